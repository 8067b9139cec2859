"""Patch tests of the flat triangle by closed forms: constant strain, constant curvature, bending in plane."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from planner.geometry.arrays import FloatArray
from planner.shell.corotation import Assembly, at_rest
from planner.shell.element import Membrane, ShellSheet, elements, plane_stress
from tests.shell.sheets import patch

MEMBRANES: list[Membrane] = ["optimal", "constant strain"]
SMALL = 1e-8


def forces(sheet: ShellSheet, step: FloatArray) -> FloatArray:
    """Forces (n, 6) after a small step from rest, over its size."""
    count = len(sheet.nodes)
    assembly = Assembly(sheet, np.ones((count, 6), dtype=bool), np.zeros((count, 3)))
    return assembly.force(at_rest(sheet).moved(SMALL * step)) / SMALL


@pytest.mark.parametrize("membrane", MEMBRANES)
@pytest.mark.parametrize("strain", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.4, -0.7, 0.9)])
def test_constant_strain_needs_no_forces_inside_and_has_its_energy(
    membrane: Membrane, strain: tuple[float, float, float]
) -> None:
    """u = (exx x + g y, eyy y), whose turn in plane is - g / 2; energy e C e V / 2."""
    sheet, inside = patch(membrane)
    x, y = sheet.nodes[:, 0], sheet.nodes[:, 1]
    step = np.zeros((len(x), 6))
    step[:, 0], step[:, 1], step[:, 5] = strain[0] * x + strain[2] * y, strain[1] * y, -0.5 * strain[2]
    result = forces(sheet, step)
    assert np.abs(result[inside]).max() < 1e-6 * np.abs(result).max()
    e = np.array(strain)
    energy = 0.5 * float(e @ plane_stress(70e9, 0.33) @ e) * 24e-3 * 12e-3 * 1e-3
    assert 0.5 * float(np.sum(result * step)) == pytest.approx(energy, rel=1e-6)


@pytest.mark.parametrize("curvature", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.5, -0.8, 0.3)])
def test_constant_curvature_needs_no_forces_inside_and_has_its_energy(
    curvature: tuple[float, float, float],
) -> None:
    """w = (a x^2 + b y^2) / 2 + c x y / 2 with turns (w,y, -w,x); energy k D k A / 2 with k = (a, b, c)."""
    sheet, inside = patch("optimal")
    x, y = sheet.nodes[:, 0], sheet.nodes[:, 1]
    a, b, c = curvature
    step = np.zeros((len(x), 6))
    step[:, 2] = 0.5 * (a * x**2 + b * y**2 + c * x * y)
    step[:, 3], step[:, 4] = b * y + 0.5 * c * x, -a * x - 0.5 * c * y
    result = forces(sheet, step)
    for part in (slice(0, 3), slice(3, 6)):
        assert np.abs(result[inside, part]).max() < 1e-5 * max(np.abs(result[:, part]).max(), 1e-3)
    k = np.array(curvature)
    energy = 0.5 * float(k @ plane_stress(70e9, 0.33) @ k) * 1e-9 / 12.0 * 24e-3 * 12e-3
    assert 0.5 * float(np.sum(result * step)) == pytest.approx(energy, rel=1e-5)


@pytest.mark.parametrize("aspect", [1.0, 4.0, 16.0])
def test_the_optimal_membrane_bends_exactly_in_plane(aspect: float) -> None:
    """Felippa 2003, section 6: rectangles of two triangles under pure bending have the beam's energy,
    whatever their aspect ratio; E I k^2 L / 2 with u = - k x y, v = k (x^2 + nu y^2) / 2. Constant strain has
    not."""
    height, poisson = 0.01, 0.25
    length = aspect * height
    nodes = np.array([[0.0, -0.5, 0.0], [1.0, -0.5, 0.0], [1.0, 0.5, 0.0], [0.0, 0.5, 0.0]])
    nodes = nodes * [length, height, 1.0]
    x, y = nodes[:, 0] - 0.5 * length, nodes[:, 1]
    step = np.zeros((4, 6))
    step[:, 0], step[:, 1], step[:, 5] = -x * y, 0.5 * (x**2 + poisson * y**2), x
    beam = 0.5 * 70e9 * 1e-3 * height**3 / 12.0 * length
    energies = {}
    for membrane in MEMBRANES:
        result = []
        for triangles in ([[0, 1, 2], [0, 2, 3]], [[0, 1, 3], [1, 2, 3]]):
            sheet = ShellSheet(nodes, np.array(triangles), np.full(2, 1e-3), 70e9, poisson, membrane)
            result.append(0.5 * float(np.sum(forces(sheet, step) * step)))
        energies[membrane] = float(np.mean(result))
    assert energies["optimal"] == pytest.approx(beam, rel=1e-5)
    assert energies["constant strain"] > 2.0 * beam


@pytest.mark.parametrize("membrane", MEMBRANES)
def test_a_triangle_has_as_many_deformations_as_it_has_freedoms(membrane: Membrane) -> None:
    sheet, _ = patch(membrane)
    stiffness = elements(sheet).stiffness
    assert np.abs(stiffness - np.swapaxes(stiffness, 1, 2)).max() < 1e-9 * np.abs(stiffness).max()
    scale = np.sqrt(np.einsum("mii->mi", stiffness))
    scaled = stiffness / (scale[:, :, None] * scale[:, None, :])
    assert np.linalg.eigvalsh(scaled)[:, 0].min() > -1e-12  # 18 freedoms, 6 of them rigid, 12 here


def test_sheets_that_are_none_are_refused() -> None:
    sheet, _ = patch("optimal")
    for fault, expected_text in (
        ({"thickness": sheet.thickness[:-1]}, "one for each"),
        ({"thickness": -sheet.thickness}, "not positive"),
        ({"poisson": 0.5}, "nu 0.5"),
        ({"nodes": np.concatenate([sheet.nodes, sheet.nodes[:1]])}, "corner"),
        ({"nodes": sheet.nodes * [1.0, 0.0, 1.0]}, "no area"),
    ):
        with pytest.raises(ValueError, match=expected_text):
            dataclasses.replace(sheet, **fault)
