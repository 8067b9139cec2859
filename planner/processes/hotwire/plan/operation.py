"""Schemas of the operations `elastic_wire` and `straight_wire` of a problem file.

Lengths are in mm, angles in degrees, speeds in mm/s. `HotWireOperation` holds the common fields: heat, speeds
and power. `Heat` states how hot the wire is: by the width of the slot, or by the power in a known foam.
"""

import dataclasses
from typing import Annotated, Final, Literal, Self

import numpy as np
from pydantic import Discriminator, Field, Tag, model_validator

from planner.catalogue.materials import FoamMaterial
from planner.claims.segments import fold
from planner.geometry.units import MM
from planner.issues import issue_error
from planner.problem import BentWire, Controller, Stock
from planner.processes.hotwire.claims import KerfCurve
from planner.processes.hotwire.plan.kerf import width
from planner.reading.materials import WireFile
from planner.reading.strict_yaml import Angle, Coordinate, Name, Strict

MAX_AIR_FEED_M_S: Final = 0.1
"""Maximum speed of the wire in air [m/s] by default. A faster hot wire cools and swings."""
MAX_AIR_STEP_M: Final = 0.012
"""Largest move of any point of the wire between targets in air [m]."""
KERF_SPEED_RANGE_M_S: Final = (1e-3, 50e-3)
"""Range of speeds [m/s] of a kerf curve.

A slower wire counts as 1 mm/s, because a wire at rest would melt without bound.
"""
RESTING_COSINE: Final = 0.7
"""Material above a slot rests on it if the cosine of the slot's tilt exceeds this."""


class Heat(Strict):
    """Width of the slot: ``kerf_mm``, constant at every speed, or ``power_w``.

    ``power_w`` is the power over the whole length of the wire. With it the width follows from the local speed
    and the foam of the stock.
    """

    kerf_mm: Annotated[float, Field(ge=0, le=20, description="width of the slot")] | None = None
    power_w: Annotated[float, Field(gt=0, le=5000, description="over the wire's whole length")] | None = None
    kerf_range_mm: tuple[Annotated[float, Field(gt=0, le=20)], Annotated[float, Field(gt=0, le=20)]] = Field(
        default=(width.USABLE_KERF_RANGE_M[0] / MM, width.USABLE_KERF_RANGE_M[1] / MM),
        description="slots that leave usable faces, where power_w is given",
    )

    @model_validator(mode="after")
    def _one_heat(self) -> "Heat":
        if (self.kerf_mm is None) == (self.power_w is None):
            raise ValueError("give either kerf_mm, the width of the slot, or power_w")
        if self.kerf_range_mm[0] >= self.kerf_range_mm[1]:
            raise ValueError("kerf_range_mm is [lower, upper] with lower < upper")
        return self

    def kerf_curve(
        self, foam: FoamMaterial | None, diameter: float, length: float, thickness: float
    ) -> KerfCurve:
        """Return the kerf as a function of the local speed.

        Args:
            foam: Foam of the stock.
            diameter: Diameter of the wire [m].
            length: Heated length of the wire [m].
            thickness: Thickness of the foam along the wire [m].

        Raises:
            TandemError: stock.foam_missing, kerf.no_data, kerf.input.
        """
        if self.kerf_mm is not None:
            return KerfCurve.constant(self.kerf_mm * MM)
        if self.power_w is None or foam is None:
            message = "power_w is given, but the kerf depends on the foam, which is not stated; state "
            message += "stock.foam, or give kerf_mm instead"
            raise issue_error("stock.foam_missing", message, field="stock.foam")
        wire = width.HotWire(diameter, length)
        return width.curve(foam, wire, self.power_w, thickness, np.array(KERF_SPEED_RANGE_M_S))


class HotWireOperation(Heat):
    """An operation that cuts foam with a hot wire."""

    name: Name
    feed_mm_s: float = Field(
        default=8.0, ge=0.1, le=200, description="upper limit of the wire's fastest point in foam"
    )
    feed_min_mm_s: float = Field(default=3.0, ge=0, le=200, description="a slower wire burns the foam")
    share: float = Field(
        default=0.95, gt=0.5, le=1, description="fraction of each surface that must be within tolerance"
    )
    signal: str = Field(
        default=Controller.wire_signal,
        pattern=r"^[A-Za-z][A-Za-z0-9_]{0,31}$",
        description="output that powers the wire",
    )

    @model_validator(mode="after")
    def _feeds_in_order(self) -> Self:
        if self.feed_min_mm_s > self.feed_mm_s:
            raise ValueError("feed_min_mm_s must not exceed feed_mm_s")
        return self


Face = Literal["front", "back"]


class ElasticWire(HotWireOperation):
    """Two arms bend one hot wire and sweep it through the block along the faces of the part."""

    process: Literal["elastic_wire"]
    arms: tuple[Name, Name] = Field(description="the arm at the wire's start, the arm at its end")
    wire: WireFile | None = Field(
        default=None, description="none: the planner tries the wires of the cell and chooses one"
    )
    faces: tuple[Face, ...] = Field(default=("front", "back"), min_length=1, max_length=2)
    runs: Literal["one", "two"] = Field(
        default="one", description="one: there and back; two: both faces in the same direction"
    )
    sweep: Literal["auto", "x", "y"] | Annotated[float, Field(ge=-360, le=360)] = Field(
        default="auto",
        description="direction across the wire, horizontal in the block; a number is degrees from x",
    )
    sections: Literal["auto", "parallel", "normal"] = Field(
        default="auto",
        description="planes upright and parallel, or normal to the face's spine; auto: normal for a strip",
    )
    shape_tol_mm: float = Field(default=0.5, ge=0.01, le=50)
    end_error_mm: float = Field(
        default=0.05, ge=0, le=5, description="position error of each wire end in reality"
    )
    step_mm: float = Field(
        default=3.0, ge=0.2, le=50, description="travel of the fastest point between targets"
    )
    margin_mm: float = Field(
        default=20.0, ge=1, le=300, description="distance of wire ends, and of wire in air, from the block"
    )
    slack_mm: float = Field(
        default=20.0, ge=0, le=500, description="how far the wire may slide along itself, in each direction"
    )
    heat_up_s: float = Field(default=10.0, ge=0, le=600)
    cool_down_s: float = Field(default=30.0, ge=0, le=600)

    def leaves(self, stock: Stock) -> Stock:
        """Return the stock unchanged. Pieces that are cut off stay in their place."""
        return stock

    @model_validator(mode="after")
    def _consistent(self) -> "ElasticWire":
        if self.arms[0] == self.arms[1]:
            raise ValueError("arms: two different arms hold the wire's ends")
        if len(set(self.faces)) != len(self.faces):
            raise ValueError("faces: each face is cut once")
        if self.power_w is not None and self.wire is not None and not self.wire.is_round:
            raise ValueError("power_w: the kerf of strips is not known; give kerf_mm")
        return self

    @property
    def chosen_wire(self) -> WireFile:
        """The stated wire.

        Raises:
            ValueError: If the operation leaves the wire open and none is chosen yet.
        """
        if self.wire is None:
            raise ValueError(f"{self.name}: no wire is chosen yet")
        return self.wire

    @property
    def sweep_degrees(self) -> float | None:
        """Direction of the sweep [deg from x], or None if it is to be chosen."""
        return {"x": 0.0, "y": 90.0, "auto": None}[self.sweep] if isinstance(self.sweep, str) else self.sweep

    @property
    def sweep_label(self) -> str:
        """Direction of the sweep in words."""
        labels = {None: "any direction", 0.0: "x", 90.0: "y"}
        return labels.get(self.sweep_degrees, f"{self.sweep} deg from x")

    def candidate_wires(self, available: tuple[BentWire, ...]) -> tuple[WireFile, ...]:
        """Return the wires that may cut: the stated one, or those in the cell whose kerf is known.

        Args:
            available: Wires that the cell file lists.
        """
        if self.wire is not None:
            return (self.wire,)
        wires = map(WireFile.from_wire, available)
        return tuple(wire for wire in wires if wire.is_round or self.power_w is None)

    def with_wire(self, wire: WireFile, sweep: float | None = None) -> "ElasticWire":
        """Return this operation with a given wire and, if given, a sweep direction [deg from x]."""
        changes: dict[str, object] = {"wire": wire}
        if sweep is not None:
            changes["sweep"] = sweep
        return self.model_copy(update=changes)

    @property
    def has_normal_sections(self) -> bool:
        """Whether sections are normal to the spine of the face.

        By default they are for a strip, because its width has to follow the sweep.
        """
        return self.sections == "normal" or (self.sections == "auto" and not self.chosen_wire.is_round)


Side = Literal["left", "right", "front", "back", "bottom", "top"]
BLOCK_SIDES: Final[dict[str, tuple[int, int]]] = {
    "left": (0, 0),
    "right": (0, 1),
    "front": (1, 0),
    "back": (1, 1),
    "bottom": (2, 0),
    "top": (2, 1),
}
"""Axis of the stock frame and end (0 low, 1 high) of each side of the stock.

``left`` and ``right`` bound x, ``front`` and ``back`` bound y.
"""

Axis = Literal["x", "y", "z"]


class _WireCut(Strict):
    """Fields that all cuts have."""

    leave: Literal["onwards", "back"] = Field(
        default="onwards",
        description="how the wire leaves the foam: on the far side, or back through its own slot",
    )
    feed_mm_s: float | None = Field(
        default=None, ge=0.1, le=200, description="feed of this cut; none: feed of the operation"
    )


class SurfaceCut(_WireCut):
    """One ruled surface of the part.

    ``lead``: direction from which the wire comes, seen from the start of the cut. ``last``: side of the piece
    that is cut last and holds it until then.
    """

    surface: Name
    lead: Literal["auto"] | tuple[Coordinate, Coordinate, Coordinate] = "auto"
    last: Literal["top", "bottom", "any"] | tuple[Coordinate, Coordinate, Coordinate] = "top"
    reverse: bool = Field(default=False, description="cut an open strip from its last ruling to its first")

    @model_validator(mode="after")
    def _directions(self) -> Self:
        for name, direction in (("lead", self.lead), ("last", self.last)):
            if not isinstance(direction, str) and not any(direction):
                raise ValueError(f"{name}: the length of a direction must be above 0")
        return self


class TrimCut(_WireCut):
    """Cut off the oversize of the block at the named sides, so that the datum block remains.

    ``along``: axis that the wire is parallel to.
    """

    trim: tuple[Side, ...] = Field(min_length=1, max_length=6)
    along: Literal["auto"] | Axis = "auto"
    reverse: bool = Field(default=False, description="cut in the opposite direction through the block")

    @model_validator(mode="after")
    def _each_once(self) -> Self:
        if len(set(self.trim)) != len(self.trim):
            raise ValueError("trim: each side is cut once")
        if any("xyz"[BLOCK_SIDES[side][0]] == self.along for side in self.trim):
            raise ValueError("along: the wire cannot be normal to the side that it trims")
        return self


def _cut_kind(value: object) -> str:
    """Return which kind of cut is meant, so that validation errors are reported for that kind alone."""
    trims = "trim" in value if isinstance(value, dict) else isinstance(value, TrimCut)
    return "trim" if trims else "surface"


def _cuts_kind(value: object) -> str:
    """Return whether ``cuts`` is a word or a list, so that errors are reported for that form alone."""
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
    """One arm moves a bow with a straight hot wire along the ruled surfaces of the part.

    A second arm, if it holds the block, moves it.
    """

    process: Literal["straight_wire"]
    arms: tuple[Name, ...] = Field(
        min_length=1, max_length=2, description="the arm with the bow, and the arm that holds the block"
    )
    cuts: Cuts = Field(
        default="all", description="in this order; all: every ruled surface, holes first and outlines last"
    )
    wire_material: str = Field(default="", max_length=60, description="for the setup sheet")
    shape_tol_mm: float = Field(default=0.3, ge=0.01, le=50)
    left_mm: float = Field(
        default=5.0, ge=0, le=100, description="depth of foam that may remain where a round wire cannot reach"
    )
    step_mm: float = Field(
        default=4.0, ge=0.2, le=50, description="travel of the fastest point between targets"
    )
    margin_mm: float = Field(
        default=20.0, ge=1, le=300, description="distance of wire ends, and of wire in air, from the block"
    )
    air_feed_mm_s: float = Field(
        default=MAX_AIR_FEED_M_S / MM,
        ge=1,
        le=1000,
        description="speed of the wire in air between cuts; a faster wire cools and swings",
    )
    holder: Literal["full", "turn"] = Field(
        default="full", description="motion of a holder: any, or only rotation about its tool's axis"
    )
    move_mm: float = Field(default=300.0, ge=0, le=2000, description="how far a holder moves the block")
    tilt_deg: Annotated[Angle, Field(ge=0, le=90, description="how far a holder tilts the block")] = 40.0
    spacers: bool = Field(
        default=False, description="ask for spacers where the material above a cut would drop by a kerf"
    )
    heat_up_s: float = Field(default=5.0, ge=0, le=600)
    cool_down_s: float = Field(default=10.0, ge=0, le=600)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        """Require that the fields do not contradict one another."""
        if len(set(self.arms)) != len(self.arms):
            raise ValueError("arms: the bow and the block are held by two different arms")
        if self.cuts != "all":
            if any(cut.feed_mm_s is not None and cut.feed_mm_s < self.feed_min_mm_s for cut in self.cuts):
                raise ValueError("cuts: feed_mm_s of a cut must not be below feed_min_mm_s")
            names = self.segments
            if len({fold(name) for name in names}) != len(names):
                raise ValueError(
                    "cuts: each surface and each side is cut once, and no surface may have the name of a "
                    "trimmed side (trim_left; case and repeated underscores are ignored); drop or rename one"
                )
        return self

    @property
    def segments(self) -> tuple[str, ...]:
        """Names of the listed cuts, in order: surfaces, and ``trim_<side>`` for sides."""
        if self.cuts == "all":
            return ()
        return tuple(
            name
            for cut in self.cuts
            for name in ([cut.surface] if isinstance(cut, SurfaceCut) else [f"trim_{s}" for s in cut.trim])
        )

    def feed(self, cut: SurfaceCut | TrimCut) -> float:
        """Return the maximum speed [m/s] of the fastest point of the wire in foam during a cut."""
        return (self.feed_mm_s if cut.feed_mm_s is None else cut.feed_mm_s) * MM

    def leaves(self, stock: Stock) -> Stock:
        """Return the stock after the operation: without the oversize of the trimmed sides."""
        oversize = stock.oversize.copy()
        for cut in () if self.cuts == "all" else self.cuts:
            if isinstance(cut, TrimCut):
                for side in cut.trim:
                    axis, end = BLOCK_SIDES[side]
                    oversize[end, axis] = 0.0
        return dataclasses.replace(stock, oversize=oversize) if np.any(oversize != stock.oversize) else stock
