"""Two programs that begin anew behind each stop: the check of all that they and those who start them can do.

So programs of UR do: a stop ends one for good, and a start begins at its first statement, whatever the other
one does meanwhile. A program switches its own running wire, which falls with any stop and pause and stays low
when a pause is over; its line to the other one stays as it is, or falls too. Whether it watches the other one
is for the text to say.

At any instant either program may be stopped, paused, continued, started, and answered by whoever asks no
panel first. Wires take any time. What a person needs is longer than what a controller needs in one place
only, which the text secures by a wait: a program that stood for a second before its running wire rises finds
wires, watching threads and the other program's statements settled; and so does a start.

Found is what may not be: a program works ("go" to "done") while nothing watches the other one; or while the
other one runs and has not done its work of the interval before: at another meeting, or at its start. Where
nobody disturbs them and people do as they are told, no program may end itself or wait for ever. Long programs
are looked at with fewer of the meetings that are alike (:mod:`handshake_windows`), and whole where that finds
a fault.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Final, Literal

from planner.programs.handshake import windows as handshake_windows
from planner.programs.handshake.moves import Move
from planner.programs.handshake.windows import Windows

FaultKind = Literal["unwatched", "apart", "ends", "stuck"]
MOST_STATES: Final = 2_000_000
"""States that are looked at, at most: programs that have more are not proven."""
_OFF, _ON, _PAUSED = 0, 1, 2
_RUNS, _LINE, _RUNS_READ, _LINE_READ, _WATCHES = 4, 8, 16, 32, 64
"""Bits of a program behind its mode: levels of its running wire and its line, as it drives them and as the
other one reads them, and whether it watches the other one."""
_BITS, _ALL = 7, 127
"""How many bits there are, and all of them."""
_EVER: Final = 2**60


@dataclasses.dataclass(frozen=True)
class Restarted:
    """A fault of ``program`` (0 or 1), both being at steps ``lines``; ``events``: how it comes about, as
    (program, what, step). ``states``: how many were looked at."""

    kind: FaultKind | None
    program: int
    lines: tuple[int, int]
    events: tuple[tuple[int, str, int], ...]
    states: int


def check(
    programs: Sequence[Sequence[Move]],
    blocks: Sequence[Sequence[int]],
    reads_back: bool = True,
    disturbed: bool = True,
) -> Restarted:
    """Look at all that two programs can do together. ``blocks``: the interval that each move stands in, by
    program. ``reads_back``: each wait, look and watch ends the program where its own running wire is 0.
    ``disturbed`` False: nobody stops or pauses a program, the one that follows is started when the other one
    says so, and that one's second question is answered when the first one runs.

    Raises :class:`OverflowError` for programs of more than :data:`MOST_STATES` states."""
    cut = handshake_windows.shortened(programs, blocks) if disturbed else None
    few = None
    if cut is not None:
        rows, windows = cut
        few = _Search(rows, reads_back, disturbed, windows).run()
        if few.kind is None and not windows.lost:
            return few
    try:
        return _Search(programs, reads_back, disturbed).run()
    except OverflowError:
        if few is None or few.kind is None:
            raise
        return few


class _Search:
    """A program is a number, its place and its bits; a state is the number of both."""

    def __init__(
        self,
        programs: Sequence[Sequence[Move]],
        reads_back: bool,
        disturbed: bool,
        windows: Windows | None = None,
    ) -> None:
        self.programs, self.windows = programs, windows
        self.reads_back, self.disturbed = reads_back, disturbed
        self.sides = (max(map(len, programs)) + 1) << _BITS
        self.done = [_finished(program) for program in programs]
        asked = [[i for i, move in enumerate(row) if move.kind == "check"][:1] for row in programs]
        self.called = [own[0] if own and not programs[i][own[0]].value else -1 for i, own in enumerate(asked)]
        """Where the lead sees that the other one runs, -1 of the one that follows."""
        looks = [[i for i, move in enumerate(row) if move.kind == "look" and move.value] for row in programs]
        self.ready = [own[0] if own else 0 for own in looks]
        """Where a panel says that it is ready for the first meeting."""
        self.known: dict[int, int] = {}
        """The state that each one comes from, -1 for the first ones."""
        self.options: dict[int, tuple[tuple[int, str, bool], ...]] = {}

    def run(self) -> Restarted:
        """The first fault in the order of events, if there is one."""
        lines = (0, _LINE | _LINE_READ)
        todo = [a * self.sides + b for a in lines for b in lines]
        known = self.known = dict.fromkeys(todo, -1)
        for state in todo:
            both = divmod(state, self.sides)
            fault = self._fault(both)
            after = [new for *_, new in self._next(both)]
            after += self._again(both)
            if not (fault or self.disturbed):
                fault = self._ended(both, bool(after))
            if fault is not None:
                places = self._line(0, both[0]), self._line(1, both[1])
                return Restarted(*fault, places, self._way(state), len(known))
            for new in after:
                if new not in known:
                    known[new] = state
                    todo.append(new)
            if len(known) > MOST_STATES:
                raise OverflowError(f"more than {MOST_STATES} states")
        return Restarted(None, 0, (0, 0), (), len(known))

    def _line(self, program: int, side: int) -> int:
        row = self.programs[program]
        return row[min(side >> _BITS, len(row) - 1)].line if row else 0

    def _way(self, state: int) -> tuple[tuple[int, str, int], ...]:
        """What has led to a state, without what wires have done."""
        out = []
        while (earlier := self.known[state]) >= 0:
            both = divmod(earlier, self.sides)
            moved = ((i, what) for i, what, new in self._next(both) if new == state)
            program, what = next(moved, (0, "wire"))
            if what != "wire":
                out.append((program, what, self._line(program, both[program])))
            state = earlier
        return tuple(reversed(out))

    def _again(self, both: tuple[int, int]) -> list[int]:
        """The same state where the same stands before it."""
        places = (both[0] >> _BITS, both[1] >> _BITS)
        other = None if self.windows is None else self.windows.again(places)
        if other is None:
            return []
        a, b = (place << _BITS | side & _ALL for place, side in zip(other, both, strict=True))
        return [a * self.sides + b]

    def _ends(self, own: int, other: int) -> bool:
        """Whether a program's thread is about to end it."""
        if own & 3 != _ON or not own & _WATCHES:
            return False
        return not other & _RUNS_READ or (self.reads_back and not own & _RUNS)

    def _fault(self, both: tuple[int, int]) -> tuple[FaultKind, int] | None:
        for i, own in enumerate(both):
            row, place = self.programs[i], own >> _BITS
            if own & 3 != _ON or place >= len(row) or row[place].kind != "done":
                continue
            if not own & _WATCHES:
                return "unwatched", i
            other = both[1 - i]
            behind = self.done[1 - i][other >> _BITS] < row[place].value - 1
            if behind and other & 3 != _OFF and not self._ends(own, other):
                return "apart", i
        return None

    def _ended(self, both: tuple[int, int], goes_on: bool) -> tuple[FaultKind, int] | None:
        """Whether a program ends itself where nobody disturbs it, or neither goes on."""
        for i, own in enumerate(both):
            row, place, other = self.programs[i], own >> _BITS, both[1 - i]
            if self._ends(own, other):
                return "ends", i
            if own & 3 == _ON and place < len(row) and place != self.called[i]:
                move = row[place]
                low = self.reads_back and not own & _RUNS and move.kind in ("wait", "look")
                if low or (move.kind == "check" and not _passes(move, own, other)):
                    return "ends", i
        gone = all(side >> _BITS >= len(row) for side, row in zip(both, self.programs, strict=True))
        return None if goes_on or gone else ("stuck", 0)

    def _may(self, both: tuple[int, int], but: int) -> bool:
        """Whether the program ``but`` may do what takes a person long, or what a person is told to do: wires
        have followed, and the other program has come to what takes long."""
        own, other = both[1 - but], both[but]
        row, place = self.programs[1 - but], own >> _BITS
        if not self.disturbed:
            if other & 3 == _OFF:  # it is started once, that of the lead first
                return other >> _BITS == 0 and (self.called[but] >= 0 or place == self.called[1 - but])
            return other >> _BITS != self.called[but] or place >= self.ready[1 - but]
        if any((side >> 2 ^ side >> 4) & 3 for side in both):
            return False
        if own & 3 != _ON:
            return True
        if self._ends(own, other) or place >= len(row):
            return False
        move = row[place]
        if move.kind in ("wait", "look"):
            return not (self.reads_back and not own & _RUNS) and not _seen(move, other)
        return move.kind in ("ask", "done") or move.slow

    def _next(self, both: tuple[int, int]) -> Iterator[tuple[int, str, int]]:
        """What may happen: by which program, what, and the state behind."""
        for i, own in enumerate(both):
            other = both[1 - i]
            key = (own << _BITS | other & _ALL) << 1 | i
            options = self.options.get(key)
            if options is None:
                options = self.options[key] = tuple(self._side(i, own, other & _ALL))
            for new, what, slow in options:
                if not slow or self._may(both, i):
                    yield i, what, new * self.sides + other if i == 0 else other * self.sides + new

    def _side(self, i: int, own: int, other: int) -> Iterator[tuple[int, str, bool]]:
        """What a program may do beside the bits of the other one: it behind, what, and whether that takes
        long."""
        for shift in (_RUNS, _LINE):
            if (own ^ own >> 2) & shift:
                yield own ^ shift << 2, "wire", False
        mode, bits, place = own & 3, own & _ALL, own >> _BITS
        if mode == _OFF:
            yield bits | _ON, "start", True
            return
        off = bits & ~(3 | _WATCHES | _RUNS)
        if self.disturbed:
            for stopped in sorted({off, off & ~_LINE}):
                yield stopped, "stop", False
            if mode == _PAUSED:
                yield own & ~3 | _ON, "go on", False
                return
            low = own & ~(3 | _RUNS) | _PAUSED
            for paused in sorted({low, low & ~_LINE}):
                yield paused, "pause", False
        row = self.programs[i]
        if place >= len(row):
            yield (off if self.disturbed else place << _BITS | off), "end", False
            return
        move, slow = row[place], False
        match move.kind:
            case "wait" | "look":
                if (self.reads_back and not own & _RUNS) or not _seen(move, other):
                    return  # it ends as by a stop, or waits
            case "check":
                if not _passes(move, own, other):
                    return  # the same
                slow = not self.disturbed
            case "run":
                slow = move.slow and self.disturbed
        after = own
        if move.kind in ("set", "run", "watch"):
            bit = {"set": _LINE, "run": _RUNS, "watch": _WATCHES}[move.kind]
            after = own | bit if move.value else own & ~bit
            if move.kind == "run" and move.value and not self.disturbed:
                after |= _RUNS_READ  # it settles before the next statement
        yield after + (1 << _BITS), "step", slow


def _seen(move: Move, other: int) -> bool:
    return bool(other & (_LINE_READ if move.kind == "wait" else _RUNS_READ)) == bool(move.value)


def _passes(move: Move, own: int, other: int) -> bool:
    line = bool(other & _LINE_READ) == bool(move.value)
    return line and bool(other & _RUNS_READ) and bool(own & _RUNS) == move.own


def _finished(program: Sequence[Move]) -> list[int]:
    """For each place, the last interval whose work is done there: the one before that of the work ahead."""
    out = [_EVER] * (len(program) + 1)
    for place in range(len(program) - 1, -1, -1):
        move = program[place]
        out[place] = move.value - 1 if move.kind in ("go", "done") else out[place + 1]
    return out
