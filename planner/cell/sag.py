"""Claims on the sag of arms that is compensated in a setup. They follow from the problem alone."""

import numpy as np

from planner.claims.claim import ArmSags
from planner.geometry.arrays import FloatArray
from planner.problem import Arm, Force, Problem, Setup, Stock


def sag_claims(problem: Problem, setup: Setup) -> tuple[ArmSags, ...]:
    """Return a claim for each arm of a setup whose sag is compensated, even if no operation uses the arm.

    Args:
        problem: The problem.
        setup: The setup.
    """
    out = []
    for arm in setup.cell.arms:
        if arm.sag is None or arm.stiffness is None:
            continue
        mass, cog = carried_load(arm, setup.stock) if arm.sag.load else (0.0, np.zeros(3))
        force = problem.tool_force(arm.name, setup)
        if force is None:
            force = Force(np.zeros((1, 3)), np.zeros(1), "stock")
        stiffness, max_sag = arm.stiffness.joints, arm.sag.max_correction
        out.append(ArmSags(arm.name, stiffness, mass, cog, force.vectors, force.height, force.frame, max_sag))
    return tuple(out)


def carried_load(arm: Arm, stock: Stock) -> tuple[float, FloatArray]:
    """Return the mass [kg] and centre of gravity (3,) [m] of a tool with the block that it holds.

    The centre of gravity is in the flange's frame.
    """
    mass, moment = arm.tool.mass, arm.tool.mass * arm.tool.cog
    if stock.held_by == arm.name and stock.mass is not None:
        middle = arm.tool.tcp @ stock.grip @ np.append(0.5 * (stock.lower + stock.upper), 1.0)
        mass, moment = mass + stock.mass, moment + stock.mass * middle[:3]
    return mass, moment / mass
