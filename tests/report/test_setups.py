"""Report and replay of jobs with several setups, with bows, and with a block that is held by an arm."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

from planner.catalogue import robots
from planner.cell import kinematics, plant
from planner.claims.claim import FeedWindow
from planner.claims.segments import Segment
from planner.geometry.arrays import RuledSurface
from planner.plans import Plan
from planner.problem import Problem
from planner.processes.hotwire import report
from planner.processes.hotwire.claims import CutsSurface, KerfCurve
from planner.proof.verdict import CutFace, Proof, RuleResult
from planner.report import cell_picture, motion_charts, output, raster, replay, scene
from planner.report.scene import SETUP_SEGMENT, sample_keyframes
from tests.report import synthetic_job as job
from tests.report import synthetic_setups as made


@pytest.fixture(scope="module")
def two_setups_job() -> tuple[Problem, Plan]:
    return made.two_setups()


@pytest.fixture(scope="module")
def held_block_job() -> tuple[Problem, Plan]:
    return made.held_block_job()


def ruling(count: int, corner: tuple[int, ...] = (), closed: bool = False) -> RuledSurface:
    """A cylinder's rulings about z, counter-clockwise."""
    angle = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    low = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    corners = np.zeros(count, dtype=bool)
    corners[list(corner)] = True
    return RuledSurface("side", low, low + np.array([0.0, 0.0, 1.0]), corners, closed)


def test_a_ruled_surface_has_its_area_and_its_normals() -> None:
    """A polygon of n sides inscribed in the unit circle is 2 n sin(pi / n) long; normals point outward."""
    for corner in ((), (0,), (0, 1, 7), tuple(range(12))):
        for closed, sides in ((True, 12), (False, 11)):
            mesh = raster.ruled_mesh(ruling(12, corner, closed))
            a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
            normal = 0.5 * np.cross(b - a, c - a)
            assert np.linalg.norm(normal, axis=1).sum() == pytest.approx(sides * 2.0 * np.sin(np.pi / 12))
            middle = (a + b + c) / 3.0
            assert (np.sum(normal[:, :2] * middle[:, :2], axis=1) > 0.0).all()
            assert mesh.faces.max() < len(mesh.vertices)


def test_no_triangle_spans_a_corner() -> None:
    """Vertices at a corner stand twice, so that shading does not round it."""
    mesh = raster.ruled_mesh(ruling(12, (3,), closed=True))
    assert len(mesh.vertices) == 2 * (12 + 1 + 1)


@pytest.mark.parametrize("seed", range(4))
def test_a_straight_wire_is_drawn_as_far_as_it_lies_in_the_block(seed: int) -> None:
    """Against sampling: 20 000 points of each wire, inside or not."""
    rng = np.random.default_rng(seed)
    lower, upper = np.array([-0.2, -0.1, 0.0]), np.array([0.2, 0.1, 0.3])
    ends = rng.uniform(-0.4, 0.5, (40, 2, 3))
    ends[:4, 1, 0] = ends[:4, 0, 0]  # across x
    got = raster.clip_wires(ends, lower, upper)
    fraction = np.linspace(0.0, 1.0, 20_001)[:, None]
    for wire, (start, end) in zip(got, ends, strict=True):
        points = start + fraction * (end - start)
        inside = ((points >= lower) & (points <= upper)).all(axis=1)
        if not inside.any():
            assert np.isnan(wire).all() or np.linalg.norm(wire[-1] - wire[0]) < 1e-4
            continue
        shown = points[inside]
        np.testing.assert_allclose(wire[[0, -1]], shown[[0, -1]], atol=1e-4)


def test_what_a_wire_sweeps_has_the_area_of_the_cut() -> None:
    """A wire along y that goes down x = 0 through a block of 0.2 x 0.3 leaves 0.06 m^2."""
    z = np.linspace(0.5, -0.2, 71)
    ends = np.stack(
        [np.stack([0 * z, 0 * z - 1, z], axis=1), np.stack([0 * z, 0 * z + 1, z], axis=1)], axis=1
    )
    mesh = raster.swept_surface(ends, np.array([-0.1, -0.1, 0.0]), np.array([0.1, 0.1, 0.3]))
    assert mesh is not None
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    assert 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() == pytest.approx(0.06)
    assert raster.swept_surface(ends + 5.0, np.array([-0.1, -0.1, 0.0]), np.array([0.1, 0.1, 0.3])) is None


def test_a_change_of_setup_is_shown_at_home_with_what_is_to_be_done(
    two_setups_job: tuple[Problem, Plan],
) -> None:
    problem, plan = two_setups_job
    run = sample_keyframes(problem, plan, 600)
    assert (np.diff(run.time) > 0).all()
    pauses = np.array([label == SETUP_SEGMENT for label in run.segment])
    for arm in problem.cell.arms:
        np.testing.assert_allclose(run.q[arm.name][pauses], np.tile(arm.home, (pauses.sum(), 1)), atol=1e-9)
    (change,) = np.flatnonzero(np.diff(run.setup))
    assert pauses[change] and pauses[change + 1]
    assert run.time[change + 1] - run.time[change] == pytest.approx(0.01, abs=1e-6)
    for k, place in enumerate(plan.stock_poses):
        np.testing.assert_allclose(run.block[run.setup == k], np.tile(place, ((run.setup == k).sum(), 1, 1)))
    told = [text for _, text in run.stops]
    for setup in problem.setups:
        assert any(text.endswith(setup.confirmation) and setup.steps[0] in text for text in told)
    assert min(at for at, _ in run.stops) >= run.time[0]


def test_arms_that_go_at_once_do_so_in_the_replay(held_block_job: tuple[Problem, Plan]) -> None:
    problem, plan = held_block_job
    (operation,) = plan.operations
    at_once = dataclasses.replace(
        plan, operations=(dataclasses.replace(operation, synchronised=("entry", "exit")),)
    )
    alone, both = sample_keyframes(problem, plan, 600), sample_keyframes(problem, at_once, 600)
    assert both.time[-1] < alone.time[-1]
    for run, together in ((alone, False), (both, True)):
        goes = [np.abs(np.diff(run.q[arm], axis=0)).max(axis=1) > 1e-9 for arm in operation.arm_order]
        entering = np.array([str(label) == "entry" for label in run.segment])[1:]
        shared = int((goes[0] & goes[1] & entering).sum())  # alone, one keyframe may hold a hand-over
        assert (shared > 1) == together
    for arm, way in operation.retreat.items():
        np.testing.assert_allclose(both.q[arm][-1], way[-1], atol=0.01)  # times are rounded


def test_a_held_block_moves_with_its_holder(held_block_job: tuple[Problem, Plan]) -> None:
    problem, plan = held_block_job
    run = sample_keyframes(problem, plan, 600)
    arm = problem.cell.arm("right")
    flange = kinematics.forward_kinematics(robots.robot(arm.robot), run.q["right"])
    np.testing.assert_allclose(run.block, arm.base @ flange @ arm.tool.tcp @ problem.stock.grip, atol=1e-9)
    assert np.ptp(run.block[:, :3, 3], axis=0).max() > 0.1


def test_what_is_cut_lies_where_the_targets_are(held_block_job: tuple[Problem, Plan]) -> None:
    """The middle of the wire passes the targets in the block, however the arms share the motion; between
    them the replay mixes joint angles, which is off by parts of a mm."""
    problem, plan = held_block_job
    operation = plan.operations[0]
    (cut,) = sample_keyframes(problem, plan, 600).sweeps
    expected = (np.linalg.inv(problem.stock.grip) @ operation.targets.pose["left"])[:, :3, 3]
    middle = cut.points.mean(axis=1)
    gap = np.linalg.norm(middle[:, None] - expected, axis=2).min(axis=1)
    step = np.linalg.norm(np.diff(expected, axis=0), axis=1).max()
    assert gap.max() < 0.55 * step
    assert np.linalg.norm(cut.points[:, 1] - cut.points[:, 0], axis=1) == pytest.approx(0.4)


def test_scenes_have_the_tools_and_the_block_of_their_setup(two_setups_job: tuple[Problem, Plan]) -> None:
    problem, plan = two_setups_job
    first, second = problem.setups
    seen = scene.extract_scene(
        plant.build_cell_model(first.cell, first.stock, plan.stock_poses[0], plan.bases)
    )
    assert not any(p.body == "stock" or p.body.endswith("/tool") for p in seen.pieces)
    item, other = scene.setup_pieces(first, np.eye(4)), scene.setup_pieces(second, np.eye(4))
    assert {p.body for p in item} - {p.body for p in other} == {"left/edge"}
    for setup, pieces in ((first, item), (second, other)):
        (block,) = [p for p in pieces if p.body == "stock"]
        corners = block.solid.moved(block.pose).vertices
        np.testing.assert_allclose(corners.min(axis=0), setup.stock.lower, atol=1e-12)
        np.testing.assert_allclose(corners.max(axis=0), setup.stock.upper, atol=1e-12)
    q = {"left": plan.operations[0].q["left"][:3]}
    poses = scene.scene_poses(seen, first, plan.stock_poses[0], q)
    edge = next(p for p in item if p.body == "left/edge")
    tcp = job.problem().cell.arm("left").base @ kinematics.forward_kinematics(
        robots.robot("irb140"), q["left"]
    )
    np.testing.assert_allclose(poses["left/edge"], tcp, atol=1e-9)
    np.testing.assert_allclose(
        scene.wire_ends(first.cell.arm("left")).mean(axis=0), edge.pose[:3, 3], atol=1e-12
    )


def test_replay_of_setups_is_one_small_file(two_setups_job: tuple[Problem, Plan]) -> None:
    problem, plan = two_setups_job
    first = problem.setups[0]
    text = replay.replay_html(
        plant.build_cell_model(first.cell, first.stock, plan.stock_poses[0], plan.bases), problem, plan
    )
    assert len(text) < 10_000_000
    assert '"setup"' in text


def test_there_is_a_picture_of_each_setup(two_setups_job: tuple[Problem, Plan]) -> None:
    problem, plan = two_setups_job
    first = problem.setups[0]
    model = plant.build_cell_model(first.cell, first.stock, plan.stock_poses[0], plan.bases)
    shown = cell_picture.setup_pictures(model, problem, plan)
    assert [title for title, _ in shown] == ["Setup 1: sides", "Setup 2: faces"]
    assert all(picture.alpha.max() > 0.9 for _, picture in shown)


def test_the_sheet_of_a_job_of_setups_says_what_to_do_in_each(two_setups_job: tuple[Problem, Plan]) -> None:
    problem, plan = two_setups_job
    text = output.report_html(problem, plan, None)
    sheet = text[text.index('id="setup"') :]
    item, other = sheet.split("<h3>Setup 2: faces</h3>")
    assert "<h3>Setup 1: sides</h3>" in item
    for part, setup in ((item, problem.setups[0]), (other, problem.setups[1])):
        assert all(f"<li>{step}</li>" in part for step in setup.steps) and setup.confirmation in part
    assert "bow_400" in item and "bow_400" not in other and "holder_left" in other
    assert "450.0 × 120.0 × 360.0" in item and "450.0" not in other  # with and without its oversize
    assert "400.0 mm" in item and "0.389 kg" in item  # 0.45 x 0.12 x 0.36 m of 20 kg/m^3
    # lower corner -x -y of the block as found: 220 - 200 - 30, -50 - 10, 240
    assert "−10.00, −60.00, 240.00" in item
    assert "3.0 to 6.0 mm/s" in item
    assert "kinks of 3.1 deg between strips" in text


def test_the_sheet_of_a_held_block_says_how_it_is_held(held_block_job: tuple[Problem, Plan]) -> None:
    problem, plan = held_block_job
    text = output.report_html(problem, plan, None)
    assert "gripper_plate of arm right" in text and "120 × 120" in text
    assert "0.173 kg" in text and "0.173 kg at 0.00, 0.00, 90.00 mm" in text  # 0.2 x 0.24 x 0.18 m
    assert "bottom corner −x −y, TCP frame of right" in text


def test_the_kerf_is_that_of_the_feeds(two_setups_job: tuple[Problem, Plan]) -> None:
    """The curve reads 1.75 mm at 3 mm/s and 1.3 mm at 6 mm/s; the bent wire's kerf lies between."""
    problem, plan = two_setups_job
    text = output.report_html(problem, plan, None)
    assert re.search(r"<b>1\.30–1\.75<small>mm</small></b><span>kerf at the allowed feeds</span>", text)
    table = KerfCurve(np.array([1e-3, 3e-3, 5e-3]), *(np.array([2e-3, 1e-3, 3e-3]),) * 3)
    triangle = np.zeros((3, 3)), np.array([[0, 1, 2]])
    cut = CutsSurface(Segment.read("cut/a"), *triangle, table, 1e-4)
    assert (
        report.kerf_range([cut], [FeedWindow(Segment.read("cut/a"), 2e-3, 4e-3)]) == "1.00–2.00"
    )  # least in between
    assert report.kerf_range([cut], []) == "1.00–3.00"
    constant = CutsSurface(Segment.read("cut/a"), *triangle, KerfCurve.constant(1.4e-3), 1e-4)
    assert report.kerf_range([constant], []) == "1.4"


def test_the_kerf_of_a_proven_cut_is_that_of_its_speeds() -> None:
    """2 mm at 3 mm/s and 1 mm at 6 mm/s: the wire passed at 4 to 5 mm/s, though 3 to 6 are allowed."""
    speeds = np.array([3e-3, 6e-3])
    table = KerfCurve(speeds, *(np.array([2e-3, 1e-3]),) * 3)
    name, triangle = Segment.read("cut/a"), (np.zeros((3, 3)), np.array([[0, 1, 2]]))
    cut, window = CutsSurface(name, *triangle, table, 1e-4), FeedWindow(name, 3e-3, 6e-3)
    three = np.zeros((3, 3)), np.zeros(3), np.ones(3)
    seen = np.array([4e-3, np.nan, 5e-3])
    face = CutFace(name, *three, 1e-4, 1.0, 0.95, 0.0, 0.0, speed=seen)
    proof = Proof("", (), (), {}, (face,), "")
    assert report.displayed_kerf([cut], [window], proof) == ("kerf of the cut", "1.33–1.67")
    assert report.displayed_kerf([cut], [window], None) == ("kerf at the allowed feeds", "1.00–2.00")


def test_series_of_straight_and_bent_wires_are_told_apart(two_setups_job: tuple[Problem, Plan]) -> None:
    """The proof counts all wires; only bent ones have a curvature and a limit of it."""
    problem, plan = two_setups_job
    proof = job.proof(50)
    series = dict(proof.series)
    bent = {name: series.pop(name) for name in list(series) if name.startswith("wire/1/")}
    series |= {name.replace("wire/1/", "wire/3/"): value for name, value in bent.items()}
    time = np.asarray(bent["wire/1/time"])
    series |= {"wire/1/time": time, "wire/1/feed": 0 * time + 0.004, "wire/1/label": ["cut/left"] * len(time)}
    motion = motion_charts.motion_series(problem, plan, dataclasses.replace(proof, series=series))
    (process,) = motion.processes
    (level,) = process.charts[0].levels
    assert level.value == 40.0
    assert len(motion.feed.time) == 2 * len(time) and motion.feed.upper[0] == 0.006


def test_a_refused_problem_of_setups_has_a_picture(held_block_job: tuple[Problem, Plan]) -> None:
    text = output.failure_report(held_block_job[0], ())
    assert 'id="cell"' in text


@pytest.mark.parametrize("passed", [True, False])
def test_the_proof_says_what_is_too_close(two_setups_job: tuple[Problem, Plan], passed: bool) -> None:
    """Between targets the proof allows a little less than the clearance required at them."""
    rule = RuleResult("verify.clearance", "bodies keep apart", passed, 9.8, 10.0, "mm")
    series = {**job.proof(50).series, "clearance/distance": np.full(50, 0.0098)}
    proof = dataclasses.replace(job.proof(50), rules=(rule,), series=series)
    text = output.report_html(*two_setups_job, proof)
    (kind,) = re.findall(r'<div class="(tile[^"]*)"><b>9\.8<small>mm</small>', text)
    assert ("bad" in kind) != passed
