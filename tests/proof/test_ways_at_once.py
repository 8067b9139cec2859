"""Simultaneous approaches and retreats of both arms in a synchronised block: written, proven, or refused."""

from __future__ import annotations

import dataclasses
import functools
import re

import numpy as np
import pytest

from planner.languages.writing import write
from tests import line_ends
from tests.languages.rapid.rapid_edits import edit, lines, name, put
from tests.proof import provers, small_job

COUNT = 12
BLOCK = re.compile(r"MoveAbsJ (\w+)\\ID:=(\d+)\\NoEOffs,v_entry,fine,\w+;")


def plan(together=("entry", "exit")):
    """The small job, with approach and retreat in one block each."""
    own = small_job.plan(COUNT)
    (operation,) = own.operations
    return dataclasses.replace(own, operations=(dataclasses.replace(operation, synchronised=together),))


@functools.cache
def texts(together=("entry", "exit")):
    return line_ends.bare(write.program_files(plan(together), small_job.problem()))


def refused(programs):
    assert programs != texts()
    proof = provers.prover("small").prove(programs)
    assert not proof.ok
    return provers.broken(proof)


def in_block(task):
    """Rows of the joint moves in blocks of a task's main module."""
    return [i for i, row in enumerate(lines(texts(), task, "Main")) if BLOCK.search(row)]


def test_both_arms_go_in_one_block_with_equal_ids_and_the_programs_are_proven():
    for task in (1, 2):
        text = texts()[name("Main", task)]
        ways = re.findall(r"SyncMoveOn (\w+),all_tasks;\s+((?:MoveAbsJ [^\n]*\s+)+)SyncMoveOff", text)
        assert [block for block, _ in ways] == ["block_1_on", "block_3_on"]
        for _, moves in ways:
            assert [int(number) for _, number in BLOCK.findall(moves)] == [1, 2]
        alone = [row for row in text.split("\n") if "MoveAbsJ" in row and "\\ID" not in row]
        assert len(alone) == 1
        assert "j_home" in alone[0]
    assert provers.prover("small").prove(texts()).ok


@pytest.mark.parametrize("together", [("entry",), ("exit",)])
def test_one_of_both_ways_at_once_is_proven_too(together):
    assert provers.prover("small").prove(texts(together)).ok


def test_the_arms_take_the_time_of_the_slower_one_and_end_together():
    motion = provers.prover("small").prove(texts()).series
    one = provers.prover("small").prove(small_job.programs(COUNT)).series
    assert float(np.asarray(motion["time"])[-1]) < float(np.asarray(one["time"])[-1])


def test_a_move_that_is_taken_out_of_one_arm_s_block_is_refused():
    rows = lines(texts(), 2, "Main")
    del rows[in_block(2)[0]]
    assert "verify.move_count" in refused(put(texts(), 2, rows, "Main"))


def test_one_arm_s_block_without_moves_is_refused():
    rows = [row for i, row in enumerate(lines(texts(), 2, "Main")) if i not in in_block(2)]
    assert "verify.move_count" in refused(put(texts(), 2, rows, "Main"))


def test_other_ids_are_refused():
    rows = lines(texts(), 1, "Main")
    first = in_block(1)[0]
    rows[first] = rows[first].replace("\\ID:=1", "\\ID:=7")
    assert "verify.move_ids" in refused(put(texts(), 1, rows, "Main"))
    rows[first] = rows[first].replace("\\ID:=7", "")
    assert "verify.move_ids" in refused(put(texts(), 1, rows, "Main"))


@pytest.mark.parametrize(
    ("degrees", "code"), [((70.0, -60.0), "verify.clearance"), ((70.0, 25.0), "verify.own_clearance")]
)
def test_a_corner_that_is_moved_into_the_block_or_the_arm_itself_is_refused(degrees, code):
    target = re.search(r"CONST jointtarget j_1_entry_1:=\[\[([^\]]*)\]", texts()[name("Data", 1)])
    assert target is not None
    joints = [float(v) for v in target[1].split(",")]
    joints[1], joints[2] = joints[1] + degrees[0], joints[2] + degrees[1]
    moved = ",".join(f"{v:.6f}" for v in joints)
    found = refused(edit(texts(), name("Data", 1), target[1], moved))
    assert code in found


def test_a_zone_in_one_arm_s_way_is_refused():
    rows = lines(texts(), 1, "Main")
    first = in_block(1)[0]
    rows[first] = rows[first].replace(",fine,", ",z10,")
    assert {"verify.zone_kind", "verify.zone_size"} & set(refused(put(texts(), 1, rows, "Main")))


def test_joint_moves_while_the_wire_is_mounted_are_refused():
    rows = lines(texts(), 1, "Main"), lines(texts(), 2, "Main")
    out = dict(texts())
    for task, own in zip((1, 2), rows, strict=True):
        calls = [i for i, row in enumerate(own) if row.strip() == "link;"]
        tool = BLOCK.search(own[in_block(task)[0]])
        assert tool is not None
        move = own[in_block(task)[-2]]
        extra = ["SyncMoveOff block_2_off;", "SyncMoveOn block_9_on,all_tasks;", move]
        extra += ["SyncMoveOff block_9_off;", "SyncMoveOn block_8_on,all_tasks;"]
        end = next(i for i, row in enumerate(own) if "SyncMoveOff block_2_off" in row)
        changed = [
            *own[: calls[0]],
            *extra,
            *own[calls[0] : end],
            "SyncMoveOff block_8_off;",
            *own[end + 1 :],
        ]
        out |= put(out, task, changed, "Main")
        names = "".join(f"\nVAR syncident block_{n}_{e};" for n in (8, 9) for e in ("on", "off"))
        data = out[name("Data", task)]
        out[name("Data", task)] = data.replace(
            "VAR syncident block_1_on;", f"VAR syncident block_1_on;{names}"
        )
    assert "verify.wire_alone" in refused(out)
