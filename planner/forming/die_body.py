"""The die of two point forming, its sheet and its clamp, as bodies that arms keep clear of.

The die stands behind the sheet, and what the tool may not do to it follows from two things that are held
elsewhere: the die does not stand in the part's far face (`planner.forming.die`), and the tool does not cut
into the near one. So the die needs no shape of its own for the tool's working end; for all other bodies its
convex hull stands for it, which is larger than a female die, on the side away from the tool alone.

Over a male die the clamp sinks with the sheet's rim, from the top of the die to the level that the sheet's
frame stands for. The clamp's bars reach over all places that they pass, and so does the flat sheet: bodies
keep clear of both at every height at once, whenever they are there.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from planner.geometry.mesh import TriangleMesh, read_mesh
from planner.geometry.outer_hull import outer_hull
from planner.geometry.rigid import from_rpy
from planner.geometry.shapes import Shape
from planner.problem import Part, Stock
from planner.units import LENGTH_UNITS

if TYPE_CHECKING:
    from planner.forming.operation import Die


def die_mesh(die: Die) -> TriangleMesh:
    """The die's mesh [m] in the sheet's frame. Raises ``TandemError`` for files that cannot be read."""
    return read_mesh(die.file, LENGTH_UNITS[die.unit])


def with_die(die: Die, side: int, stock: Stock, part: Part | None) -> Stock:
    """The stock with the die behind it and, where the holder sinks, with clamp and sheet drawn out towards
    ``side`` (+1 top) over all heights at which they are. Raises ``TandemError``: issues of the die's file."""
    if stock.sheet is None:
        return stock
    mesh = die_mesh(die)
    hull = outer_hull(mesh.vertices)
    solids = [Shape("mesh", (), np.eye(4), hull.vertices, hull.faces)]
    support = stock.support
    if die.holder == "sinking" and part is not None and part.formed is not None:
        sunk = max(float((side * part.formed.mesh.vertices[:, 2]).max()), 0.0)
        support = tuple(_drawn(shape, side * sunk) for shape in support)
        sheet = Shape(
            "box", tuple(stock.size), from_rpy([0.0, 0.0, 0.5 * float(stock.size[2])], [0.0, 0.0, 0.0])
        )
        solids.append(_drawn(sheet, side * sunk))
    made = dataclasses.replace(stock.sheet, formed=(*stock.sheet.formed, *solids))
    return dataclasses.replace(stock, sheet=made, support=support)


def _drawn(shape: Shape, along: float) -> Shape:
    """A box whose last side is along z, drawn out by ``along`` [m] along z; others stay as they are."""
    if shape.kind != "box":
        return shape
    x, y, z = shape.size
    pose = shape.pose.copy()
    pose[2, 3] += 0.5 * along
    return dataclasses.replace(shape, size=(x, y, z + abs(along)), pose=pose)
