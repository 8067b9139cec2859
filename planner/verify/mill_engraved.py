"""What an engraving asks of a tool, worked out by the proof from the drawn curves and the part's face alone:
each curve projected along z onto the face, as deep as wanted, with the axis as the problem says."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from planner.claims import Claim, FeedWindow
from planner.claims_milling import DrawnCurve, Engraves, MillsAlong
from planner.segments import Segment
from planner.tooling import Cutter
from planner.verify.files import drawings
from planner.verify.files.faults import UnreadError
from planner.verify.mill_laid import Laid, Places
from planner.verify.mill_ways import down, up
from planner.verify.setups import MILL

FloatArray = NDArray[np.float64]

MILLIMETRE = 1e-3
ALONG = 0.25e-3
"""Distance [m] of the places at which a curve is laid on the face; what a tool leans along is the chord
between the two beside a place."""
FINE = 4000
"""Places on a spline."""
CORNERED = ("polyline", "dxf")
LENGTHS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254, "ft": 0.3048}
"""Units of drawings [m]."""
UPRIGHT = 1e-3
"""A flat end that leans off the normal by less than this [rad] touches with its middle."""
SAME = 1e-9


class NotThereError(ValueError):
    """A curve that cannot be laid on the face."""


def segments(claim: Engraves) -> Iterator[Claim]:
    """The ways and feeds of all curves. Raises ``NotThereError``."""
    face = Laid(claim.vertices, claim.faces)
    for number, drawn in enumerate(claim.curves, 1):
        segment, safe = Segment(MILL, f"{claim.name}_c{number}"), claim.safe
        yield FeedWindow(segment.at("in"), 0.0, max(claim.feed, safe.plunge))
        yield FeedWindow(segment, 0.0, claim.feed)
        yield FeedWindow(segment.at("out"), 0.0, max(claim.feed, safe.rapid))
        curve, either = points(drawn)
        ways = _ways(claim, face, number - 1, curve)
        backs = _ways(claim, face, number - 1, curve[::-1]) if either else (None,) * len(ways)
        yield from (dataclasses.replace(way, back=back) for way, back in zip(ways, backs, strict=True))


def _ways(claim: Engraves, face: Laid, number: int, curve: FloatArray) -> tuple[MillsAlong, ...]:
    """The way along a curve (K, 3) [m], down to it and up from it."""
    tip, axis = tool_along(claim, face, number, curve)
    segment = Segment(MILL, f"{claim.name}_c{number + 1}"), claim.arm
    bounds = claim.tolerance, claim.turn
    return (
        MillsAlong(*segment, tip, axis, np.full(len(tip), claim.feed), *bounds),
        down(claim.safe, *segment, tip[0], axis[0], *bounds),
        up(claim.safe, *segment, tip[-1], axis[-1], *bounds),
    )


def points(drawn: DrawnCurve) -> tuple[FloatArray, bool]:
    """Points (N, 3) [m] of a curve, of a polyline its own, of a spline many; and whether it may as well be
    run the other way, as a drawing does not say it of what is drawn in pieces. Raises ``NotThereError``."""
    if drawn.file is not None:
        return _of_file(drawn, drawn.file)
    given = np.array(drawn.points_mm, dtype=np.float64) * MILLIMETRE
    if drawn.kind == "polyline":
        apart = np.linalg.norm(np.diff(given, axis=0), axis=1) > SAME
        return given[np.append(True, apart)], False
    count = len(given)
    degree = count - 1 if drawn.kind == "bezier" else min(3, count - 1)
    inner = np.arange(1, count - degree) / (count - degree)
    knots = np.concatenate([np.zeros(degree + 1), inner, np.ones(degree + 1)])
    return np.asarray(BSpline(knots, given, degree)(np.linspace(0.0, 1.0, FINE + 1))), False


def _of_file(drawn: DrawnCurve, file: Path) -> tuple[FloatArray, bool]:
    """The only curve of a drawing."""
    try:
        found = drawings.read_curves(file, LENGTHS[drawn.unit], drawn.layer)
    except UnreadError as error:
        raise NotThereError(f"{file}: {error}") from error
    if len(found) != 1:
        raise NotThereError(f"{file} holds {len(found)} curves, wanted is one")
    out = found[0].points.copy()
    if drawn.z_mm is not None:
        out[:, 2] = drawn.z_mm * MILLIMETRE
    return out, found[0].pieces > 1


def tool_along(claim: Engraves, face: Laid, number: int, curve: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Tips and axes (N, 3) along a curve (K, 3) [m]. Raises ``NotThereError``."""
    corners = claim.curves[number].kind in CORNERED
    laid = face.at(evenly(curve, corners)[:, :2])
    if not np.isfinite(laid.point).all():
        at = evenly(curve, corners)[int(np.argmin(np.isfinite(laid.point[:, 2])))] / MILLIMETRE
        raise NotThereError(f"curve {number + 1} is not over the face at {at[0]:.1f}, {at[1]:.1f} mm")
    axis = _axis(claim, number, laid)
    contact = laid.point - claim.depth * laid.normal
    return tip_at(contact, laid.normal, axis, claim.cutter), axis


def evenly(curve: FloatArray, corners: bool) -> FloatArray:
    """Places (N, 3) along a curve, ``ALONG`` apart at most, its corners among them where it has some."""
    way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1)))
    count = max(int(np.ceil(way[-1] / ALONG)), 2)
    at = way[-1] * np.arange(count + 1) / count
    at = np.union1d(at, way) if corners else at
    return np.stack([np.interp(at, way, curve[:, k]) for k in range(3)], axis=1)


def tip_at(contact: FloatArray, normal: FloatArray, axis: FloatArray, cutter: Cutter) -> FloatArray:
    """Tips (N, 3) of a cutter that touches a plane with ``normal`` (N, 3) at ``contact`` (N, 3): from the
    contact to the middle of the round edge's tube, in to the middle of the edge, and down the axis."""
    out = normal - (normal * axis).sum(axis=1, keepdims=True) * axis
    size = np.linalg.norm(out, axis=1, keepdims=True)
    inward = np.where(size > UPRIGHT, out / np.maximum(size, 1e-12), 0.0)
    tube = contact + cutter.corner * normal
    return np.asarray(tube + (cutter.radius - cutter.corner) * inward - cutter.corner * axis)


def _axis(claim: Engraves, number: int, laid: Places) -> FloatArray:
    """Axes (N, 3) from the tip to the spindle."""
    count = len(laid.point)
    if claim.axis == "upright":
        return np.tile([0.0, 0.0, 1.0], (count, 1))
    if claim.axis == "curves":
        drawn = claim.axis_curves[number]
        curve, either = points(drawn)
        there = [np.linalg.norm(laid.point[[0, -1]] - row[[0, -1]]) for row in (curve, curve[::-1])]
        other = evenly(curve[::-1] if either and there[1] < there[0] else curve, drawn.kind in CORNERED)
        shares = [_shares(row) for row in (laid.point, other)]
        at = np.stack([np.interp(shares[0], shares[1], other[:, k]) for k in range(3)], axis=1)
        return _unit(at - laid.point)
    before, behind = np.maximum(np.arange(count) - 1, 0), np.minimum(np.arange(count) + 1, count - 1)
    chord = laid.point[behind] - laid.point[before]
    ahead = _unit(chord - (chord * laid.normal).sum(axis=1, keepdims=True) * laid.normal)
    left = np.cross(laid.normal, ahead)
    return _unit(laid.normal + np.tan(claim.lead) * ahead + np.tan(claim.tilt) * left)


def _shares(row: FloatArray) -> FloatArray:
    way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(row, axis=0), axis=1)))
    return np.asarray(way / way[-1])


def _unit(vectors: FloatArray) -> FloatArray:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))
