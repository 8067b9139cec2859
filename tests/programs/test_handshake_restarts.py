"""Programs of two UR controllers that restart after each stop.

Programs of earlier versions fail the exhaustive check, current ones pass, and each of their parts is
necessary.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from planner.languages.writing import write
from planner.programs import stages
from planner.programs.handshake import block_windows as handshake_windows
from planner.programs.handshake import restarts
from planner.programs.handshake.restarts import check_restarts
from planner.programs.handshake.wire_operations import WireOperation, wire_operations
from planner.proof.context import Context
from tests.languages.urscript import ur_pair

FOLDER = Path(__file__).parents[0] / "files"


def as_before(arm, line, runs):
    """Moves and blocks of the text that was written before: its statements, none of which reads back."""
    out, blocks, number = [], [], 0
    for row in (FOLDER / f"ur_before_{arm}.txt").read_text("utf-8").split("\n"):
        level = int("True" in row)
        if row.startswith(f"set_standard_digital_out({line},"):
            number += level
            new = [WireOperation("set", level)]
        elif row.startswith(f"set_standard_digital_out({runs},"):
            new = [WireOperation("run", level)]
        elif row.startswith("await_"):
            new = [WireOperation("look" if "running" in row else "wait", level)]
        elif row.startswith(("kill", "watching")):
            new = [WireOperation("watch", int(row.startswith("w")))]
        elif row.startswith("popup"):
            new = [WireOperation("ask")]
        elif row.startswith("mov") and out[-1] != WireOperation("done", number):
            new = [WireOperation("go", number), WireOperation("done", number)]
        else:
            new = []
        out += new
        blocks += [number] * len(new)
    return out, blocks


def as_written(operations=1):
    """Return moves and blocks of a job that repeats its operations ``operations`` times."""
    plan, problem = ur_pair.plan(), ur_pair.problem(every=3)
    texts = write.program_files(
        dataclasses.replace(plan, operations=plan.operations * operations),
        dataclasses.replace(problem, operations=problem.operations * operations),
    )
    context = Context(problem, {"panel": ()}, {path: text.replace("\r", "") for path, text in texts.items()})
    wiring, readings = stages.controller_wiring(context.problem), context.job.automata_by_arm
    return tuple(
        zip(
            *(
                wire_operations(
                    task.steps,
                    readings[task.name].interval,
                    wiring.drives[task.name],
                    wiring.reads[task.name],
                    wiring.running_inputs[task.name],
                )
                for task in context.job.tasks
            ),
            strict=True,
        )
    )


@pytest.mark.parametrize("reads_back", [False, True])
def test_programs_as_they_were_written_before_fail(reads_back):
    """One that was started anew during a question works beside the other one in mid-cut."""
    rows, blocks = zip(as_before("left", 0, 1), as_before("right", 2, 3), strict=True)
    found = check_restarts(rows, blocks, reads_back=reads_back)
    assert found.kind == "apart"
    assert any(what == "start" and line == 0 for _, what, line in found.events[4:])


def test_programs_as_they_are_written_pass_and_so_does_the_undisturbed_run():
    rows, blocks = as_written()
    assert check_restarts(rows, blocks).kind is None
    assert check_restarts(rows, blocks, disturbed=False).kind is None


def without(rows, blocks, program, chosen):
    kept = [
        [i for i, move in enumerate(row) if k != program or not chosen(move)] for k, row in enumerate(rows)
    ]
    own = [[row[i] for i in some] for row, some in zip(rows, kept, strict=True)]
    return own, [[row[i] for i in some] for row, some in zip(blocks, kept, strict=True)]


def test_each_part_of_them_is_needed():
    rows, blocks = as_written()
    parts = {
        "looks at both behind a question": lambda m: m.kind == "check" and m.own_level,
        "the threads": lambda m: m.kind == "watch",
    }
    for what, chosen in parts.items():
        changed = without(rows, blocks, 0, chosen)
        assert check_restarts(*changed).kind in ("apart", "unwatched"), what
    slow = [[dataclasses.replace(move, is_slow=False) for move in row] for row in rows]
    assert check_restarts(slow, blocks).kind == "apart"
    late = without(rows, blocks, 1, lambda m: m.kind == "watch" and not m.value)
    assert check_restarts(*late, disturbed=False).kind == "ends"  # its thread runs while the other one asks


def test_what_long_programs_do_again_and_again_is_looked_at_once(monkeypatch):
    """Each operation asks twice; whole they would have some 95,000 states more for each one."""
    monkeypatch.setattr(restarts, "MAX_STATES", 150_000)
    rows, blocks = as_written(3)
    assert check_restarts(rows, blocks).kind is None
    assert len(set(blocks[0])) > 45


def test_a_fault_far_behind_in_a_long_program_is_found_where_it_is():
    rows, blocks = as_written(3)
    at = max(i for i, move in enumerate(rows[0]) if move.kind == "check")
    changed = [[*rows[0][:at], *rows[0][at + 1 :]], rows[1]]
    numbers = [[*blocks[0][:at], *blocks[0][at + 1 :]], blocks[1]]
    (short, windows) = handshake_windows.shorten_programs(changed, numbers)
    assert len(windows.kept) < windows.count  # the meetings before are cut short, those around it are not
    found = restarts._RestartSearch(short, True, True, windows).run()
    assert found.kind == "apart"
    assert found.lines[0] > rows[0][at].line - 10


def test_rows_that_are_cut_short_keep_all_threes():
    rng = np.random.default_rng(4)
    for _ in range(200):
        period = rng.integers(0, 4, rng.integers(1, 7)).tolist()
        kinds = [9, *(period * 20)[: rng.integers(2, 60)], *rng.integers(0, 4, 10).tolist(), 8]
        kept = [kinds[i] for i in handshake_windows._covering_indices(kinds)]
        threes = [set(zip(row, row[1:], row[2:], strict=False)) for row in (kinds, kept)]
        assert threes[0] == threes[1]
        assert len(kept) <= 60
