"""One problem of many as values, and its result folder.

The values are the job, its result, and the events until it ends. A result is planned in a hidden folder next
to its result folder. When it is complete, it is moved there by a rename.
"""

import contextlib
import dataclasses
import hashlib
import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path, PurePosixPath
from typing import Any, Literal, get_args

from planner.files import (
    RESULT_ENTRIES,
    deferred_sigint,
    is_disk_full,
    is_file,
    staging,
    versions,
    write_atomic,
)
from planner.issue_codes import format_message
from planner.issues import Issue, TandemError, issue_error
from planner.runtime.version import __version__

JobState = Literal[
    "verified", "done", "infeasible", "bad_input", "unproven", "crashed", "timeout", "memory", "cancelled"
]
JOB_STATES: tuple[JobState, ...] = get_args(JobState)
"""Final states of a job. ``done``: an element is divided, or the report on it is written."""
Reports = Literal["all", "failed"]
"""Which jobs get report and replay: all, or those that are not verified."""
PROBLEM_FILE = "problem.yaml"
"""The problem file among a job's files."""
ELEMENT_FILE = "element.yaml"
"""The file of a building element that the job divides, instead of a problem file.

Files that it names are next to it.
"""
PLANNED_FILE = "planned.json"
"""File of a job that reports on an element, instead of a problem file.

It lists the results of the panels as plain data. Next to it are the element's folder ``element/`` and the
result folders ``run/ID`` of the panels.
"""
REFERENCE_FOLDER = "like"
"""Folder, among a job's files, of the result with the reference plan."""
MAX_NAME_LENGTH = 100
"""Maximum number of characters of a job's name."""


@dataclasses.dataclass(frozen=True)
class BatchJob:
    """A self-contained problem, or an element to divide or to report on.

    Attributes:
        name: A safe folder name.
        files: The problem by relative names, as :func:`planner.reading.problem.bundle` makes it.
        timeout_s: Maximum planning time [s], None for no limit.
        memory_mb: Maximum memory of its worker [MB], None for no limit.
        origins: The user's name of a file, by its name in ``files``. Issues use it. Files without one keep
            their name.
        reports: Which jobs get report and replay.

    Raises:
        ValueError: A name is unsafe, a limit is not positive, or the problem file is missing.
    """

    name: str
    files: Mapping[str, bytes]
    timeout_s: float | None = None
    memory_mb: float | None = None
    origins: Mapping[str, str] = dataclasses.field(default_factory=dict)
    reports: Reports = "all"

    def __post_init__(self) -> None:
        if not is_safe_name(self.name):
            raise ValueError(f"{self.name!r} is not a safe folder name; see planner.batch.job.is_safe_name")
        if not self.files.keys() & {PROBLEM_FILE, ELEMENT_FILE, PLANNED_FILE}:
            raise ValueError(f"job {self.name}: its files lack {PROBLEM_FILE}")
        for file in self.files:
            path = PurePosixPath(file)
            if path.is_absolute() or ".." in path.parts or "\0" in file or str(path) != file:
                raise ValueError(f"job {self.name}: {file!r} is not a relative file name")
        for limit in (self.timeout_s, self.memory_mb):
            if limit is not None and not limit > 0.0:
                raise ValueError(f"job {self.name}: a limit is {limit!r}; give a number above 0, or None")

    def identity(self, versions: Mapping[str, str]) -> str:
        """Return the SHA-256 of the files and of the versions that plan them.

        Equal jobs have equal results.
        """
        lines = [f"{name} {hashlib.sha256(self.files[name]).hexdigest()}" for name in sorted(self.files)]
        lines += [f"{name} {versions[name]}" for name in sorted(versions)]
        return hashlib.sha256("\n".join(lines).encode()).hexdigest()


@dataclasses.dataclass(frozen=True)
class JobOrder:
    """Order to plan a job whose files are written.

    Attributes:
        name: Name of the job.
        source: Folder with the files of the job.
        result: Result folder.
        origins: As in :class:`BatchJob`.
        reports: As in :class:`BatchJob`.
    """

    name: str
    source: Path
    result: Path
    origins: Mapping[str, str] = dataclasses.field(default_factory=dict)
    reports: Reports = "all"


@dataclasses.dataclass(frozen=True)
class JobResult:
    """Result of a job.

    Attributes:
        name: Name of the job.
        state: Final state.
        issues: Issues.
        metrics: Numeric values by name, which ends with the unit (``cycle_s``).
        seconds: Planning time [s].
    """

    name: str
    state: JobState
    issues: tuple[Issue, ...] = ()
    metrics: Mapping[str, float] = dataclasses.field(default_factory=dict)
    seconds: float = 0.0

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        return {
            "name": self.name,
            "state": self.state,
            "issues": [issue.to_dict() for issue in self.issues],
            "metrics": dict(self.metrics),
            "seconds": self.seconds,
        }

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> "JobResult":
        """Convert the data of :meth:`to_dict` back to a result.

        Raises:
            KeyError, TypeError, ValueError: The data are of another form.
        """
        if data["state"] not in JOB_STATES:
            raise ValueError(f"state: got {data['state']!r}, allowed {', '.join(JOB_STATES)}")
        issues = tuple(Issue.from_dict(issue) for issue in data["issues"])
        metrics = {str(name): float(value) for name, value in data["metrics"].items()}
        return JobResult(str(data["name"]), data["state"], issues, metrics, float(data["seconds"]))


@dataclasses.dataclass(frozen=True)
class JobProgress:
    """Progress of a job.

    Attributes:
        name: Name of the job.
        stage: Present stage.
        fraction: Completed fraction of the stage, in 0..1.
    """

    name: str
    stage: str
    fraction: float


@dataclasses.dataclass(frozen=True)
class JobIssues:
    """Issues of a running job. :class:`JobResult` repeats them.

    Attributes:
        name: Name of the job.
        issues: The issues.
    """

    name: str
    issues: tuple[Issue, ...]


@dataclasses.dataclass(frozen=True)
class JobFinished:
    """A job has ended, and its result folder exists if it has one.

    Attributes:
        name: Name of the job.
        done: The result.
    """

    name: str
    done: JobResult


JobEvent = JobProgress | JobIssues | JobFinished


def all_versions() -> dict[str, str]:
    """Return the versions of everything that a result depends on."""
    return {"tandem": __version__, **versions()}


def cancelled_issue(name: str) -> Issue:
    """Return the issue of a cancelled job."""
    return Issue("batch.cancelled", format_message("batch.cancelled", job=name))


def disk_full_issue() -> Issue:
    """Return the issue of a job that ended because the disk is full."""
    return Issue("output.disk_full", format_message("output.disk_full"))


def is_safe_name(name: str) -> bool:
    """Return whether a name can name a folder on any system.

    Allowed are letters, digits, ``-``, ``_`` and ``.``, without a leading dot.
    """
    has_safe_characters = all(
        character.isascii() and (character.isalnum() or character in "-_.") for character in name
    )
    return has_safe_characters and 0 < len(name) <= MAX_NAME_LENGTH and not name.startswith(".")


def make_safe_names(names: Iterable[str]) -> list[str]:
    """Return safe names similar to the given ones, all different even ignoring case: ``a``, ``a-2``, ..."""
    taken: set[str] = set()
    safe_names = []
    for name in names:
        cleaned = "".join(
            character if character.isascii() and (character.isalnum() or character in "-_.") else "-"
            for character in name
        )
        base = cleaned.strip(".-")[: MAX_NAME_LENGTH - 8] or "problem"
        unique, count = base, 1
        while unique.lower() in taken:
            count += 1
            unique = f"{base}-{count}"
        taken.add(unique.lower())
        safe_names.append(unique)
    return safe_names


@dataclasses.dataclass(frozen=True)
class JobRecord:
    """A batch's record of a job, a JSON file.

    Attributes:
        path: The file.
        more: Additional data that are written with the :class:`JobResult`.
    """

    path: Path
    more: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    def write(self, done: JobResult) -> None:
        """Write the record, completely or not at all.

        Raises:
            OSError: If the disk refuses.
        """
        write_atomic(self.path, json.dumps({**self.more, **done.to_dict()}, indent=1, allow_nan=False))

    @staticmethod
    def read(path: Path) -> tuple[JobResult, dict[str, Any]] | None:
        """Return the result and all data of a record file, or None if there is no valid record."""
        try:
            data = json.loads(path.read_text("utf-8"))
            return JobResult.from_dict(data), data
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            return None


class ResultFolder:
    """Result folder of one job and, while it is planned, the hidden folder in which it is planned."""

    def __init__(self, folder: Path, record: JobRecord | None) -> None:
        self.folder, self.record = folder, record
        self._resources = contextlib.ExitStack()
        self._staging_folder: Path | None = None

    @staticmethod
    def claim(folder: Path, record: JobRecord | None) -> "ResultFolder":
        """Return the result folder of a job, if ``folder`` is missing or contains a result.

        Args:
            folder: Result folder.
            record: Record that is written with the result, or None.

        Raises:
            TandemError: ``output.folder``, it contains something else, which a result would replace.
        """
        if os.path.lexists(folder):
            foreign_names = (
                sorted(path.name for path in folder.iterdir() if path.name not in RESULT_ENTRIES)
                if folder.is_dir()
                else []
            )
            if foreign_names or folder.is_symlink() or not folder.is_dir():
                reason = f"contains {', '.join(foreign_names[:3])}" if foreign_names else "is not a folder"
                message = f"output folder {folder}: it {reason}, which a result would replace; choose another"
                raise issue_error("output.folder", message, file=str(folder))
        return ResultFolder(folder, record)

    def prepare(self, files: Mapping[str, bytes]) -> tuple[Path, Path]:
        """Write the job's files into the hidden folder.

        Args:
            files: Content of the files, by name.

        Returns:
            Folder of the files, and folder for the result, which does not exist yet.

        Raises:
            TandemError: ``output.folder``, ``output.disk_full``.
        """
        try:
            self.folder.parent.mkdir(parents=True, exist_ok=True)
            self._staging_folder = self._resources.enter_context(staging(self.folder.parent)).resolve()
            source = self._staging_folder / "problem"
            for name, content in files.items():
                path = source / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(content)
        except OSError as error:
            self.release()
            raise TandemError(self._write_issue(error)) from error
        return source, self._staging_folder / "result"

    def publish(self, done: JobResult) -> JobResult:
        """Rename the hidden result to the result folder, and write its record.

        If the job failed without a report, a report with its issues is written first. An older result is
        replaced.

        Args:
            done: Result of the job.

        Returns:
            The result. If the disk refuses, its state is ``crashed``, with ``output.folder`` or
            ``output.disk_full`` as an additional issue.
        """
        try:
            staging_folder = self._staging_folder or self.prepare({})[1].parent
            result = staging_folder / "result"
            if done.state not in ("verified", "done") and not is_file(result / "report.html"):
                from planner.batch.results import write_failure

                write_failure(result, done.issues)
            with deferred_sigint():
                if os.path.lexists(self.folder):
                    self.folder.rename(staging_folder / "old")
                if self.record is not None:
                    self.record.write(done)
                result.rename(self.folder)
        except OSError as error:
            done = _with_write_error(done, (self._write_issue(error),))
        except TandemError as error:
            done = _with_write_error(done, error.issues)
        finally:
            self.release()
        return done

    def _write_issue(self, error: OSError) -> Issue:
        if is_disk_full(error):
            return disk_full_issue()
        message = f"output folder {self.folder}: cannot be written ({error.strerror or error})"
        return Issue(
            "output.folder",
            message,
            file=str(self.folder),
            hint="check the disk, or choose another folder, and run again",
        )

    def release(self) -> None:
        """Remove the hidden folder. :meth:`prepare` may be called again."""
        self._resources.close()
        self._staging_folder = None


def _with_write_error(done: JobResult, issues: tuple[Issue, ...]) -> JobResult:
    """Return a result as crashed, with the additional issues of writing it."""
    return dataclasses.replace(done, state="crashed", issues=(*done.issues, *issues))
