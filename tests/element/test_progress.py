"""Progress of an element: marks, the next panel, and what a broken panel is cut from again."""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path
from typing import Any

import pytest

from planner.cli import command_line
from planner.cli.element import ElementMark, ElementRequest, run_element, run_element_mark
from planner.element import progress
from planner.issues import Issue, TandemError
from tests.element.shells import shell

RAW = {"sizes": [{"size_mm": [2400, 1200, 150], "foam": "eps_a120"}], "kerf_mm": 2, "keep_mm": 100}


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return shell(tmp_path_factory.mktemp("shell"), hexagons={"count": 41}, raw_blocks=RAW)


@pytest.fixture
def out(file: Path, tmp_path: Path) -> Path:
    """The folder of an element that is written once."""
    made = file.parent / "out"
    if not made.exists():
        run_element(ElementRequest(file, made))
    for name in ("element.json", "stock.csv"):
        (tmp_path / name).write_bytes((made / name).read_bytes())
    return tmp_path


def read_data(out: Path) -> dict[str, Any]:
    loaded: dict[str, Any] = json.loads((out / "element.json").read_text())
    return loaded


def read_rows(out: Path) -> list[dict[str, str]]:
    return list(csv.DictReader((out / "progress.csv").open()))


def lines(out: Path) -> str:
    return "\n".join(progress.progress_lines(progress.read_progress(out), out))


def mark(out: Path, name: str, state: progress.PanelState) -> tuple[Issue, ...]:
    return run_element_mark(ElementMark(out, name, state))


def test_marks_are_kept_once_and_stay_where_the_element_is_divided_again(file: Path, out: Path) -> None:
    names = [panel["id"] for panel in read_data(out)["panels"]]
    mark(out, names[3], "cut")
    mark(out, names[1], "cut")
    written = (out / "progress.csv").read_bytes()
    mark(out, names[1], "cut")
    assert (out / "progress.csv").read_bytes() == written
    assert [(row["id"], row["state"]) for row in read_rows(out)] == [(names[1], "cut"), (names[3], "cut")]
    run_element(ElementRequest(file, out))
    assert (out / "progress.csv").read_bytes() == written
    assert mark(out, names[1], "glued") == ()
    assert read_rows(out)[0]["state"] == "glued"


def test_the_next_panel_is_one_of_the_block_that_is_begun_and_the_next_to_glue_by_the_order(
    out: Path,
) -> None:
    data = read_data(out)
    blocks = [[item["id"] for item in block["panels"]] for block in data["blocks"]["blocks"]]
    assert f"next to be cut: {blocks[0][0]}" in lines(out)
    mark(out, blocks[2][0], "cut")
    assert f"next to be cut: {blocks[2][1]}" in lines(out)
    for name in blocks[2]:
        mark(out, name, "cut")
    assert f"next to be cut: {blocks[0][0]}" in lines(out)
    order = sorted(data["panels"], key=lambda panel: int(panel["order"]))
    first, second = (panel["id"] for panel in order[:2])
    assert f"next to be glued: {first}, 1 of" in lines(out)
    mark(out, first, "glued")
    assert f"next to be glued: {second}, 2 of" in lines(out)
    for panel in data["panels"]:
        mark(out, panel["id"], "glued")
    assert "next" not in lines(out)
    assert f"{len(data['panels'])} are glued" in lines(out)


def test_a_broken_panel_is_cut_again_from_what_is_left_over_and_holds_it_or_from_a_new_block(
    out: Path,
) -> None:
    data = read_data(out)
    panel, other = data["panels"][:2]
    size = {axis: float(panel[f"block_{axis}_mm"]) for axis in "xyz"}
    name = data["name"]
    tight = f"{name}-RB01-1,{size['y'] + 1:.1f},{size['x'] + 1:.1f},150,eps_a120"
    rows = [
        "id,length_mm,width_mm,thickness_mm,foam",
        f"thin,{size['x'] + 50:.1f},{size['y'] + 50:.1f},149,eps_a120",
        f"short,{size['x'] - 1:.1f},{size['y'] + 50:.1f},150,eps_a120",
        f"strange,{size['x'] + 50:.1f},{size['y'] + 50:.1f},150,xps",
        tight,
        "old,2000,1000,150,eps_a120",
    ]
    (out / "stock.csv").write_text("\n".join(rows) + "\n")
    mark(out, panel["id"], "broken")
    assert "1 broken" in lines(out)
    # RB01 is not cut yet, the old piece is at hand
    assert f"{panel['id']} again" in lines(out) and "offcut old (" in lines(out)
    for item in data["blocks"]["blocks"][0]["panels"]:
        if item["id"] != panel["id"]:
            mark(out, item["id"], "cut")
    assert f"offcut {name}-RB01-1 (" in lines(out)
    mark(out, other["id"], "broken")  # which no piece serves twice
    said = [line for line in lines(out).splitlines() if " again, " in line]
    assert [line.split()[0] for line in said] == [panel["id"], other["id"]]
    assert said[0] != said[1] and "offcut old (" in said[1]
    (out / "stock.csv").write_text(rows[0] + "\n")
    assert "from a raw block of 2400 x 1200 x 150 mm" in lines(out)


def test_an_element_without_raw_blocks_goes_by_ids(out: Path) -> None:
    data = read_data(out)
    del data["blocks"]
    (out / "element.json").write_text(json.dumps(data))
    names = [panel["id"] for panel in data["panels"]]
    mark(out, names[0], "broken")
    assert f"next to be cut: {names[1]}" in lines(out)
    assert f"{names[0]} again: from another block of 1200 x 1000 x 150 mm" in lines(out)


def test_what_is_no_panel_or_no_list_is_refused_and_what_is_advised_helps(out: Path) -> None:
    def expect_refusal(name: str) -> Issue:
        with pytest.raises(TandemError) as caught:
            mark(out, name, "cut")
        (issue,) = caught.value.issues
        assert issue.code == "element.mark"
        return issue

    names = [panel["id"] for panel in read_data(out)["panels"]]
    issue = expect_refusal("Z99")
    assert "'Z99'" in issue.message and names[0] in issue.message
    assert not (out / "progress.csv").exists()
    mark(out, names[0], "cut")
    good = (out / "progress.csv").read_text()
    (out / "progress.csv").write_text(good + f"{names[1]},lost,1 x 2 x 3\n")
    assert expect_refusal(names[2]).line == 3
    (out / "progress.csv").write_text(good)  # that line taken out
    mark(out, names[2], "cut")
    (out / "element.json").unlink()
    assert "tandem element" in str(expect_refusal(names[0]).hint)


def test_marks_of_panels_that_are_others_now_are_told_until_they_are_marked_again(out: Path) -> None:
    names = [panel["id"] for panel in read_data(out)["panels"]]
    rows = f"id,state,block_mm\n{names[0]},cut,1 x 2 x 3\nQ07,glued,1 x 2 x 3\n"
    (out / "progress.csv").write_text(rows)
    told = {str(issue.message) for issue in mark(out, names[1], "cut")}
    assert len(told) == 2
    assert any("Q07" in words for words in told) and any(names[0] in words for words in told)
    (left,) = mark(out, names[0], "cut")
    assert "Q07" in left.message
    assert read_rows(out)[-1]["id"] == "Q07"


def test_mark_is_a_word_of_the_command(out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    name = read_data(out)["panels"][0]["id"]
    monkeypatch.setattr(sys, "argv", ["tandem", "element", "mark", str(out), name, "cut"])
    with pytest.raises(SystemExit) as ended:
        command_line.main()
    assert ended.value.code == 0
    assert read_rows(out)[0]["state"] == "cut"


def test_jobs_of_raw_blocks_are_marked_with_the_panels_that_they_cut(tmp_path: Path) -> None:
    panels = [
        {"id": f"P{n}", "order": n, "block_x_mm": 9, "block_y_mm": 9, "block_z_mm": 9} for n in range(6)
    ]
    jobs = [
        {"id": "B1", "size_mm": [60, 30, 9]},
        {"id": "B1-2", "size_mm": [30, 30, 9], "panels": {"P0": [], "P1": [], "P2": []}},
    ]
    block = {"left_over": None, "size_mm": [60, 30, 9], "foam": "f"}
    blocks = [
        {**block, "id": "B1", "panels": [{"id": f"P{n}"} for n in range(4)], "jobs": jobs},
        {**block, "id": "B2", "panels": [{"id": f"P{n}"} for n in (4, 5)], "jobs": []},
    ]
    nest = {"blocks": blocks, "oversize_mm": 0, "turned": True}
    data = {"name": "e", "panels": panels, "blocks": nest}
    (tmp_path / "element.json").write_text(json.dumps(data))
    (tmp_path / "stock.csv").write_text("id,length_mm,width_mm,thickness_mm,foam\n")
    said = "next to be cut: P0, P1, P2 together, then P3 of block B1 (a raw block of 60 x 30 x 9 mm)"
    said += ", by job B1-2"
    assert f"{said}; before that, what cuts it apart: B1" in lines(tmp_path)

    def marks() -> dict[str, str]:
        return {row["id"]: row["state"] for row in read_rows(tmp_path)}

    mark(tmp_path, "P4", "cut")  # what is begun comes first
    assert "next to be cut: P5 of block B2" in lines(tmp_path)
    mark(tmp_path, "P5", "cut")
    mark(tmp_path, "B1", "cut")
    assert lines(tmp_path).splitlines()[1] == said
    mark(tmp_path, "P1", "glued")
    mark(tmp_path, "P0", "broken")
    mark(tmp_path, "B1-2", "cut")
    assert marks() == {"P0": "broken", "P1": "glued", "P2": "cut", "P4": "cut", "P5": "cut", "B1": "cut"}
    assert "next to be cut: P3 of block B1 (a raw block of 60 x 30 x 9 mm)" in lines(tmp_path).splitlines()
    assert "P0 again, 9 x 9 x 9 mm: from a raw block" in lines(tmp_path)
    assert lines(tmp_path).endswith("; alone, again/P0.yaml")
    mark(tmp_path, "B1-2", "broken")  # the row fell down: what is glued is not
    assert [marks()[name] for name in ("P0", "P1", "P2")] == ["broken", "glued", "broken"]
    run_element_mark(ElementMark(tmp_path, "P2", "open"))
    run_element_mark(ElementMark(tmp_path, "B1", "open"))
    assert marks().keys() == {"P0", "P1", "P4", "P5"}
    with pytest.raises(TandemError, match="a job that cuts block B1 apart; allowed: cut and open"):
        mark(tmp_path, "B1", "glued")
    mark(tmp_path, "B1", "cut")
    jobs[0]["size_mm"] = [60, 40, 9]
    (tmp_path / "element.json").write_text(json.dumps(data))
    (issue,) = progress.progress_issues(progress.read_progress(tmp_path))
    assert "have blocks of another size now: B1" in issue.message
    jobs[0]["panels"] = {"P3": []}  # divided anew, it cuts a panel
    (tmp_path / "element.json").write_text(json.dumps(data))
    run_element_mark(ElementMark(tmp_path, "B1", "open"))
    assert progress.progress_issues(progress.read_progress(tmp_path)) == ()
