"""KRL texts of ``krl_job`` as rows and places, read and changed."""

from __future__ import annotations

import re

import numpy as np
from scipy.spatial.transform import Rotation

from tests.proof.registry import pick

MAIN, DATA, MOVES = "left/straight.src", "left/straight.dat", ("left/straight_1.src", "left/straight_2.src")
_PLACE = re.compile(r"\{X ([-\d.]+),Y ([-\d.]+),Z ([-\d.]+),A ([-\d.]+),B ([-\d.]+),C ([-\d.]+)")


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


def place_of(row):
    return np.array([float(value) for value in _PLACE.search(row).groups()])


def with_place(row, place):
    """The row with another place, with the decimals that targets have."""
    found = _PLACE.search(row)
    parts = [f"{n} {v + 0.0:.{4 if n in 'XYZ' else 5}f}" for n, v in zip("XYZABC", place, strict=True)]
    return row[: found.start()] + "{" + ",".join(parts) + row[found.end() :]


def moved(rng, row, size):
    """The row with its place off by ``size`` mm in a random direction."""
    place = place_of(row)
    way = rng.normal(size=3)
    place[:3] += size * way / np.linalg.norm(way)
    return with_place(row, place)


def turned(rng, row, degrees):
    """The row turned by an angle about a random axis."""
    place = place_of(row)
    axis = rng.normal(size=3)
    turn = Rotation.from_rotvec(np.deg2rad(degrees) * axis / np.linalg.norm(axis))
    place[3:] = (turn * Rotation.from_euler("ZYX", place[3:], degrees=True)).as_euler("ZYX", degrees=True)
    return with_place(row, place)
