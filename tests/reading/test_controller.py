"""The controller section of a cell: one controller, or two that share digital signals."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from planner.claims.handshake import SignalWire
from planner.issues import TandemError
from planner.reading.controller import ControllerFile, build_controller

ARMS = ("left", "right")
TWICE = {"output": "DIPARTNER"}


def wire(source, output, sink, given):
    return {"output": {"arm": source, "signal": output}, "input": {"arm": sink, "signal": given}}


RUNNING = [wire(a, "doRunning", b, "diPartnerRunning") for a, b in (ARMS, ARMS[::-1])]


def parse_controllers(arms=ARMS, **fields):
    return build_controller(ControllerFile.model_validate(fields), arms)


def expect_refusal(arms=ARMS, **fields):
    with pytest.raises(TandemError) as error:
        parse_controllers(arms, **fields)
    return error.value.issues[0]


def test_one_controller_has_a_task_and_a_unit_for_each_arm():
    got = parse_controllers()
    assert (got.sync, got.tasks, got.units) == ("multimove", ("T_ROB1", "T_ROB2"), ("ROB_1", "ROB_2"))
    assert expect_refusal(tasks=["T_A", "t_a"]).code == "problem.duplicate_name"


def test_two_controllers_may_have_tasks_of_one_name():
    got = parse_controllers(sync="handshake")
    assert (got.tasks, got.units) == (("T_ROB1", "T_ROB1"), ("ROB_1", "ROB_1"))
    assert (got.handshake.kind, got.handshake.every) == ("four_phase", 1)
    assert parse_controllers(sync="handshake", tasks=["T_A", "T_A"]).tasks == ("T_A", "T_A")


def test_outputs_drive_the_other_controllers_inputs_unless_stated():
    assert parse_controllers(sync="handshake").handshake.meeting_wires(ARMS) == (
        SignalWire("left", "doPartner", "right", "diPartner"),
        SignalWire("right", "doPartner", "left", "diPartner"),
    )
    names = {"left": {"output": "DO_A", "input": "DI_A"}}
    wires = [
        {"output": {"arm": "left", "signal": "DO_A"}, "input": {"arm": "right", "signal": "diPartner"}},
        {"output": {"arm": "right", "signal": "doPartner"}, "input": {"arm": "left", "signal": "DI_A"}},
        *RUNNING,
    ]
    got = parse_controllers(
        sync="handshake", handshake={"kind": "toggle", "signals": names, "wires": wires}
    ).handshake
    assert got.meeting_wires(ARMS)[0] == SignalWire("left", "DO_A", "right", "diPartner")
    assert got.of("left").input == "DI_A" and got.of("right").input == "diPartner"
    assert (
        got.running_wires(ARMS)
        == got.running
        == parse_controllers(sync="handshake").handshake.running_wires(ARMS)
    )
    assert got.running == (
        SignalWire("left", "doRunning", "right", "diPartnerRunning"),
        SignalWire("right", "doRunning", "left", "diPartnerRunning"),
    )


def test_wiring_that_does_not_join_the_signals_is_refused():
    there = {
        "output": {"arm": "left", "signal": "doPartner"},
        "input": {"arm": "right", "signal": "diPartner"},
    }
    back = {
        "output": {"arm": "right", "signal": "doPartner"},
        "input": {"arm": "left", "signal": "diPartner"},
    }
    assert parse_controllers(sync="handshake", handshake={"wires": [there, back, *RUNNING]}).handshake.wires
    for wires in ([there], [there, there], [there, {**back, "input": {"arm": "left", "signal": "diOther"}}]):
        issue = expect_refusal(sync="handshake", handshake={"wires": [*wires, *RUNNING]})
        assert issue.field == "controller.handshake.wires" and "from doPartner of right" in issue.message


def test_wires_without_those_that_say_who_runs_are_refused():
    """Without them a stop of one controller goes unnoticed at the other one."""
    meet = [wire(a, "doPartner", b, "diPartner") for a, b in (ARMS, ARMS[::-1])]
    own = wire("right", "doRunning", "right", "diPartnerRunning")
    for wires in ([], RUNNING[:1], [RUNNING[0]] * 2, [RUNNING[0], own]):
        issue = expect_refusal(sync="handshake", handshake={"wires": [*meet, *wires]})
        assert (
            issue.field == "controller.handshake.wires" and "no wire goes from doRunning of" in issue.message
        )
    shared = {"left": {"running": "doPartner"}}
    assert (
        expect_refusal(sync="handshake", handshake={"signals": shared}).field
        == "controller.handshake.signals.left"
    )
    with pytest.raises(ValidationError):
        parse_controllers(sync="handshake", handshake={"wires": [*meet, *RUNNING, RUNNING[0]]})


def test_running_inputs_and_outputs_count_apart_too():
    numbers = {"doPartner": 1, "diPartner": 1, "doRunning": 2, "diPartnerRunning": 2}
    assert (
        parse_controllers(sync="handshake", io={"left": numbers}).signal_number("left", "diPartnerRunning")
        == 2
    )
    for more in ({"diPartnerRunning": 1}, {"doRunning": 1}):
        issue = expect_refusal(sync="handshake", io={"left": {**numbers, **more}})
        assert issue.field == "controller.io.left" and "cannot be distinguished" in issue.message


@pytest.mark.parametrize(
    ("arms", "fields", "field"),
    [
        (("left",), {"sync": "handshake"}, ""),
        (ARMS, {"handshake": {}}, ""),
        (ARMS, {"sync": "handshake", "handshake": {"signals": {"middle": {}}}}, ".signals"),
        (ARMS, {"sync": "handshake", "handshake": {"signals": {"left": TWICE}}}, ".signals.left"),
        (ARMS, {"sync": "handshake", "wire_signal": "doPartner"}, ".signals.left"),
    ],
)
def test_what_cannot_be_meant_is_refused_by_name(arms, fields, field):
    issue = expect_refusal(arms, **fields)
    assert (issue.code, issue.field) == ("problem.field", f"controller.handshake{field}")


@pytest.mark.parametrize(
    "wrong", [{"every": 0}, {"every": 101}, {"timeout_s": 0}, {"kind": "hope"}, {"delay": 1}]
)
def test_values_out_of_range_are_refused(wrong):
    with pytest.raises(ValidationError):
        ControllerFile.model_validate({"sync": "handshake", "handshake": wrong})
