"""Installation of packages for a test: writes the metadata that importlib.metadata finds into a folder."""

from __future__ import annotations

from pathlib import Path

import pytest

from planner.processes import registry
from planner.runtime import plugins
from planner.runtime.plugins import Language, Process
from tests import small_problem

RING = (
    "{name: ring, process: ring, arms: [left], radius_mm: 40, height_mm: 300, least_mm: 299, feed_mm_s: 20}"
)
"""An operation of the gauge."""


def install(
    path: pytest.MonkeyPatch,
    folder: Path,
    package: str,
    *points: str,
    kind: type[Process | Language] = Process,
) -> None:
    """Install a package with entry points.

    Args:
        path: Puts the package on the module path, until it is undone.
        folder: Where the metadata is written.
        package: Name of the package.
        points: Lines such as ``ring = tests.toys.gauge:PROCESS``.
        kind: What the entry points add.
    """
    info = folder / package / f"{package}-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("\n".join([f"[{kind.GROUP}]", *points]) + "\n")
    path.syspath_prepend(folder / package)
    forget()


def forget() -> None:
    """Forget which packages were found."""
    for found in (plugins.installed, plugins.loadable, registry.all_processes):
        found.cache_clear()


def problem(folder: Path, operation: str = RING) -> Path:
    """Write a problem with one arm above a block, and that operation."""
    head, _ = small_problem.PROBLEM.split("operations:")
    return small_problem.write(folder, f"{head}operations:\n  - {operation}\n")
