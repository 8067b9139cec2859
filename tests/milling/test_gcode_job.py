"""The bundled job from G-code, from its files to proven programs, and one whose path was changed."""

from __future__ import annotations

import re

import pytest

from planner import pipeline


@pytest.mark.long
def test_the_bundled_job_is_proven_and_a_changed_path_is_not() -> None:
    problem = pipeline.load("gcode")
    outcome = pipeline.plan(problem)
    assert outcome.verified, outcome.issues
    name, text = next((n, t) for n, t in outcome.programs.items() if "MoveL" in t)
    places = list(re.finditer(r"\[\[(-?[\d.]+),", text))
    middle = places[len(places) // 2]
    changed = f"{text[: middle.start(1)]}{float(middle[1]) + 0.5:.4f}{text[middle.end(1) :]}"
    proof = pipeline.verify(problem, {**outcome.programs, name: changed})
    assert "verify.mill_path" in {issue.code for issue in proof.issues}
