"""The wire holder: its frames follow the conventions, and its solids keep clear of the wire."""

from __future__ import annotations

import numpy as np
import pytest

from planner.cell.bodies import Solid, signed_distance
from planner.geometry.arrays import inverse, transform
from planner.tooling import HOLDER_REACH_M, wire_holder

OUT = {"along": (0, 0, 1), "across": (-1, 0, 0), "diagonal": (-np.sqrt(0.5), 0, np.sqrt(0.5))}


@pytest.mark.parametrize("mounting", ["along", "across", "diagonal"])
@pytest.mark.parametrize("side", ["start", "end"])
def test_the_tcps_x_axis_runs_from_the_start_arm_to_the_end_arm(mounting: str, side: str) -> None:
    tool = wire_holder(mounting, side)
    sign = 1.0 if side == "start" else -1.0
    rotation = tool.tcp[:3, :3]
    np.testing.assert_allclose(rotation[:, 0], sign * np.array(OUT[mounting]), atol=1e-12)
    np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    np.testing.assert_allclose(tool.tcp[:3, 3], [0.0, 0.0, HOLDER_REACH_M[mounting]], atol=1e-12)


def test_distances_of_the_tcp_from_the_flange() -> None:
    assert HOLDER_REACH_M == {"along": 0.120, "across": 0.100, "diagonal": 0.110}


@pytest.mark.parametrize("mounting", ["along", "across", "diagonal"])
def test_both_holders_have_the_same_solids(mounting: str) -> None:
    item, other = wire_holder(mounting, "start"), wire_holder(mounting, "end")
    for a, b in zip(item.shapes, other.shapes, strict=True):
        np.testing.assert_array_equal(a.pose, b.pose)
        assert a.size == b.size


@pytest.mark.parametrize("mounting", ["along", "across", "diagonal"])
@pytest.mark.parametrize("slide", [0.0, 0.02])
def test_the_wire_leaves_the_clamp_at_the_tcp_and_is_clear_of_the_holder_from_there(
    mounting: str, slide: float
) -> None:
    tool = wire_holder(mounting, "start", slide=slide)
    away = np.linspace(0.0, 0.3, 61)
    wire = tool.tcp[:3, 3] + away[:, None] * tool.tcp[:3, 0]
    distance = np.min(
        [signed_distance(Solid("", s), transform(inverse(s.pose), wire)) for s in tool.shapes], axis=0
    )
    assert distance[0] == pytest.approx(0.0, abs=1e-9)
    assert np.all(distance >= np.minimum(away, 0.08) - 1e-9)
    back = tool.tcp[:3, 3] - 0.010 * tool.tcp[:3, 0]
    assert min(signed_distance(Solid("", s), transform(inverse(s.pose), back)) for s in tool.shapes) < -0.005


@pytest.mark.parametrize("mounting", ["along", "across", "diagonal"])
def test_the_slide_moves_the_tcp_outward_along_the_wire(mounting: str) -> None:
    for side in ("start", "end"):
        moved = wire_holder(mounting, side, slide=0.015).tcp[:3, 3] - wire_holder(mounting, side).tcp[:3, 3]
        np.testing.assert_allclose(moved, 0.015 * np.array(OUT[mounting]), atol=1e-12)


def test_sizes_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ValueError, match="slide"):
        wire_holder("across", "start", slide=0.2)
    with pytest.raises(ValueError, match="reach"):
        wire_holder("across", "start", reach=0.02)
    with pytest.raises(ValueError, match="side"):
        wire_holder("across", "middle")
