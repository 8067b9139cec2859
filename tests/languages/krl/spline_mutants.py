"""Seeded faults in spline blocks of KRL, by kind, and rewrites that change nothing."""

from __future__ import annotations

import re

import numpy as np

from tests.languages.krl.krl_edits import moved, pose_of, rotated, where, with_pose
from tests.languages.krl.spline_job import MOVES
from tests.proof.registry import named, pick

MUTATORS = {}
REWRITES = {}
fault, rewrite = named(MUTATORS), named(REWRITES)
TOLERANCE = 0.1
"""Of the poses that are followed, in mm and degrees."""


def lines(texts):
    return texts[MOVES].split("\r\n")


def put(texts, rows):
    return {**texts, MOVES: "\r\n".join(rows)}


def points(rows):
    """Rows of points, but for the first and the last three: what is beside an end may be free."""
    return where(rows, r"^SPL \{")[3:-3]


def inserted(rng, texts, *new):
    """Texts with lines put behind a point's PART."""
    rows = lines(texts)
    at = pick(rng, points(rows)) + 2
    return put(texts, [*rows[:at], *new, *rows[at:]])


def changed(texts, pattern, new):
    text, count = re.subn(pattern, new, texts[MOVES], count=1, flags=re.MULTILINE)
    assert count == 1 and text != texts[MOVES]
    return {**texts, MOVES: text}


def scaled(row, factor):
    word, value = row.split("= ")
    return f"{word}= {float(value) * factor:.8f}"


@fault
def part_changed(rng, texts):
    rows = lines(texts)
    at = pick(rng, where(rows, "BLOCK PART"))
    rows[at] = scaled(rows[at], rng.choice([0.5, 0.9, 1.1, 2.0]))
    return put(texts, rows)


@fault
def time_taken_from_one_part_for_another(rng, texts):
    rows = lines(texts)
    one, two = rng.choice(where(rows, "BLOCK PART")[4:-4], 2, replace=False)
    half = 0.5 * float(rows[one].split("= ")[1])
    rows[one] = scaled(rows[one], 0.5)
    rows[two] = f"TIME_BLOCK PART = {float(rows[two].split('= ')[1]) + half:.8f}"
    return put(texts, rows)


@fault
def end_shorter(rng, texts):
    rows = lines(texts)
    at = where(rows, "BLOCK END")[0]
    rows[at] = scaled(rows[at], rng.uniform(0.4, 0.95))
    return put(texts, rows)


@fault
def end_of_nothing(rng, texts):
    return changed(texts, r"BLOCK END = .*$", "BLOCK END = 0\r")


@fault
def part_of_nothing(rng, texts):
    rows = lines(texts)
    rows[pick(rng, where(rows, "BLOCK PART"))] = "TIME_BLOCK PART = 0"
    return put(texts, rows)


@fault
def a_line_of_times_missing(rng, texts):
    rows = lines(texts)
    del rows[pick(rng, where(rows, "TIME_BLOCK"))]
    return put(texts, rows)


@fault
def start_missing(rng, texts):
    return changed(texts, r"^TIME_BLOCK START\r\n", "")


@fault
def end_missing(rng, texts):
    return changed(texts, r"^TIME_BLOCK END.*\r\n", "")


@fault
def a_line_of_times_doubled(rng, texts):
    rows = lines(texts)
    at = pick(rng, where(rows, "TIME_BLOCK"))
    return put(texts, [*rows[: at + 1], *rows[at:]])


@fault
def no_times_at_all(rng, texts):
    return put(texts, [row for row in lines(texts) if "TIME_BLOCK" not in row])


@fault
def point_moved(rng, texts):
    rows = lines(texts)
    at = pick(rng, points(rows))
    rows[at] = moved(rng, rows[at], 2 * TOLERANCE)
    return put(texts, rows)


@fault
def point_turned(rng, texts):
    rows = lines(texts)
    at = pick(rng, points(rows))
    rows[at] = rotated(rng, rows[at], 2 * TOLERANCE)
    return put(texts, rows)


@fault
def point_missing(rng, texts):
    """With its part, given to the next one."""
    rows = lines(texts)
    at = pick(rng, points(rows))
    part = sum(float(rows[k].split("= ")[1]) for k in (at + 1, at + 3))
    rows[at + 3] = f"TIME_BLOCK PART = {part:.8f}"
    return put(texts, [*rows[:at], *rows[at + 2 :]])


@fault
def kink_between_two_poses(rng, texts):
    """A point of its own, off the way, between two poses that are kept: only the curve tells."""
    rows = lines(texts)
    at = pick(rng, points(rows))
    middle = 0.5 * (pose_of(rows[at]) + pose_of(rows[at + 2]))
    middle[2] += 0.6 * rng.choice([-1, 1])
    fraction = 0.5 * float(rows[at + 3].split("= ")[1])
    new = [with_pose(rows[at], middle), f"TIME_BLOCK PART = {fraction:.8f}"]
    rows[at + 3] = f"TIME_BLOCK PART = {fraction:.8f}"
    return put(texts, [*rows[: at + 2], *new, *rows[at + 2 :]])


@fault
def more_than_500_points(rng, texts):
    """Every way between two points in eight."""
    out, before, waits = [], None, None
    for row in lines(texts):
        if row.startswith("SPL {"):
            waits = row
        elif waits is not None:
            here = pose_of(waits)
            count = 1 if before is None else 8
            part = float(row.split("= ")[1]) / count
            for k in range(1, count + 1):
                place = here if k == count else before + (here - before) * k / count
                out += [with_pose(waits, place), f"TIME_BLOCK PART = {part:.9f}"]
            before, waits = here, None
        else:
            out.append(row)
    return put(texts, out)


@fault
def speed_set_inside(rng, texts):
    return inserted(rng, texts, f"$VEL.CP={rng.uniform(0.01, 0.2):.4f}")


@fault
def turning_set_inside(rng, texts):
    return inserted(rng, texts, "$VEL.ORI1=100.0")


@fault
def approximated_point(rng, texts):
    rows = lines(texts)
    rows[pick(rng, points(rows))] += pick(rng, [" C_DIS", " C_SPL", " C_VEL", " C_ORI"])
    return put(texts, rows)


@fault
def straight_move_inside(rng, texts):
    rows = lines(texts)
    at = pick(rng, points(rows))
    rows[at] = rows[at].replace("SPL ", pick(rng, ["SLIN ", "LIN "]))
    return put(texts, rows)


@fault
def joint_move_inside(rng, texts):
    rows = lines(texts)
    at = pick(rng, points(rows))
    rows[at] = rows[at].replace("SPL ", "SPTP ")
    return put(texts, rows)


@fault
def station_inside(rng, texts):
    return inserted(rng, texts, "PTP x_home")


@fault
def trigger_by_distance(rng, texts):
    return inserted(rng, texts, "TRIGGER WHEN DISTANCE=0 DELAY=0 DO $OUT[5]=TRUE")


@fault
def trigger_by_path(rng, texts):
    return inserted(rng, texts, "TRIGGER WHEN PATH=0 DELAY=0 DO $OUT[5]=TRUE")


@fault
def constant_speed_inside(rng, texts):
    return inserted(rng, texts, pick(rng, ["CONST_VEL START = 10", "CONST_VEL END = -10"]))


@fault
def output_inside(rng, texts):
    return inserted(rng, texts, "$OUT[5]=TRUE")


@fault
def wait_inside(rng, texts):
    return inserted(rng, texts, "WAIT SEC 0.5")


@fault
def halt_inside(rng, texts):
    return inserted(rng, texts, ";? Go on?", "HALT")


@fault
def told_inside(rng, texts):
    return inserted(rng, texts, ";* The arm stands.")


@fault
def segment_between_a_point_and_its_part(rng, texts):
    rows = lines(texts)
    at = pick(rng, points(rows)) + 1
    return put(texts, [*rows[:at], "; Segment retreat: 1 moves", *rows[at:]])


@fault
def block_inside(rng, texts):
    return inserted(rng, texts, "SPLINE", "TIME_BLOCK START")


@fault
def blocks_joined_by_approximation(rng, texts):
    return inserted(rng, texts, "TIME_BLOCK END = 1.5", "ENDSPLINE C_SPL", "SPLINE", "TIME_BLOCK START")


@fault
def approximated_end(rng, texts):
    return changed(texts, r"^ENDSPLINE", pick(rng, ["ENDSPLINE C_SPL", "ENDSPLINE C_DIS"]))


@fault
def end_of_the_block_missing(rng, texts):
    return changed(texts, r"^ENDSPLINE\r\n", "")


@fault
def begins_in_a_corner(rng, texts):
    """The block's first point as a straight move without a stop before it."""
    rows = lines(texts)
    first = where(rows, "^SPL ")[0]
    straight = rows[first].replace("SPL ", "SLIN ") + " C_SPL"
    at = where(rows, "^SPLINE")[0]
    rows[first + 1] = scaled(rows[first + 1], 1.0)
    return put(texts, [*rows[:at], straight, *rows[at:]])


@fault
def slower_than_its_times(rng, texts):
    return changed(texts, r"^\$VEL.CP=.*$", f"$VEL.CP={rng.uniform(0.01, 0.038):.6f}\r")


@fault
def faster_than_allowed(rng, texts):
    return changed(texts, r"^\$VEL.CP=.*$", f"$VEL.CP={rng.uniform(0.28, 2.9):.6f}\r")


def unbound(texts):
    """The speed in force no longer tells of times that are too short."""
    return changed(texts, r"^\$VEL.CP=.*$", "$VEL.CP=0.2\r")


@fault
def end_shorter_and_faster_allowed(rng, texts):
    return end_shorter(rng, unbound(texts))


@fault
def time_taken_and_faster_allowed(rng, texts):
    return time_taken_from_one_part_for_another(rng, unbound(texts))


@fault
def kink_and_faster_allowed(rng, texts):
    return kink_between_two_poses(rng, unbound(texts))


@fault
def point_moved_and_faster_allowed(rng, texts):
    return point_moved(rng, unbound(texts))


@fault
def slow_turning(rng, texts):
    """Slower than the points turn: they do not turn at all but for one."""
    rows = [re.sub(r"(ORI[12])=200.0", r"\1=0.1", row) for row in lines(texts)]
    at = pick(rng, points(rows))
    rows[at] = rotated(rng, rows[at], 0.5 * TOLERANCE)
    return put(texts, rows)


@fault
def joint_spline(rng, texts):
    return changed(texts, r"^SPLINE", "PTP_SPLINE")


@fault
def speed_with_the_block(rng, texts):
    return changed(texts, r"^SPLINE", "SPLINE WITH $VEL.CP=1.5")


@fault
def speed_with_a_point(rng, texts):
    rows = lines(texts)
    rows[pick(rng, points(rows))] += " WITH $VEL.CP=1.5"
    return put(texts, rows)


@rewrite
def parts_in_seconds(rng, texts):
    rows = lines(texts)
    seconds = float(rows[where(rows, "BLOCK END")[0]].split("= ")[1])
    for at in where(rows, "BLOCK PART"):
        rows[at] = scaled(rows[at], seconds / 100.0)
    return put(texts, rows)


@rewrite
def fewer_decimals_of_parts(rng, texts):
    rows = lines(texts)
    for at in where(rows, "BLOCK PART"):
        rows[at] = f"TIME_BLOCK PART = {float(rows[at].split('= ')[1]):.5f}"
    return put(texts, rows)


@rewrite
def small_letters(rng, texts):
    rows = [row.lower() if re.match("SPL|TIME|END.", row) else row for row in lines(texts)]
    return put(texts, rows)


@rewrite
def comments_and_blank_lines(rng, texts):
    return inserted(rng, texts, "", "; half of it", "")


@rewrite
def no_blanks_around_the_sign(rng, texts):
    rows = [row.replace(" = ", "=") if "BLOCK" in row else row for row in lines(texts)]
    return put(texts, rows)


@rewrite
def a_longer_time(rng, texts):
    rows = lines(texts)
    at = where(rows, "BLOCK END")[0]
    rows[at] = scaled(rows[at], 1.02)
    return put(texts, rows)


@rewrite
def a_point_more_on_the_way(rng, texts):
    """Half way between two points, on the circle through them but for a micrometre."""
    rows = lines(texts)
    at = pick(rng, points(rows))
    before, here, there, after = (pose_of(rows[k]) for k in (at - 2, at, at + 2, at + 4))
    middle = (9.0 * (here + there) - before - after) / 16.0
    fraction = 0.5 * float(rows[at + 3].split("= ")[1])
    new = [with_pose(rows[at], middle), f"TIME_BLOCK PART = {fraction:.8f}"]
    rows[at + 3] = f"TIME_BLOCK PART = {fraction:.8f}"
    return put(texts, [*rows[: at + 2], *new, *rows[at + 2 :]])


def instances(kinds, seeds):
    """(name, seed) of each."""
    return [(name, seed) for name in kinds for seed in seeds]


def apply_mutation(name, seed, texts):
    """Texts with a fault or rewrite."""
    table = MUTATORS if name in MUTATORS else REWRITES
    out = table[name](np.random.default_rng([seed, sum(map(ord, name))]), texts)
    assert out != texts, name
    return out
