"""What one user may ask of the service."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class Limits:
    """``upload_mb`` of one request, ``mesh_mb`` of one mesh (50 MB are a million facets), ``files`` of one
    upload; ``open_jobs`` that wait or run and ``kept_jobs`` in all, of one token; ``job_s`` and
    ``job_memory_mb`` of one job's planning, ``check_s`` and ``check_memory_mb`` of reading or checking a
    problem; ``streams`` of events at once, of one token; ``keep_days`` until a finished job is deleted, None
    for never.
    """

    upload_mb: float = 200.0
    mesh_mb: float = 50.0
    files: int = 64
    open_jobs: int = 100
    kept_jobs: int = 5000
    job_s: float = 3600.0
    job_memory_mb: float = 4096.0
    check_s: float = 120.0
    check_memory_mb: float = 4096.0
    streams: int = 100
    keep_days: float | None = None
