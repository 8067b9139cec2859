"""An even pressure on a square, as fractions at nodes: it does not depend on the mesh."""

from __future__ import annotations

import numpy as np
import pytest

from planner.geometry.units import MM
from planner.shell.element import ShellSheet
from planner.shell.mesh import cone_rings, mesh_sheet
from planner.shell.newton import Loading, clamped, pressure_weights

LOAD_POINT = np.array([0.030, 0.0])
WIDTH = 3.0 * MM


def cone(triangles: int) -> ShellSheet:
    rings = cone_rings(0.050, np.radians(45.0), 0.020)
    made = mesh_sheet(rings, np.array([[-0.1, -0.1], [0.1, 0.1]]), triangles, LOAD_POINT[None])
    return ShellSheet(made.nodes, made.triangles, np.full(len(made.triangles), MM), 68e9, 0.3)


def test_shares_are_those_of_the_square() -> None:
    sheet = cone(1500)
    shares = pressure_weights(sheet, LOAD_POINT, WIDTH)
    assert shares.sum() == pytest.approx(1.0)
    assert shares.min() > -1e-12
    # linear shapes carry an even pressure's middle
    assert shares @ sheet.nodes[:, :2] == pytest.approx(LOAD_POINT, abs=1e-9)


def test_what_it_does_hangs_on_no_mesh() -> None:
    moved = []
    for triangles in (1500, 3000):
        sheet = cone(triangles)
        load = np.array([[0.0, 0.0, -50.0]])
        moved.append(
            float(
                Loading(sheet, clamped(sheet, "sliding")).curve(
                    pressure_weights(sheet, LOAD_POINT, WIDTH), load
                )[0, 2]
            )
        )
    assert moved[1] == pytest.approx(moved[0], rel=0.015)


def test_a_place_off_the_sheet_is_refused() -> None:
    with pytest.raises(ValueError, match="not on the sheet"):
        pressure_weights(cone(1500), np.array([0.5, 0.0]), WIDTH)


def test_few_triangles_do_where_they_are_small_about_the_place() -> None:
    """Beside the clamp, 1,000 of them: within 0.3 % of 6,000; with even ones it is 1.6 % too stiff."""
    points = np.array([0.066, 0.020])
    window = 0.09 * np.array([[-1.0, -1.0], [1.0, 1.0]])
    moved = []
    for triangles, near in ((1000, MM), (1000, np.inf), (6000, MM)):
        made = mesh_sheet([], window, triangles, points[None], near)
        sheet = ShellSheet(made.nodes, made.triangles, np.full(len(made.triangles), MM), 68e9, 0.3)
        load = np.array([[0.0, 0.0, -100.0]])
        held = Loading(sheet, clamped(sheet, "sliding"))
        moved.append(float(held.curve(pressure_weights(sheet, points, WIDTH), load)[0, 2]))
    assert moved[0] == pytest.approx(moved[2], rel=0.003)
    assert abs(moved[1]) < 0.99 * abs(moved[2])
