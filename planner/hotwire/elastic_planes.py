"""The planes across the sweep in which a face is cut, and the face's sections in them.

All planes contain the wire's direction, which is level in the block. Plane frame: x along the wire from the
first arm to the second, y up in the plane, z = x cross y, which is against the sweep. Everything is in the
stock frame.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_lsq_spline

from planner.geometry.mesh import TriangleMesh
from planner.geometry.rigid import from_parts
from planner.geometry.sections import slice_mesh

FloatArray = NDArray[np.float64]

POINTS = 41
"""Points per section that the fit sees."""


@dataclasses.dataclass(frozen=True)
class Spine:
    """A one-parameter family of planes: p [m] is the place along the sweep ``direction`` (3,).

    ``height``: spline of the spine's height over p on [lower, upper], straight beyond; None for upright
    parallel planes. ``across`` [m]: where along the wire's direction the planes have their origin.
    """

    direction: FloatArray
    across: float
    height: BSpline | None = None
    lower: float = 0.0
    upper: float = 0.0

    @property
    def wire(self) -> FloatArray:
        """Unit vector (3,) along the wire, from the first arm to the second."""
        return np.array([self.direction[1], -self.direction[0], 0.0])

    def frames(self, p: FloatArray) -> FloatArray:
        """Plane frames (K, 4, 4) at p (K,)."""
        up = np.array([0.0, 0.0, 1.0])
        level, slope = self._height(p)
        size = np.hypot(1.0, slope)[:, None]
        y = (up - slope[:, None] * self.direction) / size
        x = np.broadcast_to(self.wire, y.shape)
        rotation = np.stack([x, y, np.cross(x, y)], axis=-1)
        origin = p[:, None] * self.direction + self.across * self.wire + level[:, None] * up
        return from_parts(rotation, origin)

    def _height(self, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        if self.height is None:
            return np.zeros_like(p), np.zeros_like(p)
        inside = np.clip(p, self.lower, self.upper)
        slope = self.height(inside, nu=1)
        return self.height(inside) + slope * (p - inside), slope


@dataclasses.dataclass(frozen=True)
class SectionSet:
    """A face's sections in K planes: ``points`` (K, m, 2) [m] in plane coordinates, along growing x.

    ``length`` (K,) [m]; 0 where the plane misses the face (its points are then meaningless). ``pieces``
    (K,): polylines.
    """

    p: FloatArray
    points: FloatArray
    length: FloatArray
    pieces: NDArray[np.int64]


def direction_of(degrees: float) -> FloatArray:
    """Unit vector (3,) of a sweep at an angle from the block's x."""
    angle = np.deg2rad(degrees)
    return np.round(np.array([np.cos(angle), np.sin(angle), 0.0]), 15)


def make_spine(face: TriangleMesh, direction: FloatArray, normal: bool) -> Spine:
    """Upright planes, or planes normal to the face's spine: the line of its sections' mean points,
    smoothed.
    """
    middle = 0.5 * (face.vertices.min(axis=0) + face.vertices.max(axis=0))
    upright = Spine(direction, float(middle @ np.array([direction[1], -direction[0], 0.0])))
    if not normal:
        return upright
    along = face.vertices @ direction
    lower, upper = float(along.min()), float(along.max())
    p = np.linspace(lower, upper, 62)[1:-1]
    cut = cut_sections(face, upright, p)
    full = cut.length > 0.5 * np.median(cut.length[cut.length > 0])
    level = cut.points[..., 1].mean(axis=1)
    knots = np.concatenate(
        [[p[full][0]] * 4, np.linspace(p[full][0], p[full][-1], 6)[1:-1], [p[full][-1]] * 4]
    )
    height = make_lsq_spline(p[full], level[full], knots, k=3)
    return dataclasses.replace(upright, height=height, lower=float(p[full][0]), upper=float(p[full][-1]))


def cut_sections(face: TriangleMesh, spine: Spine, p: FloatArray) -> SectionSet:
    """Sections of a face in the planes at p (K,), sampled evenly over their length; several pieces count as
    one curve.
    """
    frames = spine.frames(p)
    cut = slice_mesh(face, frames[:, :3, 3], frames[:, :3, 2])
    points = np.zeros((len(p), POINTS, 2))
    length = np.zeros(len(p))
    pieces = np.bincount(cut.plane, minlength=len(p)).astype(np.int64)
    first = np.searchsorted(cut.plane, np.arange(len(p) + 1))
    for k in np.nonzero(pieces)[0]:
        lines = [
            (cut.polyline(i) - frames[k, :3, 3]) @ frames[k, :3, :2] for i in range(first[k], first[k + 1])
        ]
        lines = [line if line[-1, 0] >= line[0, 0] else line[::-1] for line in lines]
        lines.sort(key=lambda line: float(line[:, 0].mean()))
        length[k], points[k] = _resample(lines)
    return SectionSet(p, points, length, pieces)


def _resample(lines: list[FloatArray]) -> tuple[float, FloatArray]:
    steps = [np.concatenate([[0.0], np.hypot(*np.diff(line, axis=0).T)]) for line in lines]
    place = np.cumsum(np.concatenate(steps))
    line = np.concatenate(lines)
    wanted = np.linspace(0.0, place[-1], POINTS)
    return float(place[-1]), np.stack([np.interp(wanted, place, line[:, i]) for i in range(2)], axis=-1)
