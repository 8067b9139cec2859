"""Seeded faults in trajectory files, by kind.

All except those of the seal itself are sealed again, as a deliberate attacker would do.
"""

from __future__ import annotations

import numpy as np

from planner.catalogue.robots import robot
from planner.cell.kinematics import forward_kinematics
from planner.geometry.arrays import inverse
from planner.languages.trajectories.writer.straight_segments import TrajectoryArm, solve_joints
from tests.languages.trajectories.driven_job import rows_of, sealed, written
from tests.proof import held_job
from tests.proof.registry import Table, into, pick

MUTATORS: Table = {}
"""Of either job."""
BENT: Table = {}
"""Of two arms alone."""
HELD: Table = {}
"""Of an arm that holds the block."""
mutator = into(MUTATORS)
of_two = into(BENT)
of_held = into(HELD)


def where(rows, key, **values):
    """Indices of the rows of a kind, with these values."""
    return [i for i, row in enumerate(rows) if key in row and all(row[k] == v for k, v in values.items())]


def work(rows):
    """Indices of the points within work that are neither the first nor the last of a move."""
    out, inside = [], False
    for i, row in enumerate(rows):
        inside = ("segment" in row) or (inside and "t" in row)
        if inside and "t" in row and "t" in rows[i - 1] and i + 1 < len(rows) and "t" in rows[i + 1]:
            out.append(i)
    return out


def changed(programs, i, **values):
    """The file with these values in row i."""
    rows = rows_of(programs)
    rows[i] = {**rows[i], **values}
    return sealed(programs, rows)


def cuts(rows):
    """Points of work in cuts, without their ways in and out."""
    label, out = "", []
    good = set(work(rows))
    for i, row in enumerate(rows):
        label = row.get("segment", label)
        if i in good and label.startswith("cut/") and not label.endswith(("_in", "_out")):
            out.append(i)
    return out


@mutator("verify.syntax")
def a_byte_changed_and_not_sealed(rng, programs):
    ((name, text),) = programs.items()
    return {name: text.replace('"goal_time":2.000', '"goal_time":1.999', 1)}


@mutator("verify.syntax")
def cut_off_behind_a_row(rng, programs):
    ((name, text),) = programs.items()
    lines = text.split("\r\n")
    return {name: "\r\n".join(lines[: int(rng.integers(5, len(lines) - 3))]) + "\r\n"}


@mutator("verify.syntax")
def a_row_left_out_and_the_count_as_it_was(rng, programs):
    ((name, text),) = programs.items()
    lines = text.split("\r\n")
    del lines[pick(rng, work(rows_of(programs)))]
    return {name: "\r\n".join(lines)}


@mutator("verify.syntax")
def a_key_that_is_not_known(rng, programs):
    rows = rows_of(programs)
    i = pick(rng, where(rows, "move"))
    return sealed(programs, [*rows[:i], {**rows[i], "speed": 2.0}, *rows[i + 1 :]])


@mutator("verify.syntax")
def a_kind_of_row_that_is_not_known(rng, programs):
    rows = rows_of(programs)
    return sealed(programs, [*rows[:5], {"loop": 3}, *rows[5:]])


@mutator("verify.names")
def a_key_twice(rng, programs):
    rows = [written(row) for row in rows_of(programs)]
    i = pick(rng, where(rows_of(programs), "dwell"))
    rows[i] = rows[i].replace("{", '{"dwell":0.001,', 1)
    return sealed(programs, rows)


@mutator("verify.decimals")
def no_number(rng, programs):
    rows = [written(row) for row in rows_of(programs)]
    i = pick(rng, work(rows_of(programs)))
    rows[i] = rows[i].replace('"v":[', f'"v":[{pick(rng, ["NaN", "Infinity", "-Infinity", "1e-3"])},', 1)
    return sealed(programs, rows)


@mutator("verify.syntax")
def times_that_do_not_ascend(rng, programs):
    rows = rows_of(programs)
    i = pick(rng, work(rows))
    return changed(programs, i, t=rows[i - 1]["t"] - float(rng.uniform(0.0, 0.01)))


@mutator("verify.syntax")
def joints_in_another_order(rng, programs):
    rows = rows_of(programs)
    joints = list(rows[1]["joints"])
    i, j = rng.choice(len(joints), 2, replace=False)
    joints[i], joints[j] = joints[j], joints[i]
    return changed(programs, 1, joints=joints)


@mutator("verify.syntax")
def a_joint_of_another_name(rng, programs):
    rows = rows_of(programs)
    return changed(programs, 1, joints=[*rows[1]["joints"][:-1], "elbow"])


@mutator("verify.syntax")
def no_velocities(rng, programs):
    rows = rows_of(programs)
    i = pick(rng, work(rows))
    rows[i] = {"t": rows[i]["t"], "q": rows[i]["q"]}
    return sealed(programs, rows)


@mutator("verify.syntax")
def an_end_that_is_no_rest(rng, programs):
    rows = rows_of(programs)
    i = pick(rng, [i for i in where(rows, "t")[:-1] if not {"t", "segment"} & rows[i + 1].keys()])
    v = list(rows[i]["v"])
    v[int(rng.integers(len(v)))] = 0.05
    return changed(programs, i, v=v)


@mutator("verify.declarations")
def a_joint_too_many(rng, programs):
    rows = rows_of(programs)
    i = pick(rng, work(rows))
    return changed(programs, i, q=[*rows[i]["q"], 0.0])


@mutator("verify.start_posture")
def a_move_that_nothing_looks_before(rng, programs):
    rows = rows_of(programs)
    i = pick(rng, where(rows, "at")[1:])
    return sealed(programs, [*rows[:i], *rows[i + 1 :]])


@mutator("verify.start_posture")
def a_look_elsewhere(rng, programs):
    rows = rows_of(programs)
    i = pick(rng, where(rows, "at"))
    at = list(rows[i]["at"])
    at[int(rng.integers(len(at)))] += 0.01
    return changed(programs, i, at=at)


@mutator("verify.start_posture")
def a_look_that_lets_all_pass(rng, programs):
    return changed(
        programs, pick(rng, where(rows_of(programs), "at")), within=float(pick(rng, [3.2, 0.0, -1.0]))
    )


@mutator("verify.start_posture")
def a_start_that_is_not_home(rng, programs):
    rows = rows_of(programs)
    i = where(rows, "at")[0]
    at = list(rows[i]["at"])
    at[0] += 0.3
    return changed(programs, i, at=at)


@mutator("verify.start_posture")
def a_first_point_that_comes_at_once(rng, programs):
    """A controller that begins where the arm is would have to jump."""
    rows = rows_of(programs)
    i = pick(rng, where(rows, "move")) + 1
    return changed(programs, i, t=float(rng.uniform(0.02, 0.7)) * rows[i]["t"])


@mutator("verify.start_posture")
def a_first_point_elsewhere(rng, programs):
    rows = rows_of(programs)
    i = pick(rng, where(rows, "move", move=rows[where(rows, "segment")[0] - 2]["move"])) + 1
    q = list(rows[i]["q"])
    q[0] += 1e-6
    return changed(programs, i, q=q)


@mutator("verify.syntax")
def no_first_point(rng, programs):
    rows = rows_of(programs)
    del rows[pick(rng, where(rows, "move")) + 1]
    return sealed(programs, rows)


@mutator("verify.between_points")
def a_swing_between_two_points(rng, programs):
    """One point of a cut is passed faster; nothing tells but the cubics on both sides."""
    rows = rows_of(programs)
    i = pick(rng, cuts(rows)[2:-2])
    return changed(programs, i, v=[1.9 * value for value in rows[i]["v"]])


@mutator("verify.goal_tolerances")
def no_path_tolerance(rng, programs):
    rows = rows_of(programs)
    i = pick(rng, where(rows, "move"))
    path = list(rows[i]["path"])
    path[int(rng.integers(len(path)))] = float(pick(rng, [0.0, -1.0, 0.5]))
    return changed(programs, i, path=path)


@mutator("verify.goal_tolerances")
def a_wide_goal(rng, programs):
    rows = rows_of(programs)
    i = pick(rng, where(rows, "move"))
    return changed(programs, i, goal=[10.0 * value for value in rows[i]["goal"]])


@mutator("verify.goal_tolerances")
def a_goal_that_may_be_as_late_as_it_likes(rng, programs):
    return changed(
        programs, pick(rng, where(rows_of(programs), "move")), goal_time=float(pick(rng, [0.0, 600.0]))
    )


@mutator("verify.power_on_failure")
def power_that_stays_on_where_a_step_fails(rng, programs):
    rows = rows_of(programs)
    hot = [i for i, row in enumerate(rows) if row.get("on_failure")]
    return changed(programs, pick(rng, hot), on_failure=[])


@mutator("verify.power_on_failure")
def another_output_that_falls(rng, programs):
    rows = rows_of(programs)
    hot = [i for i, row in enumerate(rows) if row.get("on_failure")]
    return changed(programs, pick(rng, hot), on_failure=["doWirePower", "doSpindle"])


@mutator("verify.power_on_failure")
def power_that_stays_on_at_the_end(rng, programs):
    rows = rows_of(programs)
    return sealed(programs, [*rows, {"set": "doWirePower", "to": 1}])


@mutator("verify.between_points")
def a_velocity_that_bends_the_way(rng, programs):
    rows = rows_of(programs)
    i = pick(rng, work(rows))
    v = list(rows[i]["v"])
    v[2] += 0.08
    return changed(programs, i, v=v)


@mutator("verify.between_points")
def points_that_are_reached_backwards(rng, programs):
    rows = rows_of(programs)
    i = pick(rng, cuts(rows))
    return changed(programs, i, v=[-value for value in rows[i]["v"]])


@mutator("verify.joint_speed")
def a_short_swing_between_samples(rng, programs):
    """A joint swings out and back within milliseconds: what samples see of it depends on where they lie."""
    rows = rows_of(programs)
    i = pick(rng, work(rows))
    before, here = rows[i - 1], rows[i]
    fraction = 0.0051 / (here["t"] - before["t"])
    between = {
        key: [b + fraction * (a - b) for a, b in zip(before[key], here[key], strict=True)]
        for key in ("q", "v")
    }
    swung = {**here, "v": [*here["v"][:-1], 40.0]}
    return sealed(
        programs, [*rows[:i], {"t": round(here["t"] - 0.0051, 6), **between}, swung, *rows[i + 1 :]]
    )


@mutator("verify.joint_acceleration")
def twenty_times_as_fast(rng, programs):
    rows = rows_of(programs)
    first = pick(rng, [i for i in where(rows, "segment") if "move" in rows[i - 2]])
    last = next(i for i in range(first, len(rows)) if not {"t", "segment"} & rows[i].keys())
    begun = rows[first - 1]["t"]
    for row in rows[first:last]:
        if "t" in row:
            row["t"] = begun + max(round((row["t"] - begun) / 20.0, 6), 1e-6)
            row["v"] = [20.0 * value for value in row["v"]]
    return sealed(programs, rows)


@mutator("verify.surface")
def a_cut_that_lies_off(rng, programs):
    """All points of the cuts are moved alike, smoothly, so that nothing but the part tells."""
    rows = rows_of(programs)
    for i in cuts(rows):
        q = list(rows[i]["q"])
        for first in range(0, len(q), 6):
            q[first + 1] += 0.003
        rows[i]["q"] = q
    return sealed(programs, rows)


@mutator("verify.dialogue")
def a_question_left_out(rng, programs):
    rows = rows_of(programs)
    i = pick(rng, where(rows, "ask"))
    return sealed(programs, [*rows[:i], *rows[i + 1 :]])


@mutator("verify.dialogue")
def an_operation_that_is_told_otherwise(rng, programs):
    """The runner tells the operator what stands there."""
    rows = rows_of(programs)
    i = pick(rng, where(rows, "operation"))
    other = pick(rng, [{"operation": "Reach in"}, {"setup": rows[i]["setup"] + 1}])
    return changed(programs, i, **other)


@mutator("verify.dialogue")
def an_operation_too_many(rng, programs):
    rows = rows_of(programs)
    i = pick(rng, where(rows, "operation"))
    return sealed(programs, [*rows, {**rows[i], "operation": "Reach in"}])


@mutator("verify.dialogue")
def another_tool_that_is_told(rng, programs):
    """The right tool is announced after the wrong one, so that the moves have it."""
    rows = rows_of(programs)
    i = pick(rng, where(rows, "tool"))
    other = pick(rng, [{"tool": "gripper"}, {"mass": 50.0}])
    return sealed(programs, [*rows[:i], {**rows[i], **other}, *rows[i:]])


@mutator("verify.dialogue")
def no_time_to_heat(rng, programs):
    rows = rows_of(programs)
    i = where(rows, "dwell", on_failure=["doWirePower"])[0]
    return sealed(programs, [*rows[:i], *rows[i + 1 :]])


@mutator("verify.signals")
def another_output_that_is_switched(rng, programs):
    rows = rows_of(programs)
    i = pick(rng, where(rows, "set", to=1))
    return changed(programs, i, set="doCoolant")


@mutator("verify.names")
def an_output_spelt_otherwise_where_it_goes_off(rng, programs):
    rows = rows_of(programs)
    return changed(programs, where(rows, "set", to=0)[-1], set="dowirepower")


@mutator("verify.base_frames")
def another_base(rng, programs):
    rows = rows_of(programs)
    base = list(rows[1]["base"])
    base[int(rng.integers(3))] += 0.002
    return changed(programs, 1, base=base)


@mutator("verify.tool_data")
def another_tool_centre_point(rng, programs):
    rows = rows_of(programs)
    i = pick(rng, where(rows, "tool"))
    tcp = list(rows[i]["tcp"])
    tcp[2] += 0.002
    return changed(programs, i, tcp=tcp)


@mutator("verify.work_object")
def another_place_of_the_block(rng, programs):
    rows = rows_of(programs)
    i = where(rows, "operation")[0]
    block = list(rows[i]["block"])
    block[0] += 0.002
    return changed(programs, i, block=block)


@mutator("verify.digest")
def another_problem(rng, programs):
    return changed(programs, 0, problem_digest="0" * 64)


@mutator("verify.stop_in_foam")
def a_stop_in_the_foam(rng, programs):
    rows = rows_of(programs)
    first = cuts(rows)[: len(cuts(rows)) // 2]
    i = pick(rng, first[len(first) // 3 : -len(first) // 3])  # in the middle of the first cut
    return changed(programs, i, v=[0.0] * len(rows[i]["v"]))


@mutator("verify.stop_in_foam")
def a_stop_in_the_foam_that_is_not_called_one(rng, programs):
    rows = rows_of(programs)
    first = cuts(rows)[: len(cuts(rows)) // 2]
    i = pick(rng, first[len(first) // 3 : -len(first) // 3])
    return changed(programs, i, v=[1e-6 * value for value in rows[i]["v"]])


@mutator("verify.stop_in_foam")
def a_stop_between_points(rng, programs):
    """From three times the mean speed to none and up again, at each point and in the middle between two."""
    rows = rows_of(programs)
    for i in cuts(rows):
        rows[i]["v"] = [3.0 * value for value in rows[i]["v"]]
    return sealed(programs, rows)


@of_two("verify.stop_in_foam")
def a_pause_before_the_foam(rng, programs):
    """Three seconds, hot, at the edge of the block, where no feed is claimed."""
    rows = rows_of(programs)
    i = next(i for i in cuts(rows) if rows[i]["t"] > 0.0) + 4
    rows[i]["v"] = [1e-9] * 12
    late = [{**row, "t": round(row["t"] + 3.0, 6)} if "t" in row else row for row in rows[i + 1 :]]
    end = next(k for k, row in enumerate(late) if not {"t", "segment"} & row.keys())
    pause = {**rows[i], "t": round(rows[i]["t"] + 3.0, 6), "q": [value + 3e-9 for value in rows[i]["q"]]}
    return sealed(programs, [*rows[: i + 1], pause, *late[:end], *rows[i + 1 + end :]])


@mutator("verify.move_time")
def points_too_near_to_one_another(rng, programs):
    rows = rows_of(programs)
    i = pick(rng, work(rows))
    late = rows[i]["t"] - rows[i - 1]["t"] - 0.002
    for row in rows[i:]:
        if "t" not in row and "segment" not in row:
            break
        if "t" in row:
            row["t"] = round(row["t"] - late, 6)
    return sealed(programs, rows)


@mutator("verify.continuity")
def an_end_that_is_not_home(rng, programs):
    rows = rows_of(programs)
    i = where(rows, "move")[-1]
    return sealed(programs, rows[: i - 1])


@of_two("verify.syntax")
def an_arm_that_stands_moves(rng, programs):
    rows = rows_of(programs)
    i = pick(rng, where(rows, "move", move=["left"]))
    q = list(rows[i + 1]["q"])
    q[7] += 0.02
    return changed(programs, i + 1, q=q)


@of_two("verify.names")
def two_arms_of_one_name(rng, programs):
    return changed(programs, 2, arm="left")


@of_two("verify.files")
def one_arm_alone(rng, programs):
    """The other arm, its moves and what stands before and in them are left out."""
    rows, left_out = [], False
    given = rows_of(programs)
    for row, after in zip(given, [*given[1:], {}], strict=True):
        if "t" not in row:
            left_out = ["right"] in (row.get("move"), after.get("move"))
        if left_out or row.get("arm") == "right":
            continue
        row = {
            key: value[:6] if key in ("at", "q", "v", "path", "goal") else value for key, value in row.items()
        }
        if "move" in row:
            row["move"] = ["left"]
        rows.append(row)
    return sealed(programs, rows)


@of_two("verify.wire_alone")
def one_end_of_the_wire_moves_alone(rng, programs):
    rows = rows_of(programs)
    i = where(rows, "move", move=["left", "right"])[0]
    here = rows[i - 1]["at"]
    way = [here[0] + 0.01, *here[1:]]
    move = {**rows[i], "move": ["left"]}
    still = [0.0] * len(here)
    there = [rows[i - 1], move, {"t": 1.0, "q": here, "v": still}, {"t": 2.0, "q": way, "v": still}]
    back = [{**rows[i - 1], "at": way}, move, {"t": 1.0, "q": way, "v": still}]
    back += [{"t": 2.0, "q": here, "v": still}]
    return sealed(programs, [*rows[: i - 1], *there, *back, *rows[i - 1 :]])


def carried(rows):
    """The row in which the holder takes the block."""
    return next(i for i in where(rows, "carry") if rows[i]["mass"] > 0.0)


@of_held("verify.load")
def nobody_is_asked_about_the_load(rng, programs):
    rows = rows_of(programs)
    del rows[carried(rows)]
    return sealed(programs, rows)


@of_held("verify.load")
def another_load(rng, programs):
    rows = rows_of(programs)
    i = carried(rows)
    key = pick(rng, ["mass", "centre", "inertia", "axes"])
    factor = float(pick(rng, [0.5, 1.5]))
    value = rows[i][key]
    if key == "axes":
        return changed(programs, i, axes=[0.0, 0.0, rows[i]["axes"][2] + 0.5])
    return changed(programs, i, **{key: [factor * v for v in value] if key != "mass" else factor * value})


@of_held("verify.load")
def a_load_that_is_never_let_go(rng, programs):
    rows = rows_of(programs)
    i = where(rows, "carry")[-1]
    later = {**rows[carried(rows)], "carry": "left"}
    return sealed(programs, [*rows[:i], later, *rows[i:]])


@of_held("verify.held_frame")
def the_other_arm_holds_the_block(rng, programs):
    rows = rows_of(programs)
    i = where(rows, "operation")[0]
    return changed(programs, i, held_by=pick(rng, ["left", ""]))


@of_held("verify.dialogue")
def a_block_that_is_held_elsewhere(rng, programs):
    rows = rows_of(programs)
    i = where(rows, "operation")[0]
    block = list(rows[i]["block"])
    block[int(rng.integers(6))] += 1e-4
    return changed(programs, i, block=block)


@of_held("verify.stop_in_foam")
def the_wire_stands_still_in_a_block_that_moves(rng, programs):
    """At one point of the cut the holder goes as before and the bow with it, at rest as seen from the block:
    no joint rests."""
    rows = rows_of(programs)
    i = pick(rng, [i for i in cuts(rows)[4:-4] if rows[i]["v"][0] != 0.0])
    v = list(rows[i]["v"])
    q = np.array(rows[i]["q"])
    data = robot("irb140")
    base, tool = (held_job.BASES[arm] for arm in ("left", "right")), held_job.cell()
    left, right = base
    tcp = {arm: tool.arm(arm).tool.tcp for arm in ("left", "right")}
    soon = 1e-6
    held = [
        right @ forward_kinematics(data, q[6:] + k * soon * np.array(v[6:])) @ tcp["right"]
        for k in (0.0, 1.0)
    ]
    expected = held[1] @ inverse(held[0]) @ left @ forward_kinematics(data, q[:6]) @ tcp["left"]
    driven = TrajectoryArm(data, left, tcp["left"], slice(0, 6))
    rate = (solve_joints(driven, expected[None], q[None, :6], np.zeros(1, dtype=int))[0] - q[:6]) / soon
    return changed(programs, i, v=[*rate.tolist(), *v[6:]])


@of_held("verify.power_on_failure")
def the_load_is_asked_about_with_the_wire_hot(rng, programs):
    rows = rows_of(programs)
    i = where(rows, "dwell")[0]
    load = {**rows[carried(rows)], "on_failure": rows[i]["on_failure"]}
    return sealed(programs, [*rows[:i], load, *rows[i:]])
