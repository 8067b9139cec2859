"""What must hold of a forming job, as claims, from the problem alone."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.claims import Claim, FormsInOrder, FormsSheet, SheetState, ToolGap
from planner.forming.job import Job, segment
from planner.forming.operation import GAPPED
from planner.forming.thickness import by_corner
from planner.forming.values import Pass
from planner.forming_tools import profile
from planner.geometry.mesh import TriangleMesh, face_areas, face_normals
from planner.units import DEG, MM

FloatArray = NDArray[np.float64]

FLATTEST: Final = 2.0 * DEG
"""Walls flatter than this count as flat: no finite steps leave them without ridges."""


def claims(job: Job) -> tuple[Claim, ...]:
    """The claims of all passes."""
    out: list[Claim] = [FormsInOrder(tuple(segment(one) for one in job.passes))]
    for one in job.passes:
        out += _of(job, one)
    return tuple(out)


def _of(job: Job, one: Pass) -> list[Claim]:
    op, arm, other = job.operation, job.former(one), job.supporter(one)
    radius = job.heads[arm].radius
    return [
        FormsSheet(
            segment(one),
            arm,
            one.side,
            radius,
            one.vertices,
            one.faces,
            one.start,
            one.end,
            op.gouge_tol_mm * MM,
            scallop(job, one) + op.gouge_tol_mm * MM,
            op.share,
        ),
        _state(job, one),
        *([] if other is None else _support(job, one, arm, other)),
    ]


def _state(job: Job, one: Pass) -> SheetState:
    none = np.zeros((0, 3))
    arms = tuple(filter(None, (job.former(one), job.supporter(one))))
    heads = tuple(profile(job.heads[arm]) for arm in arms)
    tolerance = job.operation.gouge_tol_mm * MM
    return SheetState(segment(one), arms, one.side, one.start, none, none, heads, tolerance)


def _support(job: Job, one: Pass, arm: str, other: str) -> list[Claim]:
    op = job.operation
    if op.mode not in GAPPED:
        return []
    vertices, faces, thick = by_corner(one, job.thickness)
    radii = (job.heads[arm].radius, job.heads[other].radius)
    gap, tolerance = op.squeeze * thick, op.gap_tol_mm * MM
    return [ToolGap(segment(one), (arm, other), one.side, radii, vertices, faces, gap, tolerance)]


def scallop(job: Job, one: Pass) -> float:
    """Height [m] of the ridges that the steps leave on ``share`` of the walls: the stated one, or that of the
    stated step h = R - sqrt(R^2 - (dz / (2 sin a))^2), at the wall angle a that the share stays above."""
    op, radius = job.operation, job.heads[job.former(one)].radius
    if op.scallop_mm is not None:
        return op.scallop_mm * MM
    mesh = TriangleMesh(one.vertices, one.faces)
    angle = np.arccos(np.clip(face_normals(mesh)[:, 2], -1.0, 1.0))
    area = np.where(angle > FLATTEST, face_areas(mesh), 0.0)
    order = np.argsort(angle)
    passed = np.cumsum(area[order]) / max(float(area.sum()), 1e-12)
    flattest = float(angle[order[int(np.searchsorted(passed, 0.5 * (1.0 - op.share)))]])
    half = min(0.5 * (op.stepdown_mm or 0.0) * MM / np.sin(max(flattest, FLATTEST)), radius)
    return float(radius - np.sqrt(radius**2 - half**2))
