"""A cell of two arms with a block between them, as a model."""

from __future__ import annotations

import pytest

from planner.cell import plant
from planner.geometry.arrays import from_rpy
from tests.cell.cells import BLOCK, UP, facing


@pytest.fixture(scope="module")
def pair() -> plant.CellModel:
    return plant.build_cell_model(facing(), BLOCK, from_rpy((0.0, 0.0, 0.5), UP))
