"""Motion planning of a whole problem.

The stock is placed where its pose is not stated, then every operation is planned.

With spline blocks (``controller: {path: spline}``) the plan keeps extra margins. The curve that the
controller follows between two targets is known only within bounds. The proof subtracts these from clearances
and margins.
"""

import dataclasses
import itertools
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

from planner.cell import clearance, external_axis_motion, plant, support
from planner.cell.plant import CellModel
from planner.files import versions
from planner.geometry.arrays import BoolArray, FloatArray, from_parts
from planner.geometry.units import MM, measurement
from planner.issues import Issue, Remedy, TandemError, aggregate
from planner.motion import diagnosis, homing, remedies, sag, stations
from planner.motion.operation import NoCoarsePathError, PathSearchOptions, plan_operation
from planner.motion.placement import PlacementCandidate, PlacementJob, PlacementSearch, PlacementTrace
from planner.motion.planning_scene import Chain, Scene
from planner.motion.quick_check import QuickCheck
from planner.motion.reference_plan import ReferencePlan, incompatible_note, placement_note
from planner.motion.search.layered_graph_search import BlockedSearch, PathResult
from planner.motion.search.path_search import find_path, with_aims
from planner.motion.search.reach import SampleGrid, is_sampled_as_slide
from planner.plans import OperationPlan, Plan
from planner.problem import Cell, Problem, Settings, Setup
from planner.runtime.executor import SERIAL, Executor
from planner.targets import JointFreedom, Targets

SPLINE_EXTRA_CLEARANCE_M: Final = 4e-3
"""Extra clearance [m] for spline blocks."""
SPLINE_EXTRA_MARGIN_RAD: Final = float(np.deg2rad(0.2))
"""Extra margin [rad] to joint limits and singularities for spline blocks."""
SPLINE_SLOWING_FACTOR: Final = 1.15
"""Factor by which tools are slower than allowed with spline blocks, because they may be faster between two
targets.
"""
SPLINE_RAMP_FACTOR: Final = 1.25
"""Additional factor for the first two and the last two moves between stops, because ramps end faster."""


def with_margins(problem: Problem, targets: Sequence[Targets]) -> tuple[Problem, tuple[Targets, ...]]:
    """Add the margins that planning needs, and redundant joints as freedoms.

    The planner and its checks work with the result. The sag compensation and the spline blocks that follow
    then change the motion without violating the margins that the user requires. Problem and targets are
    unchanged if no sag is compensated, no spline blocks are used and no arm is redundant.

    Args:
        problem: Problem as stated.
        targets: Targets of all operations.

    Returns:
        The problem with larger margins, and the targets with lower feeds and additional freedoms.
    """
    problem, targets = _with_sag_and_spline_margins(problem, targets)
    return problem, tuple(_with_redundant_joints(problem, operation_targets) for operation_targets in targets)


def _with_redundant_joints(problem: Problem, targets: Targets) -> Targets:
    """Return the targets with the last joint of each redundant arm as an additional freedom.

    The freedom covers the range of the joint within its margin, but at most one full turn. It has the same
    range at all targets.
    """
    names = {freedom.name for freedom in targets.freedoms}
    has_rotation = any(not is_sampled_as_slide(freedom) for freedom in targets.freedoms)
    out = []
    for arm in (problem.cell.arm(name) for name in targets.arms):
        if not Chain.of(arm).is_redundant:
            continue
        robot, margin = arm.data, problem.settings.joint_margin
        middle = 0.5 * (robot.lower[-1] + robot.upper[-1])
        half_range = min(0.5 * (robot.upper[-1] - robot.lower[-1]) - margin, np.pi)
        name = f"axis_{robot.axes}_{arm.name}"
        # a freedom of the process may have this name already
        while name in names:
            name += "_"
        lower = np.full(targets.count, middle - half_range)
        upper = np.full(targets.count, middle + half_range)
        out.append(JointFreedom(name, arm.name, lower, upper, is_sole_rotation=not has_rotation))
    return dataclasses.replace(targets, freedoms=(*targets.freedoms, *out)) if out else targets


def _with_sag_and_spline_margins(
    problem: Problem, targets: Sequence[Targets]
) -> tuple[Problem, tuple[Targets, ...]]:
    """Widen the margins for compensated sag and for spline blocks, and lower feeds for spline blocks.

    Feeds are lowered only in operations whose feed limits the tool at every instant. They are lowered further
    on moves near stops.
    """
    settings_before = problem.settings
    clearance, joint_margin = sag.sag_margins(problem)
    if clearance > 0.0 or joint_margin > 0.0:
        settings = dataclasses.replace(
            settings_before.widen_clearances(clearance),
            joint_margin=settings_before.joint_margin + joint_margin,
            singularity_margin=settings_before.singularity_margin + joint_margin,
        )
        problem = dataclasses.replace(problem, settings=settings)
    if problem.cell.controller.path != "spline":
        return problem, tuple(targets)
    settings_before = problem.settings
    settings = dataclasses.replace(
        settings_before.widen_clearances(SPLINE_EXTRA_CLEARANCE_M),
        joint_margin=settings_before.joint_margin + SPLINE_EXTRA_MARGIN_RAD,
        singularity_margin=settings_before.singularity_margin + SPLINE_EXTRA_MARGIN_RAD,
        tcp_speed=settings_before.tcp_speed / SPLINE_SLOWING_FACTOR,
    )
    slower = tuple(
        dataclasses.replace(
            operation_targets,
            feed=operation_targets.feed
            / np.where(
                _are_near_stops(operation_targets),
                SPLINE_SLOWING_FACTOR * SPLINE_RAMP_FACTOR,
                SPLINE_SLOWING_FACTOR,
            ),
        )
        if operation_targets.feed_throughout
        else operation_targets
        for operation_targets in targets
    )
    return dataclasses.replace(problem, settings=settings), slower


def _are_near_stops(targets: Targets) -> BoolArray:
    """Return for each of N targets whether the move to it is one of the two moves before or after a stop.

    The first and the last target count as stops, because the motion rests there.
    """
    stop = targets.stop.copy()
    stop[[0, -1]] = True
    out = stop.copy()
    out[:-1] |= stop[1:]
    for k in (1, 2):
        out[k:] |= stop[:-k]
    return out


Progress = Callable[[str, float], None]
_PathsByOperation = dict[int, tuple[SampleGrid, PathResult]]
"""Results of :func:`find_path` by operation index."""

MAX_PLANNED_PLACEMENTS: Final = 6
"""Maximum number of stock poses that are planned completely."""
FAR_STOCK_OFFSET_M: Final = 50.0
"""Offset [m] of the stock along each axis when homes are checked without it."""
STOCK_MOVE_STEP_M: Final = 0.01
"""Step [m] of the suggested move of a stock out of an overlap."""


def solve(
    problem: Problem,
    targets: Sequence[Targets],
    progress: Progress | None = None,
    executor: Executor = SERIAL,
    reference: ReferencePlan | None = None,
) -> Plan:
    """Plan all operations of a problem.

    Every setup has its own cell and stock. If the stock is not moved between setups, one pose is searched for
    all of them. Movable bases are searched together with the first pose and stay there.

    Args:
        problem: Problem.
        targets: Targets of each operation.
        progress: Receives stage and fraction.
        executor: Runs independent work. The plan does not depend on it.
        reference: Plan of a similar problem. What still holds is taken over, and notes report it.

    Raises:
        TandemError: No plan exists; the issues say why and what may help.
    """
    problem, targets = with_margins(problem, targets)
    problem, targets = stations.assign_stations(problem, targets)
    current = [0]
    try:
        return _solve(problem, targets, progress or _ignore_progress, current, executor, reference)
    except TandemError as error:
        raise TandemError(_with_remedies(problem, targets, current[0], error.issues)) from error


def _with_remedies(
    problem: Problem, targets: Sequence[Targets], operation: int, issues: Sequence[Issue]
) -> list[Issue]:
    """Return the issues of an operation, with hints on changes of the problem that were tried.

    ``operation`` is the index of the operation that failed. A change is suggested only if the changed problem
    has a complete plan.
    """

    def has_plan(changed: Problem) -> bool:
        """Whether a changed problem has a complete plan."""
        try:
            _solve(changed, targets, _ignore_progress, [0])
        except TandemError:
            return False
        return True

    return remedies.suggest_remedies(problem, targets, operation, issues, has_plan)


def _solve(
    problem: Problem,
    targets: Sequence[Targets],
    report_progress: Progress,
    current: list[int],
    executor: Executor = SERIAL,
    reference: ReferencePlan | None = None,
) -> Plan:
    """Plan a problem that already has its margins and stations, as :func:`solve` does, without remedies.

    The only element of ``current`` is set to the index of the operation that is planned, so that the caller
    knows which operation failed.
    """
    report_progress("cell", 0.0)
    metrics: dict[str, Any] = {"stages": {}}
    notes: list[Issue] = []
    if reference is not None:
        reason = reference.incompatibility_reason(problem)
        if reason:
            notes.append(incompatible_note(reference.problem.name, reason))
            reference = None
    bases = {arm.name: arm.base for arm in problem.cell.arms if not arm.linear_axes}
    stock_poses: list[FloatArray] = []
    operations: list[OperationPlan] = []
    groups = setup_groups(problem, targets)
    submitted = _submit_later_groups(problem, groups, bases, executor, reference)
    for group in groups:
        # movable bases are chosen with the first group and fixed for all later ones
        group = group if not stock_poses else group.with_bases(bases)
        submitted_group = submitted.get(group.setups[0].number)
        group_plan = (
            _plan_group(problem, group, report_progress, current, executor, reference)
            if submitted_group is None
            else _await_group(submitted_group, current)
        )
        group_plan.add_metrics(metrics, group)
        notes += group_plan.notes
        bases.update(group_plan.placement.bases)
        stock_poses += [group_plan.placement.stock] * len(group.setups)
        operations += group_plan.operations
    report_progress("motion", 1.0)
    travels = external_axis_motion.axis_travels(problem, stock_poses)
    if travels:
        metrics["travel_s"] = sum(
            travel.seconds for setup_travels in travels for travel in setup_travels.values()
        )
    issues = [*(issue for t in targets for issue in t.issues), *notes]
    issues += [issue for operation in operations for issue in operation.issues]
    return Plan(
        problem_name=problem.name,
        digest=problem.digest,
        versions=versions(),
        stock_poses=tuple(stock_poses),
        bases=bases,
        operations=tuple(operations),
        metrics=metrics,
        issues=aggregate(issues),
        stations=problem.stations,
    )


def check(
    problem: Problem,
    targets: Sequence[Targets],
    with_remedies: bool = True,
    quick_check: QuickCheck | None = None,
) -> list[Issue]:
    """Check reach and collisions without optimisation and timing.

    Args:
        problem: Problem.
        targets: Targets of each operation.
        with_remedies: Whether remedies are tried.
        quick_check: Checks some targets only, one by one. If the stock pose is searched, only a few poses are
            tried.

    Returns:
        Issues; empty if every operation has a path. With ``quick_check``: empty if each checked target has a
        free posture at one of a few stock poses, or if none of these poses is feasible.
    """
    problem, targets = with_margins(problem, targets)
    try:
        problem, targets = stations.assign_stations(
            problem, targets, None if quick_check is None else quick_check.all_reachable
        )
    except TandemError as error:
        return list(error.issues)
    bases: Mapping[str, FloatArray] | None = None
    for group in setup_groups(problem, targets):
        current = [0]
        placement, reasons = _check_group(
            problem, group if bases is None else group.with_bases(bases), current, quick_check
        )
        if placement is None:
            return _with_remedies(problem, targets, current[0], reasons) if with_remedies else reasons
        bases = {**(bases or {}), **placement.bases}
    return []


@dataclasses.dataclass(frozen=True)
class SetupGroup:
    """Consecutive setups during which the stock is not moved.

    Attributes:
        setups: The setups.
        jobs: Targets of the operations of each setup.
    """

    setups: tuple[Setup, ...]
    jobs: tuple[tuple[Targets, ...], ...]

    @property
    def is_placed(self) -> bool:
        """Whether nothing has to be searched: the stock pose and all bases are stated."""
        first = self.setups[0]
        return first.stock.place is not None and not any(arm.base_auto for arm in first.cell.arms)

    @property
    def stock_pose(self) -> FloatArray:
        """Stated stock pose (4, 4), or its attitude at the origin."""
        stock = self.setups[0].stock
        return stock.place if stock.place is not None else from_parts(stock.attitude, np.zeros(3))

    def with_bases(self, bases: Mapping[str, FloatArray]) -> "SetupGroup":
        """Return the same group with the arms fixed on the given bases {arm: (4, 4)}."""

        def with_fixed_bases(setup: Setup) -> Cell:
            arms = tuple(
                dataclasses.replace(arm, base=bases.get(arm.name, arm.base), base_auto=False)
                for arm in setup.cell.arms
            )
            return dataclasses.replace(setup.cell, arms=arms)

        setups = tuple(dataclasses.replace(setup, cell=with_fixed_bases(setup)) for setup in self.setups)
        return dataclasses.replace(self, setups=setups)

    def models(self) -> list[CellModel]:
        """Create the collision model of each setup, with the stock in its pose."""
        return [plant.build_cell_model(setup.cell, setup.stock, self.stock_pose) for setup in self.setups]

    def model_per_job(self, models: Sequence[CellModel]) -> list[CellModel]:
        """Return the collision model of each operation, given one for each setup."""
        return [model for model, jobs in zip(models, self.jobs, strict=True) for _ in jobs]

    def placement_search(self, settings: Settings, in_air: bool) -> PlacementSearch:
        """Create the placement search for all operations.

        Args:
            settings: Margins and seed.
            in_air: Whether a support, or a stock without one, may end above the floor.
        """
        jobs = [
            PlacementJob(setup.cell, targets)
            for setup, setup_jobs in zip(self.setups, self.jobs, strict=True)
            for targets in setup_jobs
        ]
        return PlacementSearch(self.setups[0].stock, jobs, settings, in_air=in_air)


def setup_groups(problem: Problem, targets: Sequence[Targets]) -> list[SetupGroup]:
    """Group consecutive setups of a problem, with their targets, during which the stock is not moved.

    All setups of a group share one stock pose, which is stated or searched. A setup starts a new group if it
    changes the place or the holder of the stock, if an arm holds the stock, or if the cell has a turntable.
    """
    out: list[SetupGroup] = []
    for setup in problem.setups:
        jobs = tuple(targets[i] for i in setup.operations)
        change = problem.changes.get(setup.operations[0])
        is_moved = change is None or "place" in change.stock or "held_by" in change.stock
        is_moved |= problem.cell.turntable is not None
        if out and not is_moved and setup.stock.held_by is None:
            out[-1] = SetupGroup((*out[-1].setups, setup), (*out[-1].jobs, jobs))
        else:
            out.append(SetupGroup((setup,), (jobs,)))
    return out


@dataclasses.dataclass(frozen=True)
class _GroupPlanner:
    """Search for a stock pose at which all operations of a group have plans.

    Attributes:
        problem: The problem.
        group: Setups with a common stock pose.
        models: Collision model of each setup.
        current: One element, set to the index of the operation that is examined or planned.
        progress: Receives the progress of the plan.
        executor: Runs independent work.
    """

    problem: Problem
    group: SetupGroup
    models: Sequence[CellModel]
    current: list[int]
    progress: Progress
    executor: Executor = SERIAL

    def operations(
        self, placement: PlacementCandidate | None = None
    ) -> Iterator[tuple[Setup, CellModel, int, Targets]]:
        """Yield setup, collision model, index and targets of every operation.

        If a placement is given, the stock and the bases of the models are moved there.
        """
        group = self.group
        for setup, jobs, model in zip(group.setups, group.jobs, self.models, strict=True):
            placed_model = (
                model if placement is None else model.with_stock(placement.stock).with_bases(placement.bases)
            )
            for index, job in zip(setup.operations, jobs, strict=True):
                yield setup, placed_model, index, job

    def scenes(self, placement: PlacementCandidate) -> Iterator[tuple[int, Targets, Scene]]:
        """Yield index, targets and scene of every operation at a placement."""
        settings = self.problem.settings
        for setup, placed_model, index, job in self.operations(placement):
            scene = Scene.of(setup.cell, job.arms, placement.stock, settings, placed_model, placement.bases)
            yield index, job, scene

    def placement_search(self) -> PlacementSearch:
        """Create the placement search of the stock."""
        has_support = any(setup.stock.support for setup in self.group.setups)
        accepted_code = "stock.support" if has_support else "stock.hangs"
        # A stock in the air is an issue of its own. The search allows it only if the user accepts that issue.
        return self.group.placement_search(self.problem.settings, in_air=accepted_code in self.problem.accept)


@dataclasses.dataclass(frozen=True)
class _SetupGroupPlan:
    """Placement and plans of one group.

    Attributes:
        placement: Stock pose and bases.
        operations: Plans of all operations.
        stages: Duration [s] of each stage.
        trace: Metrics of the placement search; None if there was none.
        notes: Notes on the stock pose of a reference plan.
    """

    placement: PlacementCandidate
    operations: list[OperationPlan]
    stages: Mapping[str, float]
    trace: Mapping[str, Any] | None
    notes: tuple[Issue, ...] = ()

    def add_metrics(self, metrics: dict[str, Any], group: SetupGroup) -> None:
        """Add the durations and the placement of the group to the metrics of the plan.

        The metrics of the first placement with a score have no number, later ones that of their setup.
        """
        for stage, seconds in self.stages.items():
            metrics["stages"][stage] = metrics["stages"].get(stage, 0.0) + seconds
        name = f"placement_{group.setups[0].number}" if "placement_score_deg" in metrics else "placement"
        if self.trace is not None:
            metrics[name] = self.trace
        # only a placement that was searched, or taken over from a reference plan, has a score
        if self.trace is not None or self.placement.score > 0.0:
            metrics[f"{name}_score_deg"] = float(np.rad2deg(self.placement.score))


def _submit_later_groups(
    problem: Problem,
    groups: Sequence[SetupGroup],
    bases: Mapping[str, FloatArray],
    executor: Executor,
    reference: ReferencePlan | None,
) -> "dict[int, Iterator[_SetupGroupPlan | _SetupGroupFailure]]":
    """Submit the planning of all groups after the first one.

    The last group is submitted first, so that a caller that waits for the next group computes it while other
    processes compute later ones. Nothing is submitted if bases have to be searched, because all groups depend
    on the bases of the first one.

    Returns:
        The results, which are read later, by the number of the first setup of each group.
    """
    if any(arm.base_auto for group in groups for setup in group.setups for arm in setup.cell.arms):
        return {}
    out = {}
    for previous, group in reversed(list(itertools.pairwise(groups))):
        last_operation = previous.setups[-1].operations[-1]
        out[group.setups[0].number] = executor.submit(
            _group_result, problem, group.with_bases(bases), last_operation, reference
        )
    return out


@dataclasses.dataclass(frozen=True)
class _SetupGroupFailure:
    """Why a group has no plan, and the index of the failing operation."""

    issues: tuple[Issue, ...]
    operation: int


def _group_result(
    problem: Problem, group: SetupGroup, previous: int, reference: ReferencePlan | None
) -> Iterator[_SetupGroupPlan | _SetupGroupFailure]:
    """Yield the result of :func:`_plan_group`, or why it failed.

    ``previous`` is the index of the last operation of the previous group. It is reported if planning fails
    before the first operation of this group.
    """
    current = [previous]
    try:
        yield _plan_group(problem, group, _ignore_progress, current, reference=reference)
    except TandemError as error:
        yield _SetupGroupFailure(error.issues, current[0])


def _await_group(call: Iterator[_SetupGroupPlan | _SetupGroupFailure], current: list[int]) -> _SetupGroupPlan:
    """Wait for the plan of a submitted group.

    Raises:
        TandemError: The group has no plan. ``current`` is set to the index of the failing operation.
    """
    result = next(call)
    if isinstance(result, _SetupGroupFailure):
        current[0] = result.operation
        raise TandemError(result.issues)
    return result


def _plan_group(
    problem: Problem,
    group: SetupGroup,
    report_progress: Progress,
    current: list[int],
    executor: Executor = SERIAL,
    reference: ReferencePlan | None = None,
) -> _SetupGroupPlan:
    """Place the stock of a group, unless its pose is stated, and plan the operations of the group.

    Args:
        problem: Problem.
        group: Setups with a common stock pose.
        report_progress: Receives stage and fraction.
        current: One element, set to the index of the operation that is planned.
        executor: Runs independent work.
        reference: Plan of a similar problem, whose stock pose and paths are tried first.

    Raises:
        TandemError: No plan exists; the issues say why.
    """
    stages = {}
    lap = time.perf_counter()
    planner = _GroupPlanner(problem, group, group.models(), current, report_progress, executor)
    stages["cell"] = time.perf_counter() - lap
    if group.is_placed:
        placement = PlacementCandidate(group.stock_pose, {}, 0.0, 0)
        issues = _overlap_issues(planner)
        if issues:
            raise TandemError(issues)
        operations = _plan_operations(planner, placement, reference)
        return _SetupGroupPlan(placement, operations, stages, trace=None)
    _require_free_homes(planner)
    report_progress("placement", 0.0)
    lap = time.perf_counter()
    notes: list[Issue] = []
    if reference is not None:
        name, first_setup = reference.problem.name, group.setups[0]
        models = group.model_per_job(planner.models)
        reference_placement = planner.placement_search().evaluate(
            reference.stock_pose(first_setup), reference.plan.bases, models
        )
        stages["placement"] = time.perf_counter() - lap
        if isinstance(reference_placement, PlacementCandidate):
            try:
                operations = _plan_operations(planner, reference_placement, reference)
            except TandemError as error:
                reference_placement = f"it leads to no plan: {error.issues[0].message}"
            else:
                reference_margin_deg = reference.placement_margin_deg(first_setup)
                note = placement_note(name, first_setup, reference_placement, reference_margin_deg)
                return _SetupGroupPlan(reference_placement, operations, stages, trace=None, notes=(note,))
        notes.append(placement_note(name, first_setup, reference_placement, reference_margin_deg=None))
    placements, trace = planner.placement_search().run(group.model_per_job(planner.models))
    stages["placement"] = time.perf_counter() - lap
    placement, operations = _first_feasible(planner, placements, trace)
    return _SetupGroupPlan(placement, operations, stages, trace.metrics(placement.number), tuple(notes))


def _plan_operations(
    planner: _GroupPlanner,
    placement: PlacementCandidate,
    reference: ReferencePlan | None = None,
    fine: bool = True,
    paths: _PathsByOperation | None = None,
) -> list[OperationPlan]:
    """Plan all operations of a group at a placement.

    Args:
        planner: The group.
        placement: Stock pose and bases.
        reference: Plan of a similar problem. If it leads to no plan of an operation, that operation is
            planned without it.
        fine: Whether finer samples are tried, as for :class:`PathSearchOptions`.
        paths: Paths at this placement that are already known.

    Raises:
        TandemError: An operation has no plan.
        NoCoarsePathError: Not ``fine``, and only finer samples might have a path.
    """
    out = []
    problem = planner.problem
    for setup, placed_model, index, job in planner.operations(placement):
        planner.progress("motion", index / len(problem.operations))
        planner.current[0] = index
        name, controller = problem.operations[index].name, setup.cell.controller
        scene = Scene.of(
            setup.cell, job.arms, placement.stock, problem.settings, placed_model, placement.bases
        )
        reference_path = None if reference is None else reference.operation_path(index)
        known_path = None if paths is None else paths.get(index)
        options = PathSearchOptions(reference_path, fine, known_path)
        try:
            out.append(plan_operation(name, scene, job, controller, options, planner.executor))
        except TandemError as error:
            if reference_path is None:
                raise
            unreferenced = dataclasses.replace(options, reference=None)
            plan = plan_operation(name, scene, job, controller, unreferenced, planner.executor)
            reason = f"it leads to no plan: {error.issues[0].message}"
            note = reference_path.takeover_note(reason, {"in": False, "out": False}, plan.metrics)
            out.append(dataclasses.replace(plan, issues=(*plan.issues, note)))
    return out


def _first_feasible(
    planner: _GroupPlanner, placements: Sequence[PlacementCandidate], trace: PlacementTrace
) -> tuple[PlacementCandidate, list[OperationPlan]]:
    """Return the first placement at which all operations have plans, with these plans.

    Placements that need no fine samples come first, because fine samples take long. While every other
    placement is planned, the path at the next one is searched ahead, possibly in another process.

    Raises:
        TandemError: No placement leads to plans: ``motion.no_placement`` with the issues of the best one.
    """
    candidates, reasons, paths = _placements_to_try(planner, placements, trace)
    issues_by_candidate: dict[int, list[Issue]] = {}
    first_operation = planner.group.setups[0].operations[0]
    for fine in (False, True) if len(candidates) > 1 else (True,):
        ahead: Iterator[tuple[SampleGrid, PathResult] | None] | None = None
        for k, placement in enumerate(candidates):
            # Paths are searched ahead only at candidates with odd k, while the previous one is planned.
            known_paths, ahead = paths, ahead if k % 2 else None
            if ahead is not None:
                path_result, planner.current[0] = next(ahead), first_operation
                if path_result is None:
                    continue
                known_paths = {first_operation: path_result}
            elif not fine and k + 1 < len(candidates):
                ahead = _search_ahead(planner, candidates[k + 1])
            if k in issues_by_candidate:  # it failed without fine samples for another reason
                continue
            try:
                return placement, _plan_operations(planner, placement, fine=fine, paths=known_paths)
            except NoCoarsePathError:
                continue
            except TandemError as error:
                issues_by_candidate[k] = list(error.issues)
    reasons = reasons or issues_by_candidate.get(0, [])
    raise TandemError([_no_placement_issue(trace, planner.group, candidates, reasons), *reasons])


def _search_ahead(
    planner: _GroupPlanner, placement: PlacementCandidate
) -> Iterator[tuple[SampleGrid, PathResult] | None] | None:
    """Submit the path search of a group's first operation at a placement, with the first samples.

    Returns None if spins of the targets follow aims, because :func:`plan_operation` then searches a path of
    other targets (:func:`with_aims`).
    """
    _, job, scene = next(planner.scenes(placement))
    return planner.executor.submit(_coarse_path, scene, job) if with_aims(scene, job) is job else None


def _coarse_path(scene: Scene, targets: Targets) -> Iterator[tuple[SampleGrid, PathResult] | None]:
    """Yield a path that :func:`plan_operation` can start from, or None if only fine samples may have one.

    A path with colliding moves does not count. One value is yielded, because executors run generators.
    """
    grid, path_result = find_path(scene, targets, fine=False)
    yield (
        None
        if isinstance(path_result, BlockedSearch) or path_result.has_colliding_moves
        else (grid, path_result)
    )


def _require_free_homes(planner: _GroupPlanner) -> None:
    """Require that stated bases do not overlap and that homes are free, wherever the stock is.

    Otherwise no stock pose can be feasible, and the search is skipped. The check is made with the stock and
    its support far away. Overlaps of a base that the planner may move are ignored.

    Raises:
        TandemError: ``motion.overlap`` or ``motion.home``.
    """
    away = from_parts(np.eye(3), np.array([FAR_STOCK_OFFSET_M, FAR_STOCK_OFFSET_M, FAR_STOCK_OFFSET_M]))
    out: list[Issue] = []
    for setup, model in zip(planner.group.setups, planner.models, strict=True):
        overlaps = [
            overlap
            for overlap in clearance.find_overlaps(model.with_stock(away))
            if _is_between_bases(overlap)
        ]
        movable_bases = {f"{arm.name}/base_link" for arm in setup.cell.arms if arm.base_auto}
        out += [
            _overlap_issue(setup, model, overlap)
            for overlap in overlaps
            if not movable_bases & set(overlap[:2])
        ]
    if out:
        raise TandemError(list(aggregate(out)))
    for setup, model, _, job in planner.operations():
        scene = Scene.of(setup.cell, job.arms, away, planner.problem.settings, model.with_stock(away))
        homing.require_free_home(scene, job)


def _check_group(
    problem: Problem, group: SetupGroup, current: list[int], quick_check: QuickCheck | None = None
) -> tuple[PlacementCandidate | None, list[Issue]]:
    """Check a group of setups: find a placement at which all of its operations have a path.

    With a quick check, only the targets that it selects need a posture.

    Returns:
        The placement and no issues, or None and the issues. A quick check of a stock that is placed by the
        planner reports no issues except overlapping bases and homes that are not free.
    """
    planner = _GroupPlanner(problem, group, group.models(), current, _ignore_progress)
    if group.is_placed:
        placement = PlacementCandidate(group.stock_pose, {}, 0.0, 0)
        reasons = _overlap_issues(planner) or _path_issues(planner, placement, quick_check)
        return (None if reasons else placement), reasons
    try:
        _require_free_homes(planner)
    except TandemError as error:
        return None, list(error.issues)
    if quick_check is not None:
        quick_placement = find_quick_placement(problem, group, planner.models, current, quick_check)
        quick_check.is_stock_placed = quick_check.is_stock_placed and quick_placement is not None
        return quick_placement, []
    placements, trace = planner.placement_search().run(group.model_per_job(planner.models))
    candidates, reasons, paths = _placements_to_try(planner, placements, trace)
    if paths is not None:
        return candidates[0], []
    if len(candidates) > 1:  # as the plan does: prefer a placement that needs no fine samples
        for placement in candidates:
            if _has_coarse_path(planner, placement):
                return placement, []
    for placement in candidates:
        issues = _path_issues(planner, placement)
        if not issues:
            return placement, []
        reasons = reasons or issues
    return None, [_no_placement_issue(trace, group, candidates, reasons), *reasons]


def find_quick_placement(
    problem: Problem,
    group: SetupGroup,
    models: Sequence[CellModel],
    current: list[int],
    quick_check: QuickCheck,
) -> PlacementCandidate | None:
    """Find a placement among the first candidates at which the targets of the quick check have postures.

    Args:
        problem: Problem.
        group: Setups with a common stock pose.
        models: Collision model of each setup.
        current: One element, set to the index of the operation that was checked.
        quick_check: Targets to check.

    Returns:
        The placement, or None if none of the candidates is feasible.
    """
    planner = _GroupPlanner(problem, group, models, current, _ignore_progress)
    for placement in planner.placement_search().quick_candidates(group.model_per_job(models)):
        if not _path_issues(planner, placement, quick_check):
            return placement
    return None


def _overlap_issues(planner: _GroupPlanner) -> list[Issue]:
    """Return ``motion.overlap`` for static bodies that overlap as stated, and homes that are not free.

    Homes are reported only together with overlaps, because the plan itself checks them otherwise. While
    bases overlap they are left out, because homes on wrong bases mean nothing.
    """
    out: list[Issue] = []
    has_base_overlap = False
    group = planner.group
    for setup, model in zip(group.setups, planner.models, strict=True):
        placed_model = model.with_stock(group.stock_pose)
        overlaps = clearance.find_overlaps(placed_model)
        has_base_overlap = has_base_overlap or any(map(_is_between_bases, overlaps))
        out += [_overlap_issue(setup, placed_model, overlap) for overlap in overlaps]
    if has_base_overlap:
        return list(aggregate(out))
    if not out:
        return []
    for setup, model, _, job in planner.operations():
        scene = Scene.of(setup.cell, job.arms, group.stock_pose, planner.problem.settings, model)
        try:
            homing.require_free_home(scene, job)
        except TandemError as error:
            out += error.issues
    return list(aggregate(out))


BodyOverlap = tuple[str, str, float]
"""Two bodies that overlap, and the depth [m]."""


def _is_between_bases(overlap: BodyOverlap) -> bool:
    """Whether both overlapping bodies are bases of arms."""
    return all(body.endswith("/base_link") for body in overlap[:2])


def _overlap_issue(setup: Setup, model: CellModel, overlap: BodyOverlap) -> Issue:
    """Return ``motion.overlap`` of two bodies.

    If the stock is one of them, a move that separates it is tried and suggested. If both are bases, the issue
    names the field of the second one. ``model`` has the stock in its pose.
    """
    first, second, depth = overlap
    message = f"{first} and {second} overlap by {depth / MM:.1f} mm"
    field, remedy = None, None
    if _is_between_bases(overlap):
        names = [body.partition("/")[0] for body in (first, second)]
        base_distance = float(np.linalg.norm(model.bases[names[0]][:3, 3] - model.bases[names[1]][:3, 3]))
        message = f"{message}: the bases of {names[0]} and {names[1]} are {base_distance / MM:.1f} mm apart"
        number = next(i for i, arm in enumerate(setup.cell.arms) if arm.name == names[1])
        field = f"cell.arms.{number}.base"
        hint = "state the real base pose of each arm, in mm and in the world frame"
    else:
        message = f"{message}; arms would move into other bodies"
        hint = "correct the pose or the size of one of them; a stock ends where its support begins"
        # the support moves with the stock, so a move cannot separate these two
        is_stock_movable = "stock" in (first, second) and "support" not in (first, second)
        move = _separating_move(setup, model, model.stock_pose) if is_stock_movable else None
        if move is not None:
            hint = f"move the stock by ({', '.join(f'{v / MM:g}' for v in move)}) mm (tried); or {hint}"
            remedy = Remedy("stock", "stock", _to_mm(move))
    return Issue(
        "motion.overlap",
        message,
        field=field,
        bodies=(first, second),
        **measurement(depth / MM, 1.0, "mm"),
        hint=hint,
        remedy=remedy,
    )


def _separating_move(setup: Setup, model: CellModel, stock_pose: FloatArray) -> FloatArray | None:
    """Find the smallest move (3,) [m] along a world axis that takes the stock out of all overlaps.

    The move must not cause new issues of the stock's support. Moves from ``stock_pose`` (4, 4) by up to 20
    steps of :data:`STOCK_MOVE_STEP_M` are tried, upward first. Returns None if none of them helps.
    """
    support_codes = {issue.code for issue in support.setup_support_issues(setup)}
    for size in STOCK_MOVE_STEP_M * np.arange(1, 21):
        for move in size * np.array([[0, 0, 1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, -1.0]]):
            moved_pose = from_parts(stock_pose[:3, :3], stock_pose[:3, 3] + move)
            moved_setup = dataclasses.replace(setup, stock=dataclasses.replace(setup.stock, place=moved_pose))
            if (
                not clearance.find_overlaps(model.with_stock(moved_pose))
                and {i.code for i in support.setup_support_issues(moved_setup)} <= support_codes
            ):
                return np.asarray(move)
    return None


def _to_mm(move: FloatArray) -> tuple[float, float, float]:
    """Convert a move (3,) [m] of the stock to a tuple in millimetres, as a remedy states it."""
    return (float(move[0] / MM), float(move[1] / MM), float(move[2] / MM))


def _path_issues(
    planner: _GroupPlanner,
    placement: PlacementCandidate,
    quick_check: QuickCheck | None = None,
    paths: _PathsByOperation | None = None,
) -> list[Issue]:
    """Return the issues of the operations of a group that have no path at a placement.

    Homes that are not free are reported instead of a path. With a quick check, only its targets without a
    posture are reported. The planner's ``current`` is set to the first operation with an issue.

    Args:
        planner: The group.
        placement: Stock pose and bases.
        quick_check: Targets to check; None to search a path of all targets.
        paths: Receives the paths that are found, if given.
    """
    out: list[Issue] = []
    for index, job, scene in planner.scenes(placement):
        planner.current[0] = planner.current[0] if out else index
        try:
            homing.require_free_home(scene, job)
        except TandemError as error:  # the plan checks this first, too
            out += error.issues
            continue
        if quick_check is not None:
            out += quick_check.first_issues(scene, job, index)
            continue
        grid, path_result = find_path(scene, job)
        if isinstance(path_result, BlockedSearch):
            out += diagnosis.no_path_issues(scene, job, grid, path_result)
            continue
        if paths is not None:
            paths[index] = grid, path_result
    return out


def _has_coarse_path(planner: _GroupPlanner, placement: PlacementCandidate) -> bool:
    """Whether all operations of a group have free homes and paths at a placement, without fine samples.

    A path counts only if its linear moves are free too.
    """
    for _, job, scene in planner.scenes(placement):
        try:
            homing.require_free_home(scene, job)
        except TandemError:
            return False
        _, path_result = find_path(scene, job, fine=False)
        if isinstance(path_result, BlockedSearch) or path_result.has_colliding_moves:
            return False
    return True


def _placements_to_try(
    planner: _GroupPlanner, placements: Sequence[PlacementCandidate], trace: PlacementTrace
) -> tuple[Sequence[PlacementCandidate], list[Issue], _PathsByOperation | None]:
    """Choose the placements at which plans are tried, at most :data:`MAX_PLANNED_PLACEMENTS`.

    The placement search checks few postures of a target. If it finds no placement, its candidates with most
    free targets may still have paths, so they are searched.

    Returns:
        Placements found by the search, no issues and no paths. If there are none: the first of the candidates
        with most free targets that has paths, and these paths; or no placement and the issues of the first of
        these candidates.
    """
    if placements:
        return placements[:MAX_PLANNED_PLACEMENTS], [], None
    reasons: list[Issue] = []
    for _, placement in trace.freest:
        paths: _PathsByOperation = {}
        issues = _path_issues(planner, placement, paths=paths)
        if not issues:
            return [placement], [], paths
        reasons = reasons or issues
    return [], reasons, None


def _no_placement_issue(
    trace: PlacementTrace, group: SetupGroup, tried: Sequence[PlacementCandidate], reasons: Sequence[Issue]
) -> Issue:
    """Return ``motion.no_placement``, which says how far the placement search came.

    Args:
        trace: All candidates of the search.
        group: Setups with a common stock pose.
        tried: Placements that were planned without success, best first.
        reasons: Issues that are reported as well: those of the first of ``tried``, or of the candidate with
            most free targets.
    """
    stock = group.setups[0].stock
    best = int(np.argmax(trace.score))
    position = trace.positions[best]
    reachable_count = int((trace.score > 0).sum())
    message = (
        f"no stock pose was found for the whole job: {len(trace.score)} poses tried, {reachable_count} of "
    )
    message += "them reachable with all margins"
    if tried and reasons:
        x, y, z = tried[0].stock[:3, 3] / MM
        message += f", {len(tried)} of these planned without success: at {x:.0f}, {y:.0f}, {z:.0f} mm the "
        message += f"issue is {reasons[0].code}"
        hint = f"resolve the issue that is reported for that pose ({reasons[0].code}); or "
        is_same_everywhere = diagnosis.is_tool_and_support(reasons[0].bodies or ())
    else:
        hint, is_same_everywhere = "", False
        if stock.pedestal is not None and stock.pedestal.kind == "table":
            hint = "put the stock on a pedestal, which leaves room for tools (support: pedestal); "
        elif not reachable_count and stock.support and stock.sheet is None and stock.held_by is None:
            hint = "make the support longer, because it has to reach the floor; "
        free_text = ""
        if trace.freest:
            fraction, freest = trace.freest[0]
            position = freest.stock[:3, 3]
            free_text = f", with free postures for {fraction:.0%} of a few targets"
        if trace.freest and reasons:
            hint += (
                "resolve the collision there, which is reported as well (a longer wire or tool, or a smaller "
            )
            hint += "stock where a tool or a wrist hits it); "
        x, y, z = position / MM
        message += f", the best at {x:.0f}, {y:.0f}, {z:.0f} mm{free_text}"
    return Issue(
        "motion.no_placement",
        message,
        field="stock.place",
        value=float(np.rad2deg(trace.score[best])) if reachable_count else None,
        unit="deg" if reachable_count else None,
        hint="resolve the issue that is reported as well: it occurs at every pose"
        if is_same_everywhere
        else f"{hint}use larger arms, move the bases closer or let them move (base: auto), or split the job",
    )


def _ignore_progress(stage: str, fraction: float) -> None:
    del stage, fraction
