"""Rule on arms that move alone while they hold a wire."""

from planner.issues import Issue
from planner.programs.steps import MoveStep, SignalStep
from planner.proof.context import Context
from planner.proof.contribution import find_edges
from planner.proof.rule import RuleOutcome, rule, step_issue


@rule("verify.wire_alone")
def wire_alone(context: Context) -> RuleOutcome:
    """No arm moves alone while a bent wire is mounted or powered: each wire has one run of synchronised
    stages. A powered bow or spindle moves along straight lines, and arms without one keep still meanwhile.
    """
    issues = _moves_with_power(context)
    for index, setup in enumerate(context.setup_claims):
        runs, wires = context.synchronised_runs(index), len(setup.joined)
        if wires and len(runs) != wires:
            message = (
                f"{wires} wires are mounted, but there are {len(runs)} runs of synchronised moves between "
                "moves of single arms"
            )
            hint = "move both arms together while a wire is mounted"
            single_arm_issues = [
                step_issue("verify.wire_alone", message, task, moves[0], hint)
                for number, stage, task, moves in context.moves()
                if (not stage.synchronised or stage.is_synchronised_approach)
                and runs
                and runs[0][0] < number < runs[-1][-1]
            ]
            issues += single_arm_issues[:1] or [Issue("verify.wire_alone", message, hint=hint)]
    has_powered_tool = bool(context.contacts) or any(setup.joined for setup in context.setup_claims)
    return RuleOutcome(tuple(issues), nothing="" if has_powered_tool else "no wire and no spindle")


def _moves_with_power(context: Context) -> list[Issue]:
    """Return issues on moves that are not allowed while a signal that powers a wire or spindle is on.

    These are moves of a single arm while a bent wire is mounted, or if the arm carries a powered tool, and
    joint moves without a mounted wire.
    """
    signals = {claim.signal.lower() for claim in context.contacts}
    only_edges = {
        (index, task.arm.name): any(not edge.meet for edge in find_edges(context, index, task.arm.name))
        for index in range(len(context.setups))
        for task in context.job.tasks
    }
    issues, active = [], set[str]()
    for number, stage in enumerate(context.job.stages):
        index = int(context.spans.of_stage[number])
        setup = context.setup_claims[index]
        is_single = not stage.synchronised or stage.is_synchronised_approach
        for task in context.job.tasks:
            for step in stage.steps[task.name]:
                if isinstance(step, SignalStep) and step.signal.lower() in signals:
                    name = step.signal.lower()
                    active = active | {name} if step.value else active - {name}
                if not isinstance(step, MoveStep) or not active:
                    continue
                alone = is_single and (bool(setup.joined) or not only_edges[index, task.arm.name])
                if alone or (not setup.joined and step.by_joints):
                    manner = "alone" if alone else "by joints"
                    message = f"an arm moves {manner} while {', '.join(sorted(active))} is on"
                    issues.append(step_issue("verify.wire_alone", message, task, step))
    return issues
