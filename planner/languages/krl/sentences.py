"""Sentences that KRL programs show operators."""

from typing import Final

from planner.claims.sentences import Sentence

KRL_AXIS_AWAY: Final = Sentence("{unit} is %1 {sign} off home, {home}: jog it there, reset")
"""Of a KUKA robot whose track or turntable is not at home before its first move."""
KRL_EARLIER: Final = Sentence("Does no program of an earlier run go on at the controller of arm {other}?")
WAITING: Final = Sentence("Waiting for arm {arm}.")
TOGETHER: Final = Sentence("Moves with arm {arm} and waits for it where they meet.")
"""On the panel of a KUKA controller while its program waits for the other arm, and moves together with it."""
NO_INPUT: Final = Sentence("No {signal} in {seconds:g} s: the program ends. Reset it.")
"""On the panel of a KUKA controller whose program waited for an input of its process in vain."""
FOOT: Final = Sentence("Arm {arm}: $ROBROOT is off zero by %1 mm, %2 deg")
"""Shown on a KUKA robot; its controller fills in the figures."""
FOOT_RIDES: Final = Sentence("Arm {arm}: $ROBROOT_C is off track by %1 mm, %2 deg")
"""Shown on a KUKA robot on a track; its controller fills in the figures."""
