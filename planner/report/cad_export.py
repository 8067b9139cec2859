"""Export of a plan for CAD programs as GLB or 3DM: the cell at one instant, the part, and paths.

Both are in the world frame. GLB (glTF 2.0) is in metres with y up, as the format requires, and holds what a
picture shows. 3DM is in millimetres with z up. It has layers, paths as curves, and a point at each target
with its time and joint angles as user text. The part and what wires cut are placed in the block as it is at
that instant.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from planner.cell.plant import CellModel
from planner.geometry.arrays import FloatArray, Mesh, transform
from planner.geometry.mesh_files import obj_objects
from planner.geometry.units import DEG
from planner.issues import issue_error
from planner.plans import OperationPlan, Plan
from planner.problem import Problem, Setup
from planner.report import raster, scene
from planner.report.rhino_file import PATH_COLOUR, Rgb, RhinoMesh, RhinoPolyline, RhinoTarget

SUFFIXES: Final = (".glb", ".3dm")
"""Suffixes of the supported formats."""
NOMINAL_COLOUR: Final = (0.20, 0.55, 0.70)
"""Colour of the nominal part."""
CUT_COLOUR: Final = (0.90, 0.45, 0.15)
"""Colour of the part as simulated from the programs, and of wire paths."""
JOINT_MOVE_POINTS: Final = 25
"""Number of points at which the path of a joint move is drawn."""
MAX_TARGETS: Final = 2000
"""Maximum number of target points of an arm and an operation. Longer paths are decimated."""
MAX_WIRES: Final = 400
"""Maximum number of wire positions of an operation."""


@dataclasses.dataclass(frozen=True)
class CellState:
    """State of the cell at one instant.

    Attributes:
        operation: Operation in progress.
        setup: Setup of the operation.
        q: Joint values {arm: (6,)} [rad].
        block: Pose of the stock in the world (4, 4).
        bases: Bases in the world {arm: (4, 4)} of the arms on coordinated tracks.
    """

    operation: OperationPlan
    setup: Setup
    q: Mapping[str, FloatArray]
    block: FloatArray
    bases: Mapping[str, FloatArray] = dataclasses.field(default_factory=dict)


def cell_state(problem: Problem, plan: Plan, seconds: float) -> CellState:
    """Return the state of the cell at a time after the first target of the plan.

    Arms that do not take part in the operation are at home.

    Args:
        problem: Problem.
        plan: Plan.
        seconds: Time [s] on the clock of the plan, from 0 to its duration.

    Raises:
        TandemError: ``problem.field``, the plan has no operation, or the time is outside its duration.
    """
    if not plan.operations or not 0.0 <= seconds <= plan.duration:
        text = f"--time: out of range (got {seconds:g} s, allowed 0 to {plan.duration:.2f} s)"
        raise issue_error("problem.field", text, field="time", value=seconds, limit=plan.duration, unit="s")
    frame = plan.frame(seconds)
    index = next(i for i, operation in enumerate(plan.operations) if operation.name == frame.operation)
    setup = problem.setup_of(index)
    q = {arm.name: np.asarray(frame.q.get(arm.name, arm.home)) for arm in setup.cell.arms}
    q_rows = {name: value[None] for name, value in q.items()}
    stock_pose = np.asarray(plan.stock_poses[setup.number - 1])
    block = scene.block_pose(setup, stock_pose, plan.bases, q_rows)
    operation = plan.operations[index]
    # Time on the clock of the operation. The plan runs its operations one after the other without gaps.
    operation_time = (
        seconds
        - sum(float(previous.time[-1] - previous.time[0]) for previous in plan.operations[:index])
        + operation.time[0]
    )
    bases = {
        name: scene.track_base(
            setup.cell.arm(name), np.asarray(np.interp(operation_time, operation.time, values))
        )
        for name, values in operation.targets.track_positions.items()
    }
    return CellState(operation, setup, q, block if block.ndim == 2 else block[0], bases)


def shapes(
    model: CellModel, problem: Problem, plan: Plan, at: CellState, cut: Mapping[str, Mesh]
) -> Iterator[RhinoMesh]:
    """Yield robots, tools, fixed bodies, block and support, the nominal part and the simulated part.

    All are in the world at the instant of the state, each on a layer of its own.

    Args:
        model: Cell model.
        problem: Problem.
        plan: Plan.
        at: State of the cell.
        cut: Simulated part by name, in the stock frame.
    """
    visible = scene.extract_scene(model.with_bases({**scene.axis_bases(at.setup), **at.bases}))
    stock_pose = np.asarray(plan.stock_poses[at.setup.number - 1])
    q_rows = {name: value[None] for name, value in at.q.items()}
    poses = scene.scene_poses(visible, at.setup, stock_pose, q_rows)
    for piece in (*visible.pieces, *scene.setup_pieces(at.setup, stock_pose)):
        pose = poses[piece.body][0] @ piece.pose
        solid = piece.solid
        yield RhinoMesh(
            f"cell::{piece.body.replace('/', '::')}",
            transform(pose, solid.vertices),
            solid.faces,
            piece.color[:3],
        )
    for name, mesh in raster.part_meshes(problem.part):
        yield RhinoMesh(
            f"part::wanted::{name}", transform(at.block, mesh.vertices), mesh.faces, NOMINAL_COLOUR
        )
    for name, mesh in cut.items():
        yield RhinoMesh(
            f"part::simulated::{name}", transform(at.block, mesh.vertices), mesh.faces, CUT_COLOUR
        )


def lines(problem: Problem, plan: Plan, at: CellState) -> Iterator[RhinoPolyline]:
    """Yield the lines of a CAD file: TCP paths in the world, and positions of wires and linear cutters.

    Each TCP has a path for approach, work and retreat. Wires and cutter axes are drawn at about `MAX_WIRES`
    instants per sweep, with the block where it is in the state ``at``.

    Args:
        problem: Problem.
        plan: Plan.
        at: State of the cell.
    """
    keyframes = scene.sample_keyframes(problem, plan, MAX_WIRES)
    for index, operation in enumerate(plan.operations):
        setup = problem.setup_of(index)
        for name, q in operation.q.items():
            arm = setup.cell.arm(name)
            # layer, joint values, and the targets whose base applies to them
            parts: tuple[tuple[str, Any, slice | int], ...] = (
                ("in", [arm.home, *operation.approach.get(name, ()), q[0]], 0),
                ("work", q, slice(None)),
                ("out", [q[-1], *operation.retreat.get(name, ())], -1),
            )
            for layer, joints, target_indices in parts:
                joint_rows = np.asarray(joints) if layer == "work" else _interpolated(np.asarray(joints))
                bases = scene.bases_at_targets(setup, plan.bases, operation, target_indices)
                path = (scene.flange_poses(arm, bases, joint_rows) @ arm.tool.tcp)[:, :3, 3]
                yield RhinoPolyline(f"ways::{operation.name}::{name}::{layer}", path, PATH_COLOUR)
    for sweep in keyframes.sweeps:
        name = f"wire::setup {sweep.setup + 1}"
        for wire in sweep.points[:: max(1, len(sweep.points) // MAX_WIRES)]:
            yield RhinoPolyline(name, transform(at.block, wire), CUT_COLOUR)


def targets(problem: Problem, plan: Plan) -> Iterator[RhinoTarget]:
    """Yield TCPs of all operations with name, time in the operation [s], and serial joint angles [deg]."""
    for index, operation in enumerate(plan.operations):
        setup = problem.setup_of(index)
        for name, q in operation.q.items():
            arm = setup.cell.arm(name)
            bases = scene.bases_at_targets(setup, plan.bases, operation)
            tcp = (scene.flange_poses(arm, bases, q) @ arm.tool.tcp)[:, :3, 3]
            # -(-a // b) is a / b rounded up: every n-th target, so that at most MAX_TARGETS are drawn
            for k in range(0, len(q), -(-len(q) // MAX_TARGETS)):
                text = {
                    "target": operation.targets.name(k),
                    "time_s": f"{operation.time[k] - operation.time[0]:.5f}",
                }
                text |= {f"j{i}_deg": f"{value:.5f}" for i, value in enumerate(q[k] / DEG, 1)}
                yield RhinoTarget(f"targets::{operation.name}::{name}", tcp[k], text)


def _interpolated(waypoints: FloatArray) -> FloatArray:
    """Return joint values (N, J) on each move between waypoints (S, J), or a single waypoint itself."""
    fraction = np.linspace(0.0, 1.0, JOINT_MOVE_POINTS)[:, None]
    moves = [(1.0 - fraction) * a + fraction * b for a, b in itertools.pairwise(waypoints)]
    return np.concatenate(moves) if moves else waypoints


def read_simulated_part(path: Path) -> dict[str, Mesh]:
    """Read the objects of a simulated part (`simulated_part.obj`) by name, in the stock frame.

    Returns an empty mapping if there is no such file.
    """
    if not path.is_file():
        return {}
    return obj_objects(path.read_text("utf-8"))


def glb(shapes_to_write: Iterator[RhinoMesh]) -> bytes:
    """Return shapes (z up) as a binary glTF file (y up), with one node for each pair of layer and colour."""
    import trimesh

    y_up = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])  # glTF has y up
    meshes_by_layer: dict[tuple[str, Rgb], list[trimesh.Trimesh]] = {}
    for shape in shapes_to_write:
        mesh = trimesh.Trimesh(shape.vertices, shape.faces, process=False)
        meshes_by_layer.setdefault((shape.layer, shape.color), []).append(mesh)
    gltf_scene = trimesh.Scene()
    for number, ((layer, color), meshes) in enumerate(meshes_by_layer.items()):
        joined = trimesh.util.concatenate(meshes)
        material = trimesh.visual.material.PBRMaterial(
            baseColorFactor=[*color, 1.0], metallicFactor=0.0, doubleSided=True
        )
        joined.visual = trimesh.visual.TextureVisuals(material=material)
        name = f"{layer} {number}"  # unique: trimesh replaces a geometry of the same name
        gltf_scene.add_geometry(joined, node_name=name, geom_name=name)
    gltf_scene.apply_transform(y_up)
    return bytes(gltf_scene.export(file_type="glb"))
