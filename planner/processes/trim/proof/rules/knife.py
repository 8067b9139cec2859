"""The rule on sheets that a knife trims.

verify.trim_knife checks depth and tilt of the blade, its alignment with the curve, that its edge is ahead,
and that it enters and leaves the sheet along its axis without rotation.
"""

import numpy as np

from planner.claims.segments import Segment
from planner.processes.trim.claims import TrimBlade, TrimsSheet
from planner.processes.trim.proof.blade_motion import blade_path
from planner.processes.trim.proof.outlines import TRIM
from planner.processes.trim.proof.rules.mill import (
    MeasuredCut,
    check_depth,
    check_descent,
    check_retreat,
    check_straight_entry,
    check_tilt,
)
from planner.processes.trim.proof.rules.slots import ANGLE_ERROR_RAD, MAX_ISSUES, NOTHING_TRIMMED, each_slot
from planner.processes.trim.proof.torch_motion import SAMPLING_ERROR_M, TRIMMING
from planner.proof.context import Context
from planner.proof.findings import Findings, to_percent
from planner.proof.rule import RuleOutcome, mm, rule

TRIM_KNIFE = "verify.trim_knife"
"""Code of the rule."""
MIN_ADVANCE_M = 0.02e-3
"""A knife that moves along the face by less than this [m] between two samples is at rest."""


@rule("verify.trim_knife", TrimsSheet)
def trim_knife(context: Context) -> RuleOutcome:
    """A knife in the sheet is aligned with its curve, its edge ahead, and at its required depth and tilt.

    It enters along its axis, no faster than allowed and without rotation, and leaves in the same way. It is
    lifted at sharp corners.
    """
    findings = Findings(TRIM_KNIFE, context)
    for sheet, _, key, path in each_slot(context.get(TRIMMING)):
        blade = sheet.claim.knife
        if blade is None:
            continue
        has_moved = np.linalg.norm(path.feet.foot - path.feet.foot[:1], axis=1) > sheet.claim.tolerance
        slot = MeasuredCut(findings, sheet, key, path)
        check_straight_entry(slot)
        check_depth(slot, has_moved)
        check_tilt(slot)
        check_descent(slot)
        check_retreat(slot)
        _check_alignment(slot, blade)
        _check_exit_rotation(slot, blade)
        _check_direction(slot, blade)
    return findings.outcome(to_percent, "% of what is allowed", 1.0, nothing=NOTHING_TRIMMED)


def _check_alignment(slot: MeasuredCut, knife: TrimBlade) -> None:
    """Check that the blade is aligned with its curve wherever its tip is behind the face."""
    blade = blade_path(slot.sheet, knife, slot.key)
    errors = np.where(blade.deep > SAMPLING_ERROR_M, blade.heading_errors(), 0.0)
    fraction = errors / (knife.heading_tolerance + ANGLE_ERROR_RAD + slot.sheet.sheet.normal_error)
    faulty = np.flatnonzero(fraction > 1.0)
    for k in faulty[np.argsort(-fraction[faulty], kind="stable")][:MAX_ISSUES]:
        message = f"the blade is rotated {np.rad2deg(errors[k]):.1f} deg from its curve inside the sheet, "
        message += (
            f"allowed {np.rad2deg(knife.heading_tolerance):g} deg, and no rotation there at a sharp corner"
        )
        slot.add(message, blade.rows[k])
    slot.note(fraction.max())


def _check_direction(slot: MeasuredCut, knife: TrimBlade) -> None:
    """Check that the knife moves with its edge ahead wherever it is in the sheet."""
    blade = blade_path(slot.sheet, knife, slot.key)
    step = np.diff(blade.feet.foot, axis=0)
    advance = (step * blade.ahead[1:]).sum(axis=1)
    in_sheet = (blade.deep[1:] > SAMPLING_ERROR_M) & (np.linalg.norm(step, axis=1) > MIN_ADVANCE_M)
    for k in np.flatnonzero(in_sheet & (advance <= 0.0))[:1]:
        message = "the knife moves backwards in the sheet, but its edge has to be ahead"
        slot.add(message, blade.rows[k + 1])


def _check_exit_rotation(slot: MeasuredCut, knife: TrimBlade) -> None:
    """Check that the knife does not rotate on its way out until it is above the sheet."""
    trimmed = slot.sheet
    track = trimmed.slot_track(Segment(TRIM, slot.key.split("/", 1)[1]).at("out").key)
    if not len(track.rows):
        return
    depth = trimmed.project(track.tip, track.axis)[1]
    rotation = np.arccos(np.clip(track.x_axis @ track.x_axis[0], -1.0, 1.0))
    fraction = np.where(depth > 0.0, rotation, 0.0) / (knife.heading_tolerance + ANGLE_ERROR_RAD)
    for k in np.flatnonzero(fraction > 1.0)[:1]:
        message = (
            f"the knife rotates by {np.rad2deg(rotation[k]):.1f} deg while it is {mm(float(depth[k])):.2f} "
            "mm in the sheet on its way out, but it has to be lifted first"
        )
        slot.add(message, track.rows[k])
    slot.note(fraction.max())
