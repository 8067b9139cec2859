"""Reading of Rhino files, compared with rhino3dm's own values of curves and surfaces; and what is refused."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import rhino3dm
from scipy.spatial import cKDTree

from planner.geometry.mesh import face_normals
from planner.issues import TandemError
from planner.proof.part_files import rhino as proof
from planner.proof.part_files.surfaces import part_surfaces
from planner.reading import rhino
from planner.reading.cad_faces import RulingOptions
from planner.reading.part_surfaces import BackFile, FrontFile, build_faces
from planner.reading.rhino import RhinoFaceFile, RhinoFile, RhinoRuledFile
from tests.rhino_files import LOWER, UNITS, Model, at, curve, free_surface, ruled_surface, sample_curve

MM = 1e-3


def write_model(folder: Path, *things: Any, unit: str = "Millimeters") -> Path:
    model = Model(unit)
    for item in things:
        model.add(item)
    return model.write(folder / "part.3dm")


def ruled(folder: Path, closed: bool = False, flip: bool = False, **spec: Any) -> Any:
    own = RhinoRuledFile(file="part.3dm", **spec)
    options = RulingOptions(own.rulings, closed, flip, hole=False)
    return rhino.read_ruled("wall", own, options, folder, "part.ruled.0.rhino")


def refusal(read: Any) -> str:
    with pytest.raises(TandemError) as caught:
        read()
    (issue,) = caught.value.issues
    return f"{issue.code}: {issue.message}"


@pytest.mark.parametrize("unit", UNITS)
def test_curves_are_as_rhino_has_them_in_its_unit(tmp_path: Path, unit: str) -> None:
    circle = rhino3dm.NurbsCurve.CreateFromCircle(rhino3dm.Circle(rhino3dm.Point3d(1, 2, 3), 4.0))
    short = 0.3 * np.array(LOWER)  # 90 m of metres
    for item in (circle, curve(short), curve(short, degree=1)):
        write_model(tmp_path, item, unit=unit)
        (found,), notes = rhino.read_curves(RhinoFile(file="part.3dm"), tmp_path, "part")
        assert unit.lower() in notes[0].message
        true = sample_curve(item, 3000) * UNITS[unit] * MM
        ring = np.concatenate([found.points, found.points[:1]]) if found.closed else found.points
        fraction = np.linspace(0.0, 1.0, 20)[:, None, None]
        chords = ((1 - fraction) * ring[:-1] + fraction * ring[1:]).reshape(-1, 3)
        assert found.closed == (item is circle)
        assert (
            cKDTree(true).query(chords)[0].max() < 3e-6 + np.linalg.norm(np.diff(true, axis=0), axis=1).max()
        )
        near = np.array([_polyline_distance(point, ring) for point in true[::50]])
        assert near.max() < 2.1e-6  # of chords, as asked for
        # and the proof's own reader
        (other,) = proof.read_curves({"file": str(tmp_path / "part.3dm")})
        assert other.closed == found.closed
        assert max(_polyline_distance(point, ring) for point in other.points[::7]) < 2.1e-6


def _polyline_distance(point: np.ndarray, line: np.ndarray) -> float:
    """Distance of a point from a polyline."""
    segments = np.diff(line, axis=0)
    size = np.maximum(np.sum(segments * segments, axis=1), 1e-30)
    fraction = np.clip(np.sum((point - line[:-1]) * segments, axis=1) / size, 0.0, 1.0)[:, None]
    return float(np.linalg.norm(line[:-1] + fraction * segments - point, axis=1).min())


@pytest.mark.parametrize("raised", [1, 3])
@pytest.mark.parametrize("is_reversed", [False, True])
def test_a_ruled_face_gives_its_own_rulings_and_normal(
    tmp_path: Path, raised: int, is_reversed: bool
) -> None:
    surface = ruled_surface(raised=raised)
    brep = rhino3dm.Brep.CreateFromSurface(surface)
    if is_reversed:
        brep.Flip()
    write_model(tmp_path, brep)
    (result, notes) = ruled(tmp_path)
    assert [note.message for note in notes] == ["part.3dm is in millimeters"]
    # each end of a ruling is on the rail, and both are at one parameter of the surface
    t = np.linspace(surface.Domain(0).T0, surface.Domain(0).T1, 4001)
    v = [np.full(len(t), end) for end in (surface.Domain(1).T0, surface.Domain(1).T1)]
    rails = [at(surface, t, item) * MM for item in v]
    for side, rail in zip((result.start, result.end), rails, strict=True):
        assert max(_polyline_distance(point, rail) for point in side[::3]) < 2.1e-6
    ends = [
        cKDTree(rail).query(side)[1] for side, rail in zip((result.start, result.end), rails, strict=True)
    ]
    assert np.abs(ends[0] - ends[1]).max() <= 3
    middle = len(result.start) // 2
    normal = np.cross(
        result.start[middle + 1] - result.start[middle - 1], (result.end - result.start)[middle]
    )
    own = surface.NormalAt(t[ends[0][middle]], 0.5)
    sign = -1.0 if is_reversed else 1.0
    assert sign * (normal @ [own.X, own.Y, own.Z]) / np.linalg.norm(normal) > 0.99
    other = proof.ruled_face({"file": str(tmp_path / "part.3dm")})
    assert np.linalg.norm(other.start[[0, -1]] - result.start[[0, -1]], axis=1).max() < 1e-9
    assert np.linalg.norm(other.end[[0, -1]] - result.end[[0, -1]], axis=1).max() < 1e-9
    assert max(_polyline_distance(point, result.start) for point in other.start[::40]) < 6e-6


def test_the_sides_of_a_ruled_face_are_exact(tmp_path: Path) -> None:
    surface = ruled_surface(raised=3)
    write_model(tmp_path, surface)
    result = rhino._selected_face(rhino._select(RhinoRuledFile(file="part.3dm"), tmp_path, "part", ("face",)),
                        RhinoRuledFile(file="part.3dm"), "part")[0]  # fmt: skip
    u = np.linspace(0.0, 2.0, 500)
    for v in (0.0, 0.3, 1.0):
        own = result.points(u, np.full(500, v * result.whole()[1][1]))
        true = at(surface, u, np.full(500, v * surface.Domain(1).T1))
        assert np.abs(own / MM - true).max() < 1e-9  # mm


def test_a_face_that_goes_all_round_says_so(tmp_path: Path) -> None:
    low = rhino3dm.NurbsCurve.CreateFromCircle(rhino3dm.Circle(rhino3dm.Point3d(0, 0, 0), 40.0))
    high = rhino3dm.NurbsCurve.CreateFromCircle(rhino3dm.Circle(rhino3dm.Point3d(5, 0, 80), 25.0))
    write_model(tmp_path, ruled_surface(low, high))
    assert "add closed: true" in refusal(lambda: ruled(tmp_path))
    (result, _) = ruled(tmp_path, closed=True)
    assert result.closed
    assert np.linalg.norm(result.start[:, :2], axis=1) == pytest.approx(0.040, abs=2.1e-6)
    assert np.linalg.norm(result.end[:, :2] - [0.005, 0.0], axis=1) == pytest.approx(0.025, abs=2.1e-6)
    other = proof.ruled_face({"file": str(tmp_path / "part.3dm"), "closed": True})
    assert other.start[0] == pytest.approx(other.start[-1])


@pytest.mark.sampled(every=2)
@pytest.mark.parametrize("chord", [0.5, 0.01])
def test_facets_of_a_free_face_are_as_near_as_is_said(tmp_path: Path, chord: float) -> None:
    surface = free_surface()
    write_model(tmp_path, surface)
    result = rhino.read_face(RhinoFaceFile(file="part.3dm", chord_mm=chord), tmp_path, "part.front.rhino")
    told = result.notes[-1]
    assert told.value is not None and told.limit == chord
    assert told.value <= chord
    u, v = np.random.default_rng(1).uniform(0.0, 1.0, (2, 3000))
    true = at(surface, u, v) * MM
    import trimesh

    # in mm: trimesh takes triangles of less than a square millimetre in metres for lines
    mesh = trimesh.Trimesh(result.mesh.vertices / MM, result.mesh.faces, process=False)
    deviation = np.abs(trimesh.proximity.closest_point(mesh, true / MM)[1])
    assert deviation.max() <= chord
    assert deviation.max() > 0.05 * chord  # not far finer than asked for
    own = surface.NormalAt(0.4, 0.6)
    near = int(np.linalg.norm(result.mesh.vertices - at(surface, [0.4], [0.6]) * MM, axis=1).argmin())
    assert result.normals[near] @ [own.X, own.Y, own.Z] > 0.999
    other = proof.face({"file": str(tmp_path / "part.3dm")})
    assert np.abs(trimesh.proximity.closest_point(mesh, other.vertices[::97] / MM)[1]).max() <= chord
    over = proof.face({"file": str(tmp_path / "part.3dm"), "flip": True})
    assert over.up == pytest.approx(-other.up)


def test_a_mesh_is_taken_with_its_quads(tmp_path: Path) -> None:
    mesh = rhino3dm.Mesh()
    for x, y in ((0, 0), (1, 0), (1, 1), (0, 1), (2, 0)):
        mesh.Vertices.Add(100.0 * x, 100.0 * y, 5.0)
    mesh.Faces.AddFace(0, 1, 2, 3)
    mesh.Faces.AddFace(1, 4, 2)
    write_model(tmp_path, mesh, unit="Inches")
    result = rhino.read_face(RhinoFaceFile(file="part.3dm"), tmp_path, "part.front.rhino")
    assert result.surface is None
    assert len(result.mesh.faces) == 3
    assert np.ptp(result.mesh.vertices, axis=0) == pytest.approx([5.08, 2.54, 0.0])
    other = proof.face({"file": str(tmp_path / "part.3dm")})
    assert len(other.faces) == 3
    assert other.vertices.max() == pytest.approx(5.08)


def test_objects_are_picked_by_layer_name_and_colour(tmp_path: Path) -> None:
    model = Model()
    model.layer("roof", colour=(255, 0, 0, 255))
    model.layer("rails", "roof", colour=(0, 0, 255, 255))
    model.layer("off", visible=False)
    model.layer("below", "off")
    circles = [rhino3dm.Circle(rhino3dm.Point3d(100 * k, 0, 0), 10.0 + k).ToNurbsCurve() for k in range(5)]
    model.add(circles[0], "roof", "Eaves")
    model.add(circles[1], "rails", "left")
    model.add(circles[2], "rails", "right", ColorSource=rhino3dm.ObjectColorSource.ColorFromObject,
              ObjectColor=(1, 2, 3, 255))  # fmt: skip
    model.add(circles[3], "off")
    model.add(circles[4], "below")
    model.write(tmp_path / "part.3dm")

    def radii(**selection: str) -> list[int]:
        own, _ = rhino.read_curves(RhinoFile(file="part.3dm", **selection), tmp_path, "part")
        again = proof.read_curves({"file": str(tmp_path / "part.3dm"), **selection})
        size = [
            sorted(round(500 * float(np.ptp(item.points[:, 1]))) for item in each) for each in (own, again)
        ]
        assert size[0] == size[1]
        return size[0]

    assert radii() == [10, 11, 12]
    assert radii(layer="ROOF") == [10]
    assert radii(layer="rails") == radii(layer="Roof::Rails") == [11, 12]
    assert radii(name="eaves") == [10]
    assert radii(colour="#ff0000") == [10]
    assert radii(colour="#0000FF") == [11]
    assert radii(colour="#010203", layer="rails") == [12]
    _, notes = rhino.read_curves(RhinoFile(file="part.3dm"), tmp_path, "part")
    assert "left out 2 hidden" in notes[-1].message
    for asked, expected_text in (
        ({"layer": "walls"}, "has no layer walls; its layers are below, off, rails, roof"),
        ({"layer": "off"}, "has no curve of layer off, but 1 hidden"),
        ({"name": "ridge"}, "has no curve of name ridge"),
    ):
        refusal_text = refusal(
            lambda asked=asked: rhino.read_curves(RhinoFile(file="part.3dm", **asked), tmp_path, "part")
        )
        assert expected_text.split("; its")[0] in refusal_text


def test_units_are_the_files_and_nothing_is_guessed(tmp_path: Path) -> None:
    write_model(tmp_path, curve(LOWER), unit="Inches")
    (found,), _ = rhino.read_curves(RhinoFile(file="part.3dm", unit="in"), tmp_path, "part")
    assert np.ptp(found.points[:, 0]) == pytest.approx(300 * 0.0254)
    refusal_text = refusal(lambda: rhino.read_curves(RhinoFile(file="part.3dm", unit="mm"), tmp_path, "part"))
    assert "is in inches, but the problem states mm" in refusal_text
    model = Model()
    model.file.Settings.ModelUnitSystem = getattr(rhino3dm.UnitSystem, "None")
    model.add(curve(LOWER))
    model.write(tmp_path / "part.3dm")
    assert "state it" in refusal(lambda: rhino.read_curves(RhinoFile(file="part.3dm"), tmp_path, "part"))
    (found,), notes = rhino.read_curves(RhinoFile(file="part.3dm", unit="cm"), tmp_path, "part")
    assert np.ptp(found.points[:, 0]) == pytest.approx(3.0)
    assert notes[0].message == "part.3dm is in cm"
    write_model(tmp_path, curve(LOWER), unit="Miles")
    for unit in (None, "mm"):  # a file that says another unit than those that are read was taken for mm
        refusal_text = refusal(
            lambda own=unit: rhino.read_curves(RhinoFile(file="part.3dm", unit=own), tmp_path, "part")
        )
        assert "is in miles, which is not supported" in refusal_text
    write_model(tmp_path, curve(LOWER), curve(np.array(LOWER) + 1e6 * np.eye(3)[2]))
    refusal_text = refusal(lambda: rhino.read_curves(RhinoFile(file="part.3dm"), tmp_path, "part"))
    assert "is 1000 m across, allowed 100 m; check the unit" in refusal_text


def test_faces_that_are_not_ruled_or_not_one_are_refused(tmp_path: Path) -> None:
    write_model(tmp_path, free_surface())
    assert "is curved both ways; use it as front or strips" in refusal(lambda: ruled(tmp_path))
    write_model(
        tmp_path, ruled_surface(curve([(0, 0, 0), (100, 0, 0)], 1), curve([(0, 0, 50), (100, 30, 50)], 1))
    )
    assert "state the direction of the wire" in refusal(lambda: ruled(tmp_path))
    across, along_ = ruled(tmp_path, rulings="u")[0], ruled(tmp_path, rulings="v")[0]
    assert np.linalg.norm(across.end - across.start, axis=1).min() > 0.099
    assert np.linalg.norm(along_.end - along_.start, axis=1).max() < 0.060
    write_model(tmp_path, ruled_surface())
    assert "its lines along u are not straight; those along v are" in refusal(
        lambda: ruled(tmp_path, rulings="u")
    )
    write_model(tmp_path, ruled_surface(), ruled_surface(raised=2))
    assert "has 2 faces and meshes, expected 1" in refusal(lambda: ruled(tmp_path))
    write_model(tmp_path, curve(LOWER))
    assert "has no face, but 1 Curve" in refusal(lambda: ruled(tmp_path))


def test_faces_cut_along_other_lines_than_their_own_are_refused(tmp_path: Path) -> None:
    plane = rhino3dm.Plane.WorldXY()
    round_ = rhino3dm.Circle(rhino3dm.Point3d(0, 0, 0), 10.0).ToNurbsCurve()
    slanted = rhino3dm.Polyline(
        [rhino3dm.Point3d(*p) for p in ((0, 0, 0), (30, 10, 0), (20, 40, 0), (-10, 30, 0), (0, 0, 0))]
    ).ToNurbsCurve()
    for edge in (round_, slanted):
        write_model(tmp_path, rhino3dm.Brep.CreateTrimmedPlane(plane, edge))
        refusal_text = refusal(
            lambda: rhino.read_face(RhinoFaceFile(file="part.3dm"), tmp_path, "part.front.rhino")
        )
        assert "is not trimmed along its parameter lines; untrim it" in refusal_text
    square = rhino3dm.Polyline(
        [rhino3dm.Point3d(*p) for p in ((0, 0, 0), (30, 0, 0), (30, 10, 0), (0, 10, 0), (0, 0, 0))]
    ).ToNurbsCurve()
    write_model(tmp_path, rhino3dm.Brep.CreateTrimmedPlane(plane, square))
    result = rhino.read_face(RhinoFaceFile(file="part.3dm"), tmp_path, "part.front.rhino")
    assert np.ptp(result.mesh.vertices, axis=0) == pytest.approx([0.030, 0.010, 0.0])


@pytest.mark.long
def test_a_face_cut_along_its_own_lines_is_that_piece(tmp_path: Path) -> None:
    """rhino3dm cannot trim: edges on lines of the surface stand for a trimmed face."""
    surface = ruled_surface()
    write_model(tmp_path, surface)
    spec = RhinoRuledFile(file="part.3dm")
    result = rhino._select(spec, tmp_path, "part", ("face",))
    whole, _ = rhino._selected_face(result, spec, "part")
    box = (0.4, 1.7), (0.25, 0.75)
    sides = [(0, box[1][0], box[0]), (1, box[0][1], box[1]), (0, box[1][1], box[0]), (1, box[0][0], box[1])]
    edges = []
    for along_, fixed, (low, high) in sides:
        t = np.linspace(low, high, 400)
        other = np.full(400, fixed)
        points = at(surface, t, other) if along_ == 0 else at(surface, other, t)
        edges.append(rhino3dm.Polyline([rhino3dm.Point3d(*p) for p in points]).ToNurbsCurve())
    loops = [SimpleNamespace(Trims=[SimpleNamespace(EdgeIndex=k) for k in range(4)])]
    item, brep = SimpleNamespace(Loops=loops), SimpleNamespace(Edges=edges)
    cut = rhino._face_region(whole, item, brep, result, spec, "part")
    assert np.array(cut.region) == pytest.approx(np.array(box), abs=1e-5)
    own = proof._only_surface({"file": str(tmp_path / "part.3dm")})
    assert np.array(proof._face_region(own, loops[0].Trims, edges, MM)) == pytest.approx(
        np.array(box), abs=1e-5
    )


def test_damaged_files_are_refused_in_words(tmp_path: Path) -> None:
    path = write_model(tmp_path, curve(LOWER), ruled_surface())
    data = path.read_bytes()
    draw = np.random.default_rng(7)

    def read_damaged() -> None:
        rhino.read_curves(RhinoFile(file="part.3dm"), tmp_path, "part")
        ruled(tmp_path)

    for _ in range(60):
        broken = bytearray(data[: draw.integers(10, len(data))] if draw.random() < 0.5 else data)
        for place in draw.integers(0, len(broken), 8):
            broken[place] = draw.integers(0, 256)
        path.write_bytes(bytes(broken))
        try:
            read_damaged()
        except TandemError as error:
            assert {issue.code for issue in error.issues} <= {"part.rhino", "part.not_ruled"}
    path.write_text("not a model")
    assert "it is not a complete 3DM file" in refusal(read_damaged)
    path.unlink()
    assert refusal(read_damaged).startswith("problem.missing_file")


def test_faces_of_one_file_are_front_and_back_of_a_part(tmp_path: Path) -> None:
    model = Model()
    back = rhino3dm.Brep.CreateFromSurface(free_surface())
    back.Flip()
    back.Transform(rhino3dm.Transform.Translation(0, 0, -60))
    model.add(free_surface(), name="outside")
    model.add(back, name="inside")
    model.write(tmp_path / "part.3dm")
    given = {
        "front": {"rhino": {"file": "part.3dm", "name": "outside", "chord_mm": 0.05}},
        "back": {"rhino": {"file": "part.3dm", "name": "inside", "chord_mm": 0.05}},
    }
    faces = build_faces(FrontFile(**given["front"]), BackFile(**given["back"]), tmp_path)
    assert faces.back is not None
    assert faces.edges is not None
    assert face_normals(faces.front)[:, 2].max() > 0.9
    assert face_normals(faces.back)[:, 2].min() < -0.9
    said = {k: {"rhino": {**v["rhino"], "file": str(tmp_path / "part.3dm")}} for k, v in given.items()}
    names = [item.name for item in part_surfaces(said, 0.1)]
    assert names == ["front", "back", "edges"]
    over = {"rhino": {**given["front"]["rhino"], "flip": True}}
    with pytest.raises(TandemError, match="reverse the front"):
        build_faces(FrontFile(**over), BackFile(**given["back"]), tmp_path)
