"""Width of the slot that a hot wire melts in foam: forward, backward and as a table.

Models (`models`): ``energy`` (the default), ``general`` for foams without test cuts, ``measured``
for cuts like the tests' and ``dissertation`` for traceability; `MODEL_FORMS` has them by name, with what
each needs to know of a foam. `KerfFlag` is what is to be said against a kerf that a model gives.
All functions take arrays that broadcast, so that every point along a wire has its own speed.
`docs/kerf.md` tells where the figures come from and how far they are to be trusted.
"""

import dataclasses
import enum
from collections.abc import Callable
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner.catalogue import materials
from planner.catalogue.materials import Foam
from planner.geometry.arrays import BoolArray, FloatArray
from planner.geometry.units import MM
from planner.issues import Issue, TandemError, refusal
from planner.processes.hotwire.claims import KerfCurve
from planner.processes.hotwire.plan.kerf import models, test_cuts
from planner.processes.hotwire.plan.kerf.models import refuse_melting
from planner.processes.hotwire.plan.kerf.test_cuts import TEST_WIRE, HotWire

Model = Literal["energy", "general", "measured", "dissertation"]


def _no_inverse(
    foam: Foam, wire: HotWire, given: FloatArray, wanted: FloatArray, thickness: FloatArray
) -> FloatArray:
    raise ValueError("this model has no inverse")


@dataclasses.dataclass(frozen=True)
class Form:
    """A model: ``needs`` names fields of `Foam`, ``tables`` asks for a foam of the dissertation's."""

    width: Callable[
        [Foam, HotWire, FloatArray, FloatArray, FloatArray], tuple[FloatArray, FloatArray, FloatArray]
    ]
    speed_for: Callable[[Foam, HotWire, FloatArray, FloatArray, FloatArray], FloatArray]
    power_for: Callable[[Foam, HotWire, FloatArray, FloatArray, FloatArray], FloatArray]
    needs: tuple[str, ...]
    tables: bool = False


_HEAT_FIGURES: Final = ("specific_heat", "melt_temperature")
"""Figures of a foam that the heat balance needs."""
FIGURE_NAMES: Final = {
    "specific_heat": "specific heat",
    "melt_temperature": "melting temperature",
    "kerf": "test cuts",
    "radiation": "share of radiation",
    "wire_rise": "wire temperatures",
}
"""The figures of a foam in words."""
MODEL_FORMS: Final[dict[str, Form]] = {
    "energy": Form(models.energy_width, models.energy_speed, models.energy_power, ("kerf", *_HEAT_FIGURES)),
    "general": Form(
        models.general_width, models.general_speed, models.general_power, (*_HEAT_FIGURES, "conductivity")
    ),
    "measured": Form(models.measured_width, _no_inverse, _no_inverse, ("kerf", *_HEAT_FIGURES), tables=True),
    "dissertation": Form(
        models.convection_estimate,
        models.convection_speed,
        models.convection_power,
        (*_HEAT_FIGURES, "radiation", "wire_rise"),
        tables=True,
    ),
}
"""The models by name."""


def choose_model(foam: str | Foam, model: str, backward: bool = False) -> tuple[Foam, Form]:
    """The foam's data and the model's functions; refuses what the model lacks."""
    if model not in MODEL_FORMS:
        text = f"kerf model: got {model!r}, allowed {', '.join(MODEL_FORMS)}"
        raise refusal("kerf.model", text, field="model", hint="take energy")
    data, form = materials.foam(foam) if isinstance(foam, str) else foam, MODEL_FORMS[model]
    missing = [name for name in form.needs if getattr(data, name) is None]
    if form.tables and data.name not in test_cuts.dissertation_tables():
        missing.append("cells in the dissertation's tables")
    if missing:
        known = ", ".join(sorted(name for name, one in materials.foams().items() if one.kerf is not None))
        lacks = " and ".join(FIGURE_NAMES.get(name, name) for name in missing)
        text = f"kerf in {data.name} by model {model}: got no {lacks}, allowed {known} or a foam of your own"
        hint = "cut the four squares of problems/kerf_test and run: tandem kerf fit tests.csv"
        raise refusal("kerf.no_data", text, field="foam", hint=hint)
    if backward and form.speed_for is _no_inverse:
        text = f"kerf model for a wanted kerf: got {model}, whose kerf rises and falls with speed"
        raise refusal("kerf.model", text, field="model", hint="take energy")
    return data, form


USABLE_KERFS: Final = (0.8e-3, 3.0e-3)
"""Kerfs [m] that leave usable faces: thinner the wire drags, wider it burns (dissertation, chapter 3)."""


class KerfFlag(enum.IntFlag):
    """Doubts about one estimate; 0 is none. Arrays of flags are uint8."""

    OK = 0
    TOO_HOT = 1
    TOO_COLD = 2
    THICKNESS = 4
    UNTESTED = 8
    OTHER_WIRE = 16


FLAG_TEXTS: Final[dict[KerfFlag, str]] = {
    KerfFlag.TOO_HOT: "too hot: burnt, concave faces; cut faster or with less power",
    KerfFlag.TOO_COLD: "too cold: the wire drags and rounds corners; cut slower or with more power",
    KerfFlag.THICKNESS: "the foam is thicker or thinner than in the tests",
    KerfFlag.UNTESTED: "power per length or speed is outside the tests",
    KerfFlag.OTHER_WIRE: "the wire is not as thick as in the tests",
}
"""What each flag says to people."""


def explain(flag: int) -> tuple[str, ...]:
    """What each doubt in ``flag`` means, in words; none for 0."""
    return tuple(text for bit, text in FLAG_TEXTS.items() if flag & bit)


__all__ = [
    "TEST_WIRE",
    "USABLE_KERFS",
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

SAME_THICKNESS_SHARE: Final = 0.1
"""Foam and wire count as those of the tests up to this part of their thickness."""
CURVE_ERROR: Final = 1e-6
"""Largest error [m] of reading a curve linearly."""
MOST_CURVE_POINTS: Final = 50_000
"""Points of a curve at most: a kerf that cannot be read linearly with these is none."""
CURVE_SPEEDS: Final = (0.5e-3, 50e-3)
"""Range [m/s] of a curve when no speeds are given."""

DISSERTATION_TESTS: Final = materials.KerfTests((35.7 / 0.43, 54.9 / 0.43), (2e-3, 10e-3), 0.05, 0.0004)
"""What a foam without test cuts of its own is held against."""


@dataclasses.dataclass(frozen=True)
class KerfEstimate:
    """Kerfs (...) of the inputs' common shape [m]: ``width`` expected, ``low`` to ``high`` for nine new cuts
    of ten, ``flag`` `KerfFlag` as uint8."""

    width: FloatArray
    low: FloatArray
    high: FloatArray
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
    data, form = choose_model(foam, model)
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
) -> FloatArray:
    """Speed [m/s] at which the expected kerf is ``width`` [m]; the inputs broadcast.

    `width` of this module then tells the interval and the doubts. Raises `TandemError` as `width` does, and
    kerf.impossible.
    """
    data, form = choose_model(foam, model, backward=True)
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
) -> FloatArray:
    """Power [W] over the wire's heated length at which the expected kerf is ``width`` [m] at a speed [m/s];
    the inputs broadcast. Raises as `speed_for` does."""
    data, form = choose_model(foam, model, backward=True)
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

    def rows(table: FloatArray) -> FloatArray:
        got = width(foam, wire, power_w, table, thickness_m, model)
        return np.stack([got.width, got.low, got.high])

    table = _dense(rows, first, last)
    middle, low, high = rows(table)
    return KerfCurve(table, middle, low, high)


def _dense(rows: Callable[[FloatArray], FloatArray], first: float, last: float) -> FloatArray:
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
        if len(table) > MOST_CURVE_POINTS:
            text = f"kerf curve: got {len(table)} speeds and still not read linearly within 1 um"
            hint = "begin at a higher speed, or take less power"
            raise refusal("kerf.input", text, field="speeds", hint=hint)
        table = np.sort(np.concatenate([table, middle[coarse]]))


def _flags(
    foam: Foam,
    wire: HotWire,
    kerf: FloatArray,
    power_per_length: FloatArray,
    speed: FloatArray,
    thickness: FloatArray,
) -> NDArray[np.uint8]:
    tests = DISSERTATION_TESTS if foam.kerf is None else foam.kerf.tests
    hot = kerf > USABLE_KERFS[1]
    if tests.burnt_speed is not None:
        hot = hot | (speed <= tests.burnt_speed)
    untested = _outside(power_per_length, tests.power_per_length) | _outside(speed, tests.speed)
    named = (
        (KerfFlag.TOO_HOT, hot),
        (KerfFlag.TOO_COLD, kerf < USABLE_KERFS[0]),
        (KerfFlag.THICKNESS, abs(thickness - tests.thickness) > SAME_THICKNESS_SHARE * tests.thickness),
        (KerfFlag.UNTESTED, untested | (foam.kerf is None)),
        (
            KerfFlag.OTHER_WIRE,
            abs(wire.diameter - tests.wire_diameter) > SAME_THICKNESS_SHARE * tests.wire_diameter,
        ),
    )
    total: NDArray[np.uint8] = np.zeros((), np.uint8)
    for flag, where in named:
        total = total | np.where(where, np.uint8(flag.value), np.uint8(0))
    return np.asarray(total, np.uint8)


def _outside(values: FloatArray, bounds: tuple[float, float]) -> BoolArray:
    slack = 1e-6  # for figures that were converted from mm and W
    return (values < bounds[0] * (1.0 - slack)) | (values > bounds[1] * (1.0 + slack))


def _numbers(**inputs: ArrayLike) -> tuple[FloatArray, ...]:
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
        raise refusal("kerf.input", text, hint="give one value, or as many of each") from error
    return tuple(arrays.values())


def _refuse_narrow(wanted: FloatArray, wire: HotWire) -> None:
    narrowest, least = float(wanted.min()) / MM, wire.diameter / MM
    if narrowest <= least:
        text = f"wanted kerf: got {narrowest:.3f} mm, allowed above the wire's own {least:.3f} mm"
        hint = f"ask for {USABLE_KERFS[0] / MM:g} to {USABLE_KERFS[1] / MM:g} mm, or take a thinner wire"
        raise refusal("kerf.impossible", text, value=narrowest, limit=least, unit="mm", hint=hint)


def _possible(found: FloatArray, given: FloatArray, wanted: FloatArray, thickness: FloatArray) -> FloatArray:
    """What a backward model found, in the inputs' common shape; refuses what is not a positive number."""
    shape = np.broadcast_shapes(given.shape, wanted.shape, thickness.shape)
    found, asked = (np.array(np.broadcast_to(values, shape)) for values in (found, wanted))
    wrong = ~(np.isfinite(found) & (found > 0.0))
    if np.any(wrong):
        least = float(asked[wrong].flat[0]) / MM
        text = f"wanted kerf: got {least:.3f} mm"
        text += f" ({int(wrong.sum())} of {wrong.size}), which no speed or power gives"
        hint = (
            f"ask for {USABLE_KERFS[0] / MM:g} to {USABLE_KERFS[1] / MM:g} mm, with more power or at "
            "another speed"
        )
        raise refusal("kerf.impossible", text, value=least, unit="mm", hint=hint)
    return found
