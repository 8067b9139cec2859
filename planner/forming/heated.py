"""The source of heat opposite the forming ball (``heat``): where it heats, and how its nozzle stands.

As two balls do (`opposite`), the ball waits in a sharp corner while the nozzle goes round it.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from planner.forming.clamp import Clamp, clear_lean
from planner.forming.inserting import mixed
from planner.forming.opposite import AT, BETWEEN, HELD, Way, parted, waited
from planner.forming.steady import steady_below, steady_normals
from planner.forming.tilt import leaned, nozzle_below_flat
from planner.forming.touching import Touching
from planner.forming.values import ContactPath, FloatArray, IntArray, Pass
from planner.geometry.vectors import dots
from planner.tooling import FormingHead, profile
from planner.units import DEG

TURN: Final = 1.0 * DEG
"""A nozzle turns by no more than this [rad] in one move: it is long, and its arm turns with it."""
_ROUNDS: Final = 8
_SHORT: Final = 5e-5
"""Moves of the place that is heated that are not longer [m] are parted for turns alone."""


def heated(
    one: Pass,
    contact: ContactPath,
    former: FormingHead,
    nozzle: FormingHead,
    thickness: float,
    clamp: Clamp | None,
    slack: float,
) -> tuple[ContactPath, FloatArray, FloatArray]:
    """The place (N, 3) [m] that is heated, across the sheet of ``thickness`` [m] from the ball, the axis
    (N, 3) of the nozzle behind it, and the path itself with targets added where the nozzle turns.

    The nozzle leans as the wall does, as far as it stays under the flat and off the ``clamp``. Both follow
    the smooth face that the ball leans on, not its facets; within ``slack`` [m] it leans on it. For a forming
    tool above.
    """
    touching = Touching(one, former.radius, 1.0, thickness)
    way = waited(contact, touching, slack, AT)
    for left in range(_ROUNDS, -1, -1):
        contact = way.contact
        # where the ball waits the place that is heated goes on, and directions are steadied along that
        about = contact.centre - former.radius * way.lean.normal
        normal = way.lean.held(steady_normals(way.lean.normal, about), HELD)
        through = former.radius + thickness * np.clip(normal[:, 2], 0.0, 1.0)
        place = contact.centre - through[:, None] * normal
        level = one.start - thickness
        most = nozzle_below_flat(place[:, 2], level, nozzle.standoff, nozzle.radius)
        lean = np.minimum(np.arccos(np.clip(normal[:, 2], -1.0, 1.0)), most)
        if clamp is not None:
            lean = clear_lean(clamp, place, normal, lean, profile(nozzle))
        axis = leaned(normal, steady_below(lean, about))
        turn = np.arccos(np.clip(dots(axis[1:], axis[:-1]), -1.0, 1.0))
        count = np.append(1, np.ceil(turn / TURN)).astype(np.int64)
        count = np.maximum(count, _uneven(way, contact.centre - place))
        if left == 0 or count.max() <= 1:
            break
        way = parted(way, count, touching)
    return contact, place, axis


def _uneven(way: Way, across: FloatArray) -> IntArray:
    """Into how many (N,) pieces the move to each target is to be parted: two where in its middle the line
    ``across`` (N, 3) from what is heated to the ball is off what that leans on there; where the ball stands,
    as many as the line's turn needs."""
    unit = across / np.linalg.norm(across, axis=1, keepdims=True)
    line = mixed(unit[:-1], unit[1:], np.full(len(unit) - 1, 0.5))
    line /= np.linalg.norm(line, axis=1, keepdims=True)
    middle = way.middle[np.arange(1, len(unit))]
    off = np.arccos(np.clip(dots(middle.held(line, 0.0), line), -1.0, 1.0))
    turn = np.arccos(np.clip(dots(unit[1:], unit[:-1]), -1.0, 1.0))
    place = way.contact.centre - across
    moved = np.linalg.norm(np.diff(way.contact.centre, axis=0), axis=1)
    moved = np.maximum(moved, np.linalg.norm(np.diff(place, axis=0), axis=1))
    two = np.where((off > BETWEEN) & (moved > _SHORT), 2.0, 1.0)
    count = np.where(way.still[1:], np.ceil(turn / (2.0 * TURN)), two)
    return np.append(1, np.maximum(count, 1.0)).astype(np.int64)
