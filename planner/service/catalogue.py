"""What is built in, as plain data: robots, cells, tools, materials, and schemas of problem files.

JSON schemas come from the very models that read problem files: one file's schema knows the
operations of all processes. Loading them takes seconds, so this module is imported when it is asked
for.
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
from planner.reading.loads import ForcesFile
from planner.reading.problem import ProblemFile
from planner.reading.stock import SetupFile
from planner.service.models import Kind
from planner.service.security import RefusedError

TOOLS: Final[tuple[type[BaseModel], ...]] = (
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
"""Schemas of the tools that a problem file may state."""


@functools.cache
def entries(kind: Kind) -> dict[str, dict[str, Any]]:
    """The entries of one kind by name."""
    return dict({"robots": _robots, "cells": _cells, "tools": _tools, "materials": _materials}[kind]())


def _robots() -> Iterator[tuple[str, dict[str, Any]]]:
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
    """Cells as problem files may have them inside."""
    for path in sorted((data_dir("problems") / "cells").glob("*.yaml")):
        yield path.stem, _yaml(path)


def _tools() -> Iterator[tuple[str, dict[str, Any]]]:
    for model in TOOLS:
        schema = model.model_json_schema()
        kind = str(schema["properties"]["kind"]["const"])
        yield kind, {"about": " ".join((model.__doc__ or "").split()), "schema": schema}


def _materials() -> Iterator[tuple[str, dict[str, Any]]]:
    wires, foams_, sheets = wire_materials().values(), foams().values(), sheet_metals().values()
    known = [("wire", m.name, m.title, m.sources) for m in wires]
    known += [("foam", m.name, m.title, m.sources) for m in foams_]
    known += [("sheet", m.name, m.title, m.sources) for m in sheets]
    for kind, name, title, sources in known:
        yield name, {"kind": kind, "title": title, "sources": dict(sources)}


def _yaml(path: Path) -> dict[str, Any]:
    data = yaml.safe_load(path.read_text(encoding="utf-8"))
    return data if isinstance(data, dict) else {}


IN_OPENAPI: Final = "#/components/schemas/{model}"
"""Where the description of the interface keeps a schema."""


@functools.cache
def problem_schema(template: str = "#/$defs/{model}") -> tuple[dict[str, Any], dict[str, Any]]:
    """The schema of a problem file, and the definitions that it refers to by ``template``."""
    models: list[type[BaseModel]] = [ProblemFile, SetupFile, ForcesFile, *registry.schemas().values()]
    found, together = models_json_schema([(m, "validation") for m in models], ref_template=template)
    definitions: dict[str, Any] = together["$defs"]
    choices: list[dict[str, Any]] = []
    for model in registry.schemas().values():
        definition = definitions[_name(found[model, "validation"])]
        definition["properties"]["setup"] = dict(found[SetupFile, "validation"])
        stated = definitions[_name(found[ForcesFile, "validation"])]
        definition["properties"]["forces"] = stated["properties"]["forces"]
        choices.append(dict(found[model, "validation"]))
    top = definitions[_name(found[ProblemFile, "validation"])]
    top["properties"]["operations"]["items"] = {"oneOf": choices}
    return dict(found[ProblemFile, "validation"]), definitions


def problem_file() -> dict[str, Any]:
    """The schema of a whole problem file, by itself."""
    reference, definitions = problem_schema()
    return {**reference, "$defs": definitions}


def process(name: str) -> dict[str, Any]:
    """The schema of one process's operation, by itself; raises :class:`RefusedError`, 404."""
    known = registry.schemas()
    if name not in known:
        have = ", ".join(known)
        raise RefusedError(
            404, Issue("service.not_found", f"process {name[:80]!r}: known are {have}", field="name")
        )
    _, definitions = problem_schema()
    return {"$ref": f"#/$defs/{known[name].__name__}", "$defs": definitions}


def _name(reference: Any) -> str:
    return str(reference["$ref"]).rsplit("/", 1)[1]
