"""Jobs as joint trajectories, end to end.

Poses with a Panda and an iiwa, a wing cut by a bow on an iiwa, and a bent wire between two Fanuc robots. What
the language cannot express is refused with a message.
"""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
import yaml

from planner import pipeline
from planner.catalogue.robots import data_dir, robot
from planner.geometry.arrays import inverse, log_rotation
from planner.issues import TandemError
from planner.languages.trajectories.writer import clocks, curves, program, straight_segments
from planner.languages.writing import write
from planner.reading.urdf import read_chain
from planner.report import setup_sheet
from planner.shopfloor.loading import proven
from tests import test_seven_axes_jobs as seven
from tests import test_ur_jobs
from tests.languages.trajectories import driven_job
from tests.processes.hotwire.proof import straight_job
from tests.proof import planner_jobs, small_job

PROBLEMS = data_dir("problems")
TIP = ("base_link", "tool0")


def write_driven_job(source, **more):
    source["cell"]["controller"] = {"language": "ros", **more}
    return source


def row(tmp_path, name, turns=0.1):
    source, table = seven.row_of_poses(turns)
    return seven.write_job(tmp_path, name, write_driven_job(source), table)


def wing(tmp_path):
    source = write_driven_job(test_ur_jobs.wing())
    return seven.write_job(tmp_path, "iiwa", source)


def facing(**more):
    """Return the cell of two facing Fanuc robots, with the wall that is cut by a bent wire."""
    source = yaml.safe_load((PROBLEMS / "wave_wall" / "problem.yaml").read_text("utf-8"))
    source["cell"] = yaml.safe_load((PROBLEMS / "cells" / "two_irb140_facing.yaml").read_text("utf-8"))
    for arm in source["cell"]["arms"]:
        arm["robot"] = "crx10ia_l"
        del arm["home_deg"]
    return write_driven_job(source, **more)


def load_problem(tmp_path, source):
    (tmp_path / "problem.yaml").write_text(yaml.safe_dump(source), "utf-8")
    return pipeline.load(tmp_path / "problem.yaml")


def points(text):
    """Times, joints and velocities of the longest move, by the rows alone."""
    moves, out = [], []
    for line in text.split("\r\n")[:-1]:
        found = json.loads(line)
        if "move" in found:
            out = []
            moves.append(out)
        elif "t" in found:
            out.append((found["t"], found["q"], found["v"]))
    t, q, v = zip(*max(moves, key=len), strict=True)
    return np.array(t), np.array(q), np.array(v)


def test_seven_joints_are_driven_along_poses_and_proven(tmp_path):
    problem = row(tmp_path, "panda")
    outcome = pipeline.plan(problem)
    assert outcome.proof.ok, [str(issue) for issue in outcome.proof.issues]
    ((name, text),) = outcome.programs.items()
    assert name == "small.trajectory.jsonl"
    t, q, v = points(text)
    assert q.shape[1] == 7 and (np.diff(t) > 0.0).all() and not v[-1].any()
    # the tool on the cubics of the text goes straight from pose to pose, by the URDF alone
    chain, arm = read_chain(seven.TEXTS["panda"], *TIP), problem.cell.arms[0]
    joints = outcome.plan.operations[0].q["left"]
    ends = chain.tip(joints) @ arm.tool.tcp
    span = np.diff(t)[:, None]
    for fraction in (0.2, 0.5, 0.8):
        h = fraction**2 * (3.0 - 2.0 * fraction)
        middle = (
            (1.0 - h) * q[:-1]
            + h * q[1:]
            + fraction * (1.0 - fraction) * span * ((1.0 - fraction) * v[:-1] - fraction * v[1:])
        )
        pose = chain.tip(middle) @ arm.tool.tcp
        away = pose[:, None, :3, 3] - ends[None, :-1, :3, 3]
        way = np.diff(ends[:, :3, 3], axis=0)
        along = np.clip((away * way).sum(axis=2) / (way**2).sum(axis=1), 0.0, 1.0)
        assert np.linalg.norm(away - along[..., None] * way, axis=2).min(axis=1).max() < 0.1e-3
    for pose in ends:  # and passes each
        deviation = inverse(pose) @ chain.tip(np.concatenate([joints[:1], q])) @ arm.tool.tcp
        error = np.linalg.norm(deviation[:, :3, 3], axis=1) + np.linalg.norm(
            log_rotation(deviation[:, :3, :3]), axis=1
        )
        assert error.min() < 1e-6


def test_the_sheet_says_what_the_controller_must_have_and_nothing_is_uploaded(tmp_path):
    problem = row(tmp_path, "iiwa")
    outcome = pipeline.plan(problem)
    assert outcome.proof.ok
    table = setup_sheet.controller_checks(outcome.problem, outcome.plan)
    assert "joint_trajectory_controller" in str(table) and "j1, j2, j3, j4, j5, j6, j7" in str(table)
    assert "RAPID" not in str(table)
    assert "interpolate_from_desired_state" in str(table) and "4.12" in str(table)
    outcome.save(tmp_path / "out")
    assert pipeline.verify(problem, pipeline.read_programs(tmp_path / "out")).ok
    with pytest.raises(TandemError, match="runner"):
        proven.select_programs(proven.Proven(outcome.problem, {}), None)


def test_a_wing_is_cut_by_a_bow_on_seven_axes(tmp_path):
    outcome = pipeline.plan(wing(tmp_path))
    assert outcome.proof.ok, [str(issue) for issue in outcome.proof.issues]
    (text,) = outcome.programs.values()
    hot = [json.loads(line) for line in text.split("\r\n")[:-1] if '"on_failure":["doWirePower"]' in line]
    assert [next(iter(line)) for line in hot] == ["dwell", "at", "move"]


@pytest.mark.long
def test_a_wall_is_cut_by_a_bent_wire_between_two_fanuc(tmp_path):
    prefix = {"left": "left_", "right": "right_"}
    outcome = pipeline.plan(load_problem(tmp_path, facing(joint_prefix=prefix)))
    assert outcome.proof.ok, [str(issue) for issue in outcome.proof.issues]
    (text,) = outcome.programs.values()
    assert points(text)[1].shape[1] == 12


def expect_refusal(problem):
    with pytest.raises(TandemError) as caught:
        pipeline.plan(problem)
    return caught.value.issues


def test_joints_of_one_name_are_refused_and_the_prefix_that_is_told_helps():
    problem, plan = driven_job.bent_problem(), small_job.plan()
    controller = dataclasses.replace(problem.cell.controller, joint_prefix={})
    alike = dataclasses.replace(problem, cell=dataclasses.replace(problem.cell, controller=controller))
    with pytest.raises(TandemError) as caught:
        write.program_files(plan, alike)
    (issue,) = caught.value.issues
    assert issue.code == "post.name" and "joint_1" in issue.message
    told = yaml.safe_load(issue.hint.partition("controller: ")[2].partition(", as")[0])
    controller = dataclasses.replace(controller, **told)
    cell = dataclasses.replace(problem.cell, controller=controller)
    assert write.program_files(plan, dataclasses.replace(problem, cell=cell)) == driven_job.bent_programs()


def test_joints_that_rows_cannot_name_are_refused_before_anything_is_planned(tmp_path):
    problem = row(tmp_path, "panda")
    (arm,) = problem.cell.arms
    file = dataclasses.replace(arm.data.file, joints=("1st joint", *arm.data.file.joints[1:]))
    arm = dataclasses.replace(arm, custom_data=dataclasses.replace(arm.data, file=file))
    odd = dataclasses.replace(problem, cell=dataclasses.replace(problem.cell, arms=(arm,)))
    (issue,) = pipeline.check(odd)
    assert issue.code == "post.name" and "'1st joint'" in issue.message


def job_points(tmp_path, name):
    """A job of the proof's tests whose arms trajectories drive."""
    path = planner_jobs.JOBS[name](tmp_path)
    source = yaml.safe_load(path.read_text("utf-8"))
    names = [arm["name"] for arm in source["cell"]["arms"]]
    source["cell"]["controller"] = {"language": "ros", "joint_prefix": {name: f"{name}_" for name in names}}
    path.write_text(yaml.safe_dump(source), "utf-8")
    return pipeline.load(path)


def test_arms_that_bend_are_commanded_where_they_then_stand(tmp_path):
    outcome = pipeline.plan(job_points(tmp_path, "posed_sag"))
    assert outcome.proof.ok, [str(issue) for issue in outcome.proof.issues]
    (rule,) = (rule for rule in outcome.proof.rules if rule.code == "verify.sag")
    assert rule.worst > 0.1


def test_a_wire_keeps_its_feed_round_the_corners_of_a_hole(tmp_path):
    outcome = pipeline.plan(job_points(tmp_path, "plate"))
    assert outcome.proof.ok, [str(issue) for issue in outcome.proof.issues]


def test_a_torch_is_refused(tmp_path):
    (issue,) = expect_refusal(job_points(tmp_path, "trim"))
    assert issue.code == "post.controller" and "torch" in issue.message and "mill" in issue.hint


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"sync": "handshake"}, "one controller moves all joints"),
        ({"joint_prefix": {"middle": "m_"}}, "no arm middle"),
        ({"language": "own", "joint_prefix": {"left": "l_"}}, "language is own"),
        ({"path_tolerance_deg": 0}, "greater than 0"),
    ],
)
def test_what_does_not_fit_in_a_cell_is_told(tmp_path, change, words):
    with pytest.raises(TandemError, match=words):
        load_problem(tmp_path, facing(**change))


def test_tracks_are_refused(tmp_path):
    source = facing()
    source["cell"]["arms"][0]["track"] = {"axis": [1, 0, 0], "range_mm": [0, 1000]}
    with pytest.raises(TandemError, match="track"):
        load_problem(tmp_path, source)


def test_a_way_that_no_points_keep_is_told_and_a_stop_there_helps(monkeypatch):
    arm = driven_job.bow_problem().cell.arms[0]
    one = straight_segments.TrajectoryArm(arm.data, arm.base, arm.tool.tcp, slice(0, 6))
    q = straight_job.plan(12).operations[0].q["left"][:3].copy()
    q[2] = q[0] + 1e-3  # back again
    none = np.zeros(2, dtype=bool)
    feeds = np.full((1, 2), np.inf), np.zeros((1, 2))
    expected = curves.SegmentRequirements(np.array([0.3, 0.3]), 0.25, *feeds, np.zeros(2), none, none)
    with monkeypatch.context() as patched:
        patched.setattr(curves, "_MAX_INSERTION_ROUNDS", 2)
        with pytest.raises(straight_segments.PathNotKeptError, match="points do not keep the path"):
            curves.fit_curve([one], q, np.array([False, True]), expected)
        made = curves.fit_curve([one], q, np.array([True, True]), expected)
    assert np.count_nonzero(~made.v.any(axis=1)) == 3
    with monkeypatch.context() as patched:  # by itself, where it may
        patched.setattr(curves, "_MAX_INSERTION_ROUNDS", 2)
        made = curves.fit_curve(
            [one], q, np.array([False, True]), dataclasses.replace(expected, may_stop=~none)
        )
    assert np.count_nonzero(~made.v.any(axis=1)) == 3
    with monkeypatch.context() as patched:
        patched.setattr(curves, "MAX_DEVIATION_M", 1e-12)
        with pytest.raises(TandemError) as caught:
            write.program_files(straight_job.plan(12), driven_job.bow_problem())
    (issue,) = caught.value.issues
    assert issue.code == "post.trajectory" and "top" in issue.message and "stop" in issue.hint


ENDS_SLOWLY = (
    (-2.872011, -0.398768, -3.005884, 0.024206, 1.120486, 1.000752),
    (-2.870872, -0.380061, -2.981611, 0.012405, 1.07298, 1.000542),
    (-2.86986, -0.361211, -2.956353, 0.0, 1.024346, 1.000335),
)
"""Joints [rad] at a cut's last targets and at that of its way out."""


def test_no_point_is_set_on_the_end_of_a_slow_way():
    """In the middle of its time the cubic swings beyond the end: a move went nowhere, which is not proven."""
    one = straight_segments.TrajectoryArm(robot("hc10dtp"), np.eye(4), np.eye(4), slice(0, 6))
    q = np.array(ENDS_SLOWLY)
    none, feeds = np.zeros(2, dtype=bool), (np.ones((1, 2)), np.zeros((1, 2)))
    expected = curves.SegmentRequirements(np.array([0.1505, 0.6384]), 1.0, *feeds, np.zeros(2), none, none)
    made = curves.fit_curve([one], q, np.array([False, True]), expected)
    assert np.abs(np.diff(made.q, axis=0)).max(axis=1).min() > 1e-4


def test_arms_of_any_family_may_be_driven():
    problem = driven_job.bow_problem()
    assert problem.cell.arms[0].data.family == "ROS"
    assert dataclasses.replace(problem.cell.arms[0].data, family="ABB").name == "irb140"


FAST = {"feed_mm_s": 26.2, "feed_min_mm_s": 0.4, "power_w": 220.2}
"""A feed at which the trailing edge is a corner that arms are slow at."""


def thick_wing(tmp_path, **op):
    """A wing with a blunt trailing edge, whose bow an iiwa drives."""
    source = write_driven_job(test_ur_jobs.wing())
    source["operations"][0].update(op)
    wing = source["part"]["wing"]
    wing["root"]["chord_mm"], wing["tip"]["chord_mm"], wing["trailing_edge_mm"] = 196, 158, 4
    return seven.write_job(tmp_path, "iiwa", source)


def test_a_feed_that_no_arm_keeps_at_a_corner_is_refused_with_one_that_it_keeps(tmp_path):
    """The proof would refuse the program: the clock itself is slower than the least feed."""
    (issue, *_) = expect_refusal(thick_wing(tmp_path, **{**FAST, "feed_min_mm_s": 18.0}))
    assert issue.code == "motion.feed_min" and issue.severity == "error"
    assert issue.value < issue.limit == pytest.approx(18.0)
    held = float(issue.hint.partition("feed_min_mm_s: ")[2].partition(",")[0])
    assert 0.85 * issue.value < held < issue.value


def test_the_process_judges_slots_by_the_clock_that_points_have(tmp_path, monkeypatch):
    """A tool slows down before a corner and behind it: what melts there is wider than by the plan's clock,
    and the proof sees it."""
    problem = thick_wing(tmp_path, **FAST)
    (issue, *_) = expect_refusal(problem)
    assert issue.code == "straight.uneven"
    monkeypatch.setattr(program, "splice_clocks", lambda time, runs: np.stack([np.arange(len(time)), time]))
    assert not pipeline.plan(problem).proof.ok


def test_clocks_of_curves_tell_when_places_between_targets_are_passed():
    arm = driven_job.bow_problem().cell.arms[0]
    one = straight_segments.TrajectoryArm(arm.data, arm.base, arm.tool.tcp, slice(0, 6))
    q = straight_job.plan(12).operations[0].q["left"][:4]
    t = np.array([0.0, 1.0, 3.0, 3.5])
    still = curves.TrajectoryPoints(t, q, np.zeros_like(q), np.array([-1, 0, 1, 2]))
    place, when = clocks.passing_times(one, q, still)
    np.testing.assert_allclose(np.interp(t, when, place), np.arange(4.0), atol=1e-3)
    assert (np.diff(place) >= 0.0).all() and np.interp(1.2, when, place) < 1.1  # slow from rest
    whole = clocks.splice_clocks(np.arange(8.0), [(np.array([3, 4, 6]), np.stack([np.arange(4.0), t]))])
    assert (np.diff(whole, axis=1) >= 0.0).all()
    np.testing.assert_allclose(
        np.interp([0.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0], *whole), [0.0, 2.0, 3.0, 5.0, 5.25, 5.5, 6.5]
    )
