"""Wires and foams in files: the wires of operations and at hand in a cell, foams of users' own.

From the wires at hand of a cell one is chosen. A foam's file is written after a fit of test cuts,
and read where a problem names one.
"""

import itertools
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import Field, ValidationError, field_validator, model_validator

from planner.catalogue.materials import Foam, KerfFit, KerfTests, wire_material
from planner.files import write_whole
from planner.geometry.units import MM
from planner.issues import Issue, TandemError, refusal
from planner.problem import BentWire
from planner.reading import strict_yaml
from planner.reading.strict_yaml import Name, Positive, Strict

DISTINCT_LENGTH_MM = 1.0
"""Lengths nearer to each other than this are one wire to an operator [mm]."""


class SectionFile(Strict):
    """A round wire by ``diameter_mm``, or a strip by ``width_mm`` and ``thickness_mm``, over which it
    bends.
    """

    material: str = Field(description="name in the table of materials")
    diameter_mm: Annotated[float, Field(ge=0.05, le=10)] | None = None
    width_mm: Annotated[float, Field(ge=0.2, le=60)] | None = None
    thickness_mm: Annotated[float, Field(ge=0.05, le=5)] | None = None
    temperature_c: float = Field(ge=20, le=1000, description="of the wire while it cuts")

    @model_validator(mode="after")
    def _one_section(self) -> "SectionFile":
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

    length_mm: float = Field(ge=50, le=5000, description="hot length between the clamps")

    def __str__(self) -> str:
        return f"{self.material} {self.size} of {self.length_mm:g} mm"

    def value(self) -> BentWire:
        """The wire in SI units."""
        thickness = self.thickness_mm if self.diameter_mm is None else self.diameter_mm
        width = None if self.width_mm is None else self.width_mm * MM
        length = self.length_mm * MM
        return BentWire(self.material, length, (thickness or 0.0) * MM, width, self.temperature_c)

    @staticmethod
    def of(wire: BentWire) -> "WireFile":
        """The inverse of :meth:`value`, exact for figures of up to nine decimals."""
        length, thickness = (round(value / MM, 9) for value in (wire.length, wire.thickness))
        strip = wire.width is not None
        return WireFile(
            material=wire.material,
            diameter_mm=None if strip else thickness,
            width_mm=None if wire.width is None else round(wire.width / MM, 9),
            thickness_mm=thickness if strip else None,
            temperature_c=wire.temperature,
            length_mm=length,
        )


class WiresFile(SectionFile):
    """Wires at hand of one section: one for each of the lengths."""

    lengths_mm: tuple[Annotated[float, Field(ge=50, le=5000)], ...] = Field(
        min_length=1, max_length=50, description="hot lengths between the clamps"
    )

    def wires(self) -> tuple[WireFile, ...]:
        """One wire for each length."""
        own = self.model_dump(exclude={"lengths_mm"})
        return tuple(WireFile(**own, length_mm=length) for length in self.lengths_mm)


def wires_at_hand(entries: Sequence[WiresFile]) -> tuple[WireFile, ...]:
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
            if b - a < DISTINCT_LENGTH_MM:
                what = f"{a:g} and {b:g} mm are one wire to whoever mounts it; give lengths that differ by "
                issues.append(_field(number, "lengths_mm", what + f"{DISTINCT_LENGTH_MM:g} mm or more"))
    if issues:
        raise TandemError(issues)
    return tuple(w for entry in entries for w in sorted(entry.wires(), key=lambda w: w.length_mm))


def _field(number: int, name: str, what: str) -> Issue:
    field = f"wires.{number}" + (f".{name}" if name else "")
    return Issue("problem.field", f"{field}: {what}", field=field)


def wire_faults(at_hand: Sequence[BentWire], operations: Sequence[Any]) -> Iterator[Issue]:
    """``problem.field`` for operations with a bent wire that state none where the cell has none either, that
    state another one than those at hand, or whose power fits none of them."""
    wires = [WireFile.of(wire) for wire in at_hand]
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


Range = tuple[Annotated[float, Field(gt=0, le=100_000)], Annotated[float, Field(gt=0, le=100_000)]]


class KerfFitFile(Strict):
    """What test cuts say of the kerf: kerf = chi * ideal - offset."""

    chi: float = Field(gt=0, le=100, description="slot per ideal width")
    offset_mm: float = Field(ge=-100, le=100)
    spread_mm: float = Field(ge=0, le=100, description="standard deviation of the residuals")
    count: int = Field(ge=3, le=1_000_000, description="cuts that were used")
    mean_ideal_mm: float = Field(gt=0, le=1000)
    scatter_mm2: float = Field(gt=0, le=1e9)
    power_per_length_w_m: Range
    speed_mm_s: Range
    burnt_speed_mm_s: Annotated[float, Field(gt=0, le=1000)] | None = None
    thickness_mm: Positive
    wire_diameter_mm: Positive

    @field_validator("power_per_length_w_m", "speed_mm_s")
    @classmethod
    def _ascends(cls, value: tuple[float, float]) -> tuple[float, float]:
        if value[0] > value[1]:
            raise ValueError("the lower value comes first")
        return value

    def value(self) -> KerfFit:
        """The fit in SI units."""
        return KerfFit(
            chi=self.chi,
            offset=self.offset_mm * MM,
            spread=self.spread_mm * MM,
            count=self.count,
            mean_ideal=self.mean_ideal_mm * MM,
            scatter=self.scatter_mm2 * MM * MM,
            tests=KerfTests(
                power_per_length=self.power_per_length_w_m,
                speed=(self.speed_mm_s[0] * MM, self.speed_mm_s[1] * MM),
                thickness=self.thickness_mm * MM,
                wire_diameter=self.wire_diameter_mm * MM,
                burnt_speed=None if self.burnt_speed_mm_s is None else self.burnt_speed_mm_s * MM,
            ),
        )


class FoamFile(Strict):
    """A foam of the user's own."""

    tandem_foam: Literal[1]
    name: Name
    title: str = Field(default="", max_length=200)
    source: str = Field(default="", max_length=1000)
    density_kg_m3: float = Field(ge=1, le=1000)
    specific_heat_j_kg_k: float = Field(ge=100, le=10_000)
    melt_temperature_c: float = Field(ge=50, le=1000)
    conductivity_w_m_k: Annotated[float, Field(gt=0, le=10)] | None = None
    kerf: KerfFitFile | None = None


def read_foam(path: Path) -> Foam:
    """The foam of a file.

    Raises `TandemError`: kerf.foam_file for every wrong field, with its line, and what `strict_yaml.read`
    raises for what is not a YAML file.
    """
    document = strict_yaml.read(path)
    try:
        # as JSON, because its strict rules take a list for a tuple but no text for a number
        spec = FoamFile.model_validate_json(json.dumps(document.data), strict=True)
    except ValidationError as error:
        raise TandemError([_issue(dict(one), document) for one in error.errors()]) from error
    return _value(spec, spec.source or f"{path.name}, no source given")


def make_foam(fields: dict[str, Any]) -> Foam:
    """A foam without kerf from fields as in a foam file. Raises `TandemError` (kerf.foam_file)."""
    try:
        return _value(FoamFile.model_validate({"tandem_foam": 1, **fields}), "as given")
    except ValidationError as error:
        raise TandemError([_issue(dict(one), None) for one in error.errors()]) from error


def _value(spec: FoamFile, source: str) -> Foam:
    known = ("density", "specific_heat", "melt_temperature", "conductivity", "kerf")
    return Foam(
        name=spec.name,
        title=spec.title or spec.name,
        density=spec.density_kg_m3,
        sources=dict.fromkeys(known, source),
        specific_heat=spec.specific_heat_j_kg_k,
        melt_temperature=spec.melt_temperature_c,
        conductivity=spec.conductivity_w_m_k,
        kerf=None if spec.kerf is None else spec.kerf.value(),
    )


def write_foam(path: Path, foam: Foam, source: str) -> None:
    """Write a foam with its specific heat and melting temperature so that `read` gives it back.

    Raises `TandemError` (output.folder) where the file cannot be written.
    """
    data: dict[str, Any] = {
        "tandem_foam": 1,
        "name": foam.name,
        "title": foam.title,
        "source": source,
        "density_kg_m3": foam.density,
        "specific_heat_j_kg_k": foam.specific_heat,
        "melt_temperature_c": foam.melt_temperature,
    }
    if foam.conductivity is not None:
        data["conductivity_w_m_k"] = foam.conductivity
    if foam.kerf is not None:
        data["kerf"] = _written(foam.kerf)
    head = (
        "# A foam of your own, for a problem's stock: {foam: {file: ...}}. How it was fitted: docs/kerf.md\n"
    )
    try:
        write_whole(
            path, head + yaml.safe_dump(data, sort_keys=False, allow_unicode=True, default_flow_style=None)
        )
    except OSError as error:
        text = f"{path}: cannot be written ({error.strerror or error}); choose another place"
        raise refusal("output.folder", text, file=str(path)) from error


def _written(fit: KerfFit) -> dict[str, Any]:
    tests = fit.tests
    data = {
        "chi": fit.chi,
        "offset_mm": fit.offset / MM,
        "spread_mm": fit.spread / MM,
        "count": fit.count,
        "mean_ideal_mm": fit.mean_ideal / MM,
        "scatter_mm2": fit.scatter / (MM * MM),
        "power_per_length_w_m": list(tests.power_per_length),
        "speed_mm_s": [tests.speed[0] / MM, tests.speed[1] / MM],
        "thickness_mm": tests.thickness / MM,
        "wire_diameter_mm": tests.wire_diameter / MM,
    }
    if tests.burnt_speed is not None:
        data["burnt_speed_mm_s"] = tests.burnt_speed / MM
    return {key: _short(value) for key, value in data.items()}


def _short(value: Any) -> Any:
    """Nine figures are more than any test cut has."""
    if isinstance(value, list):
        return [_short(one) for one in value]
    return float(f"{value:.9g}") if isinstance(value, float) else value


def _issue(error: dict[str, Any], document: strict_yaml.Document | None) -> Issue:
    location = tuple(error["loc"])
    field = ".".join(str(step) for step in location)
    got = error.get("input")
    shown = "" if error["type"] == "missing" or isinstance(got, dict | list) else f", got {got!r:.60}"
    remedy = {"missing": "add it", "extra_forbidden": "remove it or correct its spelling"}
    what = "unknown key" if error["type"] == "extra_forbidden" else error["msg"]
    return Issue(
        "kerf.foam_file",
        f"{what}{shown}",
        file=None if document is None else str(document.path),
        line=None if document is None else document.line(location),
        field=field,
        hint=remedy.get(error["type"], "correct it"),
    )
