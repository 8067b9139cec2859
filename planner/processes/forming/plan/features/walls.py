"""Walls of a part: monotonic runs of the contour tree, split at terraces; each wall is one feature.

**Skeleton**: the contour tree without noise, that is, nodes where features start and end, and walls between
them. A branch that stays within ``noise`` of the height of its fork is not a feature. Nor is the smaller
of two branches if it is smaller in plan than any tool: its vertices count as part of the fork. Forks within
``noise`` of each other are one node, because noise on a flat produces such forks.

**Terraces**: a feature ends where a wall pauses on a flat, and the next one starts. The level lines of a wall
that continues in the same direction after a flat (a stepped dish, a single dimple in a floor) are nested
throughout. The flat shows only as a sudden change of the plan area that they enclose. Between levels
``noise`` apart the mean width of the surface in plan is that change divided by the length of the line.

**Walls** are the maximal monotonic runs of a skeleton, split at terraces.
"""

import dataclasses
from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.processes.forming.plan.features.surface import ContourTree, SheetSurface, plan_areas

MAX_TERRACE_WIDTH_M: Final = 1e-3
"""Mean width [m] in plan, within a height of ``noise``, from which a flat may be a terrace: 3 degrees."""
TERRACE_WIDTH_RADIUS_FRACTION: Final = 0.1
"""Mean width in plan from which a flat may be a terrace, as a fraction of the radius of a circle as large as
the feature there. The smaller of this and `MAX_TERRACE_WIDTH_M` counts.
"""
MIN_TERRACE_WIDTH_M: Final = 0.4e-3
"""Mean width [m] below which nothing is a terrace."""
MIN_TERRACE_CONTRAST: Final = 3.0
"""Minimum ratio of the width of a terrace to that of the wall before it and after it."""
MIN_WALL_HEIGHT_FACTOR: Final = 2.0
"""Minimum height of those walls, in units of ``noise``."""


@dataclasses.dataclass(frozen=True)
class Terrace:
    """Flat that separates two features of a wall.

    Attributes:
        level: Level [m] at which one feature ends and the next one starts.
        first: Level [m] before which level lines are clean, in the direction of the wall.
        last: Level [m] after which level lines are clean.
    """

    level: float
    first: float
    last: float


class _CumulativeArea:
    """Plan area [m^2] of a wall's faces up to a depth [m] from the start of the wall.

    The area A of a face from depth a to b is spread evenly: it contributes A (clip(d, a, b) - a) / (b - a).
    """

    def __init__(self, first_depth: FloatArray, last_depth: FloatArray, area: FloatArray) -> None:
        rate = area / (last_depth - first_depth)
        by_first, by_last = np.argsort(first_depth), np.argsort(last_depth)
        self.first_depths, self.last_depths = first_depth[by_first], last_depth[by_last]
        self.sums = tuple(
            np.concatenate([[0.0], np.cumsum(values)])
            for values in (
                rate[by_first],
                (rate * first_depth)[by_first],
                rate[by_last],
                (rate * last_depth)[by_last],
            )
        )

    def __call__(self, depth: FloatArray) -> FloatArray:
        """Return the areas (N,) [m^2] up to depths (N,) [m]."""
        # numbers of faces that start, and that end, up to each depth
        i = np.searchsorted(self.first_depths, depth)
        j = np.searchsorted(self.last_depths, depth)
        started, started_moment, ended, ended_moment = self.sums
        return np.asarray(depth * started[i] - started_moment[i] - depth * ended[j] + ended_moment[j])


@dataclasses.dataclass(frozen=True)
class WallFaces:
    """Faces of a wall.

    Attributes:
        low: Lower levels (F,) [m] of the faces.
        high: Upper levels (F,) [m] of the faces.
        area: Plan areas (F,) [m^2] of the faces.
    """

    low: FloatArray
    high: FloatArray
    area: FloatArray


def find_terraces(faces: WallFaces, inside: float, start: float, end: float, noise: float) -> list[Terrace]:
    """Return the terraces of a wall, ordered from its start to its end, at which it is divided into features.

    A terrace is a run of heights at which the wall is much wider in plan than the walls before and after it.

    Args:
        faces: Faces of the wall.
        inside: Plan area [m^2] that the wall's first level line encloses, with the wall itself.
        start: Level [m] at which the wall starts.
        end: Level [m] at which it ends.
        noise: Height [m] of the mesh's noise.
    """
    total = abs(end - start)
    if total < 2.0 * MIN_WALL_HEIGHT_FACTOR * noise or len(faces.area) == 0:
        return []
    sign = 1.0 if end > start else -1.0
    first_depth = np.clip(np.where(sign > 0, faces.low - start, start - faces.high), 0.0, total)
    last_depth = np.clip(np.where(sign > 0, faces.high - start, start - faces.low), 0.0, total)
    cell = noise / 5.0
    depths = np.arange(0.5 * cell, total, cell)
    cumulative = _CumulativeArea(first_depth, np.maximum(last_depth, first_depth + 0.01 * cell), faces.area)
    change = cumulative(depths + 0.5 * noise) - cumulative(depths - 0.5 * noise)
    radius = np.sqrt(np.maximum(inside - cumulative(depths - 0.5 * noise), 1e-12) / np.pi)
    # mean width in plan: area between levels ``noise`` apart, divided by the length of a circular level line
    width = change / (2.0 * np.pi * radius)
    is_flat = width >= np.maximum(
        np.clip(TERRACE_WIDTH_RADIUS_FRACTION * radius, MIN_TERRACE_WIDTH_M, MAX_TERRACE_WIDTH_M),
        MIN_TERRACE_CONTRAST * _adjacent_wall_width(width, noise / cell),
    )
    bounds = np.nonzero(np.diff(np.concatenate([[0], is_flat.astype(np.int8), [0]])))[0].reshape(-1, 2)
    return [_terrace(first * cell, stop * cell, cumulative, start, sign, noise) for first, stop in bounds]


def _adjacent_wall_width(width: FloatArray, cells: float) -> FloatArray:
    """Return, for each cell of height, the plan width with which a terrace there is compared.

    A wall is a run of cells `MIN_WALL_HEIGHT_FACTOR` times the noise high, and its width is that of its
    widest cell. The steepest wall on each side of the cell is taken, and of these two widths the greater one.
    It is infinite if there is no wall on one side. ``width`` has the plan width [m] of each cell, and
    ``cells`` is the number of cells per noise.
    """
    window = round(MIN_WALL_HEIGHT_FACTOR * cells)
    previous = np.full(len(width), np.inf)
    following = previous.copy()
    if len(width) > window:
        widest = sliding_window_view(width, window).max(axis=1)
        previous[window:] = np.minimum.accumulate(widest)[:-1]
        following[:-window] = np.minimum.accumulate(widest[::-1])[::-1][1:]
    return np.asarray(np.maximum(previous, following))


def _terrace(
    first: float, last: float, cumulative: _CumulativeArea, start: float, sign: float, noise: float
) -> Terrace:
    """Return the terrace that belongs to a run of flat cells from depth ``first`` to ``last`` [m].

    A flat that is higher than the noise is a gentle slope: its level lines belong to the previous wall, and
    the terrace is at its end. Otherwise the terrace is at the depth that divides its area in two. Depths
    count from the wall's ``start`` [m], upward for a ``sign`` of +1.
    """
    # the window of heights extends a flat by half its size on both sides
    first, last = sorted((first + 0.5 * noise, last - 0.5 * noise))
    cell = noise / 5.0
    if last - first > noise:  # it slopes: its own level lines belong to the previous wall
        # the steeper it is, the farther before its end the window contains too much of the next wall
        rate = float(np.diff(cumulative(np.array([first, last])))[0]) / (last - first)
        depths = np.linspace(last, last + 1.5 * noise, 76)
        is_wide = cumulative(depths + 0.5 * cell) - cumulative(depths - 0.5 * cell) >= 0.5 * rate * cell
        last = float(depths[np.flatnonzero(is_wide)].max(initial=last))
        # end at a vertex: below a level between vertices, a facet of the terrace would reach back
        vertex = float(cumulative.last_depths[np.argmin(np.abs(cumulative.last_depths - last))])
        last = vertex if abs(vertex - last) <= noise else last
        levels = (last, last - cell, last + cell)
        return Terrace(*(start + sign * level for level in levels))
    depths = np.linspace(first - cell, last + cell, 201)
    areas = cumulative(depths)
    middle_depth = float(np.interp(0.5 * (areas[0] + areas[-1]), areas, depths))
    return Terrace(
        start + sign * middle_depth,
        start + sign * min(first - cell, middle_depth - 0.1 * cell),
        start + sign * max(last + cell, middle_depth + 0.1 * cell),
    )


HEIGHT_TOLERANCE_M: Final = 1e-6
"""Heights [m] that differ by less are equal on a mesh without noise."""
MIN_BUMP_AREA_M2: Final = 3e-6
"""Plan area [m^2] (2 mm across) below which a bump is an artefact of facets that do not follow a crease."""


@dataclasses.dataclass(frozen=True)
class SkeletonNode:
    """A flat, a saddle or an end, on which walls start or end.

    Attributes:
        level: Level [m].
        deviation: Maximum deviation [m] of its vertices due to noise.
        parent: Node from which a wall leads here, -1 for the flat sheet.
    """

    level: float
    deviation: float
    parent: int


@dataclasses.dataclass(frozen=True)
class Skeleton:
    """Nodes and walls of a contour tree without noise.

    Attributes:
        nodes: Nodes, each after its parent.
        element: Element (N,) of each vertex: 2 p at node p, 2 p + 1 on the wall that leads to node p.
        height: Height (N,) [m] of the surface without noise.
    """

    nodes: tuple[SkeletonNode, ...]
    element: IntArray
    height: FloatArray

    def child_nodes(self, node: int) -> list[int]:
        """Return the nodes to which walls lead from a node."""
        return [index for index, other in enumerate(self.nodes) if other.parent == node]

    def direction(self, node: int) -> int:
        """Return +1 if the wall to a node rises, -1 if it goes down."""
        return 1 if self.nodes[node].level > self.nodes[self.nodes[node].parent].level else -1


PlanAreaBeyond = Callable[[list[int], float], float]
"""Plan area [m^2] of the part of the surface around some vertices that lies beyond a level [m]."""


def build_skeleton(
    tree: ContourTree,
    height: FloatArray,
    weight: FloatArray,
    size: PlanAreaBeyond,
    noise: float,
    level: float,
) -> Skeleton:
    """Return the skeleton of a contour tree whose root is the flat sheet, from which walls are derived.

    Args:
        tree: Contour tree.
        height: Heights (N,) [m] of its vertices.
        weight: Plan areas (N,) [m^2] of the vertices; the level of a noisy flat is their weighted median.
        size: Plan area beyond a level.
        noise: Height [m] of the mesh's noise.
        level: Level [m] of the flat sheet.
    """
    return _SkeletonBuilder(tree, height, weight, size, noise).build(level)


def _float_list(values: FloatArray) -> list[float]:
    """Return a list of floats, whose elements are read several times faster than those of an array."""
    return list(map(float, values))


class _SkeletonBuilder:
    """Builder of the skeleton of a contour tree; call `build` once.

    A vertex is significant if the branch that starts with it leaves its parent's height by the noise or more.
    Only significant vertices make nodes and walls.
    """

    def __init__(
        self, tree: ContourTree, height: FloatArray, weight: FloatArray, size: PlanAreaBeyond, noise: float
    ) -> None:
        self.weight, self.size = weight, size
        self.tree, self.noise, self.heights = tree, noise, _float_list(height)
        self.low, self.high = _float_list(tree.low), _float_list(tree.high)
        self.rank: list[int] = tree.rank.tolist()
        inner = tree.order[1:]
        above = tree.parent[inner]
        grouped = np.argsort(above, kind="stable")
        self.child_offsets: list[int] = np.concatenate(
            [[0], np.cumsum(np.bincount(above, minlength=len(height)))]
        ).tolist()
        self.child_vertices: list[int] = inner[grouped].tolist()
        reach = np.maximum(tree.high[inner] - height[above], height[above] - tree.low[inner]) >= noise
        matters = np.zeros(len(height), dtype=bool)
        matters[inner] = reach
        self.is_significant: list[bool] = matters.tolist()
        forks = np.bincount(above[reach], minlength=len(height)) > 1
        self._drop_small(np.nonzero(forks)[0].tolist())
        self.element = np.full(len(height), -1, dtype=np.int64)
        self.node_parents: list[int] = [-1]
        self.end_vertices: dict[int, int] = {}

    def _drop_small(self, forks: list[int]) -> None:
        """Make the smaller branches of forks insignificant if their plan area is below MIN_BUMP_AREA_M2."""
        for fork in forks:
            branches = sorted(
                self.significant_children(fork),
                key=lambda child: self._height_beyond(child, self.heights[fork]),
            )
            for branch in branches[:-1]:
                members = self._small_branch(branch)
                if members and self.size(members, self.heights[fork]) < MIN_BUMP_AREA_M2:
                    self.is_significant[branch] = False

    def _small_branch(self, vertex: int) -> list[int]:
        """Return the vertices of the branch that starts at a vertex; empty if it is clearly not small."""
        members, total = [vertex], 0.0
        for member in members:
            total += self.weight[member]
            if total > 10.0 * MIN_BUMP_AREA_M2:
                return []
            members.extend(self.children(member))
        return members

    def children(self, vertex: int) -> list[int]:
        """Return the vertices that follow a vertex, away from the root."""
        return self.child_vertices[self.child_offsets[vertex] : self.child_offsets[vertex + 1]]

    def significant_children(self, vertex: int) -> list[int]:
        return [child for child in self.children(vertex) if self.is_significant[child]]

    def build(self, level: float) -> Skeleton:
        """Return the skeleton, given the level [m] of the flat sheet.

        A wall that stays within the noise of the node from which it starts is merged into that node.
        """
        self.element[self.tree.root] = 0
        reference = [level]
        pending: list[tuple[int, int]] = [(self.tree.root, 0)]
        while pending:
            vertex, node = pending.pop()
            for child in self.significant_children(vertex):
                path, is_end = self._follow_wall(vertex, child)
                last = path[-1]
                if is_end and self._height_beyond(child, reference[node]) < self.noise:
                    self.element[path] = 2 * node
                    continue
                if not is_end and abs(self.heights[last] - reference[node]) < self.noise:
                    self.element[path] = 2 * node
                    pending.append((last, node))
                    continue
                new_node = len(self.node_parents)
                self.node_parents.append(node)
                reference.append(self.heights[last])
                self.element[path[:-1]] = 2 * new_node + 1
                self.element[last] = 2 * new_node
                if is_end:
                    self.end_vertices[new_node] = last
                else:
                    pending.append((last, new_node))
        return self._finish(level)

    def _follow_wall(self, vertex: int, child: int) -> tuple[list[int], bool]:
        """Return the vertices from a fork to the next fork or to the end of the wall, and whether it ends."""
        offsets = self.child_offsets
        children = self.child_vertices
        is_significant = self.is_significant
        rank = self.rank
        rises = rank[child] > rank[vertex]
        path, current = [child], child
        while True:
            following = [
                candidate
                for candidate in children[offsets[current] : offsets[current + 1]]
                if is_significant[candidate]
            ]
            if len(following) != 1 or (rank[following[0]] > rank[current]) != rises:
                break
            current = following[0]
            path.append(current)
        if following:
            return path, False
        return self._extend_to_tip(path, 1.0 if rises else -1.0), True

    def _extend_to_tip(self, path: list[int], sign: float) -> list[int]:
        """Extend a path beyond its last significant vertex to the tip of the wall, in place, and return it.

        What follows there is small, or lower than the noise. The path takes the child that reaches farthest.
        It stops where the heights are only noise, or where the next vertex turns back (``sign`` is +1 for a
        wall that rises).
        """
        while children := self.children(path[-1]):
            current = self.heights[path[-1]]
            reach = [max(self.high[child] - current, current - self.low[child]) for child in children]
            best_index = int(np.argmax(reach))
            others = reach[:best_index] + reach[best_index + 1 :]
            is_noisy = max(others, default=0.0) > HEIGHT_TOLERANCE_M and reach[best_index] < self.noise
            if is_noisy or sign * (self.heights[children[best_index]] - current) < -HEIGHT_TOLERANCE_M:
                break
            path.append(children[best_index])
        return path

    def _height_beyond(self, vertex: int, level: float) -> float:
        """Return how far [m] the branch that starts at a vertex leaves a level [m], up or down."""
        return max(self.high[vertex] - level, level - self.low[vertex])

    def _finish(self, level: float) -> Skeleton:
        """Return the skeleton once all significant vertices are assigned to elements.

        The other vertices take element and height from their parents. Nodes within the noise of their parent
        are merged into it until none is left, because merging changes the levels of nodes.
        """
        element = self.element.tolist()
        denoised = list(self.heights)
        parents = self.tree.parent.tolist()
        for vertex in self.tree.order[1:].tolist():
            if element[vertex] < 0:
                element[vertex], denoised[vertex] = element[parents[vertex]], denoised[parents[vertex]]
        elements, z = np.array(element), np.array(self.heights)
        nodes = self._make_nodes(level, elements, z)
        while (kept := self._differs_from_parent(nodes)).sum() < len(nodes):
            elements = self._merge_nodes(kept, elements)
            nodes = self._make_nodes(level, elements, z)
        smooth = np.array(denoised)
        return Skeleton(tuple(self._with_wall_noise(nodes, elements, z, smooth)), elements, smooth)

    def _make_nodes(self, level: float, elements: IntArray, z: FloatArray) -> list[SkeletonNode]:
        """Return the nodes to which ``elements`` (N,) assigns vertices of heights ``z`` (N,) [m]."""
        on_node = np.nonzero(elements % 2 == 0)[0]
        order = on_node[np.argsort(elements[on_node], kind="stable")]
        groups = np.split(order, np.nonzero(np.diff(elements[order]))[0] + 1)
        nodes = []
        for index, members in enumerate(groups):
            heights = z[members]
            node_level = level if index == 0 else self._node_level(index, heights, self.weight[members])
            nodes.append(
                SkeletonNode(node_level, float(np.abs(heights - node_level).max()), self.node_parents[index])
            )
        return nodes

    def _differs_from_parent(self, nodes: list[SkeletonNode]) -> BoolArray:
        """Return whether (P,) the level of each node differs from that of its parent by at least the noise.

        `build` compares heights of forks. On a noisy flat, the first fork may deviate from the level of its
        node by as much as the noise, so nodes are compared again.
        """
        level = np.array([node.level for node in nodes])
        kept = np.abs(level - level[[max(node.parent, 0) for node in nodes]]) >= self.noise
        kept[0] = True
        return np.asarray(kept)

    def _merge_nodes(self, kept: BoolArray, elements: IntArray) -> IntArray:
        """Merge nodes that are not ``kept`` (P,), and the walls to them, into their parents.

        ``elements`` (N,) is as `Skeleton.element`.
        """
        number = np.cumsum(kept) - 1
        target = np.zeros(len(kept), dtype=np.int64)
        for index, parent in enumerate(self.node_parents):  # each node comes after its parent
            target[index] = number[index] if kept[index] else target[parent]
        self.end_vertices = {
            int(target[parent]): end for parent, end in self.end_vertices.items() if kept[parent]
        }
        self.node_parents = [
            int(target[parent]) if parent >= 0 else -1
            for parent, is_kept in zip(self.node_parents, kept, strict=True)
            if is_kept
        ]
        return np.asarray(2 * target[elements // 2] + (elements % 2) * kept[elements // 2])

    def _with_wall_noise(
        self, nodes: list[SkeletonNode], element: IntArray, z: FloatArray, smooth: FloatArray
    ) -> list[SkeletonNode]:
        """Return the nodes with deviations that include the noise of nearby vertices on adjacent walls.

        So the first level line of a wall is placed beyond the noise at its foot. ``z`` (N,) [m] are the
        heights of the vertices with noise, and ``smooth`` (N,) [m] those without. ``element`` (N,) is as
        `Skeleton.element`.
        """
        noise_height = np.abs(z - smooth)
        noisy = np.nonzero((noise_height > 0.0) & (noise_height < self.noise))[0]
        if len(noisy) == 0:
            return nodes
        max_noise_height, z, smooth = float(noise_height[noisy].max()), z[noisy], smooth[noisy]
        node_index = element[noisy] // 2
        on_wall, parent_index = element[noisy] % 2 == 1, np.array(self.node_parents)[node_index]
        updated = []
        for index, node in enumerate(nodes):
            adjacent = (
                on_wall
                & ((node_index == index) | (parent_index == index))
                & (np.abs(smooth - node.level) <= max_noise_height)
            )
            deviation = float(np.abs(z[adjacent] - node.level).max(initial=0.0))
            updated.append(dataclasses.replace(node, deviation=max(node.deviation, deviation)))
        return updated

    def _node_level(self, node: int, heights: FloatArray, weight: FloatArray) -> float:
        """Return the level [m] of a node from the heights (M,) [m] and areas ``weight`` (M,) of its vertices.

        It is the height of the wall's tip if the vertices are level, else their median, weighted by area.
        """
        if node in self.end_vertices and np.ptp(heights) <= HEIGHT_TOLERANCE_M:
            return self.heights[self.end_vertices[node]]
        order = np.argsort(heights)
        total = np.cumsum(weight[order])
        return float(heights[order[min(int(np.searchsorted(total, 0.5 * total[-1])), len(order) - 1)]])


FLAT_CLEARANCE_FACTOR: Final = 1.1
"""Distance of the first level line from a noisy flat, in units of its noise as observed on the flat itself.

Some vertices of the flat count as parts of the walls, hence the factor above 1.
"""


@dataclasses.dataclass(frozen=True)
class FeatureWall:
    """Wall of the surface that becomes one feature.

    Attributes:
        parent: Index among the walls, or None.
        start: Level [m] at which it starts.
        end: Level [m] at which it ends.
        first: First level [m] from which its level lines are free of the noise of the flat at its start.
        last: Last level [m] up to which they are free of the noise at its end.
        height: Surface (V,) [m] on the wall, ``start`` outside it and ``end`` inside.
    """

    parent: int | None
    start: float
    end: float
    first: float
    last: float
    height: FloatArray

    @property
    def sign(self) -> float:
        """+1 if the wall rises from its start, -1 if it goes down."""
        return 1.0 if self.end > self.start else -1.0


@dataclasses.dataclass(frozen=True)
class _WallRun:
    """Nodes of a monotonic run of walls: from ``start`` through some nodes to ``end``."""

    start: int
    through: tuple[int, ...]
    end: int


def find_walls(skeleton: Skeleton, surface: SheetSurface, noise: float) -> list[FeatureWall]:
    """Return the walls of a part, each after its parent; each becomes one feature.

    The parent of a wall is the wall on whose flat it starts, or None for the flat sheet.

    Args:
        skeleton: Skeleton of the part.
        surface: Its surface.
        noise: Height [m] of the mesh's noise.
    """
    area = plan_areas(surface)
    children: list[list[int]] = [[] for _ in skeleton.nodes]
    for index, node in enumerate(skeleton.nodes[1:], start=1):
        children[node.parent].append(index)
    result: list[FeatureWall] = []
    pending: list[tuple[int, int | None]] = [(other, None) for other in children[0]]
    while pending:
        first, parent = pending.pop()
        wall_run = _follow_run(skeleton, children, first)
        pieces = _wall_pieces(wall_run, skeleton, surface, area, noise)
        owner = parent
        owners = []
        for piece in pieces:
            result.append(dataclasses.replace(piece, parent=owner))
            owner = len(result) - 1
            owners.append(owner)
        sign = pieces[0].sign
        for node_index in (*wall_run.through, wall_run.end):
            level = skeleton.nodes[node_index].level
            # walls that leave at a node belong to the first piece of this run that reaches its level
            fits = [k for k, piece in enumerate(pieces) if sign * (level - piece.end) < noise]
            leaving = [
                other for other in children[node_index] if other not in (*wall_run.through, wall_run.end)
            ]
            pending.extend((other, owners[fits[0] if fits else -1]) for other in leaving)
    return result


def _follow_run(skeleton: Skeleton, children: list[list[int]], first: int) -> _WallRun:
    """Return the run that begins with the wall to a node; it continues while one wall keeps its direction."""
    sign = skeleton.direction(first)
    through, node = [], first
    while len(continuing := [other for other in children[node] if skeleton.direction(other) == sign]) == 1:
        through.append(node)
        node = continuing[0]
    return _WallRun(skeleton.nodes[first].parent, tuple(through), node)


def _run_height(run: _WallRun, skeleton: Skeleton) -> tuple[FloatArray, FloatArray]:
    """Return the heights (V,) [m] of the surface on a run, and whether (V,) each vertex lies on the run.

    Off the run the height is constant: the level of the node from which a branch leaves the run, or the
    start.
    """
    nodes = skeleton.nodes
    run_nodes = {*run.through, run.end}
    low = np.full(2 * len(nodes), nodes[run.start].level)
    high = low.copy()
    on_run = np.zeros(2 * len(nodes), dtype=bool)
    inside: set[int] = set()
    for index, node in enumerate(nodes):
        if index in run_nodes:
            parent_level = nodes[node.parent].level
            low[2 * index + 1], high[2 * index + 1] = (
                min(parent_level, node.level),
                max(parent_level, node.level),
            )
            low[2 * index] = high[2 * index] = node.level
            on_run[2 * index : 2 * index + 2] = True
        elif node.parent in inside:
            constant = low[2 * node.parent]
            low[2 * index : 2 * index + 2] = high[2 * index : 2 * index + 2] = constant
        else:
            continue
        inside.add(index)
    element = skeleton.element
    return np.clip(skeleton.height, low[element], high[element]), on_run[element]


def _wall_pieces(
    run: _WallRun, skeleton: Skeleton, surface: SheetSurface, area: FloatArray, noise: float
) -> list[FeatureWall]:
    """Return the walls of a run, split at its terraces, in order; the caller sets their parents.

    ``area`` (F,) [m^2] are the plan areas of the surface's faces, and ``noise`` [m] is that of the mesh.
    """
    height, on_run = _run_height(run, skeleton)
    start_node, end_node = skeleton.nodes[run.start], skeleton.nodes[run.end]
    start, end = start_node.level, end_node.level
    sign = 1.0 if end > start else -1.0
    deviation = start_node.deviation
    if run.start == 0:
        deviation = max(deviation, float(np.abs(surface.vertices[surface.border, 2] - start).max()))
    first = start + sign * (FLAT_CLEARANCE_FACTOR * deviation + HEIGHT_TOLERANCE_M)
    last = end - sign * (FLAT_CLEARANCE_FACTOR * end_node.deviation + HEIGHT_TOLERANCE_M)
    height_a, height_b, height_c = height[surface.faces].T
    low = np.minimum(np.minimum(height_a, height_b), height_c)
    high = np.maximum(np.maximum(height_a, height_b), height_c)
    reached = (low != start) | (high != start)
    is_wall = (high > low) | on_run[surface.faces].all(axis=1)
    is_wall &= reached & ((low != end) | (high != end))
    wall_faces = WallFaces(low=low[is_wall], high=high[is_wall], area=area[is_wall])
    terraces = find_terraces(wall_faces, float(area[reached].sum()), start, end, noise)
    pieces = []
    for terrace in terraces:
        pieces.append(_make_wall(start, terrace.level, first, terrace.first, height))
        start, first = terrace.level, terrace.last
    pieces.append(_make_wall(start, end, first, last, height))
    return pieces


def _make_wall(start: float, end: float, first: float, last: float, height: FloatArray) -> FeatureWall:
    """Return a wall without a parent; ``first`` and ``last`` [m] are replaced if they are in wrong order."""
    if (last - first) * (end - start) <= 0.0:  # the wall is barely higher than the noise at its ends
        first, last = start + 0.4 * (end - start), start + 0.6 * (end - start)
    return FeatureWall(None, start, end, first, last, np.clip(height, min(start, end), max(start, end)))
