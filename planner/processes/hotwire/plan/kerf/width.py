"""Width of the slot that a hot wire melts in foam: forward, inverse and as a table.

Models (`models`): ``energy`` (the default), ``general`` for foams without test cuts, ``measured`` for cuts
like those of the tests, ``dissertation`` for traceability. `KERF_MODELS` lists them with the foam data that
they need. `KerfFlag` lists reasons to doubt a kerf. All functions take arrays that broadcast, so every point
along a wire has its own speed. `docs/kerf.md` states where the data come from and how reliable they are.
"""

import dataclasses
import enum
from collections.abc import Callable
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner.catalogue import materials
from planner.catalogue.materials import FoamMaterial
from planner.geometry.arrays import BoolArray, FloatArray
from planner.geometry.units import MM
from planner.issues import Issue, TandemError, issue_error
from planner.processes.hotwire.claims import KerfCurve
from planner.processes.hotwire.plan.kerf import cut_measurements, models
from planner.processes.hotwire.plan.kerf.cut_measurements import TEST_WIRE, HotWire
from planner.processes.hotwire.plan.kerf.models import refuse_melting

Model = Literal["energy", "general", "measured", "dissertation"]


def _no_inverse(
    foam: FoamMaterial, wire: HotWire, power_or_speed: FloatArray, required: FloatArray, thickness: FloatArray
) -> FloatArray:
    """Stand for the inverse of a model that has none. `choose_model` refuses such a model before."""
    raise ValueError("this model has no inverse")


@dataclasses.dataclass(frozen=True)
class KerfModel:
    """A kerf model.

    Attributes:
        width: Function of foam, wire, power [W], speed [m/s] and thickness [m]. It returns the kerf:
            expected, low and high [m].
        speed_for: Function of foam, wire, power, required kerf [m] and thickness. It returns the speed.
        power_for: Function of foam, wire, speed, required kerf and thickness. It returns the power.
        required_fields: Fields of `FoamMaterial` that the model needs.
        needs_dissertation_tables: Whether the foam must be one of the dissertation's.
    """

    width: Callable[
        [FoamMaterial, HotWire, FloatArray, FloatArray, FloatArray], tuple[FloatArray, FloatArray, FloatArray]
    ]
    speed_for: Callable[[FoamMaterial, HotWire, FloatArray, FloatArray, FloatArray], FloatArray]
    power_for: Callable[[FoamMaterial, HotWire, FloatArray, FloatArray, FloatArray], FloatArray]
    required_fields: tuple[str, ...]
    needs_dissertation_tables: bool = False


_HEAT_FIELDS: Final = ("specific_heat", "melt_temperature")
"""Fields of `FoamMaterial` that the heat balance needs."""
FIELD_LABELS: Final = {
    "specific_heat": "specific heat",
    "melt_temperature": "melting temperature",
    "kerf": "test cuts",
    "radiation": "fraction of radiation",
    "wire_rise": "wire temperatures",
}
"""Fields of `FoamMaterial` as messages name them."""
KERF_MODELS: Final[dict[str, KerfModel]] = {
    "energy": KerfModel(
        models.energy_width, models.energy_speed, models.energy_power, ("kerf", *_HEAT_FIELDS)
    ),
    "general": KerfModel(
        models.general_width, models.general_speed, models.general_power, (*_HEAT_FIELDS, "conductivity")
    ),
    "measured": KerfModel(
        models.measured_width,
        _no_inverse,
        _no_inverse,
        ("kerf", *_HEAT_FIELDS),
        needs_dissertation_tables=True,
    ),
    "dissertation": KerfModel(
        models.convection_estimate,
        models.convection_speed,
        models.convection_power,
        (*_HEAT_FIELDS, "radiation", "wire_rise"),
        needs_dissertation_tables=True,
    ),
}
"""The models by name."""


def choose_model(
    foam: str | FoamMaterial, model: str, inverse: bool = False
) -> tuple[FoamMaterial, KerfModel]:
    """Return the data of a foam and the functions of a model.

    Args:
        foam: Built-in name or foam data.
        model: Name of the model.
        inverse: Whether the inverse of the model is needed.

    Raises:
        TandemError: kerf.model, kerf.no_data, kerf.unknown_foam.
    """
    if model not in KERF_MODELS:
        text = f"kerf model: got {model!r}, allowed {', '.join(KERF_MODELS)}"
        raise issue_error("kerf.model", text, field="model", hint="use energy")
    data = materials.foam(foam) if isinstance(foam, str) else foam
    functions = KERF_MODELS[model]
    missing = [name for name in functions.required_fields if getattr(data, name) is None]
    if functions.needs_dissertation_tables and data.name not in cut_measurements.dissertation_tables():
        missing.append("cells in the tables of the dissertation")
    if missing:
        tested_foams = ", ".join(
            sorted(name for name, item in materials.foams().items() if item.kerf is not None)
        )
        missing_labels = " and ".join(FIELD_LABELS.get(name, name) for name in missing)
        text = (
            f"kerf in {data.name} by model {model}: got no {missing_labels}, allowed {tested_foams} or your "
            "own foam"
        )
        hint = "cut the four squares of problems/kerf_test and run: tandem kerf fit tests.csv"
        raise issue_error("kerf.no_data", text, field="foam", hint=hint)
    if inverse and functions.speed_for is _no_inverse:
        text = f"kerf model for a required kerf: got {model}, whose kerf is not monotonic in the speed"
        raise issue_error("kerf.model", text, field="model", hint="use energy")
    return data, functions


USABLE_KERF_RANGE_M: Final = (0.8e-3, 3.0e-3)
"""Range of kerfs [m] that leave usable faces. Below it the wire drags, above it the wire burns the foam.

Source: dissertation, chapter 3.
"""


class KerfFlag(enum.IntFlag):
    """Reasons to doubt an estimate of a kerf, 0 for none. Arrays of flags are uint8."""

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
"""Text of each flag for users."""


def explain(flag: int) -> tuple[str, ...]:
    """Return the text of each reason to doubt that is set in ``flag``, none for 0."""
    return tuple(text for bit, text in FLAG_TEXTS.items() if flag & bit)


__all__ = [
    "TEST_WIRE",
    "USABLE_KERF_RANGE_M",
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

THICKNESS_TOLERANCE_FRACTION: Final = 0.1
"""Foam and wire count as tested if their thickness differs from the tests by at most this fraction."""
CURVE_TOLERANCE_M: Final = 1e-6
"""Largest error [m] of linear interpolation in a curve."""
MAX_CURVE_POINTS: Final = 50_000
"""Maximum number of points of a curve. A kerf that needs more is refused."""
DEFAULT_CURVE_SPEEDS_M_S: Final = (0.5e-3, 50e-3)
"""Default range of speeds of a curve [m/s]."""

DISSERTATION_TESTS: Final = materials.KerfTests((35.7 / 0.43, 54.9 / 0.43), (2e-3, 10e-3), 0.05, 0.0004)
"""Conditions of the dissertation's tests. A foam without its own test cuts is compared with them."""


@dataclasses.dataclass(frozen=True)
class KerfEstimate:
    """Kerfs in the common shape of the inputs.

    Attributes:
        width: Expected width [m].
        low: Lower end of the interval that contains nine of ten new cuts [m].
        high: Upper end of the interval [m].
        flag: Combination of `KerfFlag` as uint8.
    """

    width: FloatArray
    low: FloatArray
    high: FloatArray
    flag: NDArray[np.uint8]


def width(
    foam: str | FoamMaterial,
    wire: HotWire,
    power_w: ArrayLike,
    speed_m_s: ArrayLike,
    thickness_m: ArrayLike,
    model: Model = "energy",
) -> KerfEstimate:
    """Return the kerf of a wire in foam. The numeric inputs broadcast.

    Except in the dissertation's model, no kerf is below the diameter of the wire.

    Args:
        foam: Built-in name or foam data.
        wire: The wire.
        power_w: Power over the heated length [W].
        speed_m_s: Speed across the wire [m/s].
        thickness_m: Thickness of the foam along the wire [m].
        model: Kerf model.

    Raises:
        TandemError: kerf.unknown_foam, kerf.no_data, kerf.input, kerf.model, kerf.melts.
    """
    data, functions = choose_model(foam, model)
    power, speed, thickness = _positive_arrays(power_w=power_w, speed_m_s=speed_m_s, thickness_m=thickness_m)
    refuse_melting(data, wire, float(power.max()))
    expected, low, high = functions.width(data, wire, power, speed, thickness)
    shape = np.broadcast_shapes(power.shape, speed.shape, thickness.shape)
    flag = np.broadcast_to(_flags(data, wire, expected, power / wire.length, speed, thickness), shape)
    low, expected, high = (np.broadcast_to(values, shape) for values in (low, expected, high))
    return KerfEstimate(expected, low, high, flag)


def speed_for(
    foam: str | FoamMaterial,
    wire: HotWire,
    power_w: ArrayLike,
    width: ArrayLike,
    thickness_m: ArrayLike,
    model: Model = "energy",
) -> FloatArray:
    """Return the speed [m/s] at which the expected kerf is ``width``. The numeric inputs broadcast.

    Call `width` with this speed for the interval and the flags.

    Args:
        foam: Built-in name or foam data.
        wire: The wire.
        power_w: Power over the heated length [W].
        width: Required kerf [m].
        thickness_m: Thickness of the foam along the wire [m].
        model: Kerf model with an inverse.

    Raises:
        TandemError: As `width`, and kerf.impossible.
    """
    data, functions = choose_model(foam, model, inverse=True)
    power, required, thickness = _positive_arrays(power_w=power_w, width=width, thickness_m=thickness_m)
    _refuse_narrow(required, wire)
    refuse_melting(data, wire, float(power.max()))
    return _refuse_impossible(
        functions.speed_for(data, wire, power, required, thickness), power, required, thickness
    )


def power_for(
    foam: str | FoamMaterial,
    wire: HotWire,
    speed_m_s: ArrayLike,
    width: ArrayLike,
    thickness_m: ArrayLike,
    model: Model = "energy",
) -> FloatArray:
    """Return the power [W] over the heated length at which the expected kerf is ``width``.

    The numeric inputs broadcast.

    Args:
        foam: Built-in name or foam data.
        wire: The wire.
        speed_m_s: Speed across the wire [m/s].
        width: Required kerf [m].
        thickness_m: Thickness of the foam along the wire [m].
        model: Kerf model with an inverse.

    Raises:
        TandemError: As `speed_for`.
    """
    data, functions = choose_model(foam, model, inverse=True)
    speed, required, thickness = _positive_arrays(speed_m_s=speed_m_s, width=width, thickness_m=thickness_m)
    _refuse_narrow(required, wire)
    result = _refuse_impossible(
        functions.power_for(data, wire, speed, required, thickness), speed, required, thickness
    )
    refuse_melting(data, wire, float(result.max()))
    return result


def curve(
    foam: str | FoamMaterial,
    wire: HotWire,
    power_w: float,
    thickness_m: float,
    speeds: ArrayLike | None = None,
    model: Model = "energy",
) -> KerfCurve:
    """Return the kerf over speed at one power and thickness. Linear interpolation is exact within 1 um.

    Args:
        foam: Built-in name or foam data.
        wire: The wire.
        power_w: Power over the heated length [W].
        thickness_m: Thickness of the foam along the wire [m].
        speeds: Speeds [m/s]. Only their lowest and highest values count, as bounds of the table. Default: 0.5
            to 50 mm/s.
        model: Kerf model.

    Raises:
        TandemError: As `width`, also if the table needs more than 50 000 speeds.
    """
    (bounds,) = _positive_arrays(speeds=DEFAULT_CURVE_SPEEDS_M_S if speeds is None else speeds)
    first, last = float(bounds.min()), float(bounds.max())
    first, last = (first, last) if last > first else (first, first * (1.0 + 1e-6))

    def kerfs_at(speed: FloatArray) -> FloatArray:
        """Return the expected kerf and both ends of its interval (3, K) [m] at speeds (K,) [m/s]."""
        estimate = width(foam, wire, power_w, speed, thickness_m, model)
        return np.stack([estimate.width, estimate.low, estimate.high])

    speed = _dense_speeds(kerfs_at, first, last)
    expected, low, high = kerfs_at(speed)
    return KerfCurve(speed, expected, low, high)


def _dense_speeds(kerfs_at: Callable[[FloatArray], FloatArray], first: float, last: float) -> FloatArray:
    """Return speeds (K,) between which all kerfs of ``kerfs_at`` are linear within `CURVE_TOLERANCE_M`.

    They are evenly spaced in 1 / sqrt(speed), where a kerf ~ 1 / speed has even curvature. Steps whose middle
    still deviates are halved.
    """
    table = np.linspace(first**-0.5, last**-0.5, 65) ** -2.0
    table[0], table[-1] = first, last
    while True:
        middle = 0.5 * (table[:-1] + table[1:])
        ends = kerfs_at(table)
        error = np.abs(kerfs_at(middle) - 0.5 * (ends[:, :-1] + ends[:, 1:])).max(axis=0)
        needs_split = error > 0.5 * CURVE_TOLERANCE_M
        if not np.any(needs_split):
            return table
        if len(table) > MAX_CURVE_POINTS:
            text = f"kerf curve: {len(table)} speeds are not enough for linear interpolation within 1 um"
            hint = "start at a higher speed, or use less power"
            raise issue_error("kerf.input", text, field="speeds", hint=hint)
        table = np.sort(np.concatenate([table, middle[needs_split]]))


def _flags(
    foam: FoamMaterial,
    wire: HotWire,
    kerf: FloatArray,
    power_per_length: FloatArray,
    speed: FloatArray,
    thickness: FloatArray,
) -> NDArray[np.uint8]:
    """Return the combined flags of kerfs [m], in the common shape of the inputs.

    Conditions are compared with the test cuts of the foam. A foam without test cuts is compared with
    `DISSERTATION_TESTS` and always counts as untested.
    """
    tests = DISSERTATION_TESTS if foam.kerf is None else foam.kerf.tests
    hot = kerf > USABLE_KERF_RANGE_M[1]
    if tests.burnt_speed is not None:
        hot = hot | (speed <= tests.burnt_speed)
    untested = _outside(power_per_length, tests.power_per_length) | _outside(speed, tests.speed)
    conditions = (
        (KerfFlag.TOO_HOT, hot),
        (KerfFlag.TOO_COLD, kerf < USABLE_KERF_RANGE_M[0]),
        (
            KerfFlag.THICKNESS,
            abs(thickness - tests.thickness) > THICKNESS_TOLERANCE_FRACTION * tests.thickness,
        ),
        (KerfFlag.UNTESTED, untested | (foam.kerf is None)),
        (
            KerfFlag.OTHER_WIRE,
            abs(wire.diameter - tests.wire_diameter) > THICKNESS_TOLERANCE_FRACTION * tests.wire_diameter,
        ),
    )
    flags: NDArray[np.uint8] = np.zeros((), np.uint8)
    for flag, is_set in conditions:
        flags = flags | np.where(is_set, np.uint8(flag.value), np.uint8(0))
    return np.asarray(flags, np.uint8)


def _outside(values: FloatArray, bounds: tuple[float, float]) -> BoolArray:
    tolerance = 1e-6  # for rounding errors of values that were converted from mm and W
    return (values < bounds[0] * (1.0 - tolerance)) | (values > bounds[1] * (1.0 + tolerance))


def _positive_arrays(**inputs: ArrayLike) -> tuple[FloatArray, ...]:
    """Return the inputs as arrays.

    Raises:
        TandemError: ``kerf.input`` for values that are not positive finite numbers, empty inputs, and shapes
            that do not broadcast.
    """
    arrays = {name: np.asarray(value, np.float64) for name, value in inputs.items()}
    issues = []
    for name, values in arrays.items():
        invalid = ~(np.isfinite(values) & (values > 0.0))
        if np.any(invalid) or values.size == 0:
            first_invalid = float(values[invalid].flat[0]) if values.size else float("nan")
            text = (
                f"{name}: got {first_invalid:g} ({int(invalid.sum())} of {values.size}), allowed finite "
                "numbers above 0"
            )
            hint = "a point of the wire at rest has no kerf: leave it out, or give its true speed"
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
        raise issue_error("kerf.input", text, hint="give one value, or as many of each") from error
    return tuple(arrays.values())


def _refuse_narrow(required: FloatArray, wire: HotWire) -> None:
    """Raise ``kerf.impossible`` if a required kerf [m] is not above the diameter of the wire."""
    narrowest, diameter = float(required.min()) / MM, wire.diameter / MM
    if narrowest <= diameter:
        text = f"required kerf: got {narrowest:.3f} mm, allowed above the wire's diameter {diameter:.3f} mm"
        hint = (
            f"require {USABLE_KERF_RANGE_M[0] / MM:g} to {USABLE_KERF_RANGE_M[1] / MM:g} mm, or use a "
            "thinner wire"
        )
        raise issue_error("kerf.impossible", text, value=narrowest, limit=diameter, unit="mm", hint=hint)


def _refuse_impossible(
    result: FloatArray, power_or_speed: FloatArray, required: FloatArray, thickness: FloatArray
) -> FloatArray:
    """Return the result of an inverse model in the common shape, or raise ``kerf.impossible``.

    A result that is not a positive number means that the required kerf [m] is impossible.
    """
    shape = np.broadcast_shapes(power_or_speed.shape, required.shape, thickness.shape)
    result, requested = (np.array(np.broadcast_to(values, shape)) for values in (result, required))
    invalid = ~(np.isfinite(result) & (result > 0.0))
    if np.any(invalid):
        first_invalid = float(requested[invalid].flat[0]) / MM
        text = f"required kerf: got {first_invalid:.3f} mm"
        text += f" ({int(invalid.sum())} of {invalid.size}), which no speed or power gives"
        hint = (
            f"require {USABLE_KERF_RANGE_M[0] / MM:g} to {USABLE_KERF_RANGE_M[1] / MM:g} mm, with more "
            "power or at another speed"
        )
        raise issue_error("kerf.impossible", text, value=first_invalid, unit="mm", hint=hint)
    return result
