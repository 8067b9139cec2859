"""Chooses branches for all arms together; feeds collisions back to the ladder until its path is free."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from planner.motion.chain import TWO_PI
from planner.motion.collide import Checker, Others
from planner.motion.ladder import Ladder, Path, Steps, joint_path, steps
from planner.motion.reach import Grid, Reach, Rungs, full_turn, reach
from planner.motion.scene import Scene
from planner.targets import Targets

FloatArray = NDArray[np.float64]

ROUNDS = 60
MOST_CHOICES = 6
WORTH_IT = 0.3
"""Share by which other branches must promise a cheaper path for them to be checked for collisions as well."""

TOLERATED = 1e-3
"""Share of its cost by which a path may be dearer than the bound that ignores turns before turns are searched
too."""


@dataclasses.dataclass(frozen=True)
class Found:
    """A path over the samples: freedom ``values`` (N, F), joints {arm: (N, 6)}, and how it was found."""

    path: Path
    values: FloatArray
    q: dict[str, FloatArray]
    choices: int
    checks: int = 0
    rounds: int = 1


@dataclasses.dataclass(frozen=True)
class Blocked:
    """Why there is no path, and what is known of it.

    ``reach`` is the table of all arms; ``common`` the first target that no choice of branches passes, N if it
    is collisions that are in the way; then ``path`` is the last path tried and ``collided`` (N, S) what
    collides, or ``hit`` a target with joints {arm: (6,)} on the move to it that collide. ``few``: the targets
    that all this is about, with their indices (K,) in the job, where only some of it was looked at.
    """

    reach: Mapping[str, Reach]
    common: int
    collided: NDArray[np.bool_] | None = None
    path: Found | None = None
    hit: tuple[int, dict[str, FloatArray]] | None = None
    few: tuple[Targets, NDArray[np.intp]] | None = None


def search(scene: Scene, targets: Targets, grid: Grid, others: Others | None = None) -> Found | Blocked:
    """The path of least cost over branches, samples and turns that keeps clearance at every target.

    Branches stay the same over the whole run. Choices of branches are tried in the order of their cost
    without collisions, which bounds their cost with collisions from below; the rest are left out
    once none promises much. ``others`` are arms that do not take part.
    """
    table = reach(scene, targets, grid)
    choices, common = _choices(scene, targets, grid, table)
    offers = [(found.path.cost, k) for k, c in enumerate(choices) if (found := c.shortest()) is not None]
    if not offers:
        common = max([common, *(c.modulo.furthest() for c in choices)])
        return Blocked(table, min(common, targets.count - 1))
    best: Found | None = None
    failed: Blocked | None = None
    for bound, k in sorted(offers)[:MOST_CHOICES]:
        if best is not None and best.path.cost <= bound * (1.0 + WORTH_IT):
            break
        check = Checker(scene, targets, grid, choices[k].rungs, others)
        found, last = _free_path(choices[k], check)
        if found is not None and (best is None or found.path.cost < best.path.cost):
            best = dataclasses.replace(found, choices=len(offers))
        elif found is None and failed is None:
            failed = Blocked(table, targets.count, check.collided, last)
    return best if best is not None else (failed or Blocked(table, 0))


class Choice:
    """One branch for each arm. Turns are searched only where forgetting them gives a path that cannot be
    lifted."""

    def __init__(
        self,
        scene: Scene,
        grid: Grid,
        rungs: Mapping[str, Rungs],
        modulo: Mapping[str, tuple[Rungs, Steps]],
        extra: FloatArray | None,
    ) -> None:
        self.rungs = rungs
        self._scene, self._grid, self._extra = scene, grid, extra
        self.modulo = Ladder(grid, [r for r, _ in modulo.values()], [m for _, m in modulo.values()], extra)
        self._exact: Ladder | None = None

    def _search_turns(self) -> Ladder:
        moves = [_moves(self._scene, r, self._grid) for r in self.rungs.values()]
        return Ladder(self._grid, tuple(self.rungs.values()), moves, self._extra)

    def shortest(self, blocked: FloatArray | None = None) -> Found | None:
        """The path of least cost, turns and limits included; ``blocked`` (N, S) as in :class:`Ladder`."""
        path = self.modulo.shortest(blocked)
        if path is None:
            return None
        lifted = self._lift(path)
        if lifted is None or lifted.path.cost > path.cost * (1.0 + TOLERATED):
            if self._exact is None:
                self._exact = self._search_turns()
            exact = self._exact.shortest(blocked)
            if exact is None:
                return None
            rows = np.arange(len(exact.sample))
            return Found(exact, self._grid.values[rows, exact.sample], joint_path(exact, self.rungs), 1)
        return lifted

    def _lift(self, path: Path) -> Found | None:
        """The path with the turns that follow from continuity, from the first turn that costs least."""
        rows = np.arange(len(path.sample))
        q, turns, cost = {}, {}, path.cost
        for arm, r in self.rungs.items():
            many = self._scene.chains[arm].many_turns
            angles = r.q[rows, path.sample]
            change = np.where(many, np.round(np.diff(angles, axis=0) / TWO_PI), 0.0)
            whole = np.concatenate([np.zeros((1, 6)), -np.cumsum(change, axis=0)])
            wanted = np.round(r.turns / TWO_PI) + whole[:, None, :]
            same = (wanted[:, :, None, :] == np.round(r.turns / TWO_PI)).all(axis=-1)
            state = np.where(same.any(axis=-1), same.argmax(axis=-1), -1)
            paid = np.where(state >= 0, r.penalty[rows[:, None], path.sample[:, None], state], np.inf).sum(
                axis=0
            )
            start = int(np.argmin(paid))
            if not np.isfinite(paid[start]):
                return None
            cost += float(paid[start] - r.penalty[rows, path.sample].min(axis=-1).sum())
            turns[arm] = state[:, start]
            q[arm] = angles + r.turns[turns[arm]]
        values = self._grid.values[rows, path.sample]
        return Found(Path(path.branch, path.sample, turns, cost), values, q, 1)


def _choices(
    scene: Scene, targets: Targets, grid: Grid, table: Mapping[str, Reach]
) -> tuple[list[Choice], int]:
    """Choices of branches with a common sample at every target; the farthest target where others fail."""
    extra = _preference(targets, grid)
    flat = {
        (arm, b): (r.modulo(), _moves(scene, r.modulo(), grid))
        for arm, one in table.items()
        for b, r in one.branches.items()
    }
    out, common = [], 0
    for branches in itertools.product(*(r.branches for r in table.values())):
        rungs = {arm: r.branches[b] for (arm, r), b in zip(table.items(), branches, strict=True)}
        both = np.logical_and.reduce([r.ok.any(axis=-1) for r in rungs.values()]).any(axis=1)
        if both.all():
            modulo = {arm: flat[arm, b] for arm, b in zip(table, branches, strict=True)}
            out.append(Choice(scene, grid, rungs, modulo, extra))
        else:
            common = max(common, int(np.argmin(both)))
    return out, common


def _moves(scene: Scene, rungs: Rungs, grid: Grid) -> Steps:
    return steps(rungs, scene.chains[rungs.arm], grid, speed_limits(scene, rungs.arm))


def speed_limits(scene: Scene, arm: str) -> FloatArray:
    """Joint speed limits (6,) [rad/s] of an arm with the settings' fraction."""
    return np.asarray(scene.chains[arm].robot.velocity * scene.settings.speed_fraction)


def _preference(targets: Targets, grid: Grid) -> FloatArray | None:
    """Cost (N, S) [s] of the distance from preferred values, relative to the width of the range."""
    out: FloatArray | None = None
    for j, freedom in enumerate(targets.freedoms):
        if freedom.prefer is None:
            continue
        away = grid.values[..., j] - freedom.prefer[:, None]
        if full_turn(freedom):
            away = away - TWO_PI * np.round(away / TWO_PI)
        width = np.maximum(freedom.upper - freedom.lower, 1e-12)[:, None]
        part = freedom.weight / targets.count * np.square(2.0 * away / width)
        out = part if out is None else out + part
    return out


def _free_path(choice: Choice, check: Checker) -> tuple[Found | None, Found | None]:
    """Shortest path, check it, block what collides, again. The free path if there is one, and the last one
    tried."""
    found, last = choice.shortest(), None
    suspect: FloatArray | None = None
    for count in range(ROUNDS):
        if found is None:
            return None, last
        rows = np.arange(len(found.path.sample))
        check.check(rows, found.path.sample)
        last = dataclasses.replace(found, checks=check.checks, rounds=count + 1)
        if not check.collided[rows, found.path.sample].any():
            return last, last
        if suspect is None:
            suspect = check.coarse()
        found = choice.shortest(np.where(check.collided, np.inf, suspect))
    return None, last
