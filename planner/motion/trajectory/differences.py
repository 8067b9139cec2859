"""Accelerations and jerks of joints on a clock, by divided differences of the targets of a path."""

import dataclasses

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IndexArray


@dataclasses.dataclass(frozen=True)
class Band:
    """Divided differences of paths: row m is the sum of ``weight`` (M, K) times targets ``first`` (M,) to
    ``first`` + K - 1."""

    first: IndexArray
    weight: FloatArray

    def of(self, joints: FloatArray) -> FloatArray:
        """The differences (M, J) of joints (N, J)."""
        at = self.first[:, None] + np.arange(self.weight.shape[1])
        return np.asarray(np.einsum("mk,mkj->mj", self.weight, joints[at]))


def bands(duration: FloatArray, stop: BoolArray) -> tuple[Band, Band]:
    """Accelerations and jerks of joints by the times (N - 1,) [s] of the moves, where no stop is between."""
    step = np.maximum(duration, 1e-3 * float(np.median(duration)) + 1e-9)
    middle = 0.5 * (step[1:] + step[:-1])
    weight = np.stack([1.0 / step[:-1], -1.0 / step[:-1] - 1.0 / step[1:], 1.0 / step[1:]], axis=1)
    weight = weight / middle[:, None]
    first = np.flatnonzero(~stop[1:-1])
    jerk = np.zeros((max(len(weight) - 1, 0), 4))
    if len(jerk):
        jerk[:, :3] -= weight[:-1] / step[1:-1, None]
        jerk[:, 1:] += weight[1:] / step[1:-1, None]
    both = np.flatnonzero(~stop[1:-2] & ~stop[2:-1])
    return Band(first, weight[first]), Band(both, jerk[both])


def peaks(duration: FloatArray, stop: BoolArray, joints: FloatArray) -> tuple[float, ...]:
    """The largest acceleration [rad/s2] and jerk [rad/s3] of any joint on a path (N, J) whose moves last
    ``duration`` (N - 1,) [s], by divided differences of its targets where no stop is between."""
    return tuple(float(np.abs(band.of(joints)).max(initial=0.0)) for band in bands(duration, stop))
