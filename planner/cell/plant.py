"""Drake diagram of a cell: robots, tools, stock, support, obstacles, and the pairs that are checked.

A process can keep its models from one problem to the next while cell and stock stay the same. Caching is
opt-in: run each job inside :meth:`ModelCache.job`, as worker processes do. Within a job nothing is shared:
planner, proof and report have separate models. The next job finds each as the previous one left it.
"""

import contextlib
import dataclasses
import functools
import hashlib
import logging
import weakref
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextvars import ContextVar
from typing import Any, Final, Generic, TypeVar

import numpy as np
from pydrake.geometry import MeshcatVisualizer, MeshcatVisualizerParams
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import (
    BodyIndex,
    FixedOffsetFrame,
    JacobianWrtVariable,
    RevoluteJoint,
    RigidBody,
    SpatialInertia,
)
from pydrake.planning import RobotDiagramBuilder, SceneGraphCollisionChecker

from planner.catalogue import robots as catalogue
from planner.catalogue.robots import RobotData, RobotFile
from planner.cell import support
from planner.cell.bodies import (
    NO_EASING,
    ClearanceEasing,
    FilteredPair,
    Solid,
    body_poses,
    collect_solids,
    drake_shape,
    filter_pairs,
    link_chain,
    shapes_by_body,
)
from planner.cell.bounds import ClearanceBounds, SolidPair, make_bounds
from planner.cell.kinematics import forward_kinematics
from planner.geometry.arrays import FloatArray, IndexArray, Shape, inverse
from planner.issue_codes import format_message
from planner.issues import Issue, TandemError
from planner.problem import Arm, Cell, Stock
from planner.tooling import working_solid

Model = TypeVar("Model")
MAX_MODELS: Final = 8
"""Maximum number of cell models that are kept, the most recently used ones."""


class ModelCache(Generic[Model]):
    """Cache of models by the content that they were built from.

    Args:
        count: Maximum number of models.

    Attributes:
        reused: Number of models that were reused so far.
    """

    def __init__(self, count: int = MAX_MODELS) -> None:
        self._count = count
        self._models: OrderedDict[tuple[str, int], Model] = OrderedDict()
        self._requested: dict[str, int] = {}
        self.reused = 0

    @contextlib.contextmanager
    def job(self) -> Iterator[None]:
        """Return a context in which :func:`cached_model` uses this cache, for one job.

        At the beginning of a job all models are available again. Within a job each model is returned only
        once, so that planner, proof and report share none.
        """
        self._requested.clear()
        token = _JOB_MODELS.set(self)
        try:
            yield
        finally:
            _JOB_MODELS.reset(token)

    def get(self, content: object, make: Callable[[], Model]) -> Model:
        """Return a model of the given content that this job does not have yet: a kept one, or a new one.

        Args:
            content: Content that the model is built from.
            make: Builds the model.
        """
        key = content_digest(content)
        number = self._requested.get(key, 0)
        self._requested[key] = number + 1
        model = self._models.pop((key, number), None)
        self.reused += model is not None
        if model is None:
            model = make()
        self._models[(key, number)] = model
        while len(self._models) > self._count:
            self._models.popitem(last=False)
        return model


_JOB_MODELS: Final[ContextVar[ModelCache[Any] | None]] = ContextVar("job_models", default=None)
"""Cache of the job that runs in this context."""


def cached_model(content: object, make: Callable[[], Model]) -> Model:
    """Return a model of ``content``: from the cache of the job that runs, or a new one outside jobs."""
    models = _JOB_MODELS.get()
    if models is None:
        return make()
    model: Model = models.get(content, make)
    return model


def content_digest(value: object) -> str:
    """Return the SHA-256 of plain values, arrays and dataclasses of them.

    Raises:
        TypeError: For any other value.
    """
    state = hashlib.sha256()
    _feed(state, value)
    return state.hexdigest()


def _feed(state: Any, value: object) -> None:
    """Add a value to a hash, for :func:`content_digest`.

    Types and sizes are added too, because different values may have the same text.

    Raises:
        TypeError: For a value that is not plain.
    """
    if value is None or isinstance(value, str | int | float | bool):
        state.update(f"{type(value).__name__} {value!r}\n".encode())
    elif isinstance(value, np.ndarray | np.generic):
        array = np.ascontiguousarray(value)
        state.update(f"array {array.dtype.str} {array.shape}\n".encode())
        state.update(array.tobytes())
    elif dataclasses.is_dataclass(value):
        state.update(f"{type(value).__name__} (\n".encode())
        for field in dataclasses.fields(value):
            state.update(f"{field.name}: ".encode())
            _feed(state, getattr(value, field.name))
        state.update(b")\n")
    elif isinstance(value, Mapping):
        state.update(f"mapping {len(value)}\n".encode())
        for key, item in value.items():
            _feed(state, key)
            _feed(state, item)
    elif isinstance(value, list | tuple):
        state.update(f"{type(value).__name__} {len(value)}\n".encode())
        for item in value:
            _feed(state, item)
    else:
        raise TypeError(f"a {type(value).__name__} has no digest; use plain values, arrays and dataclasses")


ALWAYS_NEAR_REASON: Final = "of one arm and always near each other"
"""Reason why pairs of solids that :meth:`ClearanceBounds.always_near_pairs` returns are not checked."""
RANDOM_POSTURES: Final = 200
"""Number of random postures, from a fixed seed, that find solids of one arm that are always close."""

STOCK_COLOUR = np.array([0.93, 0.95, 0.90, 0.55])
"""Colours of stock, support, obstacles, tools, robots from files and edges.

Red, green, blue and opacity, each from 0 to 1.
"""
SUPPORT_COLOUR = np.array([0.45, 0.47, 0.50, 1.0])
OBSTACLE_COLOUR = np.array([0.60, 0.62, 0.66, 1.0])
TOOL_COLOUR = np.array([0.20, 0.30, 0.42, 1.0])
ROBOT_COLOUR = np.array([0.90, 0.45, 0.10, 1.0])
EDGE_COLOUR = np.array([0.85, 0.30, 0.10, 1.0])


@dataclasses.dataclass
class _SharedModel:
    """State that all placements of one cell share.

    Attributes:
        mounts: Frames in the world, by arm, "stock" or axis, whose poses depend on the placement.
        names: Names of bodies by Drake's index.
        filtered: Pairs of bodies of which no or not all solids are checked, with reasons.
        checked_parts: Pairs of bodies of which only some solids are checked, with these pairs of solids.
        current_placement: The model to whose placement the contexts of the checker are set.
        models_by_height: Models of the same cell with pedestals of other heights.
        eased_bounds: Bounds by easing.
    """

    plant: MultibodyPlant
    diagram: Any
    checker: SceneGraphCollisionChecker
    mounts: Mapping[str, FixedOffsetFrame]
    names: Mapping[int, str]
    filtered: tuple[FilteredPair, ...]
    solids: tuple[Solid, ...]
    bounds: ClearanceBounds
    checked_parts: dict[frozenset[str], tuple[SolidPair, ...]] = dataclasses.field(default_factory=dict)
    current_placement: object | None = None
    models_by_height: "dict[float, CellModel]" = dataclasses.field(default_factory=dict)
    eased_bounds: dict[ClearanceEasing, ClearanceBounds] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True, eq=False)
class CellModel:
    """A cell in Drake, with the stock and the bases at one placement.

    Models made by :meth:`with_stock` and :meth:`with_bases` share one diagram. Its contexts are set to a
    model's placement when that model is used. A model must therefore not be used by several threads at once.

    q is the concatenation of the serial joint angles [rad] of all arms, in the order of ``cell.arms``. Bodies
    are named "<arm>/base_link", "<arm>/link_1" ... "<arm>/link_J", "<arm>/tool", "<arm>/edge" (a tool's own
    edge, if it has one), "stock", "support", "<obstacle>".

    A base on a coordinated track may differ from configuration to configuration (row). It is (B, 4, 4) in
    ``bases`` then, and :meth:`at_rows` gives the model of some rows. Drake is called row by row.

    Attributes:
        cell: The cell.
        stock: The stock. A held stock moves with its holder.
        stock_pose: Pose of the stock in the world (4, 4). It is only stored if the stock is held.
        bases: Pose of each base (4, 4).
        robots: Robot data by arm.
        easing: Pairs of bodies that count as farther apart in all distances. None unless :meth:`with_easing`
            sets them.
        axis_motions: Motion of what is mounted on axes, from where the cell has it (4, 4), by name as in
            :attr:`planner.problem.Cell.carried_bodies`.
    """

    cell: Cell
    stock: Stock
    stock_pose: FloatArray
    bases: Mapping[str, FloatArray]
    robots: Mapping[str, RobotData]
    _shared: _SharedModel
    easing: ClearanceEasing = NO_EASING
    axis_motions: Mapping[str, FloatArray] = dataclasses.field(default_factory=dict)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle for another process, which builds the model again. Drake objects are not transferred."""
        return _rebuild, (
            self.cell,
            self.stock,
            self.stock_pose,
            dict(self.bases),
            self.easing,
            dict(self.axis_motions),
        )

    @property
    def arms(self) -> tuple[str, ...]:
        """Names of the arms, in the order of q."""
        return tuple(arm.name for arm in self.cell.arms)

    @functools.cached_property
    def columns(self) -> dict[str, slice]:
        """Columns of each arm's joints in q."""
        return catalogue.joint_columns(self.robots)

    def split_by_arm(self, rows: FloatArray) -> dict[str, FloatArray]:
        """Return joints by arm (B, J) of configurations (B, nq)."""
        return {arm: rows[:, part] for arm, part in self.columns.items()}

    @property
    def diagram(self) -> Any:
        """The Drake ``RobotDiagram``. Its default context has the placement that it was built with."""
        return self._shared.diagram

    @property
    def plant(self) -> MultibodyPlant:
        """The Drake plant."""
        return self._shared.plant

    @property
    def checker(self) -> SceneGraphCollisionChecker:
        """The collision checker, with its contexts set to this placement.

        Pass ``parallelize=False`` to its batches.
        """
        self.apply_placement()
        return self._shared.checker

    @property
    def filtered_pairs(self) -> tuple[FilteredPair, ...]:
        """Pairs of bodies of which no or not all solids are checked, each with the reason."""
        return self._shared.filtered

    @property
    def partially_checked(self) -> Mapping[frozenset[str], tuple[SolidPair, ...]]:
        """Pairs of bodies of which some solids are always close, with the pairs of solids that are checked.

        Solids are indices in ``bounds.all_solids``.
        """
        return self._shared.checked_parts

    @property
    def solids(self) -> tuple[Solid, ...]:
        """Collision solids of all bodies."""
        return self._shared.solids

    @property
    def bounds(self) -> ClearanceBounds:
        """Capsules and boxes that bound the smallest distance."""
        if not self.easing.by:
            return self._shared.bounds
        eased_bounds = self._shared.eased_bounds
        if self.easing not in eased_bounds:
            eased_bounds[self.easing] = self._shared.bounds.with_easing(self.easing)
        return eased_bounds[self.easing]

    @property
    def home(self) -> FloatArray:
        """Configuration with all arms at home (nq,)."""
        return np.concatenate([arm.home for arm in self.cell.arms])

    def body_name(self, index: int) -> str:
        """Return the name of the Drake body with an index."""
        return self._shared.names[index]

    def body(self, name: str) -> RigidBody:
        """Return the Drake body of a name.

        Raises:
            KeyError: If there is none.
        """
        for index, body_name in self._shared.names.items():
            if body_name == name:
                return self.plant.get_body(BodyIndex(index))
        raise KeyError(name)

    def geometry(self, solid: int) -> Any:
        """Return Drake's geometry id of a solid, given its index in ``bounds.all_solids``."""
        selected = self.bounds.all_solids[solid]
        body_solids = [candidate for candidate in self.solids if candidate.body == selected.body]
        index = next(k for k, candidate in enumerate(body_solids) if candidate is selected)
        return self.plant.GetCollisionGeometriesForBody(self.body(selected.body))[index]

    def carrier(self, body: str) -> str | None:
        """Return the arm that a body belongs to or is held by, None for bodies of no arm."""
        owner = self.stock.held_by if body == "stock" else body.partition("/")[0]
        return owner if owner in self.arms else None

    def joints_of(self, arm: str, body: str) -> int:
        """Return how many joints of an arm move a body, counted from the base.

        0 for bodies that do not belong to it, all for its tool and what it holds.
        """
        link = body.partition("/")[2]
        if self.carrier(body) != arm or link == "base_link":
            return 0
        return int(link.removeprefix("link_")) if link.startswith("link_") else self.robots[arm].axes

    def stack_rows(self, q: Mapping[str, FloatArray]) -> FloatArray:
        """Return configurations (B, nq) from joints by arm (B, J). Other arms stay at home.

        Raises:
            ValueError: For unknown arms or different numbers of rows.
        """
        count = {len(np.atleast_2d(rows)) for rows in q.values()}
        if len(count) > 1 or set(q) - set(self.arms):
            raise ValueError(f"q has arms {sorted(q)} with {sorted(count)} rows; the cell has {self.arms}")
        rows = count.pop() if count else 1
        columns = [
            np.broadcast_to(np.atleast_2d(q.get(a.name, a.home)), (rows, len(a.home))) for a in self.cell.arms
        ]
        return np.concatenate(columns, axis=1)

    def tcp(self, q: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        """Return TCP poses in the world by arm (B, 4, 4), for joints by arm (B, J) [rad]."""
        return {
            arm: self.bases[arm] @ forward_kinematics(self.robots[arm], rows) @ self.cell.arm(arm).tool.tcp
            for arm, rows in q.items()
        }

    def jacobians(self, q: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        """Return Jacobians of the TCPs in the world by arm (B, 6, J), for joints by arm (B, J).

        Rows are angular [-], then linear [m/rad]. They come from Drake's plant, while :meth:`poses` is closed
        form.
        """
        world, rows = self.plant.world_frame(), self.stack_rows(q)
        ends = {arm: self._flange(arm) for arm in q}
        out = {arm: np.empty((len(rows), 6, self.robots[arm].axes)) for arm in q}
        checker = self.at_rows(0).checker  # the position of a base does not change Jacobians in world axes
        for i, row in enumerate(rows):
            context = checker.UpdatePositions(row)
            for arm, (frame, tcp_position, columns) in ends.items():
                out[arm][i] = self.plant.CalcJacobianSpatialVelocity(
                    context, JacobianWrtVariable.kQDot, frame, tcp_position, world, world
                )[:, columns]
        return out

    def _flange(self, arm: str) -> tuple[Any, FloatArray, slice]:
        """Return Drake's frame of an arm's flange, the TCP (3,) [m] in it, and the arm's columns."""
        flange = self.plant.GetFrameByName("tool0", self.body(f"{arm}/link_1").model_instance())
        return flange, self.cell.arm(arm).tool.tcp[:3, 3], self.columns[arm]

    def poses(self, q: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        """Return world poses of all bodies by name.

        (B, 4, 4) for moving bodies of named arms, (1, 4, 4) for all others.
        """
        out = {obstacle.name: np.eye(4)[None] for obstacle in self.cell.obstacles}
        bodies_by_axis = self.cell.carried_bodies.items()
        out.update((body, self.axis_motion(name)[None]) for name, bodies in bodies_by_axis for body in bodies)
        out["stock"] = out["support"] = self.stock_pose[None]
        for arm in self.cell.arms:
            rows = np.atleast_2d(q.get(arm.name, arm.home))
            out.update(body_poses(arm.name, self.robots[arm.name], self.bases[arm.name], rows))
            if working_solid(arm.tool) is not None:
                out[f"{arm.name}/edge"] = out[f"{arm.name}/tool"]
        if self.stock.held_by is not None:
            stock_in_flange = self.cell.arm(self.stock.held_by).tool.tcp @ self.stock.grip
            out["stock"] = out[f"{self.stock.held_by}/tool"] @ stock_in_flange
        return out

    def with_stock(self, pose: FloatArray) -> "CellModel":
        """Return the same cell with the stock and its support at another pose (4, 4) in the world.

        Nothing is rebuilt except a pedestal of another height. A held stock stays in its holder's tool.
        """
        pose = np.array(pose, dtype=np.float64)
        if self.stock.pedestal is None or self.stock.held_by is not None:
            return dataclasses.replace(self, stock_pose=pose)
        models = self._shared.models_by_height  # one model for each height of the pedestal
        models.setdefault(_pose_height(self.stock_pose), self)
        if _pose_height(pose) not in models:
            new_model = build_cell_model(self.cell, self.stock, pose, self.bases)
            new_model._shared.models_by_height = models
            models[_pose_height(pose)] = new_model
        model = models[_pose_height(pose)]
        return dataclasses.replace(model, stock_pose=pose, bases=self.bases, easing=self.easing)

    def with_bases(self, bases: Mapping[str, FloatArray]) -> "CellModel":
        """Return the same cell with bases by arm at other poses (4, 4) in the world. Nothing is rebuilt."""
        return dataclasses.replace(self, bases={**self.bases, **bases})

    @property
    def has_moving_base(self) -> bool:
        """Whether a base differs from row to row."""
        return any(base.ndim > 2 for base in self.bases.values())

    def at_rows(self, rows: IndexArray | int) -> "CellModel":
        """Return the model of some rows (K,) or of one row, with bases as in these rows.

        Returns itself if all bases are constant.
        """
        if not self.has_moving_base:
            return self
        row_bases = {arm: base[rows] if base.ndim > 2 else base for arm, base in self.bases.items()}
        return dataclasses.replace(self, bases=row_bases)

    def axis_motion(self, name: str) -> FloatArray:
        """Return the motion (4, 4) of what is mounted on an axis, by the axis' name.

        It counts from where the cell has the bodies.
        """
        return self.axis_motions.get(name, np.eye(4))

    def with_axis_motions(self, motions: Mapping[str, FloatArray]) -> "CellModel":
        """Return the same cell with what is mounted on axes moved by motions (4, 4), by axis.

        Motions count from where the cell has the bodies. Nothing is rebuilt.
        """
        return dataclasses.replace(self, axis_motions={**self.axis_motions, **motions})

    def with_easing(self, easing: ClearanceEasing) -> "CellModel":
        """Return the same cell, in which pairs of bodies count as farther apart than they are."""
        return dataclasses.replace(self, easing=easing)

    def apply_placement(self) -> None:
        """Set the checker's contexts to this placement, unless they are already.

        Models of one cell share these contexts, so each model sets them before it uses Drake.
        """
        if self._shared.current_placement is self:
            return

        def set_context(_model: object, context: Any) -> None:
            plant_context = context.plant_context()
            for name, frame in self._shared.mounts.items():
                poses = {"stock": self.stock_pose, **self.bases}
                axis_name = name.removesuffix(_ON_AXIS)
                pose = poses[name] if name in poses else self.axis_motion(axis_name)
                frame.SetPoseInParentFrame(plant_context, rigid_transform(pose))

        self._shared.checker.PerformOperationAgainstAllModelContexts(set_context)
        self._shared.current_placement = self


def build_cell_model(
    cell: Cell,
    stock: Stock,
    stock_pose: FloatArray,
    bases: Mapping[str, FloatArray] | None = None,
    meshcat: Any = None,
) -> CellModel:
    """Build the model of a cell, or reuse one that an earlier job built (:class:`ModelCache`).

    A held stock is fixed to its holder's tool.

    Args:
        cell: The cell.
        stock: The stock.
        stock_pose: Pose of the stock in the world (4, 4).
        bases: Poses of bases by arm (4, 4), by default those of the cell.
        meshcat: If given, a visualizer of the visible shapes is part of the diagram.

    Raises:
        TandemError: For an unknown robot, and for clashing names of bodies (``cell.body_name``).
        KeyError: For an unknown holder.
        ValueError: For a held stock on a support.
    """
    if meshcat is not None:
        return _build_new(cell, stock, stock_pose, bases, meshcat)
    content = (cell, stock, np.asarray(stock_pose, dtype=np.float64), bases)
    return cached_model(content, lambda: _build_new(cell, stock, stock_pose, bases, meshcat=None))


def _rebuild(
    cell: Cell,
    stock: Stock,
    stock_pose: FloatArray,
    bases: Mapping[str, FloatArray],
    easing: ClearanceEasing,
    axis_motions: Mapping[str, FloatArray],
) -> CellModel:
    """Build a model in another process, from what :meth:`CellModel.__reduce__` transfers to it."""
    model = build_cell_model(cell, stock, stock_pose, bases)
    return model.with_easing(easing).with_axis_motions(axis_motions)


def _build_new(
    cell: Cell, stock: Stock, stock_pose: FloatArray, bases: Mapping[str, FloatArray] | None, meshcat: Any
) -> CellModel:
    """Build the Drake diagram and the model of a cell, with the arguments of :func:`build_cell_model`.

    A table or pedestal is made for the stock if the problem asks for one. Pairs of bodies that are always
    close are removed from the checks.
    """
    _check_names(cell)
    stock = support.with_support(cell, stock, np.asarray(stock_pose))
    if stock.held_by is not None and stock.support:
        raise ValueError("a held stock has no support")
    base_poses = {arm.name: np.asarray((bases or {}).get(arm.name, arm.base)) for arm in cell.arms}
    robots = {arm.name: arm.data for arm in cell.arms}
    builder = RobotDiagramBuilder(time_step=0.0)
    plant = builder.plant()
    mounts: dict[str, FixedOffsetFrame] = {}
    shapes = shapes_by_body(cell, stock)
    instances = []
    flanges: dict[str, tuple[Any, Any]] = {}
    # Bodies are fixed to mounts, frames in the world whose poses can change without building the model again.
    for arm in cell.arms:
        file = robots[arm.name].file
        if file is None:
            instance = _add_catalogue_robot(plant, builder.scene_graph(), arm)
        else:
            instance = _add_user_robot(plant, arm.name, robots[arm.name], file)
        instances.append(instance)
        mounts[arm.name] = _add_mount(plant, f"{arm.name}/mount", base_poses[arm.name])
        plant.WeldFrames(mounts[arm.name], plant.GetFrameByName("base_link", instance))
        flanges[arm.name] = instance, plant.GetFrameByName("tool0", instance)
        for body, colour in ((f"{arm.name}/tool", TOOL_COLOUR), (f"{arm.name}/edge", EDGE_COLOUR)):
            if body in shapes:
                _add_flange_body(plant, body, flanges[arm.name], np.eye(4), shapes[body], colour)
    if stock.held_by is not None:
        stock_in_flange = cell.arm(stock.held_by).tool.tcp @ stock.grip
        _add_flange_body(
            plant, "stock", flanges[stock.held_by], stock_in_flange, shapes["stock"], STOCK_COLOUR
        )
    else:
        mounts["stock"] = _add_mount(plant, "stock/mount", np.asarray(stock_pose))
        _add_fixed_body(plant, "stock", mounts["stock"], shapes["stock"], STOCK_COLOUR)
    if stock.support:
        _add_fixed_body(plant, "support", mounts["stock"], shapes["support"], SUPPORT_COLOUR)
    mount_by_body: dict[str, str] = {}
    for axis, bodies in cell.carried_bodies.items():
        mounts[f"{axis}{_ON_AXIS}"] = _add_mount(plant, f"{axis}{_ON_AXIS}", np.eye(4))
        mount_by_body |= dict.fromkeys(bodies, f"{axis}{_ON_AXIS}")
    for obstacle in cell.obstacles:
        mount = (
            mounts[mount_by_body[obstacle.name]] if obstacle.name in mount_by_body else plant.world_frame()
        )
        _add_fixed_body(plant, obstacle.name, mount, obstacle.shapes, OBSTACLE_COLOUR)
    plant.Finalize()
    if meshcat is not None:
        parameters = MeshcatVisualizerParams()
        MeshcatVisualizer.AddToBuilder(builder.builder(), builder.scene_graph(), meshcat, parameters)
    names = _body_names(plant, cell, instances)
    with drake_log_suppressed():
        checker = SceneGraphCollisionChecker(
            model=builder.Build(), robot_model_instances=instances, edge_step_size=0.05
        )
    filtered = filter_pairs(checker, names, stock.held_by)
    inspector = checker.model().scene_graph().model_inspector()
    solids = collect_solids(plant, inspector, names, shapes)
    moving_bases = {f"{arm.name}/base_link" for arm in cell.arms if arm.has_coordinated_track}
    bounds = make_bounds(solids, filtered, stock.held_by, moving_bases)
    shared = _SharedModel(plant, checker.model(), checker, mounts, names, filtered, solids, bounds)
    model = CellModel(cell, stock, np.asarray(stock_pose, dtype=np.float64), base_poses, robots, shared)
    _filter_always_near(model)
    return model


_NamedSolidPair = tuple[tuple[str, int], tuple[str, int]]
"""Two solids, each by its body and its index among those of that body."""
MAX_ALWAYS_NEAR_RESULTS: Final = 64
"""Maximum number of sets of arms whose always close pairs are kept in memory."""


@dataclasses.dataclass(frozen=True)
class _ArmsOfModel:
    """Arms with tools, as a key: models with the same arms are equal, whatever cell they are in.

    Attributes:
        digest: Digest of the arms, their tools and the arm that holds the stock.
        model: A model with these arms. The reference is weak, so that a kept key does not keep the model.
    """

    digest: str
    model: "weakref.ReferenceType[CellModel]" = dataclasses.field(compare=False)


def _always_near_pairs(model: CellModel) -> tuple[Sequence[SolidPair], Sequence[SolidPair]]:
    """Return the pairs of solids of one arm that the arm's build keeps close to each other.

    They depend only on the arms and their tools, so they are computed once for all models with the same arms.
    Bases are at the origin meanwhile, so that rounding is the same too.

    Returns:
        Pairs of :meth:`ClearanceBounds.flange_part_pairs`, and other pairs of
        :meth:`ClearanceBounds.always_near_pairs` in :data:`RANDOM_POSTURES` random postures.
    """
    arms = [
        (a.name, a.robot, a.custom_data, a.tool, a.home, a.has_coordinated_track) for a in model.cell.arms
    ]
    named_pairs = _named_always_near_pairs(
        _ArmsOfModel(content_digest((arms, model.stock.held_by)), weakref.ref(model))
    )
    index = {name: k for k, name in enumerate(_solid_names(model.bounds.all_solids))}
    flange_pairs, near_pairs = (
        tuple(sorted((min(index[a], index[b]), max(index[a], index[b])) for a, b in pairs))
        for pairs in named_pairs
    )
    return flange_pairs, near_pairs


@functools.lru_cache(maxsize=MAX_ALWAYS_NEAR_RESULTS)
def _named_always_near_pairs(
    arms: _ArmsOfModel,
) -> tuple[Sequence[_NamedSolidPair], Sequence[_NamedSolidPair]]:
    """Return both kinds of pairs of :func:`_always_near_pairs`, with solids named by their bodies.

    The names hold for all cells and placements with the same arms and tools.

    Raises:
        ReferenceError: The model of the key no longer exists.
    """
    model = arms.model()
    if model is None:
        raise ReferenceError("the model of a new key exists while its pairs are computed")
    names = _solid_names(model.bounds.all_solids)
    flange_pairs, near_pairs = _find_always_near(
        dataclasses.replace(model, bases={arm: np.eye(4) for arm in model.arms})
    )
    return [(names[a], names[b]) for a, b in flange_pairs], [(names[a], names[b]) for a, b in near_pairs]


def _solid_names(solids: Sequence[Solid]) -> list[tuple[str, int]]:
    """Return the body of each solid and its index among the solids of that body."""
    count: dict[str, int] = {}
    out = []
    for solid in solids:
        out.append((solid.body, count.get(solid.body, 0)))
        count[solid.body] = out[-1][1] + 1
    return out


def _find_always_near(model: CellModel) -> tuple[Sequence[SolidPair], Sequence[SolidPair]]:
    """Compute both kinds of pairs of :func:`_always_near_pairs` for one model."""
    bounds = model._shared.bounds
    flange_pairs = bounds.flange_part_pairs(model.poses({}))
    lower = np.concatenate([model.robots[arm].lower for arm in model.arms])
    upper = np.concatenate([model.robots[arm].upper for arm in model.arms])
    q = np.random.default_rng(20).uniform(lower, upper, size=(RANDOM_POSTURES, len(lower)))
    postures = model.poses(model.split_by_arm(q))
    return flange_pairs, bounds.without_pairs(flange_pairs).always_near_pairs(postures)


def _filter_always_near(model: CellModel) -> None:
    """Remove the pairs of solids of :func:`_always_near_pairs` from the checks, and note the reasons.

    If these are all pairs of two bodies, the pair of bodies is removed from Drake's checker too. Otherwise
    the remaining pairs are noted as those that are checked.
    """
    shared, all_bounds = model._shared, model._shared.bounds
    flange_pairs, near_pairs = _always_near_pairs(model)
    shared.bounds = all_bounds.without_pairs({*flange_pairs, *near_pairs})
    reasons: dict[tuple[str, str], list[str]] = {}
    for reason, solid_pairs in (
        ("parts flat on the flange are kept apart by its build", flange_pairs),
        (ALWAYS_NEAR_REASON, near_pairs),
    ):
        for a, b in solid_pairs:
            first, second = sorted((all_bounds.all_solids[a].body, all_bounds.all_solids[b].body))
            reasons.setdefault((first, second), [])
            if reason not in reasons[first, second]:
                reasons[first, second].append(reason)
    filtered = list(shared.filtered)
    for (first, second), reasons_of_pair in sorted(reasons.items()):
        remaining = shared.bounds.pairs_of_bodies(first, second)
        count = len(all_bounds.pairs_of_bodies(first, second))
        if not remaining:
            first_index, second_index = (model.body(name).index() for name in (first, second))
            shared.checker.SetCollisionFilteredBetween(first_index, second_index, True)
            filtered.append((first, second, ", ".join(reasons_of_pair)))
            continue
        shared.checked_parts[frozenset((first, second))] = remaining
        count_text = f"{count - len(remaining)} of {count} pairs of their solids"
        filtered.append(
            (first, second, f"{count_text}: {', '.join(reasons_of_pair)}; the others are checked")
        )
    shared.filtered = tuple(sorted(filtered))


def _add_catalogue_robot(plant: MultibodyPlant, scene_graph: Any, arm: Arm) -> Any:
    """Add a robot of the catalogue with Drake's URDF parser, and return its model instance.

    Raises:
        TandemError: The URDF file is damaged.
    """
    path = catalogue.urdf_path(arm.robot)
    try:
        parser = Parser(plant=plant, scene_graph=scene_graph, model_name_prefix=arm.name)
        (instance,) = parser.AddModels(str(path))
    except RuntimeError as error:
        raise catalogue.damaged_file_error(path, str(error)) from None
    return instance


def _add_user_robot(plant: MultibodyPlant, name: str, robot: RobotData, file: RobotFile) -> Any:
    """Add a robot from a user's file with its collision shapes, and return its model instance.

    Link frames are those of the user's URDF file. Links are named as in the catalogue.
    """
    instance = plant.AddModelInstance(name)
    bodies = [
        plant.AddRigidBody(link, instance, SpatialInertia.Zero()) for link in link_chain(robot.axes)[:-1]
    ]
    steps = inverse(file.zero[:-1]) @ file.zero[1:]
    for i in range(robot.axes):
        parent = bodies[i].body_frame()
        hinge = plant.AddFrame(
            FixedOffsetFrame(f"hinge_{i + 1}", parent, rigid_transform(steps[i]), instance)
        )
        axis = file.zero[i + 1, :3, :3].T @ file.axis[i]
        low, high = float(robot.lower[i]), float(robot.upper[i])
        plant.AddJoint(RevoluteJoint(f"joint_{i + 1}", hinge, bodies[i + 1].body_frame(), axis, low, high))
    plant.AddFrame(FixedOffsetFrame("tool0", bodies[-1].body_frame(), rigid_transform(steps[-1]), instance))
    for body, shapes in zip(bodies, file.shapes, strict=True):
        _add_shapes(plant, body, shapes, ROBOT_COLOUR)
    return instance


@contextlib.contextmanager
def drake_log_suppressed() -> Iterator[None]:
    """Suppress Drake's log messages below warnings, on contexts of checkers and on ports."""
    logger = logging.getLogger("drake")
    level = logger.level
    logger.setLevel(max(level, logging.WARNING))
    try:
        yield
    finally:
        logger.setLevel(level)


def rigid_transform(pose: FloatArray) -> RigidTransform:
    """Return Drake's transform of a pose (4, 4), with the nearest rotation matrix."""
    return RigidTransform(RotationMatrix.ProjectToRotationMatrix(pose[:3, :3]), pose[:3, 3])


def _check_names(cell: Cell) -> None:
    """Require that names of arms and obstacles are unique, not reserved, and without a slash.

    Raises:
        TandemError: ``cell.body_name``.
    """
    taken = ["stock", "support", "world"]
    issues = []
    bodies = [("arm", f"cell.arms.{i}.name", arm.name) for i, arm in enumerate(cell.arms)]
    bodies += [("obstacle", f"cell.obstacles.{i}.name", body.name) for i, body in enumerate(cell.obstacles)]
    for kind, field, name in bodies:
        if name in taken or "/" in name:
            message = format_message("cell.body_name", kind=kind, name=name)
            issues.append(Issue("cell.body_name", message, field=field, hint="use another name"))
        taken.append(name)
    if issues:
        raise TandemError(issues)


def _add_mount(plant: MultibodyPlant, name: str, pose: FloatArray) -> FixedOffsetFrame:
    """Add a frame at a pose (4, 4) in the world, which can change later."""
    return plant.AddFrame(FixedOffsetFrame(name, plant.world_frame(), rigid_transform(pose)))


_ON_AXIS: Final = "/on"
"""Suffix of an axis' name for its frame in the world, to which the bodies on it are fixed."""


def _add_fixed_body(
    plant: MultibodyPlant, name: str, mount: Any, shapes: tuple[Shape, ...], colour: FloatArray
) -> None:
    """Add a body with shapes that is fixed to a mount, such as the stock or an obstacle."""
    body = plant.AddRigidBody(name, plant.AddModelInstance(name), SpatialInertia.Zero())
    plant.WeldFrames(mount, body.body_frame())
    _add_shapes(plant, body, shapes, colour)


def _add_flange_body(
    plant: MultibodyPlant,
    name: str,
    flange: tuple[Any, Any],
    pose: FloatArray,
    shapes: tuple[Shape, ...],
    colour: FloatArray,
) -> None:
    """Add a body that is fixed to a robot's flange: a tool, its edge or a held stock.

    Args:
        plant: Drake's plant.
        name: Name of the body.
        flange: Model instance of the robot, and its frame ``tool0``.
        pose: (4, 4) pose of the body in that frame.
        shapes: Shapes in the frame of the body.
        colour: Red, green, blue and opacity.
    """
    instance, frame = flange
    body = plant.AddRigidBody(name, instance, SpatialInertia.Zero())
    plant.WeldFrames(frame, body.body_frame(), rigid_transform(pose))
    _add_shapes(plant, body, shapes, colour)


def _add_shapes(
    plant: MultibodyPlant, body: RigidBody, shapes: tuple[Shape, ...], colour: FloatArray
) -> None:
    """Add shapes to a body, for display in a colour and for collision checks. Meshes collide as hulls."""
    for i, shape in enumerate(shapes):
        pose, name = rigid_transform(shape.pose), f"{body.name()}_{i}"
        plant.RegisterVisualGeometry(body, pose, drake_shape(shape, solid=False), name, colour)
        plant.RegisterCollisionGeometry(
            body, pose, drake_shape(shape, solid=True), name, CoulombFriction(0.5, 0.5)
        )


def _body_names(plant: MultibodyPlant, cell: Cell, instances: list[Any]) -> dict[int, str]:
    """Return the names of all bodies, as in :class:`CellModel`, by Drake's index.

    ``instances`` are the model instances of the arms.
    """
    names = {0: "world"}
    for arm, instance in zip(cell.arms, instances, strict=True):
        for index in plant.GetBodyIndices(instance):
            name = plant.get_body(index).name()
            names[int(index)] = name if name.startswith(f"{arm.name}/") else f"{arm.name}/{name}"
    for body in ["stock", "support", *(obstacle.name for obstacle in cell.obstacles)]:
        if plant.HasBodyNamed(body):
            names[int(plant.GetBodyByName(body).index())] = body
    return names


def _pose_height(pose: FloatArray) -> float:
    """Return the height of a stock pose, rounded to 0.1 um, as the key of a model with its pedestal."""
    return round(float(pose[2, 3]), 7)
