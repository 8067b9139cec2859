"""Width of the slot that a hot wire melts in foam: forward, backward and as a table.

Models: ``energy`` (the default, `kerf_energy`), ``general`` for foams without test cuts (`kerf_general`),
``measured`` for cuts like the tests' (`kerf_measured`) and ``dissertation`` for traceability
(`kerf_convection`). All functions take arrays that broadcast, so that every point along a wire has its own
speed. `docs/kerf.md` tells where the figures come from and how far they are to be trusted.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner import materials
from planner.claims import KerfCurve
from planner.hotwire.kerf_flag import DOMAIN, KerfFlag, explain
from planner.hotwire.kerf_forms import Model, choose
from planner.hotwire.kerf_limit import refuse_melting
from planner.hotwire.kerf_wire import TEST_WIRE, HotWire
from planner.issues import Issue, TandemError
from planner.materials import Foam
from planner.units import MM

__all__ = [
    "DOMAIN",
    "TEST_WIRE",
    "HotWire",
    "KerfEstimate",
    "KerfFlag",
    "Model",
    "curve",
    "explain",
    "power_for",
    "speed_for",
    "width",
]

SAME_THICKNESS: Final = 0.1
"""Foam and wire count as those of the tests up to this part of their thickness."""
CURVE_ERROR: Final = 1e-6
"""Largest error [m] of reading a curve linearly."""
MOST_SPEEDS: Final = 50_000
CURVE_SPEEDS: Final = (0.5e-3, 50e-3)
"""Range [m/s] of a curve when no speeds are given."""

DISSERTATION_TESTS: Final = materials.KerfTests((35.7 / 0.43, 54.9 / 0.43), (2e-3, 10e-3), 0.05, 0.0004)
"""What a foam without test cuts of its own is held against."""

Array = NDArray[np.float64]


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

    But for the dissertation's form, no kerf is below the wire's diameter. Raises `TandemError`:
    kerf.unknown_foam, kerf.no_data, kerf.input, kerf.model, kerf.melts.
    """
    data, form = choose(foam, model)
    power, speed, thickness = _numbers(power_w=power_w, speed_m_s=speed_m_s, thickness_m=thickness_m)
    refuse_melting(data, wire, float(power.max()))
    middle, low, high = form.width(data, wire, power, speed, thickness)
    shape = np.broadcast_shapes(power.shape, speed.shape, thickness.shape)
    flag = np.broadcast_to(_flags(data, wire, middle, power / wire.length, speed, thickness), shape)
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
    data, form = choose(foam, model, backward=True)
    power, wanted, thickness = _numbers(power_w=power_w, width=width, thickness_m=thickness_m)
    _refuse_narrow(wanted, wire)
    refuse_melting(data, wire, float(power.max()))
    return _possible(form.speed_for(data, wire, power, wanted, thickness), power, wanted, thickness)


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
    data, form = choose(foam, model, backward=True)
    speed, wanted, thickness = _numbers(speed_m_s=speed_m_s, width=width, thickness_m=thickness_m)
    _refuse_narrow(wanted, wire)
    found = _possible(form.power_for(data, wire, speed, wanted, thickness), speed, wanted, thickness)
    refuse_melting(data, wire, float(found.max()))
    return found


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
    Raises as `width` does, also where that takes more than 50 000 speeds.
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
        if len(table) > MOST_SPEEDS:
            text = f"kerf curve: got {len(table)} speeds and still not read linearly within 1 um"
            hint = "begin at a higher speed, or take less power"
            raise TandemError(Issue("kerf.input", text, field="speeds", hint=hint))
        table = np.sort(np.concatenate([table, middle[coarse]]))


def _flags(
    foam: Foam, wire: HotWire, kerf: Array, power_per_length: Array, speed: Array, thickness: Array
) -> NDArray[np.uint8]:
    tests = DISSERTATION_TESTS if foam.kerf is None else foam.kerf.tests
    hot = kerf > DOMAIN[1]
    if tests.burnt_speed is not None:
        hot = hot | (speed <= tests.burnt_speed)
    untested = _outside(power_per_length, tests.power_per_length) | _outside(speed, tests.speed)
    named = (
        (KerfFlag.TOO_HOT, hot),
        (KerfFlag.TOO_COLD, kerf < DOMAIN[0]),
        (KerfFlag.THICKNESS, abs(thickness - tests.thickness) > SAME_THICKNESS * tests.thickness),
        (KerfFlag.UNTESTED, untested | (foam.kerf is None)),
        (
            KerfFlag.OTHER_WIRE,
            abs(wire.diameter - tests.wire_diameter) > SAME_THICKNESS * tests.wire_diameter,
        ),
    )
    total: NDArray[np.uint8] = np.zeros((), np.uint8)
    for flag, where in named:
        total = total | np.where(where, np.uint8(flag.value), np.uint8(0))
    return np.asarray(total, np.uint8)


def _outside(values: Array, bounds: tuple[float, float]) -> NDArray[np.bool_]:
    slack = 1e-6  # for figures that were converted from mm and W
    return (values < bounds[0] * (1.0 - slack)) | (values > bounds[1] * (1.0 + slack))


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
    narrowest, least = float(wanted.min()) / MM, wire.diameter / MM
    if narrowest <= least:
        text = f"wanted kerf: got {narrowest:.3f} mm, allowed above the wire's own {least:.3f} mm"
        hint = f"ask for {DOMAIN[0] / MM:g} to {DOMAIN[1] / MM:g} mm, or take a thinner wire"
        raise TandemError(Issue("kerf.impossible", text, value=narrowest, limit=least, unit="mm", hint=hint))


def _possible(found: Array, given: Array, wanted: Array, thickness: Array) -> Array:
    """What a backward model found, in the inputs' common shape; refuses what is not a positive number."""
    shape = np.broadcast_shapes(given.shape, wanted.shape, thickness.shape)
    found, asked = (np.array(np.broadcast_to(values, shape)) for values in (found, wanted))
    wrong = ~(np.isfinite(found) & (found > 0.0))
    if np.any(wrong):
        least = float(asked[wrong].flat[0]) / MM
        text = f"wanted kerf: got {least:.3f} mm"
        text += f" ({int(wrong.sum())} of {wrong.size}), which no speed or power gives"
        hint = f"ask for {DOMAIN[0] / MM:g} to {DOMAIN[1] / MM:g} mm, with more power or at another speed"
        raise TandemError(Issue("kerf.impossible", text, value=least, unit="mm", hint=hint))
    return found
