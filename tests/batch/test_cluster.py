"""A Dask cluster of real scheduler and worker processes: the same results, and workers that disappear."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from planner import pipeline
from planner.batch import cluster as cluster_module
from planner.batch import run as batch
from planner.batch.cluster import ClusterPlanners
from planner.batch.job import JobEvent, JobFinished, JobIssues, JobProgress, JobResult
from planner.batch.run import BatchSettings
from planner.batch.run import make_bundled_job as job_of
from planner.batch.workers import BatchWorkers
from planner.cli import command_line
from planner.issues import TandemError
from tests import small_problem
from tests.batch.jobs import FAULTY, ROOT, alive, content, items, job

ENVIRONMENT = {
    **os.environ,
    "PYTHONPATH": str(ROOT),
    "OMP_NUM_THREADS": "1",
    "MALLOC_TRIM_THRESHOLD_": "65536",  # as Dask's nanny sets it
}


class Machines:
    """A scheduler and workers, each a process; workers come and go."""

    def __init__(self, folder: Path, port: int = 0) -> None:
        self._folder = folder
        self.workers: list[subprocess.Popen[bytes]] = []
        note = folder / "scheduler.json"
        note.unlink(missing_ok=True)
        options = ["--port", str(port), "--no-dashboard", "--scheduler-file", str(note)]
        self.scheduler = self._start("distributed.cli.dask_scheduler", "--host", "127.0.0.1", *options)
        until = time.monotonic() + 60.0
        while not (note.exists() and note.read_text()) and time.monotonic() < until:
            time.sleep(0.05)
        import json

        self.address = json.loads(note.read_text())["address"]

    def add(self) -> subprocess.Popen[bytes]:
        options = ["--nthreads", "1", "--no-nanny", "--memory-limit", "0", "--no-dashboard"]
        worker = self._start("distributed.cli.dask_worker", self.address, *options)
        self.workers.append(worker)
        return worker

    def _start(self, module: str, *arguments: str) -> subprocess.Popen[bytes]:
        with (self._folder / "log.txt").open("ab") as log:
            command = [sys.executable, "-P", "-m", module, *arguments]
            return subprocess.Popen(command, env=ENVIRONMENT, cwd=self._folder, stdout=log, stderr=log)

    def end(self) -> None:
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()


@pytest.fixture(scope="module")
def machines(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Machines]:
    made = Machines(tmp_path_factory.mktemp("machines"))
    made.add()
    yield made
    made.end()


def collect_results(team: ClusterPlanners, count: int) -> tuple[dict[str, JobResult], list[JobEvent]]:
    events: list[JobEvent] = []
    until = time.monotonic() + 60.0
    while sum(isinstance(e, JobFinished) for e in events) < count and time.monotonic() < until:
        events += team.events(1.0)
    return {e.name: e.done for e in events if isinstance(e, JobFinished)}, events


def test_jobs_fail_alone_and_are_heard_of(machines: Machines, tmp_path: Path) -> None:
    with ClusterPlanners(machines.address, module=FAULTY) as team:
        for made in (job("exit-1"), job("hang-1", timeout_s=0.5), job("good-1"), job("hang-2")):
            team.start(made, tmp_path / made.name)
        assert team.ahead >= 2
        done, heard = collect_results(team, 3)
        assert {n: d.state for n, d in done.items()} == {
            "exit-1": "crashed",
            "hang-1": "timeout",
            "good-1": "verified",
        }
        assert "ended with code 7" in done["exit-1"].issues[0].message
        while not any(isinstance(e, JobProgress) and e.name == "hang-2" for e in heard):
            heard += team.events(1.0)
        assert team.cancel("hang-2")
        assert collect_results(team, 1)[0]["hang-2"].state == "cancelled"
        assert not team.busy
        team.start(job("good-2"), tmp_path / "good-2")
        assert collect_results(team, 1)[0]["good-2"].state == "verified"
        _, planned_in = (tmp_path / "good-2" / "report.html").read_text().split()
        assert b"MALLOC_TRIM_THRESHOLD_" not in Path(f"/proc/{planned_in}/environ").read_bytes()
    assert any(isinstance(e, JobIssues) and e.issues[0].code == "mesh.unit" for e in heard)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["exit-1", "good-1", "good-2", "hang-1"]
    assert "batch.crashed" in (tmp_path / "exit-1" / "report.html").read_text()


def test_results_are_those_of_one_machine(machines: Machines, tmp_path: Path) -> None:
    small_problem.write(tmp_path)
    made = job_of("small", pipeline.load(tmp_path / "problem.yaml"))
    with ClusterPlanners(machines.address) as team:
        team.start(made, tmp_path / "far" / "small")
        assert collect_results(team, 1)[0]["small"].state == "verified"
    command_line.plan(tmp_path / "problem.yaml", tmp_path / "near" / "small")
    assert content(tmp_path / "far") == content(tmp_path / "near")
    assert (tmp_path / "far" / "small" / "programs").is_dir()


def test_a_batch_goes_on_when_a_worker_disappears(machines: Machines, tmp_path: Path) -> None:
    result = items(tmp_path, [f"slow-{i:02d}" for i in range(24)])
    lost = machines.add()
    ended_there = 0
    events: list[JobEvent] = []
    with batch.claimed_folder(tmp_path / "out"), ClusterPlanners(machines.address, module=FAULTY) as team:
        team._client.wait_for_workers(2, timeout=60)

        def tell(event: JobEvent) -> None:
            nonlocal ended_there
            events.append(event)
            ended_there += isinstance(event, JobFinished)
            if ended_there == 6 and lost.poll() is None:
                os.kill(lost.pid, signal.SIGKILL)
                lost.wait()

        rows = batch.run_batch(result, tmp_path / "out", team, BatchSettings(), tell)
    assert [row.done.state for row in rows] == ["verified"] * 24
    assert lost.returncode == -signal.SIGKILL
    assert sum(isinstance(e, JobFinished) for e in events) == 24
    texts = [(tmp_path / "out" / item.name / "report.html").read_text() for item in result]
    pids = {int(text.split()[1]) for text in texts}
    assert len(pids) >= 2  # both planned some
    assert sum(alive(pid) for pid in pids) == 1  # and what the lost one planned with is gone
    kept = batch.claimed_folder(tmp_path / "out")
    with (
        kept,
        BatchWorkers(1, module=FAULTY) as workers,
    ):  # the cluster's results are a batch's like any other
        again = batch.run_batch(result, tmp_path / "out", workers, BatchSettings(resume=True), lambda _: None)
    assert all(row.is_kept for row in again)


def test_other_versions_are_told(machines: Machines, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster_module, "all_versions", lambda: {"tandem": "9.9"})
    with ClusterPlanners(machines.address, module=FAULTY) as team:
        team.start(job("good"), tmp_path / "good")
        with pytest.raises(TandemError, match=r"instead of 9\.9") as caught:
            collect_results(team, 1)
    assert caught.value.issues[0].code == "batch.versions"


def test_a_cluster_that_is_not_there_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster_module, "CONNECT_TIMEOUT_S", 1.0)
    with pytest.raises(TandemError, match="cannot be reached") as caught:
        ClusterPlanners("tcp://127.0.0.1:1")
    assert caught.value.issues[0].code == "batch.cluster"
    with pytest.raises(TandemError, match="or local") as caught:
        ClusterPlanners("127.0.0.1:8786")
    assert caught.value.issues[0].code == "batch.field"
    monkeypatch.setattr(cluster_module.importlib.util, "find_spec", lambda _: None)
    with pytest.raises(TandemError, match=r"tandem-planner\[cluster\]") as caught:
        ClusterPlanners("local")
    assert caught.value.issues[0].code == "batch.install"


def test_a_scheduler_that_goes_away_is_told(tmp_path: Path) -> None:
    other = Machines(tmp_path)
    try:
        other.add()
        with ClusterPlanners(other.address, module=FAULTY) as team:
            team.start(job("hang-1"), tmp_path / "out" / "hang-1")
            while not any(isinstance(e, JobProgress) for e in team.events(1.0)):
                pass
            other.scheduler.kill()
            with pytest.raises(TandemError, match="scheduler is lost"):
                collect_results(team, 1)
    finally:
        other.end()


def test_a_result_that_is_lost_on_its_way_is_told(
    machines: Machines, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The connection goes between the end of a job and its result."""
    from distributed.client import Future, FutureCancelledError

    def lost(self: Future) -> None:
        raise FutureCancelledError(self.key, "scheduler-connection-lost")

    with ClusterPlanners(machines.address, module=FAULTY) as team:
        monkeypatch.setattr(Future, "result", lost)
        team.start(job("good-1"), tmp_path / "good-1")
        with pytest.raises(TandemError, match="scheduler is lost"):
            collect_results(team, 1)
