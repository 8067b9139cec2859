"""A file of test cuts: what was measured on squares, or the kerf itself."""

from __future__ import annotations

import csv
import dataclasses
import math
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.files import is_file
from planner.hotwire.kerf_cuts import Cuts
from planner.issues import Issue, TandemError
from planner.units import MM

MAX_BYTES: Final = 2_000_000
NUMBERS: Final = {
    "power_w": (0.0, 1e5),
    "speed_mm_s": (0.0, 1e3),
    "kerf_mm": (-1e3, 1e3),
    "measured_side_mm": (0.0, 1e4),
    "nominal_side_mm": (0.0, 1e4),
    "wire_length_mm": (0.0, 1e5),
    "thickness_mm": (0.0, 1e5),
}
"""Columns of numbers, above the first and up to the second value."""
FACES: Final = ("ok", "burnt", "dragging")
IGNORED: Final = ("voltage_v", "current_a", "note")


Row = tuple[int, dict[str, str]]
"""A line's number and its values by heading."""
Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class CutFile:
    """``cuts`` (N,) of a file in foam of one ``thickness`` [m]; ``burnt`` and ``dragging`` (N,) as it
    says."""

    cuts: Cuts
    thickness: float
    burnt: NDArray[np.bool_]
    dragging: NDArray[np.bool_]
    good: NDArray[np.bool_]


def read(path: Path, diameter: float, wire_length: float | None, thickness: float | None) -> CutFile:
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
    good, burnt, dragging = (np.array([face == wanted for face in faces]) for wanted in FACES)
    return CutFile(cuts, thickness, burnt, dragging, good)


def _columns(name: str, header: list[str], rows: list[Row]) -> tuple[dict[str, Array], list[str]]:
    """The columns of numbers and that of faces; refuses every value that is out of range."""
    issues = []
    found: dict[str, list[float]] = {key: [] for key in header if key in NUMBERS}
    faces: list[str] = []
    for line, row in rows:
        faces.append(row.get("face", "").lower())
        if faces[-1] and faces[-1] not in FACES:
            text = f"got {faces[-1]!r}, allowed {', '.join(FACES)}"
            issues.append(Issue("kerf.file", text, file=name, line=line, field="face", hint="correct it"))
        for key, values in found.items():
            values.append(_number(row[key]))
            low, high = NUMBERS[key]
            if not (low < values[-1] <= high):
                text = f"got {row[key]!r}, allowed a number above {low:g}, at most {high:g}"
                hint = "correct it or leave the line out"
                issues.append(Issue("kerf.file", text, file=name, line=line, field=key, hint=hint))
    if issues:
        raise TandemError(issues)
    return {key: np.array(values) for key, values in found.items()}, faces


def _narrow(name: str, rows: list[Row], kerf: Array, diameter: float) -> list[Issue]:
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
            value=float(kerf[k]),
            limit=diameter,
            unit="mm",
            hint=hint,
        )
        for k in np.flatnonzero(kerf <= diameter)
    ]


def _uneven(name: str, rows: list[Row], thickness: Array) -> list[Issue]:
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

    for key in sorted(set(header) - set(NUMBERS) - set(IGNORED) - {"face"}):
        allowed = ", ".join((*NUMBERS, "face", *IGNORED))
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
    """The headings, and each row with its line."""
    name = str(path)
    if not is_file(path):
        raise TandemError(Issue("kerf.file", f"{name}: got no such file", file=name, hint="check the path"))
    try:
        if path.stat().st_size > MAX_BYTES:
            raise TandemError(
                Issue(
                    "kerf.file", f"{name}: larger than {MAX_BYTES / 1e6:g} MB", file=name, hint="cut it down"
                )
            )
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise TandemError(
            Issue(
                "kerf.file",
                f"{name}: cannot be read as text: {error}",
                file=name,
                hint="save it as CSV, UTF-8",
            )
        ) from error
    lines = [
        (k + 1, line) for k, line in enumerate(text.splitlines()) if line.strip() and not line.startswith("#")
    ]
    if len(lines) < 2:
        text = f"{name}: got {len(lines)} lines, allowed a line of headings and one for each cut"
        raise TandemError(Issue("kerf.file", text, file=name, hint="write the headings first"))
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
