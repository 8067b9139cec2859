"""Built-in robots, cells, tools, materials and the schemas of problem files, as plain data.

The JSON schemas are generated from the models that read problem files. The schema of a problem file
contains the operations of all processes. Loading them takes seconds, so this module is imported on demand.
"""

import functools
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml
from pydantic import BaseModel
from pydantic.json_schema import models_json_schema

from planner.catalogue.materials import foams, sheet_metals, wire_materials
from planner.catalogue.robots import data_dir, robot, robot_names
from planner.geometry.units import DEG, MM
from planner.issues import Issue
from planner.processes import registry
from planner.reading import cell
from planner.reading.problem import ProblemFile
from planner.reading.process_forces import ForcesFile
from planner.reading.stock import SetupFile
from planner.service.models import Kind
from planner.service.security import RefusedError

TOOL_MODELS: Final[tuple[type[BaseModel], ...]] = (
    cell.WireHolderFile,
    cell.BowFile,
    cell.GripperPlateFile,
    cell.VacuumCupFile,
    cell.BallToolFile,
    cell.DiskToolFile,
    cell.HeatToolFile,
    cell.MillFile,
    cell.PlainToolFile,
)
"""Schemas of the tools that a problem file may contain."""


@functools.cache
def entries(kind: Kind) -> dict[str, dict[str, Any]]:
    """Return the catalogue entries of one kind, by name.

    Args:
        kind: Kind of entry.
    """
    return dict({"robots": _robots, "cells": _cells, "tools": _tools, "materials": _materials}[kind]())


def _robots() -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield name and data of each robot, converted from SI units to mm and degrees."""
    for name in robot_names():
        data = robot(name)
        limits = np.stack([data.lower, data.upper], axis=1) / DEG
        yield (
            name,
            {
                "title": data.title,
                "family": data.family,
                "controller": data.controller,
                "reach_mm": round(data.reach / MM, 3),
                "payload_kg": data.payload,
                "joint_limits_deg": np.round(limits, 6).tolist(),
                "joint_speeds_deg_s": np.round(data.velocity / DEG, 6).tolist(),
                "sources": list(data.sources),
                "assumed": list(data.assumed),
            },
        )


def _cells() -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield cells in the form in which problem files may contain them."""
    for path in sorted((data_dir("problems") / "cells").glob("*.yaml")):
        yield path.stem, _load_yaml(path)


def _tools() -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield each kind of tool with the docstring and the JSON schema of its model."""
    for model in TOOL_MODELS:
        schema = model.model_json_schema()
        kind = str(schema["properties"]["kind"]["const"])
        yield kind, {"about": " ".join((model.__doc__ or "").split()), "schema": schema}


def _materials() -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield name, kind, title and sources of each wire, foam and sheet metal."""
    wires, foams_, sheets = wire_materials().values(), foams().values(), sheet_metals().values()
    materials = [("wire", m.name, m.title, m.sources) for m in wires]
    materials += [("foam", m.name, m.title, m.sources) for m in foams_]
    materials += [("sheet", m.name, m.title, m.sources) for m in sheets]
    for kind, name, title, sources in materials:
        yield name, {"kind": kind, "title": title, "sources": dict(sources)}


def _load_yaml(path: Path) -> dict[str, Any]:
    data = yaml.safe_load(path.read_text(encoding="utf-8"))
    return data if isinstance(data, dict) else {}


OPENAPI_REFERENCE: Final = "#/components/schemas/{model}"
"""Reference to a schema in the OpenAPI document."""


@functools.cache
def problem_schema(template: str = "#/$defs/{model}") -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the schema of a problem file and the definitions that it references.

    Args:
        template: Format of a reference.
    """
    models: list[type[BaseModel]] = [ProblemFile, SetupFile, ForcesFile, *registry.schemas().values()]
    references, document = models_json_schema([(m, "validation") for m in models], ref_template=template)
    definitions: dict[str, Any] = document["$defs"]
    choices: list[dict[str, Any]] = []
    for model in registry.schemas().values():
        # Operations of every process may have the sections ``setup`` and ``forces``.
        definition = definitions[_model_name(references[model, "validation"])]
        definition["properties"]["setup"] = dict(references[SetupFile, "validation"])
        forces_definition = definitions[_model_name(references[ForcesFile, "validation"])]
        definition["properties"]["forces"] = forces_definition["properties"]["forces"]
        choices.append(dict(references[model, "validation"]))
    root = definitions[_model_name(references[ProblemFile, "validation"])]
    root["properties"]["operations"]["items"] = {"oneOf": choices}
    return dict(references[ProblemFile, "validation"]), definitions


def problem_file() -> dict[str, Any]:
    """Return the self-contained schema of a whole problem file."""
    reference, definitions = problem_schema()
    return {**reference, "$defs": definitions}


def process_schema(name: str) -> dict[str, Any]:
    """Return the self-contained schema of one process's operation.

    Args:
        name: Name of the process.

    Raises:
        RefusedError: 404, no such process.
    """
    schemas = registry.schemas()
    if name not in schemas:
        names = ", ".join(schemas)
        raise RefusedError(
            404, Issue("service.not_found", f"process {name[:80]!r}: unknown (allowed {names})", field="name")
        )
    _, definitions = problem_schema()
    return {"$ref": f"#/$defs/{schemas[name].__name__}", "$defs": definitions}


def _model_name(reference: Any) -> str:
    return str(reference["$ref"]).rsplit("/", 1)[1]
