"""The source of heat opposite the forming ball (``heat``): where it heats, and how its nozzle stands."""

from __future__ import annotations

from typing import Final

import numpy as np

from planner.forming.clamp import Clamp, clear_lean
from planner.forming.inserting import insert, shares
from planner.forming.steady import steady_below, steady_normals
from planner.forming.tilt import leaned, nozzle_below_flat
from planner.forming.values import ContactPath, FloatArray, Pass
from planner.geometry.vectors import dots
from planner.tooling import FormingHead, profile
from planner.units import DEG

TURN: Final = 1.0 * DEG
"""A nozzle turns by no more than this [rad] in one move: it is long, and its arm turns with it."""
_ROUNDS: Final = 4


def heated(
    one: Pass,
    contact: ContactPath,
    former: FormingHead,
    nozzle: FormingHead,
    thickness: float,
    clamp: Clamp | None,
) -> tuple[ContactPath, FloatArray, FloatArray]:
    """The place (N, 3) [m] that is heated, across the sheet of ``thickness`` [m] from the ball, the axis
    (N, 3) of the nozzle behind it, and the path itself with targets added where the nozzle turns.

    The nozzle leans as the wall does, as far as it stays under the flat and off the ``clamp``. Both follow
    the smooth face, not its facets. For a forming tool above.
    """
    for left in range(_ROUNDS, -1, -1):
        normal = steady_normals(contact.normal, contact.centre)
        through = former.radius + thickness * np.clip(normal[:, 2], 0.0, 1.0)
        place = contact.centre - through[:, None] * normal
        level = one.start - thickness
        most = nozzle_below_flat(place[:, 2], level, nozzle.standoff, nozzle.radius)
        lean = np.minimum(np.arccos(np.clip(normal[:, 2], -1.0, 1.0)), most)
        if clamp is not None:
            lean = clear_lean(clamp, place, normal, lean, profile(nozzle))
        axis = leaned(normal, steady_below(lean, contact.centre))
        turn = np.arccos(np.clip(dots(axis[1:], axis[:-1]), -1.0, 1.0))
        row, share = shares(np.concatenate([[1.0], np.ceil(turn / TURN)]).astype(np.int64))
        if not len(row) or left == 0:
            break
        contact = insert(contact, former.radius, 1, row, share)
    return contact, place, axis
