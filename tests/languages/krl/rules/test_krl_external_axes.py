"""Tracks and turntables in KRL: poses of arms and block by the text, and faults in E1 to E6."""

from __future__ import annotations

import dataclasses
import itertools
import re
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from planner.cell.kinematics import forward_kinematics
from planner.geometry.arrays import inverse
from planner.pipeline import Outcome
from planner.processes import registry
from planner.proof.context import Context
from planner.proof.prove import Prover
from planner.proof.rules import external_axes
from planner.report import scene
from tests import table_job, track_job
from tests.proof.provers import prover_of

SECOND_STATION = "65.0000"
"""The second station of the table as the text has it."""


@pytest.fixture(scope="module")
def track_prover() -> Prover:
    return prover_of(track_job.planned_krl_job())


@pytest.fixture(scope="module")
def turntable_prover() -> Prover:
    return prover_of(table_job.planned_krl_job())


def station(outcome: Outcome) -> str:
    """The track's first station as the text has it."""
    return f"{1e3 * outcome.plan.stations[0]['left']:.4f}"


# ---- where things stand ----


def test_the_text_has_the_tool_within_a_micrometre_of_the_plan_on_a_track(track_prover: Prover) -> None:
    out = track_job.planned_krl_job()
    assert out.verified and out.plan.stations[0] != out.plan.stations[1]
    context = external_axes.with_text_stations(
        Context(track_prover.problem, track_prover.claims, out.programs)
    )
    for index in range(2):
        # by hand: E1 [mm] of the text along y of the world, and the arm's axes from the plan
        operation_plan, arm = out.plan.operations[index], track_prover.problem.cell.arm("left")
        base = arm.base.copy()
        base[1, 3] += out.plan.stations[index]["left"]
        tcp = (base @ forward_kinematics(arm.data, operation_plan.q["left"]) @ arm.tool.tcp)[:, :3, 3]
        assert np.linalg.norm(tcp - operation_plan.targets.pose["left"][:, :3, 3], axis=1).max() < 1e-6
        nodes = context.spans.of_stage[context.motion.node_stage] == index
        text = context.motion.node_tcp["left"][nodes][:, :3, 3]
        assert np.linalg.norm(text[:, None] - tcp, axis=2).min(axis=0).max() < 1e-6


def test_the_text_has_the_block_within_a_micrometre_of_the_plan_on_a_table(turntable_prover: Prover) -> None:
    out = table_job.planned_krl_job()
    assert out.verified and np.rad2deg(out.plan.stations[1]["stock"]) == pytest.approx(float(SECOND_STATION))
    context = external_axes.with_text_stations(
        Context(turntable_prover.problem, turntable_prover.claims, out.programs)
    )
    turn = Rotation.from_euler("z", float(SECOND_STATION), degrees=True).as_matrix()  # scipy's
    centre, stated = np.array([0.9, 0.0, 0.2]), turntable_prover.problem.stock.place
    place = context.stock_frames[1]
    assert stated is not None and place is not None
    np.testing.assert_allclose(place[:3, :3], turn @ stated[:3, :3], atol=1e-8)
    np.testing.assert_allclose(place[:3, 3], centre + turn @ (stated[:3, 3] - centre), atol=1e-7)
    for index in range(2):
        operation_plan, arm = out.plan.operations[index], turntable_prover.problem.cell.arm("left")
        tcp = arm.base @ forward_kinematics(arm.data, operation_plan.q["left"]) @ arm.tool.tcp
        seen = (inverse(np.asarray(context.stock_frames[index])) @ tcp)[:, :3, 3]
        assert np.linalg.norm(seen - operation_plan.targets.pose["left"][:, :3, 3], axis=1).max() < 1e-6


def test_axes_take_the_time_of_the_text_on_the_proofs_clock_and_in_the_replay() -> None:
    for out, own in ((track_job.planned_krl_job(), 1.0), (table_job.planned_krl_job(), 20.0)):
        context = Context(out.problem, registry.claims(out.problem), out.programs)
        shown = re.search(r"\$VEL_EXTAX\[\d\]=(\d+)", "".join(out.programs.values()))
        assert shown is not None
        speed = own * float(shown[1]) / 100.0  # m/s, deg/s
        text = "".join(out.programs.values())
        found = re.findall(r"x_\d_station_1=\{.*?E(?:1 (-?[1-9][\d.]*)|2 (-?[1-9][\d.]*))", text)
        ends = [0.0, *(float(a) * 1e-3 if a else float(b) for a, b in found), 0.0]
        ramp = 0.0 if own > 1.0 else speed / 1.0  # the track's 1 m/s2
        expected = [abs(b - a) / speed + ramp for a, b in itertools.pairwise(ends)]
        gaps = np.diff(context.motion.time)
        np.testing.assert_allclose(gaps[gaps > 1.0], expected, atol=0.01)
        assert scene.sample_keyframes(out.problem, out.plan, 100).travel == pytest.approx(
            sum(expected), abs=1e-3
        )


# ---- programs that are wrong ----


def first(text: str, old: str, new: str) -> str:
    assert old in text, old
    return text.replace(old, new, 1)


def changed(text: str, pattern: str, new: str, count: int = 0) -> str:
    out, found = re.subn(pattern, new, text, count=count)
    assert found, pattern
    return out


def broken(programs: Mapping[str, str], change: Callable[[str], str]) -> dict[str, str]:
    """The programs with a change of their text."""
    joined = "\0".join(programs.values()).replace("\r\n", "\n")
    bad = dict(zip(programs, change(joined).split("\0"), strict=True))
    bad = {file: text.replace("\n", "\r\n") for file, text in bad.items()}
    assert bad != programs
    return bad


def creeping(text: str, e: str) -> str:
    """Change E1 in straight moves, by less than a micrometre per move."""
    off = iter((1, 2, 1, 0))
    pattern = rf"(SLIN [^\n]*,E1 ){re.escape(e)}\}}"
    return re.sub(pattern, lambda m: f"{m[1]}{float(e) - 9e-4 * next(off, 0):.4f}}}", text)


def in_cut(text: str, axis: str, old: str, new: str) -> str:
    """The value of the third straight move that has it."""
    at = [m.start() for m in re.finditer(rf"SLIN [^\n]*,{axis} {re.escape(old)}\}}", text)][2]
    return text[:at] + first(text[at:], f"{axis} {old}", f"{axis} {new}")


HOME_CHECK = re.compile(r"tm_shift=ABS\(\$AXIS_ACT\.E\d-0\.0000\)\n(?:[^\n]*\n)*?ENDIF\n")
"""Pattern of the check that an axis is at home."""

TRACK: dict[str, tuple[str, Callable[[str, str], str]]] = {
    "missing E1": ("external_axes", lambda t, e: t.replace(f",E1 {e}}}", "}")),
    "missing E1 in one move": ("external_axes", lambda t, e: changed(t, rf"(SLIN .*),E1 {e}\}}", r"\1}", 1)),
    "missing E1 at home": ("declarations", lambda t, e: changed(t, r"(x_home=.*),E1 [-\d.]+", r"\1")),
    "another E1 in the cut": ("external_axes", lambda t, e: t.replace(f"E1 {e}}}", "E1 -480.0000}")),
    "another E1 all along": ("setup", lambda t, e: t.replace(f"E1 {e}", f"E1 {float(e) + 100.0:.4f}")),
    "in metres": ("setup", lambda t, e: t.replace(f"E1 {e}", f"E1 {float(e) * 1e-3:.4f}")),
    "with the other sign": ("status", lambda t, e: t.replace(f"E1 {e}", f"E1 {-float(e):.4f}")),
    "creeping away and back": ("external_axes", creeping),
    "moved in the cut": ("external_axes", lambda t, e: in_cut(t, "E1", e, f"{float(e) + 1.0:.4f}")),
    "beyond the range": ("external_axes", lambda t, e: t.replace(f"E1 {e}", "E1 -5000.0000")),
    "as the second axis": ("external_axes", lambda t, e: t.replace(f"E1 {e}}}", f"E2 {e}}}")),
    "a second axis": ("external_axes", lambda t, e: t.replace(f"E1 {e}}}", f"E1 {e},E2 10.0000}}")),
    "E1 twice": ("declarations", lambda t, e: t.replace(f"E1 {e}}}", f"E1 {e},E1 {e}}}")),
    "a second axis in the data": (
        "external_axes",
        lambda t, e: t.replace(f"E1 {e},E2 0.0", f"E1 {e},E2 9.0"),
    ),
    "another foot": ("base_frames", lambda t, e: first(t, "base_frame={X 0.0000", "base_frame={X 50.0000")),
    "another base": ("work_object", lambda t, e: changed(t, r"(b_world=\{X )[-\d.]+", r"\g<1>77.0000")),
    "a base of the external kinematic": ("syntax", lambda t, e: first(t, "$BASE=b_world", "BAS(#EX_BASE,2)")),
    "coupled to the external kinematic": (
        "syntax",
        lambda t, e: first(
            t, "$BASE=b_world", "$BASE=EK(MACHINE_DEF[2].ROOT,MACHINE_DEF[2].MECH_TYPE,b_world)"
        ),
    ),
    "a fast track": ("external_axes", lambda t, e: first(t, "$VEL_EXTAX[1]=25", "$VEL_EXTAX[1]=90")),
    "no speed": ("external_axes", lambda t, e: first(t, "$VEL_EXTAX[1]=25\n", "")),
    "the speed of another axis": ("external_axes", lambda t, e: first(t, "$VEL_EXTAX[1]", "$VEL_EXTAX[2]")),
    "not folded": ("syntax", lambda t, e: first(t, "PTP x_2_station_1\n", "")),
    "nobody keeps off": (
        "syntax",
        lambda t, e: (
            first(t, "PTP x_1_exit_1\n", "PTP x_1_exit_1\nPTP x_2_station_1\n")
            if "PTP x_1_exit_1\n" in t
            else first(t, "; Operation b.", "PTP x_2_station_1\n; Operation b.")
        ),
    ),
    "no look at E1": ("external_axes", lambda t, e: HOME_CHECK.sub("", t, count=1)),
    "a look at E1 before the question": (
        "external_axes",
        lambda t, e: first(
            HOME_CHECK.sub("", t, count=1),
            "tm_answer=0\n",
            f"{HOME_CHECK.search(t)[0]}tm_answer=0\n",  # type: ignore[index]
        ),
    ),
    "a look at E1 behind the first move": (
        "external_axes",
        lambda t, e: first(
            HOME_CHECK.sub("", t, count=1), "PTP x_home\n", f"PTP x_home\n{HOME_CHECK.search(t)[0]}"
        ),  # type: ignore[index]
    ),
    "a look at E2": ("external_axes", lambda t, e: first(t, "ABS($AXIS_ACT.E1-", "ABS($AXIS_ACT.E2-")),
    "a look for another home": (
        "external_axes",
        lambda t, e: first(t, "ABS($AXIS_ACT.E1-0.0000)", "ABS($AXIS_ACT.E1+700.0000)"),
    ),
    "a wide look": ("external_axes", lambda t, e: first(t, "IF tm_shift>1.0 THEN", "IF tm_shift>50.0 THEN")),
    "a look of one side": (
        "syntax",
        lambda t, e: first(t, "ABS($AXIS_ACT.E1-0.0000)", "$AXIS_ACT.E1-0.0000"),
    ),
    "a look that goes on": ("syntax", lambda t, e: first(t, "LOOP\nHALT\nENDLOOP\nENDIF", "HALT\nENDIF")),
    "a look that says something else": ("external_axes", lambda t, e: first(t, "mm off home", "mm off")),
    "not home at the end": ("external_axes", lambda t, e: re.sub(r"(?s)(.*)PTP x_home\n", r"\1", t)),
    "elsewhere at the end": (
        "external_axes",
        lambda t, e: re.sub(r"(?s)(.*)PTP x_home\n", r"\1PTP x_1_station_1\n", t),
    ),
    "nobody asked before it goes home": ("setup", lambda t, e: first(t, "All work done", "Work done")),
    "told another value": ("setup", lambda t, e: first(t, f"to {float(e):.3f}", "to -900.000")),
    "no look at the foot": ("syntax", lambda t, e: t.replace("$ROBROOT_C", "$ROBROOT")),
    "a look along another way": (
        "syntax",
        lambda t, e: t.replace("X-0.500000*$AXIS_ACT.E1", "X+0.500000*$AXIS_ACT.E1"),
    ),
    "no look behind a station": (
        "syntax",
        lambda t, e: changed(t, r"(PTP x_2_station_1\n)(?:[^\n]*\n)*?tm_par\[2\]\.Par_Type=#EMPTY\n", r"\1"),
    ),
}
"""Faults of a track: the rule that refuses it, and the change, given the first station of the text."""


TABLE: dict[str, tuple[str, Callable[[str], str]]] = {
    "missing E2": ("external_axes", lambda t: t.replace(f",E2 {SECOND_STATION}}}", "}")),
    "another E2 all along": ("external_axes", lambda t: t.replace(f"E2 {SECOND_STATION}", "E2 130.0000")),
    "another E2 of a tenth": ("work_object", lambda t: t.replace(f"E2 {SECOND_STATION}", "E2 65.1000")),
    "in radians": ("external_axes", lambda t: t.replace(f"E2 {SECOND_STATION}", "E2 1.1345")),
    "with the other sign": (
        "external_axes",
        lambda t: t.replace(f"E2 {SECOND_STATION}", f"E2 -{SECOND_STATION}"),
    ),
    "moved in the cut": ("external_axes", lambda t: in_cut(t, "E2", SECOND_STATION, "65.5000")),
    "beyond the range": ("external_axes", lambda t: t.replace(f"E2 {SECOND_STATION}", "E2 190.0000")),
    "as the first axis": (
        "external_axes",
        lambda t: t.replace(f"E2 {SECOND_STATION}}}", f"E1 {SECOND_STATION}}}"),
    ),
    "another frame": (
        "work_object",
        lambda t: changed(t, r"(b_stock_2=\{X )(-?\d+)\.", lambda m: f"{m[1]}{int(m[2]) + 5}."),
    ),
    "a frame turned on": (
        "work_object",
        lambda t: changed(t, r"(b_stock_2=\{.*A )(-?\d+)\.", lambda m: f"{m[1]}{int(m[2]) + 2}."),
    ),
    "the frame of before": ("external_axes", lambda t: first(t, "$BASE=b_stock_2", "$BASE=b_stock")),
    "a base of the external kinematic": ("syntax", lambda t: first(t, "$BASE=b_stock_2", "BAS(#EX_BASE,2)")),
    "of another kinematic": ("syntax", lambda t: first(t, "$BASE=b_stock_2", "BAS(#EX_BASE,3)")),
    "no speed": ("external_axes", lambda t: changed(t, r"\$VEL_EXTAX\[2\]=\d+\n", "")),
    "not folded": ("external_axes", lambda t: first(t, "PTP x_2_station_1\n", "")),
    "no look at E2": ("external_axes", lambda t: HOME_CHECK.sub("", t, count=1)),
    "a wide look": ("external_axes", lambda t: first(t, "IF tm_shift>0.1 THEN", "IF tm_shift>1.0 THEN")),
    "a look at E1": ("external_axes", lambda t: first(t, "ABS($AXIS_ACT.E2-", "ABS($AXIS_ACT.E1-")),
    "not home at the end": ("external_axes", lambda t: re.sub(r"(?s)(.*)PTP x_home\n", r"\1", t)),
    "told another value": ("setup", lambda t: first(t, f"{SECOND_STATION} deg", "20.0000 deg")),
}
"""Faults of a turntable."""


def refused(prover: Prover, programs: dict[str, str], word: str) -> None:
    proof = prover.prove(programs)
    assert not proof.ok
    assert f"verify.{word}" in {issue.code for issue in proof.issues}, [str(i) for i in proof.issues]


@pytest.mark.sampled(every=4)
@pytest.mark.parametrize("name", TRACK)
def test_a_wrong_track_is_refused(track_prover: Prover, name: str) -> None:
    word, change = TRACK[name]
    out = track_job.planned_krl_job()
    refused(track_prover, broken(out.programs, lambda text: change(text, station(out))), word)


@pytest.mark.sampled(every=3)
@pytest.mark.parametrize("name", TABLE)
def test_a_wrong_turntable_is_refused(turntable_prover: Prover, name: str) -> None:
    word, change = TABLE[name]
    refused(turntable_prover, broken(table_job.planned_krl_job().programs, change), word)


OTHERS: dict[str, dict[str, Any]] = {
    "direction": {"axis": np.array([0.0, -1.0, 0.0])},
    "range": {"low": -0.1},
    "speed": {"speed": 5.0},
    "home": {"home": 0.5},
}


@pytest.mark.parametrize("name", OTHERS)
def test_programs_of_another_track_are_refused(track_prover: Prover, name: str) -> None:
    """The same text for a cell whose track is another one."""
    arm = track_prover.problem.cell.arms[0]
    assert arm.track is not None
    other = dataclasses.replace(arm, linear_axes=(dataclasses.replace(arm.track, **OTHERS[name]),))
    cell = dataclasses.replace(track_prover.problem.cell, arms=(other,))
    made = Prover(dataclasses.replace(track_prover.problem, cell=cell), track_prover.claims)
    word = "syntax" if name == "direction" else "external_axes"
    refused(made, dict(track_job.planned_krl_job().programs), word)


def test_a_table_that_turns_faster_than_the_text_takes_it_for_is_refused(turntable_prover: Prover) -> None:
    table = turntable_prover.problem.cell.turntable
    assert table is not None
    cell = dataclasses.replace(turntable_prover.problem.cell, turntable=dataclasses.replace(table, speed=5.0))
    made = Prover(dataclasses.replace(turntable_prover.problem, cell=cell), turntable_prover.claims)
    refused(made, dict(table_job.planned_krl_job().programs), "external_axes")


def test_axes_that_the_cell_does_not_have_are_refused(turntable_prover: Prover) -> None:
    cell = dataclasses.replace(turntable_prover.problem.cell, turntable=None)
    other = Prover(dataclasses.replace(turntable_prover.problem, cell=cell), turntable_prover.claims)
    refused(other, dict(table_job.planned_krl_job().programs), "move_kinds")


@pytest.mark.long
def test_the_older_dialect_has_the_track_as_well() -> None:
    out = track_job.planned_krl_job(dialect="krc2")
    assert out.verified
    (moves,) = [text for file, text in out.programs.items() if file.endswith("track_1.src")]
    assert re.search(r"LIN \{[^}]*,E1 -?[\d.]+\}", moves)


@pytest.mark.long
def test_spline_blocks_have_the_track_as_well() -> None:
    out = track_job.planned_krl_job(81, path="spline")
    assert out.verified
    text = "".join(out.programs.values())
    assert re.search(r"SPL \{[^}]*,E1 -?[\d.]+\}", text)


def test_the_setup_sheet_says_what_the_machine_data_need(tmp_path: Any) -> None:
    for made, words in (
        (track_job.planned_krl_job(), ("E1, axis 7", "#ERSYS", "$SOFTN_END[7]", "0.500000, 0.866025")),
        (table_job.planned_krl_job(), ("E2, axis 8", "#EASYS, or #NONE", "counter-clockwise", "in $WORLD")),
    ):
        folder = tmp_path / made.problem.name
        made.save(folder)
        page = (folder / "report.html").read_text()
        assert all(word in page for word in words), [word for word in words if word not in page]
