"""Sides of planar panels as their programs cut them, and the joints between them.

Neighbours share the plane of their sides. The proof of each panel writes where the wire passes on them
(``simulated_part.obj``), and both parts are transformed into the element frame. Their distance across that
plane is the **gap**, or the overlap. At the faces of the panels, which are those of the blocks, one edge may
be higher than the other along the mean of both normals: the **step**.
"""

import dataclasses
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.interpolate import LinearNDInterpolator

from planner.element.jobs import block_pose
from planner.element.run_joints import CutJoint, PanelCutFace, panel_objects, wrong_panel_error
from planner.geometry.arrays import FloatArray, dots, transform, unit
from planner.geometry.units import MM

SIDES: Final = "sides"
"""Name of the surface of a panel's problem that has all sides of the panel."""
MAX_CORNER_DISTANCE_M: Final = 0.005
"""Maximum distance [m] of a simulated part from the sides of its panel. A larger one is another panel's."""
SHARED_DISTANCE_M: Final = 5e-4
"""Distance [m] within which a point near the edge of two sides belongs to both."""
_EDGE_STEP_M: Final = 0.01  # between points of an edge [m]
_INWARD_FRACTION: Final = (
    1e-3  # fraction by which points move inward, so that those on an edge lie between others
)


@dataclasses.dataclass(frozen=True)
class CutSide(PanelCutFace):
    """One side of a panel. Its ``rim`` are the points on its edges to the front and to the back.

    Attributes:
        axes: Axes as columns (3, 2): along its edge, and in its plane from back to front.
        up: Normal (3,) of the front of the panel.
    """

    axes: FloatArray
    up: FloatArray

    @property
    def edges(self) -> FloatArray:
        """Displacement (R, 3) [m] of the edges as cut from those as written, in planes of front and back."""
        # deviation d along the normal n moves an edge by d (n - (n . up) / (r . up) r), which is in its face
        normal, rise = self.normals[0], self.axes[:, 1]
        slide = normal - (normal @ self.up) / (rise @ self.up) * rise
        return np.asarray(self.deviation[self.rim, None] * slide)


def rings(panel: Mapping[str, Any], thickness: float) -> tuple[FloatArray, FloatArray]:
    """Return the outlines (C, 3) [m] of back and front of a panel in the frame of its block."""
    back, front = (np.array(panel[key], dtype=np.float64) * MM for key in ("back_mm", "front_mm"))
    return np.insert(back, 2, 0.0, axis=1), np.insert(front, 2, thickness, axis=1)


def cut_sides(out: Path, run: Path, panel: Mapping[str, Any], thickness: float) -> tuple[CutSide, ...]:
    """Return the sides of a panel as its plan cuts them; empty if it does not cut them.

    ``run`` is the folder of the batch, ``thickness`` [m] that of the panel.

    Raises:
        TandemError: ``element.run`` if the plan is of another panel.
    """
    name = str(panel["id"])
    path, objects = panel_objects(run, panel)
    own_name = name if "cut_in" in panel else SIDES
    point_sets = [
        part.points for word, part in objects.items() if re.fullmatch(rf"cut_{own_name}(_\d+)?", word)
    ]
    if not point_sets:
        return ()
    cut = np.concatenate(point_sets)
    pose = block_pose(panel)
    back, front = rings(panel, thickness)
    corners = np.concatenate([back, front])
    max_distance = float(np.linalg.norm(corners[:, None] - cut, axis=2).min(axis=1).max())
    frames = [_SideFrame.from_rings(back, front, i) for i in range(len(back))]
    if float(cut[:, 2].max()) > thickness + SHARED_DISTANCE_M:  # sides extend beyond fronts that are cut
        cut = np.concatenate([cut, *(frame.front_edge_points(cut) for frame in frames)])
        cut = cut[cut[:, 2] < thickness + SHARED_DISTANCE_M]
    distances = np.stack([frame.distance(cut) for frame in frames])
    min_distances = distances.min(axis=0)
    if max(max_distance, float(min_distances.max())) > MAX_CORNER_DISTANCE_M:
        raise wrong_panel_error(path, name, "the cut of the sides")
    sides = []
    for frame, is_near in zip(frames, distances <= min_distances + SHARED_DISTANCE_M, strict=True):
        side_points = cut[is_near]
        if not len(side_points) or np.ptp(side_points @ frame.along) < 0.5 * np.ptp(frame.ends):
            raise wrong_panel_error(path, name, "the cut of the sides")
        nominal = side_points - ((side_points - frame.corner) @ frame.normal)[:, None] * frame.normal
        rim = np.flatnonzero(
            (np.abs(nominal[:, 2]) < SHARED_DISTANCE_M)
            | (np.abs(nominal[:, 2] - thickness) < SHARED_DISTANCE_M)
        )
        rotation = pose[:3, :3]
        normals = np.broadcast_to(rotation @ frame.normal, side_points.shape)
        axes = rotation @ np.stack([frame.along, frame.rise], axis=1)
        sides.append(
            CutSide(
                transform(pose, nominal),
                transform(pose, side_points),
                normals,
                rim,
                axes,
                rotation @ [0.0, 0.0, 1.0],
            )
        )
    return tuple(sides)


@dataclasses.dataclass(frozen=True)
class _SideFrame:
    """Nominal plane of a side, in the frame of the panel's block.

    Attributes:
        corner: Corner (3,) [m] of the back where the side starts.
        along: Unit vector (3,) along its edge.
        normal: Outward unit normal (3,).
        rise: Unit vector (3,) in the plane, perpendicular to the edge, from back to front.
        ends: Positions (2, 2) [m] along the edge: start and end at the back, start and end in front.
        high: Distance from back to front along ``rise`` [m].
    """

    corner: FloatArray
    along: FloatArray
    normal: FloatArray
    rise: FloatArray
    ends: FloatArray
    high: float

    @staticmethod
    def from_rings(back: FloatArray, front: FloatArray, i: int) -> "_SideFrame":
        """Create the frame of the side from corner ``i`` of the outlines (C, 3) [m] to the next corner."""
        k = (i + 1) % len(back)
        along = unit(back[k] - back[i])
        normal = unit(np.cross(along, 0.5 * (front[i] + front[k]) - back[i]))
        rise = np.cross(normal, along)
        ends = np.array([[0.0, (back[k] - back[i]) @ along], (front[[i, k]] - back[i]) @ along])
        return _SideFrame(back[i], along, normal, rise, ends, float((front[i] - back[i]) @ rise))

    def distance(self, points: FloatArray) -> FloatArray:
        """Return the larger distance (V,) [m] of points from the plane of the side and beyond its ends."""
        local = points - self.corner
        at, fraction = local @ self.along, local @ self.rise / self.high
        ends = self.ends[0] + fraction[:, None] * (self.ends[1] - self.ends[0])
        return np.asarray(np.max([np.abs(local @ self.normal), ends[:, 0] - at, at - ends[:, 1]], axis=0))

    def front_edge_points(self, cut: FloatArray) -> FloatArray:
        """Return points (N, 3) [m] where the side as cut meets the plane of the front.

        ``cut`` (V, 3) [m] are points of the cut, which extends beyond that plane.
        """
        local = cut[self.distance(cut) < SHARED_DISTANCE_M] - self.corner
        offset_at = LinearNDInterpolator(
            np.stack([local @ self.along, local @ self.rise], axis=1), local @ self.normal
        )
        first, last = self.ends[1].tolist()
        at = np.linspace(first, last, int((last - first) / _EDGE_STEP_M) + 2)
        offsets = offset_at(at, np.full(len(at), self.high))
        edge = self.corner + at[:, None] * self.along + self.high * self.rise + offsets[:, None] * self.normal
        return np.asarray(edge[np.isfinite(offsets)])


def side_joint(names: tuple[str, str], first: CutSide, second: CutSide) -> CutJoint | None:
    """Measure the joint of two panels from their sides; None if the sides share no points or edges."""
    normal, corner = first.normals[0], first.nominal[0]
    first_points, second_points = first.nominal @ first.axes, second.nominal @ first.axes
    middle = first_points.mean(axis=0)
    second_offset = LinearNDInterpolator(
        second_points, dots(second.cut - corner, np.broadcast_to(normal, second.cut.shape))
    )
    gaps = second_offset(middle + (1.0 - _INWARD_FRACTION) * (first_points - middle)) - dots(
        first.cut - corner, first.normals
    )
    is_measured = np.isfinite(gaps)
    steps = _edge_steps(first, second)
    if not is_measured.any() or not len(steps):
        return None
    return CutJoint(names, first.nominal[is_measured], steps, np.abs(gaps[is_measured]))


def _edge_steps(first: CutSide, second: CutSide) -> FloatArray:
    """Return height differences (M,) [m] of the edges of two sides along the mean normal of both panels."""
    normal = unit(first.up + second.up)
    middle = first.nominal.mean(axis=0)
    steps = []
    sides = [(side.nominal[side.rim] - middle) @ first.axes for side in (first, second)]
    heights = [side.edges @ normal for side in (first, second)]
    for front in (True, False):
        (first_positions, first_heights), (second_positions, second_heights) = (
            (side[on_edge, 0], side_heights[on_edge])
            for side, side_heights in zip(sides, heights, strict=True)
            for on_edge in [(side[:, 1] > 0.0) == front]
        )
        if not len(first_positions) or not len(second_positions):
            continue
        order = np.argsort(second_positions)
        overlaps = (first_positions > second_positions[order[0]] - SHARED_DISTANCE_M) & (
            first_positions < second_positions[order[-1]] + SHARED_DISTANCE_M
        )
        steps.append(
            np.abs(
                first_heights - np.interp(first_positions, second_positions[order], second_heights[order])
            )[overlaps]
        )
    return np.concatenate(steps or [np.zeros(0)])
