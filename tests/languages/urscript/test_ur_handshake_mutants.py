"""Two UR controllers with a handshake: programs of the planner are proven.

Faults in every statement of the meeting, the mutual watch and the questions are caught.
"""

from __future__ import annotations

import collections
import dataclasses
import re

import numpy as np
import pytest

from planner.issues import TandemError
from planner.languages.writing import write
from planner.proof.context import Context
from planner.proof.prove import Prover
from planner.proof.rules import handshake as rules_handshake
from planner.proof.rules import moves as moves_and_settings
from planner.proof.rules import synchronisation, waiting_time
from tests.languages.urscript import ur_pair

FORMS = [("four_phase", 3), ("four_phase", 1)]
FILES = {arm: f"{arm}/small.script" for arm in ur_pair.ARMS}
RULES = (
    synchronisation.move_count,
    synchronisation.sync_order,
    synchronisation.move_time,
    synchronisation.zone_kind,
    synchronisation.stop_before_logic,
    synchronisation.arms_alone,
    waiting_time.meeting_time,
    moves_and_settings.zero_length,
)
"""What has to hold of programs that meet, besides the handshake."""


def faults(problem, programs):
    """What is found, the text itself where it has no straight way."""
    context = Context(problem, {"panel": ()}, programs)
    if not context.is_readable:
        return ["no straight way"]
    found = [str(issue) for issue in rules_handshake.handshake(context).issues]
    if context.is_replayable and not found:
        found += [str(issue) for rule in RULES for issue in rule(context).issues]
    return found


@pytest.mark.parametrize(("kind", "every"), FORMS)
def test_programs_as_written_are_proven_by_every_rule(kind, every):
    problem = ur_pair.problem(kind, every)
    proof = Prover(problem, ur_pair.claims()).prove(ur_pair.programs(kind, every, switched=False))
    assert [str(issue) for issue in proof.issues] == []
    assert proof.ok
    assert faults(problem, ur_pair.programs(kind, every)) == []


def flipped(row):
    return row.replace("True", "\0").replace("False", "True").replace("\0", "False")


def renumbered(row):
    """The row with another input or output."""
    return re.sub(
        r"(?<=digital_)(in|out)\((\d)", lambda found: f"{found[1]}({(int(found[2]) + 1) % 8}", row, count=1
    )


def other_numbers(row):
    return re.sub(r"(?<=,)[\d.]+(?=\)$)", "99999.0", row), re.sub(r"(?<=,)[\d.]+(?=\)$)", "0.5", row)


def in_row(rows, i):
    """(what, rows) of the faults that are put into a row."""
    row = rows[i]
    bare = row.partition("#")[0].strip()
    without = [*rows[:i], *rows[i + 1 :]]

    def put(new):
        return [*rows[:i], new, *rows[i + 1 :]]

    if re.match(r"await_|set_.*doPartner|set_.*doRunning", row):
        yield "left out", without
        yield "other level", put(flipped(row))
    if row.startswith("check_partner"):
        yield "left out", without
        for own in ("True", "False"):
            for level in ("True", "False"):
                if (new := f"check_partner({level},{own})") != row:
                    yield "other look", put(new)
    if row.startswith("sleep") and "doRunning" in rows[i - 1] + rows[i + 1]:
        yield "stands not", without
        yield "stands shorter", put("sleep(0.05)")
    if re.match(r"await_", row):
        other = "await_running" if row.startswith("await_line") else "await_line"
        yield "other function", put(re.sub(r"await_\w+", other, row))
        for new in other_numbers(row):
            yield "other limit", put(new)
        yield (
            "waits by itself",
            [*rows[:i], "while get_standard_digital_in(0):", "sync()", "end", *without[i:]],
        )
    if re.match(r"set_.*doPartner", row):
        yield "doubled", [*rows[:i], row, *rows[i:]]
        yield "other output", put(renumbered(row))
    if re.match(r"set_.*doRunning", row):
        yield "other output", put(renumbered(row))
    lines = r"(await_line|set_\w+)\(.*(?=doPartner|\d\)$)"
    kinds = [found[1] for found in (re.match(lines, one) for one in rows[i : i + 2]) if found]
    if len(set(kinds)) == 2:
        yield "swapped", [*rows[:i], rows[i + 1], row, *rows[i + 2 :]]
    if bare.startswith(("watching", "kill")):
        yield "left out", without
        yield "doubled", [*rows[:i], row, *rows[i:]]
    if bare.startswith("watching") and not rows[i + 1].startswith("await_running"):
        later = (
            next(k for k in range(i + 1, len(rows)) if re.match(r"mov|set_.*True.*Gripper|kill|end", rows[k]))
            + 1
        )
        if not rows[later - 1].startswith(("kill", "end")):
            yield "too late", [*rows[:i], *rows[i + 1 : later], row, *rows[later:]]
    if bare.startswith("kill") and rows[i + 1].startswith("await_running"):
        later = next(k for k in range(i + 1, len(rows)) if not re.match(r"await_|set_.*doPartner", rows[k]))
        yield "too late", [*rows[:i], *rows[i + 1 : later], row, *rows[later:]]
    if re.match(r"movel", row):
        if rows[i + 1].startswith(("await", "set", "kill")):
            yield "in a blend", put(re.sub(r"r=0\.0\)", "r=0.001)", row))
            yield "other time", put(re.sub(r"t=([\d.]+)", lambda t: f"t={1.01 * float(t[1]):.5f}", row))
        if rows[i + 1].startswith("await"):
            yield "met before", [*rows[:i], rows[i + 1], row, *rows[i + 2 :]]
        yield "stands", put(re.sub(r".*t=([\d.]+),r=.*", r"stand(\1)\nstand(\1)", row))
        yield "stands no time", put("stand(0.0)")
    if "Tandem asks" in row and i and "doRunning" in rows[i - 1]:
        yield "not asked", without
        yield "asked while it runs", [*rows[: i - 1], row, rows[i - 1], *rows[i + 1 :]]
    if row.startswith(("def await", "def check", "thread")):
        end = next(k for k in range(i, len(rows)) if rows[k] == "end" and _closed(rows[i : k + 1]))
        yield "no such function", [*rows[:i], *rows[end + 1 :]]
        for k in range(i + 1, end):
            yield f"without its {rows[k].partition('(')[0]}", [*rows[:k], *rows[k + 1 :]]
            if "digital" in rows[k]:
                yield "other number inside", [*rows[:k], renumbered(rows[k]), *rows[k + 1 :]]
            if "popup" in rows[k]:
                held = rows[k].replace("=True", "=\0").replace("=False", "=True").replace("\0", "False")
                yield "popup held or not", [*rows[:k], held, *rows[k + 1 :]]
            if "set_" in rows[k]:
                yield "left on", [*rows[:k], flipped(rows[k]), *rows[k + 1 :]]
            if rows[k] == "halt":
                yield "goes on", [*rows[:k], "sync()", *rows[k + 1 :]]
            if "!=" in rows[k]:
                yield "waits for the other level", [*rows[:k], rows[k].replace("!=", "=="), *rows[k + 1 :]]
            if rows[k].startswith("while get") and "!=" not in rows[k]:
                yield (
                    "watches the other level",
                    [*rows[:k], rows[k].replace("while ", "while not "), *rows[k + 1 :]],
                )
    if re.match(r"if get_\w+_out", row):
        yield "not looked at", [*rows[:i], *rows[i + 5 :]]
        yield "looks at another output", put(renumbered(row))
        yield "looks twice", [*rows[: i + 5], *rows[i:]]
        yield "shown before it is low", [*rows[: i + 1], rows[i + 2], rows[i + 1], *rows[i + 3 :]]
        yield "another one goes off too", [*rows[: i + 2], renumbered(rows[i + 1]), *rows[i + 2 :]]


def _closed(rows):
    """Whether a block is closed by the last of its rows."""
    opens = sum(bool(re.match(r"def|thread|if|while", row)) for row in rows)
    return opens == rows.count("end")


def every_fault(programs):
    for file in FILES.values():
        rows = programs[file].split("\n")
        for i in range(len(rows) - 1):
            for what, changed in in_row(rows, i):
                assert changed != rows, (what, rows[i])
                yield f"{what}", f"{file}:{i + 1} {rows[i][:60]}", {**programs, file: "\n".join(changed)}


def missed_mutants(problem, mutants):
    tried = collections.Counter(what for what, _, _ in mutants)
    return [(what, where) for what, where, programs in mutants if not faults(problem, programs)], tried


def test_some_faults_are_caught():
    problem, good = ur_pair.problem(), ur_pair.programs()
    found = list(every_fault(good))
    rows = np.random.default_rng(3).permutation(len(found))[:20]
    passed, tried = missed_mutants(problem, [found[i] for i in rows])
    assert passed == []
    assert len(tried) > 8


def test_every_stand_around_the_rise_of_a_running_wire_is_demanded():
    problem, good = ur_pair.problem(), ur_pair.programs()
    found = [fault for fault in every_fault(good) if " sleep" in fault[1]]
    passed, tried = missed_mutants(problem, found)
    assert passed == []
    assert tried == {"stands not": 8, "stands shorter": 8}
    rows = good[FILES["left"]].split("\n")
    clear = rows.index("await_line(False,30.0)")  # the lead's, behind the second rise
    changed = "\n".join([*rows[:clear], *rows[clear + 1 :]])
    (first,) = faults(problem, {**good, FILES["left"]: changed})[:1]
    assert "no wait checks that the other program's line is 0" in first


def test_every_fault_of_the_look_at_a_wire_that_stays_high_is_caught():
    """Among them: nothing lowers it before the text that holds the program, or it is not the only one."""
    problem, good, file = ur_pair.problem(), ur_pair.programs(), FILES["left"]
    rows = good[file].split("\n")
    first = next(i for i, row in enumerate(rows) if re.match(r"if get_\w+_out", row))
    found = [
        (what, rows[i], {**good, file: "\n".join(changed)})
        for i in (first, first + 1)
        for what, changed in in_row(rows, i)
    ]
    passed, tried = missed_mutants(problem, found)
    assert passed == []
    assert len(tried) == 8 and tried["left out"]


@pytest.mark.parametrize("side", FILES)
def test_a_look_that_compares_one_input_twice_is_refused_also_where_nothing_calls_it(side):
    problem, good, file = ur_pair.problem(), ur_pair.programs(), FILES[side]
    look = r"(if get_standard_digital_in\()\d(\)!=level or get_standard_digital_in\((\d)\))"
    changed, count = re.subn(look, r"\g<1>\g<3>\g<2>", good[file])
    assert count == 1
    assert faults(problem, {**good, file: changed}) == ["no straight way"]


@pytest.mark.long
@pytest.mark.parametrize(("kind", "every"), FORMS)
def test_every_fault_is_caught(kind, every):
    problem, good = ur_pair.problem(kind, every), ur_pair.programs(kind, every)
    passed, tried = missed_mutants(problem, list(every_fault(good)))
    assert passed == []
    assert tried.total() > 300 and len(tried) > 30


def test_a_ur_arm_beside_an_abb_arm_and_a_toggle_are_refused():
    """Nothing keeps an ABB program from going on behind a stop, and a toggle tells too little."""
    for kind, right, text, hint in (
        ("four_phase", "irb140", "nothing prevents one of another controller from", "two arms of UR"),
        ("toggle", "ur10e", "at every second meeting", "kind: four_phase"),
    ):
        with pytest.raises(TandemError) as caught:
            write.program_files(ur_pair.plan(right=right), ur_pair.problem(kind, 3, right=right))
        (issue,) = caught.value.issues
        assert issue.code == "post.controller"
        assert text in issue.message and hint in issue.hint


def test_power_that_is_on_during_a_question_is_refused():
    plan = ur_pair.plan()
    (operation,) = plan.operations
    actions = tuple(a for a in operation.targets.actions if a.kind != "off" or a.target > 12)
    targets = dataclasses.replace(operation.targets, actions=actions)
    plan = dataclasses.replace(plan, operations=(dataclasses.replace(operation, targets=targets),))
    with pytest.raises(TandemError) as caught:
        write.program_files(plan, ur_pair.problem())
    (issue,) = caught.value.issues
    assert issue.code == "post.handshake_process"
    assert "doGripper of arm left is on while one of the programs asks" in issue.message


def test_programs_on_other_wires_than_the_cells_are_caught():
    """Inputs swapped, lines crossed, one number for two things, and numbers that both arms share."""
    good, io = ur_pair.programs(), ur_pair.io()
    assert faults(ur_pair.problem(numbers=io), good) == []
    changed = {
        "inputs swapped": {"left": {"diPartner": 1, "diPartnerRunning": 0}},
        "inputs of the other one": {"right": {"diPartner": 0, "diPartnerRunning": 1}},
        "outputs swapped": {"right": {"doPartner": 3, "doRunning": 2}},
        "power on the line of the meetings": {"left": {ur_pair.SIGNAL: 0}},
        "power on the running wire": {"left": {ur_pair.SIGNAL: 1}},
        "one output says that either runs": {"right": {"doRunning": 1, "doPartner": 3}},
    }
    for what, more in changed.items():
        numbers = {arm: {**own, **more.get(arm, {})} for arm, own in io.items()}
        assert faults(ur_pair.problem(numbers=numbers), good), what
    alike = {arm: {**own, **dict(zip(ur_pair.LINES, (0, 0, 1, 1), strict=True))} for arm, own in io.items()}
    texts = write.program_files(ur_pair.plan(), ur_pair.problem(numbers=io))
    same = {path: text.replace("out(2,", "out(0,").replace("out(3", "out(1") for path, text in texts.items()}
    same = {path: text.replace("in(2)", "in(0)").replace("in(3)", "in(1)") for path, text in same.items()}
    found = faults(ur_pair.problem(numbers=alike), same)
    assert len(found) == 2 and all("would run there" in text for text in found)


def test_programs_of_each_others_arm_are_caught():
    left, right = (ur_pair.programs()[FILES[arm]] for arm in ur_pair.ARMS)
    problem = ur_pair.problem()
    assert not Prover(problem, ur_pair.claims()).prove({FILES["left"]: right, FILES["right"]: left}).ok
    assert faults(problem, {FILES["left"]: left})  # there is no other program to answer


def test_an_arm_that_stands_while_the_other_one_moves_is_no_movel():
    plan = ur_pair.plan(switched=False)
    (operation,) = plan.operations
    pose, q = ({**own} for own in (operation.targets.pose, operation.q))
    for own in (pose, q):
        own["right"] = own["right"].copy()
        own["right"][4:] = own["right"][3]
    exits = {**operation.retreat, "right": np.stack([q["right"][-1], operation.retreat["right"][-1]])}
    targets = dataclasses.replace(operation.targets, pose=pose)
    stands = dataclasses.replace(operation, targets=targets, q=q, retreat=exits)
    problem = ur_pair.problem()
    texts = write.program_files(dataclasses.replace(plan, operations=(stands,)), problem)
    proof = Prover(problem, ur_pair.claims()).prove(texts)
    assert [str(issue) for issue in proof.issues] == []
    text = texts[FILES["right"]]
    assert text.count("\nmovel(") == 3 and text.count("\nstand(") > 10
    last = next(row for row in reversed(text.split("\r\n")) if row.startswith("movel("))
    moves = re.sub(r"\nstand\(([\d.]+)\)", rf"\n{last.split(',t=')[0]},t=\1,r=0.0)", text)
    proof = Prover(problem, ur_pair.claims()).prove({**texts, FILES["right"]: moves})
    assert {issue.code for issue in proof.issues} == {"verify.zero_length"}
