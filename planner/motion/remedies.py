"""Changes of a cell that open a path, found by trying them: bodies or a base moved, another home.

An obstacle, the stock or a base is moved, or an arm gets another home posture. The smallest change
that helps is told; where none does, so is that.
"""

import dataclasses
import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import Final

import numpy as np

from planner.cell import clearance, plant, support
from planner.cell.bodies import own_shapes
from planner.geometry.arrays import FloatArray, Shape, corners, transform
from planner.geometry.units import DEG, MM
from planner.issues import Issue, Remedy, TandemError, aggregate
from planner.motion import own_clearance, stations, ways
from planner.motion.place_margin import margin
from planner.motion.planning_scene import Scene
from planner.motion.search.ladder_search import Found
from planner.motion.search.path_search import find_path, turning
from planner.motion.search.reach import SPIN_STEP, Checker, reach, sample
from planner.motion.search.subsampling import few_of, subset
from planner.problem import Cell, Obstacle, Problem
from planner.targets import Targets

PATH_CODES: Final = frozenset({"no_reach", "joint_limit", "singular", "no_path", "collision", "linear_move"})
"""Words of codes (behind ``motion.``) that another path may mend."""
HOME_CODES: Final = frozenset({"entry", "home"})
"""Words of codes that another home may mend."""

MOVE_SIZES_M: Final = (0.02, 0.05, 0.1, 0.2, 0.3, 0.5)
"""Moves [m] that are tried, smallest first."""

HOME_TURNS_DEG: Final = (30.0, 60.0, 90.0, 120.0)
"""Turns [deg] of axis 1 at home that are tried, and of axis 2 the first, drawn back."""

MOST_TRIALS: Final = 150
"""Changes that are looked at at most."""
MOST_SEARCHES: Final = 8
"""Changes for which a path is searched at most."""
MOST_PLANS: Final = 3
"""Changes that are planned whole at most."""
MOST_TURNING_SEARCHES: Final = 4
"""As `MOST_SEARCHES` for jobs with several freedoms that turn, whose searches take some times as long."""

MOST_REMOVED: Final = 4
"""Obstacles that are tried to be taken out one by one, those in the way first."""
LARGE_SIDE_M: Final = 1.5
"""An obstacle with two sides longer than this [m] is a floor or a wall, which nobody moves."""

STANDING_GAP_M: Final = 0.005
"""Bodies that come as near [m] to each other stand on each other."""

FOOT_RANGE_M: Final = 0.1
"""Obstacles are not moved as near [m] as this to where a base stands."""

NEIGHBOURS: Final = 2
"""Targets on either side of the one that fails at which a change is tried."""
SPREAD_TARGETS: Final = 12
"""Targets over the whole job at which it is tried besides."""
SLIDE_SAMPLES: Final = 3
"""Samples of a slide there."""

FAR_STEP_M: Final = 0.05
"""Moves of a stock that is out of reach are multiples of this [m],"""
FAR_STEPS: Final = 32
"""so that there are about so many along x and y;"""
FAR_LEVELS_M: Final = (-0.6, -0.4, -0.2, 0.2, 0.4, 0.6)
"""a stock that hangs in the air is moved by these [m] too."""
FAR_TARGETS: Final = 3
"""Targets at which all of these places are tried first, those that pass at `SPREAD_TARGETS`."""
PLACES_AT_ONCE: Final = 64
"""Places whose reach is worked out at once."""
FAR_SHARE: Final = 0.6
"""Places with this share of the best margin are tried, nearest first,"""
FAR_TRIED: Final = 5
"""at most so many of them,"""
FAR_APART_M: Final = 0.2
"""so far [m] apart."""

CLEARANCE_STEP_MM: Final = 0.5
"""Clearances that are tried are multiples of this [mm]."""
MOST_CLEARANCES: Final = 5
"""Clearances that are tried at most."""

Plans = Callable[[Problem], bool]


def advised(
    problem: Problem, targets: Sequence[Targets], operation: int, issues: Sequence[Issue], plans: Plans
) -> list[Issue]:
    """The issues with what was tried, and what of that helps.

    ``operation`` is the one that has no path, ``targets`` are those of all operations. ``plans`` tells
    whether a changed problem has a whole plan.
    """
    first = next(
        (k for k, i in enumerate(issues) if i.code.removeprefix("motion.") in PATH_CODES | HOME_CODES), None
    )
    if first is None or any(setup.stock.place is None for setup in problem.setups):
        return list(issues)
    trial = _Trial(problem, targets[operation], operation, issues[first].index or 0, plans)
    code = issues[first].code.removeprefix("motion.")
    found = trial.homes(issues[first]) if code in HOME_CODES else trial.moves(issues[first])
    if found is None:
        hint = f"{issues[first].hint}; tried without success: {trial.summary()}" if trial.tried else None
        rail = stations.advice(problem, targets) if code in PATH_CODES else ""
        hint = f"{rail}; or {hint or issues[first].hint}" if rail else hint
        told = dataclasses.replace(issues[first], hint=hint or issues[first].hint)
    else:
        told = dataclasses.replace(
            issues[first], hint=f"{_sentence(found)} (tried: it opens the way)", remedy=found
        )
    widest = None
    if code == "collision":  # with work of its own, whatever was tried before
        room = _Trial(problem, targets[operation], operation, issues[first].index or 0, plans)
        widest = room.clearances(issues[first])
    if widest is not None:
        also = f"{told.hint}; or {_sentence(widest)}"
        told = dataclasses.replace(told, hint=also, remedy=told.remedy or widest)
    out = [told if k == first else issue for k, issue in enumerate(issues)]
    alike = [k for k, issue in enumerate(out) if k != first and len(aggregate([told, issue])) == 1]
    for k in alike:  # of those that are told as one, the worst speaks for all
        out[k] = dataclasses.replace(out[k], hint=told.hint, remedy=told.remedy)
    return out


def applied(problem: Problem, remedy: Remedy) -> Problem:
    """The problem with the change made."""
    cell, stock = problem.cell, problem.stock
    shift = MM * np.array(remedy.move_mm or (0.0, 0.0, 0.0))
    if remedy.what == "stock" and stock.place is not None:
        place = stock.place.copy()
        place[:3, 3] += shift
        return dataclasses.replace(problem, stock=dataclasses.replace(stock, place=place))
    if remedy.what == "clearance":
        settings = problem.settings
        if remedy.clearance_mm is not None:
            settings = dataclasses.replace(settings, clearance=MM * remedy.clearance_mm)
        if remedy.own_clearance_mm is not None:
            settings = dataclasses.replace(settings, own_clearance=MM * remedy.own_clearance_mm)
        return dataclasses.replace(problem, settings=settings)
    if remedy.what == "obstacle":
        moved = (_moved(o, shift) if o.name == remedy.name else o for o in cell.obstacles)
        return dataclasses.replace(problem, cell=dataclasses.replace(cell, obstacles=tuple(moved)))
    arms = []
    for arm in cell.arms:
        base, home = arm.base.copy(), arm.home
        if arm.name == remedy.name and remedy.what == "base":
            base[:3, 3] += shift
        if arm.name == remedy.name and remedy.home_deg is not None:
            home = DEG * np.array(remedy.home_deg)
        arms.append(dataclasses.replace(arm, base=base, home=home))
    return dataclasses.replace(problem, cell=dataclasses.replace(cell, arms=tuple(arms)))


def _sentence(remedy: Remedy) -> str:
    if remedy.what == "clearance":
        stated = (
            (own_clearance.FIELD, remedy.clearance_mm),
            (own_clearance.OWN_FIELD, remedy.own_clearance_mm),
        )
        fields = " and ".join(f"{name}: {value:g}" for name, value in stated if value is not None)
        return f"take {fields}, the widest that works of those tried"
    if remedy.home_deg is not None:
        return f"take home_deg [{', '.join(f'{a:.4g}' for a in remedy.home_deg)}] for arm {remedy.name}"
    move = remedy.move_mm or (0.0, 0.0, 0.0)
    if remedy.what == "stock":
        return f"move the {remedy.name} by ({', '.join(f'{v:.0f}' for v in move)}) mm"
    axis = int(np.argmax(np.abs(move)))
    way = f"{move[axis]:+.0f} mm in {'xyz'[axis]}"
    thing = f"the base of arm {remedy.name}" if remedy.what == "base" else remedy.name
    return f"move {thing} by {way}"


class _Trial:
    """Tries changes for one operation that has no path; ``index`` is the target where its paths end."""

    def __init__(self, problem: Problem, job: Targets, operation: int, index: int, plans: Plans) -> None:
        self._problem, self._job, self._operation, self._plans = problem, job, operation, plans
        around = np.arange(index - NEIGHBOURS, index + NEIGHBOURS + 1)
        spread = np.linspace(0, job.count - 1, SPREAD_TARGETS).round().astype(np.intp)
        rows = np.concatenate([[index], around, spread])
        rows = rows[(rows >= 0) & (rows < job.count)]
        self._rows = rows[np.sort(np.unique(rows, return_index=True)[1])]
        self._overlaps, self._unborne = self._fixed(problem), len(support.issues(problem))
        searches = MOST_SEARCHES if turning(job) <= 1 else MOST_TURNING_SEARCHES
        self._looks, self._searches, self._whole = MOST_TRIALS, searches, MOST_PLANS
        self.tried: dict[str, float] = {}
        self.removed: list[str] = []

    def summary(self) -> str:
        """What was tried, for people."""
        out = [f"{', '.join(self.removed)} taken away one by one"] if self.removed else []
        out += [
            f"{name} moved by up to {size / MM:.0f} mm" if size > 0.0 else name
            for name, size in self.tried.items()
        ]
        out += [] if self._left else ["no more was tried"]
        return "; ".join(out)

    @property
    def _left(self) -> bool:
        return min(self._looks, self._searches, self._whole) > 0

    def moves(self, issue: Issue) -> Remedy | None:
        """The smallest move of an obstacle, the stock or a base after which the whole job is planned."""
        least = (issue.value or 0.0) * MM if issue.code == "motion.no_reach" else 0.0
        obstacles = self._obstacles(issue) if least < MOVE_SIZES_M[-1] else []
        for size in MOVE_SIZES_M:
            if size < least:  # the wrist stays out of reach by the rest
                continue
            for remedy in self._candidates(size, obstacles):
                if not self._left:
                    return None
                self.tried[_thing(remedy)] = size
                if self._opens(applied(self._problem, remedy), remedy):
                    self._whole -= 1
                    if self._plans(applied(self._problem, remedy)):
                        return remedy
        return self._far() if least > 0.0 else None

    def _far(self) -> Remedy | None:
        """A move of the stock to where the arms reach the job, however far that is: of a grid of places round
        the bases those with most of the best margin, nearest first, and not close to one that did not do."""
        name, tried = self._stock_name, list[FloatArray]()
        if not self._stock_moves:
            return None
        for move in self._good_places():
            if len(tried) >= FAR_TRIED or not self._left:
                break
            if any(np.linalg.norm(move - other) < FAR_APART_M for other in tried):
                continue
            tried.append(move)
            self.tried[f"the {name}"] = max(float(np.linalg.norm(one)) for one in tried)
            x, y, z = (move / MM).round().tolist()
            remedy = Remedy("stock", name, (x, y, z))
            changed = applied(self._problem, remedy)
            if self._opens(changed, remedy):
                self._whole -= 1
                if self._plans(changed):
                    return remedy
        return None

    def _good_places(self) -> FloatArray:
        """Moves (K, 3) [m] of the stock to places from which the arms reach a few targets well, nearest
        first; in height only where it does not stand on anything and no level one does."""
        problem = self._problem
        setup, scene = problem.setup_of(self._operation), self._scene(problem)
        here = setup.stock.place if setup.stock.place is not None else np.eye(4)
        chains = [scene.chains[arm] for arm in self._job.arms]
        reach = max(c.robot.form.stretched for c in chains)
        feet = np.array([c.base[:2, 3] for c in chains])
        low, high = feet.min(axis=0) - reach, feet.max(axis=0) + reach
        step = FAR_STEP_M * max(1.0, float(np.ceil((high - low).max() / FAR_STEP_M / FAR_STEPS)))
        x, y = (
            np.arange(np.floor((low[k] - here[k, 3]) / step), (high[k] - here[k, 3]) / step) for k in (0, 1)
        )
        stands = bool(setup.stock.support) or _stands(_stock_box(problem), problem.cell, "")
        for levels in ((0.0,), () if stands else FAR_LEVELS_M):
            moves = np.stack(np.meshgrid(x * step, y * step, np.array(levels), indexing="ij"), axis=-1)
            moves, score = moves.reshape(-1, 3), np.zeros(0)
            for count in (FAR_TARGETS, SPREAD_TARGETS):
                few = few_of(setup.cell, self._job, count, shifted=turning(self._job) > 1)
                places = np.repeat(here[None, None], len(moves), axis=0)
                places[:, 0, :3, 3] += moves
                parts = np.array_split(places, -(-len(places) // PLACES_AT_ONCE)) if len(places) else []
                got = [margin(few, part, {}, scene.settings) for part in parts]
                score = np.concatenate([np.zeros(0), *got])
                moves, score = moves[score > 0.0], score[score > 0.0]
            if len(moves):
                good = moves[score >= FAR_SHARE * score.max()]
                return np.asarray(good[np.argsort(np.linalg.norm(good, axis=1), kind="stable")])
        return np.zeros((0, 3))

    def clearances(self, issue: Issue) -> Remedy | None:
        """The widest clearance with which the whole job is planned: what the best posture leaves where paths
        end, or a step less, or where that is too much elsewhere, halved between until work runs out.

        The one of the two settings that holds for the bodies in the way. Not where curves of spline blocks
        need room besides, which the clearance here has in it.
        """
        own = len(issue.bodies) == 2 and own_clearance.is_own(*issue.bodies)
        settings = self._problem.settings
        wanted = (settings.of_one_arm if own else settings.clearance) / MM
        # the best posture may be near to other bodies than those that are in the way most often
        best = wanted - ((issue.limit or 0.0) - (issue.value or 0.0))
        if not 0.0 < best < wanted or self._problem.cell.controller.path == "spline":
            return None
        low, high, found = 0, int(best / CLEARANCE_STEP_MM) + 1, None
        for number in range(MOST_CLEARANCES):
            value = high - 1 if number < 2 else (low + high) // 2
            if not low < value < high:
                break
            remedy = self._of_clearance(own, value * CLEARANCE_STEP_MM)
            changed = applied(self._problem, remedy)
            if self._opens(changed, remedy) and self._plans(changed):
                low, found = value, remedy
            else:
                high = value
        return found

    def _of_clearance(self, own: bool, value: float) -> Remedy:
        """One clearance [mm] changed, the other with it where it is stated and would be wider than all."""
        if own:
            return Remedy("clearance", own_clearance.OWN_FIELD, own_clearance_mm=value)
        stated = self._problem.settings.own_clearance
        wide = stated is not None and stated / MM > value
        return Remedy(
            "clearance", own_clearance.FIELD, clearance_mm=value, own_clearance_mm=value if wide else None
        )

    @property
    def _stock_moves(self) -> bool:
        """Whether one place of the stock is stated that all work is fixed to."""
        stock = self._problem.setup_of(self._operation).stock
        moved = any("place" in change.stock for change in self._problem.changes.values())
        here = all(self._job.frame.get(arm, "stock") == "stock" for arm in self._job.arms)
        return here and not moved and stock.held_by is None and stock.place is not None

    @property
    def _stock_name(self) -> str:
        return "stock" if self._problem.stock.sheet is None else "sheet"

    def homes(self, issue: Issue) -> Remedy | None:
        """Another posture at home from which the arms come to the job and back."""
        setup, before = self._problem.setup_of(self._operation), self._scene(self._problem)
        _, found = find_path(before, self._job)
        names = [a for a in self._job.arms if issue.arm in (None, a)]
        for turn, name in itertools.product(
            [(0, s * t) for t in HOME_TURNS_DEG for s in (1, -1)] + [(1, -HOME_TURNS_DEG[0])], names
        ):
            arm = setup.cell.arm(name)
            home = arm.home.copy()
            home[turn[0]] += DEG * turn[1]
            self.tried["other home postures"] = 0.0
            margin = float(before.chains[name].limit_margin(home))
            if self._whole <= 0 or margin < self._problem.settings.joint_margin:
                continue
            remedy = Remedy("home", name, home_deg=tuple((home / DEG).round(6).tolist()))
            changed = applied(self._problem, remedy)
            scene = self._scene(changed)
            try:
                ways.require_home(scene, self._job)
                if isinstance(found, Found):
                    ways.both_ways(scene, self._job, found.q)
            except TandemError:
                continue
            self._whole -= 1
            if self._plans(changed):
                return remedy
        return None

    def _obstacles(self, issue: Issue) -> list[Obstacle]:
        """Obstacles without which there is a path; those that the issue names are looked at first."""
        cell = self._problem.setup_of(self._operation).cell
        loose = [o for o in cell.obstacles if movable(self._problem, o)]
        loose.sort(key=lambda o: o.name not in issue.bodies)
        out = []
        for one in loose[:MOST_REMOVED]:
            rest = tuple(o for o in self._problem.cell.obstacles if o.name != one.name)
            without = dataclasses.replace(
                self._problem, cell=dataclasses.replace(self._problem.cell, obstacles=rest)
            )
            if self._may_pass(without, scene := self._scene(without)) and isinstance(
                self._find(scene), Found
            ):
                out.append(one)
            else:
                self.removed.append(one.name)
        return out

    def _candidates(self, size: float, obstacles: Sequence[Obstacle]) -> Iterator[Remedy]:
        problem = self._problem
        for obstacle in obstacles:
            for way in _ways(
                size, not _stands(_box(obstacle.shapes, np.eye(4)), problem.cell, obstacle.name)
            ):
                yield Remedy("obstacle", obstacle.name, way)
        if self._stock_moves:
            stands = _stands(_stock_box(problem), problem.cell, "")
            for way in _ways(size, not stands):
                yield Remedy("stock", self._stock_name, way)
        for arm in self._job.arms:
            for way in _ways(size, False):
                yield Remedy("base", arm, way)

    def _opens(self, changed: Problem, remedy: Remedy) -> bool:
        """Whether nothing that stands overlaps after a change, the homes are free and the job has a path."""
        self._looks -= 1
        if len(support.issues(changed)) > self._unborne:  # it would no longer stand on anything
            return False
        scene = self._scene(changed)
        if not self._fixed(changed) <= self._overlaps or _into_others(changed, remedy):
            return False
        if not self._may_pass(changed, scene):
            return False
        try:
            ways.require_home(scene, self._job)
        except TandemError:
            return False
        return isinstance(self._find(scene), Found)

    def _find(self, scene: Scene) -> object:
        self._searches -= 1
        return find_path(scene, self._job, fine=False)[1]

    def _scene(self, problem: Problem) -> Scene:
        setup = problem.setup_of(self._operation)
        place = setup.stock.place if setup.stock.place is not None else np.eye(4)
        model = plant.build(setup.cell, setup.stock, place)
        return Scene.of(setup.cell, self._job.arms, place, problem.settings, model)

    def _fixed(self, problem: Problem) -> frozenset[tuple[str, str]]:
        """Pairs of standing bodies that overlap."""
        model = self._scene(problem).model
        return (
            frozenset((a, b) for a, b, _ in clearance.overlaps(model)) if model is not None else frozenset()
        )

    def _may_pass(self, problem: Problem, scene: Scene) -> bool:
        """Whether some choice of branches has a free sample at each of a few targets, among them those where
        paths end: without that a search is no use."""
        if turning(self._job) > 1:  # too many samples: at least the arms must reach a few targets
            few = few_of(problem.setup_of(self._operation).cell, self._job, SPREAD_TARGETS, shifted=True)
            return bool(margin(few, scene.stock[None, None], {}, scene.settings)[0] > 0.0)
        some = subset(self._job, self._rows)
        grid = sample(some, SPIN_STEP, SLIDE_SAMPLES)
        table = reach(scene, some, grid)
        for branches in itertools.product(*(r.branches for r in table.values())):
            rungs = {arm: r.branches[b] for (arm, r), b in zip(table.items(), branches, strict=True)}
            check = Checker(scene, some, grid, rungs)
            if check.possible.any(axis=1).all() and all(check.free(i).any() for i in range(some.count)):
                return True
        return False


def _thing(remedy: Remedy) -> str:
    return {"stock": f"the {remedy.name}", "base": f"the base of {remedy.name}"}.get(remedy.what, remedy.name)


def _ways(size: float, up: bool) -> list[tuple[float, float, float]]:
    """Moves [mm] by ``size`` [m] along the world's axes, upright ones too if ``up``."""
    out = []
    for axis, sign in itertools.product(range(3 if up else 2), (1.0, -1.0)):
        way = [0.0, 0.0, 0.0]
        way[axis] = float(np.round(sign * size / MM, 6))
        out.append((way[0], way[1], way[2]))
    return out


def _moved(obstacle: Obstacle, shift: FloatArray) -> Obstacle:
    shapes = []
    for shape in obstacle.shapes:
        pose = shape.pose.copy()
        pose[:3, 3] += shift
        shapes.append(dataclasses.replace(shape, pose=pose))
    return dataclasses.replace(obstacle, shapes=tuple(shapes))


def _box(shapes: Sequence[Shape], frame: FloatArray) -> FloatArray:
    """Lowest and highest corner (2, 3) [m] of shapes in a frame (4, 4) of the world."""
    points = np.concatenate([transform(frame @ shape.pose, corners(shape)) for shape in shapes])
    return np.stack([points.min(axis=0), points.max(axis=0)])


def _stock_box(problem: Problem) -> FloatArray:
    place = problem.stock.place if problem.stock.place is not None else np.eye(4)
    own = own_shapes(problem.cell, problem.stock)
    return _box([*own["stock"], *problem.stock.support], place)


def _stands(box: FloatArray, cell: Cell, name: str) -> bool:
    """Whether a body's box stands on an obstacle other than itself."""
    others = (_box(o.shapes, np.eye(4)) for o in cell.obstacles if o.name != name)
    return any(_over(box, other) and abs(box[0, 2] - other[1, 2]) < STANDING_GAP_M for other in others)


def _over(a: FloatArray, b: FloatArray) -> bool:
    """Whether two boxes overlap as seen from above."""
    return bool((np.minimum(a[1], b[1])[:2] > np.maximum(a[0], b[0])[:2]).all())


def movable(problem: Problem, obstacle: Obstacle) -> bool:
    """Whether an obstacle is neither a floor or a wall nor what a base or the stock stands on, nor rides on
    an axis."""
    if any(obstacle.name in bodies for bodies in problem.cell.riders.values()):
        return False
    box = _box(obstacle.shapes, np.eye(4))
    if (np.ptp(box, axis=0) > LARGE_SIDE_M).sum() >= 2:
        return False
    stock = _stock_box(problem)
    if _over(box, stock) and abs(stock[0, 2] - box[1, 2]) < STANDING_GAP_M:
        return False
    bases = np.array([arm.base[:3, 3] for arm in problem.cell.arms])
    inside = ((bases[:, :2] > box[0, :2]) & (bases[:, :2] < box[1, :2])).all(axis=1)
    return not (inside & (bases[:, 2] >= box[1, 2] - STANDING_GAP_M)).any()


def _into_others(changed: Problem, remedy: Remedy) -> bool:
    """Whether an obstacle was moved into another one or into a base's foot."""
    if remedy.what != "obstacle":
        return False
    boxes = {o.name: _box(o.shapes, np.eye(4)) for o in changed.cell.obstacles}
    own = boxes.pop(remedy.name)
    feet = [np.stack([a.base[:3, 3] - FOOT_RANGE_M, a.base[:3, 3] + FOOT_RANGE_M]) for a in changed.cell.arms]
    return any(
        bool((np.minimum(own[1], b[1]) > np.maximum(own[0], b[0]) + 1e-6).all())
        for b in [*boxes.values(), *feet]
    )
