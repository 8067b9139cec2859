"""The shape of a rod when it is put in."""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import brentq

from planner.verify.rod_energy import Array, Ends, exponential, logarithm, matrix, multiply
from planner.verify.rod_model import Drive, Rod, RodError, RodShape, apart
from planner.verify.rod_solve import State, newton, settle

_TURN = 0.4  # most a segment may turn in one accepted step [rad]


def mount(
    rod: Rod, start: Array, end: Array, gravity: Array, turning: float | None = None, bow: float | None = None
) -> RodShape:
    """The stable shape of a rod mounted between two frames (4, 4).

    The rod starts as a planar curve that turns by `turning` [rad] about the plane's normal (default: the
    least turn between the frames) and bows to the side `bow` (+1 or -1: towards y or away; default: the one
    of less bending), and its end and weight are then brought to where they are. Raises `RodError` when no
    stable shape is found.
    """
    drive = Drive(rod, np.asarray(start)[None], np.asarray(end)[None], gravity)
    goal = drive.ends
    distance = float(np.linalg.norm(goal.place))
    if distance >= 1.0:
        got = f"{distance * rod.length * 1e3:.4f} mm apart"
        raise RodError(f"the ends are {got}; a rod of {rod.length * 1e3:.4f} mm must be longer than that")
    rotation = _rotation(logarithm(goal.turn)[:, 0], turning)
    middle = (np.arange(rod.segments) + 0.5) / rod.segments
    size = _bow(rotation[2], distance, middle, bow)
    wave = np.outer([0.0, 0.0, 1.0], size * np.sin(2.0 * np.pi * middle))
    base = exponential(np.outer(rotation, middle))
    q = multiply(base, exponential(wave))[..., None]
    first = matrix(q)[:, 0].mean(axis=1)
    state, done, step = State(q, np.zeros((3, 1))), 0.0, 0.1
    outcome = settle(rod.stiffness, state, Ends(first, goal.turn, 0.0 * goal.weight))
    while outcome.good[0] and done < 1.0:
        part = min(1.0, done + step)
        ends = Ends(first + part * (goal.place - first), goal.turn, part * goal.weight)
        trial = newton(rod.stiffness, outcome.state, ends)
        if trial.good[0] and apart(outcome.state, trial.state) < _TURN:
            outcome, done, step = trial, part, min(2.0 * step, 0.25)
        elif step > 1e-3:
            step *= 0.5
        else:
            outcome, done = settle(rod.stiffness, outcome.state, ends), part
    if not outcome.good[0]:
        raise RodError(
            "no stable shape found for the mounted rod; give another turning or bow, or other end frames"
        )
    return RodShape(outcome.state.q[..., 0], outcome.state.force[:, 0])


def _rotation(vector: Array, turning: float | None) -> Array:
    """The rotation vector that means the same attitude as `vector` and turns about z most nearly by
    `turning`.
    """
    if turning is None:
        return vector
    angle = float(np.linalg.norm(vector))
    axis = vector / angle if angle > 1e-6 else np.array([0.0, 0.0, 1.0])
    rounds = [vector + axis * 2.0 * math.pi * k for k in range(-3, 4)]
    return min(rounds, key=lambda found: abs(float(found[2]) - turning))


def _bow(turning: float, distance: float, middle: Array, side: float | None) -> float:
    """Size a [rad] of theta = turning s + a sin(2 pi s) whose ends are `distance` apart, by bisection to
    one side.
    """

    def excess(size: float) -> float:
        theta = turning * middle + size * np.sin(2.0 * np.pi * middle)
        return math.hypot(float(np.cos(theta).mean()), float(np.sin(theta).mean())) - distance

    best: list[tuple[float, float]] = []
    for sign in (1.0, -1.0) if side is None else (math.copysign(1.0, side),):
        sizes = [sign * 0.05 * k for k in range(71)]
        misses = [excess(size) for size in sizes]
        for k in range(70):
            if misses[k] * misses[k + 1] <= 0.0:
                root = float(brentq(excess, sizes[k], sizes[k + 1], xtol=1e-14))
                best.append((abs(root), root))
                break
        else:
            k = int(np.argmin(np.abs(misses)))
            best.append((10.0 + abs(misses[k]), sizes[k]))
    return min(best)[1]
