"""Rows: parts of raw blocks out of which several panels are cut together, not each out of a block of its own.

A straight wire cuts the faces of all panels of a row on one way through it, as they lie in one slab or their
rulings along one line; then the operator stands the row on edge, and the wire goes round each panel, the
uppermost first. Here is which parts of a nest are rows, and why the others are none; `row_jobs` writes them.
"""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, transform, unit
from planner.geometry.cut_tree import Bow, CutTree, Part
from planner.geometry.units import DEG, MM

SAME: Final = 5e-5
"""Thicknesses [m] that differ by no more than this are the same: sizes of blocks are rounded to 0.1 mm."""
ALONE: Final = "nothing else is cut out of its part of the block"
FRONTS, BACKS = "fronts", "backs"
"""Names of surfaces that are faces of all panels of a row."""
INSIDE: Final = 1e-3
"""Rulings of faces end so far [m] inside of the row: the wire goes on beyond both."""
ROOM: Final = 1e-3
"""Room [m] that is left between the wire and what bears a row beyond the clearance."""
BEYOND: Final = 3e-3
"""Outlines go on beyond a front that is cut by this [m], where the foam does."""
LEAST_OFF: Final = 2e-4
"""Foam above panels that is thinner than this [m] is not cut off: sides have to cross the plane of fronts."""
LEAST_BEARER: Final = 0.02
"""What bears a row is so long [m] at least in each place."""
SLIP: Final = 1e-6
"""Lengths [m] below this are rounding."""
_BESIDE: Final = 0.005  # what is so far [m] beside a way in is out of it
_WAYS: Final = 9  # of points of a wire that are looked at
_STEP: Final = 1e-3  # between places that are looked at for what bears a row [m]


@dataclasses.dataclass(frozen=True)
class Shape:
    """A panel in the frame of its block [m]: ``outline`` (2, C, 3), its corners at the back and in front,
    counterclockwise; ``faces``, back and front: ends (2, N, 3) of their rulings, which lie along x and follow
    one another along y, none where they are level: the back at z = 0, the front at the panel's thickness."""

    outline: FloatArray
    faces: tuple[FloatArray, FloatArray] | None = None

    def lean(self) -> float:
        """How far [rad] the wire leans at most where it goes round the panel."""
        way = self.outline[1] - self.outline[0]
        return float(np.arctan2(np.linalg.norm(way[:, :2], axis=1), way[:, 2]).max())


@dataclasses.dataclass(frozen=True)
class Limits:
    """What a row must keep: the ``bow``, ``margin`` [m] of foam to the wire's ends and to the beam, ``kept``
    [m], the least side of what is worth to be kept, and ``room`` [m] between what is cut and what bears it.
    """

    bow: Bow
    margin: float
    kept: float
    room: float


@dataclasses.dataclass(frozen=True)
class Piece:
    """What is asked of a panel's block: the panel's ``name``, its ``thickness`` [m] and ``shape``, none where
    no straight wire cuts it."""

    name: str
    thickness: float
    shape: Shape | None


Bearer = tuple[float, float]
"""What bears a row from and to along it [m], in its frame."""


@dataclasses.dataclass(frozen=True)
class Row:
    """A part of a block out of which panels are cut together. What is cut, in its frame, whose origin is the
    middle of its bottom face [m]: ``faces`` by their names as rulings (2, N, 3), of each panel one behind the
    other; ``outlines`` (2, C, 3) by ids. ``pieces``: their boxes in the block, and ``places`` (4, 4): where
    their blocks lie; all of these the uppermost first.

    For the faces it lies flat on ``beams``, none where there are no faces to cut. For the outlines it stands
    on edge with its ``axis`` (0: x, 1: y) upright, on ``feet`` along the other one.
    """

    part: Part
    pieces: tuple[Part, ...]
    places: Mapping[str, FloatArray]
    faces: Mapping[str, Sequence[FloatArray]]
    outlines: Mapping[str, FloatArray]
    beams: tuple[Bearer, ...]
    axis: int
    feet: tuple[Bearer, ...]

    def from_above(self, name: str) -> bool:
        """Whether nothing is above a panel on edge, so that the wire comes to it from there."""
        own = self.outlines[name][..., 1 - self.axis]
        low, high = float(own.min()), float(own.max())
        top = float(self.outlines[name][..., self.axis].max())
        return not any(
            ring[..., self.axis].max() > top
            and ring[..., 1 - self.axis].min() < high + _BESIDE
            and ring[..., 1 - self.axis].max() > low - _BESIDE
            for other, ring in self.outlines.items()
            if other != name
        )

    @property
    def along(self) -> int:
        """The axis (0: x, 1: y) along which beams follow one another: that of the wire's way."""
        return 0 if self.pieces[0].turned else 1


def rows_of(
    tree: CutTree, pieces: Sequence[Piece], thickness: float, limits: Limits
) -> tuple[dict[int, Row], dict[int, str]]:
    """The largest parts of a block ``thickness`` [m] thick that are rows, by their numbers in its tree; and
    of each box in none of them, by its number, why it is cut by itself. ``pieces`` by the numbers of
    boxes."""
    found: dict[int, Row] = {}
    alone: dict[int, str] = {}
    waiting = [(0, ALONE)]
    while waiting:
        i, why = waiting.pop()
        part = tree.parts[i]
        if part.box is not None:
            alone[part.box] = why
            continue
        if sum(tree.parts[k].box is not None for k in tree.below(i)) > 1:
            row = _row(tree, i, pieces, thickness, limits)
            if isinstance(row, Row):
                found[i] = row
                continue
            why = row
        waiting += [(k, why) for k in (part.high, part.low) if k is not None]
    return found, alone


def _row(tree: CutTree, i: int, pieces: Sequence[Piece], thickness: float, limits: Limits) -> Row | str:
    """A part as a row, or why it is none."""
    part, bow, margin = tree.parts[i], limits.bow, limits.margin
    below = [tree.parts[k] for k in tree.below(i)]
    boxes = [one for one in below if one.box is not None]
    shapes = [one.shape for one in (pieces[box.box or 0] for box in boxes) if one.shape is not None]
    if len(shapes) < len(boxes):
        return "a bent wire cuts their faces"
    for one in below:
        if one.box is None and one.axis is None and min(one.length, one.width) >= limits.kept - SAME:
            size = f"{one.length / MM:.0f} x {one.width / MM:.0f} mm"
            return f"what is left over beside them, {size}, is worth to be kept"
    sides = (part.length, part.width)
    high = [k for k in (0, 1) if sides[k] + margin <= bow.throat]
    if not high:
        room = f"throat of {bow.throat / MM:g} mm has room for {(bow.throat - margin) / MM:.0f}"
        return f"on edge they stand {min(sides) / MM:.0f} mm high, and the bow's {room}"
    lean = max(shape.lean() for shape in shapes)
    span = thickness / float(np.cos(lean)) + 2.0 * margin
    if span > bow.span:
        return _spans("round them", span, lean, bow)
    thick = [pieces[box.box or 0].thickness for box in boxes]
    curved = [shape.faces is not None for shape in shapes]
    if all(curved):
        why = _in_line(part, boxes, margin, bow)
        if why is not None:
            return why
    elif any(curved) or max(thick) - min(thick) > SAME:
        return "they are not of one thickness, so their faces are in several planes"
    elif SAME < thickness - thick[0] < LEAST_OFF - SLIP:
        over = f"{(thickness - thick[0]) / MM:.2g} mm thicker than they are"
        return f"the block is {over}: as thick, or {LEAST_OFF / MM:g} mm thicker, it would do"
    elif thickness - thick[0] > SAME and min(sides) + 2.0 * margin > bow.span:
        return _spans("across them, to their thickness", min(sides) + 2.0 * margin, 0.0, bow)
    return _borne(part, boxes, pieces, thickness, sorted(high, key=lambda k: (sides[k], k)), limits)


def _spans(what: str, span: float, lean: float, bow: Bow) -> str:
    leans = f", which leans by {lean / DEG:.0f} degrees," if lean > DEG else ""
    return f"the wire {what}{leans} takes a span of {span / MM:.0f} mm, and the bow has {bow.span / MM:g}"


def _in_line(part: Part, boxes: Sequence[Part], margin: float, bow: Bow) -> str | None:
    """Why faces that are ruled cannot be cut on one way, if they cannot."""
    turned = boxes[0].turned
    if any(one.turned != turned for one in boxes):
        return "the rulings of their faces lie along and across the block"
    ends = sorted((one.x, one.x + one.length) if turned else (one.y, one.y + one.width) for one in boxes)
    if any(first[1] > second[0] + SAME for first, second in itertools.pairwise(ends)):
        return "they lie beside one another along the rulings of their faces"
    across = (part.width if turned else part.length) + 2.0 * margin
    return _spans("along their rulings", across, 0.0, bow) if across > bow.span else None


def _borne(
    part: Part,
    boxes: Sequence[Part],
    pieces: Sequence[Piece],
    thickness: float,
    axes: Sequence[int],
    limits: Limits,
) -> Row | str:
    """The row with what bears it, on edge with one of the ``axes`` upright; or why nothing can."""
    places = [_place(part, box) for box in boxes]
    own = [pieces[box.box or 0] for box in boxes]
    shapes = [one.shape for one in own if one.shape is not None]
    outlines = [transform(at, shape.outline) for at, shape in zip(places, shapes, strict=True)]
    half = 0.5 * np.array([part.length, part.width])
    faces: dict[str, Sequence[FloatArray]] = {}
    beams: tuple[Bearer, ...] = ()
    along = 0 if boxes[0].turned else 1
    if shapes[0].faces is not None:
        for k, name in ((1, FRONTS), (0, BACKS)):
            each = [one.faces[k] for one in shapes if one.faces is not None]
            faces[name] = _one_way(each, places, float(half[1 - along]) - INSIDE)
            ends = [(float(one[..., along].min()), float(one[..., along].max())) for one in faces[name]]
            if any(a[1] > b[0] - SAME for a, b in itertools.pairwise(sorted(ends))):
                return "their faces, which go on beyond their sides, lie over one another"
        backs = _straight_on(np.concatenate(faces[BACKS], axis=1), along, float(half[along]) + limits.room)
        found = _bearers(_between(backs), along, 2, 0.0, half, limits.room)
        if isinstance(found, float):
            return _near("foam_faces_mm", "as they lie", found, limits)
        beams = found
    elif thickness - own[0].thickness > SAME:
        thick = own[0].thickness
        # surfaces that bound a part together go on beyond one another
        more = 1.0 + min(BEYOND, thickness - thick) / thick
        outlines = [np.stack([ring[0], ring[0] + more * (ring[1] - ring[0])]) for ring in outlines]
        out = max(float((np.abs(ring[..., :2]) - half).max()) for ring in outlines)
        if out > SLIP:
            more_foam = f"{out / MM:.2g} mm more foam beside them (foam_sides_mm)"
            return f"their sides, which go on beyond the fronts, come out of the part; {more_foam} would do"
        faces[FRONTS] = [_level(half, thick)]
        beams = ((-float(half[along]), float(half[along])),)
    least = -np.inf
    for axis in axes:
        rings = [_to_faces(np.concatenate([ring, ring[:, :1]], axis=1), thickness) for ring in outlines]
        rounds = [way for ring in rings for way in _between(ring)]
        feet = _bearers(rounds, 1 - axis, axis, -float(half[axis]), half, limits.room)
        if isinstance(feet, float):
            least = max(least, feet)
            continue
        top = [-float(ring[..., axis].max()) for ring in outlines]
        order = sorted(range(len(boxes)), key=lambda k: (round(top[k] / SAME), k))
        return Row(
            part,
            tuple(boxes[k] for k in order),
            {own[k].name: places[k] for k in order},
            faces,
            {own[k].name: outlines[k] for k in order},
            beams,
            axis,
            feet,
        )
    return _near("foam_sides_mm", "on edge", least, limits)


def _near(field: str, how: str, least: float, limits: Limits) -> str:
    wanted = f"{limits.room / MM:g} mm are its room ({field})"
    return f"{how} the wire comes within {least / MM:.1f} mm of what bears them, and {wanted}"


def _to_faces(ring: FloatArray, thickness: float) -> FloatArray:
    """Where wires through the ends (2, N, 3) [m] come out of both faces of a row."""
    way = ring[1] - ring[0]
    shares = [(high - ring[0][:, 2]) / way[:, 2] for high in (0.0, thickness)]
    return np.stack([ring[0] + share[:, None] * way for share in shares])


def _between(ends: FloatArray) -> list[FloatArray]:
    """Ways (N, 3) of points of a wire from end to end of it, of ``ends`` (2, N, 3): one that leans may be
    nearer to what bears a row in between than at both."""
    return [ends[0] + share * (ends[1] - ends[0]) for share in np.linspace(0.0, 1.0, _WAYS).tolist()]


def _straight_on(ends: FloatArray, along: int, far: float) -> FloatArray:
    """Wires by their ends (2, N, 3) with those of the ways in and out, which go straight on from a surface,
    as far as ``far`` [m] from the middle of the row."""
    out = ends
    for k, before in ((0, 1), (-1, -2)):
        ruling = unit(ends[1, k] - ends[0, k])
        way = (ends[:, k] - ends[:, before]).sum(axis=0)
        way = unit(way - (way @ ruling) * ruling)
        rest = far - np.sign(way[along]) * ends[:, k, along]
        length = float(np.clip(rest.max() / max(abs(float(way[along])), SLIP), 0.0, 2.0 * far))
        more = ends[:, [k]] + length * way
        out = np.concatenate([more, out] if k == 0 else [out, more], axis=1)
    return out


def _bearers(
    lines: Sequence[FloatArray], along: int, up: int, bottom: float, half: FloatArray, room: float
) -> tuple[Bearer, ...] | float:
    """Where a row may be borne along an axis from below, at ``bottom`` [m] along ``up``, so that ways of the
    wire (N, 3) keep their ``room`` [m]; where that is nowhere below its middle and at both sides of it, how
    high [m] they are at least."""
    at = np.arange(-half[along], half[along] + 0.5 * _STEP, _STEP)
    lowest = np.full(len(at), np.inf)
    for line in lines:
        for (a, high), (b, end) in itertools.pairwise(line[:, [along, up]] - [0.0, bottom]):
            share = np.linspace(0.0, 1.0, int(np.ceil(max(abs(b - a), abs(end - high)) / _STEP)) + 1)
            places, heights = a + share * (b - a), high + share * (end - high)
            for k in np.flatnonzero(heights < room):
                near = slice(*np.searchsorted(at, [places[k] - room, places[k] + room]))
                lowest[near] = np.minimum(lowest[near], heights[k])
    free = np.concatenate([[False], lowest >= room, [False]])
    ends = np.flatnonzero(free[1:] != free[:-1]).reshape(-1, 2)
    found = [(float(at[a]), float(at[b - 1])) for a, b in ends if at[b - 1] - at[a] >= LEAST_BEARER]
    if not found or found[0][0] > -LEAST_BEARER or found[-1][1] < LEAST_BEARER:
        return float(lowest.min())
    return tuple(found)


def _place(part: Part, piece: Part) -> FloatArray:
    """The pose (4, 4) of a panel's block in the frame of its row."""
    out = np.eye(4)
    if piece.turned:
        out[:2, :2] = [[0.0, -1.0], [1.0, 0.0]]
    out[0, 3] = piece.x + 0.5 * piece.length - part.x - 0.5 * part.length
    out[1, 3] = piece.y + 0.5 * piece.width - part.y - 0.5 * part.width
    return out


def _one_way(each: Sequence[FloatArray], places: Sequence[FloatArray], far: float) -> list[FloatArray]:
    """Faces of all panels (2, N, 3) one behind the other, their rulings from ``-far`` to ``far`` [m] across
    the row."""
    found = []
    for (start, end), place in zip(each, places, strict=True):
        beside, behind = (float(place[:2, k] @ place[:2, 3]) for k in (0, 1))  # of the middle of its block
        share = (np.array([[-far], [far]]) - beside - start[:, 0]) / (end - start)[:, 0]
        own = start + share[..., None] * (end - start)
        found.append((behind * np.sign(own[0, -1, 1] - own[0, 0, 1]), transform(place, own)))
    return [own for _, own in sorted(found, key=lambda one: one[0])]


def _level(half: FloatArray, height: float) -> FloatArray:
    """The plane at a height [m] of a row as two rulings (2, 2, 3) that span its shorter side; its normal, the
    way of the first ends times the rulings, is up: the slot is above the panels."""
    x, y = half.tolist()
    corners = [[[-x, -y], [x, -y]], [[-x, y], [x, y]]]
    if y > x:
        corners = [[[x, -y], [x, y]], [[-x, -y], [-x, y]]]
    return np.insert(np.array(corners), 2, height, axis=-1)
