"""A pattern of curves, projected along z onto the part's front and engraved there."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.issues import Issue, TandemError
from planner.milling.operation import EngraveCut, Milling
from planner.milling.over import Over
from planner.milling.point import leant, tips
from planner.milling.thin import thinned
from planner.milling.values import Run, plain_path
from planner.part_ruled_file import GuideFile, guide
from planner.tooling import Cutter
from planner.units import DEG, MM

FloatArray = NDArray[np.float64]

ALONG: Final = 0.25 * MM
"""Distance of the places at which a curve is laid on the face."""
LEVER: Final = 0.05
CHORD: Final = 0.1


def runs(op: Milling, cut: EngraveCut, over: Over, cutter: Cutter) -> list[Run]:
    """One run for each curve. Raises ``TandemError`` with codes ``milling.*`` and ``part.guide``."""
    out = []
    faults: list[Issue] = []
    tolerance = (cut.shape_tol_mm or op.shape_tol_mm) * MM
    for number, spec in enumerate(cut.engrave):
        field = f"operations.cuts.{cut.name}.engrave.{number}"
        try:
            tip, axis = _tool(cut, number, _curve(spec, field), over, cutter, field)
        except TandemError as error:
            faults += error.issues
            continue
        rows = thinned(np.stack([tip, tip + LEVER * axis], axis=1), CHORD * tolerance, op.step_mm * MM)
        feed = (cut.feed_mm_s or op.feed_mm_s) * MM
        out.append(
            Run(f"{cut.name}_c{number + 1}", plain_path(tip[rows], axis[rows], feed), 0, len(rows) - 1, 0.0)
        )
    if faults:
        raise TandemError(faults)
    return out


def _curve(spec: GuideFile, field: str) -> FloatArray:
    """Places (N, 3) [m] along a curve, evenly apart, with its corners."""
    own = guide(spec, False, Path(), field).points
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(own, axis=0), axis=1))])
    even = np.linspace(0.0, length[-1], max(int(np.ceil(length[-1] / ALONG)), 2) + 1)
    at = np.unique(np.concatenate([even, length]))
    return np.stack([np.interp(at, length, own[:, k]) for k in range(3)], axis=1)


def _tool(
    cut: EngraveCut, number: int, curve: FloatArray, over: Over, cutter: Cutter, field: str
) -> tuple[FloatArray, FloatArray]:
    laid = over.at(curve[:, :2])
    if not laid.on.all():
        at = curve[int(np.argmin(laid.on))] / MM
        what = f"{cut.name}: curve {number + 1} leaves the part's front at {at[0]:.1f}, {at[1]:.1f} mm; "
        low, high = over.low / MM, over.high / MM
        what += f"move or shorten it: in the block's frame the front goes from {low[0]:.1f}, {low[1]:.1f} to "
        what += f"{high[0]:.1f}, {high[1]:.1f} mm at most (curves are projected along z)"
        raise TandemError(Issue("milling.off_surface", what, field=field))
    feed = np.gradient(laid.point, axis=0)
    if cut.axis == "upright":
        axis = np.broadcast_to([0.0, 0.0, 1.0], curve.shape).copy()
    elif cut.axis == "normal":
        axis = leant(laid.normal, feed, cut.lead_deg * DEG, cut.tilt_deg * DEG)
    else:
        axis = _toward(cut, number, laid.point, field)
    contact = laid.point - cut.depth_mm * MM * laid.normal
    return tips(contact, laid.normal, axis, cutter), axis


def _toward(cut: EngraveCut, number: int, point: FloatArray, field: str) -> FloatArray:
    """Axes (N, 3) through a second curve, at equal shares of both curves' lengths."""
    name = field.replace("engrave", "axis_curves")
    other = _curve(cut.axis_curves[number], name)
    shares = []
    for row in (point, other):
        length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(row, axis=0), axis=1))])
        shares.append(length / max(float(length[-1]), 1e-12))
    at = np.stack([np.interp(shares[0], shares[1], other[:, k]) for k in range(3)], axis=1)
    way = at - point
    length = np.linalg.norm(way, axis=1)
    ends = (
        np.array([point[0] - other[0], point[-1] - other[-1]]),
        np.array([point[0] - other[-1], point[-1] - other[0]]),
    )
    if (
        length.min() < 1.0 * MM
        or np.linalg.norm(ends[1], axis=1).sum() < 0.8 * np.linalg.norm(ends[0], axis=1).sum()
    ):
        what = f"{cut.name}: axis curve {number + 1} meets its curve or runs the other way; give "
        what += "it at least 1 mm "
        what += "off its curve and in the same direction"
        raise TandemError(Issue("milling.guides", what, field=name))
    return np.asarray(way / length[:, None])
