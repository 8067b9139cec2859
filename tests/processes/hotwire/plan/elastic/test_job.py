"""From a panel to targets, against trimesh, SciPy's boundary value solver and plain geometry."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import trimesh
from scipy.integrate import solve_bvp
from scipy.interpolate import CubicSpline

from planner.claims.claim import ContactOnlyIn, FeedWindow
from planner.claims.dialogue import OperatorDialogue
from planner.claims.segments import Segment
from planner.geometry.arrays import Mesh, interpolate, inverse
from planner.processes.hotwire.claims import CutsSurface, WireJoins
from planner.processes.hotwire.plan.elastic import job
from planner.processes.hotwire.plan.elastic.path import WireSet, drive_wires
from planner.targets import ScrewFreedom, TableFreedom, Targets
from tests.processes.hotwire.plan import panels

STRIP = {
    "material": "spring_steel",
    "width_mm": 8,
    "thickness_mm": 0.8,
    "length_mm": 520,
    "temperature_c": 300,
}
SADDLE = panels.loft(panels.ARCH, (25.0, 2.0, 2.0, 25.0))


@pytest.fixture(scope="module")
def arch() -> Targets:
    return job.ElasticJob(panels.operation(), panels.setup(), panels.part()).targets()


@pytest.fixture(scope="module")
def strip() -> Targets:
    return job.ElasticJob(panels.operation(STRIP), panels.setup(), panels.part(SADDLE)).targets()


def rows(targets: Targets, segment: str) -> np.ndarray:
    return np.nonzero(np.array(targets.segment) == Segment.read(segment))[0]


def swept(targets: Targets, segment: str) -> trimesh.Trimesh:
    drawn = targets.flexible_tool.points[rows(targets, segment)]
    # the drawn points are 16 mm apart, too coarse as chords
    points = CubicSpline(np.arange(33), drawn, axis=1)(np.linspace(0, 32, 257))
    n, m = points.shape[:2]
    index = np.arange(n * m).reshape(n, m)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    return trimesh.Trimesh(points.reshape(-1, 3), faces, process=False)


@pytest.mark.parametrize("name", ["front", "back"])
@pytest.mark.parametrize("kind", ["arch", "strip"])
def test_the_wire_passes_half_a_kerf_outside_the_wanted_face(
    kind: str, name: str, request: pytest.FixtureRequest
) -> None:
    targets: Targets = request.getfixturevalue(kind)
    claim = next(
        c for c in targets.claims if isinstance(c, CutsSurface) and c.segment == Segment.read(f"cut/{name}")
    )
    face = trimesh.Trimesh(claim.vertices, claim.faces, process=False)
    some = np.arange(0, len(claim.faces), 7)
    middle = np.array(face.triangles_center)[some]
    normal = np.array(face.face_normals)[some]
    near, distance, _ = trimesh.proximity.closest_point(swept(targets, f"cut/{name}"), middle)
    side = np.einsum("fd,fd->f", near - middle, normal)
    assert (side > 0).all()  # on the side away from the part
    assert np.quantile(np.abs(distance - 0.0012), 0.95) < 5e-5


@pytest.mark.parametrize(("slant", "rise", "twist"), [(0.25, 20.0, 0.0), (0.0175, 0.0, 0.25)])
def test_the_wire_meets_corners_of_a_face_whose_ends_are_slanted(
    slant: float, rise: float, twist: float
) -> None:
    """By 14 degrees, and by 1, where all sections that end early stand within less than a step between
    sections: the wire passes half a kerf off the corners, as they are given here, and off the faces."""

    def section(v: float) -> list[list[float]]:
        return [[x, v + slant * x, z + rise * (v / 90.0) ** 2 + twist * x * v / 90.0] for x, z in panels.ARCH]

    ends = np.linspace(-90.0, 90.0, 7).tolist()
    sections = [{"at": (v + 90.0) / 180.0, "bezier_mm": section(v)} for v in ends]
    block = panels.stock(size=(0.16, 0.26, 0.14))
    part = panels.part({"loft": {"sections": sections, "flip": True, "chord_mm": 0.01}}, block=block)
    wire = {"material": "spring_steel", "diameter_mm": 1.0, "length_mm": 520, "temperature_c": 300}
    targets = job.ElasticJob(panels.operation(wire), panels.setup(block), part).targets()
    for claim in (c for c in targets.claims if isinstance(c, CutsSurface)):
        where = claim.vertices[claim.faces].mean(axis=1)[::3]
        if claim.segment == Segment("cut", "front"):
            edges = 1e-3 * np.array([section(v)[i] for v in ends for i in (0, -1)])
            edges[:, 2] += claim.vertices[:, 2].min() - edges[:, 2].min()  # lowest there; laid into the block
            where = np.concatenate([edges, where])
        _, distance, _ = trimesh.proximity.closest_point(swept(targets, str(claim.segment)), where)
        assert np.abs(distance - 0.0012).max() < 1e-4


def test_end_frames_follow_the_convention_and_the_wire_has_its_length(arch: Targets) -> None:
    points = arch.flexible_tool.points
    for arm, tip, inner in (("left", 0, 1), ("right", -1, -2)):
        pose = arch.pose[arm]
        np.testing.assert_allclose(pose[:, :3, 3], points[:, tip], atol=1e-12)
        along = (points[:, inner] - points[:, tip]) * (1 if arm == "left" else -1)
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        assert (
            np.einsum("nd,nd->n", along, pose[:, :3, 0]) > 0.99
        ).all()  # x: from the left to the right arm
        np.testing.assert_allclose(np.cross(pose[:, :3, 0], pose[:, :3, 1]), pose[:, :3, 2], atol=1e-12)
        np.testing.assert_allclose(pose[:, :3, 2], np.tile([0.0, -1.0, 0.0], (arch.count, 1)), atol=1e-12)
    assert (arch.pose["left"][:, 0, 3] < arch.pose["right"][:, 0, 3]).all()
    steps = np.linalg.norm(np.diff(points, axis=1), axis=2).sum(axis=1)
    np.testing.assert_allclose(steps, 0.520, rtol=3e-4)  # chords are a little shorter than the arc
    assert (steps < 0.520).all()


def test_the_order_of_the_job_its_stops_and_actions(arch: Targets) -> None:
    order = [str(s) for i, s in enumerate(arch.segment) if i == 0 or s != arch.segment[i - 1]]
    assert order == ["mount", "transit", "approach", "cut/front", "link", "cut/back", "retreat", "unmount"]
    assert arch.coupled
    assert arch.stop[0]
    assert arch.stop[-1]
    block = trimesh.creation.box(bounds=[[-0.08, -0.115, 0.0], [0.08, 0.115, 0.10]])
    away = -trimesh.proximity.signed_distance(block, arch.flexible_tool.points.reshape(-1, 3)).reshape(
        arch.count, -1
    )
    assert (away[arch.stop].min(axis=1) > 0.019).all()  # never a stop in the foam
    air = np.array([s.kind != "cut" for s in arch.segment])
    assert (away[air].min(axis=1) > 0.019).all()
    assert (away[:, [0, -1]] > 0.020).all()  # the clamps stay outside
    at_mount = [a.kind for a in arch.actions if a.target == 0]
    assert at_mount.index("on") < at_mount.index("wait") < len(at_mount) - 1
    assert [a.kind for a in arch.actions if a.target == arch.count - 1] == ["off", "wait", "confirm"]
    assert arch.actions[0].text == "Wire: spring_steel 1.5 mm round"
    assert "518.2" in arch.actions[1].text  # 520 mm hot at 300 C, 12.6e-6 / K


def test_feeds_bind_only_where_the_wire_is_in_the_foam(arch: Targets) -> None:
    block = trimesh.creation.box(bounds=[[-0.08, -0.115, 0.0], [0.08, 0.115, 0.10]])
    inside = (
        trimesh.proximity.signed_distance(block, arch.flexible_tool.points.reshape(-1, 3)).reshape(
            arch.count, -1
        )
        > 1e-9
    ).any(axis=1)
    slow = arch.feed_min > 0
    assert slow.any()
    assert (inside[slow] & inside[np.nonzero(slow)[0] - 1]).all()
    assert np.allclose(arch.feed_min[slow], 0.003)
    cut = np.array([s.kind == "cut" for s in arch.segment])
    assert np.allclose(arch.feed[cut], 0.008)
    moved = np.linalg.norm(np.diff(arch.flexible_tool.points, axis=0), axis=2).max(axis=1)
    assert (arch.travel[1:] <= moved + 1e-12).all()
    assert (arch.travel[1:][cut[1:]] < 0.0051).all()
    assert arch.travel[0] == 0.0


def test_slack_slides_the_wire_along_its_own_curve(arch: Targets) -> None:
    slack = next(f for f in arch.freedoms if isinstance(f, TableFreedom))
    spin = next(f for f in arch.freedoms if isinstance(f, ScrewFreedom))
    assert spin.periodic
    np.testing.assert_array_equal(spin.axis["left"], spin.axis["right"])
    still = arch.poses(np.zeros((arch.count, 2)))
    np.testing.assert_allclose(still["left"], arch.pose["left"], atol=1e-12)
    value = np.full(arch.count, 0.013)
    value[[0, -1]] = 0.0  # on and off as stated in the setup sheet
    assert (slack.upper >= value).all()
    slid = arch.poses(np.stack([value, np.zeros(arch.count)], axis=1))["left"][:, :3, 3]
    curve = arch.flexible_tool.points
    want = CubicSpline(np.arange(33), curve, axis=1)(0.013 / 0.520 * 32)
    want[[0, -1]] = curve[[0, -1], 0]
    assert np.linalg.norm(slid - want, axis=1).max() < 1e-6


def test_a_strip_has_no_spin_and_follows_the_slope_of_the_face(strip: Targets) -> None:
    assert not any(isinstance(f, ScrewFreedom) for f in strip.freedoms)
    cut = rows(strip, "cut/front")[1:-1]
    normal = strip.pose["left"][cut, :3, 2]
    middle = strip.flexible_tool.points[:, 16]
    travel = middle[cut + 1] - middle[cut - 1]
    travel /= np.linalg.norm(travel, axis=1, keepdims=True)
    assert np.ptp(np.rad2deg(np.arctan2(normal[:, 2], -normal[:, 1]))) > 20.0
    assert (np.abs(np.einsum("nd,nd->n", normal, travel)) > np.cos(np.deg2rad(3.0))).mean() > 0.95


def test_two_runs_go_over_the_block_without_touching_it() -> None:
    targets = job.ElasticJob(panels.operation(runs="two"), panels.setup(), panels.part()).targets()
    block = trimesh.creation.box(bounds=[[-0.08, -0.115, 0.0], [0.08, 0.115, 0.10]])
    link = rows(targets, "link")
    away = -trimesh.proximity.signed_distance(block, targets.flexible_tool.points[link].reshape(-1, 3))
    assert away.min() > 0.0195
    for name in ("front", "back"):
        y = targets.flexible_tool.points[rows(targets, f"cut/{name}"), 16, 1]
        assert (np.diff(y) > 0).all()
    assert len(link) > 20


@pytest.mark.parametrize(("turn", "want"), [(0.0, 90.0), (90.0, 0.0)])
def test_sweep_auto_goes_along_a_cylinder(turn: float, want: float) -> None:
    c, s = np.cos(np.deg2rad(turn)), np.sin(np.deg2rad(turn))
    front = panels.part(back=None).front
    rotated = front.vertices @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]).T
    part = dataclasses.replace(panels.part(back=None), front=Mesh(rotated, front.faces))
    block = panels.stock(size=(0.16, 0.23, 0.1) if turn == 0.0 else (0.23, 0.16, 0.1))
    targets = job.ElasticJob(
        panels.operation(sweep="auto", faces=("front",)), panels.setup(block), part
    ).targets()
    wire = targets.pose["right"][:, :3, 3] - targets.pose["left"][:, :3, 3]
    direction = np.rad2deg(np.arctan2(wire[10, 1], wire[10, 0])) + 90.0
    assert direction == pytest.approx(want, abs=1e-6)


def test_claims_come_from_the_problem_alone(arch: Targets) -> None:
    claims = job.ElasticJob(panels.operation(), panels.setup(), panels.part()).claims()
    assert [type(c) for c in claims] == [
        WireJoins,
        ContactOnlyIn,
        OperatorDialogue,
        CutsSurface,
        FeedWindow,
        CutsSurface,
        FeedWindow,
    ]
    wire = claims[0]
    assert isinstance(wire, WireJoins)
    assert wire.length == pytest.approx(0.52)
    # 187 GPa at 300 C, pi d^4 / 64, 7850 kg/m^3
    assert wire.ei_soft == pytest.approx(187e9 * np.pi * 0.0015**4 / 64, rel=1e-3)
    assert wire.weight == pytest.approx(7850 * 9.80665 * np.pi * 0.0015**2 / 4, rel=1e-3)
    assert len(arch.claims) == len(claims)


def test_the_same_problem_gives_the_same_targets(arch: Targets) -> None:
    again = job.ElasticJob(panels.operation(), panels.setup(), panels.part()).targets()
    for arm in arch.arms:
        np.testing.assert_array_equal(again.pose[arm], arch.pose[arm])
    np.testing.assert_array_equal(again.travel, arch.travel)


def test_a_driven_wire_is_what_a_boundary_value_solver_finds() -> None:
    """Half-way of a move, solve_bvp on the heavy elastica between the ends finds the same wire."""
    gravity = np.array([0.0, 0.0, -3.0])
    up = np.array([[1.0, 0, 0, 0], [0, 0, -1.0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]])
    frame = np.stack([up, up])
    frame[1, :3, 3] = [0.02, 0.0, 0.03]
    wires = WireSet(frame, np.array([[-2.5, -20.0, 1.0], [-3.5, -25.0, 4.0]]), 0.5, gravity)
    start, end = wires.ends(wires.shapes(3))
    got, miss, tilt = drive_wires(wires[:1], wires[1:], 0.5)
    assert miss[0] < 1e-10
    assert tilt[0] < 1e-12
    half = np.array([0.5])
    a = (inverse(up) @ interpolate(start[:1], start[1:], half))[0]
    b = (inverse(up) @ interpolate(end[:1], end[1:], half))[0]
    ta, tb = np.arctan2(a[1, 0], a[0, 0]), np.arctan2(b[1, 0], b[0, 0])
    load = (up[:3, :3].T @ gravity)[:2]

    def slope(s: np.ndarray, y: np.ndarray, p: np.ndarray) -> np.ndarray:
        fx, fy = p[0] - load[0] * s, p[1] - load[1] * s
        return np.stack([np.cos(y[2]), np.sin(y[2]), y[3], fx * np.sin(y[2]) - fy * np.cos(y[2])])

    def ends(ya: np.ndarray, yb: np.ndarray, p: np.ndarray) -> np.ndarray:
        return np.array(
            [ya[0] - a[0, 3], ya[1] - a[1, 3], ya[2] - ta, yb[0] - b[0, 3], yb[1] - b[1, 3], yb[2] - tb]
        )

    s = np.linspace(0.0, 0.5, 60)
    guess = np.stack([np.linspace(a[0, 3], b[0, 3], 60), 0 * s, np.linspace(ta, tb, 60), np.full(60, -3.0)])
    found = solve_bvp(slope, ends, s, guess, p=np.array([-22.0, 0.0]), tol=1e-9, max_nodes=20000)
    assert found.success
    points = got.points(got.shapes())[0] @ up[:3, :2]
    np.testing.assert_allclose(points, found.sol(np.linspace(0, 0.5, 33))[:2].T, atol=1e-8)
