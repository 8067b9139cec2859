"""Subsets of targets and coarse samples of freedoms, for searches too large to run in full.

The module selects targets, samples a few of them coarsely to score stock poses, samples many freedoms at
once, and interpolates between samples of different targets.

A sample of many freedoms has one coordinate per freedom, shared by all targets: the fraction of the range, or
the angle of a full turn. Angles are measured from a zero that does not jump where the nominal poses of the
targets rotate about the freedom's own axis, as they do at corners.
"""

import dataclasses
import functools
import itertools
from typing import Final

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IndexArray, inverse, spread_rows, to_quaternion
from planner.motion.planning_scene import FULL_TURN_RAD, frame_holders
from planner.motion.search.reach import is_full_turn, is_sampled_as_slide, sample_freedoms
from planner.problem import Cell
from planner.targets import FlexibleTool, Freedom, JointFreedom, ScrewFreedom, TableFreedom, Targets


def select_targets(targets: Targets, rows: IndexArray) -> Targets:
    """Return the targets at indices ``rows`` (K,), in that order; indices may repeat.

    Actions, claims, exhibits and issues of the operation are left out.
    """
    edge = (
        None
        if targets.flexible_tool is None
        else FlexibleTool(targets.flexible_tool.points[rows], targets.flexible_tool.radius)
    )
    return dataclasses.replace(
        targets,
        pose={arm: pose[rows] for arm, pose in targets.pose.items()},
        freedoms=tuple(select_freedom_rows(f, rows) for f in targets.freedoms),
        feed=targets.feed[rows],
        feed_min=targets.feed_min[rows],
        travel=targets.travel[rows],
        stop=targets.stop[rows],
        segment=tuple(targets.segment[i] for i in rows),
        flexible_tool=edge,
        track_positions={arm: values[rows] for arm, values in targets.track_positions.items()},
        actions=(),
        claims=(),
        exhibits={},
        issues=(),
    )


def select_freedom_rows(freedom: Freedom, rows: IndexArray) -> Freedom:
    """Return a freedom for the targets at indices ``rows`` (K,).

    Raises:
        TypeError: The freedom has an unknown type.
    """
    prefer = None if freedom.prefer is None else freedom.prefer[rows]
    if isinstance(freedom, TableFreedom):
        pose = {arm: table[rows] for arm, table in freedom.pose.items()}
        return dataclasses.replace(
            freedom, pose=pose, lower=freedom.lower[rows], upper=freedom.upper[rows], prefer=prefer
        )
    if isinstance(freedom, ScrewFreedom | JointFreedom):
        return dataclasses.replace(
            freedom, lower=freedom.lower[rows], upper=freedom.upper[rows], prefer=prefer
        )
    raise TypeError(f"unknown freedom {type(freedom).__name__}")


COARSE_SPIN_STEP_RAD: Final = np.deg2rad(30.0)
"""Step [rad] of coarse samples of rotational freedoms."""
FINE_SPIN_STEP_RAD: Final = np.deg2rad(15.0)
"""Step [rad] of fine samples of rotational freedoms."""
FINE_SLIDE_SAMPLES: Final = 3
"""Number of fine samples of a slide."""
MAX_FINE_SAMPLES: Final = 120
"""Maximum number of fine samples of a target. With more, coarse samples are used."""
MIN_LONG_SLIDE_M: Final = 0.2
"""Range [m] of a slide above which it is sampled in the placement search."""

SLIDE_SAMPLE_FRACTION: Final = 0.75
"""Fraction of the way from the middle to either end at which long slides are sampled."""

COARSE_FULL_TURN_SAMPLES: Final = 6
"""Number of coarse samples of each full turn if there are several."""


@dataclasses.dataclass(frozen=True)
class SampledTargets:
    """A few targets with samples of their freedoms.

    Attributes:
        cell: Cell with the tools of these targets.
        targets: The targets.
        index: (M,) target of each sampled state.
        poses: {arm: (M, 4, 4)} TCP poses of the sampled states in the work frames.
        every_branch: Whether every combination of branches is to be checked.
    """

    cell: Cell
    targets: Targets
    index: IndexArray
    poses: dict[str, FloatArray]
    every_branch: bool = False

    @functools.cached_property
    def distinct_poses(self) -> dict[str, tuple[IndexArray, IndexArray]]:
        """Distinct poses of each arm whose work frame and base do not move.

        States that differ only in freedoms of other arms share a pose, so an arm has few distinct ones.

        Returns:
            {arm: (indices (D,) of states with distinct poses, number (M,) of the distinct pose of each
            state)}.
        """
        out = {}
        for arm, holder in frame_holders(self.targets):
            if holder is None and arm not in self.targets.track_positions:
                flat = self.poses[arm].reshape(len(self.index), 16).round(9)
                _, first_index, pose_index = np.unique(flat, axis=0, return_index=True, return_inverse=True)
                out[arm] = first_index, pose_index.reshape(-1)
        return out


def sample_coarsely(cell: Cell, targets: Targets, count: int, with_slides: bool) -> SampledTargets:
    """Sample about ``count`` evenly spread targets of a job coarsely, to score stock poses and stations.

    Long slides are sampled in their middle only, unless ``with_slides``.
    """
    selected = select_targets(targets, spread_rows(targets.count, count))
    values = coarse_samples(selected)
    if with_slides:
        values = _with_slide_samples(selected, values)
    return _make_sampled(cell, selected, values)


def sample_finely(cell: Cell, targets: Targets, count: int) -> SampledTargets:
    """Sample about ``count`` evenly spread targets of a job finely, to be checked on every branch."""
    selected = select_targets(targets, spread_rows(targets.count, count))
    values = sample_freedoms(selected, FINE_SPIN_STEP_RAD, FINE_SLIDE_SAMPLES).values
    values = values if values.shape[1] <= MAX_FINE_SAMPLES else coarse_samples(selected)
    return dataclasses.replace(_make_sampled(cell, selected, values), every_branch=True)


def _make_sampled(cell: Cell, targets: Targets, values: FloatArray) -> SampledTargets:
    """Create the sampled states of N targets from values (N, S, F) of their freedoms."""
    index = np.repeat(np.arange(targets.count), values.shape[1])
    return SampledTargets(cell, targets, index, targets.poses(values.reshape(len(index), -1), index))


def coarse_samples(targets: Targets) -> FloatArray:
    """Return coarse samples (N, S, F) of all freedoms.

    Rotations are sampled every 30 degrees, slides in their middle. With several full turns, these are sampled
    every 60 degrees and all other freedoms are neutral.
    """
    is_ring = np.array([is_full_turn(f) for f in targets.freedoms], dtype=bool)
    if is_ring.sum() < 2:
        return sample_freedoms(targets, COARSE_SPIN_STEP_RAD, slides=1).values
    ring = -np.pi + 2.0 * np.pi * np.arange(COARSE_FULL_TURN_SAMPLES) / COARSE_FULL_TURN_SAMPLES
    grid = np.array(list(itertools.product(ring, repeat=int(is_ring.sum()))))
    values = np.repeat(targets.neutral_values()[:, None], len(grid), axis=1)
    values[..., is_ring] = grid
    return values


def are_long_slides(targets: Targets) -> BoolArray:
    """Return for each of F freedoms whether it is a slide with a range above :data:`MIN_LONG_SLIDE_M`."""
    return np.array(
        [
            is_sampled_as_slide(f) and float(np.max(f.upper - f.lower)) > MIN_LONG_SLIDE_M
            for f in targets.freedoms
        ],
        dtype=bool,
    )


def _with_slide_samples(targets: Targets, values: FloatArray) -> FloatArray:
    """Append to samples (N, S, F) copies in which one long slide is moved toward either of its ends.

    It is moved from the middle by :data:`SLIDE_SAMPLE_FRACTION` of half its range.
    """
    out = [values]
    for j in np.flatnonzero(are_long_slides(targets)):
        freedom = targets.freedoms[j]
        middle, half_range = 0.5 * (freedom.upper + freedom.lower), 0.5 * (freedom.upper - freedom.lower)
        for fraction in (-SLIDE_SAMPLE_FRACTION, SLIDE_SAMPLE_FRACTION):
            moved = values.copy()
            moved[..., j] = (middle + fraction * half_range)[:, None]
            out.append(moved)
    return np.concatenate(out, axis=1)


FULL_TURN_SAMPLES = 18
"""Number of samples of a full turn if only full turns are sampled, on a grid."""

LEVEL_SAMPLE_COUNTS = (500, 1500, 900)
"""Numbers of samples over full and bounded turns, over full turns and long slides, and over all freedoms."""

MIDDLE_FRACTION = 0.25
"""Fraction of the samples of a level that keep its new freedoms in their middle."""


@dataclasses.dataclass(frozen=True)
class SamplingLevel:
    """Samples over a part of the freedoms.

    Attributes:
        names: Names of the sampled freedoms. The others stay in their middle.
        samples: (S, F) coordinates of all freedoms, as in :class:`FreedomCoordinates`.
    """

    names: tuple[str, ...]
    samples: FloatArray


class FreedomCoordinates:
    """Converts between values of the freedoms and coordinates that all targets share.

    The coordinate of a full turn is its angle [rad], measured from a zero that does not jump from target to
    target. The coordinate of another freedom is the fraction of its range.

    Attributes:
        is_full_turn: (F,) whether each freedom is a full turn.
        middle: (F,) coordinates of the neutral values.
    """

    def __init__(self, targets: Targets) -> None:
        """Prepare the conversion for N targets with at least one freedom."""
        freedoms = targets.freedoms
        self.is_full_turn = np.array([is_full_turn(f) for f in freedoms], dtype=bool)
        self._lower = np.stack([f.lower for f in freedoms], axis=1)
        self._width = np.stack([f.upper - f.lower for f in freedoms], axis=1)
        self._zero = np.zeros_like(self._lower)
        for j in np.flatnonzero(self.is_full_turn):
            self._zero[:, j] = nominal_rotation(targets, int(j))
        neutral = targets.neutral_values()
        fraction = (neutral - self._lower) / np.where(self._width > 0.0, self._width, 1.0)
        self.middle = np.where(self.is_full_turn, neutral[0] + self._zero[0], np.median(fraction, axis=0))

    def values(self, coordinates: FloatArray, rows: IndexArray) -> FloatArray:
        """Return the values (..., F) of coordinates (..., F) at targets ``rows`` (...,)."""
        from_fraction = self._lower[rows] + coordinates * self._width[rows]
        return np.where(self.is_full_turn, coordinates - self._zero[rows], from_fraction)

    def from_values(self, values: FloatArray) -> FloatArray:
        """Return the coordinates (N, F) of values (N, F) at all targets."""
        fraction = (values - self._lower) / np.where(self._width > 0.0, self._width, 1.0)
        return np.where(self.is_full_turn, values + self._zero, fraction)

    def shortest_change(self, start: FloatArray, end: FloatArray) -> FloatArray:
        """Return the change (..., F) from ``start`` to ``end``; full turns change by half a turn at most."""
        change = end - start
        return np.where(self.is_full_turn, change - FULL_TURN_RAD * np.round(change / FULL_TURN_RAD), change)


def nominal_rotation(targets: Targets, j: int) -> FloatArray:
    """Return the rotation (N,) [rad] of the nominal poses about the axis of freedom j since the first target.

    Angles of full turns are counted from it, so that they do not jump at corners. It is summed from target to
    target, and 0 if the freedom is not a screw.
    """
    freedom = targets.freedoms[j]
    if not isinstance(freedom, ScrewFreedom):
        return np.zeros(targets.count)
    arm, twist = next(iter(freedom.axis.items()))
    changes = inverse(targets.pose[arm][:-1]) @ targets.pose[arm][1:]
    return np.append(0.0, np.cumsum(_rotation_about(twist, changes)))


def _rotation_about(twist: FloatArray, change: FloatArray) -> FloatArray:
    """Return the rotation of pose changes (..., 4, 4) about the axis of a twist (6,), at most half a turn.

    The result (...,) is in units of the freedom that the twist belongs to, which are rad for a unit twist.
    """
    quaternion = to_quaternion(change[..., :3, :3])
    length = float(np.linalg.norm(twist[:3]))
    angle = 2.0 * np.arctan2(quaternion[..., 1:] @ twist[:3] / length, quaternion[..., 0])
    return np.asarray(angle - FULL_TURN_RAD * np.round(angle / FULL_TURN_RAD)) / length


ANGLE_TOLERANCE_RAD: Final = np.deg2rad(3.0)
"""Difference [rad] of angles up to which only one of them is sampled."""


def carry_over(reference_targets: Targets, values: FloatArray, targets: Targets) -> list[FloatArray]:
    """Convert freedom values of reference targets to coordinates of the same freedoms of other targets.

    A search near a reference path starts from these coordinates.

    The tools keep their pose relative to the frames of the targets. If an arm holds a frame and may rotate it
    by a full turn, there is a second result: the frame is rotated until its first targets have the same
    orientation in the world, wherever they are on it.

    Args:
        reference_targets: Targets of the reference plan.
        values: (N, F) values of the freedoms of the reference targets.
        targets: New targets.

    Returns:
        One or two arrays (N, F) of coordinates.
    """
    coordinates = FreedomCoordinates(reference_targets).from_values(values)
    turned_coordinates = coordinates.copy()
    has_held_frame = False
    held_frames = [(arm, holder) for arm, holder in frame_holders(targets) if holder is not None]
    for j, freedom in enumerate(targets.freedoms):
        if not isinstance(freedom, ScrewFreedom) or not is_full_turn(freedom):
            continue
        arm, twist = next(iter(freedom.axis.items()))
        reference_pose, new_pose = reference_targets.pose[arm][0], targets.pose[arm][0]
        coordinates[:, j] -= _rotation_about(twist, inverse(reference_pose) @ new_pose)
        if arm not in dict(held_frames):
            turned_coordinates[:, j] = coordinates[:, j]
        for working_arm in (name for name, holder in held_frames if holder == arm):
            has_held_frame = True
            turned_coordinates[:, j] += _rotation_about(
                twist, reference_targets.pose[working_arm][0] @ inverse(targets.pose[working_arm][0])
            )
    return (
        [coordinates, turned_coordinates]
        if has_held_frame and np.abs(turned_coordinates - coordinates).max() > ANGLE_TOLERANCE_RAD
        else [coordinates]
    )


def sampling_levels(targets: Targets, coordinates: FreedomCoordinates) -> list[SamplingLevel]:
    """Return samples over more and more freedoms, which a search tries in this order.

    A search over few freedoms is faster. Full turns alone are sampled on a grid, other freedoms by a sequence
    that fills their ranges evenly. In a part of the samples the freedoms that a level adds stay in their
    middle.

    The levels are: full turns only, full and bounded turns, full turns and long slides, all freedoms. A level
    that adds no freedom to the previous one is left out.
    """
    freedoms = targets.freedoms
    has_range = np.array([float(np.max(f.upper - f.lower)) > 0.0 for f in freedoms], dtype=bool)
    rotational = has_range & ~np.array([is_sampled_as_slide(f) for f in freedoms], dtype=bool)
    out: list[SamplingLevel] = []
    active = coordinates.is_full_turn  # freedoms of the previous level
    if active.any():
        # with more than two full turns a coarser grid of about LEVEL_SAMPLE_COUNTS[0] samples in total
        count = (
            FULL_TURN_SAMPLES
            if active.sum() <= 2
            else max(4, int(LEVEL_SAMPLE_COUNTS[0] ** (1.0 / active.sum())))
        )
        ring = -np.pi + FULL_TURN_RAD * np.arange(count) / count
        grid = np.array(list(itertools.product(*(ring for _ in range(active.sum())))))
        samples = np.repeat(coordinates.middle[None], len(grid), axis=0)
        samples[:, active] = grid
        out.append(SamplingLevel(_freedom_names(targets, active), samples))
    with_slides = (coordinates.is_full_turn & has_range) | are_long_slides(targets)
    for level_freedoms, count in (
        (rotational, LEVEL_SAMPLE_COUNTS[0]),
        (with_slides, LEVEL_SAMPLE_COUNTS[1]),
        (has_range, LEVEL_SAMPLE_COUNTS[2]),
    ):
        if (level_freedoms & ~active).any():
            samples = np.repeat(coordinates.middle[None], count, axis=0)
            spread = _spread_points(count, int(level_freedoms.sum()))
            samples[:, level_freedoms] = np.where(
                coordinates.is_full_turn[level_freedoms], -np.pi + FULL_TURN_RAD * spread, spread
            )
            in_middle = slice(0, int(MIDDLE_FRACTION * count))
            samples[in_middle, level_freedoms & ~active] = coordinates.middle[level_freedoms & ~active]
            out.append(SamplingLevel(_freedom_names(targets, level_freedoms), samples))
            active = level_freedoms
    return out


def _freedom_names(targets: Targets, active: BoolArray) -> tuple[str, ...]:
    return tuple(f.name for f, used in zip(targets.freedoms, active, strict=True) if used)


def _spread_points(count: int, width: int) -> FloatArray:
    """Return points (count, width) that fill the unit cube evenly (the sequence R_d).

    Coordinate k of point n is 1/2 + n / phi^(k + 1) modulo 1, where phi is the root of phi^(d + 1) = phi + 1
    with d = width.

    Source: Roberts, "The unreasonable effectiveness of quasirandom sequences", 2018.
    """
    root = 2.0
    for _ in range(60):
        root = (1.0 + root) ** (1.0 / (width + 1.0))
    steps = root ** -np.arange(1.0, width + 1.0)
    return np.asarray((0.5 + np.arange(1, count + 1)[:, None] * steps) % 1.0)
