"""Surfaces of the proof's readers, against the part that the planner builds from the same file."""

import ezdxf
import numpy as np
import pytest
import trimesh

from planner.geometry.rulings import tessellate
from planner.geometry.wing import naca_section
from planner.processes.forming.proof import formed_sheet
from planner.proof.part_files import UnreadError, pose_of
from planner.proof.part_files.sheets import sheet_face
from planner.proof.part_files.surfaces import part_surfaces
from tests.proof.part_files.part_files import HIGH, LOW, grid_obj, hills, with_absolute_files
from tests.reading.part_specs import WING, circle, guides, make, outline

SIZE = np.array([1.6, 1.6, 0.9])
PART_POSE = {"xyz_mm": [10, -20, 300], "rpy_deg": [5, -10, 30]}
TOLERANCE_M = 6e-5
"""Planner and proof follow curves within 0.01 mm each, and facets are within 0.02 mm of surfaces."""
TWISTED = 2.5e-4
"""Error of strongly twisted patches, which have at most 64 rows of facets: twist / 256, here 0.17 mm."""


def meshes(part):
    """The faces of a planner's part as triangles (F, 3, 3), by name."""
    out = {own.name: tessellate(own, 1e-5) for own in part.ruled}
    out |= {name: mesh for name, mesh in (("front", part.front), ("back", part.back)) if mesh is not None}
    return {name: mesh.vertices[mesh.faces] for name, mesh in out.items()}


def check_surfaces(source, folder, part_pose=PART_POSE, tolerance=TOLERANCE_M):
    """Each surface of the part that the planner builds has places of one that the proof reads all over it."""
    part = meshes(make({**source, "in_stock": part_pose}, folder, SIZE))
    found = part_surfaces(with_absolute_files(source, folder), float(SIZE[2]))
    assert len(found) == len(part)
    left = list(found)
    solids = {name: trimesh.Trimesh(**trimesh.triangles.to_kwargs(c)) for name, c in part.items()}
    for name, corners in part.items():
        fits = [s for s in left if name == s.name or name.startswith(s.name + "_")]
        best, nearest = np.inf, None
        for surface in fits:
            for own in surface.samples:
                places = own.moved(pose_of(part_pose))
                deviation = formed_sheet.mesh_distance(
                    places.points, solids[name].vertices, solids[name].faces
                )
                if deviation.max() < best:
                    best, nearest, seen = float(deviation.max()), surface, places
        assert best < tolerance, (name, best)
        left = [surface for surface in left if surface is not nearest]
        spread = np.ptp(seen.points, axis=0) / np.maximum(np.ptp(corners.reshape(-1, 3), axis=0), 1e-3)
        assert spread.min() > 0.8
        which = trimesh.proximity.closest_point(solids[name], seen.points)[2]
        assert (np.einsum("ij,ij->i", solids[name].face_normals[which], seen.normals) > 0.0).mean() > 0.95
    return found


@pytest.mark.parametrize(("unit", "scale"), [("mm", 1.0), ("in", 1 / 25.4), ("m", 1e-3)])
@pytest.mark.parametrize("flip", [False, True])
def test_a_mesh_with_its_back_moved(tmp_path, unit, scale, flip) -> None:
    grid_obj(tmp_path / "front.obj", hills, scale=scale)
    check_surfaces(
        {"front": {"mesh": {"file": "front.obj", "unit": unit, "flip": flip}}, "back": {"offset_mm": 12}},
        tmp_path,
    )


def test_a_mesh_scaled_with_a_back_of_its_own(tmp_path) -> None:
    grid_obj(tmp_path / "front.obj", hills, scale=0.5)
    grid_obj(tmp_path / "back.obj", lambda x, y: hills(x, y) - 15.0 - 0.02 * x)
    said = {
        "front": {"mesh": {"file": "front.obj", "unit": "mm", "scale": 2.0}},
        "back": {"mesh": {"file": "back.obj", "unit": "mm", "flip": True}},
    }
    check_surfaces(said, tmp_path)


@pytest.mark.parametrize(
    "more",
    [
        {"rail": {"radius_mm": 300, "start_deg": 5, "end_deg": 40, "centre_mm": [0, 10, 5]},
         "profiles": [{"at": 0, "bezier_mm": [[0, 0], [30, 100], [60, 200]]},
                      {"at": 1, "bezier_mm": [[0, 0], [10, 110], [80, 190]]}]},
        {"sections": [{"at": a, "bspline_mm": [[0, 90 * a, 20], [80, 90 * a, 45 - 30 * a], [160, 90 * a, 5],
                       [240, 90 * a, 25 * a], [300, 90 * a, 0]]} for a in (0.0, 0.4, 1.0)],
         "region": {"u": [0.1, 0.9], "v": [0.2, 1.0]}, "flip": True},
    ],
    ids=["rail", "sections"],
)  # fmt: skip
def test_a_loft(tmp_path, more) -> None:
    check_surfaces({"front": {"loft": more}, "back": {"offset_mm": 10}}, tmp_path, tolerance=1e-4)


def line_dxf(path, points, closed=False, unit_scale=1.0):
    """A drawing with one polyline in space."""
    document = ezdxf.new()
    document.modelspace().add_polyline3d([tuple(unit_scale * v for v in p) for p in points], close=closed)
    document.saveas(path)


@pytest.mark.parametrize("match", ["arc_length", "parameter"])
@pytest.mark.parametrize("flip", [False, True])
@pytest.mark.parametrize("kind", ["polyline_mm", "bspline_mm", "bezier_mm"])
def test_open_guides(tmp_path, match, flip, kind) -> None:
    own = {"start": {kind: LOW}, "end": {kind: HIGH[::-1]}, "match": match, "flip": flip}
    check_surfaces({"ruled": [{"name": "wall", **own}]}, tmp_path, tolerance=TWISTED)


def test_guides_with_stated_corners(tmp_path) -> None:
    corners = (
        {"corners_mm": [[61, 30, 0]], "polyline_mm": LOW},
        {"corners_mm": [[70, 50, 130]], "polyline_mm": HIGH},
    )
    check_surfaces(
        {"ruled": [{"name": "wall", "start": corners[0], "end": corners[1]}]}, tmp_path, tolerance=TWISTED
    )


def test_guides_of_a_drawing(tmp_path) -> None:
    line_dxf(tmp_path / "low.dxf", LOW, unit_scale=0.1)
    line_dxf(tmp_path / "high.dxf", HIGH)
    start = {"dxf": {"file": "low.dxf", "unit": "cm"}}
    end = {"dxf": {"file": "high.dxf", "unit": "mm", "z_mm": 128}}
    (found,) = check_surfaces(
        {"ruled": [{"name": "wall", "start": start, "end": end}]}, tmp_path, tolerance=TWISTED
    )
    assert found.file == "low.dxf and high.dxf"


def test_guides_joined_by_the_least_twist_are_held_themselves(tmp_path) -> None:
    own = {"start": {"polyline_mm": LOW}, "end": {"polyline_mm": HIGH}, "match": "least_twist"}
    check_surfaces({"ruled": [{"name": "wall", **own}]}, tmp_path)


@pytest.mark.parametrize("hole", [False, True])
def test_closed_guides(tmp_path, hole) -> None:
    check_surfaces(guides(hole=hole), tmp_path)


def test_closed_splines(tmp_path) -> None:
    ring = [[0, 0], [90, -10], [140, 60], [60, 130], [-30, 70]]
    own = {
        "start": {"bspline_mm": [[x, y, 0] for x, y in [*ring, ring[0]]]},
        "end": {"bspline_mm": [[0.7 * x + 10, 0.7 * y, 90] for x, y in [*ring, ring[0]]]},
    }
    check_surfaces({"ruled": [{"name": "shell", "closed": True, **own}]}, tmp_path)


def test_outlines_and_holes(tmp_path) -> None:
    document = ezdxf.new()
    space = document.modelspace()
    space.add_lwpolyline(
        [(130, 0, 0.4), (200, 0, 0), (200, 60, -0.2), (130, 60, 0)], format="xyb", close=True
    )
    space.add_circle((165, 30), 12)
    document.saveas(tmp_path / "more.dxf")
    plate = outline(circle(50, 50, 20))["plate"]
    plate["outlines"].append({"bspline_mm": [[0, 120], [60, 110], [90, 150], [40, 190], [-10, 160]]})
    found = check_surfaces(
        {"plate": {**plate, "dxf": {"file": "more.dxf", "unit": "mm"}}},
        tmp_path,
        {"xyz_mm": [-50, 30, 0], "rpy_deg": [0, 0, 70]},
        8e-5,
    )
    assert [s.name for s in found] == ["outline", "hole", "outline", "outline", "hole"]


@pytest.mark.parametrize("more", [{}, {"trailing_edge_mm": 0}, {"twist_deg": -3, "sweep_deg": -4}])
def test_wings_of_digits(tmp_path, more) -> None:
    check_surfaces({"wing": {**WING, **more}}, tmp_path)


def test_wings_of_files(tmp_path) -> None:
    for name, digits in (("root.dat", "2412"), ("tip.dat", "23112")):
        rows = [f"{x:.7f} {y:.7f}" for x, y in naca_section(digits, 60)]
        (tmp_path / name).write_text("airfoil\n" + "\n".join(rows))
    said = {
        **WING,
        "root": {"file": "root.dat", "chord_mm": 200},
        "tip": {"file": "tip.dat", "chord_mm": 120},
    }
    (found,) = check_surfaces({"wing": said}, tmp_path)
    assert found.file == "root.dat and tip.dat"


def test_a_circle_has_its_radius() -> None:
    """Closed form: every place of the wall is 20 mm from the axis."""
    (hole,) = (s for s in part_surfaces(outline(circle(50, 50, 20)), 0.1) if s.name == "hole")
    deviation = np.linalg.norm(hole.samples[0].points[:, :2] - 0.05, axis=1)
    np.testing.assert_allclose(deviation, 0.02, atol=1e-6)
    inward = np.einsum("ij,ij->i", hole.samples[0].normals[:, :2], hole.samples[0].points[:, :2] - 0.05)
    assert (inward < 0.0).all()


def test_a_sheet_is_found_by_its_rim(tmp_path) -> None:
    """A cone that stands anywhere comes to lie with its rim at z = 0 and its tip 30 mm below."""
    angle = np.linspace(0, 2 * np.pi, 73)[:-1]
    rings = [(60.0, 0.0), (40.0, 0.0), (10.0, -30.0)]
    places = [np.column_stack([r * np.cos(angle), r * np.sin(angle), 0 * angle + z]) for r, z in rings]
    places = np.concatenate([*places, [[0, 0, -30]]])
    faces = []
    for k in range(2):
        for i in range(72):
            a, b = 72 * k + i, 72 * k + (i + 1) % 72
            faces += [[a, b, b + 72], [a, b + 72, a + 72]]
    faces += [[144 + i, 144 + (i + 1) % 72, 216] for i in range(72)]
    rotated = places @ pose_of({"rpy_deg": [20, 40, 60]})[:3, :3].T + [300, 20, 10]
    path = tmp_path / "cone.obj"
    path.write_text(
        "".join(f"v {x} {y} {z}\n" for x, y, z in rotated)
        + "".join(f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in faces)
    )
    said = {"sheet_mesh": {"file": str(path), "unit": "mm", "face": "bottom", "frame": "find"}}
    found = sheet_face(said)
    walls = found.walls.points * 1e3
    assert len(walls) >= 500
    radius = np.linalg.norm(walls[:, :2], axis=1)
    np.testing.assert_allclose(walls[:, 2], radius - 40.0, atol=0.1)
    assert (found.walls.normals[:, 2] > 0.0).all()


def test_what_cannot_be_read_is_told_with_its_name(tmp_path) -> None:
    with pytest.raises(UnreadError, match=r"gone.obj cannot be opened"):
        part_surfaces({"front": {"mesh": {"file": str(tmp_path / "gone.obj"), "unit": "mm"}}}, 0.1)
    (tmp_path / "bad.dat").write_text("nothing")
    own = {"file": str(tmp_path / "bad.dat"), "chord_mm": 100}
    with pytest.raises(UnreadError, match=r"bad.dat cannot be read by the proof: it has no points"):
        part_surfaces({"wing": {"root": own, "tip": own, "span_mm": 100}}, 0.1)
