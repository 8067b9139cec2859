"""A new base for one arm of a cell's file: only the numbers change, comments and layout stay."""

from __future__ import annotations

import copy
from typing import Any, Final

import numpy as np
import yaml
from numpy.typing import NDArray

from planner.geometry.rigid import to_rpy
from planner.issues import Issue, TandemError
from planner.units import DEG, MM
from planner.yaml_lines import Document

FloatArray = NDArray[np.float64]
Change = tuple[int, int, str]
"""From where to where text is replaced, and by what."""
PARTS: Final = ("xyz_mm", "rpy_deg")


def rounded(base: FloatArray) -> tuple[list[float], list[float]]:
    """Position [mm] to 0.1 um and roll, pitch, yaw [deg] to 1e-6 deg of a pose (4, 4), as in files."""
    xyz = [round(float(v), 4) + 0.0 for v in base[:3, 3] / MM]
    rpy = [round(float(v), 6) + 0.0 for v in to_rpy(base[:3, :3]) / DEG]
    return xyz, rpy


def with_base(document: Document, index: int, base: FloatArray) -> str:
    """The text of a cell's file in which the arm ``index`` has the ``base`` (4, 4), which is no longer to
    be searched.

    Raises `TandemError` (align.cell) where the file's layout does not allow it: an alias, for example.
    """
    text = document.text.decode("utf-8-sig")
    before: Any = yaml.safe_load(text)
    values = dict(zip(PARTS, rounded(base), strict=True))
    root = yaml.compose(text, Loader=yaml.SafeLoader)
    if root is None:
        raise ValueError("an empty file is no cell")
    try:
        changes = _changes(root, index, values)
        for start, end, new in sorted(changes, reverse=True):
            text = text[:start] + new + text[end:]
        got: Any = yaml.safe_load(text)
    except (yaml.YAMLError, LookupError) as error:
        raise _refuse(document, index, str(error)) from error
    if _plain(got) != _plain(_wanted(before, index, values)):
        raise _refuse(document, index, "an alias or merge key stands for a part of it")
    return text


def _wanted(data: Any, index: int, values: dict[str, list[float]]) -> Any:
    wanted = copy.deepcopy(data)
    arm = dict(wanted["arms"][index])
    arm["base"] = dict(values)
    if arm.get("base_auto"):
        arm["base_auto"] = False
    wanted["arms"] = [*wanted["arms"][:index], arm, *wanted["arms"][index + 1 :]]
    return wanted


def _changes(root: yaml.Node, index: int, values: dict[str, list[float]]) -> list[Change]:
    arm = _get(root, "arms").value[index]
    changes = []
    searched = _find(arm, "base_auto")
    if searched is not None and searched.value.lower() in ("true", "yes", "on"):
        changes.append(_put(searched, "false"))
    base = _find(arm, "base")
    whole = ", ".join(f"{key}: {_listed(values[key])}" for key in PARTS)
    if base is None:
        return [*changes, _insert(arm, f"base: {{{whole}}}")]
    if not isinstance(base, yaml.MappingNode) or not base.value:
        return [*changes, _put(base, f"{{{whole}}}")]
    for key in PARTS:
        node = _find(base, key)
        if node is None:
            changes.append(_insert(base, f"{key}: {_listed(values[key])}"))
        elif isinstance(node, yaml.SequenceNode) and len(node.value) == 3:
            pairs = zip(node.value, values[key], strict=True)
            changes += [_put(item, f"{number:.10g}") for item, number in pairs]
        else:
            raise LookupError(f"{key} is not a list of three numbers")
    return changes


def _insert(mapping: yaml.MappingNode, entry: str) -> Change:
    """An entry before the first of a mapping, in its own layout."""
    mark = mapping.value[0][0].start_mark
    gap = ", " if mapping.flow_style else "\n" + " " * mark.column
    return mark.index, mark.index, entry + gap


def _put(node: yaml.Node, new: str) -> Change:
    if isinstance(node, yaml.CollectionNode) and not node.flow_style:
        raise LookupError("it is laid out in an unexpected way")
    lead = " " if node.start_mark.index == node.end_mark.index else ""  # a key without a value
    return node.start_mark.index, node.end_mark.index, lead + new


def _get(mapping: yaml.Node, key: str) -> Any:
    found = _find(mapping, key)
    if found is None:
        raise LookupError(f"{key} comes from elsewhere")
    return found


def _find(mapping: yaml.Node, key: str) -> Any:
    return next((value for name, value in mapping.value if name.value == key), None)


def _listed(values: list[float]) -> str:
    return "[" + ", ".join(f"{value:.10g}" for value in values) + "]"


def _plain(data: Any) -> Any:
    """Numbers as floats, tuples as lists, so that only values are compared."""
    if isinstance(data, dict):
        return {key: _plain(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_plain(value) for value in data]
    if isinstance(data, int | float) and not isinstance(data, bool):
        return float(data)
    return data


def _refuse(document: Document, index: int, why: str) -> TandemError:
    return TandemError(
        Issue(
            "align.cell",
            f"the base of arm {index + 1} cannot be rewritten in place: {why}",
            file=str(document.path),
            line=document.line(("arms", index, "base")),
            field=f"arms.{index}.base",
            hint="write it out, as base: {xyz_mm: [0, 0, 0], rpy_deg: [0, 0, 0]}",
        )
    )
