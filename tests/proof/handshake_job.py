"""A small job of two arms with a controller each: both move along their sides of a block, and meet."""

from __future__ import annotations

import dataclasses
import functools

from planner.claims.dialogue import DialogueStep, OperatorDialogue, question_step
from planner.claims.handshake import Handshake
from planner.claims.sentences import Sentence
from planner.languages.writing import write
from planner.problem import Controller
from planner.targets import TargetAction
from tests import line_ends
from tests.proof import small_job

ARMS = ("left", "right")


def problem(kind="four_phase", every=1):
    """The cell of the job, whose controllers share two wires."""
    there = small_job.problem()
    controller = Controller(
        ("T_ROB1",) * 2, ("ROB_1",) * 2, sync="handshake", handshake=Handshake(kind, every)
    )
    return dataclasses.replace(there, cell=dataclasses.replace(there.cell, controller=controller))


def plan(count=8):
    """The plan: the path of the small job's arms, without the wire between them."""
    whole = small_job.plan(count)
    (operation,) = whole.operations
    actions = (
        TargetAction(0, "confirm", text="Is the block in place?"),
        TargetAction(0, "wait", seconds=1.0),
    )
    targets = dataclasses.replace(operation.targets, coupled=False, actions=actions)
    return dataclasses.replace(whole, operations=(dataclasses.replace(operation, targets=targets),))


def claims():
    """Only the operator dialogue and the claims of every job."""
    first = (question_step(Sentence("Is the block in place?")), DialogueStep("wait", seconds=1.0))
    return {"panel": (OperatorDialogue(ARMS, first),)}


@functools.cache
def programs(kind="four_phase", every=1, count=8):
    """The texts of the job as the planner writes them."""
    return line_ends.bare(write.program_files(plan(count), problem(kind, every)))
