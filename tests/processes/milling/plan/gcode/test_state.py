"""Rotary axes: each convention against rotation matrices from SciPy, and tool axes between angles."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from planner.processes.milling.plan.gcode.state import KINEMATICS, find_convention, piece_counts
from tests.processes.milling.plan.gcode.gcode_programs import HEAD, read

Z = np.array([0.0, 0.0, 1.0])
# from the part outwards: what turns the tool by its angle, what turns the part and so the tool by the inverse
CHAINS = {
    "head_a": "A",
    "head_b": "B",
    "head_ca": "CA",
    "head_cb": "CB",
    "head_ab": "AB",
    "head_ba": "BA",
    "table_a": "a",
    "table_b": "b",
    "table_ac": "ca",
    "table_bc": "cb",
    "head_a_table_c": "cA",
    "head_b_table_c": "cB",
}
ANGLE = st.floats(-200, 200)


@pytest.mark.parametrize("name", KINEMATICS)
@settings(max_examples=40, deadline=None)
@given(angles=st.tuples(ANGLE, ANGLE, ANGLE))
def test_axes_are_products_of_rotations(name: Any, angles: tuple[float, float, float]) -> None:
    """A capital turns the tool, a small letter the part."""
    expected = Z
    for letter in reversed(CHAINS[name]):
        i = "ABC".index(letter.upper())
        turn = Rotation.from_euler("xyz"[i], angles[i], degrees=True)
        expected = (turn if letter.isupper() else turn.inv()).apply(expected)
    got = find_convention(name, "").axis(np.deg2rad([angles]))
    np.testing.assert_allclose(got, [expected], atol=1e-12)


@pytest.mark.parametrize(
    ("name", "reverse", "words", "axis"),
    [
        # A tilts the tool's upper end to -y; C then turns -y to +x
        ("head_ca", "", "A30 C0", [0, -0.5, np.sqrt(0.75)]),
        ("head_ca", "", "A30 C90", [0.5, 0, np.sqrt(0.75)]),
        ("head_ca", "A", "A30 C90", [-0.5, 0, np.sqrt(0.75)]),
        ("head_cb", "", "B30 C90", [0, 0.5, np.sqrt(0.75)]),
        ("head_ab", "", "A90 B30", [0.5, -np.sqrt(0.75), 0]),
        ("head_ba", "", "A30 B90", [np.sqrt(0.75), -0.5, 0]),
        ("table_ac", "", "A30 C0", [0, 0.5, np.sqrt(0.75)]),
        ("table_ac", "AC", "A30 C90", [0.5, 0, np.sqrt(0.75)]),
        ("head_b_table_c", "", "B30 C90", [0, -0.5, np.sqrt(0.75)]),
    ],
)
def test_axes_by_hand(tmp_path: Path, name: str, reverse: str, words: str, axis: list[float]) -> None:
    stated = {"tool_axis": "rotary", "convention": name, "reverse": list(reverse)}
    path = read(tmp_path, HEAD + f"G0 X0 Y0 Z0 {words}\n", **stated).path
    np.testing.assert_allclose(path.axis[-1], axis, atol=1e-12)


def test_angles_by_g91_add_up(tmp_path: Path) -> None:
    stated = {"tool_axis": "rotary", "convention": "head_a"}
    path = read(tmp_path, HEAD + "G0 X0 Y0 Z0 A10\nG91 A20\nA-60\n", **stated).path
    got = np.rad2deg(np.arctan2(-path.axis[:, 1], path.axis[:, 2]))
    np.testing.assert_allclose(got[[0, -1]], [10, -30], atol=1e-9)


@settings(max_examples=60, deadline=None)
@given(
    start=st.tuples(ANGLE, ANGLE, ANGLE),
    change=st.tuples(ANGLE, ANGLE, ANGLE),
    tolerance=st.floats(1e-4, 1e-2),
    name=st.sampled_from(["head_ca", "head_ab", "table_bc"]),
)
def test_between_pieces_the_axis_is_on_the_great_circle(
    start: tuple[float, float, float], change: tuple[float, float, float], tolerance: float, name: Any
) -> None:
    """Evenly turning angles against the shortest turn between the ends of each piece, by SciPy."""
    own = find_convention(name, "")
    used = np.array([letter in own.letters for letter in "ABC"])
    first, turn = np.deg2rad(start), np.where(used, np.deg2rad(change), 0.0)
    count = int(piece_counts(turn[None], tolerance)[0])
    ends = own.axis(first + np.linspace(0, 1, count + 1)[:, None] * turn)
    fraction = np.linspace(0, 1, 9)
    for i in range(0, count, max(count // 5, 1)):
        really = own.axis(first + ((i + fraction) / count)[:, None] * turn)
        about, size = np.cross(ends[i], ends[i + 1]), 0.0
        size = float(np.arctan2(np.linalg.norm(about), ends[i] @ ends[i + 1]))
        unit = about / max(float(np.linalg.norm(about)), 1e-15)
        straight = Rotation.from_rotvec(fraction[:, None] * size * unit).apply(ends[i])
        deviation = np.linalg.norm(np.cross(really, straight), axis=1)
        assert deviation.max() <= tolerance * 1.01


def test_a_turn_goes_along_with_the_way(tmp_path: Path) -> None:
    stated = {"tool_axis": "rotary", "convention": "head_ca", "angle_tol_deg": 0.02}
    program = read(tmp_path, HEAD + "G0 X0 Y0 Z0 A30 C0\nM0\nG1 X90 C90\nM0\nX100\n", **stated)
    path = program.path
    assert len(path) > 20
    cut = path.line == 6
    np.testing.assert_allclose(
        np.rad2deg(np.arctan2(path.axis[cut, 1], path.axis[cut, 0])) + 90.0, path.tip[cut, 0] * 1e3, atol=1e-6
    )
    assert [event.row for event in program.events] == [int((path.line < 5).sum()), len(path) - 1]
