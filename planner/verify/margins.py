"""The margins of a proof as short text for a program's header, and the check that a header changed nothing
else.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import PurePosixPath

from planner.verify.krl_parser import without_comments
from planner.verify.rapid_lexer import Cursor
from planner.verify.result import Proof

SHOWN: dict[str, str] = {
    "verify.clearance": "clearance",
    "verify.joint_limits": "joint limits",
    "verify.joint_speed": "joint speed",
    "verify.singularity": "singularity",
    "verify.surface": "cut surface",
}


def text(proof: Proof) -> dict[str, str]:
    """Results of the rules that a person at the robot asks for: {name: "worst (limit)"}."""
    out = {}
    for code, name in SHOWN.items():
        rule = next((r for r in proof.rules if r.code == code), None)
        if rule is not None and rule.worst is not None:
            limit = "" if rule.limit is None else f", allowed {rule.limit:.4g} {rule.unit}"
            out[name] = f"{rule.worst:.4g} {rule.unit}{limit}"
    return out


def same_program(first: Mapping[str, str], second: Mapping[str, str]) -> bool:
    """Whether two sets of programs differ in comments and white space at most, file by file."""
    return first.keys() == second.keys() and all(_same(name, first[name], second[name]) for name in first)


def _same(name: str, first: str, second: str) -> bool:
    if PurePosixPath(name).suffix.lower() in (".src", ".dat"):
        return without_comments(first) == without_comments(second)
    return _lines(first) == _lines(second) or _words(first) == _words(second)


def _lines(content: str) -> list[str]:
    """The lines that hold more than a comment: no string, the only other place for a !, goes over a line's
    end."""
    lines = (line.strip(" \t\r") for line in content.split("\n"))
    return [line for line in lines if line and not line.startswith("!")]


def _words(content: str) -> list[str]:
    cursor, out = Cursor(content), []
    while cursor.token.kind not in ("end", "bad"):
        out.append(cursor.token.word or cursor.token.text)
        cursor.take()
    return [*out, cursor.token.kind]
