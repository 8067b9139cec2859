"""The proof's own reader of meshes, against trimesh and against files whose triangles are known."""

import struct

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.geometry.mesh_files import read_mesh
from planner.issues import TandemError
from planner.proof.part_files import UnreadError
from planner.proof.part_files.meshes import read_facets

VERTICES = np.array([[0, 0, 0], [40, 0, 5], [40, 30, 0], [0, 30, -5], [20, 15, 9.5]], dtype=float)
FANS = [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]
SQUARE = "".join(f"v {x} {y} {z}\n" for x, y, z in VERTICES[:4])


def sorted_corners(corners):
    """Triangles (F, 3, 3), each starting at its smallest corner, in canonical order."""
    corners = np.asarray(corners, dtype=float).round(5)
    out = []
    for triangle in corners.tolist():
        first = min(range(3), key=lambda k: triangle[k])
        out.append([triangle[(first + k) % 3] for k in range(3)])
    return np.array(sorted(out))


def alike(path, unit=0.001):
    """Return whether the proof's reader and the planner's (trimesh) read the same triangles."""
    mesh = read_mesh(path, unit)
    own = sorted_corners(read_facets(path).corners * unit * 1e3)
    other = sorted_corners(mesh.vertices[mesh.faces] * 1e3)
    return own.shape == other.shape and np.abs(own - other).max() < 2e-5


OBJS = {
    "quads": SQUARE + "f 1 2 3 4\n",
    "negative": SQUARE + "f -4 -3 -2\nf -4 -2 -1\n",
    "colours": "".join(f"v {x} {y} {z} 0.1 0.2 0.3\n" for x, y, z in VERTICES) + "f 1 2 5\nf 2 3 5\n",
    "textures and normals": SQUARE + "vt 0 0\nvn 0 0 1\nf 1/1/1 2/1/1 3/1/1\nf 1//1 3//1 4//1\n",
    "objects, comments, long lines": "# made by hand\no one\n"
    + SQUARE
    + "g a\nf 1 2 \\\n 3\nusemtl x\nf 1 3 4\n",
    "a pentagon": SQUARE + "v -10 15 1\nf 1 2 3 4 5\n",
    "windows": (SQUARE + "f 1 2 3\nf 1 3 4\n").replace("\n", "\r\n"),
    "weights": "".join(f"v {x} {y} {z} 1.0\n" for x, y, z in VERTICES[:4]) + "f 1 2 3\nf 1 3 4\n",
}


@pytest.mark.parametrize("name", OBJS)
def test_forms_of_obj_are_read_as_the_planner_reads_them(tmp_path, name) -> None:
    path = tmp_path / "part.obj"
    path.write_text(OBJS[name], newline="")
    assert alike(path)


def test_a_negative_index_counts_from_its_own_line(tmp_path) -> None:
    """Wavefront's rule: -1 is the last vertex above the line, not the last of the file."""
    path = tmp_path / "part.obj"
    path.write_text("v 0 0 0\nv 10 0 0\nv 0 10 0\nf -3 -2 -1\nv 0 0 50\nv 10 0 50\nv 0 10 50\nf -3 -2 -1\n")
    assert alike(path)
    corners = read_facets(path).corners
    np.testing.assert_allclose(corners[0], [[0, 0, 0], [10, 0, 0], [0, 10, 0]])
    np.testing.assert_allclose(corners[1], [[0, 0, 50], [10, 0, 50], [0, 10, 50]])


def stl_text(more=""):
    """An ASCII STL of the four triangles."""
    rows = []
    for a, b, c in FANS:
        rows.append(" facet normal 0 0 1\n  outer loop")
        rows += ["   vertex " + " ".join(f"{v:e}" for v in VERTICES[i]) for i in (a, b, c)]
        rows.append("  endloop\n endfacet")
    return "solid part made by hand\n" + "\n".join(rows) + "\nendsolid part\n" + more


def stl_binary(head=b"binary"):
    """A binary STL of the four triangles."""
    body = b"".join(struct.pack("<12fH", 0, 0, 1, *VERTICES[f].ravel(), 0) for f in FANS)
    return head.ljust(80, b" ") + struct.pack("<I", len(FANS)) + body


@pytest.mark.parametrize(
    "data",
    [
        stl_text().encode(),
        stl_text("exported yesterday\n").encode(),
        (stl_text() + stl_text()).upper().encode(),
        stl_text().replace("\n", "\r\n").encode(),
        stl_binary(),
        stl_binary(b"solid but binary"),
    ],
    ids=["ascii", "trailing text", "two solids", "windows", "binary", "binary that begins with solid"],
)
def test_forms_of_stl_are_read_as_the_planner_reads_them(tmp_path, data) -> None:
    path = tmp_path / "part.stl"
    path.write_bytes(data)
    found = read_facets(path).corners
    count = 2 if b"SOLID" in data else 1
    expected = sorted_corners(np.concatenate([VERTICES[np.array(FANS)]] * count))
    np.testing.assert_allclose(sorted_corners(found), expected, atol=2e-5)
    if count == 1:
        assert alike(path)


def ply(form, extra=True, ragged=False, name="vertex_indices"):
    """Return a PLY file of the four triangles, with additional properties and elements."""
    order = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}[form]
    faces = [*FANS[1:], [0, 1, 4]] if not ragged else [[0, 1, 4], [1, 2, 3, 4], [3, 0, 4]]
    head = [f"ply\nformat {form} 1.0\ncomment by hand\nelement vertex {len(VERTICES)}", "property double x"]
    head += ["property double y", "property double z", *(["property uchar red"] if extra else [])]
    head.append(f"element face {len(faces)}")
    head += ["property float quality"] if extra and not ragged else []
    head += [f"property list uchar int {name}"]
    if extra:
        head += ["element edge 2", "property int vertex1", "property int vertex2"]
    head.append("end_header\n")
    rows = [(order + "3d" + ("B" if extra else ""), [*place, *([7] if extra else [])]) for place in VERTICES]
    for face in faces:
        quality = [0.5] if extra and not ragged else []
        rows.append((order + "f" * len(quality) + f"B{len(face)}i", [*quality, len(face), *face]))
    rows += [(order + "2i", [0, 1]), (order + "2i", [1, 2])] if extra else []
    if form == "ascii":
        body = "\n".join(" ".join(f"{v:g}" for v in values) for _, values in rows).encode() + b"\n"
    else:
        body = b"".join(struct.pack(layout, *values) for layout, values in rows)
    return "\n".join(head).encode() + body


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("extra", [False, True])
@pytest.mark.parametrize("ragged", [False, True])
def test_forms_of_ply_are_read_as_the_planner_reads_them(tmp_path, form, extra, ragged) -> None:
    path = tmp_path / "part.ply"
    path.write_bytes(ply(form, extra, ragged, "vertex_index" if extra else "vertex_indices"))
    if ragged and form != "ascii":  # the planner refuses lists of several lengths in binary files
        with pytest.raises(TandemError):
            read_mesh(path, 0.001)
        expected = np.concatenate(
            [VERTICES[np.array([[0, 1, 4], [3, 0, 4]])], VERTICES[[[1, 2, 3], [1, 3, 4]]]]
        )
        np.testing.assert_allclose(sorted_corners(read_facets(path).corners), sorted_corners(expected))
    else:
        assert alike(path)


@settings(max_examples=60, deadline=None)
@given(
    heights=st.lists(st.floats(-50, 50), min_size=12, max_size=12),
    kind=st.sampled_from(["obj", "stl", "stl_ascii", "ply", "ply_ascii"]),
)
def test_what_trimesh_writes_is_read_as_trimesh_reads_it(tmp_path_factory, heights, kind) -> None:
    x, y = np.meshgrid(np.arange(4) * 10.0, np.arange(3) * 10.0)
    places = np.column_stack([x.ravel(), y.ravel(), heights])
    at = np.arange(12).reshape(3, 4)
    a, b, c, d = at[:-1, :-1].ravel(), at[:-1, 1:].ravel(), at[1:, 1:].ravel(), at[1:, :-1].ravel()
    mesh = trimesh.Trimesh(places, np.concatenate([np.c_[a, b, c], np.c_[a, c, d]]), process=False)
    suffix = kind.removesuffix("_ascii")
    path = tmp_path_factory.mktemp("mesh") / f"part.{suffix}"
    options = (
        {"file_type": kind}
        if suffix != "ply"
        else {"file_type": "ply", "encoding": "ascii" if "_" in kind else "binary"}
    )
    mesh.export(path, **options)
    np.testing.assert_allclose(
        sorted_corners(read_facets(path).corners.round(3)), sorted_corners(mesh.triangles.round(3)), atol=2e-3
    )


BROKEN = {
    "part.obj": [
        b"",
        b"v 0 0 0\nf 1 2 3\n",
        b"v 0 0 zero\nf 1 1 1\n",
        b"v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
    ],
    "part.stl": [b"", b"solid x\n", stl_binary()[:-9], stl_text().replace("e+", "x").encode()],
    "part.ply": [
        b"",
        b"ply\n",
        ply("ascii")[:-20],
        ply("binary_big_endian")[:150],
        b"ply\nformat odd 1.0\nend_header\n",
    ],
    "part.step": [b"ISO-10303-21;"],
}


@pytest.mark.parametrize(("name", "data"), [(n, d) for n, several in BROKEN.items() for d in several])
def test_what_is_no_mesh_is_told(tmp_path, name, data) -> None:
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(UnreadError):
        read_facets(path)
    with pytest.raises(TandemError):
        read_mesh(path, 1.0)
