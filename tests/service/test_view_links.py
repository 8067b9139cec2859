"""View links to a job: what they show, what they never open, and how they end."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient
from sqlalchemy import update

from planner.service import links, models
from planner.service.models import Database, default_url
from planner.service.rate_limits import RateLimiter
from planner.service.security import Auth, ServiceLimits
from tests.service import postgres
from tests.service.support import InProcess, issue_codes
from tests.service.test_links import bearer, finished_job, stranger

DENIED = 404, [("service.link", None)]


@pytest.fixture(scope="module")
def shop(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[InProcess, dict[str, str]]]:
    """A service that requires tokens.

    ann plans and vic may only view, both in one team; bob has no team.
    """
    data = tmp_path_factory.mktemp("looks") / "data"
    data.mkdir()
    auth = Auth(Database(default_url(data)))
    tokens = {
        "ann": auth.create_token("ann", "release", "shop"),
        "vic": auth.create_token("vic", "view", "shop"),
    }
    tokens |= {"bob": auth.create_token("bob", "release"), "mate": auth.create_token("mate", "plan", "shop")}
    with InProcess(data, ServiceLimits(check_s=60), examiners=1, require_token=True) as running_service:
        running_service.service.failures = RateLimiter(None)
        yield running_service, tokens


def make_view_link(running_service: InProcess, job: str, token: str, seconds: int = 600) -> dict[str, Any]:
    answer = running_service.http.post(f"/v1/jobs/{job}/looks?seconds={seconds}", headers=bearer(token))
    assert answer.status_code == 201, answer.text
    return dict(answer.json())


def addresses(job: str, link: dict[str, Any]) -> tuple[str, str, str]:
    """Return the addresses of the page, of its requests, and of the report."""
    signature = link["path"].partition("=")[2]
    asked = f"look={link['id']}&signature={signature}"
    own = f"/v1/jobs/{job}/looks/{link['id']}?signature={signature}"
    return link["path"], own, f"/v1/jobs/{job}/files/report.html?{asked}"


def opens(client: TestClient, urls: tuple[str, str, str]) -> bool:
    """Return whether a link opens all addresses. Otherwise each must be a 404 with a message."""
    page, *api = (client.get(method) for method in urls)
    if page.status_code == 200:
        assert [answer.status_code for answer in api] == [200, 200]
        return True
    assert page.status_code == 404
    assert "link: expired, withdrawn or incomplete" in page.text
    assert "data-job" not in page.text
    assert [(answer.status_code, issue_codes(answer)) for answer in api] == [DENIED] * 2
    return False


def test_a_link_to_look_shows_what_is_safe_and_nothing_else(shop: tuple[InProcess, dict[str, str]]) -> None:
    running_service, tokens = shop
    job = finished_job(running_service, "seen", tokens["ann"])
    ann = bearer(tokens["ann"])
    told = {"title": "Gewölbe <b>3</b>", "notes": "secret note", "tags": ["secret-tag"]}
    assert running_service.http.patch(f"/v1/jobs/{job}", json=told, headers=ann).status_code == 200
    client, ways = (
        stranger(running_service),
        addresses(job, make_view_link(running_service, job, tokens["ann"])),
    )
    assert opens(client, ways)
    page, seen, report = (client.get(method) for method in ways)
    shown = seen.json()
    assert (shown["state"], shown["title"], shown["metrics"]) == ("verified", told["title"], {"cycle_s": 1.0})
    assert [issue["message"] for issue in shown["issues"]] == ["a note of the pretended plan"]
    assert (shown["files"], shown["release"]) == (["report.html"], "not-released")
    for secret in ("secret", '"ann"', "digest", "sha256", "main.mod"):
        assert secret not in seen.text + page.text
    for answer in (page, seen, report):
        assert answer.headers["Cache-Control"] == "no-store"
        assert answer.headers["Referrer-Policy"] == "no-referrer"
        assert "set-cookie" not in answer.headers
    assert "default-src 'none'" in page.headers["Content-Security-Policy"]
    assert report.headers["Content-Security-Policy"].startswith("sandbox")
    assert re.findall(r'(?:href|src)="([^"]*)"', page.text) == [
        "/ui/static/mark.svg",
        "/ui/static/tandem.css",
        "/ui/static/look.js",
        "/ui/static/mark.svg",
    ]
    assert (
        running_service.http.post(f"/v1/jobs/{job}/release", json={"note": "n"}, headers=ann).status_code
        == 201
    )
    assert client.get(ways[1]).json()["release"] == "released"


def test_a_link_to_look_opens_nothing_else(shop: tuple[InProcess, dict[str, str]]) -> None:
    running_service, tokens = shop
    job, other = (
        finished_job(running_service, "shut", tokens["ann"]),
        finished_job(running_service, "beside", tokens["ann"]),
    )
    made = make_view_link(running_service, job, tokens["ann"])
    client, (_, own, report) = stranger(running_service), addresses(job, made)
    query, signed = report.partition("?")[2], own.partition("?")[2]
    folder = f"/v1/jobs/{job}/files"
    for name in (
        "programs/main.mod",
        "problem/problem.yaml",
        "problem/targets.csv",
        "plan.json",
        "proof.json",
    ):
        assert running_service.http.get(f"{folder}/{name}", headers=bearer(tokens["ann"])).status_code in (
            200,
            404,
        )
        answer = client.get(f"{folder}/{name}?{query}")
        assert (answer.status_code, issue_codes(answer)) == DENIED, name
    for method, path in (
        ("GET", ""),
        ("GET", "/files"),
        ("GET", "/events"),
        ("GET", "/programs.zip"),
        ("GET", "/releases"),
        ("GET", "/looks"),
        ("POST", "/looks"),
        ("POST", "/links"),
        ("POST", "/cancel"),
        ("POST", "/release"),
        ("DELETE", f"/looks/{made['id']}"),
        ("DELETE", ""),
    ):
        answer = client.request(method, f"/v1/jobs/{job}{path}?{query}&name=report.html")
        assert answer.status_code == 401, path
    signature = signed.partition("=")[2]
    second = make_view_link(running_service, other, tokens["ann"])
    file_link = running_service.http.post(
        f"/v1/jobs/{job}/links?name=report.html", headers=bearer(tokens["ann"])
    ).json()
    of_file = file_link["path"].rpartition("=")[2]
    for changed in (
        own.replace(job, other),  # another job
        own.replace(made["id"], second["id"]),  # another link
        own.replace(made["id"], "0" * 32),
        own.replace(made["id"], made["id"].upper()),
        own[:-1],
        f"{own[:-1]}{'0' if own[-1] != '0' else '1'}",
        own.replace(signature, signature.upper()),
        own.replace(signature, of_file),  # the signature of a file's link
        own.replace(signature, "%C3%A9%00"),
        own.replace(signature, ""),
        report.replace(job, other),
        report.replace(made["id"], second["id"]),
        f"{folder}/report.html?look={made['id']}&signature={of_file}",
        f"/ui/look/{job}/{made['id']}",
        f"/ui/look/..%2f{job}/{made['id']}?{signed}",
    ):
        assert client.get(changed).status_code == 404, changed
    assert client.get(f"{folder}/report.html?expires=9999999999&signature={signature}").status_code == 403
    assert opens(client, addresses(job, made))


def test_links_to_look_are_made_by_who_plans_listed_and_withdrawn(
    shop: tuple[InProcess, dict[str, str]],
) -> None:
    running_service, tokens = shop
    job = finished_job(running_service, "managed", tokens["ann"])
    path = f"/v1/jobs/{job}/looks"
    for name, status in (("vic", 403), ("bob", 404)):
        assert running_service.http.post(path, headers=bearer(tokens[name])).status_code == status
    for seconds in ("0", "2592001", "soon"):
        answer = running_service.http.post(f"{path}?seconds={seconds}", headers=bearer(tokens["ann"]))
        assert (answer.status_code, issue_codes(answer)) == (422, [("service.request", "seconds")])
    first, second = (
        make_view_link(running_service, job, tokens["ann"]),
        make_view_link(running_service, job, tokens["mate"], 60),
    )
    listed = running_service.http.get(path, headers=bearer(tokens["vic"]))
    assert [(item["id"], item["by"]) for item in listed.json()["links"]] == [
        (second["id"], "mate"),
        (first["id"], "ann"),
    ]
    assert "signature" not in listed.text
    client = stranger(running_service)
    assert opens(client, addresses(job, second))
    taken = f"{path}/{second['id']}"
    for name, status in (("vic", 403), ("bob", 404), ("ann", 204), ("ann", 404)):
        assert running_service.http.delete(taken, headers=bearer(tokens[name])).status_code == status
    assert not opens(client, addresses(job, second))
    assert opens(client, addresses(job, first))
    acts = running_service.http.get(f"/v1/audit?job={job}", headers=bearer(tokens["ann"])).json()["acts"]
    assert [(act["act"], act["by"], act["about"]["link"]) for act in acts if "link" in act["about"]] == [
        ("unlinked", "ann", second["id"]),
        ("linked", "mate", second["id"]),
        ("linked", "ann", first["id"]),
    ]
    for _ in range(links.MAX_VIEW_LINKS - 1):
        make_view_link(running_service, job, tokens["ann"])
    answer = running_service.http.post(path, headers=bearer(tokens["ann"]))
    assert (answer.status_code, issue_codes(answer)) == (409, [("service.link", None)])
    assert "Withdraw one first" in answer.text


def test_links_to_look_end_with_their_token_and_their_job(shop: tuple[InProcess, dict[str, str]]) -> None:
    running_service, tokens = shop
    eve = running_service.service.auth.create_token("eve", "plan", "shop")
    job = finished_job(running_service, "ends", tokens["ann"])
    hers, anns = (
        addresses(job, make_view_link(running_service, job, eve)),
        addresses(job, make_view_link(running_service, job, tokens["ann"])),
    )
    client = stranger(running_service)
    assert opens(client, hers)
    running_service.service.auth.revoke("eve")
    assert not opens(client, hers)
    assert opens(client, anns)
    assert running_service.http.delete(f"/v1/jobs/{job}", headers=bearer(tokens["ann"])).status_code == 204
    assert not opens(client, anns)
    with running_service.service.database.read() as db:
        assert db.execute(models.LINKS.select().where(models.LINKS.c.job == job)).all() == []


@pytest.mark.parametrize("database", ["sqlite", "postgresql"])
def test_links_to_look_are_over_at_their_end_whatever_clocks_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, database: str
) -> None:
    data = tmp_path / "data"
    url = postgres.fresh(tmp_path) if database == "postgresql" else None
    with InProcess(data, examiners=1, database=url) as running_service:
        job = running_service.post().json()["id"]
        running_service.wait_for_end(job)
        body = running_service.http.post(f"/v1/jobs/{job}/looks?seconds=600").json()
        ways, client = addresses(job, body), running_service.http
        assert opens(client, ways)
        if url is None:
            jump = [601.0]
            now = time.time
            monkeypatch.setattr(models.time, "time", lambda: now() + jump[0])
            assert not opens(client, ways)
            jump[0] = 0.0  # it was found over, and stays so when the clock is set back
            assert not opens(client, ways)
            body = running_service.http.post(f"/v1/jobs/{job}/looks?seconds=600").json()
            jump[0] = -3600.0  # before it was made, it opens nothing
            assert not opens(client, addresses(job, body))
            jump[0] = -30.0
            assert opens(client, addresses(job, body))
        else:  # the clock of PostgreSQL counts alone
            monkeypatch.setattr(models.time, "time", lambda: 9e9)
            assert opens(client, ways)
            ended = running_service.service.database.clock() - 1.0
            with running_service.service.database.write() as db:
                db.execute(update(models.LINKS).values(expires=ended))
            monkeypatch.setattr(models.time, "time", lambda: 0.0)
            assert not opens(client, ways)
        assert running_service.http.get(f"/v1/jobs/{job}/looks").json()["links"][1:] == []


def test_links_to_look_are_asked_for_no_more_often_than_others(
    shop: tuple[InProcess, dict[str, str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    running_service, tokens = shop
    job = finished_job(running_service, "often", tokens["ann"])
    item, two = (addresses(job, make_view_link(running_service, job, tokens["ann"]))[1] for _ in range(2))
    client = stranger(running_service)
    monkeypatch.setattr(running_service.service, "rates", RateLimiter(0.1))
    assert [client.get(item).status_code for _ in range(2)] == [200, 429]
    assert client.get(two).status_code == 200  # another one, and the token that made both, are not kept out
    assert running_service.http.get(f"/v1/jobs/{job}", headers=bearer(tokens["ann"])).status_code == 200
    monkeypatch.setattr(running_service.service, "failures", RateLimiter(0.1))
    assert [client.get(item[:-1]).status_code for _ in range(2)] == [404, 429]
