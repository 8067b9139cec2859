"""A robot as the proof sees it: where its links are, by the text of its URDF; its limits and speeds, by the
catalogue."""

from __future__ import annotations

import dataclasses
import functools
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.catalogue import RobotData, robot, urdf_path
from planner.issues import Issue, TandemError
from planner.verify.arm_shape import ArmShape, shape_of
from planner.verify.urdf_chain import Chain, read

FloatArray = NDArray[np.float64]

CODE: Final = "verify.robot_model"
AGREE: Final = 1e-8
"""How far catalogue and URDF may differ, in m, rad and rad/s: files round to 1e-9."""
HINT: Final = "install tandem-planner again, or restore the file"
_LENGTHS: Final = ("a1", "a2", "b", "c1", "c2", "c3", "c4")


@dataclasses.dataclass(frozen=True, eq=False)
class Machine:
    """One robot: ``data`` for its limits, speeds, coupling and home alone; ``chain`` and ``shape`` from its
    URDF."""

    data: RobotData
    chain: Chain
    shape: ArmShape

    def flange(self, q: FloatArray) -> FloatArray:
        """Flange poses (..., 4, 4) in the base at serial joint angles ``q`` (..., 6) [rad]."""
        return self.chain.tip(q)


def of(name: str) -> Machine:
    """The robot of that name in the catalogue. Raises ``TandemError`` (``verify.robot_model``) for a file
    that cannot be read or is of no arm with a spherical wrist, and as :func:`planner.catalogue.urdf_path`."""
    path = urdf_path(name)
    try:
        chain, shape = _read(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        message = f"the robot {name}: its URDF {error}"
        raise TandemError(Issue(CODE, message, file=str(path), hint=HINT)) from None
    return Machine(robot(name), chain, shape)


@functools.lru_cache(maxsize=32)
def _read(text: str) -> tuple[Chain, ArmShape]:
    chain = read(text)
    return chain, shape_of(chain)


def differences(machine: Machine) -> list[str]:
    """Where the catalogue's dimensions and limits, which programs are planned with, are not the URDF's."""
    shape, chain, data = machine.shape, machine.chain, machine.data
    planned = data.opw
    out = []
    for key in _LENGTHS:
        here, there = getattr(shape, key), getattr(planned, key)
        if not abs(here - there) <= AGREE:
            out.append(
                f"{key} is {1e3 * here:.6f} mm by the axes of the URDF, {1e3 * there:.6f} in the catalogue"
            )
    turn = np.abs((shape.offsets - planned.offsets + np.pi) % (2.0 * np.pi) - np.pi)
    for i in np.flatnonzero(~(turn <= AGREE)):
        here, there = np.rad2deg([shape.offsets[i], planned.offsets[i]])
        out.append(f"the offset of axis {i + 1} is {here:.6f} deg in the URDF, {there:.6f} in the catalogue")
    turned = np.flatnonzero(shape.signs != planned.signs)
    out += [f"axis {i + 1} turns the other way in the URDF than in the catalogue" for i in turned]
    for word, here, there in (
        ("lower limit", chain.lower, data.lower),
        ("upper limit", chain.upper, data.upper),
        ("speed", chain.velocity, data.velocity),
    ):
        for i in np.flatnonzero(np.abs(here - there) > AGREE):
            one, other = np.rad2deg([here[i], there[i]])
            out.append(
                f"the {word} of axis {i + 1} is {one:.6f} deg in the URDF, {other:.6f} in the catalogue"
            )
    return out
