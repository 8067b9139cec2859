"""What must hold of a milling job, as claims, from the problem alone."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.claims import Claim, ConfirmedPower, ContactOnlyIn, FeedWindow
from planner.claims_milling import MillsAlong, MillsSurface, SparesPart
from planner.milling import spoken
from planner.milling.gcode_file import GCodeCut
from planner.milling.job import Done, Job
from planner.milling.operation import FlankCut
from planner.milling.route import ends
from planner.milling.values import Run, ToolPath
from planner.segments import Phase
from planner.units import DEG, MM

FloatArray = NDArray[np.float64]

TURN: Final = 0.5 * DEG
"""How far a tool may be turned off the axis that it is to follow."""

BESIDE: Final = 0.5 * MM
"""How far the tip may be off its way where a surface says what is to be made: corners are rounded."""


def claims(job: Job) -> tuple[Claim, ...]:
    """Claims on the spindle, on the feed and the shape of each cut, and on the part
    that all of them spare."""
    op = job.operation
    out: list[Claim] = [ContactOnlyIn(("mill",), op.signal, op.spin_up_s)]
    out.append(ConfirmedPower(op.signal, spoken.told(job), spoken.asked(job), spoken.DONE, op.spin_down_s))
    for one in job.cuts:
        for run in one.runs:
            feed = _feed(job, one, run)
            fast = max(feed, op.rapid_mm_s * MM)
            out.append(FeedWindow(run.segment.at("in"), 0.0, max(feed, op.plunge_mm_s * MM)))
            out.append(FeedWindow(run.segment, 0.0, feed))
            out.append(FeedWindow(run.segment.at("out"), 0.0, fast))
        out += _shape(job, one)
        segments = tuple(run.segment for run in one.runs)
        for face in job.faces:
            deep = one.depth if face.name == "front" else 0.0
            mesh = (face.mesh.vertices, face.mesh.faces)
            out.append(SparesPart(segments, op.arms[0], job.cutter, *mesh, deep, one.tolerance))
    return tuple(out)


def _feed(job: Job, one: Done, run: Run) -> float:
    """The highest feed [m/s] of a pass; a G-code file has its own."""
    if isinstance(one.cut, GCodeCut):
        return float(_followed(run).feed[1:].max())
    return (one.cut.feed_mm_s or job.operation.feed_mm_s) * MM


def _followed(run: Run) -> ToolPath:
    """What a pass follows: the way that its path stands for, between its ways in and out."""
    return run.path[run.first : run.last + 1] if run.follow is None else run.follow


def _shape(job: Job, one: Done) -> list[Claim]:
    """The surface that a cut makes; where it follows curves, those."""
    op = job.operation
    out: list[Claim] = []
    if one.face is not None:
        # roughing passes leave the surface to the last one
        finish = one.runs[-1:] if isinstance(one.cut, FlankCut) else one.runs
        segments = tuple(run.segment for run in finish)
        mesh = (one.face.mesh.vertices, one.face.mesh.faces)
        out.append(MillsSurface(segments, op.arms[0], job.cutter, *mesh, one.tolerance, op.share))
    # where a surface is claimed it is the measure; the way then only says that nothing else is milled
    near = one.tolerance if one.face is None else max(one.tolerance, BESIDE)
    for run in one.runs:
        for phase, (tip, axis, feed) in _ways(job, run).items():
            out.append(MillsAlong(run.segment.at(phase), op.arms[0], tip, axis, feed, near, TURN))
    return out


def _ways(job: Job, run: Run) -> dict[Phase, tuple[FloatArray, FloatArray, FloatArray]]:
    """Tips and axes (N, 3) of a pass with the feeds (N,) [m/s] on the way to each, and of the ways from the
    safe plane and back to it, by phase: nothing else of the block is to be milled than
    what lies along these."""
    path, main = run.path, _followed(run)
    start, end = ends(job.operation, run, job.box)
    plunge, rapid = job.operation.plunge_mm_s * MM, job.operation.rapid_mm_s * MM
    return {
        "in": (
            np.concatenate([start[None], path.tip[: run.first + 1]]),
            np.concatenate([path.axis[:1], path.axis[: run.first + 1]]),
            np.concatenate([[plunge, plunge], path.feed[1 : run.first + 1]]),
        ),
        "": (main.tip, main.axis, np.concatenate([main.feed[1:2], main.feed[1:]])),
        "out": (
            np.concatenate([path.tip[run.last :], end[None]]),
            np.concatenate([path.axis[run.last :], path.axis[-1:]]),
            np.concatenate([[rapid], path.feed[run.last + 1 :], [rapid]]),
        ),
    }
