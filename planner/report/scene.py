"""What a cell looks like: robots and fixed bodies, once; what each setup adds; where things stand.

Shapes come from the cell's Drake model. Where the block and a straight wire are follows from joint
angles, in the setup of an operation.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import trimesh
from pydrake.geometry import Box, Capsule, Convex, Cylinder, Mesh, Rgba, Role, Sphere

from planner.catalogue import robots
from planner.cell.bodies import drake_shape
from planner.cell.kinematics import forward
from planner.cell.plant import STOCK_COLOUR, SUPPORT_COLOUR, TOOL_COLOUR, CellModel
from planner.cell.support import with_support
from planner.geometry.arrays import FloatArray
from planner.geometry.rigid import Shape, axis_ends, inverse
from planner.problem import Arm, Problem, Setup
from planner.report import raster
from planner.report.raster import Solid
from planner.tooling import Bow, Mill, working_solid


def flange_poses(arm: Arm, bases: Mapping[str, FloatArray], q: FloatArray) -> FloatArray:
    """Flange poses (..., 4, 4) in the world at joint angles q (..., 6); ``bases`` replaces the arm's own."""
    base = np.asarray(bases.get(arm.name, arm.base))
    return np.asarray(base @ forward(robots.robot(arm.robot), q))


def block_pose(
    setup: Setup, place: FloatArray, bases: Mapping[str, FloatArray], q: Mapping[str, FloatArray]
) -> FloatArray:
    """The stock's poses in the world: (4, 4) of a standing block, (T, 4, 4) of one that an arm holds, at the
    joint angles {arm: (T, 6)}; an arm that is not named stays at home."""
    holder = setup.stock.held_by
    if holder is None:
        return np.asarray(place, dtype=np.float64)
    arm = setup.cell.arm(holder)
    return np.asarray(flange_poses(arm, bases, q.get(holder, arm.home)) @ arm.tool.tcp @ setup.stock.grip)


def cutter(setup: Setup, arms: tuple[str, ...]) -> Arm | None:
    """The first of these arms whose tool cuts along a line, or None: a bow along its wire, a mill along its
    axis."""
    carriers = (setup.cell.arm(name) for name in arms)
    return next((arm for arm in carriers if isinstance(arm.tool, Bow | Mill)), None)


def wire_in_block(
    setup: Setup,
    arm: Arm,
    place: FloatArray,
    bases: Mapping[str, FloatArray],
    q: Mapping[str, FloatArray],
) -> FloatArray:
    """Both ends (T, 2, 3) [m] of a straight wire, or of a cutter's axis, in the stock frame at joint angles
    {arm: (T, 6)}."""
    pose = inverse(block_pose(setup, place, bases, q)) @ flange_poses(arm, bases, q[arm.name])
    return np.asarray(np.einsum("tij,kj->tki", pose[:, :3, :3], wire_ends(arm)) + pose[:, None, :3, 3])


def wire_ends(arm: Arm) -> FloatArray:
    """Both ends (2, 3) [m] of a straight wire, or of a cutter's axis, in the flange frame; ``ValueError`` for
    tools without either."""
    match arm.tool:
        case Bow():
            return axis_ends(arm.tool.wire)
        case Mill():
            return axis_ends(arm.tool.solid)
        case _:
            raise ValueError(f"tool {arm.tool.name} cuts along no line")


def block_box(setup: Setup) -> Shape:
    """The block as found, in the stock frame."""
    lower, upper = setup.stock.lower, setup.stock.upper
    pose = np.eye(4)
    pose[:3, 3] = 0.5 * (lower + upper)
    size = upper - lower
    return Shape("box", (float(size[0]), float(size[1]), float(size[2])), pose)


def setup_index(problem: Problem, operation: int) -> int:
    """Place of an operation's setup among the problem's setups, from 0."""
    return problem.setup_of(operation).number - 1


_PLAIN_COLOUR = (0.7, 0.72, 0.75, 1.0)
"""Red, green, blue, alpha in 0..1 of a body that states no colour."""
HOT_COLOUR: Final = (1.0, 0.30, 0.05, 1.0)
"""Red, green, blue, alpha in 0..1 of a hot wire."""
LEAST_WIRE_RADIUS_M: Final = 2.2e-3
"""Least radius [m] at which a wire is drawn, so that it can be seen."""


@dataclasses.dataclass(frozen=True)
class Piece:
    """One visible shape: Drake's ``shape`` at ``pose`` (4, 4) in its body's frame, also as triangles."""

    body: str
    shape: Any
    pose: FloatArray
    color: tuple[float, float, float, float]
    solid: Solid

    @property
    def closed(self) -> bool:
        """Whether only its outside can be seen, which holds of all shapes but meshes."""
        return not isinstance(self.shape, Mesh)


@dataclasses.dataclass(frozen=True)
class Scene:
    """Visible shapes of robots and fixed bodies; ``model`` answers where its bodies are."""

    model: CellModel
    pieces: tuple[Piece, ...]

    def bodies(self) -> tuple[str, ...]:
        """Names of the bodies that can be seen, in the order of their pieces."""
        return tuple(dict.fromkeys(piece.body for piece in self.pieces))

    def poses(self, q: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        """World poses {body: (B, 4, 4)} at joint angles {arm: (B, 6)}; arms not named stay at home.

        Bodies are those of :meth:`bodies`, and every arm's tool, whose frame is the flange.
        """
        rows = self.model.stack(q)
        checker = self.model.checker
        tools = (f"{arm}/tool" for arm in self.model.arms)
        shown = {name: self.model.body(name) for name in (*self.bodies(), *tools)}
        out = {name: np.empty((len(rows), 4, 4)) for name in shown}
        for i, row in enumerate(rows):
            context = checker.UpdatePositions(row)
            for name, body in shown.items():
                out[name][i] = body.EvalPoseInWorld(context).GetAsMatrix4()
        return out


def extract(model: CellModel) -> Scene:
    """The visible shapes of a cell's model but for those that setups change: tools, block, support."""
    inspector = model.diagram.scene_graph().model_inspector()
    names = {model.body(n).index(): n for n in _all_names(model)}
    pieces = []
    for geometry in inspector.GetAllGeometryIds(Role.kIllustration):
        body = model.plant.GetBodyFromFrameId(inspector.GetFrameId(geometry))
        shape = inspector.GetShape(geometry)
        properties = inspector.GetIllustrationProperties(geometry)
        rgba = properties.GetPropertyOrDefault("phong", "diffuse", Rgba(*_PLAIN_COLOUR))
        color = (rgba.r(), rgba.g(), rgba.b(), rgba.a())
        pose = inspector.GetPoseInFrame(geometry).GetAsMatrix4()
        name = names[body.index()]
        if name not in ("stock", "support") and not name.endswith(("/tool", "/edge")):
            pieces.append(Piece(name, shape, pose, color, _solid(shape)))
    return Scene(model, tuple(sorted(pieces, key=lambda p: p.body)))


def mounted(setup: Setup, place: FloatArray) -> tuple[Piece, ...]:
    """What a setup adds: bodies "<arm>/tool" and "<arm>/edge" in the flange's frame, "stock" and "support" in
    the stock's, which is at ``place`` (4, 4)."""
    out = []
    for arm in setup.cell.arms:
        out += [_piece(f"{arm.name}/tool", shape, TOOL_COLOUR) for shape in arm.tool.shapes]
        solid = working_solid(arm.tool)
        if solid is not None:
            out.append(_piece(f"{arm.name}/edge", _seen(solid), HOT_COLOUR))
    out.append(_piece("stock", block_box(setup), STOCK_COLOUR))
    if setup.stock.held_by is None:
        support = with_support(setup.cell, setup.stock, place).support
        out += [_piece("support", shape, SUPPORT_COLOUR) for shape in support]
    return tuple(out)


def _seen(edge: Shape) -> Shape:
    """A tool's edge as it is drawn: wires no thinner than :data:`LEAST_WIRE_RADIUS_M`, heads that are
    meshes as they are."""
    if edge.kind == "mesh":
        return edge
    radius, length = edge.size
    return dataclasses.replace(edge, size=(max(radius, LEAST_WIRE_RADIUS_M), length))


def stand(
    scene: Scene, setup: Setup, place: FloatArray, q: Mapping[str, FloatArray]
) -> dict[str, FloatArray]:
    """World poses {body: (B, 4, 4)} of a scene and of what :func:`mounted` adds to it."""
    out = scene.poses(q)
    count = len(next(iter(out.values())))
    for arm in scene.model.arms:
        out[f"{arm}/edge"] = out[f"{arm}/tool"]
    stock = block_pose(setup, place, scene.model.bases, q)
    out["stock"] = out["support"] = np.broadcast_to(stock, (count, 4, 4))
    return out


def _piece(body: str, shape: Shape, color: Any) -> Piece:
    drawn = drake_shape(shape, solid=False)
    r, g, b, a = (float(v) for v in color)
    return Piece(body, drawn, shape.pose, (r, g, b, a), _solid(drawn))


def _all_names(model: CellModel) -> list[str]:
    return [model.body_name(i) for i in range(1, model.plant.num_bodies()) if _known(model, i)]


def _known(model: CellModel, index: int) -> bool:
    try:
        model.body_name(index)
    except KeyError:
        return False
    return True


def _solid(shape: Any) -> Solid:
    if isinstance(shape, Box):
        return raster.box(*(float(v) for v in shape.size()))
    if isinstance(shape, Cylinder):
        return raster.cylinder(shape.radius(), shape.length())
    if isinstance(shape, Capsule):
        return raster.capsule(shape.radius(), shape.length())
    if isinstance(shape, Sphere):
        return raster.sphere(shape.radius())
    if isinstance(shape, Mesh | Convex):
        return _file(shape)
    raise TypeError(f"a visible shape of kind {type(shape).__name__} is not known to the report")


def _file(shape: Any) -> Solid:
    source = shape.source()
    if source.is_in_memory():
        memory = source.in_memory().mesh_file
        text = memory.contents()
        raw = text if isinstance(text, bytes) else text.encode()
        loaded = trimesh.load(
            trimesh.util.wrap_as_stream(raw), file_type=memory.extension()[1:], process=False
        )
    else:
        loaded = trimesh.load(source.path(), process=False)
    joined = loaded.to_mesh() if isinstance(loaded, trimesh.Scene) else loaded
    vertices = np.asarray(joined.vertices, dtype=np.float64) * shape.scale()
    return raster.mesh(vertices, np.asarray(joined.faces, dtype=np.int64))
