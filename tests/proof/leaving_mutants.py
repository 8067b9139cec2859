"""Seeded faults in the surroundings of the motion, by kind.

They are first moves, power without motion, meetings with a time limit, and handlers. RAPID on a bent wire
(``small_job``), on one arm's bow (``straight_job``) and of two controllers (``handshake_job``); KRL
(``krl_job``).
"""

from __future__ import annotations

import re

from planner.languages.krl.writer import syntax
from tests.languages.krl import krl_edits
from tests.languages.rapid.rapid_edits import edit, lines, name, put, random_task, segment, timed
from tests.proof.registry import Table, mutator, pick

SMALL: Table = {}
STRAIGHT: Table = {}
SHAKEN: Table = {}
KRL: Table = {}
ATTRIBUTES = ("SYSMODULE", "NOVIEW", "NOSTEPIN", "VIEWONLY", "READONLY")
SIGNAL = "doWirePower"


def task_of(rng, texts):
    """A task that the texts have."""
    return random_task(rng) if name("Main", 2) in texts else 1


def replaced(rng, texts, task, kind, pattern, new, which=None):
    """One row of a module that matches, replaced by rows; ``which``: its number, else any."""
    rows = lines(texts, task, kind)
    found = [i for i, row in enumerate(rows) if re.search(pattern, row)]
    i = pick(rng, found) if which is None else found[which]
    made = new(rows[i])
    rows[i : i + 1] = [made] if isinstance(made, str) else made
    return put(texts, task, rows, kind)


# ---- moves whose start is not known, and all that go by joints ----------------------------------------

BY_JOINTS = r"^\s*MoveAbsJ"


def _first(rng, texts, new, which=0):
    """The first move of a task, or any that goes by joints, with other words for its speed."""
    task = task_of(rng, texts)
    return replaced(rng, texts, task, "Main", BY_JOINTS, lambda row: row.replace("v_entry", new), which)


@mutator("verify.unknown_start", SMALL, STRAIGHT)
def first_move_by_time(rng, texts):
    time = pick(rng, ["0.05", "0.5", "2", "30"])
    return _first(rng, texts, f"v_entry\\T:={time}")


@mutator("verify.unknown_start", SMALL, STRAIGHT)
def joint_move_by_time(rng, texts):
    return _first(rng, texts, f"v_entry\\T:={rng.uniform(0.05, 40.0):.2f}", None)


@mutator("verify.unknown_start", SMALL, STRAIGHT)
def first_move_faster(rng, texts):
    return _first(rng, texts, f"v_entry\\V:={rng.uniform(255.0, 5000.0):.0f}")


@mutator("verify.unknown_start", SMALL, STRAIGHT)
def other_speed(rng, texts):
    """A speed of the controller's own, which turns at 500 deg/s."""
    return _first(rng, texts, pick(rng, ["v5", "v50", "v200", "v300", "v1000", "vmax"]))


def _entry(rng, texts, numbers):
    file = name("Data", task_of(rng, texts))
    return edit(texts, file, "v_entry:=[250,45,250,45]", f"v_entry:=[{numbers}]")


@mutator("verify.unknown_start", SMALL, STRAIGHT)
def faster_entry(rng, texts):
    return _entry(rng, texts, f"{rng.uniform(251.0, 5000.0):.1f},45,250,45")


@mutator("verify.unknown_start", SMALL, STRAIGHT)
def whirling_entry(rng, texts):
    return _entry(rng, texts, f"250,{rng.uniform(46.0, 90.0):.1f},250,45")


@mutator("verify.unknown_start", SMALL, STRAIGHT)
def wrong_external_speeds(rng, texts):
    return _entry(rng, texts, pick(rng, ["250,45,0,45", "250,45,-1,45", "250,45,250,0", "250,45,9000,45"]))


@mutator("verify.unknown_start", SMALL, STRAIGHT)
def speed_of_another_name(rng, texts):
    task = task_of(rng, texts)
    row = f"CONST speeddata v_start:=[{rng.uniform(260, 900):.0f},45,250,45];\n  CONST jointtarget j_home"
    texts = edit(texts, name("Data", task), "CONST jointtarget j_home", row)
    return replaced(rng, texts, task, "Main", BY_JOINTS, lambda r: r.replace("v_entry", "v_start"), 0)


# ---- power while nothing moves ----------------------------------------


def _long(rng):
    return f"{10.0 ** rng.uniform(1.3, 3.5):.2f}"


@mutator("verify.power_idle", SMALL, STRAIGHT)
def heats_for_long(rng, texts):
    rows = lines(texts, 1, "Main")
    i = next(i for i, row in enumerate(rows) if f"SetDO {SIGNAL},1" in row)
    assert "WaitTime" in rows[i + 1]
    rows[i + 1] = f"    WaitTime {_long(rng)};"
    return put(texts, 1, rows, "Main")


def _insert_before(texts, task, row, what):
    return edit(texts, name("Main", task), f"    {row}", f"    {what}\n    {row}")


STATEMENTS = {
    1: ["WaitSyncTask meet_4,", "SyncMoveOn", "approach;", "link;", "retreat;", "SyncMoveOff"],
    2: ["WaitSyncTask meet_4,", "SyncMoveOn", "approach;", "link;", "retreat;", "SyncMoveOff"],
}
ALONE = ["approach;", "cut_top_in;", "retreat;"]


def _anywhere(rng, texts, what):
    """A statement at a place at which the power is on and the wire not in the foam, in any task."""
    if name("Main", 2) not in texts:
        return _insert_before(texts, 1, pick(rng, ALONE), what)
    task = random_task(rng)
    return _insert_before(texts, task, pick(rng, STATEMENTS[task]), what)


@mutator("verify.power_idle", SMALL, STRAIGHT)
def waits_with_power(rng, texts):
    return _anywhere(rng, texts, f"WaitTime {_long(rng)};")


@mutator("verify.power_idle", SMALL, STRAIGHT)
def waits_for_a_signal(rng, texts):
    limit = pick(rng, ["", "\\MaxTime:=5", "\\MaxTime:=3600"])
    return _anywhere(rng, texts, f"WaitDI diDoor,1{limit};")


@mutator("verify.power_idle", SMALL, STRAIGHT)
def waits_as_told_at_run_time(rng, texts):
    return _anywhere(rng, texts, "WaitTime 600*DInput(diSlow);")


@mutator("verify.power_idle", SMALL, STRAIGHT)
def loops_with_power(rng, texts):
    body = pick(rng, ["WaitTime 0.1;", "", 'TPWrite "Door?";'])
    return _anywhere(rng, texts, f"WHILE TestDI(diDoor) DO {body} ENDWHILE")


@mutator("verify.power_idle", SMALL, STRAIGHT)
def asks_sometimes(rng, texts):
    what = pick(rng, ['UIMsgBox "Go on?";', "WaitTime 60;", "WaitDI diDoor,1;"])
    return _anywhere(rng, texts, f"IF TestDI(diDoor) THEN {what} ENDIF")


@mutator("verify.power_idle", SMALL)
def the_other_task_asks(rng, texts):
    place = pick(rng, [place for place in STATEMENTS[2] if place != "SyncMoveOff"])
    return _insert_before(texts, 2, place, 'UIMsgBox "Is it clear?"\\Buttons:=btnOK\\Icon:=iconInfo;')


@mutator("verify.power_idle", STRAIGHT)
def asks_on_the_way(rng, texts):
    return _anywhere(rng, texts, 'UIMsgBox "Is it clear?"\\Buttons:=btnOK\\Icon:=iconInfo;')


@mutator("verify.power_idle", SMALL, STRAIGHT)
def stays_on_at_the_end(rng, texts):
    """It stays on behind the last move."""
    rows = lines(texts, 1, "Main")
    body = rows.index(next(row for row in rows if "PROC operation_1" in row))
    off = next(i for i in range(body, len(rows)) if f"SetDO {SIGNAL},0" in rows[i])
    rows.insert(off, f"    WaitTime {rng.uniform(2.0, 900.0):.1f};")
    return put(texts, 1, rows, "Main")


@mutator("verify.power_idle", SMALL)
def creeps(rng, texts):
    """A move in the air takes for ever."""
    air = [k for proc in ("approach", "retreat", "link") for k in segment(texts, proc)]
    return timed(texts, pick(rng, air), rng.uniform(300.0, 2000.0))


@mutator("verify.power_idle", SMALL, STRAIGHT)
def off_and_on_again(rng, texts):
    """Each time for no longer than it may."""
    rows = lines(texts, 1, "Main")
    i = next(i for i, row in enumerate(rows) if f"SetDO {SIGNAL},1" in row)
    again = [f"    SetDO {SIGNAL},0;", f"    WaitTime {rng.uniform(0.1, 20.0):.1f};", *rows[i : i + 2]]
    rows[i + 2 : i + 2] = int(rng.integers(1, 40)) * again
    return put(texts, 1, rows, "Main")


@mutator("verify.power_idle", SHAKEN)
def power_that_nobody_claims(rng, texts):
    file = "left/TandemMain_1.mod"
    texts = edit(texts, file, "    SingArea\\Off;", f"    SingArea\\Off;\n    SetDO {SIGNAL},0;")
    place = pick(rng, ["    WaitTime 1;", "    approach;", "    link;", "    retreat;"])
    return edit(texts, file, place, f"    SetDO {SIGNAL},1;\n{place}")


# ---- meetings ----------------------------------------


@mutator("verify.meeting_time", SMALL)
def meeting_with_a_limit(rng, texts):
    task, limit = random_task(rng), f"\\TimeOut:={pick(rng, [1, 30, 600, 86400])};"
    return replaced(rng, texts, task, "Main", r"WaitSyncTask|SyncMoveOn", lambda r: r.replace(";", limit))


@mutator("verify.meeting_time", SMALL)
def end_of_a_block_with_a_limit(rng, texts):
    limit = f"\\TimeOut:={pick(rng, [0.1, 60])};"
    return replaced(rng, texts, random_task(rng), "Main", r"SyncMoveOff", lambda r: r.replace(";", limit))


def _side(rng, kind):
    arm, task = pick(rng, [("left", 1), ("right", 2)])
    return f"{arm}/Tandem{kind}_{task}.mod"


def _limit(rng, texts, pattern, new):
    file = _side(rng, "Main")
    rows = texts[file].split("\n")
    i = pick(rng, [i for i, row in enumerate(rows) if re.search(pattern, row)])
    rows[i] = re.sub(r"\\MaxTime:=[\d.]+", new, rows[i])
    return {**texts, file: "\n".join(rows)}


BUSY = {"left": "right is (at|home)", "right": "left is (at|home)|the actions at this stop"}
"""Of an arm's meetings those before which the other one moves alone, or asks."""


@mutator("verify.meeting_time", SHAKEN)
def impatient(rng, texts):
    """Shorter than the other arm may need, or a person."""
    arm, task = pick(rng, [("left", 1), ("right", 2)])
    file = f"{arm}/TandemMain_{task}.mod"
    rows = texts[file].split("\n")
    meeting = pick(rng, [i for i, row in enumerate(rows) if re.search(f"Meeting: ({BUSY[arm]})", row)])
    i = next(i for i in range(meeting, len(rows)) if "WaitDI diPartner,1" in rows[i])
    rows[i] = re.sub(r"MaxTime:=\d+", f"MaxTime:={rng.uniform(0.5, 3500):.1f}", rows[i])
    return {**texts, file: "\n".join(rows)}


@mutator("verify.meeting_time", SHAKEN)
def hasty(rng, texts):
    return _limit(rng, texts, r"WaitDI", rf"\\MaxTime:={rng.uniform(0.1, 29.0):.2f}")


@mutator("verify.meeting_time", SHAKEN)
def waits_for_ever(rng, texts):
    return _limit(rng, texts, r"WaitDI", pick(rng, ["", r"\\MaxTime:=90000", r"\\MaxTime:=1000000"]))


# ---- leaving by the side ----------------------------------------


def _section(rng, texts, word):
    """Task, kind of module, rows and the row at which a section of a procedure begins, and its end."""
    task = task_of(rng, texts)
    kind = pick(rng, ["Main", "Cut1"])
    rows = lines(texts, task, kind)
    start = pick(rng, [i for i, row in enumerate(rows) if row.strip() == word])
    end = next(i for i in range(start, len(rows)) if rows[i].strip() in ("ENDPROC", "UNDO") and i > start)
    return task, kind, rows, start, end


@mutator("verify.undo", SMALL, STRAIGHT)
def no_undo(rng, texts):
    task, kind, rows, start, end = _section(rng, texts, "UNDO")
    del rows[start:end]
    return put(texts, task, rows, kind)


def _in_section(rng, texts, word, what, new):
    """A section with one of its rows changed; ``new``: rows in its place."""
    task, kind, rows, start, end = _section(rng, texts, word)
    i = next(i for i in range(start, end) if what in rows[i])
    rows[i : i + 1] = new(rows[i])
    return put(texts, task, rows, kind)


@mutator("verify.undo", SMALL, STRAIGHT)
def undo_leaves_power(rng, texts):
    new = pick(rng, [[], ['    TPWrite "Left.";'], [f"    IF TestDI(diDoor) SetDO {SIGNAL},0;"]])
    return _in_section(rng, texts, "UNDO", "SetDO", lambda row: new)


@mutator("verify.hidden", SMALL, STRAIGHT)
def undo_switches_on(rng, texts):
    return _in_section(rng, texts, "UNDO", "SetDO", lambda row: [row, row.replace(",0;", ",1;")])


@mutator("verify.undo", SMALL, STRAIGHT)
def undo_is_late(rng, texts):
    new = "SetDO\\SDelay:=2,"
    return _in_section(rng, texts, "UNDO", "SetDO", lambda row: [row.replace("SetDO ", new)])


@mutator("verify.undo", SMALL)
def undo_stays_in_the_block(rng, texts):
    return _in_section(rng, texts, "UNDO", "SyncMoveUndo", lambda row: [])


@mutator("verify.undo", SMALL)
def undo_the_other_way_round(rng, texts):
    task, kind, rows, start, end = _section(rng, texts, "UNDO")
    i = next(i for i in range(start, end) if "SetDO" in rows[i])
    rows[i], rows[i + 1] = rows[i + 1], rows[i]
    return put(texts, task, rows, kind)


@mutator("verify.error_handler", SMALL, STRAIGHT)
def handler_only_ends(rng, texts):
    task, kind, rows, start, end = _section(rng, texts, "ERROR")
    rows[start + 1 : end] = ["    EXIT;"]
    return put(texts, task, rows, kind)


@mutator("verify.error_handler", SMALL, STRAIGHT)
def handler_tells_nobody(rng, texts):
    task, kind, rows, start, end = _section(rng, texts, "ERROR")
    rows[start:end] = [row for row in rows[start:end] if "TPWrite" not in row]
    return put(texts, task, rows, kind)


@mutator("verify.error_handler", SMALL, STRAIGHT)
def handler_ends_at_once(rng, texts):
    """It ends the program, which a controller that repeats its programs then starts again."""
    task, kind, rows, start, end = _section(rng, texts, "ERROR")
    rows[start:end] = [row for row in rows[start:end] if not re.match(r"\s*Stop\b", row)]
    return put(texts, task, rows, kind)


@mutator("verify.error_handler", SMALL)
def handler_stops_itself_alone(rng, texts):
    return _in_section(rng, texts, "ERROR", "Stop\\AllMoveTasks", lambda row: ["    Stop;"])


@mutator("verify.error_handler", SMALL, STRAIGHT)
def handler_stops_late(rng, texts):
    first = pick(rng, ["    WaitTime 20;", '    UIMsgBox "An error.";', '    TPWrite "An error.";'])
    return _in_section(rng, texts, "ERROR", "StopMove", lambda row: [first, row])


@mutator("verify.error_handler", SMALL, STRAIGHT)
def handler_stops_sometimes(rng, texts):
    return _in_section(rng, texts, "ERROR", "StopMove", lambda row: [f"    IF ERRNO=1 {row.strip()}"])


@mutator("verify.hidden", SMALL, STRAIGHT)
def module_with_attributes(rng, texts):
    kind, task = pick(rng, ["Main", "Cut1", "Data"]), task_of(rng, texts)
    words = ",".join(rng.permutation(ATTRIBUTES)[: int(rng.integers(1, 3))].tolist())
    head = f"MODULE Tandem{kind}_{task}"
    return edit(texts, name(kind, task), head, f"{head}({words})")


@mutator("verify.hidden", SMALL, STRAIGHT)
def system_module(rng, texts):
    """A file that the list of the program's modules takes for one of them."""
    file = name(pick(rng, ["Main", "Cut1", "Data"]), task_of(rng, texts))
    return {path.replace(".mod", ".sys") if path == file else path: text for path, text in texts.items()}


@mutator("verify.zone_kind", SMALL)
def stop_by_another_name(rng, texts):
    """A zone of one's own that stops, or the other way round."""
    task = random_task(rng)
    finep, old = pick(rng, [("TRUE", "z5mm"), ("FALSE", "fine")])
    row = f"CONST zonedata z_own:=[{finep},0.5,0.5,0.5,0.05,0.5,0.05];\n  CONST zonedata z5mm"
    texts = edit(texts, name("Data", task), "CONST zonedata z5mm", row)
    return replaced(rng, texts, task, "Cut1", rf",{old},t_", lambda r: r.replace(f",{old},", ",z_own,"))


# ---- KRL ----------------------------------------


@mutator("verify.unknown_start", KRL)
def first_ptp_faster(rng, texts):
    """One axis, or all."""
    rows = krl_edits.rows_of(texts, krl_edits.MAIN)
    first = krl_edits.where(rows, r"^\$VEL_AXIS")[:6]
    fraction = int(rng.integers(11, 101))
    for i in first if rng.random() < 0.5 else [pick(rng, first)]:
        rows[i] = re.sub(r"=\d+", f"={fraction}", rows[i])
    return krl_edits.put(texts, krl_edits.MAIN, rows)


def _behind_on(rng, texts, new):
    rows = krl_edits.rows_of(texts, krl_edits.MAIN)
    i = pick(rng, krl_edits.where(rows, r"^\$OUT.*TRUE"))
    rows[i + 1 : i + 2] = new(rows[i + 1])
    return krl_edits.put(texts, krl_edits.MAIN, rows)


@mutator("verify.power_idle", KRL)
def krl_heats_for_long(rng, texts):
    return _behind_on(rng, texts, lambda row: [f"WAIT SEC {_long(rng)}"])


@mutator("verify.power_idle", KRL)
def krl_waits_again(rng, texts):
    return _behind_on(rng, texts, lambda row: [row, row, f"WAIT SEC {rng.uniform(2.0, 90.0):.1f}"])


@mutator("verify.power_idle", KRL)
def krl_asks_with_power(rng, texts):
    return _behind_on(rng, texts, lambda row: [row, *syntax.question_lines("Is the wire hot?", "krc4")])


@mutator("verify.power_idle", KRL)
def krl_stays_on_at_the_end(rng, texts):
    rows = krl_edits.rows_of(texts, krl_edits.MAIN)
    i = pick(rng, krl_edits.where(rows, r"^straight_\d"))
    rows.insert(i + 1, f"WAIT SEC {rng.uniform(2.0, 900.0):.1f}")
    return krl_edits.put(texts, krl_edits.MAIN, rows)
