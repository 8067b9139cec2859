"""Areas that a round cutter cannot reach, against closed forms: an inner corner, a round trough.

The remedies of other milling and G-code issues are tested by the rows in ``remedies/remedy_rows_milling.py``.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner.geometry.arrays import Mesh
from planner.geometry.mesh import TriangleMesh
from planner.issues import Issue, Severity
from planner.processes.milling.plan import cutter_contact
from tests.remedies.advice import ReportedFigure
from tests.remedies.remedy_rows import lay
from tests.remedies.remedy_rows_milling import arc, walls


def faults(data: dict[str, Any], folder: Path) -> list[Issue]:
    """Errors of reading the problem and of making its targets."""
    return [issue for issue in lay(folder, data) if issue.severity is Severity.ERROR]


def test_an_inner_corner_is_rounded_as_it_is_said(tmp_path: Path) -> None:
    """How far a circle of radius R stays off a corner that turns by t: R (1 / cos(t / 2) - 1)."""
    low = [[-40.0, 0.0], [0.0, 20.0], [40.0, 0.0]]
    found = faults(walls([[*p, 12.0] for p in low], [[*p, 45.0] for p in low], {}), tmp_path)
    (corner,) = found
    assert corner.code == "milling.corner"
    off = ReportedFigure("leaves a fillet, # mm from the corner", 0.01).of(found, None)
    assert off == pytest.approx(6.0 * (math.hypot(20.0, 40.0) / 40.0 - 1.0), abs=0.006)
    radius = ReportedFigure("by # mm or more", 0.01).of(found, None)
    assert not faults(walls(arc(radius, 12.0), arc(radius, 45.0), {}), tmp_path)
    assert faults(walls(arc(5.0, 12.0), arc(5.0, 45.0), {}), tmp_path)


def test_a_ball_reaches_a_round_trough_of_its_own_radius_alone() -> None:
    """Half a pipe of radius 12 mm, in chords of 0.3 um: a ball of 20 mm that touches its bottom is as deep in
    its rim, 80 degrees up, as its centre is nearer to that than 20 mm; all of the pipe is left."""
    pipe, steep = 12e-3, np.radians(80.0)
    turn = np.linspace(-steep, steep, 181)
    grid = np.array(
        [[[x, pipe * np.sin(t), -pipe * np.cos(t)] for t in turn] for x in np.linspace(0, 5e-3, 6)]
    )
    a, b = np.meshgrid(np.arange(5), np.arange(180), indexing="ij")
    rows = [k.ravel() for k in (a * 181 + b, (a + 1) * 181 + b, (a + 1) * 181 + b + 1, a * 181 + b + 1)]
    faces = np.concatenate(
        [np.stack([rows[0], rows[1], rows[2]], 1), np.stack([rows[0], rows[2], rows[3]], 1)]
    )
    mesh = Mesh(grid.reshape(-1, 3), faces)
    up = TriangleMesh(mesh.vertices, mesh.faces)
    assert float(np.cross(*np.diff(up.vertices[up.faces[0]], axis=0))[2]) > 0.0
    found = cutter_contact.find_unreached_region(mesh, 20e-3, 1e-4)
    assert found is not None
    assert found.area_fraction == pytest.approx(1.0, abs=0.01)
    # from the one rim the other is in the ball farthest: of the chord that joins them
    across = 2.0 * pipe * np.sin(steep)
    centre = 20e-3 * np.array([-np.sin(steep), np.cos(steep)])
    deepest = 20e-3 - float(np.linalg.norm(np.array([across, 0.0]) * -1.0 - centre))
    assert found.depth == pytest.approx(deepest, rel=0.03)
    assert found.fitting_radius is not None and found.fitting_radius == pytest.approx(pipe, rel=0.03)
    assert cutter_contact.find_unreached_region(mesh, 11.9e-3, 1e-4) is None
