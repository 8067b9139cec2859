"""``element.3dm``: the bodies of ``element.obj`` for Rhino, with what is known of each panel."""

from collections.abc import Iterator, Mapping
from typing import Any

from planner.element.element_drawings import row_of
from planner.geometry.mesh_files import objects
from planner.report.markup import PALETTE
from planner.report.rhino_file import Rgb, Shape, rhino


def panels_3dm(data: Mapping[str, Any], bodies: str) -> bytes:
    """The panels of an element (``element.json`` and the text of ``element.obj``) as closed meshes, named by
    their ids, on a layer for each group, or each row or strip where there are none. Raises ``TandemError``
    (``part.extra_missing``) without ``rhino3dm``."""
    return rhino(_shapes(data, bodies))


def _shapes(data: Mapping[str, Any], bodies: str) -> Iterator[Shape]:
    kind = "group" if data.get("grouped") else "row"
    rows = [row_of(str(panel.get("place", panel["id"]))) for panel in data["panels"]]
    colours = {row: _rgb(PALETTE[k % len(PALETTE)]) for k, row in enumerate(sorted(set(rows)))}
    nested = data.get("blocks", {}).get("blocks", ())
    blocks = {part["id"]: block["id"] for block in nested for part in block["panels"]}
    meshes = objects(bodies)
    for panel, row in zip(data["panels"], rows, strict=True):
        name = str(panel["id"])
        text = {
            "id": name,
            kind: row,
            "block": str(blocks.get(name, "")),
            "raw_block_mm": str(panel["raw_block_mm"]),
            "neighbours": " ".join(one or "-" for one in panel["neighbours"]),
        }
        text = {key: value for key, value in text.items() if value}
        mesh = meshes[name]
        yield Shape(f"panels::{kind} {row}", mesh.vertices, mesh.faces, colours[row], name, text)


def _rgb(hexadecimal: str) -> Rgb:
    red, green, blue = (value / 255.0 for value in bytes.fromhex(hexadecimal[1:]))
    return red, green, blue
