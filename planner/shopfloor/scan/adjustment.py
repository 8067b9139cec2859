"""Adjustment of tools by a scan: each target moves along z by the deviation of the previous part.

A part was formed with the commanded path C. Its scan deviates from the nominal face by d along the normal,
thus it is too shallow by e = d / cos a along z on a wall of angle a. The next part is formed with

    C' = C + g (e + m),

where g is the gain (displacement adjustment, as in springback compensation of dies) and m the additional
springback of a part that is formed as planned (`planner.shopfloor.scan.forming_rate`), which follows from C,
e and the wall above. Both are averaged over the ball's width, and the result is limited in slope like every
springback file. A pass whose face is not the part's own is not on the scan, so its tools move as before.
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
"""Median distance [m] of a pass's contact from the nominal face. Beyond it the pass is not the last one."""
MIN_SEEN_FRACTION: Final = 0.7
"""Minimum fraction of a pass's path along which the scan shows the part."""
DECIMALS: Final = 9
"""Decimals of the pose, m and cosines."""


@dataclasses.dataclass(frozen=True, eq=False)
class AdjustedPass:
    """An adjusted pass with N targets.

    Attributes:
        tool_path: Its path for the next part.
        point: (N, 3) [m] points of contact.
        shallowness: (N,) [m, along z] how much too shallow the scan shows the part, NaN where it does not
            show it.
        foretold: (N,) [m] prediction for the next part.
        seen: Whether the scan decides on this pass.
    """

    tool_path: ShiftedPath
    point: FloatArray
    shallowness: FloatArray
    foretold: FloatArray
    seen: bool


@dataclasses.dataclass(frozen=True, eq=False)
class RegisteredScan:
    """Scan of a formed part, in the sheet's frame.

    Attributes:
        cloud: Its points.
        marks: Marks in the sheet's frame and in the scan; None without.
        pose: Pose of the scan.
        deviation: Deviation from the nominal face.
        top: Whether the top face was scanned.
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
    """Adjust all passes for the next part.

    Args:
        work: Forming operation.
        planned_passes: Its passes with their tool paths.
        scan: Scan of the part.
        step: Compensation of that part, gain and limits.

    Raises:
        TandemError: forming.springback_mode, forming.compensation beyond the limits, scan.hole if the scan
            shows too little of a path, scan.other_part if no pass forms the part's own face.
    """
    require_compensation_mode(work)
    measured, compensation, limits = scan.deviation, step.compensation, step.limits
    before = {} if compensation is None else {way.name: way for way in compensation.paths}
    near = MeshDistance(measured.face, SPACING)
    out = []
    for one, path in planned_passes:
        # the touched face, or the scanned one, which is offset along z by the sheet thickness
        up = work.thickness * (float(scan.top) - float(one.side > 0))
        lift = np.array([0.0, 0.0, up])
        on_face = float(np.median(near.distance(path.contact.point[::10] + lift)[0])) <= ON_FACE
        scanned_pass = _ScannedPass(one, path, before.get(one.name), lift)
        out.append(_adjusted(work, scanned_pass, measured, step.gain if on_face else 0.0, limits.slope))
    if not any(one.seen for one in out):
        what = "no pass forms the nominal face at its place in the part, so a scan cannot correct the tools"
        hint = "form with strategy: in_place, or adjust the part's file by hand"
        raise issue_error("scan.other_part", what, hint=hint)
    require_shift_limits([one.tool_path for one in out], limits.slope, limits.most_mm * MM)
    return tuple(out)


@dataclasses.dataclass(frozen=True, eq=False)
class _ScannedPass:
    """A pass with which the scanned part was formed.

    Attributes:
        forming_pass: The pass.
        path: Its planned tool path.
        previous_path: Its shifted path in the compensation of the part; None without.
        lift: (3,) [m] from the touched face to the scanned one.
    """

    forming_pass: FormingPass
    path: FormingToolPath
    previous_path: ShiftedPath | None
    lift: FloatArray


def _adjusted(
    work: FormingWork, scanned_pass: _ScannedPass, measured: Deviation, gain: float, slope: float
) -> AdjustedPass:
    """Adjust one pass with shifts of at most a ``slope``. With a ``gain`` of 0 its tools move as before."""
    forming_pass, path, lift = scanned_pass.forming_pass, scanned_pass.path, scanned_pass.lift
    previous_path = scanned_pass.previous_path
    radius = work.heads[work.forming_arm(forming_pass)].radius
    positions = arc_length(path.forming_centre)
    went = np.zeros(len(positions)) if previous_path is None else shift_at_targets(previous_path, path)

    def short(contact: FloatArray, at: FloatArray) -> tuple[FloatArray, FloatArray]:
        """How much too shallow the part was, NaN where that is not known, and what tools are to go deeper."""
        off = forming_pass.side * measured.along_z(contact + lift)
        known = _filled(off, at)
        back = np.interp(at, positions, went) + known
        normal = unit(np.column_stack([np.interp(at, positions, each) for each in path.contact.normal.T]))
        above = measured.nearest(contact + lift + forming_rate.up_the_wall(normal, forming_pass.side))
        less = _filled(off - forming_pass.side * measured.along_z(above), at)
        drop = forming_pass.side * (above - contact - lift)[:, 2]
        return off, known + forming_rate.as_wanted(back, less, drop)

    def requested_depth(contact: FloatArray, _: FloatArray, at: FloatArray) -> FloatArray:
        value = np.interp(at, positions, went)
        if not gain:
            return value
        off, more = short(contact, at)
        _require_seen(forming_pass, np.isfinite(off), contact)
        return np.asarray(value + gain * moving_average(more, radius / max(float(at[1]), 1e-12)))

    way, _ = shift_path(forming_pass.name, path, radius, requested_depth, slope)
    off = more = np.full(len(positions), np.nan)
    if gain:
        off, more = short(path.contact.point, positions)
        more = np.where(np.isfinite(off), more, np.nan)
    return AdjustedPass(
        way, path.contact.point, off, more - (shift_at_targets(way, path) - went), gain != 0.0
    )


def _filled(value: FloatArray, at: FloatArray) -> FloatArray:
    """Values (N,) at positions ``at`` (N,) [m] of a path, interpolated where unknown.

    They are 0 if all are unknown.
    """
    known = np.isfinite(value)
    return np.interp(at, at[known], value[known]) if known.any() else np.zeros(len(at))


def _require_seen(adjusted_pass: FormingPass, seen: BoolArray, contact: FloatArray) -> None:
    if seen.mean() >= MIN_SEEN_FRACTION:
        return
    x, y, z = contact[np.flatnonzero(~seen)[0]] / MM
    what = (
        f"pass {adjusted_pass.name}: the scan shows {100.0 * seen.mean():.0f} % of its path, allowed "
        f"{100.0 * MIN_SEEN_FRACTION:g} % or more; there are no points at ({x:.0f}, {y:.0f}, {z:.0f}) mm"
    )
    hint = "scan the part from more sides, and spray shiny areas"
    raise issue_error("scan.hole", what, value=100.0 * float(seen.mean()), unit="%", hint=hint)


def text(
    title: str,
    operation: str,
    identity: Mapping[str, Any],
    scan: RegisteredScan,
    step: AdjustmentStep,
    passes: Sequence[AdjustedPass],
) -> str:
    """Text of an adjustment file: its scan and pose, the paths that were formed and those to come.

    The last line is a checksum, as in a springback file.

    Args:
        title: Title of the problem.
        operation: Name of the operation.
        identity: What the file belongs to.
        scan: Scan of the part that was formed.
        step: Compensation of that part, gain and limits.
        passes: Adjusted passes, as by :func:`adjusted`.
    """
    cloud, marks, given = scan.cloud, scan.marks, step.compensation
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
            "marks": [[name, a.tolist(), b.tolist()] for name, a, b in rows],
        },
        "gain": step.gain,
        "adjusts": [one.tool_path.name for one in passes if one.seen],
        "slope": step.limits.slope,
    }
    lines = [f"{json.dumps(key)}: {json.dumps(value, ensure_ascii=False)}" for key, value in head.items()]
    lines.append(f'"before": {passes_text(given.paths if given is not None else ())}')
    return with_checksum([*lines, *path_lines([one.tool_path for one in passes])])
