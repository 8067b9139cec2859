"""Client of the service that uses the problems, issues and outcomes of this package.

>>> import planner
>>> client = planner.Client("https://plans.example.org", token)
>>> outcome = client.plan(planner.load("wing"))

The HTTP client is :mod:`planner.service.tandem_client`, which is also distributed alone as
``tandem-client``.
"""

from __future__ import annotations

import dataclasses
import json
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from planner import pipeline, plans, spec
from planner.files import PAGES, RESULT_ENTRIES, write_folder
from planner.issue_codes import all_codes, format_message
from planner.issues import Issue, TandemError
from planner.pipeline import Outcome
from planner.problem import Problem
from planner.proof.verdict import Proof, RuleResult
from planner.reading import problem as problem_file
from planner.service import tandem_client
from planner.service.tandem_client import PLANNED, Progress

if TYPE_CHECKING:
    from planner.service.tandem_client import Content

ISSUE_FIELDS: Final = frozenset(field.name for field in dataclasses.fields(Issue))
"""Names of the fields of an issue in this version."""


@dataclasses.dataclass(frozen=True)
class Served(Outcome):
    """Outcome of planning on a service.

    The proof contains rules and issues, without the arrays that the report draws. The report is in
    ``files``.

    Attributes:
        files: Content of the result folder, by name.
        job: Id of the job.
    """

    files: Mapping[str, bytes] = dataclasses.field(default_factory=dict)
    job: str = ""

    def save(self, folder: str | Path, progress: Progress | None = None, pages: bool = True) -> None:
        """Write the result folder as the service created it.

        Args:
            folder: Folder to write.
            progress: Not used.
            pages: Write HTML pages too.
        """
        del progress
        files = {name: content for name, content in self.files.items() if pages or name not in PAGES}
        write_folder(Path(folder), files, RESULT_ENTRIES)


class Client(tandem_client.Client):
    """Client of a service.

    Problems may also be results of :func:`planner.load` or instances of :class:`planner.spec.Problem`. All
    methods raise :class:`planner.TandemError` with the issues of a refusal, or ``service.answer`` if the
    service is unreachable.

    Args:
        url: Address of the service.
        token: API token, if the service requires one.
        timeout_s: Maximum time [s] of an answer.
    """

    _error = TandemError

    def plan(self, problem: Problem | spec.Problem, progress: Progress | None = None) -> Served:
        """Plan a problem on the service. An interruption cancels the job.

        Args:
            problem: Problem to plan.
            progress: Callback for stage and fraction.

        Raises:
            TandemError: No feasible plan, or planning failed.
        """
        problem = pipeline.ensure_problem(problem)
        job = self.submit(problem)
        try:
            done = self.wait(job, progress)
        except KeyboardInterrupt:
            self.cancel(job)
            raise
        return self.outcome(done, problem)

    def outcome(self, job: Mapping[str, Any], problem: Problem) -> Served:
        """Return the outcome of a job that has ended.

        Args:
            job: Job as the service returned it.
            problem: Problem of the job.

        Raises:
            TandemError: There is no plan. Contains the issues of the job.
        """
        if job["state"] not in PLANNED:
            message = format_message("service.answer", job=job["id"], state=job["state"])
            stopped = Issue("service.answer", message)
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
        """Return the problem file and its files for an upload. Problems of this package bring their files."""
        if not isinstance(problem, Problem | spec.Problem):
            return super()._bundle(problem, files)
        bundled_files = problem_file.bundle(pipeline.ensure_problem(problem))
        text, uploads = super()._bundle(bundled_files.pop("problem.yaml"), files)
        return text, {**uploads, **bundled_files}

    def _issue(self, data: Mapping[str, Any]) -> Issue:
        """Convert an issue from JSON. Unknown fields of newer services are dropped, their codes replaced."""
        fields = {name: value for name, value in data.items() if name in ISSUE_FIELDS}
        if fields["code"] not in all_codes():
            fields |= {"code": "service.answer", "message": f"[{data['code']}] {data['message']}"}
        return Issue.from_dict(fields)

    def _proof(self, data: Mapping[str, Any], part: str) -> Proof:
        """Convert ``proof.json`` to a proof without arrays. ``part`` is the simulated part as OBJ text."""
        names = {field.name for field in dataclasses.fields(RuleResult)}  # a newer service may send others
        rules = tuple(
            RuleResult(**{name: value for name, value in rule.items() if name in names})
            for rule in data["rules"]
        )
        issues = tuple(self._issue(issue) for issue in data["issues"])
        return Proof(str(data["problem_digest"]), rules, issues, {}, (), part)
