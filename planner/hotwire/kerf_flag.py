"""What is to be said against a kerf that a model gives."""

from __future__ import annotations

import enum
from typing import Final

DOMAIN: Final = (0.8e-3, 3.0e-3)
"""Kerfs [m] that leave usable faces: thinner the wire drags, wider it burns (dissertation, chapter 3)."""


class KerfFlag(enum.IntFlag):
    """Doubts about one estimate; 0 is none. Arrays of flags are uint8."""

    OK = 0
    TOO_HOT = 1
    TOO_COLD = 2
    THICKNESS = 4
    UNTESTED = 8
    OTHER_WIRE = 16


MEANING: Final[dict[KerfFlag, str]] = {
    KerfFlag.TOO_HOT: "too hot: burnt, concave faces; cut faster or with less power",
    KerfFlag.TOO_COLD: "too cold: the wire drags and rounds corners; cut slower or with more power",
    KerfFlag.THICKNESS: "the foam is thicker or thinner than in the tests",
    KerfFlag.UNTESTED: "power per length or speed is outside the tests",
    KerfFlag.OTHER_WIRE: "the wire is not as thick as in the tests",
}


def explain(flag: int) -> tuple[str, ...]:
    """What each doubt in ``flag`` means, in words; none for 0."""
    return tuple(text for bit, text in MEANING.items() if flag & bit)
