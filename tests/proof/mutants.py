"""Faults in data, motion and process, by kind, together with all kinds for the texts of ``small_job``.

Each mutator takes a random generator and the texts and returns changed texts. It never returns texts with the
same meaning. Geometric faults are twice the tolerance that they violate.
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
    segment,
    shifted,
    timed,
)
from tests.proof.mutants_of_tasks import TASKS_APART
from tests.proof.mutants_of_text import TEXT
from tests.proof.registry import Table, Texts, into, pick
from tests.proof.small_job import SIGNAL, TOLERANCE, ends, joints_at, problem

MOTION: Table = {}
mutator = into(MOTION)
FRAME = 2.0 * 0.001  # mm: twice the tolerance of written frames


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
    task = random_task(rng)
    rows, i = _data_row(texts, task, "PERS tooldata")
    rows[i] = _bump(rows[i], rng, FRAME)
    return put(texts, task, rows, "Data")


@mutator("verify.tool_data")
def wrong_mass(rng, texts):
    task = random_task(rng)
    rows, i = _data_row(texts, task, "PERS tooldata")
    rows[i] = re.sub(r"\]\],\[([\d.]+),", lambda m: f"]],[{float(m.group(1)) + 0.002:.3f},", rows[i], count=1)
    return put(texts, task, rows, "Data")


@mutator("verify.tool_data")
def not_held(rng, texts):
    task = random_task(rng)
    rows, i = _data_row(texts, task, "PERS tooldata")
    rows[i] = rows[i].replace("[TRUE", "[FALSE", 1)
    return put(texts, task, rows, "Data")


@mutator("verify.tool_data")
def no_tool(rng, texts):
    task, k = random_task(rng), int(rng.integers(len(moves(texts, 1))))
    return change(texts, task, k, tool="tool0")


@mutator("verify.work_object")
def wrong_work_object(rng, texts):
    for task in TASKS if rng.random() < 0.5 else (random_task(rng),):
        state = np.random.default_rng(int(rng.integers(2**31))) if task == 1 else rng
        rows, i = _data_row(texts, task, "PERS wobjdata")
        rows[i] = _bump(rows[i], state, FRAME)
        texts = put(texts, task, rows, "Data")
    return texts


@mutator("verify.continuity")
def world_for_stock(rng, texts):
    task, k = random_task(rng), int(rng.integers(len(moves(texts, 1))))
    return change(texts, task, k, wobj="wobj0")


@mutator("verify.base_frames")
def wrong_base(rng, texts):
    task = random_task(rng)
    rows, i = _data_row(texts, task, "base_frame")
    # a pose literal opens with two brackets as every position does
    rows[i] = _bump(rows[i], rng, FRAME)
    return put(texts, task, rows, "Data")


@mutator("verify.base_frames")
def no_base(rng, texts):
    task = random_task(rng)
    rows, i = _data_row(texts, task, "CONST pose base_frame")
    rows.pop(i)
    return put(texts, task, rows, "Data")


@mutator("verify.move_kinds")
def joint_path(rng, texts):
    k = int(rng.integers(len(moves(texts, 1))))
    for task in TASKS if rng.random() < 0.5 else (random_task(rng),):
        rows = lines(texts, task)
        i = moves(texts, task)[k]
        rows[i] = rows[i].replace("MoveL", "MoveJ")
        texts = put(texts, task, rows)
    return texts


@mutator("verify.move_kinds")
def free_configuration(rng, texts):
    task = random_task(rng)
    new = pick(rng, ["ConfL\\Off;", ""])
    return edit(texts, name("Main", task), "ConfL\\On;", new)


@mutator("verify.move_kinds")
def external_axis(rng, texts):
    task, k = random_task(rng), int(rng.integers(len(moves(texts, 1))))
    return change(texts, task, k, ext=f"{rng.uniform(0, 100):.2f},9E9,9E9,9E9,9E9,9E9")


@mutator("verify.zone_size")
def wide_zone(rng, texts):
    k = pick(rng, [k for k in range(len(moves(texts, 1))) if field(texts, 1, k, "zone") != "fine"])
    wide = pick(rng, ["z20", "z30", "z50"])
    return both(texts, k, lambda t, task, i: change(t, task, i, zone=wide))


# ---- motion ----------------------------------------


@mutator("verify.confdata")
def wrong_quadrant(rng, texts):
    task, k = random_task(rng), int(rng.integers(len(moves(texts, 1))))
    conf = [int(v) for v in field(texts, task, k, "conf").split(",")]
    conf[int(rng.integers(3))] += pick(rng, [-4, -2, -1, 1, 2, 4])
    return change(texts, task, k, conf=",".join(map(str, conf)))


@mutator("verify.confdata")
def wrong_posture(rng, texts):
    task, k = random_task(rng), int(rng.integers(len(moves(texts, 1))))
    conf = [int(v) for v in field(texts, task, k, "conf").split(",")]
    conf[3] = pick(rng, [c for c in range(8) if c != conf[3]])
    return change(texts, task, k, conf=",".join(map(str, conf)))


@mutator("verify.reach")
def out_of_reach(rng, texts):
    k = int(rng.integers(len(moves(texts, 1))))
    task = random_task(rng)
    away = np.array([-1.0 if task == 2 else 1.0, 0.0, 0.0]) * rng.uniform(500.0, 900.0)
    return change(shifted(texts, task, k, away), task, k, speed="v7000")


@mutator("verify.joint_limits")
def beyond_limits(rng, texts):
    """An axis of a waypoint beyond its limit by two degrees or more."""
    task = random_task(rng)
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
    task = random_task(rng)
    rows, i = _data_row(texts, task, "j_1_entry_1")
    arm = problem().cell.arms[task - 1]
    pose = ends(np.array([rng.uniform(-0.02, 0.02)]), False)[arm.name]
    pose[:, :3, 3] = [rng.uniform(-0.03, 0.03), rng.uniform(-0.02, 0.02), rng.uniform(0.03, 0.07)]
    into = np.rad2deg(joints_at(arm, pose)[0])
    rows[i] = re.sub(r"\[\[[^\]]*\]", "[[" + ",".join(f"{v:.6f}" for v in into) + "]", rows[i], count=1)
    return put(texts, task, rows, "Data")


@mutator("verify.own_clearance")
def tool_against_its_forearm(rng, texts):
    """A waypoint of the entry at which a bent wrist brings the tool within 3 mm of the arm's own forearm, or
    into it."""
    return bent(texts, random_task(rng), rng.uniform(106.5, 113.0))


def bent(texts: Texts, task: int, degrees: float) -> Texts:
    """The first waypoint of a task's entry with axis 5 at an angle."""
    rows, i = _data_row(texts, task, "j_1_entry_1")
    values = [float(v) for v in re.search(r"\[\[([^\]]*)\]", rows[i]).group(1).split(",")]
    values[4] = degrees
    rows[i] = re.sub(r"\[\[[^\]]*\]", "[[" + ",".join(f"{v:.6f}" for v in values) + "]", rows[i], count=1)
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
    task = random_task(rng)
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
    k, task = cutting(rng, texts), random_task(rng)
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
    for task in TASKS if rng.random() < 0.5 else (random_task(rng),):
        a = {f: field(texts, task, k, f) for f in ("pos", "orient", "conf")}
        b = {f: field(texts, task, k + 1, f) for f in ("pos", "orient", "conf")}
        texts = change(change(texts, task, k, **b), task, k + 1, **a)
    return texts


MUTATORS: Table = {**TEXT, **TASKS_APART, **MOTION}
"""In the order of these tables, which seeds go by."""
