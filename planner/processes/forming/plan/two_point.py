"""The die and the blank holder of two point forming.

**Die** (``tpif``), fixed: it may not protrude into the required part, and a full die must be where the part
is.

**Blank holder** over a male die, which sinks by one step at each pulse of a signal. All positions are in the
frame of the die, which does not move. In it the sheet's frame is the position of the sheet at the end. The
clamp starts with the flat sheet on the top of the die. The tool moves outward and down from there, and the
surrounding flat sinks with it: the clamp is as low as the lowest level that the tool's tip has reached,
within one step. A pulse is given at a stop where it brings the clamp nearer to the tip, half a step before or
after it, and up to a step ahead before a move that goes down by more.

Not checked: whether the holder has moved when the tool continues (it has the time of one pulse, on and off,
and gives no feedback), and how the sheet bends between the tool and a rim that is up to one step off.
"""

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
import shapely

from planner.geometry.arrays import FloatArray, IntArray, dots
from planner.geometry.mesh import TriangleMesh, bisect_triangles, face_normals
from planner.geometry.mesh_queries import MeshDistance
from planner.geometry.units import DEG, MM, measurement
from planner.issue_codes import format_message
from planner.issues import Issue, Severity
from planner.processes.forming.claims import SinksHolder
from planner.processes.forming.plan.contact import FormingPass, FormingToolPath
from planner.processes.forming.plan.operation import Die
from planner.processes.forming.plan.process_plan import FormingWork, forming_segment
from planner.targets import TargetAction

DIE_SPACING_M: Final = 3e-3
"""Spacing [m] of the points of a face that are compared with a die."""
MAX_SUPPORT_DISTANCE_M: Final = 0.5e-3
"""Maximum distance [m] of a full die from the part at which it supports the part."""
MAX_DIE_PROTRUSION_M: Final = 10e-3
"""A die that protrudes this far [m] above the whole part has a wrong unit or position; nothing else is
checked.
"""
MAX_UNSUPPORTED_FRACTION: Final = 0.02
"""Fraction of the walls that a full die may leave unsupported without a warning."""
_MAX_PIECES: Final = 20_000
"""Maximum number of pieces into which a face is divided for its points."""
_MIN_WALL_ANGLE_RAD: Final = 2.0 * DEG
"""Walls flatter than this [rad] need no die."""


def die_issues(
    passes: Sequence[FormingPass], die: Die, mesh: TriangleMesh, thickness: float, tolerance: float
) -> tuple[Issue, ...]:
    """Check a die whose mesh is in the sheet's frame.

    Reports forming.die_gouge (error) if the die protrudes into the part's far face by more than the
    tolerance, and forming.die_far (warning) if a full die is away from the walls.

    Args:
        passes: Final pass of each feature.
        die: Die of the operation.
        mesh: Mesh of the die.
        thickness: Thickness [m] of the sheet.
        tolerance: Allowed protrusion [m].
    """
    pieces, _ = bisect_triangles(mesh.vertices[mesh.faces], DIE_SPACING_M, _MAX_PIECES)
    points = np.concatenate([pieces.mean(axis=1), mesh.vertices])
    out: list[Issue] = []
    for forming_pass in passes:
        shift = np.array([0.0, 0.0, -forming_pass.side * thickness])
        far_face = TriangleMesh(forming_pass.vertices + shift, forming_pass.faces)
        gouges = list(_gouge_issues(forming_pass, far_face, points, tolerance))
        out += gouges
        if die.full and not gouges:
            out += _distance_issues(forming_pass, far_face, mesh)
    return tuple(out)


def _gouge_issues(
    forming_pass: FormingPass, far_face: TriangleMesh, points: FloatArray, tolerance: float
) -> Iterator[Issue]:
    """Report where the die protrudes most into the far face of a pass, if by more than ``tolerance`` [m].

    ``points`` (P, 3) [m] represent the die. A die that protrudes above the whole part by more than
    MAX_DIE_PROTRUSION_M is reported with that height, because its unit or position is wrong.
    """
    inside = shapely.Polygon(forming_pass.region[:, :2]).buffer(DIE_SPACING_M)
    points = points[shapely.contains_xy(inside, points[:, 0], points[:, 1])]
    if not len(points):
        return
    depth = forming_pass.side * points[:, 2] - float((forming_pass.side * far_face.vertices[:, 2]).max())
    if depth.max() <= MAX_DIE_PROTRUSION_M:
        distance, face = MeshDistance(far_face, DIE_SPACING_M).distance(points)
        normals = face_normals(far_face)[face]
        above_face = forming_pass.side * dots(points - far_face.vertices[far_face.faces[face, 0]], normals)
        depth = np.where(above_face > 0.0, distance, 0.0)
    k = int(np.argmax(depth))
    if depth[k] <= tolerance:
        return
    x, y, z = (float(value) / MM for value in points[k])
    message = (
        f"feature {forming_pass.feature}: the die protrudes {depth[k] / MM:.2f} mm into the part "
        f"at ({x:.1f}, "
    )
    message += (
        f"{y:.1f}, {z:.1f}) mm, allowed is {tolerance / MM:.2f} mm; check its unit, or lower it by that "
    )
    message += "distance to leave space for the sheet's thickness"
    yield Issue(
        "forming.die_gouge", message, field="die", **measurement(float(depth[k]) / MM, tolerance / MM, "mm")
    )


def _distance_issues(
    forming_pass: FormingPass, far_face: TriangleMesh, mesh: TriangleMesh
) -> Iterator[Issue]:
    """Warn if a full die does not support a larger fraction of the walls than MAX_UNSUPPORTED_FRACTION.

    A wall is supported if the die is within MAX_SUPPORT_DISTANCE_M of it. ``far_face`` is the face of the
    sheet on the side of the die, and ``mesh`` is the die.
    """
    normals = face_normals(far_face)
    is_wall = np.arccos(np.clip(normals[:, 2], -1.0, 1.0)) > _MIN_WALL_ANGLE_RAD
    pieces, _ = bisect_triangles(far_face.vertices[far_face.faces[is_wall]], DIE_SPACING_M, _MAX_PIECES)
    points = pieces.mean(axis=1)
    double_area = np.linalg.norm(np.cross(pieces[:, 1] - pieces[:, 0], pieces[:, 2] - pieces[:, 0]), axis=1)
    distance, _ = MeshDistance(mesh, DIE_SPACING_M).distance(points)
    fraction = float(double_area[distance > MAX_SUPPORT_DISTANCE_M].sum() / double_area.sum())
    if fraction <= MAX_UNSUPPORTED_FRACTION:
        return
    worst_index = int(np.argmax(distance))
    x, y, z = (float(value) / MM for value in points[worst_index])
    yield Issue(
        "forming.die_far",
        format_message(
            "forming.die_far",
            feature=forming_pass.feature,
            max_distance_mm=MAX_SUPPORT_DISTANCE_M / MM,
            unsupported_percent=100 * fraction,
            distance_mm=distance[worst_index] / MM,
            x_mm=x,
            y_mm=y,
            z_mm=z,
        ),
        Severity.WARNING,
        field="die",
        **measurement(float(distance[worst_index]) / MM, MAX_SUPPORT_DISTANCE_M / MM, "mm"),
        accepted=False,
    )


PULSE_TIME_S: Final = 0.1
"""Time [s] that the signal is on, and off before the next pulse."""
LEVEL_TOLERANCE_M: Final = 1e-6
"""Levels that differ by less [m] are the same."""


def holder_sinks(work: FormingWork) -> bool:
    """Return whether the clamp sinks while the sheet is formed."""
    return work.operation.die is not None and work.operation.die.holder == "sinking"


def holder_step(work: FormingWork) -> float:
    """Return the distance [m] by which a pulse lowers the clamp: the holder's step, else the step-down."""
    op = work.operation
    step_mm = None if op.die is None else op.die.step_mm
    return (step_mm if step_mm is not None else op.stepdown_mm or 0.0) * MM


def holder_claim(work: FormingWork) -> SinksHolder | None:
    """Return the claim on the holder's signal in the first pass, or None if the clamp does not sink."""
    die = work.operation.die
    if die is None or not holder_sinks(work):
        return None
    forming_pass = work.passes[0]
    arm = work.forming_arm(forming_pass)
    radius = work.heads[arm].radius
    return SinksHolder(
        forming_segment(forming_pass),
        arm,
        forming_pass.side,
        radius,
        die.signal,
        forming_pass.start,
        forming_pass.end,
        holder_step(work),
        PULSE_TIME_S,
    )


def pulse_counts(forming_pass: FormingPass, path: FormingToolPath, radius: float, step: float) -> IntArray:
    """Return the number of pulses (N,) at each target of a pass, each of which lowers the clamp by a step.

    In total there are as many pulses as whole steps fit into the depth of the pass. The clamp stays within
    one step of the lowest level that the tip has reached, if moves go down by at most one step; `step_issues`
    reports other moves.

    Args:
        forming_pass: Pass.
        path: Its tool path.
        radius: Radius [m] of the ball.
        step: Distance [m] by which a pulse lowers the clamp.
    """
    depth = _depth_reached(forming_pass, path, radius)
    next_depth = np.append(depth[1:], depth[-1])  # at the end of the move that follows each target
    ideal = np.floor(0.5 * (depth + next_depth) / step + 0.5)
    # the clamp is at most a step above the tip after the move, and at most a step below it before the move
    minimum = np.ceil((next_depth - LEVEL_TOLERANCE_M) / step - 1.0)
    maximum = np.floor((depth + LEVEL_TOLERANCE_M) / step + 1.0)
    pulses = np.clip(np.clip(ideal, minimum, maximum), 0.0, _whole_steps(forming_pass, step))
    pulses[-1] = _whole_steps(forming_pass, step)
    return np.diff(np.maximum.accumulate(pulses), prepend=0.0).astype(np.int64)


def holder_issues(work: FormingWork) -> Iterator[Issue]:
    """Report dies and holders that do not go together, before paths are computed (forming.holder).

    A male die needs a holder that sinks, and a part with a single feature. A female die needs a fixed holder.
    """
    die = work.operation.die
    if die is None:
        return
    if die.kind == "male" and die.holder == "fixed":
        message = "a male die penetrates the flat sheet, whose clamp is fixed at the level of the part's rim"
        hint = "state holder: sinking, so that the clamp starts at the die's top"
        yield Issue("forming.holder", message, field="die.holder", hint=hint)
    if die.kind == "female" and die.holder == "sinking":
        message = "the sheet's rim lies on a female die; a clamp that sinks would bend it over the die's edge"
        yield Issue("forming.holder", message, field="die.holder", hint="state holder: fixed")
    features = sorted({forming_pass.feature for forming_pass in work.passes})
    if holder_sinks(work) and len(features) > 1:
        message = (
            f"the part has {len(features)} features, allowed is 1, because all of them would have to be "
            "formed level by level while the clamp sinks"
        )
        hint = "form one feature over a male die, and the others in a separate job"
        yield Issue("forming.holder", message, field="die", value=len(features), limit=1, hint=hint)


def step_issues(work: FormingWork, paths: Sequence[tuple[FormingPass, FormingToolPath]]) -> Iterator[Issue]:
    """Report where the clamp cannot stay within a step of the tool, or does not reach the rim's level.

    The first is an error at the worst target. The second is a warning if the depth of the pass is not a whole
    number of steps. Without a holder that sinks there is nothing to report.
    """
    if not holder_sinks(work):
        return
    forming_pass, path = paths[0]
    step = holder_step(work)
    depth = _depth_reached(forming_pass, path, work.heads[work.forming_arm(forming_pass)].radius)
    clamp_depth = step * np.cumsum(
        pulse_counts(forming_pass, path, work.heads[work.forming_arm(forming_pass)].radius, step)
    )
    next_depth = np.append(depth[1:], depth[-1])
    distance = np.maximum(np.abs(depth - clamp_depth), np.abs(next_depth - clamp_depth))
    worst_index = int(np.argmax(distance))
    if distance[worst_index] > step + 2.0 * LEVEL_TOLERANCE_M:
        message = (
            f"pass {forming_pass.name}: at z = "
            f"{(forming_pass.start - forming_pass.side * depth[worst_index]) / MM:.2f} mm the tool goes "
            f"{(next_depth[worst_index] - depth[worst_index]) / MM:.2f} mm down in one move, so that the "
            f"clamp is {distance[worst_index] / MM:.2f} mm away from it, allowed is one of its steps, "
            f"{step / MM:g} mm"
        )
        hint = "use path: helical, or larger steps of the holder (die.step_mm)"
        yield Issue("forming.holder_step", message, field="die.step_mm", index=worst_index, hint=hint)
    remainder = abs(forming_pass.start - forming_pass.end) - step * _whole_steps(forming_pass, step)
    if remainder > 0.02 * MM:
        message = (
            f"pass {forming_pass.name}: the depth of {abs(forming_pass.start - forming_pass.end) / MM:.2f} "
            f"mm is not a whole number of steps of {step / MM:g} mm, so the clamp ends {remainder / MM:.2f} "
            "mm higher than the part's rim"
        )
        hint = "choose a step of the holder (die.step_mm) that divides the depth"
        yield Issue("forming.holder_step", message, Severity.WARNING, field="die.step_mm", hint=hint)


def holder_actions(
    work: FormingWork, forming_pass: FormingPass, path: FormingToolPath, first: int
) -> Iterator[TargetAction]:
    """Yield the pulses at the targets of the first pass.

    Args:
        work: Work of the operation.
        forming_pass: First pass.
        path: Its tool path.
        first: Index of its first target.
    """
    die = work.operation.die
    if die is None or not holder_sinks(work):
        return
    count = pulse_counts(
        forming_pass, path, work.heads[work.forming_arm(forming_pass)].radius, holder_step(work)
    )
    for target in np.flatnonzero(count):
        for _ in range(count[target]):
            yield TargetAction(first + int(target), "on", signal=die.signal, switches_power=False)
            yield TargetAction(first + int(target), "wait", seconds=PULSE_TIME_S)
            yield TargetAction(first + int(target), "off", signal=die.signal, switches_power=False)
            yield TargetAction(first + int(target), "wait", seconds=PULSE_TIME_S)


def _depth_reached(forming_pass: FormingPass, path: FormingToolPath, radius: float) -> FloatArray:
    """Return the maximum depth (N,) [m] of the tip from the pass's start, up to each target; 0 or more."""
    tip = forming_pass.side * (forming_pass.start - path.forming_centre[:, 2]) + radius
    return np.asarray(np.maximum(np.maximum.accumulate(tip), 0.0))


def _whole_steps(forming_pass: FormingPass, step: float) -> int:
    """Return the number of whole steps in the depth of a pass; 0.001 of a step covers rounding."""
    return int(np.floor(abs(forming_pass.start - forming_pass.end) / step + 1e-3))
