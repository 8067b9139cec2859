"""Remedies: changes of the cell or settings that were tried and open a path.

An obstacle, the stock or a base is moved, an arm gets another home posture, or a clearance is lowered. The
smallest change that helps is reported. If none helps, that is reported too.
"""

import dataclasses
import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import Final

import numpy as np

from planner.cell import clearance, plant, support
from planner.cell.bodies import shapes_by_body
from planner.geometry.arrays import FloatArray, Shape, hull_points, transform
from planner.geometry.units import DEG, MM
from planner.issues import Issue, Remedy, TandemError, aggregate
from planner.motion import homing, self_clearance, stations
from planner.motion.placement_margin import placement_margin
from planner.motion.planning_scene import Scene
from planner.motion.search.layered_graph_search import PathResult
from planner.motion.search.path_search import count_rotational_freedoms, find_path
from planner.motion.search.reach import SPIN_STEP_RAD, CollisionChecker, compute_reach, sample_freedoms
from planner.motion.search.subsampling import sample_coarsely, select_targets
from planner.problem import Cell, Obstacle, Problem
from planner.targets import Targets

PATH_CODES: Final = frozenset({"no_reach", "joint_limit", "singular", "no_path", "collision", "linear_move"})
"""Issue codes (after ``motion.``) that another path may resolve."""
HOME_CODES: Final = frozenset({"entry", "home"})
"""Issue codes (after ``motion.``) that another home posture may resolve."""

MOVE_SIZES_M: Final = (0.02, 0.05, 0.1, 0.2, 0.3, 0.5)
"""Sizes [m] of the moves that are tried, smallest first."""

HOME_ROTATIONS_DEG: Final = (30.0, 60.0, 90.0, 120.0)
"""Rotations [deg] of axis 1 at home that are tried. For axis 2 only the first one, backwards."""

MAX_TRIALS: Final = 150
"""Maximum number of changes that are checked."""
MAX_SEARCHES: Final = 8
"""Maximum number of changes for which a path is searched."""
MAX_PLANS: Final = 3
"""Maximum number of changes that are planned completely."""
MAX_ROTATIONAL_SEARCHES: Final = 4
"""Maximum number of path searches for jobs with several rotational freedoms, whose searches take several
times as long.
"""

MAX_REMOVED_OBSTACLES: Final = 4
"""Maximum number of obstacles whose removal is tried, one by one, starting with those that the issue
names.
"""
MAX_MOVABLE_SIDE_M: Final = 1.5
"""Side length [m]. An obstacle with two longer sides is a floor or a wall, which cannot be moved."""

MAX_SUPPORT_GAP_M: Final = 0.005
"""Maximum gap [m] between bodies that rest on each other."""

BASE_KEEPOUT_M: Final = 0.1
"""Distance [m] from a base that obstacles keep when they are moved."""

NEIGHBOUR_TARGETS: Final = 2
"""Number of targets before and after the failing one at which a change is tried."""
SPREAD_TARGETS: Final = 12
"""Number of further targets, spread over the whole job, at which a change is tried."""
SLIDE_SAMPLES: Final = 3
"""Number of samples of a sliding freedom at these targets."""

GRID_STEP_M: Final = 0.05
"""Base step [m] of the grid on which a stock that is out of reach is moved."""
MAX_GRID_STEPS: Final = 32
"""Approximate maximum number of grid steps along x and y. Larger ranges use multiples of the base step."""
GRID_LEVELS_M: Final = (-0.6, -0.4, -0.2, 0.2, 0.4, 0.6)
"""Vertical moves [m] of a stock that rests on nothing."""
GRID_TARGETS: Final = 3
"""Number of targets at which all grid points are tried first. Those that pass are tried at
:data:`SPREAD_TARGETS` targets.
"""
POSE_BATCH_SIZE: Final = 64
"""Number of stock poses whose reach is computed together."""
MIN_SCORE_FRACTION: Final = 0.6
"""Minimum margin of a grid point, as a fraction of the best one, for which a path is searched there."""
MAX_GRID_TRIALS: Final = 5
"""Maximum number of grid points for which a path is searched."""
MIN_TRIAL_DISTANCE_M: Final = 0.2
"""Minimum distance [m] between grid points for which a path is searched."""

CLEARANCE_STEP_MM: Final = 0.5
"""Increment [mm] of the clearances that are tried."""
MAX_CLEARANCES: Final = 5
"""Maximum number of clearances that are tried."""

HasPlan = Callable[[Problem], bool]


def suggest_remedies(
    problem: Problem, targets: Sequence[Targets], operation: int, issues: Sequence[Issue], has_plan: HasPlan
) -> list[Issue]:
    """Try changes and add what was tried, and what helps, to the issues.

    Args:
        problem: Problem without a plan.
        targets: Targets of all operations.
        operation: Index of the operation that has no path.
        issues: Issues of this operation.
        has_plan: Returns whether a changed problem has a complete plan.

    Returns:
        The issues. The first one that a change may resolve has another hint, and the remedy if one helps. The
        issues are unchanged if there is none, or if the planner chooses a stock pose.
    """
    first_index = next(
        (k for k, i in enumerate(issues) if i.code.removeprefix("motion.") in PATH_CODES | HOME_CODES), None
    )
    if first_index is None or any(setup.stock.place is None for setup in problem.setups):
        return list(issues)
    first = issues[first_index]
    search = _RemedySearch(problem, targets[operation], operation, first.index or 0, has_plan)
    code = first.code.removeprefix("motion.")
    remedy = search.find_home(first) if code in HOME_CODES else search.find_move(first)
    if remedy is None:
        hint = f"{first.hint}; tried without success: {search.summary()}" if search.tried else None
        # A station of a track or gantry that reaches the job comes before all else.
        station_advice = stations.suggest_axis(problem, targets) if code in PATH_CODES else ""
        hint = f"{station_advice}; or {hint or first.hint}" if station_advice else hint
        advised_issue = dataclasses.replace(first, hint=hint or first.hint)
    else:
        advised_issue = dataclasses.replace(
            first, hint=f"{_describe_remedy(remedy)} (tried: the job can be planned then)", remedy=remedy
        )
    clearance_remedy = None
    if code == "collision":  # with a budget of its own, whatever was tried before
        clearance_search = _RemedySearch(problem, targets[operation], operation, first.index or 0, has_plan)
        clearance_remedy = clearance_search.find_clearance(first)
    if clearance_remedy is not None:
        joint_hint = f"{advised_issue.hint}; or {_describe_remedy(clearance_remedy)}"
        advised_issue = dataclasses.replace(
            advised_issue, hint=joint_hint, remedy=advised_issue.remedy or clearance_remedy
        )
    out = [advised_issue if k == first_index else issue for k, issue in enumerate(issues)]
    aggregated = [
        k for k, issue in enumerate(out) if k != first_index and len(aggregate([advised_issue, issue])) == 1
    ]
    for k in aggregated:  # issues that are aggregated show the hint of the worst, so all get it
        out[k] = dataclasses.replace(out[k], hint=advised_issue.hint, remedy=advised_issue.remedy)
    return out


def apply_remedy(problem: Problem, remedy: Remedy) -> Problem:
    """Return a copy of the problem with the change of a remedy applied.

    The change is a move of the stock, of an obstacle or of a base, another home posture, or other clearances.
    """
    cell, stock = problem.cell, problem.stock
    shift = MM * np.array(remedy.move_mm or (0.0, 0.0, 0.0))
    if remedy.what == "stock" and stock.place is not None:
        stock_pose = stock.place.copy()
        stock_pose[:3, 3] += shift
        return dataclasses.replace(problem, stock=dataclasses.replace(stock, place=stock_pose))
    if remedy.what == "clearance":
        settings = problem.settings
        if remedy.clearance_mm is not None:
            settings = dataclasses.replace(settings, clearance=MM * remedy.clearance_mm)
        if remedy.own_clearance_mm is not None:
            settings = dataclasses.replace(settings, own_clearance=MM * remedy.own_clearance_mm)
        return dataclasses.replace(problem, settings=settings)
    if remedy.what == "obstacle":
        moved = (_move_obstacle(o, shift) if o.name == remedy.name else o for o in cell.obstacles)
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


def _describe_remedy(remedy: Remedy) -> str:
    """Return the instruction for a hint, such as "move the stock by (100, 0, 0) mm"."""
    if remedy.what == "clearance":
        stated = (
            (self_clearance.CLEARANCE_FIELD, remedy.clearance_mm),
            (self_clearance.SELF_CLEARANCE_FIELD, remedy.own_clearance_mm),
        )
        fields = " and ".join(f"{name}: {value:g}" for name, value in stated if value is not None)
        return f"set {fields}, the largest tried value that works"
    if remedy.home_deg is not None:
        return f"set home_deg [{', '.join(f'{a:.4g}' for a in remedy.home_deg)}] for arm {remedy.name}"
    move = remedy.move_mm or (0.0, 0.0, 0.0)
    if remedy.what == "stock":
        return f"move the {remedy.name} by ({', '.join(f'{v:.0f}' for v in move)}) mm"
    axis = int(np.argmax(np.abs(move)))
    direction = f"{move[axis]:+.0f} mm in {'xyz'[axis]}"
    subject = f"the base of arm {remedy.name}" if remedy.what == "base" else remedy.name
    return f"move {subject} by {direction}"


class _RemedySearch:
    """Tries changes for one operation that has no path, within a budget of trials, searches and plans.

    Attributes:
        tried: {what was changed: largest tried move [m], or 0 if it was not moved}.
        removed: Obstacles whose removal opens no path.
    """

    def __init__(self, problem: Problem, job: Targets, operation: int, index: int, has_plan: HasPlan) -> None:
        """Prepare the search.

        Args:
            problem: Problem without a plan.
            job: Targets of the operation.
            operation: Index of the operation.
            index: Index of the target at which its paths end.
            has_plan: Returns whether a changed problem has a complete plan.
        """
        self._problem, self._job, self._operation, self._has_plan = problem, job, operation, has_plan
        # targets at which changes are tried first: the failing one, its neighbours, then others over the job
        around = np.arange(index - NEIGHBOUR_TARGETS, index + NEIGHBOUR_TARGETS + 1)
        spread = np.linspace(0, job.count - 1, SPREAD_TARGETS).round().astype(np.intp)
        rows = np.concatenate([[index], around, spread])
        rows = rows[(rows >= 0) & (rows < job.count)]
        # without repetitions, in this order
        self._rows = rows[np.sort(np.unique(rows, return_index=True)[1])]
        self._initial_overlaps = self._fixture_overlaps(problem)
        self._initial_support_issues = len(support.support_issues(problem))
        searches = MAX_SEARCHES if count_rotational_freedoms(job) <= 1 else MAX_ROTATIONAL_SEARCHES
        self._trials_left, self._searches_left, self._plans_left = MAX_TRIALS, searches, MAX_PLANS
        self.tried: dict[str, float] = {}
        self.removed: list[str] = []

    def summary(self) -> str:
        """Describe for a hint what was tried without success."""
        out = [f"{', '.join(self.removed)} removed one by one"] if self.removed else []
        out += [
            f"{name} moved by up to {size / MM:.0f} mm" if size > 0.0 else name
            for name, size in self.tried.items()
        ]
        out += [] if self._has_budget else ["the limit of trials was reached"]
        return "; ".join(out)

    @property
    def _has_budget(self) -> bool:
        return min(self._trials_left, self._searches_left, self._plans_left) > 0

    def find_move(self, issue: Issue) -> Remedy | None:
        """Find the smallest move of an obstacle, the stock or a base that makes the whole job plannable.

        Only obstacles whose removal opens a path are moved. If the job is out of reach, moves that are too
        small to bring it into reach are skipped, and larger moves of the stock are tried at the end.
        """
        min_size = (issue.value or 0.0) * MM if issue.code == "motion.no_reach" else 0.0
        obstacles = self._blocking_obstacles(issue) if min_size < MOVE_SIZES_M[-1] else []
        for size in MOVE_SIZES_M:
            if size < min_size:  # too small to bring the wrist within reach
                continue
            for remedy in self._candidate_moves(size, obstacles):
                if not self._has_budget:
                    return None
                self.tried[_subject(remedy)] = size
                if self._opens_path(apply_remedy(self._problem, remedy), remedy):
                    self._plans_left -= 1
                    if self._has_plan(apply_remedy(self._problem, remedy)):
                        return remedy
        return self._find_far_move() if min_size > 0.0 else None

    def _find_far_move(self) -> Remedy | None:
        """Find a move of the stock, of any size, to where the arms reach the job.

        The stock poses of :meth:`_moves_into_reach` are tried, nearest first. Poses close to one that failed
        are skipped.
        """
        name = self._stock_name
        tried: list[FloatArray] = []
        if not self._is_stock_movable:
            return None
        for move in self._moves_into_reach():
            if len(tried) >= MAX_GRID_TRIALS or not self._has_budget:
                break
            if any(np.linalg.norm(move - tried_move) < MIN_TRIAL_DISTANCE_M for tried_move in tried):
                continue
            tried.append(move)
            self.tried[f"the {name}"] = max(float(np.linalg.norm(tried_move)) for tried_move in tried)
            x, y, z = (move / MM).round().tolist()
            remedy = Remedy("stock", name, (x, y, z))
            changed = apply_remedy(self._problem, remedy)
            if self._opens_path(changed, remedy):
                self._plans_left -= 1
                if self._has_plan(changed):
                    return remedy
        return None

    def _moves_into_reach(self) -> FloatArray:
        """Return moves (K, 3) [m] of the stock after which the arms reach a few targets, shortest first.

        The moves lead to a grid around the bases. Those with at least :data:`MIN_SCORE_FRACTION` of the best
        margin are returned. The height changes only if the stock rests on nothing and the arms reach the
        targets from no pose at the same height.
        """
        problem = self._problem
        setup, scene = problem.setup_of(self._operation), self._make_scene(problem)
        stock_pose = setup.stock.place if setup.stock.place is not None else np.eye(4)
        chains = [scene.chains[arm] for arm in self._job.arms]
        reach = max(c.robot.form.stretched for c in chains)
        base_positions = np.array([c.base[:2, 3] for c in chains])
        low, high = base_positions.min(axis=0) - reach, base_positions.max(axis=0) + reach
        step = GRID_STEP_M * max(1.0, float(np.ceil((high - low).max() / GRID_STEP_M / MAX_GRID_STEPS)))
        x, y = (
            np.arange(np.floor((low[k] - stock_pose[k, 3]) / step), (high[k] - stock_pose[k, 3]) / step)
            for k in (0, 1)
        )
        rests_on_something = bool(setup.stock.support) or _rests_on_obstacle(
            _stock_box(problem), problem.cell, ""
        )
        for levels in ((0.0,), () if rests_on_something else GRID_LEVELS_M):
            moves = np.stack(np.meshgrid(x * step, y * step, np.array(levels), indexing="ij"), axis=-1)
            moves, score = moves.reshape(-1, 3), np.zeros(0)
            for count in (GRID_TARGETS, SPREAD_TARGETS):  # all moves at a few targets, then those that pass
                sampled = sample_coarsely(
                    setup.cell, self._job, count, with_slides=count_rotational_freedoms(self._job) > 1
                )
                stock_poses = np.repeat(stock_pose[None, None], len(moves), axis=0)
                stock_poses[:, 0, :3, 3] += moves
                # -(-a // b) is a / b rounded up: batches of at most POSE_BATCH_SIZE poses
                parts = (
                    np.array_split(stock_poses, -(-len(stock_poses) // POSE_BATCH_SIZE))
                    if len(stock_poses)
                    else []
                )
                scores = [placement_margin(sampled, part, {}, scene.settings) for part in parts]
                score = np.concatenate([np.zeros(0), *scores])
                moves, score = moves[score > 0.0], score[score > 0.0]
            if len(moves):
                good = moves[score >= MIN_SCORE_FRACTION * score.max()]
                return np.asarray(good[np.argsort(np.linalg.norm(good, axis=1), kind="stable")])
        return np.zeros((0, 3))

    def find_clearance(self, issue: Issue) -> Remedy | None:
        """Find the widest clearance with which the whole job can be planned.

        The first trial is the clearance of the best posture where paths end, then one step less. If that is
        too much elsewhere, the interval is bisected, up to :data:`MAX_CLEARANCES` trials. Only the setting
        that applies to the colliding bodies changes. Controllers with spline blocks are excluded: their
        curves need extra margin, which is part of the clearance here.
        """
        same_arm = len(issue.bodies) == 2 and self_clearance.is_same_arm(*issue.bodies)
        settings = self._problem.settings
        required = (settings.self_clearance if same_arm else settings.clearance) / MM
        # the best posture may be close to other bodies than those that collide most often
        best_possible = required - ((issue.limit or 0.0) - (issue.value or 0.0))
        if not 0.0 < best_possible < required or self._problem.cell.controller.path == "spline":
            return None
        # in steps of the clearance: low can be planned (or is 0), high cannot
        low, high = 0, int(best_possible / CLEARANCE_STEP_MM) + 1
        widest = None
        for number in range(MAX_CLEARANCES):
            value = high - 1 if number < 2 else (low + high) // 2
            if not low < value < high:
                break
            remedy = self._clearance_remedy(same_arm, value * CLEARANCE_STEP_MM)
            changed = apply_remedy(self._problem, remedy)
            if self._opens_path(changed, remedy) and self._has_plan(changed):
                low, widest = value, remedy
            else:
                high = value
        return widest

    def _clearance_remedy(self, same_arm: bool, value: float) -> Remedy:
        """Return the remedy that sets the clearance of one arm, or of all other bodies, to a value [mm].

        A stated clearance of one arm is lowered with the other one, so that it is not wider.
        """
        if same_arm:
            return Remedy("clearance", self_clearance.SELF_CLEARANCE_FIELD, own_clearance_mm=value)
        stated = self._problem.settings.own_clearance
        is_wider = stated is not None and stated / MM > value
        return Remedy(
            "clearance",
            self_clearance.CLEARANCE_FIELD,
            clearance_mm=value,
            own_clearance_mm=value if is_wider else None,
        )

    @property
    def _is_stock_movable(self) -> bool:
        """Whether there is one stated stock pose to which all work is fixed."""
        stock = self._problem.setup_of(self._operation).stock
        is_changed = any("place" in change.stock for change in self._problem.changes.values())
        all_on_stock = all(self._job.frame.get(arm, "stock") == "stock" for arm in self._job.arms)
        return all_on_stock and not is_changed and stock.held_by is None and stock.place is not None

    @property
    def _stock_name(self) -> str:
        return "stock" if self._problem.stock.sheet is None else "sheet"

    def find_home(self, issue: Issue) -> Remedy | None:
        """Find another home posture of one arm from which the arms reach the job and return.

        Axis 1 is rotated by :data:`HOME_ROTATIONS_DEG` to both sides, and axis 2 backwards by the first of
        these angles.
        """
        setup, initial_scene = self._problem.setup_of(self._operation), self._make_scene(self._problem)
        _, path_result = find_path(initial_scene, self._job)
        names = [a for a in self._job.arms if issue.arm in (None, a)]  # the arm of the issue, or all
        rotations = [(0, sign * angle) for angle in HOME_ROTATIONS_DEG for sign in (1, -1)]
        rotations += [(1, -HOME_ROTATIONS_DEG[0])]
        for (joint, angle_deg), name in itertools.product(rotations, names):
            arm = setup.cell.arm(name)
            home = arm.home.copy()
            home[joint] += DEG * angle_deg
            self.tried["other home postures"] = 0.0
            margin = float(initial_scene.chains[name].limit_margin(home))
            if self._plans_left <= 0 or margin < self._problem.settings.joint_margin:
                continue
            remedy = Remedy("home", name, home_deg=tuple((home / DEG).round(6).tolist()))
            changed = apply_remedy(self._problem, remedy)
            scene = self._make_scene(changed)
            try:
                homing.require_free_home(scene, self._job)
                if isinstance(path_result, PathResult):
                    homing.plan_approach_and_retreat(scene, self._job, path_result.q)
            except TandemError:
                continue
            self._plans_left -= 1
            if self._has_plan(changed):
                return remedy
        return None

    def _blocking_obstacles(self, issue: Issue) -> list[Obstacle]:
        """Return the obstacles without which there is a path.

        At most :data:`MAX_REMOVED_OBSTACLES` movable ones are removed, one by one, first those that the issue
        names. Those whose removal opens no path are added to :attr:`removed`.
        """
        cell = self._problem.setup_of(self._operation).cell
        movable_obstacles = [o for o in cell.obstacles if is_movable(self._problem, o)]
        movable_obstacles.sort(key=lambda o: o.name not in issue.bodies)
        out = []
        for obstacle in movable_obstacles[:MAX_REMOVED_OBSTACLES]:
            remaining = tuple(o for o in self._problem.cell.obstacles if o.name != obstacle.name)
            changed = dataclasses.replace(
                self._problem, cell=dataclasses.replace(self._problem.cell, obstacles=remaining)
            )
            scene = self._make_scene(changed)
            if self._is_passable(changed, scene) and isinstance(self._search_path(scene), PathResult):
                out.append(obstacle)
            else:
                self.removed.append(obstacle.name)
        return out

    def _candidate_moves(self, size: float, obstacles: Sequence[Obstacle]) -> Iterator[Remedy]:
        """Yield moves by ``size`` [m] along the world axes: of the obstacles, the stock, then the bases.

        A body that rests on an obstacle is moved only horizontally, and so is a base.
        """
        problem = self._problem
        for obstacle in obstacles:
            rests_on_other = _rests_on_obstacle(
                _bounding_box(obstacle.shapes, np.eye(4)), problem.cell, obstacle.name
            )
            for move in _axis_moves(size, vertical=not rests_on_other):
                yield Remedy("obstacle", obstacle.name, move)
        if self._is_stock_movable:
            rests_on_obstacle = _rests_on_obstacle(_stock_box(problem), problem.cell, name="")
            for move in _axis_moves(size, vertical=not rests_on_obstacle):
                yield Remedy("stock", self._stock_name, move)
        for arm in self._job.arms:
            for move in _axis_moves(size, vertical=False):
                yield Remedy("base", arm, move)

    def _opens_path(self, changed: Problem, remedy: Remedy) -> bool:
        """Whether the job has a path after a change that causes no new problem.

        The change must not take away a support, make fixtures overlap, or bring home postures too close to
        bodies. The check of the path uses coarse samples only.
        """
        self._trials_left -= 1
        if len(support.support_issues(changed)) > self._initial_support_issues:
            return False  # a body would lose its support
        scene = self._make_scene(changed)
        if not self._fixture_overlaps(changed) <= self._initial_overlaps or _hits_other(changed, remedy):
            return False
        if not self._is_passable(changed, scene):
            return False
        try:
            homing.require_free_home(scene, self._job)
        except TandemError:
            return False
        return isinstance(self._search_path(scene), PathResult)

    def _search_path(self, scene: Scene) -> object:
        """Search a path with coarse samples only, which takes one search of the budget."""
        self._searches_left -= 1
        return find_path(scene, self._job, fine=False)[1]

    def _make_scene(self, problem: Problem) -> Scene:
        """Create the scene of the operation in a changed problem, with a collision model."""
        setup = problem.setup_of(self._operation)
        stock_pose = setup.stock.place if setup.stock.place is not None else np.eye(4)
        model = plant.build_cell_model(setup.cell, setup.stock, stock_pose)
        return Scene.of(setup.cell, self._job.arms, stock_pose, problem.settings, model)

    def _fixture_overlaps(self, problem: Problem) -> frozenset[tuple[str, str]]:
        """Return the pairs of static bodies of the operation's cell that overlap."""
        model = self._make_scene(problem).model
        if model is None:
            return frozenset()
        return frozenset((a, b) for a, b, _ in clearance.find_overlaps(model))

    def _is_passable(self, problem: Problem, scene: Scene) -> bool:
        """Whether some combination of branches has a free sample at each of a few targets.

        These targets include the one where paths end, and its neighbours. Without such a combination a path
        search must fail, so this check saves its time. With several rotational freedoms only reach is
        checked.
        """
        if count_rotational_freedoms(self._job) > 1:
            # There are too many samples to check collisions. Require reach at a few targets only.
            sampled = sample_coarsely(
                problem.setup_of(self._operation).cell, self._job, SPREAD_TARGETS, with_slides=True
            )
            return bool(placement_margin(sampled, scene.stock[None, None], {}, scene.settings)[0] > 0.0)
        sampled_targets = select_targets(self._job, self._rows)
        grid = sample_freedoms(sampled_targets, SPIN_STEP_RAD, SLIDE_SAMPLES)
        table = compute_reach(scene, sampled_targets, grid)
        for branches in itertools.product(*(r.branches for r in table.values())):
            states = {arm: r.branches[b] for (arm, r), b in zip(table.items(), branches, strict=True)}
            checker = CollisionChecker(scene, sampled_targets, grid, states)
            if checker.possible.any(axis=1).all() and all(
                checker.free_samples(i).any() for i in range(sampled_targets.count)
            ):
                return True
        return False


def _subject(remedy: Remedy) -> str:
    """Return what a remedy moves, as named in hints."""
    return {"stock": f"the {remedy.name}", "base": f"the base of {remedy.name}"}.get(remedy.what, remedy.name)


def _axis_moves(size: float, vertical: bool) -> list[tuple[float, float, float]]:
    """Return moves [mm] by ``size`` [m] along world x, y and, if ``vertical``, z, in both directions."""
    out = []
    for axis, sign in itertools.product(range(3 if vertical else 2), (1.0, -1.0)):
        move = [0.0, 0.0, 0.0]
        move[axis] = float(np.round(sign * size / MM, 6))
        out.append((move[0], move[1], move[2]))
    return out


def _move_obstacle(obstacle: Obstacle, shift: FloatArray) -> Obstacle:
    """Return a copy of an obstacle with its shapes translated by ``shift`` (3,) [m] in the world."""
    shapes = []
    for shape in obstacle.shapes:
        pose = shape.pose.copy()
        pose[:3, 3] += shift
        shapes.append(dataclasses.replace(shape, pose=pose))
    return dataclasses.replace(obstacle, shapes=tuple(shapes))


def _bounding_box(shapes: Sequence[Shape], frame: FloatArray) -> FloatArray:
    """Return the lower and the upper corner (2, 3) [m], in the world, of the bounding box of shapes.

    ``frame`` (4, 4) is the frame in which the poses of the shapes are given.
    """
    points = np.concatenate([transform(frame @ shape.pose, hull_points(shape)) for shape in shapes])
    return np.stack([points.min(axis=0), points.max(axis=0)])


def _stock_box(problem: Problem) -> FloatArray:
    """Return the bounding box (2, 3) [m] of the stock and its support in the world."""
    stock_pose = problem.stock.place if problem.stock.place is not None else np.eye(4)
    shapes = shapes_by_body(problem.cell, problem.stock)
    return _bounding_box([*shapes["stock"], *problem.stock.support], stock_pose)


def _rests_on_obstacle(box: FloatArray, cell: Cell, name: str) -> bool:
    """Whether the bounding box (2, 3) of a body rests on an obstacle other than the one called ``name``."""
    others = (_bounding_box(o.shapes, np.eye(4)) for o in cell.obstacles if o.name != name)
    return any(
        _overlap_in_plan(box, other) and abs(box[0, 2] - other[1, 2]) < MAX_SUPPORT_GAP_M for other in others
    )


def _overlap_in_plan(a: FloatArray, b: FloatArray) -> bool:
    """Whether two bounding boxes (2, 3) overlap in plan view."""
    return bool((np.minimum(a[1], b[1])[:2] > np.maximum(a[0], b[0])[:2]).all())


def is_movable(problem: Problem, obstacle: Obstacle) -> bool:
    """Whether an obstacle can be moved.

    It can if it is not a floor or a wall, no base or stock rests on it, and no external axis carries it.
    """
    if any(obstacle.name in bodies for bodies in problem.cell.carried_bodies.values()):
        return False
    box = _bounding_box(obstacle.shapes, np.eye(4))
    if (np.ptp(box, axis=0) > MAX_MOVABLE_SIDE_M).sum() >= 2:
        return False
    stock = _stock_box(problem)
    if _overlap_in_plan(box, stock) and abs(stock[0, 2] - box[1, 2]) < MAX_SUPPORT_GAP_M:
        return False
    bases = np.array([arm.base[:3, 3] for arm in problem.cell.arms])
    inside = ((bases[:, :2] > box[0, :2]) & (bases[:, :2] < box[1, :2])).all(axis=1)
    return not (inside & (bases[:, 2] >= box[1, 2] - MAX_SUPPORT_GAP_M)).any()


def _hits_other(changed: Problem, remedy: Remedy) -> bool:
    """Whether an obstacle was moved into another one or into the foot of an arm.

    Bounding boxes are compared. The result is False for remedies that move no obstacle.
    """
    if remedy.what != "obstacle":
        return False
    boxes = {o.name: _bounding_box(o.shapes, np.eye(4)) for o in changed.cell.obstacles}
    moved_box = boxes.pop(remedy.name)
    base_boxes = [
        np.stack([a.base[:3, 3] - BASE_KEEPOUT_M, a.base[:3, 3] + BASE_KEEPOUT_M]) for a in changed.cell.arms
    ]
    return any(
        bool((np.minimum(moved_box[1], b[1]) > np.maximum(moved_box[0], b[0]) + 1e-6).all())
        for b in [*boxes.values(), *base_boxes]
    )
