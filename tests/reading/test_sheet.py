"""Sheets and their parts in problem files: what is read, and what each refusal says."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
import trimesh

from planner import pipeline
from planner.geometry.arrays import Mesh
from planner.geometry.units import DEG, MM
from planner.issues import Severity, TandemError
from planner.problem import Problem
from planner.processes.forming.plan.features.tree import build_feature_tree
from tests import small_forming
from tests.processes.forming.plan import nests
from tests.refusals import change, codes, expect_refusal

SHEET_FIELDS = [
    ("sheet.size_mm", [160], "size_mm"),
    ("sheet.size_mm", [160, -1], "size_mm"),
    ("sheet.size_mm", ["a", 160], "size_mm"),
    ("sheet.thickness_mm", 0, "thickness_mm"),
    ("sheet.thickness_mm", 21, "thickness_mm"),
    ("sheet.thickness_mm", "thin", "thickness_mm"),
    ("sheet.opening_mm", 0, "opening_mm"),
    ("sheet.opening_mm", [100], "opening_mm"),
    ("sheet.opening_mm", 161, "sheet"),
    ("sheet.opening_mm", [100, 161], "sheet"),
    ("sheet.stand", "leaning", "stand"),
    ("sheet.place", "here", "place"),
    ("sheet.clamp.width_mm", 0, "width_mm"),
    ("sheet.clamp.border", "hinged", "border"),
    ("sheet.clamp", {"border": "spring"}, "clamp"),
    ("sheet.clamp", {"spring_n_mm2": 40}, "clamp"),
    ("sheet.clamp", {"border": "spring", "spring_n_mm2": 0}, "spring_n_mm2"),
    ("sheet.colour", "red", "colour"),
    ("part.sheet_mesh.unit", "inch", "unit"),
    ("part.sheet_mesh.face", "left", "face"),
    ("part.sheet_mesh.frame", "world", "frame"),
    ("part.sheet_mesh.down", "yes please", "down"),
    ("part.sheet_mesh.file", "", "file"),
    ("operations.0.arms", ["robot", "robot"], "operations"),
    ("operations.0.mode", "dsif", "operations"),
    ("operations.0.stepdown_mm", 0, "stepdown_mm"),
    ("operations.0.scallop_mm", 0.01, "operations"),
    ("operations.0.passes", [40, 20], "operations"),
    ("operations.0.squeeze", 2, "squeeze"),
    ("operations.0.path", "zigzag", "path"),
    ("operations.0.repeats", 1.5, "repeats"),
    ("cell.arms.0.tool.radius_mm", 0, "radius_mm"),
]
Edit = Callable[[Mesh], Mesh]


def load(folder: Path, part: Mesh | None = None, **fields: Any) -> Problem:
    data = small_forming.problem()
    for name, value in fields.items():
        data = change(data, name.replace("__", "."), value)
    return pipeline.load(small_forming.write(folder, data, part))


def formed_mesh(problem: Problem) -> Mesh:
    assert problem.part is not None
    assert problem.part.formed is not None
    return problem.part.formed.mesh


@pytest.mark.parametrize(("field", "value", "named"), SHEET_FIELDS)
def test_a_wrong_field_is_refused_by_its_name(tmp_path: Path, field: str, value: Any, named: str) -> None:
    data = change(small_forming.problem(), field, value)
    issues = expect_refusal(small_forming.write(tmp_path, data))
    assert codes(issues) == {"problem.field"}
    assert any(named in str(issue.field) for issue in issues)
    assert all(issue.line for issue in issues)


def test_the_sheet_is_clamped_around_its_opening(tmp_path: Path) -> None:
    stock = load(tmp_path).stock
    assert stock.sheet is not None
    np.testing.assert_allclose(stock.size, [0.16, 0.16, 0.001])
    np.testing.assert_allclose(np.linalg.norm(stock.sheet.opening, axis=1), 0.05)
    opening = shapely.Polygon(stock.sheet.opening)
    for bar in stock.support:
        half = 0.5 * np.array(bar.size)
        corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half
        world = corners @ bar.pose[:3, :3].T + bar.pose[:3, 3]
        hull = shapely.MultiPoint(world[:, :2]).convex_hull
        # bars are straight: the middle of each reaches in by the sagitta of 16 chords
        assert hull.intersection(opening.buffer(-0.05 * (1.0 - np.cos(np.pi / 16)) - 1e-6)).area < 1e-12
        assert (world[:, 2] >= 0.001 - 1e-12).all() or (world[:, 2] <= 1e-12).all()
    assert {round(float(z), 6) for bar in stock.support for z in bar.size[2:]} == {0.01, 0.06}


def test_an_upright_sheet_stands_with_its_y_up(tmp_path: Path) -> None:
    attitude = load(tmp_path, sheet__stand="upright").stock.attitude
    np.testing.assert_allclose(attitude[:, 1], [0.0, 0.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(load(tmp_path).stock.attitude, np.eye(3))


def test_a_part_in_any_frame_is_found_with_its_x_kept(tmp_path: Path) -> None:
    part = small_forming.dish()
    oval = Mesh(part.vertices * [1.0, 0.8, 1.0], part.faces)
    expected = formed_mesh(load(tmp_path, oval)).vertices
    turn = trimesh.transformations.rotation_matrix(25.0 * DEG, [0.0, 1.0, 0.0])
    moved = Mesh(trimesh.transform_points(oval.vertices, turn) + np.array([0.3, -0.2, 0.5]), oval.faces)
    result = formed_mesh(load(tmp_path, moved, part__sheet_mesh__frame="find")).vertices
    np.testing.assert_allclose(result, expected, atol=2e-6)
    assert codes(expect_refusal(small_forming.write(tmp_path, small_forming.problem(), moved))) == {
        "forming.border"
    }


def test_normals_of_either_side_and_a_soup_of_triangles_give_the_same_part(tmp_path: Path) -> None:
    part = small_forming.dish()
    expected = formed_mesh(load(tmp_path)).vertices
    turned = formed_mesh(load(tmp_path, Mesh(part.vertices, part.faces[:, ::-1])))
    np.testing.assert_allclose(turned.vertices, expected)
    corners = turned.vertices[turned.faces]
    assert (np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] > 0.0).all()
    soup = Mesh(part.vertices[part.faces].reshape(-1, 3), np.arange(3 * len(part.faces)).reshape(-1, 3))
    assert len(formed_mesh(load(tmp_path, soup)).vertices) == len(expected)


def _without(part: Mesh, away: float) -> Mesh:
    middle = part.vertices[part.faces].mean(axis=1)
    return Mesh(part.vertices, part.faces[np.linalg.norm(middle[:, :2], axis=1) > away])


def _two(part: Mesh) -> Mesh:
    vertices = np.concatenate([0.4 * part.vertices + [0.02, 0, 0], 0.4 * part.vertices - [0.02, 0, 0]])
    return Mesh(vertices, np.concatenate([part.faces, part.faces + len(part.vertices)]))


def _scale(scale: float) -> Edit:
    return lambda part: Mesh(part.vertices * scale, part.faces)


def _move_vertex(vertex: int, value: float) -> Edit:
    def edit(part: Mesh) -> Mesh:
        vertices = part.vertices.copy()
        vertices[vertex, 2] = value
        return Mesh(vertices, part.faces)

    return edit


def _flip_some_faces(part: Mesh) -> Mesh:
    faces = part.faces.copy()
    faces[::3] = faces[::3, ::-1]
    return Mesh(part.vertices, faces)


def _leaning(part: Mesh) -> Mesh:
    """Widen everything below 3 mm by half: more than a tenth of the faces point down."""
    low = part.vertices[:, 2] < -0.003
    wide = np.where(low[:, None], [1.5, 1.5, 1.0], [1.0, 1.0, 1.0])
    return Mesh(part.vertices * wide, part.faces)


MESHES: dict[str, tuple[Edit, str, str]] = {
    "0.07 mm": (_scale(1e-3), "mesh.unit", "unit"),
    "70 m": (_scale(1e3), "mesh.unit", "unit"),
    "five times too large": (_scale(5.0), "part.stock_too_small", "larger sheet"),
    "flat": (lambda part: Mesh(part.vertices * [1, 1, 0.01], part.faces), "forming.flat", "unit"),
    "hole in the floor": (lambda part: _without(part, 0.01), "forming.border", "hole"),
    "rim 3 mm up": (_move_vertex(0, 0.003), "forming.border", "allowed"),
    "not a number": (_move_vertex(50, np.nan), "problem.not_finite", "repair"),
    "infinite": (_move_vertex(50, np.inf), "problem.not_finite", "repair"),
    "two pieces": (_two, "mesh.pieces", "1 is required"),
    "three faces at an edge": (
        lambda part: Mesh(
            np.concatenate([part.vertices, [[0.0, 0.0, 0.01]]]),
            np.concatenate([part.faces, [[*part.faces[300, :2], len(part.vertices)]]]),
        ),
        "mesh.non_manifold",
        "delete",
    ),
    "faces turned at random": (_flip_some_faces, "forming.inside_out", "orient"),
    "one triangle": (lambda part: Mesh(np.eye(3) * 0.02, np.array([[0, 1, 2]])), "forming.border", "allowed"),
    "no faces": (lambda part: Mesh(part.vertices, part.faces[:0]), "mesh.empty", "export"),
}


@pytest.mark.parametrize("name", MESHES)
def test_a_mesh_that_is_no_part_is_named_with_the_remedy(tmp_path: Path, name: str) -> None:
    edit, code, expected_text = MESHES[name]
    path = small_forming.write(tmp_path, small_forming.problem(), edit(small_forming.dish()))
    (issue, *more) = expect_refusal(path)
    assert not more
    assert (issue.code, issue.severity) == (code, Severity.ERROR)
    assert expected_text in f"{issue.message} {issue.hint}"


def test_a_closed_mesh_is_refused(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(2, 20.0 * MM)
    path = small_forming.write(tmp_path, small_forming.problem(), Mesh(ball.vertices, ball.faces))
    assert codes(expect_refusal(path)) == {"forming.closed_mesh"}


def test_a_part_moved_out_of_the_opening_is_refused_with_the_place(tmp_path: Path) -> None:
    data = change(small_forming.problem(), "part.in_stock", {"xyz_mm": [30, 0, 0]})
    (issue,) = expect_refusal(small_forming.write(tmp_path, data))
    assert issue.code == "part.stock_too_small"
    assert issue.field == "sheet.opening_mm"


def test_solids_hold_all_that_stands_out_of_the_sheet(tmp_path: Path) -> None:
    problem = load(tmp_path)
    assert problem.stock.sheet is not None
    (solid,) = problem.stock.sheet.formed
    hull = trimesh.Trimesh(solid.vertices, solid.faces)
    below = formed_mesh(problem).vertices
    below = below[below[:, 2] < -0.2 * MM]
    assert (trimesh.proximity.signed_distance(hull, below) > -1e-9).all()


def _noisy(noise: float, seed: int = 5) -> Edit:
    """Isotropic noise of a standard deviation [m] on all vertices."""

    def edit(part: Mesh) -> Mesh:
        moved = np.random.default_rng(seed).normal(0.0, 1.0, part.vertices.shape) * noise
        return Mesh(part.vertices + moved, part.faces)

    return edit


def _scan(noise: float = 1e-4, spacing: float = 1.5e-3) -> Mesh:
    """A dish of 60 mm on irregular triangles as a scan has it."""
    line = small_forming.dish().vertices
    away, height = np.hypot(line[:, 0], line[:, 1]), line[:, 2]
    order = np.argsort(away)

    def dish(x: Any, y: Any) -> Any:
        return np.asarray(np.interp(np.hypot(x, y), away[order], height[order]))

    return _noisy(noise)(nests.sheet(dish, 0.045, spacing, 2))


def _write_with_tolerance(tmp_path: Path, tolerance: object, part: Mesh) -> Path:
    data = change(small_forming.problem(), "part.sheet_mesh.tolerance_mm", tolerance)
    return small_forming.write(tmp_path, data, part)


def test_noise_of_a_scan_is_found_told_and_taken_away(tmp_path: Path) -> None:
    problem = pipeline.load(small_forming.write(tmp_path, small_forming.problem(), _scan()))
    assert problem.part is not None and problem.part.formed is not None
    part = problem.part.formed
    assert part.tolerance == pytest.approx(3e-4, rel=0.2) and part.stated_tolerance is None
    (note,) = problem.part.notes
    assert (note.code, note.severity) == ("part.mesh_noise", Severity.NOTE)
    assert note.value == pytest.approx(part.tolerance / MM)
    deviation = np.linalg.norm(part.mesh.vertices - part.source.vertices, axis=1)
    assert np.quantile(deviation, 0.9) < part.tolerance
    assert len(build_feature_tree(part.mesh, 1e-3, part.tolerance).features) == 1
    with pytest.raises(TandemError):  # as it was given it is a heap of features, or turns over
        build_feature_tree(part.source, 1e-3)


def test_a_mesh_without_noise_is_formed_as_it_is(tmp_path: Path) -> None:
    problem = load(tmp_path)
    assert problem.part is not None and problem.part.formed is not None
    part = problem.part.formed
    assert part.tolerance == 0.0 and problem.part.notes == ()
    assert np.array_equal(part.mesh.vertices, part.source.vertices)


@pytest.mark.parametrize("tolerance", [0, -0.1, "much"])
def test_a_tolerance_that_is_no_length_is_refused_by_field(tmp_path: Path, tolerance: object) -> None:
    issues = expect_refusal(_write_with_tolerance(tmp_path, tolerance, small_forming.dish()))
    assert {issue.code for issue in issues} == {"problem.field"}
    assert all("part.sheet_mesh.tolerance_mm" in str(issue.field) for issue in issues)


@pytest.mark.parametrize("tolerance", [1.5, 50.0])
def test_a_tolerance_as_large_as_the_part_is_refused_and_its_remedy_works(
    tmp_path: Path, tolerance: float
) -> None:
    (issue,) = expect_refusal(_write_with_tolerance(tmp_path, tolerance, small_forming.dish()))
    assert (issue.code, issue.field) == ("part.mesh_tolerance", "part.sheet_mesh.tolerance_mm")
    assert issue.limit == pytest.approx(6.0 / 5.0, rel=1e-3)
    pipeline.load(_write_with_tolerance(tmp_path, issue.limit * 0.99, small_forming.dish()))
    pipeline.load(_write_with_tolerance(tmp_path, "auto", small_forming.dish()))


def test_noise_beyond_the_stated_tolerance_is_told_and_its_remedy_works(tmp_path: Path) -> None:
    problem = pipeline.load(_write_with_tolerance(tmp_path, 0.1, _scan()))
    assert problem.part is not None
    _, warning = problem.part.notes
    assert (warning.code, warning.severity) == ("part.mesh_noise", Severity.WARNING)
    assert warning.value is not None
    again = pipeline.load(_write_with_tolerance(tmp_path, round(warning.value, 3), _scan()))
    assert again.part is not None and len(again.part.notes) == 1


@pytest.mark.parametrize("high", [0.25, -0.3])
def test_a_narrow_ridge_is_not_taken_for_noise_and_its_remedy_works(tmp_path: Path, high: float) -> None:
    """A ridge 1 mm wide and 16 mm long, in a scan with noise of 0.05 mm and vertices 1 mm apart.

    Without it there is nothing to report.
    """
    part = _scan(5e-5, 1e-3)
    x, y = part.vertices[:, 0], part.vertices[:, 1]
    ridge = high * MM * ((np.abs(y) < 0.5 * MM) & (np.abs(x) < 8.0 * MM))
    marked = Mesh(part.vertices + ridge[:, None] * [0.0, 0.0, 1.0], part.faces)
    pipeline.load(_write_with_tolerance(tmp_path, "auto", part))
    (issue,) = expect_refusal(_write_with_tolerance(tmp_path, "auto", marked))
    assert issue.code == "part.mesh_tolerance"
    assert ("ridge" if high > 0.0 else "groove") in issue.message
    assert issue.hint is not None
    stated = float(issue.hint.rsplit("tolerance_mm: ", 1)[1])
    assert stated == pytest.approx(issue.value, abs=0.011)
    pipeline.load(_write_with_tolerance(tmp_path, stated, marked))


def test_a_part_that_is_all_noise_is_refused(tmp_path: Path) -> None:
    part = _scan(0.0)
    shallow = _noisy(1e-4)(Mesh(part.vertices * [1.0, 1.0, 0.15], part.faces))
    (issue,) = expect_refusal(small_forming.write(tmp_path, small_forming.problem(), shallow))
    assert issue.code == "part.mesh_tolerance"
    assert "fifth of the depth" in issue.message


def test_faces_given_twice_and_a_soup_of_triangles_are_one_part(tmp_path: Path) -> None:
    part = small_forming.dish()
    twice = Mesh(part.vertices, np.concatenate([part.faces, part.faces[:200]]))
    soup = Mesh(part.vertices[part.faces].reshape(-1, 3), np.arange(part.faces.size).reshape(-1, 3))
    whole = formed_mesh(load(tmp_path))
    for flawed in (twice, soup):
        problem = pipeline.load(small_forming.write(tmp_path, small_forming.problem(), flawed))
        assert len(formed_mesh(problem).faces) == len(whole.faces)


def test_walls_that_lean_over_are_told_as_that_and_not_as_faces_that_look_to_different_sides(
    tmp_path: Path,
) -> None:
    result = pipeline.load(
        small_forming.write(tmp_path, small_forming.problem(), _leaning(small_forming.dish()))
    )
    errors = [issue for issue in pipeline.check(result) if issue.severity is Severity.ERROR]
    assert [issue.code for issue in errors] == ["forming.undercut"]


@pytest.mark.parametrize(
    ("clamp", "border"),
    [
        ({}, 0.0),
        ({"border": "sliding"}, 0.0),
        ({"border": "immovable"}, np.inf),
        ({"border": "spring", "spring_n_mm2": 40.0}, 40e6),
    ],
)
def test_what_the_clamp_does_in_plane(tmp_path: Path, clamp: dict[str, object], border: float) -> None:
    """40 N/mm for each mm are 40 000 N/m for each mm, 40e6 N/m for each m."""
    made = load(tmp_path, sheet__clamp=clamp).stock.sheet
    assert made is not None
    assert made.border == pytest.approx(border)
