"""Parts in closed form as meshes, and the path of a ball over a cone."""

from __future__ import annotations

from typing import Any

import numpy as np
import shapely

from planner.catalogue.materials import sheet_metal
from planner.geometry.arrays import Mesh
from planner.processes.forming.plan.contact import ContactPath, FormingPass
from planner.processes.forming.plan.features.pass_shape import merge_meshes, polygons, triangulate
from planner.processes.forming.plan.features.tree import (
    FeatureTree,
    OrderStep,
    build_feature_tree,
    in_place_order,
)
from planner.processes.forming.plan.operation import Forming
from planner.processes.forming.plan.passes import make_passes
from planner.tooling import FormingHead

T0 = 1e-3
BALL = FormingHead("ball", 0.009525, 0.009525, 0.0, 0.1)


def operation(mode: str = "dsif", **more: Any) -> Forming:
    arms = ("A",) if mode in ("spif", "tpif") else ("A", "B")
    return Forming.model_validate(
        {"name": "form", "process": "forming", "arms": arms, "mode": mode, "stepdown_mm": 1.0, **more}
    )


def revolved(profile: list[tuple[float, float]], count: int = 120) -> Mesh:
    """A surface of revolution from (radius, z) [m], the outermost first, the last one on the axis."""
    turn = np.arange(count) * 2.0 * np.pi / count
    rings = [
        np.column_stack([r * np.cos(turn), r * np.sin(turn), np.full(count, z)]) for r, z in profile[:-1]
    ]
    vertices = np.concatenate([*rings, [[0.0, 0.0, profile[-1][1]]]])
    i, j = np.arange(count), np.roll(np.arange(count), -1)
    faces = []
    for k in range(len(rings) - 1):
        a, b = k * count, (k + 1) * count
        faces += [np.column_stack([a + i, a + j, b + i]), np.column_stack([a + j, b + j, b + i])]
    faces.append(np.column_stack([b + i, b + j, np.full(count, len(vertices) - 1)]))
    return Mesh(vertices, np.concatenate(faces).astype(np.int64))


def cone(angle: float, depth: float, radius: float, count: int = 120) -> Mesh:
    """A cone that goes down by ``depth`` with a flat floor."""
    floor = radius - depth / np.tan(np.radians(angle))
    return revolved([(radius + 0.02, 0.0), (radius, 0.0), (floor, -depth), (0.0, -depth)], count)


def bowl(ball: float, steepest: float, count: int = 120) -> Mesh:
    """A cap of a sphere of radius ``ball`` that goes down, as steep as ``steepest`` [deg] at its edge."""
    turn = np.radians(np.linspace(steepest, 0.0, 61))
    edge = float(np.cos(turn[0]) * ball)
    cap = [(float(ball * np.sin(a)), float(edge - ball * np.cos(a))) for a in turn]
    return revolved([(cap[0][0] + 0.02, 0.0), *cap], count)


def upside_down(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices * np.array([1.0, 1.0, -1.0]), mesh.faces)


def pit(outline: shapely.Polygon, angle: float, depth: float) -> Mesh:
    """Walls of one angle down from any outline, with sharp edges."""
    floor = outline.buffer(-depth / np.tan(np.radians(angle)), join_style="mitre", mitre_limit=20.0)
    areas = [*polygons(outline.difference(floor)), floor, *polygons(outline.buffer(0.02).difference(outline))]
    points, faces = triangulate(areas)
    low = set(map(tuple, shapely.get_coordinates(floor).tolist()))
    z = np.array([-depth if tuple(point) in low else 0.0 for point in points.tolist()])
    none = Mesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64))
    return merge_meshes(Mesh(np.column_stack([points, z]), faces), none)


def star(outer: float, inner: float, points: int = 5) -> shapely.Polygon:
    turn = np.arange(2 * points) * np.pi / points
    radius = np.where(np.arange(2 * points) % 2 == 0, outer, inner)
    return shapely.Polygon(np.column_stack([radius * np.cos(turn), radius * np.sin(turn)]))


def horseshoe(radius: float, width: float) -> shapely.Polygon:
    """An outline that no point sees all of."""
    turn = np.radians(np.linspace(30.0, 330.0, 80))
    line = shapely.LineString(radius * np.column_stack([np.cos(turn), np.sin(turn)]))
    return line.buffer(0.5 * width, quad_segs=16)


def tree_of(mesh: Mesh) -> tuple[FeatureTree, tuple[OrderStep, ...]]:
    tree = build_feature_tree(mesh, 1e-3)
    return tree, in_place_order(tree)


def cone_path(
    forming_pass: FormingPass,
    angle: float,
    radius: float,
    ball: float,
    per_loop: int = 150,
    step: float = 2e-3,
) -> ContactPath:
    """Level circles of a ball down the wall of a cone whose near face begins at ``radius``."""
    a, side = np.radians(angle), forming_pass.side
    lowest = abs(forming_pass.end - forming_pass.start) - ball * (
        1.0 - np.cos(a)
    )  # the floor stops the ball there
    depth = np.arange(step, lowest, step)
    turn = np.linspace(0.0, 2.0 * np.pi, per_loop + 1)
    d, phi = (grid.reshape(-1) for grid in np.meshgrid(depth, turn, indexing="ij"))
    r = radius - d / np.tan(a)
    point = np.column_stack([r * np.cos(phi), r * np.sin(phi), forming_pass.start - side * d])
    inward = np.column_stack([-np.cos(phi), -np.sin(phi), np.zeros(len(phi))])
    toward = np.sin(a) * inward + np.cos(a) * np.array([0.0, 0.0, side])
    loop = np.repeat(np.arange(len(depth)), len(turn))
    working = np.arange(len(phi)) > 0
    return ContactPath(point, side * toward, point + ball * toward, np.full(len(phi), a), loop, working)


METAL = sheet_metal("aluminium")


def plan_passes(mesh: Mesh, mode: str = "dsif", **more: object) -> tuple[FormingPass, ...]:
    tree, order = tree_of(mesh)
    return make_passes(tree, order, mesh, T0, operation(mode, **more), METAL)
