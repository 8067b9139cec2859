"""The springback file of a problem, as the proof reads it, and the tools without its shifts.

For each pass the file has the path of the forming tool and the shift S by which tools are deeper there. So
the commanded path is the polyline of its points, each deeper by its S. The nearest point on that polyline
gives S for a replayed position. Tools moved back by S along z are *released*: they have the positions that
they would have in a sheet that does not yield. A replayed path that deviates from the file's path keeps its
deviation when it is released, because S changes by at most a stated slope.
"""

import dataclasses
import hashlib
import json
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import FloatArray, IntArray, Mesh
from planner.geometry.units import MM
from planner.problem import Problem, Setup, Sheet
from planner.tooling import FormingTool

MARK_SPACING_M = 4e-4
"""Maximum spacing [m] of the marks on a path, which are points for the search of the nearest piece."""
NEAREST_MARKS = 5
"""Number of marks nearest to a position whose pieces of the path are checked first."""
POSITIONS_AT_ONCE = 100_000
"""Number of positions that are evaluated at once."""
SHIFT_ROUNDING_M = 3e-8
"""Maximum difference [m] of two rounded shifts."""
CURVE_TOLERANCE_FRACTION = 0.01
"""Maximum relative deviation of the springback of a control point from its own curve: values are rounded."""
MIN_POWER, MAX_POWER = 0.25, 4.0
"""From load to load springback grows with powers of the force from 0.25, less than a membrane's third, to 4,
where a sheet is about to snap.
"""
MAX_COORDINATE_M, MAX_PATH_LENGTH_M = 100.0, 5_000.0
"""Maximum coordinate, and maximum length of a path [m]."""
MAX_FILE_BYTES = 100_000_000
"""Maximum size [bytes] of a file."""
RIGID_TOLERANCE = 1e-6
"""Tolerance within which a pose is a rotation and a translation."""


@dataclasses.dataclass(frozen=True)
class FileControlPoint:
    """A control point of the file.

    Attributes:
        segment: Name of the segment.
        level: Number of its level in the segment.
        point: Position (3,) [m] on the face.
        angle: Stated wall angle [rad].
        force: Force [N].
        springback: Springback [m] when that force is released.
        loads: Loads (K,) [N] of its curve, ascending from 0.
        displacement: Displacements (K,) [m] of its curve, ascending from 0.
    """

    segment: str
    level: int
    point: FloatArray
    angle: float
    force: float
    springback: float
    loads: FloatArray
    displacement: FloatArray

    def springback_under(self, force: FloatArray) -> FloatArray:
        """Return the springback [m] under ``force`` [N] by interpolation of the curve.

        Between two loads it is a power law S = a F^b, and linear from 0 to the first load.
        """
        is_below_first_load = force < self.loads[1]
        power = np.interp(
            np.log(np.maximum(force, self.loads[1])), np.log(self.loads[1:]), np.log(self.displacement[1:])
        )
        return np.asarray(
            np.where(is_below_first_load, force / self.loads[1] * self.displacement[1], np.exp(power))
        )

    def fault(self) -> str:
        """Return a text on the fault of its curve, or an empty string if it is valid."""
        loads, displacement = self.loads, self.displacement
        if (
            loads.ndim != 1
            or loads.shape != displacement.shape
            or len(loads) < 3
            or loads[0] != 0.0
            or displacement[0] != 0.0
        ):
            return "has no curve from 0 on"
        if not (np.diff(loads) > 0.0).all() or not (np.diff(displacement) > 0.0).all():
            return "has a curve that does not increase"
        power = np.diff(np.log(displacement[1:])) / np.diff(np.log(loads[1:]))
        if not ((power >= MIN_POWER) & (power <= MAX_POWER)).all():
            low, high = float(power.min()), float(power.max())
            return f"has an implausible curve, with powers {low:.2g} to {high:.2g} of the force"
        curve_springback = float(self.springback_under(np.minimum(self.force, loads[-1])))
        if (
            not abs(curve_springback - self.springback)
            <= CURVE_TOLERANCE_FRACTION * self.springback + 10.0 * SHIFT_ROUNDING_M
        ):
            return f"has {self.springback / MM:.4f} mm, but its curve has {curve_springback / MM:.4f} mm"
        return ""


@dataclasses.dataclass(frozen=True, eq=False)
class FilePath:
    """One pass of the file.

    Attributes:
        point: Path (K, 3) [m] of the forming tool without shifts.
        shift: Shift (K,) [m] of each point into the sheet.
        ring: Index (K,) of the ring, a loop of the path, of each point.
    """

    point: FloatArray
    shift: FloatArray
    ring: IntArray

    def faults(
        self, slope: float, max_shift: float, first: float = 0.0
    ) -> list[tuple[str, float, float, str]]:
        """Return what exceeds the problem's limits.

        Args:
            slope: Maximum slope.
            max_shift: Maximum shift [m].
            first: Required shift [m] at the start.

        Returns:
            For each fault a text, the actual and the allowed value, and their unit.
        """
        out = []
        lowest, highest, start_shift = float(self.shift.min()), float(self.shift.max()), float(self.shift[0])
        if lowest < 0.0:
            out.append(("a shift out of the sheet", lowest / MM, 0.0, "mm"))
        if highest > max_shift:
            out.append(("a shift that is too large", highest / MM, max_shift / MM, "mm"))
        if abs(start_shift - first) > SHIFT_ROUNDING_M:
            out.append(("a wrong shift where the tool reaches the sheet", start_shift / MM, first / MM, "mm"))
        step = np.sqrt(((self.point[1:] - self.point[:-1]) ** 2).sum(axis=1))
        rise = np.maximum(np.abs(self.shift[1:] - self.shift[:-1]) - SHIFT_ROUNDING_M, 0.0)
        steep = rise > slope * step
        if steep.any():
            max_slope = float((rise[steep] / np.maximum(step[steep], 1e-9)).max())
            out.append(("a shift that changes too fast along the path", max_slope, slope, "mm/mm"))
        return out


@dataclasses.dataclass(frozen=True, eq=False)
class ScanData:
    """What a file of adjustments states about the scan from which it was made.

    Attributes:
        digest: SHA-256 of the scan file.
        unit: Unit of the scan's coordinates [m].
        is_top: Whether the scan is of the top face of the sheet, otherwise of the bottom face.
        pose: Transform (4, 4) from the scan's to the sheet's frame.
        marks: Positions (2, K, 3) [m] of marks in the sheet's and in the scan's frame.
        gain: Fraction of the measured deviation by which shifts are adjusted.
        adjusts: Names of the passes that the file adjusts.
    """

    digest: str
    unit: float
    is_top: bool
    pose: FloatArray
    marks: FloatArray
    gain: float
    adjusts: frozenset[str]


def _read_scan_data(data: dict[str, Any]) -> ScanData:
    """Read the scan data from the parsed file of adjustments.

    Invalid data raise ``ValueError``, ``KeyError``, ``TypeError`` or ``IndexError``.
    """
    scan = data["scan"]
    pose = np.array(scan["pose"], dtype=np.float64)
    mark_pairs = [[mark[1], mark[2]] for mark in scan["marks"]]  # without the name, mark[0]
    marks = np.array(mark_pairs, dtype=np.float64).reshape(-1, 2, 3).transpose(1, 0, 2) * MM
    if pose.shape != (4, 4) or not np.isfinite(pose).all() or not np.isfinite(marks).all():
        raise ValueError("the position of its scan is no pose")
    rotation = pose[:3, :3]
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > RIGID_TOLERANCE or np.linalg.det(rotation) < 0.0:
        raise ValueError("the position of its scan is no rotation and translation")
    if np.abs(pose[3] - [0.0, 0.0, 0.0, 1.0]).max() > 0.0:
        raise ValueError("the position of its scan is no pose")
    gain = float(data["gain"])
    if not 0.0 < gain <= 1.5 or scan["face"] not in ("top", "bottom"):
        raise ValueError("its gain or the face of its scan is invalid")
    adjusts = frozenset(str(name) for name in data["adjusts"])
    return ScanData(
        str(scan["sha256"]), float(scan["unit_m"]), scan["face"] == "top", pose, marks, gain, adjusts
    )


@dataclasses.dataclass(frozen=True)
class SpringbackFileData:
    """Data of a springback file, or of a file of adjustments.

    Attributes:
        belongs: Values that identify the job to which the file belongs, by name.
        controls: Control points; none in a file of adjustments.
        paths: Paths by the segments' names.
        measured: Scan data of a file of adjustments, otherwise None.
        previous_paths: Paths with which the scanned part was formed, by the segments' names.
    """

    belongs: dict[str, Any]
    controls: tuple[FileControlPoint, ...]
    paths: dict[str, FilePath]
    measured: ScanData | None = None
    previous_paths: dict[str, FilePath] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class LevelFileData:
    """Data of a file of a single level.

    Attributes:
        belongs: Values that identify the job to which the file belongs, by name.
        plan: The plan of levels to which the file belongs.
        name: Name of the pass.
        number: Number of the level.
        path: Path of the level.
    """

    belongs: dict[str, Any]
    plan: Any
    name: str
    number: Any
    path: FilePath


def _read_checked_json(path: Path) -> Any:
    """Parse a JSON file whose last entry is the SHA-256 of the text before it.

    A file that cannot be read or parsed, or whose checksum is wrong, raises ``ValueError`` with the fault.
    """
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise ValueError("it is too large")
        content = path.read_bytes()
    except OSError as error:
        raise ValueError(f"it cannot be read ({error.strerror})") from None
    checksum_start = content.rfind(b'"sha256": "')
    checksum_text = content[checksum_start + 11 :] if checksum_start >= 0 else b""
    if len(checksum_text.rstrip()) < 66 or checksum_text.rstrip()[64:] not in (b'"\n}', b'"}'):
        raise ValueError("it is truncated: its last line states no checksum")
    if hashlib.sha256(content[:checksum_start]).hexdigest().encode() != checksum_text[:64]:
        raise ValueError("its text does not match its checksum")
    try:
        return json.loads(content.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"it cannot be parsed: {type(error).__name__} {error}") from None


def read_level_data(path: Path) -> LevelFileData:
    """Read the file of a single level.

    Raises:
        ValueError: If the file cannot be read or is invalid; the message states its fault.
    """
    data = _read_checked_json(path)
    try:
        if data["tandem_level"] != 1:
            raise ValueError("it has another version")
        (entry,) = data["passes"]
        data_of_level = LevelFileData(
            dict(data["belongs_to"]),
            data["plan"],
            str(entry["name"]),
            data["level"],
            _read_path(entry["rings"]),
        )
        count = int(data["points"])
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
        raise ValueError(f"it cannot be parsed: {type(error).__name__} {error}") from None
    if count != len(data_of_level.path.point):
        raise ValueError("its number of points differs from the stated one")
    return data_of_level


def read_springback_data(path: Path) -> SpringbackFileData:
    """Read a springback file, or a file of adjustments from a scan.

    Raises:
        ValueError: If the file cannot be read or is invalid; the message states its fault.
    """
    data = _read_checked_json(path)
    if isinstance(data, dict) and data.get("tandem_adjustment") == 2:
        return _read_adjustment(data)
    if not isinstance(data, dict) or data.get("tandem_springback") != 2:
        raise ValueError("it has another version")
    try:
        paths = {str(item["name"]): _read_path(item["rings"]) for item in data["passes"]}
        controls = tuple(
            FileControlPoint(
                str(row["pass"]),
                int(row["level"]),
                np.array([float(row[f"{axis}_mm"]) for axis in "xyz"]) * MM,
                float(np.deg2rad(row["wall_deg"])),
                float(row["force_n"]),
                float(row["springback_mm"]) * MM,
                np.array(row["forces_n"], dtype=np.float64),
                np.array(row["displacements_mm"], dtype=np.float64) * MM,
            )
            for row in data["control_points"]
        )
        belongs, count = dict(data["belongs_to"]), int(data["points"])
        for control in controls:
            values = [
                *control.point,
                control.force,
                control.springback,
                control.angle,
                *control.loads.ravel(),
                *control.displacement.ravel(),
            ]
            if not np.isfinite(values).all():
                raise ValueError("a control point has no finite values")
            if control.fault():
                raise ValueError(f"a control point of {control.segment} {control.fault()}")
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
        raise ValueError(f"it cannot be parsed: {type(error).__name__} {error}") from None
    if count != sum(len(path_of_pass.point) for path_of_pass in paths.values()) or len(paths) != len(
        data["passes"]
    ):
        raise ValueError("its number of points differs from the stated one")
    if not controls:
        raise ValueError("a control point has no finite values")
    return SpringbackFileData(belongs, controls, paths)


def _read_adjustment(data: dict[str, Any]) -> SpringbackFileData:
    """Read the parsed file of adjustments; invalid data raise ``ValueError`` with the fault."""
    try:
        paths, previous_paths = (
            {str(entry["name"]): _read_path(entry["rings"]) for entry in data[k]}
            for k in ("passes", "before")
        )
        result = SpringbackFileData(
            dict(data["belongs_to"]), (), paths, _read_scan_data(data), previous_paths
        )
        count = int(data["points"])
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError, IndexError) as error:
        raise ValueError(f"it cannot be parsed: {type(error).__name__} {error}") from None
    if count != sum(len(path.point) for path in paths.values()) or len(paths) != len(data["passes"]):
        raise ValueError("its number of points differs from the stated one")
    return result


def _read_path(rings: list[list[list[float]]]) -> FilePath:
    """Read the path of a pass from its rings, whose points are x, y, z and the shift [mm]."""
    tables = [np.array(ring, dtype=np.float64).reshape(-1, 4) * MM for ring in rings]
    ring_index = np.concatenate([np.full(len(table), k) for k, table in enumerate(tables)])
    points_and_shifts = np.concatenate(tables)
    if len(points_and_shifts) < 2 or not np.isfinite(points_and_shifts).all():
        raise ValueError("a pass has no path")
    if (
        np.abs(points_and_shifts).max() > MAX_COORDINATE_M
        or np.sqrt((np.diff(points_and_shifts[:, :3], axis=0) ** 2).sum(axis=1)).sum() > MAX_PATH_LENGTH_M
    ):
        raise ValueError(
            f"a pass goes farther than {MAX_COORDINATE_M:g} m or is longer than {MAX_PATH_LENGTH_M:g} m"
        )
    return FilePath(points_and_shifts[:, :3], points_and_shifts[:, 3], ring_index)


def job_identity_of(problem: Problem, setup: Setup, operation: Any) -> dict[str, Any] | None:
    """Return the values that identify the job of an operation, by name, which its file has to state.

    The result is None if the problem has no formed part or the setup has no sheet.
    """
    part, sheet = problem.part, setup.stock.sheet
    if part is None or part.formed is None or sheet is None:
        return None
    tools = {}
    for arm in operation.arms:
        tool = setup.cell.arm(arm).tool
        if isinstance(tool, FormingTool):
            tools[arm] = (tool.head.kind, tool.head.radius)
    return _expected_identity(operation, setup.stock.size, sheet, part.formed.source, tools)


def differing_names(file_identity: Mapping[str, Any], own_identity: Mapping[str, Any]) -> list[str]:
    """Return the names under which the values of a file and of the job differ, or one of them is missing."""
    return [
        name
        for name in sorted({*own_identity, *file_identity})
        if file_identity.get(name, "none") != own_identity.get(name, "none")
    ]


def _expected_identity(
    operation: Any, size: FloatArray, sheet: Sheet, mesh: Mesh, tools: dict[str, Any]
) -> dict[str, Any]:
    """Return the values that identify a job, by name, as a file states them.

    ``size`` (3,) [m] and ``sheet`` are those of the stock, ``mesh`` is the part as given, and ``tools`` has
    the kind and the radius [m] of each arm's tool.
    """
    metal = sheet.metal
    nanometres = [np.rint(table * 1e9).astype("<i8") for table in (mesh.vertices, sheet.opening)]
    mesh_digest = hashlib.sha256(nanometres[0].tobytes() + mesh.faces.astype("<i8").tobytes()).hexdigest()
    border = sheet.border * MM * MM
    out: dict[str, Any] = {
        "part": mesh_digest[:32],
        "sheet.size_mm": [_round_nine_digits(value_m / MM) for value_m in size.tolist()],
        "sheet.metal": metal.name,
        "sheet.young_gpa": _round_nine_digits(metal.young / 1e9),
        "sheet.poisson": _round_nine_digits(metal.poisson),
        "sheet.tensile_mpa": _round_nine_digits(metal.tensile_stress / 1e6),
        "sheet.opening": hashlib.sha256(nanometres[1].tobytes()).hexdigest()[:32],
        "clamp.border_n_mm2": _round_nine_digits(border) if np.isfinite(border) else "immovable",
    }
    for arm, (kind, radius) in tools.items():
        out[f"tool.{arm}"] = [kind, _round_nine_digits(radius / MM)]
    for name in OPERATION_FIELDS:
        value = getattr(operation, name)
        out[f"operation.{name}"] = [*value] if isinstance(value, tuple) else value
    stated = operation.force_by
    if stated is not None and stated.file is None:
        out["operation.force_by"] = [[float(z), float(n)] for z, n in stated.table]
    elif stated is not None:
        out["operation.force_by"] = _digest_of(Path(stated.file))
    if operation.support_force_n is not None:
        out["operation.support_force_n"] = operation.support_force_n
    return out


def _digest_of(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()[:32]
    except OSError as error:
        return f"not read ({error.strerror})"


OPERATION_FIELDS = (
    *("mode", "side", "path", "stepdown_mm", "scallop_mm", "strategy", "order"),
    *("passes", "angle_step_deg", "repeats", "force_n"),
)
"""Fields of an operation that determine the springback of its sheet and the positions of its loops."""


def _round_nine_digits(value: float) -> float:
    return float(f"{value:.9g}")


class ShiftLookup:
    """Lookup of the shifts of one pass by positions on its commanded path, which includes the shifts.

    ``side`` is +1 if the forming tool is above the sheet, -1 below.
    """

    def __init__(self, path: FilePath, side: int) -> None:
        self.path, self.side = path, side
        knots = path.point.copy()
        knots[:, 2] -= side * path.shift
        self._start, self._moves = knots[:-1], np.diff(knots, axis=0)
        self._square = np.maximum((self._moves**2).sum(axis=1), 1e-24)
        count = np.maximum(np.ceil(np.sqrt(self._square) / MARK_SPACING_M), 1).astype(np.int64)
        self._owner = np.repeat(np.arange(len(count)), count)
        fraction = (np.arange(len(self._owner)) - np.repeat(np.cumsum(count) - count, count) + 0.5) / count[
            self._owner
        ]
        self._marks = self._start[self._owner] + fraction[:, None] * self._moves[self._owner]

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self._marks)

    def shift_and_distance(self, positions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the shifts at replayed positions, and their distances from the commanded path.

        Args:
            positions: Positions (N, 3) [m] of the forming tool in the sheet's frame.

        Returns:
            Shifts (N,) [m] at the nearest points of the commanded path, and distances (N,) [m] from these.
        """
        shift, distance = np.empty(len(positions)), np.empty(len(positions))
        for start in range(0, len(positions), POSITIONS_AT_ONCE):
            rows = slice(start, start + POSITIONS_AT_ONCE)
            shift[rows], distance[rows] = self._shift_and_distance_chunk(positions[rows])
        return shift, distance

    def _shift_and_distance_chunk(self, positions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return shifts and distances (N,) [m] of some positions, as :meth:`shift_and_distance` does.

        Marks are points on the pieces of the path. The pieces with the nearest marks are compared, and then
        pieces with twice as many marks wherever a farther mark may belong to a nearer piece.
        """
        shift, distance = np.empty(len(positions)), np.empty(len(positions))
        remaining, count = np.arange(len(positions)), min(NEAREST_MARKS, len(self._marks))
        while len(remaining):
            mark_distance, marks = (
                np.asarray(result).reshape(len(remaining), -1)
                for result in self._tree.query(positions[remaining], k=count)
            )
            shift[remaining], distance[remaining] = self._nearest(positions[remaining], self._owner[marks])
            # where paths are close to one another, the nearest piece may have none of the nearest marks
            is_undecided = mark_distance[:, -1] < distance[remaining] + 0.5 * MARK_SPACING_M
            remaining = remaining[is_undecided] if count < len(self._marks) else remaining[:0]
            count = min(2 * count, len(self._marks))
        return shift, distance

    def _nearest(self, positions: FloatArray, piece: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return the shifts and distances (N,) [m] of the points nearest to positions (N, 3) [m].

        ``piece`` (N, M) are the indices of the pieces of the path that are compared with each position.
        """
        rest = positions[:, None] - self._start[piece]
        fraction = np.clip((rest * self._moves[piece]).sum(axis=2) / self._square[piece], 0.0, 1.0)
        away = np.sqrt(((rest - fraction[..., None] * self._moves[piece]) ** 2).sum(axis=2))
        best = away.argmin(axis=1)[:, None]
        piece, fraction, away = (
            np.take_along_axis(array, best, axis=1)[:, 0] for array in (piece, fraction, away)
        )
        path_shift = self.path.shift
        return path_shift[piece] + fraction * (path_shift[piece + 1] - path_shift[piece]), away
