"""Wires and foams in files: wires of operations and of a cell, and custom foams.

A wire is chosen among those of a cell. A foam file is written after a fit of test cuts, and read if a problem
names it.
"""

import itertools
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import Field, ValidationError, field_validator, model_validator

from planner.catalogue.materials import FoamMaterial, KerfFit, KerfTests, wire_material
from planner.files import write_atomic
from planner.geometry.units import MM
from planner.issues import Issue, TandemError, issue_error
from planner.problem import BentWire
from planner.reading import strict_yaml
from planner.reading.strict_yaml import Name, Positive, Strict

DISTINCT_LENGTH_MM = 1.0
"""Minimum difference [mm] of wire lengths that an operator can distinguish."""


class WireSectionFile(Strict):
    """A round wire by ``diameter_mm``, or a strip by ``width_mm`` and ``thickness_mm``.

    A strip bends over its thickness.
    """

    material: str = Field(description="name in the table of materials")
    diameter_mm: Annotated[float, Field(ge=0.05, le=10)] | None = None
    width_mm: Annotated[float, Field(ge=0.2, le=60)] | None = None
    thickness_mm: Annotated[float, Field(ge=0.05, le=5)] | None = None
    temperature_c: float = Field(ge=20, le=1000, description="of the wire while it cuts")

    @model_validator(mode="after")
    def _one_section(self) -> "WireSectionFile":
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
        """Whether the wire is free to spin about its axis."""
        return self.diameter_mm is not None

    @property
    def size(self) -> str:
        """Section as text, the same in programs, report and proof."""
        if self.diameter_mm is not None:
            return f"{self.diameter_mm:g} mm round"
        return f"{self.width_mm:g} x {self.thickness_mm:g} mm strip"


class WireFile(WireSectionFile):
    """One wire: its section and its length."""

    length_mm: float = Field(ge=50, le=5000, description="hot length between the clamps")

    def __str__(self) -> str:
        return f"{self.material} {self.size} of {self.length_mm:g} mm"

    def to_wire(self) -> BentWire:
        """Convert the wire to SI units."""
        thickness = self.thickness_mm if self.diameter_mm is None else self.diameter_mm
        width = None if self.width_mm is None else self.width_mm * MM
        length = self.length_mm * MM
        return BentWire(self.material, length, (thickness or 0.0) * MM, width, self.temperature_c)

    @staticmethod
    def from_wire(wire: BentWire) -> "WireFile":
        """Create from a wire in SI units, the inverse of :meth:`to_wire`; exact for up to nine decimals."""
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


class WiresFile(WireSectionFile):
    """Available wires of one section, one for each of the lengths."""

    lengths_mm: tuple[Annotated[float, Field(ge=50, le=5000)], ...] = Field(
        min_length=1, max_length=50, description="hot lengths between the clamps"
    )

    def wires(self) -> tuple[WireFile, ...]:
        """Return one wire for each length."""
        fields = self.model_dump(exclude={"lengths_mm"})
        return tuple(WireFile(**fields, length_mm=length) for length in self.lengths_mm)


def available_wires(entries: Sequence[WiresFile]) -> tuple[WireFile, ...]:
    """Return all wires of a list, shortest first within a section.

    Raises:
        TandemError: ``problem.field`` for each entry with an unknown material, an invalid temperature, or a
            wire that cannot be distinguished from another one.
    """
    issues: list[Issue] = []
    first_entry: dict[tuple[str, str], int] = {}
    for number, entry in enumerate(entries):
        try:
            material = wire_material(entry.material)
            if entry.temperature_c > material.limit_temperature:
                text = f"{entry.temperature_c:g} C, allowed up to {material.limit_temperature:g} C for"
                issues.append(
                    _field_issue(number, "temperature_c", f"got {text} {entry.material}; correct it")
                )
        except TandemError as error:
            issues.append(_field_issue(number, "material", error.issues[0].message))
        previous = first_entry.setdefault((entry.material, entry.size), number)
        if previous != number:
            text = f"{entry.material} {entry.size} is already given in wires.{previous}; "
            issues.append(_field_issue(number, "", text + "give each section once, with all its lengths"))
        for a, b in itertools.pairwise(sorted(entry.lengths_mm)):
            if b - a < DISTINCT_LENGTH_MM:
                text = f"{a:g} and {b:g} mm cannot be told apart by an operator; give lengths differing by "
                issues.append(_field_issue(number, "lengths_mm", text + f"{DISTINCT_LENGTH_MM:g} mm or more"))
    if issues:
        raise TandemError(issues)
    return tuple(w for entry in entries for w in sorted(entry.wires(), key=lambda w: w.length_mm))


def _field_issue(number: int, name: str, message: str) -> Issue:
    field = f"wires.{number}" + (f".{name}" if name else "")
    return Issue("problem.field", f"{field}: {message}", field=field)


def wire_faults(available: Sequence[BentWire], operations: Sequence[Any]) -> Iterator[Issue]:
    """Yield ``problem.field`` for operations whose bent wire is missing or unavailable.

    An operation is refused if neither it nor the cell states a wire, if its wire is not among those of the
    cell, or if its kerf should follow from its power, but the cell only has strips.
    """
    wires = [WireFile.from_wire(wire) for wire in available]
    for index, operation in enumerate(operations):
        if getattr(operation, "process", "") != "elastic_wire":
            continue
        field, operation_wire = f"operations.{index}.wire", operation.wire
        available_text = "; ".join(map(str, wires))
        if operation_wire is None and not wires:
            message = "no wire is stated and the cell lists none; state wire, or add wires to the cell"
            yield Issue("problem.field", f"{field}: {message}", field=field)
        elif operation_wire is not None and wires and operation_wire not in wires:
            message = (
                f"{operation_wire} at {operation_wire.temperature_c:g} C is not a wire of the cell, which "
                f"has: {available_text}"
            )
            hint = "remove wire, so that one of them is chosen, state one of them, or add it to the list"
            yield Issue("problem.field", f"{field}: {message}", field=field, hint=hint)
        elif operation_wire is None and operation.power_w is not None and not any(w.is_round for w in wires):
            message = "the kerf of strips is unknown, and all wires of the cell are strips; give kerf_mm"
            yield Issue(
                "problem.field", f"operations.{index}.power_w: {message}", field=f"operations.{index}.power_w"
            )


Range = tuple[Annotated[float, Field(gt=0, le=100_000)], Annotated[float, Field(gt=0, le=100_000)]]


class KerfFitFile(Strict):
    """Kerf as fitted to test cuts: kerf = chi * ideal - offset."""

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
    def _is_ascending(cls, value: tuple[float, float]) -> tuple[float, float]:
        if value[0] > value[1]:
            raise ValueError("the lower value comes first")
        return value

    def to_fit(self) -> KerfFit:
        """Convert the fit to SI units."""
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
    """A custom foam."""

    tandem_foam: Literal[1]
    name: Name
    title: str = Field(default="", max_length=200)
    source: str = Field(default="", max_length=1000)
    density_kg_m3: float = Field(ge=1, le=1000)
    specific_heat_j_kg_k: float = Field(ge=100, le=10_000)
    melt_temperature_c: float = Field(ge=50, le=1000)
    conductivity_w_m_k: Annotated[float, Field(gt=0, le=10)] | None = None
    kerf: KerfFitFile | None = None


def read_foam(path: Path) -> FoamMaterial:
    """Read the foam of a file.

    Raises:
        TandemError: ``kerf.foam_file`` for each wrong field, with its line, and the issues of
            :func:`strict_yaml.read` for a file that is not YAML.
    """
    document = strict_yaml.read(path)
    try:
        # as JSON, whose strict rules accept a list for a tuple but no text for a number
        spec = FoamFile.model_validate_json(json.dumps(document.data), strict=True)
    except ValidationError as error:
        raise TandemError([_foam_issue(dict(fault), document) for fault in error.errors()]) from error
    return _build_foam(spec, spec.source or f"{path.name}, no source given")


def make_foam(fields: dict[str, Any]) -> FoamMaterial:
    """Create a foam without kerf from fields as in a foam file.

    Raises:
        TandemError: ``kerf.foam_file``.
    """
    try:
        return _build_foam(FoamFile.model_validate({"tandem_foam": 1, **fields}), "as given")
    except ValidationError as error:
        raise TandemError([_foam_issue(dict(fault), None) for fault in error.errors()]) from error


def _build_foam(spec: FoamFile, source: str) -> FoamMaterial:
    """Convert a foam to SI units, with one source for all its properties."""
    properties = ("density", "specific_heat", "melt_temperature", "conductivity", "kerf")
    return FoamMaterial(
        name=spec.name,
        title=spec.title or spec.name,
        density=spec.density_kg_m3,
        sources=dict.fromkeys(properties, source),
        specific_heat=spec.specific_heat_j_kg_k,
        melt_temperature=spec.melt_temperature_c,
        conductivity=spec.conductivity_w_m_k,
        kerf=None if spec.kerf is None else spec.kerf.to_fit(),
    )


def write_foam(path: Path, foam: FoamMaterial, source: str) -> None:
    """Write a foam with specific heat and melting temperature, so that :func:`read_foam` returns it.

    Raises:
        TandemError: ``output.folder`` if the file cannot be written.
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
        data["kerf"] = _fit_data(foam.kerf)
    head = (
        "# A custom foam, for a problem's stock: {foam: {file: ...}}. The fit is described in docs/kerf.md\n"
    )
    try:
        write_atomic(
            path, head + yaml.safe_dump(data, sort_keys=False, allow_unicode=True, default_flow_style=None)
        )
    except OSError as error:
        text = f"{path}: cannot be written ({error.strerror or error}); choose another folder"
        raise issue_error("output.folder", text, file=str(path)) from error


def _fit_data(fit: KerfFit) -> dict[str, Any]:
    """Return a fit as the key ``kerf`` of a foam file."""
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
    return {key: _round_digits(value) for key, value in data.items()}


def _round_digits(value: Any) -> Any:
    """Round to nine digits, more than any test cut has."""
    if isinstance(value, list):
        return [_round_digits(item) for item in value]
    return float(f"{value:.9g}") if isinstance(value, float) else value


def _foam_issue(error: dict[str, Any], document: strict_yaml.Document | None) -> Issue:
    """Return the issue of a validation error of pydantic, with file and line if there is a document."""
    location = tuple(error["loc"])
    field = ".".join(str(step) for step in location)
    value = error.get("input")
    remedy = {"missing": "add it", "extra_forbidden": "remove it or correct its spelling"}
    message = "unknown key" if error["type"] == "extra_forbidden" else error["msg"]
    if error["type"] != "missing" and not isinstance(value, dict | list):
        message += f", got {value!r:.60}"
    return Issue(
        "kerf.foam_file",
        message,
        file=None if document is None else str(document.path),
        line=None if document is None else document.line(location),
        field=field,
        hint=remedy.get(error["type"], "correct it"),
    )
