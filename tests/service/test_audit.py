"""The audit log: each act with its actor, kept after jobs are deleted, shown to owners, deleted by age."""

from __future__ import annotations

import json
import sqlite3
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final

import pytest
from fastapi.testclient import TestClient
from sqlalchemy import select

from planner.cli import service as commands
from planner.issues import TandemError
from planner.service import audit, backup
from planner.service.models import AUDIT, Database
from planner.service.runner import JobQueue
from tests.service import postgres
from tests.service.support import BASE_URL, InProcess, issue_codes, named_problem
from tests.service.test_roles import Shop, bearer, open_service

DAY_S: Final = 86400.0


@pytest.fixture(scope="module")
def shop(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shop]:
    with open_service(tmp_path_factory.mktemp("audit") / "data", None) as running_service:
        yield Shop(running_service)


def acts(shop: Shop, job: str, name: str = "bob") -> list[tuple[str, str]]:
    """Return act and actor of a job's entries, oldest first."""
    result = shop.ask(name, "GET", f"/v1/audit?job={job}&limit=200")
    assert result.status_code == 200, result.text
    return [(act["act"], act["by"]) for act in reversed(result.json()["acts"])]


def life(shop: Shop, name: str) -> str:
    """A job to which all is done that is written down."""
    job = shop.job("ann", name)
    shop.ask("lea", "GET", f"/v1/jobs/{job}/programs.zip")
    shop.ask("bob", "POST", f"/v1/jobs/{job}/release", json={"note": "ja"})
    shop.ask("lea", "GET", f"/v1/jobs/{job}/files/programs/main.mod")
    shop.ask("ann", "POST", f"/v1/jobs/{job}/links?name=programs/main.mod")
    shop.ask("bob", "POST", f"/v1/jobs/{job}/withdraw", json={"reason": "nein"})
    shop.ask("ann", "DELETE", f"/v1/jobs/{job}")
    return job


LIFE: Final = [
    ("submitted", "ann"),
    ("downloaded", "lea"),
    ("released", "bob"),
    ("downloaded", "lea"),
    ("linked", "ann"),
    ("withdrew", "bob"),
    ("deleted", "ann"),
]


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_what_was_done_with_a_job_outlives_it(tmp_path: Path, kind: str) -> None:
    database = postgres.fresh(tmp_path) if kind == "postgresql" else None
    with open_service(tmp_path / "data", database) as running_service:
        shop = Shop(running_service)
        job = life(shop, "outlived")
        assert acts(shop, job) == LIFE
        told = {act["act"]: act for act in shop.ask("bob", "GET", f"/v1/audit?job={job}").json()["acts"]}
        released = told["released"]["about"]
        assert released["programs"].keys() == {"main.mod"}
        assert len(released["digest"]) == len(released["proof"]) == 64
        assert (released["note"], released["name"]) == ("ja", "outlived")
        assert told["withdrew"]["about"]["reason"] == "nein"
        assert told["withdrew"]["about"]["released_by"] == "bob"
        assert told["deleted"]["team"] == "shop"
        assert told["linked"]["about"]["file"] == "programs/main.mod"
        running_service.service.auth.revoke("ann")
        assert acts(shop, job) == LIFE
        backup.back_up(running_service.service.options.data, database, tmp_path / "backup")
        other = postgres.fresh(tmp_path) if kind == "postgresql" else None
        backup.restore(tmp_path / "backup", tmp_path / "new", other)
        with InProcess(tmp_path / "new", examiners=1, require_token=True, database=other) as new:
            shop.running_service = new
            assert acts(shop, job) == LIFE
            shop.job("bob", "goes_on")  # numbers go on, whichever database they came from


def test_only_what_happened_is_written_down(shop: Shop) -> None:
    job = shop.job("ann", "once")
    shop.ask("ann", "POST", f"/v1/jobs/{job}/cancel")  # it has ended
    shop.ask("ann", "POST", f"/v1/jobs/{job}/retry")  # and is not tried again
    shop.ask("ann", "POST", f"/v1/jobs/{job}/release", json={})  # may not
    shop.ask("eve", "DELETE", f"/v1/jobs/{job}")  # is another team's
    shop.ask("bob", "POST", f"/v1/jobs/{job}/withdraw", json={"reason": "none there"})
    shop.ask("bob", "POST", f"/v1/jobs/{job}/links?name=none")
    shop.ask("lea", "GET", f"/v1/jobs/{job}/files/report.html")  # no program
    shop.running_service.http.head(f"/v1/jobs/{job}/programs.zip", headers=bearer(shop.tokens["lea"]))
    assert acts(shop, job) == [("submitted", "ann")]
    for part in ("bytes=0-9", "bytes=10-19", "bytes=20-"):
        headers = {**bearer(shop.tokens["lea"]), "Range": part}
        assert (
            shop.running_service.http.get(f"/v1/jobs/{job}/programs.zip", headers=headers).status_code == 206
        )
    whole = shop.ask("lea", "GET", f"/v1/jobs/{job}/programs.zip")
    known = {**bearer(shop.tokens["lea"]), "If-None-Match": whole.headers["etag"]}
    assert shop.running_service.http.get(f"/v1/jobs/{job}/programs.zip", headers=known).status_code == 304
    assert acts(shop, job) == [("submitted", "ann"), ("downloaded", "lea")]
    shop.ask("bob", "POST", f"/v1/jobs/{job}/release", json={})
    shop.ask("lea", "GET", f"/v1/jobs/{job}/programs.zip")
    shop.ask("bob", "GET", f"/v1/jobs/{job}/programs.zip")
    assert acts(shop, job)[2:] == [("released", "bob"), ("downloaded", "lea"), ("downloaded", "bob")]


def test_a_download_of_what_was_released_anew_is_another_one(shop: Shop) -> None:
    job = shop.job("ann", "anew")
    for _ in range(2):
        shop.ask("bob", "POST", f"/v1/jobs/{job}/release", json={})
        for path in ("programs.zip", "files/programs/main.mod"):
            for _ in range(2):
                assert shop.ask("lea", "GET", f"/v1/jobs/{job}/{path}").status_code == 200
        shop.ask("bob", "POST", f"/v1/jobs/{job}/withdraw", json={"reason": "again"})
    found = shop.ask("bob", "GET", f"/v1/audit?job={job}&act=downloaded").json()["acts"]
    told = [(item["about"]["file"], item["about"]["release_number"]) for item in reversed(found)]
    assert told == [(name, n) for n in (1, 2) for name in ("programs.zip", "programs/main.mod")]


def test_what_waits_is_cancelled_and_tried_again_by_name(shop: Shop) -> None:
    shop.running_service.team.hold.set()
    job = shop.running_service.post(named_problem("held"), headers=bearer(shop.tokens["ann"])).json()["id"]
    shop.ask("bob", "POST", f"/v1/jobs/{job}/cancel")
    shop.ask("ann", "POST", f"/v1/jobs/{job}/cancel")
    assert shop.running_service.wait_for_end(job, headers=bearer(shop.tokens["ann"]))["state"] == "cancelled"
    shop.running_service.team.hold.clear()
    shop.ask("bob", "POST", f"/v1/jobs/{job}/retry")
    assert acts(shop, job) == [("submitted", "ann"), ("cancelled", "bob"), ("retried", "bob")]
    shop.running_service.wait_for_end(job, headers=bearer(shop.tokens["ann"]))


def test_who_comes_by_a_link_is_whose_link_it_is(shop: Shop) -> None:
    job = shop.job("ann", "by_link")
    path = shop.ask("bob", "POST", f"/v1/jobs/{job}/links?name=programs/main.mod").json()["path"]
    assert TestClient(shop.running_service.http.app, base_url=BASE_URL).get(path).status_code == 200
    (last, *_) = shop.ask("bob", "GET", f"/v1/audit?job={job}&act=downloaded").json()["acts"]
    assert (last["by"], last["about"]["link"], last["about"]["release"]) == ("bob", True, "not-released")


def test_a_team_reads_its_own_log_with_the_role_for_it(shop: Shop) -> None:
    job, others = shop.job("ann", "ours"), shop.job("eve", "theirs")
    alone = shop.job("dan", "dans")
    for name in ("ann", "lea"):
        answer = shop.ask(name, "GET", "/v1/audit")
        assert (answer.status_code, issue_codes(answer)) == (403, [("service.role", "Authorization")])
    assert TestClient(shop.running_service.http.app, base_url=BASE_URL).get("/v1/audit").status_code == 401
    assert acts(shop, job, "bob") == [("submitted", "ann")]
    assert (acts(shop, others, "bob"), acts(shop, alone, "bob"), acts(shop, job, "eve")) == ([], [], [])
    assert (acts(shop, job, "dan"), acts(shop, alone, "dan")) == ([], [("submitted", "dan")])
    assert acts(shop, others, "eve") == [("submitted", "eve")]
    for wrong in ("job=x", f"job={job}%00", "act=none", "cursor=0", "limit=0", f"cursor={2**40}"):
        assert shop.ask("bob", "GET", f"/v1/audit?{wrong}").status_code == 422, wrong


def test_pages_of_the_log_miss_nothing(shop: Shop) -> None:
    for k in range(4):
        shop.job("ann", f"page_{k}")
    whole = shop.ask("bob", "GET", "/v1/audit?limit=200").json()["acts"]
    cursor, got = "", []
    while True:
        page: dict[str, Any] = shop.ask("bob", "GET", f"/v1/audit?limit=3{cursor}").json()
        got += page["acts"]
        shop.ask("ann", "POST", f"/v1/jobs/{'0' * 32}/cancel")
        if "next" not in page:
            break
        cursor = f"&cursor={page['next']}"
    assert got == whole
    numbers = [item["number"] for item in whole]
    assert numbers == sorted(numbers, reverse=True)


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_what_is_done_at_once_is_all_written_down(tmp_path: Path, kind: str) -> None:
    database = postgres.fresh(tmp_path) if kind == "postgresql" else None
    with open_service(tmp_path / "data", database) as running_service:
        shop = Shop(running_service)
        jobs = [shop.job("ann", f"at_once_{k}") for k in range(6)]
        with ThreadPoolExecutor(12) as pool:
            got = [pool.submit(shop.ask, "lea", "GET", f"/v1/jobs/{job}/programs.zip") for job in jobs]
            gone = [pool.submit(shop.ask, "bob", "DELETE", f"/v1/jobs/{job}") for job in jobs]
            assert {item.result().status_code for item in got} <= {200, 404}
            assert {item.result().status_code for item in gone} == {204}
        with running_service.service.database.read() as db:
            numbers = list(db.execute(select(AUDIT.c.number).order_by(AUDIT.c.number)).scalars())
        assert numbers == list(range(1, len(numbers) + 1))
        for job, item in zip(jobs, got, strict=True):
            known = acts(shop, job)
            assert known.count(("deleted", "bob")) == 1
            assert item.result().status_code == 404 or ("downloaded", "lea") in known


def test_jobs_that_go_by_age_say_so_to_their_team(shop: Shop) -> None:
    job = shop.job("ann", "aged")
    JobQueue(shop.running_service.service.database, "host", 30.0).delete_old(-60.0)
    (last, *_) = shop.ask("bob", "GET", f"/v1/audit?job={job}").json()["acts"]
    assert (last["act"], last["by"], last["team"]) == ("deleted", audit.DELETED_BY_AGE, "shop")


def test_entries_are_forgotten_by_age_and_numbers_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    database = Database(f"sqlite:///{tmp_path / 'tandem.db'}")
    work, now = JobQueue(database, "host", 30.0), time.time()

    def entries(count: int, at: float) -> None:
        with monkeypatch.context() as clock, database.write() as db:
            clock.setattr("planner.service.models.time.time", lambda: at)
            for _ in range(count):
                audit.record_act(database, db, "local", audit.AuditEvent("submitted", "0" * 32, {}))

    def numbers() -> list[int]:
        return [item.number for item in audit.all_entries(database, None, (), 10_000)][::-1]

    entries(3, now - 30 * DAY_S)
    entries(2, now - 1 * DAY_S)
    work.delete_old(None, None)
    assert numbers() == [1, 2, 3, 4, 5]
    work.delete_old(None, 7 * DAY_S)
    assert numbers() == [4, 5]
    work.delete_old(None, 0.0)
    assert numbers() == [5], "the last one stays, so that no number is given twice"
    entries(2 * audit.MAX_DELETED_ENTRIES, now)
    with monkeypatch.context() as clock:  # ten years ahead, for one look
        clock.setattr("planner.service.models.time.time", lambda: now + 3650 * DAY_S)
        work.delete_old(None, 1095 * DAY_S)
    assert len(numbers()) > audit.MAX_DELETED_ENTRIES, "a clock that jumps takes some, not all"
    database.close()


def test_the_command_lists_it(shop: Shop, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    job = life(shop, "commanded")
    data = shop.running_service.service.options.data
    commands.audit(commands.Audit(job=job, data=data))
    output = capsys.readouterr().out.splitlines()
    assert len(output) == len(LIFE)
    assert output[0].split("  ")[1:3] == ["ann (shop)", "deleted"]
    assert "nein" in output[1]
    commands.audit(commands.Audit(act=("released",), most=1, json=True, data=data))
    (only,) = capsys.readouterr().out.splitlines()
    assert json.loads(only)["by"] == "bob"
    with pytest.raises(TandemError) as caught:
        commands.audit(commands.Audit(data=tmp_path / "none"))
    assert caught.value.issues[0].code == "service.start"
    assert not (tmp_path / "none").exists()


def test_the_log_is_written_or_the_thing_is_not_done(shop: Shop) -> None:
    """An entry that cannot be written takes the act with it."""
    job = shop.job("ann", "together")
    path = shop.running_service.service.options.data / "tandem.db"
    with sqlite3.connect(path) as db:
        db.execute("ALTER TABLE tandem_audit RENAME TO away")
    try:
        assert shop.ask("bob", "POST", f"/v1/jobs/{job}/release", json={}).status_code >= 500
        assert shop.ask("ann", "DELETE", f"/v1/jobs/{job}").status_code >= 500
        assert shop.ask("lea", "GET", f"/v1/jobs/{job}/programs.zip").status_code >= 500
    finally:
        with sqlite3.connect(path) as db:
            db.execute("ALTER TABLE away RENAME TO tandem_audit")
    body = shop.ask("ann", "GET", f"/v1/jobs/{job}").json()
    assert (body["state"], body["released"]) == ("verified", False)
