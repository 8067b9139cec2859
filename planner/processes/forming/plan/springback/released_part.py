"""Springback over a formed part, and the released part, over a grid in plan, for pages and replay.

Each point of the path springs back by S, so the part is the path minus S, and is S too shallow; with a
springback file it is too shallow by S minus the file's shift. Between targets the nearest one in plan counts,
on floors that of their edge. A feature that is formed in several passes has the result of the last of them.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import shapely
from scipy.spatial import cKDTree

from planner.geometry.arrays import FloatArray, IntArray, Mesh
from planner.geometry.mesh import bisect_triangles
from planner.geometry.units import MM
from planner.processes.forming.plan.contact import FormingPass, FormingToolPath
from planner.processes.forming.plan.process_plan import FormingWork
from planner.processes.forming.plan.springback import forecast
from planner.processes.forming.plan.springback.compensation import ShiftedPath, file_error, shift_at_targets
from planner.processes.forming.plan.springback.compensation_file import PassForecast, SpringbackFile
from planner.processes.forming.plan.springback.control_points import ClusterRing, ControlPoints
from planner.processes.forming.plan.springback.curves import PassSpringback
from planner.processes.forming.plan.springback.forecast import SpringbackEstimate
from planner.processes.forming.plan.springback.levels import resample_loop

PassToolPaths = Sequence[tuple[FormingPass, FormingToolPath]]

GRID_POINTS_PER_SIDE: Final = 80
"""Number of points of the grid along its longer side."""
GRID_MARGIN_M: Final = 5.0 * MM
"""Width [m] of flat sheet around what is formed that the grid includes."""
PIECE_SIZE_M: Final = 2.0 * MM
"""Size [m] of the pieces by which faces of the part are searched."""
MAX_PIECES: Final = 200_000
"""Maximum number of pieces of the part's faces."""
SCALE_ENDS_MM: Final = (2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
"""Ends [mm] of the scale of deviations: the first one above the whole springback is used.

There are few, so that plans of one part have the same.
"""


def compensated_exhibit(work: FormingWork, paths: PassToolPaths, given: SpringbackFile) -> dict[str, Any]:
    """Return the exhibit of the deviation with a springback file, by its own forecast.

    Args:
        work: Work of the operation.
        paths: Passes with their tool paths without shifts.
        given: Springback file.

    Raises:
        TandemError: forming.compensation if the file has no forecast of a pass.
    """
    by_name = {pass_forecast.name: pass_forecast for pass_forecast in given.forecasts}
    shifted_paths = {shifted.name: shifted for shifted in given.paths}
    springback, shifts = {}, {}
    for forming_pass, path in paths:
        if forming_pass.name not in by_name:
            raise file_error(f"it has no control points for pass {forming_pass.name}")
        springback[forming_pass.name] = _forecast_at_targets(
            work, forming_pass, path, by_name[forming_pass.name]
        )
        shifts[forming_pass.name] = shift_at_targets(shifted_paths[forming_pass.name], path)
    note = f"by {given.file}: its forecast minus the shift of the tools; not measured"
    return _released_exhibit(work, paths, springback, shifts, note)


def estimated_exhibit(
    work: FormingWork, paths: PassToolPaths, estimate: SpringbackEstimate
) -> dict[str, Any]:
    """Return the exhibit of the deviation without a springback file, for the feature that was estimated.

    Values are interpolated in depth between the estimated points, and constant beyond.
    """
    estimated_pass, estimated_path = paths[estimate.number]
    depth = np.abs(estimated_path.contact.point[list(estimate.rows), 2] - estimated_pass.start)
    order = np.argsort(depth)
    springback = {
        forming_pass.name: np.interp(
            np.abs(path.contact.point[:, 2] - forming_pass.start),
            depth[order],
            np.array(estimate.springback)[order],
        )
        for forming_pass, path in paths
        if forming_pass.feature == estimated_pass.feature
    }
    count = len(estimate.rows)
    note = f"estimated at {count} point{'s' * (count > 1)} of pass {estimated_pass.name}, under "
    note += f"{estimate.force_text(estimate.force)}, interpolated in depth; not measured"
    return _released_exhibit(work, paths, springback, {}, note)


def _forecast_at_targets(
    work: FormingWork, forming_pass: FormingPass, path: FormingToolPath, pass_forecast: PassForecast
) -> FloatArray:
    """Return the springback (N,) [m] at the targets of a path, by the control points of a file.

    The file has no rings. Each level of its control points takes the loop of the path nearest in height.
    """
    contact = path.contact
    loops = np.unique(contact.loop)
    height = np.array([contact.point[contact.loop == k, 2].mean() for k in loops])
    rings: list[ClusterRing] = []
    level: list[int] = []
    ring_index: list[int] = []
    for number, file_level in enumerate(np.unique(pass_forecast.level)):
        points = pass_forecast.point[pass_forecast.level == file_level]
        nearest = loops[int(np.abs(height - points[:, 2].mean()).argmin())]
        ring = resample_loop(contact.point[contact.loop == nearest])
        rings.append(ClusterRing(ring, np.zeros(len(ring)), np.zeros(len(ring), dtype=np.int64)))
        level += [number] * len(points)
        ring_index += np.atleast_1d(cKDTree(ring[:, :2]).query(points[:, :2])[1]).tolist()
    order = np.argsort(pass_forecast.level, kind="stable")
    zeros = np.zeros(len(order), dtype=np.int64)
    control = ControlPoints(
        pass_forecast.point[order],
        np.zeros(len(order)),
        np.array(level),
        np.array(ring_index),
        zeros,
        tuple(rings),
        zeros,
        zeros,
    )
    curves = tuple(pass_forecast.curves[k] for k in order)
    springback = PassSpringback(
        forming_pass, control, curves, pass_forecast.force[order], pass_forecast.springback[order]
    )
    return forecast.springback_along(work, springback, contact.point, contact.angle)


def springback_maps(
    work: FormingWork,
    paths: PassToolPaths,
    forecasts: Sequence[PassSpringback],
    shifted_paths: Sequence[ShiftedPath] = (),
) -> dict[str, Any]:
    """Return maps of a forecast in plan, as exhibits by name; none if the sheet snaps at all points.

    With ``shifted_paths`` there are also maps of how much too shallow the part will be without their shifts
    and with them, on one scale.
    """
    grid = _PlanGrid(work, paths)
    springback = grid.values_at_points(
        {
            forecast_item.forming_pass.name: forecast.springback_along(
                work, forecast_item, path.contact.point, path.contact.angle
            )
            for forecast_item, (_, path) in zip(forecasts, paths, strict=True)
        }
    )
    if np.isnan(springback).all():
        return {}  # the sheet snaps at all points
    maps = {"springback": ("Springback of the sheet when the tool releases it", springback)}
    if shifted_paths:
        by_name = {shifted.name: shifted for shifted in shifted_paths}
        remaining = springback - grid.values_at_points(
            {
                forming_pass.name: shift_at_targets(by_name[forming_pass.name], path)
                for forming_pass, path in paths
            }
        )
        maps["deviation_before"] = ("How much too shallow the part will be without the file", springback)
        maps["deviation_after"] = ("How much too shallow the part will be with the file", remaining)
    end = _scale_end(springback)
    formed = grid.points[np.isfinite(springback), :2]
    low, high = formed.min(axis=0) - GRID_MARGIN_M, formed.max(axis=0) + GRID_MARGIN_M
    is_near = ((grid.points[:, :2] > low) & (grid.points[:, :2] < high)).all(axis=1)
    return {
        name: {
            "kind": "heatmap",
            "title": title,
            "points": grid.points[is_near],
            "value": value[is_near] / MM,
            "unit": "mm",
            **({} if name == "springback" else {"limit": end}),
        }
        for name, (title, value) in maps.items()
    }


def _released_exhibit(
    work: FormingWork,
    paths: PassToolPaths,
    target_springback: Mapping[str, FloatArray],
    target_shifts: Mapping[str, FloatArray],
    note: str,
) -> dict[str, Any]:
    """Return the exhibit of the formed and the released part over a grid in plan.

    ``target_springback`` and ``target_shifts`` have for each pass, by its name, the springback and the shift
    (N,) [m] at its targets. The deviation is NaN where a pass has no springback. A pass without shifts counts
    as not shifted. ``note`` states the origin of the values.
    """
    grid = _PlanGrid(work, paths)
    springback = grid.values_at_points(target_springback)
    shift = np.nan_to_num(grid.values_at_points(target_shifts))
    deviation = springback - shift
    nominal = grid.points[:, 2]
    shape = (len(grid.y), len(grid.x))
    return {
        "kind": "released",
        "title": "How much too shallow the released part is",
        "note": note,
        "x": grid.x,
        "y": grid.y,
        "formed": (nominal - grid.side * shift).reshape(shape),
        "released": (nominal + grid.side * np.nan_to_num(deviation)).reshape(shape),
        "deviation": deviation.reshape(shape) / MM,
        "limit": _scale_end(springback),
        "unit": "mm",
    }


def _scale_end(springback: FloatArray) -> float:
    """Return the end [mm] of the scale for springback (N,) [m]; NaN counts as 0."""
    max_mm = float(np.nanmax(springback, initial=0.0)) / MM
    return next((end for end in SCALE_ENDS_MM if end >= max_mm), SCALE_ENDS_MM[-1])


class _PlanGrid:
    """Grid of M = H W points in plan over a part, line by line.

    Attributes:
        x: Positions x (W,) [m] of the grid lines.
        y: Positions y (H,) [m] of the grid lines.
        points: Points (M, 3) [m] of the part's lower face.
        side: Side (M,) of the pass that forms there.
    """

    def __init__(self, work: FormingWork, paths: PassToolPaths) -> None:
        last_passes = {forming_pass.feature: (forming_pass, path) for forming_pass, path in paths}
        outline = {
            feature: shapely.Polygon(forming_pass.region[:, :2])
            for feature, (forming_pass, _) in last_passes.items()
        }
        self.x, self.y = _grid_lines(list(outline.values()), work.sheet.opening)
        plan = np.stack(np.meshgrid(self.x, self.y), axis=-1).reshape(-1, 2)
        self.points = np.column_stack([plan, _face_height(work.formed_mesh, plan)])
        self.side = np.ones(len(plan))
        innermost = np.full(len(plan), -1)
        # smaller outlines last: a point belongs to the innermost feature around it
        for feature in sorted(last_passes, key=lambda feature: -outline[feature].area):
            innermost[shapely.contains_xy(outline[feature], plan[:, 0], plan[:, 1])] = feature
        self._nearest: dict[str, tuple[IntArray, IntArray]] = {}
        for feature, (forming_pass, path) in last_passes.items():
            inside = np.flatnonzero(innermost == feature)
            self.side[inside] = forming_pass.side
            nearest = np.asarray(cKDTree(path.contact.point[:, :2]).query(plan[inside])[1])
            self._nearest[forming_pass.name] = inside, nearest

    def values_at_points(self, value: Mapping[str, FloatArray]) -> FloatArray:
        """Return values (M,) at the points from those (N,) at the targets of passes; NaN without targets."""
        out = np.full(len(self.points), np.nan)
        for name, (inside, nearest) in self._nearest.items():
            if name in value:
                out[inside] = value[name][nearest]
        return out


def _grid_lines(outlines: Sequence[shapely.Polygon], opening: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return grid lines along x (W,) and y (H,) [m]: dense over what is formed, and the opening's ends."""
    low, high = np.array(shapely.union_all(outlines).bounds).reshape(2, 2) + np.array(
        [[-GRID_MARGIN_M], [GRID_MARGIN_M]]
    )
    step = float((high - low).max()) / (GRID_POINTS_PER_SIDE - 1)
    lines = []
    for start, end, first, last in zip(low, high, opening.min(axis=0), opening.max(axis=0), strict=True):
        dense = np.linspace(start, end, 1 + max(1, round((end - start) / step)))
        ends = np.array([first, last])
        lines.append(np.sort(np.append(dense, ends[[first < start, last > end]])))
    return lines[0], lines[1]


def _face_height(mesh: Mesh, plan: FloatArray) -> FloatArray:
    """Return the height (M,) [m] of a face at points (M, 2), by the plane of its nearest piece in plan."""
    corners = mesh.vertices[mesh.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    is_usable = np.abs(normal[:, 2]) > 1e-3 * np.linalg.norm(normal, axis=1)
    corners, normal = corners[is_usable], normal[is_usable]
    pieces, owner = bisect_triangles(corners, PIECE_SIZE_M, MAX_PIECES)
    face = owner[cKDTree(pieces.mean(axis=1)[:, :2]).query(plan)[1]]
    slope = normal[face, :2] / normal[face, 2:]
    height = corners[face, 0, 2] - ((plan - corners[face, 0, :2]) * slope).sum(axis=1)
    # beside a steep face its plane quickly leaves the range of its heights
    return np.asarray(np.clip(height, corners[face, :, 2].min(axis=1), corners[face, :, 2].max(axis=1)))
