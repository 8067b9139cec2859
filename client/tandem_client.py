"""Client of a Tandem service for Python 3.9 or newer on any system, with the standard library only.

>>> import tandem_client
>>> client = tandem_client.Client("https://plans.example.org", token)
>>> job = client.submit(problem)
>>> if client.wait(job)["state"] == "verified":
...     programs, page = client.programs(job), client.replay_url(job)

A problem is a dict with the keys of a problem file, the path of such a file, or its text as bytes. Values
of a dict may be numpy arrays. A ``pathlib.Path`` in it is uploaded as a file, and so is a mesh: ``{"file":
(vertices, faces), "unit": "mm"}``. Other files that the problem uses are given by name.

This file belongs to two distributions: ``tandem-client``, and ``tandem-planner``, whose ``planner.Client``
is based on it.
"""

from __future__ import annotations

import dataclasses
import http.client
import io
import json
import math
import re
import secrets
import socket
import ssl
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Callable, Iterator, Mapping, Sequence
from os import PathLike, fspath
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    Mesh = tuple[Any, Any]
    """Vertices (N, 3) in the unit that the problem states; faces: rows of three or more indices from 0."""
    Content = bytes | PathLike[str] | Mesh
    """What a file holds, the path of what it holds, or a mesh, which goes as OBJ."""

__version__ = "0.1.0"
__all__ = ["API", "Client", "Issue", "TandemError", "__version__"]

API: Final = 17
"""API number of the service that this client was written for."""
LINKS_API: Final = 2
"""First API number with links."""
DESK_API: Final = 3
"""First API number with motion as data, and elements."""
RETRY_API: Final = 4
"""First API number with retry."""
KEYS_API: Final = 6
"""First API number with idempotency keys."""
TEAMS_API: Final = 8
"""First API number with roles and teams of tokens."""
RELEASES_API: Final = 9
"""First API number with releases."""
AUDIT_API: Final = 10
"""First API number with the audit log."""
FINDING_API: Final = 11
"""First API number with titles, tags and notes of jobs, and search."""
DRAFTS_API: Final = 13
"""First API number with drafts, sweeps and view links."""
TITLED_API: Final = 15
"""First API number in which saving a draft may set its title."""
BATCHES_API: Final = 14
"""First API number with batches, releases of panels, titles of elements, and paged and submitted drafts."""
RELEASE: Final = "release.json"
"""File next to the programs that states whether they are released."""
PLANNED: Final = ("verified", "unproven")
"""States of jobs that have a plan."""
OPEN: Final = ("queued", "running")
"""States of jobs that have not ended."""
WAIT_S: Final = 60.0
"""Time [s] without data after which an event stream is reopened."""
RETRY_S: Final = 1.0
"""Pause [s] before a lost event stream is reopened."""
PAUSES_S: Final = (1.0, 3.0, 9.0)
"""Pauses [s] before a request that creates jobs is sent again after its connection was lost."""
AWAY: Final = (502, 503, 504)
"""HTTP statuses of a proxy or service that is temporarily unavailable."""
MOST_DELETED: Final = 200
"""Maximum number of jobs that one request deletes."""
LONGEST_KEY: Final = 255
"""Maximum number of characters of an idempotency key."""
HEALTH_BYTES: Final = 100_000
"""Maximum size [bytes] of the answer of ``/v1/health`` that is read."""
Progress = Callable[[str, float], None]
"""Callback for the stage, and the completed fraction of it."""


@dataclasses.dataclass(frozen=True)
class Issue:
    """One finding.

    Attributes:
        code: Stable code for programs.
        message: Message for people.
        severity: error, warning or note.
        field: Path of the field in the problem.
        file: File.
        line: Line in the file.
        hint: Remedy for people.
        data: All fields as the service sent them.
    """

    code: str
    message: str
    severity: str = "error"
    field: str | None = None
    file: str | None = None
    line: int | None = None
    hint: str | None = None
    data: Mapping[str, Any] = dataclasses.field(default_factory=dict, repr=False, compare=False)

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> Issue:
        """Convert an issue as the service sends it.

        Keys that this client does not know stay in ``data``.
        """
        fields = {field.name: data[field.name] for field in dataclasses.fields(Issue) if field.name in data}
        return Issue(**{**fields, "data": dict(data)})

    def __str__(self) -> str:
        location_parts = [self.file or "", f"line {self.line}" if self.line else "", self.field or ""]
        location = ", ".join(part for part in location_parts if part)
        hint = f"; {self.hint}" if self.hint else ""
        return f"{self.severity} [{self.code}] {location + ': ' if location else ''}{self.message}{hint}"


class TandemError(Exception):
    """A failed call. ``issues`` contain the reasons."""

    def __init__(self, issues: tuple[Issue, ...]) -> None:
        self.issues = issues
        super().__init__("\n".join(str(issue) for issue in issues))


class _FaultError(Exception):
    """An invalid problem, found before it is sent."""

    def __init__(self, code: str, message: str, field: str) -> None:
        self.data = {"code": code, "message": f"{field}: {message}", "field": field}
        super().__init__(message)


class Client:
    """Client of a service.

    All methods raise ``TandemError`` with the issues of a refusal, ``service.answer`` if the service is
    unreachable, ``service.timeout`` if an answer takes too long, or ``service.version`` if client and
    service are not compatible.

    Args:
        url: Address of the service.
        token: API token, if the service requires one.
        timeout_s: Maximum time [s] of an answer.
        context: TLS context, for a certificate that this machine does not trust otherwise.
    """

    _error: Any = TandemError
    """Exception to raise. It takes a tuple of issues and has them as ``issues``."""

    def __init__(
        self,
        url: str,
        token: str | None = None,
        timeout_s: float = 300.0,
        context: ssl.SSLContext | None = None,
    ) -> None:
        try:
            parts = urllib.parse.urlsplit(url)
        except ValueError:  # for example [::1 without its closing bracket
            parts = urllib.parse.SplitResult("", "", "", "", "")
        if parts.scheme not in ("http", "https"):
            raise self._answer(url, "is not an http or https URL. Give one such as http://127.0.0.1:8000.")
        self._url, self._timeout_s = url.rstrip("/"), timeout_s
        self._token = (token or "").strip()
        if not (self._token.isascii() and self._token.isprintable()):
            message = "the token contains invalid characters. Copy it again."
            raise self._refused({"code": "service.token", "message": message, "field": "token"})
        proxies = _proxies(parts)
        self._place = f"{self._url}{_proxy_note(proxies.get(parts.scheme))}"
        self._opener = urllib.request.build_opener(
            _NoRedirect, urllib.request.HTTPSHandler(context=context), urllib.request.ProxyHandler(proxies)
        )
        self._api = 0  # API number of the service, 0 while it is unknown

    def service(self) -> dict[str, Any]:
        """Return ``status``, ``version``, ``api`` and the numbers of queued and running jobs.

        Requires no token.
        """
        try:
            with self._open("/v1/health", None, {}, "GET", self._timeout_s) as answer:
                text = answer.read(HEALTH_BYTES)
        except urllib.error.HTTPError as error:
            if error.code != 503:  # a service that cannot plan at the moment answers 503
                raise self._refusal(error) from error
            with error:
                text = error.read(HEALTH_BYTES)
        except (OSError, ValueError, http.client.HTTPException) as error:
            raise self._away(error) from error
        health = self._read_json(text)
        numbers = (health.get("api", 1), health.get("api_oldest", 1))
        if not isinstance(health.get("version"), str) or not all(
            isinstance(number, int) for number in numbers
        ):
            raise self._answer(self._url, "does not answer like a Tandem service. Check the address.")
        return health

    def who(self) -> dict[str, Any]:
        """Return ``name``, ``role`` (view, plan or release) and ``team`` of the token.

        The result also contains the time at which it ``expires``, and its ``scope`` with an optional
        ``tag`` if it is narrower than its role.
        """
        self._want(TEAMS_API, "roles of tokens")
        return self._json("/v1/session")

    def check(
        self, problem: Any, reach: bool = True, files: Mapping[str, Content] | None = None
    ) -> tuple[Any, ...]:
        """Validate a problem without planning.

        Args:
            problem: Problem.
            reach: Compute its targets and test their reach too.
            files: Files that the problem uses, by name.

        Returns:
            Issues.
        """
        result = self._upload(f"/v1/check?reach={str(reach).lower()}", problem, files)
        return tuple(self._issue(issue) for issue in result["issues"])

    def submit(
        self,
        problem: Any,
        timeout_s: float | None = None,
        memory_mb: float | None = None,
        files: Mapping[str, Content] | None = None,
        key: str | None = None,
    ) -> str:
        """Submit a problem for planning.

        Keep the returned id: any client with the same token, or a token of its team, can use it at any
        time. The request carries an idempotency key, so that it can be sent again after a lost connection
        and still creates one job. A script that may be restarted passes the same key for the same problem.

        Args:
            problem: Problem.
            timeout_s: Time limit of planning [s].
            memory_mb: Memory limit of planning [MB].
            files: Files that the problem uses, by name.
            key: Idempotency key, or None for a random one.

        Returns:
            Id of the job.

        Raises:
            TandemError: ``service.idempotency``, the key is not 1 to 255 printable ASCII characters without
                spaces. Nothing is sent then.
        """
        self._check_key(key)
        parameters = {"timeout_s": timeout_s, "memory_mb": memory_mb}
        query = self._query({name: value for name, value in parameters.items() if value is not None})
        body, kind = self._body(problem, files)
        return str(self._make(f"/v1/jobs?{query}", body, kind, key)["id"])

    def sweep(
        self,
        problem: Any,
        field: str,
        values: Sequence[Any],
        tag: str = "sweep",
        files: Mapping[str, Content] | None = None,
        key: str | None = None,
        draft: tuple[str, int] | None = None,
    ) -> list[str]:
        """Plan a problem with several values of a field. Either all jobs are created or none.

        Args:
            problem: Problem.
            field: Path of the field, such as ``operations.0.feed_mm_s``.
            values: Numbers, truth values or texts.
            tag: Tag of all jobs.
            files: Files that the problem uses, by name.
            key: Idempotency key. It is refused (``service.idempotency``) if some of its jobs were deleted
                since.
            draft: Id and version of the draft that is submitted.

        Returns:
            Ids of the jobs.
        """
        self._check_key(key)
        self._want(DRAFTS_API if draft is None else BATCHES_API, "sweeps")
        texts = [value if isinstance(value, str) else json.dumps(value) for value in values]
        parameters = {"field": field, "value": texts, "tag": tag}
        if draft is not None:
            parameters["draft"] = f"{draft[0]}@{draft[1]}"
        query = self._query(parameters)
        body, kind = self._body(problem, files)
        return self._all_of(self._make(f"/v1/sweeps?{query}", body, kind, key), len(values), key)

    def batch(
        self,
        problems: Mapping[str, Any] | Sequence[str | PathLike[str]],
        tag: str = "batch",
        files: Mapping[str, Content] | None = None,
        key: str | None = None,
        drafts: Sequence[tuple[str, int]] = (),
    ) -> list[str]:
        """Plan up to 50 problems. Either all jobs are created or none.

        Issues are reported for each problem, in messages that begin with its name. ``data["of"]`` of an
        issue is the index of the problem, from 0.

        Args:
            problems: Problems by distinct names, or paths of problem files.
            tag: Tag of all jobs.
            files: Files for all problems, by name.
            key: Idempotency key, as for :meth:`sweep`.
            drafts: Ids and versions of drafts that the first problems are.

        Returns:
            Ids of the jobs in the order of the problems.
        """
        self._check_key(key)
        texts, sent_files = self._bundles(problems, files or {})
        self._want(BATCHES_API, "batches")
        parameters: dict[str, Any] = {
            "tag": tag,
            "draft": [f"{draft}@{version}" for draft, version in drafts],
        }
        body, kind = self._form(texts, sent_files)
        created = self._make(f"/v1/batches?{self._query(parameters)}", body, kind, key)
        return self._all_of(created, len(texts), key)

    def keep_draft(
        self, problem: Any, title: str = "", kind: str = "draft", files: Mapping[str, Content] | None = None
    ) -> dict[str, Any]:
        """Save a problem as a draft, valid or not, or a cell, tool or template.

        Args:
            problem: Content.
            title: Title.
            kind: draft, cell, tool or template.
            files: Files that it uses, by name.

        Returns:
            The draft with its ``id`` and ``version``, from 1.
        """
        self._want(DRAFTS_API, "drafts")
        query = self._query({"title": title, "kind": kind})
        return self._upload(f"/v1/drafts?{query}", problem, files)

    def save_draft(
        self,
        draft: str,
        version: int,
        problem: Any,
        files: Mapping[str, Content] | None = None,
        without: Sequence[str] = (),
        title: str | None = None,
    ) -> dict[str, Any]:
        """Save the next version of a draft.

        Args:
            draft: Id of the draft.
            version: Version that was edited.
            problem: Content.
            files: New files by name. Other files of the last version are kept.
            without: Names of files that are dropped.
            title: New title, or None to keep it.

        Raises:
            TandemError: ``service.draft``, another person has saved it since.
        """
        self._want(DRAFTS_API, "drafts")
        if title is not None:
            self._want(TITLED_API, "titles of drafts that are saved")
        query = self._query({"without": list(without), **({} if title is None else {"title": title})})
        body, kind = self._body(problem, files)
        headers = {"Content-Type": kind, "If-Match": f'"{version}"'}
        return self._read_json(self._request(_path(draft, f"?{query}", "drafts"), body, headers, "PUT"))

    def drafts(self, kind: str | None = None) -> Iterator[dict[str, Any]]:
        """Yield the drafts of the token and of its team, last changed first.

        Args:
            kind: Only drafts of this kind.
        """
        self._want(DRAFTS_API, "drafts")
        limit = {} if self._api >= BATCHES_API else {"limit": 1000}  # older services return one page only
        yield from self._pages("drafts", "drafts", limit | ({} if kind is None else {"kind": kind}))

    def draft(self, draft: str, version: int | None = None) -> tuple[bytes, dict[str, bytes]]:
        """Return text and files of a draft.

        Args:
            draft: Id of the draft.
            version: Version, or None for the last one.
        """
        self._want(DRAFTS_API, "drafts")
        version_number = self._json(_path(draft, kind="drafts"))["version"] if version is None else version
        path = _path(draft, f"/versions/{version_number}", "drafts")
        names = [entry["name"] for entry in self._json(path)["files"]]
        files = {name: self._request(f"{path}/files/{_quoted(name)}") for name in names}
        return self._request(f"{path}/problem"), files

    def versions(self, draft: str) -> list[dict[str, Any]]:
        """Return the versions of a draft, newest first: ``number``, ``at``, ``by`` and names of ``files``."""
        self._want(DRAFTS_API, "drafts")
        return list(self._json(_path(draft, kind="drafts"))["versions"])

    def rename_draft(self, draft: str, title: str) -> dict[str, Any]:
        """Rename a draft. This creates no new version."""
        self._want(DRAFTS_API, "drafts")
        return self._send(_path(draft, kind="drafts"), {"title": title}, "PATCH")

    def mark_sent(self, draft: str, version: int, job: str) -> dict[str, Any]:
        """Record that a version of a draft was submitted as a job, so that it counts as submitted.

        Args:
            draft: Id of the draft.
            version: Version.
            job: Id of the job.
        """
        self._want(BATCHES_API, "submitted drafts")
        return self._send(_path(draft, "/sent", "drafts"), {"version": version, "job": job}, "POST")

    def delete_draft(self, draft: str) -> None:
        """Delete a draft with its versions."""
        self._request(_path(draft, kind="drafts"), method="DELETE")

    def job(self, job: str) -> dict[str, Any]:
        """Return state, stage, ``fraction``, issues and metrics of a job, without waiting."""
        return self._json(_path(job))

    def jobs(
        self, search: str = "", tags: Sequence[str] = (), sort: str = "newest", states: Sequence[str] = ()
    ) -> Iterator[dict[str, Any]]:
        """Yield the jobs of the token and of its team. ``by`` names the token of each.

        Args:
            search: Words that all occur in name, title, tags or notes.
            tags: Tags that a job must all have.
            sort: newest, oldest, title, or turn, which is the order of the queue.
            states: Only these states.
        """
        query = self._sought(search, tags, sort, DRAFTS_API if sort == "turn" else FINDING_API)
        yield from self._pages("jobs", "jobs", {**query, "state": list(states)})

    def describe(
        self, job: str, title: str | None = None, tags: Sequence[str] | None = None, notes: str | None = None
    ) -> dict[str, Any]:
        """Set title, tags and notes of a job. None keeps a value."""
        self._want(FINDING_API, "titles, tags and notes")
        return self._send(_path(job), _description_data(title, tags, notes), "PATCH")

    def first(self, job: str) -> dict[str, Any]:
        """Move a queued job before the other queued jobs of its owner.

        Raises:
            TandemError: ``service.state``, the job is not queued.
        """
        self._want(DRAFTS_API, "the order of the queue")
        return self._json(_path(job, "/first"), method="POST")

    def estimate(self, job: str) -> dict[str, Any]:
        """Estimate the remaining time of a job from the number ``like`` of similar proven jobs.

        Returns:
            ``left_s`` and ``whole_s`` if there are similar jobs, and ``elapsed_s`` while it runs.
        """
        self._want(DRAFTS_API, "estimates")
        return self._json(_path(job, "/estimate"))

    def cancel(self, job: str) -> None:
        """Cancel a job."""
        self._json(_path(job, "/cancel"), method="POST")

    def retry(self, job: str) -> None:
        """Queue a job again that crashed, reached a limit or was cancelled.

        Raises:
            TandemError: ``service.state``, the job is in another state.
        """
        self._want(RETRY_API, "retries of jobs")
        self._json(_path(job, "/retry"), method="POST")

    def delete(self, job: str) -> None:
        """Delete a job and its files."""
        self._request(_path(job), method="DELETE")

    def delete_jobs(self, jobs: Sequence[str]) -> list[str]:
        """Delete jobs and their files. Return the ids that do not exist."""
        self._want(FINDING_API, "deleting many jobs")
        unknown: list[str] = []
        ids = [jobs] if isinstance(jobs, str) else list(jobs)
        for start in range(0, len(ids), MOST_DELETED):
            body = {"jobs": ids[start : start + MOST_DELETED]}
            unknown += self._send("/v1/jobs/delete", body, "POST")["unknown"]
        return unknown

    def events(self, job: str, timeout_s: float | None = None) -> Iterator[tuple[str, dict[str, Any]]]:
        """Yield kind and data of a job's events until it has ended, across lost connections and restarts.

        Args:
            job: Id of the job.
            timeout_s: Maximum time [s], or None.
        """
        deadline = math.inf if timeout_s is None else time.monotonic() + timeout_s
        after, ended = 0, False
        while not ended:
            try:
                for number, kind, data in self._stream(job, after, deadline):
                    after, ended = max(after, number), kind == "end"
                    if not ended:
                        yield kind, data
            except (OSError, ValueError, http.client.HTTPException):  # the connection was lost
                pass
            if not ended:
                self._pause(job, deadline, timeout_s)
                state = self._if_there(job, deadline)
                ended = state is not None and state["state"] not in OPEN

    def wait(
        self, job: str, progress: Progress | None = None, timeout_s: float | None = None
    ) -> dict[str, Any]:
        """Wait until a job has ended, and return it.

        Args:
            job: Id of the job.
            progress: Callback for stage and fraction.
            timeout_s: Maximum time [s], or None.
        """
        deadline = math.inf if timeout_s is None else time.monotonic() + timeout_s
        for kind, data in self.events(job, timeout_s):
            if kind == "progress" and progress is not None:
                progress(str(data["stage"]), float(data["fraction"]))
        ended_job = self._if_there(job, deadline)
        while ended_job is None:
            self._pause(job, deadline, timeout_s)
            ended_job = self._if_there(job, deadline)
        return ended_job

    def file(self, job: str, name: str) -> bytes:
        """Return a file of a job, by its name in the list of files."""
        return self._request(_path(job, f"/files/{_quoted(name)}"))

    def files(self, job: str) -> dict[str, bytes]:
        """Return all files of a job by name: its problem and its results."""
        return {
            entry["name"]: self.file(job, entry["name"])
            for entry in self._json(_path(job, "/files"))["files"]
        }

    def programs(self, job: str) -> dict[str, str]:
        """Return the programs of a job by name.

        Raises:
            TandemError: The job has no programs.
        """
        import zipfile  # takes a tenth of the import time of everything else

        with zipfile.ZipFile(io.BytesIO(self._request(_path(job, "/programs.zip")))) as archive:
            names = [name for name in archive.namelist() if name != RELEASE]
            return {name: archive.read(name).decode("utf-8") for name in names}

    def release(self, job: str, note: str = "", name: str | None = None) -> dict[str, Any]:
        """Release the programs of a job.

        Args:
            job: Id of the job.
            note: Note.
            name: Name of the person, if the service requires no tokens. Otherwise the name of the token is
                used.

        Returns:
            ``by``, ``at``, ``digest`` of the problem, SHA-256 of ``proof`` and ``programs``.

        Raises:
            TandemError: ``service.release``, the job is not verified or already released.
        """
        return self._decide(job, "release", {"note": note, "name": name})

    def withdraw(self, job: str, reason: str, name: str | None = None) -> dict[str, Any]:
        """Withdraw the release of a job. The release stays recorded, with the ``reason``."""
        return self._decide(job, "withdraw", {"reason": reason, "name": name})

    def releases(self, job: str) -> list[dict[str, Any]]:
        """Return the releases of a job, newest first.

        A release that was ``withdrawn`` is no longer in force.
        """
        self._want(RELEASES_API, "releases")
        return list(self._json(_path(job, "/releases"))["releases"])

    def audit(self, job: str | None = None, acts: Sequence[str] = ()) -> Iterator[dict[str, Any]]:
        """Yield entries of the audit log, newest first: ``at``, ``by``, ``act``, ``job`` and ``about``.

        It requires a token with the role release.

        Args:
            job: Only entries of this job, or None for all of the token's team.
            acts: Only these acts.
        """
        self._want(AUDIT_API, "the audit log")
        yield from self._pages("audit", "acts", {"act": list(acts)} | ({} if job is None else {"job": job}))

    def motion(self, job: str) -> dict[str, Any]:
        """Return the motion of a planned job: planes at the TCPs [mm], joints by name [deg], times [s]."""
        self._want(DESK_API, "the motion as data")
        return self._read_json(self.file(job, "motion.json"))

    def meshes(self, job: str, name: str = "simulated_part.obj") -> dict[str, Mesh]:
        """Return the meshes in an OBJ file of a job by name, with vertices in mm.

        ``simulated_part.obj`` is the part that the tools leave, in the frame of the block. ``element.obj``
        contains the panels of an element.

        Args:
            job: Id of the job.
            name: Name of the file.
        """
        try:
            return _parse_obj(self.file(job, name).decode("utf-8"))
        except (ValueError, IndexError) as error:
            raise self._answer(self._url, f"returned {name}, which is not a mesh: {error}") from error

    def divide(self, element: Any, files: Mapping[str, Content] | None = None, key: str | None = None) -> str:
        """Submit a building element for division into panels.

        Args:
            element: Element: a dict, the path of a file, or its text.
            files: Files that it uses, by name.
            key: Idempotency key, as for :meth:`submit`.

        Returns:
            Id of the element, which is also the id of a job to wait for.
        """
        self._check_key(key)
        self._want(DESK_API, "elements")
        body, kind = self._body(element, files)
        return str(self._make("/v1/elements", body, kind, key)["id"])

    def element(self, element: str) -> dict[str, Any]:
        """Return an element with its ``panels`` (order, block, job and state) and its ``block_jobs``.

        Block jobs divide raw blocks, or cut several ``panels`` out of one together.
        """
        self._want(DESK_API, "elements")
        return self._json(_path(element, kind="elements"))

    def plan_panels(
        self, element: str, panels: Sequence[str] | None = None, key: str | None = None
    ) -> list[str]:
        """Plan panels and raw-block jobs of an element. Return the ids of their jobs.

        Args:
            element: Id of the element.
            panels: Ids of panels and raw-block jobs, or None for all that are not planned yet.
            key: Idempotency key, as for :meth:`submit`.
        """
        self._check_key(key)
        self._want(DESK_API, "elements")
        body = json.dumps({} if panels is None else {"panels": list(panels)}).encode()
        created = self._make(_path(element, "/plan", "elements"), body, "application/json", key)
        return [str(job["id"]) for job in created["jobs"]]

    def elements(
        self, search: str = "", tags: Sequence[str] = (), sort: str = "newest"
    ) -> Iterator[dict[str, Any]]:
        """Yield the elements of the token and of its team. Arguments are those of :meth:`jobs`."""
        self._want(DESK_API, "elements")
        yield from self._pages("elements", "elements", self._sought(search, tags, sort, BATCHES_API))

    def describe_element(
        self,
        element: str,
        title: str | None = None,
        tags: Sequence[str] | None = None,
        notes: str | None = None,
    ) -> dict[str, Any]:
        """Set title, tags and notes of an element, as :meth:`describe` does for a job."""
        self._want(BATCHES_API, "titles, tags and notes of elements")
        return self._send(_path(element, kind="elements"), _description_data(title, tags, notes), "PATCH")

    def divide_anew(
        self, element: str, fields: Mapping[str, Any], instead: bool = False, key: str | None = None
    ) -> str:
        """Divide an element again with other values of some fields.

        Args:
            element: Id of the present element.
            fields: New values by field path, such as ``panels.hexagons.count``.
            instead: Delete the present element if none of its panels was planned or marked.
            key: Idempotency key, as for :meth:`submit`.

        Returns:
            Id of the new element, which has the marks of the present one.
        """
        self._check_key(key)
        self._want(DESK_API, "elements")
        text, sent_files = self._bundle({"fields": fields}, {})
        if sent_files:
            message = "fields: got a file. Files of an element cannot be replaced: divide the changed file."
            raise self._refused({"code": "problem.field", "message": message, "field": "fields"})
        path = _path(element, f"/divide?instead={str(instead).lower()}", "elements")
        return str(self._make(path, text, "application/json", key)["id"])

    def release_panels(
        self, element: str, panels: Sequence[Mapping[str, Any]], note: str = "", name: str | None = None
    ) -> dict[str, Any]:
        """Release the programs of panels and of raw-block jobs in one act.

        Panels that are ``cut_in`` a raw-block job are released with that job.

        Args:
            element: Id of the element.
            panels: Rows of :meth:`element` as the person saw them, with ``id``, ``job`` and ``digest``.
            note: Note.
            name: Name of the person, as for :meth:`release`.

        Returns:
            ``releases``, and ``refused``: each ``panel`` that is not proven, was planned again or is
            already released, with its ``issues``.

        Raises:
            TandemError: ``service.release``, none could be released.
        """
        self._want(BATCHES_API, "releases of panels")
        if not all(isinstance(panel, Mapping) and "id" in panel for panel in panels):
            message = "panels: give rows of panels or block_jobs of element(...), with id, job and digest."
            raise self._refused({"code": "problem.field", "message": message, "field": "panels"})
        own = [panel for panel in panels if not panel.get("cut_in")]
        shown = {str(panel["id"]): {"job": panel.get("job"), "digest": panel.get("digest")} for panel in own}
        body = {"panels": shown, "note": note, "name": name}
        return self._send(_path(element, "/release", "elements"), body, "POST")

    def mark_panel(self, element: str, panel: str, state: str) -> dict[str, Any]:
        """Mark a panel as cut, glued or broken, or as open, which removes its mark.

        The id of a raw-block job marks all panels that it cuts. If it divides the block, it marks the job
        itself: cut or open.

        Returns:
            The element, whose ``told`` lists the next steps.
        """
        self._want(DESK_API, "elements")
        return self._send(_path(element, "/mark", "elements"), {"panel": panel, "state": state}, "POST")

    def report_panels(self, element: str, key: str | None = None) -> str:
        """Report on the panels that have ended.

        Args:
            element: Id of the element.
            key: Idempotency key, as for :meth:`submit`.

        Returns:
            Id of a job, whose files are ``element.html``, ``report.csv`` and ``joints.csv`` when it is
            done.
        """
        self._check_key(key)
        self._want(DESK_API, "elements")
        return str(self._make(_path(element, "/report", "elements"), b"", "application/json", key)["id"])

    def cancel_element(self, element: str) -> dict[str, Any]:
        """Cancel the queued and running jobs of an element: division, panels and report."""
        self._want(DESK_API, "elements")
        return self._json(_path(element, "/cancel", "elements"), method="POST")

    def delete_element(self, element: str) -> None:
        """Delete an element with its reports. Planned panels remain as jobs."""
        self._request(_path(element, kind="elements"), method="DELETE")

    def report_url(self, job: str, seconds: int = 3600) -> str:
        """Return a temporary address at which a browser opens the report of a job without a token."""
        return self.link(job, "report.html", seconds)

    def replay_url(self, job: str, seconds: int = 3600) -> str:
        """Return a temporary address at which a browser opens the replay of a job without a token."""
        return self.link(job, "replay.html", seconds)

    def link(self, job: str, name: str, seconds: int = 3600) -> str:
        """Return an address at which everybody who has it can read a file of a job, for some seconds."""
        self._want(LINKS_API, "links")
        query = self._query({"name": name, "seconds": seconds})
        return f"{self._url}{self._json(_path(job, f'/links?{query}'), method='POST')['path']}"

    def look(self, job: str, seconds: int = 7 * 86400) -> str:
        """Return a temporary address of a read-only page of a job, for everybody who has the address."""
        self._want(DRAFTS_API, "view links")
        return f"{self._url}{self._json(_path(job, f'/looks?seconds={seconds}'), method='POST')['path']}"

    def looks(self, job: str) -> list[dict[str, Any]]:
        """Return the view links of a job that are in force: ``id``, ``by``, and when each ``expires``."""
        self._want(DRAFTS_API, "view links")
        return list(self._json(_path(job, "/looks"))["links"])

    def withdraw_look(self, job: str, look: str) -> None:
        """Withdraw a view link, by its ``id``."""
        self._request(_path(job, f"/looks/{_quoted(look, '')}"), method="DELETE")

    def _issue(self, data: Mapping[str, Any]) -> Any:
        """Convert an issue from JSON."""
        return Issue.from_dict(data)

    def _bundle(self, problem: Any, files: Mapping[str, Content]) -> tuple[bytes, dict[str, bytes]]:
        """Return text and files of a problem. Faults are raised as the error of this client."""
        try:
            return _bundle(problem, files)
        except _FaultError as fault:
            raise self._refused(fault.data) from fault

    def _body(self, problem: Any, files: Mapping[str, Content] | None) -> tuple[bytes, str]:
        """Return the request body with a problem and its files, and its content type."""
        text, sent_files = self._bundle(problem, files or {})
        return self._form({"problem.yaml": text}, sent_files)

    def _form(self, problems: Mapping[str, bytes], files: Mapping[str, bytes]) -> tuple[bytes, str]:
        """Return the form with problems and files, and its content type."""
        try:
            return _multipart(problems, files)
        except UnicodeEncodeError as error:
            name = error.object[max(error.start - 40, 0) : error.end + 40]
            text = f"the name {name!a} contains half of a surrogate pair. Rename it."
            raise self._refused({"code": "service.file_name", "message": text, "field": "files"}) from error

    def _query(self, parameters: Mapping[str, Any]) -> str:
        """Return a query string."""
        try:
            return urllib.parse.urlencode(parameters, doseq=True)
        except UnicodeEncodeError as error:
            message = f"{error.object[:80]!a} contains half of a surrogate pair. Correct the text."
            raise self._refused({"code": "service.request", "message": message, "field": None}) from error

    def _bundles(
        self, problems: Any, files: Mapping[str, Content]
    ) -> tuple[dict[str, bytes], dict[str, bytes]]:
        """Return the texts of several problems by name, and all files.

        Issues are reported for each problem.
        """
        _, sent_files = self._bundle(b"", files)
        texts: dict[str, bytes] = {}
        issues: list[dict[str, Any]] = []
        for number, (name, problem) in enumerate(self._named(problems)):
            if name in texts:
                message = f"two problems have the name {name!r}. Rename one, or give {{name: problem}}."
                issue = {"code": "service.file_name", "message": message, "field": "problems"}
                issues.append({**issue, "of": number})
            texts[name], sent_files, faults = self._one_of_many(problem, sent_files)
            issues += [{**fault, "message": f"{name}: {fault['message']}", "of": number} for fault in faults]
        if issues:
            raise self._refused(*issues)
        return texts, sent_files

    def _named(self, problems: Any) -> list[tuple[str, Any]]:
        """Return several problems as pairs of name and problem. Paths are named by their last component."""
        if isinstance(problems, Mapping):
            return [(str(name), problem) for name, problem in problems.items()]
        if isinstance(problems, (list, tuple)) and all(
            isinstance(path, (str, PathLike)) for path in problems
        ):
            return [(Path(fspath(path)).name, path) for path in problems]
        message = "problems: give {name: problem}, or a list of paths of problem files."
        raise self._refused({"code": "problem.field", "message": message, "field": "problems"})

    def _one_of_many(
        self, problem: Any, sent_files: dict[str, bytes]
    ) -> tuple[bytes, dict[str, bytes], list[dict[str, Any]]]:
        """Return the text of one of several problems, all files including its own, and its issues."""
        try:
            return (*self._bundle(problem, sent_files), [])
        except self._error as error:
            fields = ("code", "message", "field", "file", "line", "hint")
            return (
                b"",
                sent_files,
                [{name: getattr(issue, name) for name in fields} for issue in error.issues],
            )

    def _refused(self, *issues: Mapping[str, Any]) -> Exception:
        """Return the exception that contains some issues."""
        error: Exception = self._error(tuple(self._issue(issue) for issue in issues))
        return error

    def _answer(self, url: str, predicate: str, code: str = "service.answer") -> Exception:
        """Return the exception for an unexpected answer. The message is the address and ``predicate``."""
        return self._refused({"code": code, "message": f"{url} {predicate}", "field": "url"})

    def _away(self, error: Exception) -> Exception:
        """Return the exception for a service that cannot be reached, or that does not answer in time."""
        reason = getattr(error, "reason", error)
        if isinstance(reason, socket.timeout):
            predicate = f"gave no answer within {self._timeout_s:g} s. Check its load, or increase timeout_s."
            return self._answer(self._place, predicate, "service.timeout")
        advice = "" if self._place == self._url else ", or name it in no_proxy"
        return self._answer(self._place, f"does not answer ({reason}). Make sure that it is running{advice}.")

    def _refusal(self, error: urllib.error.HTTPError) -> Exception:
        """Return the exception for a refused request."""
        with error:
            if 300 <= error.code < 400:  # the token is sent to no other address
                location = str(error.headers.get("Location"))[:200]
                return self._answer(self._url, f"redirects to {location}. Give that address if you trust it.")
            body: Any = None
            try:
                body = json.loads(error.read())
                for issue, number in zip(body["issues"], body.get("of") or ()):  # of several problems
                    issue["of"] = number
                return self._refused(*body["issues"])
            except (ValueError, KeyError, TypeError, OSError, http.client.HTTPException):
                texts = [body.get(name) for name in ("title", "detail")] if isinstance(body, dict) else []
                why = ": ".join(
                    text[:200] for text in texts if isinstance(text, str)
                )  # possibly from a proxy
                return self._answer(
                    self._place,
                    f"answers with status {error.code}{f' ({why})' if why else ''}. Is it a Tandem service?",
                )

    def _want(self, api: int, feature: str = "") -> None:
        """Require that the service supports this client and has at least an API number.

        Args:
            api: Required API number.
            feature: Feature that requires it, for the message.
        """
        if self._api >= api:
            return
        health = self.service()
        service_api, oldest = health.get("api", 1), health.get("api_oldest", 1)
        version = health["version"]
        if oldest > API:
            message = (
                f"has version {version}, which requires clients with API {oldest} or newer. This client, "
                f"{__version__}, has API {API}: pip install --upgrade tandem-client"
            )
            raise self._answer(self._url, message, "service.version")
        if service_api < api:
            message = (
                f"has version {version} with API {service_api}; {feature}: API {api} is required. "
                "Update the service."
            )
            raise self._answer(self._url, message, "service.version")
        self._api = service_api

    def _sought(self, search: str, tags: Sequence[str], sort: str, api: int) -> dict[str, Any]:
        """Return the query of a list. A search, tags or an order require the API number ``api``."""
        if not (search or tags or sort != "newest"):
            return {}
        self._want(api, "search")
        return {"search": search, "tag": list(tags), "sort": sort}

    def _pages(self, path: str, name: str, parameters: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
        """Yield the entries of a list, page by page. ``name`` is the key of the entries in a page."""
        parameters = {"limit": 200, **parameters}
        while True:
            page = self._json(f"/v1/{path}?{self._query(parameters)}")
            yield from page[name]
            if page.get("next") is None:
                return
            parameters = {**parameters, "cursor": page["next"]}

    def _if_there(self, job: str, deadline: float) -> dict[str, Any] | None:
        """Return the job, or None while the service is unavailable, for instance during a restart."""
        try:
            return self._read_json(
                self._request(_path(job), timeout_s=min(self._timeout_s, _remaining_s(deadline)))
            )
        except self._error as error:
            is_unavailable = getattr(error.__cause__, "code", None) in AWAY
            if is_unavailable or all(
                issue.code in ("service.answer", "service.timeout") for issue in error.issues
            ):
                return None
            raise

    def _pause(self, job: str, deadline: float, timeout_s: float | None) -> None:
        """Wait before the next attempt, unless the time limit is reached."""
        time.sleep(min(RETRY_S, _remaining_s(deadline)))
        if time.monotonic() >= deadline:
            message = f"job {job}: not ended within {timeout_s} s. It continues: wait again or cancel it."
            raise self._refused({"code": "service.timeout", "message": message, "field": "timeout_s"})

    def _stream(self, job: str, after: int, deadline: float) -> Iterator[tuple[int, str, dict[str, Any]]]:
        """Yield number, kind and data of a job's events after a number, until the connection ends."""
        self._want(1)
        silence_s = min(WAIT_S, _remaining_s(deadline))
        try:
            with self._open(_path(job, f"/events?after={after}"), None, {}, "GET", silence_s) as stream:
                fields: dict[str, str] = {}
                for line in stream:
                    name, _, value = line.decode().rstrip("\n").partition(": ")
                    if name:
                        fields[name] = value
                    elif "event" in fields:
                        yield int(fields["id"]), fields["event"], json.loads(fields["data"])
                        fields = {}
                    if time.monotonic() >= deadline:
                        return
        except urllib.error.HTTPError as error:
            if error.code in AWAY:
                error.close()
                raise ConnectionError(f"status {error.code}") from error
            raise self._refusal(error) from error

    def _upload(self, path: str, problem: Any, files: Mapping[str, Content] | None) -> dict[str, Any]:
        body, kind = self._body(problem, files)
        return self._read_json(self._request(path, body, {"Content-Type": kind}, "POST"))

    def _make(self, path: str, body: bytes, kind: str, key: str | None) -> dict[str, Any]:
        """Send a request that creates jobs, with an idempotency key.

        The request is repeated if the connection is lost and the service supports keys.
        """
        self._want(1 if key is None else KEYS_API, "idempotency keys")
        headers = {"Content-Type": kind, "Idempotency-Key": secrets.token_hex(16) if key is None else key}
        pauses = PAUSES_S if self._api >= KEYS_API else ()
        return self._read_json(self._request(path, body, headers, "POST", pauses=pauses))

    def _all_of(self, created: Mapping[str, Any], count: int, key: str | None) -> list[str]:
        """Return the ids of all created jobs.

        There are fewer than ``count`` if some that the key had created were deleted. This is an error.
        """
        ids = [str(job["id"]) for job in created["jobs"]]
        if len(ids) == count:
            return ids
        message = f"key: got {key!r}, which created {count} jobs, remaining: {len(ids)}. Give another key."
        raise self._refused({"code": "service.idempotency", "message": message, "field": "key", "jobs": ids})

    def _check_key(self, key: str | None) -> None:
        """Check that a key can be sent. HTTP changes other characters, or ends the header at them."""
        if key is None or (isinstance(key, str) and _KEY.fullmatch(key)):
            return
        got = f"{key[:40]!r} of {len(key)} characters" if isinstance(key, str) else f"a {type(key).__name__}"
        allowed = f"1 to {LONGEST_KEY} printable ASCII characters without spaces"
        message = f"key: got {got}, allowed: {allowed}. Give such a text, such as str(uuid.uuid4()), or none."
        raise self._refused({"code": "service.idempotency", "message": message, "field": "key"})

    def _decide(self, job: str, action: str, body: Mapping[str, Any]) -> dict[str, Any]:
        self._want(RELEASES_API, "releases")
        return self._send(_path(job, f"/{action}"), body, "POST")

    def _send(self, path: str, values: Mapping[str, Any], method: str) -> dict[str, Any]:
        """Send the values that are not None as JSON, and return the answer."""
        stated = {name: value for name, value in values.items() if value is not None}
        body, headers = json.dumps(stated).encode(), {"Content-Type": "application/json"}
        return self._read_json(self._request(path, body, headers, method))

    def _json(self, path: str, method: str = "GET") -> dict[str, Any]:
        return self._read_json(self._request(path, method=method))

    def _read_json(self, text: bytes) -> dict[str, Any]:
        try:
            data = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise self._answer(self._url, "does not answer in JSON. Is it a Tandem service?") from error
        if not isinstance(data, dict):
            raise self._answer(self._url, "does not answer like a Tandem service. Is it one?")
        return data

    def _request(
        self,
        path: str,
        body: bytes | None = None,
        headers: Mapping[str, str] | None = None,
        method: str = "GET",
        timeout_s: float | None = None,
        pauses: Sequence[float] = (),
    ) -> bytes:
        """Send a request and return the body of the answer.

        If the connection is lost, or a proxy cannot reach the service, the request is repeated after each of
        the ``pauses`` [s].
        """
        self._want(1)
        try:
            with self._open(path, body, headers or {}, method, timeout_s or self._timeout_s) as answer:
                return answer.read()
        except urllib.error.HTTPError as error:
            if not (pauses and error.code in AWAY[:2]):
                raise self._refusal(error) from error
            error.close()
            time.sleep(pauses[0])
        except (OSError, ValueError, http.client.HTTPException) as error:
            if not (pauses and _is_connection_lost(error)):
                raise self._away(error) from error
            time.sleep(pauses[0])
        return self._request(path, body, headers, method, timeout_s, pauses[1:])

    def _open(
        self, path: str, body: bytes | None, headers: Mapping[str, str], method: str, timeout_s: float
    ) -> IO[bytes]:
        own_headers = {"User-Agent": f"tandem-client/{__version__}"}
        if self._token:
            own_headers["Authorization"] = f"Bearer {self._token}"
        request = urllib.request.Request(self._url + path, body, {**headers, **own_headers}, method=method)
        answer: IO[bytes] = self._opener.open(request, timeout=timeout_s)
        return answer


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    """Follows no redirects, because these would send the token along."""

    def redirect_request(self, *asked: Any) -> None:
        """Do nothing."""


def _proxies(parts: urllib.parse.SplitResult) -> dict[str, str]:
    """Return the proxies of this machine by scheme.

    A service on this machine needs none: a proxy's loopback address is another machine.
    """
    host = (parts.hostname or "").rstrip(".")
    if host in ("localhost", "::1") or host.startswith("127.") or urllib.request.proxy_bypass(host):
        return {}
    return urllib.request.getproxies()


def _proxy_note(proxy: str | None) -> str:
    """Return a note on a proxy for messages, without the password that its address may contain."""
    name = (proxy or "").rstrip("/").rpartition("@")[2].rpartition("/")[2]
    return f" through the proxy {name} of this machine" if name else ""


def _is_connection_lost(error: Exception) -> bool:
    """Report whether a connection was lost or not established. The service may have got the request."""
    reason = getattr(error, "reason", error)
    return isinstance(reason, (ConnectionError, http.client.HTTPException, ssl.SSLEOFError))


def _remaining_s(deadline: float) -> float:
    """Return the remaining time [s], at least 0.01 s, because 0 would mean a non-blocking connection."""
    return max(deadline - time.monotonic(), 0.01)


def _path(job: str, suffix: str = "", kind: str = "jobs") -> str:
    """Return the path of a job, an element or a draft, with a suffix that follows its id."""
    return f"/v1/{kind}/{_quoted(job, '')}{suffix}"


def _quoted(name: str, safe: str = "/") -> str:
    """Quote a name for a URL. A lone surrogate becomes a question mark."""
    return urllib.parse.quote(name, safe, errors="replace")


def _description_data(title: str | None, tags: Sequence[str] | None, notes: str | None) -> dict[str, Any]:
    """Return title, tags and notes as JSON data."""
    return {"title": title, "tags": None if tags is None else list(tags), "notes": notes}


def _multipart(problems: Mapping[str, bytes], files: Mapping[str, bytes]) -> tuple[bytes, str]:
    """Return the multipart body with problems and their files by name, and its content type (RFC 7578)."""
    boundary = secrets.token_hex(16)
    parts = [("problem", name, problems[name]) for name in problems]
    parts += [("files", name, files[name]) for name in files]
    body = bytearray()
    for field, name, content in parts:
        quoted_name = name.replace("\\", "\\\\").replace('"', "%22").replace("\r", "%0D").replace("\n", "%0A")
        body += f"--{boundary}\r\n".encode()
        body += f'Content-Disposition: form-data; name="{field}"; filename="{quoted_name}"\r\n'.encode()
        body += b"Content-Type: application/octet-stream\r\n\r\n"
        body += content + b"\r\n"
    body += f"--{boundary}--\r\n".encode()
    return bytes(body), f"multipart/form-data; boundary={boundary}"


_KEY: Final = re.compile(rf"[\x21-\x7e]{{1,{LONGEST_KEY}}}")
"""An idempotency key that the service accepts."""
_UNPRINTABLE: Final = re.compile("[\x7f-\x9f\u2028\u2029\ufeff]")
"""Characters that are allowed unescaped in JSON but not in YAML."""


def _bundle(problem: Any, files: Mapping[str, Content]) -> tuple[bytes, dict[str, bytes]]:
    """Return text and files of a problem.

    Raises:
        _FaultError: The problem is invalid.
    """
    sent_files = {name: _content(content, f"files.{name}") for name, content in files.items()}
    if isinstance(problem, bytes):
        return problem, sent_files
    if isinstance(problem, (str, PathLike)):
        return _read(problem, "problem"), sent_files
    if not isinstance(problem, Mapping):
        message = (
            f"got a {type(problem).__name__}. Give a dict, the path of a problem file, or its text as bytes."
        )
        raise _FaultError("problem.field", message, "problem")
    try:
        text = json.dumps(_to_json_data(problem, "", sent_files), ensure_ascii=False)
        escaped = _UNPRINTABLE.sub(lambda match: f"\\u{ord(match[0]):04x}", text)
        return escaped.encode("utf-8"), sent_files
    except RecursionError as error:
        raise _FaultError("problem.field", "contains itself, or is nested too deeply.", "problem") from error
    except UnicodeEncodeError as error:
        raise _FaultError(
            "problem.field", "contains half of a surrogate pair. Correct the text.", "problem"
        ) from error


def _to_json_data(value: Any, field: str, sent_files: dict[str, bytes]) -> Any:
    """Convert a value to JSON data.

    Paths and meshes are replaced by names of files, which are added to ``sent_files``.

    Args:
        value: Value, at any level of a problem.
        field: Path of the value in the problem, for messages.
        sent_files: Files of the upload by name, which are extended.

    Raises:
        _FaultError: The value cannot be sent.
    """
    if isinstance(value, Mapping):
        data = {}
        for key, item in value.items():
            item_field = f"{field}.{key}" if field else str(key)
            if key == "file" and isinstance(item, (tuple, list)):
                if not isinstance(value.get("unit"), str):
                    raise _FaultError(
                        "mesh.unit", "a mesh needs its unit: give unit: mm, or m, cm, in.", item_field
                    )
                data[key] = _add_file(_to_obj(item, item_field), "mesh.obj", sent_files)
            else:
                data[str(key)] = _to_json_data(item, item_field, sent_files)
        return data
    if isinstance(value, PathLike):
        return _add_file(_read(value, field), Path(fspath(value)).name, sent_files)
    if hasattr(value, "tolist"):  # numpy
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [_to_json_data(item, f"{field}.{number}", sent_files) for number, item in enumerate(value)]
    if isinstance(value, float) and not math.isfinite(value):
        raise _FaultError("problem.not_finite", f"got {value}. Give a finite number.", field)
    if value is None or isinstance(value, (str, bool, int, float)):
        return value
    message = f"got a {type(value).__name__}. Give numbers, texts, lists, dicts, paths and numpy arrays."
    raise _FaultError("problem.field", message, field)


def _add_file(content: bytes, name: str, sent_files: dict[str, bytes]) -> str:
    """Add a file under a unique name, or reuse an identical one. Return its name."""
    for known_name, other in sent_files.items():
        if known_name.partition("-")[2] == name and other == content:
            return known_name
    number = len(sent_files) + 1
    while f"{number}-{name}" in sent_files:
        number += 1
    sent_files[f"{number}-{name}"] = content
    return f"{number}-{name}"


def _content(content: Any, field: str) -> bytes:
    """Return the content of a file that is given as bytes, as a path, or as a mesh."""
    if isinstance(content, (bytes, bytearray)):
        return bytes(content)
    if isinstance(content, PathLike):
        return _read(content, field)
    if isinstance(content, (tuple, list)):
        return _to_obj(content, field)
    message = f"got a {type(content).__name__}. Give bytes, a pathlib.Path, or a mesh as (vertices, faces)."
    raise _FaultError("problem.field", message, field)


def _read(path: str | PathLike[str], field: str) -> bytes:
    try:
        return Path(path).read_bytes()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise _FaultError(
            "problem.missing_file", f"{fspath(path)}: {reason}. Check the path.", field
        ) from error


def _to_obj(mesh: Any, field: str) -> bytes:
    """Convert a mesh to OBJ text, with all digits of its coordinates.

    Args:
        mesh: Vertices (N, 3), and faces with three or more indices each, from 0.
        field: Field of the mesh, for messages.

    Raises:
        _FaultError: The mesh is invalid.
    """
    try:
        vertices, faces = (value.tolist() if hasattr(value, "tolist") else value for value in mesh)
        points = [(float(x), float(y), float(z)) for x, y, z in vertices]
        corners = [[_index(value) for value in face] for face in faces]
    except (TypeError, ValueError) as error:
        message = f"is not a mesh ({error}). Give (vertices, faces): rows of x, y, z and of indices from 0."
        raise _FaultError("problem.field", message, field) from error
    if not all(math.isfinite(x + y + z) for x, y, z in points):
        raise _FaultError("problem.not_finite", "the mesh has vertices that are not finite.", field)
    for number, face in enumerate(corners):
        if len(face) < 3 or not all(0 <= value < len(points) for value in face):
            message = f"face {number} of the mesh is {face}. Give three or more, from 0 to {len(points) - 1}."
            raise _FaultError("problem.field", message, field)
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in points]
    lines += ["f " + " ".join(str(value + 1) for value in face) for face in corners]
    return "\n".join([*lines, ""]).encode("ascii")


def _parse_obj(text: str) -> dict[str, Mesh]:
    """Return the objects of an OBJ file by name, each with its faces and the vertices that these use."""
    points: list[tuple[float, float, float]] = []
    faces: dict[str, list[list[int]]] = {}
    name = "mesh"
    for line in text.splitlines():
        words = line.split()
        if words[:1] == ["v"]:
            points.append((float(words[1]), float(words[2]), float(words[3])))
        elif words[:1] == ["f"]:
            face = [int(word.partition("/")[0]) for word in words[1:]]
            faces.setdefault(name, []).append(
                [index - 1 if index > 0 else len(points) + index for index in face]
            )
        elif words[:1] in (["o"], ["g"]):
            name = " ".join(words[1:])
    meshes: dict[str, Mesh] = {}
    for name, mesh_faces in faces.items():
        new_index = {
            old: new for new, old in enumerate(sorted({index for face in mesh_faces for index in face}))
        }
        meshes[name] = (
            [points[old] for old in new_index],
            [[new_index[index] for index in face] for face in mesh_faces],
        )
    return meshes


def _index(value: Any) -> int:
    """Convert an integer of Python, numpy or the host program to int. Other numbers raise ``ValueError``."""
    index = int(value)
    if index != value:
        raise ValueError(f"{value} is not an index")
    return index
