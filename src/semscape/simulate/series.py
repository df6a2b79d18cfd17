"""One simulated acquisition: specimen, motion, micrographs and the exact truth."""

from __future__ import annotations

import difflib
import math
import os
from dataclasses import asdict, dataclass

import numpy as np

from semscape.errors import BadInputError
from semscape.geometry.rotations import wrap_axis_angle
from semscape.simulate import faults
from semscape.simulate.camera import ScanCamera, scan_cameras
from semscape.simulate.mesh import MeshSpecimen
from semscape.simulate.presets import SimulationOptions
from semscape.simulate.render import Scene, render_signal, truth_grid, visible_points
from semscape.simulate.specimens import SPECIMENS, Specimen, SpecimenSize
from semscape.types import (
    FloatArray,
    ImageArray,
    Micrograph,
    Motion,
    SemMetadata,
    SimulationTruth,
    SurfaceMesh,
    TiltSeries,
)

OVERSAMPLING = 2
# No specimen rises or falls farther from the eucentric plane than this share of the field of view.
_MAX_HEIGHT = 0.3
_MARGIN_PX = 24.0
# Grey levels of the series' exposure: the darkest and brightest permille of the view nearest to zero tilt.
_DARK, _BRIGHT = 0.24, 0.80
# Nobody turns the contrast up until a flat specimen shows nothing but noise: least range in units of the mean signal.
_LEAST_RANGE = 2.0
_WORKING_DISTANCE_UM = 8000.0
_VOLTAGE_KV = 5.0
_POLAROID_WIDTH_UM = 114_300.0
_KNOWN = (
    "pixel_size_um",
    "tilt_rad",
    "stage_rotation_rad",
    "working_distance_um",
    "accelerating_voltage_kv",
    "magnification",
    "scan_rotation_rad",
)


@dataclass(frozen=True, eq=False)
class Acquisition:
    """A simulated series, its truth, and the series of each segment of a backscatter detector.

    `segments` is empty for secondary electrons; else its order is that of `truth.settings["segments"]`, and `series`
    holds the mean of the segments.
    """

    series: TiltSeries
    truth: SimulationTruth
    segments: tuple[TiltSeries, ...] = ()


def draw_motion(options: SimulationOptions, seed: int) -> tuple[Motion, FloatArray, tuple[float, ...]]:
    """Draw the true motion of a series; return it, the stage's tilts (V,) in rad and the skews, by rising reading.

    The stage's tilts are told about the motion's axis: where the scan rotation turns the image of the stage's axis
    beyond (-45, 135] deg, they are the negative of its readings.
    """
    axis, flipped = wrap_axis_angle(math.radians(options.axis_deg + options.scan_rotation_deg))
    sense = -1.0 if flipped else 1.0
    stage = sense * np.deg2rad(np.sort(np.asarray(options.tilts_deg, dtype=np.float64)))
    draws = np.array([faults.stream(seed, "motion", i).standard_normal(6) for i in range(len(stage))])
    centre = np.array([options.width_px - 1, options.height_px - 1]) / 2
    motion = Motion(
        axis_angle_rad=axis,
        tilt_rad=stage - sense * np.deg2rad(options.stage_error_deg) * draws[:, 0],
        roll_rad=np.deg2rad(options.roll_deg) * draws[:, 1],
        scale_px_per_um=(1 + options.scale_drift * draws[:, 2]) / options.pixel_size_um,
        anisotropy=options.anisotropy * draws[:, 3],
        translation_px=centre + options.shift_px * np.clip(draws[:, 4:], -3, 3),
    )
    skew = [options.skew * float(faults.stream(seed, "skew", i).standard_normal()) for i in range(len(stage))]
    return motion, stage, tuple(skew)


def specimen_size(options: SimulationOptions, cameras: tuple[ScanCamera, ...]) -> SpecimenSize:
    """Return the piece of specimen that fills every view, whatever its relief."""
    pixel = options.pixel_size_um
    field_um = min(options.width_px, options.height_px) * pixel
    margin = _MARGIN_PX + 4 * (options.drift_px + options.jitter_px)
    x = np.array([-margin, options.width_px + margin])
    y = np.array([-margin, options.height_px + margin])
    corners = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    half_um = np.zeros(2)
    for camera in cameras:
        points, beam = camera.rays(corners)
        for level_um in (-_MAX_HEIGHT * field_um, _MAX_HEIGHT * field_um):
            at_level = points + beam * ((level_um - points[:, 2:]) / beam[:, 2:])
            half_um = np.maximum(half_um, np.abs(at_level[:, :2]).max(axis=0))
    # Coarse steps of size: the size decides the random field, and a small fault switched off must not change it.
    width_um, height_um = 0.25 * field_um * np.ceil(2 * half_um / (0.25 * field_um))
    return SpecimenSize(field_um, (float(width_um), float(height_um)), pixel / OVERSAMPLING)


def simulate(
    specimen: str | Specimen | MeshSpecimen = "fracture",
    options: SimulationOptions | None = None,
    *,
    rng: int = 0,
    workers: int | None = None,
) -> tuple[TiltSeries, SimulationTruth]:
    """Take a tilt series of a specimen with a simulated microscope.

    Parameters
    ----------
    specimen : str, Specimen or MeshSpecimen
        A name of `SPECIMENS`, or a surface of one's own, see `specimen_from_surface`.
    options : SimulationOptions, optional
        The acquisition; the preset `nominal` where left out.
    rng : int
        Seed, not negative: the same seed, specimen and options give the same bytes.
    workers : int, optional
        Threads; all cores where left out. It changes no result.

    Returns
    -------
    series : TiltSeries
        Micrographs by rising tilt, with the stage's tilts and the nominal pixel size as metadata.
    truth : SimulationTruth
        True motion, surface at zero tilt, visibility.

    Raises
    ------
    BadInputError
        For a specimen that is not built in.

    Examples
    --------
    >>> options = SimulationOptions(tilts_deg=(-3.0, 3.0), width_px=32, height_px=24)
    >>> series, truth = simulate("spheres", options, rng=1)
    >>> series.shape, truth.visible.shape
    ((24, 32), (2, 24, 32))
    """
    acquisition = acquire(specimen, options, rng=rng, workers=workers)
    return acquisition.series, acquisition.truth


def acquire(
    specimen: str | Specimen | MeshSpecimen = "fracture",
    options: SimulationOptions | None = None,
    *,
    rng: int = 0,
    workers: int | None = None,
) -> Acquisition:
    """Take a tilt series as `simulate` does, and keep the images of each detector segment.

    Examples
    --------
    >>> options = SimulationOptions(tilts_deg=(-3.0, 3.0), width_px=32, height_px=24, detector="bse-4")
    >>> acquisition = acquire("spheres", options)
    >>> [segment["name"] for segment in acquisition.truth.settings["segments"]], len(acquisition.segments)
    (['A', 'B', 'C', 'D'], 4)
    """
    options = SimulationOptions() if options is None else options
    if isinstance(rng, bool) or not isinstance(rng, int | np.integer) or rng < 0:
        raise ValueError(f"rng must be a whole number >= 0, got {rng!r}")
    seed = int(rng)
    motion, stage, skew = draw_motion(options, seed)
    cameras = scan_cameras(motion, skew, options.working_distance_um or math.inf)
    if isinstance(specimen, str):
        if specimen not in SPECIMENS:
            near = difflib.get_close_matches(specimen, SPECIMENS, 1, 0.0)[0]
            raise BadInputError(
                f"no specimen {specimen!r}; did you mean {near!r}? Built in are: {', '.join(SPECIMENS)}"
            )
        specimen = SPECIMENS[specimen](specimen_size(options, cameras), faults.stream(seed, "specimen"))
    scene = Scene(specimen, options, os.cpu_count() or 1 if workers is None else workers)
    every = micrographs(scene, motion, cameras, seed)
    truth = _truth(scene, motion, stage, skew, cameras, seed)
    return Acquisition(every[0], truth, every[1:])


def _truth(
    scene: Scene,
    motion: Motion,
    stage: FloatArray,
    skew: tuple[float, ...],
    cameras: tuple[ScanCamera, ...],
    seed: int,
) -> SimulationTruth:
    """Gather what the series really is."""
    options, specimen = scene.options, scene.specimen
    height, normals, world_from_grid = truth_grid(scene)
    col, row = np.meshgrid(np.arange(options.width_px), np.arange(options.height_px))
    grid = np.column_stack([col.ravel(), row.ravel(), height.ravel(), np.ones(height.size)])
    points = np.asarray(grid @ world_from_grid[:3].T, dtype=np.float64)
    visible = np.stack([visible_points(scene, points, camera).reshape(height.shape) for camera in cameras])
    settings = {"specimen": specimen.name} | asdict(options) | {"tilts_deg": list(options.tilts_deg)}
    settings["segments"] = [asdict(segment) for segment in scene.segments]
    mesh = None
    if isinstance(specimen, MeshSpecimen):
        color = np.full((len(specimen.vertices_um), 3), 200, dtype=np.uint8)
        mesh = SurfaceMesh(specimen.vertices_um, specimen.faces, color, "um")
    return SimulationTruth(
        motion=motion,
        stage_tilt_rad=stage,
        pixel_size_um=options.pixel_size_um,
        height_um=height,
        normals=normals,
        visible=visible,
        world_from_grid=world_from_grid,
        seed=seed,
        settings=settings,
        skew=skew,
        working_distance_um=options.working_distance_um or math.inf,
        mesh=mesh,
    )


def micrographs(
    scene: Scene, motion: Motion, cameras: tuple[ScanCamera, ...], seed: int, rotation_rad: float = 0.0
) -> tuple[TiltSeries, ...]:
    """Render every view, expose the series as a whole, and add each view's faults.

    `rotation_rad` is how far the stage has rotated the specimen, which the cameras' rotations hold already.

    Returns the series, and for several segments behind it, whose mean it is, those of the segments.
    """
    options = scene.options
    signals = []
    for view, camera in enumerate(cameras):
        pose = motion.axis_angle_rad, float(motion.tilt_rad[view])
        signal, depth = render_signal(scene, camera, pose, faults.scan_offsets(options, seed, view), rotation_rad)
        depth_px = depth / options.pixel_size_um
        signals.append(np.stack([faults.blur_beam(channel, depth_px, options) for channel in signal]))
    reference = signals[int(np.argmin(np.abs(motion.tilt_rad)))]
    shown = reference[reference > 0]  # an empty background emits nothing, and nobody exposes for it
    if not shown.size:
        raise BadInputError(
            f"the specimen {scene.specimen.name} does not show in a field of view of {options.width_px} x "
            f"{options.height_px} px of {options.pixel_size_um:g} um; give another pixel size"
        )
    mean = float(shown.mean())
    exposures = [_exposure(reference.mean(axis=0) / mean)]
    exposures += [_exposure(reference / mean)] * (len(reference) if scene.segments else 0)
    readings = np.sort(np.asarray(options.tilts_deg, dtype=np.float64))
    names = ["", *(f"_{segment.name}" for segment in scene.segments)]
    views: list[list[Micrograph]] = [[] for _ in names]
    for view, signal in enumerate(signals):
        charged = signal / mean
        charged = charged + faults.charging_streaks(charged.mean(axis=0), options, seed, view)
        share = 1.0 / len(charged)
        counted = [faults.detect(each, options, seed, view, k, share) for k, each in enumerate(charged)]
        detected = [np.mean(counted, axis=0), *counted][: len(names)]
        for k, (each, (black, white)) in enumerate(zip(detected, exposures, strict=True)):
            image = faults.digitize(each, black, white, options, seed, view)
            views[k].append(_micrograph(image, view, names[k], float(readings[view]), options))
    return tuple(TiltSeries(tuple(each)) for each in views)


def _exposure(signal: FloatArray) -> tuple[float, float]:
    """Return the signals that become black and white, for a reference in units of the mean signal."""
    dark, bright = np.quantile(signal[signal > 0], [0.001, 0.998])
    gain = max((bright - dark) / (_BRIGHT - _DARK), _LEAST_RANGE)
    black = (dark + bright) / 2 - gain * (_DARK + _BRIGHT) / 2
    return float(black), float(black + gain)


def _micrograph(image: ImageArray, view: int, suffix: str, tilt_deg: float, options: SimulationOptions) -> Micrograph:
    """Put an image into its file's clothes: name, data bar, mask, metadata."""
    width_um = options.width_px * options.pixel_size_um
    distance_um = options.working_distance_um or _WORKING_DISTANCE_UM
    mask = np.ones(image.shape, dtype=np.bool_)
    if options.data_bar_rows:
        mask[-options.data_bar_rows :] = False
        text = f"{width_um / 5:.3g} um  {_VOLTAGE_KV:g} kV  WD={distance_um / 1000:g} mm  T={tilt_deg:.1f}"
        image = faults.burn_data_bar(image, options.data_bar_rows, text, options.width_px // 5)
    metadata = SemMetadata(
        pixel_size_um=options.pixel_size_um,
        tilt_rad=math.radians(tilt_deg),
        stage_rotation_rad=0.0,
        working_distance_um=distance_um,
        accelerating_voltage_kv=_VOLTAGE_KV,
        magnification=_POLAROID_WIDTH_UM / width_um,
        scan_rotation_rad=math.radians(options.scan_rotation_deg),
        data_bar_rows=options.data_bar_rows,
        vendor="Zeiss",
        source=dict.fromkeys(_KNOWN, "file"),
        raw={
            "DP_DETECTOR_TYPE": "Detector = SE2" if options.detector == "se" else "Detector = BSD",
            "AP_TILT_AXIS": f"Tilt Axis = {options.axis_deg % 360.0:5.1f} °",
            "DP_STAGE_TILTED": f"Stage Tilt = {'In Y' if options.axis_deg == 0 else 'in X'}",
        },
    )
    return Micrograph(f"view_{view:02d}_{tilt_deg:+06.2f}deg{suffix}.tif", image, mask, metadata)
