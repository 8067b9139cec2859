"""Files that other programs wrote (tests/real_files), compared with sizes that other sources state."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from planner.geometry.mesh_files import UNIT_SUFFIXES, read_mesh, stated_unit, unit_note
from planner.geometry.units import LENGTH_UNITS
from planner.issues import Severity, TandemError
from planner.proof.part_files import rhino as proof
from planner.proof.part_files.curves import read_curves
from planner.proof.part_files.meshes import read_facets
from planner.reading import rhino
from planner.reading.drawing import read_dxf
from planner.reading.rhino import RhinoFaceFile, RhinoFile

REAL_FILES = Path(__file__).parents[1] / "real_files"

# unit, faces, sides and area in it, as trimesh has them (3MF by its own reader, with lxml and networkx)
MESHES = {
    "3mfbase10_box.3mf": ("millimeter", 12, (10, 10, 10), 600),
    "3mfbase11_AdjMount.3mf": ("inch", 1704, (8.00528, 2.020745, 4.63061), 142.1561474),
    "3mfbase12_holed_cube.3mf": ("inch", 144, (9.84906, 8.00528, 9.84907), 512.6741823),
    "3mfbase2_material093.3mf": ("millimeter", 2708, (72.173111, 63.402715, 8.925999), 7465.727876),
    "3mfbase4_Mesh1.3mf": ("millimeter", 7486, (60.362002, 39.998007, 50.65), 15148.48119),
    "Box.3mf": ("millimeter", 48, (100, 100, 100), 60000),
    "Box_OverridePositive.3mf": ("millimeter", 12, (100, 100, 100), 60000),
    "Box_Simple.3mf": ("millimeter", 12, (100, 100, 100), 60000),
    "Color_093.3mf": ("meter", 4300, (0.30059, 0.204254, 0.040288), 0.07580663733),
    "Helix.3mf": ("millimeter", 500, (100, 100, 56.521), 23574.96353),
    "HierarchicalComponent.3mf": ("millimeter", 12, (100, 100, 100), 60000),
    "Texture.3mf": ("millimeter", 1346, (100, 100, 100), 42597.11686),
    "Texture_093.3mf": ("meter", 5072, (0.199799, 0.199597, 0.2), 0.1254529237),
    "UniSliceStack_TwoFiles.3mf": ("millimeter", 12, (100, 100, 100), 60000),
    "box_assimp.3mf": ("millimeter", 12, (10, 20, 30), 2200),
    "texcube.3mf": ("millimeter", 12, (10, 10, 10), 600),
    "track093.3mf": ("millimeter", 5281, (115.584, 39.998001, 8.233761), 10544.30098),
    "heart_token.glb": ("m", 6620, (0.023963, 0.02221, 0.004255), 0.001159805714),
    "singleBlendshapeCube_sparse.glb": ("m", 12, (0.01, 0.01, 0.01), 0.0005999999732),
    "spitfire_wing.glb": ("m", 486, (5.6134, 2.807216, 0.364009), 25.71311008),
}


def area(corners: np.ndarray) -> float:
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(0.5 * np.linalg.norm(cross, axis=1).sum())


@pytest.mark.parametrize("name", MESHES)
def test_meshes_have_the_size_that_they_were_given(name: str) -> None:
    unit, count, sides, stated = MESHES[name]
    path = REAL_FILES / name
    own = stated_unit(path)
    assert own.name == unit
    mesh = read_mesh(path, None)
    assert len(mesh.faces) == count
    assert np.ptp(mesh.vertices, axis=0) == pytest.approx(np.array(sides) * own.metres, rel=1e-6, abs=1e-6)
    assert area(mesh.vertices[mesh.faces]) == pytest.approx(stated * own.metres**2, rel=1e-5)
    (note,) = unit_note(path, "part")
    assert note.severity is Severity.NOTE and unit in note.message
    # and the proof's own reader
    result = read_facets(path)
    assert result.unit == pytest.approx(own.metres, rel=1e-15)
    assert area(result.corners * result.unit) == pytest.approx(area(mesh.vertices[mesh.faces]), rel=1e-9)
    low, high = (edge(result.corners.reshape(-1, 3) * result.unit, axis=0) for edge in (np.min, np.max))
    assert low == pytest.approx(mesh.vertices.min(axis=0), abs=1e-12)
    assert high == pytest.approx(mesh.vertices.max(axis=0), abs=1e-12)


@pytest.mark.parametrize("name", ["Pass.3mf", "NotListed.3mf"])
def test_a_mesh_that_needs_an_extension_is_refused_in_words(name: str) -> None:
    with pytest.raises(TandemError, match=r"needs the extension .*, which is not supported"):
        read_mesh(REAL_FILES / name, None)


@pytest.mark.parametrize(
    ("name", "other"), [("Helix.3mf", "in"), ("Color_093.3mf", "mm"), ("heart_token.glb", "mm")]
)
def test_another_unit_than_the_file_s_is_refused(name: str, other: str) -> None:
    with pytest.raises(TandemError, match=f"the problem states {other}; remove unit") as caught:
        read_mesh(REAL_FILES / name, LENGTH_UNITS[other])
    assert caught.value.issues[0].code == "mesh.unit"
    same = {"millimeter": "mm", "meter": "m", "m": "m"}[stated_unit(REAL_FILES / name).name]
    assert len(read_mesh(REAL_FILES / name, LENGTH_UNITS[same]).faces)


# sides in the drawing's own lengths, as ezdxf's bounding boxes have them
DRAWINGS = {
    "ellipticalarcs.dxf": (620.0047, 320.0024),
    "lwpolylines.dxf": (80, 120),
    "rectangle.dxf": (10, 10),
    "splines.dxf": (80, 84.1421),
    "squareandcircle.dxf": (10, 10),
}


@pytest.mark.parametrize("name", DRAWINGS)
def test_drawings_have_their_sides(name: str) -> None:
    pytest.importorskip("ezdxf")
    curves, _ = read_dxf(REAL_FILES / name, 1e-3, None, "part")
    points = np.concatenate([curve.points for curve in curves])
    assert np.ptp(points, axis=0)[:2] == pytest.approx(np.array(DRAWINGS[name]) * 1e-3, abs=1.5e-5)
    again = np.concatenate([curve.points for curve in read_curves(REAL_FILES / name, 1e-3, None)])
    assert np.ptp(again, axis=0) == pytest.approx(np.ptp(points, axis=0), abs=5e-6)


# sides in inches, by what the file is called in its package's tests, and by Rhino's own box of it
RHINO = {"3in_x_2in.3dm": (2.0, 3.0)}


@pytest.mark.parametrize("name", RHINO)
def test_faces_of_rhino_have_their_sides(name: str) -> None:
    pytest.importorskip("rhino3dm")
    result = rhino.read_face(RhinoFaceFile(file=name), REAL_FILES, "part.front.rhino")
    assert "inches" in result.notes[0].message
    assert np.ptp(result.mesh.vertices, axis=0)[:2] == pytest.approx(np.array(RHINO[name]) * 0.0254, abs=1e-9)
    again = proof.face({"file": str(REAL_FILES / name)}).vertices
    assert np.ptp(again, axis=0) == pytest.approx(np.ptp(result.mesh.vertices, axis=0), abs=1e-9)


def test_rhino_files_that_have_no_such_thing_say_what_they_have() -> None:
    pytest.importorskip("rhino3dm")
    with pytest.raises(TandemError, match=r"is not trimmed along its parameter lines|has holes"):
        rhino.read_face(RhinoFaceFile(file="complex_shape.3dm"), REAL_FILES, "part.front.rhino")
    with pytest.raises(TandemError, match=r"has no layer none; its layers are 0, CAULK"):
        rhino.read_curves(RhinoFile(file="compound_shape.3dm", layer="none"), REAL_FILES, "part.plate.rhino")


def test_a_subd_of_rhino_is_refused_with_what_makes_a_face_of_it() -> None:
    """Its 235 faces are no NURBS, and no reader here knows the shape of a SubD between them."""
    pytest.importorskip("rhino3dm")
    for read, expected_text in (
        (
            lambda: rhino.read_face(RhinoFaceFile(file="subd_8.3dm"), REAL_FILES, "part"),
            "no face and no mesh",
        ),
        (lambda: rhino.read_curves(RhinoFile(file="subd_8.3dm"), REAL_FILES, "part"), "no curve"),
    ):
        with pytest.raises(
            TandemError, match=rf"has {expected_text}, but 1 SubD; convert SubD to NURBS"
        ) as caught:
            read()
        (issue,) = caught.value.issues
        assert issue.code == "part.rhino" and "explode" not in issue.message


def test_every_file_has_its_source() -> None:
    table = (REAL_FILES / "SOURCES.md").read_text()
    files = [path for path in REAL_FILES.iterdir() if path.suffix != ".md"]
    assert len(files) >= 30
    assert sum(path.stat().st_size for path in files) < 6_000_000
    for path in files:
        assert f"| `{path.name}` |" in table
    assert {path.name for path in files if path.suffix in UNIT_SUFFIXES} >= set(MESHES)
