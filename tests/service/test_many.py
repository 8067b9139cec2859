"""A thousand requests at once: no 500, nothing leaks, no job is lost."""

from __future__ import annotations

import asyncio
import collections
import random
import resource
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import httpx
import pytest

from tests.service.support import TABLE, Process, named_problem

COUNT = 1000


@pytest.fixture
def server_process(tmp_path: Path) -> Iterator[Process]:
    data = tmp_path / "data"
    process = Process(data, module="tests.service.fake_team", arguments=(str(data), "")).wait()
    yield process
    process.stop()


POOL = 40
"""Threads that answer requests: what AnyIO has where nothing else is said."""


def open_files(process: Process) -> int:
    """Open files of a process."""
    return len(list(Path(f"/proc/{process.pid}/fd").iterdir()))


def memory_mb(process: Process) -> float:
    return int(Path(f"/proc/{process.pid}/statm").read_text().split()[1]) * resource.getpagesize() / 1e6


async def storm(url: str, jobs: dict[str, str]) -> collections.Counter[tuple[str, int]]:
    """Uploads, good and bad, reads and streams, all begun at once; ``jobs`` {id: name} that were accepted."""
    seen: collections.Counter[tuple[str, int]] = collections.Counter()
    limits = httpx.Limits(max_connections=COUNT, max_keepalive_connections=0)
    async with httpx.AsyncClient(base_url=url, timeout=600.0, limits=limits) as client:

        async def upload(number: int) -> None:
            name = f"many{number % 100}"
            files = [("problem", ("p.yaml", named_problem(name))), ("files", ("targets.csv", TABLE))]
            answer = await client.post("/v1/jobs", files=files)
            seen["upload", answer.status_code] += 1
            if answer.status_code == 201:
                jobs[answer.json()["id"]] = name

        async def broken(number: int) -> None:
            files = [("problem", ("p.yaml", named_problem("broken").replace("robot", f"robo{number}")))]
            seen["broken", (await client.post("/v1/jobs", files=files)).status_code] += 1

        async def read(path: str) -> None:
            seen[path, (await client.get(path)).status_code] += 1

        async def leave(number: int) -> None:
            """Hang up in the middle of an upload."""
            reader, writer = await asyncio.open_connection("127.0.0.1", int(url.rsplit(":", 1)[1]))
            head = "POST /v1/jobs HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 100000\r\n"
            writer.write(
                f"{head}Content-Type: multipart/form-data; boundary=b\r\n\r\n--b\r\n{number}".encode()
            )
            await writer.drain()
            writer.close()
            seen["leave", 0] += 1
            del reader

        kinds = [upload] * 5 + [broken] + [lambda n: read("/v1/health")] + [lambda n: read("/v1/jobs")]
        kinds += [lambda n: read(f"/v1/jobs/{'0' * 32}/events"), leave]
        order = [kinds[number % len(kinds)](number) for number in range(COUNT)]
        random.Random(3).shuffle(order)
        await asyncio.gather(*order)
    return seen


def run(url: str, jobs: dict[str, str]) -> collections.Counter[tuple[str, int]]:
    """Run :func:`storm` in a thread, because the browser of the page tests keeps a loop in this one."""
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(asyncio.run, storm(url, jobs)).result()


@pytest.mark.long
def test_a_thousand_requests_at_once(server_process: Process, tmp_path: Path) -> None:
    with httpx.Client(base_url=server_process.url, timeout=600.0) as client:
        run(server_process.url, {})  # pools and readers have started
        files, megabytes = open_files(server_process), memory_mb(server_process)
        jobs: dict[str, str] = {}
        began = time.monotonic()
        seen = run(server_process.url, jobs)
        print(f"{COUNT} requests in {time.monotonic() - began:.1f} s: {dict(seen)}")
        assert not [key for key in seen if key[1] >= 500], seen
        assert sum(seen.values()) == COUNT
        assert seen["upload", 201] == len(jobs) == COUNT // 2
        assert seen["broken", 422] == COUNT // 10
        assert seen["/v1/health", 200] == COUNT // 10
        until = time.monotonic() + 300.0
        while time.monotonic() < until:
            states = {job: client.get(f"/v1/jobs/{job}").json() for job in jobs}
            if all(state["state"] == "verified" for state in states.values()):
                break
            time.sleep(0.5)
        assert {state["state"] for state in states.values()} == {"verified"}
        assert {job: state["name"] for job, state in states.items()} == jobs
        time.sleep(2.0)
        print(
            f"files {files} -> {open_files(server_process)}, "
            f"memory {megabytes:.0f} -> {memory_mb(server_process):.0f} MB"
        )
        # each thread of the pool that has asked the store keeps a connection, of two files; how many have
        # by the first measurement depends on the machine
        assert open_files(server_process) <= files + 20 + 2 * POOL
        assert memory_mb(server_process) <= megabytes * 1.25 + 20
    assert not list((tmp_path / "data" / "files" / "incoming").iterdir())
    assert "Traceback" not in server_process.log.read_text()
