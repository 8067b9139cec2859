"""State of a G-code controller: modes, rotary axes, and what the problem states beside the file.

`Modal` is what a controller remembers from line to line, `Dialect` what the problem states beside
the file.

**Rotary axes** (`Convention`): how their angles turn the tool against the part. Each convention
says which axes carry the tool and which carry the part, from the machine's frame outwards. Angles
count by the right hand about the machine's +x (A), +y (B) and +z (C), as the thing that the axis
carries turns; a machine that counts an axis the other way round, such as a table that is counted by
the tool's motion against it (ISO 841), names it in ``reverse``. At zero the tool points along the
spindle's own axis, from the tip up along +z.
"""

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Final, Literal

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray

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

ROTARY_NAMES: Final = "ABC"
"""Rotary axes about x, y and z."""


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
            about = ROTARY_NAMES.index(letter)
            first, second = (about + 1) % 3, (about + 2) % 3
            cos, sin = np.cos(angles[:, about]), sign * np.sin(angles[:, about])
            turned = cos * out[:, first] - sin * out[:, second]
            out[:, second] = sin * out[:, first] + cos * out[:, second]
            out[:, first] = turned
        return out


KINEMATICS: Final[dict[str, Convention]] = {
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


def convention(name: str, reverse: str) -> Convention:
    """The convention of that name with the axes in ``reverse`` counted the other way round."""
    own = KINEMATICS[name]
    chain = tuple((letter, -sign if letter in reverse else sign) for letter, sign in own.chain)
    return Convention(name, chain)


def pieces(turn: FloatArray, tolerance: float) -> IntArray:
    """How many equal pieces (N,) a move with changes (N, 3) [rad] of the angles takes, so that between their
    ends the axis is within ``tolerance`` [rad] of the great circle.

    The axis moves on the unit sphere with an acceleration of at most s^2, s being the sum of the angles'
    speeds, so that over a piece it is off its chord by at most (s t)^2 / 8.
    """
    change = np.abs(turn).sum(axis=1)
    count = np.maximum(np.ceil(change / np.sqrt(8.0 * tolerance) - 1e-9), 1.0)
    return np.asarray(count, dtype=np.int64)


FeedMode = Literal["per_minute", "inverse_time", "per_rev"]
Triple = tuple[float, float, float]

UNKNOWN_POSITION: Triple = (math.nan, math.nan, math.nan)
"""Position before the first move of a file."""
RAPID, LINEAR, CLOCKWISE, COUNTER = 0, 1, 2, 3
"""Motion modes, by their G codes."""
INCH = 0.0254
"""One inch in metres."""


@dataclasses.dataclass(frozen=True)
class Dialect:
    """What the problem states of a file, in SI units; None is left to the file.

    ``unit`` [m], ``absolute`` coordinates, ``motion`` mode, ``plane`` by its normal (2 for xy), ``feed``
    [m/s], ``spindle`` [rad/s], ``dwell`` [s] is what one P of a G4 means. ``turns``: the words that turn the
    tool, "IJK", those of ``convention``, or none; ``to_spindle``: +1 where I J K points to the spindle, -1 to
    the tip. ``start`` (3,) [m] is where the tip is before the first line; ``offsets`` are those of G54 to G59
    in the file's frame [m], which ``place`` (4, 4) puts into the stock's. ``skip``: codes to pass over.
    ``tool``: the number whose moves are wanted, None for the only one. ``chord`` [m] and ``angle`` [rad]
    bound what pieces of arcs and of turns are off. ``field``: where the problem file states all this.
    """

    file: Path
    field: str
    unit: float | None
    absolute: bool | None
    motion: int | None
    plane: int | None
    feed_mode: FeedMode | None
    feed: float | None
    spindle: float | None
    absolute_centre: bool
    dwell: float | None
    turns: str
    convention: Convention | None
    to_spindle: int
    block_delete: bool | None
    start: Triple
    offsets: Mapping[int, Triple]
    skip: frozenset[str]
    tool: int | None
    chord: float
    angle: float
    place: FloatArray


@dataclasses.dataclass(frozen=True)
class Modal:
    """The state between two lines. Places [m] are in the file's frame, offset included.

    ``turn``: the last I J K, or angles of A B C [rad]. ``feed`` [m/s], or [m] a turn of the spindle with
    ``per_rev``. ``spindle`` [rad/s] as it runs, ``speed`` [rad/s] as S states it. ``chosen``: the tool that T
    asks for, ``tool`` the one in the spindle, 0 for one that no line names. ``gap``: moves were left out
    since the last one that is kept. ``started``: a line had words; ``ended``: the program is over.
    """

    unit: float | None
    absolute: bool | None
    motion: int | None
    plane: int | None
    feed_mode: FeedMode | None
    feed: float | None
    speed: float | None
    spindle: float
    absolute_centre: bool
    place: Triple
    turn: Triple
    offset: Triple = (0.0, 0.0, 0.0)
    chosen: int | None = None
    tool: int = 0
    gap: bool = False
    marks: int = 0
    started: bool = False
    ended: bool = False


def first(dialect: Dialect) -> Modal:
    """The state before the first line."""
    return Modal(
        unit=dialect.unit,
        absolute=dialect.absolute,
        motion=dialect.motion,
        plane=dialect.plane,
        feed_mode=dialect.feed_mode,
        feed=dialect.feed,
        speed=dialect.spindle,
        spindle=dialect.spindle or 0.0,
        absolute_centre=dialect.absolute_centre,
        place=dialect.start,
        turn=(0.0, 0.0, float(dialect.to_spindle)) if dialect.turns == "IJK" else (0.0, 0.0, 0.0),
    )


def wanted(modal: Modal, dialect: Dialect) -> bool:
    """Whether moves of the tool in the spindle are asked for."""
    return dialect.tool is None or modal.tool == dialect.tool
