"""Curves of drawings, joined where their ends meet: DXF files, by ``ezdxf`` of the extra ``cad``."""

import dataclasses
from pathlib import Path
from typing import Any, Final

import numpy as np

from planner.files import is_file, no_file
from planner.geometry.arrays import FloatArray
from planner.geometry.nurbs import NurbsCurve
from planner.geometry.units import LENGTH_UNITS
from planner.issues import Issue, Severity, TandemError, refusal

CAD_INSTALL: Final = "pip install 'tandem-planner[cad]'"
"""What to run where the reader of DXF files is missing."""
ENTITY_KINDS: Final = ("LINE", "ARC", "CIRCLE", "ELLIPSE", "SPLINE", "LWPOLYLINE", "POLYLINE")
"""Kinds of DXF entities that are read as curves."""
FLATNESS: Final = 2e-6
"""How far [m] the points of arcs and splines may be off them."""
MOST_BYTES: Final = 50_000_000
"""Files larger than this [bytes] are refused unread."""
MOST_CURVES: Final = 2000
"""Curves of a file at most."""
LARGEST: Final = 100.0
"""A drawing whose curves reach farther [m] is in another unit."""
INSUNITS: Final = {1: ("in", 0.0254), 2: ("ft", 0.3048), 4: ("mm", 1e-3), 5: ("cm", 1e-2), 6: ("m", 1.0)}
"""Units that a drawing may state in its header ($INSUNITS), by their numbers, in metres."""
_JOINED_WITHIN: Final = 1e-5
"""Ends [m] that are this near are joined."""


@dataclasses.dataclass(frozen=True)
class FileCurve:
    """Points (N, 3) [m]; a ``closed`` curve does not repeat its first."""

    points: FloatArray
    closed: bool

    def run(self) -> FloatArray:
        """Points (K, 3) from its begin to its end: a closed one ends where it began."""
        return np.concatenate([self.points, self.points[:1]]) if self.closed else self.points.copy()


def read_dxf(path: Path, unit: float, layer: str | None, field: str) -> tuple[list[FileCurve], list[Issue]]:
    """Curves of a drawing's model space that are visible, lengths in ``unit`` metres, and notes of what was
    left out, and of another unit that the drawing states.

    Pieces whose ends meet within 0.01 mm are joined. Raises ``TandemError`` with ``problem.missing_file``,
    ``problem.too_large``, ``part.extra_missing`` or ``part.dxf``.
    """
    if not is_file(path):
        raise refused("problem.missing_file", path, field, f"{no_file(path)}; check the path")
    if path.stat().st_size > MOST_BYTES:
        raise refused("problem.too_large", path, field, "more than 50 MB; export only the curves")
    try:
        from ezdxf import path as ezpath
        from ezdxf.filemanagement import readfile
    except ImportError as error:
        raise refused("part.extra_missing", path, field, f"DXF files need ezdxf; {CAD_INSTALL}") from error
    try:
        drawing = readfile(path)
        space = list(drawing.modelspace())
    except Exception as error:  # damaged files raise anything
        what = f"cannot be read ({_first_line(error)}); export it again"
        raise refused("part.dxf", path, field, what) from error
    layers = sorted({entity.dxf.layer for entity in space})
    asked = [e for e in space if layer is None or e.dxf.layer.lower() == layer.lower()]
    wanted = [e for e in asked if not _is_hidden(e, drawing)]
    curves = [e for e in wanted if e.dxftype() in ENTITY_KINDS]
    hidden = f"{len(asked) - len(wanted)} hidden" if len(asked) > len(wanted) else ""
    if not curves:
        what = f"has no curves on layer {layer}" if layer is not None else "has no curves"
        what += f", but {hidden}; {_SHOW}" if hidden else ""
        raise refused("part.dxf", path, field, f"{what}; its layers are {', '.join(layers[:12]) or '(none)'}")
    notes = []
    others = sorted({e.dxftype() for e in wanted} - set(ENTITY_KINDS))
    if others:
        what = f"{path.name}: left out {', '.join(others)}; "
        what += f"only {', '.join(ENTITY_KINDS)} are read (explode blocks)"
        notes.append(Issue("part.dxf_left_out", what, Severity.NOTE, file=str(path), field=field))
    if hidden:
        what = f"{path.name}: left out {hidden}; {_SHOW}"
        notes.append(Issue("part.dxf_left_out", what, Severity.NOTE, file=str(path), field=field))
    name, metres = INSUNITS.get(drawing.header.get("$INSUNITS", 0), ("", unit))
    if abs(metres - unit) > 1e-9:
        said = next(short for short, size in LENGTH_UNITS.items() if size == unit)
        what = f"{path.name} says that its lengths are in {name} ($INSUNITS), the problem reads them in "
        what += f"{said}; see its sides: write unit: {name}, or save it with its own unit (_UNITS)"
        notes.append(Issue("part.dxf_unit", what, Severity.WARNING, file=str(path), field=field))
    try:
        _require_size(curves, ezpath, unit, path, field)
        pieces = [p for p in (_flat(e, ezpath, unit) for e in curves) if len(p) > 1]
    except TandemError:
        raise
    except Exception as error:  # numbers that make no curve, as knots too few or out of order, raise anything
        what = f"has a curve that cannot be read ({_first_line(error)}); draw it again"
        raise refused("part.dxf", path, field, what) from error
    if len(pieces) > MOST_CURVES:
        what = f"has {len(pieces)} curves, {MOST_CURVES} are read; name a layer, or join them to polylines"
        raise refused("part.dxf", path, field, what)
    if any(not np.isfinite(p).all() for p in pieces):
        raise refused("part.dxf", path, field, "has numbers that are not finite; export it again")
    return joined(pieces), notes


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0][:120] if str(error) else type(error).__name__


_SHOW: Final = "show what is invisible, off or frozen, if it is meant"
"""What to do in a CAD program with what is hidden."""


def _is_hidden(entity: Any, drawing: Any) -> bool:
    """Whether an entity is invisible, or its layer off or frozen."""
    if entity.dxf.get("invisible", 0) or not drawing.layers.has_entry(entity.dxf.layer):
        return bool(entity.dxf.get("invisible", 0))
    layer = drawing.layers.get(entity.dxf.layer)
    return bool(layer.is_off() or layer.is_frozen())


def _require_size(curves: list[Any], ezpath: Any, unit: float, path: Path, field: str) -> None:
    """Raises ``TandemError`` (``part.dxf``) for curves that are as large as no part is: their points would be
    too many."""
    corners = [[(v.x, v.y, v.z) for v in ezpath.make_path(one).control_vertices()] for one in curves]
    points = np.array([v for one in corners for v in one], dtype=np.float64).reshape(-1, 3) * unit
    across = float(np.ptp(points, axis=0).max()) if len(points) else 0.0
    if across > LARGEST:
        what = f"is {across:.4g} m across, up to {LARGEST:g} m are read; see the unit, or clear stray points"
        raise refused("part.dxf", path, field, what)


def _flat(entity: Any, ezpath: Any, unit: float) -> FloatArray:
    if entity.dxftype() == "SPLINE":
        return _along_spline(entity, FLATNESS / unit) * unit
    curve = ezpath.make_path(entity)
    points = [(v.x, v.y, v.z) for v in curve.flattening(FLATNESS / unit, segments=16)]
    out = np.array(points, dtype=np.float64).reshape(-1, 3) * unit
    return out[::-1] if _is_turned_round(entity, out / unit) else out


def _along_spline(entity: Any, chord: float) -> FloatArray:
    """Points (N, 3) of a spline between the knots where it begins and ends: those of a closed one go on
    beyond them, where ezdxf's paths do as well."""
    tool = entity.construction_tool()
    points = np.array([(v.x, v.y, v.z) for v in tool.control_points], dtype=np.float64).reshape(-1, 3)
    weight = np.array(tool.weights(), dtype=np.float64).reshape(-1, 1)
    weight = weight if len(weight) == len(points) else np.ones((len(points), 1))
    control = np.concatenate([points * weight, weight], axis=1)
    return NurbsCurve(tool.degree, np.array(tool.knots(), dtype=np.float64), control).chords(chord)


def _is_turned_round(entity: Any, points: FloatArray) -> bool:
    """Whether points (N, 3) of an entity run against it, as ezdxf makes those of a circle, or of an ellipse
    that ends where it begins: it takes the end for the place where they go on."""
    kind = entity.dxftype()
    if kind not in ("CIRCLE", "ELLIPSE") or not _shut(points):
        return False
    if kind == "CIRCLE":
        (early,) = entity.vertices([360.0 * _EARLY])
    else:
        first, last = entity.dxf.start_param, entity.dxf.end_param
        (early,) = entity.vertices([first + _EARLY * ((last - first) % (2.0 * np.pi) or 2.0 * np.pi)])
    way = np.array((early.x, early.y, early.z)) - points[0]
    return bool(way @ (points[-2] - points[0]) > way @ (points[1] - points[0]))


_EARLY: Final = 1e-3
"""A place so early on an entity tells its direction."""


def joined(pieces: list[FloatArray]) -> list[FileCurve]:
    """Curves made of pieces whose ends meet, in the order of the file: each is run as the first of its pieces
    is drawn, and one that is closed begins with that."""
    ends = np.array([piece[[0, -1]] for piece in pieces]).reshape(-1, 2, 3)
    left = np.array([not _shut(piece) for piece in pieces], dtype=bool)  # pieces that others may go on with
    done = np.zeros(len(pieces), dtype=bool)
    out = []
    for begin, first in enumerate(pieces):
        if done[begin]:
            continue
        chain, before, left[begin] = first, 0, False
        while left.any() and not _shut(chain):
            # where several meet, the nearest end goes on
            rows = np.flatnonzero(left)
            gap = np.linalg.norm(ends[rows][:, :, None] - chain[[0, -1]], axis=-1)
            row, end, own = np.unravel_index(int(np.argmin(gap)), gap.shape)
            if gap[row, end, own] > _JOINED_WITHIN:
                break
            i = int(rows[row])
            piece = pieces[i][::-1] if end else pieces[i]  # leads away from the chain
            chain = np.concatenate([chain, piece[1:]] if own else [piece[:0:-1], chain])
            before += 0 if own else len(piece) - 1
            left[i], done[i] = False, True
        closed = _shut(chain)
        out.append(FileCurve(np.roll(chain[:-1], -before, axis=0) if closed else chain, closed))
    return out


def _shut(points: FloatArray) -> bool:
    return len(points) > 3 and bool(np.linalg.norm(points[0] - points[-1]) <= _JOINED_WITHIN)


def refused(code: str, path: Path, field: str, what: str) -> TandemError:
    return refusal(code, f"{path.name}: {what}", file=str(path), field=field)
