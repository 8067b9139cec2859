"""Upper bounds of tool speeds on the cubics of trajectories, which hold at every instant.

A cubic is divided into time steps h, with one more step of the same cubic beyond each end. The mean velocity
over a step differs from the velocity in its middle by at most h^2/24 times the third derivative of the
position. A line between two velocities differs from the velocity between them by at most h^2/8 times the
third derivative. So the speed nowhere exceeds the largest mean speed of all steps (at each end, that of the
mean of two steps) plus h^2/6 times a bound of the third derivative.

The bound of the third derivative follows from the chain rule. A rotation moves the tool by at most its
distance from the axis, and several rotations together by at most its distance from the outermost axis.
"""

import dataclasses
from collections.abc import Callable
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, inverse
from planner.proof.kinematics.arm_model import RobotMachine
from planner.proof.kinematics.chain import SerialChain
from planner.proof.replay.moves import hermite

_GRID_SIZES: Final = (16, 64, 256, 1024)
"""Numbers of steps per cubic. Finer grids are used where the bound is not tight."""
_TIGHTNESS_FRACTION: Final = 0.005
"""Margin of the bound above the speed on the grid, as a fraction of the speed, that needs no finer grid."""
_TIGHTNESS_M_S: Final = 1e-4
"""Margin [m/s] of the bound above the speed on the grid that needs no finer grid."""
_POSITIONS_PER_BATCH: Final = 32_768
"""Number of positions per batch."""


def max_axis_distances(chain: SerialChain, tool: FloatArray) -> FloatArray:
    """Return upper bounds (J,) [m] of the TCP's distance from each axis; the TCP (4, 4) is in the flange."""
    lengths = np.append(np.linalg.norm(chain.step[1:, :3, 3], axis=1), np.linalg.norm(tool[:3, 3]))
    return np.asarray(np.cumsum(lengths[::-1])[::-1][:-1])


def axis_distances(chain: SerialChain, q: FloatArray, tool: FloatArray) -> FloatArray:
    """Return the distance (J,) [m] of the TCP ``tool`` (4, 4) in the flange from each axis at joints (J,)."""
    frames = chain.frames(q)
    count = len(chain.axis)
    local_axis = np.einsum("iba,ib->ia", chain.zero[:count, :3, :3], chain.axis)
    axis = np.einsum("iab,ib->ia", frames[:count, :3, :3], local_axis)
    arm_vectors = (frames[-1] @ tool)[:3, 3] - frames[:count, :3, 3]
    return np.asarray(np.linalg.norm(np.cross(axis, arm_vectors), axis=1))


@dataclasses.dataclass(frozen=True)
class RelativeTool:
    """Kinematics of a tool relative to a base, or to the tool of another arm.

    Attributes:
        poses: Function for the tool poses (..., 4, 4) at joints (..., D). The joints are a chain of
            rotations, each of which carries the next ones.
        reach: Upper bound (D,) [m] of the distance of the tool from each axis.
    """

    poses: Callable[[FloatArray], FloatArray]
    reach: FloatArray

    def positions(self, q: FloatArray) -> FloatArray:
        """Return the positions (..., 3) [m] at joints (..., D)."""
        return self.poses(q)[..., :3, 3]


def tool_in_base(machine: RobotMachine, tool: FloatArray) -> RelativeTool:
    """Return the kinematics of a ``tool`` (4, 4) in the flange relative to the base of its arm."""
    return RelativeTool(
        lambda q: np.asarray(machine.flange(q) @ tool), max_axis_distances(machine.chain, tool)
    )


ArmWithTool = tuple[RobotMachine, FloatArray, FloatArray]
"""An arm with its tool (4, 4) in the flange and its base (4, 4) in the world."""


def tool_in_holder(arm: ArmWithTool, holder: ArmWithTool) -> RelativeTool:
    """Return the kinematics of the tool of ``arm`` relative to that of ``holder``.

    The joints (..., D) are those of the holder from its last to its first, then those of the arm.
    """
    (machine, tool, base), (other, grip, holder_base) = arm, holder
    count = len(other.chain.axis)

    def poses(q: FloatArray) -> FloatArray:
        """Return the poses (..., 4, 4) of the tool relative to the holder's tool at joints (..., D)."""
        holder_poses = holder_base @ other.flange(q[..., :count][..., ::-1]) @ grip
        return np.asarray(inverse(holder_poses) @ base @ machine.flange(q[..., count:]) @ tool)

    links = np.linalg.norm(machine.chain.step[:, :3, 3], axis=1).sum() + np.linalg.norm(tool[:3, 3])
    holder_reach = np.cumsum(np.linalg.norm(other.chain.step[:-1, :3, 3], axis=1))[::-1]
    base_distance = np.linalg.norm(base[:3, 3] - holder_base[:3, 3])
    return RelativeTool(
        poses, np.append(holder_reach + base_distance + links, max_axis_distances(machine.chain, tool))
    )


CubicEnds = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
"""Joints at the two ends of N cubics and velocities there, each (N, D)."""


def peak_speeds(tool: RelativeTool, ends: CubicEnds, span: FloatArray) -> FloatArray:
    """Return upper bounds (N,) [m/s] of the tool speed on N cubics with durations ``span`` (N,) [s].

    They hold at every instant. Grids are refined where the bound has too much margin.
    """
    out, remaining = np.zeros(len(span)), np.arange(len(span))
    for count in _GRID_SIZES:
        speeds = np.empty(len(remaining))
        block = max(1, _POSITIONS_PER_BATCH // (count + 3))
        for first in range(0, len(remaining), block):
            batch = remaining[first : first + block]
            batch_ends = (ends[0][batch], ends[1][batch], ends[2][batch], ends[3][batch])
            speeds[first : first + block] = _grid_speeds(tool, batch_ends, span[batch], count)
        remaining_ends = (ends[0][remaining], ends[1][remaining], ends[2][remaining], ends[3][remaining])
        margin = (
            _third_derivative_bound(tool.reach, remaining_ends, span[remaining], count)
            * (span[remaining] / count) ** 2
            / 6.0
        )
        out[remaining] = speeds + margin
        remaining = remaining[margin > np.maximum(_TIGHTNESS_FRACTION * speeds, _TIGHTNESS_M_S)]
        if not len(remaining):
            break
    return out


def _grid_speeds(tool: RelativeTool, ends: CubicEnds, span: FloatArray, count: int) -> FloatArray:
    """Return the largest mean speed (M,) [m/s] over a step of each cubic, which has ``count`` steps.

    One more step beyond each end of the cubic gives the speeds at its ends.
    """
    fractions = ((np.arange(count + 3) - 1.0) / count)[:, None]
    a, b, va, vb = (values[:, None] for values in ends)
    positions = tool.positions(hermite(a, b, va, vb, span[:, None, None], fractions))
    steps = np.diff(positions, axis=1)
    steps[:, 0] = 0.5 * (steps[:, 0] + steps[:, 1])  # speeds at the ends
    steps[:, -1] = 0.5 * (steps[:, -2] + steps[:, -1])
    return np.asarray(np.linalg.norm(steps, axis=2).max(axis=1) * count / span)


def _third_derivative_bound(reach: FloatArray, ends: CubicEnds, span: FloatArray, count: int) -> FloatArray:
    """Return upper bounds (M,) [m/s^3] of the third derivative of the position on cubics.

    They also hold one step beyond each end, where a cubic has ``count`` steps. ``reach`` (D,) [m] is that of
    :class:`RelativeTool`.
    """
    a, b, va, vb = ends
    T = span[:, None]
    mean = (b - a) / T
    first = (6.0 * mean - 4.0 * va - 2.0 * vb) / T
    last = (2.0 * va + 4.0 * vb - 6.0 * mean) / T
    # The velocity of a joint is largest at an end, or at the extremum where its acceleration is 0.
    extremum = np.clip(first / np.where(first == last, np.inf, first - last), 0.0, 1.0)
    middle = va + T * extremum * (first + 0.5 * extremum * (last - first))
    third = np.abs(last - first) / T
    second = np.maximum(np.abs(first), np.abs(last)) + third * T / count
    speed = np.abs(np.stack([va, vb, middle])).max(axis=0) + second * T / count
    # d3x/dt3 <= sum over axes of reach (q''' + 3 q' q'' + q'^3), products grouped by the outermost axis.
    parts = third + 3.0 * _sum_by_outermost(speed, second) + _sum_by_outermost(speed, speed, speed)
    return np.asarray((reach * parts).sum(axis=1))


def _sum_by_outermost(*factors: FloatArray) -> FloatArray:
    """Return sums of products of factors, grouped by the outermost of their joints.

    The products are all those of one entry of each factor (M, J). Entry (m, j) of the result is the sum of
    those products whose largest joint index is j.
    """
    cumulative = np.prod([np.cumsum(factor, axis=1) for factor in factors], axis=0)
    return np.diff(cumulative, axis=1, prepend=0.0)


def settling_fraction(
    machine: RobotMachine, tool: FloatArray, q: FloatArray, within: float, time: float, tcp_speed: float
) -> float:
    """Return which fraction of its limits an arm needs to move to given joints within a time.

    The proof of trajectories uses it to check that an arm near its start can settle there.

    The arm moves on cubics from rest to rest. The result is the largest ratio of a value to its limit, of all
    joint speeds, joint accelerations and the tool speed. The arm can settle in time if it is at most 1.

    Args:
        machine: Kinematics of the arm.
        tool: TCP (4, 4) in the flange.
        q: Joints (J,) [rad] at the end.
        within: Maximum distance [rad] of each joint at the start.
        time: Duration [s].
        tcp_speed: Limit of the tool speed [m/s].
    """
    reach = max_axis_distances(machine.chain, tool)
    second_order = np.sum(reach * _sum_by_outermost(np.ones((1, len(q))), np.ones((1, len(q)))))
    tool_distance = within * axis_distances(machine.chain, q, tool).sum() + within**2 * second_order
    data = machine.data
    return float(
        max(
            (1.5 * within / time / data.velocity).max(),
            (6.0 * within / time**2 / data.acceleration).max(),
            1.5 * tool_distance / time / tcp_speed,
        )
    )
