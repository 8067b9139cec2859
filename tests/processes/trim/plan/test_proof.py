"""A trimmed dish is planned and proven, and each fault in its programs is reported by its rule.

The faults are in the text alone. The proof has no other knowledge of the programs.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from planner.processes.trim.proof import outlines
from planner.processes.trim.proof.rules.slots import _check_closed
from planner.processes.trim.proof.torch_motion import TRIMMING, SlotPath
from planner.proof.context import Context
from tests.processes.milling.proof.milling_job import in_procedure
from tests.processes.trim.plan.small_trim import Job

Programs = dict[str, str]
NUMBER = r"(-?\d+\.\d+)"
TARGET = re.compile(rf"MoveL \[\[{NUMBER},{NUMBER},{NUMBER}\],\[{NUMBER},{NUMBER},{NUMBER},{NUMBER}\]")
MAIN = "operation_1"
SWITCH_ON, OK, SWITCH_OFF = "SetDO doArc,1;", "WaitDI diArcOk,1\\MaxTime:=5;", "SetDO doArc,0;"


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Job:
    return Job(tmp_path_factory.mktemp("trim"))


def moved(change: Callable[[Any], Any]) -> Callable[[str], str]:
    """Changes the places [mm] of all targets of a procedure."""

    def move_target(match: re.Match[str]) -> str:
        x, y, z = change(np.array([float(match[k]) for k in (1, 2, 3)]))
        turn = ",".join(match[k] for k in (4, 5, 6, 7))
        return f"MoveL [[{x:.4f},{y:.4f},{z:.4f}],[{turn}]"

    return lambda text: TARGET.sub(move_target, text)


def leant(degrees: float) -> Callable[[str], str]:
    """Rotate the tool of all targets of a procedure about its own x axis."""
    half = np.deg2rad(0.5 * degrees)

    def turn(match: re.Match[str]) -> str:
        w, x, y, z = (float(match[k]) for k in (4, 5, 6, 7))
        c, s = np.cos(half), np.sin(half)
        q = (w * c - x * s, x * c + w * s, y * c + z * s, z * c - y * s)
        return f"MoveL [[{match[1]},{match[2]},{match[3]}],[{','.join(f'{v:.8f}' for v in q)}]"

    return lambda text: TARGET.sub(turn, text)


def timed(factor: float) -> Callable[[str], str]:
    def slower(match: re.Match[str]) -> str:
        return f"vmax\\T:={factor * float(match[1]):.5f}"

    return lambda text: re.sub(r"v\w+\\T:=(\d+\.\d+)", slower, text)


def without_moves(which: slice) -> Callable[[str], str]:
    """Leaves moves of a procedure out."""

    def cut(text: str) -> str:
        lines = text.split("\n")
        rows = [k for k, line in enumerate(lines) if "MoveL" in line][which]
        return "\n".join(line for k, line in enumerate(lines) if k not in rows)

    return cut


def behind_first_move(what: str) -> Callable[[str], str]:
    def put(text: str) -> str:
        at = text.index("\n", text.index("MoveL"))
        return f"{text[:at]}\n    {what}{text[at:]}"

    return put


def before_last_move(what: str) -> Callable[[str], str]:
    def put(text: str) -> str:
        at = text.rindex("\n", 0, text.rindex("MoveL"))
        return f"{text[:at]}\n    {what}{text[at:]}"

    return put


def ended(xy: tuple[float, float]) -> Callable[[str], str]:
    """Remove the last three moves and move the previous one to a position in plan [mm]."""

    def put(text: str) -> str:
        lines = text.split("\n")
        rows = [k for k, line in enumerate(lines) if "MoveL" in line]
        lines[rows[-4]] = moved(lambda p: np.array([*xy, p[2]]))(lines[rows[-4]])
        return "\n".join(line for k, line in enumerate(lines) if k not in rows[-3:])

    return put


def around(text: str) -> str:
    """Continue from the slot's end through the waste, 2.5 mm off, to the start of the next slot."""
    lines = text.split("\n")
    last = next(k for k in range(len(lines) - 1, 0, -1) if "MoveL" in lines[k])
    end = np.array([float(v) for v in TARGET.search(lines[last]).groups()[:2]])  # type: ignore[union-attr]
    radius, at = np.hypot(*end) + 2.5, np.arctan2(end[1], end[0])
    ways = [np.array([np.cos(a), np.sin(a)]) * radius for a in at + np.array([0.0, 0.03, 0.065])]
    more = [moved(lambda p, xy=xy: np.array([*xy, p[2]]))(lines[last]) for xy in ways]
    return "\n".join([*lines[: last + 1], *more, *lines[last + 1 :]])


def swapped(text: str) -> str:
    """Move the round hole with its statements after all others."""
    first = text.index("trim_round_in;")
    last = text.index("trim_round_out;") + len("trim_round_out;")
    end = text.rindex("trim_rim_p3_out;") + len("trim_rim_p3_out;")
    return f"{text[:first]}{text[last:end]}\n    {text[first:last]}{text[end:]}"


def replaced(old: str, new: str) -> Callable[[str], str]:
    def put(text: str) -> str:
        assert old in text
        return text.replace(old, new, 1)

    return put


SHIFT, HIGHER, RADIUS = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 0.8]), 8.6 / 7.4
FAULTS: dict[str, tuple[str, str, Callable[[str], str]]] = {
    "a hole beside its place": ("verify.trim_kept", "trim_round", moved(lambda p: p + SHIFT)),
    "the slot on the part's side": (
        "verify.trim_kept",
        "trim_round",
        moved(lambda p: p * np.array([RADIUS, RADIUS, 1.0])),
    ),
    "a hole too small": ("verify.trim_cut", "trim_round", moved(lambda p: p * np.array([0.9, 0.9, 1.0]))),
    "a hole not closed": ("verify.trim_cut", "trim_round", without_moves(slice(-9, None))),
    "a hole not closed by a hair": ("verify.trim_cut", "trim_round", ended((7.286, -1.293))),
    "a micro-joint cut off behind": ("verify.trim_cut", "trim_rim_p1", around),
    "a micro-joint too wide": ("verify.trim_cut", "trim_rim_p1", without_moves(slice(-2, None))),
    "an outline left out": ("verify.trim_cut", MAIN, replaced("trim_wall;", "")),
    "a slot between joints left out": ("verify.trim_cut", MAIN, replaced("trim_rim_p2;", "")),
    "the torch too high": ("verify.trim_torch", "trim_round", moved(lambda p: p + HIGHER)),
    "the torch too low": ("verify.trim_torch", "trim_round", moved(lambda p: p - HIGHER)),
    "the torch leans": ("verify.trim_torch", "trim_round", leant(10.0)),
    "pierced from too near": (
        "verify.trim_torch",
        "trim_round_in",
        moved(lambda p: p - np.array([0.0, 0.0, 1.0])),
    ),
    "no arc": ("verify.trim_arc", MAIN, replaced(SWITCH_ON, "")),
    "the arc too late": ("verify.trim_arc", "trim_round", behind_first_move(f"{SWITCH_OFF} {SWITCH_ON}")),
    "the arc goes on late, on the way": (
        "verify.trim_arc",
        MAIN,
        lambda text: text.replace(SWITCH_ON, "", 1).replace(
            "trim_round;", f"trim_round;\r\n    {SWITCH_ON}", 1
        ),
    ),
    "the arc goes out before the last move": ("verify.trim_arc", "trim_round", before_last_move(SWITCH_OFF)),
    "the arc too early": (
        "verify.trim_arc",
        MAIN,
        replaced("trim_round_in;", f"{SWITCH_ON}\n    trim_round_in;"),
    ),
    "the arc left on": (
        "verify.trim_arc",
        MAIN,
        replaced(f"{SWITCH_OFF}\r\n    trim_round_out;", f"trim_round_out;\r\n    {SWITCH_OFF}"),
    ),
    "nobody waits for the arc": ("verify.trim_arc", MAIN, replaced(OK, "")),
    "a wait without an end": ("verify.trim_arc", MAIN, replaced(OK, "WaitDI diArcOk,1;")),
    "a wait for no arc": ("verify.trim_arc", MAIN, replaced(OK, "WaitDI diArcOk,0\\MaxTime:=5;")),
    "not pierced through": ("verify.trim_arc", MAIN, replaced("WaitTime 0.5;", "WaitTime 0.05;")),
    "pierced in the part": ("verify.trim_arc", "trim_round_in", moved(lambda p: p + 6.0 * SHIFT)),
    "an outer curve first": ("verify.trim_order", MAIN, swapped),
    "twice as fast": ("verify.trim_feed", "trim_round", timed(0.5)),
    "it lingers at a place of a long slot": (
        "verify.trim_feed",
        "trim_rim_p1",
        lambda text: re.sub(r"v10\\T:=[\d.]+", r"v5\\T:=3.0", text, count=1),
    ),
    "far too slow": ("verify.trim_feed", "trim_round", timed(4.0)),
    "the nozzle in the sheet": (
        "verify.trim_clear",
        "trim_wall_out",
        moved(lambda p: np.array([p[0], p[1], -12.0])),
    ),
}


def test_the_programs_are_proven(job: Job) -> None:
    proof = job.prove(job.programs, None)
    assert proof.issues == ()
    assert proof.ok


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_told_by_the_rule_for_it(job: Job, name: str) -> None:
    code, procedure, change = FAULTS[name]
    programs = in_procedure(job.programs, procedure, change)
    assert programs != job.programs
    assert job.told_by(code, programs)


@pytest.mark.parametrize("wait", [f"WaitTime 1;\r\n    {SWITCH_ON}", f"{SWITCH_OFF}\r\n    WaitTime 1;"])
def test_a_torch_may_stand_dark_at_the_ends_of_its_slot(job: Job, wait: str) -> None:
    """As it does where it waits for the other arm."""
    old = SWITCH_ON if SWITCH_ON in wait else SWITCH_OFF
    programs = in_procedure(job.programs, MAIN, replaced(old, wait))
    assert programs != job.programs
    assert not job.told_by("verify.trim_arc", programs)


def test_the_dialogue_has_all_that_is_switched(job: Job) -> None:
    for old, new in ((OK, ""), (SWITCH_ON, ""), (SWITCH_OFF, ""), (OK, "WaitDI diArcOk,1\\MaxTime:=50;")):
        programs = in_procedure(job.programs, MAIN, replaced(f"\n    {old}", f"\n    {new}"))
        assert "verify.dialogue" in {i.code for i in job.prove(programs, "verify.dialogue").issues}


MAIN_FILE = "T_ROB1/TandemMain_1.mod"
HOOKS, ROWS = "controller/T_ROB1/TandemPower.sys", "controller/T_ROB1/SYS.cfg"
AFTER_A_STOP: dict[str, tuple[str, str, str, str]] = {
    "On is offered": ("verify.controller_files", HOOKS, '"Begin","Stop"', '"Begin","On"'),
    "On is done": ("verify.controller_files", HOOKS, "SetDO doArc,0;", "SetDO doArc,1;"),
    "it goes on in a slot": ("verify.controller_files", HOOKS, "      tandem_end;", ""),
    "it goes on when it is started once more": (
        "verify.controller_files",
        HOOKS,
        "WHILE TRUE DO",
        "IF TRUE THEN",
    ),
    "a start where it stopped is a start anew": (
        "verify.controller_files",
        ROWS,
        "tandem_again",
        "tandem_begin",
    ),
    "a power failure is no stop": ("verify.controller_files", ROWS, '"POWER_ON"', '"RESET"'),
    "an operator may set it": (
        "verify.controller_files",
        "controller/T_ROB1/EIO.cfg",
        '"TandemTorch" -Rapid',
        '"TandemTorch" -Rapid -LocalAuto',
    ),
    "left on from before": ("verify.signals", MAIN_FILE, "SetDO doArc,0;\r\n    UIMsgBox", "UIMsgBox"),
    "lit by an error handler": (
        "verify.error_handler",
        MAIN_FILE,
        "ERROR\r\n    SetDO doArc,0",
        "ERROR\r\n    SetDO doArc,1",
    ),
    "left on by an error handler": (
        "verify.error_handler",
        MAIN_FILE,
        "ERROR\r\n    SetDO doArc,0;",
        "ERROR",
    ),
    "an error handler that goes on": ("verify.error_handler", MAIN_FILE, "Stop;\r\n    EXIT;", "TRYNEXT;"),
    "lit where the pointer is moved away": (
        "verify.hidden",
        MAIN_FILE,
        "away\r\n    SetDO doArc,0;",
        "away\r\n    SetDO doArc,1;",
    ),
    "left on where the pointer is moved away": (
        "verify.undo",
        MAIN_FILE,
        "away\r\n    SetDO doArc,0;",
        "away",
    ),
    "the program frees itself": (
        "verify.declarations",
        MAIN_FILE,
        "    operation_1;\r\n",
        "    tandem_lit_1:=FALSE;\r\n    operation_1;\r\n",
    ),
    "no warning about stops": (
        "verify.dialogue",
        MAIN_FILE,
        "A stop while the torch",
        "A stop while no torch",
    ),
}


@pytest.mark.parametrize("name", AFTER_A_STOP)
def test_nothing_lights_a_torch_behind_a_stop_nor_goes_on_in_a_slot(job: Job, name: str) -> None:
    code, file, old, new = AFTER_A_STOP[name]
    assert old in job.programs[file], old
    changed = {**job.programs, file: job.programs[file].replace(old, new)}
    assert code in {issue.code for issue in job.prove(changed, code).issues}


def test_the_report_has_the_curves_with_the_stand_off(job: Job) -> None:
    shown = job.plan.operations[0].targets.exhibits
    assert {"setup", "slots", "curves", "standoff"} <= set(shown)
    heights = np.concatenate([row["y"] for row in shown["standoff"]["series"]])
    assert heights.max() == pytest.approx(4.0)  # pierced from there
    assert heights.min() == pytest.approx(3.0)
    assert ("output that starts the arc", "doArc") in shown["setup"]["items"]


@pytest.mark.parametrize(("joints", "gap", "reported"), [(1, 0.8, False), (0, 0.8, True), (0, 0.25, False)])
def test_thin_slots_have_small_joints_and_no_other_ones(
    job: Job, joints: int, gap: float, reported: bool
) -> None:
    """A slot of 0.3 mm whose ends are 0.8 mm apart leaves a joint of 0.5 mm, though no place of the curve is
    farther from it than the tolerance of 0.3 mm; of 0.25 mm nothing is left."""
    claims, unread = outlines.resolve_claims(job.prover.claims)
    context = Context(job.problem, claims, job.programs, unread)
    (work,) = context.get(TRIMMING).sheets
    work.claim = dataclasses.replace(work.claim, kerf=0.3e-3)
    curve = next(one for one in work.curves if one.outline.name == "rim")
    curve.outline = dataclasses.replace(curve.outline, joints=joints, width=0.5e-3)
    radius, z = 36.15e-3, curve.ring[0, 2]
    turn = np.linspace(0.5 * gap * 1e-3 / radius, 2.0 * np.pi - 0.5 * gap * 1e-3 / radius, 1400)
    tip = np.column_stack([radius * np.cos(turn), radius * np.sin(turn), np.full(1400, z)])
    deviation, at = curve.distance(tip)
    up = np.tile([0.0, 0.0, 1.0], (1400, 1))
    way = SlotPath(tip, up, work.sheet.project(tip), np.arange(1400), deviation, at, np.zeros(1400))
    assert bool(_check_closed(work, curve, [way])[1]) == reported
