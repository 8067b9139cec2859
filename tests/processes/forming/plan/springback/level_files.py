"""Level files of small jobs. Their shifts are invented, not solved: at least 0.4 mm toward +x."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from planner import pipeline
from planner.geometry.units import MM
from planner.processes import registry
from planner.processes.forming.plan import level as one_level
from planner.processes.forming.plan.job import FormingJob
from planner.processes.forming.plan.springback import compensation_file, level_file

PLAN = "0123456789abcdef" * 4


def stated(number: int, **more: Any) -> dict[str, Any]:
    """Return the entry of a problem file for a level of the first pass, whose file is ``level.json``."""
    return {"number": number, "file": "level.json", "plan": PLAN, "before_mm": 0.3, **more}


def write(path: Path) -> None:
    """Write the file that the problem in ``path`` names."""
    problem = pipeline.load(path)
    job = registry.job(problem, 0)
    assert isinstance(job, FormingJob)
    level = job.operation.level
    assert level is not None
    assert level.file is not None
    work = job.planned
    one = one_level.level_pass(work, level)
    loop = one_level.make_level_path(work, one, level)
    ring = loop.contact.point[:-1]
    offset = (0.4 + 0.005 * (ring[:, 0] - ring[:, 0].min()) / MM) * MM
    radius = work.heads[work.forming_arm(one)].radius
    step = (work.operation.stepdown_mm or 0.0) * MM
    offset_ring = level_file.OffsetRing(point=ring, offset=np.asarray(offset))
    way = level_file.shifted_level_path(one, loop, radius, offset_ring, level, step)
    identity = compensation_file.job_identity(work, job.setup.stock, job.part)
    level.file.write_text(
        level_file.level_file_text(problem.name, work.operation.name, identity, level, way, {"kappa": 1.0})
    )
