"""The store as hosts see it, on SQLite and PostgreSQL.

Leases, jobs of hosts that are gone, and hosts that were given up too early.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from sqlalchemy import Connection, update

from planner.service import audit, runner
from planner.service.jobs import DeletedJob, Jobs, NewJob, delete_job
from planner.service.models import JOBS, Database, default_url
from planner.service.runner import MAX_ATTEMPTS, JobQueue
from planner.service.security import ServiceLimits
from planner.service.storage import Blob, ContentStore
from tests.service import postgres
from tests.service.support import FakeTeam


@pytest.fixture(params=["sqlite", "postgresql"])
def database(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Database]:
    url = default_url(tmp_path) if request.param == "sqlite" else postgres.fresh(tmp_path)
    made = Database(url)
    yield made
    made.close()


def new(key: str, owner: str = "ann") -> NewJob:
    return NewJob(
        owner, "p", "0" * 64, key, ("targets",), {"problem/problem.yaml": Blob("0" * 64, 1)}, 9.0, 9.0
    )


def make_jobs(database: Database) -> Jobs:
    return Jobs(database, ServiceLimits())


def expire_leases(database: Database) -> None:
    """Expire all leases, as if nobody had renewed them in time."""
    with database.write() as db:
        db.execute(update(JOBS).values(lease=database.clock() - 1.0))


@pytest.mark.parametrize("years", [10, -10])
def test_a_clock_that_jumps_makes_no_job_old(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, years: int
) -> None:
    """Jobs are kept for 30 days.

    No older jobs are searched for a day after the jump, nor before the clock was seen to run correctly.
    """
    database, boot, clock = Database(default_url(tmp_path)), [0.0], [1.7e9]
    monkeypatch.setattr(time, "clock_gettime", lambda which: boot[0])
    monkeypatch.setattr(time, "time", lambda: clock[0])
    monkeypatch.setattr(runner, "SWEEP_INTERVAL_S", -1.0)
    forgot: list[float] = []
    work = JobQueue(database, "host", 30.0)
    monkeypatch.setattr(work, "delete_old", lambda *ages: forgot.append(boot[0]))
    runs = runner.JobRunner(
        work,
        ContentStore(tmp_path / "files"),
        runner.WorkerSetup(FakeTeam, 1, tmp_path),
        runner.RetentionPolicy(keep_s=30 * 86400.0, audit_s=None, used_shas=lambda some: set(some)),
        alone=True,
    )

    def advance(seconds: float, jump: float = 0.0) -> None:
        boot[0] += seconds
        clock[0] += seconds + jump
        runs._run_cycle(team)

    team = FakeTeam()
    for seconds in (0.0, 600.0, 600.0):
        advance(seconds)
    assert forgot == [600.0, 1200.0]
    advance(600.0, years * 3.2e7)
    for _ in range(142):
        advance(600.0)
    assert forgot == [600.0, 1200.0]
    advance(1200.0)
    assert len(forgot) == 3
    database.close()


def test_a_job_is_claimed_once(database: Database) -> None:
    jobs = make_jobs(database)
    made = {jobs.create(new(f"key{i}")).id for i in range(20)}
    claimed: list[str] = []

    def claim(host: str) -> None:
        work = JobQueue(database, host, 30.0)
        while (result := work.claim()) is not None:
            claimed.append(result.id)

    threads = [threading.Thread(target=claim, args=(f"host{i}",)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(claimed) == sorted(made)


def test_owners_take_turns(database: Database) -> None:
    jobs, work = make_jobs(database), JobQueue(database, "host", 30.0)
    greedy = [jobs.create(new(f"a{i}")).id for i in range(3)]
    other = jobs.create(new("b", "bob")).id
    order = [claimed.id for _ in range(4) if (claimed := work.claim()) is not None]
    assert order == [greedy[0], other, *greedy[1:]]


def test_jobs_of_a_host_that_is_gone_are_taken_over(database: Database) -> None:
    jobs = make_jobs(database)
    job = jobs.create(new("key")).id
    gone, surviving = JobQueue(database, "gone", 30.0), JobQueue(database, "here", 30.0)
    old = gone.claim()
    assert old is not None
    assert surviving.requeue_orphans() == 0
    assert surviving.claim() is None
    expire_leases(database)
    assert surviving.requeue_orphans() == 1
    again = surviving.claim()
    assert again is not None
    assert (again.id, again.attempt) == (job, 2)
    # the host comes back after all: nothing that it says counts
    gone.record_progress(old, "motion", 0.5)
    assert not gone.finish(old, "infeasible", (), {}, 1.0, {})
    assert jobs.get(job)[1].state == "running"
    assert surviving.finish(again, "verified", (), {"cycle_s": 2.0}, 1.0, {"report.html": Blob("1" * 64, 5)})
    response = jobs.get(job)[1]
    assert (response.state, response.attempts, response.metrics) == ("verified", 2, {"cycle_s": 2.0})
    assert set(jobs.files(job)) == {"problem/problem.yaml", "report.html"}


def test_a_lease_that_is_renewed_is_kept(database: Database) -> None:
    make_jobs(database).create(new("key"))
    busy, other = JobQueue(database, "busy", 30.0), JobQueue(database, "other", 30.0)
    assert busy.claim() is not None
    expire_leases(database)
    busy.renew()
    assert other.requeue_orphans() == 0
    assert JobQueue(database, "third", 30.0).claim() is None
    expire_leases(database)
    assert other.requeue_orphans() == 1


def test_a_job_that_takes_the_service_down_is_given_up(database: Database) -> None:
    jobs = make_jobs(database)
    job = jobs.create(new("key")).id
    for number in range(MAX_ATTEMPTS):
        assert JobQueue(database, f"host{number}", 0.0).claim() is not None
        assert JobQueue(database, "next", 30.0).requeue_orphans(alone=True) == 1
    response = jobs.get(job)[1]
    assert response.state == "crashed"
    assert [issue.code for issue in response.issues] == ["service.gave_up"]


def test_a_job_given_back_at_a_stop_loses_no_attempt(database: Database) -> None:
    jobs = make_jobs(database)
    job = jobs.create(new("key")).id
    for _ in range(MAX_ATTEMPTS + 2):
        work = JobQueue(database, "host", 30.0)
        claimed = work.claim()
        assert claimed is not None
        work.requeue(claimed)
    assert jobs.get(job)[1].state == "queued"


def test_what_is_cancelled_or_deleted_while_its_host_goes_is_not_planned_again(database: Database) -> None:
    jobs = make_jobs(database)
    cancelled, deleted = (jobs.create(new(key)).id for key in ("a", "b"))
    gone = JobQueue(database, "gone", 0.0)
    assert gone.claim() is not None
    assert gone.claim() is not None
    jobs.cancel(cancelled, "ann")
    jobs.cancel(deleted, "ann", also_delete=True)
    surviving = JobQueue(database, "here", 30.0)
    assert surviving.requeue_orphans(alone=True) == 2
    assert surviving.claim() is None
    assert jobs.get(cancelled)[1].state == "cancelled"
    assert jobs.counts() == {"cancelled": 1}


def test_old_jobs_are_forgotten_if_asked(database: Database) -> None:
    jobs, work = make_jobs(database), JobQueue(database, "host", 30.0)
    jobs.create(new("done"))
    claimed = work.claim()
    assert claimed is not None
    work.finish(claimed, "verified", (), {}, 1.0, {})
    jobs.create(new("open"))
    work.delete_old(None)
    work.delete_old(3600.0)
    assert jobs.counts() == {"verified": 1, "queued": 1}
    time.sleep(0.02)
    work.delete_old(0.01)
    assert jobs.counts() == {"queued": 1}


def test_hosts_that_forget_at_once_write_down_a_job_once(
    database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    jobs, work = make_jobs(database), JobQueue(database, "host", 30.0)
    made = [jobs.create(new(f"key{i}")).id for i in range(3)]
    while (claimed := work.claim()) is not None:
        work.finish(claimed, "verified", (), {}, 1.0, {})
    time.sleep(0.02)
    both = threading.Barrier(1 if database.sqlite else 2)  # SQLite has one writer

    def after_both(db: Connection, job: str) -> list[DeletedJob]:
        if job == min(made):
            both.wait(20.0)  # both have seen the jobs
        return delete_job(db, job)

    monkeypatch.setattr(runner, "delete_job", after_both)
    with ThreadPoolExecutor(2) as pool:
        done = [pool.submit(JobQueue(database, f"host{i}", 30.0).delete_old, 0.01) for i in range(2)]
    assert [item.result() for item in done] == [None, None]
    assert jobs.counts() == {}
    told = audit.all_entries(database, None, ("deleted",), 99)
    assert sorted(item.job for item in told) == sorted(made)
    assert {item.by for item in told} == {audit.DELETED_BY_AGE}
