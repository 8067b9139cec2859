"""Values that several readers share cannot be written into."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np
import pytest

from planner.geometry.arrays import read_only, spread_rows


@dataclasses.dataclass(frozen=True)
class Nested:
    """Arrays in all containers that jobs have."""

    own: np.ndarray
    table: Mapping[str, np.ndarray]
    rows: list[tuple[np.ndarray, ...]]


def test_arrays_in_dataclasses_tuples_lists_and_mappings() -> None:
    value = Nested(np.zeros(3), {"a": np.zeros(2)}, [(np.zeros((2, 2)),)])
    assert read_only(value) is value
    for array in (value.own, value.table["a"], value.rows[0][0]):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


@pytest.mark.parametrize(
    ("count", "most", "rows"),
    [(0, 5, []), (1, 5, [0]), (3, 5, [0, 1, 2]), (11, 3, [0, 5, 10]), (10, 4, [0, 3, 6, 9]), (7, 1, [0])],
)
def test_rows_are_spread_from_first_to_last(count: int, most: int, rows: list[int]) -> None:
    assert spread_rows(count, most).tolist() == rows
