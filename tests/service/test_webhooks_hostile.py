"""Webhooks whose receivers or host names belong to an attacker.

Nothing holds a sender up, and nothing signed is sent to the wrong host.
"""

from __future__ import annotations

import contextlib
import datetime as dt
import socket
import ssl
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec

from planner.service import webhooks
from planner.service.webhooks import DueNotification, send_notification, signature

SECRET = "whsec_" + "A" * 44
Answer = Callable[[socket.socket], None]


class HostileServer:
    """A server that answers each connection as configured and keeps the received bytes."""

    def __init__(self, answer: Answer) -> None:
        self.came: list[bytes] = []
        self._answer, self._server = answer, socket.create_server(("127.0.0.1", 0))
        self.host = f"127.0.0.1:{self._server.getsockname()[1]}"
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                link, _ = self._server.accept()
                threading.Thread(target=self._handle, args=(link,), daemon=True).start()

    def _handle(self, link: socket.socket) -> None:
        with link, contextlib.suppress(OSError):
            self.came.append(link.recv(65536))
            self._answer(link)

    def deliver(self, scheme: str = "http", host: str = "") -> tuple[int | None, str]:
        host = host or self.host
        return send_notification(
            DueNotification("msg_1", "w", "local", f"{scheme}://{host}/x", SECRET, "{}", 1), (host,)
        )

    def close(self) -> None:
        self._server.close()


@pytest.fixture
def hostile_server(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[Answer], HostileServer]]:
    monkeypatch.setattr(webhooks, "ANSWER_TIMEOUT_S", 0.5)
    servers: list[HostileServer] = []

    def make(answer: Answer) -> HostileServer:
        servers.append(HostileServer(answer))
        return servers[-1]

    yield make
    for item in servers:
        item.close()


def drip(link: socket.socket, first: bytes, piece: bytes) -> None:
    link.sendall(first)
    for _ in range(400):
        link.sendall(piece)
        time.sleep(0.02)


def endless(link: socket.socket, first: bytes, piece: bytes) -> None:
    link.sendall(first)
    until = time.monotonic() + 8.0
    while time.monotonic() < until:
        link.sendall(piece)


@pytest.mark.parametrize(
    ("scheme", "first", "piece", "send"),
    [
        ("https", b"\x16\x03\x03\x40\x00", b"\x02", drip),  # a handshake by the byte
        ("http", b"", b"HTTP/1.1 100 Continue\r\n\r\n", drip),
        ("http", b"", b"HTTP/1.1 100 Continue\r\n\r\n" * 1000, endless),
        ("http", b"HTTP/1.1 200 OK\r\n", b"X-A: b\r\n" * 5000, endless),
        ("http", b"HTTP/1.1 200 OK\r\nX-A: ", b"a" * 100_000, endless),
        ("http", b"HTTP/1.1 ", b"2" * 100_000, endless),
    ],
)
def test_what_never_comes_to_an_answer_is_given_up_in_time(
    hostile_server: Callable[[Answer], HostileServer],
    scheme: str,
    first: bytes,
    piece: bytes,
    send: Callable[[socket.socket, bytes, bytes], None],
) -> None:
    server = hostile_server(lambda link: send(link, first, piece))
    begun = time.monotonic()
    assert server.deliver(scheme) == (None, "no answer")
    assert time.monotonic() - begun < 5.0


def test_a_huge_body_is_not_read(hostile_server: Callable[[Answer], HostileServer]) -> None:
    sent = [0]

    def answer(link: socket.socket) -> None:
        link.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: 99999999999\r\n\r\n")
        while sent[0] < 200_000_000:
            sent[0] += link.send(b"a" * 100_000)

    begun = time.monotonic()
    assert hostile_server(answer).deliver() == (200, "")
    assert time.monotonic() - begun < 5.0
    assert sent[0] < 50_000_000


@pytest.mark.parametrize("status", [301, 302, 303, 307, 308])
def test_no_redirection_is_followed(hostile_server: Callable[[Answer], HostileServer], status: int) -> None:
    other = hostile_server(lambda link: None)
    where = f"HTTP/1.1 {status} Elsewhere\r\nLocation: http://{other.host}/latest/meta-data\r\n\r\n".encode()
    assert hostile_server(lambda link: link.sendall(where)).deliver() == (status, "")
    assert other.came == []


def test_a_host_of_many_addresses_that_never_answer_is_given_up_in_time(
    hostile_server: Callable[[Answer], HostileServer], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each had the whole time for itself, and what answered behind that had no end at all."""
    server = hostile_server(lambda link: drip(link, b"HTTP/1.1 200 OK\r\nX-A: ", b"a"))
    with socket.socket() as full:
        full.bind(("127.0.0.1", 0))
        full.listen(0)
        with contextlib.ExitStack() as waiting:
            for _ in range(4):  # so that the kernel answers nobody else
                one = waiting.enter_context(socket.socket())
                one.setblocking(False)
                one.connect_ex(full.getsockname())
            there = (socket.AF_INET, socket.SOCK_STREAM, 0, "")
            port = int(server.host.rsplit(":", 1)[1])
            result = [(*there, full.getsockname())] * 30 + [(*there, ("127.0.0.1", port))]
            monkeypatch.setattr(socket, "getaddrinfo", lambda *given, **more: result)
            begun = time.monotonic()
            assert server.deliver() == (None, "no answer")
            assert time.monotonic() - begun < 5.0


def test_a_name_that_leads_to_another_machine_gets_nothing(
    hostile_server: Callable[[Answer], HostileServer], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever answers for the host's name without its certificate: a machine of the operator's, or this."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "hooks.example.org")])
    now = dt.datetime.now(dt.UTC)
    own = x509.CertificateBuilder(name, name, key.public_key(), 1, now, now + dt.timedelta(days=1))
    text = own.sign(key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM)
    form = serialization.PrivateFormat.PKCS8
    text += key.private_bytes(serialization.Encoding.PEM, form, serialization.NoEncryption())
    (tmp_path / "own.pem").write_bytes(text)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(tmp_path / "own.pem")
    received: list[bytes] = []
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            link, _ = server.accept()
            with contextlib.suppress(OSError), context.wrap_socket(link, server_side=True) as safe:
                received.append(safe.recv(65536))

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        there = (socket.AF_INET, socket.SOCK_STREAM, 0, "", server.getsockname())
        monkeypatch.setattr(socket, "getaddrinfo", lambda *given, **more: [there])
        assert hostile_server(lambda link: None).deliver("https", "hooks.example.org") == (None, "no answer")
        thread.join(10.0)
    assert not any(received)


def test_a_signature_is_good_for_its_message_at_its_time_alone() -> None:
    good = signature(SECRET, "msg_1", 1_800_000_000, '{"type":"job.ended"}')
    others = {
        signature("whsec_" + "B" * 44, "msg_1", 1_800_000_000, '{"type":"job.ended"}'),
        signature(SECRET, "msg_2", 1_800_000_000, '{"type":"job.ended"}'),
        signature(SECRET, "msg_1", 1_800_000_301, '{"type":"job.ended"}'),
        signature(SECRET, "msg_1", 1_800_000_000, '{"type":"ping"}'),
    }
    assert good not in others and len(others) == 4


def test_an_attempt_is_signed_for_the_time_at_which_it_is_made(
    hostile_server: Callable[[Answer], HostileServer], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A receiver that refuses messages some minutes old accepts one that is sent again hours later."""
    server = hostile_server(lambda link: link.sendall(b"HTTP/1.1 204 No Content\r\n\r\n"))
    now = time.time()
    for later in (0.0, 36_000.0):
        monkeypatch.setattr(time, "time", lambda at=now + later: at)
        assert server.deliver() == (204, "")
    stamps = [int(text.split(b"webhook-timestamp: ")[1].split(b"\r\n")[0]) for text in server.came]
    assert stamps[1] - stamps[0] == 36_000
