"""Result folders whose program files are exactly those that their proof names.

`proof.json` names the SHA-256 of each program file. It states what was proven when the folder was written.
That nobody has changed file and digest together is what a signed statement is for (``tandem verify
--signed-by``).
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

from planner.files import RELEASE, STATEMENT, write_atomic
from planner.issues import TandemError, issue_error
from planner.problem import Arm, Problem
from planner.programs import text as program_text
from planner.programs.stages import CONTROLLER_FOLDER

if TYPE_CHECKING:
    from planner.proof.verdict import Proof

AGAIN = "prove again: tandem verify OUT"
"""Remedy for a missing or old proof, which it rewrites."""


@dataclasses.dataclass(frozen=True)
class Proven:
    """The ``files`` {name in ``programs/``: bytes} of a result whose proof holds, and its ``problem``."""

    problem: Problem
    files: Mapping[str, bytes]


def read(folder: Path, problem: Problem) -> Proven:
    """Read the program files of ``folder``, made for ``problem``.

    Raises:
        TandemError: ``upload.unproven`` if the verdict is not verified, the proof is of another problem or
            names no digests, or a file was changed, added or is missing.
    """
    path = folder / "proof.json"
    try:
        data: dict[str, Any] = json.loads(path.read_bytes())
        verified, stated, named = data["ok"], data["problem_digest"], dict(data.get("programs") or {})
    except (OSError, ValueError, KeyError, TypeError) as error:
        what = f"cannot be read as a proof ({type(error).__name__}: {error})"
        raise _refused(path, what, AGAIN) from error
    if verified is not True:
        raise _refused(path, "the verdict is not 'verified'; only verified programs are sent", AGAIN)
    if stated != problem.digest:
        what = f"the proof is of problem {stated}, the folder holds {problem.digest}"
        raise _refused(path, what, AGAIN)
    if not named:
        raise _refused(path, "the proof has no digests of programs: an older Tandem wrote it", AGAIN)
    root = folder / "programs"
    files = {p.relative_to(root).as_posix(): p.read_bytes() for p in sorted(root.rglob("*")) if p.is_file()}
    files.pop(RELEASE, None)  # archives of a service contain it beside the programs
    faults = []
    for name in sorted({*files, *named}):
        if name not in named:
            faults.append(f"{name} is not in the proof")
        elif name not in files:
            faults.append(f"{name} is missing")
        elif (got := hashlib.sha256(files[name]).hexdigest()) != named[name]:
            faults.append(f"{name} has digest {got[:16]}, the proof has {str(named[name])[:16]}")
    if faults:
        raise _refused(root, "; ".join(faults), "plan again, or prove these programs: tandem verify OUT")
    return Proven(problem, files)


def released(folder: Path, proven: Proven, required: bool = False) -> str | None:
    """Who released these programs, according to the ``release.json`` of the service; None if nothing says so.

    The statement is only as trustworthy as the folder, because it is not signed.

    Args:
        folder: Result folder.
        proven: Its program files.
        required: Whether a release is required.

    Raises:
        TandemError: ``upload.release`` if the release was withdrawn, is of other programs, or is required and
            missing.
    """
    paths = (folder / RELEASE, folder / "programs" / RELEASE)
    path = next((one for one in paths if one.is_file()), paths[0])
    way = "release the job in the service, and download it again"
    if not path.is_file():
        if required:
            raise _not_released(path, "there is no release file, so no release is known", way)
        return None
    try:
        data: dict[str, Any] = json.loads(path.read_bytes())
        text, is_released, last = str(data["says"]), data["released"], data["release"]
        # without control characters, because it is printed to a terminal
        says = "".join(one for one in text if unicodedata.category(one) != "Cc")
        stated, named = data["digest"], dict(data["programs"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        what = f"cannot be read as a release ({type(error).__name__}: {error})"
        raise _not_released(path, what, way) from error
    own = {name: hashlib.sha256(content).hexdigest() for name, content in proven.files.items()}
    if stated != proven.problem.digest or named != own:
        raise _not_released(path, f"it says {says!r}, but about other programs", way)
    if is_released is True:
        return says
    if last is not None or required:
        raise _not_released(path, f"it says: {says}", way)
    return None


def record(folder: Path, programs: Mapping[str, str], proof: Proof, again: bool = False) -> bool:
    """Rewrite ``proof.json`` of a result folder. What the plan has accepted stays.

    Args:
        folder: Result folder.
        programs: {name: text} that were proven.
        proof: Their proof.
        again: Whether the result will be signed again.

    Returns:
        False, without writing, if that would change signed content, unless it is signed ``again``.

    Raises:
        TandemError: ``upload.unproven`` if the files have changed since.
        OSError: The file cannot be written.
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
    new = output.proof_json(proof, output.read_accepted(old), digests)
    if new != old and (folder / STATEMENT).is_file() and not again:
        return False
    if new != old:
        write_atomic(path, new)
    return True


def select_programs(proven: Proven, arm: str | None) -> tuple[tuple[Arm, ...], dict[str, bytes]]:
    """Arms whose programs go to one controller, and their files by name.

    Args:
        proven: Program files.
        arm: The arm, if each has its own controller.

    Raises:
        TandemError: ``upload.address``.
    """
    cell = proven.problem.cell
    names = [one.name for one in cell.arms]
    if any(one.data.family == "ROS" for one in cell.arms):
        what = "trajectories cannot be uploaded; the runner (integrations/ros2) executes their file"
        raise issue_error("upload.address", what, arm=arm)
    if any(one.data.family == "UR" for one in cell.arms if arm in (None, one.name)):
        what = "programs of UR arms cannot be uploaded; load them from a network share or USB stick"
        raise issue_error("upload.address", what, arm=arm)
    if arm is not None and arm not in names:
        what = f"--arm: got {arm}, the cell has {', '.join(names)}"
        raise issue_error("upload.address", what, field="arm")
    has_separate_controllers = len(names) > 1 and (
        cell.controller.sync == "handshake" or any(a.data.family == "KUKA" for a in cell.arms)
    )
    if not has_separate_controllers:
        if arm is not None and len(names) > 1:
            what = f"--arm: got {arm}, but one controller moves {' and '.join(names)}; leave --arm out"
            raise issue_error("upload.address", what, field="arm")
        return cell.arms, dict(proven.files)
    if arm is None:
        what = f"each arm has its own controller; name the arm with --arm: {', '.join(names)}"
        raise issue_error("upload.address", what, field="arm")
    files = {name: content for name, content in proven.files.items() if _of(name, arm)}
    return (cell.arm(arm),), files


def _of(name: str, arm: str) -> bool:
    parts = [part.lower() for part in PurePosixPath(name).parts[:-1]]
    return parts[:1] == [arm.lower()] or parts[:2] == [CONTROLLER_FOLDER, arm.lower()]


def folder_name(problem: Problem) -> str:
    """Folder name for a problem's programs on a controller. The digest distinguishes problems."""
    plain = re.sub(r"[^A-Za-z0-9]+", "_", problem.name).strip("_")[:24]
    return f"tandem_{plain}_{(problem.digest or '')[:8]}"


def _not_released(path: Path, what: str, hint: str) -> TandemError:
    return issue_error("upload.release", what, file=str(path), hint=hint)


def _refused(path: Path, what: str, hint: str) -> TandemError:
    return issue_error("upload.unproven", what, file=str(path), hint=hint)
