"""Advice on the size of a block or sheet that is too small, found by trial.

What a part needs besides its own size (clearance of tools in the opening of the clamp, of a bow beside the
support) follows from checks of the enlarged problem.
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
"""Issue code that a larger block resolves."""
CLAMP_TOO_SMALL: Final = "forming.clamp"
"""Issue code that a larger opening of the clamp resolves."""
ADDED_HEIGHTS_MM: Final = (30.0, 60.0)
"""Additional heights [mm] of blocks that are tried if arms cannot reach the work on a tight one."""
MAX_SIZE_FACTOR: Final = 3.0
"""Maximum ratio of a tried block or opening to the given one. A larger ratio indicates a wrong unit."""
MAX_NAMED_FAULTS: Final = 2
"""Maximum number of remaining faults that are named."""

Data = dict[str, Any]
ChangedProblemCheck = Callable[[Document, bool], Sequence[Issue]]
"""Returns the issues of a changed problem; with True also those of a quick check of its motion.

May raise ``TandemError``.
"""
ErrorCheck = Callable[[bool], list[Issue]]
"""Returns the errors of the current data."""
RequiredWidening = Callable[[float, bool], float]
"""Returns how much [mm] wider an opening has to be for a tool depth [mm] in its clamp; True: if round."""


def add_size_advice(
    document: Document,
    issues: Sequence[Issue],
    check: ChangedProblemCheck,
    required_widening: RequiredWidening,
) -> list[Issue]:
    """Add a tried size to the issues of a problem whose only error is a block or sheet that is too small.

    The hint also states what is still wrong with that size.

    Args:
        document: Problem file.
        issues: Issues of the problem.
        check: Checks a changed problem.
        required_widening: Computes how much wider an opening has to be.
    """
    errors = [issue for issue in issues if issue.severity is Severity.ERROR]
    if len(errors) != 1 or errors[0].code != STOCK_TOO_SMALL:
        return list(issues)
    data = copy.deepcopy(document.data)

    def find_errors(include_motion: bool) -> list[Issue]:
        try:
            found_issues = check(document.with_data(data), include_motion)
        except TandemError as error:
            found_issues = error.issues
        return [issue for issue in found_issues if issue.severity is Severity.ERROR]

    is_block = data.get("sheet") is None
    advice = (
        _advise_block(data, errors[0], find_errors)
        if is_block
        else _advise_sheet(data, errors[0], find_errors, required_widening)
    )
    return [advice if issue is errors[0] else issue for issue in issues]


def _advise_block(data: Data, issue: Issue, find_errors: ErrorCheck) -> Issue:
    """Add the smallest block in which the work is feasible, else the one with the fewest remaining faults."""
    if issue.remedy is None or issue.remedy.size_mm is None:
        return issue
    stock, given_size = data["stock"], data["stock"]["size_mm"]
    stock["size_mm"] = size = list(issue.remedy.size_mm)
    if any(new > MAX_SIZE_FACTOR * given for new, given in zip(size, given_size, strict=True)):
        return issue
    remaining = find_errors(True)
    if _precedes_motion(remaining) and data["part"].get("in_stock", "auto") == "auto":
        # work stated in the block's frame may be for a part with x and y exchanged
        stock["size_mm"] = trial_size = [max(given_size[0], size[1]), max(given_size[1], size[0]), size[2]]
        errors = find_errors(True)
        size, remaining = (size, remaining) if _precedes_motion(errors) else (trial_size, errors)
    for added_height in ADDED_HEIGHTS_MM:
        if not remaining or _precedes_motion(remaining):
            break
        stock["size_mm"] = trial_size = [*size[:2], round(size[2] + added_height, 1)]
        errors = find_errors(True)
        size, remaining = (size, remaining) if errors else (trial_size, errors)
    remedy = dataclasses.replace(issue.remedy, size_mm=tuple(size))
    return dataclasses.replace(
        issue, hint=f"set size_mm: {_format_list(size)}{_remaining_text(remaining)}", remedy=remedy
    )


def _precedes_motion(remaining: Sequence[Issue]) -> bool:
    """Whether there is a fault that is found before motion is checked."""
    return any(not issue.code.startswith("motion.") for issue in remaining)


def _advise_sheet(
    data: Data, issue: Issue, find_errors: ErrorCheck, required_widening: RequiredWidening
) -> Issue:
    """Add an opening that fits the part and the tools that form it (forming.clamp)."""
    sheet, settings = data["sheet"], data.get("settings") or {}
    clearance = settings.get("clearance_mm", SettingsFile().clearance_mm)
    widening = 2.0 * (issue.value or 0.0)
    given, rim = (sheet["opening_mm"], 2.0 * (sheet.get("clamp") or {}).get("width_mm", ClampFile().width_mm))
    if widening > (MAX_SIZE_FACTOR - 1.0) * (min(given) if isinstance(given, list) else given):
        return issue

    def widened() -> list[float] | float:
        """Widen the opening by ``widening``, rounded up to whole millimetres."""
        added = math.ceil(widening - 1e-6)
        opening = [value + added for value in given] if isinstance(given, list) else given + added
        sides = opening if isinstance(opening, list) else [opening] * 2
        sheet["opening_mm"] = opening
        sheet["size_mm"] = [max(a, b + rim) for a, b in zip(sheet["size_mm"], sides, strict=True)]
        return opening

    widened()
    tool_depth = max(
        (fault.value or 0.0 for fault in find_errors(False) if fault.code == CLAMP_TOO_SMALL), default=0.0
    )
    widening += 2.0 * clearance + required_widening(tool_depth, not isinstance(given, list))
    opening, remaining = widened(), find_errors(False)
    opening_text = _format_list(opening) if isinstance(opening, list) else f"{opening:g}"
    hint = (
        f"set opening_mm: {opening_text} and size_mm: {_format_list(sheet['size_mm'])}, with space for the "
        "tools"
    )
    text = f"{hint}{_remaining_text(remaining)}; or move the part (in_stock), or check its unit"
    return dataclasses.replace(issue, hint=text)


def _remaining_text(remaining: Sequence[Issue]) -> str:
    """Describe the remaining faults of a tried size."""
    if not remaining:
        return " (tried)"
    codes = list(dict.fromkeys(issue.code for issue in remaining))[:MAX_NAMED_FAULTS]
    first = [next(issue for issue in remaining if issue.code == code) for code in codes]
    texts = (f"{issue.message}; {issue.hint}" if issue.hint else issue.message for issue in first)
    return f"; then remains: {'; and '.join(texts)}"


def _format_list(values: Sequence[float]) -> str:
    return "[" + ", ".join(f"{value:g}" for value in values) + "]"
