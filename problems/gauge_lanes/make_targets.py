"""Writes the table of this problem: ``python problems/gauge_lanes/make_targets.py`` (NumPy is all it needs).

Four lanes along x over a vault whose axis lies along y; the tool points at the axis. Between two lanes the
gauge turns around in a half circle of many short steps: the proof finds corners that no axis could take.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
RADIUS = 300.0
"""Of the vault [mm]; its ridge is the top of the block, 80 mm above the stock's frame."""
TOP = 80.0
GAP = 25.0
"""From the vault to the gauge [mm]."""
HALF = np.deg2rad(20.0)
"""The lanes end so far from the ridge, seen from the axis."""
LANES = (-60.0, -20.0, 20.0, 60.0)
STEPS = 36
TURN_STEPS = 24
COLUMNS = [f"robot.{c}" for c in ("x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz")] + ["segment"]


def path() -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Angles from the ridge (N,) [rad], y (N,) [mm], and the segment of each."""
    angle, along, rows = [], [], []
    for number, y in enumerate(LANES):
        way = 1.0 if number % 2 == 0 else -1.0
        angle.append(way * np.linspace(-HALF, HALF, STEPS))
        along.append(np.full(STEPS, y))
        rows += [f"cut/lane{number + 1}"] * STEPS
        if number + 1 < len(LANES):
            share = np.linspace(0.0, np.pi, TURN_STEPS + 2)[1:-1]
            half = (LANES[number + 1] - y) / 2.0
            angle.append(way * (HALF + half * np.sin(share) / (RADIUS + GAP)))
            along.append(y + half * (1.0 - np.cos(share)))
            rows += [f"link/turn{number + 1}"] * TURN_STEPS
    return np.concatenate(angle), np.concatenate(along), rows


def write() -> None:
    """The tool's z axis points at the vault: half a turn about x, then ``angle`` about y."""
    angle, along, rows = path()
    far = RADIUS + GAP
    with (HERE / "targets.csv").open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream)
        table.writerow(COLUMNS)
        for turned, y, segment in zip(angle, along, rows, strict=True):
            x, z = far * np.sin(turned), TOP - RADIUS + far * np.cos(turned)
            # Ry(turned) * Rx(pi) as a quaternion
            spin = (0.0, np.cos(turned / 2.0), 0.0, -np.sin(turned / 2.0))
            place = [f"{v:.4f}" for v in (x, y, z)]
            table.writerow([*place, *(f"{v + 0.0:.9f}" for v in spin), segment])


if __name__ == "__main__":
    write()
