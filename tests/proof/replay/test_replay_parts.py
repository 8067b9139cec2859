"""Parts of the replay against closed forms and other libraries: inverse kinematics, confdata, time law, cut
surface."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from planner.catalogue import robots
from planner.cell.kinematics import forward_kinematics
from planner.claims.segments import Segment
from planner.geometry.arrays import from_parts
from planner.processes.hotwire.claims import CutsSurface, KerfCurve
from planner.processes.hotwire.proof.cut_surface import WireSweep, closest_on_triangle, make_cut_face
from planner.proof.context import Context
from planner.proof.kinematics import arm_model, inverse_kinematics
from planner.proof.replay import moves
from planner.proof.replay.motion import (
    GrowingArray,
    GrowingPoses,
    Poses,
    RunLengthVectors,
    finite_differences,
)
from tests.proof import held_job, small_job
from tests.robot_sample import SAMPLE


@pytest.mark.parametrize("name", SAMPLE)
def test_inverse_kinematics_undoes_forward_on_every_branch(name):
    machine = arm_model.robot_machine(robots.robot(name))
    q = np.random.default_rng(3).uniform(machine.data.lower, machine.data.upper, (1000, 6))
    branch = inverse_kinematics.branch_of(machine, q)
    assert {0, 1, 4, 5} <= set(branch.tolist())
    back = inverse_kinematics.nearest_turns(
        inverse_kinematics.solve(machine, forward_kinematics(machine.data, q), branch), q
    )
    regular = inverse_kinematics.singularity_distance(machine, q) > 1e-2
    assert np.abs(back - q)[regular].max() < 1e-9


def test_out_of_reach_is_nan():
    machine = arm_model.robot_machine(robots.robot("irb140"))
    pose = np.eye(4)[None]
    pose[0, 0, 3] = 3.0
    assert np.isnan(inverse_kinematics.solve(machine, pose, np.zeros(1, dtype=int))).any()


def quadrants(q):
    """cf1, cf4, cf6 (..., 3) of serial joint angles (..., 6)."""
    return np.floor(q[..., [0, 3, 5]] / (0.5 * np.pi)).astype(np.int64)


def test_confdata_alone_select_the_solution():
    machine = arm_model.robot_machine(robots.robot("irb140"))
    q = np.random.default_rng(5).uniform(machine.data.lower, machine.data.upper, (2000, 6))
    q = q[inverse_kinematics.singularity_distance(machine, q) > 0.05]
    conf = np.concatenate([quadrants(q), inverse_kinematics.branch_of(machine, q)[:, None]], axis=1)
    assert (
        np.abs(
            inverse_kinematics.select_by_confdata(machine, forward_kinematics(machine.data, q), conf) - q
        ).max()
        < 1e-9
    )
    assert inverse_kinematics.fits_confdata(machine, q, conf).all()
    wrong = conf + np.array([0, 1, 0, 0])
    assert not inverse_kinematics.fits_confdata(machine, q, wrong)[np.abs(q[:, 3] % (np.pi / 2)) > 1e-3].any()


@pytest.mark.parametrize(
    ("degrees", "quadrant"), [(0.0, 0), (89.0, 0), (90.0, 1), (-1.0, -1), (-91.0, -2), (370.0, 4)]
)
def test_quadrants_as_in_the_manual(degrees, quadrant):
    machine = arm_model.robot_machine(robots.robot("irb140"))
    q = np.zeros((1, 6))
    q[0, 5] = np.deg2rad(degrees)
    conf = np.array([[0, 0, quadrant, inverse_kinematics.branch_of(machine, q)[0]]])
    assert inverse_kinematics.fits_confdata(machine, q, conf).all()
    assert not inverse_kinematics.fits_confdata(machine, q, conf + np.array([0, 0, 1, 0])).any()


def law(reach=0.5, room=0.0):
    stop = np.array([True, False, False, True])
    return moves.time_law(np.ones(3), np.ones(3), stop, np.full((4, 2), reach), np.full(4, room))


def test_a_corner_is_the_quadratic_bezier_of_its_zone():
    found = law(reach=0.25)
    delta = np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    s = np.linspace(0.0, 1.0, 21)
    node, xi = moves.offsets(found, delta, 2.0 + 0.25 * (2.0 * s - 1.0))
    corner = np.cumsum(np.vstack([np.zeros(3), delta]), axis=0)[node] + xi
    ends = np.array([[1.75, 0.0, 0.0], [2.0, 0.0, 0.0]])
    last = 2.0, found.rate_in[2], found.rate_out[2]
    assert last[1] == 1.0
    a, b = ends
    # the move behind the corner ends at a stop; its cubic progress 0.25 s in
    progress = 0.25 * (1.0 + 0.25 * (1.0 + 0.25 * -1.0))
    c = np.array([2.0, progress, 0.0])
    rate = 1.0 + 0.25 * (2.0 - 3.0 * 0.25)
    hermite = (
        (1 - s)[:, None] ** 2 * (1 + 2 * s)[:, None] * a
        + s[:, None] ** 2 * (3 - 2 * s)[:, None] * c
        + (s * (1 - s))[:, None] * 0.5 * ((1 - s)[:, None] * [1.0, 0.0, 0.0] - s[:, None] * [0.0, rate, 0.0])
    )
    assert np.abs(corner - hermite).max() < 1e-12
    assert b[0] == 2.0


def test_even_moves_keep_their_speed_through_every_node():
    """Seven equal moves in line: constant speed away from the ramps, no step in speed."""
    delta = np.array([[1.0, 0.0, 0.0]] * 7)
    stop = np.array([True, *[False] * 6, True])
    found = moves.time_law(np.ones(7), np.ones(7), stop, np.full((8, 2), 0.5), np.zeros(8))
    at = np.linspace(0.0, 7.0, 7001)
    node, xi = moves.offsets(found, delta, at)
    x = node + xi[:, 0]
    speed = np.diff(x) / np.diff(at)
    assert x[0] == 0.0
    assert x[-1] == 7.0
    assert np.abs(speed[2000:5000] - 1.0).max() < 1e-9
    assert np.abs(np.diff(speed)).max() < 0.01
    assert max(speed[0], speed[-1]) < 0.01


def test_a_zone_of_nothing_is_a_sharp_corner():
    delta = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    node, xi = moves.offsets(law(reach=0.0), delta, np.array([1.0]))
    assert (
        np.abs(np.cumsum(np.vstack([np.zeros(3), delta]), axis=0)[node[0]] + xi[0] - [1.0, 0.0, 0.0]).max()
        < 1e-12
    )


def test_closest_points_on_triangles_agree_with_trimesh():
    rng = np.random.default_rng(8)
    triangles = rng.normal(size=(500, 3, 3))
    points = rng.normal(size=(500, 3))
    place, weights = closest_on_triangle(points, triangles[:, 0], triangles[:, 1], triangles[:, 2])
    assert np.abs(place - trimesh.triangles.closest_point(triangles, points)).max() < 1e-9
    assert np.abs(np.einsum("mk,mki->mi", weights, triangles) - place).max() < 1e-12


def test_the_cut_of_a_cylinder_is_off_by_what_its_radius_says():
    """Wire shapes on a cylinder 0.3 mm too wide leave 0.3 mm less half a kerf standing, to 0.01 mm."""
    radius, kerf = 0.3, 0.002
    a = np.linspace(-0.4, 0.4, 41)
    y = np.linspace(-0.1, 0.1, 31)
    face = np.stack(np.meshgrid(a[3:-3], y[3:-3], indexing="ij"), axis=-1).reshape(-1, 2)
    vertices = np.stack([radius * np.sin(face[:, 0]), face[:, 1], radius * np.cos(face[:, 0])], axis=-1)
    rows, columns = len(a) - 6, len(y) - 6
    index = np.arange(rows * columns).reshape(rows, columns)
    p, q, r, s = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = np.concatenate([np.stack([p, q, r], -1).reshape(-1, 3), np.stack([p, r, s], -1).reshape(-1, 3)])
    out = radius + 0.0003
    sweep = np.stack([np.stack([out * np.sin(a), np.full_like(a, v), out * np.cos(a)], axis=-1) for v in y])
    found = make_cut_face(
        CutsSurface(Segment.read("cut/front"), vertices, faces, KerfCurve.constant(kerf), 0.0005),
        WireSweep.continuous(sweep),
    )
    # sample points lie on the chords of the wanted mesh, up to R (1 - cos) below the cylinder
    chord = radius * (1.0 - np.cos(0.5 * (a[1] - a[0])))
    assert np.all(found.deviation > 0.0003 - 0.001 - 1e-5)
    assert np.all(found.deviation < 0.0003 - 0.001 + chord + 1e-5)
    assert found.area.sum() == pytest.approx(radius * (a[-4] - a[3]) * (y[-4] - y[3]), rel=1e-3)


@pytest.mark.parametrize("job", [small_job, held_job])
def test_samples_worked_out_in_parts_are_the_same(job, monkeypatch):
    whole = Context(job.problem(), job.claims(), job.programs()).motion
    monkeypatch.setattr(moves, "SAMPLES_PER_BATCH", 97)
    parts = Context(job.problem(), job.claims(), job.programs()).motion
    for arm in whole.q:
        assert np.abs(whole.q[arm] - parts.q[arm]).max() < 1e-12
        assert np.abs(whole.tcp[arm][:] - parts.tcp[arm][:]).max() < 1e-12


def test_the_replay_meets_the_written_targets():
    """Half a sample's way at most off each target, and exactly the planned joints at the stops."""
    texts = small_job.programs(12)
    context = Context(small_job.problem(), small_job.claims(), texts)
    motion = context.motion
    plan = small_job.plan(12).operations[0]
    for arm in ("left", "right"):
        written = motion.node_tcp[arm]
        known = np.flatnonzero(np.isfinite(written[:, 0, 0]))
        gap = np.linalg.norm(
            motion.tcp[arm].position[motion.node_sample[known]] - written[known, :3, 3], axis=1
        )
        assert gap.max() < 0.004 * 0.25 + 1e-5
        stops = known[motion.node_stop[known]]
        ends = motion.q[arm][motion.node_sample[stops]]
        assert np.abs(ends[-3] - plan.q[arm][-1]).max() < 1e-6


def test_poses_come_back_as_they_were_put_in() -> None:
    """Rotations of scipy, upright and upside down among them; rows, slices and one alone."""
    rng = np.random.default_rng(11)
    about, over = rng.uniform(-np.pi, np.pi, (20, 1)), np.full((20, 1), np.pi)
    kinds = (
        Rotation.random(500, random_state=5),
        *(Rotation.from_euler("zx", np.concatenate([about, turn], axis=1)) for turn in (0.0 * over, over)),
    )
    turned = np.concatenate([kind.as_matrix() for kind in kinds])
    expected = from_parts(turned, rng.normal(size=(len(turned), 3)))
    kept = Poses.concatenate([Poses.of(expected[:100]), Poses.of(expected[100:])])
    np.testing.assert_allclose(kept[:], expected, rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(kept[7], expected[7], rtol=0.0, atol=1e-15)
    some = np.array([530, 3, 3])
    kept[some] = expected[[1, 2, 2]]
    np.testing.assert_allclose(kept[some], expected[[1, 2, 2]], rtol=0.0, atol=1e-15)
    assert np.array_equal(kept.position[3], expected[2, :3, 3])
    assert np.array_equal(kept.z[3], expected[2, :3, 2])


def test_poses_that_grow_are_those_put_in_at_once_in_runs_where_axes_stand() -> None:
    rng = np.random.default_rng(12)
    rotated = Rotation.random(300, random_state=3).as_matrix()
    rotated[100:] = Rotation.from_euler("zx", [0.3, 0.2]).as_matrix()  # the tool's axis stands from there on
    expected = from_parts(rotated, rng.normal(size=(300, 3)))
    grown, whole = GrowingPoses(), Poses.concatenate([Poses.of(expected)])
    for some in (slice(0, 7), slice(7, 7), slice(7, 150), slice(150, 300)):
        grown.append(expected[some])
    kept = grown.all
    assert isinstance(whole.z, np.ndarray) and isinstance(kept.z, np.ndarray)  # too many turn
    assert kept[:].tobytes() == whole[:].tobytes()
    for _ in range(3):
        grown.append(expected[100:])
    kept = grown.all
    assert isinstance(kept.z, RunLengthVectors) and len(kept.z.value) < 160 and len(kept) == 900
    assert kept[:].tobytes() == Poses.of(np.concatenate([expected, *[expected[100:]] * 3]))[:].tobytes()


def test_rows_that_grow_stay_as_they_were_written() -> None:
    rng = np.random.default_rng(13)
    grown, parts = GrowingArray((2,)), [rng.normal(size=(count, 2)) for count in (1, 0, 5, 40, 3)]
    for part in parts:
        grown.append_uninitialised(len(part))[:] = part
    assert len(grown) == 49 and np.array_equal(grown.all, np.concatenate(parts))


def test_speeds_and_accelerations_are_those_of_each_joint() -> None:
    """Of a parabola: its derivative, and half a step of acceleration, for the greater of the slopes on both
    sides counts; its second derivative everywhere."""
    time = np.linspace(0.0, 1.0, 101)
    q = np.stack([0.5 * k * time**2 for k in range(6)], axis=1)
    for axis in (slice(None), 4):
        rate = np.arange(6)[axis]
        fast, hard = finite_differences(time, q[:, axis], 1), finite_differences(time, q[:, axis], 2)
        assert fast.shape == hard.shape == q[:, axis].shape
        expected = (time[1:-1] + 0.005).reshape(-1, *np.ones(q[:, axis].ndim - 1, dtype=int)) * rate
        np.testing.assert_allclose(fast[1:-1], expected, atol=1e-12)
        np.testing.assert_allclose(hard[1:-1], np.broadcast_to(rate, hard[1:-1].shape), atol=1e-9)


def test_speeds_of_long_motions_do_not_depend_on_how_many_samples_are_worked_on_at_once() -> None:
    rng = np.random.default_rng(9)
    time, q = np.cumsum(rng.uniform(0.003, 0.005, 40_000)), rng.normal(size=(40_000, 2))
    step = np.diff(time)
    slope = np.diff(q, axis=0) / step[:, None]
    hard = (slope[1:] - slope[:-1]) / (0.5 * (step[1:] + step[:-1]))[:, None]
    fast = np.where(np.abs(slope[1:]) > np.abs(slope[:-1]), slope[1:], slope[:-1])
    assert np.array_equal(finite_differences(time, q, 1)[1:-1], fast)
    assert np.array_equal(finite_differences(time, q, 2)[1:-1], hard)


def test_axes_that_stand_are_kept_once_bit_by_bit() -> None:
    """Runs of one axis take its memory once, and give back what was put in, negative zeros too; axes that
    turn all the time stay as they are."""
    rng = np.random.default_rng(8)
    axes = np.repeat(rng.normal(size=(7, 3)), 40, axis=0)
    axes[40:80], axes[80:120] = [0.0, 0.0, 1.0], [-0.0, 0.0, 1.0]
    kept = RunLengthVectors.of(axes)
    assert isinstance(kept, RunLengthVectors) and len(kept) == len(axes) and len(kept.value) == 7
    for rows in (slice(None), np.arange(0, 280, 3), 85):
        assert kept[rows].tobytes() == axes[rows].tobytes()
    turning = rng.normal(size=(280, 3))
    assert RunLengthVectors.of(turning) is turning
