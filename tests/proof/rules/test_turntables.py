"""Turntables in programs: the pose of the block by the text, and faults in units, values and frames."""

from __future__ import annotations

import dataclasses
import functools
import re
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import planner
from planner.cell.kinematics import forward_kinematics
from planner.geometry.arrays import inverse
from planner.pipeline import Outcome
from planner.problem import Obstacle
from planner.proof.context import Context
from planner.proof.prove import Prover
from planner.proof.rules import external_axes
from planner.reading.cell import ObstacleFile, build_shape
from tests import table_job
from tests.proof.provers import prover_of

SECOND_STATION = "120.0000"
"""The second station as the text has it."""


@pytest.fixture(scope="module")
def prover() -> Prover:
    return prover_of(table_job.planned_job())


def test_where_the_block_is_follows_from_the_text_within_a_micrometre(prover: Prover) -> None:
    out = table_job.planned_job()
    assert out.verified and out.plan.stations[0]["stock"] == 0.0
    assert np.rad2deg(out.plan.stations[1]["stock"]) == pytest.approx(float(SECOND_STATION))
    context = external_axes.with_text_stations(Context(prover.problem, prover.claims, out.programs))
    turn = Rotation.from_euler("z", float(SECOND_STATION), degrees=True).as_matrix()  # scipy's
    centre, stated = np.array([0.9, 0.0, 0.2]), prover.problem.stock.place
    assert stated is not None
    place = context.stock_frames[1]
    assert place is not None
    np.testing.assert_allclose(place[:3, :3], turn @ stated[:3, :3], atol=1e-8)
    np.testing.assert_allclose(place[:3, 3], centre + turn @ (stated[:3, 3] - centre), atol=1e-7)
    for index, setup in enumerate(out.problem.setups):
        operation_plan, planned = out.plan.operations[index], setup.cell.arm("left")
        tcp = planned.base @ forward_kinematics(planned.data, operation_plan.q["left"]) @ planned.tool.tcp
        seen = (inverse(np.asarray(context.stock_frames[index])) @ tcp)[:, :3, 3]
        expected = operation_plan.targets.pose["left"][:, :3, 3]
        assert np.linalg.norm(seen - expected, axis=1).max() < 1e-6
        nodes = context.spans.of_stage[context.motion.node_stage] == index
        text = context.motion.node_tcp["left"][nodes][:, :3, 3]
        assert np.linalg.norm(text[:, None] - tcp[1:, :3, 3], axis=2).min(axis=0).max() < 1e-6


def first(text: str, old: str, new: str) -> str:
    assert old in text, old
    return text.replace(old, new, 1)


def moves(text: str, new: str, count: int = 0) -> str:
    """The second station's value in straight moves."""
    return re.sub(rf"(MoveL .*?),\[{SECOND_STATION},", rf"\1,[{new},", text, count=count)


def frame(text: str, change: Any) -> str:
    """The data of the second station's work object, changed."""
    line = re.search(r"wobjdata w_stock_2:=(.*);", text)
    assert line is not None
    return text.replace(line[1], change(line[1]))


def mirrored(data: str) -> str:
    """Return a frame with the inverse rotation: q4 with the other sign."""
    return re.sub(r"(0\.00000000,0\.00000000),(0\.9063\d+)", r"\1,-\2", data)


def third(text: str) -> str:
    """The third straight move of the second operation turns the table by half a degree."""
    at = [m.start() for m in re.finditer(rf"MoveL [^\n]*,\[{SECOND_STATION},", text)][2]
    return text[:at] + first(text[at:], f"[{SECOND_STATION},", "[120.5000,")


TABLE_MOVE = r"    MoveAbsJ j_2_station_1\NoEOffs,v_entry,fine,t_ball_tool;" + "\n"
"""The move that turns the table, and that home again."""

MUTANTS = {
    "another unit": ("external_axes", lambda t: first(t, "ActUnit STN_1", "ActUnit STN_2")),
    "no unit": ("external_axes", lambda t: first(t, "    ActUnit STN_1;\n", "")),
    "switched on too late": (
        "external_axes",
        lambda t: first(
            first(t, "    ActUnit STN_1;\n", ""), "    operation_2;", "    ActUnit STN_1;\n    operation_2;"
        ),
    ),
    "switched off": (
        "external_axes",
        lambda t: first(t, "    operation_2;", "    DeactUnit STN_1;\n    operation_2;"),
    ),
    "missing value": ("external_axes", lambda t: moves(t, "9E9")),
    "missing at home": ("external_axes", lambda t: first(t, "[0.0000,9E9", "[9E9,9E9")),
    "another value in the cut": ("external_axes", lambda t: moves(t, "130.0000")),
    "it changes inside a cut": ("external_axes", third),
    "another value all along": ("external_axes", lambda t: t.replace(SECOND_STATION, "130.0000")),
    "another value of a tenth": ("work_object", lambda t: t.replace(SECOND_STATION, "120.1000")),
    "wrong sign": ("external_axes", lambda t: t.replace(SECOND_STATION, f"-{SECOND_STATION}")),
    "beyond the range": ("external_axes", lambda t: t.replace(SECOND_STATION, "190.0000")),
    "in radians": ("external_axes", lambda t: t.replace(SECOND_STATION, "2.4435")),
    "a second axis": (
        "external_axes",
        lambda t: t.replace(f"[{SECOND_STATION},9E9", f"[{SECOND_STATION},10"),
    ),
    "the axis as the second": (
        "external_axes",
        lambda t: t.replace(f"[{SECOND_STATION},9E9", f"[9E9,{SECOND_STATION}"),
    ),
    "another frame": ("work_object", lambda t: frame(t, lambda d: first(d, "240.0000", "245.0000"))),
    "a frame turned the other way": ("work_object", lambda t: frame(t, mirrored)),
    "the frame of before": ("external_axes", lambda t: t.replace("WObj:=w_stock_2", "WObj:=w_stock")),
    "a frame of the unit": (
        "held_frame",
        lambda t: frame(t, lambda d: first(d, '[FALSE,TRUE,""', '[FALSE,FALSE,"STN_1"')),
    ),
    "another base": (
        "base_frames",
        lambda t: first(t, "base_frame:=[[0.0000,0.0000", "base_frame:=[[0.0000,50.0000"),
    ),
    "a fast table": (
        "external_axes",
        lambda t: first(t, "v_entry:=[250,45,250,20]", "v_entry:=[250,45,250,90]"),
    ),
    "not folded": ("external_axes", lambda t: first(t, TABLE_MOVE, "")),
    "back before the arm is home": (
        "external_axes",
        lambda t: t[: t.rindex(TABLE_MOVE)] + t[t.rindex(TABLE_MOVE) :].replace("j_2_station_1", "j_home"),
    ),
    "nobody keeps off": (
        "external_axes",
        lambda t: first(
            t,
            '  ERROR\n    StopMove\\Quick;\n    TPWrite "Tandem: error in operation_1',
            TABLE_MOVE + '  ERROR\n    StopMove\\Quick;\n    TPWrite "Tandem: error in operation_1',
        ),
    ),
    "no look before the first move": ("external_axes", lambda t: first(t, "    check_axes;\n", "")),
    "a wide look": ("cell_check", lambda t: first(t, "eax_a,0.0000,0.1;", "eax_a,0.0000,5;")),
    "a look at another unit": ("cell_check", lambda t: first(t, '"Axis STN_1"', '"Axis STN_2"')),
    "not home at the end": (
        "external_axes",
        lambda t: re.sub(r"(?s)(.*\n) *MoveAbsJ j_home[^\n]*\n", r"\1", t, count=1),
    ),
    "nobody asked before it turns home": (
        "external_axes",
        lambda t: re.sub(r" *UIMsgBox[^\n]*All work done[^\n]*\n[^\n]*\n", "", t, count=1),
    ),
    "told another value": (
        "setup",
        lambda t: first(t, f"turns to {SECOND_STATION} deg", "turns to 130.0000 deg"),
    ),
}


def broken(outcome: Outcome, change: Any) -> dict[str, str]:
    """The programs with a change of their text."""
    good = outcome.programs
    joined = "\0".join(good.values())
    bad = dict(zip(good, change(joined.replace("\r\n", "\n")).split("\0"), strict=True))
    bad = {file: text.replace("\n", "\r\n") for file, text in bad.items()}
    assert bad != good
    return bad


@pytest.mark.sampled(every=3)
@pytest.mark.parametrize("name", MUTANTS)
def test_a_wrong_turntable_is_refused(prover: Prover, name: str) -> None:
    word, change = MUTANTS[name]
    proof = prover.prove(broken(table_job.planned_job(), change))
    assert not proof.ok
    assert f"verify.{word}" in {issue.code for issue in proof.issues}, [str(i) for i in proof.issues]


OTHERS = {
    "centre": {"centre": np.array([0.9, 0.001, 0.2])},
    "direction": {"axis": np.array([0.0, 0.0, -1.0])},
    "unit": {"unit": "STN_2"},
    "column": {"column": 1},
    "range": {"high": np.deg2rad(100.0)},
    "speed": {"speed": np.deg2rad(5.0)},
    "home": {"home": np.deg2rad(10.0)},
}


@pytest.mark.parametrize("name", OTHERS)
def test_programs_of_another_turntable_are_refused(prover: Prover, name: str) -> None:
    """The same text for a cell whose table is another one."""
    cell = prover.problem.cell
    assert cell.turntable is not None
    other = dataclasses.replace(cell, turntable=dataclasses.replace(cell.turntable, **OTHERS[name]))
    made = Prover(dataclasses.replace(prover.problem, cell=other), prover.claims)
    codes = {issue.code for issue in made.prove(table_job.planned_job().programs).issues}
    assert "verify.external_axes" in codes


def test_a_unit_that_the_cell_does_not_have_is_refused(prover: Prover) -> None:
    cell = dataclasses.replace(prover.problem.cell, turntable=None)
    other = Prover(dataclasses.replace(prover.problem, cell=cell), prover.claims)
    codes = {issue.code for issue in other.prove(table_job.planned_job().programs).issues}
    assert {"verify.external_axes", "verify.move_kinds"} <= codes


def test_a_turn_by_other_code_is_held_against_the_problems(
    prover: Prover, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the planner's own turn, by which it wrote frames, goes wrong, the proof's does not."""
    from planner.problem import Turntable

    right = Turntable.rotate
    monkeypatch.setattr(Turntable, "rotate", lambda self, place, value: right(self, place, -value))

    def change(text: str) -> str:
        turn = Rotation.from_euler("z", 10.0 - float(SECOND_STATION), degrees=True)
        centre, stated = np.array([900.0, 0.0, 200.0]), np.array([930.0, 20.0, 240.0])
        x, y, z = centre + Rotation.from_euler("z", -float(SECOND_STATION), degrees=True).apply(
            stated - centre
        )
        q = turn.as_quat(scalar_first=True)
        data = f'[FALSE,TRUE,"",[[{x:.4f},{y:.4f},{z:.4f}],[{",".join(f"{v:.8f}" for v in q)}]],'
        return frame(text, lambda d: data + d.split("]],", 1)[1])

    proof = prover.prove(broken(table_job.planned_job(), change))
    codes = {issue.code for issue in proof.issues}
    assert "verify.work_object" not in codes and "verify.external_axes" in codes


@pytest.mark.parametrize(("side", "clear"), [(410.0, False), (480.0, True)])
def test_the_way_between_stations_is_looked_at(prover: Prover, side: float, clear: bool) -> None:
    """A post where the block sweeps by, and one where it does not: its far corner goes round at 405 mm."""
    box = {"kind": "box", "size_mm": [40, 40, 600], "pose": {"xyz_mm": [900, side, 300]}}
    made = ObstacleFile.model_validate({"name": "post", "shapes": [box]})
    here = Obstacle("post", tuple(build_shape(one, prover.problem.path.parent) for one in made.shapes))
    cell = dataclasses.replace(prover.problem.cell, obstacles=(*prover.problem.cell.obstacles, here))
    there = Prover(dataclasses.replace(prover.problem, cell=cell), prover.claims)
    codes = {issue.code for issue in there.prove(table_job.planned_job().programs).issues}
    assert ("verify.track_way" not in codes) == clear


# ---- two arms ----

FOLDER = tempfile.TemporaryDirectory()
"""Folder of the files of the job with two arms while tests run."""


@functools.cache
def of_two() -> Outcome:
    """The second arm works in a third operation; meanwhile it waits at home."""
    right = {**table_job.ARM, "name": "right", "base": {"xyz_mm": [1800, 0, 200], "rpy_deg": [0, 0, 180]}}
    rows = table_job.rows(280.0).replace("left.", "right.")
    (Path(FOLDER.name) / "c.csv").write_text(rows)
    work = {"process": "targets", "frame": "stock"}
    operations = [{"name": n, "arms": ["left"], "file": f"{n}.csv", **work} for n in "ab"]
    operations += [{"name": "c", "arms": ["right"], "file": "c.csv", **work}]
    table = {**table_job.TABLE, "external_axis": 2}
    made = table_job.problem(Path(FOLDER.name), table, arms=(table_job.ARM, right), operations=operations)
    return planner.plan(made)


def test_the_other_arm_has_to_be_at_home_while_the_table_turns() -> None:
    out = of_two()
    assert out.verified
    data = out.programs["T_ROB1/TandemData_1.mod"]
    assert (
        f"[9E9,{SECOND_STATION},9E9" in data and SECOND_STATION not in out.programs["T_ROB2/TandemData_2.mod"]
    )
    made = prover_of(out)

    def change(text: str) -> str:
        second = text.index("MODULE TandemMain_2")
        at = text.index("PROC operation_2()\n", second) + len("PROC operation_2()\n")
        away = r"    MoveAbsJ j_3_start\NoEOffs,v_entry,fine,t_ball_tool;" + "\n"
        return text[:at] + away + text[at:]

    found = made.prove(broken(out, change)).issues
    messages = [i.message for i in found if i.code == "verify.external_axes"]
    assert "STN_1 moves while right is not at home" in messages, [str(i) for i in found]
