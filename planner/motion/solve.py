"""Motion of a whole problem: a place for the stock where none is given, then every operation.

Where the controller goes by spline blocks (``controller: {path: spline}``), the plan leaves room
for them: the curve between two targets is known within bounds only, and the proof takes these off.
"""

import dataclasses
import functools
import itertools
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

from planner.cell import axis_way, clearance, plant, support
from planner.cell.plant import CellModel
from planner.files import versions
from planner.geometry.arrays import BoolArray, FloatArray, from_parts
from planner.geometry.units import MM, measurement
from planner.issues import Issue, Remedy, TandemError, aggregate
from planner.motion import diagnosis, remedies, sag, stations, ways
from planner.motion.first_look import FirstLook
from planner.motion.former import Former, place_told, unlike_told
from planner.motion.operation import NoCoarsePathError, plan_operation
from planner.motion.placement import Place, Search, Trace
from planner.motion.planning_scene import Chain, Scene
from planner.motion.search.ladder_search import Blocked, Found
from planner.motion.search.path_search import find_path, with_aims
from planner.motion.search.reach import Grid, slides_only
from planner.plans import OperationPlan, Plan
from planner.problem import Cell, Problem, Settings, Setup
from planner.runtime.executor import SERIAL, Executor
from planner.targets import JointFreedom, Targets

SPLINE_CLEARANCE_M: Final = 4e-3
"""Bodies keep so much farther [m] apart."""
SPLINE_MARGIN_RAD: Final = float(np.deg2rad(0.2))
"""Axes keep so much farther [rad] off their limits and off singular postures."""
SPLINE_SLOWING_FACTOR: Final = 1.15
"""Tools go so many times as slow as allowed: they may be faster between two targets."""
SPLINE_RAMP_FACTOR: Final = 1.25
"""The same of the first two and the last two moves from stop to stop, besides: ramps end faster."""


def with_room(problem: Problem, targets: Sequence[Targets]) -> tuple[Problem, tuple[Targets, ...]]:
    """The problem and its targets with room for the sag of arms that have it compensated, and for the curves
    of spline blocks, and with the last joints of arms with seven axes as freedoms; as they are without
    such."""
    problem, targets = _with_room(problem, targets)
    return problem, tuple(_with_joints(problem, own) for own in targets)


def _with_joints(problem: Problem, targets: Targets) -> Targets:
    """The targets with the last joint of each arm that has one to spare as a freedom."""
    names = {freedom.name for freedom in targets.freedoms}
    turns = any(not slides_only(freedom) for freedom in targets.freedoms)
    out = []
    for arm in (problem.cell.arm(name) for name in targets.arms):
        if not Chain.of(arm).spare:
            continue
        robot, margin = arm.data, problem.settings.joint_margin
        middle = 0.5 * (robot.lower[-1] + robot.upper[-1])
        half = min(0.5 * (robot.upper[-1] - robot.lower[-1]) - margin, np.pi)
        name = f"axis_{robot.axes}_{arm.name}"
        while name in names:
            name += "_"
        bounds = np.full(targets.count, middle - half), np.full(targets.count, middle + half)
        out.append(JointFreedom(name, arm.name, *bounds, alone=not turns))
    return dataclasses.replace(targets, freedoms=(*targets.freedoms, *out)) if out else targets


def _with_room(problem: Problem, targets: Sequence[Targets]) -> tuple[Problem, tuple[Targets, ...]]:
    own = problem.settings
    way, turn = sag.room(problem)
    if way > 0.0 or turn > 0.0:
        settings = dataclasses.replace(
            own.wider(way),
            joint_margin=own.joint_margin + turn,
            singularity_margin=own.singularity_margin + turn,
        )
        problem = dataclasses.replace(problem, settings=settings)
    if problem.cell.controller.path != "spline":
        return problem, tuple(targets)
    own = problem.settings
    settings = dataclasses.replace(
        own.wider(SPLINE_CLEARANCE_M),
        joint_margin=own.joint_margin + SPLINE_MARGIN_RAD,
        singularity_margin=own.singularity_margin + SPLINE_MARGIN_RAD,
        tcp_speed=own.tcp_speed / SPLINE_SLOWING_FACTOR,
    )
    slower = tuple(
        dataclasses.replace(
            t,
            feed=t.feed
            / np.where(_near_stops(t), SPLINE_SLOWING_FACTOR * SPLINE_RAMP_FACTOR, SPLINE_SLOWING_FACTOR),
        )
        if t.feed_throughout
        else t
        for t in targets
    )
    return dataclasses.replace(problem, settings=settings), slower


def _near_stops(targets: Targets) -> BoolArray:
    """Moves to targets (N,) that are one of two before or behind a stop."""
    stop = targets.stop.copy()
    stop[[0, -1]] = True
    out = stop.copy()
    out[:-1] |= stop[1:]
    for k in (1, 2):
        out[k:] |= stop[:-k]
    return out


Progress = Callable[[str, float], None]
_Paths = dict[int, tuple[Grid, Found]]
"""What :func:`find_path` gave for operations, by their numbers."""

PLACES_TRIED: Final = 6
"""Places of a stock that are planned whole at most."""
AWAY_M: Final = 50.0
"""A stock is put so far away [m] along each axis to judge homes without it."""
ASIDE_STEP_M: Final = 0.01
"""[m] by whole multiples of this a block is told to be moved out of what it stands in."""


def solve(
    problem: Problem,
    targets: Sequence[Targets],
    progress: Progress | None = None,
    executor: Executor = SERIAL,
    former: Former | None = None,
) -> Plan:
    """The plan of all operations of a problem, given the targets of each. ``executor`` runs
    independent work; the plan is the same whatever it is. ``former``: a plan of a problem like this one, of
    which is taken over what holds; notes tell what did and what did not.

    Every setup has a cell and a block of its own. Where the block is not moved between setups, one place is
    found for all of them; bases that may be moved are found with the first place and stay. Raises
    :class:`TandemError` with the reasons when there is no plan.
    """
    problem, targets = with_room(problem, targets)
    problem, targets = stations.stationed(problem, targets)
    at = [0]
    try:
        return _solve(problem, targets, progress or _silent, at, executor, former)
    except TandemError as error:
        raise TandemError(_advised(problem, targets, at[0], error.issues)) from error


def _advised(
    problem: Problem, targets: Sequence[Targets], operation: int, issues: Sequence[Issue]
) -> list[Issue]:
    def plans(changed: Problem) -> bool:
        try:
            _solve(changed, targets, _silent, [0])
        except TandemError:
            return False
        return True

    return remedies.advised(problem, targets, operation, issues, plans)


def _solve(
    problem: Problem,
    targets: Sequence[Targets],
    tell: Progress,
    at: list[int],
    executor: Executor = SERIAL,
    former: Former | None = None,
) -> Plan:
    """As :func:`solve`; ``at`` is set to the operation that is planned."""
    tell("cell", 0.0)
    metrics: dict[str, Any] = {"stages": {}}
    notes: list[Issue] = []
    if former is not None and (why := former.unlike(problem)):
        notes.append(unlike_told(former.problem.name, why))
        former = None
    bases = {arm.name: arm.base for arm in problem.cell.arms if not arm.axes}
    places: list[FloatArray] = []
    operations: list[OperationPlan] = []
    stands = setup_groups(problem, targets)
    begun = _begun(problem, stands, bases, executor, former)
    for stand in stands:
        stand = stand if not places else stand.based(bases)
        calls = begun.get(stand.setups[0].number)
        settled = _settle(problem, stand, tell, at, executor, former) if calls is None else _told(calls, at)
        settled.into(metrics, stand)
        notes += settled.notes
        bases.update(settled.place.bases)
        places += [settled.place.stock] * len(stand.setups)
        operations += settled.operations
    tell("motion", 1.0)
    ways = axis_way.travels(problem, places)
    if ways:
        metrics["travel_s"] = sum(way.seconds for own in ways for way in own.values())
    issues = [*(issue for t in targets for issue in t.issues), *notes]
    issues += [issue for operation in operations for issue in operation.issues]
    return Plan(
        problem_name=problem.name,
        digest=problem.digest,
        versions=versions(),
        places=tuple(places),
        bases=bases,
        operations=tuple(operations),
        metrics=metrics,
        issues=aggregate(issues),
        stations=problem.stations,
    )


def check(
    problem: Problem, targets: Sequence[Targets], advise: bool = True, first: FirstLook | None = None
) -> list[Issue]:
    """Issues of reach and collision without optimising or timing; empty if every operation has a path.
    ``advise``: changes that may help are tried. With ``first`` some targets alone are looked at, one by one:
    empty if each of these has a free posture; where the block's place is searched, at one of a few places, or
    if none of these will do."""
    problem, targets = with_room(problem, targets)
    try:
        problem, targets = stations.stationed(problem, targets, None if first is None else first.passes)
    except TandemError as error:
        return list(error.issues)
    bases: Mapping[str, FloatArray] | None = None
    for stand in setup_groups(problem, targets):
        at = [0]
        place, reasons = _look(problem, stand if bases is None else stand.based(bases), at, first)
        if place is None:
            return _advised(problem, targets, at[0], reasons) if advise else reasons
        bases = {**(bases or {}), **place.bases}
    return []


@dataclasses.dataclass(frozen=True)
class Stand:
    """Setups through which the block stays where it is; ``jobs``: the targets of each setup's operations."""

    setups: tuple[Setup, ...]
    jobs: tuple[tuple[Targets, ...], ...]

    @property
    def settled(self) -> bool:
        """Whether there is nothing to be searched: the block's place and all bases are given."""
        first = self.setups[0]
        return first.stock.place is not None and not any(arm.base_auto for arm in first.cell.arms)

    @property
    def place(self) -> FloatArray:
        """The given place of the block (4, 4), or its attitude at the origin."""
        stock = self.setups[0].stock
        return stock.place if stock.place is not None else from_parts(stock.attitude, np.zeros(3))

    def based(self, bases: Mapping[str, FloatArray]) -> "Stand":
        """The same with the arms on given bases, which stay."""

        def cell(setup: Setup) -> Cell:
            arms = tuple(
                dataclasses.replace(arm, base=bases.get(arm.name, arm.base), base_auto=False)
                for arm in setup.cell.arms
            )
            return dataclasses.replace(setup.cell, arms=arms)

        setups = tuple(dataclasses.replace(setup, cell=cell(setup)) for setup in self.setups)
        return dataclasses.replace(self, setups=setups)

    def models(self) -> list[CellModel]:
        """The collision model of each setup."""
        return [plant.build(setup.cell, setup.stock, self.place) for setup in self.setups]

    def each(self, models: Sequence[CellModel]) -> list[CellModel]:
        """The model of each job, given those of the setups."""
        return [model for model, jobs in zip(models, self.jobs, strict=True) for _ in jobs]

    def search(self, settings: Settings, in_air: bool) -> Search:
        """The search of a place for all operations; ``in_air``: a support, or a block
        without one, may end above the floor."""
        first = self.setups[0]
        jobs = [(setup.cell, job) for setup, some in zip(self.setups, self.jobs, strict=True) for job in some]
        cells = [cell for cell, _ in jobs]
        return Search(first.cell, first.stock, [job for _, job in jobs], settings, cells=cells, in_air=in_air)


def setup_groups(problem: Problem, targets: Sequence[Targets]) -> list[Stand]:
    """The setups of a problem with their targets, those together between which the block is not moved."""
    out: list[Stand] = []
    for setup in problem.setups:
        jobs = tuple(targets[i] for i in setup.operations)
        change = problem.changes.get(setup.operations[0])
        moved = change is None or "place" in change.stock or "held_by" in change.stock
        moved |= problem.cell.turntable is not None
        if out and not moved and setup.stock.held_by is None:
            out[-1] = Stand((*out[-1].setups, setup), (*out[-1].jobs, jobs))
        else:
            out.append(Stand((setup,), (jobs,)))
    return out


@dataclasses.dataclass(frozen=True)
class _PlacementSearch:
    """The search for a place at which the operations of a stand have plans.

    Attributes:
        problem: The problem.
        stand: Setups whose block stays in one place.
        models: Collision model of each setup.
        at: One element, set to the index of the operation that is examined or planned.
        tell: Receives the progress of the plan.
        executor: Runs independent work.
    """

    problem: Problem
    stand: Stand
    models: Sequence[CellModel]
    at: list[int]
    tell: Progress
    executor: Executor = SERIAL

    def each(self, place: Place | None = None) -> Iterator[tuple[Setup, CellModel, int, Targets]]:
        """Setup, model (at a ``place``, if there is one), number and targets of every operation."""
        stand = self.stand
        for setup, jobs, model in zip(stand.setups, stand.jobs, self.models, strict=True):
            placed = model if place is None else model.with_stock(place.stock).with_bases(place.bases)
            for index, job in zip(setup.operations, jobs, strict=True):
                yield setup, placed, index, job

    def scenes(self, place: Place) -> Iterator[tuple[int, Targets, Scene]]:
        """Number, targets and scene of every operation at a place."""
        settings = self.problem.settings
        for setup, placed, index, job in self.each(place):
            yield index, job, Scene.of(setup.cell, job.arms, place.stock, settings, placed, place.bases)

    def search(self) -> Search:
        """The search of a place for the block."""
        stated = any(setup.stock.support for setup in self.stand.setups)
        taken = "stock.support" if stated else "stock.hangs"
        return self.stand.search(self.problem.settings, taken in self.problem.accept)


@dataclasses.dataclass(frozen=True)
class _Settled:
    """A place and the plans of all operations of one stand, with the seconds of its ``stages``, figures of
    the search for the place, None where there was none, and what is told of a former place."""

    place: Place
    operations: list[OperationPlan]
    stages: Mapping[str, float]
    trace: Mapping[str, Any] | None
    notes: tuple[Issue, ...] = ()

    def into(self, metrics: dict[str, Any], stand: Stand) -> None:
        """Writes its figures among those of the plan."""
        for stage, seconds in self.stages.items():
            metrics["stages"][stage] = metrics["stages"].get(stage, 0.0) + seconds
        name = f"placement_{stand.setups[0].number}" if "placement_score_deg" in metrics else "placement"
        if self.trace is not None:
            metrics[name] = self.trace
        if self.trace is not None or self.place.score > 0.0:  # searched, or that of a former plan
            metrics[f"{name}_score_deg"] = float(np.rad2deg(self.place.score))


def _begun(
    problem: Problem,
    stands: Sequence[Stand],
    bases: Mapping[str, FloatArray],
    executor: Executor,
    former: Former | None,
) -> "dict[int, Iterator[_Settled | _Refused]]":
    """The stands behind the first one, by the number of their first setup, the last one begun first: whoever
    waits for them takes up the next one. Empty where bases are to be found first."""
    if any(arm.base_auto for stand in stands for setup in stand.setups for arm in setup.cell.arms):
        return {}
    out = {}
    for before, stand in reversed(list(itertools.pairwise(stands))):
        last = before.setups[-1].operations[-1]
        out[stand.setups[0].number] = executor.submit(_settled, problem, stand.based(bases), last, former)
    return out


@dataclasses.dataclass(frozen=True)
class _Refused:
    """Why a stand has no plan, and the operation that has none."""

    issues: tuple[Issue, ...]
    operation: int


def _settled(
    problem: Problem, stand: Stand, before: int, former: Former | None
) -> Iterator[_Settled | _Refused]:
    """What :func:`_settle` gives or raises, ``before`` being the last operation of the stand before."""
    at = [before]
    try:
        yield _settle(problem, stand, _silent, at, former=former)
    except TandemError as error:
        yield _Refused(error.issues, at[0])


def _told(call: Iterator[_Settled | _Refused], at: list[int]) -> _Settled:
    """What a stand that was begun has come to; raises and sets ``at`` as :func:`_settle` does."""
    found = next(call)
    if isinstance(found, _Refused):
        at[0] = found.operation
        raise TandemError(found.issues)
    return found


def _settle(
    problem: Problem,
    stand: Stand,
    tell: Progress,
    at: list[int],
    executor: Executor = SERIAL,
    former: Former | None = None,
) -> _Settled:
    stages = {}
    lap = time.perf_counter()
    work = _PlacementSearch(problem, stand, stand.models(), at, tell, executor)
    stages["cell"] = time.perf_counter() - lap
    if stand.settled:
        place = Place(stand.place, {}, 0.0, 0)
        if found := _inside(work):
            raise TandemError(found)
        return _Settled(place, _plan(work, place, former), stages, None)
    _require_home(work)
    tell("placement", 0.0)
    lap = time.perf_counter()
    notes: list[Issue] = []
    if former is not None:
        name, first = former.problem.name, stand.setups[0]
        each = stand.each(work.models)
        known = work.search().judged(former.place(first), former.plan.bases, each)
        stages["placement"] = time.perf_counter() - lap
        if isinstance(known, Place):
            try:
                operations = _plan(work, known, former)
            except TandemError as error:
                known = f"no plan there: {error.issues[0].message}"
            else:
                note = place_told(name, first, known, former.score(first))
                return _Settled(known, operations, stages, None, (note,))
        notes.append(place_told(name, first, known, None))
    places, trace = work.search().run(stand.each(work.models))
    stages["placement"] = time.perf_counter() - lap
    place, operations = _first_that_works(work, places, trace)
    return _Settled(place, operations, stages, trace.metrics(place.number), tuple(notes))


def _plan(
    work: _PlacementSearch,
    place: Place,
    former: Former | None = None,
    fine: bool = True,
    paths: _Paths | None = None,
) -> list[OperationPlan]:
    """The plans of all operations of one stand, beginning with what a ``former`` plan had; where that leads
    to none, without it. ``fine`` as of :func:`plan_operation`; ``paths``: those that are known there."""
    out = []
    problem = work.problem
    for setup, placed, index, job in work.each(place):
        work.tell("motion", index / len(problem.operations))
        work.at[0] = index
        planned = functools.partial(
            plan_operation,
            problem.operations[index].name,
            setup.cell,
            job,
            problem.settings,
            place.stock,
            placed,
            place.bases,
            work.executor,
            fine=fine,
            known=None if paths is None else paths.get(index),
        )
        before = None if former is None else former.path(index)
        try:
            out.append(planned(before))
        except TandemError as error:
            if before is None:
                raise
            made, why = planned(), f"it leads to none: {error.issues[0].message}"
            told = before.told(why, {"in": False, "out": False}, made.metrics)
            out.append(dataclasses.replace(made, issues=(*made.issues, told)))
    return out


def _first_that_works(
    work: _PlacementSearch, places: Sequence[Place], trace: Trace
) -> tuple[Place, list[OperationPlan]]:
    """The first place at which all operations have plans: of those that need no fine samples, which take
    long, else of all. While every other one is planned, the path at the next is looked for ahead, perhaps in
    another process."""
    tried, reasons, paths = _tried(work, places, trace)
    failed: dict[int, list[Issue]] = {}
    first = work.stand.setups[0].operations[0]
    for fine in (False, True) if len(tried) > 1 else (True,):
        ahead: Iterator[tuple[Grid, Found] | None] | None = None
        for k, place in enumerate(tried):
            known, ahead = paths, ahead if k % 2 else None
            if ahead is not None:
                found, work.at[0] = next(ahead), first
                if found is None:
                    continue
                known = {first: found}
            elif not fine and k + 1 < len(tried):
                ahead = _looked_ahead(work, tried[k + 1])
            if k in failed:
                continue
            try:
                return place, _plan(work, place, fine=fine, paths=known)
            except NoCoarsePathError:
                continue
            except TandemError as error:
                failed[k] = list(error.issues)
    reasons = reasons or failed.get(0, [])
    raise TandemError([_unplaced(trace, work.stand, tried, reasons), *reasons])


def _looked_ahead(work: _PlacementSearch, place: Place) -> Iterator[tuple[Grid, Found] | None] | None:
    """Begins the search of a path for the first operation of a stand at a place, with the samples that are
    tried first; None where tools are aimed there, which the plan itself does."""
    _, job, scene = next(work.scenes(place))
    return work.executor.submit(_coarse_path, scene, job) if with_aims(scene, job) is job else None


def _coarse_path(scene: Scene, targets: Targets) -> Iterator[tuple[Grid, Found] | None]:
    """What :func:`plan_operation` takes as known where it needs no fine samples, None where it does."""
    grid, found = find_path(scene, targets, fine=False)
    yield None if isinstance(found, Blocked) or found.loose else (grid, found)


def _require_home(work: _PlacementSearch) -> None:
    """Bases that are inside of one another, and homes that are not free, wherever the stock is need no search
    for its place."""
    away = from_parts(np.eye(3), np.array([AWAY_M, AWAY_M, AWAY_M]))  # so is what it stands on
    out: list[Issue] = []
    for setup, model in zip(work.stand.setups, work.models, strict=True):
        found = [found for found in clearance.overlaps(model.with_stock(away)) if _between_bases(found)]
        searched = {f"{arm.name}/base_link" for arm in setup.cell.arms if arm.base_auto}
        out += [_overlap(setup, model, own) for own in found if not searched & set(own[:2])]
    if out:
        raise TandemError(list(aggregate(out)))
    for setup, model, _, job in work.each():
        scene = Scene.of(setup.cell, job.arms, away, work.problem.settings, model.with_stock(away))
        ways.require_home(scene, job)


def _look(
    problem: Problem, stand: Stand, at: list[int], first: FirstLook | None = None
) -> tuple[Place | None, list[Issue]]:
    """A place at which every operation of a stand has a path, or the targets of a ``first`` look a posture;
    or why there is none."""
    work = _PlacementSearch(problem, stand, stand.models(), at, _silent)
    if stand.settled:
        place = Place(stand.place, {}, 0.0, 0)
        reasons = _inside(work) or _no_path(work, place, first)
        return (None if reasons else place), reasons
    try:
        _require_home(work)
    except TandemError as error:
        return None, list(error.issues)
    if first is not None:
        soon = first_place(problem, stand, work.models, at, first)
        first.placed = first.placed and soon is not None
        return soon, []
    places, trace = work.search().run(stand.each(work.models))
    tried, reasons, paths = _tried(work, places, trace)
    if paths is not None:
        return tried[0], []
    if len(tried) > 1:  # as the plan does: one that needs no fine samples, which take long
        for place in tried:
            if _has_coarse_path(work, place):
                return place, []
    for place in tried:
        found = _no_path(work, place)
        if not found:
            return place, []
        reasons = reasons or found
    return None, [_unplaced(trace, stand, tried, reasons), *reasons]


def first_place(
    problem: Problem, stand: Stand, models: Sequence[CellModel], at: list[int], first: FirstLook
) -> Place | None:
    """One of the first places of a block at which the targets of a ``first`` look have postures; None where
    none of them will do. ``at`` is set to the operation that was looked at."""
    work = _PlacementSearch(problem, stand, models, at, _silent)
    for place in work.search().soon(stand.each(models)):
        if not _no_path(work, place, first):
            return place
    return None


def _inside(work: _PlacementSearch) -> list[Issue]:
    """``motion.overlap`` for bodies that are inside of one another where all stands as it is stated, with
    homes that are not free; these say nothing as long as bases are inside of one another."""
    out: list[Issue] = []
    bases = False
    stand = work.stand
    for setup, model in zip(stand.setups, work.models, strict=True):
        placed = model.with_stock(stand.place)
        found = clearance.overlaps(placed)
        bases = bases or any(map(_between_bases, found))
        out += [_overlap(setup, placed, own) for own in found]
    if bases:
        return list(aggregate(out))
    if not out:
        return []
    for setup, model, _, job in work.each():
        scene = Scene.of(setup.cell, job.arms, stand.place, work.problem.settings, model)
        try:
            ways.require_home(scene, job)
        except TandemError as error:
            out += error.issues
    return list(aggregate(out))


Overlap = tuple[str, str, float]
"""Two bodies that are inside of one another, and how deep [m]."""


def _between_bases(found: Overlap) -> bool:
    return all(body.endswith("/base_link") for body in found[:2])


def _overlap(setup: Setup, placed: CellModel, found: Overlap) -> Issue:
    """``motion.overlap`` of two bodies, with the move of the block that was tried or the bases to part."""
    one, other, deep = found
    what = f"{one} and {other} stand in one another, {deep / MM:.1f} mm deep"
    field, remedy = None, None
    if _between_bases(found):
        names = [body.partition("/")[0] for body in (one, other)]
        way = float(np.linalg.norm(placed.bases[names[0]][:3, 3] - placed.bases[names[1]][:3, 3]))
        what = f"{what}: the bases of {names[0]} and {names[1]} are {way / MM:.1f} mm apart"
        number = next(i for i, arm in enumerate(setup.cell.arms) if arm.name == names[1])
        field = f"cell.arms.{number}.base"
        hint = "state each arm's base where it stands in the cell, in mm and in the world's frame"
    else:
        what = f"{what}; arms would go where something else is"
        hint = "correct the place or the size of one of them; a block ends where its support begins"
        own = "stock" in (one, other) and "support" not in (one, other)  # which moves with its block
        move = _out_of(setup, placed, placed.stock_pose) if own else None
        if move is not None:
            hint = f"move the stock by ({', '.join(f'{v / MM:g}' for v in move)}) mm (tried); or {hint}"
            remedy = Remedy("stock", "stock", _in_mm(move))
    return Issue(
        "motion.overlap",
        what,
        field=field,
        bodies=(one, other),
        **measurement(deep / MM, 1.0, "mm"),
        hint=hint,
        remedy=remedy,
    )


def _out_of(setup: Setup, model: CellModel, place: FloatArray) -> FloatArray | None:
    """The smallest straight move (3,) [m] along an axis of the world, in steps of `ASIDE_STEP_M`, after
    which the block stands in nothing and is borne as it was; None where there is none within 20 of them."""
    borne = {issue.code for issue in support.stood(setup)}
    for size in ASIDE_STEP_M * np.arange(1, 21):
        for way in size * np.array([[0, 0, 1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, -1.0]]):
            at = from_parts(place[:3, :3], place[:3, 3] + way)
            moved = dataclasses.replace(setup, stock=dataclasses.replace(setup.stock, place=at))
            if (
                not clearance.overlaps(model.with_stock(at))
                and {i.code for i in support.stood(moved)} <= borne
            ):
                return np.asarray(way)
    return None


def _in_mm(move: FloatArray) -> tuple[float, float, float]:
    return (float(move[0] / MM), float(move[1] / MM), float(move[2] / MM))


def _no_path(
    work: _PlacementSearch, place: Place, first: FirstLook | None = None, paths: _Paths | None = None
) -> list[Issue]:
    """Why operations have no path, or targets of a ``first`` look no posture, or no free home; ``at`` is set
    to the first of them. ``paths`` gets those that are found."""
    out: list[Issue] = []
    for index, job, scene in work.scenes(place):
        work.at[0] = work.at[0] if out else index
        try:
            ways.require_home(scene, job)
        except TandemError as error:  # as the plan does, which asks for this first
            out += error.issues
            continue
        if first is not None:
            out += first.faults(scene, job, index)
            continue
        grid, found = find_path(scene, job)
        if isinstance(found, Blocked):
            out += diagnosis.no_path(scene, job, grid, found)
            continue
        if paths is not None:
            paths[index] = grid, found
    return out


def _has_coarse_path(work: _PlacementSearch, place: Place) -> bool:
    """Whether all operations of a stand have free homes and paths at a place, without fine samples."""
    for _, job, scene in work.scenes(place):
        try:
            ways.require_home(scene, job)
        except TandemError:
            return False
        _, found = find_path(scene, job, fine=False)
        if isinstance(found, Blocked) or found.loose:
            return False
    return True


def _tried(
    work: _PlacementSearch, places: Sequence[Place], trace: Trace
) -> tuple[Sequence[Place], list[Issue], _Paths | None]:
    """The places to try. The search looks at few postures of a target: where it finds no place, the first of
    its freest that has a path after all is tried, with the paths of its operations; if none has, what is in
    the way at the very freest."""
    if places:
        return places[:PLACES_TRIED], [], None
    reasons: list[Issue] = []
    for _, place in trace.freest:
        paths: _Paths = {}
        found = _no_path(work, place, paths=paths)
        if not found:
            return [place], [], paths
        reasons = reasons or found
    return [], reasons, None


def _unplaced(trace: Trace, stand: Stand, tried: Sequence[Place], reasons: Sequence[Issue]) -> Issue:
    """``motion.no_placement``. ``tried``: the places that were planned, none to the end; ``reasons``: what is
    told beside it, at the first of them or at the freest place."""
    stock = stand.setups[0].stock
    best = int(np.argmax(trace.score))
    at = trace.positions[best]
    reachable = int((trace.score > 0).sum())
    found = f"{len(trace.score)} places tried, {reachable} of them reachable with all margins"
    if tried and reasons:
        x, y, z = tried[0].stock[:3, 3] / MM
        found += f", {len(tried)} of these planned, none to the end: at {x:.0f}, {y:.0f}, {z:.0f} mm there "
        found += f"was {reasons[0].code}"
        hint = f"mend what is told of that place as well ({reasons[0].code}); or "
        stays = diagnosis.at_support(reasons[0].bodies or ())
    else:
        hint, stays = "", False
        if stock.pedestal is not None and stock.pedestal.kind == "table":
            hint = "let the block stand on a pedestal, beside which tools can pass (support: pedestal); "
        elif not reachable and stock.support and stock.sheet is None and stock.held_by is None:
            hint = "make the support longer, since it has to reach the floor; "
        free = ""
        if trace.freest:
            share, freest = trace.freest[0]
            at, free = freest.stock[:3, 3], f", with free postures for {share:.0%} of a few targets"
        if trace.freest and reasons:
            hint += (
                "mend what is in the way there, which is told as well (a longer wire or tool or a smaller "
            )
            hint += "block where a tool or a wrist meets it); "
        x, y, z = at / MM
        found += f", the best at {x:.0f}, {y:.0f}, {z:.0f} mm{free}"
    return Issue(
        "motion.no_placement",
        f"no place of the stock was found for the whole job: {found}",
        field="stock.place",
        value=float(np.rad2deg(trace.score[best])) if reachable else None,
        unit="deg" if reachable else None,
        hint="mend what is told of that place as well: it is so at every place"
        if stays
        else f"{hint}use larger arms, move the bases nearer or let them move (base: auto), or split the job",
    )


def _silent(stage: str, fraction: float) -> None:
    del stage, fraction
