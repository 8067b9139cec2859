"""Reasons why programs cannot be written for a job, however it is planned.

These are cells whose controllers cannot do the job together, signals without numbers, and names of segments
that programs cannot represent. Each :class:`planner.languages.writing.language.Writer` has the refusals of
its language.
"""

import dataclasses
from collections.abc import Sequence

from planner.claims.claim import Claim
from planner.claims.segments import Segment
from planner.issues import Issue
from planner.languages.writing.language import (
    manufacturer_languages,
    no_writer_issue,
    writer_of,
    writers,
    writers_in_use,
)
from planner.problem import Arm, Problem
from planner.targets import Targets


def used_arms(problem: Problem, targets_by_operation: Sequence[Targets]) -> list[Arm]:
    """Return the arms that take part in any operation, in the cell's order.

    Args:
        problem: The problem.
        targets_by_operation: Targets of each operation.
    """
    names = {arm for targets in targets_by_operation for arm in targets.arms}
    return [arm for arm in problem.cell.arms if arm.name in names]


def controller_refusals(problem: Problem, targets_by_operation: Sequence[Targets]) -> tuple[Issue, ...]:
    """Return the reasons why the controllers of this cell cannot do this job.

    Some arms have no language (``post.language``), some cannot move together (``post.controller``), and
    languages may refuse the job.

    Args:
        problem: The problem.
        targets_by_operation: Targets of each operation.
    """
    arms = used_arms(problem, targets_by_operation)
    if unknown := [no_writer_issue(arm) for arm in arms if arm.data.family not in writers()]:
        return tuple(unknown)
    if len(arms) > 1 and (mixed_refusal := _mixed_arms_refusal(problem, arms)) is not None:
        return (mixed_refusal,)
    return tuple(
        issue
        for writer in writers_in_use(arms)
        for issue in writer.refuse(
            problem, targets_by_operation, [arm for arm in arms if writer_of(arm) is writer]
        )
    )


def _mixed_arms_refusal(problem: Problem, arms: Sequence[Arm]) -> Issue | None:
    """Reason why arms cannot work in one job, or None."""
    sync, manufacturers, in_use = problem.cell.controller.sync, manufacturer_languages(), writers_in_use(arms)
    names = " and ".join(f"{arm.name} ({arm.robot})" for arm in arms)
    if sync == "multimove" and (len(in_use) > 1 or sync not in in_use[0].syncs):
        shared = [family for family, (_, writer) in manufacturers.items() if sync in writer.syncs]
        single = " and ".join(family for family in manufacturers if family not in shared)
        what = f"{names} cannot move together: one controller for both arms (sync: multimove) is available "
        what += f"from {' and '.join(shared)} only; arms of {single} have one each"
        hint = "set controller: {sync: handshake} and wire two outputs in each direction, or use "
        return Issue("post.controller", what, hint=f"{hint}{' or '.join(shared)} robots for both")
    what = f"{names} cannot work in one job: "
    for family, (title, writer) in writers().items():
        if writer in in_use and sync not in writer.syncs:
            what += f"programs in {title} do not meet those of another controller"
            return Issue("post.controller", what, hint="plan with one arm alone")
        if writer in in_use and writer.unmixed and len(in_use) > 1:
            mixed = [
                name
                for name, (_, writer_of_family) in manufacturers.items()
                if sync in writer_of_family.syncs and not writer_of_family.unmixed
            ]
            hint = f"use two arms of {family}, two of {' or '.join(mixed)}, or plan with one arm alone"
            return Issue("post.controller", f"{what}{writer.unmixed}", hint=hint)
    return None


def unnumbered_signals(
    problem: Problem,
    targets_by_operation: Sequence[Targets],
    arm: Arm,
    language: str,
    more_signals: Sequence[str] = (),
) -> list[Issue]:
    """Return issues of signals without a number on a controller that needs one (``post.signal``).

    Such a controller addresses signals by number only.

    Args:
        problem: The problem.
        targets_by_operation: Targets of each operation.
        arm: Arm of the controller. Its programs use the signals of the actions that it leads, and those by
            which they meet programs of another controller.
        language: Name of the language in messages.
        more_signals: Further signals that are used beside another controller.
    """
    order = [item.name for item in problem.cell.arms]
    controller = problem.cell.controller
    signals = [
        action.signal
        for targets in targets_by_operation
        if min(targets.arms, key=order.index) == arm.name
        for action in targets.actions
        if action.kind in ("on", "off", "input")
    ]
    if len(used_arms(problem, targets_by_operation)) > 1:
        handshake_signals = controller.handshake.of(arm.name)
        signals += [
            handshake_signals.output,
            handshake_signals.input,
            handshake_signals.running,
            handshake_signals.partner_running,
            *more_signals,
        ]
    missing = [
        signal for signal in dict.fromkeys(signals) if controller.signal_number(arm.name, signal) is None
    ]
    if not missing:
        return []
    got = f"arm {arm.name} ({arm.robot}) uses {', '.join(missing)}, which {language} addresses by number only"
    hint = f"state the actual numbers: controller: {{io: {{{arm.name}: {{{missing[0]}: 1}}}}}}"
    return [Issue("post.signal", got, field=f"controller.io.{arm.name}", arm=arm.name, hint=hint)]


def name_refusals(problem: Problem, targets_by_operation: Sequence[Targets]) -> tuple[Issue, ...]:
    """Return issues of segment names (all ``post.name``).

    Programs cannot distinguish two segments, two operations of one setup share a segment that has claims, or
    a language has no name for a segment.

    Args:
        problem: The problem.
        targets_by_operation: Targets of each operation.
    """
    used_writers = writers_in_use(used_arms(problem, targets_by_operation))
    out: list[Issue] = []
    known: dict[str, Segment] = {}
    for number, targets in enumerate(targets_by_operation):
        field = f"operations.{number}"
        for segment in dict.fromkeys(targets.segment):
            other = known.setdefault(segment.key, segment)
            issues = [issue for writer in used_writers for issue in writer.refuse_segment(segment)]
            issues = issues if other == segment else [equal_names_issue(other, segment)]
            out += [dataclasses.replace(issue, field=field) for issue in issues]
    return (*out, *_shared_segment_issues(problem, targets_by_operation))


def equal_names_issue(first: Segment, second: Segment) -> Issue:
    """Return the issue of two segments that programs cannot distinguish.

    Args:
        first: One segment.
        second: The other segment.
    """
    message = (
        f"segments {str(first)!r} and {str(second)!r} would both be called {second.key!r} in the programs, "
        "which ignore case and treat runs of underscores and other characters as equal"
    )
    return Issue("post.name", message, hint="give them names that differ in letters or digits")


def _shared_segment_issues(problem: Problem, targets_by_operation: Sequence[Targets]) -> list[Issue]:
    """Segments of two operations of one setup, which the proof would check against the claims of both."""
    out: list[Issue] = []
    setups = [problem.setup_of(number).number for number in range(len(targets_by_operation))]
    for number, targets in enumerate(targets_by_operation):
        for earlier in range(number):
            if setups[earlier] != setups[number]:
                continue
            keys = {segment.key: segment for segment in dict.fromkeys(targets.segment)}
            claimed = _claimed_keys(targets.claims) | _claimed_keys(targets_by_operation[earlier].claims)
            both = [
                key
                for key in dict.fromkeys(s.key for s in targets_by_operation[earlier].segment)
                if key in keys
            ]
            conflicting = [
                keys[key] for key in both if key in claimed or keys[key].works
            ]  # G-code is claimed as a whole
            if conflicting:
                shown = str(conflicting[0].at(""))
                names = [problem.operations[index].name for index in (earlier, number)]
                what = f"operations {names[0]!r} and {names[1]!r} both have the segment {shown!r}"
                hint = "remove one of them, rename one of them, or put the second into a separate setup"
                out.append(Issue("post.name", what, field=f"operations.{number}", hint=hint))
    return out


def _claimed_keys(claims: Sequence[Claim]) -> set[str]:
    """Keys of the segments that have claims."""
    out: set[str] = set()
    for claim in claims:
        claimed_segments = getattr(claim, "segments", None) or (getattr(claim, "segment", None),)
        out |= {segment.key for segment in claimed_segments if isinstance(segment, Segment)}
    return out
