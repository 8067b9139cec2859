"""Stores for program files, seen as folders and files: a share, an FTP server, or a controller's home folder.

FTP uses the standard library's ``ftplib`` (RFC 959), with TLS for ``ftps://`` (RFC 4217). Replies 452 and 552
mean that there is no space (RFC 959, 4.2.1).
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
from planner.issues import TandemError, issue_error
from planner.shopfloor.loading.http_link import MAX_BYTES, Login, Trust, address

_UNIX: Final = re.compile(
    r"(?P<folder>[-dl])[rwxsStT-]{9}\S?\s+(?:\S+\s+){4,7}?(?:\d{4}|\d\d?:\d\d)\s(?P<name>.+)"
)
_DOS: Final = re.compile(r"\d[\d-]+\s+\d\d?:\d\d\s*(?:[AP]M)?\s+(?P<folder><DIR>|\d+)\s+(?P<name>.+)")
"""Lines of the FTP command LIST as UNIX and DOS servers print them."""


class Store(Protocol):
    """Folders and files of a controller, by names with ``/`` relative to the store's folder, which is ""."""

    def listing(self, folder: str) -> dict[str, bool] | None:
        """Return whether each entry of a folder is a folder, by name; None if there is no such folder."""

    def make(self, folder: str) -> None:
        """Create a folder in an existing one."""

    def write(self, name: str, content: bytes) -> None:
        """Write a file.

        Raises:
            TandemError: ``upload.write`` if it cannot be written.
        """

    def read(self, name: str) -> bytes | None:
        """Return the content of a file; None if there is no such file."""

    def remove(self, name: str) -> bool:
        """Delete a file or an empty folder, and return whether it no longer exists."""

    def close(self) -> None:
        """Close the connection."""


class MountedFolder:
    """A store in a folder of this machine, such as a mounted share."""

    def __init__(self, root: Path) -> None:
        if not root.is_dir():
            text = f"{root}: no such folder; mount the controller's share, or correct the path"
            raise issue_error("upload.controller", text)
        self.root = root

    def listing(self, folder: str) -> dict[str, bool] | None:
        """See :class:`Store`."""
        path = self.root / folder
        try:
            return {p.name: p.is_dir() for p in path.iterdir()} if path.is_dir() else None
        except OSError as error:
            raise _mount_read_error(path, error) from error

    def make(self, folder: str) -> None:
        """See :class:`Store`."""
        try:
            (self.root / folder).mkdir()
        except OSError as error:
            raise _write_error(folder, error) from error

    def write(self, name: str, content: bytes) -> None:
        """See :class:`Store`; an existing file is never overwritten."""
        try:
            with (self.root / name).open("xb") as stream:
                stream.write(content)
        except OSError as error:
            raise _write_error(name, error) from error

    def read(self, name: str) -> bytes | None:
        """See :class:`Store`."""
        path = self.root / name
        try:
            return path.read_bytes() if path.is_file() else None
        except OSError as error:
            raise _mount_read_error(path, error) from error

    def remove(self, name: str) -> bool:
        """See :class:`Store`."""
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
        """See :class:`Store`."""


def _mount_read_error(path: Path, error: OSError) -> TandemError:
    text = f"{path} cannot be read ({error.strerror or error})"
    return issue_error("upload.controller", text, hint="check that the share is mounted, and its permissions")


WIRE: Final = "latin-1"
"""Encoding of FTP lines, in which each byte is one character.

Names are UTF-8 (RFC 2640) if possible. Some servers, such as those on Windows, use bytes that are not UTF-8
in lists and replies.
"""


def _decode_line(line: str) -> str:
    """Decode a line from a server.

    Bytes that are not UTF-8 are escaped, so that :func:`_encode_line` restores them.
    """
    return line.encode(WIRE, "replace").decode("utf-8", "surrogateescape")


def _error_text(error: Exception) -> str:
    """Return the text of an error, from a server or from this machine, for display."""
    return str(error).encode(WIRE, "replace").decode("utf-8", "replace") or type(error).__name__


def _encode_line(text: str) -> str:
    """Encode a text for the connection; the inverse of :func:`_decode_line`.

    Raises ``TandemError`` (``upload.address``) for control characters, which could start further commands.
    """
    if any(ord(letter) < 32 for letter in text):
        message = (
            "names, users and passwords for FTP must not contain control characters, such as line breaks"
        )
        raise issue_error("upload.address", message)
    return text.encode("utf-8", "surrogateescape").decode(WIRE)


class _Channel(ftplib.FTP_TLS):
    """FTP over TLS that checks the trusted certificate on every connection, including data connections."""

    trust = Trust()
    url = ""

    def ntransfercmd(self, cmd: str, rest: int | str | None = None) -> tuple[socket.socket, int | None]:
        """Open a data connection as the base class does, and check its certificate."""
        connection, size = super().ntransfercmd(cmd, rest)
        self.trust.check(connection, self.url)
        return connection, size


class Ftp:
    """A store in a folder of an FTP server, ``ftp://HOST[:PORT]/FOLDER``.

    The password is sent in plain text, except with ``ftps``. ``timeout`` [s] is that of each wait.

    Raises:
        TandemError: ``upload.address`` for an invalid URL, ``upload.login`` if user, folder or certificate is
            refused, ``upload.controller`` if the server is unreachable.
    """

    def __init__(self, url: str, login: Login, timeout: float, trust: Trust | None = None) -> None:
        parts = address(url)
        if not parts.hostname:
            raise issue_error("upload.address", f"got {url}, allowed: ftp://HOST[:PORT]/FOLDER")
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
            link.login(_encode_line(login.user), _encode_line(login.password))
            if isinstance(link, _Channel):
                link.prot_p()
            link.cwd(_encode_line(unquote(parts.path)) or "/")
            self._root = _decode_line(link.pwd()).rstrip("/")
        except ftplib.error_perm as error:
            message = f"{url}: user {login.user!r} or the folder is refused ({_error_text(error)[:60]})"
            raise issue_error("upload.login", message) from error
        except ssl.SSLCertVerificationError as error:
            message = f"the certificate of {self._url} is not trusted ({error.verify_message})"
            hint = "give --ca FILE, or --fingerprint SHA256 for a self-signed one that you have checked"
            raise issue_error("upload.login", message, hint=hint) from error
        except ftplib.all_errors as error:
            message = f"{url} cannot be reached ({_error_text(error)}), waited up to {timeout:g} s"
            hint = "check that the server is on and reachable, and try again"
            raise issue_error("upload.controller", message, hint=hint) from error
        self._connection = link

    def _secure(self, trust: Trust, timeout: float) -> _Channel:
        """Return a channel with TLS that is not connected yet."""
        link = _Channel(timeout=timeout, context=trust.context(), encoding=WIRE)
        link.trust = trust
        link.url = self._url
        return link

    def listing(self, folder: str) -> dict[str, bool] | None:
        """Return whether each entry of a folder is a folder, by name; None if there is no such folder.

        The command is MLSD (RFC 3659) if the server supports it, else LIST.

        Raises:
            TandemError: ``upload.controller`` if the server does not answer.
        """
        path = self._path(folder)
        try:
            self._connection.cwd(_encode_line(path))
        except ftplib.error_perm:
            return None
        except ftplib.all_errors as error:
            raise self._read_error(path, error) from error
        try:
            # values of facts are case-insensitive (RFC 3659, 7.2); entries such as "cdir" are not contents
            entries = [
                (_decode_line(name), facts.get("type", "").lower())
                for name, facts in self._connection.mlsd(_encode_line(path))
            ]
            return {name: kind == "dir" for name, kind in entries if kind in ("dir", "file")}
        except ftplib.error_perm:
            return self._list_by_command(path)
        except ftplib.all_errors as error:
            raise self._read_error(path, error) from error

    def _list_by_command(self, path: str) -> dict[str, bool]:
        """Return the entries of the current folder by the command LIST; ``path`` is for messages."""
        lines: list[str] = []
        try:
            self._connection.retrlines("LIST", lines.append)
        except ftplib.error_perm as error:
            if str(error).startswith("550"):  # some servers answer 550 for an empty folder
                return {}
            raise self._read_error(path, error) from error
        except ftplib.all_errors as error:
            raise self._read_error(path, error) from error
        out = {}
        for line in map(_decode_line, lines):
            if line.startswith("total "):
                continue
            entry = _UNIX.match(line) or _DOS.match(line)
            if entry is None:
                message = f"{self._url}{path}: a line of its file list cannot be parsed: {line[:80]!r}"
                raise issue_error("upload.controller", message)
            if entry["name"] not in (".", ".."):
                out[entry["name"]] = entry["folder"] in ("d", "<DIR>")
        return out

    def make(self, folder: str) -> None:
        """See :class:`Store`."""
        try:
            self._connection.mkd(_encode_line(self._path(folder)))
        except ftplib.all_errors as error:
            raise _write_error(folder, error) from error

    def write(self, name: str, content: bytes) -> None:
        """See :class:`Store`."""
        try:
            self._connection.storbinary(f"STOR {_encode_line(self._path(name))}", io.BytesIO(content))
        except ftplib.all_errors as error:
            raise _write_error(name, error) from error

    def read(self, name: str) -> bytes | None:
        """See :class:`Store`."""
        out = io.BytesIO()

        def keep(part: bytes) -> None:
            if out.tell() + len(part) > MAX_BYTES:
                self.close()  # do not wait for the rest
                what = f"{self._url}{self._path(name)}: the file is longer than {MAX_BYTES} bytes"
                raise issue_error("upload.controller", what)
            out.write(part)

        try:
            self._connection.retrbinary(f"RETR {_encode_line(self._path(name))}", keep)
        except ftplib.error_perm:
            return None
        except ftplib.all_errors as error:
            raise self._read_error(self._path(name), error) from error
        return out.getvalue()

    def remove(self, name: str) -> bool:
        """See :class:`Store`."""
        for delete in (self._connection.delete, self._connection.rmd):
            try:
                delete(_encode_line(self._path(name)))
            except ftplib.error_perm:
                continue
            except ftplib.all_errors:
                return False
            return True
        # both are refused: it may not exist
        parent, _, own_name = name.rpartition("/")
        return own_name not in (self.listing(parent) or {})

    def close(self) -> None:
        """See :class:`Store`."""
        self._connection.close()

    def _path(self, name: str) -> str:
        return f"{self._root}/{name}" if name else self._root or "/"

    def _read_error(self, path: str, error: Exception) -> TandemError:
        """Return the error that a folder or file cannot be read, because the server refuses or is gone."""
        message = f"{self._url}{path}: {_error_text(error)}"
        return issue_error("upload.controller", message, hint="check that the server answers, and try again")


def _write_error(name: str, error: Exception) -> TandemError:
    """Return the error that a folder or file cannot be written, and whether the disk is full."""
    reason = error.strerror if isinstance(error, OSError) and error.strerror else _error_text(error)
    is_full = is_disk_full(error) or re.search(r"\b(?:452|552)\b|space|quota", str(error), re.IGNORECASE)
    text = f"{name} could not be written ({reason})" + ("; the disk is full" if is_full else "")
    hint = (
        "free disk space, then send again" if is_full else "check free space and permissions, then send again"
    )
    return issue_error("upload.write", text, hint=hint)
