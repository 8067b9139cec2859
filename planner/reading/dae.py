"""Visual link meshes in COLLADA (DAE, ISO/PAS 17506), the format of most robot manufacturers.

Read by ``pycollada`` of the extra ``dae``, which only parses. Lengths are in the unit of the file, placed by
its nodes. Its up axis is ignored, as in ROS viewers. Lines, textures, cameras and lights are ignored.
"""

import dataclasses
import io
from pathlib import Path
from typing import Any, Final

import numpy as np

from planner.geometry.arrays import FloatArray
from planner.geometry.mesh import TriangleMesh, merge_vertices
from planner.geometry.mesh_files import MAX_EXTENT_M, MIN_EXTENT_M

DAE_SUFFIX: Final = ".dae"
"""Suffix of COLLADA files."""
DAE_INSTALL: Final = "pip install 'tandem-planner[dae]'"
"""Command that installs the reader."""
MAX_PIECES: Final = 5000
"""Maximum number of pieces of a file, one for each use of a mesh and material."""

Colour = tuple[float, float, float]
"""Red, green and blue in 0..1."""


@dataclasses.dataclass(frozen=True)
class ColouredMesh:
    """A mesh [m] in one colour; None if the file states none."""

    mesh: TriangleMesh
    color: Colour | None


def read_dae(path: Path, scale: float) -> tuple[ColouredMesh, ...]:
    """Read the meshes of a file by colour, in the order of the file.

    Args:
        path: File.
        scale: Factor on the lengths of the file in metres.

    Raises:
        ValueError: No reader, unreadable file, no faces, numbers that are not finite, or a size that no link
            has. The text does not contain the name of the file.
    """
    try:
        import collada
    except ImportError as error:
        raise ValueError(f"DAE needs pycollada: {DAE_INSTALL}") from error
    data = path.read_bytes()
    if data.startswith(b"PK"):
        raise ValueError("it is compressed; unpack it")
    try:
        # missing textures and unknown elements do not matter here; missing faces do
        ignored_errors = [collada.common.DaeBrokenRefError, collada.common.DaeUnsupportedError]
        model = collada.Collada(io.BytesIO(data), ignore=ignored_errors)
        geometry_error = next((str(error) for error in model.errors if "eometry" in str(error)), None)
        if geometry_error is not None:
            raise ValueError(f"it cannot be read ({geometry_error[:120]})")
        metres_per_unit = scale * float(model.assetInfo.unitmeter or 1.0)
        by_colour = _triangles_by_colour(model)
    except ValueError:
        raise
    except Exception as error:  # damaged files raise anything
        reason = str(error).splitlines()[0][:120] if str(error) else type(error).__name__
        raise ValueError(f"it cannot be read ({reason})") from error
    out = []
    for color, pieces in by_colour.items():
        corners = metres_per_unit * np.concatenate(pieces)
        if not np.isfinite(corners).all():
            raise ValueError("it contains numbers that are not finite")
        mesh = merge_vertices(
            TriangleMesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))
        )
        if len(mesh.faces):
            out.append(ColouredMesh(mesh, color))
    if not out:
        raise ValueError("it has no faces")
    points = np.concatenate([coloured_mesh.mesh.vertices for coloured_mesh in out])
    extent = float(np.ptp(points, axis=0).max())
    if not MIN_EXTENT_M <= extent <= MAX_EXTENT_M:
        raise ValueError(f"it is {1e3 * extent:.4g} mm long in its own unit and the URDF's scale")
    return tuple(out)


def _triangles_by_colour(model: Any) -> dict[Colour | None, list[FloatArray]]:
    """Return triangles (F, 3, 3) of all meshes of the scene, placed by its nodes, in the file's lengths.

    Raises:
        ValueError: If the file has no scene or too many pieces.
    """
    if model.scene is None:
        raise ValueError("it has no scene")
    out: dict[Colour | None, list[FloatArray]] = {}
    count = 0
    for geometry in model.scene.objects("geometry"):
        for piece in geometry.primitives():
            count += 1
            if count > MAX_PIECES:
                raise ValueError(f"it has more than {MAX_PIECES:,} pieces; join them")
            faces = piece.triangleset() if hasattr(piece, "triangleset") else piece
            vertex_index = getattr(faces, "vertex_index", None)
            if vertex_index is None or not len(vertex_index) or np.shape(vertex_index)[1] != 3:
                continue  # lines
            corner_index = np.asarray(vertex_index, dtype=np.int64)
            if corner_index.min() < 0 or corner_index.max() >= len(faces.vertex):
                raise ValueError("a face refers to a missing vertex")
            out.setdefault(_colour(piece.material), []).append(
                np.asarray(faces.vertex, dtype=np.float64)[corner_index]
            )
    return out


def _colour(material: Any) -> Colour | None:
    """Return the colour of a material, None for no material and for textures."""
    diffuse = getattr(getattr(material, "effect", None), "diffuse", None)
    if not isinstance(diffuse, tuple) or len(diffuse) < 3:
        return None
    red, green, blue = (float(min(max(value, 0.0), 1.0)) for value in diffuse[:3])
    return (red, green, blue) if np.isfinite([red, green, blue]).all() else None
