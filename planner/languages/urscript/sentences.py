"""Sentences that URScript programs show to operators."""

from typing import Final

from planner.claims.sentences import Sentence

UR_EARLIER: Final = Sentence("Is the program of arm {other} stopped (not paused, no question open)?")
"""First question of the leading UR program."""
UR_CALLED: Final = Sentence("Does the panel of arm {other} say to start this program now?")
"""First question of the following UR program."""
UR_START_PARTNER: Final = Sentence(
    "Start the program of arm {other} now. When its panel says that it is ready, press Continue here."
)
"""Shown on the leading UR controller before it asks whether the other arm is ready."""
PARTNER_LOST: Final = Sentence("The program of arm {other} does not run any more, so this one ends.")
"""Shown on a UR controller that has seen the other one stop."""
STAYS_ON: Final = Sentence(
    "{signal} is on before the program: set it to low when not running in Installation, I/O."
)
"""Shown on a UR controller whose running wire or torch output is high before a program runs."""
NO_ARC: Final = Sentence("No {signal} in {seconds:g} s: the program ends. Begin it anew.")
"""Shown on a UR controller whose program waited in vain for a torch to burn."""
ARC_LOST: Final = Sentence(
    "{signal} is off, no {ok_signal}, or the torch stood: the program ends. Move it out by hand."
)
"""Shown on a UR controller whose torch no longer burns, or stands still."""
TORCH_STOOD: Final = Sentence("{signal} is off, or the torch stood: the program ends. Move it out by hand.")
"""Shown if a torch without an input went out or stood still."""
OTHER_ARM: Final = Sentence("Arm {arm}: this controller moves another arm than the planned {model}.")
"""Shown if the controller has the flange at home elsewhere than planned."""
