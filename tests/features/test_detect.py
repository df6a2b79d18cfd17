"""Keypoints: where they lie, and where they do not."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from rendered_blobs import blobs, offsets
from scipy.spatial import cKDTree

from semscape.errors import TooFewMatchesError
from semscape.features.detect import DETECTORS, detect
from semscape.features.normalize import normalize_contrast
from semscape.features.sift import DESCRIPTOR_LEVELS
from semscape.options import FeaturesOptions
from semscape.simulate import SimulationOptions, simulate
from semscape.types import Micrograph

OPTIONS = FeaturesOptions()


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


@pytest.mark.parametrize("sigma", [3.0, 4.5])
def test_normalization_shifts_no_blob(sigma: float) -> None:
    """Isolated blobs, whose tops the normalization clips: blurred, but not shifted."""
    centres, image = lattice(sigma)
    error = offsets(detect(micrograph(image), OPTIONS).xy, centres)
    assert len(error) >= 0.8 * len(centres)
    assert np.abs(error.mean(axis=0)).max() < 0.03
    assert error.std() < 0.1


@pytest.mark.parametrize("detector", DETECTORS)
def test_keypoints_keep_clear_of_the_mask(view: Micrograph, detector: str) -> None:
    options = replace(OPTIONS, detector=detector, max_keypoints=1000)
    mask = view.mask.copy()
    mask[-60:] = False
    mask[:, 100:104] = False
    found = detect(micrograph(view.image, mask), options)
    assert len(found) > 50
    # The half side of each descriptor's square, in px and in scales.
    reach = {"sift": 6 * found.scale_px, "surf": 10 * found.scale_px, "orb": 31 / 3 * found.scale_px}.get(detector, 28)
    rows, cols = np.nonzero(~mask)
    clearance = np.array([np.hypot(cols - x, rows - y).min() for x, y in found.xy])
    assert (clearance > np.maximum(reach, 3.0) - 1.5).all()  # the keypoint's pixel against its centre
    # What lies under the mask must not matter at all.
    burnt = view.image.copy()
    burnt[~mask] = 255 * (np.random.default_rng(0).uniform(size=int((~mask).sum())) > 0.5)
    again = detect(micrograph(burnt, mask), options)
    np.testing.assert_array_equal(again.xy, found.xy)
    np.testing.assert_array_equal(again.descriptors, found.descriptors)


@pytest.mark.parametrize("detector", DETECTORS)
def test_brightness_and_contrast_change_nothing_much(view: Micrograph, detector: str) -> None:
    """The operator's knobs: the normalization takes them out, but for the rounding to 8 bits."""
    options = replace(OPTIONS, detector=detector)
    found = detect(view, options)
    dim = detect(replace(view, image=(0.02 * view.image + 300).astype(np.float32)), options)
    assert len(dim) == pytest.approx(len(found), rel=0.02)
    nearest, _ = cKDTree(dim.xy).query(found.xy)
    assert np.mean(nearest < 0.01) > 0.95


@pytest.mark.parametrize("detector", DETECTORS)
def test_keypoints_are_sorted_and_repeat_exactly(view: Micrograph, detector: str) -> None:
    options = replace(OPTIONS, detector=detector)
    found = detect(view, options)
    order = np.lexsort((found.orientation_rad, found.scale_px, found.xy[:, 0], found.xy[:, 1]))
    np.testing.assert_array_equal(order, np.arange(len(found)))
    assert found.kind == detector
    dimension, kind = {"sift": (128, np.float32), "surf": (64, np.float32)}.get(detector, (32, np.uint8))
    assert (found.descriptors.shape, found.descriptors.dtype) == ((len(found), dimension), kind)
    assert len(found) > 100
    assert (found.response >= 0).all()
    threads = cv2.getNumThreads()
    try:
        cv2.setNumThreads(1 if threads > 1 else 4)
        again = detect(view, options)
    finally:
        cv2.setNumThreads(threads)
    for name in ("xy", "scale_px", "orientation_rad", "response", "descriptors"):
        np.testing.assert_array_equal(getattr(again, name), getattr(found, name))


@pytest.mark.parametrize("detector", ["sift", "surf"])
def test_descriptors_are_whole_numbers_whose_products_are_exact(view: Micrograph, detector: str) -> None:
    descriptors = detect(view, replace(OPTIONS, detector=detector)).descriptors
    assert descriptors.dtype == np.float32
    np.testing.assert_array_equal(descriptors, np.rint(descriptors))
    squared = (descriptors.astype(np.float64) ** 2).sum(axis=1)
    np.testing.assert_allclose(np.sqrt(squared), DESCRIPTOR_LEVELS, rtol=0.02)
    assert 4 * squared.max() < 2**24  # also as a squared distance


def test_the_strongest_keypoints_are_kept(view: Micrograph) -> None:
    every, few = detect(view, OPTIONS), detect(view, replace(OPTIONS, max_keypoints=100))
    assert len(few) == 100
    assert few.response.min() >= np.sort(every.response)[-100]


def test_spread_keypoints_cover_more_of_the_image(view: Micrograph) -> None:
    """Of 16 x 16 cells, how many hold a keypoint; the cap is met exactly both ways."""
    covered = {}
    for spread in (False, True):
        found = detect(view, replace(OPTIONS, max_keypoints=200, spread=spread))
        assert len(found) == 200
        covered[spread] = len(np.unique(found.xy // 16, axis=0))
    assert covered[True] > 1.15 * covered[False]


@pytest.mark.parametrize("detector", DETECTORS)
def test_a_featureless_image_says_so(detector: str) -> None:
    for shape in ((48, 64), (200, 150)):
        with pytest.raises(TooFewMatchesError, match=rf"a\.tif: no keypoint found in {shape[1]} x {shape[0]} px"):
            detect(micrograph(np.full(shape, 9.0, np.float32)), replace(OPTIONS, detector=detector))


def test_an_unknown_detector_is_misuse(view: Micrograph) -> None:
    with pytest.raises(ValueError, match=r"detector 'surff' is unknown.*'sift'"):
        detect(view, replace(OPTIONS, detector="surff"))


def test_normalization_has_the_stated_mean_and_deviation() -> None:
    rng = np.random.default_rng(0)
    image = (1000 + 5 * rng.normal(size=(256, 256)) + np.linspace(0, 300, 256)).astype(np.float32)
    normalized = normalize_contrast(image, np.ones(image.shape, bool), 16.0).astype(float)[64:-64, 64:-64]
    assert normalized.mean() == pytest.approx(128, abs=2)
    assert normalized.std() == pytest.approx(40, rel=0.1)
