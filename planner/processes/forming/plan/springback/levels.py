"""Data of a forecast that the level-by-level control loop needs, for its file (`planner.loops.loop_plan`).

Each loop of the path is a level. Its points are those nearest to the control points of the closest level that
has some, and others between, so that force is measured all around. Curves are interpolated between the levels
with control points above and below, and along their rings, as `PassSpringback.at` interpolates springback.
"""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import FloatArray, IntArray
from planner.geometry.curves import arc_length, interpolate_polyline
from planner.geometry.units import MM
from planner.processes.forming.plan.contact import FormingPass, FormingToolPath
from planner.processes.forming.plan.level import first_loops
from planner.processes.forming.plan.process_plan import FormingWork
from planner.processes.forming.plan.sheet_mechanics import SCALLOP_EXPONENT
from planner.processes.forming.plan.springback.compensation import ShiftedPath, shift_at_targets
from planner.processes.forming.plan.springback.curves import PassSpringback

FORCE_EXPONENT: Final = 2.0 * SCALLOP_EXPONENT
"""Exponent of the force as a function of the step-down: scallops grow with its square."""
POINT_SPACING_M: Final = 1.0 * MM
"""Spacing [m] of the points of a level, as far as their number permits."""
RING_POINTS_RANGE: Final = (24, 240)
"""Minimum and maximum number of points of a level's ring."""
MIN_MEASURING_POINTS: Final = 48
"""Minimum number of measuring points of a level."""
CURVE_FORCE_FRACTIONS: Final = np.array([0.0, 0.1, 0.25, 0.46, 0.7, 1.0])
"""Forces of a curve as fractions of its largest one."""


def loop_file_data(
    name: str,
    digest: str,
    work: FormingWork,
    paths: Sequence[tuple[FormingPass, FormingToolPath]],
    forecast: Sequence[PassSpringback],
) -> dict[str, Any]:
    """Return the data of a problem's file for the control loop: passes with their levels.

    Args:
        name: Name of the problem.
        digest: Digest of the problem.
        work: Work of the operation.
        paths: Passes with their tool paths.
        forecast: Springback of each pass.
    """
    passes = []
    for (forming_pass, path), springback in zip(paths, forecast, strict=True):
        if np.isnan(springback.springback).any():
            continue  # a sheet that snaps has no curve for a correction
        radius = work.heads[work.forming_arm(forming_pass)].radius
        passes.append(
            {
                "name": forming_pass.name,
                "side": forming_pass.side,
                "ball_radius_mm": radius / MM,
                "force_exponent": FORCE_EXPONENT,
                "levels": _level_data(work, forming_pass, path, springback),
            }
        )
    return {"tandem_loop": 1, "problem": name, "digest": digest, "passes": passes}


def _level_data(
    work: FormingWork, forming_pass: FormingPass, path: FormingToolPath, pass_springback: PassSpringback
) -> list[dict[str, Any]]:
    """Return the data of each level of a pass: its depth, the ring of its path, and its measuring points.

    At each measuring point the control loop measures the force while the level is formed. The data has the
    curve of springback over force there, and the expected force.
    """
    contact = path.contact
    out = []
    interpolator = _CurveInterpolator(pass_springback)
    for number in first_loops(forming_pass, contact):
        points = contact.point[contact.loop == number]
        depth = abs(float(points[:, 2].mean()) - forming_pass.start)
        ring = resample_loop(points)
        indices = _measuring_indices(ring, pass_springback)
        loads, springback, force = interpolator.at(ring[indices])
        if work.stated_forces is not None:
            force = work.stated_forces.force_at(forming_pass.name, ring[indices])
        out.append(
            {
                "depth_mm": round(depth / MM, 4),
                "path_mm": np.round(ring / MM, 3).tolist(),
                "points": [
                    {
                        "place": int(index),
                        "forces_n": np.round(curve_loads, 2).tolist(),
                        "springback_mm": np.round(curve_springback / MM, 4).tolist(),
                        "expected_n": round(float(expected_force), 2),
                    }
                    for index, curve_loads, curve_springback, expected_force in zip(
                        indices, loads, springback, force, strict=True
                    )
                ],
            }
        )
    return out


def resample_loop(points: FloatArray) -> FloatArray:
    """Return a closed loop of points (N, 3) [m] resampled to equidistant points (K, 3)."""
    return interpolate_polyline(np.vstack([points, points[:1]]), *_even_arc(points))


def _even_arc(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the arc lengths (N + 1,) [m] at the points of a loop and at its return to the first one.

    Also returns the arc lengths (K,) [m] of equidistant points on it.
    """
    arc = arc_length(np.vstack([points, points[:1]]))
    count = int(np.clip(round(float(arc[-1]) / POINT_SPACING_M), *RING_POINTS_RANGE))
    return arc, np.arange(count) * arc[-1] / count


def level_shifts(forming_pass: FormingPass, path: FormingToolPath, shifted: ShiftedPath) -> list[FloatArray]:
    """Return the shifts (K,) [m] of a springback file at the points of each level of a pass.

    Args:
        forming_pass: Pass.
        path: Its tool path without the shifts.
        shifted: Path with shifts of the file.
    """
    contact = path.contact
    shift = shift_at_targets(shifted, path)
    out = []
    for number in first_loops(forming_pass, contact):
        in_level = contact.loop == number
        arc, even_arc = _even_arc(contact.point[in_level])
        out.append(np.interp(even_arc, arc, np.append(shift[in_level], shift[in_level][0])))
    return out


def _measuring_indices(ring: FloatArray, springback: PassSpringback) -> IntArray:
    """Return the indices (P,) of a level's measuring points on its ring (K, 3), ascending.

    They are the points nearest to the control points of the closest level that has some, and others between,
    so that there are at least about `MIN_MEASURING_POINTS`.
    """
    control = springback.control
    height = np.array([float(control_ring.point[:, 2].mean()) for control_ring in control.rings])
    nearest = int(np.abs(height - float(ring[:, 2].mean())).argmin())
    control_points = control.point[control.level == nearest]
    nearest_indices = np.unique(cKDTree(ring[:, :2]).query(control_points[:, :2])[1])
    count = len(ring)
    gaps = np.diff(np.append(nearest_indices, nearest_indices[0] + count))
    indices = [
        np.floor(start + gap * np.arange(part_count) / part_count)
        for start, gap in zip(nearest_indices, gaps, strict=True)
        for part_count in [max(1, int(np.ceil(gap * MIN_MEASURING_POINTS / count - 1e-9)))]
    ]
    return np.unique(np.concatenate(indices).astype(np.int64) % count)


class _CurveInterpolator:
    """Interpolates the springback curves of a pass between its control points."""

    def __init__(self, springback: PassSpringback) -> None:
        control = springback.control
        self._rings = control.rings
        self._height = np.array([float(ring.point[:, 2].mean()) for ring in control.rings])
        max_forces = np.array([curve.force[-1] for curve in springback.curves])
        value = np.array(
            [
                curve.at(CURVE_FORCE_FRACTIONS * load)
                for curve, load in zip(springback.curves, max_forces, strict=True)
            ]
        )
        # values to interpolate, for each control point: largest force, springback at fractions of it,
        # expected force
        self._values = np.column_stack([max_forces, value, springback.force])
        self._level, self._ring_index = control.level, control.ring_index

    def at(self, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the interpolated curves at points (P, 3) [m] of one level.

        Returns forces (P, L) [N] and springback (P, L) [m] of the curves, and the expected force (P,) [N].
        """
        z = float(points[:, 2].mean())
        order = np.argsort(self._height)
        height = self._height[order]
        above = int(np.clip(np.searchsorted(height, z), min(1, len(height) - 1), len(height) - 1))
        below = max(above - 1, 0)
        rise = height[above] - height[below]
        fraction = float(np.clip((z - height[below]) / rise, 0.0, 1.0)) if rise > 0.0 else 0.0
        lower_values, upper_values = (self._on_ring(int(order[k]), points) for k in (below, above))
        values = (1.0 - fraction) * lower_values + fraction * upper_values
        return values[:, :1] * CURVE_FORCE_FRACTIONS, values[:, 1:-1], values[:, -1]

    def _on_ring(self, level: int, points: FloatArray) -> FloatArray:
        """Return the values of curves (P, C) at the points of a ring nearest to points (P, 3) [m]."""
        ring, on_level = self._rings[level].point, self._level == level
        nearest = cKDTree(ring[:, :2]).query(points[:, :2])[1]
        ring_index, values = self._ring_index[on_level].astype(np.float64), self._values[on_level]
        return np.stack(
            [np.interp(nearest, ring_index, column, period=float(len(ring))) for column in values.T], axis=1
        )
