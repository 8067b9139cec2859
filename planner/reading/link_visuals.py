"""Visual geometry of a custom robot, from its URDF.

Meshes with more triangles than a replay or an answer of the page can take are decimated, all meshes of a
robot with the finest grid that suffices. Visuals are not used for distances and never refuse a robot: links
without usable visuals are shown by their collision bodies.
"""

import functools
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np

from planner.catalogue.robots import VisualShape
from planner.geometry.arrays import Mesh, Shape, read_only
from planner.geometry.decimation import merge_cells, split_creases
from planner.geometry.mesh_files import MAX_MESH_BYTES, PLAIN_SUFFIXES, read_mesh
from planner.geometry.units import DEG, MM
from planner.issues import TandemError
from planner.reading.dae import DAE_SUFFIX, Colour, read_dae
from planner.reading.urdf import UrdfChain, UrdfShape

MAX_TRIANGLES: Final = 30_000
"""Maximum number of triangles of a robot's visual meshes: some 0.6 MB of a replay, 1 MB of an answer."""
FIRST_CELL_M: Final = 2.0 * MM
"""Edge [m] of the first grid for decimation."""
LAST_CELL_M: Final = 40.0 * MM
"""Edge [m] of the coarsest grid. Meshes that are too large with it are not shown."""
CREASE_ANGLE_RAD: Final = 30.0 * DEG
"""Edges are rendered sharp from about twice this angle between faces [rad]."""
NEUTRAL_COLOUR: Final = (0.70, 0.72, 0.75)
"""Red, green, blue of visuals without a colour."""
VISUAL_SUFFIXES: Final = (*PLAIN_SUFFIXES, DAE_SUFFIX)
"""Suffixes of mesh files that are read as visuals."""
MISSING: Final = "missing"
UNSUPPORTED_FORMAT: Final = "not OBJ, STL, PLY or DAE"
TOO_LARGE: Final = f"more than {MAX_MESH_BYTES / 1e6:.0f} MB together with the previous ones"

_MeshKey = tuple[str, int, int, tuple[float, ...]]
"""A mesh file: path, modification time [ns], size [bytes] and scale."""
_ColouredMesh = tuple[Mesh, Colour | None]
"""A mesh and its colour, None if the file states none."""


def visual_meshes_to_bundle(files: Mapping[str, Path | None]) -> dict[str, Path]:
    """Return the visual meshes that are read and bundled with the problem, by their names in the URDF.

    They are of a supported format and together no larger than one collision mesh may be.
    """
    out: dict[str, Path] = {}
    total = 0
    for name, path in files.items():
        if path is not None and _readable(path):
            total += path.stat().st_size
            if total > MAX_MESH_BYTES:
                break
            out[name] = path
    return out


def link_visuals(
    chain: UrdfChain, shapes: tuple[tuple[Shape, ...], ...], files: Mapping[str, Path | None]
) -> tuple[tuple[tuple[VisualShape, ...], ...], tuple[str, ...]]:
    """Return the visuals of the base and of each link, and what is not shown.

    Args:
        chain: Kinematic chain of the URDF.
        shapes: Collision shapes of base and links.
        files: Visual mesh files by their names in the URDF; None for missing ones.

    Returns:
        Visuals of base and links, empty if only collision shapes would be shown; and the reasons for each
        link that is not shown as in the URDF.
    """
    meshes = _visual_meshes(chain, files)
    faults = {owner: f"a <visual> of the link {owner} ({reason})" for owner, reason in chain.invalid_visuals}
    visuals_by_link: dict[str, list[VisualShape]] = {}
    for visual, mesh in zip(chain.visuals, meshes, strict=True):
        owner_visuals = visuals_by_link.setdefault(visual.owner, [])
        if isinstance(mesh, str):
            faults.setdefault(visual.owner, f"{visual.file} ({mesh})")
        elif mesh is None:
            shape = Shape(visual.kind, visual.size, visual.pose)  # type: ignore[arg-type]
            owner_visuals.append(VisualShape(shape, visual.color or NEUTRAL_COLOUR))
        else:  # colours of a mesh file override those of the URDF, as in ROS viewers
            coloured_shapes = [
                (Shape("mesh", (), visual.pose, m.vertices, m.faces), colour) for m, colour in mesh
            ]
            owner_visuals += [
                VisualShape(shape, colour or visual.color or NEUTRAL_COLOUR)
                for shape, colour in coloured_shapes
            ]
    shown = {owner: owner_visuals for owner, owner_visuals in visuals_by_link.items() if owner not in faults}
    reasons = tuple(faults.values())
    if not shown:
        return (), reasons
    return tuple(
        _visuals_of_link(chain, link, link_shapes, shown)
        for link, link_shapes in zip(chain.links, shapes, strict=True)
    ), reasons


def _visuals_of_link(
    chain: UrdfChain, link: str, shapes: tuple[Shape, ...], shown: Mapping[str, list[VisualShape]]
) -> tuple[VisualShape, ...]:
    """Return the visuals of a link of the chain and of the URDF links fixed to it.

    A URDF link without visuals is shown by its collision shapes.
    """
    shape_owners = [item.owner for item in chain.shapes if item.link == link]
    visual_owners = [item.owner for item in chain.visuals if item.link == link]
    out: list[VisualShape] = []
    for owner in dict.fromkeys((*shape_owners, *visual_owners)):
        collision_visuals = [
            VisualShape(shape)
            for shape, shape_owner in zip(shapes, shape_owners, strict=True)
            if shape_owner == owner
        ]
        out += shown.get(owner, collision_visuals)
    return tuple(out)


def _visual_meshes(
    chain: UrdfChain, files: Mapping[str, Path | None]
) -> list[tuple[_ColouredMesh, ...] | str | None]:
    """Return the meshes [m] of each visual, None for primitives, or the reason why there are none."""
    readable = visual_meshes_to_bundle(files)
    keys: list[_MeshKey] = []
    reasons: list[str | None] = []
    for visual in chain.visuals:
        if visual.kind == "mesh" and visual.file in readable:
            keys.append(_mesh_key(readable[visual.file], visual))
        reasons.append(None if visual.kind != "mesh" else _missing_reason(files.get(visual.file)))
    read_meshes = iter(_decimated_meshes(tuple(keys)))
    return [
        next(read_meshes) if visual.kind == "mesh" and visual.file in readable else reason
        for visual, reason in zip(chain.visuals, reasons, strict=True)
    ]


def _missing_reason(path: Path | None) -> str:
    """Return the reason why a mesh is not among :func:`visual_meshes_to_bundle`."""
    if path is None:
        return MISSING
    if path.suffix.lower() not in VISUAL_SUFFIXES:
        return UNSUPPORTED_FORMAT
    return TOO_LARGE if _readable(path) else "not readable"


def _readable(path: Path) -> bool:
    return path.suffix.lower() in VISUAL_SUFFIXES and os.access(path, os.R_OK)


def _mesh_key(path: Path, visual: UrdfShape) -> _MeshKey:
    stat = path.stat()
    return str(path), stat.st_mtime_ns, stat.st_size, visual.size


@functools.lru_cache(maxsize=4)
def _decimated_meshes(keys: tuple[_MeshKey, ...]) -> tuple[tuple[_ColouredMesh, ...] | str, ...]:
    """Return decimated meshes of a robot's files, or the reasons why there are none.

    Cached, because a problem is read several times.
    """
    meshes_by_key = {entry: _read_meshes(Path(entry[0]), entry[3]) for entry in dict.fromkeys(keys)}
    meshes_by_file = [meshes_by_key[entry] for entry in keys]
    all_meshes = [mesh for entry in meshes_by_file if not isinstance(entry, str) for mesh, _ in entry]
    meshes = _decimate(all_meshes)
    if meshes is None:
        count = sum(len(mesh.faces) for mesh in all_meshes)
        reason = f"{count:,} triangles of the robot, more than {MAX_TRIANGLES:,} even if decimated"
        return tuple(entry if isinstance(entry, str) else reason for entry in meshes_by_file)
    split_meshes = iter(split_creases(mesh, CREASE_ANGLE_RAD) for mesh in meshes)
    out: list[tuple[_ColouredMesh, ...] | str] = []
    for entry in meshes_by_file:
        if not isinstance(entry, str):
            shown = [(next(split_meshes), colour) for _, colour in entry]
            entry = tuple((mesh, colour) for mesh, colour in shown if len(mesh.faces))
        out.append(entry)
    return read_only(tuple(out))


def _read_meshes(path: Path, scale: tuple[float, ...]) -> tuple[_ColouredMesh, ...] | str:
    """Return the meshes [m] of a file, or the reason why it cannot be read."""
    max_scale = max(abs(v) for v in scale)
    try:
        if path.suffix.lower() == DAE_SUFFIX:
            meshes = [
                (coloured_mesh.mesh, coloured_mesh.color) for coloured_mesh in read_dae(path, max_scale)
            ]
        else:
            meshes = [(read_mesh(path, 1.0, max_scale), None)]
    except TandemError as error:
        return error.issues[0].message
    except (OSError, ValueError) as error:
        return getattr(error, "strerror", None) or str(error)
    out = []
    for mesh, colour in meshes:
        faces = mesh.faces if np.prod(scale) > 0.0 else mesh.faces[:, ::-1]
        out.append((Mesh(mesh.vertices * (np.array(scale) / max_scale), faces), colour))
    return tuple(out)


def _decimate(meshes: list[Mesh]) -> list[Mesh] | None:
    """Decimate meshes to :data:`MAX_TRIANGLES` in total; None if the coarsest grid leaves more."""
    count, cell = sum(len(mesh.faces) for mesh in meshes), FIRST_CELL_M
    if count <= MAX_TRIANGLES:
        return meshes
    while cell <= LAST_CELL_M:
        count = sum(len(merge_cells(mesh, cell).faces) for mesh in meshes)
        if count <= MAX_TRIANGLES:
            return [merge_cells(mesh, cell, edges=True) for mesh in meshes]
        # the number of triangles is proportional to 1 / cell^2
        cell *= 1.05 * float(np.sqrt(count / MAX_TRIANGLES))
    return None
