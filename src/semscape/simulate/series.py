"""One simulated acquisition: specimen, motion, micrographs and the exact truth."""

from __future__ import annotations

import difflib
import os
from dataclasses import asdict, replace

import numpy as np

from semscape.errors import BadInputError
from semscape.geometry.cameras import camera_matrices
from semscape.simulate import faults
from semscape.simulate.cast import rays_of_pixels
from semscape.simulate.presets import SimulationOptions
from semscape.simulate.render import Scene, render_signal, truth_grid, visible_points
from semscape.simulate.specimens import SPECIMENS, Specimen, SpecimenSize
from semscape.types import FloatArray, ImageArray, Micrograph, Motion, SemMetadata, SimulationTruth, TiltSeries

OVERSAMPLING = 2
# No specimen rises or falls farther from the eucentric plane than this share of the field of view.
_MAX_HEIGHT = 0.3
_MARGIN_PX = 24.0
# Grey levels of the series' exposure: the darkest and brightest permille of the view nearest to zero tilt.
_DARK, _BRIGHT = 0.12, 0.78
# Nobody turns the contrast up until a flat specimen shows nothing but noise: least range in units of the mean signal.
_LEAST_RANGE = 2.0
_WORKING_DISTANCE_UM = 8000.0
_VOLTAGE_KV = 5.0
_POLAROID_WIDTH_UM = 114_300.0


def draw_motion(options: SimulationOptions, seed: int) -> tuple[Motion, FloatArray]:
    """Draw the true motion of a series and return it with the stage's tilts (V,) in rad, both by rising tilt."""
    stage = np.deg2rad(np.sort(np.asarray(options.tilts_deg, dtype=np.float64)))
    draws = np.array([faults.stream(seed, "motion", i).standard_normal(6) for i in range(len(stage))])
    centre = np.array([options.width_px - 1, options.height_px - 1]) / 2
    motion = Motion(
        axis_angle_rad=float(np.deg2rad(options.axis_deg)),
        tilt_rad=stage - np.deg2rad(options.stage_error_deg) * draws[:, 0],
        roll_rad=np.deg2rad(options.roll_deg) * draws[:, 1],
        scale_px_per_um=(1 + options.scale_drift * draws[:, 2]) / options.pixel_size_um,
        anisotropy=options.anisotropy * draws[:, 3],
        translation_px=centre + options.shift_px * np.clip(draws[:, 4:], -3, 3),
    )
    return motion, stage


def specimen_size(options: SimulationOptions, motion: Motion) -> SpecimenSize:
    """Return the piece of specimen that fills every view of a motion, whatever its relief."""
    pixel = options.pixel_size_um
    field_um = min(options.width_px, options.height_px) * pixel
    margin = _MARGIN_PX + 4 * (options.drift_px + options.jitter_px)
    x = np.array([-margin, options.width_px + margin])
    y = np.array([-margin, options.height_px + margin])
    corners = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    half_um = np.zeros(2)
    for matrix, translation in zip(camera_matrices(motion), motion.translation_px, strict=True):
        linear, offset, slope = rays_of_pixels(matrix, translation, np.eye(2, 3))
        for level_um in (-_MAX_HEIGHT * field_um, _MAX_HEIGHT * field_um):
            half_um = np.maximum(half_um, np.abs(corners @ linear.T + offset + slope * level_um).max(axis=0))
    # Coarse steps of size: the size decides the random field, and a small fault switched off must not change it.
    width_um, height_um = 0.25 * field_um * np.ceil(2 * half_um / (0.25 * field_um))
    return SpecimenSize(field_um, (float(width_um), float(height_um)), pixel / OVERSAMPLING)


def simulate(
    specimen: str | Specimen = "fracture",
    options: SimulationOptions | None = None,
    *,
    rng: int = 0,
    workers: int | None = None,
) -> tuple[TiltSeries, SimulationTruth]:
    """Take a tilt series of a specimen with a simulated microscope.

    Parameters
    ----------
    specimen : str or Specimen
        A name of `SPECIMENS`, or a height field that is large enough for every view.
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
    options = SimulationOptions() if options is None else options
    if isinstance(rng, bool) or not isinstance(rng, int | np.integer) or rng < 0:
        raise ValueError(f"rng must be a whole number >= 0, got {rng!r}")
    seed = int(rng)
    motion, stage = draw_motion(options, seed)
    if isinstance(specimen, str):
        if specimen not in SPECIMENS:
            near = difflib.get_close_matches(specimen, SPECIMENS, 1, 0.0)[0]
            raise BadInputError(
                f"no specimen {specimen!r}; did you mean {near!r}? Built in are: {', '.join(SPECIMENS)}"
            )
        specimen = SPECIMENS[specimen](specimen_size(options, motion), faults.stream(seed, "specimen"))
    scene = Scene(specimen, options, os.cpu_count() or 1 if workers is None else workers)
    series = TiltSeries(_micrographs(scene, motion, stage, seed))

    height, normals, world_from_grid = truth_grid(scene)
    col, row = np.meshgrid(np.arange(options.width_px), np.arange(options.height_px))
    grid = np.column_stack([col.ravel(), row.ravel(), height.ravel(), np.ones(height.size)])
    points = np.asarray(grid @ world_from_grid[:3].T, dtype=np.float64)
    visible = np.stack(
        [
            visible_points(scene, points, matrix, translation).reshape(height.shape)
            for matrix, translation in zip(camera_matrices(motion), motion.translation_px, strict=True)
        ]
    )
    settings = {"specimen": specimen.name} | asdict(options) | {"tilts_deg": list(options.tilts_deg)}
    truth = SimulationTruth(
        motion=motion,
        stage_tilt_rad=stage,
        pixel_size_um=options.pixel_size_um,
        height_um=height,
        normals=normals,
        visible=visible,
        world_from_grid=world_from_grid,
        seed=seed,
        settings=settings,
    )
    return series, truth


def _micrographs(scene: Scene, motion: Motion, stage: FloatArray, seed: int) -> tuple[Micrograph, ...]:
    """Render every view, expose the series as a whole, and add each view's faults."""
    options = scene.options
    signals = []
    for view, matrix in enumerate(camera_matrices(motion)):
        pose = motion.axis_angle_rad, float(motion.tilt_rad[view])
        offsets = faults.scan_offsets(options, seed, view)
        signal = render_signal(scene, matrix, motion.translation_px[view], pose, offsets)
        signals.append(faults.blur_beam(signal, options.blur_px))
    reference = signals[int(np.argmin(np.abs(stage)))]
    mean = float(reference.mean())
    dark, bright = np.quantile(reference / mean, [0.001, 0.998])
    gain = max((bright - dark) / (_BRIGHT - _DARK), _LEAST_RANGE)
    black = (dark + bright) / 2 - gain * (_DARK + _BRIGHT) / 2
    views = []
    for view, signal in enumerate(signals):
        charged = signal / mean
        charged = charged + faults.charging_streaks(charged, options, seed, view)
        counted = faults.detect(charged, options, seed, view)
        image = faults.digitize(counted, black, black + gain, options, seed, view)
        views.append(_micrograph(image, view, float(stage[view]), options))
    return tuple(views)


def _micrograph(image: ImageArray, view: int, stage_tilt_rad: float, options: SimulationOptions) -> Micrograph:
    """Put an image into its file's clothes: name, data bar, mask, metadata."""
    tilt_deg = float(np.rad2deg(stage_tilt_rad))
    width_um = options.width_px * options.pixel_size_um
    magnification = _POLAROID_WIDTH_UM / width_um
    mask = np.ones(image.shape, dtype=np.bool_)
    if options.data_bar_rows:
        mask[-options.data_bar_rows :] = False
        text = f"{width_um / 5:.3g} um  {_VOLTAGE_KV:g} kV  WD={_WORKING_DISTANCE_UM / 1000:g} mm  T={tilt_deg:.1f}"
        image = faults.burn_data_bar(image, options.data_bar_rows, text, options.width_px // 5)
    metadata = SemMetadata(
        pixel_size_um=options.pixel_size_um,
        tilt_rad=stage_tilt_rad,
        stage_rotation_rad=0.0,
        working_distance_um=_WORKING_DISTANCE_UM,
        accelerating_voltage_kv=_VOLTAGE_KV,
        magnification=magnification,
        scan_rotation_rad=0.0,
        data_bar_rows=options.data_bar_rows,
        vendor="Zeiss",
    )
    known = (
        "pixel_size_um",
        "tilt_rad",
        "stage_rotation_rad",
        "working_distance_um",
        "accelerating_voltage_kv",
        "magnification",
    )
    metadata = replace(metadata, source=dict.fromkeys((*known, "scan_rotation_rad"), "file"))
    return Micrograph(f"view_{view:02d}_{tilt_deg:+06.2f}deg.tif", image, mask, metadata)
