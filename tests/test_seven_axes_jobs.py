"""Jobs of a Panda and an iiwa from their URDFs.

Poses and curves milled into a panel are planned with the last joint as a freedom, exact by the product of
exponentials of the file. Also what is refused, and a Panda that stands beside an arm at work and is part of
the proof.
"""

from __future__ import annotations

import dataclasses
import json
import shutil

import numpy as np
import pytest
import yaml

from planner import pipeline, plans
from planner.issues import TandemError, has_errors
from planner.motion import freedom_ranges, solve
from planner.motion.planning_scene import Scene
from planner.motion.search.subsampling import select_targets
from planner.motion.trajectory import trajopt
from planner.processes import registry
from planner.proof.kinematics import arm_model
from planner.reading.urdf import read_chain
from planner.report import motion_file
from planner.service import cell_drawing
from planner.targets import JointFreedom
from tests import small_problem, test_ur_jobs, urdf_text

TEXTS = {"panda": urdf_text.panda(), "iiwa": urdf_text.iiwa()}
PAYLOAD = {"panda": 3.0, "iiwa": 14.0}


def write_job(folder, name, source, table=None, text=None):
    if table is not None:
        small_problem.write(folder, table=table)
    (folder / f"{name}.urdf").write_text(TEXTS[name] if text is None else text, "utf-8")
    arm = source["cell"]["arms"][0]
    arm["robot"] = {"urdf": f"{name}.urdf", "name": name, "family": "generic", "payload_kg": PAYLOAD[name]}
    arm.pop("home_deg", None)
    (folder / "problem.yaml").write_text(yaml.safe_dump(source), "utf-8")
    return pipeline.load(folder / "problem.yaml")


def row_of_poses(turns=0.1, x=450.0):
    source, table = test_ur_jobs.poses(turns)
    source["stock"]["place"]["xyz_mm"] = [x, 0, 0]
    return source, table.replace("650,", f"{x:g},")


def panel(folder):
    source = test_ur_jobs.panel()
    source["stock"]["place"]["xyz_mm"] = [550, 0, 300]
    for path in (test_ur_jobs.PROBLEMS / "engrave").iterdir():
        if path.is_file() and path.name != "problem.yaml":
            shutil.copy(path, folder)
    return source


def plan_job(problem):
    return solve.solve(problem, [job.targets() for job in registry.jobs(problem)])


def require_proven(problem, plan, text):
    """The one operation of a plan: its TCPs by the URDF's product of exponentials, limits and speeds."""
    (own,) = plan.operations
    ((arm, q),) = own.q.items()
    one = problem.cell.arm(arm)
    chain = read_chain(text, "base_link", "tool0")
    scene = Scene.of(problem.cell, (arm,), plan.stock_poses[0], problem.settings)
    expected = scene.tcp_poses(own.targets, own.values, np.arange(own.targets.count))[arm]
    assert np.abs(one.base @ chain.tip(q) @ one.tool.tcp - expected).max() < 1e-9
    assert q.shape == (own.targets.count, 7)
    assert (q >= chain.lower).all() and (q <= chain.upper).all()
    assert (np.diff(own.time) > 0.0).all()
    assert (np.abs(np.diff(q, axis=0)) <= 1.001 * np.diff(own.time)[:, None] * chain.velocity).all()
    (joint,) = (f for f in own.targets.freedoms if isinstance(f, JointFreedom))
    column = own.values[:, [f.name for f in own.targets.freedoms].index(joint.name)]
    np.testing.assert_allclose(q[:, 6], column, atol=1e-12)
    for way in (own.approach[arm], own.retreat[arm]):
        assert way.shape[1] == 7
    np.testing.assert_allclose(own.approach[arm][[0, -1]], [one.home, q[0]])
    return own, joint, q


@pytest.fixture(scope="module", params=TEXTS)
def row(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("row")
    problem = write_job(folder, request.param, *row_of_poses())
    return folder, request.param, problem, plan_job(problem)


def test_a_row_of_poses_is_planned_and_the_last_joint_goes_where_it_suits(row):
    _, name, problem, plan = row
    own, joint, q = require_proven(problem, plan, TEXTS[name])
    assert joint.is_sole_rotation
    assert np.rad2deg(np.ptp(q[:, 6])) > 5.0
    scene = Scene.of(problem.cell, ("left",), plan.stock_poses[0], problem.settings)
    path = trajopt.PathProblem(scene, own.targets, own.metrics["branch"], None)
    held = path.joints(np.repeat(own.values[20:21], 41, axis=0), q)  # as it stands half way
    assert held is None or path.smoothness(held) > path.smoothness(q)


def test_the_optimiser_has_the_true_slopes_of_the_last_joint(row):
    _, _, problem, plan = row
    (own,) = plan.operations
    (model,) = solve.setup_groups(problem, [own.targets])[0].models()
    scene = Scene.of(problem.cell, ("left",), plan.stock_poses[0], problem.settings, model)
    path = trajopt.PathProblem(scene, own.targets, own.metrics["branch"], None)
    values, q, step = own.values, own.q["left"], 1e-6
    ahead, behind = (path.joints(values + way, q) for way in (step, -step))
    slopes = (ahead - behind)[..., None] / (2.0 * step)
    np.testing.assert_allclose(path.rates(values, q), slopes, atol=1e-5)
    np.testing.assert_allclose(path.plant_rates(scene.model, values, q), slopes, atol=1e-5)


def test_check_finds_nothing_but_that_no_language_has_seven_joints(row):
    _, name, problem, _ = row
    (issue,) = pipeline.check(problem)
    assert issue.code == "post.language"
    assert name in issue.message and "seven axes" in issue.message
    assert "check still reports" in issue.hint
    with pytest.raises(TandemError) as caught:
        pipeline.plan(problem)
    assert [item.code for item in caught.value.issues] == ["post.language"]
    assert [item.code for item in pipeline.quick_check(problem, 6).issues] == ["post.language"]


def test_plan_and_motion_of_seven_joints_are_saved_and_read_again(row, tmp_path):
    _, _, problem, plan = row
    for file, content in plans.dump(plan).items():
        (tmp_path / file).write_bytes(content if isinstance(content, bytes) else content.encode())
    again = plans.load(tmp_path)
    (own,), (kept,) = plan.operations, again.operations
    np.testing.assert_array_equal(own.q["left"], kept.q["left"])
    assert kept.targets.freedoms[0].arm == "left"
    assert plan.sample(0.1).q["left"].shape[1] == 7
    motion_data = json.loads(motion_file.motion_json(problem, plan))
    degrees = motion_data["operations"][0]["arms"]["left"]["joints_deg"]
    np.testing.assert_allclose(degrees, np.rad2deg(own.q["left"]), atol=1e-3)


def test_the_map_of_the_last_joint_is_free_where_the_plan_is(row):
    _, _, problem, plan = row
    (own,) = plan.operations
    stand = solve.setup_groups(problem, [own.targets])[0]
    (model,) = stand.models()
    scene = Scene.of(problem.cell, ("left",), stand.stock_pose, problem.settings, model)
    few, rows = own.targets, [0, 20, 40]
    result = freedom_ranges.compute_freedom_map(
        scene, select_targets(few, np.array(rows)), few.freedoms[0].name, own.values[rows]
    )
    for k, target in enumerate(rows):
        near = int(np.argmin(np.abs(result.values[k] - own.values[target, 0])))
        assert result.grid.free[k, near]


def test_the_page_has_poses_of_all_links_and_a_map_of_the_last_joint(row):
    _, _, problem, plan = row
    name = plan.operations[0].targets.freedoms[0].name
    sampling = cell_drawing.TargetSampling(3, freedom=name)
    result, issues = cell_drawing.view(problem, sampling=sampling)
    assert issues == []
    assert [target["posture"] for target in result["targets"]] == [1, 2, 3]
    assert len(result["joints_deg"]["left"][1]) == 7
    assert len(result["poses"]["left/link_7"]) == 4
    assert {"name": name, "unit": "deg"} in result["freedoms"]
    assert len(result["map"]["values"]) == 3


def test_a_place_of_the_block_is_found_at_which_the_arm_gets_through(tmp_path):
    source, table = row_of_poses()
    source["stock"]["place"] = "auto"
    source["operations"][0]["frame"] = "stock"
    lines = table.replace("450,", "0,").replace(",300,", ",250,")
    problem = write_job(tmp_path, "iiwa", source, lines)
    (tmp_path / "targets.csv").write_text(lines)
    plan = plan_job(problem)
    assert plan.metrics["placement_score_deg"] > 0.0
    require_proven(problem, plan, TEXTS["iiwa"])


def test_what_is_out_of_reach_is_told(tmp_path):
    issues = pipeline.check(write_job(tmp_path, "panda", *row_of_poses(x=900.0)))
    assert "motion.no_reach" in {issue.code for issue in issues}


def test_an_iiwa_mills_a_panel_with_spin_and_last_joint_free(tmp_path):
    problem = write_job(tmp_path, "iiwa", panel(tmp_path))
    plan = plan_job(problem)
    own, joint, _ = require_proven(problem, plan, TEXTS["iiwa"])
    assert not joint.is_sole_rotation
    assert own.metrics["clearance_mm"] > 1e3 * problem.settings.clearance
    assert not has_errors(plan.issues)


def test_a_posture_has_as_many_joints_as_the_arm_has_axes(tmp_path):
    source, table = row_of_poses()
    write_job(tmp_path, "panda", source, table)
    source["cell"]["arms"][0]["home_deg"] = [0, 0, 0, -90, 0, 90]
    (tmp_path / "problem.yaml").write_text(yaml.safe_dump(source), "utf-8")
    with pytest.raises(TandemError) as caught:
        pipeline.load(tmp_path / "problem.yaml")
    (issue,) = caught.value.issues
    assert issue.field == "cell.arms.0.home_deg" and "6 angles, the robot has 7 axes" in issue.message


def test_stiffness_of_six_axes_is_refused(tmp_path):
    source, table = row_of_poses()
    write_job(tmp_path, "panda", source, table)
    source["cell"]["arms"][0]["stiffness"] = {"joints_nm_rad": [1e5] * 6, "source": "by hand"}
    (tmp_path / "problem.yaml").write_text(yaml.safe_dump(source), "utf-8")
    with pytest.raises(TandemError, match="remove it"):
        pipeline.load(tmp_path / "problem.yaml")


@pytest.mark.parametrize(("family", "words"), [("abb", "write generic"), ("ur", "this one has seven")])
def test_families_whose_programs_name_six_joints_are_refused(tmp_path, family, words):
    source, table = row_of_poses()
    write_job(tmp_path, "panda", source, table)
    source["cell"]["arms"][0]["robot"]["family"] = family
    (tmp_path / "problem.yaml").write_text(yaml.safe_dump(source), "utf-8")
    with pytest.raises(TandemError) as caught:
        pipeline.load(tmp_path / "problem.yaml")
    assert words in " ".join(issue.message for issue in caught.value.issues)


def write_two_arm_job(folder):
    """Return a job of a catalogue arm with a Panda that stands still in its cell."""
    small_problem.write(folder)
    (folder / "panda.urdf").write_text(TEXTS["panda"], "utf-8")
    source = yaml.safe_load(small_problem.PROBLEM)
    robot = {"urdf": "panda.urdf", "name": "panda", "family": "generic", "payload_kg": 3}
    tool = {"kind": "plain", "tcp": {"xyz_mm": [0, 0, 100]}, "mass_kg": 1.0, "cog_mm": [0, 0, 50]}
    base = {"xyz_mm": [450, 900, 0]}
    source["cell"]["arms"].append({"name": "right", "robot": robot, "base": base, "tool": tool})
    (folder / "beside.yaml").write_text(yaml.safe_dump(source), "utf-8")
    return pipeline.load(folder / "beside.yaml")


def test_an_arm_works_beside_a_panda_and_is_proven(tmp_path):
    outcome = pipeline.plan(write_two_arm_job(tmp_path))
    assert outcome.verified
    minimum = next(rule for rule in outcome.proof.rules if rule.code == "verify.clearance")
    assert minimum.passed


def test_the_proof_holds_each_length_of_seven_axes_against_the_urdf(tmp_path):
    data = write_two_arm_job(tmp_path).cell.arms[1].data
    assert arm_model.compare_with_catalogue(arm_model.robot_machine(data)) == []
    for key in ("a2", "a3", "a4", "c1", "c2", "c3", "c4"):
        form = dataclasses.replace(data.form, **{key: getattr(data.form, key) + 1e-6})
        other = dataclasses.replace(data, form=form)
        assert arm_model.compare_with_catalogue(arm_model.robot_machine(other)), key
    for change in ({"offsets": data.form.offsets + 1e-6}, {"signs": -data.form.signs}):
        other = dataclasses.replace(data, form=dataclasses.replace(data.form, **change))
        assert arm_model.compare_with_catalogue(arm_model.robot_machine(other))
