"""The job of ``straight_job`` with a UR10e; its tool's poses are claimed too, so that no pose is free."""

from __future__ import annotations

import functools

import numpy as np

from planner.processes.poses.claims import FollowsPoses
from tests.processes.hotwire.proof import straight_job

MODEL = "ur10e"
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
