"""Reads configuration files of ABB controllers and the signals in RAPID text."""

import re
from typing import Final

from planner.languages.rapid.reader.lexer import RapidCursor
from planner.programs.text import STRING

InstanceRow = frozenset[tuple[str, str]]
"""Attributes of one instance: pairs of lower-case name and value; the value is "" if none is given."""
_IGNORED_ATTRIBUTES = ("label", "category")
"""Attributes that have no effect on the controller."""
_ATTRIBUTE = re.compile(r'-(\w+)(?:\s+("[^"]*"|[^\s"-][^\s"]*))?(?:\s+|$)')
"""An attribute with its value in a line of a configuration file."""
_SPELLINGS: Final = {
    name.lower(): name
    for name in (
        *("Name", "SignalType", "Device", "DeviceMap", "Access", "Rapid", "LocalManual", "LocalAuto"),
        *("Status", "Signal", "Action", "Routine", "Shelf", "Task", "File", "ModName", "AllTask"),
        *("Res", "Act1", "Oper1", "Act2", "Oper2", "Act3", "Oper3", "Act4", "Act1_invert"),
    )
}
"""Spelling of the attributes that a controller writes, by lower-case name.

Other spellings are refused, because it is not known whether the controller distinguishes case.
"""
_INSTANCE_KIND = re.compile(r"(\w+):")
"""The line that opens a list of instances of one type."""


class ConfigurationSyntaxError(Exception):
    """A file is not a valid configuration; the message says what is wrong."""


def parse_configuration(text: str) -> tuple[str, dict[str, list[InstanceRow]]]:
    """Return the first line of a configuration file, and its instances by type.

    Raises:
        ConfigurationSyntaxError: The file is not valid.
    """
    head, _, rest = text.replace("\r\n", "\n").partition("\n")
    rows_by_kind: dict[str, list[InstanceRow]] = {}
    kind: str | None = None
    if head != head.strip() or head.endswith("\\"):
        raise ConfigurationSyntaxError(f"{head[:40]!r} is no valid head")
    for line in re.sub(r"\\\n[ \t]*", " ", rest).split("\n"):
        row_text = line.strip()
        if not row_text:
            continue
        type_line = _INSTANCE_KIND.fullmatch(row_text)
        if row_text == "#":
            kind = None
        elif type_line is not None and kind is None:
            kind = type_line.group(1)
            if kind != kind.upper():
                raise ConfigurationSyntaxError(f"{kind} must be spelled {kind.upper()}")
            if kind in rows_by_kind:
                raise ConfigurationSyntaxError(f"{kind} occurs twice")
            rows_by_kind[kind] = []
        elif kind is not None:
            rows_by_kind[kind].append(_parse_row(row_text))
        else:
            raise ConfigurationSyntaxError(f"{row_text[:40]!r} belongs to no type")
    return head, rows_by_kind


def _parse_row(line: str) -> InstanceRow:
    """Parse the line of one instance, in which continuation lines are joined already.

    Attributes without effect on the controller are left out.

    Raises:
        ConfigurationSyntaxError: An attribute is malformed, spelled differently, or occurs twice.
    """
    values: dict[str, str] = {}
    offset = 0
    while offset < len(line):
        match = _ATTRIBUTE.match(line, offset)
        if match is None:
            raise ConfigurationSyntaxError(f"{line[offset : offset + 40]!r} is no attribute")
        spelled, value = match.group(1), (match.group(2) or "").strip('"')
        name = spelled.lower()
        if _SPELLINGS.get(name, spelled) != spelled:
            raise ConfigurationSyntaxError(f"-{spelled} must be spelled -{_SPELLINGS[name]}")
        if name in values:
            raise ConfigurationSyntaxError(f"-{name} occurs twice in one row")
        values[name] = value
        offset = match.end()
    return frozenset((name, value) for name, value in values.items() if name not in _IGNORED_ATTRIBUTES)


def cross_connection(row: InstanceRow) -> tuple[str, frozenset[str]] | None:
    """Return the result and the set of terms of a cross connection, or None.

    A cross connection sets a signal (the result) to a logical expression of other signals (the terms). The
    return value is None if an operator is not AND, the result is missing, or the row has other attributes.
    Signals are in lower case; an inverted term has the prefix "not ".
    """
    values = dict(row)
    values.pop("name", None)
    result = values.pop("res", "")
    terms: list[str] = []
    while f"act{len(terms) + 1}" in values:
        number = len(terms) + 1
        inverted = values.get(f"act{number}_invert") == ""
        if inverted:
            del values[f"act{number}_invert"]
        terms.append(f"{'not ' if inverted else ''}{values.pop(f'act{number}')}")
    operators = [values.pop(f"oper{number}", "") for number in range(1, len(terms))]
    if values or not result or any(operator.upper() != "AND" for operator in operators):
        return None
    return result.lower(), frozenset(term.lower() for term in terms)


def rapid_words(text: str) -> list[str]:
    """Return the tokens of RAPID text without comments: numbers by value, all but strings in lower case."""
    cursor = RapidCursor(text)
    out: list[str] = []
    while cursor.token.kind != "end":
        kind, word = cursor.token.kind, cursor.token.text
        out.append(word if kind == "string" else repr(float(word)) if kind == "number" else word.lower())
        cursor.take()
    return out


_SIGNAL_WORD = re.compile(
    r"(?i)\b(setdo|set|reset|invertdo|pulsedo|waitdo|doutput|testdo|waitdi|dinput|testdi)\b"
    r"\s*\(?\s*(?:\\\s*\w+\s*(?::=[^,;]*)?,?\s*)*([a-z]\w*)"
)
"""A RAPID instruction or function (group 1) and the digital signal that it names after options (group 2)."""
_INPUT_WORDS: Final = ("waitdi", "dinput", "testdi")
"""The words of ``_SIGNAL_WORD`` whose signal is an input."""


def rapid_signals(text: str) -> list[tuple[str, str]]:
    """Return the digital signals in RAPID text, each with "DI" or "DO" by its use, sorted by name.

    A name has the spelling of its first occurrence. Comments and strings are ignored.
    """
    code = re.sub(r"!.*", "", STRING.sub('""', text))
    spellings: dict[tuple[str, str], str] = {}
    for word, name in _SIGNAL_WORD.findall(code):
        kind = "DI" if word.lower() in _INPUT_WORDS else "DO"
        spellings.setdefault((name.lower(), kind), name)
    return [(name, kind) for (_, kind), name in sorted(spellings.items())]
