"""A plan that was made before, of a problem like the one that is planned: what it offers, and what is told of
what was taken over and what was not.

What is taken over is looked at as anything else is: margins, clearance, moves between targets. Where it does
not hold, the whole search follows.
"""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from planner.cell.plant import content_digest
from planner.geometry.arrays import FloatArray, spread_rows
from planner.geometry.units import DEG
from planner.issues import Issue, Severity, refusal
from planner.motion.placement import SAME_POSE, Place
from planner.motion.search.path_search import LONG_JOB
from planner.motion.search.reach import full_turn
from planner.motion.search.subsampling import carried
from planner.motion.ways import Ways
from planner.plans import OperationPlan, Plan
from planner.problem import Problem, Setup
from planner.targets import Freedom, Targets

SAMPLES: Final = 48
"""Places of a former path that a new one may go through at every target."""
AROUND_RAD: Final = np.deg2rad(30.0)
"""So far [rad] on either side of them full turns are sampled where these alone have no path."""
FIGURES: Final = ("branch", "trajopt_cost", "limit_margin_deg", "singularity_margin_deg")
"""Figures of an operation's plan that are read here."""
DEAR_SHARE: Final = 1.5
"""Paths that cost so many times as much as the former one are told to be dear."""
SEARCH_HINT: Final = "plan without --like and see by tandem compare which is better"


@dataclasses.dataclass(frozen=True)
class Former:
    """A former ``plan`` and the ``problem`` that it is of."""

    plan: Plan
    problem: Problem

    def __post_init__(self) -> None:
        """Raises :class:`TandemError` (``plan.damaged``) where the plan is not one of the problem."""
        plan, problem = self.plan, self.problem
        wrong = ""
        if plan.digest != problem.digest:
            wrong = "it is of another problem than the one beside it"
        elif len(plan.places) != len(problem.setups) or len(plan.operations) != len(problem.operations):
            wrong = "it has not as many places and operations as its problem"
        elif not all(_rigid(pose) for pose in (*plan.places, *plan.bases.values())):
            wrong = "a place in it is no pose"
        elif not all(map(_whole, plan.operations)):
            wrong = "a path in it is none"
        if wrong:
            what = f"the plan of {plan.problem_name} is damaged: {wrong}"
            raise refusal("plan.damaged", what, hint="plan that problem again")

    def unlike(self, problem: Problem) -> str:
        """Why nothing of the plan is taken over for a problem; empty where something may be."""
        arms = {arm.name: arm for arm in self.problem.cell.arms}
        own = {arm.name: arm for arm in problem.cell.arms}
        if list(arms) != list(own):
            return f"its arms are {', '.join(arms)}, here they are {', '.join(own)}"
        for name, arm in own.items():
            before = arms[name]
            if before.robot != arm.robot or content_digest(before.given) != content_digest(arm.given):
                return f"arm {name} is a {before.data.title} there, here a {arm.data.title}"
            given = not arm.base_auto
            stood = self.plan.bases.get(name, before.base)  # the plan has none of arms on tracks
            if given and np.abs(stood - arm.base).max() > SAME_POSE:
                return f"the base of arm {name} stands elsewhere"
        counts = [[len(p.setups), len(p.operations)] for p in (self.problem, problem)]
        if counts[0] != counts[1]:
            said = [f"{operations} operations in {setups} setups" for setups, operations in counts]
            return f"it has {said[0]}, here there are {said[1]}"
        for there, here in zip(self.problem.setups, problem.setups, strict=True):
            if there.stock.held_by != here.stock.held_by:
                return f"the block of setup {here.number} is held otherwise"
        return ""

    def place(self, setup: Setup) -> FloatArray:
        """The place (4, 4) of the block in a setup."""
        return self.plan.places[setup.number - 1]

    def score(self, setup: Setup) -> float | None:
        """The least margin [deg] of that place, None where none was searched."""
        name = "placement" if setup.number == 1 else f"placement_{setup.number}"
        found = self.plan.metrics.get(f"{name}_score_deg")
        return float(found) if isinstance(found, int | float) else None

    def path(self, index: int) -> "FormerPath":
        """The path of an operation."""
        return FormerPath(self.problem.name, self.plan.operations[index])


def _rigid(pose: object) -> bool:
    if not isinstance(pose, np.ndarray) or pose.shape != (4, 4) or not np.isfinite(pose).all():
        return False
    turn = pose[:3, :3]
    return bool(
        np.abs(turn @ turn.T - np.eye(3)).max() < SAME_POSE and np.linalg.det(turn) > 0.0
    ) and np.array_equal(pose[3], [0.0, 0.0, 0.0, 1.0])


def _whole(operation: OperationPlan) -> bool:
    """Whether an operation's arrays are finite and as long as its targets, and its figures there."""
    targets, arms = operation.targets, set(operation.targets.arms)
    count, branch = targets.count, operation.metrics.get("branch")
    if not set(FIGURES) <= set(operation.metrics) or not isinstance(branch, Mapping) or set(branch) != arms:
        return False
    parts = (operation.q, operation.entry, operation.exit, operation.order, targets.pose)
    if any(set(some) != arms for some in parts):
        return False
    for name, way in (("entry", operation.entry), ("exit", operation.exit)):
        if name in operation.together and len({len(own) for own in way.values()}) > 1:
            return False
    shapes: list[tuple[FloatArray, tuple[int, ...]]] = [(operation.values, (count, len(targets.freedoms)))]
    joints = {arm: q.shape[1] if q.ndim == 2 else 0 for arm, q in operation.q.items()}
    shapes += [(q, (count, joints[arm])) for arm, q in operation.q.items()]
    ways = (*operation.entry.items(), *operation.exit.items())
    shapes += [(way, (max(len(way), 2), joints[arm])) for arm, way in ways]
    shapes += [(pose, (count, 4, 4)) for pose in targets.pose.values()]
    shapes += [(values, (count,)) for values in targets.ride.values()]
    return all(array.shape == shape and bool(np.isfinite(array).all()) for array, shape in shapes)


@dataclasses.dataclass(frozen=True)
class FormerPath:
    """The path that an operation had in the plan of the problem ``name``."""

    name: str
    operation: OperationPlan

    @property
    def branch(self) -> Mapping[str, int]:
        """The branch of each arm."""
        return dict(self.operation.metrics["branch"])

    def samples(self, targets: Targets) -> list[FloatArray] | str:
        """Coordinates (S, F) of the freedoms of ``targets`` that the path went through, then those around
        half of them; or why it gives none."""
        before = self.operation.targets
        if before.arms != targets.arms or dict(before.frame) != dict(targets.frame):
            return "its tools are moved otherwise"
        if [_kind(f) for f in before.freedoms] != [_kind(f) for f in targets.freedoms]:
            names = [", ".join(f.name for f in own.freedoms) or "none" for own in (before, targets)]
            return f"its freedoms were {names[0]}, here they are {names[1]}"
        if max(before.count, targets.count) > LONG_JOB:
            return f"paths of over {LONG_JOB} targets are searched on fewer of them anyway"
        if not targets.freedoms:
            return "its poses leave nothing open"
        some = spread_rows(before.count, SAMPLES)
        every = carried(before, self.operation.values, targets)
        near = np.concatenate([coordinates[some] for coordinates in every])
        turns = [(-AROUND_RAD, 0.0, AROUND_RAD) if full_turn(f) else (0.0,) for f in targets.freedoms]
        around = near[::2, None] + np.array(list(itertools.product(*turns)))
        return [near, around.reshape(-1, near.shape[1])]

    @property
    def ways(self) -> tuple[Ways, Ways]:
        """The ways in and out."""
        own = self.operation
        return (
            Ways(dict(own.entry), own.order, "entry" in own.together),
            Ways(dict(own.exit), own.order, "exit" in own.together),
        )

    def told(self, path: str, kept: Mapping[str, bool], metrics: Mapping[str, Any]) -> Issue:
        """What of it was taken over: the path unless ``path`` says why not, and ways in and out {name:
        whether}; ``metrics`` are those of the new plan."""
        ways = [f"the way {way}" for way, own in kept.items() if own]
        taken = [] if path else ["branches and path"]
        left = [f"branches and path ({path})"] if path else []
        left += [f"the way {name} (not free here)" for name, own in kept.items() if not own]
        what = f"{self.operation.name}: {_listed([*taken, *ways])} taken over from the plan of {self.name}"
        what += f"; not so {_listed(left)}" if left else ""
        hint = None
        if not path:
            here, there = (float(m["trajopt_cost"]) for m in (metrics, self.operation.metrics))
            what += f". {_figures(metrics)}, there {_figures(self.operation.metrics)}"
            if here > DEAR_SHARE * there:
                hint = f"the path costs {here / there:.1f} times as much as there: {SEARCH_HINT}"
        return _note(what, f"operations.{self.operation.name}", hint)


def _kind(freedom: Freedom) -> tuple[str, type[Freedom], bool]:
    return freedom.name, type(freedom), full_turn(freedom)


def _listed(what: Sequence[str]) -> str:
    return " and ".join(what) if what else "nothing"


def _figures(metrics: Mapping[str, Any]) -> str:
    """The cost and the least margins of a path."""
    out = f"cost {metrics['trajopt_cost']:.3g}"
    for name, what in (("limit_margin_deg", "joint limits"), ("singularity_margin_deg", "singular postures")):
        out += f", {min(metrics[name].values()):.1f} deg to {what}"
    if "clearance_mm" in metrics:
        out += f", clearance {metrics['clearance_mm']:.1f} mm"
    return out


def place_told(name: str, setup: Setup, place: Place | str, before: float | None) -> Issue:
    """Whether the place of a setup was taken over from the plan of the problem ``name``, or why not;
    ``before``: its least margin [deg] there, where it is known."""
    what = f"the place of the block in setup {setup.number}"
    field = "stock.place" if setup.number == 1 else f"operations.{setup.operations[0]}.setup"
    if isinstance(place, str):
        return _note(f"{what} was not taken over from the plan of {name} ({place}), but searched anew", field)
    there = "" if before is None else f", there {before:.1f} deg"
    what += f" was taken over from the plan of {name}: least margin {place.score / DEG:.1f} deg{there}"
    return _note(what, field, f"margins may be wider elsewhere: {SEARCH_HINT}")


def unlike_told(name: str, why: str) -> Issue:
    """That nothing was taken over from the plan of the problem ``name``, and why."""
    return _note(f"nothing was taken over from the plan of {name}: {why}", None)


def _note(what: str, field: str | None, hint: str | None = None) -> Issue:
    return Issue("motion.like", what, Severity.NOTE, field=field, hint=hint)
