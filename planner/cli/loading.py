"""``tandem upload`` and ``tandem download``: programs to controllers and back."""

from __future__ import annotations

import dataclasses
import getpass
import os
import sys
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from planner.cli.console import out
from planner.files import RELEASE, write_whole
from planner.issues import Issue, Severity, refusal

if TYPE_CHECKING:
    from planner.proof.verdict import Proof
    from planner.shopfloor.loading.rws import Rws
    from planner.shopfloor.loading.store import Store
    from planner.shopfloor.loading.upload import Sent

PASSWORD = "TANDEM_CONTROLLER_PASSWORD"
"""The variable of the environment that holds the password."""
MOST_TOLD = 100
"""Places that were touched up which are told one by one; the others are counted."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Access:
    """How a controller is reached."""

    user: str | None = None
    """who logs in, "Default User" at ABB's and anonymous at FTP unless stated; the password is in
    TANDEM_CONTROLLER_PASSWORD, or is asked for"""
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


@dataclasses.dataclass(frozen=True, kw_only=True)
class Upload(Access):
    """What is sent, and where."""

    folder: tyro.conf.Positional[Path]
    """a result folder of ``tandem plan``"""
    controller: str
    """http://HOST, https://HOST (ABB), ftp://HOST/FOLDER, ftps://..., or a folder that is mounted"""
    released: bool = False
    """send only what somebody has released at the service that the result came from"""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Download(Access):
    """What is brought back, from where, and what it was."""

    controller: tyro.conf.Positional[str]
    """http://HOST, https://HOST (ABB), ftp://HOST/FOLDER, ftps://..., or a folder that is mounted"""
    result: Path
    """the result folder that was sent: its problem proves what comes back, its programs tell what changed"""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("downloaded")
    """folder for the programs that come back; must be new or empty"""
    there: str | None = None
    """the folder on the controller, as upload named it; unless stated, the one that is of this result"""


def connect(where: str, access: Access) -> Rws | Store:
    """The controller, share or FTP folder. Raises ``TandemError`` (``upload.*``)."""
    from planner.shopfloor.loading.http_link import Link, Login, Trust
    from planner.shopfloor.loading.rws import Rws
    from planner.shopfloor.loading.store import Ftp, Share

    where = where.strip()
    scheme = where.partition("://")[0].lower() if "://" in where else ""
    trust = Trust(access.ca, access.fingerprint)
    if scheme in ("http", "https"):
        version = access.rws or (1 if scheme == "http" else 2)
        user = access.user or "Default User"
        login = Login(user, _password(user, where))
        return Rws(Link(where, login, version == 2, access.timeout, trust), version)
    if scheme in ("ftp", "ftps"):
        user = access.user or "anonymous"
        login = Login(user, "" if access.user is None else _password(user, where))
        return Ftp(where, login, access.timeout, trust)
    if scheme not in ("", "file"):
        what = f"--controller: got {where}, allowed: http://, https://, ftp://, ftps://, or a folder"
        raise refusal("upload.address", what, field="controller")
    return Share(Path(where.removeprefix("file://")))


def _password(user: str, where: str) -> str:
    if PASSWORD in os.environ:
        return os.environ[PASSWORD]
    if not sys.stdin.isatty():
        what = f"no password: set {PASSWORD}, or run at a terminal, which asks for it"
        raise refusal("upload.login", what)
    return getpass.getpass(f"Password of {user} at {where}: ")


def run_upload(request: Upload) -> Sent:
    """Send a result, and tell what is there now."""
    from planner import pipeline
    from planner.shopfloor.loading import compare, proven, upload
    from planner.shopfloor.loading.rws import Rws

    result = proven.read(request.folder, pipeline.load_result(request.folder))
    said = proven.released(request.folder, result, request.released)
    with closing(connect(request.controller, request)) as link:
        if isinstance(link, Rws):
            sent = upload.to_controller(link, result, request.arm)
        else:
            sent = upload.to_store(link, result, request.arm)

    def tell(what: str) -> None:
        out.print(what, highlight=False, markup=False, soft_wrap=True)

    tell(f"{len(sent.files)} files in {sent.folder}, read back byte by byte")
    if said is not None:
        tell(f"These programs are {said}, as {RELEASE} says.")
    if sent.agreed:
        tell(f"agreed: {', '.join(sent.agreed)}")
    if sent.ready:
        tell(f"Ready to load: all that is read of a controller agreed; {compare.WITHOUT}.")
    else:
        tell("NOT said to be ready, for this was not looked at:")
        for issue in sent.issues:
            tell(f"  {issue.message.removeprefix('not looked at: ')}")
    tell("Nothing was loaded or started.")
    return sent


def run_download(request: Download) -> tuple[tuple[Issue, ...], Proof]:
    """Bring programs back: what was touched up there, and the proof of what came back."""
    from planner import pipeline
    from planner.programs import text
    from planner.shopfloor.loading import download, proven, touched

    problem = pipeline.load_result(request.result)
    result = proven.read(request.result, problem)
    if request.output.exists() and (not request.output.is_dir() or any(request.output.iterdir())):
        what = f"-o {request.output}: is not an empty folder; name a new one"
        raise refusal("output.folder", what, field="output")
    _, files = proven.chosen(result, request.arm)
    with closing(connect(request.controller, request)) as link:
        name = request.there or download.folder(link, proven.folder_name(problem))
        back = download.fetch(link, name)
    for file, content in back.items():
        write_whole(request.output / "programs" / file, content)
    for path in sorted((request.result / "problem").rglob("*")):  # what `tandem verify` asks for
        if path.is_file():
            write_whole(request.output / path.relative_to(request.result), path.read_bytes())
    texts = pipeline.read_programs(request.output)
    for file, content in result.files.items():
        if file not in files:  # the other controller's, as they were sent
            texts.setdefault(file, text.decode(content, file))
    return touched.touched(files, back), pipeline.verify(problem, texts)


def shortened(found: tuple[Issue, ...]) -> tuple[Issue, ...]:
    """Issues, the first of them one by one and the others as one that counts them."""
    if len(found) <= MOST_TOLD:
        return found
    more = f"{len(found) - MOST_TOLD} more places are not as they were sent"
    return (*found[:MOST_TOLD], Issue("upload.touched", more, Severity.WARNING, count=len(found) - MOST_TOLD))
