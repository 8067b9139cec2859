"""File of springback shifts: written by `tandem springback --write`, named by a problem.

JSON with one ring or control point a line: what it belongs to, assumptions, limits, control points with their
curves, and for each pass the loops of the forming tool's path with the shift at each target, x, y, z and S in
mm in the sheet's frame. Its last line is the SHA-256 of all text before it, so a file that is truncated or
edited is refused. So is one that belongs to another part, sheet, tool or operation, with the name of the
difference.
"""

import dataclasses
import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from planner.files import is_file, missing_file_reason
from planner.geometry.arrays import FloatArray, IntArray, Mesh, lengths
from planner.geometry.units import MM
from planner.issues import Issue, TandemError
from planner.problem import Part, Stock
from planner.processes.forming.plan.operation import Forming, Springback
from planner.processes.forming.plan.process_plan import FormingWork
from planner.processes.forming.plan.springback import forecast
from planner.processes.forming.plan.springback.compensation import REWRITE_HINT, ShiftedPath, file_error
from planner.processes.forming.plan.springback.curves import PassSpringback, SpringbackCurve

FILE_VERSIONS: Final = {"tandem_springback": 2, "tandem_adjustment": 2, "tandem_level": 1}
"""Versions of the file formats, by the key that marks the kind of file."""
FILE_KINDS: Final = {
    "tandem_springback": "springback file",
    "tandem_adjustment": "file of adjustments by a scan",
    "tandem_level": "file of one level",
}
"""Kinds of files in words, by the same keys."""
MAX_LEVELS: Final = 1_000_000
"""Upper bound of the level numbers of a pass."""
MAX_FILE_BYTES: Final = 64_000_000
"""Maximum size [bytes] of a file."""
LENGTH_DECIMALS: Final = 5
"""Decimals of lengths [mm]: a hundredth of a micrometre."""
SHIFT_ROUNDING_M: Final = 2e-8
"""Difference [m] of two rounded shifts in addition to their slope."""
IDENTITY_FIELDS: Final = (
    "mode",
    "side",
    "path",
    "stepdown_mm",
    "scallop_mm",
    "strategy",
    "order",
    "passes",
    "angle_step_deg",
    "repeats",
    "force_n",
)
"""Fields of an operation that determine the springback and the position of loops."""

_CONTROL_KEYS: Final = ("level", "x_mm", "y_mm", "z_mm", "springback_mm", "force_n")
"""Keys of a control point that are read."""
_CURVE_KEYS: Final = ("forces_n", "displacements_mm")
"""Keys of the curve of a control point that are read."""


def job_identity(work: FormingWork, stock: Stock, part: Part | None) -> dict[str, Any]:
    """Return what determines the springback of a sheet, as plain values by name.

    Meshes and outlines are represented by a digest.
    """
    op, sheet = work.operation, work.sheet
    mesh = None if part is None or part.formed is None else part.formed.source
    return {
        "part": "" if mesh is None else _mesh_digest(mesh),
        "sheet.size_mm": [_round_significant(v / MM) for v in stock.size],
        "sheet.metal": sheet.metal.name,
        "sheet.young_gpa": _round_significant(sheet.metal.young / 1e9),
        "sheet.poisson": _round_significant(sheet.metal.poisson),
        "sheet.tensile_mpa": _round_significant(sheet.metal.tensile_stress / 1e6),
        "sheet.opening": _digest(np.round(sheet.opening * 1e9).astype("<i8").tobytes()),
        "clamp.border_n_mm2": "immovable"
        if np.isinf(sheet.border)
        else _round_significant(sheet.border * MM**2),
        **{
            f"tool.{arm}": [head.kind, _round_significant(head.radius / MM)]
            for arm, head in sorted(work.heads.items())
        },
        **{f"operation.{name}": _plain_value(getattr(op, name)) for name in IDENTITY_FIELDS},
        **_stated_forces(op),
    }


def _stated_forces(op: Forming) -> dict[str, Any]:
    """Return the forces that an operation states, as plain values by name; a file as its digest."""
    stated_values: dict[str, Any] = {}
    if op.force_by is not None:
        table, file = op.force_by.table, op.force_by.file
        stated = [list(entry) for entry in table or ()] if file is None else _digest(file.read_bytes())
        stated_values["operation.force_by"] = stated
    if op.support_force_n is not None:
        stated_values["operation.support_force_n"] = op.support_force_n
    return stated_values


def _mesh_digest(mesh: Mesh) -> str:
    """Return the digest of a mesh whose vertices are rounded to nanometres."""
    vertices = np.round(mesh.vertices * 1e9).astype("<i8").tobytes()
    return _digest(vertices + np.asarray(mesh.faces).astype("<i8").tobytes())


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:32]


def _round_significant(value: float) -> float:
    return float(f"{float(value):.9g}")


def _plain_value(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def assumptions(work: FormingWork) -> list[str]:
    """Return the assumptions of a forecast that were not measured on this setup."""
    metal = work.sheet.metal
    border = work.sheet.border
    edge = (
        "slides in its plane"
        if border == 0.0
        else "does not move"
        if np.isinf(border)
        else f"yields as a spring of {border * MM**2:g} N/mm for each mm"
    )
    return [
        *forecast.describe_forces(work),
        f"the sheet's edge {edge} (clamp: border)",
        f"E {metal.young / 1e9:g} GPa and nu {metal.poisson:g} of {metal.title}, purely elastic",
        "the sheet has the thickness of the sine law, and the nominal shape down to the tool",
        "residual stress, which moves a part when it is unclamped or trimmed, is not included",
    ]


def springback_file_text(
    title: str,
    work: FormingWork,
    identity: Mapping[str, Any],
    forecasts: Sequence[PassSpringback],
    paths: Sequence[ShiftedPath],
    slope: float,
) -> str:
    """Return the content of the file.

    Args:
        title: Title of the problem.
        work: Work of the operation.
        identity: Values that identify the job to which the file belongs.
        forecasts: Springback of each pass.
        paths: Shifted paths.
        slope: Slope of the shifts.
    """
    control_points = forecast.forecast_rows(forecasts)
    head = {
        "tandem_springback": FILE_VERSIONS["tandem_springback"],
        "problem": title,
        "operation": work.operation.name,
        "belongs_to": dict(identity),
        "assumed": assumptions(work),
        "slope": slope,
    }
    lines = [f"{_dump(key)}: {_dump(value)}" for key, value in head.items()]
    points = ",\n".join(_dump(control_point) for control_point in control_points)
    lines.append(f'"control_points": [\n{points}\n]')
    return with_checksum([*lines, *path_lines(paths)])


def path_lines(paths: Sequence[ShiftedPath]) -> list[str]:
    """Return shifted paths as lines of a file: passes with their rings, and the number of points."""
    return [f'"passes": {passes_text(paths)}', f'"points": {sum(len(path.point) for path in paths)}']


def passes_text(paths: Sequence[ShiftedPath]) -> str:
    """Return passes as JSON text, one ring a line, each a table of x, y, z and shift [mm]."""
    passes = []
    for path in paths:
        rings = []
        for loop in np.unique(path.loop):
            in_loop = path.loop == loop
            table = (
                np.round(np.column_stack([path.point[in_loop], path.shift[in_loop]]) / MM, LENGTH_DECIMALS)
                + 0.0
            )
            rings.append(_dump(table.tolist()))
        joined_rings = ",\n".join(rings)
        passes.append(f'{{"name": {_dump(path.name)}, "rings": [\n{joined_rings}\n]}}')
    joined_passes = ",\n".join(passes)
    return f"[\n{joined_passes}\n]"


def with_checksum(lines: Sequence[str]) -> str:
    """Return the text of a file: a JSON object of these lines, with the checksum of them as the last one."""
    body = "{\n" + ",\n".join(lines) + ",\n"
    return body + f'"sha256": "{hashlib.sha256(body.encode()).hexdigest()}"\n}}\n'


def _dump(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False)


@dataclasses.dataclass(frozen=True)
class PassForecast:
    """Forecast of a file for one pass, at C control points.

    Attributes:
        name: Name of the pass.
        point: Contact points (C, 3) [m].
        level: Level (C,) of each point.
        curves: C springback curves.
        force: Expected forces (C,) [N].
        springback: Springback (C,) [m] under these forces.
    """

    name: str
    point: FloatArray
    level: IntArray
    curves: tuple[SpringbackCurve, ...]
    force: FloatArray
    springback: FloatArray


@dataclasses.dataclass(frozen=True)
class SpringbackFile:
    """A file of shifts that was read.

    Attributes:
        file: Name of the file.
        paths: Shifted paths of all passes.
        slope: Maximum slope of the shifts.
        forecasts: Forecasts for passes; none for a single level or if a scan has shown the springback.
        scan: Scan from which the file was made, or None.
    """

    file: str
    paths: tuple[ShiftedPath, ...]
    slope: float
    forecasts: tuple[PassForecast, ...] = ()
    scan: str | None = None


def read_springback_file(path: Path, operation: Forming, identity: Mapping[str, Any]) -> SpringbackFile:
    """Read a file of shifts.

    Args:
        path: File.
        operation: Operation that names it.
        identity: Values that identify the job to which the file has to belong.

    Raises:
        TandemError: forming.compensation, with all differences from ``identity`` at once.
    """
    limits = operation.springback or Springback(file=path)
    data = read_checked_file(path, "tandem_springback" if limits.scan is None else "tandem_adjustment")
    require_identity(data, identity)
    paths = tuple(read_shifted_path(entry) for entry in _require_list(data, "passes"))
    if sum(len(shifted.point) for shifted in paths) != data.get("points"):
        raise file_error(
            f"it states {data.get('points')} points, got {sum(len(shifted.point) for shifted in paths)}"
        )
    require_shift_limits(paths, limits.slope, limits.most_mm * MM)
    if limits.scan is not None:
        return SpringbackFile(path.name, paths, limits.slope, scan=_require_scan(data, limits.scan.file))
    control_points = _require_list(data, "control_points")
    names = dict.fromkeys(
        str(control_point.get("pass")) for control_point in control_points if isinstance(control_point, dict)
    )
    return SpringbackFile(
        path.name, paths, limits.slope, tuple(_read_forecast(control_points, name) for name in names)
    )


def _require_scan(data: Mapping[str, Any], path: Path) -> str:
    """Return the name of the scan from which the file was made.

    Raises ``TandemError`` (forming.compensation) if it is not the scan of the problem.
    """
    stated = data.get("scan")
    if not is_file(path):
        raise file_error(f"{path}: {missing_file_reason(path)}", "check the path of springback: scan: file")
    if not isinstance(stated, dict) or stated.get("sha256") != hashlib.sha256(path.read_bytes()).hexdigest():
        name = stated.get("file") if isinstance(stated, dict) else None
        raise file_error(
            f"it was made from the scan {_value_text(name)}, {path.name} is another one or has changed"
        )
    return str(stated.get("file"))


def require_identity(data: Mapping[str, Any], identity: Mapping[str, Any]) -> None:
    """Check that a file belongs to the job with a given identity.

    Raises:
        TandemError: forming.compensation.
    """
    file_identity = data.get("belongs_to")
    file_identity = file_identity if isinstance(file_identity, dict) else {}
    own_identity = json.loads(_dump(dict(identity)))
    differences = [
        f"{name}: got {_value_text(file_identity.get(name))}, the problem has "
        f"{_value_text(own_identity.get(name))}"
        for name in dict.fromkeys([*own_identity, *file_identity])
        if file_identity.get(name) != own_identity.get(name)
    ]
    if differences:
        issues = [
            issue
            for message in differences
            for issue in file_error(f"it belongs to another job: {message}").issues
        ]
        raise TandemError(issues)


def _value_text(value: Any) -> str:
    return "none" if value is None else _dump(value)


def read_checked_file(path: Path, kind: str) -> dict[str, Any]:
    """Read a file of a kind and check its checksum.

    Raises:
        TandemError: forming.compensation.
    """
    if not is_file(path):
        hint = (
            "check the path, which starts at the problem file's folder, or write the file: tandem springback "
        )
        raise file_error(f"{path}: {missing_file_reason(path)}", f"{hint}PROBLEM --write FILE")
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise file_error(f"{path.name} has more than {MAX_FILE_BYTES // 1_000_000} MB")
        content = path.read_text("utf-8")
    except (OSError, ValueError) as error:
        message = f"{path.name}: it cannot be read ({getattr(error, 'strerror', None) or 'no text'})"
        raise file_error(message) from None
    body, checksum_key, checksum_text = content.rpartition('"sha256"')
    checksum_words = checksum_text.replace('"', " ").replace(":", " ").replace("}", " ").split()
    if content.lstrip().startswith('{"tandem_loop"'):
        message = f"{path.name} has curves for tandem next-loop, written by --curves, and no shifts"
        raise file_error(message)
    if not checksum_key or len(checksum_words) != 1:
        raise file_error(f"{path.name} is truncated: its last line is no checksum")
    if hashlib.sha256(body.encode()).hexdigest() != checksum_words[0]:
        raise file_error(
            f"{path.name} was changed after it was written, or is truncated: its checksum does not match"
        )
    try:
        data = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise file_error(f"{path.name} is not valid JSON: {error}") from None
    others = [FILE_KINDS[key] for key in FILE_KINDS if key != kind and isinstance(data, dict) and key in data]
    if others:
        hint = "name adjustments with their scan, springback: {file: ..., scan: {file: ...}}, others without"
        raise file_error(f"{path.name} is a {others[0]}, expected a {FILE_KINDS[kind]}", hint)
    if not isinstance(data, dict) or data.get(kind) != FILE_VERSIONS[kind]:
        raise file_error(f"{path.name} is not a {FILE_KINDS[kind]} of version {FILE_VERSIONS[kind]}")
    return data


def _require_list(data: Mapping[str, Any], name: str) -> list[Any]:
    value = data.get(name)
    if not isinstance(value, list) or not value:
        raise file_error(f"{name}: got nothing")
    return value


def read_shifted_path(entry: Any) -> ShiftedPath:
    """Read a pass of a file.

    Raises:
        TandemError: forming.compensation.
    """
    name = str(entry.get("name")) if isinstance(entry, dict) else ""
    tables: list[FloatArray] = []
    for ring in _require_list(entry if isinstance(entry, dict) else {}, "rings"):
        try:
            table = np.asarray(ring, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            table = np.zeros((0, 0))
        if table.ndim != 2 or table.shape[1] != 4 or not np.isfinite(table).all():
            raise file_error(f"pass {name}: ring {len(tables)} is not a table of x, y, z and S in mm")
        tables.append(table * MM)
    table_of_all = np.concatenate(tables)
    loop: IntArray = np.repeat(np.arange(len(tables)), [len(table) for table in tables])
    return ShiftedPath(name, table_of_all[:, :3], table_of_all[:, 3], loop)


def _read_forecast(entries: Sequence[Any], name: str) -> PassForecast:
    """Return the forecast of the pass ``name``; raises ``TandemError`` if its control points are invalid."""
    pass_entries = [entry for entry in entries if isinstance(entry, dict) and str(entry.get("pass")) == name]
    try:
        table = np.array([[entry[key] for key in _CONTROL_KEYS] for entry in pass_entries], dtype=np.float64)
        curves = [np.array([entry[key] for key in _CURVE_KEYS], dtype=np.float64) for entry in pass_entries]
    except (KeyError, TypeError, ValueError, OverflowError):
        table, curves = np.zeros((0, len(_CONTROL_KEYS))), []
    arrays = [table, *curves]
    rising = all(curve.ndim == 2 and curve.shape[1] > 2 and (np.diff(curve) > 0.0).all() for curve in curves)
    if not len(table) or not all(np.isfinite(array).all() for array in arrays) or not rising:
        message = (
            f"pass {name}: its control points are not rows of {', '.join((*_CONTROL_KEYS, *_CURVE_KEYS))}, "
            "with "
        )
        raise file_error(message + "increasing curves")
    level = table[:, 0]
    if (level < 0).any() or (level >= MAX_LEVELS).any() or (level % 1.0 != 0.0).any():
        raise file_error(f"pass {name}: levels of control points must be numbers from 0 to {MAX_LEVELS - 1}")
    return PassForecast(
        name,
        table[:, 1:4] * MM,
        table[:, 0].astype(np.int64),
        tuple(
            SpringbackCurve(curve_force, curve_springback * MM, False)
            for curve_force, curve_springback in curves
        ),
        table[:, 5],
        table[:, 4] * MM,
    )


def require_shift_limits(
    paths: Sequence[ShiftedPath], slope: float, max_shift: float, first: float = 0.0
) -> None:
    """Check that the shifts of paths stay within their limits.

    Args:
        paths: Shifted paths.
        slope: Maximum slope.
        max_shift: Maximum shift [m].
        first: Required shift [m] at the start.

    Raises:
        TandemError: forming.compensation for shifts below 0 or above the maximum, too steep, or with a wrong
            start.
    """
    issues: list[Issue] = []
    for path in paths:
        step = lengths(np.diff(path.point, axis=0))
        slope_excess = np.abs(np.diff(path.shift)) - SHIFT_ROUNDING_M - slope * step
        if path.shift.max() > max_shift:
            message = f"pass {path.name} has a shift of {path.shift.max() / MM:.3f} mm, "
            message += f"most_mm allows {max_shift / MM:g} mm"
            issues += file_error(message, f"allow more (springback: most_mm), or {REWRITE_HINT}").issues
        problems = []
        if path.shift.min() < 0.0:
            problems.append(f"a shift of {path.shift.min() / MM:.3f} mm, allowed 0 and more")
        if abs(path.shift[0] - first) > SHIFT_ROUNDING_M:
            problems.append(f"a shift of {path.shift[0] / MM:.3f} mm at its start, allowed {first / MM:g}")
        if len(slope_excess) and slope_excess.max() > 0.0:
            k = int(np.argmax(slope_excess))
            actual_slope = abs(path.shift[k + 1] - path.shift[k]) / max(float(step[k]), 1e-12)
            problems.append(f"a slope of {actual_slope:.4f} mm/mm, allowed {slope:g}")
        issues += [
            issue for message in problems for issue in file_error(f"pass {path.name} has {message}").issues
        ]
    if issues:
        raise TandemError(issues)
