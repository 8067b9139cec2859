"""Files of users' own foams: written after a fit of test cuts, read where a problem names one."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import Field, ValidationError, field_validator

from planner import yaml_lines
from planner.files import write_whole
from planner.issues import Issue, TandemError
from planner.materials import Foam, KerfFit, KerfTests
from planner.schema import Name, Positive, Strict
from planner.units import MM

Range = tuple[
    Annotated[float, Field(gt=0, le=100_000)],
    Annotated[float, Field(gt=0, le=100_000)],
]


class KerfFitFile(Strict):
    """What test cuts say of the kerf: kerf = chi * ideal - offset."""

    chi: Annotated[float, Field(gt=0, le=100, description="slot per ideal width")]
    offset_mm: Annotated[float, Field(ge=-100, le=100)]
    spread_mm: Annotated[float, Field(ge=0, le=100, description="standard deviation of the residuals")]
    count: Annotated[int, Field(ge=3, le=1_000_000, description="cuts that were used")]
    mean_ideal_mm: Annotated[float, Field(gt=0, le=1000)]
    scatter_mm2: Annotated[float, Field(gt=0, le=1e9)]
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
    title: Annotated[str, Field(max_length=200)] = ""
    source: Annotated[str, Field(max_length=1000)] = ""
    density_kg_m3: Annotated[float, Field(ge=1, le=1000)]
    specific_heat_j_kg_k: Annotated[float, Field(ge=100, le=10_000)]
    melt_temperature_c: Annotated[float, Field(ge=50, le=1000)]
    conductivity_w_m_k: Annotated[float, Field(gt=0, le=10)] | None = None
    kerf: KerfFitFile | None = None


def read(path: Path) -> Foam:
    """The foam of a file.

    Raises `TandemError`: kerf.foam_file for every wrong field, with its line, and what `yaml_lines.read`
    raises for what is not a YAML file.
    """
    document = yaml_lines.read(path)
    try:
        # as JSON, because its strict rules take a list for a tuple but no text for a number
        spec = FoamFile.model_validate_json(json.dumps(document.data), strict=True)
    except ValidationError as error:
        raise TandemError([_issue(dict(one), document) for one in error.errors()]) from error
    return _value(spec, spec.source or f"{path.name}, no source given")


def make(fields: dict[str, Any]) -> Foam:
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


def write(path: Path, foam: Foam, source: str) -> None:
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
        raise TandemError(Issue("output.folder", text, file=str(path))) from error


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


def _issue(error: dict[str, Any], document: yaml_lines.Document | None) -> Issue:
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
