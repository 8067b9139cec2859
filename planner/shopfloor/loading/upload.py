"""Upload of a verified result to a controller.

The controller is compared with the result. Programs are written into a new folder and read back, but never
started.
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
        folder: Name of the folder on the controller.
        files: Names of its files.
        issues: What was not compared, or is a reason not to load the programs.
        agreed: Names of what was compared and agrees.
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
    """Send RAPID programs to a controller, which must be in automatic mode with stopped execution.

    ``arm`` is that of `select_programs`.

    Raises:
        TandemError: ``upload.*``; nothing is written if the controller is not as planned or not stopped.
    """
    arms, files = select_programs(proven, arm)
    if any(item.data.family == "KUKA" for item in arms):
        raise issue_error("upload.address", "KRL goes to a folder or ftp://, not to Robot Web Services")
    _require_stopped(rws)
    texts = {name: text.decode(content, name) for name, content in proven.files.items()}
    comparison = compare.compare(rws, proven.problem, texts, arms)
    if comparison.differs:
        raise TandemError((*comparison.differs, *comparison.not_looked_at))
    rws.hold()
    try:
        _require_stopped(rws)  # again, because it may have been started before mastership was taken
        folder = put(rws, folder_name(proven.problem), files)
    finally:
        released = rws.release()
    mastership_issues = (
        () if released else (_warning("mastership was not released; release it at the pendant"),)
    )
    return UploadedPrograms(
        folder, tuple(sorted(files)), (*comparison.not_looked_at, *mastership_issues), comparison.agreed
    )


def to_store(store: Store, proven: Proven, arm: str | None = None) -> UploadedPrograms:
    """Send programs to a share or an FTP folder.

    If the folder has the files of a KUKA controller, they are compared with the programs. ``arm`` is that of
    `select_programs`.

    Raises:
        TandemError: ``upload.*``; nothing is written if the controller's files differ.
    """
    arms, files = select_programs(proven, arm)
    comparison = krc.compare(store, files, arms)
    if comparison.differs:
        raise TandemError((*comparison.differs, *comparison.not_looked_at))
    folder = put(store, folder_name(proven.problem), files)
    return UploadedPrograms(folder, tuple(sorted(files)), comparison.not_looked_at, comparison.agreed)


def _warning(message: str) -> Issue:
    return Issue("upload.not_looked_at", message, Severity.WARNING)


def _require_stopped(rws: Rws) -> None:
    """Raise ``upload.busy`` unless mode is automatic and execution stopped. Neither is ever changed."""
    mode, execution = rws.mode, rws.execution
    if execution != "stopped":
        message = f"RAPID execution is {execution!r}, allowed is 'stopped'; nothing was written"
        raise issue_error("upload.busy", message, hint="stop the program at the controller, then send again")
    if mode != "AUTO":
        message = f"the controller is in mode {mode}, allowed is AUTO; nothing was written"
        hint = "in manual mode the pendant may change programs: close the gate and switch to AUTO"
        raise issue_error("upload.busy", message, hint=hint)


def put(store: Store, name: str, files: Mapping[str, bytes]) -> str:
    """Write files into a new folder, read them back and compare their bytes.

    Nothing is overwritten: if the folder exists, the new one gets a number. If writing fails, everything that
    was written is removed, and the error names what could not be removed.

    ``files`` has the contents by name, with ``/`` for subfolders. Returns the name of the folder.

    Raises:
        TandemError: ``upload.controller`` if the store cannot be read, ``upload.write`` if it cannot be
            written or a file differs when it is read back.
    """
    existing = store.listing("")
    if existing is None:
        raise issue_error("upload.controller", "the controller has no home folder")
    taken = {entry.lower() for entry in existing}
    names = [name, *(f"{name}_{k}" for k in range(2, MAX_FOLDERS + 1))]
    folder = next((candidate for candidate in names if candidate.lower() not in taken), None)
    if folder is None:
        message = f"{MAX_FOLDERS} folders {name} exist; delete old ones on the controller"
        raise issue_error("upload.write", message)
    created: list[str] = []
    try:
        store.make(folder)  # noted afterwards: never delete what another client created
        created.append(folder)
        subfolders = {
            str(parent) for file in files for parent in PurePosixPath(file).parents if str(parent) != "."
        }
        for subfolder in sorted(subfolders):
            store.make(f"{folder}/{subfolder}")
            created.append(f"{folder}/{subfolder}")
        for file, content in sorted(files.items()):
            created.append(f"{folder}/{file}")
            store.write(f"{folder}/{file}", content)
        for file, content in sorted(files.items()):
            _require_same(file, content, store.read(f"{folder}/{file}"))
    except BaseException as error:  # an incomplete program must never remain
        remaining = _remove_created(store, created)
        outcome = (
            f"delete by hand what remains: {', '.join(remaining)}" if remaining else "nothing of it remains"
        )
        if not created and isinstance(error, TandemError) and error.issues[0].code == "upload.controller":
            outcome = f"{folder} may exist, empty"  # the answer to its creation was lost
        if not isinstance(error, TandemError):
            error.add_note(f"upload of {folder}: {outcome}")
            raise
        issues = [dataclasses.replace(issue, message=f"{issue.message}; {outcome}") for issue in error.issues]
        raise TandemError(issues) from error
    return folder


def _require_same(name: str, sent: bytes, back: bytes | None) -> None:
    """Raise ``upload.write`` if the bytes of a file that were read back are not those that were sent."""
    if back == sent:
        return
    got = "nothing" if back is None else f"{len(back)} bytes"
    message = f"{name}: {got} read back, {len(sent)} bytes sent"
    if back is not None and len(back) == len(sent):
        position = next(k for k, (a, b) in enumerate(zip(sent, back, strict=True)) if a != b)
        message = f"{name}: byte {position} read back differs from the one sent"
    raise issue_error("upload.write", message)


def _remove_created(store: Store, created: Sequence[str]) -> list[str]:
    """Remove folders and files, the last one first; return the names of those that could not be removed."""
    remaining = []
    for name in reversed(created):
        try:
            is_removed = store.remove(name)
        except Exception:  # continue with the others
            is_removed = False
        if not is_removed:
            remaining.append(name)
    return remaining
