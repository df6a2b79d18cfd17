"""Where the four detectors put a blob whose centre is known, how large they call it, and which way it points."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from mahotas.features import surf as mahotas_surf
from rendered_blobs import blobs, offsets

from semscape.features.detect import DETECTORS
from semscape.features.found import least_blob_height
from semscape.features.orb import find_orb
from semscape.features.peak import nearest_peak
from semscape.features.spread import suppression_radius_px
from semscape.types import Keypoints


def lattice(sigma: float, height: float = 60.0) -> tuple[np.ndarray, np.ndarray]:
    """Return 7 x 7 centres at random sub-pixel places, and their image; its sides differ and are odd."""
    grid = np.stack(np.meshgrid(np.arange(7), np.arange(7)), axis=-1).reshape(-1, 2) * max(10 * sigma, 24) + 8 * sigma
    centres = grid.round() + 40 + np.random.default_rng(0).uniform(-0.5, 0.5, grid.shape)
    size = int(centres.max() + 8 * sigma) + 40
    return centres, np.rint(blobs(centres, sigma, (size // 2 * 2 + 1, size // 2 * 2 + 5), height)).astype(np.uint8)


def near(found: Keypoints, centres: np.ndarray) -> np.ndarray:
    """Return the index of the strongest keypoint within 2 px of each centre that has one."""
    distance = np.linalg.norm(found.xy[None] - centres[:, None], axis=2)
    strength = np.where(distance < 2, found.response, -1.0)
    return strength.argmax(axis=1)[strength.max(axis=1) >= 0]


# Half a pixel wrong, or the wrong way about the pixel's centre, would be many times these limits.
@pytest.mark.parametrize(
    ("detector", "sigma", "most_px"),
    [
        *[("sift", sigma, 0.04) for sigma in (1.5, 2.0, 3.0, 4.5)],
        *[("surf", sigma, 0.06) for sigma in (2.5, 3.0, 3.5, 4.5, 7.0, 14.0)],
        *[("orb", sigma, 0.10) for sigma in (1.2, 1.5, 2.0, 3.0)],
        *[("brief", sigma, 0.03) for sigma in (2.0, 3.0, 4.5, 6.0)],
    ],
)
def test_a_blob_is_found_at_its_centre(detector: str, sigma: float, most_px: float) -> None:
    centres, image = lattice(sigma)
    found, _ = DETECTORS[detector](image, 0.01)
    if detector == "orb":  # FAST fires on the rims of larger blobs, too: the scale that fits
        fits = np.abs(np.log(found.scale_px / sigma)) < 0.1 + np.abs(np.log(found.scale_px / sigma)).min()
        error = offsets(found.xy[fits], centres)
    else:
        error = offsets(found.xy, centres)
    assert len(error) >= 0.4 * len(centres)
    assert np.abs(error.mean(axis=0)).max() < most_px / 3
    assert np.abs(error).max() < most_px


def test_orb_is_right_at_every_scale() -> None:
    """OpenCV's own places drift off by half a pixel of the scale's image."""
    centres, image = lattice(4.0)
    found = find_orb(image, 0.01).keypoints
    level = np.rint(np.log(found.scale_px / 1.5) / np.log(1.2)).astype(int)
    for number in (4, 5, 6):
        error = offsets(found.xy[level == number], centres)
        assert len(error) > 10
        assert np.abs(error.mean(axis=0)).max() < 0.04
    raw = cv2.ORB_create(nfeatures=10_000, fastThreshold=6).detect(image)
    coarse = np.array([point.pt for point in raw if point.octave == 6])
    assert offsets(coarse, centres).mean() < -0.5  # what the correction is for


def test_mahotas_interpolates_the_wrong_way() -> None:
    """Should this fail, mahotas has been mended; semscape's places do not depend on it."""
    centres, image = lattice(3.0)
    points = mahotas_surf.interest_points(image.astype(float), 1, 6, 1, 1.0)
    error = offsets(points[:, [1, 0]], centres)
    assert np.abs(error).max() > 0.8


@pytest.mark.parametrize(("detector", "per_sigma"), [("sift", 0.887), ("surf", 0.73), ("brief", 1.0)])
def test_the_scale_follows_the_blob(detector: str, per_sigma: float) -> None:
    for sigma in (3.0, 6.0):
        centres, image = lattice(sigma)
        found, _ = DETECTORS[detector](image, 0.01)
        scale = found.scale_px[near(found, centres)]
        assert np.median(scale) / sigma == pytest.approx(per_sigma, rel=0.06)


@pytest.mark.parametrize(("detector", "sigma"), [("sift", 3.0), ("surf", 3.0), ("orb", 1.5), ("brief", 3.0)])
def test_one_threshold_means_the_same_blob_to_all(detector: str, sigma: float) -> None:
    faintest = least_blob_height(0.02)
    for factor, least, most in ((0.6, 0.0, 0.0), (1.7, 0.5, 1.0)):
        centres, image = lattice(sigma, faintest * factor)
        found, _ = DETECTORS[detector](image, 0.02)
        share = len(offsets(found.xy, centres)) / len(centres) if len(found) else 0.0
        assert least <= share <= most


@pytest.mark.parametrize("detector", ["surf", "orb", "brief"])
def test_the_response_is_the_height_of_the_blob(detector: str) -> None:
    centres, image = lattice(1.5 if detector == "orb" else 3.0, 50.0)
    found, _ = DETECTORS[detector](image, 0.01)
    assert np.median(found.response[near(found, centres)]) == pytest.approx(50, rel=0.15)


@pytest.mark.parametrize("detector", ["sift", "surf", "orb"])
def test_the_orientation_points_to_the_brighter_side(detector: str) -> None:
    """From +x towards +y, which points down; mahotas errs in one direction of twelve or so, and by much."""
    sigma = 1.5 if detector == "orb" else 3.0
    y, x = np.indices((121, 121)) - 60.0
    errors = []
    for towards in np.deg2rad(np.arange(0, 360, 30)):
        slope = x * np.cos(towards) + y * np.sin(towards)
        bump = np.exp(-(x**2 + y**2) / (2 * sigma**2))
        image = np.clip(128 + 30 * bump + 100 * np.tanh(slope / 25), 0, 255).round().astype(np.uint8)
        found, _ = DETECTORS[detector](image, 0.005)
        distance = np.linalg.norm(found.xy - 60, axis=1)
        assert distance.min() < 1.0
        turned = found.orientation_rad[distance < distance.min() + 0.5] - towards
        errors.append(np.abs(np.angle(np.exp(1j * turned))).min())
    assert np.median(errors) < np.deg2rad(6)
    assert np.mean(np.array(errors) > np.deg2rad(20)) < 0.2


def test_brief_is_upright() -> None:
    found, _ = DETECTORS["brief"](lattice(3.0)[1], 0.01)
    assert not found.orientation_rad.any()


def test_a_ridge_is_no_peak() -> None:
    """Along a bright line the place of a keypoint is not known, and the pixel stays what it is."""
    y, _ = np.indices((64, 64))
    image = np.rint(100 + 80 * np.exp(-((y - 32.3) ** 2) / 8)).astype(np.uint8)
    xy, _, is_peak = nearest_peak(image, np.array([[20, 32]]), 2.0)
    assert (xy.tolist(), is_peak.tolist()) == ([[20.0, 32.0]], [False])


def test_no_pixels_have_no_peaks() -> None:
    xy, height, is_peak = nearest_peak(np.zeros((9, 9), np.uint8), np.empty((0, 2), np.int64), 2.0)
    assert (xy.shape, height.shape, is_peak.shape) == ((0, 2), (0,), (0,))


@pytest.mark.parametrize("n", [0, 1, 2, 50, 700])
@pytest.mark.parametrize("stretch", [1.0, 200.0])
def test_suppression_radii_equal_brute_force(n: int, stretch: float) -> None:
    rng = np.random.default_rng(n)
    xy = rng.uniform(0, 100, (n, 2)) * [stretch, 1]
    response = rng.integers(0, 30, n).astype(float)  # ties
    distance = np.linalg.norm(xy[:, None] - xy[None], axis=2)
    stronger = 0.9 * response[None] > response[:, None]
    expected = np.where(stronger, distance, np.inf).min(axis=1, initial=np.inf)
    np.testing.assert_allclose(suppression_radius_px(xy, response), expected)


def test_a_negative_response_is_misuse() -> None:
    with pytest.raises(ValueError, match="must not be negative, the least is -1"):
        suppression_radius_px(np.zeros((2, 2)), np.array([1.0, -1.0]))
