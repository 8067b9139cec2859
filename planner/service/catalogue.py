"""What is built in, as plain data: robots, cells, tools, materials, example problems."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml
from pydantic import BaseModel

from planner import cell_file
from planner.catalogue import data_dir, robot, robot_names
from planner.materials import foams, wire_materials
from planner.service.models import Kind
from planner.sheet_metals import sheet_metals
from planner.units import DEG, MM

TOOLS: Final[tuple[type[BaseModel], ...]] = (
    cell_file.WireHolderFile,
    cell_file.BowFile,
    cell_file.GripperPlateFile,
    cell_file.VacuumCupFile,
    cell_file.BallToolFile,
    cell_file.DiskToolFile,
    cell_file.HeatToolFile,
    cell_file.MillFile,
    cell_file.PlainToolFile,
)


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
