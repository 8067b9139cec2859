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
"""Rotations of each machine whose product rotates z to the tool axis in the part's frame.

They are as in the table of docs/gcode.md: ``-C+A`` is Rz(-C) Rx(A).
"""
RADIUS_TOLERANCE_M = 2e-5
"""Allowed difference of the radii at both ends of an arc [m]."""
RADIUS_TOLERANCE_FRACTION = 1e-3
"""Allowed difference of the radii as a fraction of the radius, if that is more than
:data:`RADIUS_TOLERANCE_M`.
"""
POINT_TOLERANCE_M = 1e-9
"""Distance [m] up to which positions count as equal."""
MAX_ARC_PIECE_RAD = math.radians(20.0)
"""Maximum angle of a piece of an arc [rad]."""
MAX_EVEN_ROTATION_RAD = math.radians(1.5)
"""Maximum rotation of a machine's axes [rad] in a move that counts as an even rotation of the tool.

For a rotation a the tool deviates from the shortest rotation by at most a^2 / 8, here 0.005 degrees.
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
        pauses: Waits for the operator: line, and number of positions before the wait.
        waits: Waits for a time: duration [s], and number of positions before the wait.
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
    """Return the path that a file states for the tool that is used, in the stock frame.

    Arcs and rotations are divided into pieces.

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
    # Lines with a move of the tool to a known position.
    move_lines = np.flatnonzero(moving & state.uses_tool & np.isfinite(positions).all(axis=1))
    cutting = moving & state.uses_tool & (state.motion != 0.0)
    refuse(cutting & ~np.isfinite(positions).all(axis=1), state.line, "a cut to an unknown position")
    refuse(cutting & ~(np.abs(state.spindle) > 0.0), state.line, "a cut while the spindle is stopped")
    _refuse_unpositioned(state, moving, move_lines)
    if not len(move_lines):
        raise UnreadableError(0, "it has no moves of the tool")
    is_arc = state.motion[move_lines] >= 2.0
    arcs = _Arcs(state, move_lines[is_arc], start, positions)
    pieces = np.ones(len(move_lines), dtype=np.int64)
    pieces[is_arc] = arcs.piece_counts(chord)
    previous_rotations = np.concatenate([rotations[move_lines[:1]], rotations[move_lines[:-1]]])
    if stated.tool_axis == "rotary":
        change = np.abs(rotations[move_lines] - previous_rotations).sum(axis=1)
        pieces = np.maximum(pieces, np.ceil(change / MAX_EVEN_ROTATION_RAD - 1e-9).astype(np.int64))
    length = np.linalg.norm(positions[move_lines] - start[move_lines], axis=1)
    length[is_arc] = arcs.length
    feed = _move_speeds(state, move_lines, length)
    # piece_moves: index of the move of each piece; fraction: position of the piece's end on its move
    piece_moves = np.repeat(np.arange(len(move_lines)), pieces)
    fraction = (np.arange(len(piece_moves)) - np.repeat(np.cumsum(pieces) - pieces, pieces) + 1) / pieces[
        piece_moves
    ]
    starts = np.where(np.isfinite(start[move_lines]), start[move_lines], positions[move_lines])
    tips = starts[piece_moves] + fraction[:, None] * (positions[move_lines] - starts)[piece_moves]
    on_arc = np.flatnonzero(is_arc[piece_moves])
    # the running count of arcs converts indices of moves to indices of arcs
    tips[on_arc] = arcs.interpolate((np.cumsum(is_arc) - 1)[piece_moves[on_arc]], fraction[on_arc])
    is_move_end = fraction == 1.0
    tips[is_move_end] = positions[move_lines]
    angles = (
        previous_rotations[piece_moves]
        + fraction[:, None] * (rotations[move_lines] - previous_rotations)[piece_moves]
    )
    angles[is_move_end] = rotations[move_lines]
    axis = _tool_axes(angles, stated, state.line[move_lines[piece_moves]])
    frame = Rotation.from_euler("xyz", stated.rpy_deg, degrees=True)
    ends = np.cumsum(pieces)
    pauses, dwells = state.pause & state.uses_tool, np.isfinite(state.dwell) & state.uses_tool

    def counts_before(lines: BoolArray) -> list[int]:
        """Return the number of positions of the path that come before each of the flagged lines (L,)."""
        moves_before = np.searchsorted(move_lines, np.flatnonzero(lines), side="right")
        counts: list[int] = np.where(moves_before > 0, ends[np.maximum(moves_before, 1) - 1], 0).tolist()
        return counts

    return ProgrammedPath(
        frame.apply(tips) + np.array(stated.xyz_mm) * MILLIMETRE_M,
        frame.apply(axis),
        feed[piece_moves],
        (state.motion[move_lines] != 0.0)[piece_moves],
        state.spindle[move_lines[piece_moves]],
        state.line[move_lines[piece_moves]],
        tuple(zip(state.line[pauses].tolist(), counts_before(pauses), strict=True)),
        tuple(zip(state.dwell[dwells].tolist(), counts_before(dwells), strict=True)),
    )


def _start_position(stated: ProgramFile) -> FloatArray:
    """Return the position (3,) [m] before the first line, NaN if the problem does not state it."""
    start = (np.nan,) * 3 if stated.start_mm is None else stated.start_mm
    return np.asarray(np.array(start) * MILLIMETRE_M)


def _refuse_meaningless(state: GCodeLines, stated: ProgramFile) -> None:
    """Refuse words that have no meaning for the machine and the tool axis that the problem states."""
    straight = state.motion < 2.0
    if stated.tool_axis != "ijk":
        refuse(
            state.has("IJK") & straight, state.line, "I J K with a straight move, but no tool axis is stated"
        )
    # The letters of the machine's axes, without the signs + and -.
    letters = MACHINES[stated.convention or ""].translate({43: None, 45: None}) if stated.convention else ""
    for letter in "ABC":
        if letter not in letters:
            refuse(state.has(letter), state.line, f"{letter} is not an axis that the problem states")
    refuse(state.has("R") & straight, state.line, "R with a straight move")
    refuse(state.has("ELQ"), state.line, "a word that has no meaning here")


def _refuse_missing_modes(state: GCodeLines, moving: BoolArray) -> None:
    """Refuse lines that need a mode or unit that neither the file nor the problem states."""
    refuse(moving & np.isnan(state.motion), state.line, "a move without G0, G1, G2 or G3")
    refuse(moving & np.isnan(state.absolute), state.line, "neither G90 nor G91")
    refuse(state.has("XYZR") & np.isnan(state.unit), state.line, "neither G20 nor G21")
    refuse(moving & (state.motion >= 2.0) & np.isnan(state.normal), state.line, "an arc without a plane")
    refuse(
        state.has("F") & (np.nan_to_num(state.word["F"]) <= 0.0), state.line, "a feed that is not positive"
    )


def _coordinates(state: GCodeLines, k: int, stated: ProgramFile) -> FloatArray:
    """Return the coordinate (L,) [m] along axis ``k`` after each line.

    It is the last absolute coordinate plus all incremental changes since.
    """
    given = state.word["XYZ"[k]] * state.unit
    change = np.where((state.absolute == 0.0) & np.isfinite(given), given, 0.0)
    total = np.cumsum(change)
    fixed = np.where(state.absolute == 1.0, given + state.shift[:, k] - total, np.nan)
    return np.asarray(modal_values(fixed, float(_start_position(stated)[k])) + total)


def _rotations(state: GCodeLines, stated: ProgramFile) -> FloatArray:
    """Return I J K, or the angles A B C [rad], after each line, (L, 3). They are 0 for a fixed tool axis."""
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
    """Return unit vectors (N, 3) from tip to spindle in the file's frame.

    ``angles`` (N, 3) are those of :func:`_rotations`, ``line`` (N,) the lines of the file.
    """
    if stated.tool_axis == "ijk":
        length = np.linalg.norm(angles, axis=1)
        refuse(np.abs(length - 1.0) > AXIS_LENGTH_TOLERANCE, line, "a tool axis I J K whose length is not 1")
        axis = angles / length[:, None] * (1.0 if stated.ijk_to == "spindle" else -1.0)
    else:
        axis = np.tile([0.0, 0.0, 1.0], (len(angles), 1))
        chain = MACHINES[stated.convention] if stated.convention else ""
        for k in range(len(chain) - 2, -1, -2):
            sign, letter = chain[k], chain[k + 1]
            is_negative = (sign == "-") != (letter in stated.reverse)
            about = "ABC".index(letter)
            rotation = np.zeros((len(angles), 3))
            rotation[:, about] = -angles[:, about] if is_negative else angles[:, about]
            axis = Rotation.from_rotvec(rotation).apply(axis)
    is_ambiguous = np.concatenate([[False], (axis[1:] * axis[:-1]).sum(axis=1) < OPPOSITE_COSINE])
    refuse(is_ambiguous, line, "the tool axis rotates by 180 deg in one move")
    return np.asarray(axis)


def _refuse_unpositioned(state: GCodeLines, moving: BoolArray, row: IntArray) -> None:
    """Refuse cuts of a tool that no rapid move has positioned since another tool was in the spindle.

    ``row`` has the indices of the lines with moves of the tool that is used.
    """
    # 1 from a move of another tool on, 0 from a rapid move of this tool on.
    unpositioned_state = np.full(len(state.line), np.nan)
    unpositioned_state[moving & ~state.uses_tool] = 1.0
    unpositioned_state[row[state.motion[row] == 0.0]] = 0.0
    is_unpositioned = modal_values(unpositioned_state, 0.0) == 1.0
    cutting = np.zeros(len(is_unpositioned), dtype=bool)
    cutting[row[state.motion[row] != 0.0]] = True
    refuse(is_unpositioned & cutting, state.line, "a cut from the position of another tool")


def _move_speeds(state: GCodeLines, row: IntArray, length: FloatArray) -> FloatArray:
    """Return the speeds (R,) [m/s] of the moves on lines ``row`` (R,) with lengths ``length`` (R,) [m].

    They are infinite for rapid moves, and for a move by inverse time from an unknown position, whose length
    is NaN.
    """
    mode, feed = state.feed_mode[row], state.feed[row]
    per_turn = np.where(mode == REVOLUTION, np.abs(state.spindle[row]), 1.0)
    out = feed * np.where(mode == INVERSE, length, per_turn) / 60.0
    out = np.where(state.motion[row] == 0.0, np.inf, out)
    first = (mode == INVERSE) & np.isnan(length)
    refuse(~((out > 0.0) | first), state.line[row], "a cut without a feed")
    return np.where(first, np.inf, out)


class _Arcs:
    """M arcs of a file.

    ``row`` has the indices of their lines, ``start`` and ``end`` the positions (L, 3) [m] before and after
    each line of the file.
    """

    def __init__(self, state: GCodeLines, row: IntArray, start: FloatArray, end: FloatArray) -> None:
        line = state.line[row]
        indices = np.arange(len(row))
        normal = state.normal[row].astype(np.int64)
        plane = np.stack([(normal + 1) % 3, (normal + 2) % 3], axis=1)
        self._plane, self._normal = plane, normal
        self._start, self._end = start[row], end[row]
        refuse(~np.asarray(np.isfinite(self._start).all(axis=1)), line, "an arc from an unknown position")
        a, b = self._start[indices[:, None], plane], self._end[indices[:, None], plane]
        given = np.stack([state.word[letter][row] for letter in "IJK"], axis=1)
        refuse(np.isfinite(given[indices, normal]), line, "the centre of an arc outside its plane")
        centre = given[indices[:, None], plane]
        radius = state.word["R"][row] * state.unit[row]
        by_radius, by_centre = np.isfinite(radius), np.isfinite(centre).any(axis=1)
        refuse(~np.logical_xor(by_radius, by_centre), line, "an arc needs either a centre or a radius")
        is_absolute = state.absolute_centre[row] == 1.0
        refuse(by_centre & is_absolute & np.isnan(centre).any(axis=1), line, "half of an absolute centre")
        base = np.where(is_absolute[:, None], state.shift[row][indices[:, None], plane], a)
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
        rise = self._end[indices, normal] - self._start[indices, normal]
        self.length = np.hypot(self._first * self._sweep, rise)

    def piece_counts(self, chord: float) -> IntArray:
        """Return the number of pieces (M,) that keep the chord error [m]."""
        size = np.maximum(self._first, self._last)
        step = 2.0 * np.arccos(
            np.maximum(1.0 - chord / np.maximum(size, POINT_TOLERANCE_M), math.cos(0.5 * MAX_ARC_PIECE_RAD))
        )
        return np.asarray(np.maximum(np.ceil(np.abs(self._sweep) / step - 1e-9), 1.0), dtype=np.int64)

    def interpolate(self, arcs: IntArray, fraction: FloatArray) -> FloatArray:
        """Return points (N, 3) [m] at fractions of arcs ``arcs`` (N,).

        Radius and the coordinate normal to the plane change linearly with the angle.
        """
        angle = self._angle[arcs] + fraction * self._sweep[arcs]
        radius = self._first[arcs] + fraction * (self._last - self._first)[arcs]
        out = self._start[arcs] + fraction[:, None] * (self._end - self._start)[arcs]
        indices = np.arange(len(arcs))[:, None]
        offset = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        out[indices, self._plane[arcs]] = self._centre[arcs] + offset
        return out


def _radius_centres(
    a: FloatArray, b: FloatArray, radius: FloatArray, clockwise: BoolArray, line: IntArray
) -> FloatArray:
    """Return the centres (M, 2) [m] of arcs from ``a`` to ``b`` (M, 2) in their planes, by the values of R.

    Two centres have this distance from both ends. The one on the right of the chord is that of a clockwise
    arc of at most half a revolution. For a negative R, an arc of at least half a revolution, it is the other
    one.
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
