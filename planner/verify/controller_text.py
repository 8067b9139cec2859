"""Files for a controller, read: configuration of ABB as rows by type, modules of RAPID and lines of KRL as
words."""

from __future__ import annotations

import re

from planner.verify.rapid_lexer import Cursor

Row = frozenset[tuple[str, str]]
"""Attributes of an instance with their values, "" for one that has none; names in lower case."""

_SILENT = ("label", "category")
"""Attributes that change nothing."""
_WORD = re.compile(r'-(\w+)(?:\s+("[^"]*"|[^\s"-]\S*))?\s*')
_KIND = re.compile(r"(\w+):")


class UnreadError(Exception):
    """A file that is not what its name says; the message says where."""


def configuration(text: str) -> tuple[str, dict[str, list[Row]]]:
    """The head of a configuration file, and its rows by type. Raises :class:`UnreadError`."""
    head, _, rest = text.replace("\r\n", "\n").partition("\n")
    out: dict[str, list[Row]] = {}
    kind: str | None = None
    for line in re.sub(r"\\\n\s*", " ", rest).split("\n"):
        plain = line.strip()
        if not plain:
            continue
        found = _KIND.fullmatch(plain)
        if plain == "#":
            kind = None
        elif found is not None and kind is None:
            kind = found.group(1).upper()
            if kind in out:
                raise UnreadError(f"{kind} stands there twice")
            out[kind] = []
        elif kind is not None:
            out[kind].append(_row(plain))
        else:
            raise UnreadError(f"{plain[:40]!r} belongs to no type")
    return head.strip(), out


def _row(line: str) -> Row:
    values: dict[str, str] = {}
    place = 0
    while place < len(line):
        found = _WORD.match(line, place)
        if found is None:
            raise UnreadError(f"{line[place : place + 40]!r} is no attribute")
        name, value = found.group(1).lower(), (found.group(2) or "").strip('"')
        if name in values:
            raise UnreadError(f"-{name} stands there twice in one row")
        values[name] = value
        place = found.end()
    return frozenset((name, value) for name, value in values.items() if name not in _SILENT)


def crossed(row: Row) -> tuple[str, frozenset[str]] | None:
    """The result and the terms of a cross connection, all of them joined by AND, "not " before one that is
    turned over; None for any other."""
    values = dict(row)
    values.pop("name", None)
    result = values.pop("res", "")
    terms: list[str] = []
    while f"act{len(terms) + 1}" in values:
        number = len(terms) + 1
        turned = values.get(f"act{number}_invert") == ""
        if turned:
            del values[f"act{number}_invert"]
        terms.append(f"{'not ' if turned else ''}{values.pop(f'act{number}')}")
    joints = [values.pop(f"oper{number}", "") for number in range(1, len(terms))]
    if values or not result or any(joint.upper() != "AND" for joint in joints):
        return None
    return result.lower(), frozenset(term.lower() for term in terms)


def rapid_words(text: str) -> list[str]:
    """The words of RAPID text without comments, case only kept in strings, numbers by their values."""
    cursor, out = Cursor(text), []
    while cursor.token.kind != "end":
        kind, word = cursor.token.kind, cursor.token.text
        out.append(word if kind == "string" else repr(float(word)) if kind == "number" else word.lower())
        cursor.take()
    return out


def krl_lines(text: str) -> list[str]:
    """Statements of KRL text, without comments and folds, in capitals and without the spaces that count for
    nothing."""
    lines = (re.sub(r";.*", "", line) for line in text.replace("\r\n", "\n").split("\n"))
    tight = (re.sub(r"\s*([=(),\[\]])\s*", r"\1", " ".join(line.split())) for line in lines)
    return [line.upper() for line in tight if line]
