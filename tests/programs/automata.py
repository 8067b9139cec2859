"""Hand-made automata of programs that meet by signals, shared by two test files."""

from __future__ import annotations

from planner.programs.handshake.model import AutomatonAction

LEAD, FOLLOW = 0, 1
WIRES = 2


def put(wire, value, resets=()):
    return AutomatonAction("set", wire, value, resets)


def wait(wire, value, resets=()):
    return AutomatonAction("wait", wire, value, resets)


def work(interval):
    return [AutomatonAction("go", value=interval), AutomatonAction("done", value=interval)]


def with_(row, i, value):
    """A row with another value at ``i``."""
    return tuple(value if k == i else x for k, x in enumerate(row))
