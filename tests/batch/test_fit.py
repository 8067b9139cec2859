"""``tandem fit``: one job in several cells, ranked; on a job of given poses that is planned in seconds."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

import planner
from planner.batch import cell_ranking
from planner.batch.job import JobResult
from planner.batch.rows import BatchItem, BatchRow
from planner.cli.batch import Fit, run_fit
from planner.issues import TandemError
from planner.problem import Settings
from tests import small_forming


def cells(folder: Path) -> dict[str, dict]:
    """The dish's own cell, one whose arm has another name, one without a suitable tool, an invalid file."""
    own = small_forming.problem()["cell"]
    renamed = {**own, "arms": [{**own["arms"][0], "name": "big"}]}
    wire = yaml.safe_load((small_forming.CELLS / "irb140_bow.yaml").read_text())
    result = {"renamed": renamed, "wire": wire, "notes": {"title": "no cell"}}
    folder.mkdir()
    for name, data in result.items():
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(data))
    return result


def test_cells_are_ranked_and_the_others_say_why_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cells(tmp_path / "cells")
    path = small_forming.write(tmp_path, small_forming.problem())
    code = run_fit(Fit(path, tmp_path / "cells", tmp_path / "out", workers=2))
    text = capsys.readouterr().out
    assert code == 0
    assert "dish is proven in 2 of 3 cells" in text
    lines = text.splitlines()
    assert any(line.startswith("wire: error [") and "ball_tool" in line for line in lines)
    assert not any(line.startswith(("own:", "renamed:")) for line in lines)
    rows = (tmp_path / "out" / "summary.csv").read_text().splitlines()
    assert {row.split(",")[0] for row in rows[1:3]} == {"own", "renamed"}
    # each result stands alone, with its cell inside, and is proven again from its own text
    problem = planner.load(tmp_path / "out" / "renamed" / "problem" / "problem.yaml")
    assert [arm.name for arm in problem.cell.arms] == ["robot"]


def row(name: str, state: str, **metrics: float) -> BatchRow:
    return BatchRow(BatchItem(name, name, lambda: None), JobResult(name, state, (), metrics))  # type: ignore[arg-type]


def test_proof_comes_first_then_margins_then_time() -> None:
    asked = Settings(clearance=0.005, joint_margin=0.05, singularity_margin=0.05)
    rows = [
        row("refused", "bad_input"),
        row("tight and fast", "verified", clearance_mm=5.5, cycle_s=10.0),
        row("ample and slow", "verified", clearance_mm=40.0, cycle_s=30.0),
        row("ample", "verified", clearance_mm=11.0, cycle_s=20.0),
        row("unproven", "unproven", clearance_mm=100.0, cycle_s=1.0),
    ]
    names = [item.item.name for item in cell_ranking.rank_cells(rows, asked)]
    assert names == ["ample", "ample and slow", "tight and fast", "refused", "unproven"]


def test_too_few_arms_and_folders_without_cells_are_told(tmp_path: Path) -> None:
    problem = planner.load("cone_dpif_l")
    (one,) = (i for i in cell_ranking.cell_items(problem, small_forming.CELLS) if i.name == "irb140_ball")
    with pytest.raises(TandemError, match="got a cell of 1 arm, cone_dpif_l uses 2"):
        one.read()
    (tmp_path / "readme.yaml").write_text("title: none\n")
    with pytest.raises(TandemError, match="contains no cell"):
        cell_ranking.cell_items(problem, tmp_path)
