"""Wires in files: one wire of an operation, and the wires at hand of a cell, from which one is chosen."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import Annotated, Any

from pydantic import Field, model_validator

from planner.issues import Issue, TandemError
from planner.materials import wire_material
from planner.schema import Strict

APART_MM = 1.0
"""Lengths nearer to each other than this are one wire to an operator [mm]."""


class SectionFile(Strict):
    """A round wire by ``diameter_mm``, or a strip by ``width_mm`` and ``thickness_mm``, over which it
    bends.
    """

    material: Annotated[str, Field(description="name in the table of materials")]
    diameter_mm: Annotated[float, Field(ge=0.05, le=10)] | None = None
    width_mm: Annotated[float, Field(ge=0.2, le=60)] | None = None
    thickness_mm: Annotated[float, Field(ge=0.05, le=5)] | None = None
    temperature_c: Annotated[float, Field(ge=20, le=1000, description="of the wire while it cuts")]

    @model_validator(mode="after")
    def _one_section(self) -> SectionFile:
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

    @property
    def size(self) -> str:
        """The section as people read it, the same for programs, report and proof."""
        if self.diameter_mm is not None:
            return f"{self.diameter_mm:g} mm round"
        return f"{self.width_mm:g} x {self.thickness_mm:g} mm strip"


class WireFile(SectionFile):
    """One wire: its section and its length."""

    length_mm: Annotated[float, Field(ge=50, le=5000, description="hot length between the clamps")]

    def __str__(self) -> str:
        return f"{self.material} {self.size} of {self.length_mm:g} mm"


class WiresFile(SectionFile):
    """Wires at hand of one section: one for each of the lengths."""

    lengths_mm: Annotated[
        tuple[Annotated[float, Field(ge=50, le=5000)], ...],
        Field(min_length=1, max_length=50, description="hot lengths between the clamps"),
    ]

    def wires(self) -> tuple[WireFile, ...]:
        """One wire for each length."""
        own = self.model_dump(exclude={"lengths_mm"})
        return tuple(WireFile(**own, length_mm=length) for length in self.lengths_mm)


def at_hand(entries: Sequence[WiresFile]) -> tuple[WireFile, ...]:
    """All wires of a list, shortest first within a section.

    Raises ``TandemError`` with the field of each entry whose material or temperature cannot be, or that has
    a wire which another one of the list is taken for (``problem.field``)."""
    issues: list[Issue] = []
    seen: dict[tuple[str, str], int] = {}
    for number, entry in enumerate(entries):
        try:
            material = wire_material(entry.material)
            if entry.temperature_c > material.limit_temperature:
                what = f"{entry.temperature_c:g} C, allowed up to {material.limit_temperature:g} C for"
                issues.append(_field(number, "temperature_c", f"got {what} {entry.material}; correct it"))
        except TandemError as error:
            issues.append(_field(number, "material", error.issues[0].message))
        before = seen.setdefault((entry.material, entry.size), number)
        if before != number:
            what = f"{entry.material} {entry.size} is given in wires.{before} already; "
            issues.append(_field(number, "", what + "give each section once, with all its lengths"))
        for a, b in itertools.pairwise(sorted(entry.lengths_mm)):
            if b - a < APART_MM:
                what = f"{a:g} and {b:g} mm are one wire to whoever mounts it; give lengths that differ by "
                issues.append(_field(number, "lengths_mm", what + f"{APART_MM:g} mm or more"))
    if issues:
        raise TandemError(issues)
    return tuple(w for entry in entries for w in sorted(entry.wires(), key=lambda w: w.length_mm))


def _field(number: int, name: str, what: str) -> Issue:
    field = f"wires.{number}" + (f".{name}" if name else "")
    return Issue("problem.field", f"{field}: {what}", field=field)


def faults(wires: Sequence[WireFile], operations: Sequence[Any]) -> Iterator[Issue]:
    """``problem.field`` for operations with a bent wire that state none where the cell has none either, that
    state another one than those at hand, or whose power fits none of them."""
    for index, operation in enumerate(operations):
        if getattr(operation, "process", "") != "elastic_wire":
            continue
        field, own = f"operations.{index}.wire", operation.wire
        have = "; ".join(map(str, wires))
        if own is None and not wires:
            what = "no wire is stated and the cell lists none; add wire, or wires to the cell"
            yield Issue("problem.field", f"{field}: {what}", field=field)
        elif own is not None and wires and own not in wires:
            what = f"{own} at {own.temperature_c:g} C is none of the wires of the cell, which are: {have}"
            hint = "leave wire out, so that one of them is chosen, state one of them, or add it to the list"
            yield Issue("problem.field", f"{field}: {what}", field=field, hint=hint)
        elif own is None and operation.power_w is not None and not any(w.is_round for w in wires):
            what = "the kerf of strips is not known, and all wires of the cell are strips; give kerf_mm"
            yield Issue(
                "problem.field", f"operations.{index}.power_w: {what}", field=f"operations.{index}.power_w"
            )
