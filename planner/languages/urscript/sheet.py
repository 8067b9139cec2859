"""Rows of the setup sheet for UR controllers: signals, stops, settings at the panel."""

from collections.abc import Sequence
from typing import Final

from planner.problem import Arm, Controller, Problem, torch_signals
from planner.report.plugin_contributions import (
    ControllerCheck,
    ControllerSetup,
    ReportOfLanguage,
    SetupRow,
    signal_numbers,
)

_STANDARD_OUTPUTS: Final = 8
"""Number of standard digital outputs, and of inputs, of a UR controller. Configurable ones follow them."""


def _checks(setup: ControllerSetup) -> list[ControllerCheck]:
    """Return the rows on the settings of one UR controller, each with the item and its required state."""
    controller = setup.problem.cell.controller
    rows: list[ControllerCheck] = []
    arm = setup.arms[0].name
    partner_signals = controller.handshake.of(arm)
    for signal in setup.signals:
        name = _signal_name(controller.signal_number(arm, signal), "output")
        rows.append((f"{signal} is {name}, in Installation, I/O", "low when the program does not run"))
        rows.append(("the power falls at a safety stop and with the drives", f"wired so, after {name}"))
        if setup.joined:
            wire = f"the wire that ends at {partner_signals.partner_running}"
            rows.append(
                (f"the power of {signal} falls with {wire}", "a relay in series, outside the program")
            )
    if setup.joined:
        rows += _joined_checks(controller, arm)
    torches = torch_signals(setup.problem.operations) & set(setup.signals)
    rows += [row for signal in sorted(torches) for row in _torch_checks(signal)]
    rows += [
        ("pose of the flange at home in Base, at the panel", "as in the program's get_forward_kin"),
        ("mounting in Installation", "as the arm stands"),
        ("motion version in Installation", "noted; blends and times may depend on it"),
        ("local control, no Dashboard client", "only a person closes popups"),
        ("time from the first movel to the last", "as planned, at 100 % speed; otherwise the feed differs"),
        ("Program loops forever, in the program's head", "off; the program would restart at its end"),
        ("after an error or an abandoned stop", "start the program from its beginning"),
    ]
    return rows


def _torch_checks(signal: str) -> list[ControllerCheck]:
    """Return the checks whether a torch goes out at each stop of a UR controller and stays out.

    ``signal`` is the output of the torch. Each row has the test and its required result.
    """
    return [
        (
            f"Stop, Pause, emergency stop, safeguard stop, protective stop, each while {signal} is on, "
            f"supply off and input bridged: {signal}",
            "falls; otherwise put a safety output in series with it",
        ),
        (
            "once, as before: Pause in a slot, then Play",
            "the program ends, nothing is lit; otherwise this controller restores outputs: use no torch with "
            "it",
        ),
        (
            "once, as before: the speed slider at its minimum in a slot; the input disconnected in a slot",
            "the program ends within some seconds; immediately",
        ),
        ("the speed slider", "100 %, and nobody moves it"),
        (
            f"{signal} on at a stop: never set again by hand",
            "the program ends: move the torch out by hand, inspect the sheet, start again; it cuts all "
            "slots, so use a sheet without them, or plan the remaining ones again",
        ),
    ]


def _joined_checks(controller: Controller, arm: str) -> list[ControllerCheck]:
    """Return the requirements on a UR controller whose program meets the one of another controller.

    The other program must notice when this one stops.
    """
    partner_signals = controller.handshake.of(arm)
    ends = [
        (partner_signals.output, "output"),
        (partner_signals.running, "output"),
        (partner_signals.input, "input"),
        (partner_signals.partner_running, "input"),
    ]
    wired = [
        (f"{name} is {_signal_name(controller.signal_number(arm, name), kind)}", "wired")
        for name, kind in ends
    ]
    return [
        *wired,
        (
            f"{partner_signals.running} in Installation, I/O",
            "low when the program does not run; no other action",
        ),
        (
            f"{partner_signals.output}, {partner_signals.input}, {partner_signals.partner_running} in "
            "Installation, I/O",
            "no action",
        ),
        (
            f"Stop, Pause, emergency stop, safeguard stop, protective stop, each while both programs run: "
            f"{partner_signals.running}",
            "falls, and the other arm stops; otherwise put a safety output of this controller in series",
        ),
        ("emergency stops of both controllers", "joined: either button stops both"),
        ("the speed slider", "100 % at both, and nobody moves it"),
        ("after a stop or pause of either arm", "both programs have ended: start both from their beginning"),
        (
            "once: start the following arm alone up to Ready to meet, Pause, then Play",
            "its program ends; otherwise this controller restores outputs after a pause: not for two arms",
        ),
    ]


def _signal_name(number: int | None, kind: str) -> str:
    """Return the name of a digital input or output (``kind``) at a UR controller, "none" without a number."""
    if number is None:
        return "none"
    if number >= _STANDARD_OUTPUTS:
        return f"configurable {kind} {number - _STANDARD_OUTPUTS}"
    return f"digital {kind} {number}"


def _programs(problem: Problem, arms: Sequence[Arm]) -> list[SetupRow]:
    description = "one program, not run on a controller yet"
    return [(f"URScript of {arm.name}", f"{description}{signal_numbers(problem, arm)}") for arm in arms]


REPORT: Final = ReportOfLanguage(
    checks=_checks, programs=_programs, load_compensation="kinematic calibration"
)
