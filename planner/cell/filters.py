"""Which pairs of bodies are not held apart, and why: decided once when a cell is built, and shown in the
report."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.tree import BodyIndex
from pydrake.planning import SceneGraphCollisionChecker

FloatArray = NDArray[np.float64]
FilteredPair = tuple[str, str, str]

SAMPLES: Final = 200
SHARE: Final = 0.95
NEAR: Final = 0.012
"""Bodies of one arm within this distance [m] in nearly all postures tell nothing when they are near."""

CHAIN: Final = ("base_link", *(f"link_{i}" for i in range(1, 7)), "tool")
EDGE: Final = {
    "tool": "the edge belongs to the tool",
    "link_6": "the edge is fixed to the flange",
    "link_5": "kept apart by the robot's own build",
}
HELD: Final = {
    "tool": "the block is held by the tool",
    "link_6": "the block is fixed to the flange",
    "link_5": "of one arm and always near each other",
}
"""Why an arm's own edge, and a block that it holds, are not held apart from these bodies of the arm."""

BUILT_APART: Final = frozenset({(0, 2), (1, 3), (2, 4), (3, 5), (4, 6), (5, 7)})
"""Places in the chain of pairs two joints apart whose solids, fatter than the real links, would touch."""


def filter_pairs(
    checker: SceneGraphCollisionChecker,
    names: Mapping[int, str],
    limits: tuple[FloatArray, FloatArray],
    holder: str | None = None,
) -> tuple[FilteredPair, ...]:
    """Filters pairs of one arm in the checker and returns all filtered pairs with reasons, sorted.

    Neighbours and the pairs of BUILT_APART, EDGE and HELD are filtered by structure; ``holder`` is the arm
    that holds the stock, if any. Other pairs of one arm are filtered when they come within 12 mm in more than
    95 % of 200 random postures (seeded) within the limits (nq,), (nq,).
    """
    shaped = {index for index in names if _has_solids(checker, index)}
    out: list[FilteredPair] = []
    for a in sorted(shaped):
        for b in sorted(shaped):
            if a < b and (reason := _structural(names[a], names[b], holder)):
                out.append((names[a], names[b], reason))
                if "fixed to the world" not in reason:
                    checker.SetCollisionFilteredBetween(BodyIndex(a), BodyIndex(b), True)
    near = _always_near(checker, names, limits)
    for a, b in near:
        checker.SetCollisionFilteredBetween(BodyIndex(a), BodyIndex(b), True)
        out.append((names[a], names[b], "of one arm and always near each other"))
    return tuple(sorted(out))


def _has_solids(checker: Any, index: int) -> bool:
    return bool(checker.plant().GetCollisionGeometriesForBody(checker.plant().get_body(BodyIndex(index))))


def fixed(name: str, holder: str | None) -> bool:
    """Whether a body stands in the world; ``holder`` is the arm that holds the stock, if any."""
    if name == "stock" and holder is not None:
        return False
    return "/" not in name or name.endswith("/base_link")


def _structural(a: str, b: str, holder: str | None) -> str | None:
    if fixed(a, holder) and fixed(b, holder):
        return "both fixed to the world"
    (arm_a, _, link_a), (arm_b, _, link_b) = a.partition("/"), b.partition("/")
    if holder is not None and "stock" in (a, b):
        arm, link = (arm_a, link_a) if b == "stock" else (arm_b, link_b)
        return HELD.get(link) if arm == holder else None
    if not link_a or not link_b or arm_a != arm_b:
        return None
    if "edge" in (link_a, link_b):
        return EDGE.get(link_a if link_b == "edge" else link_b)
    pair = (CHAIN.index(link_a), CHAIN.index(link_b))
    if pair in BUILT_APART:
        return "kept apart by the robot's own build"
    return "neighbours in the chain" if abs(pair[0] - pair[1]) == 1 else None


def _always_near(
    checker: SceneGraphCollisionChecker, names: Mapping[int, str], limits: tuple[FloatArray, FloatArray]
) -> list[tuple[int, int]]:
    rng = np.random.default_rng(20)
    lower, upper = limits
    counts: dict[tuple[int, int], int] = {}
    for q in rng.uniform(lower, upper, size=(SAMPLES, len(lower))):
        found = checker.CalcRobotClearance(q, NEAR)
        pairs = zip(found.robot_indices(), found.other_indices(), found.distances(), strict=True)
        near = {(min(int(a), int(b)), max(int(a), int(b))) for a, b, d in pairs if d < NEAR}
        for pair in near:
            if names[pair[0]].partition("/")[0] == names[pair[1]].partition("/")[0]:
                counts[pair] = counts.get(pair, 0) + 1
    return sorted(pair for pair, count in counts.items() if count > SHARE * SAMPLES)
