"""Where and how clearance is measured along a motion.

Cheap bounds decide most samples. True distances are computed where bounds do not suffice, and by Drake
where bodies are nearest.
"""

import dataclasses
import itertools
from collections.abc import Mapping

import numpy as np

from planner.cell import clearance
from planner.cell.clearance import Pairs
from planner.cell.plant import CellModel
from planner.geometry.arrays import FloatArray, IntArray, Shape
from planner.issues import issue_error
from planner.problem import Setup
from planner.proof.context import Context
from planner.proof.kinematics import arm_model, offset_arm, parallel_arm
from planner.tooling import working_solid

MAX_SAMPLE_STRIDE_M = 0.012
"""Maximum path [m] of any point of an arm between queries, limited by the required clearance.
Bodies that keep the clearance at two queries do not touch between them, as long as it exceeds
``MIN_SAMPLE_STRIDE_M``.
"""
MIN_SAMPLE_STRIDE_M = 0.003
"""Smallest stride [m] between two queries. It holds even if the required clearance is smaller."""
MAX_FULLY_MEASURED = 20_000
"""Number of queries up to which all distances are measured. With more queries, a quarter of this number,
evenly spread, and all undecided queries are measured.
"""
QUERIES_PER_BATCH = 2000
"""Number of queries per batch, after which the number of violations is checked."""
MAX_NEAREST_QUERIES = 50_000
"""Maximum number of queries that are measured to find the smallest distance if none is undecided."""
DISTANCE_PRECISION_M = 1e-5
"""Precision [m] of the smallest distance if no query is undecided."""
MAX_UNDECIDED = 250_000
"""Maximum number of queries that bounds leave undecided. A motion with more is refused."""
MAX_VIOLATIONS = 1000
"""Number of violations after which no more undecided queries are measured."""
DRAKE_QUERIES = 32
"""Number of queries that Drake measures, too: as many with the smallest distances, and as many evenly
spread.
"""


@dataclasses.dataclass(frozen=True)
class ClearanceMeasurement:
    """Measured distances between the bodies of a cell.

    Attributes:
        rows: Ascending indices (K,) of the measured queries.
        min_clearance: Smallest distance [m], and its pair of bodies, at each of them.
        unmeasured_bound: Lower bound [m] of the distance at all other queries, infinite without any. None of
            them is below the limit, unless there are so many violations that the search ended.
    """

    rows: IntArray
    min_clearance: clearance.MinClearance
    unmeasured_bound: float


def clearance_samples(context: Context, index: int, itself: bool = False) -> IntArray:
    """Return the indices (K,) of the samples of setup ``index`` at which clearance is queried.

    Between two of them the paths of all arms add up to at most the stride: the required clearance, within
    ``MIN_SAMPLE_STRIDE_M`` and ``MAX_SAMPLE_STRIDE_M``. The path of an arm is that of its fastest point, with
    its tool, with what it holds, and with its coordinated track. For the clearance of each arm to ``itself``
    only the longest path of one arm counts, without tracks.
    """
    rows = np.flatnonzero(context.sample_setup == index)
    if not len(rows):
        return rows
    # path (M,) [m]: path from the previous sample to each of the M samples of the setup, 0 at the first.
    required, path = context.problem.settings.clearance, np.zeros(len(rows))
    for task in context.job.tasks:
        arm_path = max_point_path(context, index, task.arm.name, rows)
        track_path = context.motion.track_positions.get(task.arm.name)
        if track_path is not None and not itself:
            arm_path = arm_path + np.abs(np.diff(track_path[rows]))
        path[1:] = np.maximum(path[1:], arm_path) if itself else path[1:] + arm_path
    if itself:
        required = context.problem.settings.self_clearance
    along = np.cumsum(path)
    # The stride is the required clearance, within the two bounds.
    count = max(int(np.ceil(along[-1] / min(MAX_SAMPLE_STRIDE_M, max(required, MIN_SAMPLE_STRIDE_M)))), 1)
    marks = np.searchsorted(along, np.linspace(0.0, along[-1], count + 1))
    return rows[np.unique(np.clip(marks, 0, len(along) - 1))]


def measure_min_distances(
    model: CellModel, q: Mapping[str, FloatArray], limit: float, reach: float, ignore: Pairs
) -> ClearanceMeasurement:
    """Measure the smallest distance between the bodies of a cell at many queries.

    Up to ``MAX_FULLY_MEASURED`` queries are all measured. Of more queries, those are measured whose distance
    may be below the limit, those whose distance may be the smallest, and evenly spread ones. The search for
    the first ends after ``MAX_VIOLATIONS`` violations.

    Args:
        model: Model of the cell.
        q: Joints {arm: (B, 6)} of the queries.
        limit: Required distance [m].
        reach: Range [m] within which bodies are considered.
        ignore: Pairs of bodies that are not measured.

    Raises:
        TandemError: Too many queries are undecided (``verify.duration``).
    """
    count = max((len(rows) for rows in q.values()), default=0)
    if count <= MAX_FULLY_MEASURED:
        measured_rows = np.arange(count)
        distances = clearance.min_clearance(model, q, reach, ignore)
        return ClearanceMeasurement(
            measured_rows, _checked_with_drake(model, q, reach, ignore, measured_rows, distances), np.inf
        )
    measured = _MeasuredQueries(model, q, reach, ignore, count)
    measured.measure(np.unique(np.linspace(0, count - 1, MAX_FULLY_MEASURED // 4).astype(np.int64)))
    # lower (B,) [m]: lower bounds of the distances. Neither the limit nor the smallest distance exceeds
    # max_needed, so that range suffices for them, and bounds with a short range are fast.
    max_needed = max(limit, float(np.nanmin(measured.distance, initial=reach)))
    lower = clearance.distance_lower_bound(
        model, q, min(reach, max_needed + 2.0 * clearance.BOUND_ERROR), ignore
    )
    lower[~np.isfinite(model.stack_rows(q)).all(axis=1)] = -np.inf
    undecided = np.flatnonzero(lower < limit)
    for first in range(0, len(undecided), QUERIES_PER_BATCH):
        if np.count_nonzero(measured.distance < limit) > MAX_VIOLATIONS:
            break
        if first >= MAX_UNDECIDED:
            message = f"clearance is undecided at {len(undecided)} of {count} queries"
            message = f"{message}; allowed: {MAX_UNDECIDED}. Split the job"
            raise issue_error("verify.duration", message, value=len(undecided), limit=MAX_UNDECIDED)
        measured.measure(undecided[first : first + QUERIES_PER_BATCH])
    # Measure queries by ascending bound, until no unmeasured one can be nearer than the nearest measured one.
    order = np.argsort(lower, kind="stable")
    for first in range(0, MAX_NEAREST_QUERIES, QUERIES_PER_BATCH):
        nearest = order[first : first + QUERIES_PER_BATCH]
        # Bounds are lower than distances by up to BOUND_ERROR.
        if (
            not len(nearest)
            or lower[nearest[0]] + clearance.BOUND_ERROR
            >= np.nanmin(measured.distance) - DISTANCE_PRECISION_M
        ):
            break
        measured.measure(nearest)
    remaining = lower[~measured.done] + clearance.BOUND_ERROR
    measured_rows, distances = measured.result()
    distances = _checked_with_drake(model, q, reach, ignore, measured_rows, distances)
    return ClearanceMeasurement(measured_rows, distances, float(remaining.min(initial=np.inf)))


def _checked_with_drake(
    model: CellModel,
    q: Mapping[str, FloatArray],
    reach: float,
    ignore: Pairs,
    measured_rows: IntArray,
    distances: clearance.MinClearance,
) -> clearance.MinClearance:
    """Return measured distances after a comparison of the smallest ones and some others with Drake's.

    Drake's distances come from independent code and are never below the true ones. Where they are smaller,
    they replace the measured distances.
    """
    spread = (
        np.linspace(0, len(measured_rows) - 1, DRAKE_QUERIES).astype(np.int64)
        if len(measured_rows)
        else measured_rows
    )
    chosen = np.union1d(np.argsort(distances.distance, kind="stable")[:DRAKE_QUERIES], spread)
    drake = clearance.drake_min_clearance(
        model.at_rows(measured_rows[chosen]),
        {arm: rows[measured_rows[chosen]] for arm, rows in q.items()},
        reach,
        ignore,
    )
    closer = np.flatnonzero(drake.distance < distances.distance[chosen] - DISTANCE_PRECISION_M)
    distance, pairs = distances.distance.copy(), list(distances.pair)
    for k in closer.tolist():
        distance[chosen[k]], pairs[chosen[k]] = drake.distance[k], drake.pair[k]
    return clearance.MinClearance(distance, tuple(pairs))


class _MeasuredQueries:
    """Distances of the queries that were measured so far.

    The arguments are those of :func:`measure_min_distances`; ``count`` is the number B of queries.

    Attributes:
        distance: Distance (B,) [m] at each query, NaN where it was not measured.
        done: Whether each query was measured (B,).
        pair: Nearest pair of bodies at each measured query, by the index of the query.
    """

    def __init__(
        self, model: CellModel, q: Mapping[str, FloatArray], reach: float, ignore: Pairs, count: int
    ) -> None:
        self.model, self.q, self.reach, self.ignore = model, q, reach, ignore
        self.distance = np.full(count, np.nan)
        self.done = np.zeros(count, dtype=bool)
        self.pair: dict[int, tuple[str, str]] = {}

    def measure(self, queries: IntArray) -> None:
        """Measure those of the given queries that have not been measured yet."""
        queries = queries[~self.done[queries]]
        if not len(queries):
            return
        distances = clearance.min_clearance(
            self.model.at_rows(queries),
            {arm: rows[queries] for arm, rows in self.q.items()},
            self.reach,
            self.ignore,
        )
        self.distance[queries], self.done[queries] = distances.distance, True
        self.pair.update(zip(queries.tolist(), distances.pair, strict=True))

    def result(self) -> tuple[IntArray, clearance.MinClearance]:
        """Return the indices (K,) of the measured queries, and their distances."""
        measured_rows = np.flatnonzero(self.done)
        return measured_rows, clearance.MinClearance(
            self.distance[measured_rows], tuple(self.pair[int(i)] for i in measured_rows)
        )


def max_point_path(
    context: Context, index: int, arm: str, rows: IntArray | slice = slice(None)
) -> FloatArray:
    """Return an upper bound (M - 1,) [m] of the path of any point of an arm between samples ``rows`` (M,).

    It is the sum over the axes of the rotation, times the distance of the farthest point from the axis.
    """
    reach, q = max_point_distances(context, index, arm), context.motion.link_joints[arm]
    # One axis at a time to limit the memory of long motions.
    return np.asarray(sum(reach[axis] * np.abs(np.diff(q[rows, axis])) for axis in range(q.shape[1])))


def max_point_distances(context: Context, index: int, arm: str) -> FloatArray:
    """Return upper bounds (J,) [m] of the distance of any point of an arm, with its tool, from each axis."""
    setup = context.setups[index]
    machine, tool = arm_model.robot_machine(setup.cell.arm(arm).data), _hand_reach(setup, arm)
    if machine.spherical_shape is None:
        if machine.is_followed or len(machine.chain.axis) == 7:
            return offset_arm.max_axis_distances(machine.chain, tool)
        return parallel_arm.max_axis_distances(machine.table, tool)
    # Lengths of the chain beyond each axis, from the base to the flange, plus the reach of the tool.
    p = machine.shape
    hand = abs(p.c4) + float(np.linalg.norm(p.right[:3, 3])) + tool
    forearm = float(np.hypot(p.a2, p.c3))
    return np.array(
        [abs(p.a1) + p.c2 + forearm + hand, p.c2 + forearm + hand, forearm + hand, hand, hand, tool]
    )


def _hand_reach(setup: Setup, arm: str) -> float:
    """Return the maximum distance [m] from the flange of any point of the tool, or of a block that it holds.

    At least 50 mm beyond the TCP are counted.
    """
    tool, stock = setup.cell.arm(arm).tool, setup.stock
    distances = [float(np.linalg.norm(tool.tcp[:3, 3])) + 0.05]
    solid = working_solid(tool)
    shapes = tool.shapes if solid is None else (*tool.shapes, solid)
    distances += [float(np.linalg.norm(shape.pose[:3, 3])) + _bounding_radius(shape) for shape in shapes]
    if stock.held_by == arm:
        corners = np.array(list(itertools.product(*zip(stock.lower, stock.upper, strict=True))))
        pose = tool.tcp @ stock.grip
        distances.append(float(np.linalg.norm(corners @ pose[:3, :3].T + pose[:3, 3], axis=1).max()))
    return max(distances)


def _bounding_radius(shape: Shape) -> float:
    """Return the radius [m] of a sphere about a shape's origin that contains the shape."""
    if shape.vertices is not None:
        return float(np.linalg.norm(shape.vertices, axis=1).max())
    if shape.kind == "box":
        return 0.5 * float(np.linalg.norm(shape.size))
    if shape.kind == "cylinder":
        return float(np.hypot(shape.size[0], 0.5 * shape.size[1]))
    return shape.size[0] + (0.5 * shape.size[1] if shape.kind == "capsule" else 0.0)
