"""Trajectory optimisation as a Drake ``MathematicalProgram``, seeded by the banded result.

Each round is a convex quadratic program over the freedoms of all targets, by Clarabel or OSQP. Its cost is
that of :mod:`planner.motion.trajectory.trajopt` without obstacles, by Gauss and Newton, with the Jacobians of
Drake's plant. What the banded form has to price is a constraint here: every clearance, the margins of joints
and of singular postures, the peaks of joint acceleration and jerk, and for tools that are joined (a wire) how
far their pose to each other leaves the wanted one between targets; at targets it is exact, for the freedoms
are all that can change. Joints follow by closed-form inverse kinematics in every trial step.

A path that is found here keeps all that the seed keeps, at a lower cost; otherwise there is none, with the
reason. Work is bounded by rounds and by distances that are asked for.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from pydrake.solvers import ClarabelSolver, MathematicalProgram, OsqpSolver, SolverInterface

from planner.cell.plant import CellModel, quiet
from planner.geometry.arrays import BoolArray, FloatArray, interpolate, inverse, log_pose
from planner.motion.planning_scene import Scene
from planner.motion.search.reach import slides_only
from planner.motion.trajectory.differences import Band, bands
from planner.motion.trajectory.hinges import Avoid, Rows, near_margins
from planner.motion.trajectory.linear_rows import Linear, add_cost
from planner.motion.trajectory.trajopt import Improved, PathProblem
from planner.motion.trajectory.windows import Windows
from planner.targets import TableFreedom, Targets

MOST_TARGETS: Final = 1000
"""Of longer jobs the program gets some :mod:`planner.motion.trajectory.windows`."""
LEAST_TARGETS: Final = 3
"""Of fewer there is no acceleration."""
MOST_ROUNDS: Final = 6
"""Quadratic programs at most."""
LEAST_GAIN_SHARE: Final = 3e-3
"""A round that gains less than this share of the cost is the last."""
LEAST_SCALE: Final = 0.1
"""Steps are halved down to this share of what the program gives."""

TRUST_SHARE: Final = 0.3
"""A slide or a table moves by at most this share of its range in a round."""
TRUST_RAD: Final = 0.3
"""A turn moves by at most this [rad] in a round."""
RESERVE_M: Final = 0.5e-3
"""Distances at targets are kept so much [m] above the wanted clearance, or where they are if that is less:
moves between targets bend."""
PEAK_SHARE: Final = 1.02
"""Peaks of acceleration and jerk, each path on its own clock, grow to at most this share of the seed's."""
KEPT_SHARE: Final = 1.01
"""Trial steps keep them, on the seed's clock, to this share: programs are linear about a path."""
JOINED_FLOOR: Final = 1e-6
"""Poses of joined tools to each other may always leave the wanted one by this [m, rad] between targets."""
EXACT: Final = 1e-12
"""Poses are met to this [m]."""
DIFFERENCE_SHARE: Final = 0.01
"""Step of central differences, as a share of how far a freedom may move in a round."""
LARGEST_ENTRY: Final = 2e3
"""Largest entry of the cost's matrix as solvers get it: a hundred times as much stopped Clarabel short."""
PRICE_STEP: Final = 0.1
"""Peaks of windows cost as much as the joints that freedoms move there; so many times as much after each
program whose path would cost more than the seed,"""
LEAST_PRICE: Final = 1e-4
"""down to this share."""
SOLVERS: Final = (ClarabelSolver, OsqpSolver)
"""Solvers of the quadratic programs, the first that this build of Drake has and that solves one."""


@dataclasses.dataclass(frozen=True)
class Programmed:
    """What came of the program: a path, or None with the ``reason``; ``solver`` of the last round, the
    ``rounds`` and the targets ``asked`` for distances."""

    path: Improved | None
    reason: str
    solver: str = ""
    rounds: int = 0
    asked: int = 0


def solvers() -> list[SolverInterface]:
    """The solvers that this build of Drake has, in the order in which they are asked."""
    return [solver for solver in (kind() for kind in SOLVERS) if solver.available() and solver.enabled()]


def solver_name(kind: type) -> str:
    """What a solver is called."""
    return kind.__name__.removesuffix("Solver")


def optimise(
    scene: Scene,
    targets: Targets,
    branch: Mapping[str, int],
    seed: Improved,
    duration: FloatArray,
    stop: BoolArray,
    avoid: Avoid,
    budget: int,
    windows: Windows | None = None,
) -> Programmed:
    """A path of lower cost than ``seed`` on the branches ``branch``, whose moves last ``duration``
    (N - 1,) [s], with stops ``stop`` (N,). ``avoid`` measures the distances, at ``budget`` targets before
    the last round at most.

    The first and the last target stay as they are: arms come there from home, and go home from there. Moves
    between targets are the caller's to look at. Where there are ``windows`` of a longer path, ``targets``,
    ``seed`` and what is given back are those of the windows alone; what they do on the clock they know.
    """
    if scene.model is None or not targets.freedoms or targets.count < LEAST_TARGETS:
        return Programmed(None, "nothing is free at any target, or there are too few of them")
    ready = solvers()
    if not ready:
        return Programmed(None, "this build of Drake has no solver for it")
    own = bands(duration, stop) if windows is None else windows.bands
    search = _Search(scene, scene.model, targets, branch, seed, own, avoid, windows)
    return search.run(ready, budget)


@dataclasses.dataclass(frozen=True)
class _Look:
    """What a path is judged by: its cost, least distances (N,) [m], peaks of acceleration and jerk, each by
    joint (J,), and how far joined tools leave their pose to each other between targets (N - 1, 6)."""

    cost: float
    near: Rows
    least: FloatArray
    peaks: tuple[FloatArray, ...]
    joined: FloatArray


class _Search:
    def __init__(
        self,
        scene: Scene,
        model: CellModel,
        targets: Targets,
        branch: Mapping[str, int],
        seed: Improved,
        bands: tuple[Band, ...],
        avoid: Avoid,
        windows: Windows | None = None,
    ) -> None:
        self.scene, self.model, self.targets, self.avoid = scene, model, targets, avoid
        self.windows = windows
        self.problem = PathProblem(scene, targets, branch, None, None if windows is None else windows.weights)
        self.values = self.problem.unwrapped(seed.values)
        self.joints = self.problem.stack(seed.q)
        self.start = avoid.asked
        self.bands = bands
        self.held = np.zeros(targets.count, dtype=np.bool_) if windows is None else windows.held.copy()
        self.held[[0, -1]] = True  # where ways from and to home are known to be, or not to be
        self.look = self._look(self.values, self.joints)
        tops, self.price, self.fixed = self.look.peaks, 0.0, 0.0
        if windows is not None:
            tops = windows.tops
            self.fixed = self.problem.smoothness(np.where(windows.moved, 0.0, self.joints))
            self.price = self.look.cost - self.fixed
        self.least_price, self.before = LEAST_PRICE * self.price, self.look.cost
        strength = np.concatenate([scene.chains[arm].robot.acceleration for arm in targets.arms])
        # no joint may come to more than any of them has, nor to more of what it can than any of them has
        self.allowed = [np.minimum(peak.max(), (peak / strength).max() * strength) for peak in tops]
        self.wanted = np.minimum(scene.settings.clearance + RESERVE_M, self.look.least)
        self.off = np.maximum(np.abs(self.look.joined).max(axis=0, initial=0.0), JOINED_FLOOR)
        ranges = [float((f.upper - f.lower).max()) for f in targets.freedoms]
        spans = [
            TRUST_SHARE * (span or 1.0) if slides_only(f) else TRUST_RAD  # bounds hold what has no range
            for f, span in zip(targets.freedoms, ranges, strict=True)
        ]
        self.trust = np.array(spans)

    def run(self, ready: Sequence[SolverInterface], budget: int) -> Programmed:
        """Rounds until little is gained, by the first solver that is ``ready`` and solves."""
        rounds, used, reason = 0, "", "the banded result cannot be bettered"
        while rounds < MOST_ROUNDS and self._asked() < budget:
            rounds += 1
            step, used = self._solved(ready)
            if step is None:
                reason = f"{used} did not solve the program"
                break
            worth = self._worth(self.look.cost, self.joints)
            scale = self._advance(step)
            gain = worth - self._worth(self.look.cost, self.joints)
            if scale > 0.0 and (gain < LEAST_GAIN_SHARE * worth or self._settled()):
                break
            if scale == 0.0 and self.price > self.least_price:
                self.price *= PRICE_STEP
                continue
            self.trust = self.trust * (1.0 if scale == 1.0 else max(scale, LEAST_SCALE))
        asked = self._asked()
        if not self.look.cost < self.before:
            return Programmed(None, reason, used, rounds, asked)
        q = self.problem.split(self.joints)
        if not self._exact(q):
            return Programmed(None, f"poses are off by more than {EXACT} m", used, rounds, asked)
        path = Improved(self.values, q, self.look.cost, self.before, rounds)
        return Programmed(path, "", used, rounds, asked)

    def _asked(self) -> int:
        return self.avoid.asked - self.start

    def _look(self, values: FloatArray, joints: FloatArray) -> _Look:
        near = self.avoid.distances(joints)
        least = np.full(len(joints), np.inf)
        np.minimum.at(least, near.index, near.value)
        peaks = tuple(np.abs(band.of(joints)).max(axis=0, initial=0.0) for band in self.bands)
        return _Look(self.problem.cost(values, joints), near, least, peaks, self._joined(values))

    def _advance(self, step: FloatArray) -> float:
        """Goes the greatest share of a step that keeps everything and gains; that share, 0 for none. Steps of
        windows are gone whole while there is a lower price of peaks."""
        scale, least = 1.0, 0.5 if self.price > self.least_price else LEAST_SCALE
        while scale > least:
            values = self.problem.clip(self.values + scale * step)
            joints = self.problem.joints(values, self.joints)
            if joints is not None and self._gains(values, joints):
                look = self._look(values, joints)
                if self._keeps(look):
                    self.values, self.joints, self.look = values, joints, look
                    return scale
            scale *= 0.5
        return 0.0

    def _worth(self, cost: float, joints: FloatArray) -> float:
        """What a path comes to: its cost, and of windows that of what can change, with their peaks."""
        if self.windows is None:
            return cost
        return cost - self.fixed + self.price * sum(self.windows.levels(joints))

    def _gains(self, values: FloatArray, joints: FloatArray) -> bool:
        """Whether a path is worth less than the one before, and costs no more than the seed."""
        cost = self.problem.cost(values, joints)
        return cost < self.before and self._worth(cost, joints) < self._worth(self.look.cost, self.joints)

    def _settled(self) -> bool:
        """Whether windows have no peak left that could come down: further programs hardly change them."""
        return self.windows is not None and not any(self.windows.levels(self.joints))

    def _keeps(self, look: _Look) -> bool:
        wanted = np.minimum(self.wanted, self.scene.settings.clearance + 0.5 * RESERVE_M)
        peaks = zip(look.peaks, self.allowed, strict=True)
        return bool(
            (look.least >= wanted).all()
            and all((peak <= KEPT_SHARE * most).all() for peak, most in peaks)
            and (np.abs(look.joined) <= KEPT_SHARE * self.off).all()
        )

    def _exact(self, q: Mapping[str, FloatArray]) -> bool:
        """Whether the joints put the TCPs where the freedoms do."""
        wanted = self.scene.tcp(self.targets, self.values)
        found = {arm: self.scene.chains[arm].pose(q[arm]) for arm in q}
        return all(float(np.abs(found[arm] - wanted[arm])[:, :3, 3].max()) <= EXACT for arm in q)

    def _solved(self, ready: Sequence[SolverInterface]) -> tuple[FloatArray | None, str]:
        """The program's step (N, F) by the first solver that has one, None for none, and the solver."""
        program, unknowns = self._program()
        name = ""
        for solver in ready:
            name = solver_name(type(solver))
            with quiet():
                found = solver.Solve(program)
            step = np.asarray(found.GetSolution(unknowns.ravel())).reshape(unknowns.shape)
            if found.is_success() and np.isfinite(step).all():
                step[self.held] = 0.0  # solvers meet bounds to a tolerance
                return step * self.trust, name
        return None, name

    def _program(self) -> tuple[MathematicalProgram, Any]:
        """The program of the next step and its unknowns (N, F), in units of what a round allows."""
        problem, values, joints = self.problem, self.values, self.joints
        rates = problem.plant_rates(self.model, values, joints)
        blocks, slope = problem.model(values, joints, rates)
        program = MathematicalProgram()
        unknowns = program.NewContinuousVariables(*values.shape, "step")
        blocks = [block * self.trust[:, None] * self.trust for block in blocks]
        unit = LARGEST_ENTRY / (float(np.abs(blocks[0]).max()) or 1.0)
        blocks, slope = [unit * block for block in blocks], unit * slope * self.trust
        add_cost(program, unknowns, blocks, slope)
        low, high = (problem.lower - values) / self.trust, (problem.upper - values) / self.trust
        low, high = np.clip(low, -1.0, 0.0), np.clip(high, 0.0, 1.0)
        low[self.held] = high[self.held] = 0.0
        flat = unknowns.ravel()
        program.AddBoundingBoxConstraint(low.ravel(), high.ravel(), flat)
        levels = 0 if self.windows is None else len(self.bands)
        rows = Linear(values.shape, levels)
        self._add_distances(rows, rates)
        for band, most in zip(self.bands, self.allowed, strict=True):
            rows.add_band(band, joints, rates, most)
        self._add_joined(rows)
        if self.windows is not None:
            own = program.NewContinuousVariables(levels, "level")
            program.AddBoundingBoxConstraint(0.0, 1.0, own)
            program.AddLinearCost(np.full(levels, unit * self.price), own)
            for level, (band, bound) in enumerate(zip(self.bands, self.windows.bounds, strict=True)):
                rows.add_level(band, joints, rates, bound, level)
            flat = np.concatenate([flat, own])
        if rows.count:
            matrix, lower, upper = rows.stacked(self.trust)
            if len(lower):
                program.AddLinearConstraint(matrix, lower, upper, flat)
        return program, unknowns

    def _add_distances(self, rows: Linear, rates: FloatArray) -> None:
        """Clearances of bodies, and the hard margins of joints and singular postures where they are near."""
        near = self.look.near
        rows.add_slopes(near, rates, np.minimum(self.wanted[near.index] - near.value, 0.0))
        for margins, hard, _ in near_margins(self.scene, self.targets.arms, self.joints):
            rows.add_slopes(margins, rates, np.minimum(hard - margins.value, 0.0))

    def _joined(self, values: FloatArray) -> FloatArray:
        """How far (N - 1, 6) [rad, m] the pose of one joined tool to the other is off, half way between
        targets, what it would be there if both targets had the same freedoms."""
        if not _is_joined(self.targets):
            return np.zeros((self.targets.count - 1, 6))
        off = _off_joined(self.targets, values[:-1], values[1:])
        if self.windows is not None:
            off[np.diff(self.windows.rows) > 1] = 0.0  # not a move
        return off

    def _add_joined(self, rows: Linear) -> None:
        if not _is_joined(self.targets):
            return
        now, ends = self.look.joined, (self.values[:-1], self.values[1:])
        slopes = np.zeros((2, *now.shape, self.values.shape[1]))
        for j, step in enumerate(DIFFERENCE_SHARE * self.trust):
            shift = np.zeros(self.values.shape[1])
            shift[j] = step
            for side, (before, behind) in enumerate(((shift, 0.0 * shift), (0.0 * shift, shift))):
                ahead = _off_joined(self.targets, ends[0] + before, ends[1] + behind)
                back = _off_joined(self.targets, ends[0] - before, ends[1] - behind)
                slopes[side, ..., j] = (ahead - back) / (2.0 * step)
        rows.add_pairs(slopes, -self.off - now, self.off - now)


def _is_joined(targets: Targets) -> bool:
    """Whether a freedom changes how two joined tools stand to each other."""
    return targets.coupled and any(isinstance(f, TableFreedom) for f in targets.freedoms)


def _off_joined(targets: Targets, start: FloatArray, end: FloatArray) -> FloatArray:
    """What :meth:`_Search._joined` tells, of freedoms (N - 1, F) at the start and at the end of each move."""
    one, other = targets.arms[0], targets.arms[-1]
    first, last = np.arange(targets.count - 1), np.arange(1, targets.count)
    half, mean = np.full(targets.count - 1, 0.5), 0.5 * (start + end)

    def between(a: FloatArray, b: FloatArray) -> FloatArray:
        begins, ends = targets.poses(a, first), targets.poses(b, last)
        middle = {arm: interpolate(begins[arm], ends[arm], half) for arm in (one, other)}
        return inverse(middle[one]) @ middle[other]

    return log_pose(inverse(between(mean, mean)) @ between(start, end))
