"""Springback files of small jobs without an elastic sheet: forecasts by a formula, and deliberate edits."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from planner.geometry.units import MM
from planner.processes.forming.plan.job import FormingJob
from planner.processes.forming.plan.process_plan import make_tool_paths
from planner.processes.forming.plan.springback import compensation, compensation_file, forecast
from planner.processes.forming.plan.springback.curves import PassSpringback, SpringbackCurve


def forecast_job(job: FormingJob, max_points: int = 8) -> tuple[list[Any], tuple[PassSpringback, ...]]:
    """Paths of a job, and a forecast of 1.2 mm at the top, 0.05 mm less for each mm of depth."""
    tool_paths = make_tool_paths(job.planned)
    control = forecast.forecast_points(job.planned, tool_paths, max_points)
    curves = []
    for _, rows in control:
        for point in rows:
            depth = abs(float(point.contact[2]) - job.planned.passes[point.number].start)
            s = 1.2 * MM - 0.05 * depth
            force = point.force * np.array([0.0, 0.5, 1.0, 1.4])
            curves.append(SpringbackCurve(force, s * np.array([0.0, 0.6, 1.0, 1.3]), False))
    return tool_paths, forecast.make_forecast(tool_paths, control, curves)


def text_of(job: FormingJob, slope: float = 0.05) -> str:
    laid, found = forecast_job(job)
    ways, _ = compensation.compensated_paths(job.planned, laid, found, slope)
    identity = compensation_file.job_identity(job.planned, job.setup.stock, job.part)
    return compensation_file.springback_file_text("test", job.planned, identity, found, ways, slope)


def edited(text: str, change: Callable[[dict[str, Any]], None]) -> str:
    """A file with other values and a checksum that fits them, as one has it who means it."""
    data = json.loads(text)
    change(data)
    data.pop("sha256")
    body = json.dumps(data)[:-1] + ",\n"
    return body + f'"sha256": "{hashlib.sha256(body.encode()).hexdigest()}"\n}}\n'


def each_point(change: Callable[[list[float]], None]) -> Callable[[dict[str, Any]], None]:
    """Each point of all rings is changed."""

    def of(data: dict[str, Any]) -> None:
        for one in data["passes"]:
            for ring in one["rings"]:
                for point in ring:
                    change(point)

    return of


def twice(data: dict[str, Any]) -> None:
    """Twice the springback, everywhere, so that the file agrees with itself."""
    each_point(lambda p: p.__setitem__(3, 2.0 * p[3]))(data)
    for row in data["control_points"]:
        scaled(row, 2.0)


def scaled(row: dict[str, Any], factor: float) -> None:
    """A control point comes back by ``factor`` as much, with its curve."""
    row["springback_mm"] *= factor
    row["displacements_mm"] = [factor * one for one in row["displacements_mm"]]


def under_less(data: dict[str, Any]) -> None:
    """One point is under four fifths of its force, with its curve."""
    row = data["control_points"][1]
    row["force_n"] *= 0.8
    row["forces_n"] = [0.8 * one for one in row["forces_n"]]


def negate_springback(data: dict[str, Any]) -> None:
    """Reverse all shifts: out of the sheet instead of into it."""
    each_point(lambda p: p.__setitem__(3, -p[3]))(data)


def steep(data: dict[str, Any]) -> None:
    """One point is shifted by half a millimetre more than its neighbours."""
    data["passes"][0]["rings"][1][5][3] += 0.5


def short(data: dict[str, Any]) -> None:
    """The rings miss a part of the path."""
    ring = data["passes"][0]["rings"][1]
    del ring[4:12]
    data["points"] -= 8


def written(path: Path, text: str) -> Path:
    path.write_text(text)
    return path
