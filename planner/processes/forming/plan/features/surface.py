"""The sheet's surface as a mesh, level lines of a height over it, and their contour tree.

Features are detected on one open surface over the sheet plane, level at its edge. Level lines are cut at all
levels at once (`slice_levels`).

**Contour tree**: how level lines appear, split, merge and vanish. Each point of the tree is one level line.
Carr, Snoeyink and Axen, Computing contour trees in all dimensions, Computational Geometry 24 (2003): a sweep
from the top joins what is above, one from below what is beneath, and both trees are merged leaf by leaf.
Equal heights are ordered by index, so that flats need no special treatment.
"""

import dataclasses
import math
from typing import Final

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components

from planner.geometry.arrays import FloatArray, IntArray
from planner.geometry.curves import bounding_sides
from planner.geometry.mesh import TriangleMesh, check_surface
from planner.geometry.units import MM, measurement
from planner.issues import Issue, TandemError, issue_error

MAX_OVERHANG_M: Final = 25e-6
"""Depth [m] by which faces may overhang: the effect of vertex noise on a vertical wall."""


@dataclasses.dataclass(frozen=True)
class SheetSurface:
    """A checked surface.

    Attributes:
        vertices: Vertices (V, 3) [m], all of them used.
        faces: Triangles (F, 3) with normals up.
        edges: Edges (E, 2), the lower index first.
        face_edges: Edges (F, 3) from corner 0 to 1, 1 to 2, 2 to 0.
        border: Vertices (B,) along the edge of the part.
        level: Level [m] of the flat sheet.
        used: Indices (V,) of the vertices in the given mesh.
    """

    vertices: FloatArray
    faces: IntArray
    edges: IntArray
    face_edges: IntArray
    border: IntArray
    level: float
    used: IntArray


def check_sheet(vertices: FloatArray, faces: IntArray, noise: float) -> SheetSurface:
    """Check the surface of a part and return it with its edges, border and level.

    Args:
        vertices: Vertices (V, 3) [m].
        faces: Triangles (F, 3), normals all up or all down.
        noise: Deviation [m] from the flat that the part's edge may have.

    Raises:
        TandemError: ``mesh.*`` if it is not one open oriented surface in one piece; ``forming.touching`` if
            parts of it meet in a single vertex; ``forming.hole``; ``forming.border`` if its edge leaves the
            sheet plane; ``forming.undercut`` if it overhangs.
    """
    used, compact = np.unique(faces, return_inverse=True)
    faces = np.asarray(compact).reshape(-1, 3).astype(np.int64)
    vertices = np.ascontiguousarray(vertices[used], dtype=np.float64)
    if len(faces) == 0:
        raise issue_error("mesh.empty", "the part has no faces; export its surface", field="part")
    mesh_issues = check_surface(TriangleMesh(vertices, faces), "part")
    if mesh_issues:
        raise TandemError(mesh_issues)
    if np.sum(signed_plan_areas(vertices, faces)) < 0.0:
        faces = np.ascontiguousarray(faces[:, ::-1])
    directed = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    low, high = np.sort(directed, axis=1).T
    # one key for each undirected edge; edges that occur once are on the border
    key, inverse, count = np.unique(low * len(vertices) + high, return_inverse=True, return_counts=True)
    edges = np.stack(np.divmod(key, len(vertices)), axis=1)
    inverse = np.reshape(inverse, -1)
    border = _outer_border(vertices, faces, directed[count[inverse] == 1])
    level = float(np.median(vertices[border, 2]))
    deviation = np.abs(vertices[border, 2] - level)
    if deviation.max() >= noise:
        raise TandemError(_border_issue(vertices[border[int(np.argmax(deviation))]], level, noise))
    undercut = _undercut_issue(vertices, faces, edges, inverse.reshape(-1, 3))
    if undercut is not None:
        raise TandemError(undercut)
    return SheetSurface(vertices, faces, edges, inverse.reshape(-1, 3), border, level, used)


def plan_areas(surface: SheetSurface) -> FloatArray:
    """Return the areas (F,) [m^2] of the faces seen from above, not negative."""
    return np.maximum(signed_plan_areas(surface.vertices, surface.faces), 0.0)


class PlanAreaBeyondLevel:
    """Plan area [m^2] of the faces around some vertices, beyond a level.

    The area is that on the side of the level [m] on which the first vertex is.
    """

    def __init__(self, surface: SheetSurface) -> None:
        self.surface, self.area = surface, plan_areas(surface)
        corners = surface.faces.reshape(-1)
        self.order = np.argsort(corners, kind="stable") // 3
        self.offsets = np.concatenate([[0], np.cumsum(np.bincount(corners, minlength=len(surface.vertices)))])

    def __call__(self, members: list[int], level: float) -> float:
        """Return the area beyond a level.

        Args:
            members: Indices of vertices. The index V, of the vertex that closes the surface, has no faces.
            level: Level [m].
        """
        height, count = self.surface.vertices[:, 2], len(self.surface.vertices)
        existing = [member for member in members if member < count]
        if not existing:
            return 0.0
        faces = np.unique(
            np.concatenate([self.order[self.offsets[i] : self.offsets[i + 1]] for i in existing])
        )
        sign = 1.0 if height[existing[0]] >= level else -1.0
        low, middle, high = np.sort(sign * (height[self.surface.faces[faces]] - level), axis=1).T
        # fraction of a triangle's area at heights above 0: similar triangles at its highest or lowest corner
        tip = high**2 / np.maximum((high - low) * (high - middle), 1e-300)
        base = 1.0 - low**2 / np.maximum((high - low) * (middle - low), 1e-300)
        fraction = np.where(low >= 0.0, 1.0, np.where(middle >= 0.0, base, np.where(high > 0.0, tip, 0.0)))
        return float(np.sum(fraction * self.area[faces]))


def position_text(point: FloatArray) -> str:
    """Return a position (2 or 3,) [m] as text in mm."""
    return "(" + ", ".join(f"{value / MM:.2f}" for value in point) + ") mm"


def signed_plan_areas(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Return the areas (F,) [m^2] of faces seen from above, negative if seen from behind."""
    a, b, c = (vertices[faces[:, i], :2] for i in range(3))
    u, v = b - a, c - a
    return np.asarray(0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]))


def _is_edge_connected(faces: IntArray, vertex: int) -> bool:
    """Return whether all faces around a vertex belong to one piece that is connected by edges."""
    ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    _, edge = np.unique(ends, axis=0, return_inverse=True)
    owner = np.repeat(np.arange(len(faces)), 3)
    graph = coo_array((np.ones(len(owner)), (owner, np.reshape(edge, -1)))).tocsr()
    _, piece = connected_components(graph @ graph.T, directed=False)
    return len(np.unique(piece[(faces == vertex).any(axis=1)])) == 1


def _outer_border(vertices: FloatArray, faces: IntArray, rim: IntArray) -> IntArray:
    """Return the vertices of the outermost closed line of the edges ``rim`` (R, 2), which have one face.

    Raises ``TandemError``: forming.hole for any other line, forming.touching if two pieces meet in a point.
    """
    count = len(vertices)
    starts = np.bincount(rim[:, 0], minlength=count)
    if (starts > 1).any():
        vertex = int(np.argmax(starts > 1))
        position = vertices[vertex]
        if _is_edge_connected(faces, vertex):
            message = (
                f"holes of the part, or one and its edge, meet in a point at {position_text(position)}; "
            )
            message += "a sheet is formed without holes, so close them and cut them afterwards"
            raise issue_error("forming.hole", message, field="part")
        message = (
            f"two pieces of the part meet in a single point at {position_text(position)} with no sheet "
            "between them; "
        )
        message += "move them apart, or join them by a strip of flat sheet"
        raise issue_error("forming.touching", message, field="part")
    graph = coo_array((np.ones(len(rim)), (rim[:, 0], rim[:, 1])), shape=(count, count))
    _, label = connected_components(graph, directed=False)
    a, b = vertices[rim[:, 0], :2], vertices[rim[:, 1], :2]
    double_area = np.bincount(label[rim[:, 0]], weights=a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    loops = np.unique(label[rim[:, 0]])
    # the outer line has the part on its left, so its area is positive; the largest magnitude withstands folds
    outer = loops[np.argmax(np.abs(double_area[loops]))]
    holes = loops[loops != outer]
    if len(holes):
        raise TandemError([_hole_issue(vertices[rim[label[rim[:, 0]] == hole, 0]]) for hole in holes[:10]])
    return np.asarray(np.unique(rim[label[rim[:, 0]] == outer]))


def _hole_issue(points: FloatArray) -> Issue:
    """Return the error that the part has a hole, with the size and centre of its edge ``points`` (K, 3)."""
    centre = points.mean(axis=0)
    size = max(bounding_sides(points[:, :2])[0], float(np.ptp(points[:, 2])))
    message = (
        f"the part has a hole, {size / MM:.3g} mm across, at {position_text(centre)}; a sheet is formed "
        "without "
    )
    message += "holes, so close it (or sew the mesh if it is a crack between facets) and cut it afterwards"
    return Issue("forming.hole", message, field="part", **measurement(size / MM, None, "mm"))


def _border_issue(point: FloatArray, level: float, noise: float) -> Issue:
    """Return the error that the part's edge leaves the flat at ``level`` [m]; ``point`` (3,) is the worst."""
    deviation_mm = abs(float(point[2]) - level) / MM
    message = (
        f"the edge of the part is {deviation_mm:.3f} mm away from the flat sheet at {position_text(point)}, "
        "allowed is at "
    )
    message += (
        f"most {noise / MM:.3f} mm, because contours would end there; extend the part by a surface that "
    )
    message += "blends into the sheet plane"
    return Issue("forming.border", message, field="part", **measurement(deviation_mm, noise / MM, "mm"))


def _undercut_issue(
    vertices: FloatArray, faces: IntArray, edges: IntArray, face_edges: IntArray
) -> Issue | None:
    """Return an issue about the worst group of connected faces that overhang, or None.

    The overhang of a group is its plan area divided by the square root of its area: a wall of length and
    height L that leans over by the angle a has L sin(a).
    """
    plan = signed_plan_areas(vertices, faces)
    overhanging = np.nonzero(plan < 0.0)[0]
    if len(overhanging) == 0:
        return None
    a, b, c = (vertices[faces[overhanging, i]] for i in range(3))
    normal = 0.5 * np.cross(b - a, c - a)
    area = np.linalg.norm(normal, axis=1)
    owner = np.repeat(np.arange(len(overhanging)), 3)
    incidence = coo_array(
        (np.ones(len(owner)), (owner, face_edges[overhanging].reshape(-1))),
        shape=(len(overhanging), len(edges)),
    ).tocsr()
    _, label = connected_components(incidence @ incidence.T, directed=False)
    plan_sum = np.bincount(label, weights=-plan[overhanging])
    area_sum = np.bincount(label, weights=area)
    overhang = plan_sum / np.sqrt(np.maximum(area_sum, 1e-300))
    worst_group = int(np.argmax(overhang))
    if overhang[worst_group] <= MAX_OVERHANG_M:
        return None
    in_group = label == worst_group
    steepest = np.nonzero(in_group)[0][int(np.argmin((normal[:, 2] / np.maximum(area, 1e-300))[in_group]))]
    angle = math.degrees(math.acos(np.clip(normal[steepest, 2] / area[steepest], -1.0, 1.0)))
    point = vertices[faces[overhanging[steepest]]].mean(axis=0)
    groups = int((overhang > MAX_OVERHANG_M).sum())
    message = f"the part has an undercut in {groups} place{'s' if groups > 1 else ''}: a wall of {angle:.1f} "
    message += (
        f"deg at {position_text(point)}, allowed up to 90 deg; remove the undercut from the part, or turn "
        "the "
    )
    message += "part"
    return Issue("forming.undercut", message, field="part", **measurement(angle, 90.0, "deg"), count=groups)


def slice_levels(
    surface: SheetSurface, height: FloatArray, levels: FloatArray
) -> tuple[tuple[FloatArray, ...], ...]:
    """Return the level lines of a height at several levels.

    A vertex at a level counts as above it, so that a flat at a level has a line around it and none across.
    ``height`` may differ from the surface's own z where a wall holds it constant. The position of a line
    between two vertices is then that of the surface, if the surface has the level between them. No level line
    may meet the surface's border.

    Args:
        surface: Surface.
        height: Heights (V,) [m].
        levels: Ascending levels (L,) [m].

    Returns:
        For each level, closed polylines (K, 3) [m] with the first point repeated at the end,
        counter-clockwise seen from above, with z at the level.

    Raises:
        ValueError: A level line meets the border of the surface.
    """
    faces = surface.faces
    below = np.searchsorted(levels, height, side="right")  # number of levels at or below each vertex
    first, last = below[faces].min(axis=1), below[faces].max(axis=1)
    crossed = np.nonzero(last > first)[0]
    if len(crossed) == 0:
        return tuple(() for _ in levels)
    corner_below = below[faces[crossed]]
    count = last[crossed] - first[crossed]
    owner = np.repeat(np.arange(len(crossed)), count)
    offset = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    level = first[crossed][owner] + offset
    above = corner_below[owner] > level[:, None]
    # Going round a face counter-clockwise, the line leaves by the edge that falls below the level and enters
    # by the one that rises above it: then the higher side is on its left.
    rises = ~above & np.roll(above, -1, axis=1)
    falls = above & ~np.roll(above, -1, axis=1)
    edge = surface.face_edges[crossed[owner]]
    edge_count = len(surface.edges)
    # the crossing of a level with an edge has the number level * edge_count + edge
    enter = level * edge_count + edge[np.arange(len(owner)), np.argmax(rises, axis=1)]
    leave = level * edge_count + edge[np.arange(len(owner)), np.argmax(falls, axis=1)]
    node, target = np.unique(leave, return_inverse=True)
    order = np.argsort(enter)
    if not np.array_equal(enter[order], node):
        raise ValueError("a level line meets the border of the surface")
    follower = np.reshape(target, -1)[order]
    loop, rank = _cycles(follower)
    along_loops = np.lexsort((rank, loop))
    points = _crossing_points(surface, height, levels, node, edge_count)[along_loops]
    starts = np.nonzero(np.diff(loop[along_loops], prepend=-1))[0]
    lines: list[list[FloatArray]] = [[] for _ in levels]
    for start, stop in zip(starts, [*starts[1:].tolist(), len(points)], strict=True):
        line = _close_ring(points[start:stop])
        if line is not None:
            lines[int(node[along_loops[start]] // edge_count)].append(line)
    return tuple(tuple(group) for group in lines)


def plan_area(line: FloatArray) -> float:
    """Return the signed area [m^2] of a closed polyline (K, 2 or 3) seen from above."""
    x, y = line[:, 0] - line[0, 0], line[:, 1] - line[0, 1]
    return float(0.5 * np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))


def _crossing_points(
    surface: SheetSurface, height: FloatArray, levels: FloatArray, node: IntArray, edge_count: int
) -> FloatArray:
    """Return the points (K, 3) [m] at which the level lines of ``height`` (V,) [m] cross edges.

    ``node`` (K,) is level * ``edge_count`` + edge. A point is where the surface itself has the level, if it
    does on that edge, else where ``height`` has it.
    """
    level = levels[node // edge_count]
    a, b = surface.edges[node % edge_count].T
    p, q = surface.vertices[a], surface.vertices[b]
    surface_fraction = (level - p[:, 2]) / np.where(q[:, 2] == p[:, 2], 1.0, q[:, 2] - p[:, 2])
    fraction = (level - height[a]) / (height[b] - height[a])
    surface_meets = (q[:, 2] != p[:, 2]) & (surface_fraction >= 0.0) & (surface_fraction <= 1.0)
    points = p + np.where(surface_meets, surface_fraction, fraction)[:, None] * (q - p)
    points[:, 2] = level
    return np.asarray(points)


def _cycles(follower: IntArray) -> tuple[IntArray, IntArray]:
    """Return the cycle of each element of a permutation (N,), and its rank in the cycle.

    A cycle is named by its smallest member. The rank is minus the number of steps from the element to that
    member, so that it ascends along the cycle. Both are computed by pointer doubling.
    """
    count = len(follower)
    smallest, jump = np.arange(count), follower.copy()
    rounds = max(int(np.ceil(np.log2(max(count, 2)))), 1)
    for _ in range(rounds):
        smallest = np.minimum(smallest, smallest[jump])
        jump = jump[jump]
    is_smallest = smallest == np.arange(count)
    jump = np.where(is_smallest, np.arange(count), follower)
    steps = np.where(is_smallest, 0, 1)
    for _ in range(rounds):
        steps = steps + steps[jump]
        jump = jump[jump]
    return smallest, -steps


def _close_ring(points: FloatArray) -> FloatArray | None:
    """Return a ring (K, 3) without repeated points, closed and counter-clockwise; None below 3 points."""
    is_distinct = np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1) > 1e-9
    points = points[is_distinct]
    if len(points) < 3:
        return None
    line = np.concatenate([points, points[:1]])
    return line if plan_area(line) >= 0.0 else line[::-1]


@dataclasses.dataclass(frozen=True)
class ContourTree:
    """A contour tree that contains every vertex, seen from a root.

    Attributes:
        root: Vertex of the root.
        order: Vertices (N,), parents first.
        parent: Next vertex (N,) toward the root, -1 for the root.
        rank: Rank (N,) of each vertex by height.
        low: Minimum height (N,) [m] of the vertex and all vertices that follow it, away from the root.
        high: Maximum height (N,) [m] of the same vertices.
    """

    root: int
    order: IntArray
    parent: IntArray
    rank: IntArray
    low: FloatArray
    high: FloatArray


def contour_tree(height: FloatArray, edges: IntArray, root: int) -> ContourTree:
    """Return the contour tree of heights at the vertices of a connected graph.

    Args:
        height: Heights (N,) [m].
        edges: Edges (E, 2) of a triangulated surface that every closed line divides in two (a disk, a
            sphere).
        root: Vertex of the root.
    """
    count = len(height)
    by_rank = np.lexsort((np.arange(count), height))
    rank = np.empty(count, dtype=np.int64)
    rank[by_rank] = np.arange(count)
    low, high = np.sort(rank[edges], axis=1).T
    joined = _sweep_tree(range(count - 1, -1, -1), _directed_neighbours(low, high, count))
    split = _sweep_tree(range(count), _directed_neighbours(high, low, count))
    arcs = _merge_trees(joined, split)
    graph = coo_array((np.ones(len(arcs)), (arcs[:, 0], arcs[:, 1])), shape=(count, count)).tocsr()
    order, parent = breadth_first_order(graph, rank[root], directed=False)
    vertex_order = by_rank[order]
    vertex_parent = np.full(count, -1, dtype=np.int64)
    vertex_parent[by_rank[order[1:]]] = by_rank[parent[order[1:]]]
    low_extent, high_extent = _subtree_extents(height, vertex_order, vertex_parent)
    return ContourTree(root, vertex_order, vertex_parent, rank, low_extent, high_extent)


def _directed_neighbours(vertex: IntArray, other: IntArray, count: int) -> tuple[list[int], list[int]]:
    """Return offsets into a list of neighbours, and that list.

    The neighbours of vertex v, from offset v to offset v + 1, are the ``other`` (E,) of the edges of which
    ``vertex`` (E,) is v.
    """
    order = np.argsort(vertex, kind="stable")
    offsets = np.concatenate([[0], np.cumsum(np.bincount(vertex, minlength=count))])
    return offsets.tolist(), other[order].tolist()


def _sweep_tree(sweep: range, neighbours: tuple[list[int], list[int]]) -> list[int]:
    """Return, for each vertex, the later vertex of the sweep that first joins its component; -1 for the last.

    The neighbours of a vertex are those that come before it in the sweep.

    A union-find is sequential by nature; lists are several times faster than arrays here.
    """
    offsets, others = neighbours
    last_vertex = list(range(len(sweep)))
    follower = [-1] * len(sweep)
    for vertex in sweep:
        for other in others[offsets[vertex] : offsets[vertex + 1]]:
            while last_vertex[other] != other:  # find the last vertex of the component, with path halving
                last_vertex[other] = last_vertex[last_vertex[other]]
                other = last_vertex[other]
            if other != vertex:
                last_vertex[other] = vertex
                follower[other] = vertex
    return follower


def _merge_trees(joined: list[int], split: list[int]) -> IntArray:
    """Return the arcs (N - 1, 2) of the contour tree, each from a vertex to its neighbour in the tree.

    In each step a vertex is removed from both trees that is a leaf of one of them and has a single child in
    the other. Its arc to the next vertex in the tree of which it is a leaf belongs to the contour tree.
    ``joined`` and ``split`` are the trees of `_sweep_tree` from the top down and from the bottom up.
    """
    count = len(joined)
    up, down = [0] * count, [0] * count  # number of arcs at each vertex in either tree
    for vertex in range(count):
        if joined[vertex] >= 0:
            up[joined[vertex]] += 1
        if split[vertex] >= 0:
            down[split[vertex]] += 1
    removed = [False] * count
    leaves = [vertex for vertex in range(count) if up[vertex] + down[vertex] == 1]
    arcs: list[tuple[int, int]] = []
    while leaves:
        leaf = leaves.pop()
        if up[leaf] + down[leaf] != 1:
            continue  # the last vertex
        follower, degree = (joined, up) if up[leaf] == 0 else (split, down)
        removed[leaf] = True
        target = follower[leaf]
        while removed[target]:
            next_target = follower[target]
            if removed[next_target]:
                follower[target] = follower[next_target]
            target = next_target
        arcs.append((leaf, target))
        degree[target] -= 1
        if up[target] + down[target] == 1:
            leaves.append(target)
    return np.array(arcs, dtype=np.int64).reshape(-1, 2)


def _subtree_extents(height: FloatArray, order: IntArray, parent: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return the minimum and maximum height (N,) [m] of each vertex and all vertices that follow it."""
    low, high = height.tolist(), height.tolist()
    parents = parent.tolist()
    for vertex in order[:0:-1].tolist():
        above = parents[vertex]
        if low[vertex] < low[above]:
            low[above] = low[vertex]
        if high[vertex] > high[above]:
            high[above] = high[vertex]
    return np.array(low), np.array(high)
