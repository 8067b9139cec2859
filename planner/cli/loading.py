"""``tandem upload`` and ``tandem download``: programs to controllers and back."""

from __future__ import annotations

import dataclasses
import getpass
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal
from urllib.parse import urlsplit

import tyro

from planner.files import write_whole
from planner.issues import Issue, TandemError

if TYPE_CHECKING:
    from planner.loading.rws import Rws
    from planner.loading.store import Store

PASSWORD = "TANDEM_CONTROLLER_PASSWORD"
"""The variable of the environment that holds the password."""


@dataclasses.dataclass(frozen=True)
class Where:
    """The controller."""

    folder: tyro.conf.Positional[Path]
    """a result folder of ``tandem plan``"""
    controller: str
    """http://HOST, https://HOST (ABB), ftp://HOST/FOLDER, ftps://..., or a folder that is mounted"""
    user: str = "Default User"
    """who logs in; the password is in TANDEM_CONTROLLER_PASSWORD, or is asked for"""
    rws: Literal[1, 2] | None = None
    """Robot Web Services 1.0 or 2.0; unless stated 1 for http and 2 for https"""
    arm: str | None = None
    """whose controller it is, where each arm has its own"""
    ca: Path | None = None
    """a file of certificates by which the controller's is trusted"""
    fingerprint: str | None = None
    """SHA-256 of a self-signed certificate that you have compared"""
    timeout: float = 20.0
    """longest wait for an answer [s]"""


@dataclasses.dataclass(frozen=True)
class Download(Where):
    """Where the programs go."""

    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("downloaded")
    """folder for the programs that come back; must be new or empty"""
    there: str | None = None
    """the folder on the controller, as upload named it; unless stated, the first of this result"""


def connect(where: Where) -> Rws | Store:
    """The controller, share or FTP folder. Raises ``TandemError`` (``upload.*``)."""
    from planner.loading.http_link import Link, Login
    from planner.loading.rws import Rws
    from planner.loading.store import Ftp, Share

    scheme = urlsplit(where.controller).scheme.lower()
    if scheme in ("http", "https"):
        version = where.rws or (1 if scheme == "http" else 2)
        login = Login(where.user, _password(where))
        own = (version == 2, where.timeout, where.ca, where.fingerprint)
        return Rws(Link(where.controller, login, *own), version)
    if scheme in ("ftp", "ftps"):
        return Ftp(where.controller, Login(where.user, _password(where)), where.timeout)
    return Share(Path(where.controller.removeprefix("file://")))


def _password(where: Where) -> str:
    if PASSWORD in os.environ:
        return os.environ[PASSWORD]
    if not sys.stdin.isatty():
        what = f"no password: set {PASSWORD}, or run at a terminal, which asks for it"
        raise TandemError(Issue("upload.login", what))
    return getpass.getpass(f"Password of {where.user} at {where.controller}: ")


def run_upload(where: Where) -> tuple[Issue, ...]:
    """Send a result, and tell what is there now."""
    from planner import pipeline
    from planner.cli.command_line import out
    from planner.loading import proven, upload
    from planner.loading.rws import Rws

    result = proven.read(where.folder, pipeline.load_result(where.folder))
    link = connect(where)
    send = upload.to_controller(link, result, where.arm) if isinstance(link, Rws) else None
    sent = send or upload.to_store(link, result, where.arm)
    out.print(
        f"{len(sent.files)} files in {sent.folder}, read back byte by byte", highlight=False, markup=False
    )
    if sent.agreed:
        out.print(f"ready to load; agreed: {', '.join(sent.agreed)}", highlight=False, markup=False)
    else:
        out.print("nothing of the controller was compared: not said to be ready", highlight=False)
    out.print("Nothing was loaded or started.", highlight=False)
    return sent.issues


def run_download(request: Download) -> tuple[tuple[Issue, ...], bool]:
    """Bring programs back; what was touched up there, and whether all that came back is proven."""
    from planner import pipeline
    from planner.loading import download, proven

    problem = pipeline.load_result(request.folder)
    result = proven.read(request.folder, problem)
    if request.output.exists() and any(request.output.iterdir()):
        what = f"-o {request.output}: is not empty; name a new folder"
        raise TandemError(Issue("output.folder", what, field="output"))
    _, files = proven.chosen(result, request.arm)
    back = download.fetch(connect(request), request.there or proven.folder_name(problem))
    for name, content in back.items():
        if ".." in Path(name).parts or Path(name).is_absolute():
            raise TandemError(Issue("upload.controller", f"{name!r} is no name of a file in a folder"))
        write_whole(request.output / "programs" / name, content)
    issues = download.touched(files, back)
    texts = pipeline.read_programs(request.output)
    others = {name: content for name, content in result.files.items() if name not in files}
    for name, content in others.items():  # the other controller's, as they were sent
        texts.setdefault(name, content.decode())
    proof = pipeline.verify(problem, texts)
    return (*issues, *proof.issues), proof.ok and not issues
