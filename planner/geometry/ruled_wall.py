"""A ruled surface as a function of the length along it and the fraction along its rulings, with normals."""

import dataclasses
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, RuledSurface, lengths, unit
from planner.geometry.curves import arc_length
from planner.geometry.rulings import resample

CHORD_ERROR_M: Final = 3e-5
"""Chord error between nodes [m]."""


@dataclasses.dataclass(frozen=True)
class RuledWall:
    """A ruled surface over (u, t): length along it, and fraction of the ruling from its start.

    Attributes:
        nodes: Values of u at its rulings (M,) [m].
        ends: Start and end of these rulings (M, 2, 3) [m].
        slopes: Derivatives of the ends by u (M, 2, 3).
        mitres: Vectors from the back to the front of a wall of thickness 1 at the ends (M, 2, 3), None if
            they are the normals.
    """

    nodes: FloatArray
    ends: FloatArray
    slopes: FloatArray
    mitres: FloatArray | None = None

    @property
    def widths(self) -> FloatArray:
        """Lengths (M,) of the rulings [m]."""
        return lengths(self.ends[:, 1] - self.ends[:, 0])

    def nodes_between(self, low: float, high: float) -> FloatArray:
        """Return ``low``, the nodes between ``low`` and ``high``, and ``high``."""
        inside = self.nodes[(self.nodes > low) & (self.nodes < high)]
        return np.concatenate([[low], inside, [high]])

    def points(self, u: FloatArray, t: FloatArray) -> FloatArray:
        """Return points (..., 3) [m] at u, t (...). The surface is extended along its slopes at both ends."""
        ends = self._interpolate(self.ends, u) + (u - np.clip(u, *self.nodes[[0, -1]]))[
            ..., None, None
        ] * self._interpolate(self.slopes, u)
        return _along_rulings(ends, t)

    def tangents(self, u: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return derivatives (..., 3) by u, and by t [m], at u, t (...)."""
        ends = self._interpolate(self.ends, u)
        return _along_rulings(self._interpolate(self.slopes, u), t), ends[..., 1, :] - ends[..., 0, :]

    def normals(self, u: FloatArray, t: FloatArray) -> FloatArray:
        """Return outward unit normals (..., 3) at u, t (...)."""
        return unit(np.cross(*self.tangents(u, t)))

    def depths(self, u: FloatArray, t: FloatArray) -> FloatArray:
        """Return vectors (..., 3) from the back to the front of a wall of thickness 1, at u, t (...)."""
        return (
            self.normals(u, t)
            if self.mitres is None
            else _along_rulings(self._interpolate(self.mitres, u), t)
        )

    def _interpolate(self, values: FloatArray, u: FloatArray) -> FloatArray:
        """Return values (..., 2, 3) at u (...), linear between those at the nodes."""
        last = len(self.nodes) - 2
        low = np.clip(np.searchsorted(self.nodes, u, side="right") - 1, 0, last)
        fraction = np.clip((u - self.nodes[low]) / (self.nodes[low + 1] - self.nodes[low]), 0.0, 1.0)
        fraction = fraction[..., None, None]
        return np.asarray((1.0 - fraction) * values[low] + fraction * values[low + 1])


def _along_rulings(ends: FloatArray, t: FloatArray) -> FloatArray:
    """Return values (..., 3) at the fractions t (...) between those at both ends (..., 2, 3)."""
    fraction = t[..., None]
    return np.asarray((1.0 - fraction) * ends[..., 0, :] + fraction * ends[..., 1, :])


def build_wall(ruled: RuledSurface, step: float) -> RuledWall:
    """Return an open surface without corners as a wall.

    Args:
        ruled: The surface.
        step: Maximum distance of nodes [m].
    """
    resampled = resample(ruled, CHORD_ERROR_M, step)
    ends = np.stack([resampled.start, resampled.end], axis=1)
    nodes = arc_length(ends.mean(axis=1))
    return RuledWall(nodes, ends, np.gradient(ends, nodes, axis=0, edge_order=2))
