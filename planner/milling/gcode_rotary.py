"""Machines with rotary axes: how their angles turn the tool against the part.

Each convention says which axes carry the tool and which carry the part, from the machine's frame outwards.
Angles count by the right hand about the machine's +x (A), +y (B) and +z (C), as the thing that the axis
carries turns; a machine that counts an axis the other way round, such as a table that is counted by the
tool's motion against it (ISO 841), names it in ``reverse``. At zero the tool points along the spindle's own
axis, from the tip up along +z.
"""

from __future__ import annotations

import dataclasses
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

ConventionName = Literal[
    "head_a",
    "head_b",
    "head_ca",
    "head_cb",
    "head_ab",
    "head_ba",
    "table_a",
    "table_b",
    "table_ac",
    "table_bc",
    "head_a_table_c",
    "head_b_table_c",
]

LETTERS: Final = "ABC"


@dataclasses.dataclass(frozen=True)
class Convention:
    """A chain of axes from the part to the tool: (letter, +1 where it carries the tool, -1 the part)."""

    name: str
    chain: tuple[tuple[str, int], ...]

    @property
    def letters(self) -> str:
        """The rotary words that the machine has, in alphabetical order."""
        return "".join(sorted(letter for letter, _ in self.chain))

    def axis(self, angles: FloatArray) -> FloatArray:
        """Unit vectors (N, 3) from the tip to the spindle in the part's frame, of angles (N, 3) [rad] of A, B
        and C.

        The tool is turned by the product of its axes' rotations from the ram outwards; a part on a table is
        turned the same way, so that in its own frame the tool turns by the inverse.
        """
        out = np.zeros((len(angles), 3))
        out[:, 2] = 1.0
        for letter, sign in reversed(self.chain):
            about = LETTERS.index(letter)
            first, second = (about + 1) % 3, (about + 2) % 3
            cos, sin = np.cos(angles[:, about]), sign * np.sin(angles[:, about])
            turned = cos * out[:, first] - sin * out[:, second]
            out[:, second] = sin * out[:, first] + cos * out[:, second]
            out[:, first] = turned
        return out


CONVENTIONS: Final[dict[str, Convention]] = {
    one.name: one
    for one in (
        Convention("head_a", (("A", 1),)),
        Convention("head_b", (("B", 1),)),
        Convention("head_ca", (("C", 1), ("A", 1))),
        Convention("head_cb", (("C", 1), ("B", 1))),
        Convention("head_ab", (("A", 1), ("B", 1))),
        Convention("head_ba", (("B", 1), ("A", 1))),
        Convention("table_a", (("A", -1),)),
        Convention("table_b", (("B", -1),)),
        Convention("table_ac", (("C", -1), ("A", -1))),
        Convention("table_bc", (("C", -1), ("B", -1))),
        Convention("head_a_table_c", (("C", -1), ("A", 1))),
        Convention("head_b_table_c", (("C", -1), ("B", 1))),
    )
}
"""``head_ca``: C on the ram carries A, which carries the spindle. ``table_ac``: A on the bed carries C, which
carries the part. ``head_b_table_c``: B tilts the spindle, C turns the part."""


def convention(name: ConventionName, reverse: str) -> Convention:
    """The convention of that name with the axes in ``reverse`` counted the other way round."""
    own = CONVENTIONS[name]
    chain = tuple((letter, -sign if letter in reverse else sign) for letter, sign in own.chain)
    return Convention(name, chain)


def pieces(turn: FloatArray, tolerance: float) -> NDArray[np.int64]:
    """How many equal pieces (N,) a move with changes (N, 3) [rad] of the angles takes, so that between their
    ends the axis is within ``tolerance`` [rad] of the great circle.

    The axis moves on the unit sphere with an acceleration of at most s^2, s being the sum of the angles'
    speeds, so that over a piece it is off its chord by at most (s t)^2 / 8.
    """
    change = np.abs(turn).sum(axis=1)
    count = np.maximum(np.ceil(change / np.sqrt(8.0 * tolerance) - 1e-9), 1.0)
    return np.asarray(count, dtype=np.int64)
