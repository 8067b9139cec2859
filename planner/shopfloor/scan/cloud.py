"""Points of a scan, from a PLY, XYZ, STL or OBJ file.

Scans are larger than parts and need no faces: of a mesh the vertices are taken. An XYZ file has a point a
line, x, y and z first, with blanks, tabs, commas or semicolons between; its first line may be of names or a
count.
"""

import codecs
import dataclasses
import hashlib
import io
import re
from pathlib import Path
from typing import Final

import numpy as np

from planner.files import is_file, no_file
from planner.geometry.arrays import FloatArray
from planner.geometry.units import LENGTH_UNITS, MM
from planner.issues import TandemError, refusal

SUFFIXES: Final = (".ply", ".xyz", ".txt", ".stl", ".obj")
"""Kinds of files that are read."""
UNITS: Final = {name: LENGTH_UNITS[name] for name in ("mm", "cm", "m", "in")}
"""Units [m] that a scan's lengths are stated in."""
TEXTS: Final = (".xyz", ".txt")
"""Of these, texts with a point a line."""
MOST_BYTES: Final = 600_000_000
"""Bytes of a file at most."""
LEAST_POINTS: Final = 1_000
"""Points that tell a part's shape at least."""
LEAST_EXTENT: Final = 0.2
MOST_EXTENT: Final = 5.0
"""Scans are so many times as large as the sheet."""
MOST_POINTS: Final = 20_000_000
"""Points of a scan at most."""
VERTEX: Final = re.compile(rb"^v[ \t](.*)$", re.MULTILINE)
"""A vertex of an OBJ file."""
HEAD: Final = re.compile(rb"\s*(?:\d+|[\"']?[A-Za-z_][^\d\s]*(?:[\s,;]+[\"']?[A-Za-z_][^\s,;]*)+)\s*")
"""A first line that is no point: a count, as in PTS files, or names of columns."""
DECIMAL_COMMAS: Final = re.compile(rb"\s*-?\d+,\d+\s*[;\t ]\s*-?\d+,\d+\s*[;\t ]")
"""A point whose decimals have commas: between its lengths there is something else."""


@dataclasses.dataclass(frozen=True, eq=False)
class Cloud:
    """The ``points`` (N, 3) [m] of a scan in its own frame, from ``file`` with the SHA-256 ``digest``;
    ``dropped`` of it had no finite place, or were corners of an STL file that came again; the file's lengths
    are in ``unit`` metres."""

    file: str
    digest: str
    points: FloatArray = dataclasses.field(repr=False)
    dropped: int
    unit: float = MM


def read(path: Path, unit: float) -> Cloud:
    """Read a scan whose lengths are in ``unit`` metres. Raises ``TandemError`` (scan.file)."""
    if not is_file(path):
        raise _refused(path, no_file(path), "check the path")
    if path.suffix.lower() not in SUFFIXES:
        raise _refused(
            path, f"got {path.suffix or 'no suffix'!r}, read are {', '.join(SUFFIXES)}", "convert it"
        )
    size = path.stat().st_size
    if size > MOST_BYTES:
        what = f"{size / 1e6:.0f} MB, up to {MOST_BYTES / 1e6:.0f} MB are read"
        raise _refused(path, what, "export every second point")
    data = path.read_bytes()
    try:
        points = _points(path.suffix.lower(), data)
    except Exception as error:  # readers of damaged files raise anything
        reason = str(error).splitlines()[0][:120] if str(error) else type(error).__name__
        hint = "export it again, a text without lines of names" if path.suffix in TEXTS else "export it again"
        raise _refused(path, f"cannot be read ({reason})", hint) from error
    count = len(points)
    if count > MOST_POINTS:
        what = f"got {count} points, allowed {MOST_POINTS}"
        raise _refused(path, what, "export fewer of them")
    points = points[np.isfinite(points).all(axis=1)] * unit
    if path.suffix.lower() == ".stl":  # has each vertex once for each of its faces
        points = _once(points)
    if len(points) < LEAST_POINTS:
        what = f"got {len(points)} points, allowed {LEAST_POINTS} or more"
        raise _refused(path, what, "export the whole scan as points or as a mesh")
    return Cloud(path.name, hashlib.sha256(data).hexdigest(), points, count - len(points), unit)


def _points(kind: str, data: bytes) -> FloatArray:
    if kind in TEXTS:
        return _table(data)
    if kind == ".obj":
        return _table(b"\n".join(VERTEX.findall(data.replace(b"\r", b"\n"))))
    import trimesh  # half a second that the other kinds do not wait for

    loaded = trimesh.load(io.BytesIO(data), kind[1:], process=False)
    points = getattr(loaded, "vertices", ())  # a file without any is read as an empty scene
    return np.asarray(points, dtype=np.float64).reshape(-1, 3)


def _once(points: FloatArray) -> FloatArray:
    """Each of the points (N, 3) once, as they come first.

    One number a point is sorted, mixed of the bits of its three: a fifth of the time of sorting rows. That
    two of a million points share theirs is rarer than once in ten million files.
    """
    bits = (points + 0.0).view(np.uint64)  # no -0.0 beside 0.0
    mixed = np.zeros(len(points), dtype=np.uint64)
    for k in range(3):  # steps of splitmix64, Steele, Lea and Flood 2014
        mixed = (mixed ^ bits[:, k]) + np.uint64(0x9E3779B97F4A7C15)
        mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        mixed ^= mixed >> np.uint64(31)
    return points[np.sort(np.unique(mixed, return_index=True)[1])]


def _table(data: bytes) -> FloatArray:
    """The first three columns (N, 3) of a text; lines that begin with # or // are left out, and a first line
    of names, or of how many points follow."""
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
        raise ValueError("its decimals have commas, read are points: 12.5 in place of 12,5")
    for mark in (b";", b","):
        if mark in lines[0]:
            lines = [line.replace(mark, b" ") for line in lines]
    values = np.loadtxt(io.BytesIO(b"\n".join(lines)), usecols=(0, 1, 2), ndmin=2)
    return np.asarray(values, dtype=np.float64)


def require_size(cloud: Cloud, longest: float) -> None:
    """Raise ``TandemError`` (scan.unit) where a scan is far larger or smaller than a sheet whose longer side
    is ``longest`` [m]. A scan may show some of the sheet alone, or the table around it."""
    low, high = np.percentile(cloud.points, (2, 98), axis=0)
    extent = float((high - low).max())
    if not LEAST_EXTENT * longest <= extent <= MOST_EXTENT * longest:
        what = (
            f"{cloud.file}: its points are {extent / MM:.4g} mm across in the stated unit, the sheet is "
            f"{longest / MM:g} mm; allowed are {LEAST_EXTENT:g} to {MOST_EXTENT:g} times that"
        )
        like = [name for name, one in UNITS.items() if 0.8 <= extent * one / cloud.unit / longest <= 1.25]
        what += f"; in {like[0]!r} it would be about as large" if len(like) == 1 else ""
        hint = "state the unit that the scanner writes (--unit), or name the result folder of this part"
        raise refusal("scan.unit", what, field="unit", value=extent / MM, unit="mm", hint=hint)


def _refused(path: Path, what: str, hint: str) -> TandemError:
    return refusal("scan.file", f"{path.name}: {what}", file=str(path), hint=hint)
