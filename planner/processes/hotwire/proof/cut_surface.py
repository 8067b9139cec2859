"""The surface that the wire leaves in the foam: swept wire shapes less half the kerf.

It is held against the wanted face. The swept shapes form a grid of points, row by station and
column by arc length. From each sample of the wanted face the nearest point of that grid's triangles
is found (nearest grid point first, then the triangles around it); a wire that cuts exactly right
passes at half the kerf on the outer side.

What a slot of a round wire cannot reach of a ruled surface follows from the part alone: in an acute
inner corner, or in a groove that is narrower than the slot, foam stays on the part however the wire
goes. In the plane across the wire the surface is a polyline. The middle of a slot may stand
wherever no part of the line is nearer than half of it; how far the nearest such place is from a
point of the surface is looked up among places that lie densely along the line's parallel. A place
on the other side of a wall of the part does not count: what is cut there takes nothing off this
side.
"""

import dataclasses
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots
from planner.processes.hotwire.claims import CutsSurface, FollowsRulings
from planner.proof.faces import areas, quarter_triangles, vertex_normals
from planner.proof.verdict import CutFace

SAMPLE_EDGE = 0.005
"""Largest edge of the triangles that the wanted face is sampled with [m]."""
SAMPLE_SHARE = 1.0 / 3000.0
"""No sample stands for a larger share of its face."""
MOST_SAMPLES = 60_000
"""Samples of the wanted face at most."""
RULING_SPACING = 0.010
"""Way along a ruling between points of the simulated part [m],"""
MOST_TRIANGLES = 60_000
"""unless that makes more triangles than this."""
SIDE_SPACING = 0.020
"""Largest way from ruling to ruling of the simulated part [m]."""
_FINER_STEPS = 2
"""Steps between two stations of a wire, the place between them by a cubic."""
_NORMAL_WEIGHT = 0.003
"""Weight [m] of a turn of the normal against distance, where the nearest place of a sheet is looked for."""
_LEAN_SINE = 0.2
"""A sheet may lean by so much (sine) over the wanted face's normal and still face its way."""
_EDGE_SHARE = 1e-9
"""A barycentric coordinate below this is that of a place on the edge."""
CREASE_COSINE = float(np.cos(np.deg2rad(20.0)))
"""Facets that lean away from the mean normal of a vertex by more than 20 degrees meet at an edge there."""
_SIDE_SAMPLES = 1000
"""So many samples of a face tell on which side of a sheet it lies."""


@dataclasses.dataclass(frozen=True)
class Sweep:
    """The wire's points (T, P, 3) at its stations in the block's frame, in order of time, their speeds
    across the wire (T, P) [m/s], and whether (T - 1,) each station and the next belong together: between
    visits of a segment the wire was elsewhere."""

    points: FloatArray
    speed: FloatArray
    joined: BoolArray

    @staticmethod
    def steady(points: FloatArray) -> "Sweep":
        """A sweep in one go, of no known speed."""
        return Sweep(points, np.zeros(points.shape[:2]), np.ones(max(len(points) - 1, 0), dtype=bool))


def cut_face(claim: CutsSurface, sweep: Sweep) -> CutFace:
    """The cut of one segment."""
    points, normals, area = sample_face(claim.vertices, claim.faces)
    distance, speed = distance_to_sweep(points, normals, sweep)
    deviation = distance - 0.5 * claim.kerf.at(speed)
    good = np.abs(deviation) <= claim.tolerance  # NaN compares as not good
    known = np.isfinite(deviation)
    weight = area[known] / max(float(area[known].sum()), 1e-30)
    return CutFace(
        segment=claim.segment,
        points=points,
        deviation=deviation,
        area=area,
        tolerance=claim.tolerance,
        share=float(area[good].sum() / max(area.sum(), 1e-30)),
        wanted_share=claim.share,
        rms=float(np.sqrt((weight * deviation[known] ** 2).sum())) if known.any() else float("nan"),
        largest=float(np.abs(deviation[known]).max()) if known.any() else float("nan"),
        speed=speed,
    )


def sample_face(vertices: FloatArray, faces: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points (M, 3) on a face, its unit normals there and the area [m^2] each stands for: centroids of a
    fine division."""
    corners = vertices[faces]
    corners = corners[
        np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) > 0.0
    ]
    smooth = vertex_normals(vertices, faces)[faces]
    smooth = (
        smooth[: len(corners)]
        if len(smooth) == len(corners)
        else np.repeat(_flat(corners)[:, None], 3, axis=1)
    )
    # at an edge of the part the mean of both sides is the normal of neither
    flat = np.broadcast_to(_flat(corners)[:, None], smooth.shape)
    smooth = np.where((dots(smooth, flat) < CREASE_COSINE)[..., None], flat, smooth)
    for _ in range(12):
        edge = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
        large = edge > SAMPLE_EDGE
        if not large.any() or len(corners) + 3 * int(large.sum()) > MOST_SAMPLES:
            break
        corners = np.concatenate([corners[~large], quarter_triangles(corners[large])])
        smooth = np.concatenate([smooth[~large], quarter_triangles(smooth[large])])
    most = SAMPLE_SHARE * float(areas(corners).sum())
    # where a mesh is dense in one place, what is large in another is divided all the same
    while (large := areas(corners) > most).any():
        corners = np.concatenate([corners[~large], quarter_triangles(corners[large])])
        smooth = np.concatenate([smooth[~large], quarter_triangles(smooth[large])])
    normals = smooth.mean(axis=1)
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    return corners.mean(axis=1), normals, areas(corners)


def distance_to_sweep(points: FloatArray, normals: FloatArray, sweep: Sweep) -> tuple[FloatArray, FloatArray]:
    """Signed distance (M,) [m] from points of the face to the swept sheet, positive where it lies outwards,
    and the speed (M,) [m/s] of the wire where it is nearest.

    Sheets that face the other way are those of another side of the part and do not count. NaN where the
    nearest place is on the border of the sweep: the wire did not pass there.
    """
    if len(sweep.points) < 2 or not sweep.joined.any():
        return np.full(len(points), np.nan), np.full(len(points), np.nan)
    sheet = _refined(sweep)
    grid, count, width = sheet.points, *sheet.points.shape[:2]
    facing = _facings(sheet)
    side = 1.0
    flat, turned = grid.reshape(-1, 3), facing.reshape(-1, 3)
    some = slice(None, None, max(1, len(points) // _SIDE_SAMPLES))
    _, near = cKDTree(flat).query(points[some], k=1)
    if float(dots(turned[near], normals[some]).sum()) < 0.0:
        side = -1.0
    tree = cKDTree(np.concatenate([flat, _NORMAL_WEIGHT * side * turned], axis=1))
    _, nearest = tree.query(np.concatenate([points, _NORMAL_WEIGHT * normals], axis=1), k=1)
    best = np.full(len(points), np.inf)
    foot, speed = np.zeros((len(points), 3)), np.zeros(len(points))
    border = np.zeros(len(points), dtype=bool)
    row, column = np.divmod(nearest, width)
    open_before = np.concatenate([[True], ~sheet.joined, [True]])
    for down in (0, -1, 1, -2):  # the nearest ones first
        for right in (-1, 0):
            a = np.clip(row + down, 0, count - 2)
            b = np.clip(column + right, 0, width - 2)
            corner = ((a, b), (a, b + 1), (a + 1, b + 1), (a + 1, b))
            for triangle, edges in (
                ((0, 1, 2), (open_before[a], b == width - 2)),
                ((0, 2, 3), (open_before[a + 2], b == 0)),
            ):
                # a triangle all of which is farther off than what is found needs no closer look
                corners = [(corner[i][0], corner[i][1]) for i in triangle]
                one, two, three = (grid[at] for at in corners)
                low = np.minimum(np.minimum(one, two), three)
                high = np.maximum(np.maximum(one, two), three)
                gap = np.maximum(low - points, points - high)
                least = np.maximum(np.maximum(gap[:, 0], gap[:, 1]), gap[:, 2])
                maybe = np.flatnonzero(sheet.joined[a] & (least < best))
                if not len(maybe):
                    continue
                ends = [end[maybe] for end in (one, two, three)]
                place, weights = closest(points[maybe], *ends)
                distance = np.linalg.norm(points[maybe] - place, axis=1)
                outward = np.cross(ends[2] - ends[0], ends[1] - ends[0])  # way x wire, as the facings
                right_way = side * dots(outward, normals[maybe]) >= -_LEAN_SINE * np.linalg.norm(
                    outward, axis=1
                )
                good = (distance < best[maybe] - 1e-12) & right_way
                better = maybe[good]
                best[better] = distance[good]
                foot[better] = place[good]
                share = weights[good]
                speed[better] = sum(
                    share[:, k] * sheet.speed[at[0][better], at[1][better]] for k, at in enumerate(corners)
                )
                first, second = (np.broadcast_to(edge, len(points))[better] for edge in edges)
                # edges on the sweep's border: 0-1 and 1-2 of the one triangle, 2-3 and 3-0 of the other
                on_first = share[:, 2] < _EDGE_SHARE if triangle == (0, 1, 2) else share[:, 0] < _EDGE_SHARE
                on_second = share[:, 0] < _EDGE_SHARE if triangle == (0, 1, 2) else share[:, 1] < _EDGE_SHARE
                border[better] = (first & on_first) | (second & on_second)
    along = dots(foot - points, normals)
    signed = np.where(along < 0.0, -best, best)
    # a foot on the border may still be straight under the point; a slanted one means that the wire passed by
    slanted = np.abs(along) < 0.9 * best - 1e-6
    lost = (border & slanted) | ~np.isfinite(best)
    return np.asarray(np.where(lost, np.nan, signed)), np.asarray(np.where(lost, np.nan, speed))


def deepest(claim: CutsSurface, sweep: Sweep, inside: BoolArray) -> tuple[float, int]:
    """How far [m] the wire runs deeper into the part than half its kerf off the wanted face, at most, and the
    station; points ``inside`` (T, P) of the block count that are over the face, not beside it.

    For faces that bend little: they are taken as flat around each of their samples.
    """
    points, normals, _ = sample_face(claim.vertices, claim.faces)
    facing = _facings(sweep).reshape(-1, 3)
    flat = sweep.points.reshape(-1, 3)
    _, near = cKDTree(flat).query(points, k=1)
    side = -1.0 if float(dots(facing[near], normals).sum()) < 0.0 else 1.0
    tree = cKDTree(np.concatenate([points, _NORMAL_WEIGHT * normals], axis=1))
    rows = np.flatnonzero(inside)
    if not len(rows):
        return 0.0, 0
    _, found = tree.query(np.concatenate([flat[rows], _NORMAL_WEIGHT * side * facing[rows]], axis=1), k=1)
    off = flat[rows] - points[found]
    height = dots(off, normals[found])
    beside = np.linalg.norm(off - height[:, None] * normals[found], axis=1) > SAMPLE_EDGE
    depth = 0.5 * claim.kerf.at(sweep.speed.reshape(-1)[rows]) - height
    depth[beside] = -np.inf
    k = int(np.argmax(depth))
    return float(max(depth[k], 0.0)), int(rows[k] // sweep.points.shape[1])


def closest(points: FloatArray, a: FloatArray, b: FloatArray, c: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Closest places (M, 3) of triangles to points, with their barycentric weights (M, 3).

    Regions of the triangle as in Ericson, Real-Time Collision Detection (2005), section 5.1.5.
    """
    ab, ac, ap = b - a, c - a, points - a
    d1, d2 = dots(ab, ap), dots(ac, ap)
    bp, cp = points - b, points - c
    d3, d4, d5, d6 = dots(ab, bp), dots(ac, bp), dots(ab, cp), dots(ac, cp)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    total = np.where(np.abs(va + vb + vc) > 0.0, va + vb + vc, 1.0)
    v, w = vb / total, vc / total
    with np.errstate(divide="ignore", invalid="ignore"):
        on_ab, on_ac = d1 / (d1 - d3), d2 / (d2 - d6)
        on_bc = (d4 - d3) / ((d4 - d3) + (d5 - d6))
    bc = (va <= 0) & (d4 - d3 >= 0) & (d5 - d6 >= 0)
    v, w = np.where(bc, 1.0 - on_bc, v), np.where(bc, on_bc, w)
    edge_ac = (vb <= 0) & (d2 >= 0) & (d6 <= 0)
    v, w = np.where(edge_ac, 0.0, v), np.where(edge_ac, on_ac, w)
    edge_ab = (vc <= 0) & (d1 >= 0) & (d3 <= 0)
    v, w = np.where(edge_ab, on_ab, v), np.where(edge_ab, 0.0, w)
    at_c = (d6 >= 0) & (d5 <= d6)
    v, w = np.where(at_c, 0.0, v), np.where(at_c, 1.0, w)
    at_b = (d3 >= 0) & (d4 <= d3)
    v, w = np.where(at_b, 1.0, v), np.where(at_b, 0.0, w)
    at_a = (d1 <= 0) & (d2 <= 0)
    v, w = np.where(at_a, 0.0, v), np.where(at_a, 0.0, w)
    v, w = np.nan_to_num(v), np.nan_to_num(w)
    place = a + v[:, None] * ab + w[:, None] * ac
    return place, np.stack([1.0 - v - w, v, w], axis=1)


def part_obj(
    claims: tuple[CutsSurface, ...], sweeps: tuple[Sweep, ...], rulings: tuple[FollowsRulings, ...] = ()
) -> str:
    """The simulated part as OBJ text in mm: each wanted face with its vertices moved to where the cut
    surface is. Faces with ``rulings`` have vertices along and between these too: at their ends alone they
    would not show what the wire left between them."""
    ruled = {claim.segment.key: claim for claim in rulings}
    lines = ["# the cut faces as simulated from the programs; stock frame, mm"]
    offset = 1
    for claim, sweep in zip(claims, sweeps, strict=True):
        vertices, faces = claim.vertices, claim.faces
        if claim.segment.key in ruled:
            vertices, faces = _grid(ruled[claim.segment.key])
        normals = vertex_normals(vertices, faces)
        distance, speed = distance_to_sweep(vertices, normals, sweep)
        deviation = np.nan_to_num(distance - 0.5 * claim.kerf.at(speed))
        moved = vertices + deviation[:, None] * normals
        lines.append(f"o {claim.segment.word}")
        lines += [f"v {x:.4f} {y:.4f} {z:.4f}" for x, y, z in (moved * 1e3).tolist()]
        lines += [f"f {a} {b} {c}" for a, b, c in (faces + offset).tolist()]
        offset += len(vertices)
    return "\n".join(lines) + "\n"


def _grid(claim: FollowsRulings) -> tuple[FloatArray, IntArray]:
    """Vertices and triangles of a ruled face with points every ``RULING_SPACING`` along its rulings, wound
    as the claimed face is; fewer where there are very many rulings. Rulings that are farther apart than
    ``SIDE_SPACING`` have others between them."""
    way = np.maximum(*(np.linalg.norm(np.diff(line, axis=0), axis=1) for line in (claim.start, claim.end)))
    parts = np.maximum(np.ceil(way / SIDE_SPACING - 1e-9), 1.0).astype(np.int64)
    own = np.concatenate([[0], np.cumsum(parts)])
    fine = np.arange(own[-1] + 1)
    start, end = (
        np.stack([np.interp(fine, own, line[:, c]) for c in range(3)], axis=-1)
        for line in (claim.start, claim.end)
    )
    length = float(np.linalg.norm(end - start, axis=1).max())
    count = len(start)
    columns = 1 + int(np.clip(np.ceil(length / RULING_SPACING), 1, max(MOST_TRIANGLES // (2 * count), 4)))
    share = np.linspace(0.0, 1.0, columns)[None, :, None]
    vertices = (1.0 - share) * start[:, None] + share * end[:, None]
    at = np.arange(count * columns).reshape(count, columns)
    one, two, three, four = (part.ravel() for part in (at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]))
    faces = np.concatenate([np.stack([one, two, four], axis=1), np.stack([two, three, four], axis=1)])
    return vertices.reshape(-1, 3), faces


def _refined(sweep: Sweep) -> Sweep:
    """The sweep without stations at which the wire stood, with points between the points along the wire
    (cubic), so that triangles follow its curve."""
    step = np.linalg.norm(np.diff(sweep.points, axis=0), axis=2).max(axis=1)
    moving = np.concatenate([[True], (step > 1e-7) | ~sweep.joined])
    visit = np.concatenate([[0], np.cumsum(~sweep.joined)])[moving]
    rows, speed = sweep.points[moving], sweep.speed[moving]
    wide = np.concatenate([2 * rows[:, :1] - rows[:, 1:2], rows, 2 * rows[:, -1:] - rows[:, -2:-1]], axis=1)
    middle = (-wide[:, :-3] + 9.0 * wide[:, 1:-2] + 9.0 * wide[:, 2:-1] - wide[:, 3:]) / 16.0
    out = np.empty((rows.shape[0], _FINER_STEPS * rows.shape[1] - 1, 3))
    out[:, ::2], out[:, 1::2] = rows, middle
    fast = np.empty(out.shape[:2])
    fast[:, ::2], fast[:, 1::2] = speed, 0.5 * (speed[:, :-1] + speed[:, 1:])
    return Sweep(out, fast, visit[1:] == visit[:-1])


def _facings(sheet: Sweep) -> FloatArray:
    """Unit normals (T, P, 3) of the sheet: across the wire and its way; 0 where it turns about a point."""
    step = np.diff(sheet.points, axis=0) * sheet.joined[:, None, None]
    way = np.zeros_like(sheet.points)
    way[1:] += step
    way[:-1] += step
    normal = np.cross(way, np.gradient(sheet.points, axis=1))
    return np.asarray(normal / np.maximum(np.linalg.norm(normal, axis=2, keepdims=True), 1e-15))


def _flat(corners: FloatArray) -> FloatArray:
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-30))


PLACE_STEP: Final = 5e-5
"""[m] distance of the places that are tried."""
HALF_SLOT_SLACK: Final = 2e-6
"""[m] a place that is nearer to the line than half a slot by less is not too near."""
CORNER_FAN_STEP: Final = np.deg2rad(3.0)
"""[rad] turn between the places that are tried around an outer corner."""


def unreached(claim: FollowsRulings, places: FloatArray, half: float) -> FloatArray:
    """How much (N,) [m] farther than ``half`` [m] a slot's middle must stay from places (N, 3) of the surface
    that a claim follows; infinite where that is more than the claim allows to be left by far."""
    out = np.empty(len(places))
    along = claim.end - claim.start
    middle = claim.start + 0.5 * along
    for k, place in enumerate(places):
        nearest = int(np.argmin(dots(place - middle, place - middle)))
        axis = along[nearest] / np.linalg.norm(along[nearest])
        out[k] = _farther(_section(claim, along, place, axis), half, claim.left, claim.tolerance)
    return out


def _section(claim: FollowsRulings, along: FloatArray, place: FloatArray, axis: FloatArray) -> FloatArray:
    """The surface (M, 2) across ``axis`` as seen from a place; the part is to the left of its way."""
    share = (place - claim.start) @ axis / (along @ axis)
    row = claim.start + share[:, None] * along - place
    one = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    one /= np.linalg.norm(one)
    return np.stack([row @ one, row @ np.cross(axis, one)], axis=1)


def _farther(line: FloatArray, half: float, left: float, thin: float) -> float:
    """How much farther than ``half`` the nearest admissible place is from the origin, a point of the line,
    that does not lie behind more than ``thin`` of the part."""
    reach = 2.0 * half + left + 1e-3
    a, b = line[:-1], line[1:]
    size = np.linalg.norm(b - a, axis=1)
    own = (size > 1e-9) & (_apart(np.zeros((1, 2)), a, b)[0] < reach + 2.0 * half)
    a, b, size = a[own], b[own], size[own]
    if not len(a):
        return 0.0
    way = (b - a) / size[:, None]
    normal = np.stack([way[:, 1], -way[:, 0]], axis=1)
    tried = [_fans(a, b, normal, half)]
    for start, end, out, length in zip(a, b, normal, size, strict=True):
        share = np.linspace(0.0, 1.0, max(int(np.ceil(length / PLACE_STEP)), 1) + 1)[:, None]
        tried.append(start + share * (end - start) + half * out)
    places = np.concatenate(tried)
    distance = np.linalg.norm(places, axis=1)
    near = np.argsort(distance, kind="stable")
    near = near[distance[near] <= reach]
    for low in range(0, len(near), 256):  # the nearest ones first: one is enough
        some = near[low : low + 256]
        free = _apart(places[some], a, b).min(axis=1) >= half - HALF_SLOT_SLACK
        for k in some[free]:
            if _within(places[k], a, b) <= thin:
                return max(float(distance[k]) - half, 0.0)
    return float("inf")


def _within(place: FloatArray, a: FloatArray, b: FloatArray) -> float:
    """How much of the way from the origin to a place outside is within the part, whose border are the pieces
    of a line, ``a`` to ``b`` (M, 2): between the crossings, counted from the place."""
    edge = b - a
    across = place[0] * edge[:, 1] - place[1] * edge[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (a[:, 0] * edge[:, 1] - a[:, 1] * edge[:, 0]) / across
        on = (a[:, 0] * place[1] - a[:, 1] * place[0]) / across
    length = float(np.linalg.norm(place))
    crossed = (across != 0.0) & (on >= 0.0) & (on < 1.0) & (share * length > HALF_SLOT_SLACK) & (share < 1.0)
    at = np.sort(share[crossed])[::-1]
    if len(at) % 2:  # the last of them is where the way begins
        at = np.append(at, 0.0)
    return float((at[::2] - at[1::2]).sum()) * length


def _fans(a: FloatArray, b: FloatArray, normal: FloatArray, half: float) -> FloatArray:
    """Places (F, 2) around the corners between pieces that follow one another, from one's normal to the
    other's."""
    joined = np.flatnonzero(np.linalg.norm(b[:-1] - a[1:], axis=1) < 1e-9)
    out = [np.zeros((0, 2))]
    for k in joined:
        n, m = normal[k], normal[k + 1]
        turn = np.arctan2(n[0] * m[1] - n[1] * m[0], n @ m)
        angle = np.linspace(0.0, turn, max(int(np.ceil(abs(turn) / CORNER_FAN_STEP)), 1) + 1)
        c, s = np.cos(angle), np.sin(angle)
        out.append(b[k] + half * np.stack([c * n[0] - s * n[1], s * n[0] + c * n[1]], axis=1))
    return np.concatenate(out)


def _apart(places: FloatArray, a: FloatArray, b: FloatArray) -> FloatArray:
    """Distance (N, M) of places (N, 2) from pieces of a line, ``a`` to ``b`` (M, 2)."""
    edge, to = b - a, places[:, None] - a
    share = dots(to, np.broadcast_to(edge, to.shape)) / np.maximum(dots(edge, edge), 1e-30)
    off = to - np.clip(share, 0.0, 1.0)[..., None] * edge
    return np.asarray(np.sqrt(dots(off, off)))
