"""The proof's own interpreter of G-code: the path of the cutter's tip and axis that a file states."""

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
    MILLIMETRE_M,
    REVOLUTION,
    GCodeLines,
    UnreadableError,
    interpret_lines,
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
"""Rotations whose product takes z to the tool axis in the part's frame.

The table is that of docs/gcode.md: ``-C+A`` is Rz(-C) Rx(A).
"""
RADIUS_TOLERANCE_M = 2e-5
"""Allowed difference of the radii at both ends of an arc [m]."""
RADIUS_TOLERANCE_FRACTION = 1e-3
"""Allowed difference of the radii as a fraction of the radius, if that is more."""
POINT_TOLERANCE_M = 1e-9
"""Positions closer than this [m] are one."""
MAX_ARC_PIECE_RAD = math.radians(20.0)
"""Maximum angle of a piece of an arc [rad]."""
MAX_EVEN_ROTATION_RAD = math.radians(1.5)
"""Maximum rotation of a machine's axes [rad] that counts as an even rotation of the tool.

Over it the tool deviates from the shortest rotation by at most its square over 8, 0.005 degrees.
"""
AXIS_LENGTH_TOLERANCE = 0.01
"""Allowed deviation of the length of a tool axis I J K from 1."""
OPPOSITE_COSINE = math.cos(math.radians(179.0))
"""Cosine of the rotation of a tool axis in one move (179 degrees) beyond which its direction is ambiguous."""


@dataclasses.dataclass(frozen=True)
class ProgrammedPath:
    """N positions in the stock frame.

    Attributes:
        tip: Tips (N, 3) [m].
        axis: Unit vectors from tip to spindle (N, 3).
        feed: Speed of the move to each position (N,) [m/s], infinite for rapid moves.
        cuts: Whether the move to each position cuts (N,).
        spindle: Spindle speed (N,) [1/min].
        line: Line of the file (N,).
        pauses: Where the program waits for the operator: line, and number of positions before it.
        waits: Where it waits by itself: duration [s], and number of positions before it.
    """

    tip: FloatArray
    axis: FloatArray
    feed: FloatArray
    cuts: BoolArray
    spindle: FloatArray
    line: IntArray
    pauses: tuple[tuple[int, int], ...]
    waits: tuple[tuple[float, int], ...] = ()


def read_path(stated: ProgramFile, chord: float) -> ProgrammedPath:
    """Return the path that a file states.

    Args:
        stated: The file and what the problem states about it.
        chord: Chord error of pieces of arcs [m].

    Raises:
        UnreadableError: The file is not readable, or incomplete.
    """
    state = interpret_lines(gcode_lines.read_words(stated.path, stated.block_delete), stated)
    if not len(state.line):
        raise UnreadableError(0, "it has no words")
    _refuse_meaningless(state, stated)
    positions = np.stack([_coordinates(state, k, stated) for k in range(3)], axis=1)
    start = np.concatenate([[_start_position(stated)], positions[:-1]])
    rotations = _rotations(state, stated)
    moving = state.has("XYZABCIJKR")
    _refuse_missing_modes(state, moving)
    row = np.flatnonzero(moving & state.uses_tool & np.isfinite(positions).all(axis=1))
    cutting = moving & state.uses_tool & (state.motion != 0.0)
    refuse(cutting & ~np.isfinite(positions).all(axis=1), state.line, "a cut to an unknown position")
    refuse(cutting & ~(np.abs(state.spindle) > 0.0), state.line, "a cut while the spindle is stopped")
    _refuse_unpositioned(state, moving, row)
    if not len(row):
        raise UnreadableError(0, "it has no moves of the tool")
    arc = state.motion[row] >= 2.0
    arcs = _Arcs(state, row[arc], start, positions)
    pieces = np.ones(len(row), dtype=np.int64)
    pieces[arc] = arcs.piece_counts(chord)
    previous_rotations = np.concatenate([rotations[row[:1]], rotations[row[:-1]]])
    if stated.tool_axis == "rotary":
        change = np.abs(rotations[row] - previous_rotations).sum(axis=1)
        pieces = np.maximum(pieces, np.ceil(change / MAX_EVEN_ROTATION_RAD - 1e-9).astype(np.int64))
    length = np.linalg.norm(positions[row] - start[row], axis=1)
    length[arc] = arcs.length
    feed = _move_speeds(state, row, length)
    move_rows = np.repeat(np.arange(len(row)), pieces)
    fraction = (np.arange(len(move_rows)) - np.repeat(np.cumsum(pieces) - pieces, pieces) + 1) / pieces[
        move_rows
    ]
    starts = np.where(np.isfinite(start[row]), start[row], positions[row])
    tips = starts[move_rows] + fraction[:, None] * (positions[row] - starts)[move_rows]
    on_arc = np.flatnonzero(arc[move_rows])
    tips[on_arc] = arcs.interpolate((np.cumsum(arc) - 1)[move_rows[on_arc]], fraction[on_arc])
    last = fraction == 1.0
    tips[last] = positions[row]
    angles = (
        previous_rotations[move_rows] + fraction[:, None] * (rotations[row] - previous_rotations)[move_rows]
    )
    angles[last] = rotations[row]
    axis = _tool_axes(angles, stated, state.line[row[move_rows]])
    frame = Rotation.from_euler("xyz", stated.rpy_deg, degrees=True)
    ends = np.cumsum(pieces)
    pauses, dwells = state.pause & state.uses_tool, np.isfinite(state.dwell) & state.uses_tool

    def counts_before(lines: BoolArray) -> list[int]:
        """How many places come before some lines."""
        moves_before = np.searchsorted(row, np.flatnonzero(lines), side="right")
        counts: list[int] = np.where(moves_before > 0, ends[np.maximum(moves_before, 1) - 1], 0).tolist()
        return counts

    return ProgrammedPath(
        frame.apply(tips) + np.array(stated.xyz_mm) * MILLIMETRE_M,
        frame.apply(axis),
        feed[move_rows],
        (state.motion[row] != 0.0)[move_rows],
        state.spindle[row[move_rows]],
        state.line[row[move_rows]],
        tuple(zip(state.line[pauses].tolist(), counts_before(pauses), strict=True)),
        tuple(zip(state.dwell[dwells].tolist(), counts_before(dwells), strict=True)),
    )


def _start_position(stated: ProgramFile) -> FloatArray:
    start = (np.nan,) * 3 if stated.start_mm is None else stated.start_mm
    return np.asarray(np.array(start) * MILLIMETRE_M)


def _refuse_meaningless(state: GCodeLines, stated: ProgramFile) -> None:
    """Refuse words that have no meaning with what the problem states."""
    straight = state.motion < 2.0
    if stated.tool_axis != "ijk":
        refuse(
            state.has("IJK") & straight, state.line, "I J K with a straight move, but no tool axis is stated"
        )
    letters = MACHINES[stated.convention or ""].translate({43: None, 45: None}) if stated.convention else ""
    for letter in "ABC":
        if letter not in letters:
            refuse(state.has(letter), state.line, f"{letter} is not an axis that the problem states")
    refuse(state.has("R") & straight, state.line, "R with a straight move")
    refuse(state.has("ELQ"), state.line, "a word that has no meaning here")


def _refuse_missing_modes(state: GCodeLines, moving: BoolArray) -> None:
    refuse(moving & np.isnan(state.motion), state.line, "a move without G0, G1, G2 or G3")
    refuse(moving & np.isnan(state.absolute), state.line, "neither G90 nor G91")
    refuse(state.has("XYZR") & np.isnan(state.unit), state.line, "neither G20 nor G21")
    refuse(moving & (state.motion >= 2.0) & np.isnan(state.normal), state.line, "an arc without a plane")
    refuse(
        state.has("F") & (np.nan_to_num(state.word["F"]) <= 0.0), state.line, "a feed that is not positive"
    )


def _coordinates(state: GCodeLines, k: int, stated: ProgramFile) -> FloatArray:
    """Return the position (L,) [m] along an axis after each line.

    It is the last one given, plus all changes since.
    """
    given = state.word["XYZ"[k]] * state.unit
    change = np.where((state.absolute == 0.0) & np.isfinite(given), given, 0.0)
    total = np.cumsum(change)
    fixed = np.where(state.absolute == 1.0, given + state.shift[:, k] - total, np.nan)
    return np.asarray(modal_values(fixed, float(_start_position(stated)[k])) + total)


def _rotations(state: GCodeLines, stated: ProgramFile) -> FloatArray:
    """Return I J K, or the angles A B C [rad], (L, 3) after each line."""
    out = np.zeros((len(state.line), 3))
    if stated.tool_axis == "ijk":
        straight = state.motion < 2.0
        upright = 1.0 if stated.ijk_to == "spindle" else -1.0
        for k, letter in enumerate("IJK"):
            out[:, k] = modal_values(
                np.where(straight, state.word[letter], np.nan), upright if k == 2 else 0.0
            )
    elif stated.tool_axis == "rotary":
        for k, letter in enumerate("ABC"):
            given = np.deg2rad(state.word[letter])
            total = np.cumsum(np.where((state.absolute == 0.0) & np.isfinite(given), given, 0.0))
            out[:, k] = modal_values(np.where(state.absolute == 1.0, given - total, np.nan), 0.0) + total
    return out


def _tool_axes(angles: FloatArray, stated: ProgramFile, line: IntArray) -> FloatArray:
    """Return tool axes (N, 3) in the file's frame."""
    if stated.tool_axis == "ijk":
        size = np.linalg.norm(angles, axis=1)
        refuse(np.abs(size - 1.0) > AXIS_LENGTH_TOLERANCE, line, "a tool axis I J K whose length is not 1")
        axis = angles / size[:, None] * (1.0 if stated.ijk_to == "spindle" else -1.0)
    else:
        axis = np.tile([0.0, 0.0, 1.0], (len(angles), 1))
        chain = MACHINES[stated.convention] if stated.convention else ""
        for at in range(len(chain) - 2, -1, -2):
            sign, letter = chain[at], chain[at + 1]
            is_negative = (sign == "-") != (letter in stated.reverse)
            about = "ABC".index(letter)
            rotation = np.zeros((len(angles), 3))
            rotation[:, about] = -angles[:, about] if is_negative else angles[:, about]
            axis = Rotation.from_rotvec(rotation).apply(axis)
    is_ambiguous = np.concatenate([[False], (axis[1:] * axis[:-1]).sum(axis=1) < OPPOSITE_COSINE])
    refuse(is_ambiguous, line, "the tool axis rotates by 180 deg in one move")
    return np.asarray(axis)


def _refuse_unpositioned(state: GCodeLines, moving: BoolArray, row: IntArray) -> None:
    """Refuse cuts of a tool that no rapid move has positioned since another one was in the spindle."""
    led_state = np.full(len(state.line), np.nan)
    led_state[moving & ~state.uses_tool] = 1.0
    led_state[row[state.motion[row] == 0.0]] = 0.0
    is_unpositioned = modal_values(led_state, 0.0) == 1.0
    cutting = np.zeros(len(is_unpositioned), dtype=bool)
    cutting[row[state.motion[row] != 0.0]] = True
    refuse(is_unpositioned & cutting, state.line, "a cut from the position of another tool")


def _move_speeds(state: GCodeLines, row: IntArray, length: FloatArray) -> FloatArray:
    """Return speeds (R,) [m/s] of the moves of some lines, ``length`` (R,) [m] long."""
    mode, feed = state.feed_mode[row], state.feed[row]
    per_turn = np.where(mode == REVOLUTION, np.abs(state.spindle[row]), 1.0)
    out = feed * np.where(mode == INVERSE, length, per_turn) / 60.0
    out = np.where(state.motion[row] == 0.0, np.inf, out)
    first = (mode == INVERSE) & np.isnan(length)
    refuse(~((out > 0.0) | first), state.line[row], "a cut without a feed")
    return np.where(first, np.inf, out)


class _Arcs:
    """M arcs on the lines ``row``, from ``start`` to ``end`` (L, 3) [m] of their lines."""

    def __init__(self, state: GCodeLines, row: IntArray, start: FloatArray, end: FloatArray) -> None:
        line = state.line[row]
        each = np.arange(len(row))
        normal = state.normal[row].astype(np.int64)
        plane = np.stack([(normal + 1) % 3, (normal + 2) % 3], axis=1)
        self._plane, self._normal = plane, normal
        self._start, self._end = start[row], end[row]
        refuse(~np.asarray(np.isfinite(self._start).all(axis=1)), line, "an arc from an unknown position")
        a, b = self._start[each[:, None], plane], self._end[each[:, None], plane]
        given = np.stack([state.word[letter][row] for letter in "IJK"], axis=1)
        refuse(np.isfinite(given[each, normal]), line, "the centre of an arc outside its plane")
        centre = given[each[:, None], plane]
        radius = state.word["R"][row] * state.unit[row]
        by_radius, by_centre = np.isfinite(radius), np.isfinite(centre).any(axis=1)
        refuse(~np.logical_xor(by_radius, by_centre), line, "an arc needs either a centre or a radius")
        is_absolute = state.absolute_centre[row] == 1.0
        refuse(by_centre & is_absolute & np.isnan(centre).any(axis=1), line, "half of an absolute centre")
        base = np.where(is_absolute[:, None], state.shift[row][each[:, None], plane], a)
        self._centre = base + np.nan_to_num(centre) * state.unit[row][:, None]
        clockwise = state.motion[row] == 2.0
        radius_rows = np.flatnonzero(by_radius)
        if len(radius_rows):
            self._centre[radius_rows] = _radius_centres(
                a[radius_rows], b[radius_rows], radius[radius_rows], clockwise[radius_rows], line[radius_rows]
            )
        first, last = a - self._centre, b - self._centre
        self._first, self._last = np.hypot(*first.T), np.hypot(*last.T)
        allowed = np.maximum(RADIUS_TOLERANCE_M, RADIUS_TOLERANCE_FRACTION * self._first)
        refuse(np.abs(self._first - self._last) > allowed, line, "an arc whose radii at both ends differ")
        refuse(np.minimum(self._first, self._last) <= POINT_TOLERANCE_M, line, "an arc about one of its ends")
        self._angle = np.arctan2(first[:, 1], first[:, 0])
        sweep = np.arctan2(last[:, 1], last[:, 0]) - self._angle
        sweep = np.where(clockwise, -sweep, sweep) % (2.0 * np.pi)
        sweep[np.hypot(*(b - a).T) <= POINT_TOLERANCE_M] = 2.0 * np.pi
        self._sweep = np.where(clockwise, -sweep, sweep)
        rise = self._end[each, normal] - self._start[each, normal]
        self.length = np.hypot(self._first * self._sweep, rise)

    def piece_counts(self, chord: float) -> IntArray:
        """Return the number of pieces (M,) that keep the chord error [m]."""
        size = np.maximum(self._first, self._last)
        step = 2.0 * np.arccos(
            np.maximum(1.0 - chord / np.maximum(size, POINT_TOLERANCE_M), math.cos(0.5 * MAX_ARC_PIECE_RAD))
        )
        return np.asarray(np.maximum(np.ceil(np.abs(self._sweep) / step - 1e-9), 1.0), dtype=np.int64)

    def interpolate(self, arcs: IntArray, fraction: FloatArray) -> FloatArray:
        """Return points (N, 3) [m] at a fraction of some arcs.

        Radius and height change linearly with the angle.
        """
        angle = self._angle[arcs] + fraction * self._sweep[arcs]
        radius = self._first[arcs] + fraction * (self._last - self._first)[arcs]
        out = self._start[arcs] + fraction[:, None] * (self._end - self._start)[arcs]
        each = np.arange(len(arcs))[:, None]
        around = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        out[each, self._plane[arcs]] = self._centre[arcs] + around
        return out


def _radius_centres(
    a: FloatArray, b: FloatArray, radius: FloatArray, clockwise: BoolArray, line: IntArray
) -> FloatArray:
    """Return centres (M, 2) of arcs by radius.

    Two centres are at that distance from both ends. The one on the right of the chord is that of a clockwise
    arc of at most half a revolution. The other one is used for R below zero, an arc of at least half a
    revolution.
    """
    chord = b - a
    half = 0.5 * np.hypot(*chord.T)
    refuse(half <= 0.5 * POINT_TOLERANCE_M, line, "an arc by R with coincident ends")
    size = np.abs(radius)
    refuse(
        2.0 * (half - size) > np.maximum(RADIUS_TOLERANCE_M, RADIUS_TOLERANCE_FRACTION * size),
        line,
        "an arc whose R is too small",
    )
    distance = np.sqrt(np.maximum(size**2 - half**2, 0.0))
    left = np.stack([-chord[:, 1], chord[:, 0]], axis=1) / (2.0 * half)[:, None]
    side = np.where(clockwise, -1.0, 1.0) * np.sign(radius)
    return np.asarray(0.5 * (a + b) + (side * distance)[:, None] * left)
