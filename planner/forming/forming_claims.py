"""What must hold of a forming job, as claims, from the problem alone."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.claims import Claim, FollowsPoses
from planner.claims_forming import (
    FollowsOpposite,
    FormingFeed,
    FormsInOrder,
    FormsSheet,
    SheetState,
    SupportsBorder,
    ToolGap,
)
from planner.forming import holder, ridges
from planner.forming.border import border_curve
from planner.forming.job import Job, segment
from planner.forming.operation import GAPPED
from planner.forming.opposite import FACING
from planner.forming.state import State, states
from planner.forming.thickness import by_corner
from planner.forming.values import Pass
from planner.geometry.mesh import TriangleMesh
from planner.tooling import profile
from planner.units import DEG, MM

FloatArray = NDArray[np.float64]

BORDER: Final = 0.5 * MM
"""How far a support may be off the border that it runs along."""
OPPOSITE: Final = 2.0 * MM
"""How far a source of heat may be off its place opposite the forming ball."""
AIMED: Final = 10.0 * DEG
"""How far that place may be off the face's normal, and the nozzle off what is between that and the vertical:
it follows the smooth face, not its facets."""


def claims(job: Job, poses: dict[str, FloatArray] | None = None) -> tuple[Claim, ...]:
    """The claims of all passes; ``poses`` {arm: (N, 4, 4)} are those of both tools where the part's face does
    not tell where they are (adsif)."""
    found = states(job.tree, job.mesh, job.passes, job.thickness)
    out: list[Claim] = [FormsInOrder(tuple(segment(one) for one in job.passes))]
    sinking = holder.claim(job)
    if sinking is not None:
        out.append(sinking)
    for one, state in zip(job.passes, found, strict=True):
        out.append(_state(job, one, state))
        out.append(FormingFeed(segment(one), job.operation.arms, job.operation.feed_mm_s * MM))
        if poses is None:
            out += _of(job, one)
    if poses is not None:
        spin = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
        tolerance = (0.5 * job.operation.gap_tol_mm * MM, 0.05 * DEG + job.operation.cone_deg * DEG)
        out += [FollowsPoses(arm, "stock", poses[arm], (spin,), *tolerance) for arm in job.operation.arms]
    return tuple(out)


def scallop(job: Job, one: Pass) -> FloatArray:
    """Height (F,) [m] of the ridges that the path leaves at the triangles of a pass: the stated one, or that
    of the stated step."""
    op, radius = job.operation, job.heads[job.former(one)].radius
    if op.stepdown_mm is None:
        return np.full(len(one.faces), (op.scallop_mm or 0.0) * MM)
    return ridges.heights(TriangleMesh(one.vertices, one.faces), radius, op.stepdown_mm * MM, op.share)


def _state(job: Job, one: Pass, state: State) -> SheetState:
    arms = tuple(filter(None, (job.former(one), job.supporter(one))))
    heads = tuple(profile(job.heads[arm]) for arm in arms)
    return SheetState(segment(one), arms, one.side, one.start, state.fixed, state.carried, heads, job.pressed)


def _of(job: Job, one: Pass) -> list[Claim]:
    op, arm, other = job.operation, job.former(one), job.supporter(one)
    radius, gouge = job.heads[arm].radius, op.gouge_tol_mm * MM
    ridge = scallop(job, one) + gouge
    face = (one.vertices, one.faces)
    out: list[Claim] = [
        FormsSheet(segment(one), arm, one.side, radius, *face, one.start, one.end, gouge, ridge, op.share)
    ]
    if other is None:
        return out
    if op.mode in GAPPED:
        vertices, faces, thick = by_corner(one, job.thickness)
        gap, tolerance = op.squeeze * thick, op.gap_tol_mm * MM
        radii, step = (radius, job.heads[other].radius), op.handshake_gap_mm * MM
        out.append(
            ToolGap(
                segment(one),
                (arm, other),
                one.side,
                radii,
                vertices,
                faces,
                gap,
                tolerance,
                turn=FACING,
                handshake=step,
            )
        )
    elif op.mode == "dpif_p":
        border = border_curve(one, job.heads[other], job.thickness)
        out.append(SupportsBorder(segment(one), other, border, BORDER))
    else:
        away = radius + float(np.median(one.thickness))
        aim = AIMED + op.cone_deg * DEG
        out.append(FollowsOpposite(segment(one), (arm, other), one.side, *face, away, OPPOSITE, AIMED, aim))
    return out
