"""Requests that are sent again with the same key create nothing new.

Tested one after the other, at once, after a crash, and over a connection that breaks; also every invalid key.
"""

from __future__ import annotations

import contextlib
import http.server
import threading
import urllib.error
import urllib.request
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import select, update

import planner
from planner import Client
from planner.issues import TandemError
from planner.service import idempotency, tandem_client
from planner.service.job_search import JobFilter
from planner.service.jobs import Jobs, NewJob
from planner.service.models import KEYS, Database, default_url
from planner.service.security import Auth, ServiceLimits
from tests import small_problem
from tests.service import postgres
from tests.service.support import InProcess, Process, free_port, issue_codes, named_problem
from tests.service.test_elements import ElementService

REFUSED = [("service.idempotency", "Idempotency-Key")]


@pytest.fixture(scope="module")
def running_service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[InProcess]:
    with InProcess(tmp_path_factory.mktemp("service") / "data", examiners=1) as made:
        yield made


def key(value: str) -> dict[str, str]:
    return {"Idempotency-Key": value}


def job_ids(running_service: InProcess, name: str) -> list[str]:
    """Return the ids of all jobs with a name."""
    return [
        job["id"]
        for job in running_service.http.get("/v1/jobs?limit=200").json()["jobs"]
        if job["name"] == name
    ]


def test_the_same_request_makes_one_job_and_has_its_answer(running_service: InProcess) -> None:
    first = running_service.post(named_problem("once"), headers=key("a-1"))
    running_service.wait_for_end(first.json()["id"])
    again = running_service.post(named_problem("once"), headers=key("a-1"))  # the form has another boundary
    assert (first.status_code, again.status_code) == (201, 201)
    assert again.json()["id"] == first.json()["id"]
    assert (again.json()["state"], again.json()["from_store"]) == ("verified", False)
    assert job_ids(running_service, "once") == [first.json()["id"]]
    other = running_service.post(named_problem("once"), headers=key("a-2")).json()
    assert other["id"] != first.json()["id"]
    assert running_service.post(named_problem("once")).json()["id"] not in (other["id"], first.json()["id"])


def test_another_request_with_the_same_key_is_refused(running_service: InProcess) -> None:
    made = running_service.post(named_problem("first"), headers=key("b")).json()["id"]
    for other in (
        running_service.post(named_problem("second"), headers=key("b")),
        running_service.post(named_problem("first"), headers=key("b"), params={"timeout_s": 100}),
        running_service.http.post("/v1/jobs", json={"tandem": 1}, headers=key("b")),
        running_service.http.post(
            "/v1/jobs",
            files=[("problem", ("p.yaml", named_problem("first"))), ("files", ("targets.csv", b"other"))],
            headers=key("b"),
        ),
    ):
        assert (other.status_code, issue_codes(other)) == (422, REFUSED)
        assert "Repeat that request" in other.json()["issues"][0]["message"]
    assert job_ids(running_service, "second") == []
    assert running_service.post(named_problem("first"), headers=key("b")).json()["id"] == made


@pytest.mark.parametrize(
    "given", [[b""], [b"k" * 10_000], [b"k" * 256], [b"two words"], ["schlüssel".encode()], [b"a", b"b"]]
)
def test_keys_that_are_none(running_service: InProcess, given: list[bytes]) -> None:
    answer = running_service.post(headers=[(b"Idempotency-Key", item) for item in given])
    assert (answer.status_code, issue_codes(answer)) == (422, REFUSED)
    (issue,) = answer.json()["issues"]
    assert len(issue["message"]) < 250
    assert "1 to 255 printable ASCII" in issue["message"]


def test_a_key_with_markup_is_a_key_and_nobody_keeps_it(running_service: InProcess) -> None:
    markup = "<img/src=x>'--\"{}%00"
    made = running_service.post(named_problem("markup"), headers=key(markup)).json()["id"]
    assert running_service.post(named_problem("markup"), headers=key(markup)).json()["id"] == made
    other = running_service.post(named_problem("else"), headers=key(markup))
    assert issue_codes(other) == REFUSED
    assert "<img" not in other.text
    with running_service.service.database.read() as db:
        kept = db.execute(select(KEYS.c.hash, KEYS.c.content)).all()
    assert all(len(value) == 64 for row in kept for value in row)


def test_what_was_refused_keeps_no_key(running_service: InProcess) -> None:
    assert running_service.post("tandem: 1", headers=key("c")).status_code == 422
    assert running_service.post(named_problem("right"), headers=key("c")).status_code == 201


def test_keys_go_with_their_jobs_and_by_age(running_service: InProcess) -> None:
    first = running_service.post(named_problem("gone"), headers=key("d")).json()["id"]
    running_service.wait_for_end(first)
    running_service.http.delete(f"/v1/jobs/{first}")
    with running_service.service.database.read() as db:
        assert db.execute(select(KEYS).where(KEYS.c.job == first)).all() == []
    second = running_service.post(named_problem("gone"), headers=key("d")).json()["id"]
    assert second != first

    def aged_key(seconds: float) -> str:
        with running_service.service.database.write() as db:
            db.execute(update(KEYS).where(KEYS.c.job == second).values(created=KEYS.c.created - seconds))
            idempotency.delete_old_keys(running_service.service.database, db)
        return str(running_service.post(named_problem("gone"), headers=key("d")).json()["id"])

    assert aged_key(-7 * 86400.0) == second  # the clock jumped back: it stays
    assert aged_key(7 * 86400.0) == second
    assert aged_key(idempotency.MIN_KEY_AGE_S - 60.0) == second
    assert aged_key(120.0) != second


def test_keys_belong_to_their_token(tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    auth = Auth(Database(default_url(tmp_path / "data")))
    ann, bob = (
        {"Authorization": f"Bearer {auth.create_token(name)}", **key("same")} for name in ("ann", "bob")
    )
    with InProcess(tmp_path / "data", examiners=1, require_token=True) as running_service:
        first = running_service.post(named_problem("hers"), headers=ann).json()["id"]
        other = running_service.post(named_problem("his"), headers=bob)
        assert other.status_code == 201
        assert running_service.post(named_problem("hers"), headers=ann).json()["id"] == first
        assert running_service.http.get(f"/v1/jobs/{first}", headers=bob).status_code == 404


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_at_once_they_make_one_job(tmp_path: Path, kind: str) -> None:
    """As routes ask the store, which has read each request by itself: none of them knows of the others."""
    database = Database(default_url(tmp_path) if kind == "sqlite" else postgres.fresh(tmp_path))
    jobs, asked = Jobs(database, ServiceLimits()), idempotency.hashed_key("ann", "e", "jobs", "parts")
    together = threading.Barrier(8)

    def send(number: int) -> list[str]:
        digest = f"{number:064d}"
        news = [NewJob("ann", f"n{number}", digest, digest, (), {}, 60.0, 1000.0) for _ in range(2)]
        together.wait()
        return [job.id for job in jobs.create_all(news, asked)]

    with ThreadPoolExecutor(8) as pool:
        answers = list(pool.map(send, range(8)))
    assert all(answer == answers[0] for answer in answers)
    assert [job.id for job in jobs.created_before(asked)] == answers[0]
    assert len(jobs.page(["ann"], JobFilter(), 50)[0]) == len(answers[0]) == 2
    database.close()


def test_a_crash_before_or_after_the_jobs_are_stored(
    running_service: InProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between jobs and their key there is no moment: whatever fails, there are both or neither."""
    whole = Jobs.create_all

    def crash_after(self: Jobs, *arguments: Any) -> Any:
        whole(self, *arguments)
        raise RuntimeError("crashed")

    with monkeypatch.context() as crash:
        crash.setattr(idempotency, "record_jobs", lambda *asked: 1 / 0)
        assert running_service.post(named_problem("crash"), headers=key("f")).status_code == 500
    assert job_ids(running_service, "crash") == []
    with monkeypatch.context() as crash:
        crash.setattr(Jobs, "create_all", crash_after)
        assert running_service.post(named_problem("crash"), headers=key("f")).status_code == 500
    (made,) = job_ids(running_service, "crash")
    assert running_service.post(named_problem("crash"), headers=key("f")).json()["id"] == made
    assert job_ids(running_service, "crash") == [made]


class LossyProxy(http.server.ThreadingHTTPServer):
    """A proxy that forwards requests to a service and loses answers.

    The next ``lost`` answers to POST are dropped. Before the first of them is lost, the service is killed and
    restarted if requested.
    """

    def __init__(self, to: str, lost: int, between: Any = None) -> None:
        super().__init__(("127.0.0.1", free_port()), _PassThroughHandler)
        self.to, self.lost, self.between = to, lost, between
        self.posts: list[int] = []


class _PassThroughHandler(http.server.BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        self._pass(None)

    def do_POST(self) -> None:
        self._pass(self.rfile.read(int(self.headers["Content-Length"])))

    def _pass(self, body: bytes | None) -> None:
        assert isinstance(self.server, LossyProxy)
        sent = {name: value for name, value in self.headers.items() if name.lower() != "host"}
        request = urllib.request.Request(f"{self.server.to}{self.path}", body, sent, method=self.command)
        try:
            with urllib.request.urlopen(request, timeout=60) as answer:
                status, content = answer.status, answer.read()
        except urllib.error.HTTPError as refused:
            status, content = refused.code, refused.read()
        if body is not None:
            self.server.posts.append(status)
            if self.server.lost:
                self.server.lost -= 1
                if self.server.between is not None:
                    self.server.between()
                self.close_connection = True
                return  # no answer at all
        self.send_response(status)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *arguments: Any) -> None:
        pass


@contextlib.contextmanager
def lossy_proxy(to: str, lost: int, between: Any = None) -> Iterator[tuple[LossyProxy, str]]:
    server = LossyProxy(to, lost, between)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield server, f"http://127.0.0.1:{server.server_address[1]}"
    finally:
        server.shutdown()
        server.server_close()


@pytest.mark.long
def test_the_client_sends_again_what_was_lost_also_over_a_kill(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The service accepts the job and is killed before the client gets the answer."""
    data = tmp_path / "data"
    monkeypatch.setattr(tandem_client, "PAUSES_S", (0.01, 0.01))
    process = Process(data, module="tests.service.fake_team", arguments=(str(data), "")).wait()
    running = [process]

    def kill() -> None:
        running.pop().kill()
        arguments = (str(data), "")
        running.append(
            Process(data, port=process.port, module="tests.service.fake_team", arguments=arguments).wait()
        )

    problem = planner.load(small_problem.write(tmp_path))
    with lossy_proxy(process.url, 1, kill) as (server, url):
        client = Client(url)
        job = client.submit(problem)
        assert server.posts == [201, 201]
    assert [item["id"] for item in client_jobs(process.url)] == [job]
    with lossy_proxy(process.url, 99) as (server, url), pytest.raises(TandemError, match="does not answer"):
        Client(url).submit(problem, key="mine")
    assert server.posts == [201] * 3  # as often as there are pauses, and no more
    assert len(client_jobs(process.url)) == 2
    with lossy_proxy(process.url, 99) as (server, url), pytest.raises(TandemError):
        client = Client(url)
        client._want(1)
        client._api = 5  # a service that knows no keys
        client.submit(problem)
    assert server.posts == [201]
    assert len(client_jobs(process.url)) == 3
    assert Client(process.url).submit(problem, key="mine") in {
        item["id"] for item in client_jobs(process.url)
    }
    assert len(client_jobs(process.url)) == 3
    running.pop().stop()


def client_jobs(url: str) -> list[dict[str, Any]]:
    return list(Client(url).jobs())


@pytest.mark.long
def test_elements_are_divided_planned_and_reported_on_once(tmp_path: Path) -> None:
    limits = ServiceLimits(open_jobs=10)
    with ElementService(tmp_path / "data", limits, examiners=1, workers=4) as running_service:

        def post(path: str, value: str, **more: Any) -> Any:
            answer = running_service.http.post(path, headers=key(value), **more)
            assert answer.status_code == 201, answer.text
            return answer.json()

        running_service.http.headers.update(key("shell"))
        first, second = (running_service.upload(tmp_path, name="dome").json() for _ in range(2))
        del running_service.http.headers["Idempotency-Key"]
        assert first["id"] == second["id"]
        assert "fields" in second
        assert "panels" not in second
        running_service.wait_for_division(first["id"])
        fields = {"fields": {"panels.hexagons.count": 26}}
        divide = f"/v1/elements/{first['id']}/divide?instead=true"
        other = post(divide, "divide", json=fields)
        assert running_service.http.get(f"/v1/elements/{first['id']}").status_code == 404
        assert post(divide, "divide", json=fields)["id"] == other["id"]
        assert [item["id"] for item in running_service.http.get("/v1/elements").json()["elements"]] == [
            other["id"]
        ]
        running_service.wait_for_division(other["id"])
        own = f"/v1/elements/{other['id']}"
        jobs = post(f"{own}/plan", "plan", json={"panels": ["A01", "A02"]})["jobs"]
        again = post(f"{own}/plan", "plan", json={"panels": ["A01", "A02"]})["jobs"]
        assert [item["id"] for item in again] == [item["id"] for item in jobs]
        assert len(jobs) == 2
        wrong = running_service.http.post(f"{own}/plan", json={"panels": ["A03"]}, headers=key("plan"))
        assert issue_codes(wrong) == REFUSED
        for item in jobs:
            running_service.wait_for_end(item["id"])
        report = post(f"{own}/report", "report")
        running_service.wait_for_end(report["id"])
        assert post(f"{own}/report", "report")["id"] == report["id"]
        assert post(f"{own}/report", "another")["id"] != report["id"]
