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
from planner.files import RELEASE, write_atomic
from planner.issues import Issue, Severity, issue_error

if TYPE_CHECKING:
    from planner.proof.verdict import Proof
    from planner.shopfloor.loading.rws import Rws
    from planner.shopfloor.loading.store import Store
    from planner.shopfloor.loading.upload import UploadedPrograms

PASSWORD_VARIABLE = "TANDEM_CONTROLLER_PASSWORD"
"""Environment variable that holds the password."""
MAX_LISTED_PLACES = 100
"""Maximum number of touched-up positions that are listed. Further ones are counted."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Access:
    """Access to a controller."""

    user: str | None = None
    """user name; default "Default User" at ABB and anonymous at FTP; the password is in
    TANDEM_CONTROLLER_PASSWORD, or is asked for
    """
    rws: Literal[1, 2] | None = None
    """Robot Web Services 1.0 or 2.0; default 1 for http and 2 for https"""
    arm: str | None = None
    """the arm whose controller it is, if each arm has its own"""
    ca: Path | None = None
    """a file of certificates by which the controller's certificate is trusted"""
    fingerprint: str | None = None
    """SHA-256 of a self-signed certificate that you have compared"""
    timeout: float = 20.0
    """maximum time to wait for an answer [s]"""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Upload(Access):
    """What is sent, and where."""

    folder: tyro.conf.Positional[Path]
    """a result folder of ``tandem plan``"""
    controller: str
    """http://HOST, https://HOST (ABB), ftp://HOST/FOLDER, ftps://..., or a mounted folder"""
    released: bool = False
    """send only what has been released at the service that the result came from"""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Download(Access):
    """What is fetched, from where, and the result that it was."""

    controller: tyro.conf.Positional[str]
    """http://HOST, https://HOST (ABB), ftp://HOST/FOLDER, ftps://..., or a mounted folder"""
    result: Path
    """the result folder that was sent: its problem proves what comes back, its programs show what changed"""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("downloaded")
    """folder for the programs that come back; must be new or empty"""
    there: str | None = None
    """the folder on the controller, as upload named it; default: the one of this result"""


def connect(where: str, access: Access) -> Rws | Store:
    """Connect to a controller, share or FTP folder.

    Raises:
        TandemError: ``upload.*``.
    """
    from planner.shopfloor.loading.http_link import Link, Login, Trust
    from planner.shopfloor.loading.rws import Rws
    from planner.shopfloor.loading.store import Ftp, MountedFolder

    where = where.strip()
    scheme = where.partition("://")[0].lower() if "://" in where else ""
    trust = Trust(access.ca, access.fingerprint)
    if scheme in ("http", "https"):
        version = access.rws or (1 if scheme == "http" else 2)
        user = access.user or "Default User"
        login = Login(user, _read_password(user, where))
        return Rws(Link(where, login, version == 2, access.timeout, trust), version)
    if scheme in ("ftp", "ftps"):
        user = access.user or "anonymous"
        login = Login(user, "" if access.user is None else _read_password(user, where))
        return Ftp(where, login, access.timeout, trust)
    if scheme not in ("", "file"):
        message = f"--controller: got {where}, allowed: http://, https://, ftp://, ftps://, or a folder"
        raise issue_error("upload.address", message, field="controller")
    return MountedFolder(Path(where.removeprefix("file://")))


def _read_password(user: str, where: str) -> str:
    """Return the password in the environment variable, or ask for it at the terminal."""
    if PASSWORD_VARIABLE in os.environ:
        return os.environ[PASSWORD_VARIABLE]
    if not sys.stdin.isatty():
        message = f"no password: set {PASSWORD_VARIABLE}, or run in a terminal, where the command asks for it"
        raise issue_error("upload.login", message)
    return getpass.getpass(f"Password of {user} at {where}: ")


def run_upload(request: Upload) -> UploadedPrograms:
    """Send a verified result to a controller and print what was sent and compared.

    Raises:
        TandemError: ``upload.*``, or the folder cannot be read.
    """
    from planner import pipeline
    from planner.shopfloor.loading import compare, proven, upload
    from planner.shopfloor.loading.rws import Rws

    result = proven.read(request.folder, pipeline.load_result(request.folder))
    release_text = proven.released(request.folder, result, request.released)
    with closing(connect(request.controller, request)) as link:
        if isinstance(link, Rws):
            sent = upload.to_controller(link, result, request.arm)
        else:
            sent = upload.to_store(link, result, request.arm)

    def print_line(line: str) -> None:
        out.print(line, highlight=False, markup=False, soft_wrap=True)

    print_line(f"{len(sent.files)} files in {sent.folder}, read back and compared")
    if release_text is not None:
        print_line(f"These programs are {release_text}, according to {RELEASE}.")
    if sent.agreed:
        print_line(f"agreed: {', '.join(sent.agreed)}")
    if sent.ready:
        print_line(f"Ready to load: all data that is read from a controller agrees; {compare.WITHOUT}.")
    else:
        print_line("NOT reported as ready, because this was not compared:")
        for issue in sent.issues:
            print_line(f"  {issue.message.removeprefix('not looked at: ')}")
    print_line("Nothing was loaded or started.")
    return sent


def run_download(request: Download) -> tuple[tuple[Issue, ...], Proof]:
    """Fetch programs from a controller, write them to a new folder and prove them.

    Returns:
        Issues for positions that were touched up on the controller, and the proof of the fetched programs.

    Raises:
        TandemError: ``upload.*``, ``output.folder``, or the result folder cannot be read.
    """
    from planner import pipeline
    from planner.programs import text
    from planner.shopfloor.loading import download, proven, touched

    problem = pipeline.load_result(request.result)
    result = proven.read(request.result, problem)
    if request.output.exists() and (not request.output.is_dir() or any(request.output.iterdir())):
        message = f"-o {request.output}: is not an empty folder; name a new one"
        raise issue_error("output.folder", message, field="output")
    _, sent_files = proven.select_programs(result, request.arm)
    with closing(connect(request.controller, request)) as link:
        controller_folder = request.there or download.folder(link, proven.folder_name(problem))
        fetched_files = download.fetch(link, controller_folder)
    for file, content in fetched_files.items():
        write_atomic(request.output / "programs" / file, content)
    for path in sorted((request.result / "problem").rglob("*")):  # `tandem verify` needs them
        if path.is_file():
            write_atomic(request.output / path.relative_to(request.result), path.read_bytes())
    texts = pipeline.read_programs(request.output)
    for file, content in result.files.items():
        if file not in sent_files:  # files of the other controller, as sent
            texts.setdefault(file, text.decode(content, file))
    return touched.touched(sent_files, fetched_files), pipeline.verify(problem, texts)


def summarise_issues(issues: tuple[Issue, ...]) -> tuple[Issue, ...]:
    """Return the first `MAX_LISTED_PLACES` issues, and one issue that counts the others."""
    if len(issues) <= MAX_LISTED_PLACES:
        return issues
    message = f"{len(issues) - MAX_LISTED_PLACES} more places differ from what was sent"
    return (
        *issues[:MAX_LISTED_PLACES],
        Issue("upload.touched", message, Severity.WARNING, count=len(issues) - MAX_LISTED_PLACES),
    )
