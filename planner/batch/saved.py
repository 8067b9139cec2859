"""A result folder as it was saved: the plan, what the proof said of it, and its figures."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path

from planner import plan_io
from planner.batch.figures import figures
from planner.issues import Issue, TandemError, aggregate
from planner.plans import Plan
from planner.verify.result import RuleResult


@dataclasses.dataclass(frozen=True)
class Saved:
    """A saved plan. ``ok``: its programs were proven; None where the folder has no proof."""

    folder: Path
    plan: Plan
    ok: bool | None
    rules: tuple[RuleResult, ...]
    issues: tuple[Issue, ...]
    figures: Mapping[str, float]


def read(folder: Path) -> Saved:
    """The result in a folder. Raises ``TandemError`` (``plan.missing_file``, ``plan.damaged``,
    ``plan.schema``)."""
    plan = plan_io.load(folder)
    path = folder / "proof.json"
    ok, rules, issues = _proof(path) if path.is_file() else (None, (), ())
    found = [*plan.issues, *(issue for op in plan.operations for issue in op.issues), *issues]
    return Saved(folder, plan, ok, rules, aggregate(found), figures(plan, rules))


def _proof(path: Path) -> tuple[bool | None, tuple[RuleResult, ...], tuple[Issue, ...]]:
    try:
        data = json.loads(path.read_text("utf-8"))
        rules = tuple(RuleResult(**rule) for rule in data["rules"])
        return bool(data["ok"]), rules, tuple(Issue.from_dict(issue) for issue in data["issues"])
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        what = f"{path.name} is damaged: {type(error).__name__}: {error}"
        raise TandemError(
            Issue("plan.damaged", what, file=str(path), hint="plan the problem again")
        ) from error
