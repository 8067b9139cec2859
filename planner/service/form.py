"""Bodies of ``multipart/form-data`` (RFC 7578), for the client."""

from __future__ import annotations

import secrets
from collections.abc import Mapping


def form(problem: bytes, files: Mapping[str, bytes]) -> tuple[bytes, str]:
    """The body with a problem and its files by name, and its content type."""
    boundary = secrets.token_hex(16)
    parts = [("problem", "problem.yaml", problem), *(("files", name, files[name]) for name in files)]
    body = bytearray()
    for field, name, content in parts:
        quoted = name.replace("\\", "\\\\").replace('"', "%22").replace("\r", "%0D").replace("\n", "%0A")
        body += f"--{boundary}\r\n".encode()
        body += f'Content-Disposition: form-data; name="{field}"; filename="{quoted}"\r\n'.encode()
        body += b"Content-Type: application/octet-stream\r\n\r\n"
        body += content + b"\r\n"
    body += f"--{boundary}--\r\n".encode()
    return bytes(body), f"multipart/form-data; boundary={boundary}"
