"""KRL texts of ``krl_job`` as rows and poses, read and edited."""

from __future__ import annotations

import re

import numpy as np
from scipy.spatial.transform import Rotation

from tests.proof.registry import pick

MAIN, DATA, MOVES = "left/straight.src", "left/straight.dat", ("left/straight_1.src", "left/straight_2.src")
_POSE = re.compile(r"\{X ([-\d.]+),Y ([-\d.]+),Z ([-\d.]+),A ([-\d.]+),B ([-\d.]+),C ([-\d.]+)")


def rows_of(texts, file):
    return texts[file].split("\r\n")


def put(texts, file, rows):
    return {**texts, file: "\r\n".join(rows)}


def where(rows, pattern):
    """Indices of the rows that match."""
    return [i for i, row in enumerate(rows) if re.search(pattern, row)]


def edit(rng, texts, file, pattern, new):
    """Texts with one of the rows that match changed by ``new``, a function of the row."""
    rows = rows_of(texts, file)
    i = pick(rng, where(rows, pattern))
    changed = new(rows[i])
    assert changed != rows[i], (file, rows[i])
    rows[i : i + 1] = changed.split("\n") if changed else []
    return put(texts, file, rows)


def pose_of(row):
    return np.array([float(value) for value in _POSE.search(row).groups()])


def with_pose(row, pose):
    """Return the row with another pose, with the decimals of targets."""
    found = _POSE.search(row)
    parts = [f"{n} {v + 0.0:.{4 if n in 'XYZ' else 5}f}" for n, v in zip("XYZABC", pose, strict=True)]
    return row[: found.start()] + "{" + ",".join(parts) + row[found.end() :]


def moved(rng, row, size):
    """Return the row with its position shifted by ``size`` mm in a random direction."""
    place = pose_of(row)
    way = rng.normal(size=3)
    place[:3] += size * way / np.linalg.norm(way)
    return with_pose(row, place)


def rotated(rng, row, degrees):
    """The row turned by an angle about a random axis."""
    place = pose_of(row)
    axis = rng.normal(size=3)
    turn = Rotation.from_rotvec(np.deg2rad(degrees) * axis / np.linalg.norm(axis))
    place[3:] = (turn * Rotation.from_euler("ZYX", place[3:], degrees=True)).as_euler("ZYX", degrees=True)
    return with_pose(row, place)
