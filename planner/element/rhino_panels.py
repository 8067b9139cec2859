"""``element.3dm``: the bodies of ``element.obj`` for Rhino, with the properties of each panel."""

from collections.abc import Iterator, Mapping
from typing import Any

from planner.element.element_drawings import id_letters
from planner.geometry.mesh_files import obj_objects
from planner.report.markup import PALETTE
from planner.report.rhino_file import Rgb, RhinoMesh, rhino_bytes


def panels_3dm(data: Mapping[str, Any], bodies: str) -> bytes:
    """Return the content of a 3DM file with the panels of an element as closed meshes.

    Meshes are named by the ids of panels. Each group has a layer, or each row or strip if there are no
    groups.

    Args:
        data: Content of ``element.json``.
        bodies: Text of ``element.obj``.

    Raises:
        TandemError: ``part.extra_missing`` without ``rhino3dm``.
    """
    return rhino_bytes(_shapes(data, bodies))


def _shapes(data: Mapping[str, Any], bodies: str) -> Iterator[RhinoMesh]:
    """Yield the mesh of each panel with its layer, colour and properties."""
    kind = "group" if data.get("grouped") else "row"
    rows = [id_letters(str(panel.get("place", panel["id"]))) for panel in data["panels"]]
    colours = {row: _rgb(PALETTE[k % len(PALETTE)]) for k, row in enumerate(sorted(set(rows)))}
    nested = data.get("blocks", {}).get("blocks", ())
    blocks = {part["id"]: block["id"] for block in nested for part in block["panels"]}
    meshes = obj_objects(bodies)
    for panel, row in zip(data["panels"], rows, strict=True):
        name = str(panel["id"])
        properties = {
            "id": name,
            kind: row,
            "block": str(blocks.get(name, "")),
            "raw_block_mm": str(panel["raw_block_mm"]),
            "neighbours": " ".join(neighbour or "-" for neighbour in panel["neighbours"]),
        }
        properties = {key: value for key, value in properties.items() if value}
        mesh = meshes[name]
        yield RhinoMesh(f"panels::{kind} {row}", mesh.vertices, mesh.faces, colours[row], name, properties)


def _rgb(hexadecimal: str) -> Rgb:
    red, green, blue = (value / 255.0 for value in bytes.fromhex(hexadecimal[1:]))
    return red, green, blue
