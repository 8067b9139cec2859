"""The job of ``straight_job`` with a KUKA arm; its tool's poses are claimed too, so that no pose is free."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np

from planner.languages.writing import write
from planner.processes.poses.claims import FollowsPoses
from tests.processes.hotwire.proof import straight_job

MODEL = "kr10_r1100"
POSITION = 0.1e-3
ANGLE = np.deg2rad(0.1)


def problem():
    """The problem of the job."""
    return straight_job.problem(MODEL)


@functools.cache
def claims(count=12):
    """The claims of the process, and every pose within 0.1 mm and 0.1 degrees."""
    out = {}
    plan = straight_job.plan(count, model=MODEL)
    for (name, own), operation in zip(straight_job.claims().items(), plan.operations, strict=True):
        poses = operation.targets.poses(operation.values)["left"]
        out[name] = (*own, FollowsPoses("left", "stock", poses, (), POSITION, ANGLE))
    return out


def programs(count=12):
    """The texts of the job as the planner writes them."""
    return straight_job.programs(count, MODEL)


def older():
    """The problem with a controller of the older dialect."""
    made = problem()
    controller = dataclasses.replace(made.cell.controller, dialect="krc2")
    return dataclasses.replace(made, cell=dataclasses.replace(made.cell, controller=controller))


@functools.cache
def older_programs(count=12):
    """The texts of the job in the older dialect."""
    return write.program_files(straight_job.plan(count, model=MODEL), older())
