"""Runs jobs of the corpus, each command in its own process, and resumes where it was stopped."""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final

from bench.corpus.job import Job

LIMIT: Final = 300
"""Processor time limit [s] of the plan of a job."""
CHECK_LIMIT: Final = 90
"""Processor time limit [s] of the check of a job."""

VERIFIED, TRUE, OTHER, PLANNED_ANYWAY = (
    "verified",
    "refused, true cause",
    "refused, other cause",
    "made in spite of it",
)
FALSE, UNPROVEN, CRASH, OVER = "refused falsely", "exit 4", "crash", "over time"
CLASSES: Final = (VERIFIED, FALSE, TRUE, OTHER, PLANNED_ANYWAY, UNPROVEN, CRASH, OVER)


@dataclasses.dataclass(frozen=True)
class Result:
    """Result of a job: of its check and of its plan, as `bench.corpus.one` writes them."""

    job: Job
    check: dict[str, Any]
    plan: dict[str, Any]

    @property
    def codes(self) -> tuple[str, ...]:
        """Codes of the errors that the plan ended with."""
        result = (issue["code"] for issue in self.plan["issues"] if issue["severity"] == "error")
        return tuple(dict.fromkeys(result))

    @property
    def verdict(self) -> str:
        """One of ``CLASSES``."""
        if self.plan.get("over"):
            return OVER
        code = self.plan["exit"]
        if code == 4:
            return UNPROVEN
        if code not in (0, 2, 3):
            return CRASH
        if code == 0:
            return VERIFIED if self.job.feasible else PLANNED_ANYWAY
        if self.job.feasible:
            return FALSE
        return TRUE if self.codes and self.codes[0] in self.job.codes else OTHER

    @property
    def found_early(self) -> bool:
        """Whether the check already refused what the plan refused."""
        return self.check.get("exit") in (2, 3)


def run(
    jobs: Sequence[Job], folder: Path, processes: int = 2, limit: int = LIMIT, tell: bool = True
) -> list[Result]:
    """Check and plan jobs; results are kept in ``folder`` and not made again."""
    folder.mkdir(parents=True, exist_ok=True)

    def run_job(job: Job) -> Result:
        result = single(job, folder, limit)
        if tell:
            print(
                f"{job.name}: {result.verdict} {' '.join(result.codes)} {result.plan['seconds']:.0f} s",
                flush=True,
            )
        return result

    with ThreadPoolExecutor(processes) as pool:
        return list(pool.map(run_job, jobs))


def single(job: Job, folder: Path, limit: int = LIMIT) -> Result:
    """One job: its files, its check and its plan."""
    own = folder / job.name
    old = own / "plan.json"
    if not old.is_file():
        job.write(folder)
    return Result(job, _command("check", own, min(CHECK_LIMIT, limit)), _command("plan", own, limit))


def done(jobs: Iterable[Job], folder: Path) -> list[Result]:
    """Results that are there already: jobs that are planned, their check empty where it has not run."""
    out = []
    for job in jobs:
        check, plan = (folder / job.name / f"{command}.json" for command in ("check", "plan"))
        if plan.is_file():
            found = json.loads(check.read_text()) if check.is_file() else {}
            out.append(Result(job, found, json.loads(plan.read_text())))
    return out


def _command(command: str, folder: Path, limit: int) -> dict[str, Any]:
    result = folder / f"{command}.json"
    if not result.is_file():
        arguments = [sys.executable, "-m", "bench.corpus.one", command, str(folder), str(result), str(limit)]
        root = str(Path(__file__).resolve().parents[2])
        paths = [root, *filter(None, [os.environ.get("PYTHONPATH")])]
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        environment["PYTHONPATH"] = os.pathsep.join(paths)
        ended = subprocess.run(arguments, env=environment, capture_output=True, text=True, check=False)
        if not result.is_file():
            _write_ended(result, ended, limit)
    data: dict[str, Any] = json.loads(result.read_text())
    return data


def _write_ended(result: Path, ended: subprocess.CompletedProcess[str], limit: int) -> None:
    """A result for a process that ended before it wrote one: over its limit, or killed by something."""
    over = ended.returncode in (-24, -9)  # SIGXCPU; SIGKILL beyond the hard limit
    row = {
        "exit": 0 if over else 1,
        "issues": [],
        "seconds": float(limit) if over else 0.0,
        **({"over": True} if over else {"crash": f"ended by {ended.returncode}: {ended.stderr[-2000:]}"}),
    }
    result.write_text(json.dumps(row, indent=1) + "\n")
