"""Reading of STEP and IGES files, compared with Open CASCADE's own values of surfaces; and refusals."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner.issues import TandemError
from planner.proof.part_files import UnreadError
from planner.proof.part_files import step as proof
from planner.reading import step
from planner.reading.cad_faces import RulingOptions
from planner.reading.part_surfaces import FrontFile, build_faces
from planner.reading.step import StepFaceFile, StepRuledFile

REAL_FILES = Path(__file__).parents[1] / "real_files"
MM = 1e-3
LOWER = [(0, 0, 0), (60, 25, 0), (140, -20, 10), (200, 5, 0), (300, 0, 5)]
UPPER = [(0, 0, 100), (50, 40, 100), (150, 0, 110), (220, -15, 100), (300, 10, 100)]


def ruled(path: Path, closed: bool = False, flip: bool = False, **spec: Any) -> Any:
    own = StepRuledFile(file=path.name, **spec)
    options = RulingOptions(own.rulings, closed, flip, hole=False)
    return step.read_ruled("wall", own, options, path.parent, "part.ruled.0.step")


def refusal(read: Any) -> str:
    with pytest.raises(TandemError) as caught:
        read()
    (issue,) = caught.value.issues
    return f"{issue.code}: {issue.message}"


def off_line(points: np.ndarray, line: np.ndarray) -> float:
    """The largest distance of points from a polyline."""
    segments = np.diff(line, axis=0)
    size = np.maximum(np.sum(segments * segments, axis=1), 1e-30)
    fraction = np.clip(np.sum((points[:, None] - line[:-1]) * segments, axis=2) / size, 0.0, 1.0)[..., None]
    return float(np.linalg.norm(line[:-1] + fraction * segments - points[:, None], axis=2).min(axis=1).max())


def test_without_the_extra_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.step").write_text("ISO-10303-21;")
    monkeypatch.setattr(step.importlib.util, "find_spec", lambda name: None)
    assert "part.extra_missing" in refusal(lambda: ruled(tmp_path / "a.step"))
    assert "pip install 'tandem-planner[step]'" in refusal(lambda: ruled(tmp_path / "a.step"))


def test_files_that_are_none_are_refused(tmp_path: Path) -> None:
    assert "problem.missing_file" in refusal(lambda: ruled(tmp_path / "a.step"))
    (tmp_path / "a.sldprt").write_text("")
    assert "allowed STEP" in refusal(lambda: ruled(tmp_path / "a.sldprt"))


@pytest.fixture(scope="module")
def files() -> Any:
    pytest.importorskip("OCP", reason="STEP files need the extra step: pip install 'tandem-planner[step]'")
    from tests import step_files

    return step_files


@pytest.mark.sampled(every=2)
@pytest.mark.parametrize(
    ("name", "unit", "raised"),
    [("a.step", "MM", 1), ("a.stp", "INCH", 3), ("a.step", "M", 2), ("a.igs", "INCH", 1)],
)
def test_a_ruled_face_gives_its_own_rulings(
    tmp_path: Path, files: Any, name: str, unit: str, raised: int
) -> None:
    rails = np.array([LOWER, UPPER], dtype=float)
    fraction = np.linspace(0, 1, raised + 1)[:, None, None]
    surface = files.bspline(np.swapaxes((1 - fraction) * rails[0] + fraction * rails[1], 0, 1), (3, raised))
    path = files.write(tmp_path / name, [files.face(surface)], unit)
    result, (note,) = ruled(path)
    assert {"MM": "millimet", "M": "met", "INCH": "inch"}[
        unit
    ] in note.message and note.code == "part.step_unit"
    for side, v in ((result.start, 0.0), (result.end, 1.0)):
        t = np.linspace(0.0, 2.0, 8001)
        line = np.array([(p.X(), p.Y(), p.Z()) for p in (surface.Value(float(u), v) for u in t)]) * MM
        assert off_line(side, line) < 5e-6  # chords within 0.002 mm, as all guides have
        assert off_line(line[::40], side) < 5e-6
    again = proof.ruled_face({"file": str(path)})
    assert (
        max(off_line(a, b) for a, b in ((again.start[::20], result.start), (again.end[::20], result.end)))
        < 5e-6
    )
    ways = [line[-1] - line[0] for line in (again.start, result.start)]
    assert ways[0] @ ways[1] > 0  # the same side is outside
    # exact: the surface that is read is the one that was written, to 1e-6 mm
    face, *_ = step._selected_face(StepRuledFile(file=path.name), tmp_path, "part")
    region = np.array(face.region)
    for a, b in np.random.default_rng(1).random((20, 2)):
        u, v = region[:, 0] + np.array([a, b]) * np.ptp(region, axis=1)
        true = surface.Value(float(2 * a), float(b))
        assert face.points(np.array([u]), np.array([v]))[0] == pytest.approx(
            np.array([true.X(), true.Y(), true.Z()]) * MM, abs=1e-9
        )


def free(files: Any) -> Any:
    grid = [
        [(50.0 * i, 40.0 * j, 30 * np.sin(0.7 * i) * np.cos(0.9 * j)) for j in range(5)] for i in range(6)
    ]
    return files.bspline(grid, (3, 3))


@pytest.mark.sampled(every=2)
@pytest.mark.parametrize("chord", [0.5, 0.02])
def test_a_free_face_is_as_near_as_it_says(tmp_path: Path, files: Any, chord: float) -> None:
    from OCP.GeomAPI import GeomAPI_ProjectPointOnSurf
    from OCP.gp import gp_Pnt

    surface = free(files)
    path = files.write(tmp_path / "a.step", [files.face(surface)])
    result = step.read_face(StepFaceFile(file="a.step", chord_mm=chord), tmp_path, "part.front.step")
    told = next(note for note in result.notes if note.code == "part.step_facets")
    assert told.value <= chord
    middles = result.mesh.vertices[result.mesh.faces].mean(axis=1)
    middles = middles[:: max(1, len(middles) // 150)] / MM
    deviations = [
        GeomAPI_ProjectPointOnSurf(gp_Pnt(*map(float, p)), surface).LowerDistance() for p in middles
    ]
    assert max(deviations) <= 1.001 * told.value
    again = proof.face({"file": str(path)})
    assert np.ptp(again.vertices, axis=0) == pytest.approx(
        np.ptp(result.mesh.vertices, axis=0), abs=chord * MM
    )
    assert (again.up.mean(axis=0) @ result.normals.mean(axis=0)) > 0
    faces = build_faces(FrontFile(step=StepFaceFile(file="a.step", flip=True)), None, tmp_path)
    assert faces.front.vertices.shape[1] == 3
    assert "is curved both ways" in refusal(lambda: ruled(path))


@pytest.mark.long
def test_a_face_is_cut_along_its_own_lines_or_refused(tmp_path: Path, files: Any) -> None:
    from OCP.BRepAlgoAPI import BRepAlgoAPI_Cut
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeCylinder
    from OCP.gp import gp_Ax2, gp_Dir, gp_Pnt

    surface = free(files)
    piece = files.write(tmp_path / "piece.step", [files.face(surface, 0.5, 2.5, 0.25, 1.5)])
    result = step.read_face(StepFaceFile(file="piece.step", chord_mm=0.05), tmp_path, "part.front.step")
    true = [surface.Value(u, v) for u in (0.5, 2.5) for v in (0.25, 1.5)]
    for p in true:
        near = np.linalg.norm(result.mesh.vertices - np.array([p.X(), p.Y(), p.Z()]) * MM, axis=1)
        assert near.min() < 1e-9
    again = proof.face({"file": str(piece)})
    assert np.ptp(again.vertices, axis=0) == pytest.approx(np.ptp(result.mesh.vertices, axis=0), abs=5e-5)
    for x, words in ((0.0, "not trimmed along its parameter lines"), (120.0, "has holes")):
        tool = BRepPrimAPI_MakeCylinder(gp_Ax2(gp_Pnt(x, 80.0, -100.0), gp_Dir(0, 0, 1)), 25.0, 200.0).Shape()
        path = files.write(tmp_path / "cut.step", [BRepAlgoAPI_Cut(files.face(surface), tool).Shape()])
        refusal_text = refusal(
            lambda p=path: step.read_face(StepFaceFile(file=p.name), tmp_path, "part.front.step")
        )
        assert words in refusal_text and "create it again from its edges" in refusal_text


@pytest.mark.long
def test_faces_of_several_bodies_are_told_and_picked(
    tmp_path: Path, files: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    del files
    (tmp_path / "planner.py").write_text("raise SystemExit('the user has a file of this name')")
    monkeypatch.chdir(tmp_path)
    many = refusal(lambda: ruled(REAL_FILES / "two_disconnected_cubes.stp"))
    assert "has 12 faces in 2 bodies, expected 1" in many and "1 (plane, 'Unnamed', 'Cube'" in many
    assert "has 6 faces of colour #FFBB00" in refusal(
        lambda: ruled(REAL_FILES / "extrude_rectangle.stp", colour="#FFBB00")
    )
    assert "has 0 faces of name roof" in refusal(lambda: ruled(REAL_FILES / "single_cube.stp", name="roof"))
    assert "straight both ways" in refusal(lambda: ruled(REAL_FILES / "single_cube.stp", face=2))
    result, (note,) = ruled(REAL_FILES / "single_cube.stp", face=2, rulings="u")
    assert np.linalg.norm(result.end - result.start, axis=1) == pytest.approx(0.01, abs=1e-9)
    assert "millimetre" in note.message
    again = proof.ruled_face({"file": str(REAL_FILES / "single_cube.stp"), "face": 2, "rulings": "u"})
    assert np.linalg.norm(again.end - again.start, axis=1) == pytest.approx(0.01, abs=1e-9)
    with pytest.raises(UnreadError, match="12 of its faces match the selection"):
        proof.face({"file": str(REAL_FILES / "two_disconnected_cubes.stp")})


def test_units_that_contradict_or_are_missing_are_told(tmp_path: Path, files: Any) -> None:
    assert "is in millimetre, but the problem states in; remove unit" in refusal(
        lambda: ruled(REAL_FILES / "single_cube.stp", face=2, unit="in")
    )
    path = files.write(tmp_path / "a.step", [files.face(free(files))])
    text = path.read_text()
    unit = text.index("GLOBAL_UNIT_ASSIGNED_CONTEXT")
    path.write_text(text[:unit] + "GLOBAL_UNIT_ASSIGNED_CONTEXT(())" + text[text.index("))", unit) + 2 :])
    path.write_text(path.read_text().replace("LENGTH_UNIT()", ""))
    assert "states no unit of length; state it" in refusal(
        lambda: step.read_face(StepFaceFile(file="a.step"), tmp_path, "part.front.step")
    )
    result = step.read_face(StepFaceFile(file="a.step", unit="cm", chord_mm=1.0), tmp_path, "part.front.step")
    assert np.ptp(result.mesh.vertices[:, 0]) == pytest.approx(2.5, rel=1e-6)
    again = proof.face({"file": str(path), "unit": "cm"})
    assert np.ptp(again.vertices[:, 0]) == pytest.approx(2.5, rel=1e-6)


# faces, as the files' own lists of ADVANCED_FACE have them
REAL = {
    "M6-1x12-countersunk-screw.step": 28,
    "curved_extrude.stp": 4,
    "extrude_rectangle.stp": 6,
    "multi_volume_cylinders.stp": 28,
    "nema-17-bracket.step": 42,
    "single_cube.stp": 6,
    "single_volume_thin.stp": 6,
    "two_connected_cubes.stp": 12,
    "two_disconnected_cubes.stp": 12,
    "example-arcs.iges": 0,
    "sample.igs": 0,
}


@pytest.mark.sampled(every=4)
@pytest.mark.parametrize("name", REAL)
def test_files_of_other_writers_are_read(files: Any, name: str) -> None:
    del files
    refusal_text = refusal(lambda: step.read_face(StepFaceFile(file=name), REAL_FILES, "part.front.step"))
    assert f"has {REAL[name]} faces in" in refusal_text


def test_damaged_files_are_refused_in_words(tmp_path: Path, files: Any) -> None:
    del files
    whole = (REAL_FILES / "single_cube.stp").read_bytes()
    for data in (b"", b"solid", whole[: len(whole) // 2]):
        (tmp_path / "a.step").write_bytes(data)
        assert "part.step: a.step: " in refusal(lambda: ruled(tmp_path / "a.step", face=2, rulings="u"))


def test_what_the_planner_reads_wrongly_the_proof_does_not(
    tmp_path: Path, files: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Faults of scale, side and mirror in the planner's reading are seen in the points of the proof's."""
    path = files.write(tmp_path / "a.step", [files.face(free(files))], "INCH")
    spec = StepFaceFile(file="a.step", chord_mm=0.2)
    true = proof.face({"file": str(path)})
    read = step._query_file

    def proof_deviation(change: Any) -> tuple[float, float]:
        def wrong(*given: Any) -> Any:
            out = read(*given)
            change(out["surface"])
            return out

        monkeypatch.setattr(step, "_query_file", wrong)
        result = step.read_face(spec, tmp_path, "part.front.step")
        ends = [[edge(item.vertices, axis=0) for edge in (np.min, np.max)] for item in (result.mesh, true)]
        difference = np.abs(np.array(ends[0]) - np.array(ends[1])).max()
        return float(difference), float(result.normals.mean(axis=0) @ true.up.mean(axis=0))

    def scale_control_points(surface: Any, factors: Any) -> None:
        surface["control"] = (np.array(surface["control"]) * factors).tolist()

    assert proof_deviation(lambda own: None)[0] < 0.2 * MM
    assert proof_deviation(lambda own: scale_control_points(own, [1.05, 1.05, 1.05, 1]))[0] > 5 * MM
    assert proof_deviation(lambda own: scale_control_points(own, [1, -1, 1, 1]))[0] > 5 * MM
    assert (
        proof_deviation(lambda own: None)[1]
        > 0
        > proof_deviation(lambda own: own.update(reversed=not own["reversed"]))[1]
    )
