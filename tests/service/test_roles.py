"""Roles, teams and the end of tokens: permissions, visible jobs, and every attempt to do more."""

from __future__ import annotations

import re
import sqlite3
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final

import pytest
from fastapi.testclient import TestClient
from sqlalchemy import update

from planner.cli import service as commands
from planner.issues import TandemError
from planner.service import jobs, models, security
from planner.service.models import Database, default_url
from planner.service.security import Auth, ServiceLimits
from tests.service import postgres
from tests.service.support import BASE_URL, InProcess, issue_codes, named_problem, wait_until

REFUSED: Final = [("service.role", "Authorization")]
UNKNOWN: Final = [("service.unknown_job", None)]
ANYBODYS: Final = ("POST /v1/session", "DELETE /v1/session")
"""What changes a cookie alone."""


def bearer(token: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"}


class Shop:
    """A service with five tokens.

    ann, bob and lea, who may only view, are in the team shop, eve is in another team, and dan in none.
    """

    def __init__(self, running_service: InProcess) -> None:
        self.running_service, auth = running_service, running_service.service.auth
        self.tokens = {
            "ann": auth.create_token("ann", "plan", "shop"),
            "bob": auth.create_token("bob", "release", "shop"),
            "lea": auth.create_token("lea", "view", "shop"),
            "eve": auth.create_token("eve", "release", "other"),
            "dan": auth.create_token("dan", "release"),
        }

    def ask(self, name: str, method: str, path: str, **more: Any) -> Any:
        return self.running_service.http.request(method, path, headers=bearer(self.tokens[name]), **more)

    def job(self, name: str, problem: str) -> str:
        """Create a job with a token and wait until it has ended."""
        response = self.running_service.post(named_problem(problem), headers=bearer(self.tokens[name]))
        assert response.status_code == 201, response.text
        job = str(response.json()["id"])
        assert (
            self.running_service.wait_for_end(job, headers=bearer(self.tokens[name]))["state"] == "verified"
        )
        return job

    def listed_names(self, name: str) -> set[str]:
        return {job["id"] for job in self.ask(name, "GET", "/v1/jobs?limit=200").json()["jobs"]}


def open_service(data: Path, database: str | None) -> InProcess:
    """Open a service that requires tokens and has one."""
    data.mkdir(exist_ok=True)
    Auth(Database(database or default_url(data))).create_token("first")
    limits = ServiceLimits(check_s=60)
    return InProcess(data, limits, examiners=1, require_token=True, database=database)


@pytest.fixture(scope="module")
def shop(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shop]:
    with open_service(tmp_path_factory.mktemp("roles") / "data", None) as running_service:
        yield Shop(running_service)


@pytest.fixture(scope="module")
def operations(shop: Shop) -> dict[str, dict[str, Any]]:
    """All operations of the interface and of the page, by method and path."""
    paths = shop.running_service.http.get("/openapi.json").json()["paths"]
    told = {f"{method.upper()} {path}": item for path, ways in paths.items() for method, item in ways.items()}
    return {**told, "POST /ui/preview": {}}


def store(running_service: InProcess) -> list[str]:
    """Return the content of the database except the audit log."""
    with sqlite3.connect(running_service.service.options.data / "tandem.db") as db:
        return [row for row in db.iterdump() if not row.startswith('INSERT INTO "tandem_audit"')]


def test_who_may_only_look_changes_nothing(shop: Shop, operations: Mapping[str, Any]) -> None:
    """Each address that creates or changes something, with a job and an element of the same team."""
    job = shop.job("ann", "looked")
    before, kept = store(shop.running_service), set(shop.running_service.service.files.root.rglob("*"))
    refused = 0
    for operation in operations:
        method, path = operation.split(" ")
        if operation in ANYBODYS:
            continue
        for given in (job, "0" * 32):
            url = re.sub(r"{(\w+)}", lambda found, own=given: {"kind": "robots"}.get(found[1], own), path)  # type: ignore[misc]
            answer = shop.ask("lea", method, url, content=b"{}") if method != "GET" else None
            if answer is None:
                with shop.running_service.http.stream(method, url, headers=bearer(shop.tokens["lea"])) as got:
                    assert got.status_code in (200, 304, 403, 404, 422), operation
                continue
            refused += 1
            assert (answer.status_code, issue_codes(answer)) == (403, REFUSED), operation
            assert "got view" in answer.json()["detail"], operation
    assert refused > 25
    assert store(shop.running_service) == before
    assert set(shop.running_service.service.files.root.rglob("*")) == kept


def test_who_may_only_look_does_not_by_a_cookie_either(shop: Shop) -> None:
    browser = TestClient(shop.running_service.http.app, base_url=BASE_URL)
    job = shop.job("ann", "cookie")
    assert browser.post("/v1/session", headers=bearer(shop.tokens["lea"])).status_code == 204
    body = browser.get("/v1/session").json()
    assert body == {"name": "lea", "role": "view", "team": "shop", "tokens": True}
    assert browser.get(f"/v1/jobs/{job}/files/report.html").status_code == 200
    for method, path in (("DELETE", ""), ("POST", "/cancel"), ("POST", "/links?name=report.html")):
        answer = browser.request(method, f"/v1/jobs/{job}{path}")
        assert (answer.status_code, issue_codes(answer)) == (403, REFUSED), path
    assert browser.get(f"/v1/jobs/{job}").json()["state"] == "verified"


def test_a_refusal_says_which_role_is_needed(shop: Shop) -> None:
    (issue,) = shop.ask("lea", "POST", "/v1/jobs").json()["issues"]
    assert issue["message"] == "token lea: role not sufficient (got view, required plan)"
    assert issue["hint"] == "Ask the operator of the service for a token: tandem token add NAME --role plan."


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_a_team_sees_its_jobs_and_no_others(tmp_path: Path, kind: str) -> None:
    database = postgres.fresh(tmp_path) if kind == "postgresql" else None
    with open_service(tmp_path / "data", database) as running_service:
        shop = Shop(running_service)
        jobs = {name: shop.job(name, f"of_{name}") for name in ("ann", "bob", "eve", "dan")}
        team = {jobs["ann"], jobs["bob"]}
        assert {name: shop.listed_names(name) for name in shop.tokens} == {
            **dict.fromkeys(("ann", "bob", "lea"), team),
            "eve": {jobs["eve"]},
            "dan": {jobs["dan"]},
        }
        seen = shop.ask("bob", "GET", f"/v1/jobs/{jobs['ann']}").json()
        assert (seen["by"], seen["name"]) == ("ann", "of_ann")
        for stranger, job in (("eve", "ann"), ("dan", "ann"), ("ann", "eve"), ("ann", "dan"), ("eve", "dan")):
            for method, path in (
                ("GET", ""),
                ("GET", "/events"),
                ("GET", "/files"),
                ("GET", "/files/report.html"),
                ("GET", "/programs.zip"),
                ("POST", "/cancel"),
                ("POST", "/retry"),
                ("POST", "/links?name=report.html"),
                ("DELETE", ""),
            ):
                answer = shop.ask(stranger, method, f"/v1/jobs/{jobs[job]}{path}")
                assert (answer.status_code, issue_codes(answer)) == (404, UNKNOWN), (stranger, job, path)
        assert shop.ask("bob", "GET", f"/v1/jobs/{jobs['ann']}/programs.zip").status_code == 200
        running_service.service.auth.revoke("ann")  # who leaves a team leaves the jobs there
        assert shop.listed_names("bob") == team
        assert shop.ask("bob", "DELETE", f"/v1/jobs/{jobs['ann']}").status_code == 204
        assert shop.listed_names("lea") == {jobs["bob"]}


def test_quotas_and_keys_are_of_the_token_also_in_a_team(tmp_path: Path) -> None:
    with open_service(tmp_path / "data", None) as running_service:
        shop = Shop(running_service)
        once = {"Idempotency-Key": "the-same"}
        made = {
            name: running_service.post(
                named_problem(f"once_{name}"), headers=bearer(shop.tokens[name]) | once
            ).json()["id"]
            for name in ("ann", "bob")
        }
        assert made["ann"] != made["bob"]
        for name, job in made.items():
            again = running_service.post(
                named_problem(f"once_{name}"), headers=bearer(shop.tokens[name]) | once
            )
            assert again.json()["id"] == job
        used = {name: shop.ask(name, "GET", "/v1/storage").json()["used_mb"] for name in ("ann", "lea")}
        assert used["ann"] > used["lea"] == 0.0
        object.__setattr__(running_service.service.limits, "kept_jobs", 1)
        assert (
            running_service.post(named_problem("more"), headers=bearer(shop.tokens["ann"])).status_code == 429
        )
        assert (
            running_service.post(named_problem("more"), headers=bearer(shop.tokens["dan"])).status_code == 201
        )


def test_links_in_a_team_end_with_who_made_them(shop: Shop) -> None:
    auth = shop.running_service.service.auth
    shop.tokens["gil"] = auth.create_token("gil", "plan", "shop", lifetime_s=3600.0)
    job, stranger = shop.job("ann", "linked"), TestClient(shop.running_service.http.app, base_url=BASE_URL)
    url = f"/v1/jobs/{job}/links?name=report.html"
    paths = {name: shop.ask(name, "POST", url).json()["path"] for name in ("ann", "bob", "gil")}
    assert len(set(paths.values())) == 3
    assert all(stranger.get(path).status_code == 200 for path in paths.values())
    auth.revoke("gil")
    answer = stranger.get(paths["gil"])
    assert (answer.status_code, issue_codes(answer)) == (403, [("service.link", "signature")])
    assert stranger.get(paths["bob"]).status_code == 200
    # signed by a token of another team, and by one that may only look and so never signs
    expires = int(time.time()) + 60
    for name, good in (("eve", False), ("nobody", False)):
        token = shop.tokens.get(name, "tandem_" + "0" * 16)[7:23]
        signature = shop.running_service.service.links.sign(job, "report.html", expires, token)
        path = f"/v1/jobs/{job}/files/report.html?expires={expires}&signature={signature}"
        assert (stranger.get(path).status_code == 200) is good, name


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_a_token_ends_with_its_cookies_and_links(
    tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    database = postgres.fresh(tmp_path) if kind == "postgresql" else None
    with open_service(tmp_path / "data", database) as running_service:
        auth = running_service.service.auth
        token = auth.create_token("guest", "plan", lifetime_s=3600.0)
        job = running_service.post(named_problem("guest"), headers=bearer(token)).json()["id"]
        browser, stranger = (TestClient(running_service.http.app, base_url=BASE_URL) for _ in range(2))
        set_by = browser.post("/v1/session", headers=bearer(token)).headers["set-cookie"]
        assert int(re.findall(r"Max-Age=(\d+)", set_by)[0]) <= 3600
        path = browser.post(f"/v1/jobs/{job}/links?name=problem/problem.yaml").json()["path"]
        assert "expires" in browser.get("/v1/session").json()
        assert stranger.get(path).status_code == 200
        if database is None:  # the clock of SQLite is the host's: the end has come, and 30 days have not
            later = time.time() + 3601.0
            with monkeypatch.context() as clock:
                clock.setattr(models.time, "time", lambda: later)
                require_token_ended(running_service, browser, stranger, token, path)
            assert browser.get("/v1/jobs").status_code == 200  # a clock that went back tells no other tale
        else:  # that of PostgreSQL is its own, whatever the host's says
            with running_service.service.database.write() as db:
                ended = running_service.service.database.clock() - 1.0
                db.execute(update(models.TOKENS).where(models.TOKENS.c.name == "guest").values(expires=ended))
            monkeypatch.setattr(security.time, "time", lambda: 0.0)
            require_token_ended(running_service, browser, stranger, token, path)


def require_token_ended(
    running_service: InProcess, browser: TestClient, stranger: TestClient, token: str, path: str
) -> None:
    answer = running_service.http.get("/v1/jobs", headers=bearer(token))
    assert (answer.status_code, issue_codes(answer)) == (401, [("service.token", "Authorization")])
    assert "has expired" in answer.text
    assert browser.get("/v1/jobs").status_code == 401
    assert browser.post("/v1/jobs").status_code == 401
    assert stranger.get(path).status_code == 403
    assert not running_service.service.auth.is_valid(token[7:23])


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_streams_end_with_what_lets_their_listeners_see_the_job(
    tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(jobs, "ACCESS_CHECK_S", 0.1)
    database = postgres.fresh(tmp_path) if kind == "postgresql" else None
    with open_service(tmp_path / "data", database) as running_service:
        shop, tokens, auth = Shop(running_service), models.TOKENS, running_service.service.auth
        shop.tokens |= {"guest": auth.create_token("guest", "view", "shop", lifetime_s=3600.0)}
        shop.tokens |= {"moved": auth.create_token("moved", "view", "shop")}
        running_service.team.hold.set()
        job = running_service.post(named_problem("heard"), headers=bearer(shop.tokens["ann"])).json()["id"]
        wait_until(lambda: shop.ask("ann", "GET", f"/v1/jobs/{job}").json()["state"] == "running")

        def change(name: str, **values: Any) -> None:
            with running_service.service.database.write() as db:
                db.execute(update(tokens).where(tokens.c.name == name).values(**values))

        with ThreadPoolExecutor(5) as pool:
            events = {
                name: pool.submit(shop.ask, name, "GET", f"/v1/jobs/{job}/events")
                for name in ("ann", "bob", "lea", "guest", "moved")
            }
            try:
                wait_until(lambda: sum(running_service.service.hub._of_owner.values()) == 5)
                time.sleep(1.0)  # all look several times, and nobody is sent away
                assert not any(item.done() for item in events.values())
                auth.revoke("lea")
                change("guest", expires=time.time() - 1.0)
                change("moved", team="other")
                for name, status in (("lea", 401), ("guest", 401), ("moved", 404)):
                    said = events[name].result(20.0)
                    assert (said.status_code, "event: end" in said.text) == (200, False), name
                    assert shop.ask(name, "GET", f"/v1/jobs/{job}/events").status_code == status
                assert not events["ann"].done() and not events["bob"].done()
            finally:
                running_service.team.hold.clear()
            for name in ("ann", "bob"):
                assert "event: end" in events[name].result(20.0).text


def test_wrong_secrets_do_not_learn_that_a_token_is_over(shop: Shop) -> None:
    over = shop.running_service.service.auth.create_token("over", lifetime_s=-1.0)
    wrong = over[:-1] + ("A" if over[-1] != "A" else "B")
    assert "unknown or revoked" in shop.running_service.http.get("/v1/jobs", headers=bearer(wrong)).text
    assert "has expired" in shop.running_service.http.get("/v1/jobs", headers=bearer(over)).text


def test_without_tokens_all_may_be_done(tmp_path: Path) -> None:
    with InProcess(tmp_path / "data", examiners=1) as running_service:
        assert running_service.http.get("/v1/session").json() == {
            "name": "local",
            "role": "release",
            "tokens": False,
        }
        assert running_service.post(named_problem("open")).json()["id"]


def test_the_command_makes_and_lists_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    auth = Auth(Database(default_url(tmp_path)))
    given = commands.AddToken("kim", role="view", team="shop", expires="90d", data=tmp_path)
    commands.token(given)
    who = auth.authenticate_token(capsys.readouterr().out.strip())
    assert (who.name, who.role, who.team) == ("kim", "view", "shop")
    assert who.expires is not None
    assert abs(who.expires - time.time() - 90 * 86400) < 60
    commands.token(commands.AddToken("lou", data=tmp_path))
    who = auth.authenticate_token(capsys.readouterr().out.strip())
    assert (who.role, who.team, who.expires) == ("plan", None, None)
    for wrong, field in (
        ({"expires": "90"}, "expires"),
        ({"expires": "0d"}, "expires"),
        ({"expires": "-1d"}, "expires"),
        ({"expires": "99999d"}, "expires"),
        ({"expires": "٣d"}, "expires"),
        ({"team": "a b"}, "team"),
        ({"team": ""}, "team"),
    ):
        with pytest.raises(TandemError) as caught:
            commands.token(commands.AddToken("new", data=tmp_path, **wrong))
        (issue,) = caught.value.issues
        assert (issue.code, issue.field) == ("service.token", field), wrong
    commands.token(commands.List(data=tmp_path))
    output = capsys.readouterr().out
    assert all(word in output for word in ("kim", "view", "shop", "lou", "plan", "role", "ends")), output
