"""The Python client against a real service with a real worker: it returns what local planning returns."""

from __future__ import annotations

import http.server
import signal
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import planner
from planner import Client, plans
from planner.issues import TandemError
from planner.service.models import Database, default_url
from planner.service.security import Auth
from tests import small_problem
from tests.service.support import Process


@pytest.fixture(scope="module")
def server_process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Process, str]]:
    data = tmp_path_factory.mktemp("client") / "data"
    data.mkdir()
    database = Database(default_url(data))
    token = Auth(database).create_token("ann")
    database.close()
    process = Process(data, "--require-token").wait()
    yield process, token
    assert process.stop() in (0, -signal.SIGTERM), process.log.read_text()


def test_the_same_plan_comes_back_as_from_planning_here(
    server_process: tuple[Process, str], tmp_path: Path
) -> None:
    process, token = server_process
    problem = planner.load(small_problem.write(tmp_path))
    events: list[str] = []
    there = Client(process.url, token).plan(problem, lambda stage, fraction: events.append(stage))
    local_outcome = planner.plan(problem)
    assert there.verified
    assert isinstance(there, planner.Outcome)
    assert dict(there.programs) == dict(local_outcome.programs)
    assert plans.dump(there.plan) == plans.dump(local_outcome.plan)
    np.testing.assert_array_equal(
        there.plan.operations[0].q["left"], local_outcome.plan.operations[0].q["left"]
    )
    assert there.proof.rules == local_outcome.proof.rules
    assert there.issues == local_outcome.issues
    assert "motion" in events
    there.save(tmp_path / "there")
    local_outcome.save(tmp_path / "here")
    for path in (tmp_path / "here").rglob("*"):
        if path.is_file():
            other = tmp_path / "there" / path.relative_to(tmp_path / "here")
            assert other.read_bytes() == path.read_bytes(), path


def test_a_problem_without_a_plan_raises_its_issues(
    server_process: tuple[Process, str], tmp_path: Path
) -> None:
    process, token = server_process
    far = "\n".join([small_problem.COLUMNS, *(row.replace("450,", "4500,") for row in small_problem.ROWS)])
    problem = planner.load(small_problem.write(tmp_path, table=far))
    client = Client(process.url, token)
    with pytest.raises(TandemError) as caught:
        client.plan(problem)
    assert "motion.no_reach" in [issue.code for issue in caught.value.issues]
    assert "motion.no_reach" in [issue.code for issue in client.check(problem)]
    (job,) = [job for job in client.jobs() if job["state"] == "infeasible"]
    assert "report.html" in client.files(job["id"])
    client.delete(job["id"])
    with pytest.raises(TandemError) as caught:
        client.job(job["id"])
    assert caught.value.issues[0].code == "service.unknown_job"


def test_refusals_raise_their_issues(server_process: tuple[Process, str]) -> None:
    process, token = server_process
    with pytest.raises(TandemError) as caught:
        list(Client(process.url, token[:-2] + "xx").jobs())
    assert caught.value.issues[0].code == "service.token"


class Other(http.server.BaseHTTPRequestHandler):
    """Something that is no Tandem."""

    def do_GET(self) -> None:
        self.send_response(200 if "jobs/a" in self.path else 500)
        self.end_headers()
        self.wfile.write(b"[1]" if self.path.endswith("aa") else b"<html>")

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002
        pass


def test_what_is_no_tandem_is_told() -> None:
    with http.server.HTTPServer(("127.0.0.1", 0), Other) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        url = f"http://127.0.0.1:{server.server_port}"
        for job in ("a", "aa", "b"):
            with pytest.raises(TandemError) as caught:
                Client(url).job(job)
            assert caught.value.issues[0].code == "service.answer"
        server.shutdown()
    for wrong in ("http://127.0.0.1:1", "file:///etc/passwd", "nonsense"):
        with pytest.raises(TandemError) as caught:
            Client(wrong).job("a")
        assert caught.value.issues[0].code == "service.answer"


@pytest.mark.long
def test_a_service_plans_on_a_cluster(tmp_path: Path) -> None:
    """The same programs from a real scheduler and worker of Dask."""
    process = Process(tmp_path / "data", "--cluster", "local").wait()
    try:
        problem = planner.load(small_problem.write(tmp_path))
        there = Client(process.url).plan(problem)
        assert there.verified
        assert dict(there.programs) == dict(planner.plan(problem).programs)
    finally:
        process.stop()
