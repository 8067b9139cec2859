"""What the page draws of a cell: bodies by frame, where they are, targets with what the arms do there.

Lengths are in mm, angles in degrees, poses rows of twelve numbers (the upper three rows of the matrix) in the
world. Where bodies are says the cell's model, from joints: whoever draws needs no kinematics. It loads Drake.
"""

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from planner import pipeline
from planner.cell import plant
from planner.cell.bodies import link_chain
from planner.cell.plant import CellModel
from planner.geometry.arrays import FloatArray, Mesh, from_parts, spread_rows, to_rpy
from planner.geometry.thinning import thinned
from planner.geometry.units import DEG, MM
from planner.issues import Issue, TandemError, refusal
from planner.motion import axis_map, reach_field, solve, stations
from planner.motion.first_look import FirstLook
from planner.motion.planning_scene import Scene
from planner.motion.search.subsampling import subset
from planner.pipeline import Make
from planner.plans import Plan
from planner.problem import Problem, Setup
from planner.processes import registry
from planner.report import scene as scenes
from planner.report.raster import part_meshes
from planner.targets import Targets

FINEST: Final = 10_000
"""Meshes of more triangles are thinned out."""
MOST_TRIANGLES: Final = 300_000
"""Triangles that are drawn at most: some 10 MB of JSON."""
WIRE_POINTS: Final = 25
"""Points of a bent wire."""


def view(
    problem: Problem,
    operation: int = 0,
    make: Make | None = None,
    most: int | None = None,
    freedom: str | None = None,
    plan: Plan | None = None,
    reach: bool = False,
) -> tuple[dict[str, Any], list[Issue]]:
    """The cell as an operation finds it, and what is in the way of drawing more of it. Of about ``most``
    targets it says where they are and what posture the arms have there, or why none; with ``freedom`` there
    is the map of that one over them, and where a ``plan`` goes through it; with ``reach`` what each arm can
    do over a block that stands.

    Raises :class:`TandemError` where the cell cannot be built.
    """
    pipeline.ready()
    setup = problem.setup_of(operation)
    own = problem.operations[operation]
    issues: list[Issue] = []
    looked = None
    if most is not None:
        try:
            looked = _looked(problem, operation, make, most, brief=plan is None)
        except TandemError as error:
            issues += error.issues
    if looked is None:
        stated = setup.stock.place
        place = from_parts(setup.stock.attitude, np.zeros(3)) if stated is None else stated
        model = plant.build(setup.cell, setup.stock, place)
        placed = stated is not None or setup.stock.held_by is not None
    else:
        setup, place, model, placed = looked.setup, looked.place, looked.model, looked.placed
    q = {arm.name: arm.home[None] for arm in setup.cell.arms}
    out: dict[str, Any] = {
        "operation": operation,
        "operations": [one.name for one in problem.operations],
        "setup": setup.number,
        "placed": placed,
        "arms": [_arm(setup, model, arm.name, arm.name in own.arms) for arm in setup.cell.arms],
        "moves": _moves(problem, setup, model),
        "bodies": _bodies(problem, setup, model, place),
    }
    if looked is not None:
        found, q = _targets(looked, q)
        out |= found
        known = axis_map.freedoms(looked.targets, placed and setup.stock.held_by is None)
        out["freedoms"] = [{"name": name, "unit": axis_map.SHOWN[unit][0]} for name, unit in known.items()]
        if freedom in known:
            made = axis_map.axis_map(looked.scene, subset(looked.targets, looked.rows), freedom)
            out["map"] = _map(made) | _path(looked, operation, made, plan)
        if reach and placed and setup.stock.held_by is None:
            out |= _reach(looked)
    seen = scenes.extract(model if looked is None else model.with_bases(_ridden(looked, out["targets"])))
    poses = scenes.stand(seen, setup, place, q)
    out["poses"] = {body: _rows(poses[body]) for body in {one["body"] for one in out["bodies"]}}
    return out, issues


@dataclasses.dataclass(frozen=True)
class _Looked:
    """An operation with its targets, where all stands, and the targets ``rows`` (K,) that are looked at."""

    setup: Setup
    place: FloatArray
    model: CellModel
    placed: bool
    scene: Scene
    targets: Targets
    rows: Any


def _looked(problem: Problem, operation: int, make: Make | None, most: int, brief: bool) -> _Looked:
    """As a first look has them, or with all targets of a plan if not ``brief``; raises ``TandemError`` where
    there are no targets or no place for axes."""
    every = pipeline.targets_of(problem, registry.jobs(problem, brief=brief), make)
    problem, roomy = solve.with_room(problem, every)
    first = FirstLook(tuple(item.count for item in roomy), most)
    problem, roomy = stations.stationed(problem, roomy, first.passes)
    stand = next(one for one in solve.setup_groups(problem, roomy) if _has(one, operation))
    models = stand.models()
    at = next(i for i, setup in enumerate(stand.setups) if operation in setup.operations)
    place, bases, placed = stand.place, {}, stand.settled
    if not placed:
        found = solve.first_place(problem, stand, models, [operation], first)
        if found is not None:
            place, bases, placed = found.stock, found.bases, True
    setup, targets = stand.setups[at], roomy[operation]
    model = models[at].with_stock(place).with_bases(bases)
    scene = Scene.of(setup.cell, targets.arms, place, problem.settings, model, bases)
    return _Looked(setup, place, model, placed, scene, targets, spread_rows(targets.count, max(2, most)))


def _has(stand: solve.Stand, operation: int) -> bool:
    return any(operation in setup.operations for setup in stand.setups)


def _arm(setup: Setup, model: CellModel, name: str, works: bool) -> dict[str, Any]:
    arm = setup.cell.arm(name)
    return {
        "name": name,
        "robot": arm.data.title,
        "works": works,
        "home_deg": _numbers(np.asarray(arm.home) / DEG),
        "lower_deg": _numbers(arm.data.lower / DEG),
        "upper_deg": _numbers(arm.data.upper / DEG),
    }


def _moves(problem: Problem, setup: Setup, model: CellModel) -> list[dict[str, Any]]:
    """What stands somewhere by fields of the problem: the bodies that go along, and each field with the pose
    that it has, or that was found for it."""
    out = []
    if setup.number == 1 and setup.stock.held_by is None:
        fields = [_field("stock.place", model.stock_pose)]
        out.append(
            {"name": "stock", "kind": "stock", "bodies": ["stock", "support", "part"], "fields": fields}
        )
    for number, arm in enumerate(problem.cell.arms):
        names = [f"{arm.name}/{link}" for link in link_chain(arm.data.axes)[:-1]]
        names += [f"{arm.name}/tool", f"{arm.name}/edge"]
        if setup.stock.held_by == arm.name:
            names += ["stock", "part"]
        fields = [_field(f"cell.arms.{number}.base", model.bases[arm.name])]
        out.append({"name": arm.name, "kind": "arm", "bodies": names, "fields": fields})
    for number, body in enumerate(problem.cell.obstacles):
        fields = [
            _field(f"cell.obstacles.{number}.shapes.{i}.pose", shape.pose)
            for i, shape in enumerate(body.shapes)
        ]
        out.append({"name": body.name, "kind": "obstacle", "bodies": [body.name], "fields": fields})
    return out


def _field(name: str, pose: FloatArray) -> dict[str, Any]:
    return {
        "field": name,
        "xyz_mm": _numbers(pose[:3, 3] / MM),
        "rpy_deg": _numbers(to_rpy(pose[:3, :3]) / DEG),
    }


def _bodies(problem: Problem, setup: Setup, model: CellModel, place: FloatArray) -> list[dict[str, Any]]:
    """Triangles in the frame of their body, pieces of one colour together; robots by their bodies for
    collision where there would be too many as their makers drew them. Raises ``TandemError`` for more than
    are drawn."""
    wanted = [thinned(mesh, FINEST) for _, mesh in part_meshes(problem.part) if len(mesh.faces)]
    for hulls in (False, True):
        parts = _pieces((*scenes.extract(model, hulls).pieces, *scenes.mounted(setup, place)))
        count = sum(len(mesh.faces) for own in (*parts.values(), wanted) for mesh in own)
        if count <= MOST_TRIANGLES:
            break
    if count > MOST_TRIANGLES:
        what = (
            f"cell: its bodies have {count:,} triangles, also where fine meshes are thinned out, and at most "
            f"{MOST_TRIANGLES:,} are drawn; name fewer meshes, or export them coarser"
        )
        raise refusal("service.too_large", what, field="cell", value=count, limit=MOST_TRIANGLES)
    obstacles = {body.name for body in setup.cell.obstacles}
    out = [_body(name, _kind(name, obstacles), color, own) for (name, color), own in parts.items()]
    return [*out, _body("stock", "part", None, wanted)] if wanted else out


def _pieces(pieces: Iterable[scenes.Piece]) -> dict[tuple[str, tuple[float, ...]], list[Mesh]]:
    """Meshes in the frame of their body, by body and colour, fine ones thinned out."""
    parts: dict[tuple[str, tuple[float, ...]], list[Mesh]] = {}
    for piece in pieces:
        moved = piece.solid.moved(piece.pose)
        mesh = thinned(Mesh(moved.vertices, moved.faces), FINEST)
        parts.setdefault((piece.body, piece.color), []).append(mesh)
    return parts


def _kind(name: str, obstacles: Iterable[str]) -> str:
    if name in obstacles:
        return "obstacle"
    last = name.rpartition("/")[2]
    return last if last in ("stock", "support", "tool", "edge") else "link"


def _body(name: str, kind: str, color: tuple[float, ...] | None, meshes: Sequence[Mesh]) -> dict[str, Any]:
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts[:-1], strict=True)]
    vertices = np.concatenate([mesh.vertices for mesh in meshes]) / MM
    return {
        "body": name,
        "kind": kind,
        "color": None if color is None else [round(float(v), 4) for v in color],
        "vertices": np.round(vertices, 2).reshape(-1).tolist(),
        "faces": np.concatenate(faces).reshape(-1).tolist(),
    }


def _targets(looked: _Looked, home: Mapping[str, FloatArray]) -> tuple[dict[str, Any], dict[str, FloatArray]]:
    """Targets with their faults, and joints {arm: (1 + P, 6)}: home, then those of every target that has a
    posture, in order."""
    scene, targets, rows = looked.scene, looked.targets, looked.rows
    known = axis_map.postures(scene, targets, rows)
    few = subset(targets, rows)
    nominal = scene.tcp(dataclasses.replace(few, ride={}), few.neutral())
    edge = scene.edge(few, np.arange(few.count))
    out, wires, postures = [], [], []
    for k, (row, found) in enumerate(zip(rows.tolist(), known, strict=True)):
        here = isinstance(found, dict)
        points = {arm: nominal[arm][k, :3, 3] for arm in targets.arms}
        if isinstance(found, dict):
            chains = scene.standing(targets, row).chains
            points = {arm: chains[arm].pose(q)[:3, 3] for arm, q in found.items()}
            postures.append(found)
            if edge is not None:
                wires.append(np.round(edge[k, spread_rows(edge.shape[1], WIRE_POINTS)] / MM, 1).tolist())
        out.append(
            {
                "index": row,
                "name": targets.name(row),
                "points_mm": {arm: _numbers(point / MM) for arm, point in points.items()},
                "posture": len(postures) if here else None,
                "faults": [] if isinstance(found, dict) else found,
            }
        )
    q = {
        arm: np.concatenate([own, *(posture.get(arm, own[0])[None] for posture in postures)])
        for arm, own in home.items()
    }
    told: dict[str, Any] = {
        "of": targets.count,
        "thinned": targets.thinned,
        "targets": out,
        "joints_deg": {arm: np.round(own / DEG, 3).tolist() for arm, own in q.items()},
    }
    return (told | {"wires_mm": wires} if wires else told), q


def _ridden(looked: _Looked, told: Sequence[Mapping[str, Any]]) -> dict[str, FloatArray]:
    """Bases {arm: (1 + P, 4, 4)} of arms whose tracks go along: at the station, then at every target of those
    ``told`` that has a posture, in order."""
    rows = np.array([one["index"] for one in told if one["posture"] is not None], dtype=np.intp)
    out = {}
    for name, values in looked.targets.ride.items():
        arm = looked.setup.cell.arm(name)
        out[name] = scenes.ridden_base(arm, np.append(arm.station or 0.0, values[rows]))
    return out


def _map(found: axis_map.AxisMap) -> dict[str, Any]:
    places = found.places
    unit, scale = axis_map.SHOWN[found.unit]
    return {
        "freedom": found.freedom,
        "unit": unit,
        "values": np.round(found.values / scale, 6).tolist(),
        "states": {arm: own.tolist() for arm, own in places.state.items()},
        "codes": list(axis_map.CODES),
        "limit_deg": {arm: _some(own / DEG) for arm, own in places.limit.items()},
        "singular_deg": {arm: _some(own / DEG) for arm, own in places.singular.items()},
        "clearance_mm": _some(found.clearance / MM),
        "pairs": [[" and ".join(pair) if all(pair) else "" for pair in row] for row in places.pair],
    }


def _reach(looked: _Looked) -> dict[str, Any]:
    stock = looked.setup.stock
    found = reach_field.reach_field(looked.scene, looked.targets, stock.lower, stock.upper)
    if found is None:
        return {}
    return {
        "reach": {
            "points_mm": np.round(found.points / MM, 1).tolist(),
            "pitch_mm": _numbers(found.pitch / MM),
            "states": {arm: own.tolist() for arm, own in found.state.items()},
            "codes": list(axis_map.CODES),
            "targets": found.targets,
            "samples": found.samples,
        }
    }


def _path(looked: _Looked, operation: int, made: axis_map.AxisMap, plan: Plan | None) -> dict[str, Any]:
    """Values of a plan at the targets of a map, None at targets that it left out; nothing where it is a plan
    of other targets, or of none that are here."""
    if plan is None or operation >= len(plan.operations):
        return {}
    its = plan.operations[operation]
    rows = {its.targets.name(row): row for row in range(its.targets.count)}
    found = [rows.get(looked.targets.name(row)) for row in looked.rows.tolist()]
    names = [one.name for one in its.targets.freedoms]
    out: list[float | None] = []
    for row, there in zip(looked.rows.tolist(), found, strict=True):
        if there is None:
            out.append(None)
            continue
        for arm, pose in looked.targets.pose.items():
            if arm not in its.targets.pose or not np.allclose(pose[row], its.targets.pose[arm][there]):
                return {}
        if made.freedom in names:
            out.append(float(its.values[there, names.index(made.freedom)]))
        elif made.freedom.startswith(axis_map.PLACE):
            axis = axis_map.PLACE_AXES.index(made.freedom.removeprefix(axis_map.PLACE))
            out.append(float((plan.places[looked.setup.number - 1] - looked.place)[axis, 3]))
    scale = axis_map.SHOWN[made.unit][1]
    path = [None if value is None else round(value / scale, 6) for value in out]
    return {"path": path} if any(value is not None for value in path) else {}


def _some(values: FloatArray) -> list[list[float | None]]:
    return [[round(float(v), 1) if np.isfinite(v) else None for v in row] for row in values]


def _rows(poses: FloatArray) -> list[list[float]]:
    """Poses (B, 4, 4) as twelve numbers each, their places in mm."""
    rows = np.array(poses[:, :3, :], dtype=np.float64)
    rows[..., 3] /= MM
    return [[round(float(v), 5) for v in row] for row in rows.reshape(len(rows), 12)]


def _numbers(values: FloatArray) -> list[float]:
    return [round(float(value), 3) for value in values]
