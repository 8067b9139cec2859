"""The simulated stock against booleans of another library: signs, distances and remaining material."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from planner.claims.segments import Segment
from planner.geometry.arrays import FloatArray, Mesh
from planner.processes import registry
from planner.processes.milling.claims import SparesPart
from planner.processes.milling.plan import check
from planner.processes.milling.proof import tool_motion
from planner.processes.milling.proof.tool_motion import edge_slices, edge_spacing, edge_step, near_face_points
from planner.tooling import Cutter
from tests.processes.milling.plan.small_mill import BALL, PANEL, WALL
from tests.processes.milling.plan.swept_solids import heights, shell, signed, swept
from tests.processes.milling.proof.milling_job import Job

HOLDER = np.array([[0.04, 0.02], [0.1, 0.02]])
CUTTERS = [
    Cutter("ball", 0.003, 0.003, 0.015, 0.04, 0.003, HOLDER),
    Cutter("bull", 0.005, 0.0015, 0.015, 0.04, 0.005, HOLDER),
    Cutter("cylinder", 0.004, 0.0, 0.015, 0.04, 0.004, HOLDER),
]
PIECES = tool_motion.solids(Cutter("cylinder", 0.004, 0.0, 0.015, 0.04, 0.003, HOLDER))
FACETS = 12e-6
"""Error [m] of 64 facets around a cutter of 5 mm, 12 on its corner, and of rotations between positions."""


def wave(tilt: float, sweep: float) -> tuple[FloatArray, FloatArray]:
    """Return a path of 40 mm over a crest into a dip and out, in 60 moves.

    The axis tilts by ``tilt`` and rotates by ``sweep`` [rad].
    """
    t = np.linspace(0.0, 1.0, 61)
    tip = np.stack([0.03 * t, 0.004 * np.sin(7.0 * t), 0.002 * np.cos(9.0 * t)], axis=1)
    turn = tilt + sweep * t
    axis = np.stack([np.sin(turn), 0.3 * np.cos(turn), np.cos(turn)], axis=1)
    return tip, axis / np.linalg.norm(axis, axis=1, keepdims=True)


def fine(tip: FloatArray, axis: FloatArray, parts: int) -> tuple[FloatArray, FloatArray]:
    """Places (N, 3) that are ``parts`` times as dense."""
    at = np.linspace(0.0, len(tip) - 1.0, (len(tip) - 1) * parts + 1)
    rows = np.arange(len(tip))
    tips, axes = (np.stack([np.interp(at, rows, one[:, k]) for k in range(3)], axis=1) for one in (tip, axis))
    return tips, axes / np.linalg.norm(axes, axis=1, keepdims=True)


@pytest.mark.sampled(every=3)
@pytest.mark.parametrize("tilt", [0.0, 0.6])
@pytest.mark.parametrize("cutter", CUTTERS, ids=lambda cutter: cutter.kind)
def test_what_a_cutter_sweeps_is_what_booleans_say(cutter: Cutter, tilt: float) -> None:
    """Random points around the path: both agree on inside and outside, and on the distance outside.

    The depth inside is that in the tool at one position, which is at most the depth in the whole swept
    volume.
    """
    tip, axis = wave(tilt, 0.06)
    solid = swept(shell(cutter.radius, cutter.corner, cutter.flute), tip, axis)
    rng = np.random.default_rng(3)
    rows = rng.integers(0, len(tip), 200)
    points = tip[rows] + rng.uniform(-1.6, 1.6, (200, 3)) * [cutter.radius, cutter.radius, 0.002]
    expected = signed(solid, points)
    proof, _ = tool_motion.track_distance(points, *fine(tip, axis, 25), tool_motion.solids(cutter)[0])
    own, _ = check.path_distance(points, tip, axis, check.sections(cutter)[0])
    outside = (expected > FACETS) & (expected < 1.5e-3)
    assert outside.sum() > 25 and (expected < -FACETS).sum() > 25
    # a round edge hides s^2 / 8 r between places s apart, a sharp one leaves stairs half as deep as s at most
    step = check.PATH_SPACING_FACTOR * cutter.radius
    stairs = 0.25 * step if cutter.corner == 0.0 else step**2 / (8.0 * cutter.corner)
    for got, hidden in ((proof, 3e-6), (own, stairs)):
        np.testing.assert_allclose(got[outside], expected[outside], atol=FACETS + hidden)
        inside = expected < -FACETS - hidden
        assert (got[inside] < 0.0).all()
        assert (got[inside] >= expected[inside] - FACETS).all()


def valley(bend: float) -> tuple[FloatArray, FloatArray]:
    """Places (N, 3) and normals of z = -bend / 2 y^2 near the origin."""
    x, y = (v.ravel() for v in np.meshgrid(np.linspace(0.004, 0.016, 5), np.linspace(-0.003, 0.003, 61)))
    normal = np.stack([np.zeros_like(y), bend * y, np.ones_like(y)], axis=1)
    return np.stack([x, y, -0.5 * bend * y * y], axis=1), normal / np.linalg.norm(
        normal, axis=1, keepdims=True
    )


@pytest.mark.parametrize("bend", [60.0, 0.0, -120.0], ids=["crest", "flat", "dip"])
def test_ridges_between_lines_stay_as_high_as_booleans_leave_them(bend: float) -> None:
    """Seven lines of a ball 1 mm apart over a crest, a plane and a dip: what is left of the face is found,
    within the second order of ridges 0.03 mm high."""
    cutter = CUTTERS[0]
    across = np.linspace(-0.003, 0.003, 7)
    place, normal = np.stack([across, -0.5 * bend * across**2]), np.stack([bend * across, np.ones(7)])
    centre = place + cutter.radius * normal / np.linalg.norm(normal, axis=0)
    tip = np.array([[x, y, z - cutter.radius] for y, z in centre.T for x in (0.0, 0.02)])
    axis = np.tile([0.0, 0.0, 1.0], (len(tip), 1))
    solid = swept(shell(0.003, 0.003, 0.015, 96, 48), tip, axis, list(range(2, 14, 2)))
    points, normals = valley(bend)
    expected = heights(solid, points, normals, 0.5e-3)
    ways = [fine(tip[i : i + 2], axis[i : i + 2], 80) for i in range(0, 14, 2)]
    tips, axes = (np.concatenate(part) for part in zip(*ways, strict=True))
    got, _ = tool_motion.track_distance(points, tips, axes, tool_motion.solids(cutter)[0])
    inner = np.abs(points[:, 1]) < 0.6e-3
    assert expected[inner].max() == pytest.approx(1e-6 / 8.0 * (1 / 0.003 + bend), rel=0.05)
    np.testing.assert_allclose(got, expected, atol=4e-6)


def test_what_a_ball_leaves_in_an_inner_edge_is_found() -> None:
    """A ball along the edge of two planes at a right angle leaves (sqrt 2 - 1) r in it."""
    tip = np.array([[0.0, 0.003, 0.0], [0.02, 0.003, 0.0]])
    axis = np.tile([0.0, 0.0, 1.0], (2, 1))
    solid = swept(shell(0.003, 0.003, 0.015, 96, 48), tip, axis)
    points = np.array([[0.01, y, 0.0] for y in np.linspace(0.0, 0.003, 13)])
    expected = signed(solid, points)
    got, _ = tool_motion.track_distance(points, *fine(tip, axis, 100), tool_motion.solids(CUTTERS[0])[0])
    np.testing.assert_allclose(got, expected, atol=6e-6)
    assert got[0] == pytest.approx((np.sqrt(2.0) - 1.0) * 0.003, abs=2e-6)


def normals_at(face: Mesh, points: FloatArray) -> FloatArray:
    """Normals (N, 3) of the triangles whose middles are nearest."""
    corners = face.vertices[face.faces]
    middle = corners.mean(axis=1)
    near = np.array([np.argmin(((middle - point) ** 2).sum(axis=1)) for point in points])
    normal = np.cross(corners[near, 1] - corners[near, 0], corners[near, 2] - corners[near, 0])
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))


@pytest.mark.long
def test_what_a_proof_says_of_a_panel_is_what_booleans_leave_of_it(tmp_path: Path) -> None:
    """A panel in lines 3 mm apart, from targets to the posted text and its replay: the proof's deviations,
    point by point, against solids that the targets' own poses sweep."""
    cut = {"lines": "front", "stepover_mm": 3, "margin_mm": 8}
    job = Job(tmp_path, PANEL, BALL, cuts=[cut], shape_tol_mm=0.6)
    proof = job.prove(job.programs, last=None)
    (face,) = proof.surfaces
    targets = registry.job(job.problem, 0).targets()
    rows = np.flatnonzero(np.array(targets.segment) == Segment("mill", "front_lines"))
    pose = targets.pose["robot"][np.append(rows[0] - 1, rows)]
    solid = swept(shell(0.003, 0.003, 0.012, 64, 24), pose[:, :3, 3], -pose[:, :3, 2])
    some = np.random.default_rng(0).choice(len(face.points), 500, replace=False)
    assert job.problem.part is not None and job.problem.part.front is not None
    normals = normals_at(job.problem.part.front, face.points[some])
    expected, got = heights(solid, face.points[some], normals, 1.5e-3), face.deviation[some]
    seen = np.isfinite(expected) & np.isfinite(got)
    assert seen.sum() > 480
    assert np.quantile(expected[seen], 0.99) > 0.3e-3
    # distances of ridges 0.5 mm high are less than their heights by 4 %; corners between targets are rounded
    np.testing.assert_allclose(got[seen], expected[seen], rtol=0.06, atol=0.03e-3)


@pytest.mark.long
def test_what_a_proof_says_of_a_twisted_wall_is_what_booleans_leave_of_it(tmp_path: Path) -> None:
    job = Job(tmp_path, WALL)
    face = next(
        face
        for face in job.prove(job.programs, last=None).surfaces
        if face.segment == Segment.read("mill/wall")
    )
    targets = registry.job(job.problem, 0).targets()
    rows = np.flatnonzero([(s.kind, s.name) == ("mill", "wall") for s in targets.segment])[1:-1]
    pose = targets.pose["robot"][rows]
    solid = swept(shell(0.006, 0.0, 0.05, 128), *fine(pose[:, :3, 3], -pose[:, :3, 2], 12))
    some = np.random.default_rng(0).choice(len(face.points), 300, replace=False)
    points = face.points[some]
    deviation = signed(solid, points)
    assert np.abs(deviation).max() < 0.05e-3
    # hulls of a turning cutter are too large, here by 0.03 mm; twice as many are so by half of that
    np.testing.assert_allclose(face.deviation[some], deviation, atol=0.045e-3)


@pytest.mark.parametrize("slope", [15.0, 30.0, 45.0, 60.0])
@pytest.mark.parametrize("radius", [0.003, 0.025])
def test_a_sharp_rim_that_goes_a_little_into_a_slope_is_found(slope: float, radius: float) -> None:
    """An upright cylinder goes some millimetres over a slope, its rim 0.5 mm below it. On a plane that a
    right angle enters by d, with its sides at a and 90 - a degrees, the point farthest inside is
    d / (sin a + cos a) from both."""
    a, deep, rng = np.deg2rad(slope), 0.5e-3, np.random.default_rng(int(slope))
    up, level = np.array([np.cos(a), 0.0, np.sin(a)]), np.array([0.0, 1.0, 0.0])
    corners = np.array([x * up + y * level for x in (-0.1, 0.1) for y in (-0.1, 0.1)])
    cutter = Cutter("cylinder", radius, 0.0, 0.03, 0.05, radius, HOLDER)
    expected = deep / (np.sin(a) + np.cos(a))
    for _ in range(12):
        shift = rng.uniform(-2e-3, 2e-3, 2)
        vertices = corners + shift[0] * up + shift[1] * level
        face = SparesPart((), "robot", cutter, vertices, np.array([[0, 2, 1], [2, 3, 1]]), 0.0, 0.2e-3)
        turn = rng.uniform(-0.6, 0.6)
        way = np.arange(0.0, rng.uniform(4e-3, 10e-3), edge_step(face.tolerance))[:, None]
        start = np.array([0.0, 0.0, (radius * np.sin(a) - deep) / np.cos(a)])
        tip = start + way * (np.cos(turn) * up + np.sin(turn) * level)
        axis = np.tile([0.0, 0.0, 1.0], (len(tip), 1))
        (rim, _) = edge_slices(tool_motion.solids(cutter)[:1])
        places, _ = near_face_points(vertices[face.faces], rim, tip, axis, edge_spacing(face.tolerance))
        deviation, _ = tool_motion.track_distance(places, tip, axis, rim)
        assert 0.8 * expected < -deviation.min() < 1.001 * expected


def test_edges_of_a_tool_are_where_it_grows_wider_or_narrower() -> None:
    found = [
        (edge.name, round(1e3 * edge.start, 3), round(1e3 * edge.end, 3)) for edge in edge_slices(PIECES)
    ]
    assert found == [
        ("cutter", 0.0, 5.0),
        ("cutter", 10.0, 15.0),
        ("spindle", 40.0, 45.0),
        ("spindle", 95.0, 100.0),
    ]
