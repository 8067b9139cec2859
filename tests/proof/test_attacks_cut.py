"""Cuts in another order, approach and retreat through the part, wires on the wrong side of a surface.

Each is refused by the expected rule. The wall distances that the proof uses are compared with closed forms.
"""

from __future__ import annotations

import dataclasses
import functools
import re

import numpy as np
import pytest
import trimesh

from planner.claims.segments import Segment
from planner.processes.hotwire.claims import Contour, CutsSurface, FollowsRulings, KerfCurve, SlitsAllowed
from planner.processes.hotwire.proof.rules.straight_wire import (
    guide_deviation,
    guide_normals,
    interpolate_moves,
)
from planner.processes.hotwire.proof.walls import make_walls
from planner.proof.prove import Prover
from tests.languages.rapid.rapid_edits import edit, name
from tests.processes.hotwire.proof import straight_job
from tests.processes.hotwire.proof.bow_edits import moves, put, rows_of
from tests.proof import small_job

COUNT = 12
KERF = KerfCurve.constant(0.001)


@functools.cache
def prover(job, contours=()):
    claims = dict(job.claims())
    if contours:
        rings = tuple(ring(*one) for one in contours)
        claims["top"] = (*claims["top"], SlitsAllowed(rings, np.array([[-0.1, -0.1, 0.0], [0.1, 0.1, 0.06]])))
    return Prover(job.problem(), claims)


def ring(segment, size, hole):
    """A square contour along y."""
    square = 0.5 * size * np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]]) + [0.0, 0.03]
    start = np.column_stack([square[:, 0], np.full(4, -0.1), square[:, 1]])
    return Contour(
        Segment.read(segment) if segment else None,
        start,
        start + np.array([0.0, 0.2, 0.0]),
        np.ones(4, dtype=bool),
        hole,
    )


def codes(job, texts, last, contours=()):
    proof = prover(job, contours).prove(texts, last=last)
    return {issue.code for issue in proof.issues}


# ---- order ----------------------------------------


def test_cuts_in_another_order():
    """What is cut free first may fall before the rest is cut."""
    texts = small_job.programs(COUNT)
    for task in (1, 2):
        main = rows_of(texts, task, "Main")
        a, b = (
            next(i for i, row in enumerate(main) if row.strip() == f"cut_{side};")
            for side in ("front", "back")
        )
        main[a], main[b] = main[b], main[a]
        texts = put(texts, task, "Main", main)
    assert "verify.order" in codes(small_job, texts, "verify.order")


def test_a_cut_once_more_behind_another():
    texts = small_job.programs(COUNT)
    for task in (1, 2):
        texts = edit(texts, name("Main", task), "    cut_back;", "    cut_back;\n    cut_front;")
    assert "verify.order" in codes(small_job, texts, "verify.order")


def test_the_way_out_before_the_way_in():
    clean = straight_job.programs(COUNT)
    main = clean[name("Main", 1)].replace("cut_top_in;", "X;").replace("cut_top_out;", "cut_top_in;")
    texts = {**clean, name("Main", 1): main.replace("X;", "cut_top_out;")}
    assert "verify.order" in codes(straight_job, texts, "verify.order")


# ---- ways in and out ----------------------------------------


def lowered(row, by, back):
    x, y, z = re.search(r"MoveL \[\[([^,]*),([^,]*),([^\]]*)\]", row).groups()
    place = f"[[{float(x) - back:.4f},{y},{float(z) - by:.4f}]"
    return row.replace(f"[[{x},{y},{z}]", place, 1).replace(",fine,", ",z1,")


def through_the_part(by):
    """On its retreat the wire goes back through the block beneath the face, and out again."""
    texts = straight_job.programs(COUNT)
    rows = rows_of(texts, 1, "Cut1")
    last = moves(texts, 1, "cut_top_out")[-1]
    low = [lowered(rows[last], by, 10.0 * k) for k in range(19)]
    rows[last:last] = [*low, *reversed(low[:-1])]
    return put(texts, 1, "Cut1", rows)


def test_ways_out_do_not_pass_the_part():
    assert "verify.part" in codes(straight_job, through_the_part(18.0), "verify.part")


INSIDE = (("cut/top", 0.01, True),)
OUTSIDE = (("cut/top", 0.04, False), ("", 0.01, True))
OF_ANOTHER = (("cut/top", 0.04, False), ("cut/other", 0.01, True))


@pytest.mark.sampled(every=4)
@pytest.mark.parametrize("contours", [INSIDE, OUTSIDE, OF_ANOTHER])
@pytest.mark.parametrize("by", [18.0, 12.0, 0.0])
def test_a_slit_is_one_plane_on_the_outer_side_of_its_contour(contours, by):
    """Leave to come through the part is none to go elsewhere, nor on beyond the contour in the slit's own
    plane. (Slits that are as they have to be:
    tests/processes/hotwire/proof/rules/test_straight_wire_slits.py.)"""
    assert "verify.part" in codes(straight_job, through_the_part(by), "verify.part", contours)


# ---- a bent wire beside another face ----------------------------------------


@pytest.mark.parametrize(("rise", "good"), [(0.0, True), (0.034, False)])
def test_a_bent_wire_that_goes_up_through_the_other_face(monkeypatch, rise, good):
    """Beyond the rim of the face that it cuts, which ends 10 mm before the middle of the block, the wire
    rises smoothly through the front, 25 mm above it: the face itself is as it should be."""
    end, way = -0.01, small_job.wire_path

    def rising(count=60):
        for y, low, lift, speed, label, stop in way(count):
            share = np.clip((y - end) / 0.06, 0.0, 1.0) if low and label in ("cut/back", "retreat") else 0.0
            yield y, low, lift + rise * share * share * (3.0 - 2.0 * share), speed, label, stop

    monkeypatch.setattr(small_job, "wire_path", lambda count=60: list(rising(count)))
    claims = [
        dataclasses.replace(c, faces=c.faces[c.vertices[c.faces].mean(axis=1)[:, 1] < end])
        if isinstance(c, CutsSurface) and c.segment.name == "back"
        else c
        for c in small_job.claims()["panel"]
    ]
    texts = small_job.programs.__wrapped__(60)
    proof = Prover(small_job.problem(), {"panel": tuple(claims)}).prove(texts)
    assert {issue.code for issue in proof.issues} == (set() if good else {"verify.part"})


# ---- sides of a ruled surface ----------------------------------------


def corner(inner=False):
    """Rulings along y around a corner of 90 degrees: the part is below and left of it."""
    line = np.array([[-0.1, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, -0.1]])
    if inner:
        line = np.array([[-0.1, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.1]])
    return FollowsRulings(Segment.read("cut/x"), line, line + np.array([0.0, 0.2, 0.0]), KERF, 0.0003)


def wire_at(*positions):
    start = np.array([[x, -0.1, z] for x, z in positions])
    return np.stack([start, start + np.array([0.0, 0.4, 0.0])], axis=1)


def deviation_from_guide(claim, points):
    speed = np.full(points.shape[:2], 0.005)
    points, speed, _ = interpolate_moves(points, speed, np.arange(len(points)))
    normals = guide_normals(claim)
    return guide_deviation(points, speed, claim.start, normals[0], claim)[0]


@pytest.mark.parametrize("inner", [False, True])
def test_half_a_kerf_into_the_part_is_not_half_a_kerf_off_it(inner):
    claim = corner(inner)
    assert deviation_from_guide(claim, wire_at((-0.05, 0.0005)))[0] == pytest.approx(0.0, abs=1e-9)
    assert deviation_from_guide(claim, wire_at((-0.05, -0.0005)))[0] == pytest.approx(0.001, abs=1e-9)
    side = 0.0005 if inner else -0.0005
    assert deviation_from_guide(claim, wire_at((side, 0.05 if inner else -0.05)))[0] == pytest.approx(
        0.001, abs=1e-9
    )


def test_a_corner_is_not_cut_off_between_two_looks():
    """Both looks are half a kerf off the surface; the way between them passes the corner inside."""
    ways = wire_at((-0.0016, 0.0005), (0.0005, -0.0016))
    assert deviation_from_guide(corner(), ways[:1]).max() < 1e-9
    assert deviation_from_guide(corner(), ways[1:]).max() < 1e-9
    assert deviation_from_guide(corner(), ways).max() > 2.0 * corner().tolerance
    around = wire_at((-0.0016, 0.0005), (0.0, 0.0005), (0.00035, 0.00035), (0.0005, 0.0), (0.0005, -0.0016))
    assert deviation_from_guide(corner(), around).max() < 1e-4


# ---- walls ----------------------------------------

CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * [0.1, 0.05, 0.02]
BOTTOM, TOP = [[0, 2, 6], [0, 6, 4]], [[1, 5, 7], [1, 7, 3]]
ENDS = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6]]
SIDES = np.array([*ENDS, *BOTTOM, *TOP])


def box_off(points):
    low, high = CUBE.min(axis=0), CUBE.max(axis=0)
    over = np.maximum(low - points, points - high)
    outside = np.linalg.norm(np.maximum(over, 0.0), axis=1)
    return np.where(outside > 0.0, outside, over.max(axis=1))


def test_distances_to_a_closed_wall():
    points = np.random.default_rng(3).uniform([-0.03, -0.03, -0.03], [0.13, 0.08, 0.05], (4000, 3))
    found, owner = make_walls(
        (CutsSurface(Segment.read("cut/box"), CUBE, SIDES, KERF, 0.0003),)
    ).signed_distance(points)
    assert np.abs(found - box_off(points)).max() < 1e-9
    assert (owner == 0).all()


def test_distances_to_an_open_wall():
    """The top of the box alone: what is beside it is not known, what is beneath it is inside."""
    top = CutsSurface(Segment.read("cut/top"), CUBE, np.array(TOP), KERF, 0.0003)
    points = np.random.default_rng(4).uniform([-0.03, -0.03, -0.03], [0.13, 0.08, 0.05], (2000, 3))
    found, _ = make_walls((top,)).signed_distance(points)
    over = ((points > CUBE.min(axis=0)) & (points < CUBE.max(axis=0)))[:, :2].all(axis=1)
    assert np.isnan(found[~over]).all()
    assert np.abs(found[over] - (points[over, 2] - 0.02)).max() < 1e-9


@pytest.mark.parametrize("degrees", [0.05, 2.0, 40.0])
def test_what_lies_behind_a_sharp_edge_is_outside(degrees: float) -> None:
    """As behind a wing, whose two skins have triangles of other sizes at their edge: beyond the planes of
    both no point is inside, whichever triangles meet in the nearest place."""
    t = np.tan(np.deg2rad(0.5 * degrees))
    one, two = np.linspace(0.0, 0.2, 12), np.linspace(0.0, 0.2, 7)
    places = [[0.0, y, 0.0] for y in np.unique(np.concatenate([one, two]))]
    edge = np.array(places)
    rows = [edge, edge + np.array([-0.1, 0.0, 0.1 * t]), edge - np.array([0.1, 0.0, 0.1 * t])]
    count = len(edge)
    k = np.arange(count - 1)
    top = np.concatenate([np.stack([k, k + 1, count + k], 1), np.stack([k + 1, count + k + 1, count + k], 1)])
    far = 2 * count + k
    sole = np.concatenate([np.stack([k, far, far + 1], 1), np.stack([k, far + 1, k + 1], 1)])
    claim = CutsSurface(
        Segment.read("cut/x"), np.concatenate(rows), np.concatenate([top, sole]), KERF, 0.0003
    )
    random = np.random.default_rng(8)
    behind = random.uniform([1e-4, 0.02, -0.02], [0.08, 0.18, 0.02], (3000, 3))
    behind[:, 2] *= np.minimum(1.0, behind[:, 0] / 0.02) * 0.5
    found, _ = make_walls((claim,)).signed_distance(behind)
    assert (found > 0.0).all()
    inside = random.uniform([-0.08, 0.02, -0.9], [-0.005, 0.18, 0.9], (500, 3))
    inside[:, 2] *= -inside[:, 0] * t
    assert (make_walls((claim,)).signed_distance(inside)[0] < 0.0).all()


def test_walls_are_as_far_as_the_nearest_of_all_their_triangles_and_end_at_their_rims() -> None:
    """Against every triangle, one by one: long and short ones, twisted, as strips of meshes have them. Beyond
    the rim of a saddle of narrow facets, far away, nothing is known, whichever middles are nearest."""
    u, v = np.meshgrid(np.linspace(0.0, 1.0, 61) ** 2, np.linspace(0.0, 1.0, 41), indexing="ij")
    grid = np.stack([0.3 * u, 0.04 * v + 0.05 * u * u, 0.02 * np.sin(3.0 * u) + 0.3 * u * v * 0.1], axis=-1)
    index = np.arange(u.size).reshape(u.shape)
    a, b, c, d = (one.ravel() for one in (index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]))
    faces = np.concatenate([np.stack([a, c, d], 1), np.stack([a, d, b], 1)])
    claim = CutsSurface(Segment.read("cut/strip"), grid.reshape(-1, 3), faces, KERF, 0.0003)
    points = np.random.default_rng(7).uniform([-0.1, -0.1, -0.1], [0.4, 0.2, 0.15], (300, 3))
    found, _ = make_walls((claim,)).signed_distance(points)
    triangles = claim.vertices[faces]
    every = (np.repeat(point[None], len(faces), axis=0) for point in points)
    near = np.array([trimesh.triangles.closest_point(triangles, one) for one in every])
    distance = np.linalg.norm(near - points[:, None], axis=2)
    k = distance.argmin(axis=1)
    foot = near[np.arange(len(points)), k]
    on_rim = np.array([min(np.linalg.norm(_foot(side, p) - p) for side in _sides(grid)) < 1e-9 for p in foot])
    assert (np.isnan(found) == on_rim).all()
    assert np.abs(found[~on_rim]) == pytest.approx(distance.min(axis=1)[~on_rim], abs=1e-9)
    assert 20 < on_rim.sum() < 290


def _sides(grid: np.ndarray) -> list[np.ndarray]:
    return [grid[0], grid[-1], grid[:, 0], grid[:, -1]]


def _foot(side: np.ndarray, point: np.ndarray) -> np.ndarray:
    """The point of a polyline (N, 3) nearest to a point (3,)."""
    a, way = side[:-1], np.diff(side, axis=0)
    fraction = np.clip(((point - a) * way).sum(axis=1) / (way * way).sum(axis=1), 0.0, 1.0)
    feet = a + fraction[:, None] * way
    return feet[np.argmin(np.linalg.norm(feet - point, axis=1))]
