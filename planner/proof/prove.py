"""The proof: from the problem and the program text alone to a verdict, rule by rule.

Rules stand in an order in which each one may rely on those before it: text, tasks side by side, data,
motion, cell, wire, surface. Where a fault leaves a later rule nothing to look at, that rule has not
run, and the proof does not hold. Nothing may be claimed that no rule looks at (:data:`PROVEN_BY`),
for a reader of the claims would take it as proven.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

from planner.cell.plant import CellModel, build
from planner.claims.claim import ArmSags, Claim, OneOf
from planner.geometry.arrays import FloatArray
from planner.issues import Issue, TandemError, aggregate, has_errors, with_remedy
from planner.languages.krl.rules import moves as krl_moves
from planner.languages.krl.rules import spline
from planner.languages.rapid.rules import confdata
from planner.languages.rapid.rules import settings as rapid_settings
from planner.languages.trajectories.rules import trajectories
from planner.problem import TILT, Problem, Settings, setups_of
from planner.processes.forming.proof import swept
from planner.processes.forming.proof.face import Face
from planner.processes.forming.proof.rules import claims as forming_claims
from planner.processes.forming.proof.rules import level, part, springback, tool, two_tools
from planner.processes.forming.proof.state import Forming, Left, begun_faces
from planner.processes.hotwire.proof.rules import clearance as hotwire_clearance
from planner.processes.hotwire.proof.rules import cut_part, dialogue_figures, straight_wire, wire, wire_alone
from planner.processes.hotwire.proof.wire_motion import Wire
from planner.processes.hotwire.proof.wire_motion import wires as all_wires
from planner.processes.milling.proof import wanted_ways
from planner.processes.milling.proof.rules import cutter
from planner.processes.milling.proof.tool_motion import Milling
from planner.processes.poses.proof.rules import given_poses
from planner.processes.trim.proof import outlines
from planner.processes.trim.proof.rules import forming_holes, knife, mill, slots
from planner.processes.trim.proof.torch_motion import Trimming
from planner.proof import verdict
from planner.proof.clearance.samples import Measured
from planner.proof.context import Context
from planner.proof.dialogue import chosen_groups
from planner.proof.kinematics.external_axes import moved_on
from planner.proof.rule import Outcome, Rule
from planner.proof.rules import (
    arm_sag,
    block_support,
    clearance,
    controller_files,
    dialogue,
    external_axes,
    handshake,
    moves,
    order,
    part_file,
    power,
    robot_motion,
    setups_and_frames,
    synchronisation,
    text,
    track_along,
    track_way,
    waiting_time,
)
from planner.proof.verdict import CutFace, Proof, RuleResult
from planner.runtime.executor import SERIAL, Executor
from planner.runtime.memory import release_memory

_RuleTable = tuple[Rule[[Context], Outcome], ...]

TEXT_RULES: _RuleTable = (
    text.syntax,
    text.declarations,
    text.persistents,
    text.names,
    text.line_lengths,
    text.module_size,
    text.decimals,
    text.files,
    text.digest,
)
"""Rules about the text alone."""
_TEXT_CODES = frozenset(rule.code for rule in TEXT_RULES)
"""Codes of rules that need no motion."""
ROBOT_RULES: _RuleTable = (robot_motion.robot_model,)
"""Rules about the robots' data."""
TASK_RULES: _RuleTable = (
    synchronisation.task_list,
    synchronisation.sync_order,
    handshake.handshake,
    waiting_time.meeting_time,
    rapid_settings.error_handler,
    rapid_settings.undo,
    rapid_settings.motion_settings,
    rapid_settings.hidden,
    controller_files.cell_check,
    controller_files.controller_files,
    trajectories.start_posture,
    trajectories.goal_tolerances,
    trajectories.power_on_failure,
)
"""Rules about the tasks and how they meet."""
STAGE_RULES: _RuleTable = (
    setups_and_frames.setup,
    dialogue.messages_and_questions,
    synchronisation.move_count,
    synchronisation.move_ids,
    synchronisation.zone_kind,
    synchronisation.move_time,
    synchronisation.speed_data,
    synchronisation.arms_alone,
    wire_alone.wire_alone,
    synchronisation.stop_before_logic,
    power.signals,
    setups_and_frames.tool_data,
    setups_and_frames.work_object,
    setups_and_frames.held_frame,
    setups_and_frames.load,
    setups_and_frames.base_frames,
    block_support.rests,
    krl_moves.status,
    moves.move_kinds,
    external_axes.external_axes,
    moves.unknown_start,
    moves.zone_size,
    moves.zero_length,
    wire.wire_mount,
)
"""Rules about the steps of each setup."""
MOTION_RULES: _RuleTable = (
    robot_motion.reach,
    arm_sag.sag,
    robot_motion.corners,
    robot_motion.continuity,
    confdata.confdata,
    robot_motion.joint_limits,
    robot_motion.rod_limits,
    robot_motion.joint_speed,
    robot_motion.joint_acceleration,
    robot_motion.singularity,
    robot_motion.tcp_speed,
    track_along.track_along,
    trajectories.between_points,
    waiting_time.power_idle,
    given_poses.follows,
    order.order,
)
"""Rules about any motion."""
WIRE_RULES: tuple[Rule[[Context, tuple[Wire, ...]], Outcome], ...] = (
    wire.wire_length,
    wire.wire_stability,
    wire.curvature,
    wire.contact,
    wire.stop_in_foam,
    wire.wire_power,
    dialogue_figures.message_figures,
    wire.feed,
    straight_wire.bow,
    straight_wire.rulings,
    straight_wire.slit,
)
"""Rules about wires."""
OTHER_RULES: tuple[Rule[..., Any], ...] = (
    cut_part.surface,
    straight_wire.kerf,
    part_file.part_file,
    cut_part.ridges,
    cut_part.part,
    robot_motion.kinematics,
    clearance.bodies,
    clearance.own_bodies,
    clearance.step_apart,
    track_way.track_way,
    hotwire_clearance.wire_bodies,
)
"""Rules about any motion that ask the most time; another process may look at the last six of them."""
FORMING_RULES: tuple[Rule[[Context, Forming], Outcome], ...] = (
    part.forming_part,
    forming_holes.forming_holes,
    forming_claims.forming_claims,
    springback.springback,
    level.level,
    tool.feature_order,
    tool.feed,
    tool.lean,
    tool.gouge,
    two_tools.gap,
    two_tools.border,
    two_tools.opposite,
    tool.sheet,
    tool.holder,
    two_tools.by_table,
)
"""Rules about sheets."""
FORMED_RULES: tuple[Rule[..., Any], ...] = (tool.formed,)
"""The rule about the formed part, behind all others about sheets."""

MILLED_RULES: tuple[Rule[..., Any], ...] = (cutter.milled,)
"""The rule about the milled part, before all others about mills."""
MILLING_RULES: tuple[Rule[[Context, Milling], Outcome], ...] = (
    cutter.mill_gouge,
    cutter.mill_path,
    cutter.mill_feed,
    cutter.spindle,
)
"""Rules about mills."""

TRIM_RULES: tuple[Rule[[Context, Trimming], Outcome], ...] = (
    slots.trim_cut,
    slots.trim_kept,
    slots.trim_torch,
    slots.trim_arc,
    slots.trim_order,
    slots.trim_feed,
    slots.trim_clear,
    mill.trim_mill,
    mill.trim_spindle,
    knife.trim_knife,
)
"""Rules about sheets that are trimmed."""

SPLINE_RULES: tuple[Rule[..., Any], ...] = (spline.spline,)
"""The rule about spline blocks."""

NEEDED_RULES = (
    "verify.setup",
    "verify.move_count",
    "verify.sync_order",
    "verify.handshake",
    "verify.arms_alone",
    "verify.held_frame",
    "verify.status",
)
"""What must hold for a motion to follow from the text."""

_ALL_RULES = (
    *(
        TEXT_RULES,
        ROBOT_RULES,
        TASK_RULES,
        STAGE_RULES,
        SPLINE_RULES,
        MOTION_RULES,
        FORMING_RULES,
        FORMED_RULES,
    ),
    *(MILLED_RULES, MILLING_RULES, TRIM_RULES, WIRE_RULES, OTHER_RULES),
)
"""All rules, in the order in which they run."""
RULE_CODES: tuple[str, ...] = tuple(rule.code for table in _ALL_RULES for rule in table)
"""Codes of all rules."""

RULE_TITLES: Mapping[str, str] = {rule.code: rule.title for table in _ALL_RULES for rule in table}
"""What each rule asks, by code."""
PROVEN_BY: Final[Mapping[type, tuple[str, ...]]] = {
    kind: tuple(rule.code for table in _ALL_RULES for rule in table if kind in rule.proves)
    for kind in dict.fromkeys(kind for table in _ALL_RULES for rule in table for kind in rule.proves)
}
"""The rules that prove each kind of claim."""


MOST_SENT_SAMPLES: Final = 500_000
"""Samples of motions at most that go to another process [-]: 100 MB for two arms. For more, as forming jobs
of an hour have, the copy costs more memory than it gains time: of these only the looks at clearance go."""


def unproven(claims: Mapping[str, tuple[Claim, ...]]) -> list[Issue]:
    """What is claimed of an operation though no rule proves it, and operations of which nothing is claimed;
    ``claims`` by the operation's name."""
    out = []
    for name, group in claims.items():
        inner = [c for claim in group if isinstance(claim, OneOf) for one in claim.either for c in one]
        known = (type(claim) for claim in (*group, *inner) if type(claim) not in PROVEN_BY)
        for kind in dict.fromkeys(known):
            what = f"{name}: its process claims {kind.__name__}, which no rule of the proof looks at"
            hint = "give the proof a rule for it, or claim what there are rules for"
            out.append(Issue("claims.unproven", f"{what}; {hint}", field="operations.process"))
        if all(isinstance(claim, ArmSags) for claim in group):
            what = f"{name}: its process claims nothing, so nothing of it would be proven"
            what += "; let it claim what has to hold"
            out.append(Issue("claims.none", what, field="operations.process"))
    return out


@dataclasses.dataclass
class Prover:
    """Proves programs of one problem. Keeps the Drake models of its setups and the faces of its claims
    between proofs, which then start at once. ``executor`` checks rules that no other rule waits for."""

    problem: Problem
    claims: Mapping[str, tuple[Claim, ...]]
    executor: Executor = SERIAL
    _models: dict[int, CellModel] = dataclasses.field(default_factory=dict)
    _faces: list[tuple[float, Face]] = dataclasses.field(default_factory=list)
    _worked_out: tuple[Mapping[str, tuple[Claim, ...]], tuple[Issue, ...]] | None = None

    def prove(self, programs: Mapping[str, str], first_error: bool = False, last: str | None = None) -> Proof:
        """The proof of ``programs``. ``first_error``: stop at the first rule that is broken (the verdict is
        the same). ``last``: stop behind that rule; such a proof never holds."""
        if self._worked_out is None:
            milled, unmilled = wanted_ways.worked_out(self.claims)
            trimmed, untrimmed = outlines.worked_out(milled)
            self._worked_out = trimmed, (*unmilled, *untrimmed)
        read = Context(self.problem, self._worked_out[0], programs, self._worked_out[1])
        context = chosen_groups(external_axes.standing(read))
        run = _Run(context)
        for _ in self._steps(context, run):
            if run.long:
                release_memory()  # what a rule leaves free would count beside the next one's arrays
            if (first_error and run.broken) or last in run.results:
                break
        return run.proof()

    def __getstate__(self) -> dict[str, Any]:
        """For another process, which has models of its own and starts no process."""
        return {**vars(self), "executor": SERIAL, "_models": {}, "_faces": []}

    def model(self, context: Context, index: int = 0) -> CellModel:
        """The cell of a setup, by its index, with block, bases and what is tilted where the text has them."""
        return self._model(context.places, context.bases_by_setup, (context.tilts, context.stands), index)

    def _model(
        self,
        places: Sequence[FloatArray | None],
        based: Sequence[Mapping[str, FloatArray]],
        stood: tuple[Sequence[float], Sequence[Mapping[str, float]]],
        index: int,
    ) -> CellModel:
        setup, place, bases = setups_of(self.problem)[index], places[index], based[index]
        place = np.eye(4) if place is None else place
        if index not in self._models:
            self._models[index] = build(setup.cell, setup.stock, place, bases)
        model, table = self._models[index].with_stock(place).with_bases(bases), setup.cell.turntable
        tilts, stands = stood
        here = {name: value for arm in setup.cell.arms for name, value in arm.stands.items()}
        model = model.with_moved(moved_on(setup.cell, stands[index], here))
        if table is None or table.tilt is None:
            return model
        leans = model.stock.tilt or 0.0
        return model.with_moved({TILT: table.tilt.turned(np.eye(4), tilts[index] - leans)})

    def _steps(self, context: Context, run: _Run) -> Iterator[None]:
        """Runs the rules one after the other and hands control back behind each."""
        for rule in (*TEXT_RULES, *ROBOT_RULES):
            run.add(rule.code, rule(context))
            yield
        if run.broken_any("verify.robot_model"):
            return  # where arms are does not follow from their files
        if not context.readable:
            return
        left = begun_faces(context, self.executor)
        for rule in TASK_RULES:
            run.add(rule.code, rule(context))
            yield
        if not context.playable:
            return
        for rule in STAGE_RULES:
            run.add(rule.code, rule(context))
            yield
        if run.broken_any(*NEEDED_RULES):
            return
        outcome, context = spline.spline(context)  # from here on with what its curves leave of room
        run.add("verify.spline", outcome)
        yield
        for rule in MOTION_RULES:
            run.add(rule.code, rule(context))
            yield
        if run.broken_any("verify.reach"):
            return
        yield from self._physics(context, run, left)

    def _of_bodies(self, context: Context, begun: clearance.Begun | None = None) -> Iterator[Any]:
        """What rules on the cell's bodies find; ``begun``: what is measured at the looks, if it is begun."""
        models = functools.cache(functools.partial(self.model, context))
        if begun is None:  # both rules on clearance have their looks of it
            some = clearance.looks(context)
            begun = some, clearance.measured(models, some, context.problem.settings)
        yield robot_motion.kinematics(context, models)
        yield clearance.bodies(context, models, begun)
        yield clearance.own_bodies(context, models, begun)
        yield clearance.step_apart(context, models)
        yield track_way.track_way(context, models)

    def _measured(
        self,
        places: Sequence[FloatArray | None],
        based: Sequence[Mapping[str, FloatArray]],
        stood: tuple[Sequence[float], Sequence[Mapping[str, float]]],
        looks: Sequence[clearance.Looks],
        settings: Settings,
    ) -> Iterator[Measured | None]:
        """What is measured at looks at clearance, with blocks and bases there; ``settings``: those of the
        context, which may ask for more than the problem's."""
        models = functools.cache(functools.partial(self._model, places, based, stood))
        yield from clearance.measured(models, looks, settings)

    def _of_wires(self, context: Context, wires: tuple[Wire, ...]) -> Iterator[Any]:
        """What rules on wires find that ask the most time."""
        yield cut_part.part(context, wires)
        models = functools.cache(functools.partial(self.model, context))
        yield hotwire_clearance.wire_bodies(context, models, wires)

    def _physics(self, context: Context, run: _Run, left: Left) -> Iterator[None]:
        run.long = len(context.motion.time) > MOST_SENT_SAMPLES
        if not run.long:
            executor, of_bodies = self.executor, self.executor.submit(self._of_bodies, context)
        else:
            executor, looks = SERIAL, clearance.looks(context)
            found = self.executor.submit(
                self._measured,
                context.places,
                context.bases_by_setup,
                (context.tilts, context.stands),
                looks,
                context.problem.settings,
            )
            of_bodies = self._of_bodies(context, (looks, found))
        forming = run.forming = Forming(context, self.executor, left, self._faces)
        passes = [swept.Swept.of(one) for one in forming.formed]
        envelopes = (self.executor if passes else SERIAL).submit(swept.envelopes, passes)
        for form_rule in FORMING_RULES:
            run.add(form_rule.code, form_rule(context, forming))
            if run.long:  # what one leaves free would count beside what the next one needs
                release_memory()
            yield
        outcome, formed = tool.formed(context, forming, envelopes)
        run.add("verify.formed", outcome)
        yield
        milling = Milling(context, executor)
        outcome, milled = cutter.milled(context, milling)
        run.add("verify.milled", outcome)
        yield
        for mill_rule in MILLING_RULES:
            run.add(mill_rule.code, mill_rule(context, milling))
            yield
        trimming = Trimming(context, forming)
        for trim_rule in TRIM_RULES:
            run.add(trim_rule.code, trim_rule(context, trimming))
            yield
        wires = all_wires(context)
        run.wires = wires
        of_wires = (
            executor.submit(self._of_wires, context, wires) if wires else self._of_wires(context, wires)
        )
        for rule in WIRE_RULES:
            run.add(rule.code, rule(context, wires))
            yield
        sweeps = cut_part.sweeps(context, wires)
        outcome, run.faces, run.part = cut_part.surface(context, sweeps)
        run.part = run.part or swept.obj(forming)
        run.add("verify.surface", outcome)
        yield
        run.add("verify.kerf", straight_wire.kerf(context, run.faces, wires))
        yield
        run.add("verify.part_file", part_file.part_file(context, sweeps, forming, milling))
        del milling  # the tracks of a long job, beside which what follows would count
        yield
        run.add("verify.ridge", cut_part.ridges(context, wires))
        yield
        run.faces = (*cut_part.with_end_error(context, wires, run.faces), *formed, *milled)
        run.add("verify.part", next(of_wires))
        yield
        run.add("verify.kinematics", next(of_bodies))
        yield
        outcome, run.looks, run.clearance = next(of_bodies)
        run.add("verify.clearance", outcome)
        yield
        outcome, run.own_looks, run.own_clearance = next(of_bodies)
        run.add("verify.own_clearance", outcome)
        yield
        run.add("verify.step_apart", next(of_bodies))
        yield
        run.add("verify.track_way", next(of_bodies))
        yield
        outcome, run.wire_clearance = next(of_wires)
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
        self.long = False
        self.part = ""
        self.looks: Any = np.zeros(0, dtype=np.int64)
        self.clearance: Any = None
        self.own_looks: Any = np.zeros(0, dtype=np.int64)
        self.own_clearance: Any = None
        self.wire_clearance: list[Any] = []

    @property
    def broken(self) -> bool:
        return has_errors(self.issues)

    def broken_any(self, *codes: str) -> bool:
        return any(code in self.results and not self.results[code].passed for code in codes)

    @functools.cached_property
    def _changed(self) -> text.Marks:
        return text.marks(self.context.job)

    def add(self, code: str, outcome: Outcome) -> None:
        at_moves = code not in _TEXT_CODES
        self.issues += [
            text.with_pendant_cause(self._changed, with_remedy(issue))
            if at_moves
            else text.with_form_cause(with_remedy(issue))
            for issue in outcome.issues
        ]
        title, passed = RULE_TITLES[code], not has_errors(outcome.issues)
        if passed and outcome.nothing:
            self.results[code] = RuleResult(code, title, True, where=outcome.nothing, applies=False)
            return
        measure = outcome.worst, outcome.limit, outcome.unit
        self.results[code] = RuleResult(code, title, passed, *measure, outcome.where or outcome.nothing)

    def proof(self) -> Proof:
        rules = tuple(
            self.results.get(code)
            or RuleResult(code, RULE_TITLES[code], False, where="not reached", ran=False)
            for code in RULE_CODES
        )
        series: dict[str, Any] = {}
        if self.context.playable and "verify.reach" in self.results:
            distances = {
                "clearance": (self.looks, self.clearance),
                "own_clearance": (self.own_looks, self.own_clearance),
            }
            series = verdict.series(self.context, self.wires, self.forming, distances, self.wire_clearance)
        return Proof(
            self.context.problem.digest, rules, aggregate(self.issues), series, self.faces, self.part
        )


def prove(
    problem: Problem,
    claims: Mapping[str, tuple[Claim, ...]],
    programs: Mapping[str, str],
    executor: Executor = SERIAL,
) -> Proof:
    """Prove programs from their text.

    ``claims`` {operation: claims} follow from the problem; ``programs`` {file name: text}.
    ``executor`` checks independent rules; the proof is the same whatever it is. What is wrong with the
    programs is in the proof; raises ``TandemError`` for programs so long that they are not looked at
    (verify.duration), and for claims that no rule proves (claims.unproven, claims.none).
    """
    refused = unproven(claims)
    if refused:
        raise TandemError(refused)
    return Prover(problem, claims, executor).prove(programs)
