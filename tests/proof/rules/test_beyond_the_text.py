"""Rules for faults that are not in the text alone: the cell, the claim or the posture is wrong."""

from __future__ import annotations

import dataclasses
import functools
import re
from pathlib import Path

import numpy as np
import pytest

from planner.catalogue.robots import robot
from planner.cell.plant import build_cell_model
from planner.geometry.arrays import Shape, from_rpy
from planner.issue_codes import CODES
from planner.issues import Issue, with_remedy
from planner.problem import Arm, Cell, Controller, Obstacle, Problem, Settings, Stock
from planner.processes.hotwire.claims import CutsSurface, KerfCurve, WireJoins
from planner.processes.poses.claims import FollowsPoses
from planner.proof.context import Context
from planner.proof.models import MODELS
from planner.proof.prove import Prover
from planner.proof.replay.motion import Poses
from planner.proof.rules import robot_motion
from planner.tooling import PlainTool
from tests.languages.rapid.rapid_edits import (
    both,
    change,
    field,
    lines,
    moves,
    name,
    put,
    segment,
    shifted,
    timed,
)
from tests.proof import small_job
from tests.proof.provers import broken, prover

COUNT = 12
UNUSED = "[9E9,9E9,9E9,9E9,9E9,9E9]"


@functools.cache
def programs():
    return small_job.programs(COUNT)


def issues(code, texts=None, job=None, claims=None):
    """Issues of one rule."""
    proof = Prover(job or small_job.problem(), claims or small_job.claims()).prove(
        texts or programs(), last=code
    )
    assert proof.rule(code).ran
    return [issue for issue in proof.issues if issue.code == code]


def wire_claim(**changes):
    group = small_job.claims()["panel"]
    return {
        "panel": tuple(dataclasses.replace(c, **changes) if isinstance(c, WireJoins) else c for c in group)
    }


# ---- settings of the problem that the motion does not meet -----------------------------------------


def test_singularity():
    job = small_job.problem(singularity_margin=np.deg2rad(60.0))
    found = issues("verify.singularity", job=job)
    assert found
    assert found[0].value < 60.0


def test_tcp_speed():
    assert issues("verify.tcp_speed", job=small_job.problem(tcp_speed=0.03))


def test_clearance_of_bodies_and_wire():
    job = small_job.problem(clearance=0.3)
    proof = Prover(job, small_job.claims()).prove(programs(), last="verify.wire_clearance")
    assert broken(proof) >= {"verify.clearance", "verify.wire_clearance"}


def test_wire_clearance_names_the_obstacle():
    job = small_job.problem()
    post = Shape("box", (0.02, 0.02, 0.02), from_rpy([0.0, small_job.AWAY - 0.015, 0.53], [0.0, 0.0, 0.0]))
    cell = dataclasses.replace(job.cell, obstacles=(Obstacle("post", (post,)),))
    found = issues("verify.wire_clearance", job=dataclasses.replace(job, cell=cell))
    assert any("post" in issue.bodies for issue in found)


def test_joint_speed():
    texts = programs()
    for k in segment(texts, "approach"):
        texts = timed(texts, k, 0.02)
    assert issues("verify.joint_speed", texts)


def test_what_to_do_is_told_where_a_rule_does_not_say_so_itself():
    found = issues("verify.tcp_speed", job=small_job.problem(tcp_speed=0.03))
    assert {issue.hint for issue in found} == {CODES["verify.tcp_speed"].remedy}
    own = Issue("verify.tcp_speed", "too fast", hint="stop there")
    assert with_remedy(own) == own
    assert with_remedy(Issue("verify.syntax", "what")).hint is None


# ---- the wire ----------------------------------------------------------------------------------------


def test_curvature():
    found = issues("verify.curvature", claims=wire_claim(max_curvature=2.0))
    assert found
    assert found[0].value > 2.0
    assert found[0].limit == 2.0


def test_a_wire_that_snaps():
    """Both ends turned from an upward arch to a downward one: it must give way somewhere."""
    texts = programs()
    air = segment(texts, "approach")
    for k, turn in zip(air, np.linspace(0.0, 1.2, len(air)), strict=True):
        for task, sign in ((1, -1.0), (2, 1.0)):
            w, x, y, z = (float(v) for v in field(texts, task, k, "orient").split(","))
            c, s = np.cos(0.5 * sign * turn), np.sin(0.5 * sign * turn)
            q = np.array([w * c - z * s, x * c + y * s, y * c - x * s, z * c + w * s])
            texts = change(texts, task, k, orient=",".join(f"{v:.8f}" for v in q / np.linalg.norm(q)))
    for k in air:
        texts = timed(texts, k, 4.0)
    found = issues("verify.wire_stability", texts)
    assert found
    assert "snaps" in found[0].message


def test_ends_farther_apart_than_the_wire_is_long():
    found = issues("verify.wire_length", claims=wire_claim(length=0.48))
    assert "480.000 mm" in found[0].message


# ---- motion ------------------------------------------------------------------------------------------


def test_a_zone_between_a_joint_move_and_a_straight_one():
    texts = programs()
    k = segment(texts, "approach")[1]
    pose = {
        arm: small_job.ends(np.array([float(field(texts, 1, k, "pos").split(",")[1]) * 1e-3]), False)[arm]
        for arm in ("left", "right")
    }
    for task, arm in ((1, "left"), (2, "right")):
        q = np.rad2deg(small_job.joints_at(small_job.problem().cell.arm(arm), pose[arm])[0])
        rows = lines(texts, task)
        i = moves(texts, task)[k]
        joints = ",".join(f"{v:.6f}" for v in q)
        tail = rows[i][rows[i].index("\\ID") :].split("\\WObj")[0]
        rows[i] = f"    MoveAbsJ [[{joints}],{UNUSED}]{tail.replace(',', chr(92) + 'NoEOffs,', 1)};"
        texts = put(texts, task, rows)
    assert issues("verify.corner", texts)


def test_drake_must_put_the_tools_where_the_replay_has_them():
    context = Context(small_job.problem(), small_job.claims(), programs())
    model = build_cell_model(context.problem.cell, context.problem.stock, context.stock_pose, context.bases)
    context.put(MODELS, lambda index: model)
    assert robot_motion.kinematics(context).issues == ()
    motion = context.motion
    off = {arm: Poses.of(pose[:]) for arm, pose in motion.tcp.items()}
    off["left"].position[:, 0] += 2.0 * robot_motion.TCP_TOLERANCE_M
    context.__dict__["motion"] = dataclasses.replace(motion, tcp=off)
    found = robot_motion.kinematics(context).issues
    assert {issue.code for issue in found} == {"verify.kinematics"}


def follow_claim(by=0.0):
    y = np.linspace(small_job.OUT, -small_job.OUT, COUNT + 1)
    poses = small_job.ends(y, False)["left"].copy()
    poses[COUNT // 2, 2, 3] += by
    return {"panel": (FollowsPoses("left", "stock", poses, (), 1e-5, 1e-4),)}


def test_follows_the_given_poses():
    assert issues("verify.follows", claims=follow_claim()) == []
    found = issues("verify.follows", claims=follow_claim(2e-5))
    assert len(found) == 1
    assert found[0].index == COUNT // 2


ROD_ARM = """MODULE Rod
  CONST string problem_digest:="@";
  CONST pose base_frame:=[[0.0000,0.0000,0.0000],[1,0,0,0]];
  TASK PERS tooldata tip:=[TRUE,[[0.0000,0.0000,100.0000],[1,0,0,0]],[1,[0,0,50],[1,0,0,0],0,0,0]];
  PROC main()
    UIMsgBox\\Header:="Tandem","Clear?"\\Buttons:=btnOK\\Icon:=iconInfo;
    MoveAbsJ [[0,#2,#3,0,30,0],[9E9,9E9,9E9,9E9,9E9,9E9]]\\NoEOffs,v100,fine,tip;
  ERROR
    StopMove\\Quick;
    Stop;
    EXIT;
  ENDPROC
ENDMODULE
"""


@pytest.mark.parametrize(("axis2", "axis3", "broken"), [(20.0, 30.0, False), (94.0, None, True)])
def test_both_limits_of_a_parallel_rod_arm(axis2, axis3, broken):
    """IRB 4400: the controller's axis 3 (serial plus axis 2) beyond its limit, the serial one inside."""
    machine = robot("irb4400_60")
    if axis3 is None:
        axis3 = float(np.rad2deg(machine.coupling.axis3_upper)) + 2.0
        serial = np.deg2rad(axis3 - axis2)
        assert machine.lower[2] < serial < machine.upper[2]
    tool = PlainTool("tip", from_rpy([0.0, 0.0, 0.1], [0.0, 0.0, 0.0]), 1.0, np.array([0.0, 0.0, 0.05]), ())
    arm = Arm("left", "irb4400_60", np.eye(4), tool, np.zeros(6))
    job = Problem(
        "rod",
        Cell("rod", (arm,), (), Controller(tasks=("T_ROB1",), units=("ROB_1",))),
        Stock(np.array([0.1, 0.1, 0.1]), from_rpy([3.0, 0.0, 0.0], [0.0, 0.0, 0.0]), np.eye(3)),
        None,
        (small_job.Operation(arms=("left",)),),
        Settings(),
        Path("rod.yaml"),
        small_job.DIGEST,
    )
    text = ROD_ARM.replace("@", small_job.DIGEST).replace("#2", f"{axis2:g}").replace("#3", f"{axis3:.6f}")
    proof = Prover(job, {}).prove({"T_ROB1/Rod.mod": text}, last="verify.rod_limits")
    found = {issue.code for issue in proof.issues}
    assert proof.rule("verify.rod_limits").ran, [str(issue) for issue in proof.issues]
    assert ("verify.rod_limits" in found) is broken


# ---- the surface ---------------------------------------------------------------------------------------


def test_a_face_that_the_wire_does_not_reach():
    group = small_job.claims()["panel"]
    wide = tuple(
        dataclasses.replace(c, vertices=c.vertices * [1.0, 2.2, 1.0]) if isinstance(c, CutsSurface) else c
        for c in group
    )
    proof = Prover(small_job.problem(), {"panel": wide}).prove(programs(), last="verify.surface")
    assert not proof.rule("verify.surface").passed
    for face in proof.surfaces:
        passed = np.isfinite(face.deviation)
        assert np.abs(face.points[~passed, 1]).min() > small_job.OUT - 1e-3
        assert face.area[~passed].sum() / face.area.sum() > 0.15


def test_the_wrong_kerf_shows_as_its_half():
    group = small_job.claims()["panel"]
    more = tuple(
        dataclasses.replace(c, kerf=KerfCurve.constant(float(c.kerf.width[0]) + 0.001))
        if isinstance(c, CutsSurface)
        else c
        for c in group
    )
    proof = Prover(small_job.problem(), {"panel": more}).prove(programs(), last="verify.surface")
    for face in proof.surfaces:
        assert face.rms == pytest.approx(0.0005, abs=1e-5)
        assert np.all(face.deviation < 0.0)


def test_a_target_that_stands_out_is_named():
    texts = programs()
    k = segment(texts, "cut_front")[6]
    texts = both(texts, k, lambda t, task, i: shifted(t, task, i, np.array([0.0, 0.0, 1.0])))
    found = issues("verify.ridge", texts)
    assert field(texts, 1, k, "id") in {re.sub("ID ", "", issue.target) for issue in found}
    assert name("Cut1", 1) in texts


def test_the_stated_end_error_is_carried_to_the_surface():
    """A bowed wire moves by about its ends' error, and in proportion to it."""
    proof = prover("small").prove(programs())
    for face in proof.surfaces:
        assert 0.5 * 5e-5 < face.end_error < 5.0 * 5e-5
        assert face.share_with_error == 1.0
    large = wire_claim(end_error=3e-4)
    worse = Prover(small_job.problem(), large).prove(programs())
    for face, other in zip(proof.surfaces, worse.surfaces, strict=True):
        assert other.end_error == pytest.approx(6.0 * face.end_error, rel=0.05)
