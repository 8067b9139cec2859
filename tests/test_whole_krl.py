"""KUKA arms end to end: from a problem file to proven KRL."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import planner
from planner import pipeline
from planner.pipeline import Outcome
from tests import small_forming

HOME = [0, -110, 110, 0, 60, 0]
UPRIGHT = {"xyz_mm": [250, -1030, 900], "rpy_deg": [90, 0, -84.5]}


def plan_krl(folder: Path, data: dict[str, Any]) -> Outcome:
    return planner.plan(planner.load(small_forming.write(folder, data, small_forming.dish(around=180))))


@pytest.mark.long
@pytest.mark.parametrize(("dialect", "word"), [("krc4", "SLIN"), ("krc2", "LIN")])
def test_one_arm_forms_a_dish(tmp_path: Path, dialect: str, word: str) -> None:
    data = small_forming.problem("spif")
    data["cell"]["arms"][0] |= {"robot": "kr10_r1100", "home_deg": HOME}
    data["cell"]["controller"] = {"dialect": dialect}
    outcome = plan_krl(tmp_path, data)
    assert outcome.verified
    assert sorted(outcome.programs) == ["robot/dish.dat", "robot/dish.src", "robot/dish_1.src"]
    assert f"\r\n{word} {{X " in outcome.programs["robot/dish_1.src"]
    assert "Proven: " in outcome.programs["robot/dish.src"]
    outcome.save(tmp_path / "out")
    again = pipeline.verify(outcome.problem, pipeline.read_programs(tmp_path / "out"))
    assert again.ok


@pytest.mark.long
@pytest.mark.parametrize("left", ["kr210_r2700", "irb6640_185"])
def test_two_arms_of_one_or_two_brands_form_a_dish_by_handshake(tmp_path: Path, left: str) -> None:
    data = small_forming.problem("dsif", tangent_deg=3, handshake_gap_mm=10)
    data["cell"]["arms"][1] |= {"robot": "kr60_ha", "home_deg": HOME}
    if left.startswith("kr"):
        data["cell"]["arms"][0] |= {"robot": left, "home_deg": HOME}
    numbers = {"doPartner": 1, "diPartner": 2, "doRunning": 3, "diPartnerRunning": 4, "doMoveEnable": 5}
    data["cell"]["controller"] = {
        "sync": "handshake",
        "handshake": {"every": 5},
        "io": {"left": numbers, "right": numbers},
    }
    data["sheet"]["place"] = UPRIGHT
    outcome = plan_krl(tmp_path, data)
    assert outcome.verified, outcome.issues
    kinds = {
        arm: {Path(n).suffix for n in outcome.programs if n.startswith(arm)} for arm in ("left", "right")
    }
    assert kinds["right"] == {".src", ".dat"}
    assert kinds["left"] == ({".src", ".dat"} if left.startswith("kr") else {".mod", ".pgf"})


@pytest.mark.long
@pytest.mark.parametrize("name", ["engrave", "flank_wall"])
def test_one_arm_mills_from_krl(tmp_path: Path, name: str) -> None:
    """The spindle's output is switched by its number, and each face is within its tolerance."""
    outcome = planner.plan(planner.load(name))
    assert outcome.verified, outcome.issues
    text = "".join(outcome.programs.values())
    programs = [file for file in outcome.programs if not file.startswith("controller/")]
    assert {Path(file).suffix for file in programs} == {".src", ".dat"}
    assert "$OUT[17]=TRUE" in text and "$OUT[17]=FALSE" in text
    assert len(outcome.proof.surfaces) == {"engrave": 1, "flank_wall": 4}[name]
    for face in outcome.proof.surfaces:
        assert face.share >= face.wanted_share, face.segment
    outcome.save(tmp_path / "out")
    assert pipeline.verify(outcome.problem, pipeline.read_programs(tmp_path / "out")).ok
