"""The paths of both tools over one pass, whatever the mode."""

from __future__ import annotations

from planner.forming.adsif_path import adsif_tool_path
from planner.forming.job import Job
from planner.forming.paths import make_path
from planner.forming.support import tool_path
from planner.forming.values import Pass, ToolPath


def lay(job: Job, one: Pass) -> ToolPath:
    """Where the tools are over a pass. Raises ``TandemError`` with the codes ``forming.*``."""
    op, other = job.operation, job.supporter(one)
    former = job.heads[job.former(one)]
    if op.mode == "adsif" and other is not None:
        return adsif_tool_path(one, op, former, job.heads[other], job.thickness, job.sheet.metal)
    contact = make_path(one, former.radius, job.options)
    return tool_path(one, contact, op, former, None if other is None else job.heads[other], job.thickness)
