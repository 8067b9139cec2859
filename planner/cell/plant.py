"""One Drake diagram of a cell: robots, tools, stock, support, obstacles, and which pairs keep apart.

A process can keep its models from one problem to the next, while cell and stock stay the same. Off
unless :func:`keep_models` is called, as worker processes do. Within a job nothing is shared:
planner, proof and report have models of their own, as ever; the next job finds each where the last
one left it.
"""

import contextlib
import dataclasses
import functools
import hashlib
import logging
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
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
    NOT_EASED,
    Easing,
    FilteredPair,
    Solid,
    body_poses,
    collect,
    drake_shape,
    filter_pairs,
    link_chain,
    own_shapes,
)
from planner.cell.bounds import Bounds, SolidPair, prepare
from planner.cell.kinematics import forward
from planner.geometry.arrays import FloatArray, IndexArray, Shape, inverse
from planner.issues import Issue, TandemError
from planner.problem import Arm, Cell, Stock
from planner.tooling import working_solid

Model = TypeVar("Model")
MOST_MODELS: Final = 8
"""Models of cells that are kept at most, those last used."""


class ModelCache(Generic[Model]):
    """At most ``count`` models by the content of what they were built from."""

    def __init__(self, count: int = MOST_MODELS) -> None:
        self._count = count
        self._models: OrderedDict[tuple[str, int], Model] = OrderedDict()
        self._asked: dict[str, int] = {}
        self.reused = 0

    def next_job(self) -> None:
        """What was handed out is free again."""
        self._asked.clear()

    def get(self, content: object, make: Callable[[], Model]) -> Model:
        """A model of ``content`` that this job does not have yet: one that is kept, or a new one."""
        key = content_digest(content)
        number = self._asked.get(key, 0)
        self._asked[key] = number + 1
        model = self._models.pop((key, number), None)
        self.reused += model is not None
        if model is None:
            model = make()
        self._models[(key, number)] = model
        while len(self._models) > self._count:
            self._models.popitem(last=False)
        return model


_kept: ModelCache[Any] | None = None


def keep_models(count: int = MOST_MODELS) -> ModelCache[Any]:
    """From now on models are kept in this process; call ``next_job`` of what comes back between jobs."""
    global _kept
    _kept = ModelCache(count)
    return _kept


def forget_models() -> None:
    """From now on every model is built anew."""
    global _kept
    _kept = None


def kept_model(content: object, make: Callable[[], Model]) -> Model:
    """A kept model of ``content``, or a new one where none is kept."""
    if _kept is None:
        return make()
    model: Model = _kept.get(content, make)
    return model


def content_digest(value: object) -> str:
    """SHA-256 of plain values, arrays and dataclasses of them; raises ``TypeError`` for anything else."""
    state = hashlib.sha256()
    _feed(state, value)
    return state.hexdigest()


def _feed(state: Any, value: object) -> None:
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
        raise TypeError(f"a {type(value).__name__} has no digest; give plain values, arrays and dataclasses")


NEAR: Final = "of one arm and always near each other"
"""Why pairs of solids are not held apart that :meth:`Bounds.always_near` names."""
RANDOM_POSTURES: Final = 200
"""Postures that are drawn, from a fixed seed, to find solids of one arm that are always near each other."""

STOCK_COLOUR = np.array([0.93, 0.95, 0.90, 0.55])
"""Colours of stock, support, obstacles, tools, robots from files and edges: red, green, blue and opacity,
each from 0 to 1."""
SUPPORT_COLOUR = np.array([0.45, 0.47, 0.50, 1.0])
OBSTACLE_COLOUR = np.array([0.60, 0.62, 0.66, 1.0])
TOOL_COLOUR = np.array([0.20, 0.30, 0.42, 1.0])
ROBOT_COLOUR = np.array([0.90, 0.45, 0.10, 1.0])
EDGE_COLOUR = np.array([0.85, 0.30, 0.10, 1.0])


@dataclasses.dataclass
class _Shared:
    """What all placements of one cell share; ``placed`` is the placement that the contexts hold now."""

    plant: MultibodyPlant
    diagram: Any
    checker: SceneGraphCollisionChecker
    mounts: Mapping[str, FixedOffsetFrame]
    names: Mapping[int, str]
    filtered: tuple[FilteredPair, ...]
    solids: tuple[Solid, ...]
    bounds: Bounds
    parts: dict[frozenset[str], tuple[SolidPair, ...]] = dataclasses.field(default_factory=dict)
    placed: object | None = None
    heights: "dict[float, CellModel]" = dataclasses.field(default_factory=dict)
    eased: dict[Easing, Bounds] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True, eq=False)
class CellModel:
    """A cell in Drake, with the stock and the bases at one placement.

    Models made by :meth:`with_stock` and :meth:`with_bases` share one diagram, whose contexts are set to a
    model's placement when that model is asked; a model is therefore not for use by several threads at once.
    What stands on axes is as the cell has it, moved by ``moved`` {name as :attr:`planner.problem.Cell.riders`
    has it: (4, 4)}.
    q is the concatenation of the serial joint angles [rad] of all arms, in the order of ``cell.arms``. Bodies
    are named "<arm>/base_link", "<arm>/link_1" ... "<arm>/link_J", "<arm>/tool", "<arm>/edge" (a tool's own
    edge, if it has one), "stock", "support", "<obstacle>". A held stock moves with its holder;
    ``stock_pose`` is then only remembered. What is said of distances between bodies counts pairs of
    ``easing`` as farther apart than they are; there are none unless :meth:`with_easing` states them.

    A base whose track follows the work may stand elsewhere in each row of what is asked: it is (B, 4, 4) in
    ``bases`` then, and :meth:`at_rows` gives the model of some rows. Drake is asked row by row.
    """

    cell: Cell
    stock: Stock
    stock_pose: FloatArray
    bases: Mapping[str, FloatArray]
    robots: Mapping[str, RobotData]
    _shared: _Shared
    easing: Easing = NOT_EASED
    moved: Mapping[str, FloatArray] = dataclasses.field(default_factory=dict)

    def __reduce__(self) -> tuple[Any, ...]:
        """For another process, which builds it again: Drake's part of it does not travel."""
        return _again, (
            self.cell,
            self.stock,
            self.stock_pose,
            dict(self.bases),
            self.easing,
            dict(self.moved),
        )

    @property
    def arms(self) -> tuple[str, ...]:
        """Names of the arms, in the order of q."""
        return tuple(arm.name for arm in self.cell.arms)

    @functools.cached_property
    def columns(self) -> dict[str, slice]:
        """Where each arm's joints are in q."""
        return catalogue.columns_of(self.robots)

    def split(self, rows: FloatArray) -> dict[str, FloatArray]:
        """Joints {arm: (B, J)} of configurations (B, nq)."""
        return {arm: rows[:, part] for arm, part in self.columns.items()}

    @property
    def diagram(self) -> Any:
        """The Drake ``RobotDiagram``; its default context has the placement that it was built with."""
        return self._shared.diagram

    @property
    def plant(self) -> MultibodyPlant:
        """The Drake plant."""
        return self._shared.plant

    @property
    def checker(self) -> SceneGraphCollisionChecker:
        """The collision checker, its contexts set to this placement. Pass ``parallelize=False`` to its
        batches."""
        self.place()
        return self._shared.checker

    @property
    def pairs_filtered(self) -> tuple[FilteredPair, ...]:
        """Pairs of bodies that are not held apart, or of which some solids are not, each with the reason."""
        return self._shared.filtered

    @property
    def held_in_part(self) -> Mapping[frozenset[str], tuple[SolidPair, ...]]:
        """Pairs of bodies of which some solids are always near each other, with the pairs of solids that are
        held apart, by their places in ``bounds.given``."""
        return self._shared.parts

    @property
    def solids(self) -> tuple[Solid, ...]:
        """The collision solids of all bodies."""
        return self._shared.solids

    @property
    def bounds(self) -> Bounds:
        """Capsules and boxes that bound the least distance."""
        if not self.easing.by:
            return self._shared.bounds
        known = self._shared.eased
        if self.easing not in known:
            known[self.easing] = self._shared.bounds.eased(self.easing)
        return known[self.easing]

    @property
    def home(self) -> FloatArray:
        """All arms at home, (nq,)."""
        return np.concatenate([arm.home for arm in self.cell.arms])

    def body_name(self, index: int) -> str:
        """Our name of the Drake body with that index."""
        return self._shared.names[index]

    def body(self, name: str) -> RigidBody:
        """The Drake body of that name; raises ``KeyError``."""
        for index, known in self._shared.names.items():
            if known == name:
                return self.plant.get_body(BodyIndex(index))
        raise KeyError(name)

    def geometry(self, solid: int) -> Any:
        """Drake's id of a solid, by its place in ``bounds.given``."""
        given = self.bounds.given[solid]
        own = [one for one in self.solids if one.body == given.body]
        place = next(k for k, one in enumerate(own) if one is given)
        return self.plant.GetCollisionGeometriesForBody(self.body(given.body))[place]

    def carrier(self, body: str) -> str | None:
        """The arm that a body belongs to or is held by, None for bodies of no arm."""
        owner = self.stock.held_by if body == "stock" else body.partition("/")[0]
        return owner if owner in self.arms else None

    def joints_of(self, arm: str, body: str) -> int:
        """How many joints of an arm move a body, from the base on: 0 for bodies that are not its own, all for
        its tool and what it holds."""
        link = body.partition("/")[2]
        if self.carrier(body) != arm or link == "base_link":
            return 0
        return int(link.removeprefix("link_")) if link.startswith("link_") else self.robots[arm].axes

    def stack(self, q: Mapping[str, FloatArray]) -> FloatArray:
        """Configurations (B, nq) from {arm: (B, J)}; arms that are not named stay at home."""
        count = {len(np.atleast_2d(rows)) for rows in q.values()}
        if len(count) > 1 or set(q) - set(self.arms):
            raise ValueError(f"q has arms {sorted(q)} with {sorted(count)} rows; the cell has {self.arms}")
        rows = count.pop() if count else 1
        columns = [
            np.broadcast_to(np.atleast_2d(q.get(a.name, a.home)), (rows, len(a.home))) for a in self.cell.arms
        ]
        return np.concatenate(columns, axis=1)

    def tcp(self, q: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        """TCP poses {arm: (B, 4, 4)} in the world for {arm: (B, J)}, bases as they stand in each row."""
        return {
            arm: self.bases[arm] @ forward(self.robots[arm], rows) @ self.cell.arm(arm).tool.tcp
            for arm, rows in q.items()
        }

    def jacobians(self, q: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        """Jacobians {arm: (B, 6, J)} of the TCPs in the world, rows angular [-], then linear [m/rad], of
        joints {arm: (B, J)}, by Drake's plant; :meth:`poses` of the same is closed form."""
        world, rows = self.plant.world_frame(), self.stack(q)
        ends = {arm: self._flange(arm) for arm in q}
        out = {arm: np.empty((len(rows), 6, self.robots[arm].axes)) for arm in q}
        checker = self.at_rows(0).checker  # where a base stands changes no Jacobian in the world's axes
        for i, row in enumerate(rows):
            context = checker.UpdatePositions(row)
            for arm, (frame, place, columns) in ends.items():
                out[arm][i] = self.plant.CalcJacobianSpatialVelocity(
                    context, JacobianWrtVariable.kQDot, frame, place, world, world
                )[:, columns]
        return out

    def _flange(self, arm: str) -> tuple[Any, FloatArray, slice]:
        """Drake's frame of an arm's flange, the TCP (3,) [m] in it, and the arm's columns."""
        flange = self.plant.GetFrameByName("tool0", self.body(f"{arm}/link_1").model_instance())
        return flange, self.cell.arm(arm).tool.tcp[:3, 3], self.columns[arm]

    def poses(self, q: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        """World poses of all bodies by name: (B, 4, 4) of moving bodies of named arms, (1, 4, 4) of all
        others."""
        out = {obstacle.name: np.eye(4)[None] for obstacle in self.cell.obstacles}
        riders = self.cell.riders.items()
        out.update((body, self.motion(name)[None]) for name, bodies in riders for body in bodies)
        out["stock"] = out["support"] = self.stock_pose[None]
        for arm in self.cell.arms:
            rows = np.atleast_2d(q.get(arm.name, arm.home))
            out.update(body_poses(arm.name, self.robots[arm.name], self.bases[arm.name], rows))
            if working_solid(arm.tool) is not None:
                out[f"{arm.name}/edge"] = out[f"{arm.name}/tool"]
        if self.stock.held_by is not None:
            held = self.cell.arm(self.stock.held_by).tool.tcp @ self.stock.grip
            out["stock"] = out[f"{self.stock.held_by}/tool"] @ held
        return out

    def with_stock(self, pose: FloatArray) -> "CellModel":
        """The same cell with the stock (and its support) at another pose (4, 4) in the world; nothing is
        rebuilt but a pedestal of another height. A held stock stays in its holder's tool."""
        pose = np.array(pose, dtype=np.float64)
        if self.stock.pedestal is None or self.stock.held_by is not None:
            return dataclasses.replace(self, stock_pose=pose)
        known = self._shared.heights  # of what is made for the block: one model for each
        known.setdefault(_height(self.stock_pose), self)
        if _height(pose) not in known:
            made = build(self.cell, self.stock, pose, self.bases)
            made._shared.heights = known
            known[_height(pose)] = made
        there = known[_height(pose)]
        return dataclasses.replace(there, stock_pose=pose, bases=self.bases, easing=self.easing)

    def with_bases(self, bases: Mapping[str, FloatArray]) -> "CellModel":
        """The same cell with the named arms' bases at other poses (4, 4) in the world; nothing is rebuilt."""
        return dataclasses.replace(self, bases={**self.bases, **bases})

    @property
    def rides(self) -> bool:
        """Whether a base stands elsewhere from row to row."""
        return any(base.ndim > 2 for base in self.bases.values())

    def at_rows(self, rows: IndexArray | int) -> "CellModel":
        """The model of some rows (K,) of what is asked, or of one alone, bases where they stand in these;
        itself where they stand in one place."""
        if not self.rides:
            return self
        some = {arm: base[rows] if base.ndim > 2 else base for arm, base in self.bases.items()}
        return dataclasses.replace(self, bases=some)

    def motion(self, name: str) -> FloatArray:
        """How (4, 4) what stands on an axis, by its name among stations, is moved from where the cell has
        it."""
        return self.moved.get(name, np.eye(4))

    def with_moved(self, motions: Mapping[str, FloatArray]) -> "CellModel":
        """The same cell with what stands on the named axes moved by motions (4, 4) from where the cell has
        it; nothing is rebuilt."""
        return dataclasses.replace(self, moved={**self.moved, **motions})

    def with_easing(self, easing: Easing) -> "CellModel":
        """The same cell, in which pairs of bodies count as farther apart than they are."""
        return dataclasses.replace(self, easing=easing)

    def place(self) -> None:
        """Sets the checker's contexts to this placement, unless they are there."""
        if self._shared.placed is self:
            return

        def write(_model: object, context: Any) -> None:
            plant_context = context.plant_context()
            for name, frame in self._shared.mounts.items():
                own = {"stock": self.stock_pose, **self.bases}
                on = name.removesuffix(_ON_AXIS)
                pose = own[name] if name in own else self.motion(on)
                frame.SetPoseInParentFrame(plant_context, rigid(pose))

        self._shared.checker.PerformOperationAgainstAllModelContexts(write)
        self._shared.placed = self


def build(
    cell: Cell,
    stock: Stock,
    stock_pose: FloatArray,
    bases: Mapping[str, FloatArray] | None = None,
    meshcat: Any = None,
) -> CellModel:
    """The model of a cell, with the stock at ``stock_pose`` (4, 4) in the world and arms at ``bases`` or
    their own.

    A held stock is fixed to its holder's tool. With ``meshcat`` a visualizer of the visible shapes is part of
    the diagram. Raises :class:`TandemError` for an unknown robot and for names of bodies that clash
    (``cell.body_name``), ``KeyError`` for an unknown holder, ``ValueError`` for a held stock on a support.
    Worker processes get one that an earlier job left (`planner.cell.plant`).
    """
    if meshcat is not None:
        return _new(cell, stock, stock_pose, bases, meshcat)
    content = (cell, stock, np.asarray(stock_pose, dtype=np.float64), bases)
    return kept_model(content, lambda: _new(cell, stock, stock_pose, bases, None))


def _again(
    cell: Cell,
    stock: Stock,
    stock_pose: FloatArray,
    bases: Mapping[str, FloatArray],
    easing: Easing,
    moved: Mapping[str, FloatArray],
) -> CellModel:
    return build(cell, stock, stock_pose, bases).with_easing(easing).with_moved(moved)


def _new(
    cell: Cell, stock: Stock, stock_pose: FloatArray, bases: Mapping[str, FloatArray] | None, meshcat: Any
) -> CellModel:
    _check_names(cell)
    stock = support.with_support(cell, stock, np.asarray(stock_pose))
    if stock.held_by is not None and stock.support:
        raise ValueError("a held stock has no support")
    placed = {arm.name: np.asarray((bases or {}).get(arm.name, arm.base)) for arm in cell.arms}
    robots = {arm.name: arm.data for arm in cell.arms}
    builder = RobotDiagramBuilder(time_step=0.0)
    plant = builder.plant()
    mounts: dict[str, FixedOffsetFrame] = {}
    own = own_shapes(cell, stock)
    instances = []
    flanges: dict[str, tuple[Any, Any]] = {}
    for arm in cell.arms:
        file = robots[arm.name].file
        if file is None:
            instance = _parsed(plant, builder.scene_graph(), arm)
        else:
            instance = _jointed(plant, arm.name, robots[arm.name], file)
        instances.append(instance)
        mounts[arm.name] = _mount(plant, f"{arm.name}/mount", placed[arm.name])
        plant.WeldFrames(mounts[arm.name], plant.GetFrameByName("base_link", instance))
        flanges[arm.name] = instance, plant.GetFrameByName("tool0", instance)
        for body, colour in ((f"{arm.name}/tool", TOOL_COLOUR), (f"{arm.name}/edge", EDGE_COLOUR)):
            if body in own:
                _on_flange(plant, body, flanges[arm.name], np.eye(4), own[body], colour)
    if stock.held_by is not None:
        held = cell.arm(stock.held_by).tool.tcp @ stock.grip
        _on_flange(plant, "stock", flanges[stock.held_by], held, own["stock"], STOCK_COLOUR)
    else:
        mounts["stock"] = _mount(plant, "stock/mount", np.asarray(stock_pose))
        _fixed(plant, "stock", mounts["stock"], own["stock"], STOCK_COLOUR)
    if stock.support:
        _fixed(plant, "support", mounts["stock"], own["support"], SUPPORT_COLOUR)
    on: dict[str, str] = {}
    for axis, bodies in cell.riders.items():
        mounts[f"{axis}{_ON_AXIS}"] = _mount(plant, f"{axis}{_ON_AXIS}", np.eye(4))
        on |= dict.fromkeys(bodies, f"{axis}{_ON_AXIS}")
    for obstacle in cell.obstacles:
        mount = mounts[on[obstacle.name]] if obstacle.name in on else plant.world_frame()
        _fixed(plant, obstacle.name, mount, obstacle.shapes, OBSTACLE_COLOUR)
    plant.Finalize()
    if meshcat is not None:
        parameters = MeshcatVisualizerParams()
        MeshcatVisualizer.AddToBuilder(builder.builder(), builder.scene_graph(), meshcat, parameters)
    names = _names(plant, cell, instances)
    with quiet():
        checker = SceneGraphCollisionChecker(
            model=builder.Build(), robot_model_instances=instances, edge_step_size=0.05
        )
    filtered = filter_pairs(checker, names, stock.held_by)
    inspector = checker.model().scene_graph().model_inspector()
    solids = collect(plant, inspector, names, own)
    riding = {f"{arm.name}/base_link" for arm in cell.arms if arm.follows}
    bounds = prepare(solids, filtered, stock.held_by, riding)
    shared = _Shared(plant, checker.model(), checker, mounts, names, filtered, solids, bounds)
    model = CellModel(cell, stock, np.asarray(stock_pose, dtype=np.float64), placed, robots, shared)
    _leave_out_always_near(model)
    return model


_OwnPair = tuple[tuple[str, int], tuple[str, int]]
"""Two solids, each by its body and its place among those of that body."""
_known_near: dict[str, tuple[Sequence[_OwnPair], Sequence[_OwnPair]]] = {}
"""What :func:`_always_near` found, by the content of the arms: all cells, setups and placements with the same
arms and tools have it."""
MOST_KNOWN: Final = 64
"""Sets of arms of which that is known at most."""


def _always_near(model: CellModel) -> tuple[Sequence[SolidPair], Sequence[SolidPair]]:
    """Pairs of what is mounted flat on a flange and the link before the wrist, and of solids of one arm that
    are near each other in nearly all of RANDOM_POSTURES. Wherever the arms stand it is the same: they are
    looked at with their bases at the origin, so that rounding is the same, too."""
    arms = [(a.name, a.robot, a.given, a.tool, a.home, a.follows) for a in model.cell.arms]
    key = content_digest((arms, model.stock.held_by))
    names = _own_names(model.bounds.given)
    if key not in _known_near:
        while len(_known_near) >= MOST_KNOWN:
            del _known_near[next(iter(_known_near))]
        flat, near = _found_near(dataclasses.replace(model, bases={arm: np.eye(4) for arm in model.arms}))
        _known_near[key] = ([(names[a], names[b]) for a, b in flat], [(names[a], names[b]) for a, b in near])
    place = {name: k for k, name in enumerate(names)}
    flat, near = (
        tuple(sorted((min(place[a], place[b]), max(place[a], place[b])) for a, b in pairs))
        for pairs in _known_near[key]
    )
    return flat, near


def _own_names(given: Sequence[Solid]) -> list[tuple[str, int]]:
    """The body of each solid and its place among those of that body."""
    count: dict[str, int] = {}
    out = []
    for solid in given:
        out.append((solid.body, count.get(solid.body, 0)))
        count[solid.body] = out[-1][1] + 1
    return out


def _found_near(model: CellModel) -> tuple[Sequence[SolidPair], Sequence[SolidPair]]:
    whole = model._shared.bounds
    flat = whole.flange_parts(model.poses({}))
    lower = np.concatenate([model.robots[arm].lower for arm in model.arms])
    upper = np.concatenate([model.robots[arm].upper for arm in model.arms])
    q = np.random.default_rng(20).uniform(lower, upper, size=(RANDOM_POSTURES, len(lower)))
    return flat, whole.without(flat).always_near(model.poses(model.split(q)))


def _leave_out_always_near(model: CellModel) -> None:
    """Takes pairs of solids out of what is held apart: of what is mounted flat on a flange and the link
    before the wrist, and of one arm that are near each other in nearly all of RANDOM_POSTURES. Where those
    are all pairs of two bodies, they are out of the checker, too."""
    shared, whole = model._shared, model._shared.bounds
    flat, near = _always_near(model)
    shared.bounds = whole.without({*flat, *near})
    reasons: dict[tuple[str, str], list[str]] = {}
    for why, solids in (("what is flat on the flange is kept off by its build", flat), (NEAR, near)):
        for a, b in solids:
            one, other = sorted((whole.given[a].body, whole.given[b].body))
            reasons.setdefault((one, other), [])
            if why not in reasons[one, other]:
                reasons[one, other].append(why)
    found = list(shared.filtered)
    for (one, other), told in sorted(reasons.items()):
        left, count = shared.bounds.of_bodies(one, other), len(whole.of_bodies(one, other))
        if not left:
            a, b = (model.body(name).index() for name in (one, other))
            shared.checker.SetCollisionFilteredBetween(a, b, True)
            found.append((one, other, ", ".join(told)))
            continue
        shared.parts[frozenset((one, other))] = left
        share = f"{count - len(left)} of {count} pairs of their solids"
        found.append((one, other, f"{share}: {', '.join(told)}; the others are held apart"))
    shared.filtered = tuple(sorted(found))


def _parsed(plant: MultibodyPlant, scene_graph: Any, arm: Arm) -> Any:
    """The model of a robot of the catalogue, by Drake's reader of its URDF."""
    path = catalogue.urdf_path(arm.robot)
    try:
        parser = Parser(plant=plant, scene_graph=scene_graph, model_name_prefix=arm.name)
        (instance,) = parser.AddModels(str(path))
    except RuntimeError as error:
        raise catalogue.damaged(path, str(error)) from None
    return instance


def _jointed(plant: MultibodyPlant, name: str, robot: RobotData, file: RobotFile) -> Any:
    """The model of a robot of the user's own: frames of its URDF, links named as those of the catalogue, the
    shapes that are held apart."""
    instance = plant.AddModelInstance(name)
    bodies = [
        plant.AddRigidBody(link, instance, SpatialInertia.Zero()) for link in link_chain(robot.axes)[:-1]
    ]
    steps = inverse(file.zero[:-1]) @ file.zero[1:]
    for i in range(robot.axes):
        before = bodies[i].body_frame()
        hinge = plant.AddFrame(FixedOffsetFrame(f"hinge_{i + 1}", before, rigid(steps[i]), instance))
        axis = file.zero[i + 1, :3, :3].T @ file.axis[i]
        low, high = float(robot.lower[i]), float(robot.upper[i])
        plant.AddJoint(RevoluteJoint(f"joint_{i + 1}", hinge, bodies[i + 1].body_frame(), axis, low, high))
    plant.AddFrame(FixedOffsetFrame("tool0", bodies[-1].body_frame(), rigid(steps[-1]), instance))
    for body, shapes in zip(bodies, file.shapes, strict=True):
        _add_shapes(plant, body, shapes, ROBOT_COLOUR)
    return instance


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Without what Drake says of itself: contexts of every checker, ports."""
    logger = logging.getLogger("drake")
    level = logger.level
    logger.setLevel(max(level, logging.WARNING))
    try:
        yield
    finally:
        logger.setLevel(level)


def rigid(pose: FloatArray) -> RigidTransform:
    """Drake's transform of a pose (4, 4), made orthonormal to rounding."""
    return RigidTransform(RotationMatrix.ProjectToRotationMatrix(pose[:3, :3]), pose[:3, 3])


def _check_names(cell: Cell) -> None:
    taken = ["stock", "support", "world"]
    issues = []
    bodies = [("arm", f"cell.arms.{i}.name", arm.name) for i, arm in enumerate(cell.arms)]
    bodies += [("obstacle", f"cell.obstacles.{i}.name", body.name) for i, body in enumerate(cell.obstacles)]
    for kind, field, name in bodies:
        if name in taken or "/" in name:
            message = f"{kind} {name!r}: the name is taken, reserved or has a '/'"
            issues.append(Issue("cell.body_name", message, field=field, hint="give it another name"))
        taken.append(name)
    if issues:
        raise TandemError(issues)


def _mount(plant: MultibodyPlant, name: str, pose: FloatArray) -> FixedOffsetFrame:
    return plant.AddFrame(FixedOffsetFrame(name, plant.world_frame(), rigid(pose)))


_ON_AXIS: Final = "/on"
"""Behind the name of an axis: its frame in the world, that of what stands on it."""


def _fixed(
    plant: MultibodyPlant, name: str, mount: Any, shapes: tuple[Shape, ...], colour: FloatArray
) -> None:
    body = plant.AddRigidBody(name, plant.AddModelInstance(name), SpatialInertia.Zero())
    plant.WeldFrames(mount, body.body_frame())
    _add_shapes(plant, body, shapes, colour)


def _on_flange(
    plant: MultibodyPlant,
    name: str,
    flange: tuple[Any, Any],
    pose: FloatArray,
    shapes: tuple[Shape, ...],
    colour: FloatArray,
) -> None:
    """A body of the robot's own model (instance, tool0), fixed at ``pose`` (4, 4) to its flange."""
    instance, frame = flange
    body = plant.AddRigidBody(name, instance, SpatialInertia.Zero())
    plant.WeldFrames(frame, body.body_frame(), rigid(pose))
    _add_shapes(plant, body, shapes, colour)


def _add_shapes(
    plant: MultibodyPlant, body: RigidBody, shapes: tuple[Shape, ...], colour: FloatArray
) -> None:
    for i, shape in enumerate(shapes):
        pose, name = rigid(shape.pose), f"{body.name()}_{i}"
        plant.RegisterVisualGeometry(body, pose, drake_shape(shape, solid=False), name, colour)
        plant.RegisterCollisionGeometry(
            body, pose, drake_shape(shape, solid=True), name, CoulombFriction(0.5, 0.5)
        )


def _names(plant: MultibodyPlant, cell: Cell, instances: list[Any]) -> dict[int, str]:
    names = {0: "world"}
    for arm, instance in zip(cell.arms, instances, strict=True):
        for index in plant.GetBodyIndices(instance):
            name = plant.get_body(index).name()
            names[int(index)] = name if name.startswith(f"{arm.name}/") else f"{arm.name}/{name}"
    for fixed in ["stock", "support", *(obstacle.name for obstacle in cell.obstacles)]:
        if plant.HasBodyNamed(fixed):
            names[int(plant.GetBodyByName(fixed).index())] = fixed
    return names


def _height(pose: FloatArray) -> float:
    return round(float(pose[2, 3]), 7)
