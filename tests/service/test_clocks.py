"""Clocks that jump forward and back, under tokens, sessions, links, rates, leases, keys and the audit log.

A wrong clock ends nothing permanently, duplicates nothing, and hides nothing.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from sqlalchemy import select

from planner.service import audit, models
from planner.service.jobs import Jobs, NewJob
from planner.service.models import AUDIT, JOBS, Database, default_url
from planner.service.rate_limits import RateLimiter
from planner.service.runner import MAX_LEASE_S, JobQueue
from planner.service.security import Auth, RefusedError, ServiceLimits
from planner.service.storage import Blob
from tests.service.support import InProcess, named_problem

YEAR_S = 3.2e7
DAY_S = 86400.0


class Clock:
    """The machine's clock, which is set forth and back."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.ahead, now = 0.0, time.time
        monkeypatch.setattr(models.time, "time", lambda: now() + self.ahead)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    return Clock(monkeypatch)


@pytest.fixture
def running_service(tmp_path: Path) -> Iterator[InProcess]:
    with InProcess(tmp_path / "data", examiners=1) as made:
        yield made


def good(auth: Auth, token: str) -> bool:
    try:
        return auth.authenticate_token(token).name == "ann"
    except RefusedError as error:
        assert error.status == 401
        return False


def test_a_token_is_over_behind_its_end_and_a_wrong_clock_ends_none_for_good(
    tmp_path: Path, clock: Clock
) -> None:
    database = Database(default_url(tmp_path))
    auth = Auth(database)
    token = auth.create_token("ann", lifetime_s=30 * DAY_S)
    cookie, _ = auth.open_session(auth.authenticate_token(token))
    for ahead, expected in ((0.0, True), (31 * DAY_S, False), (YEAR_S, False), (0.0, True), (-YEAR_S, True)):
        clock.ahead = ahead
        assert good(auth, token) == expected
        if expected:
            assert auth.authenticate_session(cookie).name == "ann"
        else:
            with pytest.raises(RefusedError):
                auth.authenticate_session(cookie)
    auth.revoke("ann")
    for clock.ahead in (-YEAR_S, 0.0, YEAR_S):  # what is revoked is so at any time
        assert not good(auth, token)
    database.close()


def test_a_token_that_was_made_by_a_clock_that_was_ahead_ends_by_that_clock(
    tmp_path: Path, clock: Clock
) -> None:
    database = Database(default_url(tmp_path))
    auth = Auth(database)
    clock.ahead = YEAR_S
    token = auth.create_token("ann", lifetime_s=DAY_S)
    clock.ahead = 0.0
    (one,) = auth.list()
    assert good(auth, token) and one.expires is not None
    assert one.expires - time.time() > 0.9 * YEAR_S  # `tandem token list` says so
    database.close()


def test_a_link_to_a_file_is_over_behind_its_end_by_the_clock_of_now(tmp_path: Path, clock: Clock) -> None:
    (tmp_path / "data").mkdir()
    database = Database(default_url(tmp_path / "data"))
    ann = {"Authorization": f"Bearer {Auth(database).create_token('ann')}"}
    database.close()
    with InProcess(tmp_path / "data", examiners=1) as running_service:
        job = running_service.post(named_problem("linked"), headers=ann).json()["id"]
        running_service.wait_for_end(job, headers=ann)
        asked = {"name": "report.html", "seconds": 600}
        link = running_service.http.post(f"/v1/jobs/{job}/links", params=asked, headers=ann).json()["path"]
        for ahead, expected in ((0.0, 200), (601.0, 403), (-YEAR_S, 200), (YEAR_S, 403), (0.0, 200)):
            clock.ahead = ahead
            assert running_service.http.get(link).status_code == expected, ahead


@pytest.mark.parametrize("jump", [YEAR_S, -YEAR_S])
def test_rates_count_by_no_clock_that_can_be_set(clock: Clock, jump: float) -> None:
    rates = RateLimiter(1.0)
    asked = 0
    while asked < 100:
        try:
            rates.take("somebody", "requests")
        except RefusedError:
            break
        asked += 1
    clock.ahead = jump
    assert asked < 100
    with pytest.raises(RefusedError) as error:
        rates.take("somebody", "requests")
    assert error.value.headers is not None and 0 < int(error.value.headers["Retry-After"]) < 60


@pytest.fixture
def shared_job(tmp_path: Path) -> Iterator[tuple[Database, JobQueue, JobQueue]]:
    """A job that the first of two hosts plans."""
    database = Database(default_url(tmp_path))
    files = {"problem/problem.yaml": Blob("0" * 64, 1)}
    Jobs(database, ServiceLimits()).create(NewJob("ann", "p", "0" * 64, "key", ("targets",), files, 9.0, 9.0))
    first, other = JobQueue(database, "first", 30.0), JobQueue(database, "other", 30.0)
    assert first.claim() is not None
    yield database, first, other
    database.close()


def lease(database: Database) -> float:
    with database.read() as db:
        return float(db.execute(select(JOBS.c.lease)).scalar_one() or 0.0)


def test_a_job_of_a_host_that_went_while_the_clock_was_ahead_is_taken_over(
    shared_job: tuple[Database, JobQueue, JobQueue], clock: Clock
) -> None:
    """It was held by a dead host until the day came that its lease named."""
    database, gone, other = shared_job
    clock.ahead = 10 * YEAR_S
    gone.renew()
    clock.ahead = 0.0
    assert lease(database) > time.time() + MAX_LEASE_S
    assert other.requeue_orphans() == 1
    assert other.requeue_orphans() == 0


@pytest.mark.parametrize("jump", [20.0, -20.0, -3600.0, -20 * 3600.0])
def test_a_small_step_of_the_clock_takes_no_job_from_its_host(
    shared_job: tuple[Database, JobQueue, JobQueue], clock: Clock, jump: float
) -> None:
    _, held, other = shared_job
    clock.ahead = jump
    assert other.requeue_orphans() == 0
    held.renew()
    assert other.requeue_orphans() == 0


def downloads(database: Database) -> int:
    with database.read() as db:
        return len(db.execute(select(AUDIT.c.number).where(AUDIT.c.act == "downloaded")).all())


def test_downloads_are_written_down_also_behind_a_clock_that_was_ahead(tmp_path: Path, clock: Clock) -> None:
    """One an hour of the same: what had been written by a clock that was years ahead counted as of this
    hour, for years."""
    database = Database(default_url(tmp_path))
    expected = 0
    for ahead in (0.0, YEAR_S, DAY_S, -YEAR_S):
        clock.ahead = ahead
        expected += 1
        for _ in range(3):
            audit.record_download(database, "local", "0" * 32, {"file": "programs/main.mod"})
        assert downloads(database) == expected
        clock.ahead += 7200.0
        expected += 1
        audit.record_download(database, "local", "0" * 32, {"file": "programs/main.mod"})
        assert downloads(database) == expected
    numbers = [item.number for item in audit.all_entries(database, None, (), 100)]
    assert numbers == sorted(numbers, reverse=True)
    database.close()


def test_a_key_of_a_request_is_known_again_whatever_the_clock_says(
    running_service: InProcess, clock: Clock
) -> None:
    header = {"Idempotency-Key": "press-7"}
    first = running_service.post(named_problem("keyed"), headers=header).json()["id"]
    for clock.ahead in (YEAR_S, -YEAR_S, 0.0):
        assert running_service.post(named_problem("keyed"), headers=header).json()["id"] == first
