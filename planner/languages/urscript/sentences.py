"""Sentences that URScript programs show operators."""

from typing import Final

from planner.claims.sentences import Sentence

UR_EARLIER: Final = Sentence("Is the program of arm {other} stopped (not paused, no question open)?")
"""What the UR program that leads asks first."""
UR_CALLED: Final = Sentence("Does the panel of arm {other} say to start this program now?")
"""What the one that follows asks first."""
UR_START_PARTNER: Final = Sentence(
    "Start the program of arm {other} now. When its panel says that it is ready, press Continue here."
)
"""Shown on a UR controller, whose next popup asks whether the other arm is ready."""
PARTNER_LOST: Final = Sentence("The program of arm {other} does not run any more, so this one ends.")
"""On the panel of a UR controller that has seen the other one stop."""
STAYS_ON: Final = Sentence(
    "{signal} is on before the program: set it to low when not running in Installation, I/O."
)
"""On the panel of a UR controller whose running wire, or the output of a torch, stays high when a program
stops."""
NO_ARC: Final = Sentence("No {signal} in {seconds:g} s: the program ends. Begin it anew.")
"""On the panel of a UR controller whose program waited in vain for a torch to burn."""
ARC_LOST: Final = Sentence(
    "{signal} is off, no {ok_signal}, or the torch stood: the program ends. Move it out by hand."
)
"""On the panel of a UR controller whose torch does not burn any more, or stands."""
TORCH_STOOD: Final = Sentence("{signal} is off, or the torch stood: the program ends. Move it out by hand.")
"""Shown if a torch without an input went out or stood."""
OTHER_ARM: Final = Sentence("Arm {arm}: this controller moves another arm than the planned {model}.")
"""Of a UR robot, whose controller has its flange elsewhere at home than the plan."""
