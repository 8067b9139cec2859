"""Results in COMPAS and COMPAS FAB, run by the separate Python that ``TANDEM_COMPAS_PYTHON`` names.

Their dependencies change the behaviour of trimesh, so they stay out of the planner's own environment.
"""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

import planner
from planner.catalogue.robots import urdf_path
from planner.geometry.arrays import FloatArray, inverse
from tests import small_problem
from tests.service.support import ROOT, Process

PYTHON = os.environ.get("TANDEM_COMPAS_PYTHON", "")
AGAIN = "  - {name: again, process: targets, arms: [left], file: again.csv, frame: world}\n"


def poses(rows: list[list[float]]) -> FloatArray:
    """Poses (N, 4, 4) of frames: point, x axis, y axis."""
    frame = np.array(rows)
    out = np.tile(np.eye(4), (len(frame), 1, 1))
    out[:, :3, 3], out[:, :3, 0], out[:, :3, 1] = frame[:, :3], frame[:, 3:6], frame[:, 6:9]
    out[:, :3, 2] = np.cross(frame[:, 3:6], frame[:, 6:9])
    return out


@pytest.mark.skipif(not PYTHON, reason="no COMPAS FAB: TANDEM_COMPAS_PYTHON is not set")
def test_a_result_is_read_by_compas(tmp_path: Path) -> None:
    rows = [f"{small_problem.COLUMNS},segment", *(f"{row},cut/again" for row in small_problem.ROWS)]
    (tmp_path / "again.csv").write_text("\n".join(rows))
    problem = planner.load(small_problem.write(tmp_path, small_problem.PROBLEM + AGAIN))
    outcome = planner.plan(problem)
    outcome.save(tmp_path / "out", pages=False)
    service = Process(tmp_path / "data").wait()
    command = [PYTHON, str(Path(__file__).with_name("compas_round_trip.py")), str(tmp_path / "out")]
    command += [str(urdf_path("irb140")), service.url]
    command += [str(ROOT / "problems" / "cells" / "two_irb140_facing.yaml")]
    beside = {**os.environ, "PYTHONPATH": f"{ROOT / 'integrations' / 'compas'}{os.pathsep}{ROOT / 'client'}"}
    try:
        done = subprocess.run(command, env=beside, capture_output=True, text=True, check=False, timeout=300)
    finally:
        service.stop()
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)

    expected = np.array([[float(word) for word in row.split(",")] for row in small_problem.ROWS])
    own, arm = outcome.plan.operations[0], problem.cell.arms[0]
    frames = poses(said["frames"])
    assert np.abs(frames[:, :3, 3] - expected[:, :3] * 1e-3).max() < 1e-9
    assert np.abs(inverse(poses(said["flange"])) @ frames - arm.tool.tcp).max() < 1e-6
    assert said["joints"] == list(arm.data.joints)
    assert np.abs(np.array(said["trajectory"]) - own.q["left"]).max() < 1e-9
    assert np.abs(np.array(said["times"]) - own.time + own.time[0]).max() < 1e-6
    assert (said["base"], said["block"]) == ([0, 0, 0], [0.45, 0, 0])
    assert np.abs(np.array(said["held"]) - frames[2, :3, 3] - 0.01 * frames[2, :3, 2]).max() < 1e-9
    asked = ("operation: got None, allowed: poses, again", "arm: got 'right'", "arm: got 'right'")
    asked += ("joints: got 1 names", "frames: got {'left': 6, 'right': 0}")
    assert len(said["refused"]) == len(asked)
    assert all(words in expected_text for words, expected_text in zip(asked, said["refused"], strict=True)), (
        said["refused"]
    )
    assert said["pose"]["xyz_mm"] == pytest.approx([100, 200, 300])
    assert said["pose"]["rpy_deg"] == pytest.approx([90, 0, 90])
    assert said["state"] == "verified"
    assert np.abs(np.array(said["planned"]) - said["frames"]).max() < 1e-9
    assert said["panel"]["issues"] == []
    size = np.ptp(np.array(said["panel"]["summary"]["part_mm"]), axis=0)
    assert size[:2] == pytest.approx([120, 300], abs=0.1), "metres of the mesh"
    assert said["area"] == pytest.approx(1.0)
