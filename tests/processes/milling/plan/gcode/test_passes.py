"""G-code as passes of the cutter: the moves between rapid moves, thinned, with dwells and questions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from planner.issues import TandemError
from planner.processes.milling.plan.operation import GCodeCut
from planner.processes.milling.plan.process_plan import GCodePasses, plan_gcode_passes
from tests.processes.milling.plan.gcode.gcode_programs import HEAD, spec

TOLERANCE = 1e-4


def cut(folder: Path, text: str, step: float = 0.05, **stated: object) -> GCodePasses:
    own = GCodeCut(gcode=spec(folder, HEAD + text, **stated), name="job")
    return plan_gcode_passes(own, step, TOLERANCE, "operations.0.cuts.0")


def test_each_stretch_of_cuts_is_a_pass_from_where_the_rapid_move_ended(tmp_path: Path) -> None:
    text = "G0 X0 Y0 Z5\nG1 Z-1\nX10\nG0 Z5\nX20\nY3\nG1 Z-2\nX30\nG0 Z5\n"
    runs = cut(tmp_path, text).passes
    assert [run.name for run in runs] == ["job_1", "job_2"]
    np.testing.assert_allclose(runs[0].path.tip * 1e3, [[0, 0, 5], [0, 0, -1], [10, 0, -1]], atol=1e-9)
    np.testing.assert_allclose(runs[1].path.tip * 1e3, [[20, 3, 5], [20, 3, -2], [30, 3, -2]], atol=1e-9)


def test_dense_points_are_thinned_within_the_tolerance(tmp_path: Path) -> None:
    """Half a turn of radius 50 mm in 2,000 lines: chords within a quarter of the tolerance need no fewer than
    pi / (2 arccos(1 - e / r)) and, as moves need not be the longest, few more."""
    angle = np.linspace(0.0, np.pi, 2001)
    points = zip(50 * np.cos(angle), 50 * np.sin(angle), strict=True)
    text = "G0 X50 Y0 Z0\n" + "".join(f"G1 X{x:.5f} Y{y:.5f}\n" for x, y in points)
    (run,) = cut(tmp_path, text).passes
    chord = 0.25 * TOLERANCE
    least = np.pi / (2.0 * np.arccos(1.0 - chord / 0.05))
    assert least - 1 <= len(run.path) <= 2.0 * least
    radius = np.linalg.norm(run.path.tip[:, :2], axis=1)
    np.testing.assert_allclose(radius, 0.05, atol=1e-8)
    middle = 0.5 * (run.path.tip[1:] + run.path.tip[:-1])
    assert 0.05 - np.linalg.norm(middle[:, :2], axis=1).min() <= chord + 1e-8


def test_a_turning_axis_is_thinned_no_more_than_the_tip(tmp_path: Path) -> None:
    lines = [f"G1 X{i / 10:.3f} I{np.sin(i / 400):.7f} J0 K{np.cos(i / 400):.7f}" for i in range(401)]
    (run,) = cut(tmp_path, "G0 X0 Y0 Z0 I0 J0 K1\n" + "\n".join(lines), tool_axis="ijk").passes
    assert 5 < len(run.path) < 100
    middle = run.path.axis[1:] + run.path.axis[:-1]
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    x = 0.5 * (run.path.tip[1:, 0] + run.path.tip[:-1, 0])
    np.testing.assert_allclose(np.arctan2(middle[:, 0], middle[:, 2]), x / 0.04, atol=1e-3)


def test_feeds_change_where_the_file_changes_them_and_never_rise(tmp_path: Path) -> None:
    text = "G0 X0 Y0 Z0\n" + "".join(f"G1 X{i} F{600 if i <= 10 else 1200}\n" for i in range(1, 21))
    (run,) = cut(tmp_path, text).passes
    x = run.path.tip[:, 0] * 1e3
    assert 10.0 in x.round(6)
    np.testing.assert_allclose(run.path.feed[1:] * 60e3, np.where(x[1:] < 10.0 + 1e-6, 600, 1200))


def test_feeds_that_are_alike_are_thinned_at_the_lowest(tmp_path: Path) -> None:
    text = "G0 X0 Y0 Z0\n" + "".join(f"G1 X{i} F{1000 + i % 3}\n" for i in range(1, 21))
    (run,) = cut(tmp_path, text).passes
    assert len(run.path) <= 3
    assert run.path.feed[1:].max() * 60e3 <= 1002.0
    np.testing.assert_allclose(run.path.feed[1:].min() * 60e3, 1000.0)


def test_waits_and_questions(tmp_path: Path) -> None:
    text = "G0 X0 Y0 Z5\nM0\nG1 Z-1\nX10\nG4 P0.5\nX20\nG0 Z5\nS9000\nX0\nM1\nG1 Z-1\n"
    text += "G0 Z5\nX5\nG1 Z-1\nM0\nG0 Z5\n"
    first, second, third = cut(tmp_path, text, dwell="s").passes
    assert first.waits == ((2, 0.5),)
    np.testing.assert_allclose(first.path.tip[2] * 1e3, [10, 0, -1], atol=1e-9)
    assert first.question == "Go on: line 5 of the file, spindle at 6000 1/min?"
    assert second.question == "Go on: line 13 of the file, spindle at 9000 1/min?"
    assert third.question == ""


def test_what_is_asked_before_a_cut_that_goes_nowhere_is_asked_before_the_next(tmp_path: Path) -> None:
    (run,) = cut(tmp_path, "G0 X0 Y0 Z5\nM0\nG1 X0\nG0 Z6\nG0 X1\nG1 Z-1\nX10\nG0 Z5\n").passes
    assert run.question == "Go on: line 5 of the file, spindle at 6000 1/min?"


@pytest.mark.parametrize(
    ("text", "code", "line"),
    [
        ("G0 X0 Y0 Z0\nG1 X1\nM0\nX2\n", "gcode.word", 6),
        ("G0 X0 Y0 Z0\nG1 X1\nS9000\nX2\n", "gcode.spindle", 7),
        ("G1 X0 Y0 Z0\n", "gcode.empty", None),
        ("G0 X0 Y0 Z0\nG1 X0\nX0\n", "gcode.empty", None),
    ],
)
def test_what_a_robot_cannot_do_is_named(tmp_path: Path, text: str, code: str, line: int | None) -> None:
    with pytest.raises(TandemError) as caught:
        cut(tmp_path, text)
    assert [(issue.code, issue.line) for issue in caught.value.issues] == [(code, line)]


def test_long_moves_have_places_of_their_own_a_step_apart(tmp_path: Path) -> None:
    """A straight move of 100 mm on which the axis turns by 30 degrees about y, as angles of a closed form;
    the wait behind it is still at its end."""
    end = f"I{np.sin(np.pi / 6):.9f} J0 K{np.cos(np.pi / 6):.9f}"
    text = f"G0 X0 Y0 Z0 I0 J0 K1\nG1 X100 {end}\nG4 P0.5\nG1 X110\nG0 Z5\n"
    (run,) = cut(tmp_path, text, step=0.008, tool_axis="ijk", dwell="s").passes
    x = run.path.tip[:, 0]
    assert len(x) == 1 + 13 + 2
    np.testing.assert_allclose(np.diff(x[:14]), 0.1 / 13, atol=1e-9)
    tilt = np.arctan2(run.path.axis[:14, 0], run.path.axis[:14, 2])
    np.testing.assert_allclose(tilt, x[:14] / 0.1 * np.pi / 6, atol=1e-7)
    np.testing.assert_allclose(np.linalg.norm(run.path.axis, axis=1), 1.0, atol=1e-8)
    assert run.waits == ((13, 0.5),)
