"""A robot language that an installed package adds: planned, written, read back and proven."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from planner import pipeline
from planner.issues import TandemError
from planner.programs import job, partial
from planner.report.plugin_contributions import reports_by_language
from planner.runtime import plugins
from planner.runtime.plugins import Language, LoadedPlugin
from tests import small_problem
from tests.toys.installation import forget, install
from tests.toys.joint_table import LANGUAGE

FILE = "left/joints.csv"
HEAD, TAIL = small_problem.PROBLEM.split("stock:")
PROBLEM = f"{HEAD}  controller: {{language: joint_table}}\nstock:{TAIL}"
ASK, HOME, IN, WORK, OUT = 5, 6, 7, 9, 13
"""Rows: the question, home, at the first pose, at the third one, and home again."""
SEGMENT, TIME, JOINT = 1, 2, 3
"""Cells of a row of joints."""
Rows = list[list[str]]


@pytest.fixture(scope="module")
def _installed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The language is installed as pip would do it."""
    point = "joint_table = tests.toys.joint_table:LANGUAGE"
    with pytest.MonkeyPatch.context() as path:
        install(path, tmp_path_factory.mktemp("site"), "joint-table", point, kind=Language)
        yield
    forget()


@pytest.fixture(scope="module")
def planned(_installed: None, tmp_path_factory: pytest.TempPathFactory) -> pipeline.Outcome:
    """The small job."""
    return pipeline.plan(pipeline.load(small_problem.write(tmp_path_factory.mktemp("job"), PROBLEM)))


def test_without_the_package_the_field_is_refused(tmp_path: Path) -> None:
    forget()
    with pytest.raises(TandemError) as caught:
        pipeline.load(small_problem.write(tmp_path, PROBLEM))
    (issue,) = caught.value.issues
    assert (issue.code, issue.field) == ("problem.field", "cell.controller.language")


def test_a_job_is_planned_written_and_proven(planned: pipeline.Outcome) -> None:
    assert planned.verified, planned.issues
    assert planned.proof is not None and list(planned.programs) == [FILE]
    found = {rule.code: rule for rule in planned.proof.rules}
    assert found["joint_table.start"].passed and found["verify.follows"].passed
    straight = found["joint_table.straight"]
    assert straight.worst is not None and 0.05 < straight.worst < 0.2
    assert pipeline.verify(planned.problem, planned.programs).ok
    ((sheet, arms),) = reports_by_language(planned.problem.cell.arms)
    assert sheet.programs(planned.problem, arms) == [("joint table of left", "cubics from rest to rest")]


def put(row: int, cell: int, text: str) -> Callable[[Rows], object]:
    """Write another text into a cell."""
    return lambda rows: rows[row].__setitem__(cell, text)


MUTANTS: dict[str, tuple[Callable[[Rows], object], set[str]]] = {
    "another problem": (put(0, 1, 64 * "0"), {"verify.digest"}),
    "no problem": (put(0, 1, ""), {"verify.digest"}),
    "another base": (put(2, 1, "5.00000000"), {"verify.base_frames", "verify.follows"}),
    "another mass": (put(3, 9, "0.10000000"), {"verify.tool_data"}),
    "another block": (put(4, 1, "460.00000000"), {"verify.work_object"}),
    "no question": (lambda rows: rows.pop(ASK), {"verify.setup", "verify.dialogue"}),
    "another question": (put(ASK, 1, "Ready?"), {"verify.dialogue"}),
    "a joint off at home": (put(HOME, JOINT, "1.00000000"), {"joint_table.start"}),
    "a joint off in work": (put(WORK, JOINT, "-1.22000000"), {"verify.follows"}),
    "a joint off at the end": (put(OUT, JOINT, "1.00000000"), {"verify.continuity"}),
    "a pose left out": (lambda rows: rows.pop(WORK), {"verify.follows", "joint_table.straight"}),
    "the way home left out": (lambda rows: rows.pop(OUT), {"verify.continuity"}),
    "too short a way": (
        put(IN, TIME, "0.30000"),
        {"verify.joint_speed", "verify.joint_acceleration", "verify.tcp_speed"},
    ),
    "too short a time in work": (put(WORK, TIME, "3.00000"), {"verify.follows"}),
    "times that do not ascend": (put(WORK, TIME, "0.30000"), {"verify.syntax", "verify.digest"}),
    "no number": (put(WORK, JOINT, "nan"), {"verify.syntax", "verify.digest"}),
    "an unknown row": (put(WORK, 0, "spline"), {"verify.syntax", "verify.digest"}),
}


@pytest.mark.parametrize("name", MUTANTS)
def test_a_table_with_a_fault_is_refused(planned: pipeline.Outcome, name: str) -> None:
    fault, codes = MUTANTS[name]
    rows = [row.split(",") for row in planned.programs[FILE].splitlines()]
    fault(rows)
    text = "".join(f"{','.join(row)}\r\n" for row in rows)
    assert {issue.code for issue in pipeline.verify(planned.problem, {FILE: text}).issues} == codes


def test_two_tables_of_one_arm_are_refused(planned: pipeline.Outcome) -> None:
    programs = {FILE: planned.programs[FILE], "left/more.csv": planned.programs[FILE]}
    assert "verify.syntax" in {issue.code for issue in pipeline.verify(planned.problem, programs).issues}


@pytest.mark.usefixtures("_installed")
def test_what_has_no_row_is_refused(tmp_path: Path) -> None:
    more = PROBLEM.replace("frame: world}", "frame: world, setup: {note: Wipe it.}}")
    with pytest.raises(TandemError) as caught:
        pipeline.plan(pipeline.load(small_problem.write(tmp_path, more)))
    (issue,) = caught.value.issues
    assert (issue.code, issue.message) == ("joint_table.job", "joint tables have no rows for setups")


TRACK = "{axis: [0, 1, 0], range_mm: [-500, 500], unit: RAIL, speed_mm_s: 500, acceleration_mm_s2: 500}"
SECOND = """    - name: right
      robot: irb140
      tool: {kind: wire_holder, mounting: along, side: start}
      base: {xyz_mm: [900, 0, 0], rpy_deg: [0, 0, 180]}
      home_deg: [0, 0, 0, 0, 45, 0]
"""


@pytest.mark.usefixtures("_installed")
@pytest.mark.parametrize("sync", ["multimove", "handshake"])
def test_two_arms_in_one_job_are_refused(tmp_path: Path, sync: str) -> None:
    text = PROBLEM.replace("  controller: {", f"{SECOND}  controller: {{sync: {sync}, ")
    text += "  - {name: more, process: targets, arms: [right], file: right.csv, frame: world}\n"
    table = (small_problem.COLUMNS.replace("left", "right"), *small_problem.ROWS)
    (tmp_path / "right.csv").write_text("\n".join(table) + "\n")
    found = pipeline.check(pipeline.load(small_problem.write(tmp_path, text)))
    assert "post.controller" in {issue.code for issue in found}


@pytest.mark.usefixtures("_installed")
@pytest.mark.parametrize(
    ("original", "after", "field"),
    [
        ("joint_table}", "joint_table, joint_prefix: {left: a_}}", "cell.controller.joint_prefix"),
        ("joint_table}", "joint_tables}", "cell.controller.language"),
        ("joint_table}", "rapid}", "cell.controller.language"),
        ("home_deg:", f"track: {TRACK}\n      home_deg:", "cell.arms.0.track"),
    ],
)
def test_other_options_of_the_controller_fit_or_are_refused(
    tmp_path: Path, original: str, after: str, field: str
) -> None:
    with pytest.raises(TandemError) as caught:
        pipeline.load(small_problem.write(tmp_path, PROBLEM.replace(original, after)))
    assert [(issue.code, issue.field) for issue in caught.value.issues] == [("problem.field", field)]


@pytest.mark.parametrize("more", ["", "up\n"])
def test_it_is_read_as_a_whole_or_not_at_all_without_a_reader_of_parts(
    planned: pipeline.Outcome, more: str
) -> None:
    text = planned.programs[FILE] + more
    assert job.read_job(planned.problem, {FILE: text, "a.mod": ""}).strays == ("a.mod",)
    (one,), strays = partial.read_partial(planned.problem, {"anywhere/a.csv": text})
    assert not strays
    assert [fault.line for fault in one.unread] == ([15] if more else [])
    assert len(one.path) == (0 if more else 7)


def test_a_reader_that_cannot_be_loaded_is_refused(
    planned: pipeline.Outcome, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = dataclasses.replace(LANGUAGE, reader="tests.toys.joint_table:LANGUAGE")
    found = {**plugins.installed(Language), "joint_table": LoadedPlugin(broken, "package joint-table")}
    monkeypatch.setattr(plugins, "installed", lambda kind: found)
    with pytest.raises(TandemError, match="the reader of joint tables is Language") as caught:
        job.read_job(planned.problem, planned.programs)
    assert caught.value.issues[0].code == "post.language"
