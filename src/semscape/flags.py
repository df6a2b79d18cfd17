"""What the flags of the command line mean: they become options, each checked with the flag's own name."""

from __future__ import annotations

import difflib
import math
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from semscape.errors import BadInputError
from semscape.options import KIND_OF, MeasureOptions, Options, read_toml

if TYPE_CHECKING:
    from semscape.metrology.request import MeasureRequest
    from semscape.simulate import SimulationOptions
    from semscape.types import HeightMap


def effective_options(
    file: Path | None,
    settings: list[str] | None,
    tilts: str | None,
    pixel_size_um: float | None,
    axis_deg: float | None,
    seed: int | None,
    invert_relief: bool | None,
    scale_bar_um: float | None = None,
    keep: str | None = None,
    camera: str | None = None,
    preset: str | None = None,
) -> Options:
    """Return the options: defaults, then the file's, then --set, then the explicit flags."""
    options = Options()
    if file is not None:
        try:
            options = read_toml(file.read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError) as error:
            reason = error.strerror if isinstance(error, OSError) else "it is not text in UTF-8"
            raise BadInputError(f"the options file {file} cannot be read: {reason}") from error
    options = options.with_settings(settings or [])
    return with_flags(options, tilts, pixel_size_um, axis_deg, seed, invert_relief, scale_bar_um, keep, camera, preset)


def with_flags(
    options: Options,
    tilts: str | None = None,
    pixel_size_um: float | None = None,
    axis_deg: float | None = None,
    seed: int | None = None,
    invert_relief: bool | None = None,
    scale_bar_um: float | None = None,
    keep: str | None = None,
    camera: str | None = None,
    preset: str | None = None,
) -> Options:
    """Return options changed by the flags that are given; so the cells of a batch's manifest are read as well."""
    values: dict[str, dict[str, Any]] = {"input": {}, "run": {}, "sfm": {}, "dense": {}}
    if tilts is not None:
        values["input"]["tilts_deg"] = _numbers("--tilts", tilts)
    if pixel_size_um is not None:
        values["input"]["pixel_size_um"] = _positive("--pixel-size-um", pixel_size_um)
    if scale_bar_um is not None:
        values["input"]["scale_bar_um"] = _positive("--scale-bar-um", scale_bar_um)
    if axis_deg is not None:
        if not math.isfinite(axis_deg):
            raise BadInputError(f"--axis-deg must be an angle in deg, got {axis_deg}")
        values["input"]["axis_deg"] = axis_deg
    if seed is not None:
        values["run"]["seed"] = seed
    if invert_relief is not None:
        values["sfm"]["invert_relief"] = invert_relief
    if keep is not None:
        values["dense"]["keep"] = keep
    if camera is not None:
        values["sfm"]["camera"] = camera
    if preset is not None:
        if preset != "thesis":
            raise BadInputError(f"--preset {preset!r} is not known; there is: thesis")
        values["sfm"]["method"] = preset
    return options.with_values(values)


def simulation_options(
    preset: str | None,
    tilts: str | None,
    views: int | None,
    step: float | None,
    size: str | None,
    settings: list[str] | None,
    **given: Any,
) -> SimulationOptions:
    """Return the simulated microscope's settings: a preset, changed by --set, then by the flags that are given.

    `given` holds plain values by the names of the options, None where a flag is left out.
    """
    from semscape.simulate import PRESETS, SimulationOptions

    if preset is not None and preset not in PRESETS:
        raise BadInputError(f"--preset {preset!r} is not known; there are: {', '.join(PRESETS)}")
    options = SimulationOptions() if preset is None else PRESETS[preset]
    changes: dict[str, Any] = _simulation_settings(settings or [], options)
    if tilts is not None:
        if views is not None or step is not None:
            raise BadInputError("--tilts says all about the tilts; leave out --views and --step")
        changes["tilts_deg"] = _numbers("--tilts", tilts)
    elif views is not None or step is not None:
        now = options.tilts_deg
        count = len(now) if views is None else views
        spacing = (max(now) - min(now)) / (len(now) - 1) if step is None else _positive("--step", step)
        changes["tilts_deg"] = tuple(spacing * (i - (count - 1) / 2) for i in range(count))
    if size is not None:
        width, _, height = size.lower().partition("x")
        if not (width.isdecimal() and (height or width).isdecimal()):
            raise BadInputError(f"--size {size!r} is not a size in px, like 512 or 640x480")
        changes |= {"width_px": int(width), "height_px": int(height or width)}
    changes |= {name: value for name, value in given.items() if value is not None}
    options = replace(options, **changes)
    if len(options.tilts_deg) < 2:
        raise BadInputError(f"a tilt series needs at least 2 views, got {len(options.tilts_deg)}")
    return options


def measure_request(
    height_map: HeightMap, places: dict[str, str | None], settings: dict[str, float | str | bool | None]
) -> MeasureRequest:
    """Return what `semscape measure` is asked for: places by flag, settings by option, None if not given."""
    from semscape.metrology.request import MeasureRequest, parse_edges, parse_line, parse_region, parse_two_regions

    parsers = {
        "region": parse_region,
        "profile": parse_line,
        "edges": parse_edges,
        "step": parse_two_regions,
        "angle": parse_two_regions,
        "distance": parse_line,
    }
    pixel_size, unit = height_map.pixel_size_um, height_map.length_unit
    values: dict[str, Any] = {
        name: parsers[name](f"--{name}", text, pixel_size, unit) for name, text in places.items() if text is not None
    }
    given: dict[str, Any] = {name: value for name, value in settings.items() if value is not None}
    return MeasureRequest(options=MeasureOptions(**given), **values)


def _simulation_settings(settings: list[str], options: SimulationOptions) -> dict[str, Any]:
    """Return what `--set KEY=VALUE` says, each value of the kind that its option has."""
    values: dict[str, Any] = {}
    for setting in settings:
        name, equals, text = (part.strip() for part in setting.partition("="))
        kinds = {item.name: type(getattr(options, item.name)) for item in fields(options)}
        if name not in kinds or not equals:
            near = difflib.get_close_matches(name, kinds, 1, 0.0)[0]
            raise BadInputError(f"--set {setting!r}: the form is KEY=VALUE, and the nearest key is {near!r}")
        try:
            values[name] = _numbers("--set", text) if kinds[name] is tuple else kinds[name](text)
        except ValueError:
            raise BadInputError(f"--set {setting!r}: {name} takes {KIND_OF[kinds[name]]}, not {text!r}") from None
    return values


def _numbers(flag: str, text: str) -> tuple[float, ...]:
    try:
        values = tuple(float(item) for item in text.replace(";", ",").split(","))
    except ValueError:
        values = (math.nan,)
    if not all(math.isfinite(value) for value in values):
        raise BadInputError(f"{flag} {text!r} is not a list of numbers separated by commas, like -7,0,7")
    return values


def _positive(flag: str, value: float) -> float:
    if not (math.isfinite(value) and value > 0):
        raise BadInputError(f"{flag} must be a positive number, got {value}")
    return value
