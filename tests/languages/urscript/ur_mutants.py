"""Seeded faults in URScript texts, by kind.

Geometric faults are twice the tolerance that they violate: 0.2 mm and 0.2 degrees where 0.1 are claimed,
0.002 mm for frames.
"""

from __future__ import annotations

import re

import numpy as np
from scipy.spatial.transform import Rotation

from tests.proof.registry import Table, into, pick

FILE = "left/straight.script"
_POSE = re.compile(r"p\[([^\]]*)\]")
MUTATORS: Table = {}
mutator = into(MUTATORS)


def rows_of(texts):
    return texts[FILE].split("\r\n")


def put(texts, rows):
    return {**texts, FILE: "\r\n".join(rows)}


def where(rows, pattern):
    """Indices of the rows that match."""
    return [i for i, row in enumerate(rows) if re.search(pattern, row)]


def edit(rng, texts, pattern, new):
    """Texts with one of the rows that match changed by ``new``, a function of the row."""
    rows = rows_of(texts)
    i = pick(rng, where(rows, pattern))
    changed = new(rows[i])
    assert changed != rows[i], rows[i]
    rows[i : i + 1] = changed.split("\n") if changed else []
    return put(texts, rows)


def pose_of(row):
    return np.array([float(value) for value in _POSE.search(row)[1].split(",")])


def with_pose(row, pose):
    """The row with another pose, with the decimals that poses have."""
    text = ",".join(f"{v:.{7 if i < 3 else 9}f}" for i, v in enumerate(pose))
    return _POSE.sub(f"p[{text}]", row, count=1)


def moved(rng, row, size):
    """The row with its place off by ``size`` [m] in a random direction."""
    pose, way = pose_of(row), rng.normal(size=3)
    pose[:3] += size * way / np.linalg.norm(way)
    return with_pose(row, pose)


def rotated(rng, row, degrees):
    """The row turned by an angle about a random axis."""
    pose, axis = pose_of(row), rng.normal(size=3)
    turn = Rotation.from_rotvec(np.deg2rad(degrees) * axis / np.linalg.norm(axis))
    pose[3:] = (turn * Rotation.from_rotvec(pose[3:])).as_rotvec()
    return with_pose(row, pose)


def number_after(row, key, new):
    """The row with the number behind ``key`` changed by ``new``, a function of it."""
    return re.sub(rf"(?<={key}=)[\d.]+", lambda found: f"{new(float(found[0])):.6g}", row)


# ---- text ----------------------------------------


@mutator("verify.syntax")
def misspelt(rng, texts):
    new = pick(rng, ["move", "movep", "movec", "Movel", "servoj"])
    return edit(rng, texts, "^movel", lambda row: row.replace("movel", new, 1))


@mutator("verify.syntax")
def plain_pose(rng, texts):
    """A pose in the controller's base, with no frame."""
    return edit(rng, texts, "^movel", lambda row: re.sub(r"pose_trans\(\w+,(p[^)]*)\)", r"\1", row))


@mutator("verify.syntax")
def no_time(rng, texts):
    return edit(rng, texts, "^movel", lambda row: re.sub(r",t=[\d.]+", "", row))


@mutator("verify.syntax")
def no_blend(rng, texts):
    return edit(rng, texts, "^movel", lambda row: re.sub(r",r=[\d.]+", "", row))


@mutator("verify.syntax")
def speed_too(rng, texts):
    return edit(rng, texts, "^movel", lambda row: row.replace(",t=", ",a=1.2,v=0.25,t="))


@mutator("verify.syntax")
def lost_end(rng, texts):
    rows = rows_of(texts)
    rows.pop(where(rows, "^end$")[int(rng.integers(2))])
    return put(texts, rows)


@mutator("verify.syntax")
def lost_halt(rng, texts):
    return edit(rng, texts, "^halt$", lambda row: "")


@mutator("verify.syntax")
def behind_the_end(rng, texts):
    return put(texts, [*rows_of(texts), "movej(x_home,a=1.0,v=1.0)"])


@mutator("verify.syntax")
def branch(rng, texts):
    return edit(rng, texts, "^movel", lambda row: f"if get_standard_digital_in(0):\n{row}\nend")


@mutator("verify.syntax")
def other_statement(rng, texts):
    new = pick(
        rng,
        [
            "set_gravity([0.0,0.0,9.82])",
            "stopl(1.0)",
            "x=1+2",
            "thread t():",
            "motion_version_set(1)",
            "sync()",
        ],
    )
    return edit(rng, texts, "^movel", lambda row: f"{new}\n{row}")


@mutator("verify.syntax")
def no_look(rng, texts):
    rows = rows_of(texts)
    (i,) = where(rows, "^if ")
    return put(texts, rows[:i] + rows[i + 4 :])


@mutator("verify.syntax")
def look_later(rng, texts):
    rows = rows_of(texts)
    (i,), (k, *_) = where(rows, "^if "), where(rows, "^movej")
    return put(texts, [*rows[:i], *rows[i + 4 : k + 1], *rows[i : i + 4], *rows[k + 1 :]])


@mutator("verify.syntax")
def other_arm_named(rng, texts):
    return edit(rng, texts, "another arm", lambda row: row.replace("ur10e", "ur5e"))


@mutator("verify.syntax")
def no_payload(rng, texts):
    return edit(rng, texts, "^set_payload", lambda row: "")


@mutator("verify.syntax")
def payload_first(rng, texts):
    rows = rows_of(texts)
    i = pick(rng, where(rows, "^set_tcp"))
    rows[i : i + 2] = rows[i + 1], rows[i]
    return put(texts, rows)


@mutator("verify.declarations")
def undeclared(rng, texts):
    return edit(
        rng, texts, r"^(movej|movel|set_tcp)", lambda row: re.sub(r"([btx]_\w+)", r"\1_x", row, count=1)
    )


@mutator("verify.declarations")
def lost_data(rng, texts):
    return edit(rng, texts, "^[btx]_.* = ", lambda row: "")


@mutator("verify.declarations")
def of_another_kind(rng, texts):
    return edit(rng, texts, "^movej", lambda row: re.sub(r"x_\w+", "b_stock", row))


@mutator("verify.declarations")
def five_numbers(rng, texts):
    return edit(rng, texts, "^movel", lambda row: re.sub(r",-?[\d.]+\]", "]", row))


@mutator("verify.declarations")
def radius_in_millimetres(rng, texts):
    return edit(rng, texts, r"^movel.*r=0\.00", lambda row: number_after(row, "r", lambda r: 1e3 * r))


@mutator("verify.declarations")
def speed_in_degrees(rng, texts):
    return edit(
        rng, texts, "^movej.*v=[1-9.]*[2-9]", lambda row: number_after(row, "v", lambda v: np.rad2deg(v) + 10)
    )


@mutator("verify.names")
def double_name(rng, texts):
    return edit(rng, texts, "^[btx]_.* = ", lambda row: f"{row}\n{row}")


@mutator("verify.names")
def taken_name(rng, texts):
    new = pick(rng, ["n" * 33, "halt", "movel", "p"])
    return edit(rng, texts, "^base_frame", lambda row: f"{row}\n{row.replace('base_frame', new)}")


@mutator("verify.line_length")
def long_line(rng, texts):
    return edit(rng, texts, "^movel", lambda row: f"{row} # {'x' * 400}")


@mutator("verify.line_length")
def long_text(rng, texts):
    return edit(rng, texts, "^popup", lambda row: row.replace('popup("', 'popup("' + "x" * 256, 1))


@mutator("verify.syntax")
def number_parted(rng, texts):
    new = pick(
        rng, ["- 1.0", "+1.0", "1.0 5", "1.0E", "1.0.5", "--1.0", "1.0mm", "1.0+0.0", "0x1", ".5", "d2r(1.0)"]
    )
    return edit(rng, texts, "^movel", lambda row: re.sub(r"(?<=p\[)[^,]+", new, row))


@mutator("verify.decimals")
def number_of_no_float(rng, texts):
    new = pick(rng, ["1E39", "-4.0E+38", "9" * 60, "1E999"])
    return edit(rng, texts, "^movel", lambda row: re.sub(r"(?<=p\[)[^,]+", new, row))


@mutator("verify.files")
def other_name(rng, texts):
    return edit(rng, texts, "^def", lambda row: row.replace("straight", "strait"))


@mutator("verify.files")
def stray_file(rng, texts):
    name = pick(rng, ["other.script", "left/other.mod", "left/config.txt", "right/straight.script"])
    return {**texts, name: texts[FILE]}


@mutator("verify.names")
def two_programs(rng, texts):
    return {**texts, "left/strait.script": texts[FILE].replace("def straight", "def strait")}


@mutator("verify.digest")
def other_problem(rng, texts):
    return edit(rng, texts, "^problem_digest", lambda row: row.replace("cd34", "cd35", 1))


@mutator("verify.controller_files")
def files_for_the_controller(rng, texts):
    return {**texts, "controller/left/README.txt": "Load these."}


# ---- questions and signals ----------------------------------------


@mutator("verify.setup")
def other_question(rng, texts):
    return edit(rng, texts, "Setup [12]", lambda row: row.replace("done", "ready"))


@mutator("verify.setup")
def question_goes_on(rng, texts):
    """A question that is shown while the program goes on."""
    rows = rows_of(texts)
    for i in where(rows, "^popup.*(Mount|Clamp|Turn|Setup)"):
        rows[i] = re.sub(r'"Tandem \w+"', '"Tandem"', rows[i]).replace("blocking=True", "blocking=False")
    return put(texts, rows)


@mutator("verify.syntax")
def question_unheld(rng, texts):
    return edit(rng, texts, "Tandem asks", lambda row: row.replace("blocking=True", "blocking=False"))


@mutator("verify.setup")
def no_question(rng, texts):
    return edit(rng, texts, "is the way of the arm|Is the way of the arm", lambda row: "")


@mutator("verify.dialogue")
def other_words(rng, texts):
    return edit(rng, texts, "Is the way of the arm", lambda row: row.replace("clear", "free", 1))


@mutator("verify.signals")
def other_output(rng, texts):
    return edit(rng, texts, "digital_out", lambda row: row.replace("out(1,", f"out({pick(rng, [0, 2, 7])},"))


@mutator("verify.signals")
def standard_output(rng, texts):
    return edit(rng, texts, "digital_out", lambda row: row.replace("configurable", "standard"))


@mutator("verify.declarations")
def no_such_output(rng, texts):
    return edit(
        rng, texts, "digital_out", lambda row: row.replace("out(1,", f"out({pick(rng, [8, 17, 99])},")
    )


@mutator("verify.wire_power")
def not_switched_on(rng, texts):
    return edit(rng, texts, "digital_out.*True", lambda row: "")


@mutator("verify.wire_power")
def not_switched_off(rng, texts):
    rows = rows_of(texts)
    rows.pop(where(rows, "digital_out.*False")[int(rng.integers(1, 3))])
    return put(texts, rows)


@mutator("verify.wire_power")
def cold(rng, texts):
    """The power comes on behind the heating, just before the foam."""
    rows = rows_of(texts)
    i = pick(rng, where(rows, "^sleep.5"))
    cut = next(k for k in where(rows, "^# Segment cut/[a-z]+:") if k > i)
    rows.insert(cut - 1, rows[i - 1])
    del rows[i - 1]
    return put(texts, rows)


@mutator("verify.stop_before_logic")
def flies_into_logic(rng, texts):
    rows = rows_of(texts)
    moves = [i for i in where(rows, "^movel") if not rows[i + 1].startswith(("movel", "#"))]
    i = pick(rng, moves)
    rows[i] = number_after(rows[i], "r", lambda r: 0.001)
    return put(texts, rows)


# ---- frames, tools, loads ----------------------------------------


@mutator("verify.work_object")
def wrong_frame(rng, texts):
    return edit(rng, texts, r"^movel.*b_stock_2", lambda row: row.replace("b_stock_2", "b_stock"))


@mutator("verify.work_object")
def frame_off(rng, texts):
    return edit(rng, texts, "^b_stock", lambda row: _bump(rng, row))


@mutator("verify.base_frames")
def foot_off(rng, texts):
    return edit(rng, texts, "^base_frame", lambda row: _bump(rng, row))


@mutator("verify.tool_data")
def tool_off(rng, texts):
    return edit(rng, texts, "^t_", lambda row: _bump(rng, row))


@mutator("verify.tool_data")
def tool_in_millimetres(rng, texts):
    return edit(rng, texts, "^t_", lambda row: with_pose(row, pose_of(row) * ([1e3] * 3 + [1.0] * 3)))


def _bump(rng, row):
    """A pose with one coordinate off by 0.002 mm, or one angle by 4e-6 rad."""
    pose, i = pose_of(row), int(rng.integers(6))
    pose[i] += (2e-6 if i < 3 else 4e-6) * pick(rng, [-1, 1])
    return with_pose(row, pose)


@mutator("verify.tool_data")
def wrong_payload(rng, texts):
    """The other operation's payload; both bows have their wires at one place."""
    rows = rows_of(texts)
    i, k = where(rows, "^set_payload")
    rows[i], rows[k] = rows[k], rows[i]
    return put(texts, rows)


@mutator("verify.tool_data")
def wrong_mass(rng, texts):
    return edit(rng, texts, "^set_payload", lambda row: re.sub(r"\(([\d.]+)", _increase_mass, row))


def _increase_mass(match):
    return f"({float(match[1]) + 0.002:.3f}"


@mutator("verify.tool_data")
def centre_in_millimetres(rng, texts):
    return edit(rng, texts, "^set_payload", lambda row: re.sub(r"([\d.]+)\]", _to_millimetres, row))


def _to_millimetres(match):
    return f"{1e3 * float(match[1]):.6f}]"


# ---- poses ----------------------------------------


@mutator("verify.follows")
def pose_off(rng, texts):
    return edit(rng, texts, "^movel", lambda row: moved(rng, row, 0.2e-3))


@mutator("verify.follows")
def pose_turned(rng, texts):
    return edit(rng, texts, "^movel", lambda row: rotated(rng, row, 0.2))


@mutator("verify.follows")
def start_off(rng, texts):
    """Of the joints that an operation begins at, one is off by 0.1 degrees."""

    def shift_joint(row):
        return re.sub(r"\[([^,]+)", lambda found: f"[{float(found[1]) + 0.00175:.9f}", row)

    return edit(rng, texts, "^x_._start", shift_joint)


@mutator("verify.follows")
def missing_move(rng, texts):
    return edit(rng, texts, "^movel", lambda row: "")


@mutator("verify.zero_length")
def doubled_move(rng, texts):
    return edit(rng, texts, "^movel", lambda row: f"{row}\n{row}")


@mutator("verify.follows")
def swapped_moves(rng, texts):
    rows = rows_of(texts)
    k = pick(rng, [i for i in where(rows, "^movel") if rows[i + 1].startswith("movel")])
    rows[k], rows[k + 1] = rows[k + 1], rows[k]
    return put(texts, rows)


@mutator("verify.follows")
def millimetres(rng, texts):
    return edit(rng, texts, "^movel", lambda row: with_pose(row, pose_of(row) * ([1e3] * 3 + [1.0] * 3)))


@mutator("verify.follows")
def degrees(rng, texts):
    return edit(
        rng, texts, "^movel", lambda row: with_pose(row, pose_of(row) * ([1.0] * 3 + [180.0 / np.pi] * 3))
    )


@mutator("verify.follows")
def sign_of_coordinate(rng, texts):
    return edit(rng, texts, "^movel", lambda row: with_pose(row, pose_of(row) * [-1, -1, 1, 1, 1, 1]))


@mutator("verify.follows")
def sign_of_turn(rng, texts):
    return edit(rng, texts, "^movel", lambda row: with_pose(row, pose_of(row) * [1, 1, 1, 1, -1, 1]))


@mutator("verify.follows")
def roll_pitch_yaw(rng, texts):
    """Angles about fixed axes where a rotation vector is meant."""

    def other(row):
        pose = pose_of(row)
        return with_pose(row, [*pose[:3], *Rotation.from_rotvec(pose[3:]).as_euler("xyz")])

    return edit(rng, texts, "^movel", other)


@mutator("verify.contact")
def other_segment(rng, texts):
    """A cut said to be another part of the way."""
    return edit(rng, texts, "^# Segment cut/(top|back):", lambda row: re.sub(r"cut/\w+", "retreat", row))


# ---- joints, times, blends ----------------------------------------


@mutator("verify.cell_check")
def looks_for_the_turned_base(rng, texts):
    """The place of the flange's point in a base that is turned by 180 degrees."""

    def turn(row):
        head, _, last = row.rpartition("p[")
        x, y, *rest = last.split(",")
        return f"{head}p[{-float(x):.7f},{-float(y):.7f},{','.join(rest)}"

    return edit(rng, texts, "^if ", turn)


@mutator("verify.cell_check")
def looks_away(rng, texts):
    return edit(rng, texts, "^if ", lambda row: row.replace("p[0.1000000,0.2000000", "p[0.0000000,0.0000000"))


@mutator("verify.cell_check")
def looks_elsewhere(rng, texts):
    return edit(rng, texts, "^if ", lambda row: row.replace("x_home", "x_1_entry_1"))


@mutator("verify.cell_check")
def takes_any_arm(rng, texts):
    return edit(rng, texts, "^if ", lambda row: row.replace(">0.01:", ">0.5:"))


@mutator("verify.continuity")
def home_lost(rng, texts):
    """The arm does not go home at the end."""
    rows = rows_of(texts)
    rows.pop(where(rows, "^movej.x_home")[-1])
    return put(texts, rows)


@mutator("verify.unknown_start")
def fast_start(rng, texts):
    rows = rows_of(texts)
    i = where(rows, "^movej")[0]
    rows[i] = number_after(rows[i], "v", lambda v: 1.05 * v)
    return put(texts, rows)


@mutator("verify.tcp_speed")
def fast_joints(rng, texts):
    return edit(rng, texts, r"^movej\(x_1_exit", lambda row: number_after(row, "v", lambda v: 1.5 * v))


@mutator("verify.move_kinds")
def steep_joints(rng, texts):
    return edit(rng, texts, "^movej", lambda row: number_after(row, "a", lambda a: 2.5 * a))


@mutator("verify.feed")
def short_time(rng, texts):
    rows = rows_of(texts)
    i = pick(rng, where(rows, "^movel.*t=1.66"))
    rows[i] = number_after(rows[i], "t", lambda t: 0.5 * t)
    return put(texts, rows)


@mutator("verify.feed")
def long_time(rng, texts):
    rows = rows_of(texts)
    i = pick(rng, where(rows, "^movel.*t=1.66"))
    rows[i] = number_after(rows[i], "t", lambda t: 4.0 * t)
    return put(texts, rows)


@mutator("verify.move_time")
def no_time_at_all(rng, texts):
    return edit(rng, texts, "^movel.*t=1.66", lambda row: number_after(row, "t", lambda t: 0.001))


@mutator("verify.stop_in_foam")
def stop_in_the_foam(rng, texts):
    rows = rows_of(texts)
    i = pick(rng, where(rows, "^movel.*t=1.66")[2:-2])
    rows[i] = number_after(rows[i], "r", lambda r: 0.0)
    return put(texts, rows)


@mutator("verify.zone_size")
def blends_meet(rng, texts):
    """Blends that are more than half of their moves: they meet, and the controller skips a waypoint."""
    return edit(rng, texts, "^movel.*r=0.00", lambda row: number_after(row, "r", lambda r: 1.3 * r))
