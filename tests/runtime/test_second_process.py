"""A second process returns what this process computes, is never required, and ends with its parent."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from planner import pipeline
from planner.issues import Issue, TandemError
from planner.motion import solve
from planner.pipeline import WARM_UP
from planner.processes import registry
from planner.proof import context
from planner.proof.prove import prove
from planner.report import output
from planner.runtime.executor import SerialExecutor
from planner.runtime.second_process import SMALL_BYTES, SecondProcess, open_executor
from tests import small_problem
from tests.processes.forming.proof import forming_job
from tests.processes.hotwire.proof import straight_job
from tests.proof import small_job


class RecordingExecutor(SecondProcess):
    """Records which calls ran in the second process."""

    def __init__(self) -> None:
        super().__init__(WARM_UP)
        self.done: list[bool] = []

    def _call(self, parts: Sequence[Any]) -> tuple[bool, tuple[Any, ...]]:
        answer = super()._call(parts)
        self.done.append(answer[0])
        return answer

    def submit(self, work: Callable[..., Iterator[Any]], *arguments: Any) -> Iterator[Any]:
        """Submit a call and wait for its answer, so that it runs there however busy the machine is."""
        count, call = len(self.done), super().submit(work, *arguments)
        for _ in range(30_000):
            if len(self.done) > count:
                return call
            time.sleep(0.01)
        pytest.fail(f"{work.__name__} was not sent, because its arguments cannot be pickled")


@pytest.fixture(scope="module")
def second() -> Iterator[RecordingExecutor]:
    with RecordingExecutor() as process:
        yield process


def arrays(given: np.ndarray) -> Iterator[object]:
    """Arrays of all kinds, and where they come from."""
    yield os.getpid()
    yield given[::2]
    yield np.asfortranarray(given)
    yield {"one": given.sum(), "labels": np.array(["a", "bc"]), "none": np.zeros((0, 3))}


def refuses(parent: int) -> Iterator[object]:
    yield "not lost"
    raise TandemError(Issue("verify.duration", f"refused in {os.getpid()} of {parent}"))


def gives_up(parent: int) -> Iterator[object]:
    if os.getpid() != parent:
        raise SystemExit("as Drake does where a condition of its own fails")
    yield "here"


def is_killed(parent: int) -> Iterator[object]:
    if os.getpid() != parent:
        os.kill(os.getpid(), signal.SIGKILL)
    yield "here"


def gives_no_pickle(parent: int) -> Iterator[object]:
    yield (lambda: parent) if os.getpid() != parent else "here"


def test_results_come_back_as_they_are(second: RecordingExecutor) -> None:
    given = np.random.default_rng(3).normal(size=(SMALL_BYTES // 8, 3))
    first, again = (second.submit(arrays, given) for _ in range(2))
    pid, *found = first
    assert pid == next(again) != os.getpid()
    _, *expected = arrays(given)
    for got, want in zip(found[:2], expected[:2], strict=True):
        assert isinstance(got, np.ndarray) and isinstance(want, np.ndarray)
        assert got.tobytes() == want.tobytes()
        assert got.flags.writeable
    assert str(found[2]) == str(expected[2])


def test_what_fails_there_is_raised_as_it_is_here(second: RecordingExecutor) -> None:
    result = second.submit(refuses, os.getpid())
    assert next(result) == "not lost"
    with pytest.raises(TandemError, match=f"refused in {os.getpid()} of {os.getpid()}"):
        next(result)
    for work in (gives_up, gives_no_pickle):
        assert list(second.submit(work, os.getpid())) == ["here"]
    with SecondProcess(WARM_UP) as process:
        assert list(process.submit(lambda: iter(["here"]))) == ["here"]


def test_what_is_not_begun_there_is_worked_out_here() -> None:
    with SecondProcess(WARM_UP) as process:
        busy = process.submit(sleeps)
        assert list(process.submit(gives_up, os.getpid())) == ["here"]
        del busy


def test_a_process_that_is_killed_is_not_missed() -> None:
    with SecondProcess(WARM_UP) as process:
        calls = [process.submit(work, os.getpid()) for work in (is_killed, is_killed, gives_up)]
        assert [list(call) for call in calls] == [["here"]] * 3


@pytest.mark.sampled(every=2)
@pytest.mark.parametrize("settings", [{}, {"clearance": 0.3}])
@pytest.mark.parametrize("job", [small_job, straight_job])
def test_the_proof_is_the_same(
    second: RecordingExecutor, job: ModuleType, settings: dict[str, float]
) -> None:
    """The text is identical.

    This includes the case of more required clearance than available, with the same issues in the same order:
    those rules are checked in the second process.
    """
    given = job.problem(**settings), job.claims(), job.programs()
    second.done.clear()
    item, two = prove(*given), prove(*given, second)
    assert second.done == [True, True]
    assert bool(settings) == ("verify.clearance" in {issue.code for issue in item.issues})
    assert output.proof_json(item, (), {}) == output.proof_json(two, (), {})
    assert item.part_obj == two.part_obj
    assert list(item.series) == list(two.series)
    for name, values in item.series.items():
        assert np.asarray(values).tobytes() == np.asarray(two.series[name]).tobytes(), name


@pytest.mark.long
def test_the_proof_of_a_long_motion_is_the_same(
    second: RecordingExecutor, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only the clearance checks of a motion too long to be sent whole run in the second process.

    They include the swept volume of a ball and the bodies inside of the heads, also with more required
    clearance than available.
    """
    monkeypatch.setattr(context, "MAX_SENT_SAMPLES", 0)
    for settings in ({}, {"clearance": 0.3}):
        given = forming_job.problem(**settings), forming_job.claims(), forming_job.programs(24)
        second.done.clear()
        item, two = prove(*given), prove(*given, second)
        assert second.done
        assert all(second.done)
        assert bool(settings) == ("verify.clearance" in {issue.code for issue in item.issues})
        assert item.surfaces
        assert output.proof_json(item, (), {}) == output.proof_json(two, (), {})
        assert item.part_obj == two.part_obj
        for name, values in item.series.items():
            assert np.asarray(values).tobytes() == np.asarray(two.series[name]).tobytes(), name


def test_a_result_is_the_same(tmp_path: Path) -> None:
    """All files but the times that are measured; planned in a thread, as programs of others do."""
    problem = pipeline.load(small_problem.write(tmp_path))

    def planned(processes: int) -> None:
        pipeline.plan(problem, processes=processes).save(tmp_path / str(processes))

    for processes in (1, 2):
        thread = threading.Thread(target=planned, args=(processes,))
        thread.start()
        thread.join()
    item, two = ({p.relative_to(f): p for p in f.rglob("*.*")} for f in (tmp_path / "1", tmp_path / "2"))
    assert item.keys() == two.keys()
    for name in item.keys() - {Path("plan.json"), Path("report.html")}:
        assert item[name].read_bytes() == two[name].read_bytes(), name
    pictures = [
        re.findall(r"data:image/png;base64,[^\"]*", f[Path("report.html")].read_text()) for f in (item, two)
    ]
    assert pictures[0] == pictures[1] != []


AGAIN = "name: again, process: targets, arms: [left], frame: world, setup: {place: {xyz_mm: [450, 0, 20]}}"


def test_later_setups_and_ways_home_are_planned_there_as_they_are_here(
    second: RecordingExecutor, tmp_path: Path
) -> None:
    """The results are identical. A setup without a plan there has none here, with the same issues."""
    columns, *rows = small_problem.COLUMNS, *small_problem.ROWS
    far = [row.replace("450,", "950,", 1) for row in rows]
    (tmp_path / "far.csv").write_text("\n".join([columns, *far]) + "\n")
    plans, reasons = [], []
    for name in ("targets.csv", "far.csv"):
        text = small_problem.PROBLEM + f"  - {{{AGAIN}, file: {name}}}\n"
        problem = pipeline.load(small_problem.write(tmp_path, text))
        targets = [job.targets() for job in registry.jobs(problem)]
        for executor in (SerialExecutor(), second):
            second.done.clear()
            try:
                plans.append(solve.solve(problem, targets, executor=executor))
            except TandemError as error:
                reasons.append([issue.to_dict() for issue in error.issues])
        assert second.done == [True] * 3  # the second setup, and the ways out and in of the first one
    item, two = plans
    for mine, own in zip(item.operations, two.operations, strict=True):
        for name in ("q", "approach", "retreat"):
            (rows,), (same,) = getattr(mine, name).values(), getattr(own, name).values()
            assert rows.tobytes() == same.tobytes()
        assert mine.time.tobytes() == own.time.tobytes()
        assert mine.issues == own.issues
    assert list(item.metrics) == list(two.metrics)
    assert reasons[0] == reasons[1]
    assert {reason["code"] for reason in reasons[0]} == {"motion.no_reach"}


def test_there_is_a_process_at_least() -> None:
    with pytest.raises(ValueError, match="got 0 processes"), open_executor(0, WARM_UP):
        pass


PARENT = """
import os, sys, time
from planner.pipeline import WARM_UP
from planner.runtime.second_process import open_executor
from tests.runtime.test_second_process import sleeps
with open_executor(2, WARM_UP) as executor:
    call = executor.submit(sleeps)
    print(executor._process.pid, flush=True)
    next(call)
"""


def sleeps() -> Iterator[object]:
    time.sleep(600.0)
    yield None


@pytest.mark.sampled(every=3)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_it_ends_with_its_parent(number: signal.Signals) -> None:
    parent = subprocess.Popen(
        [sys.executable, "-c", PARENT], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    )
    assert parent.stdout is not None
    pid = int(parent.stdout.readline())
    assert Path(f"/proc/{pid}").exists()
    parent.send_signal(number)
    parent.communicate(timeout=30)
    for _ in range(200):
        if not Path(f"/proc/{pid}").exists():
            return
        time.sleep(0.05)
    pytest.fail("the second process is still there")
