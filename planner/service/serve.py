"""Runs the service: its options, its server, its log."""

from __future__ import annotations

import logging
import resource
import signal
import ssl
from collections.abc import Callable
from pathlib import Path
from typing import Final

import uvicorn

from planner.batch.cluster import Cluster
from planner.batch.workers import Workers
from planner.issues import Issue, TandemError
from planner.service.app import create_app
from planner.service.runner import Team
from planner.service.service import Options, Service

LOG: Final = logging.getLogger("planner.service")
STREAMS_END_S: Final = 3
"""Streams that are open get so long to end when the service stops."""


def serve(options: Options, certificate: Path | None = None, key: Path | None = None) -> None:
    """Serve until told to stop: after SIGTERM it returns. Raises ``TandemError`` where it cannot start."""
    if (certificate is None) != (key is None):
        raise TandemError(
            Issue("service.start", "TLS needs --certificate and --key, give both", field="certificate")
        )
    if certificate is not None and key is not None:
        try:
            ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(certificate, key)
        except (OSError, ssl.SSLError) as error:
            message = f"certificate {certificate} with key {key}: cannot be used ({error}); give PEM files"
            raise TandemError(Issue("service.start", message, field="certificate")) from error
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))  # a connection is a file
    service = Service(options, make_team(options))
    config = uvicorn.Config(
        create_app(service),
        host=options.host,
        port=options.port,
        log_level="info",
        server_header=False,
        proxy_headers=False,
        timeout_keep_alive=30,
        timeout_graceful_shutdown=STREAMS_END_S,
        limit_concurrency=None,
        backlog=4096,
        h11_max_incomplete_event_size=64 * 1024,
        ssl_certfile=certificate,
        ssl_keyfile=key,
    )
    # Uvicorn raises the signal that ended it again when all is stopped; to be asked to end is no failure, so
    # nothing more is to be done then
    signal.signal(signal.SIGTERM, lambda number, frame: None)
    _Server(config, service).run()


class _Server(uvicorn.Server):
    """Ends streams of events and the reading of uploads as soon as it is told to stop: nobody waits for
    them."""

    def __init__(self, config: uvicorn.Config, service: Service) -> None:
        super().__init__(config)
        self._service = service

    async def shutdown(self, sockets: list[object] | None = None) -> None:  # type: ignore[override]
        self._service.hub.close()
        self._service.stop_reading()
        await super().shutdown(sockets)  # type: ignore[arg-type]


def make_team(options: Options) -> Callable[[], Team]:
    """What plans the jobs: processes of this machine, or a cluster. Raises ``TandemError`` for a cluster that
    cannot be used."""
    memory_mb, count = options.limits.job_memory_mb, options.workers
    if options.cluster is None:
        return lambda: Workers(count, memory_mb=memory_mb)
    address = options.cluster
    first = [Cluster(address, count, memory_mb)]  # what is wrong is told at the start
    return lambda: first.pop() if first else Cluster(address, count, memory_mb)
