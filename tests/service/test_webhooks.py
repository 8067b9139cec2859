"""Webhooks: who is notified that a job has ended, how the message is signed, and failing receivers."""

from __future__ import annotations

import contextlib
import http.server
import json
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import update

from planner.service import webhooks
from planner.service.jobs import record_event
from planner.service.models import DELIVERIES, JOBS, TOKENS, WEBHOOKS, Database, default_url
from planner.service.security import Auth, RefusedError, ServiceLimits
from planner.service.service import Options, Service
from planner.service.webhooks import (
    DueNotification,
    Webhooks,
    WebhookSender,
    check_url,
    send_notification,
    signature,
)
from tests.service import postgres
from tests.service.support import InProcess, issue_codes, named_problem

HOSTS = ("127.0.0.1", "127.0.0.1:9")


class Receiver:
    """A local address that answers as configured and keeps the received requests."""

    def __init__(self) -> None:
        self.got: list[tuple[dict[str, str], str]] = []
        self.answers: list[int] = []
        self.go_on = threading.Event()
        self.go_on.set()
        receiver = self

        class Handler(http.server.BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = self.rfile.read(int(self.headers["Content-Length"])).decode()
                receiver.got.append(({k.lower(): v for k, v in self.headers.items()}, body))
                receiver.go_on.wait(10.0)
                status = receiver.answers.pop(0) if receiver.answers else 204
                self.send_response(status)
                if status == 302:
                    self.send_header("Location", f"{receiver.url}/elsewhere")
                self.send_header("Content-Length", "0")
                self.end_headers()

            def log_message(self, *args: Any) -> None:
                pass

        self._server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.host = f"127.0.0.1:{self._server.server_port}"
        self.url = f"http://{self.host}/hook"
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def wait(self, count: int) -> None:
        until = time.monotonic() + 20.0
        while len(self.got) < count and time.monotonic() < until:
            time.sleep(0.02)
        assert len(self.got) >= count, self.got

    def close(self) -> None:
        self.go_on.set()
        self._server.shutdown()
        self._server.server_close()


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    made = Receiver()
    yield made
    made.close()


@pytest.fixture(autouse=True)
def fast_retries(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(webhooks, "POLL_S", 0.02)
    monkeypatch.setattr(webhooks, "RETRY_WAITS_S", (0.05, 0.05))


@pytest.fixture
def running_service(tmp_path: Path, receiver: Receiver) -> Iterator[InProcess]:
    with InProcess(tmp_path / "data", examiners=1, webhook_hosts=(receiver.host,)) as made:
        yield made


def add_webhook(running_service: InProcess, url: str, **more: Any) -> dict[str, Any]:
    answer = running_service.http.post("/v1/webhooks", json={"url": url}, **more)
    assert answer.status_code == 201, answer.text
    body: dict[str, Any] = answer.json()
    return body


def only_webhook(running_service: InProcess) -> dict[str, Any]:
    (webhook,) = running_service.http.get("/v1/webhooks").json()["webhooks"]
    known: dict[str, Any] = webhook
    return known


def wait_until_delivered(running_service: InProcess) -> dict[str, Any]:
    """Return the only webhook once no message for it is waiting."""
    until = time.monotonic() + 20.0
    while only_webhook(running_service)["waiting"] and time.monotonic() < until:
        time.sleep(0.02)
    return only_webhook(running_service)


def test_the_signature_is_that_of_the_published_example() -> None:
    """Svix's documentation of manual verification, whose scheme Standard Webhooks 1.0 took over."""
    secret = "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw"
    told = signature(secret, "msg_p5jXN8AQM9LWM0D4loKWxJek", 1614265330, '{"test": 2432232314}')
    assert told == "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE="


def test_an_address_is_told_of_a_job_that_has_ended(running_service: InProcess, receiver: Receiver) -> None:
    made = add_webhook(running_service, receiver.url)
    job = running_service.post(named_problem("panel")).json()
    running_service.wait_for_end(job["id"])
    receiver.wait(1)
    headers, body = receiver.got[0]
    data = json.loads(body)
    assert data["type"] == "job.ended"
    assert data["data"] == {"id": job["id"], "name": "panel", "digest": job["digest"], "state": "verified"}
    seconds = int(headers["webhook-timestamp"])
    assert abs(seconds - time.time()) < 60
    assert headers["webhook-signature"] == signature(made["secret"], headers["webhook-id"], seconds, body)
    assert headers["content-type"] == "application/json"
    known = wait_until_delivered(running_service)
    assert (known["outcome"], known["waiting"]) == ("204", 0)
    assert "secret" not in known
    assert len(receiver.got) == 1


def test_one_that_fails_is_told_the_same_again(running_service: InProcess, receiver: Receiver) -> None:
    add_webhook(running_service, receiver.url)
    receiver.answers = [500, 302]
    running_service.wait_for_end(running_service.post(named_problem("panel")).json()["id"])
    receiver.wait(3)
    assert wait_until_delivered(running_service)["outcome"] == "204"
    assert len({headers["webhook-id"] for headers, _ in receiver.got}) == 1
    assert len({body for _, body in receiver.got}) == 1  # nothing was sent elsewhere, either


def test_attempts_come_to_an_end(running_service: InProcess, receiver: Receiver) -> None:
    add_webhook(running_service, receiver.url)
    receiver.answers = [500] * 10
    running_service.wait_for_end(running_service.post(named_problem("panel")).json()["id"])
    receiver.wait(3)
    assert wait_until_delivered(running_service)["outcome"] == "500"
    time.sleep(0.2)
    assert len(receiver.got) == 3


def test_one_that_is_gone_is_off_until_it_is_tried(running_service: InProcess, receiver: Receiver) -> None:
    number = add_webhook(running_service, receiver.url)["id"]
    receiver.answers = [410]
    running_service.wait_for_end(running_service.post(named_problem("one")).json()["id"])
    receiver.wait(1)
    wait_until_delivered(running_service)
    running_service.wait_for_end(running_service.post(named_problem("two")).json()["id"])
    time.sleep(0.2)
    assert len(receiver.got) == 1
    assert only_webhook(running_service)["off"]
    assert running_service.http.post(f"/v1/webhooks/{number}/ping").status_code == 202
    receiver.wait(2)
    assert json.loads(receiver.got[1][1])["type"] == "ping"
    assert "off" not in wait_until_delivered(running_service)


def test_nobody_answers(running_service: InProcess, receiver: Receiver) -> None:
    add_webhook(running_service, receiver.url)
    receiver.close()
    running_service.wait_for_end(running_service.post(named_problem("panel")).json()["id"])
    until = time.monotonic() + 20.0
    while not only_webhook(running_service).get("outcome") and time.monotonic() < until:
        time.sleep(0.02)
    assert only_webhook(running_service)["outcome"] == "no answer"


@pytest.mark.parametrize(
    ("url", "what"),
    [
        ("https://intranet/x", "host is not allowed (got 'intranet', allowed 127.0.0.1, 127"),
        ("http://127.0.0.1:22/x", "got '127.0.0.1:22'"),
        ("https://127.0.0.1:80/x", "got '127.0.0.1:80'"),
        ("https://127.0.0.1:443/x", None),
        ("https://169.254.169.254/latest", "got '169.254.169.254'"),
        ("http://hooks.example.org/x", "got http)"),
        ("ftp://127.0.0.1/x", "got ftp)"),
        ("127.0.0.1/x", "got no scheme)"),
        ("https://127.0.0.1@evil.example/x", "has a user"),
        ("https://evil.example#127.0.0.1", "or fragment"),
        ("https://127.0.0.1.evil.example/", "host is not allowed"),
        ("https://127.0.0.1:99999/", "invalid url"),
        ("https://[::1/", "invalid url"),
        ("https://127.0.0.1/\r\nX: y", "printable ASCII"),
        ("https://127.0.0.1/a b", "printable ASCII"),
        ("https://127.0.0.1/é", "printable ASCII"),
        ("https://127.0.0.1/" + "a" * 480, None),
        ("https://127.0.0.1/" + "a" * 500, "allowed 500 printable"),
        ("", "no scheme"),
    ],
)
def test_other_addresses_are_refused(url: str, what: str | None) -> None:
    if what is None:
        check_url(url, HOSTS)
        return
    with pytest.raises(RefusedError) as error:
        check_url(url, HOSTS)
    assert error.value.status == 422
    assert error.value.issues[0].code == "service.webhook"
    assert what in str(error.value)


def test_refusals_of_the_routes(running_service: InProcess, receiver: Receiver) -> None:
    assert running_service.http.post("/v1/webhooks", json={"url": "https://evil.example/"}).status_code == 422
    assert running_service.http.post("/v1/webhooks", json={"url": receiver.url, "more": 1}).status_code == 422
    assert running_service.http.post("/v1/webhooks", json={}).status_code == 422
    for method, path in (("POST", "/ping"), ("DELETE", "")):
        for number in ("0" * 32, "%00", "x" * 60):
            assert running_service.http.request(method, f"/v1/webhooks/{number}{path}").status_code == 404
    for _ in range(webhooks.MAX_WEBHOOKS):
        number = add_webhook(running_service, receiver.url)["id"]
    full = running_service.http.post("/v1/webhooks", json={"url": receiver.url})
    assert (full.status_code, issue_codes(full)) == (429, [("service.too_many", None)])
    assert running_service.http.delete(f"/v1/webhooks/{number}").status_code == 204
    add_webhook(running_service, receiver.url)


def test_a_service_that_names_no_host_tells_nobody(tmp_path: Path, receiver: Receiver) -> None:
    with InProcess(tmp_path / "data", examiners=1) as running_service:
        answer = running_service.http.post("/v1/webhooks", json={"url": receiver.url})
        assert answer.status_code == 422
        assert "--webhook-host" in answer.text


def test_a_webhook_is_its_owners_alone(tmp_path: Path, receiver: Receiver) -> None:
    data = tmp_path / "data"
    data.mkdir()
    auth = Auth(Database(default_url(data)))
    ann, ben = ({"Authorization": f"Bearer {auth.create_token(name)}"} for name in ("ann", "ben"))
    with InProcess(data, examiners=1, webhook_hosts=(receiver.host,), require_token=True) as running_service:
        number = add_webhook(running_service, receiver.url, headers=ann)["id"]
        assert running_service.http.get("/v1/webhooks", headers=ben).json() == {"webhooks": []}
        assert running_service.http.delete(f"/v1/webhooks/{number}", headers=ben).status_code == 404
        assert running_service.http.post(f"/v1/webhooks/{number}/ping", headers=ben).status_code == 404
        job = running_service.post(named_problem("bens"), headers=ben).json()["id"]
        running_service.wait_for_end(job, headers=ben)
        time.sleep(0.2)
        assert receiver.got == []
        auth.revoke("ann")  # what was about to be told no longer is
        with running_service.service.database.write() as db:
            db.execute(update(JOBS).values(owner=webhook_owner(running_service)))
            record_event(db, job, "state", {"state": "verified"})
        time.sleep(0.2)
        assert receiver.got == []


def webhook_owner(running_service: InProcess) -> str:
    with running_service.service.database.read() as db:
        return str(db.execute(WEBHOOKS.select()).mappings().one()["owner"])


@pytest.mark.parametrize("kind", ["sqlite", "postgres"])
def test_what_ended_before_a_crash_is_told_by_another_host_once(kind: str, tmp_path: Path) -> None:
    """The end of a job and its message are one transaction; only one of two hosts sends it."""
    database = Database(default_url(tmp_path) if kind == "sqlite" else postgres.fresh(tmp_path))
    hooks = Webhooks(database, HOSTS)
    hooks.add("local", "http://127.0.0.1:9/x")
    with pytest.raises(ZeroDivisionError), database.write() as db:
        job_row(db, "1" * 32)
        record_event(db, "1" * 32, "state", {"state": "verified"})
        raise ZeroDivisionError
    assert hooks.claim(()) is None
    with database.write() as db:
        job_row(db, "2" * 32)
        record_event(db, "2" * 32, "state", {"state": "running"})
        record_event(db, "2" * 32, "state", {"state": "infeasible"})
    due = hooks.claim(())
    assert due is not None and json.loads(due.body)["data"]["state"] == "infeasible"
    assert hooks.claim(()) is None  # another host holds it
    with database.write() as db:  # which never tells how it went
        db.execute(update(DELIVERIES).values(due=0.0))
    again = hooks.claim(())
    assert again is not None and (again.id, again.attempt) == (due.id, 2)
    hooks.record_attempt(due, 500, "")  # the first one is late, and moves nothing
    hooks.record_attempt(again, 204, "")
    assert hooks.list("local")[0]["waiting"] == 0
    database.close()


def job_row(db: Any, number: str) -> None:
    row = {"id": number, "owner": "local", "name": "panel", "digest": "d", "key": "k", "processes": "[]"}
    more = {"state": "running", "created": time.time(), "timeout_s": 1.0, "memory_mb": 1.0}
    db.execute(JOBS.insert().values({**row, **more}))


def test_one_owner_who_is_slow_keeps_no_other_waiting(tmp_path: Path) -> None:
    database = Database(default_url(tmp_path))
    hooks = Webhooks(database, HOSTS)
    with database.write() as db:
        for owner in ("slow", "quick"):
            row = {"id": owner, "name": owner, "hash": owner, "role": "plan", "created": time.time()}
            db.execute(TOKENS.insert().values(row))
    for _ in range(6):
        hooks.ping("slow", hooks.add("slow", "http://127.0.0.1:9/slow")["id"])
    hooks.ping("quick", hooks.add("quick", "http://127.0.0.1:9/quick")["id"])
    held, told = threading.Event(), list[str]()

    def send(due: DueNotification, hosts: object) -> tuple[int | None, str]:
        if due.owner == "slow":
            held.wait(20.0)
        told.append(due.owner)
        return 204, ""

    sender = WebhookSender(hooks, send)
    sender.start()
    until = time.monotonic() + 10.0
    while not told and time.monotonic() < until:
        time.sleep(0.02)
    assert told == ["quick"]
    held.set()
    sender.stop()
    database.close()


def test_a_clock_that_is_set_back_holds_nothing_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Messages queued by a clock that was years ahead are sent as soon as the clock is right."""
    database, real = Database(default_url(tmp_path)), time.time
    hooks = Webhooks(database, HOSTS)
    monkeypatch.setattr(time, "time", lambda: real() + 3e8)
    hooks.ping("local", hooks.add("local", "http://127.0.0.1:9/x")["id"])
    monkeypatch.setattr(time, "time", real)
    due = hooks.claim(())
    assert due is not None and json.loads(due.body)["type"] == "ping"
    hooks.record_attempt(due, 500, "")
    assert hooks.claim(()) is None  # the next attempt is due later
    database.close()


def test_what_nobody_tells_is_forgotten(tmp_path: Path) -> None:
    service = Service(Options(tmp_path / "data", limits=ServiceLimits(), webhook_hosts=HOSTS), lambda: None)  # type: ignore[arg-type,return-value]
    service.webhooks.ping("local", service.webhooks.add("local", "http://127.0.0.1:9/x")["id"])
    with service.database.write() as db:
        webhooks.drop_old_deliveries(service.database, db)
    assert service.webhooks.list("local")[0]["waiting"] == 1
    with service.database.write() as db:
        db.execute(update(DELIVERIES).values(due=time.time() - webhooks.MAX_PENDING_AGE_S - 1.0))
        webhooks.drop_old_deliveries(service.database, db)
    assert service.webhooks.list("local")[0]["waiting"] == 0
    service.close()


def test_an_address_whose_host_is_no_longer_named_is_told_nothing() -> None:
    due = DueNotification("msg_1", "w", "local", "http://127.0.0.1:9/x", "whsec_" + "A" * 44, "{}", 1)
    status, why = send_notification(due, ())
    assert status is None and "--webhook-host" in why


def test_an_address_that_answers_a_byte_at_a_time_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(webhooks, "ANSWER_TIMEOUT_S", 1.0)
    with socket.create_server(("127.0.0.1", 0)) as server:

        def drip() -> None:
            link, _ = server.accept()
            with link, contextlib.suppress(OSError):
                link.sendall(b"HTTP/1.1 200 OK\r\nX-A: ")
                for _ in range(200):
                    link.sendall(b"a")
                    time.sleep(0.1)

        threading.Thread(target=drip, daemon=True).start()
        host = f"127.0.0.1:{server.getsockname()[1]}"
        begun = time.monotonic()
        due = DueNotification("msg_1", "w", "local", f"http://{host}/x", "whsec_" + "A" * 44, "{}", 1)
        assert send_notification(due, (host,)) == (None, "no answer")
        assert time.monotonic() - begun < 10.0
