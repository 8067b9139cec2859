"""The proof's own kinematics: the chain of a URDF against Drake, derived values against another library.

Refusals are tested too.
"""

from __future__ import annotations

import dataclasses
from xml.etree import ElementTree as ET

import numpy as np
import py_opw_kinematics as opw
import pytest
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

from planner.catalogue import robots
from planner.issues import TandemError
from planner.proof.kinematics import arm_model, inverse_kinematics
from planner.proof.kinematics.chain import POSTURES_PER_BATCH
from tests.robot_sample import SAMPLE


def postures(machine, count=1000, seed=11):
    """Within the limits and a whole turn beyond them."""
    rng = np.random.default_rng(seed)
    return rng.uniform(machine.data.lower - np.pi, machine.data.upper + np.pi, (count, 6))


def plant_of(text):
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModelsFromString(text, "urdf")
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base_link"))
    plant.Finalize()
    return plant


def drakes(plant, links, q):
    """Poses (B, L, 4, 4) of links by Drake's own reader and kinematics."""
    context, out = plant.CreateDefaultContext(), np.empty((len(q), len(links), 4, 4))
    frames = [plant.GetFrameByName(link) for link in links]
    for i, row in enumerate(q):
        plant.SetPositions(context, row)
        for k, frame in enumerate(frames):
            out[i, k] = plant.CalcRelativeTransform(context, plant.world_frame(), frame).GetAsMatrix4()
    return out


@pytest.mark.parametrize("name", SAMPLE)
def test_every_link_is_where_drake_has_it(name):
    machine = arm_model.robot_machine(robots.robot(name))
    q = postures(machine)
    plant = plant_of(robots.urdf_path(name).read_text("utf-8"))
    expected = drakes(plant, machine.chain.links, q)
    deviation = np.abs(machine.chain.frames(q) - expected).max(axis=(0, 2, 3))
    assert machine.chain.links == (*(f"link_{i}" for i in range(1, 7)), "tool0")
    assert deviation.max() <= 1e-12, dict(zip(machine.chain.links, deviation, strict=True))
    np.testing.assert_allclose(machine.flange(q), expected[:, 6], atol=1e-12)


@pytest.mark.parametrize("name", SAMPLE)
def test_the_file_is_xml_with_its_namespace_and_the_catalogues_figures(name):
    text = robots.urdf_path(name).read_text("utf-8")
    assert ET.fromstring(text).get("name") == name
    assert 'xmlns:drake="' in text
    machine = arm_model.robot_machine(robots.robot(name))
    assert arm_model.compare_with_catalogue(machine) == []
    np.testing.assert_allclose(machine.chain.lower, machine.data.lower, atol=1e-12)
    np.testing.assert_allclose(machine.chain.upper, machine.data.upper, atol=1e-12)
    np.testing.assert_allclose(machine.chain.velocity, machine.data.velocity, atol=1e-12)


@pytest.mark.parametrize("name", SAMPLE)
def test_every_solution_leads_back_to_its_pose_by_drake(name):
    """All eight branches of poses that random joints make; some of the other branches are out of reach."""
    machine = arm_model.robot_machine(robots.robot(name))
    q = np.random.default_rng(12).uniform(machine.data.lower, machine.data.upper, (40, 6))
    plant = plant_of(robots.urdf_path(name).read_text("utf-8"))
    pose = drakes(plant, ["tool0"], q)[:, 0]
    found = inverse_kinematics.solve(machine, np.repeat(pose, 8, axis=0), np.tile(np.arange(8), len(q)))
    good = np.isfinite(found).all(axis=1)
    assert good.reshape(-1, 8).any(axis=1).all()
    assert good.sum() > 4 * len(q)
    back = drakes(plant, ["tool0"], found[good])[:, 0]
    assert np.abs(back - np.repeat(pose, 8, axis=0)[good]).max() <= inverse_kinematics.POSE_TOLERANCE


def test_a_solution_that_the_chain_does_not_lead_back_from_does_not_count():
    machine = arm_model.robot_machine(robots.robot("irb140"))
    q = np.random.default_rng(3).uniform(machine.data.lower, machine.data.upper, (50, 6))
    pose, branch = machine.flange(q), inverse_kinematics.branch_of(machine, q)
    assert np.isfinite(inverse_kinematics.solve(machine, pose, branch)).all()
    for field in ("a1", "a2", "b", "c1", "c2", "c3", "c4"):
        shape = dataclasses.replace(machine.shape, **{field: getattr(machine.shape, field) + 1e-7})
        wrong = dataclasses.replace(machine, spherical_shape=shape)
        assert np.isnan(inverse_kinematics.solve(wrong, pose, branch)).all(axis=1).mean() > 0.9


def test_batches_keep_their_shape():
    machine = arm_model.robot_machine(robots.robot("kr60_ha"))
    q = postures(machine, POSTURES_PER_BATCH + 6).reshape(-1, 2, 6)
    assert machine.chain.frames(q).shape == (len(q), 2, 7, 4, 4)
    assert machine.flange(q[0, 0]).shape == (4, 4)
    for i in (0, len(q) // 2, len(q) - 1):
        np.testing.assert_allclose(machine.flange(q)[i, 1], machine.flange(q[i, 1]), atol=1e-14)
    assert machine.flange(np.zeros((0, 6))).shape == (0, 4, 4)


# ---- arms that others might write --------------------------------------------------------------------


def random_arm(rng):
    """An arm of the form with lengths, signs and offsets of its own, as the kinematic model of
    py-opw-kinematics, and a URDF of it: frames lie anywhere along the axes and are turned anyhow, and joints
    that are fixed stand between."""
    a1, a2, b, c1, c2, c3, c4 = rng.uniform(-0.3, 0.3, 3).tolist() + rng.uniform(0.1, 1.0, 4).tolist()
    signs = rng.choice([-1.0, 1.0], 6)
    offsets = np.array([0.0, *(0.5 * np.pi * rng.integers(-1, 2, 2)), 0.0, 0.0, *rng.uniform(-1.0, 1.0, 1)])
    model = opw.KinematicModel(
        a1=a1, a2=a2, b=b, c1=c1, c2=c2, c3=c3, c4=c4,
        offsets=tuple(offsets), flip_axes=tuple(bool(s < 0) for s in signs),
    )  # fmt: skip

    def turn(axis, angle):
        out = np.eye(4)
        i, k = {"z": (0, 1), "y": (2, 0)}[axis]
        out[[i, i, k, k], [i, k, i, k]] = np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)
        return out

    def moved(x, y, z):
        out = np.eye(4)
        out[:3, 3] = x, y, z
        return out

    theta = -offsets
    steps = ((0, 0, 0), (a1, b, c1), (0, 0, c2), (a2, 0, c3), (0, 0, 0), (0, 0, 0))
    pose, joints = np.eye(4), []
    for i, axis in enumerate("zyyzyz"):
        pose = pose @ moved(*steps[i])
        direction = signs[i] * pose[:3, "xyz".index(axis)]
        joints.append((pose[:3, 3] + rng.uniform(-0.2, 0.2) * direction, direction))
        pose = pose @ turn(axis, theta[i])
    tip = pose @ moved(0, 0, c4)

    lines, last, links = ['<robot name="any"><link name="base_link"/>'], np.eye(4), ["base_link"]

    def hang(frame, kind, rest=""):
        nonlocal last
        step = np.linalg.inv(last) @ frame
        r = step[:3, :3]
        rpy = np.arctan2(r[2, 1], r[2, 2]), -np.arcsin(np.clip(r[2, 0], -1, 1)), np.arctan2(r[1, 0], r[0, 0])
        xyz, turns = (" ".join(repr(float(v)) for v in some) for some in (step[:3, 3], rpy))
        name = "tool0" if kind == "tip" else f"part_{len(links)}"
        lines.append(
            f'<link name="{name}"/><joint name="to_{name}" type="{"fixed" if kind == "tip" else kind}">'
            f'<parent link="{links[-1]}"/><child link="{name}"/>'
            f'<origin xyz="{xyz}" rpy="{turns}"/>{rest}</joint>'
        )
        links.append(name)
        last = frame

    for k, (place, direction) in enumerate(joints):
        if k in (1, 4):
            hang(np.linalg.inv(anyhow(rng)), "fixed")
        frame = anyhow(rng)
        frame[:3, 3] = place
        axis = " ".join(repr(float(v)) for v in 2.0 * frame[:3, :3].T @ direction)
        hang(frame, "revolute", f'<axis xyz="{axis}"/><limit lower="-3" upper="3" velocity="1" effort="0"/>')
    hang(tip, "tip")
    return model, "\n".join([*lines, "</robot>"])


def anyhow(rng):
    out = np.eye(4)
    out[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    out[:3, 0] *= np.linalg.det(out[:3, :3])
    out[:3, 3] = rng.uniform(-0.3, 0.3, 3)
    return out


@pytest.mark.parametrize("seed", range(12))
def test_a_chain_written_by_others_is_read_and_its_shape_found(seed):
    """The reader against Drake's and the shape against py-opw-kinematics, both of the same arm."""
    rng = np.random.default_rng(seed)
    model, text = random_arm(rng)
    chain = arm_model.read_chain(text)
    q = rng.uniform(-3.0, 3.0, (60, 6))
    expected = drakes(plant_of(text), chain.links, q)
    np.testing.assert_allclose(chain.frames(q), expected, atol=1e-12)
    other = opw.Robot(model, degrees=False)
    np.testing.assert_allclose(chain.tip(q), [other.forward(tuple(row)).as_matrix() for row in q], atol=1e-9)
    machine = arm_model.RobotMachine(robots.robot("irb140"), chain, arm_model.shape_of(chain))
    back = inverse_kinematics.solve(machine, chain.tip(q), inverse_kinematics.branch_of(machine, q))
    assert np.isfinite(back).all()
    turns = (back - q + np.pi) % (2.0 * np.pi) - np.pi
    assert np.abs(turns[inverse_kinematics.singularity_distance(machine, q) > 1e-2]).max() < 1e-7


# ---- what is refused ---------------------------------------------------------------------------------

TEXT = robots.urdf_path("irb140").read_text("utf-8")


def in_joint(number, old, new):
    """The text with one thing changed in one joint."""
    head, tail = TEXT.split(f'<joint name="joint_{number}"')
    assert old in tail.split("</joint>")[0]
    return f'{head}<joint name="joint_{number}"{tail.replace(old, new, 1)}'


UNREADABLE = {
    "not XML": (TEXT[: len(TEXT) // 2], "is not XML"),
    "a prefix without its namespace": ('<robot><drake:capsule radius="1"/></robot>', "unbound prefix"),
    "another kind of file": ("<sdf/>", "begins with <sdf>"),
    "no flange": (
        TEXT.replace('<child link="tool0"/>', '<child link="tool1"/>'),
        "tool0 has no parent joint",
    ),
    "a circle": (
        TEXT.replace('<parent link="base_link"/>', '<parent link="link_3"/>'),
        " has no parent joint",
    ),
    "five joints": (TEXT.replace('joint_4" type="revolute"', 'joint_4" type="fixed"'), "has 5 moving joints"),
    "a slide": (TEXT.replace('joint_4" type="revolute"', 'joint_4" type="prismatic"'), "5 of them revolute"),
    "a word": (TEXT.replace('<axis xyz="0 1 0"/>', '<axis xyz="0 up 0"/>', 1), "3 finite numbers"),
    "two numbers": (TEXT.replace('<axis xyz="0 1 0"/>', '<axis xyz="0 1"/>', 1), "3 finite numbers"),
    "no number": (TEXT.replace('<axis xyz="0 1 0"/>', '<axis xyz="0 nan 0"/>', 1), "3 finite numbers"),
    "no axis": (TEXT.replace('<axis xyz="0 1 0"/>', '<axis xyz="0 0 0"/>', 1), "with the invalid axis"),
    "no parent": (TEXT.replace('<parent link="link_2"/>', ""), "without a parent link"),
    "two parents": (TEXT.replace('<child link="link_4"/>', '<child link="link_5"/>'), "to two joints"),
    "axis 2 askew": (TEXT.replace('<axis xyz="0 1 0"/>', '<axis xyz="0 1 0.001"/>', 1), "square to axis 1"),
    "axis 3 askew": (
        in_joint(3, 'xyz="0 1 0"', 'xyz="0.001 1 0"'),
        "0.057296 deg away from being parallel to",
    ),
    "an offset wrist": (in_joint(6, 'xyz="0 0 0"', 'xyz="0 0 0.05"'), "50.000000 mm away from"),
}


@pytest.mark.parametrize("case", UNREADABLE)
def test_what_is_no_such_robot_is_refused_in_words(case, tmp_path, monkeypatch):
    text, words = UNREADABLE[case]
    path = tmp_path / "irb140.urdf"
    path.write_text(text, "utf-8")
    monkeypatch.setattr(arm_model, "urdf_path", lambda name: path)
    with pytest.raises(TandemError) as caught:
        arm_model.robot_machine(robots.robot("irb140"))
    (issue,) = caught.value.issues
    assert issue.code == "verify.robot_model"
    assert words in issue.message, issue.message
    assert issue.file == str(path)
