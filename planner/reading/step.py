"""Faces of STEP and IGES files, selected by number, name and colour: ruled faces and free faces.

Open CASCADE reads them in a separate process (:mod:`planner.reading.occt`, extra ``step``);
:mod:`planner.reading.cad_faces` converts the face.
"""

import importlib.util
import json
import subprocess
import sys
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
from pydantic import Field

from planner.files import is_file, missing_file_reason
from planner.geometry.arrays import RuledSurface
from planner.geometry.nurbs import NurbsSurface, bounding_rectangle
from planner.geometry.units import LENGTH_UNITS, MM
from planner.issues import Issue, Severity
from planner.reading.cad_faces import CadFace, FaceErrors, RulingOptions, ruled_between_sides, tessellate_face
from planner.reading.drawing import MAX_BYTES, file_error
from planner.reading.strict_yaml import FileName, Strict, Unit

STEP_SUFFIXES: Final = (".step", ".stp", ".igs", ".iges")
"""Suffixes of files that are read."""
STEP_INSTALL: Final = "pip install 'tandem-planner[step]'"
"""Command that installs the reader of STEP files."""
READ_TIMEOUT_S: Final = 300.0
"""Time limit for reading a file [s]."""
LINE_TOLERANCE_FRACTION: Final = 1e-4
"""Maximum deviation of an edge from a parameter line of its surface, as a fraction of the parameter range."""
UNITS: Final = {
    **dict.fromkeys(("millimetre", "mm"), 1e-3),
    **dict.fromkeys(("centimetre", "cm"), 1e-2),
    **dict.fromkeys(("metre", "m"), 1.0),
    **dict.fromkeys(("inch", "in"), 0.0254),
    **dict.fromkeys(("foot", "ft"), 0.3048),
}
"""Names of units in STEP and IGES files, in metres, that the problem may also state."""


class StepFile(Strict):
    """One face of a STEP or IGES file: the only one that matches the given ``face``, ``name`` and ``colour``.

    Needs the extra ``step`` of Tandem.

    Lengths are in the unit of the file; ``unit`` is for files that have none.
    """

    file: FileName
    face: (
        Annotated[int, Field(ge=1, description="its number in the file, from 1, over all bodies")] | None
    ) = None
    name: (
        Annotated[str, Field(min_length=1, max_length=255, description="of the face or its body")] | None
    ) = None
    colour: Annotated[str, Field(pattern=r"^#[0-9a-fA-F]{6}$", description="'#rrggbb'")] | None = None
    unit: Unit | None = None

    def selection_text(self) -> str:
        """Return the selection in words, for messages."""
        keys = [f"{key} {value}" for key in ("face", "name", "colour") if (value := getattr(self, key))]
        return f" of {', '.join(keys)}" if keys else ""


class StepRuledFile(StepFile):
    """A ruled face of a STEP or IGES file, whole or trimmed along its parameter lines.

    Its normal points away from the part. ``rulings`` is u or v, for a face that is straight both ways.
    """

    rulings: Literal["u", "v"] | None = None


class StepFaceFile(StepFile):
    """A face of a STEP or IGES file, whole or trimmed along its parameter lines.

    ``chord_mm`` is the maximum distance of its facets. Its normal points away from the part.
    """

    chord_mm: float = Field(default=0.005, ge=0.0005, le=1)
    flip: bool = Field(default=False, description="reverse the normal; it must point away from the part")


def read_ruled(
    name: str, spec: StepFile, options: RulingOptions, folder: Path, field: str
) -> tuple[RuledSurface, list[Issue]]:
    """Return a ruled face between two of its sides, with the rulings of the file; and notes.

    Args:
        name: Name of the face.
        spec: File, and selection of the face.
        options: How the face is ruled.
        folder: Folder to which the file name is relative.
        field: Field of the problem, for issues.

    Raises:
        TandemError: ``problem.missing_file``, ``problem.too_large``, ``part.extra_missing``, ``part.step``,
            ``part.not_ruled``.
    """
    surface, reverse, errors, note = _selected_face(spec, folder, field)
    return ruled_between_sides(name, surface, reverse, options, errors), [note]


def read_face(spec: StepFaceFile, folder: Path, field: str) -> CadFace:
    """Return a face in SI units. The deviation of its facets is among its notes.

    Raises:
        TandemError: As :func:`read_ruled`.
    """
    surface, reverse, errors, note = _selected_face(spec, folder, field)
    return tessellate_face(surface, reverse != spec.flip, spec.chord_mm, errors, (note,))


def _selected_face(spec: StepFile, folder: Path, field: str) -> tuple[NurbsSurface, bool, FaceErrors, Issue]:
    """Return the selected face, whether its normal is reversed, the error context, and a note on the unit."""
    path = folder / spec.file
    answer = _query_file(spec, path, field)
    if answer.get("fault"):
        raise file_error("part.step", path, field, f"cannot be read: {answer['fault']}; export it again")
    metres_per_unit, note = _file_unit(answer["units"], spec, path, field)
    if answer["count"] != 1:
        face_list = "; ".join(_describe_face(listed) for listed in answer["faces"][:12])
        message = (
            f"has {answer['count']} faces{spec.selection_text()} in {answer['bodies']} bodies, expected 1; "
        )
        message += (
            f"give the number of one (face: 3), its name or colour: {face_list}"
            if face_list
            else ("only surfaces and solids are read; save the face with the file, or select another")
        )
        raise file_error("part.step", path, field, message)
    errors = FaceErrors("part.step", "part.step_facets", path, field, f"the face{spec.selection_text()}")
    spline = answer["surface"]
    if spline.get("fault"):
        raise errors.error(f"has {spline['fault']}; untrim it, or create it again from its edges (a loft)")
    region = np.array(spline["region"])
    edges = [np.array(edge) for edge in spline["edges"]]
    if bounding_rectangle(edges, LINE_TOLERANCE_FRACTION * np.ptp(region, axis=1)) is None:
        message = "is not trimmed along its parameter lines; untrim it, or create it again from its edges"
        raise errors.error(message)
    control = np.array(spline["control"]) * np.array([metres_per_unit, metres_per_unit, metres_per_unit, 1.0])
    if not np.isfinite(control).all() or (control[..., 3] <= 0.0).any():
        raise errors.error(
            "has numbers that are not finite, or weights that are not positive; create it again"
        )
    degree = int(spline["degree"][0]), int(spline["degree"][1])
    knots = np.array(spline["knots"][0]), np.array(spline["knots"][1])
    ends = [(float(k[p]), float(k[-p - 1])) for p, k in zip(degree, knots, strict=True)]
    return NurbsSurface(degree, knots, control, (ends[0], ends[1])), bool(spline["reversed"]), errors, note


def _describe_face(face: dict[str, Any]) -> str:
    """Describe a face: number, kind, names and colour."""
    words = [str(face["kind"]), *(f"'{name}'" for name in face["names"]), *filter(None, [face["colour"]])]
    return f"{face['number']} ({', '.join(words)})"


def _query_file(spec: StepFile, path: Path, field: str) -> dict[str, Any]:
    """Return the answer of Open CASCADE, which reads the file in a separate process.

    Raises:
        TandemError: As :func:`read_ruled`; ``part.step`` if the process fails or takes too long.
    """
    if not is_file(path):
        raise file_error("problem.missing_file", path, field, f"{missing_file_reason(path)}; check the path")
    if path.suffix.lower() not in STEP_SUFFIXES:
        text = f"got '{path.suffix}', allowed STEP (.step, .stp) and IGES (.igs, .iges); convert it"
        raise file_error("part.step", path, field, text)
    if path.stat().st_size > MAX_BYTES:
        raise file_error("problem.too_large", path, field, "more than 50 MB; export only what is needed")
    if importlib.util.find_spec("OCP") is None:
        text = f"STEP and IGES files need Open CASCADE; {STEP_INSTALL}"
        raise file_error("part.extra_missing", path, field, text)
    request = {"file": str(path.absolute()), "face": spec.face, "name": spec.name, "colour": spec.colour}
    try:
        process = subprocess.run(
            [sys.executable, "-m", "planner.reading.occt"],
            input=json.dumps(request).encode(),
            capture_output=True,
            timeout=READ_TIMEOUT_S,
            check=False,
            cwd=Path(__file__).parents[2],  # modules are found here first, not in the user's folder
        )
    except subprocess.TimeoutExpired as error:
        text = f"was not read after {READ_TIMEOUT_S:g} s; export only the face that is needed"
        raise file_error("part.step", path, field, text) from error
    if process.returncode != 0:
        last_line = (process.stderr.decode(errors="replace").strip().splitlines() or ["it crashed"])[-1][:160]
        text = (
            f"cannot be read by Open CASCADE ({last_line}); export it again, or only the face that is needed"
        )
        raise file_error("part.step", path, field, text)
    out: dict[str, Any] = json.loads(process.stdout)
    return out


def _file_unit(units: list[str], spec: StepFile, path: Path, field: str) -> tuple[float, Issue]:
    """Return the length [m] of one unit of the read coordinates, and a note on the file's unit.

    Open CASCADE converts coordinates to millimetres by the file's unit. Without one it leaves them unchanged.
    """
    stated = None if spec.unit is None else LENGTH_UNITS[spec.unit]
    if not units and stated is None:
        raise file_error("part.step", path, field, "states no unit of length; state it (unit: mm)")
    if units and stated is not None:
        file_units = {UNITS.get(name.lower()) for name in units}
        if file_units != {stated}:
            message = f"is in {' and '.join(units).lower()}, but the problem states {spec.unit}; remove unit"
            raise file_error("part.step", path, field, message)
    message = f"{path.name} is in {' and '.join(units).lower() if units else spec.unit}"
    note = Issue("part.step_unit", message, Severity.NOTE, file=str(path), field=field)
    return MM if units or stated is None else stated, note
