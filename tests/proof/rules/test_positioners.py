"""Positioners in programs: the pose of the block by the text, and faults in units, values and frames."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest

from planner.cell import external_axis_motion
from planner.problem import Cell, Obstacle, RotaryAxis, Turntable
from planner.proof.prove import Prover
from tests import positioner_job
from tests.proof.provers import prover_of
from tests.proof.rules.test_turntables import broken, first

TILT, TURN = "60.0000", "-180.0000"
"""The second station as the text has it: eax_a and eax_b."""
STAND = f"[{TILT},{TURN},9E9"
LEG = f"[-20.0000,{TURN},9E9"
"""Between both stations: turned, and not tilted yet."""
FIRST_STATION = "[-20.0000,40.0000,9E9"
"""The first station."""


@pytest.fixture(scope="module")
def prover() -> Prover:
    return prover_of(positioner_job.planned_job())


def test_where_the_block_is_follows_from_the_text_within_a_micrometre(prover: Prover) -> None:
    out = positioner_job.planned_job()
    assert out.verified and prover.prove(out.programs).ok  # of the text alone
    stands = out.plan.stations[1]
    np.testing.assert_allclose(
        np.rad2deg([stands["stock/tilt"], stands["stock"]]), [float(TILT), float(TURN)]
    )
    positioner_job.require_text_is_planned(
        out, prover, float(TURN), np.deg2rad([0.0, float(TILT), 0.0]), 1e-7
    )


def frame(text: str, change: Any) -> str:
    """The data of the second station's work object, changed."""
    line = re.search(r"wobjdata w_stock_2:=(.*);", text)
    assert line is not None
    return text.replace(line[1], change(line[1]))


def cuts(text: str, old: str, new: str) -> str:
    """Values of external axes in straight moves."""
    return re.sub(rf"(MoveL [^\n]*,){re.escape(old)}", lambda m: m[1] + new, text)


def tilted_first(text: str) -> str:
    """Between the stations the tilt goes before the turn."""
    return first(text, LEG, f"[{TILT},40.0000,9E9")


def out_of_home(text: str) -> str:
    """The axes move at the first target of the second operation, not at home."""
    leg = re.search(r"CONST jointtarget (j_2_station_1):=\[(\[[^\]]*\])", text)
    at = re.search(r"CONST jointtarget j_2_start:=\[(\[[^\]]*\])", text)
    assert leg is not None and at is not None
    return text.replace(leg[0], leg[0].replace(leg[2], at[1]))


MUTANTS = {
    "another unit": ("external_axes", lambda t: first(t, "ActUnit STN_1", "ActUnit STN_2")),
    "no unit": ("external_axes", lambda t: first(t, "    ActUnit STN_1;\n", "")),
    "switched on twice": (
        "external_axes",
        lambda t: first(t, "ActUnit STN_1;", "ActUnit STN_1; ActUnit STN_1;"),
    ),
    "no tilt": ("external_axes", lambda t: cuts(t, STAND, f"[9E9,{TURN},9E9")),
    "no turn": ("external_axes", lambda t: cuts(t, STAND, f"[{TILT},9E9,9E9")),
    "another tilt in the cut": ("external_axes", lambda t: cuts(t, STAND, f"[59.0000,{TURN},9E9")),
    "another tilt all along": ("external_axes", lambda t: t.replace(f"[{TILT},", "[50.0000,")),
    "another turn all along": ("external_axes", lambda t: t.replace(f",{TURN},", ",-140.0000,")),
    "a tilt off by a tenth": ("work_object", lambda t: t.replace(f"[{TILT},", "[59.9000,")),
    "both exchanged": ("external_axes", lambda t: t.replace(STAND, f"[{TURN},{TILT},9E9")),
    "both exchanged, within their ranges": (
        "external_axes",
        lambda t: t.replace(FIRST_STATION, "[40.0000,-20.0000,9E9"),
    ),
    "the other sense of the tilt": ("external_axes", lambda t: t.replace("[-20.0000,", "[20.0000,")),
    "the other sense of the turn": ("external_axes", lambda t: t.replace(",40.0000,9E9", ",-40.0000,9E9")),
    "beyond the tilt's range": ("external_axes", lambda t: t.replace(f"[{TILT},", "[80.0000,")),
    "a third axis": ("external_axes", lambda t: t.replace(STAND, f"[{TILT},{TURN},10")),
    "another frame": ("work_object", lambda t: frame(t, lambda d: re.sub(r"\[\[(\d)", r"[[1\1", d, count=1))),
    "the frame of before": ("external_axes", lambda t: t.replace("WObj:=w_stock_2", "WObj:=w_stock")),
    "a frame of the unit": (
        "held_frame",
        lambda t: frame(t, lambda d: first(d, '[FALSE,TRUE,""', '[FALSE,FALSE,"STN_1"')),
    ),
    "both at once": ("external_axes", lambda t: first(t, LEG, STAND)),
    "the tilt before the turn": ("external_axes", tilted_first),
    "out of home": ("external_axes", out_of_home),
    "a fast tilt": (
        "external_axes",
        lambda t: re.sub(r"v_entry:=\[([^\]]*),[\d.]+\]", r"v_entry:=[\1,40]", t, count=1),
    ),
    "one look is missing": (
        "cell_check",
        lambda t: re.sub(r' *check_axis "Axis STN_1 tilt"[^\n]*\n', "", t, count=1),
    ),
    "a look at the other column": ("cell_check", lambda t: first(t, "extax.eax_a", "extax.eax_b")),
    "told another tilt": ("setup", lambda t: first(t, f"{TILT} deg.", "50.0000 deg.")),
}


KIN = (
    "no unit",
    "no turn",
    "a look at the other column",
    "a fast tilt",
    "another tilt all along",
    "column",
    "switched on twice",
    "another tilt in the cut",
    "another turn all along",
    "both exchanged",
    "beyond the tilt's range",
    "a third axis",
    "the frame of before",
    "a frame of the unit",
    "the other sense of the turn",
    "told another tilt",
    "another axis",
    "range",
    "home",
    "speed",
)
"""Faults that resemble others."""


def mark_long(names: Iterable[str]) -> list[Any]:
    """Return all names, those of :data:`KIN` as long tests."""
    return [pytest.param(name, marks=pytest.mark.long) if name in KIN else name for name in names]


@pytest.mark.sampled(every=2)
@pytest.mark.parametrize("name", mark_long(MUTANTS))
def test_a_wrong_positioner_is_refused(prover: Prover, name: str) -> None:
    word, change = MUTANTS[name]
    proof = prover.prove(broken(positioner_job.planned_job(), change))
    assert not proof.ok
    assert f"verify.{word}" in {issue.code for issue in proof.issues}, [str(i) for i in proof.issues]


OTHERS: dict[str, dict[str, Any]] = {
    "centre": {"centre": np.array([0.9, 0.0, 0.471])},
    "direction": {"axis": np.array([0.0, -1.0, 0.0])},
    "another axis": {"axis": np.array([1.0, 0.0, 0.0])},
    "column": {"column": 2},
    "range": {"high": np.deg2rad(55.0)},
    "speed": {"speed": np.deg2rad(2.0)},
    "home": {"home": np.deg2rad(5.0)},
}


@pytest.mark.parametrize("name", mark_long(OTHERS))
def test_programs_of_another_tilt_axis_are_refused(prover: Prover, name: str) -> None:
    """The same text for a cell whose tilt axis is another one."""
    table = prover.problem.cell.turntable
    assert table is not None and table.tilt is not None
    other = dataclasses.replace(table, tilt=dataclasses.replace(table.tilt, **OTHERS[name]))
    cell = dataclasses.replace(prover.problem.cell, turntable=other)
    made = Prover(dataclasses.replace(prover.problem, cell=cell), prover.claims)
    codes = {issue.code for issue in made.prove(positioner_job.planned_job().programs).issues}
    assert "verify.external_axes" in codes


@pytest.mark.parametrize("what", ["block", "bracket"])
def test_a_turn_by_other_code_is_held_against_the_problems(
    prover: Prover, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    """Where the planner's own turn goes wrong, by which bodies are placed, too, the proof's does not."""
    right = RotaryAxis.rotate
    if what == "block":
        monkeypatch.setattr(
            RotaryAxis, "rotate", lambda self, place, value: right(self, place, 1.001 * value)
        )
    else:
        monkeypatch.setattr(Cell, "with_moved_bodies", lambda self, there, here: self)
    found = Prover(prover.problem, prover.claims).prove(positioner_job.planned_job().programs).issues
    messages = [issue.message for issue in found if issue.code == "verify.external_axes"]
    words = "mm and" if what == "block" else "cradle is not where STN_1"
    assert [text for text in messages if words in text], [str(i) for i in found]


@pytest.mark.parametrize(("height", "clear"), [(60.0, True), (380.0, False)])
def test_the_way_of_the_tilt_is_looked_at(prover: Prover, height: float, clear: bool) -> None:
    """A block on the floor behind the positioner, under which nothing tilts, and one that is in the way."""
    from planner.geometry.arrays import Shape

    pose = np.eye(4)
    pose[:3, 3] = 1.08, 0.0, 0.5e-3 * height
    here = Obstacle("box", (Shape("box", (0.2, 0.2, 1e-3 * height), pose),))
    cell = dataclasses.replace(prover.problem.cell, obstacles=(*prover.problem.cell.obstacles, here))
    there = Prover(dataclasses.replace(prover.problem, cell=cell), prover.claims)
    codes = {issue.code for issue in there.prove(positioner_job.planned_job().programs).issues}
    assert ("verify.track_way" not in codes) == clear


@pytest.mark.parametrize(("height", "clear"), [(100.0, True), (440.0, False)])
def test_a_planner_that_leaves_out_a_column_is_not_believed(
    prover: Prover, monkeypatch: pytest.MonkeyPatch, height: float, clear: bool
) -> None:
    """A column of the posts' body 4 mm behind the cradle, into which that swings, and one that is lower."""
    from planner.geometry.arrays import Shape

    def by_bodies(model: Any, riders: Any, fixed: Any, axis: RotaryAxis) -> np.ndarray:
        return np.array(
            [[a.body in ("cradle", "turntable") and b.body == "posts" for b in fixed] for a in riders]
        )

    monkeypatch.setattr(external_axis_motion, "_bearing_shapes", by_bodies)
    pose = np.eye(4)
    pose[:3, 3] = 0.816, 0.0, 0.5e-3 * height
    column = Shape("box", (0.06, 0.1, 1e-3 * height), pose)
    bodies = [
        dataclasses.replace(body, shapes=(*body.shapes, column)) if body.name == "posts" else body
        for body in prover.problem.cell.obstacles
    ]
    cell = dataclasses.replace(prover.problem.cell, obstacles=tuple(bodies))
    there = Prover(dataclasses.replace(prover.problem, cell=cell), prover.claims)
    found = there.prove(positioner_job.planned_job().programs).issues
    messages = [issue.message for issue in found if issue.code == "verify.track_way"]
    assert (not messages) == clear
    assert clear or "it is not proven that" in messages[0]


def test_a_way_of_the_other_sense_is_refused(prover: Prover, monkeypatch: pytest.MonkeyPatch) -> None:
    """Looks on the way of a turn of the tilted block the wrong way round about the leaning axis."""
    right = Turntable.axis_at_tilt

    def wrong(self: Turntable, name: str, tilt: float) -> RotaryAxis:
        found = right(self, name, tilt)
        return dataclasses.replace(found, axis=-found.axis) if name != "stock/tilt" and tilt else found

    programs = positioner_job.planned_job().programs
    assert "verify.track_way" not in {
        i.code for i in Prover(prover.problem, prover.claims).prove(programs).issues
    }
    monkeypatch.setattr(Turntable, "axis_at_tilt", wrong)
    found = Prover(prover.problem, prover.claims).prove(programs).issues
    messages = [issue.message for issue in found if issue.code == "verify.track_way"]
    assert [text for text in messages if "distances of stock were" in text], [str(i) for i in found]
