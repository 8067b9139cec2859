"""The proof of milling: clean programs pass, and each fault in their text is caught by its rule."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from planner.claims.segments import Segment
from planner.processes.milling.proof.tool_motion import signed_distance, solids, track_distance
from planner.tooling import Cutter
from tests.processes.milling.plan.small_mill import BALL, PANEL, WALL
from tests.processes.milling.proof.milling_job import Job, Programs, in_procedure

RULES = ("verify.milled", "verify.mill_gouge", "verify.mill_path", "verify.mill_feed", "verify.spindle")
ENGRAVE = {"engrave": [{"bspline_mm": [[-30, -15, 0], [0, 15, 0], [30, -15, 0]]}], "depth_mm": 0.5}
LINES = {"lines": "front", "stepover_mm": 1.5}
TURN = np.linspace(0.0, 2 * np.pi, 240, endpoint=False)
OUTLINE = [
    {"polyline_mm": [[float(r * np.cos(t)), float(r * np.sin(t)), z] for t in TURN]}
    for r, z in ((20.0, 12.0), (16.0, 50.0))
]
ROUND = {"ruled": [{"name": "wall", "start": OUTLINE[0], "end": OUTLINE[1], "closed": True}], "in_stock": {}}
MOVE = re.compile(r"(MoveL \[\[)([-\d.]+),([-\d.]+),([-\d.]+)(\],\[)")


@pytest.fixture(scope="module")
def wall(tmp_path_factory: pytest.TempPathFactory) -> Job:
    return Job(tmp_path_factory.mktemp("wall"), WALL)


@pytest.fixture(scope="module")
def pattern(tmp_path_factory: pytest.TempPathFactory) -> Job:
    return Job(tmp_path_factory.mktemp("pattern"), PANEL, BALL, cuts=[ENGRAVE])


@pytest.fixture(scope="module")
def face(tmp_path_factory: pytest.TempPathFactory) -> Job:
    return Job(tmp_path_factory.mktemp("face"), PANEL, BALL, cuts=[LINES])


def moved(text: str, numbers: slice, by: tuple[float, float, float]) -> str:
    """A procedure with some of its straight moves shifted by ``by`` [mm]."""
    moves = list(MOVE.finditer(text))
    for move in reversed(moves[numbers]):
        place = [float(move[k + 2]) + by[k] for k in range(3)]
        new = move[1] + ",".join(f"{v:.4f}" for v in place) + move[5]
        text = text[: move.start()] + new + text[move.end() :]
    return text


def everywhere(programs: Programs, old: str, new: str) -> Programs:
    assert any(old in text for text in programs.values())
    return {file: text.replace(old, new) for file, text in programs.items()}


def test_a_clean_wall_is_proven_whole(wall: Job) -> None:
    proof = wall.prove(wall.programs, last=None)
    assert proof.ok, proof.issues
    for code in RULES:
        assert proof.rule(code).ran and proof.rule(code).passed
    face = next(face for face in proof.surfaces if face.segment == Segment.read("mill/wall"))
    assert face.share > 0.999
    assert face.largest < 1e-4


def test_a_clean_pattern_is_proven(pattern: Job) -> None:
    proof = pattern.prove(pattern.programs)
    assert not proof.issues
    deep = proof.rule("verify.mill_gouge")
    assert deep.worst == pytest.approx(0.5, abs=0.08)


@pytest.mark.parametrize("by", [(0.0, 0.6, 0.0), (0.0, -0.6, 0.0)])
def test_a_target_beside_the_wall_is_caught(wall: Job, by: tuple[float, float, float]) -> None:
    bad = in_procedure(wall.programs, "mill_wall", lambda text: moved(text, slice(4, 9), by))
    assert wall.broken(bad) & {"verify.milled", "verify.mill_gouge"}


def test_a_whole_wall_too_deep_is_a_gouge(wall: Job) -> None:
    """The outer side of the wall is the one that the cutter is on; toward the wall is away from it."""
    side = wall.problem.part.ruled[0]  # type: ignore[union-attr]
    out = np.cross(side.start[-1] - side.start[0], side.end[0] - side.start[0])
    step = tuple(-0.4 * out / np.linalg.norm(out))
    bad = in_procedure(wall.programs, "mill_wall", lambda text: moved(text, slice(None), step))
    assert {"verify.milled", "verify.mill_gouge"} <= wall.broken(bad)


def test_a_tip_that_is_too_high_leaves_the_wall(wall: Job) -> None:
    bad = in_procedure(wall.programs, "mill_wall", lambda text: moved(text, slice(None), (0.0, 0.0, 5.0)))
    assert "verify.milled" in wall.broken(bad)


@pytest.mark.parametrize("suffix", ["", "_in", "_out"])
def test_a_tip_that_is_too_deep_where_no_face_says_so(wall: Job, suffix: str) -> None:
    """Below the wall and beside it there is no face of the part; what is there is not to be milled."""
    bad = in_procedure(
        wall.programs, f"mill_wall{suffix}", lambda text: moved(text, slice(3, None), (0, 0, -2.0))
    )
    assert "verify.mill_path" in wall.broken(bad)


def test_a_way_through_the_block_is_caught(wall: Job) -> None:
    """The cutter goes off into the block, away from the wall, and comes back."""

    def aside(text: str) -> str:
        move = list(MOVE.finditer(text))[12]
        line = next(line for line in text.split("\n") if move[0] in line)
        slow = re.sub(r"\\T:=[\d.]+", r"\\T:=1.0", line)
        over = slow.replace(move[0], f"{move[1]}{move[2]},{float(move[3]) - 15:.4f},{move[4]}{move[5]}")
        return text.replace(line, "\n".join([line, over, slow]))

    assert "verify.mill_path" in wall.broken(in_procedure(wall.programs, "mill_wall", aside))


def test_a_roughing_pass_that_is_left_out_is_caught(tmp_path: Path) -> None:
    """The finishing pass would take all of the wall's height at once."""
    rough = Job(tmp_path, WALL, cuts=[{"flank": "wall", "stepdown_mm": 25}])
    assert rough.prove(rough.programs, last=None).ok
    bad = {file: re.sub(r"\n +mill_wall_r1(_in|_out)?;", "", text) for file, text in rough.programs.items()}
    bad = {
        file: re.sub(r" *PROC mill_wall_r1(?:_in|_out)?\(\).*?ENDPROC\r?\n", "", text, flags=re.S)
        for file, text in bad.items()
    }
    assert "verify.mill_path" in rough.broken(bad)


def test_a_pass_that_is_left_out_is_caught(wall: Job) -> None:
    bad = {file: re.sub(r"\n +mill_wall;", "", text) for file, text in wall.programs.items()}
    assert bad != wall.programs
    assert wall.broken(bad)


def test_a_spindle_that_stands_is_caught(wall: Job) -> None:
    bad = {
        file: text.replace("SetDO doSpindle,1;", "SetDO doSpindle,0;") for file, text in wall.programs.items()
    }
    assert "verify.spindle" in wall.broken(bad)


def test_a_spindle_that_is_not_up_to_speed_is_caught(wall: Job) -> None:
    """It is switched on behind the way down instead of before it, as far as the text tells it, at a stop."""

    def later(text: str) -> str:
        return text.replace("SetDO doSpindle,1;", "").replace(
            "mill_wall_in;", "mill_wall_in;\n    SetDO doSpindle,1;"
        )

    assert "verify.spindle" in wall.broken(in_procedure(wall.programs, "operation_1", later))


def twice(text: str) -> str:
    """Halve the time of all moves of a procedure."""
    return re.sub(r"\\T:=([\d.]+)", lambda m: f"\\T:={0.5 * float(m[1]):.5f}", text)


def without(rows: slice) -> Callable[[str], str]:
    """Leaves out some of a procedure's straight moves."""

    def change(text: str) -> str:
        lines = text.split("\n")
        moves = [k for k, line in enumerate(lines) if "MoveL" in line]
        drop = set(moves[rows])
        assert drop
        return "\n".join(line for k, line in enumerate(lines) if k not in drop)

    return change


def test_a_faster_feed_is_caught(wall: Job) -> None:
    assert "verify.mill_feed" in wall.broken(in_procedure(wall.programs, "mill_wall", twice))


def test_a_segment_that_nobody_claims_is_caught(wall: Job) -> None:
    bad = everywhere(wall.programs, "mill_wall_out", "mill_door_out")
    assert wall.broken(bad) & {"verify.milled", "verify.mill_feed", "verify.clearance"}


def test_a_pattern_beside_its_curve_is_caught(pattern: Job) -> None:
    shift = in_procedure(
        pattern.programs, "mill_pattern_c1", lambda text: moved(text, slice(5, 12), (0.0, 0.5, 0.0))
    )
    assert "verify.mill_path" in pattern.broken(shift)


def test_a_pattern_too_deep_is_caught(pattern: Job) -> None:
    deep = in_procedure(
        pattern.programs, "mill_pattern_c1", lambda text: moved(text, slice(None), (0.0, 0.0, -0.6))
    )
    assert {"verify.mill_gouge", "verify.mill_path"} <= pattern.broken(deep)


def test_a_pattern_that_is_half_left_out_is_caught(pattern: Job) -> None:
    def half(text: str) -> str:
        lines = text.split("\n")
        moves = [k for k, line in enumerate(lines) if "MoveL" in line]
        drop = set(moves[len(moves) // 3 : 2 * len(moves) // 3])
        return "\n".join(line for k, line in enumerate(lines) if k not in drop)

    assert "verify.mill_path" in pattern.broken(in_procedure(pattern.programs, "mill_pattern_c1", half))


def test_a_closed_outline_is_proven_all_around(tmp_path: Path) -> None:
    job = Job(tmp_path, WALL, {"overhang_mm": 90}, part=ROUND)
    proof = job.prove(job.programs, last=None)
    assert proof.ok, proof.issues
    (found,) = proof.surfaces
    assert found.share > 0.999
    short = in_procedure(job.programs, "mill_wall", without(slice(-12, None)))
    assert "verify.milled" in job.broken(short)


def test_a_face_in_lines_is_proven_with_ridges_of_the_closed_form(face: Job) -> None:
    """Balls of radius r on lines s apart along a face that bends by k across them leave s^2 / 8 (1 / r + k).
    Across the lines are the profiles: in their middle the Bezier curve has y' = 60 and z'' = -36 mm, so that
    k is 36 / 60^2 per mm."""
    proof = face.prove(face.programs, last=None)
    assert proof.ok, proof.issues
    (found,) = proof.surfaces
    assert found.share > 0.995
    inner = (np.abs(found.points[:, 0]) < 0.035) & (np.abs(found.points[:, 1]) < 0.006)
    ridge = float(np.nanquantile(found.deviation[inner], 0.999))
    assert ridge == pytest.approx(1.5e-3**2 / 8.0 * (1.0 / 3e-3 + 10.0), rel=0.08)


def test_a_line_that_is_left_out_is_caught(face: Job) -> None:
    """Two moves of the middle line of a zigzag, and all of the lines but the first ones."""
    for rows in (slice(200, 230), slice(100, None)):
        bad = in_procedure(face.programs, "mill_front_lines", without(rows))
        assert "verify.milled" in face.broken(bad)


@pytest.mark.parametrize("by", [(0.0, 0.0, -0.5), (0.0, 0.0, 0.5)])
def test_lines_too_deep_or_too_high_are_caught(face: Job, by: tuple[float, float, float]) -> None:
    bad = in_procedure(face.programs, "mill_front_lines", lambda text: moved(text, slice(150, 220), by))
    found = face.broken(bad)
    assert "verify.milled" in found
    assert ("verify.mill_gouge" in found) == (by[2] < 0.0)


def test_a_faster_feed_on_lines_is_caught(face: Job) -> None:
    bad = in_procedure(face.programs, "mill_front_lines", twice)
    assert "verify.mill_feed" in face.broken(bad)


def cutters() -> list[Cutter]:
    behind = np.array([[0.06, 0.02], [0.1, 0.02], [0.1, 0.045], [0.3, 0.045]])
    return [
        Cutter("cylinder", 0.006, 0.0, 0.03, 0.06, 0.005, behind),
        Cutter("ball", 0.006, 0.006, 0.03, 0.06, 0.006, behind),
        Cutter("bull", 0.006, 0.002, 0.03, 0.06, 0.006, behind),
    ]


@pytest.mark.parametrize("cutter", cutters(), ids=lambda c: c.kind)
def test_distances_from_a_cutter_are_those_of_dense_points_of_its_surface(cutter: Cutter) -> None:
    """Against the nearest of many points laid on the half section here, from its radius and corner."""
    turn = np.linspace(0.0, 0.5 * np.pi, 4001)
    flat = cutter.radius - cutter.corner
    arc = np.stack([cutter.corner * (1 - np.cos(turn)), flat + cutter.corner * np.sin(turn)], axis=1)
    side = np.stack([np.linspace(cutter.corner, cutter.flute, 8001), np.full(8001, cutter.radius)], axis=1)
    end = np.stack([np.zeros(2001), np.linspace(0.0, flat, 2001)], axis=1)
    top = np.stack([np.full(2001, cutter.flute), np.linspace(0.0, cutter.radius, 2001)], axis=1)
    shell = np.concatenate([arc, side, end, top])
    rng = np.random.default_rng(8)
    at = rng.uniform([-0.004, 0.0], [0.02, 0.011], (300, 2))
    expected = np.array([np.linalg.norm(shell - one, axis=1).min() for one in at])
    found = signed_distance(solids(cutter)[0], at[:, 0], at[:, 1])
    np.testing.assert_allclose(np.abs(found), expected, atol=1.2e-5)
    deep = (at[:, 1] < flat) & (at[:, 0] > 0.0) & (at[:, 0] < cutter.flute)
    assert (found[deep] < 0.0).all()
    assert (found[at[:, 1] > cutter.radius + 1e-5] > 0.0).all()


def test_a_swept_cylinder_leaves_what_a_slot_leaves() -> None:
    """A cylinder goes straight along x: points beside the slot are off it by their distance from its wall."""
    cutter = cutters()[0]
    tip = np.stack([np.linspace(0.0, 0.1, 101), np.zeros(101), np.zeros(101)], axis=1)
    axis = np.tile([0.0, 0.0, 1.0], (101, 1))
    rng = np.random.default_rng(2)
    points = np.column_stack(
        [rng.uniform(0.02, 0.08, 200), rng.uniform(0.004, 0.008, 200), rng.uniform(0.005, 0.025, 200)]
    )
    deviation, place = track_distance(points, tip, axis, solids(cutter)[0])
    expected = points[:, 1] - cutter.radius
    # places are 1 mm apart: half of that off, a point 4 mm from the axis is 0.5^2 / 8 mm farther
    np.testing.assert_allclose(deviation, expected, atol=3.2e-5)
    assert (np.abs(tip[place, 0] - points[:, 0]) < 1.1e-3).all()
