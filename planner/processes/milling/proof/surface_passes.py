"""How a cutter passes a ruled surface with its flank, and a face with its end.

With its flank, it is held against the guides alone: how far its axis is off both, how deep its tip
is, that it passes all of them in the wanted direction, and where it comes from. With its end: how
far it is off the face, whether it goes beyond its edge, and how it leans.

A face is seen from above: the place over any x and y, and the smooth normal there. The planner has
code of its own for this; here triangles are found by a tree of their outlines, and planes are
solved for heights.
"""

import dataclasses

import numpy as np
import shapely

from planner.geometry.arrays import BoolArray, FloatArray
from planner.processes.milling.claims import MillsFlank, MillsOver
from planner.proof.part_files.plan_face import Laid
from planner.tooling import Cutter

SAMPLES_TOGETHER = 400
"""Samples that are held against all rulings at once."""
END_LENGTH = 0.5e-3
"""Way [m] at the end of a pass that says in which direction it goes on."""
WAY_ASIDE_SHARE = 0.05
"""How far a way in or out may leave the direction in which the surface ends, over its length."""
WAY_TURN = np.deg2rad(10.0)
"""How far a tool turns on along a way in or out at most [rad]."""
WAY_LENGTH_FACTOR = 1.25
"""How much longer than stated a way in or out may be: the ends of a tool that turns go different ways."""
_LEAST_LENGTH = 1e-12
"""Lengths [m] are divided by no less than this."""


@dataclasses.dataclass(frozen=True)
class Passed:
    """Of T samples of a pass: what they are ``off`` (T,), by what is asked: 1 is as far as allowed; ``worst``
    says of what. ``faults`` hold for the pass as a whole."""

    off: FloatArray
    worst: tuple[str, ...]
    faults: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class Way:
    """Of T samples of a way in or out: what they are ``off`` (T,), as in :class:`Passed`; ``up``: on the
    straight way along the tool's axis; ``aside``: on the going on of the surface. ``faults`` hold for all."""

    off: FloatArray
    up: BoolArray
    aside: BoolArray
    faults: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class _Near:
    """Where T axes are nearest to a guide: the ``place`` (T, 3) there and its ``number`` along the guide (T,)
    with fractions; ``away`` (T, 3) [m] from there to the axis, square to it; ``height`` (T,) [m] of the place
    along the axis, from the tip."""

    place: FloatArray
    number: FloatArray
    away: FloatArray
    height: FloatArray


def lift(claim: MillsFlank, number: int) -> float:
    """How far [m] the tip of a pass is above where that of the last one is."""
    rough = len(claim.segments) - 1
    return _deep(claim) * (1.0 - (number + 1) / rough) if number < rough else 0.0


def _deep(claim: MillsFlank) -> float:
    return float(np.linalg.norm(claim.high - claim.low, axis=1).max()) + claim.beyond


def passed(claim: MillsFlank, number: int, tip: FloatArray, axis: FloatArray) -> Passed:
    """How the samples ``tip``, ``axis`` (T, 3) of a pass keep to the surface."""
    low, high = _ring(claim, claim.low), _ring(claim, claim.high)
    rough = number < len(claim.segments) - 1
    stand = claim.stand + (claim.leave if rough else 0.0)
    depth = claim.beyond - lift(claim, number)
    tall = np.linalg.norm(high - low, axis=1)
    # an axis that leads on one guide is longer than the ruling by so much, which roughing shares out
    longer = float(np.hypot(tall.max(), stand) - tall.max()) if rough else 0.0
    below = _nearest(low, np.full(len(low), depth), tip, axis)
    above = _nearest(high, depth + tall, tip, axis)
    off = {
        "off the guide at its tip": np.abs(np.linalg.norm(below.away, axis=1) - stand) / claim.tolerance,
        "off the other guide": np.abs(np.linalg.norm(above.away, axis=1) - stand) / claim.tolerance,
        "too deep or too high": np.abs(below.height - depth) / (claim.tolerance + longer),
        "ahead on one guide": _ahead(low, high, below, above) / (stand + claim.tolerance),
    }
    if stand > claim.tolerance:
        off["on the other side of the surface"] = np.maximum(
            _inside(claim, low, high, below), _inside(claim, low, high, above)
        )
    table = np.stack(list(off.values()))
    names = tuple(off)
    faults = [*_order(claim, low, high, below, above, axis), *_steps(claim)]
    return Passed(table.max(axis=0), tuple(names[k] for k in table.argmax(axis=0).tolist()), tuple(faults))


def _ring(claim: MillsFlank, guide: FloatArray) -> FloatArray:
    return np.concatenate([guide, guide[:1]]) if claim.closed else guide


def _nearest(guide: FloatArray, wanted: FloatArray, tip: FloatArray, axis: FloatArray) -> _Near:
    """Where axes (T, 3) through tips (T, 3) are nearest to a guide (M, 3), by the distance square to the axis
    and by how much higher the place is along it than ``wanted`` (M,)."""
    number, share = np.empty(len(tip), dtype=np.int64), np.empty(len(tip))
    for first in range(0, len(tip), SAMPLES_TOGETHER):
        rows = slice(first, first + SAMPLES_TOGETHER)
        rest = guide[None] - tip[rows, None]
        height = np.einsum("tmk,tk->tm", rest, axis[rows])
        flat = rest - height[..., None] * axis[rows, None]
        step = np.diff(flat, axis=1)
        square = np.maximum(np.einsum("tmk,tmk->tm", step, step), _LEAST_LENGTH**2)
        part = np.clip(-np.einsum("tmk,tmk->tm", flat[:, :-1], step) / square, 0.0, 1.0)
        there = flat[:, :-1] + part[..., None] * step
        over = (height - wanted)[:, :-1] + part * np.diff(height - wanted, axis=1)
        cost = np.einsum("tmk,tmk->tm", there, there) + over**2
        best = cost.argmin(axis=1)
        number[rows] = best
        share[rows] = part[np.arange(len(best)), best]
    place = guide[number] + share[:, None] * (guide[number + 1] - guide[number])
    rest = tip - place
    along = (rest * axis).sum(axis=1)
    return _Near(place, number + share, rest - along[:, None] * axis, -along)


def _ahead(low: FloatArray, high: FloatArray, below: _Near, above: _Near) -> FloatArray:
    """How far (T,) [m] the two nearest places are from being on one ruling, by the guide that tells less."""
    one = np.linalg.norm(_at(high, below.number) - above.place, axis=1)
    other = np.linalg.norm(_at(low, above.number) - below.place, axis=1)
    return np.asarray(np.minimum(one, other))


def _at(guide: FloatArray, number: FloatArray) -> FloatArray:
    first = np.clip(number.astype(np.int64), 0, len(guide) - 2)
    share = (number - first)[:, None]
    return np.asarray((1.0 - share) * guide[first] + share * guide[first + 1])


def _inside(claim: MillsFlank, low: FloatArray, high: FloatArray, near: _Near) -> FloatArray:
    """Above 1 (T,) where the axis is on the inner side of the surface; at a corner the side of either of its
    surfaces will do."""
    normal = _normals(claim, low, high)
    at = np.stack([np.floor(near.number - 1e-6), np.floor(near.number + 1e-6)], axis=1).astype(np.int64)
    at = at % len(normal) if claim.closed else np.clip(at, 0, len(normal) - 1)
    side = np.einsum("tkd,td->tk", normal[at], near.away).max(axis=1)
    return np.where(side > 0.0, 0.0, 2.0)


def _normals(claim: MillsFlank, low: FloatArray, high: FloatArray) -> FloatArray:
    """Normals (M - 1, 3), not of length 1, from the surface to the side of the cutter, between rulings."""
    along = np.diff(low, axis=0) + np.diff(high, axis=0)
    ruling = (high - low)[:-1] + (high - low)[1:]
    return np.asarray(claim.out * np.cross(along, ruling))


def _order(
    claim: MillsFlank, low: FloatArray, high: FloatArray, below: _Near, above: _Near, axis: FloatArray
) -> list[str]:
    """What is wrong with the way along the guides: all of them, once, in the wanted direction."""
    lengths = [np.append(0.0, np.cumsum(np.linalg.norm(np.diff(own, axis=0), axis=1))) for own in (low, high)]
    longer = int(lengths[1][-1] > lengths[0][-1])
    own, near = lengths[longer], (below, above)[longer]
    along = np.interp(near.number, np.arange(len(own)), own)
    step = np.diff(along)
    if claim.closed:
        step = (step + 0.5 * own[-1]) % own[-1] - 0.5 * own[-1]
    total = float(step.sum())
    slack = 4.0 * claim.tolerance
    out = []
    if abs(total) < float(own[-1]) - slack:
        out.append(f"it passes {1e3 * abs(total):.1f} of {1e3 * float(own[-1]):.1f} mm of the surface")
    if len(step) and float((np.sign(total) * step).min()) < -slack:
        out.append("it goes back on its way")
    way = float(np.sign(total))
    tangent = low[1] - low[0] + high[1] - high[0]
    left = float(np.cross(axis[0], tangent) @ _normals(claim, low, high)[0])
    wanted = {"along": 1.0, "against": -1.0, "climb": np.sign(left), "conventional": -np.sign(left)}
    if way * wanted[claim.direction] < 0.0:
        out.append(f"it goes the other way than {claim.direction}")
    return out


def _steps(claim: MillsFlank) -> list[str]:
    """What is wrong with the depth of roughing passes."""
    rough = len(claim.segments) - 1
    if claim.stepdown is None:
        return ["it is roughed, which nobody asks for"] if rough else []
    step = _deep(claim) / max(rough, 1)
    if rough and step <= claim.stepdown + claim.tolerance:
        return []
    return [f"{rough} roughing passes are {1e3 * step:.1f} mm deep each; allowed: {1e3 * claim.stepdown:g}"]


def ways(
    claim: MillsFlank, number: int, end: tuple[FloatArray, FloatArray], tip: FloatArray, axis: FloatArray
) -> Way:
    """How the samples ``tip``, ``axis`` (T, 3) of a way in or out, in the order away from the pass, keep to
    what is asked. ``end``: tips and axes (2, 3) at the end of the pass and a little before it."""
    depth = claim.beyond - lift(claim, number)
    tall = float(np.linalg.norm(claim.high - claim.low, axis=1).mean())
    base, top = (end[0] + h * end[1] for h in (depth, depth + tall))
    low, high = base[0] - base[1], top[0] - top[1]
    size = max(float(np.linalg.norm(low)), float(np.linalg.norm(high)), _LEAST_LENGTH)
    straight, first = 0.5 * (low + high) / size, low / size
    gone = tip + depth * axis - base[0]
    far = np.linalg.norm(gone, axis=1)
    apart = np.minimum.reduce(
        [_from_ray(gone, straight), _from_ray(gone, first), _wedge(gone, straight, first)]
    )
    allowed = claim.tolerance + WAY_ASIDE_SHARE * far
    leans = _angle(axis, end[1][:1])
    aside = (apart <= allowed) & (leans <= WAY_TURN + claim.turn)
    # the last sample of a first stretch that goes on as the surface does is where the tool is drawn back
    leaves = int(np.argmin(aside)) if not aside.all() else len(aside)
    rows = np.arange(max(leaves, 1))
    outer = min(int(rows[np.argmax(far[rows])]), _drawn_back(tip, axis, claim))
    rise = ((tip - tip[outer]) * axis[outer]).sum(axis=1)
    beside = np.linalg.norm(tip - tip[outer] - rise[:, None] * axis[outer], axis=1)
    turned = _angle(axis, axis[outer : outer + 1])
    line = np.maximum(beside / (2.0 * claim.tolerance), turned / claim.turn)
    line = np.where(rise < -2.0 * claim.tolerance, np.maximum(line, 2.0), line)
    lead = np.maximum(apart / allowed, leans / (WAY_TURN + claim.turn))
    lead = np.where(far > far[outer] + claim.tolerance, np.maximum(lead, 2.0), lead)
    faults = []
    if claim.lead is not None and far[outer] > WAY_LENGTH_FACTOR * claim.lead + 2.0 * claim.tolerance:
        faults.append(f"its way goes on for {1e3 * far[outer]:.1f} mm; wanted: {1e3 * claim.lead:g}")
    if claim.safe.up * (float(tip[-1, claim.safe.across]) - claim.safe.level) < -claim.tolerance:
        faults.append("its way does not come from the safe plane, or go to it")
    return Way(np.minimum(line, lead), line <= 1.0, lead <= 1.0, tuple(faults))


def _drawn_back(tip: FloatArray, axis: FloatArray, claim: MillsFlank) -> int:
    """From which sample on, in the order away from the pass, the tool is on the straight along its last axis:
    where its way aside is long, the first millimetres of that are still beside it within what is allowed."""
    rise = ((tip - tip[-1]) * axis[-1]).sum(axis=1)
    beside = np.linalg.norm(tip - tip[-1] - rise[:, None] * axis[-1], axis=1)
    off = (beside > 0.5 * claim.tolerance) | (_angle(axis, axis[-1:]) > 0.5 * claim.turn)
    return int(np.flatnonzero(off)[-1]) + 1 if off.any() else 0


def _from_ray(gone: FloatArray, way: FloatArray) -> FloatArray:
    """Distance (T,) of places (T, 3) from the ray along a way (3,)."""
    share = np.maximum(gone @ way / max(float(way @ way), _LEAST_LENGTH), 0.0)
    return np.asarray(np.linalg.norm(gone - share[:, None] * way, axis=1))


def _wedge(gone: FloatArray, one: FloatArray, two: FloatArray) -> FloatArray:
    """Distance (T,) of places (T, 3) from the plane of two ways (3,), where they are between them."""
    normal = np.cross(one, two)
    size = float(np.linalg.norm(normal))
    if size < 1e-9:
        return np.full(len(gone), np.inf)
    share = np.linalg.lstsq(np.stack([one, two], axis=1), gone.T, rcond=None)[0]
    return np.where((share >= 0.0).all(axis=0), np.abs(gone @ normal) / size, np.inf)


def _angle(axis: FloatArray, other: FloatArray) -> FloatArray:
    """Angles (T,) [rad] between axes; by the chord, which is exact for small ones."""
    chord = np.linalg.norm(axis - other, axis=1)
    return np.asarray(2.0 * np.arcsin(np.clip(0.5 * chord, 0.0, 1.0)))


CONTACT_ROUNDS = 4
"""Times that the contact is looked for anew, with the normal of the place that was found."""
NORMAL_RADIUS = 1.5e-3
"""Normals of places so far [m] around count, too: over a crease the tool turns from the one to the other."""
UPRIGHT_SINE = 1e-3
"""A flat end whose axis leans off the normal by less than this (sine) touches with its middle."""


def within(corners: FloatArray, margin: float) -> shapely.Geometry:
    """What triangles (F, 3, 3) cover in plan [m], without the strip ``margin`` [m] wide along its edge."""
    flat = corners[..., :2]
    one, two = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    upright = one[:, 0] * two[:, 1] == one[:, 1] * two[:, 0]
    whole = shapely.union_all(shapely.polygons(flat[~upright]))
    return shapely.buffer(whole, -margin, join_style="mitre") if margin else whole


class OverFace:
    """A face that is milled with the end of a cutter."""

    def __init__(self, claim: MillsOver) -> None:
        self._claim = claim
        self._face = Laid(claim.vertices, claim.faces)
        self._area = within(self._face.corners, claim.margin)
        shapely.prepare(self._area)

    def off(self, tip: FloatArray, axis: FloatArray) -> dict[str, FloatArray]:
        """How far (T,) the samples ``tip``, ``axis`` (T, 3) are off, by what is asked: 1 is allowed."""
        claim = self._claim
        beyond, gap, normal = self._touching(tip, axis)
        if claim.upright:
            lean = _angle(axis, np.array([0.0, 0.0, 1.0]))
        else:
            steps = NORMAL_RADIUS * np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
            around = [self._face.at(self._inside(tip[:, :2] + step)).normal for step in steps]
            lean = np.nanmin([_angle(axis, own) for own in (normal, *around)], axis=0)
        # from line to line a tool that leans along its feed turns over, and its edge swings up
        flat, tube = claim.cutter.radius - claim.cutter.corner, claim.cutter.corner
        swing = flat * np.sin(claim.lean) + tube * (1.0 - np.cos(claim.lean))
        allowed = claim.tolerance + beyond + np.where(gap > 0.0, swing, 0.0)
        return {
            "off the face": np.abs(gap) / allowed,
            "beyond the edge of what is to be milled": beyond / (claim.cutter.radius + claim.tolerance),
            "leant too far": lean / (claim.turn + (0.0 if claim.upright else claim.lean)),
        }

    def _touching(self, tip: FloatArray, axis: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Where the end of the cutter is nearest to the face: how far beyond the edge (T,) [m], how far above
        or below the face (T,) [m], and the normal (T, 3) there."""
        normal = self._face.at(self._inside(tip[:, :2])).normal
        far = np.full(len(tip), np.inf)
        found = [far, far, normal]
        for rim in (0.0, 1.0):
            own = normal
            for _ in range(CONTACT_ROUNDS):
                contact = _contact(tip, axis, own, self._claim.cutter, rim)
                inside = self._inside(contact[:, :2])
                place = self._face.at(inside)
                own = np.where(np.isfinite(place.normal), place.normal, own)
            beyond = np.linalg.norm(inside - contact[:, :2], axis=1)
            gap = ((contact - place.point) * own).sum(axis=1)
            better = np.abs(gap) < np.abs(found[1])
            found = [
                np.where(better, beyond, found[0]),
                np.where(better, gap, found[1]),
                np.where(better[:, None], own, found[2]),
            ]
            if self._claim.cutter.radius == self._claim.cutter.corner:
                break
        return found[0], found[1], found[2]

    def _inside(self, xy: FloatArray) -> FloatArray:
        """Places (T, 2), those beyond the edge moved to the nearest place within."""
        out = xy.copy()
        rows = np.flatnonzero(~shapely.contains_xy(self._area, xy[:, 0], xy[:, 1]))
        if len(rows):
            nearest = shapely.shortest_line(self._area, shapely.points(xy[rows]))
            out[rows] = shapely.get_coordinates(shapely.get_point(nearest, 0))
        return out


def _contact(tip: FloatArray, axis: FloatArray, normal: FloatArray, cutter: Cutter, rim: float) -> FloatArray:
    """The places (T, 3) of a cutter's end that touch a plane with ``normal`` (T, 3): up the axis to the
    height of the round edge's tube, out to it by ``rim`` of the way, and down along the normal."""
    out = (normal * axis).sum(axis=1, keepdims=True) * axis - normal
    size = np.linalg.norm(out, axis=1, keepdims=True)
    outward = np.where(size > UPRIGHT_SINE, out / np.maximum(size, 1e-12), 0.0)
    return np.asarray(tip + cutter.corner * (axis - normal) + rim * (cutter.radius - cutter.corner) * outward)
