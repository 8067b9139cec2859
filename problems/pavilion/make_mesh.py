"""Writes pavilion.obj, in millimetres: a shell of 8 x 8 m on three legs, 2.5 m high, open at the top.

Its form is that of a net which hangs from its feet, turned over, by force densities (H.-J. Schek, The force
density method for form finding and computation of general networks, 1974): each string pulls in proportion to
its length, so where the knots come to rest is a linear system. Strings along the free edges and round the
opening pull harder. Feet are curved in plan, or the legs would be flat across.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.sparse import coo_array, csc_array, diags_array
from scipy.sparse.linalg import spsolve

LEGS, HIGH, REACH = 3, 2.5, 4.0  # m
FOOT, CURL = 3.4, 0.15  # m across a foot; how far its ends are drawn in
BAY, OPENING = 2.6, 0.6  # m from the middle to the free edges and to the opening, before the net hangs
EDGE, TOP = 6.0, 8.0  # force densities along free edges and opening, 1 elsewhere
RINGS, AROUND = 24, 144


def outline(angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Radius [m] of the plan at each angle, and where a foot is."""
    pitch = 2.0 * np.pi / LEGS
    off = np.abs((angle + 0.5 * pitch) % pitch - 0.5 * pitch)  # from the nearest leg
    half = np.arctan2(0.5 * FOOT, REACH)
    foot = off <= half + 1e-9
    standing = REACH / np.cos(off) * (1.0 - CURL * (off / half) ** 2)
    corner = REACH / np.cos(half) * (1.0 - CURL)
    free = BAY + (corner - BAY) * (1.0 - (off - half) / (0.5 * pitch - half)) ** 2
    return np.where(foot, standing, free), foot


def net() -> tuple[np.ndarray, np.ndarray]:
    """Knots (V, 3) [m] at rest, and triangles (F, 3)."""
    angle = 2.0 * np.pi * np.arange(AROUND) / AROUND
    radius, foot = outline(angle)
    r = OPENING + (radius - OPENING) * np.linspace(0.0, 1.0, RINGS + 1)[:, None]
    plan = np.stack([r * np.cos(angle), r * np.sin(angle)], axis=-1).reshape(-1, 2)
    knot = np.arange(len(plan)).reshape(RINGS + 1, AROUND)
    beside = np.roll(knot, -1, axis=1)
    strings = np.concatenate(
        [
            np.stack([knot[:-1].ravel(), knot[1:].ravel()], axis=1),
            np.stack([knot.ravel(), beside.ravel()], axis=1),
        ]
    )
    round_it = np.ones((RINGS + 1, AROUND))
    round_it[0], round_it[-1] = TOP, EDGE
    density = np.concatenate([np.ones(RINGS * AROUND), round_it.ravel()])
    rows = np.repeat(np.arange(len(strings)), 2)
    ends = np.tile([1.0, -1.0], len(strings))
    branch = coo_array((ends, (rows, strings.ravel())), shape=(len(strings), len(plan))).tocsr()
    matrix = csc_array(branch.T @ diags_array(density) @ branch)

    corners = (knot[:-1], knot[1:], beside[1:]), (knot[:-1], beside[1:], beside[:-1])
    faces = np.concatenate([np.stack([c.ravel() for c in three], axis=1) for three in corners])
    a, b = plan[faces[:, 1]] - plan[faces[:, 0]], plan[faces[:, 2]] - plan[faces[:, 0]]
    load = np.zeros(len(plan))
    np.add.at(load, faces.ravel(), np.repeat(np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 6.0, 3))

    held = knot[-1][foot]
    free = np.setdiff1d(knot, held)
    at = np.zeros((len(plan), 3))
    at[held, :2] = plan[held]
    pulled = -matrix[free][:, held] @ at[held]
    pulled[:, 2] += load[free]
    at[free] = np.stack([spsolve(matrix[free][:, free], pulled[:, k]) for k in range(3)], axis=1)
    at[:, 2] *= HIGH / at[:, 2].max()
    return at, faces


def main() -> None:
    """Write the mesh beside this file."""
    at, faces = net()
    lines = ["# pavilion on three legs, millimetres, written by make_mesh.py"]
    lines += [f"v {x:.3f} {y:.3f} {z:.3f}" for x, y, z in (1e3 * at + 0.0).tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (faces + 1).tolist()]
    (Path(__file__).parent / "pavilion.obj").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
