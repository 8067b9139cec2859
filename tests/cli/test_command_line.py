"""The command line as a user meets it: exit codes, messages, and what is written."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from planner.cli import command_line
from planner.issue_codes import CODES
from planner.issues import Issue, TandemError

BROKEN = "tandem: 1\nname: broken\nstock: {size_mm: [1, 2, -3]}\noperations: []\n"


def run(*arguments: str, folder: Path | None = None) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "COLUMNS": "200", "OMP_NUM_THREADS": "1"}
    return subprocess.run(
        [sys.executable, "-m", "planner", *arguments],
        capture_output=True,
        text=True,
        cwd=folder,
        env=environment,
        check=False,
        timeout=300,
    )


def test_bad_input_is_exit_2_and_leaves_the_report_alone(tmp_path: Path) -> None:
    (tmp_path / "p.yaml").write_text(BROKEN)
    (tmp_path / "out" / "programs").mkdir(parents=True)
    (tmp_path / "out" / "programs" / "stale.mod").write_text("old")
    done = run("plan", "p.yaml", "-o", "out", folder=tmp_path)
    assert done.returncode == 2
    assert "problem.field" in done.stderr
    assert "stock.size_mm.2" in done.stderr
    assert "p.yaml, line 3" in done.stderr
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["report.html"]
    assert "stock.size_mm.2" in (tmp_path / "out" / "report.html").read_text()


def test_a_missing_problem_is_exit_2(tmp_path: Path) -> None:
    done = run("check", "nowhere.yaml", folder=tmp_path)
    assert done.returncode == 2
    assert "problem.missing_file" in done.stderr


def test_verify_without_programs_is_exit_2(tmp_path: Path) -> None:
    done = run("verify", "nowhere", "--problem", "column_capital", folder=tmp_path)
    assert done.returncode == 2
    assert "verify.no_programs" in done.stderr


def test_the_lists(tmp_path: Path) -> None:
    robots = run("robots", folder=tmp_path)
    assert robots.returncode == 0
    assert "irb4400_60" in robots.stdout
    materials = run("materials", folder=tmp_path)
    assert materials.returncode == 0
    assert "spring_steel" in materials.stdout
    assert "galvanised_steel" in materials.stdout
    issues = run("issues", folder=tmp_path)
    assert issues.returncode == 0
    assert all(code in issues.stdout for code in CODES)


@pytest.mark.parametrize(
    ("codes", "expected"),
    [
        (["part.stock_too_small"], command_line.BAD_INPUT),
        (["targets.file", "problem.missing_file"], command_line.BAD_INPUT),
        (["gcode.feed", "gcode.unit"], command_line.BAD_INPUT),
        (["forming.closed_mesh"], command_line.BAD_INPUT),
        (["milling.guide_lengths"], command_line.BAD_INPUT),
        (["motion.no_path"], command_line.NO_PLAN),
        (["forming.wall_angle"], command_line.NO_PLAN),
        (["milling.tool_radius"], command_line.NO_PLAN),
        (["wire.too_short", "problem.field"], command_line.NO_PLAN),
    ],
)
def test_what_cannot_be_planned_is_told_from_what_was_given_wrong(codes: list[str], expected: int) -> None:
    error = TandemError([Issue(code, "m") for code in codes])
    assert command_line._infeasible_code(error) == expected


def test_a_failure_of_tandem_itself_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(**_: object) -> int:
        raise RuntimeError("unexpected")

    monkeypatch.setattr(command_line.app, "cli", fail)
    with pytest.raises(SystemExit) as stopped:
        command_line.main()
    assert stopped.value.code == 1
    assert "internal.error" in capsys.readouterr().err
