"""Planned milling jobs, their programs, and a prover that keeps its models."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from planner.languages.writing import write
from planner.motion import solve
from planner.processes import registry
from planner.proof.prove import Prover
from planner.proof.verdict import Proof
from tests.processes.milling.plan.small_mill import problem

Programs = dict[str, str]


class Job:
    """A planned job, its programs and a prover that keeps its models."""

    def __init__(self, folder: Path, base: dict, tool: dict | None = None, **fields: object) -> None:  # type: ignore[type-arg]
        self.problem = problem(folder, base, tool, **fields)
        targets = [registry.job(self.problem, 0).targets()]
        self.programs: Programs = dict(write.program_files(solve.solve(self.problem, targets), self.problem))
        self.prover = Prover(self.problem, registry.claims(self.problem))

    def prove(self, programs: Programs, last: str | None = "verify.spindle") -> Proof:
        return self.prover.prove(programs, last=last)

    def broken(self, programs: Programs) -> set[str]:
        return {issue.code for issue in self.prove(programs).issues}


def in_procedure(programs: Programs, name: str, change: Callable[[str], str]) -> Programs:
    """The programs with one procedure's text changed."""
    out, found = {}, 0
    for file, text in programs.items():
        at = text.find(f"PROC {name}()")
        if at >= 0:
            end = text.index("ENDPROC", at)
            text = text[:at] + change(text[at:end]) + text[end:]
            found += 1
        out[file] = text
    assert found == 1, name
    return out
