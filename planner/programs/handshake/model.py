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
visited sum by sum. A state holds only the difference of the positions (its offset), and equal sets of states
before equal actions are expanded once. This is exact, and takes time proportional to the length of the
programs.
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
"""Levels of wires, as pairs (number of the wire, level)."""
_State = tuple[int, int]
"""State of both programs and all wires at a given sum of the positions: (offset, bits).

The position of a program is the index of its next action. The offset is the position of the first program
less that of the second one, so that sum and offset determine both positions.

The bits hold the rest. The lowest bits are three for each wire: driven level, level as read, and whether the
reader has not seen the last change yet. Then four pairs follow, with a bit for each program: it has stopped
for good, it is stopped, the other one reads it as stopped, its running wire is cut.
"""
_PositionFacts = tuple[int, int, bool, bool, bool, bool]
"""Facts that follow from the positions of both programs.

They are the codes of both actions (0 at the end of a program), for each program whether the other one has
done the work of the previous interval, and for each program whether its gate is open.
"""
_ProgramStep = tuple[int, int, FaultKind | None]
"""A step of a program, which executes one action: its number (0, 1), the bits after it, and its fault."""
_AFTER_ALL, _BEFORE_ALL = 2**60, -(2**60)
"""Interval after that of any work, and before it."""
_UNCONDITIONAL_FAULTS: Final = ("apart", "unwatched")
"""Faults that count even if the operator ignores the panels, and after a program has stopped for good."""


@dataclasses.dataclass(frozen=True, slots=True)
class AutomatonAction:
    """One action of a program.

    - "set": The program sets ``wire`` to ``value``.
    - "wait": The program waits until it reads ``value`` from ``wire``.
    - "go", "done": They enclose the work of the interval ``value`` between two meetings.
    - "gate": The program waits until the other one has reached its position ``value``. A program that is
      stopped at a gate is not started before that either.
    - "look": The program waits until it reads the other one as running (``value`` 1) or stopped (0).
    - "pause": The program stops itself until it is started again.

    Attributes:
        kind: Kind of action.
        wire: Number of the wire.
        value: Level, interval or position, by kind.
        resets: Levels on the wires that the active error handler leaves after an error.
        line: Index of the step among the steps of the program, for messages.
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
    """A fault, and events that lead to it.

    Attributes:
        kind: Kind of fault.
        positions: Positions of both programs.
        program: Program whose action is at fault; 0 if it is the fault of both, as in a deadlock.
        driven: Levels of the wires at their driving ends.
        read: Levels of the wires at their reading ends.
        trace: The last events before the fault, in order.
        steps: Number of events from the start to the fault.
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
        states: Number of explored states; equal ones at different positions count each time.
        kinds: Number of states in the distinct sets of states, one for each sum of the positions.
    """

    findings: tuple[HandshakeFault, ...]
    states: int
    kinds: int


class ProgramProduct:
    """Product of two programs, which several checks share.

    It holds the facts that follow from the positions of both programs, by sum and offset of the positions.
    ``table`` has the distinct actions by code; code 0 stands for the end of a program.

    Raises:
        ValueError: There are not two programs.
    """

    def __init__(self, programs: Sequence[Sequence[AutomatonAction]]) -> None:
        if len(programs) != 2:
            raise ValueError(f"{len(programs)} programs; the check takes two")
        self.max_sum = sum(len(program) for program in programs)
        self.table: list[AutomatonAction | None] = [None]
        code_by_action: dict[tuple[object, ...], int] = {}
        code = []
        # actions have one code if they act equally on wires; facts state the intervals and positions in gates
        for program in programs:
            program_codes = []
            for action in program:
                value = action.value if action.kind in ("set", "wait", "look") else 0
                if action.kind == "go":
                    value = min(action.value, 1)  # whether the work is after the first meeting
                key = (action.kind, action.wire, value, action.resets)
                if key not in code_by_action:
                    code_by_action[key] = len(self.table)
                    self.table.append(action)
                program_codes.append(code_by_action[key])
            code.append(np.array([*program_codes, 0]))
        self._code = code
        """Code of the action at each position, by program."""
        self._need = [
            np.array(
                [action.value - 1 if action.kind == "go" else _BEFORE_ALL for action in program]
                + [_BEFORE_ALL]
            )
            for program in programs
        ]
        """Interval whose work the other program must have done, at each position, by program."""
        self._gate = [
            np.array([action.value if action.kind == "gate" else -1 for action in program] + [-1])
            for program in programs
        ]
        """Position that the other program must have reached, at each position, by program."""
        self._finished = [np.array(_finished_intervals(program)) for program in programs]
        """Last interval whose work is done, at each position, by program."""
        self._kinds: dict[int, list[int]] = {}

    def kinds(self, offset: int) -> list[int]:
        """Return for each sum of the positions, at an offset, a number that encodes the facts there.

        The four lowest bits are the four truth values of :data:`_PositionFacts`, in order. The rest are the
        codes c0, c1 of both actions, as c0 n + c1 with n codes in total. Numbers of sums that are impossible
        at this offset have no meaning.
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
        """Return the facts at a sum of the positions and an offset.

        Args:
            total: Sum of the positions.
            offset: Position of the first program less that of the second one.
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

    The faults are:

    - "apart": A program works in an interval before the other one has done its work of the previous one.
    - "lost_edge": A wire changes before the other program has seen its last change, or that is never seen.
    - "unwatched": A program works after the first meeting although a running wire is stuck.
    - "deadlock": No unfinished program can ever continue.

    Args:
        programs: Actions of both programs, or their product.
        wires: Number of wires. Initially each has any level, which is equal at both ends.
        gates: Whether programs wait at gates. False if the operator does not look at the panels; then only
            "apart" and "unwatched" are faults.
        trace: Maximum number of events in the trace of a fault.
        running: State of the running wire that each program's controller drives. None if there are no running
            wires: both programs run from the start, and "look" and "pause" have no effect.
    """
    product = programs if isinstance(programs, ProgramProduct) else ProgramProduct(programs)
    return _HandshakeSearch(product, wires, gates, trace, running).run()


@dataclasses.dataclass(frozen=True)
class _StateSet:
    """A set of states at one sum of the positions, and the offsets that occur in it, in ascending order."""

    states: frozenset[_State]
    offsets: tuple[int, ...]


class _HandshakeSearch:
    """Search over the reachable states of two programs, see :func:`check_handshake` for the parameters.

    A state (:data:`_State`) changes in two ways. A **step** of a program executes its next action and leads
    to the next sum of the positions. A **free change** keeps both positions: the reading end of a wire
    follows its driving end, a program stops or is started again, a running wire changes or is cut. The
    **closure** of a set of states also contains all states to which free changes lead from it. At each sum,
    ``run`` forms the closure of the states there, and applies all steps to it. This gives the states at the
    next sum.

    Attributes:
        product: Actions of both programs, and the facts that follow from their positions.
        table: Distinct actions by code, None at code 0 for the end of a program.
        wires: Number of wires.
        gates: Whether programs wait at gates.
        trace: Maximum number of events in the trace of a fault.
        running: State of each running wire, None without running wires.
        stuck: Whether a running wire is stuck or missing.
        gone_bit: Number of the bit of program 0 for "has stopped for good". Here and below, the next higher
            bit is that of program 1.
        stopped_bit: Number of the bit for "is stopped".
        low_bit: Number of the bit for "the other program reads it as stopped".
        cut_bit: Number of the bit for "its running wire is cut".
    """

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
        """Visit the states sum by sum, and return the verdict.

        The search ends at the first sum with faults, or when both programs have ended. There is one fault for
        each kind that occurs at this sum.
        """
        # Initial states: all levels of the wires, read as driven. With running wires both are stopped.
        initial_bits = 0
        if self.running is not None:
            initial_bits = 3 << self.stopped_bit | sum(
                1 << self.low_bit + i for i in range(2) if self.running[i] != "high"
            )
        start = frozenset(
            (0, initial_bits | sum(level * 3 << 3 * wire for wire, level in enumerate(levels)))
            for levels in itertools.product((0, 1), repeat=self.wires)
        )
        # distinct sets of states, with their indices; the memo holds the result of each expansion
        state_sets = [_state_set(start)]
        index_by_states = {start: 0}
        memo: dict[tuple[int, tuple[int, ...]], tuple[int, int, frozenset[FaultKind]]] = {}
        kinds: list[list[list[int]]] = []
        history: list[int] = []
        findings: list[HandshakeFault] = []
        current, states = 0, 0
        for total in range(self.product.max_sum + 1):
            # the set of states and the facts at this sum determine the set at the next sum
            state_set = state_sets[current]
            if not state_set.states:
                break
            history.append(current)
            while len(kinds) < len(state_sets):
                kinds.append([self.product.kinds(offset) for offset in state_sets[len(kinds)].offsets])
            facts = tuple([kind[total] for kind in kinds[current]])
            expansion = memo.get((current, facts))
            if expansion is None:
                facts_by_offset = {
                    offset: self.product.facts_at(total, offset) for offset in state_set.offsets
                }
                next_states, count, faults = self._expand(state_set, facts_by_offset)
                if next_states not in index_by_states:
                    index_by_states[next_states] = len(state_sets)
                    state_sets.append(_state_set(next_states))
                expansion = memo[current, facts] = (index_by_states[next_states], count, faults)
            current, count, faults = expansion
            states += count
            if faults:
                findings += [self._finding(kind, total, state_sets, history) for kind in sorted(faults)]
                break
        return HandshakeVerdict(
            tuple(findings), states, sum(len(state_set.states) for state_set in state_sets)
        )

    # ---- one sum of the positions ----

    def _expand(
        self, state_set: _StateSet, facts: Mapping[int, _PositionFacts]
    ) -> tuple[frozenset[_State], int, frozenset[FaultKind]]:
        """Return what follows from the states at one sum of the positions.

        Without gates, or after a program has stopped for good, only the unconditional faults count.

        Args:
            state_set: States that steps from the previous sum lead to.
            facts: Facts at this sum, by offset.

        Returns:
            The states at the next sum, after one step of either program; the number of states in the closure
            of ``state_set``; and the kinds of faults that occur in the closure or in these steps.
        """
        faults: set[FaultKind] = set()
        out: set[_State] = set()
        # all states at this sum; each step of a program leads to a state at the next one
        closure = self._closure(state_set.states, facts)
        for offset, bits in closure:
            enabled = self._enabled_steps(bits, facts[offset])
            stopped = bits >> self.gone_bit & 3
            for program, after, fault in enabled:
                if fault and (fault in _UNCONDITIONAL_FAULTS or (self.gates and not stopped)):
                    faults.add(fault)
                out.add((offset + (1 if program == 0 else -1), after))
            if self.gates and self._is_deadlocked(bits, facts[offset], enabled):
                faults.add("deadlock")
            if self.gates and self._has_unread_change(bits, facts[offset]):
                faults.add("lost_edge")
        return frozenset(out), len(closure), frozenset(faults)

    def _closure(self, states: frozenset[_State], facts: Mapping[int, _PositionFacts]) -> set[_State]:
        """Return the closure of states under free changes, which keep the positions of both programs.

        Args:
            states: States at one sum of the positions.
            facts: Facts at this sum, by offset.
        """
        closure = set(states)
        todo = list(states)
        while todo:
            offset, bits = todo.pop()
            # a reading end follows its driving end; bits of a wire: 1 driven, 2 read, 4 change not seen yet
            lagging = [wire for wire in range(self.wires) if (bits >> 3 * wire ^ bits >> 3 * wire + 1) & 1]
            next_bits = [bits ^ 2 << 3 * wire for wire in lagging]
            if self.running is not None:
                next_bits += self._external_successors(bits, facts[offset])
            # a program stops for good, and its outputs stay or change as its error handler does
            for program in range(2):
                stop_bits = 1 << self.gone_bit + program
                action = self.table[facts[offset][program]]
                if bits & stop_bits or action is None or self.stuck:
                    continue
                if self.running is not None:
                    stop_bits |= 1 << self.stopped_bit + program
                next_bits.append(bits | stop_bits)
                bits_after_handler = bits
                for wire, value in action.resets:
                    bits_after_handler = bits_after_handler & ~(1 << 3 * wire) | value << 3 * wire
                next_bits.append(bits_after_handler | stop_bits)
            for new in next_bits:
                state = (offset, new)
                if state not in closure:
                    closure.add(state)
                    todo.append(state)
        return closure

    def _external_successors(self, bits: int, facts: _PositionFacts) -> list[int]:
        """Return the bits after each free change that involves running wires.

        These are each start or stop of a program, and each change or cut of a running wire.
        """
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
            bits_after_cut = bits | 1 << self.cut_bit + program | 1 << self.low_bit + program
            out.append(bits_after_cut if low else bits_after_cut | other)
        return out

    def _wire_works(self, bits: int, program: int) -> bool:
        """Return whether the running wire of a program (0 or 1) is neither missing, stuck nor cut."""
        return (
            self.running is not None
            and self.running[program] == "works"
            and not bits >> self.cut_bit + program & 1
        )

    def _startable(self, bits: int, facts: _PositionFacts) -> list[int]:
        """Return the stopped programs, 0 and 1, that an operator may start now.

        Such a program has not ended, nor stopped for good. The other program reads it as stopped, unless the
        running wire does not work. If gates count, its gate must be open.
        """
        return [
            program
            for program in range(2)
            if bits >> self.stopped_bit + program & 1
            and self.table[facts[program]] is not None
            and not bits >> self.gone_bit + program & 1
            and (bits >> self.low_bit + program & 1 or not self._wire_works(bits, program))
            and (not self.gates or facts[4 + program])
        ]

    def _is_deadlocked(self, bits: int, facts: _PositionFacts, enabled: list[_ProgramStep]) -> bool:
        """Return whether no unfinished program can ever continue.

        This requires that no program can execute a step (``enabled`` is empty) or be started, and that no
        wire can change any more. A state is no deadlock if both programs have ended, if a program has stopped
        for good, or if a running wire is cut or stuck.
        """
        if enabled or bits >> self.gone_bit & 3 or bits >> self.cut_bit or not (facts[0] or facts[1]):
            return False
        if any((bits >> 3 * wire ^ bits >> 3 * wire + 1) & 1 for wire in range(self.wires)):
            return False
        if self.running is None:
            return True
        # a running wire still has to follow its program, or a program that has ended still counts as running
        follows = any((bits >> self.stopped_bit + i ^ bits >> self.low_bit + i) & 1 for i in range(2))
        ends = any(not facts[i] and not bits >> self.stopped_bit + i & 1 for i in range(2))
        return not (self.stuck or follows or ends or self._startable(bits, facts))

    def _has_unread_change(self, bits: int, facts: _PositionFacts) -> bool:
        """Return whether both programs have ended, but the last change of a wire was never seen."""
        unseen = any(bits >> 3 * wire & 4 for wire in range(self.wires))
        return not (facts[0] or facts[1]) and not bits >> self.gone_bit & 3 and unseen

    def _enabled_steps(self, bits: int, facts: _PositionFacts) -> list[_ProgramStep]:
        """Return the steps that the programs can execute in a state, with the faults of these steps.

        A program that has ended, is stopped, or waits in vain has no step.

        Args:
            bits: Bits of the state.
            facts: Facts at its positions.
        """
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
                case "go":  # the other program must have done the work of the previous interval
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
            # if the other program is stopped and its running wire has not fallen yet, it falls during this
            # step and stops this program by its stop input
            wire_falls = bits >> self.stopped_bit + other & ~(bits >> self.low_bit + other) & 1
            if wire_falls and self._wire_works(bits, other):
                after |= 1 << self.low_bit + other | 1 << self.stopped_bit + program
            out.append((program, after, fault))
        return out

    # ---- events that lead to a fault ----

    def _states_with_steps(self, total: int, state_set: _StateSet) -> dict[_State, list[_ProgramStep]]:
        """Return all states at a sum of the positions, each with its enabled steps.

        They are the closure of ``state_set``, the states to which steps from the previous sum lead.
        """
        facts = {offset: self.product.facts_at(total, offset) for offset in state_set.offsets}
        return {
            (offset, bits): self._enabled_steps(bits, facts[offset])
            for offset, bits in sorted(self._closure(state_set.states, facts))
        }

    def _finding(
        self, kind: FaultKind, total: int, state_sets: list[_StateSet], history: list[int]
    ) -> HandshakeFault:
        """Return a fault with its trace: walk back from a faulty state, one sum of positions at a time.

        Args:
            kind: Kind of the fault.
            total: Sum of the positions at which it occurs.
            state_sets: Distinct sets of states.
            history: Index of the set of states at each sum of the positions up to ``total``.
        """
        faulty_state, program = next(self._faulty_states(kind, total, state_sets[history[total]]))
        events: list[AutomatonEvent] = []
        state, state_total = faulty_state, total
        while state_total > 0 and len(events) < self.trace:
            state, event = self._predecessor(state, state_total, state_sets[history[state_total - 1]])
            events.append(event)
            state_total -= 1
        offset, bits = faulty_state
        return HandshakeFault(
            kind,
            ((total + offset) >> 1, (total - offset) >> 1),
            program,
            tuple(bits >> 3 * wire & 1 for wire in range(self.wires)),
            tuple(bits >> 3 * wire + 1 & 1 for wire in range(self.wires)),
            tuple(reversed(events)),
            total,
        )

    def _faulty_states(
        self, kind: FaultKind, total: int, state_set: _StateSet
    ) -> Iterator[tuple[_State, int]]:
        """Yield each state at a sum of the positions that has the fault, with the program at fault.

        States in which no program has stopped for good come first.
        """
        enabled_by_state = self._states_with_steps(total, state_set)
        for (offset, bits), enabled in sorted(
            enabled_by_state.items(), key=lambda item: item[0][1] >> self.gone_bit & 3
        ):
            stopped = bits >> self.gone_bit & 3
            for program, _, fault in enabled:
                if fault == kind and (kind in _UNCONDITIONAL_FAULTS or not stopped):
                    yield (offset, bits), program
            if kind == "deadlock" and self._is_deadlocked(
                bits, self.product.facts_at(total, offset), enabled
            ):
                yield (offset, bits), 0
            if kind == "lost_edge" and self._has_unread_change(bits, self.product.facts_at(total, offset)):
                yield (offset, bits), 0

    def _predecessor(
        self, state: _State, total: int, previous_set: _StateSet
    ) -> tuple[_State, AutomatonEvent]:
        """Return one state from which a step of a program, and then free changes, lead to ``state``.

        Args:
            state: A reached state.
            total: Sum of the positions of both programs in ``state``.
            previous_set: States at the previous sum.

        Returns:
            The previous state, the first one in ascending order if there are several, and the step as an
            event.
        """
        previous_total = total - 1
        target_offset = state[0]
        facts = {target_offset: self.product.facts_at(total, target_offset)}
        for (offset, bits), enabled in self._states_with_steps(previous_total, previous_set).items():
            for program, bits_after_step, _ in enabled:
                offset_after_step = offset + (1 if program == 0 else -1)
                if offset_after_step != target_offset:
                    continue
                if state in self._closure(frozenset({(offset_after_step, bits_after_step)}), facts):
                    # sum s and offset d of the positions p0, p1: p0 = (s + d) / 2, p1 = (s - d) / 2
                    doubled_position = previous_total + offset if program == 0 else previous_total - offset
                    return (offset, bits), AutomatonEvent(program, doubled_position >> 1)
        raise RuntimeError("a reached state has no predecessor")


def _state_set(states: frozenset[_State]) -> _StateSet:
    """Return states together with their offsets."""
    return _StateSet(states, tuple(sorted({offset for offset, _ in states})))


def _finished_intervals(program: Sequence[AutomatonAction]) -> list[int]:
    """Return for each position of a program the last interval whose work is done there.

    It is the interval before that of the program's next work. At a position between "go" and "done" the work
    of this interval is not done yet. After the last work all intervals are done.
    """
    out = [_AFTER_ALL] * (len(program) + 1)
    for position in range(len(program) - 1, -1, -1):
        action = program[position]
        out[position] = action.value - 1 if action.kind in ("go", "done") else out[position + 1]
    return out
