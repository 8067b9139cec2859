"""Metrics of the service for Prometheus, with its client library.

- Counters and times are those of this process since its start, as Prometheus expects: they never decrease,
  so that the outcome of a job stays counted when the job is deleted.
- The content of the store is queried when metrics are read.
- Labels contain words of this program only: routes by their patterns, never user input.
- Times are taken from the monotonic clock, except the age of the queue.
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
"""Text format that every version of Prometheus reads."""
REGISTRY: Final = CollectorRegistry()
"""Metrics of this process."""
METHODS: Final = frozenset({"GET", "HEAD", "POST", "DELETE", "PUT", "PATCH", "OPTIONS"})
"""HTTP methods that have their own label. Others are counted together."""
STAGES: Final = frozenset(
    (
        *("reading", "cell", "placement", "targets", "motion", "programs", "proof", "report"),
        *("division", "surface", "joints", "page"),
    )
)
"""Stages of jobs that have their own label. Others are counted together."""
OTHER: Final = "other"
"""Label for everything that has no label of its own."""
NO_ROUTE: Final = "none"
"""Label of requests without a route: unknown addresses, and requests refused before routing."""

ProcessCollector(registry=REGISTRY)
REQUESTS: Final = Counter(
    "tandem_http_requests_total", "Requests answered.", ("method", "route", "status"), registry=REGISTRY
)
REQUEST_S: Final = Histogram(
    "tandem_http_request_duration_seconds",
    "Time from the head of a request to the head of its answer, by route.",
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
    "Time that jobs waited until they were started.",
    buckets=(0.3, 1, 3, 10, 30, 60, 300, 900, 3600, 14400, 86400),
    registry=REGISTRY,
)
OUTCOMES: Final = Counter(
    "tandem_job_outcomes_total",
    "Jobs that ended, including deleted ones, by source: planned, or answered from the store.",
    ("state", "source"),
    registry=REGISTRY,
)


def count_outcome(state: str, source: str = "planned") -> None:
    """Count a job that has ended.

    Args:
        state: Final state.
        source: ``planned``, or :data:`planner.service.jobs.FROM_STORE`.
    """
    OUTCOMES.labels(state, source).inc()


def observe_stage(stage: str, seconds: float) -> None:
    """Record how long a stage of a job took.

    Args:
        stage: Name of the stage.
        seconds: Duration [s].
    """
    STAGE_S.labels(stage if stage in STAGES else OTHER).observe(max(seconds, 0.0))


def observe_wait(seconds: float) -> None:
    """Record how long [s] a job was queued. If clocks of two hosts differ, the time may be negative."""
    WAIT_S.observe(max(seconds, 0.0))


def metrics_text(
    jobs: dict[str, int], oldest: float | None, files_bytes: float, workers: int, planning: bool
) -> bytes:
    """Return all metrics as text.

    Args:
        jobs: Number of jobs by state.
        oldest: Creation time of the oldest queued job [s since 1970], or None.
        files_bytes: Size of the stored files [bytes].
        workers: Number of worker processes.
        planning: Whether jobs are being planned.
    """
    current_registry = CollectorRegistry()
    age = 0.0 if oldest is None else max(time.time() - oldest, 0.0)
    for name, help_text, value in (
        ("tandem_queue_age_seconds", "Age of the oldest queued job, 0 without one.", age),
        ("tandem_files_bytes", "Stored files.", files_bytes),
        ("tandem_workers", "Worker processes.", workers),
        ("tandem_planning", "Whether jobs are being planned (1 or 0).", float(planning)),
    ):
        Gauge(name, help_text, registry=current_registry).set(value)
    Gauge("tandem_info", "Version.", ("version",), registry=current_registry).labels(__version__).set(1)
    states = Gauge("tandem_jobs", "Jobs in the store by state.", ("state",), registry=current_registry)
    for state in get_args(State):
        states.labels(state).set(jobs.get(state, 0))
    return bytes(generate_latest(current_registry) + generate_latest(REGISTRY))


class MetricsMiddleware:
    """ASGI middleware that counts answers and measures their time.

    Args:
        app: Application.
        routes: Patterns of all addresses.
    """

    def __init__(self, app: ASGIApp, routes: Iterable[str]) -> None:
        self._app, self._routes = app, frozenset(routes)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle a request, count its answer and measure its time. Other connections are passed on."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        started, answered = time.monotonic(), False

        def count(status: int) -> None:
            method = scope["method"] if scope["method"] in METHODS else OTHER
            route = getattr(scope.get("route"), "path", NO_ROUTE)
            route = route if route in self._routes else NO_ROUTE
            REQUESTS.labels(method, route, str(status)).inc()
            REQUEST_S.labels(method, route).observe(time.monotonic() - started)

        async def send_counted(message: Message) -> None:
            nonlocal answered
            if message["type"] == "http.response.start":
                answered = True
                count(message["status"])
            await send(message)

        try:
            await self._app(scope, receive, send_counted)
        except Exception:
            if not answered:
                count(500)  # the framework answers with this status
            raise
