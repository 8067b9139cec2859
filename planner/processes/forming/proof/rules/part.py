"""verify.forming_part: the faces of all passes, against the part.

Together they make it, each is formed where the sheet is then, in the wanted order, by way of shapes
that are no steeper than wanted.
"""

from collections.abc import Iterator

import numpy as np
from scipy.spatial import ConvexHull

from planner.geometry.arrays import corners, transform
from planner.issues import Issue
from planner.processes.forming.claims import FormsPart, FormsSheet
from planner.processes.forming.proof.shapes import Feature, PartShapes, Shape, in_order
from planner.processes.forming.proof.state import FORMING, Forming
from planner.proof.context import Context
from planner.proof.findings import Findings, coordinates, in_degrees, in_mm, in_percent
from planner.proof.part_files.sheets import SLOPE_STEP, scatter, together, tolerance_of
from planner.proof.rule import Measure, Outcome, issue, mm, rule

FORMING_PART = "verify.forming_part"
"""Code of this rule."""
FACE_ERROR = 6e-5
"""What all passes make together is off the part by no more [m]: floors may be levelled within the noise of
their mesh."""
WITHIN_SHARE = 0.99
"""Share of a noisy mesh's vertices that are within its tolerance of what is formed."""
FARTHEST_TOLERANCES = 2.5
"""How far the farthest may be, in tolerances: noise and rounded folds."""
BESIDE, GROUP = 3e-5, 6
"""By so much [m] more than the tolerance at most so many vertices beside one another are off to one side."""
MEAN_TOLERANCES = 0.35
"""How far the mean of a place may be off, in tolerances, besides its noise."""
MEAN_NOISE_FACTOR = 1.4
"""Over the root of the number of vertices: how far noise takes their mean, in tolerances: four of its
standard deviations, of which the tolerance is three."""
TOLERANCE_FACTOR = 1.5
"""How much wider than by the proof's own estimate a mesh's tolerance may be found."""
ROUNDING = 1e-9
"""Tolerances [m] and shares that differ by less are the same."""
RIM_HEIGHT = 1.2e-4
"""How far [m] a feature may begin off the sheet around it: twice that noise."""
STANDS_OUT = 3e-4
"""How far [m] the sheet may stand out of the hulls of the part between stages, and off the flat unseen."""
RIM_SHARE = 0.9
"""Share of the places around a feature that count: in a noisy mesh others lie on what is beside it."""
NO_PART = "no part is to be formed"
"""Why this rule has not run."""
WALL_SHARE = 0.995
"""Share of the walls that counts as the angle of a shape: slivers are left out."""
ANGLE_ERROR = np.deg2rad(1.0)
"""How far [rad] angles of shapes may be off: of facets, and of walls that bend."""
FLATTENED_ANGLE = np.deg2rad(3.0)
"""How much flatter [rad] a shape may be where it is not as deep as the part."""
HELD_SHARE = 0.05
"""Share of a shape's area that may be: creases, tips, and the last step to its floor."""
SAME_AREA_SHARE = 0.02
"""Share by which areas of features differ that may change places in the numbering."""


@rule("verify.forming_part", FormsPart)
def forming_part(context: Context) -> Outcome:
    """The faces of all passes, of all operations that form some features of it, together make the part and
    nothing else; each feature is formed by the tool on its side, from the level at which the sheet is then,
    in the wanted order, through shapes in between that are as steep as wanted and never beyond the part."""
    forming, findings = context.get(FORMING), Findings(FORMING_PART, context)
    last = next((made for made, _ in reversed(forming.parts) if made is not None), None)
    findings.issues += _once(forming)
    for made, group in forming.parts:
        if made is None:
            for claim in in_order(group):
                what = f"nothing says of what part {claim.segment} is a face"
                findings.add(what, field=str(claim.segment))
            continue
        if not made.own:
            findings.add("the part is never formed", field="part")
            continue
        findings.issues += _tolerance(context, made)
        if made.part.features is None or made is last:
            off, found = _whole(made) if made.part.mesh_tolerance == 0.0 else _whole_of_noisy(made)
            limit = FACE_ERROR + made.part.mesh_tolerance
            findings.highest(off, made.features[0].final.claim.segment, limit)
            findings.issues += found
            findings.issues += [] if made.part.features is None else _numbering(made)
        for k, feature in made.own:
            findings.issues += _side(made, feature)
            findings.issues += _level(made, k, feature)
            findings.issues += _between(made.part, feature)
        findings.issues += _order(made)
        if made.part.features is not None or len(made.own) > 1:
            findings.issues += _stands_out(context, made)
    return findings.outcome(mm, "mm", nothing=NO_PART)


def _once(forming: Forming) -> Iterator[Issue]:
    """Whether operations that form some features of a part form those that they name, and no two the same."""
    formed: set[int] = set()
    some = any(made is not None and made.part.features is not None for made, _ in forming.parts)
    for made, _ in forming.parts if some else ():
        if made is None or not made.own:
            continue
        numbers = {feature.number for _, feature in made.own}
        wanted = numbers if made.part.features is None else set(made.part.features)
        if numbers != wanted:
            what = f"features {sorted(numbers)} are formed; wanted of this operation: {sorted(wanted)}"
            yield _issue(what, made.own[0][1])
        if formed & numbers:
            what = f"features {sorted(formed & numbers)} are formed by two operations"
            yield _issue(what, made.own[0][1])
        formed |= numbers


def _stands_out(context: Context, made: PartShapes) -> Iterator[Issue]:
    """Whether the sheet stays, from feature to feature, in the solids of it that bodies keep clear of."""
    sheet = context.problem.stock.sheet
    hulls = [] if sheet is None else [one for one in sheet.formed if one.vertices is not None]
    planes = [ConvexHull(transform(one.pose, corners(one))).equations for one in hulls]
    for k, feature in made.own:
        moved = made.moved[: k + 1].sum(axis=0)
        some = np.abs(moved) > STANDS_OUT
        low = np.column_stack([made.places, made.level + moved])[some]
        points = np.concatenate([low, low + np.array([0.0, 0.0, made.part.thickness])])
        off = np.full(len(points), np.inf)
        for one in planes:
            off = np.minimum(off, (points @ one[:, :3].T + one[:, 3]).max(axis=1))
        if len(off) and float(off.max()) > STANDS_OUT:
            what = (
                f"once {feature.final.claim.segment} is formed the sheet stands out of the solids, of which "
                f"alone bodies keep clear, at ({coordinates(points[int(off.argmax())])}) mm"
            )
            yield _issue(what, feature)


def _tolerance(context: Context, made: PartShapes) -> Iterator[Issue]:
    """Whether the tolerance of a part's mesh is the user's own, or no more than the mesh's vertices are off
    any smooth face."""
    part = made.part
    stated = stated_tolerance(context)
    if stated is not None:
        good, limit = abs(part.mesh_tolerance - stated) <= ROUNDING, stated
    elif part.mesh_tolerance == 0.0:
        return
    else:
        limit = TOLERANCE_FACTOR * tolerance_of(part.vertices, part.faces)
        good = part.mesh_tolerance <= limit
    if not good:
        what = f"the mesh of the part is taken to hold within {mm(part.mesh_tolerance):.3f} mm; "
        what += f"{'stated' if stated is not None else 'its vertices say'}: {mm(limit):.3f} mm"
        yield _issue(what, made.features[0], in_mm(part.mesh_tolerance, limit))


def stated_tolerance(context: Context) -> float | None:
    """The tolerance [m] that the problem states of a sheet part's mesh; None where it is to be found."""
    said = (context.problem.source.get("part") or {}).get("sheet_mesh")
    if said:
        value = said.get("tolerance_mm", "auto")
        return None if value == "auto" else float(value) / 1000.0
    formed = None if context.problem.part is None else context.problem.part.formed
    return None if formed is None else formed.stated


def _whole_of_noisy(made: PartShapes) -> tuple[float, list[Issue]]:
    """How far [m] the vertices of a part with noise are off what all features make, all but one in a hundred,
    and issues: also where the farthest is beyond twice and a half its tolerance, the mean of some place is
    off by more than noise would have it, or many vertices beside one another are off to one side."""
    part, issues = made.part, []
    used, index = np.unique(part.faces, return_inverse=True)
    vertices, own = part.vertices[used], np.asarray(index).reshape(-1, 3)
    places = vertices[:, :2]
    height = made.sheet(np.arange(len(made.features)), places)
    slopes = []
    for axis in np.eye(2) * SLOPE_STEP:
        ahead, behind = (made.sheet(np.arange(len(made.features)), places + s * axis) for s in (1.0, -1.0))
        slopes.append(np.maximum(np.abs(ahead - height), np.abs(behind - height)) / SLOPE_STEP)
    steep = 1.0 / np.sqrt(1.0 + slopes[0] ** 2 + slopes[1] ** 2)
    found = scatter(vertices, height, steep)
    wide = part.mesh_tolerance
    off = np.abs(found.off)
    usual = float(np.quantile(off, WITHIN_SHARE))
    order = np.argsort(off)
    within = int(order[min(int(WITHIN_SHARE * len(off)), len(off) - 1)])
    for value, k, limit, how in (
        (usual, within, FACE_ERROR + wide, "1 % of its vertices by"),
        (float(off.max()), int(order[-1]), FACE_ERROR + FARTHEST_TOLERANCES * wide, "a vertex by"),
    ):
        if value > limit:
            what = f"all passes together leave the sheet off the part, at ({coordinates(vertices[k])}) mm, "
            issues.append(_issue(f"{what}{how} {mm(value):.3f} mm", made.features[0], in_mm(value, limit)))
    allowed = FACE_ERROR + wide * (MEAN_TOLERANCES + MEAN_NOISE_FACTOR / np.sqrt(found.number))
    if len(found.mean) and (np.abs(found.mean) > allowed).any():
        k = int(np.argmax(np.abs(found.mean) - allowed))
        value = abs(float(found.mean[k]))
        what = (
            f"about ({coordinates(found.middle[k])}) mm all passes together leave the sheet "
            f"{mm(value):.3f} mm off the part in the mean, which its noise does not do"
        )
        issues.append(_issue(what, made.features[0], in_mm(value, allowed[k])))
    limit = BESIDE + max(wide, tolerance_of(part.vertices, part.faces))
    group = together(own, found.off, limit)
    if len(group) > GROUP:
        value = float(off[group].max())
        at = coordinates(vertices[group].mean(axis=0))
        what = (
            f"about ({at}) mm {len(group)} vertices beside one another are off what all passes make, by up "
            f"to {mm(value):.3f} mm to one side, which noise does not do"
        )
        issues.append(_issue(what, made.features[0], in_mm(value, limit)))
    return usual, [*issues, *_edge_off(made, FACE_ERROR + wide)]


def _edge_off(made: PartShapes, limit: float) -> Iterator[Issue]:
    """Whether the part's edge is at the flat sheet, within a limit [m]."""
    if abs(made.level) > limit:
        what = f"the part's edge is {mm(abs(made.level)):.3f} mm off the flat sheet"
        yield _issue(what, made.features[0], in_mm(abs(made.level), limit))


def _whole(made: PartShapes) -> tuple[float, list[Issue]]:
    """How far [m] the part is off what all features make, and an issue where that is too much."""
    off = np.abs(made.moved.sum(axis=0) - made.wanted) * made.steep
    k = int(np.argmax(off))
    issues = []
    if off[k] > FACE_ERROR:
        what = f"at ({coordinates(made.places[k])}) mm all passes together leave the sheet "
        what += f"{mm(off[k]):.3f} mm off the part"
        issues.append(_issue(what, made.features[0], in_mm(off[k], FACE_ERROR)))
    return float(off[k]), [*issues, *_edge_off(made, FACE_ERROR)]


def _side(shapes: PartShapes, feature: Feature) -> Iterator[Issue]:
    """Whether the tool on the right side forms a feature, whose wall goes one way, and ends where it says."""
    part = shapes.part
    for shape in feature.shapes:
        for claim in shape.claims:
            arm = claim.arm if isinstance(claim, FormsSheet) else claim.arms[0]
            if (arm, claim.side) not in zip(part.arms, part.sides, strict=True):
                what = f"{arm} is not the tool on the side from which {claim.segment} is formed"
                yield _issue(what, feature)
        sign = float(shape.claim.side if part.male else -shape.claim.side)
        heights = sign * (shape.corners[:, :, 2] - shape.base)
        if heights.min() < -FACE_ERROR:
            what = f"{shape.claim.segment} goes {mm(-heights.min()):.3f} mm toward the tool that forms it"
            yield _issue(what, feature, in_mm(-heights.min(), FACE_ERROR))
        if abs(float(heights.max()) - sign * (shape.far - shape.base)) > FACE_ERROR:
            yield _issue(f"{shape.claim.segment} does not end at the level that is claimed", feature)
        back = shape.turns_back(sign)
        if back is not None:
            at = f"({coordinates(back)}) mm"
            yield _issue(f"the wall of {shape.claim.segment} turns back, or parts, at {at}", feature)


def _level(made: PartShapes, k: int, feature: Feature) -> Iterator[Issue]:
    """Whether the sheet around a feature is at its start when it is formed."""
    places = feature.final.rim
    if not len(places):
        yield _issue(f"{feature.final.claim.segment} begins nowhere on the sheet", feature)
        return
    lower = made.sheet(np.arange(k), places)
    for shape in feature.shapes:
        base = shape.base - (made.part.thickness if shape.claim.side > 0 else 0.0)
        off = float(np.quantile(np.abs(lower - base), RIM_SHARE))
        if off > RIM_HEIGHT:
            what = f"{shape.claim.segment} begins {mm(off):.3f} mm off the sheet as it is then"
            yield _issue(what, feature, in_mm(off, RIM_HEIGHT))


def _order(made: PartShapes) -> Iterator[Issue]:
    """Whether features come in the order that is wanted: the user's own, or what stands inside of what."""
    numbers = [feature.number for feature in made.features]
    if made.part.order is not None:
        own = numbers[made.first :]
        if tuple(own) != made.part.order:
            what = f"features come in the order {own}; wanted: {list(made.part.order)}"
            yield _issue(what, made.own[0][1])
            return
        yield from _numbering(made) if made.part.features is None else ()
        return
    for inner, outer in np.argwhere(made.inside).tolist():
        if min(inner, outer) < made.first:
            continue  # what was formed before is as the problem has it
        first, then = (inner, outer) if made.part.virgin else (outer, inner)
        if first > then:
            what = f"f{numbers[then]} is formed before f{numbers[first]}; wanted: "
            what += "inner features first" if made.part.virgin else "what a feature stands in first"
            yield _issue(what, made.features[then])


def _numbering(made: PartShapes) -> Iterator[Issue]:
    """Whether features have the numbers that users know them by: each before what stands in it, of those that
    stand in the same one the largest first."""
    count = len(made.features)
    parents = []
    for k in range(count):
        around = np.flatnonzero(made.inside[k])
        parents.append(int(around[np.argmin(made.area[around])]) if len(around) else -1)
    order: list[int] = []
    waiting = [-1]
    while waiting:
        one = waiting.pop()
        if one >= 0:
            order.append(one)
        waiting += sorted((k for k in range(count) if parents[k] == one), key=lambda k: float(made.area[k]))
    for number, k in enumerate(order, start=1):
        named = [j for j in range(count) if made.features[j].number == number]
        same = [j for j in named if parents[j] == parents[k] and _near(made.area[j], made.area[k])]
        if k not in named and not same:
            what = f"the feature that is formed as f{made.features[k].number} is number {number} of the part"
            yield _issue(what, made.features[k])


def _near(one: float, other: float) -> bool:
    return abs(one - other) <= SAME_AREA_SHARE * max(one, other)


def _between(part: FormsPart, feature: Feature) -> Iterator[Issue]:
    """Whether the shapes before the final one are as many and as steep as wanted, and only move the sheet
    onward."""
    final = feature.final
    angles = [shape.steepest(WALL_SHARE) for shape in feature.shapes]
    for shape in feature.shapes:
        if len(shape.claims) != part.repeats:
            what = f"{shape.claim.segment} is run {len(shape.claims)} times; wanted: {part.repeats}"
            yield _issue(what, feature, (len(shape.claims), part.repeats, None))
    yield from _angles(part, feature, angles)
    places = final.spread(4000)[:, :2]
    sign = -1.0 if final.far < final.base else 1.0
    before, upright = np.zeros(len(places)), float(np.cos(angles[-1]))
    for shape in feature.shapes:
        depth = sign * shape.shift(places)
        back = float((before - depth).max()) * upright
        if back > FACE_ERROR * 2:
            what = f"{shape.claim.segment} is {mm(back):.3f} mm behind what is formed before"
            yield _issue(what, feature, in_mm(back, 2 * FACE_ERROR))
        before = np.maximum(before, depth)
    for shape, angle in zip(feature.shapes[:-1], angles, strict=False):
        share = _flat_share(shape, final, angle, sign)
        if share > HELD_SHARE:
            what = (
                f"{100 * share:.1f} % of {shape.claim.segment} are neither on the part nor as steep as the "
                f"shape's {np.rad2deg(angle):.1f} deg"
            )
            yield _issue(what, feature, in_percent(share, HELD_SHARE))


def _angles(part: FormsPart, feature: Feature, angles: list[float]) -> Iterator[Issue]:
    if part.mode == "adsif" or part.male:
        if len(angles) != 1:
            what = f"{feature.final.claim.segment} is formed by way of other shapes, which cannot be"
            yield _issue(what, feature)
        return
    if part.passes is not None:
        wanted = [angle for angle in part.passes if angle < angles[-1] - ANGLE_ERROR]
        most = [angle for angle in part.passes if angle < angles[-1] + ANGLE_ERROR]
        good = len(wanted) <= len(angles) - 1 <= len(most)
        good = good and all(
            abs(a - b) <= ANGLE_ERROR for a, b in zip(angles, part.passes, strict=False) if b in wanted
        )
        if not good:
            got = ", ".join(f"{np.rad2deg(a):.1f}" for a in angles)
            what = f"the shapes of f{feature.number} have walls of {got} deg, not those that are wanted"
            yield _issue(what, feature)
        return
    before = part.limit - part.angle_step
    for shape, angle in zip(feature.shapes, angles, strict=True):
        # of the part's last degree no more can be known than how its walls bend
        if angle > max(before + part.angle_step, part.limit) + ANGLE_ERROR:
            what = f"{shape.claim.segment} has a wall of {np.rad2deg(angle):.1f} deg at once"
            yield _issue(what, feature, in_degrees(angle, max(before + part.angle_step, part.limit)))
        before = angle


def _flat_share(shape: Shape, final: Shape, angle: float, sign: float) -> float:
    """Share of a shape's area that is less deep than the final one though it is flatter than ``angle``."""
    corners = shape.corners[shape.moved]
    lean, area = shape.lean
    middle = corners.mean(axis=1)
    behind = sign * (final.shift(middle[:, :2]) - (middle[:, 2] - shape.base))
    flat = (lean < angle - FLATTENED_ANGLE) & (behind > 2e-4)
    return float(area[flat].sum() / max(float(area.sum()), 1e-30))


def _issue(what: str, feature: Feature, measure: Measure | None = None) -> Issue:
    return issue(FORMING_PART, what, measure, field=str(feature.final.claim.segment))
