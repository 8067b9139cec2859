"""Positioners in KRL: the pose of the block by the text, and faults in two external axes."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from planner.processes import registry
from planner.proof.context import Context
from planner.proof.prove import Prover
from planner.report import scene, setup_sheet
from tests import positioner_job
from tests.languages.krl.rules.test_krl_external_axes import HOME_CHECK, broken, changed, first, refused
from tests.proof.provers import prover_of

TURN, TILT = "-180.0000", "-65.0000"
"""The second station as the text has it: E1 and E2."""
STAND = f"E1 {TURN},E2 {TILT}"
LEG = f"E1 {TURN},E2 20.0000"
"""Between both stations: turned, and not tilted yet."""
FIRST_STATION = "E1 80.0000,E2 20.0000"
"""The first station."""


@pytest.fixture(scope="module")
def prover() -> Prover:
    return prover_of(positioner_job.planned_krl_job())


def test_the_text_has_the_block_within_a_micrometre_of_the_plan(prover: Prover) -> None:
    out = positioner_job.planned_krl_job()
    assert out.verified and prover.prove(out.programs).ok  # of the text alone
    stands = out.plan.stations[1]
    np.testing.assert_allclose(
        np.rad2deg([stands["stock"], stands["stock/tilt"]]), [float(TURN), float(TILT)]
    )
    positioner_job.require_text_is_planned(
        out, prover, float(TURN), np.deg2rad([0.0, -float(TILT), 0.0]), 2e-7
    )


def test_both_axes_take_the_time_of_the_text_on_the_proofs_clock_and_in_the_replay() -> None:
    out = positioner_job.planned_krl_job()
    context = Context(out.problem, registry.claims(out.problem), out.programs)
    text = "".join(out.programs.values())
    shares = {n: float(v) / 100.0 for n, v in re.findall(r"\$VEL_EXTAX\[(\d)\]=(\d+)", text)}
    own = {"1": (20.0 * shares["1"], 40.0), "2": (15.0 * shares["2"], 30.0)}  # deg/s, deg/s2
    legs = [("1", 100.0), ("2", 20.0), ("1", 260.0), ("2", 85.0), ("1", 360.0), ("2", 65.0)]
    expected = [way / own[n][0] + own[n][0] / own[n][1] for n, way in legs]
    gaps = np.diff(context.motion.time)
    for seconds in expected:  # each on its own
        assert np.abs(gaps - seconds).min() < 0.01
    assert scene.sample_keyframes(out.problem, out.plan, 100).travel == pytest.approx(sum(expected), abs=1e-3)


# ---- programs that are wrong ----


def cuts(text: str, old: str, new: str, count: int = 0) -> str:
    """Values of external axes in straight moves."""
    return changed(text, rf"(SLIN [^\n]*,){re.escape(old)}\}}", lambda m: f"{m[1]}{new}}}", count)  # type: ignore[arg-type]


def ordered(text: str, first_one: str, then: str) -> str:
    """Swap two lines of the program."""
    return first(text, f"{first_one}\n{then}\n", f"{then}\n{first_one}\n")


def creeping(text: str) -> str:
    """Change E2 in straight moves of the second operation, by less than a micrometre per move."""
    off = iter((1, 2, 1, 0))
    pattern = rf"(SLIN [^\n]*,E1 {re.escape(TURN)},E2 ){re.escape(TILT)}\}}"
    return re.sub(pattern, lambda m: f"{m[1]}{float(TILT) - 5e-5 * next(off, 0):.5f}}}", text)


def home_checks(text: str) -> list[str]:
    found = [match[0] for match in ANY_HOME_CHECK.finditer(text)]
    assert len(found) == 2
    return found


ANY_HOME_CHECK = re.compile(HOME_CHECK.pattern.replace(r"0\.0000", r"[\d.]+"))

MUTANTS: dict[str, tuple[str, Callable[[str], str]]] = {
    "no tilt": ("external_axes", lambda t: cuts(t, STAND, f"E1 {TURN}")),
    "no turn": ("external_axes", lambda t: cuts(t, STAND, f"E2 {TILT}")),
    "no tilt in one move": ("external_axes", lambda t: cuts(t, STAND, f"E1 {TURN}", 1)),
    "neither": ("external_axes", lambda t: t.replace(f",{STAND}}}", "}")),
    "no tilt at home": ("declarations", lambda t: changed(t, r"(x_home=.*),E2 [-\d.]+", r"\1")),
    "no tilt at the first target": (
        "declarations",
        lambda t: changed(t, r"(p_2_start=.*),E2 [-\d.]+", r"\1"),
    ),
    "the first target at home": (
        "external_axes",
        lambda t: changed(t, r"(p_2_start=.*),E2 [-\d.]+", r"\1,E2 0.0"),
    ),
    "another tilt in the cut": ("external_axes", lambda t: cuts(t, STAND, f"E1 {TURN},E2 -64.0000")),
    "another tilt in one move": ("external_axes", lambda t: cuts(t, STAND, f"E1 {TURN},E2 -64.0000", 1)),
    "another turn in the last move": (
        "external_axes",
        lambda t: changed(t, rf"(?s)(.*SLIN [^\n]*,)E1 {re.escape(TURN)},", r"\1E1 -179.5000,"),
    ),
    "creeping away and back": ("external_axes", creeping),
    "another tilt all along": ("external_axes", lambda t: t.replace(f"E2 {TILT}", "E2 -50.0000")),
    "another turn all along": ("external_axes", lambda t: t.replace(f"E1 {TURN}", "E1 -140.0000")),
    "a tilt off by a tenth": ("work_object", lambda t: t.replace(f"E2 {TILT}", "E2 -64.9000")),
    "in radians": ("external_axes", lambda t: t.replace(f"E2 {TILT}", "E2 -1.1345")),
    "both exchanged": ("external_axes", lambda t: t.replace(STAND, f"E1 {TILT},E2 {TURN}")),
    "both exchanged, within their ranges": (
        "external_axes",
        lambda t: t.replace(FIRST_STATION, "E1 20.0000,E2 -60.0000"),
    ),
    "the other sense of the tilt": ("external_axes", lambda t: t.replace("E2 20.0000", "E2 -20.0000")),
    "the other sense of the turn": ("external_axes", lambda t: t.replace("E1 80.0000", "E1 -80.0000")),
    "beyond the tilt's range": ("external_axes", lambda t: t.replace(f"E2 {TILT}", "E2 -80.0000")),
    "beyond the turn's range": ("external_axes", lambda t: t.replace(f"E1 {TURN}", "E1 -190.0000")),
    "a whole turn less": ("external_axes", lambda t: t.replace(f"E1 {TURN}", "E1 180.0000")),
    "as other axes": ("external_axes", lambda t: cuts(t, STAND, f"E2 {TURN},E3 {TILT}")),
    "a third axis": ("external_axes", lambda t: cuts(t, STAND, f"{STAND},E3 10.0000")),
    "a third axis in the data": ("external_axes", lambda t: t.replace(f"{STAND},E3 0.0", f"{STAND},E3 9.0")),
    "E2 before E1": ("declarations", lambda t: cuts(t, STAND, f"E2 {TILT},E1 {TURN}")),
    "E2 twice": ("declarations", lambda t: cuts(t, STAND, f"{STAND},E2 {TILT}")),
    "another frame": (
        "work_object",
        lambda t: changed(t, r"(b_stock_2=\{X )(-?\d+)\.", lambda m: f"{m[1]}{int(m[2]) + 5}."),  # type: ignore[arg-type]
    ),
    "a frame turned on": (
        "work_object",
        lambda t: changed(t, r"(b_stock_2=\{.*C )(-?\d+)\.", lambda m: f"{m[1]}{int(m[2]) + 2}."),  # type: ignore[arg-type]
    ),
    "the frame of before": ("external_axes", lambda t: first(t, "$BASE=b_stock_2", "$BASE=b_stock")),
    "no frame": ("work_object", lambda t: first(t, "$BASE=b_stock_2\n", "")),
    "a base of the external kinematic": ("syntax", lambda t: first(t, "$BASE=b_stock_2", "BAS(#EX_BASE,2)")),
    "coupled to the external kinematic": (
        "syntax",
        lambda t: first(
            t, "$BASE=b_stock_2", "$BASE=EK(MACHINE_DEF[2].ROOT,MACHINE_DEF[2].MECH_TYPE,b_stock_2)"
        ),
    ),
    "both at once": ("external_axes", lambda t: first(t, "PTP x_2_station_1\n", "")),
    "the tilt before the turn": ("external_axes", lambda t: first(t, LEG, f"E1 80.0000,E2 {TILT}")),
    "the legs exchanged": ("external_axes", lambda t: ordered(t, "PTP x_2_station_1", "PTP x_2_station_2")),
    "home by both at once": (
        "external_axes",
        lambda t: first(t, "PTP x_2_station_3\nPTP x_home", "PTP x_home"),
    ),
    "home by the tilt first": (
        "external_axes",
        lambda t: first(t, "E1 180.0000,E2 -65.0000", f"E1 {TURN},E2 0.0000"),
    ),
    "no way to the tilt": ("external_axes", lambda t: first(t, "PTP x_2_station_2\n", "")),
    "out of home": (
        "external_axes",
        lambda t: changed(t, r"(x_2_station_1=\{A1 )0\.000000", r"\g<1>5.000000"),
    ),
    "nobody keeps off": (
        "external_axes",
        lambda t: first(t, "; Operation b.", "PTP x_2_station_1\nPTP x_2_station_2\n; Operation b."),
    ),
    "within the work": (
        "syntax",
        lambda t: first(t, "SLIN {X 190.0000,Y 0.0000", "PTP x_2_station_1\nSLIN {X 190.0000,Y 0.0000"),
    ),
    "no speed of the tilt": ("external_axes", lambda t: changed(t, r"\$VEL_EXTAX\[2\]=\d+\n", "")),
    "no speed of the turn": ("external_axes", lambda t: changed(t, r"\$VEL_EXTAX\[1\]=\d+\n", "")),
    "a speed of nothing": ("declarations", lambda t: changed(t, r"\$VEL_EXTAX\[2\]=\d+", "$VEL_EXTAX[2]=0")),
    "one look is missing": ("external_axes", lambda t: first(t, home_checks(t)[0], "")),
    "the other look is missing": ("external_axes", lambda t: first(t, home_checks(t)[1], "")),
    "one look twice": ("external_axes", lambda t: first(t, home_checks(t)[0], home_checks(t)[1])),
    "looks at the other axis each": (
        "external_axes",
        lambda t: re.sub(r"AXIS_ACT\.E(\d)", lambda m: f"AXIS_ACT.E{3 - int(m[1])}", t),
    ),
    "a look for another home": (
        "external_axes",
        lambda t: first(t, "ABS($AXIS_ACT.E1-180.0000)", "ABS($AXIS_ACT.E1+180.0000)"),
    ),
    "a wide look": (
        "external_axes",
        lambda t: re.sub(r"(?s)(.*)IF tm_shift>0\.1 THEN", r"\1IF tm_shift>1.0 THEN", t),
    ),
    "looks with each other's names": (
        "external_axes",
        lambda t: t.replace("STN_1 turn is", "STN_1 what is").replace("STN_1 tilt is", "STN_1 turn is"),
    ),
    "a first move elsewhere": (
        "external_axes",
        lambda t: first(t, "PTP x_home\n", "PTP x_1_station_1\nPTP x_home\n"),
    ),
    "tilted at the end": ("external_axes", lambda t: re.sub(r"(?s)(.*)PTP x_home\n", r"\1", t)),
    "turned at the end": (
        "external_axes",
        lambda t: re.sub(r"(?s)(.*)PTP x_home\n", r"\1PTP x_1_station_1\n", t),
    ),
    "nobody asked before they go home": ("setup", lambda t: first(t, "All work done", "Work done")),
    "told another tilt": ("setup", lambda t: first(t, f"tilts to {TILT} deg", "tilts to -50.0000 deg")),
    "told the other order": (
        "setup",
        lambda t: first(
            t,
            f"turns to {TURN} deg, then tilts to {TILT} deg",
            f"tilts to {TILT} deg, then turns to {TURN} deg",
        ),
    ),
}
"""Faults by name: the rule that refuses each, and the change."""

SHORT = (
    "no tilt in one move",
    "the first target at home",
    "another tilt in one move",
    "creeping away and back",
    "as other axes",
    "another frame",
    "both at once",
    "the tilt before the turn",
    "out of home",
    "no speed of the tilt",
    "one look twice",
    "looks with each other's names",
    "tilted at the end",
    "column",
)
"""Of those that a whole proof tells, the ones that are not much like others; the rest are long tests,"""
EARLY_RULES = ("declarations", "syntax", "setup", "work_object")
"""but for those by these rules, which end a proof early."""


def mark_long(names: Iterable[str]) -> list[Any]:
    """Return all names. Most of those that need a whole proof are long tests."""
    quick = {name for name, (word, _) in MUTANTS.items() if word in EARLY_RULES}
    return [
        one if one in SHORT or one in quick else pytest.param(one, marks=pytest.mark.long) for one in names
    ]


@pytest.mark.sampled(every=4)
@pytest.mark.parametrize("name", mark_long(MUTANTS))
def test_a_wrong_positioner_is_refused(prover: Prover, name: str) -> None:
    word, change = MUTANTS[name]
    refused(prover, broken(positioner_job.planned_krl_job().programs, change), word)


OTHERS: dict[str, dict[str, Any]] = {
    "centre": {"centre": np.array([0.9, 0.0, 0.471])},
    "direction": {"axis": np.array([0.0, 1.0, 0.0])},
    "column": {"column": 2},
    "range": {"low": np.deg2rad(-55.0)},
    "speed": {"speed": np.deg2rad(900.0)},
}


@pytest.mark.parametrize("name", mark_long(OTHERS))
def test_programs_of_another_tilt_axis_are_refused(prover: Prover, name: str) -> None:
    """The same text for a cell whose tilt axis is another one."""
    table = prover.problem.cell.turntable
    assert table is not None and table.tilt is not None
    other = dataclasses.replace(table, tilt=dataclasses.replace(table.tilt, **OTHERS[name]))
    cell = dataclasses.replace(prover.problem.cell, turntable=other)
    made = Prover(dataclasses.replace(prover.problem, cell=cell), prover.claims)
    refused(made, dict(positioner_job.planned_krl_job().programs), "external_axes")


@pytest.mark.long
def test_the_older_dialect_and_spline_blocks_have_both_axes_as_well() -> None:
    older = positioner_job.planned_krl_job(dialect="krc2")
    assert older.verified
    assert re.search(rf"LIN \{{[^}}]*,{re.escape(STAND)}\}}", "".join(older.programs.values()))
    curved = positioner_job.planned_krl_job("kr6_r900_2", path="spline")  # room for curves
    assert curved.verified
    assert re.search(rf"SPL \{{[^}}]*,{re.escape(STAND)}\}}", "".join(curved.programs.values()))


def test_the_setup_sheet_says_what_the_machine_data_need() -> None:
    out = positioner_job.planned_krl_job()
    rows = {str(what): str(expected) for _, what, expected, _ in _check_rows(out.problem, out.plan)}
    kind = "present, rotary, synchronous, in deg; $AXIS_TYPE[{}] 3, not 5 (shorter direction)"
    assert rows["E1, axis 7: STN_1 turn"] == kind.format(7)
    assert rows["E2, axis 8: STN_1 tilt"] == kind.format(8)
    chain = rows["STN_1 in MACHINE_DEF, $EX_KIN, $ET1_AX"]
    assert chain.startswith("#EASYS with TR_A1 #E2 (tilt), TR_A2 #E1 (turn), or #NONE")
    assert rows["STN_1 tilt: $SOFTN_END[8], $SOFTP_END[8]"].startswith("-70 to 20 deg, at most 15 deg/s (at")
    assert "(at $VEL_EXTAX[1] 100), 40 deg/s²; home 180" in rows["STN_1 turn: $SOFTN_END[7], $SOFTP_END[7]"]
    # as the foot sees it, which is turned by 10 degrees, 200 mm above the world's origin
    seen = Rotation.from_euler("z", -10.0, degrees=True).apply([[0.0, -1.0, 0.0], [900.0, 0.0, 0.0]])
    lies = rows["STN_1 tilt: base frame"]
    assert f"({seen[0, 0]:.6f}, {seen[0, 1]:.6f}, 0.000000) in $WORLD" in lies.replace("−", "-")
    assert f"{seen[1, 0]:.2f}, {seen[1, 1]:.2f}, 270.00 mm" in lies.replace("−", "-")
    assert "E3, E4, E5, E6" in rows["other external axes"] and "MechUnitLoad" not in str(rows)


def _check_rows(problem: Any, plan: Any) -> Any:
    return setup_sheet.controller_checks(problem, plan).rows
