"""Smaller triangles where they are wanted: longest edges are cut in two, until no node is left on an edge.

M.-C. Rivara, Algorithms for refinement of triangular grids suitable for adaptive and multigrid techniques,
International Journal for Numerical Methods in Engineering 20 (1984) 745-756. Of a triangle any edge of which
is cut the longest one is cut too, so no angle becomes smaller than half of the smallest before.
"""

from collections.abc import Callable

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, distinct_rows, lengths

MOST_ROUNDS = 20
"""How often triangles are cut at most."""


def bisected(
    nodes: FloatArray,
    triangles: IntArray,
    size_at: Callable[[FloatArray], FloatArray],
    middle: Callable[[FloatArray, FloatArray, IntArray], FloatArray],
) -> tuple[FloatArray, IntArray, IntArray]:
    """Nodes (n, d), the given ones first, triangles (m, 3) none of whose edges is longer than ``size_at``
    (m,) [m] says of their middles (m, 3), and (m,) of which given triangle each is a part.

    Of a node the first three of its d numbers are x, y, z [m]; ``middle`` makes new ones (k, d) of the ends
    (k, d) and (k, d) of edges that are cut, and of the given triangles (k, 2) beside them, twice the same one
    on a border.
    """
    owner = np.arange(len(triangles))
    for _ in range(MOST_ROUNDS):
        sides = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2), axis=2)
        edges, _, flat = distinct_rows(sides.reshape(-1, 2))
        edge = flat.reshape(-1, 3)
        long = lengths(nodes[edges[:, 1], :3] - nodes[edges[:, 0], :3])
        # of equally long edges the same one is the longest, whichever triangle asks
        rank = np.empty(len(long), dtype=np.int64)
        rank[np.argsort(long, kind="stable")] = np.arange(len(long))
        first = rank[edge].argmax(axis=1)
        longest = np.take_along_axis(edge, first[:, None], axis=1)[:, 0]
        cut = np.zeros(len(edges), dtype=np.bool_)
        cut[longest[long[longest] > size_at(nodes[triangles, :3].mean(axis=1))]] = True
        if not cut.any():
            break
        while not cut[asked := longest[cut[edge].any(axis=1)]].all():
            cut[asked] = True
        beside = np.zeros((len(edges), 2), dtype=np.int64)
        for column in (0, 1):  # the first and the last triangle of each edge
            order = slice(None, None, 1 - 2 * column)
            beside[edge[order].reshape(-1), column] = np.repeat(owner[order], 3)
        chosen = edges[cut]
        new = np.zeros(len(edges), dtype=np.int64)
        new[cut] = len(nodes) + np.arange(len(chosen))
        nodes = np.concatenate([nodes, middle(nodes[chosen[:, 0]], nodes[chosen[:, 1]], beside[cut])])
        triangles, parts = _parts(triangles, edge, first, cut, new)
        owner = owner[parts]
    return nodes, triangles, owner


def _parts(
    triangles: IntArray, edge: IntArray, first: IntArray, cut: BoolArray, new: IntArray
) -> tuple[IntArray, IntArray]:
    """What triangles (m, 3) with ``edge`` (m, 3), ``first`` (m,) of which is the longest, become where edges
    are ``cut`` at ``new`` nodes; and of which each is a part."""
    turn = (first[:, None] + np.arange(3)) % 3
    a, b, c = np.take_along_axis(triangles, turn, axis=1).T
    ab, bc, ca = (np.where(cut[e], new[e], -1) for e in np.take_along_axis(edge, turn, axis=1).T)
    row = np.arange(len(triangles))
    out = [np.column_stack([a, b, c, row])[ab < 0]]
    # each half of a triangle has one of the other two edges
    for one, two, tip, other in ((b, c, ab, bc), (c, a, ab, ca)):
        half, quarter = (ab >= 0) & (other < 0), (ab >= 0) & (other >= 0)
        out.append(np.column_stack([tip, one, two, row])[half])
        out.append(np.column_stack([tip, one, other, row])[quarter])
        out.append(np.column_stack([tip, other, two, row])[quarter])
    whole = np.concatenate(out)
    return whole[:, :3], whole[:, 3]
