"""Configuration files of ABB controllers."""

import re
from typing import Final

from planner.languages.rapid.reader.lexer import Cursor
from planner.programs.text import STRING

Row = frozenset[tuple[str, str]]
"""Attributes of an instance with their values, "" for one that has none; names in lower case."""
_SILENT_ATTRIBUTES = ("label", "category")
"""Attributes that change nothing."""
_ATTRIBUTE = re.compile(r'-(\w+)(?:\s+("[^"]*"|[^\s"-][^\s"]*))?(?:\s+|$)')
"""An attribute of a line of a configuration file."""
_SPELLINGS: Final = {
    name.lower(): name
    for name in (
        *("Name", "SignalType", "Device", "DeviceMap", "Access", "Rapid", "LocalManual", "LocalAuto"),
        *("Status", "Signal", "Action", "Routine", "Shelf", "Task", "File", "ModName", "AllTask"),
        *("Res", "Act1", "Oper1", "Act2", "Oper2", "Act3", "Oper3", "Act4", "Act1_invert"),
    )
}
"""Attributes as a controller writes them: whether it minds their case is not known."""
_INSTANCE_KIND = re.compile(r"(\w+):")
"""The kind of what such a file lists."""


class UnreadError(Exception):
    """A file that is not what its name says; the message says where."""


def configuration(text: str) -> tuple[str, dict[str, list[Row]]]:
    """The head of a configuration file, and its rows by type. Raises :class:`UnreadError`."""
    head, _, rest = text.replace("\r\n", "\n").partition("\n")
    out: dict[str, list[Row]] = {}
    kind: str | None = None
    if head != head.strip() or head.endswith("\\"):
        raise UnreadError(f"{head[:40]!r} is no head")
    for line in re.sub(r"\\\n[ \t]*", " ", rest).split("\n"):
        plain = line.strip()
        if not plain:
            continue
        found = _INSTANCE_KIND.fullmatch(plain)
        if plain == "#":
            kind = None
        elif found is not None and kind is None:
            kind = found.group(1)
            if kind != kind.upper():
                raise UnreadError(f"{kind} is to be spelled {kind.upper()}")
            if kind in out:
                raise UnreadError(f"{kind} stands there twice")
            out[kind] = []
        elif kind is not None:
            out[kind].append(_row(plain))
        else:
            raise UnreadError(f"{plain[:40]!r} belongs to no type")
    return head, out


def _row(line: str) -> Row:
    values: dict[str, str] = {}
    place = 0
    while place < len(line):
        found = _ATTRIBUTE.match(line, place)
        if found is None:
            raise UnreadError(f"{line[place : place + 40]!r} is no attribute")
        spelled, value = found.group(1), (found.group(2) or "").strip('"')
        name = spelled.lower()
        if _SPELLINGS.get(name, spelled) != spelled:
            raise UnreadError(f"-{spelled} is to be spelled -{_SPELLINGS[name]}")
        if name in values:
            raise UnreadError(f"-{name} stands there twice in one row")
        values[name] = value
        place = found.end()
    return frozenset((name, value) for name, value in values.items() if name not in _SILENT_ATTRIBUTES)


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


_SIGNAL_WORD = re.compile(
    r"(?i)\b(setdo|set|reset|invertdo|pulsedo|waitdo|doutput|testdo|waitdi|dinput|testdi)\b"
    r"\s*\(?\s*(?:\\\s*\w+\s*(?::=[^,;]*)?,?\s*)*([a-z]\w*)"
)
"""Instructions and functions of RAPID that name a digital signal, options before it left out."""
_INPUT_WORDS: Final = ("waitdi", "dinput", "testdi")
"""Those whose signal is an input."""


def rapid_signals(text: str) -> list[tuple[str, str]]:
    """The digital signals that RAPID text names, as it spells them first, with "DI" or "DO" by what is done
    with each; in comments and strings there are none. Sorted by name."""
    bare = re.sub(r"!.*", "", STRING.sub('""', text))
    found: dict[tuple[str, str], str] = {}
    for word, name in _SIGNAL_WORD.findall(bare):
        kind = "DI" if word.lower() in _INPUT_WORDS else "DO"
        found.setdefault((name.lower(), kind), name)
    return [(name, kind) for (_, kind), name in sorted(found.items())]
