"""Targets that were made for uploads, kept as files for a while: an edit of the cell leaves them as they are.

A whole check takes those of the very same problem. A first look takes those of a problem that differs in
nothing that a process sees as well: a job is made of its operation, of tools, controller and wires of the
cell, of block and part, so where arms and block stand, obstacles, margins and names do not count, but how a
block leans does. Brief ones, which a first look made, are for first looks alone. The files are pickles of
this service's own, in a folder that nobody else writes into.
"""

from __future__ import annotations

import os
import pickle
import secrets
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import numpy as np

from planner.pipeline import Make
from planner.problem import Problem
from planner.reading import problem as problem_file
from planner.targets import Job, Targets

MOST_BYTES: Final = 300_000_000
"""Files that are kept at most; those that were not asked for the longest time go first."""
UNSEEN: Final = ("name", "settings", "accept")
"""Fields of a problem that no process sees;"""
UNSEEN_CELL: Final = ("name", "obstacles")
"""of its cell,"""
UNSEEN_ARM: Final = ("base", "home_deg")
"""of an arm,"""
UNSEEN_STOCK: Final = ("place",)
"""of the stock, or a sheet, and of the setup of an operation."""
DECIMALS: Final = 9
"""To which directions are compared."""


def seen(source: Mapping[str, Any]) -> str:
    """The digest of what processes see of a problem's values, but how its blocks lean."""
    out = _without(source, UNSEEN)
    if isinstance(out.get("cell"), Mapping):
        out["cell"] = _without(out["cell"], UNSEEN_CELL)
        if isinstance(out["cell"].get("arms"), list):
            out["cell"]["arms"] = _each_without(out["cell"]["arms"], UNSEEN_ARM)
    for name in ("stock", "sheet"):
        if isinstance(out.get(name), Mapping):
            out[name] = _without(out[name], UNSEEN_STOCK)
    if isinstance(out.get("operations"), list):
        out["operations"] = [_placeless(one) for one in out["operations"]]
    return problem_file.digest(out)


def seen_alike(problem: Problem) -> str:
    """The same of a problem, with how each setup's block leans: wires sag, and what is cut loose falls."""
    lean = [np.round(setup.stock.gravity, DECIMALS).tolist() for setup in problem.setups]
    return problem_file.digest({"seen": seen(problem.source), "gravity": lean})


def _placeless(operation: Any) -> Any:
    """An operation whose setup says of the block's place nothing."""
    if not isinstance(operation, Mapping) or not isinstance(operation.get("setup"), Mapping):
        return operation
    return {**operation, "setup": _without(operation["setup"], UNSEEN_STOCK)}


def _each_without(values: list[Any], fields: tuple[str, ...]) -> list[Any]:
    return [_without(one, fields) if isinstance(one, Mapping) else one for one in values]


def _without(values: Mapping[str, Any], fields: tuple[str, ...]) -> dict[str, Any]:
    return {key: value for key, value in values.items() if key not in fields}


def maker(folder: Path, problem: Problem, alike: bool) -> Make:
    """What makes the targets of a problem's operations and keeps them in ``folder``, or finds them there;
    ``alike``: those of a problem that processes see alike will do."""
    same, like = problem.digest, seen_alike(problem)

    def make(index: int, job: Job[Any]) -> Targets:
        whole = [folder / f"{same}-{index}", folder / f"{like}-{index}"]
        brief = folder / f"{like}-{index}-brief"
        for path in whole if alike else whole[:1]:
            if found := _kept(path):
                return found
        if job.brief and alike and (found := _kept(brief)):
            return found
        made = job.targets()
        _keep(folder, [brief] if job.brief else whole, pickle.dumps(made, pickle.HIGHEST_PROTOCOL))
        return made

    return make


def _kept(path: Path) -> Targets | None:
    """What is kept there, which is used now; None where there is nothing."""
    with suppress(OSError, EOFError, pickle.UnpicklingError):
        made = pickle.loads(path.read_bytes())
        if isinstance(made, Targets):
            os.utime(path)
            return made
    return None


def _keep(folder: Path, names: list[Path], content: bytes) -> None:
    """Write a file under several names, each whole or not at all; on a full disk, none."""
    if len(content) > MOST_BYTES // 2:
        return
    with suppress(OSError):
        folder.mkdir(exist_ok=True, mode=0o700)
        _make_room(folder, len(content))
        for path in names:
            new = folder / f".{secrets.token_hex(8)}"
            if path is names[0]:
                new.write_bytes(content)
            else:
                new.hardlink_to(names[0])
            new.replace(path)


def _make_room(folder: Path, size: int) -> None:
    """Remove what was asked for the longest time ago until ``size`` bytes more have room."""
    known = []
    for path in folder.iterdir():
        with suppress(OSError):  # another process has removed it
            about = path.stat()
            known.append((about.st_mtime, about.st_size / about.st_nlink, path))
    total = sum(own for _, own, _ in known)
    for _, own, path in sorted(known):
        if total + size <= MOST_BYTES:
            break
        path.unlink(missing_ok=True)
        total -= own
