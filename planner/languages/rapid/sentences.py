"""Sentences that RAPID programs show operators."""

from typing import Final

from planner.claims.sentences import Sentence

BUTTONS: Final = ("Free", "On", "Stop")
"""Answers to :func:`again`: nothing stands in the way of what follows; power is on again; neither."""
OFF_BY_MM: Final = "is off by [mm]"
OFF_BY_DEGREES: Final = "and turned by [degrees]"
OFF_HOME: Final = "is off its home by"
"""What a track or turntable is; its figure, in mm or degrees, follows."""
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


BEGIN_BUTTONS: Final = ("Begin", "Stop")
"""Answers to :func:`burned`: from main, with a sheet without these slots; or nothing."""
ENDED: Final = (
    "Not started: a torch burned at the stop",
    "or the controller was off. Move it out",
    "by hand, look at the sheet, then PP to",
    "main in all tasks, and Start.",
)
"""Told where a program would go on behind a stop at which a torch burned."""


def burned(signal: str) -> tuple[str, ...]:
    """The question at a start anew behind a stop at which the torch of ``signal`` burned."""
    return (
        f"{signal} burned at the stop,",
        "or the controller was off since.",
        "Begin: PP is at main, the torch was moved out by hand,",
        "and the sheet has no slot of this program yet.",
        "Stop: else. Then plan anew what is left to cut.",
    )


BASE_OF: Final = Sentence("Base of arm {arm}")
FRAME_OF: Final = Sentence("Frame of {name}")
USER_FRAME_OF: Final = Sentence("User frame of {name}")
OBJECT_FRAME_OF: Final = Sentence("Object frame of {name}")
HOLDER_OF: Final = Sentence("Holder of {name}")
AXIS_OF: Final = Sentence("Axis {unit}")
"""What is compared: frames, who holds a tool or a work object, and where a track or turntable stands."""
