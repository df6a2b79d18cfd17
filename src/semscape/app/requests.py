"""What the page sends, as FastAPI reads it; everything else is refused before a route sees it."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from semscape.options import ConvertOptions, MeasureOptions

Finite = Annotated[float, Field(allow_inf_nan=False, ge=-1e12, le=1e12)]
Line = Annotated[list[Finite], Field(min_length=4, max_length=4, description="x0, y0, x1, y1 in px of the image")]
Area = Annotated[
    list[Finite],
    Field(min_length=4, max_length=400, description="opposite corners of a rectangle, or all of a polygon: x, y in px"),
]


class _Body(BaseModel):
    model_config = ConfigDict(extra="forbid")


class NewRun(_Body):
    """What a run is called."""

    title: str = Field(min_length=1, max_length=200)


class CellEdit(_Body):
    """A cell to fill; null empties it. An empty image means the whole series."""

    image: str = Field("", max_length=300)
    key: str = Field(max_length=40)
    value: bool | Finite | None


class ReconstructRequest(_Body):
    """Options of the run, as `--set` takes them."""

    settings: list[Annotated[str, Field(max_length=200)]] = Field(default_factory=list, max_length=40)


class MeasureQuestion(_Body):
    """What to measure; what is left out is as `semscape measure` has it."""

    level: Literal["plane", "poly2", "poly3", "poly4", "sphere", "none"] = "plane"
    robust: bool = False
    s_filter_um: Annotated[float, Field(gt=0, le=1e9)] | None = None
    l_filter_um: Annotated[float, Field(gt=0, le=1e9)] | None = None
    outlier_sigmas: Annotated[float, Field(gt=0, le=1e6)] | None = None
    volume_level_um: Finite = 0.0
    region: Area | None = None
    profile: Line | None = None
    distance: Line | None = None
    step: Annotated[list[Area], Field(min_length=2, max_length=2)] | None = None
    angle: Annotated[list[Area], Field(min_length=2, max_length=2)] | None = None
    edges: Annotated[list[Finite], Field(max_length=2)] = Field(default_factory=list)

    def settings(self) -> dict[str, Any]:
        """Return the options."""
        names = MeasureOptions.__dataclass_fields__.keys() & type(self).model_fields.keys()
        values = {name: getattr(self, name) for name in sorted(names)}
        return {name: math.nan if value is None else value for name, value in values.items()}

    def places(self) -> dict[str, Any]:
        """Return where to measure."""
        names = ("region", "profile", "distance", "step", "angle", "edges")
        return {name: getattr(self, name) for name in names if getattr(self, name)}


def convert_settings(unit: str | None, color: str | None) -> dict[str, Any]:
    """Return the options of `semscape convert` that the page offers, checked.

    Raises
    ------
    BadInputError
        For an unknown unit.
    """
    given = {"unit": unit, "color": color}
    settings = {name: value for name, value in given.items() if value is not None}
    ConvertOptions(**settings)  # type: ignore[arg-type]
    return settings
