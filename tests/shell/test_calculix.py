"""Plates, cones and pyramids against CalculiX.

The references are a table that ``bench/calculix_shells.py`` wrote, and runs of ``ccx`` where that is
installed (Debian package ``calculix-ccx``).
"""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest

from bench import calculix_shells as calculix

TABLE = json.loads(calculix.TABLE.read_text())
SHAPES = {shape.name: shape for shape in calculix.SHAPES}
SHORT = ("plate", "cone 40", "pyramid, corner")
"""What the short tests look at, with fewer triangles; the long ones look at all."""
needs_ccx = pytest.mark.skipif(
    shutil.which("ccx") is None, reason="ccx is not installed: apt-get install calculix-ccx"
)


def test_the_table_has_every_shape_with_its_meshes() -> None:
    assert list(TABLE) == list(SHAPES)
    assert len(SHAPES) >= 10
    for name, row in TABLE.items():
        assert row["forces_n"] == list(SHAPES[name].forces)
        assert [int(count) for count in row["meshes"]] == list(SHAPES[name].meshes)
        meshes = {int(count): mesh["mm"] for count, mesh in row["meshes"].items()}
        assert calculix.extrapolate(meshes) == pytest.approx(row["extrapolated_mm"], abs=1e-5)


@pytest.mark.parametrize("name", SHORT)
def test_few_triangles_agree_with_calculix(name: str) -> None:
    """Within 1.5 % with 1,200 triangles of what S8R comes to at size zero."""
    assert calculix.ours(SHAPES[name], 1200) == pytest.approx(TABLE[name]["extrapolated_mm"], rel=0.015)


@pytest.mark.long
@pytest.mark.parametrize("name", SHAPES)
def test_4000_triangles_agree_with_calculix(name: str) -> None:
    """Within 1 % of what S8R comes to at size zero, by the line through the three finest meshes."""
    assert calculix.ours(SHAPES[name], calculix.TRIANGLES) == pytest.approx(
        TABLE[name]["extrapolated_mm"], rel=0.01
    )


@needs_ccx
def test_calculix_still_says_so_of_one_coarse_mesh() -> None:
    name, count = "cone 60, 30 deg", calculix.MESHES[0]
    result = calculix.calculix(SHAPES[name], count)
    assert result["elements"] == TABLE[name]["meshes"][str(count)]["elements"]
    assert result["mm"] == pytest.approx(TABLE[name]["meshes"][str(count)]["mm"], rel=1e-3)


@needs_ccx
@pytest.mark.long
@pytest.mark.parametrize("name", ["plate, immovable", "cone 40", "pyramid, wall"])
def test_calculix_still_says_so_of_three_shapes(name: str) -> None:
    for count in calculix.MESHES[:2]:
        result = calculix.calculix(SHAPES[name], count)
        assert result["mm"] == pytest.approx(TABLE[name]["meshes"][str(count)]["mm"], rel=1e-3)


def test_decks_have_what_they_say() -> None:
    """Elements turn the same way, cover the sheet, and the load's node is at its place."""
    shape = SHAPES["cone 50, immovable"]
    nodes, elements, thickness = calculix.quadrilaterals(shape, 6)
    a, b, c, d = (nodes[elements[:, k], :2] for k in range(4))
    item, two = c - a, d - b
    area = 0.5 * (item[:, 0] * two[:, 1] - item[:, 1] * two[:, 0])
    assert area.min() > 0.0
    whole = 4.0 * np.prod(shape.half)
    assert area.sum() == pytest.approx(whole, rel=1e-6)
    assert set(np.round(thickness, 6)) == {1.0, round(np.cos(np.radians(45.0)), 6)}
    text, count = calculix.deck(shape, 6)
    assert count == len(elements)
    assert text.count("*STEP") == len(shape.forces)
