"""Contour tree of a height over a surface: how its level lines appear, split, merge and vanish.

Each point of the tree is one level line. Carr, Snoeyink and Axen, Computing contour trees in all dimensions,
Computational Geometry 24 (2003): a sweep from the top joins what is above, one from below what is beneath,
and both trees are merged leaf by leaf. Equal heights are told apart by the index, so that flats need no care.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order

from planner.forming.values import FloatArray, IntArray


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
