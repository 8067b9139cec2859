"""Program text compared as a controller may print it again: numbers as numbers, spaces and case aside.

A controller that saves a module prints 160.0000 as 160, 9E9 as 9E+09 and single precision with six or seven
digits; none of that is a change.
"""

import dataclasses
import re
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, log_rotation

PRINT: Final = 5e-6
"""How far two prints of one number may be apart, as a share of it, or of 1 below 1: six digits."""
_STRING: Final = re.compile(r'("[^"\n]*")')
_NUMBER: Final = re.compile(r"(?<![\w$.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?![\w.])")
"""A number that is no part of a name: not the 1 of ROB_1, nor the 40 of v40."""


@dataclasses.dataclass(frozen=True)
class Shape:
    """A piece of text: its ``words`` with # for each number outside of strings, and the ``numbers``."""

    words: str
    numbers: tuple[float, ...]

    def same(self, other: "Shape") -> bool:
        """Whether the two differ in how they are printed at most."""
        return self.words == other.words and not self.apart(other)

    def apart(self, other: "Shape") -> tuple[int, ...]:
        """Which numbers differ, of two shapes with the same words."""
        pairs = enumerate(zip(self.numbers, other.numbers, strict=True))
        return tuple(k for k, (a, b) in pairs if not equal(a, b))

    @property
    def key(self) -> tuple[str, tuple[str, ...]]:
        """The same for texts that are the same; other prints of numbers mostly have it in common too."""
        return self.words, tuple(f"{number:.5g}" for number in self.numbers)


def equal(first: float, second: float) -> bool:
    """Whether two numbers are prints of one."""
    return abs(first - second) <= PRINT * max(1.0, abs(first), abs(second))


def shape(text: str) -> Shape:
    """The shape of RAPID or KRL text: letters outside of strings as capitals, single spaces between words."""
    numbers: list[float] = []
    parts = []
    for part in _STRING.split(text):
        if part.startswith('"'):
            parts.append(part)
            continue
        numbers += [float(found) for found in _NUMBER.findall(part)]
        plain = " ".join(_NUMBER.sub("#", part).upper().split())
        parts.append(re.sub(r" ?([^\w$#]) ?", r"\1", plain))
    return Shape("".join(parts), tuple(numbers))


def difference(planned: str, there: str) -> str | None:
    """In what two values differ, by words and by the largest difference of numbers; None if not."""
    first, second = shape(planned), shape(there)
    shown = f"there {there.strip()[:160]}, planned {planned.strip()[:160]}"
    if first.words != second.words:
        return shown
    apart = first.apart(second)
    if not apart:
        return None
    far = max(abs(first.numbers[k] - second.numbers[k]) for k in apart)
    return f"{len(apart)} of {len(first.numbers)} numbers, by up to {far:.4g} ({shown})"


def turn_deg(first: FloatArray, second: FloatArray) -> float:
    """Angle [deg] between two rotations (3, 3), exact near 0 too."""
    return float(np.degrees(np.linalg.norm(log_rotation(first.T @ second))))
