"""One job from its files to its result folder, in this process: the same as ``tandem plan``.

Figures of the outcome, which summaries and comparisons show, have names that end in their units.
"""

from __future__ import annotations

import dataclasses
import math
import time
import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Final

from planner import pipeline
from planner.batch.job import PROBLEM, Done, State
from planner.files import RESULT, write_folder
from planner.issues import Issue, TandemError, given_wrong
from planner.pipeline import Outcome
from planner.plans import Plan
from planner.verify.result import RuleResult

FIGURE_OF_RULE: Final[dict[str, str]] = {
    "verify.clearance": "clearance_mm",
    "verify.joint_limits": "joint_limits_deg",
    "verify.joint_speed": "joint_speed_percent",
    "verify.singularity": "singularity_deg",
    "verify.surface": "surface_percent",
}
"""Rules of the proof whose worst values are figures: least distance, least distance to a limit, greatest
share of a limit, least distance to a singularity, share of the cut faces within tolerance."""


def figures(plan: Plan, rules: Iterable[RuleResult]) -> dict[str, float]:
    """``targets``, ``cycle_s`` [s], ``path_cost``, and the worst values of `FIGURE_OF_RULE`.

    What a plan or proof does not know, or is not finite, is left out.
    """
    out: dict[str, float] = {
        "targets": float(sum(operation.targets.count for operation in plan.operations)),
        "cycle_s": sum(float(operation.time[-1]) for operation in plan.operations if len(operation.time)),
    }
    costs = [operation.metrics.get("trajopt_cost") for operation in plan.operations]
    known = [float(cost) for cost in costs if isinstance(cost, int | float)]
    if known and len(known) == len(costs):
        out["path_cost"] = sum(known)
    for rule in rules:
        if rule.code in FIGURE_OF_RULE and rule.worst is not None:
            out[FIGURE_OF_RULE[rule.code]] = float(rule.worst)
    return {name: value for name, value in out.items() if math.isfinite(value)}


OnIssues = Callable[[Sequence[Issue]], None]


def solve(
    name: str,
    source: Path,
    result: Path,
    origins: Mapping[str, str],
    on_progress: pipeline.Progress,
    on_issues: OnIssues,
) -> Done:
    """Plan the bundle in ``source`` and write its result folder to ``result``, which is there for every state
    but ``crashed``.

    ``origins`` as in :class:`planner.batch.job.Job`; ``on_issues`` gets issues as they are known.
    """
    start = time.perf_counter()
    called = Names(source, origins)

    def done(state: State, issues: Sequence[Issue], metrics: Mapping[str, float]) -> Done:
        return Done(name, state, tuple(issues), metrics, time.perf_counter() - start)

    problem = None
    try:
        problem = pipeline.load(source / PROBLEM)
        on_issues(called.issues((*(problem.part.notes if problem.part is not None else ()), *problem.notes)))
        outcome = called.outcome(pipeline.plan(problem, on_progress))
        on_issues(outcome.issues)
        outcome.save(result, on_progress)
    except TandemError as error:
        issues = called.issues(error.issues)
        on_issues(issues)
        pipeline.save_failure(problem, issues, result)
        return done("bad_input" if problem is None or given_wrong(issues) else "infeasible", issues, {})
    except Exception as error:  # what planning should never do; the job's state says so
        what = f"{type(error).__name__}: {error}; nothing was written, please report this"
        last = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(last.filename).name}, line {last.lineno}"
        return done("crashed", [Issue("internal.error", called.text(what), hint=where)], {})
    state: State = "verified" if pipeline.exit_code(outcome) == 0 else "unproven"
    return done(state, outcome.issues, figures(outcome.plan, outcome.proof.rules))


def write_failure(folder: Path, issues: Sequence[Issue]) -> None:
    """A result folder with the report alone, for a job whose planning was stopped."""
    pipeline.save_failure(None, tuple(issues), folder)


def write_result(folder: Path, files: Mapping[str, bytes]) -> None:
    """A result folder of files that were planned elsewhere, whole or not at all."""
    write_folder(folder, files, RESULT)


class Names:
    """What people call the files of a job that lie in ``source`` for its planning."""

    def __init__(self, source: Path, origins: Mapping[str, str]) -> None:
        names = [p.relative_to(source).as_posix() for p in source.rglob("*") if p.is_file()]
        # the longest first: a name may be the beginning of another
        pairs = [(str(source / name), origins.get(name, name)) for name in sorted(names, key=len)[::-1]]
        self._pairs = (*pairs, (str(source), "the problem's folder"))

    def text(self, text: str) -> str:
        """The text with files called as people do."""
        for path, name in self._pairs:
            text = text.replace(path, name)
        return text

    def issue(self, issue: Issue) -> Issue:
        """The issue with files called as people do."""
        changes = {
            field: self.text(value)
            for field in ("file", "message", "hint", "target")
            if (value := getattr(issue, field)) is not None
        }
        return dataclasses.replace(issue, **changes)  # type: ignore[arg-type]

    def issues(self, issues: Sequence[Issue]) -> tuple[Issue, ...]:
        """All of them."""
        return tuple(self.issue(issue) for issue in issues)

    def outcome(self, outcome: Outcome) -> Outcome:
        """An outcome whose issues call files as people do."""
        plan, proof = outcome.plan, outcome.proof
        operations = tuple(
            dataclasses.replace(
                op,
                issues=self.issues(op.issues),
                targets=dataclasses.replace(op.targets, issues=self.issues(op.targets.issues)),
            )
            for op in plan.operations
        )
        plan = dataclasses.replace(plan, operations=operations, issues=self.issues(plan.issues))
        proof = dataclasses.replace(proof, issues=self.issues(proof.issues))
        return dataclasses.replace(outcome, plan=plan, proof=proof)
