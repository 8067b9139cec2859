"""Use a process from your own package like a built-in one.

The package is the folder scan_ring: scan_ring.py, and a pyproject.toml whose entry point names the process.
If it is installed (pip install ./scan_ring), this script starts at "scan", and problem files may state
`process: scan_ring`, too. Tandem itself is not changed.
"""

import sys
import tempfile
import tomllib
from pathlib import Path

package = Path(__file__).parent / "scan_ring"  # replaces pip for this run: module and metadata
made = tomllib.loads((package / "pyproject.toml").read_text())["project"]
info = Path(tempfile.mkdtemp()) / "scan_ring-1.0.dist-info"
info.mkdir()
(info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {made['name']}\nVersion: {made['version']}\n")
points = [f"{name} = {value}" for name, value in made["entry-points"]["tandem.processes"].items()]
(info / "entry_points.txt").write_text("\n".join(["[tandem.processes]", *points]))
sys.path += [str(package), str(info.parent)]

import planner  # noqa: E402
from planner import spec  # noqa: E402

scan = spec.Operation(name="scan", process="scan_ring", arms=["robot"], radius_mm=60)
problem = spec.Problem(
    name="scanned_block",
    cell="irb140_gauge",
    stock=spec.Stock(size_mm=[200, 200, 80], place={"xyz_mm": [500, 0, 250]}, support="pedestal"),
    operations=[scan],
)
outcome = planner.plan(problem)
outcome.save(sys.argv[1] if len(sys.argv) > 1 else "out_scan")
circle = outcome.proof.rule("verify.follows")
print(f"verified: {outcome.verified}; largest distance from the circle {circle.worst:.3f} {circle.unit}")
