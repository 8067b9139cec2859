"""Model checker for two programs that meet by signals: explores all their joint behaviour.

**States.** Each program is a sequence of actions. A wire carries one program's output to the other one's
input with any delay: its reading end follows its driving end at any later instant, so that a pulse may pass
unseen. Any program may stop at any instant for good and leave the outputs as its error handler does. All
interleavings are explored.

**Running wires.** With ``running`` each controller drives a wire that is 1 while its program runs. Both
programs are stopped at first. Any of them may be stopped at any instant and started again later, both or
one, in either order. When the wire falls, the other program stops after one more step at most: wire and stop
input are faster than two steps. A program that has ended no longer runs. One of the wires may be cut at any
instant. After a stop the other side therefore stops too, or reads 0 until somebody starts it again: no power
is on. The wire itself cannot detect that it is stuck; then no program may start to work (``unwatched``).

**Exploration.** Every step of a program adds one to the sum of both positions, so the reachable states are
visited sum by sum. What depends on positions only is put in relative form, and equal sets of states before
equal actions are expanded once. This is exact, and takes time proportional to the length of the programs.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import Final, Literal

import numpy as np

from planner.geometry.arrays import IntArray

ActionKind = Literal["set", "wait", "go", "done", "gate", "look", "pause"]
FaultKind = Literal["deadlock", "lost_edge", "apart", "unwatched"]
RunningWire = Literal["works", "low", "high"]
"""A running wire that works, or is stuck at a level for ever. A missing wire counts as stuck."""
Levels = tuple[tuple[int, int], ...]
_State = tuple[int, int]
"""Offset between the positions of both programs, and bits.

The bits are three for each wire (driven level, level as read, a change that the reader has not seen yet),
then four for each program, grouped by kind: it has stopped for good, it is stopped, the other one reads it
as stopped, its running wire is cut.
"""
_PositionFacts = tuple[int, int, bool, bool, bool, bool]
"""What the positions determine.

These are the codes of both actions, for each program whether the other one has done the previous work, and
for each program whether its gate is open.
"""
_ProgramStep = tuple[int, int, FaultKind | None]
"""A step of a program: which one, the bits after it, and the fault that it causes."""
_AFTER_ALL, _BEFORE_ALL = 2**60, -(2**60)
_UNCONDITIONAL_FAULTS: Final = ("apart", "unwatched")
"""Faults whatever the operator does."""


@dataclasses.dataclass(frozen=True, slots=True)
class AutomatonAction:
    """One action of a program.

    "set" puts ``wire`` to ``value``. "wait" waits until it reads so. "go" and "done" enclose the work of the
    interval ``value`` between two meetings. "gate" is passed once the other program has reached its position
    ``value``; a program that is stopped before it is not started earlier either. "look" waits until the
    other program is read as running (``value`` 1) or stopped (0). "pause": the program stops itself until it
    is started again.

    Attributes:
        kind: Kind of action.
        wire: Number of the wire.
        value: Level, interval or position, by kind.
        resets: Levels of wires that the active error handler leaves, as (wire, value).
        line: Index of its step in the program, for messages.
    """

    kind: ActionKind
    wire: int = 0
    value: int = 0
    resets: Levels = ()
    line: int = 0


@dataclasses.dataclass(frozen=True)
class AutomatonEvent:
    """An event: program 0 or 1 executed the action at ``position``."""

    program: int
    position: int


@dataclasses.dataclass(frozen=True)
class HandshakeFault:
    """A fault and how it comes about.

    Attributes:
        kind: Kind of fault.
        positions: Positions of both programs.
        program: Program whose action is at fault (0 in a deadlock).
        driven: Levels of the wires at their driving ends.
        read: Levels of the wires at their reading ends.
        trace: The last events before, in order.
        steps: Number of events from the start.
    """

    kind: FaultKind
    positions: tuple[int, int]
    program: int
    driven: tuple[int, ...]
    read: tuple[int, ...]
    trace: tuple[AutomatonEvent, ...]
    steps: int


@dataclasses.dataclass(frozen=True)
class HandshakeVerdict:
    """Result of a check.

    Attributes:
        findings: Faults with the fewest events, none for correct programs.
        states: Number of explored states, with their positions.
        kinds: Number of explored states that differ in more than their positions.
    """

    findings: tuple[HandshakeFault, ...]
    states: int
    kinds: int


class ProgramProduct:
    """Product of two programs, shared by several checks.

    It holds what the positions of both programs determine, by their sum and offset.

    Raises:
        ValueError: There are not two programs.
    """

    def __init__(self, programs: Sequence[Sequence[AutomatonAction]]) -> None:
        if len(programs) != 2:
            raise ValueError(f"{len(programs)} programs; the check takes two")
        self.max_sum = sum(len(program) for program in programs)
        self.table: list[AutomatonAction | None] = [None]
        known: dict[tuple[object, ...], int] = {}
        code = []
        for program in programs:
            row = []
            for action in program:
                value = action.value if action.kind in ("set", "wait", "look") else 0
                if action.kind == "go":
                    value = min(action.value, 1)
                key = (action.kind, action.wire, value, action.resets)
                if key not in known:
                    known[key] = len(self.table)
                    self.table.append(action)
                row.append(known[key])
            code.append(np.array([*row, 0]))
        self._code = code
        self._need = [
            np.array([a.value - 1 if a.kind == "go" else _BEFORE_ALL for a in program] + [_BEFORE_ALL])
            for program in programs
        ]
        self._gate = [
            np.array([a.value if a.kind == "gate" else -1 for a in program] + [-1]) for program in programs
        ]
        self._finished = [np.array(_finished_intervals(program)) for program in programs]
        self._kinds: dict[int, list[int]] = {}

    def kinds(self, offset: int) -> list[int]:
        """Return for each sum of positions a number for what they determine at an offset.

        Numbers of sums that are impossible at this offset have no meaning.
        """
        if offset not in self._kinds:
            total: IntArray = np.arange(self.max_sum + 1)
            first, second = (
                np.clip(doubled_position >> 1, 0, len(code) - 1)
                for doubled_position, code in zip((total + offset, total - offset), self._code, strict=True)
            )
            out = self._code[0][first] * len(self.table) + self._code[1][second]
            for flag in (
                self._need[0][first] <= self._finished[1][second],
                self._need[1][second] <= self._finished[0][first],
                second >= self._gate[0][first],
                first >= self._gate[1][second],
            ):
                out = 2 * out + flag
            self._kinds[offset] = out.tolist()
        return self._kinds[offset]

    def facts_at(self, total: int, offset: int) -> _PositionFacts:
        """Return what a sum of positions determines at an offset.

        Args:
            total: Sum of the positions.
            offset: Difference of the positions.
        """
        kind = self.kinds(offset)[total]
        first, second = divmod(kind >> 4, len(self.table))
        return first, second, bool(kind & 8), bool(kind & 4), bool(kind & 2), bool(kind & 1)


def check_handshake(
    programs: Sequence[Sequence[AutomatonAction]] | ProgramProduct,
    wires: int,
    gates: bool = True,
    trace: int = 12,
    running: tuple[RunningWire, RunningWire] | None = None,
) -> HandshakeVerdict:
    """Explore all joint behaviour of two programs.

    Faults are: "apart", a program works in an interval before the other one has done its work of the
    previous interval; "lost_edge", a wire changes before the other program has seen its last change, or a
    change is never seen; "unwatched", a program works after the first meeting although a running wire is
    stuck; "deadlock".

    Args:
        programs: Actions of both programs, or their product.
        wires: Number of wires; initially each has any level, at both ends.
        gates: False if gates are passed at any time (the operator does not look). Then only "apart" and
            "unwatched" are faults.
        trace: Maximum number of events in the trace of a fault.
        running: State of the wire that each program's controller drives. None: both programs run from the
            start, only their end stops them, and "look" and "pause" are passed.
    """
    product = programs if isinstance(programs, ProgramProduct) else ProgramProduct(programs)
    return _HandshakeSearch(product, wires, gates, trace, running).run()


@dataclasses.dataclass(frozen=True)
class _StateSet:
    """States (offset between the positions, bits) and the offsets in them."""

    states: frozenset[_State]
    offsets: tuple[int, ...]


class _HandshakeSearch:
    def __init__(
        self,
        product: ProgramProduct,
        wires: int,
        gates: bool,
        trace: int,
        running: tuple[RunningWire, RunningWire] | None,
    ) -> None:
        self.product = product
        self.table = product.table
        self.wires = wires
        self.gates = gates
        self.trace = trace
        self.running = running
        self.stuck = running is not None and running != ("works", "works")
        self.gone_bit, self.stopped_bit, self.low_bit, self.cut_bit = (3 * wires + 2 * i for i in range(4))

    def run(self) -> HandshakeVerdict:
        # Initial states: all levels of the wires, read as driven. With running wires both are stopped.
        first = 0
        if self.running is not None:
            first = 3 << self.stopped_bit | sum(
                1 << self.low_bit + i for i in range(2) if self.running[i] != "high"
            )
        start = frozenset(
            (0, first | sum(level * 3 << 3 * wire for wire, level in enumerate(levels)))
            for levels in itertools.product((0, 1), repeat=self.wires)
        )
        rows = [_state_set(start)]
        known = {start: 0}
        memo: dict[tuple[int, tuple[int, ...]], tuple[int, int, frozenset[FaultKind]]] = {}
        kinds: list[list[list[int]]] = []
        history: list[int] = []
        findings: list[HandshakeFault] = []
        current, states = 0, 0
        for total in range(self.product.max_sum + 1):
            # One sum: the set of states and the facts that positions determine give the set at the next sum.
            row = rows[current]
            if not row.states:
                break
            history.append(current)
            while len(kinds) < len(rows):
                kinds.append([self.product.kinds(offset) for offset in rows[len(kinds)].offsets])
            facts = tuple([kind[total] for kind in kinds[current]])
            answer = memo.get((current, facts))
            if answer is None:
                decided = {offset: self.product.facts_at(total, offset) for offset in row.offsets}
                following, count, faults = self._expand(row, decided)
                if following not in known:
                    known[following] = len(rows)
                    rows.append(_state_set(following))
                answer = memo[current, facts] = (known[following], count, faults)
            current, count, faults = answer
            states += count
            if faults:
                findings += [self._finding(kind, total, rows, history) for kind in sorted(faults)]
                break
        return HandshakeVerdict(tuple(findings), states, sum(len(row.states) for row in rows))

    # ---- one sum of places ----

    def _expand(
        self, row: _StateSet, facts: Mapping[int, _PositionFacts]
    ) -> tuple[frozenset[_State], int, frozenset[FaultKind]]:
        """States after one event, number of states before it, and the faults."""
        faults: set[FaultKind] = set()
        out: set[_State] = set()
        # All states at this sum; each step of a program leads to a state at the next one.
        whole = self._closure(row.states, facts)
        for offset, bits in whole:
            moved = self._enabled_steps(bits, facts[offset])
            stopped = bits >> self.gone_bit & 3
            for program, after, fault in moved:
                if fault and (fault in _UNCONDITIONAL_FAULTS or (self.gates and not stopped)):
                    faults.add(fault)
                out.add((offset + (1 if program == 0 else -1), after))
            if self.gates and self._is_deadlocked(bits, facts[offset], moved):
                faults.add("deadlock")
            if self.gates and self._has_unread_change(bits, facts[offset]):
                faults.add("lost_edge")
        return frozenset(out), len(whole), frozenset(faults)

    def _closure(self, states: frozenset[_State], facts: Mapping[int, _PositionFacts]) -> set[_State]:
        """Closure of states under changes without a step of a program: wires follow, programs stop."""
        whole = set(states)
        todo = list(states)
        while todo:
            offset, bits = todo.pop()
            # a reading end follows its driving end
            lagging = [wire for wire in range(self.wires) if (bits >> 3 * wire ^ bits >> 3 * wire + 1) & 1]
            after = [bits ^ 2 << 3 * wire for wire in lagging]
            if self.running is not None:
                after += self._external_successors(bits, facts[offset])
            # a program stops for good, and its outputs stay or change as its error handler does
            for program in range(2):
                mark = 1 << self.gone_bit + program
                action = self.table[facts[offset][program]]
                if bits & mark or action is None or self.stuck:
                    continue
                if self.running is not None:
                    mark |= 1 << self.stopped_bit + program
                after.append(bits | mark)
                changed = bits
                for wire, value in action.resets:
                    changed = changed & ~(1 << 3 * wire) | value << 3 * wire
                after.append(changed | mark)
            for new in after:
                state = (offset, new)
                if state not in whole:
                    whole.add(state)
                    todo.append(state)
        return whole

    def _external_successors(self, bits: int, facts: _PositionFacts) -> list[int]:
        """Successors by starts, stops and cut wires, and as running wires follow."""
        out = [bits & ~(1 << self.stopped_bit + program) for program in self._startable(bits, facts)]
        for program in range(2):
            # a program stops; its wire falls (and stops the other one) or rises; a wire is cut
            stopped, low = bits >> self.stopped_bit + program & 1, bits >> self.low_bit + program & 1
            other = 1 << self.stopped_bit + 1 - program
            if not stopped:
                out.append(bits | 1 << self.stopped_bit + program)
            if not self._wire_works(bits, program):
                continue
            if stopped and not low:
                out.append(bits | 1 << self.low_bit + program | other)
            if not stopped and low:
                out.append(bits & ~(1 << self.low_bit + program))
            if self.gates or self.stuck or bits >> self.cut_bit:  # only one fault of the cell at a time
                continue
            cut = bits | 1 << self.cut_bit + program | 1 << self.low_bit + program
            out.append(cut if low else cut | other)
        return out

    def _wire_works(self, bits: int, program: int) -> bool:
        """Whether the running wire of a program works and is not cut."""
        return (
            self.running is not None
            and self.running[program] == "works"
            and not bits >> self.cut_bit + program & 1
        )

    def _startable(self, bits: int, facts: _PositionFacts) -> list[int]:
        """Stopped programs that may be started again: their stop has been seen, and gates are open."""
        return [
            program
            for program in range(2)
            if bits >> self.stopped_bit + program & 1
            and self.table[facts[program]] is not None
            and not bits >> self.gone_bit + program & 1
            and (bits >> self.low_bit + program & 1 or not self._wire_works(bits, program))
            and (not self.gates or facts[4 + program])
        ]

    def _is_deadlocked(self, bits: int, facts: _PositionFacts, moved: list[_ProgramStep]) -> bool:
        """Whether no unfinished program can ever continue.

        States in which a program has stopped for good or a running wire is cut do not count.
        """
        if moved or bits >> self.gone_bit & 3 or bits >> self.cut_bit or not (facts[0] or facts[1]):
            return False
        if any((bits >> 3 * wire ^ bits >> 3 * wire + 1) & 1 for wire in range(self.wires)):
            return False
        if self.running is None:
            return True
        follows = any((bits >> self.stopped_bit + i ^ bits >> self.low_bit + i) & 1 for i in range(2))
        ends = any(not facts[i] and not bits >> self.stopped_bit + i & 1 for i in range(2))
        return not (self.stuck or follows or ends or self._startable(bits, facts))

    def _has_unread_change(self, bits: int, facts: _PositionFacts) -> bool:
        """Whether both programs have ended and the last change of a wire was never seen."""
        unseen = any(bits >> 3 * wire & 4 for wire in range(self.wires))
        return not (facts[0] or facts[1]) and not bits >> self.gone_bit & 3 and unseen

    def _enabled_steps(self, bits: int, facts: _PositionFacts) -> list[_ProgramStep]:
        """Enabled steps of the programs."""
        out: list[_ProgramStep] = []
        for program in range(2):
            action = self.table[facts[program]]
            if action is None or (bits >> self.gone_bit | bits >> self.stopped_bit) >> program & 1:
                continue
            other = 1 - program
            shift = 3 * action.wire
            fault: FaultKind | None = None
            after = bits
            match action.kind:
                case "set":
                    if bits >> shift & 1 != action.value:
                        fault = "lost_edge" if bits >> shift & 4 else None
                        after = bits & ~(1 << shift) | action.value << shift | 4 << shift
                case "wait":
                    if bits >> shift + 1 & 1 != action.value:
                        continue
                    if bits >> shift & 1 == action.value:
                        after = bits & ~(4 << shift)  # the reading program has seen the last change
                case "go":
                    fault = None if facts[2 + program] else "apart"
                    if self.stuck and action.value:
                        fault = "unwatched"
                case "gate":
                    if self.gates and not facts[4 + program]:
                        continue
                case "look" if self.running is not None:
                    if (bits >> self.low_bit + other & 1) == action.value:
                        continue
                case "pause" if self.running is not None:
                    after |= 1 << self.stopped_bit + program
            # after one step of this program the fallen running wire of the other one stops it
            fallen = bits >> self.stopped_bit + other & ~(bits >> self.low_bit + other) & 1
            if fallen and self._wire_works(bits, other):
                after |= 1 << self.low_bit + other | 1 << self.stopped_bit + program  # by its stop input
            out.append((program, after, fault))
        return out

    # ---- how it comes about ----

    def _states_with_steps(self, total: int, row: _StateSet) -> dict[_State, list[_ProgramStep]]:
        """States at a sum of positions, with their enabled steps."""
        facts = {offset: self.product.facts_at(total, offset) for offset in row.offsets}
        return {
            (offset, bits): self._enabled_steps(bits, facts[offset])
            for offset, bits in sorted(self._closure(row.states, facts))
        }

    def _finding(
        self, kind: FaultKind, total: int, rows: list[_StateSet], history: list[int]
    ) -> HandshakeFault:
        # walk back from the faulty state, one sum at a time, over any predecessor
        at, program = next(self._faulty_states(kind, total, rows[history[total]]))
        events: list[AutomatonEvent] = []
        state, level = at, total
        while level > 0 and len(events) < self.trace:
            state, event = self._predecessor(state, level, rows[history[level - 1]])
            events.append(event)
            level -= 1
        offset, bits = at
        return HandshakeFault(
            kind,
            ((total + offset) >> 1, (total - offset) >> 1),
            program,
            tuple(bits >> 3 * wire & 1 for wire in range(self.wires)),
            tuple(bits >> 3 * wire + 1 & 1 for wire in range(self.wires)),
            tuple(reversed(events)),
            total,
        )

    def _faulty_states(self, kind: FaultKind, total: int, row: _StateSet) -> Iterator[tuple[_State, int]]:
        """States with the fault and the program that causes it, those without stopped programs first."""
        whole = self._states_with_steps(total, row)
        for (offset, bits), moved in sorted(whole.items(), key=lambda item: item[0][1] >> self.gone_bit & 3):
            stopped = bits >> self.gone_bit & 3
            for program, _, fault in moved:
                if fault == kind and (kind in _UNCONDITIONAL_FAULTS or not stopped):
                    yield (offset, bits), program
            if kind == "deadlock" and self._is_deadlocked(bits, self.product.facts_at(total, offset), moved):
                yield (offset, bits), 0
            if kind == "lost_edge" and self._has_unread_change(bits, self.product.facts_at(total, offset)):
                yield (offset, bits), 0

    def _predecessor(self, state: _State, level: int, row: _StateSet) -> tuple[_State, AutomatonEvent]:
        """A predecessor of ``state`` at the sum ``level``, and the event between them."""
        for (offset, bits), moved in self._states_with_steps(level - 1, row).items():
            for program, after, _ in moved:
                next_offset = offset + (1 if program == 0 else -1)
                if next_offset != state[0]:
                    continue
                if state in self._closure(
                    frozenset({(next_offset, after)}),
                    {next_offset: self.product.facts_at(level, next_offset)},
                ):
                    position = (level - 1 + offset) >> 1 if program == 0 else (level - 1 - offset) >> 1
                    return (offset, bits), AutomatonEvent(program, position)
        raise RuntimeError("a reached state has no predecessor")


def _state_set(states: frozenset[_State]) -> _StateSet:
    return _StateSet(states, tuple(sorted({offset for offset, _ in states})))


def _finished_intervals(program: Sequence[AutomatonAction]) -> list[int]:
    """For each position, the last interval whose work is done: the one before that of the work ahead."""
    out = [_AFTER_ALL] * (len(program) + 1)
    for position in range(len(program) - 1, -1, -1):
        action = program[position]
        out[position] = action.value - 1 if action.kind in ("go", "done") else out[position + 1]
    return out
