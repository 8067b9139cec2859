"""Rules on sheets that a mill trims, and checks that also apply to a knife.

verify.trim_mill checks depth and tilt of the cutter, where and how fast it goes into the sheet, that it comes
straight out again, and what it cuts outside its slot. verify.trim_spindle checks, also for a knife, that the
spindle or drive is up to speed and the tool is in a slot wherever it is in the sheet.
"""

import dataclasses
from collections.abc import Iterator

import numpy as np

from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray
from planner.geometry.swept_body import SweptBody, least_distances, points_near
from planner.issues import Issue
from planner.processes.trim.claims import TrimCutter, TrimsSheet
from planner.processes.trim.proof.outlines import TRIM, OutlineCurve
from planner.processes.trim.proof.rules.slots import ANGLE_ERROR_RAD, MAX_ISSUES, NOTHING_TRIMMED, each_slot
from planner.processes.trim.proof.torch_motion import (
    SAMPLING_ERROR_M,
    TRIMMING,
    SlotPath,
    TrimmedSheet,
    Trimming,
    cylinder,
    face_distance,
)
from planner.proof.context import Context
from planner.proof.findings import Findings, evenly_spaced_rows, to_percent
from planner.proof.rule import MAX_FEED_FACTOR, RuleOutcome, mm, rule

MILL, SPINDLE = "verify.trim_mill", "verify.trim_spindle"
"""Codes of the rules."""
MAX_SAMPLES = 1000
"""Number of samples of a path at which the cutter is compared with the part at once."""
PART_SPACING_M = 0.3e-3
"""Maximum distance of the points of both faces that are compared with the cutter [m]."""
MAX_PART_POINTS = 1_000_000
"""Maximum number of points that are compared with the cutter at once."""
DEPTH_JITTER_FRACTION = 0.5
"""Fraction of the smallest tolerance or of the depth by which the replay may be deeper than a descent at the
plunge feed, because of chords, rounded corners and facets.
"""
MIN_START_FRACTION = 0.5
"""Minimum height at which the descent into the sheet starts, as a fraction of the stated height."""


@rule("verify.trim_mill", TrimsSheet)
def trim_mill(context: Context) -> RuleOutcome:
    """Along its outline a mill has its required depth and tilt, and it cuts nothing of the part.

    It goes into the waste, at a sufficient distance from all curves and no faster than allowed, and comes out
    along its axis.
    """
    trimming, findings = context.get(TRIMMING), Findings(MILL, context)
    for trimmed, curve, key, path in each_slot(trimming):
        cutter = trimmed.claim.mill
        if cutter is None:
            continue
        slot = MeasuredCut(findings, trimmed, key, path)
        check_depth(slot, path.curve_distance <= 0.5 * trimmed.claim.kerf + trimmed.edge_tolerance)
        check_tilt(slot)
        _check_entry(slot, cutter)
        check_retreat(slot)
        _check_gouge(slot, curve, cutter)
    findings.issues += _die_issues(context, trimming)
    return findings.outcome(to_percent, "% of what is allowed", 1.0, nothing=NOTHING_TRIMMED)


@dataclasses.dataclass(frozen=True)
class MeasuredCut:
    """A slot that a tool cut, and the findings to which its checks add issues and values.

    Attributes:
        findings: Findings of the rule.
        sheet: Claim with the motion.
        key: Key of the slot's segment.
        path: Path of the tool in the slot.
    """

    findings: Findings
    sheet: TrimmedSheet
    key: str
    path: SlotPath

    def add(self, what: str, row: int) -> None:
        """Add an issue at a sample of the motion.

        Args:
            what: Message, without the segment.
            row: Sample of the motion.
        """
        self.findings.add_at_sample(f"in {self.key} {what}", self.sheet.claim.arm, row)

    def note(self, value: float) -> None:
        """Note a measured value as a fraction of the limit."""
        self.findings.note_highest(value, self.key)


def _tool_name(trimmed: TrimmedSheet) -> str:
    return "cutter" if trimmed.claim.knife is None else "knife"


def check_depth(slot: MeasuredCut, cuts: BoolArray) -> None:
    """Check that the tip of a mill or knife is through the sheet where it cuts, and nowhere too deep.

    Where it cuts, it has to be beyond the far face by at least the required depth. Nowhere may it be deeper
    behind the near face than the thickness of the sheet plus that depth. Both hold within the tolerance of
    heights.

    Args:
        slot: Slot.
        cuts: Whether the tool cuts at each sample of the path (N,).
    """
    trimmed, path, claim, tool = slot.sheet, slot.path, slot.sheet.claim, slot.sheet.claim.through_tool
    if tool is None:
        return
    tolerance = claim.height_tolerance + trimmed.sheet.tolerance + SAMPLING_ERROR_M
    through = face_distance(trimmed.other_side, path.tip, path.axis)
    too_high = np.where(cuts, tool.depth_below - through, 0.0) / tolerance
    too_low = (path.depth - claim.thickness - tool.depth_below) / tolerance
    for k in evenly_spaced_rows(np.maximum(too_high, too_low) > 1.0, MAX_ISSUES):
        message = (
            f"the tip is {mm(float(through[k])):.2f} mm through the sheet, {mm(float(path.depth[k])):.2f} "
            f"mm behind its face, required {mm(tool.depth_below):g} mm through it within "
            f"{mm(claim.height_tolerance):g}"
        )
        slot.add(message, path.rows[k])
    slot.note(max(too_high.max(), too_low.max()))


def check_tilt(slot: MeasuredCut) -> None:
    """Check that the tilt from the sheet normal stays within the tool's cone.

    Args:
        slot: Slot.
    """
    trimmed, path = slot.sheet, slot.path
    tilt = np.arccos(np.clip((path.axis * path.feet.normal).sum(axis=1), -1.0, 1.0))
    fraction = tilt / (trimmed.claim.cone + ANGLE_ERROR_RAD + trimmed.sheet.normal_error)
    for k in evenly_spaced_rows(fraction > 1.0, MAX_ISSUES):
        message = (
            f"the {_tool_name(trimmed)} is tilted {np.rad2deg(tilt[k]):.1f} deg from the sheet's normal, "
            "allowed "
        )
        slot.add(f"{message}{np.rad2deg(trimmed.claim.cone):g} deg", path.rows[k])
    slot.note(fraction.max())


def _check_entry(slot: MeasuredCut, cutter: TrimCutter) -> None:
    """Check that a mill starts above the waste, away from all curves, and goes down no faster than allowed.

    A mill without a ramp also has to go straight down. Nothing more is checked for a ramp: `check_depth`
    already requires the full depth wherever the mill cuts the outline, so a ramp ends before it.
    """
    trimmed, claim = slot.sheet, slot.sheet.claim
    foot = slot.path.feet.foot[:1]
    distances = np.array([float(curve.distance(foot)[0][0]) for curve in trimmed.curves])
    in_waste = any(bool(curve.in_waste(foot)[0]) for curve in trimmed.curves)
    required = claim.pierce_distance - trimmed.sheet.tolerance - SAMPLING_ERROR_M
    if not in_waste or distances.min() < required:
        message = (
            "the cutter goes into the sheet "
            f"{'in the part, ' if not in_waste else ''}{mm(float(distances.min())):.2f} mm from "
            f"{trimmed.curves[int(distances.argmin())].outline.name}, required in the waste, "
            f"{mm(claim.pierce_distance):g} mm away"
        )
        slot.add(message, slot.path.rows[0])
    check_descent(slot)
    if not cutter.is_ramp:
        check_straight_entry(slot)


def check_descent(slot: MeasuredCut) -> None:
    """Check that a mill or knife starts above the sheet and goes down no faster than its plunge feed.

    The speed is checked as depth: from any earlier sample of the slot, the tool may be deeper than with its
    plunge feed only by an allowance for errors of the replay.

    Args:
        slot: Slot.
    """
    trimmed, path, claim, tool = slot.sheet, slot.path, slot.sheet.claim, slot.sheet.claim.through_tool
    if tool is None:
        return
    if path.depth[0] > -tool.start_height + min(
        claim.height_tolerance + trimmed.sheet.tolerance, MIN_START_FRACTION * tool.start_height
    ):
        message = f"the way into the sheet starts {mm(-float(path.depth[0])):.2f} mm above it, required "
        message += f"{mm(tool.start_height):g} mm"
        if path.depth[0] > SAMPLING_ERROR_M:
            message = (
                f"the {_tool_name(trimmed)} is {mm(float(path.depth[0])):.2f} mm in the sheet at the start: "
                "it "
                f"was not lifted out before, required {mm(tool.start_height):g} mm above the sheet"
            )
        slot.add(message, path.rows[0])
    fraction = 0.0
    track = trimmed.slot_track(slot.key)
    depths = trimmed.project(track.tip, track.axis)[1]
    # allowance for chords, rounded corners and facets
    jitter = DEPTH_JITTER_FRACTION * min(
        claim.tolerance, claim.height_tolerance, claim.thickness + tool.depth_below
    )
    jitter += trimmed.sheet.tolerance + SAMPLING_ERROR_M
    # uninterrupted runs of samples
    for run in np.split(np.arange(len(depths)), np.flatnonzero(~track.joined) + 1):
        # excess depth over a descent at the plunge feed from any earlier sample
        lag = depths[run] - MAX_FEED_FACTOR * tool.plunge * track.time[run]
        excess = lag - np.minimum.accumulate(lag)
        fraction = max(fraction, float(excess.max(initial=0.0)) / jitter)
        for k in evenly_spaced_rows(excess > jitter, MAX_ISSUES):
            message = (
                f"the {_tool_name(trimmed)} is {mm(float(excess[k])):.2f} mm deeper than at "
                f"{mm(tool.plunge):g} mm/s, allowed {mm(jitter):.2f} mm"
            )
            slot.add(message, track.rows[run[k]])
    slot.note(fraction)


def check_straight_entry(slot: MeasuredCut) -> None:
    """Check that the tool does not move sideways before it is through the sheet.

    Args:
        slot: Slot.
    """
    path, claim = slot.path, slot.sheet.claim
    lateral = np.linalg.norm(path.feet.foot - path.feet.foot[:1], axis=1)
    through = claim.thickness - slot.sheet.sheet.tolerance
    for k in np.flatnonzero((lateral > claim.tolerance) & (path.depth < through))[:1]:
        message = (
            f"the {_tool_name(slot.sheet)} moves sideways before it is through the sheet, required straight "
            "down"
        )
        slot.add(message, path.rows[k])


def check_retreat(slot: MeasuredCut) -> None:
    """Check that a mill or knife approaches a slot above the sheet, and retreats from it along its axis.

    Until it is out of the sheet on its retreat, it may move sideways only within the tolerance and may not be
    deeper than in its slot.

    Args:
        slot: Slot.
    """
    trimmed, claim, through_tool = slot.sheet, slot.sheet.claim, slot.sheet.claim.through_tool
    lateral_ratio = 0.0
    if through_tool is None:
        return
    segment = Segment(TRIM, slot.key.split("/", 1)[1])
    for phase in ("in", "out"):
        track = trimmed.slot_track(segment.at(phase).key)
        if not len(track.rows):
            continue
        feet, depths = trimmed.project(track.tip, track.axis)
        in_sheet = np.flatnonzero(depths > (0.0 if phase == "out" else SAMPLING_ERROR_M))
        if phase == "in":
            for k in in_sheet[:1]:  # the first sample in the sheet, if there is one
                message = (
                    f"the {_tool_name(trimmed)} comes down {mm(float(depths[k])):.2f} mm into the sheet on "
                    "its "
                    "way "
                )
                slot.add(f"{message}to it", track.rows[k])
            continue
        max_depth = (
            claim.thickness
            + through_tool.depth_below
            + claim.height_tolerance
            + trimmed.sheet.tolerance
            + SAMPLING_ERROR_M
        )
        for k in np.flatnonzero(depths > max_depth)[:1]:
            message = f"the {_tool_name(trimmed)} is {mm(float(depths[k])):.2f} mm behind the face, allowed "
            slot.add(f"{message}{mm(max_depth):.2f} mm", track.rows[k])
        lateral = np.linalg.norm(feet.foot - feet.foot[0], axis=1)[in_sheet]
        lateral_ratio = float(lateral.max(initial=0.0)) / (claim.tolerance + SAMPLING_ERROR_M)
        for k in in_sheet[lateral > claim.tolerance + SAMPLING_ERROR_M][:1]:
            slot.add(f"the {_tool_name(trimmed)} moves sideways before it is out of the sheet", track.rows[k])
    slot.note(lateral_ratio)


def _check_gouge(slot: MeasuredCut, curve: OutlineCurve, cutter_claim: TrimCutter) -> None:
    """Check that a mill's flute does not cut over the outline into the part, where the sheet is bent.

    Points of both faces of the part are compared with the flute along its path. The far face is approximated
    by the near one moved along z by the thickness. On a slope that moves its points relative to the cut, by
    at most the thickness, so their distances from the outline are reduced by the thickness.
    """
    trimmed, path, claim, cutter = slot.sheet, slot.path, slot.sheet.claim, cutter_claim.cutter
    depth_ratio, allowed = 0.0, trimmed.edge_tolerance
    flute = cylinder(0.0, cutter.flute, cutter.radius)
    corners = trimmed.sheet.vertices[trimmed.sheet.faces]
    drop = np.array([0.0, 0.0, claim.side * claim.thickness])
    faults: list[tuple[str, int]] = []
    for first in range(0, len(path.tip), MAX_SAMPLES):
        tip, axis = (values[first : first + MAX_SAMPLES] for values in (path.tip, path.axis))
        swept = SweptBody(tip, axis, flute)
        face_points, _, count = points_near(corners, swept, claim.thickness, PART_SPACING_M, MAX_PART_POINTS)
        if count > MAX_PART_POINTS:
            description = f"the sheet would have to be checked at {count} points, allowed {MAX_PART_POINTS}"
            depth_ratio, faults = np.inf, [(description, path.rows[first])]
            break
        part = face_points[~curve.in_waste(face_points)] if len(face_points) else face_points
        if not len(part):
            continue
        distances = curve.distance(part)[0]
        both_faces = np.concatenate([part, part - drop])
        outline_distances = np.concatenate([distances, distances - claim.thickness])
        flute_distances, where = least_distances(both_faces, swept, PART_SPACING_M)
        depths = np.where(flute_distances < 0.0, outline_distances, 0.0)
        depth_ratio = max(depth_ratio, float(depths.max()) / allowed)
        for k in evenly_spaced_rows(depths > allowed, MAX_ISSUES):
            description = (
                f"the cutter goes {mm(float(depths[k])):.2f} mm over the outline into the part, allowed "
            )
            faults.append((f"{description}{mm(allowed):.2f} mm", path.rows[first + where[k]]))
    for description, row in faults[:MAX_ISSUES]:
        slot.add(description, row)
    slot.note(depth_ratio)


def _die_issues(context: Context, trimming: Trimming) -> Iterator[Issue]:
    """Yield an issue for each mill or knife if any operation has a die; none states that it was removed."""
    operations = context.problem.source.get("operations") or ()
    dies = [operation for operation in operations if isinstance(operation, dict) and operation.get("die")]
    for trimmed in trimming.sheets:
        if trimmed.claim.through_tool is not None and dies:
            message = (
                f"{dies[0].get('name')} has a die behind the sheet, which the {_tool_name(trimmed)} would hit"
            )
            yield Issue(MILL, message, arm=trimmed.claim.arm)


@rule("verify.trim_spindle", TrimsSheet)
def trim_spindle(context: Context) -> RuleOutcome:
    """A mill or knife is in the sheet only in its slots and leads, with its spindle or drive up to speed."""
    trimming, findings = context.get(TRIMMING), Findings(SPINDLE, context)
    count = 0
    for trimmed in trimming.sheets:
        claim, tool = trimmed.claim, trimmed.claim.through_tool
        if tool is None:
            continue
        track = trimmed.track
        size = 0.5 * np.asarray(context.stock_at(trimmed.index).size)[:2] + claim.kerf
        is_over_sheet = (np.abs(track.tip[:, :2]) <= size).all(axis=1)
        rows = np.flatnonzero(is_over_sheet)
        height = trimmed.sheet.project(track.tip[rows]).height
        rows = rows[height < 0.5 * tool.start_height]
        count += len(trimmed.slots)
        allowed_keys = set(trimmed.slots) | {
            Segment(TRIM, key.split("/", 1)[1]).at("out").key for key in trimmed.slots
        }
        for i in rows[~np.isin(track.label[rows], list(allowed_keys))][:1]:
            message = (
                f"the {_tool_name(trimmed)} is in the sheet, or just above it, in {track.label[i]}, where "
                "nothing "
            )
            findings.add_at_sample(f"{message}is cut", claim.arm, track.rows[i])
        if not claim.signal:
            continue
        on_time = context.motion.signal_on_time(
            claim.signal, context.controller_task_names((claim.arm,)), track.time[rows]
        )
        for i in np.flatnonzero(on_time < tool.spin_up - 1e-6)[:1]:
            duration = f"for {on_time[i]:.1f} s" if on_time[i] >= 0.0 else "not"
            message = (
                f"the {_tool_name(trimmed)} is in the sheet, {claim.signal} is {duration} on, required "
                f"{tool.spin_up:g} s"
            )
            measure = (float(max(on_time[i], 0.0)), tool.spin_up, "s")
            findings.add_at_sample(message, claim.arm, track.rows[rows[i]], measure)
    return findings.outcome_without_value("" if count else NOTHING_TRIMMED, f"{count} slots")
