"""The rule on arms that move alone while they hold a wire."""

from planner.issues import Issue
from planner.programs.steps import MoveStep, SignalStep
from planner.proof.context import Context
from planner.proof.contribution import edges
from planner.proof.rule import Outcome, at_step, rule


@rule("verify.wire_alone")
def wire_alone(context: Context) -> Outcome:
    """No arm moves alone while a bent wire is mounted or powered: each one has one run of synchronised
    stages. A powered bow or spindle goes straight, and arms without one keep still meanwhile."""
    issues = _moves_with_power(context)
    for index, setup in enumerate(context.setup_claims):
        runs, wires = context.runs(index), len(setup.joined)
        if wires and len(runs) != wires:
            message = (
                f"{wires} wires are mounted, and there are {len(runs)} runs of synchronised moves between "
                "lone ones"
            )
            hint = "move both arms together while a wire is mounted"
            lone = [
                at_step("verify.wire_alone", message, task, moves[0], hint)
                for number, stage, task, moves in context.moves()
                if (not stage.synchronised or stage.is_way) and runs and runs[0][0] < number < runs[-1][-1]
            ]
            issues += lone[:1] or [Issue("verify.wire_alone", message, hint=hint)]
    there = bool(context.contacts) or any(setup.joined for setup in context.setup_claims)
    return Outcome(tuple(issues), nothing="" if there else "no wire and no spindle")


def _moves_with_power(context: Context) -> list[Issue]:
    """Moves that must not be while a signal that powers a wire or a spindle is on."""
    signals = {claim.signal.lower() for claim in context.contacts}
    edged = {
        (index, task.arm.name): any(not edge.meet for edge in edges(context, index, task.arm.name))
        for index in range(len(context.setups))
        for task in context.job.tasks
    }
    issues, on = [], set[str]()
    for number, stage in enumerate(context.job.stages):
        index = int(context.spans.of_stage[number])
        setup = context.setup_claims[index]
        lone = not stage.synchronised or stage.is_way
        for task in context.job.tasks:
            for step in stage.steps[task.name]:
                if isinstance(step, SignalStep) and step.signal.lower() in signals:
                    name = step.signal.lower()
                    on = on | {name} if step.value else on - {name}
                if not isinstance(step, MoveStep) or not on:
                    continue
                alone = lone and (bool(setup.joined) or not edged[index, task.arm.name])
                if alone or (not setup.joined and step.by_joints):
                    how = "alone" if alone else "by joints"
                    message = f"an arm moves {how} while {', '.join(sorted(on))} is on"
                    issues.append(at_step("verify.wire_alone", message, task, step))
    return issues
