"""Features of a part that is formed from a flat sheet, and how they stand on each other.

A feature is a wall that goes one way from where the sheet is flat (or from its parent) to where it ends. The
tree comes from the topology of the height function of the mesh (`contour_tree`), not from its slices: the
slicing step sets how many contours a feature has and nothing else. The rules:

- A fork of the level lines ends a feature where two or more of what follows go on in its direction (a saddle:
  one loop becomes two), or none does. What follows are its children. Where one goes on, it is still the same
  feature, and what turns back there is its child (a dome on a slope).
- A terrace, a flat within a wall, ends a feature too, and what follows is its child: a stepped dish is two
  features, and so is a dish with one dimple in its floor. `terraces` says how wide a flat must be.
- What does not leave its surroundings by ``noise`` is no feature, nor is a bump less than 2 mm across beside
  something larger.

After Ndip-Agbor, Ehmann and Cao, Automated flexible forming strategy for geometries with multiple features in
double-sided incremental forming, J. Manuf. Sci. Eng. 140 (2018), who match loops of neighbouring slices.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Final, Literal

import numpy as np
from shapely import STRtree
from shapely.geometry import Polygon
from shapely.ops import nearest_points

from planner.forming.contour_tree import contour_tree
from planner.forming.skeleton import skeleton
from planner.forming.slicing import area, slice_levels
from planner.forming.surface import Beyond, SheetSurface, check, plan_areas, where
from planner.forming.values import FloatArray
from planner.forming.walls import Wall, walls
from planner.issues import Issue, Severity, TandemError
from planner.problem import Mesh
from planner.units import MM

NOISE: Final = 50e-6
"""Height [m] below which a bump of the mesh is noise of its facets and no feature."""
MOST_LEVELS: Final = 100_000

Kind = Literal["concave", "convex"]


@dataclasses.dataclass(frozen=True)
class Feature:
    """One feature. ``id`` counts from 1 in preorder; ``parent`` is None on the flat sheet; ``kind`` "concave"
    goes down (-z) and "convex" goes up, from ``start`` to ``end`` [m]. ``region`` (K, 2) [m]: outer contour
    at the start. ``levels`` (L,) [m] and ``contours``, one (K, 3) [m] each: in the order of forming, from
    just past the start to just before the end, between them every step from the start. Outlines are closed
    (the first point is repeated) and counter-clockwise seen from above.
    """

    id: int
    parent: int | None
    kind: Kind
    start: float
    end: float
    region: FloatArray
    levels: FloatArray
    contours: tuple[FloatArray, ...]
    children: tuple[int, ...]

    @property
    def sign(self) -> int:
        """+1 for convex (up), -1 for concave (down)."""
        return 1 if self.kind == "convex" else -1


@dataclasses.dataclass(frozen=True)
class FeatureTree:
    """The features of a part in preorder. ``level`` [m]: z of the flat sheet. ``share`` (F, V) [m]: how far
    each feature moves each vertex of the mesh; with the flat level they add up to the part's z, within
    ``noise``. ``issues``: features that touch, for the user."""

    level: float
    step: float
    noise: float
    features: tuple[Feature, ...]
    share: FloatArray
    issues: tuple[Issue, ...] = ()

    @property
    def roots(self) -> tuple[int, ...]:
        """Ids of the features that start on the flat sheet."""
        return tuple(feature.id for feature in self.features if feature.parent is None)

    def feature(self, number: int) -> Feature:
        """The feature of an id; raises ``KeyError`` where there is none."""
        if not 1 <= number <= len(self.features):
            raise KeyError(f"feature {number} of {len(self.features)}")
        return self.features[number - 1]


def build(mesh: Mesh, step: float, noise: float = NOISE) -> FeatureTree:
    """The features of a part, sliced every ``step`` [m].

    ``mesh``: an open surface that is nearly a height field over the sheet plane, in the sheet's frame, z up,
    its edge level with the flat sheet. Raises ``TandemError`` with the codes of `surface.check`, and
    ``forming.step`` for a step that is no length or gives too many levels, ``forming.flat`` where nothing
    leaves the flat, ``forming.touching`` where two features lie over each other.
    """
    _check_step(mesh, step)
    surface = check(mesh.vertices, mesh.faces, noise)
    found = _walls(surface, noise)
    if not found:
        raise TandemError(_flat(surface, noise))
    sliced = [_sliced(wall, surface, step) for wall in found]
    numbers = _preorder(found, [area(lines[0]) for _, lines in sliced])
    features = []
    for number, wall in enumerate(numbers, start=1):
        parent = found[wall].parent
        features.append(
            Feature(
                number,
                None if parent is None else numbers.index(parent) + 1,
                "convex" if found[wall].sign > 0 else "concave",
                found[wall].start,
                found[wall].end,
                np.ascontiguousarray(sliced[wall][1][0][:, :2]),
                sliced[wall][0],
                sliced[wall][1],
                tuple(k for k, other in enumerate(numbers, start=1) if found[other].parent == wall),
            )
        )
    share = np.zeros((len(found), len(mesh.vertices)))
    for row, wall in enumerate(numbers):
        share[row, surface.used] = found[wall].height - found[wall].start
    return FeatureTree(surface.level, step, noise, tuple(features), share, _touching(features, noise))


def _check_step(mesh: Mesh, step: float) -> None:
    extent = float(np.ptp(mesh.vertices[:, 2])) if len(mesh.vertices) else 0.0
    if not (math.isfinite(step) and step > 0.0 and extent / step <= MOST_LEVELS):
        least = extent / MM / MOST_LEVELS + 1e-6  # as told, in whole nanometres
        raise TandemError(
            Issue(
                "forming.step",
                f"step: got {step / MM:g} mm, allowed is {least:.6f} mm at least, {MOST_LEVELS} levels over "
                f"the part's {extent / MM:.3g} mm; state such a length",
                field="step",
                value=step / MM,
                limit=least,
                unit="mm",
            )
        )


def _walls(surface: SheetSurface, noise: float) -> list[Wall]:
    # beyond its edge the part goes on as flat sheet: one more vertex, which closes the surface to a sphere
    count = len(surface.vertices)
    height = np.append(surface.vertices[:, 2], surface.level)
    rim = np.stack([surface.border, np.full(len(surface.border), count)], axis=1)
    tree = contour_tree(height, np.concatenate([surface.edges, rim]), count)
    weight = np.bincount(
        surface.faces.reshape(-1), weights=np.repeat(plan_areas(surface), 3), minlength=count
    )
    bones = skeleton(tree, height, np.append(weight, 0.0), Beyond(surface), noise, surface.level)
    bones = dataclasses.replace(bones, element=bones.element[:count], height=bones.height[:count])
    return walls(bones, surface, noise)


def _sliced(wall: Wall, surface: SheetSurface, step: float) -> tuple[FloatArray, tuple[FloatArray, ...]]:
    """Levels in the order of forming, and the one level line at each. Where noise parts a line it is the
    largest piece; a line that is a mere point, at a tip, is left out."""
    sign = wall.sign
    between = wall.start + sign * step * np.arange(1, int(abs(wall.end - wall.start) / step) + 1)
    clear = 0.05 * step
    kept = (sign * (between - wall.first) > clear) & (sign * (wall.last - between) > clear)
    levels = np.concatenate([[wall.first], between[kept], [wall.last]])[:: int(sign)]
    lines = slice_levels(surface, wall.height, levels)
    chosen = [(level, max(group, key=area)) for level, group in zip(levels, lines, strict=True) if group]
    chosen = chosen[:: int(sign)]
    return np.array([level for level, _ in chosen]), tuple(line for _, line in chosen)


def _preorder(found: list[Wall], size: list[float]) -> list[int]:
    """Walls in preorder, of those of one parent the largest first."""
    order: list[int] = []
    waiting: list[int | None] = [None]
    while waiting:
        wall = waiting.pop()
        if wall is not None:
            order.append(wall)
        children = [index for index, other in enumerate(found) if other.parent == wall]
        children.sort(key=lambda index: size[index])
        waiting.extend(children)
    return order


def _flat(surface: SheetSurface, noise: float) -> Issue:
    height = float(np.ptp(surface.vertices[:, 2]))
    return Issue(
        "forming.flat",
        f"nothing of the part leaves the sheet plane by {noise / MM:g} mm (its z vary by "
        f"{height / MM:.3g} mm); check the unit of the mesh, and that its z axis is normal to the sheet",
        field="part",
        value=height / MM,
        limit=noise / MM,
        unit="mm",
    )


def _touching(features: list[Feature], noise: float) -> tuple[Issue, ...]:
    """Features of one parent with no flat between them, or that reach their parent's wall. Raises
    ``TandemError`` where two lie over each other."""
    outlines = [Polygon(feature.region).buffer(0.0) for feature in features]
    near = 2.0 * noise
    issues = []
    a, b = STRtree(outlines).query(outlines, predicate="dwithin", distance=near)
    for i, j in zip(a.tolist(), b.tolist(), strict=True):
        if i < j and features[i].parent == features[j].parent:
            over = outlines[i].intersection(outlines[j]).area
            issues.append(_touch(features[i], features[j], outlines[i], outlines[j], over > near * near))
    errors = [issue for issue in issues if issue.severity is Severity.ERROR]
    if errors:
        raise TandemError(errors)
    return tuple(issues)


def _touch(one: Feature, other: Feature, outline: Polygon, second: Polygon, over: bool) -> Issue:
    place = np.array(nearest_points(outline, second)[0].coords[0])
    if over:
        place = np.array(outline.intersection(second).representative_point().coords[0])
    what = "lie over each other" if over else "touch"
    hint = (
        "move them apart" if over else "leave a strip of flat between them, if both are to keep their edges"
    )
    return Issue(
        "forming.touching",
        f"features {one.id} and {other.id} ({one.kind} and {other.kind}) {what} at {where(place)}; {hint}",
        Severity.ERROR if over else Severity.WARNING,
        field="part",
        bodies=(f"feature {one.id}", f"feature {other.id}"),
    )
