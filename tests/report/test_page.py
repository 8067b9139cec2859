"""The report: complete, offline, readable without a plan, and true to its input."""

from __future__ import annotations

import dataclasses
import re
from html.parser import HTMLParser
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from planner.catalogue import robots
from planner.cell import kinematics
from planner.issues import Issue, Severity
from planner.plans import Plan
from planner.problem import Problem
from planner.proof.verdict import Proof, RuleResult
from planner.report import markup, motion_charts, output, page_sections, setup_sheet
from planner.report.output import ReportExtras
from tests.languages.writing import krl_job
from tests.processes.hotwire.proof import straight_job
from tests.report import synthetic_job as job

VOID = {"meta", "img", "br", "link", "input"}


class Balance(HTMLParser):
    """Checks that tags close in order, and gathers addresses and anchors."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.addresses: list[str] = []
        self.anchors: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name in ("src", "href") and value:
                self.addresses.append(value)
            if name == "id" and value:
                self.anchors.append(value)
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open and self.open[-1] == tag, f"</{tag}> closes {self.open[-1:]}"
        self.open.pop()


@pytest.fixture(scope="module")
def problem() -> Problem:
    return job.problem()


@pytest.fixture(scope="module")
def plan() -> Plan:
    return job.plan(60)


@pytest.fixture(scope="module")
def proof() -> Proof:
    return job.proof(400)


@pytest.fixture(scope="module")
def files(problem: Problem, plan: Plan, proof: Proof) -> dict[str, str]:
    return output.files(problem, plan, proof)


def _check_markup(text: str) -> Balance:
    seen = Balance()
    seen.feed(text)
    assert seen.open == []
    for address in seen.addresses:
        assert address.startswith(("data:", "#")), address
        if address.startswith("#"):
            assert address[1:] in seen.anchors
    assert len(seen.anchors) == len(set(seen.anchors))
    assert "@import" not in text and not re.search(r"url\(\s*['\"]?http", text)
    for svg in re.findall(r'<svg class="(?:chart|plot)".*?</svg>(?=<|$)', text, re.S):
        if svg.count("<svg") == svg.count("</svg>"):
            ET.fromstring(svg)
    assert "nan" not in re.sub(r"base64,[A-Za-z0-9+/=]+", "", text).lower().replace("nanum", "")
    return seen


def test_report_is_whole_offline_and_has_every_part(files: dict[str, str]) -> None:
    seen = _check_markup(files["report.html"])
    parts = (
        "issues",
        "cell",
        "part",
        "process0",
        "motion",
        "joints",
        "setup",
        "proof",
        "placement",
        "times",
        "filter",
    )
    assert set(parts) <= set(seen.anchors)
    assert len(files["report.html"]) < 3_000_000


def test_contents_lead_to_the_sections_that_have_something_in_them() -> None:
    full = markup.PageSection("a", "First & best", (markup.Paragraph("1 < 2"),))
    empty = markup.PageSection("b", "Nothing", ())
    text = markup.page_html(markup.Page("title", "name", (("ok", "good"),), None, (), (full, empty)))
    _check_markup(text)
    assert '<nav><a href="#a">First &amp; best</a></nav>' in text and "Nothing" not in text


def test_a_photo_is_found_again_in_a_page() -> None:
    address = markup.png(np.zeros((2, 3, 3)))
    text = markup.render(markup.BlockGroup((markup.Paragraph("x"), markup.Photo(address, "a & b"))))
    result = markup.extract_photo(text, "a & b")
    assert result is not None and result.startswith(b"\x89PNG")
    assert markup.extract_photo(text, "another") is None


def test_same_plan_same_page(problem: Problem, plan: Plan, proof: Proof) -> None:
    assert output.report_html(problem, plan, proof) == output.report_html(problem, plan, proof)


def test_rules_without_anything_to_ask_are_folded_and_not_counted(
    problem: Problem, plan: Plan, proof: Proof
) -> None:
    silent = RuleResult("verify.milled", "The face is milled", True, where="nothing is milled", applies=False)
    with_it = dataclasses.replace(proof, rules=(*proof.rules, silent))
    text = output.report_html(problem, plan, with_it)
    shown, folded = text.split("1 more rule does not apply")[0], text.split("1 more rule does not apply")[1]
    assert "nothing is milled" not in shown
    assert "nothing is milled" in folded.split("</details>")[0]
    assert with_it.rule_counts == (*proof.rule_counts[:2], 1)


def test_figures_at_a_glance_are_those_of_the_proof(
    files: dict[str, str], problem: Problem, plan: Plan
) -> None:
    tiles = dict(re.findall(r"<b>([^<]*)<small>[^<]*</small></b><span>([^<]*)</span>", files["report.html"]))
    by_name = {name: value for value, name in tiles.items()}
    assert by_name["targets"] == str(plan.operations[0].targets.count)
    assert by_name["wire, hot length"] == "640.0"
    assert by_name["rules held"] == "2"
    motion = motion_charts.motion_series(problem, plan, None)
    robot = robots.robot("irb140")
    margin = min(robot.limit_margin(plan.operations[0].q[arm]).min() for arm in job.ARMS)
    got = min(arm.limit_margin.min() for arm in motion.arms.values())
    assert got == pytest.approx(margin, abs=1e-12)


@pytest.mark.parametrize(
    ("ok", "issues", "word"), [(True, (), "Planned and proven"), (False, (), "Proof failed: no programs")]
)
def test_verdict(
    problem: Problem, plan: Plan, proof: Proof, ok: bool, issues: tuple[Issue, ...], word: str
) -> None:
    rules = tuple(dataclasses.replace(rule, passed=ok or rule.passed) for rule in proof.rules)
    given = dataclasses.replace(proof, rules=rules, issues=issues)
    assert f">{word}</span>" in output.report_html(problem, plan, given)


def test_without_proof_the_plan_speaks(problem: Problem, plan: Plan) -> None:
    text = output.report_html(problem, plan, None)
    _check_markup(text)
    assert "Planned, not proven" in text and "the plan&#x27;s targets" in text


def test_failure_shows_issues_and_the_cell(problem: Problem, proof: Proof) -> None:
    text = output.failure_report(problem, proof.issues)
    seen = _check_markup(text)
    assert {"issues", "cell"} <= set(seen.anchors) and "No plan" in text
    assert "move the stock or ask for less clearance" in text


def test_a_refused_problem_has_a_report_too() -> None:
    issue = Issue(
        "problem.field",
        "stock.size_mm is -3; it must be positive",
        file="p.yaml",
        line=7,
        field="stock.size_mm",
    )
    text = output.failure_report(None, (issue,))
    _check_markup(text)
    assert "p.yaml, line 7" in text and "The problem was refused" in text


def test_text_of_others_is_escaped(problem: Problem, plan: Plan) -> None:
    bad = "<script>alert(1)</script>"
    named = dataclasses.replace(problem, name=bad)
    issue = Issue(
        "problem.field", bad, Severity.NOTE, hint=bad, field=bad, bodies=(bad,), unit=bad, value=1.0
    )
    text = output.report_html(
        named, plan, None, ReportExtras(issues=(issue,), filtered=((bad, bad, bad),), programs=((bad, 1),))
    )
    assert bad not in text
    _check_markup(text)


def test_setup_sheet_states_where_the_tcps_are_at_the_mount(
    files: dict[str, str], problem: Problem, plan: Plan
) -> None:
    for arm in problem.cell.arms:
        q = plan.operations[0].q[arm.name][0]
        tcp = arm.base @ kinematics.forward_kinematics(robots.robot(arm.robot), q) @ arm.tool.tcp
        place = ", ".join(f"{v * 1e3:.2f}" for v in tcp[:3, 3]).replace("-0.00", "0.00").replace("-", "−")
        assert place in files["report.html"]
    assert "600.00 mm" in files["report.html"]  # the clamps stand 0.6 m apart in the synthetic job
    assert "Kanthal D, 1.2 mm" in files["report.html"] and "638.2 mm" in files["report.html"]


def test_joint_speeds_from_a_plan_are_steps_over_time(problem: Problem, plan: Plan) -> None:
    operation = plan.operations[0]
    steady = {arm: np.outer(operation.time, np.arange(1.0, 7.0)) * 0.01 for arm in job.ARMS}
    made = dataclasses.replace(plan, operations=(dataclasses.replace(operation, q=steady),))
    motion = motion_charts.motion_series(problem, made, None)
    for arm in job.ARMS:
        np.testing.assert_allclose(
            motion.arms[arm].speed[1:], np.tile(np.arange(1.0, 7.0) * 0.01, (len(operation.time) - 1, 1))
        )


def test_wrist_angle_is_zero_where_axes_4_and_6_are_in_line(problem: Problem, plan: Plan) -> None:
    motion = motion_charts.motion_series(problem, plan, None)
    arm = motion.arms["left"]
    q = np.zeros((3, 6))
    q[:, 4] = [0.0, 0.3, np.pi - 0.2]
    got = dataclasses.replace(arm, time=np.arange(3.0), q=q, speed=q).wrist_angle
    np.testing.assert_allclose(got, [0.0, 0.3, 0.2], atol=1e-12)


def test_setup_sheet_names_the_wires_between_two_controllers(problem: Problem, plan: Plan) -> None:
    assert "wires between the controllers" not in markup.render(setup_sheet.build_sheet(problem, plan))
    controller = dataclasses.replace(problem.cell.controller, sync="handshake")
    apart = dataclasses.replace(problem, cell=dataclasses.replace(problem.cell, controller=controller))
    assert "doPartner of left to diPartner of right" in markup.render(setup_sheet.build_sheet(apart, plan))


def test_setup_sheet_asks_what_a_ur_controller_has_to_be_set_to() -> None:
    plan, problem = straight_job.plan(6, model="ur10e"), straight_job.problem("ur10e")
    shown = re.sub(r"<[^>]+>", " ", markup.render(setup_sheet.controller_checks(problem, plan)))
    assert "doWirePower is configurable output 1, in Installation, I/O" in shown
    assert "low when the program does not run" in shown and "SoftES" not in shown
    whole = markup.render(setup_sheet.build_sheet(problem, plan))
    assert "URScript of left" in whole and "doWirePower is number 9" in whole


@pytest.mark.parametrize(
    ("models", "brand_index"), [(("irb140", "kr10_r1100"), 0), (("kr10_r1100", "irb140"), 1)]
)
def test_setup_sheet_asks_for_the_running_wires_and_their_files(
    models: tuple[str, str], brand_index: int
) -> None:
    plan, problem = krl_job.two(models, actions=krl_job.ACTIONS)
    shown = re.sub(r"<[^>]+>", " ", markup.render(setup_sheet.controller_checks(problem, plan)))
    for arm, other in (("left", "right"), ("right", "left")):
        assert f"wire: doPartner of {arm} to diPartner of {other}" in shown
        wire = shown.partition(f"running wire: doRunning of {arm} to diPartnerRunning of {other}")[2]
        tried = wire.partition(" then ")[0]
        assert f"arm {other} stops at once" in tried
        assert ("its power switches off" in tried) == (other == "left")
    files = [["EIO.cfg, SYS.cfg and TandemPower.sys", "config_user.dat and sps_user.sub"],
             ["EIO.cfg", "config_user.dat, sps_user.sub and ir_stopm_user.src"]][brand_index]  # fmt: skip
    abb, kuka = ("left", "right")[:: 1 - 2 * brand_index]
    assert f"{files[0]} of programs/controller/{abb}" in shown
    assert f"{files[1]} of programs/controller/{kuka}" in shown
    assert "doRunning is wired" in shown and "NO DEVICE stated, so the wire is dead" in shown
    assert "$OUT[3] doMoveEnable" in shown


def test_setup_sheet_says_what_the_controllers_need(problem: Problem, plan: Plan) -> None:
    shown = markup.render(setup_sheet.build_sheet(problem, plan))
    for words in (
        "EIO.cfg, SYS.cfg and TandemPower.sys",
        "SoftES",
        "CAB_REGAIN_DIST",
        "PP to main in all tasks",
    ):
        assert words in shown
    assert "NO DEVICE stated" in shown and "reduced speed" in shown
    assert "ModalPayLoadMode" not in shown


def test_setup_sheet_names_what_a_kuka_controller_must_have(problem: Problem, plan: Plan) -> None:
    controller = dataclasses.replace(problem.cell.controller, io={"left": {"doSpindle": 17}}, dialect="krc2")
    arms = (dataclasses.replace(problem.cell.arms[0], robot="kr60_ha"), *problem.cell.arms[1:])
    cell = dataclasses.replace(problem.cell, controller=controller, arms=arms)
    shown = markup.render(setup_sheet.build_sheet(dataclasses.replace(problem, cell=cell), plan))
    assert "KRL of left" in shown
    assert "KRC2; $ROBROOT zero; doSpindle is number 17" in shown
    assert "right: T_ROB2" in shown
    assert "left: T_ROB1" not in shown


def test_setup_sheet_speaks_of_hot_wires_where_there_are_some(problem: Problem, plan: Plan) -> None:
    assert "while the wire is hot" in markup.render(setup_sheet.build_sheet(problem, plan))
    (own,) = problem.operations
    milled = dataclasses.replace(problem, operations=(dataclasses.replace(own, process="milling"),))
    shown = markup.render(setup_sheet.build_sheet(milled, plan))
    assert "TandemPower.sys" in shown and "while the wire is hot" not in shown


def test_figures_of_a_plan_have_units() -> None:
    metrics = {"program_windows": 3, "program_targets": 120, "ladder_time": 1.5, "path_deviation_mm": 0.05}
    plan = job.plan()
    own = dataclasses.replace(plan.operations[0], metrics=metrics)
    html = markup.render(page_sections.planning_details(dataclasses.replace(plan, operations=(own,)), ()))
    rows = re.findall(r"<tr><td>(.*?)</td><td[^>]*>(.*?)</td><td[^>]*>(.*?)</td></tr>", html)
    result = {re.sub("<.*?>", "", name): re.sub("<.*?>", "", unit) for name, _, unit in rows}
    assert result["program windows"] == "windows"
    assert result["program targets"] == "targets"
    assert result["ladder time"] == "s"
    assert result["path deviation"] == "mm"
