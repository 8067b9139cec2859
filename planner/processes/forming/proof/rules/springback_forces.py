"""Forces by which springback was computed, against those that the problem states or a formula gives."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from planner.geometry.arrays import FloatArray
from planner.geometry.units import MM
from planner.issues import Issue
from planner.processes.forming.claims import FormsSheet
from planner.processes.forming.proof import stated_force
from planner.processes.forming.proof.released import Told
from planner.processes.forming.proof.springback_file import Control
from planner.proof.context import Context
from planner.proof.rule import Measure, issue
from planner.tooling import FormingTool

CODE = "verify.springback"
"""Code of this rule."""


def springback_issue(one: Told, what: str, measure: Measure | None = None) -> Issue:
    """An issue about an operation whose tools go deeper than the part."""
    return issue(CODE, f"{one.claim.operation}: {what}", measure, field="springback")


def group_of(context: Context, one: Told) -> tuple[object, ...]:
    """All claims of the operation of a claim."""
    return next(group for group in context.setup_claims[one.index].groups if one.claim in group)


FORCE_SHARE = 1e-3
"""Forces that differ by this share are one: figures of the file are rounded."""


LEAST_FORCE = 0.01
"""Forces by formula are this share of the largest at least: where a pass is flat it says 0."""


def force_issues(context: Context, one: Told) -> Iterator[Issue]:
    """Whether forces are the problem's, or by the formula that it names."""
    setup, given, operation = context.setups[one.index], one.given, one.operation
    sheet = setup.stock.sheet
    if given is None or sheet is None:
        return
    claims = {claim.segment.name: claim for claim in group_of(context, one) if isinstance(claim, FormsSheet)}
    for name in given.ways:
        mine = [control for control in given.controls if control.segment == name]
        if not mine or name not in claims:
            yield springback_issue(one, f"{name} has no control point in its springback file")
            continue
        try:
            stated = stated_force.stated(operation, claims[name])
        except ValueError as error:
            yield springback_issue(one, f"{Path(operation.force_by.file).name}: {error}")
            return
        if stated is not None:
            wanted = _at_least(stated.at(np.array([control.place for control in mine])))
        else:
            arms = (setup.cell.arm(arm).tool for arm in operation.arms)
            radii = [tool.head.radius for tool in arms if isinstance(tool, FormingTool)]
            angle = np.array([control.angle for control in mine])
            each = [formula_forces(operation, sheet.metal.tensile_stress, setup, r, angle) for r in radii]
            wanted = min(each, key=lambda some: float(np.abs(some - [c.force for c in mine]).max()))
        off = np.abs(np.array([control.force for control in mine]) - wanted)
        # figures by formula hang on angles that the file rounds, those by place on places
        allowed = FORCE_SHARE * float(wanted.max()) + (0.1 if operation.force_n is None else 0.0)
        k = int(np.argmax(off))
        if off[k] > allowed:
            what = f"a control point of {name} is under {mine[k].force:.1f} N; the problem's force there "
            measure = mine[k].force, float(wanted[k]), "N"
            yield springback_issue(one, f"{what}is {wanted[k]:.1f} N", measure)


def formula_forces(
    operation: object, tensile: float, setup: object, radius: float, angle: FloatArray
) -> FloatArray:
    """Forces (N,) [N] on walls at ``angle`` (N,) [rad] of a ball: F = 0.0716 Rm t^1.57 d^0.41 h^0.09 a cos a,
    Rm in MPa, lengths in mm, a in degrees (Aerens and others 2010), h the ridge between loops."""
    thick = float(setup.stock.size[2]) / MM  # type: ignore[attr-defined]
    r = radius / MM
    step, scallop = operation.stepdown_mm, operation.scallop_mm  # type: ignore[attr-defined]
    if step is None:
        ridge = np.full(len(angle), float(scallop))
    else:
        half = np.minimum(0.5 * step / np.sin(np.maximum(angle, 1e-3)), r)
        ridge = r - np.sqrt(np.maximum(r * r - half * half, 0.0))
    degrees = np.rad2deg(angle)
    force = 0.0716 * tensile / 1e6 * thick**1.57 * (2.0 * r) ** 0.41 * ridge**0.09 * degrees * np.cos(angle)
    return _at_least(force)


def _at_least(force: FloatArray, of: FloatArray | None = None) -> FloatArray:
    """Forces (N,) [N] that are no smaller than where a pass is flat, by the largest ``of`` them."""
    return np.asarray(np.maximum(force, LEAST_FORCE * float((force if of is None else of).max())))


ALONG, ANGLE_ALONG = 2, np.deg2rad(0.3)
"""Walls by which a formula takes a force are those so many steps of `STEP` around, within this [rad]."""


def _around(value: FloatArray) -> FloatArray:
    """Values (P, 2 `ALONG` + 1) at places (P,) of a way and those around."""
    return np.lib.stride_tricks.sliding_window_view(np.pad(value, ALONG, mode="edge"), 2 * ALONG + 1)


def forces_along(
    context: Context,
    one: Told,
    claim: FormsSheet,
    touch: FloatArray,
    angle: FloatArray,
    controls: Sequence[Control],
) -> FloatArray:
    """The least and largest force (2, P) [N] at places ``touch`` (P, 3) [m] of a way, on walls at ``angle``
    (P,) [rad]: as stated around, or by these walls; ``controls`` are its control points."""
    operation, setup = one.operation, context.setups[one.index]
    stated = stated_force.stated(operation, claim)
    if stated is not None:
        largest = stated.at(np.array([control.place for control in controls]))
        near = _around(_at_least(stated.at(touch), largest))
        return np.stack([near.min(axis=1), near.max(axis=1)])
    sheet, radius = setup.stock.sheet, claim.radius
    some = np.array([control.angle for control in controls])
    tensile = 0.0 if sheet is None else sheet.metal.tensile_stress
    wide = _around(angle)
    each = [np.maximum(wide.min(axis=1) - ANGLE_ALONG, 0.0), angle, wide.max(axis=1) + ANGLE_ALONG]
    force = np.array(
        [formula_forces(operation, tensile, setup, radius, np.append(some, own))[len(some) :] for own in each]
    )
    return np.stack([force.min(axis=0), force.max(axis=0)])
