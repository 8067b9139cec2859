"""Gantries in KRL: the pose of the arm by E1 and E2 of the text, and faults in the values and checks."""

from __future__ import annotations

import dataclasses
import itertools
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from planner.cell.kinematics import forward_kinematics
from planner.processes import registry
from planner.proof.context import Context
from planner.proof.prove import Prover
from planner.proof.rules import external_axes
from planner.report import scene, setup_sheet
from tests import gantry_job
from tests.languages.krl.rules.test_krl_external_axes import broken, changed, first, refused
from tests.proof.provers import prover_of

SECOND_STATION, INTERMEDIATE_STATION, FIRST_STATION = (
    "E1 700.0000,E2 100.0000",
    "E1 700.0000,E2 0.0000",
    "E1 -400.0000,E2 0.0000",
)
"""The second station as the text has it, what lies between it and those before and behind, and the first
one."""
TAKEN = "-0.500000*$AXIS_ACT.E1-0.000000*$AXIS_ACT.E2"
"""Contribution of the axes to $ROBROOT_C.X, which is rotated by 30 degrees to the bridge."""


@pytest.fixture(scope="module")
def prover() -> Prover:
    return prover_of(gantry_job.planned_krl_job())


def test_the_text_has_the_tool_within_a_micrometre_of_the_plan(prover: Prover) -> None:
    out = gantry_job.planned_krl_job()
    assert out.verified, [str(issue) for issue in out.issues]
    assert prover.prove(out.programs).ok  # of the text alone
    context = external_axes.with_text_stations(Context(prover.problem, prover.claims, out.programs))
    for index, (y, z) in enumerate([(-0.4, 0.0), (0.7, 0.1)]):
        arm, operation_plan = prover.problem.cell.arm("left"), out.plan.operations[index]
        base = arm.base.copy()
        base[:3, 3] += [0.0, y, z]
        tcp = (base @ forward_kinematics(arm.data, operation_plan.q["left"]) @ arm.tool.tcp)[:, :3, 3]
        assert np.linalg.norm(tcp - operation_plan.targets.pose["left"][:, :3, 3], axis=1).max() < 1e-6
        nodes = context.spans.of_stage[context.motion.node_stage] == index
        text = context.motion.node_tcp["left"][nodes][:, :3, 3]
        assert np.linalg.norm(text[:, None] - tcp, axis=2).min(axis=0).max() < 1e-6


def test_each_axis_takes_the_time_of_the_text_on_the_proofs_clock_and_in_the_replay() -> None:
    out = gantry_job.planned_krl_job()
    context = Context(out.problem, registry.claims(out.problem), out.programs)
    text = "".join(out.programs.values())
    shares = {n: float(v) / 100.0 for n, v in re.findall(r"\$VEL_EXTAX\[(\d)\]=(\d+)", text)}
    own = {"1": (shares["1"], 1.0), "2": (0.5 * shares["2"], 0.5)}  # m/s, m/s2
    assert all(speed <= 0.25 for speed, _ in own.values())
    expected = []
    for n, way in (("1", 0.4), ("1", 1.1), ("2", 0.1), ("2", 0.1), ("1", 0.7)):
        speed = min(own[n][0], float(np.sqrt(way * own[n][1])))
        expected.append(way / speed + speed / own[n][1])
    gaps = np.diff(context.motion.time)
    for seconds in expected:
        assert np.abs(gaps - seconds).min() < 0.01
    run = scene.sample_keyframes(out.problem, out.plan, 100)
    assert run.travel == pytest.approx(sum(expected), abs=1e-3)
    # home by the lift first: at no time does the bridge go while it is raised but there
    lift, bridge = run.axis_values["left/lift"], run.axis_values["left/bridge"]
    both = (np.abs(np.diff(lift)) > 1e-9) & (np.abs(np.diff(bridge)) > 1e-9)
    assert not both.any() and lift[-1] == bridge[-1] == 0.0 and lift.max() == pytest.approx(0.1)


def test_the_replay_has_what_rides_where_it_is() -> None:
    out = gantry_job.planned_krl_job()
    from planner.report.output import cell_model

    run = scene.sample_keyframes(out.problem, out.plan, 60)
    shown = scene.extract_scene(cell_model(out.problem, out.plan))
    poses = scene.poses_on_axes(shown, out.problem.setups, run.setup, shown.poses(run.q), run.axis_values)
    y, z = run.axis_values["left/bridge"], run.axis_values["left/lift"]
    np.testing.assert_allclose(poses["left/base_link"][:, 1:3, 3], np.stack([y, 1.0 + z], axis=1), atol=1e-9)
    # of a model of the first setup, whose column stands at its station
    np.testing.assert_allclose(poses["column"][:, 1, 3], y + 0.4, atol=1e-9)
    np.testing.assert_allclose(poses["console"][:, 1:3, 3], np.stack([y + 0.4, z], axis=1), atol=1e-9)
    assert (np.ptp(y), np.ptp(z)) == pytest.approx((1.1, 0.1))
    # pictures and files have them where each setup does
    setup = out.problem.setups[1]
    stood = scene.scene_poses(shown, setup, np.eye(4), {"left": setup.cell.arm("left").home[None]})
    np.testing.assert_allclose(stood["console"][0][:3, 3], [0.0, 1.1, 0.1], atol=1e-9)


# ---- programs that are wrong ----


def cuts(text: str, new: str) -> str:
    """Values of the second station in straight moves."""
    return changed(text, rf"(SLIN [^\n]*,){re.escape(SECOND_STATION)}\}}", rf"\1{new}}}")


def replace_position_check(text: str, new: str) -> str:
    assert TAKEN in text
    return text.replace(TAKEN, new)


MUTANTS: dict[str, tuple[str, Callable[[str], str]]] = {
    "a value off by 1 mm": ("external_axes", lambda t: cuts(t, "E1 700.0000,E2 101.0000")),
    "off by 1 mm all along": ("setup", lambda t: t.replace("E1 700.0000", "E1 701.0000")),
    "two axes swapped": ("external_axes", lambda t: t.replace(SECOND_STATION, "E1 100.0000,E2 700.0000")),
    "a sign": ("external_axes", lambda t: cuts(t, "E1 -700.0000,E2 100.0000")),
    "metres": ("external_axes", lambda t: cuts(t, "E1 0.7000,E2 0.1000")),
    "no lift": ("external_axes", lambda t: cuts(t, "E1 700.0000")),
    "a third axis": ("external_axes", lambda t: cuts(t, f"{SECOND_STATION},E3 10.0000")),
    "the lift before the bridge": (
        "external_axes",
        lambda t: first(t, INTERMEDIATE_STATION, "E1 -400.0000,E2 100.0000"),
    ),
    "both at once": ("external_axes", lambda t: first(t, "PTP x_2_station_1\n", "")),
    "no speed of the lift": ("external_axes", lambda t: changed(t, r"\$VEL_EXTAX\[2\]=\d+\n", "")),
    "directions swapped": (
        "syntax",
        lambda t: replace_position_check(t, "-0.000000*$AXIS_ACT.E1-0.500000*$AXIS_ACT.E2"),
    ),
    "axes in the look swapped": (
        "syntax",
        lambda t: re.sub(
            r"(\$ROBROOT_C\.[XYZ])-([\d.]+)\*\$AXIS_ACT\.E1-([\d.]+)\*\$AXIS_ACT\.E2",
            r"\1-\2*$AXIS_ACT.E2-\3*$AXIS_ACT.E1",
            t,
        ),
    ),
    "a sign in the look": ("syntax", lambda t: replace_position_check(t, TAKEN.replace("-0.5", "+0.5"))),
    "one axis in the look": ("syntax", lambda t: re.sub(r"-[\d.]+\*\$AXIS_ACT\.E2", "", t)),
    "one axis of X alone": ("declarations", lambda t: replace_position_check(t, "-0.500000*$AXIS_ACT.E1")),
    "one axis twice in X": (
        "declarations",
        lambda t: replace_position_check(t, "-0.500000*$AXIS_ACT.E1-0.000000*$AXIS_ACT.E1"),
    ),
    "a look as on a track that stands": (
        "syntax",
        lambda t: re.sub(
            r"tm_shift=ABS\(\$ROBROOT_C[^\n]*\n[^\n]*\n[^\n]*",
            "tm_shift=SQRT($ROBROOT.X*$ROBROOT.X+$ROBROOT.Y*$ROBROOT.Y+$ROBROOT.Z*$ROBROOT.Z)",
            t.replace("ROBROOT_C.A", "ROBROOT.A")
            .replace("ROBROOT_C.B", "ROBROOT.B")
            .replace("ROBROOT_C.C", "ROBROOT.C"),
        ),
    ),
    "no look behind the lift": (
        "syntax",
        lambda t: re.sub(
            r"(PTP x_2_station_2\n)tm_shift=ABS\(\$ROBROOT_C.*?ENDWHILE\n(?:tm_par[^\n]*\n)*",
            r"\1",
            t,
            count=1,
            flags=re.DOTALL,
        ),
    ),
    "told another value": ("setup", lambda t: first(t, "lift at 100.000 mm", "lift at 300.000 mm")),
}


LATER = ("no speed of the lift", "a third axis", "no lift", "metres", "one axis twice in X")
"""Faults that resemble others; they are long tests."""


@pytest.mark.sampled(every=3)
@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.long) if n in LATER else n for n in MUTANTS]
)
def test_a_wrong_gantry_is_refused(prover: Prover, name: str) -> None:
    word, change = MUTANTS[name]
    refused(prover, broken(gantry_job.planned_krl_job().programs, change), word)


def test_programs_for_a_gantry_of_another_direction_are_refused(prover: Prover) -> None:
    """The same text for a cell whose two axes change places: the looks at $ROBROOT_C tell."""
    arm = prover.problem.cell.arm("left")
    one, two = arm.linear_axes
    swapped = (dataclasses.replace(one, axis=two.axis), dataclasses.replace(two, axis=one.axis))
    cell = dataclasses.replace(prover.problem.cell, arms=(dataclasses.replace(arm, linear_axes=swapped),))
    made = Prover(dataclasses.replace(prover.problem, cell=cell), prover.claims)
    refused(made, dict(gantry_job.planned_krl_job().programs), "syntax")


def test_the_setup_sheet_says_what_the_machine_data_need() -> None:
    out = gantry_job.planned_krl_job()
    rows: dict[str, Any] = {
        str(what): str(expected)
        for _, what, expected, _ in setup_sheet.controller_checks(out.problem, out.plan).rows
    }
    assert rows["E2, axis 8: GANTRY_1 lift"] == "present, one linear axis, synchronous, in mm"
    chain = rows["GANTRY_1 in MACHINE_DEF, $EX_KIN"]
    assert chain.startswith("#ERSYS with TR_A1 #E1, TR_A2 #E2 from the floor up")
    assert "-300 to 900 mm" in rows["GANTRY_1 lift: $SOFTN_END[8], $SOFTP_END[8]"].replace("−", "-")
    assert "console" in rows["GANTRY_1 lift carries"] and "bridge, lift at 0 mm" in rows["$ERSYSROOT"]
    assert "E3, E4, E5, E6" in rows["other external axes"]
    assert len(list(itertools.chain(rows))) == len(rows)


@pytest.mark.long
def test_the_older_dialect_has_both_axes_as_well() -> None:
    older = gantry_job.planned_krl_job(dialect="krc2")
    assert older.verified
    assert re.search(rf"LIN \{{[^}}]*,{re.escape(SECOND_STATION)}\}}", "".join(older.programs.values()))
