"""The log as lines of JSON: what each line contains, and what no line may contain."""

from __future__ import annotations

import datetime as dt
import io
import json
import logging
import re
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from planner.service import logs
from planner.service.jobs import Jobs
from planner.service.models import Database, default_url
from planner.service.security import Auth
from tests.service.support import InProcess, Process, named_problem

RFC_3339 = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z")
"""Section 5.6 of RFC 3339, in UTC with thousandths."""


class LoggedService(InProcess):
    """A service with tokens, whose log is kept."""

    def __init__(self, data: Path, token: str) -> None:
        super().__init__(data, examiners=1, require_token=True)
        self.written = io.StringIO()
        self.token = token
        self.http.headers["Authorization"] = f"Bearer {token}"
        logs.write_json(data, self.written)

    @property
    def lines(self) -> list[dict[str, Any]]:
        return [json.loads(line) for line in self.written.getvalue().splitlines()]

    def lines_of_request(self, request: str) -> list[dict[str, Any]]:
        return [line for line in self.lines if line.get("request") == request]


@pytest.fixture(scope="module")
def running_service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LoggedService]:
    data = tmp_path_factory.mktemp("logs") / "data"
    data.mkdir()
    root, own = logging.getLogger(), logging.getLogger("planner.service")
    before = (list(root.handlers), root.level, own.level)
    with LoggedService(data, Auth(Database(default_url(data))).create_token("ann")) as made:
        yield made
    root.handlers[:], root.level, own.level = before


def test_a_request_is_a_line_with_its_jobs(running_service: LoggedService) -> None:
    answer = running_service.post(named_problem("told"), headers={"X-Request-Id": "from-a-proxy:1.2_3"})
    job = answer.json()["id"]
    assert answer.headers["x-request-id"] == "from-a-proxy:1.2_3"
    (line,) = running_service.lines_of_request("from-a-proxy:1.2_3")
    assert RFC_3339.fullmatch(line["time"])
    assert abs(dt.datetime.fromisoformat(line["time"]).timestamp() - time.time()) < 60
    assert (line["level"], line["method"], line["path"], line["status"]) == ("info", "POST", "/v1/jobs", 201)
    assert line["jobs"] == [job]
    assert 0 <= line["seconds"] < 600
    running_service.wait_for_end(job)
    about = [
        item["message"]
        for item in running_service.lines
        if item.get("jobs") == [job] and "request" not in item
    ]
    assert about == [f"job {job} starts, attempt 1", f"job {job} ended: verified"]
    response = running_service.http.get(f"/v1/jobs/{job}/files")
    (line,) = running_service.lines_of_request(response.headers["x-request-id"])
    assert line["jobs"] == [job]


def test_a_line_names_so_many_jobs_at_most() -> None:
    """However many the request is about at once, and each once."""
    formatter = logs.JsonLinesFormatter({})
    record = logging.LogRecord("planner.service", logging.INFO, "", 1, "told", (), None)
    before = logs._REQUEST.set(logs._LoggedRequest("r"))
    try:
        logs.record_jobs("a", "b", "a")
        assert json.loads(formatter.format(record))["jobs"] == ["a", "b"]
        logs.record_jobs(*(f"j{number}" for number in range(10_000)))
        logs.record_jobs("late")
        told = json.loads(formatter.format(record))["jobs"]
    finally:
        logs._REQUEST.reset(before)
    assert told == ["a", "b", *(f"j{number}" for number in range(98))]
    logs.record_jobs("of no request")


@pytest.mark.parametrize(
    ("message", "masked_message"),
    [
        (
            "postgresql://db/x?password=s3cret&sslmode=require",
            "postgresql://db/x?password=(password)&sslmode=require",
        ),
        ("postgresql://u:s3cret@db/x?sslpassword=s3cret", "postgresql://db/x?sslpassword=(password)"),
        ("host=db PASSWORD=s3cret;s3cret, user=u", "host=db PASSWORD=(password) user=u"),
        (r"password = 's3cret \' s3cret' dbname=x", "password = (password) dbname=x"),
        ("password='s3cret s3cret", "password=(password)"),
        ("the password is wrong", "the password is wrong"),
    ],
)
def test_passwords_of_databases_are_not_told(message: str, masked_message: str) -> None:
    record = logging.LogRecord("planner.service", logging.ERROR, "", 1, "%s", (message,), None)
    assert json.loads(logs.JsonLinesFormatter({}).format(record))["message"] == masked_message


@pytest.mark.parametrize(
    "given", [[], [b""], [b"a" * 10_000], [b"<script>"], [b"a\tb"], ["ä".encode()], [b"a", b"b"], [b"-"]]
)
def test_an_identifier_that_is_none_is_replaced(running_service: LoggedService, given: list[bytes]) -> None:
    headers = [(b"X-Request-Id", item) for item in given]
    answer = running_service.http.get("/v1/health", headers=headers)
    assert re.fullmatch("[0-9a-f]{32}", answer.headers["x-request-id"])
    assert len(running_service.lines_of_request(answer.headers["x-request-id"])) == 1


def test_refusals_and_faults_have_it_too(
    running_service: LoggedService, monkeypatch: pytest.MonkeyPatch
) -> None:
    for status, more in ((404, {"url": "/nowhere"}), (403, {"url": "/v1/jobs", "method": "POST"})):
        request = {
            "method": "GET",
            "headers": {"X-Request-Id": f"r{status}", "Origin": "http://evil"},
            **more,
        }
        answer = running_service.http.request(**request)
        assert (answer.status_code, answer.headers["x-request-id"]) == (status, f"r{status}")
        assert [line["status"] for line in running_service.lines_of_request(f"r{status}")] == [status]

    def fail(*arguments: object) -> None:
        root = running_service.service.files.root
        secret = f"postgresql://tandem:pass@db/x {running_service.token} {root}/ab and /etc/tandem/key"
        try:
            raise OSError(2, "no such file", "/srv/secret/place.txt")
        except OSError as error:
            raise RuntimeError(secret) from error

    monkeypatch.setattr(Jobs, "page", fail)
    answer = running_service.http.get("/v1/jobs?limit=3", headers={"X-Request-Id": "broken"})
    assert (answer.status_code, answer.headers["x-request-id"]) == (500, "broken")
    fault, request = sorted(running_service.lines_of_request("broken"), key=lambda line: line["level"])
    assert (request["status"], fault["level"]) == (500, "error")
    assert fault["message"] == "GET /v1/jobs failed"
    assert [item["type"] for item in fault["errors"]] == ["RuntimeError", "FileNotFoundError"]
    assert fault["errors"][0]["message"] == "postgresql://db/x (token) (data)/files/ab and (path)"
    assert "planner.service.routes:page:" in str(fault["errors"][0]["trace"])


def test_no_line_has_a_token_a_query_or_a_place(running_service: LoggedService) -> None:
    """Wherever a user may put them."""
    token = running_service.token
    running_service.http.get(f"/v1/jobs/{token}", headers={"X-Request-Id": token})
    running_service.http.get(f"/v1/jobs?state={token}")
    running_service.http.get("/v1/jobs/x%0A%7B%22level%22:%22error%22%7D")
    running_service.http.get("/v1/jobs", headers={"Authorization": f"Bearer {token[:-1]}"})
    running_service.http.cookies.set("tandem_session", "c00k1e")
    running_service.http.get("/v1/jobs", headers={"Authorization": ""})
    running_service.http.cookies.clear()
    logging.getLogger("uvicorn.error").error("cannot open %s", running_service.service.scratch / "upload")
    text = running_service.written.getvalue()
    assert len(running_service.lines) == len(text.splitlines())  # a line is a line, whatever a path has
    assert all({"time", "level", "logger", "message"} <= line.keys() for line in running_service.lines)
    for secret in (token[24:], "c00k1e", str(running_service.service.options.data.resolve()), "?", "state="):
        assert secret not in text


def test_the_command_writes_nothing_but_json(tmp_path: Path) -> None:
    process = Process(tmp_path / "data", "--log", "json").wait()
    request = urllib.request.Request(f"{process.url}/v1/nothing", headers={"X-Request-Id": "mine"})
    with pytest.raises(urllib.error.HTTPError) as refused:
        urllib.request.urlopen(request)
    assert refused.value.headers["X-Request-Id"] == "mine"
    assert process.stop() == 0
    text = process.log.read_text()
    lines = [json.loads(line) for line in text.splitlines()]
    assert [line["path"] for line in lines if line.get("request") == "mine"] == ["/v1/nothing"]
    assert any("Uvicorn running" in line["message"] for line in lines)
    assert str(tmp_path) not in text
