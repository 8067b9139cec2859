"""A fake controller that answers as the public descriptions of Robot Web Services say.

No real controller is used.

1.0: pages of 3HAC050973-001 revision M (JSON by ``json=1``, digest login, actions as ``?action=``). 2.0:
3HAC073675-001 and public clients (basic login, ``v=2.0`` in media types, actions as the path's last word).
"""

from __future__ import annotations

import base64
import datetime as dt
import hashlib
import json
import re
import ssl
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, unquote, urlsplit

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

REALM, USER, SECRET = "validusers@robapi.abb", "Default User", "robotics"
PAGE = 3
"""Entries of a list on one page."""


def md5(text: str) -> str:
    return hashlib.md5(text.encode()).hexdigest()


def certificate(folder: Path) -> Path:
    """A self-signed certificate with its key in one file, as a controller has one."""
    path = folder / "controller.pem"
    if path.exists():
        return path
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "controller")])
    now = dt.datetime.now(dt.UTC)
    made = x509.CertificateBuilder(name, name, key.public_key(), x509.random_serial_number())
    made = made.not_valid_before(now - dt.timedelta(1)).not_valid_after(now + dt.timedelta(1))
    form = (serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    text = key.private_bytes(serialization.Encoding.PEM, *form)
    path.write_bytes(text + made.sign(key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM))
    return path


def fingerprint(pem: Path) -> str:
    text = pem.read_text()
    return hashlib.sha256(ssl.PEM_cert_to_DER_cert(text[text.index("-----BEGIN CERT") :])).hexdigest()


class FakeController:
    """State of the fake controller, and the requests that it received.

    Attributes:
        fail: {part of "VERB path": status}.
        drop: Parts of requests at which the connection breaks.
        cut: Number of bytes that are lost of each file.
        lies: {part of a path: false answer}.
        halves: Part of a path whose answers break off.
    """

    def __init__(self, version: int = 1, tls: Path | None = None) -> None:
        self.version = version
        self.mode, self.running, self.robotware = "AUTO", "stopped", "6.15.01" if version == 1 else "7.13.1"
        self.options, self.tasks = ["RobotWare Base", "616-1 PC Interface"], ["T_ROB1"]
        self.signals = {f"DI_{k}": "DI" for k in range(2 * PAGE)}
        self.base = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
        self.model = "ROB1_140_0.81_6_typeC"
        self.loaded: dict[str, dict[str, str]] = {"user": {}}
        self.files: dict[str, bytes | None] = {"": None}
        self.fail: dict[str, int] = {}
        self.drop: set[str] = set()
        self.nonce, self.expires = "n1", 0  # after so many requests the nonce is another one
        self.short = False  # whether lists of instances tell their names alone
        self.lies: dict[str, bytes] = {}
        self.halves = ""
        self.cut, self.delay_s, self.requests = 0, 0.0, list[tuple[str, str]]()
        outer = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def log_message(self, *_: object) -> None: ...

            def do_GET(self) -> None:
                outer.answer(self)

            do_PUT = do_POST = do_DELETE = do_GET  # noqa: N815

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.server.daemon_threads = True
        if tls is not None:
            context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
            context.load_cert_chain(tls)
            self.server.socket = context.wrap_socket(self.server.socket, server_side=True)
        scheme = "http" if tls is None else "https"
        self.url = f"{scheme}://127.0.0.1:{self.server.server_address[1]}"
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    def close(self) -> None:
        self.server.shutdown()
        self.server.server_close()

    def answer(self, h: BaseHTTPRequestHandler) -> None:
        body = h.rfile.read(int(h.headers.get("Content-Length", 0)))
        parts = urlsplit(h.path)
        time.sleep(self.delay_s)
        if self.expires and len(self.requests) == self.expires:
            self.nonce, self.expires = "n2", 0
        if not self.allowed(h):
            old = 'nonce="n1"' in h.headers.get("Authorization", "") and self.nonce != "n1"
            asked = f'Digest realm="{REALM}", nonce="{self.nonce}", qop="auth", opaque="o"'
            asked += ", stale=true" if old else ""
            self.send(h, 401, b"", asked if self.version == 1 else "Basic")
            return
        self.requests.append((h.command, h.path))
        if any(part in f"{h.command} {unquote(h.path)}" for part in self.drop):
            h.close_connection = True
            return
        for part, status in self.fail.items():
            if part in f"{h.command} {h.path}":
                self.send(h, status, b"not enough space on disk" if status == 507 else b"refused")
                return
        if refusal := self.media(h):
            self.send(h, refusal, b"media type")
            return
        for part, lie in self.lies.items():
            if part in h.path:
                self.send(h, 200, lie)
                return
        query = {k: v[0] for k, v in parse_qs(parts.query).items()}
        form = {k: v[0] for k, v in parse_qs(body.decode("latin-1")).items()} if h.command == "POST" else {}
        code, content = self.reply(h.command, unquote(parts.path), body, query, form)
        if self.halves and self.halves in unquote(h.path):
            h.send_response(code)
            h.send_header("Content-Length", str(len(content)))
            h.end_headers()
            h.wfile.write(content[: len(content) // 2])
            h.close_connection = True
            return
        self.send(h, code, content)

    def media(self, h: BaseHTTPRequestHandler) -> int:
        """2.0 answers 406 and 415 where media types lack their version."""
        if self.version == 1:
            return 0
        if h.headers.get("Accept") != "application/hal+json;v=2.0":
            return 406
        sent = {"POST": "application/x-www-form-urlencoded;v=2.0", "PUT": "application/octet-stream;v=2.0"}
        return 415 if h.headers.get("Content-Type") != sent.get(h.command) else 0

    def allowed(self, h: BaseHTTPRequestHandler) -> bool:
        given = h.headers.get("Authorization", "")
        if self.version == 2:
            return given == "Basic " + base64.b64encode(f"{USER}:{SECRET}".encode()).decode()
        v = dict(re.findall(r'(\w+)="?([^",]+)"?', given))
        first, second = md5(f"{USER}:{REALM}:{SECRET}"), md5(f"{h.command}:{v.get('uri')}")
        expected = md5(f"{first}:{self.nonce}:{v.get('nc')}:{v.get('cnonce')}:auth:{second}")
        return v.get("response") == expected and v.get("uri") == h.path

    @staticmethod
    def send(h: BaseHTTPRequestHandler, status: int, content: bytes, challenge: str = "") -> None:
        h.send_response(status)
        if challenge:
            h.send_header("WWW-Authenticate", challenge)
        h.send_header("Content-Length", str(len(content)))
        h.end_headers()
        h.wfile.write(content)

    def json(self, items: list[dict[str, Any]], query: dict[str, str], path: str = "") -> tuple[int, bytes]:
        """Items as each version wraps them; of a list at ``path`` one page, with a link to the next."""
        if self.version == 1 and query.get("json") != "1":
            return 200, b"<?xml version='1.0'?><html/>"
        start = int(query.get("start", 0)) if path else 0
        shown = items[start : start + PAGE] if path else items
        links: dict[str, Any] = {"base": {"href": f"{self.url}{path.rpartition('/')[0]}/"}}
        if path and start + PAGE < len(items):
            links["next"] = {"href": f"{path.rpartition('/')[2]}?start={start + PAGE}&amp;limit={PAGE}"}
        if self.version == 1:
            whole: dict[str, Any] = {"_links": links, "_embedded": {"_state": shown}}
        elif path:
            whole = {"_links": links, "state": [], "_embedded": {"resources": shown}}
        else:
            whole = {"_links": links, "state": shown}
        return 200, json.dumps(whole).encode()

    def reply(
        self, verb: str, path: str, body: bytes, query: dict[str, str], form: dict[str, str]
    ) -> tuple[int, bytes]:
        one = self.version == 1
        if path.lower().startswith("/fileservice/$home"):
            return self.file(verb, path[len("/fileservice/$home") :].strip("/"), body, query, form)
        if verb == "POST":
            domain = "/rw/mastership/rapid" if one else "/rw/mastership/edit"
            action = query.get("action") if one else path.rpartition("/")[2]
            known = path == domain if one else path.rpartition("/")[0] == domain
            return (204, b"") if known and action in ("request", "release") else (404, b"")
        single = {
            "/rw/panel/opmode": {"_type": "pnl-opmode", "opmode": self.mode},
            "/rw/rapid/execution": {"_type": "rap-execution", "ctrlexecstate": self.running},
            "/rw/system": {"_type": "sys-system-li", "rwversion": self.robotware},
        }
        if path in single:
            return self.json([single[path]], query)
        if path == "/logout":
            return 200, b""
        lists = {
            "/rw/system/options": [{"_type": "sys-option-li", "option": o} for o in self.options],
            "/rw/rapid/tasks": [{"_type": "rap-task-li", "name": t} for t in self.tasks],
            "/rw/iosystem/signals": [
                {"_type": "ios-signal-li", "name": n, "type": t} for n, t in self.signals.items()
            ],
            "/rw/cfg/moc/ROBOT/instances": [{**self.robot(), "attrib": []} if self.short else self.robot()],
            "/rw/cfg/moc/ROBOT/instances/ROB_1": [self.robot()],
        }
        if path in lists:
            return self.json(lists[path], query, path)
        where = "/rw/rapid/modules" if one else "/rw/rapid/tasks/T_ROB1/modules"
        if path == where and (not one or query.get("task") == "T_ROB1"):
            return self.json([{"_type": "rap-module-info-li", "name": m} for m in self.loaded], query)
        start = "/rw/rapid/symbol/data/RAPID/T_ROB1/" if one else "/rw/rapid/symbol/RAPID/T_ROB1/"
        if path.startswith(start) and (one or path.endswith("/data")):
            module, name = path.removeprefix(start).removesuffix("" if one else "/data").split("/")
            if name in self.loaded.get(module, {}):
                return self.json([{"_type": "rap-data", "value": self.loaded[module][name]}], query)
            return (400, b'{"code": -1073442809}') if one else (404, b"")
        return 404, b""

    def robot(self) -> dict[str, Any]:
        names = [*(f"base_frame_pos_{a}" for a in "xyz"), *(f"base_frame_orient_u{k}" for k in range(4))]
        values = {n: str(v) for n, v in zip(names, self.base, strict=True)} | {"use_robot_type": self.model}
        rows = [{"_type": "cfg-ia-t", "_title": n, "value": v} for n, v in values.items()]
        return {"_type": "cfg-dt-instance-li", "_title": "ROB_1", "attrib": rows}

    def file(
        self, verb: str, name: str, body: bytes, query: dict[str, str], form: dict[str, str]
    ) -> tuple[int, bytes]:
        if verb == "PUT":
            if name.rpartition("/")[0] not in self.files:
                return 404, b""
            self.files[name] = body[: len(body) - self.cut]
            return 201, b""
        if verb == "POST":
            if self.version == 1 and form.get("fs-action") != "create":
                return 400, b""
            if self.version == 2 and name.rpartition("/")[2] != "create":
                return 404, b""
            above = name if self.version == 1 else name.removesuffix("create").strip("/")
            made = f"{above}/{form['fs-newname']}".strip("/")
            if made in self.files or above not in self.files:
                return 409, b""
            self.files[made] = None
            return 201, b""
        if name not in self.files:
            return 404, b""
        if verb == "DELETE":
            if any(other.startswith(f"{name}/") for other in self.files):
                return 409, b""
            del self.files[name]
            return 204, b""
        content = self.files[name]
        if content is not None:
            return 200, content
        inside = {n for n in self.files if n and n.rpartition("/")[0] == name}
        kinds = {n: "fs-dir" if self.files[n] is None else "fs-file" for n in inside}
        rows = [{"_type": k, "_title": n.rpartition("/")[2]} for n, k in sorted(kinds.items())]
        return self.json(rows, query)
