"""Figures in Prometheus's text format (version 0.0.4)."""

from __future__ import annotations

import resource
import threading
import time
from collections.abc import Iterable, Mapping
from typing import Final, get_args

import planner
from planner.service.models import State
from planner.service.service import Service

STARTED: Final = time.time()


class Counter:
    """Requests by method and status."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._counts: dict[tuple[str, int], int] = {}

    def count(self, method: str, status: int) -> None:
        """One more."""
        with self._lock:
            self._counts[method, status] = self._counts.get((method, status), 0) + 1

    def rows(self) -> list[tuple[Mapping[str, str], float]]:
        """All counts with their labels."""
        with self._lock:
            return [({"method": m, "status": str(s)}, n) for (m, s), n in sorted(self._counts.items())]


REQUESTS: Final = Counter()


def text(here: Service) -> str:
    """All figures of an instance; jobs are those of the store."""
    counts = here.jobs.counts()
    jobs = [({"state": state}, float(counts.get(state, 0))) for state in get_args(State)]
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024.0
    return "".join(
        (
            _figure("tandem_info", "gauge", "Version.", [({"version": planner.__version__}, 1.0)]),
            _figure("tandem_jobs", "gauge", "Jobs in the store by state.", jobs),
            _figure("tandem_files_bytes", "gauge", "Stored files.", [({}, float(here.files.used))]),
            _figure("tandem_workers", "gauge", "Worker processes.", [({}, float(here.options.workers))]),
            _figure(
                "tandem_planning",
                "gauge",
                "Whether jobs are being planned.",
                [({}, float(here.runner.healthy))],
            ),
            _figure("tandem_http_requests_total", "counter", "Requests answered.", REQUESTS.rows()),
            _figure("process_start_time_seconds", "gauge", "Start, seconds since 1970.", [({}, STARTED)]),
            _figure("process_max_resident_memory_bytes", "gauge", "Most memory held.", [({}, memory)]),
        )
    )


def _figure(name: str, kind: str, about: str, rows: Iterable[tuple[Mapping[str, str], float]]) -> str:
    lines = [f"# HELP {name} {about}", f"# TYPE {name} {kind}"]
    for labels, value in rows:
        inner = ",".join(f'{key}="{label}"' for key, label in labels.items())
        lines.append(f"{name}{{{inner}}} {value:.17g}" if inner else f"{name} {value:.17g}")
    return "\n".join([*lines, ""])
