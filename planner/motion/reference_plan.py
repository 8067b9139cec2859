"""Reference plans: an earlier plan of a similar problem, from which planning starts.

Stock poses, branches and paths can be taken over from it. They are checked like those of a search: margins,
clearance and moves between targets. Where they do not hold, the full search follows. Notes report what was
taken over and what was not.
"""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from planner.cell.plant import content_digest
from planner.geometry.arrays import FloatArray, spread_rows
from planner.geometry.units import DEG
from planner.issues import Issue, Severity, issue_error
from planner.motion.homing import HomeMotion
from planner.motion.placement import POSE_TOLERANCE, PlacementCandidate
from planner.motion.search.path_search import MAX_FULL_SEARCH_TARGETS
from planner.motion.search.reach import is_full_turn
from planner.motion.search.subsampling import carry_over
from planner.plans import OperationPlan, Plan
from planner.problem import Problem, Setup
from planner.targets import Freedom, Targets

MAX_REFERENCE_STATES: Final = 48
"""Number of states of the reference path that a new path may use at every target."""
FULL_TURN_OFFSET_RAD: Final = np.deg2rad(30.0)
"""Offset [rad] of further samples of full turns, on both sides of states of the reference path. They are used
if these states alone have no path.
"""
READ_METRICS: Final = ("branch", "trajopt_cost", "limit_margin_deg", "singularity_margin_deg")
"""Metrics of an operation's plan that this module reads."""
MAX_COST_RATIO: Final = 1.5
"""Cost ratio to the reference path above which a note suggests to plan without the reference."""
SEARCH_HINT: Final = "plan without --like and use tandem compare to see which plan is better"


@dataclasses.dataclass(frozen=True)
class ReferencePlan:
    """An earlier plan and the problem that it belongs to.

    Raises:
        TandemError: ``plan.damaged`` if the plan does not fit the problem.
    """

    plan: Plan
    problem: Problem

    def __post_init__(self) -> None:
        """Check that the plan belongs to the problem and that its poses and paths are complete."""
        plan, problem = self.plan, self.problem
        wrong = ""
        if plan.digest != problem.digest:
            wrong = "it belongs to a different problem than the one stored with it"
        elif len(plan.stock_poses) != len(problem.setups) or len(plan.operations) != len(problem.operations):
            wrong = "its number of stock poses or operations differs from its problem"
        elif not all(_is_rigid(pose) for pose in (*plan.stock_poses, *plan.bases.values())):
            wrong = "it contains a pose that is not a rigid motion"
        elif not all(map(_is_complete, plan.operations)):
            wrong = "it contains an incomplete path"
        if wrong:
            message = f"the plan of {plan.problem_name} is damaged: {wrong}"
            raise issue_error("plan.damaged", message, hint="plan that problem again")

    def incompatibility_reason(self, problem: Problem) -> str:
        """Return why nothing of this plan can be taken over for a problem; empty if something may be.

        Arms with their models, stated bases, the numbers of setups and operations, and the holder of the
        stock in each setup have to agree.
        """
        arms = {arm.name: arm for arm in self.problem.cell.arms}
        new_arms = {arm.name: arm for arm in problem.cell.arms}
        if list(arms) != list(new_arms):
            return f"its arms are {', '.join(arms)}, this problem has {', '.join(new_arms)}"
        for name, arm in new_arms.items():
            reference_arm = arms[name]
            if reference_arm.robot != arm.robot or content_digest(
                reference_arm.custom_data
            ) != content_digest(arm.custom_data):
                return f"arm {name} is a {reference_arm.data.title} there and a {arm.data.title} here"
            is_base_fixed = not arm.base_auto
            # the plan has no bases of arms on tracks
            reference_base = self.plan.bases.get(name, reference_arm.base)
            if is_base_fixed and np.abs(reference_base - arm.base).max() > POSE_TOLERANCE:
                return f"the base of arm {name} has a different pose"
        counts = [[len(p.setups), len(p.operations)] for p in (self.problem, problem)]
        if counts[0] != counts[1]:
            counts_text = [f"{operations} operations in {setups} setups" for setups, operations in counts]
            return f"it has {counts_text[0]}, this problem has {counts_text[1]}"
        for reference_setup, new_setup in zip(self.problem.setups, problem.setups, strict=True):
            if reference_setup.stock.held_by != new_setup.stock.held_by:
                return f"the stock of setup {new_setup.number} is held differently"
        return ""

    def stock_pose(self, setup: Setup) -> FloatArray:
        """Return the stock pose (4, 4) in the world that the reference plan has in a setup."""
        return self.plan.stock_poses[setup.number - 1]

    def placement_margin_deg(self, setup: Setup) -> float | None:
        """Return the smallest margin [deg] of the reference plan's stock pose in a setup.

        Returns None if that pose was not searched, so that its margin is unknown.
        """
        name = "placement" if setup.number == 1 else f"placement_{setup.number}"
        value = self.plan.metrics.get(f"{name}_score_deg")
        return float(value) if isinstance(value, int | float) else None

    def operation_path(self, index: int) -> "ReferencePath":
        """Return the reference path of the operation with an index from 0."""
        return ReferencePath(self.problem.name, self.plan.operations[index])


def _is_rigid(pose: object) -> bool:
    """Whether an object is a (4, 4) matrix of a rotation and a translation."""
    if not isinstance(pose, np.ndarray) or pose.shape != (4, 4) or not np.isfinite(pose).all():
        return False
    rotation = pose[:3, :3]
    return bool(
        np.abs(rotation @ rotation.T - np.eye(3)).max() < POSE_TOLERANCE and np.linalg.det(rotation) > 0.0
    ) and np.array_equal(pose[3], [0.0, 0.0, 0.0, 1.0])


def _is_complete(operation: OperationPlan) -> bool:
    """Whether a stored operation has all that a new plan reads from it.

    It needs the metrics :data:`READ_METRICS`, joints, approach, retreat and poses of all arms, values of all
    freedoms, and track positions, with one row for each target and without infinite or undefined numbers.
    """
    targets, arms = operation.targets, set(operation.targets.arms)
    count, branch = targets.count, operation.metrics.get("branch")
    if (
        not set(READ_METRICS) <= set(operation.metrics)
        or not isinstance(branch, Mapping)
        or set(branch) != arms
    ):
        return False
    arrays_by_arm = (operation.q, operation.approach, operation.retreat, operation.arm_order, targets.pose)
    if any(set(by_arm) != arms for by_arm in arrays_by_arm):
        return False
    for name, path in (("entry", operation.approach), ("exit", operation.retreat)):
        if name in operation.synchronised and len({len(arm_path) for arm_path in path.values()}) > 1:
            return False
    shapes: list[tuple[FloatArray, tuple[int, ...]]] = [(operation.values, (count, len(targets.freedoms)))]
    joints = {arm: q.shape[1] if q.ndim == 2 else 0 for arm, q in operation.q.items()}
    shapes += [(q, (count, joints[arm])) for arm, q in operation.q.items()]
    paths = (*operation.approach.items(), *operation.retreat.items())
    shapes += [(path, (max(len(path), 2), joints[arm])) for arm, path in paths]
    shapes += [(pose, (count, 4, 4)) for pose in targets.pose.values()]
    shapes += [(values, (count,)) for values in targets.track_positions.values()]
    return all(array.shape == shape and bool(np.isfinite(array).all()) for array, shape in shapes)


@dataclasses.dataclass(frozen=True)
class ReferencePath:
    """Path of an operation in the plan of the problem ``name``."""

    name: str
    operation: OperationPlan

    @property
    def branch(self) -> Mapping[str, int]:
        """Branch of each arm."""
        return dict(self.operation.metrics["branch"])

    def freedom_samples(self, targets: Targets) -> list[FloatArray] | str:
        """Return samples of the freedoms of ``targets`` along the reference path.

        Returns:
            Two arrays (S, F) of coordinates of the freedoms, as in
            :class:`planner.motion.search.subsampling.FreedomCoordinates`, to be tried in this order: those of
            the path, and those around every second state of it, in which full turns are offset by
            :data:`FULL_TURN_OFFSET_RAD`. If the path cannot be used for ``targets``, the reason why.
        """
        reference_targets = self.operation.targets
        if reference_targets.arms != targets.arms or dict(reference_targets.frame) != dict(targets.frame):
            return "its tools are moved in different frames"
        if [_freedom_kind(f) for f in reference_targets.freedoms] != [
            _freedom_kind(f) for f in targets.freedoms
        ]:
            names = [
                ", ".join(f.name for f in these_targets.freedoms) or "none"
                for these_targets in (reference_targets, targets)
            ]
            return f"its freedoms are {names[0]}, this operation has {names[1]}"
        if max(reference_targets.count, targets.count) > MAX_FULL_SEARCH_TARGETS:
            return (
                f"paths of more than {MAX_FULL_SEARCH_TARGETS} targets are searched on a subset of them "
                "anyway"
            )
        if not targets.freedoms:
            return "its poses have no freedom"
        rows = spread_rows(reference_targets.count, MAX_REFERENCE_STATES)
        coordinates_by_branch = carry_over(reference_targets, self.operation.values, targets)
        on_path = np.concatenate([coordinates[rows] for coordinates in coordinates_by_branch])
        turns = [
            (-FULL_TURN_OFFSET_RAD, 0.0, FULL_TURN_OFFSET_RAD) if is_full_turn(f) else (0.0,)
            for f in targets.freedoms
        ]
        # every second state, with each combination of no offset and an offset to either side of full turns
        around = on_path[::2, None] + np.array(list(itertools.product(*turns)))
        return [on_path, around.reshape(-1, on_path.shape[1])]

    @property
    def approach_and_retreat(self) -> tuple[HomeMotion, HomeMotion]:
        """Approach and retreat of the operation in the reference plan."""
        operation = self.operation
        return (
            HomeMotion(
                dict(operation.approach), operation.arm_order, together="entry" in operation.synchronised
            ),
            HomeMotion(
                dict(operation.retreat), operation.arm_order, together="exit" in operation.synchronised
            ),
        )

    def takeover_note(
        self, path_reason: str, kept_ends: Mapping[str, bool], metrics: Mapping[str, Any]
    ) -> Issue:
        """Return a note on what was taken over from the reference path and how the new path compares with it.

        Args:
            path_reason: Why the path was not taken over; empty if it was.
            kept_ends: {"in" or "out": whether the approach or the retreat was taken over}.
            metrics: Metrics of the new plan.
        """
        kept_texts = [f"the path {end}" for end, is_kept in kept_ends.items() if is_kept]
        taken_texts = [] if path_reason else ["branches and path"]
        dropped_texts = [f"branches and path ({path_reason})"] if path_reason else []
        dropped_texts += [
            f"the path {name} (not free here)" for name, is_kept in kept_ends.items() if not is_kept
        ]
        message = (
            f"{self.operation.name}: {_join_texts([*taken_texts, *kept_texts])} taken over from the plan of "
            f"{self.name}"
        )
        message += f"; not taken over: {_join_texts(dropped_texts)}" if dropped_texts else ""
        hint = None
        if not path_reason:
            cost, reference_cost = (float(m["trajopt_cost"]) for m in (metrics, self.operation.metrics))
            message += f". {_format_metrics(metrics)}, there {_format_metrics(self.operation.metrics)}"
            if cost > MAX_COST_RATIO * reference_cost:
                hint = (
                    f"the path costs {cost / reference_cost:.1f} times as much as the reference: "
                    f"{SEARCH_HINT}"
                )
        return _reference_note(message, f"operations.{self.operation.name}", hint)


def _freedom_kind(freedom: Freedom) -> tuple[str, type[Freedom], bool]:
    """Return what two freedoms must have in common for values of one to be used for the other."""
    return freedom.name, type(freedom), is_full_turn(freedom)


def _join_texts(texts: Sequence[str]) -> str:
    return " and ".join(texts) if texts else "nothing"


def _format_metrics(metrics: Mapping[str, Any]) -> str:
    """Format the cost and the smallest margins of a path for a note."""
    out = f"cost {metrics['trajopt_cost']:.3g}"
    for name, description in (
        ("limit_margin_deg", "joint limits"),
        ("singularity_margin_deg", "singularities"),
    ):
        out += f", {min(metrics[name].values()):.1f} deg to {description}"
    if "clearance_mm" in metrics:
        out += f", clearance {metrics['clearance_mm']:.1f} mm"
    return out


def placement_note(
    name: str, setup: Setup, placement: PlacementCandidate | str, reference_margin_deg: float | None
) -> Issue:
    """Return a note that says whether the stock pose of a setup was taken over.

    Args:
        name: Name of the reference problem.
        setup: Setup of the new problem.
        placement: The placement that was taken over, or the reason why none was.
        reference_margin_deg: Smallest margin [deg] in the reference plan, if it is known.
    """
    message = f"the stock pose of setup {setup.number}"
    field = "stock.place" if setup.number == 1 else f"operations.{setup.operations[0]}.setup"
    if isinstance(placement, str):
        return _reference_note(
            f"{message} was not taken over from the plan of {name} ({placement}) but searched again", field
        )
    reference_text = "" if reference_margin_deg is None else f", there {reference_margin_deg:.1f} deg"
    message += (
        f" was taken over from the plan of {name}: smallest margin {placement.score / DEG:.1f} "
        f"deg{reference_text}"
    )
    return _reference_note(message, field, f"another pose may have larger margins: {SEARCH_HINT}")


def incompatible_note(name: str, reason: str) -> Issue:
    """Return a note that nothing was taken over from the plan of the problem ``name``, and why."""
    return _reference_note(f"nothing was taken over from the plan of {name}: {reason}", field=None)


def _reference_note(message: str, field: str | None, hint: str | None = None) -> Issue:
    return Issue("motion.like", message, Severity.NOTE, field=field, hint=hint)
