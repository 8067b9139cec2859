"""A knife cuts curves with and without corners out of a dish.

The stretches are compared with closed forms. Refusals, programs in RAPID, KRL and URScript, and the faults
that the proof reports are tested.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner import pipeline
from planner.issues import Issue, TandemError
from planner.languages.writing import write
from planner.motion import solve
from planner.processes import registry
from planner.proof.prove import Prover
from planner.tooling import Blade, knife
from tests import urdf_text
from tests.processes.milling.proof.milling_job import in_procedure
from tests.processes.trim.plan.small_trim import KUKA, TRIM, Job, data
from tests.processes.trim.plan.test_proof import TARGET, leant, moved, replaced, timed, without_moves
from tests.small_forming import dish
from tests.small_forming import write as write_forming

KNIFE: dict[str, Any] = {
    "kind": "knife",
    "width_mm": 1.6,
    "end_mm": 0.8,
    "ground_mm": 1.5,
    "blade_mm": 30,
    "body_diameter_mm": 24,
    "length_mm": 220,
}
"""Before its tip it is 0.53 mm wide at the far face of the floor, 1 mm over its tip, and 0.8 mm at the near
one."""
RIM = {"name": "rim", "circle": {"at_mm": [0, 0], "diameter_mm": 72}, "drops": "outside"}
RECT = {"name": "rect", "curve": {"polyline_mm": [[-9, -6, 0], [9, -6, 0], [9, 6, 0], [-9, 6, 0]]}}
MAIN = "operation_1"


def cut(outlines: list[dict[str, Any]], tool: dict[str, Any] | None = None, **fields: Any) -> dict[str, Any]:
    """Return a problem file in which a knife cuts; ``by`` are fields of the knife."""
    by = {"kind": "knife", **fields.pop("by", {})}
    whole = data(tool={**KNIFE, **(tool or {})}, by=by, outlines=outlines, **fields)
    for name in set(TRIM) & {"lead", "pierce"}:
        whole["operations"][0].pop(name)
    return whole


def read(folder: Path, outlines: list[dict[str, Any]], **fields: Any) -> Any:
    return pipeline.load(write_forming(folder, cut(outlines, **fields), dish()))


class KnifeJob(Job):
    """A planned job of a knife, as :class:`Job`."""

    def __init__(self, folder: Path, outlines: list[dict[str, Any]], **fields: Any) -> None:
        self.problem = read(folder, outlines, **fields)
        self.plan = solve.solve(self.problem, [registry.job(self.problem, 0).targets()])
        self.programs = dict(write.program_files(self.plan, self.problem))
        self.prover = Prover(self.problem, registry.claims(self.problem))


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> KnifeJob:
    return KnifeJob(tmp_path_factory.mktemp("knife"), [RIM, RECT], signal="doKnife", by={"start_up_s": 20})


def rotate_tool(degrees: float) -> Callable[[str], str]:
    """Rotate the tool of all targets of a procedure about its own axis."""
    c, s = np.cos(np.deg2rad(0.5 * degrees)), np.sin(np.deg2rad(0.5 * degrees))

    def turn(match: Any) -> str:
        w, x, y, z = (float(match[k]) for k in (4, 5, 6, 7))
        q = (w * c - z * s, x * c + y * s, y * c - x * s, z * c + w * s)
        return f"MoveL [[{match[1]},{match[2]},{match[3]}],[{','.join(f'{v:.8f}' for v in q)}]"

    return lambda text: TARGET.sub(turn, text)


def by(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Callable[[str], str]:
    return moved(lambda p: p + np.array([x, y, z]))


def last(x: float) -> Callable[[str], str]:
    """Moves the last target of a procedure along x [mm]."""

    def put(text: str) -> str:
        lines = text.split("\n")
        row = [k for k, line in enumerate(lines) if "MoveL" in line][-1]
        lines[row] = by(x)(lines[row])
        return "\n".join(lines)

    return put


def not_lifted(text: str) -> str:
    """From the first side of the rectangle straight to the second."""
    return text[: text.index("trim_rect_p1_out;")] + text[text.index("trim_rect_p2;") :]


def swapped(text: str) -> str:
    """Cut the rectangle after the rim around it."""
    first, rim = text.index("trim_rect_p1_in;"), text.index("trim_rim_in;")
    end = text.index("trim_rim_out;") + len("trim_rim_out;")
    return f"{text[:first]}{text[rim:end]}\n    {text[first:rim].rstrip()}{text[end:]}"


FAULTS: dict[str, tuple[str, str, str, Callable[[str], str]]] = {
    "turned by 10 deg": (
        "verify.trim_knife",
        "from its curve inside the sheet",
        "trim_rim",
        rotate_tool(10.0),
    ),
    "turned on a straight side": ("verify.trim_knife", "rotated 10", "trim_rect_p2", rotate_tool(-10.0)),
    "its edge behind": ("verify.trim_knife", "moves backwards", "trim_rim", rotate_tool(180.0)),
    "0.5 mm beside, in the part": ("verify.trim_kept", "0.5", "trim_rect_p1", by(y=-0.5)),
    "0.5 mm beside, in the waste": ("verify.trim_cut", "left uncut", "trim_rect_p1", by(y=0.5)),
    "too shallow": ("verify.trim_knife", "0.20 mm through the sheet", "trim_rim", by(z=0.8)),
    "not through": ("verify.trim_cut", "never through the sheet", "trim_rim", by(z=1.3)),
    "too deep": ("verify.trim_knife", "1.80 mm through the sheet", "trim_rim", by(z=-0.8)),
    "it leans": ("verify.trim_knife", "tilted 9.", "trim_rim", leant(10.0)),
    "not lifted at a corner": ("verify.trim_knife", "it was not lifted out", MAIN, not_lifted),
    "a side left out": ("verify.trim_cut", "left uncut in 1", MAIN, replaced("trim_rect_p2;", "")),
    "not closed": ("verify.trim_cut", "left uncut in 1", "trim_rim", without_moves(slice(-9, None))),
    "an outline left out": ("verify.trim_cut", "rim is not cut", MAIN, replaced("trim_rim;", "")),
    "short of a corner": ("verify.trim_cut", "left uncut in 1", "trim_rect_p1", last(-0.3)),
    "too far past a corner": ("verify.trim_kept", "past a corner", "trim_rect_p1", last(1.5)),
    "the outer curve first": ("verify.trim_order", "rim is started before rect", MAIN, swapped),
    "no drive": ("verify.trim_spindle", "doKnife is not on", MAIN, replaced("SetDO doKnife,1;", "")),
    "its drive not up yet": (
        "verify.trim_spindle",
        "required 20 s",
        MAIN,
        replaced("WaitTime 20;", "WaitTime 2;"),
    ),
    "into the sheet too fast": ("verify.trim_knife", "deeper than at 5 mm/s", "trim_rim", timed(0.2)),
    "too fast along it": ("verify.trim_feed", "allowed 8.00", "trim_rim", timed(0.5)),
    "down too early": ("verify.trim_spindle", "where nothing is cut", "trim_rect_p1_in", by(z=-3.0)),
    "turned on its way out": ("verify.trim_knife", "lifted first", "trim_rect_p1_out", rotate_tool(150.0)),
    "aside on its way out": ("verify.trim_knife", "moves sideways", "trim_rect_p1_out", by(x=20.0)),
    "its body in the sheet": ("verify.trim_clear", "from the sheet", "trim_rim", by(z=-32.0)),
}


def test_the_programs_are_proven(job: KnifeJob) -> None:
    proof = job.prove(job.programs, None)
    assert proof.issues == ()
    assert proof.ok
    text = "".join(job.programs.values())
    assert "doArc" not in text and "doSpindle" not in text
    assert text.count("SetDO doKnife,1;") == 1


@pytest.mark.sampled(every=3)
@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_told_by_the_rule_for_it_with_its_cause(job: KnifeJob, name: str) -> None:
    code, words, procedure, change = FAULTS[name]
    programs = in_procedure(job.programs, procedure, change)
    assert programs != job.programs
    found = [issue.message for issue in job.issues_of(code, programs)]
    assert any(words in message for message in found), found


def rows_of(targets: Any, name: str) -> list[int]:
    return [k for k, s in enumerate(targets.segment) if s.kind == "trim" and s.name == name and not s.phase]


def test_the_blade_stands_along_its_curve_and_is_lifted_at_corners(job: KnifeJob) -> None:
    """By closed forms: a circle of 36 mm radius, and sides of a rectangle."""
    targets = job.plan.operations[0].targets
    pose = targets.pose["robot"]
    tip, ahead = pose[:, :3, 3] / 1e-3, pose[:, :3, 0]
    names = list(dict.fromkeys(s.name for s in targets.segment if s.name))
    assert names == ["rect_p1", "rect_p2", "rect_p3", "rect_p4", "rim"]
    rim = rows_of(targets, "rim")
    np.testing.assert_allclose(np.hypot(*tip[rim, :2].T), 36.0, atol=0.01)
    np.testing.assert_allclose(tip[rim, 2], 1.0 - 1.0 - 1.0, atol=1e-5)  # flat there, through it by 1 mm
    along = np.stack([-tip[rim, 1], tip[rim, 0]], axis=1) / 36.0
    assert (ahead[rim, :2] * along).sum(axis=1).min() > np.cos(np.deg2rad(0.3))
    heading = np.unwrap(np.arctan2(*ahead[rim, 1::-1].T))
    assert abs(heading[-1] - heading[0]) == pytest.approx(2.0 * np.pi, abs=0.05)
    for number, way in enumerate(([1, 0], [0, 1], [-1, 0], [0, -1]), 1):
        side = rows_of(targets, f"rect_p{number}")
        np.testing.assert_allclose(ahead[side], [[*way, 0]] * len(side), atol=1e-9)
    first = rows_of(targets, "rect_p1")
    # in with its back on the corner, out with its far front on the next one, both past it by 0.09 mm
    assert tip[first[0], 0] == pytest.approx(-9.0 + 0.8 - 0.09, abs=1e-6)
    assert tip[first[-1], 0] == pytest.approx(9.0 - 0.8 / 1.5 + 0.09, abs=1e-6)


def test_a_blade_is_turned_back_in_the_air(job: KnifeJob) -> None:
    """No more than 80 deg on one move, the short way to the heading from which the next stretch begins."""
    turn = job.plan.operations[0].targets.pose["robot"][:, :3, :3]
    trace = np.einsum("nij,nij->n", turn[1:], turn[:-1])
    assert np.rad2deg(np.arccos(np.clip(0.5 * (trace - 1.0), -1.0, 1.0))).max() < 81.0


def test_the_report_says_what_is_cut_past_corners(job: KnifeJob) -> None:
    items = {row[0]: row[1] for row in job.plan.operations[0].targets.exhibits["setup"]["items"]}
    # at the near face its front is 0.27 mm farther than at the far one
    assert items["past corners into the part"].startswith("at most 0.36 mm")
    assert items["stretches between lifts"] == "5"
    assert items["output that switches its drive"] == "doKnife, 20 s before it cuts"


SAW = {
    "name": "saw",
    "curve": {
        "polyline_mm": [
            [*(float((14 + k % 2) * f(k * np.pi / 110)) for f in (np.cos, np.sin)), 0.0] for k in range(220)
        ]
    },
}
CASES: dict[str, tuple[dict[str, Any], str, str, dict[str, Any]]] = {
    "a bend too tight for its width": (
        {"outlines": [{**RIM, "drops": "inside"}], "tool": {"width_mm": 8, "end_mm": 5, "ground_mm": 6}},
        "trim.corner",
        "is 0.35 mm off its curve, allowed 0.15 mm",
        {"shape_tol_mm": 0.7},
    ),
    "past a corner": (
        {"outlines": [RECT], "tool": {"width_mm": 4, "end_mm": 1}, "by": {"overcut_mm": 0.2}},
        "trim.corner",
        "the blade cuts 1.09 mm past a corner into the part",
        {"by": {"overcut_mm": 1.1}},
    ),
    "too many corners": (
        {"outlines": [SAW]},
        "trim.corner",
        "would be lifted 220 times, allowed 200",
        {"outlines": [RECT]},
    ),
    "micro-joints without room": (
        {"outlines": [{**RECT, "joints": 12, "joint_mm": 3}]},
        "trim.joints",
        "12 micro-joints of 3 mm",
        {"outlines": [{**RECT, "joints": 2, "joint_mm": 3}]},
    ),
    "a blade too short": (
        {"outlines": [RECT], "tool": {"blade_mm": 2}},
        "trim.tool",
        "the blade of 2 mm does not reach through the sheet, required 3.10 mm",
        {"tool": {"blade_mm": 4}},
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_what_a_knife_cannot_cut_is_refused_and_the_change_helps(tmp_path: Path, name: str) -> None:
    fields, code, words, change = CASES[name]
    with pytest.raises(TandemError) as error:
        registry.job(read(tmp_path, **fields), 0).targets()
    issue = error.value.issues[0]
    assert issue.code == code
    assert words in issue.message
    assert issue.hint
    assert registry.job(read(tmp_path, **{**fields, **change}), 0).targets().count > 10


def test_a_torch_is_no_knife(tmp_path: Path) -> None:
    whole = cut([RECT])
    whole["operations"][0]["by"] = {"kind": "torch"}
    whole["operations"][0]["signal"] = "doArc"
    with pytest.raises(TandemError, match="carries knife, which is not a torch") as error:
        registry.job(pipeline.load(write_forming(tmp_path, whole, dish())), 0).targets()
    assert [issue.code for issue in error.value.issues] == ["trim.tool"]


FIELDS: list[dict[str, Any]] = [
    {"lead": {"length_mm": 3}},
    {"pierce": {"off_mm": 1}},
    {"ok_signal": "diOk"},
    {"least_feed": 0.3},
]


@pytest.mark.parametrize("field", FIELDS)
def test_fields_of_a_torch_are_refused_for_a_knife(tmp_path: Path, field: dict[str, Any]) -> None:
    whole = cut([RECT])
    whole["operations"][0] |= field
    with pytest.raises(TandemError, match="does not apply to a knife"):
        pipeline.load(write_forming(tmp_path, whole, dish()))


def test_only_a_knife_has_no_signal(tmp_path: Path) -> None:
    with pytest.raises(TandemError, match="only a knife that is dragged"):
        pipeline.load(write_forming(tmp_path, data(signal=None), dish()))


def test_sizes_that_make_no_knife_are_refused() -> None:
    blade = Blade(0.6e-3, 3e-3, 1e-3, 2e-3, 20e-3)
    np.testing.assert_allclose(blade.front(np.array([0.0, 1e-3, 2e-3, 5e-3])), [0.0, 1e-3, 2e-3, 2e-3])
    made = knife(blade, (0.02, 0.2), rotation=0.5 * np.pi)
    np.testing.assert_allclose(made.tcp[:3, 0], [0.0, 1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(made.tcp[:3, 3], [0.0, 0.0, 0.2])
    with pytest.raises(ValueError, match="thickness must be above zero"):
        knife(Blade(4e-3, 3e-3, 1e-3, 2e-3, 20e-3))
    with pytest.raises(ValueError, match="is zero exactly"):
        knife(Blade(0.6e-3, 3e-3, 3e-3, 2e-3, 20e-3))
    with pytest.raises(ValueError, match="must fit into the length"):
        knife(blade, (0.02, 0.08))


JOINED = {**RECT, "joints": 2, "joint_mm": 1.2}
"""Six stretches; a circle that is cut in two pieces besides."""


def test_a_kuka_drags_a_knife_along_pieces_and_joints(tmp_path: Path) -> None:
    circle = {"name": "c", "circle": {"at_mm": [0, 0], "diameter_mm": 60}, "drops": "outside"}
    own = KnifeJob(
        tmp_path, [JOINED, circle], arm=KUKA, controller={"dialect": "krc4"}, by={"most_turn_deg": 185}
    )
    assert own.prove(own.programs, None).issues == ()
    names = list(dict.fromkeys(s.name for s in own.plan.operations[0].targets.segment if s.name))
    assert names == [*(f"rect_p{k + 1}" for k in range(6)), "c_p1", "c_p2"]
    (claim,) = (c for c in own.prover.claims["cut"] if hasattr(c, "knife"))
    assert claim.signal == "" and claim.kerf == 0.0


@pytest.mark.long
def test_a_ur_cuts_on_a_wall(tmp_path: Path) -> None:
    (tmp_path / "ur10e.urdf").write_text(urdf_text.ur10e(), "utf-8")
    arm = {"robot": {"urdf": "ur10e.urdf", "name": "ur10e", "family": "ur", "payload_kg": 12.5}}
    wall = {"name": "wall", "curve": {"polyline_mm": [[16, -8, 0], [30, -8, 0], [30, 8, 0], [16, 8, 0]]}}
    whole = cut(
        [wall], arm=arm, controller={"io": {"robot": {"doKnife": 8}}}, signal="doKnife", by={"start_up_s": 20}
    )
    del whole["cell"]["arms"][0]["home_deg"]
    whole["sheet"]["place"] = {"xyz_mm": [700, 0, 300]}
    problem = pipeline.load(write_forming(tmp_path, whole, dish()))
    plan = solve.solve(problem, [registry.job(problem, 0).targets()])
    programs = dict(write.program_files(plan, problem))
    prover = Prover(problem, registry.claims(problem))
    assert prover.prove(programs).issues == ()
    (file,) = programs
    late = programs[file].replace("sleep(20.0)", "sleep(2.0)")
    assert late != programs[file]
    assert "verify.trim_spindle" in {issue.code for issue in prover.prove({file: late}).issues}


def test_an_axis_that_would_turn_on_and_on_is_named(tmp_path: Path) -> None:
    """A knife all around a wall of 40 deg turns axis 4 with it, whose turns end before the curve does."""
    circle = {"name": "c", "circle": {"at_mm": [0, 0], "diameter_mm": 52}}
    whole = cut([circle])
    whole["sheet"]["place"] = {"xyz_mm": [500, 0, 100]}
    problem = pipeline.load(write_forming(tmp_path, whole, dish()))
    with pytest.raises(TandemError) as error:
        solve.solve(problem, [registry.job(problem, 0).targets()])
    issues: list[Issue] = [i for i in error.value.issues if i.code == "motion.no_path"]
    assert len(issues) == 1
    assert "axis 4 of arm robot would have to turn from" in issues[0].message


@pytest.mark.long
def test_an_axis_that_would_jump_is_named(tmp_path: Path) -> None:
    """Axis 6 of a CRB 15000 goes from -180 to 180 deg: no blade goes all around with it."""
    whole = cut([RIM], arm={"robot": "crb15000_5_95"})
    del whole["cell"]["arms"][0]["home_deg"]
    problem = pipeline.load(write_forming(tmp_path, whole, dish()))
    with pytest.raises(TandemError) as error:
        solve.solve(problem, [registry.job(problem, 0).targets()])
    (issue,) = (i for i in error.value.issues if i.code == "motion.no_path")
    assert "axis 6 of arm robot would have to turn beyond its limits and jumps" in issue.message


def test_names_of_stretches_are_not_those_of_outlines(tmp_path: Path) -> None:
    other = {"name": "rect_p2", "circle": {"at_mm": [0, 30], "diameter_mm": 8}}
    with pytest.raises(TandemError, match="rect_p2 is the name of a stretch of rect"):
        registry.job(read(tmp_path, [RECT, other]), 0).targets()
