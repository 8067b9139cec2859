"""Bezier curves by de Casteljau's steps and clamped cubic B-splines by Cox and de Boor's, and lofts of them.

G. Farin, Curves and Surfaces for CAGD (2002), 4.2 and 8.2.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

FloatArray = NDArray[np.float64]


def bezier(control: FloatArray, t: FloatArray) -> FloatArray:
    """Points (N, D) at t (N,) of control points (C, D), or of one set of them for each (N, C, D)."""
    points = np.broadcast_to(control, (len(t), *control.shape[-2:])).astype(np.float64)
    share = t[:, None, None]
    while points.shape[1] > 1:
        points = points[:, :-1] + share * (points[:, 1:] - points[:, :-1])
    return points[:, 0]


def bspline(control: FloatArray, t: FloatArray) -> FloatArray:
    """Points (N, D) at t (N,) in [0, 1] of a clamped uniform B-spline, cubic or of what degree its control
    points (C, D) or (N, C, D) allow."""
    count = control.shape[-2]
    degree = min(3, count - 1)
    inner = np.arange(1, count - degree) / (count - degree)
    knots = np.concatenate([np.zeros(degree + 1), inner, np.ones(degree + 1)])
    return nurbs(control, np.ones(count), knots, degree, t)


def nurbs(
    control: FloatArray, weight: FloatArray, knots: FloatArray, degree: int, t: FloatArray
) -> FloatArray:
    """Points (N, D) at t (N,) of a rational B-spline: control points (C, D) or (N, C, D), ``weight`` (C,),
    ``knots`` (C + degree + 1,)."""
    count = control.shape[-2]
    span = np.clip(np.searchsorted(knots, t, side="right") - 1, degree, count - 1)
    whole = np.broadcast_to(control, (len(t), *control.shape[-2:]))
    rows = np.arange(len(t))[:, None]
    near = span[:, None] - degree + np.arange(degree + 1)
    point = whole[rows, near] * weight[near][..., None]
    point = np.concatenate([point, weight[near][..., None]], axis=2)
    for level in range(1, degree + 1):
        low = knots[near[:, level:]]
        high = knots[near[:, : degree + 1 - level] + degree + 1]
        share = (t[:, None] - low) / np.where(high > low, high - low, 1.0)
        share = np.where(high > low, share, 0.0)[..., None]
        point = (1.0 - share) * point[:, :-1] + share * point[:, 1:]
    return np.asarray(point[:, 0, :-1] / point[:, 0, -1:])


def blended(at: FloatArray, control: FloatArray, u: FloatArray) -> FloatArray:
    """Control points (N, C, D) between those of the curves (P, C, D) at ``at`` (P,): the spline through them
    with as few joints as it can have, at u (N,)."""
    if len(at) == 1:
        return np.repeat(control, len(u), axis=0)
    return np.asarray(CubicSpline(at, control, axis=0, bc_type="not-a-knot")(u))
