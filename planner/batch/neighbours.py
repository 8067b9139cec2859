"""Which panel of an element is planned like which: each like a neighbour that is planned before it.

Neighbours stand in the ``element.json`` beside the folder of the panels. The first one is planned by itself,
then ring by ring those around it: who is like whom follows from the element, not from what ends first.
"""

from __future__ import annotations

import collections
import dataclasses
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from planner.issues import Issue, TandemError

if TYPE_CHECKING:
    from planner.batch.run import Item

ELEMENT = "element.json"
"""The file of an element that has its panels with their neighbours."""


def like_neighbours(items: Sequence[Item]) -> list[Item]:
    """The items, each with the neighbour that it is planned like; the first one of those that hang together
    and have the same job has none. Raises ``TandemError`` (``batch.field``) where no item is a panel of an
    element."""
    known: dict[Path, dict[str, tuple[str, tuple[str, ...]]]] = {}
    panels: dict[tuple[Path, str], str] = {}
    for item in items:
        path = Path(item.origin).resolve()
        folder = path.parent.parent
        if folder not in known:
            known[folder] = _panels(folder / ELEMENT)
        if path.stem in known[folder]:
            panels[folder, path.stem] = item.name
    if not panels:
        what = "--like neighbour: none of the problems is a panel beside whose folder an element.json lies"
        hint = "name the panels/ folder that tandem element wrote, or the folder of an earlier batch"
        raise TandemError(Issue("batch.field", what, field="--like", hint=hint))
    like = _rings(panels, known)
    return [dataclasses.replace(item, like=like.get(item.name)) for item in items]


def like_within(data: Mapping[str, Any], panels: Sequence[str]) -> dict[str, str]:
    """The same of those ``panels`` of an ``element.json``, by ids: the one that each is planned like."""
    return _rings({(Path(), name): name for name in panels}, {Path(): _jobs_and_neighbours(data)})


def _rings(
    panels: Mapping[tuple[Path, str], str], known: Mapping[Path, Mapping[str, tuple[str, tuple[str, ...]]]]
) -> dict[str, str]:
    """The item {name: name} from which each panel is reached first."""
    like: dict[str, str] = {}
    seen: set[tuple[Path, str]] = set()
    for first in panels:
        if first in seen:
            continue
        seen.add(first)
        waiting = collections.deque([first])
        while waiting:
            folder, panel = waiting.popleft()
            job, neighbours = known[folder][panel]
            for beyond in ((folder, name) for name in neighbours):
                if beyond in panels and beyond not in seen and known[folder][beyond[1]][0] == job:
                    seen.add(beyond)
                    like[panels[beyond]] = panels[folder, panel]
                    waiting.append(beyond)
    return like


def _panels(path: Path) -> dict[str, tuple[str, tuple[str, ...]]]:
    """The job and the neighbours of each panel; empty where there is no such file, or it is none."""
    try:
        return _jobs_and_neighbours(json.loads(path.read_text("utf-8")))
    except (OSError, ValueError, KeyError, TypeError):
        return {}


def _jobs_and_neighbours(data: Mapping[str, Any]) -> dict[str, tuple[str, tuple[str, ...]]]:
    rows = data["panels"]
    return {str(row["id"]): (str(row["job"]), tuple(str(n) for n in row["neighbours"] if n)) for row in rows}
