"""The ``straight_wire`` operation of a problem file: lengths in mm, angles in degrees, speeds in mm/s."""

from __future__ import annotations

import dataclasses
from typing import Annotated, Final, Literal, Self

import numpy as np
from pydantic import Discriminator, Field, Tag, model_validator

from planner.hotwire.hot_wire import HotWireOperation
from planner.problem import Stock
from planner.schema import Angle, Far, Name, Strict
from planner.segments import fold
from planner.units import MM

Side = Literal["left", "right", "front", "back", "bottom", "top"]
SIDES: Final[dict[str, tuple[int, int]]] = {
    "left": (0, 0),
    "right": (0, 1),
    "front": (1, 0),
    "back": (1, 1),
    "bottom": (2, 0),
    "top": (2, 1),
}
"""Axis of the stock frame and end (0 low, 1 high) of each side of the block: left and right lie across x,
front and back across y."""

Axis = Literal["x", "y", "z"]


class _Cut(Strict):
    """What all cuts have."""

    leave: Annotated[
        Literal["onwards", "back"],
        Field(description="how the wire leaves the foam: on the far side, or back through its own slot"),
    ] = "onwards"
    feed_mm_s: Annotated[
        float | None, Field(ge=0.1, le=200, description="of this cut; none: that of the operation")
    ] = None


class SurfaceCut(_Cut):
    """One ruled surface of the part. ``lead``: where the wire comes from, seen from where the cut begins;
    ``last``: which side of the piece is cut last, the one that holds it until then."""

    surface: Name
    lead: Literal["auto"] | tuple[Far, Far, Far] = "auto"
    last: Literal["top", "bottom", "any"] | tuple[Far, Far, Far] = "top"
    reverse: Annotated[bool, Field(description="an open strip from its last ruling to its first")] = False

    @model_validator(mode="after")
    def _directions(self) -> Self:
        for name, way in (("lead", self.lead), ("last", self.last)):
            if not isinstance(way, str) and not any(way):
                raise ValueError(f"{name}: a direction has a length above 0")
        return self


class TrimCut(_Cut):
    """The block's oversize is cut off at the sides named, so that the datum block remains. ``along``: the
    axis that the wire is parallel to."""

    trim: Annotated[tuple[Side, ...], Field(min_length=1, max_length=6)]
    along: Literal["auto"] | Axis = "auto"
    reverse: Annotated[bool, Field(description="the other way through the block")] = False

    @model_validator(mode="after")
    def _each_once(self) -> Self:
        if len(set(self.trim)) != len(self.trim):
            raise ValueError("trim: each side is cut once")
        if any("xyz"[SIDES[side][0]] == self.along for side in self.trim):
            raise ValueError("along: the wire cannot stand across the side that it trims")
        return self


def _cut_kind(value: object) -> str:
    """Which kind of cut is meant, so that its faults are told of that one alone."""
    trims = "trim" in value if isinstance(value, dict) else isinstance(value, TrimCut)
    return "trim" if trims else "surface"


def _cuts_kind(value: object) -> str:
    return "word" if isinstance(value, str) else "list"


AnyCut = Annotated[
    Annotated[SurfaceCut, Tag("surface")] | Annotated[TrimCut, Tag("trim")], Discriminator(_cut_kind)
]
Cuts = Annotated[
    Annotated[Literal["all"], Tag("word")]
    | Annotated[tuple[AnyCut, ...], Field(min_length=1, max_length=200), Tag("list")],
    Discriminator(_cuts_kind),
]


class Straight(HotWireOperation):
    """One arm takes a bow with a straight hot wire along the ruled surfaces of the part. A second arm, where
    it holds the block, moves it."""

    process: Literal["straight_wire"]
    arms: Annotated[
        tuple[Name, ...],
        Field(
            min_length=1, max_length=2, description="the arm with the bow, and the arm that holds the block"
        ),
    ]
    cuts: Annotated[
        Cuts, Field(description="in this order; all: every ruled surface, holes first and outlines last")
    ] = "all"
    wire_material: Annotated[str, Field(max_length=60, description="for the setup sheet")] = ""
    shape_tol_mm: Annotated[float, Field(ge=0.01, le=50)] = 0.3
    left_mm: Annotated[
        float, Field(ge=0, le=100, description="how deep foam may stay where a round wire cannot reach")
    ] = 5.0
    step_mm: Annotated[
        float, Field(ge=0.2, le=50, description="travel of the fastest point between targets")
    ] = 4.0
    margin_mm: Annotated[
        float, Field(ge=1, le=300, description="of the wire's ends, and of the wire in the air, to the block")
    ] = 20.0
    holder: Annotated[
        Literal["full", "turn"],
        Field(description="what a holder may do: all of it, or only turn about its tool's axis"),
    ] = "full"
    move_mm: Annotated[float, Field(ge=0, le=2000, description="how far a holder moves the block")] = 300.0
    tilt_deg: Annotated[Angle, Field(ge=0, le=90, description="how far a holder tilts the block")] = 40.0
    spacers: Annotated[
        bool, Field(description="ask for spacers where what is above a cut would drop by a kerf")
    ] = False
    heat_up_s: Annotated[float, Field(ge=0, le=600)] = 5.0
    cool_down_s: Annotated[float, Field(ge=0, le=600)] = 10.0

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if len(set(self.arms)) != len(self.arms):
            raise ValueError("arms: the bow and the block are held by two different arms")
        if self.cuts != "all":
            if any(cut.feed_mm_s is not None and cut.feed_mm_s < self.feed_min_mm_s for cut in self.cuts):
                raise ValueError("cuts: feed_mm_s of a cut must not be below feed_min_mm_s")
            names = self.segments
            if len({fold(name) for name in names}) != len(names):
                raise ValueError(
                    "cuts: each surface and each side is cut once, and no surface has the name of a side "
                    "that is trimmed (trim_left; case and runs of underscores do not count); drop or rename "
                    "one"
                )
        return self

    @property
    def segments(self) -> tuple[str, ...]:
        """Names of the cuts that are listed, in order: surfaces, and ``trim_<side>`` for sides."""
        if self.cuts == "all":
            return ()
        return tuple(
            name
            for cut in self.cuts
            for name in ([cut.surface] if isinstance(cut, SurfaceCut) else [f"trim_{s}" for s in cut.trim])
        )

    def feed(self, cut: SurfaceCut | TrimCut) -> float:
        """Upper limit [m/s] of the wire's fastest point in the foam during a cut."""
        return (self.feed_mm_s if cut.feed_mm_s is None else cut.feed_mm_s) * MM

    def leaves(self, stock: Stock) -> Stock:
        """The block without the oversize of the sides that were trimmed."""
        oversize = stock.oversize.copy()
        for cut in () if self.cuts == "all" else self.cuts:
            if isinstance(cut, TrimCut):
                for side in cut.trim:
                    axis, end = SIDES[side]
                    oversize[end, axis] = 0.0
        return dataclasses.replace(stock, oversize=oversize) if np.any(oversize != stock.oversize) else stock
