"""Programs that meet by signals, as automata made by hand: what two files of tests build them of."""

from __future__ import annotations

from planner.programs.handshake.model import Action

LEAD, FOLLOW = 0, 1
WIRES = 2


def put(wire, value, resets=()):
    return Action("set", wire, value, resets)


def wait(wire, value, resets=()):
    return Action("wait", wire, value, resets)


def work(interval):
    return [Action("go", value=interval), Action("done", value=interval)]


def with_(row, i, value):
    """A row with another value at ``i``."""
    return tuple(value if k == i else x for k, x in enumerate(row))
