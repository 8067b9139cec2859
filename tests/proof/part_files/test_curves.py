"""The proof's own readers of airfoils and drawings, against the planner's, ezdxf's and closed forms."""

import ezdxf
import numpy as np
import pytest
from ezdxf import path as ezpath
from scipy.spatial import cKDTree

from planner.geometry.curves import ArcRail, LoftSurface, curve_points
from planner.geometry.wing import naca_section, read_airfoil
from planner.issues import TandemError
from planner.proof.part_files import UnreadError
from planner.proof.part_files.curves import bezier, bspline, read_curves
from planner.proof.part_files.meshes import loft_points
from planner.proof.part_files.surfaces import read_section, section_of_digits
from planner.reading.part_ruled import read_dxf

SECTION = naca_section("2412", 30)


def text_of(points, head="NACA 2412"):
    """Lines of a coordinate file."""
    return head + "\n" + "\n".join(f" {x:.7f}  {y:.7f}" for x, y in points) + "\n"


def lednicer(points):
    """The same in Lednicer's order."""
    nose = int(points[:, 0].argmin())
    top, bottom = points[nose::-1], points[nose:]
    counts = f"  {len(top)}.  {len(bottom)}.\n"
    rows = [text_of(side, "").strip("\n") for side in (top, bottom)]
    return "NACA 2412\n" + counts + "\n" + rows[0] + "\n\n" + rows[1] + "\n"


AIRFOILS = {
    "Selig": text_of(SECTION),
    "Lednicer": lednicer(SECTION),
    "lower side first": text_of(SECTION[::-1]),
    "a chord of 100": text_of(100.0 * SECTION + [3.0, 0.0]),
    "from the nose": text_of(np.roll(SECTION, -30, axis=0)),
    "repeated points": text_of(np.repeat(SECTION, 2, axis=0)),
    "commas and remarks": "a\nb\n# c\n" + "\n".join(f"({x:.7f}, {y:.7f})" for x, y in SECTION) + "\nend\n",
    "exponents": "\n".join(f"{x:.7e} {y:.7E}".replace("e", "D") for x, y in SECTION),
}


@pytest.mark.parametrize("name", AIRFOILS)
def test_forms_of_airfoils_are_read_as_the_planner_reads_them(tmp_path, name) -> None:
    path = tmp_path / "wing.dat"
    path.write_text(AIRFOILS[name])
    own, (other, _) = read_section(path), read_airfoil(path, "part")
    assert own.shape == other.shape
    np.testing.assert_allclose(own, other, atol=1e-6)


@pytest.mark.parametrize("digits", ["0012", "2412", "4415", "23012", "23112", "44018", "25110"])
def test_digits_give_the_section_of_their_formulas(digits) -> None:
    """Both write the formulas down by themselves: the places of one lie on the other."""
    own, other = section_of_digits(digits), naca_section(digits, 3000)
    assert np.max(cKDTree(other).query(own)[0]) < 4e-4
    assert abs(np.ptp(own[:, 1]) - np.ptp(other[:, 1])) < 2e-5
    np.testing.assert_allclose(own[[0, -1]], other[[0, -1]], atol=1e-9)


def test_the_thickest_place_of_a_four_digit_section() -> None:
    """NACA Report 460: half of the thickness of 12 % at x = 0.3 is 0.06002, of the tail 0.00126."""
    points = section_of_digits("0012")
    assert np.interp(0.3, points[:201][::-1, 0], points[:201][::-1, 1]) == pytest.approx(0.06002, abs=2e-5)
    assert points[0, 1] == pytest.approx(0.00126, abs=1e-6)


@pytest.mark.parametrize("text", ["", "a name alone\n", "x\n 20. 20.\n 0 0\n 1 0\n"])
def test_what_is_no_airfoil_is_told(tmp_path, text) -> None:
    path = tmp_path / "wing.dat"
    path.write_text(text)
    with pytest.raises(UnreadError):
        read_section(path)


def drawn(space, name):
    """Curves of each kind in a model space."""
    if name == "line":
        space.add_line((0, 0, 1), (30, 20, 4))
    elif name == "arc":
        space.add_arc((5, 6), 12, 300, 45)
    elif name == "arc seen from below":
        space.add_arc((5, 6, 2), 12, 30, 200, dxfattribs={"extrusion": (0, 0, -1)})
    elif name == "arc in a slanted plane":
        space.add_arc((5, 6, 2), 12, 30, 200, dxfattribs={"extrusion": (1, 2, 3)})
    elif name == "circle":
        space.add_circle((-4, 9), 7)
    elif name == "ellipse":
        space.add_ellipse((3, 4), (20, 10, 0), 0.4, 1.0, 5.0)
    elif name == "ellipse from below":
        space.add_ellipse((3, 4), (20, 10, 0), 0.4, 0.3, 2.0, dxfattribs={"extrusion": (0, 0, -1)})
    elif name == "spline":
        space.add_open_spline([(0, 0), (10, 20), (30, -10), (45, 5), (60, 0)], degree=3)
    elif name == "rational spline":
        space.add_rational_spline([(0, 0), (10, 20), (30, -10), (45, 5)], [1, 3, 0.5, 1], degree=2)
    elif name == "spline through points":
        space.add_spline([(0, 0), (10, 20), (30, -10), (45, 5)])
    elif name == "bulges":
        space.add_lwpolyline(
            [(0, 0, 0.5), (20, 0, -1.2), (30, 15, 0), (0, 30, 0.1)], format="xyb", close=True
        )
    elif name == "bulges from below":
        space.add_lwpolyline(
            [(0, 0, 0.5), (20, 0, -0.3), (30, 15, 0)],
            format="xyb",
            dxfattribs={"extrusion": (0, 0, -1), "elevation": 4},
        )
    elif name == "old polyline":
        space.add_polyline2d([(0, 0, 0.4), (20, 0, 0), (30, 15, -0.2)], format="xyb", close=True)
    elif name == "polyline in space":
        space.add_polyline3d([(0, 0, 0), (20, 0, 5), (30, 15, -4)])
    elif name == "joined":
        space.add_line((20, 0), (0, 0))
        space.add_line((20, 20), (0, 20))
        space.add_arc((20, 10), 10, 270, 90)
        space.add_line((0, 20), (0, 0))
    elif name == "joined, open":
        space.add_line((0, 0), (20, 0))
        space.add_arc((20, 10), 10, 270, 90)
        space.add_line((0, 0), (-5, 5))


KINDS = (
    "line",
    "arc",
    "arc seen from below",
    "arc in a slanted plane",
    "circle",
    "ellipse",
    "ellipse from below",
    "spline",
    "rational spline",
    "spline through points",
    "bulges",
    "bulges from below",
    "old polyline",
    "polyline in space",
    "joined",
    "joined, open",
)
APPROXIMATE = 3e-4
"""ezdxf approximates arcs by Bezier curves, with an error of 2.7e-4 of the radius (Goldapp, CAGD 8, 1991)."""


def drawing(tmp_path, *names):
    """A drawing with curves on layer 0 and others on a layer of theirs."""
    document = ezdxf.new()
    for name in names:
        drawn(document.modelspace(), name)
    document.modelspace().add_line((0, 0), (1, 1), dxfattribs={"layer": "Other"})
    path = tmp_path / "part.dxf"
    document.saveas(path)
    return path


def max_distance(points, others):
    """Return the largest distance of points (N, 3) from a polyline."""
    start, way = others[:-1], np.diff(others, axis=0)
    off = points[:, None] - start
    fraction = np.clip((off * way).sum(2) / np.maximum((way * way).sum(1), 1e-30), 0, 1)
    return float(np.linalg.norm(off - fraction[..., None] * way, axis=2).min(axis=1).max())


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("unit", [1e-3, 0.0254])
def test_forms_of_curves_are_read_as_the_planner_reads_them(tmp_path, name, unit) -> None:
    path = drawing(tmp_path, name)
    own, (other, _) = read_curves(path, unit, "0"), read_dxf(path, unit, "0", "part")
    assert [curve.closed for curve in own] == [curve.closed for curve in other]
    for mine, theirs in zip(own, other, strict=True):
        one, two = (
            np.concatenate([c.points, c.points[:1]]) if c.closed else c.points for c in (mine, theirs)
        )
        rough = 1e-3 if name == "rational spline" else APPROXIMATE
        limit = 5e-6 + rough * float(np.ptp(one, axis=0).max())
        assert max_distance(one, two) < limit
        assert max_distance(two, one) < limit


def test_an_arc_is_where_its_angles_say(tmp_path) -> None:
    """From 300 to 45 degrees about (5, 6), radius 12, anticlockwise."""
    (curve,) = read_curves(drawing(tmp_path, "arc"), 1.0, "0")
    angle = np.deg2rad([300.0, 352.5, 405.0])
    expected = np.column_stack([5 + 12 * np.cos(angle), 6 + 12 * np.sin(angle), 0 * angle])
    np.testing.assert_allclose(curve.points[[0, len(curve.points) // 2, -1]], expected, atol=0.05)
    np.testing.assert_allclose(np.linalg.norm(curve.points[:, :2] - [5, 6], axis=1), 12.0, atol=1e-9)


def test_layers_count_in_any_case(tmp_path) -> None:
    path = drawing(tmp_path, "circle")
    assert len(read_curves(path, 1.0, "OTHER")) == 1
    assert len(read_curves(path, 1.0, None)) == 2


def test_what_is_no_drawing_is_told(tmp_path) -> None:
    path = tmp_path / "part.dxf"
    path.write_text("0\nSECTION\n2\nnonsense")
    with pytest.raises(UnreadError):
        read_curves(path, 1.0, None)
    with pytest.raises(TandemError):
        read_dxf(path, 1.0, None, "part")


def test_splines_are_those_of_their_definitions() -> None:
    """Against scipy's B-splines, by which the planner works."""
    rng, t = np.random.default_rng(3), np.linspace(0.0, 1.0, 91)
    for count in (2, 3, 4, 7, 16):
        control = rng.normal(size=(count, 3))
        np.testing.assert_allclose(bspline(control, t), curve_points("bspline", control, t), atol=1e-12)
        np.testing.assert_allclose(bezier(control, t), curve_points("bezier", control, t), atol=1e-12)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 6])
def test_a_loft_is_the_planners_loft(count) -> None:
    rng = np.random.default_rng(count)
    control = rng.normal(size=(count, 5, 2)) * 20.0
    at = np.sort(rng.uniform(size=count))
    at[[0, -1]] = 0.0, 1.0
    rail = {"radius_mm": 300, "start_deg": 10, "end_deg": 80, "centre_mm": [5, 6, 7]}
    said = {
        "rail": rail,
        "profiles": [{"at": float(a), "bspline_mm": c.tolist()} for a, c in zip(at, control, strict=True)],
    }
    u, v = rng.uniform(size=(2, 200))
    arc = ArcRail(0.3, np.deg2rad(10), np.deg2rad(80), np.array([0.005, 0.006, 0.007]))
    expected = LoftSurface("bspline", at, control / 1000.0, arc).points(u, v)
    np.testing.assert_allclose(loft_points(said, u, v), expected, atol=1e-12)


def test_a_rational_spline_is_that_of_its_definition(tmp_path) -> None:
    """Against ezdxf's B-splines, by which no path of it works."""
    path = drawing(tmp_path, "rational spline")
    (entity, *_) = ezdxf.readfile(path).modelspace()
    expected = np.array([tuple(p) for p in entity.construction_tool().approximate(500)])
    (curve,) = read_curves(path, 1.0, "0")
    assert max_distance(expected, curve.points) < 1e-3


def test_ezdxf_flattens_the_same_slanted_arc(tmp_path) -> None:
    """Against ezdxf's own geometry, without the planner."""
    path = drawing(tmp_path, "arc in a slanted plane")
    (entity, *_) = ezdxf.readfile(path).modelspace()
    expected = np.array([tuple(p) for p in ezpath.make_path(entity).flattening(1e-4)])
    (curve,) = read_curves(path, 1.0, "0")
    assert max_distance(expected, curve.points) < 12 * APPROXIMATE
