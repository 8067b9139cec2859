"""A cell of two arms with a controller each, and a job that needs one of them: its program has no meeting."""

from __future__ import annotations

import csv

import pytest
import yaml

from planner import pipeline
from planner.proof.context import Context
from planner.proof.rules import handshake
from planner.report import setup_sheet
from tests.proof import planner_jobs

LINES = ("doPartner", "diPartner", "doRunning", "diPartnerRunning", "doMoveEnable")
KRL_IO = {
    arm: {name: first + i for i, name in enumerate(LINES)} for arm, first in (("left", 1), ("right", 11))
}
EXTRA_STATEMENT = {
    "abb": ("left/TandemMain_1.mod", "    MoveAbsJ ", "    SetDO doPartner,1;\n"),
    "kuka": ("left/poses.src", "PTP ", "$OUT[1]=TRUE\n"),
    "ur": ("left/poses.script", "movej(", "set_standard_digital_out(0,True)\n"),
}
"""A file of the program, what a row begins with, and a row ahead of it that sets a line to the other one."""


def problem_of(folder, family):
    """Poses for two arms. Only the left one has to pass its poses."""
    path = planner_jobs.posed(folder, 2, handshake=True, ur=family == "ur")
    data = yaml.safe_load(path.read_text("utf-8"))
    (operation,) = data["operations"]
    operation |= {"arms": ["left"], "free": operation["free"][:1]}
    if family == "kuka":
        for arm in data["cell"]["arms"]:
            arm |= {"robot": "kr10_r1100", "home_deg": planner_jobs.KUKA_HOME}
        data["cell"]["controller"] |= {"dialect": "krc4", "io": KRL_IO}
    path.write_text(yaml.safe_dump(data), "utf-8")
    table = folder / "targets.csv"
    rows = list(csv.reader(table.read_text("utf-8").splitlines()))
    own = [i for i, name in enumerate(rows[0]) if not name.startswith("right.")]
    table.write_text("".join(",".join(row[i] for i in own) + "\n" for row in rows), "utf-8")
    return pipeline.load(path)


@pytest.mark.parametrize("family", ["abb", "kuka", "ur"])
def test_one_arm_of_two_controllers_works_alone(tmp_path, family):
    problem = problem_of(tmp_path, family)
    outcome = pipeline.plan(problem)
    assert [str(issue) for issue in outcome.proof.issues] == []
    assert outcome.proof.ok
    assert {path.split("/")[0] for path in outcome.programs} == {"left"}
    sheet = str(setup_sheet.controller_checks(problem, outcome.plan))
    assert "right meanwhile" in sheet and "doPartner" not in sheet
    file, begins, row = EXTRA_STATEMENT[family]
    text = outcome.programs[file].replace("\r\n", "\n")
    meets = {**outcome.programs, file: text.replace(f"\n{begins}", f"\n{row}{begins}", 1)}
    assert meets[file] != text
    context = Context(problem, {}, meets)
    assert context.is_readable
    assert "no other program answers this signal" in str(handshake.handshake(context).issues)
