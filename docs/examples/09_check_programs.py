"""Check programs: a position that was changed by hand, and a third-party module."""

import sys
from pathlib import Path

import numpy as np

import planner
from planner import spec

poses = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (3, 1, 1))  # the gauge points down
poses[:, :3, 3] = [[-60, -60, 120], [60, -60, 120], [60, 60, 120]]
scan = spec.Targets(name="scan", poses={"robot": poses}, unit="mm", feed_mm_s=50)
stock = spec.Stock(size_mm=[200, 200, 80], place={"xyz_mm": [500, 0, 250]}, support="pedestal")
outcome = planner.plan(spec.Problem(name="scan", cell="irb140_gauge", stock=stock, operations=[scan]))
folder = Path(sys.argv[1] if len(sys.argv) > 1 else "out_scan")
outcome.save(folder)

module = next((folder / "programs").rglob("TandemCut*.mod"))
module.write_text(module.read_text().replace("[60.0000,60.0000,120.0000]", "[60.0000,65.0000,120.0000]"))
proof = planner.prove(outcome.problem, planner.read_programs(folder))
print(f"verified: {outcome.verified} as written, {proof.ok} after the change by hand:")
print(*(f"  {issue}" for issue in proof.issues), sep="\n")

foreign = """MODULE Hand
  CONST jointtarget home := [[0,-10,10,0,60,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  PROC main()
    MoveAbsJ home,v100,fine,tool0;
    MoveAbsJ [[30,-10,10,0,60,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v100,fine,tool0;
    MoveAbsJ [[90,60,40,0,60,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v100,fine,tool0;
  ENDPROC
ENDMODULE
"""
partial = planner.read_partly(outcome.problem, {"T_ROB1/Hand.mod": foreign})
print(f"somebody else's: {partial.proven}")
print(*(f"  {issue}" for issue in partial.issues), sep="\n")
