"""Panels that are cut from one raw block together: which panels, their position, and their cuts."""

from __future__ import annotations

import csv
import dataclasses
import itertools
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
import yaml

from planner import pipeline, plans
from planner.batch import run as batch
from planner.claims.segments import Segment
from planner.cli.element import ElementReport, ElementRequest, run_element, run_element_report
from planner.element.rows import FRONTS, PanelRow, PanelShape, RowLimits, RowPiece, find_rows
from planner.geometry.cut_tree import BowSize, CutTree
from planner.geometry.line_nesting import nest_in_lines
from planner.geometry.units import MM
from planner.processes.hotwire.claims import CutsSurface, KerfCurve
from tests.element.shells import shell
from tests.element.test_run_report import read_data
from tests.element.test_saw_jobs import KERF, SAW, planes, saw_jobs, upwards
from tests.element.walls import ROOT
from tests.test_plans import some_plan

WALL = ROOT / "problems" / "ruled_wall_108" / "rows.yaml"
FOAM = 14.0
"""Foam beside panels of the shell [mm], so that the wire has room over what bears a row."""


def slab(folder: Path, thick: float = 170.0, bow: float | None = None, **changes: Any) -> Path:
    """A shell 150 mm thick out of raw blocks of 1250 x 600 mm, its panels cut together."""
    operation = {key: value for key, value in SAW["operations"][0].items() if key != "setup"}
    if bow is not None:
        tool = {"kind": "bow", "span_mm": bow, "throat_mm": bow}
        operation["setup"] = {"tools": {"robot": tool}}
    raw = {"sizes": [{"size_mm": [1250, 600, thick], "foam": "eps_a120"}], "kerf_mm": KERF}
    given = {"raw_blocks": raw, "foam_sides_mm": FOAM, "hexagons": {"count": 80}, **changes}
    path = shell(folder, cut_blocks={"problem": "saw.yaml", "together": True}, **given)
    (folder / "saw.yaml").write_text(yaml.safe_dump({**SAW, "operations": [operation]}))
    return path


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("rows")
    run_element(ElementRequest(slab(folder), folder / "out"))
    return folder / "out"


def rows_in(out: Path) -> list[tuple[dict[str, Any], dict[str, Any], dict[str, Any]]]:
    """Blocks, their jobs that cut several panels, and the problems of these."""
    result = []
    for block, job in saw_jobs(read_data(out)):
        if "panels" in job:
            loaded = yaml.safe_load((out / "blocks" / f"{job['id']}.yaml").read_text())
            result.append((block, job, loaded))
    return result


def rings(part: dict[str, Any]) -> np.ndarray:
    return np.array([part[end]["polyline_mm"] for end in ("start", "end")])


def local_ring(out: Path, name: str) -> np.ndarray:
    """Return the outline (2, C, 3) [mm] of a panel in its own problem."""
    (sides,) = yaml.safe_load((out / "again" / f"{name}.yaml").read_text())["part"]["ruled"]
    return rings(sides)


def test_every_panel_is_cut_once_alone_or_in_a_row(out: Path) -> None:
    data = read_data(out)
    rows = [name for _, job, _ in rows_in(out) for name in job["panels"]]
    alone = {path.stem for path in (out / "panels").glob("*.yaml")}
    assert len(set(rows)) == len(rows) >= 70
    assert alone | set(rows) == {panel["id"] for panel in data["panels"]}
    assert not alone & set(rows)
    assert {path.stem for path in (out / "again").iterdir()} == set(rows)
    table = list(csv.DictReader((out / "blocks.csv").open()))
    named = [name for row in table[:-1] for name in row["together"].replace("+", " ").split()]
    assert sorted(named) == sorted(rows)
    assert int(table[-1]["together"]) == len(rows)
    assert f"{len(rows)} panels are cut together with others" in (out / "element.html").read_text()


def test_panels_lie_in_their_row_as_the_problem_of_their_own_has_them(out: Path) -> None:
    for block, job, problem in rows_in(out):
        size = np.array(problem["stock"]["size_mm"])
        low = np.array(job["corner_mm"])
        assert (low + size[:2] <= np.array(block["size_mm"][:2]) + 0.01).all()
        cut = {item["name"]: item for item in problem["part"]["ruled"]}
        for name, pose in job["panels"].items():
            pose = np.array(pose)
            expected = local_ring(out, name) @ pose[:3, :3].T + pose[:3, 3]
            back, front = rings(cut[name])
            assert np.allclose(back, expected[0], atol=1e-6)
            rise = (front - back)[:, 2:] / 150.0  # goes on beyond the front, straight on
            assert np.allclose((front - back) / rise, expected[1] - back, atol=1e-5)
            assert ((rise > 1.0) & (rise <= 1.03)).all()
            assert (np.abs(expected[..., :2]) < 0.5 * size[:2] - FOAM + 0.06).all()
        rest = [shapely.Polygon(rings(cut[name])[1, :, :2]) for name in job["panels"]]
        assert all(a.distance(b) > 2.0 * FOAM for a, b in itertools.combinations(rest, 2))


def test_the_front_of_all_is_one_plane_and_outlines_follow_from_the_top_on_edge(out: Path) -> None:
    for _, job, problem in rows_in(out):
        faces, outlines = problem["operations"]
        assert [cut["surface"] for cut in faces["cuts"]] == ["fronts"]
        assert faces["spacers"]
        plane = rings(problem["part"]["ruled"][0])
        size = np.array(problem["stock"]["size_mm"])
        assert np.ptp(plane[..., 2]) == 0.0
        assert plane[0, 0, 2] == pytest.approx(150.0)
        ((_, normal),) = planes(problem)
        assert np.allclose(normal, [0.0, 0.0, 1.0])  # the slot is above the panels, none of it is theirs
        assert np.allclose(np.ptp(plane.reshape(-1, 3), axis=0)[:2], size[:2])
        assert upwards(problem)[2] == pytest.approx(1.0)
        up = upwards({"stock": outlines["setup"]})
        assert abs(up[2]) < 1e-9
        assert "tie the layers together" in outlines["setup"]["note"]
        assert {cut["surface"] for cut in outlines["cuts"]} == set(job["panels"])
        cut = {item["name"]: rings(item) for item in problem["part"]["ruled"]}
        tops = [float((cut[item["surface"]] @ up).max()) for item in outlines["cuts"]]
        assert all(a > b - 0.1 for a, b in itertools.pairwise(tops))
        assert float(np.abs(up[:2]) @ size[:2]) + 20.0 <= 650.0  # throat of the bow


def test_what_bears_a_row_on_edge_is_clear_of_the_wire(out: Path) -> None:
    for _, _, problem in rows_in(out):
        setup = problem["operations"][1]["setup"]
        up = upwards({"stock": setup})
        axis = int(np.argmax(np.abs(up[:2])))
        half = 0.5 * np.array(problem["stock"]["size_mm"])
        lines = [
            shapely.LinearRing(ring[:, [1 - axis, axis]])
            for item in problem["part"]["ruled"][1:]
            for ring in rings(item)
        ]
        low, high = np.inf, -np.inf
        for box in setup["support"]:
            at, size = np.array(box["pose"]["xyz_mm"]), np.array(box["size_mm"])
            assert at[axis] + 0.5 * size[axis] == pytest.approx(-half[axis], abs=0.01)
            ends = at[1 - axis] - 0.5 * size[1 - axis], at[1 - axis] + 0.5 * size[1 - axis]
            foot = shapely.box(ends[0], -half[axis] - 700.0, ends[1], -half[axis])
            assert min(foot.distance(line) for line in lines) > 10.0 + 0.5 * KERF
            low, high = min(low, ends[0]), max(high, ends[1])
        assert low < 0.0 < high


@pytest.mark.long
def test_no_further_block_is_taken_for_panels_to_be_cut_together(out: Path, tmp_path: Path) -> None:
    path = slab(tmp_path)
    data = yaml.safe_load(path.read_text())
    data["cut_blocks"].pop("together")
    path.write_text(yaml.safe_dump(data))
    run_element(ElementRequest(path, tmp_path / "out"))
    alone, both = read_data(tmp_path / "out")["blocks"], read_data(out)["blocks"]
    assert len(both["blocks"]) <= len(alone["blocks"])
    jobs = [sum(len(block["jobs"]) for block in item["blocks"]) for item in (alone, both)]
    assert jobs[1] < 0.5 * jobs[0]
    header = (tmp_path / "out" / "blocks.csv").read_text().splitlines()[0]
    assert "together" not in header


@pytest.mark.long
def test_blocks_as_thick_as_their_panels_are_cut_round_on_edge_alone(tmp_path: Path) -> None:
    run_element(ElementRequest(slab(tmp_path, 150.0), tmp_path / "out"))
    rows = rows_in(tmp_path / "out")
    assert rows
    for _, job, problem in rows:
        (outlines,) = problem["operations"]
        assert {cut["surface"] for cut in outlines["cuts"]} == set(job["panels"])
        assert abs(upwards(problem)[2]) < 1e-9
    name = next(iter(rows[0][1]["panels"]))
    cut = {item["name"]: rings(item) for item in rows[0][2]["part"]["ruled"]}[name]
    assert set(np.unique(cut[..., 2])) == {0.0, 150.0}


PIECE = PanelShape(
    np.array(
        [[[x, y, z] for x, y in ((-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (-0.1, 0.1))] for z in (0.0, 0.1)]
    )
)
WIDE = PanelShape(PIECE.outline * [[[1.1, 1.0, 0.9]], [[1.2, 1.0, 0.9]]])
TREE = next(nest_in_lines([(0.24, 0.24)] * 2, (0.24, 0.5), 0.002, False))[0]


@pytest.mark.parametrize("block", [(0.24, 0.5), (0.5, 0.24)])
def test_the_slot_that_takes_a_slab_to_its_thickness_is_above_its_panels(block: tuple[float, float]) -> None:
    tree = next(
        trees[0] for trees in nest_in_lines([(0.24, 0.24)] * 2, block, 0.002, True) if len(trees) == 1
    )
    limits = RowLimits(BowSize(0.65, 0.65), 0.02, 0.2, 0.013)
    (row,) = find_rows(tree, [RowPiece(n, 0.1, PIECE) for n in "ab"], 0.12, limits)[0].values()
    ((start, end),) = row.faces[FRONTS]
    assert np.allclose([start[:, 2], end[:, 2]], 0.1)
    assert np.cross(start[1] - start[0], end[0] - start[0])[2] > 0.0


def test_what_bears_a_row_ends_where_the_wire_comes_in_below_it() -> None:
    """Backs that fall off by 1 in 2 at both ends of a row: the wire goes straight on, 5 mm above the bottom
    where the part ends."""
    y = np.linspace(-0.1, 0.1, 41)

    def face(z: np.ndarray) -> np.ndarray:
        return np.stack([np.stack([np.full(41, x), y, z], axis=1) for x in (-0.1, 0.1)])

    low = 0.025 - 0.5 * np.maximum(np.abs(y) - 0.08, 0.0)
    shape = dataclasses.replace(PIECE, faces=(face(low), face(low + 0.06)))
    limits = RowLimits(BowSize(0.65, 0.65), 0.02, 0.2, 0.013)
    (row,) = find_rows(TREE, [RowPiece(n, 0.1, shape) for n in "ab"], 0.1, limits)[0].values()
    ends = max(float(np.abs(ring[..., 1]).max()) for ring in row.outlines.values())  # 15 mm high there
    beyond = ends + (0.015 - 0.013) / 0.5
    assert -row.beams[0][0] < beyond - 0.012
    assert row.beams[-1][1] < beyond - 0.012


@pytest.mark.parametrize(
    ("shapes", "thick", "limits", "why"),
    [
        ((PIECE, None), (0.1, 0.1), {}, "a bent wire"),
        ((PIECE, PIECE), (0.1, 0.08), {}, "different thicknesses"),
        ((PIECE, PIECE), (0.1, 0.1), {"bow": BowSize(0.6, 0.25)}, "throat of 250 mm allows 230"),
        (
            (PIECE, PIECE),
            (0.1, 0.1),
            {"bow": BowSize(0.13, 0.6)},
            "needs a span of 140 mm, but the bow has 130",
        ),
        (
            (PIECE, PIECE),
            (0.09, 0.09),
            {"bow": BowSize(0.26, 0.6)},
            "to their thickness needs a span of 280 mm",
        ),
        ((PIECE, PIECE), (0.1, 0.1), {"room": 0.05}, "within 20.0 mm of what bears them"),
        ((PIECE, PIECE), (0.0999, 0.0999), {}, "0.1 mm thicker than they are"),
        ((WIDE, WIDE), (0.09, 0.09), {}, "leave the part; 0.33 mm more foam beside them"),
    ],
)
def test_panels_that_are_no_row_are_told_why(
    shapes: tuple[PanelShape | None, PanelShape | None],
    thick: tuple[float, float],
    limits: dict[str, Any],
    why: str,
) -> None:
    given = {"bow": BowSize(0.65, 0.65), "margin": 0.02, "kept": 0.2, "room": 0.013}
    assert isinstance(TREE, CutTree)
    good, none = find_rows(TREE, [RowPiece(n, 0.1, PIECE) for n in "ab"], 0.1, RowLimits(**given))
    (row,) = good.values()
    assert isinstance(row, PanelRow)
    assert len(row.outlines) == 2
    assert not none
    pieces = [RowPiece(n, t, s) for n, t, s in zip("ab", thick, shapes, strict=True)]
    rows, alone = find_rows(TREE, pieces, 0.1, RowLimits(**{**given, **limits}))
    assert not rows
    assert set(alone) == {0, 1}
    assert why in alone[0]


@pytest.mark.long
def test_a_bow_without_room_is_named_for_each_panel(tmp_path: Path) -> None:
    run_element(ElementRequest(slab(tmp_path, bow=400.0), tmp_path / "out"))
    data = read_data(tmp_path / "out")
    told = [
        item["alone"] for block in data["blocks"]["blocks"] for item in block["panels"] if "alone" in item
    ]
    assert len(told) == len(data["panels"])
    assert all(re.search("throat of 400 mm|nothing else|offcut", item) for item in told)
    rows = list(csv.DictReader((tmp_path / "out" / "blocks.csv").open()))
    assert "throat of 400 mm allows 380" in rows[0]["by_themselves"]
    assert "throat of 400 mm allows 380" in (tmp_path / "out" / "element.html").read_text()


@pytest.fixture(scope="module")
def wall(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wall")
    run_element(ElementRequest(WALL, folder / "out"))
    return folder / "out"


@pytest.mark.long
def test_faces_of_a_ruled_wall_are_one_surface_from_panel_to_panel(wall: Path) -> None:
    data = read_data(wall)
    rows = rows_in(wall)
    assert sum(len(job["panels"]) for _, job, _ in rows) > 0.9 * len(data["panels"])
    assert len(data["blocks"]["blocks"]) == 10
    for _, job, problem in rows[:4]:
        cut = {item["name"]: item for item in problem["part"]["ruled"]}
        for whole, face in (("fronts", "front"), ("backs", "back")):
            start, end = rings(cut[whole])
            corners = np.array(cut[whole]["start"]["corners_mm"])
            assert len(corners) == 2 * len(job["panels"]) - 2  # ends of the runs between panels
            for name, pose in job["panels"].items():
                pose = np.array(pose)
                own = yaml.safe_load((wall / "again" / f"{name}.yaml").read_text())["part"]["ruled"]
                (item,) = [each for each in own if each["name"] == face]
                assert item.get("flip") == cut[whole].get("flip")
                for ring in rings(item) @ pose[:3, :3].T + pose[:3, 3]:
                    # each ruling of the panel lies on one of the row, which may be longer
                    way = end - start
                    fraction = ((ring[:, None] - start) * way).sum(-1) / (way * way).sum(-1)
                    deviation = np.linalg.norm(ring[:, None] - start - fraction[..., None] * way, axis=-1)
                    assert deviation.min(axis=1).max() < 1e-5


def plan_rows(out: Path, names: list[str], run: Path) -> dict[str, str]:
    problems = {name: pipeline.load(out / "blocks" / f"{name}.yaml") for name in names}
    return {name: done.state for name, done in batch.plan_all(problems, run, 1).items()}


@pytest.mark.long
def test_rows_of_a_wall_and_of_a_shell_are_proven_and_reported(out: Path, wall: Path, tmp_path: Path) -> None:
    for k, folder in enumerate((out, wall)):
        (block, job, _) = rows_in(folder)[0]
        run = tmp_path / f"run{k}"
        assert plan_rows(folder, [job["id"]], run) == {job["id"]: "verified"}
        (run / "summary.csv").write_text(f"name,state,issues,message\n{job['id']},verified,,\n")
        run_element_report(ElementReport(folder, run))
        rows = {row["id"]: row for row in csv.DictReader((folder / "report.csv").open())}
        for name in job["panels"]:
            assert rows[name]["state"] == "verified"
            assert float(rows[name]["off_written_largest_mm"]) < 0.4, block["id"]


def simulate_cut(problem: dict[str, Any]) -> str:
    """Simulate the part of a row with every cut where its problem has it, in the winding that it states."""
    lines, count = [], 1
    for item in problem["part"]["ruled"]:
        start, end = rings(item)
        if item.get("closed"):
            start, end = (np.concatenate([ring, ring[:1]]) for ring in (start, end))
        fine = np.linspace(0, len(start) - 1, 40 * (len(start) - 1) + 1)
        ends = [np.stack([np.interp(fine, range(len(r)), c) for c in r.T], axis=1) for r in (start, end)]
        fraction = np.linspace(0.0, 1.0, 12)[:, None, None]
        grid = (1.0 - fraction) * ends[0] + fraction * ends[1]
        lines += [f"o cut_{item['name']}", *(f"v {x:.4f} {y:.4f} {z:.4f}" for x, y, z in grid.reshape(-1, 3))]
        number = np.arange(grid.shape[0] * grid.shape[1]).reshape(grid.shape[:2]) + count
        a, b, c = number[:-1, :-1].ravel(), number[:-1, 1:].ravel(), number[1:, :-1].ravel()
        lines += [f"f {i} {j} {k}" for i, j, k in np.stack([a, b, c], axis=1).tolist()]
        count += number.size
    return "\n".join(lines) + "\n"


def test_a_slot_on_the_side_of_the_panels_is_named_by_the_report_and_none_once_planned_anew(
    out: Path, tmp_path: Path
) -> None:
    """Which side a slot is on comes from the problem alone, in claim and program alike: both would be wrong
    together, as they were once."""
    _, job, problem = rows_in(out)[0]
    plan = some_plan()
    operation = plan.operations[0]
    segment = Segment("cut", "fronts")
    claim = CutsSurface(segment, np.zeros((3, 3)), np.array([[0, 1, 2]]), KerfCurve.constant(KERF * MM), 1e-3)
    targets = dataclasses.replace(operation.targets, claims=(claim,))
    plan = dataclasses.replace(plan, operations=(dataclasses.replace(operation, targets=targets),))
    for k, wrong in enumerate((True, False)):
        run = tmp_path / f"run{k}"
        (run / job["id"]).mkdir(parents=True)
        plans.save(plan, run / job["id"])
        (fronts,) = [item for item in problem["part"]["ruled"] if item["name"] == "fronts"]
        turned = {**fronts, "start": fronts["end"], "end": fronts["start"]} if wrong else fronts
        ruled = [turned if item is fronts else item for item in problem["part"]["ruled"]]
        text = simulate_cut({"part": {"ruled": ruled}})
        (run / job["id"] / "simulated_part.obj").write_text(text)
        (run / "summary.csv").write_text(f"name,state,issues,message\n{job['id']},verified,,\n")
        issues = [
            issue for issue in run_element_report(ElementReport(out, run)) if issue.code == "element.face"
        ]
        rows = {row["id"]: row for row in csv.DictReader((out / "report.csv").open())}
        deviations = [float(rows[name]["off_written_largest_mm"]) for name in job["panels"]]
        assert deviations == pytest.approx([KERF if wrong else 0.0] * len(deviations), abs=2e-3)
        assert len(issues) == (len(deviations) if wrong else 0)
        assert all("the slot of 2 mm is in the panel" in issue.message for issue in issues)
        assert {issue.message.split()[3] for issue in issues} == (set(job["panels"]) if wrong else set())
