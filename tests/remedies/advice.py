"""Figures and words that are extracted from the advice of issues."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Sequence
from typing import Any

from planner.issues import Issue


def find_in_issues(issues: Sequence[Issue], pattern: str) -> str:
    """Return the only group of a pattern in the text of issues.

    Raises:
        ValueError: The pattern does not match.
    """
    text = "; ".join(f"{issue.message}; {issue.hint or ''}" for issue in issues)
    match = re.search(pattern, text)
    if match is None:
        raise ValueError(f"{pattern!r} is not said in: {text}")
    return match[1]


@dataclasses.dataclass(frozen=True)
class ReportedFigure:
    """A figure of an issue's text, at ``#`` in ``words``.

    It is multiplied by ``times``, added to the value of the field if ``more``, and rounded to ``step``, up or
    ``down``.
    """

    words: str
    step: float = 1.0
    down: bool = False
    times: float = 1.0
    more: bool = False

    def of(self, issues: Sequence[Issue], now: Any) -> float:
        figure = find_in_issues(issues, re.escape(self.words).replace(r"\#", r"(-?\d+(?:\.\d+)?)"))
        rounded = (math.floor if self.down else math.ceil)(round(float(figure) * self.times / self.step, 6))
        return round(rounded * self.step + (now if self.more else 0.0), 9)


@dataclasses.dataclass(frozen=True)
class Word:
    """A word that is taken from an issue, by a pattern with one group."""

    pattern: str

    def of(self, issues: Sequence[Issue], now: Any) -> str:
        del now
        return find_in_issues(issues, self.pattern)


@dataclasses.dataclass(frozen=True)
class Words(Word):
    """A text with such a word in the place of its ``#``."""

    text: str

    def of(self, issues: Sequence[Issue], now: Any) -> str:
        return self.text.replace("#", super().of(issues, now))
