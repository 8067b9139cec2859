"""Faults in the synchronisation of two tasks, by kind.

Each mutator takes a random generator and the texts and returns changed texts. It never returns texts with the
same meaning.
"""

from __future__ import annotations

import re

import numpy as np

from tests.languages.rapid.rapid_edits import (
    TASKS,
    both,
    change,
    cutting,
    edit,
    field,
    lines,
    moves,
    name,
    put,
    random_task,
)
from tests.proof.registry import Table, Texts, into, pick

TASKS_APART: Table = {}
mutator = into(TASKS_APART)


@mutator("verify.task_list")
def lone_task(rng, texts):
    task = random_task(rng)
    rows = lines(texts, task, "Data")
    i = next(i for i, row in enumerate(rows) if "PERS tasks" in row)
    rows[i] = rows[i].replace("{2}", "{1}").replace('["T_ROB1"],["T_ROB2"]', f'["T_ROB{random_task(rng)}"]')
    return put(texts, task, rows, "Data")


def _sync_rows(texts: Texts, task: int) -> list[int]:
    return [
        i for i, row in enumerate(lines(texts, task, "Main")) if re.search(r"WaitSyncTask|SyncMoveO", row)
    ]


@mutator("verify.sync_order")
def swapped_meets(rng, texts):
    task = random_task(rng)
    rows = lines(texts, task, "Main")
    meets = [i for i in _sync_rows(texts, task) if "WaitSyncTask" in rows[i]]
    k = int(rng.integers(len(meets) - 1))
    a, b = meets[k], meets[k + 1]
    rows[a], rows[b] = rows[b], rows[a]
    return put(texts, task, rows, "Main")


@mutator("verify.sync_order")
def dropped_sync(rng, texts):
    task = random_task(rng)
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
    task = random_task(rng)
    kind, rows, i = _handler(texts, rng, task)
    rows.pop(i + 1)
    return put(texts, task, rows, kind)


@mutator("verify.error_handler")
def handler_late(rng, texts):
    task = random_task(rng)
    kind, rows, i = _handler(texts, rng, task)
    rows[i + 1], rows[i + 2] = rows[i + 2], rows[i + 1]
    return put(texts, task, rows, kind)


@mutator("verify.error_handler")
def handler_retries(rng, texts):
    task = random_task(rng)
    kind, rows, i = _handler(texts, rng, task)
    end = next(j for j in range(i, len(rows)) if rows[j].strip() == "EXIT;")
    rows[end] = pick(rng, ["    RETRY;", "    TRYNEXT;"])
    return put(texts, task, rows, kind)


@mutator("verify.error_handler")
def no_handler(rng, texts):
    task = random_task(rng)
    kind, rows, i = _handler(texts, rng, task)
    end = next(j for j in range(i, len(rows)) if rows[j].strip() in ("ENDPROC", "UNDO"))
    del rows[i:end]
    return put(texts, task, rows, kind)


@mutator("verify.error_handler")
def handler_does_not_stop(rng, texts):
    task = random_task(rng)
    kind, rows, i = _handler(texts, rng, task)
    end = next(j for j in range(i, len(rows)) if "StopMove" in rows[j])
    rows.pop(end)
    return put(texts, task, rows, kind)


@mutator("verify.motion_settings")
def slow_settings(rng, texts):
    task = random_task(rng)
    new = pick(rng, ["AccSet 50,100;", "VelSet 50,5000;", "AccSet 100,20;"])
    if new.endswith("20;"):
        new = "AccSet 20,20;"
    return edit(texts, name("Main", task), "SingArea\\Off;", f"SingArea\\Off; {new}")


@mutator("verify.move_count")
def dropped_move(rng, texts):
    task = random_task(rng)
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
    task, k = random_task(rng), int(rng.integers(len(moves(texts, 1))))
    ident = int(field(texts, task, k, "id"))
    return change(
        texts, task, k, id=str(max(1, ident + pick(rng, [-2, -1, 1, 2, 1000])) if ident > 2 else ident + 1000)
    )


@mutator("verify.move_ids")
def swapped_ids(rng, texts):
    k = int(rng.integers(len(moves(texts, 1)) - 1))
    for task in TASKS if rng.random() < 0.5 else (random_task(rng),):
        a, b = field(texts, task, k, "id"), field(texts, task, k + 1, "id")
        texts = change(change(texts, task, k, id=b), task, k + 1, id=a)
    return texts


@mutator("verify.move_ids")
def lost_id(rng, texts):
    task = random_task(rng)
    rows = lines(texts, task)
    i = pick(rng, moves(texts, task))
    rows[i] = re.sub(r"\\ID:=\d+", "", rows[i])
    return put(texts, task, rows)


@mutator("verify.move_ids")
def id_outside(rng, texts):
    task = random_task(rng)
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
    task = random_task(rng)
    k = pick(rng, [k for k in range(len(moves(texts, 1))) if field(texts, task, k, "zone") != "fine"])
    return change(texts, task, k, zone="fine")


@mutator("verify.zone_kind")
def one_does_not_stop(rng, texts):
    task = random_task(rng)
    k = pick(rng, [k for k in range(len(moves(texts, 1))) if field(texts, task, k, "zone") == "fine"])
    return change(texts, task, k, zone="z0")


@mutator("verify.move_time")
def wrong_time(rng, texts):
    task, k = random_task(rng), int(rng.integers(len(moves(texts, 1))))
    time = float(field(texts, task, k, "time"))
    return change(texts, task, k, time=f"{time * rng.uniform(0.3, 0.95):.5f}", speed="v7000")


@mutator("verify.move_time")
def no_time(rng, texts):
    task = random_task(rng)
    rows = lines(texts, task)
    i = pick(rng, moves(texts, task))
    rows[i] = re.sub(r"\\T:=[\d.]+", "", rows[i])
    return put(texts, task, rows)


@mutator("verify.speed_data")
def slow_speed(rng, texts):
    task, k = random_task(rng), int(rng.integers(1, len(moves(texts, 1))))
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
    task = random_task(rng)
    rows = lines(texts, task, "Main")
    alone = [i for i, row in enumerate(rows) if "MoveAbsJ" in row and "MoveAbsJ" not in rows[i + 1]]
    i = pick(rng, alone)
    rows[i] = rows[i].replace("fine", "z10")
    return put(texts, task, rows, "Main")
