"""Setups: what an operator changes between operations, blocks that an arm holds, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

import planner
from planner.issues import TandemError

CELL = {
    "arms": [
        {"name": "left", "robot": "irb140", "base": {"xyz_mm": [-850, 0, 0]}, "tool": {"kind": "bow"}},
        {
            "name": "right",
            "robot": "irb140",
            "base": {"xyz_mm": [850, 0, 0], "rpy_deg": [0, 0, 180]},
            "tool": {"kind": "gripper_plate"},
        },
    ]
}
OPERATION = {"process": "targets", "arms": ["left"], "file": "targets.csv"}


def load(tmp_path: Path, stock: dict, *operations: dict) -> planner.Problem:
    """The problem of these operations on a block, with the cell above."""
    block = {"size_mm": [300, 200, 100], "foam": "eps_a120", **stock}
    jobs = [{"name": f"job_{'abc'[i]}", **OPERATION, **more} for i, more in enumerate(operations or ({},))]
    path = tmp_path / "problem.yaml"
    path.write_text(
        yaml.safe_dump({"tandem": 1, "name": "setups", "cell": CELL, "stock": block, "operations": jobs})
    )
    return planner.load(path)


def codes(tmp_path: Path, stock: dict, *operations: dict) -> list[tuple[str, str]]:
    """Return codes and messages of a refusal."""
    with pytest.raises(TandemError) as caught:
        load(tmp_path, stock, *operations)
    return [(issue.code, issue.message) for issue in caught.value.issues]


def test_a_job_without_changes_is_one_setup_and_asks_nothing(tmp_path: Path) -> None:
    (setup,) = load(tmp_path, {}, {}, {}).setups
    assert setup.operations == (0, 1)
    assert setup.steps == ()


def test_what_is_not_changed_stays_as_it_was(tmp_path: Path) -> None:
    place = {"xyz_mm": [0, 0, 500]}
    tool = {"kind": "wire_holder", "side": "end"}
    problem = load(
        tmp_path, {"place": place}, {}, {"setup": {"tools": {"right": tool}}}, {"setup": {"note": "Wipe."}}
    )
    first, second, third = problem.setups
    assert [s.operations for s in problem.setups] == [(0,), (1,), (2,)]
    assert first.cell.arm("right").tool.name == "gripper_plate"
    assert second.cell.arm("right").tool.name == third.cell.arm("right").tool.name == "wire_holder_across_end"
    assert second.cell.arm("left").tool.name == "bow_400"
    assert third.stock.place[2, 3] == pytest.approx(0.5)
    assert second.steps == ("Mount the tool wire_holder_across_end on arm right.",)
    assert third.steps == ("Wipe.",)
    assert first.steps  # a job with changes begins with its tools and block told
    assert len({s.confirmation for s in problem.setups}) == 3


def test_a_block_is_clamped_anew(tmp_path: Path) -> None:
    problem = load(
        tmp_path,
        {"place": {"xyz_mm": [0, 0, 500]}, "oversize_mm": [[10, 20], [0, 0], [5, 6]]},
        {},
        {"setup": {"place": {"xyz_mm": [0, 0, 500], "rpy_deg": [0, 0, 90]}, "oversize_mm": [[0, 0]] * 3}},
    )
    first, second = problem.setups
    np.testing.assert_allclose(first.stock.lower, [-0.16, -0.1, -0.005])
    np.testing.assert_allclose(first.stock.upper, [0.17, 0.1, 0.106])
    np.testing.assert_allclose(second.stock.box, [[-0.15, -0.1, 0.0], [0.15, 0.1, 0.1]])
    np.testing.assert_allclose(second.stock.place[:2, :2], [[0, -1], [1, 0]], atol=1e-12)
    assert second.steps == ("Clamp the block in its new place as the setup sheet says.",)


def test_a_held_block_weighs_what_its_foam_weighs(tmp_path: Path) -> None:
    problem = load(tmp_path, {"held_by": "right"})
    (setup,) = problem.setups
    assert setup.stock.mass == pytest.approx(0.3 * 0.2 * 0.1 * setup.stock.foam.density)
    assert setup.steps == ("Fix the block to the gripper of arm right as the setup sheet says.",)


@pytest.mark.parametrize(
    ("stock", "code", "word"),
    [
        ({"held_by": "left"}, "stock.gripper", "gripper_plate"),
        ({"held_by": "middle"}, "problem.unknown_arm", "left, right"),
        ({"held_by": "right", "foam": None}, "stock.foam_missing", "foam"),
        ({"held_by": "right", "foam": "granite"}, "kerf.unknown_foam", "eps_a120"),
        ({"held_by": "right", "size_mm": [2000, 2000, 1000]}, "stock.too_heavy", "carries 6 kg"),
        ({"held_by": "right", "size_mm": [150, 200, 100]}, "stock.footprint", "5.0 mm"),
        ({"held_by": "right", "grip": {"xyz_mm": [90, 0, 0]}}, "stock.footprint", "20.0 mm"),
        (
            {"held_by": "right", "support": [{"kind": "sphere", "radius_mm": 9}]},
            "problem.field",
            "support: []",
        ),
        ({"held_by": "right", "grip": {"xyz_mm": [0, 0, 3]}}, "stock.footprint", "3.0 mm off"),
        ({"held_by": "right", "grip": {"rpy_deg": [180, 0, 0]}}, "stock.footprint", "180.0 degrees"),
        (
            {"held_by": "right", "grip": {}, "oversize_mm": [[0, 0], [0, 0], [8, 0]]},
            "stock.footprint",
            "with 8 as its z",
        ),
    ],
)
def test_what_cannot_be_held_is_refused(tmp_path: Path, stock: dict, code: str, word: str) -> None:
    result = codes(tmp_path, stock)
    assert [c for c, _ in result] == [code]
    assert word in result[0][1]


def test_a_gripper_must_hold_three_times_the_blocks_weight(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """0.006 m3 of 22 kg/m3 weigh 1.29 N; a stated force of 3.8 N is too little, 3.9 N are enough."""
    for force, fits in ((3.8, False), (3.9, True)):
        tool = {"kind": "vacuum_cup", "holding_n": force}
        monkeypatch.setitem(CELL["arms"][1], "tool", tool)
        if fits:
            assert load(tmp_path, {"held_by": "right"}).stock.mass == pytest.approx(0.132)
        else:
            assert [c for c, _ in codes(tmp_path, {"held_by": "right"})] == ["stock.grip_force"]


@pytest.mark.parametrize(
    ("setup", "code"),
    [
        ({"tools": {"middle": {"kind": "bow"}}}, "problem.unknown_arm"),
        ({"tools": {"left": {"kind": "plain", "tcp": {}, "mass_kg": 10}}}, "problem.field"),
        ({"tools": {"left": {"kind": "spoon"}}}, "problem.field"),
        ({"held_by": "left"}, "stock.gripper"),
        ({"roll_pitch_deg": [90, 0]}, "problem.field"),
        ({"colour": "red"}, "problem.field"),
    ],
)
def test_faults_of_a_setup_are_told_with_their_field(tmp_path: Path, setup: dict, code: str) -> None:
    with pytest.raises(TandemError) as caught:
        load(tmp_path, {}, {}, {"setup": setup})
    (issue,) = caught.value.issues
    assert issue.code == code
    assert issue.field is not None
    assert issue.field.startswith("operations.1.setup")
    assert issue.line is not None


def test_a_foam_of_the_users_own_comes_from_its_file_and_travels_with_the_result(tmp_path: Path) -> None:
    fields = {"tandem_foam": 1, "name": "mine", "density_kg_m3": 17, "specific_heat_j_kg_k": 1400}
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump({**fields, "melt_temperature_c": 240}))
    problem = load(tmp_path, {"foam": {"file": "mine.yaml"}})
    assert problem.stock.foam.name == "mine"
    assert problem.stock.mass == pytest.approx(0.3 * 0.2 * 0.1 * 17)
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump({**fields, "melt_temperature_c": 250}))
    assert load(tmp_path, {"foam": {"file": "mine.yaml"}}).digest != problem.digest
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump({**fields, "melt_temperature_c": -3}))
    assert codes(tmp_path, {"foam": {"file": "mine.yaml"}})[0][0] == "kerf.foam_file"
    assert codes(tmp_path, {"foam": {"file": "nowhere.yaml"}})[0][0] == "problem.missing_file"
