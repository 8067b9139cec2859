"""First guess of an elastica through a curve: the curvature of an elastica is affine in position
(Brander, Gravesen and Norbjerg, arXiv 1509.00703), with a known term from weight; integrated once, it is
linear in what is sought."""

import numpy as np
from scipy.interpolate import CubicSpline

from planner.hotwire.basis import Array

_FINER = 4
_EVEN = 3.0  # largest ratio of neighbouring steps up to which a spline over the points' numbers is trusted


def first_guess(points: Array, share: Array, weight: Array) -> tuple[Array, Array]:
    """States (B, 6) abreast of the middles of curves (B, m, 2) and the arc lengths (B, m) of the points
    from there.

    share (B, m): weights of the points; weight q (B, 2). Units of the points; best when curves are about
    1 long."""
    fine = _refine(points)
    delta = np.diff(fine, axis=1)
    steps = np.hypot(delta[..., 0], delta[..., 1])
    total = np.concatenate([np.zeros((steps.shape[0], 1)), np.cumsum(steps, axis=1)], axis=1)
    place = total - 0.5 * total[:, -1:]
    theta = np.unwrap(np.arctan2(delta[..., 1], delta[..., 0]), axis=1)
    centre = _at_zero(place, fine)
    from_centre = fine - centre[:, None, :]

    def integral(values: Array) -> Array:
        """From the centre to the middles of the chords, by trapezoids; values (B, m, c)."""
        parts = 0.5 * (values[:, 1:] + values[:, :-1]) * steps[..., None]
        whole = np.concatenate([np.zeros_like(values[:, :1]), np.cumsum(parts, axis=1)], axis=1)
        middle = 0.5 * (whole[:, 1:] + whole[:, :-1])
        out: Array = middle - _at_zero(place, whole)[:, None, :]
        return out

    # k = kc + Fx (y - yc) - Fy (x - xc) - int (qx s sin theta - qy s cos theta) and theta = theta_c + int k
    s = 0.5 * (place[:, 1:] + place[:, :-1])
    load = (weight[:, :1] * s * np.sin(theta) - weight[:, 1:] * s * np.cos(theta)) * steps
    bent = np.concatenate([np.zeros_like(load[:, :1]), np.cumsum(load, axis=1)], axis=1)
    bent -= _at_zero(place, bent[..., None])
    force = integral(np.stack([from_centre[..., 1], -from_centre[..., 0], bent], axis=-1))
    columns = np.stack([np.ones_like(s), s, force[..., 0], force[..., 1]], axis=-1)
    trust = np.repeat(np.minimum(share[:, 1:], share[:, :-1]), _FINER, axis=1) / np.mean(share)
    left = np.swapaxes(columns, 1, 2) * (steps * trust)[:, None, :]
    ridge = np.diag([1e-12, 1e-9, 1e-8, 1e-8])
    law = np.linalg.solve(left @ columns + ridge, left @ (theta + force[..., 2])[..., None])
    return np.concatenate([centre, law[..., 0]], axis=1), place[:, ::_FINER]


def _refine(points: Array) -> Array:
    """Curves with more points (B, n, 2): a cubic spline over the points' numbers, or lines where the
    steps are uneven."""
    count = points.shape[1]
    number = np.arange(count, dtype=np.float64)
    fine = np.linspace(0.0, count - 1.0, (count - 1) * _FINER + 1)
    smooth: Array = np.asarray(CubicSpline(number, points, axis=1)(fine))
    cell = np.minimum(fine.astype(np.int64), count - 2)
    u = (fine - cell)[:, None]
    lines = points[:, cell] * (1.0 - u) + points[:, cell + 1] * u
    steps = np.hypot(*np.moveaxis(np.diff(points, axis=1), -1, 0))
    ratio = np.maximum(steps[:, 1:], steps[:, :-1]) / np.maximum(
        np.minimum(steps[:, 1:], steps[:, :-1]), 1e-300
    )
    even = ratio.max(axis=1) < _EVEN
    return np.where(even[:, None, None], smooth, lines)


def _at_zero(place: Array, values: Array) -> Array:
    """Values (B, c) at place 0 from (B, m, c) at the increasing places (B, m), linear in between."""
    rows = np.arange(place.shape[0])
    right = np.clip(np.sum(place < 0.0, axis=1), 1, place.shape[1] - 1)
    a, b = place[rows, right - 1], place[rows, right]
    u = (-a / np.where(b > a, b - a, 1.0))[:, None]
    out: Array = values[rows, right - 1] * (1.0 - u) + values[rows, right] * u
    return out
