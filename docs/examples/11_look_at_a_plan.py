"""Inspect a plan: poses at a time, joint paths, figures, rules of the proof, a 3D view."""

import sys
from pathlib import Path

import numpy as np

import planner
from planner import spec

poses = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (3, 1, 1))  # the gauge points down
poses[:, :3, 3] = [[-60, -60, 120], [60, -60, 120], [60, 60, 120]]
scan = spec.Targets(name="scan", poses={"robot": poses}, unit="mm", feed_mm_s=50)
stock = spec.Stock(size_mm=[200, 200, 80], place={"xyz_mm": [500, 0, 250]}, support="pedestal")
problem = spec.Problem(name="scan", cell="irb140_gauge", stock=stock, operations=[scan])
outcome = planner.plan(problem)
plan = outcome.plan

middle = plan.frame(plan.duration / 2)
print(f"at {middle.time:.1f} s: {middle.segment}, joints {np.degrees(middle.q['robot']).round(1)} deg")
path = plan.sample(dt=0.05)
speed = np.abs(np.diff(np.degrees(path.q["robot"]), axis=0)).max(axis=0) / 0.05
print(f"{len(path.time)} samples, greatest joint speeds {speed.round(1)} deg/s")
figures = plan.operations[0].metrics
print(
    f"planned: clearance {figures['clearance_mm']:.1f} mm, {figures['peak_speed_share']:.0%} of joint speed"
)
for code in ("verify.clearance", "verify.joint_speed", "verify.singularity", "verify.follows"):
    rule = outcome.proof.rule(code)
    print(f"proven: {rule.code} {rule.worst:.2f} {rule.unit}, allowed {rule.limit:g}")
print(f"verified: {outcome.verified}")

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "out_look")
outcome.save(folder)
planner.save(problem, folder.with_suffix(".yaml"))  # this problem for the command line
viewer = outcome.show(browser=False)  # True opens a browser tab; in a notebook the last line shows it
print(f"3D view at {viewer.url} while Python runs, and in {folder / 'replay.html'} for good")
