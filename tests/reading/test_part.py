"""The part of a problem file: placement in the block, offsets, and refusals."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from pydantic import ValidationError

from planner.geometry.mesh import TriangleMesh, face_normals, vertex_normals
from planner.issues import TandemError
from planner.problem import Stock
from planner.reading.part import PartFile, build_part

SIZE = np.array([0.17, 0.70, 0.10])
PROFILES = [
    {"at": 0.0, "bezier_mm": [[0, 0], [20, 230], [60, 450], [130, 680]]},
    {"at": 1.0, "bezier_mm": [[0, 0], [40, 230], [40, 450], [110, 680]]},
]


def capital(**more: Any) -> dict[str, Any]:
    loft = {
        "rail": {"radius_mm": 300, "start_deg": 0, "end_deg": 80},
        "profiles": PROFILES,
        "region": {"u": [0, 0.25]},
    }
    return {"front": {"loft": loft | {"chord_mm": 0.05}}, "back": {"offset_mm": 20}, **more}


def make(spec: dict[str, Any], folder: Path = Path(), size: np.ndarray = SIZE) -> Any:
    return build_part(PartFile.model_validate(spec), folder, Stock(size, None, np.eye(3)))


def test_a_panel_is_laid_front_up_along_the_block_and_inside_it() -> None:
    part = make(capital())
    both = np.vstack([part.front.vertices, part.back.vertices])
    assert (both.min(axis=0) >= [-0.085, -0.35, 0.0]).all()
    assert (both.max(axis=0) <= [0.085, 0.35, 0.10]).all()
    assert face_normals(part.front).mean(axis=0)[2] > 0.9
    assert face_normals(part.back).mean(axis=0)[2] < -0.9
    assert np.ptp(both[:, 1]) > 0.66
    np.testing.assert_allclose(both.min(axis=0) + both.max(axis=0), [0, 0, 0.1], atol=2e-4)


def test_the_back_is_the_thickness_away_everywhere() -> None:
    part = make(capital())
    peer = trimesh.Trimesh(part.back.vertices, part.back.faces, process=False)
    inside = np.linspace(0, len(part.front.vertices) - 1, 60).astype(int)
    _, distance, _ = trimesh.proximity.closest_point(peer, part.front.vertices[inside])
    np.testing.assert_allclose(distance, 0.020, atol=2e-4)


def test_a_turned_plate_from_a_file_is_found_and_laid_flat(tmp_path: Path) -> None:
    x, y = np.meshgrid(np.linspace(0, 0.3, 4), np.linspace(0, 0.1, 3), indexing="ij")
    i = np.arange(12).reshape(4, 3)
    a, b, c, d = i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    turn = trimesh.transformations.euler_matrix(0.4, -1.1, 2.0)
    mesh = trimesh.Trimesh(np.stack([x, y, 0 * x], -1).reshape(-1, 3) * 1000, faces, process=False)
    mesh.apply_transform(turn)
    mesh.export(tmp_path / "plate.stl")
    spec = {"front": {"mesh": {"file": "plate.stl", "unit": "mm"}}, "back": {"offset_mm": 10}}
    part = make(spec, tmp_path, np.array([0.11, 0.31, 0.05]))
    np.testing.assert_allclose(part.front.vertices[:, 2], 0.030, atol=1e-6)
    np.testing.assert_allclose(np.ptp(part.front.vertices, axis=0)[:2], [0.1, 0.3], atol=1e-6)
    again = make(spec, tmp_path, np.array([0.31, 0.11, 0.05]))
    np.testing.assert_allclose(np.ptp(again.front.vertices, axis=0)[:2], [0.3, 0.1], atol=1e-6)


def issue_code(spec: dict[str, Any], folder: Path = Path(), size: np.ndarray = SIZE) -> str:
    with pytest.raises(TandemError) as caught:
        make(spec, folder, size)
    return caught.value.issues[0].code


def test_a_block_smaller_than_the_part_is_refused_and_says_by_how_much() -> None:
    with pytest.raises(TandemError) as caught:
        make(capital(), size=np.array([0.17, 0.60, 0.10]))
    issue = caught.value.issues[0]
    assert issue.code == "part.stock_too_small"
    assert issue.value is not None
    assert 680 < issue.value < 700
    assert issue_code(capital(in_stock={"xyz_mm": [0, 0, 0]})) == "part.stock_too_small"


def wave(folder: Path, height: float = 20.0) -> dict[str, Any]:
    """One S-line of 200 mm across a panel of 300 mm: flattest when it is tilted, and wider then."""
    x, y = np.meshgrid(np.linspace(-100, 100, 21), np.linspace(-150, 150, 31), indexing="ij")
    i = np.arange(x.size).reshape(x.shape)
    a, b, c, d = i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    z = height * (1.5 * x / 100 - 0.5 * (x / 100) ** 3)
    mesh = trimesh.Trimesh(np.stack([x, y, z], -1).reshape(-1, 3), faces, process=False)
    mesh.export(folder / "wave.stl")
    return {"front": {"mesh": {"file": "wave.stl", "unit": "mm"}}}


def test_a_part_that_fits_as_it_was_drawn_is_not_tilted_out_of_its_block(tmp_path: Path) -> None:
    """The block is the mesh's own box and a hair."""
    part = make(wave(tmp_path), tmp_path, np.array([0.2002, 0.3002, 0.045]))
    np.testing.assert_allclose(np.ptp(part.front.vertices, axis=0), [0.2, 0.3, 0.04], atol=1e-6)
    tall = make(wave(tmp_path), tmp_path, np.array([0.22, 0.32, 0.045]))
    assert np.ptp(tall.front.vertices[:, 2]) < 0.030  # where there is room it lies flattest


def test_a_part_fits_its_block_where_a_tilt_does_and_is_refused_where_none_does(tmp_path: Path) -> None:
    """Brute force over tilts about the panel's long axis: neither the flattest nor the drawn one fits."""
    spec = wave(tmp_path)
    flattest = make(spec, tmp_path, np.array([0.25, 0.35, 0.1])).front.vertices
    turns = np.linspace(-0.4, 0.4, 1601)
    level = np.stack([np.cos(turns), np.zeros_like(turns), np.sin(turns)], axis=-1)
    up = np.stack([-np.sin(turns), np.zeros_like(turns), np.cos(turns)], axis=-1)
    wide, high = np.ptp(flattest @ level.T, axis=0), np.ptp(flattest @ up.T, axis=0)
    low, tight = np.array([0.2035, 0.3005, 0.0195]), np.array([0.2030, 0.3005, 0.0120])
    assert ((wide < low[0]) & (high < low[2])).any()
    assert np.ptp(flattest, axis=0)[0] > low[0]
    assert (np.ptp(make(spec, tmp_path, low).front.vertices, axis=0) < low + 1e-6).all()
    assert not ((wide < tight[0]) & (high < tight[2])).any()
    assert issue_code(spec, tmp_path, tight) == "part.stock_too_small"


def test_a_back_face_on_the_wrong_side_is_refused(tmp_path: Path) -> None:
    for name, z in (("front", 0.0), ("above", 20.0)):
        square = np.array([[0, 0, z], [100, 0, z], [100, 100, z], [0, 100, z]])
        trimesh.Trimesh(square, [[0, 1, 2], [0, 2, 3]], process=False).export(tmp_path / f"{name}.ply")
    front = {"mesh": {"file": "front.ply", "unit": "mm"}}
    above = {"mesh": {"file": "above.ply", "unit": "mm", "flip": True}}
    assert issue_code({"front": front, "back": above}, tmp_path) == "part.faces"
    inward = {"mesh": {"file": "front.ply", "unit": "mm", "flip": True}}
    below = {"mesh": {"file": "above.ply", "unit": "mm"}}
    part = {"front": inward, "back": below}
    assert make(part, tmp_path, np.array([0.1, 0.1, 0.03])).back is not None
    part["back"] = {"mesh": {"file": "above.ply", "unit": "mm", "flip": True}}
    assert issue_code(part, tmp_path) == "part.faces"


def test_a_part_thicker_than_its_radius_is_refused() -> None:
    spec = capital()
    spec["front"]["loft"]["rail"]["radius_mm"] = 15
    spec["front"]["loft"]["flip"] = False
    assert issue_code(spec) == "part.offset"


@pytest.mark.parametrize(
    "change",
    [
        {"profiles": []},
        {"profiles": PROFILES[::-1]},
        {"sections": PROFILES},
        {"profiles": [PROFILES[0], {"at": 1.0, "bezier_mm": [[0, 0], [1, 1]]}]},
        {"profiles": [{"at": 0.0}]},
        {"rail": {"radius_mm": 300, "start_deg": 10, "end_deg": 10}},
        {"region": {"u": [0.5, 0.2]}},
        {"colour": "red"},
    ],
)
def test_a_loft_that_is_not_complete_is_refused_by_field(change: dict[str, Any]) -> None:
    spec = capital()
    spec["front"]["loft"] |= change
    with pytest.raises(ValidationError):
        PartFile.model_validate(spec)


def test_normals_of_front_point_away_from_the_part() -> None:
    part = make(capital())
    front = TriangleMesh(part.front.vertices, part.front.faces)
    step = part.front.vertices - 0.02 * vertex_normals(front)
    peer = trimesh.Trimesh(part.back.vertices, part.back.faces, process=False)
    _, distance, _ = trimesh.proximity.closest_point(peer, step[::97])
    assert np.quantile(distance, 0.9) < 1e-3
