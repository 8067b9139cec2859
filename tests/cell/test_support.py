"""Supports of blocks: floor, bodies, given and generated supports, by plane geometry."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from planner import pipeline
from planner.cell import plant
from planner.cell import support as standing
from planner.geometry.arrays import Shape, from_rpy
from planner.issues import Issue, Severity
from planner.problem import Cell, Obstacle, Setup, Stock
from planner.reading.stock import PEDESTAL, TABLE
from planner.tooling import bow
from tests import small_problem
from tests.cell.cells import alone

SIZE = np.array([0.32, 0.50, 0.09])
TABLE_TOP = Obstacle("bench", (Shape("box", (0.6, 0.6, 0.05), from_rpy((1.0, 0.0, 0.375), (0, 0, 0))),))


def cell(*obstacles: Obstacle) -> Cell:
    return dataclasses.replace(alone("irb140", bow()), obstacles=obstacles)


def pose_at(x: float, z: float, rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    return from_rpy((x, 0.0, z), rpy)


def support_clearance(where: Cell, stock: Stock, stock_pose: np.ndarray) -> float:
    return float(standing.support_gap(standing.SupportGround.of(where), stock, stock_pose[None])[0])


def test_how_far_something_is_above_what_is_below_it() -> None:
    block = Stock(SIZE, None, np.eye(3))
    assert support_clearance(cell(), block, pose_at(1.0, 0.7)) == pytest.approx(0.7)
    assert support_clearance(cell(TABLE_TOP), block, pose_at(1.0, 0.7)) == pytest.approx(0.3)
    assert support_clearance(cell(TABLE_TOP), block, pose_at(1.29, 0.7)) == pytest.approx(
        0.3
    )  # its middle is over it
    assert support_clearance(cell(TABLE_TOP), block, pose_at(1.31, 0.7)) == pytest.approx(
        0.7
    )  # here it would tip
    beside = Obstacle("next", (Shape("box", (0.2, 0.6, 0.04), from_rpy((1.5, 0.0, 0.37), (0, 0, 0))),))
    assert support_clearance(cell(TABLE_TOP, beside), block, pose_at(1.35, 0.7)) == pytest.approx(
        0.3
    )  # over both
    assert support_clearance(cell(TABLE_TOP), block, pose_at(1.0, 0.2)) == pytest.approx(
        0.2
    )  # below the bench
    assert support_clearance(cell(TABLE_TOP), block, pose_at(1.0, 0.7, (np.pi / 2, 0, 0))) == pytest.approx(
        0.05
    )  # 0.7 - 0.25
    post = Shape("box", (0.1, 0.1, 0.6), from_rpy((0.0, 0.0, -0.3), (0, 0, 0)))
    borne = dataclasses.replace(block, support=(post,))
    assert support_clearance(cell(), borne, pose_at(1.0, 0.7)) == pytest.approx(0.1)
    assert support_clearance(cell(), borne, pose_at(1.0, 0.4)) == pytest.approx(-0.2)
    assert support_clearance(cell(TABLE_TOP), borne, pose_at(1.0, 0.97)) <= 0.0  # it stands in the bench


@pytest.mark.parametrize("tilt_deg", [(0.0, 0.0), (90.0, 0.0), (0.0, -90.0), (180.0, 0.0)])
@pytest.mark.parametrize("kind", [TABLE, PEDESTAL])
def test_what_is_made_goes_from_the_floor_to_the_block(tilt_deg: tuple[float, float], kind: Any) -> None:
    attitude = from_rpy((0, 0, 0), (*np.deg2rad(tilt_deg), 0.0))[:3, :3]
    over = np.array([[0.01, 0.02, 0.03], [0.0, 0.01, 0.0]])
    stock = Stock(SIZE, None, attitude, oversize=over, pedestal=kind)
    for height, level in zip(kind.heights, standing.stock_heights(cell(), stock), strict=True):
        place = np.eye(4)
        place[:3, :3], place[:3, 3] = attitude, (1.0, 0.2, level)
        made = standing.with_support(cell(), stock, place)
        (shape,) = made.support
        half = 0.5 * np.array(shape.size)
        corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half
        world = (place @ shape.pose @ np.c_[corners, np.ones(8)].T)[:3].T
        assert world[:, 2].min() == pytest.approx(0.0, abs=1e-9)
        assert world[:, 2].max() == pytest.approx(height)
        block = (place @ np.c_[standing.block_corners(stock), np.ones(8)].T)[:3].T
        assert block[:, 2].min() == pytest.approx(height)
        assert world[:, :2].mean(axis=0) == pytest.approx(block[:, :2].mean(axis=0))
        wide, long = np.ptp(world, axis=0)[:2], np.ptp(block, axis=0)[:2]
        assert (wide >= long - 1e-9).all() if kind is TABLE else (wide <= 0.6 * long + 1e-9).all()
        assert all(min(abs(w - s) for s in kind.sides) < 1e-9 for w in wide)


def test_the_plant_has_it_as_high_as_the_place_wants_it() -> None:
    stock = Stock(SIZE, None, np.eye(3), pedestal=PEDESTAL)
    model = plant.build_cell_model(cell(), stock, pose_at(0.9, 0.5))
    for height in (0.8, 0.3, 0.8):
        model = model.with_stock(pose_at(0.9, height))
        (support,) = [solid for solid in model.solids if solid.body == "support"]
        assert support.shape.size[2] == pytest.approx(height)
        assert model.stock_pose[2, 3] == height


def stock_issues(folder: Path, stock: dict[str, Any], accept: list[str] | None = None) -> list[Issue]:
    data = yaml.safe_load(small_problem.PROBLEM)
    data["stock"] = {"size_mm": [100, 100, 100], **stock}
    data["accept"] = accept or []
    found = pipeline.check(pipeline.load(small_problem.write(folder, yaml.safe_dump(data))))
    return [i for i in found if i.code.startswith("stock.") or i.code == "problem.field"]


def test_a_block_and_a_support_in_the_air_are_refused_unless_accepted(tmp_path: Path) -> None:
    place = {"xyz_mm": [450, 0, 100]}
    (hangs,) = stock_issues(tmp_path, {"place": place})
    assert (hangs.code, hangs.severity, hangs.value) == ("stock.hangs", Severity.ERROR, pytest.approx(100))
    (taken,) = stock_issues(tmp_path, {"place": place}, ["stock.hangs"])
    assert taken.accepted and taken.severity is Severity.WARNING
    (searched,) = stock_issues(tmp_path, {"place": "auto"})
    assert (searched.code, searched.severity) == ("stock.hangs", Severity.ERROR)
    post = {"kind": "box", "size_mm": [60, 60, 40], "pose": {"xyz_mm": [0, 0, -20]}}
    (air,) = stock_issues(tmp_path, {"place": place, "support": [post]})
    assert (air.code, air.severity, air.value) == ("stock.support", Severity.ERROR, pytest.approx(60))
    (taken,) = stock_issues(tmp_path, {"place": place, "support": [post]}, ["stock.support"])
    assert taken.accepted and taken.severity is Severity.WARNING
    # what both advise
    assert stock_issues(tmp_path, {"place": place, "support": "pedestal"}) == []
    assert stock_issues(tmp_path, {"place": place, "support": "table"}) == []
    post = {"kind": "box", "size_mm": [60, 60, 80], "pose": {"xyz_mm": [0, 0, -60]}}  # 20 mm below it
    assert stock_issues(tmp_path, {"place": place, "support": [post]}) == []
    post = {"kind": "box", "size_mm": [60, 60, 70], "pose": {"xyz_mm": [0, 0, -65]}}
    assert [i.code for i in stock_issues(tmp_path, {"place": place, "support": [post]})] == ["stock.support"]
    leaning = {"place": {"xyz_mm": [450, 0, 100], "rpy_deg": [30, 0, 0]}, "support": "pedestal"}
    assert [(i.code, i.field) for i in stock_issues(tmp_path, leaning)] == [
        ("problem.field", "stock.support")
    ]


def test_what_it_stands_on_in_words() -> None:
    stock = Stock(SIZE, None, np.eye(3))
    assert standing.support_note(cell(), stock, pose_at(1.0, 0.0)) == "the floor"
    assert standing.support_note(cell(TABLE_TOP), stock, pose_at(1.0, 0.41)) == "the body bench of the cell"
    assert "300 mm above what is below it" in standing.support_note(cell(), stock, pose_at(1.0, 0.3))
    made = dataclasses.replace(stock, pedestal=PEDESTAL)
    assert standing.support_note(cell(), made, pose_at(1.0, 0.7)).startswith(
        "a pedestal of 160 x 280 mm, 700 mm high"
    )


def test_a_support_is_under_the_middle_of_its_block(tmp_path: Path) -> None:
    place = {"xyz_mm": [450, 0, 100]}

    def post(x: float, *, size: float = 60, top: float = 0.0) -> dict[str, Any]:
        box = {"xyz_mm": [x, 0, top - 50]}
        return {"kind": "box", "size_mm": [size, size, 100], "pose": box}

    # a post of 60 mm bears the block as long as its edge is beyond the middle
    for x, off in ((29.0, None), (-29.0, None), (40.0, 10.0), (-75.0, 45.0)):
        found = stock_issues(tmp_path, {"place": place, "support": [post(x)]})
        assert [(i.code, i.value) for i in found] == ([("stock.support", pytest.approx(off))] if off else [])
    assert stock_issues(tmp_path, {"place": place, "support": [post(40.0), post(-40.0, size=20)]}) == []
    (aside,) = stock_issues(tmp_path, {"place": place, "support": [post(200.0, top=60.0)]})
    assert "nothing of the support is under the block" in aside.message
    assert [i.code for i in stock_issues(tmp_path, {"place": "auto", "support": [post(40.0)]})] == [
        "stock.support"
    ]


def test_what_is_made_is_no_higher_than_what_is_in_stock(tmp_path: Path) -> None:
    for z, fits in ((1500, True), (1501, False), (-20, True), (-40, False)):
        found = stock_issues(tmp_path, {"place": {"xyz_mm": [450, 0, z]}, "support": "pedestal"})
        assert [i.code for i in found] == ([] if fits else ["stock.support"]), z
    assert (
        "at most 1100"
        in stock_issues(tmp_path, {"place": {"xyz_mm": [0, 0, 1200]}, "support": "table"})[0].message
    )


def test_what_is_made_does_not_stand_in_a_body_of_the_cell() -> None:
    for x, code in ((1.0, ["stock.support"]), (1.5, [])):
        stock = Stock(SIZE, pose_at(x, 0.7), np.eye(3), pedestal=PEDESTAL)
        found = standing.setup_support_issues(Setup(1, cell(TABLE_TOP), stock, (0,)))
        assert [issue.code for issue in found] == code
        assert all("inside bench" in issue.message for issue in found)
