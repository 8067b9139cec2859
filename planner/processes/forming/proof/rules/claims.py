"""verify.forming_claims: what is claimed of each pass, against the part and the user's numbers.

Gaps, borders, feeds, tolerances, and what tools may meet. The faces themselves are
`forming_part`'s.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import shapely
from scipy.spatial import cKDTree

from planner.claims.claim import Claim
from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray
from planner.geometry.mesh import TriangleMesh, corner_normals
from planner.issues import Issue
from planner.processes.forming.claims import (
    FollowsOpposite,
    FormingFeed,
    FormsByTable,
    FormsPart,
    FormsSheet,
    SheetState,
    SinksHolder,
    SupportsBorder,
    ToolGap,
)
from planner.processes.forming.proof import accumulative
from planner.processes.forming.proof.face import CREASE_ANGLE
from planner.processes.forming.proof.shapes import FLAT_NOISE, Feature, PartShapes, Shape, spread_over
from planner.processes.forming.proof.state import FORMING
from planner.proof.context import Context
from planner.proof.findings import Findings, coordinates, in_percent, percent
from planner.proof.rule import Measure, Outcome, issue, mm, rule

FORMING_CLAIMS = "verify.forming_claims"
"""Code of this rule."""
NO_PART = "no part is to be formed"
"""Why it has not run."""
ROUNDING = 1e-9
"""Lengths [m], angles [rad] and shares that differ by less are the same."""
TABLE_ERROR = 1e-6
"""The same [m] for what follows from the response table, which is asked at angles that are so close."""
GAP, LATER = 0.01, 0.02
"""Shares of the flat sheet's thickness by which a wanted gap may be off what follows from the walls, and
where shapes came before, whose walls are faceted in another way."""
GAP_SHARE, GAP_MOST = 0.15, 0.15
"""Share of the walls where it may be more, along creases of such shapes, and by how much of the thickness."""
EDGE_BAND = 6e-4
"""Where a shape is as deep as a later pass within this [m] its own wall may begin or end: shapes are known by
contours, which walls leave tangentially."""
BORDER_ERROR = 3e-4
"""How far [m] the way of a support may be off the border, offset by its radius: the outline is faceted."""
MOST_OFF_BORDER = 5e-4
"""The most [m] that a claim may allow a support to be off its border."""
MOST_HEAT_ASIDE = 2e-3
"""The most [m] that a claim may allow a source of heat to be off its place."""
MOST_LINE_TURN = np.deg2rad(4.0)
"""The most [rad] that a claim may allow the line of two tools to be off its normal."""
LEAST_PULSE = 0.1
"""A pulse is on for so long [s] at least."""
RIDGE, BENT = 1.1, 10.0
"""The ridges that a claim allows are higher by these factors at most than those between ways that are a
step apart: on the flattest wall, and on the average over walls, for they bend within a step."""
FLATTEST_WALL = np.deg2rad(2.0)
"""Walls flatter than this [rad] count as flat."""
STATE_SPACING = 5e-3
"""Places of the sheet have one of which tools are told within this [m]."""
TOOL_REACH = 0.09
"""Places farther [m] from a feature in plan are out of any tool's reach."""
RIM_WIDTH = 0.03
"""How far [m] about a feature tools are told of what is formed already, and of the flat sheet."""
_PART_PLACES = 8_000
"""Places of the part that are asked for the sheet's state."""


@rule("verify.forming_claims", FormsPart)
def forming_claims(context: Context) -> Outcome:
    """What is claimed of each pass follows from the part and the user's numbers: tools, gaps by the sine law,
    borders, feeds, tolerances, ridges, steps of a clamp, and all of the sheet that tools may meet."""
    forming, findings = context.get(FORMING), Findings(FORMING_CLAIMS, context)
    for made, group in forming.parts:
        if made is None or not made.own:
            continue
        findings.issues += _numbers(made.part, group)
        nowhere = [feature for _, feature in made.own if not len(feature.final.rim)]
        if nowhere:  # nothing can be said of what is about it
            segment = nowhere[0].final.claim.segment
            findings.issues.append(_issue(f"{segment} begins nowhere on the sheet", segment))
            continue
        for claim in group:
            if isinstance(claim, ToolGap):
                off, found = _gap(made, claim)
                findings.issues += found
                findings.highest(off, claim.segment)
        findings.issues += _all_there(made.part, made, group)
        findings.issues += _states(made, group)
    if not forming.parts:
        return findings.outcome_without_value(NO_PART)
    if not np.isfinite(findings.worst):
        return findings.outcome_without_value()
    return findings.outcome(percent, "% of the thickness", GAP)


def _issue(what: str, segment: Segment, measure: Measure | None = None) -> Issue:
    return issue(FORMING_CLAIMS, what, measure, field=str(segment))


_PASS_CLAIMS = (
    FormsSheet,
    FormsByTable,
    ToolGap,
    FormingFeed,
    SheetState,
    SinksHolder,
    SupportsBorder,
    FollowsOpposite,
)
"""Kinds of claims of passes."""


def _numbers(part: FormsPart, group: Sequence[Claim]) -> Iterator[Issue]:
    radius = dict(zip(part.arms, part.radii, strict=True))
    ridge = _ridge(part)
    for claim in group:
        if not isinstance(claim, _PASS_CLAIMS):
            continue
        wrong: list[str] = []
        if isinstance(claim, FormsSheet):
            wrong = _differ(claim, radius=radius.get(claim.arm), tolerance=part.gouge, share=part.share)
            wrong += [] if _ridges(part, claim, ridge) else ["scallop"]
        elif isinstance(claim, FormsByTable):
            radii = tuple(radius.get(arm) for arm in claim.arms)
            wrong = _differ(claim, radii=radii, thickness=part.thickness, tolerance=part.gap)
        elif isinstance(claim, ToolGap):
            radii = tuple(radius.get(arm) for arm in claim.arms)
            wrong = _differ(claim, radii=radii, tolerance=part.gap, handshake=part.handshake)
            wrong += ["turn"] if claim.turn > MOST_LINE_TURN + ROUNDING else []
        elif isinstance(claim, FormingFeed):
            wrong = _differ(claim, upper=part.feed, arms=part.arms)
        elif isinstance(claim, SheetState):
            allowed = part.gouge + part.pressed
            wrong = ["tolerance"] if claim.tolerance > allowed + ROUNDING else []
            allowed = part.gouge + max(part.pressed, _pressed_by_table(claim, group))
            wrong += ["other"] if claim.other > allowed + TABLE_ERROR else []
        elif isinstance(claim, SinksHolder):
            signal, step = part.sinking or ("", 0.0)
            wrong = _differ(claim, signal=signal, step=step, radius=radius.get(claim.arm))
            wrong += ["pulse"] if claim.pulse < LEAST_PULSE - ROUNDING else []
        for name in wrong:
            what = f"{claim.segment}: {name} of {type(claim).__name__} is not what the problem states"
            yield _issue(what, claim.segment)


def _pressed_by_table(state: SheetState, group: Sequence[Claim]) -> float:
    """How far [m] the second tool presses the flat sheet at most where the response table wants it for any
    wall: both stay at the sheet's level while it is formed, so that is how it was formed when the table was
    made."""
    deep = 0.0
    for claim in group:
        if isinstance(claim, FormsByTable) and claim.segment == state.segment:
            table = accumulative.wanted_conditions(claim.table, claim.prefer)
            down = table.apart(claim.thickness, sum(claim.radii), claim.give)[:, 1]
            deep = max(deep, claim.thickness - claim.projection + sum(claim.radii) - float(down.min()))
    return deep


def _differ(claim: Any, **wanted: Any) -> list[str]:
    out = []
    for name, value in wanted.items():
        got = getattr(claim, name)
        if isinstance(value, float) or (isinstance(value, tuple) and isinstance(value[0], float)):
            if not np.allclose(np.asarray(got, dtype=np.float64), value, rtol=0.0, atol=ROUNDING):
                out.append(name)
        elif got != value:
            out.append(name)
    return out


def _ridge(part: FormsPart) -> Callable[[FloatArray, float], FloatArray]:
    """The ridges (F,) [m] that the steps leave on walls of angles (F,) [rad], of a ball of a radius [m]."""
    step, scallop = part.steps

    def height(angle: FloatArray, radius: float) -> FloatArray:
        if scallop is not None:
            return np.full(len(angle), scallop)
        half = np.minimum(0.5 * (step or 0.0) / np.sin(angle), radius)
        return np.asarray(radius - np.sqrt(radius**2 - half**2))

    return height


def _ridges(part: FormsPart, claim: FormsSheet, ridge: Callable[[FloatArray, float], FloatArray]) -> bool:
    corners = claim.vertices[claim.faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(cross, axis=1)
    angle = np.arccos(np.clip(cross[:, 2] / np.maximum(size, 1e-300), -1.0, 1.0))
    walls = np.flatnonzero((angle > FLATTEST_WALL) & (size > 1e-16))
    if not len(walls):
        return False
    angle, size = angle[walls], size[walls]
    order = np.argsort(angle)
    passed = np.cumsum(size[order]) / size.sum()
    least = float(angle[order[int(np.searchsorted(passed, 0.5 * (1.0 - part.share)))]])
    high = ridge(np.maximum(angle, max(least, FLATTEST_WALL)), claim.radius)
    allowed = claim.scallop[walls] - part.gouge
    most = ridge(np.array([max(least, FLATTEST_WALL)]), claim.radius)[0]
    average = (allowed * size).sum() <= BENT * (high * size).sum() + ROUNDING * size.sum()
    return bool(average and allowed.max() <= RIDGE * most + ROUNDING)


def _gap(made: PartShapes, claim: ToolGap) -> tuple[float, list[Issue]]:
    """How far a claimed gap is off what follows from the walls of its pass and of those before, as a share of
    the flat sheet's thickness, but for `GAP_SHARE` of the face."""
    part = made.part
    shapes, mine = _shapes_to(made, claim.segment)
    if mine is None:
        what = f"the gap of {claim.segment} is that of no pass"
        return np.inf, [_issue(what, claim.segment)]
    corners = claim.vertices[claim.faces]
    same = np.abs(corners - mine.corners).max() < ROUNDING if len(corners) == len(mine.corners) else False
    if not same:
        what = f"the gap of {claim.segment} is that of another face"
        return np.inf, [_issue(what, claim.segment)]
    smooth = _up(mine)
    low = high = smooth
    plan = corners.reshape(-1, 3)[:, :2]
    for shape in shapes[:-1]:  # a sheet that was thinned stays so
        least, top = _up_at(shape, plan)
        near = np.abs(mine.shift(plan) - shape.shift(plan)) < EDGE_BAND
        least = np.where(near, np.minimum(least, np.cos(shape.steepest(0.995)) - ROUNDING), least)
        top = np.where(near, 1.0, top)
        low = np.minimum(low, least.reshape(-1, 3))
        high = np.minimum(high, top.reshape(-1, 3))
    full = part.squeeze * part.thickness
    got = claim.gap[claim.faces]
    off = np.maximum(np.maximum(low * full - got, got - high * full), 0.0).max(axis=1) / part.thickness
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    floor = (np.abs(corners[:, :, 2] - mine.far) < LEVEL_ERROR).all(axis=1)  # which is not formed
    area = np.where(mine.moved & ~floor, np.linalg.norm(cross, axis=1), 0.0)
    order = np.argsort(-off)
    passed = np.cumsum(area[order])
    spared = GAP_SHARE if len(shapes) > 1 else 0.0
    worst = float(off[order[int(np.searchsorted(passed, spared * passed[-1] + 1e-15))]])
    allowed = LATER if len(shapes) > 1 else GAP
    most = float(off[area > 0.0].max(initial=0.0))
    if worst <= allowed and most <= max(GAP, GAP_MOST * (len(shapes) > 1)):
        return worst - allowed + GAP, []
    worst = max(worst, most)
    what = (
        f"the gap of {claim.segment} is {100 * worst:.2f} % of the sheet's thickness off squeeze * t0 cos(a)"
    )
    return worst, [_issue(what, claim.segment, in_percent(worst, allowed))]


def _shapes_to(made: PartShapes, segment: Segment) -> tuple[tuple[Shape, ...], Shape | None]:
    """The shapes of a feature up to that of a segment, and this itself."""
    for feature in made.features:
        for k, shape in enumerate(feature.shapes):
            if any(claim.segment == segment for claim in shape.claims):
                return feature.shapes[: k + 1], shape
    return (), None


def _up(shape: Shape) -> FloatArray:
    """The cosine (T, 3) of the wall's angle at the corners of a face, smooth but over creases."""
    claim = shape.claim
    normal = corner_normals(TriangleMesh(claim.vertices, claim.faces), CREASE_ANGLE)
    return np.clip(normal[:, :, 2], 0.0, 1.0)


def _up_at(shape: Shape, places: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least and largest cosine (N,) of the wall's angle at places in plan (N, 2); 1 off what it moves."""
    corner = _up(shape)[shape.moved]
    row, triangle, share = shape.over.at(places, _PLAN_ERROR)
    value = (share * corner[triangle]).sum(axis=1)
    least, most = np.ones(len(places)), np.zeros(len(places))
    np.minimum.at(least, row, value)
    np.maximum.at(most, row, value)
    most[np.setdiff1d(np.arange(len(places)), row)] = 1.0
    return least, most


_PLAN_ERROR = 1e-4
"""Places this near [m] to a shape in plan are on it."""


def _all_there(part: FormsPart, made: PartShapes, group: Sequence[Claim]) -> Iterator[Issue]:
    """Whether each pass has all the claims that its mode wants, and those of its border, its heat, its
    clamp."""
    wanted: dict[type, bool] = {
        FormingFeed: True,
        SheetState: True,
        ToolGap: part.mode in ("dsif", "dpif_l"),
        SupportsBorder: part.mode == "dpif_p",
        FollowsOpposite: part.mode == "heat",
        FormsByTable: part.mode == "adsif",
        FormsSheet: part.mode != "adsif",
    }
    for _, feature in made.own:
        for shape in feature.shapes:
            for one in shape.claims:
                for kind, needed in wanted.items():
                    own = (c for c in group if isinstance(c, _PASS_CLAIMS) and c.segment == one.segment)
                    found = [c for c in own if type(c) is kind]
                    if len(found) != int(needed):
                        what = f"{one.segment} has {len(found)} claims {kind.__name__}; wanted: {int(needed)}"
                        yield _issue(what, one.segment)
        for claim in group:
            if isinstance(claim, SupportsBorder) and _is_of(feature, claim.segment):
                yield from _border(part, feature, claim)
            if isinstance(claim, FollowsOpposite) and _is_of(feature, claim.segment):
                yield from _opposite(part, feature, claim)
            if isinstance(claim, SinksHolder) and _is_of(feature, claim.segment):
                one = feature.shapes[0].claim
                if _differ(claim, start=one.start, end=one.end, side=one.side):
                    yield _issue(f"{claim.segment}: the clamp sinks between other levels", claim.segment)
    if part.sinking is not None and not any(isinstance(c, SinksHolder) for c in group):
        yield Issue(FORMING_CLAIMS, "nothing says how the clamp sinks", field="die")


def _is_of(feature: Feature, segment: Segment) -> bool:
    return any(claim.segment == segment for shape in feature.shapes for claim in shape.claims)


def _border(part: FormsPart, feature: Feature, claim: SupportsBorder) -> Iterator[Issue]:
    """Whether the way of a support is its radius outside of what a feature moves, behind the flat sheet."""
    final = feature.final
    side = final.claim.side
    (arm,) = (k for k, held in enumerate(part.sides) if held != side)
    radius, ball = part.radii[arm], part.kinds[arm] == "ball"
    level = final.base - side * (part.thickness + (radius if ball else 0.0))
    far = _away(final.corners[final.moved], claim.border) - radius
    near = _away(final.corners[final.raised], claim.border) - radius  # the rest may be noise of the flat
    off = np.maximum(far, -near)
    around = shapely.contains_xy(shapely.Polygon(claim.border[:, :2]), final.rim[:, 0], final.rim[:, 1])
    # from outside the wall's foot is as far everywhere; chords of the outline and the border come on top
    back = np.asarray(cKDTree(claim.border[:, :2]).query(final.rim)[0])
    wrong = []
    if off.max() > BORDER_ERROR:
        wrong.append(f"{mm(float(off.max())):.3f} mm off the border and its radius")
    if np.abs(claim.border[:, 2] - level).max() > LEVEL_ERROR:
        wrong.append(f"{mm(float(np.abs(claim.border[:, 2] - level).max())):.3f} mm off the flat sheet")
    if not around.all() or not len(back):
        wrong.append("not around all of the feature")
    if claim.arm != part.arms[arm] or claim.tolerance > MOST_OFF_BORDER + ROUNDING:
        wrong.append("of another tool or tolerance")
    for what in wrong:
        yield _issue(f"the way of the support about {claim.segment} is {what}", claim.segment)


LEVEL_ERROR = 1e-5
"""Heights [m] that differ by less are one level."""


def _away(corners: FloatArray, ring: FloatArray) -> FloatArray:
    """How far (K,) [m] points of a ring (K, 3) are from triangles (T, 3, 3), in plan."""
    tree = shapely.STRtree(shapely.polygons(corners[:, [0, 1, 2, 0], :2]))
    points = shapely.points(ring[:, :2])
    return np.asarray(tree.query_nearest(points, return_distance=True, all_matches=False)[1])


def _opposite(part: FormsPart, feature: Feature, claim: FollowsOpposite) -> Iterator[Issue]:
    """Whether a source of heat is wanted at the far face of the sheet that it heats."""
    up = min(float(np.cos(shape.steepest(1.0))) for shape in feature.shapes)
    radius = dict(zip(part.arms, part.radii, strict=True)).get(claim.arms[0], np.nan)
    thin, thick = radius + part.thickness * up, radius + part.thickness
    own = [s for s in feature.shapes if any(c.segment == claim.segment for c in s.claims)]
    same = len(claim.faces) == len(own[0].claim.faces) and np.array_equal(
        claim.vertices[claim.faces], own[0].corners
    )
    good = (
        thin - ROUNDING <= claim.distance <= thick + ROUNDING
        and claim.tolerance <= MOST_HEAT_ASIDE + ROUNDING
    )
    if not (good and same and claim.side == own[0].claim.side):
        yield _issue(f"the source of heat for {claim.segment} is not at the sheet", claim.segment)


def _states(made: PartShapes, group: Sequence[Claim]) -> Iterator[Issue]:
    """Whether tools are told of all that is formed already and of the flat sheet around."""
    part = made.part
    told = {claim.segment: claim for claim in group if isinstance(claim, SheetState)}
    points = spread_over(part.vertices[part.faces], _PART_PLACES)[0]
    points = np.concatenate([points[:, :2], *(f.final.spread(2_000)[:, :2] for f in made.features)])
    moved = np.array([feature.final.shift(points) for feature in made.features])
    for k, feature in made.own:
        if part.male:
            continue  # the flat that sinks is all that there is besides the one feature
        low, high = feature.final.rim.min(axis=0) - TOOL_REACH, feature.final.rim.max(axis=0) + TOOL_REACH
        near = ((points >= low) & (points <= high)).all(axis=1)
        by = near & (np.abs(moved[:k]) > 1e-4)
        formed, carried = by.any(axis=0), by[made.inside[:k, k]].any(axis=0)
        height = made.level + moved[:k].sum(axis=0)
        within = np.abs(moved[k]) > FLAT_NOISE
        for number, shape in enumerate(feature.shapes):
            sunk = 0.0 if number == 0 else feature.shapes[number - 1].far - shape.base
            for claim in shape.claims:
                state = told.get(claim.segment)
                if state is None:
                    continue
                first = claim is feature.shapes[0].claims[0]
                down = 0.0 if first else (sunk if claim is shape.claims[0] else shape.far - shape.base)
                flat = _flat_about(made, k, feature)
                yield from _told(state, made, points, height, formed & ~within, carried & within, down, flat)


def _flat_about(made: PartShapes, k: int, feature: Feature) -> FloatArray:
    """Places (N, 3) of the flat sheet about a feature that starts there, off what is formed already."""
    if made.inside[k, :k].any():
        return np.zeros((0, 3))
    rim = feature.final.rim
    low, high = rim.min(axis=0) - RIM_WIDTH, rim.max(axis=0) + RIM_WIDTH
    count = 40
    x, y = np.meshgrid(*(np.linspace(a, b, count) for a, b in zip(low, high, strict=True)))
    grid = np.column_stack([x.ravel(), y.ravel()])
    away = np.asarray(cKDTree(rim).query(grid)[0])
    lying = np.abs(feature.final.shift(grid)) <= FLAT_NOISE
    for other in made.features[:k]:
        lying &= np.abs(other.final.shift(grid)) <= FLAT_NOISE
        lying &= np.asarray(cKDTree(other.final.rim).query(grid)[0]) > STATE_SPACING
    grid = grid[lying & (away < RIM_WIDTH - STATE_SPACING) & (away > STATE_SPACING)]
    return np.column_stack([grid, np.full(len(grid), made.level)])


def _told(
    state: SheetState,
    made: PartShapes,
    points: FloatArray,
    height: FloatArray,
    beside: BoolArray,
    carried: BoolArray,
    sunk: float,
    flat: FloatArray,
) -> Iterator[Issue]:
    """Whether a state has points near all places of what is formed already."""
    rise = np.array([0.0, 0.0, made.part.thickness])
    places = np.column_stack([points, height])
    still = [places[beside], flat]
    inner = places[carried]
    if sunk != 0.0:  # an earlier pass has taken it down already
        still.append(inner + np.array([0.0, 0.0, sunk]))
        inner = inner[:0]
    for kind, wanted, got in (
        ("stands still", np.concatenate(still), state.fixed),
        ("sinks", inner, state.carried),
    ):
        both = np.concatenate([wanted, wanted + rise])
        if not len(both):
            continue
        far = np.full(len(both), np.inf) if not len(got) else np.asarray(cKDTree(got).query(both)[0])
        k = int(np.argmax(far))
        if far[k] > STATE_SPACING:
            at = f"({coordinates(both[k])}) mm"
            what = f"in {state.segment} nothing tells tools of the sheet at {at}, which {kind}"
            yield _issue(what, state.segment)
