"""Solids of a cell's bodies: their representation in Drake, their poses, and distances of points from them.

A body is a link, a tool, the stock, its support or an obstacle. Its solids are its collision shapes.

Poses and signed distances to convex solids, exact inside and outside, are computed in NumPy, batched. Which
pairs of bodies are not checked for clearance, and why, is decided once when a cell is built, and shown in the
report.
"""

import dataclasses
import functools
import itertools
from collections.abc import Iterable, Mapping
from typing import Any, Final

import numpy as np
from pydrake.common import MemoryFile
from pydrake.geometry import Box, Capsule, Convex, Cylinder, InMemoryMesh, Mesh, SceneGraphInspector, Sphere
from pydrake.geometry import Shape as DrakeShape
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex
from pydrake.planning import SceneGraphCollisionChecker
from scipy.spatial import ConvexHull

from planner.catalogue.robots import RobotData
from planner.cell.kinematics import link_frames
from planner.geometry.arrays import FloatArray, Shape, from_parts, inverse
from planner.problem import Cell, Stock
from planner.tooling import working_solid


def drake_shape(shape: Shape, solid: bool) -> DrakeShape:
    """Return Drake's shape of a shape.

    Args:
        shape: The shape.
        solid: Whether a mesh becomes its convex hull (for collision) instead of the mesh itself (for
            display).

    Raises:
        ValueError: For a mesh without vertices.
    """
    if shape.kind == "box":
        return Box(*shape.size)
    if shape.kind == "cylinder":
        return Cylinder(*shape.size)
    if shape.kind == "capsule":
        return Capsule(*shape.size)
    if shape.kind == "sphere":
        return Sphere(*shape.size)
    if shape.vertices is None or shape.faces is None:
        raise ValueError("a mesh shape needs vertices and faces")
    text = _obj(shape.vertices, shape.faces)
    memory = InMemoryMesh(mesh_file=MemoryFile(text, ".obj", "mesh.obj"))
    return Convex(memory) if solid else Mesh(memory)


def _obj(vertices: np.ndarray, faces: np.ndarray) -> str:
    """Return a triangle mesh as the text of a Wavefront OBJ file, whose indices count from 1."""
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces.tolist()]
    return "\n".join(lines) + "\n"


@dataclasses.dataclass(frozen=True)
class MinClearance:
    """Smallest distances of B configurations.

    Attributes:
        distance: Distances (B,) [m], negative for overlap. If nothing is within the requested reach, it is
            that reach.
        pair: Bodies of each distance (B,), ("", "") if nothing is within reach.
    """

    distance: FloatArray
    pair: tuple[tuple[str, str], ...]

    def worst(self) -> int:
        """Return the index of the configuration with the smallest distance."""
        return int(np.argmin(self.distance))


@dataclasses.dataclass(frozen=True)
class ClearanceEasing:
    """Pairs of bodies that may be closer to each other than all others.

    Attributes:
        pairs: Pairs of body names.
        by: Distance [m] that is added to the distance of these pairs, at least 0.
    """

    pairs: frozenset[frozenset[str]] = frozenset()
    by: float = 0.0

    def added_distance(self, body: str, other: str) -> float:
        """Return the distance [m] that is added to that of two bodies."""
        return self.by if frozenset((body, other)) in self.pairs else 0.0


NO_EASING: Final = ClearanceEasing()
"""No pair counts as farther apart than it is."""


@dataclasses.dataclass(frozen=True, eq=False)
class Solid:
    """A collision object: a solid of a body. A mesh represents its convex hull.

    Attributes:
        body: Name of the body.
        shape: Shape, with its pose in the body's frame.
    """

    body: str
    shape: Shape

    @functools.cached_property
    def hull(self) -> tuple[FloatArray, FloatArray]:
        """Half spaces (F, 4), normal and offset, and triangles (F, 3, 3) of the convex hull of a mesh.

        They are in the shape's frame.

        Raises:
            ValueError: The shape is not a mesh.
        """
        if self.shape.vertices is None:
            raise ValueError(f"a {self.shape.kind} has no hull")
        hull = ConvexHull(self.shape.vertices)
        return hull.equations, hull.points[hull.simplices]


def bounding_size(solid: Solid) -> FloatArray:
    """Return the edge lengths (3,) [m] of a box that contains the solid.

    The box is centred at the origin of the shape's frame.
    """
    shape = solid.shape
    if shape.vertices is not None:
        return np.asarray(2.0 * np.abs(shape.vertices).max(axis=0))
    if shape.kind == "box":
        return np.asarray(shape.size)
    long = shape.size[1] if len(shape.size) > 1 else 0.0
    caps = 0.0 if shape.kind == "cylinder" else 2.0 * shape.size[0]
    return np.array([2.0 * shape.size[0], 2.0 * shape.size[0], long + caps])


def bounding_corners(solid: Solid) -> FloatArray:
    """Return the corners (8, 3) [m] of the box of :func:`bounding_size`."""
    signs = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
    return np.asarray(0.5 * bounding_size(solid) * signs)


def hull_points(solid: Solid) -> FloatArray:
    """Return points (P, 3) [m] in the shape's frame whose convex hull contains the solid.

    The hull is larger than the solid only by the caps of round ends and 0.5 % of a cylinder's radius.
    """
    if solid.shape.vertices is not None:
        return solid.shape.vertices
    if solid.shape.kind != "cylinder":
        return bounding_corners(solid)
    angle = np.linspace(0.0, 2.0 * np.pi, RIM_POINTS, endpoint=False)
    radius, half = solid.shape.size[0] / np.cos(np.pi / RIM_POINTS), 0.5 * solid.shape.size[1]
    rim = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    return np.concatenate([np.column_stack([rim, np.full(RIM_POINTS, z)]) for z in (-half, half)])


def signed_distance(solid: Solid, points: FloatArray) -> FloatArray:
    """Return the distances (...,) [m] of points (..., 3) from the surface of a solid, negative inside.

    The points are in the frame of the solid's shape.
    """
    kind, size = solid.shape.kind, solid.shape.size
    if kind == "sphere":
        return np.asarray(np.linalg.norm(points, axis=-1) - size[0])
    if kind == "capsule":
        rest = np.maximum(np.abs(points[..., 2]) - 0.5 * size[1], 0.0)
        return np.asarray(np.sqrt(points[..., 0] ** 2 + points[..., 1] ** 2 + rest**2) - size[0])
    if kind == "cylinder":
        side = np.hypot(points[..., 0], points[..., 1]) - size[0]
        cap = np.abs(points[..., 2]) - 0.5 * size[1]
        outside = np.hypot(np.maximum(side, 0.0), np.maximum(cap, 0.0))
        return np.asarray(outside + np.minimum(np.maximum(side, cap), 0.0))
    if kind == "box":
        over = np.abs(points) - 0.5 * np.asarray(size)
        outside = np.linalg.norm(np.maximum(over, 0.0), axis=-1)
        return np.asarray(outside + np.minimum(over.max(axis=-1), 0.0))
    return _hull_distance(solid, points)


def _hull_distance(solid: Solid, points: FloatArray) -> FloatArray:
    """Return signed distances (...,) [m] of points (..., 3) to the convex hull of a mesh, negative inside."""
    planes, triangles = solid.hull
    flat = points.reshape(-1, 3)
    out = (flat @ planes[:, :3].T + planes[:, 3]).max(axis=1)
    outside = np.flatnonzero(out > 0.0)
    # points outside, in parts of about 200 000 pairs of point and triangle to limit memory
    for part in np.array_split(outside, max(1, len(outside) * len(triangles) // 200_000)):
        out[part] = _triangle_distance(flat[part, None], triangles[None]).min(axis=1)
    return np.asarray(out.reshape(points.shape[:-1]))


def _triangle_distance(p: FloatArray, triangle: FloatArray) -> FloatArray:
    """Return distances (...,) of points (..., 3) to triangles (..., 3, 3).

    If the projection of a point is inside the triangle, the distance is that from the plane. Otherwise it is
    that from the nearest edge.
    """
    a, b, c = triangle[..., 0, :], triangle[..., 1, :], triangle[..., 2, :]
    normal = np.cross(b - a, c - a)
    normal = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    height = np.sum((p - a) * normal, axis=-1)
    inside = np.ones(height.shape, dtype=bool)
    edges = np.full(height.shape, np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        edge, ray = end - start, p - start
        inside &= np.sum(np.cross(edge, ray) * normal, axis=-1) >= 0.0
        t = np.clip(np.sum(ray * edge, axis=-1) / np.sum(edge * edge, axis=-1), 0.0, 1.0)
        edges = np.minimum(edges, np.linalg.norm(ray - t[..., None] * edge, axis=-1))
    return np.asarray(np.where(inside, np.abs(height), edges))


def shapes_by_body(cell: Cell, stock: Stock) -> dict[str, tuple[Shape, ...]]:
    """Return the collision shapes by body, each with its pose in the frame of the body.

    Links of catalogue robots are left out, because Drake reads their shapes from URDF files.
    """
    out = {f"{arm.name}/tool": arm.tool.shapes for arm in cell.arms}
    for arm in cell.arms:
        if arm.custom_data is not None and arm.custom_data.file is not None:
            link_shapes = zip(link_chain(arm.data.axes), arm.custom_data.file.shapes, strict=False)
            out.update({f"{arm.name}/{link}": shapes for link, shapes in link_shapes})
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


def collect_solids(
    plant: MultibodyPlant,
    inspector: SceneGraphInspector,
    names: Mapping[int, str],
    given_shapes: Mapping[str, tuple[Shape, ...]],
) -> tuple[Solid, ...]:
    """Return all collision solids of a cell.

    Solids of catalogue links are as Drake read them from the URDF files, the others as in ``given_shapes``.

    Args:
        plant: Drake's plant.
        inspector: Drake's inspector of its scene graph.
        names: Names of bodies by index.
        given_shapes: Shapes by body that are not from URDF files, as by :func:`shapes_by_body`.
    """
    out = []
    for index, name in names.items():
        if name in given_shapes:
            out += [Solid(name, shape) for shape in given_shapes[name]]
            continue
        for geometry in plant.GetCollisionGeometriesForBody(plant.get_body(BodyIndex(index))):
            pose = inspector.GetPoseInFrame(geometry).GetAsMatrix4()
            out.append(Solid(name, _to_shape(inspector.GetShape(geometry), pose)))
    return tuple(out)


def _to_shape(shape: object, pose: FloatArray) -> Shape:
    """Convert a shape of Drake, with its pose (4, 4) in the body.

    Raises:
        TypeError: The shape is not a box, capsule or cylinder.
    """
    if isinstance(shape, Box):
        return Shape("box", tuple(float(v) for v in shape.size()), pose)
    if isinstance(shape, Capsule):
        return Shape("capsule", (shape.radius(), shape.length()), pose)
    if isinstance(shape, Cylinder):
        return Shape("cylinder", (shape.radius(), shape.length()), pose)
    raise TypeError(
        f"collision solid of a robot: got {type(shape).__name__}, allowed box, capsule and cylinder"
    )


def body_poses(arm: str, robot: RobotData, base: FloatArray, q: FloatArray) -> dict[str, FloatArray]:
    """Return world poses (B, 4, 4) of the links and the tool of one arm.

    The frame of a link is that of the URDF: one of the catalogue is parallel to the base at the controller's
    zero pose. That of the tool is the flange.

    Args:
        arm: Name of the arm.
        robot: Robot data.
        base: Pose of the base (4, 4), or (B, 4, 4) if it differs from row to row.
        q: Serial angles (B, J) [rad].

    Returns:
        Poses by body. That of the base is (1, 4, 4), or (B, 4, 4) if it differs from row to row.
    """
    count = robot.axes
    # The last row is the zero pose. From it follows the constant pose of each URDF frame in its link frame.
    links = link_frames(robot, np.concatenate([q, np.zeros((1, count))]))
    urdf_in_link = np.zeros((count + 1, 4, 4))
    urdf_in_link[:, 3, 3] = 1.0
    urdf_in_link[:count, :3, :3] = np.swapaxes(links[-1, :count, :3, :3], -1, -2)
    urdf_in_link[count] = np.eye(4)
    if robot.file is not None:
        urdf_in_link[:count] = inverse(links[-1, :count]) @ robot.file.zero[1:-1]
    bases = base.reshape(-1, 4, 4)
    frames = bases[:, None] @ links[:-1] @ urdf_in_link
    out = {f"{arm}/link_{i + 1}": frames[:, i] for i in range(count)}
    out[f"{arm}/tool"] = frames[:, count]
    out[f"{arm}/base_link"] = bases
    return out


FilteredPair = tuple[str, str, str]
"""Two bodies that are not checked against each other, and the reason."""


@functools.cache
def link_chain(axes: int) -> tuple[str, ...]:
    """Return the bodies of an arm with a number of axes from its base to its tool."""
    return ("base_link", *(f"link_{i}" for i in range(1, axes + 1)), "tool")


EDGE_FILTERED: Final = (
    "the edge belongs to the tool",
    "the edge is fixed to the flange",
    "kept apart by the robot's own build",
)
"""Reasons why an arm's own edge is not checked against the last bodies of the arm, the tool first."""
HELD_FILTERED: Final = (
    "the block is held by the tool",
    "the block is fixed to the flange",
    "of one arm and always near each other",
)
"""Reasons why a block that an arm holds is not checked against the last bodies of the arm, the tool first."""

RIM_POINTS: Final = 32
"""Number of corners of the polygon that represents the rim of a cylinder."""


def filter_pairs(
    checker: SceneGraphCollisionChecker, names: Mapping[int, str], holder: str | None = None
) -> tuple[FilteredPair, ...]:
    """Exclude pairs of bodies from Drake's collision checks, and return them with reasons, sorted.

    These are links that are neighbours or two joints apart, because their solids, fatter than the real links,
    would touch, and the pairs of :data:`EDGE_FILTERED` and :data:`HELD_FILTERED`. Pairs of fixed bodies are
    returned too, but the checker itself never checks them.

    Args:
        checker: Drake's collision checker.
        names: Names of bodies by index.
        holder: Arm that holds the stock, if any.
    """
    with_solids = sorted(index for index in names if _has_solids(checker, index))
    chains = link_chains(names.values())
    out: list[FilteredPair] = []
    for a, b in itertools.combinations(with_solids, 2):
        reason = _structural_reason(names[a], names[b], holder, chains)
        if reason:
            out.append((names[a], names[b], reason))
            if "fixed to the world" not in reason:
                checker.SetCollisionFilteredBetween(BodyIndex(a), BodyIndex(b), True)
    return tuple(sorted(out))


def link_chains(names: Iterable[str]) -> dict[str, tuple[str, ...]]:
    """Return the bodies of each arm from its base to its tool, from the names of all bodies of a cell."""
    out: dict[str, int] = {}
    for name in names:
        arm, _, link = name.partition("/")
        if link.startswith("link_"):
            out[arm] = max(out.get(arm, 0), int(link.removeprefix("link_")))
    return {arm: link_chain(axes) for arm, axes in out.items()}


def _has_solids(checker: Any, index: int) -> bool:
    """Whether a body has any collision geometry."""
    return bool(checker.plant().GetCollisionGeometriesForBody(checker.plant().get_body(BodyIndex(index))))


def is_fixed(name: str, holder: str | None) -> bool:
    """Return whether a body is fixed in the world. ``holder`` is the arm that holds the stock, if any."""
    if name == "stock" and holder is not None:
        return False
    return "/" not in name or name.endswith("/base_link")


def _structural_reason(
    a: str, b: str, holder: str | None, chains: Mapping[str, tuple[str, ...]]
) -> str | None:
    """Return why two bodies are not checked against each other, or None if they are.

    Args:
        a: Name of the first body.
        b: Name of the second body.
        holder: Arm that holds the stock, if any.
        chains: Bodies of each arm from its base to its tool.
    """
    if is_fixed(a, holder) and is_fixed(b, holder):
        return "both fixed to the world"
    (arm_a, _, link_a), (arm_b, _, link_b) = a.partition("/"), b.partition("/")
    if holder is not None and "stock" in (a, b):
        arm, link = (arm_a, link_a) if b == "stock" else (arm_b, link_b)
        return _reason_from_tool(HELD_FILTERED, chains[arm], link) if arm == holder else None
    if not link_a or not link_b or arm_a != arm_b:
        return None
    if "edge" in (link_a, link_b):
        return _reason_from_tool(EDGE_FILTERED, chains[arm_a], link_a if link_b == "edge" else link_b)
    gap = abs(chains[arm_a].index(link_a) - chains[arm_a].index(link_b))
    if gap == 2:
        return "kept apart by the robot's own build"
    return "neighbours in the chain" if gap == 1 else None


def _reason_from_tool(reasons: tuple[str, ...], chain: tuple[str, ...], link: str) -> str | None:
    """Return the reason for a link; reasons apply to the last links of a chain, the tool first."""
    return dict(zip(reversed(chain), reasons, strict=False)).get(link)
