"""Airfoils against published ordinates and thin-airfoil theory; files in both formats, good and bad."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapely
import trimesh

from planner.geometry.rulings import outward_normals, tessellate
from planner.geometry.wing import (
    WingPanel,
    leading_point,
    naca_section,
    read_airfoil,
    section_guide,
    thickened,
    wing_surface,
)
from planner.issues import Issue, Severity, TandemError

# Abbott and von Doenhoff, Theory of Wing Sections (1959), appendix III: station, upper, lower [%]
NACA_2412 = """1.25 2.15 -1.65; 2.5 2.99 -2.27; 5 4.13 -3.01; 7.5 4.96 -3.46; 10 5.63 -3.75; 15 6.61 -4.10;
20 7.26 -4.23; 25 7.67 -4.22; 30 7.88 -4.12; 40 7.80 -3.80; 50 7.24 -3.34; 60 6.36 -2.76; 70 5.18 -2.14;
80 3.75 -1.50; 90 2.08 -0.82; 95 1.14 -0.48"""
NACA_23012 = """1.25 2.67 -1.23; 2.5 3.61 -1.71; 5 4.91 -2.26; 7.5 5.80 -2.61; 10 6.43 -2.92; 15 7.19 -3.50;
20 7.50 -3.97; 25 7.60 -4.28; 30 7.55 -4.46; 40 7.14 -4.48; 50 6.41 -4.17; 60 5.47 -3.67; 70 4.36 -3.00;
80 3.08 -2.16; 90 1.68 -1.23; 95 0.92 -0.70"""


@pytest.mark.parametrize(("digits", "table"), [("2412", NACA_2412), ("23012", NACA_23012)])
def test_sections_have_the_published_ordinates(digits: str, table: str) -> None:
    station, upper, lower = np.array([[float(v) for v in row.split()] for row in table.split(";")]).T
    points = 100.0 * naca_section(digits, 400)
    nose = leading_point(points)
    top, bottom = points[nose::-1], points[nose:]
    np.testing.assert_allclose(np.interp(station, *top.T), upper, atol=0.03)
    np.testing.assert_allclose(np.interp(station, *bottom.T), lower, atol=0.03)


def camber_slope(digits: str, theta: np.ndarray) -> np.ndarray:
    points = naca_section(digits, 20000)
    middle = 0.5 * (points[:20001][::-1] + points[20000:])
    x = 0.5 * (1.0 - np.cos(theta))
    return np.interp(x, 0.5 * (middle[1:, 0] + middle[:-1, 0]), np.diff(middle[:, 1]) / np.diff(middle[:, 0]))


@pytest.mark.parametrize(
    "digits", ["21010", "22010", "23010", "24010", "25010", "22110", "23110", "24110", "25110"]
)
def test_camber_lines_of_five_digits_have_their_design_lift_and_reflexed_ones_no_moment(digits: str) -> None:
    theta = (np.arange(20000) + 0.5) * np.pi / 20000
    slope = camber_slope(digits, theta)
    # thin-airfoil theory at the ideal angle of attack (Glauert 1926)
    first, second = (2.0 * np.mean(slope * np.cos(n * theta)) for n in (1, 2))
    assert np.pi * first == pytest.approx(0.3, abs=0.01)
    moment = -0.25 * np.pi * (first - second)
    if digits[2] == "1":
        assert abs(moment) < 0.0015
    else:
        assert moment < -0.003


def test_the_first_digit_scales_the_camber_and_the_trailing_edge_is_as_blunt_as_the_formula() -> None:
    weak, strong = naca_section("23012"), naca_section("43012")
    camber = [p + p[::-1] for p in (weak, strong)]
    assert camber[1][:, 1].max() == pytest.approx(2.0 * camber[0][:, 1].max(), rel=0.02)
    gap = np.linalg.norm(naca_section("0012")[0] - naca_section("0012")[-1])
    assert gap == pytest.approx(0.00252, abs=1e-6)


@pytest.mark.parametrize(
    "digits", ["24", "241200", "2x12", "2012", "2400", "2490", "26012", "03012", "23212"]
)
def test_digits_without_a_section_are_refused(digits: str) -> None:
    with pytest.raises(TandemError) as caught:
        naca_section(digits)
    assert caught.value.issues[0].code == "part.naca"


def written(folder: Path, points: np.ndarray, head: str = "A SECTION") -> Path:
    path = folder / "foil.dat"
    path.write_text(head + "\n" + "\n".join(f" {x:.7f}  {y:.7f}" for x, y in points) + "\n")
    return path


def read(path: Path) -> tuple[np.ndarray, list[Issue]]:
    return read_airfoil(path, "part.wing.root.file")


def test_both_formats_give_the_same_section(tmp_path: Path) -> None:
    points = naca_section("2412", 30)
    selig, notes = read(written(tmp_path, points))
    assert notes == []
    np.testing.assert_allclose(selig, points, atol=1e-7)
    top, bottom = points[30::-1], points[30:]
    lines = ["LEDNICER", " 31.  31.", ""]
    lines += [f"{x:.7f} {y:.7f}" for x, y in top] + [""] + [f"{x:.7f},{y:.7f}" for x, y in bottom]
    path = tmp_path / "lednicer.dat"
    path.write_text("\r\n".join([*lines, "", "from a catalogue, 1 of 2", ""]))
    lednicer, notes = read(path)
    assert notes == []
    np.testing.assert_allclose(lednicer, points, atol=1e-7)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda p: p[::-1], "began with the lower side"),
        (lambda p: np.concatenate([p[30:], p[:31]]), "leading edge"),
        (lambda p: 250.0 * p + [10.0, 3.0], "chord"),
        (lambda p: np.repeat(p, 2, axis=0), "repeat"),
    ],
)
def test_what_can_be_put_right_is_put_right_and_told(change, word: str, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    points = naca_section("2412", 30)
    got, notes = read(written(tmp_path, change(points)))
    assert [(n.code, n.severity) for n in notes] == [("part.airfoil_note", Severity.NOTE)]
    assert word in notes[0].message
    level = got - [0.0, got[leading_point(got), 1]]
    np.testing.assert_allclose(level[:31:10], points[:31:10], atol=1.2e-3)
    assert len(got) == len(points)


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (lambda p: p[:31], "part.airfoil_open"),
        (lambda p: p[:-4], "part.airfoil_open"),
        (lambda p: p[np.random.default_rng(3).permutation(61)], "part.airfoil_order"),
        (lambda p: p[::5], "part.airfoil_points"),
        (lambda p: np.concatenate([p[:10], p[5:]]), "part.airfoil_order"),
        (lambda p: np.where((p[:, :1] > 0.4) & (p[:, :1] < 0.7), p * [1, -1], p), "part.airfoil_crossing"),
    ],
)
def test_what_cannot_is_refused_by_name(change, code: str, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(TandemError) as caught:
        read(written(tmp_path, change(naca_section("2412", 30))))
    issue = caught.value.issues[0]
    assert issue.code == code
    assert issue.field == "part.wing.root.file"


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("only a name\n", "part.airfoil_format"),
        ("name\n20 20\n" + "0.5 0.1\n" * 30, "part.airfoil_format"),
        ("name\n1 0\n0.5 0.1\nhello\n0 0\n", "part.airfoil_format"),
        ("name\n1 0\n0.5 1e999\n0 0\n", "part.airfoil_format"),
        ("name\n" + "\n".join(f"0.5 {v / 40}" for v in range(40)), "part.airfoil_format"),
        ("name\n17 17\n" + "\n".join(f"{1 - v / 16} 0.1" for v in range(17)) * 2, "part.airfoil_format"),
        (
            "name\n17 17\n" + "\n".join(f"{(1 - v % 17 / 16)} {0.1 - 0.01 * v}" for v in range(34)),
            "part.airfoil_order",
        ),
    ],
)
def test_files_in_neither_format_are_refused(text: str, code: str, tmp_path: Path) -> None:
    path = tmp_path / "foil.dat"
    path.write_text(text)
    with pytest.raises(TandemError) as caught:
        read(path)
    assert caught.value.issues[0].code == code


def test_files_that_are_not_there_or_too_large_are_refused(tmp_path: Path) -> None:
    with pytest.raises(TandemError, match=r"problem\.missing_file"):
        read(tmp_path / "none.dat")
    path = tmp_path / "large.dat"
    path.write_bytes(b"0.5 0.5\n" * 300_000)
    with pytest.raises(TandemError, match=r"problem\.too_large"):
        read(path)


def test_a_coarse_file_is_smoothed_by_a_spline(tmp_path: Path) -> None:
    coarse, _ = read(written(tmp_path, naca_section("2412", 30)))
    fine = 0.2 * naca_section("2412", 2000)
    guide = section_guide(coarse, 0.2, 1e-6, blunt=True)
    outline = shapely.LinearRing(guide.points[:, :2])
    assert shapely.distance(shapely.points(fine), outline).max() < 2e-5


def test_a_trailing_edge_is_thickened_to_what_foam_can_hold() -> None:
    points = naca_section("0012")
    thick = thickened(points, 0.01)
    assert np.linalg.norm(thick[0] - thick[-1]) == pytest.approx(0.01)
    np.testing.assert_allclose(thick[160], points[160])
    assert thickened(points, 0.001) is points


def test_a_plain_wing_has_its_volume_and_faces_outwards() -> None:
    section = naca_section("0012", 400)
    wing = wing_surface(WingPanel(section, section, 0.2, 0.1, 0.3))
    mesh = tessellate(wing)
    x, y = section.T
    area = 0.5 * abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
    # a frustum between similar sections: V = h / 3 (A + sqrt(A B) + B); the skin alone, closed by two lids
    volume = 0.3 / 3.0 * area * (0.04 + 0.02 + 0.01)
    body = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    centre = np.array([0.08, 0.15, 0.0])
    assert (np.sum(body.face_normals * (body.triangles_center - centre), axis=1)[:, None] > 0).mean() > 0.98
    lids = 0.0  # of the flux of (x, y, z) / 3 through the planes y = 0 and y = 0.3
    lids += area * 0.01 * 0.3 / 3.0
    flux = np.sum(body.area_faces * np.sum(body.face_normals * body.triangles_center, axis=1)) / 3.0
    assert flux + lids == pytest.approx(volume, rel=2e-3)


def test_a_wing_joins_leading_edges_and_places_its_tip() -> None:
    panel = WingPanel(
        naca_section("2412"),
        naca_section("23112"),
        0.2,
        0.12,
        0.4,
        sweep=np.deg2rad(12.0),
        twist=np.deg2rad(3.0),
        dihedral=np.deg2rad(4.0),
        trailing_edge=0.0015,
    )
    wing = wing_surface(panel)
    assert wing.closed
    assert wing.corner.sum() == 2
    first, second = np.flatnonzero(wing.corner)
    for ends in (wing.start, wing.end):
        assert np.linalg.norm(ends[first] - ends[second]) == pytest.approx(0.0015, rel=2e-3)
    np.testing.assert_array_equal(wing.start[:, 1], 0.0)
    np.testing.assert_allclose(wing.end[:, 1], 0.4)
    root_tail, tip_tail = (0.5 * (e[first] + e[second]) for e in (wing.start, wing.end))
    np.testing.assert_allclose(root_tail, [0.2, 0.0, 0.0], atol=1e-4)
    quarter = np.array([0.05 + 0.4 * np.tan(np.deg2rad(12.0)), 0.4, 0.4 * np.tan(np.deg2rad(4.0))])
    rear = tip_tail - quarter
    np.testing.assert_allclose(np.linalg.norm(rear), 0.75 * 0.12, atol=1e-4)
    # washout: the nose is down, so the tail is up
    assert np.rad2deg(np.arctan2(rear[2], rear[0])) == pytest.approx(3.0, abs=0.1)
    nose = [
        np.argmax(np.linalg.norm(e - t, axis=1)) for e, t in ((wing.start, root_tail), (wing.end, tip_tail))
    ]
    assert nose[0] == nose[1]
    top = wing.start[:, 2] > 0.01
    assert (outward_normals(wing)[0][top][:, 2] > 0).all()


def test_a_sharp_and_a_blunt_section_share_two_corners() -> None:
    blunt, sharp = naca_section("0012"), naca_section("0012").copy()
    sharp[[0, -1], 1] = 0.0
    wing = wing_surface(WingPanel(blunt, sharp, 0.2, 0.2, 0.1))
    first, second = np.flatnonzero(wing.corner)
    np.testing.assert_allclose(wing.end[first], wing.end[second], atol=1e-12)
    assert np.linalg.norm(wing.start[first] - wing.start[second]) > 4e-4
    assert np.isfinite(np.concatenate(outward_normals(wing))).all()
    both = wing_surface(WingPanel(sharp, sharp, 0.2, 0.2, 0.1))
    assert both.corner.sum() == 1
