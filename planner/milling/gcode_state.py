"""What a G-code controller remembers from line to line, and what the problem states beside the file."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planner.milling.gcode_rotary import Convention

FloatArray = NDArray[np.float64]
FeedMode = Literal["per_minute", "inverse_time", "per_rev"]
Triple = tuple[float, float, float]

NOWHERE: Triple = (math.nan, math.nan, math.nan)
RAPID, LINEAR, CLOCKWISE, COUNTER = 0, 1, 2, 3
"""Motion modes, by their G codes."""
INCH = 0.0254


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
