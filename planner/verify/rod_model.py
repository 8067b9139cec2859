"""The rod, its shapes and the motion of its ends, as values."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.verify.rod_energy import (
    Array,
    Ends,
    conjugate,
    exponential,
    logarithm,
    matrix,
    multiply,
    quaternion,
)
from planner.verify.rod_solve import State


class RodError(ValueError):
    """No stable shape could be found for the mounted rod, or the input has no meaning."""


@dataclass(frozen=True)
class Rod:
    """A straight, weightless-when-`weight`-is-0 rod. Bending stiffnesses `soft` (about the frame's z) and
    `stiff` (about y) and `torsion` GJ in N m^2, `length` in m, `weight` per length in N/m, `segments` of
    the discrete rod.
    """

    length: float
    soft: float
    stiff: float
    torsion: float
    weight: float = 0.0
    segments: int = 64

    def __post_init__(self) -> None:
        numbers = (self.length, self.soft, self.stiff, self.torsion)
        if not all(math.isfinite(value) and value > 0 for value in numbers):
            raise RodError(f"length and stiffnesses must be above 0; got {numbers}")
        if not (
            math.isfinite(self.weight) and self.weight >= 0 and self.segments >= 8 and self.segments % 2 == 0
        ):
            raise RodError(f"weight must be >= 0, segments even and >= 8; got {self.weight}, {self.segments}")

    @property
    def stiffness(self) -> Array:
        """(torsion, bending about y, bending about z) over `soft`."""
        return np.array([self.torsion, self.stiff, self.soft]) / self.soft


@dataclass(frozen=True)
class RodShape:
    """One shape: segment attitudes (4, N) wxyz in the start clamp's frame and the end's force (3,) in units
    of EI/L^2.
    """

    attitudes: Array
    force: Array


@dataclass(frozen=True)
class RodPath:
    """The rod at T instants, at N + 1 points of equal arc length.

    `points` (T, N+1, 3) [m] and `frames` (T, N+1, 3, 3) in the world. `curvature` (T, N+1, 2) about y and z
    and `twist` (T, N+1) [1/m], `tension` (T, N+1) [N]. `residual` (T,): error of the end's place [m].
    `error` (T,) [m]: how far refining moved the points (the discretisation error before it; that behind it
    is far smaller); inf where the coarser rod did not hold the shape and nothing was refined. `stable`
    (T,): the shape at the instant is a strict minimum of energy. `min_eig` (T,): smallest eigenvalue of the
    second variation over that of the first bending mode of a straight clamped rod (4 pi^2 EI / L^2 with
    `soft`); 0 where stability is lost. `jump` (T,): since the instant before, the rod lost its shape and
    fell into another one; `moved` (T,) [m]: how far its points then went (0 without a jump). `shapes`: to
    go on from any instant.
    """

    points: Array
    frames: Array
    curvature: Array
    twist: Array
    tension: Array
    residual: Array
    error: Array
    stable: NDArray[np.bool_]
    min_eig: Array
    jump: NDArray[np.bool_]
    moved: Array
    shapes: tuple[RodShape, ...]


class Drive:
    """The ends' motion in units of the rod: at whole instants, and between them as a controller moves."""

    def __init__(self, rod: Rod, start: Array, end: Array, gravity: Array) -> None:
        self.start, self.end = (np.asarray(frames, dtype=float) for frames in (start, end))
        if self.start.shape != self.end.shape or self.start.ndim != 3 or self.start.shape[1:] != (4, 4):
            raise RodError(f"start and end frames must be (T,4,4); got {self.start.shape}, {self.end.shape}")
        if len(self.start) == 0 or not (np.isfinite(self.start).all() and np.isfinite(self.end).all()):
            raise RodError("end frames must be finite numbers, at least one instant")
        direction = np.asarray(gravity, dtype=float)
        norm = float(np.linalg.norm(direction))
        self.weight = direction * (rod.weight * rod.length**3 / rod.soft / norm) if norm > 0 else np.zeros(3)
        self.length = rod.length
        self.q = [quaternion(np.moveaxis(frames[:, :3, :3], 0, -1)) for frames in (self.start, self.end)]
        self.p = [frames[:, :3, 3].T for frames in (self.start, self.end)]
        self.ends = self._relative(*self.p, *self.q)

    def _relative(self, pa: Array, pb: Array, qa: Array, qb: Array) -> Ends:
        turn = matrix(qa)
        place = np.einsum("jit,jt->it", turn, pb - pa) / self.length
        weight = np.einsum("jit,j->it", turn, self.weight)
        return Ends(place, multiply(conjugate(qa), qb), weight)

    def at(self, time: float) -> Ends:
        """The ends at a time between instants: positions linear, attitudes by the shortest turn."""
        k = min(int(time), self.start.shape[0] - 1)
        rest = time - k
        if rest <= 0.0:
            return self.ends.at(slice(k, k + 1))
        place = [p[:, k : k + 1] * (1.0 - rest) + p[:, k + 1 : k + 2] * rest for p in self.p]
        turns = []
        for q in self.q:
            a, b = q[:, k : k + 1], q[:, k + 1 : k + 2]
            turns.append(multiply(a, exponential(rest * logarithm(multiply(conjugate(a), b)))))
        return self._relative(*place, *turns)


def apart(a: State, b: State) -> float:
    """Largest angle between the segments of two states of one instant [rad]."""
    return float(apart_many(a.q, b.q)[0])


def apart_many(a: Array, b: Array) -> Array:
    dot = np.clip(np.abs((a * b).sum(axis=0)), 0.0, 1.0)
    found: Array = 2.0 * np.arccos(dot.min(axis=0))
    return found
