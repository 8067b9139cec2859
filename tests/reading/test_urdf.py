"""Arms from the text of a URDF: parameters from axes, compared with the file's own kinematics.

Other classes and bad files are refused by name, each with a remedy that works.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.catalogue import robots
from planner.cell.kinematics import flange_poses
from planner.geometry.arrays import exp_rotation, from_parts, from_rpy
from planner.issues import TandemError
from planner.motion.planning_scene import inverse_kinematics
from planner.reading.arm_identification import fit_arm, read_custom_chain
from planner.reading.urdf import read_chain
from tests import urdf_text

UP, SIDE, AHEAD = np.eye(3)[[2, 1, 0]]
IRB = robots.robot("irb140")
TEXT = urdf_text.robot_urdf(IRB)


def fit_chain(text, base="base_link", tip=None):
    chain = read_chain(text, base, tip)
    return chain, fit_arm(chain)


def expect_refusal(text, base="base_link", tip=None):
    with pytest.raises(TandemError) as caught:
        fit_chain(text, base, tip)
    return caught.value.issues


def max_difference(a, b):
    return np.abs(a - b).max()


@pytest.mark.parametrize("name", robots.robot_names())
def test_robots_of_the_catalogue_are_found_again_from_their_files(name):
    known = robots.robot(name)
    chain, found = fit_chain(robots.urdf_path(name).read_text("utf-8"))
    assert type(found.form) is type(known.form)
    for field in dataclasses.fields(known.form):
        have, want = getattr(found.form, field.name), getattr(known.form, field.name)
        assert have is want or max_difference(have, want) < 1e-12, field.name
    assert (
        max_difference(chain.lower, known.lower) < 1e-8
        and max_difference(chain.velocity, known.velocity) < 1e-8
    )


@pytest.mark.parametrize("name", ["irb140", "kr210_r2700"])
def test_base_and_tip_may_be_turned_and_links_have_any_frames(name):
    known = robots.robot(name)
    rng = np.random.default_rng(3)
    base = from_rpy([0.1, -0.2, 0.3], [0.4, np.pi, 0.0])
    tip = from_rpy([0.01, 0.02, -0.05], [0.0, np.pi / 2, 0.3])
    text = urdf_text.robot_urdf(known, base, tip, exp_rotation(rng.normal(size=(6, 3))))
    chain, found = fit_chain(text)
    q = rng.uniform(known.lower, known.upper, size=(200, 6))
    assert max(found.deviation) < 1e-12
    assert max_difference(chain.tip(q), np.linalg.inv(base) @ flange_poses(known.opw, q) @ tip) < 1e-12
    for key in ("a1", "a2", "b", "c2", "c3"):
        assert abs(getattr(found.form, key) - getattr(known.opw, key)) < 1e-12, key


lengths = st.floats(0.05, 1.0)
small = st.floats(-0.2, 0.2)
turn = st.integers(-5, 6).map(lambda k: k * np.pi / 12)
sign = st.sampled_from([-1.0, 1.0])


@settings(max_examples=60, deadline=None)
@given(
    st.tuples(small.map(abs), small, small, lengths, lengths, lengths, lengths),
    st.tuples(*[turn] * 5),
    st.tuples(*[sign] * 6),
)
def test_any_arm_of_the_form_is_found_and_its_start_posture_too(sizes, offsets, signs):
    keys = ("a1", "a2", "b", "c1", "c2", "c3", "c4")
    opw = robots.OpwParameters(
        **dict(zip(keys, sizes, strict=True)), offsets=np.array([0.0, *offsets]), signs=np.array(signs)
    )
    chain, found = fit_chain(urdf_text.robot_urdf(dataclasses.replace(IRB, form=opw)))
    assert found.deviation[0] < 1e-9 and found.deviation[1] < 1e-9
    q = np.random.default_rng(1).uniform(chain.lower, chain.upper, size=(100, 6))
    solutions = inverse_kinematics(found.form, chain.tip(q))
    joint_error = np.abs(np.angle(np.exp(1j * (solutions - q[:, None]))))
    assert np.nanmin(joint_error.max(axis=-1), axis=1).max() < 1e-5


@settings(max_examples=60, deadline=None)
@given(
    st.tuples(st.floats(0.01, 0.3), lengths, lengths, lengths, st.floats(0.01, 0.3), lengths),
    st.tuples(*[turn] * 6),
    st.tuples(*[sign] * 6),
    st.booleans(),
)
def test_any_arm_with_three_parallel_axes_is_found_and_its_start_posture_too(
    sizes, offsets, signs, is_rotated
):
    form = robots.ParallelParameters(*sizes, offsets=np.array(offsets), signs=np.array(signs))
    ends = (from_rpy([0.1, -0.2, 0.3], [0.4, np.pi, 0.0]), from_rpy([0.01, 0.02, -0.05], [0.0, 1.2, 0.3]))
    chain, found = fit_chain(
        urdf_text.robot_urdf(dataclasses.replace(IRB, form=form), *(ends if is_rotated else ()))
    )
    assert isinstance(found.form, robots.ParallelParameters)
    assert max(found.deviation) < 1e-9
    got = [getattr(found.form, key) for key in ("b", "c2", "c3", "c4")]
    np.testing.assert_allclose(got, [sizes[0], *sizes[2:5]], atol=1e-9)
    q = np.random.default_rng(1).uniform(chain.lower, chain.upper, size=(100, 6))
    solutions = inverse_kinematics(found.form, chain.tip(q))
    joint_error = np.abs(np.angle(np.exp(1j * (solutions - q[:, None]))))
    assert np.nanmin(joint_error.max(axis=-1), axis=1).max() < 1e-5


@settings(max_examples=20, deadline=None)
@given(
    st.tuples(small.map(abs), small, st.floats(0.01, 0.2), small, lengths, lengths, lengths, lengths),
    st.tuples(*[turn] * 5),
    st.tuples(*[sign] * 6),
    st.booleans(),
)
def test_any_arm_with_an_offset_wrist_is_found_and_its_start_posture_too(sizes, offsets, signs, is_rotated):
    form = robots.OffsetParameters(*sizes, offsets=np.array([0.0, *offsets]), signs=np.array(signs))
    ends = (from_rpy([0.1, -0.2, 0.3], [0.4, np.pi, 0.0]), from_rpy([0.01, 0.02, -0.05], [0.0, 1.2, 0.3]))
    chain, found = fit_chain(
        urdf_text.robot_urdf(dataclasses.replace(IRB, form=form), *(ends if is_rotated else ()))
    )
    assert isinstance(found.form, robots.OffsetParameters)
    assert max(found.deviation) < 1e-9
    q = np.random.default_rng(1).uniform(chain.lower, chain.upper, size=(60, 6))
    solutions = inverse_kinematics(found.form, chain.tip(q))
    joint_error = np.abs(np.angle(np.exp(1j * (solutions - q[:, None])))).max(axis=-1)
    assert (np.where(np.isnan(joint_error), 9.0, joint_error).min(axis=1) < 1e-5).sum() >= 58


def test_noise_of_an_offset_wrist_is_refused_with_the_deviation():
    points = np.array(OFFSET[1])
    points[4:, 2] += 1e-4
    (issue,) = expect_refusal(urdf_text.arm(np.array(OFFSET[0]), points, pose(1.3, 0, 1, SIDE)))
    assert issue.code == "robot.deviation" and "an offset wrist" in issue.message


@pytest.mark.parametrize("arm", ["SEVEN", "PANDA"])
def test_seven_axes_with_the_third_fixed_are_six_that_are_known(arm):
    axes, points = {"SEVEN": SEVEN, "PANDA": PANDA}[arm]
    text = urdf_text.arm(np.array(axes), points, pose(0.09, 0, 1.2, np.zeros(3)))
    assert isinstance(fit_chain(text)[1].form, robots.SevenParameters)
    _, found = fit_chain(text.replace('name="j3" type="revolute"', 'name="j3" type="fixed"'))
    assert max(found.deviation) < 1e-9
    assert isinstance(found.form, robots.OffsetParameters) == (arm == "PANDA")


def test_a_ur10e_is_found_by_its_makers_lengths_wherever_base_and_tip_stand():
    """URDFs of ROS-Industrial have the base turned by 180 degrees against the controller's."""
    base, tip = from_rpy([0.0, 0.0, 0.0], [0.0, 0.0, np.pi]), from_rpy([0.0, 0.0, 0.1], [0.0, np.pi / 2, 0.0])
    q = np.random.default_rng(2).uniform(-np.pi, np.pi, (200, 6))
    for ends in ((), (base, tip)):
        chain, found = fit_chain(urdf_text.ur10e(*ends))
        assert max(found.deviation) < 1e-12
        for key in ("b", "c1", "c2", "c3", "c4"):
            assert abs(getattr(found.form, key) - getattr(urdf_text.UR10E_FORM, key)) < 1e-12, key
        expected = urdf_text.ur10e_flange(q)
        expected = np.linalg.inv(base) @ expected @ tip if ends else expected
        assert max_difference(chain.tip(q), expected) < 1e-12
        assert max_difference(flange_poses(found.form, q), expected) < 1e-12


def test_noise_of_three_parallel_axes_is_refused_with_the_deviation():
    points = np.array(PARALLEL[1])
    points[4:, 0] += 1e-4
    text = urdf_text.arm(np.array(PARALLEL[0]), points, pose(1.2, 0.3, 0.05, -AHEAD))
    (issue,) = expect_refusal(text)
    assert issue.code == "robot.deviation" and "three parallel axes" in issue.message


def test_angles_as_files_write_them_count_as_what_is_meant():
    turns = from_rpy([0, 0, 0], [0.5 * np.pi, 0, 0])[:3, :3]
    text = urdf_text.robot_urdf(IRB, turns=np.tile(turns, (6, 1, 1)))
    assert "1.5707963267948966" in text
    _, found = fit_chain(text.replace("1.5707963267948966", "1.5708"))
    assert max(found.deviation) < 1e-12
    assert 1e-6 < found.snapped[1] < 1e-4


# ---- not of the form ---------------------------------------------------------------------------------


def pose(x, y, z, axis):
    return from_parts(exp_rotation(0.5 * np.pi * np.asarray(axis)), np.array([x, y, z]))


PARALLEL = (
    [UP, SIDE, SIDE, SIDE, -UP, SIDE],
    [(0, 0, 0.16), (0, 0.2, 0.16), (0.6, 0.1, 0.16), (1.2, 0.1, 0.16), (1.2, 0.1, 0.05), (1.2, 0.2, 0.05)],
)
OFFSET = (
    [UP, SIDE, SIDE, AHEAD, SIDE, AHEAD],
    [(0, 0, 0.2), (0, 0, 0.3), (0, 0, 0.8), (0.2, 0, 0.9), (0.7, 0, 0.9), (0.8, 0, 0.98)],
)
SEVEN = ([UP, SIDE, UP, SIDE, UP, SIDE, UP], [(0, 0, z) for z in (0.3, 0.3, 0.3, 0.7, 1.1, 1.1, 1.1)])
PANDA = (
    [UP, SIDE, UP, SIDE, UP, SIDE, UP],
    [(0, 0, 0.3), (0, 0, 0.3), (0, 0, 0.6), (0.08, 0, 0.6), (0, 0, 1), (0, 0, 1), (0.09, 0, 1)],
)
CLASSES = {
    "(2, 3 and 4), whose axes 5 and 6 do not meet": (PARALLEL[0], [*PARALLEL[1][:5], (1.25, 0.2, 0.05)]),
    "(2, 3 and 4), whose axes 1 and 2 do not meet": (PARALLEL[0], [(-0.1, 0, 0.16), *PARALLEL[1][1:]]),
    "(2, 3 and 4), whose axes 4 and 5 are not square": (
        [*PARALLEL[0][:4], (UP + SIDE) / 2**0.5, AHEAD], [*PARALLEL[1][:4], *[(1.2, 0.1, 0.16)] * 2],
    ),
    "axes 4 and 5 do not meet": (OFFSET[0], [*OFFSET[1][:4], (0.7, 0, 0.95), (0.8, 0, 0.98)]),
    "intersect 30 mm off the plane of axis 1": (
        OFFSET[0], [*OFFSET[1][:3], (0.2, 0.03, 0.9), (0.7, 0, 0.9), (0.8, 0, 0.98)],
    ),
    "seven axes whose axes 1, 2 and 3 do not meet": (SEVEN[0], [(0.05, 0, 0.3), *SEVEN[1][1:]]),
    "seven axes whose axes 5 and 6 do not meet": (SEVEN[0], [*SEVEN[1][:5], (0.05, 0, 1.1), SEVEN[1][6]]),
    "seven axes whose axes 6 and 7 are not square": ([*SEVEN[0][:6], (UP + SIDE) / 2**0.5], SEVEN[1]),
    "axis 5 passes 50 mm beside the upper arm": (SEVEN[0], [*SEVEN[1][:4], *[(0, 0.05, 1.1)] * 3]),
    "axis 7 is 50 mm off along axis 6": (SEVEN[0], [*SEVEN[1][:6], (0, 0.05, 1.1)]),
    "five axes": tuple(part[:5] for part in OFFSET),
    "positioner with 2 axes": tuple(part[:2] for part in OFFSET),
    "with 9 axes": ([UP, SIDE, UP, *OFFSET[0]], [(0, 0, -1)] * 3 + OFFSET[1]),
    "2 and 3 are not parallel": ([UP, SIDE, AHEAD, *OFFSET[0][3:]], OFFSET[1]),
    "axes 3 and 4 are at 60 degrees": (
        [UP, SIDE, SIDE, np.array([3**0.5 / 2, 0.5, 0.0]), SIDE, AHEAD],
        [*OFFSET[1][:3], *[(0.5, 0, 0.9)] * 3],
    ),
}  # fmt: skip


@pytest.mark.parametrize("words", CLASSES)
def test_arms_of_other_classes_are_told_by_class_with_what_to_do(words):
    axes, points = CLASSES[words]
    (issue,) = expect_refusal(urdf_text.arm(np.array(axes), points, pose(1.3, 0, 1, SIDE)))
    assert issue.code == "robot.not_opw"
    assert words in issue.message
    assert issue.hint


def test_what_to_do_is_of_the_arm_at_hand():
    """A tip before the last axis is another mistake than an arm with five, and a positioner stands under a
    block."""
    short = tuple(part[:5] for part in OFFSET)
    (five,) = expect_refusal(urdf_text.arm(*map(np.array, short), pose(1.3, 0, 1, SIDE)))
    (early,) = expect_refusal(urdf_text.arm(*map(np.array, OFFSET), pose(1.3, 0, 1, SIDE)), tip="l5")
    (table,) = expect_refusal(urdf_text.arm(*(np.array(part[:1]) for part in OFFSET), pose(1.3, 0, 1, SIDE)))
    assert "use the version with six axes" in five.hint and "five axes" in early.message
    assert "name the flange after the sixth axis as tip" in early.hint
    assert (
        "a positioner with 1 axis;" in table.message and "turntable: or positioner: of the cell" in table.hint
    )
    unnamed = urdf_text.arm(*map(np.array, OFFSET), pose(1.3, 0, 0.9, SIDE), names=("base_link", "hand"))
    lamp = '<link name="lamp"/><joint name="k" type="fixed"><parent link="l1"/><child link="lamp"/></joint>'
    unnamed = unnamed.replace("</robot>", f"{lamp}</robot>")
    (tip,) = expect_refusal(unnamed)
    assert tip.code == "robot.chain" and tip.field == "tip"
    assert tip.hint.endswith("the longest chain from base_link ends at hand")


def test_the_base_behind_what_carries_the_arm_is_a_remedy():
    axes, points = [UP, SIDE, *OFFSET[0]], [(0, 0, -1), (0, 0, -0.5), *OFFSET[1][:5], OFFSET[1][4]]
    text = urdf_text.arm(np.array(axes), points, pose(1.3, 0, 0.9, SIDE))
    (issue,) = expect_refusal(text)
    assert "8 axes" in issue.message and "as base" in issue.hint
    chain, found = fit_chain(text, base="l2")
    assert max(found.deviation) < 1e-12
    assert chain.other_joints == ()  # axes that carry the base are not reported as joints beside the arm


def test_figures_with_noise_are_refused_with_the_deviation():
    """Tenths of a millimetre on axes, as ROS-Industrial's kr210l150 has, whose figures come of a mesh."""
    frames, rng = np.array(OFFSET[1][:5] + OFFSET[1][4:5]), np.random.default_rng(2)
    clean = urdf_text.arm(np.array(OFFSET[0]), frames, pose(1.3, 0, 0.9, SIDE))
    assert max(fit_chain(clean)[1].deviation) < 1e-12
    noisy = urdf_text.arm(
        np.array(OFFSET[0]), frames + rng.normal(size=(6, 3)) * 2e-4, pose(1.3, 0, 0.9, SIDE)
    )
    (issue,) = expect_refusal(noisy)
    assert issue.code == "robot.deviation"
    assert 0.05 < issue.value < 2.0 and f"{issue.value:.3g} mm" in issue.message
    assert "drawing" in issue.hint
    frames[3, 2] += 1e-4
    (issue,) = expect_refusal(urdf_text.arm(np.array(OFFSET[0]), frames, pose(1.3, 0, 0.9, SIDE)))
    assert issue.hint.endswith("they first deviate from that form at joint 'j4', by 0.05 mm")


# ---- bad files ---------------------------------------------------------------------------------------

LIMIT = TEXT[TEXT.index("<limit") : TEXT.index("/>", TEXT.index("<limit")) + 2]
AXIS = '<axis xyz="0.0 0.0 1.0"/>'
START = '<robot name="own">'
XACRO = '<robot xmlns:xacro="http://ros.org/wiki/xacro"><xacro:arm/>'
END = "</robot>"
LONG = urdf_text.geometry_tag("box", (300.0, 1.0, 1.0), np.eye(4))
SPEED = f'velocity="{float(IRB.velocity[0])!r}"'
BAD = [
    ("robot.urdf", "is not XML", "</robot>", "</rob"),
    ("robot.urdf", "ENTITY", START, f"<!DOCTYPE robot [<!ENTITY a 'b'>]>{START}"),
    ("robot.urdf", "xacro FILE.xacro", START, XACRO),
    ("robot.urdf", "is a xacro file", SPEED, 'velocity="${2 * speed}"'),
    ("robot.urdf", "begins with <sdf>", "robot", "sdf"),
    ("robot.urdf", "two links 'l1'", '<link name="l1">', '<link name="l1"/><link name="l1">'),
    ("robot.urdf", "two joints 'j1'", 'joint name="j2"', 'joint name="j1"'),
    ("robot.urdf", "a joint without a name", 'joint name="j2"', "joint"),
    ("robot.urdf", "352 m at 'j3'", 'xyz="0.0 0.0 0.36"', 'xyz="0.0 0.0 352"'),
    ("robot.urdf", "missing link 'ghost'", '<child link="l3"/>', '<child link="ghost"/>'),
    ("robot.urdf", "to two joints", '<child link="l3"/>', '<child link="l2"/>'),
    ("robot.urdf", "names no child link", '<child link="l3"/>', ""),
    ("robot.urdf", "3 finite numbers", AXIS, '<axis xyz="0 nan 1"/>'),
    ("robot.urdf", "axis [0.0, 0.0, 0.0]", AXIS, '<axis xyz="0 0 0"/>'),
    ("robot.urdf", "type 'ball'", 'name="j2" type="revolute"', 'name="j2" type="ball"'),
    ("robot.chain", "prismatic", 'name="j2" type="revolute"', 'name="j2" type="prismatic"'),
    ("robot.chain", "mimic", LIMIT, LIMIT + '<mimic joint="j2"/>'),
    ("robot.limits", "continuous", 'name="j2" type="revolute"', 'name="j2" type="continuous"'),
    ("robot.limits", "needs its range", LIMIT, ""),
    ("robot.limits", "below upper", LIMIT, LIMIT.replace('lower="-', 'lower="')),
    ("robot.limits", "a speed of 0 rad/s", SPEED, 'velocity="0"'),
    ("robot.limits", "a speed of -2 rad/s", SPEED, 'velocity="-2"'),
    ("robot.limits", "rad/s: correct", SPEED, 'velocity="200"'),
]


@pytest.mark.parametrize(("code", "words", "good", "bad"), BAD, ids=[row[1] for row in BAD])
def test_bad_files_are_refused_in_words_and_what_is_advised_helps(code, words, good, bad):
    assert good in TEXT
    issues = expect_refusal(TEXT.replace(good, bad))
    assert {issue.code for issue in issues} == {code}
    assert words in str(issues[0])
    assert max(fit_chain(TEXT)[1].deviation) < 1e-12


@pytest.mark.parametrize(
    ("more", "expected_text"),
    [
        ("", "if fixed, the arm is an arm with five axes"),
        ('<joint name="k" type="revolute"><parent link="l6"/><child link="t"/></joint>', "fix it, or give"),
    ],
)
def test_what_a_joint_that_follows_leaves_is_told_at_once(more, expected_text):
    """Fixed as was advised, some arms were refused for their class then."""
    text = TEXT.replace(END, '<link name="t"/>' + more.replace("</joint>", f"{AXIS}{LIMIT}</joint>") + END)
    mimic = '<mimic joint="j5"/></joint>'
    joint = text[text.index('<joint name="k"' if more else '<joint name="j6"') :].split("</joint>")[0]
    with pytest.raises(TandemError) as caught:
        read_custom_chain(text.replace(f"{joint}</joint>", joint + mimic), "base_link", "t" if more else None)
    (issue,) = caught.value.issues
    assert issue.code == "robot.chain" and "(mimic)" in issue.message and expected_text in issue.message


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('<robot name="none"/>', "no <link>"),
        (TEXT.replace(END, '<link name="more"/>' * 2 + END), "two links 'more'"),
        (TEXT.replace(END, "".join(f'<link name="k{i}"/>' for i in range(2000)) + END), "links"),
        (
            TEXT.replace(
                '<link name="l2">',
                '<link name="l2">' + urdf_text.geometry_tag("sphere", (1.0,), np.eye(4)) * 2001,
            ),
            "more than 2000 <collision>",
        ),
        (TEXT.replace('<link name="l2">', f'<link name="l2">{LONG}'), "a box of 300 m"),
    ],
    ids=["none", "same", "links", "bodies", "mm"],
)  # fmt: skip
def test_files_that_are_of_no_arm_are_told(text, words):
    (issue,) = expect_refusal(text)
    assert issue.code == "robot.urdf" and words in issue.message and issue.hint


def test_a_long_row_of_fixed_links_is_read_in_a_moment():
    """A row of 1,900 took minutes: each link was followed to the arm anew, and its place multiplied."""
    row = "".join(
        f'<link name="k{i}">{urdf_text.geometry_tag("sphere", (0.1,), np.eye(4)) if i == 1899 else ""}</link>'
        f'<joint name="f{i}" type="fixed"><origin xyz="0 0 0.001"/>'
        f'<parent link="{f"k{i - 1}" if i else "l2"}"/>'
        f'<child link="k{i}"/></joint>'
        for i in range(1900)
    )
    chain, _ = fit_chain(TEXT.replace("</robot>", f"{row}</robot>"))
    (shape,) = chain.shapes
    assert shape.link == "l2" and shape.owner == "k1899"
    np.testing.assert_allclose(shape.pose[:3, 3], [0.0, 0.0, 1.9], atol=1e-9)


def test_all_joints_without_limits_are_told_at_once():
    issues = expect_refusal(TEXT.replace("lower=", "low="))
    assert [issue.bodies for issue in issues] == [(f"j{i}",) for i in range(1, 7)]


@pytest.mark.parametrize(
    ("base", "tip", "words"),
    [
        ("foot", None, "no link 'foot'"),
        ("base_link", "hand", "no link 'hand'"),
        ("l3", "l2", "the chain from it is l2, l1"),
        ("tool0", "tool0", "a chain with 0 axes"),
    ],
)
def test_a_base_or_a_tip_that_is_not_on_the_chain_is_told(base, tip, words):
    (issue,) = expect_refusal(TEXT, base, tip)
    assert words in issue.message


def test_a_file_without_the_usual_tip_asks_for_its_name():
    text = TEXT.replace("tool0", "mount")
    (issue,) = expect_refusal(text)
    assert issue.code == "robot.chain" and "name the flange" in issue.hint
    assert max(fit_chain(text, tip="mount")[1].deviation) < 1e-12


def test_joints_beside_the_chain_and_inertias_that_are_none_are_told():
    rod = '<link name="rod"/><joint name="piston" type="prismatic"><parent link="l2"/><child link="rod"/>'
    heavy = '<inertial><mass value="5"/><inertia ixx="-1" iyy="1" izz="1"/></inertial>'
    text = TEXT.replace("</robot>", rod + "</joint></robot>").replace(
        '<link name="l2">', f'<link name="l2">{heavy}'
    )
    chain, _ = fit_chain(text)
    assert chain.other_joints == ("piston",)
    assert chain.notes == ("inertia: that of the link l2 is invalid; it is not used",)
