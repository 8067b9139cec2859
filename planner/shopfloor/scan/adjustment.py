"""Adjustment of tools by a scan: each target moves along z by the deviation of the previous part.

A part was formed with the commanded path C. Its scan deviates from the nominal face by d along the normal. So
it is too shallow by e = d / cos a along z on a wall of angle a. The next part is formed with

    C' = C + g (e + m),

where g is the gain (displacement adjustment, as in springback compensation of dies) and m the additional
springback of a part that is formed as planned (`planner.shopfloor.scan.forming_rate`), which follows from C,
e and the wall above. Both are averaged over the width of the ball, and the slope of the result is limited as
in every springback file. A pass that forms an intermediate face is not visible in the scan, so its tools move
as before.
"""

import dataclasses
import json
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, unit
from planner.geometry.curves import arc_length
from planner.geometry.mesh_queries import MeshDistance
from planner.geometry.units import MM
from planner.issues import issue_error
from planner.processes.forming.plan.contact import FormingPass, FormingToolPath
from planner.processes.forming.plan.operation import Springback
from planner.processes.forming.plan.process_plan import FormingWork
from planner.processes.forming.plan.springback.compensation import (
    ShiftedPath,
    moving_average,
    require_compensation_mode,
    shift_at_targets,
    shift_path,
)
from planner.processes.forming.plan.springback.compensation_file import (
    FILE_VERSIONS,
    SpringbackFile,
    passes_text,
    path_lines,
    require_shift_limits,
    with_checksum,
)
from planner.shopfloor.align.probing import ProbedPoints
from planner.shopfloor.scan import forming_rate
from planner.shopfloor.scan.cloud import Cloud
from planner.shopfloor.scan.deviation import SPACING, Deviation
from planner.shopfloor.scan.registration import ScanPose

ON_FACE: Final = 0.1 * MM
"""Maximum median distance [m] of a pass's contact from the nominal face, if the pass forms that face."""
MIN_SEEN_FRACTION: Final = 0.7
"""Minimum fraction of a pass's path along which the scan shows the part."""
DECIMALS: Final = 9
"""Decimals of the pose of a scan: of metres and of cosines."""


@dataclasses.dataclass(frozen=True, eq=False)
class AdjustedPass:
    """An adjusted pass with N targets.

    Attributes:
        tool_path: Its shifted path for the next part.
        point: Points of contact (N, 3) [m].
        shallowness: By how much (N,) [m] the part is too shallow along z; NaN where the scan does not show
            it.
        foretold: Predicted shallowness (N,) [m] of the next part.
        seen: Whether the scan shows the face of this pass, so that its path is adjusted.
    """

    tool_path: ShiftedPath
    point: FloatArray
    shallowness: FloatArray
    foretold: FloatArray
    seen: bool


@dataclasses.dataclass(frozen=True, eq=False)
class RegisteredScan:
    """Scan of a formed part with its pose in the sheet's frame.

    Attributes:
        cloud: Points in the scan's frame.
        marks: Marks in the sheet's frame and in the scan; None without.
        pose: Pose of the scan in the sheet's frame.
        deviation: Deviation from the nominal face.
        top: Whether the top face of the sheet was scanned, else the bottom face.
    """

    cloud: Cloud
    marks: ProbedPoints | None
    pose: ScanPose
    deviation: Deviation
    top: bool


@dataclasses.dataclass(frozen=True)
class AdjustmentStep:
    """Step from the compensation of the scanned part to that of the next part.

    Attributes:
        compensation: Springback file with which the scanned part was formed; None without.
        gain: Fraction of the deviation that is corrected.
        limits: Limits of shifts and slopes.
    """

    compensation: SpringbackFile | None
    gain: float
    limits: Springback


def adjusted(
    work: FormingWork,
    planned_passes: Sequence[tuple[FormingPass, FormingToolPath]],
    scan: RegisteredScan,
    step: AdjustmentStep,
) -> tuple[AdjustedPass, ...]:
    """Adjust all passes for the next part, so that its deviation is smaller than that of the scanned part.

    The targets of a pass that forms the nominal face are shifted by the gain times the correction that the
    scan requires, in addition to their previous shift. Other passes keep their previous shift.

    Args:
        work: Forming operation.
        planned_passes: Its passes with their tool paths.
        scan: Scan of the part.
        step: Compensation of that part, gain and limits.

    Raises:
        TandemError: ``forming.springback_mode`` if this mode is not compensated; ``forming.compensation``
            beyond the limits; ``scan.hole`` if the scan shows too little of a path; ``scan.other_part`` if no
            pass forms the nominal face.
    """
    require_compensation_mode(work)
    measured, compensation, limits = scan.deviation, step.compensation, step.limits
    previous_paths = {} if compensation is None else {path.name: path for path in compensation.paths}
    face_distance = MeshDistance(measured.face, SPACING)
    out = []
    for forming_pass, path in planned_passes:
        # along z from the touched face to the scanned one: 0, or the sheet thickness, down if negative
        up = work.thickness * (float(scan.top) - float(forming_pass.side > 0))
        lift = np.array([0.0, 0.0, up])
        # every tenth point is enough for a median
        on_face = float(np.median(face_distance.distance(path.contact.point[::10] + lift)[0])) <= ON_FACE
        scanned_pass = _ScannedPass(forming_pass, path, previous_paths.get(forming_pass.name), lift)
        out.append(_adjusted(work, scanned_pass, measured, step.gain if on_face else 0.0, limits.slope))
    if not any(item.seen for item in out):
        text = "no pass forms the nominal face at its place in the part, so a scan cannot correct the tools"
        hint = "form with strategy: in_place, or adjust the part's file by hand"
        raise issue_error("scan.other_part", text, hint=hint)
    require_shift_limits([item.tool_path for item in out], limits.slope, limits.most_mm * MM)
    return tuple(out)


@dataclasses.dataclass(frozen=True, eq=False)
class _ScannedPass:
    """A pass with which the scanned part was formed.

    Attributes:
        forming_pass: The pass.
        path: Its planned tool path.
        previous_path: Its shifted path in the compensation of the part; None without.
        lift: Displacement (3,) [m] from the touched face to the scanned one.
    """

    forming_pass: FormingPass
    path: FormingToolPath
    previous_path: ShiftedPath | None
    lift: FloatArray


def _adjusted(
    work: FormingWork, scanned_pass: _ScannedPass, measured: Deviation, gain: float, slope: float
) -> AdjustedPass:
    """Adjust one pass. The slope of its shifts along the path is at most ``slope`` [-].

    With a ``gain`` of 0 the shifts are those with which the scanned part was formed, and nothing is measured.
    """
    forming_pass, path, lift = scanned_pass.forming_pass, scanned_pass.path, scanned_pass.lift
    previous_path = scanned_pass.previous_path
    radius = work.heads[work.forming_arm(forming_pass)].radius
    positions = arc_length(path.forming_centre)
    previous_shift = (
        np.zeros(len(positions)) if previous_path is None else shift_at_targets(previous_path, path)
    )

    def measure(contact: FloatArray, at: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return shallowness e, NaN where unknown, and depth correction e + m, both (N,) [m].

        m is the additional springback that the sheet has when it is formed to the required depth.
        ``contact`` (N, 3) [m] are points of contact at the lengths ``at`` (N,) [m] along the path.
        """
        shallowness = forming_pass.side * measured.along_z(contact + lift)
        filled = _filled(shallowness, at)
        springback = np.interp(at, positions, previous_shift) + filled
        normal = unit(
            np.column_stack([np.interp(at, positions, component) for component in path.contact.normal.T])
        )
        above = measured.nearest(contact + lift + forming_rate.up_the_wall(normal, forming_pass.side))
        depth_difference = _filled(shallowness - forming_pass.side * measured.along_z(above), at)
        drop = forming_pass.side * (above - contact - lift)[:, 2]
        return shallowness, filled + forming_rate.as_wanted(springback, depth_difference, drop)

    def requested_depth(contact: FloatArray, _: FloatArray, at: FloatArray) -> FloatArray:
        """Return the shift (N,) [m] that is requested at points of contact, before its slope is limited."""
        shift = np.interp(at, positions, previous_shift)
        if not gain:
            return shift
        shallowness, correction = measure(contact, at)
        _require_seen(forming_pass, np.isfinite(shallowness), contact)
        return np.asarray(shift + gain * moving_average(correction, radius / max(float(at[1]), 1e-12)))

    shifted_path, _ = shift_path(forming_pass.name, path, radius, requested_depth, slope)
    shallowness = correction = np.full(len(positions), np.nan)
    if gain:
        shallowness, correction = measure(path.contact.point, positions)
        correction = np.where(np.isfinite(shallowness), correction, np.nan)
    # what the added shift leaves of the correction is the shallowness of the next part
    foretold = correction - (shift_at_targets(shifted_path, path) - previous_shift)
    return AdjustedPass(shifted_path, path.contact.point, shallowness, foretold, gain != 0.0)


def _filled(value: FloatArray, at: FloatArray) -> FloatArray:
    """Return values (N,) at positions ``at`` (N,) [m] of a path, interpolated where they are NaN.

    They are 0 if all are NaN.
    """
    is_known = np.isfinite(value)
    return np.interp(at, at[is_known], value[is_known]) if is_known.any() else np.zeros(len(at))


def _require_seen(adjusted_pass: FormingPass, seen: BoolArray, contact: FloatArray) -> None:
    """Raise ``scan.hole`` if the scan shows too few of a pass's points of contact (N, 3) [m]."""
    if seen.mean() >= MIN_SEEN_FRACTION:
        return
    x, y, z = contact[np.flatnonzero(~seen)[0]] / MM
    message = (
        f"pass {adjusted_pass.name}: the scan shows {100.0 * seen.mean():.0f} % of its path, allowed "
        f"{100.0 * MIN_SEEN_FRACTION:g} % or more; there are no points at ({x:.0f}, {y:.0f}, {z:.0f}) mm"
    )
    hint = "scan the part from more sides, and spray shiny areas"
    raise issue_error("scan.hole", message, value=100.0 * float(seen.mean()), unit="%", hint=hint)


def text(
    title: str,
    operation: str,
    identity: Mapping[str, Any],
    scan: RegisteredScan,
    step: AdjustmentStep,
    passes: Sequence[AdjustedPass],
) -> str:
    """Return the text of an adjustment file: scan and pose, paths of the scanned part and of the next part.

    The last line is a checksum, as in a springback file.

    Args:
        title: Title of the problem.
        operation: Name of the operation.
        identity: Data that identify what the file belongs to.
        scan: Scan of the part that was formed.
        step: Compensation of that part, gain and limits.
        passes: Adjusted passes, as by :func:`adjusted`.
    """
    cloud = scan.cloud
    marks = scan.marks
    compensation = step.compensation
    rows = [] if marks is None else list(zip(marks.names, marks.first / MM, marks.second / MM, strict=True))
    head = {
        "tandem_adjustment": FILE_VERSIONS["tandem_adjustment"],
        "problem": title,
        "operation": operation,
        "belongs_to": dict(identity),
        "scan": {
            "file": cloud.file,
            "sha256": cloud.digest,
            "points": len(cloud.points),
            "unit_m": cloud.unit,
            "face": "top" if scan.top else "bottom",
            "pose": np.round(scan.pose.matrix, DECIMALS).tolist(),
            "marks": [[name, sheet.tolist(), scanned.tolist()] for name, sheet, scanned in rows],
        },
        "gain": step.gain,
        "adjusts": [item.tool_path.name for item in passes if item.seen],
        "slope": step.limits.slope,
    }
    lines = [f"{json.dumps(key)}: {json.dumps(value, ensure_ascii=False)}" for key, value in head.items()]
    lines.append(f'"before": {passes_text(compensation.paths if compensation is not None else ())}')
    return with_checksum([*lines, *path_lines([item.tool_path for item in passes])])
