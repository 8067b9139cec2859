"""Programs brought back from a controller: which data somebody touched up there, by how much."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import PurePosixPath
from typing import Any

import numpy as np

from planner.issues import Issue, TandemError
from planner.loading.store import Store
from planner.verify.programs import program_text
from planner.verify.programs.steps import rotation
from planner.verify.rapid.reader import Limits, read_task
from planner.verify.rapid.syntax_tree import Literal

RAPID = (".mod", ".modx", ".sys", ".sysx")
"""Endings of modules whose data are compared one by one."""
MOST_BYTES = 20_000_000
"""Bytes of one module that is read."""


def fetch(store: Store, folder: str) -> dict[str, bytes]:
    """All files under a folder by their names in it. Raises ``TandemError`` (``upload.missing``)."""
    out: dict[str, bytes] = {}
    todo = [""]
    while todo:
        inner = todo.pop()
        there = store.listing(f"{folder}/{inner}".rstrip("/"))
        if there is None:
            what = f"{folder}: no such folder on the controller; give the one that upload named by --folder"
            raise TandemError(Issue("upload.missing", what))
        for name, deeper in there.items():
            path = f"{inner}/{name}".lstrip("/")
            if deeper:
                todo.append(path)
            elif (content := store.read(f"{folder}/{path}")) is not None:
                out[path] = content
    if not out:
        raise TandemError(Issue("upload.missing", f"{folder}: no files in it"))
    return out


def touched(planned: Mapping[str, bytes], back: Mapping[str, bytes]) -> tuple[Issue, ...]:
    """What differs between the files of a result and those that came back: data by name, with distance [mm]
    and turn [deg] of poses, else the first line that differs."""
    out = []
    for name in sorted({*planned, *back}):
        if name not in back or name not in planned:
            what = f"{name} is {'missing on' if name not in back else 'only on'} the controller"
            out.append(Issue("upload.touched", what, file=name))
        elif planned[name] != back[name]:
            texts = [program_text.decode(content, name) for content in (planned[name], back[name])]
            rapid = PurePosixPath(name).suffix.lower() in RAPID
            found = _data(name, *texts) if rapid else []
            found = found or [f"line {_line(*texts)} differs"]
            out += [Issue("upload.touched", one, file=name) for one in found]
    return tuple(out)


def _line(first: str, second: str) -> int:
    lines = zip(first.splitlines(), second.splitlines(), strict=False)
    short = min(len(first.splitlines()), len(second.splitlines()))
    return next((k for k, (a, b) in enumerate(lines, 1) if a != b), short + 1)


def _data(name: str, first: str, second: str) -> list[str]:
    sides = []
    for text in (first, second):
        modules = read_task({name: text}, Limits(bytes=MOST_BYTES)).modules
        sides.append(
            {
                datum.name.lower(): (datum.kind, datum.name, datum.initial.value)
                for module in modules
                for datum in module.data
                if isinstance(datum.initial, Literal)
            }
        )
    out = []
    for key in sorted(sides[0].keys() & sides[1].keys()):
        kind, shown, old = sides[0][key]
        new = sides[1][key][2]
        if repr(old) != repr(new):
            out.append(f"{kind} {shown}: {_how_far(kind, old, new)}")
    return out


def _how_far(kind: str, old: Any, new: Any) -> str:
    if kind in ("robtarget", "pose"):
        try:
            a, b = (pose_numbers(value) for value in (old, new))
        except (AttributeError, TypeError, ValueError, IndexError):
            return f"was {old}, is {new}"
        turn = rotation(a[1]).T @ rotation(b[1])
        angle = np.degrees(np.arccos(np.clip(0.5 * (np.trace(turn) - 1.0), -1.0, 1.0)))
        return f"moved by {np.linalg.norm(a[0] - b[0]):.3f} mm, turned by {angle:.3f} deg"
    return f"was {old}, is {new}"


def pose_numbers(value: Any) -> tuple[Any, Any]:
    """Position (3,) [mm] and quaternion (4,) of a robtarget or pose, as read or as a list."""
    if hasattr(value, "position"):
        return 1e3 * value.position, value.quaternion
    return np.array(value[0], dtype=float), np.array(value[1], dtype=float)
