"""Roles, teams and ends of tokens: what each may do, whose jobs each sees, and every way to do more."""

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
from planner.service.security import Auth, Limits
from tests.service import postgres
from tests.service.support import HERE, InProcess, codes, named, until

REFUSED: Final = [("service.role", "Authorization")]
UNKNOWN: Final = [("service.unknown_job", None)]
ANYBODYS: Final = ("POST /v1/session", "DELETE /v1/session")
"""What changes a cookie alone."""


def bearer(token: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"}


class Shop:
    """A service whose tokens are ann, bob and lea, who may only look, of the team shop, eve of another one,
    and dan of none."""

    def __init__(self, here: InProcess) -> None:
        self.here, auth = here, here.service.auth
        self.tokens = {
            "ann": auth.make("ann", "plan", "shop"),
            "bob": auth.make("bob", "release", "shop"),
            "lea": auth.make("lea", "view", "shop"),
            "eve": auth.make("eve", "release", "other"),
            "dan": auth.make("dan", "release"),
        }

    def ask(self, name: str, method: str, path: str, **more: Any) -> Any:
        return self.here.http.request(method, path, headers=bearer(self.tokens[name]), **more)

    def job(self, name: str, problem: str) -> str:
        """A job of that token that has ended."""
        made = self.here.post(named(problem), headers=bearer(self.tokens[name]))
        assert made.status_code == 201, made.text
        job = str(made.json()["id"])
        assert self.here.ended(job, headers=bearer(self.tokens[name]))["state"] == "verified"
        return job

    def listed(self, name: str) -> set[str]:
        return {one["id"] for one in self.ask(name, "GET", "/v1/jobs?limit=200").json()["jobs"]}


def opened(data: Path, database: str | None) -> InProcess:
    """A service that asks for tokens, of which there is one."""
    data.mkdir(exist_ok=True)
    Auth(Database(database or default_url(data))).make("first")
    limits = Limits(check_s=60)
    return InProcess(data, limits, examiners=1, require_token=True, database=database)


@pytest.fixture(scope="module")
def shop(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shop]:
    with opened(tmp_path_factory.mktemp("roles") / "data", None) as here:
        yield Shop(here)


@pytest.fixture(scope="module")
def operations(shop: Shop) -> dict[str, dict[str, Any]]:
    """All operations of the interface and of the page, by method and path."""
    paths = shop.here.http.get("/openapi.json").json()["paths"]
    told = {f"{way.upper()} {path}": one for path, ways in paths.items() for way, one in ways.items()}
    return {**told, "POST /ui/preview": {}}


def store(here: InProcess) -> list[str]:
    """All that the database holds, but the log of who did what."""
    with sqlite3.connect(here.service.options.data / "tandem.db") as db:
        return [row for row in db.iterdump() if not row.startswith('INSERT INTO "tandem_audit"')]


def test_who_may_only_look_changes_nothing(shop: Shop, operations: Mapping[str, Any]) -> None:
    """Each address that makes or changes something, with a job and an element of one's own team."""
    job = shop.job("ann", "looked")
    before, kept = store(shop.here), set(shop.here.service.files.root.rglob("*"))
    refused = 0
    for one in operations:
        way, path = one.split(" ")
        if one in ANYBODYS:
            continue
        for given in (job, "0" * 32):
            url = re.sub(r"{(\w+)}", lambda found, own=given: {"kind": "robots"}.get(found[1], own), path)  # type: ignore[misc]
            answer = shop.ask("lea", way, url, content=b"{}") if way != "GET" else None
            if answer is None:
                with shop.here.http.stream(way, url, headers=bearer(shop.tokens["lea"])) as got:
                    assert got.status_code in (200, 304, 403, 404, 422), one
                continue
            refused += 1
            assert (answer.status_code, codes(answer)) == (403, REFUSED), one
            assert "has the role view" in answer.json()["detail"], one
    assert refused > 25
    assert store(shop.here) == before
    assert set(shop.here.service.files.root.rglob("*")) == kept


def test_who_may_only_look_does_not_by_a_cookie_either(shop: Shop) -> None:
    browser = TestClient(shop.here.http.app, base_url=HERE)
    job = shop.job("ann", "cookie")
    assert browser.post("/v1/session", headers=bearer(shop.tokens["lea"])).status_code == 204
    said = browser.get("/v1/session").json()
    assert said == {"name": "lea", "role": "view", "team": "shop", "tokens": True}
    assert browser.get(f"/v1/jobs/{job}/files/report.html").status_code == 200
    for way, path in (("DELETE", ""), ("POST", "/cancel"), ("POST", "/links?name=report.html")):
        answer = browser.request(way, f"/v1/jobs/{job}{path}")
        assert (answer.status_code, codes(answer)) == (403, REFUSED), path
    assert browser.get(f"/v1/jobs/{job}").json()["state"] == "verified"


def test_a_refusal_says_which_role_is_needed(shop: Shop) -> None:
    (issue,) = shop.ask("lea", "POST", "/v1/jobs").json()["issues"]
    assert issue["message"] == "this needs a token with the role plan, the token lea has the role view"
    assert issue["hint"] == "ask who runs the service for one: tandem token add NAME --role plan"


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_a_team_sees_its_jobs_and_no_others(tmp_path: Path, kind: str) -> None:
    database = postgres.fresh(tmp_path) if kind == "postgresql" else None
    with opened(tmp_path / "data", database) as here:
        shop = Shop(here)
        jobs = {name: shop.job(name, f"of_{name}") for name in ("ann", "bob", "eve", "dan")}
        team = {jobs["ann"], jobs["bob"]}
        assert {name: shop.listed(name) for name in shop.tokens} == {
            **dict.fromkeys(("ann", "bob", "lea"), team),
            "eve": {jobs["eve"]},
            "dan": {jobs["dan"]},
        }
        seen = shop.ask("bob", "GET", f"/v1/jobs/{jobs['ann']}").json()
        assert (seen["by"], seen["name"]) == ("ann", "of_ann")
        for stranger, job in (("eve", "ann"), ("dan", "ann"), ("ann", "eve"), ("ann", "dan"), ("eve", "dan")):
            for way, path in (
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
                answer = shop.ask(stranger, way, f"/v1/jobs/{jobs[job]}{path}")
                assert (answer.status_code, codes(answer)) == (404, UNKNOWN), (stranger, job, path)
        assert shop.ask("bob", "GET", f"/v1/jobs/{jobs['ann']}/programs.zip").status_code == 200
        here.service.auth.revoke("ann")  # who leaves a team leaves the jobs there
        assert shop.listed("bob") == team
        assert shop.ask("bob", "DELETE", f"/v1/jobs/{jobs['ann']}").status_code == 204
        assert shop.listed("lea") == {jobs["bob"]}


def test_quotas_and_keys_are_of_the_token_also_in_a_team(tmp_path: Path) -> None:
    with opened(tmp_path / "data", None) as here:
        shop = Shop(here)
        once = {"Idempotency-Key": "the-same"}
        made = {
            name: here.post(named(f"once_{name}"), headers=bearer(shop.tokens[name]) | once).json()["id"]
            for name in ("ann", "bob")
        }
        assert made["ann"] != made["bob"]
        for name, job in made.items():
            again = here.post(named(f"once_{name}"), headers=bearer(shop.tokens[name]) | once)
            assert again.json()["id"] == job
        used = {name: shop.ask(name, "GET", "/v1/storage").json()["used_mb"] for name in ("ann", "lea")}
        assert used["ann"] > used["lea"] == 0.0
        object.__setattr__(here.service.limits, "kept_jobs", 1)
        assert here.post(named("more"), headers=bearer(shop.tokens["ann"])).status_code == 429
        assert here.post(named("more"), headers=bearer(shop.tokens["dan"])).status_code == 201


def test_links_in_a_team_end_with_who_made_them(shop: Shop) -> None:
    auth = shop.here.service.auth
    shop.tokens["gil"] = auth.make("gil", "plan", "shop", lasts_s=3600.0)
    job, stranger = shop.job("ann", "linked"), TestClient(shop.here.http.app, base_url=HERE)
    asked = f"/v1/jobs/{job}/links?name=report.html"
    paths = {name: shop.ask(name, "POST", asked).json()["path"] for name in ("ann", "bob", "gil")}
    assert len(set(paths.values())) == 3
    assert all(stranger.get(path).status_code == 200 for path in paths.values())
    auth.revoke("gil")
    answer = stranger.get(paths["gil"])
    assert (answer.status_code, codes(answer)) == (403, [("service.link", "signature")])
    assert stranger.get(paths["bob"]).status_code == 200
    # signed by a token of another team, and by one that may only look and so never signs
    expires = int(time.time()) + 60
    for name, good in (("eve", False), ("nobody", False)):
        token = shop.tokens.get(name, "tandem_" + "0" * 16)[7:23]
        signature = shop.here.service.links.sign(job, "report.html", expires, token)
        path = f"/v1/jobs/{job}/files/report.html?expires={expires}&signature={signature}"
        assert (stranger.get(path).status_code == 200) is good, name


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_a_token_ends_with_its_cookies_and_links(
    tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    database = postgres.fresh(tmp_path) if kind == "postgresql" else None
    with opened(tmp_path / "data", database) as here:
        auth = here.service.auth
        token = auth.make("guest", "plan", lasts_s=3600.0)
        job = here.post(named("guest"), headers=bearer(token)).json()["id"]
        browser, stranger = (TestClient(here.http.app, base_url=HERE) for _ in range(2))
        set_by = browser.post("/v1/session", headers=bearer(token)).headers["set-cookie"]
        assert int(re.findall(r"Max-Age=(\d+)", set_by)[0]) <= 3600
        path = browser.post(f"/v1/jobs/{job}/links?name=problem/problem.yaml").json()["path"]
        assert "expires" in browser.get("/v1/session").json()
        assert stranger.get(path).status_code == 200
        if database is None:  # the clock of SQLite is the host's: the end has come, and 30 days have not
            later = time.time() + 3601.0
            with monkeypatch.context() as clock:
                clock.setattr(models.time, "time", lambda: later)
                over(here, browser, stranger, token, path)
            assert browser.get("/v1/jobs").status_code == 200  # a clock that went back tells no other tale
        else:  # that of PostgreSQL is its own, whatever the host's says
            with here.service.database.write() as db:
                ended = here.service.database.clock() - 1.0
                db.execute(update(models.TOKENS).where(models.TOKENS.c.name == "guest").values(expires=ended))
            monkeypatch.setattr(security.time, "time", lambda: 0.0)
            over(here, browser, stranger, token, path)


def over(here: InProcess, browser: TestClient, stranger: TestClient, token: str, path: str) -> None:
    answer = here.http.get("/v1/jobs", headers=bearer(token))
    assert (answer.status_code, codes(answer)) == (401, [("service.token", "Authorization")])
    assert "has come to its end" in answer.text
    assert browser.get("/v1/jobs").status_code == 401
    assert browser.post("/v1/jobs").status_code == 401
    assert stranger.get(path).status_code == 403
    assert not here.service.auth.in_force(token[7:23])


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_streams_end_with_what_lets_their_listeners_see_the_job(
    tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(jobs, "MAY_S", 0.1)
    database = postgres.fresh(tmp_path) if kind == "postgresql" else None
    with opened(tmp_path / "data", database) as here:
        shop, tokens, auth = Shop(here), models.TOKENS, here.service.auth
        shop.tokens |= {"guest": auth.make("guest", "view", "shop", lasts_s=3600.0)}
        shop.tokens |= {"moved": auth.make("moved", "view", "shop")}
        here.team.hold.set()
        job = here.post(named("heard"), headers=bearer(shop.tokens["ann"])).json()["id"]
        until(lambda: shop.ask("ann", "GET", f"/v1/jobs/{job}").json()["state"] == "running")

        def change(name: str, **values: Any) -> None:
            with here.service.database.write() as db:
                db.execute(update(tokens).where(tokens.c.name == name).values(**values))

        with ThreadPoolExecutor(5) as pool:
            heard = {
                name: pool.submit(shop.ask, name, "GET", f"/v1/jobs/{job}/events")
                for name in ("ann", "bob", "lea", "guest", "moved")
            }
            try:
                until(lambda: sum(here.service.hub._of_owner.values()) == 5)
                time.sleep(1.0)  # all look several times, and nobody is sent away
                assert not any(one.done() for one in heard.values())
                auth.revoke("lea")
                change("guest", expires=time.time() - 1.0)
                change("moved", team="other")
                for name, status in (("lea", 401), ("guest", 401), ("moved", 404)):
                    said = heard[name].result(20.0)
                    assert (said.status_code, "event: end" in said.text) == (200, False), name
                    assert shop.ask(name, "GET", f"/v1/jobs/{job}/events").status_code == status
                assert not heard["ann"].done() and not heard["bob"].done()
            finally:
                here.team.hold.clear()
            for name in ("ann", "bob"):
                assert "event: end" in heard[name].result(20.0).text


def test_wrong_secrets_do_not_learn_that_a_token_is_over(shop: Shop) -> None:
    over = shop.here.service.auth.make("over", lasts_s=-1.0)
    wrong = over[:-1] + ("A" if over[-1] != "A" else "B")
    assert "unknown or was revoked" in shop.here.http.get("/v1/jobs", headers=bearer(wrong)).text
    assert "has come to its end" in shop.here.http.get("/v1/jobs", headers=bearer(over)).text


def test_without_tokens_all_may_be_done(tmp_path: Path) -> None:
    with InProcess(tmp_path / "data", examiners=1) as here:
        assert here.http.get("/v1/session").json() == {"name": "local", "role": "release", "tokens": False}
        assert here.post(named("open")).json()["id"]


def test_the_command_makes_and_lists_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    auth = Auth(Database(default_url(tmp_path)))
    given = commands.Add("kim", role="view", team="shop", expires="90d", data=tmp_path)
    commands.token(given)
    who = auth.who(capsys.readouterr().out.strip())
    assert (who.name, who.role, who.team) == ("kim", "view", "shop")
    assert who.expires is not None
    assert abs(who.expires - time.time() - 90 * 86400) < 60
    commands.token(commands.Add("lou", data=tmp_path))
    who = auth.who(capsys.readouterr().out.strip())
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
            commands.token(commands.Add("new", data=tmp_path, **wrong))
        (issue,) = caught.value.issues
        assert (issue.code, issue.field) == ("service.token", field), wrong
    commands.token(commands.List(data=tmp_path))
    told = capsys.readouterr().out
    assert all(word in told for word in ("kim", "view", "shop", "lou", "plan", "role", "ends")), told
