"""What one user may ask of the service."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class Limits:
    """``upload_mb`` of one request, ``mesh_mb`` and ``mesh_facets`` of one mesh (50 MB of STL are a million
    facets; three times as many vertices may be), ``files`` of one upload; ``open_jobs`` that wait or run
    and ``kept_jobs`` in all, of one token; ``token_disk_mb`` of a token's files and ``disk_mb`` of all files,
    each content once, None for what the disk has; ``readings`` of uploads that wait or are under way, of one
    token; ``job_s`` and ``job_memory_mb`` of one job's planning,
    ``check_s`` and ``check_memory_mb`` of reading or checking a problem; ``streams`` of events at once, of
    one token; ``keep_days`` until a finished job is deleted, None for never.
    """

    upload_mb: float = 200.0
    mesh_mb: float = 50.0
    mesh_facets: int = 1_000_000
    files: int = 64
    open_jobs: int = 100
    kept_jobs: int = 5000
    token_disk_mb: float = 20_000.0
    disk_mb: float | None = None
    readings: int = 100
    job_s: float = 3600.0
    job_memory_mb: float = 4096.0
    check_s: float = 120.0
    check_memory_mb: float = 4096.0
    streams: int = 100
    keep_days: float | None = None
