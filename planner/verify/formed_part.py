"""What the swept balls of forming tools leave of the wanted faces: deviations at places, and a mesh."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planner.claims_forming import FormsSheet
from planner.geometry.mesh import TriangleMesh, face_normals
from planner.geometry.vectors import dots
from planner.units import MM
from planner.verify.forming_fit import short
from planner.verify.forming_state import Formed, Forming
from planner.verify.result import CutFace
from planner.verify.surface import areas, divided, vertex_normals

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

LEVEL = 1e-5
"""Triangles all of whose corners are so near to a level [m] are flat there."""
_SAMPLES = 40_000
_STEP = 0.002
_NEIGHBOURS = 16


def envelope(one: Formed) -> CutFace:
    """What the swept ball leaves of the walls of a face: how far it stays off (positive) or cuts in at their
    places; of flat parts nothing is said. Where a ball of that size cannot come nearer than the steps leave
    it, what it cannot reach is allowed too."""
    claim = one.claim
    rows = np.flatnonzero(_walls(claim))
    walls = claim.vertices[claim.faces[rows]]
    size = min(_STEP, float(np.sqrt(areas(walls).sum() / _SAMPLES)) * 2.0)
    parts, owner = divided(walls, max(size, 1e-4))
    area = areas(parts)
    points = parts.mean(axis=1)
    off = swept(one, points) - claim.radius
    allowed = claim.scallop[rows[owner]]
    # where no ball of its size comes nearer, that is what is left there
    off_by = np.flatnonzero(off > allowed)
    normals = face_normals(TriangleMesh(claim.vertices, claim.faces[rows]))[owner[off_by]]
    unreached = short(one.face, points[off_by], normals, claim.radius, claim.side)
    allowed[off_by] += unreached
    share = float(area[off <= allowed].sum() / max(float(area.sum()), 1e-30))
    known = np.isfinite(off)
    rms = float(np.sqrt((area[known] * off[known] ** 2).sum() / max(float(area[known].sum()), 1e-30)))
    largest = float(np.abs(off[known]).max(initial=0.0))
    return CutFace(
        claim.segment,
        points,
        np.where(known, off, np.nan),
        area,
        float(allowed.max(initial=0.0)),
        share,
        claim.share,
        rms,
        largest,
        allowed=allowed,
        unreached=float(unreached.max(initial=0.0)),
    )


def obj(forming: Forming) -> str:
    """The formed faces as OBJ text in mm: the walls of each with their vertices moved to where the ball
    leaves the sheet, at the level at which they are formed; empty where nothing is formed."""
    if not forming.formed:
        return ""
    lines = ["# the formed faces as simulated from the programs, without springback; sheet's frame, mm"]
    offset = 1
    for one in forming.formed:
        claim = one.claim
        own = np.unique(claim.faces[_walls(claim)])
        off = swept(one, claim.vertices[own]) - claim.radius
        moved = claim.vertices.copy()
        normals = vertex_normals(claim.vertices, claim.faces)[own]
        moved[own] += claim.side * np.where(np.isfinite(off), off, 0.0)[:, None] * normals
        lines.append(f"o {claim.segment.word}")
        lines += [f"v {x:.4f} {y:.4f} {z:.4f}" for x, y, z in (moved / MM).tolist()]
        lines += [f"f {a} {b} {c}" for a, b, c in (claim.faces + offset).tolist()]
        offset += len(claim.vertices)
    return "\n".join(lines) + "\n"


def _walls(claim: FormsSheet) -> BoolArray:
    """The triangles (F,) that are flat neither at the level of the start nor at that of the end."""
    level = claim.vertices[claim.faces][:, :, 2]
    flat = [(np.abs(level - z) < LEVEL).all(axis=1) for z in (claim.start, claim.end)]
    return np.asarray(~(flat[0] | flat[1]))


def swept(one: Formed, points: FloatArray) -> FloatArray:
    """How near (N,) [m] the ball's centre comes to points (N, 3) while it forms; infinite if never."""
    use = one.track.own[one.pieces.first]
    start, end = one.track.centre[one.pieces.first[use], 0], one.track.centre[one.pieces.last[use], 0]
    if not len(start):
        return np.full(len(points), np.inf)
    count = np.maximum(np.ceil(np.linalg.norm(end - start, axis=1) / _STEP).astype(np.int64), 1)
    which = np.repeat(np.arange(len(start)), count)
    step = (np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)) / count[which]
    way = end - start
    a = start[which] + step[:, None] * way[which]
    b = a + way[which] / count[which][:, None]
    near = np.asarray(cKDTree(0.5 * (a + b)).query(points, k=min(_NEIGHBOURS, len(a)))[1])
    near = near.reshape(len(points), -1)
    best = np.full(len(points), np.inf)
    for column in near.T:
        along, rest = b[column] - a[column], points - a[column]
        share = dots(rest, along) / np.maximum(dots(along, along), 1e-30)
        apart = np.linalg.norm(rest - np.clip(share, 0.0, 1.0)[:, None] * along, axis=1)
        best = np.minimum(best, apart)
    return best
