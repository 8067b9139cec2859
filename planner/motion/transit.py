"""Repair of transits between cuts of coupled tools: a transit that would collide is rerouted.

Coupled tools are two tools that hold one wire. They keep their relative pose, so both move as a rigid pair.
"""

import dataclasses
import itertools
from collections.abc import Mapping
from typing import Final

import numpy as np

from planner.claims.segments import Segment
from planner.geometry.arrays import (
    BoolArray,
    FloatArray,
    exp_rotation,
    from_parts,
    interpolate,
    inverse,
    log_rotation,
)
from planner.motion.planning_scene import TRANSIT_KIND, Scene
from planner.motion.rrt import ConfigurationSpace, connect_points
from planner.motion.search.layered_graph_search import PathResult
from planner.motion.search.subsampling import select_targets
from planner.targets import FlexibleTool, Freedom, TableFreedom, Targets

SHAPE_TOLERANCE: Final = 1e-6
"""Difference [m, rad] below which relative poses of the TCPs are the same."""

LIFT_HEIGHTS_M: Final = (0.1, 0.2, 0.3, 0.45, 0.6)
"""Heights [m] by which a pair of tools is lifted between cuts, smallest first."""
MAX_ROTATION_STEP_RAD: Final = np.deg2rad(1.0)
"""Maximum rotation [rad] of one move. Linear moves of both ends shorten the pair during a rotation."""

CHECK_SPACING_M: Final = 0.02
"""Distance [m] between checks along a transit."""

YAW_WEIGHT_M: Final = 0.3
"""Length [m] that weighs a yaw of 1 rad in the search."""


def repair_transits(scene: Scene, targets: Targets, path_result: PathResult) -> Targets | None:
    """Replace transit moves that collide by several moves around the obstacle.

    A move that cannot be repaired stays as it is, and the check of all moves reports it.

    Args:
        scene: Cell with the stock in its pose.
        targets: Targets of the operation.
        path_result: Path of the layered graph.

    Returns:
        The targets with additional transit targets, or None if nothing was replaced.
    """
    motions_by_target: dict[int, list[FloatArray]] = {}
    for i in range(1, targets.count):
        if targets.segment[i].kind == TRANSIT_KIND and targets.coupled:
            motions = _TransitMove(scene, targets, path_result, i).find_motions()
            if motions:
                motions_by_target[i] = motions
    return _insert_targets(targets, motions_by_target) if motions_by_target else None


class _TransitMove:
    """The transit move of a pair of tools to target ``i``.

    A motion of the pair is a rigid motion (4, 4) in the work frame, applied to the poses of target i - 1.

    Attributes:
        total_motion: (4, 4) motion of the whole move.
        same_shape: Whether the tools have the same relative pose at both ends.
        centre: (3,) [m] mean position of the TCPs at target i - 1, in the work frame.
    """

    def __init__(self, scene: Scene, targets: Targets, path_result: PathResult, i: int) -> None:
        """Prepare the move to target ``i`` on a path of the layered graph."""
        self.scene, self.targets, self.path_result, self.i = scene, targets, path_result, i
        self.source = select_targets(targets, np.array([i - 1]))
        ends = {arm: pose[[i - 1, i]] for arm, pose in targets.pose.items()}  # nominal, without freedoms
        arms = targets.arms
        self.total_motion = ends[arms[0]][1] @ inverse(ends[arms[0]][0])
        gap = max(float(np.abs(ends[a][1] - self.total_motion @ ends[a][0]).max()) for a in arms)
        self.same_shape = gap < SHAPE_TOLERANCE
        self.centre = np.mean([ends[a][0, :3, 3] for a in arms], axis=0)

    def find_motions(self) -> list[FloatArray]:
        """Find motions (4, 4) of target i - 1 that give the targets to insert before target i.

        The pair is lifted higher and higher, then a path is searched. The list is empty if the straight move
        is free, or if no free path was found. It is also empty if the tools change their relative pose on the
        move, because they are no rigid pair then.
        """
        if not self.same_shape:
            return []
        goal = self.total_motion
        for lift in (0.0, *LIFT_HEIGHTS_M):
            corners = (
                [np.eye(4), goal] if lift == 0.0 else [np.eye(4), *self._lifted_corners(goal, lift), goal]
            )
            if self._is_free(corners):
                return self._split_rotations(corners)[1:-1]  # without both ends
        searched_corners = self._search_motions(goal)
        return self._split_rotations(searched_corners)[1:-1] if searched_corners else []

    def _lifted_corners(self, goal: FloatArray, lift: float) -> list[FloatArray]:
        """Return the two inner corners of the path up by ``lift`` [m], across, and down to ``goal``.

        Up is the vertical of the world.
        """
        up = self._up_axis() * lift
        rise, lower_start = np.eye(4), goal.copy()
        rise[:3, 3] += up
        lower_start[:3, 3] += up
        return [rise, lower_start]

    def _up_axis(self) -> FloatArray:
        """Return the vertical of the world (3,) in the work frame."""
        frame = self.targets.frame.get(self.targets.arms[0], "stock")
        return np.array([0.0, 0.0, 1.0]) if frame == "world" else self.scene.stock[2, :3].copy()

    def _interpolate(self, a: FloatArray, b: FloatArray, fraction: FloatArray) -> FloatArray:
        """Interpolate between two motions at fractions (K,).

        Returns motions (K, 4, 4) with which the pair's centre moves linearly and the pair rotates at a
        constant rate.
        """
        centre_pose = from_parts(np.eye(3), self.centre)
        return interpolate(a @ centre_pose, b @ centre_pose, fraction) @ inverse(centre_pose)

    def _split_rotations(self, corners: list[FloatArray]) -> list[FloatArray]:
        """Insert motions between corners so that moves rotate by at most `MAX_ROTATION_STEP_RAD`."""
        out = [corners[0]]
        for a, b in itertools.pairwise(corners):
            angle = float(np.linalg.norm(log_rotation(a[:3, :3].T @ b[:3, :3])))
            count = max(1, int(np.ceil(angle / MAX_ROTATION_STEP_RAD)))
            out.extend(self._interpolate(a, b, np.arange(1, count) / count) if count > 1 else [])
            out.append(b)
        return out

    def _is_free(self, corners: list[FloatArray]) -> bool:
        """Whether moves between corners are free, checked every :data:`CHECK_SPACING_M`.

        The values of the freedoms change linearly over the checked points, from target i - 1 to target i.
        """
        points = []
        for a, b in itertools.pairwise(corners):
            shift = float(
                np.linalg.norm((b @ np.append(self.centre, 1.0) - a @ np.append(self.centre, 1.0))[:3])
            )
            angle = float(np.linalg.norm(log_rotation(a[:3, :3].T @ b[:3, :3])))
            count = max(2, int(np.ceil((shift + YAW_WEIGHT_M * angle) / CHECK_SPACING_M)))
            points.append(self._interpolate(a, b, np.arange(count) / count))
        points.append(corners[-1][None])
        motions = np.concatenate(points)
        fraction = np.linspace(0.0, 1.0, len(motions))
        return bool(self._are_allowed(motions, fraction).all())

    def _are_allowed(self, motions: FloatArray, fraction: FloatArray) -> BoolArray:
        """Return for each of K motions (K, 4, 4) of the pair whether the arms keep margins and clearance.

        ``fraction`` (K,) is the fraction of the change of the freedoms from target i - 1 to target i.
        """
        rows = np.zeros(len(motions), dtype=np.intp)
        start, end = self.path_result.values[self.i - 1], self.path_result.values[self.i]
        values = start + fraction[:, None] * (end - start)
        local = self.source.poses(values, rows)
        world = self.scene.world_poses(self.targets, {arm: motions @ pose for arm, pose in local.items()})
        is_allowed = np.ones(len(motions), dtype=bool)
        q: dict[str, FloatArray] = {}
        for arm, pose in world.items():
            chain = self.scene.chains[arm]
            redundant_angle = self.targets.last_joint_angle(arm, values)
            angles = chain.inverse(pose, [self.path_result.path.branch[arm]], redundant_angle)[:, 0]
            previous_joints = self.path_result.q[arm][self.i - 1]
            q[arm] = chain.continuous(angles, np.broadcast_to(previous_joints, angles.shape))
            is_allowed &= chain.limit_margin(q[arm]) >= self.scene.settings.joint_margin
            is_allowed &= chain.singularity_margin(q[arm]) >= self.scene.settings.singularity_margin
        rows_in_limits = np.flatnonzero(is_allowed)
        if len(rows_in_limits):
            moved_targets = self._moved_targets(motions[rows_in_limits], self.targets.segment[self.i])
            is_allowed[rows_in_limits] = self.scene.keeps_clearance(
                moved_targets, {a: v[rows_in_limits] for a, v in q.items()}, np.arange(len(rows_in_limits))
            )
        return is_allowed

    def _moved_targets(self, motions: FloatArray, segment: Segment) -> Targets:
        """Return K copies of target i - 1, moved by motions (K, 4, 4), in the given segment."""
        rows = np.zeros(len(motions), dtype=np.intp)
        return move_targets(select_targets(self.source, rows), motions, segment)

    def _search_motions(self, goal: FloatArray) -> list[FloatArray] | None:
        """Search a free path of the pair from target i - 1 to the motion ``goal`` (4, 4).

        The coordinates of the search are x, y, z [m] of the pair's centre, its yaw times
        :data:`YAW_WEIGHT_M` [m], and a fraction of the remaining rotation (tilt) and of the freedoms.

        Returns:
            Motions of the waypoints including both ends, or None if no path was found.
        """
        up = self._up_axis()
        rotation = log_rotation(goal[:3, :3])
        yaw = float(rotation @ up)
        tilt_rotation = exp_rotation(-yaw * up) @ goal[:3, :3]
        tilt = log_rotation(tilt_rotation)
        start = np.zeros(5)
        shift = goal[:3, :3] @ self.centre + goal[:3, 3] - self.centre
        end = np.array([*shift, yaw * YAW_WEIGHT_M, 1.0])

        def motions(points: FloatArray) -> FloatArray:
            """Return the motions (K, 4, 4) at points (K, 5)."""
            rotations = exp_rotation(points[:, 3:4] / YAW_WEIGHT_M * up) @ exp_rotation(points[:, 4:5] * tilt)
            return from_parts(
                rotations, self.centre + points[:, :3] - np.einsum("kij,j->ki", rotations, self.centre)
            )

        def is_free(points: FloatArray) -> BoolArray:
            return self._are_allowed(motions(points), np.clip(points[:, 4], 0.0, 1.0))

        # random points lie within these distances [m] of both ends: more above them than below
        lower = np.minimum(start, end) - np.array([0.5, 0.5, 0.3, 0.3, 0.0])
        upper = np.maximum(start, end) + np.array([0.5, 0.5, 0.7, 0.3, 0.0])
        space = ConfigurationSpace(is_free, lower, upper, 2.0 * CHECK_SPACING_M)
        path = connect_points(start, end, space, self.scene.settings.seed, rounds=400)
        if path is None:
            return None
        corners = list(motions(path))
        corners[-1] = goal
        return corners


def move_targets(targets: Targets, motions: FloatArray, segment: Segment) -> Targets:
    """Move poses, pose tables and flexible edge of N targets by rigid motions (N, 4, 4) in the work frame.

    All of them become part of ``segment``.
    """
    edge = targets.flexible_tool
    if edge is not None:
        points = np.einsum("nij,npj->npi", motions[:, :3, :3], edge.points) + motions[:, None, :3, 3]
        edge = FlexibleTool(points, edge.radius)
    return dataclasses.replace(
        targets,
        pose={arm: motions @ pose for arm, pose in targets.pose.items()},
        freedoms=tuple(_move_freedom(f, motions) for f in targets.freedoms),
        flexible_tool=edge,
        segment=(segment,) * len(motions),
    )


def _move_freedom(freedom: Freedom, motions: FloatArray) -> Freedom:
    """Move the poses of a table by motions (N, 4, 4); other freedoms do not depend on the pose."""
    if not isinstance(freedom, TableFreedom):
        return freedom
    pose = {arm: motions[:, None] @ table for arm, table in freedom.pose.items()}
    return dataclasses.replace(freedom, pose=pose)


def _insert_targets(targets: Targets, motions_by_target: Mapping[int, list[FloatArray]]) -> Targets:
    """Return the targets with additional ones inserted before each target i in ``motions_by_target``.

    The additional targets are copies of target i - 1, moved by ``motions_by_target[i]``. They belong to the
    segment of target i, are stops, and have no minimum feed. Path lengths of the moves to and from them are
    those of the flexible edge, or of the TCPs without one.
    """
    rows: list[int] = []
    is_added: list[bool] = []
    motions: list[FloatArray] = []
    new_index = np.zeros(targets.count, dtype=np.intp)
    for i in range(targets.count):
        for motion in motions_by_target.get(i, []):
            rows.append(i - 1)
            is_added.append(True)
            motions.append(motion)
        new_index[i] = len(rows)
        rows.append(i)
        is_added.append(False)
        motions.append(np.eye(4))
    index, added = np.array(rows, dtype=np.intp), np.array(is_added)
    owner = np.searchsorted(new_index, np.arange(len(rows)))  # the original target that a target belongs to
    out = move_targets(select_targets(targets, index), np.array(motions), targets.segment[0])
    edge = out.flexible_tool
    points = (
        edge.points if edge is not None else np.stack([out.pose[a][:, :3, 3] for a in targets.arms], axis=1)
    )
    travel = np.append(0.0, np.linalg.norm(np.diff(points, axis=0), axis=-1).max(axis=1))
    is_changed = added | np.append(False, added[:-1])  # the moves to and from additional targets
    return dataclasses.replace(
        out,
        segment=tuple(targets.segment[i] for i in owner),
        feed=targets.feed[owner],
        feed_min=np.where(added, 0.0, targets.feed_min[owner]),
        travel=np.where(is_changed, travel, targets.travel[owner]),
        stop=np.where(added, True, targets.stop[owner]),
        actions=tuple(dataclasses.replace(a, target=int(new_index[a.target])) for a in targets.actions),
        claims=targets.claims,
        exhibits=targets.exhibits,
        issues=targets.issues,
    )
