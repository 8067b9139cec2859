"""Poses of the user's own: lanes of a gauge over a block, for one arm and for two.

Feasible by: poses within two thirds of an arm's reach, pointing down or along gentle normals, above a block
that stands free; slow feeds; the gauge's spin is free.
"""

from __future__ import annotations

import json
import math
from typing import Any, Final

from bench.corpus import cells
from bench.corpus.job import Data, Draft, Draw, Fault

GAUGE: Final = {
    "kind": "plain",
    "tcp": {"xyz_mm": [0, 0, 160]},
    "mass_kg": 0.9,
    "cog_mm": [0, 0, 60],
    "shapes": [
        {"kind": "cylinder", "radius_mm": 20, "length_mm": 90, "pose": {"xyz_mm": [0, 0, 50]}},
        {"kind": "cylinder", "radius_mm": 28, "length_mm": 25, "pose": {"xyz_mm": [0, 0, 107.5]}},
    ],
}
HOMES: Final = {
    "irb140": ([0, -10, 10, 0, 60, 0], 500.0, 220.0),
    "irb1200_7_70": ([0, -10, 10, 0, 60, 0], 430.0, 220.0),
    "irb4600_40": ([0, -20, 20, 0, 60, 0], 1400.0, 600.0),
    "kr60_ha": ([0, -110, 110, 0, 60, 0], 1200.0, 600.0),
}
COLUMNS: Final = ("x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz")
Row = dict[str, Any]


def lanes(draw: Draw, name: str, height: float, x0: float, half: float, lane_ys: list[float]) -> list[Row]:
    """Return lanes along x over a vault, half circles between them; the tool's z points at its axis."""
    # the vault falls by 20 mm at most at the lanes' ends, which is the gauge's least height over the block
    radius = max(draw.number(350, 600, 0), math.ceil(half * half / 40.0))
    rows: list[Row] = []

    def pose(x: float, y: float, segment: str) -> None:
        turn = math.asin((x - x0) / radius)
        z = height - radius + radius * math.cos(turn)
        quaternion = (0.0, math.cos(turn / 2), 0.0, -math.sin(turn / 2))
        values = [x, y, z, *quaternion]
        row: Row = {f"{name}.{c}": v for c, v in zip(COLUMNS, values, strict=True)}
        rows.append(row | {"segment": segment})

    for number, y in enumerate(lane_ys):
        way = 1.0 if number % 2 == 0 else -1.0
        for k in range(31):
            pose(x0 + way * (-half + 2 * half * k / 30), y, f"cut/lane{number + 1}")
        if number + 1 < len(lane_ys):
            gap = (lane_ys[number + 1] - y) / 2
            for k in range(1, 24):
                angle = math.pi * k / 24
                pose(
                    x0 + way * (half + gap * math.sin(angle)),
                    y + gap * (1 - math.cos(angle)),
                    f"link/turn{number + 1}",
                )
    return rows


def base(draw: Draw) -> Draft:
    """Poses without fault."""
    two = draw.index % 4 == 3
    height = draw.pick([60, 80, 100])
    gap = draw.number(20, 30)
    form = draw.pick(["csv", "csv", "json"])
    if two:
        apart = draw.number(600, 640, 0)
        cell = cells.facing(
            ("irb140", "irb140"),
            (dict(GAUGE), dict(GAUGE)),
            apart,
            apart,
            (HOMES["irb140"][0],) * 2,
            draw.chance(0.3),
        )
        count, y0 = draw.whole(1, 2), draw.number(-20, 20)
        ys = [y0 + 40.0 * k - 20.0 * (count - 1) for k in range(count)]
        state = draw.random.bit_generator.state
        rows = lanes(draw, "left", height + gap, -120.0, 40.0, ys)
        draw.random.bit_generator.state = state
        other = lanes(draw, "right", height + gap, 120.0, 40.0, ys)
        rows = [
            {**row, **{k: v for k, v in two_.items() if k != "segment"}}
            for row, two_ in zip(rows, other, strict=True)
        ]
        arms, place, size = ["left", "right"], [0.0, 0.0, 220.0], [400, 160, height]
    else:
        robot = draw.turn(["irb140", "irb4600_40", "kr60_ha", "irb1200_7_70"])
        home, far, level = HOMES[robot]
        large = robot in ("irb4600_40", "kr60_ha")
        half = draw.number(120, 220) if large else draw.number(60, 100)
        cell = cells.alone(robot, dict(GAUGE), home)
        count = draw.whole(2, 5)
        rows = lanes(
            draw, "robot", height + gap, 0.0, half, [30.0 * (k - (count - 1) / 2) for k in range(count)]
        )
        arms, place, size = ["robot"], [far, draw.number(-60, 60, 0), level], [2 * half + 40, 180, height]
    feed = draw.pick([20, 40, 60])
    columns = [f"{arm}.{c}" for arm in arms for c in COLUMNS] + ["segment"]
    operation: Data = {
        "name": "gauge",
        "process": "targets",
        "arms": arms,
        "file": f"poses.{form}",
        "frame": "stock",
    }
    operation["feed_mm_s"] = feed
    operation["free"] = [
        {"name": f"spin_{arm}", "arms": [arm], "axis": "z", "turn_deg": [-180, 180]} for arm in arms
    ]
    problem = {
        "stock": {
            "size_mm": size,
            "place": {"xyz_mm": place},
            "support": cells.stand(0.8 * size[0], 120, place[2] - 20),
        },
        "settings": {"clearance_mm": draw.pick([5, 10])},
        "operations": [operation],
    }
    why = f"{len(rows)} poses of {'two arms' if two else 'one arm'} {gap:g} mm above a block in reach"
    draft = Draft(problem, cell, {}, {"rows": rows, "columns": columns, "form": form, "arms": arms}, why)
    _write(draft)
    return draft


def _write(draft: Draft) -> None:
    rows, columns = draft.facts["rows"], draft.facts["columns"]
    name = f"poses.{draft.facts['form']}"

    def cell(key: str, value: Any) -> Any:
        if not isinstance(value, float):
            return value
        return round(value, 9 if ".q" in key else 4) + 0.0

    plain = [{key: cell(key, row[key]) for key in columns if key in row} for row in rows]
    if draft.facts["form"] == "json":
        draft.files[name] = (json.dumps(plain, indent=0) + "\n").encode()
        return
    lines = [",".join(columns), *(",".join(str(row.get(key, "")) for key in columns) for row in plain)]
    draft.files[name] = ("\n".join(lines) + "\n").encode()


def _column(draft: Draft, draw: Draw) -> None:
    key = f"{draft.facts['arms'][0]}.qw"
    draft.facts["columns"] = [c for c in draft.facts["columns"] if c != key]
    _write(draft)


def _move_poses_away(draft: Draft, draw: Draw) -> None:
    for row in draft.facts["rows"]:
        row[f"{draft.facts['arms'][0]}.y_mm"] += 4500.0
    _write(draft)


def _both(draft: Draft, draw: Draw) -> None:
    draft.operation["free"][0]["slide_mm"] = [-5, 5]


def _box(draft: Draft, draw: Draw) -> None:
    """A box in the middle of the lanes, as high as the gauge."""
    place, size = draft.problem["stock"]["place"]["xyz_mm"], draft.problem["stock"]["size_mm"]
    row = draft.facts["rows"][15]
    x = row[f"{draft.facts['arms'][0]}.x_mm"]
    at = [place[0] + x, place[1], place[2] + size[2] + 100]
    shape = {"kind": "box", "size_mm": [30, 400, 190], "pose": {"xyz_mm": at}}
    draft.cell["obstacles"].append({"name": "box", "shapes": [shape]})


def _fast(draft: Draft, draw: Draw) -> None:
    """No arm turns corners of lanes at 2 m/s or more."""
    draft.operation.update(feed_mm_s=3000, feed_min_mm_s=2500)
    draft.problem["settings"]["tcp_speed_mm_s"] = 4000


def _missing(draft: Draft, draw: Draw) -> None:
    draft.operation["file"] = "lanes.csv"


def _robot(draft: Draft, draw: Draw) -> None:
    draft.cell["arms"][0]["robot"] = "irb9999"


def _number(draft: Draft, draw: Draw) -> None:
    draft.facts["rows"][3][f"{draft.facts['arms'][0]}.x_mm"] = "12,5"
    draft.facts["form"] = "json"
    draft.operation["file"] = "poses.json"
    draft.files.clear()
    _write(draft)


FAULTS: Final = [
    Fault("a column of the table is missing", ("targets.file",), _column),
    Fault("poses metres away", ("motion.no_reach",), _move_poses_away),
    Fault("a free axis turns and slides", ("targets.freedom",), _both),
    Fault("a box stands in the gauge's way", ("motion.collision", "motion.no_path"), _box),
    Fault("the least feed is beyond the arm in its turns", ("motion.feed_min",), _fast),
    Fault("the file of poses is not there", ("problem.missing_file", "targets.file"), _missing),
    Fault("a robot that no catalogue has", ("problem.unknown_robot",), _robot),
    Fault("a number that is none", ("targets.file",), _number),
]
