"""Tandem: plans two robots that share one job, writes their programs and proves them from their own text."""

from __future__ import annotations

__version__ = "0.1.0"
