"""Lines that leave a strip along the edge of a face: its width, and the remaining required area."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from planner.geometry.arrays import Mesh
from planner.processes import registry
from planner.processes.milling.claims import MillsSurface
from planner.processes.milling.plan import cutter_contact as milling_face
from planner.processes.milling.plan.process_plan import plan_milling
from tests.processes.milling.plan.small_mill import BALL, PANEL, problem
from tests.processes.milling.proof.milling_job import Job

RADIUS = 0.05


def disk(rings: int = 30, around: int = 180) -> Mesh:
    """A paraboloid over a disk, 50 mm in radius, looking up."""
    turn = np.linspace(0.0, 2 * np.pi, around, endpoint=False)
    r = np.repeat(np.arange(1, rings + 1) / rings * RADIUS, around)
    x, y = r * np.cos(np.tile(turn, rings)), r * np.sin(np.tile(turn, rings))
    points = np.concatenate([[[0.0, 0.0, 0.0]], np.stack([x, y, -4.0 * (x * x + y * y)], axis=1)])
    k = np.arange(around)
    faces = [np.stack([np.zeros(around, int), 1 + k, 1 + (k + 1) % around], axis=1)]
    for ring in range(rings - 1):
        a, b = 1 + ring * around + k, 1 + ring * around + (k + 1) % around
        faces += [np.stack([a, a + around, b + around], axis=1), np.stack([a, b + around, b], axis=1)]
    return Mesh(points, np.concatenate(faces).astype(np.int64))


@pytest.mark.parametrize("margin", [0.004, 0.0171])
def test_the_rest_of_a_disk_is_a_smaller_disk(margin: float) -> None:
    front = disk()
    area = milling_face.inner_area(front, margin)
    left = milling_face.clip_face(front, area)
    corners = left.vertices[left.faces]
    flat = 0.5 * np.cross(corners[:, 1, :2] - corners[:, 0, :2], corners[:, 2, :2] - corners[:, 0, :2])
    assert flat.min() > 0.0
    radius = RADIUS - margin
    assert np.linalg.norm(left.vertices[:, :2], axis=1).max() < radius + 1e-9
    # what is parted to 0.5 mm and left out along the edge is half of that wide at most
    assert np.pi * (radius - 0.5e-3) ** 2 < flat.sum() < np.pi * radius**2
    np.testing.assert_allclose(left.vertices[:, 2], -4.0 * (left.vertices[:, :2] ** 2).sum(axis=1), atol=6e-6)


def test_a_margin_that_leaves_nothing() -> None:
    assert milling_face.inner_area(disk(), 0.051).is_empty


def test_lines_keep_the_margin_from_every_edge(tmp_path: Path) -> None:
    cut = {"lines": "front", "stepover_mm": 2, "margin_mm": 12, "angle_deg": 30}
    made = problem(tmp_path, PANEL, BALL, cuts=[cut])
    (claim,) = [c for c in registry.claims(made)["mill"] if isinstance(c, MillsSurface)]
    assert made.part is not None and made.part.front is not None
    edge = made.part.front.vertices[:, :2]
    low, high = edge.min(axis=0), edge.max(axis=0)
    assert claim.margin == 0.012
    face = plan_milling(made.operations[0], made.setup_of(0), made.part).cuts[0].face
    assert face is not None
    # the panel is a piece of a ring seen from above, and is narrower than the box around it by 1.5 mm at most
    own = face.mesh.vertices[:, :2]
    assert (own.min(axis=0) - low >= 12e-3 - 1e-9).all() and (high - own.max(axis=0) >= 12e-3 - 1e-9).all()
    assert (own.min(axis=0) - low <= 14e-3).all()
    targets = registry.job(made, 0).targets()
    on = np.array([str(s) == "mill/front_lines" for s in targets.segment])
    tips = targets.pose["robot"][on][:, :2, 3]
    assert (tips.min(axis=0) - low).min() > 11e-3
    assert (high - tips.max(axis=0)).min() > 11e-3


@pytest.mark.long
def test_lines_with_a_wide_margin_are_proven_on_what_they_make(tmp_path: Path) -> None:
    cut = {"lines": "front", "stepover_mm": 1.5, "margin_mm": 16}
    job = Job(tmp_path, PANEL, BALL, cuts=[cut])
    proof = job.prove(job.programs, last=None)
    assert proof.ok, proof.issues
    (face,) = proof.surfaces
    assert face.share > 0.99
