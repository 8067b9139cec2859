"""Long programs are split at the same moves in all tasks, at stops outside the work, or refused."""

from __future__ import annotations

import re

import pytest

from planner.issues import TandemError
from planner.languages.rapid.reader.reader import read_task
from tests.languages.writing import synthetic
from tests.languages.writing.reading import programs


def job(counts, stops, **limits):
    """Two arms; ``counts``: moves of each segment in turn, cut and link; ``stops``: targets that stop."""
    labels = ["mount"]
    for i, count in enumerate(counts):
        labels += [f"cut/face{i}" if i % 2 == 0 else "link"] * count
    problem = synthetic.problem(**limits)
    q = {"left": synthetic.sweep(len(labels)), "right": synthetic.sweep(len(labels), 0.2)}
    return synthetic.plan(synthetic.operation(problem, q, labels, stop=stops, actions=())), problem


def cut_modules(files, task):
    return {n: t for n, t in files.items() if n.startswith(f"{task}/TandemCut")}


def ids(text):
    return [int(i) for i in re.findall(r"\\ID:=(\d+)", text)]


def test_modules_are_split_at_the_same_ids_at_fine_points():
    plan, problem = job([40, 20, 40, 20, 40], [40, 50, 60, 100, 120], max_moves=60)
    files = programs(plan, problem)
    left, right = cut_modules(files, "T_ROB1"), cut_modules(files, "T_ROB2")
    assert [ids(t) for t in left.values()] == [ids(t) for t in right.values()]
    # 60 moves at most, at stops between segments or inside a link: 40 + 20 | 40 + 20 | 40
    assert [len(ids(t)) for t in left.values()] == [60, 60, 40]
    for text in (*left.values(), *right.values()):
        last = [line for line in text.split("\n") if "MoveL" in line][-1]
        assert ",fine," in last
    assert sorted(i for t in left.values() for i in ids(t)) == list(range(1, 161))
    listed = re.findall(r"<Module>(.*)</Module>", files["T_ROB1/Tandem_1.pgf"])
    assert sorted(f"T_ROB1/{name}" for name in listed) == sorted(
        n for n in files if "T_ROB1" in n and ".mod" in n
    )
    texts = {n: t for n, t in files.items() if n.startswith("T_ROB1") and n.endswith(".mod")}
    assert read_task(texts).faults == ()


def test_a_segment_may_be_split_inside_when_it_is_no_cut():
    plan, problem = job([40, 20, 40], [40, 50, 60], max_moves=50)
    files = programs(plan, problem)
    assert [len(ids(t)) for t in cut_modules(files, "T_ROB1").values()] == [50, 50]
    names = re.findall(r"PROC (\w+)\(\)", "\n".join(cut_modules(files, "T_ROB1").values()))
    assert names == ["cut_face0", "link", "link__2", "cut_face2"]


def test_bytes_count_too():
    plan, problem = job([40, 20, 40], [40, 60], max_bytes=20_000)
    files = programs(plan, problem)
    assert len(cut_modules(files, "T_ROB1")) > 1
    assert max(len(text.encode()) for text in files.values()) <= 20_000


@pytest.mark.parametrize("limits", [{"max_moves": 39}, {"max_bytes": 6_000}])
def test_a_cut_that_is_too_long_for_a_module_is_refused_even_with_a_stop_inside(limits):
    plan, problem = job([40, 20, 40], [20, 40, 60], **limits)
    with pytest.raises(TandemError) as caught:
        programs(plan, problem)
    assert [issue.code for issue in caught.value.issues] == ["post.no_split"]
    assert caught.value.issues[0].hint


def test_a_data_module_beyond_the_limit_is_refused():
    plan, problem = job([2], [], max_bytes=5_000)
    with pytest.raises(TandemError) as caught:
        programs(plan, job([2], [], max_bytes=2_000)[1])
    assert caught.value.issues[0].code == "post.no_split"
    assert programs(plan, problem)
