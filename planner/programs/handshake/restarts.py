"""Model checker for two programs that restart from their beginning after each stop, as UR programs do.

A stop ends such a program for good, and a start begins at its first statement, whatever the other program
does meanwhile. A program switches its own running wire, which falls with any stop and pause and stays low
after a pause. Its line to the other program stays unchanged, or falls too. Its text determines whether it
monitors the other program.

At any instant either program may be stopped, paused, continued or started, and its question answered by an
operator who ignores the panels. Wires may take any time. Operator actions take longer than controller
actions in one case only, which the text ensures by a wait: if a program has waited for a second before its
running wire rises, then wires, monitoring threads and the other program's statements have settled. They have
also settled before a start.

It is a fault if a program works ("go" to "done") while nothing monitors the other one, or while the other one
runs and has not done its work of the previous interval (it is at another meeting, or at its start). Without
disturbances, and with operators who follow instructions, no program may end itself or wait for ever.

Of long programs a shortened form, with fewer of the meetings that are alike, is checked
(:mod:`planner.programs.handshake.block_windows`). If that finds a fault, the whole programs are checked.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Final, Literal

from planner.programs.handshake import block_windows
from planner.programs.handshake.block_windows import BlockWindows
from planner.programs.handshake.wire_operations import WireOperation

FaultKind = Literal["unwatched", "apart", "ends", "stuck"]
"""Kind of fault of a program.

"unwatched": It works while it does not monitor the other one. "apart": It works before the other one has done
its previous work. "ends": It ends itself without disturbance. "stuck": Neither program can continue.
"""
MAX_STATES: Final = 2_000_000
"""Maximum number of explored states. Programs with more are not proven."""
_MODE_OFF, _MODE_ON, _MODE_PAUSED = 0, 1, 2
_RUNNING_BIT, _LINE_BIT, _RUNNING_READ_BIT, _LINE_READ_BIT, _MONITOR_BIT = 4, 8, 16, 32, 64
"""Bits of a program above the two bits of its mode.

They are the levels of its running wire and its line as it drives them, then both as the other program reads
them, and whether it monitors the other program.
"""
_BIT_COUNT, _BIT_MASK = 7, 127
"""Number of bits of a program, including its mode, and mask of all of them."""
_AFTER_ALL: Final = 2**60
"""Interval after that of any work."""


@dataclasses.dataclass(frozen=True)
class RestartResult:
    """Result of a check.

    Attributes:
        kind: Kind of fault, None for none.
        program: Program at fault, 0 or 1.
        lines: Indices of the steps at which both programs are.
        events: Events from the start to the fault, as (program, event, index of its step).
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
    """Explore all joint behaviour of two programs, and return the first fault, if there is one.

    Args:
        programs: Operations of both programs.
        blocks: Interval of each operation, by program.
        reads_back: Whether each wait, look and watch ends the program if its own running wire is 0.
        disturbed: Whether operators may stop, pause and start programs at any time. If False, nobody stops or
            pauses a program, the following one is started when the leading one says so, and its second
            question is answered when the leading one runs.

    Raises:
        OverflowError: The programs have more than :data:`MAX_STATES` states.
    """
    short_programs = block_windows.shorten_programs(programs, blocks) if disturbed else None
    short_result = None
    if short_programs is not None:
        shortened, windows = short_programs
        short_result = _RestartSearch(shortened, reads_back, disturbed, windows).run()
        if short_result.kind is None and not windows.is_invalid:
            return short_result
    try:
        return _RestartSearch(programs, reads_back, disturbed).run()
    except OverflowError:  # the fault in the shortened programs counts, although it is not confirmed
        if short_result is None or short_result.kind is None:
            raise
        return short_result


class _RestartSearch:
    """Breadth-first search over the joint states of two programs.

    The state of a program is an integer: its position, shifted by the number of its bits, and its bits. With
    the states a and b of both programs the joint state is a * ``sides`` + b.

    Attributes:
        programs: Operations of both programs.
        windows: Correspondence with the whole programs if these are shortened, else None.
        reads_back: Whether each wait, look and watch ends the program if its own running wire is 0.
        disturbed: Whether operators may stop, pause and start programs at any time.
        sides: Upper bound on the states of one program.
        done: Last interval whose work is done at each position, by program.
    """

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
        first_checks = [
            [i for i, move in enumerate(program) if move.kind == "check"][:1] for program in programs
        ]
        self.seen_running = [
            positions[0] if positions and not programs[i][positions[0]].value else -1
            for i, positions in enumerate(first_checks)
        ]
        """Position at which the lead sees that the other program runs, -1 for the following program."""
        waits = [
            [i for i, move in enumerate(program) if move.kind == "look" and move.value]
            for program in programs
        ]
        self.ready_position = [positions[0] if positions else 0 for positions in waits]
        """Position at which the panel of each program says that it is ready for the first meeting."""
        self.predecessors: dict[int, int] = {}
        """Predecessor of each state, -1 for the initial ones."""
        self.options: dict[int, tuple[tuple[int, str, bool], ...]] = {}
        """Events of one program by its state and the bits of the other: next state, event, whether slow."""

    def run(self) -> RestartResult:
        """Visit the states in the order of the number of events, and return the first fault, if there is one.

        At first both programs are off, and their lines have any levels.
        """
        initial = (0, _LINE_BIT | _LINE_READ_BIT)
        todo = [a * self.sides + b for a in initial for b in initial]
        self.predecessors = dict.fromkeys(todo, -1)
        reached = self.predecessors
        for state in todo:
            pair = divmod(state, self.sides)
            fault = self._fault(pair)
            next_states = [new for *_, new in self._successors(pair)]
            next_states += self._equivalent_states(pair)
            if not (fault or self.disturbed):
                fault = self._undisturbed_fault(pair, bool(next_states))
            if fault is not None:
                steps_at = self._line(0, pair[0]), self._line(1, pair[1])
                return RestartResult(*fault, steps_at, self._events_to(state), len(reached))
            for new in next_states:
                if new not in reached:
                    reached[new] = state
                    todo.append(new)
            if len(reached) > MAX_STATES:
                raise OverflowError(f"more than {MAX_STATES} states")
        return RestartResult(None, 0, (0, 0), (), len(reached))

    def _line(self, program: int, program_state: int) -> int:
        """Return the index of the step at which a program is in a state."""
        moves = self.programs[program]
        position = program_state >> _BIT_COUNT
        return moves[min(position, len(moves) - 1)].line if moves else 0

    def _events_to(self, state: int) -> tuple[tuple[int, str, int], ...]:
        """Return the events that lead to a state, without those of wires, as (program, event, step)."""
        out = []
        while (previous_state := self.predecessors[state]) >= 0:
            pair = divmod(previous_state, self.sides)
            events = ((i, event) for i, event, new in self._successors(pair) if new == state)
            program, event = next(events, (0, "wire"))
            if event != "wire":
                out.append((program, event, self._line(program, pair[program])))
            state = previous_state
        return tuple(reversed(out))

    def _equivalent_states(self, pair: tuple[int, int]) -> list[int]:
        """Return a list with the equivalent joint state at other positions of shortened programs.

        The list is empty if there is no such state, or if the programs are not shortened. See
        :meth:`BlockWindows.equivalent_positions`.
        """
        positions = (pair[0] >> _BIT_COUNT, pair[1] >> _BIT_COUNT)
        equivalent = None if self.windows is None else self.windows.equivalent_positions(positions)
        if equivalent is None:
            return []
        a, b = (
            position << _BIT_COUNT | program_state & _BIT_MASK
            for position, program_state in zip(equivalent, pair, strict=True)
        )
        return [a * self.sides + b]

    def _is_ending(self, program: int, other: int) -> bool:
        """Return whether a program's monitoring thread is about to end it, given both programs' states."""
        if program & 3 != _MODE_ON or not program & _MONITOR_BIT:
            return False
        return not other & _RUNNING_READ_BIT or (self.reads_back and not program & _RUNNING_BIT)

    def _fault(self, pair: tuple[int, int]) -> tuple[FaultKind, int] | None:
        """Return the fault of a program that works in this joint state, and its number; None for no fault.

        A program at the end of its work ("done") is at fault in two cases. Its monitor does not run. Or the
        other program runs or is paused, and has not done the work of the previous interval, while the monitor
        is not about to end this program.
        """
        for i, program_state in enumerate(pair):
            moves, position = self.programs[i], program_state >> _BIT_COUNT
            if program_state & 3 != _MODE_ON or position >= len(moves) or moves[position].kind != "done":
                continue
            if not program_state & _MONITOR_BIT:
                return "unwatched", i
            other = pair[1 - i]
            is_behind = self.done[1 - i][other >> _BIT_COUNT] < moves[position].value - 1
            if is_behind and other & 3 != _MODE_OFF and not self._is_ending(program_state, other):
                return "apart", i
        return None

    def _undisturbed_fault(self, pair: tuple[int, int], can_continue: bool) -> tuple[FaultKind, int] | None:
        """Return the fault if a program ends itself without disturbance, or if no program can continue.

        A program ends itself by its monitor, at a wait or look if its own running wire is 0, or at a check
        that it does not pass. The check by which the lead sees that the other program runs is left out,
        because the operator may start that program later.
        """
        for i, program_state in enumerate(pair):
            moves, position, other = self.programs[i], program_state >> _BIT_COUNT, pair[1 - i]
            if self._is_ending(program_state, other):
                return "ends", i
            if program_state & 3 == _MODE_ON and position < len(moves) and position != self.seen_running[i]:
                move = moves[position]
                own_low = (
                    self.reads_back and not program_state & _RUNNING_BIT and move.kind in ("wait", "look")
                )
                if own_low or (move.kind == "check" and not _passes_check(move, program_state, other)):
                    return "ends", i
        ended = all(side >> _BIT_COUNT >= len(moves) for side, moves in zip(pair, self.programs, strict=True))
        return None if can_continue or ended else ("stuck", 0)

    def _may_happen(self, pair: tuple[int, int], program: int) -> bool:
        """Return whether a slow event of a program may happen now: a start, an answer or a long wait.

        With disturbances it may happen if all wires have settled and the other program does not continue by
        itself: it does not run, it waits in vain, or its operation is slow, too. Without disturbances it may
        happen if the instructions ask the operator for it: the lead is started first, then the other program,
        and the lead passes its first check when the panel of the other program says that it is ready.
        """
        other_state, own_state = pair[1 - program], pair[program]
        moves, position = self.programs[1 - program], other_state >> _BIT_COUNT
        if not self.disturbed:
            if own_state & 3 == _MODE_OFF:  # each program is started once, the lead first
                return own_state >> _BIT_COUNT == 0 and (
                    self.seen_running[program] >= 0 or position == self.seen_running[1 - program]
                )
            return (
                own_state >> _BIT_COUNT != self.seen_running[program]
                or position >= self.ready_position[1 - program]
            )
        if any((side >> 2 ^ side >> 4) & 3 for side in pair):
            return False
        if other_state & 3 != _MODE_ON:
            return True
        if self._is_ending(other_state, own_state) or position >= len(moves):
            return False
        move = moves[position]
        if move.kind in ("wait", "look"):
            return not (self.reads_back and not other_state & _RUNNING_BIT) and not _is_read(move, own_state)
        return move.kind in ("ask", "done") or move.is_slow

    def _successors(self, pair: tuple[int, int]) -> Iterator[tuple[int, str, int]]:
        """Yield the possible events of both programs: program, event, and next joint state."""
        for i, program_state in enumerate(pair):
            other = pair[1 - i]
            key = (program_state << _BIT_COUNT | other & _BIT_MASK) << 1 | i
            options = self.options.get(key)
            if options is None:
                options = self.options[key] = tuple(self._program_events(i, program_state, other & _BIT_MASK))
            for next_state, event, is_slow in options:
                if not is_slow or self._may_happen(pair, i):
                    yield (
                        i,
                        event,
                        next_state * self.sides + other if i == 0 else other * self.sides + next_state,
                    )

    def _program_events(self, i: int, program_state: int, other: int) -> Iterator[tuple[int, str, bool]]:
        """Yield the possible events of one program: next state, name of the event, whether it is slow.

        Args:
            i: Number of the program.
            program_state: Its state.
            other: Bits of the other program.
        """
        # a wire follows: the bit of its level as read is two bits above that of its level as driven
        for level_bit in (_RUNNING_BIT, _LINE_BIT):
            if (program_state ^ program_state >> 2) & level_bit:
                yield program_state ^ level_bit << 2, "wire", False
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
            paused_state = program_state & ~(3 | _RUNNING_BIT) | _MODE_PAUSED
            for paused in sorted({paused_state, paused_state & ~_LINE_BIT}):
                yield paused, "pause", False
        moves = self.programs[i]
        if position >= len(moves):
            yield (stopped_state if self.disturbed else position << _BIT_COUNT | stopped_state), "end", False
            return
        move, is_slow = moves[position], False
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
        next_state = program_state
        if move.kind in ("set", "run", "watch"):
            bit = {"set": _LINE_BIT, "run": _RUNNING_BIT, "watch": _MONITOR_BIT}[move.kind]
            next_state = program_state | bit if move.value else program_state & ~bit
            if move.kind == "run" and move.value and not self.disturbed:
                next_state |= _RUNNING_READ_BIT  # the wire settles before the next statement
        yield next_state + (1 << _BIT_COUNT), "step", is_slow


def _is_read(move: WireOperation, other: int) -> bool:
    """Return whether a program reads the level for which it waits; ``other``: bits of the other program."""
    return bool(other & (_LINE_READ_BIT if move.kind == "wait" else _RUNNING_READ_BIT)) == bool(move.value)


def _passes_check(move: WireOperation, program_state: int, other: int) -> bool:
    """Return whether a program continues after a check, given the bits of both programs.

    It reads the other program's line at the required level and its running wire at 1, and its own running
    wire has the required level.
    """
    line_matches = bool(other & _LINE_READ_BIT) == bool(move.value)
    return (
        line_matches
        and bool(other & _RUNNING_READ_BIT)
        and bool(program_state & _RUNNING_BIT) == move.own_level
    )


def _finished_intervals(program: Sequence[WireOperation]) -> list[int]:
    """Return for each position of a program the last interval whose work is done there.

    It is the interval before that of the program's next work. At a position between "go" and "done" the work
    of this interval is not done yet. After the last work all intervals are done.
    """
    out = [_AFTER_ALL] * (len(program) + 1)
    for position in range(len(program) - 1, -1, -1):
        move = program[position]
        out[position] = move.value - 1 if move.kind in ("go", "done") else out[position + 1]
    return out
