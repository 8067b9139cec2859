"""One job in a process of its own: ``python -m bench.corpus.one check|plan FOLDER RESULT LIMIT``.

Writes what ``tandem check`` or ``tandem plan`` find as JSON: exit code, issues, processor seconds. The limit
is one of processor time, so that no result depends on what else the machine does.
"""

from __future__ import annotations

import json
import resource
import sys
import traceback
from pathlib import Path
from typing import Any

from bench.corpus.job import PROBLEM


def processor_seconds() -> float:
    """Processor seconds (user and system) of this process."""
    own = resource.getrusage(resource.RUSAGE_SELF)
    return own.ru_utime + own.ru_stime


def run(command: str, folder: Path) -> dict[str, Any]:
    """Exit code, issues and verdict of one command, as the command line has them."""
    from planner import pipeline
    from planner.cli import command_line as cli
    from planner.issues import Severity, TandemError, has_errors

    def record_refusal(error: TandemError, code: int) -> dict[str, Any]:
        return {"exit": code, "issues": [issue.to_dict() for issue in error.issues]}

    try:
        problem = pipeline.load(folder / PROBLEM)
    except TandemError as error:
        return record_refusal(error, cli.BAD_INPUT)
    if command == "check":
        issues = pipeline.check(problem)
        errors = [issue for issue in issues if issue.severity is Severity.ERROR]
        code = cli.DONE
        if has_errors(issues):
            code = cli._infeasible_code(TandemError(errors))
        return {"exit": code, "issues": [issue.to_dict() for issue in issues]}
    try:
        outcome = pipeline.plan(problem)
    except TandemError as error:
        return record_refusal(error, cli._infeasible_code(error))
    rules = {rule.code: rule.passed for rule in outcome.proof.rules}
    return {
        "exit": pipeline.exit_code(outcome),
        "issues": [issue.to_dict() for issue in outcome.issues],
        "failed_rules": sorted(name for name, passed in rules.items() if not passed),
        "programs": sum(len(text) for text in outcome.programs.values()),
    }


def main(arguments: list[str]) -> int:
    """Run one command and write its result."""
    command, folder, result, limit = arguments
    seconds = int(limit)
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 5))
    try:
        found = run(command, Path(folder))
    except (Exception, SystemExit) as error:  # Drake ends the process where it demands something
        found = {"exit": 1, "issues": [], "crash": f"{error!r}\n{traceback.format_exc()}"}
    found["seconds"] = round(processor_seconds(), 2)
    target = Path(result)
    partial = target.with_suffix(".part")
    partial.write_text(json.dumps(found, indent=1) + "\n")
    partial.rename(target)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
