"""Dowels that hold neighbouring panels in register: where their holes are, in the joint and in both blocks.

A panel comes in along one straight way (``way_in``), so all dowels between it and panels that stand already
lie along that way, which is chosen square to a side where it can be (``put_up``). It slides along its other
sides, and joints there get none, as those that have no room for holes. Holes begin half-way between front and
back, go ``depth`` into either panel, and keep ``cover`` of foam to faces, other sides and other holes.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from planner.element.assembly import Assembly
from planner.element.element_file import DowelsFile, Element
from planner.geometry.arrays import FloatArray, IntArray, inverse, lengths, transform, unit
from planner.geometry.assembly import NONE, Slab
from planner.geometry.mesh import closest_on_triangles
from planner.geometry.units import DEG, MM
from planner.issues import Issue, Severity

STEP: Final = 0.01
"""Places along a joint are tried this far [m] apart."""
DEEP: Final = np.array([0.25, 0.5, 0.75, 1.0])
"""Shares of a hole's depth at which the foam around it is measured."""
STEEPEST: Final = 0.5
"""A hole is at least this share of its depth away from the side that it begins on: lobes and folds bend a
side back to it."""
AT_ONCE: Final = 200_000
"""So many pairs of points and triangles are measured together."""
FILE: Final = "dowels.csv"


@dataclasses.dataclass(frozen=True)
class Dowel:
    """A dowel from the panel ``stands`` to the one that ``comes`` later: its ``place`` (3,) [m] on the joint
    and the ``way`` (3,) on which that one comes, in the frame of ``element.json``; ``along`` [m] the middle
    of the joint from its end, ``lean`` [rad] off square to it."""

    stands: str
    comes: str
    place: FloatArray
    way: FloatArray
    along: float
    lean: float


@dataclasses.dataclass(frozen=True)
class Without:
    """A joint that has none: its panels as of :class:`Dowel`, how far [rad] the way in leans, and why."""

    stands: str
    comes: str
    lean: float
    why: str


@dataclasses.dataclass(frozen=True)
class Dowels:
    """All dowels of an element, and the joints that have none."""

    file: DowelsFile
    dowels: tuple[Dowel, ...]
    without: tuple[Without, ...]

    def rows(self, poses: Mapping[str, FloatArray]) -> list[dict[str, Any]]:
        """A row for each hole, two for each dowel: where it begins and its direction in the block of its
        panel, whose ``poses`` (4, 4) [m] are in the frame of ``element.json``."""
        out = []
        for number, one in enumerate(self.dowels, 1):
            for panel, other, into in ((one.stands, one.comes, one.way), (one.comes, one.stands, -one.way)):
                place = transform(inverse(poses[panel]), one.place) / MM
                way = poses[panel][:3, :3].T @ into
                at = [round(v, 2) + 0.0 for v in place.tolist()]
                along = [round(v, 5) + 0.0 for v in way.tolist()]
                out.append(
                    {
                        "dowel": number,
                        "panel": panel,
                        "neighbour": other,
                        **dict(zip(("x_mm", "y_mm", "z_mm", "dx", "dy", "dz"), at + along, strict=True)),
                        "diameter_mm": self.file.diameter_mm,
                        "depth_mm": self.file.depth_mm,
                        "along_joint_mm": round(one.along / MM, 2),
                        "lean_deg": round(one.lean / DEG, 2),
                    }
                )
        return out

    def data(self) -> dict[str, Any]:
        """What ``element.json`` has of them: places [mm] and ways in its frame."""
        return {
            "diameter_mm": self.file.diameter_mm,
            "depth_mm": self.file.depth_mm,
            "dowels": [
                {
                    "panels": [one.stands, one.comes],
                    "at_mm": (np.round(one.place / MM, 3) + 0.0).tolist(),
                    "way": (np.round(one.way, 6) + 0.0).tolist(),
                }
                for one in self.dowels
            ],
            "without": [{"panels": [one.stands, one.comes], "why": one.why} for one in self.without],
        }

    def issues(self) -> tuple[Issue, ...]:
        """``element.dowels`` where panels come in without any."""
        held = {one.comes for one in self.dowels}
        best: dict[str, Without] = {}
        for one in sorted(self.without, key=lambda one: one.lean):
            if one.comes not in held:
                best.setdefault(one.comes, one)
        if not best:
            return ()
        count = len(held) + len(best)
        named = ", ".join(f"{panel} ({one.why} to {one.stands})" for panel, one in sorted(best.items()))
        what = f"{len(best)} of {count} panels come in without a dowel, here with their best joint: {named}"
        hint = "take shorter or thinner dowels, less cover_mm or a larger lean_deg, or hold these otherwise"
        return (Issue("element.dowels", what, Severity.WARNING, field="dowels", hint=hint),)


def square(element: Element) -> float | None:
    """How far [rad] ways in may be off square to sides that dowels go through; None without dowels."""
    file = element.file.dowels
    return None if file is None else file.lean_deg * DEG


def placed(file: DowelsFile, up: Assembly) -> Dowels:
    """The dowels of all joints of an element, in the order in which its panels are put up."""
    names = [body.name for body in up.bodies]
    slabs = [body.shown for body in up.bodies]
    order = {step.body: number for number, step in enumerate(up.steps)}
    holes: list[list[FloatArray]] = [[] for _ in names]
    dowels: list[Dowel] = []
    without: list[Without] = []
    for step in up.steps:
        comes = step.body
        beside = [k for k in np.unique(slabs[comes].beyond).tolist() if k != NONE]
        for stands in sorted((k for k in beside if order[k] < order[comes]), key=order.__getitem__):
            found = _in_joint(file, slabs, (stands, comes), step.way, holes)
            if isinstance(found, tuple):
                without.append(Without(names[stands], names[comes], *found))
            else:
                dowels += [Dowel(names[stands], names[comes], *one) for one in found]
    return Dowels(file, tuple(dowels), tuple(without))


_Found = tuple[FloatArray, FloatArray, float, float]


def _in_joint(
    file: DowelsFile,
    slabs: Sequence[Slab],
    pair: tuple[int, int],
    way: FloatArray,
    holes: list[list[FloatArray]],
) -> list[_Found] | tuple[float, str]:
    """Place, way, along and lean of the dowels between two bodies, or how far [rad] the way leans and why
    there is none; their ``holes`` are added to those of both."""
    stands, comes = pair
    edges = np.flatnonzero(slabs[comes].beyond == stands)
    places, along, normal = _candidates(slabs[comes], edges)
    lean = np.arccos(np.clip(normal @ way, -1.0, 1.0))
    leaning = lean <= file.lean_deg * DEG
    if not leaning.any():
        return float(lean.min()), f"{lean.min() / DEG:.0f} degrees off square"
    radius, depth, cover = (0.5 * file.diameter_mm * MM, file.depth_mm * MM, file.cover_mm * MM)
    keep, free = radius + cover, leaning
    for body, own, into in (
        (stands, np.flatnonzero(slabs[stands].beyond == comes), way),
        (comes, edges, -way),
    ):
        at = places[:, None] + (depth * DEEP)[:, None] * into
        here, rest = _parts(slabs[body], own)
        free = free & (_distance(at, rest).min(axis=1) >= keep)
        free &= (_distance(at, here) >= np.minimum(keep, STEEPEST * depth * DEEP)).all(axis=1)
        for other in holes[body]:
            free &= lengths(at[:, :, None] - other).min(axis=(1, 2)) >= 2.0 * radius + cover
    chosen = _spread(np.flatnonzero(free), along, file.count, 2.0 * radius + cover)
    if not len(chosen):
        return float(lean.min()), "no room"
    fine = np.linspace(0.0, depth, max(2, int(np.ceil(depth / radius)) + 1))[:, None]
    for k in chosen.tolist():
        holes[stands].append(places[k] + fine * way)
        holes[comes].append(places[k] - fine * way)
    return [(places[k], way, float(along[k]), float(lean[k])) for k in chosen.tolist()]


def _candidates(slab: Slab, edges: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Places (N, 3) [m] half-way between front and back along the sides ``edges`` of a body, one run after
    the other, how far (N,) each is along them, and the outward normals (N, 3) there."""
    places, along, normals, begun = [], [], [], 0.0
    for i in edges.tolist():
        k = (i + 1) % len(slab.rim)
        ends = [0.5 * (slab.front[c] + slab.back[c]) for c in (slab.rim[i], slab.rim[k])]
        long = float(np.linalg.norm(ends[1] - ends[0]))
        count = max(1, round(long / STEP))
        share = (np.arange(count) + 0.5) / count
        places.append(ends[0] + share[:, None] * (ends[1] - ends[0]))
        along.append(begun + share * long)
        normals.append(np.broadcast_to(unit(slab.normals[i].mean(axis=0)), (count, 3)))
        begun += long
    return np.concatenate(places), np.concatenate(along), np.concatenate(normals)


def _parts(slab: Slab, edges: IntArray) -> tuple[FloatArray, FloatArray]:
    """Triangles (T, 3, 3) of the sides ``edges`` of a body, and all others."""
    faces, sides = 2 * len(slab.faces), len(slab.rim)
    own = np.zeros(len(slab.triangles), dtype=np.bool_)
    own[np.concatenate([faces + edges, faces + sides + edges])] = True
    return slab.triangles[own], slab.triangles[~own]


def _distance(points: FloatArray, triangles: FloatArray) -> FloatArray:
    """Least distances (N, K) [m] of points (N, K, 3) to triangles (T, 3, 3)."""
    count, flat = len(triangles), points.reshape(-1, 3)
    corners = triangles.transpose(1, 0, 2)
    out = []
    for part in np.array_split(flat, -(-len(flat) * count // AT_ONCE)):
        many = np.repeat(part, count, axis=0)
        a, b, c = (np.tile(corner, (len(part), 1)) for corner in corners)
        weights = closest_on_triangles(many, a, b, c)
        foot = weights[:, :1] * a + weights[:, 1:2] * b + weights[:, 2:] * c
        out.append(lengths(foot - many).reshape(-1, count).min(axis=1))
    return np.concatenate(out).reshape(points.shape[:2])


def _spread(free: IntArray, along: FloatArray, count: int, apart: float) -> IntArray:
    """Up to ``count`` of the places ``free``, as far apart along the joint as they come, no two nearer than
    ``apart`` [m]; of one alone that in the middle."""
    if not len(free):
        return free
    own = along[free]
    for wanted in range(min(count, len(free)), 1, -1):
        even = np.linspace(own[0], own[-1], wanted)
        chosen: IntArray = np.unique(np.abs(own[:, None] - even).argmin(axis=0))
        if len(chosen) == wanted and float(np.diff(own[chosen]).min()) >= apart:
            return np.asarray(free[chosen])
    middle = int(np.abs(own - 0.5 * (own[0] + own[-1])).argmin())
    return np.asarray(free[middle : middle + 1])
