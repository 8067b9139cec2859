"""Rules on setups: who confirms them, and what stands where in each of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.catalogue import RobotData, robot
from planner.issues import Issue
from planner.verify.context import Context, Outcome
from planner.verify.findings import at_step
from planner.verify.setups import Asked, all_asked, one_line, told
from planner.verify.steps import ChoiceStep, MessageStep, MoveStep, Step
from planner.verify.values import JointTarget
from planner.verify.words import letters

FloatArray = NDArray[np.float64]

HOME = 1e-4
"""How far a joint may be off home [rad] to be there."""


def setup(context: Context) -> Outcome:
    """Each setup is told and confirmed once, in order, with all arms at home and nothing moving till then,
    and no arm moves at all before the operator has confirmed something."""
    issues: list[Issue] = _unasked(context)
    last = -1
    for index, here in enumerate(context.setups):
        if not here.steps:
            if index:
                what = f"setup {here.number} changes the cell, but says nothing that could be confirmed"
                issues.append(Issue("verify.setup", what, hint="name the setup's steps"))
            continue
        places = context.spans.asked[index]
        if len(places) != 1:
            count = f"{len(places)} times" if places else "never"
            what = f"the confirmation of setup {here.number} is asked for {count}; it must be asked for once"
            step = places[1] if places else None
            issues.append(_at(step, what) if step else Issue("verify.setup", what, hint=here.confirmation))
            continue
        (place,) = places
        if place.stage <= last:
            issues.append(_at(place, f"setup {here.number} is confirmed before the one that comes first"))
        last = max(last, place.stage)
        if not place.step.certain:
            issues.append(_at(place, f"setup {here.number} goes on without anybody pressing OK"))
        shown, wanted = told(context.job, place), "".join(letters(step) for step in here.steps)
        if shown != wanted:
            missing = next((step for step in here.steps if letters(step) not in shown), None)
            what = "with something else than what is to be done" if missing is None else f"without: {missing}"
            issues.append(_at(place, f"setup {here.number} is confirmed {what}"))
        issues += _standing(context, place, here.number, first=index == 0)
    issues += _lookalikes(context)
    return Outcome(tuple(issues), where="" if any(s.steps for s in context.setups) else "one setup")


def _unasked(context: Context) -> list[Issue]:
    """A first move that nobody has confirmed."""
    for stage in context.job.stages:
        asked = False
        for task in context.job.tasks:
            for step in stage.steps[task.name]:
                if isinstance(step, MessageStep) and step.confirm and step.certain:
                    asked = True
                    break
                if isinstance(step, MoveStep):
                    what = "an arm moves, and nobody was asked before whether its way is clear"
                    return [at_step("verify.setup", what, task, step, "ask the operator first")]
        if asked:
            return []
    return []


def _standing(context: Context, place: Asked, number: int, first: bool) -> list[Issue]:
    """Faults of arms that move at the confirmation, are not at home, or moved before the first one."""
    issues = []
    stage = context.job.stages[place.stage]
    if stage.synchronised or any(stage.moves(task.name) for task in context.job.tasks):
        issues.append(_at(place, f"an arm may move while setup {number} is being confirmed"))
    for task in context.job.tasks:
        machine = robot(task.arm.robot)
        moves = [m for earlier in context.job.stages[: place.stage] for m in earlier.moves(task.name)]
        away = [m for m in (moves if first else moves[-1:]) if not at_home(m, machine, task.arm.home)]
        if away:
            what = f"{task.arm.name} is not at home when setup {number} is confirmed"
            issues.append(at_step("verify.setup", what, task, away[-1], "let it go home first"))
    return issues


def at_home(move: MoveStep, machine: RobotData, home: FloatArray) -> bool:
    """Whether a move ends at home and stops there."""
    if not isinstance(move.target, JointTarget):
        return False
    q = machine.from_controller(move.target.joints)
    return bool(np.abs(q - home).max() <= HOME and move.zone.fine)


def _lookalikes(context: Context) -> list[Issue]:
    """Other questions that hold a setup's words, and setup texts where the proof does not follow."""
    wanted = [s for s in context.setups if s.steps]
    own = {id(q.step) for places in context.spans.asked for q in places}
    issues = [
        _at(question, f"a question other than the confirmation of setup {here.number} holds its words")
        for question in all_asked(context.job)
        for here in wanted
        if id(question.step) not in own and _like(question.step, here.confirmation)
    ]
    for task in context.job.tasks:
        aside = [step for step in task.steps if isinstance(step, ChoiceStep)]
        hidden = [s for choice in aside for s in _inside(choice)]
        hidden += [s for block in (task.handlers, task.undos) for steps in block.values() for s in steps]
        issues += [
            at_step("verify.setup", f"the confirmation of setup {here.number} is asked for aside", task, step)
            for step in hidden
            for here in wanted
            if isinstance(step, MessageStep) and _like(step, here.confirmation)
        ]
    return issues


def _inside(choice: ChoiceStep) -> list[Step]:
    return [
        s
        for step in choice.steps
        for s in ([step, *_inside(step)] if isinstance(step, ChoiceStep) else [step])
    ]


def _like(step: MessageStep, confirmation: str) -> bool:
    return letters(confirmation) in letters(" ".join(step.lines)) or one_line(confirmation) in step.text


def _at(asked: Asked, message: str) -> Issue:
    return at_step("verify.setup", message, asked.task, asked.step)
