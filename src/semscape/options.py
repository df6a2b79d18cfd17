"""One frozen dataclass of options per stage; the only place with defaults.

Angles are in degrees here and in the options files, in radians everywhere else. `read_toml` and `to_toml`
turn options into text and back; an unknown key is an error that names the nearest valid one, a value out of
range one that names the range.
"""

from __future__ import annotations

import difflib
import math
import sys
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, NamedTuple

from semscape.errors import BadInputError


class _Range(NamedTuple):
    """Allowed values: from `least` to `most`, or above `least` where that itself is not one of them."""

    least: float
    most: float = math.inf
    above: bool = False

    def __contains__(self, value: Any) -> bool:
        return (
            math.isfinite(value) and (self.least < value if self.above else self.least <= value) and value <= self.most
        )

    def __str__(self) -> str:
        lower = f"{'>' if self.above else '>='} {self.least:g}"
        return lower if math.isinf(self.most) else f"{lower} and <= {self.most:g}"


KIND_OF = {int: "a whole number", float: "a number", str: "a word", bool: "true or false", tuple: "a list of numbers"}
"""How messages name the kinds of values that options have."""

_POSITIVE = _Range(0, above=True)
# Less than its overlap a tile is not worth.
_SMALLEST_TILE_PX = 64
# Those of [input] are checked by `semscape.io.acquisition`, whose messages name the images and files.
_RANGES = {
    "features.contrast_threshold": _POSITIVE,
    "features.normalization_sigma_px": _POSITIVE,
    "features.max_keypoints": _Range(100),
    "features.pair_reach": _Range(0),
    "features.ratio": _Range(0, 1, above=True),
    "features.significance_keep": _Range(0, 1, above=True),
    "features.significance_threshold": _Range(0, 1),
    "robust.max_trials": _Range(10),
    "robust.min_inliers": _Range(8),
    "sfm.prior_tilt_deg": _POSITIVE,
    "sfm.prior_roll_deg": _POSITIVE,
    "sfm.prior_scale": _POSITIVE,
    "sfm.prior_anisotropy": _POSITIVE,
    "sfm.max_tilt_deg": _Range(0, 80, above=True),
    "sfm.de_generations": _Range(1),
    "sfm.de_population_per_variable": _Range(2),
    "sfm.de_tolerance": _Range(0),
    "sfm.max_iterations": _Range(1),
    "sfm.scan_drift_degree": _Range(0, 12),
    "dense.max_pairs": _Range(1),
    "dense.census_radius_px": _Range(1, 3),
    # Eight paths of at most 48 bits and a jump are summed in 16 bits.
    "dense.penalty_small": _Range(0, 8000, above=True),
    "dense.penalty_large": _Range(0, 8000, above=True),
    "dense.left_right_limit_px": _POSITIVE,
    "dense.mesh_max_vertices": _Range(4),
    "dense.tile_px": _Range(0),
    "mesh.triangles": _Range(0),
    "mesh.error_um": _Range(0),
    "mesh.texture_px": _Range(16),
    "run.seed": _Range(0),
}
# Checked where text becomes options; in Python an unknown detector is misuse, see `semscape.features.detect`.
_CHOICES = {
    "features.detector": ["sift", "surf", "orb", "brief"],
    "robust.model": ["affine", "fundamental", "homography", "essential", "auto"],
    "sfm.camera": ["orthographic", "perspective", "auto"],
    "sfm.method": ["series", "thesis"],
    "dense.keep": ["all", "specimen"],
    "sfm.de_strategy": ["best1bin", "rand1bin"],
    "features.significance_by": ["model", "response", "scale"],
}


class _Stage:
    """What the options of every stage share: their values are checked when they are made."""

    def __post_init__(self) -> None:
        stage = type(self).__name__.removesuffix("Options").lower()
        for key, value in vars(self).items():
            allowed = _RANGES.get(f"{stage}.{key}")
            if allowed is not None and value not in allowed:
                raise BadInputError(f"option {stage}.{key} is {value:.12g}, must be {allowed}")


@dataclass(frozen=True)
class InputOptions:
    """What the user says about the images; it overrides the files. Empty and NaN mean: take it from the files."""

    tilts_deg: tuple[float, ...] = ()
    pixel_size_um: float = math.nan
    axis_deg: float = math.nan
    scale_bar_um: float = math.nan


@dataclass(frozen=True)
class FeaturesOptions(_Stage):
    """Keypoints: detector, contrast threshold after local normalization, and the matching rules.

    Where there are more than `max_keypoints`, the strongest are kept, or with `spread` those that are the
    strongest within the largest radius about them. `guided` adds a second pass along the epipolar lines.
    `pair_reach` matches each view with so many next ones in tilt, and with some far ones for loops; 0 is all pairs.

    `significance_keep` is the share of each image's keypoints that are matched, chosen by `significance_by`: a trained
    model, the response or the scale; with the model none below the probability `significance_threshold`.
    `significance_model` is a file of `semscape train`, the model that ships with semscape where it is empty.
    """

    detector: str = "sift"
    contrast_threshold: float = 0.01
    normalization_sigma_px: float = 16.0
    max_keypoints: int = 40_000
    spread: bool = False
    ratio: float = 0.8
    guided: bool = False
    pair_reach: int = 0
    significance_keep: float = 1.0
    significance_threshold: float = 0.0
    significance_by: str = "model"
    significance_model: str = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.significance_threshold > 0 and self.significance_by != "model":
            raise BadInputError(
                f"option features.significance_threshold is {self.significance_threshold:g}, a probability of the "
                f"model, and features.significance_by is {self.significance_by}; set significance_keep instead"
            )

    @property
    def selects(self) -> bool:
        """Whether some keypoints may be left out before matching."""
        return self.significance_keep < 1 or self.significance_threshold > 0


@dataclass(frozen=True)
class RobustOptions(_Stage):
    """A contrario RANSAC per pair: the model, most trials, and the least number of inliers to keep a pair.

    `limit_parallax` drops inliers of the affine model that stand far out of the relief of the others.
    """

    model: str = "affine"
    limit_parallax: bool = False
    max_trials: int = 10_000
    min_inliers: int = 24


@dataclass(frozen=True)
class SfmOptions(_Stage):
    """Motion of the series: priors (1 sigma), Differential Evolution and bundle adjustment.

    `prior_tilt_deg` is the trust in a stage tilt that is known. The search ends after `de_generations`, or where the
    population's costs differ by less than `de_tolerance`, relatively. `camera` is "orthographic", "perspective", or
    "auto": both are fitted and an information criterion chooses. `invert_relief` mirrors a self-calibrated series whose
    sign nothing but the shading fixes. `scan_drift_degree` is that of the polynomials over the rows that take the
    drift of each scan out, where they explain it; below 2 none are. `method` "thesis" takes the tilts from the textbook
    route, the baseline that the default is compared with.
    """

    prior_tilt_deg: float = 0.1
    prior_roll_deg: float = 0.5
    prior_scale: float = 0.002
    prior_anisotropy: float = 0.001
    max_tilt_deg: float = 40.0
    de_generations: int = 120
    de_population_per_variable: int = 8
    de_strategy: str = "best1bin"
    de_tolerance: float = 1e-6
    max_iterations: int = 50
    scan_drift_degree: int = 6
    method: str = "series"
    camera: str = "orthographic"
    invert_relief: bool = False


@dataclass(frozen=True)
class DenseOptions(_Stage):
    """Dense surface: how many pairs to match, the census window, SGM penalties and the acceptance limits.

    Fields whose sides are longer than 4/3 `tile_px` are computed in tiles with overlap, so that memory does not grow
    with them; 0 is one piece. `keep` is "all" or "specimen": without what lies on the background stub. `shading` lets
    brightness tell fine slopes, as far as the series itself shows that it does.
    """

    max_pairs: int = 4
    census_radius_px: int = 3
    penalty_small: float = 4.0
    penalty_large: float = 24.0
    left_right_limit_px: float = 1.0
    mesh_max_vertices: int = 400_000
    tile_px: int = 768
    keep: str = "all"
    shading: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.penalty_small > self.penalty_large:
            raise BadInputError(
                f"option dense.penalty_small is {self.penalty_small:g}, must be <= dense.penalty_large, "
                f"{self.penalty_large:g}"
            )
        if 0 < self.tile_px < _SMALLEST_TILE_PX:
            raise BadInputError(f"option dense.tile_px is {self.tile_px}, must be 0 or >= {_SMALLEST_TILE_PX}")


@dataclass(frozen=True)
class MeshOptions(_Stage):
    """Mesh: come down to so many `triangles`, or stay within `error_um` (px without a pixel size) of all; 0 is no wish.

    `texture_px` is the longest side of the micrograph on the mesh: many viewers show no larger ones.
    """

    triangles: int = 0
    error_um: float = 0.0
    texture_px: int = 4096


@dataclass(frozen=True)
class RunOptions(_Stage):
    """The seed from which every random stream of a run derives."""

    seed: int = 0


@dataclass(frozen=True)
class MeasureOptions:
    """`semscape measure`, no stage of a run: form to take off, filters, outliers, draws of the Monte Carlo.

    Nesting indices are in um (px for a run without a pixel size); NaN means no filter, or outliers are kept.
    """

    level: str = "plane"
    robust: bool = False
    s_filter_um: float = math.nan
    l_filter_um: float = math.nan
    outlier_sigmas: float = math.nan
    volume_level_um: float = 0.0
    draws: int = 60
    seed: int = 0


@dataclass(frozen=True)
class ConvertOptions:
    """`semscape convert`, no stage of a run: how surfaces, prints and stereo pictures are written.

    `unit` is that of meshes, "um", "mm" or "nm"; empty means the run's own. `color` is "micrograph" or a colour map of
    matplotlib. `print_scale` is the magnification of the printed body; NaN means that its plate's longest side gets
    `print_size_mm`. The stereo picture takes the two views whose tilts differ by what is closest to `stereo_angle_deg`:
    two eyes 65 mm apart look at a page half a metre away under 7 deg.
    """

    unit: str = ""
    color: str = "micrograph"
    max_vertices: int = 400_000
    print_scale: float = math.nan
    print_size_mm: float = 100.0
    base_mm: float = 2.0
    stereo_angle_deg: float = 7.0

    def __post_init__(self) -> None:
        if self.unit not in {"", "um", "mm", "nm"}:
            raise BadInputError(f"--unit {self.unit!r} is not known; there are um, mm and nm")
        for flag, value in (
            ("--max-vertices", max(self.max_vertices - 3, 0)),
            ("--print-size-mm", self.print_size_mm),
            ("--base-mm", self.base_mm),
            ("--print-scale", 1.0 if math.isnan(self.print_scale) else self.print_scale),
        ):
            if not 0 < value < math.inf:
                raise BadInputError(f"{flag} must be a positive number, and --max-vertices at least 4")


@dataclass(frozen=True)
class Options:
    """All options of a run.

    Examples
    --------
    >>> Options().with_settings(["sfm.prior_tilt_deg=0.2"]).sfm.prior_tilt_deg
    0.2
    """

    input: InputOptions = field(default_factory=InputOptions)
    features: FeaturesOptions = field(default_factory=FeaturesOptions)
    robust: RobustOptions = field(default_factory=RobustOptions)
    sfm: SfmOptions = field(default_factory=SfmOptions)
    dense: DenseOptions = field(default_factory=DenseOptions)
    mesh: MeshOptions = field(default_factory=MeshOptions)
    run: RunOptions = field(default_factory=RunOptions)

    def with_settings(self, settings: list[str]) -> Options:
        """Return options with `stage.key=value` texts applied, values in TOML syntax.

        Raises
        ------
        BadInputError
            For a setting without "=", an unknown key, or a value of the wrong type or out of range.
        """
        tables: dict[str, dict[str, Any]] = {}
        for setting in settings:
            name, equals, text = setting.partition("=")
            if not equals or "." not in name:
                raise BadInputError(
                    f"--set {setting!r} is not of the form stage.key=value, like sfm.prior_tilt_deg=0.1"
                )
            stage, key = (part.strip() for part in name.split(".", 1))
            try:
                value = tomllib.loads(f"value = {text}")["value"]
            except (ValueError, RecursionError):
                value = text.strip()
            tables.setdefault(stage, {})[key.replace("significance.", "significance_")] = value
        return self.with_values(tables)

    def with_values(self, tables: Mapping[str, Mapping[str, Any]]) -> Options:
        """Return options with the values of nested tables, as a TOML file holds them, put in.

        Raises
        ------
        BadInputError
            For an unknown stage or key, or a value of the wrong type or out of range.
        """
        stages: dict[str, Any] = {}
        for stage, values in tables.items():
            _require_known(stage, [spec.name for spec in fields(self)], "options have no stage")
            current = getattr(self, stage)
            if not isinstance(values, Mapping):
                raise BadInputError(f"options: [{stage}] must be a table of keys, got {values!r}")
            known = [spec.name for spec in fields(current)]
            checked = {}
            for key, value in values.items():
                _require_known(key, known, f"options stage [{stage}] has no key")
                checked[key] = _coerce(f"{stage}.{key}", getattr(current, key), value)
            stages[stage] = replace(current, **checked)
        return replace(self, **stages)

    def to_dict(self) -> dict[str, dict[str, Any]]:
        """Return nested plain dicts, one per stage."""
        return asdict(self)

    def to_toml(self) -> str:
        """Return the options as TOML text that `read_toml` reads back to equal options."""
        lines: list[str] = []
        for stage, values in self.to_dict().items():
            lines.append(f"[{stage}]")
            lines += [f"{key} = {_toml_value(value)}" for key, value in values.items()]
            lines.append("")
        return "\n".join(lines)


def read_toml(text: str) -> Options:
    """Return the options that a TOML text holds, defaults for what it leaves out.

    Raises
    ------
    BadInputError
        For text that is not TOML, an unknown key, or a value of the wrong type or out of range.
    """
    try:
        tables = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise BadInputError(f"the options file is not valid TOML: {error}") from error
    return Options().with_values(tables)


def _require_known(name: str, known: list[str], complaint: str) -> None:
    if name not in known:
        nearest = difflib.get_close_matches(name, known, n=1, cutoff=0.0)[0]
        raise BadInputError(f"{complaint} {name!r}; the nearest one is {nearest!r} (all: {', '.join(known)})")


def _coerce(name: str, default: Any, value: Any) -> Any:
    if isinstance(default, bool):
        if isinstance(value, bool):
            return value
    elif isinstance(default, tuple):
        if isinstance(value, list | tuple) and all(_is_number(item) for item in value):
            return tuple(float(item) for item in value)
    elif isinstance(default, int):
        if isinstance(value, int) and not isinstance(value, bool):
            return value
    elif isinstance(default, float):
        if _is_number(value):
            return float(value)
    elif isinstance(value, str):
        if name in _CHOICES:
            _require_known(value, _CHOICES[name], f"option {name} has no choice")
        return value
    raise BadInputError(f"option {name} takes {KIND_OF[type(default)]}, got {value!r}")


def _is_number(value: Any) -> bool:
    if isinstance(value, int):  # TOML's integers may be larger than any float
        return not isinstance(value, bool) and abs(value) <= sys.float_info.max
    return isinstance(value, float)


def _toml_value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, tuple | list):
        return "[" + ", ".join(_toml_value(item) for item in value) + "]"
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    return repr(value)
