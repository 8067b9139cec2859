"""All rules in their order: those that hold for any motion, and those of processes and languages."""

import functools
from collections.abc import Collection, Iterable, Mapping
from typing import Final

from planner import issue_codes
from planner.issues import issue_error
from planner.problem import Problem
from planner.proof.contribution import ParallelGroup, ProofOfProcess, of_processes
from planner.proof.language_contribution import ProofOfLanguage, proofs_of_languages
from planner.proof.rule import Rule
from planner.proof.rule_order import ORDER, Stage
from planner.proof.rules import (
    arm_sag,
    block_support,
    clearance,
    controller_files,
    coordinated_track,
    dialogue,
    external_axes,
    handshake,
    moves,
    order,
    part_file,
    power,
    robot_motion,
    settings,
    setups_and_frames,
    synchronisation,
    text,
    track_clearance,
    waiting_time,
)

GENERAL_RULES: Final[tuple[Rule, ...]] = (
    *(text.syntax, text.declarations, text.persistent_data, text.names, text.line_lengths, text.module_size),
    *(text.decimals, text.files, text.digest),
    *(robot_motion.robot_model, robot_motion.reachability, robot_motion.corners, robot_motion.continuity),
    *(robot_motion.joint_limits, robot_motion.rod_limits, robot_motion.joint_speed),
    *(robot_motion.joint_acceleration, robot_motion.singularity, robot_motion.tcp_speed),
    robot_motion.kinematics,
    *(synchronisation.task_list, synchronisation.sync_order, synchronisation.move_count),
    *(synchronisation.move_ids, synchronisation.zone_kind, synchronisation.move_time),
    *(synchronisation.speed_data, synchronisation.arms_alone, synchronisation.stop_before_logic),
    *(settings.motion_settings, settings.hidden),
    *(handshake.handshake, waiting_time.meeting_time, waiting_time.power_idle),
    *(controller_files.cell_check, controller_files.controller_files),
    *(setups_and_frames.setup, setups_and_frames.tool_data, setups_and_frames.work_object),
    *(setups_and_frames.held_frame, setups_and_frames.load, setups_and_frames.base_frames),
    *(dialogue.operator_dialogue, power.signals, block_support.block_support, external_axes.external_axes),
    *(moves.move_kinds, moves.unknown_start, moves.zone_size, moves.zero_length),
    *(arm_sag.sag, coordinated_track.coordinated_track, order.order, part_file.part_file),
    *(clearance.bodies, clearance.own_bodies, clearance.step_apart, track_clearance.track_clearance),
)
"""Rules that hold for any motion."""
BODY_RULES: Final = ParallelGroup("bodies", "sheets", lambda context: not context.is_long)
"""Rules on the bodies of the cell. They need no fact of a process, so another process can examine them."""


def rules_of(problem: Problem | None = None) -> tuple[Rule, ...]:
    """Return all rules that may apply to a problem: Tandem's, then those of the packages that it uses.

    Raises:
        TandemError: A rule of an installed package cannot be used (``problem.process_package`` for a process,
            ``post.language`` for a language).
    """
    rules = dict.fromkeys((*GENERAL_RULES, *_rules(proofs_of_languages()), *_rules(of_processes())))
    used_codes = {rule.code for rule in rules}
    language_rules, process_rules = _rules(proofs_of_languages(problem)), _rules(of_processes(problem))
    for code, package_rules in (
        ("post.language", language_rules),
        ("problem.process_package", process_rules),
    ):
        for rule in (rule for rule in package_rules if rule not in rules):
            if fault := _unusable_reason(rule, used_codes):
                message = f"the rule {rule.code} of {rule.examine.__module__} {fault}"
                raise issue_error(code, f"{message}; repair or uninstall its package")
            rules[rule] = None
            used_codes.add(rule.code)
    return tuple(rules)


def _rules(parts: Iterable[ProofOfLanguage | ProofOfProcess]) -> list[Rule]:
    """Return the rules of all contributions, in order."""
    return [rule for part in parts for rule in part.rules]


def _unusable_reason(rule: Rule, used_codes: Collection[str]) -> str:
    """Return why a rule of an installed package cannot be used, "" if it can.

    ``used_codes`` are the codes of all other rules.
    """
    if rule.code in used_codes:
        return "has the code of another rule"
    if issue_codes.code_owners(rule.code) in (frozenset(), {"Tandem"}):
        return "has no row among the issue codes of its package"
    return "" if rule.stage in ORDER else f"has the stage {rule.stage!r}; stages are {', '.join(ORDER)}"


def by_stage(rules: Iterable[Rule]) -> Mapping[Stage, tuple[Rule, ...]]:
    """Return rules in their order, by stage. Rules of installed packages follow those of Tandem.

    Raises:
        TandemError: Two rules have the same code, or a rule of Tandem is missing (``internal.error``).
    """
    rules_by_code: dict[str, Rule] = {}
    for rule in rules:
        if rules_by_code.setdefault(rule.code, rule) is not rule:
            raise issue_error("internal.error", f"two rules have the code {rule.code}")
    listed = {code for codes in ORDER.values() for code in codes}
    missing = sorted(listed - rules_by_code.keys())
    if missing:
        raise issue_error("internal.error", f"there is no rule for {', '.join(missing)}")
    added = [rule for code, rule in rules_by_code.items() if code not in listed]
    return {
        stage: (*(rules_by_code[code] for code in codes), *(rule for rule in added if rule.stage == stage))
        for stage, codes in ORDER.items()
    }


@functools.cache
def built_in() -> Mapping[str, Rule]:
    """Return the rules of Tandem by code, in their order."""
    return {rule.code: rule for rules in by_stage(rules_of()).values() for rule in rules}


def proven_by(rules: Iterable[Rule]) -> Mapping[type, tuple[str, ...]]:
    """Return the codes of the rules that prove each kind of claim."""
    out: dict[type, tuple[str, ...]] = {}
    for rule in rules:
        for kind in rule.proves:
            out[kind] = (*out.get(kind, ()), rule.code)
    return out
