"""A simulated UR controller that runs the text of a torch program tick by tick, with an arm and an arc.

It is a small interpreter of the language, written for the tests from docs/urscript.md, independent of writer
and reader. It does not know the purpose of the functions and threads of these programs.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import Any

TICK = 0.01
"""A tick [s]."""
_OUT = re.compile(r"set_(standard|configurable)_digital_out\((\d),(True|False)\)")
_READ = re.compile(r"get_(standard|configurable)_digital_(in|out)\((\d)\)")
_MOVE = re.compile(r"movel\(pose_trans\(\w+,p\[([^\]]*)\]\),t=([\d.]+),r=([\d.]+)\)")
_OPENS = re.compile(r"(def|thread|if|while)\b")


class _EndedError(Exception):
    """The program halts."""


def _blocks(rows: Iterator[str]) -> list[Any]:
    """Return the rows up to the end of their block. Nested blocks come with their content."""
    out: list[Any] = []
    for row in rows:
        if row == "end":
            return out
        out.append((row, _blocks(rows)) if _OPENS.match(row) else row)
    return out


class Machine:
    """``slider``: the share of the stated speed at which the arm goes. ``lights``: ticks from the output's
    rise to the arc's burning, None for never. ``gives_back``: whether outputs come back behind a pause.
    ``feels``: input of the arc. Places are in m; joints have none.

    ``told``: texts of the popups; ``burned``: (place or None) of each tick with the output on."""

    def __init__(
        self, text: str, output: int = 3, feels: int = 0, slider: float = 1.0, gives_back: bool = False
    ) -> None:
        rows = [row.partition("#")[0].strip() if '"' not in row else row.strip() for row in text.split("\n")]
        rows = [row for row in rows if row and not row.startswith("#")]
        (self.main,) = _blocks(iter(rows))
        self.torch, self.feels, self.slider, self.gives_back = output, feels, slider, gives_back
        self.functions: dict[str, tuple[str, list[Any]]] = {}
        self.high: set[int] = set()
        self.position: tuple[float, ...] = (0.0, 0.0, 0.0)
        self.threads: dict[str, Iterator[None]] = {}
        self.messages: list[str] = []
        self.paused, self.kept = False, set[int]()
        self.now = 0
        self.lights: int | None = 20
        self.since: int | None = None
        """The tick at which the output rose."""
        self.arc_lost = False
        self.burned: list[tuple[int, tuple[float, ...]]] = []
        self.travelled = 0.0
        self.program: Iterator[None] | None = self._body(self.main[1], {})

    @property
    def on(self) -> bool:
        return self.torch in self.high

    @property
    def arc(self) -> bool:
        """Whether the arc burns."""
        lit = self.since is not None and self.lights is not None and self.now - self.since >= self.lights
        return self.on and lit and not self.arc_lost

    @property
    def runs(self) -> bool:
        return self.program is not None

    def pause(self) -> None:
        """Pause the program as at a stop: outputs are low while it does not run."""
        self.paused, self.kept, self.high = True, set(self.high), set()
        self.since = None

    def play(self) -> None:
        self.paused = False
        if self.gives_back:
            self.high |= self.kept
            self.since = self.now if self.on else None

    def tick(self) -> None:
        """Run main program and threads until each of them takes time."""
        self.now += 1
        if not self.paused and self.program is not None:
            try:
                before = self.position
                if next(self.program, "end") == "end":
                    self._end()
                self.travelled += math.dist(before, self.position)
                for name, thread in list(self.threads.items()):
                    if name in self.threads and next(thread, "end") == "end":
                        del self.threads[name]
            except _EndedError:
                self._end()
        if self.on:
            self.burned.append((self.now, self.position))

    def run(self, ticks: int = 10**6) -> None:
        for _ in range(ticks):
            if not self.runs:
                return
            self.tick()

    def _end(self) -> None:
        self.program = None
        self.threads, self.high, self.since = {}, set(), None

    # ---- the language ----

    def _body(self, rows: list[Any], variables: dict[str, Any]) -> Iterator[None]:
        for row in rows:
            if isinstance(row, str):
                yield from self._row(row, variables)
                continue
            head, inner = row
            word, _, rest = head.partition(" ")
            if word in ("def", "thread"):
                name, _, given = rest.rstrip(":").partition("(")
                self.functions[name] = given.rstrip(")"), inner
            elif word == "if" and self._value(rest.rstrip(":"), variables):
                yield from self._body(inner, variables)
            elif word == "while":
                while self._value(rest.rstrip(":"), variables):
                    yield from self._body(inner, variables)

    def _row(self, row: str, variables: dict[str, Any]) -> Iterator[None]:
        if found := _OUT.fullmatch(row):
            number = int(found[2]) + 8 * (found[1] == "configurable")
            rose = found[3] == "True" and number not in self.high
            (self.high.add if found[3] == "True" else self.high.discard)(number)
            if number == self.torch:
                self.since = self.now if rose else self.since if self.on else None
        elif found := _MOVE.fullmatch(row):
            yield from self._move(tuple(float(v) for v in found[1].split(",")[:3]), float(found[2]))
        elif row.startswith("movej("):
            for _ in range(20):
                yield
        elif row.startswith("popup("):
            self.messages.append(row.split('"')[1])
            if "blocking=True" in row:
                yield
        elif row == "halt":
            raise _EndedError
        elif row == "sync()":
            yield
        elif found := re.fullmatch(r"sleep\((.*)\)", row):
            for _ in range(max(1, round(self._value(found[1], variables) / TICK))):
                yield
        elif found := re.fullmatch(r"(\w+) = run (\w+)\(\)", row):
            self.threads[found[1]] = self._body(self.functions[found[2]][1], {})
        elif found := re.fullmatch(r"kill (\w+)", row):
            self.threads.pop(found[1], None)
        elif found := re.fullmatch(r"(?:local )?(\w+)\s?=\s?(.*)", row):
            variables[found[1]] = self._value(found[2], variables)
        elif (found := re.fullmatch(r"(\w+)\((.*)\)", row)) and found[1] in self.functions:
            given, inner = self.functions[found[1]]
            yield from self._body(inner, {given: self._value(found[2], variables)})
        else:
            assert row.startswith(("set_tcp(", "set_payload(")), row

    def _move(self, target: tuple[float, ...], seconds: float) -> Iterator[None]:
        """Straight on at the slider's share of the speed, which may change meanwhile."""
        start, fraction = self.position, 0.0
        while fraction < 1.0:
            fraction = min(1.0, fraction + TICK * self.slider / seconds)
            self.position = tuple(a + fraction * (b - a) for a, b in zip(start, target, strict=True))
            yield

    def _value(self, text: str, variables: dict[str, Any]) -> Any:
        """Evaluate an expression in Python, with inputs, outputs and poses inserted."""
        if text.startswith(("p[", "[", '"')):
            return text
        if text.startswith("point_dist(get_forward_kin"):
            return False  # this is the planned arm
        text = _READ.sub(self._read, text)
        names = variables | {"get_actual_tcp_pose": lambda: self.position, "point_dist": math.dist}
        return eval(text, {"__builtins__": {}}, names)

    def _read(self, match: re.Match[str]) -> str:
        number = int(match[3]) + 8 * (match[1] == "configurable")
        return str(number in self.high if match[2] == "out" else number == self.feels and self.arc)
