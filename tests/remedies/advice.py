"""Figures and words that are taken from what issues advise."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Sequence
from typing import Any

from planner.issues import Issue


def said(issues: Sequence[Issue], pattern: str) -> str:
    """The one group of a pattern in the issues' words; raises ``ValueError`` where it is not there."""
    text = "; ".join(f"{issue.message}; {issue.hint or ''}" for issue in issues)
    found = re.search(pattern, text)
    if found is None:
        raise ValueError(f"{pattern!r} is not said in: {text}")
    return found[1]


@dataclasses.dataclass(frozen=True)
class Said:
    """A figure that is taken from an issue's words, where ``#`` stands in ``words``: ``times`` so much, added
    to what the field has if ``more``, rounded to ``step``, up or ``down``."""

    words: str
    step: float = 1.0
    down: bool = False
    times: float = 1.0
    more: bool = False

    def of(self, issues: Sequence[Issue], now: Any) -> float:
        figure = said(issues, re.escape(self.words).replace(r"\#", r"(-?\d+(?:\.\d+)?)"))
        rounded = (math.floor if self.down else math.ceil)(round(float(figure) * self.times / self.step, 6))
        return round(rounded * self.step + (now if self.more else 0.0), 9)


@dataclasses.dataclass(frozen=True)
class Word:
    """A word that is taken from an issue, by a pattern with one group."""

    pattern: str

    def of(self, issues: Sequence[Issue], now: Any) -> str:
        del now
        return said(issues, self.pattern)


@dataclasses.dataclass(frozen=True)
class Words(Word):
    """A text with such a word in the place of its ``#``."""

    text: str

    def of(self, issues: Sequence[Issue], now: Any) -> str:
        return self.text.replace("#", super().of(issues, now))
