"""How an element is put up: the order of its panels, the way in of each, and their bodies for page and file.

``order`` counts from 1. ``way_in`` is the direction in which a panel moves as it comes in, in the frame of
``element.json``; ``jam_mm`` says how deep others are in its way, by which foam has to give.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

from planner.element.jobs import obj_lines
from planner.geometry.arrays import FloatArray, IntArray, lengths
from planner.geometry.assembly import NONE, Slab, Step, outline_faces
from planner.geometry.units import MM, measurement
from planner.issues import Issue, Severity

GIVE: Final = 1e-3
"""What foam gives way by [m] without a word, where sides are no planes."""
BESIDE: Final = 1e-5
"""How far [m] outside of a side the panel beyond is looked for."""
SHOWN: Final = 1e-3
"""How far outlines on the page may be off [m]."""
WAY_DIGITS: Final = 9
"""Decimals of ways in in ``element.json``."""


@dataclasses.dataclass(frozen=True)
class Body:
    """A panel's id, its body in the frame of ``element.json``, and the same with fewer points for the
    page."""

    name: str
    whole: Slab
    shown: Slab


@dataclasses.dataclass(frozen=True)
class Assembly:
    """All bodies of an element by their ids' order, the steps in which they are put up, and the direction
    ``up`` (3,)."""

    bodies: tuple[Body, ...]
    steps: tuple[Step, ...]
    up: FloatArray

    def columns(self) -> list[dict[str, Any]]:
        """What each panel has in the table."""
        out: list[dict[str, Any]] = [{}] * len(self.bodies)
        for number, step in enumerate(self.steps, 1):
            way = " ".join(f"{v:.4f}" for v in (step.way + 0.0).tolist())
            out[step.body] = {"order": number, "way_in": way, "jam_mm": round(step.depth / MM, 3) + 0.0}
        return out

    def data(self) -> list[dict[str, Any]]:
        """What each panel has in ``element.json`` beside it."""
        ways = {step.body: step.way for step in self.steps}
        return [
            {"way_in": (np.round(ways[k], WAY_DIGITS) + 0.0).tolist(), "solid": _solid(body.shown)}
            for k, body in enumerate(self.bodies)
        ]

    def obj(self) -> str:
        """All panels as closed bodies of one OBJ file [mm], an object for each id."""
        lines, count = ["# panels in the frame of element.json, mm"], 1
        for body in self.bodies:
            vertices, faces = body.whole.mesh
            lines += [f"o {body.name}", *obj_lines(vertices / MM + 0.0, faces, count)]
            count += len(vertices)
        return "\n".join(lines) + "\n"

    def issues(self, give: float) -> Iterator[Issue]:
        """``element.assembly`` for panels that no straight way in is free for."""
        closing = [step for step in self.steps if step.depth > give]
        if not closing:
            return
        worst = max(closing, key=lambda step: step.depth)
        names = [f"{self.bodies[step.body].name} ({step.depth / MM:.1f} mm)" for step in closing]
        what = (
            f"{len(closing)} of {len(self.bodies)} panels have no straight way in that is free, in any order "
            f"that was tried; along the best one others are in the way of them by: {', '.join(names)}"
        )
        hint = "part these panels in two or take as much off a side, and put them in where order says"
        yield Issue(
            "element.assembly",
            what,
            Severity.WARNING,
            field="panels",
            **measurement(worst.depth / MM, give / MM, "mm"),
            hint=hint,
        )


def _solid(slab: Slab) -> dict[str, str]:
    """A body as lists of numbers in lines: points [mm] of front and back in pairs, triangles of the front,
    and the numbers of the points on its outline."""

    def line(values: FloatArray | IntArray) -> str:
        return " ".join(f"{v:g}" for v in values.ravel().tolist())

    front, back = (np.round(points / MM) + 0.0 for points in (slab.front, slab.back))
    return {"front_mm": line(front), "back_mm": line(back), "faces": line(slab.faces), "rim": line(slab.rim)}


def ring_slab(front: FloatArray, back: FloatArray, plan: FloatArray, beyond: IntArray) -> Slab:
    """A body between outlines (C, 3) [m], whose front is spanned as its ``plan`` (C, 2) is."""
    return Slab(front, back, outline_faces(plan), np.arange(len(front)), beyond)


def thinned(slab: Slab, plan: FloatArray, off: float) -> Slab:
    """The body of outlines with as few corners as it takes to be ``off`` by no more [m] and to tell the
    bodies beyond apart."""
    both = np.concatenate([slab.front, slab.back], axis=1)
    turn = int(np.argmax(lengths(both - both[0])))
    ring = np.concatenate([both, both[:1]])
    ends = np.flatnonzero(slab.beyond != np.roll(slab.beyond, 1)).tolist()
    stops = sorted({0, turn, *ends, len(both)})
    parts = [_needed(ring, a, b, off) for a, b in itertools.pairwise(stops)]
    kept = sorted({k % len(both) for part in parts for k in part})
    return ring_slab(slab.front[kept], slab.back[kept], plan[kept], slab.beyond[kept])


def _needed(points: FloatArray, first: int, last: int, limit: float) -> list[int]:
    """The points from first to last that a line through them needs (D. Douglas, T. Peucker, Cartographica 10,
    1973)."""
    a, b = points[first], points[last]
    between = points[first + 1 : last]
    if not len(between):
        return [first, last]
    long = max(float((b - a) @ (b - a)), 1e-30)
    share = np.clip((between - a) @ (b - a) / long, 0.0, 1.0)
    off = lengths(between - a - share[:, None] * (b - a))
    worst = int(np.argmax(off))
    if off[worst] <= limit:
        return [first, last]
    middle = first + 1 + worst
    return _needed(points, first, middle, limit) + _needed(points, middle, last, limit)


def rests_on(beyond: Sequence[IntArray], row: IntArray) -> list[IntArray]:
    """The neighbours of each panel in rows before its own."""
    return [
        np.array([b for b in np.unique(one[one != NONE]).tolist() if row[b] < row[k]], dtype=np.int64)
        for k, one in enumerate(beyond)
    ]


def in_order(data: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The panels of ``element.json`` as they are put up, those of a file without an order by their ids."""
    return sorted(data["panels"], key=lambda panel: int(panel.get("order", 0)))
