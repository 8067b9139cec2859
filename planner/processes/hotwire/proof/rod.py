"""Quasi-static motion of a real wire: a discrete elastic rod with weight, followed from its mounted shape.

The rod is clamped at both ends to full frames (x along the wire, z the section plane's normal) and has a
fixed length. `mount_rod` finds the shape of the wire when it is mounted. `follow_rod` carries it through the
motion of its ends. Where the shape stops being stable, the real wire snaps to another one: that instant is
marked, and the rod continues from the shape that it falls into. No closed form is used: see `rod_energy` for
the model.

The shapes give points, frames, curvature, twist, tension and stability margins in the world. The discrete rod
is of second order in h = L / N. The same shapes are found again with half the segments, and both results are
combined (Richardson: (4 fine - coarse) / 3). This leaves errors of the order h^4 and estimates the error that
was removed.
"""

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from planner.geometry.arrays import BoolArray, FloatArray
from planner.processes.hotwire.proof.rod_energy import (
    RodEnds,
    joint_quaternions,
    joint_spacing,
    quaternion_conjugate,
    quaternion_exp,
    quaternion_from_matrix,
    quaternion_log,
    quaternion_product,
    rod_energy,
    rotation_matrix,
)
from planner.processes.hotwire.proof.rod_equilibrium import (
    NewtonResult,
    RodState,
    apply_step,
    descend,
    solve_newton,
    solve_newton_many,
    weakest_eigenvalues,
    weakest_mode,
)


class RodError(ValueError):
    """No stable shape could be found for the mounted rod, or the input is invalid."""


@dataclass(frozen=True)
class Rod:
    """A rod that is straight without load.

    Attributes:
        length: Length [m].
        soft_bending: Bending stiffness about the frame's z [N m^2].
        stiff_bending: Bending stiffness about the frame's y [N m^2].
        torsion: Torsional stiffness GJ [N m^2].
        weight: Weight per length [N/m], 0 for a weightless rod.
        segments: Number of segments of the discrete rod, even and at least 8.
    """

    length: float
    soft_bending: float
    stiff_bending: float
    torsion: float
    weight: float = 0.0
    segments: int = 64

    def __post_init__(self) -> None:
        numbers = (self.length, self.soft_bending, self.stiff_bending, self.torsion)
        if not all(math.isfinite(value) and value > 0 for value in numbers):
            raise RodError(f"length and stiffnesses must be above 0; got {numbers}")
        if not (
            math.isfinite(self.weight) and self.weight >= 0 and self.segments >= 8 and self.segments % 2 == 0
        ):
            raise RodError(f"weight must be >= 0, segments even and >= 8; got {self.weight}, {self.segments}")

    @property
    def stiffness(self) -> FloatArray:
        """Torsion, bending about y and bending about z, over ``soft_bending`` (3,)."""
        return np.array([self.torsion, self.stiff_bending, self.soft_bending]) / self.soft_bending


@dataclass(frozen=True)
class RodShape:
    """One shape of a rod.

    Attributes:
        attitudes: Segment attitudes wxyz in the start clamp's frame (4, N).
        force: Force at the end in units of EI/L^2 (3,).
    """

    attitudes: FloatArray
    force: FloatArray


@dataclass(frozen=True)
class RodPath:
    """The rod at T instants, at N + 1 points of equal arc length.

    Attributes:
        points: Points in the world (T, N+1, 3) [m].
        frames: Frames in the world (T, N+1, 3, 3).
        curvature: Curvature about y and z (T, N+1, 2) [1/m].
        twist: Twist (T, N+1) [1/m].
        tension: Tension (T, N+1) [N].
        residual: Position error of the end (T,) [m].
        error: Largest displacement of the points by Richardson extrapolation (T,) [m]. It estimates the
            discretisation error before the extrapolation. The remaining error is far smaller. Infinite if the
            coarser rod does not have this shape, so that nothing was extrapolated.
        is_stable: Whether the shape is a strict minimum of energy (T,).
        min_eigenvalue: Smallest eigenvalue of the second variation over that of the first bending mode of a
            straight clamped rod (4 pi^2 EI / L^2 with ``soft_bending``) (T,). 0 where stability is lost.
        has_jumped: Whether the rod lost its shape and fell into another one since the previous instant (T,).
        jump_distance: Displacement of the points by the jump (T,) [m], 0 without a jump.
        shapes: Shapes, to continue from any instant (T,).
    """

    points: FloatArray
    frames: FloatArray
    curvature: FloatArray
    twist: FloatArray
    tension: FloatArray
    residual: FloatArray
    error: FloatArray
    is_stable: BoolArray
    min_eigenvalue: FloatArray
    has_jumped: BoolArray
    jump_distance: FloatArray
    shapes: tuple[RodShape, ...]


class EndMotion:
    """Motion of the ends in units of the rod, at instants and between them as a controller moves.

    Args:
        rod: The rod.
        start: Frames of the start clamp in the world (T, 4, 4).
        end: Frames of the end clamp in the world (T, 4, 4).
        gravity: Direction of gravity (3,).

    Raises:
        RodError: If the frames are invalid.
    """

    def __init__(self, rod: Rod, start: FloatArray, end: FloatArray, gravity: FloatArray) -> None:
        self.start, self.end = (np.asarray(frames, dtype=float) for frames in (start, end))
        if self.start.shape != self.end.shape or self.start.ndim != 3 or self.start.shape[1:] != (4, 4):
            raise RodError(f"start and end frames must be (T,4,4); got {self.start.shape}, {self.end.shape}")
        if len(self.start) == 0 or not (np.isfinite(self.start).all() and np.isfinite(self.end).all()):
            raise RodError("end frames must be finite numbers, at least one instant")
        direction = np.asarray(gravity, dtype=float)
        norm = float(np.linalg.norm(direction))
        self.weight = (
            direction * (rod.weight * rod.length**3 / rod.soft_bending / norm) if norm > 0 else np.zeros(3)
        )
        self.length = rod.length
        self.attitudes = [
            quaternion_from_matrix(np.moveaxis(frames[:, :3, :3], 0, -1)) for frames in (self.start, self.end)
        ]
        self.positions = [frames[:, :3, 3].T for frames in (self.start, self.end)]
        self.ends = self._relative(*self.positions, *self.attitudes)

    def _relative(self, pa: FloatArray, pb: FloatArray, qa: FloatArray, qb: FloatArray) -> RodEnds:
        """Return the end clamp (position pb, attitude qb) as seen from the start clamp (pa, qa)."""
        rotation = rotation_matrix(qa)
        position = np.einsum("jit,jt->it", rotation, pb - pa) / self.length
        weight = np.einsum("jit,j->it", rotation, self.weight)
        return RodEnds(position, quaternion_product(quaternion_conjugate(qa), qb), weight)

    def at(self, time: float) -> RodEnds:
        """Return the ends at a time that counts instants: 3.5 is halfway from instant 3 to instant 4.

        Positions are interpolated linearly, attitudes along the shortest rotation.
        """
        k = min(int(time), self.start.shape[0] - 1)
        fraction = time - k
        if fraction <= 0.0:
            return self.ends.at(slice(k, k + 1))
        positions = [
            p[:, k : k + 1] * (1.0 - fraction) + p[:, k + 1 : k + 2] * fraction for p in self.positions
        ]
        attitudes = []
        for q in self.attitudes:
            a, b = q[:, k : k + 1], q[:, k + 1 : k + 2]
            attitudes.append(
                quaternion_product(
                    a,
                    quaternion_exp(fraction * quaternion_log(quaternion_product(quaternion_conjugate(a), b))),
                )
            )
        return self._relative(*positions, *attitudes)


def max_angle(a: RodState, b: RodState) -> float:
    """Return the largest angle [rad] between the segments of two states of one instant."""
    return float(max_angles(a.attitudes, b.attitudes)[0])


def max_angles(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the largest angles (T,) [rad] between the segments of rods of quaternions (4, N, T)."""
    dot = np.clip(np.abs((a * b).sum(axis=0)), 0.0, 1.0)
    angles: FloatArray = 2.0 * np.arccos(dot.min(axis=0))
    return angles


_MAX_STEP_ROTATION_RAD = 0.4  # maximum rotation of a segment in one accepted step [rad]


def mount_rod(
    rod: Rod,
    start: FloatArray,
    end: FloatArray,
    gravity: FloatArray,
    turning: float | None = None,
    bow: float | None = None,
) -> RodShape:
    """Return the stable shape of a rod mounted between two frames.

    The rod starts as a planar curve that rotates by ``turning`` about the plane's normal and bows to the side
    ``bow``. Its end and weight are then moved to their actual values.

    Args:
        rod: The rod.
        start: Frame of the start clamp (4, 4).
        end: Frame of the end clamp (4, 4).
        gravity: Direction of gravity (3,).
        turning: Rotation about the plane's normal [rad]. Default: the smallest rotation between the frames.
        bow: Side of the bow, +1 towards y or -1 away. Default: the side with less energy.

    Raises:
        RodError: If no stable shape is found.
    """
    drive = EndMotion(rod, np.asarray(start)[None], np.asarray(end)[None], gravity)
    goal = drive.ends
    distance = float(np.linalg.norm(goal.position))
    if distance >= 1.0:
        raise RodError(
            f"the ends are {distance * rod.length * 1e3:.4f} mm apart; a rod of {rod.length * 1e3:.4f} mm "
            "must be longer than that"
        )
    # A planar curve to either side is moved to the clamps. The stable shape of least energy is returned.
    rotation = _closest_rotation(quaternion_log(goal.attitude)[:, 0], turning)
    sides = (1.0, -1.0) if bow is None else (math.copysign(1.0, bow),)
    candidates: list[tuple[float, RodShape]] = []
    for side in sides:
        outcome = _move_to_goal(rod, _initial_state(rod, rotation, distance, side), goal)
        if outcome.is_stable[0]:
            state = outcome.state
            energy = float(rod_energy(rod.stiffness, state.attitudes, goal)[0])
            candidates.append((energy, RodShape(state.attitudes[..., 0], state.force[:, 0])))
    if not candidates:
        raise RodError(
            "no stable shape found for the mounted rod; give another turning or bow, or other end frames"
        )
    # with a tolerance, so that of two equal sides always the first one is returned
    min_energy = min(energy for energy, _ in candidates)
    max_energy = min_energy + 1e-9 * (1.0 + abs(min_energy))
    return next(shape for energy, shape in candidates if energy <= max_energy)


def _initial_state(rod: Rod, rotation: FloatArray, distance: float, side: float) -> RodState:
    """Return a curve that rotates evenly by ``rotation`` (3,) and bows so that its ends have a distance."""
    middle = (np.arange(rod.segments) + 0.5) / rod.segments
    size = _bow_amplitude(rotation[2], distance, middle, side)
    wave = np.outer([0.0, 0.0, 1.0], size * np.sin(2.0 * np.pi * middle))
    q = quaternion_product(quaternion_exp(np.outer(rotation, middle)), quaternion_exp(wave))[..., None]
    return RodState(q, np.zeros((3, 1)))


def _move_to_goal(rod: Rod, state: RodState, goal: RodEnds) -> NewtonResult:
    """Move the end of a rod to its required position, while the weight grows from 0.

    Newton follows the shape in adaptive steps. If even a small step fails, the rod falls into the nearest
    stable shape (`descend`). The result is not stable if this fails, too.
    """
    first = rotation_matrix(state.attitudes)[:, 0].mean(axis=1)
    outcome = descend(rod.stiffness, state, RodEnds(first, goal.attitude, 0.0 * goal.weight))
    reached, step = 0.0, 0.1
    while outcome.is_stable[0] and reached < 1.0:
        fraction = min(1.0, reached + step)
        ends = RodEnds(first + fraction * (goal.position - first), goal.attitude, fraction * goal.weight)
        trial = solve_newton(rod.stiffness, outcome.state, ends)
        if trial.is_stable[0] and max_angle(outcome.state, trial.state) < _MAX_STEP_ROTATION_RAD:
            outcome, reached, step = trial, fraction, min(2.0 * step, 0.25)
        elif step > 0.02:
            step *= 0.5
        else:
            outcome, reached = descend(rod.stiffness, outcome.state, ends), fraction
    return outcome


def _closest_rotation(vector: FloatArray, turning: float | None) -> FloatArray:
    """Return the rotation vector (3,) for an attitude whose rotation about z is closest to ``turning`` [rad].

    ``vector`` (3,) is the shortest rotation vector of the attitude. The others have up to three more full
    rotations about its axis. Without ``turning`` the shortest one is returned.
    """
    if turning is None:
        return vector
    angle = float(np.linalg.norm(vector))
    axis = vector / angle if angle > 1e-6 else np.array([0.0, 0.0, 1.0])
    rounds = [vector + axis * 2.0 * math.pi * k for k in range(-3, 4)]
    return min(rounds, key=lambda candidate: abs(float(candidate[2]) - turning))


def _bow_amplitude(turning: float, distance: float, middle: FloatArray, side: float) -> float:
    """Return the amplitude a [rad] of theta = turning s + a sin(2 pi s) with a given distance of the ends.

    Its sign is that of ``side``. If no amplitude gives the distance, the one that comes closest is returned.
    """

    def distance_excess(size: float) -> float:
        """Return by how much the ends are too far apart for an amplitude."""
        theta = turning * middle + size * np.sin(2.0 * np.pi * middle)
        return math.hypot(float(np.cos(theta).mean()), float(np.sin(theta).mean())) - distance

    sizes = [math.copysign(0.05, side) * k for k in range(71)]
    misses = [distance_excess(size) for size in sizes]
    for k in range(70):
        if misses[k] * misses[k + 1] <= 0.0:
            return float(brentq(distance_excess, sizes[k], sizes[k + 1], xtol=1e-14))
    return sizes[int(np.argmin(np.abs(misses)))]


_INSTANT_BATCH_SIZE = 512  # instants in one batch, for bounded memory
_MAX_COARSE_DIFFERENCE_RAD = 0.2  # largest difference of coarser and finer rod in one shape [rad]


class _RodMeasures(NamedTuple):
    """Properties of shapes in the start clamp's frame and in units of the rod.

    Attributes:
        nodes: Points (3, N+1, T).
        rate: Twist and curvatures (3, N+1, T).
        tension: Tension (N+1, T).
    """

    nodes: FloatArray
    rate: FloatArray
    tension: FloatArray


def make_path(
    rod: Rod,
    end_motion: EndMotion,
    state: RodState,
    is_stable: BoolArray,
    has_jumped: BoolArray,
    jump_distance: FloatArray,
) -> RodPath:
    """Compute points, curvature, tension and stability of the shapes at all instants, in batches.

    Args:
        rod: The rod.
        end_motion: Motion of the ends.
        state: Shapes at T instants.
        is_stable: Whether each shape is stable (T,).
        has_jumped: Whether the rod jumped (T,).
        jump_distance: Displacement by the jump (T,) [m].
    """
    ends, length, count = end_motion.ends, rod.length, state.attitudes.shape[2]
    parts, eigenvalues, errors = [], [], []
    for first in range(0, count, _INSTANT_BATCH_SIZE):
        batch = slice(first, first + _INSTANT_BATCH_SIZE)
        batch_state, batch_ends = RodState(state.attitudes[..., batch], state.force[:, batch]), ends.at(batch)
        eigenvalues.append(weakest_eigenvalues(rod.stiffness, batch_state, batch_ends))
        measures, error = _extrapolate(rod.stiffness, batch_state, batch_ends)
        parts.append(measures)
        errors.append(error)
    nodes, rate, tension = (np.concatenate(items, axis=-1) for items in zip(*parts, strict=True))
    eigenvalue = np.concatenate(eigenvalues)
    for k in np.flatnonzero(~is_stable):
        instant = slice(k, k + 1)
        eigenvalue[k] = weakest_mode(
            rod.stiffness, RodState(state.attitudes[..., instant], state.force[:, instant]), ends.at(instant)
        )[0]
    frame = rotation_matrix(end_motion.attitudes[0])
    end_gap = rotation_matrix(state.attitudes)[:, 0].mean(axis=1) - ends.position
    return RodPath(
        points=length * np.einsum("ijt,jkt->tki", frame, nodes) + end_motion.start[:, None, :3, 3],
        frames=np.einsum("ijt,jlkt->tkil", frame, rotation_matrix(_node_attitudes(state.attitudes, ends))),
        curvature=np.moveaxis(rate[1:], (0, 1, 2), (2, 1, 0)) / length,
        twist=rate[0].T / length,
        tension=tension.T * rod.soft_bending / length**2,
        residual=length * np.sqrt((end_gap * end_gap).sum(axis=0)),
        error=length * np.concatenate(errors),
        is_stable=is_stable,
        min_eigenvalue=eigenvalue / (4.0 * math.pi**2),
        has_jumped=has_jumped,
        jump_distance=jump_distance,
        shapes=tuple(RodShape(state.attitudes[..., k], state.force[:, k]) for k in range(count)),
    )


def _extrapolate(stiffness: FloatArray, state: RodState, ends: RodEnds) -> tuple[_RodMeasures, FloatArray]:
    """Return Richardson-extrapolated measures, and the largest displacement of the points by it (T,).

    Lengths are in lengths of the rod. Where the coarse rod does not have the shape of the fine one, the
    measures are those of the fine rod and the displacement is infinite.
    """
    fine = _measure_state(state, ends)
    # coarse rod: each attitude is the mean of two; only the same shape may be combined
    left, right = state.attitudes[:, ::2], state.attitudes[:, 1::2]
    half = left + np.where((left * right).sum(axis=0) < 0.0, -right, right)
    half /= np.sqrt((half * half).sum(axis=0))
    outcome = solve_newton_many(stiffness, RodState(half, state.force), ends)
    is_same_shape = (
        outcome.is_stable
        & outcome.is_continuation
        & (max_angles(half, outcome.state.attitudes) < _MAX_COARSE_DIFFERENCE_RAD)
    )
    coarse = _measure_state(outcome.state, ends)
    n = state.attitudes.shape[1]
    # Richardson: fine + (fine - coarse) / 3 at common points, the difference interpolated between them
    coarse_s, fine_s = np.linspace(0.0, 1.0, n // 2 + 1), np.linspace(0.0, 1.0, n + 1)
    improved = []
    for a, b in zip(fine, coarse, strict=True):
        change = np.where(is_same_shape, (a[..., ::2, :] - b) / 3.0, 0.0)
        improved.append(a + CubicSpline(coarse_s, change, axis=-2)(fine_s))
    shift = improved[0] - fine.nodes
    return _RodMeasures(*improved), np.where(
        is_same_shape, np.sqrt((shift * shift).sum(axis=0)).max(axis=0), np.inf
    )


def _node_attitudes(q: FloatArray, ends: RodEnds) -> FloatArray:
    """Return attitudes (4, N + 1, T) at the points, for attitudes ``q`` (4, N, T) of the segments.

    The outer ones are those of the clamps, the inner ones are halfway between neighbouring segments.
    """
    left, right = q[:, :-1], q[:, 1:]
    inner = left + np.where((left * right).sum(axis=0) < 0.0, -right, right)
    inner = inner / np.sqrt((inner * inner).sum(axis=0))
    start = np.zeros_like(q[:, :1])
    start[0] = 1.0
    return np.concatenate([start, inner, ends.attitude[:, None]], axis=1)


def _measure_state(state: RodState, ends: RodEnds) -> _RodMeasures:
    """Return points, twist, curvature and tension of a discrete rod."""
    n = state.attitudes.shape[1]
    steps = rotation_matrix(state.attitudes)[:, 0] / n
    nodes = np.concatenate([np.zeros_like(steps[:, :1]), np.cumsum(steps, axis=1)], axis=1)
    p = joint_quaternions(state.attitudes, ends.attitude)
    # twist and curvatures phi / D at the joints; tension t.(F + w (1 - s)) at the points
    rate = p[1:] * ((8.0 - 2.0 * p[0]) / 3.0) / joint_spacing(n)[:, None]
    # the outer joints belong to the clamps' half segments; extrapolate them by a cubic through the inner ones
    rate[:, 0] = 4.0 * rate[:, 1] - 6.0 * rate[:, 2] + 4.0 * rate[:, 3] - rate[:, 4]
    rate[:, -1] = 4.0 * rate[:, -2] - 6.0 * rate[:, -3] + 4.0 * rate[:, -4] - rate[:, -5]
    tangent = rotation_matrix(_node_attitudes(state.attitudes, ends))[:, 0]
    force = state.force[:, None] + ends.weight[:, None] * np.linspace(1.0, 0.0, n + 1)[:, None]
    return _RodMeasures(nodes, rate, (tangent * force).sum(axis=0))


_FOLLOW_STRIDE = 8  # instants between those that are followed one after another
_MAX_GUESS_DIFFERENCE_RAD = 0.15  # maximum difference of a shape from the mean of its neighbours [rad]
_MIN_STEP_FRACTION = 1.0 / 64.0  # minimum step, as a fraction of the move from one instant to the next


@dataclass
class _FollowedStates:
    """States by instant, filled while the rod is followed."""

    q: FloatArray
    force: FloatArray
    has_jumped: BoolArray
    jump_distance: FloatArray
    is_stable: BoolArray

    def put(self, k: int, state: RodState, is_stable: bool) -> None:
        """Store the state of instant k."""
        self.q[..., k], self.force[:, k] = state.attitudes[..., 0], state.force[:, 0]
        self.is_stable[k] = is_stable

    def get(self, k: int) -> RodState:
        """Return the state of instant k."""
        return RodState(self.q[..., k : k + 1], self.force[:, k : k + 1])


def follow_rod(
    rod: Rod,
    start_frames: FloatArray,
    end_frames: FloatArray,
    gravity: FloatArray,
    initial: RodShape,
    stride: int = _FOLLOW_STRIDE,
) -> RodPath:
    """Follow the shape of a rod from an initial shape through the motion of its ends.

    Every ``stride``-th instant is solved from the previous one, in smaller steps where the shape changes
    fast. The instants in between are solved all at once, from interpolated shapes. A solution that is stable
    and close to its interpolated shape belongs to the same branch. Other instants are followed stepwise.

    Args:
        rod: The rod.
        start_frames: Frames of the start clamp (T, 4, 4).
        end_frames: Frames of the end clamp (T, 4, 4).
        gravity: Direction of gravity (3,) of any length.
        initial: Shape at the first instant.
        stride: Instants from one to the next that are solved one after another.

    Raises:
        RodError: If the inputs are invalid.
    """
    end_motion = EndMotion(rod, start_frames, end_frames, gravity)
    count, n = len(end_motion.start), initial.attitudes.shape[1]
    if n != rod.segments:
        raise RodError(f"the initial shape has {n} segments, the rod {rod.segments}")
    no_flags = np.zeros(count, dtype=bool)
    states = _FollowedStates(
        np.zeros((4, n, count)), np.zeros((3, count)), no_flags, np.zeros(count), no_flags.copy()
    )
    state = RodState(initial.attitudes[..., None], initial.force[:, None])
    _settle_instant(rod, end_motion, states, 0, state)
    # Every stride-th instant follows from the previous one, stepwise if the shape changes too much.
    marks = [*range(0, count, max(1, stride))]
    marks += [count - 1] if marks[-1] != count - 1 else []
    pending: list[tuple[int, int]] = []
    for a, b in pairwise(marks):
        direct = solve_newton(rod.stiffness, states.get(a), end_motion.at(float(b)))
        if b - a > 1 and _is_continuation(states.get(a), direct):
            states.put(b, direct.state, True)
            pending.append((a, b))
        else:
            _follow_stepwise(rod, end_motion, states, a, b)
    # The instants between all at once; spans where that fails are followed stepwise.
    for a, b in _fill_spans(rod, end_motion, states, pending):
        _follow_stepwise(rod, end_motion, states, a, b)
    return make_path(
        rod,
        end_motion,
        RodState(states.q, states.force),
        states.is_stable,
        states.has_jumped,
        states.jump_distance,
    )


def _settle_instant(
    rod: Rod, end_motion: EndMotion, states: _FollowedStates, k: int, state: RodState
) -> None:
    """Solve for the shape at instant k from a guess, and store it.

    If no continuation of the guess is stable, the rod falls into another shape, which is stored as a jump. If
    the ends are too far apart for any shape, the guess is stored as unstable.
    """
    ends = end_motion.at(float(k))
    outcome = solve_newton(rod.stiffness, state, ends)
    if _ends_too_far(ends):
        states.put(k, state, False)
        return
    if not _is_continuation(state, outcome):
        outcome = descend(rod.stiffness, state, ends)
        states.has_jumped[k] = True
        states.jump_distance[k] = rod.length * _max_point_distance(state, outcome.state)
    states.put(k, outcome.state, bool(outcome.is_stable[0]))


def _follow_stepwise(rod: Rod, end_motion: EndMotion, states: _FollowedStates, a: int, b: int) -> None:
    """Follow the rod from instant a to b, with smaller steps where needed, and store its states.

    Jumps are marked at the next instant. If the ends are too far apart, the last shape is kept as unstable.
    """
    state, is_stable = states.get(a), bool(states.is_stable[a])
    for k in range(a, b):
        time, step = float(k), 1.0
        while time < k + 1:
            goal = min(time + step, k + 1.0)
            outcome = solve_newton(rod.stiffness, state, end_motion.at(goal))
            # go on with twice the step, halve it, or at the smallest step let the rod fall into another shape
            if _is_continuation(state, outcome):
                state, time, step, is_stable = outcome.state, goal, 2.0 * step, True
            elif step > _MIN_STEP_FRACTION:
                step *= 0.5
            elif _ends_too_far(end_motion.at(goal)):
                time, is_stable = goal, False
            else:
                settled = descend(rod.stiffness, _falling_state(state, outcome), end_motion.at(goal))
                states.has_jumped[k + 1] = True
                states.jump_distance[k + 1] += rod.length * _max_point_distance(state, settled.state)
                state, time, is_stable = settled.state, goal, bool(settled.is_stable[0])
        states.put(k + 1, state, is_stable)


def _is_continuation(state: RodState, outcome: NewtonResult) -> bool:
    """Return whether the outcome is stable, continues its guess, and is close to ``state``."""
    return (
        bool(outcome.is_stable[0] and outcome.is_continuation[0])
        and max_angle(state, outcome.state) < _MAX_STEP_ROTATION_RAD
    )


def _ends_too_far(ends: RodEnds) -> bool:
    """Return whether the ends are farther apart than the length of the rod, so that no shape exists."""
    return float(np.linalg.norm(ends.position)) >= 1.0 - 1e-12


def _falling_state(state: RodState, outcome: NewtonResult) -> RodState:
    """Return the state from which the rod falls.

    This is a nearby unstable equilibrium, else the last stable shape.
    """
    is_near = outcome.converged[0] and max_angle(state, outcome.state) < _MAX_STEP_ROTATION_RAD
    return outcome.state if is_near else state


def _max_point_distance(a: RodState, b: RodState) -> float:
    """Return the largest distance between the points of two states of one instant, in units of the length."""
    n = a.attitudes.shape[1]
    gap = np.cumsum(rotation_matrix(a.attitudes)[:, 0] - rotation_matrix(b.attitudes)[:, 0], axis=1) / n
    return float(np.sqrt((gap * gap).sum(axis=0)).max())


def _fill_spans(
    rod: Rod, end_motion: EndMotion, states: _FollowedStates, spans: list[tuple[int, int]]
) -> list[tuple[int, int]]:
    """Solve for all instants between the ends of spans (first, last) at once, and store the states.

    Guesses are interpolated between the states at both ends. A solution is accepted if it is stable and close
    to its guess.

    Returns:
        The spans in which an instant was not accepted, to be followed stepwise.
    """
    inside = [np.arange(a + 1, b) for a, b in spans]
    if not inside:
        return []
    instants = np.concatenate(inside)
    left = np.concatenate([np.full(b - a - 1, a) for a, b in spans])
    right = np.concatenate([np.full(b - a - 1, b) for a, b in spans])
    fraction = (instants - left) / (right - left)
    qa, qb = states.q[..., left], states.q[..., right]
    guess = apply_step(
        RodState(qa, states.force[:, left]),
        fraction * quaternion_log(quaternion_product(quaternion_conjugate(qa), qb)),
        fraction * (states.force[:, right] - states.force[:, left]),
    )
    failed: list[tuple[int, int]] = []
    is_valid = np.zeros(len(instants), dtype=bool)
    for first in range(0, len(instants), 512):  # bounded memory
        batch = slice(first, first + 512)
        outcome = solve_newton_many(
            rod.stiffness,
            RodState(guess.attitudes[..., batch], guess.force[:, batch]),
            end_motion.ends.at(instants[batch]),
        )
        is_valid[batch] = (
            outcome.is_stable
            & outcome.is_continuation
            & (max_angles(guess.attitudes[..., batch], outcome.state.attitudes) < _MAX_GUESS_DIFFERENCE_RAD)
        )
        states.q[..., instants[batch]] = outcome.state.attitudes
        states.force[:, instants[batch]] = outcome.state.force
    states.is_stable[instants] = is_valid
    for a, b in spans:
        if not states.is_stable[a + 1 : b].all():
            failed.append((a, b))
    return failed
