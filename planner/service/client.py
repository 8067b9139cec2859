"""A client of the service that needs nothing but Python's own library.

>>> import planner
>>> client = planner.Client("https://plans.example.org", token)
>>> outcome = client.plan(planner.load("wing"))

Problems are sent as ``multipart/form-data`` (RFC 7578).
"""

from __future__ import annotations

import dataclasses
import http.client
import json
import secrets
import tempfile
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from planner import plans
from planner.files import PAGES, RESULT, write_folder
from planner.issues import Issue, TandemError
from planner.pipeline import Outcome
from planner.problem import Problem
from planner.reading import problem as problem_file
from planner.verify.result import Proof, RuleResult


def multipart_form(problem: bytes, files: Mapping[str, bytes]) -> tuple[bytes, str]:
    """The body with a problem and its files by name, and its content type."""
    boundary = secrets.token_hex(16)
    parts = [("problem", "problem.yaml", problem), *(("files", name, files[name]) for name in files)]
    body = bytearray()
    for field, name, content in parts:
        quoted = name.replace("\\", "\\\\").replace('"', "%22").replace("\r", "%0D").replace("\n", "%0A")
        body += f"--{boundary}\r\n".encode()
        body += f'Content-Disposition: form-data; name="{field}"; filename="{quoted}"\r\n'.encode()
        body += b"Content-Type: application/octet-stream\r\n\r\n"
        body += content + b"\r\n"
    body += f"--{boundary}--\r\n".encode()
    return bytes(body), f"multipart/form-data; boundary={boundary}"


Progress = Callable[[str, float], None]
PLANNED: Final = ("verified", "unproven")
"""States of jobs that have a plan."""
OPEN: Final = ("queued", "running")
"""States of jobs that have not ended."""
WAIT_S: Final = 60.0
"""A stream that says nothing for so long is opened anew."""
RETRY_S: Final = 1.0
"""Pause [s] before a stream that broke off is opened again."""


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


class Client:
    """A service at ``url``; ``token`` where it asks for one. ``timeout_s``: how long an answer may take.

    All methods raise ``TandemError`` with the issues of a refusal, or ``service.answer`` where the service
    cannot be reached.
    """

    def __init__(self, url: str, token: str | None = None, timeout_s: float = 300.0) -> None:
        scheme = urllib.parse.urlsplit(url).scheme
        if scheme not in ("http", "https"):
            raise TandemError(_answer(url, "is no http or https URL; give one such as http://127.0.0.1:8000"))
        self._url, self._token, self._timeout_s = url.rstrip("/"), token, timeout_s

    def plan(self, problem: Problem, progress: Progress | None = None) -> Served:
        """Plan a problem there, as :func:`planner.plan` does here; an interruption cancels the job.

        Raises ``TandemError`` where no plan is feasible, or planning failed.
        """
        job = self.submit(problem)
        try:
            done = self.wait(job, progress)
        except KeyboardInterrupt:
            self.cancel(job)
            raise
        return self.outcome(done, problem)

    def submit(self, problem: Problem, timeout_s: float | None = None, memory_mb: float | None = None) -> str:
        """Send a problem; the id of its job."""
        asked = {"timeout_s": timeout_s, "memory_mb": memory_mb}
        query = urllib.parse.urlencode({name: value for name, value in asked.items() if value is not None})
        return str(self._upload(f"/v1/jobs?{query}", problem)["id"])

    def check(self, problem: Problem, reach: bool = True) -> tuple[Issue, ...]:
        """Validate a problem there without planning: the issues found."""
        found = self._upload(f"/v1/check?reach={str(reach).lower()}", problem)
        return tuple(Issue.from_dict(issue) for issue in found["issues"])

    def job(self, job: str) -> dict[str, Any]:
        """State, stage, issues and figures of a job."""
        return self._json(f"/v1/jobs/{job}")

    def jobs(self) -> Iterator[dict[str, Any]]:
        """All jobs of the token, the newest first."""
        query = "?limit=200"
        while True:
            page = self._json(f"/v1/jobs{query}")
            yield from page["jobs"]
            if page.get("next") is None:
                return
            query = f"?limit=200&cursor={page['next']}"

    def cancel(self, job: str) -> None:
        """Cancel a job."""
        self._json(f"/v1/jobs/{job}/cancel", method="POST")

    def delete(self, job: str) -> None:
        """Delete a job and its files."""
        self._request(f"/v1/jobs/{job}", method="DELETE")

    def events(self, job: str) -> Iterator[tuple[str, dict[str, Any]]]:
        """Kind and data of a job's events until it has ended, over lost connections and restarts."""
        after, ended = 0, False
        while not ended:
            try:
                for number, kind, data in self._stream(job, after):
                    after, ended = max(after, number), kind == "end"
                    if not ended:
                        yield kind, data
            except (OSError, ValueError, http.client.HTTPException):  # the line broke off
                pass
            if not ended:
                time.sleep(RETRY_S)
                ended = self._settled(job)

    def wait(self, job: str, progress: Progress | None = None) -> dict[str, Any]:
        """The job when it has ended."""
        for kind, data in self.events(job):
            if kind == "progress" and progress is not None:
                progress(str(data["stage"]), float(data["fraction"]))
        return self.job(job)

    def files(self, job: str) -> dict[str, bytes]:
        """All files of a job by name: its problem and its results."""
        names = [one["name"] for one in self._json(f"/v1/jobs/{job}/files")["files"]]
        return {n: self._request(f"/v1/jobs/{job}/files/{urllib.parse.quote(n)}") for n in names}

    def outcome(self, job: Mapping[str, Any], problem: Problem) -> Served:
        """What a job that has ended gave; raises ``TandemError`` with its issues where there is no plan."""
        if job["state"] not in PLANNED:
            issues = [Issue.from_dict(issue) for issue in job["issues"]]
            stopped = Issue("service.answer", f"job {job['id']} is {job['state']}; there is no plan")
            raise TandemError(issues or [stopped])
        files = self.files(str(job["id"]))
        with tempfile.TemporaryDirectory() as folder:
            for name in (plans.ARRAYS_FILE, plans.DATA_FILE):
                (Path(folder) / name).write_bytes(files[name])
            plan = plans.load(folder)
        prefix = "programs/"
        programs = {
            name.removeprefix(prefix): _text(content)
            for name, content in files.items()
            if name.startswith(prefix)
        }
        part = _text(files.get("simulated_part.obj", b""))
        proof = _proof(json.loads(files["proof.json"]), part)
        return Served(problem, plan, proof, programs, files, str(job["id"]))

    def _settled(self, job: str) -> bool:
        try:
            return self.job(job)["state"] not in OPEN
        except TandemError as error:
            if all(issue.code == "service.answer" for issue in error.issues):
                return False  # it is away, perhaps for a restart
            raise

    def _stream(self, job: str, after: int) -> Iterator[tuple[int, str, dict[str, Any]]]:
        request = self._asked(f"/v1/jobs/{job}/events?after={after}", None, {}, "GET")
        try:
            with urllib.request.urlopen(request, timeout=WAIT_S) as stream:
                fields: dict[str, str] = {}
                for line in stream:
                    name, _, value = line.decode().rstrip("\n").partition(": ")
                    if name:
                        fields[name] = value
                    elif "event" in fields:
                        yield int(fields["id"]), fields["event"], json.loads(fields["data"])
                        fields = {}
        except urllib.error.HTTPError as error:
            raise _refusal(error) from error

    def _upload(self, path: str, problem: Problem) -> dict[str, Any]:
        files = problem_file.bundle(problem)
        body, kind = multipart_form(files.pop("problem.yaml"), files)
        found: dict[str, Any] = json.loads(self._request(path, body, {"Content-Type": kind}, "POST"))
        return found

    def _json(self, path: str, method: str = "GET") -> dict[str, Any]:
        try:
            found = json.loads(self._request(path, method=method))
        except ValueError as error:
            raise TandemError(_answer(self._url, "does not answer in JSON; is it a Tandem?")) from error
        if not isinstance(found, dict):
            raise TandemError(_answer(self._url, "does not answer as Tandem does"))
        return found

    def _request(
        self,
        path: str,
        body: bytes | None = None,
        headers: Mapping[str, str] | None = None,
        method: str = "GET",
    ) -> bytes:
        request = self._asked(path, body, headers or {}, method)
        try:
            with urllib.request.urlopen(request, timeout=self._timeout_s) as answer:
                content: bytes = answer.read()
                return content
        except urllib.error.HTTPError as error:
            raise _refusal(error) from error
        except (OSError, http.client.HTTPException) as error:
            reason = getattr(error, "reason", error)
            raise TandemError(_answer(self._url, f"does not answer ({reason}); see that it runs")) from error

    def _asked(
        self, path: str, body: bytes | None, headers: Mapping[str, str], method: str
    ) -> urllib.request.Request:
        own = {"Authorization": f"Bearer {self._token}"} if self._token else {}
        return urllib.request.Request(self._url + path, body, {**headers, **own}, method=method)


def _refusal(error: urllib.error.HTTPError) -> TandemError:
    """The issues of a refusal."""
    try:
        found = json.loads(error.read())["issues"]
        return TandemError([Issue.from_dict(issue) for issue in found])
    except (ValueError, KeyError, TypeError, OSError):
        return TandemError(_answer(error.url, f"answers with status {error.code}; is it a Tandem?"))


def _proof(data: Mapping[str, Any], part: str) -> Proof:
    rules = tuple(RuleResult(**rule) for rule in data["rules"])
    issues = tuple(Issue.from_dict(issue) for issue in data["issues"])
    return Proof(str(data["problem_digest"]), rules, issues, {}, (), part)


def _text(content: bytes) -> str:
    return content.decode()


def _answer(url: str, what: str) -> Issue:
    return Issue("service.answer", f"{url} {what}", field="url")
