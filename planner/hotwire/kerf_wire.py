"""What a kerf needs to know of a wire."""

from __future__ import annotations

import dataclasses
import math
from typing import Final

from planner.hotwire import kerf_cuts
from planner.hotwire.wire import Wire
from planner.issues import Issue, TandemError
from planner.units import MM


@dataclasses.dataclass(frozen=True)
class HotWire:
    """A wire of a ``diameter`` [m] and a heated ``length`` [m], over which its power is spread evenly.

    Raises `TandemError` (kerf.input) unless both are finite and above 0.
    """

    diameter: float
    length: float

    def __post_init__(self) -> None:
        for name in ("diameter", "length"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                text = f"{name} of the hot wire: got {value / MM:g} mm, allowed above 0"
                raise TandemError(Issue("kerf.input", text, field=name, hint=f"give the wire's {name}"))

    @staticmethod
    def of(wire: Wire, length: float) -> HotWire:
        """The wire over its heated length [m]; a strip counts by its thickness."""
        return HotWire(wire.thickness, length)


TEST_WIRE: Final = HotWire(kerf_cuts.TEST_DIAMETER, kerf_cuts.TEST_LENGTH)
"""The wire of the dissertation's test cuts."""
