"""Forming rules: a closed-form job is proven, and each kind of fault is caught by its rule.

The faults are in the programs or in the claims.
"""

from __future__ import annotations

import functools

import numpy as np
import pytest

from planner.claims.segments import Segment
from planner.processes.forming.claims import FollowsOpposite, LimitsToolTilt, SupportsBorder
from planner.proof.prove import Prover
from tests.languages.rapid.rapid_edits import moves, name, segment, shifted, tilted, timed
from tests.processes.forming.proof import forming_job as job
from tests.proof.provers import broken

TASKS = (1, 2)
ROW = 6
MUTANTS = {}


@functools.cache
def prover():
    return Prover(job.problem(), job.claims())


@functools.cache
def clean():
    return prover().prove(job.programs())


def mutant(code):
    def register(function):
        MUTANTS[function.__name__] = (code, function)
        return function

    return register


def forming(rng, texts, proc="form_f1"):
    """A target well within the forming segment."""
    rows = segment(texts, proc)
    return int(rng.integers(rows[len(rows) // 10], rows[-len(rows) // 10]))


def moved(texts, k, by, tasks=TASKS):
    for task in tasks:
        texts = shifted(texts, task, k, np.asarray(by, dtype=float))
    return texts


@mutant("verify.gouge")
def both_deep(rng, texts):
    """Both tools too deep by twice the tolerance at one target; their gap stays."""
    return moved(texts, forming(rng, texts), [0.0, 0.0, -2.5e3 * job.TOLERANCE])


@mutant("verify.gouge")
def a_turn_outwards(rng, texts):
    """Both tools too far out on a part of a turn near the rim, where the wall is steep."""
    rows = segment(texts, "form_f1")
    first = int(rng.integers(10, 120))
    for k in rows[first : first + 10]:
        ray = job.spiral(72)[k - rows[0] + 1] * [1.0, 1.0, 0.0]
        texts = moved(texts, k, 5e3 * job.TOLERANCE * ray / np.linalg.norm(ray))
    return texts


@mutant("verify.gouge")
def out_through_the_wall(rng, texts):
    """The retreat from the sheet leads sideways, through the dish's wall and under the flat sheet."""
    k = segment(texts, "form_f1_out")[0]
    return moved(texts, k, [28.0 * np.sign(rng.normal()), 0.0, -31.0], (1,))


@mutant("verify.gouge")
def past_the_border(rng, texts):
    """The approach starts next to the face and continues below the level of the flat sheet."""
    k = segment(texts, "form_f1_in")[0]
    return moved(texts, k, [25.0, 0.0, -6.0], (1,))


@mutant("verify.formed")
def lifted_turns(rng, texts):
    """The ball is off the face during turns."""
    rows = segment(texts, "form_f1")
    for k in rows[150:250]:
        texts = moved(texts, k, [0.0, 0.0, 0.5])
    return texts


@mutant("verify.formed")
def another_name(rng, texts):
    """A pass that nothing is claimed of."""
    return {file: text.replace("form_f1", "form_f9") for file, text in texts.items()}


@mutant("verify.feature_order")
def misnamed(rng, texts):
    return {file: text.replace("form_f1_in", "form_f1_out_2") for file, text in texts.items()}


@mutant("verify.gap")
def support_back(rng, texts):
    """The support twice the tolerance of the gap too far back at one target."""
    by = 2.5e3 * job.GAP_TOLERANCE * rng.choice([-1.0, 1.0])
    return moved(texts, forming(rng, texts), [0.0, 0.0, by], (2,))


@mutant("verify.gap")
def support_aside(rng, texts):
    """The support turned around the former by twice the allowed angle, at the same distance."""
    rows = segment(texts, "form_f1")
    way = job.centres(72)
    for k in rows[60:70]:
        row = k - rows[0] + 1
        line = way["right"][row] - way["left"][row]
        side = np.cross(line, [0.0, 0.0, 1.0])
        side *= np.linalg.norm(line) / np.linalg.norm(side)
        angle = np.deg2rad(2.0)
        to = way["left"][row] + np.cos(angle) * line + np.sin(angle) * side
        texts = moved(texts, k, 1e3 * (to - way["right"][row]), (2,))
    return texts


@mutant("verify.forming_feed")
def hurried(rng, texts):
    return timed(texts, int(rng.choice(segment(texts, "form_f1")[5:60])), 1.0 / rng.uniform(2.0, 4.0))


@mutant("verify.sheet")
def support_through_the_sheet(rng, texts):
    """The support comes through the sheet."""
    return moved(texts, forming(rng, texts), [0.0, 0.0, rng.uniform(2.0, 6.0)], (2,))


@mutant("verify.sheet")
def into_the_middle(rng, texts):
    """In its first loops the forming ball presses into the middle, where the sheet is still flat."""
    rows = segment(texts, "form_f1")
    k = int(rng.choice(rows[20:60]))
    middle = job.centre_of_sphere() - [0.0, 0.0, job.SPHERE - job.BALL - 0.0005]
    return moved(texts, k, 1e3 * (middle - job.centres(72)["left"][k - rows[0] + 1]), (1,))


@mutant("verify.sheet")
def into_the_wall_beside(rng, texts):
    """The support runs into a wall that is formed already."""
    rows = segment(texts, "form_f1")
    for n, k in enumerate(rows[30:50]):
        texts = moved(texts, k, [70.0 - 3.0 * abs(n - 10), 0.0, -3.0], (2,))
    return texts


def test_clean_programs_are_proven():
    proof = clean()
    assert [str(issue) for issue in proof.issues] == []
    assert proof.ok
    codes = ("gouge", "formed", "gap", "border", "opposite", "sheet", "feature_order", "forming_feed")
    assert all(proof.rule(f"verify.{code}").ran for code in codes)


def test_the_figures_are_those_of_the_closed_form():
    """Ridges between turns: p^2 / 8 (1/R - 1/S) high at the middle between them; chords of the mesh and of
    the moves are what else there is."""
    (face,) = clean().surfaces
    pitch = job.SPHERE * (job.RIM - job.LAST) / job.TURNS
    ridge = pitch**2 / 8.0 * (1.0 / job.BALL - 1.0 / job.SPHERE)
    low = face.points[:, 2] < job.SHEET - 0.001
    high = np.quantile(face.deviation[low & (np.hypot(*face.points[:, :2].T) > 0.004)], 0.98)
    assert high == pytest.approx(ridge, rel=0.15)
    assert clean().rule("verify.gouge").worst < 0.01
    assert clean().rule("verify.gap").worst < 0.015


def faults(kind, seed):
    _, mutate = MUTANTS[kind]
    changed = mutate(np.random.default_rng([len(kind), seed]), job.programs())
    assert changed != job.programs()
    return broken(prover().prove(changed, last=MUTANTS[kind][0]))


@pytest.mark.sampled(every=2)
@pytest.mark.parametrize("kind", MUTANTS)
def test_the_named_rule_catches_the_fault(kind):
    assert MUTANTS[kind][0] in faults(kind, 0)


@pytest.mark.long
@pytest.mark.parametrize("kind", MUTANTS)
def test_more_mutants_are_caught(kind):
    """By any rule: some numbers are also written in a way that is not allowed."""
    assert all(faults(kind, seed) for seed in range(1, 9))


def dropped(texts, rows):
    """Without the targets ``rows`` of both tools."""
    for task in TASKS:
        here = texts[name("Cut1", task)].split("\n")
        places = moves(texts, task)
        gone = {places[k] for k in rows}
        texts = {**texts, name("Cut1", task): "\n".join(row for i, row in enumerate(here) if i not in gone)}
    return texts


def test_a_dropped_stretch_of_targets_is_a_gouge_or_a_lost_gap():
    """Both tools go straight where the dish is round; the moves are as long in time."""
    rows = segment(job.programs(), "form_f1")[40:58]
    texts = timed(dropped(job.programs(), rows), rows[0], 20.0)
    assert "verify.gap" in broken(prover().prove(texts, last="verify.gap"))


def test_a_dropped_turn_between_others_that_leave_the_stated_ridges_is_told():
    """Turns are as far apart along the wall as ridges of the stated height let them be; one is left out."""
    rows = segment(job.programs(), "form_f1")[72 * 4 : 72 * 5]
    proof = prover().prove(dropped(job.programs(), rows), last="verify.formed")
    messages = [issue.message for issue in proof.issues if issue.code == "verify.formed"]
    assert any("the stated steps require a whole loop" in message for message in messages), messages


CLAIMS = {
    "twice": (
        "verify.feature_order",
        {"FormsInOrder": {"segments": (Segment("form", "f1"), Segment("form", "f2"))}},
    ),
    "more of the face": ("verify.formed", {"FormsSheet": {"share": 0.9999}}),
    "a finer scallop": ("verify.formed", {"FormsSheet": {"scallop": np.full(len(job.face()[1]), 2e-5)}}),
    "from below": ("verify.gouge", {"FormsSheet": {"side": -1}}),
    "a larger ball": ("verify.gouge", {"FormsSheet": {"radius": 1.05 * job.BALL}}),
    "a thicker sheet": ("verify.gap", {"ToolGap": {"gap": np.full(len(job.face()[0]), 1.05 * job.SHEET)}}),
    "a line of the tools": ("verify.gap", {"ToolGap": {"turn": -1e-3}}),
    "a slower feed": ("verify.forming_feed", {"FormingFeed": {"upper": 0.01}}),
    "a post in the way": ("verify.sheet", {"SheetState": {"fixed": np.array([[0.0, 0.015, 0.004]])}}),
    "a carried post": ("verify.sheet", {"SheetState": {"carried": np.array([[0.0, 0.015, 0.009]])}}),
    "another segment": ("verify.sheet", {"SheetState": {"segment": Segment("form", "f3")}}),
}


@pytest.mark.sampled(every=3)
@pytest.mark.parametrize("kind", CLAIMS)
def test_programs_that_do_not_meet_a_claim_are_told(kind):
    code, changes = CLAIMS[kind]
    proof = Prover(job.problem(), job.claims(**changes)).prove(job.programs(), last=code)
    assert code in broken(proof)


@pytest.mark.parametrize(("above", "reported"), [(True, False), (False, True)])
def test_tools_stand_as_the_problem_lets_them(above, reported):
    """The forming tool of this job stands upright above the sheet."""
    tilt = LimitsToolTilt(job.SEGMENT, ("left",), (above,), np.deg2rad(0.05))
    proof = Prover(job.problem(), job.claims((tilt,))).prove(job.programs(), last="verify.lean")
    assert ("verify.lean" in broken(proof)) == reported
    rule = proof.rule("verify.lean")
    assert rule.worst == pytest.approx(180.0 if reported else 0.0, abs=1e-2)


def test_nothing_is_formed_unclaimed():
    proof = Prover(job.problem(), {"dish": ()}).prove(job.programs(), last="verify.formed")
    assert {"verify.formed", "verify.feature_order"} <= broken(proof)


def test_a_support_keeps_to_its_border():
    """The border is the support's own way here."""
    border = job.centres(72)["right"]
    more = (SupportsBorder(job.SEGMENT, "right", border, 2e-4),)
    own = Prover(job.problem(), job.claims(more))
    assert "verify.border" not in broken(own.prove(job.programs(), last="verify.border"))
    k = segment(job.programs(), "form_f1")[100]
    changed = moved(job.programs(), k, [0.0, 0.0, -0.5], (2,))
    assert "verify.border" in broken(own.prove(changed, last="verify.border"))
    inner = (
        SupportsBorder(job.SEGMENT, "right", 1.5 * border[:72] * [1, 1, 0] + border[:72] * [0, 0, 1], 0.1),
    )
    other = Prover(job.problem(), job.claims(inner))
    assert "verify.border" in broken(other.prove(job.programs(), last="verify.border"))


@pytest.mark.long
def test_a_tool_that_follows_is_opposite():
    vertices, faces = job.face()
    away = 2.0 * job.BALL + 0.95 * job.SHEET
    face = (job.SEGMENT, job.ARMS, 1, vertices, faces)
    more = (FollowsOpposite(*face, away, 2e-4, np.deg2rad(1.0), np.deg2rad(1.0)),)
    own = Prover(job.problem(), job.claims(more))
    assert "verify.opposite" not in broken(own.prove(job.programs(), last="verify.opposite"))
    k = segment(job.programs(), "form_f1")[100]
    for by in ([0.0, 0.0, -0.5], [0.4, -0.4, 0.0]):
        changed = moved(job.programs(), k, by, (2,))
        assert "verify.opposite" in broken(own.prove(changed, last="verify.opposite"))
    # the tools of the job stand upright, which a negative angle does not allow
    strict = (FollowsOpposite(*face, away, 2e-4, np.deg2rad(1.0), -1e-3),)
    other = Prover(job.problem(), job.claims(strict))
    assert "verify.opposite" in broken(other.prove(job.programs(), last="verify.opposite"))


def test_a_nozzle_that_points_aside_is_told():
    """Turned about its own TCP by 25 degrees the tool still heats the right place, but from elsewhere."""
    vertices, faces = job.face()
    away = 2.0 * job.BALL + 0.95 * job.SHEET
    aim = np.deg2rad(10.0)
    more = (FollowsOpposite(job.SEGMENT, job.ARMS, 1, vertices, faces, away, 2e-4, np.deg2rad(1.0), aim),)
    own = Prover(job.problem(), job.claims(more))
    k = segment(job.programs(), "form_f1")[-40]
    assert "verify.opposite" in broken(own.prove(tilted(job.programs(), 2, k, 25.0), last="verify.opposite"))


@pytest.mark.sampled(every=3)
@pytest.mark.parametrize(("every", "bound", "holds"), [(1, 1e-3, True), (1, 5e-5, False), (10, 1e-3, False)])
def test_two_controllers_a_step_apart_keep_the_gap_within_its_bound(every, bound, holds):
    """A step of s beside a distance D makes sqrt(D^2 + s^2) - D."""
    problem, texts = job.programs_of_two(every)
    claims = job.claims(ToolGap={"handshake": bound})
    proof = Prover(problem, claims).prove(texts, last="verify.gap")
    assert ("verify.gap" in broken(proof)) != holds


def test_the_simulated_part_is_where_the_ball_leaves_the_sheet():
    """The dish is part of a sphere: down to the last loop the sheet stays above it, toward the tool, by
    ridges, and below it nowhere."""
    lines = clean().part_obj.split("\n")
    assert [line for line in lines if line.startswith("o ")] == ["o form_f1"]
    places = np.array([line.split()[1:] for line in lines if line.startswith("v ")], dtype=float) * 1e-3
    expected = job.face()[0]
    assert places.shape == expected.shape
    dish = expected[:, 2] < job.SHEET - 1e-6
    inward = job.SPHERE - np.linalg.norm(places[dish] - job.centre_of_sphere(), axis=1)
    assert inward.min() > -1e-5
    walls = expected[dish, 2] > job.centre_of_sphere()[2] - job.SPHERE * np.cos(job.LAST)
    assert np.quantile(inward[walls], 0.95) < job.SCALLOP
    rim = np.hypot(expected[:, 0], expected[:, 1]) > job.OUTER - 1e-6
    np.testing.assert_allclose(places[rim], expected[rim], atol=6e-8)


def test_the_gap_over_time_is_told():
    """Between two balls that face each other along the sphere's radius, within what is allowed."""
    series = clean().series
    got, low, high = (series[f"gap/1/{what}"] for what in ("got", "low", "high"))
    assert len(got) == len(series["gap/1/time"]) > 50
    assert np.all(np.diff(series["gap/1/time"]) > 0.0)
    assert np.all((low <= got) & (got <= high))
    np.testing.assert_allclose(0.5 * (low + high), got, atol=job.GAP_TOLERANCE)
