"""Which arms of a setup give way under what, and have it compensated, as claims: from the problem alone."""

import numpy as np

from planner.claims.claim import ArmSags
from planner.geometry.arrays import FloatArray
from planner.problem import Arm, Force, Problem, Setup, Stock


def sags(problem: Problem, setup: Setup) -> tuple[ArmSags, ...]:
    """A claim for each arm of a setup whose sag is compensated, also where it only stands by."""
    out = []
    for arm in setup.cell.arms:
        if arm.sag is None or arm.stiffness is None:
            continue
        mass, cog = carried(arm, setup.stock) if arm.sag.load else (0.0, np.zeros(3))
        force = problem.force_on(arm.name, setup)
        if force is None:
            force = Force(np.zeros((1, 3)), np.zeros(1), "stock")
        stiff, most = arm.stiffness.joints, arm.sag.most
        out.append(ArmSags(arm.name, stiff, mass, cog, force.vectors, force.height, force.frame, most))
    return tuple(out)


def carried(arm: Arm, stock: Stock) -> tuple[float, FloatArray]:
    """Mass [kg] and centre of gravity (3,) [m] in the flange's frame of a tool, with the block that it
    holds."""
    mass, moment = arm.tool.mass, arm.tool.mass * arm.tool.cog
    if stock.held_by == arm.name and stock.mass is not None:
        middle = arm.tool.tcp @ stock.grip @ np.append(0.5 * (stock.lower + stock.upper), 1.0)
        mass, moment = mass + stock.mass, moment + stock.mass * middle[:3]
    return mass, moment / mass
