"""The kind ``strips``: a free-form surface in ruled strips side by side, each divided along its length.

Strips are ruled between lines of one parameter of the surface, smoothed along it; both parameters are tried.
All strips between lines that are near enough to the surface and hold panels that fit a block are known, as
far as a part of such a strip is one too; of all divisions into the fewest, a dynamic programme finds that
with the most even widths. Where neighbours meet, both end on the plane half-way between their normals, so
their backs have the line behind the joint in common.
"""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from planner.element.boxes import CUT_STEP, box_piece, most_even, strip_cuts
from planner.element.element_file import NODE_STEP, StripsElement
from planner.element.wall_panels import WallPanel, face_rulings, fitting, flat_box, in_block, numbered, rooms
from planner.geometry.arrays import FloatArray, IntArray, Ruled
from planner.geometry.mesh import TriangleMesh
from planner.geometry.mesh_queries import Nearness
from planner.geometry.ruled_approximation import Across, near_step
from planner.geometry.ruled_wall import CHORD, RuledWall
from planner.geometry.rulings import tessellate
from planner.geometry.surface_lines import Lines, mitred, smooth_lines
from planner.geometry.units import MM, measurement
from planner.issues import Issue, TandemError, refusal

ACROSS: Final[tuple[Across, ...]] = ("u", "v")
"""The parameters in whose direction strips may follow one another."""
ALONG: Final = 40
"""Rulings of a strip that are held against the surface in the search."""
SHARES: Final = np.linspace(0.0, 1.0, 9)
"""Places on rulings there."""
PLACES: Final = 6
"""Places along a strip where its lowest panel is held against blocks in the search."""
LOOSER: Final = 1.25
"""So much larger is each tolerance that is tried for a remedy, of which there are ``TRIES``."""
TRIES: Final = 12


@dataclasses.dataclass(frozen=True)
class Divided:
    """A divided surface: ``cuts`` (N + 1,), the lines between which its N strips lie, ``kinks`` (N - 1, M)
    [rad] along those that two of them share, and the strips, with mitres, as ``walls``; ``panels`` by
    their numbers, and ``off`` (P,) [m], how far the front of each is off the surface. ``tried``: strips and
    panels by parameter, where there is a division."""

    across: Across
    lines: Lines
    cuts: IntArray
    kinks: FloatArray
    walls: list[RuledWall]
    panels: tuple[WallPanel, ...]
    off: FloatArray
    tried: Mapping[Across, tuple[int, int]]

    def steps(self, k: int) -> tuple[int, int, int]:
        """The strip of a panel, and the first and last of the common steps along it that it takes."""
        piece = self.panels[k].piece
        strip = piece.place[0]
        first, last = np.searchsorted(self.walls[strip].nodes, np.array(piece.along) - 1e-9).tolist()
        return strip, first, last

    def kink(self, one: tuple[int, int, int], other: tuple[int, int, int]) -> float:
        """The largest angle [rad] between two neighbours where they meet; 0 within a strip."""
        if one[0] == other[0]:
            return 0.0
        first, last = max(one[1], other[1]), min(one[2], other[2])
        return float(self.kinks[min(one[0], other[0]), first : last + 1].max())


def divide_strips(element: StripsElement) -> Divided:
    """All panels by their numbers, across the parameter with the fewest panels, then the fewest strips.

    Raises ``TandemError``: ``element.surface`` for closed surfaces, ``element.tolerance`` with the tolerance
    and the count that would do, ``element.block`` where no block holds a panel, with the thickness that would
    fit, ``element.shape`` where the back would fold over.
    """
    near = Nearness(element.patch.mesh, near_step(element.patch.mesh))
    best = _best(element, near, element.wanted.tolerance_mm * MM, element.file.thickness_mm * MM)
    if best is None:
        raise TandemError(_refusal(element, near))
    _refuse_folds(element, best)
    return best


def _best(element: StripsElement, near: Nearness, tolerance: float, thickness: float) -> Divided | None:
    searches = (_Search(element, across, near, tolerance, thickness) for across in ACROSS)
    found = [made for search in searches if (made := search.divided()) is not None]
    if not found:
        return None
    best = min(found, key=lambda one: (len(one.panels), len(one.cuts), float(one.off.max())))
    tried = {one.across: (len(one.cuts) - 1, len(one.panels)) for one in found}
    return dataclasses.replace(best, tried=tried)


class _Search:
    """The division of a surface across one parameter, with what is known of the strips between its lines."""

    def __init__(
        self,
        element: StripsElement,
        across: Across,
        near: Nearness,
        tolerance: float,
        thickness: float,
        limit: float | None = None,
    ) -> None:
        self.element, self.across, self.near, self.thickness = element, across, near, thickness
        self.limit = tolerance if limit is None else limit
        self.lines = smooth_lines(element.patch, across, tolerance, NODE_STEP, near)
        self.rooms = rooms(element.file)
        width = element.wanted.least_width_mm * MM
        self.narrowest = np.searchsorted(self.lines.places, self.lines.places + width - 1e-9)
        self._off: dict[tuple[int, int], float] = {}
        self._fine: dict[tuple[int, int], float] = {}
        self._held: dict[tuple[int, int], bool] = {}

    def divided(self) -> Divided | None:
        """The fewest strips, the most even of them; None where there are none."""
        lines, last = self.lines, len(self.lines.places) - 1
        allowed = np.zeros((last + 1, last + 1), dtype=np.bool_)
        j = 1
        for i in range(last):
            j = max(j, int(self.narrowest[i]))
            while j <= last and self._fits(i, j):
                j += 1
            allowed[i, self.narrowest[i] : j] = True
        while (cuts := most_even(lines.places, allowed)) is not None:
            pairs = list(itertools.pairwise(cuts))
            over = [p for p in pairs if not self._fits(*p) or self._off_fine(*p) > self.limit]
            for pair in over:  # a part of what fits that does not fit
                allowed[pair] = False
            if over:
                continue
            found = self._panels(cuts)
            if isinstance(found, Divided):
                return found
            for i, j in (pairs[k] for k in found):  # nor does a wider one
                allowed[: i + 1, j:] = False
        return None

    def _fits(self, i: int, j: int) -> bool:
        return self.off(i, j) <= self.limit and self.held(i, j)

    def off(self, i: int, j: int) -> float:
        """How far the strip between two lines is off the surface [m], where it is looked at."""
        if (i, j) not in self._off:
            self._off[i, j] = self._seen(i, j, max(1, self.lines.points.shape[1] // ALONG))
        return self._off[i, j]

    def _off_fine(self, i: int, j: int) -> float:
        """The same [m], looked at on all rulings."""
        if (i, j) not in self._fine:
            self._fine[i, j] = self._seen(i, j, 1)
        return self._fine[i, j]

    def _seen(self, i: int, j: int, step: int) -> float:
        sight = _between(self.lines.points[[i, j]][:, ::step])
        return float(self.near.distance(sight.reshape(-1, 3))[0].max())

    def held(self, i: int, j: int) -> bool:
        """Whether the lowest panels of the strip between two lines fit blocks, where they are looked at."""
        if (i, j) not in self._held:
            wall, places = self.lines.wall(i, j), np.linspace(0.0, 1.0, PLACES)
            self._held[i, j] = all(fitting(self.box(wall, at), self.rooms) is not None for at in places)
        return self._held[i, j]

    def box(self, wall: RuledWall, place: float) -> FloatArray:
        """The box (3,) [m] of a panel of a strip that is as low as it may be, at that share of its length."""
        least = self.element.wanted.least_height_mm * MM + CUT_STEP  # cuts may lie that far apart
        high = min(least, float(wall.nodes[-1]))
        low = place * (float(wall.nodes[-1]) - high)
        faces = face_rulings(wall, self.thickness, wall.between(low, low + high), (0.0, 1.0))
        return flat_box(wall, (low, low + high), (0.0, 1.0), np.concatenate(faces).reshape(-1, 3))[1]

    def _panels(self, cuts: Sequence[int]) -> Divided | list[int]:
        """The division into the strips between those lines, or the strips whose panels fit no block or are
        too far off the surface."""
        file, least = self.element.file, self.element.wanted.least_height_mm * MM
        walls, kinks = mitred([self.lines.wall(i, j) for i, j in itertools.pairwise(cuts)])
        panels: list[WallPanel] = []
        wrong = []
        for k, wall in enumerate(walls):
            low = min(least, float(wall.nodes[-1]))
            ends = strip_cuts(wall, self.thickness, self.rooms, low, (0.0, 1.0))
            made = [
                in_block(
                    wall,
                    box_piece(wall, (k, i), part, (0.0, 1.0)),
                    self.thickness,
                    self.rooms,
                    (file.sides, file.faces),
                )
                for i, part in enumerate(itertools.pairwise([] if ends is None else ends.tolist()))
            ]
            panels += [panel for panel in made if panel is not None]
            if ends is None or None in made:
                wrong.append(k)
        if wrong:
            return wrong
        ordered = numbered(panels)
        off = _apart(ordered, walls, self.near)
        far = sorted(
            {panel.piece.place[0] for panel, own in zip(ordered, off, strict=True) if own > self.limit}
        )
        if far:
            return far
        return Divided(self.across, self.lines, np.array(cuts), kinks, walls, ordered, off, {})


def _between(ends: FloatArray) -> FloatArray:
    """Points (S, M, 3) on rulings by their ends (2, M, 3)."""
    share = SHARES[:, None, None]
    return np.asarray((1.0 - share) * ends[0] + share * ends[1])


def _apart(panels: Sequence[WallPanel], walls: Sequence[RuledWall], near: Nearness) -> FloatArray:
    """How far (P,) [m] the front of each panel and the surface are apart, looked at from both."""
    out, parts = [], []
    for panel in panels:
        wall = walls[panel.piece.place[0]]
        u = wall.between(*panel.piece.along)
        ends = wall.points(u, np.array([[0.0], [1.0]]) * np.ones_like(u))
        out.append(near.distance(_between(ends).reshape(-1, 3))[0].max())
        parts.append(
            tessellate(Ruled("strip", ends[0], ends[1], np.zeros(len(u), dtype=np.bool_)), 0.1 * CHORD)
        )
    first = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = np.concatenate([part.faces + at for part, at in zip(parts, first[:-1], strict=True)])
    whole = TriangleMesh(np.concatenate([part.vertices for part in parts]), faces)
    apart, face = Nearness(whole, near_step(near.mesh)).distance(near.mesh.vertices)
    owner = np.repeat(np.arange(len(parts)), [len(part.faces) for part in parts])[face]
    found = np.array(out)
    np.maximum.at(found, owner, apart)
    return found


def _refuse_folds(element: StripsElement, found: Divided) -> None:
    """Refuse a thickness at which a back would go backwards somewhere, along a strip or across it."""
    most, where = np.inf, np.zeros(3)
    for wall in found.walls:
        if wall.mitres is None:
            raise ValueError("strips are mitred")
        for axis in (0, 1):
            way, turn = np.diff(wall.ends, axis=axis), np.diff(wall.mitres, axis=axis)
            shrinks = np.maximum((way * turn).sum(axis=-1), 1e-12) / (way * way).sum(axis=-1)
            at = np.unravel_index(int(np.argmax(shrinks)), shrinks.shape)
            if 1.0 / shrinks[at] < most:
                most, where = float(1.0 / shrinks[at]), wall.ends[at]
    if element.file.thickness_mm * MM < most:
        return
    what = (
        f"the back of a surface {element.file.thickness_mm:g} mm thick folds over near {_at(where)} mm, "
        f"where it bends with a radius of {most / MM:.1f} mm to that side"
    )
    hint = f"give thickness_mm: {max(1.0, np.floor(0.9 * most / MM)):g}, or turn the surface over (flip)"
    limit, field = most / MM, "thickness_mm"
    raise refusal(
        "element.shape", what, field=field, **measurement(element.file.thickness_mm, limit, "mm"), hint=hint
    )


def _refusal(element: StripsElement, near: Nearness) -> Issue:
    """Why there is no division, and the nearest one that there is."""
    tolerance, thickness = element.wanted.tolerance_mm * MM, element.file.thickness_mm * MM
    searches = [_Search(element, across, near, tolerance, thickness) for across in ACROSS]
    free = [search for search in searches if all(search.held(*pair) for pair in _narrowest(search))]
    loose = (_Search(element, one.across, near, tolerance, thickness, np.inf) for one in free)
    if all(search.divided() is None for search in loose):
        return _too_large(element, searches)
    worst = [max((search.off(*pair), pair) for pair in _narrowest(search)) for search in free]
    (off, pair), search = min(zip(worst, free, strict=True), key=lambda one: one[0])
    place = _at(search.lines.points[list(pair)].mean(axis=(0, 1)))
    width = element.wanted.least_width_mm
    what = (
        f"no division into ruled strips of {width:g} mm and more is within "
        f"{element.wanted.tolerance_mm:g} mm of the surface: the narrowest are up to "
        f"{off / MM:.3g} mm off it, about {place} mm"
    )
    hint = "smooth the surface, cut it at its edges, or give a smaller least_width_mm"
    tried = max(off, tolerance)
    for _ in range(TRIES):
        tried *= LOOSER
        best = _best(element, near, np.ceil(tried / MM * 100.0) / 100.0 * MM, thickness)
        if best is not None:
            would = f"tolerance_mm: {np.ceil(tried / MM * 100.0) / 100.0:g}"
            hint = f"{would} would do, with {_counted(best)}; or {hint}"
            break
    limit, field = element.wanted.tolerance_mm, "panels.strips.tolerance_mm"
    return Issue("element.tolerance", what, field=field, value=off / MM, limit=limit, unit="mm", hint=hint)


def _too_large(element: StripsElement, searches: Sequence[_Search]) -> Issue:
    """The narrowest, lowest panel that blocks hold least, and the thickness that would fit."""
    file, search = element.file, searches[0]
    own = search.rooms
    cases = [(pair, place) for pair in _narrowest(search) for place in np.linspace(0.0, 1.0, PLACES).tolist()]
    boxes = np.array([search.box(search.lines.wall(*pair), place) for pair, place in cases])
    over = np.min([(boxes - room.size).max(axis=1) for room in own], axis=0)
    worst = int(np.argmax(over))
    pair, place = cases[worst]
    wall = search.lines.wall(*pair)
    near = _at(wall.points(np.array([place * wall.nodes[-1]]), np.array([0.5]))[0])
    around = 2.0 * np.array([file.sides, file.sides, file.faces])
    got, needed, has = (
        " x ".join(f"{v / MM:.0f}" for v in np.ceil(size / MM) * MM)
        for size in (boxes[worst] + around, boxes.max(axis=0) + around, own[-1].size + around)
    )
    what = (
        f"blocks do not hold panels as narrow and as low as allowed, or barely: near {near} mm one takes "
        f"{got} mm with foam beside it, the largest block has {has} mm within the span of the bow"
    )
    hint = f"blocks of {needed} mm would hold the lowest panels, or give smaller least sizes"
    low, high = 0, int(np.ceil(file.thickness_mm))
    tolerance = element.wanted.tolerance_mm * MM
    while high - low > 1:
        middle = (low + high) // 2
        thinner = _Search(element, search.across, search.near, tolerance, middle * MM)
        held = all(thinner.held(*own_pair) for own_pair in _narrowest(thinner))
        low, high = (middle, high) if held else (low, middle)
    best = _best(element, search.near, tolerance, low * MM) if low else None
    if best is not None:
        hint = f"thickness_mm: {low} would fit, with {_counted(best)}; {hint}"
    return Issue(
        "element.block", what, field="blocks", value=float(over[worst]) / MM, limit=0, unit="mm", hint=hint
    )


def _narrowest(search: _Search) -> list[tuple[int, int]]:
    """Pairs of lines between which strips are as narrow as they may be."""
    last = len(search.narrowest)
    pairs = [(i, int(j)) for i, j in enumerate(search.narrowest) if j < last]
    return pairs or [(0, last - 1)]


def _counted(found: Divided) -> str:
    return f"{len(found.panels)} panels in {len(found.cuts) - 1} strips across {found.across}"


def _at(point: FloatArray) -> str:
    return f"({', '.join(f'{v / MM:.0f}' for v in point)})"
