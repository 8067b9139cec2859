"""Joints of an element, measured on the simulated parts that the proofs of its panels write.

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
"""Names of the faces of a panel, as in its meshes and cuts."""
_FACE_SIGNS: Final = {"front": 1.0, "back": -1.0}
"""Sign of the z component of a face's outward normal in its block."""
VERTEX_TOLERANCE_M: Final = 2e-5
"""Maximum distance [m] in the element plane of corresponding vertices of two rims."""
MAX_DEVIATION_M: Final = 0.02
"""Maximum distance [m] of a simulated face from the written one. A larger one belongs to another panel."""


@dataclasses.dataclass(frozen=True)
class PanelCutFace:
    """One face of a panel in the element frame [m].

    Attributes:
        nominal: Points (V, 3) of the face as written in the panel's files.
        cut: Corresponding points (V, 3) where the foam ends after the cut.
        normals: Outward normals (V, 3).
        rim: Indices (R,) of the points on its border.
        slot: Width of the slot if it is inside the panel; 0 if it is outside.
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
        points: Points (N, 3) [m] at which gaps are measured.
        steps: Steps (M,) [m]: distances of the faces along the normal of the surface, at common points.
        gaps: Gaps (N,) [m]: remaining distances of the faces or sides.
    """

    panels: tuple[str, str]
    points: FloatArray
    steps: FloatArray
    gaps: FloatArray


@dataclasses.dataclass(frozen=True)
class CutPart:
    """An object of a simulated part; lengths in m.

    Attributes:
        points: Points (V, 3).
        normals: Normals (V, 3), which point away from the remaining foam; NaN for points without facets.
    """

    points: FloatArray
    normals: FloatArray

    def transform(self, pose: FloatArray) -> "CutPart":
        """Return the object in another frame, in which its current frame has the ``pose`` (4, 4)."""
        return CutPart(transform(pose, self.points), self.normals @ pose[:3, :3].T)


def cut_faces(out: Path, run: Path, panel: Mapping[str, Any]) -> tuple[PanelCutFace, ...]:
    """Return the front and back of a panel as its plan cuts them.

    The facets of the simulated part point away from the remaining foam, which shows on which side of a face
    the slot is. Outward normals point up for fronts and down for backs, however the meshes were written.

    Args:
        out: Folder of the element.
        run: Folder of the batch.
        panel: Panel of ``element.json``.

    Raises:
        TandemError: ``element.run`` if the plan is of another panel; issues of mesh files.
    """
    name = str(panel["id"])
    pose = block_pose(panel)
    path = run / name / "simulated_part.obj"
    objects = read_part_objects(path)
    faces = []
    for side in FACES:
        written = read_mesh(out / "panels" / "meshes" / f"{name}_{side}.obj", MM)
        cut_part = objects.get(f"cut_{side}")
        if cut_part is None:
            continue
        max_distance = np.inf
        if cut_part.points.shape == written.vertices.shape:
            max_distance = float(np.abs(cut_part.points - written.vertices).max())
        if max_distance > MAX_DEVIATION_M:
            raise wrong_panel_error(path, name, f"the {side} face")
        outwards = vertex_normals(written)
        outwards *= np.where(outwards[:, 2:] * _FACE_SIGNS[side] < 0.0, -1.0, 1.0)
        foam_points, slot = foam_left(cut_part, outwards, run / name, side)
        rim = np.unique(np.concatenate(boundary_rings(written)))
        normals = outwards @ pose[:3, :3].T
        faces.append(
            PanelCutFace(
                transform(pose, written.vertices), transform(pose, foam_points), normals, rim, slot=slot
            )
        )
    return tuple(faces)


def foam_left(part: CutPart, outwards: FloatArray, result: Path, surface: str) -> tuple[FloatArray, float]:
    """Return the points (V, 3) [m] at which the foam of a panel ends, and the width [m] of a slot inside it.

    The slot is on one side of the whole surface. The width is 0 if it is outside of the panel.

    Args:
        part: Object of the simulated part: the surface as cut.
        outwards: Outward normals (V, 3) of the panel.
        result: Result folder of the job.
        surface: Name of the surface.
    """
    normals = np.nan_to_num(part.normals)
    if float(dots(normals, outwards).mean()) >= 0.0:
        return part.points, 0.0
    slot = slot_width(result, surface)
    return part.points + slot * normals, slot


def slot_width(result: Path, surface: str) -> float:
    """Return the largest slot width [m] that the plan in a result folder states for a surface; 0 if none."""
    widths: list[FloatArray] = [
        claim.kerf.width
        for operation in plans.load(result).operations
        for claim in operation.targets.claims
        if isinstance(claim, CutsSurface | FollowsRulings) and claim.segment.word == f"cut_{surface}"
    ]
    return max((float(width.max()) for width in widths), default=0.0)


def job_of(panel: Mapping[str, Any]) -> str:
    """Return the id of the job that cuts a panel: its own, or one that cuts several panels together."""
    return str(panel.get("cut_in", {}).get("job", panel["id"]))


def panel_objects(run: Path, panel: Mapping[str, Any]) -> tuple[Path, dict[str, CutPart]]:
    """Return the path of a panel's simulated part, and its objects in the frame of the panel's block."""
    path = run / job_of(panel) / "simulated_part.obj"
    objects = read_part_objects(path)
    if "cut_in" not in panel:
        return path, objects
    to_block = inverse(block_pose({"block_pose": panel["cut_in"]["pose"]}))
    return path, {name: part.transform(to_block) for name, part in objects.items()}


def wrong_panel_error(path: Path, name: str, what: str) -> TandemError:
    """Create the error that ``what``, such as a face in a simulated part, does not belong to a panel."""
    message = f"{what} in {path} does not belong to panel {name}"
    hint = "plan the panels of this folder again: tandem batch OUT/panels -o RUN"
    return issue_error("element.run", message, file=str(path), hint=hint)


def read_part_objects(path: Path) -> dict[str, CutPart]:
    """Read the objects of a simulated part (OBJ, mm) by name. Objects of equal name are joined."""
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
            # file numbers count all points from 1; an object may continue an earlier one of the same name
            offset = len(points[name]) - (count - first_index) - first_index - 1
            facets[name].append([int(word.split("/")[0]) + offset for word in words[1:4]])
    return {name: _part(np.array(rows).reshape(-1, 3), facets[name]) for name, rows in points.items()}


def _part(points: FloatArray, triangles: Sequence[Sequence[int]]) -> CutPart:
    """Create an object from its points (V, 3) [m] and triangles."""
    normals = np.full(points.shape, np.nan)
    if len(triangles):
        mesh = TriangleMesh(points, np.array(triangles, dtype=np.int64))
        normals[np.unique(mesh.faces)] = vertex_normals(mesh)[np.unique(mesh.faces)]
    return CutPart(points, normals)


def cut_joint(
    names: tuple[str, str], first_faces: tuple[PanelCutFace, ...], second_faces: tuple[PanelCutFace, ...]
) -> CutJoint | None:
    """Measure the joint of two panels from their fronts and backs; None if their rims share no point."""
    points, steps, gaps = [], [], []
    for a, b in zip(first_faces, second_faces, strict=False):
        tree = cKDTree(b.nominal[b.rim, :2])  # both rims are displaced along z
        distance, nearest = tree.query(a.nominal[a.rim, :2], distance_upper_bound=VERTEX_TOLERANCE_M)
        is_common = np.isfinite(distance)
        first, second = a.rim[is_common], b.rim[np.asarray(nearest)[is_common]]
        difference = a.cut[first] - b.cut[second]
        normal = a.normals[first]
        step = dots(difference, normal)
        points.append(a.nominal[first])
        steps.append(np.abs(step))
        gaps.append(np.linalg.norm(difference - step[:, None] * normal, axis=1))
    if not sum(map(len, steps)):
        return None
    return CutJoint(names, np.concatenate(points), np.concatenate(steps), np.concatenate(gaps))
