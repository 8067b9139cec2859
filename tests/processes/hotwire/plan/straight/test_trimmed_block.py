"""A block with oversize is trimmed and an outline cut from it, from the problem file to proven programs."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import yaml

import planner
from planner.claims.segments import Segment
from planner.motion.trajectory.joint_path import MoveSamples, guarded_lengths
from tests.processes.hotwire.plan import foam_blocks as blocks

PROBLEM = {
    "tandem": 1,
    "name": "trimmed",
    "cell": {
        "arms": [
            {
                "name": "robot",
                "robot": "irb4600_40",
                "tool": {"kind": "bow", "span_mm": 400, "throat_mm": 400},
                "home_deg": [0, 0, 0, 0, 30, 0],
            }
        ]
    },
    "stock": {
        "size_mm": [200, 200, 100],
        "place": {"xyz_mm": [1500, 0, 700], "rpy_deg": [0, 0, 90]},
        "support": [{"kind": "box", "size_mm": [100, 100, 700], "pose": {"xyz_mm": [0, 0, -350]}}],
        "oversize_mm": [[5, 5], [0, 0], [0, 5]],
    },
    "operations": [
        {
            "name": "sides",
            "process": "straight_wire",
            "arms": ["robot"],
            "kerf_mm": 1.5,
            "step_mm": 8,
            "cuts": [{"trim": ["top"]}, {"surface": "house"}],
        }
    ],
}


HOUSE = [(-0.05, 0.03), (-0.05, 0.06), (0.0, 0.085), (0.05, 0.06), (0.05, 0.03)]


def test_a_trimmed_block_and_an_outline_are_planned_and_proven(tmp_path: Path) -> None:
    path = tmp_path / "problem.yaml"
    path.write_text(yaml.safe_dump(PROBLEM))
    problem = planner.load(path)
    part = blocks.part(blocks.prism("house", HOUSE, closed=True))
    problem = dataclasses.replace(problem, part=part, source={})
    outcome = planner.plan(problem)
    assert outcome.verified, [str(issue) for issue in outcome.issues]
    assert problem.operations[0].leaves(problem.stock).oversize.sum() == pytest.approx(0.01)
    (made,) = outcome.plan.operations
    # in cuts the path is measured by the way of the wire, however a move is sampled
    samples = MoveSamples(
        np.repeat(np.arange(made.targets.count), 2)[1:], np.tile([1.0, 0.25], made.targets.count)[:-1], {}
    )
    way = guarded_lengths(made.targets, samples)
    cuts = np.array([segment.kind == "cut" for segment in made.targets.segment])
    np.testing.assert_allclose(way[::2] + way[1::2], (made.targets.travel * cuts)[1:])
    np.testing.assert_allclose(way[::2], 0.25 * (made.targets.travel * cuts)[1:])
    # the wire keeps its feed around the corners, where its moves are short
    speed = made.targets.travel[1:] / np.diff(made.time)
    on = np.flatnonzero(np.array(made.targets.segment[1:]) == Segment("cut", "house"))
    assert speed[on].max() <= 0.008 * 1.001
    assert speed[on].min() >= 0.95 * 0.008
