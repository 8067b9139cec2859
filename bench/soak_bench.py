"""A service under mixed load: memory, open files and threads of all its processes when warm and at the end,
how long answers take, and whether a job is lost.

``tandem serve`` as a process of its own, which plans for real; ten clients at once send jobs, batches,
sweeps and what is refused, keep drafts, look at problems and cells, list, search, follow, read, hang up,
cancel, delete and release.
``TANDEM_SOAK_MINUTES`` says how long, 2 where it says nothing.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import random
import socket
import statistics
import tempfile
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx

from bench.proc import child_processes
from planner.service import bundled_examples
from tests import small_problem
from tests.service.support import Process

MINUTES = "TANDEM_SOAK_MINUTES"
WARM_SHARE = 0.25
"""Fraction of the time after which processes, pools and caches count as warm."""
SAMPLE_S = 5.0
"""Interval [s] of the resource samples from then on: medians of the first and the last third."""
KEPT = 60
"""Number of jobs that are kept; older ones are deleted, as in a workshop that runs for long."""
MAX_QUEUED = 20
"""Maximum number of waiting jobs at which clients still send.

A busy machine plans fewer, and all must end.
"""
LATE = 0
"""Status of requests without an answer within the client's time limit, 120 s."""
CELLS = ("wing", "column_capital", "flank_wall", "shell_piece_held")
"""Bundled problems whose cells and quick checks are requested."""
Files = list[tuple[str, tuple[str, bytes]]]


@dataclass(frozen=True)
class ProcessUsage:
    """Resources of a service's processes: memory [MB], shared pages divided, open files and threads."""

    memory_mb: float
    files: int
    threads: int
    processes: int


def run() -> list[dict[str, Any]]:
    """Return rows of median and 99th percentile [s] of each kind of request, and one of the resources.

    Raises:
        RuntimeError: A job was lost or the service failed.
    """
    minutes = float(os.environ.get(MINUTES, "2"))
    with tempfile.TemporaryDirectory() as folder, _serve(Path(folder)) as (pid, url):
        soak = _Soak(url, Path(folder))
        try:
            soak.start()
            time.sleep(60.0 * minutes * WARM_SHARE)
            end = time.monotonic() + 60.0 * minutes * (1.0 - WARM_SHARE)
            seen = [_process_usage(pid)]
            while time.monotonic() < end:
                time.sleep(SAMPLE_S)
                seen.append(_process_usage(pid))
        finally:
            soak.end()
        states = soak.outcome_counts()
    third = -(-len(seen) // 3)
    return [*soak.rows(), _row(minutes, _middle(seen[:third]), _middle(seen[-third:]), states, soak)]


@contextlib.contextmanager
def _serve(folder: Path) -> Iterator[tuple[int, str]]:
    process = Process(folder / "data", "--requests-per-s", "1000").wait()
    try:
        yield process.pid, process.url
    finally:
        process.stop()
    if "Traceback" in (said := process.log.read_text()):
        raise RuntimeError(f"the service failed: {said[-2000:]}")


def _process_usage(pid: int) -> ProcessUsage:
    """Of a process and all that it started."""
    family = [pid, *child_processes(pid)]
    memory, files, threads = 0.0, 0, 0
    for item in family:
        with contextlib.suppress(OSError):
            at = Path(f"/proc/{item}")
            said = dict(line.split(":") for line in (at / "smaps_rollup").read_text().splitlines()[1:])
            memory += int(said["Pss"].split()[0]) * 1.024e-3
            files += len(list((at / "fd").iterdir()))
            threads += len(list((at / "task").iterdir()))
    return ProcessUsage(memory, files, threads, len(family))


def _middle(seen: list[ProcessUsage]) -> ProcessUsage:
    """The median of each: a worker that plans holds a few hundred MB more for a while."""
    return ProcessUsage(
        statistics.median(item.memory_mb for item in seen),
        statistics.median_low([item.files for item in seen]),
        statistics.median_low([item.threads for item in seen]),
        statistics.median_low([item.processes for item in seen]),
    )


class _Soak:
    """Clients of a service that run until they are stopped."""

    def __init__(self, url: str, folder: Path) -> None:
        self._url = url
        self._over = threading.Event()
        self._times: dict[str, list[float]] = defaultdict(list)
        self._numbers = itertools.count()
        self._jobs: list[str] = []
        self._gone: set[str] = set()
        self.answers: Counter[tuple[str, int]] = Counter()
        self._bundles = {name: _bundle(name) for name in CELLS}
        self._clients = [
            threading.Thread(target=self._go, args=(seed, what, pause), daemon=True)
            for seed, (what, pause) in enumerate(
                [
                    (self._submit, 4.0), (self._follow, 1.0), (self._quick_check, 3.0), (self._cell, 6.0),
                    (self._list, 0.2), (self._read, 0.3), (self._wrong, 1.0), (self._tidy, 2.0),
                    (self._draft, 1.0), (self._many, 20.0),
                ]
            )
        ]  # fmt: skip

    def start(self) -> None:
        for client in self._clients:
            client.start()

    def end(self) -> None:
        self._over.set()
        for client in self._clients:
            client.join(120.0)

    def outcome_counts(self) -> Counter[str]:
        """How many of the jobs that were accepted and not deleted ended how."""
        kept = [job for job in self._jobs if job not in self._gone]
        with httpx.Client(base_url=self._url, timeout=60.0) as client:
            for _ in range(1200):
                states = Counter(client.get(f"/v1/jobs/{job}").json().get("state", "lost") for job in kept)
                if not states["queued"] + states["running"]:
                    return states
                time.sleep(0.5)
        raise RuntimeError(f"jobs do not end: {dict(states)}")

    def rows(self) -> Iterator[dict[str, Any]]:
        for kind, times in sorted(self._times.items()):
            note = f"wall time of {len(times)} requests beside all others"
            p99 = sorted(times)[int(0.99 * (len(times) - 1))]
            median = statistics.median(times)
            yield {"name": f"soak: {kind}", "median_s": median, "p99_s": p99, "note": note}

    def _go(self, seed: int, what: Callable[[httpx.Client, random.Random], None], pause_s: float) -> None:
        given = random.Random(seed)
        with httpx.Client(base_url=self._url, timeout=120.0) as client:
            while not self._over.wait(given.uniform(0.5, 1.5) * pause_s):
                try:
                    what(client, given)
                except httpx.TimeoutException:
                    self.answers[what.__name__.strip("_"), LATE] += 1

    def _ask(self, client: httpx.Client, kind: str, method: str, path: str, **more: Any) -> httpx.Response:
        start_s = time.perf_counter()
        answer = client.request(method, path, **more)
        self._times[kind].append(time.perf_counter() - start_s)
        self.answers[kind, answer.status_code] += 1
        return answer

    def _upload(self, problems: int = 1) -> Files:
        """Return the given number of new problems with their table."""
        rows = "\n".join([small_problem.COLUMNS, *small_problem.ROWS]).encode()
        texts = [
            small_problem.PROBLEM.replace("name: small", f"name: soak{next(self._numbers)}")
            for _ in range(problems)
        ]
        parts = [("problem", (f"{k}.yaml", text.encode())) for k, text in enumerate(texts)]
        return [*parts, ("files", ("targets.csv", rows))]

    def _full(self, client: httpx.Client) -> bool:
        return int(self._ask(client, "health", "GET", "/v1/health").json()["queued"]) > MAX_QUEUED

    def _submit(self, client: httpx.Client, given: random.Random) -> None:
        if self._full(client):
            return
        files = self._upload()
        answer = self._ask(client, "submit", "POST", "/v1/jobs", files=files)
        if answer.status_code == 201:
            self._jobs.append(answer.json()["id"])
        if given.random() < 0.1:
            self._ask(client, "cancel", "POST", f"/v1/jobs/{self._jobs[-1]}/cancel")

    def _many(self, client: httpx.Client, given: random.Random) -> None:
        """Send a batch or a sweep; now and then one of its problems cannot be read."""
        if self._full(client):
            return
        files, path = self._upload(3), "/v1/batches"
        if given.random() < 0.3:
            files[1] = ("problem", ("1.yaml", b"]"))
        elif given.random() < 0.5:
            files = self._upload()
            path = "/v1/sweeps?field=operations.0.feed_mm_s&value=20&value=30"
        answer = self._ask(client, "many", "POST", path, files=files)
        if answer.status_code == 201:
            self._jobs += [job["id"] for job in answer.json()["jobs"]]

    def _draft(self, client: httpx.Client, given: random.Random) -> None:
        """A draft that is kept, saved by two, listed, and deleted."""
        made = self._ask(client, "draft", "POST", "/v1/drafts?title=soak", files=self._upload())
        if made.status_code != 201:
            return
        path = f"/v1/drafts/{made.json()['id']}"
        for _ in range(given.randrange(4)):
            self._ask(client, "draft", "PUT", path, files=self._upload(), headers={"If-Match": '"1"'})
        self._ask(client, "draft", "GET", "/v1/drafts?limit=5")
        self._ask(client, "draft", "DELETE", path)

    def _follow(self, client: httpx.Client, given: random.Random) -> None:
        """The events of a job; every third time the listener hangs up after the first."""
        if not self._jobs:
            return
        with client.stream("GET", f"/v1/jobs/{self._jobs[-1]}/events") as stream:
            self.answers["events", stream.status_code] += 1
            leave = given.random() < 0.3
            for _ in stream.iter_lines():
                if leave or self._over.is_set():
                    break

    def _quick_check(self, client: httpx.Client, given: random.Random) -> None:
        files = self._bundles[given.choice(CELLS)]
        self._ask(client, "check without reach", "POST", "/v1/check?reach=false", files=files)

    def _cell(self, client: httpx.Client, given: random.Random) -> None:
        self._ask(client, "cell in 3D", "POST", "/v1/cell", files=self._bundles[given.choice(CELLS)])

    def _list(self, client: httpx.Client, given: random.Random) -> None:
        query = given.choice(["", "search=soak1", "sort=title", "state=verified", "limit=200"])
        self._ask(client, "list", "GET", f"/v1/jobs?{query}")

    def _read(self, client: httpx.Client, given: random.Random) -> None:
        job = given.choice(self._jobs[-KEPT:] or ["0" * 32])
        name = given.choice(["report.html", "replay.html", "motion.json", "proof.json"])
        kind = given.choice(["job", "programs.zip", f"files/{name}"])
        path = f"/v1/jobs/{job}" if kind == "job" else f"/v1/jobs/{job}/{kind}"
        self._ask(client, "file" if "files" in kind else kind, "GET", path)

    def _wrong(self, client: httpx.Client, given: random.Random) -> None:
        """Send requests that are refused, too long, or broken off."""
        kind = given.randrange(4)
        if kind == 0:
            text = small_problem.PROBLEM.replace("robot:", "robo:").encode()
            self._ask(client, "refused", "POST", "/v1/jobs", files=[("problem", ("p.yaml", text))])
        elif kind == 1:
            self._ask(client, "refused", "GET", f"/v1/jobs/{given.getrandbits(128):032x}")
        elif kind == 2:
            address = self._url.removeprefix("http://").split(":")
            with socket.create_connection((address[0], int(address[1]))) as one:
                head = "POST /v1/jobs HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 100000\r\n"
                one.sendall(f"{head}Content-Type: multipart/form-data; boundary=b\r\n\r\n--b\r\n".encode())
        else:
            noise = given.randbytes(200_000)
            files: Files = [("problem", ("p.yaml", noise)), ("files", ("targets.csv", noise))]
            self._ask(client, "refused", "POST", "/v1/jobs", files=files)

    def _tidy(self, client: httpx.Client, given: random.Random) -> None:
        """Release and withdraw now and then; delete old jobs."""
        if len(self._jobs) > 2 and given.random() < 0.3:
            job = given.choice(self._jobs[-KEPT:])
            said = {"note": "soak", "name": "A. Tester"}
            if self._ask(client, "release", "POST", f"/v1/jobs/{job}/release", json=said).status_code < 300:
                why = {"reason": "soak", "name": "A. Tester"}
                self._ask(client, "release", "POST", f"/v1/jobs/{job}/withdraw", json=why)
        old = [job for job in self._jobs[:-KEPT] if job not in self._gone]
        for job in old[:3]:
            if self._ask(client, "delete", "DELETE", f"/v1/jobs/{job}").status_code == 204:
                self._gone.add(job)


def _bundle(name: str) -> Files:
    """A bundled problem with its files, as an upload."""
    known = bundled_examples.problem(name)
    files = [("files", (file, bundled_examples.file(name, file).read_bytes())) for file in known["files"]]
    return [("problem", ("problem.json", json.dumps(known["problem"]).encode())), *files]


def _row(
    minutes: float, warm: ProcessUsage, last: ProcessUsage, states: Counter[str], soak: _Soak
) -> dict[str, Any]:
    failed = {kind: count for kind, count in soak.answers.items() if kind[1] >= 500 and kind[1] != 503}
    if failed or states["lost"] or states["crashed"]:
        raise RuntimeError(f"answers {dict(soak.answers)}, jobs {dict(states)}")
    said = ", ".join(f"{kind} {status}: {count}" for (kind, status), count in sorted(soak.answers.items()))
    note = (
        f"answers: {said}; jobs {dict(states)}; when warm and at the end: {warm.memory_mb:.0f} and "
        f"{last.memory_mb:.0f} MB, {warm.files} and {last.files} open files, {warm.threads} and "
        f"{last.threads} threads, {warm.processes} and {last.processes} processes"
    )
    return {
        "name": f"soak of {minutes:g} minutes: memory",
        "ratio": last.memory_mb / warm.memory_mb,
        "note": note,
    }
