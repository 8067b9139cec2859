"""Gantries in programs: poses of arms and carried bodies by the text, faults in values, units and paths."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import planner
from planner.cell import external_axis_motion
from planner.cell.bodies import Solid
from planner.cell.kinematics import forward_kinematics
from planner.cell.plant import CellModel
from planner.geometry.arrays import BoolArray, Shape
from planner.problem import Cell, LinearAxis, Obstacle
from planner.proof.context import Context
from planner.proof.models import MODELS
from planner.proof.prove import Prover
from planner.proof.rules import external_axes, track_clearance
from tests import gantry_job
from tests.proof.provers import prover_of

A, B, LEG = "[-500.0000,0.0000,", "[800.0000,200.0000,", "[800.0000,0.0000,"
"""The stations as the text has them, and what lies between the second one and those before and behind it."""


@pytest.fixture(scope="module")
def prover() -> Prover:
    return prover_of(gantry_job.planned_job())


def test_the_text_has_base_and_bodies_where_sums_by_hand_have_them(prover: Prover) -> None:
    out = gantry_job.planned_job()
    assert out.verified, [str(issue) for issue in out.issues]
    ends = [out.plan.stations[i] for i in range(2)]
    shown = [[1e3 * one["left/bridge"], 1e3 * one["left/lift"]] for one in ends]
    np.testing.assert_allclose(shown, [[-500.0, 0.0], [800.0, 200.0]])
    context = external_axes.with_text_stations(Context(prover.problem, prover.claims, out.programs))
    for index, (y, z) in enumerate([(-0.5, 0.0), (0.8, 0.2)]):
        arm, operation_plan = prover.problem.cell.arm("left"), out.plan.operations[index]
        base = arm.base.copy()
        base[:3, 3] += [0.0, y, z]
        np.testing.assert_allclose(context.base_poses(index)["left"], base, atol=1e-9)
        tcp = (base @ forward_kinematics(arm.data, operation_plan.q["left"]) @ arm.tool.tcp)[:, :3, 3]
        assert np.linalg.norm(tcp - operation_plan.targets.pose["left"][:, :3, 3], axis=1).max() < 1e-6
        nodes = context.spans.of_stage[context.motion.node_stage] == index
        text = context.motion.node_tcp["left"][nodes][:, :3, 3]
        assert np.linalg.norm(text[:, None] - tcp, axis=2).min(axis=0).max() < 1e-6
        # the column rides on the bridge alone, the console on both
        model = context.get(MODELS)(index)
        poses = model.poses({})
        np.testing.assert_allclose(poses["column"][0][:3, 3], [0.0, y, 0.0], atol=1e-9)
        np.testing.assert_allclose(poses["console"][0][:3, 3], [0.0, y, z], atol=1e-9)


def test_a_station_at_0_has_no_sign(tmp_path: Path) -> None:
    """A range whose grid has 0 as what rounding leaves of it, a little below (the text that an operator is
    told was one that the proof did not want)."""
    down = {**gantry_job.LIFT, "axis": [0, 0, -1], "range_mm": [-900, 300]}
    out = planner.plan(gantry_job.problem(tmp_path, (gantry_job.BRIDGE, down)))
    assert out.verified, [str(issue) for issue in out.issues]
    assert str(out.plan.stations[0]["left/lift"]) == "0.0"
    assert not any("-0.000" in text for text in out.programs.values())


# ---- programs that are wrong ----


def first(text: str, old: str, new: str) -> str:
    assert old in text, old
    return text.replace(old, new, 1)


def broken(programs: Mapping[str, str], change: Callable[[str], str]) -> dict[str, str]:
    joined = "\0".join(programs.values()).replace("\r\n", "\n")
    bad = dict(zip(programs, change(joined).split("\0"), strict=True))
    bad = {file: text.replace("\n", "\r\n") for file, text in bad.items()}
    assert bad != programs
    return bad


def cuts(text: str, old: str, new: str) -> str:
    """Values in straight moves."""
    out, found = re.subn(rf"(MoveL .*?),{re.escape(old)}", rf"\1,{new}", text)
    assert found, old
    return out


def leg(text: str, number: int, new: str) -> str:
    """The values of a leg of the second operation."""
    out, found = re.subn(
        rf"(jointtarget j_2_station_{number}:=\[\[[^\]]*\],)\[[-\d.]+,[-\d.]+,", rf"\1{new}", text
    )
    assert found
    return out


MOVE = "    MoveAbsJ j_2_station_{}\\NoEOffs,v_entry,fine,t_ball_tool;\n"
HOME_CHECK = "    check_axes;\n"
MUTANTS: dict[str, tuple[str, Callable[[str], str]]] = {
    "a value off by 1 mm": ("external_axes", lambda t: cuts(t, B, "[801.0000,200.0000,")),
    "the other one off by 1 mm": ("external_axes", lambda t: cuts(t, B, "[800.0000,199.0000,")),
    "off by 1 mm all along": ("setup", lambda t: t.replace("[800.0000,", "[801.0000,")),
    "the lift off by 1 mm all along": ("setup", lambda t: t.replace(B, "[800.0000,201.0000,")),
    "two axes swapped": ("external_axes", lambda t: t.replace(B, "[200.0000,800.0000,")),
    "swapped in the cut": ("external_axes", lambda t: cuts(t, B, "[200.0000,800.0000,")),
    "swapped all along": (
        "setup",
        lambda t: leg(t.replace(B, "[200.0000,800.0000,"), 1, "[200.0000,0.0000,").replace(
            A, "[-290.0000,0.0000,"
        ),
    ),
    "a sign": ("external_axes", lambda t: cuts(t, B, "[800.0000,-200.0000,")),
    "a sign all along": ("dialogue", lambda t: t.replace("[800.0000,", "[-800.0000,")),
    "metres": ("external_axes", lambda t: cuts(t, B, "[0.8000,0.2000,")),
    "metres all along": (
        "setup",
        lambda t: t.replace("[800.0000,", "[0.8000,").replace(",200.0000,", ",0.2000,"),
    ),
    "beyond the range": ("external_axes", lambda t: t.replace(B, "[800.0000,950.0000,")),
    "no lift": ("external_axes", lambda t: cuts(t, B, "[800.0000,9E9,")),
    "no bridge": ("external_axes", lambda t: cuts(t, B, "[9E9,200.0000,")),
    "a third axis": ("external_axes", lambda t: cuts(t, f"{B}9E9", f"{B}10")),
    "no unit": ("external_axes", lambda t: first(t, "    ActUnit GANTRY_1;\n", "")),
    "another unit": ("external_axes", lambda t: first(t, "ActUnit GANTRY_1", "ActUnit GANTRY_2")),
    "offsets left on": ("external_axes", lambda t: first(t, "    EOffsOff;\n", "")),
    "the lift before the bridge": ("external_axes", lambda t: leg(t, 1, "[-500.0000,200.0000,")),
    "both at once": ("external_axes", lambda t: first(t, MOVE.format(1), "")),
    "home by the bridge first": (
        "external_axes",
        lambda t: re.sub(
            r"(.*)" + re.escape(MOVE.format(1)),
            lambda m: m[1] + MOVE.format(3),
            re.sub(
                r"(CONST jointtarget )j_2_station_2(:=\[\[[^\]]*\],)[^;]*;",
                lambda m: f"{m[0]}\n  {m[1]}j_2_station_3{m[2]}[0.0000,200.0000,9E9,9E9,9E9,9E9]];",
                t,
                count=1,
            ),
            count=1,
            flags=re.DOTALL,
        ),
    ),
    "one axis twice": (
        "external_axes",
        lambda t: first(t, MOVE.format(1), MOVE.format(1) + MOVE.format(2) + MOVE.format(1)),
    ),
    "fast": ("external_axes", lambda t: first(t, "v_entry:=[250,45,250,", "v_entry:=[250,45,400,")),
    "no look": ("external_axes", lambda t: first(t, HOME_CHECK, "")),
    "one look is missing": (
        "cell_check",
        lambda t: re.sub(r' *check_axis "Axis GANTRY_1 lift"[^\n]*\n', "", t, count=1),
    ),
    "a look at the other column": ("cell_check", lambda t: first(t, "extax.eax_b", "extax.eax_a")),
    "told another value": ("setup", lambda t: first(t, "200.000 mm", "300.000 mm")),
    "raised at the end": (
        "external_axes",
        lambda t: re.sub(r"(.*)    MoveAbsJ j_home[^\n]*\n", r"\1", t, count=1, flags=re.DOTALL),
    ),
}
LATER = (
    "no bridge",
    "another unit",
    "swapped in the cut",
    "a sign",
    "the other one off by 1 mm",
    "fast",
    "offsets left on",
    "no look",
    "a third axis",
    "metres all along",
    "swapped all along",
    "a look at the other column",
    "beyond the range",
)
"""Faults that resemble others; they are long tests."""


@pytest.mark.sampled(every=3)
@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.long) if n in LATER else n for n in MUTANTS]
)
def test_a_wrong_gantry_is_refused(prover: Prover, name: str) -> None:
    word, change = MUTANTS[name]
    proof = prover.prove(broken(gantry_job.planned_job().programs, change))
    assert not proof.ok
    assert f"verify.{word}" in {issue.code for issue in proof.issues}, [str(i) for i in proof.issues]


def with_axis(prover: Prover, index: int, **changes: Any) -> Prover:
    arm = prover.problem.cell.arm("left")
    axes = list(arm.linear_axes)
    axes[index] = dataclasses.replace(axes[index], **changes)
    cell = dataclasses.replace(prover.problem.cell, arms=(dataclasses.replace(arm, linear_axes=tuple(axes)),))
    return Prover(dataclasses.replace(prover.problem, cell=cell), prover.claims)


OTHERS: dict[str, tuple[int, dict[str, Any], str]] = {
    "column": (1, {"column": 2}, "external_axes"),
    "range": (1, {"high": 0.15}, "external_axes"),
    "home": (0, {"home": 0.01}, "external_axes"),
    "speed": (0, {"speed": 0.1}, "external_axes"),
    "unit": (0, {"unit": "BRIDGE_1"}, "external_axes"),
    "direction": (1, {"axis": np.array([0.0, 0.0, -1.0])}, "reach"),
}


@pytest.mark.parametrize("name", OTHERS)
def test_programs_of_another_axis_are_refused(prover: Prover, name: str) -> None:
    """The same text for a cell whose axis is another one; where it goes elsewhere no joints fit its
    targets."""
    place, changes, _ = OTHERS[name]
    proof = with_axis(prover, place, **changes).prove(gantry_job.planned_job().programs)
    assert not proof.ok
    codes = {issue.code for issue in proof.issues}
    assert name == "direction" or "verify.external_axes" in codes, codes


# ---- the way, and what rides ----


def over(prover: Prover, *shapes: Shape) -> list[str]:
    """Return the messages of verify.track_way with an additional body in the cell."""
    cell = prover.problem.cell
    body = (Obstacle("thing", shapes),) if shapes else ()
    there = dataclasses.replace(cell, obstacles=(*cell.obstacles, *body))
    made = Prover(dataclasses.replace(prover.problem, cell=there), prover.claims)
    found = made.prove(gantry_job.planned_job().programs).issues
    return [issue.message for issue in found if issue.code == "verify.track_way"]


def everywhere(model: CellModel, riders: Sequence[Solid], fixed: Sequence[Solid], *_: Any) -> BoolArray:
    """Let the planner treat all fixed bodies as rails."""
    return np.ones((len(riders), len(fixed)), bool)


def box(x: float, y: float, z: float, size: tuple[float, float, float]) -> Shape:
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return Shape("box", size, pose)


def test_what_axes_carry_is_looked_at_on_the_way(prover: Prover) -> None:
    """Behind the arm, where nothing but the column comes; and below the console at home, to where it comes
    down with nothing of the arm."""
    assert not over(prover)
    (message, *_) = over(prover, box(-0.9, 0.5, 1.5, (0.3, 0.1, 0.1)))
    assert "column" in message and "thing" in message and "bridge" in message


def test_a_body_on_the_way_of_the_lift_alone_is_seen(prover: Prover) -> None:
    """Above the console, behind the arm: no way of the bridge comes near, there nor home, where the lift goes
    before it."""
    (message,) = over(prover, box(-0.42, 0.8, 1.17, (0.1, 0.1, 0.05)))
    assert "GANTRY_1 lift" in message and "console and thing" in message


def test_a_planner_that_leaves_out_what_rides_is_not_believed(
    prover: Prover, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(external_axis_motion, "carried_bodies", lambda cell, name: {})
    monkeypatch.setattr(
        external_axis_motion, "_supporting_shapes", lambda model, own, fixed, *_: np.ones(len(fixed), bool)
    )
    right, told = track_clearance._check_query_poses, list[str]()

    def record(*args: Any) -> str:
        told.append(right(*args))
        return told[-1]

    monkeypatch.setattr(
        track_clearance, "_check_query_poses", record
    )  # only the worst issue of each code is reported
    assert over(prover)
    assert {one.removeprefix("distances were measured without ") for one in told} == {
        "column, console",
        "console",
    }


def test_a_planner_that_leaves_out_an_end_stop_is_not_believed(
    prover: Prover, monkeypatch: pytest.MonkeyPatch
) -> None:
    thing = box(-0.9, 0.5, 1.5, (0.3, 0.1, 0.1))
    monkeypatch.setattr(external_axis_motion, "_sliding_shapes", everywhere)
    assert any("it is not proven that column keeps" in message for message in over(prover, thing))
    assert not over(prover)


@pytest.mark.parametrize("blind", [False, True])
def test_a_post_beside_a_carriage_is_no_bearing(
    prover: Prover, monkeypatch: pytest.MonkeyPatch, blind: bool
) -> None:
    """3 mm beside the column where its way begins, which leaves it behind. A planner that takes it for a rail
    is not believed; one as long as the rails is one, as nothing tells it from a guide."""
    if blind:
        monkeypatch.setattr(external_axis_motion, "_sliding_shapes", everywhere)
    words = (
        "it is not proven that column keeps 10 mm from thing"
        if blind
        else "column and thing are 3.000 mm apart"
    )
    reported = over(prover, box(-0.547, 0.0, 0.3, (0.1, 0.4, 0.4)))
    assert any(words in message for message in reported), reported
    assert not over(prover, box(-0.547, 0.0, 0.3, (0.1, 4.0, 0.4)))


@pytest.mark.long
def test_rails_that_are_shorter_than_the_range_are_told(tmp_path: Path) -> None:
    short = {"kind": "box", "size_mm": [300, 2000, 100], "pose": {"xyz_mm": [-700, 0, 50]}}
    bodies = ({"name": "rails", "shapes": [short]}, gantry_job.COLUMN, gantry_job.CONSOLE)
    (issue,) = planner.check(gantry_job.problem(tmp_path, obstacles=bodies))
    assert "column and rails come as close as 1.0 mm at its start; the support of a" in issue.message


@pytest.mark.parametrize("blind", [False, True])
def test_what_is_lowered_keeps_off_the_floor(
    prover: Prover, monkeypatch: pytest.MonkeyPatch, blind: bool
) -> None:
    """A foot of the console that ends 4 mm above the floor; a planner that does not look there is not
    believed."""
    if blind:
        monkeypatch.setattr(external_axis_motion, "_floor_distances", lambda *args: {})
    cell = prover.problem.cell
    foot = box(-0.3, 0.0, 0.104, (0.1, 0.1, 0.2))
    bodies = tuple(
        dataclasses.replace(body, shapes=(*body.shapes, foot)) if body.name == "console" else body
        for body in cell.obstacles
    )
    there = dataclasses.replace(prover.problem, cell=dataclasses.replace(cell, obstacles=bodies))
    found = Prover(there, prover.claims).prove(gantry_job.planned_job().programs).issues
    messages = [issue.message for issue in found if issue.code == "verify.track_way"]
    words = "console is 4.000 mm above the floor" if blind else "console and the floor are 4.000 mm apart"
    assert [text for text in messages if words in text], [str(i) for i in found]


@pytest.mark.parametrize("blind", [False, True])
def test_a_base_is_not_lowered_into_the_floor(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, blind: bool
) -> None:
    """Poses that are reached from below the floor alone; a planner that does not look there is not
    believed."""
    axes = [
        {**gantry_job.BRIDGE, "carries": []},
        {**gantry_job.LIFT, "carries": [], "range_mm": [-900, 1000]},
    ]
    made = gantry_job.problem(tmp_path, axes, (), -1500.0, base={"xyz_mm": [0, 0, 0]})
    if not blind:
        (issue,) = [one for one in planner.check(made) if one.code == "motion.station"]
        assert "left/base_link moves below the floor" in issue.message
        return
    monkeypatch.setattr(external_axis_motion, "_floor_distances", lambda *args: {})
    out = planner.plan(made)
    assert not out.verified
    assert any("left/base_link is -300.000 mm above the floor" in one.message for one in out.issues), [
        str(one) for one in out.issues
    ]


@pytest.mark.parametrize("blind", [False, True])
def test_a_block_is_no_bearing(prover: Prover, monkeypatch: pytest.MonkeyPatch, blind: bool) -> None:
    """A block 2 mm beside the column where its way begins; a planner that takes it for a rail is not
    believed."""
    if blind:
        every = {body.name for body in prover.problem.cell.obstacles} | {"stock"}
        monkeypatch.setattr(external_axis_motion, "_bearing_bodies", lambda *args: every)
        monkeypatch.setattr(external_axis_motion, "_sliding_shapes", everywhere)
    place = np.eye(4)
    place[:3, 3] = [-0.548, 0.0, 0.2]
    stock = dataclasses.replace(prover.problem.stock, place=place)
    made = Prover(dataclasses.replace(prover.problem, stock=stock), prover.claims)
    context = external_axes.with_text_stations(
        Context(made.problem, made.claims, gantry_job.planned_job().programs)
    )
    found = track_clearance.track_clearance(context).issues
    messages = [one.message for one in found if "bridge from 0 mm to -500 mm: " in one.message]
    words = "it is not proven that column keeps 10 mm from stock"
    words = words if blind else "column and stock are 2.000 mm apart"
    assert any(words in text for text in messages), [str(one) for one in found]


@pytest.mark.parametrize("what", ["bodies of setups", "bodies of models", "sums of the planner"])
def test_a_body_left_behind_is_refused(prover: Prover, monkeypatch: pytest.MonkeyPatch, what: str) -> None:
    """Where the planner's own placing goes wrong, by which bodies stand, too, the proof's does not."""
    if what == "bodies of setups":
        monkeypatch.setattr(Cell, "with_moved_bodies", lambda self, there, here: self)
        code, words = "verify.external_axes", "is not where GANTRY_1"
    elif what == "bodies of models":
        monkeypatch.setattr(CellModel, "axis_motion", lambda self, name: np.eye(4))
        code, words = "verify.track_way", "the axes under it put it in setup"
    else:
        right = LinearAxis.translate
        monkeypatch.setattr(
            LinearAxis, "translate", lambda self, pose, value: right(self, pose, 1.001 * value)
        )
        code, words = "verify.external_axes", "is not where GANTRY_1"
    made = Prover(prover.problem, prover.claims)
    found = made.prove(gantry_job.planned_job().programs).issues
    messages = [issue.message for issue in found if issue.code == code]
    assert [text for text in messages if words in text], [str(i) for i in found]
