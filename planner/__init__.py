"""Tandem: plans two robots that share one job, writes their programs and proves them from their own text.

>>> import planner
>>> problem = planner.load("problems/column_capital/problem.yaml")
>>> outcome = planner.plan(problem)
>>> outcome.save("out")
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"
__all__ = ["Client", "Issue", "Outcome", "TandemError", "__version__", "check", "load", "plan"]

if TYPE_CHECKING:
    from planner.issues import Issue, TandemError
    from planner.pipeline import Outcome, check, load, plan
    from planner.service.client import Client

_HOME = {
    "Client": "planner.service.client",
    "Issue": "planner.issues",
    "TandemError": "planner.issues",
    "Outcome": "planner.pipeline",
    "check": "planner.pipeline",
    "load": "planner.pipeline",
    "plan": "planner.pipeline",
}


def __getattr__(name: str) -> Any:
    """Import on first use: ``import planner`` alone must not load Drake."""
    if name not in _HOME:
        raise AttributeError(f"module 'planner' has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(_HOME[name]), name)
