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
from planner.forming.job import Job
from planner.forming.passes import ALIKE, pass_issues
from planner.forming.state import states
from planner.forming.state_check import clear_issues
from planner.forming.support import support_issues
from planner.forming.thickness import steepest
from planner.forming.values import Pass, ToolPath
from planner.issues import Issue
from planner.problem import Setup
from planner.sheet_metals import thickness_doubt
from planner.tooling import profile
from planner.units import DEG, MM


def check(job: Job, setup: Setup, paths: Sequence[tuple[Pass, ToolPath]]) -> list[Issue]:
    """All issues of a job: metal, passes, forces, the die and its holder, supports that cannot do as they
    should, tools that would cut into what is formed already."""
    out = [*job.tree.issues, *_metal(job), *_forces(job, setup, paths), *_clear(job, paths)]
    return [*out, *_die(job), *holder.step_issues(job, paths)]


def shift_issues(job: Job) -> Iterator[Issue]:
    """Features around whose wall the support cannot be turned by the stated shift (forming.shift): beyond the
    vertical it would leave the wall that it supports."""
    shift, final = job.operation.shift_deg, {one.feature: one for one in job.passes}
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


def force(job: Job, one: Pass, path: ToolPath) -> ForceEstimate:
    """The axial force on the forming tool of a pass."""
    op, radius = job.operation, job.heads[job.former(one)].radius
    walls = path.contact.angle[path.contact.angle > 0.0]
    if op.stepdown_mm is not None:
        step = op.stepdown_mm * MM
    else:  # the step whose ridges are as high as stated, at the steepest wall
        ridge = (op.scallop_mm or 0.0) * MM
        step = 2.0 * float(np.sin(walls.max())) * float(np.sqrt(2.0 * radius * ridge - ridge**2))
    return estimate(job.sheet.metal, job.thickness, 2.0 * radius, step, walls, op.force_n)


def _clear(job: Job, paths: Sequence[tuple[Pass, ToolPath]]) -> Iterator[Issue]:
    found = states(job.tree, job.mesh, job.passes, job.thickness)
    for (one, path), state in zip(paths, found, strict=True):
        arms = tuple(filter(None, (job.former(one), job.supporter(one))))
        heads = [job.heads[arm] for arm in arms]
        support = heads[1] if len(heads) > 1 else None
        yield from support_issues(one, path, job.operation, heads[0], support, job.thickness)
        profiles = [profile(head) for head in heads]
        yield from clear_issues(one, path, state, arms, profiles, job.pressed)
        if job.operation.cone_deg == 0.0:  # else motion may tilt it out of there
            yield from clamp_issues(one, path, job.clamp, arms, profiles)


def _die(job: Job) -> Iterator[Issue]:
    die = job.operation.die
    if die is not None:
        final = {one.feature: one for one in job.passes}  # shapes in between stand off the die
        tolerance = job.operation.gouge_tol_mm * MM
        yield from die_issues(tuple(final.values()), die, die_mesh(die), job.thickness, tolerance)


def _metal(job: Job) -> Iterator[Issue]:
    doubt = thickness_doubt(job.sheet.metal, job.thickness)
    if doubt is not None:
        yield doubt
    yield from pass_issues(job.passes, job.thickness, job.operation, job.sheet.metal)


def _forces(job: Job, setup: Setup, paths: Sequence[tuple[Pass, ToolPath]]) -> Iterator[Issue]:
    """The largest force of each arm against what it carries."""
    most: dict[str, ForceEstimate] = {}
    for one, path in paths:
        found = force(job, one, path)
        for arm in filter(None, (job.former(one), job.supporter(one))):
            if job.operation.mode == "heat" and arm != job.former(one):
                continue
            if arm not in most or found.force > most[arm].force:
                most[arm] = found
    for arm, found in most.items():
        mounted = setup.cell.arm(arm)
        data = robot(mounted.robot)
        issue = payload_issue(found, f"arm {arm}", data.title, data.payload, mounted.tool.mass)
        if issue is not None:
            yield issue
