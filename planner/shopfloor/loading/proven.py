"""Result folders whose program files are exactly those that their proof names.

`proof.json` has the SHA-256 of each program file that was proven. It does not detect that somebody changed a
file and its digest together; a signed statement does (``tandem verify --signed-by``).
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
"""Remedy for a missing or old proof: the command rewrites it."""


@dataclasses.dataclass(frozen=True)
class Proven:
    """Program files of a result that are those of its proof.

    Attributes:
        problem: Problem of the result.
        files: Contents by name in ``programs/``.
    """

    problem: Problem
    files: Mapping[str, bytes]


def read(folder: Path, problem: Problem) -> Proven:
    """Read the program files of a result folder for ``problem``, and compare them with its proof.

    Raises:
        TandemError: ``upload.unproven`` if the verdict is not verified, the proof is of another problem or
            has no digests, or a file was changed, added or removed.
    """
    path = folder / "proof.json"
    try:
        data: dict[str, Any] = json.loads(path.read_bytes())
        verified = data["ok"]
        proven_digest = data["problem_digest"]
        digests = dict(data.get("programs") or {})
    except (OSError, ValueError, KeyError, TypeError) as error:
        message = f"cannot be read as a proof ({type(error).__name__}: {error})"
        raise _refused(path, message, AGAIN) from error
    if verified is not True:
        raise _refused(path, "the verdict is not 'verified'; only verified programs are sent", AGAIN)
    if proven_digest != problem.digest:
        message = f"the proof is of problem {proven_digest}, the folder holds {problem.digest}"
        raise _refused(path, message, AGAIN)
    if not digests:
        raise _refused(path, "the proof has no digests of programs: an older Tandem wrote it", AGAIN)
    root = folder / "programs"
    files = {p.relative_to(root).as_posix(): p.read_bytes() for p in sorted(root.rglob("*")) if p.is_file()}
    files.pop(RELEASE, None)  # archives of a service contain it beside the programs
    faults = []
    for name in sorted({*files, *digests}):
        if name not in digests:
            faults.append(f"{name} is not in the proof")
        elif name not in files:
            faults.append(f"{name} is missing")
        elif (got := hashlib.sha256(files[name]).hexdigest()) != digests[name]:
            faults.append(f"{name} has digest {got[:16]}, the proof has {str(digests[name])[:16]}")
    if faults:
        raise _refused(root, "; ".join(faults), "plan again, or prove these programs: tandem verify OUT")
    return Proven(problem, files)


def released(folder: Path, proven: Proven, required: bool = False) -> str | None:
    """Return the statement of the service's ``release.json`` that these programs are released, or None.

    It is only as trustworthy as the folder, because it is not signed.

    Args:
        folder: Result folder.
        proven: Its program files.
        required: Whether a release is required.

    Raises:
        TandemError: ``upload.release`` if the release was withdrawn, is of other programs, or is required and
            missing.
    """
    paths = (folder / RELEASE, folder / "programs" / RELEASE)
    path = next((candidate for candidate in paths if candidate.is_file()), paths[0])
    remedy = "release the job in the service, and download it again"
    if not path.is_file():
        if required:
            raise _not_released(path, "there is no release file, so no release is known", remedy)
        return None
    try:
        data: dict[str, Any] = json.loads(path.read_bytes())
        text = str(data["says"])
        is_released = data["released"]
        last_release = data["release"]
        # without control characters, because it is printed to a terminal
        statement = "".join(letter for letter in text if unicodedata.category(letter) != "Cc")
        released_digest = data["digest"]
        released_programs = dict(data["programs"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        message = f"cannot be read as a release ({type(error).__name__}: {error})"
        raise _not_released(path, message, remedy) from error
    own = {name: hashlib.sha256(content).hexdigest() for name, content in proven.files.items()}
    if released_digest != proven.problem.digest or released_programs != own:
        raise _not_released(path, f"it says {statement!r}, but about other programs", remedy)
    if is_released is True:
        return statement
    if last_release is not None or required:  # withdrawn, or never released
        raise _not_released(path, f"it says: {statement}", remedy)
    return None


def record(folder: Path, programs: Mapping[str, str], proof: Proof, again: bool = False) -> bool:
    """Rewrite ``proof.json`` of a result folder after its programs were proven again.

    The issues that the plan accepted are kept.

    Args:
        folder: Result folder.
        programs: Texts of the proven programs by name.
        proof: Their proof.
        again: Whether the result will be signed again.

    Returns:
        False if nothing was written because that would change signed content; else True.

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
    """Return the arms of one controller, and the contents of their program files by name.

    Args:
        proven: Program files.
        arm: Name of the arm if each has a controller of its own; else None.

    Raises:
        TandemError: ``upload.address`` if programs of this family cannot be uploaded, or the arm is unknown,
            missing, or stated although one controller moves all arms.
    """
    cell = proven.problem.cell
    names = [item.name for item in cell.arms]
    if any(item.data.family == "ROS" for item in cell.arms):
        message = "trajectories cannot be uploaded; the runner (integrations/ros2) executes their file"
        raise issue_error("upload.address", message, arm=arm)
    if any(item.data.family == "UR" for item in cell.arms if arm in (None, item.name)):
        message = "programs of UR arms cannot be uploaded; load them from a network share or USB stick"
        raise issue_error("upload.address", message, arm=arm)
    if arm is not None and arm not in names:
        message = f"--arm: got {arm}, the cell has {', '.join(names)}"
        raise issue_error("upload.address", message, field="arm")
    has_separate_controllers = len(names) > 1 and (
        cell.controller.sync == "handshake" or any(item.data.family == "KUKA" for item in cell.arms)
    )
    if not has_separate_controllers:
        if arm is not None and len(names) > 1:
            message = f"--arm: got {arm}, but one controller moves {' and '.join(names)}; leave --arm out"
            raise issue_error("upload.address", message, field="arm")
        return cell.arms, dict(proven.files)
    if arm is None:
        message = f"each arm has its own controller; name the arm with --arm: {', '.join(names)}"
        raise issue_error("upload.address", message, field="arm")
    files = {name: content for name, content in proven.files.items() if _belongs_to(name, arm)}
    return (cell.arm(arm),), files


def _belongs_to(name: str, arm: str) -> bool:
    """Whether a program file is in the folder of an arm, or in that of its controller."""
    parts = [part.lower() for part in PurePosixPath(name).parts[:-1]]
    return parts[:1] == [arm.lower()] or parts[:2] == [CONTROLLER_FOLDER, arm.lower()]


def folder_name(problem: Problem) -> str:
    """Return the folder name for a problem's programs; part of its digest distinguishes equal names."""
    short_name = re.sub(r"[^A-Za-z0-9]+", "_", problem.name).strip("_")[:24]
    return f"tandem_{short_name}_{(problem.digest or '')[:8]}"


def _not_released(path: Path, message: str, hint: str) -> TandemError:
    return issue_error("upload.release", message, file=str(path), hint=hint)


def _refused(path: Path, message: str, hint: str) -> TandemError:
    return issue_error("upload.unproven", message, file=str(path), hint=hint)
