"""What two programs do with the wires between their controllers, as automata, from the steps of their texts.

Meetings are counted by what a program says, not by what the cell calls a meeting: its own output rises
(four-phase) or changes (toggle). What stands between two meetings is an interval. If a text counts otherwise
than its partner, or does something with a wire that has no part in the automata, that is a fault.
"""

import dataclasses
from collections.abc import Iterable, Mapping, Sequence

from planner.claims.handshake import HandshakeKind, SignalWire
from planner.programs.handshake.model import Action, Levels
from planner.programs.handshake.moves import SLOW
from planner.programs.steps import (
    CarryStep,
    CheckStep,
    ChoiceStep,
    LoadStep,
    MessageStep,
    MoveStep,
    RunningStep,
    SettingStep,
    SignalStep,
    Step,
    SyncStep,
    WaitStep,
    WatchStep,
    letters,
)

Sections = Mapping[tuple[str, str], tuple[Step, ...]]
_READY_TEXT = "readytomeetarm"
"""Letters of the message that a program which follows shows before the two meet."""
_START_TEXT = "starttheprogramofarm"
"""Letters of the message that asks to start it."""


@dataclasses.dataclass(frozen=True)
class Wiring:
    """Wires by number: those that an arm's outputs drive and those that its inputs read, by lower-case name;
    a name that has several wires is in ``doubled``. ``running``: wires that say that a controller runs, with
    the outputs that ``tells`` and the inputs that ``watches`` name, by arm, in lower case."""

    wires: tuple[SignalWire, ...]
    drives: Mapping[str, Mapping[str, int]]
    reads: Mapping[str, Mapping[str, int]]
    doubled: tuple[str, ...]
    running: tuple[SignalWire, ...] = ()
    tells: Mapping[str, frozenset[str]] = dataclasses.field(default_factory=dict)
    watches: Mapping[str, frozenset[str]] = dataclasses.field(default_factory=dict)

    @staticmethod
    def of(wires: Sequence[SignalWire], arms: Sequence[str], running: Sequence[SignalWire] = ()) -> "Wiring":
        """The wiring of the controllers of ``arms``."""
        drives: dict[str, dict[str, int]] = {arm: {} for arm in arms}
        reads: dict[str, dict[str, int]] = {arm: {} for arm in arms}
        doubled, used = [], set()
        for number, wire in enumerate((*wires, *running)):
            for arm, name in ((wire.source, wire.output), (wire.sink, wire.input)):
                if (arm, name.lower()) in used:
                    doubled.append(f"{name} of arm {arm}")
                used.add((arm, name.lower()))
            if number < len(wires):
                drives.setdefault(wire.source, {})[wire.output.lower()] = number
                reads.setdefault(wire.sink, {})[wire.input.lower()] = number
        tells = {arm: frozenset(w.output.lower() for w in running if w.source == arm) for arm in arms}
        watches = {arm: frozenset(w.input.lower() for w in running if w.sink == arm) for arm in arms}
        return Wiring(tuple(wires), drives, reads, tuple(doubled), tuple(running), tells, watches)


@dataclasses.dataclass(frozen=True)
class Reading:
    """One program: its ``actions`` (their ``line`` is an index into its steps), the ``interval`` that each
    step belongs to, whether a step is part of the ``protocol``, and faults as (message, step)."""

    actions: tuple[Action, ...]
    interval: tuple[int, ...]
    protocol: tuple[bool, ...]
    faults: tuple[tuple[str, Step], ...]


def read(
    arms: Sequence[str],
    steps: Mapping[str, Sequence[Step]],
    sections: Mapping[str, Sequence[Sections]],
    wiring: Wiring,
    kind: HandshakeKind,
    longest: float,
) -> dict[str, Reading]:
    """The programs of ``arms``. ``sections``: for each arm the ERROR and the UNDO sections by (module,
    procedure). ``longest`` [s]: how long a program may wait until it sees the other one stand.

    A program that is started because the other one's panel says so begins with a gate.
    """
    readers = {
        arm: _Reader(arm, steps[arm], sections[arm], wiring, kind, _asked(arm, steps, arms), longest)
        for arm in arms
    }
    for reader in readers.values():
        reader.run()
    calls = {arm: _of(arm, arms, {name: readers[name].starts for name in arms}) for arm in arms}
    out = {}
    for arm, reader in readers.items():
        ahead = sum(call is not None for name, call in calls.items() if name != arm)
        ready = _of(arm, arms, {name: readers[name].ready for name in arms})
        place = 0 if ready is None else ready + ahead
        actions = [
            dataclasses.replace(action, value=place) if action.kind == "gate" else action
            for action in reader.actions
        ]
        call = calls[arm]
        if call is not None:
            actions.insert(0, Action("gate", 0, call + ahead))
        out[arm] = Reading(
            tuple(actions), tuple(reader.interval), tuple(reader.protocol), tuple(reader.faults)
        )
    return out


def touches(arm: str, steps: Iterable[Step], sections: Sequence[Sections], wiring: Wiring) -> bool:
    """Whether a program has to do with the wires between two controllers, or with the start of the other
    one."""
    seen = wiring.tells.get(arm, frozenset()) | wiring.watches.get(arm, frozenset())
    names = {*wiring.drives[arm], *wiring.reads[arm], *seen}
    handlers = (step for table in sections for part in table.values() for step in part)
    for step in _all((*steps, *handlers)):
        match step:
            case RunningStep() | WatchStep() | CheckStep():
                return True
            case SignalStep() | WaitStep() if step.signal.lower() in names:
                return True
            case MessageStep() if _READY_TEXT in letters(step.text) or _START_TEXT in letters(step.text):
                return True
    return False


def lets_fall(step: MessageStep) -> bool:
    """Whether a program counts as standing while it shows something."""
    return step.kind == "HALT" or step.stands


def _of(arm: str, arms: Sequence[str], places: Mapping[str, Mapping[str, int]]) -> int | None:
    """The place at which another program's panel speaks of an arm, None where none does."""
    found = [places[name][letters(arm)] for name in arms if name != arm and letters(arm) in places[name]]
    return found[0] if found else None


def _asked(arm: str, steps: Mapping[str, Sequence[Step]], arms: Sequence[str]) -> int | None:
    """The step at which a program asks whether the other one's panel says that it is ready to meet this arm,
    None where it does not, or where the other one's panel never says so."""
    sentence = _READY_TEXT + letters(arm)
    told = any(
        sentence in _told(steps[other], i) for other in arms if other != arm for i in _first(steps[other])
    )
    for i, step in enumerate(steps[arm]):
        if isinstance(step, MoveStep):
            break
        if isinstance(step, MessageStep) and step.certain and sentence in letters(step.text) and told:
            return i
    return None


def _first(steps: Sequence[Step]) -> Iterable[int]:
    """Indices of the messages before the first move."""
    for i, step in enumerate(steps):
        if isinstance(step, MoveStep):
            return
        if isinstance(step, MessageStep):
            yield i


def _told(steps: Sequence[Step], at: int) -> str:
    """What the panel's lines that end with the message ``at`` say in a row."""
    text = ""
    while at >= 0:
        step = steps[at]
        if not isinstance(step, MessageStep) or step.panel != "line":
            break
        text, at = letters(step.text) + text, at - 1
    return text


class _Reader:
    def __init__(
        self,
        arm: str,
        steps: Sequence[Step],
        sections: Sequence[Sections],
        wiring: Wiring,
        kind: HandshakeKind,
        gate: int | None,
        longest: float,
    ) -> None:
        self.steps = steps
        self.drives, self.reads = wiring.drives[arm], wiring.reads[arm]
        self.tells, self.watches = wiring.tells.get(arm, ()), wiring.watches.get(arm, ())
        self.longest = longest
        self.kind = kind
        self.gate = gate
        self.actions: list[Action] = []
        self.interval: list[int] = []
        self.protocol: list[bool] = []
        self.faults: list[tuple[str, Step]] = []
        self.ready: dict[str, int] = {}
        """Places at which the panel says so, by the letters of the arm that is to be met."""
        self.starts: dict[str, int] = {}
        """Places at which the panel says that another program is to be started, by the letters of its arm."""
        self.left = 0
        """Sets and waits of a meeting that the last look at the other one's running wire still stands for."""
        self.limit: float | None = None
        """Time limit of that look [s]."""
        self.sections = sections
        self.resets: dict[tuple[str, str], Levels] = {}
        self.levels: dict[int, int] = {}
        self.count = 0
        self.last: MoveStep | None = None
        self.working: int | None = None
        self.low = False
        """Whether the program holds its own running wire at 0."""
        self.uncleared = False
        """Whether the running wire rose at the start and no wait has seen the other one's line at 0 since."""
        self.asked = False
        """Whether the operator was asked anything: that no earlier run goes on."""

    def run(self) -> None:
        for i, step in enumerate(self.steps):
            self.protocol.append(self._step(i, step))
            self.interval.append(self.count)
        if self.count and self.last is not None:
            what = "the arm is still at work when the other program may have come to its end, which stops it"
            self._fault(f"{what}; let both meet once more behind it", self.last)
        self._rest()

    # ---- steps ----

    def _step(self, i: int, step: Step) -> bool:
        """Take one step; whether it is part of the protocol."""
        match step:
            case SignalStep() if step.signal.lower() in self.drives:
                self._set(i, step)
                return True
            case WaitStep() if step.signal and step.signal.lower() in self.watches:
                self._look(i, step)
                return True
            case WaitStep() if step.signal:
                self._wait(i, step)
                return True
            case MessageStep() if i == self.gate:
                self._rest()
                if lets_fall(step):
                    self._add("pause", 0, 0, i)
                self._add("gate", 0, 0, i)
                return True
            case SettingStep() if step.stops:
                self._rest()
                self._add("pause", 0, 0, i)
                return True
            case MessageStep() if not step.confirm:
                said = _told(self.steps, i)
                if _READY_TEXT in said:
                    self._rest()
                    self.ready.setdefault(said.split(_READY_TEXT, 1)[1], len(self.actions))
                if _START_TEXT in said:
                    self.starts.setdefault(
                        said.split(_START_TEXT, 1)[1].split("now", 1)[0], len(self.actions)
                    )
            case SyncStep():
                self._fault(f"{step.kind}: the tasks of two controllers cannot synchronise so", step)
            case MoveStep():
                self._unmet(step, "the arm moves")
                self._work(i)
                self.last = step
            case SignalStep():
                if step.signal.lower() in (*self.reads, *self.watches):
                    self._fault(f"{step.signal} is an input of this controller; it cannot be switched", step)
                elif step.signal.lower() in self.tells:
                    self._fault(f"{step.signal} says that the program runs; no program switches it", step)
                elif step.value:
                    self._unmet(step, f"{step.signal} is switched on")
                self._work(i)
            case ChoiceStep():
                self._aside(step)
                self._work(i)
            case WaitStep() | MessageStep() | CarryStep() | LoadStep():
                self.asked |= isinstance(step, MessageStep) and step.certain
                self._work(i)
                if isinstance(step, MessageStep) and lets_fall(step):
                    self._add("pause", 0, 0, i)
            case CheckStep():
                self._check(i, step)
                return True
            case RunningStep():
                self._dwelt(step)
                self.uncleared = step.on and not self.count
                self.low = not step.on
                return True
            case WatchStep():
                return True
            case _:
                pass
        return False

    def _set(self, i: int, step: SignalStep) -> None:
        wire = self.drives[step.signal.lower()]
        if step.value not in (0.0, 1.0):
            self._fault(f"{step.signal} is set to {step.value:g}, neither 0 nor 1", step)
        if step.delay:
            self._fault(f"{step.signal} is set {step.delay:g} s later, when the arm may move again", step)
        value = int(step.value == 1.0)
        if value and self.uncleared:
            self._fault("no wait sees the other one's line at 0 behind the rise of the running wire", step)
        self._rest()
        known = self.levels.get(wire)
        if known == value:
            self._fault(f"{step.signal} is {value} already; the other program can see no change", step)
        if value != known and (value == 1 or (self.kind == "toggle" and known is not None)):
            self.count += 1
        self.levels[wire] = value
        self._looked(step, value)
        self._add("set", wire, value, i)

    def _wait(self, i: int, step: WaitStep) -> None:
        if step.signal.lower() not in self.reads:
            known = ", ".join(sorted(self.reads)) or "none"
            self._fault(f"no wire leads to {step.signal}, which it waits for; wired: {known}", step)
            self._work(i)
            return
        if step.value not in (0.0, 1.0):
            self._fault(f"it waits for {step.signal} to be neither 0 nor 1", step)
        if step.flag and not self._stops(i, step):
            what = f"when its time is over it goes on with {step.flag} set; it must stop and end the program"
            self._fault(what, step)
        self.uncleared = self.uncleared and step.value != 0.0
        self._rest()
        limit = self.limit
        self._looked(step, int(step.value == 1.0))
        if limit is not None and step.seconds is not None and limit > step.seconds:
            what = f"{limit:g} s for the other program to run, {step.seconds:g} s for the meeting itself"
            self._fault(f"{what}; the look at the running wire may take no longer", step)
        self._add("wait", self.reads[step.signal.lower()], int(step.value == 1.0), i)

    def _look(self, i: int, step: WaitStep) -> None:
        if step.value not in (0.0, 1.0):
            self._fault(f"it waits for {step.signal} to be neither 0 nor 1", step)
        if step.flag and not self._stops(i, step):
            what = f"when its time is over it goes on with {step.flag} set; it must stop and end the program"
            self._fault(what, step)
        if step.seconds is None:
            self._fault(f"the wait for {step.signal} has no end; give it a time limit", step)
        elif step.value == 0.0 and step.seconds > self.longest + 1e-6:
            what = f"{step.seconds:g} s for the other program to stand; allowed: {self.longest:g} s"
            self._fault(what, step)
        if step.value == 0.0 and self.count:
            self._fault(f"behind the first meeting it waits for {step.signal} to be 0", step)
        self._rest()
        running = step.value == 1.0
        self.left = (4 if self.kind == "four_phase" else 2) if running else 0
        self.limit = step.seconds if running else None
        self._add("look", 0, int(running), i)

    def _check(self, i: int, step: CheckStep) -> None:
        """A look at both the other one's line and its running wire, which ends the program or goes on."""
        line, runs = step.signal.lower(), step.runs.lower()
        if line not in self.reads or runs not in self.watches:
            self._fault(
                f"it looks at {step.signal} and {step.runs}, which are not the other one's wires", step
            )
            return
        self._rest()
        self.left, self.limit = (4 if step.own else 0), None
        self._add("look", 0, 1, i)
        self._add("wait", self.reads[line], step.value, i)

    def _looked(self, step: Step, value: int) -> None:
        """Every meeting begins with a look at the other one's running wire."""
        if self.left:
            self.left -= 1
        elif self.count or value:
            self._fault("nothing looks before this meeting whether the other program runs", step)
        if not self.left:
            self.limit = None

    def _unmet(self, step: Step, what: str) -> None:
        """Nothing happens before the first meeting, before which the running wires are checked."""
        if not self.count:
            self._fault(f"{what} before the first meeting, before which the running wires are checked", step)

    def _dwelt(self, step: RunningStep) -> None:
        """A program that begins stands before each rise of its running wire: the other one has seen by then
        that it was low."""
        if step.on and not self.count and step.waited < SLOW:
            what = f"{step.waited:g} s before the running wire rises at the start; at least: {SLOW:g} s"
            self._fault(f"the program stands {what}, so that the other one sees it low", step)

    def _stops(self, i: int, step: WaitStep) -> bool:
        """Whether what follows a wait ends the program where its time was over, and does nothing before."""
        after = self.steps[i + 1] if i + 1 < len(self.steps) else None
        if not isinstance(after, ChoiceStep):
            return False
        condition = letters(after.condition)
        if condition not in (letters(step.flag), letters(step.flag) + "true"):
            return False
        last = after.steps[-1]
        quiet = all(isinstance(s, MessageStep | SettingStep | SignalStep) for s in after.steps)
        return quiet and isinstance(last, SettingStep) and last.kind == "EXIT"

    def _aside(self, step: ChoiceStep) -> None:
        """Nothing that hangs on what is known at run time only may touch the wires or wait for them."""
        for inside in step.steps:
            if isinstance(inside, ChoiceStep):
                self._aside(inside)
            elif isinstance(inside, SignalStep) and inside.signal.lower() in self.drives:
                self._fault(f"whether {inside.signal} is set is known at run time only", inside)
            elif isinstance(inside, SignalStep) and inside.signal.lower() in self.tells:
                self._fault(f"{inside.signal} says that the program runs; no program switches it", inside)
            elif isinstance(inside, WaitStep) and inside.signal:
                self._fault(f"whether it waits for {inside.signal} is known at run time only", inside)

    # ---- actions ----

    def _work(self, i: int) -> None:
        self.left, self.limit = 0, None  # a look before the work says nothing of the meeting behind it
        if self.working is None:
            self.working = self.count
            self._add("go", 0, self.count, i)

    def _rest(self) -> None:
        """The work before a meeting ends, with the arm at rest."""
        if self.working is None:
            return
        if self.last is not None and not self.last.zone.fine:
            what = (
                f"{self.last.zone_name} stands before a handshake, which it may run before the arm is there"
            )
            self._fault(what, self.last)
        self._add("done", 0, self.working, self.actions[-1].line)
        self.working, self.last = None, None

    def _add(self, kind: str, wire: int, value: int, i: int) -> None:
        step = self.steps[i]
        if kind in ("set", "wait", "look") and not (self.asked or self.low):
            what = (
                "nobody is asked before whether a program of an earlier run goes on at the other controller"
            )
            self._fault(what, step)
            self.asked = True
        self.actions.append(Action(kind, wire, value, self._left(step), i))  # type: ignore[arg-type]

    def _left(self, step: Step) -> Levels:
        """Levels that error handlers and UNDO of a step's procedure leave on the wires."""
        key = (step.module, step.procedure)
        if key not in self.resets:
            signals = [
                s for table in self.sections for s in _all(table.get(key, ())) if isinstance(s, SignalStep)
            ]
            for s in signals:
                if s.signal.lower() in self.tells:
                    self._fault(f"{s.signal} says that the program runs; no handler switches it", s)
            self.resets[key] = tuple(
                (self.drives[s.signal.lower()], int(s.value == 1.0))
                for s in signals
                if s.signal.lower() in self.drives
            )
        return self.resets[key]

    def _fault(self, message: str, step: Step) -> None:
        self.faults.append((message, step))


def _all(steps: Iterable[Step]) -> Iterable[Step]:
    for step in steps:
        yield step
        if isinstance(step, ChoiceStep):
            yield from _all(step.steps)


def intervals(
    readings: Mapping[str, Reading], steps: Mapping[str, Sequence[Step]]
) -> list[dict[str, list[Step]]]:
    """Steps of each program in each interval, without those of the protocol; empty where the programs do not
    have the same number of meetings."""
    counts = {(reading.interval[-1] if reading.interval else 0) for reading in readings.values()}
    if len(counts) != 1:
        return []
    out: list[dict[str, list[Step]]] = [{arm: [] for arm in readings} for _ in range(counts.pop() + 1)]
    for arm, reading in readings.items():
        for step, interval, protocol in zip(steps[arm], reading.interval, reading.protocol, strict=True):
            if not protocol:
                out[interval][arm].append(step)
    return out
