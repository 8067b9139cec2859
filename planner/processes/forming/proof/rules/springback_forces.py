"""Forces by which springback was computed, compared with those that the problem states or a formula gives."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from planner.geometry.arrays import FloatArray
from planner.geometry.units import MM
from planner.issues import Issue
from planner.processes.forming.claims import FormsSheet
from planner.processes.forming.proof import stated_force
from planner.processes.forming.proof.compensation import CompensationClaim
from planner.processes.forming.proof.springback_file import FileControlPoint
from planner.proof.context import Context
from planner.proof.rule import Measure, measured_issue
from planner.tooling import FormingTool

CODE = "verify.springback"
"""Code of the rule on springback."""


def springback_issue(compensation: CompensationClaim, what: str, measure: Measure | None = None) -> Issue:
    """Return an issue about an operation with springback compensation."""
    return measured_issue(CODE, f"{compensation.claim.operation}: {what}", measure, field="springback")


def claim_group(context: Context, compensation: CompensationClaim) -> tuple[object, ...]:
    """Return all claims of the operation that a claim of springback compensation belongs to."""
    return next(
        group for group in context.setup_claims[compensation.index].groups if compensation.claim in group
    )


FORCE_TOLERANCE_FRACTION = 1e-3
"""Relative difference up to which forces are equal: values in the file are rounded."""


MIN_FORCE_FRACTION = 0.01
"""Minimum force by formula as a fraction of the largest one: where a pass is flat the formula gives 0."""


def force_issues(context: Context, compensation: CompensationClaim) -> Iterator[Issue]:
    """Check that the forces at control points of a file are those that the problem states, or by formula.

    Springback follows from these forces. The formula may use the radius of either tool of the operation. At
    most one issue for each pass is returned.
    """
    setup, operation = context.setups[compensation.index], compensation.operation
    springback_data = compensation.file
    sheet = setup.stock.sheet
    if springback_data is None or sheet is None:
        return
    claims = {
        claim.segment.name: claim
        for claim in claim_group(context, compensation)
        if isinstance(claim, FormsSheet)
    }
    for name in springback_data.paths:
        pass_controls = [control for control in springback_data.controls if control.segment == name]
        if not pass_controls or name not in claims:
            yield springback_issue(compensation, f"{name} has no control point in its springback file")
            continue
        try:
            stated = stated_force.stated_pass_force(operation, claims[name])
        except ValueError as error:
            yield springback_issue(compensation, f"{Path(operation.force_by.file).name}: {error}")
            return
        if stated is not None:
            expected = _apply_minimum(stated.force_at(np.array([control.point for control in pass_controls])))
        else:
            tools = (setup.cell.arm(arm).tool for arm in operation.arms)
            radii = [tool.head.radius for tool in tools if isinstance(tool, FormingTool)]
            angle = np.array([control.angle for control in pass_controls])
            candidates = [
                formula_forces(operation, sheet.metal.tensile_stress, setup, r, angle) for r in radii
            ]
            expected = min(
                candidates, key=lambda forces: float(np.abs(forces - [c.force for c in pass_controls]).max())
            )
        difference = np.abs(np.array([control.force for control in pass_controls]) - expected)
        # forces by formula depend on wall angles that the file rounds, and stated ones on rounded positions
        allowed = FORCE_TOLERANCE_FRACTION * float(expected.max()) + (
            0.1 if operation.force_n is None else 0.0
        )
        worst_index = int(np.argmax(difference))
        if difference[worst_index] > allowed:
            message = (
                f"a control point of {name} is under {pass_controls[worst_index].force:.1f} N, the "
                "problem's force "
                "there "
            )
            measure = pass_controls[worst_index].force, float(expected[worst_index]), "N"
            yield springback_issue(compensation, f"{message}is {expected[worst_index]:.1f} N", measure)


def formula_forces(
    operation: object, tensile: float, setup: object, radius: float, angle: FloatArray
) -> FloatArray:
    """Return the axial forces (N,) [N] of a ball on walls by an empirical formula.

    F = 0.0716 Rm t^1.57 d^0.41 h^0.09 a cos a, with the tensile strength Rm in MPa, the sheet's thickness t,
    the ball's diameter d and the height h of the ridge between loops in mm, and the wall angle a in degrees.

    Args:
        operation: Operation, with its step-down or scallop.
        tensile: Tensile strength Rm [Pa].
        setup: Setup with the stock.
        radius: Radius [m] of the ball.
        angle: Wall angles (N,) [rad].

    Source: Aerens and others (2010).
    """
    thickness = float(setup.stock.size[2]) / MM  # type: ignore[attr-defined]
    r = radius / MM
    step, scallop = operation.stepdown_mm, operation.scallop_mm  # type: ignore[attr-defined]
    if step is None:
        ridge = np.full(len(angle), float(scallop))
    else:
        # loops are step / sin(angle) apart along the wall; the ridge is in the middle between two of them
        half = np.minimum(0.5 * step / np.sin(np.maximum(angle, 1e-3)), r)
        ridge = r - np.sqrt(np.maximum(r * r - half * half, 0.0))
    degrees = np.rad2deg(angle)
    force = (
        0.0716 * tensile / 1e6 * thickness**1.57 * (2.0 * r) ** 0.41 * ridge**0.09 * degrees * np.cos(angle)
    )
    return _apply_minimum(force)


def _apply_minimum(force: FloatArray, reference: FloatArray | None = None) -> FloatArray:
    """Raise forces (N,) [N] to a fraction of the largest one, or of the largest ``reference`` force."""
    return np.asarray(
        np.maximum(force, MIN_FORCE_FRACTION * float((force if reference is None else reference).max()))
    )


NEIGHBOUR_STEPS, NEIGHBOUR_ANGLE_RAD = 2, np.deg2rad(0.3)
"""A force by formula may be that of any wall up to this many points of the path away, with this uncertainty
[rad] of its angle.
"""


def _neighbour_values(value: FloatArray) -> FloatArray:
    """Return for each point of a path the values (P, 2 `NEIGHBOUR_STEPS` + 1) at it and at its neighbours.

    ``value`` (P,) has the values at the points. Beyond the ends of the path the value at the end is repeated.
    """
    return np.lib.stride_tricks.sliding_window_view(
        np.pad(value, NEIGHBOUR_STEPS, mode="edge"), 2 * NEIGHBOUR_STEPS + 1
    )


def forces_along(
    context: Context,
    compensation: CompensationClaim,
    claim: FormsSheet,
    touch: FloatArray,
    angle: FloatArray,
    controls: Sequence[FileControlPoint],
) -> FloatArray:
    """Return the minimum and maximum force (2, P) [N] at points of a path.

    They are the minimum and maximum of the stated forces at neighbouring points, or of the forces by formula
    for the walls at neighbouring points.

    Args:
        context: Context of the proof.
        compensation: Claim of springback compensation.
        claim: Claim on the pass.
        touch: Points (P, 3) [m] at which the forming tool touches the face.
        angle: Wall angles (P,) [rad] there.
        controls: Control points of the pass, whose largest force determines the minimum force.
    """
    operation, setup = compensation.operation, context.setups[compensation.index]
    stated = stated_force.stated_pass_force(operation, claim)
    if stated is not None:
        control_forces = stated.force_at(np.array([control.point for control in controls]))
        nearby = _neighbour_values(_apply_minimum(stated.force_at(touch), control_forces))
        return np.stack([nearby.min(axis=1), nearby.max(axis=1)])
    sheet, radius = setup.stock.sheet, claim.radius
    control_angles = np.array([control.angle for control in controls])
    tensile = 0.0 if sheet is None else sheet.metal.tensile_stress
    nearby_angles = _neighbour_values(angle)
    angle_cases = [
        np.maximum(nearby_angles.min(axis=1) - NEIGHBOUR_ANGLE_RAD, 0.0),
        angle,
        nearby_angles.max(axis=1) + NEIGHBOUR_ANGLE_RAD,
    ]
    force = np.array(
        [
            formula_forces(operation, tensile, setup, radius, np.append(control_angles, wall_angle))[
                len(control_angles) :
            ]
            for wall_angle in angle_cases
        ]
    )
    return np.stack([force.min(axis=0), force.max(axis=0)])
