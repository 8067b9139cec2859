"""Calibration of a clamp by a test: a flat sheet is pressed, forces and a dial gauge are read.

The readings at one pressed point are fitted with the elastic shell of the flat sheet. Three quantities are
estimated: the in-plane behaviour of the border, from sliding through a spring to immovable; the thickness,
for which the sheet's tolerance is known; and kappa, the factor by which the sheet deflects more than the
shell model.

**Response.** By the similarity of thin plates under large deflections (von Karman's equations with lengths in
the plane over a, deflections over the thickness t), w / t depends only on F a^2 / (E t^4) and on the border's
spring over E t / a. So curves for some borders at one thickness are sufficient; a test compares that with
shells of other thicknesses.

**Fit.** w = kappa t f(F a^2 / (E t^4), spring a / (E t)), with independent errors of the dial and of the
shell, whose size is estimated from the readings as well (Student's distribution). Kappa is linear and is
integrated in closed form. Border and thickness are evaluated on a grid that is refined twice. Intervals are
the shortest ones of 95 % (highest density). They reach the end of the range where a border slides or does not
move.
"""

import csv
import dataclasses
import io
from pathlib import Path
from typing import Final

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

from planner.files import is_file, missing_file_reason, separator_hint
from planner.geometry.arrays import FloatArray
from planner.geometry.units import MM
from planner.issues import Issue, Severity, TandemError
from planner.shell.element import ShellSheet
from planner.shell.mesh import mesh_walls
from planner.shell.newton import clamped, curve

GRIPS: Final = np.array([0.0, 0.05, 0.15, 0.35, 0.6, 0.8, 0.92, 1.0])
"""Borders that are solved: spring / (spring + E t / a); 0 slides, 1 does not move."""
LOADS_PER_CURVE: Final = 9
"""Number of loads of each curve."""
TRIANGLES: Final = 900
"""Number of triangles of the flat sheet: the result is within half a percent of that with six times
as many.
"""
PRESSED_WIDTH_M: Final = 3.0 * MM
"""Width [m] of the square that is pressed."""
MODEL_ERROR_FRACTION: Final = 0.004
"""Error of the shell model, as a fraction of its deflection."""
INTERVAL_PROBABILITY: Final = 0.95
"""Probability of the intervals."""
PRIOR_READINGS: Final = 3
"""Weight of the stated error, in readings, relative to the scatter of the readings themselves."""
READING_COLUMNS: Final = ("force_n", "dial_mm")
"""Columns of a file of readings."""
MIN_READINGS: Final = 6
"""Minimum number of readings, because three quantities are estimated."""
MIN_DIFFERENT_FORCES: Final = 5
"""Minimum number of different forces, because three quantities are estimated."""
MAX_FILE_BYTES: Final = 1_000_000
"""Maximum size [bytes] of a file of readings."""
MAX_FALL_FRACTION: Final = 0.05
"""Fraction of the largest reading by which the dial may fall at a higher force: play and scatter."""
GRID_SHAPE: Final = (61, 41)
"""Numbers of borders and thicknesses of a grid, each time it is refined."""
MAX_DETERMINED_FRACTION: Final = 0.7
"""An interval wider than this fraction of the prior one means that the test did not determine the
quantity.
"""


@dataclasses.dataclass(frozen=True)
class TestPlate:
    """A flat sheet in a clamp.

    Attributes:
        outline: Opening (K, 2) [m] of the clamp.
        load_point: Point (2,) [m] that is pressed.
        young: Young's modulus [Pa].
        poisson: Poisson's ratio.
        thickness: Thickness [m] as ordered.
        tolerance: Tolerance [m] of the thickness (two standard deviations).
    """

    outline: FloatArray
    load_point: FloatArray
    young: float
    poisson: float
    thickness: float
    tolerance: float

    @property
    def width(self) -> float:
        """Characteristic length a [m] of the opening: the square root of its area."""
        x, y = self.outline.T
        return float(np.sqrt(0.5 * abs(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))))

    def spring(self, grip: float, thickness: float) -> float:
        """Return the in-plane stiffness [N/m^2] of the border per length; infinite for a ``grip`` of 1."""
        if grip >= 1.0:
            return np.inf
        return grip / (1.0 - grip) * self.young * thickness / self.width


@dataclasses.dataclass(frozen=True)
class PlateReadings:
    """Readings of a test.

    Attributes:
        force: Forces (n,) [N].
        dial: Dial readings (n,) [m].
        error: Error [m] of a reading, one standard deviation.
    """

    force: FloatArray
    dial: FloatArray
    error: float


@dataclasses.dataclass(frozen=True)
class PlateResponse:
    """Deflection of a plate as a function of load.

    Attributes:
        load: ln F a^2 / (E t^4) (L,).
        grip: Borders (G,).
        log_deflection: ln w / t (L, G).
    """

    load: FloatArray
    grip: FloatArray
    log_deflection: FloatArray

    def log_deflection_at(self, load: FloatArray, grip: FloatArray) -> FloatArray:
        """Return ln w / t (n, g) at loads ln F a^2 / (E t^4) (n,) for borders (g,)."""
        at_loads = CubicSpline(self.load, self.log_deflection, axis=0)(load)
        return np.asarray(PchipInterpolator(self.grip, at_loads, axis=1)(grip))


def plate_response(
    plate: TestPlate, max_force: float, min_force: float, triangles: int = TRIANGLES
) -> PlateResponse:
    """Return the response of a plate to a range of forces, from shells of its ordered thickness.

    The response is dimensionless, so that other thicknesses within the tolerance can be evaluated with it.

    Args:
        plate: Plate.
        max_force: Largest force [N].
        min_force: Smallest force [N].
        triangles: Number of triangles.

    Raises:
        ValueError: if there are too few triangles.
        LimitLoadError: if the sheet does not bear the load.
    """
    # load ~ 1 / t^4: sheet that is thinner by the tolerance has a higher dimensionless load
    spread = (1.0 + 2.5 * plate.tolerance / plate.thickness) ** 4
    # range of the readings, a little extended on both sides
    forces = np.geomspace(0.7 * min_force / spread, 1.1 * max_force * spread, LOADS_PER_CURVE)
    plate_mesh = mesh_walls([], plate.outline, triangles, plate.load_point[None])
    thicknesses = np.full(len(plate_mesh.triangles), plate.thickness)
    sheet = ShellSheet(plate_mesh.nodes, plate_mesh.triangles, thicknesses, plate.young, plate.poisson)
    log_deflections = []
    for grip in GRIPS:
        border: str | float = plate.spring(grip, plate.thickness)
        border = "sliding" if grip == 0.0 else "immovable" if grip == 1.0 else border
        loads = np.stack([np.zeros(LOADS_PER_CURVE), np.zeros(LOADS_PER_CURVE), -forces], axis=1)
        displacement = curve(sheet, clamped(sheet, border), plate.load_point, loads, PRESSED_WIDTH_M)
        log_deflections.append(np.log(-displacement[:, 2] / plate.thickness))
    return PlateResponse(_log_load(plate, forces, plate.thickness), GRIPS, np.stack(log_deflections, axis=1))


def _log_load(plate: TestPlate, force: FloatArray, thickness: float) -> FloatArray:
    """Return the logarithm of the dimensionless load F a^2 / (E t^4) of forces (n,) [N]."""
    return np.asarray(np.log(force * plate.width**2 / (plate.young * thickness**4)))


@dataclasses.dataclass(frozen=True)
class IntervalEstimate:
    """Estimated quantity.

    Attributes:
        value: Best value.
        low: Lower bound of the interval of probability `INTERVAL_PROBABILITY`.
        high: Upper bound of the interval.
        is_determined: Whether the test determined it; otherwise its interval is about that before the test.
    """

    value: float
    low: float
    high: float
    is_determined: bool


@dataclasses.dataclass(frozen=True)
class ClampCalibration:
    """Result of a calibration.

    Attributes:
        grip: Border (0 slides, 1 does not move).
        spring: Stiffness [N/m^2] of the border at the estimated thickness, infinite at 1.
        thickness: Thickness [m].
        kappa: Factor kappa [-].
        residuals: Readings minus the best fit (n,) [m].
        correlation: Correlations (3, 3) of grip, thickness and kappa.
    """

    grip: IntervalEstimate
    spring: IntervalEstimate
    thickness: IntervalEstimate
    kappa: IntervalEstimate
    residuals: FloatArray
    correlation: FloatArray

    @property
    def border(self) -> str:
        """Border as a problem's clamp states it: sliding, immovable or spring.

        It is sliding or immovable if the interval of the grip includes that end, "unknown" if it includes
        both.
        """
        if self.grip.low <= 0.0 and self.grip.high >= 1.0:
            return "unknown"
        return "sliding" if self.grip.low <= 0.0 else "immovable" if self.grip.high >= 1.0 else "spring"


def calibrate(plate: TestPlate, readings: PlateReadings, response: PlateResponse) -> ClampCalibration:
    """Estimate the border, the thickness and kappa, each with its interval, from the readings of a test.

    The posterior distribution is evaluated on a grid, which is refined twice to the range that matters.
    """
    spread = 0.5 * plate.tolerance
    grip_range = (0.0, 1.0)
    thickness_range = (plate.thickness - 4.0 * spread, plate.thickness + 4.0 * spread)
    for _ in range(3):
        grid = _PosteriorGrid.evaluate(plate, readings, response, grip_range, thickness_range)
        grip_range, thickness_range = grid.bounds()
    return grid.calibration(plate, readings, response)


@dataclasses.dataclass(frozen=True)
class _PosteriorGrid:
    """Posterior distribution on a grid of borders (g,) and thicknesses (h,).

    Attributes:
        grip: Borders (g,).
        thick: Thicknesses (h,) [m].
        weight: Posterior weights (g, h), sum 1.
        mean: Mean of kappa (g, h).
        scale: Scale of kappa (g, h) in Student's distribution.
        freedom: Degrees of freedom of that distribution.
    """

    grip: FloatArray
    thick: FloatArray
    weight: FloatArray
    mean: FloatArray
    scale: FloatArray
    freedom: int

    @staticmethod
    def evaluate(
        plate: TestPlate,
        readings: PlateReadings,
        response: PlateResponse,
        grips: tuple[float, float],
        thicks: tuple[float, float],
    ) -> "_PosteriorGrid":
        """Return the posterior distribution on a grid over ranges of borders and thicknesses.

        The model of a reading is kappa times the deflection of the plate, plus normal errors.

        Args:
            plate: Plate.
            readings: Readings.
            response: Response of the plate.
            grips: Lowest and highest border, 0 to 1.
            thicks: Lowest and highest thickness [m].
        """
        grip, thick = np.linspace(*grips, GRID_SHAPE[0]), np.linspace(*thicks, GRID_SHAPE[1])
        inverse_variance = 1.0 / (readings.error**2 + (MODEL_ERROR_FRACTION * readings.dial) ** 2)
        # deflection (n, g, h) [m] for kappa = 1
        shape = np.stack(
            [
                thickness
                * np.exp(response.log_deflection_at(_log_load(plate, readings.force, thickness), grip))
                for thickness in thick
            ],
            axis=2,
        )
        shape_square = np.einsum("n,ngh,ngh->gh", inverse_variance, shape, shape)
        shape_dial = np.einsum("n,n,ngh->gh", inverse_variance, readings.dial, shape)
        mean = shape_dial / shape_square
        residual = np.maximum(np.sum(inverse_variance * readings.dial**2) - mean * shape_dial, 1e-12)
        count = len(readings.dial)
        # the size of the errors is hardly known (PRIOR_READINGS degrees of freedom); prior of kappa: 1 /
        # kappa
        freedom = count - 1 + PRIOR_READINGS
        residual = residual + PRIOR_READINGS
        log_weight = -0.5 * freedom * np.log(residual) - 0.5 * np.log(shape_square) - np.log(mean)
        log_weight -= 0.5 * ((thick - plate.thickness) / (0.5 * plate.tolerance)) ** 2
        weight = np.exp(log_weight - log_weight.max())
        return _PosteriorGrid(
            grip, thick, weight / weight.sum(), mean, np.sqrt(residual / (freedom * shape_square)), freedom
        )

    def bounds(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return the ranges of border and thickness with non-negligible weight, extended by one cell."""
        ranges = []
        for values, marginal in ((self.grip, self.weight.sum(axis=1)), (self.thick, self.weight.sum(axis=0))):
            significant = np.flatnonzero(marginal > 1e-5 * marginal.max())
            low, high = max(significant[0] - 1, 0), min(significant[-1] + 1, len(values) - 1)
            ranges.append((float(values[low]), float(values[high])))
        return ranges[0], ranges[1]

    def kappa_distribution(self) -> tuple[FloatArray, FloatArray]:
        """Return equidistant values (K,) of kappa and their weights (K,), sum 1."""
        half_width = 8.0 * np.sqrt(
            np.sum(self.weight * ((self.mean - self._mean_kappa()) ** 2 + self.scale**2))
        )
        values = np.linspace(self._mean_kappa() - half_width, self._mean_kappa() + half_width, 801)
        significant = self.weight > 1e-7 * self.weight.max()
        mean, scale, weight = self.mean[significant], self.scale[significant], self.weight[significant]
        density_sum = np.zeros(len(values))
        for first in range(0, len(mean), 512):
            part = slice(first, first + 512)
            deviation = (values[:, None] - mean[part]) / scale[part]
            density = (1.0 + deviation**2 / self.freedom) ** (-0.5 * (self.freedom + 1)) / scale[part]
            density_sum += density @ weight[part]
        return values, density_sum / density_sum.sum()

    def _mean_kappa(self) -> float:
        """Return the mean of kappa over the grid."""
        return float(np.sum(self.weight * self.mean))

    def calibration(
        self, plate: TestPlate, readings: PlateReadings, response: PlateResponse
    ) -> ClampCalibration:
        """Return the estimated quantities with their intervals, and the residuals of the best fit."""
        grip_weight, thick_weight = self.weight.sum(axis=1), self.weight.sum(axis=0)
        kappa, kappa_weight = self.kappa_distribution()
        best_cell = np.unravel_index(int(np.argmax(self.weight)), self.weight.shape)
        grip = _interval(self.grip, grip_weight, 1.0, float(self.grip[best_cell[0]]))
        prior_width = 2.0 * 1.96 * 0.5 * plate.tolerance
        thick = _interval(self.thick, thick_weight, prior_width, float(self.thick[best_cell[1]]))
        kappa_estimate = _interval(kappa, kappa_weight, np.inf, float(self.mean[best_cell]))
        value, low, high = (
            plate.spring(grip_value, thick.value) for grip_value in (grip.value, grip.low, grip.high)
        )
        spring = IntervalEstimate(value, low, high, grip.is_determined)
        shape = thick.value * np.exp(
            response.log_deflection_at(_log_load(plate, readings.force, thick.value), np.array([grip.value]))
        )
        residuals = readings.dial - float(self.mean[best_cell]) * shape[:, 0]
        return ClampCalibration(grip, spring, thick, kappa_estimate, residuals, self._correlation())

    def _correlation(self) -> FloatArray:
        """Return the correlations (3, 3) of border, thickness and kappa."""
        quantities = [
            np.broadcast_to(values, self.weight.shape).reshape(-1)
            for values in (self.grip[:, None], self.thick, self.mean)
        ]
        covariance = np.cov(np.stack(quantities), aweights=self.weight.reshape(-1), ddof=0)
        # kappa also varies within each cell of the grid
        covariance[2, 2] += np.sum(self.weight * self.scale**2)
        deviation = np.sqrt(np.maximum(np.diag(covariance), 1e-30))
        return np.asarray(covariance / deviation / deviation[:, None])


def _interval(values: FloatArray, weight: FloatArray, prior_width: float, best: float) -> IntervalEstimate:
    """Return the best value with the interval of probability `INTERVAL_PROBABILITY` around the likely values.

    The interval includes the values of largest weight until their sum has that probability. The quantity
    counts as determined if the interval is shorter than `MAX_DETERMINED_FRACTION` of ``prior_width``, the
    width of the interval before the test. ``values`` (N,) are equidistant, with the posterior weights
    ``weight`` (N,).
    """
    order = np.argsort(-weight, kind="stable")
    count = int(np.searchsorted(np.cumsum(weight[order]), INTERVAL_PROBABILITY * weight.sum())) + 1
    selected = np.sort(order[:count])
    half_cell = 0.5 * (values[1] - values[0])
    low, high = float(values[selected[0]] - half_cell), float(values[selected[-1]] + half_cell)
    low, high = max(low, float(values[0])), min(high, float(values[-1]))
    return IntervalEstimate(best, low, high, high - low < MAX_DETERMINED_FRACTION * prior_width)


MAX_SEPARABLE_CORRELATION: Final = 0.8
"""Correlation from which two quantities count as not separable."""
_QUANTITY_NAMES: Final = ("the border", "the thickness", "kappa")


def clarity_issues(
    calibration: ClampCalibration, plate: TestPlate, readings: PlateReadings, assumed: bool
) -> tuple[Issue, ...]:
    """Return warnings about quantities that the readings do not determine or do not separate.

    The issues have the code ``forming.clamp_unclear``.

    Args:
        calibration: Result.
        plate: Plate.
        readings: Readings.
        assumed: Whether the thickness's tolerance is an assumption.
    """
    messages = []
    deflection_ratio = float(readings.dial.max()) / plate.thickness
    if not calibration.grip.is_determined:
        message = (
            f"the border may be anything from {_grip_text(calibration.grip.low)} to "
            f"{_grip_text(calibration.grip.high)}: the "
        )
        message += (
            f"sheet sank by {deflection_ratio:.1f} times its thickness; press harder until it sinks by three "
            "or more"
        )
        messages.append(message)
    if not calibration.thickness.is_determined:
        message = "the readings do not determine the thickness, which is as you stated it, within "
        message += f"{plate.tolerance / MM:.3g} mm"
        if assumed:
            message += " as assumed; measure it, and state its tolerance (--thickness-tol-mm)"
        messages.append(message)
    is_correlated = np.abs(calibration.correlation) > MAX_SEPARABLE_CORRELATION
    correlated = [name for k, name in enumerate(_QUANTITY_NAMES) if np.count_nonzero(is_correlated[k]) > 1]
    if correlated:
        message = (
            f"{', '.join(correlated[:-1])} and {correlated[-1]} are correlated: other combinations within "
            "their "
        )
        message += (
            "intervals give nearly the same readings; measure the thickness to a hundredth, press lightly"
        )
        message += " and hard, and take more "
        messages.append(f"{message}readings")
    return tuple(Issue("forming.clamp_unclear", message, Severity.WARNING) for message in messages)


def _grip_text(value: float) -> str:
    return "sliding" if value <= 0.0 else "immovable" if value >= 1.0 else f"a grip of {value:.2f}"


def read_readings(path: Path, error: float) -> PlateReadings:
    """Read a CSV file with the columns force_n [N] and dial_mm [mm].

    The dial shows the deflection in the direction of the force. Its reading without force is subtracted.
    Lines that start with # are skipped.

    Args:
        path: File.
        error: Error [m] of a reading.

    Raises:
        TandemError: ``forming.plate_test`` with every fault and its line: other columns and units, values
            that are not numbers, forces below 0, too few readings, dials that do not rise with the force.
    """
    lines = _read_text(path).splitlines()
    numbered_lines = [
        (number, line) for number, line in enumerate(lines, 1) if line.strip() and line[:1] != "#"
    ]
    rows = list(csv.reader(io.StringIO("\n".join(line for _, line in numbered_lines))))
    header = [name.strip().lower() for name in rows[0]] if rows else []
    separator_fault = separator_hint(numbered_lines[0][1]) if numbered_lines else None
    if separator_fault is not None:
        raise TandemError(_reading_issue(path, numbered_lines[0][0], separator_fault))
    if sorted(header) != sorted(READING_COLUMNS):
        got_columns = ", ".join(header)[:80] or "nothing"
        message = (
            f"the columns are {got_columns}, expected {', '.join(READING_COLUMNS)} (newtons, millimetres, "
            "decimal points)"
        )
        raise TandemError(_reading_issue(path, 1, message))
    issues, values = list[Issue](), list[tuple[float, float]]()
    for (number, _), row in zip(numbered_lines[1:], rows[1:], strict=True):
        try:
            force, dial = (float(row[header.index(name)]) for name in READING_COLUMNS)
            if len(row) != len(header) or not np.isfinite([force, dial]).all():
                raise ValueError
        except (ValueError, IndexError):
            issues.append(
                _reading_issue(path, number, f"got {','.join(row)[:60]!r}, expected two finite numbers")
            )
            continue
        if force < 0.0:
            issues.append(
                _reading_issue(path, number, f"the force is {force:g} N, allowed 0 N or more (downward)")
            )
        values.append((force, dial))
    if issues:
        raise TandemError(issues)
    forces, dials = np.array(values, dtype=np.float64).reshape(-1, 2).T
    is_unloaded = forces == 0.0
    dials = dials - (float(dials[is_unloaded].mean()) if is_unloaded.any() else 0.0)
    order = np.argsort(forces[~is_unloaded], kind="stable")
    forces, dials = forces[~is_unloaded][order], dials[~is_unloaded][order] * MM
    _require_plausible(path, forces, dials)
    return PlateReadings(forces, dials, error)


def _require_plausible(path: Path, forces: FloatArray, dials: FloatArray) -> None:
    """Raise ``TandemError`` (forming.plate_test) if readings cannot be those of a test.

    There must be enough readings at enough different forces, and the dial must rise with the force. The
    stiffness must be between 2 and 20 000 N/mm; other values indicate another unit.

    Args:
        path: File, for messages.
        forces: Forces (n,) [N], ascending.
        dials: Dial readings (n,) [m].
    """
    count, different_count = len(forces), len(np.unique(forces))
    if count < MIN_READINGS or different_count < MIN_DIFFERENT_FORCES:
        message = f"{count} readings at {different_count} forces, required: {MIN_READINGS} at "
        message += f"{MIN_DIFFERENT_FORCES} "
        raise TandemError(
            _reading_issue(path, None, f"{message}forces at least, from a tenth of the largest upward")
        )
    running_max = np.maximum.accumulate(dials)
    worst_index = int(np.argmax(running_max - dials))
    if (
        dials.min() <= 0.0
        or dials[-1] <= dials[0]
        or running_max[worst_index] - dials[worst_index] > MAX_FALL_FRACTION * running_max[-1]
    ):
        worst_index = worst_index if dials.min() > 0.0 else int(np.argmin(dials))
        message = f"the dial shows {dials[worst_index] / MM:.3f} mm at {forces[worst_index]:g} N"
        message += (
            f", and {running_max[worst_index] / MM:.3f} mm at less"
            if running_max[worst_index] > dials[worst_index]
            else ""
        )
        message += (
            "; the reading must increase with the force: correct the signs, the dial's zero, or readings"
        )
        raise TandemError(_reading_issue(path, None, message))
    ratio = forces[-1] / (dials[-1] / MM)
    if not 2.0 <= ratio <= 20_000.0:
        message = f"{forces[-1]:g} N for {dials[-1] / MM:.4g} mm is not plausible for a clamped sheet; "
        raise TandemError(_reading_issue(path, None, f"{message}state forces in N and the dial in mm"))


def _read_text(path: Path) -> str:
    """Return the text of a file, or raise ``TandemError`` (forming.plate_test)."""
    if not is_file(path):
        raise TandemError(_reading_issue(path, None, f"{missing_file_reason(path)}; check the path"))
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise TandemError(
                _reading_issue(path, None, f"is larger than the limit of {MAX_FILE_BYTES / 1e6:g} MB")
            )
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        message = f"cannot be read ({error.strerror}); check the path"
        raise TandemError(_reading_issue(path, None, message)) from error
    except (UnicodeDecodeError, ValueError) as error:
        raise TandemError(_reading_issue(path, None, "is not text in UTF-8; save it as CSV")) from error


def _reading_issue(path: Path, line: int | None, message: str) -> Issue:
    location = f", line {line}" if line is not None else ""
    return Issue("forming.plate_test", f"{path.name}{location}: {message}", file=str(path), line=line)
