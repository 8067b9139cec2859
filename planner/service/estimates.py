"""Estimates of the remaining time of a job: medians of the stage times of similar jobs."""

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

MAX_SIMILAR_JOBS: Final = 20
"""Maximum number of similar jobs that are evaluated, the last ones that ended."""
CACHE_S: Final = 30.0
"""Time [s] for which medians are cached."""


class StageTime(Sent):
    """A stage and its median time [s]."""

    stage: str
    seconds: float


class EstimateOut(Sent):
    """Elapsed and estimated remaining time of a job, from ``like`` similar jobs."""

    elapsed_s: float | None = Field(None, description="time since the start [s], if it has started")
    left_s: float | None = Field(None, description="estimated remaining time [s], if it has started")
    whole_s: float | None = Field(None, description="estimated time of all stages [s]")
    like: int = Field(description="number of proven jobs of the same processes; without any, no estimates")
    stages: list[StageTime] = Field([], description="stages in order")


class Estimates:
    """Estimates from the jobs of one database."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._lock = threading.Lock()
        self._known: dict[tuple[str, ...], tuple[float, int, dict[str, float]]] = {}

    def estimate(self, job: JobOut, owners: Sequence[str], now: float) -> EstimateOut:
        """Estimate the remaining time of a job from the median stage times of similar jobs.

        Stages before the present one count with their medians. The rest of the present stage is the larger of
        two estimates: its median minus the time spent in it, and its median times the fraction that is left.

        Args:
            job: Job.
            owners: Tokens whose jobs are evaluated.
            now: Present time [s since 1970].
        """
        job_count, stages = self._medians(json.dumps(job.processes), owners)
        stage_times = [StageTime(stage=name, seconds=round(seconds, 3)) for name, seconds in stages.items()]
        total = round(sum(stages.values()), 3) if job_count else None
        if job.state != "running" or job.started is None:
            return EstimateOut(elapsed_s=None, left_s=None, whole_s=total, like=job_count, stages=stage_times)
        elapsed = round(max(now - job.started.timestamp(), 0.0), 3)  # clocks may have been set back
        remaining = None
        if job_count:
            stage_names = list(stages)
            stage_index = stage_names.index(job.stage) if job.stage in stage_names else 0
            stage_elapsed = max(elapsed - sum(stages[name] for name in stage_names[:stage_index]), 0.0)
            stage_median = stages[stage_names[stage_index]] if stage_names else 0.0
            remaining = max(
                stage_median - stage_elapsed, stage_median * (1 - job.fraction) if job.fraction else 0.0
            )
            remaining = round(remaining + sum(stages[name] for name in stage_names[stage_index + 1 :]), 3)
        return EstimateOut(
            elapsed_s=elapsed, left_s=remaining, whole_s=total, like=job_count, stages=stage_times
        )

    def _medians(self, processes: str, owners: Sequence[str]) -> tuple[int, dict[str, float]]:
        """Return :meth:`_read_medians`, cached for `CACHE_S`."""
        key = (processes, *sorted(owners))
        with self._lock:
            cached_at, job_count, stages = self._known.get(key, (-CACHE_S, 0, {}))
            if time.monotonic() - cached_at < CACHE_S:
                return job_count, stages
        job_count, stages = self._read_medians(processes, owners)
        with self._lock:
            if len(self._known) > 1000:  # bounds the memory
                self._known.clear()
            self._known[key] = (time.monotonic(), job_count, stages)
        return job_count, stages

    def _read_medians(self, processes: str, owners: Sequence[str]) -> tuple[int, dict[str, float]]:
        """Compute median stage times from the stored events of similar jobs.

        Args:
            processes: Processes of the job, as the JSON text of the database.
            owners: Tokens whose jobs are evaluated.

        Returns:
            Number of jobs that were evaluated, and the median time [s] of each stage, in order.
        """
        similar = (JOBS.c.owner.in_(owners), JOBS.c.processes == processes, JOBS.c.state == "verified")
        job_query = select(JOBS.c.id).where(*similar, JOBS.c.from_store == 0).order_by(JOBS.c.finished.desc())
        with self._database.read() as db:
            jobs = db.execute(job_query.limit(MAX_SIMILAR_JOBS)).scalars().all()
            kinds = EVENTS.c.kind.in_(("state", "progress"))
            query = select(EVENTS).where(EVENTS.c.job.in_(jobs), kinds).order_by(EVENTS.c.job, EVENTS.c.seq)
            events = list(db.execute(query).mappings())
        times_by_job: dict[str, dict[str, float]] = {job: {} for job in jobs}
        for event, next_event in itertools.pairwise(events):
            if event["job"] == next_event["job"]:
                _add_stage_time(times_by_job, event, max(next_event["at"] - event["at"], 0.0))
        times_by_job = {job: stage_times for job, stage_times in times_by_job.items() if stage_times}
        order = dict.fromkeys(name for stage_times in times_by_job.values() for name in stage_times)
        medians = {
            name: statistics.median(stage_times.get(name, 0.0) for stage_times in times_by_job.values())
            for name in order
        }
        return len(times_by_job), {name: seconds for name, seconds in medians.items() if seconds}


def _add_stage_time(times_by_job: dict[str, dict[str, float]], event: RowMapping, seconds: float) -> None:
    """Add the time from an event to the next one to the stage of the event.

    If a job starts again, for instance after a restart of the service, its earlier times are dropped.
    ``times_by_job`` contains times [s] by job and stage.
    """
    event_data, stage_times = json.loads(str(event["data"])), times_by_job[str(event["job"])]
    if event["kind"] == "state":
        if event_data.get("state") == "running":
            stage_times.clear()
        return
    stage = str(event_data["stage"])
    stage_times[stage] = stage_times.get(stage, 0.0) + seconds
