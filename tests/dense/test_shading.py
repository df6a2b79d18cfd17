"""Laws of shading: learnt from what is seen, and then a witness of slopes."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy import ndimage
from threadpoolctl import threadpool_limits

from semscape.dense.sampling import ViewSampler
from semscape.dense.shading import (
    GreyLevels,
    Regression,
    ShadingLaws,
    Texture,
    grey_levels,
    regressions,
)
from semscape.dense.sweep import Views
from semscape.types import FloatArray, Micrograph

SHAPE = 300, 320
TILTS = np.tan(np.deg2rad([-6.0, 0.0, 6.0]))
OF_MEAN, OF_CHANGE = np.array([0.2, -0.1, 0.3]), np.array([-0.4, 0.05, 0.0])
ALL = np.ones(SHAPE, bool)


def rough(seed: int, wave_px: float, height_px: float) -> FloatArray:
    made = ndimage.gaussian_filter(np.random.default_rng(seed).standard_normal(SHAPE), wave_px)
    return np.asarray(height_px * made / made.std(), np.float64)


def functions(height: FloatArray) -> FloatArray:
    down, along = np.gradient(height)
    up = 1 / np.sqrt(1 + along**2 + down**2)
    return np.stack([along * up, down * up, -np.log(up)])


@cache
def surface() -> FloatArray:
    return rough(0, 14.0, 12.0) + rough(1, 4.0, 0.8)


def seen(texture: float = 0.02, seed: int = 2) -> Views:
    """Return three views of the surface with shading by both laws, their parallax undone: heights move nothing."""
    rng = np.random.default_rng(seed)
    normals = functions(surface())
    brightness = 1 + np.tensordot(OF_MEAN, normals, 1) + texture * rng.standard_normal(SHAPE)
    change = np.tensordot(OF_CHANGE, normals, 1)
    still = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    views = []
    for k, (tilt, gain, offset) in enumerate(zip(TILTS, (80.0, 100.0, 120.0), (20.0, 0.0, -10.0), strict=True)):
        image = (offset + gain * brightness * (1 + tilt * change)).astype(np.float32)
        view = Micrograph(f"view{k}.tif", image, np.ones(SHAPE, bool))
        views.append(ViewSampler(view, still, np.zeros(2), np.array([1.0, 0.0]), SHAPE, 0.3))
    return Views(tuple(views), TILTS, 1)


def levels(views: Views) -> GreyLevels:
    found = grey_levels([Micrograph("view.tif", view.image, view.mask > 0) for view in views.samplers])
    assert found is not None
    return found


def laws_of(views: Views) -> list[FloatArray]:
    laws = [each.law() for each in regressions(surface(), ALL, views, levels(views))]
    assert laws[0] is not None
    assert laws[1] is not None
    return [law for law in laws if law is not None]


def test_the_laws_are_learnt() -> None:
    of_mean, of_change = laws_of(seen())
    # Views are made alike in the contrast that each has; the median's own brightness is the unit.
    assert of_mean / OF_MEAN == pytest.approx(1, abs=0.15)
    assert of_change[:2] == pytest.approx(OF_CHANGE[:2], abs=0.08)


def test_regressions_of_parts_add_up() -> None:
    views = seen()
    whole = regressions(surface(), ALL, views, levels(views))
    halves = [
        regressions(surface(), ALL, views, levels(views), (slice(*rows), slice(0, SHAPE[1])))
        for rows in ((0, 100), (100, SHAPE[0]))
    ]
    for one, first, second in zip(whole, *halves, strict=True):
        both = first + second
        assert both.count == one.count
        assert both.square == pytest.approx(one.square)
        assert both.answer == pytest.approx(one.answer)


def test_sums_do_not_depend_on_threads() -> None:
    views = seen()
    by_threads = []
    for count in (1, 2):
        with threadpool_limits(count):
            by_threads.append(regressions(surface(), ALL, views, levels(views)))
    for one, other in zip(*by_threads, strict=True):
        assert one.square.tobytes() == other.square.tobytes()
        assert one.answer.tobytes() == other.answer.tobytes()
        assert one.power == other.power


def test_texture_alone_is_no_law() -> None:
    rng = np.random.default_rng(6)
    still = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    noise = [Micrograph(f"{k}.tif", rng.normal(100, 10, SHAPE).astype(np.float32), ALL) for k in range(3)]
    views = Views(
        tuple(ViewSampler(view, still, np.zeros(2), np.array([1.0, 0.0]), SHAPE, 0.3) for view in noise), TILTS, 1
    )
    told = regressions(surface(), ALL, views, levels(views))
    assert [each.law() for each in told] == [None, None]
    looks = [view.sample(surface()) for view in views.samplers]
    free = ALL.astype(np.float32)
    terms, same = ShadingLaws(levels(views), told).heard(looks, TILTS, free, surface(), Texture())
    assert terms == []
    assert all(np.array_equal(one[0], other[0]) for one, other in zip(looks, same, strict=True))


def test_too_few_pixels_are_no_law() -> None:
    nothing = Regression(np.zeros((3, 3)), np.zeros(3), 0.0, 0.0)
    assert nothing.law() is None
    few = np.zeros(SHAPE, bool)
    few[:20, :20] = True
    views = seen()
    assert [each.law() for each in regressions(surface(), few, views, levels(views))] == [None, None]


def test_brightness_pulls_towards_the_true_surface() -> None:
    """Heights that lack the finer waves are pulled along what they lack; the true ones much less."""
    views = seen()
    laws = ShadingLaws(levels(views), regressions(surface(), ALL, views, levels(views)))
    free = ALL.astype(np.float32)
    smooth = ndimage.gaussian_filter(surface(), 6.0)
    looks = [view.sample(smooth) for view in views.samplers]
    terms, _ = laws.heard(looks, TILTS, free, smooth, Texture())
    assert len(terms) == 2
    lacking = (surface() - smooth)[40:-40, 40:-40]
    for term in terms:
        pull = term.pull()[40:-40, 40:-40]
        assert np.vdot(pull, lacking) > 0.2 * np.linalg.norm(pull) * np.linalg.norm(lacking)


def test_the_expected_change_is_taken_out() -> None:
    views = seen(texture=0.0)
    laws = ShadingLaws(levels(views), regressions(surface(), ALL, views, levels(views)))
    looks = [view.sample(surface()) for view in views.samplers]
    _, corrected = laws.heard(looks, TILTS, ALL.astype(np.float32), surface(), Texture())

    def change(seen: list[tuple[FloatArray, ...]]) -> float:
        first, last = ((image - np.median(image)) / np.median(np.abs(image - np.median(image))) for image in seen)
        return float(np.std(last - first))

    before = change([looks[0][0], looks[2][0]])
    assert change([corrected[0][0], corrected[2][0]]) < 0.35 * before


def test_what_the_brightness_holds_besides_is_taken_no_smaller_than_at_first() -> None:
    views = seen()
    laws = ShadingLaws(levels(views), regressions(surface(), ALL, views, levels(views)))
    free, texture = ALL.astype(np.float32), Texture()
    smooth = ndimage.gaussian_filter(surface(), 6.0)
    first, _ = laws.heard([v.sample(smooth) for v in views.samplers], TILTS, free, smooth, texture)
    again, _ = laws.heard([v.sample(surface()) for v in views.samplers], TILTS, free, surface(), texture)
    assert again[0].precision == pytest.approx(first[0].precision)
    assert np.median(again[1].precision) >= np.median(first[1].precision)


def test_views_of_one_grey_have_no_levels() -> None:
    flat = np.full(SHAPE, 7.0, np.float32)
    assert grey_levels([Micrograph("flat.tif", flat, ALL)]) is None
    assert grey_levels([Micrograph("black.tif", 0 * flat, ALL)]) is None
    assert grey_levels([Micrograph("barred.tif", flat + surface().astype(np.float32), ~ALL)]) is None
