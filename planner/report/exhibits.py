"""Draws ``Targets.exhibits`` by kind; it knows kinds of pictures, not processes.

An exhibit is a mapping of arrays and plain data with ``kind`` and ``title`` (``note`` optional):

``sections``  ``curves`` (S, P, 3) or a sequence of (P, 3) [m] in the stock frame; ``wanted`` alike, optional;
              ``value`` (S,), ``value_name``, ``unit`` optional: colours the curves. Drawn in space within the
              block, and laid over one another in their planes.
``paths``     ``curves``: sequence of (P, 3) [m] in the stock frame, drawn in space, coloured in their order.
``curve``     ``x`` (N,), ``x_label``, ``y_label``; ``series``: sequence of {``name``, ``y`` (N,),
              ``x`` if its own}; optional ``limits``: sequence of {``name``, ``value``}, ``equal``: one scale.
``table``     ``columns``: names; ``rows``: sequence of sequences.
``facts``     ``items``: sequence of (name, value) or (name, value, unit).
``setup``     as ``facts``, but shown in the setup sheet: what an operator mounts, cuts, sets or measures.
``heatmap``   ``points`` (M, 3) [m] and ``value`` (M,), ``unit``; ``limit`` optional: the colours
              then diverge from 0 up to it.
``mesh``      ``vertices`` (V, 3) [m], ``faces`` (F, 3): a shaded picture.
``tree``      ``nodes``: names; ``parent``: for each node the index of its parent, -1 for a root.
``text``      ``text``: a paragraph.

What does not follow its form becomes an issue ``report.exhibit`` and is left out of the report.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from planner.issues import Issue, Severity
from planner.report import charts, heatmap, markup, raster, sections, solids
from planner.report.markup import Raw

FloatArray = NDArray[np.float64]


_HALF = 6
"""Tables of more columns than this take the whole width."""


def draw(exhibits: Mapping[str, Any], block: FloatArray) -> tuple[list[Raw], list[Issue]]:
    """Figures of all exhibits but those of the setup sheet, and issues for those that cannot be drawn.

    ``block`` (2, 3) [m] are the lowest and the highest corner of the block as the operation finds it.
    """
    figures, issues = [], []
    for name, exhibit in exhibits.items():
        kind = exhibit.get("kind") if isinstance(exhibit, Mapping) else None
        try:
            if kind == "setup":
                _items(exhibit["items"])
                continue
            figures.append(_KINDS[str(kind)](exhibit, block))
        except (KeyError, TypeError, ValueError, IndexError, np.linalg.LinAlgError) as error:
            issues.append(_refused(name, kind, error))
    return figures, issues


def setup_items(exhibits: Mapping[str, Any]) -> list[tuple[Any, Any]]:
    """Names and values of all exhibits of kind ``setup``."""
    out: list[tuple[Any, Any]] = []
    for exhibit in exhibits.values():
        if isinstance(exhibit, Mapping) and exhibit.get("kind") == "setup":
            with contextlib.suppress(KeyError, TypeError, ValueError):  # draw() has said so
                out += _items(exhibit["items"])
    return out


def _refused(name: str, kind: Any, error: Exception) -> Issue:
    return Issue(
        "report.exhibit",
        f"exhibit {name!r} of kind {kind!r} cannot be drawn: {type(error).__name__}: {error}; "
        f"known kinds are {', '.join((*_KINDS, 'setup'))}",
        Severity.WARNING,
        field=name,
    )


def _items(items: Sequence[Any]) -> list[tuple[Any, Any]]:
    out = []
    for item in items:
        name, value, unit = (*item, "")[:3]
        shown = markup.text(value)
        out.append((name, Raw(f"{shown} {markup.text(unit)}" if unit else shown)))
    return out


def _paths(exhibit: Mapping[str, Any], block: FloatArray) -> Raw:
    curves = [np.asarray(c, dtype=np.float64) for c in exhibit["curves"]]
    order = np.arange(len(curves), dtype=np.float64)
    drawn = sections.in_space(curves, order, block) + sections.colour_key(order, "in order")
    return markup.figure(exhibit["title"], drawn, exhibit.get("note", ""))


def _sections(exhibit: Mapping[str, Any], block: FloatArray) -> Raw:
    curves = [np.asarray(c, dtype=np.float64) for c in exhibit["curves"]]
    wanted = [np.asarray(c, dtype=np.float64) for c in exhibit.get("wanted", ())]
    value = exhibit.get("value")
    value = np.arange(len(curves), dtype=np.float64) if value is None else np.asarray(value, dtype=np.float64)
    name = f"{exhibit.get('value_name', 'section')} [{exhibit['unit']}]" if exhibit.get("unit") else "section"
    space = sections.in_space(curves, value, block)
    plane = sections.in_plane(curves, wanted, value)
    key = sections.colour_key(value, name)
    note = exhibit.get("note", "")
    pair = markup.grid(
        [markup.figure(exhibit["title"], space + key), markup.figure("In their planes", plane, note)]
    )
    return Raw(f'<div class="wide">{pair}</div>')


def _curve(exhibit: Mapping[str, Any], block: FloatArray) -> Raw:
    del block
    x = exhibit.get("x")
    lines = [
        charts.Line(
            str(item["name"]),
            np.asarray(item.get("x", x), dtype=np.float64),
            np.asarray(item["y"], dtype=np.float64),
            i,
        )
        for i, item in enumerate(exhibit["series"])
    ]
    levels = [charts.Level(float(v["value"]), str(v["name"])) for v in exhibit.get("limits", ())]
    body = charts.chart(
        lines,
        x_label=str(exhibit.get("x_label", "")),
        y_label=str(exhibit.get("y_label", "")),
        levels=levels,
        equal=bool(exhibit.get("equal", False)),
    )
    return markup.figure(exhibit["title"], body, exhibit.get("note", ""))


def _table(exhibit: Mapping[str, Any], block: FloatArray) -> Raw:
    del block
    columns = tuple(exhibit["columns"])
    drawn = markup.figure(exhibit["title"], markup.table(columns, exhibit["rows"]), exhibit.get("note", ""))
    return Raw(f'<div class="wide">{drawn}</div>') if len(columns) > _HALF else drawn


def _facts(exhibit: Mapping[str, Any], block: FloatArray) -> Raw:
    del block
    return markup.figure(exhibit["title"], markup.facts(_items(exhibit["items"])), exhibit.get("note", ""))


def _heatmap(exhibit: Mapping[str, Any], block: FloatArray) -> Raw:
    del block
    points, value = np.asarray(exhibit["points"]), np.asarray(exhibit["value"], dtype=np.float64)
    body = heatmap.value_map(points, value, exhibit.get("limit"), str(exhibit.get("unit", "")))
    return markup.figure(exhibit["title"], body, exhibit.get("note", ""))


def _mesh(exhibit: Mapping[str, Any], block: FloatArray) -> Raw:
    del block
    vertices = np.asarray(exhibit["vertices"], dtype=np.float64)
    solid = solids.mesh(vertices, np.asarray(exhibit["faces"], dtype=np.int64), smooth=True)
    camera = raster.frame(vertices, np.array([-0.55, 1.0, -0.55]), 1000, 640)
    image = raster.draw(camera, [raster.Thing(solid, (0.55, 0.68, 0.74), 0.0, closed=False)])
    address = markup.png(image.color, np.isfinite(image.depth).astype(np.float64))
    picture = f'<div class="picture"><img alt="{markup.text(exhibit["title"])}" src="{address}"></div>'
    return markup.figure(exhibit["title"], picture, exhibit.get("note", ""))


def _tree(exhibit: Mapping[str, Any], block: FloatArray) -> Raw:
    del block
    parents = [int(p) for p in exhibit["parent"]]
    names = list(exhibit["nodes"])
    if len(names) != len(parents):
        raise ValueError(f"{len(names)} nodes but {len(parents)} parents")

    def below(parent: int, depth: int) -> str:
        if depth > 64:
            raise ValueError("the tree goes in a circle or is deeper than 64")
        found = [i for i, p in enumerate(parents) if p == parent]
        rows = "".join(f"<li>{markup.text(names[i])}{below(i, depth + 1)}</li>" for i in found)
        return f"<ul>{rows}</ul>" if rows else ""

    return markup.figure(exhibit["title"], below(-1, 0), exhibit.get("note", ""))


def _text(exhibit: Mapping[str, Any], block: FloatArray) -> Raw:
    del block
    return markup.figure(exhibit["title"], f"<p>{markup.text(exhibit['text'])}</p>", exhibit.get("note", ""))


_KINDS: Final[Mapping[str, Callable[[Mapping[str, Any], FloatArray], Raw]]] = {
    "paths": _paths,
    "sections": _sections,
    "curve": _curve,
    "table": _table,
    "facts": _facts,
    "heatmap": _heatmap,
    "mesh": _mesh,
    "tree": _tree,
    "text": _text,
}
