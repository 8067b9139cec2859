"""The bundled jobs from G-code, from their files to proven programs, and copies with a changed path."""

from __future__ import annotations

import re

import pytest

from planner import pipeline


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "suffix", "coordinate"),
    [("gcode", ".src", r"\nSLIN \{X (-?[\d.]+),"), ("gcode/abb.yaml", ".mod", r"MoveL \[\[(-?[\d.]+),")],
)
def test_a_bundled_job_is_proven_and_a_changed_path_is_not(name: str, suffix: str, coordinate: str) -> None:
    problem = pipeline.load(name)
    outcome = pipeline.plan(problem)
    assert outcome.verified, outcome.issues
    file, text = next(
        (n, t) for n, t in outcome.programs.items() if n.endswith(suffix) and re.search(coordinate, t)
    )
    places = list(re.finditer(coordinate, text))
    middle = places[len(places) // 2]
    changed = f"{text[: middle.start(1)]}{float(middle[1]) + 0.5:.4f}{text[middle.end(1) :]}"
    proof = pipeline.verify(problem, {**outcome.programs, file: changed})
    assert "verify.mill_path" in {issue.code for issue in proof.issues}
