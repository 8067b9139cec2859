"""Tandem: plans two robots that share one job, writes their programs and proves them from their own text.

>>> import planner
>>> problem = planner.load("problems/column_capital/problem.yaml")
>>> outcome = planner.plan(problem)
>>> outcome.save("out")
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from planner.runtime.version import __version__

__all__ = [
    "Client",
    "Issue",
    "Outcome",
    "TandemError",
    "__version__",
    "build",
    "check",
    "load",
    "plan",
    "prove",
    "read_partly",
    "read_programs",
    "save",
]

if TYPE_CHECKING:
    from planner.issues import Issue, TandemError
    from planner.pipeline import Outcome, build, check, load, plan, read_partly, read_programs, save
    from planner.pipeline import verify as prove
    from planner.service.client import Client

_HOME = {
    "Client": ("planner.service.client", "Client"),
    "Issue": ("planner.issues", "Issue"),
    "TandemError": ("planner.issues", "TandemError"),
    "Outcome": ("planner.pipeline", "Outcome"),
    "build": ("planner.pipeline", "build"),
    "check": ("planner.pipeline", "check"),
    "load": ("planner.pipeline", "load"),
    "plan": ("planner.pipeline", "plan"),
    "prove": ("planner.pipeline", "verify"),  # planner.proof is the package of the proof
    "read_partly": ("planner.pipeline", "read_partly"),
    "read_programs": ("planner.pipeline", "read_programs"),
    "save": ("planner.pipeline", "save"),
}


def __getattr__(name: str) -> Any:
    """Import on first use: ``import planner`` alone must not load Drake."""
    if name not in _HOME:
        raise AttributeError(f"module 'planner' has no attribute {name!r}")
    from importlib import import_module

    module, own = _HOME[name]
    return getattr(import_module(module), own)


def __dir__() -> list[str]:
    """What :func:`__getattr__` imports is there for ``dir`` and completion, too."""
    return sorted({*globals(), *__all__})
