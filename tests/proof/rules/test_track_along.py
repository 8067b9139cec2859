"""Coordinated tracks: base poses by the text, and faults in values."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import planner
from planner.cell import clearance as cell_clearance
from planner.cell.kinematics import forward_kinematics
from planner.motion.planning_scene import Scene
from planner.problem import END_SUFFIX, Obstacle
from planner.processes import registry
from planner.proof.clearance import samples
from planner.proof.context import Context
from planner.proof.models import MODELS
from planner.proof.prove import Prover
from planner.proof.rules import clearance, external_axes
from planner.proof.rules.track_clearance import track_clearance
from planner.reading.cell import ObstacleFile, build_shape
from tests import following_job
from tests.proof.provers import prover_of

MOVE = re.compile(r"(MoveL .*?\],\[)(-?[0-9.]+|9E9)((?:,[^\]]*)?\]\])")
"""A straight move with the value of the track."""


@pytest.fixture(scope="module")
def prover() -> Prover:
    return prover_of(following_job.planned_job())


@pytest.fixture(scope="module")
def context(prover: Prover) -> Context:
    return external_axes.with_text_stations(
        Context(prover.problem, prover.claims, following_job.planned_job().programs)
    )


def test_a_row_longer_than_the_arm_reaches_is_one_proven_operation() -> None:
    out = following_job.planned_job()
    assert out.verified
    made, _ = out.plan.operations
    values = made.targets.track_positions["left"]
    assert np.ptp(values) > 2.5 and values.min() >= -1.5 and values.max() <= 1.5
    place = made.targets.pose["left"][:, 1, 3]
    expected = np.clip(place + float(np.median((values - place)[np.abs(values) < 1.4])), -1.5, 1.5)
    assert np.abs(values - expected).max() < 0.035  # what is smoothed
    speed = np.abs(np.diff(values) / np.diff(made.time))
    assert 0.15 < speed.max() < 1.0


def test_bases_at_targets_and_between_them_follow_from_the_text(context: Context) -> None:
    """The poses in the text are those of its joints from a base that its track value moves.

    The reference is the planner's forward kinematics, which the replay does not use.
    """
    out, motion = following_job.planned_job(), context.motion
    arm = out.problem.cell.arms[0]
    of_node = context.spans.of_stage[motion.node_stage]
    for index, made in enumerate(out.plan.operations):
        own = np.flatnonzero(context.sample_setup == index)
        base = context.track_base_poses(index, own)["left"]
        found = base @ forward_kinematics(arm.data, motion.q["left"][own]) @ arm.tool.tcp
        assert np.abs(found - motion.tcp["left"][own]).max() < 1e-6
        values = context.stations[index]["left"] + motion.track_positions["left"][motion.node_sample]
        straight = np.array([str(one) == "move" for one in motion.node_segment]) & (of_node == index)
        # within what zones cut off corners, and what the tool does from sample to sample
        assert np.abs(values[straight] - made.targets.track_positions["left"][1:]).max() < 6e-3
        ends = made.targets.track_positions["left"][[0, -1]]
        station, end = (context.stations[index][name] for name in ("left", f"left{END_SUFFIX}"))
        np.testing.assert_allclose([station, end], ends, atol=1e-9)
    assert np.abs(motion.tcp["left"].position[:, 1]).max() > 1.7


def test_a_straight_tool_has_its_track_turn_within_the_zones(tmp_path: Path) -> None:
    """Few targets, far apart: outside of zones the track goes as the lines from value to value have it, and
    what that asks of it at corners the plan has slowed down for."""
    out = planner.plan(following_job.problem(tmp_path, count=5, sway=0.0))
    assert out.verified, [str(issue) for issue in out.issues]
    context = external_axes.with_text_stations(
        Context(out.problem, registry.claims(out.problem), out.programs)
    )
    operation_plan, motion = out.plan.operations[0], context.motion
    rows = np.flatnonzero(context.sample_setup == 0)
    straight = np.array([str(segment) == "move" for segment in motion.node_segment])[motion.node[rows]]
    rows = rows[straight]
    place, value = motion.tcp["left"][rows][:, 1, 3], motion.track_positions["left"][rows]
    nodes = operation_plan.targets.pose["left"][:, 1, 3]
    outside = np.abs(place[:, None] - nodes).min(axis=1) > 0.011
    expected = (
        np.interp(place, nodes, operation_plan.targets.track_positions["left"]) - context.stations[0]["left"]
    )
    assert (
        outside.sum() > 1000
        and np.abs(np.diff(operation_plan.targets.track_positions["left"], 2)).max() > 0.2
    )
    assert np.abs(value - expected)[outside].max() < 1e-5
    assert np.abs(value - expected).max() < 3e-3


def moved(text: str, change: Callable[[int, float], float | str]) -> str:
    """The text with other values of the track in straight moves: by their number and the value that is there
    [mm]."""
    number = iter(range(10**6))

    def replace(match: re.Match[str]) -> str:
        value = change(next(number), float(match[2]))
        return f"{match[1]}{value if isinstance(value, str) else format(value, '.4f')}{match[3]}"

    return MOVE.sub(replace, text)


def lettered(text: str, number: int) -> str:
    """The text with the value of one straight move as that of the second axis."""
    seen = iter(range(10**6))

    def replace(match: re.Match[str]) -> str:
        if next(seen) != number:
            return match[0]
        return f"{match[1]}9E9,{match[2]},9E9,9E9,9E9,9E9]]"

    return MOVE.sub(replace, text)


START = -1500.0
"""The value before the first target [mm]."""

MUTANTS: dict[str, tuple[str, str, Callable[[str], str]]] = {
    "one target off": (
        "track_along",
        "TRACK_1 would need the acceleration",
        lambda t: moved(t, lambda k, v: v + 30.0 * (k == 30)),
    ),
    "one target far off": (
        "track_along",
        "mm; expected: ",
        lambda t: moved(t, lambda k, v: v + 80.0 * (k == 30)),
    ),
    "it stands": (
        "track_along",
        "TRACK_1 stays at -600 mm; expected:",
        lambda t: moved(t, lambda k, v: START).replace("-1500.0", "-600.0"),
    ),
    "it stands where it began": (
        "track_along",
        "TRACK_1 is at -1500 mm; expected:",
        lambda t: moved(t, lambda k, v: START if k < 45 else v),
    ),
    "it jumps": (
        "track_along",
        "mm; expected: ",
        lambda t: moved(t, lambda k, v: min(v + 500.0, 1500.0) if 30 <= k < 60 else v),
    ),
    "it shakes": (
        "track_along",
        "TRACK_1 would need the acceleration",
        lambda t: moved(t, lambda k, v: v + 12.0 * (k % 2) * (v < 1350.0)),
    ),
    "it goes half as far": (
        "track_along",
        "as it follows 1 of the tool's path",
        lambda t: moved(t, lambda k, v: 0.5 * (v + START)),
    ),
    "it goes back": ("track_along", "mm; expected: ", lambda t: moved(t, lambda k, v: -v)),
    "beyond its range": (
        "external_axes",
        "its range is -1500 mm to 1500 mm",
        lambda t: moved(t, lambda k, v: v + 200.0),
    ),
    "another letter": (
        "external_axes",
        "the target has values for axes other than TRACK_1",
        lambda t: lettered(t, 20),
    ),
    "no value": (
        "external_axes",
        "the target has no value of TRACK_1 (eax_a)",
        lambda t: moved(t, lambda k, v: "9E9" if k == 20 else v),
    ),
    "no value behind the work": (
        "external_axes",
        "the target has no value of TRACK_1 (eax_a)",
        lambda t: re.sub(r"(j_1_exit_1:=\[\[[^\]]*\],\[)[^,]*,", r"\g<1>9E9,", t),
    ),
    "the track turns long before the tool": (
        "zone_size",
        "the track leaves its path 30 mm before the target, the tool 3 mm",
        lambda t: t.replace("z3mm:=[FALSE,3,3,3,", "z3mm:=[FALSE,3,3,30,"),
    ),
    "another value on the way out": (
        "external_axes",
        "TRACK_1 moves while left is not at home",
        lambda t: re.sub(r"(j_1_exit_1:=\[\[[^\]]*\],\[)[^,]*,", r"\g<1>900.0000,", t),
    ),
    "another value at the start": (
        "external_axes",
        "TRACK_1 moves while left is not at home",
        lambda t: re.sub(r"(j_1_start:=\[\[[^\]]*\],\[)[^,]*,", r"\g<1>-1400.0000,", t),
    ),
    "not told that it goes along": (
        "setup",
        "is confirmed without",
        lambda t: re.sub(r'\n *TPWrite "[^"\n]*along[^"\n]*";', "", t, count=1),
    ),
    "not home at the end": (
        "external_axes",
        "the program ends with TRACK_1 at",
        lambda t: (lambda at: t[:at] + t[t.index("\n", at) + 1 :])(t.rindex("    MoveAbsJ j_home")),
    ),
}


@pytest.mark.sampled(every=3)
@pytest.mark.parametrize("name", MUTANTS)
def test_a_track_that_goes_along_otherwise_is_refused(prover: Prover, name: str) -> None:
    word, said, change = MUTANTS[name]
    good = following_job.planned_job().programs
    joined = "\0".join(good.values()).replace("\r\n", "\n")
    bad = dict(zip(good, change(joined).split("\0"), strict=True))
    bad = {file: text.replace("\n", "\r\n") for file, text in bad.items()}
    assert bad != good
    proof = prover.prove(bad)
    assert not proof.ok
    messages = [i.message for i in proof.issues if i.code == f"verify.{word}"]
    assert any(said in message for message in messages), [str(i) for i in proof.issues]


def test_a_slower_or_weaker_track_is_too_slow_for_the_same_text(prover: Prover) -> None:
    for change, said in (
        ({"speed": 0.1}, "TRACK_1 would need the speed"),
        ({"acceleration": 0.1}, "TRACK_1 would need the acceleration"),
    ):
        (message, *_) = _messages(_on(prover, track=change), "verify.track_along")
        assert said in message


def test_a_track_that_is_to_stand_may_not_go_along(prover: Prover) -> None:
    found = _messages(_on(prover, track={"follow_fraction": None}), "verify.external_axes")
    assert any("TRACK_1 moves while left is not at home" in message for message in found)


STOP = {"kind": "box", "size_mm": [100, 50, 60], "pose": {"xyz_mm": [0, 600, 30]}}
GATE = {"kind": "box", "size_mm": [60, 60, 60], "pose": {"xyz_mm": [420, 300, 650]}}
"""A body next to the path of the working forearm, and of nothing else."""


def test_what_the_base_and_the_arm_pass_as_they_go_along_is_looked_at(prover: Prover) -> None:
    assert not _messages(_on(prover), "verify.track_way", "verify.clearance")
    other = _on(prover, obstacle=STOP)
    programs = following_job.planned_job().programs
    context = external_axes.with_text_stations(Context(other.problem, other.claims, programs))
    near = track_clearance(context).issues
    own = [issue.message for issue in near if issue.message.startswith("coordinated motion of TRACK_1")]
    assert own and all("left/base_link and post" in message for message in own)
    hit = _messages(_on(prover, obstacle=GATE), "verify.clearance")
    assert any("left/" in message for message in hit)


def _on(
    prover: Prover, track: dict[str, Any] | None = None, obstacle: dict[str, Any] | None = None
) -> Prover:
    """Return a prover of the same problem with another track, or with a body in its path."""
    problem, cell = prover.problem, prover.problem.cell
    arm = cell.arms[0]
    assert arm.track is not None
    arm = dataclasses.replace(arm, linear_axes=(dataclasses.replace(arm.track, **(track or {})),))
    bodies = cell.obstacles
    if obstacle is not None:
        made = ObstacleFile.model_validate({"name": "post", "shapes": [obstacle]})
        bodies = (Obstacle("post", tuple(build_shape(one, problem.path.parent) for one in made.shapes)),)
    cell = dataclasses.replace(cell, arms=(arm,), obstacles=bodies)
    return Prover(dataclasses.replace(problem, cell=cell), prover.claims)


def _messages(prover: Prover, *codes: str) -> list[str]:
    found = prover.prove(following_job.planned_job().programs).issues
    return [issue.message for issue in found if issue.code in codes]


def test_of_many_looks_those_in_doubt_have_the_base_where_it_is(
    context: Context, prover: Prover, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A long motion is measured at some looks first; by what all looks at once give."""
    models = context.get(MODELS)
    some = [look for look in clearance.clearance_queries(context) if not look.itself and look.index == 0]
    (whole,) = clearance.measure_queries(models, some, prover.problem.settings)
    monkeypatch.setattr(samples, "MAX_FULLY_MEASURED", 40)
    monkeypatch.setattr(clearance, "MIN_QUERY_RANGE_M", 0.4)
    (part,) = clearance.measure_queries(models, some, prover.problem.settings)
    assert whole is not None and part is not None and 10 <= len(part.rows) < len(whole.rows)
    model = models(0).with_bases(some[0].bases)
    for look, distance in zip(part.rows.tolist(), part.min_clearance.distance, strict=True):
        q = {arm: rows[look : look + 1] for arm, rows in some[0].q.items()}
        ignore = some[0].ignore | clearance.excluded_pairs(model, False)
        alone = cell_clearance.min_clearance(model.at_rows(look), q, 0.4, ignore)
        assert distance == pytest.approx(float(alone.distance[0]), abs=1e-6)


def test_a_planner_that_leaves_bodies_at_the_station_is_not_believed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The post is where the tool passes as the base goes along."""
    post = {**GATE, "pose": {"xyz_mm": [430, 300, 610]}}
    made = following_job.problem(tmp_path, obstacles=[{"name": "post", "shapes": [post]}])
    monkeypatch.setattr(Scene, "model_at", lambda scene, *_: scene.model)
    outcome = planner.plan(made)
    assert not outcome.verified
    assert {issue.code for issue in outcome.proof.issues} == {"verify.clearance"}
