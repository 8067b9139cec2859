"""The sheet's surface as a mesh, level lines of a height over it, and their contour tree.

What a mesh must be before features are looked for: one open surface over the sheet plane, level at
its edge. Level lines are cut at all levels at once (`slice_levels`).

**Contour tree**: how level lines appear, split, merge and vanish. Each point of the tree is one
level line. Carr, Snoeyink and Axen, Computing contour trees in all dimensions, Computational
Geometry 24 (2003): a sweep from the top joins what is above, one from below what is beneath, and
both trees are merged leaf by leaf. Equal heights are told apart by the index, so that flats need no
care.
"""

import dataclasses
import math
from typing import Final

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components

from planner.geometry.arrays import FloatArray, IntArray
from planner.geometry.curves import sides
from planner.geometry.mesh import TriangleMesh, check_surface
from planner.geometry.units import MM, measurement
from planner.issues import Issue, TandemError, refusal

OVERHANG: Final = 25e-6
"""Depth [m] by which faces may turn over: what noise of the vertices does to a vertical wall."""


@dataclasses.dataclass(frozen=True)
class SheetSurface:
    """A checked surface: ``vertices`` (V, 3) [m], all of them used, ``faces`` (F, 3) with normals up,
    ``edges`` (E, 2) with the lower index first, ``face_edges`` (F, 3) the edges from corner 0 to 1, 1 to 2, 2
    to 0, ``border`` (B,) vertices along the edge of the part, ``level`` [m] of the flat sheet, ``used`` (V,)
    indices of the vertices in the mesh that was given.
    """

    vertices: FloatArray
    faces: IntArray
    edges: IntArray
    face_edges: IntArray
    border: IntArray
    level: float
    used: IntArray


def check_sheet(vertices: FloatArray, faces: IntArray, noise: float) -> SheetSurface:
    """The surface of a part, checked. ``noise`` [m]: departure from the flat that its edge may have.

    Normals may all point up or all down. Raises ``TandemError``: ``mesh.*`` for what is no open oriented
    surface in one piece, ``forming.touching`` where parts of it meet in a single vertex, ``forming.hole``,
    ``forming.border`` where its edge leaves the sheet plane, ``forming.undercut`` where it turns over.
    """
    used, compact = np.unique(faces, return_inverse=True)
    faces = np.asarray(compact).reshape(-1, 3).astype(np.int64)
    vertices = np.ascontiguousarray(vertices[used], dtype=np.float64)
    if len(faces) == 0:
        raise refusal("mesh.empty", "the part has no faces; export its surface", field="part")
    found = check_surface(TriangleMesh(vertices, faces), "part")
    if found:
        raise TandemError(found)
    if np.sum(signed_plan_areas(vertices, faces)) < 0.0:
        faces = np.ascontiguousarray(faces[:, ::-1])
    directed = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    low, high = np.sort(directed, axis=1).T
    key, inverse, count = np.unique(low * len(vertices) + high, return_inverse=True, return_counts=True)
    edges, inverse = np.stack(np.divmod(key, len(vertices)), axis=1), np.reshape(inverse, -1)
    outer = _outer_border(vertices, faces, directed[count[inverse] == 1])
    level = float(np.median(vertices[outer, 2]))
    off = np.abs(vertices[outer, 2] - level)
    if off.max() >= noise:
        raise TandemError(_border(vertices[outer[int(np.argmax(off))]], level, noise))
    turned = _undercut(vertices, faces, edges, inverse.reshape(-1, 3))
    if turned is not None:
        raise TandemError(turned)
    return SheetSurface(vertices, faces, edges, inverse.reshape(-1, 3), outer, level, used)


def plan_areas(surface: SheetSurface) -> FloatArray:
    """Areas (F,) [m^2] of the faces seen from above, not negative."""
    return np.maximum(signed_plan_areas(surface.vertices, surface.faces), 0.0)


class Beyond:
    """Asked for the plan area [m^2] of what of the faces around some vertices lies beyond a level [m], on the
    side on which the first of them is."""

    def __init__(self, surface: SheetSurface) -> None:
        self.surface, self.area = surface, plan_areas(surface)
        corners = surface.faces.reshape(-1)
        self.order = np.argsort(corners, kind="stable") // 3
        self.begin = np.concatenate([[0], np.cumsum(np.bincount(corners, minlength=len(surface.vertices)))])

    def __call__(self, members: list[int], level: float) -> float:
        """``members``: indices of vertices; one past the last, which closes the surface, has no faces."""
        height, count = self.surface.vertices[:, 2], len(self.surface.vertices)
        own = [member for member in members if member < count]
        if not own:
            return 0.0
        faces = np.unique(np.concatenate([self.order[self.begin[m] : self.begin[m + 1]] for m in own]))
        sign = 1.0 if height[own[0]] >= level else -1.0
        low, middle, high = np.sort(sign * (height[self.surface.faces[faces]] - level), axis=1).T
        tip = high**2 / np.maximum((high - low) * (high - middle), 1e-300)
        base = 1.0 - low**2 / np.maximum((high - low) * (middle - low), 1e-300)
        share = np.where(low >= 0.0, 1.0, np.where(middle >= 0.0, base, np.where(high > 0.0, tip, 0.0)))
        return float(np.sum(share * self.area[faces]))


def where(point: FloatArray) -> str:
    """A place (2 or 3,) [m] as a person reads it."""
    return "(" + ", ".join(f"{value / MM:.2f}" for value in point) + ") mm"


def signed_plan_areas(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Areas (F,) [m^2] of faces seen from above, negative of those that are seen from behind."""
    a, b, c = (vertices[faces[:, i], :2] for i in range(3))
    u, v = b - a, c - a
    return np.asarray(0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]))


def _joined(faces: IntArray, vertex: int) -> bool:
    """Whether all faces around a vertex belong to one piece that hangs together by edges."""
    ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    _, edge = np.unique(ends, axis=0, return_inverse=True)
    owner = np.repeat(np.arange(len(faces)), 3)
    graph = coo_array((np.ones(len(owner)), (owner, np.reshape(edge, -1)))).tocsr()
    _, piece = connected_components(graph @ graph.T, directed=False)
    return len(np.unique(piece[(faces == vertex).any(axis=1)])) == 1


def _outer_border(vertices: FloatArray, faces: IntArray, rim: IntArray) -> IntArray:
    """Vertices of the outer one of the closed lines of edges (R, 2) with one face. Any other is a hole."""
    count = len(vertices)
    starts = np.bincount(rim[:, 0], minlength=count)
    if (starts > 1).any():
        vertex = int(np.argmax(starts > 1))
        at = vertices[vertex]
        if _joined(faces, vertex):
            what = f"holes of the part, or one and its edge, meet in a point at {where(at)}; a sheet is "
            what += "formed whole, so close them and cut them afterwards"
            raise refusal("forming.hole", what, field="part")
        what = f"two pieces of the part meet in a single point at {where(at)} with no sheet between them, so "
        what += "they cannot be told apart; move them apart, or join them by a strip of flat sheet"
        raise refusal("forming.touching", what, field="part")
    graph = coo_array((np.ones(len(rim)), (rim[:, 0], rim[:, 1])), shape=(count, count))
    _, label = connected_components(graph, directed=False)
    a, b = vertices[rim[:, 0], :2], vertices[rim[:, 1], :2]
    doubled = np.bincount(label[rim[:, 0]], weights=a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    loops = np.unique(label[rim[:, 0]])
    # the outer line has the part on its left and so a positive area; so that a fold cannot mislead, the
    # largest
    outer = loops[np.argmax(np.abs(doubled[loops]))]
    holes = loops[loops != outer]
    if len(holes):
        raise TandemError([_hole(vertices[rim[label[rim[:, 0]] == hole, 0]]) for hole in holes[:10]])
    return np.asarray(np.unique(rim[label[rim[:, 0]] == outer]))


def _hole(points: FloatArray) -> Issue:
    middle, size = points.mean(axis=0), max(sides(points[:, :2])[0], float(np.ptp(points[:, 2])))
    what = f"the part has a hole, {size / MM:.3g} mm across, at {where(middle)}; a sheet is formed whole, so "
    what += "close it (or, where it is a crack between facets, sew the mesh) and cut it afterwards"
    return Issue("forming.hole", what, field="part", **measurement(size / MM, None, "mm"))


def _border(point: FloatArray, level: float, noise: float) -> Issue:
    off = abs(float(point[2]) - level) / MM
    what = f"the edge of the part is {off:.3f} mm off the flat sheet at {where(point)}, at most "
    what += f"{noise / MM:.3f} mm is allowed, so that its contours would end there; extend the part by a "
    what += "surface that runs out into the sheet plane"
    return Issue("forming.border", what, field="part", **measurement(off, noise / MM, "mm"))


def _undercut(vertices: FloatArray, faces: IntArray, edges: IntArray, face_edges: IntArray) -> Issue | None:
    """The worst group of joined faces that turn over. Its overhang is its plan area over the root of its
    area: a wall of length and height L that leans over by the angle a has L sin(a).
    """
    plan = signed_plan_areas(vertices, faces)
    turned = np.nonzero(plan < 0.0)[0]
    if len(turned) == 0:
        return None
    a, b, c = (vertices[faces[turned, i]] for i in range(3))
    normal = 0.5 * np.cross(b - a, c - a)
    area = np.linalg.norm(normal, axis=1)
    owner = np.repeat(np.arange(len(turned)), 3)
    incidence = coo_array(
        (np.ones(len(owner)), (owner, face_edges[turned].reshape(-1))), shape=(len(turned), len(edges))
    ).tocsr()
    _, label = connected_components(incidence @ incidence.T, directed=False)
    flat, full = np.bincount(label, weights=-plan[turned]), np.bincount(label, weights=area)
    overhang = flat / np.sqrt(np.maximum(full, 1e-300))
    worst = int(np.argmax(overhang))
    if overhang[worst] <= OVERHANG:
        return None
    mine = label == worst
    most = np.nonzero(mine)[0][int(np.argmin((normal[:, 2] / np.maximum(area, 1e-300))[mine]))]
    angle = math.degrees(math.acos(np.clip(normal[most, 2] / area[most], -1.0, 1.0)))
    at = vertices[faces[turned[most]]].mean(axis=0)
    groups = int((overhang > OVERHANG).sum())
    what = f"the part turns over in {groups} place{'s' if groups > 1 else ''}: a wall of {angle:.1f} deg at "
    what += f"{where(at)}, walls up to 90 deg can be formed; take the undercut out of the part, or turn the "
    what += "part"
    return Issue("forming.undercut", what, field="part", **measurement(angle, 90.0, "deg"), count=groups)


def slice_levels(
    surface: SheetSurface, height: FloatArray, levels: FloatArray
) -> tuple[tuple[FloatArray, ...], ...]:
    """For each of the ascending ``levels`` (L,) [m] the level lines of ``height`` (V,) [m].

    Lines are closed polylines (K, 3) [m], the first point repeated at the end, counter-clockwise seen from
    above, with z at the level. A vertex at a level counts as above it, so that flats at a level do no harm.
    ``height`` may differ from the surface's own where it is held constant; then the place of a line between
    two vertices is that of the surface where it can be. No level line may meet the surface's border.
    """
    faces, below = surface.faces, np.searchsorted(levels, height, side="right")
    first, last = below[faces].min(axis=1), below[faces].max(axis=1)
    crossed = np.nonzero(last > first)[0]
    if len(crossed) == 0:
        return tuple(() for _ in levels)
    corner = below[faces[crossed]]
    count = last[crossed] - first[crossed]
    owner = np.repeat(np.arange(len(crossed)), count)
    offset = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    level = first[crossed][owner] + offset
    above = corner[owner] > level[:, None]
    # going round a face counter-clockwise the line leaves by the edge that comes down to below the level and
    # enters by the one that goes up: then what is above lies on its left
    rises = ~above & np.roll(above, -1, axis=1)
    falls = above & ~np.roll(above, -1, axis=1)
    edge = surface.face_edges[crossed[owner]]
    edges = len(surface.edges)
    enter = level * edges + edge[np.arange(len(owner)), np.argmax(rises, axis=1)]
    leave = level * edges + edge[np.arange(len(owner)), np.argmax(falls, axis=1)]
    node, target = np.unique(leave, return_inverse=True)
    order = np.argsort(enter)
    if not np.array_equal(enter[order], node):
        raise ValueError("a level line meets the border of the surface")
    follower = np.reshape(target, -1)[order]
    loop, rank = _rings(follower)
    sorted_ = np.lexsort((rank, loop))
    points = _points(surface, height, levels, node, edges)[sorted_]
    starts = np.nonzero(np.diff(loop[sorted_], prepend=-1))[0]
    lines: list[list[FloatArray]] = [[] for _ in levels]
    for start, stop in zip(starts, [*starts[1:].tolist(), len(points)], strict=True):
        line = _closed(points[start:stop])
        if line is not None:
            lines[int(node[sorted_[start]] // edges)].append(line)
    return tuple(tuple(group) for group in lines)


def plan_area(line: FloatArray) -> float:
    """Signed area [m^2] of a closed polyline (K, 2 or 3) seen from above."""
    x, y = line[:, 0] - line[0, 0], line[:, 1] - line[0, 1]
    return float(0.5 * np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))


def _points(
    surface: SheetSurface, height: FloatArray, levels: FloatArray, node: IntArray, edges: int
) -> FloatArray:
    level = levels[node // edges]
    a, b = surface.edges[node % edges].T
    p, q = surface.vertices[a], surface.vertices[b]
    own = (level - p[:, 2]) / np.where(q[:, 2] == p[:, 2], 1.0, q[:, 2] - p[:, 2])
    held = (level - height[a]) / (height[b] - height[a])
    own_meets = (q[:, 2] != p[:, 2]) & (own >= 0.0) & (own <= 1.0)
    points = p + np.where(own_meets, own, held)[:, None] * (q - p)
    points[:, 2] = level
    return np.asarray(points)


def _rings(follower: IntArray) -> tuple[IntArray, IntArray]:
    """For a permutation (N,) the least member of each element's cycle, and the steps from the element on to
    it, counted down: by pointer doubling."""
    count = len(follower)
    least, jump = np.arange(count), follower.copy()
    rounds = max(int(np.ceil(np.log2(max(count, 2)))), 1)
    for _ in range(rounds):
        least = np.minimum(least, least[jump])
        jump = jump[jump]
    head = least == np.arange(count)
    jump = np.where(head, np.arange(count), follower)
    steps = np.where(head, 0, 1)
    for _ in range(rounds):
        steps = steps + steps[jump]
        jump = jump[jump]
    return least, -steps


def _closed(points: FloatArray) -> FloatArray | None:
    """A ring (K, 3) without repeated points, closed and counter-clockwise; None for a mere point."""
    apart = np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1) > 1e-9
    points = points[apart]
    if len(points) < 3:
        return None
    line = np.concatenate([points, points[:1]])
    return line if plan_area(line) >= 0.0 else line[::-1]


@dataclasses.dataclass(frozen=True)
class ContourTree:
    """A contour tree with every vertex on it, seen from ``root``: ``order`` (N,) vertices, parents first,
    ``parent`` (N,) the next vertex toward the root (-1 for the root), ``rank`` (N,) the place of a vertex
    among all by height, ``low`` and ``high`` (N,) [m] least and greatest height from the vertex on.
    """

    root: int
    order: IntArray
    parent: IntArray
    rank: IntArray
    low: FloatArray
    high: FloatArray


def contour_tree(height: FloatArray, edges: IntArray, root: int) -> ContourTree:
    """The contour tree of ``height`` (N,) over a connected graph ``edges`` (E, 2), the edges of a
    triangulated surface that every closed line parts in two (a disk, a sphere).
    """
    count = len(height)
    by_rank = np.lexsort((np.arange(count), height))
    rank = np.empty(count, dtype=np.int64)
    rank[by_rank] = np.arange(count)
    low, high = np.sort(rank[edges], axis=1).T
    joined = _sweep(range(count - 1, -1, -1), _neighbours(low, high, count))
    split = _sweep(range(count), _neighbours(high, low, count))
    arcs = _merge(joined, split)
    graph = coo_array((np.ones(len(arcs)), (arcs[:, 0], arcs[:, 1])), shape=(count, count)).tocsr()
    order, parent = breadth_first_order(graph, rank[root], directed=False)
    vertex_order = by_rank[order]
    vertex_parent = np.full(count, -1, dtype=np.int64)
    vertex_parent[by_rank[order[1:]]] = by_rank[parent[order[1:]]]
    least, most = _extents(height, vertex_order, vertex_parent)
    return ContourTree(root, vertex_order, vertex_parent, rank, least, most)


def _neighbours(own: IntArray, other: IntArray, count: int) -> tuple[list[int], list[int]]:
    """For each vertex where its neighbours on one side begin in the second list."""
    order = np.argsort(own, kind="stable")
    begin = np.concatenate([[0], np.cumsum(np.bincount(own, minlength=count))])
    return begin.tolist(), other[order].tolist()


def _sweep(sweep: range, neighbours: tuple[list[int], list[int]]) -> list[int]:
    """For each vertex the next one of the sweep on the component that it belongs to; -1 for the last.

    A union-find is one vertex after the other by its nature; lists are several times faster than arrays here.
    """
    begin, others = neighbours
    top = list(range(len(sweep)))
    follower = [-1] * len(sweep)
    for vertex in sweep:
        for other in others[begin[vertex] : begin[vertex + 1]]:
            while top[other] != other:
                top[other] = top[top[other]]
                other = top[other]
            if other != vertex:
                top[other] = vertex
                follower[other] = vertex
    return follower


def _merge(joined: list[int], split: list[int]) -> IntArray:
    """Arcs (N - 1, 2) of the contour tree from the trees of both sweeps."""
    count = len(joined)
    up, down = [0] * count, [0] * count
    for vertex in range(count):
        if joined[vertex] >= 0:
            up[joined[vertex]] += 1
        if split[vertex] >= 0:
            down[split[vertex]] += 1
    gone = [False] * count
    leaves = [vertex for vertex in range(count) if up[vertex] + down[vertex] == 1]
    arcs: list[tuple[int, int]] = []
    while leaves:
        leaf = leaves.pop()
        if up[leaf] + down[leaf] != 1:
            continue  # the last of all
        follower, degree = (joined, up) if up[leaf] == 0 else (split, down)
        gone[leaf] = True
        target = follower[leaf]
        while gone[target]:
            after = follower[target]
            if gone[after]:
                follower[target] = follower[after]
            target = after
        arcs.append((leaf, target))
        degree[target] -= 1
        if up[target] + down[target] == 1:
            leaves.append(target)
    return np.array(arcs, dtype=np.int64).reshape(-1, 2)


def _extents(height: FloatArray, order: IntArray, parent: IntArray) -> tuple[FloatArray, FloatArray]:
    low, high = height.tolist(), height.tolist()
    up = parent.tolist()
    for vertex in order[:0:-1].tolist():
        above = up[vertex]
        if low[vertex] < low[above]:
            low[above] = low[vertex]
        if high[vertex] > high[above]:
            high[above] = high[vertex]
    return np.array(low), np.array(high)
