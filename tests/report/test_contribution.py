"""Parts of the report that plug-ins supply; the report itself knows none of them."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest

from planner import report
from planner.report import output, plugin_contributions
from planner.report.charts import ChartLine, FaceWords
from planner.report.markup import Tile
from planner.report.plugin_contributions import ProcessMotion, ReportOfLanguage, ReportOfProcess, TimeChart
from planner.runtime import plugins
from planner.runtime.plugins import Language, LoadedPlugin, Process
from tests.report import synthetic_job as job

CHART = TimeChart("Glow of the toy", (ChartLine("glow", np.arange(3.0), np.arange(3.0)),), "W", "bright")
PROCESS = ReportOfProcess(
    tiles=lambda plan, proof: (Tile("toys", "7", "kg"),),
    setup_rows=lambda *_: [("paint of the toy", "blue")],
    motion=lambda plan, series: ProcessMotion(charts=(CHART,)),
    faces={"cut": FaceWords("toy", "too blue", "too pale")},
    hot="the toy",
)
LANGUAGE = ReportOfLanguage(
    checks=lambda setup: [("switch of the toy", f"on, {setup.hot} in {', '.join(setup.signals)}")],
    programs=lambda problem, arms: [("toys of", " and ".join(arm.name for arm in arms))],
)


def test_the_report_draws_what_plug_ins_supply(monkeypatch: pytest.MonkeyPatch) -> None:
    families = tuple({arm.data.family for arm in job.problem().cell.arms})
    toys = {
        Process: {"elastic_wire": LoadedPlugin(Process("", "", report=f"{__name__}:PROCESS"), "")},
        Language: {
            "toy": LoadedPlugin(Language("toy", families, (), "", "", report=f"{__name__}:LANGUAGE"), "")
        },
    }
    monkeypatch.setattr(plugins, "installed", toys.__getitem__)
    text = output.report_html(job.problem(), job.plan(60), job.proof(200))
    for words in ("toys", "paint of the toy", "Glow of the toy", "too blue", "switch of the toy"):
        assert words in text
    assert "on, the toy in doWirePower" in text and "toys of" in text and "left and right" in text
    assert "wire, hot length" not in text and "RobotWare" not in text


def test_processes_that_a_problem_does_not_name_add_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    other = Process("", "", report="no_such_module:REPORT")
    monkeypatch.setattr(plugins, "installed", {Process: {"other": LoadedPlugin(other, "")}}.__getitem__)
    assert plugin_contributions.process_reports(job.problem()) == ()


def test_the_report_names_no_plug_in_and_no_family() -> None:
    names = {name for group in plugins.BUILT_IN.values() for name in group} - {"targets"}  # a common word
    names |= {family for language in plugins.usable(Language).values() for family in language.families}
    (folder,) = map(Path, report.__path__)
    result = [
        f"{path.name}:{node.lineno}: {node.value}"
        for path in folder.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and node.value in names
    ]
    assert not result
