"""State of a G-code controller: modes, rotary axes, and statements of the problem in addition to the file.

`Modal` is the state that a controller keeps from line to line. `Dialect` has the statements of the problem.

**Rotary axes** (`Convention`): how their angles rotate the tool relative to the part. Each convention states
which axes carry the tool and which carry the part, from the machine's frame outwards. Angles are positive by
the right-hand rule about the machine's +x (A), +y (B) and +z (C), for the rotation of what the axis carries.
An axis that the machine counts in the opposite direction is named in ``reverse``, for example a table counted
by the tool's relative motion (ISO 841). At zero the tool points along the spindle's own axis, from the tip up
along +z.
"""

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Final, Literal

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray

# Names of the conventions of rotary axes, which are explained at KINEMATICS.
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
"""Letters of the rotary axes about x, y and z."""


@dataclasses.dataclass(frozen=True)
class Convention:
    """A chain of axes from the part to the tool.

    Attributes:
        name: Name in problem files.
        chain: Letter of each axis, and +1 if it carries the tool, -1 if it carries the part.
    """

    name: str
    chain: tuple[tuple[str, int], ...]

    @property
    def letters(self) -> str:
        """Rotary words that the machine has, in alphabetical order."""
        return "".join(sorted(letter for letter, _ in self.chain))

    def axis(self, angles: FloatArray) -> FloatArray:
        """Return unit vectors (N, 3) from the tip to the spindle in the part's frame.

        The tool is rotated by the product of its axes' rotations from the ram outwards. A part on a table is
        rotated the same way, so that in the part's own frame the tool is rotated by the inverse.

        Args:
            angles: Angles of A, B and C (N, 3) [rad].
        """
        out = np.zeros((len(angles), 3))
        out[:, 2] = 1.0
        for letter, sign in reversed(self.chain):
            about = ROTARY_NAMES.index(letter)
            first, second = (about + 1) % 3, (about + 2) % 3
            cos, sin = np.cos(angles[:, about]), sign * np.sin(angles[:, about])
            rotated = cos * out[:, first] - sin * out[:, second]
            out[:, second] = sin * out[:, first] + cos * out[:, second]
            out[:, first] = rotated
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
"""Conventions by name.

``head_ca``: C on the ram carries A, which carries the spindle. ``table_ac``: A on the bed carries C, which
carries the part. ``head_b_table_c``: B tilts the spindle, C rotates the part.
"""


def find_convention(name: str, reverse: str) -> Convention:
    """Return the convention of that name with the axes in ``reverse`` counted in the opposite direction."""
    base = KINEMATICS[name]
    chain = tuple((letter, -sign if letter in reverse else sign) for letter, sign in base.chain)
    return Convention(name, chain)


def piece_counts(rotations: FloatArray, tolerance: float) -> IntArray:
    """Return the number (N,) of equal pieces into which moves are divided.

    In each piece the axis must stay near the great circle between its ends. The axis moves on the unit sphere
    with an acceleration of at most s^2, where s is the sum of the angles' speeds. Over a piece of duration t
    it therefore deviates from its chord by at most (s t)^2 / 8.

    Args:
        rotations: Changes of the angles (N, 3) [rad].
        tolerance: Allowed deviation between the ends of a piece [rad].
    """
    change = np.abs(rotations).sum(axis=1)
    count = np.maximum(np.ceil(change / np.sqrt(8.0 * tolerance) - 1e-9), 1.0)
    return np.asarray(count, dtype=np.int64)


FeedMode = Literal["per_minute", "inverse_time", "per_rev"]
"""Meaning of F: G94, G93 or G95."""
Triple = tuple[float, float, float]
"""Three values about x, y and z."""

UNKNOWN_POSITION: Triple = (math.nan, math.nan, math.nan)
"""Position before the first move of a file."""
RAPID, LINEAR, CLOCKWISE, COUNTER = 0, 1, 2, 3
"""Motion modes, by their G codes."""
INCH_M = 0.0254
"""One inch in metres."""


@dataclasses.dataclass(frozen=True)
class Dialect:
    """Statements of the problem about a file, in SI units. A value of None is left to the file.

    Attributes:
        file: The file.
        field: Where the problem file states all this, for messages.
        unit: Length unit [m].
        absolute: Whether coordinates are absolute.
        motion: Motion mode.
        plane: Index of the plane's normal; 2 for xy.
        feed_mode: Meaning of F.
        feed: Feed [m/s].
        spindle: Spindle speed [rad/s].
        absolute_centre: Whether arc centres are absolute.
        dwell: Duration of one P of a G4 [s].
        rotation_words: Letters of the words that rotate the tool: "IJK", those of ``convention``, or "".
        convention: Rotary axes of the machine.
        to_spindle: +1 if I J K points to the spindle, -1 if it points to the tip.
        block_delete: Whether lines with / are left out.
        start: Position of the tip before the first line (3,) [m].
        offsets: Offsets of G54 to G59 in the file's frame [m].
        skip: Codes to skip.
        tool: Number of the tool whose moves are used, None for the only one.
        chord: Chord error of pieces of arcs [m].
        angle: Allowed deviation of the axis between pieces of rotations [rad].
        frame: Pose of the file's frame in the stock frame (4, 4).
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
    rotation_words: str
    convention: Convention | None
    to_spindle: int
    block_delete: bool | None
    start: Triple
    offsets: Mapping[int, Triple]
    skip: frozenset[str]
    tool: int | None
    chord: float
    angle: float
    frame: FloatArray


@dataclasses.dataclass(frozen=True)
class Modal:
    """State between two lines. Positions are in the file's frame [m], offset included.

    Attributes:
        unit: Length unit [m].
        absolute: Whether coordinates are absolute.
        motion: Motion mode.
        plane: Index of the plane's normal.
        feed_mode: Meaning of F.
        feed: Feed [m/s], or [m] per revolution of the spindle with ``per_rev``.
        speed: Spindle speed as S states it [rad/s].
        spindle: Spindle speed as it runs [rad/s].
        absolute_centre: Whether arc centres are absolute.
        position: Position of the tip.
        turn: The last I J K, or angles of A B C [rad].
        offset: Active offset [m].
        chosen: Tool that T selects.
        tool: Tool in the spindle, 0 if no line names it.
        gap: Whether moves of other tools were left out since the last move that is used.
        marks: Number of % lines so far.
        started: Whether a line had words.
        ended: Whether the program has ended.
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
    position: Triple
    turn: Triple
    offset: Triple = (0.0, 0.0, 0.0)
    chosen: int | None = None
    tool: int = 0
    gap: bool = False
    marks: int = 0
    started: bool = False
    ended: bool = False


def initial_state(dialect: Dialect) -> Modal:
    """Return the state before the first line."""
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
        position=dialect.start,
        turn=(0.0, 0.0, float(dialect.to_spindle)) if dialect.rotation_words == "IJK" else (0.0, 0.0, 0.0),
    )


def uses_tool(modal: Modal, dialect: Dialect) -> bool:
    """Return whether moves of the tool in the spindle are used."""
    return dialect.tool is None or modal.tool == dialect.tool
