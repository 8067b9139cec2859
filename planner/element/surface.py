"""The surface of an element over its plane: a frame, the lines that may be cut, and what lies over them.

**Element frame**: z is the surface's mean normal, or the axis of the file's frame that is near it; x and y
run along the sides of the rectangle over which the surface stands, from its lower corner. Panels are bounded
by upright planes of this frame, so a joint is a plane curve. The surface must stand over the whole rectangle
once.
"""

import dataclasses
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import FloatArray, dots, from_parts, inverse, lengths, transform, unit
from planner.geometry.mesh import TriangleMesh, face_areas, face_normals, offset, vertex_normals
from planner.geometry.mesh_queries import slice_mesh
from planner.geometry.rulings import boundaries
from planner.geometry.units import DEG, MM
from planner.issues import Issue, Severity, TandemError

SNAP_ANGLE: Final = 20.0 * DEG
"""An axis of the file's frame that is nearer to the mean normal than this [rad] is the element's z."""
STEEPEST: Final = 80.0 * DEG
"""How far a facet may be turned out of the element's plane [rad]."""
RIM: Final = 1e-5
"""How far inside of the rim the outermost sections are cut [m]."""
LEAST_COVER: Final = 0.998
"""Share of its rectangle over which a surface must stand."""
TOUCHING: Final = 1e-3
"""A rim that runs back along itself nearer than this [m] touches itself."""
TURNED_BACK: Final = -np.cos(20.0 * DEG)
"""Dot product of directions, at most, where a rim runs back."""
SEAM_STEP: Final = 0.02
"""Length of parts of the rim [m], at most, that are looked at."""
SHORTEST_SEAM: Final = 0.05
"""Length [m] over which a rim must touch itself to be told: sharp corners do so over less."""


@dataclasses.dataclass(frozen=True)
class ElementSurface:
    """``front`` and ``back`` in the element frame [m], the back with the same vertices moved by ``thickness``
    against their normals; ``pose`` (4, 4): the element frame in the file's frame; ``size`` (2,) [m] of the
    rectangle."""

    front: TriangleMesh
    back: TriangleMesh
    thickness: float
    pose: FloatArray
    size: FloatArray


def stand(
    mesh: TriangleMesh, thickness: float, normal: FloatArray | None = None, along: FloatArray | None = None
) -> ElementSurface:
    """The surface in its element frame, whose z is along ``normal`` (3,) and x along ``along`` (3,).

    Raises ``TandemError``: ``element.surface`` where the surface has holes, folds over or fills no rectangle,
    ``part.offset`` where the thickness does.
    """
    rotation = axes(mesh, normal, along)
    local = mesh.vertices @ rotation
    origin = rotation @ np.array([*local[:, :2].min(axis=0), 0.0])
    pose = from_parts(rotation, origin)
    own = TriangleMesh(transform(inverse(pose), mesh.vertices), mesh.faces)
    size = np.ptp(own.vertices[:, :2], axis=0)
    _refuse(own, size)
    back = offset(own, -thickness, vertex_normals(own))
    return ElementSurface(own, back, thickness, pose, size)


def axes(mesh: TriangleMesh, normal: FloatArray | None = None, along: FloatArray | None = None) -> FloatArray:
    """The axes of a surface's plane as columns (3, 3): z along ``normal``, else the surface's, x along
    ``along``. Raises ``TandemError``: ``element.surface`` where both run one way."""
    z = _axis(mesh) if normal is None else unit(np.asarray(normal, dtype=np.float64))
    if along is None:
        # level where the element stands upright
        along = np.array([1.0, 0.0, 0.0]) if abs(z[2]) > np.cos(45.0 * DEG) else np.cross([0.0, 0.0, 1.0], z)
    x = along - (along @ z) * z
    if np.linalg.norm(x) < 1e-6 * max(float(np.linalg.norm(along)), 1e-12) or not np.any(along):
        raise TandemError(
            _wrong("plane.along runs along its normal; give a direction in the plane", "surface.plane")
        )
    x = unit(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def _axis(mesh: TriangleMesh) -> FloatArray:
    mean = unit((face_areas(mesh)[:, None] * face_normals(mesh)).sum(axis=0))
    axis = np.sign(mean) * np.eye(3)[int(np.argmax(np.abs(mean)))]
    return axis if mean @ axis > np.cos(SNAP_ANGLE) else mean


def _wrong(what: str, field: str = "surface", hint: str | None = None) -> Issue:
    return Issue("element.surface", what, field=field, hint=hint)


def seam(mesh: TriangleMesh) -> tuple[Issue, ...]:
    """``element.surface``, a warning, where the rim of a surface [m] runs back along itself, as that of a
    tube does whose sides touch but are not joined."""
    ends = [(mesh.vertices[ring], mesh.vertices[np.roll(ring, -1)]) for ring in boundaries(mesh)]
    if not ends:
        return ()
    first, last = (np.concatenate(points) for points in zip(*ends, strict=True))
    parts = np.ceil(lengths(last - first) / SEAM_STEP).astype(np.int64).clip(1)
    own = np.repeat(np.arange(len(parts)), parts)
    share = (np.arange(len(own)) - np.repeat(np.cumsum(parts) - parts, parts))[:, None]
    way = (last - first)[own] / parts[own, None]
    middle = first[own] + (share + 0.5) * way
    one, other = cKDTree(middle).query_pairs(SEAM_STEP + TOUCHING, output_type="ndarray").T
    along, apart = unit(way), middle[one] - middle[other]
    apart -= dots(apart, along[other])[:, None] * along[other]
    touch = (dots(along[one], along[other]) < TURNED_BACK) & (lengths(apart) < TOUCHING)
    near = np.unique(np.concatenate([one[touch], other[touch]]))
    length = 0.5 * float(lengths(way[near]).sum())
    if length < SHORTEST_SEAM:
        return ()
    amid = middle[near][np.argmin(lengths(middle[near] - middle[near].mean(axis=0)))]
    x, y, z = (np.round(amid / MM) + 0.0).tolist()
    what = (
        f"the rim of the surface touches itself over {length / MM:.0f} mm, near ({x:g}, {y:g}, {z:g}) mm, "
        "as that of a tube whose sides are not joined: panels on both sides of it are no neighbours, and may "
        "have no way in"
    )
    hint = "join both sides there in the program that the surface is from, or leave a gap"
    return (Issue("element.surface", what, Severity.WARNING, field="surface", hint=hint),)


def _refuse(own: TriangleMesh, size: FloatArray) -> None:
    rings = boundaries(own)
    if len(rings) > 1:
        at = own.vertices[rings[-1]].mean(axis=0) / MM
        what = (
            f"the surface has {len(rings)} rims, 1 is allowed: the smallest is round a hole at "
            f"({at[0]:.0f}, {at[1]:.0f}) mm of the element's plane"
        )
        raise TandemError(_wrong(what, hint="close the hole, or divide the surface beside it yourself"))
    lean = face_normals(own)[:, 2]
    steep = lean < np.cos(STEEPEST)
    if steep.any():
        at = own.vertices[own.faces[int(np.argmin(lean))]].mean(axis=0) / MM
        worst = float(np.degrees(np.arccos(np.clip(lean.min(), -1.0, 1.0))))
        what = (
            f"{int(steep.sum())} of {len(steep)} facets are turned out of the element's plane by more than "
            f"{STEEPEST / DEG:.0f} degrees, the worst by {worst:.0f}, at ({at[0]:.0f}, {at[1]:.0f}) mm"
        )
        hint = (
            "unify the normals of the mesh; state another surface.plane; or give parts that do not fold over"
        )
        raise TandemError(_wrong(what, hint=hint))
    covered = float((face_areas(own) * lean).sum() / (size[0] * size[1]))
    if covered < LEAST_COVER:
        what = (
            f"the surface stands over {100 * covered:.1f} % of its rectangle of {size[0] / MM:.0f} x "
            f"{size[1] / MM:.0f} mm, at least {100 * LEAST_COVER:.1f} % are wanted"
        )
        hint = "state the plane and the direction of its sides (surface.plane), or extend it to a rectangle"
        raise TandemError(_wrong(what, hint=hint))


@dataclasses.dataclass(frozen=True)
class Profile:
    """Sections of a surface by upright planes at ``at`` (K,) [m] along one axis of the element's plane: one
    polyline each, ``place`` along the other axis, growing, ``height`` and arc ``length`` so far [m]."""

    at: FloatArray
    place: tuple[FloatArray, ...]
    height: tuple[FloatArray, ...]
    length: tuple[FloatArray, ...]


def profiles(own: TriangleMesh, size: FloatArray, axis: int, at: FloatArray) -> Profile:
    """Sections along ``axis`` (0: x, 1: y) at places ``at`` (K,) of the other one.

    Raises ``TandemError``: ``element.surface`` where a section has several pieces or runs back.
    """
    other = 1 - axis
    origin = np.zeros((len(at), 3))
    origin[:, other] = np.clip(at, RIM, size[other] - RIM)
    normal = np.broadcast_to(np.eye(3)[other], origin.shape)
    cut = slice_mesh(own, origin, normal)
    pieces = np.bincount(cut.plane, minlength=len(at))
    place, height, length = [], [], []
    first = np.searchsorted(cut.plane, np.arange(len(at)))
    for k in range(len(at)):
        line = cut.polyline(int(first[k])) if pieces[k] else np.zeros((2, 3))
        if line[-1, axis] < line[0, axis]:
            line = line[::-1]
        step = np.diff(line[:, axis])
        if pieces[k] != 1 or (step < -1e-9).any():
            name = "xy"[other]
            what = (
                f"the section at {name} = {at[k] / MM:.0f} mm of the element's plane has {pieces[k]} pieces "
                "or runs back; 1 that runs on is wanted"
            )
            raise TandemError(_wrong(what, hint="give a surface that stands over each place once, whole"))
        line = line[np.concatenate([[True], step > 1e-9])]
        place.append(line[:, axis])
        height.append(line[:, 2])
        steps = np.hypot(np.diff(line[:, axis]), np.diff(line[:, 2]))
        length.append(np.concatenate([[0.0], np.cumsum(steps)]))
    return Profile(at, tuple(place), tuple(height), tuple(length))
