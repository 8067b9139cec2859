"""What a straight wire needs to know of the bow that carries it, from the tool itself."""

from __future__ import annotations

import dataclasses

import numpy as np

from planner.geometry.rigid import inverse, transform
from planner.hotwire.straight_operation import Straight
from planner.issues import Issue, TandemError
from planner.problem import Setup, Shape, Tool


@dataclasses.dataclass(frozen=True)
class Bow:
    """A bow: ``span`` of the wire between its clamps, ``throat`` from the wire to the nearest part of the
    beam behind it, ``radius`` of the wire [m]."""

    span: float
    throat: float
    radius: float


def bow_of(op: Straight, setup: Setup) -> Bow:
    """The bow on the first arm. Raises ``TandemError``: bow.missing, bow.holder, bow.arms."""
    issues = [*_arms(op, setup)]
    tool = setup.cell.arm(op.arms[0]).tool
    if tool.edge is None:
        issues.append(
            Issue(
                "bow.missing",
                f"{op.name}: arm {op.arms[0]} carries the tool {tool.name}, which has no straight wire; "
                "give it a bow, in the cell or in this operation's setup",
                field="cell.arms",
                arm=op.arms[0],
            )
        )
    if issues or tool.edge is None:
        raise TandemError(issues)
    return Bow(float(tool.edge.size[1]), _throat(tool, float(tool.edge.size[1])), float(tool.edge.size[0]))


def _arms(op: Straight, setup: Setup) -> list[Issue]:
    """The operation has the holder as its second arm exactly where the block is held."""
    holder = setup.stock.held_by
    wanted = (op.arms[0],) if holder is None else (op.arms[0], holder)
    if op.arms == wanted and op.arms[0] != holder:
        return []
    how = "stands" if holder is None else f"is held by arm {holder}"
    need = "the arm with the bow alone" if holder is None else f"the arm with the bow, then {holder}"
    return [
        Issue(
            "bow.arms",
            f"{op.name}: arms are {', '.join(op.arms)}, but the block {how} in this setup; name {need}",
            field="operations.arms",
        )
    ]


def _throat(tool: Tool, span: float) -> float:
    """Free depth [m] behind the middle of the wire: to the nearest shape of the tool there."""
    to_tcp = inverse(tool.tcp)
    nearest = [-np.inf]
    for shape in tool.shapes:
        points = transform(to_tcp @ shape.pose, corners(shape))
        low, high = points.min(axis=0), points.max(axis=0)
        if low[0] < 0.4 * span and high[0] > -0.4 * span:
            nearest.append(float(high[2]))
    return -max(nearest)


def corners(shape: Shape) -> np.ndarray:
    """Points whose hull holds a shape, in its own frame."""
    if shape.vertices is not None:
        return shape.vertices
    if shape.kind == "box":
        half = 0.5 * np.array(shape.size)
    else:
        radius = shape.size[0]
        length = shape.size[1] if len(shape.size) > 1 else 0.0
        cap = radius if shape.kind in ("capsule", "sphere") else 0.0
        half = np.array([radius, radius, 0.5 * length + cap])
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    return np.asarray(signs * half)
