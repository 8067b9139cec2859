"""Parts as problem files describe them, built in a block or refused by it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner.issues import Issue, TandemError
from planner.problem import Part, Stock
from planner.reading.part import PartFile, build_part

BLOCK = np.array([0.3, 0.6, 0.1])
SQUARE = [[0, 0], [100, 0], [100, 100], [0, 100]]
WING = {
    "root": {"naca": "2412", "chord_mm": 200},
    "tip": {"naca": "23112", "chord_mm": 120},
    "span_mm": 500,
    "sweep_deg": 6,
    "twist_deg": 2,
    "dihedral_deg": 2,
    "trailing_edge_mm": 1,
}


def make(spec: dict[str, Any], folder: Path = Path(), size: np.ndarray = BLOCK) -> Part:
    return build_part(
        PartFile.model_validate_json(json.dumps(spec), strict=True), folder, Stock(size, None, np.eye(3))
    )


def expect_refusal(spec: dict[str, Any], folder: Path = Path(), size: np.ndarray = BLOCK) -> list[Issue]:
    with pytest.raises(TandemError) as caught:
        make(spec, folder, size)
    return list(caught.value.issues)


def guides(**more: Any) -> dict[str, Any]:
    top = [[x, y, 60] for x, y in SQUARE[1:] + SQUARE[:1]]
    own = {"start": {"polyline_mm": [[*p, 0] for p in SQUARE]}, "end": {"polyline_mm": top}, "closed": True}
    return {"ruled": [{"name": "sides", **own, **more}]}


def outline(*more: Any) -> dict[str, Any]:
    return {"plate": {"outlines": [{"polyline_mm": SQUARE}, *more]}}


def circle(x: float, y: float, radius: float) -> dict[str, Any]:
    return {"circle": {"centre_mm": [x, y], "radius_mm": radius}}
