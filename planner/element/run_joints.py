"""Joints of an element measured on the cuts of its programs, from the simulated parts of proven panels.

The parts are placed next to one another in the element frame. This module has the joints of elastic panels;
`side_joints.py` has planar ones.

The proof of a panel writes each nominal face with its vertices where the wire passes
(``simulated_part.obj``). Neighbours have the same vertices on the rim at their joint, so the distance of
corresponding vertices is that of the joint: its component along the normal of the surface is the **step**,
the rest the **gap**. Compliance of the foam, and sides that another operation cuts, are not included.
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
from planner.geometry.rulings import boundary_rings
from planner.geometry.units import MM
from planner.issues import TandemError, issue_error
from planner.processes.hotwire.claims import CutsSurface, FollowsRulings

FACES: Final = ("front", "back")
"""Faces of a panel, as their meshes and cuts are named."""
_FACE_SIGNS: Final = {"front": 1.0, "back": -1.0}
"""Whether a face points up or down in its block."""
VERTEX_TOLERANCE_M: Final = 2e-5
"""Maximum distance [m] in the element plane of corresponding vertices of two rims."""
MAX_DEVIATION_M: Final = 0.02
"""Maximum distance [m] of a simulated face from the written one. Otherwise it belongs to another panel."""


@dataclasses.dataclass(frozen=True)
class PanelCutFace:
    """One face of a panel in the element frame [m].

    Attributes:
        nominal: Points (V, 3) as written.
        cut: Points (V, 3) where the wire passes.
        normals: Outward normals (V, 3).
        rim: Vertices (R,) on its border.
        slot: Width of the slot that lies on the side of the panel; 0 if it is outside.
    """

    nominal: FloatArray
    cut: FloatArray
    normals: FloatArray
    rim: IntArray
    slot: float = dataclasses.field(default=0.0, kw_only=True)

    @property
    def deviation(self) -> FloatArray:
        """Distance (V,) [m] of the cut from the written face, positive outwards."""
        return dots(self.cut - self.nominal, self.normals)


@dataclasses.dataclass(frozen=True)
class CutJoint:
    """Measured joint of two panels.

    Attributes:
        panels: Ids of the panels.
        points: Points (N, 3) [m] of the gaps.
        steps: Steps (M,) [m], at the same points of both faces, or at those on edges of faces.
        gaps: Gaps (N,) [m].
    """

    panels: tuple[str, str]
    points: FloatArray
    steps: FloatArray
    gaps: FloatArray


@dataclasses.dataclass(frozen=True)
class CutPart:
    """An object of a simulated part [m].

    Attributes:
        points: Points (V, 3).
        normals: Normals (V, 3) of the surrounding facets, away from the remaining foam; NaN without facets.
    """

    points: FloatArray
    normals: FloatArray

    def transform(self, pose: FloatArray) -> "CutPart":
        """Return the object in another frame, by its pose (4, 4) there."""
        return CutPart(transform(pose, self.points), self.normals @ pose[:3, :3].T)


def cut_faces(out: Path, run: Path, panel: Mapping[str, Any]) -> tuple[PanelCutFace, ...]:
    """Return the faces of a panel of ``out`` as the plan in ``run`` cuts them.

    The simulated part is oriented by the remaining foam, which tells its side of a face. Fronts point up in
    the block and backs down, however they were written.

    Raises:
        TandemError: ``element.run`` if the plan is of another panel; issues of mesh files.
    """
    name = str(panel["id"])
    pose = block_pose(panel)
    path = run / name / "simulated_part.obj"
    cut = read_part_objects(path)
    faces = []
    for side in FACES:
        written = read_mesh(out / "panels" / "meshes" / f"{name}_{side}.obj", MM)
        cut_part = cut.get(f"cut_{side}")
        if cut_part is None:
            continue
        max_distance = np.inf
        if cut_part.points.shape == written.vertices.shape:
            max_distance = float(np.abs(cut_part.points - written.vertices).max())
        if max_distance > MAX_DEVIATION_M:
            raise wrong_panel_error(path, name, f"the {side} face")
        out_of_it = vertex_normals(written)
        out_of_it *= np.where(out_of_it[:, 2:] * _FACE_SIGNS[side] < 0.0, -1.0, 1.0)
        left, slot = foam_left(cut_part, out_of_it, run / name, side)
        rim = np.unique(np.concatenate(boundary_rings(written)))
        normals = out_of_it @ pose[:3, :3].T
        faces.append(
            PanelCutFace(transform(pose, written.vertices), transform(pose, left), normals, rim, slot=slot)
        )
    return tuple(faces)


def foam_left(part: CutPart, outwards: FloatArray, result: Path, surface: str) -> tuple[FloatArray, float]:
    """Return where (V, 3) [m] the foam of a surface ends, and how much of the panel the slot takes [m].

    The slot is 0 if it is outside of the panel. It is on one side of the whole surface.

    Args:
        part: Object of the simulated part.
        outwards: Outward normals (V, 3).
        result: Result folder of the job.
        surface: Name of the surface.
    """
    normals = np.nan_to_num(part.normals)
    if float(dots(normals, outwards).mean()) >= 0.0:
        return part.points, 0.0
    slot = slot_width(result, surface)
    return part.points + slot * normals, slot


def slot_width(result: Path, surface: str) -> float:
    """Return the largest slot width [m] of the cut of a surface in a result folder."""
    widths: list[FloatArray] = [
        claim.kerf.width
        for operation in plans.load(result).operations
        for claim in operation.targets.claims
        if isinstance(claim, CutsSurface | FollowsRulings) and claim.segment.word == f"cut_{surface}"
    ]
    return max((float(width.max()) for width in widths), default=0.0)


def job_of(panel: Mapping[str, Any]) -> str:
    """Return the job that cuts a panel: its own, or one that cuts several."""
    return str(panel.get("cut_in", {}).get("job", panel["id"]))


def panel_objects(run: Path, panel: Mapping[str, Any]) -> tuple[Path, dict[str, CutPart]]:
    """Return the simulated part that contains a panel, and its objects in the frame of the panel's block."""
    path = run / job_of(panel) / "simulated_part.obj"
    objects = read_part_objects(path)
    if "cut_in" not in panel:
        return path, objects
    to_block = inverse(block_pose({"block_pose": panel["cut_in"]["pose"]}))
    return path, {name: part.transform(to_block) for name, part in objects.items()}


def wrong_panel_error(path: Path, name: str, what: str) -> TandemError:
    """Create the error of a simulated part that does not belong to the panel, as ``what`` shows."""
    message = f"{what} in {path} does not belong to panel {name}"
    hint = "plan the panels of this folder again: tandem batch OUT/panels -o RUN"
    return issue_error("element.run", message, file=str(path), hint=hint)


def read_part_objects(path: Path) -> dict[str, CutPart]:
    """Read the objects of a simulated part, by name."""
    points: dict[str, list[list[float]]] = {}
    facets: dict[str, list[list[int]]] = {}
    name, first_index, count = "", 0, 0
    for line in path.read_text("utf-8").splitlines():
        words = line.split()
        if words[:1] == ["o"]:
            name, first_index = words[1], count
            points.setdefault(name, [])
            facets.setdefault(name, [])
        elif words[:1] == ["v"]:
            points[name].append([float(word) * MM for word in words[1:4]])
            count += 1
        elif words[:1] == ["f"]:
            first = len(points[name]) - (count - first_index) - first_index - 1
            facets[name].append([int(word.split("/")[0]) + first for word in words[1:4]])
    return {name: _part(np.array(rows).reshape(-1, 3), facets[name]) for name, rows in points.items()}


def _part(points: FloatArray, wound: Sequence[Sequence[int]]) -> CutPart:
    normals = np.full(points.shape, np.nan)
    if len(wound):
        mesh = TriangleMesh(points, np.array(wound, dtype=np.int64))
        normals[np.unique(mesh.faces)] = vertex_normals(mesh)[np.unique(mesh.faces)]
    return CutPart(points, normals)


def cut_joint(
    names: tuple[str, str], first_faces: tuple[PanelCutFace, ...], second_faces: tuple[PanelCutFace, ...]
) -> CutJoint | None:
    """Return the joint of two panels; None if their rims have nothing in common."""
    points, steps, gaps = [], [], []
    for a, b in zip(first_faces, second_faces, strict=False):
        tree = cKDTree(b.nominal[b.rim, :2])  # both rims are displaced along z
        distance, at = tree.query(a.nominal[a.rim, :2], distance_upper_bound=VERTEX_TOLERANCE_M)
        is_common = np.isfinite(distance)
        first, second = a.rim[is_common], b.rim[np.asarray(at)[is_common]]
        difference = a.cut[first] - b.cut[second]
        normal = a.normals[first]
        step = dots(difference, normal)
        points.append(a.nominal[first])
        steps.append(np.abs(step))
        gaps.append(np.linalg.norm(difference - step[:, None] * normal, axis=1))
    if not sum(map(len, steps)):
        return None
    return CutJoint(names, np.concatenate(points), np.concatenate(steps), np.concatenate(gaps))
