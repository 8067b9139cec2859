"""What the API sends, as models: they give its OpenAPI too. Problems are read by the models of
:mod:`planner.reading.problem`."""

from __future__ import annotations

import datetime as dt
from typing import Any, Final, Literal

from pydantic import BaseModel, ConfigDict, Field

from planner.issues import Issue

State = Literal[
    "queued",
    "running",
    "verified",
    "infeasible",
    "bad_input",
    "unproven",
    "crashed",
    "timeout",
    "memory",
    "cancelled",
]
Kind = Literal["robots", "cells", "tools", "materials"]
OPEN: Final = ("queued", "running")
"""States of jobs that have not ended."""
SETTLED: Final = ("verified", "infeasible", "unproven")
"""States that the problem alone decides, so that an identical one needs no planning."""


class Sent(BaseModel):
    """Base of what is sent."""

    model_config = ConfigDict(frozen=True)


class Refusal(Sent):
    """Why a request was refused."""

    issues: list[Issue]


class JobOut(Sent):
    """A job. ``fraction`` is that of its stage; ``from_store``: an identical problem had been planned."""

    id: str
    name: str = Field(description="the problem's name")
    state: State
    stage: str = Field("", description="what is being done")
    fraction: float = Field(0.0, ge=0, le=1, description="how much of the stage is done")
    processes: list[str] = []
    digest: str = Field(description="SHA-256 over the problem's values and files")
    created: dt.datetime
    started: dt.datetime | None = None
    finished: dt.datetime | None = None
    seconds: float | None = Field(None, description="time of planning [s]")
    attempts: int = Field(0, description="how often planning began: more than once after a restart")
    from_store: bool = False
    ahead: int | None = Field(None, description="queued jobs that came before it")
    timeout_s: float
    memory_mb: float
    issues: list[Issue] = []
    metrics: dict[str, float] = {}


class JobList(Sent):
    """A page of jobs, the newest first; ``next`` is the ``cursor`` of the page that follows."""

    jobs: list[JobOut]
    next: str | None = None


class FileOut(Sent):
    """A file of a job: its problem (``problem/...``) or a result."""

    name: str
    size: int = Field(description="bytes")
    sha256: str
    content_type: str


class FileList(Sent):
    """The files of a job."""

    files: list[FileOut]


class CheckOut(Sent):
    """What is known of a problem without planning it. ``summary``: arms, operations, and the boxes of stock
    and part [mm] in the stock's frame."""

    ok: bool = Field(description="whether nothing in the way of a plan was found")
    name: str
    digest: str
    processes: list[str]
    summary: dict[str, Any]
    issues: list[Issue]


class Health(Sent):
    """Whether the service works."""

    status: Literal["ok", "degraded"]
    version: str
    workers: int
    queued: int
    running: int


class Storage(Sent):
    """What a token's files take: those of its jobs, and for an hour what was only checked. Content counts
    once."""

    used_mb: float
    limit_mb: float


class Catalogue(Sent):
    """Entries by name, as plain data."""

    entries: dict[str, dict[str, Any]]
