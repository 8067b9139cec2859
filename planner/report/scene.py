"""Visible shapes of a cell and its motion: bodies, what setups add, and the whole job on one clock.

Shapes come from the Drake model of the cell: robots and fixed bodies once, then what each setup adds. Poses
of the block and of a straight wire follow from joint angles, in the setup of an operation. The clock of the
replay (`sample_keyframes`) runs from home through all setups and operations and back.
"""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
import trimesh
from pydrake.geometry import Box, Capsule, Convex, Cylinder, Mesh, Rgba, Role, Sphere

from planner.catalogue.robots import RobotData, VisualShape
from planner.cell import external_axis_motion
from planner.cell.bodies import drake_shape, link_chain
from planner.cell.external_axis_motion import AxisTravel
from planner.cell.kinematics import forward_kinematics
from planner.cell.plant import ROBOT_COLOUR, STOCK_COLOUR, SUPPORT_COLOUR, TOOL_COLOUR, CellModel
from planner.cell.support import with_support
from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray, IntArray, Shape, axis_ends, inverse, transform
from planner.plans import OperationPlan, Plan
from planner.problem import Arm, Problem, Setup
from planner.report import raster
from planner.report.raster import RenderSolid
from planner.tooling import Bow, Mill, working_solid


def flange_poses(arm: Arm, bases: Mapping[str, FloatArray], q: FloatArray) -> FloatArray:
    """Return flange poses in the world.

    Args:
        arm: Arm.
        bases: Bases (4, 4), or one for each posture, that replace the arm's own, by arm.
        q: Joint angles (..., 6) [rad].

    Returns:
        Poses (..., 4, 4).
    """
    base = np.asarray(bases.get(arm.name, arm.base))
    return np.asarray(base @ forward_kinematics(arm.data, q))


def bases_at_targets(
    setup: Setup,
    bases: Mapping[str, FloatArray],
    operation: OperationPlan,
    rows: IntArray | slice | int = slice(None),
) -> dict[str, FloatArray]:
    """Return bases with those of arms on coordinated tracks as they are at some targets of an operation.

    Args:
        setup: Setup.
        bases: Bases {arm: (4, 4)} in the world, which are returned for all other arms.
        operation: Operation.
        rows: Indices of targets (T,), or a single one.

    Returns:
        Bases {arm: (4, 4)}, or (T, 4, 4) for arms on coordinated tracks and several targets.
    """
    out = dict(bases)
    for name, values in operation.targets.track_positions.items():
        out[name] = track_base(setup.cell.arm(name), values[rows])
    return out


def track_base(arm: Arm, values: FloatArray) -> FloatArray:
    """Return the bases (..., 4, 4) in the world of a setup's arm at values (...,) [m] of its track."""
    values = np.asarray(values)
    out = np.array(np.broadcast_to(arm.base, (*values.shape, 4, 4)))
    if arm.track is not None:
        out[..., :3, 3] += (values - (arm.track_position or 0.0))[..., None] * arm.track.axis
    return out


def block_pose(
    setup: Setup, stock_pose: FloatArray, bases: Mapping[str, FloatArray], q: Mapping[str, FloatArray]
) -> FloatArray:
    """Return the pose of the stock in the world.

    Args:
        setup: Setup.
        stock_pose: Pose of a fixed block (4, 4).
        bases: Bases that replace the arms' own, by arm.
        q: Joint angles {arm: (T, 6)} [rad]. Other arms are at home.

    Returns:
        Pose (4, 4) of a fixed block, or (T, 4, 4) of one that an arm holds.
    """
    holder = setup.stock.held_by
    if holder is None:
        return np.asarray(stock_pose, dtype=np.float64)
    arm = setup.cell.arm(holder)
    return np.asarray(flange_poses(arm, bases, q.get(holder, arm.home)) @ arm.tool.tcp @ setup.stock.grip)


def linear_cutter(setup: Setup, arms: tuple[str, ...]) -> Arm | None:
    """Return the first of some arms with a linear cutter (bow wire or mill axis), or None."""
    carriers = (setup.cell.arm(name) for name in arms)
    return next((arm for arm in carriers if isinstance(arm.tool, Bow | Mill)), None)


def wire_in_block(
    setup: Setup,
    arm: Arm,
    stock_pose: FloatArray,
    bases: Mapping[str, FloatArray],
    q: Mapping[str, FloatArray],
) -> FloatArray:
    """Return both ends (T, 2, 3) [m] of a straight wire or of a mill's axis in the stock frame.

    Args:
        setup: Setup.
        arm: Arm with the linear cutter.
        stock_pose: Pose of a fixed block (4, 4).
        bases: Bases that replace the arms' own, by arm.
        q: Joint angles {arm: (T, 6)} [rad].
    """
    pose = inverse(block_pose(setup, stock_pose, bases, q)) @ flange_poses(arm, bases, q[arm.name])
    return np.asarray(np.einsum("tij,kj->tki", pose[:, :3, :3], wire_ends(arm)) + pose[:, None, :3, 3])


def wire_ends(arm: Arm) -> FloatArray:
    """Return both ends (2, 3) [m] of a straight wire or of a mill's axis, in the flange frame.

    Raises:
        ValueError: The tool is not a linear cutter.
    """
    match arm.tool:
        case Bow():
            return axis_ends(arm.tool.wire)
        case Mill():
            return axis_ends(arm.tool.solid)
        case _:
            raise ValueError(f"tool {arm.tool.name} cuts along no line")


def block_box(setup: Setup) -> Shape:
    """Return the block at the start of a setup as a box, in the stock frame."""
    lower, upper = setup.stock.lower, setup.stock.upper
    pose = np.eye(4)
    pose[:3, 3] = 0.5 * (lower + upper)
    size = upper - lower
    return Shape("box", (float(size[0]), float(size[1]), float(size[2])), pose)


def setup_index(problem: Problem, operation: int) -> int:
    """Return the index of an operation's setup, from 0."""
    return problem.setup_of(operation).number - 1


_PLAIN_COLOUR = (0.7, 0.72, 0.75, 1.0)
"""Red, green, blue, alpha in 0..1 of a body without a stated colour."""
HOT_COLOUR: Final = (1.0, 0.30, 0.05, 1.0)
"""Red, green, blue, alpha in 0..1 of a hot wire."""
MIN_WIRE_RADIUS_M: Final = 2.2e-3
"""Minimum radius [m] of a drawn wire, so that it is visible."""


@dataclasses.dataclass(frozen=True)
class VisiblePiece:
    """One visible shape.

    Attributes:
        body: Name of the body.
        shape: Shape of Drake, or a mesh shape of the planner.
        pose: Pose in the frame of the body (4, 4).
        color: Red, green, blue, alpha in 0..1.
        solid: The shape as triangles.
    """

    body: str
    shape: Any
    pose: FloatArray
    color: tuple[float, float, float, float]
    solid: RenderSolid

    @property
    def closed(self) -> bool:
        """Whether only the outside is visible. True for all shapes except meshes."""
        return not (isinstance(self.shape, Mesh) or getattr(self.shape, "kind", "") == "mesh")


@dataclasses.dataclass(frozen=True)
class VisibleScene:
    """Visible shapes of robots and fixed bodies. ``model`` computes the poses of its bodies."""

    model: CellModel
    pieces: tuple[VisiblePiece, ...]

    def bodies(self) -> tuple[str, ...]:
        """Return the names of visible bodies, in the order of their pieces."""
        return tuple(dict.fromkeys(piece.body for piece in self.pieces))

    def poses(self, q: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        """Return world poses {body: (B, 4, 4)} of :meth:`bodies` and of every arm's tool.

        The frame of a tool is the flange. If the model has a base for each row, it applies to that row.

        Args:
            q: Joint angles {arm: (B, 6)} [rad]. Other arms are at home.
        """
        rows = self.model.stack_rows(q)
        tools = (f"{arm}/tool" for arm in self.model.arms)
        drake_bodies = {name: self.model.body(name) for name in (*self.bodies(), *tools)}
        out = {name: np.empty((len(rows), 4, 4)) for name in drake_bodies}
        for i, row in enumerate(rows):
            context = self.model.at_rows(i).checker.UpdatePositions(row)
            for name, body in drake_bodies.items():
                out[name][i] = body.EvalPoseInWorld(context).GetAsMatrix4()
        return out


def extract_scene(model: CellModel, hulls: bool = False) -> VisibleScene:
    """Return the visible shapes of a cell model, except tools, block and support, which setups change.

    Args:
        model: Cell model.
        hulls: Draw robots from the user's files as their collision shapes instead of their visual shapes.
    """
    inspector = model.diagram.scene_graph().model_inspector()
    names = {model.body(n).index(): n for n in _all_names(model)}
    file_arms = () if hulls else [arm for arm in model.arms if _file_visuals(model.robots[arm])]
    pieces = [piece for arm in file_arms for piece in _visual_pieces(arm, model.robots[arm])]
    hidden = {
        "stock",
        "support",
        *(f"{arm}/{link}" for arm in file_arms for link in link_chain(model.robots[arm].axes)[:-1]),
    }
    for geometry in inspector.GetAllGeometryIds(Role.kIllustration):
        body = model.plant.GetBodyFromFrameId(inspector.GetFrameId(geometry))
        shape = inspector.GetShape(geometry)
        properties = inspector.GetIllustrationProperties(geometry)
        rgba = properties.GetPropertyOrDefault("phong", "diffuse", Rgba(*_PLAIN_COLOUR))
        color = (rgba.r(), rgba.g(), rgba.b(), rgba.a())
        pose = inspector.GetPoseInFrame(geometry).GetAsMatrix4()
        name = names[body.index()]
        if name not in hidden and not name.endswith(("/tool", "/edge")):
            pieces.append(VisiblePiece(name, shape, pose, color, _solid(shape)))
    return VisibleScene(model, tuple(sorted(pieces, key=lambda p: p.body)))


def _file_visuals(robot: RobotData) -> tuple[tuple[VisualShape, ...], ...]:
    """Return the visual shapes in a robot's file, by link. Empty for a robot of the catalogue."""
    return () if robot.file is None else robot.file.visuals


def _visual_pieces(arm: str, robot: RobotData) -> Iterator[VisiblePiece]:
    """Yield the visual shapes of a robot from its file, meshes with a colour of their own smoothly shaded."""
    for link, visuals in zip(link_chain(robot.axes), _file_visuals(robot), strict=False):
        for visual in visuals:
            shape, body = visual.shape, f"{arm}/{link}"
            if visual.color is None or shape.vertices is None or shape.faces is None:
                yield _piece(body, shape, ROBOT_COLOUR if visual.color is None else (*visual.color, 1.0))
                continue
            r, g, b = visual.color
            solid = raster.mesh(shape.vertices, shape.faces, smooth=True)
            yield VisiblePiece(body, shape, shape.pose, (r, g, b, 1.0), solid)


def setup_pieces(setup: Setup, stock_pose: FloatArray) -> tuple[VisiblePiece, ...]:
    """Return the shapes that a setup adds.

    Args:
        setup: Setup.
        stock_pose: Pose of the stock (4, 4).

    Returns:
        Bodies "<arm>/tool" and "<arm>/edge" in the flange frame, "stock" and "support" in the stock frame.
    """
    out = []
    for arm in setup.cell.arms:
        out += [_piece(f"{arm.name}/tool", shape, TOOL_COLOUR) for shape in arm.tool.shapes]
        solid = working_solid(arm.tool)
        if solid is not None:
            out.append(_piece(f"{arm.name}/edge", _visible_edge(solid), HOT_COLOUR))
    out.append(_piece("stock", block_box(setup), STOCK_COLOUR))
    if setup.stock.held_by is None:
        support = with_support(setup.cell, setup.stock, stock_pose).support
        out += [_piece("support", shape, SUPPORT_COLOUR) for shape in support]
    return tuple(out)


def _visible_edge(edge: Shape) -> Shape:
    """Return a tool's edge as drawn: wires with at least :data:`MIN_WIRE_RADIUS_M`, meshes unchanged."""
    if edge.kind == "mesh":
        return edge
    radius, length = edge.size
    return dataclasses.replace(edge, size=(max(radius, MIN_WIRE_RADIUS_M), length))


def axis_bases(setup: Setup) -> dict[str, FloatArray]:
    """Return the bases {arm: (4, 4)} in the world of the arms on external axes, as they are in a setup."""
    return {arm.name: arm.base for arm in setup.cell.arms if arm.linear_axes}


def axis_motions(model: CellModel, axis_values: Mapping[str, float]) -> dict[str, FloatArray]:
    """Return the motions {body: (4, 4)} in the world of bodies on external axes.

    They lead from the poses in the model to those at other values of the axes.

    Args:
        model: Cell model.
        axis_values: Values of the axes [m, rad] after the motion, by name.
    """
    model_values = {
        **model.stock.axis_values,
        **{k: v for arm in model.cell.arms for k, v in arm.axis_values.items()},
    }
    motions = model.cell.carried_motions(axis_values, model_values)
    return {body: motions[name] for name, bodies in model.cell.carried_bodies.items() for body in bodies}


def poses_on_axes(
    scene: VisibleScene,
    setups: Sequence[Setup],
    setup: IntArray,
    poses: Mapping[str, FloatArray],
    values: Mapping[str, FloatArray] | None = None,
) -> dict[str, FloatArray]:
    """Return world poses {body: (T, 4, 4)} of a scene in which external axes move arms and bodies.

    Args:
        scene: Scene.
        setups: Setups.
        setup: Index of the setup in force (T,).
        poses: World poses {body: (T, 4, 4)} with all external axes as in the model of the scene.
        values: Values (T,) [m, rad] of all axes by name, or None for those of the setups.
    """
    out = dict(poses)
    values_at_rows = [setups[k].axis_values for k in setup]
    if values:
        values_at_rows = [
            {name: float(axis_series[k]) for name, axis_series in values.items()} for k in range(len(setup))
        ]
    if scene.model.cell.carried_bodies:
        motions = [axis_motions(scene.model, row_values) for row_values in values_at_rows]
        for name in motions[0] if motions else ():
            if name in poses:
                out[name] = np.stack([row_motions[name] for row_motions in motions]) @ poses[name]
    # an arm on linear axes is translated from its base in the model
    for arm in (arm for arm in setups[0].cell.arms if arm.linear_axes):
        displacement = np.array(
            [[row_values[name] for name in arm.axes_by_name] for row_values in values_at_rows]
        ) - np.array(arm.axis_positions)
        base_positions = arm.base[:3, 3] + displacement @ np.stack([axis.axis for axis in arm.linear_axes])
        for body in [body for body in poses if body.startswith(f"{arm.name}/")]:
            out[body] = np.array(np.broadcast_to(poses[body], (len(setup), 4, 4)))
            out[body][:, :3, 3] += base_positions - scene.model.bases[arm.name][:3, 3]
    return out


def scene_poses(
    scene: VisibleScene, setup: Setup, stock_pose: FloatArray, q: Mapping[str, FloatArray]
) -> dict[str, FloatArray]:
    """Return world poses {body: (B, 4, 4)} of a scene and of what :func:`setup_pieces` adds to it.

    Args:
        scene: Scene.
        setup: Setup.
        stock_pose: Pose of a fixed block (4, 4).
        q: Joint angles {arm: (B, 6)} [rad].
    """
    out = scene.poses(q)
    count = len(next(iter(out.values())))
    for arm in scene.model.arms:
        out[f"{arm}/edge"] = out[f"{arm}/tool"]
    stock = block_pose(setup, stock_pose, scene.model.bases, q)
    out["stock"] = out["support"] = np.broadcast_to(stock, (count, 4, 4))
    for name, motion in axis_motions(scene.model, setup.axis_values).items():
        out[name] = motion @ out[name]
    return out


def _piece(body: str, shape: Shape, color: Any) -> VisiblePiece:
    """Return a shape of the planner as a visible piece of a body."""
    visible_shape = drake_shape(shape, solid=False)
    r, g, b, a = (float(v) for v in color)
    return VisiblePiece(body, visible_shape, shape.pose, (r, g, b, a), _solid(visible_shape))


def _all_names(model: CellModel) -> list[str]:
    """Return the names of all bodies of the model that have one, without the world."""
    return [model.body_name(i) for i in range(1, model.plant.num_bodies()) if _has_name(model, i)]


def _has_name(model: CellModel, index: int) -> bool:
    try:
        model.body_name(index)
    except KeyError:
        return False
    return True


def _solid(shape: Any) -> RenderSolid:
    """Return a shape of Drake as triangles. Raises TypeError for other kinds of shapes."""
    if isinstance(shape, Box):
        return raster.box(*(float(v) for v in shape.size()))
    if isinstance(shape, Cylinder):
        return raster.cylinder(shape.radius(), shape.length())
    if isinstance(shape, Capsule):
        return raster.capsule(shape.radius(), shape.length())
    if isinstance(shape, Sphere):
        return raster.sphere(shape.radius())
    if isinstance(shape, Mesh | Convex):
        return _file_solid(shape)
    raise TypeError(f"visible shape of unsupported kind {type(shape).__name__}")


def _file_solid(shape: Any) -> RenderSolid:
    """Return the mesh of a Drake shape, from memory or from its file, as triangles."""
    source = shape.source()
    if source.is_in_memory():
        memory = source.in_memory().mesh_file
        text = memory.contents()
        content = text if isinstance(text, bytes) else text.encode()
        loaded = trimesh.load(
            trimesh.util.wrap_as_stream(content), file_type=memory.extension()[1:], process=False
        )
    else:
        loaded = trimesh.load(source.path(), process=False)
    mesh = loaded.to_mesh() if isinstance(loaded, trimesh.Scene) else loaded
    vertices = np.asarray(mesh.vertices, dtype=np.float64) * shape.scale()
    return raster.mesh(vertices, np.asarray(mesh.faces, dtype=np.int64))


WIRE_POINTS: Final = 29
"""Number of points of a bent wire in the replay."""
MOTION_TIME: Final = "from first to last target"
"""Words for the part of the motion that the motion time of report and replay includes.

Approach and retreat are not included, because they have no clock in the plan.
"""
TRAVEL_TIME: Final = "of track or turntable between stations"
"""Words for the travel of external axes whose time report and replay state. The proof has it on its clock."""
ENTRY_SPEED_FRACTION: Final = 0.25
"""Fraction of the joint speed limits at which the replay shows entry and exit, which have no clock."""
SETUP_PAUSE_S: Final = 2.0
"""Time [s] for which the replay shows a change of setup, half before and half after it."""
SETUP_SEGMENT: Final = Segment("setup")
"""Segment of a replay in which the operator changes the setup."""
TRAVEL_STEP_S: Final = 0.25
"""Time [s] between keyframes while a track or turntable moves."""
CHANGE_TIME_S: Final = 0.01
"""Time [s] between the keyframes before and after a change of setup, in which stock and tools change."""


@dataclasses.dataclass(frozen=True)
class DrawnSweep:
    """Surface that the wire or mill of one operation sweeps during one run of cutting keyframes.

    Attributes:
        setup: Index of the setup.
        keys: Indices of successive keyframes (K,).
        points: Points of the wire (K, P, 3) [m] in the stock frame. A straight wire has two, its ends.
    """

    setup: int
    keys: IntArray
    points: FloatArray


@dataclasses.dataclass(frozen=True)
class Keyframes:
    """Keyframes of a replay.

    Attributes:
        time: Ascending times (T,) [s].
        q: Joint angles {arm: (T, 6)} [rad].
        segment: Segment (T,) of the path to each keyframe.
        setup: Indices of setups (T,), from 0.
        block: Poses of the stock in the world (T, 4, 4).
        wire: Wire between the arms in the world (T, P, 3) [m], or None.
        shown: Whether the wire is mounted (T,).
        wire_radius: Radius of the wire [m].
        stops: Times [s] and texts of stops.
        sweeps: Surfaces that wires and mills cut.
        axis_values: Values (T,) [m, rad] of external axes, by their names among the stations.
        travel: Total time [s] in which they move between stations.
        operation: Indices of operations (T,), from 0.
        starts: Times [s] of the first targets of the operations.
    """

    time: FloatArray
    q: Mapping[str, FloatArray]
    segment: tuple[Segment, ...]
    setup: IntArray
    block: FloatArray
    wire: FloatArray | None
    shown: BoolArray
    wire_radius: float
    stops: tuple[tuple[float, str], ...]
    sweeps: tuple[DrawnSweep, ...]
    axis_values: Mapping[str, FloatArray] = dataclasses.field(default_factory=dict)
    travel: float = 0.0
    operation: IntArray = dataclasses.field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    starts: tuple[float, ...] = ()


@dataclasses.dataclass
class _SampleLists:
    """Samples of the motion while they are collected, as lists of arrays, with times in seconds.

    ``wire`` is NaN where no wire joins the arms. ``axis_values`` are the values of external axes at the
    samples, ``present_values`` those after the last sample.
    """

    time: list[FloatArray]
    q: dict[str, list[FloatArray]]
    wire: list[FloatArray]
    segment: list[Segment]
    operation: list[int]
    stops: list[tuple[float, str]]
    axis_values: dict[str, list[FloatArray]]
    present_values: dict[str, float]
    travel: float = 0.0
    starts: list[float] = dataclasses.field(default_factory=list)

    def end(self) -> float:
        """Return the time [s] of the last sample, or 0."""
        return float(self.time[-1][-1]) if self.time else 0.0


@dataclasses.dataclass(frozen=True)
class _MotionSamples:
    """Motion of the arms at some instants.

    Attributes:
        time: Ascending times (T,) [s].
        q: Joint angles {arm: (T, 6)} [rad], or (1, 6) of an arm that does not move.
        segment: Segments (T,).
        wire: Wire between the arms in the world (T, WIRE_POINTS, 3) [m], or None.
        axis_values: Values (T,) [m, rad] of the external axes that move meanwhile.
    """

    time: FloatArray
    q: Mapping[str, FloatArray]
    segment: tuple[Segment, ...]
    wire: FloatArray | None = None
    axis_values: Mapping[str, FloatArray] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class _HomingMotion:
    """Approach or retreat of the arms of an operation.

    Attributes:
        paths: Joint angles {arm: (T, 6)} [rad].
        groups: Groups of arms that move together. The groups move one after the other.
        segment: Segment of the motion.
    """

    paths: Mapping[str, FloatArray]
    groups: Sequence[tuple[str, ...]]
    segment: Segment


def sample_keyframes(problem: Problem, plan: Plan, keys: int) -> Keyframes:
    """Sample a plan at keyframes for the replay, from home through all operations and back to home.

    Keyframes are denser outside the work, where the motion is fast. Approach, retreat and changes of setup
    have no times in the plan, so they get times that are chosen for the replay.

    Args:
        problem: Problem.
        plan: Plan.
        keys: Approximate number of keyframes.
    """
    setups = problem.setups
    arms = [arm.name for arm in problem.cell.arms]
    samples = _SampleLists(
        time=[],
        q={arm: [] for arm in arms},
        wire=[],
        segment=[],
        operation=[],
        stops=[],
        axis_values={name: [] for name in problem.axis_homes},
        present_values=problem.axis_homes,
    )
    travels = external_axis_motion.axis_travels(problem, plan.stock_poses)
    joints = {arm.name: np.asarray(arm.home) for arm in problem.cell.arms}
    for index, operation in enumerate(plan.operations):
        setup = setups[setup_index(problem, index)]
        if setup.steps and setup.operations[0] == index:
            _add_setup_pause(samples, setup, index, joints)
        if travels:
            _add_travel(samples, travels[index], index, joints)
        # Each group moves at once, one group after the other. The arms retreat in reverse order.
        one_by_one = [(arm,) for arm in operation.arm_order]
        entry_groups = [operation.arm_order] if "entry" in operation.synchronised else one_by_one
        exit_groups = [operation.arm_order] if "exit" in operation.synchronised else one_by_one[::-1]
        approach = _HomingMotion(operation.approach, entry_groups, Segment("entry"))
        joints = _add_approach_or_retreat(samples, problem, index, approach, joints)
        joints = _add_operation(samples, setup, plan, index, operation, joints)
        retreat = _HomingMotion(operation.retreat, exit_groups, Segment("exit"))
        joints = _add_approach_or_retreat(samples, problem, index, retreat, joints)
    if problem.closing_setup is not None and len(plan.operations) == len(problem.operations):
        _add_setup_pause(samples, problem.closing_setup, len(plan.operations) - 1, joints)
        _add_travel(samples, travels[-1], len(plan.operations) - 1, joints)
    if not samples.time:
        q = {arm: v[None] for arm, v in joints.items()}
        _append_samples(samples, 0, _MotionSamples(np.zeros(1), q, (Segment("home"),)))
    time = np.concatenate(samples.time)
    keyframe_times = _keyframe_times(time, samples.segment, keys)
    return _interpolate_keyframes(samples, time, keyframe_times, problem, plan)


def _add_setup_pause(
    samples: _SampleLists, setup: Setup, index: int, joints: Mapping[str, FloatArray]
) -> None:
    """Add a pause at home before the operation ``index``, in whose middle the setup changes."""
    start = samples.end()
    q = {arm: v[None] for arm, v in joints.items()}
    # rounded like the times of keyframes, so that a keyframe is exactly there
    middle = round(start + 0.5 * SETUP_PAUSE_S, 2)
    samples.stops.append((middle, " ".join((*setup.steps, setup.confirmation))))
    if index > 0:
        time = np.array([start, middle])
        _append_samples(samples, index - 1, _MotionSamples(time, q, (SETUP_SEGMENT,) * 2))
        start = middle + CHANGE_TIME_S
    time = np.array([start, middle + 0.5 * SETUP_PAUSE_S])
    _append_samples(samples, index, _MotionSamples(time, q, (SETUP_SEGMENT,) * 2))


def _add_travel(
    samples: _SampleLists, travels: Mapping[str, AxisTravel], index: int, joints: Mapping[str, FloatArray]
) -> None:
    """Add the travel of tracks and axes under the block to their stations, one after the other."""
    q = {arm: v[None] for arm, v in joints.items()}
    for name, travel in travels.items():
        # rounded up like the times of keyframes, which are hundredths of a second
        start, seconds = np.ceil(100.0 * samples.end()) / 100.0, travel.seconds
        fraction = np.linspace(0.0, 1.0, max(2, int(np.ceil(seconds / TRAVEL_STEP_S)) + 1))
        values = travel.start + fraction * (travel.end - travel.start)
        segments = (SETUP_SEGMENT,) * len(fraction)
        motion = _MotionSamples(start + fraction * seconds, q, segments, axis_values={name: values})
        _append_samples(samples, index, motion)
        samples.present_values = {**samples.present_values, name: travel.end}
        samples.travel += seconds


def _add_approach_or_retreat(
    samples: _SampleLists, problem: Problem, index: int, homing: _HomingMotion, joints: dict[str, FloatArray]
) -> dict[str, FloatArray]:
    """Add the approach or retreat of the arms, one group after the other, at a moderate speed.

    Arms of one group move together, and the slowest one determines the time between waypoints.

    Returns:
        Joint angles {arm: (6,)} [rad] of all arms afterwards.
    """
    paths = homing.paths
    for group in homing.groups:
        group_paths = {name: paths[name] for name in group if len(paths.get(name, ()))}
        if not group_paths:
            continue
        group_paths = {name: np.concatenate([joints[name][None], path]) for name, path in group_paths.items()}
        durations = []
        for name, path in group_paths.items():
            robot = problem.cell.arm(name).data
            durations.append(
                np.max(np.abs(np.diff(path, axis=0)) / (ENTRY_SPEED_FRACTION * robot.velocity), axis=1)
            )
        time = samples.end() + np.concatenate([[0.0], np.cumsum(np.max(durations, axis=0))])
        q = {**{a: q[None] for a, q in joints.items()}, **group_paths}
        _append_samples(samples, index, _MotionSamples(time, q, (homing.segment,) * len(time)))
        joints = {**joints, **{name: path[-1] for name, path in group_paths.items()}}
    return joints


def _add_operation(
    samples: _SampleLists,
    setup: Setup,
    plan: Plan,
    index: int,
    operation: OperationPlan,
    joints: dict[str, FloatArray],
) -> dict[str, FloatArray]:
    """Add the motion of an operation from its first to its last target, with its stops.

    Arms without targets stay at ``joints`` {arm: (6,)} [rad]. Returns the joints of all arms afterwards.
    """
    targets = operation.targets
    time = operation.time - operation.time[0] + samples.end()
    samples.starts.append(samples.end())
    q = {**{a: v[None] for a, v in joints.items()}, **operation.q}
    for action in targets.actions:
        text = action.text or {"on": f"{action.signal} on", "off": f"{action.signal} off"}.get(
            action.kind, ""
        )
        text = text or f"wait {action.seconds:g} s"
        samples.stops.append((float(time[action.target]), text))
    wire = edge_in_world(setup, plan, operation)
    _append_samples(samples, index, _MotionSamples(time, q, targets.segment, wire, targets.track_positions))
    samples.present_values = {
        **samples.present_values,
        **{arm: float(values[-1]) for arm, values in targets.track_positions.items()},
    }
    return {**joints, **{arm: operation.q[arm][-1] for arm in operation.q}}


def edge_in_world(setup: Setup, plan: Plan, operation: OperationPlan) -> FloatArray | None:
    """Return the wire between the arms (N, WIRE_POINTS, 3) [m] in the world at every target, or None.

    Args:
        setup: Setup.
        plan: Plan.
        operation: Operation.
    """
    targets = operation.targets
    if targets.flexible_tool is None:
        return None
    points = targets.flexible_tool.points
    # resample the wire linearly at evenly spaced fractional indices
    at = np.linspace(0.0, points.shape[1] - 1.0, WIRE_POINTS)
    low = np.minimum(at.astype(int), points.shape[1] - 2)
    fraction = (at - low)[:, None]
    points = points[:, low] * (1.0 - fraction) + points[:, low + 1] * fraction
    frame = targets.frame[targets.arms[0]]
    if frame == "world":
        return np.asarray(points)
    if frame == "stock":
        return transform(np.asarray(plan.stock_poses[setup.number - 1]), points)
    arm = setup.cell.arm(frame.removeprefix("held:"))
    pose = flange_poses(arm, plan.bases, operation.q[arm.name]) @ arm.tool.tcp
    return np.asarray(np.einsum("nij,npj->npi", pose[:, :3, :3], points) + pose[:, None, :3, 3])


def _append_samples(samples: _SampleLists, index: int, motion: _MotionSamples) -> None:
    """Append the samples of a motion in the operation ``index``. Other external axes keep their values."""
    count, q = len(motion.time), motion.q
    for name, values in samples.axis_values.items():
        values.append(np.broadcast_to(motion.axis_values.get(name, samples.present_values[name]), (count,)))
    samples.time.append(motion.time)
    for arm, gathered in samples.q.items():
        gathered.append(np.broadcast_to(q[arm], (count, q[arm].shape[-1])))
    samples.wire.append(np.full((count, WIRE_POINTS, 3), np.nan) if motion.wire is None else motion.wire)
    samples.segment += list(motion.segment)
    samples.operation += [index] * count


def _keyframe_times(time: FloatArray, segments: Sequence[Segment], keys: int) -> FloatArray:
    """Choose times of keyframes from those of samples (S,) [s], rounded to hundredths of a second.

    Six tenths are evenly spaced. The others are times of samples: outside the work, which is fast, at the
    start and end of the work, and in changes of setup.
    """
    even = np.linspace(time[0], time[-1], max(2, int(0.6 * keys)))
    working = np.array([segment.works for segment in segments])
    is_pause = np.array([segment == SETUP_SEGMENT for segment in segments])
    change = np.flatnonzero(working[1:] != working[:-1])
    outside_work = np.flatnonzero(~working)
    outside_work = outside_work[:: max(1, -(-len(outside_work) // max(1, int(0.35 * keys))))]
    sample_indices = np.concatenate([outside_work, change, change + 1, np.flatnonzero(is_pause)])
    return np.unique(np.round(np.concatenate([even, time[sample_indices]]), 2))


def _interpolate_keyframes(
    samples: _SampleLists, sampled: FloatArray, times: FloatArray, problem: Problem, plan: Plan
) -> Keyframes:
    """Interpolate the samples, taken at times ``sampled`` (S,) [s], at the ``times`` (T,) [s] of keyframes.

    Between two samples, segment and operation are those of the later one. At the time of a sample they are
    those of that sample.
    """
    later = np.clip(np.searchsorted(sampled, times, side="right"), 1, max(len(sampled) - 1, 1))
    later = np.minimum(later, len(sampled) - 1)
    earlier = np.maximum(later - 1, 0)
    gap = sampled[later] - sampled[earlier]
    fraction = np.where(gap > 0, (times - sampled[earlier]) / np.where(gap > 0, gap, 1.0), 0.0)
    fraction = np.clip(fraction, 0.0, 1.0)

    def interpolate(values: FloatArray) -> FloatArray:
        """Interpolate values (S, ...) of the samples at the keyframes."""
        weight = fraction.reshape(-1, *(1,) * (values.ndim - 1))
        return np.asarray(values[earlier] * (1.0 - weight) + values[later] * weight)

    q = {arm: interpolate(np.concatenate(parts)) for arm, parts in samples.q.items()}
    sample_index = np.where(fraction > 1e-9, later, earlier)
    segments = tuple(samples.segment[i] for i in sample_index)
    operation = np.array(samples.operation)[sample_index]
    index = np.array([setup_index(problem, i) for i in range(len(plan.operations))] or [0])
    setup = index[operation]
    block = np.empty((len(times), 4, 4))
    for k in np.unique(setup):
        in_setup = setup == k
        joints = {arm: values[in_setup] for arm, values in q.items()}
        block[in_setup] = block_pose(problem.setups[k], plan.stock_poses[k], plan.bases, joints)
    axis_values = {name: interpolate(np.concatenate(parts)) for name, parts in samples.axis_values.items()}
    table = problem.cell.turntable
    if table is not None:
        setup_values = [problem.setups[k].stock.axis_values for k in setup]
        present_values = [{name: axis_values[name][k] for name in table.axes} for k in range(len(times))]
        moves = zip(block, present_values, setup_values, strict=True)
        block = np.stack([table.move_pose(pose, values, reference) for pose, values, reference in moves])
    wire = interpolate(np.concatenate(samples.wire))
    shown = np.asarray(np.isfinite(wire).all(axis=(1, 2)), dtype=np.bool_)
    keyframes = Keyframes(
        time=times,
        q=q,
        segment=segments,
        setup=setup,
        block=block,
        wire=None,
        shown=np.zeros(len(times), dtype=bool),
        wire_radius=0.0,
        stops=tuple(samples.stops),
        sweeps=(),
        axis_values=axis_values,
        travel=samples.travel,
        operation=operation,
        starts=tuple(samples.starts),
    )
    keyframes = dataclasses.replace(keyframes, sweeps=_wire_sweeps(problem, plan, keyframes, wire))
    wires = [op.targets.flexible_tool for op in plan.operations if op.targets.flexible_tool is not None]
    if not wires or not shown.any():
        return keyframes
    # A hidden wire waits where it is shown next or was shown last, so that nothing flies in.
    seen = np.flatnonzero(shown)
    wire = wire[seen[np.clip(np.searchsorted(seen, np.arange(len(times))), 0, len(seen) - 1)]]
    return dataclasses.replace(keyframes, wire=wire, shown=shown, wire_radius=wires[0].radius)


def _wire_sweeps(
    problem: Problem, plan: Plan, keyframes: Keyframes, wire: FloatArray
) -> tuple[DrawnSweep, ...]:
    """Return the surface that the wire or mill sweeps in each run of cutting keyframes.

    A run includes the keyframe before it, at which its first motion starts.

    Args:
        problem: Problem.
        plan: Plan.
        keyframes: Keyframes, still without wire and sweeps.
        wire: Wire between the arms in the world (T, P, 3) [m], NaN where no wire joins them.
    """
    is_cutting = np.array([segment.kind == "cut" for segment in keyframes.segment])
    out = []
    for index, operation_plan in enumerate(plan.operations):
        cutting_keyframes = np.flatnonzero(is_cutting & (keyframes.operation == index))
        for run in np.split(cutting_keyframes, np.flatnonzero(np.diff(cutting_keyframes) > 1) + 1):
            if not len(run):
                continue
            keys = np.concatenate([[max(run[0] - 1, 0)], run]) if run[0] > 0 else run
            setup = problem.setup_of(index)
            arm = linear_cutter(setup, operation_plan.targets.arms)
            if operation_plan.targets.flexible_tool is not None:
                to_block = inverse(keyframes.block[keys])
                points = wire[keys] @ np.swapaxes(to_block[:, :3, :3], 1, 2) + to_block[:, None, :3, 3]
            elif arm is not None:
                joints = {name: values[keys] for name, values in keyframes.q.items()}
                stock_pose = plan.stock_poses[setup.number - 1]
                track_bases = {
                    name: track_base(setup.cell.arm(name), keyframes.axis_values[name][keys])
                    for name in operation_plan.targets.track_positions
                }
                points = wire_in_block(setup, arm, stock_pose, {**plan.bases, **track_bases}, joints)
            else:
                continue
            out.append(DrawnSweep(setup.number - 1, keys, points))
    return tuple(out)
