"""The planning scene of an operation: kinematics of its arms, the stock, and what may not be touched.

**Kinematics of one arm** (`Chain`) as planning sees it: closed-form inverse, turns, limit margins,
rates. The inverse is that of the arm's form: :mod:`planner.motion.spherical_wrist`,
:mod:`planner.motion.three_parallel`, :mod:`planner.motion.offset_wrist` or, with a seventh joint,
:mod:`planner.motion.seven_axes`.

**Scene**: where things stand for one operation, the arms that take part, the stock, and the cell's
collision model.
"""

import dataclasses
import functools
import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from planner.catalogue.robots import (
    ArmForm,
    OffsetParameters,
    OpwParameters,
    ParallelParameters,
    RobotData,
    SevenParameters,
    columns_of,
)
from planner.cell import clearance
from planner.cell.bodies import NOT_EASED
from planner.cell.clearance import Against, LeastClearance, Pairs
from planner.cell.clearance import edge as edge_clearance
from planner.cell.kinematics import forward, jacobian
from planner.cell.plant import CellModel
from planner.geometry.arrays import (
    BoolArray,
    FloatArray,
    IndexArray,
    interpolate,
    inverse,
    spread_rows,
    transform,
)
from planner.geometry.arrays import inverse as rigid_inverse
from planner.motion import offset_wrist, own_clearance, seven_axes, spherical_wrist, three_parallel
from planner.problem import Arm, Cell, LinearAxis, Settings
from planner.targets import Targets
from planner.tooling import FormingTool, working_solid


def inverse_kinematics(
    form: ArmForm, flange: FloatArray, branches: Sequence[int] | None = None, last: FloatArray | None = None
) -> FloatArray:
    """Joint angles (..., len(branches), J) [rad] of flange poses (..., 4, 4) in the base, all branches of
    the form unless some are named; NaN where none exists. ``last`` (...,) [rad]: the last joint of an arm
    with seven axes, without which its poses say too little.

    Branch number = shoulder (0 front, 1 back) * 2 + elbow (0, 1) + 4 * wrist (0 theta5 >= 0, 1 flipped); of
    an offset wrist as :mod:`planner.motion.offset_wrist` says. Angles are not wrapped into limits. The branch
    number of a solution is continuous in the pose while the arm does not pass a singularity; that of an
    offset wrist may change where other solutions come and go. With seven axes the shoulder is theta2 >= 0
    (0) or not, the wrist the side of axis 4 on which axis 6 is. Raises ``TypeError`` for a form that is not
    known.
    """
    branches = range(form.branches) if branches is None else branches
    if isinstance(form, SevenParameters) and last is not None:
        return seven_axes.inverse_kinematics(form, flange, last, branches)
    if isinstance(form, OffsetParameters):
        return offset_wrist.inverse_kinematics(form, flange, branches)
    if isinstance(form, ParallelParameters):
        return three_parallel.inverse_kinematics(form, flange, branches)
    if not isinstance(form, OpwParameters):
        raise TypeError(f"no inverse kinematics of {type(form).__name__}")
    return spherical_wrist.inverse_kinematics(form, flange, branches)


FULL_TURN = 2.0 * np.pi
"""One turn of a joint [rad]."""


@dataclasses.dataclass(frozen=True)
class Chain:
    """An arm at ``base`` (4, 4) in the world with a tool whose TCP is at ``tcp`` (4, 4) on the flange."""

    name: str
    robot: RobotData
    base: FloatArray
    tcp: FloatArray
    home: FloatArray

    @staticmethod
    def of(arm: Arm, base: FloatArray | None = None) -> "Chain":
        """The chain of an arm of a cell, at another base when one is given."""
        return Chain(arm.name, arm.data, arm.base if base is None else base, arm.tool.tcp, arm.home)

    def pose(self, q: FloatArray) -> FloatArray:
        """TCP poses (..., 4, 4) in the world for joint angles (..., J)."""
        return np.asarray(self.base @ forward(self.robot, q) @ self.tcp)

    def inverse(
        self, pose: FloatArray, branches: Sequence[int] | None = None, last: FloatArray | None = None
    ) -> FloatArray:
        """Joint angles (..., len(branches), J) of TCP poses (..., 4, 4), each within pi of the middle of its
        range, of all branches of the arm's form unless some are named. ``last`` (...,) [rad]: the last joint
        of an arm with seven axes, as at home unless stated.

        NaN where a pose is out of reach. Joints that may turn more than once have more states: :attr:`turns`.
        """
        if self.spare and last is None:
            last = np.broadcast_to(self.home[-1], pose.shape[:-2])
        return wrap(inverse_kinematics(self.robot.form, self._flange(pose), branches, last), self.middle)

    @property
    def spare(self) -> bool:
        """Whether it has one joint more than a pose asks for, the last one, which is a freedom then."""
        return isinstance(self.robot.form, SevenParameters)

    def on_branch(
        self, pose: FloatArray, branch: int, near: FloatArray, last: FloatArray | None = None
    ) -> FloatArray:
        """Joint angles (..., J) of TCP poses (..., 4, 4) on one branch, joints that may turn more than once
        nearest to ``near`` (..., J); NaN where there is none. ``last`` as of :meth:`inverse`, that of
        ``near`` unless stated.

        An offset wrist is followed from ``near`` on, whatever number its branch has there.
        """
        if isinstance(self.robot.form, OffsetParameters):
            return offset_wrist.followed(self.robot.form, self._flange(pose), near)
        if self.spare and last is None:
            last = near[..., -1]
        return self.continuous(self.inverse(pose, [branch], last)[..., 0, :], near)

    def joined(self, q: FloatArray) -> FloatArray:
        """Joints (N, S, B, 6) of :meth:`inverse` at N targets with S samples, branches as they go on from
        target to target: those of an offset wrist have no numbers that hold everywhere."""
        return offset_wrist.joined(q) if isinstance(self.robot.form, OffsetParameters) else q

    def joined_on(self, pose: FloatArray, branch: int, last: FloatArray | None = None) -> FloatArray:
        """Those of one branch alone, joints (N, S, J), at TCP poses (N, S, 4, 4)."""
        if isinstance(self.robot.form, OffsetParameters):  # all of them together give each its number
            return self.joined(self.inverse(pose))[..., branch, :]
        return self.inverse(pose, [branch], last)[..., 0, :]

    def _flange(self, pose: FloatArray) -> FloatArray:
        return np.asarray(rigid_inverse(self.base) @ pose @ rigid_inverse(self.tcp))

    @property
    def middle(self) -> FloatArray:
        """Middle (J,) of every joint's range."""
        return np.asarray(0.5 * (self.robot.lower + self.robot.upper))

    @property
    def turns(self) -> FloatArray:
        """Whole turns (T, 6) [rad] that can be added to angles of :meth:`inverse` and may stay within the
        limits."""
        choices = itertools.product(*(range(-m, m + 1) for m in self._most_turns))
        return FULL_TURN * np.array(sorted(choices, key=lambda c: (sum(map(abs, c)), c)), dtype=np.float64)

    @property
    def _most_turns(self) -> tuple[int, ...]:
        span = 0.5 * (self.robot.upper - self.robot.lower)
        return tuple(int(m) for m in np.floor((span + np.pi - 1e-9) / FULL_TURN))

    @property
    def many_turns(self) -> BoolArray:
        """(6,) which joints may turn more than once."""
        return np.asarray(self.robot.upper - self.robot.lower > FULL_TURN + 1e-9)

    def continuous(self, q: FloatArray, near: FloatArray) -> FloatArray:
        """The angles q (..., 6), with joints that may turn more than once brought nearest to ``near`` (...,
        6)."""
        return np.where(self.many_turns, wrap(q, near), q)

    def limit_margin(self, q: FloatArray) -> FloatArray:
        """Least distance (...,) [rad] to a joint limit; -inf where q is NaN."""
        return _plain_margin(self.robot.limit_margin(q))

    def limit_margins(self, q: FloatArray, turns: FloatArray) -> list[FloatArray]:
        """Limit margins (...,) of principal angles q (..., 6) with each of the turns (T, 6) added; -inf where
        NaN."""
        fixed = self._single_turn_margin(q)
        parts: dict[tuple[int, float], FloatArray] = {}
        out = []
        for turn in turns:
            margin: FloatArray | None = fixed
            for j in np.flatnonzero(self.many_turns):
                key = (int(j), float(turn[j]))
                if key not in parts:
                    parts[key] = self._joint_margin(q, int(j), turn[j])
                margin = parts[key] if margin is None else np.minimum(margin, parts[key])
            out.append(_plain_margin(np.asarray(margin)))
        return out

    def best_limit_margin(self, q: FloatArray) -> FloatArray:
        """The greatest of the limit margins (...,) of principal angles q (..., 6) over all of :attr:`turns`;
        -inf where NaN. Each joint has the turn that suits it."""
        margin = self._single_turn_margin(q)
        for j, most in enumerate(self._most_turns):
            if self.many_turns[j]:
                turned = [self._joint_margin(q, j, FULL_TURN * k) for k in range(-most, most + 1)]
                best = np.max(turned, axis=0)
                margin = best if margin is None else np.minimum(margin, best)
        return _plain_margin(np.asarray(margin))

    def _single_turn_margin(self, q: FloatArray) -> FloatArray | None:
        """Limit margin (...,) of joints with one turn and of the rod; None where there are none."""
        fixed: FloatArray | None = None
        for j in np.flatnonzero(~self.many_turns):
            part = self._joint_margin(q, int(j), 0.0)
            fixed = part if fixed is None else np.minimum(fixed, part)
        if self.robot.coupling is not None:
            axis3 = q[..., 1] + q[..., 2]
            rod = np.minimum(axis3 - self.robot.coupling.axis3_lower, self.robot.coupling.axis3_upper - axis3)
            fixed = rod if fixed is None else np.minimum(fixed, rod)
        return fixed

    def _joint_margin(self, q: FloatArray, joint: int, turn: float) -> FloatArray:
        angle = q[..., joint] + turn
        return np.asarray(np.minimum(angle - self.robot.lower[joint], self.robot.upper[joint] - angle))

    def singularity_margin(self, q: FloatArray) -> FloatArray:
        """Least angle (...,) [rad] from a singularity of wrist, elbow or shoulder; -inf where q is NaN."""
        wrist, elbow, shoulder = self._singularities(q)
        return _plain_margin(np.minimum(np.minimum(wrist, elbow), shoulder))

    def singularities(self, q: FloatArray) -> FloatArray:
        """Angles (..., 3) [rad]: axis 5 from lining up axes 4 and 6, the elbow from stretched or folded, and
        the angle under which the stretched arm would see the distance of the wrist's centre from axis 1; of
        an arm with three parallel axes, that of where axes 5 and 6 meet. Of an offset wrist the first is
        the angle whose sine the Jacobian's determinant has left beside the other two. With seven axes those
        at which no other joint can be moved with the last one held: :mod:`planner.motion.seven_axes`."""
        return np.stack(self._singularities(q), axis=-1)

    def _singularities(self, q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        p = self.robot.form
        if isinstance(p, OffsetParameters):
            return offset_wrist.singularities(p, q)
        if isinstance(p, ParallelParameters):
            return three_parallel.singularities(p, q)
        if isinstance(p, SevenParameters):
            return seven_axes.singularities(p, q)
        p = self.robot.opw
        theta2, theta3, theta5 = (p.signs[j] * q[..., j] - p.offsets[j] for j in (1, 2, 4))
        wrist = np.abs(wrap(2.0 * theta5, np.zeros(()))) / 2.0
        elbow = np.abs(wrap(2.0 * (theta3 + np.arctan2(p.a2, p.c3)), np.zeros(()))) / 2.0
        tilt = theta2 + theta3
        out = p.a1 + p.c2 * np.sin(theta2) + p.c3 * np.sin(tilt) + p.a2 * np.cos(tilt)
        shoulder = np.arcsin(np.minimum(1.0, np.abs(out) / (p.c2 + np.hypot(p.a2, p.c3))))
        return wrist, elbow, shoulder

    def rates(self, q: FloatArray, twist: FloatArray) -> FloatArray:
        """Joint rates (..., K, J) for K body twists (..., K, 6) of the TCP (angular part first) at angles q
        (..., J); a joint more than six stands."""
        jac = jacobian(self.robot, q)
        flange = forward(self.robot, q)
        tool = flange[..., :3, :3] @ self.tcp[:3, :3]
        angular = np.einsum("...ij,...kj->...ik", tool, twist[..., :3])
        linear = np.einsum("...ij,...kj->...ik", tool, twist[..., 3:])
        lever = flange[..., :3, :3] @ self.tcp[:3, 3]
        at_flange = linear - np.cross(np.swapaxes(angular, -1, -2), lever[..., None, :]).swapaxes(-1, -2)
        rates = np.linalg.solve(jac[..., :6], np.concatenate([angular, at_flange], axis=-2))
        return self.with_last(np.swapaxes(rates, -1, -2))

    def with_last(self, rates: FloatArray) -> FloatArray:
        """Rates (..., J) of rates (..., 6) with the last joint held."""
        return np.concatenate([rates, np.zeros((*rates.shape[:-1], 1))], axis=-1) if self.spare else rates

    def own_rates(self, q: FloatArray) -> FloatArray:
        """Joint rates (..., J) per [rad] of the last joint with the TCP held, at angles q (..., J) of an arm
        that has one to spare."""
        jac = jacobian(self.robot, q)
        others = np.linalg.solve(jac[..., :6], -jac[..., 6:])[..., 0]
        return np.concatenate([others, np.ones((*others.shape[:-1], 1))], axis=-1)


def _plain_margin(margin: FloatArray) -> FloatArray:
    """Margins, -inf where NaN."""
    return np.where(np.isnan(margin), -np.inf, margin)


def wrap(angle: FloatArray, near: FloatArray) -> FloatArray:
    """Angles brought within pi of ``near`` by whole turns."""
    return np.asarray(angle - FULL_TURN * np.round((angle - near) / FULL_TURN))


SKIPPED_END_LENGTH = 0.05
"""Arc length [m] at either end of the flexible edge that is not held against the tool which holds it."""

TRANSIT_KIND = "transit"
"""Kind of segments in which joined TCPs go from one work to the next and keep their relative pose."""

HELD_PREFIX = "held:"
"""Work frames that another arm's tool carries are named by this and that arm."""


DISTANCE_BATCH = 64
"""Targets that are asked for their least distance at a time, nearest bounds first."""


@dataclasses.dataclass(frozen=True)
class Scene:
    """Arms of one operation with the stock at ``stock`` (4, 4) in the world.

    ``model`` is the cell's collision model, or None for kinematics alone. Of :meth:`of` it is one in which
    bodies of one arm count as farther apart than they are, so that ``settings.clearance`` can be asked of all
    (:mod:`planner.motion.own_clearance`).

    Where a base rides along (:attr:`Targets.ride`) its chain stands where the track is at its station, and
    poses of TCPs that joints are found of are those seen from there: shifted back by the way that the base
    has gone (:meth:`tcp`). A straight move is straight there as well. :meth:`bodies` has them where they
    are. ``tracks`` {arm: (its track, its station [m])}.
    """

    chains: Mapping[str, Chain]
    stock: FloatArray
    settings: Settings
    model: CellModel | None = None
    tracks: Mapping[str, tuple[LinearAxis, float]] = dataclasses.field(default_factory=dict)

    @staticmethod
    def of(
        cell: Cell,
        arms: tuple[str, ...],
        stock: FloatArray,
        settings: Settings,
        model: CellModel | None = None,
        bases: Mapping[str, FloatArray] | None = None,
    ) -> "Scene":
        """The scene of the named arms of a cell; ``bases`` replaces base poses."""
        moved = bases or {}
        chains = {name: Chain.of(cell.arm(name), moved.get(name)) for name in arms}
        stands = [arm for arm in cell.arms if arm.track is not None and arm.name in arms]
        tracks = {arm.name: (arm.track, arm.station or 0.0) for arm in stands if arm.track is not None}
        eased = None if model is None else own_clearance.eased(model, settings)
        return Scene(chains, stock, settings, eased, tracks)

    def columns(self, arms: Sequence[str]) -> dict[str, slice]:
        """Where each of some arms' joints are among those of all of them, one after the other."""
        return columns_of({arm: self.chains[arm].robot for arm in arms})

    def ridden(
        self, targets: Targets, index: IndexArray | None = None, share: FloatArray | None = None
    ) -> dict[str, FloatArray]:
        """How far {arm: (..., 3)} [m] bases have gone from their stations at targets ``index`` (...,), at all
        unless stated; or at ``share`` (...,) of the moves that lead there. Those that stand are left out."""
        out = {}
        for arm, values in targets.ride.items():
            track, station = self.tracks[arm]
            here = values if index is None else values[index]
            if share is not None and index is not None:
                before = values[np.maximum(index - 1, 0)]
                here = before + share * (here - before)
            out[arm] = (here - station)[..., None] * track.axis
        return out

    def chain_poses(
        self,
        targets: Targets,
        q: Mapping[str, FloatArray],
        index: IndexArray,
        share: FloatArray | None = None,
    ) -> dict[str, FloatArray]:
        """TCP poses {arm: (B, 4, 4)} in the world of joints {arm: (B, 6)}, bases where :meth:`ridden` has
        them."""
        gone = self.ridden(targets, index, share)
        poses = {arm: self.chains[arm].pose(angles) for arm, angles in q.items()}
        return {arm: _shifted(pose, gone[arm]) if arm in gone else pose for arm, pose in poses.items()}

    def bodies(
        self, targets: Targets, index: IndexArray | None = None, share: FloatArray | None = None
    ) -> CellModel | None:
        """The model whose bases stand, row by row, where they are at targets, as :meth:`ridden` has them; the
        scene's own where none rides."""
        if self.model is None or not targets.ride:
            return self.model
        bases = {}
        for arm, gone in self.ridden(targets, index, share).items():
            bases[arm] = np.tile(self.model.bases[arm], (len(gone), 1, 1))
            bases[arm][:, :3, 3] += gone
        return self.model.with_bases(bases)

    def standing(self, targets: Targets, row: int) -> "Scene":
        """The scene whose bases, chains too, stand where they are at a target; itself where none rides."""
        if not targets.ride:
            return self
        gone = self.ridden(targets, np.array(row))
        chains, tracks = dict(self.chains), dict(self.tracks)
        for arm, way in gone.items():
            base = self.chains[arm].base.copy()
            base[:3, 3] += way
            chains[arm] = dataclasses.replace(self.chains[arm], base=base)
            tracks[arm] = self.tracks[arm][0], float(targets.ride[arm][row])
        model = self.model
        if model is not None:
            model = model.with_bases({arm: chains[arm].base for arm in gone})
        return dataclasses.replace(self, chains=chains, model=model, tracks=tracks)

    def world(
        self, targets: Targets, poses: Mapping[str, FloatArray], index: IndexArray | None = None
    ) -> dict[str, FloatArray]:
        """TCP poses in the world of poses {arm: (..., 4, 4)} in the work frames of the targets, at targets
        ``index`` (...,), at all unless stated; where a base rides as its chain sees them."""
        done: dict[str, FloatArray] = {}
        for arm, holder in holders(targets):
            if holder is not None:
                done[arm] = done[holder] @ poses[arm]
            else:
                done[arm] = poses[arm] if targets.frame.get(arm) == "world" else self.stock @ poses[arm]
        for arm, gone in self.ridden(targets, index).items():
            done[arm] = _shifted(done[arm], -gone)
        return done

    def tcp(
        self, targets: Targets, values: FloatArray, index: IndexArray | None = None
    ) -> dict[str, FloatArray]:
        """TCP poses in the world {arm: (..., 4, 4)} at freedom values (..., F), as :meth:`Targets.poses`;
        where a base rides as its chain sees them."""
        return self.world(targets, targets.poses(values, index), index)

    def edge(self, targets: Targets, index: IndexArray) -> FloatArray | None:
        """Points (B, P, 3) of the flexible edge in the world at targets ``index`` (B,), or None without an
        edge."""
        if targets.edge is None:
            return None
        frame = targets.frame.get(targets.arms[0], "stock")
        points = targets.edge.points[index]
        return points if frame == "world" else transform(self.stock, points)

    @functools.cached_property
    def last_reach(self) -> dict[str, tuple[FloatArray, FloatArray | None, tuple[int, int], object]]:
        """What was found last of each arm's reach: the poses, last joints that are freedoms, how many targets
        and samples, and the table."""
        return {}

    @functools.cached_property
    def passing(self) -> Pairs:
        """Pairs of bodies that may meet in working segments: the stock and the rigid edges of the tools that
        take part, and the heads of two tools that form one sheet."""
        if self.model is None:
            return frozenset()
        tools = {arm: self.model.cell.arm(arm).tool for arm in self.chains}
        works = [arm for arm, tool in tools.items() if working_solid(tool) is not None]
        pairs = {frozenset((f"{arm}/edge", "stock")) for arm in works}
        heads = [f"{arm}/edge" for arm, tool in tools.items() if isinstance(tool, FormingTool)]
        return frozenset(pairs | ({frozenset(heads)} if len(heads) > 1 else set()))

    def by_kind(self, targets: Targets, move: IndexArray) -> list[tuple[Pairs, IndexArray]]:
        """Rows of ``move`` (B,), targets that moves lead to, with the pairs of bodies that may meet there."""
        if not self.passing:
            return [(frozenset(), np.arange(len(move)))]
        cuts = cutting(targets)[move]
        parts = [(self.passing, np.flatnonzero(cuts)), (frozenset(), np.flatnonzero(~cuts))]
        return [(pairs, rows) for pairs, rows in parts if len(rows)]

    def free(
        self,
        targets: Targets,
        q: Mapping[str, FloatArray],
        index: IndexArray,
        move: IndexArray | None = None,
        ignored: Pairs = frozenset(),
        edge: bool = True,
        share: FloatArray | None = None,
    ) -> BoolArray:
        """(B,) whether joints {arm: (B, 6)} at targets ``index`` (B,) keep the wanted clearance, that of the
        flexible ``edge`` included.

        ``move`` (B,) are the targets that the moves lead to on which the joints lie, where that is not
        ``index``, and ``share`` (B,) how much of them is gone. Pairs of bodies in ``ignored`` are not looked
        at.
        """
        if self.model is None or len(index) == 0:
            return np.ones(len(index), dtype=bool)
        ok = np.zeros(len(index), dtype=bool)
        there = self.bodies(targets, index if move is None else move, share) or self.model
        for ignore, part in self.by_kind(targets, index if move is None else move):
            some = {arm: v[part] for arm, v in q.items()}
            ok[part] = clearance.free(there.at_rows(part), some, self.settings.clearance, ignore | ignored)
        if not edge:
            return ok
        rows = np.flatnonzero(ok)
        ok[rows] = self._edge_free(targets, {arm: v[rows] for arm, v in q.items()}, index[rows])
        return ok

    def _edge_free(self, targets: Targets, q: Mapping[str, FloatArray], index: IndexArray) -> BoolArray:
        """(B,) whether the flexible edge keeps the wanted clearance, as in :meth:`edge_clearance`."""
        out = np.ones(len(index), dtype=bool)
        points = self.edge(targets, index)
        if points is None or targets.edge is None or self.model is None:
            return out
        edge, padding = targets.edge, self.settings.clearance
        for against, rows in _held_against(targets, index):
            part = {arm: q[arm][rows] for arm in targets.arms}
            out[rows] = clearance.edge_free(
                self.model, part, points[rows], edge.radius, SKIPPED_END_LENGTH, padding, against
            )
        return out

    def least(
        self, targets: Targets, q: Mapping[str, FloatArray], move: IndexArray, reach: float
    ) -> LeastClearance:
        """Least distances (B,) between bodies, as they count, at joints {arm: (B, 6)} on the moves to targets
        ``move`` (B,), at their ends where a base rides, of those within ``reach`` [m]; without the flexible
        edge."""
        distance, pair = np.full(len(move), reach), [("", "")] * len(move)
        if self.model is None:
            return LeastClearance(distance, tuple(pair))
        there = self.bodies(targets, move) or self.model
        for ignore, rows in self.by_kind(targets, move):
            part = {arm: v[rows] for arm, v in q.items()}
            found = clearance.least(there.at_rows(rows), part, reach, ignore)
            distance[rows] = found.distance
            for row, names in zip(rows, found.pair, strict=True):
                pair[row] = names
        return LeastClearance(distance, tuple(pair))

    def nearest(
        self, targets: Targets, q: Mapping[str, FloatArray], reach: float, own: bool = False
    ) -> tuple[float, tuple[str, str], int]:
        """The least true distance [m] over all targets between bodies of one arm (``own``) or all others, if
        within ``reach`` [m], its pair and its target; exact, though only targets are looked at whose cheap
        lower bounds leave room for less."""
        best, pair, where = reach, ("", ""), 0
        if self.model is None:
            return best, pair, where
        model = (self.bodies(targets) or self.model).with_easing(NOT_EASED)
        aside = own_clearance.other_pairs(model) if own else own_clearance.own_pairs(model)
        for passing, rows in self.by_kind(targets, np.arange(targets.count)):
            part, ignore, here = {arm: v[rows] for arm, v in q.items()}, passing | aside, model.at_rows(rows)
            some = spread_rows(len(rows), DISTANCE_BATCH)  # bounds need not reach farther than these are
            few = clearance.least(here.at_rows(some), {arm: v[some] for arm, v in part.items()}, best, ignore)
            enough = float(few.distance.min(initial=best)) + 2.0 * clearance.BOUND_ERROR
            lower = clearance.at_least(here, part, min(best, enough), ignore)
            order = np.argsort(lower, kind="stable")
            for start in range(0, len(order), DISTANCE_BATCH):
                some = order[start : start + DISTANCE_BATCH]
                some = some[lower[some] < best]
                if not len(some):
                    break
                q_some = {arm: v[some] for arm, v in part.items()}
                found = clearance.least(here.at_rows(some), q_some, best, ignore)
                k = found.worst()
                if found.distance[k] < best:
                    best, pair, where = float(found.distance[k]), found.pair[k], int(rows[some[k]])
        return best, pair, where

    def between(
        self,
        targets: Targets,
        start: Mapping[str, FloatArray],
        end: Mapping[str, FloatArray],
        share: FloatArray,
    ) -> dict[str, FloatArray]:
        """TCP poses in the world {arm: (..., 4, 4)} at ``share`` (...,) of linear moves between world poses.

        A TCP whose work frame is held by another arm moves straight in that frame, which itself moves.
        """
        out: dict[str, FloatArray] = {}
        for arm, holder in holders(targets):
            if holder is None:
                out[arm] = interpolate(start[arm], end[arm], share)
            else:
                first, last = inverse(start[holder]) @ start[arm], inverse(end[holder]) @ end[arm]
                out[arm] = out[holder] @ interpolate(first, last, share)
        return {arm: out[arm] for arm in targets.arms}

    def edge_clearance(
        self, targets: Targets, q: Mapping[str, FloatArray], index: IndexArray
    ) -> tuple[FloatArray, list[tuple[str, str]]]:
        """Least distances (B,) [m] of the flexible edge to what it may not touch, and the pairs.

        The stock counts except in cut segments. Infinite without an edge.
        """
        distance, pairs = np.full(len(index), np.inf), [("", "")] * len(index)
        points = self.edge(targets, index)
        if points is None or targets.edge is None or self.model is None:
            return distance, pairs
        for against, rows in _held_against(targets, index):
            part = {arm: q[arm][rows] for arm in targets.arms}
            found = edge_clearance(
                self.model, part, points[rows], targets.edge.radius, SKIPPED_END_LENGTH, against
            )
            distance[rows] = found.distance
            for row, pair in zip(rows, found.pair, strict=True):
                pairs[row] = pair
        return distance, pairs


def _shifted(poses: FloatArray, way: FloatArray) -> FloatArray:
    """Poses (..., 4, 4) moved by ways (..., 3) [m]."""
    out = np.array(np.broadcast_to(poses, (*np.broadcast_shapes(poses.shape[:-2], way.shape[:-1]), 4, 4)))
    out[..., :3, 3] += way
    return out


def _held_against(targets: Targets, index: IndexArray) -> list[tuple[Against, IndexArray]]:
    """Rows of ``index`` (B,) with what the flexible edge is held against there: the stock is left out where
    it cuts."""
    cuts = cutting(targets)[index]
    choices: list[tuple[Against, IndexArray]] = [
        ("no_stock", np.flatnonzero(cuts)),
        ("all", np.flatnonzero(~cuts)),
    ]
    return [(against, rows) for against, rows in choices if len(rows)]


def holders(targets: Targets) -> list[tuple[str, str | None]]:
    """Arms, each with the arm that holds its work frame or None, holders first."""
    frames = {arm: targets.frame.get(arm, "stock") for arm in targets.arms}
    pairs = [
        (arm, f.removeprefix(HELD_PREFIX) if f.startswith(HELD_PREFIX) else None) for arm, f in frames.items()
    ]
    return sorted(pairs, key=lambda pair: pair[1] is not None)


def cutting(targets: Targets) -> BoolArray:
    """(N,) whether an edge works the stock on the move to each target."""
    return np.array([segment.works for segment in targets.segment], dtype=bool)
