"""What is seen of a robot of the user's own: the visual geometry of its URDF, as its maker drew it.

Meshes of more triangles than a replay and an answer of the page have room for are thinned out, all of a
robot by one grid, about the finest that suits. Nothing here is for distances, and nothing refuses a robot: of
a link whose visuals cannot be had the bodies for collision are seen.
"""

import functools
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np

from planner.catalogue.robots import Look
from planner.geometry.arrays import Mesh, Shape, read_only
from planner.geometry.mesh_files import MAX_MESH_BYTES, PLAIN_SUFFIXES, read_mesh
from planner.geometry.thinning import creased, joined
from planner.geometry.units import DEG, MM
from planner.issues import TandemError
from planner.reading.dae import DAE_SUFFIX, Colour, read_dae
from planner.reading.urdf import UrdfChain, UrdfShape

MOST_TRIANGLES: Final = 30_000
"""Triangles of the visual meshes of one robot at most: some 0.6 MB of a replay, 1 MB of an answer."""
FIRST_CELL: Final = 2.0 * MM
"""Edge [m] of the first grid in which vertices are joined, ..."""
LAST_CELL: Final = 40.0 * MM
"""... and of the last one: meshes that are still too much then are not seen."""
CREASE: Final = 30.0 * DEG
"""Edges between faces that are turned by about twice as much are seen as edges."""
NEUTRAL: Final = (0.70, 0.72, 0.75)
"""Red, green, blue of what has no colour in the URDF."""
SEEN_SUFFIXES: Final = (*PLAIN_SUFFIXES, DAE_SUFFIX)
"""Files of meshes that are read to be seen."""
NOT_THERE: Final = "not there"
NOT_READ: Final = "no OBJ, STL, PLY or DAE"
TOO_LARGE: Final = f"with those before it more than {MAX_MESH_BYTES / 1e6:.0f} MB"

_Named = tuple[str, int, int, tuple[float, ...]]
"""A mesh file: its path, its time of change [ns], its bytes, and how it is stretched."""
_Coloured = tuple[Mesh, Colour | None]
"""A mesh and its own colour, None of files that have none."""


def carried(files: Mapping[str, Path | None]) -> dict[str, Path]:
    """Of visual meshes by the URDF's names those that are read, and that a copy of the problem carries: of a
    kind that is read, no larger together than one mesh for collision may be."""
    out: dict[str, Path] = {}
    total = 0
    for name, path in files.items():
        if path is not None and _readable(path):
            total += path.stat().st_size
            if total > MAX_MESH_BYTES:
                break
            out[name] = path
    return out


def looks(
    chain: UrdfChain, shapes: tuple[tuple[Shape, ...], ...], files: Mapping[str, Path | None]
) -> tuple[tuple[tuple[Look, ...], ...], tuple[str, ...]]:
    """What is seen of the base and of each link, nothing where that is all of ``shapes``, what is held apart;
    and what is not seen, with the reason. ``files``: visual meshes by the URDF's names."""
    meshes = _meshes(chain, files)
    faults = {owner: f"a <visual> of the link {owner} ({why})" for owner, why in chain.unseen}
    seen: dict[str, list[Look]] = {}
    for one, mesh in zip(chain.visuals, meshes, strict=True):
        own = seen.setdefault(one.owner, [])
        if isinstance(mesh, str):
            faults.setdefault(one.owner, f"{one.file} ({mesh})")
        elif mesh is None:
            shape = Shape(one.kind, one.size, one.pose)  # type: ignore[arg-type]
            own.append(Look(shape, one.color or NEUTRAL))
        else:  # a file's own colours count before the URDF's, as in ROS's viewers
            shapes_of = [(Shape("mesh", (), one.pose, m.vertices, m.faces), colour) for m, colour in mesh]
            own += [Look(shape, colour or one.color or NEUTRAL) for shape, colour in shapes_of]
    shown = {owner: own for owner, own in seen.items() if owner not in faults}
    told = tuple(faults.values())
    if not shown:
        return (), told
    return tuple(_link(chain, link, own, shown) for link, own in zip(chain.links, shapes, strict=True)), told


def _link(
    chain: UrdfChain, link: str, shapes: tuple[Shape, ...], shown: Mapping[str, list[Look]]
) -> tuple[Look, ...]:
    """What is seen of a link of the chain: of each link of the URDF that it carries its visuals, or else its
    bodies for collision."""
    stated = [one.owner for one in chain.shapes if one.link == link]
    seen = [one.owner for one in chain.visuals if one.link == link]
    out: list[Look] = []
    for owner in dict.fromkeys((*stated, *seen)):
        hulls = [Look(shape) for shape, of in zip(shapes, stated, strict=True) if of == owner]
        out += shown.get(owner, hulls)
    return tuple(out)


def _meshes(chain: UrdfChain, files: Mapping[str, Path | None]) -> list[tuple[_Coloured, ...] | str | None]:
    """Of each visual its meshes [m], as they are shown, None of boxes and the like, or why there are none."""
    there = carried(files)
    named: list[_Named] = []
    out: list[str | None] = []
    for one in chain.visuals:
        if one.kind == "mesh" and one.file in there:
            named.append(_named(there[one.file], one))
        out.append(None if one.kind != "mesh" else _why(files.get(one.file)))
    read = iter(_shown(tuple(named)))
    return [
        next(read) if one.kind == "mesh" and one.file in there else told
        for one, told in zip(chain.visuals, out, strict=True)
    ]


def _why(path: Path | None) -> str:
    """Why a mesh is none of :func:`carried`."""
    if path is None:
        return NOT_THERE
    if path.suffix.lower() not in SEEN_SUFFIXES:
        return NOT_READ
    return TOO_LARGE if _readable(path) else "may not be read"


def _readable(path: Path) -> bool:
    return path.suffix.lower() in SEEN_SUFFIXES and os.access(path, os.R_OK)


def _named(path: Path, one: UrdfShape) -> _Named:
    stat = path.stat()
    return str(path), stat.st_mtime_ns, stat.st_size, one.size


@functools.lru_cache(maxsize=4)
def _shown(named: tuple[_Named, ...]) -> tuple[tuple[_Coloured, ...] | str, ...]:
    """The meshes of a robot's files, thinned out, or why there are none; kept, for a problem is read several
    times."""
    known = {one: _read(Path(one[0]), one[3]) for one in dict.fromkeys(named)}
    given = [known[one] for one in named]
    whole = [mesh for one in given if not isinstance(one, str) for mesh, _ in one]
    meshes = _few(whole)
    if meshes is None:
        count = sum(len(mesh.faces) for mesh in whole)
        what = f"{count:,} triangles of the robot, more than {MOST_TRIANGLES:,} also where thinned out"
        return tuple(one if isinstance(one, str) else what for one in given)
    fine = iter(creased(mesh, CREASE) for mesh in meshes)
    out: list[tuple[_Coloured, ...] | str] = []
    for one in given:
        if not isinstance(one, str):
            shown = [(next(fine), colour) for _, colour in one]
            one = tuple((mesh, colour) for mesh, colour in shown if len(mesh.faces))
        out.append(one)
    return read_only(tuple(out))


def _read(path: Path, scale: tuple[float, ...]) -> tuple[_Coloured, ...] | str:
    """The meshes [m] of a file, or why they cannot be had."""
    most = max(abs(v) for v in scale)
    try:
        if path.suffix.lower() == DAE_SUFFIX:
            found = [(one.mesh, one.color) for one in read_dae(path, most)]
        else:
            found = [(read_mesh(path, 1.0, most), None)]
    except TandemError as error:
        return error.issues[0].message
    except (OSError, ValueError) as error:
        return getattr(error, "strerror", None) or str(error)
    out = []
    for mesh, colour in found:
        faces = mesh.faces if np.prod(scale) > 0.0 else mesh.faces[:, ::-1]
        out.append((Mesh(mesh.vertices * (np.array(scale) / most), faces), colour))
    return tuple(out)


def _few(meshes: list[Mesh]) -> list[Mesh] | None:
    """The meshes with at most :data:`MOST_TRIANGLES` together, None where the coarsest grid leaves more."""
    count, cell = sum(len(mesh.faces) for mesh in meshes), FIRST_CELL
    if count <= MOST_TRIANGLES:
        return meshes
    while cell <= LAST_CELL:
        count = sum(len(joined(mesh, cell).faces) for mesh in meshes)
        if count <= MOST_TRIANGLES:
            return [joined(mesh, cell, edges=True) for mesh in meshes]
        # what is left goes with the square of the edge
        cell *= 1.05 * float(np.sqrt(count / MOST_TRIANGLES))
    return None
