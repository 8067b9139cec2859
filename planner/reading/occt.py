"""Thin layer over Open CASCADE (``OCP`` of the extra ``step``) that extracts faces of a STEP or IGES file.

It runs as a separate process (``python -m planner.reading.occt``), with a JSON request on standard input and
a JSON answer on standard output. So a file that crashes Open CASCADE results in a message, and its memory is
released. All lengths are in millimetres, as Open CASCADE converts them. No other module of the planner
imports ``OCP``. In version 8.0 of it ``TDF_Label.FindAttribute`` and ``XCAFDoc_ShapeTool.Search`` crash if
there is nothing to find, so they are not called then.
"""

import json
import os
import sys
from collections.abc import Iterator
from typing import Any, Final

IGES_SUFFIXES: Final = (".igs", ".iges")
"""Suffixes of files that are read as IGES. Others are STEP."""
IGES_UNITS: Final = {1: "inch", 2: "millimetre", 4: "foot", 6: "metre", 10: "centimetre"}
"""Units of IGES files by their flag; one is always stated."""
EDGE_SAMPLES: Final = 9
"""Number of points on an edge, ends included, at which the trimming of a face is tested."""
MAX_LISTED_FACES: Final = 24
"""Maximum number of faces that an answer lists."""


def answer(request: dict[str, Any]) -> dict[str, Any]:
    """Answer a request for faces of a file.

    Args:
        request: ``file``, and optionally ``face``, ``name``, ``colour``.

    Returns:
        ``units``: names of the length units of the file; ``bodies``: their number; ``faces``: number, names,
            colour and kind of matching faces, at most `MAX_LISTED_FACES`; ``count``: number of matching
            faces; ``surface`` if there is exactly one. ``fault``: the reason if there is no answer.
    """
    path = str(request["file"])
    reader, document = _reader(path)
    from OCP.IFSelect import IFSelect_RetDone

    if reader.ReadFile(path) != IFSelect_RetDone:
        return {"fault": "it is not a complete STEP or IGES file"}
    units = _units(reader, path)
    if not reader.Transfer(document):
        return {"fault": "it has no shape that Open CASCADE can read", "units": units}
    faces: list[dict[str, Any]] = []
    selected_face = None
    count = bodies = 0
    for number, face, properties in _faces(reader, document):
        bodies = max(bodies, properties.pop("body"))
        names = [name.lower() for name in properties["names"]]
        if request.get("face") not in (None, number):
            continue
        if request.get("name") is not None and str(request["name"]).lower() not in names:
            continue
        if request.get("colour") is not None and str(request["colour"]).lower() != properties["colour"]:
            continue
        count, selected_face = count + 1, face
        if len(faces) < MAX_LISTED_FACES:
            faces.append({"number": number, **properties})
    result = {"units": units, "bodies": bodies, "faces": faces, "count": count}
    return result | {"surface": _surface(selected_face)} if count == 1 else result


def _reader(path: str) -> tuple[Any, Any]:
    """Return a reader of STEP or IGES that keeps names and colours, and an empty document for its shapes."""
    from OCP.IGESCAFControl import IGESCAFControl_Reader
    from OCP.Message import Message
    from OCP.STEPCAFControl import STEPCAFControl_Reader
    from OCP.TCollection import TCollection_ExtendedString
    from OCP.TDocStd import TDocStd_Document

    for printer in list(Message.DefaultMessenger_s().Printers()):
        Message.DefaultMessenger_s().RemovePrinter(printer)  # they would mix with the JSON answer
    is_iges = path.lower().endswith(IGES_SUFFIXES)
    reader = IGESCAFControl_Reader() if is_iges else STEPCAFControl_Reader()
    reader.SetNameMode(True)
    reader.SetColorMode(True)
    return reader, TDocStd_Document(TCollection_ExtendedString("tandem"))


def _units(reader: Any, path: str) -> list[str]:
    """Return the names of the length units that the file states."""
    if path.lower().endswith(IGES_SUFFIXES):
        return [IGES_UNITS.get(reader.IGESModel().GlobalSection().UnitFlag(), "a unit of its own")]
    from OCP.collections import Sequence_TCollection_AsciiString

    lengths, angles, solid_angles = (Sequence_TCollection_AsciiString() for _ in range(3))
    reader.ChangeReader().FileUnits(lengths, angles, solid_angles)
    names = [lengths.Value(k + 1).ToCString() for k in range(lengths.Length())]
    return sorted({name for name in names if name})


def _faces(reader: Any, document: Any) -> Iterator[tuple[int, Any, dict[str, Any]]]:
    """Yield each face with its number from 1, in the order of the shapes in the file, and its properties."""
    from OCP.BRepAdaptor import BRepAdaptor_Surface
    from OCP.collections import Sequence_TDF_Label
    from OCP.TDataStd import TDataStd_Name
    from OCP.TopAbs import TopAbs_FACE, TopAbs_SHELL, TopAbs_SOLID
    from OCP.TopoDS import TopoDS
    from OCP.XCAFDoc import XCAFDoc_DocumentTool

    shapes = XCAFDoc_DocumentTool.ShapeTool_s(document.Main())
    colours = XCAFDoc_DocumentTool.ColorTool_s(document.Main())
    labels: Any = Sequence_TDF_Label()
    shapes.GetFreeShapes(labels)
    number = bodies = 0
    for k in range(labels.Length()):
        label = labels.Value(k + 1)
        label_names = []
        if label.IsAttribute(TDataStd_Name.GetID_s()):  # else FindAttribute crashes
            name = TDataStd_Name()
            label.FindAttribute(TDataStd_Name.GetID_s(), name)
            label_names = [name.Get().ToExtString()]
        root = shapes.GetShape_s(label)
        solids = list(_parts(root, TopAbs_SOLID))
        shells = list(_parts(root, TopAbs_SHELL, TopAbs_SOLID))
        single_faces = list(_parts(root, TopAbs_FACE, TopAbs_SHELL))
        for body in (*solids, *shells, *single_faces):
            bodies += 1
            body_names = [*label_names, *_names(reader, body)]
            for face_shape in _parts(body, TopAbs_FACE):
                number += 1
                face = TopoDS.Face(face_shape)
                names = dict.fromkeys([*_names(reader, face), *body_names])
                kind = str(BRepAdaptor_Surface(face).GetType()).rpartition("_")[2].lower()
                colour = next((c for part in (face, body, root) if (c := _colour(colours, part))), None)
                properties = {
                    "names": [n for n in names if n],
                    "colour": colour,
                    "kind": kind,
                    "body": bodies,
                }
                yield number, face, properties


def _parts(shape: Any, kind: Any, excluded: Any = None) -> Iterator[Any]:
    """Yield parts of a shape of one kind, except those inside a part of the kind ``excluded``."""
    from OCP.TopExp import TopExp_Explorer

    explorer = TopExp_Explorer(shape, kind) if excluded is None else TopExp_Explorer(shape, kind, excluded)
    while explorer.More():
        yield explorer.Current()
        explorer.Next()


def _names(reader: Any, shape: Any) -> list[str]:
    """Return the name of the entity from which a shape was read, as a list that is empty without a name."""
    session = reader.ChangeReader().WS() if hasattr(reader, "ChangeReader") else reader.WS()
    entity = session.TransferReader().EntityFromShapeResult(shape, 1)
    for key in ("Name", "NameValue"):
        if entity is not None and hasattr(entity, key):
            text = getattr(entity, key)()
            name = "" if text is None else text.ToCString().strip()
            return [name] if name and name.upper() != "NONE" else []
    return []


def _colour(colours: Any, shape: Any) -> str | None:
    """Return the colour of a shape as '#rrggbb', None if it has none of its own."""
    from OCP.Quantity import Quantity_Color
    from OCP.XCAFDoc import XCAFDoc_ColorGen, XCAFDoc_ColorSurf

    colour = Quantity_Color()
    for kind in (XCAFDoc_ColorSurf, XCAFDoc_ColorGen):
        if colours.GetColor(shape, kind, colour):
            return str(Quantity_Color.ColorToHex_s(colour).ToCString()).lower()
    return None


def _surface(face: Any) -> dict[str, Any]:
    """Return the face as a B-spline surface between its parameter lines, or its fault.

    The answer has points (u, v) of the edges, the region of u and v, degrees, complete knots, homogeneous
    control points (x w, y w, z w, w) [mm], and whether the normal is reversed.
    """
    from OCP.BRep import BRep_Tool
    from OCP.BRepAdaptor import BRepAdaptor_Curve2d
    from OCP.TopAbs import TopAbs_EDGE, TopAbs_REVERSED, TopAbs_WIRE
    from OCP.TopoDS import TopoDS

    if len(list(_parts(face, TopAbs_WIRE))) != 1:
        return {"fault": "holes"}
    edges = []
    for edge_shape in _parts(face, TopAbs_EDGE):
        curve = BRepAdaptor_Curve2d(TopoDS.Edge(edge_shape), face)
        first, last = curve.FirstParameter(), curve.LastParameter()
        points = [curve.Value(first + k / (EDGE_SAMPLES - 1) * (last - first)) for k in range(EDGE_SAMPLES)]
        edges.append([(point.X(), point.Y()) for point in points])
    if not edges:
        return {"fault": "no edges"}
    surface = BRep_Tool.Surface_s(face)
    region = [[bound(p[k] for edge in edges for p in edge) for bound in (min, max)] for k in (0, 1)]
    try:
        spline = _spline(surface, region)
    except Exception as error:  # Open CASCADE raises many kinds
        return {"fault": f"no B-spline ({type(error).__name__})"}
    return {
        "edges": edges,
        "region": region,
        "degree": [spline.UDegree(), spline.VDegree()],
        "knots": [
            [
                spline.UKnot(k + 1)
                for k in range(spline.NbUKnots())
                for _ in range(spline.UMultiplicity(k + 1))
            ],
            [
                spline.VKnot(k + 1)
                for k in range(spline.NbVKnots())
                for _ in range(spline.VMultiplicity(k + 1))
            ],
        ],
        "control": [
            [_homogeneous(spline, i + 1, j + 1) for j in range(spline.NbVPoles())]
            for i in range(spline.NbUPoles())
        ],
        "reversed": face.Orientation() == TopAbs_REVERSED,
    }


def _spline(surface: Any, region: list[list[float]]) -> Any:
    """Return the region of a surface as a B-spline surface that is not periodic.

    The region has the lower and upper bound of u, then of v. Without a period it is limited to the surface.
    """
    from OCP.Geom import Geom_RectangularTrimmedSurface
    from OCP.GeomConvert import GeomConvert

    (u0, u1), (v0, v1) = region
    low_u, high_u, low_v, high_v = surface.Bounds()
    if not surface.IsUPeriodic():
        u0, u1 = max(u0, low_u), min(u1, high_u)
    if not surface.IsVPeriodic():
        v0, v1 = max(v0, low_v), min(v1, high_v)
    piece = Geom_RectangularTrimmedSurface(surface, u0, u1, v0, v1, True, True)
    spline = GeomConvert.SurfaceToBSplineSurface_s(piece)
    if spline.IsUPeriodic():
        spline.SetUNotPeriodic()
    if spline.IsVPeriodic():
        spline.SetVNotPeriodic()
    return spline


def _homogeneous(spline: Any, i: int, j: int) -> list[float]:
    """Return a control point, counted from 1, as (x w, y w, z w, w)."""
    pole, weight = spline.Pole(i, j), spline.Weight(i, j)
    return [pole.X() * weight, pole.Y() * weight, pole.Z() * weight, weight]


def main() -> None:
    """Answer the request on standard input, and exit without Open CASCADE's clean-up."""
    answer_fd = os.dup(1)
    os.dup2(2, 1)  # keep Open CASCADE's prints out of the answer
    out = answer(json.loads(sys.stdin.read()))
    with os.fdopen(answer_fd, "w") as stream:
        json.dump(out, stream)
    sys.stderr.flush()
    os._exit(0)


if __name__ == "__main__":
    main()
