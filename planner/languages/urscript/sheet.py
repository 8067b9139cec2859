"""Rows of the setup sheet for UR controllers: signals, stops, settings at the panel."""

from collections.abc import Sequence
from typing import Final

from planner.problem import Arm, Controller, Problem, torch_signals
from planner.report.contribution import Check, ControllerSetup, ReportOfLanguage, Row, numbered_signals

_STANDARD_OUTPUTS: Final = 8
"""Number of standard digital outputs, and of inputs, of a UR controller. Configurable ones follow them."""


def _checks(setup: ControllerSetup) -> list[Check]:
    controller, out = setup.problem.cell.controller, list[Check]()
    arm = setup.arms[0].name
    own = controller.handshake.of(arm)
    for signal in setup.signals:
        name = _signal(controller.number(arm, signal), "output")
        out.append((f"{signal} is {name}, in Installation, I/O", "low when the program does not run"))
        out.append(("the power falls at a safety stop and with the drives", f"wired so, behind {name}"))
        if setup.joined:
            wire = f"the wire that ends at {own.partner_running}"
            out.append((f"the power of {signal} falls with {wire}", "a relay in series, beside the program"))
    if setup.joined:
        out += _joined_checks(controller, arm)
    lit = torch_signals(setup.problem.operations) & set(setup.signals)
    out += [row for signal in sorted(lit) for row in _torch_checks(signal)]
    out += [
        ("pose of the flange at home in Base, at the panel", "as the program's get_forward_kin has it"),
        ("mounting in Installation", "as the arm stands"),
        ("motion version in Installation", "noted; blends and times may differ by it"),
        ("local control, no Dashboard client", "nothing but a person closes popups"),
        ("time from the first movel to the last", "as planned, at 100 % speed: else the feed is another"),
        ("Program loops forever, in the program's head", "off: at its end it would begin anew by itself"),
        ("behind an error or a stop that is given up", "start the program from its beginning"),
    ]
    return out


def _torch_checks(signal: str) -> list[Check]:
    """What a UR controller needs so that a torch goes out at each stop, and is not lit again."""
    return [
        (
            f"Stop, Pause, emergency stop, safeguard stop, protective stop, each while {signal} is on, "
            f"supply off and input bridged: {signal}",
            "falls; else a safety output in series with it",
        ),
        (
            "once, as before: Pause in a slot, then Play",
            "the program ends, nothing is lit; else this controller gives outputs back: light no torch with "
            "it",
        ),
        (
            "once, as before: the speed slider at its least in a slot; the input pulled in a slot",
            "the program ends within some seconds; at once",
        ),
        ("the speed slider", "100 %, and nobody moves it"),
        (
            f"{signal} on at a stop: never set again by hand",
            "the program ends: torch out by hand, sheet looked at, start from the beginning; it cuts all "
            "slots, so on a sheet without them, else plan anew what is left",
        ),
    ]


def _joined_checks(controller: Controller, arm: str) -> list[Check]:
    """What a UR controller needs so that another one's program knows when this one stops."""
    own = controller.handshake.of(arm)
    ends = [
        (own.output, "output"),
        (own.running, "output"),
        (own.input, "input"),
        (own.partner_running, "input"),
    ]
    named = [(f"{name} is {_signal(controller.number(arm, name), kind)}", "wired") for name, kind in ends]
    return [
        *named,
        (f"{own.running} in Installation, I/O", "low when the program does not run; no other action"),
        (f"{own.output}, {own.input}, {own.partner_running} in Installation, I/O", "no action"),
        (
            f"Stop, Pause, emergency stop, safeguard stop, protective stop, each while both programs run: "
            f"{own.running}",
            "falls, and the other arm stops; else a safety output of this controller in series with its wire",
        ),
        ("emergency stops of both controllers", "joined: either button stops both"),
        ("the speed slider", "100 % at both, and nobody moves it"),
        ("behind a stop or pause of either arm", "both programs have ended: start both from their beginning"),
        (
            "once: the arm that follows started alone up to Ready to meet, Pause, then Play",
            "its program ends; else this controller gives outputs back behind a pause: do not use it for two",
        ),
    ]


def _signal(number: int | None, kind: str) -> str:
    """What a number of a digital input or output is called at a UR controller."""
    if number is None:
        return "none"
    if number >= _STANDARD_OUTPUTS:
        return f"configurable {kind} {number - _STANDARD_OUTPUTS}"
    return f"digital {kind} {number}"


def _programs(problem: Problem, arms: Sequence[Arm]) -> list[Row]:
    what = "one program, not run on a controller yet"
    return [(f"URScript of {arm.name}", f"{what}{numbered_signals(problem, arm)}") for arm in arms]


REPORT: Final = ReportOfLanguage(
    checks=_checks, programs=_programs, load_compensation="kinematic calibration"
)
