"""Which way the wire sweeps: the direction whose sections an elastica meets best, with its ends' errors
counted in.
"""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.geometry.mesh import TriangleMesh
from planner.hotwire import heavy
from planner.hotwire.elastic_planes import cut_sections, direction_of, make_spine
from planner.hotwire.response import end_sensitivity

FloatArray = NDArray[np.float64]

CANDIDATES: Final = (90.0, 0.0, 45.0, 135.0, 67.5, 112.5, 22.5, 157.5)
_PLANES = 13
_WORST = 1.0  # m: stands for a shape that cannot be held at all


@dataclasses.dataclass(frozen=True)
class Sweep:
    """One direction tried: ``degrees`` from the block's x, ``shape`` the largest distance [m] of its
    sections from elasticas, ``hold`` [m] by how much stated end errors move them (1 m: not held at all),
    ``longest`` section [m].
    """

    degrees: float
    shape: float
    hold: float
    longest: float

    @property
    def score(self) -> float:
        """What is to be small."""
        return self.shape + self.hold


def try_sweeps(
    faces: list[TriangleMesh], length: float, spare: float, load: float, end_error: float, normal: bool
) -> list[Sweep]:
    """All candidate directions for faces; the wire has ``length``, of which ``spare`` must be left beside a
    section [m].
    """
    return [_try(faces, angle, length, spare, load, end_error, normal) for angle in CANDIDATES]


def best_sweep(tried: list[Sweep], tolerance: float) -> Sweep:
    """The direction of least score; among those well within ``tolerance`` [m] the one with the shortest
    sections.
    """
    good = [s for s in tried if s.score < 0.5 * tolerance]
    if good:
        straight = [s for s in good if s.degrees % 90.0 == 0.0] or good
        return min(straight, key=lambda s: round(s.longest, 4))
    return min(tried, key=lambda s: s.score)


def _try(
    faces: list[TriangleMesh],
    degrees: float,
    length: float,
    spare: float,
    load: float,
    end_error: float,
    normal: bool,
) -> Sweep:
    shape, hold, longest = 0.0, 0.0, 0.0
    for face in faces:
        spine = make_spine(face, direction_of(degrees), normal)
        along = face.vertices @ spine.direction
        p = np.linspace(along.min(), along.max(), _PLANES + 2)[1:-1]
        sections = cut_sections(face, spine, p)
        longest = max(longest, float(sections.length.max()))
        full = sections.length > 0.5 * sections.length.max()
        if longest + spare > length:
            return Sweep(degrees, _WORST, _WORST, longest)
        gravity = np.swapaxes(spine.frames(p[full])[:, :3, :3], 1, 2) @ np.array([0.0, 0.0, -load])
        count = int(full.sum())
        got = heavy.fit(sections.points[full], np.full(count, length), gravity[:, :2])
        feel = end_sensitivity(got.shape, got.foot[:, [0, -1]]).position
        shape = max(shape, float(got.largest.max()))
        hold = max(hold, float(np.minimum(feel * end_error, _WORST).max()))
    return Sweep(degrees, shape, hold, longest)
