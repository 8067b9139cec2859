"""Poses of arms that deflect under the claimed loads, from the joints of their programs.

The computation is the proof's own. The axes are those of the chain of the robot's URDF. Each load has a
torque about each axis. The joints of the loaded arm are found by iteration, because the loads act on the
deflected arm.

The working force acts in segments that work, as `ArmSags` states it. On a move at whose two ends it differs,
it changes linearly with the path of the tool. If a force turns with the feed, the feed is that of the loaded
arm, which is found by iteration from the straight moves of the program.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from planner.claims.claim import FEED_PATH_M, ArmSags
from planner.geometry.arrays import FloatArray, IntArray, inverse
from planner.geometry.units import GRAVITY
from planner.issues import issue_error
from planner.proof.kinematics.arm_model import RobotMachine
from planner.proof.kinematics.chain import POSTURES_PER_BATCH
from planner.proof.replay.motion import IntermediateInstants, Motion, Poses

CONSTANT_FORCE_ITERATIONS: Final = 3
"""Number of iterations for a constant force. Each reduces the error to some thousandths."""
TABLE_FORCE_ITERATIONS: Final = 10
"""Number of iterations for a force that changes with the height. Each reduces the error to at most a
quarter.
"""
MAX_FEED_ITERATIONS: Final = 40
"""Maximum number of iterations for the feed direction. Each reduces the error to at most a half."""
FEED_TOLERANCE_M: Final = 1e-8
"""Change of positions [m] below which the iterations for the feed direction end."""
MIN_PATH_M: Final = 1e-6
"""Length [m] of a move below which the force changes with the time instead of the path."""


@dataclasses.dataclass(frozen=True)
class SaggingArm:
    """An arm under its loads in one setup.

    Attributes:
        machine: Kinematics of the arm.
        claim: Loads and stiffness.
        base: Base pose (4, 4) in the world.
        tcp: TCP (4, 4) in the flange.
        block: Frame (4, 4) of the stock in the world.
    """

    machine: RobotMachine
    claim: ArmSags
    base: FloatArray
    tcp: FloatArray
    block: FloatArray

    @property
    def turns_with_feed(self) -> bool:
        """Whether the force of the work turns with the feed."""
        return self.claim.frame == "feed"

    def loaded_joints(
        self,
        q: FloatArray,
        fraction: FloatArray,
        feed: FloatArray | None = None,
        height: FloatArray | None = None,
    ) -> FloatArray:
        """Return the serial angles (M, 6) [rad] of the loaded arm, at which its links and tool really are.

        They are the fixed point of q_loaded = q + compliance(torque(q_loaded)), by iteration.

        Args:
            q: Serial angles (M, 6) [rad] of the drives, as the controller commands them.
            fraction: Fraction (M,) of the working force that acts, 0 to 1.
            feed: Direction (M, 3) in which the tool moves. None if the force does not depend on it.
            height: Height (M,) [m] in the stock's frame at which the force is read from its table. NaN, or
                None for all, stands for the height of the tool itself.
        """
        feed = np.zeros((len(q), 3)) if feed is None else feed
        height = np.full(len(q), np.nan) if height is None else height
        out = np.empty_like(q)
        for first in range(0, len(q), POSTURES_PER_BATCH):
            batch = slice(first, first + POSTURES_PER_BATCH)
            drives = q[batch]
            loaded = drives
            for _ in range(
                CONSTANT_FORCE_ITERATIONS if len(self.claim.height) == 1 else TABLE_FORCE_ITERATIONS
            ):
                loaded = drives + self._deflections(loaded, fraction[batch], feed[batch], height[batch])
            out[batch] = loaded
        return out

    def _deflections(
        self, q: FloatArray, fraction: FloatArray, feed: FloatArray, height: FloatArray
    ) -> FloatArray:
        """Return the deflections (M, 6) [rad] of the joints under the loads that act at angles ``q`` (M, 6).

        The other arguments are those of :meth:`loaded_joints`.
        """
        chain = self.machine.chain
        frames = self.base @ chain.frames(q)
        flange = frames[:, 6]
        tcp_poses = flange @ self.tcp
        work = fraction[:, None] * self._work_force(tcp_poses, feed, height)
        weight = np.array([0.0, 0.0, -self.claim.mass * GRAVITY])
        centre = flange[:, :3, :3] @ self.claim.cog + flange[:, :3, 3]
        # Torque about axis i: tau_i = z_i . ((c - p_i) x weight + (tcp - p_i) x work).
        torque = np.empty_like(q)
        for i in range(6):
            local_axis = chain.zero[i, :3, :3].T @ chain.axis[i]
            axis, origin = frames[:, i, :3, :3] @ local_axis, frames[:, i, :3, 3]
            moment = np.cross(centre - origin, weight) + np.cross(tcp_poses[:, :3, 3] - origin, work)
            torque[:, i] = np.einsum("mi,mi->m", axis, moment)
        if self.machine.data.coupling is None:
            return np.asarray(torque / self.claim.joints)
        # Parallel rod: axis 3 of the controller is q2 + q3. So drive 3 moves q3 alone, and drive 2 moves q2
        # forward and q3 back: tau_2' = tau_2 - tau_3, and the deflection of q3 is d3 - d2.
        drives = torque.copy()
        drives[:, 1] -= torque[:, 2]
        deflection = drives / self.claim.joints
        deflection[:, 2] -= deflection[:, 1]
        return deflection

    def _work_force(self, tcp_poses: FloatArray, feed: FloatArray, height: FloatArray) -> FloatArray:
        """Return the full working force (M, 3) [N] in the world at TCP poses ``tcp_poses`` (M, 4, 4).

        The claim has the force in the frame of the tool, of the stock, or of the feed: x along the feed
        across the tool axis, z along the tool axis, y = z x x. The table is constant beyond both ends.
        ``feed`` (M, 3) and ``height`` (M,) are those of :meth:`loaded_joints`.
        """
        height = np.where(np.isnan(height), self.heights(tcp_poses), height)
        knots = self.claim.height
        # Linear interpolation of the force between the table rows below and above the height. A table with
        # one row has below = above and the weight 0.
        above = np.clip(np.searchsorted(knots, height), 1, max(len(knots) - 1, 1))
        below, above = above - 1, np.minimum(above, len(knots) - 1)
        span = np.where(above > below, knots[above] - knots[below], np.inf)
        weight = np.clip((height - knots[below]) / span, 0.0, 1.0)[:, None]
        force = (1.0 - weight) * self.claim.force[below] + weight * self.claim.force[above]
        if self.claim.frame == "tool":
            return np.asarray(np.einsum("mij,mj->mi", tcp_poses[:, :3, :3], force))
        if self.claim.frame == "stock":
            return np.asarray(force @ self.block[:3, :3].T)
        down = tcp_poses[:, :3, 2]
        feed_direction = feed - np.einsum("mi,mi->m", feed, down)[:, None] * down
        x, y, z = force.T[:, :, None]
        return np.asarray(x * feed_direction + y * np.cross(down, feed_direction) + z * down)

    def heights(self, tcp_poses: FloatArray) -> FloatArray:
        """Return the heights (M,) [m] of TCP poses (M, 4, 4) in the stock's frame."""
        return np.asarray((inverse(self.block) @ tcp_poses)[:, 2, 3])

    def flange_poses(self, q: FloatArray) -> FloatArray:
        """Return the flange poses (M, 4, 4) in the world at serial angles ``q`` (M, 6) [rad]."""
        return np.asarray(self.base @ self.machine.flange(q))


def with_sag(
    motion: Motion, arms: Sequence[Mapping[str, SaggingArm]], sample_setup: IntArray, node_setup: IntArray
) -> Motion:
    """Return the motion with the poses of the deflected arms, which all rules on tools and bodies use.

    ``tcp``, ``node_tcp`` and the poses between samples become those of the deflected arms, and
    ``loaded_joints`` has their joints. ``q`` keeps the joints of the controllers.

    Args:
        motion: The replayed motion.
        arms: Deflecting arms of each setup, by name.
        sample_setup: Index (S,) of the setup of each sample.
        node_setup: Index (K,) of the setup of each node.
    """
    tcp, node_tcp, between = dict(motion.tcp), dict(motion.node_tcp), dict(motion.between.tcp)
    loaded_joints = dict(motion.loaded_joints)
    for name in dict.fromkeys(name for setup in arms for name in setup):
        arm_setups = {index: setup[name] for index, setup in enumerate(arms) if name in setup}
        sagging = _sagging_motion(motion, name, arm_setups, sample_setup, node_setup)
        tcp[name], node_tcp[name], between[name], loaded_joints[name] = sagging
    return dataclasses.replace(
        motion,
        tcp=tcp,
        node_tcp=node_tcp,
        loaded_joints=loaded_joints,
        between=IntermediateInstants(
            motion.between.time, motion.between.sample, motion.between.node, between
        ),
    )


def _sagging_motion(
    motion: Motion,
    name: str,
    arm_setups: Mapping[int, SaggingArm],
    sample_setup: IntArray,
    node_setup: IntArray,
) -> tuple[Poses, FloatArray, Poses, FloatArray]:
    """Return the poses and joints of one deflected arm.

    In setups without its loads the poses stay as they are. The arguments are those of :func:`with_sag`, for
    arm ``name``, whose loads are in ``arm_setups`` by the index of the setup.

    Returns:
        S TCP poses at the samples, TCP poses (K, 4, 4) at the nodes, C TCP poses at the instants between
        samples, and joints (S, 6) [rad] at the samples.
    """
    # Fractions and feeds at nodes, (K,) and (K, 3), and at samples, (S,) and (S, 3); heights at samples (S,).
    at_node = work_fractions(motion)
    fraction = _sample_fractions(motion, name, at_node)
    node_feed, feed = _feed_directions(motion, name, arm_setups, at_node, node_setup)
    height = _force_heights(motion, name, arm_setups, at_node, node_setup, node_feed)
    q, links = motion.q[name], np.array(motion.q[name])
    tcp, between = Poses.empty(len(q)), Poses.empty(len(motion.between.time))
    node_tcp = np.array(motion.node_tcp[name])
    instant_samples, after = motion.between.sample, np.minimum(motion.between.sample + 1, len(q) - 1)
    instant_setup = sample_setup[instant_samples]
    for index in range(int(sample_setup.max(initial=0)) + 1):
        rows = np.flatnonzero(sample_setup == index)
        instants = np.flatnonzero(instant_setup == index)
        if index not in arm_setups:
            for batch in _batches(rows):
                tcp[batch] = motion.tcp[name][batch]
            between[instants] = motion.between.tcp[name][instants]
            continue
        arm = arm_setups[index]
        for batch in _batches(rows):
            links[batch] = arm.loaded_joints(q[batch], fraction[batch], feed[batch], height[batch])
            tcp[batch] = _displacement(arm, q[batch], links[batch]) @ motion.tcp[name][batch]
        # Between two samples, joints and deflections are interpolated linearly.
        span = np.maximum(motion.time[after[instants]] - motion.time[instant_samples[instants]], 1e-9)
        weight = np.clip(
            (motion.between.time[instants] - motion.time[instant_samples[instants]]) / span, 0.0, 1.0
        )[:, None]
        previous_sample = instant_samples[instants]
        next_sample = np.where(
            sample_setup[after[instants]] == index, after[instants], instant_samples[instants]
        )
        drives = q[previous_sample] + weight * (q[next_sample] - q[previous_sample])
        deflection = (1.0 - weight) * (links[previous_sample] - q[previous_sample]) + weight * (
            links[next_sample] - q[next_sample]
        )
        for batch in _batches(np.arange(len(instants))):
            displacement = _displacement(arm, drives[batch], drives[batch] + deflection[batch])
            between[instants[batch]] = displacement @ motion.between.tcp[name][instants[batch]]
        nodes = np.flatnonzero(node_setup == index)
        node_q = q[motion.node_sample[nodes]]
        for batch in _batches(np.arange(len(nodes))):
            loaded = arm.loaded_joints(node_q[batch], at_node[nodes[batch]], node_feed[nodes[batch]])
            node_tcp[nodes[batch]] = _displacement(arm, node_q[batch], loaded) @ node_tcp[nodes[batch]]
    return tcp, node_tcp, between, links


def _displacement(arm: SaggingArm, q: FloatArray, links: FloatArray) -> FloatArray:
    """Return the motions (M, 4, 4) in the world that take the flange from its unloaded to its loaded pose.

    Args:
        arm: The arm.
        q: Joints (M, 6) [rad] of the drives.
        links: Joints (M, 6) [rad] of the loaded arm.
    """
    return np.asarray(arm.flange_poses(links) @ inverse(arm.flange_poses(q)))


def _batches(rows: IntArray) -> list[IntArray]:
    """Split indices into batches that limit memory."""
    return [rows[i : i + POSTURES_PER_BATCH] for i in range(0, len(rows), POSTURES_PER_BATCH)]


def work_fractions(motion: Motion) -> FloatArray:
    """Return the fraction (K,) of the working force that acts at the end of each move: 1 or 0.

    It is 1 in segments whose kind works (``works``), such as cuts, except in their phases, such as lead-ins.
    """
    works = [segment.works and not segment.phase for segment in motion.node_segment]
    return np.array(works, dtype=np.float64)


def _sample_fractions(motion: Motion, name: str, at_node: FloatArray) -> FloatArray:
    """Return the fraction (S,) of the working force that acts at each sample.

    Along a move it is interpolated between the fractions at both ends, by the path of arm ``name``.
    ``at_node`` (K,) is that of :func:`work_fractions`.
    """
    node = motion.node
    previous = np.concatenate([[0.0], at_node[:-1]])
    out = at_node[node]
    changing = np.flatnonzero((previous != at_node)[node])
    if not len(changing):
        return out
    moves = node[changing]
    progress = _move_progress(motion, name, changing)
    out[changing] = previous[moves] + progress * (at_node[moves] - previous[moves])
    return out


def _force_heights(
    motion: Motion,
    name: str,
    arm_setups: Mapping[int, SaggingArm],
    at_node: FloatArray,
    node_setup: IntArray,
    node_feed: FloatArray,
) -> FloatArray:
    """Return the heights (S,) [m] in the stock's frame at which a force that changes is read from its table.

    While the force ramps up or down along a move, it is that at the height of the loaded tool at the working
    end of the move. On all other moves the result is NaN, which stands for the current height of the tool.
    The arguments are those of :func:`_sagging_motion`. ``at_node`` (K,) are the fractions at the nodes, and
    ``node_feed`` (K, 3) the feed directions there.
    """
    # works: whether the force acts at each node. The loop examines moves along which this changes.
    out, works = np.full(len(motion.time), np.nan), np.append(at_node, 0.0) > 0.0
    for node in np.flatnonzero(works[:-1] != np.append(False, works[:-2])):
        full_node = node if works[node] else node - 1
        arm = arm_setups.get(int(node_setup[full_node]))
        if arm is None or len(arm.claim.height) == 1:
            continue
        links = arm.loaded_joints(
            motion.q[name][[motion.node_sample[full_node]]], np.ones(1), node_feed[[full_node]]
        )
        rows = slice(*np.searchsorted(motion.node, [node, node + 1]))
        out[rows] = arm.heights(arm.flange_poses(links) @ arm.tcp)[0]
    return out


def _move_progress(motion: Motion, name: str, rows: IntArray) -> FloatArray:
    """Return the fraction (M,) of the current move that the tool has covered at samples ``rows`` (M,).

    It is the projection of the tool of arm ``name`` on the straight line between both ends of the move. On a
    move of at most ``MIN_PATH_M`` it is the fraction of the time.
    """
    moves = np.asarray(motion.node[rows], dtype=np.int64)
    start, end = _move_ends(motion, name, moves - 1), _move_ends(motion, name, moves)
    path = end - start
    length = np.einsum("mi,mi->m", path, path)
    covered = np.einsum("mi,mi->m", motion.tcp[name].position[rows] - start, path)
    started = motion.time[np.where(moves > 0, motion.node_sample[moves - 1], 0)]
    duration = np.maximum(motion.time[motion.node_sample[moves]] - started, 1e-9)
    progress = np.where(
        length > MIN_PATH_M**2, covered / np.maximum(length, 1e-30), (motion.time[rows] - started) / duration
    )
    return np.clip(progress, 0.0, 1.0)


def _feed_directions(
    motion: Motion, name: str, arm_setups: Mapping[int, SaggingArm], at_node: FloatArray, node_setup: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Return the mean feed direction of the loaded arm at nodes (K, 3) and at samples (S, 3).

    A force that turns with the feed is computed from it. It is 0 where there is no such force. The arguments
    are those of :func:`_sagging_motion`, and ``at_node`` (K,) are the fractions at the nodes.
    """
    at_nodes, at_samples = np.zeros((len(at_node), 3)), np.zeros((len(motion.time), 3))
    works = np.flatnonzero(at_node > 0.0)
    # run: successive nodes at which the force acts.
    for run in np.split(works, np.flatnonzero(np.diff(works) != 1) + 1):
        arm = arm_setups.get(int(node_setup[run[0]])) if len(run) else None
        if arm is None or not arm.turns_with_feed:
            continue
        positions = _loaded_path(motion, name, arm, run)
        lengths = _path_lengths(positions)
        at_nodes[run] = _mean_direction(positions, lengths, lengths[1:])
        # Samples of the run, and of the move after it, along which the last direction is kept.
        first, last, end = np.searchsorted(motion.node, [run[0], run[-1] + 1, run[-1] + 2])
        rows = np.arange(first, last)
        move = motion.node[rows] - run[0]
        path_lengths = lengths[move] + _move_progress(motion, name, rows) * (
            lengths[move + 1] - lengths[move]
        )
        at_samples[rows] = _mean_direction(positions, lengths, path_lengths)
        at_samples[last:end] = at_nodes[run[-1]]
    return at_nodes, at_samples


def _loaded_path(motion: Motion, name: str, arm: SaggingArm, run: IntArray) -> FloatArray:
    """Return the positions (M + 1, 3) [m] of the loaded tool at the start and at the ends of working moves.

    ``run`` (M,) has the successive nodes of these moves.

    Raises:
        TandemError: The iteration does not converge (``verify.sag``).
    """
    nodes = np.append(run[0] - 1, run)
    stated = _move_ends(motion, name, nodes)
    q = motion.q[name][np.where(nodes >= 0, motion.node_sample[np.maximum(nodes, 0)], 0)]
    fraction = np.append(0.0, np.ones(len(run)))
    positions = stated
    for _ in range(MAX_FEED_ITERATIONS):
        lengths = _path_lengths(positions)
        links = arm.loaded_joints(q, fraction, _mean_direction(positions, lengths, lengths))
        displacement = _displacement(arm, q, links)
        loaded = np.asarray(np.einsum("mij,mj->mi", displacement[:, :3, :3], stated) + displacement[:, :3, 3])
        change = float(np.abs(loaded - positions).max())
        positions = loaded
        if change < FEED_TOLERANCE_M:
            return positions
    message = (
        f"{name} deflects so much under a force that turns with the feed that its path is undetermined: "
    )
    message += (
        f"after {MAX_FEED_ITERATIONS} rounds positions still move by {1e3 * change:.3g} mm. Use a stiffer arm"
    )
    raise issue_error("verify.sag", message, arm=name)


def _path_lengths(positions: FloatArray) -> FloatArray:
    """Return the length (M,) [m] of the polyline up to each of the positions (M, 3)."""
    return np.append(0.0, np.cumsum(np.linalg.norm(positions[1:] - positions[:-1], axis=1)))


def _mean_direction(positions: FloatArray, lengths: FloatArray, at: FloatArray) -> FloatArray:
    """Return the mean direction (M, 3) of a path around given path lengths.

    The mean is taken from `FEED_PATH_M` before to `FEED_PATH_M` after, as far as the path goes.

    Args:
        positions: Positions (P, 3) [m] on the path.
        lengths: Path length (P,) [m] at the positions.
        at: Path lengths (M,) [m] at which the direction is returned.
    """
    early, late = np.maximum(at - FEED_PATH_M, 0.0), np.minimum(at + FEED_PATH_M, lengths[-1])
    step = np.empty((len(at), 3))
    for k in range(3):
        step[:, k] = np.interp(late, lengths, positions[:, k]) - np.interp(early, lengths, positions[:, k])
    span = late - early
    return np.asarray(step / np.where(span > 0.0, span, np.inf)[:, None])


def _move_ends(motion: Motion, name: str, nodes: IntArray) -> FloatArray:
    """Return the tool positions (M, 3) at the ends of moves ``nodes`` (M,). -1 is the start of the motion.

    It is the stated target, or the replayed position at that time if a move states none for this arm.
    """
    stated = motion.node_tcp[name][np.maximum(nodes, 0), :3, 3]
    sample = np.where(nodes >= 0, motion.node_sample[np.maximum(nodes, 0)], 0)
    is_stated = np.isfinite(stated).all(axis=1) & (nodes >= 0)
    return np.where(is_stated[:, None], stated, motion.tcp[name].position[sample])
