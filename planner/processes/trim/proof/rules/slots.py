"""Rules on trimmed sheets: what is cut and what remains, a torch and its arc, order, feed and clearance.

- verify.trim_cut: each outline is cut, closed but for its joints; a knife cuts both faces.
- verify.trim_kept: nothing is cut off the part.
- verify.trim_torch: stand-off and tilt.
- verify.trim_arc: when the torch burns.
- verify.trim_order, verify.trim_feed, verify.trim_clear: order, feed and clearance.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Sequence

import numpy as np
from scipy.spatial import cKDTree

from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray
from planner.issues import Issue
from planner.processes.trim.claims import TrimBlade, TrimsSheet, slot_names
from planner.processes.trim.proof.blade_motion import CORNER_ERROR_RAD, blade_path, find_corners
from planner.processes.trim.proof.outlines import TRIM, OutlineCurve, encloses
from planner.processes.trim.proof.rules.arc_waits import (
    LINGER_FACTOR,
    LINGER_KERF_FACTOR,
    LINGER_TIME_S,
    MIN_STRETCH_M,
    WAIT_ROUNDING_S,
    missing_waits,
    missing_watchdogs,
)
from planner.processes.trim.proof.torch_motion import (
    REST_TOLERANCE_M,
    SAMPLE_STEP_M,
    SAMPLING_ERROR_M,
    TRIMMING,
    SlotPath,
    TrimmedSheet,
    Trimming,
    sheet_distance,
    start_row,
)
from planner.proof.context import Context
from planner.proof.findings import Findings, evenly_spaced_rows, format_point_mm, measure_in_mm, to_percent
from planner.proof.part_files import UnreadError
from planner.proof.rule import MAX_FEED_FACTOR, RuleOutcome, measured_issue, mm, rule
from planner.tooling import Knife, Mill, Torch

TRIM_CUT = "verify.trim_cut"
"""Code of the rule about outlines."""
NOTHING_TRIMMED = "nothing is trimmed"
"""Reason why rules about trimming have not run."""
ANGLE_ERROR_RAD = np.deg2rad(0.5)
"""Possible rotation of normals by facets of a mesh [rad]."""
AVERAGE_SLACK = 0.95
"""Fraction of the minimum average feed that is accepted.

Acceleration ramps of the replay are not those of a controller.
"""
LENGTH_TOLERANCE_M = 1e-9
"""Lengths along a curve that differ by less than this [m] are equal."""
FILL_FRACTION = 0.5
"""Maximum distance of the points that represent a knife's cut, as a fraction of its tolerance."""
MIN_JOINT_FRACTION = 0.5
"""Minimum width of a micro-joint, as a fraction of the stated one."""
DESCENT_TOLERANCE_FACTOR = 2.0
"""A mill that is higher than its depth by more than this many tolerances is still on its way down."""
DESCENT_SLOPE = 0.1
"""A mill that goes deeper by more than this fraction of its path is still on its way down."""
CLEARANCE_REDUCTION = 0.1
"""Reduction of the clearance that is accepted between targets, as a fraction of it."""
MAX_ISSUES = 20
"""Maximum number of issues of one slot."""


@rule("verify.trim_cut", TrimsSheet)
def trim_cut(context: Context) -> RuleOutcome:
    """Each outline is cut all the way round within the tolerance, but for its stated micro-joints.

    The proof reads outlines and part itself. The edge of the slot on the side of the part is compared with
    the outline. Nothing else is trimmed.
    """
    trimming, findings = context.get(TRIMMING), Findings(TRIM_CUT, context)
    findings.issues += trimming.issues
    findings.issues += (unread for unread in context.reading_issues if unread.code == TRIM_CUT)
    _check_unclaimed(findings, trimming)
    for trimmed in trimming.sheets:
        for curve in trimmed.curves:
            name = curve.outline.name
            paths = [path for path in trimmed.slot_paths(curve).values() if path is not None]
            if len(paths) < len(trimmed.slot_paths(curve)) or not paths:
                findings.add(f"a slot of {name} is not cut" if paths else f"{name} is not cut", field=name)
                continue
            if trimmed.claim.knife is not None:
                deviation, curve_issues = _check_knife_cut(trimmed, curve, trimmed.claim.knife)
            else:
                deviation, curve_issues = _check_closed(trimmed, curve, paths)
            findings.issues += curve_issues
            findings.note_highest(deviation, name, trimmed.claim.tolerance + trimmed.sheet.tolerance)
    if not findings.measured:
        return findings.outcome_without_value("" if findings.issues else NOTHING_TRIMMED)
    return findings.outcome(mm, "mm")


def _check_knife_cut(
    trimmed: TrimmedSheet, curve: OutlineCurve, knife: TrimBlade
) -> tuple[float, list[Issue]]:
    """Check that a knife cuts an outline at both faces of the sheet, first at the far one.

    Because its edge is slanted, the cut goes farther at the near face than at the far one. So joints may be
    wider at the far face by ``slant``, the length of the edge along the cut within the sheet.

    Returns:
        Maximum deviation [m] from the outline where it is cut, and issues of the first faulty face.
    """
    slant = float(
        knife.blade.front(trimmed.claim.thickness + knife.depth_below) - knife.blade.front(knife.depth_below)
    )
    worst, issues = 0.0, list[Issue]()
    for at_far_face in (True, False):
        cuts = [
            getattr(blade_path(trimmed, knife, key), "far_cut" if at_far_face else "near_cut")
            for key in trimmed.slot_paths(curve)
        ]
        paths = [path for cut in cuts for path in cut.paths]
        if not paths:
            message = f"the knife is never through the sheet along {curve.outline.name}"
            return worst, [Issue(TRIM_CUT, message, field=curve.outline.name)]
        deviation, face_issues = _check_closed(trimmed, curve, paths, slant if at_far_face else 0.0)
        worst, issues = max(worst, deviation), face_issues
        if face_issues:
            side = "at the far face of the sheet" if at_far_face else "at its near face"
            issues = [
                dataclasses.replace(face_issue, message=f"{face_issue.message} ({side})")
                for face_issue in face_issues
            ]
            break
    return worst, issues


def _check_closed(
    trimmed: TrimmedSheet, curve: OutlineCurve, paths: list[SlotPath], extra_width: float = 0.0
) -> tuple[float, list[Issue]]:
    """Check that slots cut an outline all the way round except for its micro-joints.

    Issues are those of uncut places whose number differs from that of the joints, of joints with a wrong
    width, and of joints that a slot cuts off from the waste. Joints may be wider than stated by
    ``extra_width`` [m] in addition to the tolerance.

    Returns:
        The maximum distance [m] of the slot's edge from the outline where it is cut, and the issues.
    """
    claim, outline, half_kerf = trimmed.claim, curve.outline, 0.5 * trimmed.claim.kerf
    tolerance = trimmed.edge_tolerance
    foot = np.concatenate([path.feet.foot for path in paths])
    distances = np.concatenate([path.curve_distance for path in paths])
    curve_lengths = np.concatenate([path.at for path in paths])
    on_edge = np.abs(distances - half_kerf) <= tolerance
    # distance of each point of the outline from the edge of the nearest slot
    ring_distances = (
        np.asarray(cKDTree(_path_points(paths, half_kerf, tolerance)).query(curve.ring)[0]) - half_kerf
    )
    if not on_edge.any():
        message = f"the slot is never within {mm(claim.tolerance):g} mm of {outline.name}, on the side that "
        message += f"drops; its nearest point is {mm(float(np.abs(distances - half_kerf).min())):.2f} mm off"
        deviation = float(np.abs(ring_distances[ring_distances <= tolerance]).max(initial=0.0))
        return deviation, [Issue(TRIM_CUT, message, field=outline.name)]
    issues = []
    gaps = []
    in_joint = np.zeros(len(curve.ring), dtype=bool)
    for first, last in uncut_intervals(curve, paths, half_kerf, tolerance):
        # points of the slot next to the gap, before and after it along the curve
        before = foot[on_edge][
            int(np.argmin((first + LENGTH_TOLERANCE_M - curve_lengths[on_edge]) % curve.length))
        ]
        after = foot[on_edge][
            int(np.argmin((curve_lengths[on_edge] - last + LENGTH_TOLERANCE_M) % curve.length))
        ]
        width = float(np.linalg.norm(after - before)) - 2.0 * half_kerf
        if width > SAMPLING_ERROR_M:  # otherwise the round ends of the slots meet
            gaps.append((first, last, width))
            in_joint |= (curve.along - first) % curve.length < last - first
    # points of the outline that no slot reaches, although they are in no gap between slots
    uncut_runs = _cyclic_runs((ring_distances > tolerance) & ~in_joint)
    deviation = float(np.abs(ring_distances[(ring_distances <= tolerance) & ~in_joint]).max(initial=0.0))
    if uncut_runs or len(gaps) != outline.joints:
        count = len(gaps) + len(uncut_runs)
        message = f"{outline.name} is left uncut in {count} places, required {outline.joints}"
        if count:
            # division by 1e-3 converts to mm
            x, y, _ = curve.point_after(gaps[0][0] if gaps else float(curve.along[uncut_runs[0][0]])) / 1e-3
            message += f"; the first is at ({x:.1f}, {y:.1f}) mm"
        issues.append(
            measured_issue(TRIM_CUT, message, (float(count), float(outline.joints), None), field=outline.name)
        )
    for first, last, width in gaps if outline.joints else ():
        x, y, _ = curve.point_after(first) / 1e-3
        subject = f"the micro-joint of {outline.name} at ({x:.1f}, {y:.1f}) mm"
        if (
            not outline.width - tolerance <= width <= outline.width + tolerance + extra_width
            or width < MIN_JOINT_FRACTION * outline.width
        ):
            message = f"{subject} is {mm(width):.2f} mm wide, required {mm(outline.width):g} mm within "
            message += f"{mm(claim.tolerance):g}"
            issues.append(
                measured_issue(TRIM_CUT, message, (mm(width), mm(outline.width), None), field=outline.name)
            )
        if any(_passes_joint(curve, path, first, last) for path in paths):
            message = f"{subject} is cut off from the waste, so that it holds nothing"
            issues.append(Issue(TRIM_CUT, message, field=outline.name))
    return deviation, issues


def _path_points(paths: list[SlotPath], half_kerf: float, tolerance: float) -> FloatArray:
    """Return the points (M, 3) [m] of paths on the face.

    A knife's cut has no width, so points are inserted between those of its path. Otherwise points of the
    curve between two of them would count as uncut.
    """
    if half_kerf > 0.0:
        return np.concatenate([path.feet.foot for path in paths])
    out = []
    for path in paths:
        foot = path.feet.foot
        size = np.linalg.norm(np.diff(foot, axis=0), axis=1)
        count = np.where(size < 3.0 * SAMPLE_STEP_M, np.ceil(size / (FILL_FRACTION * tolerance)), 1).astype(
            np.int64
        )
        row = np.repeat(np.arange(len(size)), np.maximum(count, 1))
        fraction = (np.arange(len(row)) - np.searchsorted(row, row)) / np.maximum(count, 1)[row]
        out += [foot[row] + fraction[:, None] * np.diff(foot, axis=0)[row], foot[-1:]]
    return np.concatenate(out)


def uncut_intervals(
    curve: OutlineCurve, paths: list[SlotPath], half_kerf: float, tolerance: float
) -> list[tuple[float, float]]:
    """Return the intervals [m] along a closed curve that no slot cuts, to compare them with its micro-joints.

    A slot cuts the curve where its edge is within the tolerance of it. Two adjacent samples that both do so
    also cut the length between them, unless they or their nearest points of the curve are too far apart. At
    an inner corner the nearest point of the curve jumps by a short length, which counts as cut.

    Args:
        curve: Curve.
        paths: Paths of its slots.
        half_kerf: Half of the kerf [m].
        tolerance: Tolerance of the edge [m].

    Returns:
        Start and end [m] of each interval. The end may be beyond the length of the curve.
    """
    # The edge of a disk (radius h, centre h from a straight curve) is within the tolerance of the curve over
    # a chord of 2 sqrt((h + tolerance)^2 - h^2). Samples farther apart leave a gap.
    jump = 2.0 * np.sqrt((half_kerf + tolerance) ** 2 - half_kerf**2) + 4.0 * SAMPLE_STEP_M
    starts, size = [np.zeros(0)], [np.zeros(0)]
    for path in paths:
        on_edge = np.abs(path.curve_distance - half_kerf) <= tolerance
        # shorter of both ways round from each sample to the next
        step = (np.diff(path.at) + 0.5 * curve.length) % curve.length - 0.5 * curve.length
        is_continuous = np.linalg.norm(np.diff(path.feet.foot, axis=0), axis=1) < 3.0 * SAMPLE_STEP_M
        step = np.append(np.where(on_edge[1:] & is_continuous & (np.abs(step) <= jump), step, 0.0), 0.0)[
            on_edge
        ]
        starts.append((path.at[on_edge] + np.minimum(step, 0.0)) % curve.length)
        size.append(np.abs(step))
    # intervals that are cut, by their starts; gaps are where the largest end so far is before the next start
    order = np.argsort(np.concatenate(starts), kind="stable")
    low, high = np.concatenate(starts)[order], (np.concatenate(starts) + np.concatenate(size))[order]
    if not len(low):
        return [(0.0, curve.length)]
    # three revolutions; the middle one contains all intervals that cross the end
    revolutions = curve.length * np.arange(3)[:, None]
    low, high = (low + revolutions).ravel(), np.maximum.accumulate((high + revolutions).ravel())
    is_gap = (
        (high[:-1] >= curve.length)
        & (high[:-1] < 2.0 * curve.length)
        & (low[1:] > high[:-1] + LENGTH_TOLERANCE_M)
    )
    return [(float(a), float(b)) for a, b in zip(high[:-1][is_gap], low[1:][is_gap], strict=True)]


def _passes_joint(curve: OutlineCurve, path: SlotPath, first: float, last: float) -> bool:
    """Return whether a slot passes the middle of a joint, at any distance from the curve.

    Then it cuts the joint off from the waste. The joint is from ``first`` to ``last`` [m] along the curve.
    """
    offset = (path.at - 0.5 * (first + last) + 0.5 * curve.length) % curve.length - 0.5 * curve.length
    is_near = np.abs(offset) < max(0.5 * (last - first), 2.0 * SAMPLE_STEP_M)
    return bool((is_near[1:] & is_near[:-1] & (offset[1:] * offset[:-1] <= 0.0)).any())


def _cyclic_runs(flags: BoolArray) -> list[tuple[int, int]]:
    """Return the first and last index, both inclusive, of each run of true flags (N,).

    The flags are cyclic: a run that crosses the end has a first index above its last one.
    """
    rows = np.flatnonzero(flags)
    if not len(rows):
        return []
    groups = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
    if len(groups) > 1 and groups[0][0] == 0 and groups[-1][-1] == len(flags) - 1:
        groups = [np.concatenate([groups[-1], groups[0]]), *groups[1:-1]]
    return [(int(group[0]), int(group[-1])) for group in groups]


def _check_unclaimed(findings: Findings, trimming: Trimming) -> None:
    """Add an issue for each trimming segment of the programs without a claim."""
    claimed_keys = {
        Segment(TRIM, name).key
        for trimmed in trimming.sheets
        for curve in trimmed.curves
        for name in slot_names(trimmed.claim, curve.outline)
    }
    for segment in dict.fromkeys(findings.context.motion.node_segment):
        if segment.kind == TRIM and segment.at("").key not in claimed_keys:
            message = f"the programs trim in {segment}, but the problem has no claim on it"
            findings.add(message, field=str(segment))


@rule("verify.trim_kept", TrimsSheet)
def trim_kept(context: Context) -> RuleOutcome:
    """The slot with its pierce point and leads lies in the waste of its outline, within the tolerance.

    A knife may in addition cut past sharp corners by the stated overcut.
    """
    findings = Findings("verify.trim_kept", context)
    for trimmed, curve, key, path in each_slot(context.get(TRIMMING)):
        tolerance = trimmed.edge_tolerance
        if trimmed.claim.knife is not None:
            _check_knife_kept(findings, trimmed, curve, trimmed.claim.knife, key)
            continue
        depths = 0.5 * trimmed.claim.kerf - path.curve_distance
        findings.note_highest(depths.max(), key, tolerance)
        for i in evenly_spaced_rows(depths > tolerance, MAX_ISSUES):
            message = (
                f"in {key} the slot is {mm(float(depths[i])):.2f} mm in the part, over {curve.outline.name}, "
                "at "
            )
            message += f"({format_point_mm(path.feet.foot[i])}) mm, allowed {mm(tolerance):.2f} mm"
            findings.add_at_sample(
                message, trimmed.claim.arm, path.rows[i], measure_in_mm(depths[i], tolerance)
            )
    return findings.outcome(mm, "mm", nothing=NOTHING_TRIMMED)


def _check_knife_kept(
    findings: Findings, trimmed: TrimmedSheet, curve: OutlineCurve, knife: TrimBlade, key: str
) -> None:
    """Check how far a blade cuts over its curve into the part, at both faces.

    On the straight continuation of a side of a sharp corner, the stated overcut is allowed in addition to the
    tolerance. Measured depths and issues are added to ``findings``.
    """
    tolerance, blade = trimmed.edge_tolerance, blade_path(trimmed, knife, key)
    sharp_corners = find_corners(
        trimmed, curve, knife.max_corner - CORNER_ERROR_RAD - trimmed.sheet.normal_error
    )
    for cut, face in ((blade.near_cut, "near"), (blade.far_cut, "far")):
        depths = np.maximum(-cut.distances, 0.0)
        past_corner = sharp_corners.distance_past(cut.foot, tolerance)
        depths[past_corner <= knife.overcut + tolerance] = 0.0
        findings.note_highest(depths.max(initial=0.0), key, tolerance)
        for i in evenly_spaced_rows(depths > tolerance, MAX_ISSUES):
            message = (
                f"in {key} the blade is {mm(float(depths[i])):.2f} mm in the part, over "
                f"{curve.outline.name}, at ({format_point_mm(cut.foot[i])}) mm of the {face} face, allowed "
                f"{mm(tolerance):.2f} mm"
            )
            if np.isfinite(past_corner[i]):
                message += f", and straight on past a corner {mm(knife.overcut):g} mm; it is "
                message += f"{mm(float(past_corner[i])):.2f} mm past one"
            findings.add_at_sample(
                message, trimmed.claim.arm, cut.rows[i], measure_in_mm(depths[i], tolerance)
            )


@rule("verify.trim_torch", TrimsSheet)
def trim_torch(context: Context) -> RuleOutcome:
    """While it cuts, the nozzle keeps its stand-off within the tolerance, and the torch its maximum tilt.

    Where it leads in, the nozzle is no higher than its pierce height.
    """
    findings = Findings("verify.trim_torch", context, worst=0.0)
    for trimmed, _, key, path in each_slot(context.get(TRIMMING)):
        claim, torch = trimmed.claim, trimmed.claim.torch
        if torch is None:
            continue
        # The TCP is at the stand-off before the nozzle, so feet.height, the height of the TCP above the face,
        # is the deviation of the nozzle from its stand-off.
        tolerance = claim.height_tolerance + trimmed.sheet.tolerance
        # In the lead-in the nozzle may be anywhere between the pierce height and the stand-off. The pierce
        # height may be above (lift) or below (drop) the stand-off.
        lift = max(claim.pierce_height - torch.standoff, 0.0)
        drop = min(claim.pierce_height - torch.standoff, 0.0)
        in_lead = path.curve_distance > 0.5 * claim.kerf + trimmed.edge_tolerance
        high = tolerance + SAMPLING_ERROR_M + np.where(in_lead, lift, 0.0)
        low = -tolerance - SAMPLING_ERROR_M + np.where(in_lead, drop, 0.0)
        tilt = np.arccos(np.clip((path.axis * path.feet.normal).sum(axis=1), -1.0, 1.0))
        # low is negative, so each quotient exceeds 1 only beyond its own limit
        height_ratio = np.maximum(path.feet.height / high, path.feet.height / low)
        tilt_ratio = tilt / (claim.cone + ANGLE_ERROR_RAD + trimmed.sheet.normal_error)
        # the sheet is pierced at the first sample of the path
        pierce_ratio = abs(float(path.feet.height[0]) - (claim.pierce_height - torch.standoff)) / tolerance
        for ratio, kind in (
            (height_ratio, "height"),
            (tilt_ratio, "lean"),
            (np.array([pierce_ratio]), "pierce"),
        ):
            findings.note_highest(ratio.max(), f"{kind} in {key}")
            for i in evenly_spaced_rows(ratio > 1.0, MAX_ISSUES):
                nozzle = mm(float(path.feet.height[i]) + torch.standoff)
                message = {
                    "height": f"the nozzle is {nozzle:.2f} mm above the sheet, required "
                    f"{mm(torch.standoff):g} mm within {mm(claim.height_tolerance):g}",
                    "lean": f"the torch is tilted {np.rad2deg(tilt[i]):.1f} deg from the sheet's normal, "
                    f"allowed {np.rad2deg(claim.cone):g} deg",
                    "pierce": f"the sheet is pierced from {nozzle:.2f} mm, required "
                    f"{mm(claim.pierce_height):g} mm within {mm(claim.height_tolerance):g}",
                }[kind]
                findings.add_at_sample(f"in {key} {message}", claim.arm, path.rows[i])
    return findings.outcome(to_percent, "% of what is allowed", 1.0, nothing=NOTHING_TRIMMED)


@rule("verify.trim_arc", TrimsSheet)
def trim_arc(context: Context) -> RuleOutcome:
    """The arc starts at rest in the waste, the program waits for it, and it burns only in its slot.

    It starts at a sufficient distance from all curves, and the wait is bounded. It burns all along the slot.
    A UR program checks the arc throughout, and ends if the arc is lost or the torch rests.
    """
    trimming, findings = context.get(TRIMMING), Findings("verify.trim_arc", context)
    count = 0
    torches = [trimmed for trimmed in trimming.sheets if trimmed.claim.torch is not None]
    for trimmed in torches:
        claim = trimmed.claim
        others = {key for other in torches if other is not trimmed for key in other.slots} - set(
            trimmed.slots
        )
        findings.issues += [
            *missing_waits(context, trimmed, others),
            *missing_watchdogs(context, trimmed, others),
        ]
        track, burning = trimmed.track, trimmed.on_intervals
        for on_time, end in zip(burning.start, burning.end, strict=True):
            has_moved, first_row = _moving_rows(trimmed, on_time, end)
            if not (has_moved & np.isin(track.label, list(trimmed.slots))).any() and any(
                np.isin(other.track.label[_moving_rows(other, on_time, end)[0]], list(other.slots)).any()
                for other in torches
            ):
                continue  # another operation cuts in this interval, and is checked with its own claim
            rows_outside = np.flatnonzero(has_moved & ~np.isin(track.label, list(trimmed.slots)))
            for i in rows_outside[:1]:
                message = f"{claim.signal} is on in {track.label[i]}, where nothing is cut"
                findings.add_at_sample(message, claim.arm, track.rows[i])
            _check_pierce(findings, trimmed, track.tip[first_row], int(track.rows[first_row]), on_time)
        for key in trimmed.slots:
            slot_track = trimmed.slot_track(key)
            if len(slot_track.time) < 2:
                continue
            count += 1
            # at the slot's ends a torch may rest longer than it burns: it waits for the arc and the other arm
            after_start, before_end = (
                np.linalg.norm(slot_track.tip - slot_track.tip[k], axis=1) > REST_TOLERANCE_M for k in (0, -1)
            )
            for i in np.flatnonzero(~burning.contains(slot_track.time) & after_start & before_end)[:1]:
                message = f"{claim.signal} is off in {key}: nothing is cut there"
                findings.add_at_sample(message, claim.arm, slot_track.rows[i])
    return findings.outcome_without_value("" if torches else NOTHING_TRIMMED, f"{count} slots")


def _moving_rows(trimmed: TrimmedSheet, start_time: float, end_time: float) -> tuple[BoolArray, int]:
    """Return the rows (T,), as flags, in a time interval [s] at which the torch has moved since its start.

    The second result is the row at the start of the interval, from whose position the torch moves.
    """
    track = trimmed.track
    inside = (track.time > start_time + 1e-6) & (track.time < end_time - 1e-6)
    first_row = min(int(np.searchsorted(track.time, start_time, side="right")), len(track.time)) - 1
    return inside & (np.linalg.norm(track.tip - track.tip[first_row], axis=1) > REST_TOLERANCE_M), first_row


def _check_pierce(
    findings: Findings, trimmed: TrimmedSheet, tip: FloatArray, row: int, start_time: float
) -> None:
    """Check that the arc starts in the waste, away from all curves, and that the torch then rests.

    The signal goes on at ``start_time`` [s]. The torch rests until its pierce time is over. The arc starts at
    the TCP ``tip`` (3,) [m], at sample ``row`` of the motion.
    """
    claim = trimmed.claim
    foot = trimmed.sheet.project(tip[None]).foot
    distances = np.array([float(curve.distance(foot)[0][0]) for curve in trimmed.curves])
    in_waste = any(bool(curve.in_waste(foot)[0]) for curve in trimmed.curves)
    required = claim.pierce_distance - trimmed.sheet.tolerance - SAMPLING_ERROR_M
    if not in_waste or distances.min() < required:
        message = (
            f"the arc starts {'in the part, ' if not in_waste else ''}{mm(float(distances.min())):.2f} mm "
            "from "
        )
        message += f"{trimmed.curves[int(distances.argmin())].outline.name}, required in the waste, "
        message += f"{mm(claim.pierce_distance):g} mm away"
        findings.add_at_sample(message, claim.arm, row)
    moving = np.flatnonzero(
        (trimmed.track.time > start_time)
        & (np.linalg.norm(trimmed.track.tip - tip, axis=1) > REST_TOLERANCE_M)
    )
    rest_time = float(trimmed.track.time[moving[0]]) - start_time if len(moving) else 0.0
    if rest_time < claim.pierce_seconds - WAIT_ROUNDING_S:
        message = (
            f"the torch moves {rest_time:.3f} s after {claim.signal} goes on, required "
            f"{claim.pierce_seconds:g} s"
        )
        findings.add_at_sample(message, claim.arm, row)


@rule("verify.trim_order", TrimsSheet)
def trim_order(context: Context) -> RuleOutcome:
    """An outline inside another one is cut completely before the outer one is started.

    The outer cut would let the inner one move.
    """
    findings, pairs = Findings("verify.trim_order", context), 0
    for trimmed in context.get(TRIMMING).sheets:
        spans: list[tuple[float, float]] = []
        for curve in trimmed.curves:
            tracks = [trimmed.slot_track(key) for key in trimmed.slot_paths(curve)]
            times = np.concatenate([track.time for track in tracks if len(track.time)] or [np.zeros(0)])
            spans.append((float(times.min()), float(times.max())) if len(times) else (np.inf, -np.inf))
        for (a, inner), (b, outer) in itertools.permutations(enumerate(trimmed.curves), 2):
            if not bool(encloses(outer.plan_vertices, inner.plan_vertices[:1])[0]):
                continue
            pairs += 1
            if spans[a][1] > spans[b][0]:
                message = f"{outer.outline.name} is started before {inner.outline.name} inside it is cut"
                findings.add(message, field=outer.outline.name, arm=trimmed.claim.arm)
    return findings.outcome_without_value(
        "" if pairs else "no outline within another", f"{pairs} within others"
    )


@rule("verify.trim_feed", TrimsSheet)
def trim_feed(context: Context) -> RuleOutcome:
    """The tool keeps its feed, which depends on the wall angle, and its minimum average feed.

    The maximum is the feed over the cosine of the wall angle, by the thickness that the sine law leaves
    there. A knife has no minimum. A torch is nowhere so slow that it burns away more than its slot.
    """
    findings = Findings("verify.trim_feed", context, worst=0.0)
    for trimmed, _, key, _path in each_slot(context.get(TRIMMING)):
        claim, track = trimmed.claim, trimmed.slot_track(key)
        time, length = np.diff(track.time), np.linalg.norm(np.diff(track.tip, axis=0), axis=1)
        time, length = time[track.joined], length[track.joined]
        feet, depth = trimmed.project(track.tip, track.axis)
        wall_cosine = np.maximum(np.abs(feet.normal[:, 2]), 0.05)  # lower bound: no division by 0
        limit = np.minimum(claim.feed / wall_cosine, claim.max_feed)
        # per move between two samples: the higher limit of both ends applies
        move_limit = np.maximum(limit[:-1], limit[1:])[track.joined]
        speed = length / np.maximum(time, 1e-6)
        fraction = speed / move_limit
        findings.note_highest(fraction.max(), key)
        rows = track.rows[1:][track.joined]
        for i in evenly_spaced_rows(fraction > MAX_FEED_FACTOR, MAX_ISSUES):
            speed_mm, allowed_mm = mm(float(speed[i])), mm(float(move_limit[i]))
            message = f"the tool cuts at {speed_mm:.2f} mm/s in {key}, allowed {allowed_mm:.2f}"
            findings.add_at_sample(message, claim.arm, rows[i], (speed_mm, allowed_mm, "mm/s"))
        if claim.torch is not None:
            _check_linger(findings, trimmed, key)
        if claim.knife is not None:  # a knife has no minimum feed
            continue
        if claim.mill is not None:  # on its way down another feed applies
            min_depth = (
                claim.thickness + claim.mill.depth_below - DESCENT_TOLERANCE_FACTOR * claim.height_tolerance
            )
            is_down = (depth[1:] >= min_depth)[track.joined] & (
                np.diff(depth)[track.joined] <= DESCENT_SLOPE * length
            )
            time, length, move_limit = time[is_down], length[is_down], move_limit[is_down]
        else:  # the time at rest above the pierce point does not count
            is_moving = (np.arange(1, len(track.time)) > start_row(track))[track.joined]
            time, length, move_limit = time[is_moving], length[is_moving], move_limit[is_moving]
        mean = float((length / move_limit).sum() / max(float(time.sum()), 1e-9))
        if mean < AVERAGE_SLACK * claim.min_feed_fraction:
            message = f"the tool cuts at {100 * mean:.0f} % of its feed in {key} on average, required "
            message += f"{100 * claim.min_feed_fraction:.0f} %"
            findings.add(message, (mean, claim.min_feed_fraction, None), field=key)
    return findings.outcome(float, "of the feed", MAX_FEED_FACTOR, nothing=NOTHING_TRIMMED)


def _check_linger(findings: Findings, trimmed: TrimmedSheet, key: str) -> None:
    """Check that a torch, once it moves, does not take too long for a short stretch of its slot.

    On such a stretch the arc would burn away more than the kerf. Stretches have the length of some kerfs and
    start at each sample. The rests before the first and after the last motion do not count.
    """
    claim, track = trimmed.claim, trimmed.slot_track(key)
    after_start, before_end = (
        np.linalg.norm(track.tip - track.tip[k], axis=1) > REST_TOLERANCE_M for k in (0, -1)
    )
    rows_after_start = np.flatnonzero(after_start)
    if not len(rows_after_start) or not before_end.any():
        return
    moving = slice(max(int(rows_after_start[0]) - 1, 0), int(np.flatnonzero(before_end)[-1]) + 2)
    time, rows = track.time[moving], track.rows[moving]
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(track.tip[moving], axis=0), axis=1)))
    stretch = max(LINGER_KERF_FACTOR * claim.kerf, MIN_STRETCH_M)
    stretch_ends = np.minimum(np.searchsorted(along, along + stretch), len(along) - 1)
    durations, lengths = time[stretch_ends] - time, along[stretch_ends] - along
    allowed = LINGER_FACTOR * lengths / (claim.min_feed_fraction * claim.feed) + LINGER_TIME_S
    k = int(np.argmax(durations - allowed))
    if durations[k] > allowed[k]:
        message = (
            f"the torch takes {durations[k]:.2f} s for {mm(float(lengths[k])):.2f} mm in {key}, allowed "
        )
        message += f"{allowed[k]:.2f} s"
        findings.add_at_sample(message, claim.arm, rows[k], (float(durations[k]), float(allowed[k]), "s"))


@rule("verify.trim_clear", TrimsSheet)
def trim_clear(context: Context) -> RuleOutcome:
    """The mounted tool is the claimed one, and keeps its clearance from the formed sheet.

    It is compared in slots, and on the approach to them and the retreat. Of a mill or knife only the parts
    that do not cut are compared.
    """
    findings = Findings("verify.trim_clear", context, worst=np.inf)
    for trimmed in context.get(TRIMMING).sheets:
        claim = trimmed.claim
        _check_tool(findings, trimmed)
        rows = np.flatnonzero(np.char.startswith(trimmed.track.label.astype(str), f"{TRIM}/"))
        if not len(rows):
            continue
        try:
            distance, row = sheet_distance(trimmed, rows)
        except UnreadError as error:
            findings.add(str(error), hint="use a smaller sheet or a coarser mesh")
            continue
        required = (1.0 - CLEARANCE_REDUCTION) * claim.clearance - trimmed.sheet.tolerance
        findings.note_lowest(distance, trimmed.track.label[row], required)
        if distance < required:
            message = (
                f"in {trimmed.track.label[row]} the tool is {mm(distance):.2f} mm from the sheet, required "
            )
            message += f"{mm(claim.clearance):g} mm"
            findings.add_at_sample(
                message, claim.arm, trimmed.track.rows[row], measure_in_mm(distance, required)
            )
    return findings.outcome(mm, "mm", nothing=NOTHING_TRIMMED)


TORCH_SIZES = ("standoff", "kerf", "nozzle", "cone", "body", "back")
"""Sizes of a torch that have to be the claimed ones."""
CUTTER_SIZES = ("radius", "corner", "flute", "overhang", "shank", "holder_outline")
"""Sizes of a mill's cutter that have to be the claimed ones."""
BLADE_SIZES = ("thickness", "width", "end", "ground", "length")
"""Sizes of a knife's blade that have to be the claimed ones."""


def _check_tool(findings: Findings, trimmed: TrimmedSheet) -> None:
    """Check that the tool on the arm is of the claimed kind and has the claimed sizes and kerf."""
    claim = trimmed.claim
    tool = findings.context.setups[trimmed.index].cell.arm(claim.arm).tool
    is_same = False
    if claim.mill is not None and isinstance(tool, Mill):
        claimed_cutter = claim.mill.cutter
        is_same = (
            _same_sizes(tool.cutter, claimed_cutter, CUTTER_SIZES)
            and abs(claim.kerf - 2.0 * claimed_cutter.radius) < SIZE_TOLERANCE_M
        )
    elif claim.knife is not None and isinstance(tool, Knife):
        is_same = _same_sizes(tool.blade, claim.knife.blade, BLADE_SIZES) and claim.kerf == 0.0
        is_same = is_same and _same_sizes(tool, claim.knife, ("body", "back"))
    elif claim.torch is not None and isinstance(tool, Torch):
        is_same = (
            _same_sizes(tool, claim.torch, TORCH_SIZES)
            and abs(claim.kerf - claim.torch.kerf) < SIZE_TOLERANCE_M
        )
    if not is_same:
        message = f"the tool of {claim.arm} in setup {trimmed.index + 1} differs from the claimed one"
        findings.add(message, arm=claim.arm)


SIZE_TOLERANCE_M = 1e-9
"""Sizes that differ by less than this [m] are equal."""


def _same_sizes(first: object, second: object, sizes: Sequence[str]) -> bool:
    """Return whether two tools have equal attributes ``sizes``."""
    pairs = (
        [np.asarray(getattr(tool, name), dtype=np.float64) for tool in (first, second)] for name in sizes
    )
    return all(a.shape == b.shape and bool(np.all(np.abs(a - b) < SIZE_TOLERANCE_M)) for a, b in pairs)


def each_slot(trimming: Trimming) -> Iterator[tuple[TrimmedSheet, OutlineCurve, str, SlotPath]]:
    """Yield all slots that are cut: the claim with the motion, the outline, the segment's key, and the path.

    Args:
        trimming: Trimming of the proof.
    """
    for trimmed in trimming.sheets:
        for curve in trimmed.curves:
            for key, path in trimmed.slot_paths(curve).items():
                if path is not None:
                    yield trimmed, curve, key, path
