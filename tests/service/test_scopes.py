"""Scopes of tokens, and every attempt to do more.

A script sends jobs and reads its own. A screen at the cell reads what is released.
"""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import pytest
from fastapi.testclient import TestClient

from planner.cli import service as commands
from planner.issues import TandemError
from planner.service import scopes
from tests.service.support import BASE_URL, InProcess, issue_codes, named_problem
from tests.service.test_roles import REFUSED, UNKNOWN, Shop, bearer, open_service, store

SEEN: Final = {"report.html", "release.json", "programs/main.mod"}
"""Files of a released job that a screen at the cell reads, of those that the pretended team makes."""


class ScopedShop(Shop):
    """The shop with a script and two screens, one of them of the jobs with a tag; a job that is released,
    ``out``, with the tag ``Cell 3``, one that is not, ``held``, and one that another team released."""

    def __init__(self, running_service: InProcess) -> None:
        super().__init__(running_service)
        auth = running_service.service.auth
        self.tokens |= {
            "script": auth.create_token("script", None, "shop", scope="submit"),
            "screen": auth.create_token("screen", None, "shop", scope="released"),
            "tagged": auth.create_token("tagged", None, "shop", scope="released", tag="cell 3"),
            "elsewhere": auth.create_token("elsewhere", None, "shop", scope="released", tag="cell"),
        }
        self.out, self.held = self.job("ann", "out"), self.job("ann", "held")
        self.plain, self.theirs = self.job("ann", "plain"), self.job("eve", "theirs")
        for name, job in (("bob", self.out), ("bob", self.plain), ("eve", self.theirs)):
            assert self.ask(name, "POST", f"/v1/jobs/{job}/release", json={}).status_code == 201
        tagged = self.ask("ann", "PATCH", f"/v1/jobs/{self.out}", json={"tags": ["Cell 3"]})
        assert tagged.status_code == 200

    def files(self, name: str, job: str) -> set[str]:
        return {file["name"] for file in self.ask(name, "GET", f"/v1/jobs/{job}/files").json()["files"]}


@pytest.fixture(scope="module")
def shop(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ScopedShop]:
    with open_service(tmp_path_factory.mktemp("scopes") / "data", None) as running_service:
        yield ScopedShop(running_service)


def operations(shop: ScopedShop) -> set[str]:
    paths = shop.running_service.http.get("/openapi.json").json()["paths"]
    told = {f"{method.upper()} {path}" for path, ways in paths.items() for method in ways}
    return {*told, "POST /ui/preview"}


def test_scopes_name_addresses_that_there_are(shop: ScopedShop) -> None:
    told = {
        item.replace("{name:path}", "{name}")
        for named in scopes.PERMITTED_ADDRESSES.values()
        for item in named
    }
    assert told <= operations(shop)


@pytest.mark.parametrize("name", ["script", "screen", "tagged"])
def test_all_other_addresses_are_closed_whatever_the_role_may(shop: ScopedShop, name: str) -> None:
    scope = "submit" if name == "script" else "released"
    open_to = {item.replace("{name:path}", "{name}") for item in scopes.PERMITTED_ADDRESSES[scope]}
    free = {"GET /v1/health", "GET /v1/ready", "DELETE /v1/session", "GET /v1/jobs/{job}/looks/{look}"}
    before, refused = store(shop.running_service), 0
    for item in operations(shop) - open_to - free:
        method, path = item.split(" ")
        for given in (shop.out, "0" * 32):
            url = re.sub(r"{(\w+)}", lambda found, own=given: {"kind": "robots"}.get(found[1], own), path)  # type: ignore[misc]
            answer = shop.ask(name, method, url, **({} if method == "GET" else {"content": b"{}"}))
            assert (answer.status_code, issue_codes(answer)) == (403, REFUSED), item
            assert f"token {name}: its scope {scope} does not permit" in answer.json()["detail"], item
            refused += 1
    assert refused > 60
    assert store(shop.running_service) == before


def test_a_script_sends_and_reads_its_own_and_nothing_of_its_team(shop: ScopedShop) -> None:
    job = shop.job("script", "sent")
    assert shop.listed_names("script") == {job}
    assert job in shop.listed_names("ann")
    assert shop.ask("script", "GET", f"/v1/jobs/{job}/programs.zip").status_code == 200
    assert "event: end" in shop.ask("script", "GET", f"/v1/jobs/{job}/events").text
    for other in (shop.out, shop.held, shop.theirs):
        for path in (
            "",
            "/events",
            "/files",
            "/files/report.html",
            "/programs.zip",
            "/releases",
            "/estimate",
        ):
            answer = shop.ask("script", "GET", f"/v1/jobs/{other}{path}")
            assert (answer.status_code, issue_codes(answer)) == (404, UNKNOWN), path
    for method, path in (
        ("DELETE", ""),
        ("POST", "/cancel"),
        ("POST", "/release"),
        ("POST", "/links?name=x"),
    ):
        answer = shop.ask("script", method, f"/v1/jobs/{job}{path}")
        assert (answer.status_code, issue_codes(answer)) == (403, REFUSED), path
    assert shop.ask("script", "POST", "/v1/jobs/delete", json={"jobs": [job]}).status_code == 403
    assert shop.running_service.post(
        named_problem("checked"), path="/v1/check", headers=bearer(shop.tokens["script"])
    ).is_success


def test_a_screen_reads_what_its_team_released_and_nothing_else(shop: ScopedShop) -> None:
    assert shop.listed_names("screen") == {shop.out, shop.plain}
    assert shop.files("screen", shop.out) == SEEN < shop.files("ann", shop.out)
    packed = shop.ask("screen", "GET", f"/v1/jobs/{shop.out}/programs.zip")
    assert packed.headers["Tandem-Release"] == "released"
    assert set(zipfile.ZipFile(io.BytesIO(packed.content)).namelist()) == {"main.mod", "release.json"}
    for name in shop.files("ann", shop.out):
        answer = shop.ask("screen", "GET", f"/v1/jobs/{shop.out}/files/{name}")
        expected = (200, None) if name in SEEN else (404, [("service.unknown_file", "name")])
        assert (answer.status_code, None if name in SEEN else issue_codes(answer)) == expected, name
    for job in (shop.held, shop.theirs):
        for path in (
            "",
            "/files",
            "/files/report.html",
            "/files/programs/main.mod",
            "/programs.zip",
            "/releases",
        ):
            answer = shop.ask("screen", "GET", f"/v1/jobs/{job}{path}")
            assert (answer.status_code, issue_codes(answer)) == (404, UNKNOWN), path
    told = shop.ask("bob", "GET", f"/v1/audit?job={shop.out}&act=downloaded").json()["acts"]
    assert "screen" in {item["by"] for item in told}


def test_a_screen_of_a_tag_has_the_jobs_with_that_tag(shop: ScopedShop) -> None:
    assert shop.listed_names("tagged") == {shop.out}
    assert shop.listed_names("elsewhere") == set()
    assert {item["id"] for item in shop.ask("tagged", "GET", "/v1/jobs?tag=other").json()["jobs"]} == set()
    for name, job in (("tagged", shop.plain), ("elsewhere", shop.out)):
        for path in ("", "/files/programs/main.mod", "/programs.zip"):
            answer = shop.ask(name, "GET", f"/v1/jobs/{job}{path}")
            assert (answer.status_code, issue_codes(answer)) == (404, UNKNOWN), (name, path)


def test_what_is_withdrawn_goes_from_the_screen(shop: ScopedShop) -> None:
    job = shop.job("ann", "taken_back")
    path = f"/v1/jobs/{job}/programs.zip"
    assert shop.ask("bob", "POST", f"/v1/jobs/{job}/release", json={}).status_code == 201
    tag = {"If-None-Match": shop.ask("screen", "GET", path).headers["ETag"]}
    assert shop.ask("bob", "POST", f"/v1/jobs/{job}/withdraw", json={"reason": "wrong"}).status_code == 200
    for headers in ({}, tag):
        answer = shop.running_service.http.get(path, headers=bearer(shop.tokens["screen"]) | headers)
        assert (answer.status_code, issue_codes(answer)) == (404, UNKNOWN)
    assert job not in shop.listed_names("screen")


def test_a_cookie_has_the_scope_of_its_token(shop: ScopedShop) -> None:
    browser = TestClient(shop.running_service.http.app, base_url=BASE_URL)
    assert browser.post("/v1/session", headers=bearer(shop.tokens["tagged"])).status_code == 204
    body = browser.get("/v1/session").json()
    assert (body["role"], body["scope"], body["tag"]) == ("view", "released", "cell 3")
    assert {job["id"] for job in browser.get("/v1/jobs").json()["jobs"]} == {shop.out}
    assert browser.head(f"/v1/jobs/{shop.out}/programs.zip").status_code == 200
    assert browser.get(f"/v1/jobs/{shop.held}/files/report.html").status_code == 404
    for path in ("/v1/elements", "/v1/drafts", "/v1/audit", "/metrics", f"/v1/jobs/{shop.out}/events"):
        assert browser.get(path).status_code == 403, path


@pytest.mark.parametrize(
    ("more", "field"),
    [
        (("--scope", "submit", "--role", "release"), "role"),
        (("--scope", "released", "--role", "plan", "--team", "shop"), "role"),
        (("--scope", "released"), "team"),
        (("--scope", "submit", "--tag", "cell 3"), "tag"),
        (("--tag", "cell 3"), "tag"),
        (("--scope", "released", "--team", "shop", "--tag", ""), "tag"),
        (("--scope", "released", "--team", "shop", "--tag", "x" * 41), "tag"),
    ],
)
def test_a_scope_that_does_not_go_with_the_rest_is_refused(
    tmp_path: Path, more: tuple[str, ...], field: str
) -> None:
    given: dict[str, Any] = dict(zip((item[2:] for item in more[::2]), more[1::2], strict=True))
    with pytest.raises(TandemError) as caught:
        commands.token(commands.AddToken(name="one", data=tmp_path, **given))
    assert [(item.code, item.field) for item in caught.value.issues] == [("service.token", field)]


def test_the_command_makes_and_lists_scopes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    commands.token(
        commands.AddToken(name="screen", data=tmp_path, scope="released", team="shop", tag="cell 3")
    )
    assert capsys.readouterr().out.startswith("tandem_")
    commands.token(commands.List(data=tmp_path))
    assert "released cell 3" in " ".join(capsys.readouterr().out.split())
