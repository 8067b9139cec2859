"""Assembly of an element: order of its panels, insertion directions, and bodies for page and file.

``order`` counts from 1. ``way_in`` is the direction in which a panel moves when it is inserted, in the frame
of ``element.json``. ``jam_mm`` is the depth of interference on that path, by which foam has to give.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

from planner.element.jobs import obj_lines
from planner.geometry.arrays import FloatArray, IntArray, lengths
from planner.geometry.assembly import NONE, AssemblyStep, Slab, outline_faces
from planner.geometry.units import MM, measurement
from planner.issue_codes import format_message
from planner.issues import Issue, Severity

FREE_INTERFERENCE_M: Final = 1e-3
"""Interference [m] up to which panels whose sides are not planes are not reported."""
NEIGHBOUR_OFFSET_M: Final = 1e-5
"""Distance [m] outside of a side at which the panel beyond that side is searched."""
PAGE_TOLERANCE_M: Final = 1e-3
"""Maximum deviation [m] of the simplified outlines that the page shows."""
DIRECTION_DIGITS: Final = 9
"""Decimals of insertion directions in ``element.json``."""


@dataclasses.dataclass(frozen=True)
class PanelBody:
    """Body of a panel in the frame of ``element.json``.

    Attributes:
        name: Id of the panel.
        whole: Body with all points.
        shown: The same body with fewer points, for the page.
    """

    name: str
    whole: Slab
    shown: Slab


@dataclasses.dataclass(frozen=True)
class ElementAssembly:
    """Assembly sequence of an element.

    Attributes:
        bodies: Bodies in the order of their ids.
        steps: Assembly steps in order; each has the index in ``bodies`` of the panel that it inserts.
        up: Unit vector (3,) that points upward.
    """

    bodies: tuple[PanelBody, ...]
    steps: tuple[AssemblyStep, ...]
    up: FloatArray

    def columns(self) -> list[dict[str, Any]]:
        """Return the assembly columns of the table of panels: one dict for each of ``bodies``, in order."""
        out: list[dict[str, Any]] = [{}] * len(self.bodies)
        for number, step in enumerate(self.steps, 1):
            direction = " ".join(f"{v:.4f}" for v in (step.direction + 0.0).tolist())
            out[step.body] = {"order": number, "way_in": direction, "jam_mm": round(step.depth / MM, 3) + 0.0}
        return out

    def data(self) -> list[dict[str, Any]]:
        """Return what ``element.json`` states of assembly: a dict per panel, in the order of ``bodies``."""
        directions = {step.body: step.direction for step in self.steps}
        return [
            {
                "way_in": (np.round(directions[k], DIRECTION_DIGITS) + 0.0).tolist(),
                "solid": _solid(body.shown),
            }
            for k, body in enumerate(self.bodies)
        ]

    def obj(self) -> str:
        """Return all panels as closed bodies of one OBJ file [mm], one object per id."""
        lines, count = ["# panels in the frame of element.json, mm"], 1
        for body in self.bodies:
            vertices, faces = body.whole.mesh
            lines += [f"o {body.name}", *obj_lines(vertices / MM + 0.0, faces, count)]
            count += len(vertices)
        return "\n".join(lines) + "\n"

    def issues(self, max_interference: float) -> Iterator[Issue]:
        """Yield one ``element.assembly`` that lists all panels without a free straight insertion path.

        Args:
            max_interference: Interference [m] up to which a path counts as free.
        """
        blocked = [step for step in self.steps if step.depth > max_interference]
        if not blocked:
            return
        worst_step = max(blocked, key=lambda step: step.depth)
        names = [f"{self.bodies[step.body].name} ({step.depth / MM:.1f} mm)" for step in blocked]
        message = format_message(
            "element.assembly",
            blocked_count=len(blocked),
            panel_count=len(self.bodies),
            panels=", ".join(names),
        )
        hint = "split these panels or trim a side by as much, and insert them in the stated order"
        yield Issue(
            "element.assembly",
            message,
            Severity.WARNING,
            field="panels",
            **measurement(worst_step.depth / MM, max_interference / MM, "mm"),
            hint=hint,
        )


def _solid(slab: Slab) -> dict[str, str]:
    """Return a body as text, for the 3D view of the page: lists of numbers that are separated by spaces.

    The lists are the points [mm] of front and back, which are paired, and the triangles and the outline of
    the front as indices of its points.
    """

    def join_numbers(values: FloatArray | IntArray) -> str:
        return " ".join(f"{v:g}" for v in values.ravel().tolist())

    front, back = (np.round(points / MM) + 0.0 for points in (slab.front, slab.back))
    return {
        "front_mm": join_numbers(front),
        "back_mm": join_numbers(back),
        "faces": join_numbers(slab.faces),
        "rim": join_numbers(slab.rim),
    }


def ring_slab(front: FloatArray, back: FloatArray, plan: FloatArray, beyond: IntArray) -> Slab:
    """Create a body between paired outlines (C, 3) [m] of front and back.

    ``plan`` (C, 2) [m] is a counterclockwise projection of the front, in which it is triangulated. ``beyond``
    (C,) has the index of the body beyond the side from each corner to the next one, or ``NONE``.
    """
    return Slab(front, back, outline_faces(plan), np.arange(len(front)), beyond)


def simplify_outlines(slab: Slab, plan: FloatArray, tolerance: float) -> Slab:
    """Remove corners of a body's outlines, front and back together.

    The outlines deviate by at most ``tolerance`` [m]. Corners where the body beyond changes are kept.
    ``plan`` is that of `ring_slab`.
    """
    paired = np.concatenate([slab.front, slab.back], axis=1)
    farthest = int(np.argmax(lengths(paired - paired[0])))
    closed_ring = np.concatenate([paired, paired[:1]])
    changes = np.flatnonzero(slab.beyond != np.roll(slab.beyond, 1)).tolist()
    stops = sorted({0, farthest, *changes, len(paired)})
    parts = [_simplified_indices(closed_ring, a, b, tolerance) for a, b in itertools.pairwise(stops)]
    kept = sorted({k % len(paired) for part in parts for k in part})
    return ring_slab(slab.front[kept], slab.back[kept], plan[kept], slab.beyond[kept])


def _simplified_indices(points: FloatArray, first: int, last: int, limit: float) -> list[int]:
    """Return the indices of the points from ``first`` to ``last`` that a polyline within ``limit`` [m] needs.

    Both ends are included.

    Source: D. Douglas, T. Peucker, Cartographica 10, 1973.
    """
    a, b = points[first], points[last]
    between = points[first + 1 : last]
    if not len(between):
        return [first, last]
    squared_length = max(float((b - a) @ (b - a)), 1e-30)
    fraction = np.clip((between - a) @ (b - a) / squared_length, 0.0, 1.0)
    distance = lengths(between - a - fraction[:, None] * (b - a))
    worst_index = int(np.argmax(distance))
    if distance[worst_index] <= limit:
        return [first, last]
    middle = first + 1 + worst_index
    return _simplified_indices(points, first, middle, limit) + _simplified_indices(
        points, middle, last, limit
    )


def supporting_panels(beyond: Sequence[IntArray], row: IntArray) -> list[IntArray]:
    """Return the neighbours of each panel that are in previous rows and therefore support it.

    ``beyond`` has the panel beyond each side of each panel, or ``NONE``. ``row`` (N,) has the row of each
    panel.
    """
    return [
        np.array(
            [b for b in np.unique(neighbours[neighbours != NONE]).tolist() if row[b] < row[k]], dtype=np.int64
        )
        for k, neighbours in enumerate(beyond)
    ]


def panels_in_order(data: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the panels of ``element.json`` in assembly order; in the order of the file if it states none."""
    return sorted(data["panels"], key=lambda panel: int(panel.get("order", 0)))
