"""Features of a part that is formed from a flat sheet: their tree and their order.

A feature is a monotonic wall from where the sheet is flat (or from its parent) to where the wall ends. The
tree follows from the topology of the height function of the mesh (`surface.contour_tree`), not from its
slices. The slicing step determines only how many contours a feature has. The rules:

- A fork of the level lines ends a feature if two or more of its branches continue in its direction (a saddle:
  one loop becomes two), or none does. The branches are its children. If one branch continues, it is still the
  same feature, and a branch that turns back is its child (a dome on a slope).
- A terrace, a flat within a wall, ends a feature too, and the rest is its child: a stepped dish is two
  features, and so is a dish with one dimple in its floor. `find_walls` defines how wide a flat must be.
- A bump within ``noise`` of its surroundings is not a feature, nor is a bump less than 2 mm across beside
  something larger.

After Ndip-Agbor, Ehmann and Cao, Automated flexible forming strategy for geometries with multiple features in
double-sided incremental forming, J. Manuf. Sci. Eng. 140 (2018), who match loops of neighbouring slices.

**Order** and level at which features are formed. The sheet inside a feature moves with it when the feature is
formed. So a feature is formed at the level that its area of the sheet has at that time: at the level of its
start if all features around it are done (strategy 1), on the flat sheet if none is (strategy 2), and in
between in a custom order.

**Drawings** (`plan_drawing`, `tree_diagram`, `drawing_page`): contours from above, and the tree over the
levels of its features.
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
from planner.issue_codes import format_message
from planner.issues import Issue, Severity, TandemError, issue_error
from planner.processes.forming.plan.features.surface import (
    PlanAreaBeyondLevel,
    SheetSurface,
    check_sheet,
    contour_tree,
    plan_area,
    plan_areas,
    position_text,
    slice_levels,
)
from planner.processes.forming.plan.features.walls import FeatureWall, build_skeleton, find_walls
from planner.runtime.memoize import memoized

MIN_BUMP_HEIGHT_M: Final = 50e-6
"""Height [m] below which a bump of the mesh is noise of its facets, not a feature."""
MAX_SLICES: Final = 100_000
"""Maximum number of levels at which a part is cut to detect its features."""

Kind = Literal["concave", "convex"]


@dataclasses.dataclass(frozen=True)
class Feature:
    """One feature.

    Outlines are closed (the first point is repeated) and counter-clockwise seen from above.

    Attributes:
        id: Number from 1, in preorder.
        parent: Id of the parent, None on the flat sheet.
        kind: "concave" goes down (-z), "convex" goes up.
        start: Level [m] at which it starts.
        end: Level [m] at which it ends.
        region: Outer contour (K, 2) [m] at the start.
        levels: Levels (L,) [m] in the order of forming, from just past the start to just before the end,
            between them one at every step from the start.
        contours: One contour (K, 3) [m] for each level.
        children: Ids of the children.
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
    """The features of a part in preorder.

    Attributes:
        level: Level z [m] of the flat sheet.
        step: Spacing [m] of the slices.
        noise: Height [m] of the mesh's noise.
        features: The features.
        displacement: Displacement (F, V) [m] of each vertex of the mesh by each feature. With the flat level
            they add up to the part's z, within ``noise``.
        issues: Features that touch, for the user.
    """

    level: float
    step: float
    noise: float
    features: tuple[Feature, ...]
    displacement: FloatArray
    issues: tuple[Issue, ...] = ()

    @property
    def roots(self) -> tuple[int, ...]:
        """Ids of the features that start on the flat sheet."""
        return tuple(feature.id for feature in self.features if feature.parent is None)

    def feature(self, number: int) -> Feature:
        """Return the feature with an id.

        Raises:
            KeyError: if there is none.
        """
        if not 1 <= number <= len(self.features):
            raise KeyError(f"feature {number} of {len(self.features)}")
        return self.features[number - 1]


@memoized
def build_feature_tree(mesh: Mesh, step: float, noise: float = MIN_BUMP_HEIGHT_M) -> FeatureTree:
    """Return the features of a part, which are formed one after the other, each in one or more passes.

    Args:
        mesh: Open surface, nearly a height field over the sheet plane, in the sheet's frame, z up, its edge
            level with the flat sheet.
        step: Spacing [m] of the slices.
        noise: Height [m] of the mesh's noise.

    Raises:
        TandemError: the codes of `surface.check_sheet`; ``forming.step`` for a step that is not a
            positive length or gives too many levels; ``forming.flat`` if the part is flat;
            ``forming.touching`` if two features overlap.
    """
    _check_step(mesh, step)
    surface = check_sheet(mesh.vertices, mesh.faces, noise)
    feature_walls = _surface_walls(surface, noise)
    if not feature_walls:
        raise TandemError(_flat_issue(surface, noise))
    slices = [_slice_wall(wall, surface, step) for wall in feature_walls]
    numbers = _preorder(feature_walls, [plan_area(lines[0]) for _, lines in slices])
    features = []
    for number, wall in enumerate(numbers, start=1):
        parent = feature_walls[wall].parent
        features.append(
            Feature(
                number,
                None if parent is None else numbers.index(parent) + 1,
                "convex" if feature_walls[wall].sign > 0 else "concave",
                feature_walls[wall].start,
                feature_walls[wall].end,
                np.ascontiguousarray(slices[wall][1][0][:, :2]),
                slices[wall][0],
                slices[wall][1],
                tuple(k for k, other in enumerate(numbers, start=1) if feature_walls[other].parent == wall),
            )
        )
    displacement = np.zeros((len(feature_walls), len(mesh.vertices)))
    for row, wall in enumerate(numbers):
        displacement[row, surface.used] = feature_walls[wall].height - feature_walls[wall].start
    return FeatureTree(
        surface.level, step, noise, tuple(features), displacement, _touching_issues(features, noise)
    )


def _check_step(mesh: Mesh, step: float) -> None:
    """Raise ``TandemError`` (forming.step) if the step [m] is not positive or gives too many levels."""
    extent = float(np.ptp(mesh.vertices[:, 2])) if len(mesh.vertices) else 0.0
    if not (math.isfinite(step) and step > 0.0 and extent / step <= MAX_SLICES):
        min_step = extent / MM / MAX_SLICES + 1e-6  # as reported, in whole nanometres
        message = (
            f"step: got {step / MM:g} mm, allowed is {min_step:.6f} mm at least ({MAX_SLICES} levels over "
        )
        message += f"the part's {extent / MM:.3g} mm); state a larger one"
        raise issue_error("forming.step", message, field="step", **measurement(step / MM, min_step, "mm"))


def _surface_walls(surface: SheetSurface, noise: float) -> list[FeatureWall]:
    """Return the walls of a surface from the contour tree of its heights, with the flat sheet as its root."""
    # the part continues as flat sheet beyond its edge: one more vertex closes the surface to a sphere
    count = len(surface.vertices)
    height = np.append(surface.vertices[:, 2], surface.level)
    rim = np.stack([surface.border, np.full(len(surface.border), count)], axis=1)
    tree = contour_tree(height, np.concatenate([surface.edges, rim]), count)
    weight = np.bincount(
        surface.faces.reshape(-1), weights=np.repeat(plan_areas(surface), 3), minlength=count
    )
    skeleton = build_skeleton(
        tree, height, np.append(weight, 0.0), PlanAreaBeyondLevel(surface), noise, surface.level
    )
    skeleton = dataclasses.replace(skeleton, element=skeleton.element[:count], height=skeleton.height[:count])
    return find_walls(skeleton, surface, noise)


def _slice_wall(
    wall: FeatureWall, surface: SheetSurface, step: float
) -> tuple[FloatArray, tuple[FloatArray, ...]]:
    """Return levels (L,) [m] in the order of forming, and the closed level line (K, 3) [m] at each.

    Levels are ``step`` [m] apart from the start of the wall, between its first and its last clean level. If
    noise splits a line, the largest piece is used. A line that is a single point, at a tip, is left out.
    """
    sign = wall.sign
    between = wall.start + sign * step * np.arange(1, int(abs(wall.end - wall.start) / step) + 1)
    min_distance = 0.05 * step
    kept = (sign * (between - wall.first) > min_distance) & (sign * (wall.last - between) > min_distance)
    levels = np.concatenate([[wall.first], between[kept], [wall.last]])[:: int(sign)]  # ascending
    lines = slice_levels(surface, wall.height, levels)
    chosen = [(level, max(group, key=plan_area)) for level, group in zip(levels, lines, strict=True) if group]
    chosen = chosen[:: int(sign)]  # in the order of forming
    return np.array([level for level, _ in chosen]), tuple(line for _, line in chosen)


def _preorder(feature_walls: list[FeatureWall], size: list[float]) -> list[int]:
    """Return the indices of the walls in preorder; siblings by ``size`` [m^2], the largest first."""
    order: list[int] = []
    pending: list[int | None] = [None]
    while pending:
        wall = pending.pop()
        if wall is not None:
            order.append(wall)
        children = [index for index, other in enumerate(feature_walls) if other.parent == wall]
        children.sort(key=lambda index: size[index])
        pending.extend(children)
    return order


def _flat_issue(surface: SheetSurface, noise: float) -> Issue:
    height = float(np.ptp(surface.vertices[:, 2]))
    message = f"the part does not leave the sheet plane by {noise / MM:g} mm (its z varies by "
    message += (
        f"{height / MM:.3g} mm); check the unit of the mesh, and that its z axis is normal to the sheet"
    )
    return Issue("forming.flat", message, field="part", **measurement(height / MM, noise / MM, "mm"))


def _touching_issues(features: list[Feature], noise: float) -> tuple[Issue, ...]:
    """Return warnings about features of one parent that have no flat between them.

    Raises ``TandemError`` (forming.touching) if two of them overlap.
    """
    outlines = [Polygon(feature.region).buffer(0.0) for feature in features]
    max_distance = 2.0 * noise
    issues = []
    a, b = STRtree(outlines).query(outlines, predicate="dwithin", distance=max_distance)
    for i, j in zip(a.tolist(), b.tolist(), strict=True):
        if i < j and features[i].parent == features[j].parent:
            over = outlines[i].intersection(outlines[j]).area
            issues.append(
                _touch_issue(
                    features[i], features[j], outlines[i], outlines[j], over > max_distance * max_distance
                )
            )
    errors = [issue for issue in issues if issue.severity is Severity.ERROR]
    if errors:
        raise TandemError(errors)
    return tuple(issues)


def _touch_issue(
    feature: Feature, other: Feature, outline: Polygon, other_outline: Polygon, overlaps: bool
) -> Issue:
    """Return the issue that two features overlap (an error) or touch (a warning), with the place."""
    point = np.array(nearest_points(outline, other_outline)[0].coords[0])
    if overlaps:
        point = np.array(outline.intersection(other_outline).representative_point().coords[0])
    verb = "overlap" if overlaps else "touch"
    hint = (
        "move them apart"
        if overlaps
        else "leave a strip of flat between them if both edges are to be preserved"
    )
    return Issue(
        "forming.touching",
        f"features {feature.id} and {other.id} ({feature.kind} and {other.kind}) {verb} at "
        f"{position_text(point)}; {hint}",
        Severity.ERROR if overlaps else Severity.WARNING,
        field="part",
        bodies=(f"feature {feature.id}", f"feature {other.id}"),
    )


@dataclasses.dataclass(frozen=True)
class OrderStep:
    """One step of forming.

    Attributes:
        feature: Id of the feature to form.
        shift: Distance [m] that is added to z of its contours.
    """

    feature: int
    shift: float


def in_place_order(
    tree: FeatureTree, selected: Sequence[int] | None = None, previous: Sequence[int] = ()
) -> tuple[OrderStep, ...]:
    """Return the order of strategy 1: parents before their children, each in place.

    Every feature is formed at its level in the part (preorder).

    Args:
        tree: Features of the part.
        selected: Features to form; None for all.
        previous: Features that were formed before.
    """
    return custom_order(
        tree,
        _select([feature.id for feature in tree.features], selected),
        selected=selected,
        previous=previous,
    )


def virgin_sheet_order(
    tree: FeatureTree, selected: Sequence[int] | None = None, previous: Sequence[int] = ()
) -> tuple[OrderStep, ...]:
    """Return the order of strategy 2: children before their parents, on the virgin sheet.

    Every feature is formed from the level of the flat sheet (postorder).

    Args:
        tree: Features of the part.
        selected: Features to form; None for all.
        previous: Features that were formed before.
    """
    order: list[int] = []
    waiting = list(tree.roots)  # siblings come out in reverse, then all is reversed
    while waiting:
        feature = tree.feature(waiting.pop())
        order.append(feature.id)
        waiting.extend(feature.children)
    return custom_order(
        tree, _select(order[::-1], selected), translated=True, selected=selected, previous=previous
    )


def _select(order: list[int], selected: Sequence[int] | None) -> list[int]:
    """Return the ids of an order that are selected; all of them if ``selected`` is None."""
    allowed = set(order if selected is None else selected)
    return [number for number in order if number in allowed]


def custom_order(
    tree: FeatureTree,
    order: Sequence[int],
    translated: bool = False,
    selected: Sequence[int] | None = None,
    previous: Sequence[int] = (),
) -> tuple[OrderStep, ...]:
    """Return the steps of a custom order.

    In place, a parent must come before its children.

    Args:
        tree: Features of the part.
        order: Ids of the features in the order of forming.
        translated: Allow any order: a feature that is formed before its parent is formed at the level that
            the sheet has there at that time.
        selected: Features to form; None for all.
        previous: Features that were formed before.

    Raises:
        TandemError: ``forming.order`` for a feature that is unknown, missing or named twice, and in place for
            a child before its parent.
    """
    _check_order(tree, order, translated, selected, previous)
    done = set(previous)
    steps = []
    for number in order:
        steps.append(OrderStep(number, sheet_level(tree, number, done) - tree.feature(number).start))
        done.add(number)
    return tuple(steps)


def sheet_level(tree: FeatureTree, number: int, done: set[int]) -> float:
    """Return z [m] of the sheet where a feature starts, once some features are formed.

    A feature that encloses it and is formed moves the sheet there from the start of the enclosing feature to
    the start of the next feature inside. If all enclosing features are done, the level is exactly the start
    of the feature in the part. If none is done, it is exactly that of the flat sheet.

    Args:
        tree: Features of the part.
        number: Id of the feature.
        done: Features that are formed.
    """
    feature = tree.feature(number)
    enclosing = []
    while feature.parent is not None:
        parent = tree.feature(feature.parent)
        enclosing.append((parent.id, feature.start - parent.start))
        feature = parent
    if all(parent in done for parent, _ in enclosing):
        return tree.feature(number).start
    return tree.level + sum(displacement for parent, displacement in enclosing if parent in done)


def _check_order(
    tree: FeatureTree,
    order: Sequence[int],
    translated: bool,
    selected: Sequence[int] | None,
    previous: Sequence[int],
) -> None:
    """Raise ``TandemError`` (forming.order) with all faults of a custom order.

    Each required feature must be named exactly once, and no other one. Unless ``translated``, a parent must
    come before its children, or be formed before. The arguments are those of `custom_order`.
    """
    required = set(range(1, len(tree.features) + 1)) if selected is None else set(selected)
    issues = []
    unknown = sorted(set(order) - required - {feature.id for feature in tree.features})
    others = sorted(set(order) - required - set(unknown))
    missing = sorted(required - set(order))
    repeated = sorted({number for number in order if order.count(number) > 1})
    for fault, numbers in (
        ("does not exist", unknown),
        ("is formed by another operation", others),
        ("is missing", missing),
        ("is named twice", repeated),
    ):
        allowed = f"1 to {len(required)}" if selected is None else ", ".join(map(str, sorted(required)))
        issues += [_order_issue(f"feature {n} {fault}; name each of {allowed} once") for n in numbers]
    if not translated and not issues:
        position = {number: index for index, number in enumerate((*previous, *order))}
        issues += [
            _order_issue(
                f"feature {feature.id} comes before its parent, feature {feature.parent}; form the "
                "parent first, or form the features translated, on the virgin sheet"
            )
            for feature in tree.features
            if feature.id in required
            and feature.parent is not None
            and position[feature.id] < position.get(feature.parent, len(position))
        ]
    if issues:
        raise TandemError(issues)


def _order_issue(fault: str) -> Issue:
    return Issue("forming.order", format_message("forming.order", fault=fault), field="order")


COLOUR_COUNT: Final = 8
"""Number of colours c0 to c7 of the report's style sheet; features use them in turn."""
PRINT_COLOURS: Final = (
    *("#1f6fb4", "#d9662b", "#2a9461", "#8e5bb5"),
    *("#b8912a", "#c4497f", "#3aa5a0", "#6b7686"),
)
"""Colours c0 to c7 on white, for a drawing without the style sheet."""
MAX_DRAWN_CONTOURS: Final = 24
"""Maximum number of drawn contours of one feature. More would merge visually."""
CONTOUR_TOLERANCE: Final = 0.15
"""Tolerance of the simplification of drawn contours, in units of the drawing."""
DRAWING_WIDTH: Final = 760.0
"""Width of the drawing, in its own units."""


def plan_drawing(tree: FeatureTree) -> str:
    """Return the contours of all features from above as SVG.

    The sheet's x points to the right and y up. Contours of convex features are dashed.
    """
    outlines = np.concatenate([feature.region for feature in tree.features])
    low, high = outlines.min(axis=0), outlines.max(axis=0)
    margin = 0.04 * float((high - low).max())
    low, high = low - margin, high + margin
    scale = DRAWING_WIDTH / float(high[0] - low[0])
    height = scale * float(high[1] - low[1])
    parts = [
        f'<svg class="plot" viewBox="0 0 {DRAWING_WIDTH:.0f} {height:.0f}" role="img" aria-label="contours '
        f'from above">'
    ]
    for feature in tree.features:
        dashed = " dashed" if feature.sign > 0 else ""
        parts.append(f'<g class="thin c{feature.id % COLOUR_COUNT}{dashed}">')
        parts.append(f"<title>{html.escape(_feature_label(feature))}</title>")
        parts += [
            f'<path d="{_svg_path((line[:, :2] - low) * scale, height)}"/>'
            for line in _drawn_contours(feature)
        ]
        parts.append("</g>")
    for feature in tree.features:
        x, y = (np.array(shapely.Polygon(feature.region).exterior.interpolate(0.0).coords[0]) - low) * scale
        parts.append(f'<text x="{x + 4:.1f}" y="{height - y - 4:.1f}">{feature.id}</text>')
    return "".join([*parts, "</svg>"])


def tree_diagram(tree: FeatureTree) -> str:
    """Return the tree as SVG: a bar for each feature from its start to its end, joined to its parent."""
    levels = [tree.level, *(value for feature in tree.features for value in (feature.start, feature.end))]
    low, high = min(levels), max(levels)
    height, left, top = 260.0, 64.0, 24.0
    step = min((DRAWING_WIDTH - left - 20.0) / len(tree.features), 90.0)

    def level_y(level: float) -> float:
        """Return the y of a level [m] in the drawing."""
        return top + (high - level) / (high - low) * height

    parts = [
        f'<svg class="plot" viewBox="0 0 {DRAWING_WIDTH:.0f} {height + 2 * top:.0f}" role="img" '
        f'aria-label="feature tree"><line class="axis" x1="{left}" x2="{DRAWING_WIDTH - 10}" '
        f'y1="{level_y(tree.level):.1f}" y2="{level_y(tree.level):.1f}"/>'
    ]
    for level in sorted({round(value / MM, 1) for value in levels}):
        y = level_y(level * MM) + 4
        parts.append(f'<text class="ytick" x="{left - 6}" y="{y:.1f}">{level + 0.0:g} mm</text>')
    for feature in tree.features:
        x, start_y, end_y = left + (feature.id - 0.5) * step, level_y(feature.start), level_y(feature.end)
        colour = feature.id % COLOUR_COUNT
        if feature.parent is not None:
            from_x = left + (feature.parent - 0.5) * step
            parts.append(
                f'<line class="axis" x1="{from_x:.1f}" x2="{x:.1f}" y1="{start_y:.1f}" y2="{start_y:.1f}"/>'
            )
        parts.append(
            f'<rect style="fill:var(--c{colour})" x="{x - 6:.1f}" width="12" y="{min(start_y, end_y):.1f}" '
            f'height="{max(abs(end_y - start_y), 1.0):.1f}">'
            f"<title>{html.escape(_feature_label(feature))}</title></rect>"
        )
        y = end_y + 14.0 if feature.sign < 0 else end_y - 6.0
        parts.append(f'<text class="mid" x="{x:.1f}" y="{y:.1f}">{feature.id}</text>')
    return "".join([*parts, "</svg>"])


def standalone_drawing(tree: FeatureTree) -> str:
    """Return the contours from above as a standalone SVG file that contains its colours."""
    rules = [".thin{fill:none;stroke-width:1}", ".dashed{stroke-dasharray:4 3}", "text{font:11px sans-serif}"]
    rules += [f".c{index}{{stroke:{colour}}}" for index, colour in enumerate(PRINT_COLOURS)]
    start, rest = plan_drawing(tree).split(">", 1)
    named = start.replace("<svg", '<svg xmlns="http://www.w3.org/2000/svg"')
    return f"{named}><style>{''.join(rules)}</style>{rest}\n"


def _drawn_contours(feature: Feature) -> list[FloatArray]:
    return [feature.contours[index] for index in spread_rows(len(feature.contours), MAX_DRAWN_CONTOURS)]


def _svg_path(points: FloatArray, height: float) -> str:
    """Return an SVG path of a closed line (K, 2); ``height`` is that of the drawing, whose y points down."""
    line = shapely.LineString(points).simplify(CONTOUR_TOLERANCE)
    coordinates = (f"{x:.1f} {height - y:.1f}" for x, y in shapely.get_coordinates(line)[:-1])
    return "M" + "L".join(coordinates) + "Z"


def _feature_label(feature: Feature) -> str:
    base = "the flat sheet" if feature.parent is None else f"feature {feature.parent}"
    name = f"feature {feature.id} on {base}: {feature.kind}"
    return f"{name}, {feature.start / MM:z.2f} to {feature.end / MM:z.2f} mm"
