"""Springback over a formed part, and the part as it is released: over a grid in plan, for pages and replay.

Each place of the path comes back by S, so what is left is the path less S, and the part is S too shallow;
with a springback file S less the file's shift. Between targets the nearest in plan counts, on floors that of
their edge; a feature that is formed in several passes is what the last of them leaves.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import shapely
from scipy.spatial import cKDTree

from planner.geometry.arrays import FloatArray, IntArray, Mesh
from planner.geometry.mesh import small_pieces
from planner.geometry.units import MM
from planner.processes.forming.plan.contact import Pass, ToolPath
from planner.processes.forming.plan.process_plan import Work
from planner.processes.forming.plan.springback import forecast
from planner.processes.forming.plan.springback.compensation import Way, at_targets, refused
from planner.processes.forming.plan.springback.compensation_file import Compensation, Foretold
from planner.processes.forming.plan.springback.control_points import ControlPoints, Ring
from planner.processes.forming.plan.springback.curves import PassSpringback
from planner.processes.forming.plan.springback.forecast import Estimate
from planner.processes.forming.plan.springback.levels import evenly

Laid = Sequence[tuple[Pass, ToolPath]]

MOST_PLACES: Final = 80
"""Places of the grid along its longer side."""
AROUND: Final = 5.0 * MM
"""Flat sheet [m] around what is formed that the grid has, too."""
PIECE: Final = 2.0 * MM
"""Faces of the part are looked for by pieces of this size [m]."""
MOST_PIECES: Final = 200_000
"""Pieces of the part's faces at most."""
SCALE_ENDS: Final = (2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
"""Ends [mm] of the scale of deviations: the first beyond all that the sheet comes back by; few of them, so
that plans of one part have the same."""


def compensated(work: Work, laid: Laid, given: Compensation) -> dict[str, Any]:
    """What is left with a springback file, by its own forecast; ``laid`` are the paths without its shifts.
    Raises ``TandemError`` (forming.compensation) where it foretells nothing of a pass."""
    by_name = {one.name: one for one in given.foretold}
    ways = {way.name: way for way in given.ways}
    back, deeper = {}, {}
    for one, path in laid:
        if one.name not in by_name:
            raise refused(f"it has no control points for pass {one.name}")
        back[one.name] = _interpolated(work, one, path, by_name[one.name])
        deeper[one.name] = at_targets(ways[one.name], path)
    note = f"by {given.file}: its forecast less what the tools go deeper; nothing was measured"
    return _exhibit(work, laid, back, deeper, note)


def estimated(work: Work, laid: Laid, found: Estimate) -> dict[str, Any]:
    """What is left without a springback file: of the feature that was estimated, by
    depth between its places and as at the nearest of them beyond."""
    estimated_pass, estimated_path = laid[found.number]
    depth = np.abs(estimated_path.contact.point[list(found.rows), 2] - estimated_pass.start)
    order = np.argsort(depth)
    back = {
        one.name: np.interp(
            np.abs(path.contact.point[:, 2] - one.start), depth[order], np.array(found.springback)[order]
        )
        for one, path in laid
        if one.feature == estimated_pass.feature
    }
    count = len(found.rows)
    note = f"estimated at {count} place{'s' * (count > 1)} of pass {estimated_pass.name}, under "
    note += f"{found.under(found.force)}, by depth between; nothing was measured"
    return _exhibit(work, laid, back, {}, note)


def _interpolated(work: Work, one: Pass, path: ToolPath, given: Foretold) -> FloatArray:
    """Springback (N,) [m] at the targets of a path by the control points of a file."""
    contact = path.contact
    loops = np.unique(contact.loop)
    height = np.array([contact.point[contact.loop == k, 2].mean() for k in loops])
    rings: list[Ring] = []
    level: list[int] = []
    place: list[int] = []
    for number, old in enumerate(np.unique(given.level)):
        points = given.point[given.level == old]
        nearest = loops[int(np.abs(height - points[:, 2].mean()).argmin())]
        ring = evenly(contact.point[contact.loop == nearest])
        rings.append(Ring(ring, np.zeros(len(ring)), np.zeros(len(ring), dtype=np.int64)))
        level += [number] * len(points)
        place += np.atleast_1d(cKDTree(ring[:, :2]).query(points[:, :2])[1]).tolist()
    order = np.argsort(given.level, kind="stable")
    none = np.zeros(len(order), dtype=np.int64)
    control = ControlPoints(
        given.point[order],
        np.zeros(len(order)),
        np.array(level),
        np.array(place),
        none,
        tuple(rings),
        none,
        none,
    )
    curves = tuple(given.curves[k] for k in order)
    found = PassSpringback(one, control, curves, given.force[order], given.springback[order])
    return forecast.along(work, found, contact.point, contact.angle)


def maps(work: Work, laid: Laid, found: Sequence[PassSpringback], ways: Sequence[Way] = ()) -> dict[str, Any]:
    """A forecast as a map; with ``ways`` also how much too shallow the part will be without their shifts and
    with them, on one scale."""
    grid = _Grid(work, laid)
    back = grid.spread(
        {
            one.one.name: forecast.along(work, one, path.contact.point, path.contact.angle)
            for one, (_, path) in zip(found, laid, strict=True)
        }
    )
    if np.isnan(back).all():
        return {}  # the sheet snaps wherever it was asked
    named = {"springback": ("How far the sheet comes back when the tool lets go", back)}
    if ways:
        by_name = {way.name: way for way in ways}
        left = back - grid.spread({one.name: at_targets(by_name[one.name], path) for one, path in laid})
        named["deviation_before"] = ("How much too shallow the part will be, without the file", back)
        named["deviation_after"] = ("How much too shallow the part will be, with it", left)
    end = _scale_end(back)
    formed = grid.points[np.isfinite(back), :2]
    low, high = formed.min(axis=0) - AROUND, formed.max(axis=0) + AROUND
    near = ((grid.points[:, :2] > low) & (grid.points[:, :2] < high)).all(axis=1)
    return {
        name: {
            "kind": "heatmap",
            "title": title,
            "points": grid.points[near],
            "value": value[near] / MM,
            "unit": "mm",
            **({} if name == "springback" else {"limit": end}),
        }
        for name, (title, value) in named.items()
    }


def _exhibit(
    work: Work, laid: Laid, back: Mapping[str, FloatArray], deeper: Mapping[str, FloatArray], note: str
) -> dict[str, Any]:
    """Heights over the grid. ``back`` and ``deeper`` {pass: (N,)} [m] at targets: what the sheet comes back
    by, and what the tools go deeper by; passes that ``back`` does not have are not known."""
    grid = _Grid(work, laid)
    springback, shift = grid.spread(back), np.nan_to_num(grid.spread(deeper))
    left, wanted, shape = springback - shift, grid.points[:, 2], (len(grid.y), len(grid.x))
    return {
        "kind": "released",
        "title": "How much too shallow the part is once the tools have let go",
        "note": note,
        "x": grid.x,
        "y": grid.y,
        "formed": (wanted - grid.side * shift).reshape(shape),
        "released": (wanted + grid.side * np.nan_to_num(left)).reshape(shape),
        "deviation": left.reshape(shape) / MM,
        "limit": _scale_end(springback),
        "unit": "mm",
    }


def _scale_end(springback: FloatArray) -> float:
    most = float(np.nanmax(springback, initial=0.0)) / MM
    return next((end for end in SCALE_ENDS if end >= most), SCALE_ENDS[-1])


class _Grid:
    """Places M = H W over a part, row by row: ``points`` (M, 3) [m] of its lower face on lines ``x`` (W,) and
    ``y`` (H,), ``side`` (M,) of the pass that forms there."""

    def __init__(self, work: Work, laid: Laid) -> None:
        last = {one.feature: (one, path) for one, path in laid}
        outline = {feature: shapely.Polygon(one.region[:, :2]) for feature, (one, _) in last.items()}
        self.x, self.y = _lines(list(outline.values()), work.sheet.opening)
        plan = np.stack(np.meshgrid(self.x, self.y), axis=-1).reshape(-1, 2)
        self.points = np.column_stack([plan, _height(work.left, plan)])
        self.side = np.ones(len(plan))
        inner = np.full(len(plan), -1)
        # smaller outlines later: a place belongs to the innermost feature around it
        for feature in sorted(last, key=lambda feature: -outline[feature].area):
            inner[shapely.contains_xy(outline[feature], plan[:, 0], plan[:, 1])] = feature
        self._nearest: dict[str, tuple[IntArray, IntArray]] = {}
        for feature, (one, path) in last.items():
            inside = np.flatnonzero(inner == feature)
            self.side[inside] = one.side
            nearest = np.asarray(cKDTree(path.contact.point[:, :2]).query(plan[inside])[1])
            self._nearest[one.name] = inside, nearest

    def spread(self, value: Mapping[str, FloatArray]) -> FloatArray:
        """Values (M,) at the places by those {pass: (N,)} at its targets; NaN where there is none."""
        out = np.full(len(self.points), np.nan)
        for name, (inside, nearest) in self._nearest.items():
            if name in value:
                out[inside] = value[name][nearest]
        return out


def _lines(outlines: Sequence[shapely.Polygon], opening: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lines of the grid along x (W,) and y (H,) [m]: close over what is formed, then the opening's ends."""
    low, high = np.array(shapely.union_all(outlines).bounds).reshape(2, 2) + np.array([[-AROUND], [AROUND]])
    step = float((high - low).max()) / (MOST_PLACES - 1)
    lines = []
    for a, b, first, last in zip(low, high, opening.min(axis=0), opening.max(axis=0), strict=True):
        close = np.linspace(a, b, 1 + max(1, round((b - a) / step)))
        ends = np.array([first, last])
        lines.append(np.sort(np.append(close, ends[[first < a, last > b]])))
    return lines[0], lines[1]


def _height(mesh: Mesh, plan: FloatArray) -> FloatArray:
    """Height (M,) [m] of a face at places (M, 2), by the plane of the nearest piece of it in plan."""
    corners = mesh.vertices[mesh.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    level = np.abs(normal[:, 2]) > 1e-3 * np.linalg.norm(normal, axis=1)
    corners, normal = corners[level], normal[level]
    pieces, owner = small_pieces(corners, PIECE, MOST_PIECES)
    face = owner[cKDTree(pieces.mean(axis=1)[:, :2]).query(plan)[1]]
    slope = normal[face, :2] / normal[face, 2:]
    height = corners[face, 0, 2] - ((plan - corners[face, 0, :2]) * slope).sum(axis=1)
    # beside a steep face its plane soon leaves it
    return np.asarray(np.clip(height, corners[face, :, 2].min(axis=1), corners[face, :, 2].max(axis=1)))
