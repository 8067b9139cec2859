"""Raw blocks of an element: every panel's block once, remainders kept, impossible ones refused."""

from __future__ import annotations

import csv
import dataclasses
import io
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from planner.cli.element import ElementRequest, run_element
from planner.element import block_nesting, stock_list
from planner.element.block_drawing import draw_blocks
from planner.element.block_nesting import (
    BlockNesting,
    PanelBlock,
    RawBlock,
    SawOptions,
    nest_blocks,
    reach_issues,
)
from planner.element.stock_list import Offcut
from planner.geometry import nesting
from planner.geometry.cut_tree import BowSize
from planner.geometry.mesh import TriangleMesh
from planner.issues import Issue, Severity, TandemError, is_input_error
from tests.element.walls import element, wall
from tests.geometry.test_nesting import cut_pieces

RAW = RawBlock(2.4, 1.2, 0.2, "eps_a120")
SAW = SawOptions(0.002)


@pytest.fixture(scope="module", autouse=True)
def fewer_samples() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(nesting, "MAX_CHECKS", 60_000)
        yield


def panels(count: int = 30, thickness: float = 0.2, foam: str | None = "eps_a120") -> list[PanelBlock]:
    rng = np.random.default_rng(7)
    sides = rng.uniform([0.3, 0.2], [0.9, 0.5], (count, 2)).round(4).tolist()
    return [
        PanelBlock(f"A{i:02d}", a, b, thickness, 0.5 * a * b * thickness, foam)
        for i, (a, b) in enumerate(sides)
    ]


def check_nesting(packing: BlockNesting, given: list[PanelBlock], sawing: SawOptions) -> None:
    """Every panel once, sawn out of a block of its foam as large as asked."""
    seen = []
    for block in packing.blocks:
        cut_pieces(block.tree, nesting.NestBlock(*block.size), sawing.kerf)
        for part in block.tree.boxes():
            panel = given[block.panel(part.box)]
            seen.append(panel.name)
            asked = np.array([panel.length, panel.width]) + sawing.oversize
            sides = (part.width, part.length) if part.is_rotated else (part.length, part.width)
            assert np.allclose(sides, asked, atol=2.5e-5)
            assert panel.thickness <= block.size[2] + 1e-9
            assert panel.foam == block.foam
            assert (block.panel(part.box) in block.level) == (panel.thickness < block.size[2] - 1e-3)
    assert sorted(seen) == sorted(panel.name for panel in given)


def refusal(given: list[PanelBlock], raw: list[RawBlock], sawing: SawOptions = SAW) -> Issue:
    with pytest.raises(TandemError) as caught:
        nest_blocks("dome", given, raw, (), sawing)
    (issue,) = caught.value.issues
    return issue


def test_panels_are_sawn_out_of_blocks_of_their_foam_and_thickness() -> None:
    given = panels(20) + [dataclasses.replace(p, name=f"B{p.name}", foam="xps") for p in panels(5, 0.1)]
    raw = [RAW, RawBlock(2.0, 1.0, 0.12, "xps"), RawBlock(2.0, 1.0, 0.3, "xps")]
    sawing = SawOptions(0.003, 0.01)
    made = nest_blocks("dome", given, raw, (), sawing)
    check_nesting(made, given, sawing)
    assert {block.size[2] for block in made.blocks if block.foam == "xps"} == {0.12}
    assert [block.name for block in made.blocks] == [f"B{n:02d}" for n in range(1, len(made.blocks) + 1)]


def test_the_table_has_what_each_block_gives_and_all_of_them() -> None:
    given = panels()
    made = nest_blocks("dome", given, [RAW], (), SAW)
    *rows, whole = csv.DictReader(io.StringIO(block_nesting.blocks_csv(made, given)))
    assert [row["block"] for row in rows] == [block.name for block in made.blocks]
    assert sorted(" ".join(row["panels"] for row in rows).split()) == [panel.name for panel in given]
    area = sum(p.length * p.width for p in given)
    fraction = area / (2.4 * 1.2 * len(rows))
    assert float(whole["yield_boxes"]) == pytest.approx(fraction, abs=1e-4)
    assert float(whole["yield_volume"]) == pytest.approx(0.5 * fraction, abs=1e-4)
    grown = sum((p.length + 0.002) * (p.width + 0.002) for p in given) / (2.402 * 1.202)
    assert int(whole["least_blocks"]) == np.ceil(grown) <= len(rows)


def test_what_is_left_over_is_kept_and_used_before_new_blocks(tmp_path: Path) -> None:
    first = nest_blocks("dome", panels(10), [RAW], (), SAW)
    assert first.stock
    assert all(min(one.length, one.width) >= SAW.kept for one in first.stock)
    path = tmp_path / "stock.csv"
    path.write_text(block_nesting.stock_csv(first))
    stock = stock_list.read_offcuts(path)
    assert stock_list.offcuts_csv(stock) == path.read_text()
    largest = max(stock, key=lambda one: one.length * one.width)
    small = [dataclasses.replace(panels(1)[0], length=largest.length, width=largest.width)]
    second = nest_blocks("vault", small, [RAW], stock, SAW)
    assert [block.source for block in second.blocks] == [largest.name]
    assert largest not in second.stock
    assert {one for one in stock if one != largest} <= set(second.stock)
    assert len({one.name for one in second.stock}) == len(second.stock)


@pytest.mark.parametrize(
    ("row", "expected_text"),
    [
        ("a,-900,400,200,xps", "length_mm '-900'"),
        ("a,900,0,200,xps", "width_mm '0'"),
        ("a,900,400,thick,xps", "thickness_mm 'thick'"),
        ("a,900,400,nan,xps", "thickness_mm 'nan'"),
        ("old,900,400,200,xps", "id 'old' again"),
        (",900,400,200,xps", "no id"),
        ("a,900,400,200", "4 values"),
    ],
)
def test_wrong_rows_of_the_stock_are_refused_and_without_them_it_is_read(
    row: str, expected_text: str, tmp_path: Path
) -> None:
    path = tmp_path / "stock.csv"
    good = "id,length_mm,width_mm,thickness_mm,foam\nold,1000,600,200,\n"
    path.write_text(f"{good}{row}\n")
    with pytest.raises(TandemError) as caught:
        stock_list.read_offcuts(path)
    (issue,) = caught.value.issues
    assert (issue.code, issue.line, issue.file) == ("element.stock", 3, str(path))
    assert expected_text in issue.message
    assert issue.hint
    assert is_input_error(caught.value.issues)
    path.write_text(good)
    assert stock_list.read_offcuts(path) == (Offcut("old", 1.0, 0.6, 0.2, None),)


def test_a_list_that_is_none_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "stock.csv"
    wrong = {"a;b\n": "';'", "id,length\n": "columns", "": "columns", None: "no such file"}
    for content, said in wrong.items():
        path.unlink(missing_ok=True)
        if content is not None:
            path.write_text(content)
        with pytest.raises(TandemError, match=re.escape(said)):
            stock_list.read_offcuts(path)


def test_blocks_that_fit_no_raw_block_are_refused_with_the_size_that_does() -> None:
    sizes = {"B01": (0.7, 1.5, 0.25), "B02": (2.5, 0.4, 0.1)}
    given = [*panels(5), *(PanelBlock(name, *size, 0.1, "eps_a120") for name, size in sizes.items())]
    issue = refusal(given, [RAW])
    assert issue.code == "element.raw_block"
    assert "B01, B02" in issue.message
    match = re.search(r"raw blocks of ([\d.]+) x ([\d.]+) x ([\d.]+) mm", str(issue.hint))
    assert match is not None
    size = [float(v) / 1e3 for v in match.groups()]
    check_nesting(nest_blocks("dome", given, [RawBlock(*size, "eps_a120")], (), SAW), given, SAW)


def test_foam_of_which_there_is_no_raw_block_is_refused() -> None:
    issue = refusal(panels(3, foam="xps"), [RAW])
    assert issue.code == "element.raw_block"
    assert "xps" in issue.message


def test_grain_is_kept_and_where_that_leaves_no_room_it_is_said() -> None:
    tall = [PanelBlock("A01", 0.4, 1.5, 0.2, 0.1, "eps_a120")]
    assert nest_blocks("dome", tall, [RAW], (), SAW).blocks[0].tree.boxes()[0].is_rotated
    kept = dataclasses.replace(SAW, may_rotate=False)
    assert "grain: any" in str(refusal(tall, [RAW], kept).hint)
    made = nest_blocks("dome", panels(), [RAW], (), kept)
    assert not any(part.is_rotated for block in made.blocks for part in block.tree.boxes())


def test_cuts_out_of_reach_are_named_and_the_bow_advised_reaches_them() -> None:
    given = panels(12, 0.15)
    sawing = dataclasses.replace(SAW, bow=BowSize(0.25, 0.14))
    (issue,) = reach_issues(nest_blocks("dome", given, [RAW], (), sawing), given, sawing)
    assert (issue.code, issue.severity) == ("element.cut", Severity.WARNING)
    assert re.search(r"cut \d+ of B\d\d", issue.message)
    assert re.search(r"level, A\d\d", issue.message)
    match = re.search(r"span_mm: (\d+), throat_mm: (\d+)", str(issue.hint))
    assert match is not None
    better = dataclasses.replace(SAW, bow=BowSize(float(match[1]) / 1e3, float(match[2]) / 1e3))
    assert reach_issues(nest_blocks("dome", given, [RAW], (), sawing), given, better) == ()


def test_the_drawing_has_every_panel_and_every_cut() -> None:
    given = panels(12, 0.15)
    made = nest_blocks("<dome>", given, [RAW], (), SAW)
    root = ET.fromstring(draw_blocks("<dome>", made, given, 0.002))
    texts = ["".join(node.itertext()) for node in root.iter("{http://www.w3.org/2000/svg}text")]
    assert all(texts.count(panel.name) == 1 for panel in given)
    for number in range(1, max(len(block.tree.cuts()) for block in made.blocks) + 1):
        assert texts.count(str(number)) == sum(len(block.tree.cuts()) >= number for block in made.blocks)
    assert sum(text.startswith("level cut") for text in texts) == len(given)


@pytest.fixture(scope="module")
def raw_blocks() -> dict[str, Any]:
    size = {"size_mm": [1600, 1100, 200], "foam": "eps_a120"}
    return {"sizes": [size], "kerf_mm": 2, "bow": {"span_mm": 650, "throat_mm": 650}, "stock": "stock.csv"}


STOCK = "id,length_mm,width_mm,thickness_mm,foam\nold,800,600,200,eps_a120\n"


def write_element(folder: Path, raw_blocks: dict[str, Any], mesh: TriangleMesh | None = None) -> Path:
    path = element(folder, mesh, raw_blocks=raw_blocks)
    (folder / "stock.csv").write_text(STOCK)
    run_element(ElementRequest(path, folder / "out"))
    return folder / "out"


@pytest.mark.long
def test_an_element_with_raw_blocks_says_which_panel_comes_from_where(
    tmp_path: Path, raw_blocks: dict[str, Any]
) -> None:
    out = write_element(tmp_path, raw_blocks)
    data = json.loads((out / "element.json").read_text())
    sizes = {p["id"]: sorted([p["block_x_mm"], p["block_y_mm"]]) for p in data["panels"]}
    cut = {p["id"]: sorted(p["size_mm"]) for block in data["blocks"]["blocks"] for p in block["panels"]}
    assert sorted(cut) == sorted(sizes)
    assert all(cut[name] == pytest.approx(size) for name, size in sizes.items())
    *rows, whole = csv.DictReader((out / "blocks.csv").open())
    assert sorted(" ".join(row["panels"] for row in rows).split()) == sorted(sizes)
    assert 0.1 < float(whole["yield_volume"]) < float(whole["yield_boxes"]) < 1.0
    assert "old" not in (out / "stock.csv").read_text() or all(not row["left_over"] for row in rows)
    assert (out / "blocks.svg").exists()
    # moved by nothing, the same bytes: which panel comes from where does not change
    mesh = wall(1.2, 0.9, 0.02)
    noise = 1e-9 * np.random.default_rng(1).standard_normal(mesh.vertices.shape)
    there = write_element(tmp_path / "b", raw_blocks, TriangleMesh(mesh.vertices + noise, mesh.faces))
    for name in ("blocks.csv", "blocks.svg", "stock.csv"):
        assert (out / name).read_bytes() == (there / name).read_bytes()


def test_the_stock_that_is_read_is_not_written_over(tmp_path: Path, raw_blocks: dict[str, Any]) -> None:
    path = element(tmp_path, raw_blocks=raw_blocks)
    (tmp_path / "stock.csv").write_text(STOCK)
    with pytest.raises(TandemError, match=r"stock\.csv"):
        run_element(ElementRequest(path, tmp_path))
    assert (tmp_path / "stock.csv").read_text() == STOCK


def test_negative_sizes_in_the_stock_of_an_element_are_refused(
    tmp_path: Path, raw_blocks: dict[str, Any]
) -> None:
    path = element(tmp_path, raw_blocks=raw_blocks)
    (tmp_path / "stock.csv").write_text(STOCK.replace("800", "-800"))
    with pytest.raises(TandemError) as caught:
        run_element(ElementRequest(path, tmp_path / "out"))
    (issue,) = caught.value.issues
    assert (issue.code, issue.line) == ("element.stock", 2)
