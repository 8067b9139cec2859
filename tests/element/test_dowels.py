"""Dowels between panels, checked by manifold3d.

Their holes are in the bodies of ``element.obj`` of both panels, stay in the foam, and do not block the
insertion of panels.
"""

from __future__ import annotations

import csv
import itertools
from pathlib import Path
from typing import Any

import manifold3d
import numpy as np
import pytest

from planner.cli.element import ElementRequest, run_element
from planner.element.element_file import read_element
from planner.geometry.assembly import CONTACT_TOLERANCE_M
from tests.element.shells import shell
from tests.element.test_assembly import manifold, read_data, removal_overlap, solids
from tests.element.test_walls import wall
from tests.element.walls import expect_refusal

DOWELS = {"diameter_mm": 10, "depth_mm": 45, "cover_mm": 15}
KINDS = {
    "hexagons": lambda folder, file: shell(folder, hexagons={"count": 41}, dowels=file),
    "boxes": lambda folder, file: wall(folder, dowels=file),
}


@pytest.fixture(scope="module", params=list(KINDS))
def out(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp(request.param)
    run_element(ElementRequest(KINDS[request.param](folder, DOWELS), folder / "out"))
    return folder / "out"


def holes(out: Path) -> dict[int, list[dict[str, Any]]]:
    """By dowel both holes, each with its place [mm] and direction in the frame of ``element.json``."""
    poses = {panel["id"]: np.array(panel["block_pose"]) for panel in read_data(out)["panels"]}
    result: dict[int, list[dict[str, Any]]] = {}
    for row in csv.DictReader((out / "dowels.csv").open()):
        pose = poses[row["panel"]]
        place = pose[:3, :3] @ [float(row[f"{axis}_mm"]) for axis in "xyz"] + pose[:3, 3]
        way = pose[:3, :3] @ [float(row[f"d{axis}"]) for axis in "xyz"]
        result.setdefault(int(row["dowel"]), []).append({**row, "place": place, "way": way})
    return result


def test_both_holes_of_a_dowel_are_one_line_along_the_way_in(out: Path) -> None:
    panels = {panel["id"]: panel for panel in read_data(out)["panels"]}
    result = holes(out)
    assert len(result) > 0.7 * len(panels)
    for item, other in result.values():
        assert item["panel"] == other["neighbour"] and other["panel"] == item["neighbour"]
        assert panels[item["panel"]]["order"] < panels[other["panel"]]["order"]
        np.testing.assert_allclose(item["place"], other["place"], atol=0.02)
        np.testing.assert_allclose(item["way"], panels[other["panel"]]["way_in"], atol=2e-5)
        np.testing.assert_allclose(item["way"], -other["way"], atol=4e-5)


def test_holes_stay_in_the_foam_with_their_cover(out: Path) -> None:
    bodies = {name: manifold(mesh) for name, mesh in solids(out).items()}
    keep = 0.5 * DOWELS["diameter_mm"] + DOWELS["cover_mm"]
    for hole in itertools.chain.from_iterable(holes(out).values()):
        end = hole["place"] + DOWELS["depth_mm"] * hole["way"]
        ball = manifold3d.Manifold.sphere(keep - 1.0, 32).translate(end.tolist())
        assert (ball - bodies[hole["panel"]]).volume() < 1e-3 * ball.volume(), hole
        # it begins on the side: a little before it there is no foam of this panel, a little behind there is
        for off, fraction in ((-2.0, 0.05), (2.0, 0.95)):
            dot = manifold3d.Manifold.sphere(0.5, 16).translate((hole["place"] + off * hole["way"]).tolist())
            inside = (dot ^ bodies[hole["panel"]]).volume() / dot.volume()
            assert inside < fraction if off < 0.0 else inside > fraction, hole


def test_holes_of_a_panel_keep_apart(out: Path) -> None:
    lines_by_panel: dict[str, list[Any]] = {}
    fraction = np.linspace(0.0, DOWELS["depth_mm"], 200)[:, None]
    for hole in itertools.chain.from_iterable(holes(out).values()):
        lines_by_panel.setdefault(hole["panel"], []).append(hole["place"] + fraction * hole["way"])
    for lines in lines_by_panel.values():
        for item, other in itertools.combinations(lines, 2):
            minimum = np.linalg.norm(item[:, None] - other, axis=2).min()
            assert minimum > DOWELS["diameter_mm"] + 0.5 * DOWELS["cover_mm"]


def test_panels_slide_onto_their_dowels(out: Path) -> None:
    panels = sorted(read_data(out)["panels"], key=lambda panel: int(panel["order"]))
    meshes = solids(out)
    standing = manifold3d.Manifold()
    for panel in panels:
        mesh, body = meshes[panel["id"]], manifold(meshes[panel["id"]])
        size = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
        allowed = (
            float(panel["jam_mm"]) + 1e3 * (CONTACT_TOLERANCE_M if "boxes" not in str(out) else 1e-3)
        ) * mesh.area
        assert removal_overlap(body, standing, np.array(panel["way_in"]), size) <= allowed, panel["id"]
        standing += body


def test_panels_without_a_dowel_are_named_with_their_best_joint(out: Path) -> None:
    data = read_data(out)
    first = min(data["panels"], key=lambda panel: int(panel["order"]))["id"]
    held = {item["panels"][1] for item in data["dowels"]["dowels"]}
    loose = {panel["id"] for panel in data["panels"]} - held - {first}
    (issue,) = [item for item in data["issues"] if item["code"] == "element.dowels"]
    named = issue["message"].split("joint of each is: ")[1]
    assert {word for word in loose if f"{word} (" in named} >= {
        item["panels"][1] for item in data["dowels"]["without"]
    } - held
    assert not any(f"{word} (" in named for word in held)


def test_shorter_dowels_find_room_where_long_ones_have_none(tmp_path: Path) -> None:
    count = {}
    for depth in (45, 400):
        folder = tmp_path / str(depth)
        run_element(ElementRequest(KINDS["boxes"](folder, {**DOWELS, "depth_mm": depth}), folder / "out"))
        data = read_data(folder / "out")
        count[depth] = len(data["dowels"]["dowels"])
        reasons = {item["why"] for item in data["dowels"]["without"]}
    assert count[400] == 0 and count[45] > 0
    assert "no space" in reasons


def test_lobes_need_no_dowels(tmp_path: Path) -> None:
    path = wall(tmp_path, panels={"puzzle": {"lobe_mm": 40}}, dowels=DOWELS)
    issue = expect_refusal(lambda: read_element(path))
    assert issue.code == "problem.field" and "lobes hold" in issue.message
