"""Joint accelerations and jerks on a clock, by divided differences of the targets of a path."""

import dataclasses

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IndexArray


@dataclasses.dataclass(frozen=True)
class DifferenceBand:
    """Divided differences of a path.

    Row m is the sum of ``weight`` (M, K) times targets ``first`` (M,) to first + K - 1.
    """

    first: IndexArray
    weight: FloatArray

    def differences(self, joints: FloatArray) -> FloatArray:
        """Differences (M, J) of joints (N, J)."""
        at = self.first[:, None] + np.arange(self.weight.shape[1])
        return np.asarray(np.einsum("mk,mkj->mj", self.weight, joints[at]))


def difference_bands(duration: FloatArray, stop: BoolArray) -> tuple[DifferenceBand, DifferenceBand]:
    """Bands of joint accelerations and jerks where no stop is in between.

    Args:
        duration: (N - 1,) [s] durations of the moves.
        stop: (N,) whether the arms stop at a target.
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
    both = np.flatnonzero(~stop[1:-2] & ~stop[2:-1])
    return DifferenceBand(first, weight[first]), DifferenceBand(both, jerk[both])


def peak_differences(duration: FloatArray, stop: BoolArray, joints: FloatArray) -> tuple[float, ...]:
    """Largest acceleration [rad/s2] and jerk [rad/s3] of any joint, by divided differences.

    Differences across a stop do not count.

    Args:
        duration: (N - 1,) [s] durations of the moves.
        stop: (N,) whether the arms stop at a target.
        joints: (N, J) [rad] joints.
    """
    return tuple(
        float(np.abs(band.differences(joints)).max(initial=0.0)) for band in difference_bands(duration, stop)
    )
