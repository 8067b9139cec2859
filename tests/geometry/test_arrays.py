"""Shared values are read-only; rows of arrays."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np
import pytest

from planner.geometry.arrays import read_only, spread_rows, unique_rows


@dataclasses.dataclass(frozen=True)
class Nested:
    """Arrays in all containers that jobs have."""

    array: np.ndarray
    table: Mapping[str, np.ndarray]
    rows: list[tuple[np.ndarray, ...]]


def test_arrays_in_dataclasses_tuples_lists_and_mappings() -> None:
    value = Nested(np.zeros(3), {"a": np.zeros(2)}, [(np.zeros((2, 2)),)])
    assert read_only(value) is value
    for array in (value.array, value.table["a"], value.rows[0][0]):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


@pytest.mark.parametrize(
    ("count", "max_rows", "rows"),
    [(0, 5, []), (1, 5, [0]), (3, 5, [0, 1, 2]), (11, 3, [0, 5, 10]), (10, 4, [0, 3, 6, 9]), (7, 1, [0])],
)
def test_rows_are_spread_from_first_to_last(count: int, max_rows: int, rows: list[int]) -> None:
    assert spread_rows(count, max_rows).tolist() == rows


@pytest.mark.parametrize(
    ("low", "high", "columns"), [(0, 9, 2), (-5, 400, 3), (-(2**62), 2**62, 2), (0, 2, 4)], ids=str
)
def test_distinct_rows_are_numpys(low: int, high: int, columns: int) -> None:
    """Also of numbers so far apart that no one number stands for a row, of one row, and of none."""
    rng = np.random.default_rng(3)
    for count in (500, 1, 0):
        rows = rng.integers(low, high, (count, columns))
        rows = np.concatenate([rows, rows[::3]])
        found = unique_rows(rows)
        expected = np.unique(rows, axis=0, return_index=True, return_inverse=True)
        for one, other in zip(found, expected, strict=True):
            np.testing.assert_array_equal(one, np.reshape(other, one.shape))
