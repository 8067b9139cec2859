"""Joints of an element measured from what its programs cut: the simulated parts of proven panels, laid beside
one another in the element frame. Here are those of elastic panels; `side_joints.py` has planar ones.

The proof of a panel writes each wanted face with its vertices where the wire passes
(``simulated_part.obj``). Neighbours have the same vertices on the rim at their joint, so the distance of the
two that belong together is the joint's: its part along the surface's normal is the **step**, the rest the
**gap**. Foam that gives way, and sides that another operation cuts, are not in it.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.spatial import cKDTree

from planner import plans
from planner.element.jobs import block_pose
from planner.geometry.arrays import FloatArray, IntArray, dots, inverse, transform
from planner.geometry.mesh import TriangleMesh, vertex_normals
from planner.geometry.mesh_files import read_mesh
from planner.geometry.rulings import boundaries
from planner.geometry.units import MM
from planner.issues import TandemError, refusal
from planner.processes.hotwire.claims import CutsSurface, FollowsRulings

FACES: Final = ("front", "back")
"""The faces of a panel, as their meshes and cuts are named."""
_LOOKS: Final = {"front": 1.0, "back": -1.0}
"""Whether a face looks up or down in its block."""
SAME_PLACE: Final = 2e-5
"""Vertices of two rims that are nearer than this [m] in the element's plane as written are one."""
LARGEST_DEVIATION: Final = 0.02
"""A simulated face that is farther from the written one [m] is not that panel's."""


@dataclasses.dataclass(frozen=True)
class CutFace:
    """One face of a panel in the element frame [m]: ``place`` (V, 3) as written, ``cut`` (V, 3) where the
    wire passes, ``normals`` (V, 3) outwards; ``rim`` (R,): vertices on its border. ``slot`` [m]: what the
    slot takes of the panel where it lies on the panel's side, 0 where it is outside."""

    place: FloatArray
    cut: FloatArray
    normals: FloatArray
    rim: IntArray
    slot: float = dataclasses.field(default=0.0, kw_only=True)

    @property
    def deviation(self) -> FloatArray:
        """How far (V,) [m] the cut is off the written face, outwards above 0."""
        return dots(self.cut - self.place, self.normals)


@dataclasses.dataclass(frozen=True)
class CutJoint:
    """Where two panels meet, by id: ``points`` (N, 3) [m] with ``gaps`` (N,) [m] there, and ``steps`` (M,)
    [m]: at the same points of both faces, or at those of them that lie on edges of faces."""

    panels: tuple[str, str]
    points: FloatArray
    steps: FloatArray
    gaps: FloatArray


@dataclasses.dataclass(frozen=True)
class CutPart:
    """An object of a simulated part [m]: ``points`` (V, 3), and the normals (V, 3) of what is wound about
    them, away from the foam that is left; NaN where nothing is."""

    points: FloatArray
    normals: FloatArray

    def moved(self, pose: FloatArray) -> "CutPart":
        """The object in another frame, by its pose (4, 4) there."""
        return CutPart(transform(pose, self.points), self.normals @ pose[:3, :3].T)


def cut_faces(out: Path, run: Path, panel: Mapping[str, Any]) -> tuple[CutFace, ...]:
    """The faces of a panel of ``out`` as the plan in ``run`` cuts them.

    On which side of a face foam is left says the simulated part, which is wound about it; fronts look up in
    the block and backs down, however they were written.

    Raises ``TandemError``: ``element.run`` where the plan is of another panel, issues of mesh files.
    """
    name = str(panel["id"])
    pose = block_pose(panel)
    path = run / name / "simulated_part.obj"
    cut = part_objects(path)
    faces = []
    for side in FACES:
        written = read_mesh(out / "panels" / "meshes" / f"{name}_{side}.obj", MM)
        moved = cut.get(f"cut_{side}")
        if moved is None:
            continue
        far = np.inf
        if moved.points.shape == written.vertices.shape:
            far = float(np.abs(moved.points - written.vertices).max())
        if far > LARGEST_DEVIATION:
            raise other_panel(path, name, f"the {side} face")
        out_of_it = vertex_normals(written)
        out_of_it *= np.where(out_of_it[:, 2:] * _LOOKS[side] < 0.0, -1.0, 1.0)
        left, slot = foam_left(moved, out_of_it, run / name, side)
        rim = np.unique(np.concatenate(boundaries(written)))
        normals = out_of_it @ pose[:3, :3].T
        faces.append(
            CutFace(transform(pose, written.vertices), transform(pose, left), normals, rim, slot=slot)
        )
    return tuple(faces)


def foam_left(part: CutPart, outwards: FloatArray, result: Path, surface: str) -> tuple[FloatArray, float]:
    """Where (V, 3) [m] the foam of a ``surface`` ends whose normals should be ``outwards`` (V, 3), and what
    the slot takes of the panel [m], 0 where it is outside of it. One slot is on one side of all of it."""
    normals = np.nan_to_num(part.normals)
    if float(dots(normals, outwards).mean()) >= 0.0:
        return part.points, 0.0
    slot = slot_width(result, surface)
    return part.points + slot * normals, slot


def slot_width(result: Path, surface: str) -> float:
    """The widest slot [m] of the cut of a ``surface`` in a result folder."""
    widths: list[FloatArray] = [
        claim.kerf.width
        for operation in plans.load(result).operations
        for claim in operation.targets.claims
        if isinstance(claim, CutsSurface | FollowsRulings) and claim.segment.word == f"cut_{surface}"
    ]
    return max((float(width.max()) for width in widths), default=0.0)


def job_of(panel: Mapping[str, Any]) -> str:
    """The job that cuts a panel: its own, or one that cuts several."""
    return str(panel.get("cut_in", {}).get("job", panel["id"]))


def panel_objects(run: Path, panel: Mapping[str, Any]) -> tuple[Path, dict[str, CutPart]]:
    """The simulated part that a panel is in, and its objects in the frame of the panel's block."""
    path = run / job_of(panel) / "simulated_part.obj"
    found = part_objects(path)
    if "cut_in" not in panel:
        return path, found
    to_block = inverse(block_pose({"block_pose": panel["cut_in"]["pose"]}))
    return path, {name: one.moved(to_block) for name, one in found.items()}


def other_panel(path: Path, name: str, what: str) -> TandemError:
    """The simulated part at ``path`` is not that of the panel ``name``, as ``what`` of it shows."""
    said = f"{what} in {path} is not that of panel {name}"
    hint = "plan the panels of this folder again: tandem batch OUT/panels -o RUN"
    return refusal("element.run", said, file=str(path), hint=hint)


def part_objects(path: Path) -> dict[str, CutPart]:
    """The objects of a simulated part, by their names."""
    found: dict[str, list[list[float]]] = {}
    wound: dict[str, list[list[int]]] = {}
    name, before, count = "", 0, 0
    for line in path.read_text("utf-8").splitlines():
        words = line.split()
        if words[:1] == ["o"]:
            name, before = words[1], count
            found.setdefault(name, [])
            wound.setdefault(name, [])
        elif words[:1] == ["v"]:
            found[name].append([float(word) * MM for word in words[1:4]])
            count += 1
        elif words[:1] == ["f"]:
            first = len(found[name]) - (count - before) - before - 1
            wound[name].append([int(word.split("/")[0]) + first for word in words[1:4]])
    return {name: _part(np.array(rows).reshape(-1, 3), wound[name]) for name, rows in found.items()}


def _part(points: FloatArray, wound: Sequence[Sequence[int]]) -> CutPart:
    normals = np.full(points.shape, np.nan)
    if len(wound):
        mesh = TriangleMesh(points, np.array(wound, dtype=np.int64))
        normals[np.unique(mesh.faces)] = vertex_normals(mesh)[np.unique(mesh.faces)]
    return CutPart(points, normals)


def cut_joint(
    names: tuple[str, str], one: tuple[CutFace, ...], other: tuple[CutFace, ...]
) -> CutJoint | None:
    """The joint of two panels; None where their rims have nothing in common."""
    points, steps, gaps = [], [], []
    for a, b in zip(one, other, strict=False):
        tree = cKDTree(b.place[b.rim, :2])  # both rims are moved along z
        distance, at = tree.query(a.place[a.rim, :2], distance_upper_bound=SAME_PLACE)
        own = np.isfinite(distance)
        first, second = a.rim[own], b.rim[np.asarray(at)[own]]
        apart = a.cut[first] - b.cut[second]
        normal = a.normals[first]
        step = dots(apart, normal)
        points.append(a.place[first])
        steps.append(np.abs(step))
        gaps.append(np.linalg.norm(apart - step[:, None] * normal, axis=1))
    if not sum(map(len, steps)):
        return None
    return CutJoint(names, np.concatenate(points), np.concatenate(steps), np.concatenate(gaps))
