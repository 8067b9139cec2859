"""Drawing of a cell: bodies by frame, their poses, and the targets with the postures of the arms.

Lengths are in mm, angles in degrees. A pose is a list of twelve numbers in the world: the upper three rows
of its matrix. The cell model computes poses from joint values, so that the web page needs no kinematics.
The module loads Drake.
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
from planner.geometry.decimation import decimate
from planner.geometry.units import DEG, MM
from planner.issues import Issue, TandemError, issue_error
from planner.motion import freedom_ranges, reach_field, solve, stations
from planner.motion.planning_scene import Scene
from planner.motion.quick_check import QuickCheck
from planner.motion.search.subsampling import select_targets
from planner.pipeline import TargetFactory
from planner.plans import Plan
from planner.problem import Problem, Setup
from planner.processes import registry
from planner.report import scene as scenes
from planner.report.raster import part_meshes
from planner.targets import Targets

MAX_MESH_TRIANGLES: Final = 10_000
"""Maximum number of triangles of one mesh. Finer meshes are simplified."""
MAX_TRIANGLES: Final = 300_000
"""Maximum number of triangles of a drawing: about 10 MB of JSON."""
WIRE_POINT_COUNT: Final = 25
"""Number of points of a drawn bent wire."""


@dataclasses.dataclass(frozen=True)
class TargetSampling:
    """Targets of an operation that are sampled for a drawing, and what is computed from them.

    Attributes:
        max_samples: Approximate number of targets to sample. The drawing contains the tool points of each and
            its posture, or the issues if there is none.
        freedom: Freedom to map over the sampled targets, or None.
        reach: Add the reach of each arm over a fixed block.
    """

    max_samples: int
    freedom: str | None = None
    reach: bool = False


def view(
    problem: Problem,
    operation: int = 0,
    sampling: TargetSampling | None = None,
    make: TargetFactory | None = None,
    plan: Plan | None = None,
) -> tuple[dict[str, Any], list[Issue]]:
    """Draw the cell as an operation finds it.

    Args:
        problem: Problem.
        operation: Index of the operation.
        sampling: Sampled targets, or None to draw the cell alone.
        make: Function that creates targets, or None for the default.
        plan: Plan whose path through the freedom map is added, or None.

    Returns:
        Fields of :class:`planner.service.cell_models.CellOut`, and issues that prevented parts of the
        drawing.

    Raises:
        TandemError: The cell cannot be built.
    """
    pipeline.import_dependencies()
    setup = problem.setup_of(operation)
    current_operation = problem.operations[operation]
    issues: list[Issue] = []
    sampled = None
    if sampling is not None:
        try:
            sampled = _sample_operation(problem, operation, make, sampling.max_samples, brief=plan is None)
        except TandemError as error:
            issues += error.issues
    if sampled is None:
        stated = setup.stock.place
        stock_pose = from_parts(setup.stock.attitude, np.zeros(3)) if stated is None else stated
        model = plant.build_cell_model(setup.cell, setup.stock, stock_pose)
        placed = stated is not None or setup.stock.held_by is not None
    else:
        setup, stock_pose, model, placed = sampled.setup, sampled.stock_pose, sampled.model, sampled.placed
    joints = {arm.name: arm.home[None] for arm in setup.cell.arms}
    out: dict[str, Any] = {
        "operation": operation,
        "operations": [item.name for item in problem.operations],
        "setup": setup.number,
        "placed": placed,
        "arms": [_arm(setup, model, arm.name, arm.name in current_operation.arms) for arm in setup.cell.arms],
        "moves": _movables(problem, setup, model),
        "bodies": _bodies(problem, setup, model, stock_pose),
    }
    if sampling is not None and sampled is not None:
        target_fields, joints = _targets(sampled, joints)
        out |= target_fields
        freedom_units = freedom_ranges.freedom_units(sampled.targets, placed and setup.stock.held_by is None)
        out["freedoms"] = [
            {"name": name, "unit": freedom_ranges.DISPLAY_UNITS[unit][0]}
            for name, unit in freedom_units.items()
        ]
        if sampling.freedom in freedom_units:
            freedom_map = freedom_ranges.compute_freedom_map(
                sampled.scene, select_targets(sampled.targets, sampled.rows), sampling.freedom
            )
            out["map"] = _freedom_map_fields(freedom_map) | _plan_path_fields(
                sampled, operation, freedom_map, plan
            )
        if sampling.reach and placed and setup.stock.held_by is None:
            out |= _reach_fields(sampled)
    scene_data = scenes.extract_scene(
        model if sampled is None else model.with_bases(_track_bases(sampled, out["targets"]))
    )
    poses = scenes.scene_poses(scene_data, setup, stock_pose, joints)
    out["poses"] = {body: _pose_rows(poses[body]) for body in {item["body"] for item in out["bodies"]}}
    return out, issues


@dataclasses.dataclass(frozen=True)
class _SampledOperation:
    """An operation with its targets, the poses of the bodies, and the sampled targets.

    Attributes:
        setup: Setup of the operation.
        stock_pose: Pose of the stock (4, 4).
        model: Cell model.
        placed: Whether the pose of the stock is stated or was found.
        scene: Planning scene.
        targets: All targets.
        rows: Indices of the sampled targets (K,).
    """

    setup: Setup
    stock_pose: FloatArray
    model: CellModel
    placed: bool
    scene: Scene
    targets: Targets
    rows: Any


def _sample_operation(
    problem: Problem, operation: int, make: TargetFactory | None, target_count: int, brief: bool
) -> _SampledOperation:
    """Prepare the targets and the planning scene of an operation as a quick check does.

    Args:
        problem: Problem.
        operation: Index of the operation.
        make: Function that creates targets, or None for the default.
        target_count: Approximate number of targets to sample.
        brief: Create the reduced targets of a quick check. False creates all targets of a plan.

    Raises:
        TandemError: There are no targets, or no position of the external axes.
    """
    all_targets = pipeline.create_targets(problem, registry.jobs(problem, brief=brief), make)
    problem, margin_targets = solve.with_margins(problem, all_targets)
    sampling = QuickCheck(tuple(item.count for item in margin_targets), target_count)
    problem, margin_targets = stations.assign_stations(problem, margin_targets, sampling.all_reachable)
    group = next(
        candidate
        for candidate in solve.setup_groups(problem, margin_targets)
        if _contains_operation(candidate, operation)
    )
    models = group.models()
    setup_index = next(i for i, setup in enumerate(group.setups) if operation in setup.operations)
    stock_pose, bases, placed = group.stock_pose, {}, group.is_placed
    if not placed:
        placement = solve.find_quick_placement(problem, group, models, [operation], sampling)
        if placement is not None:
            stock_pose, bases, placed = placement.stock, placement.bases, True
    setup, targets = group.setups[setup_index], margin_targets[operation]
    model = models[setup_index].with_stock(stock_pose).with_bases(bases)
    scene = Scene.of(setup.cell, targets.arms, stock_pose, problem.settings, model, bases)
    return _SampledOperation(
        setup, stock_pose, model, placed, scene, targets, spread_rows(targets.count, max(2, target_count))
    )


def _contains_operation(group: solve.SetupGroup, operation: int) -> bool:
    return any(operation in setup.operations for setup in group.setups)


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


def _movables(problem: Problem, setup: Setup, model: CellModel) -> list[dict[str, Any]]:
    """List stock, arms and obstacles with the problem fields that place them and the bodies that they move.

    Returns:
        Fields of :class:`planner.service.cell_models.CellMove`, one dictionary for each.
    """
    out = []
    # the field stock.place is the pose in the first setup
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


def _bodies(problem: Problem, setup: Setup, model: CellModel, stock_pose: FloatArray) -> list[dict[str, Any]]:
    """Return the triangles of all bodies and of the nominal part, in body frames and merged by colour.

    Robots are drawn by their collision hulls if the visual meshes exceed `MAX_TRIANGLES`.

    Raises:
        TandemError: More than `MAX_TRIANGLES` triangles.
    """
    simplified_part = [
        decimate(mesh, MAX_MESH_TRIANGLES) for _, mesh in part_meshes(problem.part) if len(mesh.faces)
    ]
    for hulls in (False, True):
        meshes_by_body = _meshes_by_body(
            (*scenes.extract_scene(model, hulls).pieces, *scenes.setup_pieces(setup, stock_pose))
        )
        triangle_count = sum(
            len(mesh.faces)
            for body_meshes in (*meshes_by_body.values(), simplified_part)
            for mesh in body_meshes
        )
        if triangle_count <= MAX_TRIANGLES:
            break
    if triangle_count > MAX_TRIANGLES:
        message = (
            f"cell: too many triangles to draw, even with simplified meshes (got {triangle_count:,}, "
            f"allowed {MAX_TRIANGLES:,}). Use fewer meshes, or export them coarser."
        )
        raise issue_error(
            "service.too_large", message, field="cell", value=triangle_count, limit=MAX_TRIANGLES
        )
    obstacles = {body.name for body in setup.cell.obstacles}
    out = [
        _body(name, _kind(name, obstacles), color, body_meshes)
        for (name, color), body_meshes in meshes_by_body.items()
    ]
    return [*out, _body("stock", "part", None, simplified_part)] if simplified_part else out


def _meshes_by_body(pieces: Iterable[scenes.VisiblePiece]) -> dict[tuple[str, tuple[float, ...]], list[Mesh]]:
    """Return meshes in body frames, by body and colour. Fine meshes are simplified."""
    meshes_by_body: dict[tuple[str, tuple[float, ...]], list[Mesh]] = {}
    for piece in pieces:
        moved = piece.solid.moved(piece.pose)
        mesh = decimate(Mesh(moved.vertices, moved.faces), MAX_MESH_TRIANGLES)
        meshes_by_body.setdefault((piece.body, piece.color), []).append(mesh)
    return meshes_by_body


def _kind(name: str, obstacles: Iterable[str]) -> str:
    """Return the kind of a body, as in :class:`planner.service.cell_models.CellBody`, from its name."""
    if name in obstacles:
        return "obstacle"
    last_component = name.rpartition("/")[2]
    return last_component if last_component in ("stock", "support", "tool", "edge") else "link"


def _body(name: str, kind: str, color: tuple[float, ...] | None, meshes: Sequence[Mesh]) -> dict[str, Any]:
    """Merge meshes [m] into the fields of one :class:`planner.service.cell_models.CellBody` [mm]."""
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


def _targets(
    sampled: _SampledOperation, home: Mapping[str, FloatArray]
) -> tuple[dict[str, Any], dict[str, FloatArray]]:
    """Find a posture of the arms for each sampled target, and describe the targets for the drawing.

    Args:
        sampled: Operation with its sampled targets.
        home: Home joints {arm: (1, 6)} [rad].

    Returns:
        Fields of the drawing that describe the targets, and joints {arm: (1 + P, 6)} [rad]. The first row is
        home. The others are the P postures that were found, in the order of the targets.
    """
    scene, targets, target_indices = sampled.scene, sampled.targets, sampled.rows
    results = freedom_ranges.find_postures(scene, targets, target_indices)
    sampled_targets = select_targets(targets, target_indices)
    nominal = scene.tcp_poses(
        dataclasses.replace(sampled_targets, track_positions={}), sampled_targets.neutral_values()
    )
    edge = scene.edge_points(sampled_targets, np.arange(sampled_targets.count))
    target_entries, wires, postures = [], [], []
    for k, (target_index, posture_or_faults) in enumerate(zip(target_indices.tolist(), results, strict=True)):
        has_posture = isinstance(posture_or_faults, dict)
        points = {arm: nominal[arm][k, :3, 3] for arm in targets.arms}
        if isinstance(posture_or_faults, dict):
            chains = scene.at_target(targets, target_index).chains
            points = {
                arm: chains[arm].pose(joints_by_arm)[:3, 3]
                for arm, joints_by_arm in posture_or_faults.items()
            }
            postures.append(posture_or_faults)
            if edge is not None:
                wires.append(np.round(edge[k, spread_rows(edge.shape[1], WIRE_POINT_COUNT)] / MM, 1).tolist())
        target_entries.append(
            {
                "index": target_index,
                "name": targets.name(target_index),
                "points_mm": {arm: _numbers(point / MM) for arm, point in points.items()},
                "posture": len(postures) if has_posture else None,
                "faults": [] if isinstance(posture_or_faults, dict) else posture_or_faults,
            }
        )
    joints_by_arm = {
        arm: np.concatenate([home_joints, *(posture.get(arm, home_joints[0])[None] for posture in postures)])
        for arm, home_joints in home.items()
    }
    fields: dict[str, Any] = {
        "of": targets.count,
        "thinned": targets.is_subsampled,
        "targets": target_entries,
        "joints_deg": {
            arm: np.round(home_joints / DEG, 3).tolist() for arm, home_joints in joints_by_arm.items()
        },
    }
    return (fields | {"wires_mm": wires} if wires else fields), joints_by_arm


def _track_bases(
    sampled: _SampledOperation, target_entries: Sequence[Mapping[str, Any]]
) -> dict[str, FloatArray]:
    """Return the base poses {arm: (1 + P, 4, 4)} of arms on coordinated tracks.

    The first pose is that at the station. The others are those at the P targets with a posture, in order.
    """
    target_indices = np.array(
        [target["index"] for target in target_entries if target["posture"] is not None], dtype=np.intp
    )
    bases = {}
    for name, values in sampled.targets.track_positions.items():
        arm = sampled.setup.cell.arm(name)
        bases[name] = scenes.track_base(arm, np.append(arm.track_position or 0.0, values[target_indices]))
    return bases


def _freedom_map_fields(freedom_map: freedom_ranges.ReachableFreedomMap) -> dict[str, Any]:
    """Convert a freedom map to the fields of :class:`planner.service.cell_models.FreedomMap` but ``path``."""
    grid = freedom_map.grid
    unit, scale = freedom_ranges.DISPLAY_UNITS[freedom_map.unit]
    return {
        "freedom": freedom_map.freedom,
        "unit": unit,
        "values": np.round(freedom_map.values / scale, 6).tolist(),
        "states": {arm: arm_values.tolist() for arm, arm_values in grid.state.items()},
        "codes": list(freedom_ranges.ISSUE_CODES),
        "limit_deg": {arm: _rounded_rows(arm_values / DEG) for arm, arm_values in grid.limit.items()},
        "singular_deg": {arm: _rounded_rows(arm_values / DEG) for arm, arm_values in grid.singular.items()},
        "clearance_mm": _rounded_rows(freedom_map.clearance / MM),
        "pairs": [[" and ".join(pair) if all(pair) else "" for pair in row] for row in grid.pair],
    }


def _reach_fields(sampled: _SampledOperation) -> dict[str, Any]:
    """Compute the reach of each arm over the block, or nothing if the operation has no reach field."""
    stock = sampled.setup.stock
    field = reach_field.compute_reach_field(sampled.scene, sampled.targets, stock.lower, stock.upper)
    if field is None:
        return {}
    return {
        "reach": {
            "points_mm": np.round(field.points / MM, 1).tolist(),
            "pitch_mm": _numbers(field.pitch / MM),
            "states": {arm: states.tolist() for arm, states in field.state.items()},
            "codes": list(freedom_ranges.ISSUE_CODES),
            "targets": field.targets,
            "samples": field.samples,
        }
    }


def _plan_path_fields(
    sampled: _SampledOperation,
    operation: int,
    freedom_map: freedom_ranges.ReachableFreedomMap,
    plan: Plan | None,
) -> dict[str, Any]:
    """Return the values that a plan gave to the freedom of a map, as the line that is drawn over the map.

    The field ``path`` has one value for each sampled target, in the display unit, and None at targets that
    are missing in the plan. The result is empty if there is no plan of this operation, if poses of targets
    with equal names differ, or if the plan contains none of the values.
    """
    if plan is None or operation >= len(plan.operations):
        return {}
    planned = plan.operations[operation]
    plan_row_by_name = {planned.targets.name(row): row for row in range(planned.targets.count)}
    plan_rows = [plan_row_by_name.get(sampled.targets.name(row)) for row in sampled.rows.tolist()]
    freedom_names = [freedom.name for freedom in planned.targets.freedoms]
    plan_values: list[float | None] = []
    for row, plan_row in zip(sampled.rows.tolist(), plan_rows, strict=True):
        if plan_row is None:
            plan_values.append(None)
            continue
        for arm, pose in sampled.targets.pose.items():
            if arm not in planned.targets.pose or not np.allclose(
                pose[row], planned.targets.pose[arm][plan_row]
            ):
                return {}
        if freedom_map.freedom in freedom_names:
            plan_values.append(float(planned.values[plan_row, freedom_names.index(freedom_map.freedom)]))
        elif freedom_map.freedom.startswith(freedom_ranges.STOCK_SHIFT_PREFIX):
            axis = freedom_ranges.STOCK_SHIFT_AXES.index(
                freedom_map.freedom.removeprefix(freedom_ranges.STOCK_SHIFT_PREFIX)
            )
            plan_values.append(
                float((plan.stock_poses[sampled.setup.number - 1] - sampled.stock_pose)[axis, 3])
            )
    scale = freedom_ranges.DISPLAY_UNITS[freedom_map.unit][1]
    path = [None if value is None else round(value / scale, 6) for value in plan_values]
    return {"path": path} if any(value is not None for value in path) else {}


def _rounded_rows(table: FloatArray) -> list[list[float | None]]:
    """Round a table to one decimal. Values that are not finite become None."""
    return [[round(float(v), 1) if np.isfinite(v) else None for v in row] for row in table]


def _pose_rows(poses: FloatArray) -> list[list[float]]:
    """Return poses (B, 4, 4) [m] as twelve numbers each: the upper three matrix rows, positions in mm."""
    rows = np.array(poses[:, :3, :], dtype=np.float64)
    rows[..., 3] /= MM
    return [[round(float(v), 5) for v in row] for row in rows.reshape(len(rows), 12)]


def _numbers(values: FloatArray) -> list[float]:
    """Round an array (N,) to three decimals."""
    return [round(float(value), 3) for value in values]
