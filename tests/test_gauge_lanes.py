"""The bundled table of poses: its script writes it, it lies at the right position, is planned and proven."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest

import planner
from planner import pipeline
from planner.catalogue import robots
from planner.processes import registry

FOLDER = robots.data_dir("problems") / "gauge_lanes"


def test_the_table_is_what_its_script_writes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    spec = importlib.util.spec_from_file_location("make_targets", FOLDER / "make_targets.py")
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    monkeypatch.setattr(script, "HERE", tmp_path)
    script.write()
    assert (tmp_path / "targets.csv").read_text() == (FOLDER / "targets.csv").read_text()


def test_every_pose_looks_at_the_vault_from_25_mm() -> None:
    """Against the cylinder itself: radius 300 mm about y, its ridge 80 mm above the stock's frame."""
    made = registry.job(pipeline.load("gauge_lanes"), 0).targets()
    pose = made.pose["robot"]
    to_axis = np.array([0.0, 0.0, 0.080 - 0.300]) - pose[:, :3, 3] * [1.0, 0.0, 1.0]
    np.testing.assert_allclose(np.linalg.norm(to_axis, axis=1), 0.325, atol=1e-6)
    np.testing.assert_allclose(pose[:, :3, 2], to_axis / 0.325, atol=1e-6)
    assert [str(item) for item in dict.fromkeys(made.segment) if item.kind == "cut"] == [
        f"cut/lane{number}" for number in (1, 2, 3, 4)
    ]


def test_it_is_planned_and_proven() -> None:
    outcome = planner.plan(pipeline.load("gauge_lanes"))
    assert outcome.verified
    assert outcome.issues == ()
    assert any("TandemCut" in name for name in outcome.programs)
    of_poses, of_wires = outcome.proof.rule("verify.follows"), outcome.proof.rule("verify.wire_length")
    assert of_poses.applies
    assert (of_wires.applies, of_wires.where, of_wires.limit) == (False, "no bent wire", None)
    held, asked, others = outcome.proof.rule_counts
    assert held == asked == len(outcome.proof.rules) - others
    assert others > 30  # wires, sheets, cutters, torches
