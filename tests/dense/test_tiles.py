"""Tiles with overlap: the same map as in one piece, by whomever it is computed."""

from __future__ import annotations

import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from semscape.dense.groups import _reconstruction
from semscape.dense.tiles import surface_in_tiles
from semscape.options import DenseOptions
from semscape.simulate import PRESETS, simulate
from semscape.types import FloatArray, HeightMap, ImageArray, Reason, Reconstruction, TiltSeries

OPTIONS = replace(
    PRESETS["nominal"], tilts_deg=(-6.0, 0.0, 6.0), width_px=300, height_px=260, data_bar_rows=20, shift_px=4.0
)


@cache
def calibrated() -> tuple[TiltSeries, Reconstruction]:
    """Return a simulated series with its true cameras."""
    series, truth = simulate("spheres", OPTIONS, rng=3, workers=2)
    rows, columns = np.nonzero(np.isfinite(truth.height_um))
    grid = np.column_stack([columns, rows, truth.height_um[rows, columns], np.ones(len(rows))])
    points = (grid @ truth.world_from_grid.T)[::500, :3]
    # The reference's grid is centred on the ray through its centre, as calibration leaves it.
    motion = truth.motion
    centre = np.array([(OPTIONS.width_px - 1) / 2, (OPTIONS.height_px - 1) / 2])
    shift = (centre - motion.translation_px[1]) / motion.scale_px_per_um[1] * [1, -1]
    moved = motion.translation_px + motion.scale_px_per_um[:, None] * np.column_stack(
        [shift[0] * np.cos(motion.tilt_rad), np.full(3, -shift[1])]
    )
    points[:, :2] -= shift
    return series, _reconstruction(replace(motion, translation_px=moved), points, 1, series)


@cache
def found(tile_px: int) -> HeightMap:
    return surface_in_tiles(*calibrated(), DenseOptions(tile_px=tile_px)).height_map


def test_tiles_agree_with_one_piece() -> None:
    whole, tiled = found(0), found(160)
    assert tiled.height_um.shape == whole.height_um.shape
    assert np.array_equal(tiled.world_from_grid, whole.world_from_grid)
    known = np.isfinite(whole.height_um) & np.isfinite(tiled.height_um)
    assert known.mean() > 0.95 * np.isfinite(whole.height_um).mean() > 0.7
    # Where noise decides, it decides anew: matching starts at another place. Sigmas say how far that goes.
    error, sigma = np.abs(whole.height_um - tiled.height_um)[known], whole.uncertainty_um[known]
    assert np.mean(error <= sigma) > 0.9
    # The resolution rests on the noise, too; it is stated wherever a height is.
    assert np.array_equal(np.isfinite(tiled.lateral_period_um), np.isfinite(tiled.height_um))
    ratio = (tiled.lateral_period_um / whole.lateral_period_um)[known]
    assert np.median(ratio) == pytest.approx(1, abs=0.1)
    assert np.mean(np.abs(ratio - 1) < 0.5) > 0.95
    # The tiles' borders are no worse than the rest.
    seam = np.zeros(known.shape, bool)
    seam[120:140] = seam[:, 140:160] = True
    assert np.median(disparities_apart(whole, tiled)[known & seam]) < 0.08


def test_tiles_match_on_the_pixels_of_one_piece() -> None:
    """Frames of tiles share their pixels with the whole's: else noise decides anew, and 0.07 px come out."""
    assert np.nanmedian(disparities_apart(found(0), found(160))) < 0.04


def disparities_apart(one: HeightMap, other: HeightMap) -> FloatArray:
    """Return by how many px of disparity between the outer views two maps differ (H, W)."""
    baseline = np.ptp(np.tan(OPTIONS.tilts_deg[2] * np.pi / 180 * np.array([-1, 1])))
    apart: FloatArray = np.abs(one.height_um - other.height_um) / OPTIONS.pixel_size_um * baseline
    return apart


def in_the_field(tile: Any) -> FloatArray:
    """Return row and column in the field (2, H, W) of a tile's pixels, from how far its world is moved."""
    x, y = (tile.reconstruction.points_um - calibrated()[1].points_um)[0, :2] / OPTIONS.pixel_size_um
    shape = np.array(tile.series.shape)
    corner = (np.array([OPTIONS.height_px, OPTIONS.width_px]) - shape) / 2 + [y, -x]
    return np.asarray(np.indices(shape) + corner[:, None, None], np.float64)


def test_drift_makes_no_step_of_sigma_between_tiles(monkeypatch: pytest.MonkeyPatch) -> None:
    """What each tile finds of the variance that is shared far and wide is pooled: it knows no tiles' borders."""
    shared_um2, own_um2 = iter([0.0, 1.0, 4.0, 3.0]), 0.25

    def core(tile: Any) -> Any:
        shared = next(shared_um2)
        # On the left of the field fewer views agree: they hold three times as much of it.
        shares = np.where(in_the_field(tile)[1] < 60, np.float32(3), np.float32(1))

        def heights(place: tuple[slice, slice]) -> tuple[FloatArray, FloatArray, ImageArray]:
            share = shares[place].copy()
            height, uncertainty = np.zeros(share.shape), np.sqrt(own_um2 + shared * share).astype(np.float64)
            if shared == 1:  # a tile that knows half as much counts half
                height[::2] = uncertainty[::2] = np.nan
            return height, uncertainty, share

        height, uncertainty, share = heights(tile.core)
        number, nothing = np.full(height.shape, 3, np.uint8), np.zeros(height.shape, np.float32)
        planes = height, uncertainty, number, nothing, nothing + 1, share
        return planes, [heights(strip) for strip in tile.strips], shared

    monkeypatch.setattr("semscape.dense.tiles._cores", lambda _series, _options, tiles, mapper: mapper(core, tiles))
    surface = surface_in_tiles(*calibrated(), DenseOptions(tile_px=160))
    pooled_um2 = (0.5 * 1 + 4 + 3) / 3.5
    assert surface.shared_variance_um2 == pytest.approx(pooled_um2)
    stated = surface.height_map.uncertainty_um
    times = surface.shared_times
    assert np.unique(times).tolist() == [1.0, 3.0]
    assert stated[np.isfinite(stated)] == pytest.approx(np.sqrt(own_um2 + pooled_um2 * times)[np.isfinite(stated)])


def test_no_seam_between_tiles_that_err_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each tile finds a known surface with an offset of its own, 0.2 px apart: no pixel shows where one ends."""
    offsets, slope = iter([0.0, 0.2, -0.2, 0.1]), 0.05

    def core(tile: Any) -> Any:
        rows, columns = in_the_field(tile)
        height = (slope * rows + 0.02 * columns + next(offsets)) * OPTIONS.pixel_size_um

        def heights(place: tuple[slice, slice]) -> tuple[FloatArray, FloatArray, ImageArray]:
            shape = height[place].shape
            return height[place].copy(), np.full(shape, OPTIONS.pixel_size_um), np.ones(shape, np.float32)

        (found, sigma, share), nothing = heights(tile.core), np.zeros(height[tile.core].shape, np.float32)
        planes = found, sigma, np.full(found.shape, 3, np.uint8), nothing, nothing + 1, share
        return planes, [heights(strip) for strip in tile.strips], 0.0

    monkeypatch.setattr("semscape.dense.tiles._cores", lambda _series, _options, tiles, mapper: mapper(core, tiles))
    height = surface_in_tiles(*calibrated(), DenseOptions(tile_px=160)).height_map.height_um / OPTIONS.pixel_size_um
    down, right = np.diff(height, axis=0) - slope, np.diff(height, axis=1) - 0.02
    assert 0 < np.abs(down).max() < 0.4 / 64
    assert 0 < np.abs(right).max() < 0.4 / 64


def by_bytes(function: Any, items: Any) -> Any:
    """Return what another process would: function and items as bytes there, the values as bytes back."""
    sent = pickle.dumps(function)
    return [pickle.loads(pickle.dumps(pickle.loads(sent)(pickle.loads(pickle.dumps(item))))) for item in items]


@pytest.mark.parametrize("tile_px", [0, 160])
@pytest.mark.parametrize("way", ["threads", "processes"])
def test_who_computes_the_surface_changes_nothing(way: str, tile_px: int) -> None:
    one = found(tile_px)
    with ThreadPoolExecutor(3) as pool:
        mapper = pool.map if way == "threads" else by_bytes
        options = DenseOptions(tile_px=tile_px)
        other = surface_in_tiles(*calibrated(), options, mapper=mapper, threads=pool.map).height_map
    for plane in ("height_um", "uncertainty_um", "n_views", "texture", "reason", "specimen"):
        assert np.array_equal(getattr(one, plane), getattr(other, plane), equal_nan=plane not in ("specimen",)), plane


def test_every_unknown_pixel_has_a_reason_and_no_known_one() -> None:
    for height_map in (found(0), found(160)):
        known = np.isfinite(height_map.height_um)
        assert np.array_equal(height_map.reason == Reason.KNOWN, known)
        assert not (height_map.reason == Reason.NOT_TOLD).any()
        assert (height_map.reason[-8:] == Reason.MASKED).mean() > 0.9  # the data bar


def test_reasons_are_those_of_the_whole_field() -> None:
    """A tile's crop ends where the images do not, and its own brightest place need not be white."""
    whole, tiled = found(0).reason, found(160).reason
    for reason in (Reason.OUTSIDE, Reason.MASKED):
        assert (whole == reason).sum() > 300
        assert np.mean(tiled[(whole == reason) & (tiled > 0)] == reason) > 0.99


def test_what_stands_above_all_sparse_points_is_found() -> None:
    """Spheres without keypoints of their own, as under wide tilts: the ground's points alone tell no range."""
    series, reconstruction = calibrated()
    height = reconstruction.points_um[:, 2]
    ground = reconstruction.points_um[height < np.quantile(height, 0.3)]
    apart = surface_in_tiles(series, replace(reconstruction, points_um=ground), DenseOptions(tile_px=0)).height_map
    whole = found(0)
    highest = whole.height_um > np.nanquantile(whole.height_um, 0.97)
    assert np.mean(disparities_apart(whole, apart)[highest] < 0.5) > 0.97


@pytest.mark.parametrize(("tile_px", "tiles"), [(224, 4), (225, 0), (0, 0)])
def test_a_field_as_large_as_a_tile_with_its_overlap_is_one_piece(
    tile_px: int, tiles: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    cut = []

    def mapper(_: Any, items: Any) -> Any:
        cut.extend(items)
        raise KeyboardInterrupt

    def whole(*_: Any, **__: Any) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr("semscape.dense.tiles.dense_surface", whole)
    with pytest.raises(KeyboardInterrupt):
        surface_in_tiles(*calibrated(), DenseOptions(tile_px=tile_px), mapper=mapper)
    assert len(cut) == tiles


def test_shading_can_be_left_out() -> None:
    heard, unheard = (
        surface_in_tiles(*calibrated(), DenseOptions(tile_px=0, shading=shading)).height_map.height_um
        for shading in (True, False)
    )
    both = np.isfinite(heard) & np.isfinite(unheard)
    apart = np.abs(heard - unheard)[both] / OPTIONS.pixel_size_um
    assert 0.01 < np.median(apart) < 1
