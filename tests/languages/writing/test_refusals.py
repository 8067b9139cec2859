"""Plans that no program can carry out are refused with the issue that states the reason."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from planner.claims.segments import Segment
from planner.issues import TandemError
from planner.targets import TargetAction
from tests.languages.writing import krl_job, synthetic
from tests.languages.writing.reading import programs


def changed(plan, **fields):
    """The plan with fields of its first operation changed; those that targets have go there."""
    operation = plan.operations[0]
    inner = {k: v for k, v in fields.items() if hasattr(operation.targets, k)}
    outer = {k: v for k, v in fields.items() if k not in inner}
    targets = dataclasses.replace(operation.targets, **inner)
    return dataclasses.replace(plan, operations=(dataclasses.replace(operation, targets=targets, **outer),))


def with_tool(problem, **fields):
    arms = [dataclasses.replace(a, tool=dataclasses.replace(a.tool, **fields)) for a in problem.cell.arms]
    return dataclasses.replace(problem, cell=dataclasses.replace(problem.cell, arms=tuple(arms)))


def refused(plan, problem):
    with pytest.raises(TandemError) as caught:
        programs(plan, problem)
    assert all(issue.message and issue.hint for issue in caught.value.issues)
    return {issue.code for issue in caught.value.issues}


@pytest.fixture
def small():
    return synthetic.small()


def test_too_few_tasks(small):
    controller = dataclasses.replace(small[1].cell.controller, tasks=("T_ROB1",))
    cell = dataclasses.replace(small[1].cell, controller=controller)
    assert refused(small[0], dataclasses.replace(small[1], cell=cell)) == {"post.tasks"}


def test_two_kuka_arms_on_one_controller():
    plan, problem = synthetic.small(model="kr60_ha")
    assert refused(plan, problem) == {"post.controller"}


@pytest.mark.parametrize("time", [np.zeros(9), np.full(9, np.nan), np.arange(8.0), -np.arange(9.0)])
def test_times_that_do_not_go_on(small, time):
    assert refused(changed(small[0], time=time), small[1]) == {"post.plan"}


def test_joints_that_are_not_finite(small):
    q = {arm: np.where(np.arange(9)[:, None] == 4, np.nan, v) for arm, v in small[0].operations[0].q.items()}
    assert refused(changed(small[0], q=q), small[1]) == {"post.plan"}


@pytest.mark.parametrize("together", [("entry",), ("entry", "exit"), ("elsewhere",)])
def test_ways_at_once_that_no_program_can_go(small, together):
    way = {arm: path[: 1 + k] for k, (arm, path) in enumerate(small[0].operations[0].approach.items())}
    assert refused(changed(small[0], synchronised=together, approach=way), small[1]) == {"post.plan"}


@pytest.mark.parametrize("models", [("irb140",) * 2, ("kr10_r1100", "irb140"), ("kr10_r1100",) * 2])
def test_ways_at_once_of_two_controllers(models):
    plan, problem = krl_job.two(models)
    programs(plan, problem)
    assert refused(changed(plan, synchronised=("entry",)), problem) == {"post.plan"}
    assert refused(changed(plan, synchronised=("exit",)), problem) == {"post.plan"}


@pytest.mark.parametrize("at", [4, -1, 9])
def test_an_action_where_the_motion_does_not_stop(small, at):
    assert refused(changed(small[0], actions=(TargetAction(at, "message", text="?"),)), small[1]) == {
        "post.action"
    }


@pytest.mark.parametrize("label", ["1st", "exit", "a" * 40, "!!!"])
def test_a_label_that_gives_no_name(small, label):
    segment = (*small[0].operations[0].targets.segment[:7], Segment.of(label), Segment("unmount"))
    assert refused(changed(small[0], segment=segment), small[1]) == {"post.name"}


def test_a_long_label_that_comes_too_often():
    job = synthetic.problem(("left",))
    segment = [label for _ in range(100) for label in ("x" * 28, "link")]
    q = {"left": synthetic.sweep(len(segment) + 1)}
    operation = synthetic.operation(job, q, ["mount", *segment], actions=(), coupled=False)
    assert refused(synthetic.plan(operation), job) == {"post.name"}


def test_two_labels_with_one_name(small):
    segment = (*small[0].operations[0].targets.segment[:7], Segment("cut", "Front_"), Segment("unmount"))
    assert refused(changed(small[0], segment=segment), small[1]) == {"post.name"}


def test_a_label_with_the_name_of_another_thing(small):
    segment = (*small[0].operations[0].targets.segment[:7], Segment("w", "stock"), Segment("unmount"))
    assert refused(changed(small[0], segment=segment), small[1]) == {"post.name"}


def test_a_signal_that_gives_no_name(small):
    assert refused(changed(small[0], actions=(TargetAction(0, "on", signal="2nd"),)), small[1]) == {
        "post.name"
    }


@pytest.mark.parametrize("mass", [0.0, -1.0, float("nan")])
def test_a_tool_without_mass(small, mass):
    assert refused(small[0], with_tool(small[1], mass=mass)) == {"post.tool"}


@pytest.mark.parametrize("frame", ["held:nobody", "table"])
def test_a_frame_that_no_program_can_refer_to(small, frame):
    assert refused(changed(small[0], frame={"left": frame, "right": "stock"}), small[1]) == {"post.frame"}
