"""The kind ``strips``: a free-form surface in adjacent ruled strips, each divided along its length.

Strips are ruled between lines of one parameter of the surface, smoothed along it; both parameters are tried.
All strips between lines that are close enough to the surface and hold panels that fit a block are known, as
far as a part of a strip inherits this. Among all divisions into the fewest strips, dynamic programming finds
the one with the most even widths. Where neighbours meet, both end on the plane halfway between their normals,
so their backs share the line behind the joint.
"""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from planner.element.boxes import CUT_STEP_M, box_piece, most_even_cuts, strip_cuts
from planner.element.element_file import NODE_STEP_M, StripsElement
from planner.element.wall_panels import (
    WallPanel,
    block_rooms,
    face_rulings,
    first_fitting,
    flat_box,
    place_in_block,
    sort_panels,
)
from planner.geometry.arrays import FloatArray, IntArray, RuledSurface
from planner.geometry.mesh import TriangleMesh
from planner.geometry.mesh_queries import MeshDistance
from planner.geometry.ruled_approximation import Across, deviation_step
from planner.geometry.ruled_wall import CHORD_ERROR_M, RuledWall
from planner.geometry.rulings import tessellate
from planner.geometry.surface_lines import SurfaceLines, mitred, smooth_lines
from planner.geometry.units import MM, measurement
from planner.issues import Issue, TandemError, issue_error

ACROSS: Final[tuple[Across, ...]] = ("u", "v")
"""Parameters in whose direction strips may follow one another."""
SEARCH_RULINGS: Final = 40
"""Number of rulings of a strip that are compared with the surface in the search."""
RULING_FRACTIONS: Final = np.linspace(0.0, 1.0, 9)
"""Positions on rulings that are compared with the surface in the search."""
SEARCH_POSITIONS: Final = 6
"""Number of positions along a strip at which its lowest panel is compared with blocks in the search."""
TOLERANCE_FACTOR: Final = 1.25
"""Factor between the ``MAX_TRIALS`` tolerances that are tried for a remedy."""
MAX_TRIALS: Final = 12


@dataclasses.dataclass(frozen=True)
class StripDivision:
    """A divided surface.

    Attributes:
        across: Parameter in whose direction strips follow one another.
        lines: Lines.
        cuts: Lines (N + 1,) between which its N strips lie.
        kinks: Angles (N - 1, M) [rad] along the lines that two strips share.
        walls: Strips with mitres.
        panels: Panels by number.
        deviation: Maximum distance (P,) [m] of the front of each panel from the surface.
        tried: Numbers of strips and panels by parameter, if there is a division.
    """

    across: Across
    lines: SurfaceLines
    cuts: IntArray
    kinks: FloatArray
    walls: list[RuledWall]
    panels: tuple[WallPanel, ...]
    deviation: FloatArray
    tried: Mapping[Across, tuple[int, int]]

    def steps(self, k: int) -> tuple[int, int, int]:
        """Return the strip of a panel, and the first and last of the common steps along it that it takes."""
        piece = self.panels[k].piece
        strip = piece.grid_position[0]
        first, last = np.searchsorted(self.walls[strip].nodes, np.array(piece.along) - 1e-9).tolist()
        return strip, first, last

    def kink(self, first_steps: tuple[int, int, int], second_steps: tuple[int, int, int]) -> float:
        """Return the largest angle [rad] between two neighbours where they meet; 0 within a strip."""
        if first_steps[0] == second_steps[0]:
            return 0.0
        first, last = max(first_steps[1], second_steps[1]), min(first_steps[2], second_steps[2])
        return float(self.kinks[min(first_steps[0], second_steps[0]), first : last + 1].max())


def divide_strips(element: StripsElement) -> StripDivision:
    """Compute all panels, across the parameter with the fewest panels, then the fewest strips.

    Raises:
        TandemError: ``element.surface`` for closed surfaces; ``element.tolerance`` with a sufficient
            tolerance and its count; ``element.block`` if no block holds a panel, with a thickness that fits;
            ``element.shape`` if the back folds over.
    """
    nearness = MeshDistance(element.patch.mesh, deviation_step(element.patch.mesh))
    best = _best_division(
        element, nearness, element.options.tolerance_mm * MM, element.file.thickness_mm * MM
    )
    if best is None:
        raise TandemError(_division_issue(element, nearness))
    _refuse_folds(element, best)
    return best


def _best_division(
    element: StripsElement, nearness: MeshDistance, tolerance: float, thickness: float
) -> StripDivision | None:
    searches = (_StripSearch(element, across, nearness, tolerance, thickness) for across in ACROSS)
    divisions = [candidate for search in searches if (candidate := search.divide()) is not None]
    if not divisions:
        return None
    best = min(
        divisions,
        key=lambda division: (len(division.panels), len(division.cuts), float(division.deviation.max())),
    )
    tried = {division.across: (len(division.cuts) - 1, len(division.panels)) for division in divisions}
    return dataclasses.replace(best, tried=tried)


class _StripSearch:
    """Division of a surface across one parameter, with cached properties of the strips between its lines."""

    def __init__(
        self,
        element: StripsElement,
        across: Across,
        nearness: MeshDistance,
        tolerance: float,
        thickness: float,
        limit: float | None = None,
    ) -> None:
        self.element, self.across, self.nearness, self.thickness = element, across, nearness, thickness
        self.limit = tolerance if limit is None else limit
        self.lines = smooth_lines(element.patch, across, tolerance, NODE_STEP_M, nearness)
        self.rooms = block_rooms(element.file)
        width = element.options.least_width_mm * MM
        self.narrowest = np.searchsorted(
            self.lines.distances_across, self.lines.distances_across + width - 1e-9
        )
        self._deviation: dict[tuple[int, int], float] = {}
        self._fine: dict[tuple[int, int], float] = {}
        self._fit_cache: dict[tuple[int, int], bool] = {}

    def divide(self) -> StripDivision | None:
        """Return the division into the fewest, most even strips; None if there is none."""
        lines, last = self.lines, len(self.lines.distances_across) - 1
        allowed = np.zeros((last + 1, last + 1), dtype=np.bool_)
        j = 1
        for i in range(last):
            j = max(j, int(self.narrowest[i]))
            while j <= last and self._fits(i, j):
                j += 1
            allowed[i, self.narrowest[i] : j] = True
        while (cuts := most_even_cuts(lines.distances_across, allowed)) is not None:
            pairs = list(itertools.pairwise(cuts))
            over = [p for p in pairs if not self._fits(*p) or self._fine_deviation(*p) > self.limit]
            for pair in over:  # a part of a fitting strip may not fit
                allowed[pair] = False
            if over:
                continue
            division = self._place_panels(cuts)
            if isinstance(division, StripDivision):
                return division
            for i, j in (pairs[k] for k in division):  # nor do wider ones
                allowed[: i + 1, j:] = False
        return None

    def _fits(self, i: int, j: int) -> bool:
        return self.deviation(i, j) <= self.limit and self.fits_blocks(i, j)

    def deviation(self, i: int, j: int) -> float:
        """Return the distance [m] of the strip between two lines from the surface, at sampled rulings."""
        if (i, j) not in self._deviation:
            self._deviation[i, j] = self._sampled_deviation(
                i, j, max(1, self.lines.points.shape[1] // SEARCH_RULINGS)
            )
        return self._deviation[i, j]

    def _fine_deviation(self, i: int, j: int) -> float:
        """Return the distance [m] of the strip between two lines from the surface, at all rulings."""
        if (i, j) not in self._fine:
            self._fine[i, j] = self._sampled_deviation(i, j, 1)
        return self._fine[i, j]

    def _sampled_deviation(self, i: int, j: int, step: int) -> float:
        sight = _ruling_points(self.lines.points[[i, j]][:, ::step])
        return float(self.nearness.distance(sight.reshape(-1, 3))[0].max())

    def fits_blocks(self, i: int, j: int) -> bool:
        """Whether the lowest panels of the strip between two lines fit blocks, at sampled positions."""
        if (i, j) not in self._fit_cache:
            wall, positions = self.lines.wall(i, j), np.linspace(0.0, 1.0, SEARCH_POSITIONS)
            self._fit_cache[i, j] = all(
                first_fitting(self.box(wall, at), self.rooms) is not None for at in positions
            )
        return self._fit_cache[i, j]

    def box(self, wall: RuledWall, position: float) -> FloatArray:
        """Return the box (3,) [m] of the lowest allowed panel of a strip, at a fraction of its length."""
        min_height = self.element.options.least_height_mm * MM + CUT_STEP_M  # cuts may lie that far apart
        high = min(min_height, float(wall.nodes[-1]))
        low = position * (float(wall.nodes[-1]) - high)
        faces = face_rulings(wall, self.thickness, wall.nodes_between(low, low + high), (0.0, 1.0))
        return flat_box(wall, (low, low + high), (0.0, 1.0), np.concatenate(faces).reshape(-1, 3))[1]

    def _place_panels(self, cuts: Sequence[int]) -> StripDivision | list[int]:
        """Return the division into the strips between those lines, or the infeasible strips.

        Strips are infeasible if their panels fit no block or are too far from the surface.
        """
        file, min_height = self.element.file, self.element.options.least_height_mm * MM
        walls, kinks = mitred([self.lines.wall(i, j) for i, j in itertools.pairwise(cuts)])
        panels: list[WallPanel] = []
        wrong = []
        for k, wall in enumerate(walls):
            low = min(min_height, float(wall.nodes[-1]))
            ends = strip_cuts(wall, self.thickness, self.rooms, low, (0.0, 1.0))
            placed_panels = [
                place_in_block(
                    wall,
                    box_piece(wall, (k, i), part, (0.0, 1.0)),
                    self.thickness,
                    self.rooms,
                    (file.sides, file.faces),
                )
                for i, part in enumerate(itertools.pairwise([] if ends is None else ends.tolist()))
            ]
            panels += [panel for panel in placed_panels if panel is not None]
            if ends is None or None in placed_panels:
                wrong.append(k)
        if wrong:
            return wrong
        ordered = sort_panels(panels)
        deviations = _deviations(ordered, walls, self.nearness)
        far_strips = sorted(
            {
                panel.piece.grid_position[0]
                for panel, deviation in zip(ordered, deviations, strict=True)
                if deviation > self.limit
            }
        )
        if far_strips:
            return far_strips
        return StripDivision(self.across, self.lines, np.array(cuts), kinks, walls, ordered, deviations, {})


def _ruling_points(ends: FloatArray) -> FloatArray:
    """Return points (S, M, 3) on rulings by their ends (2, M, 3)."""
    fractions = RULING_FRACTIONS[:, None, None]
    return np.asarray((1.0 - fractions) * ends[0] + fractions * ends[1])


def _deviations(
    panels: Sequence[WallPanel], walls: Sequence[RuledWall], nearness: MeshDistance
) -> FloatArray:
    """Return the distance (P,) [m] between the front of each panel and the surface, measured from both."""
    out, parts = [], []
    for panel in panels:
        wall = walls[panel.piece.grid_position[0]]
        u = wall.nodes_between(*panel.piece.along)
        ends = wall.points(u, np.array([[0.0], [1.0]]) * np.ones_like(u))
        out.append(nearness.distance(_ruling_points(ends).reshape(-1, 3))[0].max())
        parts.append(
            tessellate(
                RuledSurface("strip", ends[0], ends[1], np.zeros(len(u), dtype=np.bool_)), 0.1 * CHORD_ERROR_M
            )
        )
    first = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = np.concatenate([part.faces + at for part, at in zip(parts, first[:-1], strict=True)])
    whole = TriangleMesh(np.concatenate([part.vertices for part in parts]), faces)
    distances, face = MeshDistance(whole, deviation_step(nearness.mesh)).distance(nearness.mesh.vertices)
    owner = np.repeat(np.arange(len(parts)), [len(part.faces) for part in parts])[face]
    out_array = np.array(out)
    np.maximum.at(out_array, owner, distances)
    return out_array


def _refuse_folds(element: StripsElement, division: StripDivision) -> None:
    """Refuse a thickness at which a back reverses somewhere, along a strip or across it."""
    max_thickness, where = np.inf, np.zeros(3)
    for wall in division.walls:
        if wall.mitres is None:
            raise ValueError("strips are mitred")
        for axis in (0, 1):
            edges, turn = np.diff(wall.ends, axis=axis), np.diff(wall.mitres, axis=axis)
            shrinks = np.maximum((edges * turn).sum(axis=-1), 1e-12) / (edges * edges).sum(axis=-1)
            at = np.unravel_index(int(np.argmax(shrinks)), shrinks.shape)
            if 1.0 / shrinks[at] < max_thickness:
                max_thickness, where = float(1.0 / shrinks[at]), wall.ends[at]
    if element.file.thickness_mm * MM < max_thickness:
        return
    what = (
        f"the back of a surface {element.file.thickness_mm:g} mm thick folds over near {_point_text(where)} "
        f"mm, where it bends with a radius of {max_thickness / MM:.1f} mm to that side"
    )
    hint = (
        f"give thickness_mm: {max(1.0, np.floor(0.9 * max_thickness / MM)):g}, or reverse the surface (flip)"
    )
    limit, field = max_thickness / MM, "thickness_mm"
    raise issue_error(
        "element.shape", what, field=field, **measurement(element.file.thickness_mm, limit, "mm"), hint=hint
    )


def _division_issue(element: StripsElement, nearness: MeshDistance) -> Issue:
    """Return why there is no division, and the closest one that exists."""
    tolerance, thickness = element.options.tolerance_mm * MM, element.file.thickness_mm * MM
    searches = [_StripSearch(element, across, nearness, tolerance, thickness) for across in ACROSS]
    free = [
        search for search in searches if all(search.fits_blocks(*pair) for pair in _narrowest_pairs(search))
    ]
    loose = (
        _StripSearch(element, candidate.across, nearness, tolerance, thickness, np.inf) for candidate in free
    )
    if all(search.divide() is None for search in loose):
        return _too_large(element, searches)
    worst = [max((search.deviation(*pair), pair) for pair in _narrowest_pairs(search)) for search in free]
    (deviation, pair), search = min(zip(worst, free, strict=True), key=lambda candidate: candidate[0])
    location = _point_text(search.lines.points[list(pair)].mean(axis=(0, 1)))
    width = element.options.least_width_mm
    what = (
        f"no division into ruled strips of {width:g} mm and more is within "
        f"{element.options.tolerance_mm:g} mm of the surface: the narrowest are up to "
        f"{deviation / MM:.3g} mm off it, about {location} mm"
    )
    hint = "smooth the surface, cut it at its edges, or give a smaller least_width_mm"
    tried = max(deviation, tolerance)
    for _ in range(MAX_TRIALS):
        tried *= TOLERANCE_FACTOR
        best = _best_division(element, nearness, np.ceil(tried / MM * 100.0) / 100.0 * MM, thickness)
        if best is not None:
            would = f"tolerance_mm: {np.ceil(tried / MM * 100.0) / 100.0:g}"
            hint = f"{would} would suffice, with {_count_text(best)}; or {hint}"
            break
    limit, field = element.options.tolerance_mm, "panels.strips.tolerance_mm"
    return Issue(
        "element.tolerance", what, field=field, value=deviation / MM, limit=limit, unit="mm", hint=hint
    )


def _too_large(element: StripsElement, searches: Sequence[_StripSearch]) -> Issue:
    """Return the issue of the narrowest, lowest panel that blocks hold least, and a thickness that fits."""
    file, search = element.file, searches[0]
    block_rooms = search.rooms
    cases = [
        (pair, position)
        for pair in _narrowest_pairs(search)
        for position in np.linspace(0.0, 1.0, SEARCH_POSITIONS).tolist()
    ]
    boxes = np.array([search.box(search.lines.wall(*pair), position) for pair, position in cases])
    over = np.min([(boxes - room.size).max(axis=1) for room in block_rooms], axis=0)
    worst = int(np.argmax(over))
    pair, position = cases[worst]
    wall = search.lines.wall(*pair)
    location = _point_text(wall.points(np.array([position * wall.nodes[-1]]), np.array([0.5]))[0])
    around = 2.0 * np.array([file.sides, file.sides, file.faces])
    got, needed, has = (
        " x ".join(f"{v / MM:.0f}" for v in np.ceil(size / MM) * MM)
        for size in (boxes[worst] + around, boxes.max(axis=0) + around, block_rooms[-1].size + around)
    )
    what = (
        f"blocks hold even the smallest allowed panels hardly or not: near {location} mm one needs "
        f"{got} mm with foam around it, the largest block has {has} mm within the span of the bow"
    )
    hint = f"blocks of {needed} mm would hold the lowest panels, or give smaller minimum sizes"
    low, high = 0, int(np.ceil(file.thickness_mm))
    tolerance = element.options.tolerance_mm * MM
    while high - low > 1:
        middle = (low + high) // 2
        thinner = _StripSearch(element, search.across, search.nearness, tolerance, middle * MM)
        held = all(thinner.fits_blocks(*own_pair) for own_pair in _narrowest_pairs(thinner))
        low, high = (middle, high) if held else (low, middle)
    best = _best_division(element, search.nearness, tolerance, low * MM) if low else None
    if best is not None:
        hint = f"thickness_mm: {low} would fit, with {_count_text(best)}; {hint}"
    return Issue(
        "element.block", what, field="blocks", value=float(over[worst]) / MM, limit=0, unit="mm", hint=hint
    )


def _narrowest_pairs(search: _StripSearch) -> list[tuple[int, int]]:
    """Return pairs of lines between which strips have the minimum width."""
    last = len(search.narrowest)
    pairs = [(i, int(j)) for i, j in enumerate(search.narrowest) if j < last]
    return pairs or [(0, last - 1)]


def _count_text(division: StripDivision) -> str:
    return f"{len(division.panels)} panels in {len(division.cuts) - 1} strips across {division.across}"


def _point_text(point: FloatArray) -> str:
    return f"({', '.join(f'{v / MM:.0f}' for v in point)})"
