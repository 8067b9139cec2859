"""Two UR10e with a controller each: both move along a block and meet on the way.

In between, one of them switches a spindle on and off and asks the operator.
"""

from __future__ import annotations

import dataclasses
import functools

import numpy as np

from planner.claims.dialogue import DialogueStep, DialogueStop, OperatorDialogue, message_step, question_step
from planner.claims.handshake import Handshake
from planner.claims.segments import Segment
from planner.claims.sentences import Sentence
from planner.geometry.arrays import from_rpy
from planner.languages.writing import write
from planner.problem import Arm, Controller
from planner.proof.kinematics import arm_model, inverse_kinematics
from planner.targets import TargetAction
from planner.tooling import wire_holder
from tests import urdf_text
from tests.proof import small_job

ARMS = ("left", "right")
BASES = {
    "left": from_rpy([-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]),
    "right": from_rpy([1.0, 0.0, 0.0], [0.0, 0.0, np.pi]),
}
SIGNAL = "doGripper"
LINES = ("doPartner", "diPartner", "doRunning", "diPartnerRunning")
NUMBERS = {"left": (0, 0, 1, 1), "right": (2, 2, 3, 3)}
JOINT_GUESS = np.deg2rad([180.0, -60.0, 100.0, -130.0, -90.0, 0.0])
"""Joints near home."""
QUESTION = "Is the block in place?"
AGAIN = "Go on?"


def io(signal=9):
    """Numbers of the signals by arm; ``signal``: of what the left arm switches."""
    out = {arm: dict(zip(LINES, numbers, strict=True)) for arm, numbers in NUMBERS.items()}
    out["left"][SIGNAL] = signal
    return out


@functools.cache
def _data():
    return urdf_text.ur10e_data()


@functools.cache
def _arms(right):
    """The left arm is a UR10e; so is the right one, or it is the ``irb140`` of the small job."""
    ends = small_job.ends(np.array([small_job.AWAY]), False, 0.15)
    out = []
    for name, side in (("left", "start"), ("right", "end")):
        bare = Arm(name, "ur10e", BASES[name], wire_holder("across", side), JOINT_GUESS, custom_data=_data())
        out.append(dataclasses.replace(bare, home=_joints(bare, ends[name])[0]))
    if right == "irb140":
        out[1] = small_job.problem().cell.arms[1]
    return tuple(out)


def _joints(arm, pose):
    """Joints (N, 6) of TCP poses (N, 4, 4) in the block's frame, by the branch of the arm's home."""
    machine = arm_model.robot_machine(arm.data)
    flange = np.linalg.inv(arm.base) @ small_job.STOCK @ pose @ np.linalg.inv(arm.tool.tcp)
    branch = np.full(len(pose), int(inverse_kinematics.branch_of(machine, arm.home)))
    q = inverse_kinematics.unwrapped_path(
        machine, inverse_kinematics.solve(machine, flange, branch), arm.home
    )
    assert np.isfinite(q).all(), arm.name
    return q


def problem(kind="four_phase", every=1, numbers=None, right="ur10e"):
    """The cell of the job, whose controllers share four wires."""
    there = small_job.problem()
    controller = Controller(
        ("T_ROB1",) * 2,
        ("ROB_1",) * 2,
        sync="handshake",
        handshake=Handshake(kind, every),
        io=io() if numbers is None else numbers,
    )
    cell = dataclasses.replace(there.cell, controller=controller, arms=_arms(right))
    return dataclasses.replace(there, cell=cell)


def plan(count=2, switched=True, right="ur10e"):
    """Return the plan: the path of the small job's arms, without the wire between them.

    The left arm asks at the first targets and where the path reverses. Unless ``switched`` is False, it
    switches there too.
    """
    whole = small_job.plan(count)
    (operation,) = whole.operations
    arms = {arm.name: arm for arm in _arms(right)}
    targets = operation.targets
    q = {name: _joints(arm, targets.pose[name]) for name, arm in arms.items()}
    turn = next(i for i, segment in enumerate(targets.segment) if str(segment) == "link") - 1
    actions = (
        TargetAction(0, "message", text="Mount a block."),
        TargetAction(0, "confirm", text=QUESTION),
        TargetAction(0, "on", signal=SIGNAL),
        TargetAction(0, "wait", seconds=1.0),
        TargetAction(turn, "off", signal=SIGNAL),
        TargetAction(turn, "confirm", text=AGAIN),
        TargetAction(turn, "on", signal=SIGNAL),
        TargetAction(targets.count - 1, "off", signal=SIGNAL),
    )
    if not switched:
        actions = tuple(action for action in actions if not action.signal)
    own = dataclasses.replace(targets, coupled=False, actions=actions)
    made = dataclasses.replace(
        operation,
        targets=own,
        q=q,
        time=1.5 * operation.time,
        approach={name: np.stack([arms[name].home, q[name][0]]) for name in ARMS},
        retreat={name: np.stack([q[name][-1], arms[name].home]) for name in ARMS},
    )
    return dataclasses.replace(whole, operations=(made,), bases={arm.name: arm.base for arm in _arms(right)})


def claims():
    """Claims of the job without switching: the operator dialogue and the claims of every job."""
    first = (
        message_step(Sentence("Mount a block.")),
        question_step(Sentence(QUESTION)),
        DialogueStep("wait", seconds=1.0),
    )
    stop = DialogueStop(Segment.read("link"), "before", (question_step(Sentence(AGAIN)),))
    return {"panel": (OperatorDialogue(ARMS, first, stops=(stop,)),)}


@functools.cache
def programs(kind="four_phase", every=1, count=2, switched=True, right="ur10e"):
    """The texts of the job as the planner writes them, with bare line feeds."""
    texts = write.program_files(plan(count, switched, right), problem(kind, every, right=right))
    return {
        path: text.replace("\r\n", "\n") if path.endswith(".script") else text for path, text in texts.items()
    }
