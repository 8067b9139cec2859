"""Whole KRL programs: against a golden text, by their structure, times and corners."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from planner.catalogue.robots import robot
from planner.cell.kinematics import forward_kinematics
from planner.geometry.arrays import inverse
from planner.issues import TandemError
from planner.languages.krl.writer import syntax
from planner.targets import TargetAction
from tests.languages.writing import krl_job, synthetic
from tests.languages.writing.krl_job import body, data, flat, moves, turning_job
from tests.languages.writing.reading import programs

GOLDEN = Path(__file__).with_name("golden")
MARGINS = {"least clearance": "12.3 mm (left/link_4 to stock)"}


def pose(values):
    """(4, 4) in m of X, Y, Z, A, B, C, by scipy."""
    out = np.eye(4)
    out[:3, :3] = Rotation.from_euler("ZYX", values[3:6], degrees=True).as_matrix()
    out[:3, 3] = 1e-3 * np.asarray(values[:3])
    return out


@pytest.fixture(scope="module")
def small():
    plan, problem = krl_job.alone()
    return plan, problem, programs(plan, problem, MARGINS)


@pytest.fixture(scope="module")
def older():
    plan, problem = krl_job.alone("kr60_ha", dialect="krc2")
    return plan, problem, programs(plan, problem)


def test_a_small_job_is_written_as_read_by_a_person(small):
    """The golden text was read line by line against docs/krl.md."""
    written = {n: re.sub(r"Tandem \d+\.\d+\.\d+", "Tandem X", t) for n, t in small[2].items()}
    stored = {str(p.relative_to(GOLDEN)): p.read_bytes().decode() for p in GOLDEN.rglob("*.*")}
    assert written == stored


@pytest.mark.parametrize(
    ("name", "called"),
    [("wire_holder_across", "t_wire_holder_across"), ("spindle with a long shank", "t_spindle_with_a_long")],
)
def test_names_of_tools_are_as_long_as_krl_takes(name, called):
    """KRL's names have 24 characters, three of which tell tools of one name apart."""
    plan, problem = krl_job.alone()
    arms = (dataclasses.replace(problem.cell.arms[0], tool=synthetic.tool(name=name)),)
    files = programs(plan, dataclasses.replace(problem, cell=dataclasses.replace(problem.cell, arms=arms)))
    assert f"$TOOL={called}" in flat(files)
    assert {called, "l" + called[1:]} <= set(data(files))


def test_the_same_plan_gives_the_same_text_and_margins_change_comments_only(small):
    plan, problem, files = small
    assert programs(plan, problem, MARGINS) == files
    bare = programs(plan, problem)
    assert {n: body(t) for n, t in bare.items()} == {n: body(t) for n, t in files.items()}
    assert any("least clearance 12.3 mm" in text for text in files.values())


@pytest.mark.parametrize("fixture", ["small", "older"])
def test_files_are_as_a_controller_reads_them(fixture, request):
    plan, _, files = request.getfixturevalue(fixture)
    files = {path: text for path, text in files.items() if not path.startswith("controller/")}
    assert sorted(files) == ["left/test.dat", "left/test.src", "left/test_1.src"]
    for path, text in files.items():
        stem, kind = path.removeprefix("left/").split(".")
        assert text.isascii() and text.endswith("\r\n")
        lines = text.split("\r\n")
        assert all("\r" not in line and "\n" not in line and len(line) <= 200 for line in lines)
        assert lines[:2] == ["&ACCESS RVP", "&REL 1"]
        assert lines[2] == (f"DEF {stem}()" if kind == "src" else f"DEFDAT {stem} PUBLIC") and len(stem) <= 24
        assert lines[-2] == ("END" if kind == "src" else "ENDDAT")
        assert sum("INITMOV" in line for line in lines) == (path == "left/test.src")
    names = re.findall(r"DECL \w+ (\w+)", files["left/test.dat"])
    assert len({n.lower() for n in names}) == len(names) and max(map(len, names)) <= 24
    assert f'problem_digest[]="{plan.digest}"' in files["left/test.dat"]


def test_the_words_follow_the_dialect(small, older):
    new, old = flat(small[2]), flat(older[2])
    assert {line.split()[0] for line in new if "LIN " in line} == {"SLIN"}
    assert {line.split()[0] for line in old if "LIN " in line} == {"LIN"}
    assert {move[2] for move in moves(new)} == {"C_SPL", ""}
    assert {move[2] for move in moves(old)} == {"C_DIS", ""}
    assert "EXT test_1()" in body(older[2]["left/test.src"])
    assert not any("EXT" in text for text in small[2].values())


@pytest.mark.parametrize("fixture", ["small", "older"])
def test_targets_read_back_as_planned(fixture, request):
    """In the cell's world, from the text alone, by scipy's angles: 0.001 mm and 0.0001 degrees."""
    plan, problem, files = request.getfixturevalue(fixture)
    values = {n: list(v.values()) for n, v in data(files).items()}
    arm = problem.cell.arms[0]
    assert np.allclose(pose(values["base_frame"]), arm.base, atol=1e-9)
    tcp = pose(values["t_holder"])
    base = pose(values["base_frame"]) @ pose(values["b_stock"])
    got = [base @ pose(values["p_1_start"])] + [base @ pose(m[1]) for m in moves(flat(files))]
    flanges = np.array(got) @ inverse(tcp)
    expected = arm.base @ forward_kinematics(robot(arm.robot), plan.operations[0].q["left"])
    assert len(got) == 9
    assert np.linalg.norm(flanges[:, :3, 3] - expected[:, :3, 3], axis=1).max() < 1e-6
    deviation = Rotation.from_matrix(np.swapaxes(expected[:, :3, :3], 1, 2) @ flanges[:, :3, :3]).magnitude()
    assert np.rad2deg(deviation).max() < 1e-4


def test_every_station_is_where_the_plan_has_it(small):
    plan, _, files = small
    values, arm = data(files), robot("kr10_r1100")
    way = [values[line.split()[1]] for line in flat(files) if line.startswith("PTP x_")]
    joints = np.deg2rad([[v[f"A{i}"] for i in range(1, 7)] for v in way])
    planned = plan.operations[0]
    # all but the first and the last target: the one is a pose, at the other the arm stands already
    expected = np.array([*planned.approach["left"][:-1], *planned.retreat["left"][1:]])
    assert flat(files).count("PTP p_1_start") == 1
    assert np.allclose(arm.from_controller(joints), expected, atol=1e-8)
    assert all(v[f"E{i}"] == 0.0 for v in way for i in range(1, 7))


def times(files, first):
    """Times of the moves by docs/krl.md, from the text."""
    poses = [first, *(m[1] for m in moves(flat(files)))]
    turns = Rotation.from_euler("ZYX", np.array(poses)[:, 3:6], degrees=True)
    angle = np.rad2deg((turns[:-1].inv() * turns[1:]).magnitude())
    path_length = np.linalg.norm(np.diff(np.array(poses)[:, :3], axis=0), axis=1)
    settings = [m[3] for m in moves(flat(files))]
    assert all(s["$VEL.ORI1"] == s["$VEL.ORI2"] for s in settings)
    speed = np.array([s["$VEL.CP"] for s in settings])
    turning = np.array([s["$VEL.ORI1"] for s in settings])
    return (
        np.maximum(1e-3 * path_length / speed, angle / (np.sqrt(2.0) * turning)),
        path_length,
        angle,
        speed,
        turning,
    )


def start_of(files, operation=1):
    values = data(files)[f"p_{operation}_start"]
    return np.array([values[k] for k in "XYZABC"])


@pytest.mark.parametrize("fixture", ["small", "older"])
def test_moves_take_as_long_as_planned_and_never_less(fixture, request):
    _, _, files = request.getfixturevalue(fixture)
    seconds, _, _, _, turning = times(files, start_of(files))
    assert (seconds >= 0.5).all() and (seconds < 0.5 * (1 + 1e-5)).all()
    assert (turning == 200.0).all()


def test_a_turn_about_the_tcp_is_never_faster_than_planned_however_it_is_split():
    """Swivel of one tool axis and rotation about it, each at $VEL.ORI; the longer one counts."""
    files = programs(*turning_job())
    seconds, way, angle, _, turning = times(files, start_of(files))
    assert np.flatnonzero(turning < 200.0).tolist() == [1, 2, 3, 4]
    assert (way[2:5] == 0.0).all() and (angle[1:5] > 1.0).all()
    led = turning < 200.0
    assert (seconds >= 0.5).all() and np.allclose(seconds[led], 0.5, rtol=1e-4)
    poses = np.array([start_of(files), *(m[1] for m in moves(flat(files)))])[:, 3:6]
    turns = Rotation.from_euler("ZYX", poses, degrees=True).as_matrix()
    for axis in np.concatenate([np.eye(3), np.random.default_rng(2).normal(size=(50, 3))]):
        tool = turns @ (axis / np.linalg.norm(axis))
        swivel = np.arccos(np.clip(np.sum(tool[:-1] * tool[1:], axis=1), -1.0, 1.0))
        about = 2.0 * np.arccos(np.clip(np.cos(np.deg2rad(angle) / 2) / np.cos(swivel / 2), -1.0, 1.0))
        taken = np.rad2deg(np.maximum(swivel, about)) / turning
        assert (taken[led] >= 0.5 * (1 - 1e-6)).all()
        assert (taken[led] <= 0.5 * np.sqrt(2.0) * (1 + 1e-4)).all()


@pytest.mark.parametrize(("dialect", "word"), [("krc4", "C_SPL"), ("krc2", "C_ORI")])
def test_a_corner_between_turns_has_an_angle(dialect, word):
    made = moves(flat(programs(*turning_job(dialect))))
    corner = [m for m in made if m[3]["$APO.CORI"] < 180.0 and m[2]]
    assert len(corner) >= 2
    for _, _, end, now in corner:
        assert end == word
        assert now["$APO.CDIS"] == 0.001
        assert now["$APO.CORI"] <= 0.5 * np.rad2deg(np.hypot(0.02, 0.03))


def test_corners_take_at_most_half_of_the_shorter_move(small, older):
    for made in (small, older):
        files = made[2]
        _, way, _, _, _ = times(files, start_of(files))
        all_moves = moves(flat(files))
        for i, (_, _, end, now) in enumerate(all_moves):
            assert (end == "") == (i in (5, 7))  # the stop between cut and retreat, and the end
            if end:
                assert now["$APO.CDIS"] <= 0.5 * min(way[i], way[i + 1])
                assert now["$APO.CORI"] == 180.0


def test_an_arm_that_stands_while_the_other_one_moves_waits():
    plan, problem = krl_job.two()
    work = plan.operations[0]
    q = {**work.q, "left": work.q["left"].copy()}
    q["left"][3:5] = q["left"][2]
    poses = {**work.targets.pose, "left": work.targets.pose["left"].copy()}
    poses["left"][3:5] = poses["left"][2]
    targets = dataclasses.replace(work.targets, pose=poses)
    plan = dataclasses.replace(plan, operations=(dataclasses.replace(work, q=q, targets=targets),))
    lines = body(programs(plan, problem)["left/test_1.src"])
    moving = [line for line in lines if line.startswith(("SLIN", "WAIT"))]
    assert [line.split()[0] for line in moving] == ["SLIN"] * 2 + ["WAIT"] * 2 + ["SLIN"] * 4
    assert all(float(line.split()[2]) >= 0.5 for line in moving[2:4])
    assert not moving[1].endswith("C_SPL")


def test_the_arm_stands_before_everything_that_stops_the_advance_run(small):
    last = "PTP"
    for line in flat(small[2]):
        if line.startswith(("$OUT", "WAIT", "HALT", "PTP", "WHILE", "tm_")):
            assert "C_" not in last
        if line.startswith(("PTP", "SLIN")):
            last = line


def test_settings_stand_at_the_head_of_every_file_with_moves():
    labels = ["mount", *["link"] * 40]
    plan, problem = krl_job.alone(
        q=synthetic.sweep(41, 3.0, krl_job.START), labels=labels, stop=(10, 20, 30), actions=(), max_moves=20
    )
    files = programs(plan, problem)
    assert sorted(files) == ["left/test.dat", "left/test.src", "left/test_1.src", "left/test_2.src"]
    once = moves(flat(files))
    heads = ["$VEL.CP", "$VEL.ORI1", "$VEL.ORI2", "$APO.CDIS", "$APO.CORI"]
    apart = []
    for n in (1, 2):
        lines = body(files[f"left/test_{n}.src"])
        assert [line.split("=")[0] for line in lines[3:8]] == heads
        assert "C_" not in lines[-2]
        apart += moves(lines)
    # what is in force at a move is the same whether the file before it ran or not
    assert [m[3] for m in apart] == [{k: m[3][k] for k in heads} for m in once]
    assert len(once) == 40
    calls = [line for line in body(files["left/test.src"]) if line.endswith("()")]
    assert calls[1:] == ["test_1()", "test_2()"]


def test_an_action_between_two_segments_parts_their_files():
    actions = (TargetAction(6, "off", signal="doSpindle"), TargetAction(6, "wait", seconds=1.0))
    plan, problem = krl_job.alone(actions=actions)
    lines = flat(programs(plan, problem))
    assert [
        sum(line.startswith("SLIN") for line in part)
        for part in (lines[: lines.index("WAIT SEC 1")], lines[lines.index("WAIT SEC 1") :])
    ] == [6, 2]
    assert lines[lines.index("WAIT SEC 1") - 1] == "$OUT[17]=FALSE"


def test_setups_are_told_and_confirmed_at_home():
    plan, problem = synthetic.two_setups()
    arms = (dataclasses.replace(problem.cell.arms[0], robot="kr60_ha"),)
    problem = krl_job.at_home(dataclasses.replace(problem, cell=dataclasses.replace(problem.cell, arms=arms)))
    first, second = plan.operations
    q = {"left": synthetic.sweep(7, start=krl_job.START)}
    made = [
        krl_job.synthetic_homes(
            synthetic.operation(
                setup,
                q,
                list(map(str, old.targets.segment[:1])) + ["cut/a"] * 6,
                name=old.name,
                actions=(),
                coupled=False,
                stock_pose=place,
            ),
            problem,
        )
        for setup, old, place in zip(problem.setups, (first, second), plan.stock_poses, strict=True)
    ]
    files = programs(dataclasses.replace(plan, operations=tuple(made)), problem)
    text = files["left/test.src"]
    assert text.index("Turn the block and clamp it again.") < text.index("Setup 2 done as instructed")
    lines = body(text)
    panel = krl_job.folded(lines)
    asked = [i for i, line in enumerate(panel) if line.startswith("ASK")]
    assert len(asked) == 3
    assert [line for line in panel[: asked[2]] if line.startswith("PTP")][-1] == "PTP x_home"
    read = [line for line in panel[asked[1] : asked[2]] if line.startswith("READ")]
    assert read == [f"READ {step}" for step in problem.setups[1].steps]
    assert {"$BASE=b_stock", "$BASE=b_stock_2", "$TOOL=t_holder"} <= set(lines)
    second_base = pose(list(data(files)["b_stock_2"].values()))
    assert np.allclose(second_base, inverse(plan.bases["left"]) @ synthetic.ROTATED_STOCK, atol=1e-6)


@pytest.mark.parametrize("fields", [{"io": {}}, {"io": {"left": {"doWater": 1}}}])
def test_a_signal_without_a_number(fields):
    with pytest.raises(TandemError) as caught:
        programs(*krl_job.alone(**fields))
    (issue,) = caught.value.issues
    assert issue.code == "post.signal"
    assert "doSpindle" in issue.message
    assert issue.field == "controller.io.left"


def test_a_pose_that_is_nearer_than_least_speeds_go_in_the_least_time_is_the_one_before() -> None:
    """At 0.1 mm/s, 6 ms take the arm 0.6 um: nearer poses are none of their own, and do not add up."""
    x = np.array([0.0, 1.0, 1.0003, 1.0007, 1.0009, 2.0, 2.0005, 1.9998, 1.9998])
    position, angles = np.zeros((9, 3)), np.zeros((9, 3))
    position[:, 0] = x
    angles[8, 2] = 0.01
    syntax._snap_in_place(position, angles)
    assert position[:, 0].tolist() == [0.0, 1.0, 1.0, 1.0007, 1.0007, 2.0, 2.0, 2.0, 2.0]
    assert angles[8, 2] == 0.01
