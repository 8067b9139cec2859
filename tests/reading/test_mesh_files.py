"""GLB and 3MF files as parts: written here, read twice, and refused where they are ambiguous."""

from __future__ import annotations

import io
import json
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest
import trimesh

from planner.geometry import mesh_files
from planner.geometry.mesh_files import read_mesh
from planner.issues import TandemError
from planner.proof.part_files import UnreadError, packed_meshes
from planner.proof.part_files.meshes import mesh_face, read_facets
from planner.reading.part_surfaces import FaceMeshFile, FrontFile, build_faces, build_surface
from planner.service.upload_reader import mesh_size

CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
LINKS = (
    '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships"><Relationship '
    'Target="/3D/m.model" Id="r" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/>'
    "</Relationships>"
)
SHEET = (
    '<mesh><vertices>{}</vertices><triangles><triangle v1="0" v2="1" v3="2"/>'
    '<triangle v1="0" v2="2" v3="3"/></triangles></mesh>'
)
SQUARE = SHEET.format(
    "".join(f'<vertex x="{x}" y="{y}" z="0"/>' for x, y in ((0, 0), (300, 0), (300, 120), (0, 120)))
)


def write_3mf(path: Path, inside: str, unit: str = ' unit="millimeter"', model: str | None = None) -> Path:
    text = model or f'<model xmlns="{CORE}"{unit}>{inside}</model>'
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as pack:
        pack.writestr("_rels/.rels", LINKS)
        pack.writestr("3D/m.model", text)
    return path


def single_object(transform: str = "", kind: str = "") -> str:
    moved = f' transform="{transform}"' if transform else ""
    return (
        f'<resources><object id="1"{kind}>{SQUARE}</object></resources>'
        f'<build><item objectid="1"{moved}/></build>'
    )


def glb(path: Path, **more: object) -> Path:
    """A sheet of 0.3 x 0.12 m in the plane of glTF's x and -z, which is up for y."""
    scene = trimesh.Scene()
    corners = np.array([(0, 0, 0), (0.3, 0, 0), (0.3, 0, -0.12), (0, 0, -0.12)])
    pose = np.eye(4)
    pose[1, 3] = 0.05
    scene.add_geometry(trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False), transform=pose)
    path.write_bytes(scene.export(file_type="glb"))
    if more:
        data = path.read_bytes()
        size = int.from_bytes(data[12:16], "little")
        text = json.dumps(json.loads(data[20 : 20 + size]) | more).encode()
        text += b" " * (-len(text) % 4)
        rest = data[20 + size :]
        path.write_bytes(
            struct.pack("<4sII", b"glTF", 2, 20 + len(text) + len(rest))
            + struct.pack("<I4s", len(text), b"JSON")
            + text
            + rest
        )
    return path


@pytest.mark.parametrize("unit", ["micron", "centimeter", "inch", "foot", "meter", ""])
def test_a_3mf_is_in_its_own_unit(tmp_path: Path, unit: str) -> None:
    metres = {"micron": 1e-6, "centimeter": 0.01, "inch": 0.0254, "foot": 0.3048, "meter": 1.0, "": 1e-3}[
        unit
    ]
    shrunk = 0.3 / (300 * metres)
    pose = f"{shrunk} 0 0 0 {shrunk} 0 0 0 {shrunk} 0 0 0"
    path = write_3mf(tmp_path / "a.3mf", single_object(pose), f' unit="{unit}"' if unit else "")
    mesh = read_mesh(path, None)
    assert np.ptp(mesh.vertices, axis=0) == pytest.approx([0.3, 0.12, 0.0], rel=1e-9)
    again = mesh_face({"file": str(path)})
    assert np.ptp(again.vertices, axis=0) == pytest.approx([0.3, 0.12, 0.0], rel=1e-9)


def test_components_turn_move_and_mirror(tmp_path: Path) -> None:
    text = (
        f'<resources><object id="1">{SQUARE}</object><object id="9" type="support">{SQUARE}</object>'
        '<object id="2"><components>'
        '<component objectid="1" transform="0 1 0 -1 0 0 0 0 1 5 6 7"/>'
        '<component objectid="1" transform="-1 0 0 0 1 0 0 0 1 0 0 90"/><component objectid="9"/>'
        "</components></object></resources>"
        '<build><item objectid="2" transform="1 0 0 0 1 0 0 0 1 0 0 100"/></build>'
    )
    path = write_3mf(tmp_path / "a.3mf", text)
    mesh = read_mesh(path, None)
    assert mesh.vertices.min(axis=0) == pytest.approx([-0.3, 0.0, 0.107])
    assert mesh.vertices.max(axis=0) == pytest.approx([0.005, 0.306, 0.19])
    corners = mesh.vertices[mesh.faces]
    assert (np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] > 0).all()
    again = read_facets(path)
    assert np.sort(again.corners.reshape(-1, 3) * 1e-3, axis=0) == pytest.approx(
        np.sort(corners.reshape(-1, 3), axis=0), abs=1e-12
    )


def test_a_glb_stands_up(tmp_path: Path) -> None:
    path = glb(tmp_path / "a.glb")
    given = FrontFile(mesh=FaceMeshFile(file="a.glb"))
    mesh, normals, (note,) = build_surface(given, tmp_path, "part.front")
    assert mesh.vertices.min(axis=0) == pytest.approx([0, 0, 0.05])
    assert mesh.vertices.max(axis=0) == pytest.approx([0.3, 0.12, 0.05])
    assert (normals[:, 2] > 0.99).all()
    assert "metres" in note.message and "z up" in note.message
    assert mesh_face({"file": str(path)}).vertices.max(axis=0) == pytest.approx([0.3, 0.12, 0.05])
    assert build_faces(given, None, tmp_path).notes[0].code == "mesh.file_unit"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<build/>", "no faces"),
        ('<build><item objectid="4"/></build>', "an object 4 that it names is missing"),
        (single_object(kind=' type="support"'), "no faces"),
        (single_object("1 2 3"), "cannot be read"),
        (
            '<resources><object id="1"><components><component objectid="1"/></components></object>'
            "</resources>"
            '<build><item objectid="1"/></build>',
            "nested too deep",
        ),
        (single_object().replace('v3="3"', 'v3="7"'), "a face names a missing vertex"),
        (single_object().replace('x="300"', 'x="nan"'), "not finite"),
        (single_object("1e-3 0 0 0 1e-3 0 0 0 1e-3 0 0 0"), "export it again"),
    ],
)
def test_bad_3mf_files_are_refused_in_words(tmp_path: Path, text: str, words: str) -> None:
    path = write_3mf(tmp_path / "a.3mf", text)
    with pytest.raises(TandemError, match=words):
        read_mesh(path, None)


@pytest.mark.parametrize(
    ("mesh", "count", "words"),
    [
        ("<mesh><vertices/><triangles/></mesh>", 10, "over 1000 times"),
        (
            SHEET.format("")
            .replace("</triangles>", '<triangle v1="0" v2="1" v3="2"/>' * 600 + "</triangles>")
            .replace("<vertices>", "<vertices>" + '<vertex x="0" y="0" z="0"/>' * 4),
            9,
            "too many facets",
        ),
    ],
)
def test_components_that_multiply_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mesh: str, count: int, words: str
) -> None:
    """A file of a few kilobytes that is placed in itself again and again: it was read for ever, or filled
    the memory with facets of few vertices."""
    for module in (mesh_files, packed_meshes):
        monkeypatch.setattr(module, "_MAX_PLACEMENTS", 1000)
        monkeypatch.setattr(module, "_MAX_TRIANGLES", 100_000)
    part = "".join(
        f'<object id="{k}"><components>{f"""<component objectid="{k - 1}"/>""" * count}</components></object>'
        for k in range(1, 12)
    )
    text = f'<resources><object id="0">{mesh}</object>{part}</resources><build><item objectid="11"/></build>'
    path = write_3mf(tmp_path / "a.3mf", text)
    with pytest.raises(TandemError, match=words):
        read_mesh(path, None)
    with pytest.raises(UnreadError, match="too often"):
        read_facets(path)


def test_damaged_files_are_refused_in_words(tmp_path: Path) -> None:
    whole = write_3mf(tmp_path / "a.3mf", single_object()).read_bytes()
    wrong = {
        "b.3mf": whole[:200],
        "c.3mf": b"solid",
        "d.glb": glb(tmp_path / "whole.glb").read_bytes()[:400],
        "e.glb": b"glTF" + bytes(40),
        "f.glb": b"",
    }
    for name, data in wrong.items():
        (tmp_path / name).write_bytes(data)
        with pytest.raises(TandemError, match=r"cannot be read|no faces") as caught:
            read_mesh(tmp_path / name, None)
        assert caught.value.issues[0].code in ("mesh.unreadable", "mesh.empty")
        with pytest.raises(UnreadError):
            read_facets(tmp_path / name)
    bad = write_3mf(tmp_path / "g.3mf", "", model=f'<model xmlns="{CORE}" unit="parsec"/>')
    with pytest.raises(TandemError, match="parsec"):
        read_mesh(bad, None)
    big = '<!DOCTYPE m [<!ENTITY a "aaaaaaaaaa">' + "".join(
        f'<!ENTITY {chr(98 + k)} "{f"&{chr(97 + k)};" * 10}">' for k in range(9)
    )
    bomb = write_3mf(tmp_path / "h.3mf", "", model=f'{big}]><model xmlns="{CORE}">&j;</model>')
    with pytest.raises(TandemError, match=r"cannot be read|no faces"):
        read_mesh(bomb, None)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"extensionsRequired": ["KHR_draco_mesh_compression"]}, "export it without compression"),
        ({"buffers": [{"uri": "a.bin", "byteLength": 72}]}, "export it as one GLB"),
    ],
)
def test_glb_files_that_are_not_whole_are_refused(
    tmp_path: Path, more: dict[str, object], words: str
) -> None:
    with pytest.raises(TandemError, match=words):
        read_mesh(glb(tmp_path / "a.glb", **more), None)


def test_a_file_without_a_unit_wants_one() -> None:
    with pytest.raises(ValueError, match="is required, as unit: mm"):
        FaceMeshFile(file="a.obj")
    assert FaceMeshFile(file="a.3MF").unit is None


def test_a_service_counts_before_it_reads(tmp_path: Path) -> None:
    assert mesh_size(write_3mf(tmp_path / "a.3mf", single_object()), ".3mf") == (2, 4)
    assert mesh_size(glb(tmp_path / "a.glb"), ".glb") == (2, 4)
    (tmp_path / "b.glb").write_bytes(b"glTF" + bytes(40))
    (tmp_path / "b.3mf").write_bytes(io.BytesIO(b"no").getvalue())
    assert mesh_size(tmp_path / "b.glb", ".glb") == (0, 0)
    assert mesh_size(tmp_path / "b.3mf", ".3mf") == (0, 0)
