"""Which model a pair of views gets, and what is said of it."""

from __future__ import annotations

import numpy as np
import pytest

from semscape.errors import BadInputError, TooFewMatchesError
from semscape.robust.pair_geometry import pinhole_calibrations, two_view_geometry
from semscape.types import Micrograph, SemMetadata, TiltSeries, TwoViewGeometry
from synthetic_pairs import SHAPES, pair_of_views, perspective_views


def geometry(x1: np.ndarray, x2: np.ndarray, kind: str, **named: object) -> TwoViewGeometry:
    rng = np.random.default_rng(0)
    return two_view_geometry((0, 1), x1, x2, kind=kind, shapes=SHAPES, rng=rng, max_trials=1000, **named)


def test_parallel_views_of_a_relief_are_affine() -> None:
    x1, x2, right = pair_of_views(500, 0.3, 0.4, 1, relief_px=250)
    found = geometry(x1, x2, "auto")
    assert found.kind == "affine"
    assert not found.planar
    assert set(found.log10_nfa_by_kind) == {"affine", "fundamental", "homography"}
    assert found.log10_nfa == found.log10_nfa_by_kind["affine"] == min(found.log10_nfa_by_kind.values())
    # What the full fundamental matrix has more to adjust costs more tests than it gains.
    assert 0 < found.nfa_margin < 0.1 * abs(found.log10_nfa)
    assert found.inliers[right].mean() > 0.9


def test_one_model_has_no_margin() -> None:
    found = geometry(*pair_of_views(300, 0.3, 0.4, 1)[:2], "affine")
    assert found.kind == "affine"
    assert np.isnan(found.nfa_margin)


def test_a_plane_is_a_homography_and_said_to_be_planar() -> None:
    x1, x2, _ = pair_of_views(300, 0.2, 0.4, 1, relief_px=0)
    found = geometry(x1, x2, "auto")
    assert (found.kind, found.planar) == ("homography", True)
    assert found.nfa_margin > 100
    affine = geometry(x1, x2, "affine")  # one of many that hold: an honest model says so
    assert affine.planar
    assert affine.log10_nfa < 0


def test_perspective_views_are_not_affine() -> None:
    x1, x2, _, calibration = perspective_views(300, 0.3, 1)
    found = geometry(x1, x2, "auto", calibrations=(calibration, calibration))
    assert found.kind in {"fundamental", "essential"}
    assert found.log10_nfa_by_kind["affine"] - found.log10_nfa > 100


def test_a_model_that_cannot_be_had_is_left_out_and_without_any_the_reason_is_told() -> None:
    x1, x2, _ = pair_of_views(7, 0.0, 0.1, 1)
    found = geometry(x1, x2, "auto")
    assert set(found.log10_nfa_by_kind) == {"affine", "homography"}  # seven matches are no fundamental matrix
    with pytest.raises(TooFewMatchesError, match="'affine' needs at least 5"):
        geometry(x1[:3], x2[:3], "auto")


def test_an_essential_matrix_needs_calibrations() -> None:
    x1, x2, _ = pair_of_views(50, 0.0, 0.1, 1)
    with pytest.raises(BadInputError, match="calibrations"):
        geometry(x1, x2, "essential")
    with pytest.raises(ValueError, match="'cubic' is unknown"):
        geometry(x1, x2, "cubic")


def test_calibrations_come_from_the_working_distance() -> None:
    image, mask = np.zeros((101, 201), np.float32), np.ones((101, 201), bool)
    known = Micrograph("a.tif", image, mask, SemMetadata(pixel_size_um=0.5, working_distance_um=10_000.0))
    (matrix,) = pinhole_calibrations(TiltSeries((known,)))
    np.testing.assert_array_equal(matrix, [[20_000, 0, 100], [0, 20_000, 50], [0, 0, 1]])
    with pytest.raises(BadInputError, match=r"b\.tif.*working distance"):
        pinhole_calibrations(TiltSeries((known, Micrograph("b.tif", image, mask))))
