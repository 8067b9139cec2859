"""The springback file of a problem, as the proof reads it, and the tools without what it shifts them by.

The file says of each pass where the former's path is and by how much S tools are deeper there, so the way
that is commanded is the polyline of its points, each lower by its S. Of a replayed place the nearest one on
that polyline tells S, and the tools less S along z are the *released* ones: where they would be in a sheet
that does not give way. A way that is elsewhere than the file's stays as far off as it is, for S changes by a
stated slope at most.
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

MARKS = 4e-4
"""Marks on a way are so far apart [m] at most."""
NEAREST_MARKS = 5
"""Marks nearest to a place whose pieces of the way are looked at, first."""
AT_ONCE = 100_000
"""Places that are looked at once."""
ROUNDING = 3e-8
"""Shifts are rounded by no more [m], two of them."""
OFF_CURVE = 0.01
"""Springback of a control point is off its own curve by this share at most: figures are rounded."""
LEAST_POWER, MOST_POWER = 0.25, 4.0
"""From load to load springback grows with powers of the force from 0.25, a membrane's third and less, to 4,
where a sheet is about to snap."""
FARTHEST, LONGEST = 100.0, 5_000.0
"""Coordinates and lengths of ways at most [m]."""
LARGEST = 100_000_000
"""Bytes of a file at most."""
RIGID = 1e-6
"""A pose is a turn and a way within this."""


@dataclasses.dataclass(frozen=True)
class Control:
    """A control point of the file: the ``segment``'s name, its ``level``, ``place`` (3,) [m] on the face, the
    ``angle`` [rad] of the wall that it states, ``force`` [N] and ``springback`` [m]; its curve, of ``loads``
    (K,) [N], from 0, and ``moved`` (K,) [m]."""

    segment: str
    level: int
    place: FloatArray
    angle: float
    force: float
    springback: float
    loads: FloatArray
    moved: FloatArray

    def under(self, force: FloatArray) -> FloatArray:
        """What the sheet comes back by [m] under ``force`` [N]: from load to load a power of it, S = a F^b,
        and a line to the first one."""
        first = force < self.loads[1]
        power = np.interp(
            np.log(np.maximum(force, self.loads[1])), np.log(self.loads[1:]), np.log(self.moved[1:])
        )
        return np.asarray(np.where(first, force / self.loads[1] * self.moved[1], np.exp(power)))

    def fault(self) -> str:
        """What is wrong with its curve, if anything."""
        loads, moved = self.loads, self.moved
        if (
            loads.ndim != 1
            or loads.shape != moved.shape
            or len(loads) < 3
            or loads[0] != 0.0
            or moved[0] != 0.0
        ):
            return "has no curve from 0 on"
        if not (np.diff(loads) > 0.0).all() or not (np.diff(moved) > 0.0).all():
            return "has a curve that does not grow"
        power = np.diff(np.log(moved[1:])) / np.diff(np.log(loads[1:]))
        if not ((power >= LEAST_POWER) & (power <= MOST_POWER)).all():
            low, high = float(power.min()), float(power.max())
            return f"has a curve that grows as no sheet does: by powers {low:.2g} to {high:.2g} of the force"
        at = float(self.under(np.minimum(self.force, loads[-1])))
        if not abs(at - self.springback) <= OFF_CURVE * self.springback + 10.0 * ROUNDING:
            return f"has {self.springback / MM:.4f} mm beside its curve, which has {at / MM:.4f} mm"
        return ""


@dataclasses.dataclass(frozen=True, eq=False)
class Way:
    """Of one pass: ``point`` (K, 3) [m] of the former's path without shifts, ``shift`` (K,) [m] of each, the
    ``ring`` (K,) that it is of."""

    point: FloatArray
    shift: FloatArray
    ring: IntArray

    def faults(self, slope: float, most: float, first: float = 0.0) -> list[tuple[str, float, float, str]]:
        """What of it is beyond the problem's limits, of which ``first`` [m] is the shift that it begins with:
        what, got, allowed, unit."""
        out = []
        low, high, begins = float(self.shift.min()), float(self.shift.max()), float(self.shift[0])
        if low < 0.0:
            out.append(("a shift out of the sheet", low / MM, 0.0, "mm"))
        if high > most:
            out.append(("a shift that is too large", high / MM, most / MM, "mm"))
        if abs(begins - first) > ROUNDING:
            out.append(("another shift where the tool comes to the sheet", begins / MM, first / MM, "mm"))
        step = np.sqrt(((self.point[1:] - self.point[:-1]) ** 2).sum(axis=1))
        rise = np.maximum(np.abs(self.shift[1:] - self.shift[:-1]) - ROUNDING, 0.0)
        steep = rise > slope * step
        if steep.any():
            worst = float((rise[steep] / np.maximum(step[steep], 1e-9)).max())
            out.append(("a shift that changes too fast along the way", worst, slope, "mm/mm"))
        return out


@dataclasses.dataclass(frozen=True, eq=False)
class Measured:
    """What a file of adjustments says of its scan: its ``digest``, ``unit`` [m], whether of the ``top`` face,
    the ``pose`` (4, 4) into the sheet's frame, ``marks`` (2, K, 3) [m] in the sheet's and the scan's frame;
    the ``gain``, and the passes that it ``adjusts``."""

    digest: str
    unit: float
    top: bool
    pose: FloatArray
    marks: FloatArray
    gain: float
    adjusts: frozenset[str]


def _measured(data: dict[str, Any]) -> Measured:
    """The same of a file's values. Raises ``ValueError``, ``KeyError``, ``TypeError``."""
    scan = data["scan"]
    pose = np.array(scan["pose"], dtype=np.float64)
    rows = [[row[1], row[2]] for row in scan["marks"]]
    marks = np.array(rows, dtype=np.float64).reshape(-1, 2, 3).transpose(1, 0, 2) * MM
    if pose.shape != (4, 4) or not np.isfinite(pose).all() or not np.isfinite(marks).all():
        raise ValueError("where its scan lies is no pose")
    turn = pose[:3, :3]
    if np.abs(turn @ turn.T - np.eye(3)).max() > RIGID or np.linalg.det(turn) < 0.0:
        raise ValueError("where its scan lies is no turn and way")
    if np.abs(pose[3] - [0.0, 0.0, 0.0, 1.0]).max() > 0.0:
        raise ValueError("where its scan lies is no pose")
    gain = float(data["gain"])
    if not 0.0 < gain <= 1.5 or scan["face"] not in ("top", "bottom"):
        raise ValueError("its gain or the face of its scan is none")
    adjusts = frozenset(str(name) for name in data["adjusts"])
    return Measured(
        str(scan["sha256"]), float(scan["unit_m"]), scan["face"] == "top", pose, marks, gain, adjusts
    )


@dataclasses.dataclass(frozen=True)
class Given:
    """A file: what it ``belongs`` to by name, its ``controls``, its ``ways`` by the segments' names. Of one
    that was made from a scan: what it says of that, ``measured``, and the ways that the scanned part was
    formed by, ``before``."""

    belongs: dict[str, Any]
    controls: tuple[Control, ...]
    ways: dict[str, Way]
    measured: Measured | None = None
    before: dict[str, Way] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class GivenLevel:
    """A file of one level: what it ``belongs`` to by name, of which ``plan``, ``name`` of a pass and
    ``number`` of its level, and the ``way`` of that."""

    belongs: dict[str, Any]
    plan: Any
    name: str
    number: Any
    way: Way


def _sealed(path: Path) -> Any:
    """What a file whose checksum is right holds. Raises ``ValueError``: what is wrong with it."""
    try:
        if path.stat().st_size > LARGEST:
            raise ValueError("it is too large")
        content = path.read_bytes()
    except OSError as error:
        raise ValueError(f"it cannot be read ({error.strerror})") from None
    at = content.rfind(b'"sha256": "')
    end = content[at + 11 :] if at >= 0 else b""
    if len(end.rstrip()) < 66 or end.rstrip()[64:] not in (b'"\n}', b'"}'):
        raise ValueError("it is cut short: its last line states no checksum")
    if hashlib.sha256(content[:at]).hexdigest().encode() != end[:64]:
        raise ValueError("its text is not the one of its checksum")
    try:
        return json.loads(content.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"it is not read: {type(error).__name__} {error}") from None


def read_level(path: Path) -> GivenLevel:
    """Read the file of one level. Raises ``ValueError``: what is wrong with it."""
    data = _sealed(path)
    try:
        if data["tandem_level"] != 1:
            raise ValueError("it is of another version")
        (one,) = data["passes"]
        found = GivenLevel(
            dict(data["belongs_to"]), data["plan"], str(one["name"]), data["level"], _way(one["rings"])
        )
        count = int(data["points"])
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
        raise ValueError(f"it is not read: {type(error).__name__} {error}") from None
    if count != len(found.way.point):
        raise ValueError("it has another number of points than it says")
    return found


def read(path: Path) -> Given:
    """Read a file. Raises ``ValueError``: what is wrong with it."""
    data = _sealed(path)
    if isinstance(data, dict) and data.get("tandem_adjustment") == 2:
        return _adjustment(data)
    if not isinstance(data, dict) or data.get("tandem_springback") != 2:
        raise ValueError("it is of another version")
    try:
        ways = {str(one["name"]): _way(one["rings"]) for one in data["passes"]}
        controls = tuple(
            Control(
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
        for one in controls:
            figures = [
                *one.place,
                one.force,
                one.springback,
                one.angle,
                *one.loads.ravel(),
                *one.moved.ravel(),
            ]
            if not np.isfinite(figures).all():
                raise ValueError("a control point has no figures")
            if one.fault():
                raise ValueError(f"a control point of {one.segment} {one.fault()}")
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
        raise ValueError(f"it is not read: {type(error).__name__} {error}") from None
    if count != sum(len(way.point) for way in ways.values()) or len(ways) != len(data["passes"]):
        raise ValueError("it has another number of points than it says")
    if not controls:
        raise ValueError("a control point has no figures")
    return Given(belongs, controls, ways)


def _adjustment(data: dict[str, Any]) -> Given:
    try:
        ways, before = (
            {str(one["name"]): _way(one["rings"]) for one in data[k]} for k in ("passes", "before")
        )
        found = Given(dict(data["belongs_to"]), (), ways, _measured(data), before)
        count = int(data["points"])
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError, IndexError) as error:
        raise ValueError(f"it is not read: {type(error).__name__} {error}") from None
    if count != sum(len(way.point) for way in ways.values()) or len(ways) != len(data["passes"]):
        raise ValueError("it has another number of points than it says")
    return found


def _way(rings: list[list[list[float]]]) -> Way:
    tables = [np.array(ring, dtype=np.float64).reshape(-1, 4) * MM for ring in rings]
    ring = np.concatenate([np.full(len(table), k) for k, table in enumerate(tables)])
    both = np.concatenate(tables)
    if len(both) < 2 or not np.isfinite(both).all():
        raise ValueError("a pass has no way")
    if (
        np.abs(both).max() > FARTHEST
        or np.sqrt((np.diff(both[:, :3], axis=0) ** 2).sum(axis=1)).sum() > LONGEST
    ):
        raise ValueError(f"a pass goes farther than {FARTHEST:g} m or is longer than {LONGEST:g} m")
    return Way(both[:, :3], both[:, 3], ring)


def of_job(problem: Problem, setup: Setup, operation: Any) -> dict[str, Any] | None:
    """What a file of an operation has to belong to, by name; none where no sheet comes back."""
    part, sheet = problem.part, setup.stock.sheet
    if part is None or part.formed is None or sheet is None:
        return None
    tools = {}
    for arm in operation.arms:
        tool = setup.cell.arm(arm).tool
        if isinstance(tool, FormingTool):
            tools[arm] = (tool.head.kind, tool.head.radius)
    return _wanted(operation, setup.stock.size, sheet, part.formed.source, tools)


def differing(said: Mapping[str, Any], mine: Mapping[str, Any]) -> list[str]:
    """The names under which a file has another value than the job."""
    return [name for name in sorted({*mine, *said}) if said.get(name, "none") != mine.get(name, "none")]


def _wanted(
    operation: Any, size: FloatArray, sheet: Sheet, mesh: Mesh, tools: dict[str, Any]
) -> dict[str, Any]:
    """What a file of this operation has to belong to, by name: ``size`` (3,) [m] and ``sheet`` of the stock,
    the part's ``mesh`` as given, each arm's ``tools`` [kind, radius in m]."""
    metal = sheet.metal
    nanometres = [np.rint(table * 1e9).astype("<i8") for table in (mesh.vertices, sheet.opening)]
    whole = hashlib.sha256(nanometres[0].tobytes() + mesh.faces.astype("<i8").tobytes()).hexdigest()
    border = sheet.border * MM * MM
    out: dict[str, Any] = {
        "part": whole[:32],
        "sheet.size_mm": [_nine(one / MM) for one in size.tolist()],
        "sheet.metal": metal.name,
        "sheet.young_gpa": _nine(metal.young / 1e9),
        "sheet.poisson": _nine(metal.poisson),
        "sheet.tensile_mpa": _nine(metal.tensile_stress / 1e6),
        "sheet.opening": hashlib.sha256(nanometres[1].tobytes()).hexdigest()[:32],
        "clamp.border_n_mm2": _nine(border) if np.isfinite(border) else "immovable",
    }
    for arm, (kind, radius) in tools.items():
        out[f"tool.{arm}"] = [kind, _nine(radius / MM)]
    for name in OF_OPERATION:
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


OF_OPERATION = (
    *("mode", "side", "path", "stepdown_mm", "scallop_mm", "strategy", "order"),
    *("passes", "angle_step_deg", "repeats", "force_n"),
)
"""Fields of an operation that decide what its sheet comes back by, and where its loops are."""


def _nine(value: float) -> float:
    return float(f"{value:.9g}")


class Deeper:
    """The commanded way of one pass, whose tools on ``side`` +1 are above: by its ``way`` they are lower."""

    def __init__(self, way: Way, side: int) -> None:
        self.way, self.side = way, side
        knots = way.point.copy()
        knots[:, 2] -= side * way.shift
        self._start, self._way = knots[:-1], np.diff(knots, axis=0)
        self._square = np.maximum((self._way**2).sum(axis=1), 1e-24)
        count = np.maximum(np.ceil(np.sqrt(self._square) / MARKS), 1).astype(np.int64)
        self._owner = np.repeat(np.arange(len(count)), count)
        share = (np.arange(len(self._owner)) - np.repeat(np.cumsum(count) - count, count) + 0.5) / count[
            self._owner
        ]
        self._marks = self._start[self._owner] + share[:, None] * self._way[self._owner]

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self._marks)

    def at(self, places: FloatArray) -> tuple[FloatArray, FloatArray]:
        """By how much (N,) [m] tools are deeper at replayed ``places`` (N, 3) [m] of the former, and how far
        (N,) [m] these are off the commanded way."""
        shift, off = np.empty(len(places)), np.empty(len(places))
        for begin in range(0, len(places), AT_ONCE):
            rows = slice(begin, begin + AT_ONCE)
            shift[rows], off[rows] = self._some(places[rows])
        return shift, off

    def _some(self, places: FloatArray) -> tuple[FloatArray, FloatArray]:
        shift, off = np.empty(len(places)), np.empty(len(places))
        left, count = np.arange(len(places)), min(NEAREST_MARKS, len(self._marks))
        while len(left):
            apart, found = (
                np.asarray(one).reshape(len(left), -1) for one in self._tree.query(places[left], k=count)
            )
            shift[left], off[left] = self._nearest(places[left], self._owner[found])
            # where ways lie close to one another the nearest piece may have none of the nearest marks
            more = apart[:, -1] < off[left] + 0.5 * MARKS
            left = left[more] if count < len(self._marks) else left[:0]
            count = min(2 * count, len(self._marks))
        return shift, off

    def _nearest(self, places: FloatArray, piece: IntArray) -> tuple[FloatArray, FloatArray]:
        """Shifts (N,) [m] at the nearest place on any of the pieces (N, M), and how far (N,) [m] that is."""
        rest = places[:, None] - self._start[piece]
        share = np.clip((rest * self._way[piece]).sum(axis=2) / self._square[piece], 0.0, 1.0)
        away = np.sqrt(((rest - share[..., None] * self._way[piece]) ** 2).sum(axis=2))
        best = away.argmin(axis=1)[:, None]
        piece, share, away = (np.take_along_axis(one, best, axis=1)[:, 0] for one in (piece, share, away))
        value = self.way.shift
        return value[piece] + share * (value[piece + 1] - value[piece]), away
