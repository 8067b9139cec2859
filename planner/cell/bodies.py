"""The solids of a cell's bodies as Drake holds them, and where the bodies are, in NumPy and batched."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Box, Capsule, Cylinder, SceneGraphInspector
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex

from planner.catalogue import RobotData
from planner.cell.distance import Solid
from planner.cell.robots import link_frames
from planner.geometry.rigid import from_parts
from planner.geometry.shapes import Shape
from planner.problem import Cell, Stock
from planner.tooling import working_solid

FloatArray = NDArray[np.float64]


def own_shapes(cell: Cell, stock: Stock) -> dict[str, tuple[Shape, ...]]:
    """Shapes by body, in the body's frame, of everything but the robots' links."""
    out = {f"{arm.name}/tool": arm.tool.shapes for arm in cell.arms}
    solids = {arm.name: working_solid(arm.tool) for arm in cell.arms}
    out.update({f"{name}/edge": (solid,) for name, solid in solids.items() if solid is not None})
    lower, upper = stock.lower, stock.upper
    x, y, z = (upper - lower).tolist()
    block = Shape("box", (x, y, z), from_parts(np.eye(3), 0.5 * (lower + upper)))
    out["stock"] = (block, *(stock.sheet.formed if stock.sheet is not None else ()))
    if stock.support:
        out["support"] = stock.support
    out.update({obstacle.name: obstacle.shapes for obstacle in cell.obstacles})
    return out


def collect(
    plant: MultibodyPlant,
    inspector: SceneGraphInspector,
    names: Mapping[int, str],
    own: Mapping[str, tuple[Shape, ...]],
) -> tuple[Solid, ...]:
    """All collision solids: those of the links as Drake read them from the URDFs, the others as they were
    given."""
    out = []
    for index, name in names.items():
        if name in own:
            out += [Solid(name, shape) for shape in own[name]]
            continue
        for geometry in plant.GetCollisionGeometriesForBody(plant.get_body(BodyIndex(index))):
            pose = inspector.GetPoseInFrame(geometry).GetAsMatrix4()
            out.append(Solid(name, _ours(inspector.GetShape(geometry), pose)))
    return tuple(out)


def _ours(shape: object, pose: FloatArray) -> Shape:
    if isinstance(shape, Box):
        return Shape("box", tuple(float(v) for v in shape.size()), pose)
    if isinstance(shape, Capsule):
        return Shape("capsule", (shape.radius(), shape.length()), pose)
    if isinstance(shape, Cylinder):
        return Shape("cylinder", (shape.radius(), shape.length()), pose)
    raise TypeError(
        f"a robot's collision solid is a {type(shape).__name__}; only box, capsule and cylinder are used"
    )


def body_poses(arm: str, robot: RobotData, base: FloatArray, q: FloatArray) -> dict[str, FloatArray]:
    """World poses (B, 4, 4) of the links and the tool of one arm at serial angles q (B, 6); the base's is
    (1, 4, 4).

    A link's frame is parallel to the base at the controller's zero pose, as in the URDF; the tool's is the
    flange.
    """
    upright = np.swapaxes(link_frames(robot, np.zeros(6))[:6, :3, :3], -1, -2)
    turn = np.zeros((7, 4, 4))
    turn[:, 3, 3] = 1.0
    turn[:6, :3, :3] = upright
    turn[6] = np.eye(4)
    frames = base @ link_frames(robot, q) @ turn
    out = {f"{arm}/link_{i + 1}": frames[:, i] for i in range(6)}
    out[f"{arm}/tool"] = frames[:, 6]
    out[f"{arm}/base_link"] = base[None]
    return out
