"""The passes of a part: one over each feature, or several where its walls are too steep for one.

**Thickness from pass to pass.** Like the final shape, an intermediate shape results from a displacement of
the flat along z only. So the change of area of a point from pass to pass, A(k-1) / A(k), telescopes to that
from the flat: t0 cos(a), the sine law of the shape that the point has now. In this model several passes give
no thicker wall than one. Their practical gains, sheet drawn from the floor and a higher strain at fracture,
are not modelled, so the model errs on the safe side. One effect is included: sheet that was thinned once does
not thicken where a later pass makes it less steep (the wall of an intermediate shape becomes floor). So each
point keeps the minimum thickness of all passes over it.

**Trials** of forming with two robots, from `data/forming_trials.yaml`, and the warnings that they give. They
are single trials of one lab with metals of unstated alloy: hints of what may go wrong, not limits.
"""

import dataclasses
import functools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml

from planner.catalogue.materials import SheetMetal
from planner.geometry.arrays import FloatArray, Mesh
from planner.geometry.units import DEG, MM, measurement
from planner.issue_codes import format_message
from planner.issues import Issue, Severity, TandemError
from planner.processes.forming.plan.contact import FormingPass
from planner.processes.forming.plan.features.pass_shape import (
    AngleLimitedShape,
    depth_areas,
    feature_face,
    limit_wall_angle,
    shape_face,
)
from planner.processes.forming.plan.features.tree import FeatureTree, OrderStep
from planner.processes.forming.plan.operation import Forming
from planner.processes.forming.plan.sheet_mechanics import thickness_map, wall_angle
from planner.runtime.memoize import memoized

_TRIALS_FILE: Final = Path(__file__).resolve().parents[3] / "data" / "forming_trials.yaml"
"""Published forming trials, each with its source."""

TRIAL_MODES: Final = {"spif": "isf", "dpif_p": "dpif_p", "dpif_l": "dpif_l", "dsif": "dpif_l"}
"""Mode of the trials that is most similar to a forming mode; other modes have none."""
TRIAL_CAUSES: Final = {
    "force": "the robot stopped with a collision error, from the forming force,",
    "border_tear": "the sheet tore along the border",
    "local_tear": "the sheet tore at the forming tool",
    "completed": "the part was completed",
}
"""Cause that stopped a trial, in words."""
TRIAL_MODE_NAMES: Final = {
    "isf": "no support",
    "dpif_p": "support on the border",
    "dpif_l": "support opposite the tool",
}
"""Modes of the trials, in words."""
ANGLE_SLACK_RAD: Final = 5.0 * DEG
"""A part is similar to a trial if its wall angle is at least the trial's minus this [rad]."""
DEPTH_SLACK_FRACTION: Final = 0.9
"""A part is similar to a trial if its depth is at least this fraction of the trial's."""
THICKNESS_SLACK_FACTOR: Final = 1.25
"""A sheet that is thinner than that of a trial with too much force, or thicker than one that tore, by up to
this factor is still similar.
"""


@dataclasses.dataclass(frozen=True)
class FormingTrial:
    """One forming trial.

    Attributes:
        name: Name of the trial.
        mode: isf, dpif_p or dpif_l.
        family: Family of the sheet metal.
        thickness: Sheet thickness [m].
        angle: Wall angle [rad].
        diameter: Tool diameter [m].
        stepdown: Step-down [m].
        feed: Feed [m/s].
        depth: Depth [m] at which it stopped.
        second_depth: Depth [m] of a stage in the other direction inside the first, or None.
        duration: Duration [s].
        cause: What stopped it at ``depth``: force, border_tear, local_tear or completed.
        forming_robot: Robot of the forming tool.
        supporter: Robot of the support, or None.
        support_tool: Tool of the support, or None.
        lubricant: Lubricant.
        note: Remark of the source.
    """

    name: str
    mode: str
    family: str
    thickness: float
    angle: float
    diameter: float
    stepdown: float
    feed: float
    depth: float
    second_depth: float | None
    duration: float
    cause: str
    forming_robot: str
    supporter: str | None
    support_tool: str | None
    lubricant: str
    note: str

    @property
    def failed(self) -> bool:
        """Whether the trial stopped for another reason than completion."""
        return self.cause != "completed"


@functools.lru_cache(maxsize=1)
def trials() -> tuple[FormingTrial, ...]:
    """Return all trials, in the order of their source."""
    with _TRIALS_FILE.open(encoding="utf-8") as stream:
        return tuple(_trial(entry) for entry in yaml.safe_load(stream)["trials"])


def nearest_failed_trial(
    family: str, thickness: float, angle: float, depth: float, mode: str
) -> FormingTrial | None:
    """Return the failed trial that is most similar to a part, or None.

    A trial is similar if all of these conditions hold:

    - The metal is of the same family, and the mode is the one that is most similar to ``mode``.
    - The part is nearly as steep and as deep as the part of the trial, or more so.
    - If the trial stopped because of the forming force, the sheet of the part is hardly thinner. If the sheet
      tore, the sheet of the part is hardly thicker.

    Args:
        family: Family of the sheet metal.
        thickness: Sheet thickness [m].
        angle: Steepest wall angle [rad].
        depth: Depth [m].
        mode: Forming mode.
    """
    if mode not in TRIAL_MODES:
        return None
    similar = [
        trial
        for trial in trials()
        if trial.failed
        and trial.family == family
        and trial.mode == TRIAL_MODES[mode]
        and angle >= trial.angle - ANGLE_SLACK_RAD
        and depth >= DEPTH_SLACK_FRACTION * trial.depth
        and _is_thickness_similar(trial, thickness)
    ]
    return min(similar, key=lambda trial: _trial_distance(trial, thickness, angle, depth), default=None)


def trial_warning(family: str, thickness: float, angle: float, depth: float, mode: str) -> Issue | None:
    """Return a warning (forming.trial) with the cause of the nearest failed trial, or None.

    Arguments as in `nearest_failed_trial`.
    """
    trial = nearest_failed_trial(family, thickness, angle, depth, mode)
    if trial is None:
        return None
    return Issue(
        "forming.trial",
        format_message(
            "forming.trial",
            thickness_mm=thickness / MM,
            metal_family=family.replace("_", " "),
            angle_deg=angle / DEG,
            depth_mm=depth / MM,
            trial=trial.name,
            trial_mode=TRIAL_MODE_NAMES[trial.mode],
            support_clause=f", {trial.support_tool}" if trial.support_tool else "",
            trial_thickness_mm=trial.thickness / MM,
            trial_angle_deg=trial.angle / DEG,
            lubricant=trial.lubricant,
            cause=TRIAL_CAUSES[trial.cause],
            trial_depth_mm=trial.depth / MM,
        ),
        Severity.WARNING,
        **measurement(depth / MM, trial.depth / MM, "mm"),
        hint=f"form a test piece first; note of the trial: {trial.note}",
    )


def _is_thickness_similar(trial: FormingTrial, thickness: float) -> bool:
    """Return whether a sheet of a thickness [m] would hardly fare better than the failed trial."""
    if trial.cause == "force":  # thicker sheet takes more force
        return thickness >= trial.thickness / THICKNESS_SLACK_FACTOR
    return thickness <= trial.thickness * THICKNESS_SLACK_FACTOR  # thinner sheet tears sooner


def _trial_distance(trial: FormingTrial, thickness: float, angle: float, depth: float) -> float:
    """Return a dimensionless distance between a part and a trial: log-ratios, and angles over 15 degrees."""
    return math.hypot(
        math.log(thickness / trial.thickness),
        (angle - trial.angle) / (15.0 * DEG),
        math.log(depth / trial.depth),
    )


def _trial(entry: dict[str, Any]) -> FormingTrial:
    """Return the trial that an entry of the file describes, in m, rad and s."""
    second = entry.get("second_depth_mm")
    return FormingTrial(
        name=entry["name"],
        mode=entry["mode"],
        family=entry["family"],
        thickness=float(entry["thickness_mm"]) * MM,
        angle=float(entry["angle_deg"]) * DEG,
        diameter=float(entry["diameter_mm"]) * MM,
        stepdown=float(entry["stepdown_mm"]) * MM,
        feed=float(entry["feed_mm_s"]) * MM,
        depth=float(entry["depth_mm"]) * MM,
        second_depth=None if second is None else float(second) * MM,
        duration=float(entry["minutes"]) * 60.0,
        cause=entry["cause"],
        forming_robot=entry["former"],
        supporter=entry["supporter"],
        support_tool=entry["support_tool"],
        lubricant=entry["lubricant"],
        note=entry["note"],
    )


SUPPORTED_MODES: Final = frozenset({"dsif", "dpif_l", "adsif"})
"""Modes with a tool opposite the forming one."""
UPRIGHT_WALL_ANGLE_RAD: Final = 89.0 * DEG
"""Wall angle [rad] from which the sine law leaves no sheet."""
ANGLE_TOLERANCE_RAD: Final = 0.1 * DEG
"""Wall angles [rad] that differ by less are equal: no pass is made for so small a difference."""
MAX_ANGLE_STEP_RAD: Final = 15.0 * DEG
"""Angle [rad] from shape to shape beyond which walls tore in trials (30 deg tore, 15 deg did not)."""


def make_passes(
    tree: FeatureTree,
    order: Sequence[OrderStep],
    mesh: Mesh,
    thickness: float,
    operation: Forming,
    metal: SheetMetal,
) -> tuple[FormingPass, ...]:
    """Return all passes in the order of forming, in the sheet's frame.

    A feature that is too steep for one pass is formed through intermediate shapes, one pass each, and all of
    them are repeated as often as the operation states. The sheet is equally thick along z everywhere. The
    face that a tool above the sheet touches is therefore the mesh moved up by the thickness.

    Args:
        tree: Features of the part.
        order: Features in the order of forming.
        mesh: Lower face of the part from which ``tree`` was built.
        thickness: Thickness [m] of the sheet.
        operation: Operation.
        metal: Sheet metal.

    Raises:
        TandemError: forming.wall_angle for upright walls.
    """
    out: list[FormingPass] = []
    issues: list[Issue] = []
    for step in order:
        is_male_die = operation.die is not None and operation.die.kind == "male"
        final_pass = _final_pass(tree, step, mesh, thickness, is_male_die)
        angle = wall_angle(final_pass.vertices, final_pass.faces)
        if angle >= UPRIGHT_WALL_ANGLE_RAD:
            issues.append(_upright_issue(step.feature, angle))
            continue
        shapes = _intermediate_passes(final_pass, pass_angles(angle, operation, metal)[:-1], thickness)
        repeated = [shape for shape in shapes for _ in range(operation.repeats)]
        for number, shape in enumerate(repeated, start=1):
            name = f"f{step.feature}" + (f"_p{number}" if len(repeated) > 1 else "")
            out.append(dataclasses.replace(shape, name=name, number=number))
    if issues:
        raise TandemError(issues)
    return tuple(out)


def pass_angles(angle: float, operation: Forming, metal: SheetMetal) -> tuple[float, ...]:
    """Return the wall angles [rad] of the passes over a feature; the last one is its own wall angle.

    The user's own angles are used as far as they are below that of the feature. If the user states none, the
    angles decrease from that of the feature by the operation's step, until one is within the metal's limit
    for a single pass. In ADSIF the sheet is formed once, and over a male die nothing holds an intermediate
    shape, so there is one pass.

    Args:
        angle: Wall angle [rad] of the feature.
        operation: Operation.
        metal: Sheet metal.
    """
    if operation.mode == "adsif" or (operation.die is not None and operation.die.kind == "male"):
        return (angle,)
    if operation.passes != "auto":
        return (*(deg * DEG for deg in operation.passes if deg * DEG < angle - ANGLE_TOLERANCE_RAD), angle)
    step = operation.angle_step_deg * DEG
    limit = metal.wall_angle_limit(operation.mode in SUPPORTED_MODES)
    count = max(math.ceil((angle - limit - ANGLE_TOLERANCE_RAD) / step), 0)
    return tuple(angle - step * k for k in range(count, -1, -1) if angle - step * k > ANGLE_TOLERANCE_RAD)


def pass_issues(
    passes: Sequence[FormingPass], thickness: float, operation: Forming, metal: SheetMetal
) -> tuple[Issue, ...]:
    """Return warnings about passes: walls that may tear in one pass, and similar trials that failed.

    A wall may tear if it is steeper than `max_wall_angle` after the steepest previous pass over the feature.
    For each feature the most similar failed trial is reported, if there is one.
    """
    issues: list[Issue] = []
    limit = metal.wall_angle_limit(operation.mode in SUPPORTED_MODES)
    for feature in dict.fromkeys(forming_pass.feature for forming_pass in passes):
        feature_passes = [forming_pass for forming_pass in passes if forming_pass.feature == feature]
        angles = [wall_angle(forming_pass.vertices, forming_pass.faces) for forming_pass in feature_passes]
        previous = 0.0
        for forming_pass, angle in zip(feature_passes, angles, strict=True):
            if angle > max_wall_angle(previous, operation, metal):
                automatic_angles = pass_angles(
                    angles[-1], operation.model_copy(update={"passes": "auto"}), metal
                )
                issues.append(_tear_issue(forming_pass, angle, previous, limit, automatic_angles))
            previous = max(previous, angle)
        depth = abs(feature_passes[-1].end - feature_passes[-1].start)
        trial = trial_warning(metal.family, thickness, angles[-1], depth, operation.mode)
        if trial is not None:
            issues.append(dataclasses.replace(trial, field=f"feature {feature}"))
    return tuple(issues)


def max_wall_angle(previous: float, operation: Forming, metal: SheetMetal) -> float:
    """Return the steepest wall [rad] that a pass may form over a shape without a warning.

    It is the metal's limit for a single pass, or one angle step and 1 deg of tolerance more than the shape,
    whichever is larger.

    Args:
        previous: Wall angle [rad] of the shape; 0 for the flat sheet.
        operation: Operation.
        metal: Sheet metal.
    """
    limit = metal.wall_angle_limit(operation.mode in SUPPORTED_MODES)
    return max(
        limit + ANGLE_TOLERANCE_RAD, previous + max(MAX_ANGLE_STEP_RAD, operation.angle_step_deg * DEG) + DEG
    )


@memoized
def _final_pass(tree: FeatureTree, step: OrderStep, mesh: Mesh, thickness: float, male: bool) -> FormingPass:
    """Return the last pass over a feature, whose face is that of the part.

    Over a ``male`` die the tool is on the side to which the feature protrudes. It moves from the feature's
    end, where the sheet first lies on the die, outward to its start while the clamp sinks.
    """
    feature = tree.feature(step.feature)
    side = feature.sign if male else -feature.sign
    rise = step.shift + (thickness if side > 0 else 0.0)
    face = feature_face(mesh, tree, step.feature, rise)
    start, end = feature.start + rise, feature.end + rise
    return FormingPass(
        name=f"f{step.feature}",
        feature=step.feature,
        number=1,
        side=side,
        vertices=face.vertices,
        faces=face.faces,
        thickness=thickness_map(face.vertices, face.faces, thickness),
        start=end if male else start,
        end=start if male else end,
        region=feature.region,
    )


def _intermediate_passes(final: FormingPass, angles: Sequence[float], thickness: float) -> list[FormingPass]:
    """Return the passes through shapes of at most ``angles`` [rad], in turn, and then the final pass."""
    if not angles:
        return [final]
    face = Mesh(final.vertices, final.faces)
    depth, areas = depth_areas(face, final.side, final.start, final.end)
    earlier: list[AngleLimitedShape] = []
    out = []
    for angle in angles:
        shape = limit_wall_angle(depth, areas, angle)
        face_mesh = shape_face(shape, final.side, final.start)
        level = face_mesh.vertices[:, 2]
        out.append(
            dataclasses.replace(
                final,
                vertices=face_mesh.vertices,
                faces=face_mesh.faces,
                thickness=_min_thickness(face_mesh, final, earlier, thickness),
                end=float(level.min() if final.side > 0 else level.max()),
            )
        )
        earlier.append(shape)
    return [*out, dataclasses.replace(final, thickness=_min_thickness(face, final, earlier, thickness))]


def _min_thickness(
    face: Mesh, final: FormingPass, earlier: Sequence[AngleLimitedShape], thickness: float
) -> FloatArray:
    """Return the thickness (V,) [m] of a face by the sine law, and at most what earlier shapes have left."""
    minimum = thickness_map(face.vertices, face.faces, thickness)
    depth = final.side * (final.start - face.vertices[:, 2])
    for shape in earlier:
        is_limited = shape.limits_depth(face.vertices[:, :2], depth)
        minimum = np.where(is_limited, np.minimum(minimum, thickness * math.cos(shape.angle)), minimum)
    return np.asarray(minimum)


def _upright_issue(feature: int, angle: float) -> Issue:
    """Return the error that a feature has a wall of ``angle`` [rad], for which no sheet would be left."""
    return Issue(
        "forming.wall_angle",
        f"feature {feature}: a wall of {angle / DEG:.1f} deg, allowed below "
        f"{UPRIGHT_WALL_ANGLE_RAD / DEG:.0f} deg; the sine law leaves no sheet at 90 deg, and an undercut "
        "tore in trials",
        field="part",
        **measurement(angle / DEG, UPRIGHT_WALL_ANGLE_RAD / DEG, "deg"),
        hint="make the wall less steep, or use another process",
    )


def _tear_issue(
    forming_pass: FormingPass, angle: float, previous: float, limit: float, automatic_angles: Sequence[float]
) -> Issue:
    """Return the warning that the sheet may tear in a pass because its wall is too steep.

    Args:
        forming_pass: The pass.
        angle: Wall angle [rad] of the pass.
        previous: Wall angle [rad] of the shape from which it starts, 0 for the flat sheet.
        limit: Wall angle [rad] that the metal allows in one pass.
        automatic_angles: Wall angles [rad] that ``passes: auto`` would form one after the other.
    """
    shapes = " and ".join(f"{pass_angle / DEG:.1f}" for pass_angle in automatic_angles)
    hint = f"use passes: auto, which forms walls of {shapes} deg one after the other, or give such angles"
    if len(automatic_angles) == 1:
        hint = "make the wall less steep: in this mode it is formed in one pass"
    pass_text = "in one pass" if previous == 0.0 else f"in one pass from a shape of {previous / DEG:.1f} deg"
    return Issue(
        "forming.wall_angle",
        f"pass {forming_pass.name}: a wall of {angle / DEG:.1f} deg {pass_text}; the metal allows "
        f"{limit / DEG:.1f} deg in one pass and about {MAX_ANGLE_STEP_RAD / DEG:.0f} deg more with each "
        "further pass",
        Severity.WARNING,
        **measurement(angle / DEG, limit / DEG, "deg"),
        hint=hint,
        accepted=False,
    )
