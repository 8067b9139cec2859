"""Where arms really are that give way under what is claimed of their loads, by the joints of their programs.

The proof's own way of it: axes from the chain of the robot's URDF, torques of each load about them,
joints of the loaded arm by iteration, for the loads hang on the arm as it stands bent. The force of the
work acts in segments that work, as `ArmSags` says it; how far it has risen or fallen on a move is how far the
tool has come. Where a force turns with the feed, the feed is that of the loaded arm: by iteration again, from
the straight moves that the program states.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from planner.claims.claim import FEED_WAY, ArmSags
from planner.geometry.arrays import FloatArray, IntArray, inverse
from planner.geometry.units import GRAVITY
from planner.issues import refusal
from planner.proof.kinematics.arm_model import Machine
from planner.proof.kinematics.chain import POSTURES_TOGETHER
from planner.proof.replay.motion import Instants, Motion, Poses

ROUNDS: Final = 3
"""Iterations: each one leaves some thousandths of the error of the one before."""
TABLE_ROUNDS: Final = 10
"""The same where a force changes with the height: each round leaves at most a quarter."""
FEED_ROUNDS: Final = 40
"""Iterations of the feed's direction at most: each one leaves at most half of the last error."""
FEED_ERROR: Final = 1e-8
"""They end where places move by less [m]."""
LEAST_WAY: Final = 1e-6
"""On shorter moves [m] force comes and goes by the clock."""


@dataclasses.dataclass(frozen=True)
class Bent:
    """An arm under its loads in one setup, on its ``base`` (4, 4), with its ``tcp`` (4, 4) in the flange;
    ``block`` (4, 4): the stock's frame in the world."""

    machine: Machine
    claim: ArmSags
    base: FloatArray
    tcp: FloatArray
    block: FloatArray

    @property
    def turns(self) -> bool:
        """Whether the work's force turns with the feed."""
        return self.claim.frame == "feed"

    def joints(
        self,
        q: FloatArray,
        share: FloatArray,
        feed: FloatArray | None = None,
        height: FloatArray | None = None,
    ) -> FloatArray:
        """Serial angles (M, 6) [rad] of the loaded arm whose drives are at ``q`` (M, 6), under a ``share``
        (M,) of the work's force where the tool goes along ``feed`` (M, 3), none where it does not matter; as
        it is at a ``height`` (M,) [m] of the stock, NaN for that of the tool itself."""
        feed = np.zeros((len(q), 3)) if feed is None else feed
        height = np.full(len(q), np.nan) if height is None else height
        out = np.empty_like(q)
        for first in range(0, len(q), POSTURES_TOGETHER):
            some = slice(first, first + POSTURES_TOGETHER)
            own = q[some]
            bent = own
            for _ in range(ROUNDS if len(self.claim.height) == 1 else TABLE_ROUNDS):
                bent = own + self._turned(bent, share[some], feed[some], height[some])
            out[some] = bent
        return out

    def _turned(self, q: FloatArray, share: FloatArray, feed: FloatArray, height: FloatArray) -> FloatArray:
        chain = self.machine.chain
        frames = self.base @ chain.frames(q)
        flange = frames[:, 6]
        hand = flange @ self.tcp
        work = share[:, None] * self._work(hand, feed, height)
        weight = np.array([0.0, 0.0, -self.claim.mass * GRAVITY])
        centre = flange[:, :3, :3] @ self.claim.cog + flange[:, :3, 3]
        torque = np.empty_like(q)
        for i in range(6):
            still = chain.zero[i, :3, :3].T @ chain.axis[i]
            axis, foot = frames[:, i, :3, :3] @ still, frames[:, i, :3, 3]
            moment = np.cross(centre - foot, weight) + np.cross(hand[:, :3, 3] - foot, work)
            torque[:, i] = np.einsum("mi,mi->m", axis, moment)
        if self.machine.data.coupling is None:
            return np.asarray(torque / self.claim.joints)
        # the rod: axis 3 of the controller is q2 + q3, so that its drive's turn moves q3 alone, and the turn
        # of drive 2 moves q2 on and q3 back
        drives = torque.copy()
        drives[:, 1] -= torque[:, 2]
        turn = drives / self.claim.joints
        turn[:, 2] -= turn[:, 1]
        return turn

    def _work(self, hand: FloatArray, feed: FloatArray, height: FloatArray) -> FloatArray:
        """The whole force of the work (M, 3) [N] in the world, at places ``hand`` (M, 4, 4) of the TCP."""
        height = np.where(np.isnan(height), self.heights(hand), height)
        knots = self.claim.height
        # the row above, and how far it is to it from the one below
        above = np.clip(np.searchsorted(knots, height), 1, max(len(knots) - 1, 1))
        below, above = above - 1, np.minimum(above, len(knots) - 1)
        span = np.where(above > below, knots[above] - knots[below], np.inf)
        part = np.clip((height - knots[below]) / span, 0.0, 1.0)[:, None]
        force = (1.0 - part) * self.claim.force[below] + part * self.claim.force[above]
        if self.claim.frame == "tool":
            return np.asarray(np.einsum("mij,mj->mi", hand[:, :3, :3], force))
        if self.claim.frame == "stock":
            return np.asarray(force @ self.block[:3, :3].T)
        down = hand[:, :3, 2]
        ahead = feed - np.einsum("mi,mi->m", feed, down)[:, None] * down
        x, y, z = force.T[:, :, None]
        return np.asarray(x * ahead + y * np.cross(down, ahead) + z * down)

    def heights(self, hand: FloatArray) -> FloatArray:
        """Heights (M,) [m] of places (M, 4, 4) of the TCP in the stock's frame."""
        return np.asarray((inverse(self.block) @ hand)[:, 2, 3])

    def places(self, q: FloatArray) -> FloatArray:
        """Flange poses (M, 4, 4) in the world."""
        return np.asarray(self.base @ self.machine.flange(q))


def bent(
    motion: Motion, arms: Sequence[Mapping[str, Bent]], sample_setup: IntArray, node_setup: IntArray
) -> Motion:
    """The motion of arms as they stand: ``tcp``, ``node_tcp`` and places between samples are those of the
    bent arms, ``bends`` their joints, while ``q`` stays what the controllers count. ``arms``: by setup, those
    that bend in it."""
    tcp, node_tcp, between = dict(motion.tcp), dict(motion.node_tcp), dict(motion.between.tcp)
    bends = dict(motion.bends)
    for name in dict.fromkeys(name for setup in arms for name in setup):
        own = {index: setup[name] for index, setup in enumerate(arms) if name in setup}
        made = _one(motion, name, own, sample_setup, node_setup)
        tcp[name], node_tcp[name], between[name], bends[name] = made
    return dataclasses.replace(
        motion,
        tcp=tcp,
        node_tcp=node_tcp,
        bends=bends,
        between=Instants(motion.between.time, motion.between.sample, motion.between.node, between),
    )


def _one(
    motion: Motion, name: str, own: Mapping[int, Bent], sample_setup: IntArray, node_setup: IntArray
) -> tuple[Poses, FloatArray, Poses, FloatArray]:
    """Places of the tool at samples, at nodes and between samples, and joints at samples, of one arm."""
    at_node = working(motion)
    share = _shares(motion, name, at_node)
    node_feed, feed = _feeds(motion, name, own, at_node, node_setup)
    height = _heights(motion, name, own, at_node, node_setup, node_feed)
    q, links = motion.q[name], np.array(motion.q[name])
    tcp, between = Poses.empty(len(q)), Poses.empty(len(motion.between.time))
    node_tcp = np.array(motion.node_tcp[name])
    looks, after = motion.between.sample, np.minimum(motion.between.sample + 1, len(q) - 1)
    look_setup = sample_setup[looks]
    for index in range(int(sample_setup.max(initial=0)) + 1):
        rows = np.flatnonzero(sample_setup == index)
        late = np.flatnonzero(look_setup == index)
        if index not in own:
            for some in _pieces(rows):
                tcp[some] = motion.tcp[name][some]
            between[late] = motion.between.tcp[name][late]
            continue
        arm = own[index]
        for some in _pieces(rows):
            links[some] = arm.joints(q[some], share[some], feed[some], height[some])
            tcp[some] = _off(arm, q[some], links[some]) @ motion.tcp[name][some]
        # between two samples both what the joints bend and where they are go on evenly
        span = np.maximum(motion.time[after[late]] - motion.time[looks[late]], 1e-9)
        part = np.clip((motion.between.time[late] - motion.time[looks[late]]) / span, 0.0, 1.0)[:, None]
        here, there = looks[late], np.where(sample_setup[after[late]] == index, after[late], looks[late])
        held = q[here] + part * (q[there] - q[here])
        turn = (1.0 - part) * (links[here] - q[here]) + part * (links[there] - q[there])
        for some in _pieces(np.arange(len(late))):
            moved = _off(arm, held[some], held[some] + turn[some])
            between[late[some]] = moved @ motion.between.tcp[name][late[some]]
        nodes = np.flatnonzero(node_setup == index)
        there = q[motion.node_sample[nodes]]
        for some in _pieces(np.arange(len(nodes))):
            turned = arm.joints(there[some], at_node[nodes[some]], node_feed[nodes[some]])
            node_tcp[nodes[some]] = _off(arm, there[some], turned) @ node_tcp[nodes[some]]
    return tcp, node_tcp, between, links


def _off(arm: Bent, q: FloatArray, links: FloatArray) -> FloatArray:
    """How the bent hand lies from where the drives have it, as motions (M, 4, 4) of the world."""
    return np.asarray(arm.places(links) @ inverse(arm.places(q)))


def _pieces(rows: IntArray) -> list[IntArray]:
    return [rows[i : i + POSTURES_TOGETHER] for i in range(0, len(rows), POSTURES_TOGETHER)]


def working(motion: Motion) -> FloatArray:
    """Share (K,) of the work's force that acts at the ends of moves."""
    works = [segment.works and not segment.phase for segment in motion.node_segment]
    return np.array(works, dtype=np.float64)


def _shares(motion: Motion, name: str, at_node: FloatArray) -> FloatArray:
    """Share (S,) of the work's force that acts at each sample."""
    node = motion.node
    before = np.concatenate([[0.0], at_node[:-1]])
    out = at_node[node]
    changing = np.flatnonzero((before != at_node)[node])
    if not len(changing):
        return out
    own = node[changing]
    part = _parts(motion, name, changing)
    out[changing] = before[own] + part * (at_node[own] - before[own])
    return out


def _heights(
    motion: Motion,
    name: str,
    own: Mapping[int, Bent],
    at_node: FloatArray,
    node_setup: IntArray,
    node_feed: FloatArray,
) -> FloatArray:
    """Heights (S,) [m] of the stock whose force acts at samples where it comes or goes: that of the loaded
    arm at the end of the move at which it acts in full; elsewhere NaN."""
    out, works = np.full(len(motion.time), np.nan), np.append(at_node, 0.0) > 0.0
    for node in np.flatnonzero(works[:-1] != np.append(False, works[:-2])):
        full = node if works[node] else node - 1
        arm = own.get(int(node_setup[full]))
        if arm is None or len(arm.claim.height) == 1:
            continue
        links = arm.joints(motion.q[name][[motion.node_sample[full]]], np.ones(1), node_feed[[full]])
        rows = slice(*np.searchsorted(motion.node, [node, node + 1]))
        out[rows] = arm.heights(arm.places(links) @ arm.tcp)[0]
    return out


def _parts(motion: Motion, name: str, rows: IntArray) -> FloatArray:
    """What part (M,) of the move under way the tool has come by samples ``rows`` (M,)."""
    own = np.asarray(motion.node[rows], dtype=np.int64)
    start, end = _ends(motion, name, own - 1), _ends(motion, name, own)
    way = end - start
    length = np.einsum("mi,mi->m", way, way)
    gone = np.einsum("mi,mi->m", motion.tcp[name].place[rows] - start, way)
    began = motion.time[np.where(own > 0, motion.node_sample[own - 1], 0)]
    whole = np.maximum(motion.time[motion.node_sample[own]] - began, 1e-9)
    part = np.where(
        length > LEAST_WAY**2, gone / np.maximum(length, 1e-30), (motion.time[rows] - began) / whole
    )
    return np.clip(part, 0.0, 1.0)


def _feeds(
    motion: Motion, name: str, own: Mapping[int, Bent], at_node: FloatArray, node_setup: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Mean direction of the feed of the loaded arm at nodes (K, 3) and at samples (S, 3), 0 where it does not
    matter."""
    at_nodes, at_samples = np.zeros((len(at_node), 3)), np.zeros((len(motion.time), 3))
    works = np.flatnonzero(at_node > 0.0)
    for run in np.split(works, np.flatnonzero(np.diff(works) != 1) + 1):
        arm = own.get(int(node_setup[run[0]])) if len(run) else None
        if arm is None or not arm.turns:
            continue
        place = _loaded_way(motion, name, arm, run)
        gone = _gone(place)
        at_nodes[run] = _mean(place, gone, gone[1:])
        # samples of the run, and of the move off it, along which the last direction stays
        first, last, off = np.searchsorted(motion.node, [run[0], run[-1] + 1, run[-1] + 2])
        rows = np.arange(first, last)
        move = motion.node[rows] - run[0]
        at = gone[move] + _parts(motion, name, rows) * (gone[move + 1] - gone[move])
        at_samples[rows] = _mean(place, gone, at)
        at_samples[last:off] = at_nodes[run[-1]]
    return at_nodes, at_samples


def _loaded_way(motion: Motion, name: str, arm: Bent, run: IntArray) -> FloatArray:
    """Where (M + 1, 3) the loaded tool is at the beginning of a run of moves that work and at their ends.

    Raises ``TandemError``: ``verify.sag`` where that cannot be told.
    """
    nodes = np.append(run[0] - 1, run)
    stated = _ends(motion, name, nodes)
    q = motion.q[name][np.where(nodes >= 0, motion.node_sample[np.maximum(nodes, 0)], 0)]
    share = np.append(0.0, np.ones(len(run)))
    place = stated
    for _ in range(FEED_ROUNDS):
        gone = _gone(place)
        links = arm.joints(q, share, _mean(place, gone, gone))
        off = _off(arm, q, links)
        loaded = np.asarray(np.einsum("mij,mj->mi", off[:, :3, :3], stated) + off[:, :3, 3])
        moved = float(np.abs(loaded - place).max())
        place = loaded
        if moved < FEED_ERROR:
            return place
    what = f"{name} gives way so far under a force that turns with the feed that its way cannot be told: "
    what += f"after {FEED_ROUNDS} rounds places still move by {1e3 * moved:.3g} mm; take a stiffer arm"
    raise refusal("verify.sag", what, arm=name)


def _gone(place: FloatArray) -> FloatArray:
    """How far (M,) [m] it is along straight lines to each of the places (M, 3)."""
    return np.append(0.0, np.cumsum(np.linalg.norm(place[1:] - place[:-1], axis=1)))


def _mean(place: FloatArray, gone: FloatArray, at: FloatArray) -> FloatArray:
    """The mean direction (M, 3) of a way through places (P, 3), ``gone`` (P,) [m] along it, from `FEED_WAY`
    before ``at`` (M,) [m] to as far behind, as far as it goes."""
    early, late = np.maximum(at - FEED_WAY, 0.0), np.minimum(at + FEED_WAY, gone[-1])
    step = np.empty((len(at), 3))
    for k in range(3):
        step[:, k] = np.interp(late, gone, place[:, k]) - np.interp(early, gone, place[:, k])
    span = late - early
    return np.asarray(step / np.where(span > 0.0, span, np.inf)[:, None])


def _ends(motion: Motion, name: str, nodes: IntArray) -> FloatArray:
    """Where (M, 3) the tool is at the ends of moves, -1 for the beginning of all."""
    stated = motion.node_tcp[name][np.maximum(nodes, 0), :3, 3]
    sample = np.where(nodes >= 0, motion.node_sample[np.maximum(nodes, 0)], 0)
    known = np.isfinite(stated).all(axis=1) & (nodes >= 0)
    return np.where(known[:, None], stated, motion.tcp[name].place[sample])
