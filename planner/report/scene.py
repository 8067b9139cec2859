"""What a cell looks like: robots and fixed bodies from its Drake model, once, and what each setup adds."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import trimesh
from numpy.typing import NDArray
from pydrake.geometry import Box, Capsule, Convex, Cylinder, Mesh, Rgba, Role, Sphere

from planner.cell.plant import STOCK_COLOUR, SUPPORT_COLOUR, TOOL_COLOUR, CellModel
from planner.cell.solids import drake_shape
from planner.cell.standing import with_support
from planner.geometry.shapes import Shape
from planner.problem import Setup
from planner.report import solids, standing
from planner.report.solids import Solid
from planner.tooling import working_solid

FloatArray = NDArray[np.float64]
_PLAIN = (0.7, 0.72, 0.75, 1.0)
HOT: Final = (1.0, 0.30, 0.05, 1.0)
SEEN: Final = 2.2e-3
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
        rgba = properties.GetPropertyOrDefault("phong", "diffuse", Rgba(*_PLAIN))
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
            out.append(_piece(f"{arm.name}/edge", _seen(solid), HOT))
    out.append(_piece("stock", standing.box(setup), STOCK_COLOUR))
    if setup.stock.held_by is None:
        support = with_support(setup.cell, setup.stock, place).support
        out += [_piece("support", shape, SUPPORT_COLOUR) for shape in support]
    return tuple(out)


def _seen(edge: Shape) -> Shape:
    """A tool's edge as it is drawn: wires no thinner than :data:`SEEN`, heads that are meshes as they are."""
    if edge.kind == "mesh":
        return edge
    radius, length = edge.size
    return dataclasses.replace(edge, size=(max(radius, SEEN), length))


def stand(
    scene: Scene, setup: Setup, place: FloatArray, q: Mapping[str, FloatArray]
) -> dict[str, FloatArray]:
    """World poses {body: (B, 4, 4)} of a scene and of what :func:`mounted` adds to it."""
    out = scene.poses(q)
    count = len(next(iter(out.values())))
    for arm in scene.model.arms:
        out[f"{arm}/edge"] = out[f"{arm}/tool"]
    stock = standing.block(setup, place, scene.model.bases, q)
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
        return solids.box(*(float(v) for v in shape.size()))
    if isinstance(shape, Cylinder):
        return solids.cylinder(shape.radius(), shape.length())
    if isinstance(shape, Capsule):
        return solids.capsule(shape.radius(), shape.length())
    if isinstance(shape, Sphere):
        return solids.sphere(shape.radius())
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
    return solids.mesh(vertices, np.asarray(joined.faces, dtype=np.int64))
