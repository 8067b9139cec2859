"""Scans of a known part: accuracy of pose and field, and what is refused. The truth is synthetic."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
import shapely
import trimesh
from scipy.spatial.transform import Rotation

from planner.geometry.arrays import FloatArray, Mesh
from planner.geometry.units import MM
from planner.issues import Severity, TandemError
from planner.problem import FormedPart, Part
from planner.proof.part_files.meshes import read_points
from planner.shopfloor.align.probing import ProbedPoints
from planner.shopfloor.scan import cloud, deviation, freedoms
from planner.shopfloor.scan.cloud import Cloud
from tests import small_forming
from tests.processes.forming.plan.shapes import pit
from tests.shopfloor.scan.synthetic_scan import Field, SyntheticScan, make_scan, write_ply

SIZE = np.array([160.0, 160.0, 1.0]) * MM
DEEP = 6.0 * MM


@pytest.fixture(scope="module")
def dish() -> Mesh:
    return small_forming.dish(around=120)


def part(mesh: Mesh) -> Part:
    return Part(formed=FormedPart(mesh))


def springs(q: FloatArray) -> FloatArray:
    """More with depth, three crests around, as if a clamp gave way there."""
    depth = np.clip((SIZE[2] - q[:, 2]) / DEEP, 0.0, 1.0)
    distance = np.minimum(np.hypot(q[:, 0], q[:, 1]) / 0.015, 1.0)
    return 0.7 * MM * np.sqrt(depth) * (1.0 + 0.4 * distance * np.sin(3.0 * np.arctan2(q[:, 1], q[:, 0])))


def tilts(q: FloatArray) -> FloatArray:
    """A part that springs back on one side: a fit to the whole part would hide this in the pose."""
    depth = np.clip((SIZE[2] - q[:, 2]) / DEEP, 0.0, 1.0)
    return depth * (0.5 * MM + 20.0 * MM * q[:, 0])


def fit_scan(sample: SyntheticScan, mesh: Mesh, marks: bool = True) -> tuple[FloatArray, deviation.Deviation]:
    known = ProbedPoints(("a", "b", "c", "d"), sample.sheet, sample.scan) if marks else None
    whole = Cloud("scan.ply", "0" * 64, sample.points, 0)
    pose, found = deviation.of_part(whole, part(mesh), SIZE, known, True)
    return pose.matrix, found


@pytest.mark.parametrize(("true_deviation", "seed"), [(springs, 1), (springs, 2), (tilts, 3)])
def test_a_known_field_and_pose_come_back(dish: Mesh, true_deviation: Field, seed: int) -> None:
    made = make_scan(dish, SIZE, true_deviation, seed, hole=(0.02, 0.0, 0.006))
    pose, found = fit_scan(made, dish)
    wrong = pose @ np.linalg.inv(made.pose)
    assert np.abs(wrong[:3, 3]).max() < 0.05 * MM
    assert np.degrees(Rotation.from_matrix(wrong[:3, :3]).magnitude()) < 0.05
    known = np.isfinite(found.deviation)
    error = found.deviation[known] - true_deviation(found.point[known])
    assert np.sqrt(np.mean(error**2)) < 0.05 * MM
    assert np.abs(error).max() < 0.2 * MM
    assert known.mean() > 0.95
    # a tenth is stray by up to 10 mm each way, some of it too near to tell
    assert 0.07 * found.used < found.stray < 0.12 * found.used
    assert 0.04 * MM < found.noise < 0.08 * MM
    (hole,) = found.holes
    np.testing.assert_allclose(hole.position[:2], [0.02, 0.0], atol=1.5 * MM)
    assert 6.0 * MM < hole.across < 14.0 * MM


def test_without_marks_height_and_tilt_are_found_and_said(dish: Mesh) -> None:
    made = make_scan(dish, SIZE, springs, 4, turn=(0.002, -0.003, 0.0))
    shifted = replace_points(
        made, made.points + made.pose[:3, 3] @ made.pose[:3, :3] + np.array([0.0, 0.0, 0.002])
    )
    pose, found = fit_scan(shifted, dish, marks=False)
    assert abs(pose[2, 3] + 0.002) < 0.02 * MM
    np.testing.assert_allclose(pose[:3, :3], made.pose[:3, :3], atol=1e-4)
    known = np.isfinite(found.deviation)
    assert np.sqrt(np.mean((found.deviation[known] - springs(found.point[known])) ** 2)) < 0.05 * MM
    whole = Cloud("scan.ply", "0" * 64, shifted.points, 0)
    told, more = deviation.of_part(whole, part(dish), SIZE, None, True)
    (issue,) = freedoms.issues(more, told, "scan.ply")
    assert issue.code == "scan.no_marks"
    assert issue.severity is Severity.WARNING
    assert "x, y and the rotation about z are taken as the scan has them" in issue.message
    assert "the rotation cannot be observed on this part" in issue.message  # it is round
    assert np.isinf(told.within[[2, 3, 4]]).all()
    assert (told.within[[0, 1, 5]] < [1e-5, 1e-5, 0.001 * MM]).all()
    # walls of 40 degrees
    assert f"Each mm of offset adds up to {np.sin(np.radians(40.0)):.2f} mm" in issue.message
    freedoms.require_place(more, told, "scan.ply")
    # a scan that lies 3 mm beside the part is off by that on every wall, less where a wall ends
    moved = dataclasses.replace(whole, points=shifted.points + np.array([0.003, 0.0, 0.0]))
    told, more = deviation.of_part(moved, part(dish), SIZE, None, True)
    (issue,) = freedoms.issues(more, told, "scan.ply")
    x, y = re.search(r"offset by \(([-0-9.]+), ([-0-9.]+)\) mm from", issue.message).groups()  # type: ignore[union-attr]
    np.testing.assert_allclose([float(x), float(y)], [3.0, 0.0], atol=0.5)
    with pytest.raises(TandemError, match="targets would be moved by the scan's offset") as error:
        freedoms.require_place(more, told, "scan.ply")
    assert error.value.issues[0].code == "scan.no_marks"
    # marks, as is advised, put it where it is
    known = made.scan + made.pose[:3, 3] @ made.pose[:3, :3] + np.array([0.003, 0.0, 0.002])
    told, more = deviation.of_part(
        moved, part(dish), SIZE, ProbedPoints(tuple("abcd"), made.sheet, known), True
    )
    assert freedoms.issues(more, told, "scan.ply") == []
    freedoms.require_place(more, told, "scan.ply")


def test_a_turn_shows_on_a_part_that_is_not_round() -> None:
    """A trough of 45 degrees, 100 x 30 mm: turned by a degree about its middle, and that alone."""
    trough = pit(shapely.box(-0.05, -0.015, 0.05, 0.015), 45.0, 0.008)
    made = make_scan(
        trough, SIZE * [1.2, 1, 1], lambda q: np.zeros(len(q)), 4, stray=0.0, turn=(0.0, 0.0, 0.0)
    )
    turn = Rotation.from_rotvec([0.0, 0.0, np.radians(1.0)]).as_matrix()
    whole = Cloud("scan.ply", "0" * 64, (made.points + made.pose[:3, 3]) @ turn.T, 0)
    pose, found = deviation.of_part(whole, part(trough), SIZE * [1.2, 1, 1], None, True)
    seen = freedoms.in_plane_motion(found)
    assert abs(np.degrees(seen.turn) - 1.0) < 0.15
    assert np.abs(seen.move).max() < 0.05 * MM
    assert seen.fraction > 0.8
    assert not seen.hidden
    with pytest.raises(TandemError, match=r"rotated by (0\.[89]|1\.)\d* deg"):
        freedoms.require_place(found, pose, "scan.ply")


def test_marks_say_how_well_a_scan_lies_and_which_of_them_is_doubted(dish: Mesh) -> None:
    """Four marks at the corners of a rectangle, each known to 0.02 mm: the mean of them to half of that."""
    made = make_scan(dish, SIZE, springs, 8)
    names = ("a", "b", "c", "d")
    whole = Cloud("scan.ply", "0" * 64, made.points, 0)
    pose, found = deviation.of_part(whole, part(dish), SIZE, ProbedPoints(names, made.sheet, made.scan), True)
    assert 0.25 < pose.position_sigma / (np.sqrt(2.0) * 0.01 * MM) < 2.0
    assert freedoms.issues(found, pose, "scan.ply") == []
    far = made.scan.copy()
    far[2, 0] += 1.0 * MM
    pose, found = deviation.of_part(whole, part(dish), SIZE, ProbedPoints(names, made.sheet, far), True)
    assert pose.doubtful == ("c",)
    (issue,) = freedoms.issues(found, pose, "scan.ply")
    assert issue.code == "scan.marks"
    assert "'c' is 0." in issue.message
    assert "without 'c' the others agree" in issue.message
    assert issue.limit == 0.05
    wrong = pose.matrix @ np.linalg.inv(made.pose)
    assert np.linalg.norm(wrong[:2, 3]) < 3.0 * issue.value * MM


def test_what_is_too_shallow_is_told_where_the_tool_is(dish: Mesh) -> None:
    """Springback grows along a wall: scan points are above the point that sank less, not the nearest one."""

    def grows(q: FloatArray) -> FloatArray:
        return np.asarray(np.clip((1.0 * MM - q[:, 2]) / (6.0 * MM), 0.0, 1.0) * 2.0 * MM)

    made = make_scan(dish, SIZE, grows, 9, noise=0.0, stray=0.0, marks=0.0, along_z=True)
    _, found = fit_scan(made, dish)
    wall = found.point[(found.normal[:, 2] < 0.9) & (found.point[:, 2] < -1.0 * MM)]
    above = found.along_z(wall)
    known = np.isfinite(above)
    assert known.mean() > 0.9
    assert np.median(np.abs(above[known] - grows(wall[known]))) < 0.03 * MM


def replace_points(
    sample: SyntheticScan, points: FloatArray, scan: FloatArray | None = None
) -> SyntheticScan:
    return SyntheticScan(points, sample.pose, sample.sheet, sample.scan if scan is None else scan)


def test_scans_that_are_none_of_the_part_are_refused_by_what_they_are(dish: Mesh) -> None:
    tilt = trimesh.Trimesh(dish.vertices, dish.faces, process=False)
    slab = Mesh(tilt.vertices * [1.0, 1.0, -4.0], tilt.faces[:, ::-1])
    made = make_scan(dish, SIZE, springs, 5)
    groove = pit(shapely.box(-0.03, -0.01, 0.03, 0.01).buffer(0.006), 45.0, DEEP)
    alike = make_scan(groove, SIZE, springs, 5)
    other = make_scan(slab, SIZE, lambda q: np.zeros(len(q)), 5)
    there = made.points @ made.pose[:3, :3].T + made.pose[:3, 3]
    flat_gone = np.abs(there[:, 2] - SIZE[2]) > 4.0 * MM
    flat_alone = np.hypot(there[:, 0], there[:, 1]) > np.hypot(*dish.vertices[:, :2].T).max() + 2.0 * MM
    corner = (there[:, 0] > 0.005) & (there[:, 1] > 0.005)
    for name, scan, code, words in (
        ("other", other, "scan.other_part", "name the result folder of the scanned part"),
        (
            "inches",
            replace_points(made, made.points / 25.4, made.scan / 25.4),
            "scan.unit",
            "in 'in' the sizes",
        ),
        ("metres", replace_points(made, made.points / 1e3, made.scan / 1e3), "scan.unit", "in 'm' the sizes"),
        ("marks in metres", replace_points(made, made.points, made.scan * 1000.0), "align.units", "in mm"),
        (
            "mirrored",
            replace_points(made, made.points * [-1, 1, 1], made.scan * [-1, 1, 1]),
            "scan.other_part",
            "mirrored along z",  # its marks are in a plane, and fit when it is turned over
        ),
        (
            "mirrored beside its marks",
            replace_points(made, made.points * [-1, 1, 1]),
            "scan.flat",
            "with the sign of x reversed in the scan it would fit",
        ),
        (
            "inside out",
            replace_points(made, made.points, made.scan * [1, -1, 1]),
            "scan.flat",
            "a wrong sign of y",
        ),
        (
            "a blank",
            replace_points(made, made.points[flat_alone]),
            "scan.other_part",
            "shows only the flat around the part",
        ),
        ("as deep", alike, "scan.other_part", "places of the same nominal depth differ"),
        (
            "no flat",
            replace_points(made, made.points[flat_gone]),
            "scan.flat",
            "scan the flat around the part",
        ),
        ("a part of it", replace_points(made, made.points[corner]), "scan.other_part", "scan the whole part"),
    ):
        with pytest.raises(TandemError) as error:
            fit_scan(scan, dish)
        issue = error.value.issues[0]
        assert issue.code == code, (name, issue.message)
        assert words in f"{issue.message} {issue.hint}", (name, issue.message)


@pytest.mark.parametrize(("axis", "factor"), [("x", [-1.0, 1.0, 1.0]), ("z", [1.0, 1.0, -1.0])])
def test_a_mirrored_scan_in_the_right_place_is_called_so(dish: Mesh, axis: str, factor: list[float]) -> None:
    """Without marks, or with coplanar marks, which fit their mirror image: only the formed shape shows it."""
    groove = dish.vertices.copy()
    groove[:, 2] *= 1.0 + 0.9 * np.tanh(groove[:, 0] / 0.01)
    uneven = Mesh(groove, dish.faces)
    made = make_scan(uneven, SIZE, lambda q: np.zeros(len(q)), 6, 40_000, turn=(0.0, 0.0, 0.0))
    there = made.points + made.pose[:3, 3]
    scan = Cloud("scan.ply", "0" * 64, there * factor, 0)
    with pytest.raises(TandemError, match=f"mirrored along {axis} it would be") as error:
        deviation.of_part(scan, part(uneven), SIZE, None, True)
    assert error.value.issues[0].code == "scan.other_part"


def test_the_other_face_is_told_by_marks(dish: Mesh) -> None:
    made = make_scan(dish, SIZE * [1, 1, 8], springs, 7)
    known = ProbedPoints(("a", "b", "c", "d"), made.sheet, made.scan)
    with pytest.raises(TandemError) as error:
        deviation.of_part(Cloud("s", "", made.points, 0), part(dish), SIZE * [1, 1, 8], known, False)
    assert error.value.issues[0].code == "scan.flat"
    assert "--face" in str(error.value.issues[0].hint)


def test_all_kinds_of_files_say_the_same(tmp_path: Path) -> None:
    points = np.random.default_rng(1).normal(size=(3000, 3)).astype(np.float32).astype(np.float64)
    write_ply(tmp_path / "a.ply", points, 1.0)
    np.savetxt(tmp_path / "b.xyz", points, fmt="%.9g")
    np.savetxt(tmp_path / "c.txt", np.column_stack([points, points]), delimiter=";", header="x;y;z")
    rows = "".join(f"v {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in points)
    (tmp_path / "d.obj").write_text(f"# a scan\n{rows}")
    faces = np.arange(3000).reshape(-1, 3)
    trimesh.Trimesh(points, faces, process=False).export(tmp_path / "e.stl")
    plain = "".join(f"{x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in points)
    (tmp_path / "f.xyz").write_text(f"3000\n{plain}")  # as PTS files begin
    (tmp_path / "g.txt").write_text(f"x y z\n{plain}", encoding="utf-8-sig")
    (tmp_path / "h.txt").write_text(f'"X","Y","Z"\n{plain}'.replace(" ", ","), encoding="utf-16")
    (tmp_path / "i.xyz").write_bytes(f"# B\xfcro\n{plain}".encode("latin-1"))
    (tmp_path / "j.obj").write_bytes(f"# B\xfcro\n{rows}".encode("latin-1"))
    for path in sorted(tmp_path.iterdir()):
        result = cloud.read(path, 0.001)
        assert result.file == path.name
        a, b = (item[np.lexsort(item.T)] for item in (result.points, 0.001 * points))
        np.testing.assert_allclose(a, b, atol=1e-9)
        again = 0.001 * read_points(path)  # as the proof reads it
        np.testing.assert_allclose(again[np.lexsort(again.T)], b, atol=1e-9)


def test_bad_files_are_refused_in_words(tmp_path: Path) -> None:
    write_ply(tmp_path / "few.ply", np.zeros((10, 3)))
    whole = write_ply(tmp_path / "whole.ply", np.random.default_rng(1).normal(size=(3000, 3)))
    (tmp_path / "cut.ply").write_bytes(whole.read_bytes()[:5000])
    (tmp_path / "other.xyz").write_text("x y z\n" * 2 + "1 2 3\n" * 2000)
    (tmp_path / "words.xyz").write_text("these are no points\n" * 2000)
    (tmp_path / "empty.obj").write_text("")
    (tmp_path / "commas.txt").write_text("1,5; 2,25; -3,0\n" * 2000)
    write_ply(tmp_path / "none.ply", np.zeros((0, 3)))
    (tmp_path / "scan.e57").write_text("x")
    nan = np.full((3000, 3), np.nan)
    write_ply(tmp_path / "nan.ply", nan)
    for name, words in (
        ("few.ply", "got 10 points, allowed 1000"),
        ("cut.ply", "cannot be read"),
        ("words.xyz", "cannot be read"),
        ("other.xyz", "cannot be read"),
        ("commas.txt", "it has decimal commas"),
        ("none.ply", "got 0 points"),
        ("empty.obj", "no points"),
        ("scan.e57", "allowed .ply, .xyz"),
        ("nan.ply", "got 0 points"),
        ("gone.ply", "no such file"),
    ):
        with pytest.raises(TandemError) as error:
            cloud.read(tmp_path / name, MM)
        (issue,) = error.value.issues
        assert issue.code == "scan.file"
        assert words in issue.message, (name, issue.message)
