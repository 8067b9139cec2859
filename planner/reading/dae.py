"""Link meshes in COLLADA (DAE, ISO/PAS 17506), in which most makers draw their robots, to be seen.

Read by ``pycollada`` of the extra ``dae``, which only parses. Lengths are in the file's own unit, placed by
its nodes; its up axis is not looked at, as ROS's viewers do not. Lines, textures, cameras and lights are left
out.
"""

import dataclasses
import io
from pathlib import Path
from typing import Any, Final

import numpy as np

from planner.geometry.arrays import FloatArray
from planner.geometry.mesh import TriangleMesh, merge
from planner.geometry.mesh_files import LARGEST_EXTENT, SMALLEST_EXTENT

DAE_SUFFIX: Final = ".dae"
"""How names of such files end."""
DAE_INSTALL: Final = "pip install 'tandem-planner[dae]'"
"""What to run where their reader is missing."""
MOST_PIECES: Final = 5000
"""Pieces of a file at most, one for each use of a mesh and material."""

Colour = tuple[float, float, float]
"""Red, green and blue in 0..1."""


@dataclasses.dataclass(frozen=True)
class Painted:
    """A mesh [m] in one colour, None where the file has none."""

    mesh: TriangleMesh
    color: Colour | None


def read_dae(path: Path, scale: float) -> tuple[Painted, ...]:
    """The meshes of a file by colour, in its order, in metres times ``scale``.

    Raises ``ValueError`` in words without the file's name: no reader, unreadable, without faces, numbers that
    are not finite, of a size that no link has.
    """
    try:
        import collada
    except ImportError as error:
        raise ValueError(f"DAE needs pycollada: {DAE_INSTALL}") from error
    data = path.read_bytes()
    if data.startswith(b"PK"):
        raise ValueError("it is packed; unpack it")
    try:
        # textures that are not there, and what it does not know, do not matter here; faces do
        passed = [collada.common.DaeBrokenRefError, collada.common.DaeUnsupportedError]
        model = collada.Collada(io.BytesIO(data), ignore=passed)
        lost = next((str(error) for error in model.errors if "eometry" in str(error)), None)
        if lost is not None:
            raise ValueError(f"it cannot be read ({lost[:120]})")
        size = scale * float(model.assetInfo.unitmeter or 1.0)
        by_colour = _by_colour(model)
    except ValueError:
        raise
    except Exception as error:  # damaged files raise anything
        reason = str(error).splitlines()[0][:120] if str(error) else type(error).__name__
        raise ValueError(f"it cannot be read ({reason})") from error
    out = []
    for color, pieces in by_colour.items():
        corners = size * np.concatenate(pieces)
        if not np.isfinite(corners).all():
            raise ValueError("it has numbers that are not finite")
        mesh = merge(TriangleMesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3)))
        if len(mesh.faces):
            out.append(Painted(mesh, color))
    if not out:
        raise ValueError("it has no faces")
    points = np.concatenate([one.mesh.vertices for one in out])
    extent = float(np.ptp(points, axis=0).max())
    if not SMALLEST_EXTENT <= extent <= LARGEST_EXTENT:
        raise ValueError(f"it is {1e3 * extent:.4g} mm long in its own unit and the URDF's scale")
    return tuple(out)


def _by_colour(model: Any) -> dict[Colour | None, list[FloatArray]]:
    """Triangles (F, 3, 3) of all meshes of the scene, where its nodes place them, in the file's lengths.
    Raises ``ValueError`` for a file without a scene, or with too much in it."""
    if model.scene is None:
        raise ValueError("it has no scene")
    out: dict[Colour | None, list[FloatArray]] = {}
    count = 0
    for geometry in model.scene.objects("geometry"):
        for piece in geometry.primitives():
            count += 1
            if count > MOST_PIECES:
                raise ValueError(f"it has more than {MOST_PIECES:,} pieces; join them")
            faces = piece.triangleset() if hasattr(piece, "triangleset") else piece
            index = getattr(faces, "vertex_index", None)
            if index is None or not len(index) or np.shape(index)[1] != 3:
                continue  # lines
            rows = np.asarray(index, dtype=np.int64)
            if rows.min() < 0 or rows.max() >= len(faces.vertex):
                raise ValueError("a face names a vertex that is not there")
            out.setdefault(_colour(piece.material), []).append(
                np.asarray(faces.vertex, dtype=np.float64)[rows]
            )
    return out


def _colour(material: Any) -> Colour | None:
    """Return the colour of a material, None for no material and for textures."""
    diffuse = getattr(getattr(material, "effect", None), "diffuse", None)
    if not isinstance(diffuse, tuple) or len(diffuse) < 3:
        return None
    red, green, blue = (float(min(max(value, 0.0), 1.0)) for value in diffuse[:3])
    return (red, green, blue) if np.isfinite([red, green, blue]).all() else None
