"""A thread that plans the jobs of the store on worker processes, as many at once as there are."""

from __future__ import annotations

import logging
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final, Protocol

from sqlalchemy.exc import SQLAlchemyError

from planner.batch.job import Done, Event, Finished, Found, Job, Progress
from planner.issues import TandemError
from planner.service.files import Blob, Files
from planner.service.work import Claimed, Work

LOG: Final = logging.getLogger("planner.service")
LISTEN_S: Final = 0.2
ASK_S: Final = 0.5
"""Cancelled jobs, and jobs of other hosts, are looked for so often."""
TELL_S: Final = 0.5
"""Progress within a stage is told so often."""
SWEEP_S: Final = 600.0
AGAIN_S: Final = 2.0
"""After an error of the database or the workers it is tried again so much later."""


class Team(Protocol):
    """What plans: :class:`planner.batch.workers.Workers`, or a cluster."""

    def start(self, job: Job, folder: Path) -> None: ...

    def cancel(self, name: str) -> bool: ...

    def events(self, timeout_s: float) -> Iterator[Event]: ...

    def close(self) -> None: ...


class Runner(threading.Thread):
    """Claims jobs, hands them to a team, stores what comes back. ``shas`` tells which files are wanted."""

    def __init__(
        self,
        work: Work,
        files: Files,
        make_team: Callable[[], Team],
        count: int,
        scratch: Path,
        *,
        lease_s: float,
        alone: bool,
        keep_s: float | None,
        shas: Callable[[list[str]], set[str]],
    ) -> None:
        super().__init__(name="tandem-runner", daemon=True)
        self._work, self._files, self._make_team, self._count = work, files, make_team, count
        self._lease_s, self._alone, self._keep_s, self._shas = lease_s, alone, keep_s, shas
        self._scratch = scratch
        self._ending = threading.Event()
        self._claimed: dict[str, Claimed] = {}
        self._told: dict[str, tuple[str, float]] = {}
        self._folders: dict[str, Path] = {}
        self._due: dict[str, float] = {}
        self.alive_at = time.monotonic()

    @property
    def healthy(self) -> bool:
        """Whether it has come round lately."""
        return self.is_alive() and time.monotonic() - self.alive_at < max(30.0, self._lease_s)

    def stop(self) -> None:
        """End the team; jobs that run wait again."""
        self._ending.set()
        if self.is_alive():
            self.join(30.0)

    def run(self) -> None:
        """Until :meth:`stop`; the team belongs to this thread."""
        team: Team | None = None
        while not self._ending.is_set():
            try:
                team = team or self._make_team()
                self._round(team)
            except (SQLAlchemyError, TandemError, OSError):
                LOG.exception("the runner tries again in %g s", AGAIN_S)
                self._ending.wait(AGAIN_S)
        if team is not None:
            team.close()
        for claimed in self._claimed.values():
            try:
                self._work.give_back(claimed)
            except SQLAlchemyError:
                LOG.exception("job %s waits until its lease is over", claimed.id)
        for folder in self._folders.values():
            shutil.rmtree(folder, ignore_errors=True)

    def _round(self, team: Team) -> None:
        if self._is_due("lease", self._lease_s / 4):
            self._work.renew()
            if self._work.take_over(alone=self._alone):
                LOG.warning("jobs of a service that is gone wait again")
        if self._is_due("sweep", SWEEP_S):
            self._work.forget(self._keep_s)
            self._files.sweep(self._shas)
        while len(self._claimed) < self._count:
            claimed = self._work.claim()
            if claimed is None:
                break
            self._begin(team, claimed)
        if self._claimed and self._is_due("cancel", ASK_S):
            for job in self._work.cancelled():
                names = [name for name, claimed in self._claimed.items() if claimed.id == job]
                for name in names:
                    team.cancel(name)
        for event in team.events(LISTEN_S):
            self._hear(event)
        self.alive_at = time.monotonic()

    def _begin(self, team: Team, claimed: Claimed) -> None:
        name = f"{claimed.name}-{claimed.id[:12]}"
        prefix = "problem/"
        bundle = {
            file.removeprefix(prefix): self._files.read(blob.sha)
            for file, blob in claimed.files.items()
            if file.startswith(prefix)
        }
        folder = Path(tempfile.mkdtemp(dir=self._scratch, prefix="job-"))
        self._claimed[name], self._folders[name] = claimed, folder
        job = Job(name, bundle, timeout_s=claimed.timeout_s, memory_mb=claimed.memory_mb)
        team.start(job, folder / "result")

    def _hear(self, event: Event) -> None:
        claimed = self._claimed.get(event.name)
        if claimed is None:
            return
        if isinstance(event, Progress):
            stage, at = self._told.get(event.name, ("", 0.0))
            if event.stage != stage or time.monotonic() - at >= TELL_S:
                self._told[event.name] = (event.stage, time.monotonic())
                self._work.progress(claimed, event.stage, event.fraction)
        elif isinstance(event, Found):
            self._work.found(claimed, event.issues)
        elif isinstance(event, Finished):
            self._finish(claimed, event.name, event.done)

    def _finish(self, claimed: Claimed, name: str, done: Done) -> None:
        """Store the end of a job, however long the database is away."""
        folder = self._folders[name]
        while not self._ending.is_set():
            try:
                stored = self._stored(folder / "result")
                kept = self._work.finish(claimed, done.state, done.issues, done.metrics, done.seconds, stored)
                if not kept:
                    LOG.warning("job %s was taken over; what was planned here is dropped", claimed.id)
                break
            except (SQLAlchemyError, OSError):
                LOG.exception("the end of job %s cannot be stored now", claimed.id)
                self._ending.wait(AGAIN_S)
        else:
            return  # it is planned again
        del self._claimed[name], self._folders[name]
        self._told.pop(name, None)
        shutil.rmtree(folder, ignore_errors=True)

    def _stored(self, result: Path) -> dict[str, Blob]:
        paths = sorted(path for path in result.rglob("*") if path.is_file() and not path.is_symlink())
        return {path.relative_to(result).as_posix(): self._files.put_file(path) for path in paths}

    def _is_due(self, what: str, every_s: float) -> bool:
        now = time.monotonic()
        if now < self._due.get(what, 0.0):
            return False
        self._due[what] = now + every_s
        return True
