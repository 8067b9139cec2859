"""Description of the computer and the packages that a measurement ran on."""

from __future__ import annotations

import platform
from importlib.metadata import version
from pathlib import Path

PACKAGES = ("drake", "numpy", "scipy", "toppra", "py-opw-kinematics")
"""Packages whose versions are recorded with each result."""


def machine() -> dict[str, str]:
    """Describe the processor, and the versions of Python and of :data:`PACKAGES`."""
    cpu = Path("/proc/cpuinfo")
    lines = cpu.read_text().splitlines() if cpu.exists() else []
    model = next(
        (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "unknown"
    )
    return {"cpu": model, "python": platform.python_version(), **{name: version(name) for name in PACKAGES}}
