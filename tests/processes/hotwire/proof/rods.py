"""Rods, end frames and a reference solution for the tests of the discrete rod."""

from __future__ import annotations

import math

import numpy as np
from scipy.integrate import solve_bvp

from planner.geometry.arrays import FloatArray
from planner.processes.hotwire.proof.rod import Rod

DOWN = np.array([0.0, 0.0, -1.0])
LENGTH = 0.7
ROUND = 1.0 / 1.3  # torsion over bending of a round wire with Poisson's ratio 0.3


def frame(x: float, y: float, theta: float, spin: float = 0.0) -> FloatArray:
    """Planar end frame in the world's x-y plane, then rotated about its own x."""
    c, s, a, b = math.cos(theta), math.sin(theta), math.cos(spin), math.sin(spin)
    found = np.eye(4)
    found[:3, :3] = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]) @ np.array(
        [[1.0, 0, 0], [0, a, -b], [0, b, a]]
    )
    found[:2, 3] = x, y
    return found


def wire(ratio: float = 1.0, torsion: float = ROUND, weight: float = 0.0, segments: int = 64) -> Rod:
    return Rod(LENGTH, 2e-3, ratio * 2e-3, torsion * 2e-3, weight, segments)


def planar_reference(
    start: tuple[float, float, float], end: tuple[float, float, float], guess: FloatArray
) -> FloatArray:
    """Elastica x, y, theta, k at 65 points by scipy's collocation.

    x' = cos, y' = sin, theta' = k, k' = Fx sin - Fy cos.

    All in units of the length; `guess` is a polyline of 65 points.
    """
    s = np.linspace(0.0, 1.0, len(guess))
    slope = np.gradient(guess, s, axis=0)
    theta = np.unwrap(np.arctan2(slope[:, 1], slope[:, 0]))
    y0 = np.stack([guess[:, 0], guess[:, 1], theta, np.gradient(theta, s)])

    def rate(_: FloatArray, y: FloatArray, p: FloatArray) -> FloatArray:
        return np.stack([np.cos(y[2]), np.sin(y[2]), y[3], p[0] * np.sin(y[2]) - p[1] * np.cos(y[2])])

    def edge(a: FloatArray, b: FloatArray, _: FloatArray) -> FloatArray:
        return np.concatenate([a[:3] - start, b[:3] - end, []])

    solution = solve_bvp(rate, edge, s, y0, p=[-20.0, 0.0], tol=1e-10, max_nodes=20000)
    assert solution.success
    states: FloatArray = solution.sol(s)
    return states


def arc_frames(turn: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    radius = LENGTH / turn
    half = turn / 2
    centre = np.array([radius * math.sin(half), radius * math.cos(half), 0.0])
    return frame(0, 0, -half), frame(2 * radius * math.sin(half), 0, half), centre
