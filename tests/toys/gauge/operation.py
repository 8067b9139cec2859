"""The operation: a circle above the block."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from planner.problem import Stock
from planner.reading.strict_yaml import Name, Strict


class Ring(Strict):
    """A circle of ``radius_mm`` about the middle of the block's top, ``height_mm`` above it.

    The tip of the gauge must stay at least ``least_mm`` above the block.
    """

    name: Name
    process: Literal["ring"]
    arms: Annotated[tuple[str, ...], Field(min_length=1, max_length=1)]
    radius_mm: Annotated[float, Field(gt=0)]
    height_mm: float
    least_mm: float
    feed_mm_s: Annotated[float, Field(gt=0)]

    def leaves(self, stock: Stock) -> Stock:
        """Return the block unchanged."""
        return stock
