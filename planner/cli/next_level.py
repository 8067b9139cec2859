"""``tandem next-loop --problem FILE``: the next level as a problem of its own, which `tandem plan` plans.

The problem of the result folder with the level that is next, and the file of its shifts in ``files/``.
"""

from __future__ import annotations

import copy
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from planner.cli.console import require_suffix
from planner.files import is_file
from planner.geometry.units import MM
from planner.issues import TandemError, refusal

if TYPE_CHECKING:
    from planner.loops.loop_plan import LoopPlan
    from planner.loops.next_loop import Law, Offsets
    from planner.problem import Problem

DECIMALS = 4
"""Digits behind the point of figures in mm."""


def write_level(
    path: Path,
    problem: Problem,
    plan: LoopPlan,
    number: int,
    told: Offsets,
    law: Law,
    kappa: float,
    before_mm: float | None,
) -> Path:
    """Write the problem of level ``number`` of a planned ``problem`` to ``path``, with its files beside it;
    the path. A springback file that the problem names is left out: the shifts are from the path without it.

    Raises ``TandemError``: ``forming.loop_law`` where nothing says at what shift the level before ended, what
    the level's operation or path is refused for, ``output.folder``.
    """
    from planner import pipeline
    from planner.processes import registry
    from planner.processes.forming.plan.job import FormingJob
    from planner.processes.forming.plan.level import alone, pass_of
    from planner.processes.forming.plan.springback import compensation_file, level_file
    from planner.reading.problem import build

    require_suffix(path, "a problem is .yaml", (".yaml", ".yml"), "problem")
    require_free(path, problem, "level")
    if number > 0 and before_mm is None:
        what = f"got no shift at which level {number - 1} ended"
        hint = "give --before-mm: the last one of its shifts, or 0 where it had none"
        raise refusal("forming.loop_law", what, field="before_mm", hint=hint)
    stated: dict[str, Any] = {
        "number": number,
        "pass_name": plan.name,
        "slope": law.slope,
        "most_mm": law.most / MM,
    }
    begins = round(before_mm or 0.0, DECIMALS)
    place = _formed(problem, plan.name)
    first = build(_document(problem, place, stated), registry.readers())
    job = registry.job(first, place)
    if not isinstance(job, FormingJob) or job.operation.level is None:
        raise TypeError(f"{job} forms no level")
    work, level = (
        job.planned,
        job.operation.level.model_copy(update={"plan": problem.digest, "before_mm": begins}),
    )
    one = pass_of(work, level)
    loop = alone(work, one, level)
    step = (work.operation.stepdown_mm or 0.0) * MM
    radius = work.heads[work.former(one)].radius
    way = level_file.way(one, loop, radius, plan.levels[number].path, told.offset, level, step)
    share = told.force / plan.levels[number].force.clip(min=1.0)
    why = {
        "kappa": round(kappa, DECIMALS),
        "force_over_expected": [round(float(share.min()), 3), round(float(share.max()), 3)],
        "rule": law.rule,
        "ends_mm": round(float(way.shift[-1]) / MM, DECIMALS),
    }
    identity = compensation_file.belongs_to(work, job.setup.stock, job.part)
    text = level_file.text(problem.name, work.operation.name, identity, level, way, why)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "level.json"
        file.write_text(text, encoding="utf-8")
        stated |= {"file": str(file), "plan": problem.digest, "before_mm": begins}
        return pipeline.save(build(_document(problem, place, stated), registry.readers()), path, True)


def require_free(path: Path, problem: Problem, section: str) -> None:
    """Raise ``TandemError`` (output.folder) where ``path`` is a file of the planned problem's own, or another
    than one with this ``section`` in an operation, which was written before."""
    from planner.reading import strict_yaml

    what = ""
    if path.resolve().is_relative_to(problem.path.resolve().parent):
        what = "is where the plan's own problem lies"
    elif is_file(path):
        try:
            operations = strict_yaml.read(path).data.get("operations")
        except TandemError:
            operations = None
        some = operations if isinstance(operations, list) else []
        if not any(isinstance(one, dict) and section in one for one in some):
            what = f"is another file, and no problem with a {section}"
    if what:
        hint = "give it a name of its own"
        raise refusal("output.folder", f"{path} {what}", field="problem", hint=hint)


def _formed(problem: Problem, name: str) -> int:
    """Which operation forms sheets: the one that curves are of. Raises ``TandemError`` (forming.loop_curves)
    where there are several."""
    found = [k for k, one in enumerate(problem.operations) if one.process == "forming"]
    if len(found) != 1 or len(problem.operations) != 1:
        what = f"got a problem of {len(problem.operations)} operations, a level of {name} is formed alone in "
        hint = "plan the forming of the sheet as a problem of its own"
        raise refusal("forming.loop_curves", what + "one", field="operations", hint=hint)
    return found[0]


def _document(problem: Problem, place: int, level: dict[str, Any]) -> Any:
    """The problem's file with a level in its operation, and no springback file."""
    from planner.reading import strict_yaml

    source = copy.deepcopy(dict(problem.source))
    operation = dict(source["operations"][place])
    operation.pop("springback", None)
    source["operations"] = [*source["operations"]]
    source["operations"][place] = {**operation, "level": level}
    # file names in what was read start where the process does
    return strict_yaml.Document(Path(problem.path.name), source, None, b"", file=False)
