"""Local refinement of triangle meshes by longest-edge bisection, without hanging nodes.

Edges are cut at their middles. If any edge of a triangle is cut, its longest edge is cut too, so no angle
falls below half of the smallest original angle.

Source: M.-C. Rivara, Algorithms for refinement of triangular grids suitable for adaptive and multigrid
techniques, International Journal for Numerical Methods in Engineering 20 (1984) 745-756.
"""

from collections.abc import Callable

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, lengths, unique_rows

MAX_ROUNDS = 20
"""Maximum number of rounds, each of which cuts an edge of a triangle at most once."""


def bisect(
    nodes: FloatArray,
    triangles: IntArray,
    size_at: Callable[[FloatArray], FloatArray],
    middle: Callable[[FloatArray, FloatArray, IntArray], FloatArray],
) -> tuple[FloatArray, IntArray, IntArray]:
    """Bisect triangles until none has an edge longer than allowed, in at most `MAX_ROUNDS` rounds.

    Args:
        nodes: Nodes (n, d); the first three of the d values are x, y, z [m].
        triangles: Node indices (m, 3).
        size_at: Maximum edge length (m,) [m] for triangles with centroids (m, 3).
        middle: Function that returns new nodes (k, d) for the ends (k, d) and (k, d) of cut edges, and the
            indices (k, 2) of the given triangles on both sides of each edge (equal on a border).

    Returns:
        Nodes (n, d) with the given ones first, triangles (m, 3), and the index (m,) of the given triangle
        that each is a part of.

    Source: Rivara 1984.
    """
    owner = np.arange(len(triangles))
    for _ in range(MAX_ROUNDS):
        sides = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2), axis=2)
        edges, _, flat = unique_rows(sides.reshape(-1, 2))
        edge = flat.reshape(-1, 3)
        edge_length = lengths(nodes[edges[:, 1], :3] - nodes[edges[:, 0], :3])
        # ties between equally long edges are resolved alike for all triangles
        rank = np.empty(len(edge_length), dtype=np.int64)
        rank[np.argsort(edge_length, kind="stable")] = np.arange(len(edge_length))
        first = rank[edge].argmax(axis=1)
        longest = np.take_along_axis(edge, first[:, None], axis=1)[:, 0]
        cut = np.zeros(len(edges), dtype=np.bool_)
        cut[longest[edge_length[longest] > size_at(nodes[triangles, :3].mean(axis=1))]] = True
        if not cut.any():
            break
        # cut the longest edges of affected triangles too, until no further triangle is affected
        while not cut[needed := longest[cut[edge].any(axis=1)]].all():
            cut[needed] = True
        adjacent = np.zeros((len(edges), 2), dtype=np.int64)
        for column in (0, 1):  # first and last triangle of each edge
            order = slice(None, None, 1 - 2 * column)
            adjacent[edge[order].reshape(-1), column] = np.repeat(owner[order], 3)
        chosen = edges[cut]
        new = np.zeros(len(edges), dtype=np.int64)
        new[cut] = len(nodes) + np.arange(len(chosen))
        nodes = np.concatenate([nodes, middle(nodes[chosen[:, 0]], nodes[chosen[:, 1]], adjacent[cut])])
        triangles, parts = _split_triangles(triangles, edge, first, cut, new)
        owner = owner[parts]
    return nodes, triangles, owner


def _split_triangles(
    triangles: IntArray, edge: IntArray, first: IntArray, cut: BoolArray, new: IntArray
) -> tuple[IntArray, IntArray]:
    """Split triangles (m, 3) at cut edges into two to four parts. Uncut triangles are kept.

    If any edge of a triangle is cut, its longest edge must be cut.

    Args:
        triangles: Node indices (m, 3).
        edge: Edge indices (m, 3); edge k runs from corner k to the next one.
        first: Which of the three edges (m,) is the longest.
        cut: Whether each of the e edges is cut (e,).
        new: Index of the node in the middle of each cut edge (e,).

    Returns:
        Triangles (k, 3), and the index (k,) of the triangle that each is a part of.
    """
    corner_order = (first[:, None] + np.arange(3)) % 3
    a, b, c = np.take_along_axis(triangles, corner_order, axis=1).T
    # corners a, b, c start at the longest edge; ab, bc and ca are the new nodes on the edges, -1 if not cut
    ab, bc, ca = (np.where(cut[e], new[e], -1) for e in np.take_along_axis(edge, corner_order, axis=1).T)
    row = np.arange(len(triangles))
    out = [np.column_stack([a, b, c, row])[ab < 0]]
    # each half of a triangle contains one of the other two edges
    for first_end, second_end, tip, other in ((b, c, ab, bc), (c, a, ab, ca)):
        half, quarter = (ab >= 0) & (other < 0), (ab >= 0) & (other >= 0)
        out.append(np.column_stack([tip, first_end, second_end, row])[half])
        out.append(np.column_stack([tip, first_end, other, row])[quarter])
        out.append(np.column_stack([tip, other, second_end, row])[quarter])
    rows = np.concatenate(out)
    return rows[:, :3], rows[:, 3]
