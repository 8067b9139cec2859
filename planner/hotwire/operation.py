"""The ``elastic_wire`` operation of a problem file: lengths in mm, angles in degrees, speeds in mm/s."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from planner.hotwire.hot_wire import HotWireOperation
from planner.problem import Stock
from planner.schema import Name, Strict

Face = Literal["front", "back"]


class WireFile(Strict):
    """A round wire by ``diameter_mm``, or a strip by ``width_mm`` and ``thickness_mm``, over which it
    bends.
    """

    material: Annotated[str, Field(description="name in the table of materials")]
    diameter_mm: Annotated[float, Field(ge=0.05, le=10)] | None = None
    width_mm: Annotated[float, Field(ge=0.2, le=60)] | None = None
    thickness_mm: Annotated[float, Field(ge=0.05, le=5)] | None = None
    length_mm: Annotated[float, Field(ge=50, le=5000, description="hot length between the clamps")]
    temperature_c: Annotated[float, Field(ge=20, le=1000, description="of the wire while it cuts")]

    @model_validator(mode="after")
    def _one_section(self) -> WireFile:
        strip = self.width_mm is not None and self.thickness_mm is not None
        if self.diameter_mm is not None and (self.width_mm is not None or self.thickness_mm is not None):
            raise ValueError("give diameter_mm for a round wire, or width_mm and thickness_mm for a strip")
        if self.diameter_mm is None and not strip:
            raise ValueError(
                "give diameter_mm for a round wire, or both width_mm and thickness_mm for a strip"
            )
        if self.width_mm is not None and self.thickness_mm is not None and self.thickness_mm > self.width_mm:
            raise ValueError("thickness_mm must not exceed width_mm: a strip bends over its thin side")
        return self

    @property
    def is_round(self) -> bool:
        """Whether the wire may spin about itself."""
        return self.diameter_mm is not None


class ElasticWire(HotWireOperation):
    """Two arms bend one hot wire and sweep it through the block along the faces of the part."""

    process: Literal["elastic_wire"]
    arms: Annotated[tuple[Name, Name], Field(description="the arm at the wire's start, the arm at its end")]
    wire: WireFile
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
        if self.power_w is not None and not self.wire.is_round:
            raise ValueError("power_w: the kerf of strips is not known; give kerf_mm")
        return self

    @property
    def is_normal(self) -> bool:
        """Whether sections are normal to the spine of the face: a strip's width must follow the sweep."""
        return self.sections == "normal" or (self.sections == "auto" and not self.wire.is_round)
