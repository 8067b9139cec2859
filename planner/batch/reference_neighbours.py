"""Choice of reference plans within an element: each panel starts from a neighbour that is planned before it.

Neighbours are listed in the ``element.json`` next to the folder of the panels. A few panels, spread over the
element, are planned without a reference, then those around each, ring by ring. Several are planned at a time,
and none waits for more than ``MAX_RINGS`` others. The choice follows from the list of problems alone, not
from the order in which jobs end or the number of workers.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from planner.issues import issue_error

if TYPE_CHECKING:
    from planner.batch.rows import BatchItem

ELEMENT_DATA_FILE = "element.json"
"""File of an element that lists its panels with their neighbours."""
MAX_RINGS: Final = 6
"""Maximum number of panels that are planned one after another, each from the previous one.

They follow a panel that is planned without reference.
"""

PanelKey: TypeAlias = tuple[Path, str]
"""Folder of its element and its id."""


def assign_reference_neighbours(items: Sequence[BatchItem]) -> list[BatchItem]:
    """Return the items, each with the neighbour from which it is planned.

    Few of those that are connected and have the same job have none.

    Raises:
        TandemError: ``batch.field``, if no item is a panel of an element.
    """
    panels_by_folder: dict[Path, dict[str, tuple[str, tuple[str, ...]]]] = {}
    panels: dict[PanelKey, str] = {}
    for item in items:
        path = Path(item.origin).resolve()
        folder = path.parent.parent
        if folder not in panels_by_folder:
            panels_by_folder[folder] = _read_panels(folder / ELEMENT_DATA_FILE)
        if path.stem in panels_by_folder[folder]:
            panels[folder, path.stem] = item.name
    if not panels:
        what = "--like neighbour: none of the problems is a panel with an element.json next to its folder"
        hint = "give the panels/ folder that tandem element wrote, or the folder of an earlier batch"
        raise issue_error("batch.field", what, field="--like", hint=hint)
    references = _reference_forest(panels, panels_by_folder)
    return [dataclasses.replace(item, reference=references.get(item.name)) for item in items]


def reference_panels(
    data: Mapping[str, Any], panels: Sequence[str], done: Iterable[str] = ()
) -> dict[str, str]:
    """Return the reference {id: id} of each of some panels of an ``element.json``.

    Args:
        data: Contents of the file.
        panels: Ids of the panels.
        done: Ids of panels with results. They have no reference, and panels near them start from them.
    """
    done_panels = {(Path(), name) for name in done}
    return _reference_forest(
        {(Path(), name): name for name in panels}, {Path(): _jobs_and_neighbours(data)}, done_panels
    )


def _reference_forest(
    panels: Mapping[PanelKey, str],
    known: Mapping[Path, Mapping[str, tuple[str, tuple[str, ...]]]],
    done: Collection[PanelKey] = (),
) -> dict[str, str]:
    """Return the item {name: name} from which each panel is reached first.

    The search goes ring by ring from all first panels.
    """
    neighbours = {
        (folder, panel): [
            (folder, name)
            for name in known[folder][panel][1]
            if (folder, name) in panels and known[folder][name][0] == known[folder][panel][0]
        ]
        for folder, panel in panels
    }
    references: dict[str, str] = {}
    roots = [
        first for part in _connected_parts(neighbours) for first in _choose_roots(neighbours, part, done)
    ]
    for panel, source in _breadth_first(neighbours, roots).items():
        if source != panel:
            references[panels[panel]] = panels[source]
    return references


def _connected_parts(neighbours: Mapping[PanelKey, Sequence[PanelKey]]) -> Iterator[list[PanelKey]]:
    """Yield connected panels, each part from its first one, ring by ring."""
    seen: set[PanelKey] = set()
    for panel in neighbours:
        if panel not in seen:
            part = list(_breadth_first(neighbours, [panel]))
            seen.update(part)
            yield part


def _choose_roots(
    neighbours: Mapping[PanelKey, Sequence[PanelKey]], part: Sequence[PanelKey], done: Collection[PanelKey]
) -> list[PanelKey]:
    """Return the panels that are planned without reference, or are ``done``.

    All others of a part are no more than ``MAX_RINGS`` steps from one of them. Each is chosen that many steps
    back from the farthest panel that is not near one yet (the smallest number if panels are connected as a
    tree). Then each is moved to the middle of the panels nearest to it.
    """
    predecessors = _breadth_first(neighbours, [part[0]])
    done_panels = [panel for panel in part if panel in done]
    roots, covered = done_panels, set(_breadth_first(neighbours, done_panels, MAX_RINGS))
    for panel in reversed(part):
        if panel in covered:
            continue
        for _ in range(MAX_RINGS):
            panel = predecessors[panel]
        roots.append(panel)
        covered.update(_breadth_first(neighbours, [panel], MAX_RINGS))
    cells: dict[PanelKey, list[PanelKey]] = {first: [] for first in roots}
    source: dict[PanelKey, PanelKey] = {}
    for panel, predecessor in _breadth_first(neighbours, roots).items():
        source[panel] = source.get(predecessor, panel)
        cells[source[panel]].append(panel)
    return [first if first in done else _middle_panel(neighbours, cell) for first, cell in cells.items()]


def _middle_panel(neighbours: Mapping[PanelKey, Sequence[PanelKey]], cell: Sequence[PanelKey]) -> PanelKey:
    """Return the panel of a cell with the fewest steps to its farthest one, then to all of them."""
    inside = set(cell)
    neighbours_inside = {panel: [other for other in neighbours[panel] if other in inside] for panel in cell}

    def eccentricity(panel: PanelKey) -> tuple[int, int]:
        steps: dict[PanelKey, int] = {}
        for other, predecessor in _breadth_first(neighbours_inside, [panel]).items():
            steps[other] = steps[predecessor] + 1 if other != predecessor else 0
        return max(steps.values()), sum(steps.values())

    return min(cell, key=eccentricity)  # the first one of equals


def _breadth_first(
    neighbours: Mapping[PanelKey, Sequence[PanelKey]], roots: Iterable[PanelKey], rings: int | None = None
) -> dict[PanelKey, PanelKey]:
    """Return the panels reached from the ``roots``, in order, each with the one that it is reached from.

    First panels are reached from themselves. The search proceeds ring by ring, at most ``rings`` of them.
    """
    out = {panel: panel for panel in roots}
    ring = list(out)
    while ring and rings != 0:
        next_ring = []
        for panel in ring:
            for neighbour in neighbours[panel]:
                if neighbour not in out:
                    out[neighbour] = panel
                    next_ring.append(neighbour)
        ring, rings = next_ring, None if rings is None else rings - 1
    return out


def _read_panels(path: Path) -> dict[str, tuple[str, tuple[str, ...]]]:
    """Return the job and the neighbours of each panel; empty if there is no valid file."""
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
