"""Arcs of G-code against closed forms: every point on the circle, every chord within its error."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.processes.milling.plan.gcode import moves
from tests.processes.milling.plan.gcode.gcode_programs import HEAD, read

PLANES = {"G17": "XYZ IJ", "G18": "ZXY KI", "G19": "YZX JK"}


@pytest.mark.parametrize("code", PLANES)
@pytest.mark.parametrize("arc_code", ["G2", "G3"])
def test_a_quarter_in_each_plane(tmp_path: Path, code: str, arc_code: str) -> None:
    """From (10, 0) about the origin of the plane, whose axes are right-handed with its normal: G3 leads to
    (0, 10), G2 to (0, -10), seen from the end of the normal (ISO 6983-1)."""
    (first, second, normal), (centre, _) = PLANES[code].split()
    end = 10 if arc_code == "G3" else -10
    text = (
        f"{code} G0 {first}10 {second}0 {normal}0\n{arc_code} {first}0 {second}{end} {normal}4 {centre}-10\n"
    )
    path = read(tmp_path, HEAD + text).path
    a, b, c = ("XYZ".index(axis) for axis in (first, second, normal))
    tip = path.tip[1:] * 1e3
    np.testing.assert_allclose(np.hypot(tip[:, a], tip[:, b]), 10.0, atol=1e-9)
    angle = np.arctan2(tip[:, b] * np.sign(end), tip[:, a])
    assert (angle > 0).all() and (angle < np.pi / 2 + 1e-9).all()
    np.testing.assert_allclose(tip[:, c], 4.0 * angle / (np.pi / 2), atol=1e-9)
    assert set(path.kind[1:]) == {"arc"}


def test_a_full_circle_by_its_centre(tmp_path: Path) -> None:
    path = read(tmp_path, HEAD + "G0 X10 Y5 Z0\nG2 I-10 J0\n", chord_tol_mm=0.01).path
    tip = path.tip * 1e3
    np.testing.assert_allclose(np.hypot(tip[:, 0], tip[:, 1] - 5.0), 10.0, atol=1e-9)
    np.testing.assert_allclose(tip[-1], [10, 5, 0], atol=1e-12)
    length = np.linalg.norm(np.diff(tip, axis=0), axis=1).sum()
    np.testing.assert_allclose(length, 20 * np.pi, rtol=1e-3)
    assert tip[1, 1] < 5.0  # clockwise


@pytest.mark.parametrize(("radius", "arc_code", "middle"), [(10, "G3", 1), (-10, "G3", -1), (10, "G2", -1)])
def test_arcs_by_radius(tmp_path: Path, radius: float, arc_code: str, middle: int) -> None:
    """From (10, 0) to (0, 10): about (0, 0) or about (10, 10), the short or the long way round."""
    path = read(tmp_path, HEAD + f"G0 X10 Y0 Z0\n{arc_code} X0 Y10 R{radius}\n").path
    tip = path.tip * 1e3
    centre = np.array([0.0, 0.0]) if middle == 1 else np.array([10.0, 10.0])
    np.testing.assert_allclose(np.linalg.norm(tip[:, :2] - centre, axis=1), 10.0, atol=1e-9)
    sweep = 2.0 * np.arcsin(np.linalg.norm(np.diff(tip, axis=0), axis=1) / 20.0).sum()
    np.testing.assert_allclose(np.rad2deg(sweep), 90.0 if radius > 0 else 270.0, atol=1e-9)


def test_absolute_and_incremental_centres(tmp_path: Path) -> None:
    offsets = {"G54": [100, 0, 0]}
    start = HEAD + "G54 G0 X10 Y0 Z0\n"
    incremental = read(tmp_path, start + "G3 X0 Y10 I-10 J0\n", offsets=offsets).path
    by_word = read(tmp_path, start + "G90.1 G3 X0 Y10 I0 J0\n", offsets=offsets).path
    by_field = read(tmp_path, start + "G3 X0 Y10 I0 J0\n", offsets=offsets, arc_centre="absolute").path
    np.testing.assert_allclose(by_word.tip, incremental.tip, atol=1e-15)
    np.testing.assert_allclose(by_field.tip, incremental.tip, atol=1e-15)


def test_radii_that_differ_by_rounding_leave_no_jump(tmp_path: Path) -> None:
    path = read(tmp_path, HEAD + "G0 X10.004 Y0 Z0\nG3 X0 Y9.996 I-10.004\n").path
    tip = path.tip * 1e3
    radius = np.hypot(tip[:, 0], tip[:, 1])
    assert (np.diff(radius) <= 1e-12).all()
    np.testing.assert_allclose(radius[[0, -1]], [10.004, 9.996], atol=1e-9)


@settings(max_examples=150, deadline=None)
@given(
    radius=st.floats(1e-4, 5.0),
    start_angle=st.floats(-3.1, 3.1),
    turn=st.floats(0.01, 6.27),
    clockwise=st.booleans(),
    normal=st.sampled_from([0, 1, 2]),
    chord=st.floats(1e-6, 1e-4),
)
def test_chords_and_centres(
    radius: float, start_angle: float, turn: float, clockwise: bool, normal: int, chord: float
) -> None:
    """The sagitta r (1 - cos(w / 2)) of every piece is within the chord error; R gives the centre again."""
    a, b = (normal + 1) % 3, (normal + 2) % 3
    sweep = -turn if clockwise else turn
    ends = []
    for angle in (start_angle, start_angle + sweep):
        point = [0.0, 0.0, 0.0]
        point[a], point[b] = 0.3 + radius * math.cos(angle), -0.2 + radius * math.sin(angle)
        ends.append(point)
    start, end = ends
    got = moves.arc_sweep(start, end, (0.3, -0.2), normal, clockwise)
    assert math.isclose(got, sweep, rel_tol=1e-6, abs_tol=1e-6 / radius)
    points = np.vstack([start, moves.arc_points(start, end, (0.3, -0.2), got, normal, chord)])
    chords = np.linalg.norm(np.diff(points, axis=0), axis=1)
    sagitta = radius * (1.0 - np.sqrt(np.clip(1.0 - (chords / (2 * radius)) ** 2, 0.0, 1.0)))
    assert (sagitta <= chord * (1 + 1e-6) + 1e-12).all()
    if abs(turn - math.pi) > 0.05 and radius > 1e-3:
        by_radius = moves.arc_centre(start, end, radius if turn < math.pi else -radius, normal, clockwise)
        np.testing.assert_allclose(by_radius, (0.3, -0.2), atol=1e-6)
