"""Wires placed in space, as the rest of the elastic process handles them: N planar heavy elasticas, each in
its own plane.

A wire is given by the frame of its middle (x along the tangent, y in the plane, z the plane's normal) and
by curvature and force there; its weight follows from the attitude of the plane. Everything is in the stock
frame.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from planner.geometry.rigid import from_parts, interpolate, inverse
from planner.hotwire import heavy
from planner.hotwire.heavy import HeavyShape
from planner.hotwire.shooting import polish

FloatArray = NDArray[np.float64]

EDGE_POINTS = 33


@dataclasses.dataclass(frozen=True)
class Wires:
    """N wires of one ``length`` [m]: ``frame`` (N, 4, 4) of the middle, ``bend`` (N, 3) = k, Fx, Fy there,
    in its axes.

    ``gravity`` (3,) [1/m^3]: weight per length over EI as a vector in the stock frame.
    """

    frame: FloatArray
    bend: FloatArray
    length: float
    gravity: FloatArray

    def __len__(self) -> int:
        return len(self.bend)

    def __getitem__(self, index: NDArray[np.intp] | slice) -> Wires:
        return dataclasses.replace(self, frame=self.frame[index], bend=self.bend[index])

    def load(self) -> FloatArray:
        """Weight (N, 3) [1/m^3] in the wires' own axes; the third is across the plane."""
        return np.asarray(np.swapaxes(self.frame[:, :3, :3], 1, 2) @ self.gravity)

    def shapes(self, n: int = EDGE_POINTS) -> HeavyShape:
        """The planar shapes, with the middle at the origin along x."""
        count = len(self)
        middle = np.concatenate([np.zeros((count, 3)), self.bend], axis=1)
        return heavy.from_middle(middle, np.full(count, self.length), self.load()[:, :2], n)

    def points(self, shape: HeavyShape) -> FloatArray:
        """Points (N, n, 3) of the wires' ``shapes()``."""
        axes = np.swapaxes(self.frame[:, :3, :2], 1, 2)
        return np.asarray(shape.points @ axes + self.frame[:, None, :3, 3])

    def ends(self, shape: HeavyShape) -> tuple[FloatArray, FloatArray]:
        """Poses (N, 4, 4) of start and end: x along the wire from start to end, z the plane's normal."""
        return self.frame @ planar_pose(shape.start), self.frame @ planar_pose(shape.end)

    def moved(self, shift: FloatArray) -> Wires:
        """The wires moved by shift (3,) or (N, 3) [m]."""
        frame = self.frame.copy()
        frame[:, :3, 3] += shift
        return dataclasses.replace(self, frame=frame)


def planar_pose(pose: FloatArray) -> FloatArray:
    """Poses (..., 4, 4) in a plane's frame of planar poses (..., 3) = x, y, theta."""
    c, s = np.cos(pose[..., 2]), np.sin(pose[..., 2])
    zero, one = np.zeros_like(c), np.ones_like(c)
    rotation = np.stack(
        [np.stack([c, -s, zero], -1), np.stack([s, c, zero], -1), np.stack([zero, zero, one], -1)], axis=-2
    )
    return from_parts(rotation, np.stack([pose[..., 0], pose[..., 1], zero], axis=-1))


def from_states(planes: FloatArray, state: FloatArray, length: float, gravity: FloatArray) -> Wires:
    """Wires whose middles have the states (N, 6) in the frames ``planes`` (N, 4, 4)."""
    c, s = np.cos(state[:, 2]), np.sin(state[:, 2])
    fx, fy = c * state[:, 4] + s * state[:, 5], -s * state[:, 4] + c * state[:, 5]
    bend = np.stack([state[:, 3], fx, fy], axis=1)
    return Wires(planes @ planar_pose(state[:, :3]), bend, length, gravity)


def join(parts: list[Wires]) -> Wires:
    """Wires one after another; all of one length."""
    return dataclasses.replace(
        parts[0],
        frame=np.concatenate([w.frame for w in parts]),
        bend=np.concatenate([w.bend for w in parts]),
    )


def between(a: Wires, b: Wires, t: FloatArray) -> Wires:
    """Wires (N,) between a and b: frames by straight line and steady turn, curvature and force linearly.

    Each is an equilibrium of the same length under its own weight.
    """
    bend = (1.0 - t[:, None]) * a.bend + t[:, None] * b.bend
    return dataclasses.replace(a, frame=interpolate(a.frame, b.frame, t), bend=bend)


def driven(a: Wires, b: Wires, t: float) -> tuple[Wires, FloatArray, FloatArray]:
    """Where the wires are when both ends have gone the part ``t`` of a straight move, at a steady turn,
    from a to b.

    Returns the wires, on the branch next to ``between``; how far (N,) the solver's ends miss, over the
    length (inf where it fails); and how far (N,) [rad] the ends' tangents lean out of the common plane,
    which the planar shape leaves out.
    """
    start_a, end_a = a.ends(a.shapes(3))
    start_b, end_b = b.ends(b.shapes(3))
    part = np.full(len(a), t)
    start, end = interpolate(start_a, start_b, part), interpolate(end_a, end_b, part)
    guess = between(a, b, part)
    chord = end[:, :3, 3] - start[:, :3, 3]
    z = start[:, :3, 2] + end[:, :3, 2]
    size = np.sum(chord * chord, axis=1, keepdims=True)
    z = z - chord * np.sum(chord * z, axis=1, keepdims=True) / size
    z = z / np.linalg.norm(z, axis=1, keepdims=True)
    x = guess.frame[:, :3, 0] - z * np.sum(z * guess.frame[:, :3, 0], axis=1, keepdims=True)
    x = x / np.linalg.norm(x, axis=1, keepdims=True)
    origin = guess.frame[:, :3, 3] - z * np.sum(
        z * (guess.frame[:, :3, 3] - start[:, :3, 3]), axis=1, keepdims=True
    )
    plane = from_parts(np.stack([x, np.cross(z, x), z], axis=-1), origin)
    local_start, local_end = inverse(plane) @ start, inverse(plane) @ end
    shape = dataclasses.replace(guess, frame=plane).shapes(3)
    want_start, want_end = _flat(local_start, shape.start[:, 2]), _flat(local_end, shape.end[:, 2])
    middle, miss = polish(shape.middle, want_start, want_end, shape.length, shape.weight)
    lean = np.maximum(np.abs(local_start[:, 2, 0]), np.abs(local_end[:, 2, 0]))
    miss = np.where(np.isfinite(middle).all(axis=1), miss, np.inf)
    middle = np.where(np.isfinite(middle), middle, shape.middle)
    return from_states(plane, middle, a.length, a.gravity), miss, lean


def _flat(pose: FloatArray, theta: FloatArray) -> FloatArray:
    """Planar poses (N, 3) of poses (N, 4, 4), the angle unwrapped to lie next to theta (N,)."""
    angle = np.arctan2(pose[:, 1, 0], pose[:, 0, 0])
    angle = angle + 2.0 * np.pi * np.round((theta - angle) / (2.0 * np.pi))
    return np.stack([pose[:, 0, 3], pose[:, 1, 3], angle], axis=1)


def box_distance(points: FloatArray, box: FloatArray) -> FloatArray:
    """Signed distances (...,) of points (..., 3) in the stock frame from the block with the corners ``box``
    (2, 3), negative inside.
    """
    q = np.abs(points - box.mean(axis=0)) - 0.5 * np.ptp(box, axis=0)
    outside = np.linalg.norm(np.maximum(q, 0.0), axis=-1)
    return np.asarray(outside + np.minimum(q.max(axis=-1), 0.0))
