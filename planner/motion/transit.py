"""Transit between cuts of tools that are joined: where its straight way would collide it gets another one,
which keeps their relative pose."""

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
from planner.motion.rrt import connect
from planner.motion.search.ladder_search import Found
from planner.motion.search.subsampling import subset
from planner.targets import Edge, Freedom, TableFreedom, Targets

SAME_SHAPE: Final = 1e-6
"""Relative poses of the TCPs that differ by less [m, rad] count as the same."""

LIFTS_M: Final = (0.1, 0.2, 0.3, 0.45, 0.6)
"""Heights [m] by which a pair of tools is lifted between cuts, smallest first."""
MOST_TURN_RAD: Final = np.deg2rad(1.0)
"""A turn of the pair is cut into moves of at most this angle [rad], since straight moves of both ends
shorten the pair."""

CHECK_SPACING_M: Final = 0.02
"""Distance [m] between checks along a transit move."""

YAW_LEVER: Final = 0.3
"""[m] that a turn of the pair by 1 rad counts for in the search."""


def mend(scene: Scene, targets: Targets, found: Found) -> Targets | None:
    """The targets with transit moves replaced where they collide, or None if nothing had to be replaced.

    A move that cannot be mended stays as it is; the check of all moves reports it.
    """
    ways: dict[int, list[FloatArray]] = {}
    for i in range(1, targets.count):
        if targets.segment[i].kind == TRANSIT_KIND and targets.coupled:
            way = _Transit(scene, targets, found, i).way()
            if way:
                ways[i] = way
    return _insert(targets, ways) if ways else None


class _Transit:
    """The move to target ``i``: motions of the pair are rigid motions (4, 4) of target i - 1 in the work
    frame."""

    def __init__(self, scene: Scene, targets: Targets, found: Found, i: int) -> None:
        self.scene, self.targets, self.found, self.i = scene, targets, found, i
        self.source = subset(targets, np.array([i - 1]))
        ends = {arm: pose[[i - 1, i]] for arm, pose in targets.pose.items()}  # as if no freedom were used
        arms = targets.arms
        self.total = ends[arms[0]][1] @ inverse(ends[arms[0]][0])
        gap = max(float(np.abs(ends[a][1] - self.total @ ends[a][0]).max()) for a in arms)
        self.same_shape = gap < SAME_SHAPE
        self.centre = np.mean([ends[a][0, :3, 3] for a in arms], axis=0)

    def way(self) -> list[FloatArray]:
        """Rigid motions at which to put targets before target i; empty if the straight move will do."""
        if not self.same_shape:
            return []
        goal = self.total
        for lift in (0.0, *LIFTS_M):
            corners = [np.eye(4), goal] if lift == 0.0 else [np.eye(4), *self._over(goal, lift), goal]
            if self._free(corners):
                return self._fine(corners)[1:-1]
        corners_found = self._search(goal)
        return self._fine(corners_found)[1:-1] if corners_found else []

    def _over(self, goal: FloatArray, lift: float) -> list[FloatArray]:
        """Up, across, down; up is the world's."""
        up = self._up() * lift
        rise, land = np.eye(4), goal.copy()
        rise[:3, 3] += up
        land[:3, 3] += up
        return [rise, land]

    def _up(self) -> FloatArray:
        frame = self.targets.frame.get(self.targets.arms[0], "stock")
        return np.array([0.0, 0.0, 1.0]) if frame == "world" else self.scene.stock[2, :3].copy()

    def _between(self, a: FloatArray, b: FloatArray, share: FloatArray) -> FloatArray:
        """Motions (K, 4, 4) between two, the pair's centre going straight and its turn at a constant rate."""
        place = from_parts(np.eye(3), self.centre)
        return interpolate(a @ place, b @ place, share) @ inverse(place)

    def _fine(self, corners: list[FloatArray]) -> list[FloatArray]:
        """The corners with turns cut into small ones."""
        out = [corners[0]]
        for a, b in itertools.pairwise(corners):
            angle = float(np.linalg.norm(log_rotation(a[:3, :3].T @ b[:3, :3])))
            count = max(1, int(np.ceil(angle / MOST_TURN_RAD)))
            out.extend(self._between(a, b, np.arange(1, count) / count) if count > 1 else [])
            out.append(b)
        return out

    def _free(self, corners: list[FloatArray]) -> bool:
        """Whether moves between corners are free, the freedoms going linearly from one end to the other."""
        points = []
        for a, b in itertools.pairwise(corners):
            shift = float(
                np.linalg.norm((b @ np.append(self.centre, 1.0) - a @ np.append(self.centre, 1.0))[:3])
            )
            angle = float(np.linalg.norm(log_rotation(a[:3, :3].T @ b[:3, :3])))
            count = max(2, int(np.ceil((shift + YAW_LEVER * angle) / CHECK_SPACING_M)))
            points.append(self._between(a, b, np.arange(count) / count))
        points.append(corners[-1][None])
        motions = np.concatenate(points)
        share = np.linspace(0.0, 1.0, len(motions))
        return bool(self._ok(motions, share).all())

    def _ok(self, motions: FloatArray, share: FloatArray) -> BoolArray:
        """(K,) whether the pair may stand at motions (K, 4, 4)."""
        rows = np.zeros(len(motions), dtype=np.intp)
        start, end = self.found.values[self.i - 1], self.found.values[self.i]
        values = start + share[:, None] * (end - start)
        local = self.source.poses(values, rows)
        world = self.scene.world(self.targets, {arm: motions @ pose for arm, pose in local.items()})
        ok = np.ones(len(motions), dtype=bool)
        q: dict[str, FloatArray] = {}
        for arm, pose in world.items():
            chain = self.scene.chains[arm]
            last = self.targets.last(arm, values)
            angles = chain.inverse(pose, [self.found.path.branch[arm]], last)[:, 0]
            near = self.found.q[arm][self.i - 1]
            q[arm] = chain.continuous(angles, np.broadcast_to(near, angles.shape))
            ok &= chain.limit_margin(q[arm]) >= self.scene.settings.joint_margin
            ok &= chain.singularity_margin(q[arm]) >= self.scene.settings.singularity_margin
        good = np.flatnonzero(ok)
        if len(good):
            moved = self._moved(motions[good], self.targets.segment[self.i])
            ok[good] = self.scene.free(moved, {a: v[good] for a, v in q.items()}, np.arange(len(good)))
        return ok

    def _moved(self, motions: FloatArray, segment: Segment) -> Targets:
        rows = np.zeros(len(motions), dtype=np.intp)
        return moved(subset(self.source, rows), motions, segment)

    def _search(self, goal: FloatArray) -> list[FloatArray] | None:
        """A way over x, y, z and yaw of the pair, found by trees from both ends."""
        up = self._up()
        turn = log_rotation(goal[:3, :3])
        yaw = float(turn @ up)
        rest = exp_rotation(-yaw * up) @ goal[:3, :3]
        tilt = log_rotation(rest)
        start = np.zeros(5)
        shift = goal[:3, :3] @ self.centre + goal[:3, 3] - self.centre
        end = np.array([*shift, yaw * YAW_LEVER, 1.0])

        def motions(points: FloatArray) -> FloatArray:
            turns = exp_rotation(points[:, 3:4] / YAW_LEVER * up) @ exp_rotation(points[:, 4:5] * tilt)
            return from_parts(turns, self.centre + points[:, :3] - np.einsum("kij,j->ki", turns, self.centre))

        def free(points: FloatArray) -> BoolArray:
            return self._ok(motions(points), np.clip(points[:, 4], 0.0, 1.0))

        lower = np.minimum(start, end) - np.array([0.5, 0.5, 0.3, 0.3, 0.0])
        upper = np.maximum(start, end) + np.array([0.5, 0.5, 0.7, 0.3, 0.0])
        way = connect(
            start, end, free, lower, upper, 2.0 * CHECK_SPACING_M, self.scene.settings.seed, rounds=400
        )
        if way is None:
            return None
        corners = list(motions(way))
        corners[-1] = goal
        return corners


def moved(targets: Targets, motions: FloatArray, segment: Segment) -> Targets:
    """Targets whose poses, tables and edge are moved by rigid motions (N, 4, 4) of the work frame."""
    edge = targets.edge
    if edge is not None:
        points = np.einsum("nij,npj->npi", motions[:, :3, :3], edge.points) + motions[:, None, :3, 3]
        edge = Edge(points, edge.radius)
    return dataclasses.replace(
        targets,
        pose={arm: motions @ pose for arm, pose in targets.pose.items()},
        freedoms=tuple(_moved_freedom(f, motions) for f in targets.freedoms),
        edge=edge,
        segment=(segment,) * len(motions),
    )


def _moved_freedom(freedom: Freedom, motions: FloatArray) -> Freedom:
    if not isinstance(freedom, TableFreedom):
        return freedom
    pose = {arm: motions[:, None] @ table for arm, table in freedom.pose.items()}
    return dataclasses.replace(freedom, pose=pose)


def _insert(targets: Targets, ways: Mapping[int, list[FloatArray]]) -> Targets:
    """The targets with copies of target i - 1, moved by the motions ``ways[i]``, put before each target i."""
    rows: list[int] = []
    new: list[bool] = []
    motions: list[FloatArray] = []
    place = np.zeros(targets.count, dtype=np.intp)
    for i in range(targets.count):
        for motion in ways.get(i, []):
            rows.append(i - 1)
            new.append(True)
            motions.append(motion)
        place[i] = len(rows)
        rows.append(i)
        new.append(False)
        motions.append(np.eye(4))
    index, added = np.array(rows, dtype=np.intp), np.array(new)
    owner = np.searchsorted(place, np.arange(len(rows)))
    out = moved(subset(targets, index), np.array(motions), targets.segment[0])
    edge = out.edge
    points = (
        edge.points if edge is not None else np.stack([out.pose[a][:, :3, 3] for a in targets.arms], axis=1)
    )
    way = np.append(0.0, np.linalg.norm(np.diff(points, axis=0), axis=-1).max(axis=1))
    touched = added | np.append(False, added[:-1])
    corner = added.copy()
    return dataclasses.replace(
        out,
        segment=tuple(targets.segment[i] for i in owner),
        feed=targets.feed[owner],
        feed_min=np.where(added, 0.0, targets.feed_min[owner]),
        travel=np.where(touched, way, targets.travel[owner]),
        stop=np.where(corner, True, targets.stop[owner]),
        actions=tuple(dataclasses.replace(a, at=int(place[a.at])) for a in targets.actions),
        claims=targets.claims,
        exhibits=targets.exhibits,
        issues=targets.issues,
    )
