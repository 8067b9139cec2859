"""Conversion of a NURBS face of a CAD file, from any program, to rails and rulings or to facets."""

import dataclasses
from pathlib import Path
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, RuledSurface
from planner.geometry.curves import CORNER_ANGLE_RAD, RuledGuide, turning_angles
from planner.geometry.matching import join_guides
from planner.geometry.mesh import TriangleMesh
from planner.geometry.nurbs import NurbsSurface
from planner.geometry.part_placement import facing_outwards, reversed_rulings
from planner.geometry.rulings import resample
from planner.geometry.units import MM, measurement
from planner.issues import Issue, Severity, TandemError
from planner.reading.drawing import CURVE_CHORD_TOLERANCE_M, file_error

CLOSED_TOLERANCE_M: Final = 1e-7
"""Maximum distance [m] between the ends of a side of a closed face."""
MAX_CELLS: Final = 1_000_000
"""Maximum number of cells of the facets of a face."""
_FREE_FORM_HINT: Final = "; use it as front or strips, which may be free-form"


@dataclasses.dataclass(frozen=True)
class FaceErrors:
    """Context of errors about a face of a file.

    Attributes:
        code: Issue code of the kind of file.
        facets_code: Issue code of the note on the deviation of facets.
        path: File.
        field: Field of the problem.
        what: Name of the face in messages.
    """

    code: str
    facets_code: str
    path: Path
    field: str
    what: str

    def error(self, words: str, code: str | None = None) -> TandemError:
        """Create the error about the face; ``words`` complete the sentence that starts with its name."""
        return file_error(code or self.code, self.path, self.field, f"{self.what} {words}")


@dataclasses.dataclass(frozen=True)
class RulingOptions:
    """How a face is ruled.

    Attributes:
        rulings: Direction of the rulings, "u" or "v"; None to choose the straight one.
        closed: Whether the face is closed.
        flip: Whether to reverse its normal.
        hole: Whether it is a hole.
    """

    rulings: str | None
    closed: bool
    flip: bool
    hole: bool


@dataclasses.dataclass(frozen=True)
class CadFace:
    """A face as facets.

    Attributes:
        mesh: Facets.
        normals: Unit normals (V, 3) of the vertices.
        surface: Surface that the facets represent; None for a mesh.
        is_reversed: Whether the normal of the surface is reversed.
        notes: Notes.
    """

    mesh: TriangleMesh
    normals: FloatArray
    surface: NurbsSurface | None
    is_reversed: bool
    notes: tuple[Issue, ...]


def ruled_between_sides(
    name: str, surface: NurbsSurface, reverse: bool, ruling_options: RulingOptions, face: FaceErrors
) -> RuledSurface:
    """Create a ruled face between two of its sides, with its rulings.

    Args:
        name: Name of the face.
        surface: Surface.
        reverse: Whether the normal of the surface is reversed.
        ruling_options: How the face is ruled.
        face: Context of errors.

    Raises:
        TandemError: ``part.not_ruled``, and the code of the kind of file.
    """
    is_straight = {key: surface.is_straight(k) for k, key in enumerate("uv")}
    if ruling_options.rulings is not None and not is_straight[ruling_options.rulings]:
        text = (
            f"its lines along {ruling_options.rulings} are not "
            f"straight{_straight_direction_hint(is_straight)}"
        )
        raise file_error("part.not_ruled", face.path, face.field, text)
    directions = [key for key in "uv" if is_straight[key] and ruling_options.rulings in (None, key)]
    if not directions:
        raise face.error(f"is curved both ways{_FREE_FORM_HINT}", "part.not_ruled")
    if len(directions) > 1:
        text = "is straight both ways; state the direction of the wire: rulings: u or v"
        raise face.error(text, "part.not_ruled")
    along = "uv".index(directions[0])
    start, end = surface.rails(along, CURVE_CHORD_TOLERANCE_M)
    if (along == 0) != reverse:  # tangent x ruling is the face's normal
        start, end = start[::-1], end[::-1]
    are_closed = [float(np.linalg.norm(side[0] - side[-1])) <= CLOSED_TOLERANCE_M for side in (start, end)]
    if all(are_closed) != ruling_options.closed:
        text = "is closed: add closed: true" if all(are_closed) else "is not closed: remove closed"
        raise face.error(text)
    if ruling_options.closed:
        start, end = start[:-1], end[:-1]
    corner = (turning_angles(start, ruling_options.closed) > CORNER_ANGLE_RAD) | (
        turning_angles(end, ruling_options.closed) > CORNER_ANGLE_RAD
    )
    parameter = np.arange(len(start)) / (len(start) if ruling_options.closed else len(start) - 1)
    first, second = (RuledGuide(side, corner, parameter, ruling_options.closed) for side in (start, end))
    ruled = join_guides(name, first, second, "parameter", ruling_options.hole)
    if ruling_options.closed:
        ruled = facing_outwards(ruled)
    elif ruling_options.flip:
        ruled = reversed_rulings(ruled)
    return resample(ruled, 0.5e-5, 1.0)


def _straight_direction_hint(is_straight: dict[str, bool]) -> str:
    """Return a hint on the other direction, if its lines are straight, else on other uses of the face."""
    straight_keys = [key for key, value in is_straight.items() if value]
    return f"; those along {straight_keys[0]} are" if straight_keys else _FREE_FORM_HINT


def tessellate_face(
    surface: NurbsSurface, is_reversed: bool, chord_mm: float, face: FaceErrors, notes: tuple[Issue, ...]
) -> CadFace:
    """Tessellate a face within ``chord_mm`` and note the measured deviation.

    Args:
        surface: Surface.
        is_reversed: Whether to reverse its normal.
        chord_mm: Maximum distance [mm] of the facets from the face.
        face: Context of errors.
        notes: Notes to keep.

    Raises:
        TandemError: The facets need more than `MAX_CELLS` cells; with the code of the kind of file.
    """
    try:
        vertices, normals, faces, deviation = surface.facets(chord_mm * MM, MAX_CELLS)
    except ValueError as error:
        raise face.error(
            f"is too large: {error}; allow a larger chord_mm, or check the file's unit"
        ) from error
    if is_reversed:
        normals, faces = -normals, faces[:, ::-1]
    message = (
        f"{face.path.name}: {len(faces)} facets are up to {deviation / MM:.2g} mm off the face, as measured"
    )
    note = Issue(
        face.facets_code,
        message,
        Severity.NOTE,
        file=str(face.path),
        field=face.field,
        **measurement(deviation / MM, chord_mm, "mm"),
    )
    return CadFace(TriangleMesh(vertices, faces), normals, surface, is_reversed, (*notes, note))
