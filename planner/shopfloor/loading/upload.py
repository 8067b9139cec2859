"""Upload of a verified result to a controller.

It is compared, written into a new folder, read back, and never started.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import PurePosixPath

from planner.issues import Issue, Severity, TandemError, issue_error
from planner.programs import text
from planner.shopfloor.loading import compare, krc
from planner.shopfloor.loading.proven import Proven, folder_name, select_programs
from planner.shopfloor.loading.rws import Rws
from planner.shopfloor.loading.store import Store

MAX_FOLDERS = 99
"""Maximum number of folders of one result on a controller."""


@dataclasses.dataclass(frozen=True)
class UploadedPrograms:
    """Result of an upload.

    Attributes:
        folder: Folder on the controller.
        files: Its files.
        issues: What was not compared, or speaks against loading it.
        agreed: What agrees.
    """

    folder: str
    files: tuple[str, ...]
    issues: tuple[Issue, ...]
    agreed: tuple[str, ...] = ()

    @property
    def ready(self) -> bool:
        """Whether everything was compared and agrees. A file on a disk alone is not ready to be loaded."""
        return bool(self.agreed) and not self.issues


def to_controller(rws: Rws, proven: Proven, arm: str | None = None) -> UploadedPrograms:
    """Send RAPID to a controller in automatic mode with stopped programs.

    If the controller is not as planned, nothing is written.

    Raises:
        TandemError: ``upload.*``.
    """
    arms, files = select_programs(proven, arm)
    if any(one.data.family == "KUKA" for one in arms):
        raise issue_error("upload.address", "KRL goes to a folder or ftp://, not to Robot Web Services")
    _require_stopped(rws)
    texts = {name: text.decode(content, name) for name, content in proven.files.items()}
    comparison = compare.compare(rws, proven.problem, texts, arms)
    if comparison.differs:
        raise TandemError((*comparison.differs, *comparison.not_looked_at))
    rws.hold()
    try:
        _require_stopped(rws)
        folder = put(rws, folder_name(proven.problem), files)
    finally:
        released = rws.release()
    held = () if released else (_warning("mastership was not released; release it at the pendant"),)
    return UploadedPrograms(
        folder, tuple(sorted(files)), (*comparison.not_looked_at, *held), comparison.agreed
    )


def to_store(store: Store, proven: Proven, arm: str | None = None) -> UploadedPrograms:
    """Send programs to a share or an FTP folder. Available files of a KUKA controller behind it are compared.

    If they differ, nothing is written.

    Raises:
        TandemError: ``upload.*``.
    """
    arms, files = select_programs(proven, arm)
    comparison = krc.compare(store, files, arms)
    if comparison.differs:
        raise TandemError((*comparison.differs, *comparison.not_looked_at))
    folder = put(store, folder_name(proven.problem), files)
    return UploadedPrograms(folder, tuple(sorted(files)), comparison.not_looked_at, comparison.agreed)


def _warning(what: str) -> Issue:
    return Issue("upload.not_looked_at", what, Severity.WARNING)


def _require_stopped(rws: Rws) -> None:
    """Require automatic mode and stopped execution. Neither is ever changed from here."""
    mode, running = rws.mode, rws.execution
    if running != "stopped":
        what = f"RAPID execution is {running!r}, allowed is 'stopped'; nothing was written"
        raise issue_error("upload.busy", what, hint="stop the program at the controller, then send again")
    if mode != "AUTO":
        what = f"the controller is in mode {mode}, allowed is AUTO; nothing was written"
        hint = "in manual mode the pendant may change programs: close the gate and switch to AUTO"
        raise issue_error("upload.busy", what, hint=hint)


def put(store: Store, name: str, files: Mapping[str, bytes]) -> str:
    """Write files into a new folder, read them back and compare their bytes; return the folder's name.

    Nothing is overwritten: a name that exists gets a number. If writing fails, what was written is removed;
    if that fails too, it is named.

    Raises:
        TandemError: ``upload.controller``, ``upload.write``.
    """
    existing = store.listing("")
    if existing is None:
        raise issue_error("upload.controller", "the controller has no home folder")
    taken = {one.lower() for one in existing}
    names = [name, *(f"{name}_{k}" for k in range(2, MAX_FOLDERS + 1))]
    folder = next((one for one in names if one.lower() not in taken), None)
    if folder is None:
        what = f"{MAX_FOLDERS} folders {name} exist; delete old ones on the controller"
        raise issue_error("upload.write", what)
    created: list[str] = []
    try:
        store.make(folder)  # noted afterwards: never delete what another client created
        created.append(folder)
        for inner in sorted({str(p) for n in files for p in PurePosixPath(n).parents if str(p) != "."}):
            store.make(f"{folder}/{inner}")
            created.append(f"{folder}/{inner}")
        for file, content in sorted(files.items()):
            created.append(f"{folder}/{file}")
            store.write(f"{folder}/{file}", content)
        for file, content in sorted(files.items()):
            _same(file, content, store.read(f"{folder}/{file}"))
    except BaseException as error:  # an incomplete program must never remain
        left = _cleaned(store, created)
        after = f"delete by hand what remains: {', '.join(left)}" if left else "nothing of it remains"
        if not created and isinstance(error, TandemError) and error.issues[0].code == "upload.controller":
            after = f"{folder} may exist, empty"
        if not isinstance(error, TandemError):
            error.add_note(f"upload of {folder}: {after}")
            raise
        issues = [dataclasses.replace(issue, message=f"{issue.message}; {after}") for issue in error.issues]
        raise TandemError(issues) from error
    return folder


def _same(name: str, sent: bytes, back: bytes | None) -> None:
    if back == sent:
        return
    got = "nothing" if back is None else f"{len(back)} bytes"
    what = f"{name}: {got} read back, {len(sent)} bytes sent"
    if back is not None and len(back) == len(sent):
        at = next(k for k, (a, b) in enumerate(zip(sent, back, strict=True)) if a != b)
        what = f"{name}: byte {at} read back differs from the one sent"
    raise issue_error("upload.write", what)


def _cleaned(store: Store, created: Sequence[str]) -> list[str]:
    """Remove what was ``created``; returns what could not be removed."""
    left = []
    for name in reversed(created):
        try:
            gone = store.remove(name)
        except Exception:  # continue with the others
            gone = False
        left += [] if gone else [name]
    return left
