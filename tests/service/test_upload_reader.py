"""Meshes are counted before they are read: compared with trimesh, which reads them, and refused by name."""

from __future__ import annotations

import io
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh

from planner.service.security import ServiceLimits
from planner.service.upload_reader import mesh_size
from tests import small_problem
from tests.service.support import TABLE, InProcess

BALL = trimesh.creation.icosphere(subdivisions=3, radius=40.0)


def write_mesh(path: Path, kind: str) -> Path:
    if kind == "ascii":
        path.write_text(trimesh.exchange.stl.export_stl_ascii(BALL))
    elif kind == "text":
        path.write_bytes(trimesh.exchange.ply.export_ply(BALL, encoding="ascii"))
    else:
        made = BALL.export(file_type=path.suffix[1:])
        path.write_bytes(made.encode() if isinstance(made, str) else made)
    return path


@pytest.mark.parametrize(
    ("name", "kind"), [("a.obj", ""), ("a.stl", ""), ("a.ply", ""), ("a.STL", "ascii"), ("a.ply", "text")]
)
def test_the_count_is_what_trimesh_reads(tmp_path: Path, name: str, kind: str) -> None:
    path = write_mesh(tmp_path / name.lower(), kind)
    read = trimesh.load(io.BytesIO(path.read_bytes()), path.suffix[1:], force="mesh", process=False)
    result = mesh_size(path, Path(name).suffix)
    assert result.facets == len(read.faces) == 1280
    assert result.vertices >= len(read.vertices)


def quads(count: int, corners: int, text: bool) -> bytes:
    """Return a PLY file with the given numbers of faces and of corners per face."""
    points = np.random.default_rng(3).uniform(size=(corners, 3))
    head = f"ply\nformat {'ascii' if text else 'binary_little_endian'} 1.0\nelement vertex {corners}\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz")
    head += f"element face {count}\nproperty list uchar int vertex_indices\nend_header\n"
    if text:
        rows = [" ".join(f"{v:.3f}" for v in point) for point in points]
        rows += [" ".join(map(str, [corners, *range(corners)]))] * count
        return (head + "\n".join(rows) + "\n").encode()
    face = struct.pack(f"<B{corners}i", corners, *range(corners))
    return head.encode() + points.astype("<f4").tobytes() + face * count


@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize("corners", [3, 4, 9])
def test_a_polygon_counts_as_its_triangles(tmp_path: Path, corners: int, text: bool) -> None:
    path = tmp_path / "a.ply"
    path.write_bytes(quads(100, corners, text))
    assert mesh_size(path, ".ply") == (100 * (corners - 2), corners)
    obj = "v 0 0 0\n" * corners + f"f {' '.join(map(str, range(1, corners + 1)))}\n" * 100
    (tmp_path / "a.obj").write_text(obj)
    assert mesh_size(tmp_path / "a.obj", ".obj") == (100 * (corners - 2), corners)


@pytest.mark.parametrize("content", [b"", b"ply\n", b"ply\nend_header\n", b"\xff" * 200, b"solid\n"])
@pytest.mark.parametrize("suffix", [".ply", ".stl", ".obj", ".txt"])
def test_what_is_no_mesh_counts_nothing(tmp_path: Path, content: bytes, suffix: str) -> None:
    (tmp_path / "a").write_bytes(content)
    assert mesh_size(tmp_path / "a", suffix) == (0, 0)


def test_a_mesh_of_too_many_facets_is_refused_by_name(tmp_path: Path) -> None:
    body = "obstacles: [{name: wall, shapes: [{kind: mesh, file: ball.ply, unit: mm}]}]"
    problem = small_problem.PROBLEM.replace("stock:", f"  {body}\nstock:")
    files = [
        ("problem", ("p.yaml", problem)),
        ("files", ("targets.csv", TABLE)),
        ("files", ("ball.ply", BALL.export(file_type="ply"))),
    ]
    with InProcess(tmp_path / "data", ServiceLimits(mesh_facets=1279), examiners=1) as running_service:
        for path in ("/v1/jobs", "/v1/check", "/ui/preview"):
            answer = running_service.http.post(path, files=files)
            assert answer.status_code == 413
            (issue,) = answer.json()["issues"]
            assert (issue["code"], issue["field"], issue["file"]) == (
                "service.too_large",
                "files",
                "ball.ply",
            )
            assert (issue["value"], issue["limit"]) == (1280, 1279)
            assert "too many facets (got 1,280, allowed 1,279)" in issue["message"]
    with InProcess(tmp_path / "more", ServiceLimits(mesh_facets=1280), examiners=1) as running_service:
        assert running_service.http.post("/v1/check", files=files).status_code == 200
