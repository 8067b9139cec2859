"""The shape of a rod when it is put in."""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import brentq

from planner.verify.rod_energy import Array, Ends, energy, exponential, logarithm, matrix, multiply
from planner.verify.rod_model import Drive, Rod, RodError, RodShape, apart
from planner.verify.rod_solve import Outcome, State, newton, settle

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
    sides = (1.0, -1.0) if bow is None else (math.copysign(1.0, bow),)
    found: list[tuple[float, RodShape]] = []
    for side in sides:
        outcome = _brought(rod, _first(rod, rotation, distance, side), goal)
        if outcome.good[0]:
            state = outcome.state
            value = float(energy(rod.stiffness, state.q, goal)[0])
            found.append((value, RodShape(state.q[..., 0], state.force[:, 0])))
    if not found:
        raise RodError(
            "no stable shape found for the mounted rod; give another turning or bow, or other end frames"
        )
    least = min(value for value, _ in found)
    return next(shape for value, shape in found if value <= least + 1e-9 * (1.0 + abs(least)))


def _first(rod: Rod, rotation: Array, distance: float, side: float) -> State:
    middle = (np.arange(rod.segments) + 0.5) / rod.segments
    size = _bow(rotation[2], distance, middle, side)
    wave = np.outer([0.0, 0.0, 1.0], size * np.sin(2.0 * np.pi * middle))
    q = multiply(exponential(np.outer(rotation, middle)), exponential(wave))[..., None]
    return State(q, np.zeros((3, 1)))


def _brought(rod: Rod, state: State, goal: Ends) -> Outcome:
    """The shape after the end went from its place in `state` to the wanted one, and the weight from 0."""
    first = matrix(state.q)[:, 0].mean(axis=1)
    outcome = settle(rod.stiffness, state, Ends(first, goal.turn, 0.0 * goal.weight))
    done, step = 0.0, 0.1
    while outcome.good[0] and done < 1.0:
        part = min(1.0, done + step)
        ends = Ends(first + part * (goal.place - first), goal.turn, part * goal.weight)
        trial = newton(rod.stiffness, outcome.state, ends)
        if trial.good[0] and apart(outcome.state, trial.state) < _TURN:
            outcome, done, step = trial, part, min(2.0 * step, 0.25)
        elif step > 0.02:
            step *= 0.5
        else:
            outcome, done = settle(rod.stiffness, outcome.state, ends), part
    return outcome


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


def _bow(turning: float, distance: float, middle: Array, side: float) -> float:
    """Size a [rad] of theta = turning s + a sin(2 pi s) with its ends `distance` apart, to one side."""

    def excess(size: float) -> float:
        theta = turning * middle + size * np.sin(2.0 * np.pi * middle)
        return math.hypot(float(np.cos(theta).mean()), float(np.sin(theta).mean())) - distance

    sizes = [math.copysign(0.05, side) * k for k in range(71)]
    misses = [excess(size) for size in sizes]
    for k in range(70):
        if misses[k] * misses[k + 1] <= 0.0:
            return float(brentq(excess, sizes[k], sizes[k + 1], xtol=1e-14))
    return sizes[int(np.argmin(np.abs(misses)))]
