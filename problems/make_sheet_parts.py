"""Writes the meshes of the sheet-forming problems into their folders: python problems/make_sheet_parts.py.

Every mesh is the face of a sheet that is flat, z = 0, at the mesh's edge; lengths are in mm.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import Delaunay

FloatArray = NDArray[np.float64]
HERE = Path(__file__).resolve().parent


def rounded_wall(outer: float, depth: float, angle: float, fillet: float, steps: int) -> FloatArray:
    """Inset from the outline and height (K, 2) [mm] down a wall of one angle [deg], both edges rounded;
    ``outer`` is how far outside the outline the flat begins."""
    a = np.deg2rad(angle)
    turn = np.linspace(0.0, a, 33)
    tangent = fillet * np.tan(0.5 * a)
    foot = depth / np.tan(a)
    top = np.stack([fillet * np.sin(turn) - tangent, fillet * (np.cos(turn) - 1.0)], axis=1)
    low = np.stack([foot + tangent - fillet * np.sin(turn), fillet * (1.0 - np.cos(turn)) - depth], axis=1)[
        ::-1
    ]
    share = np.linspace(0.0, 1.0, steps)[1:-1, None]
    return np.concatenate([[[-outer, 0.0]], top, (1.0 - share) * top[-1] + share * low[0], low])


def stitched(rings: FloatArray, centre: FloatArray) -> trimesh.Trimesh:
    """A surface through closed rings (M, K, 3), from outside to inside, closed by a fan around ``centre``."""
    count, around = rings.shape[:2]
    ring, step = np.meshgrid(np.arange(count - 1), np.arange(around), indexing="ij")
    a, b = ring * around + step, ring * around + (step + 1) % around
    c, d = a + around, b + around
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([b, d, c], -1).reshape(-1, 3)])
    last = (count - 1) * around + np.arange(around)
    fan = np.stack([last, np.roll(last, -1), np.full(around, count * around)], axis=1)
    return trimesh.Trimesh(np.vstack([rings.reshape(-1, 3), centre]), np.vstack([faces, fan]), process=False)


def revolved(radius: float, profile: FloatArray, around: int) -> trimesh.Trimesh:
    """A surface of revolution: ``profile`` (K, 2) is inset from ``radius`` and height, ending on a floor."""
    floor = np.linspace(radius - profile[-1, 0], 0.0, 10)[1:-1]
    line = np.concatenate([profile, np.stack([radius - floor, np.full(len(floor), profile[-1, 1])], axis=1)])
    angle = 2.0 * np.pi * np.arange(around) / around
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rings = np.concatenate(
        [(radius - line[:, 0])[:, None, None] * circle, np.repeat(line[:, 1, None, None], around, axis=1)],
        axis=2,
    )
    return stitched(rings, np.array([0.0, 0.0, profile[-1, 1]]))


def pyramid(half: float, corner: float, profile: FloatArray, around: int) -> trimesh.Trimesh:
    """A pyramid over a square of half side ``half`` with corners of radius ``corner`` that shrink with the
    inset, as those of walls of one angle do."""
    turn = np.linspace(0.0, 0.5 * np.pi, around // 8 + 1)
    rings = []
    for inset, height in profile:
        radius = corner - inset
        side = half - corner
        arc = np.stack([side + radius * np.cos(turn), side + radius * np.sin(turn)], axis=1)
        edge = np.linspace(arc[-1], [-arc[-1, 0], arc[-1, 1]], around // 8 + 1)[1:-1]
        quarter = np.concatenate([arc, edge])
        ring = []
        for _ in range(4):
            ring.append(quarter)
            quarter = np.stack([-quarter[:, 1], quarter[:, 0]], axis=1)
        flat = np.concatenate(ring)
        rings.append(np.column_stack([flat, np.full(len(flat), height)]))
    outline, height = np.array(rings), profile[-1, 1]
    for share in np.linspace(1.0, 0.0, 8)[1:-1]:
        shrunk = outline[len(profile) - 1] * np.array([share, share, 1.0])
        outline = np.concatenate([outline, shrunk[None]])
    return stitched(outline, np.array([0.0, 0.0, height]))


def bump(distance: FloatArray, radius: float, height: float) -> FloatArray:
    """A smooth bump: half a wave of a cosine over ``radius``."""
    inside = np.clip(distance / radius, 0.0, 1.0)
    return height * 0.5 * (1.0 + np.cos(np.pi * inside))


def nest() -> trimesh.Trimesh:
    """A dish of 300 mm, 24 mm deep, with six domes up out of its floor on a ring and three dimples further
    down inside the ring."""
    profile = rounded_wall(15.0, 24.0, 40.0, 14.0, 14)
    angle = 2.0 * np.pi * np.arange(6) / 6
    domes = [(78.0 * np.cos(t), 78.0 * np.sin(t), 25.0, 8.0) for t in angle]
    dimples = [(27.0 * np.cos(t), 27.0 * np.sin(t), 18.0, -5.0) for t in 2.0 * np.pi * np.arange(3) / 3 + 0.5]
    points = [np.zeros((1, 2))]
    for inset in profile[:, 0]:
        around = np.linspace(0.0, 2.0 * np.pi, 300, endpoint=False)
        points.append((150.0 - inset) * np.stack([np.cos(around), np.sin(around)], axis=1))
    grid = np.stack(np.meshgrid(np.arange(-115, 115, 5.0), np.arange(-115, 115, 5.0)), axis=-1).reshape(-1, 2)
    keep = np.linalg.norm(grid, axis=1) < 150.0 - profile[-1, 0] - 3.0
    for x, y, radius, _ in domes + dimples:
        keep &= np.linalg.norm(grid - [x, y], axis=1) > radius + 2.0
        for ring in np.linspace(0.0, radius, 20):
            count = max(int(2.0 * np.pi * ring / 1.6), 1)
            around = 2.0 * np.pi * np.arange(count) / count
            points.append(np.array([x, y]) + ring * np.stack([np.cos(around), np.sin(around)], axis=1))
    flat = np.unique(np.concatenate([*points, grid[keep]]).round(9), axis=0)
    far = np.linalg.norm(flat, axis=1)
    height = np.interp(150.0 - far, profile[:, 0], profile[:, 1])
    for x, y, radius, rise in domes + dimples:
        height += bump(np.linalg.norm(flat - [x, y], axis=1), radius, rise)
    return trimesh.Trimesh(np.column_stack([flat, height]), Delaunay(flat).simplices, process=False)


def funnel() -> trimesh.Trimesh:
    """A funnel of 70 mm whose wall goes from 20 to 33 degrees, 11 mm deep."""
    angle = np.deg2rad(np.linspace(20.0, 33.0, 31))
    run = np.full(30, 0.75)
    inset = np.concatenate([[-8.0, 0.0], np.cumsum(run)])
    height = np.concatenate([[0.0, 0.0], -np.cumsum(run * np.tan(0.5 * (angle[1:] + angle[:-1])))])
    return revolved(35.0, np.stack([inset, height], axis=1), 144)


def domed(outer: float, depth: float, ball: float, fillet: float) -> FloatArray:
    """Inset and height (K, 2) [mm] of a dome of height ``depth`` on a circle: a cap of a ball of radius
    ``ball`` whose foot runs out into the flat with a radius ``fillet``, from ``outer`` outside of the circle
    to the top's middle; the circle is where the fillet begins."""
    a = np.arccos((ball + fillet - depth) / (ball + fillet))
    turn = np.linspace(0.0, a, 12)
    foot = np.stack([fillet * np.sin(turn), fillet * (1.0 - np.cos(turn))], axis=1)
    turn = np.linspace(a, 0.0, 40)[1:]
    inset = (ball + fillet) * np.sin(a) - ball * np.sin(turn)
    cap = np.stack([inset, depth - ball * (1.0 - np.cos(turn))], axis=1)
    return np.concatenate([[[-outer, 0.0]], foot, cap])


def dome() -> tuple[trimesh.Trimesh, trimesh.Trimesh]:
    """The lower face of a dome of 25 mm, and a male die for it, a solid on a foot of its own."""
    ball, fillet, depth, around = 60.0, 10.0, 25.0, 144
    radius = float(np.sqrt((ball + fillet) ** 2 - (ball + fillet - depth) ** 2))
    profile = domed(8.0, depth, ball, fillet)
    line = np.stack([radius - profile[:, 0], profile[:, 1]], axis=1)
    angle = 2.0 * np.pi * np.arange(around) / around
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rings = [np.column_stack([r * circle, np.full(around, z)]) for r, z in line[:-1]]
    foot = np.array([[0.0, -50.0], [line[0, 0], -50.0]])
    die = trimesh.creation.revolve(np.concatenate([foot, line]), sections=around)
    return stitched(np.array(rings), np.array([0.0, 0.0, depth])), die


if __name__ == "__main__":
    revolved(203.2, rounded_wall(22.0, 165.0, 60.0, 12.0, 26), 288).export(HERE / "cone_dpif_l" / "cone.ply")
    revolved(55.0, rounded_wall(11.0, 25.0, 45.0, 8.0, 16), 144).export(HERE / "cone_spif" / "cone.ply")
    sump = rounded_wall(0.0, 4.0, 30.0, 8.0, 6)[1:]
    profile = np.vstack([rounded_wall(9.0, 12.0, 35.0, 8.0, 12), sump + np.array([29.0, -12.0])])
    revolved(45.0, profile, 96).export(HERE / "dish_apertures" / "dish.ply")
    pyramid(60.0, 24.0, rounded_wall(12.0, 40.0, 75.0, 8.0, 20), 160).export(
        HERE / "pyramid_steep" / "pyramid.ply"
    )
    nest().export(HERE / "multi_feature" / "nest.ply")
    funnel().export(HERE / "funnel_adsif" / "funnel.ply")
    part, die = dome()
    part.export(HERE / "dome_tpif" / "dome.ply")
    die.export(HERE / "dome_tpif" / "die.ply")
