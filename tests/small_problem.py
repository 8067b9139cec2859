"""A problem that is planned in a second or two: one arm passes a few poses of a CSV file."""

from __future__ import annotations

from pathlib import Path

COLUMNS = "left.x_mm,left.y_mm,left.z_mm,left.qw,left.qx,left.qy,left.qz,feed_mm_s"
ROWS = [f"450,{y},500,0.5,-0.5,0.5,0.5,20" for y in range(-50, 51, 20)]
PROBLEM = """\
tandem: 1
name: small
cell:
  arms:
    - name: left
      robot: irb140
      tool: {kind: wire_holder, mounting: along, side: start}
      home_deg: [0, 0, 0, 0, 45, 0]
stock: {size_mm: [100, 100, 100], place: {xyz_mm: [450, 0, 0]}}
operations:
  - {name: poses, process: targets, arms: [left], file: targets.csv, frame: world}
"""


def write(folder: Path, problem: str = PROBLEM, table: str | None = None) -> Path:
    """Write the problem and its targets into ``folder``; the path of the problem file."""
    (folder / "targets.csv").write_text("\n".join([COLUMNS, *ROWS]) + "\n" if table is None else table)
    path = folder / "problem.yaml"
    path.write_text(problem)
    return path
