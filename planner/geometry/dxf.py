"""Curves from DXF files, by ``ezdxf``, which comes with the extra ``cad``."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from planner.files import is_file
from planner.issues import Issue, Severity, TandemError

FloatArray = NDArray[np.float64]

INSTALL: Final = "pip install 'tandem-planner[cad]'"
KINDS: Final = ("LINE", "ARC", "CIRCLE", "ELLIPSE", "SPLINE", "LWPOLYLINE", "POLYLINE")
FLATNESS: Final = 2e-6
"""How far [m] the points of arcs and splines may be off them."""
_MOST_BYTES: Final = 50_000_000
_MOST_PIECES: Final = 2000
_MEET: Final = 1e-5
"""Ends [m] that are this near are joined."""


@dataclasses.dataclass(frozen=True)
class DxfCurve:
    """Points (N, 3) [m]; a ``closed`` curve does not repeat its first."""

    points: FloatArray
    closed: bool


def read_dxf(path: Path, unit: float, layer: str | None, field: str) -> tuple[list[DxfCurve], list[Issue]]:
    """Curves of a drawing's model space, lengths in ``unit`` metres, and notes of what was left out.

    Pieces whose ends meet within 0.01 mm are joined. Raises ``TandemError`` with ``problem.missing_file``,
    ``problem.too_large``, ``part.extra_missing`` or ``part.dxf``.
    """
    if not is_file(path):
        raise _refuse("problem.missing_file", path, field, "there is no such file; check the path")
    if path.stat().st_size > _MOST_BYTES:
        raise _refuse("problem.too_large", path, field, "more than 50 MB; export only the curves")
    try:
        from ezdxf import path as ezpath
        from ezdxf.filemanagement import readfile
    except ImportError as error:
        raise _refuse("part.extra_missing", path, field, f"DXF files need ezdxf; {INSTALL}") from error
    try:
        drawing = readfile(path)
        space = list(drawing.modelspace())
    except Exception as error:  # damaged files raise anything
        reason = str(error).splitlines()[0][:120] if str(error) else type(error).__name__
        raise _refuse("part.dxf", path, field, f"cannot be read ({reason}); export it again") from error
    layers = sorted({entity.dxf.layer for entity in space})
    wanted = [e for e in space if layer is None or e.dxf.layer.lower() == layer.lower()]
    curves = [e for e in wanted if e.dxftype() in KINDS]
    if not curves:
        what = f"has no curves on layer {layer}" if layer is not None else "has no curves"
        raise _refuse("part.dxf", path, field, f"{what}; its layers are {', '.join(layers[:12]) or '(none)'}")
    notes = []
    others = sorted({e.dxftype() for e in wanted} - set(KINDS))
    if others:
        what = f"{path.name}: left out {', '.join(others)}; only {', '.join(KINDS)} are read (explode blocks)"
        notes.append(Issue("part.dxf_left_out", what, Severity.NOTE, file=str(path), field=field))
    pieces = [_flat(e, ezpath, unit) for e in curves]
    pieces = [p for p in pieces if len(p) > 1]
    if len(pieces) > _MOST_PIECES:
        what = f"has {len(pieces)} curves, {_MOST_PIECES} are read; name a layer, or join them to polylines"
        raise _refuse("part.dxf", path, field, what)
    if any(not np.isfinite(p).all() for p in pieces):
        raise _refuse("part.dxf", path, field, "has numbers that are not finite; export it again")
    return _joined(pieces), notes


def _flat(entity: Any, ezpath: Any, unit: float) -> FloatArray:
    curve = ezpath.make_path(entity)
    points = [(v.x, v.y, v.z) for v in curve.flattening(FLATNESS / unit, segments=16)]
    return np.array(points, dtype=np.float64).reshape(-1, 3) * unit


def _joined(pieces: list[FloatArray]) -> list[DxfCurve]:
    """Curves made of pieces whose ends meet, in the order of the file."""
    left = list(pieces)
    out = []
    while left:
        chain = left.pop(0)
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
        out.append(DxfCurve(chain[:-1] if closed else chain, closed))
    return out


def _shut(points: FloatArray) -> bool:
    return len(points) > 3 and bool(np.linalg.norm(points[0] - points[-1]) <= _MEET)


def _attach(chain: FloatArray, other: FloatArray) -> FloatArray | None:
    for own in (chain, chain[::-1]):
        for piece in (other, other[::-1]):
            if np.linalg.norm(own[-1] - piece[0]) <= _MEET:
                return np.concatenate([own, piece[1:]])
    return None


def _refuse(code: str, path: Path, field: str, what: str) -> TandemError:
    return TandemError(Issue(code, f"{path.name}: {what}", file=str(path), field=field))
