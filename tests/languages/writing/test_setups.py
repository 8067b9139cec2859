"""Programs of several setups and of a held block: questions, names, carried loads and poses."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

from planner.catalogue.robots import robot
from planner.cell.kinematics import forward_kinematics
from planner.geometry.arrays import from_quaternion
from planner.issues import TandemError
from planner.languages.rapid.reader.reader import read_task
from planner.problem import SetupChange
from tests.languages.writing import synthetic
from tests.languages.writing.reading import data, flat, modules, moves, pose, programs, targets

TASKS = ("T_ROB1", "T_ROB2")


@pytest.fixture(scope="module")
def two():
    plan, problem = synthetic.two_setups()
    return plan, problem, programs(plan, problem)


@pytest.fixture(scope="module")
def held():
    plan, problem = synthetic.held(released=True)
    return plan, problem, programs(plan, problem)


def at(lines, text):
    """Index of the one line that begins with the text."""
    found = [i for i, line in enumerate(lines) if line.startswith(text)]
    assert len(found) == 1, (text, found)
    return found[0]


def question(number):
    return f'UIMsgBox\\Header:="Tandem","Setup {number} done as instructed, nobody in the cell?"'


def tcp(setup, plan, arm, q):
    """Return the TCP in the world by the arm's own kinematics."""
    item = setup.cell.arm(arm)
    return plan.bases[arm] @ forward_kinematics(robot(item.robot), q) @ item.tool.tcp


@pytest.mark.parametrize("job", ["two", "held"])
def test_an_independent_reader_finds_nothing_to_say(job, request):
    for task in TASKS:
        assert read_task(modules(request.getfixturevalue(job)[2], task)).faults == ()


@pytest.mark.parametrize("number", [1, 2])
def test_a_setup_is_asked_for_at_home_between_two_meetings_of_all_tasks(two, number):
    _, problem, files = two
    lead, other = flat(files, "T_ROB1"), flat(files, "T_ROB2")
    asked = at(lead, question(number))
    before = max(i for i in range(asked) if lead[i].startswith("WaitSyncTask"))
    after = min(i for i in range(asked, len(lead)) if lead[i].startswith("WaitSyncTask"))
    told = " ".join(re.findall(r'TPWrite "(.*)";', "\n".join(lead[before:after])))
    assert told == " ".join(problem.setups[number - 1].steps)
    assert not any(line.startswith(("Move", "Sync", "SetDO")) for line in lead[before:after])
    assert not any(line.startswith("UIMsgBox") for line in other)
    # the other task goes from the one meeting straight to the next
    assert other[at(other, lead[before]) + 1] == lead[after]
    for lines, end in ((lead, asked), (other, at(other, lead[before]))):
        last = [line for line in lines[:end] if line.startswith("Move")][-1]
        assert last.startswith("MoveAbsJ j_home")


def test_every_arm_is_at_home_before_the_first_question_and_goes_on_from_there(two):
    lead, other = flat(two[2], "T_ROB1"), flat(two[2], "T_ROB2")
    moved = [line for line in lead[: at(lead, question(1))] if line.startswith("Move")]
    assert len(moved) == 1 and "j_home" in moved[0]
    first = next(line for line in lead[at(lead, question(1)) :] if line.startswith("Move"))
    assert "j_home" not in first
    assert sum("j_home" in line for line in other) == 2  # to home at first, and back from the second


def test_the_first_box_asks_for_no_block_that_is_yet_to_be_clamped(held):
    lead = flat(held[2], "T_ROB1")
    box = " ".join(
        re.findall(r'"([^"]*)"', " ".join(lead[: next(i for i, line in enumerate(lead) if "Move" in line)]))
    )
    assert "nobody in the cell? Press" in box and "stock in place" not in box


def test_tools_and_work_objects_are_those_of_the_setup(two):
    plan, problem, files = two
    first, second = problem.setups
    rows = moves(files, "T_ROB1")
    assert [(row[7], row[8]) for row in rows] == [("t_bow_400", "w_stock")] * 6 + [
        ("t_Holder", "w_stock_2")
    ] * 5
    assert {(row[7], row[8]) for row in moves(files, "T_ROB2")} == {("t_Holder", "w_stock_2")}
    for name, setup in (("t_bow_400", first), ("t_Holder", second)):
        np.testing.assert_allclose(
            pose(data(files, "T_ROB1", "tooldata", name)[1]), setup.cell.arm("left").tool.tcp, atol=1e-8
        )
    for name, place in (("w_stock", synthetic.STOCK), ("w_stock_2", synthetic.ROTATED_STOCK)):
        value = data(files, "T_ROB1", "wobjdata", name)
        assert value[:3] == [False, True, ""]
        np.testing.assert_allclose(pose(value[3]) @ pose(value[4]), place, atol=1e-7)
    for setup, operation, part in ((first, 0, slice(0, 6)), (second, 1, slice(6, 11))):
        work = plan.stock_poses[setup.number - 1] @ targets(rows[part])
        q = plan.operations[operation].q["left"][1:]
        np.testing.assert_allclose(work, tcp(setup, plan, "left", q), atol=2e-7)
    ways = [line for line in flat(files, "T_ROB1") if line.startswith("MoveAbsJ")]
    mounted = [re.search(r"t_\w+", line).group() for line in ways]
    assert mounted == sorted(mounted, key=["t_bow_400", "t_Holder"].index)


def test_tools_that_differ_have_names_that_differ():
    plan, problem = synthetic.two_setups()
    longer = synthetic.tool(name="bow_400_with_a_long_name", mass=2.0)
    tools = [dataclasses.replace(longer, name=f"{longer.name} {n}", mass=2.0 + n) for n in (1, 2)]
    arms = (dataclasses.replace(problem.cell.arms[0], tool=tools[0]), problem.cell.arms[1])
    changes = {**problem.changes, 1: dataclasses.replace(problem.changes[1], tools={"left": tools[1]})}
    cell = dataclasses.replace(problem.cell, arms=arms)
    files = programs(plan, dataclasses.replace(problem, cell=cell, changes=changes))
    names = [row[7] for row in moves(files, "T_ROB1")]
    assert len(set(names)) == 2
    assert [data(files, "T_ROB1", "tooldata", name)[2][0] for name in dict.fromkeys(names)] == [3.0, 4.0]


@pytest.mark.parametrize(
    ("name", "called", "second"),
    [
        ("wire_holder_across_start", "t_wire_holder_across_start", "t_wire_holder_across_sta_2"),
        (
            "spindle with a very long shank and more",
            "t_spindle_with_a_very_long",
            "t_spindle_with_a_very_lo_2",
        ),
    ],
)
def test_names_of_tools_are_as_long_as_rapid_takes(name, called, second):
    """RAPID identifiers have at most 32 characters. Two tools of one name get different identifiers."""
    plan, problem = synthetic.two_setups()
    tools = [synthetic.tool(name=name, mass=2.0 + n) for n in (1, 2)]
    arms = (dataclasses.replace(problem.cell.arms[0], tool=tools[0]), problem.cell.arms[1])
    changes = {**problem.changes, 1: dataclasses.replace(problem.changes[1], tools={"left": tools[1]})}
    cell = dataclasses.replace(problem.cell, arms=arms)
    files = programs(plan, dataclasses.replace(problem, cell=cell, changes=changes))
    assert {row[7] for row in moves(files, "T_ROB1")} == {called, second}
    assert all(len(word) <= 32 for text in files.values() for word in re.findall(r"\bt_\w+", text))


def test_a_tool_that_stays_has_one_name(two):
    text = "\n".join(modules(two[2], "T_ROB2").values())
    assert len(re.findall("PERS tooldata", text)) == 1


def test_work_on_a_held_block_follows_the_other_arms_flange(held):
    plan, problem, files = held
    setup, operation = problem.setups[0], plan.operations[0]
    rows = [row for row in moves(files, "T_ROB1") if row[3]]
    assert {row[8] for row in rows} == {"w_held"}
    work = data(files, "T_ROB1", "wobjdata", "w_held")
    assert work[:3] == [False, False, "ROB_2"]
    flange = plan.bases["right"] @ forward_kinematics(robot("irb140"), operation.q["right"][1:])
    reached = flange @ pose(work[3]) @ pose(work[4]) @ targets(rows)
    np.testing.assert_allclose(reached, tcp(setup, plan, "left", operation.q["left"][1:]), atol=5e-7)


def test_the_holders_own_moves_are_in_the_world(held):
    plan, problem, files = held
    rows = moves(files, "T_ROB2")
    assert {row[8] for row in rows} == {"wobj0"}
    expected = tcp(problem.setups[0], plan, "right", plan.operations[0].q["right"][1:])
    np.testing.assert_allclose(targets(rows), expected, atol=2e-7)
    assert "wobjdata" not in files["T_ROB2/TandemData_2.mod"]


def test_both_move_in_pairs_that_stop_and_end_together(held):
    left, right = ([row for row in moves(held[2], task) if row[3]] for task in TASKS)
    assert len(left) == len(right) == 7
    for one, other in zip(left, right, strict=True):
        assert one[3] == other[3] and one[5] == other[5]
        assert (one[6] == "fine") == (other[6] == "fine")


def test_the_holders_controller_knows_the_load_until_it_is_let_go(held):
    files = held[2]
    lines = flat(files, "T_ROB2")
    loads = [line for line in lines if line.startswith("GripLoad")]
    assert loads == ["GripLoad load_block;", "GripLoad load0;"]
    assert not any("GripLoad" in line for line in flat(files, "T_ROB1"))
    ways = [i for i, line in enumerate(lines) if line.startswith("Move")]
    # after the first way home and before anything else moves; let go after the last move of the setup
    assert ways[0] < lines.index("GripLoad load_block;") < ways[1]
    assert lines.index("GripLoad load0;") > ways[-1]
    lead = flat(files, "T_ROB1")
    for number, load in ((1, "GripLoad load_block;"), (2, "GripLoad load0;")):
        asked = at(lead, question(number))
        met = next(line for line in lead[asked:] if line.startswith("WaitSyncTask"))
        assert lines[lines.index(met) + 1] == load


def test_the_load_is_the_blocks_in_the_tools_frame(held):
    """Mass and centre are the claim's; the moments are those of a solid box, about its own axes."""
    value = data(held[2], "T_ROB2", "loaddata", "load_block")
    assert value[0] == 0.9 and value[1] == [20.0, -10.0, 125.0]
    np.testing.assert_allclose(from_quaternion(np.array(value[2])), synthetic.GRIP[:3, :3], atol=1e-7)
    x, y, z = 0.3, 0.2, 0.25
    expected = 0.9 / 12 * np.array([y * y + z * z, x * x + z * z, x * x + y * y])
    np.testing.assert_allclose(value[3:], expected, atol=1e-6)


def test_a_block_that_two_setups_hold_has_a_load_in_each():
    plan, problem = synthetic.held()
    work = (*problem.operations, dataclasses.replace(problem.operations[0], name="again"))
    changes = {**problem.changes, 1: SetupChange(stock={"oversize": np.zeros((2, 3))}, steps=("Turn it.",))}
    problem = dataclasses.replace(problem, operations=work, changes=changes)
    operation = plan.operations[0]
    segment = tuple(dataclasses.replace(own, name=own.name and "other") for own in operation.targets.segment)
    again = dataclasses.replace(
        operation, name="again", targets=dataclasses.replace(operation.targets, segment=segment)
    )
    plan = dataclasses.replace(plan, operations=(operation, again), stock_poses=plan.stock_poses * 2)
    files = programs(plan, problem)
    lines = [line for line in flat(files, "T_ROB2") if line.startswith("GripLoad")]
    assert lines == ["GripLoad load_block;", "GripLoad load_block_2;"]
    assert {row[8] for row in moves(files, "T_ROB1")} == {"w_held", "w_held_2"}


def test_a_held_block_of_unknown_weight_is_refused():
    plan, problem = synthetic.held()
    operation = plan.operations[0]
    bare = dataclasses.replace(operation, targets=dataclasses.replace(operation.targets, claims=()))
    with pytest.raises(TandemError) as caught:
        programs(dataclasses.replace(plan, operations=(bare,)), problem)
    assert [issue.code for issue in caught.value.issues] == ["post.load"]
    assert caught.value.issues[0].hint


@pytest.mark.parametrize("pose_count", [1, 0])
def test_a_plan_of_fewer_setups_than_the_problem_has_is_refused(two, pose_count):
    plan, problem, _ = two
    with pytest.raises(TandemError) as caught:
        programs(dataclasses.replace(plan, stock_poses=plan.stock_poses[:pose_count]), problem)
    assert [issue.code for issue in caught.value.issues] == ["post.plan"]


def test_messages_fit_the_panel():
    """A box has five lines of 55 characters and a header of 46; a line of the panel has 40."""
    plan, problem = synthetic.two_setups()
    note = "Put spacers of the kerf under the block before the last cut, or it drops; see the sheet. " * 2
    steps = (*problem.changes[1].steps, note)
    changes = {**problem.changes, 1: dataclasses.replace(problem.changes[1], steps=steps)}
    files = programs(plan, dataclasses.replace(problem, changes=changes))
    text = "\n".join(modules(files, "T_ROB1").values())
    for box in re.findall(r"UIMsgBox.*?;", text, re.DOTALL):
        header, *lines = re.findall(r'"((?:[^"]|"")*)"', box)
        assert len(header) <= 46 and 1 <= len(lines) <= 5
        assert max(len(line) for line in lines) <= 55
    told = [line for line in flat(files, "T_ROB1") if line.startswith("TPWrite")]
    assert max(len(line) for line in re.findall(r'TPWrite "(.*?)";', "\n".join(told))) <= 40
    assert "spacers" in text
