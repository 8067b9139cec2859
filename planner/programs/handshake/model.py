"""Two programs that meet by signals, as automata, and the check of all that they can do together.

Each program is a row of actions. A wire carries one program's output to the other one's input with any delay:
its reading end follows its driving end at any later instant, so that a pulse may pass unseen. Any program may
stop at any instant for good, as its error handler leaves the outputs. All interleavings are looked at.

With ``running`` each controller drives a wire that is 1 while its program runs. Both programs stand at first;
any of them may be stopped at any instant and started again later, both or one, in either order. The fall of
the wire stops the other program, which does one more step at most: wire and stop input are faster than two
steps. A program that has come to its end runs no longer. One of the wires may be cut at any instant.
So behind a stop the other side stands too, or reads 0 until somebody starts it again: no power is on. What
the wire cannot find by itself is that it is stuck; then no program may begin to work (``unwatched``).

Every step of a program adds one to the sum of both places, so the reachable states are visited sum by sum;
what depends on places alone is put in relative form, and equal rows of states before equal actions are
expanded once. This is exact, and takes time in proportion to the programs' length.
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
"""A running wire that works, or is stuck at a level for ever (one that is not there is stuck, too)."""
Levels = tuple[tuple[int, int], ...]
_State = tuple[int, int]
"""Offset between the places of both programs, and bits: three for each wire (driven level, level as read, a
change that the reader has not seen yet), then four for each program, those of one kind in a row: whether it
has stopped for good, stands, is read as standing by the other one, and whether its running wire is cut."""
_Here = tuple[int, int, bool, bool, bool, bool]
"""What the places decide: codes of both actions, whether the other one has done the work before, whether
gates are open."""
_Step = tuple[int, int, FaultKind | None]
"""A step of a program: which one, the bits behind it, the fault that it is."""
_EVER, _NEVER = 2**60, -(2**60)
_ALWAYS: Final = ("apart", "unwatched")
"""Faults whatever the operator does."""


@dataclasses.dataclass(frozen=True, slots=True)
class Action:
    """One action. "set" puts ``wire`` to ``value``, "wait" waits until it reads so. "go" and "done" enclose
    the work of the interval ``value`` between two meetings. "gate" is passed once the other program has
    reached its place ``value``; a program that stands before it is not started earlier either. "look" waits
    until the other program is read as running (``value`` 1) or standing (0). "pause": the program stops by
    itself until it is started again.

    ``resets``: levels of wires that the error handler in force here leaves, as (wire, value). ``line`` is
    its step in the program text, for messages.
    """

    kind: ActionKind
    wire: int = 0
    value: int = 0
    resets: Levels = ()
    line: int = 0


@dataclasses.dataclass(frozen=True)
class Event:
    """What one of the programs (0 or 1) did: the action at ``place``."""

    program: int
    place: int


@dataclasses.dataclass(frozen=True)
class Finding:
    """A fault and how it comes about.

    ``places``: where both programs are; ``program``: whose action is at fault (0 in a deadlock); ``driven``
    and ``read``: levels of the wires at their ends; ``trace``: the last events before, in order; ``steps``:
    how many events lead there from the start.
    """

    kind: FaultKind
    places: tuple[int, int]
    program: int
    driven: tuple[int, ...]
    read: tuple[int, ...]
    trace: tuple[Event, ...]
    steps: int


@dataclasses.dataclass(frozen=True)
class Verdict:
    """``findings``: the faults that the fewest events lead to, none for programs that hold. ``states`` that
    were looked at, counted with their places, and ``kinds`` of them that differ otherwise."""

    findings: tuple[Finding, ...]
    states: int
    kinds: int


class Product:
    """Two programs as several checks look at them: what their places decide, by the sum of both places and
    the offset between them. Raises ``ValueError`` where there are not two of them."""

    def __init__(self, programs: Sequence[Sequence[Action]]) -> None:
        if len(programs) != 2:
            raise ValueError(f"{len(programs)} programs; the check takes two")
        self.last = sum(len(program) for program in programs)
        self.table: list[Action | None] = [None]
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
            np.array([a.value - 1 if a.kind == "go" else _NEVER for a in program] + [_NEVER])
            for program in programs
        ]
        self._gate = [
            np.array([a.value if a.kind == "gate" else -1 for a in program] + [-1]) for program in programs
        ]
        self._finished = [np.array(_finished(program)) for program in programs]
        self._kinds: dict[int, list[int]] = {}

    def kinds(self, offset: int) -> list[int]:
        """For each sum of places the number of what they decide, at an offset; without meaning where there
        are no such places."""
        if offset not in self._kinds:
            total: IntArray = np.arange(self.last + 1)
            first, second = (
                np.clip(place >> 1, 0, len(code) - 1)
                for place, code in zip((total + offset, total - offset), self._code, strict=True)
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

    def here(self, total: int, offset: int) -> _Here:
        """What a sum of places decides at an offset."""
        kind = self.kinds(offset)[total]
        first, second = divmod(kind >> 4, len(self.table))
        return first, second, bool(kind & 8), bool(kind & 4), bool(kind & 2), bool(kind & 1)


def check(
    programs: Sequence[Sequence[Action]] | Product,
    wires: int,
    gates: bool = True,
    trace: int = 12,
    running: tuple[RunningWire, RunningWire] | None = None,
) -> Verdict:
    """Look at all that two programs can do together.

    ``wires``: how many there are; at first each one has any level, at both ends. ``gates`` False: gates are
    passed at any time (the operator does not look), and only "apart" and "unwatched" are faults.
    ``running``: the wire that each program's controller drives; None: both programs run from the first on,
    nothing but their end stops them, and "look" and "pause" are passed.

    "apart": a program works in an interval before the other one has done its work of the interval before.
    "lost_edge": a wire changes before the other program has seen its last change, or that is never seen.
    "unwatched": a program works behind the first meeting though a running wire is stuck.
    """
    product = programs if isinstance(programs, Product) else Product(programs)
    return _Search(product, wires, gates, trace, running).run()


@dataclasses.dataclass(frozen=True)
class _Row:
    """States (offset between the places, bits) and the offsets in them."""

    states: frozenset[_State]
    offsets: tuple[int, ...]


class _Search:
    def __init__(
        self,
        product: Product,
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
        self.gone, self.stands, self.low, self.cut = (3 * wires + 2 * i for i in range(4))

    def run(self) -> Verdict:
        first = 0
        if self.running is not None:
            first = 3 << self.stands | sum(1 << self.low + i for i in range(2) if self.running[i] != "high")
        start = frozenset(
            (0, first | sum(level * 3 << 3 * wire for wire, level in enumerate(levels)))
            for levels in itertools.product((0, 1), repeat=self.wires)
        )
        rows = [_row(start)]
        known = {start: 0}
        memo: dict[tuple[int, tuple[int, ...]], tuple[int, int, frozenset[FaultKind]]] = {}
        kinds: list[list[list[int]]] = []
        history: list[int] = []
        findings: list[Finding] = []
        here, states = 0, 0
        for total in range(self.product.last + 1):
            row = rows[here]
            if not row.states:
                break
            history.append(here)
            while len(kinds) < len(rows):
                kinds.append([self.product.kinds(offset) for offset in rows[len(kinds)].offsets])
            place = tuple([kind[total] for kind in kinds[here]])
            answer = memo.get((here, place))
            if answer is None:
                decided = {offset: self.product.here(total, offset) for offset in row.offsets}
                following, count, faults = self._expand(row, decided)
                if following not in known:
                    known[following] = len(rows)
                    rows.append(_row(following))
                answer = memo[here, place] = (known[following], count, faults)
            here, count, faults = answer
            states += count
            if faults:
                findings += [self._finding(kind, total, rows, history) for kind in sorted(faults)]
                break
        return Verdict(tuple(findings), states, sum(len(row.states) for row in rows))

    # ---- one sum of places ----

    def _expand(
        self, row: _Row, here: Mapping[int, _Here]
    ) -> tuple[frozenset[_State], int, frozenset[FaultKind]]:
        """States behind one event, how many states there are before it, and what faults show."""
        faults: set[FaultKind] = set()
        out: set[_State] = set()
        whole = self._closed(row.states, here)
        for offset, bits in whole:
            moved = self._events(bits, here[offset])
            stopped = bits >> self.gone & 3
            for program, after, fault in moved:
                if fault and (fault in _ALWAYS or (self.gates and not stopped)):
                    faults.add(fault)
                out.add((offset + (1 if program == 0 else -1), after))
            if self.gates and self._stuck(bits, here[offset], moved):
                faults.add("deadlock")
            if self.gates and self._unread(bits, here[offset]):
                faults.add("lost_edge")
        return frozenset(out), len(whole), frozenset(faults)

    def _closed(self, states: frozenset[_State], here: Mapping[int, _Here]) -> set[_State]:
        """The states with all that happens without a step of a program: wires that follow, programs that
        stop."""
        whole = set(states)
        todo = list(states)
        while todo:
            offset, bits = todo.pop()
            behind = [wire for wire in range(self.wires) if (bits >> 3 * wire ^ bits >> 3 * wire + 1) & 1]
            after = [bits ^ 2 << 3 * wire for wire in behind]
            if self.running is not None:
                after += self._by_hand(bits, here[offset])
            for program in range(2):
                mark = 1 << self.gone + program
                action = self.table[here[offset][program]]
                if bits & mark or action is None or self.stuck:
                    continue
                if self.running is not None:
                    mark |= 1 << self.stands + program
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

    def _by_hand(self, bits: int, here: _Here) -> list[int]:
        """What follows when a program is started or stopped by hand or a running wire is cut, and as running
        wires follow."""
        out = [bits & ~(1 << self.stands + program) for program in self._startable(bits, here)]
        for program in range(2):
            stands, low = bits >> self.stands + program & 1, bits >> self.low + program & 1
            other = 1 << self.stands + 1 - program
            if not stands:
                out.append(bits | 1 << self.stands + program)
            if not self._works(bits, program):
                continue
            if stands and not low:
                out.append(bits | 1 << self.low + program | other)
            if not stands and low:
                out.append(bits & ~(1 << self.low + program))
            if self.gates or self.stuck or bits >> self.cut:  # one fault of the cell at a time
                continue
            cut = bits | 1 << self.cut + program | 1 << self.low + program
            out.append(cut if low else cut | other)
        return out

    def _works(self, bits: int, program: int) -> bool:
        """Whether the running wire of a program follows."""
        return (
            self.running is not None
            and self.running[program] == "works"
            and not bits >> self.cut + program & 1
        )

    def _startable(self, bits: int, here: _Here) -> list[int]:
        """Programs that stand and may be started again: their stop has been seen, and gates are open."""
        return [
            program
            for program in range(2)
            if bits >> self.stands + program & 1
            and self.table[here[program]] is not None
            and not bits >> self.gone + program & 1
            and (bits >> self.low + program & 1 or not self._works(bits, program))
            and (not self.gates or here[4 + program])
        ]

    def _stuck(self, bits: int, here: _Here, moved: list[_Step]) -> bool:
        """Whether no program that has not come to its end can ever go on, though none has stopped for good
        and no running wire is cut."""
        if moved or bits >> self.gone & 3 or bits >> self.cut or not (here[0] or here[1]):
            return False
        if any((bits >> 3 * wire ^ bits >> 3 * wire + 1) & 1 for wire in range(self.wires)):
            return False
        if self.running is None:
            return True
        follows = any((bits >> self.stands + i ^ bits >> self.low + i) & 1 for i in range(2))
        ends = any(not here[i] and not bits >> self.stands + i & 1 for i in range(2))
        return not (self.stuck or follows or ends or self._startable(bits, here))

    def _unread(self, bits: int, here: _Here) -> bool:
        """Whether both programs are at their ends, and the last change of a wire was never seen."""
        unseen = any(bits >> 3 * wire & 4 for wire in range(self.wires))
        return not (here[0] or here[1]) and not bits >> self.gone & 3 and unseen

    def _events(self, bits: int, here: _Here) -> list[_Step]:
        """Steps that the programs can do."""
        out: list[_Step] = []
        for program in range(2):
            action = self.table[here[program]]
            if action is None or (bits >> self.gone | bits >> self.stands) >> program & 1:
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
                        after = bits & ~(4 << shift)  # the reader has seen the last change
                case "go":
                    fault = None if here[2 + program] else "apart"
                    if self.stuck and action.value:
                        fault = "unwatched"
                case "gate":
                    if self.gates and not here[4 + program]:
                        continue
                case "look" if self.running is not None:
                    if (bits >> self.low + other & 1) == action.value:
                        continue
                case "pause" if self.running is not None:
                    after |= 1 << self.stands + program
            fallen = bits >> self.stands + other & ~(bits >> self.low + other) & 1
            if fallen and self._works(bits, other):
                after |= 1 << self.low + other | 1 << self.stands + program  # its stop input has stopped it
            out.append((program, after, fault))
        return out

    # ---- how it comes about ----

    def _whole(self, total: int, row: _Row) -> dict[_State, list[_Step]]:
        """States at a sum of places, with the steps that they can do."""
        here = {offset: self.product.here(total, offset) for offset in row.offsets}
        return {
            (offset, bits): self._events(bits, here[offset])
            for offset, bits in sorted(self._closed(row.states, here))
        }

    def _finding(self, kind: FaultKind, total: int, rows: list[_Row], history: list[int]) -> Finding:
        at, program = next(self._at_fault(kind, total, rows[history[total]]))
        events: list[Event] = []
        state, level = at, total
        while level > 0 and len(events) < self.trace:
            state, event = self._before(state, level, rows[history[level - 1]])
            events.append(event)
            level -= 1
        offset, bits = at
        return Finding(
            kind,
            ((total + offset) >> 1, (total - offset) >> 1),
            program,
            tuple(bits >> 3 * wire & 1 for wire in range(self.wires)),
            tuple(bits >> 3 * wire + 1 & 1 for wire in range(self.wires)),
            tuple(reversed(events)),
            total,
        )

    def _at_fault(self, kind: FaultKind, total: int, row: _Row) -> Iterator[tuple[_State, int]]:
        """States at which the fault shows, with the program that does it; unstopped ones come first."""
        whole = self._whole(total, row)
        for (offset, bits), moved in sorted(whole.items(), key=lambda item: item[0][1] >> self.gone & 3):
            stopped = bits >> self.gone & 3
            for program, _, fault in moved:
                if fault == kind and (kind in _ALWAYS or not stopped):
                    yield (offset, bits), program
            if kind == "deadlock" and self._stuck(bits, self.product.here(total, offset), moved):
                yield (offset, bits), 0
            if kind == "lost_edge" and self._unread(bits, self.product.here(total, offset)):
                yield (offset, bits), 0

    def _before(self, state: _State, level: int, row: _Row) -> tuple[_State, Event]:
        """A state one event earlier than ``state`` at the sum ``level``, and that event."""
        for (offset, bits), moved in self._whole(level - 1, row).items():
            for program, after, _ in moved:
                there = offset + (1 if program == 0 else -1)
                if there != state[0]:
                    continue
                if state in self._closed(
                    frozenset({(there, after)}), {there: self.product.here(level, there)}
                ):
                    place = (level - 1 + offset) >> 1 if program == 0 else (level - 1 - offset) >> 1
                    return (offset, bits), Event(program, place)
        raise RuntimeError("a state that was reached has no state before it")


def _row(states: frozenset[_State]) -> _Row:
    return _Row(states, tuple(sorted({offset for offset, _ in states})))


def _finished(program: Sequence[Action]) -> list[int]:
    """For each place, the last interval whose work is done there: the one before that of the work ahead."""
    out = [_EVER] * (len(program) + 1)
    for place in range(len(program) - 1, -1, -1):
        action = program[place]
        out[place] = action.value - 1 if action.kind in ("go", "done") else out[place + 1]
    return out
