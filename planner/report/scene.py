"""What a cell looks like, taken from its Drake model once: visible shapes, and where bodies are."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from pydrake.geometry import Box, Capsule, Convex, Cylinder, Mesh, Rgba, Role, Sphere

from planner.cell.plant import CellModel
from planner.report import solids
from planner.report.solids import Solid

FloatArray = NDArray[np.float64]
_PLAIN = (0.7, 0.72, 0.75, 1.0)


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
    """All visible shapes of a cell; ``model`` answers where its bodies are."""

    model: CellModel
    pieces: tuple[Piece, ...]

    def bodies(self) -> tuple[str, ...]:
        """Names of the bodies that can be seen, in the order of their pieces."""
        return tuple(dict.fromkeys(piece.body for piece in self.pieces))

    def poses(self, q: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        """World poses {body: (B, 4, 4)} at joint angles {arm: (B, 6)}; arms not named stay at home."""
        rows = self.model.stack(q)
        checker = self.model.checker
        shown = {name: self.model.body(name) for name in self.bodies()}
        out = {name: np.empty((len(rows), 4, 4)) for name in shown}
        for i, row in enumerate(rows):
            context = checker.UpdatePositions(row)
            for name, body in shown.items():
                out[name][i] = body.EvalPoseInWorld(context).GetAsMatrix4()
        return out


def extract(model: CellModel) -> Scene:
    """The visible shapes of a cell's model."""
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
        pieces.append(Piece(names[body.index()], shape, pose, color, _solid(shape)))
    return Scene(model, tuple(sorted(pieces, key=lambda p: p.body)))


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
