"""What arms carry: the block that a tool holds, as the controller must know it."""

from __future__ import annotations

import numpy as np

from planner.claims import HoldsStock
from planner.issues import Issue, TandemError
from planner.plans import Plan
from planner.post.program import Carry, Load
from planner.problem import Problem, Setup

LEAST_MASS = 0.001
"""Least mass [kg] of a load in RAPID."""


def carries(plan: Plan, problem: Problem) -> dict[int, dict[str, Carry]]:
    """{index of an operation: {arm: what it carries from there on}}, where that changes.

    Raises :class:`TandemError` (``post.load``) where a block is held and no claim says how heavy it is.
    """
    out: dict[int, dict[str, Carry]] = {}
    before: str | None = None
    for setup in problem.setups:
        if setup.operations[0] >= len(plan.operations):
            break
        holder = setup.stock.held_by
        change = {before: Carry(None)} if before is not None and before != holder else {}
        if holder is not None:
            change[holder] = Carry(_load(plan, setup, holder))
        out[setup.operations[0]] = change
        before = holder
    return out


def _load(plan: Plan, setup: Setup, holder: str) -> Load:
    """The block of a setup in the holder's TCP frame, a solid box of one density."""
    claims = [
        claim
        for index in setup.operations
        if index < len(plan.operations)
        for claim in plan.operations[index].targets.claims
        if isinstance(claim, HoldsStock) and claim.arm == holder
    ]
    if not claims or not claims[0].mass >= LEAST_MASS:
        got = f"{claims[0].mass:g} kg" if claims else "no claim of its weight"
        message = f"setup {setup.number}: arm {holder} holds the block, with {got}; it needs {LEAST_MASS} kg"
        hint = (
            "give a larger block, or one of a denser foam" if claims else "name the block's foam (stock.foam)"
        )
        raise TandemError(Issue("post.load", message, arm=holder, hint=f"{hint}, and plan again"))
    claim, size = claims[0], setup.stock.upper - setup.stock.lower
    inertia = claim.mass / 12.0 * (np.sum(size**2) - size**2)
    return Load(setup.number, claim.mass, claim.cog, claim.grip[:3, :3], inertia)
