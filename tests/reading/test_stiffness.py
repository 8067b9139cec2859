"""Joint stiffness in cell files and in the catalogue: what is read, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from planner import pipeline, spec
from planner.catalogue import robots
from planner.issues import TandemError
from tests.proof.planner_jobs import JOBS

STIFFNESS: dict[str, Any] = {
    "joints_nm_rad": [3.1e5, 3.3e5, 2.2e5, 6.0e4, 6.0e4, 4.0e4],
    "source": "made up for this test",
}


def problem(folder: Path, **arm: Any) -> Path:
    """Return a job of one arm with additional keys of that arm."""
    path = JOBS["posed"](folder)
    data = yaml.safe_load(path.read_text())
    data["cell"]["arms"][0] |= arm
    path.write_text(yaml.safe_dump(data))
    return path


def test_an_arm_has_what_its_file_states_with_its_source(tmp_path: Path) -> None:
    arm = pipeline.load(problem(tmp_path, stiffness=STIFFNESS)).cell.arms[0]
    assert arm.stiffness is not None
    np.testing.assert_array_equal(arm.stiffness.joints, STIFFNESS["joints_nm_rad"])
    assert arm.stiffness.source == "made up for this test"
    assert spec.Stiffness(**STIFFNESS)["source"] == "made up for this test"


def test_forces_and_sag_are_said_in_python() -> None:
    poses = {"left": np.eye(4)[None].repeat(2, axis=0)}
    said = spec.Targets(name="scan", poses=poses, unit="m", forces={"left": spec.Force(force_n=[0, 0, 30])})
    assert said["forces"] == {"left": {"force_n": [0, 0, 30]}}
    assert spec.Sag(load=False)["load"] is False
    with pytest.raises(TandemError) as refused:
        spec.Targets(name="scan", poses=poses, unit="m", forces={"left": {"force_n": [0, 0]}})
    assert refused.value.issues[0].message.startswith("Targets: forces.left.force_n: entry 2")


def test_no_robot_of_the_catalogue_has_any_and_an_arm_without_it_has_none(tmp_path: Path) -> None:
    assert all(robots.robot(name).stiffness is None for name in robots.robot_names())
    assert pipeline.load(problem(tmp_path)).cell.arms[0].stiffness is None


@pytest.mark.parametrize(
    ("change", "expected_text"),
    [
        ({"joints_nm_rad": [3.1e5, 3.3e5, 2.2e5, 6.0e4, 6.0e4]}, "entry 5, counted from 0, is missing"),
        ({"joints_nm_rad": [1e5] * 7}, "joints_nm_rad"),
        ({"joints_nm_rad": [1e5, -1e5, 1e5, 1e5, 1e5, 1e5]}, "joints_nm_rad.1"),
        ({"joints_nm_rad": [1e5, 0, 1e5, 1e5, 1e5, 1e5]}, "greater than or equal to 1000"),
        ({"joints_nm_rad": [0.31, 0.33, 0.22, 0.06, 0.06, 0.04]}, "greater than or equal to 1000"),
        ({"joints_nm_rad": [float("nan")] * 6}, "joints_nm_rad"),
        ({"joints_nm_rad": None}, "joints_nm_rad"),
        ({"source": ""}, "source"),
        ({"source": None}, "source"),
        ({"joints_n_mm_deg": [1] * 6}, "unknown key"),
    ],
)
def test_what_is_no_stiffness_of_six_joints_is_refused_by_field(
    change: dict[str, Any], expected_text: str, tmp_path: Path
) -> None:
    with pytest.raises(TandemError) as refused:
        pipeline.load(problem(tmp_path, stiffness={**STIFFNESS, **change}))
    issues = refused.value.issues
    assert {issue.code for issue in issues} <= {"problem.field", "problem.not_finite"}
    assert all("cell.arms.0.stiffness" in (issue.field or "") for issue in issues)
    assert any(expected_text in issue.message for issue in issues)


def test_a_catalogue_entry_without_a_source_is_a_damaged_one() -> None:
    entry = {"joints_nm_rad": [1e6] * 6, "source": "somebody 2020"}
    assert robots._stiffness("x", entry) is not None
    for wrong in ({"source": ""}, {"joints_nm_rad": [1e6] * 5}, {"joints_nm_rad": [1e6] * 5 + [-1.0]}):
        with pytest.raises(TandemError) as refused:
            robots._stiffness("x", {**entry, **wrong})
        assert refused.value.issues[0].code == "catalogue.missing_data"
