"""Why programs cannot be written for a job, however it is planned.

Cells whose controllers cannot do the job together, signals without numbers, and names of segments that
programs cannot carry. What one language alone refuses is in its :class:`Writer`.
"""

import dataclasses
from collections.abc import Sequence

from planner.claims.claim import Claim
from planner.claims.segments import Segment
from planner.issues import Issue
from planner.languages.writing.language import makers_languages, unwritten, writer_of, writers, writers_in_use
from planner.problem import Arm, Problem
from planner.targets import Targets


def used(problem: Problem, made: Sequence[Targets]) -> list[Arm]:
    """The arms that take part in any operation, in the cell's order."""
    names = {arm for targets in made for arm in targets.arms}
    return [arm for arm in problem.cell.arms if arm.name in names]


def controller_refusals(problem: Problem, made: Sequence[Targets]) -> tuple[Issue, ...]:
    """Why the controllers of this cell cannot do this job: arms without a language (``post.language``), arms
    that cannot move together (``post.controller``), and what their languages refuse.

    Args:
        problem: Problem.
        made: Targets of each operation.
    """
    arms = used(problem, made)
    if unknown := [unwritten(arm) for arm in arms if arm.data.family not in writers()]:
        return tuple(unknown)
    if len(arms) > 1 and (apart := _apart(problem, arms)) is not None:
        return (apart,)
    return tuple(
        issue
        for writer in writers_in_use(arms)
        for issue in writer.refuse(problem, made, [arm for arm in arms if writer_of(arm) is writer])
    )


def _apart(problem: Problem, arms: Sequence[Arm]) -> Issue | None:
    """Why arms cannot work in one job."""
    sync, own, in_use = problem.cell.controller.sync, makers_languages(), writers_in_use(arms)
    names = " and ".join(f"{arm.name} ({arm.robot})" for arm in arms)
    if sync == "multimove" and (len(in_use) > 1 or sync not in in_use[0].syncs):
        shared = [family for family, (_, writer) in own.items() if sync in writer.syncs]
        single = " and ".join(family for family in own if family not in shared)
        what = f"{names} cannot move together: one controller for both arms (sync: multimove) is "
        what += f"{' and '.join(shared)}'s; arms of {single} have one each"
        hint = "set controller: {sync: handshake} and wire two outputs each way, or take "
        return Issue("post.controller", what, hint=f"{hint}{' or '.join(shared)} robots for both")
    what = f"{names} cannot work in one job: "
    for family, (title, writer) in writers().items():
        if writer in in_use and sync not in writer.syncs:
            what += f"programs in {title} do not meet those of another controller"
            return Issue("post.controller", what, hint="plan with one arm alone")
        if writer in in_use and writer.unmixed and len(in_use) > 1:
            mixed = [name for name, (_, one) in own.items() if sync in one.syncs and not one.unmixed]
            hint = f"take two arms of {family}, two of {' or '.join(mixed)}, or plan with one arm alone"
            return Issue("post.controller", f"{what}{writer.unmixed}", hint=hint)
    return None


def unnumbered(
    problem: Problem, made: Sequence[Targets], arm: Arm, language: str, more: Sequence[str] = ()
) -> list[Issue]:
    """Signals without a number on a controller that knows them by number only (``post.signal``).

    Args:
        problem: Problem.
        made: Targets of each operation.
        arm: Arm of the controller. Its programs use the signals of the actions that it leads, and those by
            which they meet programs of another controller.
        language: Name of the language in messages.
        more: Further signals that are used beside another controller.
    """
    order = [item.name for item in problem.cell.arms]
    controller = problem.cell.controller
    signals = [
        action.signal
        for targets in made
        if min(targets.arms, key=order.index) == arm.name
        for action in targets.actions
        if action.kind in ("on", "off", "input")
    ]
    if len(used(problem, made)) > 1:
        own = controller.handshake.of(arm.name)
        signals += [own.output, own.input, own.running, own.partner_running, *more]
    missing = [signal for signal in dict.fromkeys(signals) if controller.number(arm.name, signal) is None]
    if not missing:
        return []
    got = (
        f"arm {arm.name} ({arm.robot}) is to use {', '.join(missing)}, which {language} knows by number only"
    )
    hint = f"state the numbers: controller: {{io: {{{arm.name}: {{{missing[0]}: 1}}}}}}, as they are"
    return [Issue("post.signal", got, field=f"controller.io.{arm.name}", arm=arm.name, hint=hint)]


def name_refusals(problem: Problem, made: Sequence[Targets]) -> tuple[Issue, ...]:
    """Segments that programs cannot tell apart, that two operations of one setup have in common though
    something is claimed of them, and that a language has no name for (all ``post.name``).

    Args:
        problem: Problem.
        made: Targets of each operation.
    """
    own = writers_in_use(used(problem, made))
    out: list[Issue] = []
    known: dict[str, Segment] = {}
    for number, targets in enumerate(made):
        field = f"operations.{number}"
        for segment in dict.fromkeys(targets.segment):
            other = known.setdefault(segment.key, segment)
            found = [issue for writer in own for issue in writer.refuse_segment(segment)]
            found = found if other == segment else [alike(other, segment)]
            out += [dataclasses.replace(issue, field=field) for issue in found]
    return (*out, *_shared(problem, made))


def alike(one: Segment, other: Segment) -> Issue:
    """Why programs cannot tell two segments apart."""
    message = (
        f"segments {str(one)!r} and {str(other)!r} would both be called {other.key!r} in the programs, which "
        "tell neither case nor runs of underscores and other signs apart"
    )
    return Issue("post.name", message, hint="give them names that differ in letters or digits")


def _shared(problem: Problem, made: Sequence[Targets]) -> list[Issue]:
    """Segments of two operations of one setup, which the proof would hold against the claims of both."""
    out: list[Issue] = []
    setups = [problem.setup_of(number).number for number in range(len(made))]
    for number, targets in enumerate(made):
        for before in range(number):
            if setups[before] != setups[number]:
                continue
            keys = {segment.key: segment for segment in dict.fromkeys(targets.segment)}
            claimed = _claimed(targets.claims) | _claimed(made[before].claims)
            both = [key for key in dict.fromkeys(s.key for s in made[before].segment) if key in keys]
            own = [keys[key] for key in both if key in claimed or keys[key].works]  # G-code is claimed whole
            if own:
                shown = str(own[0].at(""))
                names = [problem.operations[index].name for index in (before, number)]
                what = f"operations {names[0]!r} and {names[1]!r} both have the segment {shown!r}"
                hint = "do it once, give one of them another name, or give the second a setup of its own"
                out.append(Issue("post.name", what, field=f"operations.{number}", hint=hint))
    return out


def _claimed(claims: Sequence[Claim]) -> set[str]:
    """Keys of the segments of which something is claimed."""
    out: set[str] = set()
    for claim in claims:
        own = getattr(claim, "segments", None) or (getattr(claim, "segment", None),)
        out |= {segment.key for segment in own if isinstance(segment, Segment)}
    return out
