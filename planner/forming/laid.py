"""The paths of both tools over one pass: the contact's path, the tool opposite by mode, refined until the gap
holds between targets too."""

from __future__ import annotations

import numpy as np

from planner.forming.job import Job
from planner.forming.paths import make_path
from planner.forming.values import Pass, ToolPath


def lay(job: Job, one: Pass) -> ToolPath:
    """Where the tools are over a pass. Raises ``TandemError`` with the codes ``forming.*``."""
    head = job.heads[job.former(one)]
    contact = make_path(one, head.radius, job.options)
    axis = np.tile([0.0, 0.0, -float(one.side)], (len(contact.point), 1))
    return ToolPath(contact.centre, axis, None, None, np.full(len(axis), np.nan), contact)
