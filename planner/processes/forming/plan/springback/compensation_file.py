"""The file of shifts that make up for springback: `tandem springback --write` makes it, a problem names it.

JSON, one ring or control point a line: what it belongs to, what is assumed, limits, control points with their
curves, and of each pass the loops of the former's path with the shift at each target, x, y, z and S in mm in
the sheet's frame. Its last line is the SHA-256 of all text before it, so one that is cut short or edited is
refused; so is one that belongs to another part, sheet, tool or operation, by the name of what differs.
"""

import dataclasses
import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from planner.files import is_file, no_file
from planner.geometry.arrays import FloatArray, IntArray, Mesh, lengths
from planner.geometry.units import MM
from planner.issues import Issue, TandemError
from planner.problem import Part, Stock
from planner.processes.forming.plan.operation import Forming, Springback
from planner.processes.forming.plan.process_plan import Work
from planner.processes.forming.plan.springback import forecast
from planner.processes.forming.plan.springback.compensation import AGAIN, Way, refused
from planner.processes.forming.plan.springback.curves import Curve, PassSpringback

VERSIONS: Final = {"tandem_springback": 2, "tandem_adjustment": 2, "tandem_level": 1}
"""Numbers of the files' forms, by what files have them with."""
KINDS: Final = {
    "tandem_springback": "springback file",
    "tandem_adjustment": "file of adjustments by a scan",
    "tandem_level": "file of one level",
}
"""What files are, by the same."""
MOST_LEVELS: Final = 1_000_000
"""Levels of a pass are numbered below this."""
LARGEST: Final = 64_000_000
"""Bytes of a file at most."""
DECIMALS: Final = 5
"""Digits of lengths behind the point [mm]: a hundredth of a micrometre."""
ROUNDING: Final = 2e-8
"""What two rounded shifts may differ by besides their slope [m]."""
DECIDES: Final = (
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
"""Fields of an operation that decide what the sheet comes back by and where loops run."""

_CONTROL: Final = ("level", "x_mm", "y_mm", "z_mm", "springback_mm", "force_n")
_CURVE: Final = ("forces_n", "displacements_mm")
"""What is read of a control point, and of its curve."""


def belongs_to(work: Work, stock: Stock, part: Part | None) -> dict[str, Any]:
    """What decides how far a sheet comes back, as plain values by name; meshes and outlines by digest."""
    op, sheet = work.operation, work.sheet
    mesh = None if part is None or part.formed is None else part.formed.source
    return {
        "part": "" if mesh is None else _mesh_digest(mesh),
        "sheet.size_mm": [_short(v / MM) for v in stock.size],
        "sheet.metal": sheet.metal.name,
        "sheet.young_gpa": _short(sheet.metal.young / 1e9),
        "sheet.poisson": _short(sheet.metal.poisson),
        "sheet.tensile_mpa": _short(sheet.metal.tensile_stress / 1e6),
        "sheet.opening": _digest(np.round(sheet.opening * 1e9).astype("<i8").tobytes()),
        "clamp.border_n_mm2": "immovable" if np.isinf(sheet.border) else _short(sheet.border * MM**2),
        **{f"tool.{arm}": [head.kind, _short(head.radius / MM)] for arm, head in sorted(work.heads.items())},
        **{f"operation.{name}": _plain(getattr(op, name)) for name in DECIDES},
        **_stated_forces(op),
    }


def _stated_forces(op: Forming) -> dict[str, Any]:
    out: dict[str, Any] = {}
    if op.force_by is not None:
        table, file = op.force_by.table, op.force_by.file
        whole = [list(row) for row in table or ()] if file is None else _digest(file.read_bytes())
        out["operation.force_by"] = whole
    if op.support_force_n is not None:
        out["operation.support_force_n"] = op.support_force_n
    return out


def _mesh_digest(mesh: Mesh) -> str:
    vertices = np.round(mesh.vertices * 1e9).astype("<i8").tobytes()
    return _digest(vertices + np.asarray(mesh.faces).astype("<i8").tobytes())


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:32]


def _short(value: float) -> float:
    return float(f"{float(value):.9g}")


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def assumed(work: Work) -> list[str]:
    """What a forecast rests on that nobody has measured here."""
    metal = work.sheet.metal
    border = work.sheet.border
    edge = (
        "slides in its plane"
        if border == 0.0
        else "does not move"
        if np.isinf(border)
        else f"gives way by a spring of {border * MM**2:g} N/mm for each mm"
    )
    return [
        *forecast.forces_told(work),
        f"the sheet's edge {edge} (clamp: border)",
        f"E {metal.young / 1e9:g} GPa and nu {metal.poisson:g} of {metal.title}, elastic alone",
        "the sheet is as thick as the sine law has it, and has the wanted shape down to the tool",
        "residual stress, which moves a part when it is unclamped or trimmed, is not in this",
    ]


def text(
    title: str,
    work: Work,
    identity: Mapping[str, Any],
    found: Sequence[PassSpringback],
    ways: Sequence[Way],
    slope: float,
) -> str:
    """The file."""
    rows = forecast.rows(found)
    head = {
        "tandem_springback": VERSIONS["tandem_springback"],
        "problem": title,
        "operation": work.operation.name,
        "belongs_to": dict(identity),
        "assumed": assumed(work),
        "slope": slope,
    }
    lines = [f"{_dump(key)}: {_dump(value)}" for key, value in head.items()]
    points = ",\n".join(_dump(row) for row in rows)
    lines.append(f'"control_points": [\n{points}\n]')
    return sealed([*lines, *way_lines(ways)])


def way_lines(ways: Sequence[Way]) -> list[str]:
    """Ways as lines of a file: passes with their rings, and how many points they have."""
    return [f'"passes": {passes_text(ways)}', f'"points": {sum(len(way.point) for way in ways)}']


def passes_text(ways: Sequence[Way]) -> str:
    """Passes with their rings."""
    passes = []
    for way in ways:
        rings = []
        for k in np.unique(way.loop):
            mine = way.loop == k
            table = np.round(np.column_stack([way.point[mine], way.shift[mine]]) / MM, DECIMALS) + 0.0
            rings.append(_dump(table.tolist()))
        joined = ",\n".join(rings)
        passes.append(f'{{"name": {_dump(way.name)}, "rings": [\n{joined}\n]}}')
    both = ",\n".join(passes)
    return f"[\n{both}\n]"


def sealed(lines: Sequence[str]) -> str:
    """A file of these lines, its checksum the last one."""
    body = "{\n" + ",\n".join(lines) + ",\n"
    return body + f'"sha256": "{hashlib.sha256(body.encode()).hexdigest()}"\n}}\n'


def _dump(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False)


@dataclasses.dataclass(frozen=True)
class Foretold:
    """What a file foretells of pass ``name`` at its control points: ``point`` (C, 3) [m] of contact,
    ``level`` (C,) which of its levels each is on, ``curves``, and ``springback`` (C,) [m] under the expected
    ``force`` (C,) [N]."""

    name: str
    point: FloatArray
    level: IntArray
    curves: tuple[Curve, ...]
    force: FloatArray
    springback: FloatArray


@dataclasses.dataclass(frozen=True)
class Compensation:
    """A file that was read: the ``ways`` of all passes, whose shifts change by ``slope`` at most, named
    ``file``, and what it has ``foretold`` of passes: nothing of a level alone, nor where a ``scan`` has
    shown what a part comes back by."""

    file: str
    ways: tuple[Way, ...]
    slope: float
    foretold: tuple[Foretold, ...] = ()
    scan: str | None = None


def read(path: Path, operation: Forming, identity: Mapping[str, Any]) -> Compensation:
    """Read a file of shifts for what ``identity`` says. Raises ``TandemError`` (forming.compensation): all
    that is wrong with what it belongs to at once."""
    limits = operation.springback or Springback(file=path)
    data = read_data(path, "tandem_springback" if limits.scan is None else "tandem_adjustment")
    require_same(data, identity)
    ways = tuple(read_way(one) for one in _list(data, "passes"))
    if sum(len(way.point) for way in ways) != data.get("points"):
        raise refused(f"it says {data.get('points')} points and has {sum(len(way.point) for way in ways)}")
    require_limits(ways, limits.slope, limits.most_mm * MM)
    if limits.scan is not None:
        return Compensation(path.name, ways, limits.slope, scan=_scan(data, limits.scan.file))
    rows = _list(data, "control_points")
    names = dict.fromkeys(str(row.get("pass")) for row in rows if isinstance(row, dict))
    return Compensation(path.name, ways, limits.slope, tuple(_foretold(rows, name) for name in names))


def _scan(data: Mapping[str, Any], path: Path) -> str:
    """The name of the scan that the file was made from. Raises ``TandemError`` (forming.compensation) where
    that is not the one of the problem."""
    stated = data.get("scan")
    if not is_file(path):
        raise refused(f"{path}: {no_file(path)}", "check the path of springback: scan: file")
    if not isinstance(stated, dict) or stated.get("sha256") != hashlib.sha256(path.read_bytes()).hexdigest():
        name = stated.get("file") if isinstance(stated, dict) else None
        raise refused(f"it was made from the scan {_told(name)}, {path.name} is another one or was changed")
    return str(stated.get("file"))


def require_same(data: Mapping[str, Any], identity: Mapping[str, Any]) -> None:
    """Raise ``TandemError`` (forming.compensation) where a file belongs to another job than ``identity``."""
    theirs = data.get("belongs_to")
    theirs = theirs if isinstance(theirs, dict) else {}
    mine = json.loads(_dump(dict(identity)))
    differ = [
        f"{name}: got {_told(theirs.get(name))}, the problem has {_told(mine.get(name))}"
        for name in dict.fromkeys([*mine, *theirs])
        if theirs.get(name) != mine.get(name)
    ]
    if differ:
        issues = [issue for what in differ for issue in refused(f"it belongs to another job: {what}").issues]
        raise TandemError(issues)


def _told(value: Any) -> str:
    return "none" if value is None else _dump(value)


def read_data(path: Path, kind: str) -> dict[str, Any]:
    """A file of a ``kind`` whose checksum is right. Raises ``TandemError`` (forming.compensation)."""
    if not is_file(path):
        hint = (
            "check the path, which starts at the problem file's folder, or write the file: tandem springback "
        )
        raise refused(f"{path}: {no_file(path)}", f"{hint}PROBLEM --write FILE")
    try:
        if path.stat().st_size > LARGEST:
            raise refused(f"{path.name} has more than {LARGEST // 1_000_000} MB")
        content = path.read_text("utf-8")
    except (OSError, ValueError) as error:
        what = f"{path.name}: it cannot be read ({getattr(error, 'strerror', None) or 'no text'})"
        raise refused(what) from None
    body, mark, tail = content.rpartition('"sha256"')
    stated = tail.replace('"', " ").replace(":", " ").replace("}", " ").split()
    if content.lstrip().startswith('{"tandem_loop"'):
        what = f"{path.name} has curves for tandem next-loop, as --curves writes them, and no shifts"
        raise refused(what)
    if not mark or len(stated) != 1:
        raise refused(f"{path.name} is cut short: its last line is no checksum")
    if hashlib.sha256(body.encode()).hexdigest() != stated[0]:
        raise refused(
            f"{path.name} was changed since it was written, or is cut short: its checksum is another"
        )
    try:
        data = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise refused(f"{path.name} is no JSON: {error}") from None
    other = [KINDS[one] for one in KINDS if one != kind and isinstance(data, dict) and one in data]
    if other:
        hint = "name adjustments with their scan, springback: {file: ..., scan: {file: ...}}, others without"
        raise refused(f"{path.name} is a {other[0]}, wanted is a {KINDS[kind]}", hint)
    if not isinstance(data, dict) or data.get(kind) != VERSIONS[kind]:
        raise refused(f"{path.name} is no {KINDS[kind]} of version {VERSIONS[kind]}")
    return data


def _list(data: Mapping[str, Any], name: str) -> list[Any]:
    value = data.get(name)
    if not isinstance(value, list) or not value:
        raise refused(f"{name}: got nothing")
    return value


def read_way(one: Any) -> Way:
    """A pass of a file. Raises ``TandemError`` (forming.compensation)."""
    name = str(one.get("name")) if isinstance(one, dict) else ""
    tables: list[FloatArray] = []
    for ring in _list(one if isinstance(one, dict) else {}, "rings"):
        try:
            table = np.asarray(ring, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            table = np.zeros((0, 0))
        if table.ndim != 2 or table.shape[1] != 4 or not np.isfinite(table).all():
            raise refused(f"pass {name}: ring {len(tables)} is no table of x, y, z and S in mm")
        tables.append(table * MM)
    whole = np.concatenate(tables)
    loop: IntArray = np.repeat(np.arange(len(tables)), [len(table) for table in tables])
    return Way(name, whole[:, :3], whole[:, 3], loop)


def _foretold(rows: Sequence[Any], name: str) -> Foretold:
    mine = [row for row in rows if isinstance(row, dict) and str(row.get("pass")) == name]
    try:
        table = np.array([[row[key] for key in _CONTROL] for row in mine], dtype=np.float64)
        curves = [np.array([row[key] for key in _CURVE], dtype=np.float64) for row in mine]
    except (KeyError, TypeError, ValueError, OverflowError):
        table, curves = np.zeros((0, len(_CONTROL))), []
    whole = [table, *curves]
    rising = all(c.ndim == 2 and c.shape[1] > 2 and (np.diff(c) > 0.0).all() for c in curves)
    if not len(table) or not all(np.isfinite(one).all() for one in whole) or not rising:
        what = f"pass {name}: its control points are no rows of {', '.join((*_CONTROL, *_CURVE))}, with "
        raise refused(what + "curves that grow")
    level = table[:, 0]
    if (level < 0).any() or (level >= MOST_LEVELS).any() or (level % 1.0 != 0.0).any():
        raise refused(f"pass {name}: levels of control points are numbers from 0 to {MOST_LEVELS - 1}")
    return Foretold(
        name,
        table[:, 1:4] * MM,
        table[:, 0].astype(np.int64),
        tuple(Curve(n, s * MM, False) for n, s in curves),
        table[:, 5],
        table[:, 4] * MM,
    )


def require_limits(ways: Sequence[Way], slope: float, most: float, first: float = 0.0) -> None:
    """Raise ``TandemError`` (forming.compensation) where shifts are below 0, above ``most`` [m], change by
    more than ``slope`` along a way, or begin with another than ``first`` [m]."""
    issues: list[Issue] = []
    for way in ways:
        step = lengths(np.diff(way.point, axis=0))
        steep = np.abs(np.diff(way.shift)) - ROUNDING - slope * step
        if way.shift.max() > most:
            what = f"pass {way.name} has a shift of {way.shift.max() / MM:.3f} mm, "
            what += f"most_mm allows {most / MM:g} mm"
            issues += refused(what, f"allow more (springback: most_mm), or {AGAIN}").issues
        wrong = []
        if way.shift.min() < 0.0:
            wrong.append(f"a shift of {way.shift.min() / MM:.3f} mm, allowed 0 and more")
        if abs(way.shift[0] - first) > ROUNDING:
            wrong.append(f"a shift of {way.shift[0] / MM:.3f} mm at its beginning, allowed {first / MM:g}")
        if len(steep) and steep.max() > 0.0:
            k = int(np.argmax(steep))
            got = abs(way.shift[k + 1] - way.shift[k]) / max(float(step[k]), 1e-12)
            wrong.append(f"a slope of {got:.4f} mm/mm, allowed {slope:g}")
        issues += [issue for what in wrong for issue in refused(f"pass {way.name} has {what}").issues]
    if issues:
        raise TandemError(issues)
