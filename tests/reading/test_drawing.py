"""DXF drawings: hidden objects are ignored, units are compared with the problem's, pieces are joined."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner.issues import Severity, TandemError
from planner.proof.part_files import curves as proof
from planner.reading.drawing import join_curves, read_dxf

ezdxf = pytest.importorskip("ezdxf")


def drawing(path: Path, units: int = 4, **radius: float) -> Path:
    """Circles about the origin, one on each layer."""
    document = ezdxf.new(units=units)
    for name, size in radius.items():
        layer = document.layers.add(name)
        if name.startswith("off"):
            layer.off()
        if name.startswith("frozen"):
            layer.freeze()
        more = {"invisible": 1} if name.startswith("unseen") else {}
        document.modelspace().add_circle((0, 0), size, dxfattribs={"layer": name, **more})
    document.saveas(path)
    return path


def sizes(curves: Any) -> list[float]:
    return [round(float(np.linalg.norm(curve.points[0])), 9) for curve in curves]


def test_what_is_hidden_is_left_out_by_planner_and_proof(tmp_path: Path) -> None:
    path = drawing(tmp_path / "a.dxf", cut=10, off=20, frozen=30, unseen=40)
    result, (note,) = read_dxf(path, 1e-3, None, "part")
    assert (note.code, note.severity) == ("part.dxf_left_out", Severity.NOTE)
    assert "left out 3 hidden" in note.message
    assert sizes(result) == sizes(proof.read_curves(path, 1e-3, None)) == [0.01]
    with pytest.raises(TandemError, match=r"no curves on layer OFF, but 1 hidden; show objects"):
        read_dxf(path, 1e-3, "OFF", "part")
    assert proof.read_curves(path, 1e-3, "off") == []


@pytest.mark.parametrize(("units", "unit_name"), [(1, "in"), (6, "m"), (4, None), (0, None)])
def test_another_unit_than_the_drawings_is_told(tmp_path: Path, units: int, unit_name: str | None) -> None:
    _, notes = read_dxf(drawing(tmp_path / "a.dxf", units, cut=10), 1e-3, None, "part.plate.dxf")
    assert [(note.code, note.severity, note.field) for note in notes] == (
        [("part.dxf_unit", Severity.WARNING, "part.plate.dxf")] if unit_name else []
    )
    assert all(
        f"lengths in {unit_name} " in note.message and "reads them in mm" in note.message for note in notes
    )


def test_a_drawing_of_a_town_is_refused_before_its_points_are_made(tmp_path: Path) -> None:
    """A circle of 10,000 km in metres took 1.8 GB."""
    with pytest.raises(TandemError, match=r"is 2e\+07 m across, allowed 100 m; check the unit"):
        read_dxf(drawing(tmp_path / "a.dxf", 6, cut=1e7), 1.0, None, "part")


def naive(pieces: list[np.ndarray]) -> list[tuple[bool, int]]:
    """How many points the chains have, piece by piece."""
    left, out = list(pieces), []
    shut = lambda p: len(p) > 3 and np.linalg.norm(p[0] - p[-1]) <= 1e-5  # noqa: E731
    while left:
        chain, grown = left.pop(0), True
        while grown and not shut(chain):
            grown = False
            for i, other in enumerate(left):
                ways = [(a, b) for a in (chain, chain[::-1]) for b in (other, other[::-1])]
                near = [(a, b) for a, b in ways if np.linalg.norm(a[-1] - b[0]) <= 1e-5]
                if near and not shut(other):
                    chain, grown = np.concatenate([near[0][0], near[0][1][1:]]), True
                    left.pop(i)
                    break
        out.append((bool(shut(chain)), len(chain) - int(shut(chain))))
    return out


def test_pieces_are_joined_as_one_by_one() -> None:
    rng = np.random.default_rng(7)
    for _ in range(20):
        nodes = rng.integers(0, 4, (12, 2, 3)) * 0.01
        pieces = [np.linspace(a, b, 3) for a, b in nodes if (a != b).any()]
        assert [(curve.closed, len(curve.points)) for curve in join_curves(pieces)] == naive(pieces)
    lines = [np.array([[2.0 * i, 0, 0], [2.0 * i + 1.0, 0, 0]]) for i in range(300)]
    assert len(join_curves(lines)) == len(proof.join_pieces(lines)) == 300


CLOSED = {
    "circle": lambda space: space.add_circle((3, 4), 10),
    "circle from below": lambda space: space.add_circle((3, 4), 10, dxfattribs={"extrusion": (0, 0, -1)}),
    "ellipse": lambda space: space.add_ellipse((3, 4), (10, 3), 0.5, 1.0, 1.0 + 2.0 * np.pi),
    "spline": lambda space: space.add_open_spline([(0, 0), (10, 5), (20, 0), (10, -9), (0, 0)]),
    "spline of a period": lambda space: space.add_spline().set_closed(
        [(0, 0, 0), (10, 5, 0), (20, 0, 0), (10, -9, 0)]
    ),
    "polyline": lambda space: space.add_lwpolyline([(0, 0, 0, 0, 0.5), (10, 0), (10, 10)], close=True),
}


@pytest.mark.parametrize("kind", CLOSED)
def test_what_ends_where_it_begins_is_run_as_it_is_drawn(tmp_path: Path, kind: str) -> None:
    """Engraving runs along it that way, by planner and proof: ezdxf's paths of some go the other way."""
    document = ezdxf.new(units=4)
    CLOSED[kind](document.modelspace())
    document.saveas(tmp_path / "a.dxf")
    ((own,), _) = read_dxf(tmp_path / "a.dxf", 1e-3, None, "part")
    (other,) = proof.read_curves(tmp_path / "a.dxf", 1e-3, None)
    assert own.closed and other.closed
    ways = []
    for points in (own.run_points(), np.concatenate([other.points, other.points[:1]])):
        gone = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
        at = np.linspace(0.0, gone[-1], 17)
        ways.append(np.stack([np.interp(at, gone, points[:, k]) for k in range(3)], axis=1))
    assert np.abs(ways[0] - ways[1]).max() < 1e-5


@pytest.mark.parametrize("knots", [[0, 0, 0, 0, 1], [0, 0, 3, 0, 1, 1, 1, 1], [0] * 8])
def test_a_spline_whose_knots_make_no_curve_is_refused_by_name(tmp_path: Path, knots: list[float]) -> None:
    document = ezdxf.new(units=4)
    spline = document.modelspace().add_spline()
    spline.control_points = [(0, 0, 0), (10, 5, 0), (20, 0, 0), (10, -9, 0)]
    spline.knots = knots
    document.saveas(tmp_path / "a.dxf")
    with pytest.raises(TandemError, match=r"a\.dxf: has a curve that cannot be read .*; draw it again"):
        read_dxf(tmp_path / "a.dxf", 1e-3, None, "part")


def test_where_three_lines_meet_planner_and_proof_go_on_with_the_nearest(tmp_path: Path) -> None:
    """Ends that are a few nanometres apart, as those of a file in inches: the first of the file was taken."""
    document = ezdxf.new(units=4)
    for start, end in (((0, 0), (10, 0)), ((10.000004, 0), (20, 5)), ((10.000001, 0), (20, -5))):
        document.modelspace().add_line(start, end)
    document.saveas(tmp_path / "a.dxf")
    own, _ = read_dxf(tmp_path / "a.dxf", 1e-3, None, "part")
    other = proof.read_curves(tmp_path / "a.dxf", 1e-3, None)
    assert [curve.run_points()[-1].tolist() for curve in own] == [
        curve.points[-1].tolist() for curve in other
    ]
    assert own[0].run_points()[-1, 1] == pytest.approx(-5e-3)
