"""Many poses in little memory."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Rows = int | np.integer | slice | IntArray | NDArray[np.bool_]


@dataclasses.dataclass(frozen=True)
class Poses:
    """S poses as their positions ``place`` and the directions ``x`` and ``z`` of two of their axes (S, 3): y
    follows. What is indexed comes as (..., 4, 4)."""

    place: FloatArray
    x: FloatArray
    z: FloatArray

    @staticmethod
    def of(poses: FloatArray) -> Poses:
        """Of poses (S, 4, 4)."""
        return Poses(poses[:, :3, 3].copy(), poses[:, :3, 0].copy(), poses[:, :3, 2].copy())

    @staticmethod
    def empty(count: int) -> Poses:
        """Room for ``count`` poses."""
        return Poses(np.empty((count, 3)), np.empty((count, 3)), np.empty((count, 3)))

    @staticmethod
    def joined(parts: Iterable[Poses]) -> Poses:
        """Poses behind each other."""
        some = tuple(parts)
        if len(some) == 1:
            return some[0]
        place, x, z = (
            np.concatenate([getattr(part, field.name) for part in some])
            for field in dataclasses.fields(Poses)
        )
        return Poses(place, x, z)

    def __len__(self) -> int:
        return len(self.place)

    def __getitem__(self, rows: Rows) -> FloatArray:
        place, x, z = self.place[rows], self.x[rows], self.z[rows]
        out = np.zeros((*place.shape[:-1], 4, 4))
        out[..., :3, 0], out[..., :3, 1], out[..., :3, 2] = x, np.cross(z, x), z
        out[..., :3, 3] = place
        out[..., 3, 3] = 1.0
        return out

    def __setitem__(self, rows: Rows, poses: FloatArray) -> None:
        self.place[rows] = poses[..., :3, 3]
        self.x[rows] = poses[..., :3, 0]
        self.z[rows] = poses[..., :3, 2]
