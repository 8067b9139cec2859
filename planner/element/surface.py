"""The surface of an element over its plane: its frame, and its sections over cut lines.

**Element frame**: z is the mean normal of the surface, or the axis of the file frame close to it; x and y run
along the sides of the rectangle over which the surface lies, from its lower corner. Panels are bounded by
upright planes of this frame, so a joint is a plane curve. The surface must cover the whole rectangle once.
"""

import dataclasses
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import FloatArray, dots, from_parts, inverse, lengths, transform, unit
from planner.geometry.mesh import TriangleMesh, face_areas, face_normals, offset_mesh, vertex_normals
from planner.geometry.mesh_queries import slice_mesh
from planner.geometry.rulings import boundary_rings
from planner.geometry.units import DEG, MM
from planner.issues import Issue, Severity, TandemError

SNAP_ANGLE_RAD: Final = 20.0 * DEG
"""Maximum angle [rad] between the mean normal and an axis of the file frame that becomes the element's z."""
MAX_TILT_RAD: Final = 80.0 * DEG
"""Maximum tilt [rad] of a facet to the element plane."""
RIM_INSET_M: Final = 1e-5
"""Distance [m] inside of the rim at which the outermost sections are cut."""
MIN_COVER_FRACTION: Final = 0.998
"""Minimum fraction of its rectangle that a surface must cover."""
TOUCH_DISTANCE_M: Final = 1e-3
"""Maximum distance [m] of two parts of a rim, with opposite directions, that count as touching."""
MAX_REVERSED_DOT: Final = -np.cos(20.0 * DEG)
"""Maximum dot product of the directions of two parts of a rim that count as opposite."""
SEAM_STEP_M: Final = 0.02
"""Maximum length [m] of the parts of the rim that are compared."""
MIN_SEAM_M: Final = 0.05
"""Minimum length [m] of touching rim that is reported: sharp corners touch over less."""


@dataclasses.dataclass(frozen=True)
class ElementSurface:
    """Surface of an element in its frame [m].

    Attributes:
        front: Front, over the rectangle from (0, 0) to ``size``.
        back: Back, with the vertices of the front offset by ``thickness`` against their normals.
        thickness: Thickness of the element.
        pose: Pose (4, 4) of the element frame in the file frame.
        size: Size (2,) of the rectangle.
    """

    front: TriangleMesh
    back: TriangleMesh
    thickness: float
    pose: FloatArray
    size: FloatArray


def to_element_frame(
    mesh: TriangleMesh, thickness: float, normal: FloatArray | None = None, along: FloatArray | None = None
) -> ElementSurface:
    """Transform a surface [m] into its element frame, and add its back.

    ``normal`` and ``along`` are those of `surface_axes`.

    Raises:
        TandemError: ``element.surface`` if the surface has holes, is too steep or does not fill its
            rectangle; ``part.offset`` if the back folds over.
    """
    rotation = surface_axes(mesh, normal, along)
    local = mesh.vertices @ rotation
    origin = rotation @ np.array([*local[:, :2].min(axis=0), 0.0])
    pose = from_parts(rotation, origin)
    element_mesh = TriangleMesh(transform(inverse(pose), mesh.vertices), mesh.faces)
    size = np.ptp(element_mesh.vertices[:, :2], axis=0)
    _require_rectangle(element_mesh, size)
    back = offset_mesh(element_mesh, -thickness, vertex_normals(element_mesh))
    return ElementSurface(element_mesh, back, thickness, pose, size)


def surface_axes(
    mesh: TriangleMesh, normal: FloatArray | None = None, along: FloatArray | None = None
) -> FloatArray:
    """Return the axes of a surface's plane as columns (3, 3).

    z is along ``normal`` (3,), else along the mean normal. x is along ``along`` (3,) projected into the
    plane, else along the file's x for a lying surface, and level for an upright one.

    Raises:
        TandemError: ``element.surface`` if z and ``along`` are parallel.
    """
    z = _mean_axis(mesh) if normal is None else unit(np.asarray(normal, dtype=np.float64))
    if along is None:
        # x of the file if the element lies, level if it is upright
        along = np.array([1.0, 0.0, 0.0]) if abs(z[2]) > np.cos(45.0 * DEG) else np.cross([0.0, 0.0, 1.0], z)
    x = along - (along @ z) * z
    if np.linalg.norm(x) < 1e-6 * max(float(np.linalg.norm(along)), 1e-12) or not np.any(along):
        raise TandemError(
            _surface_issue(
                "plane.along is parallel to the normal; give a direction in the plane", "surface.plane"
            )
        )
    x = unit(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def _mean_axis(mesh: TriangleMesh) -> FloatArray:
    """Return the mean normal (3,) of a surface, or the axis of its frame that is close to it."""
    mean_normal = unit((face_areas(mesh)[:, None] * face_normals(mesh)).sum(axis=0))
    axis = np.sign(mean_normal) * np.eye(3)[int(np.argmax(np.abs(mean_normal)))]
    return axis if mean_normal @ axis > np.cos(SNAP_ANGLE_RAD) else mean_normal


def _surface_issue(message: str, field: str = "surface", hint: str | None = None) -> Issue:
    return Issue("element.surface", message, field=field, hint=hint)


def seam_issues(mesh: TriangleMesh) -> tuple[Issue, ...]:
    """Return a warning ``element.surface`` if the rim of a surface [m] runs back along itself, else nothing.

    The rim of a tube does so if its sides touch but are not joined.
    """
    ends = [(mesh.vertices[ring], mesh.vertices[np.roll(ring, -1)]) for ring in boundary_rings(mesh)]
    if not ends:
        return ()
    first, last = (np.concatenate(points) for points in zip(*ends, strict=True))
    # divide each edge of the rim into equal parts, and compare their centres
    parts = np.ceil(lengths(last - first) / SEAM_STEP_M).astype(np.int64).clip(1)
    edge_index = np.repeat(np.arange(len(parts)), parts)
    fraction = (np.arange(len(edge_index)) - np.repeat(np.cumsum(parts) - parts, parts))[:, None]
    steps = (last - first)[edge_index] / parts[edge_index, None]
    middle = first[edge_index] + (fraction + 0.5) * steps
    first_index, second_index = (
        cKDTree(middle).query_pairs(SEAM_STEP_M + TOUCH_DISTANCE_M, output_type="ndarray").T
    )
    along, offsets = unit(steps), middle[first_index] - middle[second_index]
    offsets -= dots(offsets, along[second_index])[:, None] * along[second_index]
    touches = (dots(along[first_index], along[second_index]) < MAX_REVERSED_DOT) & (
        lengths(offsets) < TOUCH_DISTANCE_M
    )
    touching = np.unique(np.concatenate([first_index[touches], second_index[touches]]))
    length = 0.5 * float(lengths(steps[touching]).sum())
    if length < MIN_SEAM_M:
        return ()
    centre = middle[touching][np.argmin(lengths(middle[touching] - middle[touching].mean(axis=0)))]
    x, y, z = (np.round(centre / MM) + 0.0).tolist()
    message = (
        f"the rim of the surface touches itself over {length / MM:.0f} mm, near ({x:g}, {y:g}, {z:g}) mm, "
        "like that of a tube whose sides are not joined: panels on both sides are not neighbours, and may "
        "have no insertion path"
    )
    hint = "join both sides in the CAD program of the surface, or leave a gap"
    return (Issue("element.surface", message, Severity.WARNING, field="surface", hint=hint),)


def _require_rectangle(mesh: TriangleMesh, size: FloatArray) -> None:
    """Raise ``element.surface`` if a surface has holes, steep facets, or gaps in its rectangle (2,) [m]."""
    rings = boundary_rings(mesh)
    if len(rings) > 1:
        at = mesh.vertices[rings[-1]].mean(axis=0) / MM
        message = (
            f"the surface has {len(rings)} rims, allowed 1: the smallest is around a hole at "
            f"({at[0]:.0f}, {at[1]:.0f}) mm of the element's plane"
        )
        raise TandemError(_surface_issue(message, hint="close the hole, or split the surface at it"))
    normal_z = face_normals(mesh)[:, 2]
    is_steep = normal_z < np.cos(MAX_TILT_RAD)
    if is_steep.any():
        at = mesh.vertices[mesh.faces[int(np.argmin(normal_z))]].mean(axis=0) / MM
        tilt = float(np.degrees(np.arccos(np.clip(normal_z.min(), -1.0, 1.0))))
        message = (
            f"{int(is_steep.sum())} of {len(is_steep)} facets are tilted to the element's plane by more than "
            f"{MAX_TILT_RAD / DEG:.0f} degrees, the worst by {tilt:.0f}, at ({at[0]:.0f}, {at[1]:.0f}) mm"
        )
        hint = (
            "unify the normals of the mesh; state another surface.plane; or give parts that do not fold over"
        )
        raise TandemError(_surface_issue(message, hint=hint))
    covered = float((face_areas(mesh) * normal_z).sum() / (size[0] * size[1]))
    if covered < MIN_COVER_FRACTION:
        message = (
            f"the surface covers {100 * covered:.1f} % of its rectangle of {size[0] / MM:.0f} x "
            f"{size[1] / MM:.0f} mm, required {100 * MIN_COVER_FRACTION:.1f} %"
        )
        hint = "state the plane and the direction of its sides (surface.plane), or extend it to a rectangle"
        raise TandemError(_surface_issue(message, hint=hint))


@dataclasses.dataclass(frozen=True)
class SectionProfiles:
    """Sections of a surface by K upright planes along one axis of the element plane, one polyline each.

    Attributes:
        at: Positions (K,) [m] of the planes on the other axis.
        position: For each section, positions (P,) [m] of its points on the first axis, ascending.
        height: For each section, heights (P,) [m] of its points.
        length: For each section, arc lengths (P,) [m] of its points from its start.
    """

    at: FloatArray
    position: tuple[FloatArray, ...]
    height: tuple[FloatArray, ...]
    length: tuple[FloatArray, ...]


def cut_profiles(mesh: TriangleMesh, size: FloatArray, axis: int, at: FloatArray) -> SectionProfiles:
    """Cut a surface into sections along ``axis`` (0: x, 1: y) at positions ``at`` (K,) [m] on the other axis.

    ``size`` (2,) [m] is the rectangle of the surface. Sections on its edges are moved inside by
    `RIM_INSET_M`.

    Raises:
        TandemError: ``element.surface`` if a section has several pieces or runs back.
    """
    other = 1 - axis
    origin = np.zeros((len(at), 3))
    origin[:, other] = np.clip(at, RIM_INSET_M, size[other] - RIM_INSET_M)
    normal = np.broadcast_to(np.eye(3)[other], origin.shape)
    cut = slice_mesh(mesh, origin, normal)
    pieces = np.bincount(cut.plane, minlength=len(at))
    positions, height, length = [], [], []
    first = np.searchsorted(cut.plane, np.arange(len(at)))
    for k in range(len(at)):
        line = cut.polyline(int(first[k])) if pieces[k] else np.zeros((2, 3))
        if line[-1, axis] < line[0, axis]:
            line = line[::-1]
        step = np.diff(line[:, axis])
        if pieces[k] != 1 or (step < -1e-9).any():
            name = "xy"[other]
            message = (
                f"the section at {name} = {at[k] / MM:.0f} mm of the element's plane has {pieces[k]} pieces "
                "or runs back; expected 1 piece that does not"
            )
            raise TandemError(
                _surface_issue(message, hint="give a surface that covers each point of the plane once")
            )
        line = line[np.concatenate([[True], step > 1e-9])]
        positions.append(line[:, axis])
        height.append(line[:, 2])
        steps = np.hypot(np.diff(line[:, axis]), np.diff(line[:, 2]))
        length.append(np.concatenate([[0.0], np.cumsum(steps)]))
    return SectionProfiles(at, tuple(positions), tuple(height), tuple(length))
