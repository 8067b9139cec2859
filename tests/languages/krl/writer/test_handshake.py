"""KRL for two controllers: run side by side with every delay, also with a RAPID program on the other side."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

from planner.claims import sentences
from planner.issues import TandemError
from planner.languages.rapid.reader.reader import read_task
from planner.languages.writing.write import program_notes, refusals
from tests.languages.writing import krl_job, reading, synthetic
from tests.languages.writing import test_handshake as rapid_side
from tests.languages.writing.reading import programs

KUKA, ABB = "kr10_r1100", "irb140"
WAIT = re.compile(r"^WHILE \$IN\[([12])\]==(TRUE|FALSE)$")


def run(files, arm, model):
    """Return the program's output changes, questions and moves in order, in the terms of the RAPID tests."""
    if model == ABB:
        return rapid_side.run(files, arm)
    out, inside = [], False
    for line in krl_job.folded(krl_job.flat(files, arm)):
        waiting = WAIT.match(line)
        if waiting:
            if waiting.group(1) == "1":  # the other one is the running wire
                out.append(("wait", "diPartner", 1 if waiting.group(2) == "FALSE" else 0))
            inside = True
        elif line == "ENDWHILE":
            inside = False
        elif inside:
            assert line in ("HALT", "$TIMER[1]=0", "ENDIF", "WAIT SEC 0.01") or line.startswith("IF $TIMER")
        elif line.startswith("$OUT[1]="):
            out.append(("set", "doPartner", int(line.endswith("TRUE"))))
        elif line.startswith("ASK"):
            out.append(("UIMsgBox", line, 0))
        elif line.startswith("TELL"):
            out.append(("TPWrite", line, 0))
        elif line.startswith("PTP"):
            out.append(("MoveAbsJ", line, 0))
        elif line.startswith(("SLIN", "LIN")):
            out.append(("MoveL", line, 0))
    return out


@pytest.mark.parametrize("models", [(KUKA, KUKA), (KUKA, ABB), (ABB, KUKA)])
@pytest.mark.parametrize(("kind", "every"), [("four_phase", 1), ("toggle", 3), ("toggle", 1)])
def test_no_delay_lets_the_programs_wait_for_ever_or_run_apart(models, kind, every):
    files = programs(*krl_job.two(models, kind, every))
    a, b = (run(files, arm, model) for arm, model in zip(("left", "right"), models, strict=True))
    work = [np.cumsum([0, *(k == "MoveL" for k, _, _ in steps)]) for steps in (a, b)]
    assert work[0][-1] == work[1][-1] == 8
    apart = 0
    for start in np.ndindex(2, 2):
        seen, stuck = rapid_side.explore(a, b, start)
        assert not stuck
        assert {state[2:] for state in seen if state[:2] == (len(a), len(b))} == {(0, 0)}
        apart = max(apart, *(abs(int(work[0][i] - work[1][j])) for i, j, _, _ in seen))
    assert apart == min(every, 6)


@pytest.mark.parametrize("kind", ["four_phase", "toggle"])
def test_a_program_that_is_asked_too_early_never_moves_an_arm(kind):
    files = programs(*krl_job.two(kind=kind))
    a, b = run(files, "left", KUKA), run(files, "right", KUKA)
    at, bt = rapid_side.moves_before(a), rapid_side.moves_before(b)
    for start in np.ndindex(2, 2):
        _, stuck = rapid_side.explore(a, b, start, trusted=False)
        assert all(at[i] == bt[j] == 0 for i, j, _, _ in stuck)


def test_every_meeting_behind_a_move_follows_an_exact_stop():
    files = programs(*krl_job.two(every=2))
    for arm in ("left", "right"):
        lines = krl_job.body(files[f"{arm}/test_1.src"])
        calls = [i for i, line in enumerate(lines) if line == "test_meet()"]
        assert len(calls) == 4
        assert all(lines[i - 1].startswith("SLIN") and lines[i - 1].endswith("}") for i in calls)
        body = krl_job.body(files[f"{arm}/test_meet.src"])
        assert sum(line == "IF $TIMER[1]>30000 THEN" for line in body) == 3


def test_a_wait_that_is_over_its_time_halts_and_waits_again_without_a_change_of_the_lines():
    text = programs(*krl_job.two())["left/test.src"]
    lines = krl_job.body(text)
    begins = [i for i, line in enumerate(lines) if line.startswith("WHILE $IN")]
    assert len(begins) > 4
    for i in begins:
        assert lines[i - 2 : i] == ["$TIMER[1]=0", "$TIMER_STOP[1]=FALSE"]
        assert re.match(r"IF \$TIMER\[1\]>\d+ THEN", lines[i + 1])
        assert lines[i + 2 : i + 8] == [
            *("HALT", "$TIMER[1]=0", "ENDIF", "WAIT SEC 0.01", "ENDWHILE", "$TIMER_STOP[1]=TRUE")
        ]
    limits = [int(found) for found in re.findall(r"\$TIMER\[1\]>(\d+) ", text)]
    assert min(limits) == 30_000 and max(limits) == 3_600_000
    assert sentences.UNANSWERED.format(other="right").split(",")[0] in text


@pytest.mark.parametrize(("kind", "every"), [("four_phase", 1), ("toggle", 3)])
def test_the_panel_says_what_a_program_waits_for_and_takes_it_back(kind, every):
    files = programs(*krl_job.two(kind=kind, every=every))
    for arm, other in (("left", "right"), ("right", "left")):
        main = krl_job.folded(krl_job.body(files[f"{arm}/test.src"]))
        shown = ""
        for line in main:
            if line.startswith("SHOW"):
                assert not shown
                shown = line
            elif line == "CLEAR":
                assert shown
                shown = ""
            elif line.startswith("WHILE $IN"):
                assert shown == f"SHOW Waiting for arm {other}."
            elif line == "test_1()":
                assert shown == f"SHOW Moves with arm {other} and waits for it where they meet."
            elif line.startswith(("PTP", "ASK")):
                assert not shown
        assert not shown


def test_the_older_dialect_shows_nothing_while_it_waits_and_halts_in_no_mode_of_a_plc():
    files = programs(*krl_job.two(dialect="krc2"))
    lines = krl_job.body(files["left/test.src"])
    assert not any("tm_msg" in line or "Krl" in line for line in lines)
    halts = [i for i, line in enumerate(lines) if line == "HALT"]
    for i in halts:  # a question, a wait that is over its time, or the refusal itself
        behind = lines[i + 1]
        assert behind in ("WHILE $MODE_OP==#EX", "$TIMER[1]=0", "ENDWHILE") or behind.startswith("tm_shift=")
    assert lines.count("WHILE $MODE_OP==#EX") == 3


def test_each_brand_gets_its_language_and_the_rapid_one_reads():
    files = programs(*krl_job.two((ABB, KUKA)))
    kinds = {arm: {n.split(".")[-1] for n in files if n.startswith(arm)} for arm in ("left", "right")}
    assert kinds == {"left": {"mod", "pgf"}, "right": {"src", "dat"}}
    assert read_task(reading.modules(files, "left")).faults == ()
    assert "Meets arm left, on a separate controller" in files["right/test.src"]


@pytest.mark.parametrize("models", [(KUKA, KUKA), (KUKA, ABB)])
def test_no_controller_moves_a_kuka_arm_with_another_one(models):
    plan, problem = krl_job.two(models)
    controller = synthetic.problem(io=problem.cell.controller.io).cell.controller
    cell = dataclasses.replace(problem.cell, controller=controller)
    problem = dataclasses.replace(problem, cell=cell)
    with pytest.raises(TandemError) as caught:
        programs(plan, problem)
    assert {issue.code for issue in caught.value.issues} == {"post.controller"}
    found = refusals(problem, [operation.targets for operation in plan.operations])
    assert [(issue.code, "handshake" in (issue.hint or "")) for issue in found] == [("post.controller", True)]


def test_lines_of_the_handshake_need_numbers():
    whole = dict(krl_job.two()[1].cell.controller.io["right"])
    for name in ("doPartner", "diPartner", "doRunning", "diPartnerRunning", "doMoveEnable"):
        less = {word: number for word, number in whole.items() if word != name}
        plan, problem = krl_job.two(io={"left": less, "right": whole})
        found = refusals(problem, [operation.targets for operation in plan.operations])
        assert [(issue.code, issue.arm) for issue in found] == [("post.signal", "left")]
        assert f"uses {name}, which" in found[0].message


def test_two_arms_of_which_one_works_take_no_handshake():
    """The other arm of the cell takes no part, so it has no program."""
    _, problem = krl_job.two()
    alone = synthetic.operation(
        problem, {"left": synthetic.sweep(9, start=krl_job.START)}, krl_job.LABELS, actions=(), coupled=False
    )
    files = programs(synthetic.plan(krl_job.synthetic_homes(alone, problem)), problem)
    assert {name.split("/")[0] for name in files} == {"left"}
    assert not any("$IN" in text for text in files.values())


def test_the_drift_of_two_kuka_arms_is_told():
    codes = [issue.code for issue in program_notes(*krl_job.two())]
    assert codes.count("post.handshake_drift") == 1
