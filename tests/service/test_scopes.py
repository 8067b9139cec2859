"""Scopes of tokens: a script that sends jobs and reads those, a screen at the cell that reads what is
released, and every way to do more."""

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
from tests.service.support import HERE, InProcess, codes, named
from tests.service.test_roles import REFUSED, UNKNOWN, Shop, bearer, opened, store

SEEN: Final = {"report.html", "release.json", "programs/main.mod"}
"""Files of a released job that a screen at the cell reads, of those that the pretended team makes."""


class Scoped(Shop):
    """The shop with a script and two screens, one of them of the jobs with a tag; a job that is released,
    ``out``, with the tag ``Cell 3``, one that is not, ``held``, and one that another team released."""

    def __init__(self, here: InProcess) -> None:
        super().__init__(here)
        auth = here.service.auth
        self.tokens |= {
            "script": auth.make("script", None, "shop", scope="submit"),
            "screen": auth.make("screen", None, "shop", scope="released"),
            "tagged": auth.make("tagged", None, "shop", scope="released", tag="cell 3"),
            "elsewhere": auth.make("elsewhere", None, "shop", scope="released", tag="cell"),
        }
        self.out, self.held = self.job("ann", "out"), self.job("ann", "held")
        self.plain, self.theirs = self.job("ann", "plain"), self.job("eve", "theirs")
        for name, job in (("bob", self.out), ("bob", self.plain), ("eve", self.theirs)):
            assert self.ask(name, "POST", f"/v1/jobs/{job}/release", json={}).status_code == 201
        tagged = self.ask("ann", "PATCH", f"/v1/jobs/{self.out}", json={"tags": ["Cell 3"]})
        assert tagged.status_code == 200

    def files(self, name: str, job: str) -> set[str]:
        return {one["name"] for one in self.ask(name, "GET", f"/v1/jobs/{job}/files").json()["files"]}


@pytest.fixture(scope="module")
def shop(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Scoped]:
    with opened(tmp_path_factory.mktemp("scopes") / "data", None) as here:
        yield Scoped(here)


def operations(shop: Scoped) -> set[str]:
    paths = shop.here.http.get("/openapi.json").json()["paths"]
    told = {f"{way.upper()} {path}" for path, ways in paths.items() for way in ways}
    return {*told, "POST /ui/preview"}


def test_scopes_name_addresses_that_there_are(shop: Scoped) -> None:
    told = {one.replace("{name:path}", "{name}") for named in scopes.OPEN_TO.values() for one in named}
    assert told <= operations(shop)


@pytest.mark.parametrize("name", ["script", "screen", "tagged"])
def test_all_other_addresses_are_closed_whatever_the_role_may(shop: Scoped, name: str) -> None:
    scope = "submit" if name == "script" else "released"
    open_to = {one.replace("{name:path}", "{name}") for one in scopes.OPEN_TO[scope]}
    free = {"GET /v1/health", "GET /v1/ready", "DELETE /v1/session", "GET /v1/jobs/{job}/looks/{look}"}
    before, refused = store(shop.here), 0
    for one in operations(shop) - open_to - free:
        way, path = one.split(" ")
        for given in (shop.out, "0" * 32):
            url = re.sub(r"{(\w+)}", lambda found, own=given: {"kind": "robots"}.get(found[1], own), path)  # type: ignore[misc]
            answer = shop.ask(name, way, url, **({} if way == "GET" else {"content": b"{}"}))
            assert (answer.status_code, codes(answer)) == (403, REFUSED), one
            assert f"beyond the scope {scope} of the token {name}" in answer.json()["detail"], one
            refused += 1
    assert refused > 60
    assert store(shop.here) == before


def test_a_script_sends_and_reads_its_own_and_nothing_of_its_team(shop: Scoped) -> None:
    job = shop.job("script", "sent")
    assert shop.listed("script") == {job}
    assert job in shop.listed("ann")
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
            assert (answer.status_code, codes(answer)) == (404, UNKNOWN), path
    for way, path in (("DELETE", ""), ("POST", "/cancel"), ("POST", "/release"), ("POST", "/links?name=x")):
        answer = shop.ask("script", way, f"/v1/jobs/{job}{path}")
        assert (answer.status_code, codes(answer)) == (403, REFUSED), path
    assert shop.ask("script", "POST", "/v1/jobs/delete", json={"jobs": [job]}).status_code == 403
    assert shop.here.post(
        named("checked"), path="/v1/check", headers=bearer(shop.tokens["script"])
    ).is_success


def test_a_screen_reads_what_its_team_released_and_nothing_else(shop: Scoped) -> None:
    assert shop.listed("screen") == {shop.out, shop.plain}
    assert shop.files("screen", shop.out) == SEEN < shop.files("ann", shop.out)
    packed = shop.ask("screen", "GET", f"/v1/jobs/{shop.out}/programs.zip")
    assert packed.headers["Tandem-Release"] == "released"
    assert set(zipfile.ZipFile(io.BytesIO(packed.content)).namelist()) == {"main.mod", "release.json"}
    for name in shop.files("ann", shop.out):
        answer = shop.ask("screen", "GET", f"/v1/jobs/{shop.out}/files/{name}")
        wanted = (200, None) if name in SEEN else (404, [("service.unknown_file", "name")])
        assert (answer.status_code, None if name in SEEN else codes(answer)) == wanted, name
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
            assert (answer.status_code, codes(answer)) == (404, UNKNOWN), path
    told = shop.ask("bob", "GET", f"/v1/audit?job={shop.out}&act=downloaded").json()["acts"]
    assert "screen" in {one["by"] for one in told}


def test_a_screen_of_a_tag_has_the_jobs_with_that_tag(shop: Scoped) -> None:
    assert shop.listed("tagged") == {shop.out}
    assert shop.listed("elsewhere") == set()
    assert {one["id"] for one in shop.ask("tagged", "GET", "/v1/jobs?tag=other").json()["jobs"]} == set()
    for name, job in (("tagged", shop.plain), ("elsewhere", shop.out)):
        for path in ("", "/files/programs/main.mod", "/programs.zip"):
            answer = shop.ask(name, "GET", f"/v1/jobs/{job}{path}")
            assert (answer.status_code, codes(answer)) == (404, UNKNOWN), (name, path)


def test_what_is_withdrawn_goes_from_the_screen(shop: Scoped) -> None:
    job = shop.job("ann", "taken_back")
    path = f"/v1/jobs/{job}/programs.zip"
    assert shop.ask("bob", "POST", f"/v1/jobs/{job}/release", json={}).status_code == 201
    tag = {"If-None-Match": shop.ask("screen", "GET", path).headers["ETag"]}
    assert shop.ask("bob", "POST", f"/v1/jobs/{job}/withdraw", json={"reason": "wrong"}).status_code == 200
    for headers in ({}, tag):
        answer = shop.here.http.get(path, headers=bearer(shop.tokens["screen"]) | headers)
        assert (answer.status_code, codes(answer)) == (404, UNKNOWN)
    assert job not in shop.listed("screen")


def test_a_cookie_has_the_scope_of_its_token(shop: Scoped) -> None:
    browser = TestClient(shop.here.http.app, base_url=HERE)
    assert browser.post("/v1/session", headers=bearer(shop.tokens["tagged"])).status_code == 204
    said = browser.get("/v1/session").json()
    assert (said["role"], said["scope"], said["tag"]) == ("view", "released", "cell 3")
    assert {one["id"] for one in browser.get("/v1/jobs").json()["jobs"]} == {shop.out}
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
    given: dict[str, Any] = dict(zip((one[2:] for one in more[::2]), more[1::2], strict=True))
    with pytest.raises(TandemError) as caught:
        commands.token(commands.Add(name="one", data=tmp_path, **given))
    assert [(one.code, one.field) for one in caught.value.issues] == [("service.token", field)]


def test_the_command_makes_and_lists_scopes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    commands.token(commands.Add(name="screen", data=tmp_path, scope="released", team="shop", tag="cell 3"))
    assert capsys.readouterr().out.startswith("tandem_")
    commands.token(commands.List(data=tmp_path))
    assert "released cell 3" in " ".join(capsys.readouterr().out.split())
