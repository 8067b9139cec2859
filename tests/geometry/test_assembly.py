"""The assembly order of bodies and their directions of insertion.

The references are directions on a grid, closed forms and bodies that are locked by construction.
"""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy.optimize import nnls

from planner.geometry.assembly import (
    CONTACT_TOLERANCE_M,
    NONE,
    Slab,
    assemble,
    assembly_rows,
    bodies_beyond,
    middle_direction,
    obstruction_depth,
    outline_faces,
)

UP = np.array([0.0, 0.0, 1.0])


def box(low: tuple[float, ...], high: tuple[float, ...]) -> np.ndarray:
    return np.asarray(trimesh.creation.box(bounds=[low, high]).triangles)


def slab(ring: np.ndarray, leans: np.ndarray, beyond: list[int], thick: float = 0.2) -> Slab:
    """A prism over a convex outline, whose side i leans outwards to the front by an angle."""
    along = np.roll(ring, -1, axis=0) - ring
    out = np.stack([along[:, 1], -along[:, 0]], axis=1) / np.linalg.norm(along, axis=1, keepdims=True)
    corners = []
    for z in (-0.5 * thick, 0.5 * thick):
        off = (out * ring).sum(axis=1) + z * np.tan(leans)
        before = np.roll(np.arange(len(ring)), 1)
        at = [np.linalg.solve(out[[i, k]], off[[i, k]]) for i, k in enumerate(before)]
        corners.append(np.insert(np.array(at), 2, z, axis=1))
    return Slab(corners[1], corners[0], outline_faces(ring), np.arange(len(ring)), np.array(beyond))


@pytest.mark.parametrize("count", [1, 2, 3, 5, 30])
def test_the_middle_way_is_the_farthest_from_all_sides_there_is(count: int) -> None:
    rng = np.random.default_rng(count)
    for spread in (0.3, 0.8, 3.0):
        normals = rng.normal(size=(count, 3)) * spread + [0.0, 0.0, -1.0]
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        way, margin = middle_direction(normals)
        assert np.linalg.norm(way) == pytest.approx(1.0)
        assert -(normals @ way).max() == pytest.approx(margin, abs=1e-12)
        many = rng.normal(size=(40000, 3))
        many /= np.linalg.norm(many, axis=1, keepdims=True)
        assert (-(many @ normals.T).max(axis=1)).max() <= margin + 1e-12
        if margin > 0.0:  # then it is how far the hull of the normals is from the origin
            heavy = np.concatenate([normals.T, np.full((1, count), 1e4)])
            fraction = nnls(heavy, np.array([0.0, 0.0, 0.0, 1e4]))[0]
            assert np.linalg.norm(normals.T @ fraction) == pytest.approx(margin, abs=1e-4)


def test_a_slot_has_a_way_out_along_its_sides_and_a_hole_has_none() -> None:
    sides = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
    way, margin = middle_direction(sides)
    assert margin == pytest.approx(0.0, abs=1e-12) and abs(way[0]) < 1e-12
    assert middle_direction(np.concatenate([np.eye(3), -np.eye(3)]))[1] < -0.5


def test_what_is_above_on_the_way_is_in_it_and_what_is_beside_is_not() -> None:
    body = box((0, 0, 0), (1, 1, 1))
    over = box((0.2, 0.2, 2), (0.8, 0.8, 3))
    assert obstruction_depth(body, over, UP, 1.1) == pytest.approx(2.0)
    assert obstruction_depth(body, over, UP, 0.9) == 0.0  # it does not come so far
    assert obstruction_depth(body, box((0.2, 0.2, 1.5), (0.8, 0.8, 90.0)), UP, 0.6) > 1.0
    assert obstruction_depth(body, box((0, 0, 7), (1, 1, 8)), UP, 3.0) == 0.0
    assert obstruction_depth(body, over, -UP, 5.0) == 0.0
    assert obstruction_depth(body, box((1, 0, 0), (2, 1, 1)), UP, 5.0) == 0.0  # beside it, touching
    assert obstruction_depth(body, box((1 - 1e-3, 0, 1), (2, 1, 2)), UP, 5.0) > 0.5
    assert obstruction_depth(body, box((1 - 1e-3, 0, 1), (2, 1, 2)), UP, 5.0, 2e-3) == 0.0
    assert obstruction_depth(body, box((0, 0, -1), (1, 1, 0)), UP, 5.0) == 0.0  # below it, touching


def test_sides_that_lean_open_to_one_face_alone() -> None:
    ring = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    stone = slab(ring, np.full(4, 0.1), [NONE] * 4)
    wide = np.array([[-0.5, 0.5], [0.5, 0.5], [0.5, 1.5], [-0.5, 1.5]])
    beside = slab(wide, np.array([-0.1, 0.0, 0.0, 0.0]), [NONE] * 4)
    assert obstruction_depth(stone.triangles, beside.triangles, UP, 3.0) < 1e-9
    assert obstruction_depth(stone.triangles, beside.triangles, -UP, 3.0) > 0.01


def test_faces_of_outlines_fill_them_and_bodies_are_closed() -> None:
    star = np.array([[0, 0], [2, 1], [4, 0], [3, 2], [4, 4], [2, 3], [0, 4], [1, 2]], dtype=float)
    one, two, three = star[outline_faces(star)].transpose(1, 0, 2)
    areas = 0.5 * np.cross(two - one, three - one)
    assert areas.min() > 0.0 and areas.sum() == pytest.approx(8.0)
    with pytest.raises(ValueError, match="crosses"):
        outline_faces(star[[0, 4, 2, 6]])
    whole = slab(star[[0, 2, 4, 6]], np.full(4, 0.2), [NONE] * 4).mesh
    solid = trimesh.Trimesh(*whole, process=False)
    assert solid.is_watertight and solid.is_winding_consistent and solid.volume > 0.0


def test_bodies_beyond_and_rows_follow_from_outlines_side_by_side() -> None:
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=float)
    plans = [square + np.array([k % 3, k // 3]) for k in range(9)]
    beyond = bodies_beyond(plans, 1e-6)
    assert [one.tolist() for one in beyond[:2]] == [[NONE, 1, 3, NONE], [NONE, 2, 4, 0]]
    first = np.arange(9) < 3
    assert assembly_rows(beyond, first, np.zeros(9)).tolist() == [0, 0, 0, 1, 1, 1, 2, 2, 2]


def honeycomb(leans: np.ndarray, around: int) -> list[Slab]:
    """A hexagon whose sides lean by angles, and six round it that have the same sides."""
    turn = np.deg2rad(60.0 * np.arange(6))
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    middles = [np.zeros(2)] + [np.sqrt(3.0) * np.array([np.cos(t), np.sin(t)]) for t in turn + np.pi / 6]
    beyond = bodies_beyond([ring + m for m in middles], 1e-6)
    out = [slab(ring, leans, beyond[0].tolist())]
    for k, middle in enumerate(middles[1 : around + 1], 1):
        own = np.where(beyond[k] == 0, -leans[(np.arange(6) + 3) % 6], 0.0)
        moved = slab(ring, own, beyond[k].tolist())
        off = np.append(middle, 0.0)
        out.append(Slab(moved.front + off, moved.back + off, moved.faces, moved.rim, moved.beyond))
    return out


def test_a_body_that_its_neighbours_would_lock_comes_before_them() -> None:
    """Every other side of the one in the middle leans in: once all six stand it has no way, and by the wanted
    order it would be the last."""
    slabs = honeycomb(np.where(np.arange(6) % 2, 0.2, -0.2), 6)
    assert middle_direction(slabs[0].normals.reshape(-1, 3))[1] < -0.1
    rank = np.array([9, 1, 2, 3, 4, 5, 6])
    rests = [np.arange(1, 7), *([np.array([], dtype=int)] * 6)]
    steps = assemble(slabs, rank, rests, UP, CONTACT_TOLERANCE_M)
    assert sorted(step.body for step in steps) == list(range(7))
    assert max(step.depth for step in steps) == 0.0
    assert [step.body for step in steps].index(0) < 6


def test_a_keystone_is_the_last_and_comes_from_the_side_to_which_it_is_wide() -> None:
    slabs = honeycomb(np.full(6, 0.1), 6)
    rests = [np.arange(1, 7), *([np.array([], dtype=int)] * 6)]
    steps = assemble(slabs, np.array([9, 1, 2, 3, 4, 5, 6]), rests, UP, CONTACT_TOLERANCE_M)
    assert steps[-1].body == 0
    np.testing.assert_allclose(steps[-1].direction, -UP, atol=1e-9)


def test_a_body_without_a_way_in_any_order_is_told_by_how_much_is_in_it() -> None:
    """The other body has all six sides of the one, so no order helps: sides lean by 0.02 over 200 mm, so 2 mm
    at the middle of each face are in the way, 4 mm at one face along one way."""
    one, *six = honeycomb(np.where(np.arange(6) % 2, 0.02, -0.02), 6)
    one = Slab(one.front, one.back, one.faces, one.rim, np.ones(6, dtype=int))
    front, back = (np.concatenate([getattr(part, face) for part in six]) for face in ("front", "back"))
    number = [6 * k + part.faces for k, part in enumerate(six)]
    rim = np.arange(36)
    ring = Ring(front, back, np.concatenate(number), rim, np.full(36, NONE))
    empty = np.array([], dtype=int)
    steps = assemble([one, ring], np.array([1, 0]), [np.array([1]), empty], UP, CONTACT_TOLERANCE_M)
    assert sorted(step.body for step in steps) == [0, 1]
    assert steps[0].depth == 0.0 and 2e-3 < steps[1].depth < 9e-3


class Ring(Slab):
    """Six bodies as one: each rim goes round by itself."""

    @property
    def mesh(self) -> tuple[np.ndarray, np.ndarray]:  # type: ignore[override]
        parts = [np.arange(6 * k, 6 * k + 6) for k in range(6)]
        sides = [Slab(self.front, self.back, self.faces[:0], part, part).mesh[1] for part in parts]
        caps = [self.faces, len(self.front) + self.faces[:, ::-1]]
        return np.concatenate([self.front, self.back]), np.concatenate([*sides, *caps])
