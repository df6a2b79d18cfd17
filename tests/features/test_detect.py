"""Keypoints: where they lie, and where they do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from semscape.errors import TooFewMatchesError
from semscape.features.detect import DESCRIPTOR_LEVELS, DETECTORS, detect, normalize_contrast
from semscape.options import FeaturesOptions
from semscape.simulate import SimulationOptions, simulate
from semscape.types import Micrograph

OPTIONS = FeaturesOptions()


def blobs(centres: np.ndarray, sigma: float, shape: tuple[int, int]) -> np.ndarray:
    """Return hills and pits in turn: alone on a flat field a hill would be clipped by the local normalization."""
    rows, cols = np.indices(shape)
    image = np.full(shape, 100.0)
    for index, (x, y) in enumerate(centres):
        image += (60 if index % 2 else -60) * np.exp(-((cols - x) ** 2 + (rows - y) ** 2) / (2 * sigma**2))
    return image.astype(np.float32)


def micrograph(image: np.ndarray, mask: np.ndarray | None = None) -> Micrograph:
    return Micrograph("a.tif", image, np.ones(image.shape, bool) if mask is None else mask)


@pytest.fixture(scope="module")
def view() -> Micrograph:
    options = SimulationOptions(tilts_deg=(0.0,), width_px=256, height_px=256)
    return simulate("fracture", options, rng=1)[0].views[0]


def lattice(sigma: float) -> tuple[np.ndarray, np.ndarray]:
    grid = np.stack(np.meshgrid(np.arange(7), np.arange(7)), axis=-1).reshape(-1, 2) * 6.0 * sigma + 30
    centres = grid + np.random.default_rng(0).uniform(-0.5, 0.5, grid.shape)
    size = round(36 * sigma) + 60
    return centres, blobs(centres, sigma, (size, size))


def offsets(xy: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """Return the offset (F, 2) of the nearest keypoint from each centre that has one within 2 px."""
    offset = xy[None] - centres[:, None]
    nearest = np.linalg.norm(offset, axis=2).argmin(axis=1)
    offset = offset[np.arange(len(centres)), nearest]
    return offset[np.linalg.norm(offset, axis=1) < 2]


@pytest.mark.parametrize("sigma", [3.0, 4.5])
def test_the_detector_finds_a_blob_at_its_centre(sigma: float) -> None:
    """Half-pixel errors, from up-sampling or from another corner convention, would be ten times the limit."""
    centres, image = lattice(sigma)
    found = DETECTORS["sift"](image.astype(np.uint8), np.ones(image.shape, bool), OPTIONS)
    error = offsets(found.xy, centres)
    assert len(error) >= 0.9 * len(centres)
    assert np.abs(error.mean(axis=0)).max() < 0.01
    assert np.abs(error).max() < 0.05


@pytest.mark.parametrize("sigma", [3.0, 4.5])
def test_normalization_shifts_no_blob(sigma: float) -> None:
    """Isolated blobs, whose tops the normalization clips: blurred, but not shifted."""
    centres, image = lattice(sigma)
    error = offsets(detect(micrograph(image), OPTIONS).xy, centres)
    assert len(error) >= 0.8 * len(centres)
    assert np.abs(error.mean(axis=0)).max() < 0.03
    assert error.std() < 0.1


def test_keypoints_keep_clear_of_the_mask(view: Micrograph) -> None:
    mask = view.mask.copy()
    mask[-60:] = False
    mask[:, 100:104] = False
    found = detect(micrograph(view.image, mask), OPTIONS)
    assert len(found) > 50
    rows, cols = np.nonzero(~mask)
    for (x, y), scale in zip(found.xy, found.scale_px, strict=True):
        clearance = np.hypot(cols - x, rows - y).min()
        assert clearance > max(6 * scale, 3.0) - 1.5  # the keypoint's pixel against its centre
    # What lies under the mask must not matter at all.
    burnt = view.image.copy()
    burnt[~mask] = 255 * (np.random.default_rng(0).uniform(size=int((~mask).sum())) > 0.5)
    again = detect(micrograph(burnt, mask), OPTIONS)
    np.testing.assert_array_equal(again.xy, found.xy)
    np.testing.assert_array_equal(again.descriptors, found.descriptors)


def test_brightness_and_contrast_change_nothing_much(view: Micrograph) -> None:
    """The operator's knobs: the normalization takes them out, but for the rounding to 8 bits."""
    found = detect(view, OPTIONS)
    dim = detect(replace(view, image=(0.25 * view.image + 3000).astype(np.float32)), OPTIONS)
    assert len(dim) == pytest.approx(len(found), rel=0.02)
    nearest = np.linalg.norm(found.xy[:, None] - dim.xy[None], axis=2).min(axis=1)
    assert np.mean(nearest < 0.01) > 0.95


def test_keypoints_are_sorted_and_repeat_exactly(view: Micrograph) -> None:
    found, again = detect(view, OPTIONS), detect(view, OPTIONS)
    order = np.lexsort((found.orientation_rad, found.scale_px, found.xy[:, 0], found.xy[:, 1]))
    np.testing.assert_array_equal(order, np.arange(len(found)))
    np.testing.assert_array_equal(found.descriptors, again.descriptors)
    assert found.kind == "sift"
    assert found.descriptors.shape == (len(found), 128)


def test_descriptors_are_whole_numbers_whose_products_are_exact(view: Micrograph) -> None:
    descriptors = detect(view, OPTIONS).descriptors
    assert descriptors.dtype == np.float32
    np.testing.assert_array_equal(descriptors, np.rint(descriptors))
    squared = (descriptors.astype(np.float64) ** 2).sum(axis=1)
    np.testing.assert_allclose(np.sqrt(squared), DESCRIPTOR_LEVELS, rtol=0.02)
    assert 4 * squared.max() < 2**24  # also as a squared distance


def test_the_strongest_keypoints_are_kept(view: Micrograph) -> None:
    every, few = detect(view, OPTIONS), detect(view, replace(OPTIONS, max_keypoints=100))
    assert len(few) == 100
    assert few.response.min() >= np.sort(every.response)[-100]


def test_a_featureless_image_says_so() -> None:
    with pytest.raises(TooFewMatchesError, match=r"a\.tif: no keypoint found in 64 x 48 px"):
        detect(micrograph(np.full((48, 64), 9.0, np.float32)), OPTIONS)


def test_an_unknown_detector_is_misuse(view: Micrograph) -> None:
    with pytest.raises(ValueError, match=r"detector 'surff' is unknown.*'sift'"):
        detect(view, replace(OPTIONS, detector="surff"))


def test_normalization_has_the_stated_mean_and_deviation() -> None:
    rng = np.random.default_rng(0)
    image = (1000 + 5 * rng.normal(size=(256, 256)) + np.linspace(0, 300, 256)).astype(np.float32)
    normalized = normalize_contrast(image, np.ones(image.shape, bool), 16.0).astype(float)[64:-64, 64:-64]
    assert normalized.mean() == pytest.approx(128, abs=2)
    assert normalized.std() == pytest.approx(40, rel=0.1)
