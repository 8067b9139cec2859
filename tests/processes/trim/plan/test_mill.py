"""A mill cuts apertures out of a dish: refusals, programs in RAPID and KRL, and reported faults.

Positions are compared with closed forms: the slot of a round hole, the depth of a tip.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

from planner import pipeline
from planner.geometry.arrays import Mesh
from planner.issues import TandemError
from planner.languages.writing import write
from planner.motion import solve
from planner.processes import registry
from planner.processes.trim.plan.check import gouge_depths
from planner.processes.trim.plan.cutting import CuttingTool, shank_body
from planner.processes.trim.plan.face import SheetFace, project_curve
from planner.processes.trim.plan.operation import OutlineFile
from planner.processes.trim.plan.slots import PlannedOutline
from planner.processes.trim.proof import outlines
from planner.processes.trim.proof.rules.mill import MeasuredCut, _check_gouge, trim_mill, trim_spindle
from planner.processes.trim.proof.rules.slots import trim_cut
from planner.processes.trim.proof.torch_motion import TRIMMING, Trimming
from planner.proof.context import Context
from planner.proof.findings import Findings
from planner.proof.prove import Prover
from planner.proof.rules.power import signals
from planner.targets import ScrewFreedom
from planner.tooling import CutterGeometry, mill
from tests import urdf_text
from tests.processes.milling.proof.milling_job import in_procedure
from tests.processes.trim.plan.small_trim import KUKA, MILL, OUTLINES, Job, data, milled, problem
from tests.processes.trim.plan.test_proof import (
    before_last_move,
    leant,
    moved,
    replaced,
    timed,
    without_moves,
)
from tests.proof import handshake_job
from tests.small_forming import die, dish
from tests.small_forming import write as write_forming

ROUND, WALL = OUTLINES[0], OUTLINES[1]
MAIN = "operation_1"
ON = "SetDO doSpindle,1;"
SPINDLE_OFF = "SetDO doSpindle,0;"


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Job:
    return Job(tmp_path_factory.mktemp("mill"), outlines=[ROUND, WALL], **milled())


def up(z: float) -> Callable[[str], str]:
    return moved(lambda p: p + np.array([0.0, 0.0, z]))


def along(x: float) -> Callable[[str], str]:
    return moved(lambda p: p + np.array([x, 0.0, 0.0]))


def deeper_first(text: str) -> str:
    """Its move, and before that one to 2 mm below where the tip was."""
    at = text.index("    MoveL")
    line = text[at : text.index("\n", at) + 1]
    return text[:at] + moved(lambda p: np.array([p[0], p[1], -9.0]))(line) + text[at:]


FAULTS: dict[str, tuple[str, str, Callable[[str], str]]] = {
    "a hole beside its place": ("verify.trim_kept", "trim_round", along(1.0)),
    "a hole too small": ("verify.trim_cut", "trim_round", moved(lambda p: p * np.array([0.9, 0.9, 1.0]))),
    "a hole not closed": ("verify.trim_cut", "trim_round", without_moves(slice(-9, None))),
    "an outline left out": ("verify.trim_cut", MAIN, replaced("trim_wall;", "")),
    "not through the sheet": ("verify.trim_mill", "trim_round", up(0.8)),
    "too deep": ("verify.trim_mill", "trim_round", up(-0.8)),
    "too deep on a wall": ("verify.trim_mill", "trim_wall", up(-1.0)),
    "the cutter leans": ("verify.trim_mill", "trim_round", leant(10.0)),
    "down too fast": ("verify.trim_mill", "trim_round", timed(0.2)),
    "down in the part": ("verify.trim_mill", "trim_round_in", along(8.0)),
    "into the sheet on the way to it": ("verify.trim_mill", "trim_round_in", up(-3.0)),
    "deeper on the way out": ("verify.trim_mill", "trim_round_out", deeper_first),
    "aside on the way out": ("verify.trim_mill", "trim_round_out", along(20.0)),
    "the spindle stands": ("verify.trim_spindle", MAIN, replaced(ON, "")),
    "the spindle is off again at once": ("verify.trim_spindle", MAIN, replaced(ON, ON + SPINDLE_OFF)),
    "not up to speed": ("verify.trim_spindle", MAIN, replaced("WaitTime 5;", "WaitTime 0.5;")),
    "it stops in a slot": ("verify.trim_spindle", "trim_round", before_last_move("SetDO doSpindle,0;")),
    "twice as fast": ("verify.trim_feed", "trim_wall", timed(0.5)),
    "the shank in the sheet": ("verify.trim_clear", "trim_wall", up(-8.0)),
}


def test_the_programs_are_proven(job: Job) -> None:
    proof = job.prove(job.programs, None)
    assert proof.issues == ()
    assert proof.ok
    text = "".join(job.programs.values())
    assert "doArc" not in text and "diArcOk" not in text
    assert text.count(ON) == 1
    assert "TandemTorch" not in text  # a spindle may be set on again by hand, as another's


@pytest.mark.sampled(every=3)
@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_told_by_the_rule_for_it(job: Job, name: str) -> None:
    code, procedure, change = FAULTS[name]
    programs = in_procedure(job.programs, procedure, change)
    assert programs != job.programs
    assert job.told_by(code, programs)


def test_the_slot_is_half_a_cutter_inside_and_the_tip_through_the_sheet(job: Job) -> None:
    targets = job.plan.operations[0].targets
    pose = targets.pose["robot"]
    rows = [
        k for k, s in enumerate(targets.segment) if s.kind == "trim" and s.name == "round" and not s.phase
    ]
    tip = pose[rows, :3, 3] / 1e-3
    radius = np.hypot(tip[:, 0], tip[:, 1])
    cut = radius > 6.9
    # a hole of 16 mm by a cutter of 2 mm; the floor's upper face is at -6 + 1 mm, its lower one at -6 mm
    np.testing.assert_allclose(radius[cut], 7.0, atol=0.03)
    np.testing.assert_allclose(tip[cut, 2], -7.0, atol=1e-3)
    first = pose[rows[0] - 1, :3, 3] / 1e-3  # the way down ends 2 mm over the upper face
    assert first[2] == pytest.approx(-5.0 + 2.0, abs=1e-3)


def test_a_cutter_on_a_wall_turns_about_the_face_when_it_leans(tmp_path: Path) -> None:
    targets = registry.job(problem(tmp_path, outlines=[WALL], **milled(below_mm=2)), 0).targets()
    for one in targets.freedoms:
        assert isinstance(one, ScrewFreedom)
        twist = one.axis["robot"]
        if one.name.startswith("tilt"):
            face = np.array([0.0, 0.0, -3.0e-3])  # sheet of 1 mm and 2 mm below
            assert np.cross(twist[:3], face) + twist[3:] == pytest.approx(0.0, abs=1e-12)


def test_a_cutter_goes_down_a_ramp_unturned_and_slower_than_it_may(tmp_path: Path) -> None:
    """On walls a ramp is uneven: the proof found 2.1 mm/s where 2 are allowed."""
    targets = registry.job(problem(tmp_path, outlines=[WALL], **milled(plunge_mm_s=2)), 0).targets()
    pose = targets.pose["robot"]
    rows = np.array([k for k, s in enumerate(targets.segment) if s.key == "trim/wall"])
    rows = np.concatenate([rows[:1] - 1, rows])
    down = -((pose[rows[1:], :3, 3] - pose[rows[:-1], :3, 3]) * -pose[rows[1:], :3, 2]).sum(axis=1)
    way = np.linalg.norm(pose[rows[1:], :3, 3] - pose[rows[:-1], :3, 3], axis=1)
    steep = np.flatnonzero(down > 0.2e-3)
    assert len(steep) > 2
    assert (targets.feed[rows[1:]][steep] * (down / way)[steep]).max() <= 0.85 * 2e-3
    for one in targets.freedoms[:2]:
        assert isinstance(one, ScrewFreedom)
        assert (one.upper[rows[1:][steep]] == 0.0).all()


@pytest.mark.long
def test_a_kuka_plunges(tmp_path: Path) -> None:
    numbers = {"io": {"robot": {"doSpindle": 17}}, "dialect": "krc4"}
    hole = {"name": "round", "circle": {"at_mm": [0, 0], "diameter_mm": 12}}
    own = Job(
        tmp_path, arm=KUKA, controller=numbers, outlines=[hole], **milled(entry="plunge", plunge_mm_s=1)
    )
    proof = own.prove(own.programs, None)
    assert proof.issues == ()
    main = own.programs["robot/trimmed.src"]
    assert main.count("$OUT[17]=TRUE") == 1
    changed = {**own.programs, "robot/trimmed.src": main.replace("$OUT[17]=TRUE", "$OUT[17]=FALSE", 1)}
    assert own.told_by("verify.trim_spindle", changed)
    targets = own.plan.operations[0].targets
    begin = next(k for k, s in enumerate(targets.segment) if s.kind == "trim" and not s.phase)
    ways = np.diff(targets.pose["robot"][begin - 1 : begin + 1, :3, 3], axis=0)[0]
    assert ways == pytest.approx([0.0, 0.0, -4.0e-3], abs=1e-6)  # from 2 mm over it to 1 mm through 1 mm


@pytest.mark.long
def test_short_slots_are_as_fast_as_asked_where_nothing_goes_down(tmp_path: Path) -> None:
    """The last bit of a slow way down is not counted as slow cutting; a slot that is cut slowly is, and the
    planner says so, however quick the way down is for its feed."""
    rim = {"name": "rim", "circle": {"at_mm": [0, 0], "diameter_mm": 24}, "drops": "inside", "joints": 4}
    own = Job(tmp_path, outlines=[rim], feed_mm_s=25, **milled())
    assert own.prove(own.programs).issues == ()

    def slower(text: str) -> str:
        rows = text.split("\n")
        moves = [k for k, row in enumerate(rows) if "MoveL" in row]
        for k in moves[1:]:  # the first one goes down
            rows[k] = re.sub(r"\\T:=([\d.]+)", lambda f: f"\\T:={3.0 * float(f[1]):.5f}", rows[k])
        return "\n".join(rows)

    changed = in_procedure(own.programs, "trim_rim_p1", slower)
    assert changed != own.programs
    assert own.told_by("verify.trim_feed", changed)
    operation_plan, job = own.plan.operations[0], registry.job(own.problem, 0)
    own_rows = np.array([str(s) == "trim/rim_p1" for s in operation_plan.targets.segment])
    spent = np.diff(operation_plan.time, prepend=operation_plan.time[0])
    behind = np.cumsum(own_rows) > 2  # of its rows: down, and the first at the bottom
    late = np.cumsum(np.where(own_rows & behind, 3.0 * spent, spent))
    assert job.check_timing(operation_plan.targets, operation_plan.time) == ()
    assert [i.code for i in job.check_timing(operation_plan.targets, late)] == ["trim.slow"]


def refused(folder: Path, **fields: Any) -> list[Any]:
    with pytest.raises(TandemError) as error:
        registry.job(problem(folder, **fields), 0).targets()
    return [issue for issue in error.value.issues if issue.severity.name == "ERROR"]


@pytest.mark.parametrize(
    ("fields", "code", "words"),
    [
        ({**milled(), "tool": {}}, "trim.tool", "not a mill"),
        ({"tool": MILL}, "trim.tool", "not a torch"),
        (milled({"flute_mm": 2.5}), "trim.tool", "does not reach through the sheet, required 3.10 mm"),
        (milled({"cutter": "ball", "diameter_mm": 4}), "trim.tool", "round over 2 mm, stays in the sheet"),
        (milled({"flute_mm": 3.2, "shank_diameter_mm": 18}), "trim.wall", "the cutter's shank or holder"),
    ],
)
def test_cutters_that_do_not_fit_are_refused(
    tmp_path: Path, fields: dict[str, Any], code: str, words: str
) -> None:
    hole = {"name": "hole", "circle": {"at_mm": [30, 0], "diameter_mm": 7}}
    (issue,) = refused(tmp_path, outlines=[hole], lead={"length_mm": 1.0}, **fields)
    assert issue.code == code
    assert words in issue.message
    assert issue.hint


def test_a_thick_cutter_beside_a_wall_goes_into_it() -> None:
    """A floor up to x = 10 mm and a wall of 45 deg behind: a cutter of 8 mm that stands upright at 7 mm
    reaches 11 mm, over a curve that is 1 mm up the wall by 1.41 - 1 = 0.41 mm, of which places 2 mm apart at
    most find what they find."""
    xs = np.array([-60.0, 10.0, 40.0])
    low, high = (np.column_stack([xs, np.full(3, y), np.maximum(xs - 10.0, 0.0)]) for y in (-60.0, 60.0))
    mesh = Mesh(np.concatenate([low, high]) * 1e-3, np.array([[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]]))
    face = SheetFace(mesh, 0.001, 1)
    edge = 10.0 + np.sqrt(0.5)
    ring = np.array([[-30.0, -30.0], [edge, -30.0], [edge, 30.0], [-30.0, 30.0]]) * 1e-3
    laid = project_curve("a", ring, face)
    spec = OutlineFile.model_validate({"name": "a", "circle": {"at_mm": [0, 0], "diameter_mm": 1}})
    one = PlannedOutline(spec, laid, shapely.Polygon(laid.point[:, :2]))
    cutter = mill(CutterGeometry("cylinder", 0.004, 0.0, 0.012, 0.03)).cutter
    tool = CuttingTool("cutter", 0.008, 0.002, 0.004, shank_body(cutter), cutter)
    wall = np.linspace(10.0, 14.0, 401)
    places = np.column_stack([wall, np.zeros(401), wall - 10.0 + 1.0]) * 1e-3
    tip = np.array([[0.007, 0.0, -0.001], [0.0055, 0.0, -0.001]])
    deep, where = gouge_depths(one, tool, places, 0.001, 1, (tip, np.tile([0.0, 0.0, 1.0], (2, 1))))
    assert deep == pytest.approx([(11.0 - edge) * np.sqrt(2.0) * 1e-3, 0.0], abs=2e-5)
    assert where[0, 0] == pytest.approx(0.011, abs=2e-5)


def test_the_proof_finds_a_cutter_that_is_too_thick_for_its_slot(job: Job) -> None:
    context, made = trimming(job, job.programs)
    (work,) = made.sheets
    own = work.claim.mill
    assert own is not None
    way = work.slot_path("trim/round")
    assert way is not None
    curve = work.slots["trim/round"]
    findings = Findings("verify.trim_mill", context)
    _check_gouge(MeasuredCut(findings, work, "trim/round", way), curve, own)
    assert not findings.issues
    thick = dataclasses.replace(own, cutter=dataclasses.replace(own.cutter, radius=2.0e-3))
    _check_gouge(MeasuredCut(findings, work, "trim/round", way), curve, thick)
    assert {issue.code for issue in findings.issues} == {"verify.trim_mill"}


@pytest.mark.parametrize(
    "field",
    [{"pierce": {"seconds": 1}}, {"pierce": {"height_mm": 2}}, {"ok_signal": "diFast"}, {"ok_timeout_s": 3}],
)
def test_fields_of_a_torch_are_refused_for_a_mill(tmp_path: Path, field: dict[str, Any]) -> None:
    with pytest.raises(TandemError) as error:
        problem(tmp_path, **(milled() | field))
    assert {issue.code for issue in error.value.issues} == {"problem.field"}


def test_a_die_behind_the_sheet_is_not_cut(tmp_path: Path) -> None:
    whole = data(outlines=[ROUND], **milled())
    (trim,) = whole["operations"]
    own = die(tmp_path, dish(), "female", True)
    form = {
        "name": "form",
        "process": "forming",
        "arms": ["robot"],
        "mode": "tpif",
        "stepdown_mm": 2,
        "die": own,
    }
    ball = {"kind": "ball_tool", "radius_mm": 6, "length_mm": 180}
    whole["operations"] = [form, {**trim, "setup": {"tools": {"robot": whole["cell"]["arms"][0]["tool"]}}}]
    whole["cell"]["arms"][0]["tool"] = ball
    read = pipeline.load(write_forming(tmp_path, whole, dish()))
    with pytest.raises(TandemError) as error:
        registry.job(read, 1).targets()
    assert [issue.code for issue in error.value.issues] == ["trim.die"]


def test_the_proof_asks_for_a_die_itself(job: Job) -> None:
    source = dict(job.problem.source)
    source["operations"] = [{**one, "die": {"file": "post.ply"}} for one in source["operations"]]
    known = job.problem
    job.problem = dataclasses.replace(known, source=source)
    try:
        assert job.told_by("verify.trim_mill", job.programs)
    finally:
        job.problem = known


@pytest.mark.parametrize(("sync", "reported"), [("handshake", True), ("multimove", False)])
def test_a_spindle_of_the_other_controller_is_another_one(job: Job, sync: Any, reported: bool) -> None:
    """Its signal has the same name there; tasks of one controller share theirs."""
    cell = job.problem.cell
    controller = dataclasses.replace(cell.controller, sync=sync)
    whole = dataclasses.replace(job.problem, cell=dataclasses.replace(cell, controller=controller))
    claims, unread = outlines.resolve_claims(job.prover.claims)
    context = Context(job.problem, claims, job.programs, unread)
    motion, (task,) = context.motion, context.job.tasks
    other = dataclasses.replace(task, name="other", arm=dataclasses.replace(task.arm, name="other"))
    steps = [(*row[:2], "other", row[3]) for row in motion.step_time]
    vars(context)["motion"] = dataclasses.replace(motion, step_time=tuple(steps))
    vars(context)["job"] = dataclasses.replace(context.job, tasks=(other, task))
    context.problem = whole
    issues = trim_spindle(context).issues
    assert bool(issues) == reported


def trimming(job: Job, programs: dict[str, str]) -> tuple[Context, Trimming]:
    """What the rules look at, to be changed."""
    claims, unread = outlines.resolve_claims(job.prover.claims)
    context = Context(job.problem, claims, programs, unread)
    return context, context.get(TRIMMING)


def test_what_counts_as_cut_is_asked_to_be_through_the_sheet(job: Job) -> None:
    """A mesh that may be off by 0.2 mm lets a slot be 0.5 mm beside its curve: one that is so, and above the
    sheet's lower face, cuts nothing."""
    middle = 6.6 / 7.0  # a radius of 8 less 1 of the cutter and 0.4 beyond the curve
    changed = in_procedure(
        job.programs,
        "trim_round",
        moved(lambda p: p * np.array([middle, middle, 1.0]) + np.array([0.0, 0.0, 0.9])),
    )
    context, made = trimming(job, changed)
    made.sheets[0].sheet.tolerance = 0.2e-3
    found = [*trim_cut(context).issues, *trim_mill(context).issues]
    assert {(issue.code, issue.message.startswith("in trim/round the tip")) for issue in found} == {
        ("verify.trim_mill", True)
    }


def test_a_cutter_comes_down_on_an_arc_before_it_is_near_to_the_curve(tmp_path: Path) -> None:
    """An arc that runs into the curve is near to it long before its end: there the proof found 0.93 mm of the
    2 mm that it has to be behind the face."""
    arc = {"length_mm": 2.5, "shape": "arc"}
    targets = registry.job(problem(tmp_path, outlines=[ROUND], lead=arc, **milled()), 0).targets()
    rows = [k for k, one in enumerate(targets.segment) if one.key == "trim/round"]
    tip = targets.pose["robot"][rows, :3, 3] / 1e-3
    off = 8.0 - np.hypot(tip[:, 0], tip[:, 1]) - 1.0
    near = off < 0.6
    assert 3 < near.sum() < len(near)
    np.testing.assert_allclose(tip[near, 2], -7.0, atol=1e-3)


def test_a_way_in_on_which_nothing_comes_down_is_refused(tmp_path: Path) -> None:
    """A mesh that may be off by 1 mm leaves no room on a way in of 1.5 mm."""
    whole = data(outlines=[ROUND], lead={"length_mm": 1.5}, **milled())
    whole["part"]["sheet_mesh"]["tolerance_mm"] = 1.0
    read = pipeline.load(write_forming(tmp_path, whole, dish()))
    with pytest.raises(TandemError) as error:
        registry.job(read, 0).targets()
    (issue,) = error.value.issues
    assert issue.code == "trim.lead"
    assert "1.65 mm before the curve" in issue.message


def test_a_cutter_goes_down_no_faster_however_deep_it_may_be(job: Job) -> None:
    """A large tolerance of the depth let it go down at any speed, as the last of its way was not looked
    at."""
    context, made = trimming(job, in_procedure(job.programs, "trim_round", timed(0.2)))
    made.sheets[0].claim = dataclasses.replace(made.sheets[0].claim, height_tolerance=5e-3)
    found = trim_mill(context).issues
    assert any("deeper than at 2 mm/s" in issue.message for issue in found)


def test_a_long_slot_is_looked_at_as_closely_as_a_short_one(job: Job) -> None:
    """One place of 6,000 at which the cutter stands in the part."""
    context, made = trimming(job, job.programs)
    (work,) = made.sheets
    own, curve = work.claim.mill, work.slots["trim/wall"]
    way = work.slot_path("trim/wall")
    assert own is not None and way is not None
    count = -(-6000 // len(way.tip))
    names = ("tip", "axis", "rows", "curve_distance", "at", "depth")
    long = {name: np.concatenate([getattr(way, name)] * count) for name in names}
    k = int(np.argmin(way.curve_distance)) + 3 * len(way.tip)
    out = curve.ring[np.argmin(np.linalg.norm(curve.ring - way.feet.foot[k % len(way.tip)], axis=1))]
    long["tip"][k] += 1.5 * (out - way.feet.foot[k % len(way.tip)])
    findings = Findings("verify.trim_mill", context)
    _check_gouge(MeasuredCut(findings, work, "trim/wall", dataclasses.replace(way, **long)), curve, own)
    assert {issue.code for issue in findings.issues} == {"verify.trim_mill"}


def test_an_arm_of_ur_mills(tmp_path: Path) -> None:
    (tmp_path / "ur10e.urdf").write_text(urdf_text.ur10e(), "utf-8")
    arm = {"robot": {"urdf": "ur10e.urdf", "name": "ur10e", "family": "ur", "payload_kg": 12.5}}
    whole = data(outlines=[ROUND], arm=arm, controller={"io": {"robot": {"doSpindle": 8}}}, **milled())
    del whole["cell"]["arms"][0]["home_deg"]
    whole["sheet"]["place"] = {"xyz_mm": [700, 0, 300]}
    read = pipeline.load(write_forming(tmp_path, whole, dish()))
    programs = dict(write.program_files(solve.solve(read, [registry.job(read, 0).targets()]), read))
    prover = Prover(read, registry.claims(read))
    assert prover.prove(programs).ok
    (file,) = programs
    late = programs[file].replace("sleep(5.0)", "sleep(0.5)")
    assert "verify.trim_spindle" in {issue.code for issue in prover.prove({file: late}).issues}


def test_two_controllers_switch_signals_of_their_own(tmp_path: Path) -> None:
    """By one name nothing tells which of them is meant."""
    whole = data(outlines=[ROUND], controller={"sync": "handshake"}, **milled())
    (arm,), (one,) = whole["cell"]["arms"], whole["operations"]
    whole["cell"]["arms"].append({**arm, "name": "second", "base": {"xyz_mm": [1250, 0, 0]}})
    other = {**one, "name": "other", "arms": ["second"], "outlines": [{**ROUND, "name": "b"}]}
    whole["operations"].append(other)
    with pytest.raises(TandemError) as error:
        pipeline.load(write_forming(tmp_path, whole, dish()))
    (issue,) = error.value.issues
    assert (issue.code, issue.field) == ("problem.field", "operations.1.signal")
    other["signal"] = "doSpindle2"
    pipeline.load(write_forming(tmp_path, whole, dish()))


@pytest.mark.parametrize(("sync", "reported"), [("handshake", False), ("multimove", True)])
def test_programs_of_two_controllers_may_switch_in_one_interval(sync: Any, reported: bool) -> None:
    """As both take their power back at first: only of signals of one controller the order is chance."""
    cell = handshake_job.problem().cell
    controller = dataclasses.replace(cell.controller, sync=sync)
    texts = {
        file: re.sub(r"PROC main\(\)", "PROC main()\n    SetDO doWirePower,0;", text)
        for file, text in handshake_job.programs().items()
    }
    context = Context(handshake_job.problem(), handshake_job.claims(), texts)
    _ = context.job
    whole = dataclasses.replace(cell, controller=controller)
    context.problem = dataclasses.replace(context.problem, cell=whole)
    found = [issue for issue in signals(context).issues if "between the same" in issue.message]
    assert bool(found) == reported
