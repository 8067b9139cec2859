"""Shells of planar panels: the content of their files, read by independent test code.

Also what is refused, and that the advice then helps.
"""

from __future__ import annotations

import csv
import itertools
import math
import re
from pathlib import Path
from typing import Any

import manifold3d
import numpy as np
import pytest
import shapely
import trimesh

from planner import pipeline
from planner.cli.element import ElementRequest, run_element
from planner.element import element_file, hexagon_files, hexagons
from planner.geometry.mesh import TriangleMesh
from planner.issues import Issue, Severity, TandemError, has_errors
from tests.element.shells import THICK, WrittenPanel, cap, patch, read_panels, saddle, shell
from tests.element.walls import ROOT, element


def divide(path: Path) -> dict[str, str]:
    """The files of a shell by their names."""
    return divide_with_issues(path)[0]


def divide_with_issues(path: Path) -> tuple[dict[str, str], tuple[Issue, ...]]:
    """Return the files of a shell, and its issues."""
    read = element_file.read_element(path)
    assert isinstance(read, element_file.HexagonElement)
    return hexagon_files.hexagon_folder(read, hexagons.divide_hexagons(read))


def refusals(path: Path) -> dict[str, Issue]:
    """The issues that a shell is refused with, by their fields."""
    with pytest.raises(TandemError) as caught:
        divide(path)
    return {str(issue.field): issue for issue in caught.value.issues}


@pytest.fixture(scope="module")
def dome() -> dict[str, WrittenPanel]:
    """The panels of the dome among the problems."""
    return read_panels(divide(ROOT / "problems" / "dome_267" / "element.yaml"))


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    return divide(shell(tmp_path_factory.mktemp("shell")))


def plane_deviation(points: np.ndarray) -> float:
    """How far points are off their best plane."""
    rest = points - points.mean(axis=0)
    return float(np.abs(rest @ np.linalg.svd(rest)[2][2]).max())


def sides(panel: WrittenPanel) -> list[np.ndarray]:
    """The four corners of each side."""
    return [
        np.stack([panel.bottom[i - 1], panel.bottom[i], panel.top[i], panel.top[i - 1]])
        for i in [*range(1, len(panel.top)), 0]
    ]


def require_convex_panel(panel: WrittenPanel, thick: float, min_edge: float) -> None:
    """Require level faces ``thick`` [mm] apart, convex, with planar sides and edges of ``min_edge`` [mm]."""
    for ring, height in zip(panel.local_outlines, (0.0, thick), strict=True):
        assert (ring[:, 2] == height).all()
        outline = shapely.Polygon(ring[:, :2])
        assert outline.is_valid
        assert outline.exterior.is_ccw
        # convex up to the last digit that is written
        assert outline.convex_hull.area - outline.area < 1e-3
        assert np.linalg.norm(np.roll(ring, -1, axis=0) - ring, axis=1).min() >= min_edge
    assert max(map(plane_deviation, sides(panel))) < 1e-6


def test_the_dome_has_267_convex_panels_with_planar_faces_and_sides_as_written(
    dome: dict[str, WrittenPanel],
) -> None:
    assert len(dome) == 267
    longest, off = [], []
    for panel in dome.values():
        require_convex_panel(panel, 200.0, 50.0)
        longest.append(np.linalg.norm(panel.top[:, None] - panel.top, axis=2).max())
        x, y, z = np.concatenate([panel.top, panel.top.mean(axis=0)[None]]).T / 1e3
        # to first order: the level set's value by its slope
        value = (x / 5) ** 2 + (y / 4) ** 2 + (z / 2.5 + 0.5) ** 2 - 1.25
        slope = 2.0 * np.linalg.norm([x / 25, y / 16, (z / 2.5 + 0.5) / 2.5], axis=0)
        off.append(1e3 * np.abs(value / slope)[(x / 5) ** 2 + (y / 4) ** 2 < 1.17].max())
    assert 5.0 < max(off) < 0.03 * np.median(longest)


def test_neighbours_have_the_same_side_as_their_files_say(dome: dict[str, WrittenPanel]) -> None:
    shared = whole = 0
    for name, panel in dome.items():
        for i, other in enumerate(panel.row["neighbours"]):
            if other is None or other < name:
                continue
            beyond = dome[other]
            k = beyond.row["neighbours"].index(name)
            side, neighbour_side = sides(panel)[i][[1, 0, 3, 2]], sides(beyond)[k]
            # on the rim each panel's back ends in its own side, square to it
            beside = panel.row["neighbours"]
            inner = [beside[(i + 1) % len(beside)] is not None, beside[i - 1] is not None]
            same = np.array([*inner, True, True])
            np.testing.assert_allclose(side[same], neighbour_side[same], atol=1e-6)
            assert plane_deviation(np.concatenate([side, neighbour_side])) < 1e-6
            shared += 1
            whole += bool(same.all())
    assert shared > 690
    assert whole > 600
    assert {panel.row["backs_apart_mm"] for panel in dome.values()} == {0.0}


def test_solids_are_disjoint_and_fill_their_union_and_volumes_are_those_of_the_table(
    dome: dict[str, WrittenPanel],
) -> None:
    bodies = [manifold3d.Manifold.hull_points(np.concatenate([p.bottom, p.top]) / 1e3) for p in dome.values()]
    volumes = [body.volume() for body in bodies]
    union = manifold3d.Manifold.batch_boolean(bodies, manifold3d.OpType.Add)
    assert abs(union.volume() - sum(volumes)) < 1e-9
    stated = [panel.row["volume_l"] for panel in dome.values()]
    np.testing.assert_allclose(stated, 1e3 * np.array(volumes), atol=1e-3)


def test_rows_go_up_from_panel_to_panel(dome: dict[str, WrittenPanel]) -> None:
    rows = "".join(sorted({name[0] for name in dome}))
    assert rows == "ABCDEFGH"
    for row in rows:
        count = sum(name[0] == row for name in dome)
        assert {f"{row}{k:02d}" for k in range(1, count + 1)} <= dome.keys()
    for name, panel in dome.items():
        letters = {other[0] for other in panel.row["neighbours"] if other}
        if name[0] == "A":
            assert None in panel.row["neighbours"]  # all of them stand on the rim
        else:
            assert chr(ord(name[0]) - 1) in letters
        assert max(letters) <= chr(ord(name[0]) + 1)
    heights = [np.mean([p.top[:, 2].mean() for n, p in dome.items() if n[0] == row]) for row in rows]
    assert all(a < b for a, b in itertools.pairwise(heights))


def test_blocks_hold_their_panels_with_foam_beside_them(small: dict[str, str]) -> None:
    for panel in read_panels(small).values():
        both = np.concatenate(panel.local_outlines)
        room = 0.5 * panel.block[:2] - np.abs(both[:, :2]).max(axis=0)
        assert (room >= 10.0 - 1e-6).all()
        assert (room <= 10.1).all()
        assert panel.block[0] >= panel.block[1]
        assert panel.block[2] == THICK


def test_no_turned_box_is_smaller(small: dict[str, str]) -> None:
    for panel in read_panels(small).values():
        both = np.concatenate(panel.local_outlines)[:, :2]
        for angle in np.deg2rad(np.arange(0.0, 90.0, 1.0)):
            turned = both @ np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
            assert np.ptp(turned, axis=0).prod() >= np.ptp(both, axis=0).prod() * (1.0 - 1e-6)


def test_the_smallest_block_that_holds_a_panel_is_taken(tmp_path: Path) -> None:
    sizes = [[1200, 1000, THICK], [700, 650, THICK + 50], [700, 650, THICK]]
    panels = read_panels(divide(shell(tmp_path, blocks=[{"size_mm": s, "foam": "eps_a120"} for s in sizes])))
    small = {name for name, p in panels.items() if p.block[0] <= 700 and p.block[1] <= 650}
    assert 0 < len(small) < len(panels)
    for name, panel in panels.items():
        expected = sizes[2] if name in small else sizes[0]
        assert panel.row["raw_block_mm"] == " x ".join(f"{v:g}" for v in expected)


def test_the_table_says_what_the_outlines_say(small: dict[str, str]) -> None:
    rows = list(csv.DictReader(small["panels.csv"].splitlines()))
    panels = read_panels(small)
    assert [row["id"] for row in rows] == list(panels) == sorted(panels)
    drawing = small["panels.svg"]
    assert "http" not in drawing.replace("http://www.w3.org/2000/svg", "")
    for row, panel in zip(rows, panels.values(), strict=True):
        assert f">{row['id']}<" in drawing
        count = len(panel.top)
        assert int(row["sides"]) == count
        for k in range(count):
            a, b, c = (panel.top[i % count] for i in (k - 1, k, k + 1))
            assert float(row["front_edges_mm"].split()[k]) == pytest.approx(np.linalg.norm(c - b), abs=1e-3)
            cosine = (a - b) @ (c - b) / np.linalg.norm(a - b) / np.linalg.norm(c - b)
            turn = np.degrees(np.arccos(cosine))
            assert float(row["corners_deg"].split()[k]) == pytest.approx(turn, abs=2e-3)
            down = panel.bottom[(k + 1) % count] - panel.bottom[k]
            assert float(row["back_edges_mm"].split()[k]) == pytest.approx(np.linalg.norm(down), abs=1e-3)
            side = np.cross(down, panel.top[k] - panel.bottom[k])
            normal = np.array(panel.row["block_pose"])[:3, 2]
            tilt = -np.degrees(np.arcsin(side @ normal / np.linalg.norm(side)))
            assert float(row["leans_deg"].split()[k]) == pytest.approx(tilt, abs=2e-3)
        own = [name or "-" for name in panel.row["neighbours"]]
        assert row["neighbours"].split() == own
        # the foam weighs 22 kg/m^3
        assert float(row["weight_kg"]) == pytest.approx(0.022 * float(row["volume_l"]), abs=1e-3)


def test_ids_do_not_change_where_the_surface_moves_by_a_billionth(
    tmp_path: Path, small: dict[str, str]
) -> None:
    moved = divide(shell(tmp_path, cap(1e-9)))
    assert list(moved) == list(small)
    original, perturbed = read_panels(small), read_panels(moved)
    for name, panel in original.items():
        assert panel.row["neighbours"] == perturbed[name].row["neighbours"]
        np.testing.assert_allclose(panel.top, perturbed[name].top, atol=0.01)
        np.testing.assert_allclose(panel.local_outlines[1], perturbed[name].local_outlines[1], atol=0.01)


def test_the_same_file_gives_the_same_bytes(tmp_path: Path, small: dict[str, str]) -> None:
    assert divide(shell(tmp_path)) == small


def test_panels_are_ordinary_problems_and_a_gripper_of_the_rack_holds_them(tmp_path: Path) -> None:
    plates = [
        {"kind": "gripper_plate", "name": f"plate_{size}", "width_mm": size, "depth_mm": size}
        for size in (80, 140, 200)
    ]
    tight = {"count": 150, "least_edge_mm": 15, "least_width_mm": 60}
    path = shell(tmp_path, jobs=[{"problem": "held.yaml", "grippers": plates}], hexagons=tight)
    assert run_element(ElementRequest(path, tmp_path / "out")) == ()
    held = set()
    for file in sorted((tmp_path / "out" / "panels").glob("*.yaml"))[::10]:
        problem = pipeline.load(file)
        assert problem.name == f"small_{file.stem}"
        held.add(problem.cell.arm("right").tool.name)
    # the plate of 300 x 200 mm in the cell is too large for most
    assert "plate_200" in held


@pytest.mark.sampled(every=3)
@pytest.mark.parametrize("numbering", ["rows", "height", "ground"])
def test_groups_lie_together_are_as_large_and_are_numbered_as_asked(tmp_path: Path, numbering: str) -> None:
    groups = {"parts": 3, "numbering": numbering}
    panels = read_panels(divide(shell(tmp_path, groups=groups)))
    plain = read_panels(divide(shell(tmp_path)))
    assert list(panels) == sorted(panels)
    letters = [name[0] for name in panels]
    assert [letters.count(letter) for letter in "ABC"] in ([13, 13, 14], [13, 14, 13], [14, 13, 13])
    near = {name: {other for other in p.row["neighbours"] if other} for name, p in panels.items()}
    for letter in "ABC":
        mine = {name for name in panels if name[0] == letter}
        reached = {min(mine)}
        while more := {other for name in reached for other in near[name]} & mine - reached:
            reached |= more
        assert reached == mine
        ids = sorted(mine)
        height = [panels[name].top[:, 2].mean() for name in ids]
        if numbering == "height":
            assert all(a <= b + 1.5 for a, b in itertools.pairwise(height))
        # the same panels as without groups, under other names
        row = {tuple(np.round(p.top.mean(axis=0))): name[0] for name, p in plain.items()}
        rows = [row[tuple(np.round(panels[name].top.mean(axis=0)))] for name in ids]
        if numbering == "rows":
            assert rows == sorted(rows)
        if numbering == "ground":
            first = rows.count("A")
            assert rows[:first] == ["A"] * first


def test_groups_of_panels_of_another_kind_are_refused(tmp_path: Path) -> None:
    with pytest.raises(TandemError) as caught:
        element_file.read_element(element(tmp_path, groups={"parts": 2}))
    assert [issue.code for issue in caught.value.issues] == ["problem.field"]
    for parts in (0, 27):
        with pytest.raises(TandemError):
            element_file.read_element(shell(tmp_path, groups={"parts": parts}))


@pytest.mark.long
def test_panels_of_the_dome_pass_the_whole_check(tmp_path: Path) -> None:
    run_element(ElementRequest(ROOT / "problems" / "dome_267" / "element.yaml", tmp_path / "out"))
    for name in ("A01", "A20", "D11", "H04"):
        assert not has_errors(pipeline.check(pipeline.load(tmp_path / "out" / "panels" / f"{name}.yaml")))


def test_a_rim_on_the_ground_is_level_and_is_the_first_row(tmp_path: Path) -> None:
    mesh = patch(lambda x, y: 1.1 * np.sqrt(np.maximum(1.0 - (x / 2.6) ** 2, 0.0)) + 0 * y)
    low = 1e3 * float(mesh.vertices[:, 2].min())
    ground = {"count": 30, "least_edge_mm": 30, "least_width_mm": 30, "ground_mm": low, "off_surface_mm": 60}
    panels = read_panels(divide(shell(tmp_path, mesh, ground)))
    standing = {name for name, panel in panels.items() if any(panel.row["on_ground"])}
    assert standing == {name for name in panels if name[0] == "A"}
    for name in standing:
        panel = panels[name]
        for side, level in zip(sides(panel), panel.row["on_ground"], strict=True):
            assert not level or np.abs(side[:, 2] - low).max() < 1e-6
    issue = refusals(shell(tmp_path, mesh, {**ground, "ground_mm": low - 500.0}))
    advised = re.search(r"is at ([-\d.]+) mm", str(issue["panels.hexagons.ground_mm"].hint))
    assert advised is not None
    assert divide(shell(tmp_path, mesh, {**ground, "ground_mm": float(advised[1])}))


@pytest.mark.long
def test_concave_panels_are_named_all_and_none_else(tmp_path: Path) -> None:
    files, said = divide_with_issues(shell(tmp_path, saddle(), {"least_edge_mm": 20, "off_surface_mm": 100}))
    (issue,) = (item for item in said if item.code == "element.concave")
    hollow = set()
    for name, panel in read_panels(files).items():
        for ring in panel.local_outlines:
            outline = shapely.Polygon(ring[:, :2])
            assert outline.is_valid
            if outline.convex_hull.area - outline.area > 1e-2:
                hollow.add(name)
    assert hollow
    assert hollow == set(re.findall(r"\b[A-Z]\d\d\b", issue.message))
    assert all(row["concave"] == "yes" for row in _rows(files) if row["id"] in hollow)


def _rows(files: dict[str, str]) -> list[dict[str, Any]]:
    return list(csv.DictReader(files["panels.csv"].splitlines()))


def advised_fields(issue: Issue) -> dict[str, Any]:
    """Return the fields of hexagons that an issue reports as tried and successful."""
    hint = re.search(r"([^;]*) was tried: all panels can be made then", str(issue.hint))
    assert hint is not None, issue.hint
    return {name: float(value) for name, value in re.findall(r"(\w+): ([\d.]+)", hint[1])}


@pytest.mark.sampled(every=3)
@pytest.mark.parametrize(
    ("limits", "code"),
    [
        ({"least_edge_mm": 300}, "element.shape"),
        ({"least_width_mm": 560}, "element.shape"),
        ({"off_surface_mm": 3}, "element.tolerance"),
    ],
)
def test_panels_beyond_a_limit_are_named_with_a_change_that_helps(
    tmp_path: Path, limits: dict[str, float], code: str
) -> None:
    (name,) = limits
    issue = refusals(shell(tmp_path, hexagons=limits))[f"panels.hexagons.{name}"]
    assert issue.code == code
    assert re.search(r"the worst is [A-Z]\d\d near \(-?\d+, -?\d+, -?\d+\) mm", issue.message)
    change = advised_fields(issue)
    change = {k: int(v) if k == "count" else v for k, v in change.items()}
    thickness = {"thickness_mm": change.pop("thickness_mm")} if "thickness_mm" in change else {}
    assert divide(shell(tmp_path, hexagons={**limits, **change}, **thickness))


@pytest.mark.long
def test_a_thickness_that_sides_cannot_have_is_refused_with_its_panels(tmp_path: Path) -> None:
    """A tight bend: offset by half its radius, panels lean far, or their backs cross."""
    bend = patch(lambda x, y: 0.9 * np.sqrt(np.maximum(1.0 - (x / 2.05) ** 2, 0.0)) + 0 * y)
    result = refusals(shell(tmp_path, bend, thickness_mm=800, blocks=[{"size_mm": [3000, 3000, 800]}]))
    assert {issue.code for issue in result.values()} <= {"element.shape", "element.tolerance"}
    assert all(re.search(r"[A-Z]\d\d near", issue.message) for issue in result.values())


def test_blocks_too_small_are_refused_with_the_block_and_the_count_that_fit(tmp_path: Path) -> None:
    blocks = [{"size_mm": [700, 600, THICK]}]
    issue = refusals(shell(tmp_path, blocks=blocks))["blocks"]
    assert issue.code == "element.block"
    assert re.search(r"[A-Z]\d\d near", issue.message)
    size = re.search(r"a block of (\d+) x (\d+) x (\d+) mm would hold all", str(issue.hint))
    assert size is not None
    assert divide(shell(tmp_path, blocks=[*blocks, {"size_mm": [float(v) for v in size.groups()]}]))
    count = int(advised_fields(issue)["count"])
    assert divide(shell(tmp_path, blocks=blocks, hexagons={"count": count}))


def test_blocks_too_thin_are_refused_with_the_thickness_that_fits(tmp_path: Path) -> None:
    blocks = [{"size_mm": [1200, 1000, 120]}]
    issue = refusals(shell(tmp_path, blocks=blocks))["blocks"]
    assert "the thickest block is 120 mm" in issue.message
    fits = advised_fields(issue)["thickness_mm"]
    assert fits == 120
    assert divide(shell(tmp_path, blocks=blocks, thickness_mm=fits))


def test_blocks_far_too_small_are_refused_with_count_and_thickness_that_fit(tmp_path: Path) -> None:
    blocks = [{"size_mm": [900, 760, 100]}]
    few = {"count": 4, "off_surface_mm": 200}
    change = advised_fields(refusals(shell(tmp_path, hexagons=few, blocks=blocks))["blocks"])
    count = int(change["count"])
    assert count > 3 * few["count"]
    assert change["thickness_mm"] == 100
    fits = shell(tmp_path, hexagons={**few, "count": count}, blocks=blocks, thickness_mm=100)
    read = element_file.read_element(fits)
    assert isinstance(read, element_file.HexagonElement)
    assert len(hexagons.divide_hexagons(read)) == count


@pytest.mark.parametrize(
    ("size", "says"),
    [
        ([130, 110], r"blocks require about count: (\d+), .*least_width_mm: \d+, which was not tried"),
        ([60, 50], "no count .* because 5000 at most are divided: give larger blocks"),
        ([15, 15], "no count .* because foam beside panels takes all of them: give larger blocks"),
    ],
)
def test_blocks_that_take_more_panels_than_are_tried_say_how_many(
    tmp_path: Path, size: list[float], says: str
) -> None:
    few = {"count": 8, "off_surface_mm": 200}
    issue = refusals(shell(tmp_path, hexagons=few, blocks=[{"size_mm": [*size, THICK]}]))["blocks"]
    match = re.search(says, str(issue.hint))
    assert match, issue.hint
    assert "smooth" not in str(issue.hint)
    if match.groups():  # less foam beside them, on 4 x 3 m
        assert int(match[1]) > 12e6 / np.prod(np.array(size) - 20.0)


def slit_tube(gap: float) -> TriangleMesh:
    """A tube with a radius of 1 m and a length of 3 m, ``gap`` [m] wide open along it."""
    angle, z = np.meshgrid(np.linspace(gap, 2.0 * np.pi, 49), np.linspace(0.0, 3.0, 13), indexing="ij")
    k = np.arange(48 * 12).reshape(48, 12) + np.arange(48)[:, None]
    a, b, c, d = (part.ravel() for part in (k, k + 13, k + 14, k + 1))
    at = np.stack([np.cos(angle), np.sin(angle), z], axis=-1).reshape(-1, 3)
    return TriangleMesh(at, np.concatenate([np.c_[a, b, c], np.c_[a, c, d]]))


@pytest.mark.parametrize(("gap", "touches"), [(2e-4, True), (2e-2, False)])
def test_a_tube_that_touches_itself_is_named(tmp_path: Path, gap: float, touches: bool) -> None:
    path = shell(tmp_path, slit_tube(gap))
    read = element_file.read_element(path)
    issues = [note for note in read.notes if note.code == "element.surface"]
    assert bool(issues) == touches
    for note in issues:
        assert note.severity is Severity.WARNING
        assert "touches itself over 3000 mm, near (1000, 0, 15" in note.message
        assert "join both sides" in str(note.hint)


@pytest.mark.parametrize("count", [1, 100_000])
def test_counts_that_cannot_be_are_refused(tmp_path: Path, count: int) -> None:
    issue = refusals(shell(tmp_path, hexagons={"count": count}))["panels.hexagons.count"]
    assert issue.code == "problem.field"


def test_more_panels_than_the_area_has_room_for_are_refused_at_once(tmp_path: Path) -> None:
    """No convex panel of that width is smaller than an equilateral triangle of that height (Pal, 1921)."""
    small = patch(lambda x, y: 0.2 - 0.1 * x * x)
    small.vertices[:] *= 0.1
    area = trimesh.Trimesh(small.vertices, small.faces).area
    issue = refusals(shell(tmp_path, small, {"count": 40, "least_width_mm": 100}))["panels.hexagons.count"]
    assert issue.code == "element.shape" and "40 panels do not fit on" in issue.message
    assert area / 40 < 0.1**2 / math.sqrt(3.0)
    counts, widths = (
        re.findall(rf"{name}: ([\d.]+)", str(issue.hint)) for name in ("count", "least_width_mm")
    )
    assert float(counts[0]) * 0.1**2 <= 1.1 * area and float(widths[0]) ** 2 * 40 <= 1.1e6 * area


def test_a_strip_narrower_than_its_panels_is_refused_or_divided_whole(tmp_path: Path) -> None:
    narrow = patch(lambda x, y: 0.2 - 0.1 * x * x)
    narrow.vertices[:, 1] *= 0.02
    result = refusals(shell(tmp_path, narrow, {"count": 4, "least_width_mm": 100}))
    assert {issue.code for issue in result.values()} <= {"element.surface", "element.shape"}


def test_what_is_of_the_other_kind_is_refused(tmp_path: Path) -> None:
    wire = {"material": "spring_steel", "diameter_mm": 2.0, "lengths_mm": [900], "temperature_c": 300}
    for change in (
        {"wires": [wire]},
        {"foam_faces_mm": 5},
        {"panels": {"hexagons": {"count": 40}, "elastic": {"tolerance_mm": 1.0}}, "wires": [wire]},
        {"panels": {"elastic": {"tolerance_mm": 1.0}}},
        {"panels": {}},
    ):
        with pytest.raises(TandemError) as caught:
            element_file.read_element(shell(tmp_path, **change))
        assert [issue.code for issue in caught.value.issues] == ["problem.field"]
    assert element_file.read_element(shell(tmp_path))


@pytest.mark.long
def test_the_pavilion_stands_on_three_legs_and_names_its_concave_panels() -> None:
    files, (issue,) = divide_with_issues(ROOT / "problems" / "pavilion" / "element.yaml")
    panels = read_panels(files)
    assert len(panels) == 267
    hollow, feet = set(), []
    for name, panel in panels.items():
        for ring in panel.local_outlines:
            outline = shapely.Polygon(ring[:, :2])
            assert outline.is_valid
            assert np.linalg.norm(np.roll(ring, -1, axis=0) - ring, axis=1).min() >= 40.0
            if outline.convex_hull.area - outline.area > 1e-2:
                hollow.add(name)
        rise = panel.local_outlines[1] - panel.local_outlines[0]
        level = np.array(panel.row["on_ground"])
        free = ~(level | np.roll(level, 1))
        assert np.linalg.norm(rise[free], axis=1).max(initial=0.0) <= 1.15 * 200.0 + 1e-6
        for side, down in zip(sides(panel), level, strict=True):
            assert plane_deviation(side) < 1e-6
            if down:
                assert np.abs(side[:, 2]).max() < 1e-6
                feet.append(np.arctan2(*side.mean(axis=0)[[1, 0]]))
    assert hollow == set(re.findall(r"\b[A-Z]\d\d\b", issue.message))
    # three legs, a third of a turn apart
    assert np.unique(np.round(np.array(feet) / (2 * np.pi / 3))).tolist() == [-1.0, 0.0, 1.0]
