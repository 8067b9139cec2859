"""Steps between two moves, and their duration."""

from planner.programs.steps import MessageStep, MoveStep, ProgramStep, SettingStep, WaitStep


def steps_between_moves(steps: tuple[ProgramStep, ...], count: int) -> list[list[ProgramStep]]:
    """Return the steps other than moves: before the first move, and after each of ``count`` moves.

    The last entry takes all that remain.
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
    """Return the time [s] for which the steps wait."""
    return sum(step.pause for step in steps if isinstance(step, WaitStep))


def needs_standstill(steps: list[ProgramStep]) -> bool:
    """Return whether the steps need the arm to stand: waits and questions to the operator, not settings."""
    return any(
        isinstance(step, WaitStep) or (isinstance(step, MessageStep) and step.confirm) for step in steps
    ) or any(isinstance(step, SettingStep) and step.stops for step in steps)
