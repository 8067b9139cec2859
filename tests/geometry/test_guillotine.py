"""Guillotine divisions are optimal, by an independent program of the test."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from scipy.optimize import Bounds, LinearConstraint, milp

from planner.geometry.guillotine import GridDivision, divide_grid


def random_prices(nx: int, ny: int, seed: int, allowed_fraction: float) -> np.ndarray:
    rng = np.random.default_rng(seed)
    price = rng.integers(1, 9, size=(nx, ny, nx, ny)).astype(float)
    price[rng.random(price.shape) > allowed_fraction] = np.inf
    price[0, 0] = rng.integers(1, 9, size=(nx, ny))  # a single cell always goes
    return price


def best(price: np.ndarray) -> tuple[int, float]:
    """The best pair by recursion over all cuts, with nothing of the code under test."""

    @functools.cache
    def of(x0: int, x1: int, y0: int, y1: int) -> tuple[float, float]:
        own = price[x1 - x0 - 1, y1 - y0 - 1, x0, y0]
        pairs = [(1.0, float(own)) if np.isfinite(own) else (np.inf, np.inf)]
        halves = [(of(x0, x, y0, y1), of(x, x1, y0, y1)) for x in range(x0 + 1, x1)]
        halves += [(of(x0, x1, y0, y), of(x0, x1, y, y1)) for y in range(y0 + 1, y1)]
        pairs += [(a[0] + b[0], max(a[1], b[1])) for a, b in halves]
        return min(pairs)

    found = of(0, price.shape[0], 0, price.shape[1])
    return int(found[0]), found[1]


def check_cover(division: GridDivision, price: np.ndarray) -> None:
    """The pieces cover each cell once, each is allowed, and the reported largest price is correct."""
    cells = np.zeros(price.shape[:2], dtype=int)
    prices = []
    for x0, x1, y0, y1 in division.rectangles:
        cells[x0:x1, y0:y1] += 1
        prices.append(price[x1 - x0 - 1, y1 - y0 - 1, x0, y0])
    assert (cells == 1).all()
    assert max(prices) == division.max_price < np.inf


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize(
    ("nx", "ny", "allowed_fraction"), [(1, 1, 1.0), (5, 3, 0.3), (4, 6, 0.1), (7, 7, 0.15)]
)
def test_the_division_is_the_best_that_a_plain_recursion_finds(
    nx: int, ny: int, allowed_fraction: float, seed: int
) -> None:
    price = random_prices(nx, ny, seed, allowed_fraction)
    found = divide_grid(price)
    assert found is not None
    check_cover(found, price)
    assert (len(found.rectangles), found.max_price) == best(price)


def test_no_partition_at_all_has_fewer_pieces_where_pieces_are_bounded_boxes() -> None:
    """Exact cover as an integer programme, guillotine or not, bounds the count from below."""
    price = np.full((6, 5, 6, 5), np.inf)
    price[:3, :2] = 1.0  # up to 3 x 2 cells: 2 x 3 pieces are the least, and through cuts reach it
    rows = [
        (x, x + w, y, y + h)
        for w in range(1, 4)
        for h in range(1, 3)
        for x in range(7 - w)
        for y in range(6 - h)
    ]
    cover = np.zeros((30, len(rows)))
    for column, (x0, x1, y0, y1) in enumerate(rows):
        cells = np.zeros((6, 5))
        cells[x0:x1, y0:y1] = 1
        cover[:, column] = cells.ravel()
    least = milp(
        np.ones(len(rows)),
        constraints=LinearConstraint(cover, 1, 1),
        integrality=np.ones(len(rows)),
        bounds=Bounds(0, 1),
    )
    found = divide_grid(price)
    assert found is not None and len(found.rectangles) == round(least.fun) == 6


def test_what_cannot_be_divided_is_told() -> None:
    price = np.full((3, 2, 3, 2), 1.0)
    assert divide_grid(price) is not None
    price = np.full((3, 2, 3, 2), np.inf)
    price[0, 0] = 1.0
    price[0, 0, 1, 1] = np.inf
    assert divide_grid(price) is None


def test_pieces_are_in_the_order_of_rows_and_equal_prices_give_even_halves() -> None:
    price = np.full((4, 4, 4, 4), np.inf)
    price[:3, :3] = 1.0
    found = divide_grid(price)
    assert found is not None
    assert found.rectangles.tolist() == [[0, 2, 0, 2], [2, 4, 0, 2], [0, 2, 2, 4], [2, 4, 2, 4]]
