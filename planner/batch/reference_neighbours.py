"""Choice of reference plans within an element: each panel starts from a neighbour that is planned before it.

Neighbours are listed in the ``element.json`` next to the folder of the panels. A few panels, spread over the
element, are planned without a reference (the roots). The panels around each root follow, ring by ring.
Several are planned at a time, and none waits for more than ``MAX_RINGS`` others. The choice depends on the
list of problems alone, not on the order in which jobs end or the number of workers.
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
"""A panel: the folder of its element, and its id."""


def assign_reference_neighbours(items: Sequence[BatchItem]) -> list[BatchItem]:
    """Set the reference of each item to the neighbouring panel whose plan is its reference plan.

    Panels are neighbours if the element says so and if they belong to the same job of the element. A few of
    the panels that are connected in this way have no reference, and neither have items that are not panels.

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
        message = "--like neighbour: none of the problems is a panel with an element.json next to its folder"
        hint = "give the panels/ folder that tandem element wrote, or the folder of an earlier batch"
        raise issue_error("batch.field", message, field="--like", hint=hint)
    references = _reference_forest(panels, panels_by_folder)
    return [dataclasses.replace(item, reference=references.get(item.name)) for item in items]


def reference_panels(
    data: Mapping[str, Any], panels: Sequence[str], done: Iterable[str] = ()
) -> dict[str, str]:
    """Choose the reference panels of some panels of an ``element.json``.

    Args:
        data: Contents of the file.
        panels: Ids of the panels, including those of ``done``.
        done: Ids of panels with results. They have no reference, and panels near them start from them.

    Returns:
        Id of the reference panel, by the id of the panel. Panels without a reference are missing.
    """
    done_panels = {(Path(), name) for name in done}
    return _reference_forest(
        {(Path(), name): name for name in panels}, {Path(): _jobs_and_neighbours(data)}, done_panels
    )


def _reference_forest(
    panels: Mapping[PanelKey, str],
    panels_by_folder: Mapping[Path, Mapping[str, tuple[str, tuple[str, ...]]]],
    done: Collection[PanelKey] = (),
) -> dict[str, str]:
    """Choose the reference of each panel: the neighbour from which a search from all roots reaches it first.

    Args:
        panels: Name of the item of each panel.
        panels_by_folder: Job and neighbours of all panels of an element, by its folder and the id.
        done: Panels with results, which are roots.

    Returns:
        Name of the reference item, by the name of the item. Roots are missing.
    """
    neighbours = {
        (folder, panel): [
            (folder, name)
            for name in panels_by_folder[folder][panel][1]
            if (folder, name) in panels
            and panels_by_folder[folder][name][0] == panels_by_folder[folder][panel][0]
        ]
        for folder, panel in panels
    }
    references: dict[str, str] = {}
    roots = [
        root for group in _connected_groups(neighbours) for root in _choose_roots(neighbours, group, done)
    ]
    for panel, predecessor in _breadth_first(neighbours, roots).items():
        if predecessor != panel:
            references[panels[panel]] = panels[predecessor]
    return references


def _connected_groups(neighbours: Mapping[PanelKey, Sequence[PanelKey]]) -> Iterator[list[PanelKey]]:
    """Yield each connected group of panels, in the order of a breadth-first search from its first panel."""
    seen: set[PanelKey] = set()
    for panel in neighbours:
        if panel not in seen:
            group = list(_breadth_first(neighbours, [panel]))
            seen.update(group)
            yield group


def _choose_roots(
    neighbours: Mapping[PanelKey, Sequence[PanelKey]], group: Sequence[PanelKey], done: Collection[PanelKey]
) -> list[PanelKey]:
    """Choose the roots of a connected group: the panels that are ``done`` or planned without a reference.

    All other panels are at most ``MAX_RINGS`` steps from a root. As long as some panels are farther away, the
    one of them that is farthest from the first panel of the group is taken. The panel ``MAX_RINGS`` steps
    before it, on the path from the first panel, becomes a root. On a tree this gives the smallest number of
    roots. Finally, each root that is not ``done`` is moved to the middle of the panels nearest to it.

    Args:
        neighbours: Neighbours of each panel.
        group: Panels of the group, in the order of a breadth-first search from the first one.
        done: Panels with results, of this and other groups.
    """
    predecessors = _breadth_first(neighbours, [group[0]])
    roots = [panel for panel in group if panel in done]
    covered = set(_breadth_first(neighbours, roots, MAX_RINGS))
    for panel in reversed(group):
        if panel in covered:
            continue
        for _ in range(MAX_RINGS):
            panel = predecessors[panel]
        roots.append(panel)
        covered.update(_breadth_first(neighbours, [panel], MAX_RINGS))
    cells: dict[PanelKey, list[PanelKey]] = {root: [] for root in roots}
    root_of_panel: dict[PanelKey, PanelKey] = {}
    for panel, predecessor in _breadth_first(neighbours, roots).items():
        root_of_panel[panel] = root_of_panel.get(predecessor, panel)
        cells[root_of_panel[panel]].append(panel)
    return [root if root in done else _middle_panel(neighbours, cell) for root, cell in cells.items()]


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
    """Search ring by ring from the ``roots``, at most ``rings`` of them if that is given.

    Returns:
        Predecessor of each panel that was reached, in the order of the search. A root is its own predecessor.
    """
    predecessors = {panel: panel for panel in roots}
    ring = list(predecessors)
    while ring and rings != 0:
        next_ring = []
        for panel in ring:
            for neighbour in neighbours[panel]:
                if neighbour not in predecessors:
                    predecessors[neighbour] = panel
                    next_ring.append(neighbour)
        ring, rings = next_ring, None if rings is None else rings - 1
    return predecessors


def _read_panels(path: Path) -> dict[str, tuple[str, tuple[str, ...]]]:
    """Return job and neighbours of each panel by id. The result is empty if there is no valid file."""
    try:
        return _jobs_and_neighbours(json.loads(path.read_text("utf-8")))
    except (OSError, ValueError, KeyError, TypeError):
        return {}


def _jobs_and_neighbours(data: Mapping[str, Any]) -> dict[str, tuple[str, tuple[str, ...]]]:
    """Return the job and the ids of the neighbours of each panel of an ``element.json``, by its id."""
    panels = data["panels"]
    return {
        str(panel["id"]): (
            str(panel.get("job", "")),
            tuple(str(name) for name in panel["neighbours"] if name),
        )
        for panel in panels
    }
