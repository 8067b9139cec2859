"""What a user may state about the path of the contact on a face."""

from __future__ import annotations

import dataclasses
import math
from typing import Final, Literal

Kind = Literal["contour", "alternating", "stepped", "helical"]
Direction = Literal["ccw", "cw"]


MISSED: Final = 2e-5
"""Smooth places [m] that a ball stays farther off are too narrow for it, where the mesh has no noise."""


@dataclasses.dataclass(frozen=True)
class PathOptions:
    """How the contact goes over a face.

    ``kind``: "contour" closed loops, joined by a diagonal step along the face at the seam; "alternating" the
    same, each loop the other way round; "stepped" at the seam level first, along the sheet as it is then,
    and then straight down; "helical" one spiral between a flat first and a flat last loop.
    Spacing: ``stepdown`` [m] from level to level or ``scallop`` [m], the height of the ridges left between
    loops: exactly one of both. ``tangent_angle`` [rad]: a target wherever the contact's way has turned by so
    much; corners always get one. ``chord`` [m]: the straight moves of the ball's centre stay within it of
    the true offset of the face, and where they would cut into the face, within ``cut`` [m]. ``start_angle``
    [rad] of the ray from the middle of the feature on which the
    loops begin, ``direction`` of the loops as seen from +z. ``longest`` [m] move. ``lift`` [m]: so far above
    everything the ball goes over to another loop. ``missed`` [m]: a place of a smooth face that the ball
    stays farther off than this (and than the mesh's own facets make it) is too narrow for the tool;
    infinite where a stated tolerance is asked before. ``spare`` [m]: fillets that a ball so
    much larger does not fit count as creases; 0 where nothing depends on the place that the ball touches.
    """

    kind: Kind = "contour"
    stepdown: float | None = 1e-3
    scallop: float | None = None
    tangent_angle: float = math.radians(5.0)
    chord: float = 5e-5
    cut: float = 5e-5
    start_angle: float = 0.0
    direction: Direction = "ccw"
    longest: float = 0.02
    lift: float = 5e-3
    missed: float = MISSED
    spare: float = 0.0
