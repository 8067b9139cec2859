"""Width of the slot that a hot wire melts in foam: forward, backward and as a table.

Two models: ``energy`` (the default, `kerf_energy`) and ``dissertation`` (`kerf_convection`). All functions
take arrays that broadcast, so that every point along a wire has its own speed. `docs/kerf.md` tells where
the figures come from and how far they are to be trusted.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Final, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import stdtrit

from planner import materials
from planner.claims import KerfCurve
from planner.hotwire import kerf_convection, kerf_cuts, kerf_energy
from planner.hotwire.kerf_flag import KerfFlag
from planner.hotwire.wire import Wire
from planner.issues import Issue, TandemError
from planner.materials import Foam, KerfFit
from planner.units import MM

DOMAIN: Final = (0.8e-3, 3.0e-3)
"""Kerfs [m] that leave usable faces: thinner the wire drags, wider it burns (dissertation, chapter 3)."""
SAME_THICKNESS: Final = 0.1
"""Foam and wire count as those of the tests up to this part of their thickness."""
CURVE_ERROR: Final = 1e-6
"""Largest error [m] of reading a curve linearly."""
CURVE_SPEEDS: Final = (0.5e-3, 50e-3)
"""Range [m/s] of a curve when no speeds are given."""

Model = Literal["energy", "dissertation"]
Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class HotWire:
    """What a kerf needs to know of a wire: ``diameter`` [m] and heated ``length`` [m], over which its power
    is spread evenly."""

    diameter: float
    length: float

    def __post_init__(self) -> None:
        for name in ("diameter", "length"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                text = f"{name} of the hot wire: got {value / MM:g} mm, allowed above 0"
                raise TandemError(Issue("kerf.input", text, field=name, hint=f"give the wire's {name}"))

    @staticmethod
    def of(wire: Wire, length: float) -> HotWire:
        """The wire over its heated length [m]; a strip counts by its thickness."""
        return HotWire(wire.thickness, length)


TEST_WIRE: Final = HotWire(kerf_cuts.TEST_DIAMETER, kerf_cuts.TEST_LENGTH)
"""The wire of the dissertation's test cuts."""


@dataclasses.dataclass(frozen=True)
class KerfEstimate:
    """Kerfs (...) of the inputs' common shape [m]: ``width`` expected, ``low`` to ``high`` for nine new cuts
    of ten, ``flag`` `KerfFlag` as uint8."""

    width: Array
    low: Array
    high: Array
    flag: NDArray[np.uint8]


def width(
    foam: str | Foam,
    wire: HotWire,
    power_w: ArrayLike,
    speed_m_s: ArrayLike,
    thickness_m: ArrayLike,
    model: Model = "energy",
) -> KerfEstimate:
    """Kerf of ``wire`` in ``foam`` (a built-in name or a value) at a power over the heated length [W], the
    speed across the wire [m/s] and the foam's thickness along the wire [m].

    The energy model's kerf is nowhere below the wire's diameter. Raises `TandemError`: kerf.unknown_foam,
    kerf.no_data, kerf.input, kerf.model.
    """
    data, fit = _foam(foam, model)
    power, speed, thickness = _numbers(power_w=power_w, speed_m_s=speed_m_s, thickness_m=thickness_m)
    if model == "energy":
        ideal = kerf_energy.ideal(data, power / wire.length, speed)
        middle, half = kerf_energy.width(fit, ideal), kerf_energy.margin(fit, ideal)
        low, high = (np.maximum(middle + s * half, wire.diameter) for s in (-1.0, 1.0))
        middle = np.maximum(middle, wire.diameter)
    else:
        middle = kerf_convection.width(data, wire.diameter, wire.length, power, speed, thickness)
        error, count = kerf_convection.spread(data.name)
        half = np.asarray(float(stdtrit(count, 0.5 + 0.5 * kerf_energy.LEVEL)) * error)
        low, high = middle - half, middle + half
    shape = np.broadcast_shapes(power.shape, speed.shape, thickness.shape)
    flag = np.broadcast_to(_flags(fit, wire, middle, power / wire.length, speed, thickness), shape)
    low, middle, high = (np.broadcast_to(values, shape) for values in (low, middle, high))
    return KerfEstimate(middle, low, high, flag)


def speed_for(
    foam: str | Foam,
    wire: HotWire,
    power_w: ArrayLike,
    width: ArrayLike,
    thickness_m: ArrayLike,
    model: Model = "energy",
) -> Array:
    """Speed [m/s] at which the expected kerf is ``width`` [m]; the inputs broadcast.

    `width` of this module then tells the interval and the doubts. Raises `TandemError` as `width` does, and
    kerf.impossible.
    """
    data, fit = _foam(foam, model)
    power, wanted, thickness = _numbers(power_w=power_w, width=width, thickness_m=thickness_m)
    _refuse_narrow(wanted, wire)
    if model == "dissertation":
        return kerf_convection.speed_for(data, wire.diameter, wire.length, power, wanted, thickness)
    ideal = _possible(kerf_energy.ideal_for(fit, wanted), wanted)
    shape = np.broadcast_shapes(power.shape, wanted.shape, thickness.shape)
    return np.array(np.broadcast_to(power / wire.length / (kerf_energy.heat(data) * ideal), shape))


def power_for(
    foam: str | Foam,
    wire: HotWire,
    speed_m_s: ArrayLike,
    width: ArrayLike,
    thickness_m: ArrayLike,
    model: Model = "energy",
) -> Array:
    """Power [W] over the wire's heated length at which the expected kerf is ``width`` [m] at a speed [m/s];
    the inputs broadcast. Raises as `speed_for` does."""
    data, fit = _foam(foam, model)
    speed, wanted, thickness = _numbers(speed_m_s=speed_m_s, width=width, thickness_m=thickness_m)
    _refuse_narrow(wanted, wire)
    shape = np.broadcast_shapes(speed.shape, wanted.shape, thickness.shape)
    if model == "energy":
        ideal = _possible(kerf_energy.ideal_for(fit, wanted), wanted)
        return np.array(np.broadcast_to(ideal * kerf_energy.heat(data) * speed * wire.length, shape))
    return kerf_convection.power_for(data, wire.diameter, wire.length, speed, wanted, thickness)


def curve(
    foam: str | Foam,
    wire: HotWire,
    power_w: float,
    thickness_m: float,
    speeds: ArrayLike | None = None,
    model: Model = "energy",
) -> KerfCurve:
    """Kerf over speed at one power and thickness, dense enough to be read linearly within 1 um.

    ``speeds`` [m/s] only bounds the table, from its lowest to its highest value; 0.5 to 50 mm/s without.
    Raises as `width` does.
    """
    (given,) = _numbers(speeds=CURVE_SPEEDS if speeds is None else speeds)
    first, last = float(given.min()), float(given.max())
    first, last = (first, last) if last > first else (first, first * (1.0 + 1e-6))

    def rows(table: Array) -> Array:
        got = width(foam, wire, power_w, table, thickness_m, model)
        return np.stack([got.width, got.low, got.high])

    table = _dense(rows, first, last)
    middle, low, high = rows(table)
    return KerfCurve(table, middle, low, high)


def _dense(rows: Callable[[Array], Array], first: float, last: float) -> Array:
    """Speeds that let every row be read linearly: spaced evenly in 1 / sqrt(speed), where a kerf ~ 1 / speed
    bends evenly, then halved where the middle of a step is still off."""
    table = np.linspace(first**-0.5, last**-0.5, 65) ** -2.0
    table[0], table[-1] = first, last
    while True:
        middle = 0.5 * (table[:-1] + table[1:])
        ends = rows(table)
        off = np.abs(rows(middle) - 0.5 * (ends[:, :-1] + ends[:, 1:])).max(axis=0)
        coarse = off > 0.5 * CURVE_ERROR
        if not np.any(coarse):
            return table
        table = np.sort(np.concatenate([table, middle[coarse]]))


def _flags(
    fit: KerfFit, wire: HotWire, kerf: Array, power_per_length: Array, speed: Array, thickness: Array
) -> NDArray[np.uint8]:
    hot = kerf > DOMAIN[1]
    if fit.burnt_speed is not None:
        hot = hot | (speed <= fit.burnt_speed)
    cold = kerf < DOMAIN[0]
    away = np.abs(thickness - fit.thickness) > SAME_THICKNESS * fit.thickness
    slack = 1e-6  # for figures that were converted from mm and W
    untested = _outside(power_per_length, fit.power_per_length, slack) | _outside(speed, fit.speed, slack)
    other = abs(wire.diameter - fit.wire_diameter) > SAME_THICKNESS * fit.wire_diameter
    named = (
        (KerfFlag.TOO_HOT, hot),
        (KerfFlag.TOO_COLD, cold),
        (KerfFlag.THICKNESS, away),
        (KerfFlag.UNTESTED, untested),
        (KerfFlag.OTHER_WIRE, np.asarray(other)),
    )
    total: NDArray[np.uint8] = np.zeros((), np.uint8)
    for flag, where in named:
        total = total | np.where(where, np.uint8(flag.value), np.uint8(0))
    return np.asarray(total, np.uint8)


def _outside(values: Array, bounds: tuple[float, float], slack: float) -> NDArray[np.bool_]:
    return (values < bounds[0] * (1.0 - slack)) | (values > bounds[1] * (1.0 + slack))


def _foam(foam: str | Foam, model: str) -> tuple[Foam, KerfFit]:
    data = materials.foam(foam) if isinstance(foam, str) else foam
    if model not in get_args(Model):
        text = f"kerf model: got {model!r}, allowed {', '.join(get_args(Model))}"
        raise TandemError(
            Issue("kerf.model", text, field="model", hint="take energy, which is the better one")
        )
    if data.kerf is None or data.specific_heat is None or data.melt_temperature is None:
        known = ", ".join(sorted(name for name, one in materials.foams().items() if one.kerf is not None))
        text = f"kerf in {data.name}: got no test cuts of this foam, allowed {known} or a foam of your own"
        hint = "cut the four squares of problems/kerf_test and run: tandem kerf fit tests.csv"
        raise TandemError(Issue("kerf.no_data", text, field="foam", hint=hint))
    tested = data.name in kerf_cuts.dissertation_tables()
    if model == "dissertation" and (data.wire_rise is None or data.radiation is None or not tested):
        text = f"kerf in {data.name} by the dissertation's form: got no wire temperatures for this foam"
        raise TandemError(Issue("kerf.no_data", text, field="foam", hint="take model energy"))
    return data, data.kerf


def _numbers(**inputs: ArrayLike) -> tuple[Array, ...]:
    """The inputs as arrays of one common shape each, refused unless all values are positive numbers."""
    arrays = {name: np.asarray(value, np.float64) for name, value in inputs.items()}
    issues = []
    for name, values in arrays.items():
        wrong = ~(np.isfinite(values) & (values > 0.0))
        if np.any(wrong) or values.size == 0:
            bad = float(values[wrong].flat[0]) if values.size else float("nan")
            text = (
                f"{name}: got {bad:g} ({int(wrong.sum())} of {values.size}), allowed finite numbers above 0"
            )
            hint = "a point of the wire that stands still has no kerf: leave it out, or give its true speed"
            issues.append(
                Issue("kerf.input", text, field=name, hint=hint if "speed" in name else "correct it")
            )
    if issues:
        raise TandemError(issues)
    try:
        np.broadcast_shapes(*(values.shape for values in arrays.values()))
    except ValueError as error:
        shapes = ", ".join(f"{name} {values.shape}" for name, values in arrays.items())
        text = f"shapes of the inputs: got {shapes}, allowed shapes that broadcast"
        raise TandemError(Issue("kerf.input", text, hint="give one value, or as many of each")) from error
    return tuple(arrays.values())


def _refuse_narrow(wanted: Array, wire: HotWire) -> None:
    narrowest = float(wanted.min())
    if narrowest <= wire.diameter:
        least = wire.diameter / MM
        text = f"wanted kerf: got {narrowest / MM:.3f} mm, allowed above the wire's own {least:.3f} mm"
        raise TandemError(
            Issue(
                "kerf.impossible",
                text,
                value=narrowest / MM,
                limit=least,
                unit="mm",
                hint=f"ask for {DOMAIN[0] / MM:g} to {DOMAIN[1] / MM:g} mm, or take a thinner wire",
            )
        )


def _possible(ideal: Array, wanted: Array) -> Array:
    if np.any(ideal <= 0.0):
        least = float(wanted[ideal <= 0.0].max())
        text = f"wanted kerf: got {least / MM:.3f} mm, which this foam's fit gives at no speed or power"
        hint = "ask for a wider kerf"
        raise TandemError(Issue("kerf.impossible", text, value=least / MM, unit="mm", hint=hint))
    return ideal
