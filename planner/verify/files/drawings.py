"""Curves of DXF drawings from the raw values of their entities.

ezdxf parses the text; what arcs, bulges, ellipses and splines are is worked out here. Source: Autodesk, DXF
Reference (2018), entities and "Arbitrary Axis Algorithm".
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from planner.verify.files.faults import UnreadError
from planner.verify.files.splines import nurbs

FloatArray = NDArray[np.float64]

MEET: Final = 1e-5
"""Ends of pieces that are so near [m] are joined."""
SAG: Final = 1e-6
"""Chords of arcs and splines are off them by this at most [m]."""
FEWEST: Final = 48
"""Chords of a full turn, or of a span of a spline, at least."""


@dataclasses.dataclass(frozen=True)
class Drawn:
    """A curve: points (N, 3) [m], the first not repeated where it is ``closed``; ``pieces`` it was joined of:
    which way round several of them run, a drawing does not say."""

    points: FloatArray
    closed: bool
    pieces: int


def read_curves(path: Path, unit: float, layer: str | None) -> list[Drawn]:
    """The curves of the model space, of one layer or all. Raises `UnreadError`."""
    try:
        from ezdxf.filemanagement import readfile
    except ImportError as error:
        raise UnreadError("DXF files need ezdxf: pip install 'tandem-planner[cad]'") from error
    pieces = []
    try:
        for entity in readfile(path).modelspace():
            if layer is None or str(entity.dxf.layer).lower() == layer.lower():
                points = _points(entity, unit)
                if points is not None and len(points) > 1:
                    pieces.append(points * unit)
    except Exception as error:  # damaged files raise anything
        raise UnreadError(str(error).splitlines()[0][:120] if str(error) else type(error).__name__) from error
    return _chained(pieces)


def _points(entity: Any, unit: float) -> FloatArray | None:
    """Points (N, 3) of a curve in the drawing's lengths; None for what is none."""
    kind, dxf = entity.dxftype(), entity.dxf
    if kind == "LINE":
        return np.array([tuple(dxf.start), tuple(dxf.end)], dtype=np.float64)
    if kind in ("ARC", "CIRCLE"):
        first, last = (dxf.start_angle, dxf.end_angle) if kind == "ARC" else (0.0, 360.0)
        turn = (last - first) % 360.0 or 360.0
        angle = np.deg2rad(first + turn * _shares(dxf.radius * unit, np.deg2rad(turn)))
        centre = np.array(tuple(dxf.center), dtype=np.float64)
        flat = dxf.radius * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))])
        return _to_world(centre + flat, dxf.extrusion)
    if kind == "ELLIPSE":
        major = np.array(tuple(dxf.major_axis), dtype=np.float64)
        up = np.array(tuple(dxf.extrusion), dtype=np.float64)
        minor = dxf.ratio * np.cross(up / np.linalg.norm(up), major)
        turn = (dxf.end_param - dxf.start_param) % (2.0 * np.pi)
        turn = turn if turn > 1e-12 else 2.0 * np.pi
        count = 4 * len(_shares(float(np.linalg.norm(major)) * unit, turn))
        angle = (dxf.start_param + turn * np.linspace(0.0, 1.0, count))[:, None]
        return np.asarray(np.array(tuple(dxf.center)) + np.cos(angle) * major + np.sin(angle) * minor)
    if kind == "SPLINE":
        return _spline(entity)
    if kind == "LWPOLYLINE":
        rows = np.array([(x, y, bulge) for x, y, bulge in entity.get_points("xyb")], dtype=np.float64)
        height = float(dxf.get("elevation", 0.0))
        return _to_world(_bulged(rows, height, bool(entity.closed), unit), dxf.extrusion)
    if kind == "POLYLINE":
        corners = [vertex.dxf for vertex in entity.vertices]
        places = np.array([tuple(vertex.location) for vertex in corners], dtype=np.float64).reshape(-1, 3)
        if entity.is_3d_polyline:
            return np.concatenate([places, places[:1]]) if entity.is_closed else places
        if not entity.is_2d_polyline or not len(places):
            return None
        bulge = np.array([float(vertex.get("bulge", 0.0)) for vertex in corners])
        height = float(tuple(dxf.get("elevation", (0.0, 0.0, 0.0)))[2])
        rows = np.column_stack([places[:, :2], bulge])
        return _to_world(_bulged(rows, height, bool(entity.is_closed), unit), dxf.extrusion)
    return None


def _shares(radius: float, turn: float) -> FloatArray:
    """Places from 0 to 1 along an arc of ``radius`` [m] over ``turn`` [rad]."""
    step = 2.0 * np.arccos(max(0.0, 1.0 - SAG / max(radius, SAG)))
    count = max(int(np.ceil(turn / step)), int(np.ceil(FEWEST * turn / (2.0 * np.pi))), 2)
    return np.linspace(0.0, 1.0, count + 1)


def _to_world(points: FloatArray, extrusion: Any) -> FloatArray:
    """Points of an entity's own frame, whose z is ``extrusion``, in that of the drawing."""
    z = np.array(tuple(extrusion), dtype=np.float64)
    z = z / np.linalg.norm(z)
    x = np.cross([0.0, 1.0, 0.0] if max(abs(z[0]), abs(z[1])) < 1.0 / 64.0 else [0.0, 0.0, 1.0], z)
    x = x / np.linalg.norm(x)
    return np.asarray(points @ np.array([x, np.cross(z, x), z]))


def _bulged(rows: FloatArray, height: float, closed: bool, unit: float) -> FloatArray:
    """Points of a polyline (K, 3) of x, y and bulge, the tangent of a quarter of the arc to the next one."""
    out = [rows[:1, :2]]
    after = np.roll(rows, -1, axis=0)
    for start, end in zip(rows[: None if closed else -1], after[: None if closed else -1], strict=True):
        chord, bulge = end[:2] - start[:2], float(start[2])
        size = float(np.hypot(*chord))
        if abs(bulge) < 1e-12 or size == 0.0:
            out.append(end[None, :2])
            continue
        # the arc is on the right of its chord for a bulge above zero; parameters of the half angle's tangent
        turn = 4.0 * np.arctan(bulge)
        radius = 0.5 * size / abs(np.sin(0.5 * turn))
        left = np.array([-chord[1], chord[0]])
        centre = start[:2] + 0.5 * chord + 0.25 * left * (1.0 - bulge**2) / bulge
        angle = turn * _shares(radius * unit, abs(turn))[1:, None]
        arm = start[:2] - centre
        out.append(centre + np.cos(angle) * arm + np.sin(angle) * np.array([-arm[1], arm[0]]))
    flat = np.concatenate(out)
    return np.column_stack([flat, np.full(len(flat), height)])


def _spline(entity: Any) -> FloatArray | None:
    control = np.array([tuple(point) for point in entity.control_points], dtype=np.float64).reshape(-1, 3)
    if not len(control):
        # through fit points alone, a curve is what the program that drew it says
        tool = entity.construction_tool()
        return np.array([tuple(point) for point in tool.approximate(400)], dtype=np.float64)
    degree = int(entity.dxf.degree)
    knots = np.array(list(entity.knots), dtype=np.float64)
    weight = np.array(list(entity.weights), dtype=np.float64)
    weight = weight if len(weight) == len(control) else np.ones(len(control))
    spans = np.unique(knots[degree : len(control) + 1])
    inner = np.linspace(0.0, 1.0, 4 * FEWEST, endpoint=False)
    t = np.append((spans[:-1, None] + np.diff(spans)[:, None] * inner).ravel(), spans[-1])
    return nurbs(control, weight, knots, degree, t)


def _chained(pieces: list[FloatArray]) -> list[Drawn]:
    """Curves of pieces whose ends meet; what is closed is left as it is."""
    out: list[Drawn] = []
    left = list(range(len(pieces)))
    while left:
        chain, count = pieces[left.pop(0)], 1
        while left and not _shut(chain):
            ends = np.array([pieces[i][[0, -1]] for i in left])
            open_ = np.array([not _shut(pieces[i]) for i in left])
            gap = np.linalg.norm(ends[:, :, None] - chain[[0, -1]][None, None], axis=3)
            gap[~open_] = np.inf
            which, end, own = np.unravel_index(int(np.argmin(gap)), gap.shape)
            if gap[which, end, own] > MEET:
                break
            piece = pieces[left.pop(int(which))]
            piece = piece if end == 0 else piece[::-1]  # leads away from the chain
            chain = np.concatenate([chain, piece[1:]] if own else [piece[:0:-1], chain])
            count += 1
        shut = _shut(chain)
        out.append(Drawn(chain[:-1] if shut else chain, shut, count))
    return out


def _shut(points: FloatArray) -> bool:
    return len(points) > 3 and bool(np.linalg.norm(points[0] - points[-1]) <= MEET)
