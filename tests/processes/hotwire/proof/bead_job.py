"""Beads along a table of poses with a minimum feed: one ABB arm, one KUKA arm, and two ABB arms side by side.

Each has a lane, a turn without a minimum feed, and a lane back with a stop in its middle.
"""

from __future__ import annotations

import functools
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from planner import pipeline
from planner.claims.claim import Claim
from planner.problem import Problem
from planner.processes import registry

FEED, MIN_FEED = 40.0, 36.0
STEP, COUNT, STOP = 6.0, 13, 7
TOOL: dict[str, Any] = {
    "kind": "plain",
    "tcp": {"xyz_mm": [0, 0, 160]},
    "mass_kg": 0.9,
    "cog_mm": [0, 0, 60],
    "shapes": [{"kind": "cylinder", "radius_mm": 15, "length_mm": 120, "pose": {"xyz_mm": [0, 0, 70]}}],
}
JOBS = ("abb", "kuka", "two")
_ARMS: dict[str, list[tuple[str, str, list[float], float, list[float]]]] = {
    "abb": [("robot", "irb140", [0, 0, 0], 0, [0, -10, 10, 0, 60, 0])],
    "kuka": [("robot", "kr60_ha", [0, 0, 0], 0, [0, -110, 110, 0, 60, 0])],
    "two": [
        ("left", "irb140", [-650, 0, 0], 0, [0, -10, 10, 0, 60, 0]),
        ("right", "irb140", [650, 0, 0], 180, [0, -10, 10, 0, 60, 0]),
    ],
}
_BLOCK = {"abb": [560, 0, 220], "kuka": [1100, 0, 500], "two": [0, 0, 220]}


def lanes() -> tuple[np.ndarray, list[float], list[str], list[bool]]:
    """Places (N, 3) [mm] on the block, least feed, segment and stop of each row."""
    half = 0.5 * STEP * (COUNT - 1)
    there = np.stack([np.linspace(-half, half, COUNT), np.full(COUNT, -15.0), np.full(COUNT, 90.0)], axis=1)
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 14)[1:-1]
    turn = np.stack([half + 15 * np.cos(angle), 15 * np.sin(angle), np.full(12, 90.0)], axis=1)
    back = there[::-1] * [1, -1, 1]
    least = [MIN_FEED] * COUNT + [0.0] * 13 + [MIN_FEED] * (COUNT - 1)
    segment = ["cut/there"] * COUNT + ["link/turn"] * 12 + ["cut/back"] * COUNT
    stop = [False] * (COUNT + 12) + [i == STOP for i in range(COUNT)]
    return np.concatenate([there, turn, back]), least, segment, stop


def tool_quaternion(job: str, row: int) -> str:
    """The head down, which the KUKA arm turns by a degree a row."""
    half = np.deg2rad(0.5 * row) if job == "kuka" else 0.0
    return f"0,{np.cos(half):.9f},{np.sin(half):.9f},0"


def write(folder: Path, job: str, **changes: object) -> Path:
    """The problem of a job as files in ``folder``, with fields of its operation changed."""
    arms = [arm[0] for arm in _ARMS[job]]
    columns = [f"{arm}.{c}" for arm in arms for c in ("x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz")]
    rows = [",".join([*columns, "feed_min_mm_s", "segment", "stop"])]
    for k, (place, least, segment, stop) in enumerate(zip(*lanes(), strict=True)):
        shifts = [0.0] if len(arms) == 1 else [-90.0, 90.0]
        poses = [
            f"{place[0] + x:.4f},{place[1]:.4f},{place[2]:.4f},{tool_quaternion(job, k)}" for x in shifts
        ]
        rows.append(",".join([*poses, f"{least:g}", segment, str(stop).lower()]))
    (folder / "beads.csv").write_text("\n".join(rows) + "\n")
    cell: dict[str, Any] = {
        "name": job,
        "arms": [
            {
                "name": name,
                "robot": robot,
                "base": {"xyz_mm": base, "rpy_deg": [0, 0, turned]},
                "tool": TOOL,
                "home_deg": home,
            }
            for name, robot, base, turned, home in _ARMS[job]
        ],
    }
    if job == "kuka":
        cell["controller"] = {"dialect": "krc4"}
    else:
        numbers = range(1, len(arms) + 1)
        cell["controller"] = {"tasks": [f"T_ROB{n}" for n in numbers], "units": [f"ROB_{n}" for n in numbers]}
    spin = [{"name": "spin", "arms": arms, "axis": "z", "turn_deg": [-180, 180]}] if job == "abb" else []
    operation = {
        "name": "beads",
        "process": "targets",
        "arms": arms,
        "file": "beads.csv",
        "feed_mm_s": FEED,
        "free": spin,
    }
    problem = {
        "tandem": 1,
        "name": "beads",
        "cell": cell,
        "accept": ["stock.hangs"],
        "stock": {"size_mm": [300, 120, 80], "place": {"xyz_mm": _BLOCK[job]}},
        "operations": [operation | changes],
    }
    (folder / "problem.yaml").write_text(yaml.safe_dump(problem, sort_keys=False))
    return folder / "problem.yaml"


@functools.cache
def problem(job: str) -> Problem:
    """The problem of a job; its files stay while the tests run."""
    return pipeline.load(write(Path(tempfile.mkdtemp(prefix="tandem-beads-")), job))


@functools.cache
def claims(job: str) -> dict[str, tuple[Claim, ...]]:
    """Claims that follow from the problem."""
    return dict(registry.claims(problem(job)))


@functools.cache
def outcome(job: str) -> pipeline.Outcome:
    """The planned and proven job."""
    made = pipeline.plan(problem(job))
    assert made.verified, made.proof.issues
    return made


def programs(job: str) -> dict[str, str]:
    """The proven programs of a job."""
    return dict(outcome(job).programs)
