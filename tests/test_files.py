"""Files are written whole or not at all."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from planner import files, pipeline
from planner.geometry import mesh_files, wing
from planner.issues import TandemError
from planner.loops import loop_plan, machine, plant
from planner.loops.loop_plan import LoopPlan
from planner.processes.forming.plan.paths import adsif_response
from planner.processes.forming.plan.springback import clamp_calibration
from planner.reading import forces_file
from planner.shopfloor.align import probing


def test_a_failed_write_leaves_the_old_file_and_no_litter(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.txt"
    files.write_atomic(path, "old")

    def fail(_: int) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(files.os, "fsync", fail)
    with pytest.raises(OSError, match="disk full"):
        files.write_atomic(path, "new")
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]


def test_a_folder_is_replaced_as_a_whole_and_foreign_files_stay(tmp_path: Path) -> None:
    owned = ("programs", "report.html")
    (tmp_path / "notes.txt").write_text("mine")
    files.write_folder(tmp_path, {"programs/a/x.mod": "1", "report.html": "r"}, owned)
    files.write_folder(tmp_path, {"report.html": "r2"}, owned)
    assert sorted(str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*")) == ["notes.txt", "report.html"]
    assert (tmp_path / "report.html").read_text() == "r2"


def test_an_interrupted_folder_keeps_what_was_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    owned = ("programs",)
    files.write_folder(tmp_path, {"programs/x.mod": "old"}, owned)
    real = files.write_atomic

    def interrupted_write(path: Path, content: str | bytes) -> None:
        real(path, content)
        raise KeyboardInterrupt

    monkeypatch.setattr(files, "write_atomic", interrupted_write)
    with pytest.raises(KeyboardInterrupt):
        files.write_folder(tmp_path, {"programs/x.mod": "new", "programs/y.mod": "new"}, owned)
    assert (tmp_path / "programs" / "x.mod").read_text() == "old"
    assert not list(tmp_path.glob(".tandem-*"))


READERS: dict[str, Callable[[Path], object]] = {
    "curves": loop_plan.read_loop_plan,
    "forces": lambda path: forces_file.read_forces(
        path, [LoopPlan("f1", "", 1, 0.005, 0.18, ()).expected_forces]
    ),
    "plant": plant.read_plant,
    "machine": machine.read_machine,
    "plate test": lambda path: clamp_calibration.read_readings(path, 1e-5),
    "adsif": adsif_response.table_text,
    "points": lambda path: probing.read(path, ("left", "right")),
    "problem": pipeline.load,
    "mesh": lambda path: mesh_files.read_mesh(path, 1e-3),
    "airfoil": lambda path: wing.read_airfoil(path, "part"),
}


@pytest.mark.parametrize("reader", READERS)
def test_a_folder_and_no_file_are_told_apart(reader: str, tmp_path: Path) -> None:
    for path, expected_text in (
        (tmp_path, "is a folder, not a file"),
        (tmp_path / "none.csv", "no such file"),
    ):
        with pytest.raises(TandemError) as refused:
            READERS[reader](path)
        (issue,) = refused.value.issues
        assert expected_text in issue.message
        assert issue.file == str(path)


@pytest.mark.parametrize(
    ("text", "mark"),
    [
        ("level;point;force_n;springback_mm\n0;0;400;0,5\n", "';'"),
        ("level\tpoint\tforce_n\n0\t0\t400\n", "tabs"),
        ("force_n;dial_mm\n0;0,0\n20;0,74\n", "';'"),
    ],
)
def test_another_separator_is_told_once_with_what_to_do(text: str, mark: str, tmp_path: Path) -> None:
    file = tmp_path / "some.csv"
    file.write_text(f"# measured\n{text}")
    with pytest.raises(TandemError) as refused:
        READERS["plate test" if "dial" in text else "forces"](file)
    (issue,) = refused.value.issues
    assert issue.line == 2
    whole = f"{issue.message}; {issue.hint}"
    assert f"columns are separated by {mark}" in whole
    assert "separate them by commas" in whole


def test_a_plant_that_is_no_yaml_is_not_called_a_problem(tmp_path: Path) -> None:
    for text in ("sheet: [cone\n", "- cone\n", ""):
        (tmp_path / "plant.yaml").write_text(text)
        with pytest.raises(TandemError) as refused:
            plant.read_plant(tmp_path / "plant.yaml")
        (issue,) = refused.value.issues
        assert "problem" not in issue.message
        assert "write a mapping" in issue.message


@pytest.mark.parametrize(
    ("name", "carried"),
    [
        ("mydome.stl", "mydome-{}.stl"),
        ("My Dome v3.2 (final).STL", "My-Dome-v3-2-final-{}.stl"),
        ("C:\\parts\\dome.obj", "dome-{}.obj"),
        ("../../etc/passwd", "passwd-{}"),
        ("穹顶.stl", "{}.stl"),
        ("dome<script>.s'tl", "dome-script-{}.stl"),
        (".hidden", "hidden-{}"),
        ("a" * 200 + ".obj", "a" * 60 + "-{}.obj"),
        ("", "{}"),
    ],
)
def test_carried_files_keep_their_names_and_have_their_hash(name: str, carried: str) -> None:
    sha = "0123456789abcdef" * 4
    result = files.bundled_name(name, sha)
    assert result == carried.format(sha[:16])
    assert files.bundled_name(result, sha) == result, "a bundle of a bundle"
    assert files.bundled_name(result, "f" * 64) != result
