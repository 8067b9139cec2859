"""Curves of drawings, joined where their ends meet: DXF files, by ``ezdxf`` of the extra ``cad``."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any, Final

import numpy as np

from planner.files import is_file, no_file
from planner.geometry.arrays import FloatArray
from planner.issues import Issue, Severity, TandemError

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
    """Curves of a drawing's model space, lengths in ``unit`` metres, and notes of what was left out.

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
        reason = str(error).splitlines()[0][:120] if str(error) else type(error).__name__
        raise refused("part.dxf", path, field, f"cannot be read ({reason}); export it again") from error
    layers = sorted({entity.dxf.layer for entity in space})
    wanted = [e for e in space if layer is None or e.dxf.layer.lower() == layer.lower()]
    curves = [e for e in wanted if e.dxftype() in ENTITY_KINDS]
    if not curves:
        what = f"has no curves on layer {layer}" if layer is not None else "has no curves"
        raise refused("part.dxf", path, field, f"{what}; its layers are {', '.join(layers[:12]) or '(none)'}")
    notes = []
    others = sorted({e.dxftype() for e in wanted} - set(ENTITY_KINDS))
    if others:
        what = f"{path.name}: left out {', '.join(others)}; "
        what += f"only {', '.join(ENTITY_KINDS)} are read (explode blocks)"
        notes.append(Issue("part.dxf_left_out", what, Severity.NOTE, file=str(path), field=field))
    pieces = [_flat(e, ezpath, unit) for e in curves]
    pieces = [p for p in pieces if len(p) > 1]
    if len(pieces) > MOST_CURVES:
        what = f"has {len(pieces)} curves, {MOST_CURVES} are read; name a layer, or join them to polylines"
        raise refused("part.dxf", path, field, what)
    if any(not np.isfinite(p).all() for p in pieces):
        raise refused("part.dxf", path, field, "has numbers that are not finite; export it again")
    return joined(pieces), notes


def _flat(entity: Any, ezpath: Any, unit: float) -> FloatArray:
    curve = ezpath.make_path(entity)
    points = [(v.x, v.y, v.z) for v in curve.flattening(FLATNESS / unit, segments=16)]
    return np.array(points, dtype=np.float64).reshape(-1, 3) * unit


def joined(pieces: list[FloatArray]) -> list[FileCurve]:
    """Curves made of pieces whose ends meet, in the order of the file: each is run as the first of its pieces
    is drawn, and one that is closed begins with that."""
    left = list(pieces)
    out = []
    while left:
        first = chain = left.pop(0)
        grown = True
        while grown and not _shut(chain):
            grown = False
            for i, other in enumerate(left):
                if _shut(other):
                    continue
                joined = _attach(chain, other)
                if joined is not None:
                    chain, grown = joined, True
                    left.pop(i)
                    break
        closed = _shut(chain)
        points = chain[:-1] if closed else chain
        out.append(FileCurve(points if chain is first else _run_as(points, closed, first), closed))
    return out


def _run_as(points: FloatArray, closed: bool, first: FloatArray) -> FloatArray:
    """The points (N, 3) of a curve in the direction in which those of its piece ``first`` are."""
    count = len(points)
    for way in (points, points[::-1]):
        for at in np.flatnonzero((way == first[0]).all(axis=1)):
            if (at + 1 < count or closed) and (way[(at + 1) % count] == first[1]).all():
                return np.asarray(np.roll(way, -at, axis=0) if closed else way)
    return points


def _shut(points: FloatArray) -> bool:
    return len(points) > 3 and bool(np.linalg.norm(points[0] - points[-1]) <= _JOINED_WITHIN)


def _attach(chain: FloatArray, other: FloatArray) -> FloatArray | None:
    for own in (chain, chain[::-1]):
        for piece in (other, other[::-1]):
            if np.linalg.norm(own[-1] - piece[0]) <= _JOINED_WITHIN:
                return np.concatenate([own, piece[1:]])
    return None


def refused(code: str, path: Path, field: str, what: str) -> TandemError:
    return TandemError(Issue(code, f"{path.name}: {what}", file=str(path), field=field))
