"""The thin layer over Open CASCADE (``OCP`` of the extra ``step``): the faces of a STEP or IGES file.

Run as a program of its own (``python -m planner.reading.occt``), with what is asked for as JSON on
standard input; it answers in JSON. So a file that crashes Open CASCADE ends in words, and its memory is
given back. All lengths come out in millimetres, as Open CASCADE converts them. Nothing else of the planner
imports ``OCP``; in its version 8.0 ``TDF_Label.FindAttribute`` and ``XCAFDoc_ShapeTool.Search`` crash where
there is nothing to be found, so that they are not called there.
"""

import json
import os
import sys
from collections.abc import Iterator
from typing import Any, Final

IGES_SUFFIXES: Final = (".igs", ".iges")
"""Files that are read as IGES; others are STEP."""
IGES_UNITS: Final = {1: "inch", 2: "millimetre", 4: "foot", 6: "metre", 10: "centimetre"}
"""Units of IGES files by their flag; one is always stated."""
PLACES: Final = 9
"""Places of an edge at which it is looked at where a face is trimmed, its ends included."""
TOLD: Final = 24
"""Faces that are told of where another number is asked for."""


def answer(asked: dict[str, Any]) -> dict[str, Any]:
    """What a file has of what is asked for (``file``, and ``face``, ``name``, ``colour``).

    ``units``: names of the file's units of length; ``bodies``: how many; ``faces``: number, names, colour and
    kind of those that are meant, `TOLD` at most, and ``count`` of them; ``surface`` where it is one.
    ``fault``: why nothing can be had.
    """
    path = str(asked["file"])
    reader, document = _reader(path)
    from OCP.IFSelect import IFSelect_RetDone

    if reader.ReadFile(path) != IFSelect_RetDone:
        return {"fault": "it is no whole STEP or IGES file"}
    units = _units(reader, path)
    if not reader.Transfer(document):
        return {"fault": "it has nothing that Open CASCADE takes for a shape", "units": units}
    faces, found, chosen, bodies = list[dict[str, Any]](), 0, None, 0
    for number, face, about in _faces(reader, document):
        bodies = max(bodies, about.pop("body"))
        names = [one.lower() for one in about["names"]]
        if asked.get("face") not in (None, number):
            continue
        if asked.get("name") is not None and str(asked["name"]).lower() not in names:
            continue
        if asked.get("colour") is not None and str(asked["colour"]).lower() != about["colour"]:
            continue
        found, chosen = found + 1, face
        if len(faces) < TOLD:
            faces.append({"number": number, **about})
    out = {"units": units, "bodies": bodies, "faces": faces, "count": found}
    return out | {"surface": _surface(chosen)} if found == 1 else out


def _reader(path: str) -> tuple[Any, Any]:
    from OCP.IGESCAFControl import IGESCAFControl_Reader
    from OCP.Message import Message
    from OCP.STEPCAFControl import STEPCAFControl_Reader
    from OCP.TCollection import TCollection_ExtendedString
    from OCP.TDocStd import TDocStd_Document

    for printer in list(Message.DefaultMessenger_s().Printers()):
        Message.DefaultMessenger_s().RemovePrinter(printer)  # they would write between the lines of JSON
    iges = path.lower().endswith(IGES_SUFFIXES)
    reader = IGESCAFControl_Reader() if iges else STEPCAFControl_Reader()
    reader.SetNameMode(True)
    reader.SetColorMode(True)
    return reader, TDocStd_Document(TCollection_ExtendedString("tandem"))


def _units(reader: Any, path: str) -> list[str]:
    if path.lower().endswith(IGES_SUFFIXES):
        return [IGES_UNITS.get(reader.IGESModel().GlobalSection().UnitFlag(), "a unit of its own")]
    from OCP.collections import Sequence_TCollection_AsciiString

    lengths, angles, solid = (Sequence_TCollection_AsciiString() for _ in range(3))
    reader.ChangeReader().FileUnits(lengths, angles, solid)
    names = [lengths.Value(k + 1).ToCString() for k in range(lengths.Length())]
    return sorted({name for name in names if name})


def _faces(reader: Any, document: Any) -> Iterator[tuple[int, Any, dict[str, Any]]]:
    """Each face with its number from 1, in the order of the file's shapes, and what is known about it."""
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
        own = []
        if label.IsAttribute(TDataStd_Name.GetID_s()):  # else FindAttribute crashes
            name = TDataStd_Name()
            label.FindAttribute(TDataStd_Name.GetID_s(), name)
            own = [name.Get().ToExtString()]
        root = shapes.GetShape_s(label)
        solids = list(_parts(root, TopAbs_SOLID))
        loose = list(_parts(root, TopAbs_SHELL, TopAbs_SOLID))
        single = list(_parts(root, TopAbs_FACE, TopAbs_SHELL))
        for body in (*solids, *loose, *single):
            bodies += 1
            within = [*own, *_name(reader, body)]
            for one in _parts(body, TopAbs_FACE):
                number += 1
                face = TopoDS.Face(one)
                names = dict.fromkeys([*_name(reader, face), *within])
                kind = str(BRepAdaptor_Surface(face).GetType()).rpartition("_")[2].lower()
                colour = next((c for part in (face, body, root) if (c := _colour(colours, part))), None)
                about = {"names": [n for n in names if n], "colour": colour, "kind": kind, "body": bodies}
                yield number, face, about


def _parts(shape: Any, kind: Any, outside: Any = None) -> Iterator[Any]:
    """Parts of one kind, those within ``outside`` left out."""
    from OCP.TopExp import TopExp_Explorer

    walk = TopExp_Explorer(shape, kind) if outside is None else TopExp_Explorer(shape, kind, outside)
    while walk.More():
        yield walk.Current()
        walk.Next()


def _name(reader: Any, shape: Any) -> list[str]:
    session = reader.ChangeReader().WS() if hasattr(reader, "ChangeReader") else reader.WS()
    entity = session.TransferReader().EntityFromShapeResult(shape, 1)
    for key in ("Name", "NameValue"):
        if entity is not None and hasattr(entity, key):
            text = getattr(entity, key)()
            name = "" if text is None else text.ToCString().strip()
            return [name] if name and name.upper() != "NONE" else []
    return []


def _colour(colours: Any, shape: Any) -> str | None:
    from OCP.Quantity import Quantity_Color
    from OCP.XCAFDoc import XCAFDoc_ColorGen, XCAFDoc_ColorSurf

    found = Quantity_Color()
    for kind in (XCAFDoc_ColorSurf, XCAFDoc_ColorGen):
        if colours.GetColor(shape, kind, found):
            return str(Quantity_Color.ColorToHex_s(found).ToCString()).lower()
    return None


def _surface(face: Any) -> dict[str, Any]:
    """The face as a B-spline surface between its own lines: degrees, knots, control points (x, y, z, weight)
    [mm]; whether its normal is turned; or the fault that it has."""
    from OCP.BRep import BRep_Tool
    from OCP.BRepAdaptor import BRepAdaptor_Curve2d
    from OCP.TopAbs import TopAbs_EDGE, TopAbs_REVERSED, TopAbs_WIRE
    from OCP.TopoDS import TopoDS

    if len(list(_parts(face, TopAbs_WIRE))) != 1:
        return {"fault": "holes"}
    edges = []
    for one in _parts(face, TopAbs_EDGE):
        curve = BRepAdaptor_Curve2d(TopoDS.Edge(one), face)
        first, last = curve.FirstParameter(), curve.LastParameter()
        at = [curve.Value(first + k / (PLACES - 1) * (last - first)) for k in range(PLACES)]
        edges.append([(point.X(), point.Y()) for point in at])
    if not edges:
        return {"fault": "no edges"}
    surface = BRep_Tool.Surface_s(face)
    region = [[f(p[k] for edge in edges for p in edge) for f in (min, max)] for k in (0, 1)]
    try:
        made = _spline(surface, region)
    except Exception as error:  # Open CASCADE's own kinds, which are many
        return {"fault": f"no B-spline ({type(error).__name__})"}
    return {
        "edges": edges,
        "region": region,
        "degree": [made.UDegree(), made.VDegree()],
        "knots": [
            [made.UKnot(k + 1) for k in range(made.NbUKnots()) for _ in range(made.UMultiplicity(k + 1))],
            [made.VKnot(k + 1) for k in range(made.NbVKnots()) for _ in range(made.VMultiplicity(k + 1))],
        ],
        "control": [
            [_homogeneous(made, i + 1, j + 1) for j in range(made.NbVPoles())] for i in range(made.NbUPoles())
        ],
        "reversed": face.Orientation() == TopAbs_REVERSED,
    }


def _spline(surface: Any, region: list[list[float]]) -> Any:
    from OCP.Geom import Geom_RectangularTrimmedSurface
    from OCP.GeomConvert import GeomConvert

    (u0, u1), (v0, v1) = region
    low_u, high_u, low_v, high_v = surface.Bounds()
    if not surface.IsUPeriodic():
        u0, u1 = max(u0, low_u), min(u1, high_u)
    if not surface.IsVPeriodic():
        v0, v1 = max(v0, low_v), min(v1, high_v)
    piece = Geom_RectangularTrimmedSurface(surface, u0, u1, v0, v1, True, True)
    made = GeomConvert.SurfaceToBSplineSurface_s(piece)
    if made.IsUPeriodic():
        made.SetUNotPeriodic()
    if made.IsVPeriodic():
        made.SetVNotPeriodic()
    return made


def _homogeneous(made: Any, i: int, j: int) -> list[float]:
    pole, weight = made.Pole(i, j), made.Weight(i, j)
    return [pole.X() * weight, pole.Y() * weight, pole.Z() * weight, weight]


def main() -> None:
    """Answers what standard input asks for, and ends without Open CASCADE's own clearing up."""
    told = os.dup(1)
    os.dup2(2, 1)  # what Open CASCADE prints is no answer
    out = answer(json.loads(sys.stdin.read()))
    with os.fdopen(told, "w") as stream:
        json.dump(out, stream)
    sys.stderr.flush()
    os._exit(0)


if __name__ == "__main__":
    main()
