"""Sides of planar panels as their programs cut them, and the joints between them.

Neighbours share the plane of their sides. The proof of each panel writes where the wire passes on them
(``simulated_part.obj``), and both parts are laid into the frame of the element. How far they are apart across
that plane is the **gap**, or where they overlap, the overlap. Where they come to the faces of their panels,
which are those of the blocks, one edge may stand higher than the other along the mean of both normals: the
**step**.
"""

import dataclasses
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.interpolate import LinearNDInterpolator

from planner.element.jobs import block_pose
from planner.element.run_joints import CutFace, CutJoint, other_panel, panel_objects
from planner.geometry.arrays import FloatArray, dots, transform, unit
from planner.geometry.units import MM

SIDES: Final = "sides"
"""The surface of a panel's problem that has all of its sides."""
FARTHEST: Final = 0.005
"""A simulated part whose corners are farther from those of a panel [m] is not that panel's."""
BOTH: Final = 5e-4
"""What is nearer to two sides than this [m] belongs to both."""
_EDGE_STEP: Final = 0.01  # between points of an edge [m]
_INWARD: Final = 1e-3  # share by which points are drawn in, so that those on an edge lie between others


@dataclasses.dataclass(frozen=True)
class CutSide(CutFace):
    """One side of a panel: its ``rim`` are the vertices on the edges of both faces. ``axes`` (3, 2): along
    its edge, and in its plane from back to front; ``up`` (3,): the normal of the panel's front."""

    axes: FloatArray
    up: FloatArray

    @property
    def edges(self) -> FloatArray:
        """Where (R, 3) [m] the cut comes to the faces, against the rim as written."""
        normal, rise = self.normals[0], self.axes[:, 1]
        slide = normal - (normal @ self.up) / (rise @ self.up) * rise
        return np.asarray(self.deviation[self.rim, None] * slide)


def rings(panel: Mapping[str, Any], thickness: float) -> tuple[FloatArray, FloatArray]:
    """Outlines (C, 3) [m] of a panel's back and front in the frame of its block."""
    back, front = (np.array(panel[key], dtype=np.float64) * MM for key in ("back_mm", "front_mm"))
    return np.insert(back, 2, 0.0, axis=1), np.insert(front, 2, thickness, axis=1)


def cut_sides(out: Path, run: Path, panel: Mapping[str, Any], thickness: float) -> tuple[CutSide, ...]:
    """The sides of a panel of ``out``, ``thickness`` [m], as the plan in ``run`` cuts them, or none of them.

    Raises ``TandemError``: ``element.run`` where the plan is of another panel.
    """
    name = str(panel["id"])
    path, objects = panel_objects(run, panel)
    own_name = name if "cut_in" in panel else SIDES
    found = [one.points for word, one in objects.items() if re.fullmatch(rf"cut_{own_name}(_\d+)?", word)]
    if not found:
        return ()
    cut = np.concatenate(found)
    pose = block_pose(panel)
    back, front = rings(panel, thickness)
    corners = np.concatenate([back, front])
    far = float(np.linalg.norm(corners[:, None] - cut, axis=2).min(axis=1).max())
    frames = [_Frame.of(back, front, i) for i in range(len(back))]
    if float(cut[:, 2].max()) > thickness + BOTH:  # sides go on beyond fronts that are cut
        cut = np.concatenate([cut, *(frame.on_front(cut) for frame in frames)])
        cut = cut[cut[:, 2] < thickness + BOTH]
    off = np.stack([frame.distance(cut) for frame in frames])
    least = off.min(axis=0)
    if max(far, float(least.max())) > FARTHEST:
        raise other_panel(path, name, "what is cut of the sides")
    sides = []
    for frame, near in zip(frames, off <= least + BOTH, strict=True):
        own = cut[near]
        if not len(own) or np.ptp(own @ frame.along) < 0.5 * np.ptp(frame.ends):
            raise other_panel(path, name, "what is cut of the sides")
        place = own - ((own - frame.corner) @ frame.normal)[:, None] * frame.normal
        rim = np.flatnonzero((np.abs(place[:, 2]) < BOTH) | (np.abs(place[:, 2] - thickness) < BOTH))
        turn = pose[:3, :3]
        normals = np.broadcast_to(turn @ frame.normal, own.shape)
        axes = turn @ np.stack([frame.along, frame.rise], axis=1)
        sides.append(
            CutSide(transform(pose, place), transform(pose, own), normals, rim, axes, turn @ [0.0, 0.0, 1.0])
        )
    return tuple(sides)


@dataclasses.dataclass(frozen=True)
class _Frame:
    """The plane of a side: a ``corner`` (3,) of the back, axes ``along`` the edge, ``normal`` outwards and
    ``rise``, and (2, 2) the places along the edge at which the side begins and ends, at the back and in
    front, which is ``high`` above."""

    corner: FloatArray
    along: FloatArray
    normal: FloatArray
    rise: FloatArray
    ends: FloatArray
    high: float

    @staticmethod
    def of(back: FloatArray, front: FloatArray, i: int) -> "_Frame":
        k = (i + 1) % len(back)
        along = unit(back[k] - back[i])
        normal = unit(np.cross(along, 0.5 * (front[i] + front[k]) - back[i]))
        rise = np.cross(normal, along)
        ends = np.array([[0.0, (back[k] - back[i]) @ along], (front[[i, k]] - back[i]) @ along])
        return _Frame(back[i], along, normal, rise, ends, float((front[i] - back[i]) @ rise))

    def distance(self, points: FloatArray) -> FloatArray:
        """How far (V,) [m] points are off the side, the largest of the ways across and beyond its ends."""
        rest = points - self.corner
        at, share = rest @ self.along, rest @ self.rise / self.high
        ends = self.ends[0] + share[:, None] * (self.ends[1] - self.ends[0])
        return np.asarray(np.max([np.abs(rest @ self.normal), ends[:, 0] - at, at - ends[:, 1]], axis=0))

    def on_front(self, cut: FloatArray) -> FloatArray:
        """Points (N, 3) [m] of what is cut of the side on its front edge, of ``cut`` (V, 3) that go on
        beyond it."""
        own = cut[self.distance(cut) < BOTH] - self.corner
        high = LinearNDInterpolator(np.stack([own @ self.along, own @ self.rise], axis=1), own @ self.normal)
        first, last = self.ends[1].tolist()
        at = np.linspace(first, last, int((last - first) / _EDGE_STEP) + 2)
        off = high(at, np.full(len(at), self.high))
        edge = self.corner + at[:, None] * self.along + self.high * self.rise + off[:, None] * self.normal
        return np.asarray(edge[np.isfinite(off)])


def side_joint(names: tuple[str, str], one: CutSide, other: CutSide) -> CutJoint | None:
    """The joint of two panels by their sides there; None where these have nothing in common."""
    normal, corner = one.normals[0], one.place[0]
    here, there = one.place @ one.axes, other.place @ one.axes
    middle = here.mean(axis=0)
    beyond = LinearNDInterpolator(there, dots(other.cut - corner, np.broadcast_to(normal, other.cut.shape)))
    gaps = beyond(middle + (1.0 - _INWARD) * (here - middle)) - dots(one.cut - corner, one.normals)
    known = np.isfinite(gaps)
    steps = _steps(one, other)
    if not known.any() or not len(steps):
        return None
    return CutJoint(names, one.place[known], steps, np.abs(gaps[known]))


def _steps(one: CutSide, other: CutSide) -> FloatArray:
    """How much higher (M,) [m] the one edge stands than the other, at front and back."""
    normal = unit(one.up + other.up)
    middle = one.place.mean(axis=0)
    found = []
    sides = [(side.place[side.rim] - middle) @ one.axes for side in (one, other)]
    high = [side.edges @ normal for side in (one, other)]
    for front in (True, False):
        (at, own), (beside, beyond) = (
            (side[face, 0], z[face])
            for side, z in zip(sides, high, strict=True)
            for face in [(side[:, 1] > 0.0) == front]
        )
        if not len(at) or not len(beside):
            continue
        order = np.argsort(beside)
        met = (at > beside[order[0]] - BOTH) & (at < beside[order[-1]] + BOTH)
        found.append(np.abs(own - np.interp(at, beside[order], beyond[order]))[met])
    return np.concatenate(found or [np.zeros(0)])
