"""Meshes of rings: they cover the sheet once, kinks lie on mesh lines, load points are nodes.

Counts are kept.
"""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from scipy.spatial import Delaunay

from planner.geometry.arrays import FloatArray, IntArray, lengths
from planner.geometry.mesh_repair import border_edges
from planner.shell.bisection import bisect
from planner.shell.contours import _corners
from planner.shell.mesh import FLANGE, FLOOR, WALL, ShellMesh, Wall, cone_rings, mesh_sheet, mesh_walls
from tests.shell.sheets import WINDOW


def rounded_square(half: float, radius: float, z: float) -> FloatArray:
    """A contour (k, 3); of radius 0: four points."""
    count = 12 if radius else 1
    turn = (np.arange(4)[:, None] + np.linspace(0.0, 1.0, count)).reshape(-1) * 0.5 * np.pi
    sign = np.repeat([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]], count, axis=0)
    plan = (half - radius) * sign + radius * np.column_stack([np.cos(turn), np.sin(turn)])
    return np.column_stack([plan, np.full(len(plan), z)])


def heart(inwards: float, z: float) -> FloatArray:
    """A heart, offset inwards as paths do: a notch that becomes an arc, a tip that stays one."""
    t = np.linspace(0.0, 2.0 * np.pi, 300, endpoint=False)
    y = 13.0 * np.cos(t) - 5.0 * np.cos(2.0 * t) - 2.0 * np.cos(3.0 * t) - np.cos(4.0 * t)
    shape = shapely.Polygon(3.5e-3 * np.column_stack([16.0 * np.sin(t) ** 3, y])).buffer(-inwards)
    plan = np.array(shape.exterior.coords[:-1])
    return np.column_stack([plan, np.full(len(plan), z)])


PARTS = {
    "cone": cone_rings(0.05, np.radians(45.0), 0.02),
    "cone, two angles": [
        *cone_rings(0.06, np.radians(30.0), 0.01),
        cone_rings(0.06, np.radians(45.0), 0.03)[1],
    ],
    "rounded pyramid": [rounded_square(0.04, 0.01, 0.0), rounded_square(0.025, 0.004, -0.02)],
    "sharp pyramid": [rounded_square(0.04, 0.0, 0.0), rounded_square(0.02, 0.0, -0.02)],
    "dense contours": [rounded_square(0.04 - 1e-4 * k, 0.01 - 5e-5 * k, -1e-4 * k) for k in range(150)],
    "heart": [heart(5e-4 * k, -5e-4 * k) for k in range(30)],
    "flat": [],
}


def normals(mesh: ShellMesh) -> FloatArray:
    """Twice the area of each triangle along its normal (m, 3) [m^2]."""
    corners = mesh.nodes[mesh.triangles]
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


@pytest.mark.parametrize("name", PARTS)
def test_a_mesh_covers_the_window_once(name: str) -> None:
    mesh = mesh_sheet(PARTS[name], WINDOW, 3000)
    assert 0.85 * 3000 < len(mesh.triangles) <= 3000
    across = normals(mesh)
    assert across[:, 2].min() > 0.0
    assert 0.5 * across[:, 2].sum() == pytest.approx(0.25**2, rel=1e-9)
    rim = border_edges(mesh.triangles)
    assert np.allclose(np.abs(mesh.nodes[rim, :2]).max(axis=2), 0.125)
    assert lengths(mesh.nodes[rim[:, 1]] - mesh.nodes[rim[:, 0]]).sum() == pytest.approx(1.0, rel=1e-9)
    assert set(np.unique(mesh.triangles)) == set(range(len(mesh.nodes)))


@pytest.mark.parametrize(
    "name", ["cone", "cone, two angles", "rounded pyramid", "sharp pyramid", "dense contours"]
)
def test_no_triangle_lies_across_a_kink(name: str) -> None:
    """Heights of a triangle's corners lie between those of two kinks, and zones say between which."""
    rings = PARTS[name]
    mesh = mesh_sheet(rings, WINDOW, 2000)
    kinks = sorted({0.0, rings[-1][0, 2]} | ({-0.01} if name == "cone, two angles" else set()))
    z = mesh.nodes[mesh.triangles][:, :, 2]
    low, high = z.min(axis=1), z.max(axis=1)
    for kink in kinks:
        assert not np.any((low < kink - 1e-9) & (high > kink + 1e-9))
    assert np.array_equal(mesh.zone == WALL, high - low > 1e-9)
    assert np.all(high[mesh.zone == FLOOR] < kinks[0] + 1e-9)
    assert np.all(low[mesh.zone == FLANGE] > -1e-9)


def test_sharp_corners_are_mesh_lines() -> None:
    """Each wall of the pyramid is flat: its triangles have one of four normals."""
    mesh = mesh_sheet(PARTS["sharp pyramid"], WINDOW, 1500)
    wall = normals(mesh)[mesh.zone == WALL]
    wall /= lengths(wall)[:, None]
    known = np.array([[1.0, 0.0, 1.0], [-1.0, 0.0, 1.0], [0.0, 1.0, 1.0], [0.0, -1.0, 1.0]]) / np.sqrt(2.0)
    assert np.abs(wall @ known.T).max(axis=1).min() > 1.0 - 1e-9


def test_places_are_nodes_and_elements_grow_outwards() -> None:
    places = np.array([[0.0, 0.03], [0.03 * np.cos(0.3), 0.03 * np.sin(0.3)], [0.011, -0.004], [0.08, 0.02]])
    mesh = mesh_sheet(PARTS["cone"], WINDOW, 2000, places)
    deviation = lengths(mesh.nodes[:, None, :2] - places).min(axis=0)
    assert deviation.max() < 5e-6  # chords of the 360 points that the ring has
    area = 0.5 * lengths(normals(mesh))
    assert area[mesh.zone == FLANGE].max() > 5.0 * np.median(area[mesh.zone == FLOOR])


@pytest.mark.parametrize("name", ["cone", "sharp pyramid", "dense contours"])
def test_elements_are_small_about_a_place_and_walls_keep_their_shape(name: str) -> None:
    """Beside a rim, on a wall's corner or on a floor: of 2 mm there, and nodes of
    walls are on their contours."""
    rings = PARTS[name]
    places = np.array([rings[0][0, :2] + [0.002, 0.0], rings[-1][0, :2], [0.003, -0.004]])
    mesh = mesh_sheet(rings, WINDOW, 2500, places, 2e-3)
    assert len(mesh.triangles) <= 2500
    across = normals(mesh)
    assert across[:, 2].min() > 0.0
    assert 0.5 * across[:, 2].sum() == pytest.approx(0.25**2, rel=1e-9)
    sides = lengths(mesh.nodes[mesh.triangles] - mesh.nodes[np.roll(mesh.triangles, 1, axis=1)])
    middle = mesh.nodes[mesh.triangles].mean(axis=1)[:, :2]
    near = lengths(middle[:, None] - places).min(axis=1) < 2e-3
    assert near.sum() > 3 * len(places)
    assert sides[near].max() < 2.6e-3
    wall = mesh.nodes[np.unique(mesh.triangles[mesh.zone == WALL])]
    if name == "cone":
        assert lengths(wall[:, :2]) == pytest.approx(0.05 + wall[:, 2], abs=1e-5)
    else:
        flat = [np.abs(wall[:, k]) for k in (0, 1)]
        assert np.maximum(*flat).max() <= 0.04 + 1e-9


def test_edges_are_cut_until_none_is_too_long_and_no_angle_is_halved() -> None:
    """Of random triangles in a square: they cover it once, edges meet at their ends alone, angles stay."""
    random = np.random.default_rng(2026)
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    nodes = np.column_stack([np.concatenate([corners, random.random((60, 2))]), np.zeros(64)])
    before = np.asarray(Delaunay(nodes[:, :2]).simplices, dtype=np.int64)

    def size_at(points: FloatArray) -> FloatArray:
        return 0.02 + 0.3 * lengths(points[:, :2] - [0.3, 0.7])

    def middle(first: FloatArray, second: FloatArray, adjacent: IntArray) -> FloatArray:
        for column in (0, 1):  # ends are of the triangle that is named
            low, high = (
                nodes[before[adjacent[:, column]]].min(axis=1),
                nodes[before[adjacent[:, column]]].max(axis=1),
            )
            assert np.all((first >= low - 1e-12) & (first <= high + 1e-12))
        return 0.5 * (first + second)

    def angles(points: FloatArray, triangles: IntArray) -> FloatArray:
        a, b, c = (points[np.roll(triangles, -k, axis=1)] for k in range(3))
        cosine = np.sum((b - a) * (c - a), axis=2) / (lengths(b - a) * lengths(c - a))
        return np.arccos(np.clip(cosine, -1.0, 1.0)).min(axis=1)

    points, triangles, owner = bisect(nodes, before, size_at, middle)
    assert np.array_equal(points[: len(nodes)], nodes)
    edges = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2), axis=2).reshape(-1, 2)
    shared = np.unique(edges, axis=0, return_counts=True)[1]
    assert set(shared) == {1, 2}
    rim = border_edges(triangles)
    assert lengths(points[rim[:, 1]] - points[rim[:, 0]]).sum() == pytest.approx(4.0)
    cross = np.cross(
        points[triangles][:, 1] - points[triangles][:, 0], points[triangles][:, 2] - points[triangles][:, 0]
    )
    assert 0.5 * np.abs(cross[:, 2]).sum() == pytest.approx(1.0)
    long = lengths(points[triangles] - points[np.roll(triangles, 1, axis=1)]).max(axis=1)
    assert np.all(long <= size_at(points[triangles].mean(axis=1)))
    assert np.all(angles(points, triangles) >= 0.5 * angles(nodes, before)[owner] - 1e-9)


def test_round_rims_have_rows_by_their_turn() -> None:
    """Of a rim rounded by 10 mm, 45 degrees in 7.9 mm, 800 elements keep the shape within 0.15 mm."""
    turn = np.linspace(0.0, 0.25 * np.pi, 20)
    radius, z = 0.05 - 0.01 * np.sin(turn), 0.01 * (np.cos(turn) - 1.0)
    rings = [cone_rings(r, 0.5, 0.001)[0] + [0.0, 0.0, h] for r, h in zip(radius, z, strict=True)]
    mesh = mesh_sheet(rings, WINDOW, 800)
    edges = mesh.triangles[mesh.zone == WALL]
    middle = 0.5 * (mesh.nodes[edges] + mesh.nodes[np.roll(edges, 1, axis=1)])
    middle = middle[np.abs(np.ptp(mesh.nodes[edges][:, :, 2], axis=1)) > 0.0].reshape(-1, 3)
    true = np.interp(lengths(middle[:, :2]), radius[::-1], z[::-1])
    assert np.abs(middle[:, 2] - true).max() < 1.5e-4


def test_what_cannot_be_meshed_is_refused() -> None:
    top, low = PARTS["cone"]
    for rings, expected_text in (
        ([low, top], "inside"),
        ([1.0 * top, low + np.array([0.04, 0.0, 0.0])], "inside"),
        ([3.0 * top, low], "window"),
        ([top + np.outer(np.arange(len(top)), [0.0, 0.0, 1e-5]), low], "heights differ"),
    ):
        with pytest.raises(ValueError, match=expected_text):
            mesh_sheet(rings, WINDOW, 1000)
    with pytest.raises(ValueError, match="allow about"):
        mesh_sheet(PARTS["cone"], WINDOW, 40)
    with pytest.raises(ValueError, match="add a contour through it"):
        mesh_sheet(PARTS["cone"], WINDOW, 1000, np.array([[0.04, 0.0]]))
    with pytest.raises(ValueError, match="tip"):
        cone_rings(0.05, np.radians(45.0), 0.06)


@pytest.mark.parametrize("sides", [24, 25, 40])
def test_a_small_circle_of_few_points_has_no_corners_and_no_folds(sides: int) -> None:
    """The last contours of a dome of 18 mm that rises 4.5 mm, as a coarse mesh of the part has them."""
    rings = []
    for z in np.linspace(0.0, -4e-3, 9):
        radius = np.sqrt(0.018**2 * (1.0 + z / 4.5e-3))
        turn = 2.0 * np.pi * np.arange(sides) / sides + 0.3 * z
        # pairs of points near each other, where contours pass the corners of facets
        turn = np.sort(np.concatenate([turn, turn + 0.03]))
        rings.append(np.column_stack([radius * np.cos(turn), radius * np.sin(turn), np.full(len(turn), z)]))
    assert all(len(_corners(ring)) == 0 for ring in rings)
    for triangles in (800, 1600, 4000):
        assert normals(mesh_sheet(rings, WINDOW, triangles))[:, 2].min() > 0.0


def test_walls_side_by_side_and_on_floors_are_meshed_as_one_sheet() -> None:
    """The plan's area is that of the clamp's, a circle of 72 sides; each floor has its own height."""
    turn = np.linspace(0.0, 2.0 * np.pi, 72, endpoint=False)
    outline = 0.1 * np.column_stack([np.cos(turn), np.sin(turn)])

    def wall_contours(x: float, top: float, depth: float, flat: float = 0.0) -> list[FloatArray]:
        return [np.add(ring, [x, 0.0, flat]) for ring in cone_rings(top, np.radians(45.0), depth, 60)]

    inner = Wall(wall_contours(-0.045, 0.012, 0.005, -0.01))
    walls = [Wall(wall_contours(-0.045, 0.035, 0.010), [inner]), Wall(wall_contours(0.040, 0.030, 0.015))]
    places = np.array([[-0.038, 0.0], [0.055, 0.0], [0.0, 0.08], [-0.03, 0.012]])
    made = mesh_walls(walls, outline, 3000, places)
    corners = made.nodes[made.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert normal[:, 2].min() > 0.0
    assert 0.5 * normal[:, 2].sum() == pytest.approx(0.5 * 72 * 0.01 * np.sin(2.0 * np.pi / 72))
    assert len(made.triangles) <= 3000
    level = np.ptp(corners[:, :, 2], axis=1) < 1e-12
    assert set(np.round(corners[level][:, 0, 2], 6)) == {0.0, -0.010, -0.015}
    for candidate in places:
        assert np.linalg.norm(made.nodes[:, :2] - candidate, axis=1).min() < 2e-4


def test_walls_that_touch_or_stand_in_the_air_are_refused() -> None:
    outline = 0.1 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    ring = cone_rings(0.030, np.radians(45.0), 0.010, 60)
    beside = [np.add(each, [0.050, 0.0, 0.0]) for each in ring]
    with pytest.raises(ValueError, match="not inside"):
        mesh_walls([Wall(ring), Wall(beside)], outline, 3000)
    above = [each * [0.3, 0.3, 1.0] for each in ring]
    with pytest.raises(ValueError, match="in height"):
        mesh_walls([Wall(ring, [Wall(above)])], outline, 3000)
    with pytest.raises(ValueError, match="outline"):
        mesh_walls([Wall(ring)], outline, 3000, np.array([[0.2, 0.0]]))
