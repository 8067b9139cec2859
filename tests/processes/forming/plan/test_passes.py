"""Passes over features: surfaces alone, shapes between, thickness and angle maps, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from planner.geometry.arrays import FloatArray, Mesh
from planner.geometry.mesh import TriangleMesh, check_surface, face_areas, face_normals
from planner.issues import Severity, TandemError
from planner.processes.forming.plan.contact import FormingPass
from planner.processes.forming.plan.features.pass_shape import add_flat_ring
from planner.processes.forming.plan.features.tree import virgin_sheet_order
from planner.processes.forming.plan.passes import make_passes, pass_angles, pass_issues
from planner.processes.forming.plan.sheet_mechanics import (
    face_by_corner,
    thickness_map,
    thinnest_point,
    wall_angle,
    wall_angle_map,
)
from tests.processes.forming.plan import nests
from tests.processes.forming.plan.shapes import (
    METAL,
    T0,
    bowl,
    cone,
    operation,
    pit,
    plan_passes,
    revolved,
    star,
    tree_of,
    upside_down,
)


def check_surface_of(forming_pass: FormingPass) -> None:
    """A surface in one piece with its normals up, whose rim is flat."""
    mesh = TriangleMesh(forming_pass.vertices, forming_pass.faces)
    assert not [issue for issue in check_surface(mesh, "pass") if issue.code != "mesh.closed"]
    assert face_normals(mesh)[:, 2].min() >= 0.0


def test_a_cone_is_one_pass_on_the_face_that_the_tool_touches() -> None:
    (down,) = plan_passes(cone(60.0, 0.05, 0.1))
    assert (down.name, down.side, down.number) == ("f1", 1, 1)
    assert down.start == pytest.approx(T0) and down.end == pytest.approx(T0 - 0.05)
    (up,) = plan_passes(upside_down(cone(60.0, 0.05, 0.1)))
    assert up.side == -1
    assert up.start == pytest.approx(0.0) and up.end == pytest.approx(0.05)
    for one in (down, up):
        check_surface_of(one)
        assert np.rad2deg(wall_angle(one.vertices, one.faces)) == pytest.approx(60.0, abs=0.05)
        # the ring of flat is there on all sides
        assert np.hypot(*one.vertices[:, :2].T).max() > 0.1 + 0.02
        wall = face_by_corner(one, T0)[2]
        assert wall.min() == pytest.approx(T0 * np.cos(np.radians(60.0)), rel=2e-3)
        assert wall.max() == pytest.approx(T0)


def test_thickness_of_a_bowl_follows_the_sine_law_everywhere() -> None:
    mesh = bowl(0.05, 60.0)
    (forming_pass,) = plan_passes(mesh)
    r = np.hypot(*forming_pass.vertices[:, :2].T)
    inner = r < 0.05 * np.sin(np.radians(58.0))
    expected = T0 * np.sqrt(1.0 - (r[inner] / 0.05) ** 2)  # cos of the slope of a sphere
    assert np.abs(forming_pass.thickness[inner] - expected).max() < 0.01 * T0
    angle = wall_angle_map(forming_pass.vertices, forming_pass.faces)[inner]
    assert np.abs(angle - np.arcsin(r[inner] / 0.05)).max() < np.radians(1.0)
    least = thinnest_point(mesh.vertices, mesh.faces, T0)
    assert least.thickness == pytest.approx(T0 * np.cos(np.radians(60.0)), rel=0.03)
    assert np.hypot(*least.point[:2]) == pytest.approx(0.05 * np.sin(np.radians(60.0)), abs=1e-3)
    assert np.rad2deg(least.angle) == pytest.approx(60.0, abs=1.5)


def samples(forming_pass: FormingPass, count: int = 6) -> FloatArray:
    """Random places (S, 3) of a face, and its vertices."""
    weights = np.random.default_rng(1).dirichlet(np.ones(3), (count, len(forming_pass.faces)))
    inner = np.einsum("sfk,fkd->sfd", weights, forming_pass.vertices[forming_pass.faces]).reshape(-1, 3)
    return np.concatenate([inner, forming_pass.vertices])


def pyramid_depth(points: FloatArray, angle: float) -> FloatArray:
    """Of a square pyramid of half side 50 mm, 50 mm deep: the distance from the side times tan."""
    away = 0.05 - np.abs(points[:, :2]).max(axis=1)
    return np.clip(away * np.tan(np.radians(angle)), 0.0, 0.05)


@pytest.mark.parametrize("turn", [1, -1])
def test_a_steep_pyramid_takes_a_shape_between(turn: int) -> None:
    part = pit(shapely.box(-0.05, -0.05, 0.05, 0.05), 75.0, 0.05)
    between, last = plan_passes(part if turn > 0 else upside_down(part))
    assert (between.name, last.name) == ("f1_p1", "f1_p2")
    assert np.rad2deg(wall_angle(between.vertices, between.faces)) == pytest.approx(60.0, abs=0.2)
    assert np.rad2deg(wall_angle(last.vertices, last.faces)) == pytest.approx(75.0, abs=0.1)
    for one, angle in ((between, 60.0), (last, 75.0)):
        check_surface_of(one)
        places = samples(one)
        depth = turn * (one.start - places[:, 2])
        assert np.abs(depth - pyramid_depth(places, angle)).max() < 2e-5
    # only onward: nowhere deeper than the part
    places = samples(between)
    assert np.all(turn * (between.start - places[:, 2]) <= pyramid_depth(places, 75.0) + 1e-6)
    # the wall is as the sine law of one pass says, and the floor where the first wall stood stays thin
    wall = face_by_corner(last, T0)[2]
    assert wall.min() == pytest.approx(T0 * np.cos(np.radians(75.0)), rel=1e-3)


def test_sheet_once_thinned_stays_thin() -> None:
    # rings on the floor: within 28.9 mm of the outline stood the first wall of 60 deg
    rings = [(0.07, 0.0), (0.05, 0.0), *((0.0365 - 0.0025 * k, -0.05) for k in range(14)), (0.0, -0.05)]
    between, last = plan_passes(revolved(rings), "spif")
    assert np.rad2deg(wall_angle(between.vertices, between.faces)) == pytest.approx(59.9, abs=0.3)
    r = np.hypot(*last.vertices[:, :2].T)
    floor = (last.vertices[:, 2] < T0 - 0.0499) & (r < 0.036)
    held = 0.05 - 0.05 / np.tan(wall_angle(between.vertices, between.faces))
    before, after = floor & (r > held + 1e-3), floor & (r < held - 1e-3)
    assert before.sum() > 100 and after.sum() > 100
    assert np.allclose(last.thickness[before], T0 * 0.5, rtol=0.01)
    assert np.allclose(last.thickness[after], T0, rtol=1e-6)


def test_shapes_between_of_a_star_are_no_steeper_and_nowhere_deeper() -> None:
    outline, part = star(0.1, 0.06), pit(star(0.1, 0.06), 75.0, 0.03)
    between, last = plan_passes(part, "spif")
    check_surface_of(between)
    assert np.rad2deg(wall_angle(between.vertices, between.faces)) <= 60.2
    places = samples(between)
    away = shapely.distance(outline.exterior, shapely.points(places[:, :2]))
    inside = shapely.contains_xy(outline, places[:, 0], places[:, 1])
    limit = np.where(inside, np.minimum(away * np.tan(np.radians(60.0)), 0.03), 0.0)
    assert np.abs(between.start - places[:, 2] - limit).max() < 1e-4
    assert last.end == pytest.approx(T0 - 0.03)


def test_features_stand_alone_at_their_level() -> None:
    # a dish with a dome standing in it
    dome = 0.012
    rings = [(0.1, 0.0), (0.08, 0.0), (0.06, -0.03), (0.02, -0.03), (0.01, -0.03 + dome), (0.0, -0.03 + dome)]
    tree, order = tree_of(revolved(rings))
    dish, inner = make_passes(tree, order, revolved(rings), T0, operation(), METAL)
    assert (dish.side, inner.side) == (1, -1)
    assert dish.vertices[:, 2].min() == pytest.approx(T0 - 0.03)
    assert np.allclose(dish.vertices[np.hypot(*dish.vertices[:, :2].T) < 0.055, 2], T0 - 0.03)
    assert inner.start == pytest.approx(-0.03) and inner.end == pytest.approx(-0.03 + dome)
    # first on the virgin sheet: from its level
    inner, dish = make_passes(tree, virgin_sheet_order(tree), revolved(rings), T0, operation(), METAL)
    assert inner.start == pytest.approx(0.0) and inner.end == pytest.approx(dome)
    assert dish.start == pytest.approx(T0)
    for one in (dish, inner):
        check_surface_of(one)


def test_a_noisy_mesh_makes_sound_passes() -> None:
    shape = nests.sheet(
        lambda x, y: -nests.frustum(x, y, (0.0, 0.0), 0.06, 0.02, 50.0) + 0.0, 0.09, 2e-3, seed=4, noise=5e-6
    )
    (forming_pass,) = plan_passes(shape)
    check_surface_of(forming_pass)
    assert np.rad2deg(wall_angle(forming_pass.vertices, forming_pass.faces)) == pytest.approx(50.0, abs=1.5)


def test_angles_of_passes() -> None:
    def angles(wall: float, mode: str = "spif", **more: object) -> list[float]:
        return [
            round(float(np.rad2deg(a)), 6)
            for a in pass_angles(np.radians(wall), operation(mode, **more), METAL)
        ]

    assert angles(60.0) == [60.0]
    assert angles(75.0) == [60.0, 75.0]
    assert angles(85.0) == [55.0, 70.0, 85.0]
    assert angles(72.0, "dsif") == [72.0]  # with a tool opposite one pass is enough
    assert angles(72.0, "dpif_p") == [57.0, 72.0]  # at the border there is none opposite
    assert angles(85.0, angle_step_deg=10.0) == [65.0, 75.0, 85.0]
    assert angles(75.0, passes=[40, 65]) == [40.0, 65.0, 75.0]
    assert angles(75.0, passes=[90]) == [75.0]


def test_repeats_run_each_pass_again() -> None:
    found = plan_passes(cone(60.0, 0.02, 0.05), repeats=2)
    assert [one.name for one in found] == ["f1_p1", "f1_p2"]
    assert found[0].vertices is found[1].vertices


def test_an_upright_wall_is_refused_with_the_reason() -> None:
    part = pit(shapely.box(-0.05, -0.05, 0.05, 0.05), 89.9, 0.05)
    with pytest.raises(TandemError) as caught:
        plan_passes(part)
    (issue,) = caught.value.issues
    assert issue.code == "forming.wall_angle" and issue.severity is Severity.ERROR
    assert issue.value == pytest.approx(89.9, abs=0.05)
    assert "sine law" in issue.message


def test_a_pass_forced_too_steep_is_warned_of() -> None:
    part = pit(shapely.box(-0.05, -0.05, 0.05, 0.05), 75.0, 0.05)

    def codes(mode: str, **more: object) -> list[str]:
        found = plan_passes(part, mode, **more)
        issues = pass_issues(found, T0, operation(mode, **more), METAL)
        assert all(issue.severity is Severity.WARNING for issue in issues)
        return [issue.code for issue in issues]

    assert codes("spif", passes=[75]).count("forming.wall_angle") == 1
    assert "forming.wall_angle" not in codes("spif")


def test_a_part_like_one_that_failed_is_warned_of() -> None:
    found = plan_passes(cone(60.0, 0.165, 0.2))
    assert [issue.code for issue in pass_issues(found, T0, operation(), METAL)] == ["forming.trial"]


def test_passes_of_a_large_cone_take_little_time() -> None:
    mesh = cone(75.0, 0.165, 0.2, 200)
    found = plan_passes(mesh, "spif")
    assert len(found) == 2


def test_the_ring_fills_holes_of_a_mesh_with_flat() -> None:
    whole = cone(45.0, 0.01, 0.05)
    rim = np.hypot(*whole.vertices[:, :2].T) > 0.04 - 1e-9
    part = Mesh(whole.vertices * np.array([1.0, 1.0, 0.0]), whole.faces[rim[whole.faces].all(axis=1)])
    filled = add_flat_ring(part, 0.0)
    area = face_areas(TriangleMesh(filled.vertices, filled.faces)).sum()
    outer = 0.5 * 120 * np.sin(2 * np.pi / 120) * 0.07**2
    assert area > outer and np.all(filled.vertices[:, 2] == 0.0)
    assert check_surface(TriangleMesh(filled.vertices, filled.faces), "x") == []
    assert thickness_map(filled.vertices, filled.faces, T0) == pytest.approx(T0)
