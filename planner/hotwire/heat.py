"""How hot a wire is, as an operation says it: by the slot's width, or by the power in a foam one knows."""

from __future__ import annotations

from typing import Annotated, Final

import numpy as np
from pydantic import Field, model_validator

from planner.claims import KerfCurve
from planner.hotwire import kerf
from planner.issues import Issue, TandemError
from planner.materials import Foam
from planner.schema import Strict
from planner.units import MM

SPEEDS: Final = (1e-3, 50e-3)
"""Speeds [m/s] of a kerf curve. A wire that hardly moves has no kerf of its own: it counts as 1 mm/s."""


class Heat(Strict):
    """How wide the wire melts: ``kerf_mm``, the same at every speed, or ``power_w`` over the wire's whole
    length, from which the slot follows by the local speed and the block's foam."""

    kerf_mm: Annotated[float, Field(ge=0, le=20, description="width of the slot")] | None = None
    power_w: Annotated[float, Field(gt=0, le=5000, description="over the wire's whole length")] | None = None
    kerf_range_mm: Annotated[
        tuple[Annotated[float, Field(gt=0, le=20)], Annotated[float, Field(gt=0, le=20)]],
        Field(description="slots that leave usable faces, where power_w is given"),
    ] = (kerf.DOMAIN[0] / MM, kerf.DOMAIN[1] / MM)

    @model_validator(mode="after")
    def _one_heat(self) -> Heat:
        if (self.kerf_mm is None) == (self.power_w is None):
            raise ValueError("give kerf_mm, the slot's width, or power_w, one of them")
        if self.kerf_range_mm[0] >= self.kerf_range_mm[1]:
            raise ValueError("kerf_range_mm is [lower, upper] with lower < upper")
        return self

    def kerf_curve(self, foam: Foam | None, diameter: float, length: float, thickness: float) -> KerfCurve:
        """Kerf over the local speed of a wire of ``diameter`` and heated ``length`` [m] in foam that is
        ``thickness`` [m] thick along it.

        Raises ``TandemError``: stock.foam_missing, kerf.no_data, kerf.input.
        """
        if self.kerf_mm is not None:
            return KerfCurve.constant(self.kerf_mm * MM)
        if self.power_w is None or foam is None:
            raise TandemError(
                Issue(
                    "stock.foam_missing",
                    "power_w is given, but the kerf depends on the block's foam, which is not named; name "
                    "stock.foam, or give kerf_mm instead",
                    field="stock.foam",
                )
            )
        wire = kerf.HotWire(diameter, length)
        return kerf.curve(foam, wire, self.power_w, thickness, np.array(SPEEDS))
