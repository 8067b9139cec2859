"""The running wire between two controllers: lines of their configuration, and what they come to."""

from __future__ import annotations

import re

import pytest

from planner import dialogue
from planner.post import running, write
from tests.post import krl_job, synthetic
from tests.verify import handshake_job

KUKA, ABB = "kr10_r1100", "irb140"


def by_arm(models=(ABB, KUKA)):
    _, problem = krl_job.two(models)
    return problem, dict(zip(("left", "right"), problem.cell.arms, strict=True))


def test_one_controller_needs_no_lines():
    problem = synthetic.problem()
    assert all(running.lines(problem, arm) == () for arm in problem.cell.arms)
    assert all(running.power(problem, arm) == "" for arm in problem.cell.arms)


def value(expression, signals):
    """What an expression of the submit interpreter comes to."""
    words = expression.partition(";")[0]
    words = re.sub(r"\$?\w+(\[\d+\])?", lambda m: _word(m.group(), signals), words)
    return bool(eval(words, {"__builtins__": {}}))


def _word(name, signals):
    return name.lower() if name in ("AND", "OR", "NOT") else str(bool(signals.get(name, name == "TRUE")))


def cycle(lines, signals):
    """One cycle of the submit interpreter's lines."""
    doing = True
    for line in lines[lines.index("; USER PLC, in the cycle") + 1 :]:
        if line.startswith("IF "):
            doing = value(line[3:].removesuffix(" THEN"), signals)
        elif line == "ENDIF":
            doing = True
        elif "=" in line and not line.startswith(";") and doing:
            name, _, expression = line.partition("=")
            signals[name] = value(expression, signals)
    return signals


def test_a_kuka_controller_may_be_started_first_and_stops_when_its_partner_does():
    problem, arms = by_arm()
    lines = running.lines(problem, arms["right"])
    now = {"tandem_seen": False}

    def then(**signals):
        names = {"act": "$PRO_ACT", "ready": "$PERI_RDY", "partner": "$IN[2]"}
        cycle(lines, now | {names[name]: on for name, on in signals.items()})
        now.update({names[name]: on for name, on in signals.items()})
        now.update(cycle(lines, dict(now)))
        return now["$OUT[2]"], now["$OUT[3]"]

    # (says that it runs, may move)
    assert then(act=False, ready=True, partner=False) == (False, True)
    assert then(act=True, ready=True, partner=False) == (True, True)  # started first: nothing seen yet
    assert then(act=True, ready=True, partner=True) == (True, True)
    assert then(act=True, ready=True, partner=False) == (True, False)  # the partner stops, or the wire is cut
    assert then(act=False, ready=True, partner=False) == (
        False,
        True,
    )  # stopped: one side may be started again
    assert then(act=True, ready=True, partner=False) == (True, True)
    assert then(act=True, ready=False, partner=True) == (False, True)  # drives off
    assert running.power(problem, arms["right"]) == "$IN[2]"


def test_an_abb_controller_drives_its_wire_from_the_system_and_stops_by_the_other_ones():
    problem, arms = by_arm()
    lines = running.lines(problem, arms["left"])
    cross = [line for line in lines if "-Res" in line]
    own, lost = (re.search(r'-Res "(\w+)"', line).group(1) for line in cross)
    assert own == "doRunning"
    assert re.findall(r'-(Act\d|Oper\d) "(\w+)"', cross[0]) == [
        ("Act1", running.CYCLE),
        ("Oper1", "AND"),
        ("Act2", running.MOTORS),
    ]
    assert re.findall(r'-Act1 "(\w+)" -Act1_invert', cross[1]) == ["diPartnerRunning"]
    assert f'-Signal "{lost}" -Action "Stop"' in lines
    declared = re.findall(r'-Name "(\w+)" -SignalType', "\n".join(lines))
    used = re.findall(r'-(?:Signal|Res|Act\d) "(\w+)"', "\n".join(lines))
    assert set(used) == set(declared) and len(declared) == len(set(declared))
    assert all(len(name) <= 32 for name in declared)
    assert running.power(problem, arms["left"]) == "diPartnerRunning"


@pytest.mark.parametrize(
    "text", (running.STANDS, running.RUNS, dialogue.START_PARTNER.words, dialogue.UNANSWERED.words)
)
def test_every_text_on_the_running_wire_is_in_some_program(text):
    files = [*handshake_job.programs().values(), *write.programs(*krl_job.two()).values()]
    given = " ".join(re.sub(r"[^\w .:]", "", "\n".join(files).replace("TPWrite", "")).split())
    words = text.format(other="right", input="diPartnerRunning")
    assert " ".join(re.sub(r"[^\w .:]", "", words).split()) in given
