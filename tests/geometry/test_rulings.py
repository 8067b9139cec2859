"""Rows of rulings against closed forms: cylinders, cones and the hyperbolic paraboloid."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from planner.geometry.arrays import RuledSurface
from planner.geometry.rulings import (
    outward_normals,
    outward_sides,
    resample,
    ruling_points,
    smooth_pieces,
    tessellate,
)


def smooth(count: int) -> np.ndarray:
    return np.zeros(count, dtype=bool)


def cylinder(radius: float = 0.05, count: int = 2000, height: float = 0.1) -> RuledSurface:
    angle = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    ring = radius * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    return RuledSurface("skin", ring, ring + np.array([0.0, 0.0, height]), smooth(count), closed=True)


def square() -> RuledSurface:
    """A square column of side 0.1 m, 25 rulings a side, starting in the middle of a side."""
    corner = 0.05 * np.array([[1, -1, 0], [1, 1, 0], [-1, 1, 0], [-1, -1, 0]])
    fraction = np.linspace(0.0, 1.0, 25)[:-1, None]
    ring = np.concatenate(
        [(1 - fraction) * a + fraction * b for a, b in zip(corner, np.roll(corner, -1, 0), strict=True)]
    )
    edge = np.arange(96) % 24 == 0
    ring = np.roll(ring, 12, 0)
    return RuledSurface("skin", ring, ring + np.array([0, 0, 0.2]), np.roll(edge, 12), True)


def test_normals_of_a_cylinder_point_out_of_it() -> None:
    skin = cylinder(count=90)
    start, end = outward_normals(skin)
    np.testing.assert_allclose(start, skin.start / 0.05, atol=1e-12)
    np.testing.assert_allclose(end, start, atol=1e-12)


def test_normals_at_the_ends_of_an_open_arc_are_those_of_the_circle() -> None:
    whole = cylinder(count=360)
    arc = RuledSurface("arc", whole.start[:40], whole.end[:40], smooth(40))
    start, _ = outward_normals(arc)
    assert np.abs(start - arc.start / 0.05).max() < 2e-4  # a chord's direction would be off by 9e-3


def test_a_cone_has_the_same_normal_at_its_tip_and_its_rim() -> None:
    rim = cylinder(count=180)
    tip = np.tile([0.0, 0.0, 0.1], (180, 1))
    for skin in (
        RuledSurface("c", rim.start, tip, smooth(180), True),
        RuledSurface("c", tip, rim.start[::-1], smooth(180), True),
    ):
        start, end = outward_normals(skin)
        across = (skin.start + skin.end)[:, :2] * 20.0
        expected = np.concatenate([across * 2.0, np.ones((180, 1))], axis=1) / np.sqrt(5.0)
        np.testing.assert_allclose(start, expected, atol=1e-9)
        np.testing.assert_allclose(end, expected, atol=1e-9)


def test_corners_have_a_normal_on_each_side_and_one_between() -> None:
    box = square()
    before, after = outward_sides(box)
    first = int(np.flatnonzero(box.corner)[0])
    np.testing.assert_allclose(box.start[first], [0.05, -0.05, 0.0], atol=1e-12)
    np.testing.assert_allclose(before[first, 0], [0, -1, 0], atol=1e-12)
    np.testing.assert_allclose(after[first, 0], [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(outward_normals(box)[1][first], np.array([1, -1, 0]) / np.sqrt(2), atol=1e-12)
    rest = ~box.corner
    np.testing.assert_array_equal(before[rest], after[rest])


def test_pieces_between_corners_share_their_ends() -> None:
    pieces = smooth_pieces(square())
    assert [len(p) for p in pieces] == [25] * 4
    assert [p[0] for p in pieces[1:]] + [pieces[0][0]] == [p[-1] for p in pieces]
    (ring,) = smooth_pieces(cylinder(count=10))
    np.testing.assert_array_equal(ring, [*range(10), 0])
    open_square = RuledSurface("s", square().start, square().end, square().corner)
    assert [len(p) for p in smooth_pieces(open_square)] == [13, 25, 25, 25, 12]


@pytest.mark.parametrize("chord", [1e-5, 1e-4])
def test_a_thinned_cylinder_keeps_its_chord_tolerance_with_few_rulings(chord: float) -> None:
    skin = resample(cylinder(), chord, 1.0)
    ideal = np.pi / np.arccos(1.0 - chord / 0.05)  # sagitta r (1 - cos(a / 2))
    assert ideal <= len(skin.start) <= 1.1 * ideal + 1
    middle = 0.5 * (skin.start + np.roll(skin.start, -1, 0))
    assert 0.05 - np.linalg.norm(middle[:, :2], axis=1).min() <= 1.05 * chord + 1e-7
    assert skin.closed


def test_thinning_keeps_corners_and_steps() -> None:
    box = resample(square(), 1e-5, 0.03)
    assert len(box.start) == 16  # four steps of 25 mm a side
    np.testing.assert_allclose(np.abs(box.start[box.corner][:, :2]), 0.05, atol=1e-15)
    assert box.corner.sum() == 4
    assert len(resample(square(), 1e-5, 1.0).start) == 4
    flat = resample(RuledSurface("s", square().start, square().end, square().corner), 1e-5, 1.0)
    assert not flat.closed
    assert len(flat.start) == 6
    np.testing.assert_array_equal(flat.corner, [False, True, True, True, True, False])


def test_thickening_stays_on_the_given_patches() -> None:
    hypar = RuledSurface(
        "h", np.array([[0, 0, 0], [0, 1, 0.5]]), np.array([[1, 0, 0.5], [1, 1, 0.0]]), smooth(2)
    )
    dense = resample(hypar, 1e-4, 0.05)
    assert len(dense.start) == 24  # sides of 1.118 m in steps of 50 mm
    sight = ruling_points(dense, np.linspace(0, 1, 7)).reshape(-1, 3)
    x, y, z = sight.T
    np.testing.assert_allclose(z, 0.5 * (x + y) - x * y, atol=1e-12)


def test_triangles_of_a_twisted_patch_follow_it_and_face_outwards() -> None:
    hypar = resample(
        RuledSurface(
            "h", np.array([[0, 0, 0], [0, 0.1, 0.05]]), np.array([[0.1, 0, 0.05], [0.1, 0.1, 0.0]]), smooth(2)
        ),
        1e-4,
        0.005,
    )
    mesh = tessellate(hypar, 1e-5)
    body = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    x, y, z = body.triangles_center.T
    assert np.abs(z - (0.5 * (x + y) - 10 * x * y)).max() < 1e-5
    assert (body.face_normals[:, 2] < 0).all()  # tangent y, rulings along x


def test_triangles_of_a_closed_skin_have_the_area_of_the_cylinder() -> None:
    mesh = tessellate(cylinder(count=720))
    body = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert body.area == pytest.approx(2 * np.pi * 0.05 * 0.1, rel=1e-4)
    assert (np.sum(body.face_normals * body.triangles_center, axis=1) > 0).all()
    cone = RuledSurface("c", cylinder(count=72).start, np.tile([0, 0, 0.1], (72, 1)), smooth(72), True)
    mesh = tessellate(cone)
    areas = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).area_faces
    assert (areas > 0).all()
    assert areas.sum() == pytest.approx(np.pi * 0.05 * np.hypot(0.05, 0.1), rel=2e-3)


def test_a_tolerance_of_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match="above 0"):
        resample(cylinder(count=10), 0.0, 1.0)
