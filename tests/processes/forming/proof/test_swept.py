"""The part of a face that exists while it is formed, and its distance from paths.

The reference is trimesh, which has its own code to cut meshes at planes.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from planner.processes.forming.proof import swept_volume
from planner.processes.forming.proof.face import ProofFace
from planner.processes.forming.proof.tracks import LazyCentres
from planner.proof.prove import Prover
from planner.proof.replay.motion import Poses
from tests.languages.rapid.rapid_edits import segment, shifted
from tests.processes.forming.proof import forming_job as job


@pytest.mark.sampled(every=2)
@pytest.mark.parametrize("side", [1, -1])
def test_ways_are_held_against_what_trimesh_leaves_of_a_face(side):
    vertices, faces = job.face(48, 8)
    vertices = vertices * [1.0, 1.0, side]
    face = ProofFace(vertices, faces if side > 0 else faces[:, ::-1], job.BALL)
    rng = np.random.default_rng(4)
    start = rng.uniform([-0.03, -0.03, -0.012], [0.03, 0.03, 0.012], (60, 3))
    end = start + rng.normal(scale=0.004, size=(60, 3))
    need = np.full(60, 0.05)
    for level in (-0.0037, -0.001, 0.0005):
        found = swept_volume.distance_above_level(face, start, end, need, side, np.full(60, level))
        whole = trimesh.Trimesh(vertices, faces, process=False)
        kept = trimesh.intersections.slice_mesh_plane(whole, [0, 0, side], [0, 0, side * level])
        fraction = np.linspace(0.0, 1.0, 400)
        looks = start[:, None] + fraction[None, :, None] * (end - start)[:, None]
        distance = trimesh.proximity.closest_point(kept, looks.reshape(-1, 3))[1].reshape(60, -1).min(axis=1)
        step = np.linalg.norm(end - start, axis=1) / 399.0
        assert np.all(found <= distance + 1e-9)
        assert np.all(found >= distance - step)


def test_a_face_is_there_down_to_where_the_ball_has_been():
    """The level only falls, counts the lowest of several places, and waits for the ball to touch."""
    radius = 0.004
    near = SimpleNamespace(
        row=np.array([0, 1, 2, 2, 3, 4, 5]),
        tied=np.column_stack([np.zeros((7, 2)), [-9e-3, -1e-3, -2e-3, -3e-3, -1e-3, -8e-3, -5e-3]]),
        apart=np.array([radius, radius, radius, radius, 3 * radius, radius]),
    )
    own = np.array([False, True, True, True, True, True])
    claim = SimpleNamespace(side=1, start=0.0, radius=radius, tolerance=5e-5)
    touches = near.apart <= radius
    track = SimpleNamespace(is_forming=own)
    one = SimpleNamespace(
        claim=claim, nearest=near, track=track, knots=np.arange(6), is_touching=touches, formed_depth=0.0
    )
    np.testing.assert_allclose(swept_volume.formed_levels(one), [0.0, -1e-3, -3e-3, -3e-3, -3e-3, -5e-3])
    one.formed_depth = 2e-3  # levels before it are there already
    np.testing.assert_allclose(swept_volume.formed_levels(one), [-2e-3, -2e-3, -3e-3, -3e-3, -3e-3, -5e-3])


def shift(texts, k, by):
    return shifted(texts, 2, k, np.asarray(by, dtype=float))


def sheet_rule_fails(texts):
    proof = Prover(job.problem(), job.claims()).prove(texts, last="verify.sheet")
    (rule,) = [rule for rule in proof.rules if rule.code == "verify.sheet"]
    return not rule.passed


@pytest.mark.long
def test_before_anything_is_formed_the_sheet_is_flat_for_the_support():
    """The way in goes to the first target; raised by 3 mm its ball is above the flat sheet's near face."""
    texts = job.programs()
    k = segment(texts, "form_f1_in")[0]
    assert not sheet_rule_fails(texts)
    assert sheet_rule_fails(shift(texts, k, [0.0, 0.0, 3.0]))


def test_at_the_end_all_of_the_face_is_there():
    """The support leaves sideways, through the wall that is formed."""
    texts = job.programs()
    k = segment(texts, "form_f1_out")[0]
    assert sheet_rule_fails(shift(texts, k, [22.0, 0.0, 27.0]))


def test_centres_of_a_sheet_that_moves_are_worked_out_in_any_shape_of_rows() -> None:
    """Against SciPy's rotations, one frame to each row."""
    rng = np.random.default_rng(3)
    frames = np.tile(np.eye(4), (20, 1, 1))
    turns = Rotation.random(20, random_state=4)
    frames[:, :3, :3], frames[:, :3, 3] = turns.as_matrix(), rng.normal(size=(20, 3))
    place = rng.normal(size=(30, 3))
    poses = Poses(place, np.tile([0.0, 0.0, 1.0], (30, 1)), np.zeros(30))
    rows = np.arange(5, 25)
    expected = turns.apply(place[rows]) + frames[:, :3, 3]
    centres = LazyCentres(rows, (poses,), frames)
    assert centres[:, 0] == pytest.approx(expected)
    assert centres[7, 0] == pytest.approx(expected[7])
    some = np.array([[0, 3, 5], [7, 8, 9]])
    assert centres[some] == pytest.approx(expected[some][:, :, None])
