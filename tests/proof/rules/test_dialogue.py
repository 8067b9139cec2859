"""Messages and questions of programs are refused unless they match the problem word for word."""

from __future__ import annotations

import re

import numpy as np
import pytest
import yaml

import planner
from planner.claims import sentences
from planner.claims.claim import OneOf
from planner.languages.writing import write
from planner.motion import solve
from planner.processes import registry
from planner.processes.hotwire.claims import WireJoins
from planner.proof.context import Context
from planner.proof.dialogue import with_chosen_groups
from planner.proof.prove import Prover
from tests import line_ends
from tests.languages.krl.reader.wall_program import MAIN as MAIN_KRL
from tests.languages.krl.reader.wall_program import WAIT, read
from tests.processes.milling.plan import small_mill
from tests.proof import dialogue_job, planner_jobs, small_job
from tests.proof.dialogue_mutants import KRL, LIES, RAPID, main_of
from tests.proof.dialogue_proofs import CODE, JOBS, faults, prover

SAMPLE, FULL = 2, 12


def missed(job, kinds, each, seed):
    """Mutants that no rule has seen, and how many were tried."""
    programs = JOBS[job][2]()
    out, tried, named = [], 0, 0
    for n, (name, mutate) in enumerate(kinds.items()):
        for k in range(each):
            mutant = mutate(np.random.default_rng([seed, n, k]), dict(programs))
            assert mutant != programs, (name, k)
            found = faults(job, mutant)
            tried += 1
            named += any(issue.code == CODE for issue in found)
            out += [] if found else [(name, k)]
    return out, tried, named


SHOWN = re.compile(r'(?<=Msg_txt\[\] ")[^"%]+(?=")')


@pytest.mark.parametrize("rewrite", ["figure", "opposite", "other"])
def test_each_text_of_a_dialog_is_held_word_for_word(rewrite):
    """Every text on the panel of a krc4 controller, the states and the look at the foot aside."""
    programs = JOBS["dialogs"][2]()
    file = next(file for file in programs if file.endswith("straight.src"))
    text, tried = programs[file], 0
    for found in SHOWN.finditer(text):
        own = found.group()
        if "spacers" in own or (rewrite == "figure" and not re.search(r"\d", own)):
            continue  # how thick spacers are is for the rule on figures of the motion
        new = {
            "figure": re.sub(r"\d", lambda m: str((int(m[0]) + 3) % 10), own, count=1),
            "opposite": own.replace("?", ", not yet?") if "?" in own else f"{own[:-1]}not",
            "other": "Have a look at the cell?",
        }[rewrite]
        tried += 1
        assert faults("dialogs", {**programs, file: text[: found.start()] + new + text[found.end() :]})
    assert tried >= (2 if rewrite == "figure" else 6)


@pytest.mark.parametrize("job", JOBS)
def test_clean_programs_are_proven(job):
    assert faults(job, JOBS[job][2]()) == ()


@pytest.mark.parametrize(("job", "kinds"), [("bent", RAPID), ("choice", RAPID), ("bow", RAPID), ("krl", KRL)])
def test_mutants_are_caught(job, kinds):
    out, tried, named = missed(job, kinds, SAMPLE, 1)
    assert out == [] and tried >= 16
    assert named >= 0.6 * tried  # by the rule that is for it


@pytest.mark.long
@pytest.mark.parametrize(("job", "kinds"), [("bent", RAPID), ("choice", RAPID), ("bow", RAPID), ("krl", KRL)])
def test_many_mutants_are_caught(job, kinds):
    out, tried, _ = missed(job, kinds, FULL, 7)
    assert out == [] and tried >= 8 * FULL


# ---- what the problem leaves open ----


NAMED, COLD = "spring_steel 1.5 mm round", "493.2 mm"


def test_the_proof_is_of_the_wire_that_the_operator_is_told_to_mount():
    programs = dialogue_job.choice_programs()
    context = Context(small_job.problem(), dialogue_job.choice_claims(), programs)
    assert [type(claim) for claim in context.claims] == [OneOf]
    told = with_chosen_groups(context)
    assert told.dialogue_issues == ()
    assert [wire.length for wire in told.claims_of(WireJoins)] == [pytest.approx(small_job.LENGTH)]
    longer = edit(programs, COLD, "513.2 mm")
    told = with_chosen_groups(Context(small_job.problem(), dialogue_job.choice_claims(), longer))
    assert [wire.length for wire in told.claims_of(WireJoins)] == [pytest.approx(small_job.LENGTH + 0.02)]
    assert [issue.code for issue in faults("choice", longer)] == [CODE]  # it is locked at another length


def test_another_wire_at_hand_that_is_told_all_through_does_not_go_with_the_motion():
    """Each text is true of the longer wire, but the arms move the shorter one."""
    programs = edit(dialogue_job.choice_programs(), COLD, "513.2 mm")
    hot = f"{1e3 * small_job.LENGTH:.1f} mm hot"
    programs = edit(programs, hot, f"{1e3 * small_job.LENGTH + 20.0:.1f} mm hot")
    assert faults("choice", programs) == ()
    proof = prover("choice").prove(programs, first_error=True)
    assert not proof.ok
    assert proof.issues[0].code in (
        "verify.surface",
        "verify.contact",
        "verify.wire_length",
        "verify.stop_in_foam",
    )


@pytest.mark.parametrize(
    ("old", "new"),
    [(NAMED, "spring_steel 2 mm round"), (NAMED, "kanthal_d 1.5 mm round"), (COLD, "493.3 mm")],
)
def test_a_wire_that_is_not_at_hand_is_refused(old, new):
    found = faults("choice", edit(dialogue_job.choice_programs(), old, new))
    assert any(issue.code == CODE and "name none of the items to mount" in issue.message for issue in found)


def test_wires_that_a_text_cannot_tell_apart_are_refused():
    (choice,) = dialogue_job.choice_claims()["panel"]
    twice = {"panel": (OneOf((choice.either[1], choice.either[1])),)}
    context = with_chosen_groups(Context(small_job.problem(), twice, dialogue_job.choice_programs()))
    assert ["more than one" in issue.message for issue in context.dialogue_issues] == [True]


# ---- what was accepted before ----


def edit(texts, old, new, file=None):
    """Texts with ``old`` replaced once."""
    file = file or next(name for name, text in texts.items() if old in text)
    assert texts[file].count(old) >= 1, old
    return {**texts, file: texts[file].replace(old, new, 1)}


def shown(text):
    return f'    TPWrite "{text}";'


def box(text, more=""):
    return f'    UIMsgBox\\Header:="Tandem","{text}"\\Buttons:=btnOK{more};'


MAIN, OTHER = "T_ROB1/TandemMain_1.mod", "T_ROB2/TandemMain_2.mod"
FIRST_BOX = 'UIMsgBox\\Header:="Tandem","Wire clamped'
ATTACKS = {
    "another wire": (
        "bent",
        "493.2",
        "693.2",
        "other figures: cold_mm is 693.2, expected by the problem 493.2",
    ),
    "not taken up": ("bent", "Slide taken up to 500.0", "Slide taken up to 510.0", "hot_mm is 510.0"),
    "ten times the power": ("bow", "78 W", "780 W", "power_w is 780, expected by the problem 78"),
    "the opposite": (
        "bent",
        "slide free, block fixed",
        "slide locked, block fixed",
        "differs from what is expected",
    ),
    "another question": (
        "bow",
        "Wire taut, block fixed, nobody in the cell?",
        LIES[1],
        "differs from what is expected",
    ),
    "no time to answer": ("bow", "\\Icon:=iconInfo", "\\Icon:=iconInfo\\MaxTime:=1", "without a press of OK"),
    "hands at once": (
        "bow",
        "WaitTime 10;",
        shown(LIES[0]).strip() + " WaitTime 10;",
        "is not expected before",
    ),
    "no cooling": ("bent", "    WaitTime 30;", "", "appears where a wait of 30 s"),
    "short cooling": ("bent", "WaitTime 30;", "WaitTime 0.01;", "expected: a wait of 30 s"),
    "an hour of heat": ("bent", "WaitTime 10;", "WaitTime 3600;", "expected: a wait of 10 s"),
    "while an arm moves": (
        "bent",
        "MoveAbsJ j_1_entry_1",
        shown(LIES[3]).strip() + " MoveAbsJ j_1_entry_1",
        "is not expected before",
    ),
    "erased": ("bent", FIRST_BOX, "TPErase; " + FIRST_BOX, "TPErase"),
    "in the handler": (
        "bow",
        'TPWrite "Check the arm',
        shown(LIES[2]).strip() + ' TPWrite "Check the arm',
        "shows",
    ),
    "after the start": (
        "bow",
        "    operation_1;",
        box(LIES[1]) + "\n    operation_1;",
        "is not expected before",
    ),
}


@pytest.mark.parametrize("name", ATTACKS)
def test_attacks_are_refused_with_a_true_word(name):
    job, old, new, word = ATTACKS[name]
    issues = faults(job, edit(JOBS[job][2](), old, new))
    messages = [issue.message for issue in issues if issue.code == CODE]
    assert messages and any(word in message for message in messages), messages


def test_a_question_by_the_other_task_is_refused():
    texts = JOBS["bent"][2]()
    rows = texts[MAIN].split("\n")
    i = next(k for k, row in enumerate(rows) if "Wire clamped" in row)
    last = next(k for k in range(i, len(rows)) if rows[k].rstrip().endswith(";"))
    own = "\n".join(rows[i : last + 1])
    meets = re.findall(r"WaitSyncTask (meet_\d+)", "\n".join(rows[last:]))
    texts = edit(texts, own + "\n", "", MAIN)
    texts = edit(texts, f"    WaitSyncTask {meets[0]}", f"{own}\n    WaitSyncTask {meets[0]}", OTHER)
    messages = [issue.message for issue in faults("bent", texts)]
    assert any("it belongs to task T_ROB1" in message for message in messages), messages


def test_undo_says_nothing():
    texts = edit(JOBS["bent"][2](), "SyncMoveUndo;", f"{shown(LIES[2]).strip()} SyncMoveUndo;", MAIN)
    assert any("UNDO shows" in issue.message for issue in faults("bent", texts))


@pytest.mark.parametrize("mark", [";?", ";*"])
def test_a_guarded_wait_of_krl_asks_nothing_of_its_own(mark):
    said = WAIT.replace("HALT", f"{mark} Take the block out\nHALT")
    text = read(main=MAIN_KRL.replace("wall_1()\n", f"{said}wall_1()\n"))
    assert [fault.message for fault in text.faults] == ["a guarded wait must not contain a marked comment"]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("Is the block in place?", "Is the block away?"),
        ("Does no program", "Does a program"),
        ("Ready to meet arm left.", "Do not wait for arm left."),
        ("earlier run go on at", "earlier run go on near"),
        ("Arm right did not answer", "Arm right has stopped and did not answer"),
        ("Does the panel of arm right say that it is ready", "Is it a good day and arm right ready"),
        ("WaitTime 1;", "WaitTime 3600;"),
        ("WaitTime 1;", "WaitTime 1; WaitTime 5;"),
    ],
)
def test_two_controllers_say_what_they_should(old, new):
    programs = JOBS["handshake"][2]()
    assert faults("handshake", edit(programs, old, new))


# ---- figures of the motion ----


@pytest.mark.parametrize(
    ("job", "old", "new"),
    [("bent", r"Clamps (\d)(\d\d\.\d) mm", r"Clamps 2\2 mm"),
     pytest.param("bent", r"wire at (\d)", r"wire at -\1", marks=pytest.mark.long),
     ("bow", r"spacers of 1\.2", "spacers of 12.0")],
)  # fmt: skip
def test_figures_of_the_motion_are_held_against_it(job, old, new):
    programs = JOBS[job][2]()
    file = main_of(programs)
    mutant = {**programs, file: re.sub(old, new, programs[file], count=1)}
    assert mutant != programs and faults(job, mutant) == ()
    codes = {issue.code for issue in prover(job).prove(mutant, last="verify.dialogue_figures").issues}
    assert codes == {"verify.dialogue_figures"}


def test_figures_of_the_motion_are_proven():
    assert prover("bow").prove(JOBS["bow"][2](), last="verify.dialogue_figures").issues == ()


@pytest.mark.long
@pytest.mark.parametrize("job", JOBS)
def test_the_jobs_are_proven_whole(job):
    assert prover(job).prove(JOBS[job][2]()).ok


# ---- whole jobs ----

FILE = """G21 G90 G17 G94
M3 S6000
G0 X-40 Y-10 Z10
G1 Z1 F600
X-20 F1200
G4 P500
X20 Y-5
G4 P250
G0 Z10
S9000
G4 P700
G0 X-30 Y0
M0
G1 Z1 F600
X10
G4 P1500
G0 Z10
M5
"""
"""Waits in cuts, a wait above the block, which is passed over, another speed and a stop."""


@pytest.fixture(scope="module")
def milled(tmp_path_factory):
    """A file's job, its programs, and a proof up to the rule."""
    folder = tmp_path_factory.mktemp("milled")
    (folder / "job.nc").write_text(FILE)
    own = {"file": "job.nc", "origin": {"xyz_mm": [5, 3, 30]}, "dwell": "ms"}
    cuts = [{"name": "prog", "gcode": own}]
    path = small_mill.write(folder, small_mill.PANEL, small_mill.BALL, cuts=cuts, part=None)
    problem = planner.load(path)
    targets = [job.targets() for job in registry.jobs(problem)]
    programs = line_ends.bare(write.program_files(solve.solve(problem, targets), problem))
    held = Prover(problem, registry.claims(problem))
    return programs, lambda texts: held.prove(texts, last=CODE).issues


def test_what_a_file_asks_and_waits_for_is_proven(milled):
    programs, issues = milled
    text = programs[main_of(programs)]
    assert re.findall(r"WaitTime ([\d.]+)", text) == ["1", "0.5", "0.25", "1", "1", "1.5", "1"]
    assert "Go on: line 13 of the file, spindle at 9000 1/min?" in text
    assert "12000 1/min" not in text  # which no pass is cut at
    assert issues(programs) == ()


@pytest.mark.parametrize(
    ("old", "new"),
    [("WaitTime 0.5;", ""), ("WaitTime 0.5;", "WaitTime 500;"), ("WaitTime 0.25;", "WaitTime 0.5;"),
     ("9000 1/min", "19000 1/min"), ("line 13", "line 12"),
     ("ball mill of 6", "ball mill of 6, 12000 1/min"),
     ("ball mill of 6", "ball mill of 60"), ("Block 120 x 80", "Block 80 x 120"),
     ("stands, take", "runs, take")],
)  # fmt: skip
def test_what_a_file_asks_and_waits_for_is_held_against_it(milled, old, new):
    programs, issues = milled
    assert {issue.code for issue in issues(edit(programs, old, new, main_of(programs)))} == {CODE}


def test_a_wait_at_another_place_is_refused(milled):
    """The two waits of the first pass change places."""
    programs, issues = milled
    file = main_of(programs)
    calls = re.findall(r"(?m)^    (mill_prog_1\w*);$", programs[file])
    text = programs[file].replace("    WaitTime 0.5;\n", "", 1)
    text = text.replace("    WaitTime 0.25;\n", "    WaitTime 0.5;\n    WaitTime 0.25;\n", 1)
    assert len(calls) >= 2 and any(
        "at another position" in issue.message for issue in issues({**programs, file: text})
    )


@pytest.mark.long
@pytest.mark.parametrize("heat", [{}, {"power_w": None, "kerf_mm": 2.0}])
def test_spacers_are_as_thick_as_the_slot(tmp_path, heat):
    """Of a tapered face, one end of which is cut half as fast as the other."""
    path = planner_jobs.tapered(tmp_path)
    data = yaml.safe_load(path.read_text())
    data["operations"][0] |= {
        "spacers": True,
        "wire_material": "nichrome",
        "kerf_range_mm": [0.5, 3.0],
        **heat,
    }
    path.write_text(yaml.safe_dump(data))
    problem = planner.load(path)
    targets = [job.targets() for job in registry.jobs(problem)]
    programs = line_ends.bare(write.program_files(solve.solve(problem, targets), problem))
    held = Prover(problem, registry.claims(problem))
    assert held.prove(programs).ok
    file = main_of(programs)
    for change in (0.7, 1.4):
        wrong = re.sub(
            r"spacers of ([\d.]+)", lambda m, k=change: f"spacers of {k * float(m[1]):.1f}", programs[file]
        )
        assert held.prove({**programs, file: wrong}, last="verify.dialogue_figures").issues


# ---- on ways that are decided at run time ----

WAIT_DI = r"WaitDI (\w+),(\d)\\MaxTime:=(\d+);"


UNANSWERED = sentences.UNANSWERED.format(other="right")


def flagged(end, text=UNANSWERED):
    """Return programs for two controllers in which a flag and a branch after one wait replace an error."""
    programs = JOBS["handshake"][2]()
    file = next(file for file in programs if file.startswith("left") and "Main" in file)
    branch = f'    IF late THEN\n      TPWrite "{text}";\n      {end}\n    ENDIF'
    own = re.sub(WAIT_DI, rf"WaitDI \1,\2\\MaxTime:=\3\\TimeFlag:=late;\n{branch}", programs[file], count=1)
    assert own != programs[file]
    head, line, rest = own.partition("\n")
    return {**programs, file: f"{head}{line}  VAR bool late;\n{rest}"}


def test_a_partner_that_does_not_answer_may_be_told_where_that_ends_the_program():
    assert faults("handshake", flagged("EXIT;")) == ()
    assert faults("handshake", flagged("EXIT;", LIES[0]))
    assert faults("handshake", flagged("", UNANSWERED))
