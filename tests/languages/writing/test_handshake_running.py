"""The running wire between two controllers: the lines of their configuration and their logic values."""

from __future__ import annotations

import dataclasses
import re

import pytest

from planner.claims import sentences
from planner.claims.handshake import PartnerSignals
from planner.languages.krl.writer import controller_files as krl_files
from planner.languages.rapid.writer import controller_files as rapid_files
from planner.languages.writing import handshake, write
from planner.targets import TargetAction
from tests.languages.writing import krl_job, synthetic
from tests.proof import handshake_job

KUKA, ABB = "kr10_r1100", "irb140"


def value(expression, signals):
    """Evaluate an expression of the submit interpreter."""
    words = expression.partition(";")[0]
    words = re.sub(r"\$?\w+(\[\d+\])?", lambda m: _word(m.group(), signals), words)
    return bool(eval(words, {"__builtins__": {}}))


def _word(name, signals):
    return name.lower() if name in ("AND", "OR", "NOT") else str(bool(signals.get(name, name == "TRUE")))


def cycle(lines, signals):
    """One cycle of the submit interpreter's lines."""
    doing = True
    for line in lines:
        if line.startswith("IF "):
            doing = value(line.partition(";")[0].strip()[3:].removesuffix(" THEN"), signals)
        elif line == "ENDIF":
            doing = True
        elif "=" in line and not line.startswith(";") and doing:
            name, _, expression = line.partition("=")
            signals[name] = value(expression, signals)
    return signals


def test_a_kuka_controller_may_be_started_first_and_stops_when_its_partner_does():
    controller = krl_job.two((ABB, KUKA))[1].cell.controller
    lines = krl_files.krl_submit_lines(controller, "right")
    now = {"TANDEM_SEEN": False}

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
    assert krl_files.krl_power_term(controller, "right") == "$IN[2]"


def test_an_abb_controller_drives_its_wire_from_the_system_and_stops_by_the_other_ones():
    rows = rapid_files.rapid_running_rows(krl_job.two((ABB, KUKA))[1].cell.controller, "left")
    own, other = rows["EIO_CROSS"]
    assert own["Res"] == "doRunning"
    assert (own["Act1"], own["Oper1"], own["Act2"]) == ("soCycleOn", "AND", "soMotorsOn")
    assert other["Act1"] == "diPartnerRunning" and "Act1_invert" in other
    assert rows["SYSSIG_IN"] == [{"Signal": other["Res"], "Action": "Stop"}]
    declared = [row["Name"] for row in rows["EIO_SIGNAL"]]
    assert declared == ["doRunning", "diPartnerRunning", other["Res"]]
    longest = dataclasses.replace(PartnerSignals(), partner_running="d" * 24)
    assert len(longest.lost_input) <= 32
    assert (
        rapid_files.rapid_power_term(krl_job.two((ABB, KUKA))[1].cell.controller, "left")
        == "diPartnerRunning"
    )


@pytest.mark.parametrize(
    "text",
    (
        handshake.PARTNER_NOT_RUNNING,
        handshake.PARTNER_STILL_RUNNING,
        sentences.START_PARTNER.words,
        sentences.UNANSWERED.words,
    ),
)
def test_every_text_on_the_running_wire_is_in_some_program(text):
    files = [*handshake_job.programs().values(), *write.program_files(*krl_job.two()).values()]
    given = " ".join(re.sub(r"[^\w .:]", "", "\n".join(files).replace("TPWrite", "")).split())
    words = text.format(other="right", input="diPartnerRunning")
    assert " ".join(re.sub(r"[^\w .:]", "", words).split()) in given


def test_a_signal_that_powers_nothing_is_no_matter_of_the_controller():
    """A pulse that asks for one step is not switched off when a program breaks off."""
    job = synthetic.problem(("left",))
    found = {}
    for powers in (True, False):
        actions = [TargetAction(0, kind, signal="doStep", switches_power=powers) for kind in ("on", "off")]
        made = synthetic.operation(
            job, {"left": synthetic.sweep(4)}, ["cut/a"] * 4, actions=actions, coupled=False
        )
        texts = write.program_files(synthetic.plan(made), job)
        found[powers] = {name for name in texts if name.startswith("controller/")}
        assert any("doStep" in text for text in texts.values())
    assert found[True] and not found[False]
