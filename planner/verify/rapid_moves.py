"""Move instructions of the usual form, read in one step for speed.

A job has thousands of moves that differ in their numbers only. Whatever does not match the pattern exactly
goes the ordinary way (`rapid_instructions`), which gives the same result and explains faults.
"""

from __future__ import annotations

import re

from planner.verify.rapid_ast import Expr, Literal, Move, Name
from planner.verify.rapid_expressions import number_list
from planner.verify.rapid_lexer import Cursor
from planner.verify.rapid_values import RapidValueError, build
from planner.verify.rapid_words import RESERVED
from planner.verify.values import LARGEST

_HEAD = re.compile(r"(?:Move(?P<linear>[LJ])|MoveAbsJ)[ \t]+(?P<name>[A-Za-z]\w*)?", re.IGNORECASE | re.ASCII)
# possessive, as three runs of blanks in a row would be tried against each other
_TAIL = re.compile(
    r"""[ \t]*+(?:\\ID:=(?P<id>\d{1,9}))?[ \t]*+(?P<still>\\NoEOffs)?[ \t]*+,[ \t]*+
    (?P<speed>[A-Za-z]\w*|\[[^\[\]]*\])(?:[ \t]*+\\T:=(?P<time>\d+(?:\.\d+)?))?[ \t]*+,[ \t]*+
    (?P<zone>[A-Za-z]\w*)[ \t]*+,[ \t]*+(?P<tool>[A-Za-z]\w*)
    (?:[ \t]*+\\WObj:=(?P<wobj>[A-Za-z]\w*))?[ \t]*+;""",
    re.IGNORECASE | re.ASCII | re.VERBOSE,
)


def quick_move(cursor: Cursor, line: int) -> Move | None:
    """The move at the cursor, or None when it is not of the usual form; then the cursor has not moved."""
    text, first = cursor.text, cursor.token.start
    head = _HEAD.match(text, first)
    if head is None:
        return None
    kind = "MoveAbsJ" if head["linear"] is None else "Move" + head["linear"].upper()
    try:
        end = head.end()
        if head["name"]:
            target: Expr | None = _name(head["name"], head.start("name"))
        else:
            found = number_list(text, end)
            if found is None:
                return None
            record = "jointtarget" if kind == "MoveAbsJ" else "robtarget"
            target, end = Literal(end, record, build(record, found[0])), found[1]
        tail = _TAIL.match(text, end)
        if tail is None or target is None or (tail["still"] and kind != "MoveAbsJ"):
            return None
        zone = _name(tail["zone"], tail.start("zone"))
        tool = _name(tail["tool"], tail.start("tool"))
        wobj = _name(tail["wobj"], tail.start("wobj")) if tail["wobj"] else None
        speed = _speed(text, tail)
        if zone is None or tool is None or speed is None or (tail["wobj"] and wobj is None):
            return None
    except RapidValueError:
        return None
    if tail["time"] and float(tail["time"]) >= LARGEST:
        return None
    ident = Literal(tail.start("id"), "num", float(tail["id"])) if tail["id"] else None
    time = Literal(tail.start("time"), "num", float(tail["time"])) if tail["time"] else None
    switches = ("noeoffs",) if tail["still"] else ()
    cursor.jump(tail.end())
    return Move(line, first, kind, target, speed, zone, tool, ident, time, None, wobj, switches)


def _name(text: str, start: int) -> Name | None:
    return None if text.lower() in RESERVED else Name(start, text)


def _speed(text: str, tail: re.Match[str]) -> Expr | None:
    start = tail.start("speed")
    if text[start] != "[":
        return _name(tail["speed"], start)
    found = number_list(text, start)
    if found is None or found[1] != tail.end("speed"):
        return None
    return Literal(start, "speeddata", build("speeddata", found[0]))
