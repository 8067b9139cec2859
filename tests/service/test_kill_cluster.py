"""``kill -9`` of two servers on one PostgreSQL with a cluster: no accepted job is lost or duplicated."""

from __future__ import annotations

import json
import random
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from sqlalchemy import select

from planner import Client
from planner.issues import TandemError
from planner.service.models import EVENTS, JOBS, OPEN_STATES, Database
from tests.batch.test_cluster import Machines
from tests.service import postgres
from tests.service.support import Process, free_port, wait_until
from tests.service.test_kill import problems


class WorkshopCluster:
    """Servers, a scheduler and workers, each a process, and the problems sent to them."""

    def __init__(self, folder: Path, servers: int, workers: int) -> None:
        self._folder, self._data = folder, folder / "data"
        self.url, self.accepted = postgres.fresh(folder), list[str]()
        self.current_server = 0  # the server that requests go to
        (folder / "machines").mkdir()
        self.port = free_port()
        self.machines = Machines(folder / "machines", self.port)
        for _ in range(workers):
            self.machines.add()
        self.servers = [self._server(0) for _ in range(servers)]
        for server in self.servers:
            server.wait()
        self.clients = [Client(server.url) for server in self.servers]
        self.database = Database(self.url)

    def _server(self, port: int) -> Process:
        given = (str(self._data), self.url, self.machines.address)
        return Process(self._data, port=port, module="tests.service.fake_team", arguments=given)

    def send(self, count: int) -> None:
        """Send problems from two threads until a server accepts each of them.

        If a server is down, the other one is used. A repeated request has the same key.
        """

        def send_problem(given: tuple[int, object]) -> None:
            number, problem = given
            ending = time.monotonic() + 240.0
            while time.monotonic() < ending:
                asked = self.current_server
                try:
                    self.accepted.append(self.clients[asked].submit(problem, key=f"problem-{number}"))
                    return
                except TandemError:  # that server is down
                    self.current_server = (asked + 1) % len(self.clients)
                time.sleep(0.1)

        with ThreadPoolExecutor(2) as pool:
            list(pool.map(send_problem, enumerate(problems(self._folder, count, "slow_"))))

    def states(self) -> list[str]:
        with self.database.read() as db:
            return list(db.execute(select(JOBS.c.state)).scalars())

    def running(self) -> bool:
        """Whether both servers have jobs that run."""
        with self.database.read() as db:
            hosts = select(JOBS.c.host).where(JOBS.c.state == "running").distinct()
            return len(db.execute(hosts).all()) == len(self.servers)

    def all_ended(self, count: int) -> Callable[[], bool]:
        return lambda: sum(state not in OPEN_STATES for state in self.states()) >= count

    def restart(self, server: int) -> None:
        """kill -9 of a server, and its next start."""
        self.servers[server].kill()
        self.servers[server] = self._server(self.servers[server].port).wait()

    def restart_cluster(self, workers: int) -> None:
        """kill -9 of the scheduler and of all workers, and others at the same address."""
        self.machines.end()
        self.machines = Machines(self._folder / "machines", self.port)
        for _ in range(workers):
            self.machines.add()

    def judge(self, count: int) -> None:
        """All are there once, verified, ended once, each with its own result."""
        assert len(set(self.accepted)) == len(self.accepted) == count
        assert self.states() == ["verified"] * count
        with self.database.read() as db:
            said = db.execute(select(EVENTS.c.job, EVENTS.c.data).where(EVENTS.c.kind == "state")).all()
        ends = sorted(job for job, data in said if json.loads(data)["state"] not in OPEN_STATES)
        assert ends == sorted(self.accepted)
        for job in self.accepted:
            files = self.clients[-1].files(job)
            about, name = files["report.html"].decode(), self.clients[-1].job(job)["name"]
            assert about.split()[0] == f"{name}-{job[:12]}"
            assert f"name: {name}".encode() in files["problem/problem.yaml"]
            assert not any("half" in file for file in files)

    def close(self) -> None:
        self.database.close()
        for server in self.servers:
            server.kill()
        self.machines.end()


@pytest.fixture
def workshop(tmp_path: Path) -> Iterator[WorkshopCluster]:
    made = WorkshopCluster(tmp_path, servers=2, workers=2)
    yield made
    made.close()


@pytest.mark.long
def test_a_server_and_a_worker_of_the_cluster_are_killed(workshop: WorkshopCluster) -> None:
    count = 8
    with ThreadPoolExecutor(1) as pool:
        sent = pool.submit(workshop.send, count)
        wait_until(lambda: sent.done() or workshop.running())
        workshop.servers[0].kill()
        workshop.machines.workers[0].kill()
        sent.result()
    wait_until(workshop.all_ended(count))
    workshop.judge(count)


@pytest.mark.long
def test_servers_workers_and_scheduler_are_killed(workshop: WorkshopCluster) -> None:
    count, moments = 60, random.Random(13)
    with ThreadPoolExecutor(1) as pool:
        sent = pool.submit(workshop.send, count)
        for number, kill in enumerate(
            (
                lambda: workshop.restart(0),
                lambda: (workshop.machines.workers[0].kill(), workshop.machines.add()),
                lambda: workshop.restart_cluster(2),
                lambda: workshop.restart(1),
                lambda: (workshop.restart(0), workshop.restart_cluster(2)),
            )
        ):
            wait_until(workshop.all_ended(8 * number))
            assert not (sent.done() and sent.exception())
            time.sleep(moments.uniform(0.0, 1.0))
            kill()
        sent.result()
    wait_until(workshop.all_ended(count), 300.0)
    workshop.judge(count)
