"""HTTP connection to one controller.

It supports the digest login of RWS 1.0 and the basic login over TLS of RWS 2.0. Except for the second half of
a digest login, no request is repeated. The password appears in no message and no log.

Source: Digest access authentication, RFC 7616 (MD5, qop "auth").
"""

import base64
import dataclasses
import hashlib
import http.client
import re
import secrets
import ssl
from collections.abc import Mapping
from pathlib import Path
from urllib.parse import SplitResult, urlsplit

from planner.issues import TandemError, issue_error

MAX_BYTES = 50_000_000
"""Maximum size [bytes] of an answer."""


@dataclasses.dataclass(frozen=True)
class Login:
    """User and password. The password is not part of its text."""

    user: str
    password: str = dataclasses.field(repr=False)


@dataclasses.dataclass(frozen=True)
class Trust:
    """Trusted certificates: those that this machine trusts, those of a file, or a single one.

    Attributes:
        authority: File of trusted certificates; None for those of this machine.
        fingerprint: SHA-256 of the only trusted certificate, such as a controller's self-signed one; else
            None.
    """

    authority: Path | None = None
    fingerprint: str | None = None

    def context(self) -> ssl.SSLContext:
        """Return a TLS context.

        With a fingerprint, it accepts any certificate, so :meth:`check` must follow before anything is sent.

        Raises:
            TandemError: ``upload.address`` if the fingerprint or the file of certificates is invalid.
        """
        if self.fingerprint is not None and not re.fullmatch(r"[0-9a-f]{64}", _normalised(self.fingerprint)):
            message = f"--fingerprint: got {self.fingerprint}, allowed are 64 hexadecimal digits (SHA-256)"
            raise issue_error("upload.address", message, field="fingerprint")
        try:
            context = ssl.create_default_context(cafile=None if not self.authority else str(self.authority))
        except OSError as error:
            message = f"the file of certificates {self.authority} cannot be used ({error})"
            raise issue_error("upload.address", message, field="ca") from error
        if self.fingerprint is not None:
            context.check_hostname = False
            context.verify_mode = ssl.CERT_NONE
        return context

    def check(self, socket: object, url: str) -> None:
        """Compare the certificate of a connected TLS socket with the fingerprint, if there is one.

        ``url`` is the address, for the message.

        Raises:
            TandemError: ``upload.login`` if they differ.
        """
        if self.fingerprint is None or not isinstance(socket, ssl.SSLSocket):
            return
        certificate = socket.getpeercert(binary_form=True) or b""
        got, expected = hashlib.sha256(certificate).hexdigest(), _normalised(self.fingerprint)
        if got != expected:
            message = f"the certificate of {url} has SHA-256 {got}, --fingerprint names {expected}"
            hint = "compare it with the controller's certificate before you trust it"
            raise issue_error("upload.login", message, hint=hint)


def _normalised(fingerprint: str) -> str:
    """Return a fingerprint in lower case without colons, spaces and prefix."""
    return re.sub(r"[\s:]", "", fingerprint.lower().removeprefix("sha256"))


def address(url: str) -> SplitResult:
    """Parse the URL of a controller.

    Raises:
        TandemError: ``upload.address`` if it is not a URL, or contains a user or a password, which would end
            up in shell histories and logs.
    """
    try:
        parts = urlsplit(url)
        _ = parts.port  # access raises ValueError outside 0 to 65535
    except ValueError as error:
        message = f"got {url}, not a URL ({error}); allowed: http://HOST[:PORT], ftp://HOST[:PORT]/FOLDER"
        raise issue_error("upload.address", message, field="controller") from error
    if parts.username or parts.password:
        message = "a URL must not contain a user or password; use --user and TANDEM_CONTROLLER_PASSWORD"
        raise issue_error("upload.address", message)
    return parts


@dataclasses.dataclass(frozen=True)
class Answer:
    """HTTP status and body of an answer."""

    status: int
    body: bytes


@dataclasses.dataclass
class Link:
    """One connection to ``url``.

    Attributes:
        url: Address of the controller.
        login: User and password.
        basic: Whether the basic scheme of RWS 2.0 is used, which is refused without TLS.
        timeout: Timeout [s] of each wait.
        trust: Trusted certificates.
    """

    url: str
    login: Login
    basic: bool
    timeout: float = 20.0
    trust: Trust = Trust()

    def __post_init__(self) -> None:
        parts = address(self.url)
        if parts.scheme not in ("http", "https") or not parts.hostname or parts.path not in ("", "/"):
            message = f"got {self.url}, allowed: http://HOST[:PORT] or https://HOST[:PORT]"
            raise issue_error("upload.address", message, field="controller")
        if self.basic and parts.scheme != "https":
            message = "RWS 2.0 sends the password unencrypted, so only https is allowed; give https://HOST"
            raise issue_error("upload.address", message, field="controller")
        self._connection = self._connect(parts.scheme, parts.hostname, parts.port)
        self._cookie = ""
        self._challenge = dict[str, str]()  # fields of the digest challenge; empty before the first one
        self._count = 0  # requests with that challenge

    def _connect(self, scheme: str, host: str, port: int | None) -> http.client.HTTPConnection:
        """Create the connection object; it connects in :meth:`_open`."""
        if scheme == "http":
            return http.client.HTTPConnection(host, port, timeout=self.timeout)
        context = self.trust.context()
        return http.client.HTTPSConnection(host, port, timeout=self.timeout, context=context)

    def _open(self) -> None:
        """Connect, and check the certificate against the fingerprint before anything is sent."""
        if self._connection.sock is not None:
            return
        self._connection.connect()
        try:
            self.trust.check(self._connection.sock, self.url)
        except TandemError:
            self._connection.close()
            raise

    def ask(
        self, method: str, path: str, body: bytes | None = None, headers: Mapping[str, str] | None = None
    ) -> Answer:
        """Send one request and return the answer, whatever its status except 401.

        Raises:
            TandemError: ``upload.controller`` if there is no complete answer; ``upload.login`` if the login
                or the certificate is refused.
        """
        answer, challenge = self._once(method, path, body, headers or {})
        # repeat after the first half of a digest login, or if the nonce has expired
        may_repeat = bool(challenge) and (not self._sent or "stale=true" in challenge.lower())
        if answer.status == 401 and not self.basic and may_repeat:
            answer, _ = self._once(method, path, body, headers or {})
        if answer.status == 401:
            message = f"{self.url} refuses user {self.login.user!r} (HTTP 401 at {path})"
            raise issue_error("upload.login", message, hint="give --user and the right password")
        return answer

    def _once(
        self, method: str, path: str, body: bytes | None, headers: Mapping[str, str]
    ) -> tuple[Answer, str]:
        """Send a request once, and return the answer and its WWW-Authenticate header.

        Errors are those of `ask`. A cookie and a digest challenge in the answer are kept for later requests.
        ``_sent`` is set if the request contained the login, so that `ask` knows whether it was refused.
        """
        request_headers: dict[str, str | bytes] = dict(headers)
        self._sent = bool(self.basic or self._challenge)
        if self.basic:
            credentials = f"{self.login.user}:{self.login.password}".encode()
            request_headers["Authorization"] = "Basic " + base64.b64encode(credentials).decode()
        elif self._challenge:
            request_headers["Authorization"] = self._digest(method, path).encode()
        if self._cookie:
            request_headers["Cookie"] = self._cookie
        try:
            self._open()
            self._connection.request(method, path, body, request_headers)
            response = self._connection.getresponse()
            content = response.read(MAX_BYTES + 1)
            if len(content) <= MAX_BYTES and response.length:  # read(n) does not raise if bytes are missing
                raise http.client.IncompleteRead(content, response.length)
        except ssl.SSLCertVerificationError as error:
            message = f"the certificate of {self.url} is not trusted ({error.verify_message})"
            hint = "give --ca FILE, or --fingerprint SHA256 for a self-signed one that you have checked"
            raise issue_error("upload.login", message, hint=hint) from error
        except (OSError, http.client.HTTPException) as error:
            self._connection.close()
            name = "no answer in time" if isinstance(error, TimeoutError) else type(error).__name__
            message = f"{method} {self.url}{path}: {name} ({error}), waited up to {self.timeout:g} s"
            if isinstance(error, http.client.IncompleteRead):
                message = f"{method} {self.url}{path}: the answer ended after {len(error.partial)} bytes, "
                message += f"{error.expected or 'some'} before its end"
            hint = "check that the controller is on and reachable, and try again"
            raise issue_error("upload.controller", message, hint=hint) from error
        except ValueError as error:  # invalid header values
            self._connection.close()
            message = f"user {self.login.user!r} cannot log in over HTTP ({error})"
            raise issue_error("upload.login", message, hint="give --user as the controller has it") from error
        if len(content) > MAX_BYTES:
            self._connection.close()
            raise issue_error("upload.controller", f"{path}: the answer is longer than {MAX_BYTES} bytes")
        cookies = [value.split(";")[0] for value in response.headers.get_all("Set-Cookie") or ()]
        self._cookie = "; ".join(cookies) or self._cookie
        challenge = response.headers.get("WWW-Authenticate", "")
        if challenge.lower().startswith("digest"):
            fields = re.findall(r'(\w+)=(?:"([^"]*)"|([^\s,]+))', challenge)
            self._challenge = {name.lower(): quoted or bare for name, quoted, bare in fields}
            self._count = 0
        return Answer(response.status, content), challenge

    def _digest(self, method: str, path: str) -> str:
        """Return the value of the Authorization header by RFC 7616, section 3.4."""
        challenge, login = self._challenge, self.login
        self._count += 1
        count, client_nonce = f"{self._count:08x}", secrets.token_hex(8)
        realm, nonce = challenge.get("realm", ""), challenge.get("nonce", "")
        user_hash = _md5(f"{login.user}:{realm}:{login.password}")
        request_hash = _md5(f"{method}:{path}")
        has_qop = "qop" in challenge
        middle = f"{nonce}:{count}:{client_nonce}:auth" if has_qop else nonce
        header = f'Digest username="{login.user}", realm="{realm}", nonce="{nonce}", uri="{path}", '
        header += f'response="{_md5(f"{user_hash}:{middle}:{request_hash}")}"'
        if has_qop:
            header += f', qop=auth, nc={count}, cnonce="{client_nonce}"'
        return header + (f', opaque="{challenge["opaque"]}"' if "opaque" in challenge else "")

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()


def _md5(text: str) -> str:
    return hashlib.md5(text.encode(), usedforsecurity=False).hexdigest()
