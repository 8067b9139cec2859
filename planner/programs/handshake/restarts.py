"""Model checker for two programs that restart from their beginning after each stop, as UR programs do.

A stop ends such a program for good, and a start begins at its first statement, whatever the other program
does meanwhile. A program switches its own running wire, which falls with any stop and pause and stays low
after a pause. Its line to the other program stays unchanged, or falls too. Its text determines whether it
monitors the other program.

At any instant either program may be stopped, paused, continued or started, and its question answered by an
operator who ignores the panels. Wires may take any time. Operator actions take longer than controller
actions in one case only, which the text ensures by a wait: a program that waited for a second before its
running wire rises finds wires, monitoring threads and the other program's statements settled. The same
applies to a start.

Faults: a program works ("go" to "done") while nothing monitors the other one, or while the other one runs
and has not done its work of the previous interval (at another meeting, or at its start). Without
disturbances, and with operators who follow instructions, no program may end itself or wait for ever. Long
programs are checked with fewer of the meetings that are alike
(:mod:`planner.programs.handshake.block_windows`), and as a whole if that finds a fault.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Final, Literal

from planner.programs.handshake import block_windows as handshake_windows
from planner.programs.handshake.block_windows import BlockWindows
from planner.programs.handshake.wire_operations import WireOperation

FaultKind = Literal["unwatched", "apart", "ends", "stuck"]
MAX_STATES: Final = 2_000_000
"""Maximum number of explored states. Programs with more are not proven."""
_MODE_OFF, _MODE_ON, _MODE_PAUSED = 0, 1, 2
_RUNNING_BIT, _LINE_BIT, _RUNNING_READ_BIT, _LINE_READ_BIT, _MONITOR_BIT = 4, 8, 16, 32, 64
"""Bits of a program above its mode.

They are the levels of its running wire and its line, as it drives them and as the other program reads them,
and whether it monitors the other program.
"""
_BIT_COUNT, _BIT_MASK = 7, 127
"""Number of bits, and mask of all bits."""
_AFTER_ALL: Final = 2**60


@dataclasses.dataclass(frozen=True)
class RestartResult:
    """Result of a check.

    Attributes:
        kind: Kind of fault, None for none.
        program: Program at fault, 0 or 1.
        lines: Steps of both programs.
        events: How it comes about, as (program, event, step).
        states: Number of explored states.
    """

    kind: FaultKind | None
    program: int
    lines: tuple[int, int]
    events: tuple[tuple[int, str, int], ...]
    states: int


def check_restarts(
    programs: Sequence[Sequence[WireOperation]],
    blocks: Sequence[Sequence[int]],
    reads_back: bool = True,
    disturbed: bool = True,
) -> RestartResult:
    """Explore all joint behaviour of two programs.

    Args:
        programs: Operations of both programs.
        blocks: Interval of each operation, by program.
        reads_back: Whether each wait, look and watch ends the program if its own running wire is 0.
        disturbed: False if nobody stops or pauses a program, the following one is started when the other one
            says so, and its second question is answered when the first one runs.

    Raises:
        OverflowError: The programs have more than :data:`MAX_STATES` states.
    """
    short_programs = handshake_windows.shorten_programs(programs, blocks) if disturbed else None
    short_result = None
    if short_programs is not None:
        rows, windows = short_programs
        short_result = _RestartSearch(rows, reads_back, disturbed, windows).run()
        if short_result.kind is None and not windows.is_invalid:
            return short_result
    try:
        return _RestartSearch(programs, reads_back, disturbed).run()
    except OverflowError:
        if short_result is None or short_result.kind is None:
            raise
        return short_result


class _RestartSearch:
    """Breadth-first search. A program is a number of position and bits; a state combines both numbers."""

    def __init__(
        self,
        programs: Sequence[Sequence[WireOperation]],
        reads_back: bool,
        disturbed: bool,
        windows: BlockWindows | None = None,
    ) -> None:
        self.programs, self.windows = programs, windows
        self.reads_back, self.disturbed = reads_back, disturbed
        self.sides = (max(map(len, programs)) + 1) << _BIT_COUNT
        self.done = [_finished_intervals(program) for program in programs]
        checks = [[i for i, move in enumerate(row) if move.kind == "check"][:1] for row in programs]
        self.seen_running = [
            rows[0] if rows and not programs[i][rows[0]].value else -1 for i, rows in enumerate(checks)
        ]
        """Position at which the lead sees that the other program runs, -1 for the following program."""
        waits = [[i for i, move in enumerate(row) if move.kind == "look" and move.value] for row in programs]
        self.ready_position = [rows[0] if rows else 0 for rows in waits]
        """Position at which a panel says that it is ready for the first meeting."""
        self.predecessors: dict[int, int] = {}
        """Predecessor of each state, -1 for the initial ones."""
        self.options: dict[int, tuple[tuple[int, str, bool], ...]] = {}

    def run(self) -> RestartResult:
        """Return the first fault in the order of events, if there is one."""
        lines = (0, _LINE_BIT | _LINE_READ_BIT)
        todo = [a * self.sides + b for a in lines for b in lines]
        known = self.predecessors = dict.fromkeys(todo, -1)
        for state in todo:
            both = divmod(state, self.sides)
            fault = self._fault(both)
            after = [new for *_, new in self._successors(both)]
            after += self._equivalent_states(both)
            if not (fault or self.disturbed):
                fault = self._undisturbed_fault(both, bool(after))
            if fault is not None:
                steps_at = self._line(0, both[0]), self._line(1, both[1])
                return RestartResult(*fault, steps_at, self._events_to(state), len(known))
            for new in after:
                if new not in known:
                    known[new] = state
                    todo.append(new)
            if len(known) > MAX_STATES:
                raise OverflowError(f"more than {MAX_STATES} states")
        return RestartResult(None, 0, (0, 0), (), len(known))

    def _line(self, program: int, side: int) -> int:
        row = self.programs[program]
        return row[min(side >> _BIT_COUNT, len(row) - 1)].line if row else 0

    def _events_to(self, state: int) -> tuple[tuple[int, str, int], ...]:
        """Events that lead to a state, without those of wires."""
        out = []
        while (earlier := self.predecessors[state]) >= 0:
            both = divmod(earlier, self.sides)
            moved = ((i, what) for i, what, new in self._successors(both) if new == state)
            program, what = next(moved, (0, "wire"))
            if what != "wire":
                out.append((program, what, self._line(program, both[program])))
            state = earlier
        return tuple(reversed(out))

    def _equivalent_states(self, both: tuple[int, int]) -> list[int]:
        """The equivalent state at an earlier position with the same blocks before it."""
        positions = (both[0] >> _BIT_COUNT, both[1] >> _BIT_COUNT)
        other = None if self.windows is None else self.windows.equivalent_positions(positions)
        if other is None:
            return []
        a, b = (position << _BIT_COUNT | side & _BIT_MASK for position, side in zip(other, both, strict=True))
        return [a * self.sides + b]

    def _is_ending(self, program: int, other: int) -> bool:
        """Whether a program's monitoring thread is about to end it."""
        if program & 3 != _MODE_ON or not program & _MONITOR_BIT:
            return False
        return not other & _RUNNING_READ_BIT or (self.reads_back and not program & _RUNNING_BIT)

    def _fault(self, both: tuple[int, int]) -> tuple[FaultKind, int] | None:
        for i, program_state in enumerate(both):
            row, position = self.programs[i], program_state >> _BIT_COUNT
            if program_state & 3 != _MODE_ON or position >= len(row) or row[position].kind != "done":
                continue
            if not program_state & _MONITOR_BIT:
                return "unwatched", i
            other = both[1 - i]
            is_behind = self.done[1 - i][other >> _BIT_COUNT] < row[position].value - 1
            if is_behind and other & 3 != _MODE_OFF and not self._is_ending(program_state, other):
                return "apart", i
        return None

    def _undisturbed_fault(self, both: tuple[int, int], goes_on: bool) -> tuple[FaultKind, int] | None:
        """Whether a program ends itself without disturbance, or neither program can continue."""
        for i, program_state in enumerate(both):
            row, position, other = self.programs[i], program_state >> _BIT_COUNT, both[1 - i]
            if self._is_ending(program_state, other):
                return "ends", i
            if program_state & 3 == _MODE_ON and position < len(row) and position != self.seen_running[i]:
                move = row[position]
                low = self.reads_back and not program_state & _RUNNING_BIT and move.kind in ("wait", "look")
                if low or (move.kind == "check" and not _passes_check(move, program_state, other)):
                    return "ends", i
        gone = all(side >> _BIT_COUNT >= len(row) for side, row in zip(both, self.programs, strict=True))
        return None if goes_on or gone else ("stuck", 0)

    def _may_happen(self, both: tuple[int, int], program: int) -> bool:
        """Whether an action that takes a person long may happen to the program ``program``.

        Wires have followed, and the other program is at an operation that takes long. Actions that the
        operator is asked for are included.
        """
        other_state, other = both[1 - program], both[program]
        row, position = self.programs[1 - program], other_state >> _BIT_COUNT
        if not self.disturbed:
            if other & 3 == _MODE_OFF:  # each program is started once, the lead first
                return other >> _BIT_COUNT == 0 and (
                    self.seen_running[program] >= 0 or position == self.seen_running[1 - program]
                )
            return (
                other >> _BIT_COUNT != self.seen_running[program]
                or position >= self.ready_position[1 - program]
            )
        if any((side >> 2 ^ side >> 4) & 3 for side in both):
            return False
        if other_state & 3 != _MODE_ON:
            return True
        if self._is_ending(other_state, other) or position >= len(row):
            return False
        move = row[position]
        if move.kind in ("wait", "look"):
            return not (self.reads_back and not other_state & _RUNNING_BIT) and not _is_read(move, other)
        return move.kind in ("ask", "done") or move.is_slow

    def _successors(self, both: tuple[int, int]) -> Iterator[tuple[int, str, int]]:
        """Possible events: program, event, and next state."""
        for i, program_state in enumerate(both):
            other = both[1 - i]
            key = (program_state << _BIT_COUNT | other & _BIT_MASK) << 1 | i
            options = self.options.get(key)
            if options is None:
                options = self.options[key] = tuple(self._program_events(i, program_state, other & _BIT_MASK))
            for new, what, is_slow in options:
                if not is_slow or self._may_happen(both, i):
                    yield i, what, new * self.sides + other if i == 0 else other * self.sides + new

    def _program_events(self, i: int, program_state: int, other: int) -> Iterator[tuple[int, str, bool]]:
        """Events of one program, given the bits of the other: next value, event, whether it takes long."""
        for shift in (_RUNNING_BIT, _LINE_BIT):
            if (program_state ^ program_state >> 2) & shift:
                yield program_state ^ shift << 2, "wire", False
        mode, bits, position = program_state & 3, program_state & _BIT_MASK, program_state >> _BIT_COUNT
        if mode == _MODE_OFF:
            yield bits | _MODE_ON, "start", True
            return
        stopped_state = bits & ~(3 | _MONITOR_BIT | _RUNNING_BIT)
        if self.disturbed:
            for stopped in sorted({stopped_state, stopped_state & ~_LINE_BIT}):
                yield stopped, "stop", False
            if mode == _MODE_PAUSED:
                yield program_state & ~3 | _MODE_ON, "go on", False
                return
            low = program_state & ~(3 | _RUNNING_BIT) | _MODE_PAUSED
            for paused in sorted({low, low & ~_LINE_BIT}):
                yield paused, "pause", False
        row = self.programs[i]
        if position >= len(row):
            yield (stopped_state if self.disturbed else position << _BIT_COUNT | stopped_state), "end", False
            return
        move, is_slow = row[position], False
        match move.kind:
            case "wait" | "look":
                if (self.reads_back and not program_state & _RUNNING_BIT) or not _is_read(move, other):
                    return  # it waits, or ends, which equals a stop
            case "check":
                if not _passes_check(move, program_state, other):
                    return  # it ends, which equals a stop
                is_slow = not self.disturbed
            case "run":
                is_slow = move.is_slow and self.disturbed
        after = program_state
        if move.kind in ("set", "run", "watch"):
            bit = {"set": _LINE_BIT, "run": _RUNNING_BIT, "watch": _MONITOR_BIT}[move.kind]
            after = program_state | bit if move.value else program_state & ~bit
            if move.kind == "run" and move.value and not self.disturbed:
                after |= _RUNNING_READ_BIT  # the wire settles before the next statement
        yield after + (1 << _BIT_COUNT), "step", is_slow


def _is_read(move: WireOperation, other: int) -> bool:
    return bool(other & (_LINE_READ_BIT if move.kind == "wait" else _RUNNING_READ_BIT)) == bool(move.value)


def _passes_check(move: WireOperation, program_state: int, other: int) -> bool:
    line = bool(other & _LINE_READ_BIT) == bool(move.value)
    return line and bool(other & _RUNNING_READ_BIT) and bool(program_state & _RUNNING_BIT) == move.own_level


def _finished_intervals(program: Sequence[WireOperation]) -> list[int]:
    """For each position, the last interval whose work is done: the one before that of the work ahead."""
    out = [_AFTER_ALL] * (len(program) + 1)
    for position in range(len(program) - 1, -1, -1):
        move = program[position]
        out[position] = move.value - 1 if move.kind in ("go", "done") else out[position + 1]
    return out
