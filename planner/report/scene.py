"""What a cell looks like, and how it moves: its bodies, what setups add, the whole job on one clock.

Shapes come from the cell's Drake model: robots and fixed bodies once, then what each setup adds.
Where the block and a straight wire are follows from joint angles, in the setup of an operation. The
clock of the replay (`track`) goes from home through all setups and operations and back.
"""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
import trimesh
from pydrake.geometry import Box, Capsule, Convex, Cylinder, Mesh, Rgba, Role, Sphere

from planner.catalogue.robots import Look, RobotData
from planner.cell import axis_way
from planner.cell.axis_way import Travel
from planner.cell.bodies import drake_shape, link_chain
from planner.cell.kinematics import forward
from planner.cell.plant import ROBOT_COLOUR, STOCK_COLOUR, SUPPORT_COLOUR, TOOL_COLOUR, CellModel
from planner.cell.support import with_support
from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray, IntArray, Shape, axis_ends, inverse, transform
from planner.plans import OperationPlan, Plan
from planner.problem import Arm, Problem, Setup
from planner.report import raster
from planner.report.raster import Solid
from planner.tooling import Bow, Mill, working_solid


def flange_poses(arm: Arm, bases: Mapping[str, FloatArray], q: FloatArray) -> FloatArray:
    """Flange poses (..., 4, 4) in the world at joint angles q (..., 6); ``bases`` replaces the arm's own."""
    base = np.asarray(bases.get(arm.name, arm.base))
    return np.asarray(base @ forward(arm.data, q))


def riding(
    setup: Setup,
    bases: Mapping[str, FloatArray],
    operation: OperationPlan,
    rows: IntArray | slice | int = slice(None),
) -> dict[str, FloatArray]:
    """Bases {arm: (4, 4)}, or (T, 4, 4) of arms whose tracks go along, at targets ``rows`` (T,) of an
    operation; one row is (4, 4)."""
    out = dict(bases)
    for name, values in operation.targets.ride.items():
        out[name] = ridden_base(setup.cell.arm(name), values[rows])
    return out


def ridden_base(arm: Arm, values: FloatArray) -> FloatArray:
    """Bases (..., 4, 4) of an arm of a setup at values (...,) [m] of its track."""
    values = np.asarray(values)
    out = np.array(np.broadcast_to(arm.base, (*values.shape, 4, 4)))
    if arm.track is not None:
        out[..., :3, 3] += (values - (arm.station or 0.0))[..., None] * arm.track.axis
    return out


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
    setup: Setup, arm: Arm, place: FloatArray, bases: Mapping[str, FloatArray], q: Mapping[str, FloatArray]
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
    """One visible shape: Drake's, or our mesh, ``shape`` at ``pose`` (4, 4) in its body's frame, also as
    triangles."""

    body: str
    shape: Any
    pose: FloatArray
    color: tuple[float, float, float, float]
    solid: Solid

    @property
    def closed(self) -> bool:
        """Whether only its outside can be seen, which holds of all shapes but meshes."""
        return not (isinstance(self.shape, Mesh) or getattr(self.shape, "kind", "") == "mesh")


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
        tools = (f"{arm}/tool" for arm in self.model.arms)
        shown = {name: self.model.body(name) for name in (*self.bodies(), *tools)}
        out = {name: np.empty((len(rows), 4, 4)) for name in shown}
        for i, row in enumerate(rows):
            context = self.model.at_rows(i).checker.UpdatePositions(row)
            for name, body in shown.items():
                out[name][i] = body.EvalPoseInWorld(context).GetAsMatrix4()
        return out


def extract(model: CellModel, hulls: bool = False) -> Scene:
    """The visible shapes of a cell's model but for those that setups change: tools, block, support. Robots of
    the user's own are seen as their makers drew them where their files say how, or, with ``hulls``, by their
    bodies for collision."""
    inspector = model.diagram.scene_graph().model_inspector()
    names = {model.body(n).index(): n for n in _all_names(model)}
    own = () if hulls else [arm for arm in model.arms if _own(model.robots[arm])]
    pieces = [piece for arm in own for piece in _looks(arm, model.robots[arm])]
    hidden = {
        "stock",
        "support",
        *(f"{arm}/{link}" for arm in own for link in link_chain(model.robots[arm].axes)[:-1]),
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
            pieces.append(Piece(name, shape, pose, color, _solid(shape)))
    return Scene(model, tuple(sorted(pieces, key=lambda p: p.body)))


def _own(robot: RobotData) -> tuple[tuple[Look, ...], ...]:
    return () if robot.file is None else robot.file.looks


def _looks(arm: str, robot: RobotData) -> Iterator[Piece]:
    """What is seen of a robot whose file says how it looks."""
    for link, own in zip(link_chain(robot.axes), _own(robot), strict=False):
        for look in own:
            shape, body = look.shape, f"{arm}/{link}"
            if look.color is None or shape.vertices is None or shape.faces is None:
                yield _piece(body, shape, ROBOT_COLOUR if look.color is None else (*look.color, 1.0))
                continue
            r, g, b = look.color
            solid = raster.mesh(shape.vertices, shape.faces, smooth=True)
            yield Piece(body, shape, shape.pose, (r, g, b, 1.0), solid)


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


def standing(setup: Setup) -> dict[str, FloatArray]:
    """Bases (4, 4) in the world of arms that stand on axes, where they do in a setup."""
    return {arm.name: arm.base for arm in setup.cell.arms if arm.axes}


def carried(model: CellModel, there: Mapping[str, float]) -> dict[str, FloatArray]:
    """Motions (4, 4) of the bodies that stand on axes, from where a model was built with them to where they
    are at values [m, rad]."""
    here = {**model.stock.stands, **{k: v for arm in model.cell.arms for k, v in arm.stands.items()}}
    goes = model.cell.going(there, here)
    return {body: goes[name] for name, bodies in model.cell.riders.items() for body in bodies}


def ridden(
    scene: Scene,
    setups: Sequence[Setup],
    setup: IntArray,
    poses: Mapping[str, FloatArray],
    values: Mapping[str, FloatArray] | None = None,
) -> dict[str, FloatArray]:
    """World poses {body: (T, 4, 4)} of a scene with arms and bodies on axes, and what a positioner tilts,
    where they stand in the setups (T,) that are in force, or at ``values`` (T,) [m, rad] of their axes."""
    out = dict(poses)
    stands = [setups[k].stands for k in setup]
    if values:
        stands = [{name: float(own[k]) for name, own in values.items()} for k in range(len(setup))]
    if scene.model.cell.riders:
        goes = [carried(scene.model, there) for there in stands]
        for name in goes[0] if goes else ():
            if name in poses:
                out[name] = np.stack([one[name] for one in goes]) @ poses[name]
    for arm in (arm for arm in setups[0].cell.arms if arm.axes):
        way = np.array([[there[name] for name in arm.rails] for there in stands]) - np.array(arm.stood)
        bases = arm.base[:3, 3] + way @ np.stack([axis.axis for axis in arm.axes])
        for body in [body for body in poses if body.startswith(f"{arm.name}/")]:
            out[body] = np.array(np.broadcast_to(poses[body], (len(setup), 4, 4)))
            out[body][:, :3, 3] += bases - scene.model.bases[arm.name][:3, 3]
    return out


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
    for name, goes in carried(scene.model, setup.stands).items():
        out[name] = goes @ out[name]
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


WIRE_POINTS: Final = 29
"""Points of a bent wire as the replay shows it."""
MOTION_TIME: Final = "from first to last target"
"""Of what report and replay state the motion time; the ways from and to home have no clock of the plan."""
TRAVEL_TIME: Final = "of track or turntable from station to station"
"""Of what report and replay state the time of external axes, which the proof has on its clock."""
ENTRY_PACE: Final = 0.25
"""Share of the joint speed limits at which the replay shows entry and exit, which have no clock."""
SETUP_PAUSE_S: Final = 2.0
"""Time [s] for which the replay shows a change of setup, half of it before and half of it after."""
SETUP_SEGMENT: Final = Segment("setup")
"""Segment of a replay in which the operator changes the setup."""
TRAVEL_STEP_S: Final = 0.25
"""Time [s] between keyframes on the way of a track or turntable."""
CHANGE_TIME_S: Final = 0.01
"""Time [s] in which things change place between two setups."""


@dataclasses.dataclass(frozen=True)
class Sweep:
    """What the wire of one operation sweeps: wires ``points`` (K, P, 3) in the stock frame at the keyframes
    ``keys`` (K,), which follow one another; a straight wire by its two ends."""

    setup: int
    keys: IntArray
    points: FloatArray


@dataclasses.dataclass(frozen=True)
class Track:
    """Keyframes: ``time`` (T,) [s] ascending; ``q`` {arm: (T, 6)}; ``segment`` (T,); ``stops``: time,
    text.

    ``setup`` (T,) counts from 0; ``block`` (T, 4, 4) is the stock's pose in the world. ``wire`` (T, P, 3) in
    the world is a wire that joins the arms, None for jobs without; ``shown`` (T,): whether it is mounted.
    ``sweeps``: what wires cut. ``stands`` (T,): values [m, rad] of tracks and the turntable, by what they
    carry, on whose ways ``travel`` [s] of the time goes. ``operation`` (T,) counts from 0; ``starts``: the
    time [s] of each operation's first target.
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
    sweeps: tuple[Sweep, ...]
    stands: Mapping[str, FloatArray] = dataclasses.field(default_factory=dict)
    travel: float = 0.0
    operation: IntArray = dataclasses.field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    starts: tuple[float, ...] = ()


@dataclasses.dataclass
class _Rows:
    """Keyframes as they are gathered; ``wire`` has NaN where none joins the arms. ``stands``: values of
    external axes at the keyframes, ``here`` those of now."""

    time: list[FloatArray]
    q: dict[str, list[FloatArray]]
    wire: list[FloatArray]
    segment: list[Segment]
    operation: list[int]
    stops: list[tuple[float, str]]
    stands: dict[str, list[FloatArray]]
    here: dict[str, float]
    travel: float = 0.0
    starts: list[float] = dataclasses.field(default_factory=list)

    def end(self) -> float:
        return float(self.time[-1][-1]) if self.time else 0.0


def track(problem: Problem, plan: Plan, keys: int) -> Track:
    """About ``keys`` keyframes of a plan, denser where the motion is quick."""
    setups = problem.setups
    arms = [arm.name for arm in problem.cell.arms]
    rows = _Rows(
        [], {arm: [] for arm in arms}, [], [], [], [], {name: [] for name in problem.homes}, problem.homes
    )
    travels = axis_way.travels(problem, plan.places)
    here = {arm.name: np.asarray(arm.home) for arm in problem.cell.arms}
    for index, operation in enumerate(plan.operations):
        setup = setups[setup_index(problem, index)]
        if setup.steps and setup.operations[0] == index:
            _setup_pause(rows, setup, index, here)
        if travels:
            _travel(rows, travels[index], index, here)
        alone = [(arm,) for arm in operation.order]
        first = [operation.order] if "entry" in operation.together else alone
        last = [operation.order] if "exit" in operation.together else alone[::-1]
        here = _ways(rows, problem, index, operation.entry, first, here, Segment("entry"))
        here = _operation_rows(rows, setup, plan, index, operation, here)
        here = _ways(rows, problem, index, operation.exit, last, here, Segment("exit"))
    if problem.closing is not None and len(plan.operations) == len(problem.operations):
        _setup_pause(rows, problem.closing, len(plan.operations) - 1, here)
        _travel(rows, travels[-1], len(plan.operations) - 1, here)
    if not rows.time:
        _append(rows, 0, np.zeros(1), {arm: q[None] for arm, q in here.items()}, None, (Segment("home"),))
    time = np.concatenate(rows.time)
    pick = _keys(time, rows.segment, keys)
    return _sampled(rows, time, pick, problem, plan)


def _setup_pause(rows: _Rows, setup: Setup, index: int, here: Mapping[str, FloatArray]) -> None:
    """A pause at home while the operator changes the setup; what changes does so in its middle."""
    start = rows.end()
    q = {arm: v[None] for arm, v in here.items()}
    # on a keyframe's time, which keyframes are rounded to
    middle = round(start + 0.5 * SETUP_PAUSE_S, 2)
    rows.stops.append((middle, " ".join((*setup.steps, setup.confirmation))))
    if index > 0:
        _append(rows, index - 1, np.array([start, middle]), q, None, (SETUP_SEGMENT,) * 2)
        start = middle + CHANGE_TIME_S
    _append(rows, index, np.array([start, middle + 0.5 * SETUP_PAUSE_S]), q, None, (SETUP_SEGMENT,) * 2)


def _travel(rows: _Rows, own: Mapping[str, Travel], index: int, here: Mapping[str, FloatArray]) -> None:
    """Tracks and axes under the block go where they are to stand, one after the other, in their time."""
    q = {arm: v[None] for arm, v in here.items()}
    for name, travel in own.items():
        # keyframes are rounded to hundredths
        start, seconds = np.ceil(100.0 * rows.end()) / 100.0, travel.seconds
        share = np.linspace(0.0, 1.0, max(2, int(np.ceil(seconds / TRAVEL_STEP_S)) + 1))
        values = travel.begin + share * (travel.end - travel.begin)
        moved = {name: values}
        _append(rows, index, start + share * seconds, q, None, (SETUP_SEGMENT,) * len(share), moved)
        rows.here = {**rows.here, name: travel.end}
        rows.travel += seconds


def _ways(
    rows: _Rows,
    problem: Problem,
    index: int,
    paths: Mapping[str, FloatArray],
    groups: Sequence[tuple[str, ...]],
    here: dict[str, FloatArray],
    segment: Segment,
) -> dict[str, FloatArray]:
    """The arms' ways, one group after the other, at a modest pace; arms of one group go at once, from point
    to point as the one that takes longest."""
    for group in groups:
        own = {name: paths[name] for name in group if len(paths.get(name, ()))}
        if not own:
            continue
        own = {name: np.concatenate([here[name][None], path]) for name, path in own.items()}
        steps = []
        for name, path in own.items():
            robot = problem.cell.arm(name).data
            steps.append(np.max(np.abs(np.diff(path, axis=0)) / (ENTRY_PACE * robot.velocity), axis=1))
        time = rows.end() + np.concatenate([[0.0], np.cumsum(np.max(steps, axis=0))])
        q = {**{a: q[None] for a, q in here.items()}, **own}
        _append(rows, index, time, q, None, (segment,) * len(time))
        here = {**here, **{name: path[-1] for name, path in own.items()}}
    return here


def _operation_rows(
    rows: _Rows, setup: Setup, plan: Plan, index: int, operation: OperationPlan, here: dict[str, FloatArray]
) -> dict[str, FloatArray]:
    targets = operation.targets
    time = operation.time - operation.time[0] + rows.end()
    rows.starts.append(rows.end())
    q = {**{a: v[None] for a, v in here.items()}, **operation.q}
    for action in targets.actions:
        text = action.text or {"on": f"{action.signal} on", "off": f"{action.signal} off"}.get(
            action.kind, ""
        )
        text = text or f"wait {action.seconds:g} s"
        rows.stops.append((float(time[action.at]), text))
    _append(rows, index, time, q, edge_in_world(setup, plan, operation), targets.segment, targets.ride)
    rows.here = {**rows.here, **{arm: float(values[-1]) for arm, values in targets.ride.items()}}
    return {**here, **{arm: operation.q[arm][-1] for arm in operation.q}}


def edge_in_world(setup: Setup, plan: Plan, operation: OperationPlan) -> FloatArray | None:
    """The wire that joins the arms (N, WIRE_POINTS, 3) in the world at every target, or None."""
    targets = operation.targets
    if targets.edge is None:
        return None
    points = targets.edge.points
    at = np.linspace(0.0, points.shape[1] - 1.0, WIRE_POINTS)
    low = np.minimum(at.astype(int), points.shape[1] - 2)
    share = (at - low)[:, None]
    points = points[:, low] * (1.0 - share) + points[:, low + 1] * share
    frame = targets.frame[targets.arms[0]]
    if frame == "world":
        return np.asarray(points)
    if frame == "stock":
        return transform(np.asarray(plan.places[setup.number - 1]), points)
    arm = setup.cell.arm(frame.removeprefix("held:"))
    pose = flange_poses(arm, plan.bases, operation.q[arm.name]) @ arm.tool.tcp
    return np.asarray(np.einsum("nij,npj->npi", pose[:, :3, :3], points) + pose[:, None, :3, 3])


def _append(
    rows: _Rows,
    index: int,
    time: FloatArray,
    q: Mapping[str, FloatArray],
    wire: FloatArray | None,
    segment: tuple[Segment, ...],
    moved: Mapping[str, FloatArray] | None = None,
) -> None:
    """Keyframes; ``moved``: values of external axes that move meanwhile."""
    count = len(time)
    for name, values in rows.stands.items():
        values.append(np.broadcast_to((moved or {}).get(name, rows.here[name]), (count,)))
    rows.time.append(time)
    for arm, gathered in rows.q.items():
        gathered.append(np.broadcast_to(q[arm], (count, q[arm].shape[-1])))
    rows.wire.append(np.full((count, WIRE_POINTS, 3), np.nan) if wire is None else wire)
    rows.segment += list(segment)
    rows.operation += [index] * count


def _keys(time: FloatArray, segments: Sequence[Segment], keys: int) -> FloatArray:
    """Times of the keyframes: most at equal steps, the rest at rows outside the work, which pass quickly."""
    even = np.linspace(time[0], time[-1], max(2, int(0.6 * keys)))
    working = np.array([segment.works for segment in segments])
    still = np.array([segment == SETUP_SEGMENT for segment in segments])
    change = np.flatnonzero(working[1:] != working[:-1])
    rest = np.flatnonzero(~working)
    rest = rest[:: max(1, -(-len(rest) // max(1, int(0.35 * keys))))]
    rows = np.concatenate([rest, change, change + 1, np.flatnonzero(still)])
    return np.unique(np.round(np.concatenate([even, time[rows]]), 2))


def _sampled(rows: _Rows, time: FloatArray, pick: FloatArray, problem: Problem, plan: Plan) -> Track:
    right = np.clip(np.searchsorted(time, pick, side="right"), 1, max(len(time) - 1, 1))
    right = np.minimum(right, len(time) - 1)
    left = np.maximum(right - 1, 0)
    gap = time[right] - time[left]
    share = np.clip(np.where(gap > 0, (pick - time[left]) / np.where(gap > 0, gap, 1.0), 0.0), 0.0, 1.0)

    def mix(values: FloatArray) -> FloatArray:
        weight = share.reshape(-1, *(1,) * (values.ndim - 1))
        return np.asarray(values[left] * (1.0 - weight) + values[right] * weight)

    q = {arm: mix(np.concatenate(parts)) for arm, parts in rows.q.items()}
    nearest = np.where(share > 1e-9, right, left)
    segments = tuple(rows.segment[i] for i in nearest)
    operation = np.array(rows.operation)[nearest]
    index = np.array([setup_index(problem, i) for i in range(len(plan.operations))] or [0])
    setup = index[operation]
    block = np.empty((len(pick), 4, 4))
    for k in np.unique(setup):
        own = setup == k
        held = {arm: values[own] for arm, values in q.items()}
        block[own] = block_pose(problem.setups[k], plan.places[k], plan.bases, held)
    stands = {name: mix(np.concatenate(parts)) for name, parts in rows.stands.items()}
    table = problem.cell.turntable
    if table is not None:
        here = [problem.setups[k].stock.stands for k in setup]
        there = [{name: stands[name][k] for name in table.axes} for k in range(len(pick))]
        both = zip(block, there, here, strict=True)
        block = np.stack([table.placed(pose, wanted, at) for pose, wanted, at in both])
    wire = mix(np.concatenate(rows.wire))
    shown = np.asarray(np.isfinite(wire).all(axis=(1, 2)), dtype=np.bool_)
    sweeps = _sweeps(problem, plan, q, segments, operation, wire, block, stands)
    edges = [op.targets.edge for op in plan.operations if op.targets.edge is not None]
    base = (pick, q, segments, setup, block)
    more = (operation, tuple(rows.starts))
    if not edges or not shown.any():
        none = np.zeros(len(pick), dtype=bool)
        return Track(*base, None, none, 0.0, tuple(rows.stops), sweeps, stands, rows.travel, *more)
    # A hidden wire waits where it is next or was last seen, so that nothing flies in from afar.
    seen = np.flatnonzero(shown)
    wire = wire[seen[np.clip(np.searchsorted(seen, np.arange(len(pick))), 0, len(seen) - 1)]]
    stops = tuple(rows.stops)
    return Track(*base, wire, shown, edges[0].radius, stops, sweeps, stands, rows.travel, *more)


def _sweeps(
    problem: Problem,
    plan: Plan,
    q: Mapping[str, FloatArray],
    segments: tuple[Segment, ...],
    operation: IntArray,
    wire: FloatArray,
    block: FloatArray,
    stands: Mapping[str, FloatArray],
) -> tuple[Sweep, ...]:
    """For each operation and each run of keyframes that cut, with the keyframe before it."""
    cutting = np.array([segment.kind == "cut" for segment in segments])
    out = []
    for index, made in enumerate(plan.operations):
        own = np.flatnonzero(cutting & (operation == index))
        for run in np.split(own, np.flatnonzero(np.diff(own) > 1) + 1):
            if not len(run):
                continue
            keys = np.concatenate([[max(run[0] - 1, 0)], run]) if run[0] > 0 else run
            setup = problem.setup_of(index)
            arm = cutter(setup, made.targets.arms)
            if made.targets.edge is not None:
                to_block = inverse(block[keys])
                points = wire[keys] @ np.swapaxes(to_block[:, :3, :3], 1, 2) + to_block[:, None, :3, 3]
            elif arm is not None:
                joints = {name: values[keys] for name, values in q.items()}
                place = plan.places[setup.number - 1]
                own_bases = {
                    name: ridden_base(setup.cell.arm(name), stands[name][keys]) for name in made.targets.ride
                }
                points = wire_in_block(setup, arm, place, {**plan.bases, **own_bases}, joints)
            else:
                continue
            out.append(Sweep(setup.number - 1, keys, points))
    return tuple(out)
