"""Files of one level of small jobs, whose shifts are made up, not solved: 0.4 mm and more toward +x."""

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
    """A level of the first pass as a problem file has it, beside which its file is ``level.json``."""
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
    one = one_level.pass_of(work, level)
    loop = one_level.alone(work, one, level)
    ring = loop.contact.point[:-1]
    offset = (0.4 + 0.005 * (ring[:, 0] - ring[:, 0].min()) / MM) * MM
    radius = work.heads[work.former(one)].radius
    step = (work.operation.stepdown_mm or 0.0) * MM
    way = level_file.way(one, loop, radius, ring, np.asarray(offset), level, step)
    identity = compensation_file.belongs_to(work, job.setup.stock, job.part)
    level.file.write_text(
        level_file.text(problem.name, work.operation.name, identity, level, way, {"kappa": 1.0})
    )
