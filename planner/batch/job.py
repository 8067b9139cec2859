"""One problem of many as values, and where its result goes.

What is to be planned, what came out, what is heard of it meanwhile. A result is planned in a hidden
folder beside its own, which is renamed when it is whole.
"""

import contextlib
import dataclasses
import hashlib
import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path, PurePosixPath
from typing import Any, Literal, get_args

from planner.files import RESULT, deferred_sigint, is_disk_full, is_file, staging, versions, write_whole
from planner.issues import Issue, TandemError, refusal
from planner.runtime.version import __version__

State = Literal[
    "verified", "done", "infeasible", "bad_input", "unproven", "crashed", "timeout", "memory", "cancelled"
]
STATES: tuple[State, ...] = get_args(State)
"""How a job may end; ``done``: an element is divided, or the report on it written."""
Reports = Literal["all", "failed"]
"""Which jobs get report and replay: all, or those that are not verified."""
PROBLEM = "problem.yaml"
"""The problem file among a job's files."""
ELEMENT = "element.yaml"
"""In its place, the file of a building element that the job divides; what it names stands beside it."""
PLANNED = "planned.json"
"""In its place, how the panels of an element ended, as a list of plain data, where the job reports on it. The
element's folder is ``element/`` there; results of panels are in ``run/``, under their ids."""
LIKE = "like"
"""The folder, among a job's files, of the result that it is planned like."""
MAX_NAME = 100
"""Characters that the name of a job may have."""


@dataclasses.dataclass(frozen=True)
class Job:
    """A problem that stands alone; or an element to divide, or one to report on.

    ``name`` is a safe folder name. ``files``: the problem by relative names, as
    :func:`planner.reading.problem.bundle` makes it. A job is stopped after ``timeout_s`` [s] of planning, and
    when its worker holds more than ``memory_mb`` [MB]; None is no limit. ``origins``: what people call a
    file, by its name in ``files``; issues name files so, and by their names in ``files`` where nothing is
    given. ``reports``: whether it gets a report and a replay where it is verified.

    Raises ``ValueError`` for names that are not safe and where the problem file is missing.
    """

    name: str
    files: Mapping[str, bytes]
    timeout_s: float | None = None
    memory_mb: float | None = None
    origins: Mapping[str, str] = dataclasses.field(default_factory=dict)
    reports: Reports = "all"

    def __post_init__(self) -> None:
        if not safe_name(self.name):
            raise ValueError(f"{self.name!r} is no safe folder name; see planner.batch.job.safe_name")
        if not self.files.keys() & {PROBLEM, ELEMENT, PLANNED}:
            raise ValueError(f"job {self.name}: its files lack {PROBLEM}")
        for file in self.files:
            path = PurePosixPath(file)
            if path.is_absolute() or ".." in path.parts or "\0" in file or str(path) != file:
                raise ValueError(f"job {self.name}: {file!r} is no relative name of a file")
        for limit in (self.timeout_s, self.memory_mb):
            if limit is not None and not limit > 0.0:
                raise ValueError(f"job {self.name}: a limit is {limit!r}; give a number above 0, or None")

    def identity(self, versions: Mapping[str, str]) -> str:
        """SHA-256 of the files and of the versions that plan them: equal jobs have equal results."""
        rows = [f"{name} {hashlib.sha256(self.files[name]).hexdigest()}" for name in sorted(self.files)]
        rows += [f"{name} {versions[name]}" for name in sorted(versions)]
        return hashlib.sha256("\n".join(rows).encode()).hexdigest()


@dataclasses.dataclass(frozen=True)
class Done:
    """How a job ended. ``metrics``: figures by name, their unit last in it (``cycle_s``); ``seconds`` [s] of
    planning."""

    name: str
    state: State
    issues: tuple[Issue, ...] = ()
    metrics: Mapping[str, float] = dataclasses.field(default_factory=dict)
    seconds: float = 0.0

    def to_dict(self) -> dict[str, Any]:
        """As plain data for JSON."""
        return {
            "name": self.name,
            "state": self.state,
            "issues": [issue.to_dict() for issue in self.issues],
            "metrics": dict(self.metrics),
            "seconds": self.seconds,
        }

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> "Done":
        """The inverse of :meth:`to_dict`; raises ``KeyError``, ``TypeError`` or ``ValueError`` for other
        data."""
        if data["state"] not in STATES:
            raise ValueError(f"state {data['state']!r} is not known; there are {', '.join(STATES)}")
        issues = tuple(Issue.from_dict(issue) for issue in data["issues"])
        metrics = {str(name): float(value) for name, value in data["metrics"].items()}
        return Done(str(data["name"]), data["state"], issues, metrics, float(data["seconds"]))


@dataclasses.dataclass(frozen=True)
class Progress:
    """A job has come so far: ``fraction`` in 0..1 of ``stage``."""

    name: str
    stage: str
    fraction: float


@dataclasses.dataclass(frozen=True)
class Found:
    """Issues of a job that is under way; :class:`Done` has them all again."""

    name: str
    issues: tuple[Issue, ...]


@dataclasses.dataclass(frozen=True)
class Finished:
    """A job has ended, and its result folder is there if it has one."""

    name: str
    done: Done


Event = Progress | Found | Finished


def all_versions() -> dict[str, str]:
    """Versions of all that a result depends on."""
    return {"tandem": __version__, **versions()}


def cancelled(name: str) -> Issue:
    """Of a job that was told to end."""
    return Issue("batch.cancelled", f"{name}: planning was cancelled; start it again if wanted")


def disk_full() -> Issue:
    """Of a job that ended because of it."""
    what = "the disk that results are written to is full, so nothing was; make room on it and plan again"
    return Issue("output.disk_full", what)


def safe_name(name: str) -> bool:
    """Whether a name may name a folder anywhere: letters, digits, ``-``, ``_`` and ``.``, no dot first."""
    plain = all(c.isascii() and (c.isalnum() or c in "-_.") for c in name)
    return plain and 0 < len(name) <= MAX_NAME and not name.startswith(".")


def safe_names(wanted: Iterable[str]) -> list[str]:
    """Safe names, all different even where case does not count, near the wanted ones: ``a``, ``a-2``, ..."""
    taken: set[str] = set()
    out = []
    for name in wanted:
        plain = "".join(c if c.isascii() and (c.isalnum() or c in "-_.") else "-" for c in name)
        base = plain.strip(".-")[: MAX_NAME - 8] or "problem"
        chosen, count = base, 1
        while chosen.lower() in taken:
            count += 1
            chosen = f"{base}-{count}"
        taken.add(chosen.lower())
        out.append(chosen)
    return out


@dataclasses.dataclass(frozen=True)
class Record:
    """What a batch remembers of a job, as JSON in the file ``path``: its :class:`Done`, and ``more``."""

    path: Path
    more: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    def write(self, done: Done) -> None:
        """Write it, whole or not at all; raises ``OSError``."""
        write_whole(self.path, json.dumps({**self.more, **done.to_dict()}, indent=1, allow_nan=False))

    @staticmethod
    def read(path: Path) -> tuple[Done, dict[str, Any]] | None:
        """The record in a file and all that it says; None where there is none, or it is no record."""
        try:
            data = json.loads(path.read_text("utf-8"))
            return Done.from_dict(data), data
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            return None


class Place:
    """The result folder of one job and, while it is planned, the hidden folder that it is planned in."""

    def __init__(self, folder: Path, record: Record | None) -> None:
        self.folder, self.record = folder, record
        self._open = contextlib.ExitStack()
        self._hidden: Path | None = None

    @staticmethod
    def claim(folder: Path, record: Record | None) -> "Place":
        """The place, if ``folder`` can be one: missing, or a result. Raises ``TandemError``
        (``output.folder``)."""
        if os.path.lexists(folder):
            foreign = (
                sorted(p.name for p in folder.iterdir() if p.name not in RESULT) if folder.is_dir() else []
            )
            if foreign or folder.is_symlink() or not folder.is_dir():
                got = f"holds {', '.join(foreign[:3])}" if foreign else "is no folder"
                what = f"output folder {folder}: it {got}, and a result would replace it; choose another"
                raise refusal("output.folder", what, file=str(folder))
        return Place(folder, record)

    def prepare(self, files: Mapping[str, bytes]) -> tuple[Path, Path]:
        """Write the job's files; where they lie, and where its result is to be written. Raises
        ``TandemError`` (``output.folder``, ``output.disk_full``)."""
        try:
            self.folder.parent.mkdir(parents=True, exist_ok=True)
            self._hidden = self._open.enter_context(staging(self.folder.parent)).resolve()
            source = self._hidden / "problem"
            for name, content in files.items():
                path = source / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(content)
        except OSError as error:
            self.leave()
            raise TandemError(self._refusal(error)) from error
        return source, self._hidden / "result"

    def publish(self, done: Done) -> Done:
        """Let the result appear under its name, with its record; a job that wrote none gets the report alone.

        What is given back has ``output.folder`` or ``output.disk_full`` as one more issue where the disk
        refuses.
        """
        try:
            hidden = self._hidden or self.prepare({})[1].parent
            result = hidden / "result"
            if done.state not in ("verified", "done") and not is_file(result / "report.html"):
                from planner.batch.results import write_failure

                write_failure(result, done.issues)
            with deferred_sigint():
                if os.path.lexists(self.folder):
                    self.folder.rename(hidden / "old")
                if self.record is not None:
                    self.record.write(done)
                result.rename(self.folder)
        except OSError as error:
            done = _also(done, (self._refusal(error),))
        except TandemError as error:
            done = _also(done, error.issues)
        finally:
            self.leave()
        return done

    def _refusal(self, error: OSError) -> Issue:
        if is_disk_full(error):
            return disk_full()
        what = f"output folder {self.folder}: cannot be written ({error.strerror or error})"
        return Issue(
            "output.folder",
            what,
            file=str(self.folder),
            hint="see to the disk, or choose another folder, and run again",
        )

    def leave(self) -> None:
        """Remove the hidden folder; the place can be prepared anew."""
        self._open.close()
        self._hidden = None


def _also(done: Done, issues: tuple[Issue, ...]) -> Done:
    """An end whose result could not be written."""
    return dataclasses.replace(done, state="crashed", issues=(*done.issues, *issues))
