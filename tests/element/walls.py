"""A wavy wall whose height is a formula, as a mesh and as an element file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from planner.geometry.mesh import TriangleMesh
from planner.issues import Issue, TandemError

ROOT = Path(__file__).parents[2]


def height(x: Any, y: Any) -> Any:
    """Height [m] of the wall of the trials: two long waves, a short one and a bump."""
    waves = 0.30 * np.sin(1.5 * x + 0.6 * y) + 0.16 * np.cos(2.6 * y - 0.5 * x)
    bump = 0.10 * np.exp(-((x - 2.6) ** 2 + (y - 1.2) ** 2) / 0.15)
    return waves + 0.04 * np.sin(5.5 * x) * np.cos(3.0 * y) + bump


def slope(x: Any, y: Any) -> tuple[Any, Any]:
    """Its derivatives, by central differences."""
    d = 1e-5
    return (height(x + d, y) - height(x - d, y)) / (2 * d), (height(x, y + d) - height(x, y - d)) / (2 * d)


def wall(long: float, wide: float, step: float) -> TriangleMesh:
    """The wall over 0 to ``long``, 0 to ``wide`` [m] in facets of ``step`` [m]."""
    nx, ny = round(long / step), round(wide / step)
    x, y = np.meshgrid(np.linspace(0, long, nx + 1), np.linspace(0, wide, ny + 1), indexing="ij")
    i = np.arange((nx + 1) * (ny + 1)).reshape(nx + 1, ny + 1)
    a, b, c, d = (i[s].ravel() for s in (np.s_[:-1, :-1], np.s_[1:, :-1], np.s_[1:, 1:], np.s_[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return TriangleMesh(np.stack([x, y, height(x, y)], axis=-1).reshape(-1, 3), faces)


def write_obj(path: Path, mesh: TriangleMesh) -> None:
    """A mesh file in millimetres."""
    lines = [f"v {x:.9f} {y:.9f} {z:.9f}" for x, y, z in (mesh.vertices * 1e3).tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (mesh.faces + 1).tolist()]
    path.write_text("\n".join(lines) + "\n")


def expect_refusal(divide: Callable[[], object]) -> Issue:
    """The one issue that an element is refused with."""
    with pytest.raises(TandemError) as caught:
        divide()
    (issue,) = caught.value.issues
    return issue


def element(folder: Path, mesh: TriangleMesh | None = None, **changes: Any) -> Path:
    """A small element file in ``folder``: 1.2 x 0.9 m of the wall in 6 x 5 cells, unchecked, with ``changes``
    of it."""
    folder.mkdir(parents=True, exist_ok=True)
    write_obj(folder / "wall.obj", wall(1.2, 0.9, 0.02) if mesh is None else mesh)
    template = yaml.safe_load((ROOT / "problems" / "wave_facade" / "faces.yaml").read_text())
    template["cell"] = str(ROOT / "problems" / "cells" / "two_irb4600_facing.yaml")
    (folder / "faces.yaml").write_text(yaml.safe_dump(template))
    data = {
        "element": 1,
        "name": "small",
        "surface": {"mesh": {"file": "wall.obj", "unit": "mm"}},
        "thickness_mm": 50,
        "panels": {"elastic": {"tolerance_mm": 1.0, "cells": [6, 5], "check": "none"}},
        "wires": [
            {"material": "spring_steel", "diameter_mm": 2.0, "lengths_mm": [900], "temperature_c": 300}
        ],
        "blocks": [{"size_mm": [700, 500, 180], "foam": "eps_a120"}],
        "jobs": [{"problem": "faces.yaml"}],
    }
    path = folder / "element.yaml"
    path.write_text(yaml.safe_dump({**data, **changes}))
    return path
