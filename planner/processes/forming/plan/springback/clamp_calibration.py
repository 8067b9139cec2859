"""What a clamp does to a sheet, by a test: a flat sheet is pressed in a place, forces and a dial are read.

The readings are held against the elastic shell of the flat sheet. Three figures are asked: what the border
does in plane, from sliding by a spring to immovable; the thickness, of which the sheet's tolerance is known;
kappa, by which the sheet gives way more than the shell says.

**Response.** By the similarity of thin plates under large deflections (von Karman's equations with lengths in
the plane over a, deflections over the thickness t), w / t depends on F a^2 / (E t^4) and on the border's
spring over E t / a alone, so that curves for some borders at one thickness are enough: a test holds that
against shells of other thicknesses.

**Fit.** w = kappa t f(F a^2 / (E t^4), spring a / (E t)), with errors of the dial and of the shell side by
side, whose size the readings tell as well (Student's distribution). Kappa is linear and is integrated in
closed form; border and thickness are looked at on a grid that is drawn in twice. Intervals are the shortest
ones of 95 % (highest density), which reach the end where a border slides or does not move.
"""

import csv
import dataclasses
import io
from pathlib import Path
from typing import Final

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

from planner.files import is_file, no_file, not_by_commas
from planner.geometry.arrays import FloatArray
from planner.geometry.units import MM
from planner.issues import Issue, Severity, TandemError
from planner.shell.element import Sheet
from planner.shell.mesh import mesh_walls
from planner.shell.newton import clamped, curve

GRIPS: Final = np.array([0.0, 0.05, 0.15, 0.35, 0.6, 0.8, 0.92, 1.0])
"""Borders that are solved: spring / (spring + E t / a); 0 slides, 1 does not move."""
LOADS: Final = 9
"""Loads of each curve."""
TRIANGLES: Final = 900
"""Triangles of the flat sheet: within half a percent of six times as many."""
COLUMN: Final = 3.0 * MM
"""Width [m] of the square that is pressed on."""
MODEL_SHARE: Final = 0.004
"""What the shell may be off, as a share of its deflection."""
LEVEL: Final = 0.95
"""Share of the truths that intervals hold."""
BEFORE: Final = 3
"""Readings that the stated error counts for, against what the readings' own scatter says of it."""
COLUMNS: Final = ("force_n", "dial_mm")
"""Columns of a file of readings."""
LEAST_READINGS: Final = 6
LEAST_FORCES: Final = 5
"""Readings, and forces that differ, at least: three figures are asked."""
MOST_BYTES: Final = 1_000_000
FALL_SHARE: Final = 0.05
"""How much less, as a share of the largest, a dial may show at more force: play and scatter."""
GRID: Final = (61, 41)
"""Borders and thicknesses of a grid, each time it is drawn in."""
TOLD_SHARE: Final = 0.7
"""An interval that is wider than so much of the one before the test says that the test did not tell it."""


@dataclasses.dataclass(frozen=True)
class Plate:
    """A flat sheet: ``outline`` (K, 2) [m] of the clamp's opening, ``place`` (2,) [m] that is pressed,
    Young's modulus [Pa], Poisson's ratio, ``thickness`` [m] as ordered, and by how much it may be off (two
    standard deviations)."""

    outline: FloatArray
    place: FloatArray
    young: float
    poisson: float
    thickness: float
    tolerance: float

    @property
    def width(self) -> float:
        """A length a [m] of the opening, the root of its area."""
        x, y = self.outline.T
        return float(np.sqrt(0.5 * abs(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))))

    def spring(self, grip: float, thickness: float) -> float:
        """Stiffness [N/m^2] of the border in plane, by its length; infinite for a ``grip`` of 1."""
        if grip >= 1.0:
            return np.inf
        return grip / (1.0 - grip) * self.young * thickness / self.width


@dataclasses.dataclass(frozen=True)
class Readings:
    """What was read: ``force`` (n,) [N], ``dial`` (n,) [m], ``error`` [m] of a reading, one standard
    deviation."""

    force: FloatArray
    dial: FloatArray
    error: float


@dataclasses.dataclass(frozen=True)
class Response:
    """Deflection of a plate over load: ``load`` (L,) ln F a^2 / (E t^4), ``grip`` (G,) of the borders,
    ``bent`` (L, G) ln w / t."""

    load: FloatArray
    grip: FloatArray
    bent: FloatArray

    def at(self, load: FloatArray, grip: FloatArray) -> FloatArray:
        """ln w / t (n, g) at ``load`` (n,), ln F a^2 / (E t^4), for borders (g,)."""
        rows = CubicSpline(self.load, self.bent, axis=0)(load)
        return np.asarray(PchipInterpolator(self.grip, rows, axis=1)(grip))


def respond(plate: Plate, most: float, least: float, triangles: int = TRIANGLES) -> Response:
    """The response of a plate to forces from ``least`` to ``most`` [N], by shells of its ordered thickness.

    Raises ``ValueError`` where so few triangles do not do, `LimitLoadError` where the sheet does not."""
    # thickness counts by its fourth power: what is thinner by the tolerance sees more load
    spread = (1.0 + 2.5 * plate.tolerance / plate.thickness) ** 4
    forces = np.geomspace(0.7 * least / spread, 1.1 * most * spread, LOADS)
    made = mesh_walls([], plate.outline, triangles, plate.place[None])
    thick = np.full(len(made.triangles), plate.thickness)
    sheet = Sheet(made.nodes, made.triangles, thick, plate.young, plate.poisson)
    bent = []
    for grip in GRIPS:
        border: str | float = plate.spring(grip, plate.thickness)
        border = "sliding" if grip == 0.0 else "immovable" if grip == 1.0 else border
        loads = np.stack([np.zeros(LOADS), np.zeros(LOADS), -forces], axis=1)
        moved = curve(sheet, clamped(sheet, border), plate.place, loads, COLUMN)
        bent.append(np.log(-moved[:, 2] / plate.thickness))
    return Response(_load(plate, forces, plate.thickness), GRIPS, np.stack(bent, axis=1))


def _load(plate: Plate, force: FloatArray, thickness: float) -> FloatArray:
    return np.asarray(np.log(force * plate.width**2 / (plate.young * thickness**4)))


@dataclasses.dataclass(frozen=True)
class Estimate:
    """A figure, its interval of `LEVEL`, and whether the test told it or it is as it was before."""

    value: float
    low: float
    high: float
    told: bool


@dataclasses.dataclass(frozen=True)
class Calibration:
    """What readings say: ``grip`` of the border (0 slides, 1 does not move), ``spring`` [N/m^2] of it at the
    found thickness, infinite at 1; ``thickness`` [m]; ``kappa`` [-]; ``left`` (n,) [m], readings less the
    best fit; ``tied``: how grip, thickness and kappa move with one another (3, 3), correlations."""

    grip: Estimate
    spring: Estimate
    thickness: Estimate
    kappa: Estimate
    left: FloatArray
    tied: FloatArray

    @property
    def border(self) -> str:
        """The word of a problem's clamp: sliding, immovable or spring; the end where it may be the end."""
        if self.grip.low <= 0.0 and self.grip.high >= 1.0:
            return "unknown"
        return "sliding" if self.grip.low <= 0.0 else "immovable" if self.grip.high >= 1.0 else "spring"


def calibrate(plate: Plate, readings: Readings, response: Response) -> Calibration:
    """What the border does, how thick the sheet is and kappa, each with its interval."""
    spread = 0.5 * plate.tolerance
    grip = (0.0, 1.0)
    thick = (plate.thickness - 4.0 * spread, plate.thickness + 4.0 * spread)
    for _ in range(3):
        found = _Grid.of(plate, readings, response, grip, thick)
        grip, thick = found.bounds()
    return found.calibration(plate, readings, response)


@dataclasses.dataclass(frozen=True)
class _Grid:
    """A grid over borders (g,) and thicknesses (h,) [m]: ``weight`` (g, h), sum 1; kappa's mean and scale
    (g, h) there by Student's distribution of ``freedom`` degrees."""

    grip: FloatArray
    thick: FloatArray
    weight: FloatArray
    mean: FloatArray
    scale: FloatArray
    freedom: int

    @staticmethod
    def of(
        plate: Plate,
        readings: Readings,
        response: Response,
        grips: tuple[float, float],
        thicks: tuple[float, float],
    ) -> "_Grid":
        grip, thick = np.linspace(*grips, GRID[0]), np.linspace(*thicks, GRID[1])
        sure = 1.0 / (readings.error**2 + (MODEL_SHARE * readings.dial) ** 2)
        shape = np.stack(
            [t * np.exp(response.at(_load(plate, readings.force, t), grip)) for t in thick], axis=2
        )
        own = np.einsum("n,ngh,ngh->gh", sure, shape, shape)
        both = np.einsum("n,n,ngh->gh", sure, readings.dial, shape)
        mean = both / own
        left = np.maximum(np.sum(sure * readings.dial**2) - mean * both, 1e-12)
        count = len(readings.dial)
        # the size of the errors is hardly known; of kappa, above zero, each ratio counts alike
        freedom = count - 1 + BEFORE
        left = left + BEFORE
        log = -0.5 * freedom * np.log(left) - 0.5 * np.log(own) - np.log(mean)
        log -= 0.5 * ((thick - plate.thickness) / (0.5 * plate.tolerance)) ** 2
        weight = np.exp(log - log.max())
        return _Grid(grip, thick, weight / weight.sum(), mean, np.sqrt(left / (freedom * own)), freedom)

    def bounds(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """What of border and thickness counts at all, with a cell more."""
        out = []
        for values, share in ((self.grip, self.weight.sum(axis=1)), (self.thick, self.weight.sum(axis=0))):
            some = np.flatnonzero(share > 1e-5 * share.max())
            low, high = max(some[0] - 1, 0), min(some[-1] + 1, len(values) - 1)
            out.append((float(values[low]), float(values[high])))
        return out[0], out[1]

    def kappas(self) -> tuple[FloatArray, FloatArray]:
        """Values (K,) of kappa and their weights."""
        wide = 8.0 * np.sqrt(np.sum(self.weight * ((self.mean - self._centre()) ** 2 + self.scale**2)))
        values = np.linspace(self._centre() - wide, self._centre() + wide, 801)
        some = self.weight > 1e-7 * self.weight.max()
        mean, scale, weight = self.mean[some], self.scale[some], self.weight[some]
        share = np.zeros(len(values))
        for first in range(0, len(mean), 512):
            part = slice(first, first + 512)
            off = (values[:, None] - mean[part]) / scale[part]
            density = (1.0 + off**2 / self.freedom) ** (-0.5 * (self.freedom + 1)) / scale[part]
            share += density @ weight[part]
        return values, share / share.sum()

    def _centre(self) -> float:
        return float(np.sum(self.weight * self.mean))

    def calibration(self, plate: Plate, readings: Readings, response: Response) -> Calibration:
        """The figures with their intervals."""
        at_grip, at_thick = self.weight.sum(axis=1), self.weight.sum(axis=0)
        kappa, at_kappa = self.kappas()
        best = np.unravel_index(int(np.argmax(self.weight)), self.weight.shape)
        grip = _estimate(self.grip, at_grip, 1.0, float(self.grip[best[0]]))
        before = 2.0 * 1.96 * 0.5 * plate.tolerance
        thick = _estimate(self.thick, at_thick, before, float(self.thick[best[1]]))
        factor = _estimate(kappa, at_kappa, np.inf, float(self.mean[best]))
        value, low, high = (plate.spring(one, thick.value) for one in (grip.value, grip.low, grip.high))
        spring = Estimate(value, low, high, grip.told)
        shape = thick.value * np.exp(
            response.at(_load(plate, readings.force, thick.value), np.array([grip.value]))
        )
        left = readings.dial - float(self.mean[best]) * shape[:, 0]
        return Calibration(grip, spring, thick, factor, left, self._tied())

    def _tied(self) -> FloatArray:
        """Correlations (3, 3) of border, thickness and kappa."""
        rows = [
            np.broadcast_to(v, self.weight.shape).reshape(-1)
            for v in (self.grip[:, None], self.thick, self.mean)
        ]
        spread = np.cov(np.stack(rows), aweights=self.weight.reshape(-1), ddof=0)
        spread[2, 2] += np.sum(self.weight * self.scale**2)
        size = np.sqrt(np.maximum(np.diag(spread), 1e-30))
        return np.asarray(spread / size / size[:, None])


def _estimate(values: FloatArray, share: FloatArray, before: float, best: float) -> Estimate:
    """The shortest interval of `LEVEL` around the best value; told if shorter than that ``before``."""
    order = np.argsort(-share, kind="stable")
    count = int(np.searchsorted(np.cumsum(share[order]), LEVEL * share.sum())) + 1
    some = np.sort(order[:count])
    half = 0.5 * (values[1] - values[0])
    low, high = float(values[some[0]] - half), float(values[some[-1]] + half)
    low, high = max(low, float(values[0])), min(high, float(values[-1]))
    return Estimate(best, low, high, high - low < TOLD_SHARE * before)


TIED: Final = 0.8
"""Correlation from which two figures count as not told apart."""
_NAMES: Final = ("the border", "the thickness", "kappa")


def unclear(found: Calibration, plate: Plate, readings: Readings, assumed: bool) -> tuple[Issue, ...]:
    """What the readings do not tell, or not apart, as warnings (``forming.clamp_unclear``). ``assumed``:
    nobody has stated the thickness's tolerance."""
    out = []
    deep = float(readings.dial.max()) / plate.thickness
    if not found.grip.told:
        what = f"the border may be anything from {_grip(found.grip.low)} to {_grip(found.grip.high)}: the "
        what += f"sheet sank by {deep:.1f} of its thickness; press harder, until it sinks by three or more"
        out.append(what)
    if not found.thickness.told:
        what = "the readings do not tell the thickness, which is as you stated it, within "
        what += f"{plate.tolerance / MM:.3g} mm"
        if assumed:
            what += " as assumed; measure it, and state how far it may be off (--thickness-tol-mm)"
        out.append(what)
    tied = np.abs(found.tied) > TIED
    some = [name for k, name in enumerate(_NAMES) if np.count_nonzero(tied[k]) > 1]
    if some:
        what = f"{', '.join(some[:-1])} and {some[-1]} go together: others of their intervals at once read "
        what += "nearly the same; measure the thickness to a hundredth, press lightly and hard, and take "
        what += "more "
        out.append(f"{what}readings")
    return tuple(Issue("forming.clamp_unclear", what, Severity.WARNING) for what in out)


def _grip(value: float) -> str:
    return "sliding" if value <= 0.0 else "immovable" if value >= 1.0 else f"a grip of {value:.2f}"


def read_readings(path: Path, error: float) -> Readings:
    """Readings from a CSV file with the columns force_n [N] and dial_mm [mm], the way down under the force;
    what the dial shows without force is taken off. Lines that begin with # are skipped.

    Raises `TandemError` (``forming.plate_test``) with every fault and its line: other columns and units,
    what is no number, forces below 0, too few readings, dials that do not rise with the force.
    """
    lines = _text(path).splitlines()
    kept = [(number, line) for number, line in enumerate(lines, 1) if line.strip() and line[:1] != "#"]
    rows = list(csv.reader(io.StringIO("\n".join(line for _, line in kept))))
    header = [name.strip().lower() for name in rows[0]] if rows else []
    other = not_by_commas(kept[0][1]) if kept else None
    if other is not None:
        raise TandemError(_wrong(path, kept[0][0], other))
    if sorted(header) != sorted(COLUMNS):
        got = ", ".join(header)[:80] or "nothing"
        what = f"the columns are {got}; wanted: {', '.join(COLUMNS)} (newtons, millimetres, decimal points)"
        raise TandemError(_wrong(path, 1, what))
    issues, values = list[Issue](), list[tuple[float, float]]()
    for (number, _), row in zip(kept[1:], rows[1:], strict=True):
        try:
            force, dial = (float(row[header.index(name)]) for name in COLUMNS)
            if len(row) != len(header) or not np.isfinite([force, dial]).all():
                raise ValueError
        except (ValueError, IndexError):
            issues.append(_wrong(path, number, f"got {','.join(row)[:60]!r}; wanted two finite numbers"))
            continue
        if force < 0.0:
            issues.append(_wrong(path, number, f"the force is {force:g} N; forces press down, above 0 N"))
        values.append((force, dial))
    if issues:
        raise TandemError(issues)
    forces, dials = np.array(values, dtype=np.float64).reshape(-1, 2).T
    idle = forces == 0.0
    dials = dials - (float(dials[idle].mean()) if idle.any() else 0.0)
    order = np.argsort(forces[~idle], kind="stable")
    forces, dials = forces[~idle][order], dials[~idle][order] * MM
    _require_plausible(path, forces, dials)
    return Readings(forces, dials, error)


def _require_plausible(path: Path, forces: FloatArray, dials: FloatArray) -> None:
    count, different = len(forces), len(np.unique(forces))
    if count < LEAST_READINGS or different < LEAST_FORCES:
        what = f"{count} readings under {different} forces; wanted: {LEAST_READINGS} under {LEAST_FORCES} "
        raise TandemError(_wrong(path, None, f"{what}forces at least, from a tenth of the largest on"))
    most = np.maximum.accumulate(dials)
    k = int(np.argmax(most - dials))
    if dials.min() <= 0.0 or dials[-1] <= dials[0] or most[k] - dials[k] > FALL_SHARE * most[-1]:
        k = k if dials.min() > 0.0 else int(np.argmin(dials))
        what = f"the dial shows {dials[k] / MM:.3f} mm at {forces[k]:g} N"
        what += f", and {most[k] / MM:.3f} mm at less" if most[k] > dials[k] else ""
        what += "; under more force a sheet sinks deeper: correct the signs, the dial's zero, or readings"
        raise TandemError(_wrong(path, None, what))
    ratio = forces[-1] / (dials[-1] / MM)
    if not 2.0 <= ratio <= 20_000.0:
        what = f"{forces[-1]:g} N for {dials[-1] / MM:.4g} mm is no sheet in a frame; "
        raise TandemError(_wrong(path, None, f"{what}forces are wanted in N, the dial in mm"))


def _text(path: Path) -> str:
    if not is_file(path):
        raise TandemError(_wrong(path, None, f"{no_file(path)}; check the path"))
    try:
        if path.stat().st_size > MOST_BYTES:
            raise TandemError(_wrong(path, None, f"is over {MOST_BYTES / 1e6:g} MB, which no such test is"))
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        what = f"cannot be read ({error.strerror}); check the path"
        raise TandemError(_wrong(path, None, what)) from error
    except (UnicodeDecodeError, ValueError) as error:
        raise TandemError(_wrong(path, None, "is not text in UTF-8; save it as CSV")) from error


def _wrong(path: Path, line: int | None, what: str) -> Issue:
    where = f", line {line}" if line is not None else ""
    return Issue("forming.plate_test", f"{path.name}{where}: {what}", file=str(path), line=line)
