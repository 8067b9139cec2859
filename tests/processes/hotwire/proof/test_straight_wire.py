"""Parts of the proof of straight wires against closed forms and brute force."""

from __future__ import annotations

import dataclasses
import io

import numpy as np
import pytest
import trimesh

from planner.claims.segments import Segment
from planner.geometry.arrays import RuledSurface
from planner.geometry.rulings import tessellate
from planner.problem import Stock
from planner.processes.hotwire.claims import CutsSurface, FollowsRulings, KerfCurve, KerfWithin, StraightWire
from planner.processes.hotwire.proof.cut_surface import WireSweep, make_cut_face, part_obj
from planner.processes.hotwire.proof.rules.straight_wire import free_lengths, guide_deviation, guide_normals
from planner.processes.hotwire.proof.wire_motion import depth_in_block
from planner.programs.steps import normalised_text
from planner.programs.text import segment_of_name
from planner.proof.context import Context
from planner.proof.prove import Prover
from planner.proof.replay.motion import wire_speed
from tests.processes.hotwire.proof import straight_job
from tests.proof import held_job

COUNT = 12


@pytest.mark.parametrize(
    ("procedure", "segment"),
    [
        ("cut_front", "cut/front"),
        ("cut_front__2", "cut/front"),
        ("cut_rib_12", "cut/rib_12"),
        ("CUT_Top_in__3", "cut/top_in"),
        ("link__4", "link"),
        ("operation_1", "operation/1"),
    ],
)
def test_segments_by_procedure(procedure, segment):
    assert segment_of_name(procedure) == Segment.read(segment)


def test_letters_survive_wrapping_and_a_plain_alphabet():
    assert (
        normalised_text("Stegni blok (čvrsto), 2 mm!")
        == normalised_text("Stegni blok\n(cvrsto),  2 mm!")
        == "stegniblokcvrsto2mm"
    )


def block(over=0.0):
    return Stock(np.array([0.2, 0.1, 0.3]), None, np.eye(3), oversize=np.full((2, 3), over))


def test_free_lengths_of_wires_agree_with_points_along_them():
    rng = np.random.default_rng(4)
    stock = block(0.01)
    start, end = rng.uniform(-0.3, 0.3, (2, 400, 3)) + np.array([0.0, 0.0, 0.15])
    found = free_lengths(start, end, stock)
    t = np.linspace(0.0, 1.0, 20001)
    for a, b, free in zip(start, end, found, strict=True):
        points = a + t[:, None] * (b - a)
        inside = np.flatnonzero(((points >= stock.lower) & (points <= stock.upper)).all(axis=1))
        if not len(inside):
            continue
        length = np.linalg.norm(b - a)
        assert free == pytest.approx([t[inside[0]] * length, (1.0 - t[inside[-1]]) * length], abs=1e-4)
    assert np.isinf(found).any()
    assert np.isfinite(found).any()


def test_the_depth_in_raw_foam_counts_the_oversize():
    line = np.linspace([-0.3, 0.0, 0.305], [0.3, 0.0, 0.305], 65)[None]
    assert depth_in_block(line, block(), 0.0)[0][0] == pytest.approx(-0.005)
    assert depth_in_block(line, block(0.01), 0.0)[0][0] == pytest.approx(0.005)


def test_each_point_of_a_wire_has_its_own_speed():
    """A wire that turns about one end: the speed grows along it; sliding along itself adds none."""
    time = np.linspace(0.0, 2.0, 81)
    angle = 0.1 * time
    r = np.linspace(0.0, 0.4, 41) + 0.03 * time[:, None]
    points = np.stack([r * np.cos(angle)[:, None], r * np.sin(angle)[:, None], 0.0 * r], axis=-1)
    speed = wire_speed(points, time, np.ones(points.shape[:2], dtype=bool))
    assert np.abs(speed - 0.1 * r)[1:-1].max() < 1e-6


def test_speeds_do_not_depend_on_where_the_stations_are() -> None:
    """A wire at 5 mm/s with a stretch of 0.4 mm at 1 mm/s: over 1 mm either way of its middle, 1.6 mm take
    0.32 s and 0.4 mm take 0.4 s, whether stations stand within it or not."""

    def time_at(distance: np.ndarray) -> np.ndarray:
        return distance / 0.005 + (np.clip(distance, 0.010, 0.0104) - 0.010) * (1.0 / 0.001 - 1.0 / 0.005)

    line = np.linspace([0.0, 0.0, 0.0], [0.4, 0.0, 0.0], 9)
    for more in ([], [0.0101, 0.0103], [0.00999, 0.0099, 0.01041]):
        way = np.unique(np.concatenate([np.linspace(0.0, 0.02, 6), [0.010, 0.0102, 0.0104], more]))
        points = line + np.array([0.0, 1.0, 0.0]) * way[:, None, None]
        speed = wire_speed(points, time_at(way), np.ones(points.shape[:2], dtype=bool))
        k = int(np.argmin(np.abs(way - 0.0102)))
        assert speed[k] == pytest.approx(np.full(9, 0.002 / (0.0016 / 0.005 + 0.4)), rel=1e-9)


def thin(sides, gap=0.0004, kerf=0.001):
    """A plate of thickness ``gap``, its upper face, and the sheets of a wire that runs around it.

    The wire moves over the plate and back under it.
    """
    x, y = np.linspace(-0.05, 0.05, 21), np.linspace(-0.03, 0.03, 9)
    wire = np.linspace(-0.1, 0.1, 33)
    out = 0.5 * (gap + kerf)
    rows = []
    if "over" in sides:
        rows.append(
            np.stack([np.stack([np.full_like(wire, v), wire, np.full_like(wire, out)], -1) for v in x])
        )
    if "under" in sides:
        rows.append(
            np.stack([np.stack([np.full_like(wire, v), wire, np.full_like(wire, -out)], -1) for v in x[::-1]])
        )
    points = np.concatenate(rows)
    grid = np.stack(np.meshgrid(x[2:-2], y, indexing="ij"), -1).reshape(-1, 2)
    vertices = np.concatenate([grid, np.full((len(grid), 1), 0.5 * gap)], axis=1)
    index = np.arange(len(grid)).reshape(-1, len(y))
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    claim = CutsSurface(Segment.read("cut/skin"), vertices, faces, KerfCurve.constant(kerf), 0.0003)
    return claim, WireSweep.continuous(points)


def test_a_thin_edge_is_not_cut_by_the_sheet_on_its_other_side():
    assert make_cut_face(*thin(("over", "under"))).share == 1.0
    assert make_cut_face(*thin(("over", "under"))).largest < 1e-9
    # pulled inwards by more than the tolerance, the upper sheet comes nearer to the other one's distance
    claim, sweep = thin(("over", "under"))
    low = sweep.points.copy()
    low[: len(low) // 2, :, 2] -= 0.0007
    moved = make_cut_face(claim, dataclasses.replace(sweep, points=low))
    assert moved.share == 0.0
    assert np.nanmedian(moved.deviation) == pytest.approx(-0.0007, abs=1e-6)


def changed(job, kind, **fields):
    """Claims of a job, those of one kind changed."""
    return {
        name: tuple(dataclasses.replace(c, **fields) if isinstance(c, kind) else c for c in group)
        for name, group in job.claims().items()
    }


def refused(job, claims, code):
    proof = Prover(job.problem(), claims).prove(job.programs(COUNT), last=code)
    return not proof.rule(code).passed


@pytest.mark.parametrize("job", [straight_job, held_job])
def test_claims_that_the_programs_do_not_meet(job):
    assert refused(job, changed(job, StraightWire, margin=0.17), "verify.bow")
    assert refused(job, changed(job, StraightWire, end=np.array([0.19, 0.0, 0.0])), "verify.bow")
    assert refused(job, changed(job, KerfWithin, upper=0.0012), "verify.kerf")
    assert refused(job, changed(job, KerfWithin, lower=0.0013), "verify.kerf")
    assert refused(job, changed(job, FollowsRulings, tolerance=1e-9), "verify.rulings")
    assert refused(job, changed(job, CutsSurface, kerf=KerfCurve.constant(0.0025)), "verify.surface")


def test_guide_lines_that_are_not_passed_whole():
    claims = straight_job.claims()
    u = np.linspace(-1.05, 1.0, 41)
    start, end = straight_job.guides(0, u)
    group = tuple(
        dataclasses.replace(c, start=start, end=end) if isinstance(c, FollowsRulings) else c
        for c in claims["top"]
    )
    proof = Prover(straight_job.problem(), {**claims, "top": group}).prove(
        straight_job.programs(COUNT), last="verify.rulings"
    )
    (issue,) = proof.rule("verify.rulings").passed is False and {
        i.message for i in proof.issues if "start" in i.message
    }
    assert "does not pass" in issue


def test_the_held_block_moves_with_its_holder():
    """The replay's relative motion is the planned one, while both arms move in the world."""
    context = Context(held_job.problem(), held_job.claims(), held_job.programs(COUNT))
    motion = context.motion
    operation = held_job.plan(COUNT).operations[0]
    nodes = np.flatnonzero(motion.node_ids > 0)
    assert len(nodes) == operation.targets.count - 1
    for arm in ("left", "right"):
        off = motion.node_tcp[arm][nodes] - (
            operation.targets.pose["right"][1:]
            if arm == "right"
            else operation.targets.pose["right"][1:] @ operation.targets.pose["left"][1:]
        )
        assert np.abs(off[:, :3, 3]).max() < 2e-7
        moved = np.ptp(motion.tcp[arm].position[motion.node_sample[nodes]], axis=0)
        assert moved.max() > 0.02
    rows = np.flatnonzero(context.sample_setup == 0)
    seen = context.stock_poses(0, rows)
    assert np.abs(seen - motion.tcp["right"][rows] @ held_job.GRIP).max() == 0.0
    later = context.stock_poses(1, np.flatnonzero(context.sample_setup == 1))
    assert np.abs(later - held_job.STOCK_POSE).max() < 1e-8


@pytest.mark.parametrize(("count", "wave"), [(21, 0.0), (2, 0.2)])
def test_the_simulated_part_shows_what_a_wire_leaves_between_its_rulings_and_between_their_ends(
    count: int, wave: float
) -> None:
    """Slots 2 mm wide, and a wire that is right at both ends and bulges by 0.5 mm half way: a sine; on its
    way between two rulings it rises by a ``wave`` [mm] too."""
    x, away = np.linspace(0.0, 0.1, count), np.array([0.0, 0.0, 1.0])
    start, end = (np.stack([x, np.full(count, y), np.zeros(count)], axis=1) for y in (0.0, 0.4))
    ruled = RuledSurface("face", start, end, np.zeros(count, dtype=np.bool_))
    mesh, name = tessellate(ruled), Segment.read("cut/face")
    kerf = KerfCurve.constant(0.002)
    y = np.linspace(0.0, 0.4, 161)
    along = np.linspace(-0.02, 0.12, 41)[:, None]
    bulge = 0.0005 * np.sin(np.pi * y / 0.4) + 1e-3 * wave * np.sin(np.pi * along / 0.1)
    rows = np.stack([np.broadcast_to(v, (41, 161)) for v in (along, y, bulge)], 2)
    outward = np.cross(*(mesh.vertices[mesh.faces[0, k]] - mesh.vertices[mesh.faces[0, 0]] for k in (1, 2)))
    side = float(np.sign(outward[2]))
    sweep = WireSweep.continuous(rows * [1.0, 1.0, side] + side * 0.001 * away)
    claim = CutsSurface(name, mesh.vertices, mesh.faces, kerf, 1e-3)
    shown = part_obj((claim,), (sweep,), (FollowsRulings(name, start, end, kerf, 1e-3),))
    made = trimesh.load(io.StringIO(shown), file_type="obj", process=False)
    assert made.vertices.shape == (max(count, 6) * 41, 3)  # every 10 mm of 400, every 20 mm of 100
    expected = 0.5 * np.sin(np.pi * made.vertices[:, 1] / 400.0)
    expected += wave * np.sin(np.pi * made.vertices[:, 0] / 100.0)
    np.testing.assert_allclose(side * made.vertices[:, 2], expected, atol=2e-3)
    assert (made.face_normals[:, 2] * side > 0.9).all()
    flat = trimesh.load(io.StringIO(part_obj((claim,), (sweep,))), file_type="obj", process=False)
    assert np.abs(flat.vertices[:, 2]).max() < 0.01  # at the rulings' ends alone nothing shows


@pytest.mark.parametrize("closed", [False, True])
def test_a_wire_around_a_sharp_tip_beside_a_blunt_root_is_outside_all_the_way(closed: bool) -> None:
    """A wedge whose edge is 2 mm thick at the start of the rulings and sharp at their end: there the guide
    line stands still while the other one goes on. Closed form: a wire 1 mm off the edge is on the circle of
    half a kerf, whichever way it lies between the normals of both faces."""
    xz = np.array([[-0.1, 0.02], [0.0, 0.001], [0.0, -0.001], [-0.1, -0.02]])
    start = np.stack([xz[:, 0], np.zeros(4), xz[:, 1]], axis=1)
    end = np.stack([xz[:, 0], np.full(4, 0.2), np.where(xz[:, 0] < 0.0, xz[:, 1], 0.0)], axis=1)
    if closed:  # the line begins and ends at the edge
        start, end = (line[[2, 3, 0, 1, 2]] for line in (start, end))
    claim = FollowsRulings(Segment.read("cut/wedge"), start, end, KerfCurve.constant(0.002), 1e-4)
    _, normal = guide_normals(claim)
    flank = normal[np.argmax(np.abs(np.diff(end, axis=0)[:, 2]) * (np.diff(end, axis=0)[:, 0] < 0.0))]
    normal = normal * -np.sign(flank[2])  # the lower face's way down
    tilt = np.arctan2(0.02, 0.1)
    turn = np.linspace(-0.5 * np.pi + tilt, 0.5 * np.pi - tilt, 41)
    away = 0.001 * np.stack([np.cos(turn), np.zeros(41), np.sin(turn)], axis=1)
    wires = np.stack([away + np.array([0.0, y, 0.0]) for y in (0.0, 0.1, 0.2, 0.3)], axis=1)
    deviation, half = guide_deviation(wires, np.full((41, 4), 0.005), end, normal, claim)
    np.testing.assert_allclose(half, 0.001)
    np.testing.assert_allclose(deviation, 0.0, atol=1e-9)
    inside, _ = guide_deviation(
        wires - [2.0 * 0.001, 0.0, 0.0] - 2.0 * away[:, None], np.full((41, 4), 0.005), end, normal, claim
    )
    assert inside[20] > 0.001  # a wire within the wedge is not
