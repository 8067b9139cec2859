"""What to do where a plan breaks a rule of the proof and the rule itself knows nothing better."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Final

from planner.issues import Issue

_PLACE: Final = "move or turn the stock, and plan again"
_SLOWER: Final = "lower the feed there, or round the corner by more targets, and plan again"

REMEDIES: Final[Mapping[str, str]] = {
    "verify.reach": _PLACE,
    "verify.joint_limits": f"{_PLACE}; settings.joint_margin_deg says how far arms keep off",
    "verify.singularity": f"{_PLACE}; settings.singularity_margin_deg says how far arms keep off",
    "verify.joint_speed": _SLOWER,
    "verify.joint_acceleration": _SLOWER,
    "verify.tcp_speed": "lower the feed, and plan again; settings.tcp_speed_mm_s is the most allowed",
    "verify.clearance": "move what is in the way, or the stock, and plan again",
    "verify.wire_clearance": "move what is in the wire's way, and plan again",
    "verify.rod_limits": "take a longer or thinner wire, and plan again",
    "verify.gouge": "take a smaller forming tool or round the part more, and plan again",
    "verify.sheet": "take a slimmer tool, another order, or let it lean (lean_deg), and plan again",
    "verify.gap": "put targets nearer to each other (tangent_deg, chord_mm), and plan again",
    "verify.adsif": "put targets nearer to each other (tangent_deg, chord_mm), and plan again",
    "verify.mill_gouge": "take a smaller or slimmer cutter or tilt its axis, and plan again",
    "verify.milled": "take a smaller cutter or finer steps, and plan again",
    "verify.mill_feed": "lower the feed, and plan again",
}
"""What to do, by code. Programs that were changed by hand are best written anew."""


def told(issue: Issue) -> Issue:
    """The issue with what to do, where it does not say so itself."""
    hint = REMEDIES.get(issue.code)
    return issue if issue.hint or hint is None else dataclasses.replace(issue, hint=hint)
