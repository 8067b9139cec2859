"""The ``elastic_wire`` operation of a problem file: lengths in mm, angles in degrees, speeds in mm/s."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from planner.hotwire.hot_wire import HotWireOperation
from planner.problem import Stock
from planner.schema import Name
from planner.wire_file import WireFile

Face = Literal["front", "back"]


class ElasticWire(HotWireOperation):
    """Two arms bend one hot wire and sweep it through the block along the faces of the part."""

    process: Literal["elastic_wire"]
    arms: Annotated[tuple[Name, Name], Field(description="the arm at the wire's start, the arm at its end")]
    wire: Annotated[
        WireFile | None, Field(description="none: one of the cell's wires, chosen by trying them")
    ] = None
    faces: Annotated[tuple[Face, ...], Field(min_length=1, max_length=2)] = ("front", "back")
    runs: Annotated[
        Literal["one", "two"], Field(description="one: there and back; two: both faces in the same direction")
    ] = "one"
    sweep: Annotated[
        Literal["auto", "x", "y"] | Annotated[float, Field(ge=-360, le=360)],
        Field(description="direction across the wire, horizontal in the block; a number is degrees from x"),
    ] = "auto"
    sections: Annotated[
        Literal["auto", "parallel", "normal"],
        Field(
            description="planes upright and parallel, or normal to the face's spine; auto: normal for a strip"
        ),
    ] = "auto"
    shape_tol_mm: Annotated[float, Field(ge=0.01, le=50)] = 0.5
    end_error_mm: Annotated[
        float, Field(ge=0, le=5, description="how far each wire end may be off in reality")
    ] = 0.05
    step_mm: Annotated[
        float, Field(ge=0.2, le=50, description="travel of the fastest point between targets")
    ] = 3.0
    margin_mm: Annotated[
        float, Field(ge=1, le=300, description="of wire ends, and of the wire in air, to the block")
    ] = 20.0
    slack_mm: Annotated[
        float, Field(ge=0, le=500, description="how far the wire may slide along itself, either way")
    ] = 20.0
    heat_up_s: Annotated[float, Field(ge=0, le=600)] = 10.0
    cool_down_s: Annotated[float, Field(ge=0, le=600)] = 30.0

    def leaves(self, stock: Stock) -> Stock:
        """The block as it was: what is cut stays in its place."""
        return stock

    @model_validator(mode="after")
    def _consistent(self) -> ElasticWire:
        if self.arms[0] == self.arms[1]:
            raise ValueError("arms: two different arms hold the wire's ends")
        if len(set(self.faces)) != len(self.faces):
            raise ValueError("faces: each face is cut once")
        if self.power_w is not None and self.wire is not None and not self.wire.is_round:
            raise ValueError("power_w: the kerf of strips is not known; give kerf_mm")
        return self

    @property
    def chosen(self) -> WireFile:
        """The wire; an operation that leaves it open has none before it is chosen."""
        if self.wire is None:
            raise ValueError(f"{self.name}: no wire is chosen yet")
        return self.wire

    @property
    def degrees(self) -> float | None:
        """Direction of the sweep [deg from x]; None: it is chosen."""
        return {"x": 0.0, "y": 90.0, "auto": None}[self.sweep] if isinstance(self.sweep, str) else self.sweep

    @property
    def way(self) -> str:
        """The sweep as people say it."""
        known = {None: "any direction", 0.0: "x", 90.0: "y"}
        return known.get(self.degrees, f"{self.sweep} deg from x")

    def wires(self, at_hand: tuple[WireFile, ...]) -> tuple[WireFile, ...]:
        """The wires that may cut: the stated one, else those ``at_hand`` in the cell whose kerf is known."""
        if self.wire is not None:
            return (self.wire,)
        return tuple(w for w in at_hand if w.is_round or self.power_w is None)

    def using(self, wire: WireFile, sweep: float | None = None) -> ElasticWire:
        """This operation with a wire, and a sweep [deg from x], in place of what it leaves open."""
        return self.model_copy(update={"wire": wire} | ({} if sweep is None else {"sweep": sweep}))

    @property
    def is_normal(self) -> bool:
        """Whether sections are normal to the spine of the face: a strip's width must follow the sweep."""
        return self.sections == "normal" or (self.sections == "auto" and not self.chosen.is_round)
