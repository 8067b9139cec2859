"""A server of our own that answers as the public descriptions of Robot Web Services say; no controller."""

from __future__ import annotations

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

REALM, USER, SECRET = "validusers@robapi.abb", "Default User", "robotics"


def md5(text: str) -> str:
    return hashlib.md5(text.encode()).hexdigest()


class Controller:
    """State of the pretended controller, and what it was asked for."""

    def __init__(self, version: int = 1, tls: Path | None = None) -> None:
        self.version = version
        self.values = {
            "opmode": "AUTO",
            "ctrlexecstate": "stopped",
            "ctrlstate": "motoroff",
            "rwversion": "6.15.01",
        }
        self.options, self.tasks = ["RobotWare Base", "616-1 PC Interface"], ["T_ROB1"]
        self.signals: dict[str, str] = {}
        self.base = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
        self.data: dict[str, str] = {}
        self.files: dict[str, bytes | None] = {"": None}
        self.fail: dict[str, int] = {}
        self.cut, self.slow, self.asked = 0, 0.0, list[tuple[str, str]]()
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
        path = unquote(urlsplit(h.path).path)
        time.sleep(self.slow)
        if not self.allowed(h):
            asked = f'Digest realm="{REALM}", nonce="n1", qop="auth", opaque="o"'
            self.send(h, 401, b"", asked if self.version == 1 else "Basic")
            return
        self.asked.append((h.command, h.path))
        for part, status in self.fail.items():
            if part in f"{h.command} {h.path}":
                self.send(h, status, b"not enough space on disk" if status == 507 else b"refused")
                return
        code, content = self.reply(h.command, path, body, parse_qs(body.decode("latin-1")))
        self.send(h, code, content)

    def allowed(self, h: BaseHTTPRequestHandler) -> bool:
        given = h.headers.get("Authorization", "")
        if self.version == 2:
            return given == "Basic RGVmYXVsdCBVc2VyOnJvYm90aWNz"  # RFC 7617 of the two words above
        v = dict(re.findall(r'(\w+)="?([^",]+)"?', given))
        first, second = md5(f"{USER}:{REALM}:{SECRET}"), md5(f"{h.command}:{v.get('uri')}")
        wanted = md5(f"{first}:n1:{v.get('nc')}:{v.get('cnonce')}:auth:{second}")
        return v.get("response") == wanted and v.get("uri") == h.path

    @staticmethod
    def send(h: BaseHTTPRequestHandler, status: int, content: bytes, asked: str = "") -> None:
        h.send_response(status)
        if asked:
            h.send_header("WWW-Authenticate", asked)
        h.send_header("Content-Length", str(len(content)))
        h.end_headers()
        h.wfile.write(content)

    def json(self, items: list[dict[str, Any]]) -> tuple[int, bytes]:
        whole = {"_embedded": {"_state": items}} if self.version == 1 else {"state": items}
        return 200, json.dumps(whole).encode()

    def reply(self, verb: str, path: str, body: bytes, form: dict[str, list[str]]) -> tuple[int, bytes]:
        if path.startswith("/fileservice/"):
            return self.file(verb, "/".join(path.split("/")[3:]).strip("/"), body, form)
        if path.startswith("/rw/mastership"):
            return 204, b""
        keys = {
            "/rw/panel/opmode": "opmode",
            "/rw/panel/ctrlstate": "ctrlstate",
            "/rw/rapid/execution": "ctrlexecstate",
            "/rw/system": "rwversion",
        }
        if verb == "GET" and path in keys:
            return self.json([{"_type": "x", keys[path]: self.values[keys[path]]}])
        if path == "/rw/system/options":
            return self.json([{"_type": "sys-option-li", "option": o} for o in self.options])
        if path == "/rw/rapid/tasks":
            return self.json([{"_type": "rap-task-li", "name": t} for t in self.tasks])
        if path == "/rw/iosystem/signals":
            rows = self.signals.items()
            return self.json([{"_type": "ios-signal-li", "name": n, "type": t} for n, t in rows])
        if path == "/rw/cfg/moc/ROBOT/instances":
            names = [*(f"base_frame_pos_{a}" for a in "xyz"), *(f"base_frame_orient_u{k}" for k in range(4))]
            rows = [
                {"_type": "cfg-ia-t", "_title": n, "value": str(v)}
                for n, v in zip(names, self.base, strict=True)
            ]
            return self.json([{"_type": "cfg-dt-instance-li", "_title": "ROB_1", "attrib": rows}])
        name = path.removesuffix("/data").rpartition("/")[2]
        if "/rw/rapid/symbol/" in path and name in self.data:
            return self.json([{"_type": "rap-data", "value": self.data[name]}])
        return 404, b""

    def file(self, verb: str, name: str, body: bytes, form: dict[str, list[str]]) -> tuple[int, bytes]:
        if verb == "PUT":
            self.files[name] = body[: len(body) - self.cut]
            return 201, b""
        if verb == "POST":
            folder = f"{name.removesuffix('create').strip('/')}/{form['fs-newname'][0]}".strip("/")
            self.files[folder] = None
            return 201, b""
        if name not in self.files:
            return 404, b""
        if verb == "DELETE":
            del self.files[name]
            return 204, b""
        content = self.files[name]
        if content is not None:
            return 200, content
        inside = {n for n in self.files if n and n.rpartition("/")[0] == name}
        kinds = {n: "fs-dir" if self.files[n] is None else "fs-file" for n in inside}
        return self.json([{"_type": k, "_title": n.rpartition("/")[2]} for n, k in kinds.items()])
