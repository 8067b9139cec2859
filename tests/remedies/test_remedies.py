"""Remedies work: the advice of an issue is applied to the problem, by its own figures, and the issue is gone.

Each row is a bundled problem that cannot be solved; ``problems/infeasible/expect.yaml`` has its codes.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.refusals import change
from tests.remedies.advice import ReportedFigure, Word
from tests.test_infeasible import EXPECT, FOLDER, errors

PLATE = [[-90, -70], [90, -70], [90, 70], [-90, 70]]
ARC = [[-70, 0], [-25, 21], [25, 21], [70, 0]]
ARCH = [{"at": y / 200 + 0.5, "bezier_mm": [[x, y, z] for x, z in ARC]} for y in (-100.0, 100.0)]


def guide(*points: list[float]) -> dict[str, Any]:
    return {"polyline_mm": list(points)}


REMEDIES: dict[str, Mapping[str, Any]] = {
    # hot wire
    "wire_too_short": {
        "operations.0.wire.length_mm": ReportedFigure("length_mm: #"),
        "operations.0.sweep": Word("sweep: ([xy])"),
    },
    "wire_too_thick": {
        "operations.0.wire.diameter_mm": ReportedFigure("diameter_mm: #", 0.01),
        "operations.0.wire.length_mm": ReportedFigure("length_mm: #"),
        "operations.0.sweep": Word("sweep: ([xy])"),
    },
    "waves": {"operations.0.shape_tol_mm": ReportedFigure("within # mm", 0.1)},
    "flat_wall": {"part.front.loft.sections": ARCH},
    "thin_wire_on_edge": {
        "operations.0.wire.length_mm": ReportedFigure("length_mm: #"),
        "operations.0.sweep": Word("sweep: ([xy])"),
    },
    "block_too_small": {"stock.size_mm.1": ReportedFigure("by # mm in y", more=True)},
    "bent_tighter_than_thick": {"part.back.offset_mm": 15},
    "no_back_face": {"operations.0.faces": ["front"]},
    "far_cell": {"stock.place": "auto"},
    "unequal_corners": {
        "part.ruled.0.start.corners_mm": [[0, 0, 0], [90, 0, 0], [0, 90, 0]],
        "part.ruled.0.end.corners_mm": [[0, 0, 80], [90, 0, 80], [0, 90, 80]],
    },
    "crossing_outline": {"part.plate.outlines.0.polyline_mm": PLATE},
    "wider_than_the_wire": {"cell.arms.0.tool.span_mm": ReportedFigure("need a wire of # mm")},
    "deeper_than_the_throat": {"cell.arms.0.tool.throat_mm": ReportedFigure("is # mm deeper", more=True)},
    "block_too_heavy": {"stock.size_mm": [700, 600, 300]},
    "gripper_in_the_way": {
        "cell.arms.1.tool.width_mm": ReportedFigure("has width_mm: #"),
        "cell.arms.1.tool.depth_mm": ReportedFigure("depth_mm: #"),
    },
    "foam_without_data": {"stock.foam": "eps_a120"},
    "no_such_surface": {"operations.0.cuts.0.surface": "outline_a"},
    # mill
    "mill_short_flute": {"cell.arms.0.tool.flute_mm": ReportedFigure("needs # mm of flute")},
    "mill_too_thick": {
        "cell.arms.0.tool.diameter_mm": ReportedFigure(
            "radius that fits there is # mm", 0.01, down=True, times=2.0
        )
    },
    "mill_twisted": {
        "cell.arms.0.tool.diameter_mm": ReportedFigure("radius of # mm or less", 0.01, down=True, times=2.0)
    },
    "mill_lies_flat": {"operations.0.safe_side": Word("use safe_side: (\\w+)")},
    "mill_guides_cross": {"part.ruled.0.end": guide([-30, 0, 50], [30, 0, 50])},
    "mill_inner_corner": {
        "part.ruled.0.start": guide([-40, 0, 36], [0, 20, 36]),
        "part.ruled.0.end": guide([-40, 0, 50], [0, 20, 50]),
    },
    "mill_unreachable": {"stock.place.xyz_mm.0": ReportedFigure("move the stock by (#, 0, 0) mm", more=True)},
    # sheet
    "sheet_tool_too_big": {
        "cell.arms.0.tool.radius_mm": ReportedFigure("largest radius that fits is # mm", 0.01, down=True)
    },
    "sheet_part_too_wide": {
        "sheet.opening_mm": ReportedFigure("extends # mm beyond", times=2.0, more=True),
        "sheet.size_mm": [220, 220],
    },
    "sheet_wrong_unit": {"part.sheet_mesh.unit": "m"},
    "sheet_other_metal": {"sheet.metal": "aa1050_o"},
    "sheet_adsif_steep": {"operations.0.mode": "dsif"},
    # G-code
    "gcode_unstated": {
        "operations.0.cuts.0.gcode.unit": "mm",
        "operations.0.cuts.0.gcode.feed_mode": "per_minute",
        "operations.0.cuts.0.gcode.plane": "xy",
    },
}


def follow(name: str, folder: Path) -> Path:
    """The problem of that name with its remedy, in ``folder``; the cell stands inside it."""
    issues = [issue for issue in errors(FOLDER / name) if issue.code in EXPECT[name]]
    data = yaml.safe_load((FOLDER / name).read_text())
    data["cell"] = yaml.safe_load((FOLDER / data["cell"]).read_text())

    def figures(value: Any, now: Any) -> Any:
        if isinstance(value, dict):
            return {key: figures(item, None) for key, item in value.items()}
        return value.of(issues, now) if isinstance(value, ReportedFigure | Word) else value

    for field, value in REMEDIES[Path(name).stem].items():
        now: Any = data
        for step in field.split("."):
            now = now[int(step)] if isinstance(now, list) else now.get(step)
            if now is None:
                break
        data = change(data, field, figures(value, now))
    shutil.copytree(FOLDER, folder, dirs_exist_ok=True)
    (folder / name).write_text(yaml.safe_dump(data))
    return folder / name


@pytest.mark.sampled(every=8)
@pytest.mark.parametrize("name", REMEDIES)
def test_what_an_issue_advises_ends_it(name: str, tmp_path: Path) -> None:
    left = errors(follow(f"{name}.yaml", tmp_path))
    assert not [str(issue) for issue in left if issue.code in EXPECT[f"{name}.yaml"]]
