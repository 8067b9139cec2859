"""The proof's own interpreter of G-code: the way of the cutter's tip and axis that a file states."""

import dataclasses
import math
from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.processes.milling.claims import ProgramFile
from planner.processes.milling.proof import gcode_lines
from planner.processes.milling.proof.gcode_lines import (
    INVERSE,
    MILLIMETRE,
    TURN,
    Lines,
    UnreadableError,
    lines,
    modal_values,
    refuse,
)

MACHINES: Mapping[str, str] = {
    "head_a": "+A",
    "head_b": "+B",
    "head_ca": "+C+A",
    "head_cb": "+C+B",
    "head_ab": "+A+B",
    "head_ba": "+B+A",
    "table_a": "-A",
    "table_b": "-B",
    "table_ac": "-C-A",
    "table_bc": "-C-B",
    "head_a_table_c": "-C+A",
    "head_b_table_c": "-C+B",
}
"""Rotations whose product turns z to the tool axis, in the part's frame, as the table in docs/gcode.md has
them: ``-C+A`` is Rz(-C) Rx(A)."""
RADIUS_TOLERANCE = 2e-5
"""How far [m] the radii at both ends of an arc may differ."""
RADIUS_SHARE = 1e-3
"""The same as a share of the radius, where that is more."""
SAME_PLACE = 1e-9
"""Places nearer to one another than this [m] are one."""
WIDEST_ARC_PIECE = math.radians(20.0)
"""Longest piece [rad] of an arc."""
EVEN_TURN = math.radians(1.5)
"""Longest turn [rad] of a machine's axes that counts as an even turn of the tool: over it the tool is off
the shortest turn by its square over 8 at most, 0.005 degrees."""
AXIS_LENGTH_ERROR = 0.01
"""How far a tool axis I J K may be off length 1."""
OPPOSITE_COSINE = math.cos(math.radians(179.0))
"""Cosine of the turn (179 degrees) of a tool axis in one move beyond which its way is not known."""


@dataclasses.dataclass(frozen=True)
class Way:
    """N places, in the stock's frame: ``tip`` (N, 3) [m], ``axis`` (N, 3) from tip to spindle; of the move to
    each the ``feed`` (N,) [m/s], infinite for rapid ones, whether it ``cuts`` (N,), the ``spindle`` (N,)
    [1/min] and the ``line`` (N,). ``pauses``: (line, places before it) where the program waits for somebody;
    ``waits``: ([s], places before it) where it does by itself."""

    tip: FloatArray
    axis: FloatArray
    feed: FloatArray
    cuts: BoolArray
    spindle: FloatArray
    line: IntArray
    pauses: tuple[tuple[int, int], ...]
    waits: tuple[tuple[float, int], ...] = ()


def read(stated: ProgramFile, chord: float) -> Way:
    """The way that a file states; its arcs in pieces within ``chord`` [m]. Raises ``UnreadableError``."""
    own = lines(gcode_lines.read(stated.path, stated.block_delete), stated)
    if not len(own.line):
        raise UnreadableError(0, "it has no words")
    _meant(own, stated)
    place = np.stack([_coordinate(own, k, stated) for k in range(3)], axis=1)
    start = np.concatenate([[_start(stated)], place[:-1]])
    turn = _turns(own, stated)
    moving = own.has("XYZABCIJKR")
    _modes(own, moving)
    row = np.flatnonzero(moving & own.wanted & np.isfinite(place).all(axis=1))
    cutting = moving & own.wanted & (own.motion != 0.0)
    refuse(cutting & ~np.isfinite(place).all(axis=1), own.line, "a cut to a place that is not known")
    refuse(cutting & ~(np.abs(own.spindle) > 0.0), own.line, "a cut while the spindle stands")
    _led(own, moving, row)
    if not len(row):
        raise UnreadableError(0, "it has no moves of the tool")
    arc = own.motion[row] >= 2.0
    arcs = _Arcs(own, row[arc], start, place)
    pieces = np.ones(len(row), dtype=np.int64)
    pieces[arc] = arcs.pieces(chord)
    turned = np.concatenate([turn[row[:1]], turn[row[:-1]]])
    if stated.tool_axis == "rotary":
        change = np.abs(turn[row] - turned).sum(axis=1)
        pieces = np.maximum(pieces, np.ceil(change / EVEN_TURN - 1e-9).astype(np.int64))
    length = np.linalg.norm(place[row] - start[row], axis=1)
    length[arc] = arcs.length
    feed = _feeds(own, row, length)
    to = np.repeat(np.arange(len(row)), pieces)
    share = (np.arange(len(to)) - np.repeat(np.cumsum(pieces) - pieces, pieces) + 1) / pieces[to]
    begin = np.where(np.isfinite(start[row]), start[row], place[row])
    tips = begin[to] + share[:, None] * (place[row] - begin)[to]
    bent = np.flatnonzero(arc[to])
    tips[bent] = arcs.at((np.cumsum(arc) - 1)[to[bent]], share[bent])
    last = share == 1.0
    tips[last] = place[row]
    angles = turned[to] + share[:, None] * (turn[row] - turned)[to]
    angles[last] = turn[row]
    axis = _axes(angles, stated, own.line[row[to]])
    frame = Rotation.from_euler("xyz", stated.rpy_deg, degrees=True)
    ends = np.cumsum(pieces)
    pauses, dwells = own.pause & own.wanted, np.isfinite(own.dwell) & own.wanted

    def places(lines: BoolArray) -> list[int]:
        """How many places come before some lines."""
        before = np.searchsorted(row, np.flatnonzero(lines), side="right")
        counts: list[int] = np.where(before > 0, ends[np.maximum(before, 1) - 1], 0).tolist()
        return counts

    return Way(
        frame.apply(tips) + np.array(stated.xyz_mm) * MILLIMETRE,
        frame.apply(axis),
        feed[to],
        (own.motion[row] != 0.0)[to],
        own.spindle[row[to]],
        own.line[row[to]],
        tuple(zip(own.line[pauses].tolist(), places(pauses), strict=True)),
        tuple(zip(own.dwell[dwells].tolist(), places(dwells), strict=True)),
    )


def _start(stated: ProgramFile) -> FloatArray:
    start = (np.nan,) * 3 if stated.start_mm is None else stated.start_mm
    return np.asarray(np.array(start) * MILLIMETRE)


def _meant(own: Lines, stated: ProgramFile) -> None:
    """Words that mean nothing with what the problem states."""
    straight = own.motion < 2.0
    if stated.tool_axis != "ijk":
        refuse(
            own.has("IJK") & straight, own.line, "I J K with a straight move, where no tool axis is stated"
        )
    letters = MACHINES[stated.convention or ""].translate({43: None, 45: None}) if stated.convention else ""
    for letter in "ABC":
        if letter not in letters:
            refuse(own.has(letter), own.line, f"{letter} turns nothing that the problem states")
    refuse(own.has("R") & straight, own.line, "R with a straight move")
    refuse(own.has("ELQ"), own.line, "a word that means nothing here")


def _modes(own: Lines, moving: BoolArray) -> None:
    refuse(moving & np.isnan(own.motion), own.line, "a move without G0, G1, G2 or G3")
    refuse(moving & np.isnan(own.absolute), own.line, "neither G90 nor G91")
    refuse(own.has("XYZR") & np.isnan(own.unit), own.line, "neither G20 nor G21")
    refuse(moving & (own.motion >= 2.0) & np.isnan(own.normal), own.line, "an arc in no plane")
    refuse(own.has("F") & (np.nan_to_num(own.word["F"]) <= 0.0), own.line, "a feed that is not above zero")


def _coordinate(own: Lines, k: int, stated: ProgramFile) -> FloatArray:
    """The place (L,) [m] along an axis behind each line: the last one given, and all changes since."""
    given = own.word["XYZ"[k]] * own.unit
    change = np.where((own.absolute == 0.0) & np.isfinite(given), given, 0.0)
    total = np.cumsum(change)
    fixed = np.where(own.absolute == 1.0, given + own.shift[:, k] - total, np.nan)
    return np.asarray(modal_values(fixed, float(_start(stated)[k])) + total)


def _turns(own: Lines, stated: ProgramFile) -> FloatArray:
    """I J K, or the angles A B C [rad], (L, 3) behind each line."""
    out = np.zeros((len(own.line), 3))
    if stated.tool_axis == "ijk":
        straight = own.motion < 2.0
        upright = 1.0 if stated.ijk_to == "spindle" else -1.0
        for k, letter in enumerate("IJK"):
            out[:, k] = modal_values(np.where(straight, own.word[letter], np.nan), upright if k == 2 else 0.0)
    elif stated.tool_axis == "rotary":
        for k, letter in enumerate("ABC"):
            given = np.deg2rad(own.word[letter])
            total = np.cumsum(np.where((own.absolute == 0.0) & np.isfinite(given), given, 0.0))
            out[:, k] = modal_values(np.where(own.absolute == 1.0, given - total, np.nan), 0.0) + total
    return out


def _axes(angles: FloatArray, stated: ProgramFile, line: IntArray) -> FloatArray:
    """Tool axes (N, 3) in the file's frame."""
    if stated.tool_axis == "ijk":
        size = np.linalg.norm(angles, axis=1)
        refuse(np.abs(size - 1.0) > AXIS_LENGTH_ERROR, line, "a tool axis I J K whose length is not 1")
        axis = angles / size[:, None] * (1.0 if stated.ijk_to == "spindle" else -1.0)
    else:
        axis = np.tile([0.0, 0.0, 1.0], (len(angles), 1))
        chain = MACHINES[stated.convention] if stated.convention else ""
        for at in range(len(chain) - 2, -1, -2):
            sign, letter = chain[at], chain[at + 1]
            back = (sign == "-") != (letter in stated.reverse)
            about = "ABC".index(letter)
            turn = np.zeros((len(angles), 3))
            turn[:, about] = -angles[:, about] if back else angles[:, about]
            axis = Rotation.from_rotvec(turn).apply(axis)
    over = np.concatenate([[False], (axis[1:] * axis[:-1]).sum(axis=1) < OPPOSITE_COSINE])
    refuse(over, line, "the tool axis turns over")
    return np.asarray(axis)


def _led(own: Lines, moving: BoolArray, row: IntArray) -> None:
    """A tool cuts only where a rapid move has led it since another one was in the spindle."""
    state = np.full(len(own.line), np.nan)
    state[moving & ~own.wanted] = 1.0
    state[row[own.motion[row] == 0.0]] = 0.0
    lost = modal_values(state, 0.0) == 1.0
    cutting = np.zeros(len(lost), dtype=bool)
    cutting[row[own.motion[row] != 0.0]] = True
    refuse(lost & cutting, own.line, "a cut from where another tool was")


def _feeds(own: Lines, row: IntArray, length: FloatArray) -> FloatArray:
    """Speeds (R,) [m/s] of the moves of some lines, ``length`` (R,) [m] long."""
    mode, feed = own.feed_mode[row], own.feed[row]
    per_turn = np.where(mode == TURN, np.abs(own.spindle[row]), 1.0)
    out = feed * np.where(mode == INVERSE, length, per_turn) / 60.0
    out = np.where(own.motion[row] == 0.0, np.inf, out)
    first = (mode == INVERSE) & np.isnan(length)
    refuse(~((out > 0.0) | first), own.line[row], "a cut without a feed")
    return np.where(first, np.inf, out)


class _Arcs:
    """M arcs on the lines ``row``, from ``start`` to ``end`` (L, 3) [m] of their lines."""

    def __init__(self, own: Lines, row: IntArray, start: FloatArray, end: FloatArray) -> None:
        line = own.line[row]
        each = np.arange(len(row))
        normal = own.normal[row].astype(np.int64)
        plane = np.stack([(normal + 1) % 3, (normal + 2) % 3], axis=1)
        self._plane, self._normal = plane, normal
        self._start, self._end = start[row], end[row]
        refuse(
            ~np.asarray(np.isfinite(self._start).all(axis=1)), line, "an arc from a place that is not known"
        )
        a, b = self._start[each[:, None], plane], self._end[each[:, None], plane]
        given = np.stack([own.word[letter][row] for letter in "IJK"], axis=1)
        refuse(np.isfinite(given[each, normal]), line, "the centre of an arc beside its plane")
        centre = given[each[:, None], plane]
        radius = own.word["R"][row] * own.unit[row]
        by_radius, by_centre = np.isfinite(radius), np.isfinite(centre).any(axis=1)
        refuse(~np.logical_xor(by_radius, by_centre), line, "an arc needs either a centre or a radius")
        whole = own.absolute_centre[row] == 1.0
        refuse(by_centre & whole & np.isnan(centre).any(axis=1), line, "half of an absolute centre")
        base = np.where(whole[:, None], own.shift[row][each[:, None], plane], a)
        self._centre = base + np.nan_to_num(centre) * own.unit[row][:, None]
        clockwise = own.motion[row] == 2.0
        some = np.flatnonzero(by_radius)
        if len(some):
            self._centre[some] = _centres(a[some], b[some], radius[some], clockwise[some], line[some])
        first, last = a - self._centre, b - self._centre
        self._first, self._last = np.hypot(*first.T), np.hypot(*last.T)
        allowed = np.maximum(RADIUS_TOLERANCE, RADIUS_SHARE * self._first)
        refuse(np.abs(self._first - self._last) > allowed, line, "an arc whose radii at both ends differ")
        refuse(np.minimum(self._first, self._last) <= SAME_PLACE, line, "an arc about one of its ends")
        self._angle = np.arctan2(first[:, 1], first[:, 0])
        turn = np.arctan2(last[:, 1], last[:, 0]) - self._angle
        turn = np.where(clockwise, -turn, turn) % (2.0 * np.pi)
        turn[np.hypot(*(b - a).T) <= SAME_PLACE] = 2.0 * np.pi
        self._sweep = np.where(clockwise, -turn, turn)
        rise = self._end[each, normal] - self._start[each, normal]
        self.length = np.hypot(self._first * self._sweep, rise)

    def pieces(self, chord: float) -> IntArray:
        """How many pieces (M,) keep within ``chord`` [m]."""
        size = np.maximum(self._first, self._last)
        step = 2.0 * np.arccos(
            np.maximum(1.0 - chord / np.maximum(size, SAME_PLACE), math.cos(0.5 * WIDEST_ARC_PIECE))
        )
        return np.asarray(np.maximum(np.ceil(np.abs(self._sweep) / step - 1e-9), 1.0), dtype=np.int64)

    def at(self, which: IntArray, share: FloatArray) -> FloatArray:
        """Places (N, 3) [m] at a share of some arcs; radius and rise grow evenly with the angle."""
        angle = self._angle[which] + share * self._sweep[which]
        radius = self._first[which] + share * (self._last - self._first)[which]
        out = self._start[which] + share[:, None] * (self._end - self._start)[which]
        each = np.arange(len(which))[:, None]
        around = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        out[each, self._plane[which]] = self._centre[which] + around
        return out


def _centres(
    a: FloatArray, b: FloatArray, radius: FloatArray, clockwise: BoolArray, line: IntArray
) -> FloatArray:
    """Centres (M, 2) of arcs by their radii: of the two at that distance from both ends the one on the right
    of the chord for a clockwise arc of at most half a turn, the other for R below zero, of at least half."""
    chord = b - a
    half = 0.5 * np.hypot(*chord.T)
    refuse(half <= 0.5 * SAME_PLACE, line, "an arc by R whose ends are in one place")
    size = np.abs(radius)
    refuse(
        2.0 * (half - size) > np.maximum(RADIUS_TOLERANCE, RADIUS_SHARE * size),
        line,
        "an arc whose R is too small",
    )
    away = np.sqrt(np.maximum(size**2 - half**2, 0.0))
    left = np.stack([-chord[:, 1], chord[:, 0]], axis=1) / (2.0 * half)[:, None]
    side = np.where(clockwise, -1.0, 1.0) * np.sign(radius)
    return np.asarray(0.5 * (a + b) + (side * away)[:, None] * left)
