"""Tandem plans two robots that share one job, writes their programs and proves them from the program text.

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

_EXPORTS = {
    "Client": ("planner.service.client", "Client"),
    "Issue": ("planner.issues", "Issue"),
    "TandemError": ("planner.issues", "TandemError"),
    "Outcome": ("planner.pipeline", "Outcome"),
    "build": ("planner.pipeline", "build"),
    "check": ("planner.pipeline", "check"),
    "load": ("planner.pipeline", "load"),
    "plan": ("planner.pipeline", "plan"),
    "prove": ("planner.pipeline", "verify"),  # not "proof": planner.proof is a package
    "read_partly": ("planner.pipeline", "read_partly"),
    "read_programs": ("planner.pipeline", "read_programs"),
    "save": ("planner.pipeline", "save"),
}


def __getattr__(name: str) -> Any:
    """Import an exported name on first use, so that ``import planner`` alone does not load Drake."""
    if name not in _EXPORTS:
        raise AttributeError(f"module 'planner' has no attribute {name!r}")
    from importlib import import_module

    module, attribute = _EXPORTS[name]
    return getattr(import_module(module), attribute)


def __dir__() -> list[str]:
    """List the lazily imported names too, for ``dir`` and completion."""
    return sorted({*globals(), *__all__})
