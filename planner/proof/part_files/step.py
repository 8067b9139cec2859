"""Ruled faces and faces of STEP and IGES files, read a second time.

Open CASCADE parses the file once more, in a process of its own (``python -m planner.proof.part_files.step``);
its own points of the face's surface are taken here, not the B-splines that it makes of it, between the
parameters that it finds for the face.
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
from planner.proof.part_files import UNITS, Said, UnreadError, file_of
from planner.proof.part_files.curves import Ruled
from planner.proof.part_files.meshes import Face, gridded, rulings

_IGES: Final = (".igs", ".iges")
_LONGEST: Final = 300.0
"""Seconds after which a file is given up."""


def ruled_face(said: Said) -> Ruled:
    """The rulings of a ruled face, its normal tangent x ruling, the first one again at the end of a closed
    one. Raises `UnreadError`."""
    found = _asked(said, "rulings")
    return Ruled(found["start"], found["end"])


def face(said: Said) -> Face:
    """A face on a grid of exact places. Raises `UnreadError`."""
    found = _asked(said, "face")
    return Face(found["vertices"], found["up"], found["faces"], found["number"])


def _asked(said: Said, want: str) -> dict[str, Any]:
    """Arrays that the other process finds."""
    path = file_of(said)
    path.stat()
    keys = ("face", "name", "colour", "rulings", "flip")
    asked = {"file": str(path.absolute()), "want": want, "size": _metres(said)} | {
        key: said.get(key) for key in keys
    }
    try:
        done = subprocess.run(
            [sys.executable, "-m", "planner.proof.part_files.step"],
            input=json.dumps(asked).encode(),
            capture_output=True,
            timeout=_LONGEST,
            check=False,
            cwd=Path(__file__).parents[3],  # where modules are looked for first: not where the user is
        )
    except subprocess.TimeoutExpired as error:
        raise UnreadError(f"it takes more than {_LONGEST:g} s") from error
    if done.returncode != 0:
        last = (done.stderr.decode(errors="replace").strip().splitlines() or ["Open CASCADE crashed"])[-1]
        raise UnreadError(last.removeprefix("planner.proof.part_files.UnreadError: ")[:160])
    with np.load(io.BytesIO(done.stdout)) as arrays:
        return dict(arrays)


def _metres(said: Said) -> float:
    """What Open CASCADE gives as one: a millimetre, where the file says what its lengths are in."""
    path = file_of(said)
    text = path.read_bytes().decode("latin-1")
    if path.suffix.lower() in _IGES or re.search(r"\bLENGTH_UNIT\s*\(", text):
        return 1 / 1000
    if said.get("unit") is None:
        raise UnreadError("it says no unit of length")
    return UNITS[str(said["unit"])]


def _arrays(asked: dict[str, Any]) -> dict[str, Any]:
    from OCP.BRep import BRep_Tool
    from OCP.BRepTools import BRepTools
    from OCP.GeomAdaptor import GeomAdaptor_Surface
    from OCP.TopAbs import TopAbs_REVERSED

    one = _face_of(asked)
    u0, u1, v0, v1 = BRepTools.UVBounds_s(one)
    surface = GeomAdaptor_Surface(BRep_Tool.Surface_s(one))
    size = float(asked["size"])

    def at(u: FloatArray, v: FloatArray) -> FloatArray:
        points = (surface.Value(float(a), float(b)) for a, b in zip(u, v, strict=True))
        return size * np.array([(p.X(), p.Y(), p.Z()) for p in points])

    region = (float(u0), float(u1)), (float(v0), float(v1))
    turned = one.Orientation() == TopAbs_REVERSED
    kinks = _kinks(surface)
    if asked["want"] == "face":
        found = gridded(at, *region, turned != bool(asked["flip"]), kinks)
        return {"vertices": found.vertices, "up": found.up, "faces": found.faces, "number": found.number}
    along, start, end = rulings(at, region, kinks, asked["rulings"])
    # along u, dS/dv x ruling is against dS/du x dS/dv
    order = slice(None, None, -1) if (along == 0) != turned else slice(None)
    return {"start": start[order], "end": end[order]}


def _kinks(surface: Any) -> tuple[FloatArray, FloatArray]:
    """Knots along u and v of a surface that has them."""
    from OCP.GeomAbs import GeomAbs_BSplineSurface

    if surface.GetType() != GeomAbs_BSplineSurface:
        return np.zeros(0), np.zeros(0)
    own = surface.BSpline()
    along = np.array([own.UKnot(k + 1) for k in range(own.NbUKnots())])
    return along, np.array([own.VKnot(k + 1) for k in range(own.NbVKnots())])


def _face_of(asked: dict[str, Any]) -> Any:
    """The one face of all in the file, counted body by body, that is asked for."""
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

    iges = str(asked["file"]).lower().endswith(_IGES)
    reader: Any = IGESCAFControl_Reader() if iges else STEPCAFControl_Reader()
    reader.SetColorMode(True)
    reader.SetNameMode(True)
    document = TDocStd_Document(TCollection_ExtendedString("proof"))
    reader.ReadFile(str(asked["file"]))
    if not reader.Transfer(document):
        raise UnreadError("it has no shapes")
    transfer = (reader if iges else reader.ChangeReader()).WS().TransferReader()
    tones = XCAFDoc_DocumentTool.ColorTool_s(document.Main())

    def inside(shape: Any, *kinds: Any) -> list[Any]:
        found, walk = [], TopExp_Explorer(shape, *kinds)
        while walk.More():
            found.append(walk.Current())
            walk.Next()
        return found

    def called(shape: Any) -> str:
        entity = transfer.EntityFromShapeResult(shape, 1)
        said = getattr(entity, "NameValue" if iges else "Name", lambda: None)()
        return "" if said is None else str(said.ToCString()).strip()

    def shown(shape: Any) -> str:
        tone = Quantity_Color()
        if tones.GetColor(shape, XCAFDoc_ColorSurf, tone) or tones.GetColor(shape, XCAFDoc_ColorGen, tone):
            return str(Quantity_Color.ColorToHex_s(tone).ToCString())
        return ""

    labels: Any = Sequence_TDF_Label()
    XCAFDoc_DocumentTool.ShapeTool_s(document.Main()).GetFreeShapes(labels)
    number, meant = 0, []
    for k in range(1, labels.Length() + 1):
        label, product = labels.Value(k), ""
        if label.IsAttribute(TDataStd_Name.GetID_s()):
            title = TDataStd_Name()
            label.FindAttribute(TDataStd_Name.GetID_s(), title)
            product = title.Get().ToExtString()
        root = XCAFDoc_DocumentTool.ShapeTool_s(document.Main()).GetShape_s(label)
        bodies = [*inside(root, TopAbs_SOLID), *inside(root, TopAbs_SHELL, TopAbs_SOLID)]
        for body in [*bodies, *inside(root, TopAbs_FACE, TopAbs_SHELL)]:
            for own in inside(body, TopAbs_FACE):
                number += 1
                names: set[Any] = {product.lower(), called(body).lower(), called(own).lower()}
                colour = shown(own) or shown(body) or shown(root)
                told = {"face": {number}, "name": names, "colour": {colour.lower()}}
                wanted = {key: asked[key] for key in told if asked[key] is not None}
                if all((w if key == "face" else str(w).lower()) in told[key] for key, w in wanted.items()):
                    meant.append(own)
    if len(meant) != 1:
        raise UnreadError(f"it has {len(meant)} faces of what is asked for")
    return TopoDS.Face(meant[0])


def _main() -> None:
    answer = os.dup(1)
    os.dup2(2, 1)  # what Open CASCADE prints is no answer
    data = io.BytesIO()
    np.savez(data, **_arrays(json.loads(sys.stdin.read())))
    with os.fdopen(answer, "wb") as stream:
        stream.write(data.getvalue())
    sys.stderr.flush()
    os._exit(0)  # without Open CASCADE's own clearing up


if __name__ == "__main__":
    _main()
