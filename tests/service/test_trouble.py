"""A full disk and an unavailable database: what is reported, what waits, and what continues afterwards."""

from __future__ import annotations

import errno
import shutil
import sqlite3
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import select, text
from sqlalchemy.exc import OperationalError

from planner.batch import solve
from planner.batch.job import BatchJob, JobEvent, JobFinished, JobOrder, JobResult, ResultFolder
from planner.issues import Issue, TandemError
from planner.service import runner, storage
from planner.service.models import JOBS, Database
from planner.service.security import ServiceLimits
from tests.service.support import InProcess, issue_codes, named_problem, wait_until

FULL = Issue("output.disk_full", "full")


@pytest.fixture
def running_service(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[InProcess]:
    monkeypatch.setattr(runner, "RETRY_WAIT_S", 0.05)
    monkeypatch.setattr(runner, "DISK_FULL_PAUSE_S", 0.05)
    with InProcess(tmp_path / "data", ServiceLimits(check_s=60), examiners=1, lease_s=0.4) as made:
        yield made


def fail_database(error: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    @contextmanager
    def fail(self: Database) -> Iterator[Any]:
        raise error
        yield

    for name in ("read", "write"):
        monkeypatch.setattr(Database, name, fail)


def free(monkeypatch: pytest.MonkeyPatch, count: float) -> None:
    usage = shutil.disk_usage("/")
    monkeypatch.setattr(storage.shutil, "disk_usage", lambda root: usage._replace(free=int(count)))


def test_tables_of_a_newer_version_end_the_work_of_an_older_host(
    running_service: InProcess, caplog: pytest.LogCaptureFixture
) -> None:
    """As another host leaves them that was updated while this one runs."""
    running_service.team.hold.set()
    job = running_service.post(named_problem("older")).json()["id"]
    wait_until(lambda: running_service.http.get(f"/v1/jobs/{job}").json()["state"] == "running")
    with ThreadPoolExecutor(1) as pool:
        stream = pool.submit(running_service.http.get, f"/v1/jobs/{job}/events")
        wait_until(lambda: bool(running_service.service.hub._of_owner))
        with running_service.service.database.write() as db:
            db.execute(text("UPDATE tandem_schema SET version = version + 1"))
        wait_until(lambda: not running_service.service.runner.is_alive(), 30.0)
        assert "event: end" not in stream.result(30.0).text
    for answer in (
        running_service.http.get("/v1/jobs"),
        running_service.post(named_problem("late")),
        running_service.http.get("/v1/ready"),
        running_service.http.get("/"),
    ):
        assert (answer.status_code, answer.headers["retry-after"]) in ((503, "60"), (503, "5"))
        assert issue_codes(answer) == [("service.database", None)]
        assert "Update tandem-planner on this host" in answer.text
    assert running_service.http.get("/v1/health").status_code == 503
    assert "This host stops accepting requests and jobs" in caplog.text
    running_service.team.hold.clear()
    with running_service.service.database.read() as db:  # another host takes it over when its lease is over
        assert db.execute(select(JOBS.c.state, JOBS.c.attempts)).one() == ("running", 1)


def test_while_the_database_is_away_requests_are_503_and_the_process_is_well(
    running_service: InProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert running_service.http.get("/v1/ready").json() == {"ready": True, "issues": []}
    fail_database(OperationalError("SELECT", {}, sqlite3.OperationalError("gone")), monkeypatch)
    for answer in (
        running_service.http.get("/v1/jobs"),
        running_service.post(named_problem("away")),
        running_service.http.get("/v1/ready"),
    ):
        assert answer.status_code == 503
        assert answer.headers["retry-after"] == "5"
        assert issue_codes(answer) == [("service.database", None)]
        assert "SELECT" not in answer.text
    health = running_service.http.get("/v1/health")
    assert health.status_code == 200
    assert health.json()["status"] == "degraded"
    assert "queued" not in health.json()
    wait_until(lambda: not running_service.service.runner.working)
    assert running_service.service.runner.healthy
    monkeypatch.undo()
    wait_until(lambda: running_service.http.get("/v1/ready").status_code == 200)
    assert (
        running_service.wait_for_end(running_service.post(named_problem("back")).json()["id"])["state"]
        == "verified"
    )


def test_a_fault_of_ours_in_the_database_is_still_500(
    running_service: InProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    from sqlalchemy.exc import ProgrammingError

    fail_database(ProgrammingError("SELEC", {}, sqlite3.ProgrammingError("wrong")), monkeypatch)
    answer = running_service.http.get("/v1/jobs")
    assert (answer.status_code, issue_codes(answer)) == (500, [("internal.error", None)])


def test_a_full_disk_is_507_for_what_is_stored_already_too(
    running_service: InProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = named_problem("stored")
    assert running_service.post(problem).status_code == 201
    free(monkeypatch, 1e6)
    for path in ("/v1/jobs", "/v1/check"):
        answer = running_service.post(problem, path=path)
        assert (answer.status_code, issue_codes(answer)) == (507, [("service.storage", "files")])
    ready = running_service.http.get("/v1/ready")
    assert (ready.status_code, issue_codes(ready)) == (503, [("service.storage", "files")])
    assert str(running_service.service.options.data) not in ready.text
    monkeypatch.undo()
    assert running_service.post(problem).status_code == 201


def test_a_database_whose_disk_is_full_is_507(
    running_service: InProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    full = sqlite3.OperationalError("database or disk is full")
    full.sqlite_errorcode = sqlite3.SQLITE_FULL
    error = OperationalError("INSERT", {}, full)
    monkeypatch.setattr(running_service.service.jobs, "create", lambda *asked: (_ for _ in ()).throw(error))
    late = running_service.post(named_problem("late"))
    fail_database(error, monkeypatch)
    for answer in (late, running_service.http.get("/v1/jobs")):
        assert (answer.status_code, issue_codes(answer)) == (507, [("service.storage", "files")])


def test_a_job_that_finds_the_disk_full_waits_and_is_planned_when_there_is_room(
    running_service: InProcess,
) -> None:
    team, tries = running_service.team, []
    ordinary = team.events

    def events(timeout_s: float) -> Iterator[Any]:
        if len(tries) < 5 and team._open:
            (name,) = team._open
            team._open.clear()
            tries.append(name)
            yield JobFinished(name, JobResult(name, "crashed", (FULL,)))
        yield from ordinary(timeout_s)

    team.events = events  # type: ignore[method-assign]
    job = running_service.post(named_problem("roomy")).json()["id"]
    result = running_service.wait_for_end(job)
    assert len(tries) == 5
    assert (result["state"], result["attempts"]) == ("verified", 1)


def test_no_job_is_begun_without_room(running_service: InProcess, monkeypatch: pytest.MonkeyPatch) -> None:
    job = running_service.post(named_problem("later"))
    running_service.wait_for_end(job.json()["id"])
    monkeypatch.setattr(running_service.service.runner, "_has_disk_space", lambda: False)
    waits = running_service.post(named_problem("waits")).json()["id"]
    began = len(running_service.team.started)
    wait_until(lambda: running_service.service.runner.working)
    assert running_service.http.get(f"/v1/jobs/{waits}").json()["state"] == "queued"
    monkeypatch.undo()
    assert running_service.wait_for_end(waits)["state"] == "verified"
    assert len(running_service.team.started) == began + 1


def test_a_job_that_could_not_be_begun_goes_back_and_loses_no_attempt(
    running_service: InProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, failed = runner.tempfile.mkdtemp, []

    def mkdtemp(*given: Any, **options: Any) -> str:
        if options.get("prefix") == "job-" and len(failed) < 4:
            failed.append(1)
            raise OSError(errno.ENOSPC, "no space left on device", "/secret/place")
        return str(real(*given, **options))

    monkeypatch.setattr(runner.tempfile, "mkdtemp", mkdtemp)
    found = running_service.wait_for_end(running_service.post(named_problem("begun")).json()["id"])
    assert (found["state"], found["attempts"], len(failed)) == ("verified", 1, 4)


def test_jobs_of_a_cluster_that_went_away_are_planned_by_the_next_one(
    running_service: InProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, gone = running_service.team.events, []

    def events(timeout_s: float) -> Iterator[JobEvent]:
        if running_service.team._open and not gone:
            gone.append(1)
            raise TandemError(Issue("batch.cluster", "the cluster's scheduler is lost"))
        yield from real(timeout_s)

    monkeypatch.setattr(running_service.team, "events", events)
    found = running_service.wait_for_end(running_service.post(named_problem("clustered")).json()["id"])
    assert (found["state"], found["attempts"], len(gone)) == ("verified", 1, 1)


def test_no_place_of_the_server_is_told(running_service: InProcess) -> None:
    place = f"{running_service.service.scratch}/job-x/result"
    wrong = Issue("internal.error", f"{place}: odd", file=f"{place}/report.html", hint=f"see {place}")
    ordinary = running_service.team.events

    def events(timeout_s: float) -> Iterator[Any]:
        for name in list(running_service.team._open):
            running_service.team._open.clear()
            yield JobFinished(name, JobResult(name, "crashed", (wrong,)))
        yield from ordinary(timeout_s)

    running_service.team.events = events  # type: ignore[method-assign]
    found = running_service.wait_for_end(running_service.post(named_problem("placed")).json()["id"])
    assert found["state"] == "crashed"
    assert str(running_service.service.options.data) not in str(found)
    assert "the service's folder/job-x" in found["issues"][0]["message"]


@pytest.mark.parametrize("wrapped", [False, True])
def test_planning_into_a_full_disk_is_told_as_that(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, wrapped: bool
) -> None:
    def load(path: Path) -> None:
        full = OSError(errno.ENOSPC, "no space left")
        if wrapped:
            raise TandemError(Issue("output.folder", f"{path} cannot be written")) from full
        raise full

    monkeypatch.setattr(solve.pipeline, "load", load)
    done = solve.solve_job(JobOrder("a", tmp_path, tmp_path / "out"), lambda *_: None, lambda _: None)
    assert (done.state, [issue.code for issue in done.issues]) == ("crashed", ["output.disk_full"])
    assert str(tmp_path) not in done.issues[0].message


def test_a_place_on_a_full_disk_is_told_as_that(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def write(self: Path, content: bytes) -> None:
        raise OSError(errno.EDQUOT, "quota")

    monkeypatch.setattr(Path, "write_bytes", write)
    job = BatchJob("a", {"problem.yaml": b""})
    with pytest.raises(TandemError) as caught:
        ResultFolder.claim(tmp_path / "a", None).prepare(job.files)
    assert caught.value.issues[0].code == "output.disk_full"


@pytest.mark.parametrize("state", ["crashed", "timeout", "memory"])
def test_one_call_tries_again(running_service: InProcess, state: str) -> None:
    ordinary, once = running_service.team.events, [state]

    def events(timeout_s: float) -> Iterator[Any]:
        for name in list(running_service.team._open):
            if once:
                running_service.team._open.clear()
                issue = Issue("service.gave_up", "three times")
                yield JobFinished(name, JobResult(name, once.pop(), (issue,), {"cycle_s": 3.0}, 0.1))  # type: ignore[arg-type]
        yield from ordinary(timeout_s)

    running_service.team.events = events  # type: ignore[method-assign]
    job = running_service.post(named_problem(f"again_{state}")).json()["id"]
    assert running_service.wait_for_end(job)["state"] == state
    again = running_service.http.post(f"/v1/jobs/{job}/retry")
    assert again.status_code == 200
    assert again.json()["id"] == job
    assert "finished" not in again.json() or again.json()["state"] != state
    result = running_service.wait_for_end(job)
    assert (result["state"], result["attempts"], result["metrics"]) == ("verified", 1, {"cycle_s": 1.0})
    assert "service.gave_up" not in str(result["issues"])
    refused = running_service.http.post(f"/v1/jobs/{job}/retry")
    assert (refused.status_code, issue_codes(refused)) == (409, [("service.state", "state")])
    assert "state verified" in refused.text
    events_told = running_service.http.get(f"/v1/jobs/{job}/events").text
    assert events_told.rstrip().split("\n")[-2] == "event: end"


def test_a_job_that_was_cancelled_is_tried_again_and_one_that_waits_is_not(
    running_service: InProcess,
) -> None:
    running_service.team.hold.set()
    running = running_service.post(named_problem("running")).json()["id"]
    wait_until(lambda: running_service.http.get(f"/v1/jobs/{running}").json()["state"] == "running")
    job = running_service.post(named_problem("stopped")).json()["id"]
    assert running_service.http.post(f"/v1/jobs/{job}/retry").status_code == 409
    assert running_service.http.post(f"/v1/jobs/{job}/cancel").json()["state"] == "cancelled"
    assert running_service.http.post(f"/v1/jobs/{job}/retry").json()["state"] == "queued"
    running_service.team.hold.clear()
    assert running_service.wait_for_end(job)["state"] == "verified"
    assert running_service.http.post(f"/v1/jobs/{'0' * 32}/retry").status_code == 404
