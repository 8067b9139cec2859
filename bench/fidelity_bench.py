"""Postprocessor fidelity: 100,000 random targets of every robot.

They are selected by confdata or by status and turn, and read back from the text; the inverse kinematics is
py-opw-kinematics.
"""

from __future__ import annotations

import time
from typing import Any

from planner.catalogue.robots import robot, robot_names
from tests.languages.writing import fidelity

TARGETS = 100_000


def run() -> list[dict[str, Any]]:
    """Rows of the table, one a robot."""
    return [_row(name) for name in robot_names()]


def _row(name: str) -> dict[str, Any]:
    arm = robot(name)
    start = time.perf_counter()
    got = fidelity.measure(name, TARGETS)
    language = "S and T" if arm.family == "KUKA" else "confdata"
    unproven = "; unproven: parallel rod, cfx as for serial arms" if arm.coupling is not None else ""
    note = (
        f"{100 * got.selected:.3f} % selected (goal 100), read back within {got.position:.6f} mm and "
        f"{got.angle:.7f} deg (goals 0.001, 0.0001){unproven}"
    )
    return {
        "name": f"{name}, {language}, {TARGETS} targets",
        "median_s": time.perf_counter() - start,
        "note": note,
    }
