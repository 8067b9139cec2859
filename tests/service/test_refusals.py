"""Refusals are problem documents (RFC 9457) wherever they come from. Clients read them and other formats."""

from __future__ import annotations

import http.server
import json
import threading
from collections.abc import Iterator
from http import HTTPStatus
from pathlib import Path
from typing import Any

import jsonschema_rs
import pytest
from sqlalchemy.exc import OperationalError

from planner import Client
from planner.issues import TandemError
from planner.service import tandem_client
from planner.service.jobs import Jobs
from tests.service.support import InProcess, named_problem

DOCUMENT = {
    "type": "object",
    "required": ["type", "title", "status", "detail", "issues"],
    "properties": {
        "type": {"const": "about:blank"},
        "title": {"type": "string"},
        "status": {"type": "integer", "minimum": 400, "maximum": 599},
        "detail": {"type": "string", "minLength": 1},
        "issues": {"type": "array", "minItems": 1, "items": {"required": ["code", "message", "severity"]}},
    },
}
"""Members of section 3.1 of RFC 9457, and our own."""


@pytest.fixture(scope="module")
def running_service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[InProcess]:
    with InProcess(tmp_path_factory.mktemp("service") / "data", examiners=1) as made:
        yield made


def test_every_refusal_is_a_problem_document(
    running_service: InProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of routes, of the framework, of what stands before it, and of faults."""
    answers = {
        404: running_service.http.get(f"/v1/jobs/{'0' * 32}"),
        405: running_service.http.put("/v1/jobs"),
        422: running_service.http.get("/v1/jobs", params={"limit": "many"}),
        403: running_service.http.get("/v1/jobs", headers={"Host": "other.example"}),
        413: running_service.http.post("/v1/jobs", headers={"Content-Length": "999999999999"}),
        401: running_service.http.get("/v1/jobs", headers={"Authorization": "Basic YTpi"}),
    }
    with monkeypatch.context() as broken:
        broken.setattr(Jobs, "page", lambda *asked: 1 / 0)
        answers[500] = running_service.http.get("/v1/jobs")

        def away(*arguments: object) -> None:
            raise OperationalError("SELECT", {}, Exception("away"))

        broken.setattr(Jobs, "page", away)
        answers[503] = running_service.http.get("/v1/jobs")
    check = jsonschema_rs.validator_for(DOCUMENT)
    for status, answer in answers.items():
        body = answer.json()
        assert (answer.status_code, body["status"]) == (status, status)
        assert answer.headers["content-type"] == "application/problem+json"
        assert check.is_valid(body), body
        assert body["title"] == HTTPStatus(status).phrase
        assert body["detail"] == "; ".join(issue["message"] for issue in body["issues"])


def test_the_description_says_so(running_service: InProcess) -> None:
    document = running_service.http.get("/openapi.json").json()
    answers = [
        (status, answer)
        for path in document["paths"].values()
        for method in path.values()
        for status, answer in method["responses"].items()
    ]
    refusals = [answer["content"] for status, answer in answers if status[0] == "4" and status != "416"]
    assert len(refusals) > 50
    assert all(list(content) == ["application/problem+json"] for content in refusals)
    body = running_service.http.get(f"/v1/jobs/{'0' * 32}").json()
    whole = {"$ref": "#/components/schemas/Refusal", "components": document["components"]}
    assert jsonschema_rs.validator_for(whole).is_valid(body)
    assert not jsonschema_rs.validator_for(whole).is_valid({"issues": body["issues"]})


class FixedAnswerHandler(http.server.BaseHTTPRequestHandler):
    """Health as of a service, and one refusal for all else."""

    body = b""
    kind = ""

    def do_GET(self) -> None:
        health = self.path == "/v1/health"
        body = b'{"version": "1", "api": 6, "api_oldest": 1}' if health else self.body
        self.send_response(200 if health else 409)
        self.send_header("Content-Type", "application/json" if health else self.kind)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *arguments: Any) -> None:
        pass


ISSUE = {"code": "service.state", "severity": "error", "message": "it runs"}


@pytest.mark.parametrize(
    ("kind", "body", "code", "expected_text"),
    [
        ("application/json", {"issues": [ISSUE]}, "service.state", "it runs"),  # services of before
        ("application/problem+json", {"status": 409, "issues": [ISSUE]}, "service.state", "it runs"),
        ("application/problem+json", {"title": "Busy", "detail": "later"}, "service.answer", "(Busy: later)"),
        ("application/problem+json", {"title": 3, "issues": 4}, "service.answer", "status 409. Is it"),
        ("text/html", "<html>", "service.answer", "status 409. Is it"),
        ("application/json", [], "service.answer", "status 409. Is it"),
    ],
)
def test_clients_read_both_and_what_proxies_say(kind: str, body: Any, code: str, expected_text: str) -> None:
    text = body if isinstance(body, str) else json.dumps(body)
    own = type("Own", (FixedAnswerHandler,), {"body": text.encode(), "kind": kind})
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), own) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        url = f"http://127.0.0.1:{server.server_address[1]}"
        for client in (Client(url), tandem_client.Client(url)):
            with pytest.raises((TandemError, tandem_client.TandemError)) as caught:
                client.job("0" * 32)
            (issue,) = caught.value.issues
            assert issue.code == code
            assert expected_text in issue.message
        server.shutdown()


def test_what_a_problem_gets_wrong_is_all_there(running_service: InProcess, tmp_path: Path) -> None:
    answer = running_service.post(named_problem("wrong").replace("size_mm", "sise_mm"))
    body = answer.json()
    assert answer.status_code == body["status"] == 422
    assert {issue["field"] for issue in body["issues"]} >= {"stock.sise_mm"}
    assert len(body["issues"]) >= 2
