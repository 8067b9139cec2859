"""What stands between two moves, and how long it takes."""

from planner.programs.steps import MessageStep, MoveStep, SettingStep, Step, WaitStep


def between(steps: tuple[Step, ...], count: int) -> list[list[Step]]:
    """Steps that are no moves: before the first move, behind each of ``count`` moves (the last takes what
    remains)."""
    out: list[list[Step]] = [[] for _ in range(count + 1)]
    seen = 0
    for step in steps:
        if isinstance(step, MoveStep):
            seen += 1
        else:
            out[min(seen, count)].append(step)
    return out


def dwell_time(steps: list[Step]) -> float:
    """Seconds that the steps wait for."""
    return sum(step.pause for step in steps if isinstance(step, WaitStep))


def needs_standstill(steps: list[Step]) -> bool:
    """Whether the steps need the arm to stand: waits and questions to the operator, not settings."""
    return any(
        isinstance(step, WaitStep) or (isinstance(step, MessageStep) and step.confirm) for step in steps
    ) or any(isinstance(step, SettingStep) and step.stops for step in steps)
