"""Signal and faults against closed forms, and each fault alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from semscape.simulate import PRESETS, SimulationOptions, simulate
from semscape.simulate.camera import ScanCamera, scan_cameras
from semscape.simulate.faults import blur_beam, burn_data_bar, detect, digitize, scan_offsets
from semscape.simulate.render import Scene, render_signal
from semscape.simulate.series import draw_motion, specimen_size
from semscape.simulate.signal import open_sky
from semscape.simulate.specimens import Specimen

SMALL = replace(PRESETS["ideal"], tilts_deg=(-6.0, 6.0), width_px=64, height_px=48)
BARE = replace(
    SMALL,
    yield_saturation=0.0,
    edge_gain=0.0,
    detector_asymmetry=0.0,
    cavity=0.0,
    texture=0.0,
    texture_bump=0.0,
)


@pytest.mark.parametrize("slope_deg", [0.0, 30.0])
@pytest.mark.parametrize("tilt_deg", [0.0, 20.0, -20.0])
def test_yield_of_a_tilted_plane_is_the_secant_of_its_angle_to_the_beam(slope_deg: float, tilt_deg: float) -> None:
    x = (np.arange(301) - 150) * 0.05
    # Rising towards +x: the normal leans to -x by the slope; a positive tilt about +y turns it towards +x.
    height = np.broadcast_to(np.tan(np.deg2rad(slope_deg)) * x, (301, 301))
    specimen = Specimen("slope", np.ascontiguousarray(height, dtype=np.float32), 0.05, 0)
    c, s = np.cos(np.deg2rad(tilt_deg)), np.sin(np.deg2rad(tilt_deg))
    matrix = np.array([[c, 0.0, s], [0.0, -1.0, 0.0]])
    pose = (np.pi / 2, float(np.deg2rad(tilt_deg)))
    camera = ScanCamera(np.vstack([matrix, [s, 0.0, -c]]), 10 * np.eye(2), np.array([31.5, 23.5]))
    (signal,), _ = render_signal(Scene(specimen, BARE), camera, pose, np.zeros((48, 2)))
    np.testing.assert_allclose(signal[4:-4, 4:-4], 1 / np.cos(np.deg2rad(slope_deg - tilt_deg)), rtol=1e-4)


def test_detector_shading_stays_in_the_lab_while_the_specimen_tilts() -> None:
    options = replace(BARE, detector_asymmetry=0.5, detector_azimuth_deg=0.0, detector_elevation_deg=0.0)
    specimen = Specimen("plane", np.zeros((301, 301), dtype=np.float32), 0.05, 0)
    for tilt_deg in (-20.0, 20.0):
        c, s = np.cos(np.deg2rad(tilt_deg)), np.sin(np.deg2rad(tilt_deg))
        matrix = np.array([[c, 0.0, s], [0.0, -1.0, 0.0]])
        pose = (np.pi / 2, float(np.deg2rad(tilt_deg)))
        camera = ScanCamera(np.vstack([matrix, [s, 0.0, -c]]), 10 * np.eye(2), np.array([31.5, 23.5]))
        (signal,), _ = render_signal(Scene(specimen, options), camera, pose, np.zeros((48, 2)))
        # The normal leans by sin(tilt) towards the detector on the right; the yield is 1 / cos(tilt).
        np.testing.assert_allclose(signal[4:-4, 4:-4], (1 + 0.5 * s) / c, rtol=1e-4)


def test_open_sky_of_a_trench_is_that_of_its_walls() -> None:
    height = np.full((81, 81), 10.0, dtype=np.float32)
    height[:, 38:43] = 0.0
    sky = open_sky(height, 1.0, 200.0)
    assert sky[40, 70] == 1.0
    # 8 azimuths: two run along the trench, six meet a wall at most 5 nodes away and 10 high.
    assert 2 / 8 < sky[40, 40] < 2 / 8 + 6 / 8 / (1 + (10 / 5) ** 2)


@pytest.mark.parametrize("dose", [20.0, 500.0])
def test_noise_variance_is_the_signal_over_the_dose(dose: float) -> None:
    options = replace(SMALL, dose=dose)
    for level in (0.5, 2.0):
        counted = detect(np.full((300, 300), level), options, 3, 0)
        assert counted.mean() == pytest.approx(level, rel=0.01)
        assert counted.var() == pytest.approx(level / dose, rel=0.03)


def test_digitize_gives_whole_grey_levels_between_black_and_white() -> None:
    image = digitize(np.array([[-1.0, 0.5, 1.0, 1.75, 9.0]]), 0.5, 2.5, SMALL, 0, 0)
    assert image.dtype == np.float32
    assert image.tolist() == [[0.0, 0.0, 64.0, 159.0, 255.0]]


def test_blur_spreads_a_point_to_the_variance_of_the_beam() -> None:
    point = np.zeros((41, 41))
    point[20, 20] = 1.0
    blurred = blur_beam(point, np.zeros(point.shape), replace(SMALL, blur_px=1.5))
    x = np.arange(41) - 20
    assert blurred.sum() == pytest.approx(1.0)
    assert (blurred.sum(axis=0) * x**2).sum() == pytest.approx(1.5**2, rel=0.02)


def test_slow_drift_holds_no_scale_and_no_shear() -> None:
    options = replace(SMALL, drift_px=0.5, height_px=200)
    offsets = scan_offsets(options, 1, 0)
    assert offsets.std(axis=0) == pytest.approx([0.5, 0.5])
    assert np.abs(np.polyfit(np.arange(200), offsets, 1)).max() < 1e-9
    assert scan_offsets(replace(options, drift_px=0.0, jitter_px=0.2), 1, 0)[:, 0].std() == pytest.approx(0.2, rel=0.2)


def test_data_bar_covers_the_bottom_alone() -> None:
    image = np.full((100, 200), 77.0, dtype=np.float32)
    out = burn_data_bar(image, 30, "3.84 um  5 kV  T=-6.0", 40)
    assert (out[:70] == 77).all()
    assert set(np.unique(out[70:])) == {0.0, 255.0}
    assert (image == 77).all()


MOTION_FAULTS = ("scale_drift", "anisotropy", "roll_deg", "stage_error_deg", "shift_px")
IMAGE_FAULTS = {
    "blur_px": 1.0,
    "defocus": 0.1,
    "dose": 100.0,
    "line_noise": 0.05,
    "jitter_px": 0.3,
    "drift_px": 0.5,
    "charging": 0.5,
    "brightness": 0.1,
    "contrast": 0.2,
}


def test_image_faults_act_and_switch_off_alone() -> None:
    clean, truth = simulate("spheres", SMALL, rng=4)
    for name, strength in IMAGE_FAULTS.items():
        series, faulty_truth = simulate("spheres", replace(SMALL, **{name: strength}), rng=4)
        changed = [np.mean(a.image != b.image) for a, b in zip(series.views, clean.views, strict=True)]
        assert min(changed) > 0.01, name
        np.testing.assert_array_equal(faulty_truth.motion.translation_px, truth.motion.translation_px)
        np.testing.assert_array_equal(faulty_truth.motion.tilt_rad, truth.motion.tilt_rad)


# What belongs to the signal is on in every preset, and each effect can be taken away alone.
SIGNAL_EFFECTS = ("edge_gain", "detector_asymmetry", "cavity", "texture", "texture_bump")


@pytest.mark.parametrize("name", SIGNAL_EFFECTS)
def test_effects_of_the_signal_act_and_switch_off_alone(name: str) -> None:
    bare = replace(SMALL, **dict.fromkeys(SIGNAL_EFFECTS, 0.0))
    without = simulate("spheres", bare, rng=4)[0].views[0].image
    with_it = simulate("spheres", replace(bare, **{name: getattr(SMALL, name)}), rng=4)[0].views[0].image
    assert np.mean(with_it != without) > 0.01


@pytest.mark.parametrize("name", MOTION_FAULTS)
def test_motion_faults_act_and_switch_off_alone(name: str) -> None:
    ideal = simulate("spheres", SMALL, rng=4)[1].motion
    nominal = getattr(PRESETS["nominal"], name)
    motion = simulate("spheres", replace(SMALL, **{name: nominal}), rng=4)[1].motion
    field = {
        "scale_drift": "scale_px_per_um",
        "anisotropy": "anisotropy",
        "roll_deg": "roll_rad",
        "stage_error_deg": "tilt_rad",
        "shift_px": "translation_px",
    }
    for fault, attribute in field.items():
        same = np.array_equal(getattr(motion, attribute), getattr(ideal, attribute))
        assert same == (fault != name), attribute


def cameras_of(options: SimulationOptions, seed: int) -> tuple[ScanCamera, ...]:
    motion, _, skew = draw_motion(options, seed)
    return scan_cameras(motion, skew, np.inf)


def test_faults_leave_the_specimen_alone() -> None:
    # The size of the piece decides its random numbers: at the default image size usual faults may not change it.
    sizes = {
        specimen_size(options, cameras_of(options, seed))
        for options in (PRESETS["ideal"], PRESETS["nominal"])
        for seed in range(20)
    }
    assert len(sizes) == 1


def test_ideal_motion_is_what_was_asked_for() -> None:
    _, truth = simulate("spheres", SMALL)
    np.testing.assert_allclose(np.rad2deg(truth.motion.tilt_rad), [-6, 6])
    np.testing.assert_allclose(truth.motion.translation_px, [[31.5, 23.5]] * 2)
    np.testing.assert_allclose(truth.motion.scale_px_per_um, 10.0)
    np.testing.assert_array_equal(truth.stage_tilt_rad, truth.motion.tilt_rad)


def test_the_page_tells_the_strengths_of_the_presets() -> None:
    page = (Path(__file__).parents[2] / "docs" / "simulator.md").read_text(encoding="utf-8")
    rows = [line.strip("| ").split(" | ") for line in page.splitlines() if line.startswith("| `")]
    told = {}
    for names, _, *cells in (row for row in rows if len(row) == 5):
        columns = [[float(value) for value in cell.split(",")] for cell in cells]
        told |= dict(zip(names.replace("`", "").split(", "), zip(*columns, strict=True), strict=True))
    assert set(MOTION_FAULTS) | set(IMAGE_FAULTS) | {"cavity", "edge_gain", "data_bar_rows"} <= set(told)
    for name, values in told.items():
        assert values == tuple(getattr(PRESETS[preset], name) for preset in ("ideal", "nominal", "hard")), name
