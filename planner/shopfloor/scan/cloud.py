"""Points of a scan, from a PLY, XYZ, STL or OBJ file.

Scans are larger than parts and need no faces: of a mesh only the vertices are used. An XYZ file has one point
per line, starting with x, y and z, separated by blanks, tabs, commas or semicolons. Its first line may hold
names or a count.
"""

import codecs
import dataclasses
import hashlib
import io
import re
from pathlib import Path
from typing import Final

import numpy as np

from planner.files import is_file, missing_file_reason
from planner.geometry.arrays import FloatArray
from planner.geometry.units import LENGTH_UNITS, MM
from planner.issue_codes import format_message
from planner.issues import TandemError, issue_error

SUFFIXES: Final = (".ply", ".xyz", ".txt", ".stl", ".obj")
"""Suffixes of supported files."""
UNITS: Final = {name: LENGTH_UNITS[name] for name in ("mm", "cm", "m", "in")}
"""Units [m] of a scan's lengths."""
TEXTS: Final = (".xyz", ".txt")
"""Suffixes of text files with one point per line."""
MAX_BYTES: Final = 600_000_000
"""Maximum size [bytes] of a file."""
MIN_POINTS: Final = 1_000
"""Minimum number of points that show a part's shape."""
MIN_EXTENT_RATIO: Final = 0.2
"""Minimum ratio of the extent of a scan to that of the sheet."""
MAX_EXTENT_RATIO: Final = 5.0
"""Maximum ratio of the extent of a scan to that of the sheet."""
MAX_POINTS: Final = 20_000_000
"""Maximum number of points of a scan."""
VERTEX: Final = re.compile(rb"^v[ \t](.*)$", re.MULTILINE)
"""A vertex of an OBJ file."""
HEAD: Final = re.compile(rb"\s*(?:\d+|[\"']?[A-Za-z_][^\d\s]*(?:[\s,;]+[\"']?[A-Za-z_][^\s,;]*)+)\s*")
"""A first line that is not a point: a count, as in PTS files, or column names."""
DECIMAL_COMMAS: Final = re.compile(rb"\s*-?\d+,\d+\s*[;\t ]\s*-?\d+,\d+\s*[;\t ]")
"""A point with decimal commas: its numbers have another separator."""


@dataclasses.dataclass(frozen=True, eq=False)
class Cloud:
    """Points of a scan.

    Attributes:
        file: Name of the file.
        digest: SHA-256 of the file.
        points: Points (N, 3) [m] in the scan's frame.
        dropped: Number of points that were not finite, or repeated corners of an STL file.
        unit: Unit [m] of the file's lengths.
    """

    file: str
    digest: str
    points: FloatArray = dataclasses.field(repr=False)
    dropped: int
    unit: float = MM


def read(path: Path, unit: float) -> Cloud:
    """Read a scan whose lengths are in ``unit`` metres.

    Raises:
        TandemError: ``scan.file`` if the file is missing, unsupported, too large or unreadable, or has too
            few or too many points.
    """
    if not is_file(path):
        raise _refused(path, missing_file_reason(path), "check the path")
    if path.suffix.lower() not in SUFFIXES:
        raise _refused(
            path, f"got {path.suffix or 'no suffix'!r}, allowed {', '.join(SUFFIXES)}", "convert it"
        )
    size = path.stat().st_size
    if size > MAX_BYTES:
        message = f"got {size / 1e6:.0f} MB, allowed {MAX_BYTES / 1e6:.0f} MB"
        raise _refused(path, message, "export every second point")
    data = path.read_bytes()
    try:
        points = _points(path.suffix.lower(), data)
    except Exception as error:  # readers raise arbitrary exceptions for damaged files
        reason = str(error).splitlines()[0][:120] if str(error) else type(error).__name__
        hint = "export it again, without lines of names" if path.suffix in TEXTS else "export it again"
        raise _refused(path, f"cannot be read ({reason})", hint) from error
    count = len(points)
    if count > MAX_POINTS:
        message = f"got {count} points, allowed {MAX_POINTS}"
        raise _refused(path, message, "export fewer of them")
    points = points[np.isfinite(points).all(axis=1)] * unit
    if path.suffix.lower() == ".stl":  # repeats each vertex for each of its faces
        points = _unique(points)
    if len(points) < MIN_POINTS:
        message = f"got {len(points)} points, allowed {MIN_POINTS} or more"
        raise _refused(path, message, "export the whole scan as points or as a mesh")
    return Cloud(path.name, hashlib.sha256(data).hexdigest(), points, count - len(points), unit)


def _points(suffix: str, data: bytes) -> FloatArray:
    """Return the points or vertices (N, 3) of a file's content, in its unit. Readers raise any exception."""
    if suffix in TEXTS:
        return _table(data)
    if suffix == ".obj":
        return _table(b"\n".join(VERTEX.findall(data.replace(b"\r", b"\n"))))
    import trimesh  # imported here because it takes half a second

    loaded = trimesh.load(io.BytesIO(data), suffix[1:], process=False)
    points = getattr(loaded, "vertices", ())  # a file without any is read as an empty scene
    return np.asarray(points, dtype=np.float64).reshape(-1, 3)


def _unique(points: FloatArray) -> FloatArray:
    """Return the unique points (N, 3), in the order of their first occurrence.

    One hash per point, mixed from the bits of its coordinates, is sorted, which takes a fifth of the time of
    sorting points. A collision among a million points is rarer than once in ten million files.
    """
    bits = (points + 0.0).view(np.uint64)  # turns -0.0 into 0.0
    mixed = np.zeros(len(points), dtype=np.uint64)
    for k in range(3):  # steps of splitmix64, Steele, Lea and Flood 2014
        mixed = (mixed ^ bits[:, k]) + np.uint64(0x9E3779B97F4A7C15)
        mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        mixed ^= mixed >> np.uint64(31)
    return points[np.sort(np.unique(mixed, return_index=True)[1])]


def _table(data: bytes) -> FloatArray:
    """Return the first three columns (N, 3) of a text.

    Lines that begin with # or //, and a first line with names or a count, are skipped. Raises ``ValueError``
    if there are no points, or decimal commas.
    """
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        data = data.decode("utf-16").encode()
    data = data.removeprefix(codecs.BOM_UTF8)
    lines = [
        line for line in data.splitlines() if line.strip() and not line.lstrip().startswith((b"#", b"//"))
    ]
    if not lines:
        raise ValueError("it has no points")
    if len(lines) > 1 and HEAD.fullmatch(lines[0]):
        del lines[0]
    if DECIMAL_COMMAS.match(lines[0]):
        raise ValueError("it has decimal commas; use decimal points: 12.5 instead of 12,5")
    for separator in (b";", b","):
        if separator in lines[0]:
            lines = [line.replace(separator, b" ") for line in lines]
    values = np.loadtxt(io.BytesIO(b"\n".join(lines)), usecols=(0, 1, 2), ndmin=2)
    return np.asarray(values, dtype=np.float64)


def require_size(cloud: Cloud, longest: float) -> None:
    """Require that a scan is about as large as the sheet; otherwise its unit is wrong.

    The limits are wide, because a scan may show only part of the sheet, or the table around it.

    Args:
        cloud: Points of the scan.
        longest: Longer side [m] of the sheet.

    Raises:
        TandemError: ``scan.unit`` if it is not.
    """
    low, high = np.percentile(cloud.points, (2, 98), axis=0)
    extent = float((high - low).max())
    if not MIN_EXTENT_RATIO * longest <= extent <= MAX_EXTENT_RATIO * longest:
        message = (
            f"{cloud.file}: its points are {extent / MM:.4g} mm across in the stated unit, the sheet is "
            f"{longest / MM:g} mm; allowed are {MIN_EXTENT_RATIO:g} to {MAX_EXTENT_RATIO:g} times that"
        )
        # units in which the scan would be as large as the sheet
        matching = [
            name for name, metres in UNITS.items() if 0.8 <= extent * metres / cloud.unit / longest <= 1.25
        ]
        message += f"; in {matching[0]!r} the sizes would match" if len(matching) == 1 else ""
        hint = "state the unit that the scanner writes (--unit), or name the result folder of this part"
        raise issue_error("scan.unit", message, field="unit", value=extent / MM, unit="mm", hint=hint)


def _refused(path: Path, fault: str, hint: str) -> TandemError:
    message = format_message("scan.file", file=path.name, fault=fault)
    return issue_error("scan.file", message, file=str(path), hint=hint)
