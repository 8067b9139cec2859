"""What HTTP requires of every answer (RFC 9110, RFC 6797), and what the documented proxy passes on."""

from __future__ import annotations

import gzip
import io
import operator
import socket
import time
import zipfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import anyio
import pytest
from fastapi.testclient import TestClient
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from planner.service import security
from planner.service.http_responses import HEADER_TIMEOUT_S
from planner.service.jobs import put_files
from planner.service.models import Database, default_url
from planner.service.security import Auth, ServiceLimits
from planner.service.upload_reader import mesh_size
from tests.service.support import BASE_URL, InProcess, Process, named_problem

TLS = {"X-Forwarded-Proto": "https", "X-Forwarded-For": "203.0.113.9"}


@pytest.fixture(scope="module")
def service_with_job(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[InProcess, str]]:
    """A service, and the address of a job that has ended."""
    with InProcess(
        tmp_path_factory.mktemp("answers") / "data", ServiceLimits(check_s=60), examiners=1
    ) as running_service:
        job = running_service.post(named_problem("answers")).json()["id"]
        running_service.wait_for_end(job)
        yield running_service, f"/v1/jobs/{job}"


@pytest.fixture(scope="module")
def closed_service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[InProcess, str]]:
    """A service behind a proxy, and a token."""
    data = tmp_path_factory.mktemp("proxied") / "data"
    data.mkdir()
    token = Auth(Database(default_url(data))).create_token("ann")
    with InProcess(data, ServiceLimits(check_s=60), examiners=1, require_token=True) as running_service:
        yield running_service, token


class AddressApp:
    """The application as a client at that address reaches it."""

    def __init__(self, app: ASGIApp, address: str) -> None:
        self.app, self.address = app, address

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        await self.app({**scope, "client": (self.address, 1234)}, receive, send)


@pytest.mark.parametrize("path", ["", "/files", "/files/report.html", "/programs.zip", "/events"])
def test_head_tells_what_get_tells_without_a_body(service_with_job: tuple[InProcess, str], path: str) -> None:
    running_service, job = service_with_job
    head, get = running_service.http.head(job + path), running_service.http.get(job + path)
    assert (head.status_code, head.content) == (200, b"")
    for name in ("content-type", "content-length", "etag", "cache-control"):
        assert head.headers.get(name) == get.headers.get(name), name
    assert running_service.http.head("/v1/jobs/nothing").status_code == 404
    assert running_service.http.head("/").status_code == 200


@pytest.mark.parametrize(
    ("method", "path", "allowed"),
    [
        ("PUT", "/v1/jobs", "GET, HEAD, POST"),
        ("PUT", "", "DELETE, GET, HEAD, PATCH"),
        ("GET", "/cancel", "POST"),
        ("POST", "/v1/health", "GET, HEAD"),
    ],
)
def test_a_wrong_method_is_told_all_right_ones(
    service_with_job: tuple[InProcess, str], method: str, path: str, allowed: str
) -> None:
    running_service, job = service_with_job
    answer = running_service.http.request(method, path if path.startswith("/v1") else job + path)
    assert answer.status_code == 405
    assert answer.headers["allow"] == allowed
    assert f"allowed {allowed}" in answer.json()["issues"][0]["message"]


@pytest.mark.parametrize("path", ["/files/report.html", "/programs.zip"])
def test_what_a_browser_has_is_not_sent_again(service_with_job: tuple[InProcess, str], path: str) -> None:
    running_service, job = service_with_job
    tag = running_service.http.get(job + path).headers["etag"]
    for known in (tag, f'"other", {tag}', f"W/{tag}", "*"):
        again = running_service.http.get(job + path, headers={"If-None-Match": known})
        assert (again.status_code, again.content) == (304, b""), known
        assert again.headers["etag"] == tag
    assert running_service.http.get(job + path, headers={"If-None-Match": '"other"'}).status_code == 200


def test_a_list_that_is_asked_for_again_is_sent_when_it_has_changed(
    service_with_job: tuple[InProcess, str],
) -> None:
    running_service, _ = service_with_job
    for path in ("/v1/jobs", "/v1/jobs?limit=1", "/v1/elements"):
        first = running_service.http.get(path)
        assert first.headers["content-type"] == "application/json"
        again = running_service.http.get(path, headers={"If-None-Match": first.headers["etag"]})
        assert (again.status_code, again.content) == (304, b""), path
    known = {"If-None-Match": running_service.http.get("/v1/jobs").headers["etag"]}
    job = running_service.post(named_problem("another")).json()["id"]
    changed = running_service.http.get("/v1/jobs", headers=known)
    assert changed.status_code == 200 and changed.json()["jobs"][0]["id"] == job
    running_service.wait_for_end(job)
    last = running_service.http.get("/v1/jobs", headers={"If-None-Match": changed.headers["etag"]})
    assert last.json()["jobs"][0] == running_service.http.get(f"/v1/jobs/{job}").json()


def test_a_broken_download_of_programs_goes_on_where_it_was(service_with_job: tuple[InProcess, str]) -> None:
    running_service, job = service_with_job
    whole = running_service.http.get(f"{job}/programs.zip")
    assert zipfile.ZipFile(io.BytesIO(whole.content)).namelist() == ["main.mod", "release.json"]
    headers = {"Range": "bytes=20-", "If-Range": whole.headers["etag"]}
    rest = running_service.http.get(f"{job}/programs.zip", headers=headers)
    assert rest.status_code == 206
    assert whole.content[:20] + rest.content == whole.content
    beyond = running_service.http.get(f"{job}/programs.zip", headers={"Range": "bytes=100000-"})
    assert beyond.status_code == 416
    other = running_service.http.get(f"{job}/programs.zip", headers={**headers, "If-Range": '"other"'})
    assert (other.status_code, other.content) == (200, whole.content)
    left = [path for path in running_service.service.scratch.iterdir() if path.is_file()]
    assert left == [], "an archive that was made for an answer stays"


def test_large_texts_are_compressed_for_who_takes_that(service_with_job: tuple[InProcess, str]) -> None:
    running_service, job = service_with_job
    text = b"<p>replay</p>" * 5000
    blob = running_service.service.files.put(io.BytesIO(text))
    with running_service.service.database.write() as db:
        put_files(db, job.rsplit("/", 1)[1], {"replay.html": blob})
    path = f"{job}/files/replay.html"
    plain = running_service.http.get(path, headers={"Accept-Encoding": "identity"})
    assert plain.content == text
    assert "content-encoding" not in plain.headers
    with running_service.http.stream("GET", path, headers={"Accept-Encoding": "br, gzip;q=0.5"}) as packed:
        raw = b"".join(packed.iter_raw())
        assert packed.headers["content-encoding"] == "gzip"
        assert packed.headers["vary"] == "Accept-Encoding"
        assert packed.headers["etag"] != plain.headers["etag"]
        assert "sandbox" in packed.headers["content-security-policy"]
    assert len(raw) < len(text) / 20
    assert gzip.decompress(raw) == text
    again = running_service.http.get(
        path, headers={"Accept-Encoding": "gzip", "If-None-Match": packed.headers["etag"]}
    )
    assert again.status_code == 304
    for headers in ({"Accept-Encoding": "gzip;q=0"}, {"Accept-Encoding": "gzip", "Range": "bytes=0-9"}):
        answer = running_service.http.get(path, headers=headers)
        assert "content-encoding" not in answer.headers
    assert answer.content == text[:10]
    saved = running_service.http.get(f"{path}?download=true", headers={"Accept-Encoding": "gzip"})
    assert saved.headers["content-disposition"] == 'attachment; filename="replay.html"'


def test_behind_the_proxy_cookies_are_secure_and_browsers_stay_with_tls(
    closed_service: tuple[InProcess, str],
) -> None:
    running_service, token = closed_service
    proxy = TestClient(AddressApp(running_service.http.app, "127.0.0.1"), base_url=BASE_URL)
    headers = {"Authorization": f"Bearer {token}"}
    response = proxy.post("/v1/session", headers={**headers, **TLS})
    assert response.status_code == 204
    assert "; secure" in response.headers["set-cookie"].lower()
    assert response.headers["strict-transport-security"] == "max-age=31536000"
    clear = proxy.post("/v1/session", headers=headers)
    assert "; secure" not in clear.headers["set-cookie"].lower()
    assert "strict-transport-security" not in clear.headers


def test_a_page_that_came_in_clear_does_not_send_to_a_service_by_tls(
    closed_service: tuple[InProcess, str],
) -> None:
    """For browsers without ``Sec-Fetch-Site``: a man in the middle may have written that page."""
    running_service, token = closed_service
    proxy = TestClient(AddressApp(running_service.http.app, "127.0.0.1"), base_url=BASE_URL)
    headers = {"Authorization": f"Bearer {token}"}
    clear, tls = {"Origin": BASE_URL}, {"Origin": BASE_URL.replace("http:", "https:")}
    sent = [clear, tls, {**tls, **TLS}, {**clear, **TLS}]
    answers = [proxy.post("/v1/session", headers={**headers, **item}) for item in sent]
    assert [item.status_code for item in answers] == [204, 204, 204, 403]


def test_nobody_else_is_believed_to_be_a_proxy(closed_service: tuple[InProcess, str]) -> None:
    running_service, token = closed_service
    stranger = TestClient(AddressApp(running_service.http.app, "203.0.113.77"), base_url=BASE_URL)
    response = stranger.post("/v1/session", headers={"Authorization": f"Bearer {token}", **TLS})
    assert response.status_code == 204
    assert "; secure" not in response.headers["set-cookie"].lower()
    assert "strict-transport-security" not in response.headers


def test_connections_without_a_whole_head_are_cut_off(tmp_path: Path) -> None:
    process = Process(tmp_path / "data").wait()
    try:
        request = b"GET /v1/health HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
        began = time.monotonic()
        silent, slow, second, kept = (socket.create_connection(("127.0.0.1", process.port)) for _ in range(4))
        slow.sendall(request[:30])
        for item in (second, kept):
            item.sendall(request)
            assert _answer(item).startswith(b"HTTP/1.1 200")
        second.sendall(request[:30])
        for item in (silent, slow, second):
            item.settimeout(3 * HEADER_TIMEOUT_S)
            assert item.recv(100) == b"", "the connection is open still"
        assert HEADER_TIMEOUT_S - 1 < time.monotonic() - began < 2 * HEADER_TIMEOUT_S
        kept.sendall(request)
        assert _answer(kept).startswith(b"HTTP/1.1 200")
    finally:
        process.stop()


@pytest.mark.parametrize(
    ("sizes", "every_s", "whole"),
    [([1] * 40, 0.05, False), ([1], 9.0, False), ([900, 900, 900], 0.3, True), ([1, 1, 1], 0.1, True)],
)
def test_bodies_that_come_by_the_byte_are_given_up(
    monkeypatch: pytest.MonkeyPatch, sizes: list[int], every_s: float, whole: bool
) -> None:
    """Also one of which nothing more comes; a slow one that goes on is taken."""
    monkeypatch.setattr(security, "BODY_IDLE_S", 0.5)
    pieces = iter(sizes)

    async def receive() -> Message:
        size = next(pieces)
        await anyio.sleep(every_s)
        return {"type": "http.request", "body": b"x" * size, "more_body": operator.length_hint(pieces) > 0}

    async def app(scope: Scope, receive: Receive, send: Send) -> None:
        while (message := await receive()).get("more_body"):
            pass
        got.append(message["type"])

    async def send(message: Message) -> None:
        raise AssertionError(message)

    got: list[str] = []
    scope = {"type": "http", "method": "GET", "path": "/", "scheme": "http", "headers": []}
    with ThreadPoolExecutor(1) as pool:  # the pages' browser keeps a loop of its own running in this thread
        pool.submit(anyio.run, security.RequestGuard(app, 1.0, None), scope, receive, send).result(30)
    assert got == ["http.request" if whole else "http.disconnect"]


@pytest.mark.parametrize(("path", "kind"), [("/v1/webhooks", "json"), ("/v1/check", "yaml")])
def test_a_connection_that_breaks_off_is_no_fault_of_the_service(
    service_with_job: tuple[InProcess, str], caplog: pytest.LogCaptureFixture, path: str, kind: str
) -> None:
    said = [{"type": "http.request", "body": b"{", "more_body": True}, {"type": "http.disconnect"}]
    parts, told = iter(said), []

    async def receive() -> Message:
        return next(parts)

    async def send(message: Message) -> None:
        told.append(message)

    headers = [(b"host", b"127.0.0.1"), (b"content-type", f"application/{kind}".encode())]
    scope = {"type": "http", "method": "POST", "path": path, "scheme": "http", "headers": headers}
    more = {"query_string": b"", "raw_path": path.encode(), "http_version": "1.1", "root_path": ""}
    with ThreadPoolExecutor(1) as pool:
        pool.submit(anyio.run, service_with_job[0].http.app, {**scope, **more}, receive, send).result(30)
    assert told[0]["status"] == 499
    assert not [record for record in caplog.records if record.levelname == "ERROR"]


def _answer(connection: socket.socket) -> bytes:
    """A whole answer of a connection that stays open."""
    got = b""
    while b"\r\n\r\n" not in got or not got.endswith(b"}"):
        got += connection.recv(10_000)
    return got


@pytest.mark.parametrize("end", [b"\\\n", b"\\\r\n"])
def test_faces_of_an_obj_file_over_several_lines_count_whole(tmp_path: Path, end: bytes) -> None:
    path = tmp_path / "a.obj"
    ring = b" ".join(b"%d" % n for n in range(1, 1001))
    face = b"f " + ring.replace(b" ", b" " + end) + b"\nf" + end + b" 1 2 3\n"
    path.write_bytes(b"v 0 0 0\n" * 1000 + face)
    assert mesh_size(path, ".obj") == (998 + 1, 1000)
