"""Torches in URScript: the wait for one to burn, and the thread that monitors it while it cuts.

A program that was paused continues where it stopped, in the slot. Its output is *low when not running*, and
stays low. The thread reads it back and ends the program if it has fallen, so that nothing is lit there
again. It also ends the program if the input has shown for some time that no arc burns, as a controller of a
plasma table does (LinuxCNC's ``plasmac.arc-lost-delay``), and if the torch stands, as it would with the
speed slider at its minimum (2 % at the panel, 0 by RTDE; issue 58 of Universal_Robots_Client_Library).

Nothing is monitored before the torch is to move: the first check of the thread notices a pause there.
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
from planner.languages.writing.layout import ActionStep, OperationProgram, TaskProgram

AWAIT_ARC, WATCH_ARC, WATCHING_ARC = "await_arc", "watch_arc", "watching_arc"
"""Names of the function that waits for a torch to burn, of the thread that monitors it, and of its variable.

Those of further torches have a number appended.
"""
ARC_LOST_TIME_S: Final = 0.2
"""Time [s] for which the input may be low while the torch cuts: an arc flickers where it crosses its slot."""
MIN_TRAVELS_M: Final = (1.0e-3, 0.5e-3, 0.2e-3)
"""Distances [m] that a torch has to move so that it does not count as standing.

The largest one is used that the planned motion covers in the available time.
"""
MAX_STANDING_FRACTION: Final = 0.8
"""Fraction of the standing time in which the planned motion must cover that distance."""


@dataclasses.dataclass(frozen=True)
class ScriptTorch:
    """A torch as a program knows it.

    Attributes:
        signal: Output of the torch.
        ok_signal: Input of the torch, None for none.
        timeout: Time [s] for which the program waits for it to burn.
        max_standing_time: Time [s] for which it may stand while it burns.
        min_travel: Distance [m] that it has to move in that time.
        suffix: Suffix of the names of its function and its thread.
    """

    signal: str
    ok_signal: str | None
    timeout: float
    max_standing_time: float
    min_travel: float
    suffix: str = ""

    @property
    def wait(self) -> str:
        """Statement that waits for it to burn."""
        return f"{AWAIT_ARC}{self.suffix}({syntax.format_real(self.timeout, 3)})"

    @property
    def start_thread(self) -> str:
        """Statement that starts the thread."""
        return f"{WATCHING_ARC}{self.suffix} = run {WATCH_ARC}{self.suffix}()"

    @property
    def end_thread(self) -> str:
        """Statement that ends the thread."""
        return f"kill {WATCHING_ARC}{self.suffix}"


def task_torches(task: TaskProgram) -> dict[int, ScriptTorch]:
    """Return the torches of a task by the number of their operation, from 1.

    A torch is the first output that an action of the operation switches on with a limit for the time at one
    point (``max_dwell``). If the next action waits for an input, this is the torch's input. Operations with
    equal data share a torch, so that its functions are written once. The wait is rounded up to ms and the
    standing time down to 10 ms.
    """
    torches: dict[int, ScriptTorch] = {}
    named: dict[ScriptTorch, ScriptTorch] = {}  # torches without suffix -> with suffix
    for number, operation in enumerate(task.operations, 1):
        actions = [step.action for step in operation.steps if isinstance(step, ActionStep)]
        lit_index = next(
            (k for k, action in enumerate(actions) if action.kind == "on" and action.max_dwell > 0.0), None
        )
        if lit_index is None:
            continue
        following = actions[lit_index + 1] if lit_index + 1 < len(actions) else actions[lit_index]
        ok_signal = following.signal if following.kind == "input" else None
        timeout = math.ceil(1e3 * following.seconds) / 1e3 if ok_signal is not None else 0.0
        max_standing_time = math.floor(1e2 * actions[lit_index].max_dwell) / 1e2
        stays = functools.partial(longest_stay, operation)
        min_travel = next(
            (
                min_travel
                for min_travel in MIN_TRAVELS_M
                if stays(min_travel) <= MAX_STANDING_FRACTION * max_standing_time
            ),
            MIN_TRAVELS_M[-1],
        )
        torch = ScriptTorch(actions[lit_index].signal, ok_signal, timeout, max_standing_time, min_travel)
        suffix = f"_{len(named) + 1}" if named else ""
        torches[number] = named.setdefault(torch, dataclasses.replace(torch, suffix=suffix))
    return torches


def longest_stay(program: OperationProgram, distance: float) -> float:
    """Return the longest time [s] in which a tool moves at most ``distance`` [m] in its slots.

    The distance that a torch must move is chosen by it, so that the planned motion does not count as
    standing. A stay starts at a target and ends at the first target that is farther away, where the next stay
    starts. A slot is a run of consecutive moves that cut. Lead-in and lead-out do not count.
    """
    track = program.moves
    longest = 0.0
    if track is None:
        return longest
    cuts = [k for k, segment in enumerate(program.segments) if segment.works and not segment.phase]
    # a slot is a run of consecutive moves: index minus place in the list is constant
    for _, run in itertools.groupby(enumerate(cuts), lambda item: item[1] - item[0]):
        slot = [move for _, move in run]
        # the target before the slot is its start, if there is one; otherwise the first time is dropped, too
        positions = 1e-3 * track.position[max(slot[0] - 1, 0) : slot[-1] + 1]
        time = np.append(0.0, np.cumsum(track.duration[slot]))[-len(positions) :]
        start = 0
        while start < len(positions) - 1:
            away = np.linalg.norm(positions[start + 1 :] - positions[start], axis=1) > distance
            step = int(np.argmax(away)) + 1 if away.any() else len(away)
            longest = max(longest, float(time[start + step] - time[start]))
            start += step
    return longest


def torch_functions(
    torch: ScriptTorch, output: int, given: int | None, off_statements: Sequence[str]
) -> Iterator[str]:
    """Yield the lines of the function that waits for a torch to burn and of the thread that monitors it.

    Args:
        torch: The torch.
        output: Number of its output.
        given: Number of its input, None for none; then there is no function.
        off_statements: Statements that switch off what must be off where the program ends.
    """
    if given is not None and torch.ok_signal is not None:
        text = urscript_sentences.NO_ARC.format(signal=torch.ok_signal, seconds=torch.timeout)
        yield from (
            f"def {AWAIT_ARC}{torch.suffix}(limit):",
            "local passed=0.0",
            f"while {syntax.input_call(given)}==False:",
            "if passed>limit:",
            *off_statements,
            *syntax.end_program(text),
            "end",
            f"sleep({syntax.WAIT_STEP})",
            f"passed=passed+{syntax.WAIT_STEP}",
            "end",
            "end",
        )
        text = urscript_sentences.ARC_LOST.format(signal=torch.signal, ok_signal=torch.ok_signal)
        arc_condition = f" and arc_lost<={ARC_LOST_TIME_S}"
        arc_check = [
            f"arc_lost=arc_lost+{syntax.WAIT_STEP}",
            f"if {syntax.input_call(given)}:",
            "arc_lost=0.0",
            "end",
        ]
    else:
        text = urscript_sentences.TORCH_STOOD.format(signal=torch.signal)
        arc_condition = ""
        arc_check = []
    yield from (
        f"thread {WATCH_ARC}{torch.suffix}():",
        *(["local arc_lost=0.0"] if arc_check else []),
        "local arc_stood=0.0",
        "local arc_place=get_actual_tcp_pose()",
        f"sleep({syntax.SETTLING_TIME_S})",
        f"while {syntax.output_call(output)}{arc_condition} and "
        f"arc_stood<={syntax.format_real(torch.max_standing_time, 2)}:",
        f"sleep({syntax.WAIT_STEP})",
        *arc_check,
        f"arc_stood=arc_stood+{syntax.WAIT_STEP}",
        f"if point_dist(get_actual_tcp_pose(),arc_place)>{torch.min_travel}:",
        "arc_place=get_actual_tcp_pose()",
        "arc_stood=0.0",
        "end",
        "end",
        *off_statements,
        *syntax.end_program(text, blocking=False),
        "end",
    )
