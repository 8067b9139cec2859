"""Which bodies planning keeps apart by the clearance of one arm with itself, and how such distances are told.

Base, links and tool of one arm are held apart by ``Settings.of_one_arm``, all else by ``Settings.clearance``.
So that one figure can be asked for everywhere, pairs of one arm count as farther apart by the difference
(:class:`planner.cell.bodies.Easing`); what people are told are true distances, each with its own limit.
"""

import itertools
from typing import Final

from planner.cell.bodies import NOT_EASED, Easing
from planner.cell.clearance import Pairs
from planner.cell.plant import CellModel
from planner.problem import Settings

FIELD: Final = "clearance_mm"
"""The setting that holds for bodies of different arms, the block and obstacles,"""
OWN_FIELD: Final = "own_clearance_mm"
"""and that of bodies of one arm."""


def is_own(one: str, other: str) -> bool:
    """Whether two bodies are base, links or tool of one arm. Its edge is not: a wire bends and is hot, and a
    cutter turns. Nor is a block that it holds: how it lies in the gripper is known less well."""
    (arm, _, part), (second, _, another) = one.partition("/"), other.partition("/")
    return arm == second and one != other and "edge" not in (part, another) and bool(part and another)


def own_pairs(model: CellModel) -> Pairs:
    """Pairs of bodies of a cell that are of one arm."""
    names = sorted({solid.body for solid in model.solids})
    return frozenset(frozenset(pair) for pair in itertools.combinations(names, 2) if is_own(*pair))


def other_pairs(model: CellModel) -> Pairs:
    """All other pairs of bodies."""
    names = sorted({solid.body for solid in model.solids})
    return frozenset(map(frozenset, itertools.combinations(names, 2))) - own_pairs(model)


def eased(model: CellModel, settings: Settings) -> CellModel:
    """The cell's model in which every pair keeps enough where it counts as ``settings.clearance`` apart."""
    by = settings.clearance - settings.of_one_arm
    return model.with_easing(Easing(own_pairs(model), by) if by > 0.0 else NOT_EASED)


def wanted(settings: Settings, pair: tuple[str, str]) -> float:
    """The clearance [m] that is wanted of a pair of bodies."""
    return settings.of_one_arm if is_own(*pair) else settings.clearance


def told(settings: Settings, counted: float, pair: tuple[str, str]) -> tuple[float, float, str]:
    """The true distance [m] of a pair that counts as ``counted`` [m] apart in an eased model, the clearance
    [m] that is wanted of it, and the name of the setting."""
    limit = wanted(settings, pair)
    return counted - (settings.clearance - limit), limit, OWN_FIELD if is_own(*pair) else FIELD
