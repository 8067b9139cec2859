"""The bow and the grippers: frames, passage of the wire through the throat, masses, refused sizes."""

from __future__ import annotations

import numpy as np
import pytest

from planner.cell.bodies import Solid, signed_distance
from planner.geometry.arrays import inverse, transform
from planner.tooling import Gripper, Tool, bow, gripper_plate, vacuum_cup


def distance(tool: Tool, points: np.ndarray) -> np.ndarray:
    """Least distance (N,) of points (N, 3) in the flange frame to the tool's solids."""
    each = [signed_distance(Solid("", s), transform(inverse(s.pose), points)) for s in tool.shapes]
    return np.asarray(np.min(each, axis=0))


def at_tcp(tool: Tool, points: np.ndarray) -> np.ndarray:
    """Points (N, 3) of the TCP frame in the flange frame."""
    return transform(tool.tcp, points)


@pytest.mark.parametrize("size", [0.4, 0.65])
@pytest.mark.parametrize("tilt", [0.0, np.pi / 4])
def test_the_wire_runs_along_x_of_the_tcp_from_clamp_to_clamp(size: float, tilt: float) -> None:
    tool = bow(size, size, tilt=tilt)
    radius, length = tool.wire.size
    assert (radius, length) == (0.0002, size)
    ends = tool.wire.pose @ np.array([[0, 0, -length / 2, 1], [0, 0, length / 2, 1]]).T
    np.testing.assert_allclose(np.sort((inverse(tool.tcp) @ ends)[0]), [-size / 2, size / 2], atol=1e-12)
    np.testing.assert_allclose((inverse(tool.tcp) @ ends)[1:3], 0.0, atol=1e-12)
    wire = np.linspace(-0.5, 0.5, 41)[:, None] * [size, 0.0, 0.0]
    gap = distance(tool, at_tcp(tool, wire))
    np.testing.assert_allclose(gap[[0, -1]], 0.0, atol=1e-9)
    assert np.all(gap[1:-1] >= np.minimum(size / 2 - np.abs(wire[1:-1, 0]), 0.2) - 1e-9)


def test_the_throat_is_free_over_its_whole_depth() -> None:
    tool = bow(0.4, 0.4)
    inner = np.array([[0.0, 0.0, -0.38], [0.17, 0.0, -0.2], [-0.17, 0.0, -0.05]])
    assert np.all(distance(tool, at_tcp(tool, inner)) > 0.0)
    beam = np.array([[0.0, 0.0, -0.4]])
    assert distance(tool, at_tcp(tool, beam))[0] < 0.0


def test_bows_are_light_enough_for_the_arms_that_carried_them() -> None:
    """Seed 004, 2.1.2.3 and 2.2.2.3: IRB 140, payload 6 kg, with bows of 400 and 650 mm."""
    assert bow(0.4, 0.4).mass < bow(0.65, 0.65).mass < 3.0


@pytest.mark.parametrize("tool", [gripper_plate(0.2, 0.1), vacuum_cup(0.06)])
def test_a_gripper_ends_at_its_tcp(tool: Gripper) -> None:
    half = 0.4 * np.array([*tool.footprint, 0.0])
    face = np.array([[0.0, 0.0, 0.0], half * [1, 0, 0], half * [0, 1, 0]])
    np.testing.assert_allclose(distance(tool, at_tcp(tool, face)), 0.0, atol=1e-9)
    above = face + np.array([0.0, 0.0, 0.01])
    np.testing.assert_allclose(distance(tool, at_tcp(tool, above)), 0.01, atol=1e-9)


@pytest.mark.parametrize(
    "make",
    [
        lambda: bow(0.01),
        lambda: bow(0.4, 9.0),
        lambda: bow(wire_diameter=0.0),
        lambda: gripper_plate(0.001, 0.1),
        lambda: vacuum_cup(0.06, reach=0.0),
    ],
)
def test_sizes_that_make_no_tool_are_refused(make) -> None:
    with pytest.raises(ValueError, match="mm"):
        make()
