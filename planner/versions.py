"""Versions of what plans depend on."""

from __future__ import annotations

import importlib.metadata
import platform
from typing import Final

PACKAGES: Final = ("tandem-planner", "drake", "numpy", "scipy", "toppra")


def versions() -> dict[str, str]:
    """Versions of what the plan depends on."""
    out = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            out[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            out[name] = "not installed"
    return out
