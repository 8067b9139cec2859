"""The description of the interface lists the refusals that each address gives: all of them, and no others.

Each address is asked in every way that may be refused, and what it answers is held against its own list.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import pytest
from sqlalchemy.exc import OperationalError

from planner.issues import Issue
from planner.service.models import Database, default_url
from planner.service.rates import Rates
from planner.service.runner import Runner
from planner.service.security import Auth, Limits, RefusedError
from tests import small_problem
from tests.service.support import TABLE, InProcess, named
from tests.service.test_elements import Elements

UPLOAD_MB: Final = 2.0
NOBODY: Final = "0" * 32
FILES: Final = [("problem", ("p.yaml", small_problem.PROBLEM)), ("files", ("targets.csv", TABLE))]
LOOK: Final[dict[str, str]] = {}
GOOD: Final[Mapping[str, dict[str, Any]]] = {
    "POST /v1/jobs": {"files": [("problem", ("p.yaml", named("more"))), FILES[1]]},
    "POST /v1/check": {"files": [("problem", ("p.yaml", named("checked"))), FILES[1]]},
    "PATCH /v1/jobs/{job}": {"json": {"title": "Gewölbe 3"}},
    "POST /v1/jobs/delete": {"json": {"jobs": [NOBODY]}},
    "POST /v1/cell": {"files": [("problem", ("p.yaml", named("drawn"))), FILES[1]]},
    "POST /v1/sweeps": {
        "files": [("problem", ("p.yaml", named("swept"))), FILES[1]],
        "params": {"field": "name", "value": ["swept_a", "swept_b"]},
    },
    "POST /v1/batches": {
        "files": [
            ("problem", ("p.yaml", named("batch_a"))),
            ("problem", ("q.yaml", named("batch_b"))),
            FILES[1],
        ]
    },
    "POST /v1/jobs/{job}/links": {"params": {"name": "report.html"}},
    "GET /v1/jobs/{job}/looks/{look}": {"params": LOOK},
    "POST /v1/jobs/{job}/release": {"json": {"note": "cut of Tuesday"}},
    "POST /v1/jobs/{job}/withdraw": {"json": {"reason": "the clamp moved"}},
    "POST /v1/elements/{element}/divide": {"json": {"fields": {"panels.hexagons.count": 26}}},
    "POST /v1/elements/{element}/plan": {"json": {"panels": ["A02"]}},
    "PATCH /v1/elements/{element}": {"json": {"title": "Gewölbe 3"}},
    "POST /v1/elements/{element}/release": {
        "json": {"panels": {"A01": {"job": NOBODY, "digest": NOBODY}}, "note": "north side"}
    },
    "POST /v1/drafts/{draft}/sent": {"json": {"version": 1, "job": NOBODY}},
    "POST /v1/drafts": {"files": FILES, "params": {"title": "Gewölbe 3"}},
    "PUT /v1/drafts/{draft}": {"files": FILES, "headers": {"If-Match": "*"}},
    "PATCH /v1/drafts/{draft}": {"json": {"title": "Gewölbe 4"}},
    "POST /v1/webhooks": {"json": {"url": "http://127.0.0.1:9/told"}},
    "POST /v1/elements/{element}/mark": {"json": {"panel": "A01", "state": "cut"}},
}
"""What a request needs to be a good one."""


class TooOften:
    """Buckets of requests that are empty."""

    def take(self, *asked: Any) -> None:
        raise RefusedError(429, Issue("service.too_many", "too often"))


class Away:
    """A database that does not answer."""

    def __call__(self, *asked: Any, **more: Any) -> Any:
        raise OperationalError("SELECT", {}, Exception("away"))


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Iterator[InProcess]:
    """A service with tokens, one of which is sent unless a request says otherwise."""
    data = tmp_path_factory.mktemp("service") / "data"
    data.mkdir()
    token = Auth(Database(default_url(data))).make("ann", "release")
    limits = Limits(upload_mb=UPLOAD_MB)
    hosts = ("127.0.0.1:9",)
    with Elements(data, limits, examiners=2, workers=4, require_token=True, webhook_hosts=hosts) as made:
        made.service.failures = Rates(None)
        made.http.headers["Authorization"] = f"Bearer {token}"
        yield made


@pytest.fixture(scope="module")
def ids(here: Elements, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """A job and an element that have ended, a file, a process, a part of the catalogue."""
    job = here.post().json()["id"]
    here.ended(job)
    element = here.upload(tmp_path_factory.mktemp("shell"), name="dome").json()["id"]
    here.divided(element)
    for one in here.http.post(f"/v1/elements/{element}/plan", json={"panels": ["A01"]}).json()["jobs"]:
        here.ended(one["id"])  # there is something to report on
    hook = here.http.post("/v1/webhooks", **GOOD["POST /v1/webhooks"]).json()["id"]
    draft = here.http.post("/v1/drafts", **GOOD["POST /v1/drafts"]).json()["id"]
    made = here.http.post(f"/v1/jobs/{job}/looks").json()
    LOOK["signature"] = made["path"].partition("=")[2]
    own = {"job": job, "look": made["id"], "element": element, "draft": draft, "number": "1", "webhook": hook}
    return {**own, "name": "targets", "kind": "robots"}


@pytest.fixture(scope="module")
def closed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[InProcess]:
    """One without tokens, which this machine alone may ask."""
    with InProcess(tmp_path_factory.mktemp("closed") / "data", examiners=1) as made:
        yield made


@pytest.fixture(scope="module")
def documented(here: Elements) -> dict[str, dict[str, Any]]:
    """All operations, by method and path."""
    paths = here.http.get("/openapi.json").json()["paths"]
    return {f"{way.upper()} {path}": one for path, ways in paths.items() for way, one in ways.items()}


@contextlib.contextmanager
def limited(here: InProcess, **limits: float) -> Iterator[None]:
    """With other limits for a while."""
    before = {name: getattr(here.service.limits, name) for name in limits}
    for name, value in limits.items():
        object.__setattr__(here.service.limits, name, value)
    yield
    for name, value in before.items():
        object.__setattr__(here.service.limits, name, value)


def address(path: str, ids: Mapping[str, str]) -> str:
    own = {**ids, "name": "report.html"} if "/files/" in path else ids
    if "/versions/" in path:
        own["name"] = "targets.csv"
    return re.sub(r"{(\w+)}", lambda found: own[found[1]], path)


def provoked(
    here: Elements,
    closed: InProcess,
    ids: Mapping[str, str],
    one: str,
    about: Mapping[str, Any],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> set[int]:
    """What an operation answers, of all that is refused."""
    way, path = one.split(" ")
    right = address(path, ids)
    good = {"method": way, "url": right, **GOOD.get(one, {})}

    def status(client: InProcess = here, **more: Any) -> int:
        with client.http.stream(**{**good, **more}) as answer:
            return int(answer.status_code)

    def upload() -> int:
        if one == "POST /v1/elements":
            return int(here.upload(tmp_path, name="another").status_code)
        return status()

    out = {status(headers={"Authorization": "Bearer none"})}
    out.add(status(closed, headers={"Host": "other.example", "Authorization": ""}))
    with monkeypatch.context() as away:
        away.setattr(here.service.auth, "who", Away())
        away.setattr(here.service.auth, "close_session", Away())
        away.setattr(here.service.links, "looker", Away())
        away.setattr(Runner, "healthy", False)
        out.add(status(headers={"Cookie": "tandem_session=x"} if one == "DELETE /v1/session" else {}))
    with monkeypatch.context() as often:
        often.setattr(here.service, "rates", TooOften())
        out.add(status())
    for name in re.findall(r"{(\w+)}", path):
        nobody = {**ids, name: NOBODY}
        url = re.sub(r"{(\w+)}", lambda found, own=nobody: own[found[1]], path)  # type: ignore[misc]
        out.add(status(url=url))
    for parameter in about.get("parameters", []):
        if parameter["in"] == "query" and parameter["name"] in ids:
            out.add(status(params={parameter["name"]: NOBODY}))
        if parameter["in"] == "query":
            out.add(status(params={**GOOD.get(one, {}).get("params", {}), parameter["name"]: "~" * 300}))
        if parameter["in"] == "query" and parameter["name"] == "draft":
            known = GOOD.get(one, {}).get("params", {})
            out.add(status(params={**known, "draft": f"{NOBODY}@1"}))
        if parameter["in"] == "query" and parameter["name"] == "job":
            out.add(status(params={"job": NOBODY}))
        if parameter["in"] == "header" and "maxLength" in str(parameter["schema"]):
            out.add(status(headers={parameter["name"]: "~" * 300}))
    if way == "PUT":
        out |= {status(headers={}), status(headers={"If-Match": '"0"'})}
    if "requestBody" in about:
        for content in (b"\xff{", b" " * int(UPLOAD_MB * 1e6 + 1)):
            out.add(status(content=content, files=None, json=None))
    if "{name}" in path or path.endswith((".zip", "/problem")):
        out.add(status(headers={"Range": "bytes=999999-"}))
    with limited(here, readings=0, open_jobs=0, kept_jobs=0, streams=0):
        out.add(upload())
        if one.endswith("/retry"):
            with monkeypatch.context() as again:
                again.setattr("planner.service.jobs.AGAIN", ("verified",))
                out.add(status())
    if one.endswith("/looks"):
        with monkeypatch.context() as full:
            full.setattr("planner.service.links.MOST_LOOKS", 0)
            out.add(status())
    with limited(here, token_disk_mb=0.0):
        out.add(upload())
    if one.endswith("/retry"):
        out.add(status())
    return {code for code in out if code >= 400}


def test_each_address_lists_its_own_refusals(
    here: Elements,
    closed: InProcess,
    ids: dict[str, str],
    documented: dict[str, dict[str, Any]],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    assert len(documented) > 30
    wrong = {}
    for one, about in sorted(documented.items(), key=lambda item: item[0].startswith("DELETE")):
        listed = {int(code) for code in about["responses"] if int(code) >= 400}
        got = provoked(here, closed, ids, one, about, monkeypatch, tmp_path)
        if got != listed:
            wrong[one] = (
                f"answers {sorted(got - listed)} without listing, lists {sorted(listed - got)} in vain"
            )
    assert wrong == {}


def test_good_answers_are_listed_too(here: Elements, documented: dict[str, dict[str, Any]]) -> None:
    for path in ("/v1/jobs", "/v1/health", "/v1/ready", "/metrics", "/v1/processes", "/v1/schema"):
        assert str(here.http.get(path).status_code) in documented[f"GET {path}"]["responses"]
    assert "HTTPValidationError" not in here.http.get("/openapi.json").text
