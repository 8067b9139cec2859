"""Shells as element files, and the written panels, read again by independent test code."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from planner.geometry.mesh import TriangleMesh
from tests.element.walls import ROOT, write_obj

THICK = 150.0
"""Thickness [mm] of small shells."""


def cap(shift: float = 0.0, n: int = 21) -> TriangleMesh:
    """A piece of a sphere-like dome over 4 x 3 m, its crown off the middle; vertices moved by up to ``shift``
    [m] at random."""
    return patch(lambda x, y: 0.8 - 0.11 * (x - 0.2) ** 2 - 0.13 * (y + 0.1) ** 2, n, shift)


def saddle() -> TriangleMesh:
    """A surface that bends both ways everywhere."""
    return patch(lambda x, y: (x * x - y * y) / 7.0)


def patch(height: Any, n: int = 21, shift: float = 0.0) -> TriangleMesh:
    """A height over 4 x 3 m."""
    x, y = np.meshgrid(np.linspace(-2.0, 2.0, n), np.linspace(-1.5, 1.5, n), indexing="ij")
    i = np.arange(n * n).reshape(n, n)
    a, b, c, d = (part.reshape(-1) for part in (i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]))
    at = np.stack([x, y, height(x, y)], axis=-1).reshape(-1, 3)
    at += np.random.default_rng(1).uniform(-shift, shift, at.shape)
    return TriangleMesh(at, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]))


def shell(folder: Path, mesh: TriangleMesh | None = None, hexagons: Any = None, **changes: Any) -> Path:
    """An element file of a small shell in ``folder``, with ``changes`` of it and of its ``hexagons``."""
    folder.mkdir(parents=True, exist_ok=True)
    write_obj(folder / "shell.obj", cap() if mesh is None else mesh)
    template = yaml.safe_load((ROOT / "problems" / "dome_267" / "held.yaml").read_text())
    template["cell"] = str(ROOT / "problems" / "cells" / "two_irb4600_bow_gripper.yaml")
    (folder / "held.yaml").write_text(yaml.safe_dump(template))
    data = {
        "element": 1,
        "name": "small",
        "surface": {"mesh": {"file": "shell.obj", "unit": "mm"}},
        "thickness_mm": THICK,
        "panels": {"hexagons": {"count": 40, "least_edge_mm": 40, **(hexagons or {})}},
        "blocks": [{"size_mm": [1200, 1000, THICK], "foam": "eps_a120"}],
        "jobs": [{"problem": "held.yaml"}],
    }
    path = folder / "element.yaml"
    path.write_text(yaml.safe_dump({**data, **changes}))
    return path


@dataclasses.dataclass(frozen=True)
class WrittenPanel:
    """A panel as its problem file has it: outlines (C, 3) [mm] in its block's frame and in the element's,
    ``block`` (3,) [mm] in the middle of whose bottom face that is, and its row of ``element.json``."""

    bottom: np.ndarray
    top: np.ndarray
    local_outlines: tuple[np.ndarray, np.ndarray]
    block: np.ndarray
    row: dict[str, Any]


def read_panels(files: dict[str, str]) -> dict[str, WrittenPanel]:
    """All panels by their ids, out of the texts of a folder."""
    result = {}
    for row in json.loads(files["element.json"])["panels"]:
        data = yaml.load(
            files[f"panels/{row['id']}.yaml"], Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader)
        )
        (sides,) = data["part"]["ruled"]
        assert sides["closed"]
        assert sides["match"] == "parameter"
        assert data["part"]["in_stock"]["xyz_mm"] == [0, 0, 0]
        own = tuple(np.array(sides[end]["polyline_mm"]) for end in ("start", "end"))
        pose = np.array(row["block_pose"])
        bottom, top = (ring @ pose[:3, :3].T + pose[:3, 3] for ring in own)
        result[row["id"]] = WrittenPanel(
            bottom, top, (own[0], own[1]), np.array(data["stock"]["size_mm"]), row
        )
    return result
