"""RAPID texts of jobs with a bow (``straight_job``, ``held_job``) as rows and moves, read and edited."""

from __future__ import annotations

import re

import numpy as np

from planner.geometry.arrays import exp_rotation, from_quaternion, to_quaternion
from tests.languages.rapid.rapid_edits import name
from tests.proof.registry import Texts, pick

MOVE = re.compile(
    r"MoveL \[\[(?P<pos>[^\]]*)\],\[(?P<orient>[^\]]*)\],\[(?P<conf>[^\]]*)\],\[(?P<ext>[^\]]*)\]\]"
    r"(?P<id>\\ID:=\d+)?,(?P<speed>\w+)\\T:=(?P<time>[\d.]+),(?P<zone>\w+),(?P<tool>\w+)\\WObj:=(?P<wobj>\w+);"
)

SIGNAL = "doWirePower"


def rows_of(texts: Texts, task: int, kind: str) -> list[str]:
    return texts[name(kind, task)].split("\n")


def put(texts: Texts, task: int, kind: str, rows: list[str]) -> Texts:
    return {**texts, name(kind, task): "\n".join(rows)}


def moves(texts: Texts, task: int, *procs: str) -> list[int]:
    """Rows of the moves of some procedures in the cut module."""
    out, here = [], ""
    for i, row in enumerate(rows_of(texts, task, "Cut1")):
        found = re.search(r"PROC (\w+)", row)
        here = found.group(1) if found else here
        if "MoveL" in row and here in procs:
            out.append(i)
    return out


def change(texts: Texts, task: int, i: int, **fields: str) -> Texts:
    """The move in row ``i`` of a cut module with other fields."""
    rows = rows_of(texts, task, "Cut1")
    found = MOVE.search(rows[i])
    assert found is not None
    p = {**found.groupdict(), **fields}
    rows[i] = (
        f"    MoveL [[{p['pos']}],[{p['orient']}],[{p['conf']}],[{p['ext']}]]{p['id'] or ''},"
        f"{p['speed']}\\T:={p['time']},{p['zone']},{p['tool']}\\WObj:={p['wobj']};"
    )
    return put(texts, task, "Cut1", rows)


def field(texts: Texts, task: int, i: int, which: str) -> str:
    found = MOVE.search(rows_of(texts, task, "Cut1")[i])
    assert found is not None
    return found.group(which)


def pose_of(texts: Texts, task: int, i: int):
    """Position (3,) [mm] and rotation (3, 3) of the target in a row."""
    position = np.array([float(v) for v in field(texts, task, i, "pos").split(",")])
    quaternion = np.array([float(v) for v in field(texts, task, i, "orient").split(",")])
    return position, from_quaternion(quaternion / np.linalg.norm(quaternion))


def placed(texts: Texts, task: int, i: int, position, rotation) -> Texts:
    """The target in a row at another pose; the quaternion keeps its sign."""
    old = np.array([float(v) for v in field(texts, task, i, "orient").split(",")])
    new = to_quaternion(rotation)
    new = -new if new @ old < 0.0 else new
    return change(
        texts,
        task,
        i,
        pos=",".join(f"{v:.4f}" for v in np.round(position, 4) + 0.0),
        orient=",".join(f"{v:.8f}" for v in np.round(new, 8) + 0.0),
    )


def tilted(texts: Texts, rows: list[int], angle: float, about: float = 0.0) -> Texts:
    """Rotate the wire across the face, about its direction of motion, by ``angle`` [rad].

    The centre of rotation is the point of the wire at ``about`` [mm] from its middle.
    """
    for k, i in enumerate(rows):
        position, rotation = pose_of(texts, 1, i)
        other, _ = pose_of(texts, 1, rows[k + 1] if k + 1 < len(rows) else rows[k - 1])
        x = rotation[:, 0]
        way = (other - position) * (1.0 if k + 1 < len(rows) else -1.0)
        way = way - (way @ x) * x
        turn = exp_rotation((angle * way / np.linalg.norm(way))[None])[0]
        centre = position + about * x
        texts = placed(texts, 1, i, centre + turn @ (position - centre), turn @ rotation)
    return texts


def outwards(texts: Texts, rows: list[int], by: float) -> Texts:
    """Move the wire off the face by ``by`` [mm], across itself and its direction of motion."""
    for k, i in enumerate(rows):
        position, rotation = pose_of(texts, 1, i)
        other, _ = pose_of(texts, 1, rows[k + 1] if k + 1 < len(rows) else rows[k - 1])
        normal = np.cross(other - position, rotation[:, 0])
        texts = placed(texts, 1, i, position + by * normal / np.linalg.norm(normal), rotation)
    return texts


def slid(texts: Texts, rows: list[int], by: float) -> Texts:
    """The bow moved along its wire."""
    for i in rows:
        position, rotation = pose_of(texts, 1, i)
        texts = placed(texts, 1, i, position + by * rotation[:, 0], rotation)
    return texts


def timed(texts: Texts, rows: list[int], factor: float) -> Texts:
    """Times of moves scaled, in all tasks, with a speed that fits."""
    for task in tasks(texts):
        own = moves(texts, task, *PROCS)
        place = {i: k for k, i in enumerate(moves(texts, 1, *PROCS))}
        for i in rows:
            if place[i] < len(own) and (task == 1 or field(texts, task, own[place[i]], "id")):
                row = own[place[i]]
                time = float(field(texts, task, row, "time")) * factor
                texts = change(texts, task, row, time=f"{time:.5f}", speed="v7000")
    return texts


def tasks(texts: Texts) -> list[int]:
    return [task for task in (1, 2) if name("Cut1", task) in texts]


FACES = ("top", "end", "back")
PROCS = tuple(
    ["approach", "retreat", "approach__2", "retreat__2"]
    + [f"cut_{face}{way}" for face in FACES for way in ("_in", "", "_out")]
)


def faces(texts: Texts) -> list[str]:
    return [face for face in FACES if moves(texts, 1, f"cut_{face}")]


def cutting(rng, texts: Texts) -> list[int]:
    """The moves of one face without its ends."""
    return moves(texts, 1, f"cut_{pick(rng, faces(texts))}")
