"""Where program files go, seen as folders and files: a share, an FTP server, or a controller's home folder.

FTP by the standard library's ``ftplib`` (RFC 959), with TLS for ``ftps://`` (RFC 4217).
"""

from __future__ import annotations

import ftplib
import io
from pathlib import Path
from typing import Protocol
from urllib.parse import unquote, urlsplit

from planner.issues import Issue, TandemError
from planner.loading.http_link import Login


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


class Share:
    """A folder that is mounted here."""

    def __init__(self, root: Path) -> None:
        if not root.is_dir():
            what = f"{root}: no such folder; mount the controller's share, or give the right one"
            raise TandemError(Issue("upload.controller", what))
        self.root = root

    def listing(self, folder: str) -> dict[str, bool] | None:
        """As :class:`Store` has it."""
        path = self.root / folder
        return {p.name: p.is_dir() for p in path.iterdir()} if path.is_dir() else None

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
        return path.read_bytes() if path.is_file() else None

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


class Ftp:
    """A folder of an FTP server, ``ftp://HOST[:PORT]/FOLDER``. The password goes over the wire as it is, but
    for ``ftps``."""

    def __init__(self, url: str, login: Login, timeout: float) -> None:
        parts = urlsplit(url)
        if parts.username or parts.password:
            what = "a URL must hold no user or password; use --user and TANDEM_CONTROLLER_PASSWORD"
            raise TandemError(Issue("upload.address", what))
        try:
            link = ftplib.FTP_TLS(timeout=timeout) if parts.scheme == "ftps" else ftplib.FTP(timeout=timeout)
            link.connect(parts.hostname or "", parts.port or 21)
            link.login(login.user, login.password)
            if isinstance(link, ftplib.FTP_TLS):
                link.prot_p()
            link.cwd(unquote(parts.path) or "/")
        except ftplib.error_perm as error:
            what = f"{url}: user {login.user!r} or the folder is refused ({str(error)[:60]})"
            raise TandemError(Issue("upload.login", what)) from error
        except ftplib.all_errors as error:
            what = f"{url} cannot be reached ({error}), waited up to {timeout:g} s"
            raise TandemError(Issue("upload.controller", what)) from error
        self._link, self._root = link, link.pwd().rstrip("/")

    def listing(self, folder: str) -> dict[str, bool] | None:
        """As :class:`Store` has it."""
        try:
            self._link.cwd(self._path(folder))
            lines: list[str] = []
            self._link.retrlines("LIST", lines.append)
        except ftplib.error_perm:
            return None
        return {
            line.split(None, 8)[8]: line.startswith("d") for line in lines if len(line.split(None, 8)) > 8
        }

    def make(self, folder: str) -> None:
        """As :class:`Store` has it."""
        try:
            self._link.mkd(self._path(folder))
        except ftplib.all_errors as error:
            raise _unwritten(folder, error) from error

    def write(self, name: str, content: bytes) -> None:
        """As :class:`Store` has it."""
        try:
            self._link.storbinary(f"STOR {self._path(name)}", io.BytesIO(content))
        except ftplib.all_errors as error:
            raise _unwritten(name, error) from error

    def read(self, name: str) -> bytes | None:
        """As :class:`Store` has it."""
        out = io.BytesIO()
        try:
            self._link.retrbinary(f"RETR {self._path(name)}", out.write)
        except ftplib.error_perm:
            return None
        return out.getvalue()

    def remove(self, name: str) -> bool:
        """As :class:`Store` has it."""
        for gone in (self._link.delete, self._link.rmd):
            try:
                gone(self._path(name))
            except ftplib.all_errors:
                continue
            return True
        return False

    def _path(self, name: str) -> str:
        return f"{self._root}/{name}" if name else self._root or "/"


def _unwritten(name: str, error: Exception) -> TandemError:
    what = f"{name} is not written ({error}); see the room and the rights there, then send again"
    return TandemError(Issue("upload.write", what))
