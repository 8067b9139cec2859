"""Mesh files: correct reading, and refusals with their codes."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from planner.geometry import mesh
from planner.geometry.mesh import TriangleMesh, check_surface, offset_mesh, vertex_normals
from planner.geometry.mesh_files import read_mesh
from planner.issues import TandemError


def grid(n: int = 5, size: float = 0.4) -> TriangleMesh:
    x = np.linspace(-size / 2, size / 2, n)
    xx, yy = np.meshgrid(x, x, indexing="ij")
    index = np.arange(n * n).reshape(n, n)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    return TriangleMesh(np.stack([xx, yy, xx * yy], -1).reshape(-1, 3), faces)


@pytest.mark.parametrize("suffix", ["obj", "stl", "ply"])
def test_what_trimesh_writes_is_read_in_the_stated_unit(tmp_path: Path, suffix: str) -> None:
    expected = grid()
    path = tmp_path / f"face.{suffix}"
    trimesh.Trimesh(expected.vertices * 1e3, expected.faces, process=False).export(path)
    got = read_mesh(path, 1e-3)
    assert len(got.vertices) == len(expected.vertices)
    assert len(got.faces) == len(expected.faces)
    assert mesh.face_areas(got).sum() == pytest.approx(mesh.face_areas(expected).sum(), rel=1e-6)
    assert check_surface(got, "part.front") == []


def test_quads_of_an_obj_file_become_triangles(tmp_path: Path) -> None:
    path = tmp_path / "quad.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n")
    assert mesh.face_areas(read_mesh(path, 0.1)).sum() == pytest.approx(0.01)


TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"


@pytest.mark.parametrize(
    ("name", "text", "unit", "code"),
    [
        ("a.obj", TRIANGLE, 0.1, "mesh.empty"),
        ("a.obj", "", 0.1, "mesh.empty"),
        ("a.obj", "v 0 0 0\nv 0 0 0\nv 0 0 0\nf 1 2 3\n", 0.1, "mesh.empty"),
        ("a.obj", "v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", 0.1, "problem.not_finite"),
        ("a.obj", TRIANGLE + "f 1 2 3\n", 1e-4, "mesh.unit"),
        ("a.obj", TRIANGLE + "f 1 2 3\n", 100.0, "mesh.unit"),
        ("a.ply", "ply\nnonsense", 1.0, "mesh.unreadable"),
        ("a.stl", "\x00\x01 not an STL", 1.0, "mesh.empty"),
        ("a.step", "ISO-10303-21;", 1.0, "mesh.unreadable"),
    ],
)
def test_a_bad_file_is_refused_by_its_code(
    tmp_path: Path, name: str, text: str, unit: float, code: str
) -> None:
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(TandemError) as caught:
        read_mesh(path, unit)
    issue = caught.value.issues[0]
    if name == "a.obj" and text == "":
        assert issue.code in {"mesh.empty", "mesh.unreadable"}
    else:
        assert issue.code == code
    assert issue.file == str(path)


def test_a_missing_file_and_a_file_over_100_mb_are_refused(tmp_path: Path) -> None:
    with pytest.raises(TandemError) as caught:
        read_mesh(tmp_path / "none.obj", 1e-3)
    assert caught.value.issues[0].code == "problem.missing_file"
    large = tmp_path / "large.stl"
    with large.open("wb") as file:
        file.truncate(100_000_001)
    with pytest.raises(TandemError) as caught:
        read_mesh(large, 1e-3)
    assert caught.value.issues[0].code == "problem.too_large"


def test_a_surface_must_be_open_manifold_oriented_and_one_piece() -> None:
    flat = grid(3)
    fin = TriangleMesh(
        np.vstack([flat.vertices, [[0.0, 0.0, 1.0]]]), np.vstack([flat.faces, [[0, 4, 9]], [[4, 0, 9]]])
    )
    assert [i.code for i in check_surface(fin, "f")] == ["mesh.non_manifold"]
    turned = flat.faces.copy()
    turned[0] = turned[0][::-1]
    assert [i.code for i in check_surface(TriangleMesh(flat.vertices, turned), "f")] == ["mesh.orientation"]
    box = trimesh.creation.box()
    closed = TriangleMesh(np.array(box.vertices), np.array(box.faces, dtype=np.int64))
    assert [i.code for i in check_surface(closed, "f")] == ["mesh.closed"]
    two = TriangleMesh(
        np.vstack([flat.vertices, flat.vertices + 1.0]),
        np.vstack([flat.faces, flat.faces + len(flat.vertices)]),
    )
    assert [i.code for i in check_surface(two, "f")] == ["mesh.pieces"]


def sphere_cap(radius: float) -> TriangleMesh:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=radius)
    keep = (np.array(ball.vertices)[ball.faces][:, :, 2] > 0).all(axis=1)
    return mesh.merge_vertices(
        TriangleMesh(np.array(ball.vertices), np.array(ball.faces, dtype=np.int64)[keep])
    )


def test_offsetting_a_sphere_changes_its_radius() -> None:
    cap = sphere_cap(0.3)
    inner = offset_mesh(cap, -0.02)
    high = cap.vertices[:, 2] > 0.05  # at the rim the averaged normals lean
    np.testing.assert_allclose(np.linalg.norm(inner.vertices[high], axis=1), 0.28, atol=2e-6)
    np.testing.assert_allclose(vertex_normals(cap)[high], cap.vertices[high] / 0.3, atol=3e-3)


def test_an_offset_beyond_the_radius_is_refused() -> None:
    with pytest.raises(TandemError) as caught:
        offset_mesh(sphere_cap(0.015), -0.02)
    assert caught.value.issues[0].code == "part.offset"


def test_a_mesh_opens_no_file_but_its_own(tmp_path: Path) -> None:
    """OBJ names materials, and those name pictures; whose mesh it is may not choose what is read."""
    (tmp_path / "secret.mtl").write_text("newmtl a\nmap_Kd secret.png\n")
    text = "mtllib secret.mtl\nusemtl a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1\n"
    (tmp_path / "a.obj").write_text(text)
    opened: list[str] = []

    def hear(event: str, arguments: tuple[object, ...]) -> None:
        if event == "open" and str(arguments[0]).startswith(str(tmp_path)):
            opened.append(Path(str(arguments[0])).name)

    sys.addaudithook(hear)
    assert len(read_mesh(tmp_path / "a.obj", 1.0).faces) == 1
    assert opened == ["a.obj"]
