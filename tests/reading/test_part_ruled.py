"""Parts cut by rulings, as problem files describe them: edges of faces, guides, wings, and invalid parts."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import ezdxf
import numpy as np
import pytest
import trimesh
import yaml
from pydantic import ValidationError

from planner.geometry.rulings import outward_normals, outward_sides, ruling_points, tessellate
from planner.reading.part import PartFile
from tests.reading.part_specs import SQUARE, WING, expect_refusal, guides, make, outline
from tests.rhino_files import LOWER, UPPER, Model, ruled_surface
from tests.rhino_files import curve as rhino_curve


def panel(**more: Any) -> dict[str, Any]:
    loft = {
        "rail": {"radius_mm": 300, "start_deg": 0, "end_deg": 20},
        "profiles": [{"at": 0, "bezier_mm": [[0, 0], [30, 200], [60, 400]]}],
        "chord_mm": 0.02,
    }
    return {"front": {"loft": loft}, **more}


def test_a_panel_has_four_smooth_edges_with_corners_between() -> None:
    part = make(panel(back={"offset_mm": 20}))
    (edges,) = part.ruled
    assert edges.name == "edges"
    assert edges.closed
    assert edges.corner.sum() == 4
    np.testing.assert_allclose(np.linalg.norm(edges.end - edges.start, axis=1), 0.020, atol=2e-5)
    front = trimesh.Trimesh(part.front.vertices, part.front.faces, process=False)
    assert np.abs(trimesh.proximity.closest_point(front, edges.start)[1]).max() < 1e-5
    middle = ruling_points(edges, np.array([0.5]))[:, 0]
    normal = outward_normals(edges)[0]
    assert (np.sum((middle - middle.mean(axis=0)) * normal, axis=1) > 0).all()
    before, after = outward_sides(edges)
    turn = np.rad2deg(np.arccos(np.clip(np.sum(before[:, 0] * after[:, 0], axis=1), -1, 1)))
    np.testing.assert_allclose(turn[edges.corner], 90.0, atol=3.0)
    assert make(panel()).ruled == ()


def plate_mesh(path: Path, corners: list[list[float]], cells: int, up: bool) -> None:
    a, b, c, d = np.array(corners, dtype=float)
    s, t = np.meshgrid(np.linspace(0, 1, cells + 1), np.linspace(0, 1, cells + 1), indexing="ij")
    s, t = s[..., None], t[..., None]
    grid = ((1 - s) * (1 - t) * a + s * (1 - t) * b + s * t * c + (1 - s) * t * d).reshape(-1, 3)
    i = np.arange((cells + 1) ** 2).reshape(cells + 1, cells + 1)
    p, q, r, w = i[:-1, :-1].ravel(), i[1:, :-1].ravel(), i[1:, 1:].ravel(), i[:-1, 1:].ravel()
    faces = np.concatenate([np.stack([p, q, r], 1), np.stack([p, r, w], 1)])
    trimesh.Trimesh(grid, faces if up else faces[:, ::-1], process=False).export(path)


def test_a_back_of_its_own_is_joined_corner_to_corner(tmp_path: Path) -> None:
    plate_mesh(tmp_path / "front.ply", [[0, 0, 40], [200, 0, 40], [200, 90, 50], [0, 90, 40]], 8, True)
    plate_mesh(tmp_path / "back.ply", [[5, 5, 0], [190, 5, 0], [190, 80, 0], [5, 80, 0]], 5, False)
    spec = {
        "front": {"mesh": {"file": "front.ply", "unit": "mm"}},
        "back": {"mesh": {"file": "back.ply", "unit": "mm"}},
        "in_stock": {"xyz_mm": [-100, -45, 0]},
    }
    (edges,) = make(spec, tmp_path).ruled
    got = 1e3 * np.stack([edges.start, edges.end], axis=1)[edges.corner] + [100, 45, 0]
    expected = {
        (0, 0, 40, 5, 5, 0),
        (200, 0, 40, 190, 5, 0),
        (200, 90, 50, 190, 80, 0),
        (0, 90, 40, 5, 80, 0),
    }
    assert {tuple(np.round(row.ravel()).astype(int)) for row in got} == expected
    assert (np.sum(outward_normals(edges)[1] * (edges.end - edges.end.mean(axis=0)), axis=1) > 0).all()


def test_faces_that_cannot_be_joined_say_so_in_a_note(tmp_path: Path) -> None:
    plate_mesh(tmp_path / "front.ply", [[0, 0, 40], [200, 0, 40], [200, 90, 40], [0, 90, 40]], 4, True)
    corner = np.array([[0, 0, 0], [200, 0, 0], [100, 90, 0]])
    trimesh.Trimesh(corner, [[0, 2, 1]], process=False).export(tmp_path / "back.ply")
    front, back = ({"mesh": {"file": f"{n}.ply", "unit": "mm"}} for n in ("front", "back"))
    part = make({"front": front, "back": back}, tmp_path)
    assert part.ruled == ()
    assert [note.code for note in part.notes] == ["part.edges"]
    assert "4 corners and the back's 3" in part.notes[0].message


def test_two_closed_guides_make_a_prism_that_faces_outwards_and_a_hole_inwards() -> None:
    (sides,) = make(guides()).ruled
    assert sides.corner.sum() == 4
    np.testing.assert_allclose(np.ptp(sides.start, axis=0).max(), 0.1, atol=1e-9)
    out = np.sum(outward_normals(sides)[0] * (sides.start - sides.start.mean(axis=0)), axis=1)
    assert (out > 0).all()
    (hole,) = make(guides(hole=True)).ruled
    assert hole.hole
    assert (np.sum(outward_normals(hole)[0] * (hole.start - hole.start.mean(axis=0)), axis=1) < 0).all()


def test_an_open_surface_is_turned_by_flip_and_a_crossing_guide_is_run_the_other_way() -> None:
    start = {"bezier_mm": [[0, 0, 0], [100, 0, 40], [200, 0, 0]]}
    end = {"bspline_mm": [[200, 80, 10], [120, 80, 30], [60, 80, 30], [0, 80, 0]]}
    own = {"name": "roof", "start": start, "end": end}
    place = {"xyz_mm": [-100, -40, 0]}
    part = make({"ruled": [own], "in_stock": place})
    assert [note.code for note in part.notes] == ["part.guide_turned"]
    (roof,) = part.ruled
    np.testing.assert_allclose(roof.end[[0, -1], 0], [-0.1, 0.1], atol=1e-9)
    assert (outward_normals(roof)[0][:, 2] > 0).all()
    (other,) = make({"ruled": [own | {"flip": True}], "in_stock": place}).ruled
    assert (outward_normals(other)[0][:, 2] < 0).all()


def test_unequal_corners_name_both_counts_and_can_be_given() -> None:
    bent = {"polyline_mm": [[0, 0, 60], [100, 0, 60], [100, 100, 60], [50, 130, 60], [0, 100, 60]]}
    (issue,) = expect_refusal(guides(end=bent))
    assert issue.code == "part.corners"
    assert "4 corners" in issue.message
    assert "end guide 5" in issue.message
    assert "corners_mm" in issue.message
    four = {**bent, "corners_mm": [[0, 0, 60], [100, 0, 60], [100, 100, 60], [0, 100, 60]]}
    assert make(guides(end=four)).ruled[0].corner.sum() == 4


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"start": {"polyline_mm": [[0, 0, 0], [0, 0, 0], [5, 0, 0]]}}, "part.guide"),
        ({"start": {"polyline_mm": [[0, 0, 0], [100, 100, 0], [100, 0, 0], [0, 100, 0]]}}, "part.guide"),
        ({"end": {"polyline_mm": [[*p, 0] for p in SQUARE]}}, "part.ruled_shape"),
        ({"end": {"polyline_mm": [[*p, 60_000] for p in SQUARE]}}, "part.ruled_shape"),
    ],
)
def test_guides_without_size_that_cross_themselves_or_meet_are_refused(
    change: dict[str, Any], code: str
) -> None:
    assert [issue.code for issue in expect_refusal(guides(**change))] == [code]


def test_a_surface_that_folds_over_itself_is_refused() -> None:
    arc = [[100 - 100 * np.cos(t), 60 * np.sin(t), 0] for t in np.linspace(0, np.pi, 30)]
    line = [[0, 30, 50], [200, 30, 50]]
    fold = {"name": "fold", "start": {"polyline_mm": arc}, "end": {"polyline_mm": line}, "match": "parameter"}
    bad = {
        **fold,
        "end": {"polyline_mm": [[0, 30, 1], [120, 30, 1], [80, 30, 1], [200, 30, 1]], "corners_mm": []},
    }
    assert make({"ruled": [fold]}).ruled
    assert expect_refusal({"ruled": [bad]})[0].code == "part.ruled_shape"


def test_surfaces_of_no_area_and_many_corners_are_taken_as_they_are() -> None:
    line = [[x, 0, 0] for x in (0, 50, 100)]
    flat = {
        "name": "flat",
        "start": {"polyline_mm": line},
        "end": {"polyline_mm": [[x + 150, 0, 0] for x in (0, 9, 99)]},
    }
    assert expect_refusal({"ruled": [flat]})[0].code == "part.ruled_shape"
    angle = np.arange(800) * 2 * np.pi / 800
    wheel = (90 + 10 * (np.arange(800) % 2)) * np.array([np.cos(angle), np.sin(angle)])
    start, end = ([[x, y, z] for x, y in np.roll(wheel.T, shift, axis=0)] for z, shift in ((0, 0), (80, 250)))
    gear = {"name": "gear", "start": {"polyline_mm": start}, "end": {"polyline_mm": end}, "closed": True}
    (teeth,) = make({"ruled": [gear | {"match": "least_twist"}]}).ruled
    assert teeth.corner.sum() == 800
    np.testing.assert_allclose(np.linalg.norm(teeth.end - teeth.start, axis=1), 0.08, atol=1e-9)


@pytest.mark.parametrize("size", [[0.25, 0.6, 0.06], [0.6, 0.25, 0.06], [0.06, 0.25, 0.6]])
def test_a_wing_lies_along_the_longest_axis_of_its_block(size: list[float]) -> None:
    (skin,) = make({"wing": WING}, size=np.array(size)).ruled
    way = (skin.end - skin.start).mean(axis=0)
    assert np.abs(way[int(np.argmax(size))]) > 0.98 * np.linalg.norm(way)
    both = np.concatenate([skin.start, skin.end])
    lower, upper = np.array([-0.5, -0.5, 0.0]) * size, np.array([0.5, 0.5, 1.0]) * size
    assert (both > lower - 1e-6).all()
    assert (both < upper + 1e-6).all()
    centre = ruling_points(skin, np.array([0.5]))[:, 0].mean(axis=0)
    facets = tessellate(skin)
    body = trimesh.Trimesh(facets.vertices, facets.faces, process=False)
    across = body.triangles_center - centre
    across -= np.outer(across @ way, way) / (way @ way)
    assert (np.sum(body.face_normals * across, axis=1) > 0).mean() > 0.97


def test_a_wing_may_be_twisted_as_little_as_can_be() -> None:
    (even,), (least,) = (make({"wing": WING | {"match": m}}).ruled for m in ("arc_length", "least_twist"))
    angle = []
    for skin in (even, least):
        start, end = outward_normals(skin)
        angle.append(np.mean(np.arccos(np.clip(np.sum(start * end, axis=1), -1.0, 1.0))))
    assert angle[1] < angle[0]


def test_wings_from_files_and_their_faults_by_field(tmp_path: Path) -> None:
    rows = [f"{x:.6f} {y:.6f}" for x, y in np.array([[1, 0.001], [0, 0], [1, -0.001]])]
    (tmp_path / "bad.dat").write_text("bad\n" + "\n".join(rows))
    wing = {**WING, "root": {"file": "bad.dat", "chord_mm": 200}, "tip": {"naca": "0099", "chord_mm": 100}}
    assert {(i.code, i.field) for i in expect_refusal({"wing": wing}, tmp_path)} == {
        ("part.airfoil_points", "part.wing.root.file"),
        ("part.naca", "part.wing.tip.naca"),
    }
    assert [i.code for i in expect_refusal({"wing": WING | {"trailing_edge_mm": 20}})] == ["part.wing"] * 2
    assert expect_refusal({"wing": WING}, size=np.array([0.2, 0.4, 0.06]))[0].code == "part.stock_too_small"


@pytest.mark.parametrize(
    "spec",
    [
        {},
        {"wing": WING, **outline()},
        {"wing": WING, "back": {"offset_mm": 5}},
        {"ruled": []},
        guides(flip=True),
        guides(name="side_2"),
        guides(closed=False, hole=True),
        guides(start={"polyline_mm": [[0, 0, 0], [1, 0, 0]], "bezier_mm": [[0, 0, 0], [1, 0, 0]]}),
        {"wing": WING | {"root": {"chord_mm": 100}}},
        {"wing": WING | {"root": {"naca": 2412, "chord_mm": 100}}},
        {"wing": WING | {"span_mm": 0}},
        {"plate": {}},
        {"plate": {"outlines": [{"polyline_mm": SQUARE[:2]}]}},
        {"strips": {"across": "u"}},
        {"ruled": guides()["ruled"] * 2},
    ],
)
def test_what_is_no_part_is_refused_when_read(spec: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        PartFile.model_validate_json(json.dumps(spec), strict=True)


def test_the_examples_of_the_page_on_parts_are_parts(tmp_path: Path) -> None:
    page = (Path(__file__).parents[2] / "docs" / "parts.md").read_text("utf-8")
    examples = re.findall(r"^```yaml\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    assert len(examples) == 6
    model = Model()
    for name, parent in (("wall", ""), ("front", "wall"), ("rails", "")):
        model.layer(name, parent)
    model.add(ruled_surface(), "front")
    model.add(rhino_curve(LOWER), "rails", "low")
    model.add(rhino_curve(UPPER), "rails", "high")
    model.write(tmp_path / "wall.3dm")
    document = ezdxf.new("R2010")
    document.modelspace().add_circle((150, 60), 20, dxfattribs={"layer": "cut"})
    document.saveas(tmp_path / "pieces.dxf")
    for text in examples:
        if "step:" in text:  # what such files are read to: test_step.py, where their reader is installed
            PartFile.model_validate(yaml.safe_load(text)["part"])
            continue
        part = make(yaml.safe_load(text)["part"], tmp_path, np.array([0.32, 0.6, 0.25]))
        assert part.ruled


def test_a_shell_piece_stands_on_its_base_though_its_sides_lean(tmp_path: Path) -> None:
    angle = np.deg2rad(np.arange(6) * 60.0)
    base = [[480 * np.cos(a), 280 * np.sin(a), 0] for a in angle]
    top = [
        [440 * np.cos(a + 0.05) + 30, 250 * np.sin(a + 0.05), 180 + 8 * (-1) ** k]
        for k, a in enumerate(angle)
    ]
    own = {"name": "sides", "start": {"polyline_mm": base}, "end": {"polyline_mm": top}, "closed": True}
    (sides,) = make({"ruled": [own]}, size=np.array([1.0, 0.6, 0.2])).ruled
    assert sides.corner.sum() == 6
    assert np.ptp(sides.start[:, 2]) < 1e-12
    np.testing.assert_allclose(np.ptp(sides.start, axis=0)[:2], [0.96, 0.56 * np.sin(np.pi / 3)], atol=1e-9)
    assert (np.sum((outward_normals(sides)[0] * sides.start)[:, :2], axis=1) > 0).all()
