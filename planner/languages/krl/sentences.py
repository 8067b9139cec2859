"""Sentences that KRL programs show to operators."""

from typing import Final

from planner.claims.sentences import Sentence

KRL_AXIS_NOT_HOME: Final = Sentence("{unit} is %1 {sign} off home, {home}: jog it there, reset")
"""Shown if a track or turntable of a KUKA robot is not at home before its first move."""
KRL_EARLIER: Final = Sentence("Does no program of an earlier run go on at the controller of arm {other}?")
"""Question before the start of programs on two controllers."""
WAITING_FOR_PARTNER: Final = Sentence("Waiting for arm {arm}.")
"""State on the panel of a KUKA controller while its program waits for the other arm."""
MOVING_WITH_PARTNER: Final = Sentence("Moves with arm {arm} and waits for it where they meet.")
"""State on the panel of a KUKA controller while its program moves together with the other arm."""
INPUT_TIMEOUT: Final = Sentence("No {signal} in {seconds:g} s: the program ends. Reset it.")
"""Shown if an input of the process did not arrive in time."""
ROBROOT_DEVIATION: Final = Sentence("Arm {arm}: $ROBROOT is off zero by %1 mm, %2 deg")
"""Shown if $ROBROOT of an arm is not zero; the controller fills in the values."""
ROBROOT_TRACK_DEVIATION: Final = Sentence("Arm {arm}: $ROBROOT_C is off track by %1 mm, %2 deg")
"""Shown if the foot of an arm is not where its track takes it; the controller fills in the values."""
