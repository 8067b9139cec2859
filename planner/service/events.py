"""Events of jobs as they happen, for any number of listeners: one question to the store for all of them."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator, Iterator
from typing import Any, Final, NamedTuple

import anyio.to_thread
from sqlalchemy import select
from starlette.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

from planner.issues import Issue
from planner.service.database import Database
from planner.service.limits import Limits
from planner.service.models import OPEN
from planner.service.refusals import RefusedError
from planner.service.tables import EVENTS, JOBS

POLL_S: Final = 0.25
ALIVE_S: Final = 15.0
"""A comment is sent so often, so that proxies do not take a stream for dead."""
CHUNK: Final = 500


class Event(NamedTuple):
    """The event ``seq`` of a job; ``data`` is JSON."""

    seq: int
    kind: str
    data: str


class Hub:
    """Wakes listeners when their jobs have news."""

    def __init__(self, database: Database, limits: Limits) -> None:
        self._database, self._limits = database, limits
        self._listening: dict[str, dict[asyncio.Event, int]] = {}
        self._of_owner: dict[str, int] = {}
        self._closing = False

    async def run(self) -> None:
        """Ask the store for news until cancelled; errors of the store are passed over, it is asked again."""
        while True:
            await asyncio.sleep(POLL_S)
            if self._listening:
                with contextlib.suppress(Exception):
                    self._wake(await anyio.to_thread.run_sync(self._numbers, list(self._listening)))

    def close(self) -> None:
        """End all streams."""
        self._closing = True
        for listeners in self._listening.values():
            for event in listeners:
                event.set()

    @contextlib.contextmanager
    def slot(self, owner: str) -> Iterator[None]:
        """A stream of an owner; raises :class:`RefusedError`, 429, where there are too many."""
        if self._of_owner.get(owner, 0) >= self._limits.streams:
            what = f"{self._limits.streams} streams of events are open, and no more may be; close some"
            raise RefusedError(429, Issue("service.too_many", what), {"Retry-After": "10"})
        self._of_owner[owner] = self._of_owner.get(owner, 0) + 1
        try:
            yield
        finally:
            self._of_owner[owner] -= 1
            if not self._of_owner[owner]:
                del self._of_owner[owner]

    async def stream(self, job: str, after: int) -> AsyncIterator[str]:
        """The events of a job after number ``after`` as server-sent events, until it has ended or is gone."""
        woken = asyncio.Event()
        self._listening.setdefault(job, {})[woken] = after
        try:
            yield ": tandem\n\n"
            while not self._closing:
                woken.clear()
                events, is_open = await anyio.to_thread.run_sync(self._news, job, after)
                for event in events:
                    after = event.seq
                    yield f"id: {event.seq}\nevent: {event.kind}\ndata: {event.data}\n\n"
                if not is_open:
                    yield f"id: {after}\nevent: end\ndata: {json.dumps({'seq': after})}\n\n"
                    return
                self._listening[job][woken] = after
                try:
                    await asyncio.wait_for(woken.wait(), ALIVE_S)
                except TimeoutError:
                    yield ": still here\n\n"
        finally:
            listeners = self._listening.get(job, {})
            listeners.pop(woken, None)
            if not listeners:
                self._listening.pop(job, None)

    def _wake(self, numbers: dict[str, int]) -> None:
        for job, listeners in self._listening.items():
            for event, seen in listeners.items():
                if numbers.get(job, -1) != seen:
                    event.set()

    def _numbers(self, jobs: list[str]) -> dict[str, int]:
        found: dict[str, int] = {}
        with self._database.read() as db:
            for start in range(0, len(jobs), CHUNK):
                query = select(JOBS.c.id, JOBS.c.seq).where(JOBS.c.id.in_(jobs[start : start + CHUNK]))
                found |= dict(tuple(row) for row in db.execute(query))
        return found

    def _news(self, job: str, after: int) -> tuple[list[Event], bool]:
        """Events after number ``after``, and whether more may come."""
        with self._database.read() as db:
            state: Any = db.execute(select(JOBS.c.state).where(JOBS.c.id == job)).scalar()
            query = select(EVENTS).where(EVENTS.c.job == job, EVENTS.c.seq > after).order_by(EVENTS.c.seq)
            rows = db.execute(query).mappings().all()
        return [Event(row["seq"], row["kind"], row["data"]) for row in rows], state in OPEN


class Stream(StreamingResponse):
    """The events of a job as an answer, which holds a slot of its owner for as long as it is sent."""

    def __init__(self, hub: Hub, owner: str, job: str, after: int) -> None:
        headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
        super().__init__(hub.stream(job, after), media_type="text/event-stream", headers=headers)
        self._hub, self._owner = hub, owner

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """ASGI; raises :class:`RefusedError`, 429."""
        with self._hub.slot(self._owner):
            await super().__call__(scope, receive, send)
