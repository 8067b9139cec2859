"""Which panel of an element is planned like which: each like a neighbour that is planned before it.

Neighbours stand in the ``element.json`` beside the folder of the panels. A few panels, spread over the
element, are planned by themselves, then ring by ring those around each: several at a time, and none has to
wait for more than ``RINGS`` others. Who is like whom follows from the list of problems alone, not from what
ends first or how many workers there are.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from planner.issues import refusal

if TYPE_CHECKING:
    from planner.batch.rows import Item

ELEMENT = "element.json"
"""The file of an element that has its panels with their neighbours."""
RINGS: Final = 6
"""So many panels at most are planned one after the other, each like the one before it, behind one that is
planned by itself."""

Panel: TypeAlias = tuple[Path, str]
"""The folder of its element and its id."""


def like_neighbours(items: Sequence[Item]) -> list[Item]:
    """The items, each with the neighbour that it is planned like; few of those that hang together and
    have the same job have none. Raises ``TandemError`` (``batch.field``) where no item is a panel of an
    element."""
    known: dict[Path, dict[str, tuple[str, tuple[str, ...]]]] = {}
    panels: dict[Panel, str] = {}
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
        raise refusal("batch.field", what, field="--like", hint=hint)
    like = _forest(panels, known)
    return [dataclasses.replace(item, like=like.get(item.name)) for item in items]


def like_within(data: Mapping[str, Any], panels: Sequence[str], done: Iterable[str] = ()) -> dict[str, str]:
    """The same of those ``panels`` of an ``element.json``, by ids: the one that each is planned like. Those
    that are ``done`` are like none, and panels near them begin with theirs."""
    there = {(Path(), name) for name in done}
    return _forest({(Path(), name): name for name in panels}, {Path(): _jobs_and_neighbours(data)}, there)


def _forest(
    panels: Mapping[Panel, str],
    known: Mapping[Path, Mapping[str, tuple[str, tuple[str, ...]]]],
    done: Collection[Panel] = (),
) -> dict[str, str]:
    """The item {name: name} from which each panel is reached first, ring by ring from all of the firsts."""
    beyond = {
        (folder, panel): [
            (folder, name)
            for name in known[folder][panel][1]
            if (folder, name) in panels and known[folder][name][0] == known[folder][panel][0]
        ]
        for folder, panel in panels
    }
    like: dict[str, str] = {}
    firsts = [first for whole in _parts(beyond) for first in _firsts(beyond, whole, done)]
    for panel, before in _reached(beyond, firsts).items():
        if before != panel:
            like[panels[panel]] = panels[before]
    return like


def _parts(beyond: Mapping[Panel, Sequence[Panel]]) -> Iterator[list[Panel]]:
    """Panels that hang together, each part beginning at its first one, ring by ring."""
    seen: set[Panel] = set()
    for panel in beyond:
        if panel not in seen:
            part = list(_reached(beyond, [panel]))
            seen.update(part)
            yield part


def _firsts(
    beyond: Mapping[Panel, Sequence[Panel]], part: Sequence[Panel], done: Collection[Panel]
) -> list[Panel]:
    """Those that are planned by themselves, or are ``done``: all others of a part are no more than ``RINGS``
    steps from one of them.

    From the farthest panel that none is near yet, so many steps back (the least number of them where panels
    hang together as a tree); then each is put in the middle of what is nearest to it, which is as near then.
    """
    way = _reached(beyond, [part[0]])
    there = [panel for panel in part if panel in done]
    firsts, near = there, set(_reached(beyond, there, RINGS))
    for panel in reversed(part):
        if panel in near:
            continue
        for _ in range(RINGS):
            panel = way[panel]
        firsts.append(panel)
        near.update(_reached(beyond, [panel], RINGS))
    cells: dict[Panel, list[Panel]] = {first: [] for first in firsts}
    source: dict[Panel, Panel] = {}
    for panel, before in _reached(beyond, firsts).items():
        source[panel] = source.get(before, panel)
        cells[source[panel]].append(panel)
    return [first if first in done else _middle(beyond, cell) for first, cell in cells.items()]


def _middle(beyond: Mapping[Panel, Sequence[Panel]], cell: Sequence[Panel]) -> Panel:
    """The panel of a cell that is fewest steps from its farthest one, then from all of them."""
    inside = set(cell)
    within = {panel: [one for one in beyond[panel] if one in inside] for panel in cell}

    def far(panel: Panel) -> tuple[int, int]:
        steps: dict[Panel, int] = {}
        for one, before in _reached(within, [panel]).items():
            steps[one] = steps[before] + 1 if one != before else 0
        return max(steps.values()), sum(steps.values())

    return min(cell, key=far)  # the first one of those alike


def _reached(
    beyond: Mapping[Panel, Sequence[Panel]], firsts: Iterable[Panel], rings: int | None = None
) -> dict[Panel, Panel]:
    """Panels that are reached from the ``firsts``, in their order, each with the one that it is reached from
    (a first one from itself), ring by ring, no more than ``rings``."""
    out = {panel: panel for panel in firsts}
    ring = list(out)
    while ring and rings != 0:
        after = []
        for panel in ring:
            for one in beyond[panel]:
                if one not in out:
                    out[one] = panel
                    after.append(one)
        ring, rings = after, None if rings is None else rings - 1
    return out


def _panels(path: Path) -> dict[str, tuple[str, tuple[str, ...]]]:
    """The job and the neighbours of each panel; empty where there is no such file, or it is none."""
    try:
        return _jobs_and_neighbours(json.loads(path.read_text("utf-8")))
    except (OSError, ValueError, KeyError, TypeError):
        return {}


def _jobs_and_neighbours(data: Mapping[str, Any]) -> dict[str, tuple[str, tuple[str, ...]]]:
    rows = data["panels"]
    return {
        str(row["id"]): (str(row.get("job", "")), tuple(str(n) for n in row["neighbours"] if n))
        for row in rows
    }
