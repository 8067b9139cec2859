"""Programs for two controllers that share digital signals: run side by side, every delay tried."""

from __future__ import annotations

import collections
import dataclasses
import itertools
import re

import numpy as np
import pytest

from planner.claims.handshake import Handshake, PartnerSignals
from planner.issues import TandemError
from planner.languages.rapid.reader.reader import read_task
from planner.languages.writing import handshake, write
from planner.languages.writing.handshake import lengthen_for_stops, meeting_rows
from planner.languages.writing.steps import build_job
from planner.languages.writing.write import program_notes
from planner.targets import TargetAction
from tests.languages.writing import reading, synthetic
from tests.languages.writing.reading import programs

KINDS = ("four_phase", "toggle")
LABELS = ["mount", "approach", "approach", *["cut/front"] * 4, "retreat", "unmount"]
RUNNING = "diPartnerRunning"
FORM = re.compile(r"^(SetDO\\Sync,(\w+),([01])|WaitDI (\w+),([01])\\MaxTime:=([\d.]+));$")


def cell(kind="four_phase", every=1, **fields):
    controllers = {"tasks": ("T_ROB1", "T_ROB1"), "units": ("ROB_1", "ROB_1")}
    return synthetic.problem(sync="handshake", handshake=Handshake(kind, every, **fields), **controllers)


def plan_and_job(kind="four_phase", every=1, actions=(), **fields):
    job = cell(kind, every, **fields)
    q = {"left": synthetic.sweep(9), "right": synthetic.sweep(9, 0.25)}
    work = synthetic.operation(job, q, LABELS, stop=(6,), actions=actions, coupled=False)
    return synthetic.plan(work), job


def written(kind="four_phase", every=1, **fields):
    return programs(*plan_and_job(kind, every, **fields))


def run(files, arm):
    """Return the program's output changes, boxes and moves in order, without checks of the running wire."""
    out = []
    for line in reading.flat(files, arm):
        signal = FORM.match(line)
        if signal and signal.group(2):
            out.append(("set", signal.group(2), int(signal.group(3))))
        elif signal and signal.group(4) == RUNNING:
            continue
        elif signal:
            out.append(("wait", signal.group(4), int(signal.group(5))))
        elif line.startswith(("Move", "UIMsgBox", "TPWrite")):
            out.append((line.split("\\")[0].split(" ")[0], line, 0))
    return out


def explore(a, b, start=(0, 0), trusted=True):
    """Return all reachable states of two runs, and those without a successor.

    A state is (position of each, line of each). Events occur one at a time, on either side, so every delay is
    covered. ``trusted``: the lead's second box is confirmed only after the other panel reports ready.
    """
    ready = next(i for i, (kind, _, _) in enumerate(b) if kind == "TPWrite")
    boxes = [i for i, (kind, _, _) in enumerate(a) if kind == "UIMsgBox"]
    todo, seen, stuck = [(0, 0, *start)], set(), set()
    while todo:
        state = todo.pop()
        if state in seen:
            continue
        seen.add(state)
        i, j, x, y = state
        after = []
        if i < len(a):
            kind, _, value = a[i]
            held = (kind == "wait" and y != value) or (trusted and i == boxes[1] and j <= ready)
            after += [] if held else [(i + 1, j, value if kind == "set" else x, y)]
        if j < len(b):
            kind, _, value = b[j]
            held = kind == "wait" and x != value
            after += [] if held else [(i, j + 1, x, value if kind == "set" else y)]
        todo += after
        if not after and (i, j) != (len(a), len(b)):
            stuck.add(state)
    return seen, stuck


def moves_before(steps):
    return [sum(kind.startswith("Move") for kind, _, _ in steps[:i]) for i in range(len(steps) + 1)]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("every", [1, 3])
def test_no_delay_lets_the_programs_wait_for_ever_whatever_an_earlier_run_left_behind(kind, every):
    files = written(kind, every)
    a, b = run(files, "left"), run(files, "right")
    for start in np.ndindex(2, 2):
        seen, stuck = explore(a, b, start)
        assert not stuck
        assert {state[2:] for state in seen if state[:2] == (len(a), len(b))} == {(0, 0)}


@pytest.mark.parametrize("kind", KINDS)
def test_a_program_that_is_asked_too_early_never_moves_an_arm(kind):
    files = written(kind)
    a, b = run(files, "left"), run(files, "right")
    at, bt = moves_before(a), moves_before(b)
    for start in np.ndindex(2, 2):
        _, stuck = explore(a, b, start, trusted=False)
        assert all(at[i] == bt[j] == 0 for i, j, _, _ in stuck)
    # the other program never runs: its line stays as it was
    for line in (0, 1):
        i = 0
        while a[i][0] != "wait" or a[i][2] == line:
            i += 1
        assert at[i] == 0


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("every", [1, 2, 4])
def test_the_arms_are_never_more_than_one_interval_apart(kind, every):
    files = written(kind, every)
    a, b = run(files, "left"), run(files, "right")

    def work(steps):
        return np.cumsum([0, *(k == "MoveL" for k, _, _ in steps)])

    at, bt = work(a), work(b)
    apart = 0
    for start, trusted in itertools.product(np.ndindex(2, 2), (True, False)):
        for i, j, _, _ in explore(a, b, start, trusted)[0]:
            apart = max(apart, abs(int(at[i]) - int(bt[j])))
            kinds = {a[i][0] if i < len(a) else "", b[j][0] if j < len(b) else ""}
            # one that goes by joints does so while the other one stands
            assert "MoveAbsJ" not in kinds or (len(kinds) == 2 and "MoveL" not in kinds)
    assert apart == min(every, 6)


def test_both_setting_first_would_lose_an_edge():
    """Why one side asks and the other one answers: the explorer finds the fault of the symmetric form."""
    turn = [("set", "", 1), ("wait", "", 1), ("set", "", 0), ("wait", "", 0)]
    head_a, head_b = [("UIMsgBox", "", 0)] * 2, [("TPWrite", "", 0)]
    assert explore(head_a + turn * 2, head_b + turn * 2)[1]
    alternate = [
        ("set", "", 1),
        ("wait", "", 1),
        ("set", "", 0),
        ("wait", "", 0),
        ("set", "", 1),
        ("wait", "", 1),
    ]
    assert explore(head_a + alternate, head_b + alternate)[1]


@pytest.mark.parametrize("kind", KINDS)
def test_programs_hold_nothing_of_multimove_and_are_read_without_faults(kind):
    files = written(kind, 2)
    assert {name.split("/")[0] for name in files} == {"left", "right", "controller"}
    text = "\n".join(files.values())
    for word in ("SyncMove", "WaitSync", "syncident", "\\ID", "all_tasks", "AllMoveTasks", "UNDO"):
        assert word not in text
    for arm in ("left", "right"):
        assert read_task(reading.modules(files, arm)).faults == ()
        # handlers leave the lines alone
        for handler in re.findall(
            r"\n  ERROR(.*?)ENDPROC", "\n".join(reading.modules(files, arm).values()), re.S
        ):
            assert "SetDO" not in handler and "EXIT;" in handler and "did not answer in time" in handler


@pytest.mark.parametrize("kind", KINDS)
def test_moves_go_in_pairs_of_equal_times_with_stops_before_every_wait(kind):
    files = written(kind, 3)
    left, right = reading.moves(files, "left"), reading.moves(files, "right")
    assert [row[5] for row in left] == [row[5] for row in right] == ["0.50000"] * 8
    # target 6 stops anyway: meetings behind moves 3, 6 (the stop) and 8 (the end)
    for rows in (left, right):
        assert [i + 1 for i, row in enumerate(rows) if row[6] == "fine"] == [3, 6, 8]
    for arm in ("left", "right"):
        last = ""
        for line in reading.flat(files, arm):
            if line.startswith("WaitDI"):
                assert not last or ",fine," in last
            last = line if line.startswith("Move") else last


def test_meetings_are_at_every_so_many_moves_and_at_stops():
    stop = np.array([0, 0, 0, 0, 1, 0, 0, 1], dtype=bool)
    assert meeting_rows(stop, 1).all()
    assert np.flatnonzero(meeting_rows(stop, 2)).tolist() == [1, 3, 4, 6, 7]
    assert np.flatnonzero(meeting_rows(stop, 3)).tolist() == [2, 4, 7]
    assert len(meeting_rows(stop[:0], 3)) == 0


def test_moves_that_stop_more_often_than_planned_take_the_time_that_takes():
    """From rest to rest by a cubic: highest speed 1.5 times the mean, highest acceleration 6 d / T^2."""
    planned, stop = np.full(4, 0.1), np.array([False, True, True, True])
    slow, still = np.full(4, 0.06), [np.zeros((4, 6))]
    assert lengthen_for_stops(planned, stop, slow, still) == pytest.approx([0.1] * 4)
    assert lengthen_for_stops(planned, stop, 2 * slow, still) == pytest.approx([0.16, 0.16, 0.18, 0.18])
    steps = np.zeros((4, 6))
    steps[:, 2] = -0.02  # a step of 0.02 times the acceleration allowed
    got = lengthen_for_stops(planned, stop, slow, [steps])
    assert got == pytest.approx(np.sqrt([0.08, 0.08, 0.12, 0.12]), abs=1.1e-5)
    time = np.linspace(0.0, got[3], 2001)
    fraction = time / got[3]
    acceleration = np.gradient(np.gradient(0.02 * (3 * fraction**2 - 2 * fraction**3), time), time)
    assert 0.98 < np.abs(acceleration[2:-2]).max() <= 1.001
    assert not len(lengthen_for_stops(planned[:0], stop[:0], slow[:0], [steps[:0]]))


def test_waits_are_as_long_as_stated():
    actions = (TargetAction(6, "wait", seconds=90.5), TargetAction(6, "message", text="Half way."))
    files = written("toggle", 1, actions=actions, timeout=7.5, patience=600.0)
    main = files["right/TandemMain_2.mod"]
    assert "WaitDI diPartner,1\\MaxTime:=7.5;" in main and "\\MaxTime:=691;" in main
    assert set(re.findall(r"MaxTime:=([\d.]+)", main)) == {"7.5", "600", "691"}
    assert "Half way." in files["left/TandemMain_1.mod"] and "Half way." not in main


def test_signals_have_each_controllers_own_names():
    names = {"left": PartnerSignals("DO_IRB6640", "DI_IRB4400")}
    files = written("toggle", signals=names)
    left, right = (run(files, arm) for arm in ("left", "right"))
    assert {name for kind, name, _ in left if kind in ("set", "wait")} == {"DO_IRB6640", "DI_IRB4400"}
    assert {name for kind, name, _ in right if kind in ("set", "wait")} == {"doPartner", "diPartner"}
    assert "Wire DO_IRB6640 of arm left to diPartner of arm right." in " ".join(
        files["left/TandemMain_1.mod"].replace("! ", "").split()
    )


def test_power_is_switched_off_by_the_controller_that_switches_it_on():
    actions = (TargetAction(0, "on", signal="doWirePower"), TargetAction(8, "off", signal="doWirePower"))
    files = written(actions=actions)
    assert "doWirePower" not in "\n".join(reading.modules(files, "right").values())
    handlers = re.findall(r"\n  ERROR\n +(\S+ ?\S*)", "\n".join(reading.modules(files, "left").values()))
    assert set(handlers) == {"SetDO doWirePower,0;"}


def test_only_procedures_that_are_called_are_written():
    for every, expected in ((1, {"handshake_0", "handshake_1"}), (9, {"handshake_0", "handshake_1"})):
        main = written("toggle", every)["left/TandemMain_1.mod"]
        assert set(re.findall(r"PROC (handshake\w*)", main)) == expected
    job = cell("toggle", 100)
    q = {"left": synthetic.sweep(4), "right": synthetic.sweep(4, 0.25)}
    plan = synthetic.plan(synthetic.operation(job, q, ["cut/b"] * 4, actions=(), coupled=False))
    assert re.findall(r"PROC (handshake\w*)", programs(plan, job)["left/TandemMain_1.mod"]) == ["handshake_1"]


def test_one_arm_alone_needs_no_handshake():
    job = cell()
    work = synthetic.operation(job, {"right": synthetic.sweep(5)}, ["cut/a"] * 5, actions=(), coupled=False)
    files = programs(synthetic.plan(work), job)
    assert {name.split("/")[0] for name in files} == {"right"}
    assert "WaitDI" not in "\n".join(files.values()) and not program_notes(synthetic.plan(work), job)


def test_an_arm_that_works_alone_is_waited_for():
    job = cell("toggle", patience=100.0)
    alone = {"left": synthetic.sweep(201)}
    q = {"left": synthetic.sweep(4), "right": synthetic.sweep(4, 0.25)}
    plan = synthetic.plan(
        synthetic.operation(job, alone, ["cut/a"] * 201, name="first", actions=(), coupled=False),
        synthetic.operation(job, q, ["cut/b"] * 4, name="second", actions=(), coupled=False),
    )
    files = programs(plan, job)
    assert "\\MaxTime:=200;" in files["right/TandemMain_2.mod"]  # 200 moves of 0.5 s
    assert set(re.findall(r"MaxTime:=(\d+)", files["left/TandemMain_1.mod"])) == {
        "30",
        "100",
    }  # it waits for none
    assert not explore(run(files, "left"), run(files, "right"))[1]
    calls = [line for line in reading.flat(files, "right") if line.startswith("SetDO")]
    assert calls[-1].endswith(",0;")


@pytest.mark.parametrize("coupled", [True, False])
def test_what_cannot_live_with_a_step_apart_is_refused_with_the_reason(coupled):
    if coupled:
        plan, job = plan_and_job()
        work = plan.operations[0]
        work = dataclasses.replace(work, targets=dataclasses.replace(work.targets, coupled=True))
        plan, word = synthetic.plan(work), "wire"
    else:
        plan, job = synthetic.held()
        controller = dataclasses.replace(job.cell.controller, sync="handshake")
        job = dataclasses.replace(job, cell=dataclasses.replace(job.cell, controller=controller))
        word = "holds"
    with pytest.raises(TandemError) as error:
        programs(plan, job)
    issue = error.value.issues[0]
    assert (
        issue.code == "post.handshake_process" and word in issue.message and "multimove" in (issue.hint or "")
    )
    # seen before anything is planned
    assert write.refusals(job, [plan.operations[0].targets]) == error.value.issues


def test_long_programs_are_split_where_the_arms_meet():
    job = cell()
    controller = dataclasses.replace(job.cell.controller, max_moves=500)
    job = dataclasses.replace(job, cell=dataclasses.replace(job.cell, controller=controller))
    q = {"left": synthetic.sweep(2001), "right": synthetic.sweep(2001, 0.25)}
    work = synthetic.operation(job, q, ["cut/a"] * 2001, actions=(), coupled=False)
    files = programs(synthetic.plan(work), job)
    counts = collections.Counter()
    for name, text in files.items():
        counts[name] = text.count("MoveL")
        assert counts[name] == text.count("handshake;") or "Main" in name
    assert max(counts.values()) <= 500 and len([n for n in counts if "Cut" in n]) <= 12
    assert len(reading.moves(files, "left")) == len(reading.moves(files, "right")) == 2000


def brute(a, b, meets, fine=60):
    """The drift by looking at very many pairs of instants."""
    out, first = np.zeros(len(meets)), 0
    fraction = np.linspace(0.0, 1.0, fine + 1)[:, None]
    for last in np.flatnonzero(meets).tolist():
        x, y = (
            np.concatenate([p[i] + fraction * (p[i + 1] - p[i]) for i in range(first, last + 1)])
            for p in (a, b)
        )
        gap = np.linalg.norm(x[:, None] - y[None], axis=2)
        planned = np.diag(gap)
        out[first : last + 1] = max(np.abs(gap - planned).max(), np.abs(gap - planned[:, None]).max())
        first = last + 1
    return out


def test_the_drift_is_what_very_many_pairs_of_instants_show():
    rng = np.random.default_rng(4)
    a = np.cumsum(rng.normal(size=(41, 3)), axis=0)
    b = a + np.array([20.0, 0.0, 0.0]) + rng.normal(size=(41, 3))
    meets = np.zeros(40, dtype=np.int64)
    meets[[0, 1, 4, 9, 10, 20, 39]] = np.arange(1, 8)
    got, expected = handshake.distance_change(a, b, meets), brute(a, b, meets)
    assert np.abs(got / expected - 1.0).max() < 0.02


def test_the_drift_of_parallel_tools_in_closed_form():
    """Both go 1 mm along a line, 20 mm apart: one a whole step ahead makes the distance the hypotenuse."""
    a = np.stack([np.arange(11.0) * 1e-3, np.zeros(11), np.zeros(11)], axis=1)
    b = a + np.array([0.0, 0.020, 0.0])
    for every in (1, 2, 5):
        meets = (np.arange(10) % every == every - 1).astype(np.int64)
        expected = np.hypot(20.0, every) - 20.0
        assert handshake.distance_change(a, b, meets) == pytest.approx(np.full(10, 1e-3 * expected), rel=1e-6)


def test_the_drift_is_told_in_a_note_and_in_the_headers():
    plan, job = plan_and_job("toggle", 4)
    (note,) = program_notes(plan, job)
    drift = build_job(plan, job).drifts[0]
    poses = plan.operations[0].targets.poses(plan.operations[0].values)
    ways = [poses[arm][:, :3, 3] for arm in ("left", "right")]
    expected = brute(*ways, np.array([0, 0, 0, 1, 0, 1, 0, 1]))
    assert drift.change == pytest.approx(expected, rel=1e-3)
    assert (note.code, note.severity.value, note.unit) == ("post.handshake_drift", "note", "mm")
    assert note.value == pytest.approx(1e3 * expected.max(), rel=1e-3)
    for text in programs(plan, job).values():
        assert "ENDMODULE" not in text or f"{note.value:.3f} mm, at move {drift.row + 1}" in " ".join(
            text.replace("! ", "").split()
        )


def test_one_controller_has_no_drift_to_tell():
    assert program_notes(*synthetic.small()) == ()
