"""What a worker of a Dask cluster does: it plans on a process of its own, as on one machine.

So a crash, a time-out or too much memory fails a job alone here too, and Dask hears of a worker's
end only where the worker itself has gone. Nothing of the planner is imported into the Dask worker.
"""

from __future__ import annotations

import dataclasses
import json
import tempfile
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from distributed import get_worker

from planner.batch.job import Event, Finished, Found, Job, Progress, all_versions
from planner.batch.workers import Workers

PROGRESS_EVERY_S: Final = 0.5
"""Progress within a stage is published so often."""
NANNYS: Final = ("MALLOC_TRIM_THRESHOLD_",)
"""Dask's nanny sets it for its workers, so that what they free is given back at once. A planner asks for the
same memory again all the time, and would take 1.4 times as long."""
_cancelled: set[str] = set()
_mine = threading.local()


def plan(
    token: str, topic: str, files: Mapping[str, bytes], more: Mapping[str, Any], versions: Mapping[str, str]
) -> dict[str, Any]:
    """Plan one job; ``more`` are its other fields and the ``module`` of its worker, ``token`` names it in
    this cluster, and what is heard of it goes to ``topic``.

    Gives ``done`` (plain data) and ``files`` (the result folder's, by name), or ``versions`` where this
    worker's are not those asked for.
    """
    own = all_versions()
    if own != dict(versions):
        return {"versions": own, "worker": get_worker().address}
    job = Job(more["name"], files, more["timeout_s"], more["memory_mb"], more["origins"])
    with tempfile.TemporaryDirectory(prefix="tandem-") as folder:
        result = Path(folder) / "result"
        done = _finished(token, topic, job, result, more["module"])
        kept = {p.relative_to(result).as_posix(): p.read_bytes() for p in _all(result)}
        return {"done": done.done.to_dict(), "files": kept}


def cancel(token: str) -> None:
    """End a job, if it is planned here."""
    _cancelled.add(token)


def _finished(token: str, topic: str, job: Job, result: Path, module: str) -> Finished:
    team = _team(module)
    team.start(job, result)
    published: tuple[str, float] = ("", 0.0)
    try:
        while True:
            for event in team.events(0.2):
                if isinstance(event, Finished):
                    return event
                if isinstance(event, Progress):
                    if event.stage == published[0] and time.monotonic() - published[1] < PROGRESS_EVERY_S:
                        continue
                    published = event.stage, time.monotonic()
                _publish(topic, event)
            if token in _cancelled:
                team.cancel(job.name)
    except BaseException:
        _drop_team()  # what it still does belongs to no later job
        raise
    finally:
        _cancelled.discard(token)


def _team(module: str) -> Workers:
    """The planning process of this thread, which keeps its Drake models from job to job."""
    if getattr(_mine, "module", None) != module:
        _drop_team()
        _mine.team, _mine.module = Workers(1, module=module, reports=False, unset=NANNYS), module
    team: Workers = _mine.team
    return team


def _drop_team() -> None:
    if hasattr(_mine, "team"):
        _mine.team.close()
    _mine.__dict__.clear()


def _publish(topic: str, event: Event) -> None:
    """Send an event to who asked for the job, as JSON: Dask takes no more than the plainest data."""
    if isinstance(event, Progress):
        get_worker().log_event(topic, json.dumps({"progress": dataclasses.astuple(event)}))
    elif isinstance(event, Found):
        issues = [issue.to_dict() for issue in event.issues]
        get_worker().log_event(topic, json.dumps({"found": [event.name, issues]}))


def _all(folder: Path) -> list[Path]:
    return sorted(p for p in folder.rglob("*") if p.is_file())
