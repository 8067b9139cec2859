"""Airfoils from closed forms, as files in Selig's format.

NACA sections: Jacobs, Ward and Pinkerton, NACA Report 460 (1933), and Abbott and von Doenhoff, Theory of
Wing Sections, 6.4 to 6.6. Joukowski and Karman-Trefftz: the conformal maps of any textbook of aerodynamics.
"""

from __future__ import annotations

import numpy as np

from planner.geometry.arrays import FloatArray


def stations(count: int) -> FloatArray:
    """Places along the chord (count,), dense at both ends: half a cosine."""
    return 0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, count)))


def half_thickness(x: FloatArray, thick: float, closed: bool) -> FloatArray:
    """Half the thickness of a NACA section of thickness ``thick``; ``closed``: with a sharp trailing edge."""
    last = 0.1036 if closed else 0.1015
    poly = 0.2969 * np.sqrt(x) - 0.126 * x - 0.3516 * x**2 + 0.2843 * x**3 - last * x**4
    return np.asarray(5.0 * thick * poly)


def around(x: FloatArray, camber: FloatArray, half: FloatArray) -> FloatArray:
    """Return points (2n-1, 2) from the trailing edge over the top to the trailing edge again.

    The thickness is added across the camber line.
    """
    slope = np.arctan(np.gradient(camber, x, edge_order=2))
    up = np.stack([x - half * np.sin(slope), camber + half * np.cos(slope)], axis=1)
    low = np.stack([x + half * np.sin(slope), camber - half * np.cos(slope)], axis=1)
    return np.concatenate([up[::-1], low[1:]])


def naca_four_digits(
    camber: float, camber_position: float, thick: float, count: int, closed: bool
) -> FloatArray:
    """A NACA section of four digits: largest camber and its place, thickness, all over the chord."""
    x = stations(count)
    if camber == 0.0:
        return around(x, np.zeros_like(x), half_thickness(x, thick, closed))
    front = camber / camber_position**2 * (2.0 * camber_position * x - x**2)
    rear = (
        camber
        / (1.0 - camber_position) ** 2
        * (1.0 - 2.0 * camber_position + 2.0 * camber_position * x - x**2)
    )
    return around(x, np.where(x < camber_position, front, rear), half_thickness(x, thick, closed))


def blunt(thick: float, edge: float, count: int) -> FloatArray:
    """A section whose trailing edge is ``edge`` thick, over the chord: a closed one with a wedge added."""
    x = stations(count)
    return around(x, 0.02 * np.sin(np.pi * x), half_thickness(x, thick, True) + 0.5 * edge * x)


def reflexed(thick: float, lift: float, count: int) -> FloatArray:
    """A section whose camber line turns up at its end, for wings without a tail: a cubic that is 0 at both
    ends and at 0.85 of the chord."""
    x = stations(count)
    return around(x, lift * x * (1.0 - x) * (0.85 - x) * 4.0, half_thickness(x, thick, True))


def flat_bottom(thick: float, count: int) -> FloatArray:
    """A section with a flat underside behind a third of the chord, as Clark's Y: the underside is 0 there,
    and the top is the whole thickness."""
    x = stations(count)
    whole = 2.0 * half_thickness(x, thick, True)
    nose = 0.3 * whole * np.clip(1.0 - x / 0.33, 0.0, 1.0) ** 2
    return np.concatenate([np.stack([x, whole - nose], axis=1)[::-1], np.stack([x, -nose], axis=1)[1:]])


def karman_trefftz(thick: float, camber: float, edge_deg: float, count: int) -> FloatArray:
    """A Karman-Trefftz section: the image of a circle through (1, 0), with a trailing edge of ``edge_deg``
    (0: a Joukowski section's cusp). ``thick`` and ``camber`` place the circle's centre."""
    centre = complex(-thick, camber)
    n = 2.0 - edge_deg / 180.0
    start = -np.arcsin(camber / abs(1.0 - centre))
    turn = start + np.linspace(0.0, 2.0 * np.pi, 2 * count - 1)
    z = centre + abs(1.0 - centre) * np.exp(1j * turn)
    z[[0, -1]] = 1.0
    up, low = (z + 1.0) ** n, (z - 1.0) ** n
    w = n * (up + low) / (up - low)
    x = (w.real - w.real.min()) / (w.real.max() - w.real.min())
    y = w.imag / (w.real.max() - w.real.min())
    return np.stack([x, y - y[0]], axis=1)


def selig(name: str, points: FloatArray) -> bytes:
    """A file in Selig's format."""
    return (f"{name}\n" + "".join(f" {x:8.6f} {y + 0.0:9.6f}\n" for x, y in points)).encode()
