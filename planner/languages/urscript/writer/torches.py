"""Torches in URScript: what waits for one to burn, and the thread that watches it while it cuts.

A program that was paused goes on where it stood, in the slot. Its output is *low when not running*, and stays
low; the thread reads it back, ends the program where it has fallen, and so nothing is lit there again. It
ends it as well where the input says that no arc burns, for some time, as a controller of a plasma table does
(LinuxCNC's ``plasmac.arc-lost-delay``), and where the torch stands, as it would with the speed slider at its
least (2 % at the panel, 0 by RTDE; issue 58 of Universal_Robots_Client_Library).

Nothing is watched before the torch is to move: a pause there is seen by the first look of the thread.
"""

import dataclasses
import functools
import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from planner.languages.urscript import sentences as urscript_sentences
from planner.languages.urscript.writer import syntax
from planner.languages.writing.layout import Do, OperationProgram, TaskProgram

AWAIT_ARC, WATCH_ARC, WATCHING_ARC = "await_arc", "watch_arc", "watching_arc"
"""The function that waits for a torch to burn, the thread that watches it, and what holds that; of further
torches with a number behind."""
LOST: Final = 0.2
"""Time [s] for which its input may be low while it cuts: an arc flickers where it crosses its own slot."""
PLACES: Final = (1.0e-3, 0.5e-3, 0.2e-3)
"""How far [m] it has to get so that it does not stand: as far as its slots let it in the time that it has."""
STANDING_SHARE: Final = 0.8
"""Share of that time in which it gets there by its plan."""


@dataclasses.dataclass(frozen=True)
class Torch:
    """A torch as a program knows it: its output and its input, None for none, how long [s] the program waits
    for it to burn and for how long it may stand then; ``suffix`` of its function's and its thread's names."""

    signal: str
    ok_signal: str | None
    timeout: float
    stood: float
    far: float
    suffix: str = ""

    @property
    def wait(self) -> str:
        """The wait for it to burn."""
        return f"{AWAIT_ARC}{self.suffix}({syntax.real(self.timeout, 3)})"

    @property
    def watched(self) -> str:
        """The thread begins."""
        return f"{WATCHING_ARC}{self.suffix} = run {WATCH_ARC}{self.suffix}()"

    @property
    def left(self) -> str:
        """The thread ends."""
        return f"kill {WATCHING_ARC}{self.suffix}"


def torches(task: TaskProgram) -> dict[int, Torch]:
    """The torch of each operation of a task that has one, by the operation's number from 1 on: what is
    switched on and must not stay in one place."""
    out: dict[int, Torch] = {}
    known: dict[Torch, Torch] = {}
    for number, operation in enumerate(task.operations, 1):
        actions = [step.action for step in operation.steps if isinstance(step, Do)]
        lit = next((k for k, one in enumerate(actions) if one.kind == "on" and one.stands > 0.0), None)
        if lit is None:
            continue
        behind = actions[lit + 1] if lit + 1 < len(actions) else actions[lit]
        given = behind.signal if behind.kind == "input" else None
        timeout = math.ceil(1e3 * behind.seconds) / 1e3 if given is not None else 0.0
        stood = math.floor(1e2 * actions[lit].stands) / 1e2
        stays = functools.partial(longest_stay, operation)
        far = next((far for far in PLACES if stays(far) <= STANDING_SHARE * stood), PLACES[-1])
        one = Torch(actions[lit].signal, given, timeout, stood, far)
        suffix = f"_{len(known) + 1}" if known else ""
        out[number] = known.setdefault(one, dataclasses.replace(one, suffix=suffix))
    return out


def longest_stay(program: OperationProgram, far: float) -> float:
    """The longest time [s] in which a tool gets no farther than ``far`` [m] from a place in the slots of an
    operation, from target to target."""
    track, worst = program.track, 0.0
    if track is None:
        return worst
    rows = [k for k, segment in enumerate(program.segments) if segment.works and not segment.phase]
    for _, run in itertools.groupby(enumerate(rows), lambda item: item[1] - item[0]):
        slot = [row for _, row in run]
        place = 1e-3 * track.position[max(slot[0] - 1, 0) : slot[-1] + 1]
        time = np.append(0.0, np.cumsum(track.duration[slot]))[-len(place) :]
        at = 0
        while at < len(place) - 1:
            away = np.linalg.norm(place[at + 1 :] - place[at], axis=1) > far
            step = int(np.argmax(away)) + 1 if away.any() else len(away)
            worst, at = max(worst, float(time[at + step] - time[at])), at + step
    return worst


def functions(torch: Torch, output: int, given: int | None, off: Sequence[str]) -> Iterator[str]:
    """What waits for a torch and what watches it, with its numbers; ``off``: all that goes off where the
    program ends."""
    if given is not None and torch.ok_signal is not None:
        text = urscript_sentences.NO_ARC.filled(signal=torch.ok_signal, seconds=torch.timeout)
        yield from (
            f"def {AWAIT_ARC}{torch.suffix}(limit):",
            "local passed=0.0",
            f"while {syntax.input_call(given)}==False:",
            "if passed>limit:",
            *off,
            *syntax.ended(text),
            "end",
            f"sleep({syntax.WAIT_STEP})",
            f"passed=passed+{syntax.WAIT_STEP}",
            "end",
            "end",
        )
        text = urscript_sentences.ARC_LOST.filled(signal=torch.signal, ok_signal=torch.ok_signal)
        watched, burns = (
            f" and arc_lost<={LOST}",
            [
                f"arc_lost=arc_lost+{syntax.WAIT_STEP}",
                f"if {syntax.input_call(given)}:",
                "arc_lost=0.0",
                "end",
            ],
        )
    else:
        text, watched, burns = urscript_sentences.TORCH_STOOD.filled(signal=torch.signal), "", []
    yield from (
        f"thread {WATCH_ARC}{torch.suffix}():",
        *(["local arc_lost=0.0"] if burns else []),
        "local arc_stood=0.0",
        "local arc_place=get_actual_tcp_pose()",
        f"sleep({syntax.SETTLED})",
        f"while {syntax.output_call(output)}{watched} and arc_stood<={syntax.real(torch.stood, 2)}:",
        f"sleep({syntax.WAIT_STEP})",
        *burns,
        f"arc_stood=arc_stood+{syntax.WAIT_STEP}",
        f"if point_dist(get_actual_tcp_pose(),arc_place)>{torch.far}:",
        "arc_place=get_actual_tcp_pose()",
        "arc_stood=0.0",
        "end",
        "end",
        *off,
        *syntax.ended(text, blocking=False),
        "end",
    )
