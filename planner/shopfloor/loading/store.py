"""Where program files go, seen as folders and files: a share, an FTP server, or a controller's home folder.

FTP by the standard library's ``ftplib`` (RFC 959), with TLS for ``ftps://`` (RFC 4217). Replies 452 and 552
say that there is no room (RFC 959, 4.2.1).
"""

import ftplib
import io
import re
import socket
import ssl
from pathlib import Path
from typing import Final, Protocol
from urllib.parse import unquote

from planner.files import is_disk_full
from planner.issues import TandemError, refusal
from planner.shopfloor.loading.http_link import MOST_BYTES, Login, Trust, address

_UNIX: Final = re.compile(
    r"(?P<folder>[-dl])[rwxsStT-]{9}\S?\s+(?:\S+\s+){4,7}?(?:\d{4}|\d\d?:\d\d)\s(?P<name>.+)"
)
_DOS: Final = re.compile(r"\d[\d-]+\s+\d\d?:\d\d\s*(?:[AP]M)?\s+(?P<folder><DIR>|\d+)\s+(?P<name>.+)")
"""Lines of LIST as servers of UNIX and of DOS print them."""


class Store(Protocol):
    """Folders and files of a controller by names with ``/``; "" is the folder that was given."""

    def listing(self, folder: str) -> dict[str, bool] | None:
        """{name: whether it is a folder}, None where there is no such folder."""

    def make(self, folder: str) -> None:
        """Make a folder in one that is there."""

    def write(self, name: str, content: bytes) -> None:
        """Write a file; raises ``TandemError`` (``upload.write``)."""

    def read(self, name: str) -> bytes | None:
        """A file's bytes, None where there is none."""

    def remove(self, name: str) -> bool:
        """Delete a file or an empty folder; whether it is gone."""

    def close(self) -> None:
        """End the connection."""


class Share:
    """A folder that is mounted here."""

    def __init__(self, root: Path) -> None:
        if not root.is_dir():
            what = f"{root}: no such folder; mount the controller's share, or give the right one"
            raise refusal("upload.controller", what)
        self.root = root

    def listing(self, folder: str) -> dict[str, bool] | None:
        """As :class:`Store` has it."""
        path = self.root / folder
        try:
            return {p.name: p.is_dir() for p in path.iterdir()} if path.is_dir() else None
        except OSError as error:
            raise _unread(path, error) from error

    def make(self, folder: str) -> None:
        """As :class:`Store` has it."""
        try:
            (self.root / folder).mkdir()
        except OSError as error:
            raise _unwritten(folder, error) from error

    def write(self, name: str, content: bytes) -> None:
        """As :class:`Store` has it; a file that is there is never written over."""
        try:
            with (self.root / name).open("xb") as stream:
                stream.write(content)
        except OSError as error:
            raise _unwritten(name, error) from error

    def read(self, name: str) -> bytes | None:
        """As :class:`Store` has it."""
        path = self.root / name
        try:
            return path.read_bytes() if path.is_file() else None
        except OSError as error:
            raise _unread(path, error) from error

    def remove(self, name: str) -> bool:
        """As :class:`Store` has it."""
        path = self.root / name
        try:
            if path.is_dir():
                path.rmdir()
            else:
                path.unlink(missing_ok=True)
        except OSError:
            return False
        return True

    def close(self) -> None:
        """As :class:`Store` has it."""


def _unread(path: Path, error: OSError) -> TandemError:
    what = f"{path} cannot be read ({error.strerror or error})"
    return refusal("upload.controller", what, hint="see that the share is mounted, and the rights")


WIRE: Final = "latin-1"
"""Lines of FTP are bytes: each is a letter of this. Names are UTF-8 (RFC 2640) where they can be; a server of
another kind, as on Windows, has bytes that are not, in lists and replies."""


def _text(line: str) -> str:
    """What a server said; bytes that are not UTF-8 are kept apart, so that :func:`_wire` gives them back."""
    return line.encode(WIRE, "replace").decode("utf-8", "surrogateescape")


def _told(error: Exception) -> str:
    """What an error says, of a server or of this machine, to be shown."""
    return str(error).encode(WIRE, "replace").decode("utf-8", "replace") or type(error).__name__


def _wire(text: str) -> str:
    """Text as it is sent. Raises ``TandemError`` (``upload.address``) for control characters, which would be
    commands of their own."""
    if any(ord(letter) < 32 for letter in text):
        what = "names, users and passwords of FTP have no control characters, such as ends of lines"
        raise refusal("upload.address", what)
    return text.encode("utf-8", "surrogateescape").decode(WIRE)


class _Channel(ftplib.FTP_TLS):
    """FTP over TLS of which every connection, those of data too, shows the certificate that is trusted."""

    trust = Trust()
    url = ""

    def ntransfercmd(self, cmd: str, rest: int | str | None = None) -> tuple[socket.socket, int | None]:
        """As the base class has it."""
        made, size = super().ntransfercmd(cmd, rest)
        self.trust.check(made, self.url)
        return made, size


class Ftp:
    """A folder of an FTP server, ``ftp://HOST[:PORT]/FOLDER``. The password goes over the wire as it is, but
    for ``ftps``. Raises ``TandemError`` (``upload.*``)."""

    def __init__(self, url: str, login: Login, timeout: float, trust: Trust | None = None) -> None:
        parts = address(url)
        if not parts.hostname:
            raise refusal("upload.address", f"got {url}, allowed: ftp://HOST[:PORT]/FOLDER")
        self._url = f"{parts.scheme}://{parts.hostname}"
        link = (
            self._secure(trust or Trust(), timeout)
            if parts.scheme == "ftps"
            else ftplib.FTP(timeout=timeout, encoding=WIRE)
        )
        try:
            link.connect(parts.hostname, parts.port or 21)
            if isinstance(link, _Channel):
                link.auth()
                link.trust.check(link.sock, self._url)
            link.login(_wire(login.user), _wire(login.password))
            if isinstance(link, _Channel):
                link.prot_p()
            link.cwd(_wire(unquote(parts.path)) or "/")
            self._root = _text(link.pwd()).rstrip("/")
        except ftplib.error_perm as error:
            what = f"{url}: user {login.user!r} or the folder is refused ({_told(error)[:60]})"
            raise refusal("upload.login", what) from error
        except ssl.SSLCertVerificationError as error:
            what = f"the certificate of {self._url} is not trusted ({error.verify_message})"
            hint = "give --ca FILE, or --fingerprint SHA256 for a self-signed one that you have compared"
            raise refusal("upload.login", what, hint=hint) from error
        except ftplib.all_errors as error:
            what = f"{url} cannot be reached ({_told(error)}), waited up to {timeout:g} s"
            hint = "see that the server is on and reachable, and try again"
            raise refusal("upload.controller", what, hint=hint) from error
        self._link = link

    def _secure(self, trust: Trust, timeout: float) -> _Channel:
        link = _Channel(timeout=timeout, context=trust.context(), encoding=WIRE)
        link.trust, link.url = trust, self._url
        return link

    def listing(self, folder: str) -> dict[str, bool] | None:
        """As :class:`Store` has it; by MLSD (RFC 3659) where the server knows it, else by LIST as UNIX or DOS
        print it."""
        path = self._path(folder)
        try:
            self._link.cwd(_wire(path))
        except ftplib.error_perm:
            return None
        except ftplib.all_errors as error:
            raise self._gone(path, error) from error
        try:
            # values of facts are in any case (RFC 3659, 7.2)
            rows = [
                (_text(name), facts.get("type", "").lower()) for name, facts in self._link.mlsd(_wire(path))
            ]
            return {name: kind == "dir" for name, kind in rows if kind in ("dir", "file")}
        except ftplib.error_perm:
            return self._listed(path)
        except ftplib.all_errors as error:
            raise self._gone(path, error) from error

    def _listed(self, path: str) -> dict[str, bool]:
        lines: list[str] = []
        try:
            self._link.retrlines("LIST", lines.append)
        except ftplib.error_perm as error:
            if str(error).startswith("550"):  # how some servers say that a folder is empty
                return {}
            raise self._gone(path, error) from error
        except ftplib.all_errors as error:
            raise self._gone(path, error) from error
        out = {}
        for line in map(_text, lines):
            if line.startswith("total "):
                continue
            found = _UNIX.match(line) or _DOS.match(line)
            if found is None:
                what = f"{self._url}{path}: a line of its list of files cannot be read: {line[:80]!r}"
                raise refusal("upload.controller", what)
            if found["name"] not in (".", ".."):
                out[found["name"]] = found["folder"] in ("d", "<DIR>")
        return out

    def make(self, folder: str) -> None:
        """As :class:`Store` has it."""
        try:
            self._link.mkd(_wire(self._path(folder)))
        except ftplib.all_errors as error:
            raise _unwritten(folder, error) from error

    def write(self, name: str, content: bytes) -> None:
        """As :class:`Store` has it."""
        try:
            self._link.storbinary(f"STOR {_wire(self._path(name))}", io.BytesIO(content))
        except ftplib.all_errors as error:
            raise _unwritten(name, error) from error

    def read(self, name: str) -> bytes | None:
        """As :class:`Store` has it."""
        out = io.BytesIO()

        def keep(part: bytes) -> None:
            if out.tell() + len(part) > MOST_BYTES:
                self.close()  # the rest of it is not waited for
                what = f"{self._url}{self._path(name)}: over {MOST_BYTES} bytes came back"
                raise refusal("upload.controller", what)
            out.write(part)

        try:
            self._link.retrbinary(f"RETR {_wire(self._path(name))}", keep)
        except ftplib.error_perm:
            return None
        except ftplib.all_errors as error:
            raise self._gone(self._path(name), error) from error
        return out.getvalue()

    def remove(self, name: str) -> bool:
        """As :class:`Store` has it."""
        for gone in (self._link.delete, self._link.rmd):
            try:
                gone(_wire(self._path(name)))
            except ftplib.error_perm:
                continue
            except ftplib.all_errors:
                return False
            return True
        above, _, own = name.rpartition("/")
        return own not in (self.listing(above) or {})

    def close(self) -> None:
        """As :class:`Store` has it."""
        self._link.close()

    def _path(self, name: str) -> str:
        return f"{self._root}/{name}" if name else self._root or "/"

    def _gone(self, path: str, error: Exception) -> TandemError:
        what = f"{self._url}{path}: {_told(error)}"
        return refusal("upload.controller", what, hint="see that the server answers, and try again")


def _unwritten(name: str, error: Exception) -> TandemError:
    why = error.strerror if isinstance(error, OSError) and error.strerror else _told(error)
    full = is_disk_full(error) or re.search(r"\b(?:452|552)\b|space|quota", str(error), re.IGNORECASE)
    what = f"{name} is not written ({why})" + ("; the disk there is full" if full else "")
    hint = (
        "make room there, then send again" if full else "see the room and the rights there, then send again"
    )
    return refusal("upload.write", what, hint=hint)
