"""``tandem align``: where the second robot of a cell stands, from points that both robots probed."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console
from rich.table import Table

from planner.issues import Issue, TandemError
from planner.units import DEG, MM

if TYPE_CHECKING:
    from planner.align.probing import ProbedPoints
    from planner.align.rigid_fit import Alignment

out = Console(highlight=False, soft_wrap=True)


@dataclasses.dataclass(frozen=True)
class Align:
    """Find the base of a cell's second robot from points that both robots probed, and write the cell anew.

    The CSV file has a row for each point: name, and for both arms <arm>.x_mm, <arm>.y_mm, <arm>.z_mm, where
    the controller shows the TCP in the robot's own base. Nothing is written while a point does not fit.
    """

    cell: tyro.conf.Positional[Path]
    """the cell, YAML"""
    points: tyro.conf.Positional[Path]
    """the probed points, CSV"""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """the cell to write; its comments stay"""
    arm: str | None = None
    """the arm whose base is looked for; else the second of the cell"""
    tolerance_mm: float = 0.5
    """how far a point may be from the fit"""
    leave_out: tuple[str, ...] = ()
    """names of points that are not to count"""


def run(request: Align) -> tuple[Issue, ...]:
    """Fit, print, and write the cell; warnings come back. Raises `TandemError` (room align, and what a cell's
    file can have)."""
    from planner.align import probing, rigid_fit
    from planner.files import write_whole
    from planner.geometry.rigid import inverse, to_rpy
    from planner.reading import strict_yaml
    from planner.reading.problem import read_cell

    if not 0.0 < request.tolerance_mm <= 1000.0:
        what = f"tolerance: got {request.tolerance_mm:g} mm, allowed above 0, up to 1000 mm"
        raise TandemError(Issue("align.file", what, hint="correct it"))
    document = strict_yaml.read(request.cell)
    cell = read_cell(document)
    index = probing.moved_arm(cell, request.arm, str(request.cell))
    fixed, moved = cell.arms[1 - index], cell.arms[index]
    arms = (fixed.name, moved.name)
    points = probing.read(request.points, arms)
    probing.require_reach(cell, (1 - index, index), points, str(request.points))
    used = probing.used_points(points, request.leave_out, str(request.points))
    found = rigid_fit.align(points.first, points.second, points.names, arms, used)
    issues = rigid_fit.tolerance_issues(
        found, points.first, points.second, points.names, request.tolerance_mm * MM
    )
    _print_points(found, points, {issue.target for issue in issues})
    if issues:
        raise TandemError([dataclasses.replace(i, file=str(request.points)) for i in issues])
    base = fixed.base @ found.pose
    text = probing.with_base(document, index, base)
    probing.require_readable(text, request.output, document)
    try:
        write_whole(request.output, text)
    except (OSError, ValueError) as error:
        what = f"{request.output}: cannot be written ({getattr(error, 'strerror', None) or error})"
        raise TandemError(Issue("output.folder", what, hint="choose a place of your own")) from error
    xyz, rpy = probing.rounded(base)
    shift = inverse(moved.base) @ base
    out.print(f"base of {moved.name}: xyz_mm {xyz}, rpy_deg {rpy}")
    turned = float(abs(to_rpy(shift[:3, :3])).max()) / DEG
    was = float((shift[:3, 3] ** 2).sum() ** 0.5) / MM
    out.print(f"before, the cell had it {was:.1f} mm and up to {turned:.3f} deg elsewhere")
    out.print(
        f"from {int(found.used.sum())} points: known to {found.position_sigma / MM:.2f} mm and "
        f"{found.turn_sigma / DEG:.3f} deg (one standard deviation, worst direction)"
    )
    out.print(f"written to {request.output}")
    return rigid_fit.collinearity_warnings(points.first[used], points.second[used], arms)


def _print_points(found: Alignment, points: ProbedPoints, bad: set[str | None]) -> None:
    table = Table("point", "off mm", "x mm", "y mm", "z mm", "")
    for k, name in enumerate(points.names):
        remark = "left out" if not found.used[k] else "BAD" if name in bad else ""
        x, y, z = found.residual[k] / MM
        table.add_row(name, f"{found.distance[k] / MM:.3f}", f"{x:+.3f}", f"{y:+.3f}", f"{z:+.3f}", remark)
    out.print(table)
