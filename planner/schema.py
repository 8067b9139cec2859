"""What the schemas of all files share: a strict base, and numbers, vectors and names with their ranges."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

Far = Annotated[float, Field(ge=-100_000, le=100_000)]
"""A coordinate [mm]: a cell is not larger than 100 m."""
Angle = Annotated[float, Field(ge=-720, le=720)]
"""An angle [deg]."""
Vector = tuple[Far, Far, Far]
Positive = Annotated[float, Field(ge=0.01, le=100_000)]
"""A length [mm] of a body."""
Fraction = Annotated[float, Field(ge=0, le=1)]
Scale = Annotated[float, Field(gt=0, le=100_000)]
Unit = Literal["mm", "cm", "m", "in", "ft"]
Name = Annotated[
    str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,23}$", description="letter first, at most 24 characters")
]
FileName = Annotated[str, Field(min_length=1, max_length=1000)]


class Strict(BaseModel):
    """Base of every schema: unknown keys and non-finite numbers are refused, values do not change."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
