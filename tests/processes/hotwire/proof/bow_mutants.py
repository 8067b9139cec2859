"""Seeded faults in the texts of the jobs with a bow (``straight_job`` and ``held_job``), by kind.

Geometric faults are at least twice the tolerance that they violate.
"""

from __future__ import annotations

import re

import numpy as np

from tests.languages.rapid.rapid_edits import edit, name
from tests.processes.hotwire.proof.bow_edits import (
    PROCS,
    SIGNAL,
    change,
    cutting,
    faces,
    field,
    moves,
    outwards,
    placed,
    pose_of,
    put,
    rows_of,
    slid,
    tasks,
    tilted,
    timed,
)
from tests.proof.registry import Table, Texts, mutator, pick

STRAIGHT: Table = {}
HELD: Table = {}


BOTH = (STRAIGHT, HELD)


# ---- setups ----------------------------------------


def question(rows: list[str], number: int) -> tuple[int, int]:
    """First and last row of the box that confirms a setup."""
    first = next(i for i, row in enumerate(rows) if f"Setup {number} done as instructed" in row)
    last = next(i for i in range(first, len(rows)) if rows[i].rstrip().endswith(";"))
    return first, last


def with_main(texts: Texts, function) -> Texts:
    rows = rows_of(texts, 1, "Main")
    function(rows)
    return put(texts, 1, "Main", rows)


@mutator("verify.setup", *BOTH)
def nobody_confirms(rng, texts):
    def drop(rows):
        first, last = question(rows, int(rng.integers(1, 3)))
        del rows[first : last + 1]

    return with_main(texts, drop)


@mutator("verify.setup", *BOTH)
def confirmed_in_another_order(rng, texts):
    main = texts[name("Main", 1)]
    main = main.replace("Setup 1 done", "Setup # done").replace("Setup 2 done", "Setup 1 done")
    return {**texts, name("Main", 1): main.replace("Setup # done", "Setup 2 done")}


@mutator("verify.setup", *BOTH)
def confirmed_twice(rng, texts):
    def twice(rows):
        first, last = question(rows, int(rng.integers(1, 3)))
        rows[first:first] = rows[first : last + 1]

    return with_main(texts, twice)


@mutator("verify.setup", *BOTH)
def lookalike(rng, texts):
    k = int(rng.integers(1, 3))
    old = f"Setup {k} done as instructed, nobody in the cell?"
    new = pick(
        rng, [old.lower(), old.replace("?", "!"), old.replace("instructed", "instruct3d"), old + " Or is it?"]
    )
    return edit(texts, name("Main", 1), old, new)


@mutator("verify.setup", *BOTH)
def confirmed_in_passing(rng, texts):
    """The words stand in another question as well."""

    def also(rows):
        rows.insert(
            next(i for i, row in enumerate(rows) if "operation_1;" in row),
            f'    UIMsgBox "Setup {int(rng.integers(1, 3))} done as instructed, nobody in the cell? More.";',
        )

    return with_main(texts, also)


@mutator("verify.setup", *BOTH)
def confirmed_by_time(rng, texts):
    def hurry(rows):
        _first, last = question(rows, int(rng.integers(1, 3)))
        options = ["\\MaxTime:=5", "\\Buttons:=btnYesNo", "\\Buttons:=btnOKCancel"]
        rows[last] = f"        {pick(rng, options)}\\Icon:=iconInfo;"

    return with_main(texts, hurry)


@mutator("verify.setup", *BOTH)
def not_told(rng, texts):
    def silent(rows):
        first, _ = question(rows, int(rng.integers(1, 3)))
        rows.pop(first - 1)

    return with_main(texts, silent)


@mutator("verify.setup", *BOTH)
def wiped_away(rng, texts):
    def wipe(rows):
        first, _ = question(rows, int(rng.integers(1, 3)))
        rows.insert(first, "    TPErase;")

    return with_main(texts, wipe)


@mutator("verify.setup", *BOTH)
def confirmed_away_from_home(rng, texts):
    def stay(rows):
        first, _ = question(rows, 2)
        rows.pop(max(i for i in range(first) if "MoveAbsJ j_home" in rows[i]))

    return with_main(texts, stay)


@mutator("verify.setup", *BOTH)
def moves_before_it_is_confirmed(rng, texts):
    def late(rows):
        first, last = question(rows, pick(rng, [1, 2]))
        box = rows[first : last + 1]
        del rows[first : last + 1]
        at = next(i for i in range(first, len(rows)) if "MoveAbsJ" in rows[i])
        rows[at + 1 : at + 1] = box

    return with_main(texts, late)


# ---- tools and frames ----------------------------------------


@mutator("verify.tool_data", STRAIGHT)
def the_other_bow(rng, texts):
    """A move with the tool of the other setup."""
    kind = pick(rng, ["Main", "Cut1"])
    rows = rows_of(texts, 1, kind)
    if kind == "Main":
        _first, last = question(rows, 2)
        i = pick(rng, [k for k in range(last, len(rows)) if "MoveAbsJ" in rows[k]])
    else:
        i = pick(rng, moves(texts, 1, *PROCS))
    old, new = ("t_bow_400", "t_bow_300") if "t_bow_400" in rows[i] else ("t_bow_300", "t_bow_400")
    rows[i] = rows[i].replace(old, new)
    return put(texts, 1, kind, rows)


@mutator("verify.tool_data", *BOTH)
def another_tcp(rng, texts):
    task = pick(rng, tasks(texts))
    rows = rows_of(texts, task, "Data")
    i = pick(rng, [k for k, row in enumerate(rows) if "PERS tooldata" in row])
    rows[i] = re.sub(
        r"(\d+\.\d{4})\],\[1", lambda m: f"{float(m.group(1)) + pick(rng, [-1, 1]):.4f}],[1", rows[i], count=1
    )
    return put(texts, task, "Data", rows)


@mutator("verify.work_object", STRAIGHT)
def the_other_place(rng, texts):
    i = pick(rng, moves(texts, 1, *PROCS))
    old = field(texts, 1, i, "wobj")
    return change(texts, 1, i, wobj="w_stock" if old == "w_stock_2" else "w_stock_2")


@mutator("verify.work_object", STRAIGHT)
def block_elsewhere(rng, texts):
    rows = rows_of(texts, 1, "Data")
    i = pick(rng, [k for k, row in enumerate(rows) if "PERS wobjdata" in row])
    by = pick(rng, [-1.0, 1.0])
    rows[i] = re.sub(r"\[\[(-?\d+\.\d{4}),", lambda m: f"[[{float(m.group(1)) + by:.4f},", rows[i], count=1)
    return put(texts, 1, "Data", rows)


def _held_row(texts: Texts) -> tuple[list[str], int]:
    rows = rows_of(texts, 1, "Data")
    return rows, next(i for i, row in enumerate(rows) if "wobjdata w_held" in row)


@mutator("verify.held_frame", HELD)
def held_frame_off(rng, texts):
    """The carried frame off by a millimetre, in the user's or the object's part."""
    rows, i = _held_row(texts)
    numbers = list(re.finditer(r"-?\d+\.\d{4}(?=[,\]])", rows[i]))
    found = pick(rng, numbers)
    value = float(found.group()) + pick(rng, [-1.0, 1.0])
    rows[i] = f"{rows[i][: found.start()]}{value:.4f}{rows[i][found.end() :]}"
    return put(texts, 1, "Data", rows)


@mutator("verify.held_frame", HELD)
def held_by_another(rng, texts):
    rows, i = _held_row(texts)
    old, new = pick(rng, [('"ROB_2"', '"ROB_1"'), ('"ROB_2"', '"ROB_3"'), ('"ROB_2"', '""')])
    rows[i] = rows[i].replace(old, new)
    return put(texts, 1, "Data", rows)


@mutator("verify.held_frame", HELD)
def held_frame_stands(rng, texts):
    rows, i = _held_row(texts)
    new = pick(rng, ["[FALSE,TRUE,", "[TRUE,FALSE,", "[TRUE,TRUE,"])
    rows[i] = rows[i].replace("[FALSE,FALSE,", new, 1)
    return put(texts, 1, "Data", rows)


@mutator("verify.held_frame", HELD)
def held_and_standing_mixed(rng, texts):
    """A move of the one setup with the frame of the other, or in the world."""
    i = pick(rng, moves(texts, 1, *PROCS))
    held = field(texts, 1, i, "wobj") == "w_held"
    return change(texts, 1, i, wobj=pick(rng, ["w_stock_2", "wobj0"]) if held else "w_held")


@mutator("verify.load", HELD)
def load_not_known(rng, texts):
    """GripLoad of the block, or of nothing behind it, is missing."""
    rows = rows_of(texts, 2, "Main")
    if rng.random() < 0.5:
        rows.pop(next(i for i, row in enumerate(rows) if "GripLoad load_block" in row))
        return put(texts, 2, "Main", rows)
    i = next(i for i, row in enumerate(rows) if "GripLoad load0" in row)
    rows[i] = "    MoveAbsJ j_home\\NoEOffs,v_entry,fine,t_gripper_plate;"
    texts = put(texts, 2, "Main", rows)
    rows = rows_of(texts, 1, "Main")  # let it move alone
    at = next(i for i, row in enumerate(rows) if "MoveAbsJ j_2_entry_1" in row)
    moved = rows.pop(at)
    rows.insert(next(i for i in range(at, len(rows)) if "WaitSyncTask" in rows[i]) + 1, moved)
    return put(texts, 1, "Main", rows)


@mutator("verify.load", HELD)
def another_load(rng, texts):
    rows = rows_of(texts, 2, "Data")
    i = next(i for i, row in enumerate(rows) if "loaddata load_block" in row)
    mass, centre = re.search(r":=\[([\d.]+),\[([^\]]*)\]", rows[i]).groups()
    if rng.random() < 0.5:
        rows[i] = rows[i].replace(f":=[{mass}", f":=[{float(mass) * pick(rng, [0.5, 1.1, 10.0]):.4f}", 1)
    else:
        x, y, z = (float(v) for v in centre.split(","))
        rows[i] = rows[i].replace(f"[{centre}]", f"[{x:.3f},{y:.3f},{z + 5.0:.3f}]", 1)
    return put(texts, 2, "Data", rows)


@mutator("verify.load", HELD)
def load_too_late(rng, texts):
    rows = rows_of(texts, 2, "Main")
    i = next(i for i, row in enumerate(rows) if "GripLoad load_block" in row)
    if rng.random() < 0.5:
        rows.insert(next(k for k in range(i, len(rows)) if "SyncMoveOn" in rows[k]), rows[i])
    else:
        rows.insert(next(k for k, row in enumerate(rows) if "MoveAbsJ j_home" in row) + 1, rows[i])
        i += 1
    rows.pop(i)
    return put(texts, 2, "Main", rows)


@mutator("verify.rulings", HELD)
def cutter_alone(rng, texts):
    """The cutter's targets shifted in the held frame, while the holder goes on as before."""
    return outwards(texts, moves(texts, 1, "cut_end"), 0.6 * pick(rng, [-1.0, 1.0]))


@mutator("verify.joint_acceleration", HELD)
def holder_alone(rng, texts):
    """A target of the holder far away: the cutter goes along, but neither can so quickly."""
    i = pick(rng, moves(texts, 2, "cut_end_in", "cut_end", "cut_end_out"))
    position, rotation = pose_of(texts, 2, i)
    texts = placed(texts, 2, i, position + rng.choice([-1.0, 1.0], 3) * 120.0, rotation)
    return change(texts, 2, i, speed="v7000")


@mutator("verify.move_count", HELD)
def one_of_a_pair(rng, texts):
    task = pick(rng, [1, 2])
    rows = rows_of(texts, task, "Cut1")
    rows.pop(pick(rng, moves(texts, task, "approach", "cut_end_in", "cut_end", "cut_end_out", "retreat")))
    return put(texts, task, "Cut1", rows)


# ---- the wire ----------------------------------------


@mutator("verify.feed", *BOTH)
def a_target_left_out(rng, texts):
    face = pick(rng, faces(texts))
    place = int(rng.integers(1, len(moves(texts, 1, f"cut_{face}")) - 1))
    for task in tasks(texts):
        own = moves(texts, task, f"cut_{face}")
        if own:
            rows = rows_of(texts, task, "Cut1")
            rows.pop(own[place])
            texts = put(texts, task, "Cut1", rows)
    return texts


@mutator("verify.feed", *BOTH)
def too_fast(rng, texts):
    return timed(texts, cutting(rng, texts), 1.0 / rng.uniform(1.9, 3.0))


@mutator("verify.feed", *BOTH)
def too_slow(rng, texts):
    return timed(texts, cutting(rng, texts), rng.uniform(3.2, 6.0))


@mutator("verify.kerf", *BOTH)
def too_wide_a_slot(rng, texts):
    """Slow, though within the feed window: the slot is wider than wanted."""
    return timed(texts, cutting(rng, texts), rng.uniform(2.0, 2.3))


@mutator("verify.wire_power", *BOTH)
def power_after_entry(rng, texts):
    def late(rows):
        on = next(i for i, row in enumerate(rows) if f"SetDO {SIGNAL},1;" in row)
        del rows[on : on + 2]
        if rng.random() < 0.5:
            rows.insert(on, "    WaitTime 5;")

    return with_main(texts, late)


@mutator("verify.wire_power", *BOTH)
def never_off(rng, texts):
    def on(rows):
        ons = [i for i, row in enumerate(rows) if f"SetDO {SIGNAL},1;" in row]
        at = pick(rng, ons)
        rows.pop(next(i for i in range(at, len(rows)) if f"SetDO {SIGNAL},0;" in rows[i]))

    return with_main(texts, on)


@mutator("verify.wire_power", *BOTH)
def cold(rng, texts):
    """The power comes on when the wire is already on its way in."""

    def hurry(rows):
        ons = [i for i, row in enumerate(rows) if f"SetDO {SIGNAL},1;" in row]
        on = pick(rng, ons)
        switch = rows.pop(on)
        into = next(i for i in range(on, len(rows)) if "_in;" in rows[i])
        rows.insert(into, switch)

    return with_main(texts, hurry)


@mutator("verify.signals", *BOTH)
def another_signal(rng, texts):
    old, new = pick(
        rng,
        [
            (f"SetDO {SIGNAL},1;", "SetDO doVacuum,0;"),
            (f"SetDO {SIGNAL},1;", f"SetDO\\SDelay:=0.5,{SIGNAL},1;"),
            ("WaitTime 2;", f"SetDO\\SDelay:=0.5,{SIGNAL},1; WaitTime 2;"),
        ],
    )
    return edit(texts, name("Main", 1), old, new)


@mutator("verify.bow", *BOTH)
def clamp_near_the_foam(rng, texts):
    """The bow slides along its wire until one clamp is a few millimetres off the foam."""
    face = pick(rng, faces(texts))
    half = {"top": 200.0, "end": 200.0, "back": 150.0 if "Tandem_2.pgf" not in str(sorted(texts)) else 200.0}
    inside = {"top": 40.0, "end": 80.0, "back": 80.0}
    by = half[face] - inside[face] - rng.uniform(2.0, 15.0)
    rows = moves(texts, 1, f"cut_{face}_in", f"cut_{face}", f"cut_{face}_out")
    return slid(texts, rows, by * pick(rng, [-1.0, 1.0]))


@mutator("verify.rulings", *BOTH)
def turned_ruling(rng, texts):
    angle = np.deg2rad({"top": 0.9, "end": 0.45, "back": 0.45}[(face := pick(rng, faces(texts)))])
    return tilted(texts, moves(texts, 1, f"cut_{face}"), angle * pick(rng, [-1.0, 1.0]))


@mutator("verify.rulings", *BOTH)
def one_end_off(rng, texts):
    """One guide line missed by 0.6 mm, the other one met."""
    half = {"top": 40.0, "end": 80.0, "back": 80.0}[(face := pick(rng, faces(texts)))]
    side = pick(rng, [-1.0, 1.0])
    return tilted(texts, moves(texts, 1, f"cut_{face}"), 0.6 / (2.0 * half) * pick(rng, [-1, 1]), side * half)


@mutator("verify.rulings", *BOTH)
def one_target_off(rng, texts):
    rows = cutting(rng, texts)
    k = int(rng.integers(1, len(rows) - 1))
    return outwards(texts, rows[k : k + 2], 0.6 * pick(rng, [-1.0, 1.0]))


@mutator("verify.surface", *BOTH)
def whole_face_off(rng, texts):
    return outwards(texts, cutting(rng, texts), 0.6 * pick(rng, [-1.0, 1.0]))


@mutator("verify.stop_in_foam", *BOTH)
def stops_in_foam(rng, texts):
    face = pick(rng, faces(texts))
    place = int(rng.integers(1, len(moves(texts, 1, f"cut_{face}")) - 1))
    for task in tasks(texts):
        own = moves(texts, task, f"cut_{face}")
        texts = change(texts, task, own[place], zone="fine") if own else texts
    return texts


@mutator("verify.contact", *BOTH)
def cut_by_another_name(rng, texts):
    """The cut under a name that no claim knows, so that nothing would look at it."""
    face = pick(rng, faces(texts))
    new = pick(rng, ["link_x", "cut_aside", f"cut_{face}_2", f"transit_{face}"])
    old = f"cut_{face}{pick(rng, ['', '_in', '_out'])}"
    for task in tasks(texts):
        for kind in ("Main", "Cut1"):
            text = texts[name(kind, task)].replace(f"PROC {old}()", f"PROC {new}()")
            texts = {**texts, name(kind, task): re.sub(rf"(?m)^(\s+){old};", rf"\g<1>{new};", text)}
    return texts


@mutator("verify.surface", *BOTH)
def cut_as_a_lead(rng, texts):
    """The face's own moves as part of the way in: allowed to cut, but not the face."""
    face = pick(rng, faces(texts))
    for task in tasks(texts):
        for kind in ("Main", "Cut1"):
            text = texts[name(kind, task)].replace(f"PROC cut_{face}()", f"PROC cut_{face}_in__2()")
            texts = {**texts, name(kind, task): text.replace(f" cut_{face};", f" cut_{face}_in__2;")}
    return texts


@mutator("verify.zone_size", *BOTH)
def wide_zone(rng, texts):
    face = pick(rng, faces(texts))
    place = int(rng.integers(0, len(moves(texts, 1, f"cut_{face}"))))
    for task in tasks(texts):
        own = moves(texts, task, f"cut_{face}")
        texts = change(texts, task, own[place], zone="z20") if own else texts
    return texts
