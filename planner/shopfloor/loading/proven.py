"""A result folder of which every program file is the one that its proof names.

`proof.json` names the SHA-256 of each program file. It says what was proven when the folder was written; that
nobody has changed file and digest together is what a signed statement is for (``tandem verify --signed-by``).
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import re
import unicodedata
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

from planner.files import RELEASE, STATEMENT, write_whole
from planner.issues import TandemError, refusal
from planner.problem import Arm, Problem
from planner.programs import text as program_text
from planner.programs.stages import CONTROLLER

if TYPE_CHECKING:
    from planner.proof.verdict import Proof

AGAIN = "prove again: tandem verify OUT"
"""What to do where a proof is missing or old: that writes it anew."""


@dataclasses.dataclass(frozen=True)
class Proven:
    """The ``files`` {name in ``programs/``: bytes} of a result whose proof holds, for its ``problem``."""

    problem: Problem
    files: Mapping[str, bytes]


def read(folder: Path, problem: Problem) -> Proven:
    """The program files of ``folder``, made for ``problem``.

    Raises ``TandemError`` (``upload.unproven``) where the verdict is not verified, the proof is of another
    problem or names no digests, or a file was changed, added or is missing.
    """
    path = folder / "proof.json"
    try:
        data: dict[str, Any] = json.loads(path.read_bytes())
        verified, stated, named = data["ok"], data["problem_digest"], dict(data.get("programs") or {})
    except (OSError, ValueError, KeyError, TypeError) as error:
        what = f"cannot be read as a proof ({type(error).__name__}: {error})"
        raise _refused(path, what, AGAIN) from error
    if verified is not True:
        raise _refused(path, "the verdict is not verified; only verified programs are sent", AGAIN)
    if stated != problem.digest:
        what = f"the proof is of problem {stated}, the folder holds {problem.digest}"
        raise _refused(path, what, AGAIN)
    if not named:
        raise _refused(path, "the proof names no digests of programs: an older Tandem wrote it", AGAIN)
    root = folder / "programs"
    found = {p.relative_to(root).as_posix(): p.read_bytes() for p in sorted(root.rglob("*")) if p.is_file()}
    found.pop(RELEASE, None)  # as it lies beside the programs in an archive of a service
    faults = []
    for name in sorted({*found, *named}):
        if name not in named:
            faults.append(f"{name} is not named by the proof")
        elif name not in found:
            faults.append(f"{name} is missing")
        elif (got := hashlib.sha256(found[name]).hexdigest()) != named[name]:
            faults.append(f"{name} has digest {got[:16]}, the proof names {str(named[name])[:16]}")
    if faults:
        raise _refused(root, "; ".join(faults), "plan again; or prove what is there: tandem verify OUT")
    return Proven(problem, found)


def released(folder: Path, proven: Proven, asked: bool = False) -> str | None:
    """Who released these programs, as the service says in ``release.json`` that their result came from; None
    where nothing says so.

    It is as good as the folder: nobody has signed it. Raises ``TandemError`` (``upload.release``) where the
    release was withdrawn or is of other programs, and where there is none that was ``asked`` for.
    """
    paths = (folder / RELEASE, folder / "programs" / RELEASE)
    path = next((one for one in paths if one.is_file()), paths[0])
    way = "release the job at the service, and download it again"
    if not path.is_file():
        if asked:
            raise _not_released(path, "there is none, so nobody is known to have released this", way)
        return None
    try:
        data: dict[str, Any] = json.loads(path.read_bytes())
        told, is_released, last = str(data["says"]), data["released"], data["release"]
        says = "".join(one for one in told if unicodedata.category(one) != "Cc")  # it goes to a terminal
        stated, named = data["digest"], dict(data["programs"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        what = f"cannot be read as a release ({type(error).__name__}: {error})"
        raise _not_released(path, what, way) from error
    own = {name: hashlib.sha256(content).hexdigest() for name, content in proven.files.items()}
    if stated != proven.problem.digest or named != own:
        raise _not_released(path, f"it says {says!r} of other programs than those here", way)
    if is_released is True:
        return says
    if last is not None or asked:
        raise _not_released(path, f"it says: {says}", way)
    return None


def record(folder: Path, programs: Mapping[str, str], proof: Proof, again: bool = False) -> bool:
    """Write ``proof.json`` of a result folder anew, of the ``proof`` of its ``programs``, with the SHA-256 of
    their files; what the plan has accepted stays.

    False, and nothing is written, where that would change what is signed, unless it is signed ``again``.
    Raises ``TandemError`` (``upload.unproven``) where the files are others by now, and ``OSError``.
    """
    from planner.report import output

    path, root = folder / "proof.json", folder / "programs"
    digests = {}
    for name, text in programs.items():
        content = (root / name).read_bytes()
        if program_text.decode(content, name) != text:
            raise _refused(root / name, f"{name} was changed while it was proven", AGAIN)
        digests[name] = hashlib.sha256(content).hexdigest()
    old = path.read_text(encoding="utf-8") if path.is_file() else ""
    new = output.proof_text(proof, output.accepted_of(old), digests)
    if new != old and (folder / STATEMENT).is_file() and not again:
        return False
    if new != old:
        write_whole(path, new)
    return True


def chosen(proven: Proven, arm: str | None) -> tuple[tuple[Arm, ...], dict[str, bytes]]:
    """The arms whose programs go to one controller, and their files by name; ``arm`` says which where each
    has a controller of its own. Raises ``TandemError`` (``upload.address``)."""
    cell = proven.problem.cell
    names = [one.name for one in cell.arms]
    if any(one.data.family == "ROS" for one in cell.arms):
        what = "trajectories are not sent by this; the runner (integrations/ros2) goes through their file"
        raise refusal("upload.address", what, arm=arm)
    if any(one.data.family == "UR" for one in cell.arms if arm in (None, one.name)):
        what = "programs of UR arms are not sent by this; load them by a share or USB stick"
        raise refusal("upload.address", what, arm=arm)
    if arm is not None and arm not in names:
        what = f"--arm: got {arm}, the cell has {', '.join(names)}"
        raise refusal("upload.address", what, field="arm")
    apart = len(names) > 1 and (
        cell.controller.sync == "handshake" or any(a.data.family == "KUKA" for a in cell.arms)
    )
    if not apart:
        if arm is not None and len(names) > 1:
            what = f"--arm: got {arm}, but one controller moves {' and '.join(names)}; leave --arm out"
            raise refusal("upload.address", what, field="arm")
        return cell.arms, dict(proven.files)
    if arm is None:
        what = f"each arm has a controller of its own; say by --arm which is meant: {', '.join(names)}"
        raise refusal("upload.address", what, field="arm")
    files = {name: content for name, content in proven.files.items() if _of(name, arm)}
    return (cell.arm(arm),), files


def _of(name: str, arm: str) -> bool:
    parts = [part.lower() for part in PurePosixPath(name).parts[:-1]]
    return parts[:1] == [arm.lower()] or parts[:2] == [CONTROLLER, arm.lower()]


def folder_name(problem: Problem) -> str:
    """The name of the folder for a problem's programs on a controller; the digest tells problems apart."""
    plain = re.sub(r"[^A-Za-z0-9]+", "_", problem.name).strip("_")[:24]
    return f"tandem_{plain}_{(problem.digest or '')[:8]}"


def _not_released(path: Path, what: str, hint: str) -> TandemError:
    return refusal("upload.release", what, file=str(path), hint=hint)


def _refused(path: Path, what: str, hint: str) -> TandemError:
    return refusal("upload.unproven", what, file=str(path), hint=hint)
