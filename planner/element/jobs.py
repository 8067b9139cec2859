"""Panels as ordinary problem files: ids by rows, a template for each, meshes of the two faces."""

import copy
import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, Protocol

import numpy as np

from planner.element.elastic_panel import ElasticPanel
from planner.element.element_file import ElasticElement, Element, JobTemplate
from planner.geometry.arrays import FloatArray, IntArray, lengths
from planner.geometry.mesh import TriangleMesh
from planner.geometry.units import MM
from planner.issues import Issue, TandemError
from planner.reading import strict_yaml

SIZE_STEP_MM: Final = 0.1
"""Step to which sizes of blocks are rounded up [mm]."""
DIGITS: Final = 9
"""Decimals of lengths in mm, so that neighbours in their own frames agree to a millionth of a millimetre."""
POSE_DIGITS: Final = 13
"""Decimals of the axes of poses, so that neighbours agree to a millionth of a millimetre."""


def elastic_ids(panels: tuple[ElasticPanel, ...]) -> tuple[str, ...]:
    """Return the ids of elastic panels: A01, A02 ... in the lowest row of the grid, B01 ... in the next one.

    Panels of a row start on the same grid line. The ids follow from cells alone, so they do not change if the
    surface moves a little.
    """
    rows = sorted({panel.rectangle[2] for panel in panels})
    return row_names([rows.index(panel.rectangle[2]) for panel in panels])  # sorted by rows


def row_names(rows: Sequence[int]) -> tuple[str, ...]:
    """Return the id of each panel: letters for its row, and its number in that row.

    ``rows`` are the rows of the panels, counted from 0. A row has one letter, or two from row 26 on.
    """
    digits = max(2, len(str(max(np.bincount(rows)))))
    count: dict[int, int] = {}
    names = []
    for row in rows:
        count[row] = count.get(row, 0) + 1
        letters = (chr(64 + row // 26) if row >= 26 else "") + chr(65 + row % 26)
        names.append(f"{letters}{count[row]:0{digits}d}")
    return tuple(names)


class BlockPanel(Protocol):
    """Properties of a panel of any kind."""

    @property
    def block(self) -> int:
        """Index of the kind of block in the element file."""

    @property
    def size(self) -> FloatArray:
        """Length, width and height [m] of the piece of the block that the job starts with."""


def block_mm(panel: BlockPanel) -> tuple[float, float, float]:
    """Return the size [mm] of the block of a panel, rounded up to `SIZE_STEP_MM`."""
    x, y, z = np.ceil(np.round(panel.size / MM / SIZE_STEP_MM, 6)) * SIZE_STEP_MM
    return round(float(x), 3), round(float(y), 3), round(float(z), 3)


def choose_templates(
    element: Element, panels: Sequence[BlockPanel], names: Sequence[str]
) -> tuple[JobTemplate, ...]:
    """Return the template of each panel.

    Raises:
        TandemError: ``element.jobs`` if none or several match.
    """
    chosen, issues = [], []
    for panel, name in zip(panels, names, strict=True):
        size = block_mm(panel)
        matching = [template for template in element.templates if template.when.matches(size)]
        chosen += matching[:1]
        if len(matching) != 1:
            text = " x ".join(f"{v:g}" for v in size)
            by = " and ".join(template.file for template in matching) or "no job"
            message = f"panel {name} with its block of {text} mm is matched by {by}, exactly one must match"
            hint = "make the ranges of when (from, below) contiguous"
            issues.append(Issue("element.jobs", message, field="jobs", hint=hint))
    if issues:
        first = dataclasses.replace(issues[0], count=len(issues))
        raise TandemError(first)
    return tuple(chosen)


def cut_figures(
    template: JobTemplate, length_of: Callable[[Mapping[str, Any]], float], stops: int = 0
) -> dict[str, Any]:
    """Estimate cutting times, cut length and operator stops of a job.

    Times of approaches, retreats, loading and mounting are not included.

    Args:
        template: Template of the job.
        length_of: Returns the cut length [mm] of an operation.
        stops: Number of operator stops; 0 to count them: one to load the foam, and one before each later
            operation that has a setup of its own, or before which a bent wire is mounted.

    Returns:
        ``cut_min``: cutting time of each arm [min] at the feed; ``cut_m``: total cut length [m], to which
        each operation contributes once, even if several arms cut together; ``stops``: number of stops.
    """
    minutes: dict[str, float] = {}
    metres = 0.0
    operations = [item for item in template.data["operations"] if isinstance(item, dict)]
    for operation in operations:
        feed, arms, length = operation.get("feed_mm_s"), operation.get("arms"), length_of(operation)
        metres += 1e-3 * length
        if isinstance(feed, int | float) and feed > 0 and isinstance(arms, list):
            for arm in arms:
                minutes[str(arm)] = minutes.get(str(arm), 0.0) + length / feed / 60.0
    return {
        "cut_min": {arm: round(arm_minutes, 3) for arm, arm_minutes in minutes.items()},
        "cut_m": round(metres, 4),
        "stops": stops or 1 + sum(map(_is_stop, operations[1:])),
    }


def _is_stop(operation: Mapping[str, Any]) -> bool:
    """Whether an operation that is not the first waits for the operator."""
    return "setup" in operation or operation.get("process") == "elastic_wire"


def ruled_cut_length(problem_data: Mapping[str, Any], operation: Mapping[str, Any]) -> float:
    """Return the length [mm] of the cuts of an operation along ruled surfaces of its problem.

    The length of a cut is the mean length of both guides of its surface.
    """
    shapes = {surface["name"]: surface for surface in problem_data["part"].get("ruled", ())}
    surfaces = [shapes[cut["surface"]] for cut in operation.get("cuts", ()) if cut.get("surface") in shapes]
    return sum(
        float(lengths(np.diff(np.array(surface[side]["polyline_mm"]), axis=0)).sum()) / 2.0
        for surface in surfaces
        for side in ("start", "end")
    )


def panel_problem(
    element: Element, panel: BlockPanel, name: str, template: JobTemplate, shape: dict[str, Any]
) -> dict[str, Any]:
    """Return the data of a panel's problem file: the template with its block, and ``shape`` as the part."""
    spec = element.file
    stock: dict[str, Any] = {"size_mm": list(block_mm(panel))}
    return fill_template(template, f"{spec.name}_{name}", stock, spec.blocks[panel.block].foam, shape)


def fill_template(
    template: JobTemplate, name: str, stock: dict[str, Any], foam: str | None, shape: dict[str, Any]
) -> dict[str, Any]:
    """Complete a template to a whole problem.

    Args:
        template: Template.
        name: Name of the problem.
        stock: Keys of its stock that the template does not state, as its size.
        foam: Foam, unless the template states one.
        shape: Part in the block frame, as data.
    """
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
    """Return the problem file of a panel as text."""
    return f"# Panel {name} of {element.file.name}, written by tandem element.\n" + strict_yaml.dump(data)


def ruled_surface(name: str, start: FloatArray, end: FloatArray, **flags: bool) -> dict[str, Any]:
    """Return a ruled surface of a problem's part: rulings join paired points (N, 3) [m] of two guides."""

    def guide(points: FloatArray) -> dict[str, Any]:
        return {"polyline_mm": [[round(v, DIGITS) + 0.0 for v in row] for row in (points / MM).tolist()]}

    return {"name": name, **flags, "match": "parameter", "start": guide(start), "end": guide(end)}


def pose_to_mm(pose: FloatArray) -> list[list[float]]:
    """Return a pose (4, 4) [m] as rows of numbers, with the position in mm."""
    out = pose.copy()
    out[:3, 3] /= MM
    out[:3, :3] = np.round(out[:3, :3], POSE_DIGITS)
    out[:3, 3] = np.round(out[:3, 3], DIGITS)
    return [[v + 0.0 for v in row] for row in out.tolist()]


def block_pose(panel: Mapping[str, Any]) -> FloatArray:
    """Return the pose (4, 4) [m] of the block of a panel in ``element.json``."""
    pose = np.array(panel["block_pose"], dtype=np.float64)
    pose[:3, 3] *= MM
    return pose


def panel_files(
    element: ElasticElement, panels: tuple[ElasticPanel, ...], names: tuple[str, ...]
) -> dict[str, str]:
    """Return the problem files and meshes of elastic panels, as texts by their paths in the folder.

    Wire and sweep are added if a template omits them.

    Raises:
        TandemError: As `choose_templates`.
    """
    files = {}
    for panel, name, template in zip(panels, names, choose_templates(element, panels, names), strict=True):
        faces = {
            side: {"mesh": {"file": f"meshes/{name}_{side}.obj", "unit": "mm"}} for side in ("front", "back")
        }
        data = panel_problem(element, panel, name, template, faces)
        wire = element.wires[panel.wire].model_dump(exclude_none=True)
        for operation in data["operations"]:
            if isinstance(operation, dict) and operation.get("process") == "elastic_wire":
                operation.setdefault("wire", wire)
                operation.setdefault("sweep", "y")
        files[f"panels/{name}.yaml"] = problem_text(element, name, data)
        files[f"panels/meshes/{name}_front.obj"] = _obj_text(panel.front, f"front of {name}")
        files[f"panels/meshes/{name}_back.obj"] = _obj_text(panel.back, f"back of {name}")
    return files


def _obj_text(mesh: TriangleMesh, title: str) -> str:
    """Return a mesh [m] in the block frame as an OBJ file [mm]."""
    lines = [f"# {title}, in the frame of its block, mm", *obj_lines(mesh.vertices / MM, mesh.faces)]
    return "\n".join(lines) + "\n"


def obj_lines(points: FloatArray, faces: IntArray, first: int = 1) -> list[str]:
    """Return points (V, 3) [mm] and triangles (F, 3) as lines of an OBJ file.

    ``first`` is the number that the first point has in the file.
    """
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in points.tolist()]
    return lines + [f"f {a} {b} {c}" for a, b, c in (faces + first).tolist()]
