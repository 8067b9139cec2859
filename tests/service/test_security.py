"""Who may send requests, from where, and what may be sent: every refusal with its code."""

from __future__ import annotations

import builtins
import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient

from planner.cli import service
from planner.issues import TandemError
from planner.service.models import Database, default_url
from planner.service.rate_limits import RateLimiter
from planner.service.security import Auth, ServiceLimits
from planner.service.service import Options, Service
from tests.service.support import BASE_URL, FakeTeam, InProcess, issue_codes, named_problem


@pytest.fixture(scope="module")
def running_service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[InProcess]:
    with InProcess(tmp_path_factory.mktemp("open") / "data", ServiceLimits(check_s=60), examiners=1) as made:
        yield made


@pytest.fixture(scope="module")
def closed_service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[InProcess, str, str]]:
    """A service that requires tokens, and two tokens."""
    data = tmp_path_factory.mktemp("closed") / "data"
    data.mkdir()
    auth = Auth(Database(default_url(data)))
    tokens = auth.create_token("ann"), auth.create_token("bob")
    with InProcess(data, ServiceLimits(check_s=60), examiners=1, require_token=True) as running_service:
        running_service.service.failures = RateLimiter(
            None
        )  # more wrong tokens come here than one address may send
        yield running_service, *tokens


def bearer(token: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"}


def test_without_a_token_nothing_but_health_is_told(closed_service: tuple[InProcess, str, str]) -> None:
    running_service, ann, _ = closed_service
    for path in ("/v1/jobs", "/v1/catalogue/robots", "/metrics", "/v1/schema", f"/v1/jobs/{'0' * 32}"):
        answer = running_service.http.get(path)
        assert answer.status_code == 401, path
        assert issue_codes(answer) == [("service.token", "Authorization")]
        assert answer.headers["www-authenticate"] == "Bearer"
    assert running_service.post().status_code == 401
    assert running_service.http.get("/v1/health").status_code == 200
    assert running_service.http.get("/v1/jobs", headers=bearer(ann)).status_code == 200


@pytest.mark.parametrize(
    "change", [lambda t: t[:-1] + "!", lambda t: t[:-2] + "AA", lambda t: "", lambda t: "é"]
)
def test_wrong_tokens_are_401(closed_service: tuple[InProcess, str, str], change: Any) -> None:
    running_service, ann, _ = closed_service
    header = f"Bearer {change(ann)}".encode("latin-1")
    answer = running_service.http.get("/v1/jobs", headers={"Authorization": header})
    assert answer.status_code == 401


def test_tokens_are_hashed_at_rest(closed_service: tuple[InProcess, str, str]) -> None:
    running_service, ann, _ = closed_service
    kept = b"".join(path.read_bytes() for path in running_service.service.options.data.glob("tandem.db*"))
    assert ann.encode() not in kept
    assert ann.rsplit("_", 1)[1].encode() not in kept
    assert hashlib.sha256(ann.encode()).hexdigest().encode() in kept


def test_jobs_of_others_are_404_as_if_there_were_none(closed_service: tuple[InProcess, str, str]) -> None:
    running_service, ann, bob = closed_service
    job = running_service.post(named_problem("mine"), headers=bearer(ann)).json()["id"]
    running_service.wait_for_end(job, headers=bearer(ann))
    for method, path in (
        ("GET", ""),
        ("GET", "/events"),
        ("GET", "/files"),
        ("GET", "/files/report.html"),
        ("GET", "/programs.zip"),
        ("POST", "/cancel"),
        ("DELETE", ""),
    ):
        answer = running_service.http.request(method, f"/v1/jobs/{job}{path}", headers=bearer(bob))
        none = running_service.http.request(method, f"/v1/jobs/{'0' * 32}{path}", headers=bearer(bob))
        assert answer.status_code == none.status_code == 404, path
        assert answer.text == none.text.replace("0" * 32, job)
    assert not running_service.http.get("/v1/jobs", headers=bearer(bob)).json()["jobs"]
    later = f"/v1/jobs?cursor=99999999999.0-{job}"
    assert running_service.http.get(later, headers=bearer(bob)).json()["jobs"] == []


def test_a_revoked_token_ends_at_once_with_its_sessions(closed_service: tuple[InProcess, str, str]) -> None:
    running_service, _, _ = closed_service
    eve = running_service.service.auth.create_token("eve")
    browser = TestClient(running_service.http.app, base_url=BASE_URL)
    logged_in = browser.post("/v1/session", headers=bearer(eve))
    assert logged_in.status_code == 204
    cookie = logged_in.headers["set-cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=strict" in cookie
    assert browser.get("/v1/jobs").status_code == 200
    running_service.service.auth.revoke("eve")
    assert browser.get("/v1/jobs").status_code == 401
    assert running_service.http.get("/v1/jobs", headers=bearer(eve)).status_code == 401


def test_a_session_ends_when_the_browser_logs_out(closed_service: tuple[InProcess, str, str]) -> None:
    running_service, ann, _ = closed_service
    browser = TestClient(running_service.http.app, base_url=BASE_URL)
    browser.post("/v1/session", headers=bearer(ann))
    cookie = browser.cookies["tandem_session"]
    assert browser.delete("/v1/session").status_code == 204
    browser.cookies.set("tandem_session", cookie)
    assert browser.get("/v1/jobs").status_code == 401


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "https://evil.example"},
        {"Origin": "null"},
        {"Sec-Fetch-Site": "cross-site"},
        {"Host": "evil.example"},
        {"X-Forwarded-For": "10.0.0.1"},
    ],
)
def test_other_sites_cannot_ask_through_a_browser(
    running_service: InProcess, headers: dict[str, str]
) -> None:
    answer = running_service.post(headers=headers)
    assert answer.status_code == 403
    assert issue_codes(answer) == [("service.foreign", None)]


def test_no_other_origin_may_read(running_service: InProcess) -> None:
    answer = running_service.http.get("/v1/jobs", headers={"Origin": "https://evil.example"})
    assert "access-control-allow-origin" not in answer.headers


@pytest.mark.parametrize("host", ["0.0.0.0", "192.0.2.1", "::"])
def test_off_loopback_a_token_must_exist(tmp_path: Path, host: str) -> None:
    with pytest.raises(TandemError) as caught:
        Service(Options(data=tmp_path / "data", host=host), FakeTeam)
    (issue,) = caught.value.issues
    assert issue.code == "service.start"
    assert "tandem token add" in str(issue.hint)


def test_one_data_folder_has_one_service(running_service: InProcess) -> None:
    with pytest.raises(TandemError) as caught:
        Service(Options(data=running_service.service.options.data), FakeTeam)
    assert caught.value.issues[0].code == "service.start"


@pytest.mark.parametrize("url", ["mysql://a/b", "no url", "postgresql://u:secret@127.0.0.1:1/none"])
def test_a_database_that_cannot_be_opened_is_told_without_its_password(url: str) -> None:
    with pytest.raises(TandemError) as caught:
        Database(url)
    assert caught.value.issues[0].code == "service.database"
    assert "secret" not in str(caught.value)


def test_what_is_not_installed_is_told_with_the_install_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usual = builtins.__import__

    def without(name: str, *rest: Any) -> Any:
        if name.startswith("planner.service."):
            raise ImportError("no", name="sqlalchemy")
        return usual(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    for ask in (
        lambda: service.serve(service.Serve(data=tmp_path)),
        lambda: service.token(service.List(data=tmp_path)),
    ):
        with pytest.raises(TandemError) as caught:
            ask()
        assert caught.value.issues[0].code == "service.install"
        assert "tandem-planner[service]" in str(caught.value.issues[0].hint)


def test_tokens_are_made_listed_and_revoked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    service.token(service.AddToken(name="ann", data=tmp_path))
    token = capsys.readouterr().out.strip()
    auth = Auth(Database(default_url(tmp_path)))
    assert auth.authenticate_token(token).name == "ann"
    for wrong in ("ann", "", "a b", "x" * 65):
        with pytest.raises(TandemError) as caught:
            service.token(service.AddToken(name=wrong, data=tmp_path))
        assert caught.value.issues[0].code == "service.token"
    service.token(service.Revoke(name="ann", data=tmp_path))
    assert not auth.has_valid_token()
    service.token(service.List(data=tmp_path))
    assert "ann" in capsys.readouterr().out
