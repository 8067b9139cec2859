"""``tandem align`` as a user meets it: the cell that it writes, and what it refuses."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from planner.cli import preparation as align_commands
from planner.geometry.arrays import from_rpy, inverse
from planner.geometry.units import DEG, MM
from planner.issues import TandemError
from planner.reading import strict_yaml
from planner.reading.problem import read_cell

CELL = Path(__file__).parents[2] / "problems" / "cells" / "two_irb140_facing.yaml"
LEFT = from_rpy([-0.85, 0.0, 0.0], [0.0, 0.0, 0.0])
TRUE = from_rpy([0.8612, 0.0134, -0.0021], np.array([0.2, -0.1, 179.3]) * DEG)
WORLD = np.array(
    [[0, -300, 400], [0, 300, 400], [50, 250, 800], [-50, -280, 750], [30, 10, 500], [-40, 0, 900]]
)
HEAD = "name,left.x_mm,left.y_mm,left.z_mm,right.x_mm,right.y_mm,right.z_mm\n"


def probe(world: NDArray[np.float64], base: NDArray[np.float64]) -> NDArray[np.float64]:
    into = inverse(base)
    return (world * MM @ into[:3, :3].T + into[:3, 3]) / MM


def points(path: Path, error_m: float = 0.0) -> Path:
    both = np.concatenate([probe(WORLD, LEFT), probe(WORLD, TRUE)], axis=1)
    both[2, 4] += error_m
    rows = [f"p{k + 1}," + ",".join(f"{v:.4f}" for v in row) for k, row in enumerate(both)]
    path.write_text(HEAD + "\n".join(rows) + "\n")
    return path


def align(folder: Path, error_m: float = 0.0, **given: object) -> align_commands.Align:
    csv = points(folder / "points.csv", error_m)
    return align_commands.Align(**({"cell": CELL, "points": csv, "output": folder / "new.yaml"} | given))  # type: ignore[arg-type]


def expect_refusal(request: align_commands.Align) -> list[str]:
    with pytest.raises(TandemError) as caught:
        align_commands.run_align(request)
    assert not request.output.exists()
    return [issue.code for issue in caught.value.issues]


def write_cell(folder: Path, old: str, new: str) -> Path:
    path = folder / "cell.yaml"
    text = (path if path.exists() else CELL).read_text()
    assert text.count(old) == 1
    path.write_text(text.replace(old, new))
    return path


def test_the_cell_has_the_base_and_nothing_else_changes(tmp_path: Path) -> None:
    assert align_commands.run_align(align(tmp_path)) == ()
    new, old = (tmp_path / "new.yaml").read_text().splitlines(), CELL.read_text().splitlines()
    changed = [k for k, (a, b) in enumerate(zip(new, old, strict=True)) if a != b]
    assert len(changed) == 1
    assert new[changed[0]].startswith("    base: {xyz_mm: [861.2, 13.4")
    cell = read_cell(strict_yaml.read(tmp_path / "new.yaml"))
    assert np.allclose(cell.arms[1].base, TRUE, atol=1e-6)
    assert np.array_equal(cell.arms[0].base, LEFT)


def test_the_first_arm_can_be_aligned_to_the_second(tmp_path: Path) -> None:
    right = np.array([850, 0, 0]), [0.0, 0.0, 180 * DEG]
    align_commands.run_align(align(tmp_path, arm="left"))
    cell = read_cell(strict_yaml.read(tmp_path / "new.yaml"))
    expected = from_rpy(right[0] * MM, right[1]) @ inverse(TRUE) @ LEFT
    assert np.allclose(cell.arms[0].base, expected, atol=1e-6)


@pytest.mark.parametrize(
    "layout",
    [
        "\n    base_auto: true # searched\n    base:\n      # by hand\n      rpy_deg:\n        - 0\n"
        "        - 1e-3\n        - 180 # about z\n      xyz_mm: [850, 0,\n        0]\n",
        "\n    base:\n      xyz_mm: [850, 0, 0] # from the drawing\n",
        "\n    base: {}\n",
        "\n    base:\n      {xyz_mm: [8.5e2, 0, 0]} # from the drawing\n",
        "\n    base:\n      rpy_deg: [0, 0, 180]\n    base_auto: true\n",
        "\n",
    ],
)
def test_every_layout_keeps_its_comments(tmp_path: Path, layout: str) -> None:
    cell = write_cell(tmp_path, "[3200, 2400, 100]", "[3.2e3, 2400, 1e2]")
    cell = write_cell(tmp_path, "\n    base: {xyz_mm: [850, 0, 0], rpy_deg: [0, 0, 180]}\n", layout)
    align_commands.run_align(align(tmp_path, cell=cell))
    text = (tmp_path / "new.yaml").read_text()
    new = read_cell(strict_yaml.read(tmp_path / "new.yaml"))
    assert np.allclose(new.arms[1].base, TRUE, atol=1e-6)
    assert not new.arms[1].base_auto
    for comment in ("# searched", "# by hand", "# about z", "# from the drawing"):
        assert (comment in text) == (comment in layout)


def test_an_alias_is_refused_with_a_remedy(tmp_path: Path) -> None:
    cell = write_cell(tmp_path, "{xyz_mm: [-850, 0, 0], rpy_deg: [0, 0, 0]}", "&b {xyz_mm: [-850, 0, 0]}")
    cell.write_text(cell.read_text().replace("{xyz_mm: [850, 0, 0], rpy_deg: [0, 0, 180]}", "*b"))
    assert expect_refusal(align(tmp_path, cell=cell)) == ["align.cell"]


def test_a_bad_point_stops_it_until_it_is_left_out(tmp_path: Path) -> None:
    assert expect_refusal(align(tmp_path, error_m=2.0)) == ["align.bad_point"]
    align_commands.run_align(align(tmp_path, error_m=2.0, leave_out=("p3",)))
    cell = read_cell(strict_yaml.read(tmp_path / "new.yaml"))
    assert np.allclose(cell.arms[1].base, TRUE, atol=1e-6)


def test_what_else_is_refused(tmp_path: Path) -> None:
    assert expect_refusal(align(tmp_path, arm="middle")) == ["align.cell"]
    assert expect_refusal(align(tmp_path, leave_out=("p9",))) == ["align.file"]
    assert expect_refusal(align(tmp_path, leave_out=("p1", "p2", "p3", "p4"))) == ["align.few_points"]
    assert expect_refusal(align(tmp_path, tolerance_mm=0.0)) == ["align.file"]
    searched = write_cell(tmp_path, "rpy_deg: [0, 0, 0]}\n", "rpy_deg: [0, 0, 0]}\n    base_auto: true\n")
    assert expect_refusal(align(tmp_path, cell=searched)) == ["align.cell"]
    assert expect_refusal(align(tmp_path, cell=CELL.parent / "irb140_bow.yaml")) == ["align.cell"]
    assert expect_refusal(align(tmp_path, cell=tmp_path / "none.yaml")) == ["problem.missing_file"]
    (tmp_path / "file").write_text("")
    request = align(tmp_path)
    there = align(tmp_path, output=tmp_path / "file" / "new.yaml")
    with pytest.raises(TandemError, match="cannot be written"):
        align_commands.run_align(there)
    text = request.points.read_text().splitlines(keepends=True)
    inches = [text[0]] + [
        row.split(",")[0] + "," + ",".join(f"{float(v) * 25.4:.3f}" for v in row.split(",")[1:]) + "\n"
        for row in text[1:]
    ]
    request.points.write_text("".join(inches))
    assert set(expect_refusal(request)) == {"align.units"}


def test_meshes_that_the_cell_names_must_be_found_from_the_new_place(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    (tmp_path / "a" / "box.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
    )
    shape = "{kind: box, size_mm: [3200, 2400, 100], pose: {xyz_mm: [0, 0, -50]}}"
    mesh = "{kind: mesh, file: box.obj, unit: m, pose: {xyz_mm: [0, 0, -1500]}}"
    cell = write_cell(tmp_path / "a", shape, mesh)
    assert expect_refusal(align(tmp_path, cell=cell, output=tmp_path / "b" / "new.yaml")) == ["align.cell"]
    align_commands.run_align(align(tmp_path, cell=cell, output=tmp_path / "a" / "new.yaml"))


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("name,left.x_mm", "name,left.x", "'left.x_mm' 0 times"),
        ("p2,", "p1,", "'p1' again"),
        ("p2,", ",", "no name"),
        ("p2,", "p2,nan,", "8 values"),
        ("p2,850.0000", "p2,about", "'about'"),
        ("p2,850.0000", "p2,1e9", "'1e9'"),
    ],
)
def test_faults_of_the_points_are_named(tmp_path: Path, old: str, new: str, what: str) -> None:
    request = align(tmp_path)
    text = request.points.read_text()
    assert text.count(old) == 1
    request.points.write_text(text.replace(old, new))
    with pytest.raises(TandemError) as caught:
        align_commands.run_align(request)
    assert {i.code for i in caught.value.issues} == {"align.file"}
    assert what in str(caught.value)


def test_semicolons_and_decimal_commas_are_read(tmp_path: Path) -> None:
    request = align(tmp_path)
    request.points.write_text(
        "# probed on Monday\n" + request.points.read_text().replace(",", ";").replace(".", ",")
    )
    request.points.write_text(
        request.points.read_text().replace("left,", "left.").replace("right,", "right.")
    )
    assert align_commands.run_align(request) == ()


def test_the_command_and_its_exit_codes(tmp_path: Path) -> None:
    def run(csv: Path) -> subprocess.CompletedProcess[str]:
        command = [
            sys.executable,
            "-m",
            "planner",
            "align",
            str(CELL),
            str(csv),
            "-o",
            str(tmp_path / "n.yaml"),
        ]
        return subprocess.run(
            command,
            capture_output=True,
            text=True,
            check=False,
            timeout=120,
            env={**os.environ, "COLUMNS": "200"},
        )

    done = run(points(tmp_path / "bad.csv", error_m=2.0))
    assert done.returncode == 2
    assert "align.bad_point" in done.stderr
    assert "BAD" in done.stdout
    assert not (tmp_path / "n.yaml").exists()
    done = run(points(tmp_path / "good.csv"))
    assert done.returncode == 0, done.stderr
    assert "xyz_mm [861.2, 13.4" in done.stdout
    assert (tmp_path / "n.yaml").exists()
