"""One figure for each quantity: job page, report, replay, program headers, proof and console agree."""

from __future__ import annotations

import html
import json
import re
from pathlib import Path

import numpy as np
import pytest

from planner import pipeline
from planner.batch.rows import result_figures
from planner.cli import console
from tests import small_problem

TAGS = re.compile(r"<(script|style|svg)\b.*?</\1>|<[^>]+>", re.DOTALL)
TILES = {
    "clearance_mm": ("minimum clearance", "verify.clearance", "clearance", "mm"),
    "own_clearance_mm": ("self-clearance", "verify.own_clearance", "own clearance", "mm"),
    "joint_limits_deg": ("to a joint limit", "verify.joint_limits", "joint limits", "deg margin"),
    "singularity_deg": ("from singularity", "verify.singularity", "singularity", "deg"),
    "joint_speed_percent": ("maximum joint speed", "verify.joint_speed", "joint speed", "% of the limit"),
}


@pytest.fixture(scope="module")
def outcome(tmp_path_factory: pytest.TempPathFactory) -> pipeline.Outcome:
    return pipeline.plan(pipeline.load(small_problem.write(tmp_path_factory.mktemp("problem"))))


@pytest.fixture(scope="module")
def folder(outcome: pipeline.Outcome, tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("result") / "out"
    outcome.save(made)
    return made


@pytest.fixture(scope="module")
def report(folder: Path) -> str:
    """The words of the report, pictures left out."""
    words = TAGS.sub(" ", (folder / "report.html").read_text("utf-8"))
    return " ".join(html.unescape(words).split())


def figure_in(pattern: str, text: str) -> float:
    """The one figure that a text has there."""
    result = {float(item) for item in re.findall(pattern, text)}
    assert len(result) == 1, f"{pattern}: {result}"
    return result.pop()


@pytest.mark.parametrize("name", TILES)
def test_margins_are_the_proof_s_own_everywhere(
    outcome: pipeline.Outcome, folder: Path, report: str, name: str
) -> None:
    title, code, header, unit = TILES[name]
    page = result_figures(outcome.plan, outcome.proof.rules)[name]
    (rule,) = (
        item for item in json.loads((folder / "proof.json").read_text())["rules"] if item["code"] == code
    )
    assert rule["worst"] == page
    tile = figure_in(rf"([\d.]+) (?:°|mm|% of limit) {title}", report)
    assert tile == pytest.approx(page, abs=0.5 if "percent" in name else 0.05)
    row = figure_in(rf"([\d.]+) {unit} [\d.]+ {unit} (?:(?!verify).)*{code} ", report)
    assert row == pytest.approx(page, abs=0.006)
    for path in (folder / "programs").rglob("*.mod"):
        told = re.findall(rf"! Proven: {header} ([\d.]+) ", path.read_text())
        assert [float(item) for item in told] == [row], path.name


def test_charts_tell_the_least_that_tiles_tell(report: str) -> None:
    for chart, tile in (
        (r"Distance to the nearest joint limit minimum: ([\d.]+)°", r"([\d.]+) ° to a joint limit"),
        (
            r"Distance to the nearest singular posture minimum during linear moves: ([\d.]+)°",
            r"([\d.]+) ° from singularity",
        ),
        (r"Clearance to everything else minimum: ([\d.]+) mm", r"([\d.]+) mm minimum clearance"),
        (r"Clearance of each arm to itself minimum: ([\d.]+) mm", r"([\d.]+) mm self-clearance"),
    ):
        assert figure_in(chart, report) == figure_in(tile, report)


def test_the_curve_of_singular_postures_is_the_one_that_is_proven(outcome: pipeline.Outcome) -> None:
    """Its minimum over the straight path is that of the rule; the wrist alone has a larger distance here."""
    series = outcome.proof.series
    straight = np.array([str(label).startswith("cut/") for label in series["label"]])
    minimum = float(np.rad2deg(np.min(series["singular/left"][straight])))
    assert minimum == pytest.approx(outcome.proof.rule("verify.singularity").worst, abs=0.01)


def test_the_time_from_first_to_last_target_is_one(
    outcome: pipeline.Outcome, folder: Path, report: str, capsys: pytest.CaptureFixture[str]
) -> None:
    page = result_figures(outcome.plan, outcome.proof.rules)["cycle_s"]
    assert page == outcome.plan.duration > 1.0
    assert figure_in(r"([\d.]+) s motion time from first to last target", report) == pytest.approx(
        page, abs=0.05
    )
    replay = (folder / "replay.html").read_text("utf-8")
    (minutes, seconds), *more = set(re.findall(r"(\d+):([\d.]+) from first to last target", replay))
    assert not more
    assert 60 * int(minutes) + float(seconds) == pytest.approx(page, abs=0.05)
    console.print_summary(outcome, folder, 1.0)
    assert figure_in(r"([\d.]+) s of motion", capsys.readouterr().out) == pytest.approx(page, abs=0.05)
