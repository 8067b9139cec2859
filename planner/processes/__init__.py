"""Manufacturing processes: one folder each, with its plan, its claims and its part of the proof."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from planner.processes.process import Process

__all__ = ["Process"]


def __getattr__(name: str) -> Any:
    """Load the public name on first use, so that importing a folder of this package loads nothing else."""
    if name == "Process":
        from planner.processes.process import Process

        return Process
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
