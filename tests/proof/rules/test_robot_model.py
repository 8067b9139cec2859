"""Robots whose files or catalogue dimensions differ from the planned arm: nothing is proven.

Every link counts.
"""

from __future__ import annotations

import dataclasses
import re
import shutil

import numpy as np
import pytest
import yaml

from planner.catalogue import robots
from planner.cell.plant import CellModel, build_cell_model
from planner.issues import TandemError
from planner.proof.context import Context
from planner.proof.kinematics.chain import SerialChain
from planner.proof.models import MODELS
from planner.proof.prove import Prover, prove
from planner.proof.rules import robot_motion
from tests.languages.krl import krl_job
from tests.proof import held_job, small_job

MM, TENTH = 1e-3, np.deg2rad(0.1)
JOINTS = (*(f"joint_{i}" for i in range(1, 7)), "joint_tool0")
CHANGES = [
    *((joint, "xyz", axis) for joint in JOINTS for axis in range(3)),
    *((joint, "rpy", axis) for joint in JOINTS for axis in range(3)),
    *((joint, "axis", axis) for joint in JOINTS[:6] for axis in range(2)),
]
LENGTHS = ("a1", "a2", "b", "c1", "c2", "c3", "c4")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Use a separate catalogue instead of the built-in one."""
    small_job.programs()
    copy = tmp_path / "urdf"
    shutil.copytree(robots.data_dir("urdf"), copy)
    monkeypatch.setattr(robots, "_PACKAGE", tmp_path / "planner")
    robots._table.cache_clear()
    yield copy
    robots._table.cache_clear()


def changed(text, joint, kind, axis, rng):
    """Return the URDF with one origin or axis off by 1 mm or 0.1 degree, in either direction."""
    found = re.search(rf'<joint name="{joint}".*?</joint>', text, re.DOTALL)
    by = rng.choice([-1.0, 1.0])
    if kind == "axis":
        there = re.search(r'<axis xyz="(.*?)"', found[0])
        was = np.array([float(v) for v in there[1].split()])
        across = np.delete(np.eye(3), int(np.argmax(np.abs(was))), axis=0)[axis]
        value = np.cos(TENTH) * was + by * np.sin(TENTH) * across
    else:
        there = re.search(rf'<origin.*? ?{kind}="(.*?)"', found[0])
        value = np.array([float(v) for v in there[1].split()])
        value[axis] += by * (MM if kind == "xyz" else TENTH)
    start = found.start() + there.start(1)
    end = found.start() + there.end(1)
    return text[:start] + " ".join(repr(float(v)) for v in value) + text[end:]


def rewritten(folder, joint, kind, axis, name="irb140"):
    path = folder / f"{name}.urdf"
    seed = [JOINTS.index(joint), ("xyz", "rpy", "axis").index(kind), axis]
    path.write_text(changed(path.read_text("utf-8"), joint, kind, axis, np.random.default_rng(seed)), "utf-8")


@pytest.mark.parametrize(("joint", "kind", "axis"), CHANGES)
def test_a_urdf_that_is_off_ends_not_proven(folder, joint, kind, axis):
    rewritten(folder, joint, kind, axis)
    proof = Prover(small_job.problem(), small_job.claims()).prove(small_job.programs(), first_error=True)
    assert not proof.ok
    assert {issue.code for issue in proof.issues} == {"verify.robot_model"}


def test_the_folder_is_what_is_read_and_proves_as_it_was(folder):
    assert robots.urdf_path("irb140").parent == folder
    proof = prove(small_job.problem(), small_job.claims(), small_job.programs())
    assert proof.ok


@pytest.mark.parametrize(("module", "name"), [(held_job, "irb4600_40"), (krl_job, "kr10_r1100")])
def test_other_arms_too(folder, module, name):
    problem, claims, programs = module.problem(), module.claims(), module.programs()
    names = {arm.robot for arm in problem.cell.arms}
    rewritten(folder, "joint_4", "xyz", 1, sorted(names)[0])
    assert not prove(problem, claims, programs).ok


@pytest.mark.parametrize("key", LENGTHS)
def test_a_catalogue_that_is_off_ends_not_proven(folder, key):
    """The programs are planned with the catalogue's dimensions; the URDF is as it was."""
    entries = yaml.safe_load((folder / "robots.yaml").read_text("utf-8"))
    entries["irb140"]["opw_m"][key] += MM
    (folder / "robots.yaml").write_text(yaml.safe_dump(entries), "utf-8")
    proof = prove(small_job.problem(), small_job.claims(), small_job.programs())
    assert not proof.ok
    assert f"{key} is" in proof.issues[0].message


@pytest.mark.parametrize(
    ("key", "axis", "by", "words"),
    [
        ("offset_deg", 2, 0.1, "offset of axis 3"),
        ("sign", 5, -2, "axis 6 turns in opposite directions"),
        ("velocity_deg_s", 1, 1.0, "speed of axis 2"),
    ],
)
def test_an_offset_sign_or_speed_that_is_off_is_told(folder, key, axis, by, words):
    entries = yaml.safe_load((folder / "robots.yaml").read_text("utf-8"))
    entries["irb140"][key][axis] += by
    (folder / "robots.yaml").write_text(yaml.safe_dump(entries), "utf-8")
    proof = prove(small_job.problem(), small_job.claims(), small_job.programs())
    assert not proof.ok
    assert words in proof.issues[0].message


def test_limits_that_differ_are_told(folder):
    path = folder / "irb140.urdf"
    path.write_text(path.read_text("utf-8").replace('lower="-4.01425727958696"', 'lower="-4"'), "utf-8")
    proof = prove(small_job.problem(), small_job.claims(), small_job.programs())
    assert not proof.ok
    assert "lower limit of axis 3" in proof.issues[0].message


def test_a_file_that_cannot_be_read_ends_not_proven(folder):
    (folder / "irb140.urdf").write_text("<robot", "utf-8")
    proof = prove(small_job.problem(), small_job.claims(), small_job.programs())
    assert not proof.ok
    (issue,) = proof.issues
    assert issue.code == "verify.robot_model"
    assert "is not XML" in issue.message


def test_drake_is_not_asked_to_plan_with_a_file_that_cannot_be_read(folder):
    (folder / "irb140.urdf").write_text("<robot", "utf-8")
    problem = small_job.problem()
    with pytest.raises(TandemError) as caught:
        build_cell_model(problem.cell, problem.stock, np.eye(4))
    (issue,) = caught.value.issues
    assert issue.code == "catalogue.missing_data"
    assert str(folder / "irb140.urdf") in issue.message


# ---- every link, against Drake -----------------------------------------------------------------------


def kinematics(context, model):
    context.put(MODELS, lambda index: model)
    return robot_motion.kinematics(context)


@pytest.fixture(scope="module")
def small():
    context = Context(small_job.problem(), small_job.claims(), small_job.programs())
    place = context.stock_pose
    return context, build_cell_model(context.problem.cell, context.problem.stock, place, context.bases)


def test_a_thousand_samples_are_looked_at(small):
    context, model = small
    outcome = kinematics(context, model)
    assert outcome.issues == ()
    assert outcome.where == "every link at 1000 samples"


@pytest.mark.parametrize("link", range(7))
def test_a_link_that_the_proofs_chain_has_elsewhere(small, monkeypatch, link):
    context, model = small
    ask = SerialChain.frames

    def frames(chain, q):
        out = ask(chain, q)
        out[..., link, 0, 3] += 1e-8
        return out

    monkeypatch.setattr(SerialChain, "frames", frames)
    found = kinematics(context, model).issues
    name = f"link_{link + 1}" if link < 6 else "tool"
    assert {issue.code for issue in found} == {"verify.kinematics"}
    assert {body for issue in found for body in issue.bodies} == {f"left/{name}", f"right/{name}"}


@pytest.mark.parametrize("body", ["base_link", "link_2", "link_5", "tool"])
def test_a_link_that_the_clearance_has_elsewhere(small, monkeypatch, body):
    """The cell's own batched kinematics, the planner's, bounds the distances of bodies."""
    context, model = small

    ask = CellModel.poses

    def poses(self, q):
        out = ask(self, q)
        out[f"right/{body}"] = out[f"right/{body}"] + 1e-8 * np.eye(4, k=3)
        return out

    monkeypatch.setattr(CellModel, "poses", poses)
    found = kinematics(context, model).issues
    assert {issue.bodies for issue in found} == {(f"right/{body}",)}
    assert "the clearance bounds" in found[0].message


def test_the_planners_chain_is_held_against_drake(small, monkeypatch):
    """Its axis 3 turned the other way in memory: the programs' own motion is as it was, the cell's is not."""
    context, model = small
    robot = model.robots["left"]
    wrong = dataclasses.replace(robot.opw, signs=robot.opw.signs * np.array([1, 1, -1, 1, 1, 1]))
    other = dataclasses.replace(model, robots=model.robots | {"left": dataclasses.replace(robot, form=wrong)})
    found = kinematics(context, other).issues
    assert {issue.bodies[0] for issue in found} == {
        f"left/{n}" for n in ("link_3", "link_4", "link_5", "link_6", "tool")
    }


def test_a_held_block_is_looked_at():
    context = Context(held_job.problem(), held_job.claims(), held_job.programs())
    held = next(i for i in range(len(context.setups)) if context.stock_holder(i) is not None)
    models = context.get(MODELS)
    model = models(held)
    assert robot_motion.kinematics(context).issues == ()
    grip = dataclasses.replace(model.stock, grip=model.stock.grip + 1e-5 * np.eye(4, k=3))
    moved = build_cell_model(model.cell, grip, model.stock_pose, context.bases)
    context.put(MODELS, lambda index: moved if index == held else models(index))
    found = robot_motion.kinematics(context).issues
    assert ("stock",) in {issue.bodies for issue in found}
