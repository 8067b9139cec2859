"""Calibration of a foam from test cuts: reading the file of cuts, and fitting chi and offset.

The CSV file lists measured squares, or the kerf itself. The fitted law is kerf = chi * ideal - offset
(`models`), by least squares or robustly (Huber's weights, then Tukey's).
"""

import csv
import dataclasses
import math
from pathlib import Path
from typing import Final

import numpy as np
from scipy.special import ndtr

from planner.catalogue.materials import FoamMaterial, KerfFit, KerfTests
from planner.files import is_file, missing_file_reason
from planner.geometry.arrays import BoolArray, FloatArray
from planner.geometry.units import MM, measurement
from planner.issue_codes import format_message
from planner.issues import Issue, TandemError, issue_error
from planner.processes.hotwire.plan.kerf import models
from planner.processes.hotwire.plan.kerf.cut_measurements import CutMeasurements
from planner.processes.hotwire.plan.kerf.width import USABLE_KERF_RANGE_M

HUBER_THRESHOLD: Final = 1.345
"""Number of standard deviations beyond which residuals get less weight.

With this value the efficiency is 95 % of least squares if no reading is wrong. Source: Huber, Robust
Statistics, 1981.
"""
TUKEY_THRESHOLD: Final = 4.685
"""Number of standard deviations beyond which residuals get no weight, at the same efficiency of 95 %.

Source: Beaton and Tukey, 1974.
"""
MIN_CUTS: Final = 4
"""Minimum number of test cuts for a fit."""


@dataclasses.dataclass(frozen=True)
class FitReport:
    """A fit and the cuts that it uses.

    Attributes:
        fit: The fitted line.
        hot: Whether a cut is left out as too hot (N,).
        cold: Whether a cut is left out as too cold (N,).
        residuals: Measured minus fitted width of all cuts (N,) [m].
    """

    fit: KerfFit
    hot: BoolArray
    cold: BoolArray
    residuals: FloatArray

    @property
    def kept(self) -> BoolArray:
        """Whether a cut is used by the fit (N,)."""
        return ~(self.hot | self.cold)


def fit_least_squares(
    foam: FoamMaterial, cuts: CutMeasurements, thickness: float, diameter: float
) -> KerfFit:
    """Fit a straight line through kerf over ideal width by least squares. All cuts have the same weight.

    Args:
        foam: Foam, for its density and heat.
        cuts: The test cuts.
        thickness: Thickness of the foam in the tests [m].
        diameter: Diameter of the wire in the tests [m].

    Raises:
        TandemError: kerf.few_cuts.
    """
    return _fit_line(foam, cuts, np.ones(len(cuts)), thickness, diameter)


@dataclasses.dataclass(frozen=True)
class CutFile:
    """Test cuts of a file.

    Attributes:
        cuts: The N cuts.
        thickness: Thickness of the foam, one for all cuts [m].
        burnt: Whether the file states that a cut is burnt (N,).
        dragging: Whether the file states that the wire dragged in a cut (N,).
        good: Whether the file states that a cut is good (N,).
    """

    cuts: CutMeasurements
    thickness: float
    burnt: BoolArray
    dragging: BoolArray
    good: BoolArray


def fit_robust(foam: FoamMaterial, cut_file: CutFile, diameter: float) -> FitReport:
    """Fit a straight line through kerf over ideal width, robust against a few wrong readings.

    Burnt and dragging cuts are left out. Cuts not known to be good are also left out if the line itself gives
    a kerf outside 0.8 to 3 mm, as too cold or too hot. The fit is repeated until no more cuts are left out.
    The criterion is the line and not the reading, because selecting cuts by their readings would bias the
    line.

    Args:
        foam: Foam, for its density and heat.
        cut_file: The N test cuts, with those that are known to be burnt, to drag or to be good.
        diameter: Diameter of the wire in the tests [m].

    Raises:
        TandemError: kerf.few_cuts, kerf.no_trend.
    """
    cuts, thickness = cut_file.cuts, cut_file.thickness
    burnt, dragging, good = cut_file.burnt, cut_file.dragging, cut_file.good
    ideal = models.ideal_width(foam, cuts.power_per_length, cuts.speed)
    hot, cold = burnt, dragging & ~burnt
    fixed_hot, fixed_cold, is_fixed = hot, cold, hot | cold | good
    seen: set[bytes] = set()
    while True:
        kept = ~(hot | cold)
        fit = _fit_reweighted(foam, cuts.select(kept), thickness, diameter, (int(hot.sum()), int(cold.sum())))
        expected = fit.chi * ideal - fit.offset
        next_hot = np.where(is_fixed, fixed_hot, expected > USABLE_KERF_RANGE_M[1])
        next_cold = np.where(is_fixed, fixed_cold, expected < USABLE_KERF_RANGE_M[0])
        if np.array_equal(next_hot, hot) and np.array_equal(next_cold, cold):
            break
        key = next_hot.tobytes() + next_cold.tobytes()
        if key in seen:  # the selection cycles: a cut that either of both states leaves out stays left out
            next_hot, next_cold = next_hot | hot, (next_cold | cold) & ~(next_hot | hot)
            fixed_hot, fixed_cold, is_fixed = next_hot, next_cold, np.ones_like(is_fixed)
        seen.add(key)
        hot, cold = next_hot, next_cold
    # the fastest burnt cut bounds usable speeds if all cuts that the fit uses were faster
    max_burnt_speed = cuts.speed[burnt].max() if np.any(burnt) else -np.inf
    is_bound = np.any(burnt) and max_burnt_speed < cuts.speed[kept].min()
    burnt_speed = float(max_burnt_speed) if is_bound else None
    fit = dataclasses.replace(fit, tests=dataclasses.replace(fit.tests, burnt_speed=burnt_speed))
    return FitReport(fit, hot, cold, cuts.width - expected)


def _fit_reweighted(
    foam: FoamMaterial, cuts: CutMeasurements, thickness: float, diameter: float, left_out: tuple[int, int]
) -> KerfFit:
    """Fit by iteratively reweighted least squares, with residuals scaled by their median.

    Iterations with Huber's weights start from the least-squares line. Iterations with Tukey's weights follow,
    which ignore distant readings. ``left_out`` are the numbers of cuts left out as too hot and too cold, for
    messages.

    Raises:
        TandemError: ``kerf.few_cuts``, ``kerf.no_trend``.
    """
    if len(cuts) < MIN_CUTS:
        raise TandemError(_few_cuts_issue(len(cuts), left_out))
    ideal = models.ideal_width(foam, cuts.power_per_length, cuts.speed)
    fit = _fit_line(foam, cuts, np.ones(len(cuts)), thickness, diameter, left_out)
    scale = _residual_scale(fit, ideal, cuts)
    for weigh in (_huber_weights, _tukey_weights):
        for _ in range(100):
            if scale < 1e-9:
                break
            weights = weigh((cuts.width - (fit.chi * ideal - fit.offset)) / scale)
            previous, fit = fit, _fit_line(foam, cuts, weights, thickness, diameter, left_out)
            scale = _residual_scale(fit, ideal, cuts)
            if abs(fit.chi - previous.chi) < 1e-9:
                break
    if fit.chi <= 0.0:
        text = format_message("kerf.no_trend", chi=fit.chi)
        raise issue_error("kerf.no_trend", text, hint="check the columns and units of the file")
    # spread: standard deviation of residuals clipped at Huber's threshold, corrected for the clipping
    clipped = np.clip(
        cuts.width - (fit.chi * ideal - fit.offset), -HUBER_THRESHOLD * scale, HUBER_THRESHOLD * scale
    )
    spread = np.sqrt(np.sum(clipped**2) / (len(cuts) - 2) / _clipped_variance(HUBER_THRESHOLD))
    return dataclasses.replace(fit, spread=float(spread))


def _residual_scale(fit: KerfFit, ideal: FloatArray, cuts: CutMeasurements) -> float:
    """Return the standard deviation [m] of normal residuals, from the median of their absolute values."""
    return 1.4826 * float(np.median(np.abs(cuts.width - (fit.chi * ideal - fit.offset))))


def _huber_weights(scaled: FloatArray) -> FloatArray:
    return np.asarray(np.minimum(1.0, HUBER_THRESHOLD / np.maximum(np.abs(scaled), 1e-12)))


def _tukey_weights(scaled: FloatArray) -> FloatArray:
    return np.asarray(np.maximum(1.0 - (scaled / TUKEY_THRESHOLD) ** 2, 0.0) ** 2)


def _clipped_variance(bound: float) -> float:
    """Return the variance of a standard normal variable that is clipped to [-bound, bound]."""
    inside = 2.0 * float(ndtr(bound)) - 1.0
    density = math.exp(-0.5 * bound**2) / math.sqrt(2.0 * math.pi)
    return inside - 2.0 * bound * density + bound**2 * (1.0 - inside)


def _fit_line(
    foam: FoamMaterial,
    cuts: CutMeasurements,
    weights: FloatArray,
    thickness: float,
    diameter: float,
    left_out: tuple[int, int] = (0, 0),
) -> KerfFit:
    """Fit kerf = chi * ideal width - offset by weighted least squares.

    Raises:
        TandemError: ``kerf.few_cuts`` for fewer than 3 cuts, or ideal widths that are almost equal.
    """
    if len(cuts) < 3:
        raise TandemError(_few_cuts_issue(len(cuts), left_out))
    ideal = models.ideal_width(foam, cuts.power_per_length, cuts.speed)
    total_weight = float(weights.sum())
    mean, mean_width = float(weights @ ideal) / total_weight, float(weights @ cuts.width) / total_weight
    scatter = float(weights @ (ideal - mean) ** 2)
    if scatter <= 1e-6 * total_weight * mean**2:
        raise TandemError(_few_cuts_issue(len(cuts), left_out))
    chi = float(weights @ ((ideal - mean) * (cuts.width - mean_width))) / scatter
    residuals = cuts.width - mean_width - chi * (ideal - mean)
    return KerfFit(
        chi=chi,
        offset=chi * mean - mean_width,
        spread=float(np.sqrt(weights @ residuals**2 / (len(cuts) - 2))),
        count=len(cuts),
        mean_ideal=mean,
        scatter=scatter,
        tests=KerfTests(
            power_per_length=(float(cuts.power_per_length.min()), float(cuts.power_per_length.max())),
            speed=(float(cuts.speed.min()), float(cuts.speed.max())),
            thickness=thickness,
            wire_diameter=diameter,
        ),
    )


def _few_cuts_issue(count: int, left_out: tuple[int, int]) -> Issue:
    """Return ``kerf.few_cuts`` for a number of usable cuts and those left out as too hot and too cold."""
    hot, cold = left_out
    text = format_message(
        "kerf.few_cuts", usable_count=count, hot_count=hot, cold_count=cold, min_count=MIN_CUTS
    )
    usable_range = f"{USABLE_KERF_RANGE_M[0] / MM:g} to {USABLE_KERF_RANGE_M[1] / MM:g} mm"
    hint = f"cut squares whose kerf is {usable_range}, at two powers and four speeds"
    return Issue("kerf.few_cuts", text, value=float(count), limit=float(MIN_CUTS), hint=hint)


MAX_TEST_CUT_BYTES: Final = 2_000_000
"""Maximum size of a file of test cuts [bytes]. Larger files are refused unread."""
NUMBER_COLUMNS: Final = {
    "power_w": (0.0, 1e5),
    "speed_mm_s": (0.0, 1e3),
    "kerf_mm": (-1e3, 1e3),
    "measured_side_mm": (0.0, 1e4),
    "nominal_side_mm": (0.0, 1e4),
    "wire_length_mm": (0.0, 1e5),
    "thickness_mm": (0.0, 1e5),
}
"""Numeric columns with their range: above the first value and up to the second."""
FACE_VALUES: Final = ("ok", "burnt", "dragging")
"""Allowed values of the column ``face``."""
IGNORED_COLUMNS: Final = ("voltage_v", "current_a", "note")
"""Columns for the user's records. They are not read."""


CsvRow = tuple[int, dict[str, str]]
"""Line number and values by heading."""


def read_cuts(path: Path, diameter: float, wire_length: float | None, thickness: float | None) -> CutFile:
    """Read test cuts from a CSV file.

    Columns: power_w, speed_mm_s, and either kerf_mm or measured_side_mm with nominal_side_mm. (A square along
    whose path the centre of the wire moves loses half a kerf on each side, so its side is one kerf short.)
    wire_length_mm and thickness_mm are required unless ``wire_length`` and ``thickness`` hold for all cuts.
    Optional: face (ok, burnt, dragging), voltage_v, current_a and note. The separator is a comma, or a
    semicolon with decimal commas. Lines that begin with # are skipped.

    Args:
        path: CSV file.
        diameter: Diameter of the wire [m].
        wire_length: Heated length of the wire [m], or None if a column states it.
        thickness: Thickness of the foam [m], or None if a column states it.

    Raises:
        TandemError: ``kerf.file``, ``kerf.impossible``. Each issue has its line.
    """
    name = str(path)
    header, rows = _read_rows(path)
    issues = _heading_issues(name, header, wire_length, thickness)
    if issues:
        raise TandemError(issues)
    columns, face_values = _columns(name, header, rows)
    if "kerf_mm" in columns:
        kerf = columns["kerf_mm"]
    else:
        kerf = columns["nominal_side_mm"] - columns["measured_side_mm"]
    issues = _narrow_cut_issues(name, rows, kerf, diameter / MM)
    if "thickness_mm" in columns:
        issues += _thickness_issues(name, rows, columns["thickness_mm"])
        thickness = float(columns["thickness_mm"][0]) * MM
    if issues:
        raise TandemError(issues)
    length = columns["wire_length_mm"] * MM if "wire_length_mm" in columns else wire_length
    if length is None or thickness is None:
        raise ValueError("the headings were checked")
    cuts = CutMeasurements(columns["power_w"] / length, columns["speed_mm_s"] * MM, kerf * MM)
    good, burnt, dragging = (np.array([face == value for face in face_values]) for value in FACE_VALUES)
    return CutFile(cuts, thickness, burnt, dragging, good)


def _columns(name: str, header: list[str], rows: list[CsvRow]) -> tuple[dict[str, FloatArray], list[str]]:
    """Return the numeric columns by heading, and the column ``face``.

    Raises:
        TandemError: ``kerf.file`` for each value that is not allowed.
    """
    issues = []
    numbers: dict[str, list[float]] = {key: [] for key in header if key in NUMBER_COLUMNS}
    faces: list[str] = []
    for line, row in rows:
        faces.append(row.get("face", "").lower())
        if faces[-1] and faces[-1] not in FACE_VALUES:
            text = f"got {faces[-1]!r}, allowed {', '.join(FACE_VALUES)}"
            issues.append(Issue("kerf.file", text, file=name, line=line, field="face", hint="correct it"))
        for key, values in numbers.items():
            values.append(_number(row[key]))
            low, high = NUMBER_COLUMNS[key]
            if not (low < values[-1] <= high):
                text = f"got {row[key]!r}, allowed a number above {low:g}, at most {high:g}"
                hint = "correct it or remove the line"
                issues.append(Issue("kerf.file", text, file=name, line=line, field=key, hint=hint))
    if issues:
        raise TandemError(issues)
    return {key: np.array(values) for key, values in numbers.items()}, faces


def _narrow_cut_issues(name: str, rows: list[CsvRow], kerf: FloatArray, diameter: float) -> list[Issue]:
    """Return ``kerf.impossible`` for each cut that is not wider than the wire. Both are in mm."""
    hint = (
        "kerf is nominal minus measured side: measure the piece, not the hole, or state the wire's diameter"
    )
    return [
        Issue(
            "kerf.impossible",
            f"kerf: got {kerf[k]:.3f} mm, allowed above the wire's {diameter:g} mm",
            file=name,
            line=rows[k][0],
            **measurement(float(kerf[k]), diameter, "mm"),
            hint=hint,
        )
        for k in np.flatnonzero(kerf <= diameter)
    ]


def _thickness_issues(name: str, rows: list[CsvRow], thickness: FloatArray) -> list[Issue]:
    """Return ``kerf.file`` for each cut in foam of another thickness [mm] than the first one."""
    first = thickness[0]
    return [
        Issue(
            "kerf.file",
            f"got {thickness[k]:g} mm after {first:g} mm, allowed one thickness in a file",
            file=name,
            line=rows[k][0],
            field="thickness_mm",
            hint="fit a foam for each thickness",
        )
        for k in np.flatnonzero(np.abs(thickness - first) > 0.01 * first)
    ]


def _heading_issues(
    name: str, header: list[str], wire_length: float | None, thickness: float | None
) -> list[Issue]:
    """Return ``kerf.file`` for unknown, repeated, missing and conflicting columns."""
    issues = []

    def add_issue(text: str, field: str, hint: str) -> None:
        issues.append(Issue("kerf.file", text, file=name, line=1, field=field, hint=hint))

    for key in sorted(set(header) - set(NUMBER_COLUMNS) - set(IGNORED_COLUMNS) - {"face"}):
        allowed = ", ".join((*NUMBER_COLUMNS, "face", *IGNORED_COLUMNS))
        add_issue(f"column: got {key!r}, allowed {allowed}", key, "remove it or correct its spelling")
    for key in sorted({key for key in header if header.count(key) > 1}):
        add_issue(f"column: got {key!r} twice, allowed once", key, "keep one")
    for key in ("power_w", "speed_mm_s"):
        if key not in header:
            add_issue("the column is missing", key, "add it")
    sides = {"measured_side_mm", "nominal_side_mm"} & set(header)
    if ("kerf_mm" in header) == bool(sides) or len(sides) == 1:
        text = "columns of the kerf: got " + (
            ", ".join(sorted(sides | ({"kerf_mm"} & set(header)))) or "none"
        )
        text += ", allowed kerf_mm alone, or measured_side_mm with nominal_side_mm"
        add_issue(text, "kerf_mm", "give one of the two")
    for key, common_value in (("wire_length_mm", wire_length), ("thickness_mm", thickness)):
        if key not in header and common_value is None:
            add_issue(
                f"{key}: got neither a column nor a value, allowed one of them",
                key,
                f"add --{key.replace('_', '-')}",
            )
    return issues


def _read_rows(path: Path) -> tuple[list[str], list[CsvRow]]:
    """Return the headings and rows of a CSV file of test cuts, without empty lines and comments.

    Raises:
        TandemError: ``kerf.file``.
    """
    name = str(path)
    if not is_file(path):
        raise issue_error(
            "kerf.file", f"{name}: {missing_file_reason(path)}", file=name, hint="check the path"
        )
    try:
        if path.stat().st_size > MAX_TEST_CUT_BYTES:
            message = f"{name}: larger than {MAX_TEST_CUT_BYTES / 1e6:g} MB"
            hint = "split the file"
            raise issue_error("kerf.file", message, file=name, hint=hint)
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        message = f"{name}: cannot be read as text: {error}"
        hint = "save it as CSV, UTF-8"
        raise issue_error("kerf.file", message, file=name, hint=hint) from error
    lines = [
        (k + 1, line) for k, line in enumerate(text.splitlines()) if line.strip() and not line.startswith("#")
    ]
    if len(lines) < 2:
        text = f"{name}: got {len(lines)} lines, allowed a line of headings and one line for each cut"
        raise issue_error("kerf.file", text, file=name, hint="start the file with the headings")
    separator = ";" if ";" in lines[0][1] else ","
    parsed = list(csv.reader((line for _, line in lines), delimiter=separator))
    header = [cell.strip().lower() for cell in parsed[0]]
    issues, rows = [], []
    for (line, _), cells in zip(lines[1:], parsed[1:], strict=False):
        if len(cells) != len(header):
            text = f"{name}: got {len(cells)} values, allowed {len(header)}, one for each heading"
            issues.append(
                Issue("kerf.file", text, file=name, line=line, hint="write one value per column, no quotes")
            )
        values = [cell.strip().replace(",", ".") if separator == ";" else cell.strip() for cell in cells]
        rows.append((line, dict(zip(header, values, strict=False))))
    if issues:
        raise TandemError(issues)
    return header, rows


def _number(text: str) -> float:
    """Return the number in a cell, or NaN, which no range of a column includes."""
    try:
        return float(text)
    except ValueError:
        return math.nan
