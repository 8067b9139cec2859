"""A plan for CAD programs: the cell at a moment, the part, the ways of tools and wires, as GLB or as 3DM.

Both are in the world. GLB (glTF 2.0) is in metres with y up, as that format has it; it holds what a
picture shows. 3DM is in millimetres with z up; it has layers, ways as curves, and a point at each
target with its time and joint angles as user text. The part and what wires cut lie in the block where
it is at that moment.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from planner.cell.plant import CellModel
from planner.geometry.arrays import FloatArray, Mesh, transform
from planner.geometry.mesh_files import objects
from planner.geometry.units import DEG
from planner.issues import refusal
from planner.plans import OperationPlan, Plan
from planner.problem import Problem, Setup
from planner.report import raster, scene
from planner.report.rhino_file import WAY_COLOUR, Line, Rgb, Shape, Target

KINDS: Final = (".glb", ".3dm")
"""Endings of the files that can be written."""
WANTED_COLOUR: Final = (0.20, 0.55, 0.70)
"""Colour of the wanted part."""
CUT_COLOUR: Final = (0.90, 0.45, 0.15)
"""Colour of the part as simulated from the programs, and of what wires do."""
WAY_PLACES: Final = 25
"""Places of a joint move through which its way is drawn."""
MOST_TARGETS: Final = 2000
"""Targets of an arm and an operation that are points, at most; of more every second, third ... is."""
MOST_WIRES: Final = 400
"""Wire positions of an operation at most."""


@dataclasses.dataclass(frozen=True)
class Moment:
    """Where everything is: the operation and its setup, joints {arm: (6,)} [rad], the block's pose (4, 4),
    and ``bases`` {arm: (4, 4)} of arms whose tracks go along."""

    operation: OperationPlan
    setup: Setup
    q: Mapping[str, FloatArray]
    block: FloatArray
    bases: Mapping[str, FloatArray] = dataclasses.field(default_factory=dict)


def moment(problem: Problem, plan: Plan, seconds: float) -> Moment:
    """The moment ``seconds`` after the plan's first target. Raises ``TandemError`` (``problem.field``) where
    the plan has none."""
    if not plan.operations or not 0.0 <= seconds <= plan.duration:
        what = f"--time: got {seconds:g} s, the plan goes from 0 to {plan.duration:.2f} s"
        raise refusal("problem.field", what, field="time", value=seconds, limit=plan.duration, unit="s")
    frame = plan.frame(seconds)
    index = next(i for i, own in enumerate(plan.operations) if own.name == frame.operation)
    setup = problem.setup_of(index)
    q = {arm.name: np.asarray(frame.q.get(arm.name, arm.home)) for arm in setup.cell.arms}
    rows = {name: value[None] for name, value in q.items()}
    place = np.asarray(plan.places[setup.number - 1])
    block = scene.block_pose(setup, place, plan.bases, rows)
    own = plan.operations[index]
    here = seconds - sum(float(one.time[-1] - one.time[0]) for one in plan.operations[:index]) + own.time[0]
    bases = {
        name: scene.ridden_base(setup.cell.arm(name), np.asarray(np.interp(here, own.time, values)))
        for name, values in own.targets.ride.items()
    }
    return Moment(own, setup, q, block if block.ndim == 2 else block[0], bases)


def shapes(
    model: CellModel, problem: Problem, plan: Plan, at: Moment, cut: Mapping[str, Mesh]
) -> Iterator[Shape]:
    """Robots, tools, fixed bodies, block, support; the wanted part, and the ``cut`` one, by name in the stock
    frame."""
    drawn = scene.extract(model.with_bases({**scene.standing(at.setup), **at.bases}))
    place = np.asarray(plan.places[at.setup.number - 1])
    rows = {name: value[None] for name, value in at.q.items()}
    poses = scene.stand(drawn, at.setup, place, rows)
    for piece in (*drawn.pieces, *scene.mounted(at.setup, place)):
        pose = poses[piece.body][0] @ piece.pose
        solid = piece.solid
        yield Shape(
            f"cell::{piece.body.replace('/', '::')}",
            transform(pose, solid.vertices),
            solid.faces,
            piece.color[:3],
        )
    for name, mesh in raster.part_meshes(problem.part):
        yield Shape(f"part::wanted::{name}", transform(at.block, mesh.vertices), mesh.faces, WANTED_COLOUR)
    for name, mesh in cut.items():
        yield Shape(f"part::simulated::{name}", transform(at.block, mesh.vertices), mesh.faces, CUT_COLOUR)


def lines(problem: Problem, plan: Plan, at: Moment) -> Iterator[Line]:
    """The way of each TCP in each operation, in and out too, and positions of what cuts along a line."""
    track = scene.track(problem, plan, MOST_WIRES)
    for index, own in enumerate(plan.operations):
        setup = problem.setup_of(index)
        for name, q in own.q.items():
            arm = setup.cell.arm(name)
            every: tuple[tuple[str, Any, slice | int], ...] = (
                ("in", [arm.home, *own.entry.get(name, ()), q[0]], 0),
                ("work", q, slice(None)),
                ("out", [q[-1], *own.exit.get(name, ())], -1),
            )
            for word, joints, at_rows in every:
                rows = np.asarray(joints) if word == "work" else _between(np.asarray(joints))
                bases = scene.riding(setup, plan.bases, own, at_rows)
                way = (scene.flange_poses(arm, bases, rows) @ arm.tool.tcp)[:, :3, 3]
                yield Line(f"ways::{own.name}::{name}::{word}", way, WAY_COLOUR)
    for sweep in track.sweeps:
        name = f"wire::setup {sweep.setup + 1}"
        for wire in sweep.points[:: max(1, len(sweep.points) // MOST_WIRES)]:
            yield Line(name, transform(at.block, wire), CUT_COLOUR)


def targets(problem: Problem, plan: Plan) -> Iterator[Target]:
    """TCPs of all operations with name, time from the operation's first target [s] and joints [deg]."""
    for index, own in enumerate(plan.operations):
        setup = problem.setup_of(index)
        for name, q in own.q.items():
            arm = setup.cell.arm(name)
            bases = scene.riding(setup, plan.bases, own)
            tcp = (scene.flange_poses(arm, bases, q) @ arm.tool.tcp)[:, :3, 3]
            for k in range(0, len(q), -(-len(q) // MOST_TARGETS)):
                text = {"target": own.targets.name(k), "time_s": f"{own.time[k] - own.time[0]:.5f}"}
                text |= {f"j{i}_deg": f"{value:.5f}" for i, value in enumerate(q[k] / DEG, 1)}
                yield Target(f"targets::{own.name}::{name}", tcp[k], text)


def _between(joints: FloatArray) -> FloatArray:
    """Joints (N, J) along straight joint moves through stations (S, J)."""
    share = np.linspace(0.0, 1.0, WAY_PLACES)[:, None]
    moves = [(1.0 - share) * a + share * b for a, b in itertools.pairwise(joints)]
    return np.concatenate(moves) if moves else joints


def simulated(path: Path) -> dict[str, Mesh]:
    """The objects of a simulated part (`simulated_part.obj`) by name, in the stock frame; none where there is
    no file."""
    if not path.is_file():
        return {}
    return objects(path.read_text("utf-8"))


def glb(found: Iterator[Shape]) -> bytes:
    """Shapes as a binary glTF file, a node for each layer and colour."""
    import trimesh

    turned = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])  # its y is up
    by_layer: dict[tuple[str, Rgb], list[trimesh.Trimesh]] = {}
    for shape in found:
        mesh = trimesh.Trimesh(shape.vertices, shape.faces, process=False)
        by_layer.setdefault((shape.layer, shape.color), []).append(mesh)
    out = trimesh.Scene()
    for number, ((layer, color), meshes) in enumerate(by_layer.items()):
        joined = trimesh.util.concatenate(meshes)
        paint = trimesh.visual.material.PBRMaterial(
            baseColorFactor=[*color, 1.0], metallicFactor=0.0, doubleSided=True
        )
        joined.visual = trimesh.visual.TextureVisuals(material=paint)
        name = f"{layer} {number}"  # one of the same name would take its place
        out.add_geometry(joined, node_name=name, geom_name=name)
    out.apply_transform(turned)
    return bytes(out.export(file_type="glb"))
