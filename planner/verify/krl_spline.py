"""Spline blocks of KRL as the proof reads them: points, and the times that the block states.

    SPLINE
    TIME_BLOCK START
    SPL {X ..,Y ..,Z ..,A ..,B ..,C ..}
    TIME_BLOCK PART = 12.5
    ...
    TIME_BLOCK END = 3.2
    ENDSPLINE

Between SPLINE and ENDSPLINE nothing else may stand but comments: KSS refuses what would approximate
(its message 2360), most statements, so no setting of a speed (2359, 2923), and triggers by distance (2363); a
block without approximation behind ENDSPLINE ends in an exact stop. Parts are shares of the time at END: of
the two usages that were seen, percents of 100 and the seconds of each part, both mean that, and no other sum
is taken.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Iterator
from typing import Final

from planner.verify import krl_values
from planner.verify.krl_ast import Point, Said, Spline
from planner.verify.krl_values import KrlValueError

MOST_POINTS: Final = 500
"""A block is planned whole before it starts; more points [-] than this were seen to be too many."""
PARTS_SUM: Final = 1e-4
"""How far the parts may be off 100, or off the seconds at END, as a share."""

_TIME: Final = r"(\d{1,7}(?:\.\d{1,12})?)"
OPENS: Final = re.compile(r"SPLINE", re.IGNORECASE)
_SPL: Final = re.compile(r"SPL\s*(\{.*\})", re.IGNORECASE | re.ASCII)
_START: Final = re.compile(r"TIME_BLOCK\s+START", re.IGNORECASE)
_PART: Final = re.compile(rf"TIME_BLOCK\s+PART\s*=\s*{_TIME}", re.IGNORECASE | re.ASCII)
_END: Final = re.compile(rf"TIME_BLOCK\s+END\s*=\s*{_TIME}", re.IGNORECASE | re.ASCII)
_CLOSES: Final = re.compile(r"ENDSPLINE", re.IGNORECASE)
_WHY: Final = (
    (r"SPL\b.*\}\s*C_\w+", "no approximation between the points of a block (KSS 2360)"),
    (r"S?(LIN|CIRC|PTP)(_REL)?\b.*", "no other motion than SPL in a block of these programs"),
    (r"\$.*", "no setting and no output inside of a block (KSS 2359)"),
    (r"TRIGGER\b.*", "no trigger in a block of these programs (KSS 2363 by distance)"),
    (r"CONST_VEL\b.*", "CONST_VEL contradicts the times of a block"),
    (r"ENDSPLINE\s+C_\w+", "a block ends in an exact stop, without approximation behind ENDSPLINE"),
    (r"SPLINE\b.*", "a block inside of a block"),
)


class SplineError(Exception):
    """What is wrong in a block, at a line."""

    def __init__(self, line: int, kind: str, message: str) -> None:
        super().__init__(message)
        self.line, self.kind, self.message = line, kind, message


def block(line: int, rows: Iterator[tuple[int, str, list[Said]]]) -> Spline:
    """The block whose SPLINE stands in ``line``, from the ``rows`` behind it: line, code without its comment,
    and what the comment says to the proof. Raises :class:`SplineError`."""
    found: list[Point | Said] = []
    parts: list[float] = []
    started, seconds, last = False, None, line
    for last, code, says in rows:
        for said in says:
            if said.kind != "segment":
                raise SplineError(last, "syntax", "nothing is told or asked inside of a spline block")
        pending = len(parts) < sum(isinstance(item, Point) for item in found)
        if says and pending:
            raise SplineError(last, "syntax", "a segment begins between SPL and its TIME_BLOCK PART")
        found += says
        if not code:
            continue
        if _START.fullmatch(code) and not started and not _points(found):
            started = True
        elif (spl := _SPL.fullmatch(code)) and started and not pending and seconds is None:
            found.append(Point(last, _place(last, spl[1]), 0.0))
        elif (part := _PART.fullmatch(code)) and pending and seconds is None:
            parts.append(float(part[1]))
        elif (end := _END.fullmatch(code)) and parts and not pending and seconds is None:
            seconds = float(end[1])
        elif _CLOSES.fullmatch(code) and seconds is not None:
            return _made(line, found, parts, seconds)
        else:
            raise SplineError(last, "syntax", f"{_shown(code)}: {_reason(code)}")
    raise SplineError(last, "syntax", "a spline block without its ENDSPLINE")


def _points(items: list[Point | Said]) -> int:
    """How many points are among the items."""
    return sum(isinstance(item, Point) for item in items)


def _made(line: int, found: list[Point | Said], parts: list[float], seconds: float) -> Spline:
    total, count = math.fsum(parts), len(parts)
    if count > MOST_POINTS:
        what = f"a spline block of {count} points; allowed: {MOST_POINTS}; break it at a stop"
        raise SplineError(line, "spline_size", what)
    if min(parts) <= 0.0 or seconds <= 0.0:
        raise SplineError(line, "type", "a part, or all, of the block's time is 0; allowed: more than that")
    if min(abs(total - whole) / whole for whole in (100.0, seconds)) > PARTS_SUM:
        what = f"the parts make up {total:g}; allowed: 100 (percents) or {seconds:g} (the seconds at END)"
        raise SplineError(line, "type", what)
    shares = iter(parts)
    points = [
        dataclasses.replace(item, part=next(shares) / total) if isinstance(item, Point) else item
        for item in found
    ]
    return Spline(line, tuple(points), seconds)


def _place(line: int, text: str) -> tuple[float, float, float, float, float, float]:
    try:
        return krl_values.place(text)
    except KrlValueError as wrong:
        raise SplineError(line, wrong.kind, wrong.message) from None


def _reason(code: str) -> str:
    """Why a statement may not stand where it does."""
    for pattern, why in _WHY:
        if re.fullmatch(pattern, code, re.IGNORECASE | re.ASCII):
            return why
    return (
        "not the next statement of a block: TIME_BLOCK START, then SPL and TIME_BLOCK PART for each "
        "point, then TIME_BLOCK END and ENDSPLINE"
    )


def _shown(code: str) -> str:
    return repr(code if len(code) <= 60 else code[:57] + "...")
