"""Reasons why programs cannot be written for a job, however it is planned.

The reasons are controllers that cannot do the job together, signals without numbers, and names of segments
that programs cannot represent. Further reasons that only one language has are in its
:class:`planner.languages.writing.language.Writer`.
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

    These are, in this order: arms without a language (``post.language``), arms whose programs cannot run
    together (``post.controller``), and the reasons of each language. Only issues of the first kind that
    occurs are returned.

    Args:
        problem: The problem.
        targets_by_operation: Targets of each operation.
    """
    arms = used_arms(problem, targets_by_operation)
    if no_writer_issues := [no_writer_issue(arm) for arm in arms if arm.data.family not in writers()]:
        return tuple(no_writer_issues)
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
    """Return the reason why the programs of several arms cannot run in one job, or None if they can.

    There are three reasons: one controller for all arms is required (sync: multimove), but the arms have
    different languages or one that does not support it; the programs of a language do not meet those of
    another controller; a language does not work together with others.
    """
    sync, manufacturers, in_use = problem.cell.controller.sync, manufacturer_languages(), writers_in_use(arms)
    names = " and ".join(f"{arm.name} ({arm.robot})" for arm in arms)
    if sync == "multimove" and (len(in_use) > 1 or sync not in in_use[0].syncs):
        shared = [family for family, (_, writer) in manufacturers.items() if sync in writer.syncs]
        single = " and ".join(family for family in manufacturers if family not in shared)
        message = (
            f"{names} cannot move together: one controller for both arms (sync: multimove) is available "
        )
        message += f"from {' and '.join(shared)} only; arms of {single} have one each"
        hint = "set controller: {sync: handshake} and wire two outputs in each direction, or use "
        return Issue("post.controller", message, hint=f"{hint}{' or '.join(shared)} robots for both")
    message = f"{names} cannot work in one job: "
    for family, (title, writer) in writers().items():
        if writer in in_use and sync not in writer.syncs:
            message += f"programs in {title} do not meet those of another controller"
            return Issue("post.controller", message, hint="plan with one arm alone")
        if writer in in_use and writer.unmixed and len(in_use) > 1:
            mixed = [
                name
                for name, (_, writer_of_family) in manufacturers.items()
                if sync in writer_of_family.syncs and not writer_of_family.unmixed
            ]
            hint = f"use two arms of {family}, two of {' or '.join(mixed)}, or plan with one arm alone"
            return Issue("post.controller", f"{message}{writer.unmixed}", hint=hint)
    return None


def unnumbered_signals(
    problem: Problem,
    targets_by_operation: Sequence[Targets],
    arm: Arm,
    language: str,
    more_signals: Sequence[str] = (),
) -> list[Issue]:
    """Return an issue if signals have no number on a controller that addresses them by number only.

    Its code is ``post.signal``. The list is empty if all signals have a number.

    Args:
        problem: The problem.
        targets_by_operation: Targets of each operation.
        arm: Arm of the controller. Its programs use the signals of the actions that it leads, and those by
            which they meet programs of another controller.
        language: Name of the language in messages.
        more_signals: Further signals that the controller uses if another arm takes part.
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
    message = (
        f"arm {arm.name} ({arm.robot}) uses {', '.join(missing)}, which {language} addresses by number only"
    )
    hint = f"state the actual numbers: controller: {{io: {{{arm.name}: {{{missing[0]}: 1}}}}}}"
    return [Issue("post.signal", message, field=f"controller.io.{arm.name}", arm=arm.name, hint=hint)]


def name_refusals(problem: Problem, targets_by_operation: Sequence[Targets]) -> tuple[Issue, ...]:
    """Return issues of segment names (all ``post.name``).

    There is one if programs cannot distinguish two segments, if two operations of one setup share a segment
    that has claims, or if a language has no name for a segment.

    Args:
        problem: The problem.
        targets_by_operation: Targets of each operation.
    """
    used_writers = writers_in_use(used_arms(problem, targets_by_operation))
    out: list[Issue] = []
    segments_by_key: dict[str, Segment] = {}
    for number, targets in enumerate(targets_by_operation):
        field = f"operations.{number}"
        for segment in dict.fromkeys(targets.segment):
            other = segments_by_key.setdefault(segment.key, segment)
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
    """Return issues of segments that two operations of one setup share.

    The claims of both operations would then apply to the moves of both. There is an issue if a claim names
    the shared segment or the tool works in it.
    """
    out: list[Issue] = []
    setups = [problem.setup_of(number).number for number in range(len(targets_by_operation))]
    for number, targets in enumerate(targets_by_operation):
        for earlier in range(number):
            if setups[earlier] != setups[number]:
                continue
            segments_by_key = {segment.key: segment for segment in dict.fromkeys(targets.segment)}
            claimed = _claimed_keys(targets.claims) | _claimed_keys(targets_by_operation[earlier].claims)
            shared_keys = [
                key
                for key in dict.fromkeys(segment.key for segment in targets_by_operation[earlier].segment)
                if key in segments_by_key
            ]
            # working segments of G-code have no claims of their own: G-code is claimed as a whole
            conflicting = [
                segments_by_key[key] for key in shared_keys if key in claimed or segments_by_key[key].works
            ]
            if conflicting:
                shown = str(conflicting[0].at(""))
                names = [problem.operations[index].name for index in (earlier, number)]
                message = f"operations {names[0]!r} and {names[1]!r} both have the segment {shown!r}"
                hint = "remove one of them, rename one of them, or put the second into a separate setup"
                out.append(Issue("post.name", message, field=f"operations.{number}", hint=hint))
    return out


def _claimed_keys(claims: Sequence[Claim]) -> set[str]:
    """Return the keys of the segments that claims name."""
    out: set[str] = set()
    for claim in claims:
        claimed_segments = getattr(claim, "segments", None) or (getattr(claim, "segment", None),)
        out |= {segment.key for segment in claimed_segments if isinstance(segment, Segment)}
    return out
