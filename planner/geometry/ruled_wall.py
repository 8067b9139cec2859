"""A ruled surface as a function of the way along it and the share along its rulings, with its normals."""

import dataclasses
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, Ruled, lengths, unit
from planner.geometry.curves import arc_length
from planner.geometry.rulings import resample

CHORD: Final = 3e-5
"""The surface between nodes is this near [m] to the given one."""


@dataclasses.dataclass(frozen=True)
class RuledWall:
    """Rulings at ``nodes`` (M,) [m], the ways that their middles have gone along the surface: ``ends`` (M, 2,
    3) [m] and ``slopes`` (M, 2, 3), their derivatives by that way.

    A place is (u, t): the way and the share of the ruling from its start. Between nodes ends go straight, and
    beyond the first and the last one straight on. The outward normal is that of `arrays.Ruled`.
    ``mitres`` (M, 2, 3): at the ends, from the back to the front of a wall one thickness of 1 thick; without
    them, they are its normals.
    """

    nodes: FloatArray
    ends: FloatArray
    slopes: FloatArray
    mitres: FloatArray | None = None

    @property
    def widths(self) -> FloatArray:
        """Lengths (M,) of the rulings [m]."""
        return lengths(self.ends[:, 1] - self.ends[:, 0])

    def between(self, low: float, high: float) -> FloatArray:
        """``low``, the nodes above it and below ``high``, and that."""
        inside = self.nodes[(self.nodes > low) & (self.nodes < high)]
        return np.concatenate([[low], inside, [high]])

    def points(self, u: FloatArray, t: FloatArray) -> FloatArray:
        """Points (..., 3) [m] at places u, t (...)."""
        at = self._rows(self.ends, u) + (u - np.clip(u, *self.nodes[[0, -1]]))[..., None, None] * self._rows(
            self.slopes, u
        )
        return _along(at, t)

    def tangents(self, u: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives (..., 3) by u, and by t [m], at places u, t (...)."""
        at = self._rows(self.ends, u)
        return _along(self._rows(self.slopes, u), t), at[..., 1, :] - at[..., 0, :]

    def normals(self, u: FloatArray, t: FloatArray) -> FloatArray:
        """Outward unit normals (..., 3) at places u, t (...)."""
        return unit(np.cross(*self.tangents(u, t)))

    def depths(self, u: FloatArray, t: FloatArray) -> FloatArray:
        """What is in front of a back one thickness of 1 behind (..., 3), at places u, t (...)."""
        return self.normals(u, t) if self.mitres is None else _along(self._rows(self.mitres, u), t)

    def _rows(self, values: FloatArray, u: FloatArray) -> FloatArray:
        """Values (..., 2, 3) at u (...), straight between those at the nodes."""
        last = len(self.nodes) - 2
        low = np.clip(np.searchsorted(self.nodes, u, side="right") - 1, 0, last)
        share = np.clip((u - self.nodes[low]) / (self.nodes[low + 1] - self.nodes[low]), 0.0, 1.0)
        share = share[..., None, None]
        return np.asarray((1.0 - share) * values[low] + share * values[low + 1])


def _along(ends: FloatArray, t: FloatArray) -> FloatArray:
    share = t[..., None]
    return np.asarray((1.0 - share) * ends[..., 0, :] + share * ends[..., 1, :])


def ruled_wall(ruled: Ruled, step: float) -> RuledWall:
    """An open surface without corners as a wall, with nodes no farther apart than ``step`` [m]."""
    own = resample(ruled, CHORD, step)
    ends = np.stack([own.start, own.end], axis=1)
    nodes = arc_length(ends.mean(axis=1))
    return RuledWall(nodes, ends, np.gradient(ends, nodes, axis=0, edge_order=2))
