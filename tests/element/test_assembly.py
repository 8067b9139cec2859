"""The assembly order of panels and their insertion directions.

Bodies read from ``element.obj`` are moved along these directions among those that already stand, by
manifold3d.
"""

from __future__ import annotations

import csv
import dataclasses
import datetime as dt
import json
import os
import re
from pathlib import Path
from typing import Any

import manifold3d
import numpy as np
import pytest
import rhino3dm
import trimesh

from planner.cli.element import ElementRequest, run_element
from planner.element import assembly, element_page, progress, rhino_panels, run_report
from planner.element.assembly import ElementAssembly, PanelBody
from planner.geometry.assembly import CONTACT_TOLERANCE_M, NONE, Slab, assemble
from planner.issues import Issue
from tests.element.shells import saddle, shell
from tests.element.test_walls import PUZZLE, wall
from tests.element.walls import element
from tests.geometry.test_assembly import UP, Ring, honeycomb
from tests.report.test_browser import BROWSER, console_errors, take_screenshot

KINDS = {
    "hexagons": lambda folder: shell(folder, hexagons={"count": 41}),
    "saddle": lambda folder: shell(folder, saddle(), {"least_edge_mm": 20, "off_surface_mm": 100}),
    "elastic": element,
    "boxes": wall,
    "puzzle": lambda folder: wall(folder, PUZZLE),
}
EXACT = ("hexagons", "saddle")
"""Kinds whose sides are planes."""


@pytest.fixture(scope="module", params=list(KINDS))
def divided_element(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[str, Path]:
    folder = tmp_path_factory.mktemp(request.param)
    run_element(ElementRequest(KINDS[request.param](folder), folder / "out"))
    return request.param, folder / "out"


def read_data(out: Path) -> dict[str, Any]:
    loaded: dict[str, Any] = json.loads((out / "element.json").read_text())
    return loaded


def solids(out: Path) -> dict[str, trimesh.Trimesh]:
    """Bodies [mm] by their ids, by a reader of another's."""
    by_object = {"split_object": True, "split_objects": True}  # as trimesh 4 and 5 call it
    return dict(trimesh.load_scene(out / "element.obj", group_material=False, **by_object).geometry)


def manifold(mesh: trimesh.Trimesh) -> manifold3d.Manifold:
    return manifold3d.Manifold(
        manifold3d.Mesh64(
            np.ascontiguousarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.uint64)
        )
    )


@pytest.mark.sampled(every=5)
def test_all_panels_are_closed_bodies_of_one_file(divided_element: tuple[str, Path]) -> None:
    kind, out = divided_element
    panels = {panel["id"]: panel for panel in read_data(out)["panels"]}
    result = solids(out)
    assert set(result) == set(panels)
    for name, mesh in result.items():
        assert mesh.is_watertight and mesh.is_winding_consistent
        volume = float(panels[name]["volume_l"])
        assert mesh.volume * 1e-6 == pytest.approx(volume, rel=1e-4 if kind in EXACT else 0.03)


def test_rhino_has_the_same_bodies_with_their_ids_on_layers(divided_element: tuple[str, Path]) -> None:
    """Read by rhino3dm, against the OBJ file and the tables."""
    kind, out = divided_element
    model = rhino3dm.File3dm.Read(str(out / "element.3dm"))
    assert model.Settings.ModelUnitSystem == rhino3dm.UnitSystem.Millimeters
    lines = (out / "element.obj").read_text().split("\no ")[1:]
    bodies = {own.split("\n")[0]: re.findall(r"^v (\S+) (\S+) (\S+)$", own, re.M) for own in lines}
    rows = {row["id"]: row for row in csv.DictReader((out / "panels.csv").open())}
    nested = {
        name: row["block"]
        for row in (csv.DictReader((out / "blocks.csv").open()) if (out / "blocks.csv").exists() else ())
        for name in row["panels"].split()
    }
    assert [item.Attributes.Name for item in model.Objects] == list(bodies)
    layers = {layer.Index: layer.FullPath for layer in model.Layers}
    for item in model.Objects:
        name, mesh = item.Attributes.Name, item.Geometry
        assert mesh.IsClosed and mesh.IsManifold(True)[0]
        result = np.array([[p.X, p.Y, p.Z] for p in mesh.Vertices.ToPoint3dArray()])
        np.testing.assert_allclose(result, np.array(bodies[name], dtype=float), rtol=0, atol=1e-6)
        text = dict(item.Attributes.GetUserStrings())
        assert text["id"] == name
        assert text["raw_block_mm"] == rows[name]["raw_block_mm"]
        assert text.get("block") == nested.get(name)
        if kind != "elastic":  # whose table has none
            assert set(text["neighbours"].split()) - {"-"} == set(rows[name]["neighbours"].split()) - {"-"}
        row = re.sub(r"\d+", "", rows[name].get("place", name))
        assert text["row"] == row
        assert layers[item.Attributes.LayerIndex] == f"panels::row {row}"


def test_the_same_element_gives_the_same_3dm_file_at_any_time(divided_element: tuple[str, Path]) -> None:
    _, out = divided_element
    first = (out / "element.3dm").read_bytes()
    model = rhino3dm.File3dm.FromByteArray(first)
    assert model.Created == model.LastEdited == dt.datetime(2000, 1, 1)
    assert str(out.parent).encode("utf-16-le") not in first
    data, bodies = read_data(out), (out / "element.obj").read_text()
    assert rhino_panels.panels_3dm(data, bodies) == first
    grouped = rhino3dm.File3dm.FromByteArray(rhino_panels.panels_3dm({**data, "grouped": True}, bodies))
    assert {layer.FullPath.split(" ")[0] for layer in grouped.Layers} == {"panels", "panels::group"}
    assert all(item.Attributes.GetUserString("group") for item in grouped.Objects)


def test_each_panel_has_a_place_in_the_order_and_one_way_in(divided_element: tuple[str, Path]) -> None:
    _, out = divided_element
    panels = read_data(out)["panels"]
    assert sorted(panel["order"] for panel in panels) == list(range(1, len(panels) + 1))
    rows = {row["id"]: row for row in csv.DictReader((out / "panels.csv").open())}
    for panel in panels:
        way = np.array(panel["way_in"])
        assert np.linalg.norm(way) == pytest.approx(1.0, abs=1e-8)
        row = rows[panel["id"]]
        assert int(row["order"]) == panel["order"] and float(row["jam_mm"]) == panel["jam_mm"]
        np.testing.assert_allclose([float(v) for v in row["way_in"].split()], way, atol=1e-4)


def removal_overlap(
    body: manifold3d.Manifold, others: manifold3d.Manifold, direction: np.ndarray, size: float
) -> float:
    """Return the largest common volume [mm^3] along the removal direction."""
    steps = size * np.array([0.0, 0.003, 0.02, 0.1, 0.3, 0.7, 1.2])
    return max((body.translate(list(-direction * s)) ^ others).volume() for s in steps)


def test_the_ways_in_are_free_of_what_stands(divided_element: tuple[str, Path]) -> None:
    kind, out = divided_element
    panels = sorted(read_data(out)["panels"], key=lambda panel: int(panel["order"]))
    meshes = solids(out)
    bodies = {name: manifold(mesh) for name, mesh in meshes.items()}
    standing = manifold3d.Manifold()
    blocked = 0
    for panel in panels:
        mesh, body = meshes[panel["id"]], bodies[panel["id"]]
        way = np.array(panel["way_in"])
        size = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
        side = mesh.area
        # volume of an overlap by a millionth of a metre, or by the reported interference
        allowed = float(panel["jam_mm"]) + (1e-3 if kind in EXACT else assembly.FREE_INTERFERENCE_M * 1e3)
        assert removal_overlap(body, standing, way, size) <= allowed * side, panel["id"]
        blocked += removal_overlap(body, standing, -way, size) > 0.005 * mesh.volume
        standing += body
    if kind != "puzzle":  # whose lobes slide both ways
        assert blocked > 0.3 * len(panels)  # the other way many are in one another's way


def test_panels_rest_on_what_stands(divided_element: tuple[str, Path]) -> None:
    kind, out = divided_element
    data = read_data(out)
    panels = {panel["id"]: panel for panel in data["panels"]}
    order = {name: panel["order"] for name, panel in panels.items()}
    before = {
        name: {item for item in panel["neighbours"] if item is not None and order[item] < order[name]}
        for name, panel in panels.items()
    }
    if kind in EXACT:
        assert all(name[0] == "A" or {item for item in before[name] if item[0] < name[0]} for name in panels)
    elif kind == "elastic":
        for name, panel in panels.items():
            ring = np.array(panel["outline_mm"])
            level = np.isclose(ring[:, 1], np.roll(ring[:, 1], -1)) & np.isclose(ring[:, 1], ring[:, 1].min())
            below = {item for item, flat in zip(panel["neighbours"], level, strict=True) if flat and item}
            assert below <= before[name]
    elif kind == "puzzle":
        assert sorted(panels, key=order.__getitem__) == sorted(panels, key=lambda n: panels[n]["place"])
    else:
        vertices = {name: mesh.vertices for name, mesh in solids(out).items()}
        ground = min(v[:, 2].min() for v in vertices.values())
        standing = [name for name in panels if not before[name]]
        assert all(vertices[name][:, 2].min() < ground + 150.0 for name in standing)


def test_the_page_has_all_panels_in_order_with_their_ways(divided_element: tuple[str, Path]) -> None:
    _, out = divided_element
    data = read_data(out)
    page = (out / "element.html").read_text()
    (packed,) = re.findall(r'id="put-up-data">(.*?)</script>', page, re.DOTALL)
    shown = json.loads(packed)
    panels = sorted(data["panels"], key=lambda panel: int(panel["order"]))
    assert [item["id"] for item in shown["panels"]] == [panel["id"] for panel in panels]
    assert f'max="{len(panels)}"' in page
    axes = np.array(shown["axes"])
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(axes @ data["up"], [0.0, 0.0, 1.0], atol=1e-12)
    meshes = solids(out)
    for item, panel in zip(shown["panels"], panels, strict=True):
        np.testing.assert_allclose(item["way"], panel["way_in"], atol=1e-4)
        points = np.array((item["front"] + " " + item["back"]).split(), dtype=float).reshape(-1, 3)
        corners = meshes[panel["id"]].bounds
        np.testing.assert_allclose([points.min(axis=0), points.max(axis=0)], corners, atol=2.5)
    assert "import " not in page[page.index("put-up-data") :].split("<script>")[1].split("</script>")[0]
    assert len(page) < 4e5


def test_what_is_glued_next_follows_the_order(divided_element: tuple[str, Path]) -> None:
    _, out = divided_element
    panels = sorted(read_data(out)["panels"], key=lambda panel: int(panel["order"]))
    result = progress.read_progress(out)
    for k in (0, 1, len(panels) - 1):
        glued = progress.ElementProgress(result.data, {panel["id"]: ("glued", "") for panel in panels[:k]})
        said = [line for line in progress.progress_lines(glued, out) if line.startswith("next to be glued")]
        words = f"next to be glued: {panels[k]['id']}, {k + 1} of {len(panels)} in order; it is not cut yet"
        assert said == [words]


@pytest.mark.sampled(every=5)
@pytest.mark.skipif(BROWSER is None and "CI" not in os.environ, reason="no Chromium or Chrome")
def test_the_page_draws_what_stands_and_the_panel_that_comes(
    divided_element: tuple[str, Path], tmp_path: Path
) -> None:
    """In a browser without a network: standing panels are blue, the one that comes is orange."""
    kind, out = divided_element
    if kind not in ("hexagons", "puzzle"):
        pytest.skip("two kinds are looked at")
    page = (out / "element.html").read_text()
    (panel,) = (panel for panel in read_data(out)["panels"] if panel["order"] == 9)
    asked = page.replace("<head>", f"<head><script>location.hash='panel={panel['id']}'</script>")
    assert asked != page
    count = []
    for number, text in enumerate((page, asked)):
        folder = tmp_path / str(number)
        folder.mkdir()
        shot, log = take_screenshot(
            text, folder, "--window-size=900,2600", "--blink-settings=preferredColorScheme=1"
        )
        assert not console_errors(log)
        red, _, blue = shot.astype(int).transpose(2, 0, 1)
        count.append([int((blue - red > 90).sum()), int((red - blue > 90).sum())])
    (all_blue, none), (blue, orange) = count
    assert all_blue > blue > 500
    assert orange > none + 200


def locked_assembly(parted: bool) -> tuple[ElementAssembly, tuple[Issue, ...]]:
    """A panel whose sides lean in and out by turns, in one that is all round it: whole, or parted in two."""
    item, *six = honeycomb(np.where(np.arange(6) % 2, 0.02, -0.02), 6)
    front, back = (np.concatenate([getattr(part, face) for part in six]) for face in ("front", "back"))
    faces = np.concatenate([6 * k + part.faces for k, part in enumerate(six)])
    around = Ring(front, back, faces, np.arange(36), np.full(36, NONE))
    slabs: list[Slab] = [
        around,
        Slab(item.front, item.back, item.faces, item.rim, np.zeros(6, dtype=np.int64)),
    ]
    if parted:
        rings = [np.array([0, 1, 2, 3]), np.array([3, 4, 5, 0])]
        beyond = [np.array([0, 0, 0, 2]), np.array([0, 0, 0, 1])]
        fan = np.array([[0, 1, 2], [0, 2, 3]])
        slabs[1:] = [
            Slab(item.front[ring], item.back[ring], fan, np.arange(4), out)
            for ring, out in zip(rings, beyond, strict=True)
        ]
    rests = [np.array([], dtype=np.int64)] + [np.array([0])] * (len(slabs) - 1)
    steps = assemble(slabs, np.arange(len(slabs)), rests, UP, CONTACT_TOLERANCE_M)
    result = ElementAssembly(tuple(PanelBody(f"A0{k}", s, s) for k, s in enumerate(slabs)), steps, UP)
    return result, result.issues(CONTACT_TOLERANCE_M)


def test_panels_without_a_way_in_are_named_and_what_is_advised_opens_one() -> None:
    result, (issue,) = locked_assembly(parted=False)
    assert issue.code == "element.assembly"
    (last,) = [step for step in result.steps if step.depth > CONTACT_TOLERANCE_M]
    assert f"A0{last.body} ({last.depth * 1e3:.1f} mm)" in issue.message
    assert issue.value == pytest.approx(last.depth * 1e3)
    assert "split these panels" in str(issue.hint)
    assert result.columns()[last.body]["jam_mm"] == pytest.approx(last.depth * 1e3, abs=1e-3)
    # taken off by so much all round, it comes in
    whole = result.bodies[last.body].whole
    other = result.bodies[1 - last.body].whole
    smaller = 1.0 - last.depth / 0.8
    flat = np.array([smaller, smaller, 1.0])
    thin = dataclasses.replace(whole, front=whole.front * flat, back=whole.back * flat)
    steps = assemble([other, thin], np.arange(2), [np.array([], dtype=np.int64), np.array([0])], UP, 2e-3)
    assert max(step.depth for step in steps) == 0.0


def test_an_element_that_was_written_without_an_order_says_so(divided_element: tuple[str, Path]) -> None:
    _, out = divided_element
    data = read_data(out)
    for panel in data["panels"]:
        del panel["solid"], panel["order"]
    page = element_page.element_page(run_report.unplanned_run(data))
    assert "written without an assembly order" in page
    result = progress.ElementProgress(data, {})
    assert f"next to be glued: {data['panels'][0]['id']}," in "\n".join(progress.progress_lines(result, out))
