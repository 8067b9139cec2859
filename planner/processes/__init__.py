"""Manufacturing processes: one folder each, with its plan, its claims and its part of the proof."""

from planner.runtime.plugins import Process

__all__ = ["Process"]
