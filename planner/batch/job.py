"""One problem of many as values: what is to be planned, what came out, what is heard of it meanwhile."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Iterable, Mapping
from pathlib import PurePosixPath
from typing import Any, Literal, get_args

import planner
from planner.issues import Issue
from planner.versions import versions

State = Literal[
    "verified", "infeasible", "bad_input", "unproven", "crashed", "timeout", "memory", "cancelled"
]
STATES: tuple[State, ...] = get_args(State)
PROBLEM = "problem.yaml"
"""The problem file among a job's files."""
MAX_NAME = 100


@dataclasses.dataclass(frozen=True)
class Job:
    """A problem that stands alone.

    ``name`` is a safe folder name. ``files``: the problem by relative names, as
    :func:`planner.problem_bundle.bundle` makes it. A job is stopped after ``timeout_s`` [s] of planning, and
    when its worker holds more than ``memory_mb`` [MB]; None is no limit. ``origins``: what people call a
    file, by its name in ``files``; issues name files so, and by their names in ``files`` where nothing is
    given.

    Raises ``ValueError`` for names that are not safe and where the problem file is missing.
    """

    name: str
    files: Mapping[str, bytes]
    timeout_s: float | None = None
    memory_mb: float | None = None
    origins: Mapping[str, str] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        if not safe_name(self.name):
            raise ValueError(f"{self.name!r} is no safe folder name; see planner.batch.job.safe_name")
        if PROBLEM not in self.files:
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
    def from_dict(data: Mapping[str, Any]) -> Done:
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
    return {"tandem": planner.__version__, **versions()}


def cancelled(name: str) -> Issue:
    """Of a job that was told to end."""
    return Issue("batch.cancelled", f"{name}: planning was cancelled; start it again if wanted")


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
