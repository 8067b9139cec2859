"""Walls between the loops of tools that go deeper than the part.

Known paths are tested, and a planner that makes them too steep.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import planner
from planner.cli.forming import SpringbackCommand, run_springback
from planner.geometry.units import MM
from planner.issues import Severity, TandemError
from planner.processes.forming.proof import loop_walls
from tests import small_forming
from tests.proof import planner_faults

STEP = 0.5 * MM
SLOPE = 0.05


def ring(sides: int, radius: float, count: int) -> np.ndarray:
    """Places (count, 2) of a closed polygon, evenly from its first corner to just before it."""
    turn = 2.0 * np.pi * np.arange(sides + 1) / sides
    corner = radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    at = np.linspace(0.0, sides, count, endpoint=False)
    return np.stack([np.interp(at, np.arange(sides + 1), corner[:, k]) for k in (0, 1)], axis=1)


def wall_path(
    degrees: float, sides: int = 90, spiral: bool = True, loops: int = 24, side: int = 1
) -> np.ndarray:
    """Return a path (N, 3) [m] of ``loops`` down a wall of ``degrees``.

    It is at most 30 mm from the middle and 0.5 mm deeper per loop, as a spiral or as level loops.
    """
    count = 90 * sides // np.gcd(90, sides)
    across = STEP / np.tan(np.deg2rad(degrees)) / np.cos(np.pi / sides)
    out = []
    for k in range(min(loops, int(25.0 * MM / across))):
        own = k + (np.arange(count) / count if spiral else np.zeros(count))
        plan = ring(sides, 1.0, count) * (30.0 * MM - own * across)[:, None]
        out.append(np.column_stack([plan, -side * own * STEP]))
    return np.concatenate(out)


def shifted_down(points: np.ndarray, shift: np.ndarray, side: int = 1) -> np.ndarray:
    return np.asarray(points - np.outer(side * shift, [0.0, 0.0, 1.0]))


def growing_shift(
    points: np.ndarray, full: float, to: float = 0.0, at: float = 0.0, over: float = 1.0
) -> np.ndarray:
    """Return shifts that grow from 0 to ``full`` [m] at the limit slope.

    From the depth ``at`` [m] on, they grow by another ``to`` [m] over the depth ``over`` [m].
    """
    gone = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    more = to * np.clip((np.abs(points[:, 2]) - at) / over, 0.0, 1.0)
    return np.asarray(np.minimum(SLOPE * gone, full) + more)


@pytest.mark.sampled(every=5)
@pytest.mark.parametrize("sides", [4, 7, 90])
@pytest.mark.parametrize("spiral", [True, False])
@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("degrees", [20.0, 45.0, 70.0])
def test_walls_without_more_shift_are_those_of_the_way(
    degrees: float, spiral: bool, side: int, sides: int
) -> None:
    place = wall_path(degrees, sides, spiral, side=side)
    shift = growing_shift(place, 2.0 * MM)
    found = loop_walls.walls_between_loops(shifted_down(place, shift, side), shift, side, SLOPE)
    assert len(found.row) > 0.7 * len(place)
    steep = np.rad2deg(found.angle)
    assert np.quantile(np.abs(steep - degrees), 0.9) < 0.5  # beside a seam, level loops join aslant
    assert steep.max() < degrees + 1.0
    np.testing.assert_allclose(found.angle, found.unshifted_angle, atol=1e-9)


@pytest.mark.parametrize("sides", [4, 90])
def test_a_shift_that_grows_with_depth_makes_walls_steeper_by_that(sides: int) -> None:
    """A wall of 45 degrees whose shift grows by 1.55 mm on ten loops of 0.5 mm is one of 52.6 degrees."""
    place = wall_path(45.0, sides, loops=30)
    shift = growing_shift(place, 2.0 * MM, 1.55 * MM, 5.0 * MM, 5.0 * MM)
    found = loop_walls.walls_between_loops(shifted_down(place, shift), shift, 1, SLOPE)
    depth = -place[found.row, 2]
    inside, outside = (depth > 5.8 * MM) & (depth < 9.7 * MM), (depth < 4.8 * MM) | (depth > 11.0 * MM)
    steep = np.rad2deg(found.angle)
    expected = np.rad2deg(np.arctan(1.0 + 1.55 / 5.0))
    assert expected == pytest.approx(52.6, abs=0.05)
    assert np.median(steep[inside]) == pytest.approx(expected, abs=0.3)
    assert steep[inside].max() < expected + 0.8
    assert steep[outside].max() < 46.0


def test_one_loop_that_takes_all_of_it_is_found() -> None:
    place = wall_path(60.0)
    shift = growing_shift(place, 2.0 * MM, 0.3 * MM, 6.0 * MM, STEP)
    found = loop_walls.walls_between_loops(shifted_down(place, shift), shift, 1, SLOPE)
    expected = np.rad2deg(np.arctan(np.tan(np.deg2rad(60.0)) * 1.6))
    assert np.rad2deg(found.angle.max()) == pytest.approx(expected, abs=0.6)


def test_the_way_on_which_shifts_grow_from_nothing_is_no_wall() -> None:
    place = wall_path(45.0)
    shift = growing_shift(place, 5.0 * MM)  # 100 mm of a first loop of 188 mm
    found = loop_walls.walls_between_loops(shifted_down(place, shift), shift, 1, SLOPE)
    assert np.rad2deg(found.angle.max()) < 46.0
    assert found.row.min() < 2 * 90
    late = shift + 1.0 * MM * (np.arange(len(place)) > 3 * 90)  # all at once, three loops later
    found = loop_walls.walls_between_loops(shifted_down(place, late), late, 1, SLOPE)
    assert np.rad2deg(found.angle.max()) > 65.0


def test_a_flat_last_loop_and_a_stop_are_no_walls() -> None:
    """The last loop of a spiral is level and lies on the one before it in part; tools stand at a place."""
    place = wall_path(60.0)
    last = np.column_stack([ring(90, float(np.hypot(*place[-1, :2])), 90), np.full(90, place[-1, 2])])
    place = np.concatenate([place[:500], place[500:501], place[500:], last])
    shift = growing_shift(place, 2.0 * MM) + 1e-5 * np.arange(len(place)) / len(place)
    found = loop_walls.walls_between_loops(shifted_down(place, shift), shift, 1, SLOPE)
    assert np.rad2deg(found.angle.max()) < 61.0


def test_ways_of_nothing_have_no_walls() -> None:
    for place in (np.zeros((0, 3)), np.zeros((2, 3)), np.zeros((5, 3)), np.eye(3)):
        assert len(loop_walls.walls_between_loops(place, np.zeros(len(place)), 1, SLOPE).row) == 0


# ---- from file to proof ----


def stated(folder: Path, **more: Any) -> Path:
    """Write a dish with a wall of 62 degrees, in a wide clamp. The metal allows up to 65 degrees."""
    data = small_forming.problem("spif", force_n=600.0, stepdown_mm=0.5, tangent_deg=6, **more)
    data["sheet"] |= {"size_mm": [240, 240], "opening_mm": 180}
    data["accept"] = ["forming.force"]
    part = small_forming.dish(depth=13.0, angle=62.0, fillet=8.0, around=120)
    return small_forming.write(folder, data, part)


def _sudden(old: Callable[..., Any]) -> Callable[..., Any]:
    """Reduce shifts by 4.5 % from 4.5 to 6.5 mm of depth and recover within one loop.

    The wall is 69 degrees steep on this loop, within the variation that the proof accepts between control
    points.
    """

    def other(name: str, path: Any, radius: float, required_springback: Any, *more: Any) -> Any:
        def late(points: np.ndarray, angle: np.ndarray, at: np.ndarray) -> np.ndarray:
            share = np.interp(-points[:, 2], [4.5e-3, 6.5e-3, 7e-3], [0.0, 0.045, 0.0])
            return np.asarray(required_springback(points, angle, at) * (1.0 - share))

        return old(name, path, radius, late, *more)

    return other


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The problem with its springback file, which the planner has made such."""
    folder = tmp_path_factory.mktemp("steep")
    request = SpringbackCommand(stated(folder), most_points=4, triangles=3000, write=folder / "back.json")
    with planner_faults.changed({"processes.forming.plan.springback.compensation:shift_path": _sudden}):
        run_springback(request, planner.load(request.problem))
    return stated(folder, springback={"file": "back.json"})


@pytest.mark.long
def test_a_planner_that_makes_walls_too_steep_is_caught_by_this_alone(path: Path) -> None:
    with planner_faults.changed({**planner_faults.CHECKS, **planner_faults.SOONER}):
        outcome = planner.plan(planner.load(path))
    wrong = [rule.code for rule in outcome.proof.rules if rule.ran and not rule.passed]
    assert wrong == ["verify.springback"]
    (found,) = (issue for issue in outcome.issues if issue.code == "verify.springback")
    assert "has a wall of" in found.message
    assert found.value > 67.0
    assert found.limit == pytest.approx(65.0)


def test_a_planner_that_looks_refuses_such_walls(path: Path) -> None:
    with pytest.raises(TandemError) as refused:
        planner.plan(planner.load(path))
    (issue,) = (one for one in refused.value.issues if one.severity is Severity.ERROR)
    assert issue.code == "forming.wall_angle"
    assert issue.value > 67.0
    assert "accept: [forming.wall_angle]" in issue.hint


@pytest.mark.long
def test_such_walls_are_planned_where_they_are_accepted(path: Path) -> None:
    data = yaml.safe_load(path.read_text())
    data["accept"].append("forming.wall_angle")
    accepted = path.with_name("accepted.yaml")
    accepted.write_text(yaml.safe_dump(data))
    outcome = planner.plan(planner.load(accepted))
    assert outcome.verified, outcome.issues
    assert "forming.wall_angle" in outcome.accepted
