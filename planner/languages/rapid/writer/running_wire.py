"""RAPID rows of the signals by which two controllers watch each other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from planner.languages.rapid.writer.syntax import identifier
from planner.problem import Controller

ConfigurationRow = Mapping[str, str | None]
"""An instance of a type of ABB's configuration: values by attribute, None for one without a value."""


def rapid_power_term(controller: Controller, arm: str) -> str:
    """The further AND term of the power of an ABB arm's controller: the input from the other one."""
    return identifier(controller.handshake.of(arm).partner_running)


def rapid_running_rows(controller: Controller, arm: str) -> dict[str, list[ConfigurationRow]]:
    """Rows of EIO.cfg by type, for the controller of an ABB arm; the outputs of the system that say that a
    program runs and motors are on are declared beside them.

    Seen in backups of real cells: SYSSIG_OUT of CycleOn into EIO_CROSS. From public tools that write such
    files: -Act1_invert, SYSSIG_IN. From memory: the action Stop, and that it acts on the rising edge.
    """
    own, lock = controller.handshake.of(arm), controller.interlock
    running, given, lost = identifier(own.running), identifier(own.partner_running), identifier(own.lost)
    out, into = (placed(controller, [arm], name) for name in (own.running, own.partner_running))
    return {
        "EIO_SIGNAL": [
            {"Name": running, "SignalType": "DO", **out, "Access": "ReadOnly"},
            {"Name": given, "SignalType": "DI", **into},
            {"Name": lost, "SignalType": "DI"},
        ],
        "SYSSIG_IN": [{"Signal": lost, "Action": "Stop"}],
        "EIO_CROSS": [
            {
                "Name": "TandemRunning",
                "Res": running,
                "Act1": identifier(lock.cycle),
                "Oper1": "AND",
                "Act2": identifier(lock.motors),
            },
            {"Name": "TandemPartner", "Res": lost, "Act1": given, "Act1_invert": None},
        ],
    }


def placed(controller: Controller, arms: Sequence[str], signal: str) -> dict[str, str]:
    """Device and bit of a signal at the controller of these arms; none where the cell states none."""
    places = (controller.interlock.place(arm, signal) for arm in arms)
    place = next((place for place in places if place is not None), None)
    return {"Device": place.device, "DeviceMap": str(place.bit)} if place else {}
