"""Power, feed and slot of a hot wire in foam: the values of ``tandem kerf``, here by its formula.

kerf = chi (P / L) / (rho Cp (Tp - Ta) V) - c, the energy balance of docs/kerf.md; constants of its table.
"""

from __future__ import annotations

from typing import Final

from bench.corpus.job import Draft, Draw, Fault

FOAMS: Final = {
    # chi, c [mm], density [kg/m^3], specific heat [J/(kg K)]
    "xps_30": (0.90837, 0.15928, 30.0, 1500.0),
    "eps_a120": (1.1034, 0.66407, 22.0, 1450.0),
    "eps_af_plus": (1.1276, 0.40026, 14.0, 1450.0),
}
RISE: Final = 260.0
"""Temperature difference [K] from the room to melting."""


def power(foam: str, feed: float, kerf: float, wire: float) -> float:
    """Power [W] for a kerf [mm] at a feed [mm/s] of a wire [mm]."""
    chi, offset, density, heat = FOAMS[foam]
    ideal = (kerf + offset) / chi
    return float(round(ideal * density * heat * RISE * feed * wire * 1e-9))


def settle(draft: Draft, draw: Draw, wire: float, kerf: tuple[float, float] = (1.2, 1.6)) -> None:
    """Choose foam, feed and power of the first operation for a slot within a range [mm]."""
    foam, feed = draw.pick(["xps_30", "eps_a120", "eps_a120"]), draw.pick([5, 6, 6, 7])
    expected = draw.number(*kerf, 2)
    draft.problem["stock"]["foam"] = foam
    draft.operation.update(
        power_w=power(foam, feed, expected, wire), feed_mm_s=feed, feed_min_mm_s=round(0.5 * feed, 1)
    )
    draft.facts.update(foam=foam, feed=feed, kerf=expected, wire=wire)


def _powered(kerf: float) -> Fault:
    def spoil(draft: Draft, draw: Draw) -> None:
        own = draft.operation
        feed = own["feed_mm_s"]
        own["feed_min_mm_s"] = round(0.9 * feed, 1)  # no slower or faster way out
        own["power_w"] = power(draft.facts["foam"], feed, kerf, draft.facts["wire"])

    hot = kerf > 2.0
    return Fault(
        f"the power gives a slot of {kerf:g} mm at the full feed, which is beyond 0.8 to 3 mm",
        ("kerf.too_hot",) if hot else ("kerf.too_cold",),
        spoil,
    )


def _foam(draft: Draft, draw: Draw) -> None:
    draft.problem["stock"]["foam"] = draw.pick(["eps", "xps"])


TOO_HOT: Final = _powered(5.0)
TOO_COLD: Final = _powered(0.35)
NO_DATA: Final = Fault("nobody has made test cuts in this foam", ("kerf.no_data",), _foam)


def _move_block_away(draft: Draft, draw: Draw) -> None:
    key = "sheet" if "sheet" in draft.problem else "stock"
    draft.problem[key].pop("roll_pitch_deg", None)
    draft.problem[key].pop("support", None)
    if key == "stock" and "held_by" not in draft.problem[key]:
        draft.problem[key]["support"] = "pedestal"  # it is far away, and hangs nowhere
    draft.problem[key]["place"] = {"xyz_mm": [0, draw.pick([4500, 6000, -5200]), 500]}


UNREACHABLE: Final = Fault(
    "the block stands metres away from all arms", ("motion.no_reach",), _move_block_away
)
