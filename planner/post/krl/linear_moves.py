"""KRL's straight moves of whole tracks at once: poses, speeds, corners, and their text.

KRL states no times: a move's speeds are those that its planned time asks for, rounded down.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.geometry.corner_rounding import FINE_ZONES
from planner.geometry.rigid import from_quaternion
from planner.post.krl.syntax import ANGLE_DECIMALS, abc, rotation
from planner.post.program import POSITION_DECIMALS, Track, short
from planner.problem import KrlDialect

LED_BY_WAY_MM: Final = 0.01
"""Least way [mm] of a move whose speed along it sets the time."""
LEAST_SPEED: Final = 1e-4
"""Least $VEL.CP [m/s]."""
LEAST_MOVE_TIME: Final = 6e-3
"""No controller plans a move in less [s]."""
LEAST_TURN_RATE: Final = 0.1
"""Least $VEL.ORI [deg/s]."""
FREE_TURN_RATE: Final = 200.0
"""$VEL.ORI [deg/s] of moves whose way sets the time."""
SPEED_DECIMALS: Final = 8
"""Decimals of $VEL.CP in m/s."""
TURN_DECIMALS: Final = 5
"""Decimals of $VEL.ORI1 and $VEL.ORI2 in deg/s."""
APPROXIMATION_DISTANCES: Final = (15.0, 10.0, 7.0, 5.0, 3.0, 2.0, 1.5, 1.0, *FINE_ZONES)
"""$APO.CDIS [mm]."""
APPROXIMATION_ANGLES: Final = (1.0, *FINE_ZONES)
"""$APO.CORI [deg]."""
FREE_ANGLE: Final = 180.0
"""$APO.CORI [deg] of corners that $APO.CDIS alone rounds."""
_MODAL: Final = ("$VEL.CP", "$VEL.ORI1", "$VEL.ORI2", "$APO.CDIS", "$APO.CORI")
"""Variables that each move may set anew, in this order."""


@dataclasses.dataclass(frozen=True)
class Rows:
    """M moves as KRL has them, all as written.

    ``position`` (M, 3) [mm], ``angles`` (M, 3) [deg]; ``way`` (M,) [mm] and ``turn`` (M,) [rad] from the pose
    before; ``duration`` (M,) [s] planned; ``speed`` (M,) [m/s] and ``turning`` (M,) [deg/s] allowed;
    ``distance`` (M,) [mm] and ``angle`` (M,) [deg] of the corners; ``stop``, ``still`` (M,): the move ends in
    an exact stop, goes nowhere.
    """

    position: FloatArray
    angles: FloatArray
    way: FloatArray
    turn: FloatArray
    duration: FloatArray
    speed: FloatArray
    turning: FloatArray
    distance: FloatArray
    angle: FloatArray
    stop: BoolArray
    still: BoolArray


def written(pose: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Positions (..., 3) [mm] and A, B, C (..., 3) [deg] of poses (..., 4, 4) [m], rounded as written."""
    position = np.round(1e3 * pose[..., :3, 3], POSITION_DECIMALS) + 0.0
    return position, np.round(abc(pose[..., :3, :3]), ANGLE_DECIMALS) + 0.0


def rows(track: Track, stop: BoolArray, start: tuple[FloatArray, FloatArray]) -> Rows:
    """The moves of a track; ``start``: position (3,) [mm] and angles (3,) [deg] before them, as written."""
    angles = np.round(abc(from_quaternion(track.quaternion)), ANGLE_DECIMALS) + 0.0
    position, angles = np.concatenate([start[0][None], track.position]), np.vstack([start[1], angles])
    _settle(position, angles)
    way = np.linalg.norm(np.diff(position, axis=0), axis=1)
    turn = _turns(angles)
    still = np.all(np.diff(position, axis=0) == 0.0, axis=1) & (turn == 0.0)
    stop = stop | still | np.append(still[1:], False)
    wanted = 1e-3 * way / track.duration
    led = (way >= LED_BY_WAY_MM) & (wanted >= LEAST_SPEED)
    turning = _down(np.rad2deg(turn) / (np.sqrt(2.0) * track.duration), TURN_DECIMALS)
    distance, angle = _corners(track)
    return Rows(
        position=position[1:],
        angles=angles[1:],
        way=way,
        turn=turn,
        duration=track.duration,
        speed=np.maximum(_down(wanted, SPEED_DECIMALS), LEAST_SPEED),
        turning=np.where(led, FREE_TURN_RATE, np.maximum(turning, LEAST_TURN_RATE)),
        distance=distance,
        angle=angle,
        stop=stop,
        still=still,
    )


def _settle(position: FloatArray, angles: FloatArray) -> None:
    """Places that are no farther from the one before than the least speed goes in the least time of a move
    are that one, and so are poses that are no farther turned, either."""
    # both turning speeds of a path run together, so that a turn may take but 0.7 of what one alone takes
    near, alike = 1e3 * LEAST_SPEED * LEAST_MOVE_TIME, 2.0 * LEAST_TURN_RATE * LEAST_MOVE_TIME
    # the one before may have been put back by as much
    for row in np.flatnonzero(np.abs(np.diff(position, axis=0)).max(axis=1) < 2.0 * near).tolist():
        far, turned = (np.abs(values[row + 1] - values[row]).max() for values in (position, angles))
        if far < near:
            position[row + 1] = position[row]
            angles[row + 1] = angles[row] if turned < alike else angles[row + 1]


@dataclasses.dataclass(frozen=True)
class Lines:
    """The text of M moves: ``move`` without settings, ``settings`` that change before each one, each a line
    with its end, and ``values`` (M, 5) in force then."""

    move: list[str]
    settings: list[str]
    values: FloatArray

    def sizes(self) -> IntArray:
        """Characters (M,) of each move with its settings; ends of lines count twice."""
        pairs = zip(self.settings, self.move, strict=True)
        return np.array(
            [len(a) + a.count("\n") + len(b) + b.count("\n") + 2 for a, b in pairs], dtype=np.int64
        )

    def of(self, row: int, fresh: bool) -> list[str]:
        """The lines of a move; ``fresh``: with all settings, for the first one of a file."""
        head = _settings(self.values[row].tolist()) if fresh else self.settings[row]
        return [*head.splitlines(), *self.move[row].splitlines()]

    def replaced(self, move: list[str], values: FloatArray) -> Lines:
        """With other text for the moves, which may have several lines, and other values in force."""
        return Lines(move, _changes(values), values)


def lines(moves: Rows, dialect: KrlDialect) -> Lines:
    """The text of all moves."""
    word = "SLIN" if dialect == "krc4" else "LIN"
    values = _modal(moves)
    settings = _changes(values)
    poses = zip(moves.position.tolist(), moves.angles.tolist(), _ends(moves, dialect), strict=True)
    move = [
        f"{word} {{X {x:.4f},Y {y:.4f},Z {z:.4f},A {a:.5f},B {b:.5f},C {c:.5f}}}{end}"
        for (x, y, z), (a, b, c), end in poses
    ]
    for row in np.flatnonzero(moves.still).tolist():
        move[row] = f"WAIT SEC {short(float(moves.duration[row]), 5)}"
    return Lines(move, settings, values)


def _changes(values: FloatArray) -> list[str]:
    """The settings that change before each of M moves, given the values (M, 5) in force."""
    changed = np.diff(values, axis=0, prepend=np.nan) != 0.0
    return [
        _settings(row, new) if some else ""
        for row, new, some in zip(
            values.tolist(), changed.tolist(), changed.any(axis=1).tolist(), strict=True
        )
    ]


def _modal(moves: Rows) -> FloatArray:
    """(M, 5) values in force at each move; where nothing moves or nothing is rounded those before stay."""
    table = np.stack([moves.speed, moves.turning, moves.turning, moves.distance, moves.angle], axis=1)
    keep = np.stack([moves.still] * 3 + [moves.stop] * 2, axis=1)
    source = np.where(keep, 0, np.arange(len(table))[:, None])
    latest = np.maximum.accumulate(source, axis=0) if len(table) else source
    return np.take_along_axis(table, latest, axis=0)


def _settings(values: Sequence[float], new: Sequence[bool] = (True,) * len(_MODAL)) -> str:
    """Lines, each with its end, that set those of the values that are new."""
    decimals = (SPEED_DECIMALS, TURN_DECIMALS, TURN_DECIMALS, 3, 3)
    return "".join(
        f"{word}={_real(value, digits)}\n"
        for word, value, changed, digits in zip(_MODAL, values, new, decimals, strict=True)
        if changed
    )


def _real(value: float, decimals: int) -> str:
    text = short(value, decimals)
    return text if "." in text else f"{text}.0"


def _ends(moves: Rows, dialect: KrlDialect) -> list[str]:
    """The end word of each move, with a blank before it."""
    by_way = np.where(moves.angle == FREE_ANGLE, " C_DIS", " C_ORI")
    word = np.full(len(moves.stop), " C_SPL") if dialect == "krc4" else by_way
    return [str(end) for end in np.where(moves.stop, "", word)]


def _corners(track: Track) -> tuple[FloatArray, FloatArray]:
    """Distances (M,) [mm] and angles (M,) [deg] that the corners may take."""
    turning = track.reach <= 0.0  # also where a move of some micrometres turns nothing
    distance = _largest(APPROXIMATION_DISTANCES, track.reach)
    angle = _largest(APPROXIMATION_ANGLES, np.rad2deg(track.reach_turn))
    return np.where(turning, APPROXIMATION_DISTANCES[-1], distance), np.where(turning, angle, FREE_ANGLE)


def _largest(sizes: Sequence[float], room: FloatArray) -> FloatArray:
    """(M,) the largest of the descending sizes within the room, or the smallest one."""
    index: IntArray = np.searchsorted(-np.array(sizes), -room - 1e-9)
    return np.asarray(np.array(sizes)[np.minimum(index, len(sizes) - 1)])


def _turns(angles: FloatArray) -> FloatArray:
    """Angles (M,) [rad] between M + 1 orientations A, B, C (M + 1, 3) [deg].

    By the chord of the matrices, |R1 - R0| = 2 sqrt(2) sin(w / 2) in the Frobenius norm: exact also where the
    turn is small. Equal angles turn by exactly 0.
    """
    r = rotation(angles)
    chord = np.linalg.norm(np.diff(r, axis=0), axis=(1, 2)) / (2.0 * np.sqrt(2.0))
    return np.asarray(2.0 * np.arcsin(np.minimum(chord, 1.0)))


def _down(value: FloatArray, decimals: int) -> FloatArray:
    """Rounded down to so many decimals."""
    return np.asarray(np.floor(value * 10.0**decimals) / 10.0**decimals)
