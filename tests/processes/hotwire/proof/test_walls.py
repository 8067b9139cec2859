"""Faces that extend beyond one another bound a part together.

Crossings and the outside are compared with half spaces.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh

from planner.processes.hotwire.proof import walls as module
from planner.processes.hotwire.proof.rules.cut_part import _PartBounds
from planner.processes.hotwire.proof.walls import PartWalls, crosses, make_walls

HALF = np.array([0.1, 0.06])
BLOCK = np.array([[-0.12, -0.08, 0.0], [0.12, 0.08, 0.05]])


def face(name: str, ends: np.ndarray) -> Any:
    """Return a flat upright face between two points (2, 2) in plan, with the part on its left.

    It ends a millimetre before the block's top and bottom.
    """
    corners = np.array([[*ends[i], z] for z in (0.001, 0.049) for i in (0, 1)])
    triangles = np.array([[0, 1, 3], [0, 3, 2]])
    return SimpleNamespace(
        segment=SimpleNamespace(key=name), vertices=corners, faces=triangles, tolerance=4e-4
    )


def ring(beyond: float) -> tuple[Any, ...]:
    """Four faces round a rectangle that go on ``beyond`` [m] its corners."""
    corners = np.array([(1, -1), (1, 1), (-1, 1), (-1, -1)]) * HALF
    out = []
    for k in range(4):
        a, b = corners[k], corners[(k + 1) % 4]
        way = (b - a) / np.linalg.norm(b - a)
        out.append(face(f"side{k}", np.array([a - beyond * way, b + beyond * way])))
    return tuple(out)


@pytest.mark.parametrize(
    ("beyond", "expected"), [(0.018, True), (0.0025, True), (0.0, False), (-0.01, False)]
)
def test_faces_cross_that_go_on_a_little_beyond_one_another(beyond: float, expected: bool) -> None:
    """Of the longer ones 2.5 mm are 1.2 %."""
    one, other, opposite, _ = ring(beyond)
    assert crosses(one, make_walls((other,)), BLOCK) == expected
    assert crosses(other, make_walls((one,)), BLOCK) == expected
    assert not crosses(one, make_walls((opposite,)), BLOCK)


def test_what_is_outside_of_any_face_is_outside_of_the_part() -> None:
    rng = np.random.default_rng(5)
    context: Any = SimpleNamespace(claims_of=lambda kind: (), datum=SimpleNamespace(box=BLOCK))
    deviation, tolerance = _PartBounds(context, ring(0.018)).signed_distance(
        points := rng.uniform(*BLOCK, (4000, 3))
    )
    # the same by half spaces; what is nearest to a rim of a face is not known
    expected = (np.abs(points[:, :2]) - HALF).max(axis=1)
    known = np.isfinite(deviation)
    inner = (points[:, 2] > 0.01) & (points[:, 2] < 0.04)
    assert known[inner & (expected < -0.001)].all()
    assert known[inner].mean() > 0.97
    assert ((deviation > 0.0) == (expected > 0.0))[known].all()
    within = known & inner & (expected < 0.009)  # farther ones need not be known so well
    np.testing.assert_allclose(deviation[within], expected[within], atol=1e-9)
    assert (tolerance[known] == 4e-4).all()


def test_a_face_that_only_meets_another_does_not_make_outside_what_is_beyond_it() -> None:
    """A rebate: the part is below its floor and behind its wall, which does not end where its floor does."""
    floor = face("floor", np.array([[-0.1, 0.0], [0.0, 0.0]]))
    wall = face("wall", np.array([[0.0, 0.0], [0.0, -0.06]]))
    context: Any = SimpleNamespace(claims_of=lambda kind: (), datum=SimpleNamespace(box=BLOCK))
    deviation, _ = _PartBounds(context, (floor, wall)).signed_distance(
        np.array([[0.02, -0.03, 0.025], [-0.05, 0.01, 0.025]])
    )
    assert (deviation < 0.0).all()


def test_of_the_faces_of_a_ring_neighbours_cross_and_each_pair_is_looked_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked = []
    monkeypatch.setattr(module, "crosses", lambda *one: asked.append(one) or crosses(*one))
    faces = ring(0.018)
    part = PartWalls(faces, BLOCK)
    for _ in range(2):
        for k, face in enumerate(faces):
            assert [faces.index(one) for one in part.crossing_surfaces(face)] == sorted(
                [(k + 1) % 4, (k - 1) % 4]
            )
    assert len(asked) == 12


def test_distances_far_from_a_slanted_wall_are_those_to_its_triangles() -> None:
    """Against trimesh, triangle by triangle, without any search; far away very many may be the nearest."""
    rng = np.random.default_rng(3)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    wave = [[x, y, 0.01 * np.sin(40 * x) * np.cos(30 * y)] for x in (-0.05, 0, 0.06) for y in (-0.05, 0.05)]
    mesh: Any = SimpleNamespace(
        vertices=np.array(wave) @ turn.T, faces=np.array([[0, 2, 1], [1, 2, 3], [2, 4, 3], [3, 4, 5]])
    )
    points = rng.uniform([-0.04, -0.04, -0.3], [0.05, 0.04, 0.3], (300, 3)) @ turn.T
    deviation, _ = make_walls((mesh,)).signed_distance(points)
    all_of = np.repeat(mesh.vertices[mesh.faces], len(points), axis=0)
    places = trimesh.triangles.closest_point(all_of, np.tile(points, (4, 1)))
    expected = np.linalg.norm(places - np.tile(points, (4, 1)), axis=1).reshape(4, -1).min(axis=0)
    known = np.isfinite(deviation)
    assert known.mean() > 0.5
    np.testing.assert_allclose(np.abs(deviation[known]), expected[known], atol=1e-9)
