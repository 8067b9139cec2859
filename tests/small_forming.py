"""A forming job that is planned and proven in seconds: a round dish of 60 mm, coarse steps."""

from __future__ import annotations

import copy
import itertools
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
import yaml

from planner.catalogue.robots import data_dir
from planner.geometry.arrays import Mesh
from planner.geometry.units import MM
from tests.processes.forming.plan.shapes import revolved

CELLS = data_dir("problems") / "cells"
HEAT = {"kind": "heat_tool", "radius_mm": 15, "length_mm": 250, "standoff_mm": 20}
DISK = {"kind": "disk_tool", "radius_mm": 20, "length_mm": 250, "thickness_mm": 8, "shaft_radius_mm": 10}


def dish(
    radius: float = 30.0, depth: float = 6.0, angle: float = 40.0, fillet: float = 7.0, around: int = 96
) -> Mesh:
    """A dish [m] that goes down, its wall of one angle [deg] rounded into flat and floor; sizes in mm."""
    a = np.deg2rad(angle)
    turn = np.linspace(0.0, a, 13)
    tangent, foot = fillet * np.tan(0.5 * a), depth / np.tan(a)
    top = [(radius - fillet * np.sin(t) + tangent, fillet * (np.cos(t) - 1.0)) for t in turn]
    low = [(radius - foot - tangent + fillet * np.sin(t), fillet * (1.0 - np.cos(t)) - depth) for t in turn]
    steps = [tuple((1.0 - s) * np.array(top[-1]) + s * np.array(low[-1])) for s in np.linspace(0, 1, 8)[1:-1]]
    floor = [(fraction * low[0][0], -depth) for fraction in (0.75, 0.5, 0.25, 0.0)]
    profile = [(radius + tangent + 4.0, 0.0), *top, *steps, *low[::-1], *floor]
    return revolved([(float(r) * MM, float(z) * MM) for r, z in profile], around)


def problem(mode: str = "spif", **operation: Any) -> dict[str, Any]:
    """The problem as a file has it: one IRB 140 over a lying sheet, or two arms that face each other."""
    alone = mode in ("spif", "tpif")
    name = "irb140_ball.yaml" if alone else "irb6640_irb4400_small_tools.yaml"
    cell = yaml.safe_load((CELLS / name).read_text())
    sheet: dict[str, Any] = {"size_mm": [160, 160], "thickness_mm": 1, "metal": "aa1100_o", "opening_mm": 100}
    if alone:
        sheet |= {"clamp": {"width_mm": 30, "above_mm": 10, "below_mm": 60}}
    else:
        sheet |= {"size_mm": [200, 200], "opening_mm": 120, "stand": "upright"}
    arms = ["robot"] if alone else ["left", "right"]
    own = {"name": "dish", "process": "forming", "arms": arms, "mode": mode, "feed_mm_s": 25, **operation}
    if "scallop_mm" not in own:
        own.setdefault("stepdown_mm", 2)
    if mode == "heat":
        cell["arms"][1]["tool"] = copy.deepcopy(HEAT)
    if mode == "adsif":
        sheet["metal"] = "aa5754_o"
        own["stepdown_mm"] = 0.2
    return {
        "tandem": 1,
        "name": "dish",
        "cell": cell,
        "sheet": sheet,
        "part": {"sheet_mesh": {"file": "part.ply", "unit": "mm", "face": "bottom"}},
        "settings": {"clearance_mm": 5},
        "operations": [own],
    } | ({"accept": ["forming.force"]} if alone else {})  # an IRB 140 does not carry it


def write(folder: Path, data: dict[str, Any], part: Mesh | None = None) -> Path:
    """Write problem and part into ``folder``; the path of the problem file."""
    mesh = dish() if part is None else part
    trimesh.Trimesh(mesh.vertices / MM, mesh.faces, process=False).export(folder / "part.ply")
    path = folder / "problem.yaml"
    path.write_text(yaml.safe_dump(data))
    return path


def upside_down(mesh: Mesh) -> Mesh:
    """The same part going the other way; its normals are up again."""
    return Mesh(mesh.vertices * [1.0, 1.0, -1.0], mesh.faces[:, ::-1])


def die(folder: Path, part: Mesh, kind: str, full: bool) -> dict[str, Any]:
    """A die for a dish or dome (`dish`) as a problem file states it, its mesh written into ``folder``: the
    part's lower face a little lower, whole, or only its rim (female) or top (male)."""
    distance = np.linalg.norm(part.vertices[part.faces].mean(axis=1)[:, :2], axis=1) > 22.0 * MM
    kept = part.faces if full else part.faces[distance if kind == "female" else ~distance]
    lower = part.vertices / MM - [0.0, 0.0, 0.02]
    trimesh.Trimesh(lower, kept, process=False).export(folder / "die.ply")
    spec: dict[str, Any] = {"file": "die.ply", "unit": "mm", "kind": kind, "full": full}
    return spec if kind == "female" else {**spec, "holder": "sinking", "step_mm": 1}


def dish_with_a_dome(around: int = 180) -> Mesh:
    """A dish of 40 degrees and 8 mm, a dome of 35 degrees and 5 mm up on its floor, edges rounded by 7 mm."""
    down, up = np.tan(np.deg2rad(40.0)), np.tan(np.deg2rad(35.0))
    corners = [(54, 0), (44, 0), (44 - 8 / down, -8), (14, -8), (14 - 5 / up, -3), (0, -3)]
    profile = [np.array(corners[0], dtype=float)]
    for before, corner, after in zip(corners, corners[1:], corners[2:], strict=False):
        middle = np.array(corner, dtype=float)
        arms = [(end - middle) / np.linalg.norm(end - middle) for end in (before, after)]
        half = 0.5 * np.arccos(arms[0] @ arms[1])
        centre = middle + (arms[0] + arms[1]) / np.linalg.norm(arms[0] + arms[1]) * 7.0 / np.sin(half)
        ends = [middle + 7.0 / np.tan(half) * arm - centre for arm in arms]
        turn = np.pi - 2.0 * half
        for s in np.linspace(0.0, 1.0, 9):
            mixed = (np.sin((1.0 - s) * turn) * ends[0] + np.sin(s * turn) * ends[1]) / np.sin(turn)
            profile.append(centre + mixed)
    profile.append(np.array(corners[-1], dtype=float))
    dense = [profile[0]]
    for item, two in itertools.pairwise(profile):
        count = max(1, int(np.ceil(np.linalg.norm(two - item) / 1.5)))
        dense += [item + (two - item) * k / count for k in range(1, count + 1)]
    return revolved([(float(r) * MM, float(z) * MM) for r, z in dense], around)
