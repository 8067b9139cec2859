"""The kind ``strips``: a free-form surface in adjacent ruled strips, each divided along its length.

Strips are ruled between lines of one parameter of the surface, which are smoothed; both parameters are tried.
The search determines which strips between two lines are close enough to the surface and have panels that fit
a block. It assumes at first that a part of such a strip is one as well. Among all divisions into the fewest
strips, dynamic programming finds the one with the most even widths. Where neighbours meet, both end on the
plane halfway between their normals, so their backs share the line behind the joint.
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
"""Parameters of the surface along which strips may follow one another."""
SEARCH_RULINGS: Final = 40
"""Number of rulings of a strip that are compared with the surface in the search."""
RULING_FRACTIONS: Final = np.linspace(0.0, 1.0, 9)
"""Positions on rulings, as fractions, that are compared with the surface."""
SEARCH_POSITIONS: Final = 6
"""Number of positions along a strip at which a panel of minimum height is compared with blocks."""
TOLERANCE_FACTOR: Final = 1.25
"""Factor between successive tolerances that are tried for a remedy."""
MAX_TRIALS: Final = 12
"""Maximum number of tolerances that are tried for a remedy."""


@dataclasses.dataclass(frozen=True)
class StripDivision:
    """A divided surface.

    Attributes:
        across: Parameter along which strips follow one another.
        lines: Lines of the surface between which strips can lie.
        cuts: Indices (N + 1,) of the lines between which the N strips lie.
        kinks: Angles (N - 1, M) [rad] between the fronts of adjacent strips, along the lines that they share.
        walls: Strips as ruled walls that are mitred at the shared lines.
        panels: Panels in the order of their numbers.
        deviation: Maximum distance (P,) [m] of the front of each panel from the surface.
        tried: Numbers of strips and of panels for each parameter with a division.
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
        """Return the strip of the panel ``k``, and the indices of its nodes where the panel starts and ends.

        Nodes of equal index are at the same parameter in all strips.
        """
        piece = self.panels[k].piece
        strip = piece.grid_position[0]
        first, last = np.searchsorted(self.walls[strip].nodes, np.array(piece.along) - 1e-9).tolist()
        return strip, first, last

    def kink(self, first_steps: tuple[int, int, int], second_steps: tuple[int, int, int]) -> float:
        """Return the largest angle [rad] between two neighbours, by their `steps`; 0 within a strip."""
        if first_steps[0] == second_steps[0]:
            return 0.0
        first, last = max(first_steps[1], second_steps[1]), min(first_steps[2], second_steps[2])
        return float(self.kinks[min(first_steps[0], second_steps[0]), first : last + 1].max())


def divide_strips(element: StripsElement) -> StripDivision:
    """Compute all panels, across the parameter that gives the fewest panels, then the fewest strips.

    Raises:
        TandemError: ``element.surface`` if the surface is closed; ``element.tolerance`` if no division is
            close enough to it; ``element.block`` if no block holds a panel; ``element.shape`` if the back
            folds over.
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
    """Return the best division over both parameters for a tolerance and thickness [m], or None."""
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
    """Division of a surface across one parameter, with cached properties of the strips between its lines.

    ``tolerance`` [m] is that of the smoothed lines. Strips may deviate from the surface by ``limit`` [m],
    which is equal unless stated.
    """

    def __init__(
        self,
        element: StripsElement,
        across: Across,
        nearness: MeshDistance,
        tolerance: float,
        thickness: float,
        limit: float | None = None,
    ) -> None:
        self.element = element
        self.across = across
        self.nearness = nearness
        self.thickness = thickness
        self.limit = tolerance if limit is None else limit
        self.lines = smooth_lines(element.patch, across, tolerance, NODE_STEP_M, nearness)
        self.rooms = block_rooms(element.file)
        width = element.options.least_width_mm * MM
        # for each line, the first one with which a strip has the minimum width
        self.narrowest = np.searchsorted(
            self.lines.distances_across, self.lines.distances_across + width - 1e-9
        )
        self._deviation: dict[tuple[int, int], float] = {}
        self._fine: dict[tuple[int, int], float] = {}
        self._fit_cache: dict[tuple[int, int], bool] = {}

    def divide(self) -> StripDivision | None:
        """Return the division into the fewest strips, the most even ones of these; None if there is none."""
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
            unfit = [p for p in pairs if not self._fits(*p) or self._fine_deviation(*p) > self.limit]
            for pair in unfit:  # a part of a fitting strip may not fit
                allowed[pair] = False
            if unfit:
                continue
            division = self._place_panels(cuts)
            if isinstance(division, StripDivision):
                return division
            for i, j in (pairs[k] for k in division):  # strips that contain an infeasible one are infeasible
                allowed[: i + 1, j:] = False
        return None

    def _fits(self, i: int, j: int) -> bool:
        """Whether samples of the strip between two lines are close to the surface and fit blocks."""
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
        """Return the maximum distance [m] of every ``step``-th ruling from the surface."""
        samples = _ruling_points(self.lines.points[[i, j]][:, ::step])
        return float(self.nearness.distance(samples.reshape(-1, 3))[0].max())

    def fits_blocks(self, i: int, j: int) -> bool:
        """Whether panels of minimum height between two lines fit blocks, at sampled positions."""
        if (i, j) not in self._fit_cache:
            wall, positions = self.lines.wall(i, j), np.linspace(0.0, 1.0, SEARCH_POSITIONS)
            self._fit_cache[i, j] = all(
                first_fitting(self.box(wall, at), self.rooms) is not None for at in positions
            )
        return self._fit_cache[i, j]

    def box(self, wall: RuledWall, position: float) -> FloatArray:
        """Return the box (3,) [m] of a panel of minimum height of a strip, at a fraction of its length."""
        min_height = self.element.options.least_height_mm * MM + CUT_STEP_M  # cuts may lie that far apart
        high = min(min_height, float(wall.nodes[-1]))
        low = position * (float(wall.nodes[-1]) - high)
        faces = face_rulings(wall, self.thickness, wall.nodes_between(low, low + high), (0.0, 1.0))
        return flat_box(wall, (low, low + high), (0.0, 1.0), np.concatenate(faces).reshape(-1, 3))[1]

    def _place_panels(self, cuts: Sequence[int]) -> StripDivision | list[int]:
        """Return the division into strips between the lines ``cuts``, or the indices of infeasible strips.

        A strip is infeasible if a panel of it fits no block or is too far from the surface.
        """
        file = self.element.file
        min_height = self.element.options.least_height_mm * MM
        walls, kinks = mitred([self.lines.wall(i, j) for i, j in itertools.pairwise(cuts)])
        panels: list[WallPanel] = []
        infeasible = []
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
                infeasible.append(k)
        if infeasible:
            return infeasible
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
    """Return points (S, M, 3) at `RULING_FRACTIONS` of rulings with the ends (2, M, 3)."""
    fractions = RULING_FRACTIONS[:, None, None]
    return np.asarray((1.0 - fractions) * ends[0] + fractions * ends[1])


def _deviations(
    panels: Sequence[WallPanel], walls: Sequence[RuledWall], nearness: MeshDistance
) -> FloatArray:
    """Return the maximum distance (P,) [m] between each panel's front and the surface, measured both ways."""
    max_distances, parts = [], []
    for panel in panels:
        wall = walls[panel.piece.grid_position[0]]
        u = wall.nodes_between(*panel.piece.along)
        ends = wall.points(u, np.array([[0.0], [1.0]]) * np.ones_like(u))
        max_distances.append(nearness.distance(_ruling_points(ends).reshape(-1, 3))[0].max())
        parts.append(
            tessellate(
                RuledSurface("strip", ends[0], ends[1], np.zeros(len(u), dtype=np.bool_)), 0.1 * CHORD_ERROR_M
            )
        )
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = np.concatenate([part.faces + offset for part, offset in zip(parts, starts[:-1], strict=True)])
    fronts = TriangleMesh(np.concatenate([part.vertices for part in parts]), faces)
    distances, face = MeshDistance(fronts, deviation_step(nearness.mesh)).distance(nearness.mesh.vertices)
    panel_of_face = np.repeat(np.arange(len(parts)), [len(part.faces) for part in parts])[face]
    out_array = np.array(max_distances)
    np.maximum.at(out_array, panel_of_face, distances)
    return out_array


def _refuse_folds(element: StripsElement, division: StripDivision) -> None:
    """Raise ``element.shape`` if the back folds over somewhere, along a strip or across it."""
    max_thickness, worst = np.inf, np.zeros(3)
    for wall in division.walls:
        if wall.mitres is None:
            raise ValueError("strips are mitred")
        for axis in (0, 1):
            edges, mitre_steps = np.diff(wall.ends, axis=axis), np.diff(wall.mitres, axis=axis)
            # an edge e becomes e - h m with the mitres' difference m: it vanishes at h = e.e / e.m
            shrinkage = np.maximum((edges * mitre_steps).sum(axis=-1), 1e-12) / (edges * edges).sum(axis=-1)
            index = np.unravel_index(int(np.argmax(shrinkage)), shrinkage.shape)
            if 1.0 / shrinkage[index] < max_thickness:
                max_thickness, worst = float(1.0 / shrinkage[index]), wall.ends[index]
    if element.file.thickness_mm * MM < max_thickness:
        return
    text = (
        f"the back of a surface {element.file.thickness_mm:g} mm thick folds over near {_point_text(worst)} "
        f"mm, where it bends with a radius of {max_thickness / MM:.1f} mm to that side"
    )
    hint = (
        f"give thickness_mm: {max(1.0, np.floor(0.9 * max_thickness / MM)):g}, or reverse the surface (flip)"
    )
    limit, field = max_thickness / MM, "thickness_mm"
    raise issue_error(
        "element.shape", text, field=field, **measurement(element.file.thickness_mm, limit, "mm"), hint=hint
    )


def _division_issue(element: StripsElement, nearness: MeshDistance) -> Issue:
    """Return the issue that there is no division, with a tolerance or thickness with which there is one."""
    tolerance, thickness = element.options.tolerance_mm * MM, element.file.thickness_mm * MM
    searches = [_StripSearch(element, across, nearness, tolerance, thickness) for across in ACROSS]
    fitting = [
        search for search in searches if all(search.fits_blocks(*pair) for pair in _narrowest_pairs(search))
    ]
    unlimited = (
        _StripSearch(element, candidate.across, nearness, tolerance, thickness, np.inf)
        for candidate in fitting
    )
    if all(search.divide() is None for search in unlimited):
        return _too_large(element, searches)
    worst = [max((search.deviation(*pair), pair) for pair in _narrowest_pairs(search)) for search in fitting]
    (deviation, pair), search = min(zip(worst, fitting, strict=True), key=lambda candidate: candidate[0])
    location = _point_text(search.lines.points[list(pair)].mean(axis=(0, 1)))
    width = element.options.least_width_mm
    message = (
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
            advice = f"tolerance_mm: {np.ceil(tried / MM * 100.0) / 100.0:g}"
            hint = f"{advice} would suffice, with {_count_text(best)}; or {hint}"
            break
    limit, field = element.options.tolerance_mm, "panels.strips.tolerance_mm"
    return Issue(
        "element.tolerance", message, field=field, value=deviation / MM, limit=limit, unit="mm", hint=hint
    )


def _too_large(element: StripsElement, searches: Sequence[_StripSearch]) -> Issue:
    """Return the issue that blocks do not even hold panels of minimum size, with a thickness that fits."""
    file, search = element.file, searches[0]
    block_rooms = search.rooms
    cases = [
        (pair, position)
        for pair in _narrowest_pairs(search)
        for position in np.linspace(0.0, 1.0, SEARCH_POSITIONS).tolist()
    ]
    boxes = np.array([search.box(search.lines.wall(*pair), position) for pair, position in cases])
    excess = np.min([(boxes - room.size).max(axis=1) for room in block_rooms], axis=0)
    worst_index = int(np.argmax(excess))
    pair, position = cases[worst_index]
    wall = search.lines.wall(*pair)
    location = _point_text(wall.points(np.array([position * wall.nodes[-1]]), np.array([0.5]))[0])
    foam = 2.0 * np.array([file.sides, file.sides, file.faces])
    got, needed, largest = (
        " x ".join(f"{v / MM:.0f}" for v in np.ceil(size / MM) * MM)
        for size in (boxes[worst_index] + foam, boxes.max(axis=0) + foam, block_rooms[-1].size + foam)
    )
    text = (
        f"blocks hold even the smallest allowed panels hardly or not: near {location} mm one needs "
        f"{got} mm with foam around it, the largest block has {largest} mm within the span of the bow"
    )
    hint = f"blocks of {needed} mm would hold the lowest panels, or give smaller minimum sizes"
    # bisection for the largest whole thickness [mm] at which panels of minimum size fit
    low, high = 0, int(np.ceil(file.thickness_mm))
    tolerance = element.options.tolerance_mm * MM
    while high - low > 1:
        middle = (low + high) // 2
        thinner = _StripSearch(element, search.across, search.nearness, tolerance, middle * MM)
        fits = all(thinner.fits_blocks(*own_pair) for own_pair in _narrowest_pairs(thinner))
        low, high = (middle, high) if fits else (low, middle)
    best = _best_division(element, search.nearness, tolerance, low * MM) if low else None
    if best is not None:
        hint = f"thickness_mm: {low} would fit, with {_count_text(best)}; {hint}"
    return Issue(
        "element.block",
        text,
        field="blocks",
        value=float(excess[worst_index]) / MM,
        limit=0,
        unit="mm",
        hint=hint,
    )


def _narrowest_pairs(search: _StripSearch) -> list[tuple[int, int]]:
    """Return the pairs of lines between which strips have the minimum width; else the first and last line."""
    last = len(search.narrowest)
    pairs = [(i, int(j)) for i, j in enumerate(search.narrowest) if j < last]
    return pairs or [(0, last - 1)]


def _count_text(division: StripDivision) -> str:
    return f"{len(division.panels)} panels in {len(division.cuts) - 1} strips across {division.across}"


def _point_text(point: FloatArray) -> str:
    return f"({', '.join(f'{v / MM:.0f}' for v in point)})"
