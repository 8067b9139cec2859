"""How long a job may still take: by medians of the times that like jobs took for each stage."""

import itertools
import json
import statistics
import threading
import time
from collections.abc import Sequence
from typing import Final

from pydantic import Field
from sqlalchemy import RowMapping, select

from planner.service.models import EVENTS, JOBS, Database, JobOut, Sent

LIKE: Final = 20
"""So many like jobs are looked at, those that ended last."""
KNOWN_S: Final = 30.0
"""Time [s] for which their medians are known again."""


class StageTime(Sent):
    """A stage, and what it took in the median [s]."""

    stage: str
    seconds: float


class EstimateOut(Sent):
    """What a job has taken and may still take, by ``like`` jobs; an estimate, nothing more."""

    elapsed_s: float | None = Field(None, description="since it was begun [s], once it was")
    left_s: float | None = Field(None, description="estimate [s], where there are like jobs and it has begun")
    whole_s: float | None = Field(None, description="estimate of all stages [s], where there are like jobs")
    like: int = Field(description="proven jobs of the same processes that it is estimated by")
    stages: list[StageTime] = Field([], description="in their order")


class Estimates:
    """Estimates from the jobs of one database."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._lock = threading.Lock()
        self._known: dict[tuple[str, ...], tuple[float, int, dict[str, float]]] = {}

    def of(self, job: JobOut, owners: Sequence[str], now: float) -> EstimateOut:
        """For a job, by those of these owners; ``now`` [s since 1970]."""
        like, stages = self._medians(json.dumps(job.processes), owners)
        told = [StageTime(stage=name, seconds=round(s, 3)) for name, s in stages.items()]
        whole = round(sum(stages.values()), 3) if like else None
        if job.state != "running" or job.started is None:
            return EstimateOut(elapsed_s=None, left_s=None, whole_s=whole, like=like, stages=told)
        elapsed = round(max(now - job.started.timestamp(), 0.0), 3)  # clocks may have been set back
        left = None
        if like:
            names = list(stages)
            at = names.index(job.stage) if job.stage in names else 0
            spent = max(elapsed - sum(stages[name] for name in names[:at]), 0.0)
            begun = stages[names[at]] if names else 0.0
            left = max(begun - spent, begun * (1 - job.fraction) if job.fraction else 0.0)
            left = round(left + sum(stages[name] for name in names[at + 1 :]), 3)
        return EstimateOut(elapsed_s=elapsed, left_s=left, whole_s=whole, like=like, stages=told)

    def _medians(self, processes: str, owners: Sequence[str]) -> tuple[int, dict[str, float]]:
        key = (processes, *sorted(owners))
        with self._lock:
            at, like, stages = self._known.get(key, (-KNOWN_S, 0, {}))
            if time.monotonic() - at < KNOWN_S:
                return like, stages
        like, stages = self._read(processes, owners)
        with self._lock:
            if len(self._known) > 1000:
                self._known.clear()
            self._known[key] = (time.monotonic(), like, stages)
        return like, stages

    def _read(self, processes: str, owners: Sequence[str]) -> tuple[int, dict[str, float]]:
        alike = (JOBS.c.owner.in_(owners), JOBS.c.processes == processes, JOBS.c.state == "verified")
        last = select(JOBS.c.id).where(*alike, JOBS.c.from_store == 0).order_by(JOBS.c.finished.desc())
        with self._database.read() as db:
            jobs = db.execute(last.limit(LIKE)).scalars().all()
            kinds = EVENTS.c.kind.in_(("state", "progress"))
            query = select(EVENTS).where(EVENTS.c.job.in_(jobs), kinds).order_by(EVENTS.c.job, EVENTS.c.seq)
            rows = list(db.execute(query).mappings())
        taken: dict[str, dict[str, float]] = {job: {} for job in jobs}
        for before, after in itertools.pairwise(rows):
            if before["job"] == after["job"]:
                _count(taken, before, max(after["at"] - before["at"], 0.0))
        taken = {job: one for job, one in taken.items() if one}
        order = dict.fromkeys(name for one in taken.values() for name in one)
        medians = {n: statistics.median(one.get(n, 0.0) for one in taken.values()) for n in order}
        return len(taken), {name: seconds for name, seconds in medians.items() if seconds}


def _count(taken: dict[str, dict[str, float]], event: RowMapping, seconds: float) -> None:
    """Add the time from an event to the next one to the stage that it tells; a job that is begun anew, as
    after a restart, is counted from there."""
    told, own = json.loads(str(event["data"])), taken[str(event["job"])]
    if event["kind"] == "state":
        if told.get("state") == "running":
            own.clear()
        return
    stage = str(told["stage"])
    own[stage] = own.get(stage, 0.0) + seconds
