"""What is taken of STEP and IGES files, by number, name and colour: ruled faces and free faces.

Open CASCADE reads them in a process of its own (:mod:`planner.reading.occt`, extra ``step``); what becomes of
a face, :mod:`planner.reading.cad_faces` works out.
"""

import importlib.util
import json
import subprocess
import sys
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
from pydantic import Field

from planner.files import is_file, no_file
from planner.geometry.arrays import Ruled
from planner.geometry.nurbs import NurbsSurface, rectangle
from planner.geometry.units import LENGTH_UNITS, MM
from planner.issues import Issue, Severity
from planner.reading.cad_faces import CadFace, Refusals, Way, between_sides, faceted
from planner.reading.drawing import MOST_BYTES, refused
from planner.reading.strict_yaml import FileName, Strict, Unit

STEP_SUFFIXES: Final = (".step", ".stp", ".igs", ".iges")
"""Files that are read."""
STEP_INSTALL: Final = "pip install 'tandem-planner[step]'"
"""What to run where the reader of STEP files is missing."""
LONGEST: Final = 300.0
"""A file that is not read after this [s] is given up."""
ON_LINE_SHARE: Final = 1e-4
"""Share of a surface's parameters by which an edge along one of its lines may be off that line."""
UNITS: Final = {
    **dict.fromkeys(("millimetre", "mm"), 1e-3),
    **dict.fromkeys(("centimetre", "cm"), 1e-2),
    **dict.fromkeys(("metre", "m"), 1.0),
    **dict.fromkeys(("inch", "in"), 0.0254),
    **dict.fromkeys(("foot", "ft"), 0.3048),
}
"""Names of units in STEP and IGES files, in metres, that may be stated as well."""


class StepFile(Strict):
    """One face of a STEP or IGES file: of those that have all of what is given of ``face``, ``name`` and
    ``colour``, there is one. Needs the extra ``step`` of Tandem.

    Lengths are in the file's unit; ``unit`` is for files that have none.
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

    def asked(self) -> str:
        """What is asked for, in words."""
        keys = [f"{key} {value}" for key in ("face", "name", "colour") if (value := getattr(self, key))]
        return f" of {', '.join(keys)}" if keys else ""


class StepRuledFile(StepFile):
    """A ruled face of a STEP or IGES file, whole or cut along its own lines; its normal points away from the
    part. ``rulings``: along u or v, where it is straight both ways.
    """

    rulings: Literal["u", "v"] | None = None


class StepFaceFile(StepFile):
    """A face of a STEP or IGES file, whole or cut along its own lines; ``chord_mm``: how far its facets may
    be off it. Its normal points away from the part.
    """

    chord_mm: float = Field(default=0.005, ge=0.0005, le=1)
    flip: bool = Field(default=False, description="turn the side that faces away from the part")


def ruled(
    name: str, spec: StepRuledFile, closed: bool, flip: bool, hole: bool, folder: Path, field: str
) -> tuple[Ruled, list[Issue]]:
    """A ruled face between its own sides, its rulings as they are in the file; and notes.

    Raises ``TandemError``: ``problem.missing_file``, ``problem.too_large``, ``part.extra_missing``,
    ``part.step``, ``part.not_ruled``.
    """
    surface, reverse, of, note = _face(spec, folder, field)
    return between_sides(name, surface, reverse, Way(spec.rulings, closed, flip, hole), of), [note]


def face(spec: StepFaceFile, folder: Path, field: str) -> CadFace:
    """A face in SI units; how far facets are off it is among its notes. Raises ``TandemError``: as
    :func:`ruled`."""
    surface, reverse, of, note = _face(spec, folder, field)
    return faceted(surface, reverse != spec.flip, spec.chord_mm, of, (note,))


def _face(spec: StepFile, folder: Path, field: str) -> tuple[NurbsSurface, bool, Refusals, Issue]:
    """The one face that is asked for, whether its normal is turned, how it is refused, a note of the unit."""
    path = folder / spec.file
    said = _asked(spec, path, field)
    if said.get("fault"):
        raise refused("part.step", path, field, f"cannot be read: {said['fault']}; export it again")
    size, note = _unit(said["units"], spec, path, field)
    if said["count"] != 1:
        shown = "; ".join(_told(one) for one in said["faces"][:12])
        what = f"has {said['count']} faces{spec.asked()} in {said['bodies']} bodies, 1 is wanted; "
        what += (
            f"give the number of one (face: 3), its name or colour: {shown}"
            if shown
            else ("surfaces and solids are read, no curves; save the face with the file, or ask for another")
        )
        raise refused("part.step", path, field, what)
    of = Refusals("part.step", "part.step_facets", path, field, f"the face{spec.asked()}")
    own = said["surface"]
    if own.get("fault"):
        raise of.of(f"has {own['fault']}; untrim it, or make it anew between its edges (a loft)")
    region = np.array(own["region"])
    edges = [np.array(edge) for edge in own["edges"]]
    if rectangle(edges, ON_LINE_SHARE * np.ptp(region, axis=1)) is None:
        what = "is cut along other lines than its own; untrim it, or make it anew between its edges (a loft)"
        raise of.of(what)
    control = np.array(own["control"]) * np.array([size, size, size, 1.0])
    if not np.isfinite(control).all() or (control[..., 3] <= 0.0).any():
        raise of.of("has numbers that are not finite, or weights that are not above 0; make it anew")
    degree = int(own["degree"][0]), int(own["degree"][1])
    knots = np.array(own["knots"][0]), np.array(own["knots"][1])
    ends = [(float(k[p]), float(k[-p - 1])) for p, k in zip(degree, knots, strict=True)]
    return NurbsSurface(degree, knots, control, (ends[0], ends[1])), bool(own["reversed"]), of, note


def _told(one: dict[str, Any]) -> str:
    """A face in words: its number, kind, names and colour."""
    words = [str(one["kind"]), *(f"'{name}'" for name in one["names"]), *filter(None, [one["colour"]])]
    return f"{one['number']} ({', '.join(words)})"


def _asked(spec: StepFile, path: Path, field: str) -> dict[str, Any]:
    """What Open CASCADE has of the file, out of a process of its own."""
    if not is_file(path):
        raise refused("problem.missing_file", path, field, f"{no_file(path)}; check the path")
    if path.suffix.lower() not in STEP_SUFFIXES:
        what = f"got '{path.suffix}', read are STEP (.step, .stp) and IGES (.igs, .iges); convert it"
        raise refused("part.step", path, field, what)
    if path.stat().st_size > MOST_BYTES:
        raise refused("problem.too_large", path, field, "more than 50 MB; export only what is needed")
    if importlib.util.find_spec("OCP") is None:
        what = f"STEP and IGES files need Open CASCADE; {STEP_INSTALL}"
        raise refused("part.extra_missing", path, field, what)
    asked = {"file": str(path.absolute()), "face": spec.face, "name": spec.name, "colour": spec.colour}
    try:
        done = subprocess.run(
            [sys.executable, "-m", "planner.reading.occt"],
            input=json.dumps(asked).encode(),
            capture_output=True,
            timeout=LONGEST,
            check=False,
            cwd=Path(__file__).parents[2],  # where modules are looked for first: not where the user is
        )
    except subprocess.TimeoutExpired as error:
        what = f"was not read after {LONGEST:g} s; export only the face that is needed"
        raise refused("part.step", path, field, what) from error
    if done.returncode != 0:
        last = (done.stderr.decode(errors="replace").strip().splitlines() or ["it crashed"])[-1][:160]
        what = f"cannot be read by Open CASCADE ({last}); export it again, or only the face that is needed"
        raise refused("part.step", path, field, what)
    out: dict[str, Any] = json.loads(done.stdout)
    return out


def _unit(units: list[str], spec: StepFile, path: Path, field: str) -> tuple[float, Issue]:
    """Metres of a length that was read as a millimetre, and a note that tells the unit."""
    stated = None if spec.unit is None else LENGTH_UNITS[spec.unit]
    if not units and stated is None:
        raise refused("part.step", path, field, "says no unit of length; state it (unit: mm)")
    if units and stated is not None:
        own = {UNITS.get(name.lower()) for name in units}
        if own != {stated}:
            what = f"is in {' and '.join(units).lower()}, the problem says {spec.unit}; take unit out"
            raise refused("part.step", path, field, what)
    what = f"{path.name} is in {' and '.join(units).lower() if units else spec.unit}"
    note = Issue("part.step_unit", what, Severity.NOTE, file=str(path), field=field)
    return MM if units or stated is None else stated, note
