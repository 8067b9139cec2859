"""Clearance of an arm to itself: which pairs it applies to, and how such distances are reported.

Base, links and tool of one arm keep ``Settings.self_clearance``, all other pairs keep ``Settings.clearance``.
So that queries can compare all distances with one limit, the distance of pairs of one arm is increased by the
difference of both settings (:class:`planner.cell.bodies.ClearanceEasing`). This is called the counted
distance. Users see true distances, each with its own limit.
"""

import itertools
from typing import Final

from planner.cell.bodies import NO_EASING, ClearanceEasing
from planner.cell.clearance import Pairs
from planner.cell.plant import CellModel
from planner.problem import Settings

CLEARANCE_FIELD: Final = "clearance_mm"
"""Setting for the clearance between bodies of different arms, the stock and obstacles."""
SELF_CLEARANCE_FIELD: Final = "own_clearance_mm"
"""Setting for the clearance between bodies of one arm."""


def is_same_arm(first: str, other: str) -> bool:
    """Whether two bodies are base, links or tool of one arm.

    The working end of a tool (``edge``) is excluded: a wire bends and is hot, and a cutter rotates. A stock
    that the arm holds is excluded too, because its pose in the gripper is known less accurately.
    """
    (arm, _, part), (second_arm, _, second_part) = first.partition("/"), other.partition("/")
    return (
        arm == second_arm
        and first != other
        and "edge" not in (part, second_part)
        and bool(part and second_part)
    )


def same_arm_pairs(model: CellModel) -> Pairs:
    """Return the pairs of bodies of a cell that belong to the same arm, as sets of two body names."""
    names = sorted({solid.body for solid in model.solids})
    return frozenset(frozenset(pair) for pair in itertools.combinations(names, 2) if is_same_arm(*pair))


def other_pairs(model: CellModel) -> Pairs:
    """Return the pairs of bodies of a cell that do not belong to the same arm, as sets of two body names."""
    names = sorted({solid.body for solid in model.solids})
    return frozenset(map(frozenset, itertools.combinations(names, 2))) - same_arm_pairs(model)


def with_counted_distances(model: CellModel, settings: Settings) -> CellModel:
    """Return a copy of a cell model whose distances are counted distances.

    Every pair keeps its clearance if its counted distance is at least ``settings.clearance``.
    """
    easing = settings.clearance - settings.self_clearance
    return model.with_easing(ClearanceEasing(same_arm_pairs(model), easing) if easing > 0.0 else NO_EASING)


def required_clearance(settings: Settings, pair: tuple[str, str]) -> float:
    """Return the clearance [m] that a pair of bodies, given by their names, has to keep."""
    return settings.self_clearance if is_same_arm(*pair) else settings.clearance


def true_distance(settings: Settings, counted: float, pair: tuple[str, str]) -> tuple[float, float, str]:
    """Convert a counted distance to the true distance of a pair.

    Args:
        settings: Settings with both clearances.
        counted: Counted distance [m] of the pair in an eased model.
        pair: Names of the two bodies.

    Returns:
        True distance [m], required clearance [m] and the name of the setting that requires it.
    """
    limit = required_clearance(settings, pair)
    return (
        counted - (settings.clearance - limit),
        limit,
        SELF_CLEARANCE_FIELD if is_same_arm(*pair) else CLEARANCE_FIELD,
    )
