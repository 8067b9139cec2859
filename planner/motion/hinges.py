"""Hinges: residuals that are zero while a margin is wide, and grow as it narrows."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from planner.motion.chain import TWO_PI, Chain
from planner.motion.reach import PENALTY, SOFT_LIMIT, SOFT_SINGULARITY
from planner.motion.scene import Scene
from planner.targets import Targets

FloatArray = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Rows:
    """R residuals: ``index`` (R,) of their targets, ``value`` (R,), ``slope`` (R, J) by joints (or by
    freedoms)."""

    index: NDArray[np.intp]
    value: FloatArray
    slope: FloatArray

    @property
    def cost(self) -> float:
        """Sum of squares."""
        return float(np.sum(self.value * self.value))


def hinge(
    margin: FloatArray, slope: FloatArray, hard: float, soft: float, weight: float, index: NDArray[np.intp]
) -> Rows:
    """Residuals of margins (R,) with their slopes (R, J): sqrt(weight) at ``hard``, 0 from ``hard + soft``
    on."""
    factor = np.sqrt(weight) / soft
    return Rows(index, factor * (hard + soft - margin), -factor * slope)


def margin_rows(scene: Scene, arms: tuple[str, ...], joints: FloatArray, slopes: bool = True) -> list[Rows]:
    """Hinges on joint limits and singularities of all arms at joints (N, J)."""
    out = []
    rows, width = joints.shape
    weight = PENALTY / rows
    for k, arm in enumerate(arms):
        chain = scene.chains[arm]
        part = slice(6 * k, 6 * k + 6)
        q = joints[:, part]
        for margins, gradient, hard, soft in (
            (*_limits(chain, q), scene.settings.joint_margin, SOFT_LIMIT),
            (*_singularities(chain, q, slopes), scene.settings.singularity_margin, SOFT_SINGULARITY),
        ):
            index, which = np.nonzero(margins < hard + soft)
            slope = np.zeros((len(index), width))
            if slopes:
                slope[:, part] = gradient[index, which]
            out.append(hinge(margins[index, which], slope, hard, soft, weight, index))
    return out


def _limits(chain: Chain, q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """All limit margins (N, L) and their slopes (N, L, 6)."""
    robot = chain.robot
    margins, slopes = [q - robot.lower, robot.upper - q], [np.eye(6), -np.eye(6)]
    if robot.coupling is not None:
        axis3 = q[:, 1:2] + q[:, 2:3]
        row = np.array([[0.0, 1.0, 1.0, 0.0, 0.0, 0.0]])
        margins += [axis3 - robot.coupling.axis3_lower, robot.coupling.axis3_upper - axis3]
        slopes += [row, -row]
    slope = np.concatenate(slopes)
    return np.concatenate(margins, axis=1), np.broadcast_to(slope, (len(q), *slope.shape))


def _singularities(chain: Chain, q: FloatArray, slopes: bool) -> tuple[FloatArray, FloatArray]:
    """Singularity margins (N, 3) and their slopes (N, 3, 6), by central differences."""
    margin = chain.singularities(q)
    gradient = np.zeros((len(q), 3, 6))
    if slopes:
        step = 1e-6
        for j in (1, 2, 4):
            shift = np.zeros(6)
            shift[j] = step
            gradient[:, :, j] = (chain.singularities(q + shift) - chain.singularities(q - shift)) / (
                2.0 * step
            )
    return margin, gradient


def preference_rows(targets: Targets, values: FloatArray, rings: NDArray[np.bool_]) -> list[Rows]:
    """Residuals (slopes by freedoms) of the distance from preferred values."""
    out = []
    index = np.arange(targets.count)
    for j, freedom in enumerate(targets.freedoms):
        if freedom.prefer is None:
            continue
        away = values[:, j] - freedom.prefer
        if rings[j]:
            away = away - TWO_PI * np.round(away / TWO_PI)
        factor = (
            2.0 * np.sqrt(freedom.weight / targets.count) / np.maximum(freedom.upper - freedom.lower, 1e-12)
        )
        slope = np.zeros((targets.count, values.shape[1]))
        slope[:, j] = factor
        out.append(Rows(index, factor * away, slope))
    return out
