"""Ruled walls in boxes and puzzle pieces: the content of their files, read by independent test code.

The two are compared on the wall of the dissertation. Also what is refused, and that the advice then helps.
"""

from __future__ import annotations

import csv
import dataclasses
import html
import itertools
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
import yaml

from planner import pipeline
from planner.element import element_file, element_page, run_report, wall_files, walls
from planner.element.boxes import most_even_cuts
from planner.element.nested_output import nested_folder
from planner.element.panel_box import hull_boxes
from planner.element.puzzle import FILLET_RATIO, lobe_outline
from planner.issues import Issue, TandemError
from planner.processes.hotwire.plan.operation import Straight
from planner.processes.hotwire.plan.straight.job import StraightJob
from tests.element.walls import ROOT, expect_refusal

PROBLEM = ROOT / "problems" / "ruled_wall_108"
LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
THICK = 50.0
SIDES = ("right", "top", "left", "bottom")


def wall(folder: Path, panels: Any = None, **changes: Any) -> Path:
    """An element file of a twisted wall, 0.6 m wide and about 1.1 m long, with ``changes``."""
    folder.mkdir(parents=True, exist_ok=True)
    template = yaml.safe_load((PROBLEM / "panel.yaml").read_text())
    template["cell"] = str(ROOT / "problems" / "cells" / "irb4600_bow.yaml")
    (folder / "panel.yaml").write_text(yaml.safe_dump(template))
    guides = {
        "start": {"bspline_mm": [[0, 0, 0], [0, 300, 260], [0, 650, 260], [0, 1000, 0]]},
        "end": {"bspline_mm": [[600, 0, 40], [600, 320, 260], [600, 680, 300], [600, 1000, 20]]},
    }
    data = {
        "element": 1,
        "name": "small",
        "surface": {"ruled": {"name": "front", "match": "parameter", **guides}},
        "thickness_mm": THICK,
        "panels": panels or {"boxes": {}},
        "blocks": [{"size_mm": [1250, 600, 100], "foam": "eps_a120"}],
        "raw_blocks": {
            "sizes": [{"size_mm": [1250, 600, 100], "foam": "eps_a120"}],
            "kerf_mm": 2,
            "bow": {"span_mm": 400, "throat_mm": 400},
        },
        "jobs": [{"problem": "panel.yaml"}],
    }
    path = folder / "element.yaml"
    path.write_text(yaml.safe_dump({**data, **changes}))
    return path


PUZZLE = {"puzzle": {"lobe_mm": 30, "cells": [3, 5]}}


def read_element(path: Path) -> element_file.WallElement:
    result = element_file.read_element(path)
    assert isinstance(result, element_file.WallElement)
    return result


def divide(path: Path) -> dict[str, str]:
    """The files of a wall by their names."""
    element = read_element(path)
    return wall_files.wall_folder(element, walls.divide_wall(element))[0]


def refusal(path: Path) -> Issue:
    """The one issue that a wall is refused with."""
    return expect_refusal(lambda: walls.divide_wall(read_element(path)))


@dataclasses.dataclass(frozen=True)
class WrittenWallPanel:
    """A panel as its problem file has it [mm]: ends (2, N, 3) of the rulings of its surfaces in the wall's
    frame, the size of its block, and its row of ``element.json``."""

    surfaces: dict[str, np.ndarray]
    block: np.ndarray
    row: dict[str, Any]

    def local(self, points: np.ndarray) -> np.ndarray:
        """Points in the frame of its block."""
        pose = np.array(self.row["block_pose"])
        return (points - pose[:3, 3]) @ pose[:3, :3]

    def sides(self) -> np.ndarray:
        """The rulings (2, N, 3) of all sides, without those by which they go on through the block."""
        return np.concatenate([self.surfaces[side][:, 1:-2] for side in SIDES], axis=1)

    def part(self) -> np.ndarray:
        """Points (K, 3) all round its body: where the rulings of its sides go through front and back."""
        sides = self.sides()
        ways = sides[1] - sides[0]
        result = [
            sides[0] + _intersect(sides[0], ways, self.surfaces[face])[:, None] * ways
            for face in ("back", "front")
        ]
        return np.concatenate(result)


def _intersect(start: np.ndarray, direction: np.ndarray, face: np.ndarray) -> np.ndarray:
    """Shares of lines at which they go through triangles between the rulings of a face."""
    a, b = face
    low = np.concatenate([np.stack([a[:-1], b[:-1], a[1:]], 1), np.stack([b[1:], a[1:], b[:-1]], 1)])
    base, item, two = low[:, 0], low[:, 1] - low[:, 0], low[:, 2] - low[:, 0]
    across = np.cross(item, two)
    with np.errstate(divide="ignore", invalid="ignore"):
        fraction = ((base - start[:, None]) * across).sum(-1) / (direction[:, None] * across).sum(-1)
        at = start[:, None] + fraction[..., None] * direction[:, None] - base
        size = (across * across).sum(-1)
        u = (np.cross(at, two) * across).sum(-1) / size
        v = (np.cross(item, at) * across).sum(-1) / size
    inside = (u > -1e-6) & (v > -1e-6) & (u + v < 1 + 1e-6)
    assert inside.any(axis=1).all()
    return np.asarray(fraction[np.arange(len(start)), np.argmax(inside, axis=1)])


def read_panels(files: dict[str, str]) -> dict[str, WrittenWallPanel]:
    """All panels by their ids, out of the texts of a folder."""
    result = {}
    for row in json.loads(files["element.json"])["panels"]:
        data = yaml.load(files[f"panels/{row['id']}.yaml"], Loader=LOADER)
        pose = np.array(row["block_pose"])
        surfaces = {
            item["name"]: np.array([item[end]["polyline_mm"] for end in ("start", "end")]) @ pose[:3, :3].T
            + pose[:3, 3]
            for item in data["part"]["ruled"]
        }
        result[row["id"]] = WrittenWallPanel(surfaces, np.array(data["stock"]["size_mm"]), row)
    return result


@pytest.fixture(scope="module")
def boxes(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    return divide(wall(tmp_path_factory.mktemp("boxes")))


@pytest.fixture(scope="module")
def puzzle(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    return divide(wall(tmp_path_factory.mktemp("puzzle"), PUZZLE))


def excess(file: str) -> tuple[int, float]:
    """How many panels the wall of the dissertation has, and litres of foam that are bought and are none."""
    element = read_element(PROBLEM / file)
    panels = walls.divide_wall(element)
    blocks = [wall_files.panel_block(element, panel, f"P{k}") for k, panel in enumerate(panels)]
    table, _, _ = nested_folder(element, blocks)
    rows = [row for row in csv.DictReader(table["blocks.csv"].splitlines()) if row["block"] != "all"]
    sizes = [[float(row[f"{side}_mm"]) for side in ("length", "width", "thickness")] for row in rows]
    assert sizes == [[1250, 600, 100]] * len(rows)
    assert sorted(name for row in rows for name in row["panels"].split()) == sorted(b.name for b in blocks)
    # the front's area is taken from the wall's own rulings: thickness changes that by curvature alone
    quads = element.wall.ends
    area = 0.5 * np.linalg.norm(np.cross(quads[1:, 1] - quads[:-1, 0], quads[1:, 0] - quads[:-1, 1]), axis=1)
    shell = 1e3 * THICK / 1e3 * area.sum()
    assert sum(1e3 * panel.volume for panel in panels) == pytest.approx(shell, rel=0.05)
    return len(panels), len(rows) * 75.0 - shell


def test_what_panels_take_is_told_before_they_are_planned(boxes: dict[str, str]) -> None:
    """Metres along all surfaces that are cut, half-way between their lines, at 6 mm/s; one stop to bring the
    foam, one to move it."""
    for row in json.loads(boxes["element.json"])["panels"][:3]:
        data = yaml.safe_load(boxes[f"panels/{row['id']}.yaml"])
        ways = {
            item["name"]: sum(
                0.5e-3 * np.linalg.norm(np.diff(item[side]["polyline_mm"], axis=0), axis=1).sum()
                for side in ("start", "end")
            )
            for item in data["part"]["ruled"]
        }
        cuts = [cut["surface"] for operation in data["operations"] for cut in operation["cuts"]]
        assert len(cuts) == 6
        assert row["cut_m"] == pytest.approx(sum(ways[name] for name in cuts), abs=1e-3)
        assert row["cut_min"]["robot"] == pytest.approx(row["cut_m"] / 0.006 / 60.0, abs=1e-3)
        assert row["stops"] == 2


@pytest.mark.long
def test_boxes_take_at_most_three_fifths_of_the_pieces_and_half_the_excess_of_the_puzzle() -> None:
    """The dissertation claims half of both for its wall, of 108 puzzle pieces."""
    (few, waste), (many, more) = excess("boxes.yaml"), excess("element.yaml")
    assert many == 108
    assert few <= 0.6 * many
    assert waste <= 0.5 * more


def test_the_wall_of_the_dissertation_has_its_measures() -> None:
    """1.7 m wide, 2.1 m long, directrices of 3.2 m."""
    ends = read_element(PROBLEM / "element.yaml").wall.ends
    np.testing.assert_allclose(np.ptp(ends, axis=(0, 1))[:2], [1.7, 2.1], atol=0.03)
    directrices = np.linalg.norm(np.diff(ends, axis=0), axis=2).sum(axis=0)
    np.testing.assert_allclose(directrices, 3.2, atol=0.06)


@pytest.mark.parametrize("kind", ["boxes", "puzzle"])
def test_panels_fit_half_blocks_with_foam_around_them(kind: str, request: pytest.FixtureRequest) -> None:
    for panel in read_panels(request.getfixturevalue(kind)).values():
        local = panel.local(panel.part())
        room = 0.5 * panel.block[:2] - np.abs(local[:, :2]).max(axis=0)
        assert (room >= 4.0 - 0.06).all()
        assert (room <= 4.2).all()
        assert local[:, 2].min() >= 4.0 - 1e-3
        assert local[:, 2].max() <= 96.0 + 1e-3
        # half of 600 less one kerf
        assert panel.block[0] <= 299.0
        assert panel.block[2] == 100.0


def test_strips_are_as_wide_as_the_formula_says_and_heights_are_even(boxes: dict[str, str]) -> None:
    panels = list(read_panels(boxes).values())
    shares = sorted({(p.row["from_share"], p.row["to_share"]) for p in panels})
    wide = [np.linalg.norm(np.subtract(*p.surfaces["front"][:, 5])) for p in panels]
    count = int(np.ceil(len(shares) * max(wide) / 1.02 / (299.0 - 8.0) / len(shares)))
    assert len(shares) == max(count, 3)
    np.testing.assert_allclose(np.diff(shares, axis=1), 1 / len(shares), atol=1e-6)
    for strip in shares:
        own = sorted((p.row["from_mm"], p.row["to_mm"]) for p in panels if p.row["from_share"] == strip[0])
        assert all(a[1] == b[0] for a, b in itertools.pairwise(own))
        heights = np.diff(own, axis=1)
        assert heights.min() > 0.5 * heights.max()


def test_the_fewest_and_most_even_intervals_are_those_of_all() -> None:
    """Against all subsets of the places."""
    rng = np.random.default_rng(3)
    for _ in range(20):
        places = np.concatenate([[0.0], np.sort(rng.uniform(0.0, 1.0, 7)), [1.0]])
        allowed = np.triu(rng.uniform(size=(9, 9)) < 0.5, 1)
        ways = [
            (0, *inner, 8)
            for k in range(8)
            for inner in itertools.combinations(range(1, 8), k)
            if all(allowed[pair] for pair in itertools.pairwise((0, *inner, 8)))
        ]
        cuts = most_even_cuts(places, allowed)
        if not ways:
            assert cuts is None
            continue
        assert cuts is not None and tuple(cuts) in ways
        best = min(ways, key=lambda way: (len(way), (np.diff(places[list(way)]) ** 2).sum()))
        assert len(cuts) == len(best)
        both = [(np.diff(places[list(way)]) ** 2).sum() for way in (cuts, best)]
        assert both[0] == pytest.approx(both[1], abs=1e-3)


def neighbours(panel: WrittenWallPanel) -> set[str]:
    """The neighbours of a panel; an edge on the rim has none."""
    return {name for name in panel.row["neighbours"] if name is not None}


@pytest.mark.parametrize("kind", ["boxes", "puzzle"])
def test_neighbours_are_cut_along_the_same_lines(kind: str, request: pytest.FixtureRequest) -> None:
    """Each ruling of a side but those on the rim is one of a neighbour's, as written."""
    panels = read_panels(request.getfixturevalue(kind))
    shared = {name: np.zeros(panel.sides().shape[1], dtype=bool) for name, panel in panels.items()}
    for name, panel in panels.items():
        own = panel.sides()
        for other in neighbours(panel):
            assert name in neighbours(panels[other])
            there = panels[other].sides()
            gaps = np.abs(own[:, :, None] - there[:, None]).max(axis=(0, 3)).min(axis=1)
            assert (gaps < 1e-6).sum() >= 2 or kind == "boxes"
            shared[name] |= gaps < 1e-6
    inner = [name for name, panel in panels.items() if None not in panel.row["neighbours"]]
    assert inner or kind == "boxes"
    for name in inner:
        alone = (~shared[name]).sum()
        assert alone == 0 if kind == "puzzle" else alone <= 4


@pytest.mark.parametrize("kind", ["boxes", "puzzle"])
def test_panels_are_laid_out_as_seen_from_the_front(kind: str, request: pytest.FixtureRequest) -> None:
    """As labels show them: two neighbours follow each other the same way round as in the wall itself."""
    panels = read_panels(request.getfixturevalue(kind))
    looked = 0
    for panel in panels.values():
        part = panel.part()
        middle, front = part.mean(axis=0), part[len(part) // 2 :].mean(axis=0)
        around = [panels[name] for name in sorted(neighbours(panel))]
        for item, other in itertools.combinations(around, 2):
            own, first, then = (np.mean(p.row["outline_mm"], axis=0) for p in (panel, item, other))
            drawn = np.linalg.det([first - own, then - own])
            if abs(drawn) < 1e3:  # mm2: they lie on one line
                continue
            ways = [p.part().mean(axis=0) - middle for p in (item, other)]
            assert np.sign(np.dot(np.cross(*ways), front - middle)) == np.sign(drawn)
            looked += 1
    assert looked > 5


def test_faces_of_neighbours_meet_and_are_one_thickness_apart(boxes: dict[str, str]) -> None:
    for panel in read_panels(boxes).values():
        part = panel.part()
        back, front = part[: len(part) // 2], part[len(part) // 2 :]
        np.testing.assert_allclose(np.linalg.norm(front - back, axis=1), THICK, atol=0.02)
        assert panel.row["off_surface_mm"] < 0.5


def test_lobes_lock_and_have_no_inner_corner_that_a_wire_cannot_go_round() -> None:
    radius = 0.04
    points = np.concatenate([[[-0.1, 0.0]], lobe_outline(radius), [[0.1, 0.0]]])
    body = shapely.Polygon([*points, (0.1, -0.05), (-0.1, -0.05)])
    assert body.is_valid
    assert points[:, 1].max() == pytest.approx(1.7 * radius, rel=1e-3)
    # the neck is narrower than what is behind it
    neck = body.intersection(
        shapely.LineString([(-0.1, FILLET_RATIO * radius), (0.1, FILLET_RATIO * radius)])
    ).length
    assert neck < 1.75 * radius
    # what a slot that is nearly as wide as two fillets cannot reach beside the lobe is nothing
    wide = 0.95 * FILLET_RATIO * radius
    outside = shapely.box(-0.1, -0.05, 0.1, 0.1) - body
    left = outside - outside.buffer(-wide, 64).buffer(wide, 64)
    near = left.intersection(shapely.box(-0.08, -0.01, 0.08, 0.09))
    assert near.area < 1e-3 * body.area * FILLET_RATIO
    sharp = 0.5 * (points[1:] + points[:-1])
    assert len(sharp) > 40


def test_pieces_slide_in_one_way_and_have_up_to_four_lobes_around_them(puzzle: dict[str, str]) -> None:
    """Rows from the first on: lobes to pieces that are there already are cut along one direction."""
    panels = read_panels(puzzle)
    by_place = {panel.row["place"]: panel for panel in panels.values()}
    assert len(by_place) == 15
    for place, panel in by_place.items():
        way = -np.array(panel.row["way_in"])
        assert np.linalg.norm(way) == pytest.approx(1.0)
        for other in neighbours(panel):
            if panels[other].row["place"] > place:
                continue
            there = panels[other].sides()
            own = panel.sides()
            same = np.abs(own[:, :, None] - there[:, None]).max(axis=(0, 3)).min(axis=1) < 1e-6
            lines = own[1, same] - own[0, same]
            along = lines / np.linalg.norm(lines, axis=1, keepdims=True)
            parallel = np.linalg.norm(np.cross(along, way), axis=1) < 1e-7
            assert parallel.sum() >= len(lobe_outline(0.03))
        assert 0.0 <= panel.row["jam_mm"] < 1.0


def test_numbers_grow_with_heights_and_say_where_a_panel_belongs(boxes: dict[str, str]) -> None:
    rows = list(csv.DictReader(boxes["panels.csv"].splitlines()))
    assert [row["id"] for row in rows] == [f"P{k:02d}" for k in range(len(rows))]
    heights = [float(row["box_height_mm"]) for row in rows]
    assert all(b - a > -0.1 for a, b in itertools.pairwise(heights))
    assert len({row["place"] for row in rows}) == len(rows)
    assert {row["place"][0] for row in rows} == set("ABC")
    for row in rows:
        assert f">{row['id']}<" in boxes["panels.svg"]


def test_the_same_file_gives_the_same_bytes_and_a_billionth_moves_no_id(
    tmp_path: Path, boxes: dict[str, str]
) -> None:
    path = wall(tmp_path)
    assert divide(path) == boxes
    data = yaml.safe_load(path.read_text())
    data["surface"]["ruled"]["end"]["bspline_mm"][1][2] += 1e-6
    path.write_text(yaml.safe_dump(data))
    moved = divide(path)
    ids = [
        [(r["id"], r["place"]) for r in csv.DictReader(f["panels.csv"].splitlines())] for f in (boxes, moved)
    ]
    assert ids[0] == ids[1]


@pytest.mark.parametrize("kind", ["boxes", "puzzle"])
def test_panels_are_ordinary_problems(kind: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    files = request.getfixturevalue(kind)
    (tmp_path / "P03.yaml").write_text(files["panels/P03.yaml"])
    problem = pipeline.load(tmp_path / "P03.yaml")
    assert problem.part is not None
    assert [item.name for item in problem.part.ruled] == ["front", "back", *SIDES]


@pytest.mark.parametrize("kind", ["boxes", "puzzle"])
def test_sides_go_straight_on_to_the_faces_of_the_block(kind: str, request: pytest.FixtureRequest) -> None:
    for panel in read_panels(request.getfixturevalue(kind)).values():
        half = 0.5 * panel.block[:2]
        for name in SIDES:
            side = np.stack([panel.local(line) for line in panel.surfaces[name]])
            for on, at, before in ((0, 1, 2), (-1, -2, -3)):
                np.testing.assert_allclose(side[:, on, 2], side[:, at, 2], atol=1e-6)
                way, tilt = side[:, on] - side[:, at], side[1, at] - side[0, at]
                np.testing.assert_allclose(way[0], way[1], atol=1e-6)
                assert (np.abs(side[:, on, :2]) - half).max() == pytest.approx(-1.2, abs=0.06)
                normal = np.cross(tilt, (side[:, at] - side[:, before]).sum(axis=0))
                assert abs(way[0] @ normal) < 1e-4 * np.linalg.norm(normal) * np.linalg.norm(way[0])


def test_what_goes_on_beyond_a_corner_takes_nothing_from_the_part(
    puzzle: dict[str, str], tmp_path: Path
) -> None:
    """There the back goes on below the side, beyond the next one."""
    (tmp_path / "P02.yaml").write_text(puzzle["panels/P02.yaml"])
    problem = pipeline.load(tmp_path / "P02.yaml")
    sides = problem.operations[1]
    assert isinstance(sides, Straight) and problem.part is not None
    made = StraightJob(sides, problem.setups[0], problem.part).targets()
    assert {issue.code for issue in made.issues} <= {"kerf.doubt"}


@pytest.mark.long
def test_faces_and_sides_of_a_panel_are_planned_and_proven(tmp_path: Path) -> None:
    """As they are written; the operator moves the block between them."""
    (tmp_path / "P20.yaml").write_text(divide(PROBLEM / "boxes.yaml")["panels/P20.yaml"])
    outcome = pipeline.plan(pipeline.load(tmp_path / "P20.yaml"))
    assert outcome.verified, outcome.issues


def test_what_is_said_of_the_raw_blocks_is_told_on_the_page_too(tmp_path: Path) -> None:
    raw = {
        "sizes": [{"size_mm": [1250, 600, 100], "foam": "eps_a120"}],
        "kerf_mm": 2,
        "bow": {"span_mm": 400, "throat_mm": 60},
    }
    element = read_element(wall(tmp_path, raw_blocks=raw))
    files, said = wall_files.wall_folder(element, walls.divide_wall(element))
    assert {issue.code for issue in said} == {"element.cut"}
    data = json.loads(files["element.json"])
    assert data["issues"] == [issue.to_dict() for issue in said]
    page = element_page.element_page(run_report.unplanned_run(data))
    assert all(html.escape(issue.message) in page for issue in said)


def test_blocks_too_thin_are_refused_with_the_thickness_that_fits(tmp_path: Path) -> None:
    panels = {"boxes": {"least_height_mm": 200}}
    blocks = {"blocks": [{"size_mm": [1250, 600, 42], "foam": "eps_a120"}], "raw_blocks": None}
    issue = refusal(wall(tmp_path, panels, **blocks, thickness_mm=32))
    assert issue.code == "element.block"
    match = re.search(r"thickness_mm: (\d+) would fit", str(issue.hint))
    assert match is not None
    assert walls.divide_wall(read_element(wall(tmp_path, panels, **blocks, thickness_mm=float(match[1]))))
    refusal(wall(tmp_path, panels, **blocks, thickness_mm=float(match[1]) + 1.0))


def test_rulings_longer_than_the_bow_are_shared_out(tmp_path: Path) -> None:
    blocks = [{"size_mm": [1250, 700, 100]}]
    whole = walls.divide_wall(read_element(wall(tmp_path, raw_blocks=None, blocks=blocks)))
    assert {panel.piece.across for panel in whole} == {(0.0, 1.0)}
    raw = {"sizes": blocks, "kerf_mm": 2, "bow": {"span_mm": 150, "throat_mm": 400}}
    parts = walls.divide_wall(read_element(wall(tmp_path, raw_blocks=raw, blocks=blocks)))
    assert max(panel.size[0] for panel in parts) <= 1e-3 * (700 - 4 * 2) / 5 + 1e-6


def test_lobes_too_large_for_their_cells_are_refused_with_the_size_that_fits(tmp_path: Path) -> None:
    issue = refusal(wall(tmp_path, {"puzzle": {"lobe_mm": 60, "cells": [4, 5]}}))
    assert issue.code == "element.shape"
    match = re.search(r"lobe_mm: ([\d.]+)", str(issue.hint))
    assert match is not None
    radius = 1e-3 * float(match[1])
    panels = walls.divide_wall(
        read_element(wall(tmp_path, {"puzzle": {"lobe_mm": 1e3 * radius, "cells": [4, 5]}}))
    )
    for panel in panels:
        outline = shapely.Polygon(np.concatenate([side[1, 1:-2, :2] for side in panel.sides]))
        assert outline.is_valid
        assert outline.buffer(-0.2 * radius).geom_type == "Polygon"


def closed_wall() -> dict[str, Any]:
    angle = np.linspace(0.0, 2.0 * np.pi, 60)
    rings = [[[x, 400 * float(np.sin(a)), 400 * float(np.cos(a))] for a in angle] for x in (0, 500)]
    return {"name": "front", "start": {"polyline_mm": rings[0]}, "end": {"polyline_mm": rings[1]}}


def edged_wall() -> dict[str, Any]:
    lines = [[[x, 0, 0], [x, 400, 0], [x, 400, 400]] for x in (0, 500)]
    return {"name": "front", "start": {"polyline_mm": lines[0]}, "end": {"polyline_mm": lines[1]}}


@pytest.mark.parametrize("ruled", [closed_wall(), {**closed_wall(), "closed": True}, edged_wall()])
def test_walls_that_are_closed_or_have_edges_are_refused(tmp_path: Path, ruled: dict[str, Any]) -> None:
    issue = refusal(wall(tmp_path, surface={"ruled": ruled}))
    assert issue.code == "element.surface"
    assert "halves" in issue.message or "(250, 400, 0) mm" in issue.message


def test_a_mirrored_wall_is_thick_to_its_other_side(tmp_path: Path, boxes: dict[str, str]) -> None:
    data = yaml.safe_load(wall(tmp_path).read_text())
    over = divide(wall(tmp_path, surface={"ruled": {**data["surface"]["ruled"], "flip": True}}))
    up = [
        np.mean([np.array(p.row["block_pose"])[2, 2] for p in read_panels(f).values()]) for f in (boxes, over)
    ]
    assert up[0] * up[1] < 0.0


def test_what_is_of_another_kind_is_refused(tmp_path: Path) -> None:
    wire = {"material": "spring_steel", "diameter_mm": 2.0, "lengths_mm": [900], "temperature_c": 300}
    for change in (
        {"wires": [wire]},
        {"panels": {"boxes": {}, **PUZZLE}},
        {"panels": {"hexagons": {"count": 40}}},
        {"surface": {"mesh": {"file": "wall.obj", "unit": "mm"}}},
        {"foam_sides_mm": 0},
    ):
        with pytest.raises(TandemError) as caught:
            element_file.read_element(wall(tmp_path, **change))
        assert [issue.code for issue in caught.value.issues] == ["problem.field"]


def test_boxes_round_points_follow_no_edge_without_a_length() -> None:
    """Points that are apart by the last digit leave edges of a hull whose direction is noise."""
    rng = np.random.default_rng(5)
    corners = np.array([[0.0, 0.0], [0.3, 0.0], [0.3, 0.2], [0.0, 0.2]])
    for turn in rng.uniform(0.0, 2.0 * np.pi, 200):
        own = corners @ [[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]
        near = np.nextafter(own, rng.normal(size=own.shape))
        way, size = hull_boxes(np.concatenate([own, near]))
        np.testing.assert_allclose(np.linalg.norm(way, axis=1), 1.0)
        np.testing.assert_allclose(np.sort(size, axis=1), np.tile([0.2, 0.3], (len(size), 1)), atol=1e-12)
