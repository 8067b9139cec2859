"""Solids, renderer, scene and replay against closed forms, trimesh and the batched kinematics."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
import trimesh

from planner.catalogue import robots
from planner.cell import kinematics, plant
from planner.claims.segments import Segment
from planner.plans import Plan
from planner.problem import Problem
from planner.report import raster, replay, scene
from planner.report.scene import VisibleScene, sample_keyframes
from tests.report import synthetic_job as job


@pytest.fixture(scope="module")
def problem() -> Problem:
    return job.problem()


@pytest.fixture(scope="module")
def plan() -> Plan:
    return job.plan(60)


@pytest.fixture(scope="module")
def cell(problem: Problem, plan: Plan) -> VisibleScene:
    return scene.extract_scene(
        plant.build_cell_model(problem.cell, problem.stock, plan.stock_pose, plan.bases)
    )


def _volume(solid: raster.RenderSolid) -> float:
    mesh = trimesh.Trimesh(solid.vertices, solid.faces, process=True, merge_norm=True)
    return float(mesh.volume)


def test_solids_have_their_volume_and_face_outward() -> None:
    """Volumes in closed form; a polygon of n sides has the area n/2 sin(2 pi/n) r^2."""
    polygon = 0.5 * 32 * np.sin(2 * np.pi / 32)
    assert _volume(raster.box(0.1, 0.2, 0.3)) == pytest.approx(0.006, rel=1e-12)
    assert _volume(raster.cylinder(0.1, 0.4)) == pytest.approx(polygon * 0.01 * 0.4, rel=1e-9)
    assert _volume(raster.sphere(0.2, 96)) == pytest.approx(4 / 3 * np.pi * 0.008, rel=0.03)
    ball = 4 / 3 * np.pi * 0.001
    assert _volume(raster.capsule(0.1, 0.3, 96)) == pytest.approx(np.pi * 0.003 + ball, rel=0.03)
    for solid in (raster.box(1, 2, 3), raster.cylinder(1, 2), raster.sphere(1), raster.capsule(1, 2)):
        corners = solid.vertices[solid.faces]
        face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        assert (np.einsum("fc,fc->f", face, solid.normals[solid.faces].mean(axis=1)) > -1e-12).all()


def test_a_ball_is_drawn_as_large_and_as_far_as_it_is() -> None:
    """Outline of a sphere in perspective: a circle of radius f r / sqrt(d^2 - r^2)."""
    pose = np.eye(4)
    pose[:3, :3] = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])  # looks along world y, z is up
    camera = raster.Camera(pose, 900.0, 400, 300, (400, 300))
    far, radius = 4.0, 0.5
    ball = raster.sphere(radius, 96)
    moved = np.eye(4)
    moved[1, 3] = far
    image = raster.render_items(camera, [raster.RenderItem(ball.moved(moved), (0.5, 0.5, 0.5))])
    seen = image.thing == 0
    outline = camera.focal * radius / np.sqrt(far**2 - radius**2)
    assert seen.sum() == pytest.approx(np.pi * outline**2, rel=0.03)
    assert image.depth[150, 200] == pytest.approx(far - radius, rel=5e-3)
    assert np.isinf(image.depth[0, 0]) and image.thing[0, 0] == -1


def test_nearer_things_hide_farther_ones() -> None:
    camera = raster.frame_camera(np.array([[-1.0, -1, -1], [1, 1, 1]]), np.array([0.0, 1.0, -0.3]), 320, 200)
    moved = np.eye(4)
    moved[1, 3] = -0.9
    near, far = raster.box(0.3, 0.3, 0.3).moved(moved), raster.box(1.0, 1.0, 1.0)
    for order in ((near, far), (far, near)):
        image = raster.render_items(camera, [raster.RenderItem(s, (0.5, 0.5, 0.5)) for s in order])
        x, y, _ = camera.project(np.array([0.0, -0.9, 0.0]))
        assert order[image.thing[int(y), int(x)]] is near


def test_frame_sees_everything() -> None:
    points = np.random.default_rng(1).normal(size=(100, 3)) * [2.0, 0.5, 1.0]
    camera = raster.frame_camera(points, np.array([0.4, 1.0, -0.4]), 800, 450)
    seen = camera.project(points)
    assert (seen[:, 2] > 0).all()
    assert (seen[:, :2] >= 0).all() and (seen[:, :2] <= [800, 450]).all()
    assert np.ptp(seen[:, 0]) > 0.7 * 800 or np.ptp(seen[:, 1]) > 0.7 * 450


def test_bodies_are_where_the_kinematics_say(cell: VisibleScene, problem: Problem, plan: Plan) -> None:
    q = {arm: plan.operations[0].q[arm][::9] for arm in job.ARMS}
    poses = cell.poses(q)
    for arm in problem.cell.arms:
        frames = arm.base @ kinematics.link_frames(robots.robot(arm.robot), q[arm.name])
        flange = poses[f"{arm.name}/tool"]
        np.testing.assert_allclose(flange, frames[:, 6], atol=1e-9)


def test_track_runs_from_home_through_all_targets_and_home(problem: Problem, plan: Plan) -> None:
    run = sample_keyframes(problem, plan, 480)
    assert (np.diff(run.time) > 0).all() and len(run.time) <= 600
    for arm in problem.cell.arms:
        np.testing.assert_allclose(run.q[arm.name][[0, -1]], np.tile(arm.home, (2, 1)), atol=1e-6)
    assert run.segment[1] == Segment("entry") and run.segment[-1] == Segment("exit")
    assert list(dict.fromkeys(str(s) for s in run.segment if s.name)) == ["cut/front", "cut/back"]
    assert run.stops[0][1].startswith("Mount the wire")


def test_wire_of_the_replay_ends_at_the_tcps(problem: Problem, plan: Plan) -> None:
    """Between targets angles and points are mixed linearly, so the ends agree to part of a mm."""
    run = sample_keyframes(problem, plan, 480)
    assert run.wire is not None and run.shown.any() and not run.shown[0] and not run.shown[-1]
    for arm, end in zip(problem.cell.arms, (0, -1), strict=True):
        flange = kinematics.forward_kinematics(robots.robot(arm.robot), run.q[arm.name][run.shown])
        tcp = (arm.base @ flange @ arm.tool.tcp)[:, :3, 3]
        gap = np.linalg.norm(run.wire[run.shown][:, end] - tcp, axis=1)
        assert gap.max() < 1e-3


def test_replay_is_one_small_offline_file(cell: VisibleScene, problem: Problem, plan: Plan) -> None:
    text = replay.replay_html(cell.model, problem, plan)
    assert len(text) < 10_000_000
    assert not re.search(r'<(script|link|img)[^>]+(src|href)="(?!data:)', text)
    match = re.search(r"<script type='application/json' id='track'>(.*?)</script>", text)
    assert match is not None
    bar = json.loads(match.group(1))
    assert [row[2] for row in bar["segments"] if "/" in row[2]] == ["cut/front", "cut/back"]
    assert bar["end"] == pytest.approx(sample_keyframes(problem, plan, 480).time[-1], abs=0.02)
    assert "synthetic panel – Tandem replay" in text
