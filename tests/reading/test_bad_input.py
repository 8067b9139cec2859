"""Hostile and clumsy input: every wrong file gives issues with their location, never another exception."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from planner import pipeline
from planner.issues import TandemError
from tests import small_problem
from tests.refusals import CAPITAL, CELL, HYPAR, OPERATION, change, codes, expect_refusal

BILLION = "a: &a [1,1,1,1,1,1,1,1,1,1]\n" + "".join(
    f"{chr(98 + i)}: &{chr(98 + i)} [{','.join(['*' + chr(97 + i)] * 10)}]\n" for i in range(12)
)
NOT_PROBLEMS = {
    "binary": (bytes(range(256)) * 40, "problem.not_yaml"),
    "zip": (b"PK\x03\x04\x14\x00\x00\x00\x08\x00", "problem.not_yaml"),
    "html": (b"<!DOCTYPE html><html><body>Not Found</body></html>", "problem.not_yaml"),
    "utf16": ("tandem: 1\n".encode("utf-16"), "problem.not_yaml"),
    "empty": (b"", "problem.not_yaml"),
    "blank": (b"\n\n  \n# nothing\n", "problem.not_yaml"),
    "list": (b"- 1\n- 2\n", "problem.not_yaml"),
    "number": (b"42\n", "problem.not_yaml"),
    "two documents": (b"tandem: 1\n---\ntandem: 1\n", "problem.not_yaml"),
    "tab": (b"tandem: 1\n\tname: x\n", "problem.not_yaml"),
    "bomb": (BILLION.encode(), "problem.not_yaml"),
    "merge bomb": (
        (
            "a0: &a0 {x: 1}\n"
            + "".join(f"a{i}: &a{i} {{<<: [{','.join([f'*a{i - 1}'] * 9)}]}}\n" for i in range(1, 9))
        ).encode(),
        "problem.not_yaml",
    ),
    "loop": (b"tandem: &a [*a]\n", "problem.not_yaml"),
    "loop in merge": (b"tandem: &a {<<: *a}\n", "problem.not_yaml"),
    "deep": (b"tandem: " + b"[" * 3000 + b"]" * 3000, "problem.not_yaml"),
    "deep mapping": (b"{a: " * 80 + b"1" + b"}" * 80, "problem.not_yaml"),
    "huge integer": (b"tandem: " + b"9" * 5000, "problem.not_yaml"),
    "python tag": (b"tandem: !!python/object/apply:os.system [echo]\n", "problem.not_yaml"),
    "binary tag": (b"tandem: !!binary aGVsbG8=\n", "problem.not_yaml"),
    "set tag": (b"tandem: !!set {a, b}\n", "problem.not_yaml"),
    "wrong tag": (b"tandem: !!int abc\n", "problem.not_yaml"),
    "wrong truth": (b"tandem: !!bool abc\n", "problem.not_yaml"),
    "list as key": (b"? [1, 2]\n: 3\ntandem: 1\n", "problem.not_yaml"),
    "number as key": (b"1: 2\ntandem: 1\n", "problem.not_yaml"),
    "null as key": (b"~: 2\n", "problem.not_yaml"),
    "half a character": (b'tandem: 1\nname: "\\ud800"\n', "problem.not_yaml"),
    "unknown alias": (b"tandem: *nowhere\n", "problem.not_yaml"),
    "same key twice": (b"tandem: 1\nname: a\nname: b\n", "problem.duplicate_name"),
    "large integer": (b"tandem: 1\nstock: {size_mm: [1" + b"0" * 400 + b", 1, 1]}\n", "problem.field"),
    "date": (b"tandem: 2024-02-30\n", "problem.field"),
}


@pytest.mark.parametrize("name", NOT_PROBLEMS)
def test_what_is_no_problem_file_is_refused(tmp_path: Path, name: str) -> None:
    content, code = NOT_PROBLEMS[name]
    path = tmp_path / "p.yaml"
    path.write_bytes(content)
    assert code in codes(expect_refusal(path))


def test_paths_that_lead_nowhere(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    for path in (
        tmp_path / "folder",
        tmp_path / "no.yaml",
        tmp_path / ("x" * 400),
        Path("/dev/null"),
        Path("a\0b"),
    ):
        assert codes(expect_refusal(path)) == {"problem.missing_file"}


def test_a_problem_file_of_100_mb_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "p.yaml"
    with path.open("wb") as stream:
        stream.truncate(100_000_000)
    (issue,) = expect_refusal(path)
    assert issue.code == "problem.too_large"
    assert issue.unit == "MB"


def test_byte_order_mark_and_unicode_names_of_files_are_read(tmp_path: Path) -> None:
    folder = tmp_path / "größe 部分"
    folder.mkdir()
    path = small_problem.write(folder, "\ufeff" + small_problem.PROBLEM)
    assert pipeline.load(path).name == "small"


WRONG = [
    ("stock.size_mm", [0.2e-3, 100, 100], "problem.field"),
    ("stock.size_mm", [5e9, 100, 100], "problem.field"),
    ("stock.size_mm", 5, "problem.field"),
    ("stock.size_mm", ["170", 700, 100], "problem.field"),
    ("stock.size_mm", [True, 700, 100], "problem.field"),
    ("stock.size_mm", [170, 700], "problem.field"),
    ("stock.size_mm.0", float("nan"), "problem.not_finite"),
    ("stock.size_mm.1", float("inf"), "problem.not_finite"),
    ("stock.size_mm.2", None, "problem.field"),
    ("stock.size_mm", [170, 650, 100], "part.stock_too_small"),
    ("stock.place", "there", "problem.field"),
    ("stock.place", {"xyz_mm": [1e300, 0, 0]}, "problem.field"),
    ("stock.place", {"xyz": [1, 2, 3]}, "problem.field"),
    ("stock.roll_pitch_deg", [1e300, 0], "problem.field"),
    ("stock.support", [{"kind": "ball"}], "problem.field"),
    ("name", "", "problem.field"),
    ("name", "two words", "problem.field"),
    ("name", "Straße", "problem.field"),
    ("name", True, "problem.field"),
    ("tandem", 2, "problem.field"),
    ("tandem", "1", "problem.field"),
    ("cell", "nowhere.yaml", "problem.missing_file"),
    ("cell", "../" * 12 + "etc/passwd", "problem.not_yaml"),
    ("cell", "x" * 900, "problem.missing_file"),
    ("cell", "x" * 5000, "problem.field"),
    ("cell", ".", "problem.missing_file"),
    ("cell", None, "problem.field"),
    ("cell.arms", [], "problem.field"),
    ("cell.arms", [*CELL["arms"], CELL["arms"][0]], "problem.field"),
    ("cell.arms.0.robot", "irb9000", "problem.unknown_robot"),
    ("cell.arms.0.robot", 140, "problem.field"),
    ("cell.arms.0.home_deg", [0, 0, 0, 0, 0], "problem.field"),
    ("cell.arms.0.home_deg", [0, 0, 0, 0, 359, 0], "problem.field"),
    ("cell.arms.1.name", "left", "problem.duplicate_name"),
    ("cell.arms.1.name", "LEFT", "problem.duplicate_name"),
    ("cell.arms.1.tool", {"kind": "plain", "tcp": {}, "mass_kg": -1}, "problem.field"),
    ("cell.arms.1.tool", {"kind": "plain", "tcp": {}, "mass_kg": 900}, "problem.field"),
    ("cell.controller.tasks", ["T_ROB1"], "post.tasks"),
    ("cell.obstacles", [CELL["obstacles"][0]] * 2, "problem.duplicate_name"),
    ("cell.obstacles.0.shapes", [{"kind": "mesh", "file": "no.obj", "unit": "mm"}], "problem.missing_file"),
    ("cell.obstacles.0.shapes", [{"kind": "mesh", "file": str(HYPAR)}], "problem.field"),
    ("cell.obstacles.0.shapes", [{"kind": "mesh", "file": str(HYPAR), "unit": "yd"}], "problem.field"),
    ("cell.controller.tasks", ["T_ROB1", "t_rob1"], "problem.duplicate_name"),
    ("cell.controller.units", ["ROB_1", "ROB_1"], "problem.duplicate_name"),
    ("cell.controller.max_moves", 1.5, "problem.field"),
    ("settings.clearance_mm", -1, "problem.field"),
    ("settings.clearance_mm", "10", "problem.field"),
    ("settings.own_clearance_mm", -1, "problem.field"),
    ("settings.own_clearance_mm", 10.5, "problem.field"),
    ("settings.speed_fraction", 1e-9, "problem.field"),
    ("settings.speed_fraction", 90, "problem.field"),
    ("settings.seed", 10**30, "problem.field"),
    ("settings.seed", -1, "problem.field"),
    ("settings.speed", 1, "problem.field"),
    ("settings", [], "problem.field"),
    ("operations", [], "problem.field"),
    ("operations", {}, "problem.field"),
    ("operations", [1], "problem.field"),
    ("operations", CAPITAL["operations"] * 2, "problem.duplicate_name"),
    (OPERATION + "process", "knitting", "problem.unknown_process"),
    (OPERATION + "process", ["elastic_wire"], "problem.unknown_process"),
    (OPERATION + "arms", ["left"], "problem.field"),
    (OPERATION + "arms", ["left", "left"], "problem.field"),
    (OPERATION + "arms", ["left", "middle"], "problem.unknown_arm"),
    (OPERATION + "faces", ["front", "front"], "problem.field"),
    (OPERATION + "kerf_mm", -2, "problem.field"),
    (OPERATION + "feed_min_mm_s", 9, "problem.field"),
    (OPERATION + "feed_mm_s", 1e-6, "problem.field"),
    (OPERATION + "sweep", "up", "problem.field"),
    (OPERATION + "sweep", 1e9, "problem.field"),
    (OPERATION + "sweep", True, "problem.field"),
    (OPERATION + "shape_tol_mm", 1e-9, "problem.field"),
    (OPERATION + "wire.length_mm", 1e6, "problem.field"),
    (OPERATION + "wire.diameter_mm", 0, "problem.field"),
    (OPERATION + "wire", {**CAPITAL["operations"][0]["wire"], "width_mm": 5}, "problem.field"),
    ("part.front", {}, "problem.field"),
    ("part.front.loft.rail.end_deg", 0, "problem.field"),
    ("part.front.loft.rail.end_deg", 1e12, "problem.field"),
    ("part.front.loft.region", {"u": [0.7, 0.2]}, "problem.field"),
    ("part.front.loft.region", {"u": [0.5, 0.5000001]}, "mesh.unit"),
    ("part.front.loft.rail.radius_mm", 90000, "mesh.unit"),
    ("part.front.loft.profiles.1.at", 0.0, "problem.field"),
    ("part.front.loft.profiles.0.bezier_mm", [[0, 0]], "problem.field"),
    ("part.front.loft.profiles.0.bezier_mm.0", [0, 0, 0], "problem.field"),
    ("part.front.loft.profiles.0.bezier_mm.0", [float("nan"), 0], "problem.not_finite"),
    ("part.front.loft.chord_mm", 1e-9, "problem.field"),
    ("part.back.offset_mm", 0, "problem.field"),
    ("part.back", {"offset_mm": 20, "mesh": {"file": "b.obj", "unit": "mm"}}, "problem.field"),
    ("part.back", {"offset_mm": 350}, "part.offset"),
    ("part.front", {"mesh": {"file": "no.obj", "unit": "mm"}}, "problem.missing_file"),
    ("part.front", {"mesh": {"file": str(HYPAR), "unit": "m", "scale": 500}}, "mesh.unit"),
    ("part.front", {"mesh": {"file": str(HYPAR), "unit": "mm", "scale": 1e-4}}, "mesh.unit"),
]


@pytest.mark.sampled(every=2)
@pytest.mark.parametrize(("field", "value", "code"), WRONG, ids=[f"{f}={str(v)[:30]}" for f, v, _ in WRONG])
def test_each_wrong_field_is_named(tmp_path: Path, field: str, value: Any, code: str) -> None:
    path = tmp_path / "p.yaml"
    path.write_text(yaml.safe_dump(change(CAPITAL, field, value)))
    issues = expect_refusal(path)
    assert code in codes(issues)
    first = next(issue for issue in issues if issue.code == code)
    assert first.line or first.file != str(path)


def test_a_name_of_other_letters_is_told_in_words(tmp_path: Path) -> None:
    path = tmp_path / "p.yaml"
    path.write_text(yaml.safe_dump(change(CAPITAL, "name", "Straße")))
    (issue,) = expect_refusal(path)
    assert "start with a letter A to Z" in issue.message and "24 characters" in issue.message
    assert "Straße" in issue.message and "^[" not in issue.message


MESHES = {
    "empty file": ("", {"mesh.unreadable", "mesh.empty"}),
    "no faces": ("v 0 0 0\nv 1 0 0\n", {"mesh.empty", "mesh.unreadable"}),
    "no area": ("v 0 0 0\nv 100 0 0\nv 200 0 0\nf 1 2 3\n", {"mesh.empty"}),
    "not finite": ("v 0 0 nan\nv 100 0 0\nv 0 100 0\nf 1 2 3\n", {"problem.not_finite"}),
    "missing vertex": ("v 0 0 0\nv 100 0 0\nv 0 100 0\nf 1 2 9\n", {"mesh.unreadable"}),
    "three at an edge": (
        "v 0 0 0\nv 100 0 0\nv 0 100 0\nv 0 -100 0\nv 0 0 100\nf 1 2 3\nf 2 1 4\nf 1 2 5\n",
        {"mesh.non_manifold"},
    ),
    "turned over": ("v 0 0 0\nv 100 0 0\nv 0 100 0\nv 100 100 0\nf 1 2 3\nf 2 3 4\n", {"mesh.orientation"}),
    "closed": (
        "v 0 0 0\nv 100 0 0\nv 0 100 0\nv 0 0 100\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n",
        {"mesh.closed"},
    ),
    "two pieces": (
        "v 0 0 0\nv 10 0 0\nv 0 10 0\nv 100 0 0\nv 110 0 0\nv 100 10 0\nf 1 2 3\nf 4 5 6\n",
        {"mesh.pieces"},
    ),
    "web page": ("<!DOCTYPE html><html></html>", {"mesh.unreadable", "mesh.empty"}),
}


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("where", ["front", "back"])
def test_each_wrong_mesh_is_named(tmp_path: Path, name: str, where: str) -> None:
    text, expected = MESHES[name]
    (tmp_path / "m.obj").write_text(text)
    data = change(CAPITAL, f"part.{where}", {"mesh": {"file": "m.obj", "unit": "mm"}})
    (tmp_path / "p.yaml").write_text(yaml.safe_dump(data))
    issues = expect_refusal(tmp_path / "p.yaml")
    assert codes(issues) & expected
    assert all("m.obj" in str(issue.file) for issue in issues)


def test_meshes_of_other_kinds_and_sizes(tmp_path: Path) -> None:
    (tmp_path / "m.step").write_text("ISO-10303-21;")
    (tmp_path / "m.stl").write_bytes(b"\0" * 200)
    with (tmp_path / "m.ply").open("wb") as stream:
        stream.truncate(100_000_001)
    for file, code in (("m.step", "mesh.unreadable"), ("m.ply", "problem.too_large"), ("m.stl", "mesh.")):
        data = change(CAPITAL, "part.front", {"mesh": {"file": file, "unit": "mm"}})
        (tmp_path / "p.yaml").write_text(yaml.safe_dump(data))
        assert all(issue.code.startswith(code) for issue in expect_refusal(tmp_path / "p.yaml"))


def test_a_back_face_in_front_of_the_front_is_refused(tmp_path: Path) -> None:
    square = "v 0 0 {z}\nv 100 0 {z}\nv 0 100 {z}\nv 100 100 {z}\nf 1 2 3\nf 3 2 4\n"
    (tmp_path / "front.obj").write_text(square.format(z=0))
    (tmp_path / "back.obj").write_text(square.format(z=20))
    part = {
        "front": {"mesh": {"file": "front.obj", "unit": "mm"}},
        "back": {"mesh": {"file": "back.obj", "unit": "mm"}},
    }
    (tmp_path / "p.yaml").write_text(yaml.safe_dump({**CAPITAL, "part": part}))
    (issue,) = expect_refusal(tmp_path / "p.yaml")
    assert issue.code == "part.faces"
    assert issue.field == "part.back"
    assert issue.line


def command(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "COLUMNS": "200", "OMP_NUM_THREADS": "1"}
    return subprocess.run(
        [sys.executable, "-m", "planner", *arguments],
        capture_output=True,
        text=True,
        cwd=folder,
        env=environment,
        check=False,
        timeout=120,
    )


def test_the_command_refuses_by_exit_code_and_clears_what_is_stale(tmp_path: Path) -> None:
    small_problem.write(tmp_path, table="a;b\n1;2\n")
    out = tmp_path / "new" / "out"
    (out / "programs").mkdir(parents=True)
    (out / "programs" / "stale.mod").write_text("old")
    (out / ".tandem-killed").mkdir()
    (out / "mine.txt").write_text("mine")
    done = command("plan", "problem.yaml", "-o", "new/out", folder=tmp_path)
    assert (done.returncode, "targets.file" in done.stderr) == (2, True)
    assert sorted(p.name for p in out.iterdir()) == ["mine.txt", "report.html"]

    high = small_problem.PROBLEM.replace("450, 0, 0]", "450, 0, 450]")
    small_problem.write(tmp_path, f"{high}accept: [stock.hangs]\n")
    done = command("plan", "problem.yaml", "-o", "new/out", folder=tmp_path)
    assert done.returncode == 3
    assert "motion." in done.stderr
    assert "Traceback" not in done.stderr
    assert sorted(p.name for p in out.iterdir()) == ["mine.txt", "report.html"]


def test_the_command_refuses_an_output_folder_that_is_a_file(tmp_path: Path) -> None:
    small_problem.write(tmp_path)
    (tmp_path / "out").write_text("mine")
    done = command("plan", "problem.yaml", "-o", "out", folder=tmp_path)
    assert done.returncode == 2
    assert "output.folder" in done.stderr
    assert (tmp_path / "out").read_text() == "mine"


def test_programs_that_are_no_text_are_refused(tmp_path: Path) -> None:
    (tmp_path / "programs").mkdir()
    (tmp_path / "programs" / "a.mod").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(TandemError) as caught:
        pipeline.read_programs(tmp_path)
    assert codes(caught.value.issues) == {"verify.files"}


def test_programs_that_run_for_days_are_not_replayed(tmp_path: Path) -> None:
    problem = pipeline.load(small_problem.write(tmp_path))
    outcome = pipeline.plan(problem)
    assert outcome.verified
    slow = {n: re.sub(r"\\T:=[0-9.]+", r"\\T:=99999", text) for n, text in outcome.programs.items()}
    assert slow != outcome.programs
    with pytest.raises(TandemError) as caught:
        pipeline.verify(problem, slow)
    assert codes(caught.value.issues) == {"verify.duration"}


def test_a_list_whose_entries_have_faults_is_not_called_too_short(tmp_path: Path) -> None:
    cut = {"trim": ["left"], "along": "x"}
    straight = {"name": "a", "process": "straight_wire", "arms": ["left"], "kerf_mm": 1, "cuts": [cut]}
    path = small_problem.write(tmp_path, small_problem.PROBLEM)
    data = yaml.safe_load(path.read_text())
    data["operations"] = [straight]
    path.write_text(yaml.safe_dump(data))
    (issue,) = expect_refusal(path)
    assert "normal to the side" in issue.message
