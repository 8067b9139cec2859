"""Problem files: all faults at once, each with its field and line. A good file becomes values in SI units."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import TypeAdapter

from planner.claims.handshake import Handshake
from planner.issues import Issue, TandemError
from planner.pipeline import load
from planner.problem import Controller, Settings
from planner.reading import cell
from planner.reading.controller import ControllerFile, build_controller
from planner.reading.problem import SettingsFile, bundle
from planner.tooling import CutterGeometry, Tool, bow, disk_tool, gripper_plate, mill, vacuum_cup

GOOD = """\
tandem: 1
name: small
cell:
  name: one
  arms:
    - name: left
      robot: irb140
      base: {xyz_mm: [-800, 0, 0]}
      tool: {kind: wire_holder, mounting: across, side: start}
    - name: right
      robot: irb140
      base: {xyz_mm: [800, 0, 0], rpy_deg: [0, 0, 180]}
      tool: {kind: wire_holder, mounting: across, side: end}
  obstacles:
    - name: table
      shapes: [{kind: box, size_mm: [500, 500, 20], pose: {xyz_mm: [0, 0, -10]}}]
stock: {size_mm: [160, 300, 100], place: {xyz_mm: [0, 0, 600], rpy_deg: [0, 0, 90]}}
settings: {clearance_mm: 15}
operations:
  - name: poses
    process: targets
    arms: [left, right]
    file: targets.csv
"""


def expect_refusal(folder: Path, text: str) -> tuple[Issue, ...]:
    path = folder / "problem.yaml"
    path.write_text(text)
    with pytest.raises(TandemError) as caught:
        load(path)
    return caught.value.issues


def test_a_good_file_becomes_values_in_si(tmp_path: Path) -> None:
    path = tmp_path / "problem.yaml"
    path.write_text(GOOD)
    problem = load(path)
    assert problem.name == "small"
    np.testing.assert_allclose(problem.stock.size, [0.16, 0.3, 0.1])
    np.testing.assert_allclose(problem.cell.arm("right").base[:3, 3], [0.8, 0, 0])
    assert problem.stock.place is not None
    np.testing.assert_allclose(problem.stock.place[:3, 0], [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(problem.stock.gravity, [0, 0, -1])
    assert problem.settings.clearance == pytest.approx(0.015)
    assert [op.process for op in problem.operations] == ["targets"]


def test_the_digest_covers_the_files_that_are_named(tmp_path: Path) -> None:
    path = tmp_path / "problem.yaml"
    path.write_text(GOOD)
    without = load(path).digest
    (tmp_path / "targets.csv").write_text("a\n")
    with_file = load(path).digest
    (tmp_path / "targets.csv").write_text("b\n")
    assert len({without, with_file, load(path).digest}) == 3


def test_all_faults_come_at_once_with_their_lines(tmp_path: Path) -> None:
    text = (
        GOOD.replace("size_mm: [160, 300, 100]", "size_mm: [160, -300, .nan]")
        .replace("settings: {clearance_mm: 15}", "settings: {clearence_mm: 15}")
        .replace("process: targets", "process: lasers")
    )
    issues = expect_refusal(tmp_path, text)
    result = {(issue.code, issue.field, issue.line) for issue in issues}
    assert ("problem.field", "stock.size_mm.1", 17) in result
    assert ("problem.not_finite", "stock.size_mm.2", 17) in result
    assert ("problem.field", "settings.clearence_mm", 18) in result
    assert ("problem.unknown_process", "operations.0.process", 21) in result
    messages = "\n".join(issue.message for issue in issues)
    assert "unknown key" in messages
    assert "known are elastic_wire, forming, milling, straight_wire, targets" in messages


FIRST_ROBOT = "robot: irb140\n      base: {xyz_mm: [-8"
BOX = "kind: box, size_mm: [500, 500, 20]"
FAULTS = [
    (FIRST_ROBOT, FIRST_ROBOT.replace("140", "9"), "problem.unknown_robot", "irb140"),
    ("arms: [left, right]", "arms: [left, middle]", "problem.unknown_arm", "middle"),
    ("- name: right", "- name: Left", "problem.duplicate_name", "Left"),
    ("    file: targets", "    arm: left\n    file: targets", "problem.field", "operations.0.arm"),
    ("tandem: 1", "tandem: 2", "problem.field", "tandem"),
    ("name: small", "name: 9lives", "problem.field", "name"),
    ("clearance_mm: 15", "clearance_mm: -1", "problem.field", "clearance_mm"),
    (BOX, "kind: mesh, file: no.stl, unit: mm", "problem.missing_file", "no.stl"),
    (BOX, "kind: mesh, file: no.stl", "problem.field", "cell.obstacles.0.shapes.0.unit"),
]


@pytest.mark.parametrize(("old", "new", "code", "words"), FAULTS)
def test_each_fault_has_its_code(tmp_path: Path, old: str, new: str, code: str, words: str) -> None:
    assert old in GOOD
    issues = expect_refusal(tmp_path, GOOD.replace(old, new))
    hits = [issue for issue in issues if issue.code == code]
    assert hits, [str(issue) for issue in issues]
    assert words in str(hits[0])


def test_a_missing_cell_file_is_named(tmp_path: Path) -> None:
    start, end = GOOD.index("cell:"), GOOD.index("stock:")
    (issue,) = expect_refusal(tmp_path, GOOD[:start] + "cell: no_cell.yaml\n" + GOOD[end:])
    assert issue.code == "problem.missing_file"
    assert issue.field == "cell"
    assert issue.line == 3


def test_no_operation_is_no_problem(tmp_path: Path) -> None:
    issues = expect_refusal(tmp_path, GOOD[: GOOD.index("operations:")] + "operations: []\n")
    assert issues[0].field == "operations"


def test_a_bundle_reads_as_the_same_problem(tmp_path: Path) -> None:
    (tmp_path / "cells").mkdir()
    (tmp_path / "job").mkdir()
    start, end = GOOD.index("cell:"), GOOD.index("stock:")
    inner = "\n".join(line[2:] for line in GOOD[start:end].splitlines()[1:]) + "\n"
    (tmp_path / "cells" / "one.yaml").write_text(inner)
    path = tmp_path / "job" / "problem.yaml"
    path.write_text("# a comment\n" + GOOD[:start] + "cell: ../cells/one.yaml\n" + GOOD[end:])
    (tmp_path / "job" / "targets.csv").write_text("left.x_mm\n1\n")
    problem = load(path)
    for name, content in bundle(problem).items():
        target = tmp_path / "elsewhere" / name
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(content)
    again = load(tmp_path / "elsewhere" / "problem.yaml")
    assert again.digest == problem.digest
    assert again.operations[0].file.read_text() == "left.x_mm\n1\n"  # type: ignore[attr-defined]


def test_what_a_file_leaves_out_is_what_values_in_python_leave_out() -> None:
    """To the last bit, as the same plan comes of both."""
    assert SettingsFile().to_settings() == Settings()
    assert Settings() == Settings(0.01, None, 0.9, 0.8, np.deg2rad(2.0), np.deg2rad(5.0), 0.25, 0)
    arms = ["left", "right"]
    assert build_controller(ControllerFile.model_validate({}), arms) == Controller()
    assert build_controller(ControllerFile.model_validate({"max_kilobytes": 1000}), arms) == Controller()
    two = build_controller(ControllerFile.model_validate({"sync": "handshake"}), arms)
    assert two.tasks == ("T_ROB1", "T_ROB1") and two.units == ("ROB_1", "ROB_1")
    meets, usual = two.handshake, Handshake()
    assert (meets.kind, meets.every, meets.timeout, meets.patience) == ("four_phase", 1, 30.0, 3600.0)
    assert (usual.kind, usual.every, usual.timeout, usual.patience) == ("four_phase", 1, 30.0, 3600.0)
    assert {meets.of(arm) for arm in arms} == {usual.of("left")}


@pytest.mark.parametrize(
    ("fields", "expected_tool"),
    [
        ({"kind": "bow"}, bow()),
        ({"kind": "gripper_plate"}, gripper_plate(0.16, 0.16)),
        ({"kind": "vacuum_cup"}, vacuum_cup(0.06)),
        ({"kind": "disk_tool"}, disk_tool(25.4e-3, 0.3, 0.012, 9.525e-3)),
        (
            {"kind": "mill", "diameter_mm": 12, "flute_mm": 40, "overhang_mm": 60},
            mill(CutterGeometry("cylinder", 0.006, 0.0, 0.04, 0.06)),
        ),
    ],
)
def test_sizes_of_tools_that_a_file_leaves_out_are_those_of_their_makers(
    fields: Any, expected_tool: Tool
) -> None:
    read = cell.build_tool(TypeAdapter(cell.ToolFile).validate_python(fields), Path())
    np.testing.assert_array_equal(read.tcp, expected_tool.tcp)
    assert read.mass == expected_tool.mass
    for ours, theirs in zip(read.shapes, expected_tool.shapes, strict=True):
        assert ours.size == theirs.size
        np.testing.assert_array_equal(ours.pose, theirs.pose)
