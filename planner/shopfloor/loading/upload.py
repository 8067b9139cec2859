"""A verified result onto a controller: compared, written into a new folder, read back, never started."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import PurePosixPath

from planner.issues import Issue, Severity, TandemError, refusal
from planner.programs import text
from planner.shopfloor.loading import compare, krc
from planner.shopfloor.loading.proven import Proven, chosen, folder_name
from planner.shopfloor.loading.rws import Rws
from planner.shopfloor.loading.store import Store

MOST_FOLDERS = 99
"""Folders of one result that are kept beside each other at most."""


@dataclasses.dataclass(frozen=True)
class Sent:
    """What is on the controller now: ``folder`` there and its ``files``; ``issues`` that were not looked at,
    or stand against loading it; what ``agreed``."""

    folder: str
    files: tuple[str, ...]
    issues: tuple[Issue, ...]
    agreed: tuple[str, ...] = ()

    @property
    def ready(self) -> bool:
        """Whether all was looked at and agreed: a file alone on a disk is not ready to be loaded."""
        return bool(self.agreed) and not self.issues


def to_controller(rws: Rws, proven: Proven, arm: str | None = None) -> Sent:
    """Send RAPID to a controller in automatic whose programs stand. Raises ``TandemError`` (``upload.*``);
    where the controller is not as planned nothing is written."""
    arms, files = chosen(proven, arm)
    if any(one.data.family == "KUKA" for one in arms):
        raise refusal("upload.address", "KRL goes to a folder or ftp://, not to Robot Web Services")
    _stands(rws)
    texts = {name: text.decode(content, name) for name, content in proven.files.items()}
    found = compare.compare(rws, proven.problem, texts, arms)
    if found.differs:
        raise TandemError((*found.differs, *found.not_looked_at))
    rws.hold()
    try:
        _stands(rws)
        folder = put(rws, folder_name(proven.problem), files)
    finally:
        released = rws.release()
    held = () if released else (_warning("mastership was not given back; let go of it at the pendant"),)
    return Sent(folder, tuple(sorted(files)), (*found.not_looked_at, *held), found.agreed)


def to_store(store: Store, proven: Proven, arm: str | None = None) -> Sent:
    """Send programs to a share or an FTP folder; of a KUKA controller behind it the files are compared that
    are there. Raises ``TandemError`` (``upload.*``); where they differ nothing is written."""
    arms, files = chosen(proven, arm)
    found = krc.compare(store, files, arms)
    if found.differs:
        raise TandemError((*found.differs, *found.not_looked_at))
    folder = put(store, folder_name(proven.problem), files)
    return Sent(folder, tuple(sorted(files)), found.not_looked_at, found.agreed)


def _warning(what: str) -> Issue:
    return Issue("upload.not_looked_at", what, Severity.WARNING)


def _stands(rws: Rws) -> None:
    """Raise unless the controller is in automatic and runs nothing; neither is ever changed from here."""
    mode, running = rws.mode, rws.execution
    if running != "stopped":
        what = f"RAPID execution is {running!r}, allowed is 'stopped'; nothing was written"
        raise refusal("upload.busy", what, hint="stop the program at the panel, then send again")
    if mode != "AUTO":
        what = f"the controller is in mode {mode}, allowed is AUTO; nothing was written"
        hint = "in manual whoever holds the pendant may change programs: close the gate, turn to AUTO"
        raise refusal("upload.busy", what, hint=hint)


def put(store: Store, name: str, files: Mapping[str, bytes]) -> str:
    """Write files into a new folder and read them back byte by byte; the folder's name. What is there is
    never written over: a name that is taken gets a number. What was begun is taken away where it fails,
    and named where that fails too. Raises ``TandemError``."""
    there = store.listing("")
    if there is None:
        raise refusal("upload.controller", "the home folder of the controller is not there")
    taken = {one.lower() for one in there}
    names = [name, *(f"{name}_{k}" for k in range(2, MOST_FOLDERS + 1))]
    folder = next((one for one in names if one.lower() not in taken), None)
    if folder is None:
        what = f"{MOST_FOLDERS} folders {name} are there; take old ones away at the controller"
        raise refusal("upload.write", what)
    made: list[str] = []
    try:
        store.make(folder)  # noted behind: what somebody else made meanwhile is not ours to take away
        made.append(folder)
        for inner in sorted({str(p) for n in files for p in PurePosixPath(n).parents if str(p) != "."}):
            store.make(f"{folder}/{inner}")
            made.append(f"{folder}/{inner}")
        for file, content in sorted(files.items()):
            made.append(f"{folder}/{file}")
            store.write(f"{folder}/{file}", content)
        for file, content in sorted(files.items()):
            _same(file, content, store.read(f"{folder}/{file}"))
    except BaseException as error:  # whatever it is, half a program must not stay
        left = _cleaned(store, made)
        after = f"left behind, take it away by hand: {', '.join(left)}" if left else "nothing of it was left"
        if not made and isinstance(error, TandemError) and error.issues[0].code == "upload.controller":
            after = f"{folder} may be there, empty"
        if not isinstance(error, TandemError):
            error.add_note(f"upload of {folder}: {after}")
            raise
        told = [dataclasses.replace(issue, message=f"{issue.message}; {after}") for issue in error.issues]
        raise TandemError(told) from error
    return folder


def _same(name: str, sent: bytes, back: bytes | None) -> None:
    if back == sent:
        return
    got = "nothing" if back is None else f"{len(back)} bytes"
    what = f"{name}: {got} came back, {len(sent)} bytes were sent"
    if back is not None and len(back) == len(sent):
        at = next(k for k, (a, b) in enumerate(zip(sent, back, strict=True)) if a != b)
        what = f"{name}: byte {at} came back otherwise than it was sent"
    raise refusal("upload.write", what)


def _cleaned(store: Store, made: Sequence[str]) -> list[str]:
    """What of ``made`` could not be taken away again."""
    left = []
    for name in reversed(made):
        try:
            gone = store.remove(name)
        except Exception:  # the others are still to be taken away
            gone = False
        left += [] if gone else [name]
    return left
