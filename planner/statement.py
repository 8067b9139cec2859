"""Statements that can be signed: which files a result folder holds, for which problem, and what was proven.

``statement.json`` names every file of a result by its SHA-256, ``statement.json.sig`` signs it. A signature
says who stands for the result; that the programs are safe is proven from their text each time.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from planner import sshsig
from planner.files import RESULT, SIGNATURE, STATEMENT, write_whole
from planner.issues import Issue, Severity, TandemError
from planner.versions import versions

if TYPE_CHECKING:
    from planner.problem import Problem
    from planner.verify.result import Proof

FORMAT: Final = "tandem-statement"
SCHEMA: Final = 1
SHOWN: Final = 5


def sign(folder: Path, problem: Problem, stored: str | None, proof: Proof, key: sshsig.PrivateKey) -> str:
    """Write statement and signature of a result folder; the fingerprint of the key. Only what is proven for
    the problem that the folder carries, whose digest is ``stored``, is signed: raises ``TandemError`` with
    ``sign.unproven``."""
    if not proof.ok or stored != problem.digest:
        why = "the programs are not proven" if not proof.ok else "its copy of the problem is another one"
        what = f"{folder} is not signed, for {why}"
        raise TandemError(Issue("sign.unproven", what, file=str(folder), hint="plan the problem again"))
    content = text(folder, problem, proof)
    write_whole(folder / STATEMENT, content)
    write_whole(folder / SIGNATURE, sshsig.sign(content, key))
    return key.public.fingerprint


def text(folder: Path, problem: Problem, proof: Proof) -> bytes:
    """The statement on a folder, as it is signed."""
    data = {
        "format": FORMAT,
        "schema": SCHEMA,
        "problem": {"name": problem.name, "digest": problem.digest},
        "proven": proof.ok,
        "rules": {rule.code: "holds" if rule.passed else "broken" for rule in proof.rules},
        "files": digests(folder),
        "versions": versions(),
    }
    return (json.dumps(data, indent=1, ensure_ascii=False) + "\n").encode()


def digests(folder: Path) -> dict[str, str]:
    """SHA-256 of each file of a result by its name in the folder, statement and signature left out."""
    out = {}
    for name in RESULT:
        top = folder / name
        inside = sorted(path for path in top.rglob("*") if path.is_file()) if top.is_dir() else [top]
        for path in inside:
            if name not in (STATEMENT, SIGNATURE) and path.is_file():
                digest = hashlib.sha256(path.read_bytes()).hexdigest()
                out[path.relative_to(folder).as_posix()] = digest
    return out


def check(folder: Path, problem: Problem, signers: Path) -> tuple[Issue, ...]:
    """What is wrong with the signature of a result, by the keys in the file ``signers``; else a note
    (``sign.good``) that says who signed. Raises ``TandemError`` for keys that cannot be read."""
    known = sshsig.public_keys(signers)
    try:
        content, armoured = (folder / STATEMENT).read_bytes(), (folder / SIGNATURE).read_text("ascii")
    except (OSError, UnicodeDecodeError) as error:
        what = f"{folder} is not signed: {STATEMENT} and {SIGNATURE} cannot be read ({error})"
        return (_issue("sign.missing", what, folder / SIGNATURE),)
    try:
        by = sshsig.signer(content, armoured, known)
    except ValueError as error:
        return (_issue("sign.signature", f"the signature of {STATEMENT} does not hold: {error}", folder),)
    faults = _faults(folder, problem, content)
    if faults:
        more = f" and {len(faults) - SHOWN} more" if len(faults) > SHOWN else ""
        what = f"the folder is not what was signed: {'; '.join(faults[:SHOWN])}{more}"
        return (_issue("sign.content", what, folder / STATEMENT),)
    who = f" ({by.who})" if by.who else ""
    what = f"signed by {by.fingerprint}{who}: all files are as signed, for problem {problem.digest}"
    return (Issue("sign.good", what, Severity.NOTE, file=str(folder / SIGNATURE)),)


def _faults(folder: Path, problem: Problem, content: bytes) -> list[str]:
    """In what a folder and a problem differ from a signed statement."""
    try:
        data: dict[str, Any] = json.loads(content)
        if (data["format"], data["schema"]) != (FORMAT, SCHEMA):
            return [f"it is a statement of another format ({data['format']} {data['schema']})"]
        signed, stated, proven = dict(data["files"]), data["problem"]["digest"], data["proven"]
    except (ValueError, KeyError, TypeError) as error:
        return [f"the statement cannot be read ({type(error).__name__}: {error})"]
    out = [] if proven is True else ["the statement does not say that the programs are proven"]
    if stated != problem.digest:
        out.append(f"it was signed for problem {stated}, not {problem.digest}")
    found = digests(folder)
    for name in sorted({*found, *signed}):
        if name not in signed:
            out.append(f"{name} was added")
        elif name not in found:
            out.append(f"{name} is missing")
        elif found[name] != signed[name]:
            out.append(f"{name} was changed")
    return out


def _issue(code: str, what: str, path: Path) -> Issue:
    hint = "do not run the programs before you know why; ask whoever made them, or plan the problem yourself"
    return Issue(code, what, file=str(path), hint=hint)
