"""Figures of the service for Prometheus, by its own client library.

Counters and times are of this process since its start, as Prometheus expects: they never go down while it
runs, so that the outcome of a job is counted for good when the job is deleted. What is in the store now is
asked for when the figures are read. Labels have words of this program alone: routes by their patterns, never
what users wrote. Times are by the monotonic clock, but for the age of the queue.
"""

import time
from collections.abc import Iterable
from typing import Final, get_args

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, ProcessCollector
from prometheus_client.exposition import generate_latest
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from planner.runtime.version import __version__
from planner.service.models import State

CONTENT_TYPE: Final = "text/plain; version=0.0.4; charset=utf-8"
"""The text format that every version of Prometheus reads."""
REGISTRY: Final = CollectorRegistry()
"""Figures of this process."""
METHODS: Final = frozenset({"GET", "HEAD", "POST", "DELETE", "PUT", "PATCH", "OPTIONS"})
"""Methods that are counted by name; others are counted together."""
STAGES: Final = frozenset(
    (
        *("reading", "cell", "placement", "targets", "motion", "programs", "proof", "report"),
        *("division", "surface", "joints", "page"),
    )
)
"""Stages of jobs that are told by name; others together."""
OTHER: Final = "other"
"""The label of what is told together."""
NO_ROUTE: Final = "none"
"""The route of what has none: unknown addresses, and what is refused before."""

ProcessCollector(registry=REGISTRY)
REQUESTS: Final = Counter(
    "tandem_http_requests_total", "Requests answered.", ("method", "route", "status"), registry=REGISTRY
)
REQUEST_S: Final = Histogram(
    "tandem_http_request_duration_seconds",
    "Time from a request's head to its answer's, by route.",
    ("method", "route"),
    buckets=(0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1, 2.5, 5, 10, 30, 120),
    registry=REGISTRY,
)
STAGE_S: Final = Histogram(
    "tandem_job_stage_duration_seconds",
    "Time that jobs took for each stage.",
    ("stage",),
    buckets=(0.1, 0.3, 1, 3, 10, 30, 60, 120, 300, 600, 1800, 3600),
    registry=REGISTRY,
)
WAIT_S: Final = Histogram(
    "tandem_job_wait_seconds",
    "Time that jobs waited until they were begun.",
    buckets=(0.3, 1, 3, 10, 30, 60, 300, 900, 3600, 14400, 86400),
    registry=REGISTRY,
)
OUTCOMES: Final = Counter(
    "tandem_job_outcomes_total",
    "Jobs that ended, also those that were deleted since; by source: planned, or answered from the store.",
    ("state", "source"),
    registry=REGISTRY,
)


def ended(state: str, source: str = "planned") -> None:
    """Count a job that has ended."""
    OUTCOMES.labels(state, source).inc()


def staged(stage: str, seconds: float) -> None:
    """Count a stage of a job."""
    STAGE_S.labels(stage if stage in STAGES else OTHER).observe(max(seconds, 0.0))


def waited(seconds: float) -> None:
    """Count how long a job waited; by clocks of two hosts it may be less than nothing."""
    WAIT_S.observe(max(seconds, 0.0))


def text(
    jobs: dict[str, int], oldest: float | None, files_bytes: float, workers: int, planning: bool
) -> bytes:
    """All figures: those of this process, and ``jobs`` in the store by state; ``oldest``: when the job that
    has waited longest came [s since 1970]."""
    now = CollectorRegistry()
    age = 0.0 if oldest is None else max(time.time() - oldest, 0.0)
    for name, what, value in (
        ("tandem_queue_age_seconds", "How long the job that came first has waited; 0 without one.", age),
        ("tandem_files_bytes", "Stored files.", files_bytes),
        ("tandem_workers", "Worker processes.", workers),
        ("tandem_planning", "Whether jobs are being planned.", float(planning)),
    ):
        Gauge(name, what, registry=now).set(value)
    Gauge("tandem_info", "Version.", ("version",), registry=now).labels(__version__).set(1)
    states = Gauge("tandem_jobs", "Jobs in the store by state.", ("state",), registry=now)
    for state in get_args(State):
        states.labels(state).set(jobs.get(state, 0))
    return bytes(generate_latest(now) + generate_latest(REGISTRY))


class Measured:
    """Wraps the application: counts answers and takes their time. ``routes``: patterns of all addresses."""

    def __init__(self, app: ASGIApp, routes: Iterable[str]) -> None:
        self._app, self._routes = app, frozenset(routes)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        began, answered = time.monotonic(), False

        def count(status: int) -> None:
            method = scope["method"] if scope["method"] in METHODS else OTHER
            route = getattr(scope.get("route"), "path", NO_ROUTE)
            route = route if route in self._routes else NO_ROUTE
            REQUESTS.labels(method, route, str(status)).inc()
            REQUEST_S.labels(method, route).observe(time.monotonic() - began)

        async def counted(message: Message) -> None:
            nonlocal answered
            if message["type"] == "http.response.start":
                answered = True
                count(message["status"])
            await send(message)

        try:
            await self._app(scope, receive, counted)
        except Exception:
            if not answered:
                count(500)  # by which the framework answers
            raise
