"""The client of the service, with problems, issues and outcomes of this package.

>>> import planner
>>> client = planner.Client("https://plans.example.org", token)
>>> outcome = client.plan(planner.load("wing"))

All that is HTTP is in :mod:`planner.service.tandem_client`, which the distribution ``tandem-client`` has
alone.
"""

from __future__ import annotations

import dataclasses
import json
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from planner import pipeline, plans, spec
from planner.files import PAGES, RESULT, write_folder
from planner.issue_codes import all_codes
from planner.issues import Issue, TandemError
from planner.pipeline import Outcome
from planner.problem import Problem
from planner.proof.verdict import Proof, RuleResult
from planner.reading import problem as problem_file
from planner.service import tandem_client
from planner.service.tandem_client import PLANNED, Progress

if TYPE_CHECKING:
    from planner.service.tandem_client import Content

FIELDS: Final = frozenset(field.name for field in dataclasses.fields(Issue))
"""What an issue of this version has."""


@dataclasses.dataclass(frozen=True)
class Served(Outcome):
    """An outcome that a service planned; ``files`` are those of its result folder, by name.

    Its proof has rules and issues, without the arrays that the report draws: the report is in ``files``.
    """

    files: Mapping[str, bytes] = dataclasses.field(default_factory=dict)
    job: str = ""

    def save(self, folder: str | Path, progress: Progress | None = None, pages: bool = True) -> None:
        """Write the result folder as the service made it; ``pages`` as of an outcome."""
        del progress
        files = {name: content for name, content in self.files.items() if pages or name not in PAGES}
        write_folder(Path(folder), files, RESULT)


class Client(tandem_client.Client):
    """A service at ``url``; ``token`` where it asks for one. ``timeout_s``: how long an answer may take.

    Problems are those of :func:`planner.load` or :class:`planner.spec.Problem` too. All methods raise
    :class:`planner.TandemError` with the issues of a refusal, or ``service.answer`` where the service cannot
    be reached.
    """

    _error = TandemError

    def plan(self, problem: Problem | spec.Problem, progress: Progress | None = None) -> Served:
        """Plan a problem there, as :func:`planner.plan` does here; an interruption cancels the job.

        Raises ``TandemError`` where no plan is feasible, or planning failed.
        """
        problem = pipeline.built(problem)
        job = self.submit(problem)
        try:
            done = self.wait(job, progress)
        except KeyboardInterrupt:
            self.cancel(job)
            raise
        return self.outcome(done, problem)

    def outcome(self, job: Mapping[str, Any], problem: Problem) -> Served:
        """What a job that has ended gave; raises ``TandemError`` with its issues where there is no plan."""
        if job["state"] not in PLANNED:
            stopped = Issue("service.answer", f"job {job['id']} is {job['state']}; there is no plan")
            raise TandemError([self._issue(issue) for issue in job["issues"]] or [stopped])
        files = self.files(str(job["id"]))
        with tempfile.TemporaryDirectory() as folder:
            for name in (plans.ARRAYS_FILE, plans.DATA_FILE):
                (Path(folder) / name).write_bytes(files[name])
            plan = plans.load(folder)
        prefix = "programs/"
        programs = {
            name.removeprefix(prefix): content.decode()
            for name, content in files.items()
            if name.startswith(prefix)
        }
        proof = self._proof(json.loads(files["proof.json"]), files.get("simulated_part.obj", b"").decode())
        return Served(problem, plan, proof, programs, files, str(job["id"]))

    def _bundle(self, problem: Any, files: Mapping[str, Content]) -> tuple[bytes, dict[str, bytes]]:
        if not isinstance(problem, Problem | spec.Problem):
            return super()._bundle(problem, files)
        whole = problem_file.bundle(pipeline.built(problem))
        text, sent = super()._bundle(whole.pop("problem.yaml"), files)
        return text, {**sent, **whole}

    def _issue(self, data: Mapping[str, Any]) -> Issue:
        """An issue as this version has it: what a newer service has besides is left out."""
        known = {name: value for name, value in data.items() if name in FIELDS}
        if known["code"] not in all_codes():
            known |= {"code": "service.answer", "message": f"[{data['code']}] {data['message']}"}
        return Issue.from_dict(known)

    def _proof(self, data: Mapping[str, Any], part: str) -> Proof:
        names = {field.name for field in dataclasses.fields(RuleResult)}  # a newer service may have others
        rules = tuple(
            RuleResult(**{name: value for name, value in rule.items() if name in names})
            for rule in data["rules"]
        )
        issues = tuple(self._issue(issue) for issue in data["issues"])
        return Proof(str(data["problem_digest"]), rules, issues, {}, (), part)
