"""Shares and FTP, against pyftpdlib; files of a KUKA controller in the format of its archives."""

from __future__ import annotations

import errno
import os
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pyftpdlib.authorizers import DummyAuthorizer
from pyftpdlib.filesystems import AbstractedFS
from pyftpdlib.handlers import FTPHandler
from pyftpdlib.servers import ThreadedFTPServer

from planner.issues import TandemError
from planner.shopfloor.loading import download, upload
from planner.shopfloor.loading import store as stores
from planner.shopfloor.loading.http_link import Login, Trust
from planner.shopfloor.loading.proven import Proven
from planner.shopfloor.loading.store import Ftp, MountedFolder
from tests.processes.hotwire.proof import bead_job
from tests.shopfloor.loading.ftps_server import FtpsServer
from tests.shopfloor.loading.rws_server import certificate, fingerprint

MACHINE = '$TRAFONAME[]="#KR60HA C4 FLR"\n$ROBROOT={X 0.0,Y 0.0,Z 0.0,A 0.0,B 0.0,C 0.0}\n'
CONFIG = """DEFDAT $CONFIG PUBLIC
TOOL_DATA[1]={X 0.0,Y 0.0,Z 160.0,A 0.0,B 0.0,C 0.0}
TOOL_NAME[1,]="plain"
LOAD_DATA[1]={M 0.9,CM {X 0.0,Y 0.0,Z 60.0,A 0.0,B 0.0,C 0.0},J {X 0.0,Y 0.0,Z 0.0}}
LOAD_NAME[1,]="plain"
BASE_DATA[4]={X 1100.0,Y 0.0,Z 500.0,A 0.0,B 0.0,C 0.0}
BASE_NAME[4,]="table"
ENDDAT
"""


class FullDisk(AbstractedFS):
    def open(self, filename: str, mode: str) -> Any:
        if "w" in mode and filename.endswith(".src"):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return super().open(filename, mode)


class Old(FTPHandler):
    """A server that knows LIST alone, as those of older controllers do."""

    proto_cmds = {k: v for k, v in FTPHandler.proto_cmds.items() if k not in ("MLSD", "MLST")}  # noqa: RUF012


@pytest.fixture(params=[FTPHandler, Old])
def server(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[str, Any, Path]]:
    users = DummyAuthorizer()
    (tmp_path / "krc").mkdir()
    users.add_user("kuka", "secret", str(tmp_path / "krc"), perm="elradfmw")
    handler = type("Handler", (request.param,), {"authorizer": users, "auth_failed_timeout": 0.1})
    made = ThreadedFTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=made.serve_forever, kwargs={"timeout": 0.05}, daemon=True)
    thread.start()
    yield f"ftp://127.0.0.1:{made.address[1]}/", handler, tmp_path / "krc"
    made.close_all()
    thread.join(5)


@pytest.fixture(scope="module")
def result() -> Proven:
    files = {name: text.encode() for name, text in bead_job.programs("kuka").items()}
    return Proven(bead_job.problem("kuka"), files)


def test_programs_go_by_ftp_into_a_new_folder_and_come_back(
    server: tuple[str, Any, Path], result: Proven
) -> None:
    url, handler, root = server
    (root / "old.src").write_text("DEF old()\nEND\n")
    store = Ftp(url, Login("kuka", "secret"), 5.0)
    first, second = upload.to_store(store, result), upload.to_store(store, result)
    assert second.folder == f"{first.folder}_2"
    assert download.fetch(store, second.folder) == dict(result.files)
    assert (root / "old.src").read_text() == "DEF old()\nEND\n"
    assert not second.ready
    with pytest.raises(TandemError, match=f"has more than one: {first.folder}, {second.folder}"):
        download.folder(store, first.folder)
    with pytest.raises(TandemError, match="no such folder") as caught:
        download.folder(store, "tandem_other_00000000")
    assert caught.value.issues[0].code == "upload.missing"
    handler.abstracted_fs = FullDisk
    with pytest.raises(TandemError, match="disk is full") as caught:
        upload.to_store(Ftp(url, Login("kuka", "secret"), 5.0), result)
    assert caught.value.issues[0].code == "upload.write"
    assert "nothing of it remains" in str(caught.value)
    assert {path.name for path in root.iterdir()} == {"old.src", first.folder, second.folder}
    store._connection.sock.shutdown(socket.SHUT_RDWR)  # type: ignore[union-attr]
    with pytest.raises(TandemError, match="try again") as caught:
        upload.to_store(store, result)
    assert caught.value.issues[0].code == "upload.controller"
    store.close()


def test_ftp_that_refuses_or_is_not_there_is_told(server: tuple[str, Any, Path]) -> None:
    url = server[0]
    for login, place, code in (
        (Login("kuka", "wrong"), url, "upload.login"),
        (Login("kuka", "secret"), f"{url}nowhere", "upload.login"),
        (Login("kuka", "secret"), "ftp://127.0.0.1:1/", "upload.controller"),
        (Login("kuka", "secret"), "ftp:///folder", "upload.address"),
        (Login("kuka", "secret"), "ftp://a:b@host/", "upload.address"),
        (Login("kuka", "secret"), "ftp://host:70000/", "upload.address"),
        (Login("kuka", "secret"), "ftp://[::1/", "upload.address"),
        (Login("kuka", "secret\r\nDELE x"), url, "upload.address"),
    ):
        with pytest.raises(TandemError) as caught:
            Ftp(place, login, 2.0)
        assert caught.value.issues[0].code == code, place
        assert "secret" not in str(caught.value)


class Renames(AbstractedFS):
    """A server that renames the files that it gets."""

    def open(self, filename: str, mode: str) -> Any:
        return super().open(f"{filename}.1" if "w" in mode else filename, mode)


def test_ftp_servers_of_other_kinds(
    server: tuple[str, Any, Path], result: Proven, monkeypatch: pytest.MonkeyPatch
) -> None:
    url, handler, root = server
    handler.banner, handler.encoding = "Begr\xfc\xdfung", "latin-1"  # as on Windows
    (root / os.fsdecode(b"\xdcbung.src")).write_bytes(b"DEF x()")
    (root / "\xdc").mkdir()
    store = Ftp(url, Login("kuka", "secret"), 5.0)
    sent = upload.to_store(store, result)
    assert download.fetch(store, sent.folder) == dict(result.files)
    monkeypatch.setattr(stores, "MAX_BYTES", 100)
    with pytest.raises(TandemError, match="longer than 100 bytes"):
        download.fetch(store, sent.folder)
    monkeypatch.undo()
    handler.abstracted_fs = Renames
    store = Ftp(url, Login("kuka", "secret"), 5.0)
    with pytest.raises(TandemError, match=r"nothing read back, .*delete by hand"):
        upload.to_store(store, result)
    with pytest.raises(TandemError, match="control characters"):
        store.read("x\r\nDELE y")
    store.close()


def test_ftp_by_tls_trusts_the_pinned_certificate_alone(tmp_path: Path, result: Proven) -> None:
    for name in ("root", "own", "other"):
        (tmp_path / name).mkdir()
    own, other = certificate(tmp_path / "own"), certificate(tmp_path / "other")
    server = FtpsServer(tmp_path / "root", own)
    login, pinned = Login("kuka", "secret"), Trust(fingerprint=fingerprint(own))
    store = Ftp(server.url, login, 5.0, pinned)
    sent = upload.to_store(store, result)
    assert download.fetch(store, sent.folder) == dict(result.files)
    assert "PROT P" in server.commands
    server.commands.clear()
    for trust, words in (
        (Trust(), "is not trusted"),
        (Trust(fingerprint=fingerprint(other)), "--fingerprint names"),
    ):
        with pytest.raises(TandemError, match=words) as caught:
            Ftp(server.url, login, 5.0, trust)
        assert caught.value.issues[0].code == "upload.login"
    assert not [word for word in server.commands if "secret" in word or "USER" in word]
    server.close()
    between = FtpsServer(tmp_path / "root", own, other)
    with pytest.raises(TandemError, match="--fingerprint names") as caught:
        upload.to_store(Ftp(between.url, login, 5.0, pinned), result)
    assert caught.value.issues[0].code == "upload.login"
    assert [path.name for path in (tmp_path / "root").iterdir()] == [sent.folder]
    between.close()


@pytest.mark.parametrize(
    ("line", "name", "deeper"),
    [
        ("-rw-r--r--   1 owner    group        1803128 Jul 10 10:18 ls lR.Z", "ls lR.Z", False),
        ("drwxr-xr-x  11 root     root            4096 Nov 26  2025 R1", "R1", True),
        ("11-26-26  02:41PM       <DIR>          KRC", "KRC", True),
        ("11-26-26  02:41PM                 1234 $config.dat", "$config.dat", False),
        ("2026-11-26  14:41       <DIR>          R1", "R1", True),
    ],
)
def test_lists_as_servers_of_unix_and_dos_print_them(line: str, name: str, deeper: bool) -> None:
    class Link:
        def retrlines(self, command: str, take: Any) -> None:
            take("total 3" if line[0] in "-d" else line)
            take(line)

    store = Ftp.__new__(Ftp)
    store._connection, store._url = Link(), "ftp://host"  # type: ignore[assignment]
    assert store._list_by_command("/") == {name: deeper}
    with pytest.raises(TandemError, match="cannot be parsed"):
        bad = type("Bad", (), {"retrlines": lambda _, command, take: take("?? what")})()
        store._connection = bad
        store._list_by_command("/")


@pytest.mark.parametrize(("root", "given"), [("", "."), ("R1", "."), ("KRC/R1", "."), ("R1", "R1/Program")])
def test_files_of_a_kuka_controller_are_compared_where_they_are(
    tmp_path: Path, result: Proven, root: str, given: str
) -> None:
    for folder, name, text in (("System", "$config.dat", CONFIG), ("mada", "$MACHINE.DAT", MACHINE)):
        (tmp_path / root / folder).mkdir(parents=True)
        (tmp_path / root / folder / name).write_bytes(text.replace("\n", "\r\n").encode())
    (tmp_path / given).mkdir(parents=True, exist_ok=True)
    sent = upload.to_store(MountedFolder(tmp_path / given), result)
    agreed = " ".join(sent.agreed)
    assert "$ROBROOT" in agreed
    assert "t_plain (TOOL_DATA[1])" in agreed
    assert "l_plain (LOAD_DATA[1])" in agreed
    assert "b_stock (BASE_DATA[4] by value)" in agreed
    (left,) = sent.issues
    assert "mode, version and model" in left.message
    assert not sent.ready


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("Z 160.0", "Z 161.5", "t_plain: TOOL_DATA[1] of that name differs: off by 1.500 mm, 0.000 deg"),
        ("Z 160.0,A 0.0", "Z 160.0,A 0.5", "off by 0.000 mm, 0.500 deg"),
        ("M 0.9", "M 1.9", "LOAD_DATA[1] of that name differs"),
        (
            "Y 0.0,Z 0.0,A 0.0,B 0.0,C 0.0}\n",
            "Y 3.0,Z 4.0,A 0.0,B 0.0,C 0.0}\n",
            "off zero by 5.000 mm, 0.0000 deg",
        ),
    ],
)
def test_a_kuka_controller_that_is_another_is_refused(
    tmp_path: Path, result: Proven, old: str, new: str, words: str
) -> None:
    texts = {"System/$config.dat": CONFIG, "Mada/$machine.dat": MACHINE}
    name = "Mada/$machine.dat" if words.startswith("off zero") else "System/$config.dat"
    assert old in texts[name]
    texts[name] = texts[name].replace(old, new, 1)
    for path, text in texts.items():
        (tmp_path / path).parent.mkdir()
        (tmp_path / path).write_text(text)
    with pytest.raises(TandemError) as caught:
        upload.to_store(MountedFolder(tmp_path), result)
    assert caught.value.issues[0].code == "upload.differs"
    assert words in str(caught.value)
    assert {path.name for path in tmp_path.iterdir()} == {"System", "Mada"}


def test_what_a_kuka_controller_does_not_tell_is_named(tmp_path: Path, result: Proven) -> None:
    sent = upload.to_store(MountedFolder(tmp_path), result)
    told = " ".join(issue.message for issue in sent.issues)
    assert all(word in told for word in ("$ROBROOT", "no $config.dat", "mode, version"))
    assert sent.agreed == ()
    (tmp_path / "System").mkdir()
    (tmp_path / "System" / "$config.dat").write_text(
        CONFIG.replace('"plain"', '"other"').replace("Z 160.0", "Z 9.0")
    )
    sent = upload.to_store(MountedFolder(tmp_path), result)
    assert any("t_plain: no TOOL_DATA has that name or value" in issue.message for issue in sent.issues)
