"""The API description lists the refusals of each address: all of them, and no others.

Each address is requested in every way that may be refused. The answers are compared with its list.
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
from planner.service.rate_limits import RateLimiter
from planner.service.runner import JobRunner
from planner.service.security import Auth, RefusedError, ServiceLimits
from tests import small_problem
from tests.service.support import TABLE, InProcess, named_problem
from tests.service.test_elements import ElementService

UPLOAD_MB: Final = 2.0
NOBODY: Final = "0" * 32
FILES: Final = [("problem", ("p.yaml", small_problem.PROBLEM)), ("files", ("targets.csv", TABLE))]
VIEW_LINK: Final[dict[str, str]] = {}
GOOD: Final[Mapping[str, dict[str, Any]]] = {
    "POST /v1/jobs": {"files": [("problem", ("p.yaml", named_problem("more"))), FILES[1]]},
    "POST /v1/check": {"files": [("problem", ("p.yaml", named_problem("checked"))), FILES[1]]},
    "PATCH /v1/jobs/{job}": {"json": {"title": "Gewölbe 3"}},
    "POST /v1/jobs/delete": {"json": {"jobs": [NOBODY]}},
    "POST /v1/cell": {"files": [("problem", ("p.yaml", named_problem("drawn"))), FILES[1]]},
    "POST /v1/sweeps": {
        "files": [("problem", ("p.yaml", named_problem("swept"))), FILES[1]],
        "params": {"field": "name", "value": ["swept_a", "swept_b"]},
    },
    "POST /v1/batches": {
        "files": [
            ("problem", ("p.yaml", named_problem("batch_a"))),
            ("problem", ("q.yaml", named_problem("batch_b"))),
            FILES[1],
        ]
    },
    "POST /v1/jobs/{job}/links": {"params": {"name": "report.html"}},
    "GET /v1/jobs/{job}/looks/{look}": {"params": VIEW_LINK},
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


class FailingRates:
    """Buckets of requests that are empty."""

    def take(self, *arguments: Any) -> None:
        raise RefusedError(429, Issue("service.too_many", "too often"))


class FailingDatabase:
    """A database that does not answer."""

    def __call__(self, *arguments: Any, **more: Any) -> Any:
        raise OperationalError("SELECT", {}, Exception("away"))


@pytest.fixture(scope="module")
def running_service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[InProcess]:
    """A service with tokens; requests carry one of them unless stated otherwise."""
    data = tmp_path_factory.mktemp("service") / "data"
    data.mkdir()
    token = Auth(Database(default_url(data))).create_token("ann", "release")
    limits = ServiceLimits(upload_mb=UPLOAD_MB)
    hosts = ("127.0.0.1:9",)
    with ElementService(
        data, limits, examiners=2, workers=4, require_token=True, webhook_hosts=hosts
    ) as made:
        made.service.failures = RateLimiter(None)
        made.http.headers["Authorization"] = f"Bearer {token}"
        yield made


@pytest.fixture(scope="module")
def ids(running_service: ElementService, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """A job and an element that have ended, a file, a process, a part of the catalogue."""
    job = running_service.post().json()["id"]
    running_service.wait_for_end(job)
    element = running_service.upload(tmp_path_factory.mktemp("shell"), name="dome").json()["id"]
    running_service.wait_for_division(element)
    for item in running_service.http.post(f"/v1/elements/{element}/plan", json={"panels": ["A01"]}).json()[
        "jobs"
    ]:
        running_service.wait_for_end(item["id"])  # there is something to report on
    hook = running_service.http.post("/v1/webhooks", **GOOD["POST /v1/webhooks"]).json()["id"]
    draft = running_service.http.post("/v1/drafts", **GOOD["POST /v1/drafts"]).json()["id"]
    body = running_service.http.post(f"/v1/jobs/{job}/looks").json()
    VIEW_LINK["signature"] = body["path"].partition("=")[2]
    own = {"job": job, "look": body["id"], "element": element, "draft": draft, "number": "1", "webhook": hook}
    return {**own, "name": "targets", "kind": "robots"}


@pytest.fixture(scope="module")
def local_service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[InProcess]:
    """One without tokens, which this machine alone may ask."""
    with InProcess(tmp_path_factory.mktemp("closed") / "data", examiners=1) as running_service:
        yield running_service


@pytest.fixture(scope="module")
def documented_operations(running_service: ElementService) -> dict[str, dict[str, Any]]:
    """All operations, by method and path."""
    paths = running_service.http.get("/openapi.json").json()["paths"]
    return {f"{method.upper()} {path}": item for path, ways in paths.items() for method, item in ways.items()}


@contextlib.contextmanager
def temporary_limits(running_service: InProcess, **limits: float) -> Iterator[None]:
    """With other limits for a while."""
    before = {name: getattr(running_service.service.limits, name) for name in limits}
    for name, value in limits.items():
        object.__setattr__(running_service.service.limits, name, value)
    yield
    for name, value in before.items():
        object.__setattr__(running_service.service.limits, name, value)


def address(path: str, ids: Mapping[str, str]) -> str:
    own = {**ids, "name": "report.html"} if "/files/" in path else ids
    if "/versions/" in path:
        own["name"] = "targets.csv"
    return re.sub(r"{(\w+)}", lambda found: own[found[1]], path)


def provoke_statuses(
    running_service: ElementService,
    closed: InProcess,
    ids: Mapping[str, str],
    operation: str,
    about: Mapping[str, Any],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> set[int]:
    """Return the statuses of an operation for every refusal that can be provoked."""
    method, path = operation.split(" ")
    right = address(path, ids)
    good = {"method": method, "url": right, **GOOD.get(operation, {})}

    def status(client: InProcess = running_service, **more: Any) -> int:
        with client.http.stream(**{**good, **more}) as answer:
            return int(answer.status_code)

    def upload() -> int:
        if operation == "POST /v1/elements":
            return int(running_service.upload(tmp_path, name="another").status_code)
        return status()

    out = {status(headers={"Authorization": "Bearer none"})}
    out.add(status(closed, headers={"Host": "other.example", "Authorization": ""}))
    with monkeypatch.context() as away:
        away.setattr(running_service.service.auth, "authenticate_token", FailingDatabase())
        away.setattr(running_service.service.auth, "close_session", FailingDatabase())
        away.setattr(running_service.service.links, "check_view_link", FailingDatabase())
        away.setattr(JobRunner, "healthy", False)
        out.add(status(headers={"Cookie": "tandem_session=x"} if operation == "DELETE /v1/session" else {}))
    with monkeypatch.context() as often:
        often.setattr(running_service.service, "rates", FailingRates())
        out.add(status())
    for name in re.findall(r"{(\w+)}", path):
        nobody = {**ids, name: NOBODY}
        url = re.sub(r"{(\w+)}", lambda found, own=nobody: own[found[1]], path)  # type: ignore[misc]
        out.add(status(url=url))
    for parameter in about.get("parameters", []):
        if parameter["in"] == "query" and parameter["name"] in ids:
            out.add(status(params={parameter["name"]: NOBODY}))
        if parameter["in"] == "query":
            out.add(
                status(params={**GOOD.get(operation, {}).get("params", {}), parameter["name"]: "~" * 300})
            )
        if parameter["in"] == "query" and parameter["name"] == "draft":
            known = GOOD.get(operation, {}).get("params", {})
            out.add(status(params={**known, "draft": f"{NOBODY}@1"}))
        if parameter["in"] == "query" and parameter["name"] == "job":
            out.add(status(params={"job": NOBODY}))
        if parameter["in"] == "header" and "maxLength" in str(parameter["schema"]):
            out.add(status(headers={parameter["name"]: "~" * 300}))
    if method == "PUT":
        out |= {status(headers={}), status(headers={"If-Match": '"0"'})}
    if "requestBody" in about:
        for content in (b"\xff{", b" " * int(UPLOAD_MB * 1e6 + 1)):
            out.add(status(content=content, files=None, json=None))
    if "{name}" in path or path.endswith((".zip", "/problem")):
        out.add(status(headers={"Range": "bytes=999999-"}))
    with temporary_limits(running_service, readings=0, open_jobs=0, kept_jobs=0, streams=0):
        out.add(upload())
        if operation.endswith("/retry"):
            with monkeypatch.context() as again:
                again.setattr("planner.service.jobs.RETRYABLE_STATES", ("verified",))
                out.add(status())
    if operation.endswith("/looks"):
        with monkeypatch.context() as full:
            full.setattr("planner.service.links.MAX_VIEW_LINKS", 0)
            out.add(status())
    with temporary_limits(running_service, token_disk_mb=0.0):
        out.add(upload())
    if operation.endswith("/retry"):
        out.add(status())
    return {code for code in out if code >= 400}


def test_each_address_lists_its_own_refusals(
    running_service: ElementService,
    local_service: InProcess,
    ids: dict[str, str],
    documented_operations: dict[str, dict[str, Any]],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    assert len(documented_operations) > 30
    wrong = {}
    for one, about in sorted(documented_operations.items(), key=lambda item: item[0].startswith("DELETE")):
        listed = {int(code) for code in about["responses"] if int(code) >= 400}
        got = provoke_statuses(running_service, local_service, ids, one, about, monkeypatch, tmp_path)
        if got != listed:
            wrong[one] = (
                f"answers {sorted(got - listed)} without listing, lists {sorted(listed - got)} in vain"
            )
    assert wrong == {}


def test_good_answers_are_listed_too(
    running_service: ElementService, documented_operations: dict[str, dict[str, Any]]
) -> None:
    for path in ("/v1/jobs", "/v1/health", "/v1/ready", "/metrics", "/v1/processes", "/v1/schema"):
        assert (
            str(running_service.http.get(path).status_code)
            in documented_operations[f"GET {path}"]["responses"]
        )
    assert "HTTPValidationError" not in running_service.http.get("/openapi.json").text
