"""Seeded faults in KRL texts, by kind.

Geometric faults are twice the tolerance that they violate: 0.2 mm and 0.2 degrees where 0.1 are claimed,
0.002 mm for frames.
"""

from __future__ import annotations

import re

import numpy as np
from scipy.spatial.transform import Rotation

from tests.languages.krl.krl_edits import (
    DATA,
    MAIN,
    MOVES,
    edit,
    moved,
    pose_of,
    put,
    rotated,
    rows_of,
    where,
    with_pose,
)
from tests.proof.registry import Table, into, pick

MUTATORS: Table = {}
mutator = into(MUTATORS)


# ---- text ----------------------------------------


@mutator("verify.syntax")
def misspelt(rng, texts):
    return edit(
        rng, texts, pick(rng, MOVES), "^SLIN", lambda row: row.replace("SLIN", pick(rng, ["LINS", "CIRC"]))
    )


@mutator("verify.syntax")
def other_dialect(rng, texts):
    return edit(rng, texts, pick(rng, MOVES), "^SLIN", lambda row: row.replace("SLIN", "LIN"))


@mutator("verify.syntax")
def by_joints(rng, texts):
    return edit(rng, texts, pick(rng, MOVES), "^SLIN", lambda row: row.replace("SLIN", "PTP"))


@mutator("verify.syntax")
def other_corner(rng, texts):
    new = pick(rng, [" C_DIS", " C_PTP", " C_VEL"])
    return edit(rng, texts, pick(rng, MOVES), "C_SPL$", lambda row: row.replace(" C_SPL", new))


@mutator("verify.syntax")
def lost_end(rng, texts):
    return edit(rng, texts, pick(rng, [MAIN, *MOVES]), "^END$", lambda row: "")


@mutator("verify.syntax")
def branch(rng, texts):
    return edit(rng, texts, MAIN, r"^straight_\d", lambda row: f"IF $IN[3] THEN\n{row}\nENDIF")


@mutator("verify.syntax")
def other_setting(rng, texts):
    new = pick(rng, ["$OV_PRO=50", "$ACC.CP=0.1", "$TOOL.X=5.0", "$VEL.CP=0.02 + 0.1"])
    return edit(rng, texts, pick(rng, MOVES), "^SLIN", lambda row: f"{new}\n{row}")


@mutator("verify.syntax")
def no_initmov(rng, texts):
    return edit(rng, texts, MAIN, "INITMOV", lambda row: "")


@mutator("verify.syntax")
def late_setting(rng, texts):
    """A file with moves that does not state one of its five settings."""
    file = pick(rng, MOVES)
    rows = rows_of(texts, file)
    name = pick(rng, [r"\$VEL.ORI1", r"\$VEL.ORI2", r"\$APO.CDIS", r"\$APO.CORI", r"\$VEL.CP"])
    rows.pop(where(rows, name)[0])
    return put(texts, file, rows)


@mutator("verify.syntax")
def no_start(rng, texts):
    return edit(rng, texts, MAIN, "^PTP p_", lambda row: "")


@mutator("verify.syntax")
def frame_later(rng, texts):
    """Another base between the start pose and the moves in it."""
    return edit(rng, texts, MAIN, r"^straight_\d", lambda row: f"$BASE=b_stock\n{row}")


@mutator("verify.declarations")
def undeclared(rng, texts):
    return edit(rng, texts, MAIN, r"^(PTP |\$BASE=|\$TOOL=|\$LOAD=)", lambda row: row + "_x")


@mutator("verify.declarations")
def lost_data(rng, texts):
    return edit(rng, texts, DATA, "^DECL (E6|LOAD|FRAME [bt]_)", lambda row: "")


@mutator("verify.declarations")
def no_tool_mode(rng, texts):
    return edit(rng, texts, MAIN, "IPO_MODE", lambda row: row.replace("#BASE", "#TCP"))


@mutator("verify.declarations")
def millimetres_a_second(rng, texts):
    """A speed in mm/s where m/s are meant."""
    file = pick(rng, MOVES)
    return edit(rng, texts, file, r"VEL\.CP", lambda row: f"$VEL.CP={1e3 * float(row.split('=')[1]):.5f}")


@mutator("verify.declarations")
def no_turn(rng, texts):
    return edit(rng, texts, DATA, "E6POS", lambda row: re.sub(r",T \d+", "", row))


@mutator("verify.names")
def double_name(rng, texts):
    return edit(rng, texts, DATA, "^DECL (E6|LOAD|FRAME)", lambda row: f"{row}\n{row}")


@mutator("verify.names")
def long_name(rng, texts):
    new = pick(rng, ["n" * 25, "halt", "lin", "straight_1"])
    return edit(rng, texts, DATA, "FRAME base_frame", lambda row: f"{row}\n{row.replace('base_frame', new)}")


@mutator("verify.line_length")
def long_line(rng, texts):
    return edit(rng, texts, pick(rng, MOVES), "^SLIN", lambda row: f"{row} ; {'x' * 150}")


def numeral(rng, texts, new, names="XYZAB"):
    """Texts with one number of a straight move rewritten by ``new``, a function of it as written."""
    name = pick(rng, names)

    def rewritten(row):
        return re.sub(rf"{name} (-?[\d.]+)", lambda found: f"{name} {new(found.group(1))}", row)

    return edit(rng, texts, pick(rng, MOVES), "^SLIN", rewritten)


@mutator("verify.syntax")
def number_of_another_base(rng, texts):
    new = pick(rng, ["'H{}'", "0x{}", "{}#", "16#{}", "%{}"])
    return numeral(rng, texts, lambda old: new.format(int(abs(float(old)))))


@mutator("verify.syntax")
def number_parted(rng, texts):
    new = pick(rng, ["- {}", "{} 5", "{}E", "{}.5", "{},5", "--{}", "+-{}", "{}mm", "{}+0.0", "1/{}", "${}"])
    return numeral(rng, texts, new.format)


@mutator("verify.decimals")
def number_of_no_float(rng, texts):
    new = pick(rng, ["1E39", "-4.0E+38", "9" * 60, "1E999", "3.5E38"])
    return numeral(rng, texts, lambda old: new)


@mutator("verify.follows")
def exponent_turned(rng, texts):
    """An exponent that has lost its sign, or got one."""
    return numeral(rng, texts, lambda old: f"{float(old):.6E}".replace("E+", "E-"), "Z")


@mutator("verify.files")
def other_name(rng, texts):
    return edit(rng, texts, pick(rng, MOVES), "^DEF", lambda row: row.replace("straight", "strait"))


@mutator("verify.files")
def stray_file(rng, texts):
    name = pick(rng, ["other.src", "left/other.mod", "left/config.txt", "right/straight.src"])
    return {**texts, name: texts[MAIN]}


@mutator("verify.declarations")
def lost_file(rng, texts):
    gone = pick(rng, [DATA, MAIN, *MOVES])
    return {name: text for name, text in texts.items() if name != gone}


@mutator("verify.digest")
def other_problem(rng, texts):
    return edit(rng, texts, DATA, "^problem_digest", lambda row: row.replace("cd34", "cd35", 1))


@mutator("verify.hidden")
def call_lost(rng, texts):
    return edit(rng, texts, MAIN, r"^straight_\d", lambda row: "")


@mutator("verify.syntax")
def call_twice(rng, texts):
    """From its own end a path does not go on to its beginning."""
    file = pick(rng, MOVES)
    name = file.removeprefix("left/").removesuffix(".src")
    return edit(rng, texts, file, "^END$", lambda row: f"{name}()\n{row}")


@mutator("verify.follows")
def calls_swapped(rng, texts):
    return {**texts, MAIN: _swapped(texts[MAIN], "straight_1()", "straight_2()")}


def _swapped(text, a, b):
    return text.replace(a, "\0").replace(b, a).replace("\0", b)


# ---- setups and signals ----------------------------------------


@mutator("verify.setup")
def other_question(rng, texts):
    return edit(rng, texts, MAIN, r"\"Setup \d", lambda row: row.replace("done", "ready"))


@mutator("verify.signals")
def other_output(rng, texts):
    return edit(
        rng, texts, MAIN, r"^\$OUT", lambda row: row.replace("17", pick(rng, ["1", "16", "18", "170"]))
    )


@mutator("verify.wire_power")
def not_switched_on(rng, texts):
    return edit(rng, texts, MAIN, r"^\$OUT.*TRUE", lambda row: "")


@mutator("verify.wire_power")
def not_switched_off(rng, texts):
    rows = rows_of(texts, MAIN)
    rows.pop(where(rows, r"^\$OUT.*FALSE")[int(rng.integers(1, 3))])
    return put(texts, MAIN, rows)


@mutator("verify.wire_power")
def cold(rng, texts):
    """The power comes on behind the cut."""
    rows = rows_of(texts, MAIN)
    i = pick(rng, where(rows, r"^straight_\d"))
    on = max(k for k in where(rows, r"^\$OUT.*TRUE") if k < i)
    rows.insert(i, rows.pop(on))
    return put(texts, MAIN, rows)


@mutator("verify.stop_before_logic")
def flies_into_logic(rng, texts):
    file = pick(rng, MOVES)
    rows = rows_of(texts, file)
    rows[where(rows, "^SLIN")[-1]] += " C_SPL"
    return put(texts, file, rows)


# ---- frames, tools, loads ----------------------------------------


@mutator("verify.work_object")
def wrong_base(rng, texts):
    return edit(rng, texts, MAIN, r"^\$BASE=b_stock_2", lambda row: "$BASE=b_stock")


@mutator("verify.work_object")
def base_off(rng, texts):
    return edit(rng, texts, DATA, "FRAME b_", lambda row: _bump(rng, row))


@mutator("verify.base_frames")
def foot_off(rng, texts):
    return edit(rng, texts, DATA, "FRAME base_frame", lambda row: _bump(rng, row))


@mutator("verify.tool_data")
def tool_off(rng, texts):
    return edit(rng, texts, DATA, "FRAME t_", lambda row: _bump(rng, row))


def _bump(rng, row):
    """A frame with one coordinate off by 0.002 mm, or one angle by 0.0002 deg."""
    name, size, decimals = pick(rng, [*((n, 0.002, 4) for n in "XYZ"), *((n, 0.0002, 6) for n in "ABC")])
    old = float(re.search(rf"\b{name} ([-\d.]+)", row).group(1))
    return re.sub(rf"\b{name} [-\d.]+", f"{name} {old + size * pick(rng, [-1, 1]):.{decimals}f}", row)


@mutator("verify.tool_data")
def wrong_tool(rng, texts):
    """The other operation's tool, with its load."""
    rows = rows_of(texts, MAIN)
    i = pick(rng, where(rows, r"^\$TOOL="))
    rows[i : i + 2] = [_swapped(row, "bow_400", "bow_300") for row in rows[i : i + 2]]
    return put(texts, MAIN, rows)


@mutator("verify.syntax")
def wrong_load(rng, texts):
    return edit(rng, texts, MAIN, r"^\$LOAD=", lambda row: _swapped(row, "l_bow_400", "l_bow_300"))


@mutator("verify.tool_data")
def wrong_mass(rng, texts):
    return edit(rng, texts, DATA, "LOAD", lambda row: re.sub(r"M ([\d.]+)", _increase_mass, row, count=1))


def _increase_mass(match):
    return f"M {float(match.group(1)) + 0.002:.3f}"


@mutator("verify.tool_data")
def centre_in_metres(rng, texts):
    return edit(rng, texts, DATA, "LOAD", lambda row: re.sub(r"Z (\d\d+\.\d+)", _to_metres, row, count=1))


def _to_metres(match):
    return f"Z {1e-3 * float(match.group(1)):.6f}"


# ---- poses ----------------------------------------


@mutator("verify.follows")
def pose_off(rng, texts):
    return edit(rng, texts, pick(rng, MOVES), "^SLIN", lambda row: moved(rng, row, 0.2))


@mutator("verify.follows")
def pose_turned(rng, texts):
    return edit(rng, texts, pick(rng, MOVES), "^SLIN", lambda row: rotated(rng, row, 0.2))


@mutator("verify.follows")
def start_off(rng, texts):
    return edit(rng, texts, DATA, "E6POS", lambda row: moved(rng, row, 0.2))


@mutator("verify.follows")
def start_turned(rng, texts):
    return edit(rng, texts, DATA, "E6POS", lambda row: rotated(rng, row, 0.2))


@mutator("verify.follows")
def missing_move(rng, texts):
    return edit(rng, texts, pick(rng, MOVES), "^SLIN", lambda row: "")


@mutator("verify.zero_length")
def doubled_move(rng, texts):
    return edit(rng, texts, pick(rng, MOVES), "^SLIN", lambda row: f"{row}\n{row}")


@mutator("verify.follows")
def swapped_moves(rng, texts):
    file = pick(rng, MOVES)
    rows = rows_of(texts, file)
    moves = where(rows, "^SLIN.*C_SPL")
    k = int(rng.integers(len(moves) - 1))
    a, b = moves[k], moves[k + 1]
    rows[a], rows[b] = rows[b], rows[a]
    return put(texts, file, rows)


@mutator("verify.follows")
def swapped_angles(rng, texts):
    def swap(row):
        place = pose_of(row)
        return with_pose(row, [*place[:3], place[5], place[4], place[3]])

    return edit(rng, texts, pick(rng, MOVES), "^SLIN", swap)


@mutator("verify.follows")
def fixed_axes(rng, texts):
    """Angles by the other order of turns: as if A, B, C were about x, y, z."""

    def other(row):
        place = pose_of(row)
        turn = Rotation.from_euler("ZYX", place[3:], degrees=True)
        return with_pose(row, [*place[:3], *turn.as_euler("XYZ", degrees=True)])

    return edit(rng, texts, pick(rng, MOVES), "^SLIN", other)


@mutator("verify.follows")
def radians(rng, texts):
    def convert(row):
        place = pose_of(row)
        return with_pose(row, [*place[:3], *np.deg2rad(place[3:])])

    return edit(rng, texts, pick(rng, MOVES), "^SLIN", convert)


@mutator("verify.follows")
def metres(rng, texts):
    def convert(row):
        place = pose_of(row)
        return with_pose(row, [*(1e-3 * place[:3]), *place[3:]])

    return edit(rng, texts, pick(rng, MOVES), "^SLIN", convert)


@mutator("verify.follows")
def sign_of_angle(rng, texts):
    def flip(row):
        place = pose_of(row)
        place[3] *= -1.0
        return with_pose(row, place)

    return edit(rng, texts, pick(rng, MOVES), "^SLIN", flip)


# ---- status, turn, joints ----------------------------------------


@mutator("verify.status")
def status_flipped(rng, texts):
    bit = 1 << int(rng.integers(3))
    return edit(rng, texts, DATA, "E6POS", lambda row: _flipped(row, "S", bit))


@mutator("verify.status")
def turn_flipped(rng, texts):
    bit = 1 << int(rng.integers(6))
    return edit(rng, texts, DATA, "E6POS", lambda row: _flipped(row, "T", bit))


def _flipped(row, name, bit):
    return re.sub(rf"\b{name} (\d+)", lambda found: f"{name} {int(found.group(1)) ^ bit}", row)


@mutator("verify.setup")
def home_off(rng, texts):
    axis = int(rng.integers(1, 7))
    return edit(rng, texts, DATA, "x_home", lambda row: re.sub(rf"A{axis} ([-\d.]+)", _increase, row))


def _increase(match):
    name = match.group(0).split()[0]
    return f"{name} {float(match.group(1)) + 0.02:.6f}"


@mutator("verify.setup")
def joint_sign(rng, texts):
    axis = pick(rng, [2, 3, 5, 6])
    return edit(rng, texts, DATA, "x_home", lambda row: re.sub(rf"A{axis} ([-\d.]+)", _negate, row))


def _negate(match):
    name = match.group(0).split()[0]
    return f"{name} {-float(match.group(1)):.6f}"


@mutator("verify.continuity")
def not_home(rng, texts):
    rows = rows_of(texts, MAIN)
    homes = where(rows, "^PTP x_home")
    rows.pop(homes[pick(rng, [0, -1])])
    return put(texts, MAIN, rows)


@mutator("verify.move_kinds")
def external_axis(rng, texts):
    return edit(rng, texts, DATA, "E6", lambda row: row.replace("E1 0.0", "E1 5.0"))


# ---- speeds and corners ----------------------------------------


@mutator("verify.feed")
def faster(rng, texts):
    return _paced(rng, texts, rng.uniform(2.2, 5.0))


@mutator("verify.feed")
def slower(rng, texts):
    return _paced(rng, texts, rng.uniform(0.1, 0.3))


def _paced(rng, texts, factor):
    """All speeds of one cut with a factor."""
    file = pick(rng, MOVES)
    rows = rows_of(texts, file)
    for i in where(rows, r"^\$VEL\.CP"):
        rows[i] = f"$VEL.CP={min(factor * float(rows[i].split('=')[1]), 0.24):.8f}"
    return put(texts, file, rows)


@mutator("verify.feed")
def slow_turns(rng, texts):
    """A turning speed that holds the moves back."""
    file = pick(rng, MOVES)
    rows = rows_of(texts, file)
    for i in where(rows, r"^\$VEL\.ORI"):
        rows[i] = rows[i].split("=")[0] + "=0.02"
    return put(texts, file, rows)


@mutator("verify.tcp_speed")
def full_speed(rng, texts):
    rows = rows_of(texts, MAIN)
    for i in where(rows, r"^\$VEL_AXIS"):
        rows[i] = rows[i].split("=")[0] + "=100"
    return put(texts, MAIN, rows)


@mutator("verify.zone_size")
def wide_corner(rng, texts):
    return edit(rng, texts, pick(rng, MOVES), r"^\$APO\.CDIS=[1-3]\.\d", lambda row: "$APO.CDIS=10.0")
