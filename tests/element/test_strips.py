"""Free-form surfaces in ruled strips: the written files, measured by independent test code.

They are compared with the surface and with each other, for surfaces of all kinds. Also what is refused, and
that the advice helps.
"""

from __future__ import annotations

import csv
import itertools
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rhino3dm
import trimesh
import yaml

from planner import pipeline
from planner.element import element_file, element_page, labels, run_report, strips, wall_files
from planner.geometry.mesh import TriangleMesh
from planner.issues import Issue, TandemError
from tests.element.test_walls import SIDES, WrittenWallPanel, read_panels
from tests.element.walls import ROOT, expect_refusal, write_obj
from tests.rhino_files import Model

THICK = 30.0
LONG, WIDE = 0.4, 0.3


def sheet(height: Any, step: float = 0.02, long: float = LONG, wide: float = WIDE) -> TriangleMesh:
    """A height [m] over ``long`` x ``wide`` [m] in facets of ``step`` [m], seen from above."""
    x, y = np.meshgrid(
        np.linspace(0, long, round(long / step) + 1),
        np.linspace(0, wide, round(wide / step) + 1),
        indexing="ij",
    )
    i = np.arange(x.size).reshape(x.shape)
    a, b, c, d = (part.ravel() for part in (i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return TriangleMesh(np.stack([x, y, height(x, y) + 0 * x], axis=-1).reshape(-1, 3), faces)


def wave(x: Any, y: Any) -> Any:
    return 0.025 * np.sin(5.0 * x + 2.0 * y) + 0.015 * np.cos(6.0 * y - 2.0 * x)


def write_element(folder: Path, mesh: TriangleMesh, strip_fields: Any = None, **changes: Any) -> Path:
    """An element file of a mesh in strips, with ``changes``."""
    folder.mkdir(parents=True, exist_ok=True)
    write_obj(folder / "sheet.obj", mesh)
    template = yaml.safe_load((ROOT / "problems" / "strips" / "panel.yaml").read_text())
    template["cell"] = str(ROOT / "problems" / "cells" / "irb4600_bow.yaml")
    (folder / "panel.yaml").write_text(yaml.safe_dump(template))
    data = {
        "element": 1,
        "name": "small",
        "surface": {"mesh": {"file": "sheet.obj", "unit": "mm"}},
        "thickness_mm": THICK,
        "panels": {"strips": {"tolerance_mm": 1.0, **(strip_fields or {})}},
        "blocks": [{"size_mm": [280, 200, 80], "foam": "eps_a120"}],
        "jobs": [{"problem": "panel.yaml"}],
    }
    path = folder / "element.yaml"
    path.write_text(yaml.safe_dump({**data, **changes}))
    return path


def read_element(path: Path) -> element_file.StripsElement:
    result = element_file.read_element(path)
    assert isinstance(result, element_file.StripsElement)
    return result


def divide(path: Path) -> dict[str, str]:
    """The files of an element by their names."""
    element = read_element(path)
    return wall_files.strips_folder(element, strips.divide_strips(element))[0]


def refusal(path: Path) -> Issue:
    """The one issue that an element is refused with."""
    return expect_refusal(lambda: strips.divide_strips(read_element(path)))


@pytest.fixture(scope="module")
def waves(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    return divide(write_element(tmp_path_factory.mktemp("waves"), sheet(wave)))


def top_and_bottom(panel: WrittenWallPanel) -> tuple[np.ndarray, np.ndarray]:
    """Ends (2, n, 3) [mm] of the rulings of the front between the panel's sides, and of its back: its outline
    goes along one line of the strip and back along the other."""
    part = panel.part()
    result = []
    for ring in (part[len(part) // 2 :], part[: len(part) // 2]):
        item, other = ring[: len(ring) // 2], ring[len(ring) // 2 :][::-1]
        result.append(np.stack([item, other]))
    return result[0], result[1]


def facets(ends: np.ndarray, rows: int = 12) -> trimesh.Trimesh:
    """A fine mesh of the ruled surface between two lines (2, n, 3)."""
    fraction = np.linspace(0, 1, rows + 1)[:, None, None]
    at = (1 - fraction) * ends[0] + fraction * ends[1]
    i = np.arange(at.shape[0] * at.shape[1]).reshape(at.shape[:2])
    a, b, c, d = (part.ravel() for part in (i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return trimesh.Trimesh(at.reshape(-1, 3), faces, process=False)


def measure_deviations(panels: dict[str, WrittenWallPanel], mesh: TriangleMesh) -> dict[str, float]:
    """Return the distances [mm] of fronts from the mesh by trimesh, and of the mesh from the fronts."""
    given = trimesh.Trimesh(1e3 * mesh.vertices, mesh.faces, process=False)
    fronts = {name: facets(top_and_bottom(panel)[0]) for name, panel in panels.items()}
    back = np.array([trimesh.proximity.closest_point(own, given.vertices)[1] for own in fronts.values()])
    nearest = np.argmin(back, axis=0)
    return {
        name: max(
            float(trimesh.proximity.closest_point(given, own.vertices)[1].max()),
            float(back[k, nearest == k].max(initial=0.0)),
        )
        for k, (name, own) in enumerate(fronts.items())
    }


def test_fronts_are_as_near_to_the_surface_as_their_rows_say(waves: dict[str, str]) -> None:
    panels = read_panels(waves)
    assert len(panels) > 3
    for name, off in measure_deviations(panels, sheet(wave)).items():
        assert off <= 1.0 + 1e-3
        assert off == pytest.approx(panels[name].row["off_surface_mm"], rel=0.1, abs=0.05)


def test_neighbours_are_cut_along_the_same_lines_but_on_the_rim(waves: dict[str, str]) -> None:
    """As written, and to a millionth of a millimetre."""
    panels = read_panels(waves)
    for name, panel in panels.items():
        own = panel.sides()
        shared = np.zeros(own.shape[1], dtype=bool)
        for other in {neighbour for neighbour in panel.row["neighbours"] if neighbour is not None}:
            assert name in panels[other].row["neighbours"]
            gaps = np.abs(own[:, :, None] - panels[other].sides()[:, None]).max(axis=(0, 3)).min(axis=1)
            assert (gaps < 1e-6).sum() >= 2
            shared |= gaps < 1e-6
        middle = own[:, ~shared].mean(axis=0)[:, :2]
        rim = np.minimum(np.abs(middle), np.abs(middle - 1e3 * np.array([LONG, WIDE]))).min(axis=1)
        assert (rim < 0.5 * THICK).all()
        assert shared.sum() >= 4


def test_backs_are_one_thickness_behind_up_to_the_lines_that_neighbours_share(waves: dict[str, str]) -> None:
    for panel in read_panels(waves).values():
        front, back = top_and_bottom(panel)
        way = np.gradient(front, axis=1)
        normal = np.cross(way, front[1] - front[0])
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        deep = ((front - back) * normal).sum(axis=-1)
        np.testing.assert_allclose(deep[:, 1:-1], THICK, atol=0.1)
        np.testing.assert_allclose(deep[:, [0, -1]], THICK, atol=0.5)
        assert (np.linalg.norm(front - back, axis=-1) < 1.01 * THICK).all()


def test_kinks_are_the_angles_between_neighbours_along_their_joint(waves: dict[str, str]) -> None:
    panels = read_panels(waves)
    fronts = {name: top_and_bottom(panel)[0] for name, panel in panels.items()}
    looked = 0
    for name, panel in panels.items():
        for other, kink in zip(panel.row["neighbours"], panel.row["kinks_deg"], strict=True):
            if other is None:
                assert kink is None
                continue
            if panel.row["place"][0] == panels[other].row["place"][0]:
                assert kink == 0.0
                continue
            # the line that is the end of one and the start of the other
            item, two = (fronts[n] for n in sorted((name, other), key=lambda n: str(panels[n].row["place"])))
            same = np.linalg.norm(item[1][:, None] - two[0], axis=-1) < 1e-3
            i, k = np.nonzero(same)
            normals = []
            for ends, at, end in ((item, i, 1), (two, k, 0)):
                way = np.gradient(ends[end], axis=0)[at]
                normal = np.cross(way, (ends[1] - ends[0])[at])
                normals.append(normal / np.linalg.norm(normal, axis=1, keepdims=True))
            angle = np.degrees(np.arccos(np.clip((normals[0] * normals[1]).sum(axis=1), -1, 1)))
            assert angle.max() == pytest.approx(kink, abs=0.25)
            looked += 1
    assert looked > 2
    rows = list(csv.DictReader(waves["panels.csv"].splitlines()))
    for row in rows:
        own = [kink for kink in panels[row["id"]].row["kinks_deg"] if kink is not None]
        assert float(row["kink_deg"]) == max(own)


def test_panels_fit_their_blocks_and_are_ordinary_problems(waves: dict[str, str], tmp_path: Path) -> None:
    for name, panel in read_panels(waves).items():
        local = panel.local(panel.part())
        assert (0.5 * panel.block[:2] - np.abs(local[:, :2]).max(axis=0) >= 4.0 - 0.06).all()
        assert local[:, 2].min() >= 4.0 - 1e-3
        assert local[:, 2].max() <= 76.0 + 1e-3
        assert panel.block[0] <= 200.0
        assert panel.block[1] <= 280.0
        (tmp_path / f"{name}.yaml").write_text(waves[f"panels/{name}.yaml"])
        problem = pipeline.load(tmp_path / f"{name}.yaml")
        assert problem.part is not None
        assert [item.name for item in problem.part.ruled] == ["front", "back", *SIDES]


def test_page_and_labels_have_all_panels_and_the_better_parameter_is_told(waves: dict[str, str]) -> None:
    data = json.loads(waves["element.json"])
    page, sheets = element_page.element_page(run_report.unplanned_run(data)), labels.label_sheets(data)
    assert "Angle between neighbours" in page
    assert "Deviation from the surface" in page
    assert "ruled strips" in page
    tried = data["strips"]["tried"]
    assert set(tried) == {"u", "v"}
    assert tried[data["strips"]["across"]]["panels"] == len(data["panels"])
    assert len(data["panels"]) == min(item["panels"] for item in tried.values())
    for panel in data["panels"]:
        assert panel["id"] in sheets
        assert f">{panel['id']}<" in waves["panels.svg"]


def test_panels_are_laid_out_as_seen_from_the_front(waves: dict[str, str]) -> None:
    """Of the surface over its x and y: two neighbours follow each other the same way round."""
    panels = read_panels(waves)
    looked = 0
    for panel in panels.values():
        around = sorted({item for item in panel.row["neighbours"] if item is not None})
        for item, other in itertools.pairwise(around):
            own = [panel, panels[item], panels[other]]
            laid = [np.mean(p.row["outline_mm"], axis=0) for p in own]
            real = [p.part().mean(axis=0)[:2] for p in own]
            turns = [np.linalg.det([p[1] - p[0], p[2] - p[0]]) for p in (laid, real)]
            if abs(turns[0]) > 2e3:  # mm2: they do not lie on one line
                assert np.sign(turns[0]) == np.sign(turns[1])
                looked += 1
    assert looked > 1


@pytest.mark.long
def test_the_same_file_gives_the_same_bytes_and_a_billionth_moves_no_id(
    tmp_path: Path, waves: dict[str, str]
) -> None:
    assert divide(write_element(tmp_path / "again", sheet(wave))) == waves
    moved = divide(write_element(tmp_path / "moved", sheet(lambda x, y: wave(x, y) + 1e-9 * np.sin(40 * x))))
    ids = [
        [(r["id"], r["place"]) for r in csv.DictReader(f["panels.csv"].splitlines())] for f in (waves, moved)
    ]
    assert ids[0] == ids[1]


def test_strips_are_the_fewest_that_the_sagitta_and_the_block_allow(tmp_path: Path) -> None:
    """Of z = k x^2: across x each is off by k w^2 / 4, across y all are exact and as wide as blocks."""
    k, tolerance = 0.8, 1.2e-3
    path = write_element(tmp_path, sheet(lambda x, y: k * x * x, 0.01), {"tolerance_mm": 1e3 * tolerance})
    result = strips.divide_strips(read_element(path))
    counts = sorted(strips for strips, _ in result.tried.values())
    widest = 2.0 * np.sqrt(tolerance / k)
    # the facets themselves are k h^2 / 4 off, lines lie 10 mm apart and take a part of what is allowed
    assert int(np.ceil(LONG / widest)) <= counts[1] <= int(np.ceil(LONG / (widest - 0.011)))
    assert counts[0] == int(np.ceil(WIDE / (0.200 - 0.008)))


def dome(x: Any, y: Any) -> Any:
    return np.sqrt(0.8**2 - (x - 0.25) ** 2 - (y - 0.2) ** 2)


def zone() -> TriangleMesh:
    """A piece of a sphere between two heights, 56 degrees round."""
    flat = sheet(lambda x, y: 0.0)
    round_it, up = np.radians(140.0 * flat.vertices[:, 0]), 1.5 * flat.vertices[:, 1] + 0.2
    at = [np.cos(up) * np.cos(round_it), np.cos(up) * np.sin(round_it), np.sin(up)]
    return TriangleMesh(0.9 * np.stack(at, axis=1), flat.faces)


def noisy() -> TriangleMesh:
    mesh = sheet(wave)
    shift = np.random.default_rng(2).uniform(-1e-4, 1e-4, len(mesh.vertices))
    return TriangleMesh(mesh.vertices + shift[:, None] * [0.0, 0.0, 1.0], mesh.faces)


SURFACES = {
    "dome": sheet(dome),
    "zone": zone(),
    "saddle": sheet(lambda x, y: 0.5 * ((x - 0.25) ** 2 - (y - 0.2) ** 2)),
    "noise": noisy(),
    "plate": sheet(lambda x, y: 0.0),
}


@pytest.mark.sampled(every=2)
@pytest.mark.parametrize("name", list(SURFACES))
def test_other_surfaces_are_divided_within_the_tolerance(name: str, tmp_path: Path) -> None:
    mesh = SURFACES[name]
    panels = read_panels(divide(write_element(tmp_path, mesh)))
    deviation = measure_deviations(panels, mesh)
    assert max(deviation.values()) <= 1.0 + 1e-3
    kinks = [kink for panel in panels.values() for kink in panel.row["kinks_deg"] if kink is not None]
    if name == "plate":
        assert max(deviation.values()) < 0.1
        assert max(kinks) < 0.1
    if name == "noise":  # no ruling leans by the noise of the facets
        for panel in panels.values():
            ends = top_and_bottom(panel)[0]
            way = np.diff(ends, axis=1)
            way /= np.linalg.norm(way, axis=-1, keepdims=True)
            turns = np.degrees(np.linalg.norm(np.diff(way, axis=1), axis=-1))
            assert turns.max() < 5.0


def test_inches_are_as_good_and_mirrored_normals_are_thick_to_the_other_side(
    tmp_path: Path, waves: dict[str, str]
) -> None:
    mesh = sheet(wave)
    small = TriangleMesh(mesh.vertices / 25.4, mesh.faces)
    surface = {"mesh": {"file": "sheet.obj", "unit": "in"}}
    inches = read_panels(divide(write_element(tmp_path / "inches", small, surface=surface)))
    assert list(inches) == list(read_panels(waves))
    over = TriangleMesh(mesh.vertices, mesh.faces[:, ::-1])
    mirrored = read_panels(divide(write_element(tmp_path / "over", over)))
    for found, side in ((inches, 1.0), (mirrored, -1.0)):
        for panel in found.values():
            front, back = top_and_bottom(panel)
            assert np.sign((front - back)[..., 2].mean()) == side


@pytest.mark.long
def test_a_surface_that_strips_cannot_follow_is_refused_with_the_tolerance_and_the_count_that_do(
    tmp_path: Path,
) -> None:
    issue = refusal(write_element(tmp_path, noisy(), {"tolerance_mm": 0.05}))
    assert issue.code == "element.tolerance"
    match = re.search(r"tolerance_mm: ([\d.]+) would .*with (\d+) panels in (\d+) strips", str(issue.hint))
    assert match is not None
    made = strips.divide_strips(
        read_element(write_element(tmp_path, noisy(), {"tolerance_mm": float(match[1])}))
    )
    assert (len(made.panels), len(made.cuts) - 1) == (int(match[2]), int(match[3]))


def test_blocks_too_thin_are_refused_with_the_thickness_and_the_count_that_fit(tmp_path: Path) -> None:
    blocks = [{"size_mm": [320, 200, 39], "foam": "eps_a120"}]
    issue = refusal(write_element(tmp_path, sheet(wave), blocks=blocks))
    assert issue.code == "element.block"
    match = re.search(r"thickness_mm: (\d+) would fit, with (\d+) panels", str(issue.hint))
    assert match is not None
    thinner = {"blocks": blocks, "thickness_mm": float(match[1])}
    assert len(
        strips.divide_strips(read_element(write_element(tmp_path, sheet(wave), **thinner))).panels
    ) == int(match[2])


def test_a_back_that_would_fold_over_is_refused_with_the_thickness_that_does_not(tmp_path: Path) -> None:
    """Behind a sphere of 120 mm."""
    round_it = sheet(lambda x, y: np.sqrt(0.12**2 - (x - 0.08) ** 2), 0.01, 0.16, 0.2)
    blocks = [{"size_mm": [600, 600, 400], "foam": "eps_a120"}]
    issue = refusal(write_element(tmp_path, round_it, thickness_mm=130, blocks=blocks))
    assert issue.code == "element.shape"
    assert issue.limit == pytest.approx(120.0, rel=0.1)
    match = re.search(r"thickness_mm: (\d+)", str(issue.hint))
    assert match is not None
    changes = {"thickness_mm": float(match[1]), "blocks": blocks}
    assert strips.divide_strips(read_element(write_element(tmp_path, round_it, **changes)))


def test_surfaces_without_four_sides_are_refused(tmp_path: Path) -> None:
    mesh = sheet(wave)
    for name, own, expected_text in (
        ("hole", TriangleMesh(mesh.vertices, np.delete(mesh.faces, [110, 410], axis=0)), "close its holes"),
        ("round", tube(), "cut it open if it is closed around an axis"),
    ):
        with pytest.raises(TandemError) as caught:
            read_element(write_element(tmp_path / name, own))
        (issue,) = caught.value.issues
        assert issue.code == "part.patch"
        assert expected_text in issue.message
    pole = {"radius_mm": 300, "start_deg": 0, "end_deg": 90, "centre_mm": [0, 0, 0]}
    point = {"rail": pole, "profiles": [{"at": 0.0, "bezier_mm": [[0, 0], [0, 100], [-300, 200]]}]}
    issue = refusal(write_element(tmp_path / "pole", mesh, surface={"loft": point}))
    assert issue.code == "element.surface"
    assert "point" in issue.message
    shut = {"rail": {"radius_mm": 300, "start_deg": 0, "end_deg": 360}}
    loft = {**shut, "profiles": [{"at": 0.0, "bezier_mm": [[0, 0], [40, 100], [0, 200]]}]}
    issue = refusal(write_element(tmp_path / "loft", mesh, surface={"loft": loft}))
    assert issue.code == "element.surface"
    assert "closed" in issue.message


def tube() -> TriangleMesh:
    """A ring of facets that goes all round."""
    own = trimesh.creation.cylinder(0.2, 0.3, sections=48)
    wall = np.abs(own.face_normals[:, 2]) < 0.5
    own.update_faces(wall)
    own.remove_unreferenced_vertices()
    return TriangleMesh(np.array(own.vertices), np.array(own.faces))


def test_what_is_of_another_kind_is_refused(tmp_path: Path) -> None:
    wire = {"material": "spring_steel", "diameter_mm": 2.0, "lengths_mm": [900], "temperature_c": 300}
    mesh = {"mesh": {"file": "sheet.obj", "unit": "mm"}}
    for change in (
        {"wires": [wire]},
        {"groups": {"parts": 3}},
        {"foam_faces_mm": 1},
        {"surface": {**mesh, "plane": {"normal": [0, 0, 1], "along": [1, 0, 0]}}},
        {"panels": {"strips": {"tolerance_mm": 1.0}, "boxes": {}}},
    ):
        with pytest.raises(TandemError) as caught:
            element_file.read_element(write_element(tmp_path, sheet(wave), **change))
        assert [issue.code for issue in caught.value.issues] == ["problem.field"]


@pytest.fixture(scope="module")
def canopy() -> dict[str, str]:
    return divide(ROOT / "problems" / "strips" / "element.yaml")


@pytest.mark.long
def test_the_bundled_canopy_is_divided_within_its_tolerance(canopy: dict[str, str]) -> None:
    panels = read_panels(canopy)
    mesh = read_element(ROOT / "problems" / "strips" / "element.yaml").patch.mesh
    assert len(panels) <= 8
    coarse = trimesh.Trimesh(1e3 * mesh.vertices, mesh.faces, process=False)
    for panel in panels.values():
        front = facets(top_and_bottom(panel)[0][:, ::4], 4)
        assert trimesh.proximity.closest_point(coarse, front.vertices)[1].max() <= 1.5 + 1e-3


@pytest.mark.long
def test_the_faces_of_a_panel_are_planned_and_proven(canopy: dict[str, str], tmp_path: Path) -> None:
    """As they are written; its sides are left out."""
    data = yaml.safe_load(canopy["panels/P05.yaml"])
    data["operations"] = data["operations"][:1]
    (tmp_path / "P05.yaml").write_text(yaml.safe_dump(data))
    outcome = pipeline.plan(pipeline.load(tmp_path / "P05.yaml"))
    assert outcome.verified, outcome.issues


def test_a_face_of_a_rhino_file_is_divided_and_its_unit_told(tmp_path: Path) -> None:
    made = rhino3dm.NurbsSurface.Create(3, False, 4, 4, 4, 4)
    for u, v in itertools.product(range(4), range(4)):
        made.Points[u, v] = rhino3dm.Point4d(0.4 * u, 0.2 * v, 0.05 * np.sin(u) * np.cos(v), 1.0)
    for knots in (made.KnotsU, made.KnotsV):
        knots.CreateUniformKnots(1.0)
    model = Model("Meters")
    model.layer("skin")
    model.add(made, "skin")
    model.write(tmp_path / "skin.3dm")
    data = yaml.safe_load((ROOT / "problems" / "strips" / "element.yaml").read_text())
    data["surface"] = {"rhino": {"file": "skin.3dm", "layer": "skin", "chord_mm": 0.1}}
    template = (ROOT / "problems" / "strips" / "panel.yaml").read_text()
    (tmp_path / "panel.yaml").write_text(template.replace("../cells", str(ROOT / "problems" / "cells")))
    (tmp_path / "element.yaml").write_text(yaml.safe_dump(data))
    element = element_file.read_element(tmp_path / "element.yaml")
    assert isinstance(element, element_file.StripsElement)
    assert [note.code for note in element.notes] == ["part.rhino_unit", "part.rhino_facets"]
    result = strips.divide_strips(element)
    files, told = wall_files.strips_folder(element, result)
    assert "in meters" in told[0].message
    assert json.loads(files["element.json"])["issues"][0]["code"] == "part.rhino_unit"
    assert np.ptp(element.patch.mesh.vertices, axis=0)[:2] == pytest.approx([1.2, 0.6])
