"""Moves in a file's own words as the way of a cutter: axes from I J K or angles, in the stock's frame."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.milling.gcode_faults import Faults
from planner.milling.gcode_rotary import pieces
from planner.milling.gcode_rows import KINDS, Event, Gathered, Rows
from planner.milling.gcode_state import Dialect
from planner.milling.values import ToolPath

FloatArray = NDArray[np.float64]

FARTHEST: Final = 100.0
"""No coordinate [m] is farther out: another unit is meant."""
LENGTH_TOL: Final = 0.01
"""How far I J K may be off length 1: three decimals are, an arc's centre is not."""
OVER: Final = np.cos(np.deg2rad(179.0))


@dataclasses.dataclass(frozen=True)
class Last:
    """The last move before a block: its place (3,), its turn (3,) and its tool axis (3,), in file words."""

    place: FloatArray
    turn: FloatArray
    axis: FloatArray


@dataclasses.dataclass(frozen=True)
class Settled:
    """The path of a block, its events, and what the next block goes on from."""

    path: ToolPath
    events: tuple[Event, ...]
    last: Last | None


def settle(out: Gathered, last: Last | None, dialect: Dialect, faults: Faults) -> Settled:
    """The path of gathered moves; faults of places and axes are noted with their lines."""
    rows = out.rows()
    if len(rows.line) == 0:
        return Settled(_path(rows, np.zeros((0, 3)), dialect), tuple(out.events), last)
    far = np.asarray((np.abs(rows.place) > FARTHEST).any(axis=1))
    _note(
        far,
        rows,
        faults,
        "gcode.position",
        "far",
        f"a place beyond {FARTHEST:g} m; correct it, or the unit (G20 inches, G21 millimetres)",
    )
    if far.any():  # refused; numbers too large to reckon with are not carried on
        rows = dataclasses.replace(rows, place=np.where(far[:, None], 0.0, rows.place))
    rows, ends = _divided(rows, last, dialect)
    axis = _axis(rows, dialect, faults)
    before = np.concatenate([axis[:1] if last is None else last.axis[None], axis[:-1]])
    over = (axis * before).sum(axis=1) < OVER
    message = "the tool axis turns over by 180 deg in one move, which way is not said; part the move"
    _note(over, rows, faults, "gcode.axis", "over", message)
    events = tuple(
        dataclasses.replace(event, at=int(ends[event.at - 1]) if event.at else 0) for event in out.events
    )
    done = Last(rows.place[-1], rows.turn[-1], axis[-1])
    return Settled(_path(rows, axis, dialect), events, done)


def _divided(rows: Rows, last: Last | None, dialect: Dialect) -> tuple[Rows, NDArray[np.int64]]:
    """Moves parted so that evenly turning axes of a machine and an evenly turning tool axis are the same,
    and how many parts there are up to the end of each move (N,)."""
    count = len(rows.line)
    if dialect.convention is None:
        return rows, np.arange(1, count + 1)
    before = {
        name: np.concatenate(
            [getattr(rows, name)[:1] if last is None else getattr(last, name)[None], own[:-1]]
        )
        for name, own in (("place", rows.place), ("turn", rows.turn))
    }
    number = pieces(rows.turn - before["turn"], dialect.angle)
    ends = np.cumsum(number)
    if ends[-1] == count:
        return rows, ends
    origin = np.repeat(np.arange(count), number)
    share = ((np.arange(ends[-1]) - np.repeat(ends - number, number) + 1) / number[origin])[:, None]
    fields = {field.name: getattr(rows, field.name)[origin] for field in dataclasses.fields(Rows)}
    for name, start in before.items():
        end = fields[name]
        fields[name] = np.where(share == 1.0, end, start[origin] + share * (end - start[origin]))
    return Rows(**fields), ends


def _axis(rows: Rows, dialect: Dialect, faults: Faults) -> FloatArray:
    """Unit vectors (N, 3) from the tip to the spindle, in the file's frame."""
    if dialect.convention is not None:
        return dialect.convention.axis(rows.turn)
    if dialect.turns != "IJK":
        return np.tile([0.0, 0.0, 1.0], (len(rows.line), 1))
    size = np.linalg.norm(rows.turn, axis=1)
    wrong = np.abs(size - 1.0) > LENGTH_TOL
    if wrong.any():
        got = size[int(np.argmax(wrong))]
        message = (
            f"I J K of length {got:.4f}, a tool axis has length 1 within {LENGTH_TOL:g}; correct it, or "
            "state another tool_axis where I J K is none"
        )
        _note(wrong, rows, faults, "gcode.axis", "IJK", message)
    unit = rows.turn / np.maximum(size, 1e-12)[:, None]
    return np.asarray(dialect.to_spindle * unit)


def _path(rows: Rows, axis: FloatArray, dialect: Dialect) -> ToolPath:
    turn, origin = dialect.place[:3, :3], dialect.place[:3, 3]
    kind = tuple(np.array(KINDS, dtype=object)[rows.kind].tolist())
    tip, along = rows.place @ turn.T + origin, axis @ turn.T
    return ToolPath(tip, along, rows.feed, kind, rows.spindle, rows.tool, rows.line)


def _note(wrong: NDArray[np.bool_], rows: Rows, faults: Faults, code: str, word: str, message: str) -> None:
    if wrong.any():
        lines = np.unique(rows.line[wrong])
        faults.add(code, word, int(lines[0]), message, len(lines))
