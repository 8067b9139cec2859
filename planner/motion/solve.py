"""Motion of a whole problem: a place for the stock where none is given, then the plan of every operation."""

from __future__ import annotations

import importlib.metadata
import platform
import time
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from planner.cell import plant
from planner.cell.plant import CellModel
from planner.geometry.rigid import from_parts
from planner.issues import Issue, TandemError, aggregate
from planner.motion import diagnose, entry
from planner.motion.operation import plan_operation
from planner.motion.placement import Place, Search, Trace
from planner.motion.reach import sample
from planner.motion.scene import Scene
from planner.motion.search import Blocked, search
from planner.plans import OperationPlan, Plan
from planner.problem import Problem
from planner.targets import Targets

FloatArray = NDArray[np.float64]
Progress = Callable[[str, float], None]

PLACES_TRIED: Final = 6
AWAY: Final = 50.0
PACKAGES: Final = ("tandem-planner", "drake", "numpy", "scipy", "toppra")


def solve(problem: Problem, targets: Sequence[Targets], progress: Progress | None = None) -> Plan:
    """The plan of all operations of a problem, given the targets of each.

    Raises :class:`TandemError` with the reasons when there is none.
    """
    tell = progress or _silent
    started = time.perf_counter()
    fixed = problem.stock.place
    base = fixed if fixed is not None else from_parts(problem.stock.attitude, np.zeros(3))
    tell("cell", 0.0)
    model = plant.build(problem.cell, problem.stock, base)
    metrics: dict[str, Any] = {"stages": {"cell": time.perf_counter() - started}}
    if fixed is not None and not any(arm.base_auto for arm in problem.cell.arms):
        place = Place(fixed, {}, 0.0, 0)
        operations = _plan(problem, targets, model, place, tell)
    else:
        _require_home(problem, targets, model)
        tell("placement", 0.0)
        lap = time.perf_counter()
        places, trace = Search(problem.cell, problem.stock, targets, problem.settings).run(model)
        metrics["stages"]["placement"] = time.perf_counter() - lap
        place, operations = _first_that_works(problem, targets, model, places, trace, tell)
        metrics["placement"] = trace.metrics(place.number)
        metrics["placement_score_deg"] = float(np.rad2deg(place.score))
    issues = [issue for t in targets for issue in t.issues]
    issues += [issue for operation in operations for issue in operation.issues]
    return Plan(
        problem_name=problem.name,
        digest=problem.digest,
        versions=versions(),
        places=(place.stock,),
        bases={arm.name: place.bases.get(arm.name, arm.base) for arm in problem.cell.arms},
        operations=tuple(operations),
        metrics=metrics,
        issues=aggregate(issues),
    )


def check(problem: Problem, targets: Sequence[Targets]) -> list[Issue]:
    """Issues of reach and collision without optimising or timing; empty if every operation has a path."""
    fixed = problem.stock.place
    base = fixed if fixed is not None else from_parts(problem.stock.attitude, np.zeros(3))
    model = plant.build(problem.cell, problem.stock, base)
    if fixed is not None and not any(arm.base_auto for arm in problem.cell.arms):
        return _no_path(problem, targets, model, Place(fixed, {}, 0.0, 0))
    places, trace = Search(problem.cell, problem.stock, targets, problem.settings).run(model)
    reasons: list[Issue] = []
    for place in places[:PLACES_TRIED]:
        reasons = _no_path(problem, targets, model, place)
        if not reasons:
            return []
    return [_unplaced(trace), *reasons]


def versions() -> dict[str, str]:
    """Versions of what the plan depends on."""
    out = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            out[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            out[name] = "not installed"
    return out


def _plan(
    problem: Problem, targets: Sequence[Targets], model: CellModel, place: Place, tell: Progress
) -> list[OperationPlan]:
    placed = model.with_stock(place.stock).with_bases(place.bases)
    out = []
    for number, (operation, job) in enumerate(zip(problem.operations, targets, strict=True)):
        tell("motion", number / len(targets))
        out.append(
            plan_operation(
                operation.name, problem.cell, job, problem.settings, place.stock, placed, place.bases
            )
        )
    tell("motion", 1.0)
    return out


def _first_that_works(
    problem: Problem,
    targets: Sequence[Targets],
    model: CellModel,
    places: Sequence[Place],
    trace: Trace,
    tell: Progress,
) -> tuple[Place, list[OperationPlan]]:
    reasons: tuple[Issue, ...] = ()
    for place in places[:PLACES_TRIED]:
        try:
            return place, _plan(problem, targets, model, place, tell)
        except TandemError as error:
            reasons = reasons or error.issues
    raise TandemError([_unplaced(trace), *reasons])


def _require_home(problem: Problem, targets: Sequence[Targets], model: CellModel) -> None:
    """Homes that are not free wherever the stock is need no search for its place."""
    away = from_parts(np.eye(3), np.array([0.0, 0.0, AWAY]))
    for job in targets:
        entry.require_home(
            Scene.of(problem.cell, job.arms, away, problem.settings, model.with_stock(away)), job
        )


def _no_path(problem: Problem, targets: Sequence[Targets], model: CellModel, place: Place) -> list[Issue]:
    placed = model.with_stock(place.stock).with_bases(place.bases)
    out: list[Issue] = []
    for job in targets:
        scene = Scene.of(problem.cell, job.arms, place.stock, problem.settings, placed, place.bases)
        grid = sample(job)
        found = search(scene, job, grid)
        if isinstance(found, Blocked):
            out += diagnose.no_path(scene, job, grid, found)
    return out


def _unplaced(trace: Trace) -> Issue:
    best = int(np.argmax(trace.score))
    x, y, z = 1e3 * trace.positions[best]
    reachable = int((trace.score > 0).sum())
    return Issue(
        "motion.no_placement",
        f"no place of the stock was found for the whole job: {len(trace.score)} places tried, "
        f"{reachable} of them "
        f"reachable with all margins, the best at {x:.0f}, {y:.0f}, {z:.0f} mm",
        field="stock.place",
        value=float(np.rad2deg(trace.score[best])) if reachable else None,
        unit="deg" if reachable else None,
        hint="use larger arms, move the bases nearer or let them move (base: auto), or split the job",
    )


def _silent(stage: str, fraction: float) -> None:
    del stage, fraction
