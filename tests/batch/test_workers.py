"""Workers: a fault of one job does not affect others, and a result folder is complete or absent."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from planner.batch.job import BatchJob, JobFinished, JobIssues, JobProgress, JobRecord, JobResult
from planner.batch.workers import BatchWorkers
from planner.issues import Issue, TandemError
from tests.batch.jobs import FAULTY, ROOT, alive, job


def run(workers: BatchWorkers, count: int, patience_s: float = 60.0) -> dict[str, JobResult]:
    done: dict[str, JobResult] = {}
    until = time.monotonic() + patience_s
    while len(done) < count and time.monotonic() < until:
        done |= {e.name: e.done for e in workers.events(1.0) if isinstance(e, JobFinished)}
    return done


@pytest.fixture(scope="module")
def workers() -> Iterator[BatchWorkers]:
    with BatchWorkers(1, module=FAULTY) as made:
        yield made


@pytest.mark.parametrize(
    ("kind", "expected_text"),
    [
        ("exit", "ended with code 7 (the library gave up)"),
        ("kill", "was ended by SIGKILL"),
        ("segfault", "was ended by SIGSEGV"),
    ],
)
def test_a_crash_fails_its_job_alone(
    workers: BatchWorkers, tmp_path: Path, kind: str, expected_text: str
) -> None:
    before = workers.pids
    for name in (f"{kind}-1", "good-1"):
        workers.start(job(name), tmp_path / name)
    done = run(workers, 2)
    assert {name: d.state for name, d in done.items()} == {f"{kind}-1": "crashed", "good-1": "verified"}
    (issue,) = done[f"{kind}-1"].issues
    assert issue.code == "batch.crashed"
    assert expected_text in issue.message
    assert issue.hint is not None
    assert [p.name for p in (tmp_path / f"{kind}-1").iterdir()] == ["report.html"]
    assert "batch.crashed" in (tmp_path / f"{kind}-1" / "report.html").read_text()
    assert not set(before) & set(workers.pids)
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(done)


def test_a_time_out_and_a_cancelled_job_end_alone(workers: BatchWorkers, tmp_path: Path) -> None:
    workers.start(job("hang-1", timeout_s=0.3), tmp_path / "hang-1")
    workers.start(job("hang-2"), tmp_path / "hang-2")
    workers.start(job("hang-3"), tmp_path / "hang-3")
    workers.start(job("good-2"), tmp_path / "good-2")
    assert workers.cancel("hang-3")
    done = run(workers, 2)
    assert done["hang-1"].state == "timeout"
    assert done["hang-3"].state == "cancelled"
    (issue,) = done["hang-1"].issues
    assert (issue.code, issue.limit, issue.unit) == ("batch.timeout", 0.3, "s")
    assert done["hang-1"].seconds >= 0.3
    while not any(isinstance(e, JobProgress) and e.name == "hang-2" for e in workers.events(1.0)):
        pass
    assert workers.cancel("hang-2")
    done = run(workers, 2)
    assert done["hang-2"].issues[0].code == "batch.cancelled"
    assert done["good-2"].state == "verified"
    assert not workers.cancel("hang-2")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["good-2", "hang-1"]


def test_too_much_memory_ends_a_job(tmp_path: Path) -> None:
    with BatchWorkers(1, memory_mb=600.0, module=FAULTY) as workers:
        workers.start(job("hog-1"), tmp_path / "hog-1")
        done = run(workers, 1)
    assert done["hog-1"].state == "memory"
    (issue,) = done["hog-1"].issues
    assert (issue.code, issue.limit, issue.unit) == ("batch.memory", 600.0, "MB")


def test_a_job_is_not_blamed_for_what_others_left(workers: BatchWorkers, tmp_path: Path) -> None:
    workers.start(job("keep-1"), tmp_path / "keep-1")
    run(workers, 1)
    (pid,) = workers.pids
    limit = workers.memory_mb() - 100.0
    workers.start(job("good-3", memory_mb=limit), tmp_path / "good-3")
    workers.start(job("hang-4", timeout_s=1.0, memory_mb=limit), tmp_path / "hang-4")
    done = run(workers, 2)
    assert done["good-3"].state == "verified"
    assert done["hang-4"].issues[0].code == "batch.timeout"
    assert (pid,) != workers.pids


def test_what_is_heard_of_a_job(workers: BatchWorkers, tmp_path: Path) -> None:
    record = JobRecord(tmp_path / "records" / "good.json", {"identity": "mine"})
    known = BatchJob("good", {"problem.yaml": b""}, origins={"problem.yaml": "mine.yaml"})
    workers.start(known, tmp_path / "good", record)
    with pytest.raises(ValueError, match="is running"):
        workers.start(known, tmp_path / "other")
    heard = []
    while not heard or not isinstance(heard[-1], JobFinished):
        heard += list(workers.events(1.0))
    assert [type(e) for e in heard] == [JobProgress, JobIssues, JobFinished]
    assert heard[0] == JobProgress("good", "fault", 0.5)
    assert isinstance(heard[-1], JobFinished)
    read = JobRecord.read(record.path)
    assert read is not None
    assert read[0] == heard[-1].done
    assert read[1]["identity"] == "mine"
    assert JobRecord.read(tmp_path / "none.json") is None
    assert heard[-1].done.metrics == {"targets": 3.0}


def test_an_error_of_ours_is_told_as_such(workers: BatchWorkers, tmp_path: Path) -> None:
    workers.start(job("raise"), tmp_path / "raise")
    done = run(workers, 1)["raise"]
    assert (done.state, done.issues[0].code) == ("crashed", "internal.error")
    assert "ZeroDivisionError: in problem.yaml" in done.issues[0].message


def test_a_result_is_replaced_and_nothing_else(workers: BatchWorkers, tmp_path: Path) -> None:
    folder = tmp_path / "good"
    for _ in range(2):
        workers.start(job("good"), folder)
        assert run(workers, 1)["good"].state == "verified"
    (folder / "mine.txt").write_text("mine")
    with pytest.raises(TandemError, match=r"contains mine\.txt"):
        workers.start(job("good"), folder)
    with pytest.raises(TandemError, match="not a folder"):
        workers.start(job("good"), folder / "mine.txt")
    assert (folder / "mine.txt").read_text() == "mine"


def test_a_full_disk_fails_a_job_alone(
    workers: BatchWorkers, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    for step in ("write_bytes", "rename"):
        with monkeypatch.context() as patch:
            patch.setattr(Path, step, full)
            workers.start(job("good-4"), tmp_path / "good-4")
            done = run(workers, 1)["good-4"]
        assert (done.state, done.issues[-1].code) == ("crashed", "output.disk_full")
    assert list(tmp_path.iterdir()) == []
    workers.start(job("good-4"), tmp_path / "good-4")
    assert run(workers, 1)["good-4"].state == "verified"


def test_workers_that_do_not_start_are_told(tmp_path: Path) -> None:
    with BatchWorkers(1, module="tests.batch.no_such_module") as workers:
        workers.start(job("good"), tmp_path / "good")
        with pytest.raises(TandemError, match="No module named") as caught:
            run(workers, 1)
    assert caught.value.issues[0].code == "batch.worker"


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_workers_end_with_their_parent(tmp_path: Path, number: signal.Signals) -> None:
    code = f"""
from pathlib import Path
from planner.batch.job import BatchJob, JobProgress
from planner.batch.workers import BatchWorkers
with BatchWorkers(2, module={FAULTY!r}) as workers:
    for name in ("hang-1", "hang-2"):
        workers.start(BatchJob(name, {{"problem.yaml": b""}}), Path({str(tmp_path)!r}) / name)
    begun = set()
    while len(begun) < 2:
        begun |= {{e.name for e in workers.events(1.0) if isinstance(e, JobProgress)}}
    print(*workers.pids, flush=True)
    while True:
        list(workers.events(1.0))
"""
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, cwd=ROOT)
    assert parent.stdout is not None
    pids = [int(pid) for pid in parent.stdout.readline().split()]
    assert len(pids) == 2
    parent.send_signal(number)
    parent.communicate(timeout=30)
    until = time.monotonic() + 10.0
    while any(alive(pid) for pid in pids) and time.monotonic() < until:
        time.sleep(0.02)
    assert not any(alive(pid) for pid in pids)
    assert all(p.name.startswith(".tandem-") for p in tmp_path.iterdir())


@pytest.mark.parametrize("name", ["", "..", ".hidden", "a/b", "a b", "a\0", "é", "x" * 101])
def test_names_that_are_no_folders_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match="not a safe folder name"):
        job(name)


@pytest.mark.parametrize("name", ["/etc/passwd", "../x", "a/../b", "./a", "a//b"])
def test_files_outside_a_job_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match="not a relative file name"):
        BatchJob("a", {"problem.yaml": b"", name: b""})


def test_a_job_needs_its_problem_and_sensible_limits() -> None:
    with pytest.raises(ValueError, match=r"lack problem\.yaml"):
        BatchJob("a", {})
    with pytest.raises(ValueError, match="above 0"):
        job("a", timeout_s=0.0)
    with pytest.raises(ValueError, match="at least 1"):
        BatchWorkers(0)


def test_identity_is_of_files_and_versions() -> None:
    one = BatchJob("a", {"problem.yaml": b"x", "files/1": b"y"})
    same = BatchJob("b", {"files/1": b"y", "problem.yaml": b"x"}, timeout_s=3.0)
    other = BatchJob("a", {"problem.yaml": b"x", "files/1": b"z"})
    versions = {"tandem": "1"}
    assert one.identity(versions) == same.identity(versions)
    assert one.identity(versions) != other.identity(versions)
    assert one.identity(versions) != one.identity({"tandem": "2"})


def test_done_is_plain_data() -> None:
    done = JobResult("a", "unproven", (Issue("mesh.unit", "m", value=1.0),), {"cycle_s": 1.5}, 2.0)
    assert JobResult.from_dict(json.loads(json.dumps(done.to_dict()))) == done
    with pytest.raises(ValueError, match="allowed"):
        JobResult.from_dict({**done.to_dict(), "state": "lost"})
