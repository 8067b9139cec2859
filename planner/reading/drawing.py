"""Curves of DXF drawings, joined where their ends meet; read by ``ezdxf`` of the extra ``cad``."""

import dataclasses
from pathlib import Path
from typing import Any, Final

import numpy as np

from planner.files import is_file, missing_file_reason
from planner.geometry.arrays import FloatArray
from planner.geometry.nurbs import NurbsCurve
from planner.geometry.units import LENGTH_UNITS
from planner.issues import Issue, Severity, TandemError, issue_error

CAD_INSTALL: Final = "pip install 'tandem-planner[cad]'"
"""Command that installs the reader of DXF files."""
ENTITY_KINDS: Final = ("LINE", "ARC", "CIRCLE", "ELLIPSE", "SPLINE", "LWPOLYLINE", "POLYLINE")
"""Kinds of DXF entities that are read as curves."""
CURVE_CHORD_TOLERANCE_M: Final = 2e-6
"""Maximum distance [m] of the polyline of an arc or spline from the curve."""
MAX_BYTES: Final = 50_000_000
"""Maximum file size [bytes]. Larger files are refused unread."""
MAX_CURVES: Final = 2000
"""Maximum number of curves of a file."""
MAX_EXTENT_M: Final = 100.0
"""Maximum extent [m] of a drawing. A larger one is in another unit."""
INSUNITS: Final = {1: ("in", 0.0254), 2: ("ft", 0.3048), 4: ("mm", 1e-3), 5: ("cm", 1e-2), 6: ("m", 1.0)}
"""Units that a drawing may state in its header ($INSUNITS), by number: name and length [m]."""
_JOIN_TOLERANCE_M: Final = 1e-5
"""Maximum distance [m] between ends that are joined."""


@dataclasses.dataclass(frozen=True)
class FileCurve:
    """Points (N, 3) [m]. A ``closed`` curve does not repeat its first point."""

    points: FloatArray
    closed: bool

    def run_points(self) -> FloatArray:
        """Return points (K, 3) from start to end; a closed curve ends at its first point."""
        return np.concatenate([self.points, self.points[:1]]) if self.closed else self.points.copy()


def read_dxf(path: Path, unit: float, layer: str | None, field: str) -> tuple[list[FileCurve], list[Issue]]:
    """Read the visible curves of a drawing's model space.

    Pieces whose ends meet within 0.01 mm are joined.

    Args:
        path: File.
        unit: Length unit [m].
        layer: Layer to read; None for all.
        field: Field of the problem, for issues.

    Returns:
        Curves, and notes on what was left out and on another unit that the drawing states.

    Raises:
        TandemError: ``problem.missing_file``, ``problem.too_large``, ``part.extra_missing`` or ``part.dxf``.
    """
    if not is_file(path):
        raise file_error("problem.missing_file", path, field, f"{missing_file_reason(path)}; check the path")
    if path.stat().st_size > MAX_BYTES:
        raise file_error("problem.too_large", path, field, "more than 50 MB; export only the curves")
    try:
        from ezdxf import path as ezpath
        from ezdxf.filemanagement import readfile
    except ImportError as error:
        raise file_error("part.extra_missing", path, field, f"DXF files need ezdxf; {CAD_INSTALL}") from error
    try:
        drawing = readfile(path)
        space = list(drawing.modelspace())
    except Exception as error:  # damaged files raise anything
        message = f"cannot be read ({_first_line(error)}); export it again"
        raise file_error("part.dxf", path, field, message) from error
    layers = sorted({entity.dxf.layer for entity in space})
    on_layer = [e for e in space if layer is None or e.dxf.layer.lower() == layer.lower()]
    visible = [e for e in on_layer if not _is_hidden(e, drawing)]
    curves = [e for e in visible if e.dxftype() in ENTITY_KINDS]
    hidden_text = f"{len(on_layer) - len(visible)} hidden" if len(on_layer) > len(visible) else ""
    if not curves:
        message = f"has no curves on layer {layer}" if layer is not None else "has no curves"
        message += f", but {hidden_text}; {_SHOW_HIDDEN_HINT}" if hidden_text else ""
        raise file_error(
            "part.dxf", path, field, f"{message}; its layers are {', '.join(layers[:12]) or '(none)'}"
        )
    notes = []
    unread_kinds = sorted({e.dxftype() for e in visible} - set(ENTITY_KINDS))
    if unread_kinds:
        message = f"{path.name}: left out {', '.join(unread_kinds)}; "
        message += f"only {', '.join(ENTITY_KINDS)} are read (explode blocks)"
        notes.append(Issue("part.dxf_left_out", message, Severity.NOTE, file=str(path), field=field))
    if hidden_text:
        message = f"{path.name}: left out {hidden_text}; {_SHOW_HIDDEN_HINT}"
        notes.append(Issue("part.dxf_left_out", message, Severity.NOTE, file=str(path), field=field))
    name, metres = INSUNITS.get(drawing.header.get("$INSUNITS", 0), ("", unit))
    if abs(metres - unit) > 1e-9:
        stated_unit = next(short for short, size in LENGTH_UNITS.items() if size == unit)
        message = f"{path.name} states lengths in {name} ($INSUNITS), but the problem reads them in "
        message += (
            f"{stated_unit}; check its size, then write unit: {name}, or save it with the right unit (_UNITS)"
        )
        notes.append(Issue("part.dxf_unit", message, Severity.WARNING, file=str(path), field=field))
    try:
        _require_size(curves, ezpath, unit, path, field)
        pieces = [p for p in (_flatten(e, ezpath, unit) for e in curves) if len(p) > 1]
    except TandemError:
        raise
    except Exception as error:  # invalid curves, such as too few or unordered knots, raise anything
        message = f"has a curve that cannot be read ({_first_line(error)}); draw it again"
        raise file_error("part.dxf", path, field, message) from error
    if len(pieces) > MAX_CURVES:
        message = f"has {len(pieces)} curves, allowed {MAX_CURVES}; name a layer, or join them to polylines"
        raise file_error("part.dxf", path, field, message)
    if any(not np.isfinite(p).all() for p in pieces):
        raise file_error("part.dxf", path, field, "has numbers that are not finite; export it again")
    return join_curves(pieces), notes


def _first_line(error: Exception) -> str:
    """Return the first line of an exception's text, or the exception's name if it has no text."""
    return str(error).splitlines()[0][:120] if str(error) else type(error).__name__


_SHOW_HIDDEN_HINT: Final = "show objects that are invisible, off or frozen, if they are needed"
"""Remedy for hidden entities, to be done in a CAD program."""


def _is_hidden(entity: Any, drawing: Any) -> bool:
    """Whether an entity is invisible, or its layer is off or frozen."""
    if entity.dxf.get("invisible", 0) or not drawing.layers.has_entry(entity.dxf.layer):
        return bool(entity.dxf.get("invisible", 0))
    layer = drawing.layers.get(entity.dxf.layer)
    return bool(layer.is_off() or layer.is_frozen())


def _require_size(curves: list[Any], ezpath: Any, unit: float, path: Path, field: str) -> None:
    """Raise ``part.dxf`` for curves larger than any part, which would have too many points."""
    control_points = [
        [(v.x, v.y, v.z) for v in ezpath.make_path(curve).control_vertices()] for curve in curves
    ]
    points = np.array([v for curve in control_points for v in curve], dtype=np.float64).reshape(-1, 3) * unit
    extent = float(np.ptp(points, axis=0).max()) if len(points) else 0.0
    if extent > MAX_EXTENT_M:
        text = f"is {extent:.4g} m across, allowed {MAX_EXTENT_M:g} m; check the unit, or remove stray points"
        raise file_error("part.dxf", path, field, text)


def _flatten(entity: Any, ezpath: Any, unit: float) -> FloatArray:
    """Return points (N, 3) [m] along an entity, in its direction."""
    if entity.dxftype() == "SPLINE":
        return _flatten_spline(entity, CURVE_CHORD_TOLERANCE_M / unit) * unit
    curve = ezpath.make_path(entity)
    points = [(v.x, v.y, v.z) for v in curve.flattening(CURVE_CHORD_TOLERANCE_M / unit, segments=16)]
    out = np.array(points, dtype=np.float64).reshape(-1, 3) * unit
    return out[::-1] if _is_reversed(entity, out / unit) else out


def _flatten_spline(entity: Any, chord: float) -> FloatArray:
    """Return points (N, 3) of a spline between its first and last valid knot.

    The knots of a closed spline extend beyond them, and so do the paths of ezdxf.
    """
    spline = entity.construction_tool()
    points = np.array([(v.x, v.y, v.z) for v in spline.control_points], dtype=np.float64).reshape(-1, 3)
    weight = np.array(spline.weights(), dtype=np.float64).reshape(-1, 1)
    weight = weight if len(weight) == len(points) else np.ones((len(points), 1))
    control = np.concatenate([points * weight, weight], axis=1)
    return NurbsCurve(spline.degree, np.array(spline.knots(), dtype=np.float64), control).chords(chord)


def _is_reversed(entity: Any, points: FloatArray) -> bool:
    """Whether points (N, 3) of an entity run against its direction.

    ezdxf reverses a circle, and an ellipse that ends at its start, because it takes the end for the start.
    """
    kind = entity.dxftype()
    if kind not in ("CIRCLE", "ELLIPSE") or not _is_closed(points):
        return False
    if kind == "CIRCLE":
        (early_point,) = entity.vertices([360.0 * _EARLY_FRACTION])
    else:
        first, last = entity.dxf.start_param, entity.dxf.end_param
        (early_point,) = entity.vertices(
            [first + _EARLY_FRACTION * ((last - first) % (2.0 * np.pi) or 2.0 * np.pi)]
        )
    direction = np.array((early_point.x, early_point.y, early_point.z)) - points[0]
    return bool(direction @ (points[-2] - points[0]) > direction @ (points[1] - points[0]))


_EARLY_FRACTION: Final = 1e-3
"""Fraction of an entity at which its direction is tested."""


def join_curves(pieces: list[FloatArray]) -> list[FileCurve]:
    """Join pieces whose ends meet to curves, in the order of the file.

    Each curve runs in the direction of its first piece; a closed one starts with that piece.
    """
    ends = np.array([piece[[0, -1]] for piece in pieces]).reshape(-1, 2, 3)
    # pieces that may still be joined
    is_joinable = np.array([not _is_closed(piece) for piece in pieces], dtype=bool)
    is_joined = np.zeros(len(pieces), dtype=bool)
    out = []
    for start, first in enumerate(pieces):
        if is_joined[start]:
            continue
        chain, prepended, is_joinable[start] = first, 0, False
        while is_joinable.any() and not _is_closed(chain):
            # if several ends meet, continue with the nearest
            rows = np.flatnonzero(is_joinable)
            gap = np.linalg.norm(ends[rows][:, :, None] - chain[[0, -1]], axis=-1)
            row, end, chain_end = np.unravel_index(int(np.argmin(gap)), gap.shape)
            if gap[row, end, chain_end] > _JOIN_TOLERANCE_M:
                break
            i = int(rows[row])
            piece = pieces[i][::-1] if end else pieces[i]  # leads away from the chain
            chain = np.concatenate([chain, piece[1:]] if chain_end else [piece[:0:-1], chain])
            prepended += 0 if chain_end else len(piece) - 1
            is_joinable[i], is_joined[i] = False, True
        closed = _is_closed(chain)
        out.append(FileCurve(np.roll(chain[:-1], -prepended, axis=0) if closed else chain, closed))
    return out


def _is_closed(points: FloatArray) -> bool:
    return len(points) > 3 and bool(np.linalg.norm(points[0] - points[-1]) <= _JOIN_TOLERANCE_M)


def file_error(code: str, path: Path, field: str, what: str) -> TandemError:
    """Create the error of a file."""
    return issue_error(code, f"{path.name}: {what}", file=str(path), field=field)
