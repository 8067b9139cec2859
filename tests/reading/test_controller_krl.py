"""KUKA controllers in a cell file: the dialect and the numbers of signals."""

from __future__ import annotations

import pytest

from planner.issues import TandemError
from planner.reading.controller import ControllerFile, build_controller


def read_controllers(arms=("left",), **fields):
    return build_controller(ControllerFile.model_validate(fields), arms)


def test_signals_have_numbers_by_arm_whatever_their_case():
    made = read_controllers(dialect="krc2", io={"left": {"doSpindle": 17}})
    assert made.dialect == "krc2"
    assert made.signal_number("left", "dospindle") == 17
    assert made.signal_number("left", "doWirePower") is None
    assert read_controllers().dialect == "krc4"


@pytest.mark.parametrize("number", [4097, -1])
def test_numbers_are_those_that_a_controller_has(number):
    with pytest.raises(ValueError, match="io"):
        ControllerFile.model_validate({"io": {"left": {"doSpindle": number}}})


@pytest.mark.parametrize(
    ("io", "word"),
    [
        ({"middle": {"doSpindle": 1}}, "no arm middle"),
        ({"left": {"doSpindle": 1, "DOSPINDLE": 2}}, "DOSPINDLE"),
    ],
)
def test_numbers_of_no_arm_or_of_two_signals(io, word):
    with pytest.raises(TandemError, match=word) as caught:
        read_controllers(io=io)
    assert {issue.code for issue in caught.value.issues} == {"problem.field"}


def test_an_input_and_an_output_count_apart():
    io = {"left": {"doPartner": 5, "diPartner": 5}, "right": {"doPartner": 5, "diPartner": 5}}
    assert (
        read_controllers(("left", "right"), sync="handshake", io=io).signal_number("right", "diPartner") == 5
    )
