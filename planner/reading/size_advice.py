"""How large a block or a sheet is enough, found by trying it: what a part needs besides its own size (room of
the tools in the clamp's opening, of a bow beside the support) the checks of the enlarged problem tell.
"""

import copy
import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any, Final

from planner.issues import Issue, Severity, TandemError
from planner.reading.problem import SettingsFile
from planner.reading.sheet import ClampFile
from planner.reading.strict_yaml import Document

STOCK_TOO_SMALL: Final = "part.stock_too_small"
"""Code of what a larger block mends."""
CLAMP_TOO_SMALL: Final = "forming.clamp"
"""Code of what a larger opening of the clamp mends."""
ADDED_HEIGHTS_MM: Final = (30.0, 60.0)
"""Blocks that are higher by these [mm] are tried where arms have no room for the work on a tight one."""
MOST_FACTOR: Final = 3.0
"""A part that needs a block or an opening of more than so many times the given one is not tried: its unit is
wrong."""
MOST_NAMED: Final = 2
"""Faults left over that are named at most."""

Data = dict[str, Any]
Check = Callable[[Document, bool], Sequence[Issue]]
"""The issues of a changed problem; with True also those of a first look at its motion. May raise
``TandemError``."""
Look = Callable[[bool], list[Issue]]
"""The errors of the data as they are now."""
Wider = Callable[[float, bool], float]
"""By how much [mm] an opening has to be wider where tools are so deep [mm] in its clamp; True: if round."""


def advised(document: Document, issues: Sequence[Issue], check: Check, wider: Wider) -> list[Issue]:
    """The issues of the problem in a file; where the one error is a block or sheet that is too small, it is
    told with a size that was tried, and with what is still wrong then."""
    errors = [issue for issue in issues if issue.severity is Severity.ERROR]
    if len(errors) != 1 or errors[0].code != STOCK_TOO_SMALL:
        return list(issues)
    data = copy.deepcopy(document.data)

    def look(far: bool) -> list[Issue]:
        try:
            found = check(document.with_data(data), far)
        except TandemError as error:
            found = error.issues
        return [issue for issue in found if issue.severity is Severity.ERROR]

    blocked = data.get("sheet") is None
    told = _block(data, errors[0], look) if blocked else _sheet(data, errors[0], look, wider)
    return [told if issue is errors[0] else issue for issue in issues]


def _block(data: Data, issue: Issue, look: Look) -> Issue:
    """With the tightest block in which the work can be done; else that in which it comes farthest."""
    if issue.remedy is None or issue.remedy.size_mm is None:
        return issue
    stock, old = data["stock"], data["stock"]["size_mm"]
    stock["size_mm"] = size = list(issue.remedy.size_mm)
    if any(new > MOST_FACTOR * was for new, was in zip(size, old, strict=True)):
        return issue
    left = look(True)
    if _earlier(left) and data["part"].get("in_stock", "auto") == "auto":
        # work that is given in the block's frame may be meant for a part that lies the other way round
        stock["size_mm"] = other = [max(old[0], size[1]), max(old[1], size[0]), size[2]]
        found = look(True)
        size, left = (size, left) if _earlier(found) else (other, found)
    for more in ADDED_HEIGHTS_MM:
        if not left or _earlier(left):
            break
        stock["size_mm"] = other = [*size[:2], round(size[2] + more, 1)]
        found = look(True)
        size, left = (size, left) if found else (other, found)
    remedy = dataclasses.replace(issue.remedy, size_mm=tuple(size))
    return dataclasses.replace(issue, hint=f"take size_mm: {_list(size)}{_left(left)}", remedy=remedy)


def _earlier(left: Sequence[Issue]) -> bool:
    """Whether something is wrong before motion is looked at."""
    return any(not issue.code.startswith("motion.") for issue in left)


def _sheet(data: Data, issue: Issue, look: Look, wider: Wider) -> Issue:
    """With an opening that has room for the part and for the tools that form it (forming.clamp)."""
    sheet, settings = data["sheet"], data.get("settings") or {}
    clear = settings.get("clearance_mm", SettingsFile().clearance_mm)
    more = 2.0 * (issue.value or 0.0)
    old, rim = sheet["opening_mm"], 2.0 * (sheet.get("clamp") or {}).get("width_mm", ClampFile().width_mm)
    if more > (MOST_FACTOR - 1.0) * (min(old) if isinstance(old, list) else old):
        return issue

    def widened() -> list[float] | float:
        """The opening wider by ``more``, to whole millimetres."""
        added = math.ceil(more - 1e-6)
        opening = [value + added for value in old] if isinstance(old, list) else old + added
        wide = opening if isinstance(opening, list) else [opening] * 2
        sheet["opening_mm"] = opening
        sheet["size_mm"] = [max(a, b + rim) for a, b in zip(sheet["size_mm"], wide, strict=True)]
        return opening

    widened()
    deep = max((one.value or 0.0 for one in look(False) if one.code == CLAMP_TOO_SMALL), default=0.0)
    more += 2.0 * clear + wider(deep, not isinstance(old, list))
    opening, left = widened(), look(False)
    shown = _list(opening) if isinstance(opening, list) else f"{opening:g}"
    hint = f"take opening_mm: {shown} and size_mm: {_list(sheet['size_mm'])}, with room for the tools"
    told = f"{hint}{_left(left)}; or move the part (in_stock), or check its unit"
    return dataclasses.replace(issue, hint=told)


def _left(left: Sequence[Issue]) -> str:
    """What is still wrong with a size that was tried."""
    if not left:
        return " (tried)"
    codes = list(dict.fromkeys(one.code for one in left))[:MOST_NAMED]
    first = [next(one for one in left if one.code == code) for code in codes]
    told = (f"{one.message}; {one.hint}" if one.hint else one.message for one in first)
    return f"; then there is still: {'; and '.join(told)}"


def _list(values: Sequence[float]) -> str:
    return "[" + ", ".join(f"{value:g}" for value in values) + "]"
