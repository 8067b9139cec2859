"""The passes of a part: over each feature one, or several where its walls are too steep for one.

**Thickness from pass to pass.** A shape in between is moved from the flat along z only, as the
final one is, so the change of area of a place from pass to pass, A(k-1) / A(k), telescopes to that
from the flat: t0 cos(a), the sine law of the shape that the place has now. Several passes give no
thicker wall than one in this model; what they gain in practice, sheet drawn from the floor and a
higher strain at fracture, it does not know, so it errs to the safe side. One thing it carries:
sheet once thinned does not thicken where a later pass makes it less steep (the wall of a shape in
between becomes floor). So each place keeps the least thickness of all passes over it.

**Trials** of forming with two robots, from `data/forming_trials.yaml`, and the warnings that they
give. They are single trials of one lab with metals of unstated alloy: hints of what may go wrong,
no limits.
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
from planner.issues import Issue, Severity, TandemError
from planner.processes.forming.plan.contact import Pass
from planner.processes.forming.plan.features.pass_shape import Limited, alone, depth_areas, face_of, limited
from planner.processes.forming.plan.features.tree import FeatureTree, OrderStep
from planner.processes.forming.plan.operation import Forming
from planner.processes.forming.plan.sheet_mechanics import steepest, thickness_map
from planner.runtime.memoize import memoized

_TRIALS_FILE: Final = Path(__file__).resolve().parents[3] / "data" / "forming_trials.yaml"
"""Published trials of forming, each with its source."""

TRIAL_MODES: Final = {"spif": "isf", "dpif_p": "dpif_p", "dpif_l": "dpif_l", "dsif": "dpif_l"}
"""The trials' mode that is likest to a mode of forming; the others have none."""
TRIAL_CAUSES: Final = {
    "force": "the robot stopped with a collision error, from the forming force,",
    "border_tear": "the sheet tore along the border",
    "local_tear": "the sheet tore at the forming tool",
    "completed": "the part was completed",
}
"""What stopped a trial, in words."""
TRIAL_MODE_NAMES: Final = {
    "isf": "no support",
    "dpif_p": "support on the border",
    "dpif_l": "support opposite the tool",
}
"""The trials' modes in words."""
ANGLE_SLACK: Final = 5.0 * DEG
"""A part is like a trial where its wall angle is no smaller than the trial's less this [rad]."""
DEPTH_SLACK: Final = 0.9
"""A part is like a trial where its depth is at least this share of the trial's."""
THICKNESS_SLACK: Final = 1.25
"""A part is like a trial where its thickness is no worse than the trial's by this factor."""


@dataclasses.dataclass(frozen=True)
class Trial:
    """One trial. Lengths [m], ``angle`` [rad], ``feed`` [m/s], ``duration`` [s]. ``mode`` is isf, dpif_p or
    dpif_l, ``cause`` what stopped it at ``depth``: force, border_tear, local_tear or completed.
    ``second_depth`` [m] of a stage the other way inside the first."""

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
    former: str
    supporter: str | None
    support_tool: str | None
    lubricant: str
    note: str

    @property
    def failed(self) -> bool:
        """Whether something else than its end stopped it."""
        return self.cause != "completed"


@functools.lru_cache(maxsize=1)
def trials() -> tuple[Trial, ...]:
    """All trials, in the order of their source."""
    with _TRIALS_FILE.open(encoding="utf-8") as stream:
        return tuple(_trial(entry) for entry in yaml.safe_load(stream)["trials"])


def nearest_failed(family: str, thickness: float, angle: float, depth: float, mode: str) -> Trial | None:
    """The failed trial that says most of such a part; None if no trial is like it.

    ``family`` of the sheet metal, ``thickness`` [m], steepest wall ``angle`` [rad], ``depth`` [m],
    ``mode`` of forming. A trial is like it if the metal is of the same family, the part as steep and deep at
    least, and its sheet no thinner than one that met too much force, or no thicker than one that tore.
    """
    if mode not in TRIAL_MODES:
        return None
    like = [
        trial
        for trial in trials()
        if trial.failed
        and trial.family == family
        and trial.mode == TRIAL_MODES[mode]
        and angle >= trial.angle - ANGLE_SLACK
        and depth >= DEPTH_SLACK * trial.depth
        and _as_bad(trial, thickness)
    ]
    return min(like, key=lambda trial: _distance(trial, thickness, angle, depth), default=None)


def warning(family: str, thickness: float, angle: float, depth: float, mode: str) -> Issue | None:
    """A warning (forming.trial) of what stopped the nearest failed trial; arguments as `nearest_failed`."""
    trial = nearest_failed(family, thickness, angle, depth, mode)
    if trial is None:
        return None
    helper = f", {trial.support_tool}" if trial.support_tool else ""
    part = (
        f"{thickness / MM:g} mm {family.replace('_', ' ')}, {angle / DEG:.0f} deg, {depth / MM:.0f} mm deep"
    )
    return Issue(
        "forming.trial",
        f"{part}: in a trial ({trial.name}: {TRIAL_MODE_NAMES[trial.mode]}{helper}, "
        f"{trial.thickness / MM:g} mm, "
        f"{trial.angle / DEG:.0f} deg, {trial.lubricant}) {TRIAL_CAUSES[trial.cause]} at a depth of "
        f"{trial.depth / MM:.0f} mm; one trial in one lab, with metal of unstated alloy: a hint, no limit",
        Severity.WARNING,
        **measurement(depth / MM, trial.depth / MM, "mm"),
        hint=f"form a test piece first; of the trial: {trial.note}",
    )


def _as_bad(trial: Trial, thickness: float) -> bool:
    if trial.cause == "force":  # thicker sheet takes more force
        return thickness >= trial.thickness / THICKNESS_SLACK
    return thickness <= trial.thickness * THICKNESS_SLACK  # thinner sheet tears sooner


def _distance(trial: Trial, thickness: float, angle: float, depth: float) -> float:
    return math.hypot(
        math.log(thickness / trial.thickness),
        (angle - trial.angle) / (15.0 * DEG),
        math.log(depth / trial.depth),
    )


def _trial(entry: dict[str, Any]) -> Trial:
    second = entry.get("second_depth_mm")
    return Trial(
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
        former=entry["former"],
        supporter=entry["supporter"],
        support_tool=entry["support_tool"],
        lubricant=entry["lubricant"],
        note=entry["note"],
    )


SUPPORTED_MODES: Final = frozenset({"dsif", "dpif_l", "adsif"})
"""Modes with a tool opposite the forming one."""
UPRIGHT_WALL: Final = 89.0 * DEG
"""Walls [rad] from which on the sine law leaves nothing of the sheet."""
SAME_ANGLE: Final = 0.1 * DEG
"""Wall angles [rad] that differ by less are one: no pass is made for so little."""
LARGEST_ANGLE_STEP: Final = 15.0 * DEG
"""Angle [rad] from shape to shape beyond which walls tore in trials (30 deg tore, 15 deg did not)."""


def passes(
    tree: FeatureTree,
    order: Sequence[OrderStep],
    mesh: Mesh,
    thickness: float,
    operation: Forming,
    metal: SheetMetal,
) -> tuple[Pass, ...]:
    """All passes in the order of forming, in the sheet's frame.

    ``mesh``: lower face of the part, of which ``tree`` was built. The sheet of ``thickness`` [m] is as thick
    along z everywhere, so the face that the tool touches, for features that go down, is the mesh moved up by
    it. Raises ``TandemError`` (forming.wall_angle) for upright walls.
    """
    out: list[Pass] = []
    wrong: list[Issue] = []
    for step in order:
        male = operation.die is not None and operation.die.kind == "male"
        final = _final(tree, step, mesh, thickness, male)
        angle = steepest(final.vertices, final.faces)
        if angle >= UPRIGHT_WALL:
            wrong.append(_upright(step.feature, angle))
            continue
        shapes = _shapes(final, pass_angles(angle, operation, metal)[:-1], thickness)
        repeated = [shape for shape in shapes for _ in range(operation.repeats)]
        for number, shape in enumerate(repeated, start=1):
            name = f"f{step.feature}" + (f"_p{number}" if len(repeated) > 1 else "")
            out.append(dataclasses.replace(shape, name=name, number=number))
    if wrong:
        raise TandemError(wrong)
    return tuple(out)


def pass_angles(angle: float, operation: Forming, metal: SheetMetal) -> tuple[float, ...]:
    """Wall angles [rad] of the shapes on the way to a feature whose wall is ``angle`` [rad], itself the last.

    Where the user gives none, they go up by the operation's step from an angle that one pass may have. In
    ADSIF the sheet is formed once, and over a male die there is nothing to hold a shape between, so there is
    one.
    """
    if operation.mode == "adsif" or (operation.die is not None and operation.die.kind == "male"):
        return (angle,)
    if operation.passes != "auto":
        return (*(a * DEG for a in operation.passes if a * DEG < angle - SAME_ANGLE), angle)
    step = operation.angle_step_deg * DEG
    limit = metal.wall_angle_limit(operation.mode in SUPPORTED_MODES)
    count = max(math.ceil((angle - limit - SAME_ANGLE) / step), 0)
    return tuple(angle - step * k for k in range(count, -1, -1) if angle - step * k > SAME_ANGLE)


def pass_issues(
    found: Sequence[Pass], thickness: float, operation: Forming, metal: SheetMetal
) -> tuple[Issue, ...]:
    """Warnings of ``found`` passes: walls that one pass may tear, and failed trials that are like them."""
    issues: list[Issue] = []
    limit = metal.wall_angle_limit(operation.mode in SUPPORTED_MODES)
    for feature in dict.fromkeys(one.feature for one in found):
        mine = [one for one in found if one.feature == feature]
        angles = [steepest(one.vertices, one.faces) for one in mine]
        before = 0.0
        for one, angle in zip(mine, angles, strict=True):
            if angle > stood(before, operation, metal):
                auto = pass_angles(angles[-1], operation.model_copy(update={"passes": "auto"}), metal)
                issues.append(_torn(one, angle, before, limit, auto))
            before = max(before, angle)
        deep = abs(mine[-1].end - mine[-1].start)
        trial = warning(metal.family, thickness, angles[-1], deep, operation.mode)
        if trial is not None:
            issues.append(dataclasses.replace(trial, field=f"feature {feature}"))
    return tuple(issues)


def stood(before: float, operation: Forming, metal: SheetMetal) -> float:
    """The steepest wall [rad] that a pass may have over a shape whose walls are ``before`` [rad], 0 for the
    flat sheet."""
    limit = metal.wall_angle_limit(operation.mode in SUPPORTED_MODES)
    return max(limit + SAME_ANGLE, before + max(LARGEST_ANGLE_STEP, operation.angle_step_deg * DEG) + DEG)


@memoized
def _final(tree: FeatureTree, step: OrderStep, mesh: Mesh, thickness: float, male: bool) -> Pass:
    """The last pass over a feature.

    Over a ``male`` die the tool is on the side to which the feature stands out, and goes from its end, where
    the sheet lies on the die first, outward to its start while the clamp sinks.
    """
    feature = tree.feature(step.feature)
    side = feature.sign if male else -feature.sign
    rise = step.shift + (thickness if side > 0 else 0.0)
    face = alone(mesh, tree, step.feature, rise)
    start, end = feature.start + rise, feature.end + rise
    return Pass(
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


def _shapes(final: Pass, angles: Sequence[float], thickness: float) -> list[Pass]:
    """Shapes of at most ``angles`` [rad] in turn, and the final one, with the thickness that each place has
    then."""
    if not angles:
        return [final]
    face = Mesh(final.vertices, final.faces)
    depth, areas = depth_areas(face, final.side, final.start, final.end)
    earlier: list[Limited] = []
    out = []
    for angle in angles:
        shape = limited(depth, areas, angle)
        between = face_of(shape, final.side, final.start)
        level = between.vertices[:, 2]
        out.append(
            dataclasses.replace(
                final,
                vertices=between.vertices,
                faces=between.faces,
                thickness=_kept_thin(between, final, earlier, thickness),
                end=float(level.min() if final.side > 0 else level.max()),
            )
        )
        earlier.append(shape)
    return [*out, dataclasses.replace(final, thickness=_kept_thin(face, final, earlier, thickness))]


def _kept_thin(face: Mesh, final: Pass, earlier: Sequence[Limited], thickness: float) -> FloatArray:
    thick = thickness_map(face.vertices, face.faces, thickness)
    depth = final.side * (final.start - face.vertices[:, 2])
    for shape in earlier:
        held = shape.holds_back(face.vertices[:, :2], depth)
        thick = np.where(held, np.minimum(thick, thickness * math.cos(shape.angle)), thick)
    return np.asarray(thick)


def _upright(feature: int, angle: float) -> Issue:
    return Issue(
        "forming.wall_angle",
        f"feature {feature}: a wall of {angle / DEG:.1f} deg, allowed below {UPRIGHT_WALL / DEG:.0f} deg; "
        "by the "
        "sine law nothing is left of the sheet at 90 deg, and an undercut tore in trials",
        field="part",
        **measurement(angle / DEG, UPRIGHT_WALL / DEG, "deg"),
        hint="make the wall lean, or form it in another way",
    )


def _torn(one: Pass, angle: float, before: float, limit: float, auto: Sequence[float]) -> Issue:
    shapes = " and ".join(f"{a / DEG:.1f}" for a in auto)
    hint = f"take passes: auto, which forms walls of {shapes} deg one after the other, or give such angles"
    if len(auto) == 1:
        hint = "make the wall less steep: in this mode it is formed in one pass"
    how = "in one pass" if before == 0.0 else f"in one pass from a shape of {before / DEG:.1f} deg"
    return Issue(
        "forming.wall_angle",
        f"pass {one.name}: a wall of {angle / DEG:.1f} deg {how}; the metal is good for "
        f"{limit / DEG:.1f} deg at once and about {LARGEST_ANGLE_STEP / DEG:.0f} deg more with each "
        "further pass",
        Severity.WARNING,
        **measurement(angle / DEG, limit / DEG, "deg"),
        hint=hint,
        accepted=False,
    )
