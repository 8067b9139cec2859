"""Deliberate faults of forming jobs."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from bench.corpus import meshes, sheets
from bench.corpus.foams import UNREACHABLE
from bench.corpus.job import Draft, Draw, Fault
from planner.geometry.arrays import FloatArray


def _part(draft: Draft, mesh: meshes.Mesh, scale: float = 1.0) -> None:
    """Put another mesh in place of the part, in mm."""
    draft.files = {n: c for n, c in draft.files.items() if n == "die.ply"} | {
        "part.obj": meshes.obj(mesh, scale)
    }
    draft.problem["part"] = {"sheet_mesh": {"file": "part.obj", "unit": "mm", "face": "bottom"}}


def _cone(draft: Draft, angle: float, fillet: float, depth: float = 14.0) -> meshes.Mesh:
    line = sheets.profile(sheets.wall(depth, angle, 12.0 if depth >= 14 and angle < 60 else 4.0, fillet))
    return sheets.turned_surface(max(draft.facts["half"], line[-1, 0] + 4.0), line)


def _ball(draft: Draft, draw: Draw) -> None:
    """A floor fillet of 2 mm, itself a radius, under a ball of 8 mm."""
    for arm in draft.cell["arms"]:
        if arm["tool"]["kind"] == "ball_tool":
            arm["tool"]["radius_mm"] = 8.0
    _part(draft, _cone(draft, 45.0, 2.0))
    draft.operation.pop("share", None)


def _sharp(draft: Draft, draw: Draw) -> None:
    """A sharp floor under a ball of 9.5 mm: at 55 degrees its distance is 1.2 mm, 9.5 (1 / cos 27.5 - 1)."""
    for arm in draft.cell["arms"]:
        if arm["tool"]["kind"] == "ball_tool":
            arm["tool"]["radius_mm"] = 9.5
    line = sheets.profile(sheets.wall(15.0, 55.0, 0.0, 0.0))
    _part(draft, sheets.turned_surface(max(draft.facts["half"], 40.0), line))
    draft.operation.update(share=0.95, unreached_mm=0.5)


def _steep(draft: Draft, draw: Draw) -> None:
    """A wall of 89.7 degrees: no pass can form it."""
    profile = np.array(
        [[_outer(draft), 0.0], [draft.facts["half"], 0.0], [draft.facts["half"] - 0.1, -18.0], [0.0, -18.0]]
    )
    _part(draft, meshes.revolve(meshes.round_corners(profile.tolist(), [0.0, 0.0]), 96))


def _outer(draft: Draft) -> float:
    return float(draft.facts["half"]) + sheets.FLAT


def _undercut(draft: Draft, draw: Draw) -> None:
    h = draft.facts["half"]
    profile = [(h + 8, 0.0), (h, 0.0), (h - 6, -9.0), (h - 2, -14.0), (h - 15, -18.0), (0.0, -18.0)]
    _part(draft, meshes.revolve(meshes.round_corners(profile, [0.0] * 4), 96))


def _up(draft: Draft, draw: Draw) -> None:
    line = sheets.profile(sheets.wall(14.0, 35.0, 12.0, 12.0)) * [1.0, -1.0]
    _part(draft, sheets.turned_surface(max(draft.facts["half"], line[-1, 0] + 4.0), line))


def _wide(draft: Draft, draw: Draw) -> None:
    own = draft.problem["sheet"]
    opening = 2.0 * draft.facts["half"] - 10.0
    own["opening_mm"] = round(opening) if not isinstance(own["opening_mm"], list) else [round(opening)] * 2


def _unit(draft: Draft, draw: Draw) -> None:
    _part(draft, _cone(draft, 40.0, 12.0), 0.001)


def _closed(draft: Draft, draw: Draw) -> None:
    points, faces = _cone(draft, 40.0, 12.0)
    ring = np.arange(144)
    lid = np.stack([(ring + 1) % 144, ring, np.full(144, len(points))], axis=1)
    _part(draft, (np.vstack([points, [[0.0, 0.0, 0.0]]]), np.vstack([faces, lid])))


def _inside_out(draft: Draft, draw: Draw) -> None:
    points, faces = _cone(draft, 40.0, 12.0)
    mixed = faces.copy()
    mixed[::3] = mixed[::3, ::-1]
    _part(draft, (points, mixed))


def _rim(draft: Draft, draw: Draw) -> None:
    """A rim that rises by 6 mm to one side: it lies in no flat sheet."""
    points, faces = _cone(draft, 40.0, 12.0)
    distance = np.hypot(points[:, 0], points[:, 1])
    outer = distance > distance.max() - 1e-6
    points[outer, 2] += 3.0 + 3.0 * points[outer, 0] / distance.max()
    _part(draft, (points, faces))


def _flat(draft: Draft, draw: Draw) -> None:
    points, faces = _cone(draft, 40.0, 12.0)
    _part(draft, (points * [1.0, 1.0, 0.0], faces))


def _metal(draft: Draft, draw: Draw) -> None:
    draft.problem["sheet"]["metal"] = "aa6061_t6"


def _hole(draft: Draft, draw: Draw) -> None:
    """A hole in the middle of the floor."""
    points, faces = _cone(draft, 40.0, 12.0)
    distance = np.hypot(points[:, 0], points[:, 1])
    _part(draft, (points, faces[(distance[faces] > 5.5).all(axis=1)]))


def _no_steps(draft: Draft, draw: Draw) -> None:
    draft.operation.pop("scallop_mm", None)
    draft.operation.pop("stepdown_mm", None)


def _shift(draft: Draft, draw: Draw) -> None:
    draft.operation.update(mode="dpif_l", shift_deg=70)
    _part(draft, _cone(draft, 40.0, 12.0))


def _disk_forms(draft: Draft, draw: Draw) -> None:
    draft.cell["arms"][0]["tool"] = {"kind": "disk_tool", "radius_mm": 20, "length_mm": 300}


def _alone(draft: Draft, draw: Draw) -> None:
    draft.operation["arms"] = ["left"]


def _weak(draft: Draft, draw: Draw) -> None:
    """Twenty kilonewton, where the strongest arm carries two."""
    draft.operation["force_n"] = 20000


def _no_room(draft: Draft, draw: Draw) -> None:
    """An opening hardly wider than the part: the tool that goes round outside of it is in the clamp."""
    own = draft.problem["sheet"]
    opening = math.ceil(2.0 * (draft.facts["half"] + sheets.FLAT) + 2)
    own["opening_mm"] = [opening] * 2


def _too_steep(draft: Draft, draw: Draw) -> None:
    line = sheets.profile([(sheets.FLAT, 0.0, 0.0), (18.0, 48.0, 48.0)], 0.75)
    _part(draft, sheets.turned_surface(38.0, line))


def _adsif_metal(draft: Draft, draw: Draw) -> None:
    draft.problem["sheet"]["metal"] = "aa1100_o"


def _adsif_ball(draft: Draft, draw: Draw) -> None:
    for arm in draft.cell["arms"]:
        arm["tool"]["radius_mm"] = 8.0


def _adsif_sheet(draft: Draft, draw: Draw) -> None:
    draft.problem["sheet"]["thickness_mm"] = 1.5


def _no_die(draft: Draft, draw: Draw) -> None:
    draft.operation.pop("die")


def _die_high(draft: Draft, draw: Draw) -> None:
    """The die protrudes 2 mm into the part."""
    die = draft.files["die.ply"].decode().splitlines()
    start = die.index("end_header") + 1
    count = int(next(row for row in die if row.startswith("element vertex")).split()[-1])
    for k in range(start, start + count):
        x, y, z = map(float, die[k].split())
        die[k] = f"{x:.5f} {y:.5f} {z + 2.0:.5f}"
    draft.files["die.ply"] = ("\n".join(die) + "\n").encode()


def _holder(draft: Draft, draw: Draw) -> None:
    """A holder that sinks over a female die, or a fixed one over a male die."""
    die = draft.operation["die"]
    die["holder"] = "sinking" if die["kind"] == "female" else "fixed"
    die.pop("step_mm", None)
    if die["kind"] == "female":
        die["step_mm"] = 0.5


def _touching(draft: Draft, draw: Draw) -> None:
    """Two dishes whose rims overlap by 4 mm: it is undefined which of them forms the region between."""

    def height(x: FloatArray, y: FloatArray) -> FloatArray:
        near = np.minimum(np.hypot(x - 23.0, y), np.hypot(x + 23.0, y))
        return np.asarray(np.interp(near, [0.0, 10.0, 25.0], [-10.0, -10.0, 0.0]))

    line = np.linspace(-60, 60, 121)
    _part(draft, meshes.grid(line, line, height))


TOOL: Final = Fault(
    "a floor fillet of 2 mm is narrower than the ball of R 8",
    ("forming.tool_radius", "forming.support_radius"),
    _ball,
)
SHARP: Final = Fault(
    "a sharp floor that a ball of R 9.5 stays 1.2 mm off, more than the 0.5 mm stated",
    ("forming.tool_radius", "forming.unreached"),
    _sharp,
)
COMMON: Final = [
    TOOL,
    Fault("a wall of 89.7 degrees", ("forming.wall_angle",), _steep),
    UNREACHABLE,
    Fault("the part is wider than the opening", ("part.stock_too_small", "forming.clamp"), _wide),
    SHARP,
    Fault("the wall turns over", ("forming.undercut",), _undercut),
    Fault("the mesh is in metres and said to be in mm", ("mesh.unit",), _unit),
    Fault("a sheet metal that nobody knows", ("forming.unknown_metal",), _metal),
    Fault("the mesh is closed", ("forming.closed_mesh", "mesh.closed"), _closed),
    Fault("faces look to different sides", ("forming.inside_out", "mesh.orientation"), _inside_out),
    Fault("the rim is not flat", ("forming.border",), _rim),
    Fault("nothing of the part leaves the sheet", ("forming.flat",), _flat),
    Fault("the part has a hole", ("forming.hole", "forming.border"), _hole),
    Fault("neither a step nor a ridge height is given", ("problem.field", "forming.path_options"), _no_steps),
]
ONE_ARM: Final = [
    *COMMON[:6],
    Fault("the part goes up, and the only tool is above", ("forming.side",), _up),
    *COMMON[6:],
]
TWO_ARMS: Final = [
    COMMON[0],
    Fault("a force of 20 kN, far beyond what the arms carry", ("forming.force",), _weak),
    *COMMON[1:4],
    Fault(
        "one arm alone where the mode needs two",
        ("problem.field", "forming.tool", "forming.support_tool"),
        _alone,
    ),
    *COMMON[4:],
]
SUPPORTED: Final = [
    Fault("the support is turned by more than the wall's angle", ("forming.shift",), _shift),
    *TWO_ARMS,
]
BORDER: Final = [
    Fault("the opening leaves no room for the tool outside of the part", ("forming.clamp",), _no_room),
    Fault("a disk is to form", ("forming.tool",), _disk_forms),
    *TWO_ARMS,
]
ADSIF: Final = [
    Fault("a wall steeper than the table", ("forming.adsif_range",), _too_steep),
    Fault("a metal that the table does not hold for", ("forming.adsif_conditions",), _adsif_metal),
    Fault("balls that the table does not hold for", ("forming.adsif_conditions",), _adsif_ball),
    Fault("a sheet that the table does not hold for", ("forming.adsif_conditions",), _adsif_sheet),
    UNREACHABLE,
]
TPIF: Final = [
    Fault("the mode needs a die", ("problem.field", "forming.holder"), _no_die),
    Fault("the die stands in the part", ("forming.die_gouge",), _die_high),
    Fault("die and holder do not go together", ("forming.holder", "problem.field"), _holder),
    UNREACHABLE,
    Fault("a sheet metal that nobody knows", ("forming.unknown_metal",), _metal),
    Fault("two dishes overlap", ("forming.touching", "forming.holder", "forming.die_gouge"), _touching),
]
