"""Sentences that RAPID programs show to operators."""

from typing import Final

from planner.claims.sentences import Sentence

RESTART_BUTTONS: Final = ("Free", "On", "Stop")
"""Answers to :func:`restart_question`: nothing blocks the next moves; the power is on again; neither."""
POSITION_DEVIATION: Final = "deviates by [mm]"
"""Deviation of a frame of the controller from the plan; the distance in mm follows."""
ROTATION_DEVIATION: Final = "and is rotated by [degrees]"
"""Second line of this deviation; the angle in degrees follows."""
HOME_DEVIATION: Final = "deviates from its home by"
"""Deviation of a track or turntable from its home; the value in mm or degrees follows."""
DIFFERS_FROM_PLAN: Final = "differs from the plan."
MOTION_BLOCKED: Final = ("No arm moves. Correct the cell,", "then PP to main in all tasks.")
"""Last lines of the cell check after a deviation; the program stays stopped."""
RESTART_REFUSED: Final = (
    "Not started: the power was on at the",
    "stop. Free the wire or tool, then",
    "PP to main in all tasks.",
)
"""Shown after the answer Stop to :func:`restart_question`."""


def restart_question(signal: str) -> tuple[str, ...]:
    """Return the question at a start after a stop at which the power output ``signal`` was on."""
    return (
        f"{signal} was on at the stop.",
        "Free: stock and part block none of the next moves.",
        f"On: {signal} is 1 again by hand,",
        "and the wire is hot, or the tool at full speed.",
        "Stop: neither. Free it, then PP to main in all tasks.",
    )


TORCH_RESTART_BUTTONS: Final = ("Begin", "Stop")
"""Answers to :func:`torch_restart_question`: start from main with a sheet without these slots; stop."""
TORCH_RESTART_REFUSED: Final = (
    "Not started: a torch burned at the stop",
    "or the controller was off. Move it out",
    "by hand, inspect the sheet, then PP to",
    "main in all tasks, and Start.",
)
"""Shown if a program is resumed after a stop at which a torch burned."""


def torch_restart_question(signal: str) -> tuple[str, ...]:
    """Return the question at a start from main after a stop at which the torch of ``signal`` burned."""
    return (
        f"{signal} burned at the stop,",
        "or the controller has been off since.",
        "Begin: PP is at main, the torch was moved out by hand,",
        "and the sheet has no slot of this program yet.",
        "Stop: otherwise. Then replan what is left to cut.",
    )


BASE_OF: Final = Sentence("Base of arm {arm}")
FRAME_OF: Final = Sentence("Frame of {name}")
USER_FRAME_OF: Final = Sentence("User frame of {name}")
OBJECT_FRAME_OF: Final = Sentence("Object frame of {name}")
HOLDER_OF: Final = Sentence("Holder of {name}")
AXIS_OF: Final = Sentence("Axis {unit}")
"""Compared item: a frame, the holder of a tool or work object, or the position of a track or turntable."""
