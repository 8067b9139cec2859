"""Two arms on one controller: one moves with its coordinated track while the other one works or waits.

The first one also works alone.
"""

from __future__ import annotations

import dataclasses
import functools
import re
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import planner
from planner.cell.kinematics import forward_kinematics
from planner.issues import TandemError
from planner.pipeline import Outcome
from planner.proof.context import Context
from planner.proof.prove import Prover
from planner.proof.rules import clearance, external_axes
from planner.proof.rules.track_clearance import track_clearance
from tests.following_job import FOLLOWING
from tests.proof.provers import prover_of
from tests.track_job import TRACK
from tests.two_arms_job import BOTH, LEFT, RIGHT, problem

FOLDER = tempfile.TemporaryDirectory()
"""Folder of the planned job's files while tests run."""
MOVE = re.compile(r"(MoveL .*?\],\[)(-?[0-9.]+|9E9)((?:,[^\]]*)?\]\])")
"""A straight move with the value of its first external axis."""


OPERATIONS = [("row", BOTH, (-1800.0, 1800.0)), ("alone", RIGHT, (0.0, 1.0)), ("back", LEFT, (1000.0, 400.0))]


@functools.cache
def planned() -> Outcome:
    """The job, planned and proven."""
    return planner.plan(problem(Path(FOLDER.name), OPERATIONS))


@pytest.fixture(scope="module")
def prover() -> Prover:
    return prover_of(planned())


def test_one_arm_goes_along_beside_one_that_works(prover: Prover) -> None:
    """And waits where it came to while the other one works alone."""
    out = planned()
    assert out.verified
    row, alone, back = out.plan.operations
    values = row.targets.track_positions["left"]
    assert set(row.targets.track_positions) == {"left"} and np.ptp(values) > 2.5
    assert not alone.targets.track_positions and set(back.targets.track_positions) == {"left"}
    context = external_axes.with_text_stations(Context(prover.problem, prover.claims, out.programs))
    bases = [context.base_poses(index)["left"][1, 3] for index in range(3)]
    np.testing.assert_allclose(
        bases, [values[0], values[-1], back.targets.track_positions["left"][0]], atol=1e-9
    )
    motion = context.motion
    for index in range(3):
        own = np.flatnonzero(context.sample_setup == index)
        base = context.track_base_poses(index, own)["left"]
        arm = out.problem.cell.arm("left")
        found = base @ forward_kinematics(arm.data, motion.q["left"][own]) @ arm.tool.tcp
        assert np.abs(found - motion.tcp["left"][own]).max() < 1e-6
    own = np.flatnonzero(context.sample_setup == 1)
    assert (
        np.ptp(motion.track_positions["left"][own]) == 0.0
        and np.ptp(motion.q["right"][own], axis=0).max() > 0.05
    )


def _values(text: str, change: Callable[[int, float], float | str]) -> str:
    """The text with other values of the first external axis in straight moves."""
    number = iter(range(10**6))

    def replace(match: re.Match[str]) -> str:
        value = change(next(number), float(match[2]))
        return f"{match[1]}{value if isinstance(value, str) else format(value, '.4f')}{match[3]}"

    return MOVE.sub(replace, text)


def _insert_before(text: str, mark: str, put: str) -> str:
    assert mark in text, mark
    return text.replace(mark, put + mark, 1)


JUMP = "    MoveAbsJ [[0,0,0,0,0,0],[1100,9E9,9E9,9E9,9E9,9E9]]\\NoEOffs,v_entry,fine,t_ball_tool;\n"
AWAY = "    MoveAbsJ [[0,-40,0,0,30,0],[9E9,9E9,9E9,9E9,9E9,9E9]]\\NoEOffs,v_entry,fine,t_ball_tool;\n"
MUTANTS: dict[str, tuple[str, str, str, Callable[[str], str]]] = {
    "it stands beside the other one": (
        "1",
        "track_along",
        "mm; expected: ",
        lambda t: _values(t, lambda k, v: -1500.0 if k < 15 else v),
    ),
    "it goes on while the other one works alone": (
        "1",
        "external_axes",
        "TRACK_1 moves while right is not at home",
        lambda t: _insert_before(
            t.replace("to 1183.", "to 1100.").replace("1100.456", "1100.000"), "    ! meet_9:", JUMP
        ),
    ),
    "the other one leaves home while it goes to its station": (
        "2",
        "external_axes",
        "TRACK_1 moves while right is not at home",
        lambda t: _insert_before(t, "    ! meet_5:", AWAY),
    ),
}


@pytest.mark.parametrize("name", MUTANTS)
def test_programs_that_go_along_otherwise_are_refused(prover: Prover, name: str) -> None:
    task, word, said, change = MUTANTS[name]
    good = planned().programs
    own = [file for file in good if file.startswith(f"T_ROB{task}/") and file.endswith(".mod")]
    joined = "\0".join(good[file] for file in own).replace("\r\n", "\n")
    parts = [text.replace("\n", "\r\n") for text in change(joined).split("\0")]
    bad = {**good, **dict(zip(own, parts, strict=True))}
    assert bad != good
    proof = prover.prove(bad)
    assert not proof.ok
    messages = [i.message for i in proof.issues if i.code == f"verify.{word}"]
    assert any(said in message for message in messages), [str(i) for i in proof.issues]


@pytest.mark.parametrize(
    ("x", "y", "rule", "text"),
    [(1.2, 0.0, "clearance", "right/"), (0.0, 1.25, "track_way", "left/base_link and right/base_link")],
)
def test_where_the_other_arm_stands_counts_as_it_goes_along(
    prover: Prover, x: float, y: float, rule: str, text: str
) -> None:
    """Nearer, in the way of the tool; or on the rail, in that of the base."""
    cell = prover.problem.cell
    left, right = cell.arms
    base = np.array(right.base)
    base[:2, 3] = (x, y) if rule == "track_way" else (base[0, 3] - x, y)
    cell = dataclasses.replace(cell, arms=(left, dataclasses.replace(right, base=base)))
    other = Prover(dataclasses.replace(prover.problem, cell=cell), prover.claims)
    context = external_axes.with_text_stations(Context(other.problem, other.claims, planned().programs))
    context.__dict__["bases"] = {"left": left.base, "right": base}  # where the text has it besides
    if rule == "track_way":
        near = track_clearance(context).issues
        messages = [i.message for i in near if i.message.startswith("coordinated motion of TRACK_1")]
    else:
        messages = [i.message for i in clearance.bodies(context).issues]
    assert messages and all(text in message for message in messages), messages


@pytest.mark.long
def test_an_arm_beside_it_stands_where_its_own_track_takes_it(tmp_path: Path) -> None:
    """From home it reaches nothing; each is judged by itself."""
    track = {**TRACK, "unit": "TRACK_2", "home_mm": -900, "range_mm": [-1000, 1000]}
    made = problem(tmp_path, OPERATIONS[:1], right={"track": track}, count=7)
    assert not planner.check(made)


def test_two_tracks_do_not_go_along_at_once(tmp_path: Path) -> None:
    track = {"track": {**FOLLOWING, "unit": "TRACK_2"}}
    with pytest.raises(TandemError) as refused:
        problem(tmp_path, OPERATIONS[:1], right=track)
    (issue,) = refused.value.issues
    assert issue.code == "problem.track" and issue.field == "operations.0"
    assert "which is not supported for two bases yet" in issue.message
    assert problem(tmp_path, OPERATIONS[1:], right=track).cell.arm("right").has_coordinated_track
