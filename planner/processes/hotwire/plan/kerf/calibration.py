"""Calibration of a foam from test cuts: the file of cuts, and chi and offset fitted to them.

The CSV file has what was measured on squares, or the kerf itself. The fit is of kerf = chi * ideal
- offset (`models`), by least squares or robustly (Huber's, then Tukey's weights).
"""

import csv
import dataclasses
import math
from pathlib import Path
from typing import Final

import numpy as np
from scipy.special import ndtr

from planner.catalogue.materials import Foam, KerfFit, KerfTests
from planner.files import is_file, no_file
from planner.geometry.arrays import BoolArray, FloatArray
from planner.geometry.units import MM, measurement
from planner.issues import Issue, TandemError, refusal
from planner.processes.hotwire.plan.kerf import models
from planner.processes.hotwire.plan.kerf.test_cuts import Cuts
from planner.processes.hotwire.plan.kerf.width import USABLE_KERFS

HUBER: Final = 1.345
"""Residuals beyond so many standard deviations count less: 95 % as good as least squares where none is wrong
(Huber, Robust Statistics, 1981)."""
TUKEY: Final = 4.685
"""Residuals beyond so many do not count, at the same efficiency (Beaton and Tukey, 1974)."""
FEWEST_CUTS: Final = 4
"""A curve is fitted to this many test cuts at least."""


@dataclasses.dataclass(frozen=True)
class FitReport:
    """``fit`` and how it came about: masks (N,) of the cuts left out as ``hot`` or ``cold``, ``residuals``
    (N,) [m], measured less fitted, of all cuts."""

    fit: KerfFit
    hot: BoolArray
    cold: BoolArray
    residuals: FloatArray

    @property
    def kept(self) -> BoolArray:
        """The cuts that count."""
        return ~(self.hot | self.cold)


def least_squares(foam: Foam, cuts: Cuts, thickness: float, diameter: float) -> KerfFit:
    """Straight line through kerf over ideal width: every cut counts.

    ``foam`` gives density and heat, ``thickness`` and ``diameter`` [m] are those of the tests. Raises
    `TandemError`: kerf.few_cuts.
    """
    return _line(foam, cuts, np.ones(len(cuts)), thickness, diameter)


def robust(
    foam: Foam,
    cuts: Cuts,
    burnt: BoolArray,
    dragging: BoolArray,
    good: BoolArray,
    thickness: float,
    diameter: float,
) -> FitReport:
    """Straight line that a few wrong readings do not turn, over the cuts that are neither ``burnt`` nor
    ``dragging`` (N,).

    Cuts that are not known to be ``good`` (N,) are left out too where the line itself gives a kerf outside
    0.8 to 3 mm, as too cold or too hot, and the line is drawn again until none is left; by the line and not
    by the reading, because choosing cuts by their readings would bend the line. Raises `TandemError`:
    kerf.few_cuts, kerf.no_trend.
    """
    ideal = models.ideal(foam, cuts.power_per_length, cuts.speed)
    hot, cold = burnt, dragging & ~burnt
    known_hot, known_cold, known = hot, cold, hot | cold | good
    seen: set[bytes] = set()
    while True:
        kept = ~(hot | cold)
        fit = _draw(foam, cuts.only(kept), thickness, diameter, (int(hot.sum()), int(cold.sum())))
        expected = fit.chi * ideal - fit.offset
        now_hot = np.where(known, known_hot, expected > USABLE_KERFS[1])
        now_cold = np.where(known, known_cold, expected < USABLE_KERFS[0])
        if np.array_equal(now_hot, hot) and np.array_equal(now_cold, cold):
            break
        key = now_hot.tobytes() + now_cold.tobytes()
        if key in seen:  # it goes round: out stays what was out before or after
            now_hot, now_cold = now_hot | hot, (now_cold | cold) & ~(now_hot | hot)
            known_hot, known_cold, known = now_hot, now_cold, np.ones_like(known)
        seen.add(key)
        hot, cold = now_hot, now_cold
    slowest = cuts.speed[burnt].max() if np.any(burnt) else -np.inf
    burnt_speed = float(slowest) if np.any(burnt) and slowest < cuts.speed[kept].min() else None
    fit = dataclasses.replace(fit, tests=dataclasses.replace(fit.tests, burnt_speed=burnt_speed))
    return FitReport(fit, hot, cold, cuts.width - expected)


def _draw(foam: Foam, cuts: Cuts, thickness: float, diameter: float, left_out: tuple[int, int]) -> KerfFit:
    """Iteratively reweighted least squares, residuals scaled by their median: with Huber's weights from a
    plain line, then with Tukey's, under which readings far off do not count at all."""
    if len(cuts) < FEWEST_CUTS:
        raise TandemError(_few(len(cuts), left_out))
    ideal = models.ideal(foam, cuts.power_per_length, cuts.speed)
    fit = _line(foam, cuts, np.ones(len(cuts)), thickness, diameter, left_out)
    scale = _scale(fit, ideal, cuts)
    for weigh in (_huber, _tukey):
        for _ in range(100):
            if scale < 1e-9:
                break
            weights = weigh((cuts.width - (fit.chi * ideal - fit.offset)) / scale)
            before, fit = fit, _line(foam, cuts, weights, thickness, diameter, left_out)
            scale = _scale(fit, ideal, cuts)
            if abs(fit.chi - before.chi) < 1e-9:
                break
    if fit.chi <= 0.0:
        text = f"test cuts: got a kerf that falls with power over speed (chi {fit.chi:.2f}), allowed a rise"
        raise refusal("kerf.no_trend", text, hint="see to the columns and units of the file")
    clipped = np.clip(cuts.width - (fit.chi * ideal - fit.offset), -HUBER * scale, HUBER * scale)
    spread = np.sqrt(np.sum(clipped**2) / (len(cuts) - 2) / _clipped_variance(HUBER))
    return dataclasses.replace(fit, spread=float(spread))


def _scale(fit: KerfFit, ideal: FloatArray, cuts: Cuts) -> float:
    """Standard deviation [m] of normal residuals, from the median of their sizes."""
    return 1.4826 * float(np.median(np.abs(cuts.width - (fit.chi * ideal - fit.offset))))


def _huber(scaled: FloatArray) -> FloatArray:
    return np.asarray(np.minimum(1.0, HUBER / np.maximum(np.abs(scaled), 1e-12)))


def _tukey(scaled: FloatArray) -> FloatArray:
    return np.asarray(np.maximum(1.0 - (scaled / TUKEY) ** 2, 0.0) ** 2)


def _clipped_variance(bound: float) -> float:
    """Variance of a standard normal value that is clipped at both sides."""
    inside = 2.0 * float(ndtr(bound)) - 1.0
    density = math.exp(-0.5 * bound**2) / math.sqrt(2.0 * math.pi)
    return inside - 2.0 * bound * density + bound**2 * (1.0 - inside)


def _line(
    foam: Foam,
    cuts: Cuts,
    weights: FloatArray,
    thickness: float,
    diameter: float,
    left_out: tuple[int, int] = (0, 0),
) -> KerfFit:
    if len(cuts) < 3:
        raise TandemError(_few(len(cuts), left_out))
    ideal = models.ideal(foam, cuts.power_per_length, cuts.speed)
    total = float(weights.sum())
    mean, mean_width = float(weights @ ideal) / total, float(weights @ cuts.width) / total
    scatter = float(weights @ (ideal - mean) ** 2)
    if scatter <= 1e-6 * total * mean**2:
        raise TandemError(_few(len(cuts), left_out))
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


def _few(count: int, left_out: tuple[int, int]) -> Issue:
    hot, cold = left_out
    text = (
        f"test cuts: got {count} that can be used ({hot} too hot, {cold} too cold left out), "
        f"allowed {FEWEST_CUTS} or more, at two speeds or powers at least"
    )
    wanted = f"{USABLE_KERFS[0] / MM:g} to {USABLE_KERFS[1] / MM:g} mm"
    hint = f"cut squares whose kerf is {wanted}, at two powers and four speeds"
    return Issue("kerf.few_cuts", text, value=float(count), limit=float(FEWEST_CUTS), hint=hint)


MAX_TEST_CUT_BYTES: Final = 2_000_000
"""Files of test cuts larger than this [bytes] are refused unread."""
NUMBER_COLUMNS: Final = {
    "power_w": (0.0, 1e5),
    "speed_mm_s": (0.0, 1e3),
    "kerf_mm": (-1e3, 1e3),
    "measured_side_mm": (0.0, 1e4),
    "nominal_side_mm": (0.0, 1e4),
    "wire_length_mm": (0.0, 1e5),
    "thickness_mm": (0.0, 1e5),
}
"""Columns of numbers, above the first and up to the second value."""
FACE_WORDS: Final = ("ok", "burnt", "dragging")
"""What the column ``face`` may say."""
IGNORED_COLUMNS: Final = ("voltage_v", "current_a", "note")
"""Columns that people keep and nothing reads."""


Row = tuple[int, dict[str, str]]
"""A line's number and its values by heading."""


@dataclasses.dataclass(frozen=True)
class CutFile:
    """``cuts`` (N,) of a file in foam of one ``thickness`` [m]; ``burnt`` and ``dragging`` (N,) as it
    says."""

    cuts: Cuts
    thickness: float
    burnt: BoolArray
    dragging: BoolArray
    good: BoolArray


def read_cuts(path: Path, diameter: float, wire_length: float | None, thickness: float | None) -> CutFile:
    """Test cuts from a CSV file, for a wire of ``diameter`` [m].

    Columns: power_w, speed_mm_s, and either kerf_mm or measured_side_mm with nominal_side_mm (a square whose
    path the wire's middle goes loses half a kerf on each side, so its side is one whole kerf short);
    wire_length_mm and thickness_mm unless ``wire_length`` and ``thickness`` [m] stand for all; face (ok,
    burnt, dragging), voltage_v, current_a and note if you like. Commas, or semicolons with decimal commas;
    lines that begin with # are skipped. Raises `TandemError` with every fault and its line: kerf.file,
    kerf.impossible.
    """
    name = str(path)
    header, rows = _rows(path)
    issues = _headings(name, header, wire_length, thickness)
    if issues:
        raise TandemError(issues)
    columns, faces = _columns(name, header, rows)
    if "kerf_mm" in columns:
        kerf = columns["kerf_mm"]
    else:
        kerf = columns["nominal_side_mm"] - columns["measured_side_mm"]
    issues = _narrow(name, rows, kerf, diameter / MM)
    if "thickness_mm" in columns:
        issues += _uneven(name, rows, columns["thickness_mm"])
        thickness = float(columns["thickness_mm"][0]) * MM
    if issues:
        raise TandemError(issues)
    length = columns["wire_length_mm"] * MM if "wire_length_mm" in columns else wire_length
    if length is None or thickness is None:
        raise ValueError("the headings were checked")
    cuts = Cuts(columns["power_w"] / length, columns["speed_mm_s"] * MM, kerf * MM)
    good, burnt, dragging = (np.array([face == wanted for face in faces]) for wanted in FACE_WORDS)
    return CutFile(cuts, thickness, burnt, dragging, good)


def _columns(name: str, header: list[str], rows: list[Row]) -> tuple[dict[str, FloatArray], list[str]]:
    """The columns of numbers and that of faces; refuses every value that is out of range."""
    issues = []
    found: dict[str, list[float]] = {key: [] for key in header if key in NUMBER_COLUMNS}
    faces: list[str] = []
    for line, row in rows:
        faces.append(row.get("face", "").lower())
        if faces[-1] and faces[-1] not in FACE_WORDS:
            text = f"got {faces[-1]!r}, allowed {', '.join(FACE_WORDS)}"
            issues.append(Issue("kerf.file", text, file=name, line=line, field="face", hint="correct it"))
        for key, values in found.items():
            values.append(_number(row[key]))
            low, high = NUMBER_COLUMNS[key]
            if not (low < values[-1] <= high):
                text = f"got {row[key]!r}, allowed a number above {low:g}, at most {high:g}"
                hint = "correct it or leave the line out"
                issues.append(Issue("kerf.file", text, file=name, line=line, field=key, hint=hint))
    if issues:
        raise TandemError(issues)
    return {key: np.array(values) for key, values in found.items()}, faces


def _narrow(name: str, rows: list[Row], kerf: FloatArray, diameter: float) -> list[Issue]:
    """The cuts narrower than the wire [mm]."""
    hint = (
        "kerf is nominal less measured side: measure the piece and not the hole, or state the wire's diameter"
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


def _uneven(name: str, rows: list[Row], thickness: FloatArray) -> list[Issue]:
    """The cuts in foam of another thickness [mm] than the first."""
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


def _headings(
    name: str, header: list[str], wire_length: float | None, thickness: float | None
) -> list[Issue]:
    issues = []

    def say(text: str, field: str, hint: str) -> None:
        issues.append(Issue("kerf.file", text, file=name, line=1, field=field, hint=hint))

    for key in sorted(set(header) - set(NUMBER_COLUMNS) - set(IGNORED_COLUMNS) - {"face"}):
        allowed = ", ".join((*NUMBER_COLUMNS, "face", *IGNORED_COLUMNS))
        say(f"column: got {key!r}, allowed {allowed}", key, "remove it or correct its spelling")
    for key in sorted({key for key in header if header.count(key) > 1}):
        say(f"column: got {key!r} twice, allowed once", key, "keep one")
    for key in ("power_w", "speed_mm_s"):
        if key not in header:
            say("got no such column, allowed one", key, "add it")
    sides = {"measured_side_mm", "nominal_side_mm"} & set(header)
    if ("kerf_mm" in header) == bool(sides) or len(sides) == 1:
        text = "columns of the kerf: got " + (
            ", ".join(sorted(sides | ({"kerf_mm"} & set(header)))) or "none"
        )
        text += ", allowed kerf_mm alone, or measured_side_mm with nominal_side_mm"
        say(text, "kerf_mm", "give one of the two")
    for key, given in (("wire_length_mm", wire_length), ("thickness_mm", thickness)):
        if key not in header and given is None:
            say(
                f"{key}: got neither a column nor a value, allowed one of them",
                key,
                f"add --{key.replace('_', '-')}",
            )
    return issues


def _rows(path: Path) -> tuple[list[str], list[Row]]:
    name = str(path)
    if not is_file(path):
        raise refusal("kerf.file", f"{name}: {no_file(path)}", file=name, hint="check the path")
    try:
        if path.stat().st_size > MAX_TEST_CUT_BYTES:
            what = f"{name}: larger than {MAX_TEST_CUT_BYTES / 1e6:g} MB"
            hint = "cut it down"
            raise refusal("kerf.file", what, file=name, hint=hint)
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        what = f"{name}: cannot be read as text: {error}"
        hint = "save it as CSV, UTF-8"
        raise refusal("kerf.file", what, file=name, hint=hint) from error
    lines = [
        (k + 1, line) for k, line in enumerate(text.splitlines()) if line.strip() and not line.startswith("#")
    ]
    if len(lines) < 2:
        text = f"{name}: got {len(lines)} lines, allowed a line of headings and one for each cut"
        raise refusal("kerf.file", text, file=name, hint="write the headings first")
    separator = ";" if ";" in lines[0][1] else ","
    parsed = list(csv.reader((line for _, line in lines), delimiter=separator))
    header = [cell.strip().lower() for cell in parsed[0]]
    issues, rows = [], []
    for (line, _), cells in zip(lines[1:], parsed[1:], strict=False):
        if len(cells) != len(header):
            text = f"{name}: got {len(cells)} values, allowed {len(header)} as there are headings"
            issues.append(
                Issue("kerf.file", text, file=name, line=line, hint="quote nothing, one value a column")
            )
        values = [cell.strip().replace(",", ".") if separator == ";" else cell.strip() for cell in cells]
        rows.append((line, dict(zip(header, values, strict=False))))
    if issues:
        raise TandemError(issues)
    return header, rows


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan
