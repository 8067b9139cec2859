"""Panels as ordinary problem files: ids by rows, a template for each, meshes of its two faces."""

import copy
import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, Protocol

import numpy as np

from planner.element.elastic_panel import ElasticPanel
from planner.element.element_file import ElasticElement, Element, Template
from planner.geometry.arrays import FloatArray, IntArray, lengths
from planner.geometry.mesh import TriangleMesh
from planner.geometry.units import MM
from planner.issues import Issue, TandemError
from planner.reading import strict_yaml

SIZE_STEP_MM: Final = 0.1
"""Sizes of blocks are rounded up to this."""
DIGITS: Final = 9
"""Decimals of lengths in mm: neighbours agree to a millionth of a millimetre through both of their poses."""
POSE_DIGITS: Final = 13
"""Decimals of the axes of poses, for the same reason."""


def ids(panels: tuple[ElasticPanel, ...]) -> tuple[str, ...]:
    """A01, A02 ... B01 ...: a letter for each row of panels that begin on the same line, from the lowest, and
    numbers along it. They follow from cells alone, so they stay while the surface moves a little."""
    rows = sorted({panel.rectangle[2] for panel in panels})
    return row_names([rows.index(panel.rectangle[2]) for panel in panels])  # by rows already


def row_names(rows: Sequence[int]) -> tuple[str, ...]:
    """Ids of panels by the rows that they are in, counted from 0: a letter, or two, for each row and numbers
    in the panels' order."""
    digits = max(2, len(str(max(np.bincount(rows)))))
    count: dict[int, int] = {}
    names = []
    for row in rows:
        count[row] = count.get(row, 0) + 1
        letters = (chr(64 + row // 26) if row >= 26 else "") + chr(65 + row % 26)
        names.append(f"{letters}{count[row]:0{digits}d}")
    return tuple(names)


class Panel(Protocol):
    """What a panel of any kind has: the kind of ``block`` that it is cut from, and ``size`` (3,) [m] of its
    own."""

    @property
    def block(self) -> int:
        """The number of a kind of block in the element file."""

    @property
    def size(self) -> FloatArray:
        """Length, width and height of the piece of it that the job begins with [m]."""


def block_mm(panel: Panel) -> tuple[float, float, float]:
    """The size of a panel's block [mm], rounded up."""
    x, y, z = np.ceil(np.round(panel.size / MM / SIZE_STEP_MM, 6)) * SIZE_STEP_MM
    return round(float(x), 3), round(float(y), 3), round(float(z), 3)


def chosen_templates(element: Element, panels: Sequence[Panel], names: Sequence[str]) -> tuple[Template, ...]:
    """The template of each panel. Raises ``TandemError``: ``element.jobs`` where none or several are
    meant."""
    chosen, issues = [], []
    for panel, name in zip(panels, names, strict=True):
        size = block_mm(panel)
        found = [t for t in element.templates if t.when.holds(size)]
        chosen += found[:1]
        if len(found) != 1:
            text = " x ".join(f"{v:g}" for v in size)
            which = " and ".join(t.file for t in found) or "no job"
            what = f"panel {name} with its block of {text} mm is meant by {which}, exactly one must be"
            hint = "let the ranges of when (from, below) follow one another without gaps"
            issues.append(Issue("element.jobs", what, field="jobs", hint=hint))
    if issues:
        first = dataclasses.replace(issues[0], count=len(issues))
        raise TandemError(first)
    return tuple(chosen)


def cut_figures(
    template: Template, way: Callable[[Mapping[str, Any]], float], stops: int = 0
) -> dict[str, Any]:
    """What a job takes, estimated: ``cut_min``, minutes that each arm cuts, by its name: the ``way`` [mm] of
    each operation of a template at its feed; ``cut_m``, all ways together [m]; ``stops`` of the operator: one
    to bring the foam, and one before each later operation with a setup or a bent wire, which is put in then,
    unless they are stated. Ways in and out, loading and mounting come on top."""
    minutes: dict[str, float] = {}
    metres = 0.0
    operations = [one for one in template.data["operations"] if isinstance(one, dict)]
    for operation in operations:
        feed, arms, far = operation.get("feed_mm_s"), operation.get("arms"), way(operation)
        metres += 1e-3 * far
        if isinstance(feed, int | float) and feed > 0 and isinstance(arms, list):
            for arm in arms:
                minutes[str(arm)] = minutes.get(str(arm), 0.0) + far / feed / 60.0
    return {
        "cut_min": {arm: round(one, 3) for arm, one in minutes.items()},
        "cut_m": round(metres, 4),
        "stops": stops or 1 + sum(map(_stops, operations[1:])),
    }


def _stops(operation: Mapping[str, Any]) -> bool:
    """Whether an operation that is not the first waits for the operator."""
    return "setup" in operation or operation.get("process") == "elastic_wire"


def ruled_way(made: Mapping[str, Any], operation: Mapping[str, Any]) -> float:
    """How far [mm] the wire goes in an operation along ruled surfaces of the problem that is ``made``,
    half-way between their lines."""
    shapes = {one["name"]: one for one in made["part"].get("ruled", ())}
    named = [shapes[cut["surface"]] for cut in operation.get("cuts", ()) if cut.get("surface") in shapes]
    return sum(
        float(lengths(np.diff(np.array(one[side]["polyline_mm"]), axis=0)).sum()) / 2.0
        for one in named
        for side in ("start", "end")
    )


def problem(
    element: Element, panel: Panel, name: str, template: Template, shape: dict[str, Any]
) -> dict[str, Any]:
    """A panel's problem as a file has it: the template with the panel's block, and its ``shape`` as a part
    has it in the block's frame."""
    spec = element.file
    stock: dict[str, Any] = {"size_mm": list(block_mm(panel))}
    return filled(template, f"{spec.name}_{name}", stock, spec.blocks[panel.block].foam, shape)


def filled(
    template: Template, name: str, stock: dict[str, Any], foam: str | None, shape: dict[str, Any]
) -> dict[str, Any]:
    """A template as a whole problem: its stock goes on as ``stock`` begins, with the ``foam`` unless it names
    one, and ``shape`` is its part in the block's frame."""
    data = copy.deepcopy(template.data)
    stock = {**stock, **(data.pop("stock", None) or {})}
    if foam is not None:
        stock.setdefault("foam", foam)
    operations = data.pop("operations")
    head = {"tandem": 1, "name": name, "cell": data.pop("cell")}
    rest = {key: value for key, value in data.items() if key not in ("tandem", "name")}
    part = {**shape, "in_stock": {"xyz_mm": [0.0, 0.0, 0.0]}}
    return {**head, **rest, "stock": stock, "part": part, "operations": operations}


def problem_text(element: Element, name: str, data: dict[str, Any]) -> str:
    """A panel's problem as text."""
    return f"# Panel {name} of {element.file.name}, written by tandem element.\n" + strict_yaml.dump(data)


def ruled(name: str, start: FloatArray, end: FloatArray, **more: bool) -> dict[str, Any]:
    """A ruled surface between points (N, 3) [m], one to one, as the part of a problem file has it."""

    def guide(points: FloatArray) -> dict[str, Any]:
        return {"polyline_mm": [[round(v, DIGITS) + 0.0 for v in row] for row in (points / MM).tolist()]}

    return {"name": name, **more, "match": "parameter", "start": guide(start), "end": guide(end)}


def pose_mm(pose: FloatArray) -> list[list[float]]:
    """A pose (4, 4) [m] as data, in mm."""
    out = pose.copy()
    out[:3, 3] /= MM
    out[:3, :3] = np.round(out[:3, :3], POSE_DIGITS)
    out[:3, 3] = np.round(out[:3, 3], DIGITS)
    return [[v + 0.0 for v in line] for line in out.tolist()]


def block_pose(panel: Mapping[str, Any]) -> FloatArray:
    """The pose (4, 4) [m] of the block of a panel of ``element.json``."""
    pose = np.array(panel["block_pose"], dtype=np.float64)
    pose[:3, 3] *= MM
    return pose


def panel_files(
    element: ElasticElement, panels: tuple[ElasticPanel, ...], names: tuple[str, ...]
) -> dict[str, str]:
    """Problem files and meshes by their places in the folder; wire and sweep where a template leaves them
    out. Raises ``TandemError`` as `chosen_templates`."""
    files = {}
    for panel, name, template in zip(panels, names, chosen_templates(element, panels, names), strict=True):
        faces = {
            side: {"mesh": {"file": f"meshes/{name}_{side}.obj", "unit": "mm"}} for side in ("front", "back")
        }
        data = problem(element, panel, name, template, faces)
        wire = element.wires[panel.wire].model_dump(exclude_none=True)
        for operation in data["operations"]:
            if isinstance(operation, dict) and operation.get("process") == "elastic_wire":
                operation.setdefault("wire", wire)
                operation.setdefault("sweep", "y")
        files[f"panels/{name}.yaml"] = problem_text(element, name, data)
        files[f"panels/meshes/{name}_front.obj"] = _obj(panel.front, f"front of {name}")
        files[f"panels/meshes/{name}_back.obj"] = _obj(panel.back, f"back of {name}")
    return files


def _obj(mesh: TriangleMesh, what: str) -> str:
    """A mesh in the frame of its block, in millimetres."""
    lines = [f"# {what}, in the frame of its block, mm", *obj_lines(mesh.vertices / MM, mesh.faces)]
    return "\n".join(lines) + "\n"


def obj_lines(points: FloatArray, faces: IntArray, first: int = 1) -> list[str]:
    """Points (V, 3) [mm] and triangles (F, 3) as lines of an OBJ file, in which the first point is number
    ``first``."""
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in points.tolist()]
    return lines + [f"f {a} {b} {c}" for a, b, c in (faces + first).tolist()]
