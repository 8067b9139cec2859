"""Faults put into program texts, by kind. Each mutator takes a generator of random numbers and the texts and
returns changed texts; it never returns texts that mean the same.

Geometric faults are twice the tolerance that they violate.
"""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np

from tests.verify.small_job import SIGNAL, TOLERANCE, ends, joints_at, problem

Texts = dict[str, str]
Mutator = Callable[[np.random.Generator, Texts], Texts]
TASKS = (1, 2)
MOVE = re.compile(
    r"MoveL \[\[(?P<pos>[^\]]*)\],\[(?P<orient>[^\]]*)\],\[(?P<conf>[^\]]*)\],\[(?P<ext>[^\]]*)\]\]"
    r"\\ID:=(?P<id>\d+),"
    r"(?P<speed>\w+)\\T:=(?P<time>[\d.]+),(?P<zone>\w+),(?P<tool>\w+)\\WObj:=(?P<wobj>\w+);"
)
MUTATORS: dict[str, tuple[str, Mutator]] = {}
FRAME = 2.0 * 0.001  # mm: twice the tolerance of written frames


def mutator(code: str) -> Callable[[Mutator], Mutator]:
    """Registers a mutator with the rule that is named for its fault (others may see it first)."""

    def register(function: Mutator) -> Mutator:
        MUTATORS[function.__name__] = (code, function)
        return function

    return register


def name(kind: str, task: int) -> str:
    """File name of a module."""
    return f"T_ROB{task}/Tandem{kind}_{task}.mod"


def edit(texts: Texts, file: str, old: str, new: str, count: int = 1) -> Texts:
    """Texts with ``old`` replaced; raises when it is not there."""
    assert old in texts[file], (file, old)
    return {**texts, file: texts[file].replace(old, new, count)}


def lines(texts: Texts, task: int, kind: str = "Cut1") -> list[str]:
    return texts[name(kind, task)].split("\n")


def put(texts: Texts, task: int, rows: list[str], kind: str = "Cut1") -> Texts:
    return {**texts, name(kind, task): "\n".join(rows)}


def moves(texts: Texts, task: int) -> list[int]:
    """Rows of the moves of the cut module."""
    return [i for i, row in enumerate(lines(texts, task)) if "MoveL" in row]


def segment(texts: Texts, proc: str, task: int = 1) -> list[int]:
    """Indices among the moves that belong to a procedure."""
    rows = lines(texts, task)
    out, here, k = [], "", 0
    for row in rows:
        found = re.search(r"PROC (\w+)", row)
        here = found.group(1) if found else here
        if "MoveL" in row:
            if here == proc:
                out.append(k)
            k += 1
    return out


def change(texts: Texts, task: int, k: int, **fields: str) -> Texts:
    """Texts with fields of move ``k`` of a task changed."""
    rows = lines(texts, task)
    i = moves(texts, task)[k]
    found = MOVE.search(rows[i])
    assert found is not None
    parts = {**found.groupdict(), **fields}
    rows[i] = (
        f"    MoveL [[{parts['pos']}],[{parts['orient']}],[{parts['conf']}],[{parts['ext']}]]"
        f"\\ID:={parts['id']},"
        f"{parts['speed']}\\T:={parts['time']},{parts['zone']},{parts['tool']}\\WObj:={parts['wobj']};"
    )
    return put(texts, task, rows)


def field(texts: Texts, task: int, k: int, which: str) -> str:
    found = MOVE.search(lines(texts, task)[moves(texts, task)[k]])
    assert found is not None
    return found.group(which)


def both(texts: Texts, k: int, function: Callable[[Texts, int, int], Texts]) -> Texts:
    for task in TASKS:
        texts = function(texts, task, k)
    return texts


def shifted(texts: Texts, task: int, k: int, by) -> Texts:
    position = np.array([float(v) for v in field(texts, task, k, "pos").split(",")]) + by
    return change(texts, task, k, pos=",".join(f"{v:.4f}" for v in position + 0.0))


def tilted(texts: Texts, task: int, k: int, degrees: float) -> Texts:
    """A tool turned about its own x axis at one target."""
    w, x, y, z = (float(v) for v in field(texts, task, k, "orient").split(","))
    c, s = np.cos(0.5 * np.deg2rad(degrees)), np.sin(0.5 * np.deg2rad(degrees))
    turned = np.array([w * c - x * s, x * c + w * s, y * c + z * s, z * c - y * s])
    return change(texts, task, k, orient=",".join(f"{v:.8f}" for v in turned + 0.0))


def timed(texts: Texts, k: int, factor: float) -> Texts:
    """Both moves' times scaled, with a speed that fits."""
    time = float(field(texts, 1, k, "time")) * factor
    return both(texts, k, lambda t, task, i: change(t, task, i, time=f"{time:.5f}", speed="v7000"))


def pick(rng: np.random.Generator, options):
    return options[int(rng.integers(len(options)))]


def one(rng: np.random.Generator) -> int:
    return int(rng.integers(1, 3))


def cutting(rng: np.random.Generator, texts: Texts) -> int:
    """A move that is well inside the block."""
    inside = segment(texts, pick(rng, ["cut_front", "cut_back"]))
    return pick(rng, [k for k in inside if abs(float(field(texts, 1, k, "pos").split(",")[1])) < 32.0])


# ---- text ----------------------------------------


@mutator("verify.syntax")
def no_semicolon(rng, texts):
    task = one(rng)
    rows = lines(texts, task)
    i = pick(rng, moves(texts, task))
    rows[i] = rows[i].rstrip(";")
    return put(texts, task, rows)


@mutator("verify.syntax")
def misspelt(rng, texts):
    task = one(rng)
    rows = lines(texts, task)
    i = pick(rng, moves(texts, task))
    rows[i] = rows[i].replace("MoveL", pick(rng, ["MovL", "Move", "MoveC"]))
    return put(texts, task, rows)


@mutator("verify.syntax")
def lost_end(rng, texts):
    file = name(pick(rng, ["Main", "Cut1", "Data"]), one(rng))
    return edit(texts, file, "ENDMODULE", "")


@mutator("verify.syntax")
def run_time_branch(rng, texts):
    task = one(rng)
    return edit(texts, name("Main", task), "cut_front;", "IF DOutput(doWirePower)=1 cut_front;")


@mutator("verify.declarations")
def undeclared(rng, texts):
    task = one(rng)
    k = int(rng.integers(len(moves(texts, task))))
    which = pick(rng, ["zone", "tool", "wobj", "speed"])
    return change(texts, task, k, **{which: field(texts, task, k, which) + "_x"})


@mutator("verify.declarations")
def lost_declaration(rng, texts):
    task = one(rng)
    rows = lines(texts, task, "Data")
    known = [
        i
        for i, row in enumerate(rows)
        if re.search(r"(CONST jointtarget|PERS wobj|PERS tool|VAR syncident)", row)
    ]
    rows.pop(pick(rng, known))
    return put(texts, task, rows, "Data")


@mutator("verify.pers_literal")
def pers_expression(rng, texts):
    task = one(rng)
    rows = lines(texts, task, "Data")
    i = next(i for i, row in enumerate(rows) if "PERS tooldata" in row)
    rows.insert(i, f"  PERS num extra:=1+{int(rng.integers(9))};")
    return put(texts, task, rows, "Data")


@mutator("verify.names")
def bad_name(rng, texts):
    task = one(rng)
    rows = lines(texts, task, "Data")
    i = next(i for i, row in enumerate(rows) if "PERS tooldata" in row)
    wrong = pick(rng, ["n" * 33, "while", "1st", "fine", "MoveL"])
    rows.insert(i, f"  CONST num {wrong}:=1;")
    return put(texts, task, rows, "Data")


@mutator("verify.names")
def double_name(rng, texts):
    task = one(rng)
    rows = lines(texts, task, "Data")
    known = [i for i, row in enumerate(rows) if "CONST" in row or "VAR" in row]
    i = pick(rng, known)
    rows.insert(i, rows[i])
    return put(texts, task, rows, "Data")


@mutator("verify.line_length")
def long_line(rng, texts):
    task = one(rng)
    rows = lines(texts, task)
    i = pick(rng, moves(texts, task))
    rows[i] += " ! " + "x" * 250
    return put(texts, task, rows)


@mutator("verify.module_size")
def huge(rng, texts):
    task = one(rng)
    rows = lines(texts, task)
    rows[1:1] = ["  ! " + "x" * 200] * 5200
    return put(texts, task, rows)


def numeral(rng, texts, new, parts=(0, 2)):
    """Texts with one number of a target rewritten by ``new``, a function of it as written; ``parts``: of its
    place."""
    task, k = one(rng), int(rng.integers(len(moves(texts, 1))))
    place = field(texts, task, k, "pos").split(",")
    i = pick(rng, parts)
    place[i] = new(place[i])
    return change(texts, task, k, pos=",".join(place))


@mutator("verify.names")
def number_of_another_base(rng, texts):
    new = pick(rng, ["0x{}", "0b{}", "0o{}", "0D{}", "{}h"])
    return numeral(rng, texts, lambda old: new.format(int(abs(float(old)))))


@mutator("verify.syntax")
def number_parted(rng, texts):
    new = pick(rng, ["{} 5", "{}+0.1", "1/({})", "({})*1.1", "{}!5", "{};", "{}-1E-9", "{} E2"])
    return numeral(rng, texts, new.format)


@mutator("verify.decimals")
def number_of_no_float(rng, texts):
    new = pick(rng, ["1E39", "-4E+38", "9" * 60, "1E999", "3.5E38", "{}E", "{}.5", "{}e+"])
    return numeral(rng, texts, lambda old: new.format(old.lstrip("-")))


@mutator("verify.speed_data")
def exponent_turned(rng, texts):
    """An exponent that has lost its sign, or got one."""
    return numeral(rng, texts, lambda old: f"{float(old):.6E}".replace("E+", "E-"), (0,))


@mutator("verify.decimals")
def not_a_unit(rng, texts):
    task, k = one(rng), int(rng.integers(len(moves(texts, 1))))
    factor = 1.0 + 10.0 ** rng.uniform(-4.9, -2)
    orient = [float(v) * factor for v in field(texts, task, k, "orient").split(",")]
    return change(texts, task, k, orient=",".join(f"{v:.8f}" for v in orient))


@mutator("verify.files")
def lost_file(rng, texts):
    gone = name(pick(rng, ["Main", "Cut1", "Data"]), one(rng))
    return {file: text for file, text in texts.items() if file != gone}


@mutator("verify.files")
def stray_file(rng, texts):
    return {**texts, f"other_{int(rng.integers(99))}.mod": "MODULE other\nENDMODULE\n"}


@mutator("verify.files")
def short_list(rng, texts):
    task = one(rng)
    file = f"T_ROB{task}/Tandem_{task}.pgf"
    rows = texts[file].split("\n")
    listed = [i for i, row in enumerate(rows) if "<Module>" in row]
    rows.pop(pick(rng, listed))
    return {**texts, file: "\n".join(rows)}


@mutator("verify.digest")
def other_problem(rng, texts):
    task = one(rng)
    rows = lines(texts, task, "Data")
    i = next(i for i, row in enumerate(rows) if "problem_digest" in row)
    rows[i] = rows[i].replace(pick(rng, ["ab12ab", "12ab12"]), "ffffff", 1)
    return put(texts, task, rows, "Data")


# ---- tasks side by side ----------------------------------------


@mutator("verify.task_list")
def lone_task(rng, texts):
    task = one(rng)
    rows = lines(texts, task, "Data")
    i = next(i for i, row in enumerate(rows) if "PERS tasks" in row)
    rows[i] = rows[i].replace("{2}", "{1}").replace('["T_ROB1"],["T_ROB2"]', f'["T_ROB{one(rng)}"]')
    return put(texts, task, rows, "Data")


def _sync_rows(texts: Texts, task: int) -> list[int]:
    return [
        i for i, row in enumerate(lines(texts, task, "Main")) if re.search(r"WaitSyncTask|SyncMoveO", row)
    ]


@mutator("verify.sync_order")
def swapped_meets(rng, texts):
    task = one(rng)
    rows = lines(texts, task, "Main")
    meets = [i for i in _sync_rows(texts, task) if "WaitSyncTask" in rows[i]]
    k = int(rng.integers(len(meets) - 1))
    a, b = meets[k], meets[k + 1]
    rows[a], rows[b] = rows[b], rows[a]
    return put(texts, task, rows, "Main")


@mutator("verify.sync_order")
def dropped_sync(rng, texts):
    task = one(rng)
    rows = lines(texts, task, "Main")
    rows.pop(pick(rng, _sync_rows(texts, task)))
    return put(texts, task, rows, "Main")


@mutator("verify.sync_order")
def reused_ident(rng, texts):
    for task in TASKS:
        texts = edit(texts, name("Main", task), "WaitSyncTask meet_2,", "WaitSyncTask meet_1,")
    return texts


@mutator("verify.sync_order")
def open_block(rng, texts):
    for task in TASKS:
        rows = lines(texts, task, "Main")
        i = next(i for i, row in enumerate(rows) if "SyncMoveOff" in row)
        rows.pop(i)
        texts = put(texts, task, rows, "Main")
    return texts


def _handler(texts: Texts, rng, task: int) -> tuple[str, list[str], int]:
    kind = pick(rng, ["Main", "Cut1"])
    rows = lines(texts, task, kind)
    heads = [i for i, row in enumerate(rows) if row.strip() == "ERROR"]
    return kind, rows, pick(rng, heads)


@mutator("verify.error_handler")
def handler_leaves_power(rng, texts):
    task = one(rng)
    kind, rows, i = _handler(texts, rng, task)
    rows.pop(i + 1)
    return put(texts, task, rows, kind)


@mutator("verify.error_handler")
def handler_late(rng, texts):
    task = one(rng)
    kind, rows, i = _handler(texts, rng, task)
    rows[i + 1], rows[i + 2] = rows[i + 2], rows[i + 1]
    return put(texts, task, rows, kind)


@mutator("verify.error_handler")
def handler_retries(rng, texts):
    task = one(rng)
    kind, rows, i = _handler(texts, rng, task)
    end = next(j for j in range(i, len(rows)) if rows[j].strip() == "EXIT;")
    rows[end] = pick(rng, ["    RETRY;", "    TRYNEXT;"])
    return put(texts, task, rows, kind)


@mutator("verify.error_handler")
def no_handler(rng, texts):
    task = one(rng)
    kind, rows, i = _handler(texts, rng, task)
    end = next(j for j in range(i, len(rows)) if rows[j].strip() in ("ENDPROC", "UNDO"))
    del rows[i:end]
    return put(texts, task, rows, kind)


@mutator("verify.error_handler")
def handler_does_not_stop(rng, texts):
    task = one(rng)
    kind, rows, i = _handler(texts, rng, task)
    end = next(j for j in range(i, len(rows)) if "StopMove" in rows[j])
    rows.pop(end)
    return put(texts, task, rows, kind)


@mutator("verify.motion_settings")
def slow_settings(rng, texts):
    task = one(rng)
    new = pick(rng, ["AccSet 50,100;", "VelSet 50,5000;", "AccSet 100,20;"])
    if new.endswith("20;"):
        new = "AccSet 20,20;"
    return edit(texts, name("Main", task), "SingArea\\Off;", f"SingArea\\Off; {new}")


@mutator("verify.move_count")
def dropped_move(rng, texts):
    task = one(rng)
    rows = lines(texts, task)
    rows.pop(pick(rng, moves(texts, task)))
    return put(texts, task, rows)


@mutator("verify.feed")
def dropped_pair(rng, texts):
    k = cutting(rng, texts)
    for task in TASKS:
        rows = lines(texts, task)
        rows.pop(moves(texts, task)[k])
        texts = put(texts, task, rows)
    return texts


@mutator("verify.move_ids")
def wrong_id(rng, texts):
    task, k = one(rng), int(rng.integers(len(moves(texts, 1))))
    ident = int(field(texts, task, k, "id"))
    return change(
        texts, task, k, id=str(max(1, ident + pick(rng, [-2, -1, 1, 2, 1000])) if ident > 2 else ident + 1000)
    )


@mutator("verify.move_ids")
def swapped_ids(rng, texts):
    k = int(rng.integers(len(moves(texts, 1)) - 1))
    for task in TASKS if rng.random() < 0.5 else (one(rng),):
        a, b = field(texts, task, k, "id"), field(texts, task, k + 1, "id")
        texts = change(change(texts, task, k, id=b), task, k + 1, id=a)
    return texts


@mutator("verify.move_ids")
def lost_id(rng, texts):
    task = one(rng)
    rows = lines(texts, task)
    i = pick(rng, moves(texts, task))
    rows[i] = re.sub(r"\\ID:=\d+", "", rows[i])
    return put(texts, task, rows)


@mutator("verify.move_ids")
def id_outside(rng, texts):
    task = one(rng)
    return edit(texts, name("Main", task), "MoveAbsJ j_home\\NoEOffs,", "MoveAbsJ j_home\\ID:=5\\NoEOffs,")


@mutator("verify.move_ids")
def duplicated_pair(rng, texts):
    k = int(rng.integers(len(moves(texts, 1))))
    for task in TASKS:
        rows = lines(texts, task)
        i = moves(texts, task)[k]
        rows.insert(i, rows[i])
        texts = put(texts, task, rows)
    return texts


@mutator("verify.zero_length")
def duplicated_place(rng, texts):
    """A pair that goes nowhere, with IDs in order."""
    k = int(rng.integers(len(moves(texts, 1))))
    for task in TASKS:
        rows = lines(texts, task)
        i = moves(texts, task)[k]
        rows.insert(i, rows[i])
        texts = put(texts, task, rows)
        for n in range(len(moves(texts, task))):
            texts = change(texts, task, n, id=str(10 * (n + 1)))
    return texts


@mutator("verify.zone_kind")
def one_stops(rng, texts):
    task = one(rng)
    k = pick(rng, [k for k in range(len(moves(texts, 1))) if field(texts, task, k, "zone") != "fine"])
    return change(texts, task, k, zone="fine")


@mutator("verify.zone_kind")
def one_does_not_stop(rng, texts):
    task = one(rng)
    k = pick(rng, [k for k in range(len(moves(texts, 1))) if field(texts, task, k, "zone") == "fine"])
    return change(texts, task, k, zone="z0")


@mutator("verify.move_time")
def wrong_time(rng, texts):
    task, k = one(rng), int(rng.integers(len(moves(texts, 1))))
    time = float(field(texts, task, k, "time"))
    return change(texts, task, k, time=f"{time * rng.uniform(0.3, 0.95):.5f}", speed="v7000")


@mutator("verify.move_time")
def no_time(rng, texts):
    task = one(rng)
    rows = lines(texts, task)
    i = pick(rng, moves(texts, task))
    rows[i] = re.sub(r"\\T:=[\d.]+", "", rows[i])
    return put(texts, task, rows)


@mutator("verify.speed_data")
def slow_speed(rng, texts):
    task, k = one(rng), int(rng.integers(1, len(moves(texts, 1))))
    if _fast(texts, task, k):
        return change(texts, task, k, speed="v5")
    return both(texts, k, lambda t, arm, i: change(t, arm, i, time="0.01000"))


def _fast(texts: Texts, task: int, k: int) -> bool:
    a, b = (np.array([float(v) for v in field(texts, task, i, "pos").split(",")]) for i in (k - 1, k))
    return float(np.linalg.norm(b - a)) / float(field(texts, task, k, "time")) > 5.2


@mutator("verify.arms_alone")
def both_at_once(rng, texts):
    rows = lines(texts, 2, "Main")
    i = next(i for i, row in enumerate(rows) if "WaitSyncTask meet_2" in row)
    rows.insert(i, "    MoveAbsJ j_home\\NoEOffs,v_entry,fine,tool_x;".replace("tool_x", _tool(texts, 2)))
    return put(texts, 2, rows, "Main")


def _tool(texts: Texts, task: int) -> str:
    return field(texts, task, 0, "tool")


@mutator("verify.wire_alone")
def lone_with_wire(rng, texts):
    """An arm moves alone while the operator is at the mounted wire."""
    rows = lines(texts, 1, "Main")
    places = [i for i, row in enumerate(rows) if "WaitTime 10;" in row]
    row = f"    MoveAbsJ j_home\\NoEOffs,v_entry,fine,{_tool(texts, 1)};"
    back = f"    MoveAbsJ j_1_start\\NoEOffs,v_entry,fine,{_tool(texts, 1)};"
    i = pick(rng, places)
    rows[i:i] = [row, back]
    return put(texts, 1, rows, "Main")


@mutator("verify.stop_before_logic")
def flies_into_logic(rng, texts):
    last = len(moves(texts, 1)) - 1
    if rng.random() < 0.5:
        return both(texts, last, lambda t, task, k: change(t, task, k, zone="z0"))
    task = one(rng)
    rows = lines(texts, task, "Main")
    alone = [i for i, row in enumerate(rows) if "MoveAbsJ" in row and "MoveAbsJ" not in rows[i + 1]]
    i = pick(rng, alone)
    rows[i] = rows[i].replace("fine", "z10")
    return put(texts, task, rows, "Main")


# ---- data ----------------------------------------


def _data_row(texts: Texts, task: int, what: str) -> tuple[list[str], int]:
    rows = lines(texts, task, "Data")
    return rows, next(i for i, row in enumerate(rows) if what in row)


def _bump(row: str, rng, size: float) -> str:
    """The first position in a row, one coordinate off by ``size`` mm."""
    found = re.search(r"\[\[(-?[\d.]+),(-?[\d.]+),(-?[\d.]+)\]", row)
    assert found is not None
    values = [float(v) for v in found.groups()]
    values[int(rng.integers(3))] += size * pick(rng, [-1.0, 1.0])
    return row[: found.start()] + "[[" + ",".join(f"{v + 0.0:.4f}" for v in values) + "]" + row[found.end() :]


@mutator("verify.tool_data")
def wrong_tcp(rng, texts):
    task = one(rng)
    rows, i = _data_row(texts, task, "PERS tooldata")
    rows[i] = _bump(rows[i], rng, FRAME)
    return put(texts, task, rows, "Data")


@mutator("verify.tool_data")
def wrong_mass(rng, texts):
    task = one(rng)
    rows, i = _data_row(texts, task, "PERS tooldata")
    rows[i] = re.sub(r"\]\],\[([\d.]+),", lambda m: f"]],[{float(m.group(1)) + 0.002:.3f},", rows[i], count=1)
    return put(texts, task, rows, "Data")


@mutator("verify.tool_data")
def not_held(rng, texts):
    task = one(rng)
    rows, i = _data_row(texts, task, "PERS tooldata")
    rows[i] = rows[i].replace("[TRUE", "[FALSE", 1)
    return put(texts, task, rows, "Data")


@mutator("verify.tool_data")
def no_tool(rng, texts):
    task, k = one(rng), int(rng.integers(len(moves(texts, 1))))
    return change(texts, task, k, tool="tool0")


@mutator("verify.work_object")
def wrong_work_object(rng, texts):
    for task in TASKS if rng.random() < 0.5 else (one(rng),):
        state = np.random.default_rng(int(rng.integers(2**31))) if task == 1 else rng
        rows, i = _data_row(texts, task, "PERS wobjdata")
        rows[i] = _bump(rows[i], state, FRAME)
        texts = put(texts, task, rows, "Data")
    return texts


@mutator("verify.continuity")
def world_for_stock(rng, texts):
    task, k = one(rng), int(rng.integers(len(moves(texts, 1))))
    return change(texts, task, k, wobj="wobj0")


@mutator("verify.base_frames")
def wrong_base(rng, texts):
    task = one(rng)
    rows, i = _data_row(texts, task, "base_frame")
    # a pose literal opens with two brackets as every position does
    rows[i] = _bump(rows[i], rng, FRAME)
    return put(texts, task, rows, "Data")


@mutator("verify.base_frames")
def no_base(rng, texts):
    task = one(rng)
    rows, i = _data_row(texts, task, "CONST pose base_frame")
    rows.pop(i)
    return put(texts, task, rows, "Data")


@mutator("verify.move_kinds")
def joint_path(rng, texts):
    k = int(rng.integers(len(moves(texts, 1))))
    for task in TASKS if rng.random() < 0.5 else (one(rng),):
        rows = lines(texts, task)
        i = moves(texts, task)[k]
        rows[i] = rows[i].replace("MoveL", "MoveJ")
        texts = put(texts, task, rows)
    return texts


@mutator("verify.move_kinds")
def free_configuration(rng, texts):
    task = one(rng)
    new = pick(rng, ["ConfL\\Off;", ""])
    return edit(texts, name("Main", task), "ConfL\\On;", new)


@mutator("verify.move_kinds")
def external_axis(rng, texts):
    task, k = one(rng), int(rng.integers(len(moves(texts, 1))))
    return change(texts, task, k, ext=f"{rng.uniform(0, 100):.2f},9E9,9E9,9E9,9E9,9E9")


@mutator("verify.zone_size")
def wide_zone(rng, texts):
    k = pick(rng, [k for k in range(len(moves(texts, 1))) if field(texts, 1, k, "zone") != "fine"])
    wide = pick(rng, ["z20", "z30", "z50"])
    return both(texts, k, lambda t, task, i: change(t, task, i, zone=wide))


# ---- motion ----------------------------------------


@mutator("verify.confdata")
def wrong_quadrant(rng, texts):
    task, k = one(rng), int(rng.integers(len(moves(texts, 1))))
    conf = [int(v) for v in field(texts, task, k, "conf").split(",")]
    conf[int(rng.integers(3))] += pick(rng, [-4, -2, -1, 1, 2, 4])
    return change(texts, task, k, conf=",".join(map(str, conf)))


@mutator("verify.confdata")
def wrong_posture(rng, texts):
    task, k = one(rng), int(rng.integers(len(moves(texts, 1))))
    conf = [int(v) for v in field(texts, task, k, "conf").split(",")]
    conf[3] = pick(rng, [c for c in range(8) if c != conf[3]])
    return change(texts, task, k, conf=",".join(map(str, conf)))


@mutator("verify.reach")
def out_of_reach(rng, texts):
    k = int(rng.integers(len(moves(texts, 1))))
    task = one(rng)
    away = np.array([-1.0 if task == 2 else 1.0, 0.0, 0.0]) * rng.uniform(500.0, 900.0)
    return change(shifted(texts, task, k, away), task, k, speed="v7000")


@mutator("verify.joint_limits")
def beyond_limits(rng, texts):
    """An axis of a waypoint beyond its limit by two degrees or more."""
    task = one(rng)
    rows, i = _data_row(texts, task, "j_1_entry_1")
    values = [float(v) for v in re.search(r"\[\[([^\]]*)\]", rows[i]).group(1).split(",")]
    axis, value = pick(
        rng, [(0, 182.0), (1, 112.0), (2, 52.0), (3, 202.0), (4, 117.0), (4, -117.0), (5, 402.0)]
    )
    values[axis] = value + rng.uniform(0.0, 20.0) * np.sign(value)
    rows[i] = re.sub(r"\[\[[^\]]*\]", "[[" + ",".join(f"{v:.6f}" for v in values) + "]", rows[i], count=1)
    return put(texts, task, rows, "Data")


@mutator("verify.joint_acceleration")
def too_quick(rng, texts):
    """Times so short that speed or acceleration cannot be had."""
    air = [k for proc in ("approach", "retreat", "link") for k in segment(texts, proc)]
    return timed(texts, pick(rng, air), 1.0 / rng.uniform(20.0, 60.0))


@mutator("verify.clearance")
def entry_through_block(rng, texts):
    """A waypoint of the entry that leads an arm through the block."""
    task = one(rng)
    rows, i = _data_row(texts, task, "j_1_entry_1")
    arm = problem().cell.arms[task - 1]
    pose = ends(np.array([rng.uniform(-0.02, 0.02)]), False)[arm.name]
    pose[:, :3, 3] = [rng.uniform(-0.03, 0.03), rng.uniform(-0.02, 0.02), rng.uniform(0.03, 0.07)]
    into = np.rad2deg(joints_at(arm, pose)[0])
    rows[i] = re.sub(r"\[\[[^\]]*\]", "[[" + ",".join(f"{v:.6f}" for v in into) + "]", rows[i], count=1)
    return put(texts, task, rows, "Data")


# ---- process ----------------------------------------


def _main_row(texts: Texts, what: str, which: int = 0) -> tuple[list[str], int]:
    rows = lines(texts, 1, "Main")
    return rows, [i for i, row in enumerate(rows) if what in row][which]


def _box(rows: list[str], i: int) -> int:
    """Rows that a message box takes."""
    return next(j for j in range(i, len(rows)) if rows[j].rstrip().endswith(";")) - i + 1


@mutator("verify.wire_power")
def nobody_mounts(rng, texts):
    rows, i = _main_row(texts, '"Press OK when the wire is mounted."')
    del rows[i : i + _box(rows, i)]
    return put(texts, 1, rows, "Main")


@mutator("verify.wire_mount")
def nobody_takes_off(rng, texts):
    rows, i = _main_row(texts, '"Take the wire off, then press OK."')
    del rows[i : i + _box(rows, i)]
    return put(texts, 1, rows, "Main")


@mutator("verify.wire_power")
def never_on(rng, texts):
    rows, i = _main_row(texts, f"SetDO {SIGNAL},1;")
    if rng.random() < 0.5:
        rows.pop(i)
    else:
        rows[i] = rows[i].replace(",1;", ",0;")
    return put(texts, 1, rows, "Main")


@mutator("verify.wire_power")
def no_heat_up(rng, texts):
    rows, i = _main_row(texts, "WaitTime 10;")
    rows[i] = f"    WaitTime {rng.uniform(0.2, 2.0):.2f};"
    return put(texts, 1, rows, "Main")


@mutator("verify.wire_power")
def never_off(rng, texts):
    rows, at = _main_row(texts, "SyncMoveOff")
    i = next(j for j in range(at, len(rows)) if f"SetDO {SIGNAL},0;" in rows[j])
    rows.pop(i)
    return put(texts, 1, rows, "Main")


@mutator("verify.wire_power")
def off_too_early(rng, texts):
    place = pick(rng, ["    cut_front;", "    link;", "    cut_back;"])
    return edit(texts, name("Main", 1), place, f"    SetDO {SIGNAL},0;\n{place}")


@mutator("verify.contact")
def cuts_in_transit(rng, texts):
    old = pick(rng, ["cut_front", "cut_back"])
    for task in TASKS:
        for kind in ("Main", "Cut1"):
            text = (
                texts[name(kind, task)]
                .replace(f"PROC {old}()", "PROC transit()")
                .replace(f"{old};", "transit;")
            )
            texts = {**texts, name(kind, task): text}
    return texts


@mutator("verify.stop_in_foam")
def stops_in_foam(rng, texts):
    k = cutting(rng, texts)
    return both(texts, k, lambda t, task, i: change(t, task, i, zone="fine"))


@mutator("verify.feed")
def too_fast(rng, texts):
    return timed(texts, cutting(rng, texts), 1.0 / rng.uniform(2.0, 4.0))


@mutator("verify.feed")
def too_slow(rng, texts):
    return timed(texts, cutting(rng, texts), rng.uniform(4.5, 9.0))


@mutator("verify.wire_length")
def torn(rng, texts):
    """The ends farther apart than the wire is long."""
    air = [k for proc in ("approach", "retreat", "link") for k in segment(texts, proc)]
    k = pick(rng, air)
    task = one(rng)
    away = 2.0 * 18.5 * (-1.0 if task == 1 else 1.0)
    return timed(shifted(texts, task, k, np.array([away, 0.0, 0.0])), k, 4.0)


@mutator("verify.ridge")
def moved_pair(rng, texts):
    """Both ends off by twice the tolerance of the surface at one target."""
    k = cutting(rng, texts)
    by = np.array([0.0, 0.0, 2.0 * TOLERANCE * 1e3 * pick(rng, [-1.0, 1.0])])
    return both(texts, k, lambda t, task, i: shifted(t, task, i, by))


@mutator("verify.surface")
def moved_face(rng, texts):
    """A whole face off by twice the tolerance."""
    proc = pick(rng, ["cut_front", "cut_back"])
    by = np.array([0.0, 0.0, 2.0 * TOLERANCE * 1e3 * pick(rng, [-1.0, 1.0])])
    for k in segment(texts, proc):
        texts = both(texts, k, lambda t, task, i: shifted(t, task, i, by))
    return texts


@mutator("verify.ridge")
def turned_end(rng, texts):
    """One end turned at one target by so much that the middle of the wire moves by twice the tolerance or
    more."""
    k, task = cutting(rng, texts), one(rng)
    # an end turned by 0.024 rad about the section normal moves this wire by 0.53 mm inside the block
    angle = 48.0 * 2.0 * TOLERANCE * pick(rng, [-1.0, 1.0])
    w, x, y, z = (float(v) for v in field(texts, task, k, "orient").split(","))
    c, s = np.cos(0.5 * angle), np.sin(0.5 * angle)
    q = np.array([w * c - z * s, x * c + y * s, y * c - x * s, z * c + w * s])
    return change(texts, task, k, orient=",".join(f"{v:.8f}" for v in q / np.linalg.norm(q)))


@mutator("verify.speed_data")
def swapped_targets(rng, texts):
    """Two neighbouring targets change places, on one arm or both."""
    k = pick(rng, [k for proc in ("cut_front", "cut_back") for k in segment(texts, proc)[1:-2]])
    for task in TASKS if rng.random() < 0.5 else (one(rng),):
        a = {f: field(texts, task, k, f) for f in ("pos", "orient", "conf")}
        b = {f: field(texts, task, k + 1, f) for f in ("pos", "orient", "conf")}
        texts = change(change(texts, task, k, **b), task, k + 1, **a)
    return texts
