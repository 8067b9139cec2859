"""What a forming job is refused for, or warned of, once its tools' paths are known."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from planner.catalogue import robot
from planner.forming import holder
from planner.forming.clamp import clamp_issues
from planner.forming.die import die_issues
from planner.forming.die_body import die_mesh
from planner.forming.force import ForceEstimate, estimate, payload_issue
from planner.forming.passes import ALIKE, pass_issues
from planner.forming.state import states
from planner.forming.state_check import clear_issues
from planner.forming.support import support_issues
from planner.forming.thickness import steepest
from planner.forming.values import Pass, ToolPath
from planner.forming.work import Work
from planner.issues import Issue
from planner.problem import Setup
from planner.sheet_metals import thickness_doubt
from planner.tooling import profile
from planner.units import DEG, MM


def check(work: Work, setup: Setup, paths: Sequence[tuple[Pass, ToolPath]]) -> list[Issue]:
    """All issues of a job but its die's: metal, passes, forces, the die's holder, supports that cannot do as
    they should, tools that would cut into what is formed already."""
    out = [*work.tree.issues, *_metal(work), *_forces(work, setup, paths), *_clear(work, paths)]
    return [*out, *holder.step_issues(work, paths)]


def shift_issues(work: Work) -> Iterator[Issue]:
    """Features around whose wall the support cannot be turned by the stated shift (forming.shift): beyond the
    vertical it would leave the wall that it supports."""
    shift, final = work.operation.shift_deg, {one.feature: one for one in work.passes}
    for number, one in final.items():
        wall = steepest(one.vertices, one.faces) / DEG
        if shift > wall + ALIKE / DEG:
            what = (
                f"feature {number}: shift_deg is {shift:g}, allowed is 0 to {wall:.1f}, the angle of its wall"
            )
            hint = "take a smaller shift_deg; at the wall's angle the support is straight behind the former"
            yield Issue(
                "forming.shift", what, field="shift_deg", value=shift, limit=wall, unit="deg", hint=hint
            )


def step_issues(work: Work) -> Iterator[Issue]:
    """A stepdown that is more than the whole part is deep (forming.path_options): its one loop would be at
    the floor, where balls are easily too large, and nothing above it would be formed."""
    op = work.operation
    deep = max(abs(one.end - one.start) for one in work.passes) / MM
    if op.mode != "adsif" and op.stepdown_mm is not None and op.stepdown_mm > deep:
        what = f"stepdown_mm is {op.stepdown_mm:g}, allowed is up to {deep:.3g}, the depth of the part"
        hint = f"take a tenth of that, {0.1 * deep:.2g}, or state scallop_mm instead"
        yield Issue(
            "forming.path_options",
            what,
            field="operations.stepdown_mm",
            value=op.stepdown_mm,
            limit=deep,
            unit="mm",
            hint=hint,
        )


def of_die(work: Work) -> Iterator[Issue]:
    """Issues of the die, which asks for no path: a part that it is not the die of is not to be blamed on a
    ball."""
    die = work.operation.die
    if die is not None:
        final = {one.feature: one for one in work.passes}  # shapes in between stand off the die
        tolerance = work.operation.gouge_tol_mm * MM
        yield from die_issues(tuple(final.values()), die, die_mesh(die), work.thickness, tolerance)


def force(work: Work, one: Pass, path: ToolPath) -> ForceEstimate:
    """The axial force on the forming tool of a pass."""
    op, radius = work.operation, work.heads[work.former(one)].radius
    walls = path.contact.angle[path.contact.angle > 0.0]
    if op.stepdown_mm is not None:
        step = op.stepdown_mm * MM
    else:  # the step whose ridges are as high as stated, at the steepest wall
        ridge = (op.scallop_mm or 0.0) * MM
        step = 2.0 * float(np.sin(walls.max())) * float(np.sqrt(2.0 * radius * ridge - ridge**2))
    return estimate(work.sheet.metal, work.thickness, 2.0 * radius, step, walls, op.force_n)


def _clear(work: Work, paths: Sequence[tuple[Pass, ToolPath]]) -> Iterator[Issue]:
    found = states(work.tree, work.mesh, work.passes, work.thickness)
    for (one, path), state in zip(paths, found, strict=True):
        arms = tuple(filter(None, (work.former(one), work.supporter(one))))
        heads = [work.heads[arm] for arm in arms]
        support = heads[1] if len(heads) > 1 else None
        yield from support_issues(one, path, work.operation, heads[0], support, work.thickness)
        profiles = [profile(head) for head in heads]
        yield from clear_issues(one, path, state, arms, profiles, work.pressed)
        if work.operation.cone_deg == 0.0:  # else motion may tilt it out of there
            yield from clamp_issues(one, path, work.clamp, arms, profiles)


def _metal(work: Work) -> Iterator[Issue]:
    doubt = thickness_doubt(work.sheet.metal, work.thickness)
    if doubt is not None:
        yield doubt
    yield from pass_issues(work.passes, work.thickness, work.operation, work.sheet.metal)


def _forces(work: Work, setup: Setup, paths: Sequence[tuple[Pass, ToolPath]]) -> Iterator[Issue]:
    """The largest force of each arm against what it carries."""
    most: dict[str, ForceEstimate] = {}
    for one, path in paths:
        found = force(work, one, path)
        for arm in filter(None, (work.former(one), work.supporter(one))):
            if work.operation.mode == "heat" and arm != work.former(one):
                continue
            if arm not in most or found.force > most[arm].force:
                most[arm] = found
    for arm, found in most.items():
        mounted = setup.cell.arm(arm)
        data = robot(mounted.robot)
        issue = payload_issue(found, f"arm {arm}", data.title, data.payload, mounted.tool.mass)
        if issue is not None:
            yield issue
