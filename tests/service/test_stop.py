"""SIGTERM: a service that plans, checks and streams ends by itself within seconds.

It leaves no process behind, and its job waits for the next start.
"""

from __future__ import annotations

import math
import os
import threading
from pathlib import Path

import planner
from planner import Client
from planner.issues import TandemError
from planner.service.jobs import Jobs
from planner.service.models import Database, default_url
from planner.service.security import ServiceLimits
from tests.service.support import Process, wait_until


def children(pid: int) -> list[int]:
    """Processes of the kernel's list that were started by ``pid``, and those that they started."""
    listed = Path(f"/proc/{pid}/task").glob("*/children")
    own = [int(word) for path in listed for word in path.read_text().split()]
    return own + [item for child in own for item in children(child)]


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


def reading_s(pids: list[int]) -> float:
    """Processor time [s] of those that read what people upload."""
    ticks = 0
    for pid in pids:
        if b"planner.service.upload_processes" in Path(f"/proc/{pid}/cmdline").read_bytes():
            ticks += sum(map(int, Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[11:13]))
    return ticks / os.sysconf("SC_CLK_TCK")


def test_sigterm_ends_all_and_keeps_the_jobs(tmp_path: Path) -> None:
    process = Process(tmp_path / "data").wait()
    client = Client(process.url)
    problem = planner.load("wave_wall")
    job = client.submit(problem)
    wait_until(lambda: client.job(job).get("stage"))  # a worker plans it
    codes: list[str] = []
    before = reading_s(children(process.pid))

    streamed = threading.Event()

    def check() -> None:
        try:
            client.check(problem, reach=True)
        except TandemError as error:
            codes.extend(issue.code for issue in error.issues)

    def stream() -> None:
        for _ in client._stream(job, 0, math.inf):
            streamed.set()
        codes.append("stream")

    threads = [threading.Thread(target=item, daemon=True) for item in (check, stream)]
    for thread in threads:
        thread.start()
    wait_until(lambda: reading_s(children(process.pid)) > before + 0.2)  # the check is under way
    assert streamed.wait(60.0)
    own = children(process.pid)
    assert len(own) >= 2  # the worker and an examiner
    assert process.stop() == 0
    wait_until(lambda: not any(alive(pid) for pid in own), 20.0)
    for thread in threads:
        thread.join(20.0)
    assert sorted(codes) == ["service.stopping", "stream"]
    assert "Traceback" not in process.log.read_text()
    _, found = Jobs(Database(default_url(tmp_path / "data")), ServiceLimits()).get(job)
    assert (found.state, found.attempts) == ("queued", 0)  # it waits for the next start
