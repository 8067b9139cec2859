"""What operations with a hot wire have in common, bent or straight: its heat, its speeds, its power."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from planner.hotwire.heat import Heat
from planner.schema import Name


class HotWireOperation(Heat):
    """An operation that cuts foam with a hot wire."""

    name: Name
    feed_mm_s: Annotated[
        float, Field(ge=0.1, le=200, description="upper limit of the wire's fastest point in foam")
    ] = 8.0
    feed_min_mm_s: Annotated[float, Field(ge=0, le=200, description="a slower wire burns the foam")] = 3.0
    share: Annotated[
        float, Field(gt=0.5, le=1, description="part of each surface that must be within tolerance")
    ] = 0.95
    signal: Annotated[
        str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,31}$", description="output that powers the wire")
    ] = "doWirePower"

    @model_validator(mode="after")
    def _feeds_in_order(self) -> Self:
        if self.feed_min_mm_s > self.feed_mm_s:
            raise ValueError("feed_min_mm_s must not exceed feed_mm_s")
        return self
