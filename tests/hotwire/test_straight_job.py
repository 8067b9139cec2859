"""A block larger than its datum is trimmed, from the problem file to proven programs."""

from __future__ import annotations

from pathlib import Path

import yaml

import planner

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
        "support": [{"kind": "box", "size_mm": [100, 100, 600], "pose": {"xyz_mm": [0, 0, -300]}}],
        "oversize_mm": [[5, 5], [0, 0], [0, 5]],
    },
    "operations": [
        {
            "name": "sides",
            "process": "straight_wire",
            "arms": ["robot"],
            "kerf_mm": 1.5,
            "step_mm": 8,
            "cuts": [{"trim": ["top", "left"]}],
        }
    ],
}


def test_a_trimmed_block_is_planned_and_proven(tmp_path: Path) -> None:
    path = tmp_path / "problem.yaml"
    path.write_text(yaml.safe_dump(PROBLEM))
    problem = planner.load(path)
    outcome = planner.plan(problem)
    assert outcome.verified, [str(issue) for issue in outcome.issues]
    assert problem.operations[0].leaves(problem.stock).oversize.sum() == 0.005
