"""What becomes of a NURBS face of a CAD file, whatever program wrote it: rails and rulings, or facets."""

import dataclasses
from pathlib import Path
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, Ruled
from planner.geometry.curves import CORNER_ANGLE, Guide, turns
from planner.geometry.matching import join
from planner.geometry.mesh import TriangleMesh
from planner.geometry.nurbs import NurbsSurface
from planner.geometry.placing import backwards, outwards
from planner.geometry.rulings import resample
from planner.geometry.units import MM, measurement
from planner.issues import Issue, Severity, TandemError
from planner.reading.drawing import FLATNESS, refused

CLOSED_WITHIN: Final = 1e-7
"""Sides of a face whose ends are this near [m] go all round."""
MOST_CELLS: Final = 1_000_000
"""Most cells of a face's facets."""
_FREE: Final = "; take it as front or strips, which may be free-form"


@dataclasses.dataclass(frozen=True)
class Refusals:
    """How a face of a file is refused: the ``code`` of its kind of file, that of how far ``facets`` are off,
    the file, the problem's field, and ``what`` the face is called."""

    code: str
    facets: str
    path: Path
    field: str
    what: str

    def of(self, words: str, code: str | None = None) -> TandemError:
        """The refusal of the face in these words."""
        return refused(code or self.code, self.path, self.field, f"{self.what} {words}")


@dataclasses.dataclass(frozen=True)
class Way:
    """How a face is ruled: along u or v, closed or not, turned over, as a hole."""

    rulings: str | None
    closed: bool
    flip: bool
    hole: bool


@dataclasses.dataclass(frozen=True)
class CadFace:
    """A face as facets, with the unit normals (V, 3) of its vertices; the surface that they stand for, None
    of a mesh, and whether its normal is ``turned``; notes."""

    mesh: TriangleMesh
    normals: FloatArray
    surface: NurbsSurface | None
    turned: bool
    notes: tuple[Issue, ...]


def between_sides(name: str, surface: NurbsSurface, reverse: bool, way: Way, face: Refusals) -> Ruled:
    """A ruled face between its own sides, its rulings as they are; ``reverse``: its normal is turned.

    Raises ``TandemError``: ``part.not_ruled``, and the code of its kind of file.
    """
    straight = {key: surface.straight(k) for k, key in enumerate("uv")}
    if way.rulings is not None and not straight[way.rulings]:
        what = f"its lines along {way.rulings} are not straight{_instead(straight)}"
        raise refused("part.not_ruled", face.path, face.field, what)
    ways = [key for key in "uv" if straight[key] and way.rulings in (None, key)]
    if not ways:
        raise face.of(f"bends both ways{_FREE}", "part.not_ruled")
    if len(ways) > 1:
        what = "is straight both ways; say along which the wire lies: rulings: u or v"
        raise face.of(what, "part.not_ruled")
    along = "uv".index(ways[0])
    start, end = surface.rails(along, FLATNESS)
    if (along == 0) != reverse:  # tangent x ruling is the face's normal
        start, end = start[::-1], end[::-1]
    shut = [float(np.linalg.norm(side[0] - side[-1])) <= CLOSED_WITHIN for side in (start, end)]
    if all(shut) != way.closed:
        what = "goes all round: add closed: true" if all(shut) else "does not go all round: take closed out"
        raise face.of(what)
    if way.closed:
        start, end = start[:-1], end[:-1]
    corner = (turns(start, way.closed) > CORNER_ANGLE) | (turns(end, way.closed) > CORNER_ANGLE)
    parameter = np.arange(len(start)) / (len(start) if way.closed else len(start) - 1)
    one, other = (Guide(side, corner, parameter, way.closed) for side in (start, end))
    made = join(name, one, other, "parameter", way.hole)
    if way.closed:
        made = outwards(made)
    elif way.flip:
        made = backwards(made)
    return resample(made, 0.5e-5, 1.0)


def _instead(straight: dict[str, bool]) -> str:
    other = [key for key, value in straight.items() if value]
    return f"; those along {other[0]} are" if other else _FREE


def faceted(
    surface: NurbsSurface, turned: bool, chord_mm: float, face: Refusals, notes: tuple[Issue, ...]
) -> CadFace:
    """Facets of a face within ``chord_mm`` of it, ``turned`` over or not; how far they are off is told.

    Raises ``TandemError`` with the code of its kind of file.
    """
    try:
        vertices, normals, faces, off = surface.facets(chord_mm * MM, MOST_CELLS)
    except ValueError as error:
        raise face.of(f"is too large: {error}; allow a larger chord_mm, or check the file's unit") from error
    if turned:
        normals, faces = -normals, faces[:, ::-1]
    what = f"{face.path.name}: {len(faces)} facets are off the face by {off / MM:.2g} mm at most, as measured"
    told = Issue(
        face.facets,
        what,
        Severity.NOTE,
        file=str(face.path),
        field=face.field,
        **measurement(off / MM, chord_mm, "mm"),
    )
    return CadFace(TriangleMesh(vertices, faces), normals, surface, turned, (*notes, told))
