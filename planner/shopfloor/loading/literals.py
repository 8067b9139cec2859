"""Comparison of program text after a controller saved it: numbers by value; spaces and case are ignored.

A controller that saves a module prints 160.0000 as 160, 9E9 as 9E+09, and single precision with six or seven
digits. None of that is a change.
"""

import dataclasses
import re
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, log_rotation

PRINT_TOLERANCE: Final = 5e-6
"""Maximum relative difference of two prints of one number (absolute below 1): six digits."""
_STRING: Final = re.compile(r'("[^"\n]*")')
_NUMBER: Final = re.compile(r"(?<![\w$.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?![\w.])")
"""A number that is not part of a name: neither the 1 of ROB_1 nor the 40 of v40."""


@dataclasses.dataclass(frozen=True)
class TextShape:
    """A text without its way of printing.

    Attributes:
        words: Text with # for each number outside of strings.
        numbers: These numbers, in order.
    """

    words: str
    numbers: tuple[float, ...]

    def same(self, other: "TextShape") -> bool:
        """Whether two texts are equal, apart from how they are printed."""
        return self.words == other.words and not self.differing_numbers(other)

    def differing_numbers(self, other: "TextShape") -> tuple[int, ...]:
        """Return the indices of numbers that differ from those of a shape with the same words."""
        pairs = enumerate(zip(self.numbers, other.numbers, strict=True))
        return tuple(k for k, (a, b) in pairs if not equal(a, b))

    @property
    def key(self) -> tuple[str, tuple[str, ...]]:
        """Key for a search of equal texts.

        Different prints of the same numbers have the same key, except rarely at the limit of rounding.
        """
        return self.words, tuple(f"{number:.5g}" for number in self.numbers)


def equal(first: float, second: float) -> bool:
    """Whether two numbers are prints of the same number."""
    return abs(first - second) <= PRINT_TOLERANCE * max(1.0, abs(first), abs(second))


def text_shape(text: str) -> TextShape:
    """Return the shape of RAPID or KRL text: upper case outside of strings, spaces only between words."""
    numbers: list[float] = []
    parts = []
    for part in _STRING.split(text):
        if part.startswith('"'):
            parts.append(part)
            continue
        numbers += [float(number) for number in _NUMBER.findall(part)]
        normalised = " ".join(_NUMBER.sub("#", part).upper().split())
        parts.append(re.sub(r" ?([^\w$#]) ?", r"\1", normalised))
    return TextShape("".join(parts), tuple(numbers))


def difference(planned: str, actual: str) -> str | None:
    """Describe how two values differ, with the largest difference of numbers; None if they are equal."""
    first, second = text_shape(planned), text_shape(actual)
    values_text = f"on the controller {actual.strip()[:160]}, planned {planned.strip()[:160]}"
    if first.words != second.words:
        return values_text
    differing = first.differing_numbers(second)
    if not differing:
        return None
    max_difference = max(abs(first.numbers[k] - second.numbers[k]) for k in differing)
    return f"{len(differing)} of {len(first.numbers)} numbers, by up to {max_difference:.4g} ({values_text})"


def turn_deg(first: FloatArray, second: FloatArray) -> float:
    """Return the angle [deg] between two rotations (3, 3), which is accurate also near 0."""
    return float(np.degrees(np.linalg.norm(log_rotation(first.T @ second))))
