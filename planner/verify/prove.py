"""The proof: from the problem and the program text alone to a verdict, rule by rule.

Rules stand in an order in which each one may rely on those before it: text, tasks side by side, data,
motion, cell, wire, surface. Where a fault leaves a later rule nothing to look at, that rule has not run, and
the proof does not hold.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from planner.cell.plant import CellModel, build
from planner.claims import Claim
from planner.issues import Issue, TandemError, aggregate, has_errors
from planner.problem import Problem
from planner.verify import (
    formed_part,
    handshake_apart,
    mill_worked,
    pendant,
    report_series,
    rules_adsif,
    rules_cell,
    rules_check,
    rules_controller,
    rules_data,
    rules_dialogue,
    rules_entry,
    rules_file,
    rules_follow,
    rules_forming,
    rules_forming_claims,
    rules_forming_part,
    rules_forming_sheet,
    rules_forming_two,
    rules_frames,
    rules_handshake,
    rules_holder,
    rules_kinematics,
    rules_krl,
    rules_leaving,
    rules_mill_spindle,
    rules_milling,
    rules_motion,
    rules_part,
    rules_power,
    rules_rests,
    rules_setup,
    rules_slit,
    rules_spline,
    rules_straight,
    rules_surface,
    rules_sync,
    rules_text,
    rules_waits,
    rules_wire,
)
from planner.verify.context import Context, Outcome
from planner.verify.dialogue_choice import told_choice
from planner.verify.forming_state import Forming
from planner.verify.kinds import unproven
from planner.verify.mill_track import Milling
from planner.verify.remedies import told
from planner.verify.result import CutFace, Proof, RuleResult
from planner.verify.wire import Wire
from planner.verify.wire import wires as all_wires

_RuleTable = tuple[tuple[str, Callable[[Context], Outcome]], ...]

TEXT: _RuleTable = (
    ("verify.syntax", rules_text.syntax),
    ("verify.declarations", rules_text.declarations),
    ("verify.pers_literal", rules_text.persistents),
    ("verify.names", rules_text.names),
    ("verify.line_length", rules_text.line_lengths),
    ("verify.module_size", rules_text.module_size),
    ("verify.decimals", rules_text.decimals),
    ("verify.files", rules_text.files),
    ("verify.digest", rules_text.digest),
)
_OF_TEXT = frozenset(code for code, _ in TEXT)
ROBOTS: _RuleTable = (("verify.robot_model", rules_kinematics.robot_model),)
TASKS: _RuleTable = (
    ("verify.task_list", rules_sync.task_list),
    ("verify.sync_order", rules_sync.sync_order),
    ("verify.handshake", rules_handshake.handshake),
    ("verify.meeting_time", rules_waits.meeting_time),
    ("verify.error_handler", rules_data.error_handler),
    ("verify.undo", rules_leaving.undo),
    ("verify.motion_settings", rules_data.motion_settings),
    ("verify.hidden", rules_data.hidden),
    ("verify.cell_check", rules_check.cell_check),
    ("verify.controller_files", rules_controller.controller_files),
)
STAGES: _RuleTable = (
    ("verify.setup", rules_setup.setup),
    ("verify.dialogue", rules_dialogue.told_and_asked),
    ("verify.move_count", rules_sync.move_count),
    ("verify.move_ids", rules_sync.move_ids),
    ("verify.zone_kind", rules_sync.zone_kind),
    ("verify.move_time", rules_sync.move_time),
    ("verify.speed_data", rules_sync.speed_data),
    ("verify.arms_alone", rules_sync.arms_alone),
    ("verify.wire_alone", rules_sync.wire_alone),
    ("verify.stop_before_logic", rules_sync.stop_before_logic),
    ("verify.signals", rules_power.signals),
    ("verify.tool_data", rules_frames.tool_data),
    ("verify.work_object", rules_frames.work_object),
    ("verify.held_frame", rules_frames.held_frame),
    ("verify.load", rules_frames.load),
    ("verify.base_frames", rules_frames.base_frames),
    ("verify.rests", rules_rests.rests),
    ("verify.status", rules_krl.status),
    ("verify.move_kinds", rules_data.move_kinds),
    ("verify.unknown_start", rules_entry.unknown_start),
    ("verify.zone_size", rules_data.zone_size),
    ("verify.zero_length", rules_data.zero_length),
    ("verify.wire_mount", rules_wire.wire_mount),
)
MOTION: _RuleTable = (
    ("verify.reach", rules_motion.reach),
    ("verify.corner", rules_motion.corners),
    ("verify.continuity", rules_motion.continuity),
    ("verify.confdata", rules_motion.confdata),
    ("verify.joint_limits", rules_motion.joint_limits),
    ("verify.rod_limits", rules_motion.rod_limits),
    ("verify.joint_speed", rules_motion.joint_speed),
    ("verify.joint_acceleration", rules_motion.joint_acceleration),
    ("verify.singularity", rules_motion.singularity),
    ("verify.tcp_speed", rules_motion.tcp_speed),
    ("verify.power_idle", rules_waits.power_idle),
    ("verify.follows", rules_follow.follows),
    ("verify.order", rules_part.order),
)
WIRE: tuple[tuple[str, Callable[[Context, tuple[Wire, ...]], Outcome]], ...] = (
    ("verify.wire_length", rules_wire.wire_length),
    ("verify.wire_stability", rules_wire.wire_stability),
    ("verify.curvature", rules_wire.curvature),
    ("verify.contact", rules_wire.contact),
    ("verify.stop_in_foam", rules_wire.stop_in_foam),
    ("verify.wire_power", rules_power.wire_power),
    ("verify.dialogue_figures", rules_dialogue.told_figures),
    ("verify.feed", rules_wire.feed),
    ("verify.bow", rules_straight.bow),
    ("verify.rulings", rules_straight.rulings),
    ("verify.part", rules_part.part),
    ("verify.slit", rules_slit.slit),
)
OTHERS: tuple[tuple[str, Callable[..., Any]], ...] = (
    ("verify.kinematics", rules_kinematics.kinematics),
    ("verify.clearance", rules_cell.bodies),
    ("verify.step_apart", handshake_apart.step_apart),
    ("verify.wire_clearance", rules_cell.wire_bodies),
    ("verify.surface", rules_surface.surface),
    ("verify.kerf", rules_straight.kerf),
    ("verify.ridge", rules_surface.ridges),
    ("verify.part_file", rules_file.part_file),
)
FORMING: tuple[tuple[str, Callable[[Context, Forming], Outcome]], ...] = (
    ("verify.forming_part", rules_forming_part.forming_part),
    ("verify.forming_claims", rules_forming_claims.forming_claims),
    ("verify.feature_order", rules_forming.feature_order),
    ("verify.forming_feed", rules_forming.feed),
    ("verify.lean", rules_forming.lean),
    ("verify.gouge", rules_forming.gouge),
    ("verify.gap", rules_forming_two.gap),
    ("verify.border", rules_forming_two.border),
    ("verify.opposite", rules_forming_two.opposite),
    ("verify.sheet", rules_forming_sheet.sheet),
    ("verify.holder", rules_holder.holder),
    ("verify.adsif", rules_adsif.by_table),
)
FORMED: tuple[tuple[str, Callable[..., Any]], ...] = (("verify.formed", rules_forming.formed),)

MILLED: tuple[tuple[str, Callable[..., Any]], ...] = (("verify.milled", rules_milling.milled),)
MILLING: tuple[tuple[str, Callable[[Context, Milling], Outcome]], ...] = (
    ("verify.mill_gouge", rules_milling.mill_gouge),
    ("verify.mill_path", rules_milling.mill_path),
    ("verify.mill_feed", rules_mill_spindle.mill_feed),
    ("verify.spindle", rules_mill_spindle.spindle),
)

SPLINES: tuple[tuple[str, Callable[..., Any]], ...] = (("verify.spline", rules_spline.spline),)

NEEDED = (
    "verify.setup",
    "verify.move_count",
    "verify.sync_order",
    "verify.handshake",
    "verify.arms_alone",
    "verify.held_frame",
    "verify.status",
)
"""What must hold for a motion to follow from the text."""

_ALL = (
    *(TEXT, ROBOTS, TASKS, STAGES, SPLINES, MOTION, FORMING, FORMED),
    *(MILLED, MILLING, WIRE, OTHERS),
)
RULES: tuple[str, ...] = tuple(code for table in _ALL for code, _ in table)
"""Codes of all rules."""

TITLES: Mapping[str, str] = {
    code: " ".join((rule.__doc__ or code).split("\n\n")[0].split()).rstrip(".")
    for table in _ALL
    for code, rule in table
}
"""What each rule asks, by code."""


@dataclasses.dataclass
class Prover:
    """Proves programs of one problem. Keeps the Drake models of its setups between proofs, which then start
    at once."""

    problem: Problem
    claims: Mapping[str, tuple[Claim, ...]]
    _models: dict[int, CellModel] = dataclasses.field(default_factory=dict)
    _worked_out: tuple[Mapping[str, tuple[Claim, ...]], tuple[Issue, ...]] | None = None

    def prove(self, programs: Mapping[str, str], first_error: bool = False, last: str | None = None) -> Proof:
        """The proof of ``programs``. ``first_error``: stop at the first rule that is broken (the verdict is
        the same). ``last``: stop behind that rule; such a proof never holds."""
        if self._worked_out is None:
            self._worked_out = mill_worked.worked_out(self.claims)
        context = told_choice(Context(self.problem, self._worked_out[0], programs, self._worked_out[1]))
        run = _Run(context)
        for _ in self._steps(context, run):
            if (first_error and run.broken) or last in run.results:
                break
        return run.proof()

    def model(self, context: Context, index: int = 0) -> CellModel:
        """The cell of a setup, by its index, with block and bases where the text has them."""
        setup = context.setups[index]
        place = context.places[index]
        place = np.eye(4) if place is None else place
        if index not in self._models:
            self._models[index] = build(setup.cell, setup.stock, place, context.bases)
        return self._models[index].with_stock(place).with_bases(context.bases)

    def _steps(self, context: Context, run: _Run) -> Iterator[None]:
        """Runs the rules one after the other and hands control back behind each."""
        for code, rule in (*TEXT, *ROBOTS):
            run.add(code, rule(context))
            yield
        if run.broken_any("verify.robot_model"):
            return  # where arms are does not follow from their files
        if not context.readable:
            return
        for code, rule in TASKS:
            run.add(code, rule(context))
            yield
        if not context.playable:
            return
        for code, rule in STAGES:
            run.add(code, rule(context))
            yield
        if run.broken_any(*NEEDED):
            return
        outcome, context = rules_spline.spline(context)  # from here on with what its curves leave of room
        run.add("verify.spline", outcome)
        yield
        for code, rule in MOTION:
            run.add(code, rule(context))
            yield
        if run.broken_any("verify.reach"):
            return
        yield from self._physics(context, run)

    def _physics(self, context: Context, run: _Run) -> Iterator[None]:
        forming = run.forming = Forming(context)
        for form_code, form_rule in FORMING:
            run.add(form_code, form_rule(context, forming))
            yield
        outcome, formed = rules_forming.formed(context, forming)
        run.add("verify.formed", outcome)
        yield
        milling = Milling(context)
        outcome, milled = rules_milling.milled(context, milling)
        run.add("verify.milled", outcome)
        yield
        for mill_code, mill_rule in MILLING:
            run.add(mill_code, mill_rule(context, milling))
            yield
        wires = all_wires(context)
        run.wires = wires
        for code, rule in WIRE:
            run.add(code, rule(context, wires))
            yield
        sweeps = rules_surface.sweeps(context, wires)
        outcome, run.faces, run.part = rules_surface.surface(context, sweeps)
        run.part = run.part or formed_part.obj(forming)
        run.add("verify.surface", outcome)
        yield
        run.add("verify.kerf", rules_straight.kerf(context, run.faces, wires))
        yield
        run.add("verify.part_file", rules_file.part_file(context, sweeps, forming, milling))
        yield
        run.add("verify.ridge", rules_surface.ridges(context, wires))
        yield
        run.faces = (*rules_surface.with_end_error(context, wires, run.faces), *formed, *milled)
        models = functools.cache(functools.partial(self.model, context))
        run.add("verify.kinematics", rules_kinematics.kinematics(context, models))
        yield
        outcome, run.looks, run.clearance = rules_cell.bodies(context, models)
        run.add("verify.clearance", outcome)
        yield
        run.add("verify.step_apart", handshake_apart.step_apart(context, models))
        yield
        outcome, run.wire_clearance = rules_cell.wire_bodies(context, models, wires)
        run.add("verify.wire_clearance", outcome)
        yield


class _Run:
    """What a proof has found so far."""

    def __init__(self, context: Context) -> None:
        self.context = context
        self.results: dict[str, RuleResult] = {}
        self.issues: list[Issue] = []
        self.wires: tuple[Wire, ...] = ()
        self.faces: tuple[CutFace, ...] = ()
        self.forming: Forming | None = None
        self.part = ""
        self.looks: Any = np.zeros(0, dtype=np.int64)
        self.clearance: Any = None
        self.wire_clearance: list[Any] = []

    @property
    def broken(self) -> bool:
        return has_errors(self.issues)

    def broken_any(self, *codes: str) -> bool:
        return any(code in self.results and not self.results[code].passed for code in codes)

    @functools.cached_property
    def _changed(self) -> pendant.Marks:
        return pendant.marks(self.context.job)

    def add(self, code: str, outcome: Outcome) -> None:
        at_moves = code not in _OF_TEXT
        self.issues += [
            pendant.told(self._changed, told(issue)) if at_moves else pendant.of_form(told(issue))
            for issue in outcome.issues
        ]
        passed, measure = not has_errors(outcome.issues), (outcome.worst, outcome.limit, outcome.unit)
        self.results[code] = RuleResult(code, TITLES[code], passed, *measure, outcome.where)

    def proof(self) -> Proof:
        rules = tuple(
            self.results.get(code) or RuleResult(code, TITLES[code], False, where="not reached", ran=False)
            for code in RULES
        )
        series: dict[str, Any] = {}
        if self.context.playable and "verify.reach" in self.results:
            series = report_series.series(
                self.context, self.wires, self.forming, self.looks, self.clearance, self.wire_clearance
            )
        return Proof(
            self.context.problem.digest, rules, aggregate(self.issues), series, self.faces, self.part
        )


def prove(problem: Problem, claims: Mapping[str, tuple[Claim, ...]], programs: Mapping[str, str]) -> Proof:
    """Prove programs from their text.

    ``claims`` {operation: claims} follow from the problem; ``programs`` {file name: text}. What is wrong
    with the programs is in the proof; raises ``TandemError`` for programs so long that they are not looked at
    (verify.duration), and for claims that no rule proves (claims.unproven, claims.none).
    """
    refused = unproven(claims)
    if refused:
        raise TandemError(refused)
    return Prover(problem, claims).prove(programs)
