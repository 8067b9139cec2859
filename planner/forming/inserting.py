"""More targets on the straight moves of a contact's path, where the other tool needs them."""

from __future__ import annotations

import numpy as np

from planner.forming.values import ContactPath, FloatArray, IntArray
from planner.geometry.vectors import dots

_STILL = 1e-12


def insert(contact: ContactPath, radius: float, side: int, row: IntArray, share: FloatArray) -> ContactPath:
    """The path with more targets: each in the move that ends at ``row`` (M,), at ``share`` (M,) of it, in
    ascending order.

    The centre of the forming ball of ``radius`` [m] stays on the straight move; the normal turns evenly, and
    the contact is where that normal leaves the ball.
    """
    if len(row) == 0:
        return contact
    normal = turned(contact.normal[row - 1], contact.normal[row], share)
    return insert_at(contact, row, share, normal, radius, side)


def insert_at(
    contact: ContactPath,
    row: IntArray,
    share: FloatArray,
    normal: FloatArray,
    radius: float,
    side: int = 1,
) -> ContactPath:
    """As ``insert``, with the ``normal`` (M, 3) of the face at the new targets."""
    centre = mixed(contact.centre[row - 1], contact.centre[row], share)
    point = mixed(contact.point[row - 1], contact.point[row], share)
    touching = np.linalg.norm(centre - point, axis=1) < 1.5 * radius
    point = np.where(touching[:, None], centre - side * radius * normal, point)
    return ContactPath(
        point=np.insert(contact.point, row, point, axis=0),
        normal=np.insert(contact.normal, row, normal, axis=0),
        centre=np.insert(contact.centre, row, centre, axis=0),
        angle=np.insert(contact.angle, row, np.arccos(np.clip(normal[:, 2], -1.0, 1.0))),
        loop=np.insert(contact.loop, row, contact.loop[row]),
        working=np.insert(contact.working, row, contact.working[row]),
    )


def mixed(one: FloatArray, two: FloatArray, share: FloatArray) -> FloatArray:
    """Between ``one`` and ``two`` (M, 3) at ``share`` (M,) of the way."""
    return np.asarray(one + share[:, None] * (two - one))


def turned(one: FloatArray, two: FloatArray, share: FloatArray) -> FloatArray:
    """Unit vectors (M, 3) turned evenly from ``one`` to ``two`` (M, 3) by ``share`` (M,) of the angle."""
    angle = np.arccos(np.clip(dots(one, two), -1.0, 1.0))
    sine = np.sin(angle)
    straight = sine < 1e-9
    base = np.where(straight, 1.0, sine)
    first = np.where(straight, 1.0 - share, np.sin((1.0 - share) * angle) / base)
    second = np.where(straight, share, np.sin(share * angle) / base)
    out = first[:, None] * one + second[:, None] * two
    return np.asarray(out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), _STILL))


def shares(count: IntArray) -> tuple[IntArray, FloatArray]:
    """Rows and shares that part the move to row k into ``count`` (N,) equal pieces; 1 leaves it whole."""
    extra = np.maximum(count - 1, 0)
    row = np.repeat(np.arange(len(count)), extra)
    place = np.arange(len(row)) - np.repeat(np.cumsum(extra) - extra, extra) + 1
    return row, place / count[row]
