"""What the files beside the programs say to the operator: the wording, which writer and proof both read.

Lines of a box have 55 characters at most, lines of the panel 40.
"""

from __future__ import annotations

from typing import Final

HEADER: Final = "Tandem"
BUTTONS: Final = ("Free", "On", "Stop")
"""Answers to :func:`again`: nothing stands in the way of what follows; power is on again; neither."""

OFF_BY_MM: Final = "is off by [mm]"
OFF_BY_DEGREES: Final = "and turned by [degrees]"
NOT_AS_PLANNED: Final = "is not as it was planned."
NOTHING_MOVES: Final = ("Nothing moves. Put it right,", "then PP to main in all tasks.")
REFUSED: Final = (
    "Not started: the power was on at the",
    "stop. Free the wire or tool, then",
    "PP to main in all tasks.",
)


def again(signal: str) -> tuple[str, ...]:
    """The question at a start behind a stop at which the power ``signal`` was on."""
    return (
        f"{signal} was on at the stop.",
        "Free: block and part are out of all that follows.",
        f"On: {signal} is 1 again by hand,",
        "and the wire is hot, or the tool at full speed.",
        "Stop: neither. Free it, then PP to main in all tasks.",
    )


def base_of(arm: str) -> str:
    """What is compared: the base frame of an arm."""
    return f"Base of arm {arm}"


def frame_of(name: str) -> str:
    """What is compared: the frame of a tool."""
    return f"Frame of {name}"


def user_frame_of(name: str) -> str:
    """What is compared: the user frame of a work object."""
    return f"User frame of {name}"


def object_frame_of(name: str) -> str:
    """What is compared: the object frame of a work object."""
    return f"Object frame of {name}"


def kind_of(name: str) -> str:
    """What is compared: who holds a tool or a work object."""
    return f"Holder of {name}"
