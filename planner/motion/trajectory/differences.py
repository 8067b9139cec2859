"""Joint accelerations and jerks on a clock, by divided differences of the targets of a path."""

import dataclasses

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IndexArray


@dataclasses.dataclass(frozen=True)
class DifferenceBand:
    """M divided differences of a path, each over K consecutive targets.

    Attributes:
        first: (M,) index of the first target of each difference.
        weight: (M, K) weights of the targets from the first one on. A difference is the weighted sum of their
            joints.
    """

    first: IndexArray
    weight: FloatArray

    def differences(self, joints: FloatArray) -> FloatArray:
        """Return the differences (M, J) of joints (N, J)."""
        targets = self.first[:, None] + np.arange(self.weight.shape[1])
        return np.asarray(np.einsum("mk,mkj->mj", self.weight, joints[targets]))


def difference_bands(duration: FloatArray, stop: BoolArray) -> tuple[DifferenceBand, DifferenceBand]:
    """Return the differences that are joint accelerations and joint jerks of a path on its clock.

    Differences with a stop at an inner target are left out.

    Args:
        duration: (N - 1,) [s] durations of the moves.
        stop: (N,) whether the arms stop at a target.

    Returns:
        Accelerations, over three targets, and jerks, over four.
    """
    step = np.maximum(duration, 1e-3 * float(np.median(duration)) + 1e-9)
    # acceleration at target i: ((q_(i+1) - q_i) / t_i - (q_i - q_(i-1)) / t_(i-1)) / ((t_(i-1) + t_i) / 2)
    middle = 0.5 * (step[1:] + step[:-1])
    weight = np.stack([1.0 / step[:-1], -1.0 / step[:-1] - 1.0 / step[1:], 1.0 / step[1:]], axis=1)
    weight = weight / middle[:, None]
    first = np.flatnonzero(~stop[1:-1])
    # jerk between targets i and i + 1: (a_(i+1) - a_i) / t_i
    jerk = np.zeros((max(len(weight) - 1, 0), 4))
    if len(jerk):
        jerk[:, :3] -= weight[:-1] / step[1:-1, None]
        jerk[:, 1:] += weight[1:] / step[1:-1, None]
    jerk_first = np.flatnonzero(~stop[1:-2] & ~stop[2:-1])
    return DifferenceBand(first, weight[first]), DifferenceBand(jerk_first, jerk[jerk_first])


def peak_differences(duration: FloatArray, stop: BoolArray, joints: FloatArray) -> tuple[float, ...]:
    """Return the largest acceleration [rad/s2] and jerk [rad/s3] of any joint, by divided differences.

    Differences across a stop do not count.

    Args:
        duration: (N - 1,) [s] durations of the moves.
        stop: (N,) whether the arms stop at a target.
        joints: (N, J) [rad] joints.
    """
    return tuple(
        float(np.abs(band.differences(joints)).max(initial=0.0)) for band in difference_bands(duration, stop)
    )
