"""URScript as it is written: bases, speeds, blends, and what no program can say."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from planner.catalogue.robots import robot
from planner.geometry.arrays import from_rpy
from planner.issues import TandemError
from planner.languages.urscript.writer import program, syntax
from planner.languages.writing import write
from planner.languages.writing.layout import MoveTable
from planner.problem import Arm
from planner.reading.controller import controller_faults
from tests import urdf_text
from tests.languages.urscript import ur_job
from tests.processes.hotwire.proof import straight_job


def arm(data):
    return dataclasses.replace(straight_job.cell(0, "ur10e").arms[0], custom_data=data)


def refused(problem, plan=None):
    with pytest.raises(TandemError) as caught:
        write.program_files(straight_job.plan(12, model="ur10e") if plan is None else plan, problem)
    return [(issue.code, issue.message) for issue in caught.value.issues]


def with_cell(problem, **changes):
    return dataclasses.replace(problem, cell=dataclasses.replace(problem.cell, **changes))


@pytest.mark.parametrize("degrees", [0.0, 180.0, -90.0, 37.5])
def test_the_controllers_base_is_that_of_the_makers_table(degrees):
    turn = from_rpy([0.0, 0.0, 0.0], [0.0, 0.0, np.deg2rad(degrees)])
    base = program.controller_base(arm(urdf_text.ur10e_data(turn)))
    np.testing.assert_allclose(base, np.linalg.inv(turn), atol=1e-9)


def test_an_arm_that_a_ur_controller_does_not_move_is_refused():
    """Its axes are others, or count otherwise, or its tip is another flange; of UR's own file it is none."""
    own = urdf_text.ur10e_data()
    turned = dataclasses.replace(own.form, signs=np.array([1.0, 1.0, -1.0, 1.0, 1.0, 1.0]))
    offset = dataclasses.replace(
        own.form, offsets=own.form.offsets + np.deg2rad([0.0, 90.0, 0.0, 0.0, 0.0, 0.0])
    )
    tip = dataclasses.replace(own.form, right=from_rpy([0.0, 0.0, 0.1], [0.0, 0.0, 0.0]))
    for form, what in (
        (turned, "directions differ"),
        (offset, "joint zeros"),
        (tip, "its tip"),
        (robot("irb140").form, "not parallel"),
    ):
        problem = ur_job.problem()
        wrong = with_cell(problem, arms=(arm(dataclasses.replace(own, form=form)),))
        targets = [operation.targets for operation in straight_job.plan(12, model="ur10e").operations]
        (issue,) = write.refusals(wrong, targets)
        assert issue.code == "post.ur_arm" and what in issue.message and "UR's own URDF" in issue.hint
        assert write.refusals(problem, targets) == ()


def test_two_arms_are_refused_and_numbers_are_asked_for():
    problem = ur_job.problem()
    other = Arm("right", "irb140", np.eye(4), straight_job.BOWS[0], np.zeros(6))
    both = with_cell(problem, arms=(*problem.cell.arms, other))
    plan = straight_job.plan(12, model="ur10e")
    targets = [
        dataclasses.replace(operation.targets, arms=("left", "right")) for operation in plan.operations
    ]
    (issue,) = write.controller_refusals(both, targets)
    assert issue.code == "post.controller" and "arms of KUKA and UR have one each" in issue.message
    controller = dataclasses.replace(problem.cell.controller, io={})
    found = refused(with_cell(problem, controller=controller))
    assert [code for code, _ in found] == ["post.signal"] and "URScript addresses by number only" in found[0][
        1
    ]


def test_an_arm_that_would_hold_the_block_is_refused_before_anything_is_planned():
    problem = ur_job.problem()
    targets = [operation.targets for operation in straight_job.plan(12, model="ur10e").operations]
    held = dataclasses.replace(problem, stock=dataclasses.replace(problem.stock, held_by="left"))
    found = write.refusals(held, targets)
    assert [(issue.code, issue.arm) for issue in found] == [("post.load", "left")]
    assert "URScript is written only for tools" in found[0].message


@pytest.mark.parametrize(("number", "fits"), [(0, True), (15, True), (16, False)])
def test_numbers_are_those_of_digital_outputs(number, fits):
    problem = ur_job.problem()
    controller = dataclasses.replace(problem.cell.controller, io={"left": {"doWirePower": number}})
    found = [
        issue
        for issue in controller_faults(dataclasses.replace(problem.cell, controller=controller), ())
        if issue.field
    ]
    assert [issue.code for issue in found] == ([] if fits else ["problem.field"])
    if fits:
        (text,) = write.program_files(
            straight_job.plan(12, model="ur10e"), with_cell(problem, controller=controller)
        ).values()
        word = "set_standard_digital_out(0,True)" if number == 0 else "set_configurable_digital_out(7,True)"
        assert text.count(word) == 2


def test_a_tool_without_mass_and_a_program_too_long_are_refused():
    problem = ur_job.problem()
    plan = straight_job.plan(12, model="ur10e")
    controller = dataclasses.replace(problem.cell.controller, max_moves=20)
    ((code, message),) = refused(with_cell(problem, controller=controller))
    assert code == "post.no_split" and "because it is one program" in message
    light = dataclasses.replace(straight_job.BOWS[0], mass=0.0)
    arms = (dataclasses.replace(problem.cell.arms[0], tool=light),)
    bare = dataclasses.replace(with_cell(problem, arms=arms), changes={})
    assert refused(bare, dataclasses.replace(plan, operations=plan.operations[:1]))[0][0] == "post.tool"


def track(position, reach):
    count = len(position)
    distance = np.linalg.norm(np.diff(position, axis=0, prepend=position[:1] - [[10.0, 0.0, 0.0]]), axis=1)
    turn = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    flat = np.zeros(count)
    return MoveTable(position, turn, np.zeros((count, 6)), np.ones(count), distance, reach, flat, "stock")


def test_blends_keep_to_their_room_and_never_meet():
    position = np.array(
        [[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [4.0, 9.0, 0.0], [4.0, 10.0, 0.0], [14.0, 10.0, 0.0]]
    )
    own = track(position, np.array([5.0, 5.0, 0.0123, 5.0, 0.0]))
    stop = np.array([False, False, False, False, True])
    radius = syntax.blends(own, stop)
    np.testing.assert_allclose(radius, [1.8e-3, 1.8e-3, 1.2e-5, 0.45e-3, 0.0], atol=1e-12)
    assert (radius[:-1] + radius[1:] < 1e-3 * own.distance[1:]).all()


def test_a_turn_about_the_tcp_is_no_blend_and_a_stop_there_helps():
    position = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [5.0, 0.0, 0.0]])
    own = track(position, np.array([0.0, 0.0, 0.0]))
    assert np.isnan(syntax.blends(own, np.array([False, False, True]))).tolist() == [True, True, False]
    assert syntax.blends(own, np.array([True, True, True])).tolist() == [0.0, 0.0, 0.0]
    plan = straight_job.plan(12, model="ur10e")
    first = plan.operations[0]
    pose = first.targets.pose["left"].copy()
    pose[6:, :3, 3] += pose[5, :3, 3] - pose[6, :3, 3]  # between targets 5 and 6 the tool turns alone
    turned = dataclasses.replace(first, targets=dataclasses.replace(first.targets, pose={"left": pose}))
    fed = dataclasses.replace(turned.targets, feed_min=np.full(first.targets.count, 0.003))
    least = dataclasses.replace(turned, targets=fed)
    ((code, message),) = refused(
        ur_job.problem(), dataclasses.replace(plan, operations=(least, *plan.operations[1:]))
    )
    assert code == "post.blend" and "rotates about its TCP" in message
    (text,) = write.program_files(
        dataclasses.replace(plan, operations=(turned, *plan.operations[1:])), ur_job.problem()
    ).values()
    rows = [row for row in text.splitlines() if row.startswith("movel")]
    assert [row.endswith("r=0.0)") for row in rows[3:7]] == [
        False,
        True,
        True,
        False,
    ]  # where no least feed is
    stop = first.targets.stop.copy()
    stop[[4, 5, 6]] = True
    stopped = dataclasses.replace(turned, targets=dataclasses.replace(turned.targets, stop=stop))
    plan = dataclasses.replace(plan, operations=(stopped, *plan.operations[1:]))
    assert len(write.program_files(plan, ur_job.problem())) == 1


def test_a_move_by_joints_keeps_to_the_tools_speed_and_the_axes_share():
    data = urdf_text.ur10e_data()
    start, tcp = np.deg2rad([0.0, -90.0, 90.0, -90.0, -90.0, 0.0]), from_rpy([0.0, 0.0, 0.2], [0.0, 0.0, 0.0])
    end = start + np.deg2rad([60.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    speed = program.joint_speed(data, start, end, tcp, 0.25, 0.8)
    reach = np.linalg.norm((urdf_text.ur10e_flange(start[None])[0] @ tcp)[:2, 3])
    assert 0.97 * 0.25 < speed * reach <= 0.25
    spin = start + np.deg2rad([0.0, 0.0, 0.0, 0.0, 0.0, 60.0])
    assert program.joint_speed(data, start, spin, tcp, 0.25, 0.8) == pytest.approx(
        0.8 * np.deg2rad(120.0), abs=1e-4
    )


@pytest.mark.parametrize("text", ['a "quote"', "back\\slash", "x" * 256])
def test_what_no_popup_can_show_is_refused(text):
    with pytest.raises(TandemError) as caught:
        syntax.question(text)
    assert caught.value.issues[0].code == "post.name"


def test_names_are_words_of_no_language():
    assert syntax.identifier("Bow 650, short") == "bow_650_short"
    for text in ("movel", "7th", "***"):
        with pytest.raises(TandemError):
            syntax.identifier(text)
