"""Two arms on one rail whose tracks move one after the other: the order in the text matters."""

from __future__ import annotations

import functools
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

import planner
from planner.pipeline import Outcome
from tests import track_job
from tests.proof.provers import prover_of

FOLDER = tempfile.TemporaryDirectory()
"""Folder of the job's files while tests run."""


def problem(folder: Path) -> planner.Problem:
    """Return a problem of two arms on one rail.

    The right arm moves out of the way by 300 mm, then the left one moves from -1000 mm to the right one's
    position. They have to return home in the other order.
    """
    arms = [
        {**track_job.ARM, "name": name, "track": {**track_job.TRACK, "unit": unit, "home_mm": home}}
        for name, unit, home in (("left", "TRACK_1", -1000), ("right", "TRACK_2", 300))
    ]
    w = track_job.at_home("irb140")
    for name, middle in (("right", 2200.0), ("left", 900.0)):
        rows = [track_job.COLUMNS.replace("left", name)]
        for k in np.linspace(0.0, 4.0, 5):
            at = 500.0, middle + 40.0 * k, 450.0 + 20.0 * np.sin(k)
            rows.append(",".join(str(round(float(v), 9)) for v in (*at, *w, 50.0)) + ",move")
        (folder / f"{name}.csv").write_text("\n".join(rows) + "\n")
    operations = [
        {"name": name, "process": "targets", "arms": [name], "file": f"{name}.csv", "frame": "world"}
        for name in ("right", "left")
    ]
    data = {
        "tandem": 1,
        "name": "two_tracks",
        "cell": {"name": "rail", "arms": arms},
        "stock": {"size_mm": [100, 100, 50], "place": {"xyz_mm": [0, -4500, 0]}},
        "operations": operations,
    }
    (folder / "problem.yaml").write_text(yaml.safe_dump(data))
    return planner.load(folder / "problem.yaml")


@functools.cache
def planned() -> Outcome:
    return planner.plan(problem(Path(FOLDER.name)))


def test_arms_on_one_rail_go_home_one_after_the_other() -> None:
    """The left one first: with it still at its station the right one could not."""
    out = planned()
    assert out.verified
    assert out.plan.stations[1]["left"] == pytest.approx(0.3) and out.plan.stations[1]["right"] > 1.2


HOME = r"    MoveAbsJ j_home\NoEOffs,v_entry,fine,t_ball_tool;" + "\n"
AWAY = HOME.replace("j_home", "[[30,0,0,0,30,0],[-1000,9E9,9E9,9E9,9E9,9E9]]")
MEETING_COMMENT = "    ! meet_16: left is at its station\n"
MET = "    WaitSyncTask meet_16,all_tasks;\n"


def first(text: str, old: str, new: str) -> str:
    assert old in text, old
    return text.replace(old, new, 1)


MUTANTS: dict[str, tuple[str, Callable[[str], str], Callable[[str], str]]] = {
    "the right one home first": (
        "track_way",
        lambda left: first(left, HOME + MEETING_COMMENT + MET, MEETING_COMMENT + MET + HOME),
        lambda right: first(first(right, MET + HOME, MET), MEETING_COMMENT, HOME + MEETING_COMMENT),
    ),
    "the left one works before the right one goes home": (  # which rules have at home by then
        "external_axes",
        lambda left: first(left, HOME + MEETING_COMMENT, HOME + AWAY + HOME + MEETING_COMMENT),
        lambda right: right,
    ),
}


@pytest.mark.parametrize("name", MUTANTS)
def test_a_wrong_order_is_refused(name: str) -> None:
    word, one, other = MUTANTS[name]
    out = planned()
    made = prover_of(out)
    change = {"T_ROB1/TandemMain_1.mod": one, "T_ROB2/TandemMain_2.mod": other}
    bad = {
        file: change.get(file, str)(text.replace("\r\n", "\n")).replace("\n", "\r\n")
        for file, text in out.programs.items()
    }
    proof = made.prove(bad)
    assert not proof.ok
    assert f"verify.{word}" in {issue.code for issue in proof.issues}, [str(i) for i in proof.issues]
