"""Features of a part that is formed from a flat sheet: how they stand on each other, their order.

A feature is a wall that goes one way from where the sheet is flat (or from its parent) to where it
ends. The tree comes from the topology of the height function of the mesh (`surface.contour_tree`),
not from its slices: the slicing step sets how many contours a feature has and nothing else. The
rules:

- A fork of the level lines ends a feature where two or more of what follows go on in its direction
  (a saddle: one loop becomes two), or none does. What follows are its children. Where one goes on,
  it is still the same feature, and what turns back there is its child (a dome on a slope).
- A terrace, a flat within a wall, ends a feature too, and what follows is its child: a stepped dish
  is two features, and so is a dish with one dimple in its floor. `walls` says how wide a flat must
  be.
- What does not leave its surroundings by ``noise`` is no feature, nor is a bump less than 2 mm
  across beside something larger.

After Ndip-Agbor, Ehmann and Cao, Automated flexible forming strategy for geometries with multiple
features in double-sided incremental forming, J. Manuf. Sci. Eng. 140 (2018), who match loops of
neighbouring slices.

**Order** and level at which features are formed. The sheet inside a feature goes along when the
feature is formed. So a feature is formed where its place of the sheet is at that time: at the level
of its start where all the features around it are done (strategy 1), on the flat sheet where none is
(strategy 2), and in between in an order of one's own.

**Drawings** (`plan_drawing`, `tree_diagram`, `drawing_page`): contours from above, and the tree over
the levels of its features.
"""

import dataclasses
import html
import math
from collections.abc import Sequence
from typing import Final, Literal

import numpy as np
import shapely
from shapely import STRtree
from shapely.geometry import Polygon
from shapely.ops import nearest_points

from planner.geometry.arrays import FloatArray, Mesh, spread_rows
from planner.geometry.units import MM, measurement
from planner.issues import Issue, Severity, TandemError, refusal
from planner.processes.forming.plan.features.surface import (
    Beyond,
    SheetSurface,
    check_sheet,
    contour_tree,
    plan_area,
    plan_areas,
    slice_levels,
    where,
)
from planner.processes.forming.plan.features.walls import Wall, skeleton, walls
from planner.runtime.memoize import memoized

LEAST_BUMP: Final = 50e-6
"""Height [m] below which a bump of the mesh is noise of its facets and no feature."""
MOST_SLICES: Final = 100_000
"""Levels at most at which a part is cut to find its features."""

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


@memoized
def build(mesh: Mesh, step: float, noise: float = LEAST_BUMP) -> FeatureTree:
    """The features of a part, sliced every ``step`` [m].

    ``mesh``: an open surface that is nearly a height field over the sheet plane, in the sheet's frame, z up,
    its edge level with the flat sheet. Raises ``TandemError`` with the codes of `surface.check_sheet`, and
    ``forming.step`` for a step that is no length or gives too many levels, ``forming.flat`` where nothing
    leaves the flat, ``forming.touching`` where two features lie over each other.
    """
    _check_step(mesh, step)
    surface = check_sheet(mesh.vertices, mesh.faces, noise)
    found = _walls(surface, noise)
    if not found:
        raise TandemError(_flat(surface, noise))
    sliced = [_sliced(wall, surface, step) for wall in found]
    numbers = _preorder(found, [plan_area(lines[0]) for _, lines in sliced])
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
    if not (math.isfinite(step) and step > 0.0 and extent / step <= MOST_SLICES):
        least = extent / MM / MOST_SLICES + 1e-6  # as told, in whole nanometres
        what = f"step: got {step / MM:g} mm, allowed is {least:.6f} mm at least, {MOST_SLICES} levels over "
        what += f"the part's {extent / MM:.3g} mm; state such a length"
        raise refusal("forming.step", what, field="step", **measurement(step / MM, least, "mm"))


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
    chosen = [(level, max(group, key=plan_area)) for level, group in zip(levels, lines, strict=True) if group]
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
    what = f"nothing of the part leaves the sheet plane by {noise / MM:g} mm (its z vary by "
    what += f"{height / MM:.3g} mm); check the unit of the mesh, and that its z axis is normal to the sheet"
    return Issue("forming.flat", what, field="part", **measurement(height / MM, noise / MM, "mm"))


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


@dataclasses.dataclass(frozen=True)
class OrderStep:
    """Form ``feature`` (its id) with ``shift`` [m] added to z of its contours."""

    feature: int
    shift: float


def in_place(
    tree: FeatureTree, own: Sequence[int] | None = None, before: Sequence[int] = ()
) -> tuple[OrderStep, ...]:
    """Strategy 1: parents before their children (preorder), every feature where it is in the part; of those
    that are its ``own``, where others were formed ``before``."""
    return given_order(tree, _chosen([feature.id for feature in tree.features], own), own=own, before=before)


def on_virgin_sheet(
    tree: FeatureTree, own: Sequence[int] | None = None, before: Sequence[int] = ()
) -> tuple[OrderStep, ...]:
    """Strategy 2: children before their parents (postorder), every feature from the level of the flat
    sheet; of those that are its ``own``, where others were formed ``before``."""
    order: list[int] = []
    waiting = list(tree.roots)  # siblings come out in reverse, then all is reversed
    while waiting:
        feature = tree.feature(waiting.pop())
        order.append(feature.id)
        waiting.extend(feature.children)
    return given_order(tree, _chosen(order[::-1], own), True, own, before)


def _chosen(order: list[int], own: Sequence[int] | None) -> list[int]:
    some = set(order if own is None else own)
    return [number for number in order if number in some]


def given_order(
    tree: FeatureTree,
    order: Sequence[int],
    translated: bool = False,
    own: Sequence[int] | None = None,
    before: Sequence[int] = (),
) -> tuple[OrderStep, ...]:
    """An order of one's own. In place, a parent must come before its children. ``translated`` allows any
    order: what is formed before its parent is formed at the level that the sheet has there at the time.
    ``own``: the features that are to be formed, none for all, where others were formed ``before``.

    Raises ``TandemError`` with ``forming.order`` for a feature that is unknown, missing or named twice, and
    in place for a child before its parent.
    """
    _check(tree, order, translated, own, before)
    done = set(before)
    steps = []
    for number in order:
        steps.append(OrderStep(number, sheet_level(tree, number, done) - tree.feature(number).start))
        done.add(number)
    return tuple(steps)


def sheet_level(tree: FeatureTree, number: int, done: set[int]) -> float:
    """z [m] of the sheet where a feature starts, once the features ``done`` are formed.

    A feature around it takes it along from the feature's own start to the start of what stands on it. With
    all of them done that is the start itself, with none the flat sheet, to the last bit.
    """
    feature = tree.feature(number)
    around = []
    while feature.parent is not None:
        parent = tree.feature(feature.parent)
        around.append((parent.id, feature.start - parent.start))
        feature = parent
    if all(parent in done for parent, _ in around):
        return tree.feature(number).start
    return tree.level + sum(moved for parent, moved in around if parent in done)


def _check(
    tree: FeatureTree,
    order: Sequence[int],
    translated: bool,
    own: Sequence[int] | None,
    before: Sequence[int],
) -> None:
    wanted = set(range(1, len(tree.features) + 1)) if own is None else set(own)
    issues = []
    unknown = sorted(set(order) - wanted - {feature.id for feature in tree.features})
    others = sorted(set(order) - wanted - set(unknown))
    missing = sorted(wanted - set(order))
    twice = sorted({number for number in order if order.count(number) > 1})
    for what, numbers in (
        ("does not exist", unknown),
        ("is formed by another operation", others),
        ("is missing", missing),
        ("is there twice", twice),
    ):
        each = f"1 to {len(wanted)}" if own is None else ", ".join(map(str, sorted(wanted)))
        issues += [_issue(f"feature {n} {what}; name each of {each} once") for n in numbers]
    if not translated and not issues:
        place = {number: index for index, number in enumerate((*before, *order))}
        issues += [
            _issue(
                f"feature {feature.id} comes before feature {feature.parent}, on which it stands; form the "
                "parent first, or form the features translated, on the virgin sheet"
            )
            for feature in tree.features
            if feature.id in wanted
            and feature.parent is not None
            and place[feature.id] < place.get(feature.parent, len(place))
        ]
    if issues:
        raise TandemError(issues)


def _issue(what: str) -> Issue:
    return Issue("forming.order", f"order of forming: {what}", field="order")


COLOUR_COUNT: Final = 8
"""Colours c0 to c7 of the report's style sheet; features take them in turn."""
PRINT_COLOURS: Final = (
    *("#1f6fb4", "#d9662b", "#2a9461", "#8e5bb5"),
    *("#b8912a", "#c4497f", "#3aa5a0", "#6b7686"),
)
"""The same on white, for a drawing without the style sheet."""
MOST_CONTOURS: Final = 24
"""Contours drawn of one feature, at most: more run into each other."""
CONTOUR_TOLERANCE: Final = 0.15
"""Contours are drawn with points left out up to this far from the line, in units of the drawing."""
DRAWING_WIDTH: Final = 760.0
"""Width of the drawing, in its own units."""


def plan_drawing(tree: FeatureTree) -> str:
    """Contours of all features from above as SVG: the sheet's x to the right and y up; dashed ones go up."""
    every = np.concatenate([feature.region for feature in tree.features])
    low, high = every.min(axis=0), every.max(axis=0)
    margin = 0.04 * float((high - low).max())
    low, high = low - margin, high + margin
    scale = DRAWING_WIDTH / float(high[0] - low[0])
    tall = scale * float(high[1] - low[1])
    parts = [
        f'<svg class="plot" viewBox="0 0 {DRAWING_WIDTH:.0f} {tall:.0f}" role="img" aria-label="contours '
        f'from above">'
    ]
    for feature in tree.features:
        dashed = " dashed" if feature.sign > 0 else ""
        parts.append(f'<g class="thin c{feature.id % COLOUR_COUNT}{dashed}">')
        parts.append(f"<title>{html.escape(_feature_label(feature))}</title>")
        parts += [f'<path d="{_path((line[:, :2] - low) * scale, tall)}"/>' for line in _some(feature)]
        parts.append("</g>")
    for feature in tree.features:
        x, y = (np.array(shapely.Polygon(feature.region).exterior.interpolate(0.0).coords[0]) - low) * scale
        parts.append(f'<text x="{x + 4:.1f}" y="{tall - y - 4:.1f}">{feature.id}</text>')
    return "".join([*parts, "</svg>"])


def tree_diagram(tree: FeatureTree) -> str:
    """The tree as SVG: a bar for each feature from its start to its end, joined to its parent."""
    levels = [tree.level, *(value for feature in tree.features for value in (feature.start, feature.end))]
    low, high = min(levels), max(levels)
    tall, left, top = 260.0, 64.0, 24.0
    step = min((DRAWING_WIDTH - left - 20.0) / len(tree.features), 90.0)

    def down(level: float) -> float:
        return top + (high - level) / (high - low) * tall

    parts = [
        f'<svg class="plot" viewBox="0 0 {DRAWING_WIDTH:.0f} {tall + 2 * top:.0f}" role="img" '
        f'aria-label="feature tree"><line class="axis" x1="{left}" x2="{DRAWING_WIDTH - 10}" '
        f'y1="{down(tree.level):.1f}" y2="{down(tree.level):.1f}"/>'
    ]
    for level in sorted({round(value / MM, 1) for value in levels}):
        y = down(level * MM) + 4
        parts.append(f'<text class="ytick" x="{left - 6}" y="{y:.1f}">{level + 0.0:g} mm</text>')
    for feature in tree.features:
        x, begin, end = left + (feature.id - 0.5) * step, down(feature.start), down(feature.end)
        colour = feature.id % COLOUR_COUNT
        if feature.parent is not None:
            from_x = left + (feature.parent - 0.5) * step
            parts.append(
                f'<line class="axis" x1="{from_x:.1f}" x2="{x:.1f}" y1="{begin:.1f}" y2="{begin:.1f}"/>'
            )
        parts.append(
            f'<rect style="fill:var(--c{colour})" x="{x - 6:.1f}" width="12" y="{min(begin, end):.1f}" '
            f'height="{max(abs(end - begin), 1.0):.1f}">'
            f"<title>{html.escape(_feature_label(feature))}</title></rect>"
        )
        y = end + 14.0 if feature.sign < 0 else end - 6.0
        parts.append(f'<text class="mid" x="{x:.1f}" y="{y:.1f}">{feature.id}</text>')
    return "".join([*parts, "</svg>"])


def alone(tree: FeatureTree) -> str:
    """The contours from above as an SVG file of its own, with its colours in it."""
    rules = [".thin{fill:none;stroke-width:1}", ".dashed{stroke-dasharray:4 3}", "text{font:11px sans-serif}"]
    rules += [f".c{index}{{stroke:{colour}}}" for index, colour in enumerate(PRINT_COLOURS)]
    start, rest = plan_drawing(tree).split(">", 1)
    named = start.replace("<svg", '<svg xmlns="http://www.w3.org/2000/svg"')
    return f"{named}><style>{''.join(rules)}</style>{rest}\n"


def _some(feature: Feature) -> list[FloatArray]:
    return [feature.contours[index] for index in spread_rows(len(feature.contours), MOST_CONTOURS)]


def _path(points: FloatArray, tall: float) -> str:
    line = shapely.LineString(points).simplify(CONTOUR_TOLERANCE)
    pairs = (f"{x:.1f} {tall - y:.1f}" for x, y in shapely.get_coordinates(line)[:-1])
    return "M" + "L".join(pairs) + "Z"


def _feature_label(feature: Feature) -> str:
    on = "the flat sheet" if feature.parent is None else f"feature {feature.parent}"
    name = f"feature {feature.id} on {on}: {feature.kind}"
    return f"{name}, {feature.start / MM:z.2f} to {feature.end / MM:z.2f} mm"
