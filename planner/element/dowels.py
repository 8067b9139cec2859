"""Dowels that align neighbouring panels: positions of their holes in the joint and in both blocks.

A panel is inserted along one straight direction (``way_in``), so all dowels to panels that are already in
place are parallel to it. The direction is perpendicular to a side if possible. Along its other
sides the panel slides. Joints there have no dowels, nor do joints without space for holes. Holes start
halfway between front and back, have ``depth`` in either panel, and keep ``cover`` of foam to faces, other
sides and other holes.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from planner.element.assembly import ElementAssembly
from planner.element.element_file import DowelsFile, Element
from planner.geometry.arrays import FloatArray, IntArray, inverse, lengths, transform, unit
from planner.geometry.assembly import NONE, Slab
from planner.geometry.mesh import closest_weights
from planner.geometry.units import DEG, MM
from planner.issue_codes import format_message
from planner.issues import Issue, Severity

POSITION_STEP_M: Final = 0.01
"""Distance [m] between the positions along a joint that are tried for dowels."""
DEPTH_FRACTIONS: Final = np.array([0.25, 0.5, 0.75, 1.0])
"""Fractions of the depth of a hole at which the foam around it is measured."""
MIN_SIDE_DISTANCE_RATIO: Final = 0.5
"""Minimum distance of a point in a hole from the side where the hole starts, as a ratio to its depth.

Lobes and folds bend a side back to the hole.
"""
BATCH_SIZE: Final = 200_000
"""Approximate number of pairs of a point and a triangle that are measured in one batch."""
DOWELS_FILE: Final = "dowels.csv"


@dataclasses.dataclass(frozen=True)
class Dowel:
    """A dowel between two panels.

    Attributes:
        placed_panel: Panel that is already in place.
        inserted_panel: Panel that is inserted later.
        position: Middle of the dowel (3,) [m], on the joint, in the frame of ``element.json``.
        direction: Insertion direction (3,) of the later panel, a unit vector from it to the placed panel.
        along: Position [m] along the joint.
        tilt: Angle [rad] between dowel and normal of the joint.
    """

    placed_panel: str
    inserted_panel: str
    position: FloatArray
    direction: FloatArray
    along: float
    tilt: float


@dataclasses.dataclass(frozen=True)
class UndowelledJoint:
    """A joint without dowels.

    Attributes:
        placed_panel: Panel that is already in place.
        inserted_panel: Panel that is inserted later.
        tilt: Smallest angle [rad] between the insertion direction and the normal of the joint.
        why: Reason why the joint has no dowels.
    """

    placed_panel: str
    inserted_panel: str
    tilt: float
    why: str


@dataclasses.dataclass(frozen=True)
class ElementDowels:
    """All dowels of an element, its joints without dowels, and the options of its file."""

    file: DowelsFile
    dowels: tuple[Dowel, ...]
    undowelled: tuple[UndowelledJoint, ...]

    def rows(self, poses: Mapping[str, FloatArray]) -> list[dict[str, Any]]:
        """Return the rows of ``dowels.csv``: one for each hole, so two per dowel.

        A row states where the hole starts and its direction into the panel, in the frame of the panel's
        block.

        Args:
            poses: Poses (4, 4) [m] of the blocks in the frame of ``element.json``, by panel.
        """
        out = []
        for number, dowel in enumerate(self.dowels, 1):
            for panel, other, into in (
                (dowel.placed_panel, dowel.inserted_panel, dowel.direction),
                (dowel.inserted_panel, dowel.placed_panel, -dowel.direction),
            ):
                position = transform(inverse(poses[panel]), dowel.position) / MM
                direction = poses[panel][:3, :3].T @ into
                position_mm = [round(v, 2) + 0.0 for v in position.tolist()]
                components = [round(v, 5) + 0.0 for v in direction.tolist()]
                out.append(
                    {
                        "dowel": number,
                        "panel": panel,
                        "neighbour": other,
                        **dict(
                            zip(
                                ("x_mm", "y_mm", "z_mm", "dx", "dy", "dz"),
                                position_mm + components,
                                strict=True,
                            )
                        ),
                        "diameter_mm": self.file.diameter_mm,
                        "depth_mm": self.file.depth_mm,
                        "along_joint_mm": round(dowel.along / MM, 2),
                        "lean_deg": round(dowel.tilt / DEG, 2),
                    }
                )
        return out

    def data(self) -> dict[str, Any]:
        """Return what ``element.json`` states about dowels: positions [mm] and directions in its frame."""
        return {
            "diameter_mm": self.file.diameter_mm,
            "depth_mm": self.file.depth_mm,
            "dowels": [
                {
                    "panels": [item.placed_panel, item.inserted_panel],
                    "at_mm": (np.round(item.position / MM, 3) + 0.0).tolist(),
                    "way": (np.round(item.direction, 6) + 0.0).tolist(),
                }
                for item in self.dowels
            ],
            "without": [
                {"panels": [item.placed_panel, item.inserted_panel], "why": item.why}
                for item in self.undowelled
            ],
        }

    def issues(self) -> tuple[Issue, ...]:
        """Return one ``element.dowels`` that lists all panels inserted without a dowel, if any.

        Each panel is listed with the reason of the joint that its insertion direction crosses most squarely.
        """
        dowelled = {item.inserted_panel for item in self.dowels}
        least_tilted: dict[str, UndowelledJoint] = {}
        for item in sorted(self.undowelled, key=lambda item: item.tilt):
            if item.inserted_panel not in dowelled:
                least_tilted.setdefault(item.inserted_panel, item)
        if not least_tilted:
            return ()
        count = len(dowelled) + len(least_tilted)
        panel_texts = ", ".join(
            f"{panel} ({item.why} to {item.placed_panel})" for panel, item in sorted(least_tilted.items())
        )
        message = format_message(
            "element.dowels", undowelled_count=len(least_tilted), inserted_count=count, panels=panel_texts
        )
        hint = "use shorter or thinner dowels, less cover_mm or a larger lean_deg, or align these otherwise"
        return (Issue("element.dowels", message, Severity.WARNING, field="dowels", hint=hint),)


def max_dowel_tilt(element: Element) -> float | None:
    """Return the maximum angle [rad] between dowels and the normal of a joint; None without dowels."""
    file = element.file.dowels
    return None if file is None else file.lean_deg * DEG


def place_dowels(file: DowelsFile, assembly: ElementAssembly) -> ElementDowels:
    """Place all dowels in assembly order, since earlier holes restrict later ones in the same panel."""
    names = [body.name for body in assembly.bodies]
    slabs = [body.shown for body in assembly.bodies]
    order = {step.body: number for number, step in enumerate(assembly.steps)}
    holes: list[list[FloatArray]] = [[] for _ in names]
    dowels: list[Dowel] = []
    undowelled: list[UndowelledJoint] = []
    for step in assembly.steps:
        inserted_body = step.body
        neighbours = [k for k in np.unique(slabs[inserted_body].beyond).tolist() if k != NONE]
        for placed_body in sorted(
            (k for k in neighbours if order[k] < order[inserted_body]), key=order.__getitem__
        ):
            result = _place_in_joint(file, slabs, (placed_body, inserted_body), step.direction, holes)
            if isinstance(result, tuple):
                undowelled.append(UndowelledJoint(names[placed_body], names[inserted_body], *result))
            else:
                dowels += [Dowel(names[placed_body], names[inserted_body], *dowel) for dowel in result]
    return ElementDowels(file, tuple(dowels), tuple(undowelled))


_DowelPosition = tuple[FloatArray, FloatArray, float, float]
"""Position (3,) [m], direction (3,), position along the joint [m] and tilt [rad] of a dowel."""


def _place_in_joint(
    file: DowelsFile,
    slabs: Sequence[Slab],
    pair: tuple[int, int],
    direction: FloatArray,
    holes: list[list[FloatArray]],
) -> list[_DowelPosition] | tuple[float, str]:
    """Place the dowels between two bodies, and add their holes to ``holes``.

    Args:
        file: Options of the file.
        slabs: All bodies.
        pair: Index of the body that is in place, and of the body that is inserted.
        direction: Insertion direction (3,).
        holes: For each body, points (K, 3) [m] on the axis of each hole. Modified in place.

    Returns:
        One entry for each dowel; or the smallest tilt [rad] and the reason why there is none.
    """
    placed_body, inserted_body = pair
    edges = np.flatnonzero(slabs[inserted_body].beyond == placed_body)
    positions, along, normal = _candidates(slabs[inserted_body], edges)
    tilt = np.arccos(np.clip(normal @ direction, -1.0, 1.0))
    is_allowed = tilt <= file.lean_deg * DEG
    if not is_allowed.any():
        return float(tilt.min()), f"{tilt.min() / DEG:.0f} degrees off perpendicular"
    radius = 0.5 * file.diameter_mm * MM
    depth = file.depth_mm * MM
    cover = file.cover_mm * MM
    min_distance = radius + cover
    is_free = is_allowed
    for body, side_edges, into in (
        (placed_body, np.flatnonzero(slabs[placed_body].beyond == inserted_body), direction),
        (inserted_body, edges, -direction),
    ):
        axis_points = positions[:, None] + (depth * DEPTH_FRACTIONS)[:, None] * into  # (N, 4, 3)
        side_triangles, other_triangles = _split_triangles(slabs[body], side_edges)
        is_free = is_free & (_min_distance(axis_points, other_triangles).min(axis=1) >= min_distance)
        # near its start a hole is near the side that it starts on, so the distance there grows with depth
        is_free &= (
            _min_distance(axis_points, side_triangles)
            >= np.minimum(min_distance, MIN_SIDE_DISTANCE_RATIO * depth * DEPTH_FRACTIONS)
        ).all(axis=1)
        for other in holes[body]:
            is_free &= lengths(axis_points[:, :, None] - other).min(axis=(1, 2)) >= 2.0 * radius + cover
    chosen = _spread(np.flatnonzero(is_free), along, file.count, 2.0 * radius + cover)
    if not len(chosen):
        return float(tilt.min()), "no space"
    # points at most one radius apart, from which later holes keep their distance
    fine = np.linspace(0.0, depth, max(2, int(np.ceil(depth / radius)) + 1))[:, None]
    for k in chosen.tolist():
        holes[placed_body].append(positions[k] + fine * direction)
        holes[inserted_body].append(positions[k] - fine * direction)
    return [(positions[k], direction, float(along[k]), float(tilt[k])) for k in chosen.tolist()]


def _candidates(slab: Slab, edges: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return candidate positions along the sides ``edges`` (K,) of a body, one after the other.

    Returns:
        Positions (N, 3) [m] halfway between front and back, distances (N,) [m] along the sides, and outward
            normals (N, 3).
    """
    positions, along, normals, start = [], [], [], 0.0
    for i in edges.tolist():
        j = (i + 1) % len(slab.rim)
        ends = [0.5 * (slab.front[c] + slab.back[c]) for c in (slab.rim[i], slab.rim[j])]
        length = float(np.linalg.norm(ends[1] - ends[0]))
        count = max(1, round(length / POSITION_STEP_M))
        fraction = (np.arange(count) + 0.5) / count
        positions.append(ends[0] + fraction[:, None] * (ends[1] - ends[0]))
        along.append(start + fraction * length)
        normals.append(np.broadcast_to(unit(slab.normals[i].mean(axis=0)), (count, 3)))
        start += length
    return np.concatenate(positions), np.concatenate(along), np.concatenate(normals)


def _split_triangles(slab: Slab, edges: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return the triangles (T, 3, 3) [m] of the sides ``edges`` (K,) of a body, and all other triangles."""
    # Slab.mesh lists the triangles of front and back first, then one and then the other triangle of each side
    faces, sides = 2 * len(slab.faces), len(slab.rim)
    is_side = np.zeros(len(slab.triangles), dtype=np.bool_)
    is_side[np.concatenate([faces + edges, faces + sides + edges])] = True
    return slab.triangles[is_side], slab.triangles[~is_side]


def _min_distance(points: FloatArray, triangles: FloatArray) -> FloatArray:
    """Return the distances (N, K) [m] of points (N, K, 3) from the nearest of triangles (T, 3, 3)."""
    count, all_points = len(triangles), points.reshape(-1, 3)
    corners = triangles.transpose(1, 0, 2)
    out = []
    for part in np.array_split(all_points, -(-len(all_points) * count // BATCH_SIZE)):
        repeated = np.repeat(part, count, axis=0)
        a, b, c = (np.tile(corner, (len(part), 1)) for corner in corners)
        weights = closest_weights(repeated, a, b, c)
        nearest = weights[:, :1] * a + weights[:, 1:2] * b + weights[:, 2:] * c
        out.append(lengths(nearest - repeated).reshape(-1, count).min(axis=1))
    return np.concatenate(out).reshape(points.shape[:2])


def _spread(free: IntArray, along: FloatArray, count: int, min_distance: float) -> IntArray:
    """Choose up to ``count`` free positions, spread along the joint as far as possible.

    Two positions are at least ``min_distance`` [m] apart. A single one is that nearest to the middle.
    ``free`` (F,) and the result are indices of ``along`` (N,) [m], the distances of all positions along the
    joint.
    """
    if not len(free):
        return free
    positions = along[free]
    for chosen_count in range(min(count, len(free)), 1, -1):
        even = np.linspace(positions[0], positions[-1], chosen_count)
        chosen: IntArray = np.unique(np.abs(positions[:, None] - even).argmin(axis=0))
        if len(chosen) == chosen_count and float(np.diff(positions[chosen]).min()) >= min_distance:
            return np.asarray(free[chosen])
    middle = int(np.abs(positions - 0.5 * (positions[0] + positions[-1])).argmin())
    return np.asarray(free[middle : middle + 1])
