"""URScript programs of a job: for each arm of UR one file with one program, without branches.

Beside another arm of UR on a controller of its own it meets the other program by
:mod:`planner.languages.writing.handshake`. A thread watches the other one's running wire and ends this
program when it falls. The own running wire is switched by the program, for a program that asks cannot know
whether its controller counts as running meanwhile: the wire is low then in any case. That it falls with the
program, and stays low behind a pause, is set in the controller's installation.

A question stands in the middle of a meeting: the other program waits there with its line at 1, and does
not watch from before it until its wait is over. The one that asks looks at both wires of the other one
before its running wire rises again, and once more when it watches: a program that was started anew
meanwhile has its line at 0.

The controller counts in a base of its own, which :func:`controller_base` finds in the arm's URDF.
Moves by joints state the speed of their leading axis, at which the TCP keeps its limit; straight
moves state their time and a blend radius.
"""

import itertools
import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from planner.catalogue.robots import ParallelParameters, RobotData
from planner.cell.kinematics import forward
from planner.claims import sentences
from planner.claims.handshake import PartnerSignals
from planner.geometry.arrays import BoolArray, FloatArray, from_rpy, inverse
from planner.issues import Issue, TandemError, refusal
from planner.languages.urscript import sentences as urscript_sentences
from planner.languages.urscript.writer import syntax
from planner.languages.urscript.writer.meetings import (
    Watch,
    WatchedStep,
    asking,
    held,
    watched_meeting,
    watched_start,
)
from planner.languages.urscript.writer.syntax import comment, name
from planner.languages.urscript.writer.torches import Torch, torches
from planner.languages.urscript.writer.torches import functions as torch_functions
from planner.languages.writing import handshake, layout
from planner.languages.writing.header import header
from planner.languages.writing.language import Margins, WrittenPrograms
from planner.languages.writing.steps import require_mass
from planner.plans import Plan
from planner.problem import Arm, Problem
from planner.targets import Action
from planner.tooling import Tool

CHECK_TIP: Final = from_rpy([0.1, 0.2, 0.3], [0.0, 0.0, 0.0])
"""A point of the flange's frame off all axes: where it stands tells how base and flange are turned."""
CHECK_ERROR: Final = 0.01
"""How far [m] the controller may have that point elsewhere: arms are calibrated one by one, to some mm."""
UNKNOWN_START_SHARE: Final = 0.10
"""Share of the axes' speed of a move from a place that is not known: the first one of a program."""
_SPEED_SAMPLES: Final = 400
"""Places of a move by joints at which the speed of the TCP is looked at."""
_SPEED_SHARE: Final = 0.99
"""Share of the speed limit that it may use, for the fastest place may lie between two of these."""
LEAST_JOINT_SPEED: Final = 0.001
"""Least speed of a leading axis that is written [rad/s]."""
_ZERO: Final = np.deg2rad([-90.0, 0.0, -90.0, 0.0, 0.0])
"""Offsets of axes 2 to 6 of UR's own zero posture."""
_AGREE: Final = 1e-6
"""How far an arm may be off that [rad]."""
_UNTESTED: Final = "No controller of UR has run such a program yet: begin at low speed, and compare the time."
"""Said at the head of each program."""
_STEM_LENGTH: Final = 24
"""Characters of the problem's name in the program's."""


def controller_base(arm: Arm) -> FloatArray:
    """The base (4, 4) that a UR controller counts in, in the arm's own: at zero the arm lies along its -x.

    Raises :class:`TandemError` (``post.ur_arm``) for an arm whose zero, signs or flange are not those of UR:
    joints in programs would mean other postures.
    """
    form = arm.data.form
    wrong = ""
    if not isinstance(form, ParallelParameters):
        wrong = "its axes 2, 3 and 4 are not parallel"
    elif np.abs(form.offsets[1:] - _ZERO).max() > _AGREE or (form.signs != 1.0).any():
        wrong = "its joints are zero elsewhere, or turn the other way, than a UR controller counts them"
    elif form.right is not None:
        wrong = "its tip is not the flange of a UR controller, which stands on axis 6 with z out of the arm"
    if wrong or not isinstance(form, ParallelParameters):
        message = f"arm {arm.name} ({arm.robot}) is no arm that a UR controller moves: {wrong}"
        hint = "take UR's own URDF with base: base_link and tip: tool0, or family: generic"
        raise refusal("post.ur_arm", message, arm=arm.name, hint=hint)
    turn = from_rpy([0.0, 0.0, 0.0], [0.0, 0.0, np.pi - float(form.offsets[0])])
    return turn if form.left is None else np.asarray(form.left @ turn)


def joint_speed(
    robot: RobotData, start: FloatArray, end: FloatArray, tcp: FloatArray, limit: float, most: float
) -> float:
    """Speed [rad/s] of the leading axis of a move between joints (6,) [rad] with the TCP ``tcp`` (4, 4), so
    that the TCP keeps below ``limit`` [m/s] and each axis below the share ``most`` of its speed."""
    q = start + np.linspace(0.0, 1.0, _SPEED_SAMPLES + 1)[:, None] * (end - start)
    point = (forward(robot, q) @ tcp)[:, :3, 3]
    change = np.abs(end - start)
    farthest = float(np.linalg.norm(np.diff(point, axis=0), axis=1).max()) * _SPEED_SAMPLES
    lead = float(change.max())
    speed = most * float(np.min(robot.velocity))
    if farthest > 0.0:
        speed = min(speed, _SPEED_SHARE * limit * lead / farthest)
    return max(LEAST_JOINT_SPEED, float(np.floor(1e4 * speed) / 1e4))


class _Main:
    """Writes the program of one task."""

    def __init__(self, task: layout.TaskProgram, job: layout.Job, plan: Plan, problem: Problem) -> None:
        self.task, self.job, self.plan, self.problem = task, job, plan, problem
        self.foot = controller_base(task.arm)
        self.base = task.base @ self.foot
        self.data: dict[str, str] = {}
        self.tools: dict[str, str] = {}
        self.places: dict[str, str] = {}
        self.moves = 0
        self.partner = handshake.Partner.of(task, job)
        self.asks, self.held = frozenset[int](), frozenset[int]()
        """Meetings behind which this program asks somebody, and those in which the other one does."""
        if self.partner is not None:
            self.asks = asking(task)
            others = (asking(other) for other in job.tasks if other is not task)
            self.held = held(self.partner, frozenset[int]().union(*others))
        self.watching = False
        self.met = 0
        """The last meeting."""
        self.begun = 0
        """The meeting before which the other one's line was seen to rise, for a question."""
        self.rest: list[WatchedStep] = []
        """Steps of the last meeting that stand behind a question."""
        self.powered: set[str] = set()
        self.torches = torches(task)
        self.torch: Torch | None = None
        """That of the operation that is written."""
        self.lit = self.guarded = False
        """Whether it burns, and its thread runs."""
        self._at: FloatArray | None = None
        self._acceleration = float(np.min(task.robot.acceleration)) * problem.settings.acceleration_fraction

    def lines(self) -> tuple[list[str], list[str]]:
        """Declarations, and the statements behind them."""
        self._declare("base_frame", syntax.pose(self.base))
        home = self._joints(layout.Joints(self.task.arm.home, "home"), 0)
        place = inverse(self.foot) @ forward(self.task.robot, self.task.arm.home) @ CHECK_TIP
        text = urscript_sentences.OTHER_ARM.filled(arm=self.task.arm.name, model=self.task.arm.robot)
        out = self._unlit()
        out += [self._switch(signal, False) for signal in self.job.switched(self.task)]
        if self.partner is not None:
            running = self._own.running
            stays = urscript_sentences.STAYS_ON.filled(signal=running)
            out += syntax.stays_low(self._number(running), self._runs(False), stays)
        out += syntax.kinematics_check(home, CHECK_TIP, place, CHECK_ERROR, text)
        clear = (sentences.KRL_CLEAR if self.problem.setups[0].steps else sentences.KRL_READY).filled()
        functions = self._watched()
        if self.partner is None:
            out += syntax.question(clear)
        else:
            functions += self._functions(self.partner)
            out += self._start(self.partner, clear)
        for i, operation in enumerate(self.task.operations, 1):
            out += self._operation(i, operation)
        return [*(f"{word} = {value}" for word, value in self.data.items()), *functions], out

    # ---- torches ----

    def _unlit(self) -> list[str]:
        """The program ends where the output of a torch is on before it has switched anything."""
        out: list[str] = []
        for signal in dict.fromkeys(torch.signal for torch in self.torches.values()):
            stays = urscript_sentences.STAYS_ON.filled(signal=signal)
            out += syntax.stays_low(self._number(signal), self._switch(signal, False), stays)
        return out

    def _watched(self) -> list[str]:
        off = [self._switch(signal, False) for signal in self.job.switched(self.task)]
        out: list[str] = []
        for torch in dict.fromkeys(self.torches.values()):
            given = None if torch.ok_signal is None else self._number(torch.ok_signal)
            out += torch_functions(torch, self._number(torch.signal), given, off)
        return out

    def _switched(self, signal: str, on: bool) -> list[str]:
        """An output is switched; the thread of a torch ends before that goes off."""
        torch = self.torch
        out = [self._switch(signal, on)]
        if torch is None or signal != torch.signal:
            return out
        self.lit, guarded, self.guarded = on, self.guarded, False
        return [torch.left, *out] if guarded else out

    # ---- the other controller ----

    def _functions(self, partner: handshake.Partner) -> list[str]:
        """What waits for the other program, and what watches it."""
        own = partner.handshake.of(partner.arm)
        off = [self._switch(signal, False) for signal in (own.running, *self.job.switched(self.task))]
        lost = urscript_sentences.PARTNER_LOST.filled(other=partner.other)
        given, runs, back = (self._number(s) for s in (own.input, own.partner_running, own.running))
        return [
            *syntax.wait_function(syntax.AWAIT_LINE, given, back, off, partner.unanswered),
            *syntax.wait_function(syntax.AWAIT_RUNNING, runs, back, off, partner.unanswered),
            *syntax.check_function(given, runs, back, off, partner.unanswered),
            *syntax.watch_thread(runs, back, off, lost),
            *syntax.stand_function(),
        ]

    @property
    def _own(self) -> PartnerSignals:
        return self.problem.cell.controller.handshake.of(self.task.arm.name)

    def _runs(self, on: bool) -> str:
        return self._switch(self._own.running, on)

    def _start(self, partner: handshake.Partner, clear: str) -> list[str]:
        """All up to the first meeting, and that. A program begins with its wires low, and stands for a while
        before its running wire rises behind a question; at the second one it sees the other one run."""
        out, popups, first = [self._runs(False)], list[str](), True
        for step in watched_start(partner, clear):
            match step:
                case handshake.Tell(text) if partner.lead:
                    popups = syntax.told(text, before_question=True)
                case handshake.Ask(text):
                    before = [] if first else [self._runs(False)]
                    seen = [] if first else [syntax.checked(0, False)]
                    stands = f"sleep({syntax.real(syntax.SEEN, 1)})"
                    out += [*before, *popups, *syntax.question(text), *seen, stands, *self._rises()]
                    first = False
                case _:
                    out += self._steps([step])
        wait = partner.handshake.timeout if partner.lead else partner.handshake.patience
        return [*out, *comment("First meeting: both programs run."), *self._meeting(partner, 1, wait)]

    def _rises(self) -> list[str]:
        return [self._runs(True), f"sleep({syntax.real(syntax.SETTLED, 1)})"]

    def _meeting(self, partner: handshake.Partner, meeting: int, wait: float) -> list[str]:
        """A meeting. Nobody watches any more from before one on in which the other program asks, or
        behind which both come to their ends; a question of this program stands in it or before."""
        quiet = meeting in self.held or meeting == partner.meets
        longest = partner.handshake.patience if meeting in self.held else 0.0
        first, rest = watched_meeting(partner, wait, longest)
        self.met = meeting
        out = self._watch(False) if quiet else []
        out += [syntax.checked(1, True)] if self.begun == meeting else self._steps(first)
        if partner.lead and meeting in self.asks:
            self.rest = rest
            return out
        return out + self._steps(rest)

    def _steps(self, steps: Sequence[WatchedStep]) -> list[str]:
        out: list[str] = []
        for step in steps:
            match step:
                case handshake.SetLine(value):
                    out.append(self._switch(self._own.output, value == 1))
                case handshake.AwaitLine(value, seconds):
                    out.append(syntax.awaited(syntax.AWAIT_LINE, value, seconds))
                case handshake.AwaitRunning(value, seconds):
                    out.append(syntax.awaited(syntax.AWAIT_RUNNING, value, seconds))
                case Watch() if self.partner is not None and self.met < self.partner.meets:
                    out += self._watch(True)
                case handshake.Tell(text):
                    out += syntax.told(text, before_question=False)
        return out

    def _asked(self, popups: Sequence[str], behind: Sequence[layout.Step]) -> list[str]:
        """A question between two meetings; ``behind``: steps of the operation behind it. The other program
        waits with its line at 1: of the lead in the meeting before, else in the one behind."""
        if self.partner is None:
            return list(popups)
        out: list[str] = []
        if not self.partner.lead and self.begun != self.met + 1:
            self.begun = self.met + 1
            out = self._steps(watched_meeting(self.partner, self.partner.handshake.patience)[0])
        low = [self._runs(False), *popups, syntax.checked(1, False), *self._rises()]
        out += [*self._watch(False), *low, *self._watch(True), syntax.checked(1, True)]
        if not _asks_again(behind):
            out += self._steps(self.rest)
            self.rest = []
        return out

    def _watch(self, on: bool) -> list[str]:
        if on == self.watching:
            return []
        self.watching = on
        if not on and self.powered:
            listed = ", ".join(sorted(self.powered))
            message = (
                f"{listed} of arm {self.task.arm.name} is on while one of the arms asks somebody something; "
                "nothing would take the power when the other program stops then"
            )
            hint = "switch it off before the question, and on behind it"
            raise refusal("post.handshake_process", message, arm=self.task.arm.name, hint=hint)
        return [f"{syntax.WATCHING} = run {syntax.WATCH}()" if on else f"kill {syntax.WATCHING}"]

    def _declare(self, word: str, value: str) -> str:
        if self.data.setdefault(word, value) != value:
            message = f"two things of arm {self.task.arm.name} would be called {word}"
            raise refusal("post.name", message, hint="give the tool another name")
        return word

    def _operation(self, index: int, operation: layout.OperationProgram) -> list[str]:
        out, told = comment(f"Operation {operation.name}."), False
        self.torch = self.torches.get(index)
        held: list[str] = []
        for i, step in enumerate(operation.steps):
            if not told and isinstance(
                step, layout.Joints | layout.Run
            ):  # behind the setup that has mounted the tool
                told, tool = True, operation.arm.tool
                out += [f"set_tcp({self._tool(tool)})", _payload(tool)]
            if isinstance(step, layout.Do) and step.action.kind in ("message", "confirm"):
                held += self._action(step.action, layout.question_follows(operation.steps[i + 1 :]))
                if step.action.kind == "confirm":
                    out, held = [*out, *self._asked(held, operation.steps[i + 1 :])], []
                elif not layout.question_follows(operation.steps[i + 1 :]):
                    out, held = [*out, *held], []
                continue
            out += self._step(step, index, operation)
        return out

    def _step(self, step: layout.Step, index: int, operation: layout.OperationProgram) -> list[str]:
        match step:
            case layout.Joints():
                return self._movej(step, index, operation)
            case layout.Do(action):
                return self._action(action, False)
            case layout.Meet(meeting, reached, seconds) if self.partner is not None:
                wait = self.partner.handshake.patience + math.ceil(seconds)
                return [*comment(f"Meeting: {reached}"), *self._meeting(self.partner, meeting, wait)]
            case layout.Run():
                return self._run(step, operation)
            case layout.Carry(load) if load is not None:
                raise TandemError(no_load(self.task.arm.name))
        return []

    def _movej(self, step: layout.Joints, index: int, operation: layout.OperationProgram) -> list[str]:
        limits, robot = self.problem.settings, self.task.robot
        tcp, share, start = operation.arm.tool.tcp, limits.speed_fraction, self._at
        if start is None:
            speed = UNKNOWN_START_SHARE * float(np.min(robot.velocity))
            speed = float(np.floor(1e4 * speed) / 1e4)
        else:
            speed = joint_speed(robot, start, step.q, tcp, limits.tcp_speed, share)
        self._at = step.q
        acceleration = float(np.floor(1e4 * self._acceleration) / 1e4)
        return [syntax.movej(self._joints(step, index), acceleration, speed)]

    def _joints(self, step: layout.Joints, operation: int) -> str:
        text = syntax.joints(self.task.robot.to_controller(step.q))
        if text not in self.places:
            stem = "x_home" if step.place == "home" else f"x_{operation}_{step.place}"
            count = sum(word.startswith(stem) for word in self.places.values())
            word = stem if step.place == "home" else f"{stem}_{count + 1}"
            self.places[text] = self._declare(word, text)
        return self.places[text]

    def _tool(self, tool: Tool) -> str:
        value = syntax.pose(tool.tcp)
        key = f"{tool.name} {value}"
        if key not in self.tools:
            stem = name(f"t_{tool.name}")
            names = itertools.chain([stem], (f"{stem}_{n}" for n in itertools.count(2)))
            own = next(word for word in names if word not in self.tools.values())
            self.tools[key] = self._declare(own, value)
        return self.tools[key]

    def _frame(self, operation: layout.OperationProgram) -> str:
        """Name of the frame of an operation's moves, as the controller's base sees it."""
        kind = "world" if operation.track is None else operation.track.frame
        seen = inverse(self.base)
        if kind == "world":
            return self._declare("b_world", syntax.pose(seen))
        if kind == "stock":
            place = seen @ self.plan.places[operation.setup - 1]
            word = "b_stock" if operation.setup == 1 else f"b_stock_{operation.setup}"
            return self._declare(word, syntax.pose(place))
        message = f"targets of {self.task.arm.name} lie in {kind!r}, which URScript has no frame for"
        raise refusal("post.frame", message, hint="allowed: stock, world")

    def _action(self, action: Action, asks: bool) -> list[str]:
        match action.kind:
            case "message":
                return syntax.told(action.text, before_question=asks)
            case "confirm":
                return syntax.question(action.text)
            case "on" | "off":
                change = self.powered.add if action.kind == "on" else self.powered.discard
                change(action.signal)
                return self._switched(action.signal, action.kind == "on")
            case "wait":
                return [f"sleep({syntax.real(action.seconds, 3)})"]
            case "input" if self.torch is not None and action.signal == self.torch.ok_signal:
                return [self.torch.wait]
            case "input":
                raise TandemError(no_input(action, self.task.arm.name))

    def _switch(self, signal: str, on: bool) -> str:
        return f"{syntax.output(self._number(signal), on)} # {signal}"

    def _number(self, signal: str) -> int:
        found = self.problem.cell.controller.number(self.task.arm.name, signal)
        if found is None:
            message = f"the cell gives no number of {signal} on the controller of {self.task.arm.name}"
            raise refusal("post.signal", message, arm=self.task.arm.name)
        return found

    def _run(self, run: layout.Run, operation: layout.OperationProgram) -> list[str]:
        track, some = operation.track, slice(run.first, run.last)
        if track is None:
            return []
        radius = syntax.blends(track, operation.stop)
        lost = np.flatnonzero(np.isnan(radius[some])) + run.first
        if len(lost):
            place = f"{operation.segments[lost[0]]}, move {lost[0] + 1}"
            message = (
                f"operation {operation.name}: {len(lost)} moves of arm {self.task.arm.name} would pass "
                f"targets where there is no room for a blend, first {place}: the tool turns about its TCP, "
                "or hardly moves"
            )
            hint = "let the motion stop there, or choose another TCP or cut, so that the tool has a way"
            raise refusal("post.blend", message, arm=self.task.arm.name, target=place, hint=hint)
        seconds = layout.short(float(track.duration[some].sum()), 2)
        out: list[str] = []
        if self.torch is not None and self.lit and not self.guarded:
            out.append(self.torch.watched)
            self.guarded = True
        out += comment(f"Segment {layout.mark(run.segment)}: {run.last - run.first} moves, {seconds} s.")
        moves = syntax.straight(track, radius, self._frame(operation))[some]
        if self.partner is not None and self._at is not None:
            rests = np.flatnonzero(self._still(operation, track)[some])
            for row in rests.tolist():
                moves[row] = f"{syntax.STAND}({syntax.real(float(track.duration[some][row]), 5)})"
        for move, meeting in zip(moves, operation.meets[some].tolist(), strict=True):
            out.append(move)
            if meeting and self.partner is not None:
                out += self._meeting(self.partner, meeting, self.partner.handshake.timeout)
        self._at = track.q[run.last - 1]
        self.moves += run.last - run.first
        return out

    def _still(self, operation: layout.OperationProgram, track: layout.Track) -> BoolArray:
        """Whether (M,) moves go nowhere. Raises :class:`TandemError` (``post.blend``) where the first one
        does: behind a move by joints a program knows no place to stand at."""
        start = next(s.q for s in operation.steps if isinstance(s, layout.Joints) and s.place == "start")
        out = syntax.still(track, start)
        if out[:1].any():
            message = f"operation {operation.name}: arm {self.task.arm.name} stands still in its first move"
            hint = "let both arms move from the first target on"
            raise refusal("post.blend", message, arm=self.task.arm.name, hint=hint)
        return out


def no_input(action: Action, arm: str) -> Issue:
    """Why an arm of UR does not wait for an input of its process."""
    what = f"arm {arm} is to wait for {action.signal}, for {action.seconds:g} s at most, which Tandem writes "
    what += "in RAPID and KRL alone so far"
    return Issue("post.controller", what, arm=arm, hint="take an ABB or KUKA robot for it")


def no_load(arm: str) -> Issue:
    """Why an arm of UR holds no block."""
    message = f"arm {arm} holds the block; URScript is written for tools alone"
    return Issue("post.load", message, arm=arm, hint="let the block stand in the cell")


def _payload(tool: Tool) -> str:
    """The statement that tells mass [kg] and centre [m] in the flange's frame. Raises :class:`TandemError`
    (``post.tool``) for a tool without mass."""
    require_mass(tool, "a payload needs {} kg at least")
    return f"set_payload({layout.number(tool.mass, 3)},{syntax.vector(np.asarray(tool.cog), 6)})"


def _asks_again(steps: Sequence[layout.Step]) -> bool:
    """Whether another question stands ahead of the next meeting."""
    rest = (step for step in steps if isinstance(step, layout.Meet | layout.Run) or layout.confirms(step))
    return layout.confirms(next(rest, None))


def write(
    tasks: Sequence[layout.TaskProgram], job: layout.Job, plan: Plan, problem: Problem, margins: Margins
) -> WrittenPrograms:
    """Write the programs of UR's arms. Raises :class:`TandemError` (``post.*``)."""
    limits = problem.cell.controller
    out: dict[str, str] = {}
    for task in tasks:
        stem = name(problem.name, _STEM_LENGTH)
        main = _Main(task, job, plan, problem)
        data, body = main.lines()
        told = header(task, job, plan, margins, untested=[_UNTESTED])
        head = [line for sentence in told for line in comment(sentence)]
        note = "# what this program was planned for; the proof starts from these"
        digest = f'problem_digest = "{plan.digest}"'
        rows = [f"def {stem}():", *head, note, digest, *data, *body, "end"]
        path = f"{task.arm.name}/{stem}.script"
        text = "".join(f"{row}{layout.LINE_END}" for row in rows)
        layout.require_one_file(path, text, limits, main.moves, "moves")
        out[path] = text
    return WrittenPrograms(out)
