"""The files of a result folder that people look at: report, replay, simulated part, and the proof as data."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence

import numpy as np

from planner.cell import plant
from planner.issues import Issue, TandemError, accepted, aggregate, has_errors
from planner.plans import Plan
from planner.problem import Problem
from planner.report import moments, page, replay3d
from planner.report.cell_picture import Picture
from planner.report.page import Extra
from planner.verify.result import Proof


def files(problem: Problem, plan: Plan, proof: Proof | None) -> dict[str, str]:
    """``report.html``, ``replay.html``, and with a proof ``proof.json`` and ``simulated_part.obj``, by name.

    Where Meshcat cannot start there is no replay, and the report says so.
    """
    first = problem.setups[0]
    model = plant.build(first.cell, first.stock, plan.places[0], plan.bases)
    out: dict[str, str] = {}
    issues: tuple[Issue, ...] = ()
    try:
        out["replay.html"] = replay3d.document(model, problem, plan, proof)
    except TandemError as error:
        issues = error.issues
    extra = Extra(moments.pictures(model, problem, plan), model.pairs_filtered, issues=issues)
    out["report.html"] = page.render(problem, plan, proof, extra)
    if proof is not None:
        out["proof.json"] = _verdict(proof, accepted(plan.issues))
        if proof.part_obj:
            out["simulated_part.obj"] = proof.part_obj
    return out


def failure(problem: Problem | None, issues: Sequence[Issue]) -> str:
    """The report alone, for a problem that was refused or has no plan."""
    shown: tuple[tuple[str, Picture], ...] = ()
    filtered: Sequence[tuple[str, str, str]] = ()
    if problem is not None:
        place = problem.stock.place
        standing = np.eye(4)
        standing[:3, :3] = problem.stock.attitude
        try:
            model = plant.build(problem.cell, problem.stock, standing if place is None else place)
        except TandemError as error:
            issues = [*issues, *(i for i in error.issues if i not in issues)]
        else:
            shown = moments.pictures(model, problem, None)
            filtered = model.pairs_filtered
    return page.render(problem, None, None, Extra(shown, filtered, issues=issues))


def _verdict(proof: Proof, taken: Sequence[str]) -> str:
    """The proof as JSON: verdict, what the problem accepts beside it, rules, issues, faces without their
    points."""
    faces = [
        {"segment": face.title, **{k: v for k, v in vars(face).items() if isinstance(v, float)}}
        for face in proof.surfaces
    ]
    found = aggregate(proof.issues)
    data = {
        "ok": proof.ok and not has_errors(found),
        "accepted": list(taken),
        "problem_digest": proof.problem_digest,
        "rules": [dataclasses.asdict(rule) for rule in proof.rules],
        "issues": [issue.to_dict() for issue in found],
        "surfaces": faces,
    }
    return json.dumps(_plain(data), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def _plain(value: object) -> object:
    """Plain data for JSON: tuples as lists, NumPy's numbers as Python's, numbers that JSON lacks as None."""
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    return value
