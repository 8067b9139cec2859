"""Plan on a Tandem service from any Python since 3.9, on any system, with nothing but Python's own library.

>>> import tandem_client
>>> client = tandem_client.Client("https://plans.example.org", token)
>>> job = client.submit(problem)
>>> if client.wait(job)["state"] == "verified":
...     programs, page = client.programs(job), client.replay_url(job)

A problem is a dict with the keys of a problem file, the path of such a file, or its text as bytes. Values of
a dict may be numpy arrays. A ``pathlib.Path`` in it goes along as a file, and so does a mesh:
``{"file": (vertices, faces), "unit": "mm"}``. Other files that the problem names are given by name.

This file belongs to two distributions, ``tandem-client`` and ``tandem-planner``, whose ``planner.Client`` is
built on it.
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
"""Number of the service's interface that this client was made for."""
LINKS_API: Final = 2
"""The interface from which on there are links."""
DESK_API: Final = 3
"""The interface from which on there are motions as data, and elements."""
RETRY_API: Final = 4
"""The interface from which on jobs are tried again."""
KEYS_API: Final = 6
"""The interface from which on what is sent twice with the same key is done once."""
TEAMS_API: Final = 8
"""The interface from which on tokens have roles and teams."""
RELEASES_API: Final = 9
"""The interface from which on programs are released."""
AUDIT_API: Final = 10
"""The interface from which on there is a log of who did what."""
FINDING_API: Final = 11
"""The interface from which on jobs have titles, tags and notes, and are searched."""
DRAFTS_API: Final = 13
"""The interface from which on there are drafts, sweeps, and links to look."""
TITLED_API: Final = 15
"""The interface from which on what is saved of a draft may have a new title with it."""
BATCHES_API: Final = 14
"""The interface from which on there are batches, releases of panels, titles of elements, pages of drafts, and
drafts say whether they were sent."""
RELEASE: Final = "release.json"
"""What stands beside the programs, and says whether they are released."""
PLANNED: Final = ("verified", "unproven")
"""States of jobs that have a plan."""
OPEN: Final = ("queued", "running")
"""States of jobs that have not ended."""
WAIT_S: Final = 60.0
"""A stream that says nothing for so long is opened anew."""
RETRY_S: Final = 1.0
"""Pause [s] before a stream that broke off is opened again."""
PAUSES_S: Final = (1.0, 3.0, 9.0)
"""Pauses [s] before a request that makes jobs is sent again after its connection broke off."""
AWAY: Final = (502, 503, 504)
"""Statuses by which a proxy says that the service does not answer now, or the service that it cannot."""
MOST_DELETED: Final = 200
"""Jobs that one request deletes."""
LONGEST_KEY: Final = 255
"""Characters that a key of a request may have."""
HEALTH_BYTES: Final = 100_000
"""A service's word on itself is shorter."""
Progress = Callable[[str, float], None]
"""Is told the stage, and how much of it is done."""


@dataclasses.dataclass(frozen=True)
class Issue:
    """One finding. Programs compare ``code``; ``message`` and ``hint`` are for people; ``field`` is the
    problem's, by its path. ``data`` has all that was said of it."""

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
        """An issue as the service sends it; keys that this client does not know stay in ``data``."""
        known = {field.name: data[field.name] for field in dataclasses.fields(Issue) if field.name in data}
        return Issue(**{**known, "data": dict(data)})

    def __str__(self) -> str:
        where = [self.file or "", f"line {self.line}" if self.line else "", self.field or ""]
        place = ", ".join(one for one in where if one)
        hint = f"; {self.hint}" if self.hint else ""
        return f"{self.severity} [{self.code}] {place + ': ' if place else ''}{self.message}{hint}"


class TandemError(Exception):
    """What cannot go on; ``issues`` say why."""

    def __init__(self, issues: tuple[Issue, ...]) -> None:
        self.issues = issues
        super().__init__("\n".join(str(issue) for issue in issues))


class _FaultError(Exception):
    """What is wrong with a problem before it is sent."""

    def __init__(self, code: str, message: str, field: str) -> None:
        self.data = {"code": code, "message": f"{field}: {message}", "field": field}
        super().__init__(message)


class Client:
    """A service at ``url``; ``token`` where it asks for one. ``timeout_s``: how long an answer may take.
    ``context``: for TLS, where its certificate is not one that this machine trusts anyway.

    All methods raise ``TandemError`` with the issues of a refusal, ``service.answer`` where the service
    cannot be reached, ``service.timeout`` where that takes too long, ``service.version`` where client and
    service are too far apart.
    """

    _error: Any = TandemError
    """What is raised: made of a tuple of issues, which it has as ``issues``."""

    def __init__(
        self,
        url: str,
        token: str | None = None,
        timeout_s: float = 300.0,
        context: ssl.SSLContext | None = None,
    ) -> None:
        try:
            parts = urllib.parse.urlsplit(url)
        except ValueError:  # [::1 without its end
            parts = urllib.parse.SplitResult("", "", "", "", "")
        if parts.scheme not in ("http", "https"):
            raise self._answer(url, "is no http or https URL; give one such as http://127.0.0.1:8000")
        self._url, self._timeout_s = url.rstrip("/"), timeout_s
        self._token = (token or "").strip()
        if not (self._token.isascii() and self._token.isprintable()):
            what = "the token has characters that no token has; copy it again"
            raise self._refused({"code": "service.token", "message": what, "field": "token"})
        proxies = _proxies(parts)
        self._place = f"{self._url}{_told(proxies.get(parts.scheme))}"
        self._opener = urllib.request.build_opener(
            _NoRedirect, urllib.request.HTTPSHandler(context=context), urllib.request.ProxyHandler(proxies)
        )
        self._api = 0  # of the service; 0 until it was asked

    def service(self) -> dict[str, Any]:
        """What the service says of itself: ``status``, ``version``, ``api``, jobs that wait and run. It asks
        for no token."""
        try:
            with self._open("/v1/health", None, {}, "GET", self._timeout_s) as answer:
                text = answer.read(HEALTH_BYTES)
        except urllib.error.HTTPError as error:
            if error.code != 503:  # one that does not plan at the moment says so by 503
                raise self._refusal(error) from error
            with error:
                text = error.read(HEALTH_BYTES)
        except (OSError, ValueError, http.client.HTTPException) as error:
            raise self._away(error) from error
        said = self._read_json(text)
        numbers = (said.get("api", 1), said.get("api_oldest", 1))
        if not isinstance(said.get("version"), str) or not all(isinstance(one, int) for one in numbers):
            raise self._answer(self._url, "does not answer as Tandem does; see the address")
        return said

    def who(self) -> dict[str, Any]:
        """Who asks: ``name``, ``role`` (view, plan or release) and ``team`` of the token, when it
        ``expires``, and its ``scope``, with a ``tag`` perhaps, where it is narrower than its role."""
        self._want(TEAMS_API, "roles of tokens")
        return self._json("/v1/session")

    def check(
        self, problem: Any, reach: bool = True, files: Mapping[str, Content] | None = None
    ) -> tuple[Any, ...]:
        """Validate a problem without planning: the issues found; with ``reach`` its targets are made too."""
        found = self._upload(f"/v1/check?reach={str(reach).lower()}", problem, files)
        return tuple(self._issue(issue) for issue in found["issues"])

    def submit(
        self,
        problem: Any,
        timeout_s: float | None = None,
        memory_mb: float | None = None,
        files: Mapping[str, Content] | None = None,
        key: str | None = None,
    ) -> str:
        """Send a problem to be planned, within ``timeout_s`` and ``memory_mb``; the id of its job.

        Keep the id: any client with the same token, or one of its team, asks by it, whenever. The request
        goes with a ``key``, one of its own where none is given, so that it is sent again when the connection
        breaks off and makes one job all the same; a script that may be started anew gives the same key for
        the same problem. Raises ``TandemError``: ``service.idempotency`` for a key that is not 1 to 255
        printable ASCII characters without spaces, before anything is sent.
        """
        self._check_key(key)
        asked = {"timeout_s": timeout_s, "memory_mb": memory_mb}
        query = self._query({name: value for name, value in asked.items() if value is not None})
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
        """Plan a problem with a field (``operations.0.feed_mm_s``) at several values: numbers, truth, words.
        The ids of the jobs, all or none, which have that ``tag``. ``key`` as of :meth:`submit`; where some of
        its jobs were deleted since, it is refused (``service.idempotency``). ``draft``: id and version of the
        draft that it is, which was sent then."""
        self._check_key(key)
        self._want(DRAFTS_API if draft is None else BATCHES_API, "sweeps")
        texts = [one if isinstance(one, str) else json.dumps(one) for one in values]
        asked = {"field": field, "value": texts, "tag": tag}
        if draft is not None:
            asked["draft"] = f"{draft[0]}@{draft[1]}"
        query = self._query(asked)
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
        """Plan up to 50 problems: by names that tell them apart, or paths of their files, which have names.
        The ids of the jobs in their order, all or none, which have that ``tag``. ``files`` are for all of
        them, ``key`` as of :meth:`sweep`; ``drafts``: id and version of those that the first ones are.

        What is wrong is told of each problem, in messages that begin with its name; ``data["of"]`` of an
        issue is its place, from 0.
        """
        self._check_key(key)
        texts, sent = self._bundles(problems, files or {})
        self._want(BATCHES_API, "batches")
        asked: dict[str, Any] = {"tag": tag, "draft": [f"{draft}@{version}" for draft, version in drafts]}
        body, kind = self._form(texts, sent)
        made = self._make(f"/v1/batches?{self._query(asked)}", body, kind, key)
        return self._all_of(made, len(texts), key)

    def keep_draft(
        self, problem: Any, title: str = "", kind: str = "draft", files: Mapping[str, Content] | None = None
    ) -> dict[str, Any]:
        """Keep a problem as it is, right or wrong, or a ``kind``: draft, cell, tool or template. Its ``id``
        and ``version``, from 1."""
        self._want(DRAFTS_API, "drafts")
        asked = self._query({"title": title, "kind": kind})
        return self._upload(f"/v1/drafts?{asked}", problem, files)

    def save_draft(
        self,
        draft: str,
        version: int,
        problem: Any,
        files: Mapping[str, Content] | None = None,
        without: Sequence[str] = (),
        title: str | None = None,
    ) -> dict[str, Any]:
        """The next version of a draft, for who has ``version``: the problem, ``files`` that are new, and
        those of before but ``without`` some; ``title``: what it is called from now on. Raises
        ``TandemError``: ``service.draft`` where somebody else has saved it since."""
        self._want(DRAFTS_API, "drafts")
        if title is not None:
            self._want(TITLED_API, "titles of drafts that are saved")
        asked = self._query({"without": list(without), **({} if title is None else {"title": title})})
        body, kind = self._body(problem, files)
        headers = {"Content-Type": kind, "If-Match": f'"{version}"'}
        return self._read_json(self._request(_of(draft, f"?{asked}", "drafts"), body, headers, "PUT"))

    def drafts(self, kind: str | None = None) -> Iterator[dict[str, Any]]:
        """Drafts of the token and of its team, or those of a ``kind``, what was changed last first."""
        self._want(DRAFTS_API, "drafts")
        whole = {} if self._api >= BATCHES_API else {"limit": 1000}  # before that, one page was all
        yield from self._pages("drafts", "drafts", whole | ({} if kind is None else {"kind": kind}))

    def draft(self, draft: str, version: int | None = None) -> tuple[bytes, dict[str, bytes]]:
        """Text and files of a draft as it is, or as it was."""
        self._want(DRAFTS_API, "drafts")
        number = self._json(_of(draft, kind="drafts"))["version"] if version is None else version
        own = _of(draft, f"/versions/{number}", "drafts")
        names = [one["name"] for one in self._json(own)["files"]]
        files = {name: self._request(f"{own}/files/{_quoted(name)}") for name in names}
        return self._request(f"{own}/problem"), files

    def versions(self, draft: str) -> list[dict[str, Any]]:
        """The versions of a draft, the newest first: ``number``, ``at``, ``by`` whom, names of ``files``."""
        self._want(DRAFTS_API, "drafts")
        return list(self._json(_of(draft, kind="drafts"))["versions"])

    def rename_draft(self, draft: str, title: str) -> dict[str, Any]:
        """Call a draft otherwise, in any language; it is no new version."""
        self._want(DRAFTS_API, "drafts")
        return self._send(_of(draft, kind="drafts"), {"title": title}, "PATCH")

    def mark_sent(self, draft: str, version: int, job: str) -> dict[str, Any]:
        """Note that a version of a draft was sent as a job, so that it is no unsent work any more."""
        self._want(BATCHES_API, "drafts that were sent")
        return self._send(_of(draft, "/sent", "drafts"), {"version": version, "job": job}, "POST")

    def delete_draft(self, draft: str) -> None:
        """Delete a draft with its versions."""
        self._request(_of(draft, kind="drafts"), method="DELETE")

    def job(self, job: str) -> dict[str, Any]:
        """State, stage and ``fraction`` of it, issues and figures of a job, at once."""
        return self._json(_of(job))

    def jobs(
        self, search: str = "", tags: Sequence[str] = (), sort: str = "newest", states: Sequence[str] = ()
    ) -> Iterator[dict[str, Any]]:
        """All jobs of the token and of its team, or those with all words of ``search`` in name, title, tags
        or notes, with all ``tags`` and one of the ``states``; ``sort``: newest, oldest, title, or turn, which
        is the queue of those that wait. ``by`` says whose each is."""
        asked = self._sought(search, tags, sort, DRAFTS_API if sort == "turn" else FINDING_API)
        yield from self._pages("jobs", "jobs", {**asked, "state": list(states)})

    def describe(
        self, job: str, title: str | None = None, tags: Sequence[str] | None = None, notes: str | None = None
    ) -> dict[str, Any]:
        """Give a job a title in any language, tags and notes; what is None stays as it is."""
        self._want(FINDING_API, "titles, tags and notes")
        return self._send(_of(job), _described(title, tags, notes), "PATCH")

    def first(self, job: str) -> dict[str, Any]:
        """Let a job that waits come before the others of its owner. Raises ``TandemError``:
        ``service.state`` for one that does not wait."""
        self._want(DRAFTS_API, "the order of the queue")
        return self._json(_of(job, "/first"), method="POST")

    def estimate(self, job: str) -> dict[str, Any]:
        """How long a job may still take by ``like`` proven jobs: ``left_s`` and ``whole_s``, where there are
        such; ``elapsed_s`` while it runs. An estimate, nothing more."""
        self._want(DRAFTS_API, "estimates")
        return self._json(_of(job, "/estimate"))

    def cancel(self, job: str) -> None:
        """Cancel a job."""
        self._json(_of(job, "/cancel"), method="POST")

    def retry(self, job: str) -> None:
        """Plan a job again that crashed, met a limit or was cancelled. Raises ``TandemError``:
        ``service.state`` for others."""
        self._want(RETRY_API, "jobs that are tried again")
        self._json(_of(job, "/retry"), method="POST")

    def delete(self, job: str) -> None:
        """Delete a job and its files."""
        self._request(_of(job), method="DELETE")

    def delete_jobs(self, jobs: Sequence[str]) -> list[str]:
        """Delete jobs and their files; the ids of those that there are not."""
        self._want(FINDING_API, "deleting many jobs")
        unknown: list[str] = []
        ids = [jobs] if isinstance(jobs, str) else list(jobs)
        for start in range(0, len(ids), MOST_DELETED):
            some = {"jobs": ids[start : start + MOST_DELETED]}
            unknown += self._send("/v1/jobs/delete", some, "POST")["unknown"]
        return unknown

    def events(self, job: str, timeout_s: float | None = None) -> Iterator[tuple[str, dict[str, Any]]]:
        """Kind and data of a job's events until it has ended, over lost connections and restarts; with
        ``timeout_s`` for so long at most."""
        until = math.inf if timeout_s is None else time.monotonic() + timeout_s
        after, ended = 0, False
        while not ended:
            try:
                for number, kind, data in self._stream(job, after, until):
                    after, ended = max(after, number), kind == "end"
                    if not ended:
                        yield kind, data
            except (OSError, ValueError, http.client.HTTPException):  # the line broke off
                pass
            if not ended:
                self._pause(job, until, timeout_s)
                found = self._if_there(job, until)
                ended = found is not None and found["state"] not in OPEN

    def wait(
        self, job: str, progress: Progress | None = None, timeout_s: float | None = None
    ) -> dict[str, Any]:
        """The job when it has ended; with ``timeout_s`` no longer than that."""
        until = math.inf if timeout_s is None else time.monotonic() + timeout_s
        for kind, data in self.events(job, timeout_s):
            if kind == "progress" and progress is not None:
                progress(str(data["stage"]), float(data["fraction"]))
        found = self._if_there(job, until)
        while found is None:
            self._pause(job, until, timeout_s)
            found = self._if_there(job, until)
        return found

    def file(self, job: str, name: str) -> bytes:
        """A file of a job, by its name in the list of files."""
        return self._request(_of(job, f"/files/{_quoted(name)}"))

    def files(self, job: str) -> dict[str, bytes]:
        """All files of a job by name: its problem and its results."""
        return {one["name"]: self.file(job, one["name"]) for one in self._json(_of(job, "/files"))["files"]}

    def programs(self, job: str) -> dict[str, str]:
        """The programs of a job by name; raises ``TandemError`` where there are none."""
        import zipfile  # costs a tenth of what all the rest does

        with zipfile.ZipFile(io.BytesIO(self._request(_of(job, "/programs.zip")))) as archive:
            names = [name for name in archive.namelist() if name != RELEASE]
            return {name: archive.read(name).decode("utf-8") for name in names}

    def release(self, job: str, note: str = "", name: str | None = None) -> dict[str, Any]:
        """Release the programs of a job, in the name of the token, or in that ``name`` where the service asks
        for none: ``by`` whom, ``at``, the ``digest`` of the problem, SHA-256 of ``proof`` and ``programs``.
        Raises ``TandemError``: ``service.release`` for what is not verified or is released already."""
        return self._decide(job, "release", {"note": note, "name": name})

    def withdraw(self, job: str, reason: str, name: str | None = None) -> dict[str, Any]:
        """Withdraw the release of a job; it stays written down with the ``reason``."""
        return self._decide(job, "withdraw", {"reason": reason, "name": name})

    def releases(self, job: str) -> list[dict[str, Any]]:
        """The releases of a job, the newest first; one that was ``withdrawn`` holds no longer."""
        self._want(RELEASES_API, "releases")
        return list(self._json(_of(job, "/releases"))["releases"])

    def audit(self, job: str | None = None, acts: Sequence[str] = ()) -> Iterator[dict[str, Any]]:
        """Who did what, the newest first: ``at``, ``by``, ``act``, ``job`` and ``about``; of one job, or of
        all of the token's team, and of some ``acts`` alone. It needs a token with the role release."""
        self._want(AUDIT_API, "the audit log")
        yield from self._pages("audit", "acts", {"act": list(acts)} | ({} if job is None else {"job": job}))

    def motion(self, job: str) -> dict[str, Any]:
        """The motion of a planned job as data: planes at the TCPs [mm], joints by name [deg], times [s]."""
        self._want(DESK_API, "the motion as data")
        return self._read_json(self.file(job, "motion.json"))

    def meshes(self, job: str, name: str = "simulated_part.obj") -> dict[str, Mesh]:
        """The meshes in an OBJ file of a job by their names, with vertices in mm: what the tools leave, in
        the frame of the block; the panels of an element are in ``element.obj``."""
        try:
            return _meshes(self.file(job, name).decode("utf-8"))
        except (ValueError, IndexError) as error:
            raise self._answer(self._url, f"gives {name}, which is no mesh: {error}") from error

    def divide(self, element: Any, files: Mapping[str, Content] | None = None, key: str | None = None) -> str:
        """Send a building element to be divided into panels; its id, which is also that of a job to wait for.

        An element is said as a problem is: a dict, the path of a file, or its text. ``key`` as of
        :meth:`submit`.
        """
        self._check_key(key)
        self._want(DESK_API, "elements")
        body, kind = self._body(element, files)
        return str(self._make("/v1/elements", body, kind, key)["id"])

    def element(self, element: str) -> dict[str, Any]:
        """An element with its ``panels``: order, block, job and state of each, and its ``block_jobs``, which
        cut raw blocks apart, or several ``panels`` out of one together."""
        self._want(DESK_API, "elements")
        return self._json(_of(element, kind="elements"))

    def plan_panels(
        self, element: str, panels: Sequence[str] | None = None, key: str | None = None
    ) -> list[str]:
        """Plan panels and jobs of raw blocks of an element by their ids, or all that are not planned yet; the
        ids of their jobs. ``key`` as of :meth:`submit`."""
        self._check_key(key)
        self._want(DESK_API, "elements")
        body = json.dumps({} if panels is None else {"panels": list(panels)}).encode()
        made = self._make(_of(element, "/plan", "elements"), body, "application/json", key)
        return [str(one["id"]) for one in made["jobs"]]

    def elements(
        self, search: str = "", tags: Sequence[str] = (), sort: str = "newest"
    ) -> Iterator[dict[str, Any]]:
        """All elements of the token and of its team, or those that are sought as :meth:`jobs` are."""
        self._want(DESK_API, "elements")
        yield from self._pages("elements", "elements", self._sought(search, tags, sort, BATCHES_API))

    def describe_element(
        self,
        element: str,
        title: str | None = None,
        tags: Sequence[str] | None = None,
        notes: str | None = None,
    ) -> dict[str, Any]:
        """Give an element a title, tags and notes, as :meth:`describe` does a job."""
        self._want(BATCHES_API, "titles, tags and notes of elements")
        return self._send(_of(element, kind="elements"), _described(title, tags, notes), "PATCH")

    def divide_anew(
        self, element: str, fields: Mapping[str, Any], instead: bool = False, key: str | None = None
    ) -> str:
        """Divide an element with other values of ``fields``, by their places (``panels.hexagons.count``); the
        id of the new one, which has the former one's marks. With ``instead`` the former one is deleted if
        none of its panels was planned or marked. ``key`` as of :meth:`submit`."""
        self._check_key(key)
        self._want(DESK_API, "elements")
        text, sent = self._bundle({"fields": fields}, {})
        if sent:
            what = "fields: got a file; what an element is read from stays, so divide the changed file"
            raise self._refused({"code": "problem.field", "message": what, "field": "fields"})
        path = _of(element, f"/divide?instead={str(instead).lower()}", "elements")
        return str(self._make(path, text, "application/json", key)["id"])

    def release_panels(
        self, element: str, panels: Sequence[Mapping[str, Any]], note: str = "", name: str | None = None
    ) -> dict[str, Any]:
        """Release the programs of panels and of jobs of raw blocks by one act: rows of :meth:`element`, each
        by its ``job`` and ``digest`` as it was looked at; panels that are ``cut_in`` the job of a raw block
        are released with that. The ``releases``, and what is ``refused``: a ``panel`` that is not
        proven, was planned again meanwhile, or is released already, with its ``issues``. ``name`` as of
        :meth:`release`. Raises ``TandemError``: ``service.release`` where that is all of them."""
        self._want(BATCHES_API, "releases of panels")
        if not all(isinstance(one, Mapping) and "id" in one for one in panels):
            what = "panels: give rows of element(...), of its panels or block_jobs, with id, job and digest"
            raise self._refused({"code": "problem.field", "message": what, "field": "panels"})
        own = [one for one in panels if not one.get("cut_in")]
        shown = {str(one["id"]): {"job": one.get("job"), "digest": one.get("digest")} for one in own}
        said = {"panels": shown, "note": note, "name": name}
        return self._send(_of(element, "/release", "elements"), said, "POST")

    def mark_panel(self, element: str, panel: str, state: str) -> dict[str, Any]:
        """Mark a panel as cut, glued or broken, or open, which takes its mark away: the element, whose
        ``told`` says what is next. The id of a job of a raw block stands for all panels that it cuts, or
        where it cuts the block apart, for itself: cut or open."""
        self._want(DESK_API, "elements")
        return self._send(_of(element, "/mark", "elements"), {"panel": panel, "state": state}, "POST")

    def report_panels(self, element: str, key: str | None = None) -> str:
        """Report on the panels that have ended: the id of a job, whose files are ``element.html``,
        ``report.csv`` and ``joints.csv`` when it is done. ``key`` as of :meth:`submit`."""
        self._check_key(key)
        self._want(DESK_API, "elements")
        return str(self._make(_of(element, "/report", "elements"), b"", "application/json", key)["id"])

    def cancel_element(self, element: str) -> dict[str, Any]:
        """Cancel what of an element waits or runs: its division, its panels, a report."""
        self._want(DESK_API, "elements")
        return self._json(_of(element, "/cancel", "elements"), method="POST")

    def delete_element(self, element: str) -> None:
        """Delete an element with its reports; panels that were planned stay as jobs."""
        self._request(_of(element, kind="elements"), method="DELETE")

    def report_url(self, job: str, seconds: int = 3600) -> str:
        """The address of a job's report, which a browser opens without a token for so long."""
        return self.link(job, "report.html", seconds)

    def replay_url(self, job: str, seconds: int = 3600) -> str:
        """The address of a job's replay, which a browser opens without a token for so long."""
        return self.link(job, "replay.html", seconds)

    def link(self, job: str, name: str, seconds: int = 3600) -> str:
        """The address of a file of a job, which whoever has it may read for so long."""
        self._want(LINKS_API, "links")
        asked = self._query({"name": name, "seconds": seconds})
        return f"{self._url}{self._json(_of(job, f'/links?{asked}'), method='POST')['path']}"

    def look(self, job: str, seconds: int = 7 * 86400) -> str:
        """The address of a page that shows a job to whoever has it, and nothing else, for so long."""
        self._want(DRAFTS_API, "links to look")
        return f"{self._url}{self._json(_of(job, f'/looks?seconds={seconds}'), method='POST')['path']}"

    def looks(self, job: str) -> list[dict[str, Any]]:
        """The links to look at a job that are good: ``id``, ``by`` whom, and when it ``expires``."""
        self._want(DRAFTS_API, "links to look")
        return list(self._json(_of(job, "/looks"))["links"])

    def withdraw_look(self, job: str, look: str) -> None:
        """Withdraw a link to look, by its ``id``."""
        self._request(_of(job, f"/looks/{_quoted(look, '')}"), method="DELETE")

    def _issue(self, data: Mapping[str, Any]) -> Any:
        """An issue as it was sent."""
        return Issue.from_dict(data)

    def _bundle(self, problem: Any, files: Mapping[str, Content]) -> tuple[bytes, dict[str, bytes]]:
        """Text and files of a problem."""
        try:
            return _bundle(problem, files)
        except _FaultError as fault:
            raise self._refused(fault.data) from fault

    def _body(self, problem: Any, files: Mapping[str, Content] | None) -> tuple[bytes, str]:
        """The body with a problem and its files, and its content type."""
        text, sent = self._bundle(problem, files or {})
        return self._form({"problem.yaml": text}, sent)

    def _form(self, problems: Mapping[str, bytes], files: Mapping[str, bytes]) -> tuple[bytes, str]:
        """The body with problems and files, whose names are texts."""
        try:
            return _multipart(problems, files)
        except UnicodeEncodeError as error:
            name = error.object[max(error.start - 40, 0) : error.end + 40]
            what = f"the name {name!a} has half a character; rename it"
            raise self._refused({"code": "service.file_name", "message": what, "field": "files"}) from error

    def _query(self, asked: Mapping[str, Any]) -> str:
        """The query with what is asked."""
        try:
            return urllib.parse.urlencode(asked, doseq=True)
        except UnicodeEncodeError as error:
            what = f"{error.object[:80]!a} has half a character; correct the text"
            raise self._refused({"code": "service.request", "message": what, "field": None}) from error

    def _bundles(
        self, problems: Any, files: Mapping[str, Content]
    ) -> tuple[dict[str, bytes], dict[str, bytes]]:
        """Texts of several problems by their names, and the files of all; what is wrong is told of each."""
        _, sent = self._bundle(b"", files)
        texts: dict[str, bytes] = {}
        wrong: list[dict[str, Any]] = []
        for number, (name, problem) in enumerate(self._named(problems)):
            if name in texts:
                what = f"two problems have the name {name!r}; rename one, or give {{name: problem}}"
                double = {"code": "service.file_name", "message": what, "field": "problems"}
                wrong.append({**double, "of": number})
            texts[name], sent, faults = self._one_of_many(problem, sent)
            wrong += [{**one, "message": f"{name}: {one['message']}", "of": number} for one in faults]
        if wrong:
            raise self._refused(*wrong)
        return texts, sent

    def _named(self, problems: Any) -> list[tuple[str, Any]]:
        """Several problems with their names."""
        if isinstance(problems, Mapping):
            return [(str(name), problem) for name, problem in problems.items()]
        if isinstance(problems, (list, tuple)) and all(isinstance(one, (str, PathLike)) for one in problems):
            return [(Path(fspath(one)).name, one) for one in problems]
        what = "problems: give {name: problem}, or a list of paths of problem files"
        raise self._refused({"code": "problem.field", "message": what, "field": "problems"})

    def _one_of_many(
        self, problem: Any, sent: dict[str, bytes]
    ) -> tuple[bytes, dict[str, bytes], list[dict[str, Any]]]:
        """Text of a problem, the files with its own, and what is wrong with it."""
        try:
            return (*self._bundle(problem, sent), [])
        except self._error as error:
            asked = ("code", "message", "field", "file", "line", "hint")
            return b"", sent, [{name: getattr(one, name) for name in asked} for one in error.issues]

    def _refused(self, *found: Mapping[str, Any]) -> Exception:
        error: Exception = self._error(tuple(self._issue(one) for one in found))
        return error

    def _answer(self, url: str, what: str, code: str = "service.answer") -> Exception:
        return self._refused({"code": code, "message": f"{url} {what}", "field": "url"})

    def _away(self, error: Exception) -> Exception:
        reason = getattr(error, "reason", error)
        if isinstance(reason, socket.timeout):
            what = f"gave no answer within {self._timeout_s:g} s; see how busy it is, or give timeout_s more"
            return self._answer(self._place, what, "service.timeout")
        past = "" if self._place == self._url else ", or name it in no_proxy"
        return self._answer(self._place, f"does not answer ({reason}); see that it runs{past}")

    def _refusal(self, error: urllib.error.HTTPError) -> Exception:
        """The issues of a refusal."""
        with error:
            if 300 <= error.code < 400:  # a token goes to the address that it was given for, and no other
                there = str(error.headers.get("Location"))[:200]
                return self._answer(
                    self._url, f"sends requests on to {there}; give that address if it is yours"
                )
            said: Any = None
            try:
                said = json.loads(error.read())
                for issue, number in zip(said["issues"], said.get("of") or ()):  # of several problems
                    issue["of"] = number
                return self._refused(*said["issues"])
            except (ValueError, KeyError, TypeError, OSError, http.client.HTTPException):
                told = [said.get(name) for name in ("title", "detail")] if isinstance(said, dict) else []
                why = ": ".join(one[:200] for one in told if isinstance(one, str))  # of a proxy, perhaps
                return self._answer(
                    self._place,
                    f"answers with status {error.code}{f' ({why})' if why else ''}; is it a Tandem?",
                )

    def _want(self, api: int, what: str = "") -> None:
        """See that the service has this interface, and serves this client."""
        if self._api >= api:
            return
        said = self.service()
        has, oldest, version = said.get("api", 1), said.get("api_oldest", 1), said["version"]
        if oldest > API:
            message = (
                f"has version {version}, for clients of interface {oldest} or newer; this one, "
                f"{__version__}, has {API}: pip install --upgrade tandem-client"
            )
            raise self._answer(self._url, message, "service.version")
        if has < api:
            message = (
                f"has version {version} with interface {has}; {what} came with {api}: update the service"
            )
            raise self._answer(self._url, message, "service.version")
        self._api = has

    def _sought(self, search: str, tags: Sequence[str], sort: str, api: int) -> dict[str, Any]:
        """What a list is asked for, if the service has an interface with that."""
        if not (search or tags or sort != "newest"):
            return {}
        self._want(api, "search")
        return {"search": search, "tag": list(tags), "sort": sort}

    def _pages(self, path: str, name: str, asked: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
        """What a list has under ``name``, page by page."""
        asked = {"limit": 200, **asked}
        while True:
            page = self._json(f"/v1/{path}?{self._query(asked)}")
            yield from page[name]
            if page.get("next") is None:
                return
            asked = {**asked, "cursor": page["next"]}

    def _if_there(self, job: str, until: float) -> dict[str, Any] | None:
        """The job; None while the service is away, perhaps for a restart."""
        try:
            return self._read_json(self._request(_of(job), timeout_s=min(self._timeout_s, _left(until))))
        except self._error as error:
            away = getattr(error.__cause__, "code", None) in AWAY
            if away or all(one.code in ("service.answer", "service.timeout") for one in error.issues):
                return None
            raise

    def _pause(self, job: str, until: float, timeout_s: float | None) -> None:
        """Wait for the service to be there again, unless time is up."""
        time.sleep(min(RETRY_S, _left(until)))
        if time.monotonic() >= until:
            what = f"job {job}: not ended within {timeout_s} s; it goes on, wait again or cancel it"
            raise self._refused({"code": "service.timeout", "message": what, "field": "timeout_s"})

    def _stream(self, job: str, after: int, until: float) -> Iterator[tuple[int, str, dict[str, Any]]]:
        self._want(1)
        quiet = min(WAIT_S, _left(until))
        try:
            with self._open(_of(job, f"/events?after={after}"), None, {}, "GET", quiet) as stream:
                fields: dict[str, str] = {}
                for line in stream:
                    name, _, value = line.decode().rstrip("\n").partition(": ")
                    if name:
                        fields[name] = value
                    elif "event" in fields:
                        yield int(fields["id"]), fields["event"], json.loads(fields["data"])
                        fields = {}
                    if time.monotonic() >= until:
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
        """Send what makes jobs; again where the connection breaks off, if the service knows keys."""
        self._want(1 if key is None else KEYS_API, "keys of requests")
        headers = {"Content-Type": kind, "Idempotency-Key": secrets.token_hex(16) if key is None else key}
        pauses = PAUSES_S if self._api >= KEYS_API else ()
        return self._read_json(self._request(path, body, headers, "POST", pauses=pauses))

    def _all_of(self, made: Mapping[str, Any], count: int, key: str | None) -> list[str]:
        """The ids of so many jobs in their order; fewer are left where some that a key had made were
        deleted."""
        ids = [str(one["id"]) for one in made["jobs"]]
        if len(ids) == count:
            return ids
        what = f"key: got {key!r}, which made {count} jobs before; left of them: {len(ids)}. Give another key"
        raise self._refused({"code": "service.idempotency", "message": what, "field": "key", "jobs": ids})

    def _check_key(self, key: str | None) -> None:
        """See that the service takes a key: a header changes some others on their way, or ends at them."""
        if key is None or (isinstance(key, str) and _KEY.fullmatch(key)):
            return
        got = f"{key[:40]!r} of {len(key)} characters" if isinstance(key, str) else f"a {type(key).__name__}"
        allowed = f"1 to {LONGEST_KEY} printable ASCII characters without spaces"
        what = f"key: got {got}; {allowed} are allowed: give such a text, str(uuid.uuid4()) say, or none"
        raise self._refused({"code": "service.idempotency", "message": what, "field": "key"})

    def _decide(self, job: str, what: str, said: Mapping[str, Any]) -> dict[str, Any]:
        self._want(RELEASES_API, "releases")
        return self._send(_of(job, f"/{what}"), said, "POST")

    def _send(self, path: str, said: Mapping[str, Any], method: str) -> dict[str, Any]:
        """Send what is not None."""
        given = {name: value for name, value in said.items() if value is not None}
        body, headers = json.dumps(given).encode(), {"Content-Type": "application/json"}
        return self._read_json(self._request(path, body, headers, method))

    def _json(self, path: str, method: str = "GET") -> dict[str, Any]:
        return self._read_json(self._request(path, method=method))

    def _read_json(self, text: bytes) -> dict[str, Any]:
        try:
            found = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise self._answer(self._url, "does not answer in JSON; is it a Tandem?") from error
        if not isinstance(found, dict):
            raise self._answer(self._url, "does not answer as Tandem does; is it one?")
        return found

    def _request(
        self,
        path: str,
        body: bytes | None = None,
        headers: Mapping[str, str] | None = None,
        method: str = "GET",
        timeout_s: float | None = None,
        pauses: Sequence[float] = (),
    ) -> bytes:
        """The answer; after each of the ``pauses`` [s] it is asked for again where the connection broke
        off, or a proxy found nobody behind it."""
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
            if not (pauses and _broken_off(error)):
                raise self._away(error) from error
            time.sleep(pauses[0])
        return self._request(path, body, headers, method, timeout_s, pauses[1:])

    def _open(
        self, path: str, body: bytes | None, headers: Mapping[str, str], method: str, timeout_s: float
    ) -> IO[bytes]:
        own = {"User-Agent": f"tandem-client/{__version__}"}
        if self._token:
            own["Authorization"] = f"Bearer {self._token}"
        request = urllib.request.Request(self._url + path, body, {**headers, **own}, method=method)
        found: IO[bytes] = self._opener.open(request, timeout=timeout_s)
        return found


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    """Follows no redirects: the token would go along."""

    def redirect_request(self, *asked: Any) -> None:
        """Nothing."""


def _proxies(parts: urllib.parse.SplitResult) -> dict[str, str]:
    """The proxies of this machine by scheme, none for what is on it: a proxy's own loopback is another."""
    host = (parts.hostname or "").rstrip(".")
    if host in ("localhost", "::1") or host.startswith("127.") or urllib.request.proxy_bypass(host):
        return {}
    return urllib.request.getproxies()


def _told(proxy: str | None) -> str:
    """How a proxy is named to people, without a password that its address may have."""
    shown = (proxy or "").rstrip("/").rpartition("@")[2].rpartition("/")[2]
    return f" through the proxy {shown} of this machine" if shown else ""


def _broken_off(error: Exception) -> bool:
    """Whether a connection was lost or not had: the request came to its service, or it did not."""
    reason = getattr(error, "reason", error)
    return isinstance(reason, (ConnectionError, http.client.HTTPException, ssl.SSLEOFError))


def _left(until: float) -> float:
    """Time [s] until then, more than none: a connection takes 0 for never waiting."""
    return max(until - time.monotonic(), 0.01)


def _of(job: str, what: str = "", kind: str = "jobs") -> str:
    """The path of a job, or an element."""
    return f"/v1/{kind}/{_quoted(job, '')}{what}"


def _quoted(name: str, safe: str = "/") -> str:
    """A name in an address; half a character, which no name has there, is a question mark."""
    return urllib.parse.quote(name, safe, errors="replace")


def _described(title: str | None, tags: Sequence[str] | None, notes: str | None) -> dict[str, Any]:
    """What people call a job or an element."""
    return {"title": title, "tags": None if tags is None else list(tags), "notes": notes}


def _multipart(problems: Mapping[str, bytes], files: Mapping[str, bytes]) -> tuple[bytes, str]:
    """The body with problems and their files by name, and its content type (RFC 7578)."""
    boundary = secrets.token_hex(16)
    parts = [("problem", name, problems[name]) for name in problems]
    parts += [("files", name, files[name]) for name in files]
    body = bytearray()
    for field, name, content in parts:
        quoted = name.replace("\\", "\\\\").replace('"', "%22").replace("\r", "%0D").replace("\n", "%0A")
        body += f"--{boundary}\r\n".encode()
        body += f'Content-Disposition: form-data; name="{field}"; filename="{quoted}"\r\n'.encode()
        body += b"Content-Type: application/octet-stream\r\n\r\n"
        body += content + b"\r\n"
    body += f"--{boundary}--\r\n".encode()
    return bytes(body), f"multipart/form-data; boundary={boundary}"


_KEY: Final = re.compile(rf"[\x21-\x7e]{{1,{LONGEST_KEY}}}")
"""A key of a request, as the service takes it."""
_UNPRINTABLE: Final = re.compile("[\x7f-\x9f\u2028\u2029\ufeff]")
"""Characters that JSON has as they are and YAML does not."""


def _bundle(problem: Any, files: Mapping[str, Content]) -> tuple[bytes, dict[str, bytes]]:
    """Text and files of a problem; raises :class:`_FaultError`."""
    sent = {name: _content(one, f"files.{name}") for name, one in files.items()}
    if isinstance(problem, bytes):
        return problem, sent
    if isinstance(problem, (str, PathLike)):
        return _read(problem, "problem"), sent
    if not isinstance(problem, Mapping):
        what = (
            f"got a {type(problem).__name__}; give a dict, the path of a problem file, or its text as bytes"
        )
        raise _FaultError("problem.field", what, "problem")
    try:
        text = json.dumps(_plain(problem, "", sent), ensure_ascii=False)
        escaped = _UNPRINTABLE.sub(lambda found: f"\\u{ord(found[0]):04x}", text)
        return escaped.encode("utf-8"), sent
    except RecursionError as error:
        raise _FaultError(
            "problem.field", "holds itself, or too much inside one another", "problem"
        ) from error
    except UnicodeEncodeError as error:
        raise _FaultError("problem.field", "has half a character; correct the text", "problem") from error


def _plain(value: Any, field: str, sent: dict[str, bytes]) -> Any:
    """A value as JSON has it; paths and meshes in it become names of files, which are added to ``sent``."""
    if isinstance(value, Mapping):
        out = {}
        for key, one in value.items():
            place = f"{field}.{key}" if field else str(key)
            if key == "file" and isinstance(one, (tuple, list)):
                if not isinstance(value.get("unit"), str):
                    raise _FaultError(
                        "mesh.unit", "a mesh needs its unit beside it: unit: mm, or m, cm, in", place
                    )
                out[key] = _carry(_obj(one, place), "mesh.obj", sent)
            else:
                out[str(key)] = _plain(one, place, sent)
        return out
    if isinstance(value, PathLike):
        return _carry(_read(value, field), Path(fspath(value)).name, sent)
    if hasattr(value, "tolist"):  # of numpy
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [_plain(one, f"{field}.{number}", sent) for number, one in enumerate(value)]
    if isinstance(value, float) and not math.isfinite(value):
        raise _FaultError("problem.not_finite", f"got {value}; give a finite number", field)
    if value is None or isinstance(value, (str, bool, int, float)):
        return value
    what = f"got a {type(value).__name__}; give numbers, texts, lists, dicts, paths and numpy arrays"
    raise _FaultError("problem.field", what, field)


def _carry(content: bytes, name: str, sent: dict[str, bytes]) -> str:
    """Add a file under a name of its own, or find it where it is there already; that name."""
    for known, other in sent.items():
        if known.partition("-")[2] == name and other == content:
            return known
    number = len(sent) + 1
    while f"{number}-{name}" in sent:
        number += 1
    sent[f"{number}-{name}"] = content
    return f"{number}-{name}"


def _content(one: Any, field: str) -> bytes:
    if isinstance(one, (bytes, bytearray)):
        return bytes(one)
    if isinstance(one, PathLike):
        return _read(one, field)
    if isinstance(one, (tuple, list)):
        return _obj(one, field)
    what = f"got a {type(one).__name__}; give bytes, a pathlib.Path, or a mesh as (vertices, faces)"
    raise _FaultError("problem.field", what, field)


def _read(path: str | PathLike[str], field: str) -> bytes:
    try:
        return Path(path).read_bytes()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise _FaultError(
            "problem.missing_file", f"{fspath(path)}: {reason}; check the path", field
        ) from error


def _obj(mesh: Any, field: str) -> bytes:
    """A mesh of vertices (N, 3) and faces, rows of three or more indices from 0, as OBJ with every digit."""
    try:
        vertices, faces = (one.tolist() if hasattr(one, "tolist") else one for one in mesh)
        points = [(float(x), float(y), float(z)) for x, y, z in vertices]
        corners = [[_index(one) for one in face] for face in faces]
    except (TypeError, ValueError) as error:
        what = f"is no mesh ({error}); give (vertices, faces), rows of x, y, z and rows of indices from 0"
        raise _FaultError("problem.field", what, field) from error
    if not all(math.isfinite(x + y + z) for x, y, z in points):
        raise _FaultError("problem.not_finite", "the mesh has vertices that are not finite", field)
    for number, face in enumerate(corners):
        if len(face) < 3 or not all(0 <= one < len(points) for one in face):
            what = (
                f"face {number} of the mesh is {face}; give three or more indices from 0 to {len(points) - 1}"
            )
            raise _FaultError("problem.field", what, field)
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in points]
    lines += ["f " + " ".join(str(one + 1) for one in face) for face in corners]
    return "\n".join([*lines, ""]).encode("ascii")


def _meshes(text: str) -> dict[str, Mesh]:
    """The objects of an OBJ file by name, each with the vertices that it uses, and its faces."""
    points: list[tuple[float, float, float]] = []
    faces: dict[str, list[list[int]]] = {}
    name = "mesh"
    for line in text.splitlines():
        words = line.split()
        if words[:1] == ["v"]:
            points.append((float(words[1]), float(words[2]), float(words[3])))
        elif words[:1] == ["f"]:
            face = [int(word.partition("/")[0]) for word in words[1:]]
            faces.setdefault(name, []).append([one - 1 if one > 0 else len(points) + one for one in face])
        elif words[:1] in (["o"], ["g"]):
            name = " ".join(words[1:])
    found: dict[str, Mesh] = {}
    for name, rows in faces.items():
        own = {old: new for new, old in enumerate(sorted({one for row in rows for one in row}))}
        found[name] = [points[old] for old in own], [[own[one] for one in row] for row in rows]
    return found


def _index(value: Any) -> int:
    """A whole number, as numpy's or another host's integers are too."""
    found = int(value)
    if found != value:
        raise ValueError(f"{value} is no index")
    return found
