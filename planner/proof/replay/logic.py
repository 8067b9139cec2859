"""Steps between moves, their duration, and whether they need a standstill."""

from planner.programs.steps import MessageStep, MoveStep, ProgramStep, SettingStep, WaitStep


def steps_between_moves(steps: tuple[ProgramStep, ...], count: int) -> list[list[ProgramStep]]:
    """Return the steps other than moves, in ``count`` + 1 lists: before the first move, and after each move.

    The last list contains all steps after move ``count``, although there may be further moves between them.
    """
    out: list[list[ProgramStep]] = [[] for _ in range(count + 1)]
    move_count = 0
    for step in steps:
        if isinstance(step, MoveStep):
            move_count += 1
        else:
            out[min(move_count, count)].append(step)
    return out


def dwell_time(steps: list[ProgramStep]) -> float:
    """Return the total time [s] of the pauses among the steps."""
    return sum(step.pause for step in steps if isinstance(step, WaitStep))


def needs_standstill(steps: list[ProgramStep]) -> bool:
    """Return whether steps need an arm at rest: waits, questions, and settings that stop the arm."""
    return any(
        isinstance(step, WaitStep) or (isinstance(step, MessageStep) and step.confirm) for step in steps
    ) or any(isinstance(step, SettingStep) and step.stops for step in steps)
