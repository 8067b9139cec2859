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
"""Interference [m] that is not reported, where sides are not planes."""
NEIGHBOUR_OFFSET_M: Final = 1e-5
"""Distance [m] outside of a side at which the panel beyond is searched."""
PAGE_TOLERANCE_M: Final = 1e-3
"""Maximum deviation [m] of outlines on the page."""
DIRECTION_DIGITS: Final = 9
"""Decimals of insertion directions in ``element.json``."""


@dataclasses.dataclass(frozen=True)
class PanelBody:
    """Body of a panel in the frame of ``element.json``.

    Attributes:
        name: Id of the panel.
        whole: Body.
        shown: Body with fewer points, for the page.
    """

    name: str
    whole: Slab
    shown: Slab


@dataclasses.dataclass(frozen=True)
class ElementAssembly:
    """Assembly sequence of an element.

    Attributes:
        bodies: Bodies in the order of their ids.
        steps: Steps in which they are assembled.
        up: Direction (3,) that is up.
    """

    bodies: tuple[PanelBody, ...]
    steps: tuple[AssemblyStep, ...]
    up: FloatArray

    def columns(self) -> list[dict[str, Any]]:
        """Return the columns of each panel in the table."""
        out: list[dict[str, Any]] = [{}] * len(self.bodies)
        for number, step in enumerate(self.steps, 1):
            direction = " ".join(f"{v:.4f}" for v in (step.direction + 0.0).tolist())
            out[step.body] = {"order": number, "way_in": direction, "jam_mm": round(step.depth / MM, 3) + 0.0}
        return out

    def data(self) -> list[dict[str, Any]]:
        """Return the further data of each panel in ``element.json``."""
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
        """Yield ``element.assembly`` for panels without a straight insertion path that is free.

        Args:
            max_interference: Interference [m] that is allowed.
        """
        blocked = [step for step in self.steps if step.depth > max_interference]
        if not blocked:
            return
        worst = max(blocked, key=lambda step: step.depth)
        names = [f"{self.bodies[step.body].name} ({step.depth / MM:.1f} mm)" for step in blocked]
        what = format_message(
            "element.assembly",
            blocked_count=len(blocked),
            panel_count=len(self.bodies),
            panels=", ".join(names),
        )
        hint = "split these panels or trim a side by as much, and insert them in the stated order"
        yield Issue(
            "element.assembly",
            what,
            Severity.WARNING,
            field="panels",
            **measurement(worst.depth / MM, max_interference / MM, "mm"),
            hint=hint,
        )


def _solid(slab: Slab) -> dict[str, str]:
    """Return a body as lists of numbers in text.

    The lists have the points [mm] of front and back in pairs, the triangles of the front, and the numbers of
    the points on its outline.
    """

    def line(values: FloatArray | IntArray) -> str:
        return " ".join(f"{v:g}" for v in values.ravel().tolist())

    front, back = (np.round(points / MM) + 0.0 for points in (slab.front, slab.back))
    return {"front_mm": line(front), "back_mm": line(back), "faces": line(slab.faces), "rim": line(slab.rim)}


def ring_slab(front: FloatArray, back: FloatArray, plan: FloatArray, beyond: IntArray) -> Slab:
    """Create a body between outlines (C, 3) [m], triangulated by the ``plan`` (C, 2) of its front."""
    return Slab(front, back, outline_faces(plan), np.arange(len(front)), beyond)


def simplify_outlines(slab: Slab, plan: FloatArray, tolerance: float) -> Slab:
    """Simplify the outlines of a body.

    Corners are kept as needed to deviate by at most ``tolerance`` [m] and to keep the bodies beyond apart.
    """
    both = np.concatenate([slab.front, slab.back], axis=1)
    farthest = int(np.argmax(lengths(both - both[0])))
    ring = np.concatenate([both, both[:1]])
    ends = np.flatnonzero(slab.beyond != np.roll(slab.beyond, 1)).tolist()
    stops = sorted({0, farthest, *ends, len(both)})
    parts = [_simplified_indices(ring, a, b, tolerance) for a, b in itertools.pairwise(stops)]
    kept = sorted({k % len(both) for part in parts for k in part})
    return ring_slab(slab.front[kept], slab.back[kept], plan[kept], slab.beyond[kept])


def _simplified_indices(points: FloatArray, first: int, last: int, limit: float) -> list[int]:
    """Return the points that a polyline within ``limit`` [m] needs, ends included.

    Source: D. Douglas, T. Peucker, Cartographica 10, 1973.
    """
    a, b = points[first], points[last]
    between = points[first + 1 : last]
    if not len(between):
        return [first, last]
    squared_length = max(float((b - a) @ (b - a)), 1e-30)
    fraction = np.clip((between - a) @ (b - a) / squared_length, 0.0, 1.0)
    distance = lengths(between - a - fraction[:, None] * (b - a))
    worst = int(np.argmax(distance))
    if distance[worst] <= limit:
        return [first, last]
    middle = first + 1 + worst
    return _simplified_indices(points, first, middle, limit) + _simplified_indices(
        points, middle, last, limit
    )


def supporting_panels(beyond: Sequence[IntArray], row: IntArray) -> list[IntArray]:
    """Return the neighbours of each panel in previous rows."""
    return [
        np.array(
            [b for b in np.unique(neighbours[neighbours != NONE]).tolist() if row[b] < row[k]], dtype=np.int64
        )
        for k, neighbours in enumerate(beyond)
    ]


def panels_in_order(data: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the panels of ``element.json`` in assembly order; without an order in the file, by ids."""
    return sorted(data["panels"], key=lambda panel: int(panel.get("order", 0)))
