"""Distance of a torch from a sheet far from any mesh vertex, computed by hand."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from planner.processes.trim.proof import torch_motion
from planner.processes.trim.proof.torch_motion import cylinder

RADIUS = 4e-3


def coarse_sheet(corner: float) -> Any:
    """A flat square of 200 mm at height 0 with one more corner on the x axis; its stock is as large."""
    rim = [[x, y, 0.0] for x, y in ((-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (-0.1, 0.1))]
    faces = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    return SimpleNamespace(vertices=np.array([*rim, [corner, 0.0, 0.0]]), faces=faces, height=0.0)


@pytest.mark.parametrize("corner", [8e-3, 60e-3])
@pytest.mark.parametrize("height", [3e-3, 0.4e-3, 0.0, -1e-3])
def test_the_face_is_looked_at_as_near_as_its_nearest_corner(corner: float, height: float) -> None:
    """A cylinder that stands over the face, or goes through it, while a corner is farther off, in sight or
    not; it is there at the second of three places."""
    tip = np.array([[-0.05, 0.0, 0.03], [0.0, 0.0, height], [0.02, 0.03, 0.03]])
    track = SimpleNamespace(tip=tip, axis=np.tile([0.0, 0.0, 1.0], (3, 1)))
    context = SimpleNamespace(stock_at=lambda _: SimpleNamespace(size=(0.2, 0.2, 1e-3)))
    work: Any = SimpleNamespace(track=track, sheet=coarse_sheet(corner), context=context, index=0)
    deviation, row = torch_motion._body_distance(work, np.arange(3), cylinder(0.0, 0.1, RADIUS))
    assert deviation == pytest.approx(height, abs=1e-6)
    assert row == 1
