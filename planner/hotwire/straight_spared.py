"""What a cut must leave alone: other pieces of the part beside its slot, and the part itself where the wire
goes in and out.

The claims of a job say how each surface comes out, not what a way in takes from another one, so it is looked
at here, on the planned wires.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
import shapely
from numpy.typing import NDArray

from planner.geometry.rulings import resample, tessellate
from planner.hotwire.straight_cut import Cut
from planner.hotwire.straight_lines import Lines, chord, join
from planner.hotwire.straight_neighbours import check_neighbours
from planner.hotwire.straight_operation import Straight, SurfaceCut
from planner.hotwire.straight_section import Piece, contour, pieces_across, section
from planner.issues import Issue
from planner.problem import Ruled
from planner.units import MM

FloatArray = NDArray[np.float64]

LEVELS: Final = (0.02, 0.5, 0.98)
"""Shares of the common length of all rulings at which slots are held against other pieces."""
STEEP: Final = 6.0
"""Half slots of way beside another contour that a slit may take wherever it crosses it: at 20 degrees or
more."""
GRAZE: Final = 0.3
"""Share of the tolerance that a slot may take from another piece, and a way in from its own."""
SIGHTS: Final = np.linspace(0.01, 0.99, 9)
"""Shares of the wire in the foam at which its way in and out is followed."""
COARSE: Final = 2e-4
"""[m] surfaces that ways in and out might pass are as near as this."""


def check_spared(op: Straight, cut: Cut, ruled: tuple[Ruled, ...], box: FloatArray) -> Iterator[Issue]:
    """Issues of one cut: ``straight.crossing`` and ``straight.lead`` where it takes from other surfaces of
    the part, or from its own on the way in or out."""
    found: list[Issue] = []
    if cut.wanted.ruled.closed:
        found += [*_beside(op, cut, ruled, box), *_along(op, cut, ruled, box)]
    elif isinstance(cut.wanted.cut, SurfaceCut):
        found += [*_own_side(op, cut), *_through(op, cut, ruled, box)]
    yield from found or check_neighbours(op, cut, ruled, box)


def _beside(op: Straight, cut: Cut, ruled: tuple[Ruled, ...], box: FloatArray) -> Iterator[Issue]:
    """No slot of a closed cut reaches another closed surface that is cut in the same direction."""
    allowed = GRAZE * op.shape_tol_mm * MM
    for level in LEVELS:
        pieces = pieces_across(cut.wanted.ruled, ruled, box, level)
        if not pieces.others:
            continue
        ways = (
            ("straight.crossing", cut.on.lines, cut.on.half),
            ("straight.lead", cut.into, cut.on.half[:1]),
            ("straight.lead", cut.out, cut.on.half[-1:]),
        )
        for code, lines, half in ways:
            if code == "straight.lead" and (cut.wanted.ruled.hole or pieces.enclosed):
                continue  # its slit is told
            others = [p for p in pieces.others if code == "straight.crossing" or not p.around]
            found = _taken(section(lines, pieces.plane), half.max(axis=1), others, allowed)
            if found is None:
                continue
            depth, place, other = found
            point = pieces.plane.point(place)
            what = "the slot" if code == "straight.crossing" else "the way in or out"
            yield Issue(
                code,
                f"{op.name}: {what} of {cut.wanted.segment} takes {depth / MM:.2f} mm off {other.name} at "
                f"{_place(point)}; move the pieces apart, take a thinner slot"
                + ("" if code == "straight.crossing" else " or give another lead"),
                field=str(cut.wanted.segment),
                value=depth / MM,
                limit=allowed / MM,
                unit="mm",
            )
            return


def _along(op: Straight, cut: Cut, ruled: tuple[Ruled, ...], box: FloatArray) -> Iterator[Issue]:
    """A slit through the part crosses other contours steeply, and runs beside none of them."""
    if cut.start is None or cut.start.through < 1e-4:
        return
    pieces = pieces_across(cut.wanted.ruled, ruled, box, 0.5)
    half = float(cut.on.half[[0, -1]].max())
    allowed = GRAZE * op.shape_tol_mm * MM
    for lines in (cut.into, cut.out):
        way = shapely.LineString(section(lines, pieces.plane)[[0, -1]])
        for other in ruled:
            if not other.closed or other.name == cut.wanted.ruled.name:
                continue
            border = shapely.boundary(contour(other, pieces.plane))
            beside = way.intersection(shapely.buffer(border, half)).length
            crossed = shapely.get_num_geometries(way.intersection(border)) if way.intersects(border) else 0
            if beside > STEEP * half * crossed + allowed:
                yield Issue(
                    "straight.lead",
                    f"{op.name}: the slit to {cut.wanted.segment} runs along {other.name} for "
                    f"{beside / MM:.1f} mm and takes from it; give another lead",
                    field=str(cut.wanted.segment),
                    value=beside / MM,
                    limit=STEEP * half * crossed / MM,
                    unit="mm",
                )
                return


def _taken(
    way: FloatArray, half: FloatArray, others: list[Piece], allowed: float
) -> tuple[float, FloatArray, Piece] | None:
    """How deep [m] the slot about a way (N, 2) reaches into the pieces at most, where and which; None where
    it takes no more than ``allowed``."""
    if len(way) < 2 or not others:
        return None
    moves = shapely.linestrings(np.stack([way[:-1], way[1:]], axis=1))
    half = np.broadcast_to(half, (len(way),))
    wide = np.maximum(half[:-1], half[1:])
    tree = shapely.STRtree([piece.shape for piece in others])
    move, piece = tree.query(moves, predicate="dwithin", distance=np.maximum(wide - allowed, 0.0))
    if not len(move):
        return None
    depth = wide[move] - shapely.distance(moves[move], tree.geometries[piece])
    k = int(np.argmax(depth))
    return float(depth[k]), way[move[k]], others[int(piece[k])]


def _own_side(op: Straight, cut: Cut) -> Iterator[Issue]:
    """A lead that is given for a strip comes from outside the part, or straight on."""
    foot, into = cut.on.row.foot, cut.into
    if len(into) < 2:
        return
    way = into.start[0] + into.end[0] - into.start[-1] - into.end[-1]
    normal = cut.on.row.normal[0].mean(axis=0)
    depth = -0.5 * float(way @ normal) / max(float(np.linalg.norm(normal)), 1e-12)
    if depth <= GRAZE * op.shape_tol_mm * MM:
        return
    # a strip that bends away beyond its end may be followed straight on
    ahead = foot.start[0] + foot.end[0] - foot.start[1] - foot.end[1]
    if isinstance(cut.wanted.cut, SurfaceCut) and cut.wanted.cut.lead == "auto" and way @ ahead > 0.0:
        return
    yield Issue(
        "straight.lead",
        f"{op.name}: the lead of {cut.wanted.segment} comes through the part, {depth / MM:.1f} mm below its "
        f"surface, to {_place(foot.start[0])}; give a lead on the outer side, or auto",
        field=str(cut.wanted.segment),
        value=depth / MM,
        limit=0.0,
        unit="mm",
    )


def _through(op: Straight, cut: Cut, ruled: tuple[Ruled, ...], box: FloatArray) -> Iterator[Issue]:
    """The ways in and out of a strip do not enter the part through another surface that the strip itself does
    not cross. (Surfaces that cross bound the part together: what is beyond one is no part.)"""
    on = cut.on.lines
    near = 4.0 * float(cut.on.half.max())
    for other in ruled:
        if other.name == cut.wanted.ruled.name:
            continue
        mesh = tessellate(resample(other, COARSE, 0.05), COARSE)
        triangles = mesh.vertices[mesh.faces]
        inner = _between(on, near)
        if len(inner) > 1 and _entered(inner[:: max(1, len(inner) // 40)], triangles, box, both=True).size:
            continue
        out = cut.out[: cut.turns] if cut.turns else cut.out
        for lines, word in ((cut.into.reversed(), "in"), (out, "out")):
            # from the wire before, since the last one may stand exactly in the other surface
            ends = join([on[[1 if word == "in" else -2]], lines[[-1]]])
            place = _entered(ends, triangles, box, both=False)
            if place.size:
                yield Issue(
                    "straight.lead",
                    f"{op.name}: the way {word} of {cut.wanted.segment} goes straight on through the part, "
                    f"into which it comes through {other.name} at {_place(place)}; make both one surface "
                    "with a corner, or move them apart",
                    field=str(cut.wanted.segment),
                )
                return


def _between(lines: Lines, near: float) -> Lines:
    """The lines that are farther than ``near`` [m] from the first and the last one."""
    middle = 0.5 * (lines.start + lines.end)
    far = [np.linalg.norm(middle - middle[k], axis=1) > near for k in (0, -1)]
    return lines[far[0] & far[1]]


def _entered(lines: Lines, triangles: FloatArray, box: FloatArray, both: bool) -> FloatArray:
    """A place (3,) where points of the wire in the foam pass triangles (T, 3, 3) from outside to inside, or
    either way; of no size where there is none (Moller and Trumbore's test)."""
    # wires outside the block are followed between their guide points
    length = np.linalg.norm(lines.end - lines.start, axis=1)
    first, last = chord(lines, box)
    first, last = np.nan_to_num(first), np.where(np.isfinite(last), last, length)
    along = first[:, None] + (last - first)[:, None] * SIGHTS
    base = lines.start[:, None] + lines.direction[:, None] * along[..., None]
    origin, way = base[:-1].reshape(-1, 3), np.diff(base, axis=0).reshape(-1, 3)
    a, one, two = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    for start, move in zip(origin, way, strict=True):
        cross = np.cross(move, two)
        det = np.sum(one * cross, axis=1)
        size = np.where(np.abs(det) > 1e-18, det, np.inf)
        off = start - a
        u = np.sum(off * cross, axis=1) / size
        turned = np.cross(off, one)
        v = turned @ move / size
        t = np.sum(two * turned, axis=1) / size
        hit = (u > 0.0) & (v > 0.0) & (u + v < 1.0) & (t > 0.0) & (t < 1.0)
        if not both:
            hit &= np.cross(one, two) @ move < 0.0
        if hit.any():
            return np.asarray(start + t[int(np.argmax(hit))] * move)
    return np.zeros(0)


def _place(point: FloatArray) -> str:
    return "[" + ", ".join(f"{value / MM:.1f}" for value in point) + "] mm"
