"""Ruled faces and faces of STEP and IGES files, read independently of the planner.

Open CASCADE parses the file again, in a process of its own (``python -m planner.proof.part_files.step``).
Exact points of the face's surface are used, not its conversion to B-splines. The parameter ranges of the face
are those that Open CASCADE finds.
"""

import io
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any, Final

import numpy as np

from planner.geometry.arrays import FloatArray
from planner.proof.part_files import UNITS, Entry, UnreadError, file_of
from planner.proof.part_files.curves import GuideRulings
from planner.proof.part_files.meshes import MeshFace, grid_face, rulings

_IGES: Final = (".igs", ".iges")
"""Suffixes of IGES files."""
_TIMEOUT_S: Final = 300.0
"""Time [s] after which reading a file is given up."""


def ruled_face(entry: Entry) -> GuideRulings:
    """Read the rulings of a ruled face, in the order in which the face's normal is tangent x ruling.

    At the end of a closed face the first ruling is repeated.

    Raises:
        UnreadError: The file cannot be read, or the face is not ruled.
    """
    arrays_read = _read_in_process(entry, "rulings")
    return GuideRulings(arrays_read["start"], arrays_read["end"])


def face(entry: Entry) -> MeshFace:
    """Read a face on a grid of exact points.

    Raises:
        UnreadError: The file cannot be read, or has no such face.
    """
    arrays_read = _read_in_process(entry, "face")
    return MeshFace(arrays_read["vertices"], arrays_read["up"], arrays_read["faces"], arrays_read["number"])


def _read_in_process(entry: Entry, kind: str) -> dict[str, Any]:
    """Return the arrays that another process computes from the file, as :func:`_read_arrays` describes."""
    path = file_of(entry)
    path.stat()
    keys = ("face", "name", "colour", "rulings", "flip")
    request = {"file": str(path.absolute()), "want": kind, "size": _metres_per_unit(entry)} | {
        key: entry.get(key) for key in keys
    }
    try:
        done = subprocess.run(
            [sys.executable, "-m", "planner.proof.part_files.step"],
            input=json.dumps(request).encode(),
            capture_output=True,
            timeout=_TIMEOUT_S,
            check=False,
            cwd=Path(__file__).parents[3],  # where modules are searched first, instead of the user's folder
        )
    except subprocess.TimeoutExpired as error:
        raise UnreadError(f"reading takes more than {_TIMEOUT_S:g} s") from error
    if done.returncode != 0:
        last = (done.stderr.decode(errors="replace").strip().splitlines() or ["Open CASCADE crashed"])[-1]
        raise UnreadError(last.removeprefix("planner.proof.part_files.UnreadError: ")[:160])
    with np.load(io.BytesIO(done.stdout)) as arrays:
        return dict(arrays)


def _metres_per_unit(entry: Entry) -> float:
    """Return the metres per unit in which Open CASCADE returns lengths.

    Open CASCADE converts to millimetres if the file states its unit. Else the unit is that of the entry.
    """
    path = file_of(entry)
    text = path.read_bytes().decode("latin-1")
    if path.suffix.lower() in _IGES or re.search(r"\bLENGTH_UNIT\s*\(", text):
        return 1 / 1000
    if entry.get("unit") is None:
        raise UnreadError("it states no unit of length")
    return UNITS[str(entry["unit"])]


def _read_arrays(request: dict[str, Any]) -> dict[str, Any]:
    """Return the arrays of a face or of its rulings, for :func:`_read_in_process`.

    ``request["want"]`` is ``face`` or ``rulings``. The arrays of a face are the fields of `MeshFace`, and
    those of rulings their starts and ends (M, 3) [m].
    """
    from OCP.BRep import BRep_Tool
    from OCP.BRepTools import BRepTools
    from OCP.GeomAdaptor import GeomAdaptor_Surface
    from OCP.TopAbs import TopAbs_REVERSED

    topods_face = _selected_face(request)
    u0, u1, v0, v1 = BRepTools.UVBounds_s(topods_face)
    surface = GeomAdaptor_Surface(BRep_Tool.Surface_s(topods_face))
    size = float(request["size"])

    def at(u: FloatArray, v: FloatArray) -> FloatArray:
        """Return points (N, 3) [m] of the surface at parameters u and v (N,)."""
        points = (surface.Value(float(a), float(b)) for a, b in zip(u, v, strict=True))
        return size * np.array([(p.X(), p.Y(), p.Z()) for p in points])

    region = (float(u0), float(u1)), (float(v0), float(v1))
    is_reversed = topods_face.Orientation() == TopAbs_REVERSED
    kinks = _kinks(surface)
    if request["want"] == "face":
        grid = grid_face(at, *region, is_reversed != bool(request["flip"]), kinks)
        return {"vertices": grid.vertices, "up": grid.up, "faces": grid.faces, "number": grid.number}
    along, start, end = rulings(at, region, kinks, request["rulings"])
    # Along u, dS/dv x ruling is opposite to dS/du x dS/dv.
    order = slice(None, None, -1) if (along == 0) != is_reversed else slice(None)
    return {"start": start[order], "end": end[order]}


def _kinks(surface: Any) -> tuple[FloatArray, FloatArray]:
    """Return the knots along u and v of a B-spline surface, none for other surfaces."""
    from OCP.GeomAbs import GeomAbs_BSplineSurface

    if surface.GetType() != GeomAbs_BSplineSurface:
        return np.zeros(0), np.zeros(0)
    spline = surface.BSpline()
    along = np.array([spline.UKnot(k + 1) for k in range(spline.NbUKnots())])
    return along, np.array([spline.VKnot(k + 1) for k in range(spline.NbVKnots())])


def _selected_face(request: dict[str, Any]) -> Any:
    """Return the one face in the file that has the requested number, name and colour.

    Faces are numbered from 1, body by body. The name may be that of the product, the body or the face.
    """
    from OCP.collections import Sequence_TDF_Label
    from OCP.IGESCAFControl import IGESCAFControl_Reader
    from OCP.Quantity import Quantity_Color
    from OCP.STEPCAFControl import STEPCAFControl_Reader
    from OCP.TCollection import TCollection_ExtendedString
    from OCP.TDataStd import TDataStd_Name
    from OCP.TDocStd import TDocStd_Document
    from OCP.TopAbs import TopAbs_FACE, TopAbs_SHELL, TopAbs_SOLID
    from OCP.TopExp import TopExp_Explorer
    from OCP.TopoDS import TopoDS
    from OCP.XCAFDoc import XCAFDoc_ColorGen, XCAFDoc_ColorSurf, XCAFDoc_DocumentTool

    iges = str(request["file"]).lower().endswith(_IGES)
    reader: Any = IGESCAFControl_Reader() if iges else STEPCAFControl_Reader()
    reader.SetColorMode(True)
    reader.SetNameMode(True)
    document = TDocStd_Document(TCollection_ExtendedString("proof"))
    reader.ReadFile(str(request["file"]))
    if not reader.Transfer(document):
        raise UnreadError("it has no shapes")
    transfer = (reader if iges else reader.ChangeReader()).WS().TransferReader()
    colour_tool = XCAFDoc_DocumentTool.ColorTool_s(document.Main())

    def subshapes(shape: Any, *kinds: Any) -> list[Any]:
        """Return the shapes of the first kind in a shape, except those inside a shape of the second kind."""
        shapes, walk = [], TopExp_Explorer(shape, *kinds)
        while walk.More():
            shapes.append(walk.Current())
            walk.Next()
        return shapes

    def shape_name(shape: Any) -> str:
        """Return the name that the file gives a body or a face, "" for none."""
        entity = transfer.EntityFromShapeResult(shape, 1)
        name = getattr(entity, "NameValue" if iges else "Name", lambda: None)()
        return "" if name is None else str(name.ToCString()).strip()

    def shape_colour(shape: Any) -> str:
        """Return the colour of a shape as ``#RRGGBB``, "" for none."""
        quantity_colour = Quantity_Color()
        if colour_tool.GetColor(shape, XCAFDoc_ColorSurf, quantity_colour) or colour_tool.GetColor(
            shape, XCAFDoc_ColorGen, quantity_colour
        ):
            return str(Quantity_Color.ColorToHex_s(quantity_colour).ToCString())
        return ""

    # Solids, shells outside solids, and faces outside shells count as bodies. Colours are inherited.
    labels: Any = Sequence_TDF_Label()
    XCAFDoc_DocumentTool.ShapeTool_s(document.Main()).GetFreeShapes(labels)
    number, selected = 0, []
    for k in range(1, labels.Length() + 1):
        label, product = labels.Value(k), ""
        if label.IsAttribute(TDataStd_Name.GetID_s()):
            title = TDataStd_Name()
            label.FindAttribute(TDataStd_Name.GetID_s(), title)
            product = title.Get().ToExtString()
        root = XCAFDoc_DocumentTool.ShapeTool_s(document.Main()).GetShape_s(label)
        bodies = [*subshapes(root, TopAbs_SOLID), *subshapes(root, TopAbs_SHELL, TopAbs_SOLID)]
        for body in [*bodies, *subshapes(root, TopAbs_FACE, TopAbs_SHELL)]:
            for body_face in subshapes(body, TopAbs_FACE):
                number += 1
                names: set[Any] = {product.lower(), shape_name(body).lower(), shape_name(body_face).lower()}
                colour = shape_colour(body_face) or shape_colour(body) or shape_colour(root)
                properties = {"face": {number}, "name": names, "colour": {colour.lower()}}
                selection = {key: request[key] for key in properties if request[key] is not None}
                if all(
                    (value if key == "face" else str(value).lower()) in properties[key]
                    for key, value in selection.items()
                ):
                    selected.append(body_face)
    if len(selected) != 1:
        raise UnreadError(f"{len(selected)} of its faces match the selection")
    return TopoDS.Face(selected[0])


def _main() -> None:
    """Read a request from the standard input, and write its arrays to the standard output."""
    answer = os.dup(1)
    os.dup2(2, 1)  # keep Open CASCADE's output out of the answer
    data = io.BytesIO()
    np.savez(data, **_read_arrays(json.loads(sys.stdin.read())))
    with os.fdopen(answer, "wb") as stream:
        stream.write(data.getvalue())
    sys.stderr.flush()
    os._exit(0)  # skip Open CASCADE's cleanup


if __name__ == "__main__":
    _main()
