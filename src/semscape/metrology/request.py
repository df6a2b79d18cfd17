"""What is to be measured, and how its texts are read: places in the image, in px or um."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import get_args

from semscape.errors import BadInputError
from semscape.metrology.grid import Polygon, Region, region_of
from semscape.metrology.level import FormName
from semscape.options import MeasureOptions
from semscape.types import LengthUnit

Line = tuple[float, float, float, float]


@dataclass(frozen=True)
class MeasureRequest:
    """Options, and places in px of the image: x right, y down, the centre of the top-left pixel at (0, 0).

    `profile` and `distance` are lines (x0, y0, x1, y1); `step` and `angle` two regions each; `edges` one or two
    distances along the profile in the map's unit; `region` is the part of the map that is measured, None for all.
    """

    options: MeasureOptions = field(default_factory=MeasureOptions)
    region: Region | Polygon | None = None
    profile: Line | None = None
    edges: tuple[float, ...] = ()
    step: tuple[Region | Polygon, Region | Polygon] | None = None
    angle: tuple[Region | Polygon, Region | Polygon] | None = None
    distance: Line | None = None

    def __post_init__(self) -> None:
        if self.options.level not in get_args(FormName):
            raise BadInputError(f"--level {self.options.level!r} is not one of {', '.join(get_args(FormName))}")
        for flag, value in (
            ("--s-filter-um", self.options.s_filter_um),
            ("--l-filter-um", self.options.l_filter_um),
            ("--outliers", self.options.outlier_sigmas),
        ):
            if not (math.isnan(value) or 0 < value < math.inf):
                raise BadInputError(f"{flag} must be a positive number, got {value}")
        if self.options.s_filter_um >= self.options.l_filter_um:
            raise BadInputError(
                f"--s-filter-um {self.options.s_filter_um:g} must be smaller than --l-filter-um "
                f"{self.options.l_filter_um:g}: nothing would be left between them"
            )
        if self.edges and self.profile is None:
            raise BadInputError("--edges are distances along a profile; give --profile x0,y0,x1,y1 as well")


def parse_line(flag: str, text: str, pixel_size: float, unit: LengthUnit) -> Line:
    """Return x0, y0, x1, y1 in px of a text like "10,20,300,20" (px), "10,20,300,20px" or "1.5,2,40,2um".

    Raises
    ------
    BadInputError
        If the text is not four numbers, or in um for a map without a pixel size.

    Examples
    --------
    >>> parse_line("--profile", "1,2,3,4um", 0.5, "um")
    (2.0, 4.0, 6.0, 8.0)
    """
    numbers, suffix = _numbers(text)
    if len(numbers) != 4:
        raise BadInputError(f"{flag} {text!r} is not x0,y0,x1,y1 in px, or with um at its end, like 1.5,2,40,2um")
    if suffix == "um" and unit != "um":
        raise BadInputError(f"{flag} {text!r} is in um, but the run has no pixel size; give px")
    factor = 1 / pixel_size if suffix == "um" else 1.0
    x0, y0, x1, y1 = (number * factor for number in numbers)
    return x0, y0, x1, y1


def parse_region(flag: str, text: str, pixel_size: float, unit: LengthUnit) -> Region | Polygon:
    """Return the rectangle of a text with two opposite corners (see parse_line), the polygon of one with more.

    Raises
    ------
    BadInputError
        If the text is neither, or in um for a map without a pixel size.

    Examples
    --------
    >>> parse_region("--region", "0,0,8,0,0,8", 0.5, "um")
    Polygon(corners_px=((0.0, 0.0), (8.0, 0.0), (0.0, 8.0)))
    """
    numbers, suffix = _numbers(text)
    if len(numbers) < 6:
        return Region(*parse_line(flag, text, pixel_size, unit))
    if suffix == "um" and unit != "um":
        raise BadInputError(f"{flag} {text!r} is in um, but the run has no pixel size; give px")
    try:
        return region_of([number / pixel_size if suffix == "um" else number for number in numbers])
    except ValueError as error:
        raise BadInputError(f"{flag} {text!r}: {error}") from error


def parse_two_regions(
    flag: str, text: str, pixel_size: float, unit: LengthUnit
) -> tuple[Region | Polygon, Region | Polygon]:
    """Return the two regions of a text like "10,10,90,90;110,10,190,90" (see parse_region)."""
    parts = text.split(";")
    if len(parts) != 2:
        raise BadInputError(f"{flag} {text!r} is not two regions x0,y0,x1,y1;x0,y0,x1,y1")
    first, second = (parse_region(flag, part, pixel_size, unit) for part in parts)
    return first, second


def parse_edges(flag: str, text: str, pixel_size: float, unit: LengthUnit) -> tuple[float, ...]:
    """Return one or two distances in the map's unit of a text like "120" or "120,180" (px), or "12,18um".

    Raises
    ------
    BadInputError
        If the text is not one or two numbers.
    """
    numbers, suffix = _numbers(text)
    if len(numbers) not in (1, 2):
        raise BadInputError(f"{flag} {text!r} is not one edge of a step or the two of a groove, like 120 or 12,18um")
    if suffix == "um" and unit != "um":
        raise BadInputError(f"{flag} {text!r} is in um, but the run has no pixel size; give px")
    return tuple(numbers if suffix == "um" else [number * pixel_size for number in numbers])


def _numbers(text: str) -> tuple[list[float], str]:
    text = text.strip()
    suffix = next((unit for unit in ("um", "px") if text.endswith(unit)), "px")
    try:
        numbers = [float(item) for item in text.removesuffix(suffix).split(",")]
    except ValueError:
        return [], suffix
    return (numbers if all(math.isfinite(number) for number in numbers) else []), suffix
