"""The proof's own reading of part files against the produced surfaces: only equal readings pass.

Wires and cutters here produce exactly the planner's reading. The file or the problem's numbers differ from it
in each wrong case, so that the reading is the only fault.
"""

from __future__ import annotations

import copy
import dataclasses
from types import SimpleNamespace

import ezdxf
import numpy as np
import pytest

from planner.claims.segments import Segment
from planner.geometry.mesh import vertex_normals
from planner.geometry.rulings import outward_sides, tessellate
from planner.geometry.wing import naca_section
from planner.processes.hotwire.claims import CutsSurface, KerfCurve
from planner.processes.hotwire.proof.cut_surface import WireSweep
from planner.processes.hotwire.proof.rules.cut_part import SWEEPS
from planner.processes.milling.proof.tool_motion import MILLING
from planner.proof.prove import Prover
from planner.proof.rules import part_file
from tests.processes.forming.proof import forming_job
from tests.proof.part_files.part_files import HIGH, LOW, grid_obj, hills, with_absolute_files
from tests.reading.part_specs import make

KERF, TOLERANCE = 0.002, 0.3
SIZE = np.array([0.5, 0.7, 0.2])


def refine(surface):
    """The surface with rulings at most 2 mm apart."""
    ring = np.append(np.arange(len(surface.start)), 0) if surface.closed else np.arange(len(surface.start))
    start, end = surface.start[ring], surface.end[ring]
    step = np.maximum(*(np.linalg.norm(np.diff(guide, axis=0), axis=1) for guide in (start, end)))
    at = [np.linspace(k, k + 1, int(np.ceil(s / 0.002)) + 1)[:-1] for k, s in enumerate(step)]
    at = np.concatenate([*at, [] if surface.closed else [float(len(step))]])
    rows = [
        np.stack([np.interp(at, np.arange(len(ring)), column) for column in g.T], 1) for g in (start, end)
    ]
    corner = (at == np.rint(at)) & surface.corner[np.rint(at).astype(int) % len(surface.corner)]
    return dataclasses.replace(surface, start=rows[0], end=rows[1], corner=corner)


def swept_rulings(surface):
    """Return the wire along rulings, offset outwards by half a kerf, beyond both ends.

    At corners it rotates about the edge.
    """
    surface = refine(surface)
    lines = []
    for normal in outward_sides(surface):
        start, end = surface.start + 0.5 * KERF * normal[:, 0], surface.end + 0.5 * KERF * normal[:, 1]
        fraction = np.concatenate([[-0.3], np.linspace(0.0, 1.0, 41), [1.3]])[:, None]
        lines.append(start[:, None] + fraction * (end - start)[:, None])
    points = np.stack(lines, axis=1)
    points = (np.concatenate([points, points[:1]]) if surface.closed else points).reshape(
        -1, *points.shape[2:]
    )
    return WireSweep.continuous(points if surface.closed else points[1:-1])


def swept_grid(mesh, cells=12):
    """Return the wire along the vertex rows of a face from `grid_obj`, offset by half a kerf."""
    points = mesh.vertices + 0.5 * KERF * vertex_normals(mesh)
    grid = points.reshape(cells + 1, cells + 1, 3)
    wide = [2 * grid[:, :1] - grid[:, 1:2], grid, 2 * grid[:, -1:] - grid[:, -2:-1]]
    rows = np.concatenate(wide, axis=1)
    rows = np.concatenate([2 * rows[:1] - rows[1:2], rows, 2 * rows[-1:] - rows[-2:-1]])
    return WireSweep.continuous(rows)


def judge_part(read_source, source, folder, cuts="all", size=SIZE, operation=None):
    """Run the rule where the planner reads ``read_source`` and the problem states ``source``."""
    part = make(read_source, folder, size)
    surfaces, sweeps = [], []
    for own in part.ruled:
        if own.name != "edges":
            mesh = tessellate(own, 2e-5)
            curve = KerfCurve.constant(KERF)
            surfaces.append(
                CutsSurface(Segment("cut", own.name), mesh.vertices, mesh.faces, curve, 3e-4, 0.95)
            )
            sweeps.append(swept_rulings(own))
    for name, mesh in (("front", part.front), ("back", part.back)):
        if mesh is not None:
            curve = KerfCurve.constant(KERF)
            surfaces.append(CutsSurface(Segment("cut", name), mesh.vertices, mesh.faces, curve, 3e-4, 0.95))
            sweeps.append(swept_grid(mesh))
    straight = SimpleNamespace(
        name="cut", process="straight_wire", cuts=cuts, shape_tol_mm=TOLERANCE, share=0.95
    )
    problem = SimpleNamespace(
        source={"part": with_absolute_files(source, folder)},
        stock=SimpleNamespace(size=size),
        operations=(operation or straight,),
        part=part,
    )
    facts = {SWEEPS: sweeps, MILLING: SimpleNamespace(surfaces=())}
    context = SimpleNamespace(problem=problem, claims_of=lambda kind: tuple(surfaces), get=facts.__getitem__)
    return part_file.part_file(context)


def elastic(*faces):
    """An operation that cuts faces with a bent wire."""
    return SimpleNamespace(
        name="cut", process="elastic_wire", faces=faces, shape_tol_mm=TOLERANCE, share=0.95
    )


def changed(source, **fields):
    """A part with other values at fields that are named by their path, ``__`` between its words."""
    out = copy.deepcopy(source)
    for path, value in fields.items():
        words = [int(word) if word.isdigit() else word for word in path.split("__")]
        at = out
        for word in words[:-1]:
            at = at[word]
        at[words[-1]] = value
    return out


def passes(outcome, min_samples=500):
    """Whether the rule passes, with all the places looked at."""
    counted = sum(int(text.split(" points")[0]) for text in outcome.where.split(", "))
    return not outcome.issues and outcome.worst >= 95.0 and counted >= min_samples


def fails(outcome):
    """Return whether the rule fails with a measured deviation."""
    return bool(outcome.issues) and all(issue.code == "verify.part_file" for issue in outcome.issues)


# ---- meshes ----

MESH = {
    "front": {"mesh": {"file": "front.obj", "unit": "mm"}},
    "back": {"mesh": {"file": "back.obj", "unit": "mm", "flip": True}},
}
PLACED = {**MESH, "in_stock": {"xyz_mm": [-60, -40, 30], "rpy_deg": [0, 0, 0]}}


@pytest.fixture
def faces(tmp_path):
    """A front and a back as files, and readings of them that are wrong."""
    grid_obj(tmp_path / "front.obj", hills)
    grid_obj(tmp_path / "back.obj", lambda x, y: hills(x, y) - 15.0 - 0.02 * x)
    grid_obj(tmp_path / "mirrored.obj", lambda x, y: hills(120 - x, y))
    grid_obj(tmp_path / "mirrored_back.obj", lambda x, y: hills(120 - x, y) - 15.0 - 0.02 * (120 - x))
    grid_obj(tmp_path / "high.obj", lambda x, y: hills(x, y) + 0.9)
    grid_obj(tmp_path / "low.obj", lambda x, y: hills(x, y) - 15.9 - 0.02 * x)
    grid_obj(tmp_path / "turned.obj", lambda x, y: hills(1.5 * y, x / 1.5))
    return tmp_path


@pytest.mark.parametrize("source", [MESH, PLACED], ids=["auto", "placed"])
def test_a_mesh_that_both_read_alike_is_proven(faces, source) -> None:
    assert passes(judge_part(source, source, faces, operation=elastic("front", "back")), 1000)


@pytest.mark.sampled(every=3)
@pytest.mark.parametrize(
    "wrong",
    [
        {"front__mesh__file": "mirrored.obj", "back__mesh__file": "mirrored_back.obj"},
        {"front__mesh__file": "high.obj"},
        {"back__mesh__file": "low.obj"},
        {"front__mesh__file": "turned.obj"},
        {"front__mesh__scale": 1.02, "back__mesh__scale": 1.02},
        {
            "front__mesh__unit": "cm",
            "back__mesh__unit": "cm",
            "front__mesh__scale": 0.4,
            "back__mesh__scale": 0.4,
        },
    ],
    ids=["mirrored", "front off", "back off", "axes swapped", "scale", "unit"],
)
def test_a_mesh_that_is_read_otherwise_is_not_proven(faces, wrong) -> None:
    """Wherever the part is: a mirror and a scale are no motion."""
    assert fails(judge_part(changed(MESH, **wrong), MESH, faces, operation=elastic("front", "back")))


@pytest.mark.parametrize(
    "wrong",
    [
        {"in_stock__xyz_mm": [-60, -40, 30.9]},
        {"in_stock__xyz_mm": [-54, -40, 30]},
        {"in_stock__rpy_deg": [0, 0, 4]},
        {"in_stock__rpy_deg": [1.5, 0, 0]},
    ],
)
def test_a_placed_mesh_that_is_put_elsewhere_is_not_proven(faces, wrong) -> None:
    assert fails(judge_part(changed(PLACED, **wrong), PLACED, faces, operation=elastic("front", "back")))


def test_a_face_that_looks_the_other_way_is_not_proven(faces) -> None:
    """Turned over, half the kerf is on the other side of it."""
    turned = {
        "front": {"mesh": {"file": "front.obj", "unit": "mm", "flip": True}},
        "in_stock": PLACED["in_stock"],
    }
    right = changed(turned, front__mesh__flip=False)
    assert passes(judge_part(right, right, faces, operation=elastic("front")))
    assert fails(judge_part(turned, right, faces, operation=elastic("front")))


def test_where_and_by_how_much_is_told(faces) -> None:
    found = judge_part(
        changed(PLACED, in_stock__xyz_mm=[-60, -40, 30.9]), PLACED, faces, operation=elastic("front")
    )
    (issue,) = found.issues
    assert issue.field == "cut/front"
    assert "front.obj as read: 0.0 % of 600 points are within 0.32 mm" in issue.message
    off = float(issue.message.split("deviates by ")[1].split(" mm")[0])
    assert 0.85 < abs(off) < 0.95  # moved by 0.9 mm


def test_a_file_that_is_gone_or_broken_is_told_by_its_name(faces) -> None:
    (faces / "front.obj").rename(faces / "kept.obj")
    read = changed(PLACED, front__mesh__file="kept.obj")
    found = judge_part(read, PLACED, faces, operation=elastic("front"))
    assert "front.obj cannot be opened" in found.issues[0].message
    (faces / "front.obj").write_text("v 1 2\nf 1 1 1\n")
    found = judge_part(read, PLACED, faces, operation=elastic("front"))
    assert "front.obj cannot be read by the proof" in found.issues[0].message


def test_a_file_that_has_changed_since_is_told(faces) -> None:
    (faces / "kept.obj").write_bytes((faces / "front.obj").read_bytes())
    grid_obj(faces / "front.obj", lambda x, y: hills(x, y) + 0.9)
    assert fails(
        judge_part(changed(PLACED, front__mesh__file="kept.obj"), PLACED, faces, operation=elastic("front"))
    )


# ---- airfoils ----

WING = {
    "root": {"file": "root.dat", "chord_mm": 200},
    "tip": {"file": "tip.dat", "chord_mm": 120},
    "span_mm": 400,
    "sweep_deg": 6,
    "twist_deg": 2,
    "dihedral_deg": 2,
    "trailing_edge_mm": 1,
}


@pytest.fixture
def airfoils(tmp_path):
    """Two airfoils, and others."""
    for name, digits in (("root.dat", "2412"), ("tip.dat", "23112"), ("other.dat", "4409")):
        rows = [f"{x:.7f} {y:.7f}" for x, y in naca_section(digits, 60)]
        (tmp_path / name).write_text("airfoil\n" + "\n".join(rows))
    rows = [f"{x:.7f} {-y:.7f}" for x, y in naca_section("2412", 60)]
    (tmp_path / "upside_down.dat").write_text("airfoil\n" + "\n".join(rows[::-1]))
    return tmp_path


def test_a_wing_that_both_read_alike_is_proven(airfoils) -> None:
    assert passes(judge_part({"wing": WING}, {"wing": WING}, airfoils))
    found = {"wing": {**WING, "match": "least_twist"}}
    assert passes(judge_part(found, found, airfoils))


@pytest.mark.sampled(every=3)
@pytest.mark.parametrize(
    "wrong",
    [
        {"tip__file": "other.dat"},
        pytest.param({"tip__file": "root.dat"}, marks=pytest.mark.long),
        {"root__file": "upside_down.dat", "tip__file": "upside_down.dat"},
        pytest.param({"root__file": "tip.dat", "tip__file": "root.dat"}, marks=pytest.mark.long),
        {"tip__chord_mm": 125},
        pytest.param({"span_mm": 440}, marks=pytest.mark.long),
        pytest.param({"sweep_deg": -6}, marks=pytest.mark.long),
        pytest.param({"twist_deg": -2}, marks=pytest.mark.long),
        {"dihedral_deg": 12},
        {"trailing_edge_mm": 4},
    ],
    ids=lambda wrong: " ".join(wrong),
)
def test_a_wing_that_is_read_otherwise_is_not_proven(airfoils, wrong) -> None:
    assert fails(judge_part({"wing": changed(WING, **wrong)}, {"wing": WING}, airfoils))


# ---- guides and drawings ----

RULED = {
    "ruled": [
        {"name": "wall", "start": {"dxf": {"file": "low.dxf", "unit": "mm"}}, "end": {"polyline_mm": HIGH}}
    ],
    "in_stock": {"xyz_mm": [-90, 0, 30], "rpy_deg": [0, 0, 15]},
}


@pytest.fixture
def drawings(tmp_path):
    """A guide and outlines as drawings."""
    for name, points in (("low.dxf", LOW), ("mirrored.dxf", [[x, -y, z] for x, y, z in LOW])):
        document = ezdxf.new()
        document.modelspace().add_polyline3d([tuple(p) for p in points])
        document.saveas(tmp_path / name)
    for name, radius, bulge in (("plate.dxf", 30, 0.3), ("wide.dxf", 31, 0.3), ("hollow.dxf", 30, -0.3)):
        document = ezdxf.new()
        space = document.modelspace()
        rows = [(0, 0, 0), (200, 0, bulge), (200, 120, 0), (60, 140, 0)]
        space.add_lwpolyline(rows, format="xyb", close=True)
        space.add_circle((120, 60), radius)
        document.saveas(tmp_path / name)
    return tmp_path


def test_guides_that_both_read_alike_are_proven(drawings) -> None:
    assert passes(judge_part(RULED, RULED, drawings))
    loose = {key: value for key, value in RULED.items() if key != "in_stock"}
    assert passes(judge_part(loose, loose, drawings))


@pytest.mark.parametrize(
    "wrong",
    [
        {"ruled__0__start__dxf__file": "mirrored.dxf"},
        {"ruled__0__start__dxf__z_mm": 4},
        {"ruled__0__flip": True},
        {"in_stock__rpy_deg": [0, 0, -15]},
        {"in_stock__xyz_mm": [-90, 1, 30]},
        {"in_stock__xyz_mm": [-0.09, 0, 0.03]},
    ],
    ids=lambda wrong: " ".join(wrong),
)  # fmt: skip
def test_guides_that_are_read_otherwise_are_not_proven(drawings, wrong) -> None:
    found = judge_part(changed(RULED, **wrong), RULED, drawings)
    assert fails(found) or ("polyline_mm" in " ".join(wrong) and "match" not in " ".join(wrong))


def test_rulings_joined_otherwise_are_not_proven(drawings) -> None:
    """By their points one to one, and by the way: pairs that differ make another twist."""
    start, end = [[0, 0, 0], [20, 0, 0], [200, 0, 0]], [[0, 0, 120], [180, 60, 120], [200, 60, 120]]
    own = {
        "name": "wall",
        "start": {"polyline_mm": start, "corner_deg": 179},
        "end": {"polyline_mm": end, "corner_deg": 179},
    }
    said = {"ruled": [{**own, "match": "parameter"}], "in_stock": {"xyz_mm": [-100, 0, 30]}}
    other = changed(said, ruled__0__match="arc_length")
    assert passes(judge_part(said, said, drawings))
    assert passes(judge_part(other, other, drawings))
    assert fails(judge_part(other, said, drawings))


PLATE = {"plate": {"dxf": {"file": "plate.dxf", "unit": "mm"}}}


@pytest.mark.parametrize("more", [{}, {"in_stock": {"xyz_mm": [-90, -80, 0], "rpy_deg": [0, 0, 10]}}])
def test_outlines_that_both_read_alike_are_proven(drawings, more) -> None:
    said = {**PLATE, **more}
    assert passes(judge_part(said, said, drawings), 1200)
    one = (SimpleNamespace(surface="hole_a"),)
    assert passes(judge_part(said, said, drawings, one))


@pytest.mark.parametrize(
    "wrong",
    [
        {"plate__dxf__file": "wide.dxf"},
        {"plate__dxf__file": "hollow.dxf"},
        pytest.param({"plate__dxf__unit": "in"}, marks=pytest.mark.long),
    ],
    ids=["wide", "hollow", "inches"],
)
def test_outlines_that_are_read_otherwise_are_not_proven(drawings, wrong) -> None:
    size = np.array([6.0, 6.0, 0.2])
    assert fails(judge_part(changed(PLATE, **wrong), PLATE, drawings, size=size))


def test_an_outline_that_is_lost_is_not_proven(drawings) -> None:
    more = {
        "plate": {**PLATE["plate"], "outlines": [{"polyline_mm": [[0, 150], [50, 150], [50, 190], [0, 190]]}]}
    }
    assert passes(judge_part(more, more, drawings), 1800)
    lost = judge_part(PLATE, {**more, "in_stock": {}}, drawings)
    assert any("2 outlines are cut; the part as read has 3" in issue.message for issue in lost.issues)


def test_a_surface_that_nobody_claims_is_told(drawings) -> None:
    found = judge_part(RULED, RULED, drawings, (SimpleNamespace(surface="roof"),))
    assert fails(found)
    assert "no claim covers cut/roof" in found.issues[0].message


@pytest.mark.parametrize("name", ["wall_in", "Wall_out", "trim_x"])
def test_names_that_end_like_ways_are_found(drawings, name) -> None:
    said = changed(RULED, ruled__0__name=name)
    assert passes(judge_part(said, said, drawings, (SimpleNamespace(surface=name),)))


@pytest.mark.parametrize("name", ["outline", "hole"])
def test_a_ruled_surface_called_like_an_outline_is_none_of_a_plate(drawings, name) -> None:
    said = changed(RULED, ruled__0__name=name)
    said = {**said, "ruled": said["ruled"][:1]}
    assert passes(judge_part(said, said, drawings))


def test_what_no_operation_makes_is_not_looked_at(drawings) -> None:
    found = judge_part(RULED, RULED, drawings, (SimpleNamespace(trim=("top",)),))
    assert not found.issues
    assert found.nothing == "no operation makes a surface of the part"


# ---- sheets ----


def dish_file(path, raised=0.0, scale=1e3, mirrored=False):
    """The dish of the small forming job as its lower face, in mm, all z ``raised`` [m]."""
    vertices, faces = forming_job.face()
    places = (vertices - [0, 0, forming_job.SHEET - raised]) * scale
    if mirrored:
        places = places * [1, 1, -1]
    path.write_text(
        "".join("v " + " ".join(f"{v:.9f}" for v in p) + "\n" for p in places)
        + "".join(f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in faces)
    )


def judge_formed(path, **source):
    """The rule's result for the programs of the small forming job."""
    operation = SimpleNamespace(
        name="dish",
        process="forming",
        arms=forming_job.ARMS,
        share=0.95,
        gouge_tol_mm=0.05,
        strategy="in_place",
        leaves=lambda stock: stock,
    )
    part = {"sheet_mesh": {"file": str(path), "unit": "mm", "face": "bottom", **source}}
    where = {"in_stock": source.pop("in_stock")} if "in_stock" in source else {}
    part["sheet_mesh"].pop("in_stock", None)
    problem = dataclasses.replace(
        forming_job.problem(), operations=(operation,), source={"part": {**part, **where}}
    )
    proof = Prover(problem, forming_job.claims()).prove(forming_job.programs(), last="verify.part_file")
    return proof.rule("verify.part_file"), [i for i in proof.issues if i.code == "verify.part_file"]


def test_a_sheet_that_both_read_alike_is_proven(tmp_path) -> None:
    dish_file(tmp_path / "dish.obj")
    rule, issues = judge_formed(tmp_path / "dish.obj")
    assert rule.passed, issues
    assert rule.where == "800 points of dish.obj"


@pytest.mark.sampled(every=3)
@pytest.mark.parametrize("wrong", ["raised", "mirrored", "unit", "place", "flat"])
def test_a_sheet_that_is_read_otherwise_is_not_proven(tmp_path, wrong) -> None:
    path, said = tmp_path / "dish.obj", {}
    options = {"raised": {"raised": 3e-4}, "mirrored": {"mirrored": True}, "unit": {"scale": 1.02e3}}
    dish_file(path, **options.get(wrong, {}))
    if wrong == "place":
        said = {"in_stock": {"xyz_mm": [0.5, 0, 0]}}
    if wrong == "flat":
        path.write_text("v 0 0 0\nv 50 0 0\nv 0 50 0\nf 1 2 3\n")
    rule, issues = judge_formed(path, **said)
    assert rule.ran
    assert not rule.passed
    assert "dish.obj" in issues[0].message


@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.long) for k in (8, 11))])
def test_irregular_rings_whose_place_is_open_are_found(tmp_path, seed) -> None:
    """Seven corners each, joined with the least twist: of what is made, only the guides are known."""
    rng = np.random.default_rng(seed)
    radius, angle = rng.uniform(60.0, 90.0, 7).round(1), 2.0 * np.pi * np.arange(7) / 7

    def ring(z, size, turn):
        wide = size * radius * [[1.0], [1.4]] * np.stack([np.cos(angle + turn), np.sin(angle + turn)])
        points = np.column_stack([*wide, np.full(7, z)]).round(2).tolist()
        return {"polyline_mm": points, "corner_deg": 20.0}

    sides = {"name": "sides", "closed": True, "match": "least_twist"}
    said = {"ruled": [sides | {"start": ring(0.0, 1.0, 0.0), "end": ring(100.0, 0.7, 0.2)}]}
    assert not judge_part(said, said, tmp_path, size=np.array([0.9, 1.1, 0.7])).issues
    wrong = {"ruled": [sides | {"start": ring(0.0, 1.0, 0.0), "end": ring(100.0, 0.72, 0.2)}]}
    assert judge_part(wrong, said, tmp_path, size=np.array([0.9, 1.1, 0.7])).issues
