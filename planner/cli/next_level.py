"""``tandem next-loop --problem FILE``: the next level as its own problem, which `tandem plan` plans.

It is the problem of the result folder with the next level, and the file of its shifts in ``files/``.
"""

from __future__ import annotations

import copy
import dataclasses
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from planner.cli.console import require_suffix
from planner.files import is_file
from planner.geometry.units import MM
from planner.issues import TandemError, issue_error

if TYPE_CHECKING:
    from planner.loops.level_correction import CorrectionLaw, LevelCorrection
    from planner.loops.loop_plan import LoopPlan
    from planner.problem import Problem

DECIMALS = 4
"""Decimals of lengths in mm and of kappa."""


@dataclasses.dataclass(frozen=True)
class CorrectedLevel:
    """A level of a pass with its correction.

    Attributes:
        plan: The pass.
        number: Index of the level.
        correction: Correction of the level.
        law: Correction law.
        kappa: Ratio of the springback of the sheet to that of the model.
        before_mm: Shift [mm] at which the previous level ended, None if it is not stated.
    """

    plan: LoopPlan
    number: int
    correction: LevelCorrection
    law: CorrectionLaw
    kappa: float
    before_mm: float | None


def write_level(path: Path, problem: Problem, corrected: CorrectedLevel) -> Path:
    """Write the problem of one level of a pass, with its files.

    The file with the shifts of the level refers to the level's path. This path is determined first, from a
    problem that states the level without shifts. A springback file of the problem is left out, because shifts
    are relative to the path without it.

    Args:
        path: File to write.
        problem: Planned problem.
        corrected: Level of one of its passes.

    Returns:
        Path of the file.

    Raises:
        TandemError: ``forming.loop_law`` if ``before_mm`` is missing, ``output.folder``, or the issues of the
            level's operation or path.
    """
    from planner import pipeline
    from planner.processes import registry
    from planner.processes.forming.plan.job import FormingJob
    from planner.processes.forming.plan.level import level_pass, make_level_path
    from planner.processes.forming.plan.springback import compensation_file, level_file
    from planner.reading.problem import build_problem

    plan, number, law = corrected.plan, corrected.number, corrected.law
    require_suffix(path, "a problem is .yaml", (".yaml", ".yml"), "problem")
    require_free(path, problem, "level")
    if number > 0 and corrected.before_mm is None:
        message = f"the shift at which level {number - 1} ended is missing"
        hint = "state --before-mm: its last shift, or 0 if it had none"
        raise issue_error("forming.loop_law", message, field="before_mm", hint=hint)
    level_fields: dict[str, Any] = {
        "number": number,
        "pass_name": plan.name,
        "slope": law.slope,
        "most_mm": law.max_offset / MM,
    }
    start_shift_mm = round(corrected.before_mm or 0.0, DECIMALS)
    operation_index = _forming_operation_index(problem, plan.name)
    problem_without_shifts = build_problem(
        _level_document(problem, operation_index, level_fields), registry.readers()
    )
    job = registry.job(problem_without_shifts, operation_index)
    if not isinstance(job, FormingJob) or job.operation.level is None:
        raise TypeError(f"{job} forms no level")
    work = job.planned
    level = job.operation.level.model_copy(update={"plan": problem.digest, "before_mm": start_shift_mm})
    single_level_pass = level_pass(work, level)
    level_path = make_level_path(work, single_level_pass, level)
    stepdown = (work.operation.stepdown_mm or 0.0) * MM
    radius = work.heads[work.forming_arm(single_level_pass)].radius
    ring = level_file.OffsetRing(point=plan.levels[number].path, offset=corrected.correction.offset)
    tool_path = level_file.shifted_level_path(single_level_pass, level_path, radius, ring, level, stepdown)
    force_ratio = corrected.correction.force / plan.levels[number].force.clip(min=1.0)
    reasons = {
        "kappa": round(corrected.kappa, DECIMALS),
        "force_over_expected": [round(float(force_ratio.min()), 3), round(float(force_ratio.max()), 3)],
        "rule": law.rule,
        "ends_mm": round(float(tool_path.shift[-1]) / MM, DECIMALS),
    }
    identity = compensation_file.job_identity(work, job.setup.stock, job.part)
    text = level_file.level_file_text(problem.name, work.operation.name, identity, level, tool_path, reasons)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "level.json"
        file.write_text(text, encoding="utf-8")
        level_fields |= {"file": str(file), "plan": problem.digest, "before_mm": start_shift_mm}
        return pipeline.save(
            build_problem(_level_document(problem, operation_index, level_fields), registry.readers()),
            path,
            True,
        )


def require_free(path: Path, problem: Problem, section: str) -> None:
    """Require that a problem file may be written to a path.

    The path must be free, or contain a problem that the same command wrote earlier.

    Args:
        path: File to write.
        problem: Planned problem. No file may be written into its folder.
        section: Section of an operation by which an earlier problem of the command is recognised.

    Raises:
        TandemError: ``output.folder``.
    """
    from planner.reading import strict_yaml

    message = ""
    if path.resolve().is_relative_to(problem.path.resolve().parent):
        message = "is in the folder of the plan's own problem"
    elif is_file(path):
        try:
            operations = strict_yaml.read(path).data.get("operations")
        except TandemError:
            operations = None
        operation_list = operations if isinstance(operations, list) else []
        if not any(isinstance(operation, dict) and section in operation for operation in operation_list):
            message = f"exists and is not a problem with a {section}"
    if message:
        hint = "choose another name"
        raise issue_error("output.folder", f"{path} {message}", field="problem", hint=hint)


def _forming_operation_index(problem: Problem, name: str) -> int:
    """Return the index of the only operation of a problem, which forms the sheet.

    Args:
        problem: Problem.
        name: Name of the pass, for the message.

    Raises:
        TandemError: ``forming.loop_curves``, there are several operations, or it is not a forming operation.
    """
    forming_indices = [
        index for index, operation in enumerate(problem.operations) if operation.process == "forming"
    ]
    if len(forming_indices) != 1 or len(problem.operations) != 1:
        text = f"got a problem of {len(problem.operations)} operations, a level of {name} needs a problem of "
        hint = "plan the forming of the sheet as a problem of its own"
        raise issue_error("forming.loop_curves", text + "one", field="operations", hint=hint)
    return forming_indices[0]


def _level_document(problem: Problem, operation_index: int, level: dict[str, Any]) -> Any:
    """Return the problem as a document, with ``level`` in its operation and without a springback file."""
    from planner.reading import strict_yaml

    source = copy.deepcopy(dict(problem.source))
    operation = dict(source["operations"][operation_index])
    operation.pop("springback", None)
    source["operations"] = [*source["operations"]]
    source["operations"][operation_index] = {**operation, "level": level}
    # file names in the source are relative to the working directory
    return strict_yaml.Document(Path(problem.path.name), source, None, b"", file=False)
