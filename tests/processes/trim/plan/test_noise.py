"""A dish whose mesh has the noise of a scan: the proof uses the intended face."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from planner import pipeline
from planner.geometry.arrays import Mesh
from planner.processes import registry
from planner.processes.trim.claims import TrimsSheet
from planner.processes.trim.plan.face import SheetFace
from planner.processes.trim.proof.outlines import SheetSide
from tests.processes.trim.plan.small_trim import OUTLINES, data, milled
from tests.small_forming import dish
from tests.small_forming import write as write_forming

SIGMA = 0.03e-3
"""Standard deviation of the vertices' heights [m]: the thin facets about the middle lean by 20 deg."""


def test_the_proof_sees_the_face_that_a_mesh_with_noise_means(tmp_path: Path) -> None:
    """By its own fit, which knows nothing of the planner's: held against the dish without noise."""
    clean = dish(radius=41.0, depth=11.0, angle=33.0, fillet=9.0, around=131)
    vertices = clean.vertices.copy()
    radius = np.hypot(*vertices[:, :2].T)
    inner = radius < radius.max() - 1e-6
    vertices[inner, 2] += np.random.default_rng(7).normal(0.0, SIGMA, int(inner.sum()))
    path = write_forming(tmp_path, data(outlines=[OUTLINES[0]], **milled()), Mesh(vertices, clean.faces))
    problem = pipeline.load(path)
    (claim,) = (one for one in registry.claims(problem)["cut"] if isinstance(one, TrimsSheet))
    assert claim.surface_error == pytest.approx(3.0 * SIGMA, rel=0.15)
    side = SheetSide(claim, problem.source.get("part"))
    assert 2.5 * SIGMA < side.tolerance <= claim.surface_error
    places = np.random.default_rng(1).uniform(-0.045, 0.045, (4000, 2))
    places = places[np.hypot(*places.T) < 0.045]
    point, normal = side.at(places)
    expected, square = SheetFace(clean, 0.001, 1).at(places)
    assert np.abs(point - expected).max() < side.tolerance
    turn = np.arccos(np.clip((normal * square).sum(axis=1), -1.0, 1.0))
    assert np.quantile(turn, 0.95) < np.deg2rad(1.5)
    assert turn.max() < side.normal_error + np.deg2rad(1.0)
