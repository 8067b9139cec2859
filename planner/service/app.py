"""Application and server: API, web pages, error handlers, lifespan, options and log.

The files of the web pages are in ``service/page/``. They contain no user data: their scripts call the API
with the user's credentials. For a bundled problem that serves as a starting point, the pages receive its
description, its data with the cell inlined, and its files.
"""

import asyncio
import contextlib
import logging
import resource
import signal
import ssl
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Annotated, Any, Final, get_args

import uvicorn
from fastapi import APIRouter, FastAPI, Query, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.openapi.utils import get_openapi
from fastapi.responses import FileResponse, HTMLResponse, JSONResponse, RedirectResponse
from jinja2 import Environment, FileSystemLoader, StrictUndefined, select_autoescape
from sqlalchemy.exc import SQLAlchemyError
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from uvicorn.middleware.proxy_headers import ProxyHeadersMiddleware

from planner.batch.cluster import ClusterPlanners
from planner.batch.workers import BatchWorkers
from planner.issues import Issue, has_errors, issue_error
from planner.report import view3d
from planner.runtime.version import __version__
from planner.service import (
    bundled_examples,
    draft_routes,
    element_routes,
    job_description_routes,
    logs,
    metrics,
    queue_routes,
    release_routes,
    routes,
    view_link_routes,
    webhook_routes,
)
from planner.service.http_responses import HeaderTimeoutProtocol, HeadMiddleware, allowed_methods
from planner.service.models import AuditAct
from planner.service.reading_result import ReadingOptions
from planner.service.routes import REFUSALS, AuthorisedOwner, CurrentService
from planner.service.runner import WorkerPool
from planner.service.security import LOOPBACK, PROBLEM_JSON, RefusedError, RequestGuard, issue_json
from planner.service.service import Options, Service
from planner.service.storage import refusal_of_error, store_upload
from planner.service.upload_processes import connection_closed

page_router: Final = APIRouter(include_in_schema=False)
PAGE_FOLDER: Final = Path(__file__).resolve().parent / "page"
"""Folder of the web pages."""
STATIC: Final = PAGE_FOLDER / "static"
"""Folder of files that are sent unchanged."""
CONTENT_SECURITY_POLICY: Final = "; ".join(
    (
        "default-src 'none'",
        "script-src 'self'",
        "style-src 'self'",
        "img-src 'self' data:",
        "connect-src 'self'",
        "frame-src 'self'",
        "form-action 'self'",
        "base-uri 'none'",
        "frame-ancestors 'none'",
        "require-trusted-types-for 'script'",
    )
)
"""Content security policy: own files only, no inline scripts or styles, text never becomes markup."""
STATIC_TYPES: Final = {
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".mjs": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
    ".txt": "text/plain; charset=utf-8",
}
"""Content types of static files, by suffix."""
TEMPLATES: Final = Environment(
    loader=FileSystemLoader(PAGE_FOLDER / "templates"),
    autoescape=select_autoescape(default=True, default_for_string=True),
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
"""Templates of the pages. All values are escaped."""
TEMPLATES.globals["ACTS"] = get_args(AuditAct)
LOG_IN_COOKIE: Final = "tandem_log_in"
"""Name of the cookie of a browser during log-in at the OpenID Connect provider."""
PAGES: Final = {
    "new": "New job",
    "drafts": "Drafts, cells, tools, templates",
    "compare": "Compare two jobs",
    "audit": "Audit log",
    "elements": "Building elements",
    "login": "Log in",
}
"""Titles of the pages, by name."""


@page_router.get("/")
def home(service: CurrentService) -> HTMLResponse:
    """Page with the list of jobs."""
    return _page("jobs", "Jobs", service)


@page_router.get("/ui/jobs/{job}")
def job(job: str, service: CurrentService) -> HTMLResponse:
    """Page of one job. Its script finds out whether the job exists."""
    return _page("job", "Job", service, job=job)


@page_router.get("/ui/look/{job}/{look}")
def shared_job_page(
    request: Request,
    job: str,
    look: str,
    service: CurrentService,
    signature: Annotated[str, Query(max_length=200)] = "",
) -> HTMLResponse:
    """Read-only page of one job, for holders of a view link. An invalid link gives 404 with a message."""
    try:
        routes.job_of_view_link(request, job, look, signature, service)
        answer = _page("look", "Job", service, job=job, look=look, signature=signature)
    except RefusedError as refused:
        answer = _page("look", "No such link", service, status=refused.status, fault=str(refused))
        answer.headers.update(refused.headers)
    answer.headers.update(view_link_routes.PRIVATE_HEADERS)
    return answer


@page_router.get("/ui/elements/{element}")
def element(element: str, service: CurrentService) -> HTMLResponse:
    """Page of one building element."""
    return _page("element", "Element", service, element=element)


@page_router.get("/ui/static/{name:path}")
def static(name: str) -> Response:
    """Styles and scripts of this version."""
    path = next(
        (folder / name for folder in (STATIC, view3d.FOLDER) if (folder / name).is_file()), STATIC / name
    )
    kind = STATIC_TYPES.get(path.suffix)
    if kind is None or ".." in name or not path.is_file():
        raise _unknown_page(f"/ui/static/{name}")
    return FileResponse(path, media_type=kind, headers={"Cache-Control": "no-cache"})


@page_router.get("/ui/examples")
def examples(_: AuthorisedOwner) -> dict[str, Any]:
    """Bundled problems."""
    return bundled_examples.problems()


@page_router.get("/ui/example-elements")
def example_elements(_: AuthorisedOwner) -> dict[str, Any]:
    """Bundled building elements."""
    return bundled_examples.elements()


@page_router.get("/ui/example")
def example(_: AuthorisedOwner, name: Annotated[str, Query(max_length=200)]) -> dict[str, Any]:
    """A bundled problem as data."""
    return bundled_examples.problem(name)


@page_router.get("/ui/example/file")
def example_file(
    _: AuthorisedOwner,
    name: Annotated[str, Query(max_length=200)],
    file: Annotated[str, Query(max_length=200)],
) -> FileResponse:
    """A file of a bundled problem."""
    return FileResponse(bundled_examples.file(name, file), media_type="application/octet-stream")


@page_router.post("/ui/preview")
async def preview(request: Request, owner: AuthorisedOwner, service: CurrentService) -> JSONResponse:
    """Read an upload without planning it and return the shapes to draw. Refuses with 422 as for a job."""
    upload = await store_upload(request, service.storage, owner, service.limits)
    result = await service.run_in_turn(
        request, owner, lambda reading: service.examine(upload, ReadingOptions(draw=True), reading)
    )
    return JSONResponse(
        {
            "ok": not has_errors(result.issues),
            "name": result.name,
            "digest": result.digest,
            "processes": list(result.processes),
            "summary": dict(result.summary),
            "issues": [issue_json(issue) for issue in result.issues],
            "shapes": list(result.shapes),
        }
    )


@page_router.get("/ui/oidc/login")
def log_in(
    request: Request, service: CurrentService, after: Annotated[str, Query(max_length=500)] = "/"
) -> Response:
    """Redirect to the OpenID Connect provider."""
    if service.log_in is None:
        raise _unknown_page("/ui/oidc/login")
    try:
        routes.count_unauthenticated(request, service, "logs in")
        address, cookie = service.log_in.start(_redirect_url(request), after)
    except RefusedError as refused:
        return _log_in_failed_page(service, refused)
    answer = RedirectResponse(address, 303, {"Cache-Control": "no-store"})
    answer.set_cookie(
        LOG_IN_COOKIE,
        cookie,
        max_age=600,
        path="/ui/oidc",
        secure=request.url.scheme == "https",
        httponly=True,
        samesite="lax",  # the browser returns from the provider's page
    )
    return answer


@page_router.get("/ui/oidc/callback")
def logged_in(request: Request, service: CurrentService) -> Response:
    """Finish the log-in when the browser returns from the provider."""
    if service.log_in is None:
        raise _unknown_page("/ui/oidc/callback")
    answer: Response
    try:
        routes.count_unauthenticated(request, service, "logs in")
        principal, after = service.log_in.finish(
            str(request.url), _redirect_url(request), request.cookies.get(LOG_IN_COOKIE)
        )
    except RefusedError as refused:
        answer = _log_in_failed_page(service, refused)
    else:
        answer = RedirectResponse(after, 303, {"Cache-Control": "no-store"})
        routes.set_session_cookie(request, answer, service, principal)
    answer.delete_cookie(LOG_IN_COOKIE, path="/ui/oidc")
    return answer


def _log_in_failed_page(service: Service, refused: RefusedError) -> Response:
    answer = _page("login", PAGES["login"], service, status=refused.status, fault=str(refused))
    answer.headers.update(refused.headers)
    return answer


def _redirect_url(request: Request) -> str:
    """Return the redirect URL for the provider: the address under which the browser knows the service."""
    return str(request.url_for("logged_in"))


@page_router.get("/ui/{name}")
def page(name: str, service: CurrentService) -> HTMLResponse:
    """The other pages, by name."""
    if name not in PAGES:
        raise _unknown_page(f"/ui/{name}")
    return _page(name, PAGES[name], service)


def _page(
    name: str, title: str, service: Any, status: int = 200, fault: str = "", **variables: str
) -> HTMLResponse:
    """Render a page.

    ``fault`` is an error message that the page shows, ``variables`` are further values of its template.
    """
    text = TEMPLATES.get_template(f"{name}.html").render(
        title=title,
        page=name,
        version=__version__,
        tokens=service.options.tokens_required,
        accounts=service.log_in is not None,
        fault=fault,
        **variables,
    )
    headers = {"Content-Security-Policy": CONTENT_SECURITY_POLICY, "Cache-Control": "no-store"}
    return HTMLResponse(text, status, headers)


def _unknown_page(path: str) -> RefusedError:
    return RefusedError(404, Issue("service.not_found", f"{path[:200]}: page not found. Start at /."))


ROUTERS: Final = (
    routes.job_router,
    job_description_routes.router,
    release_routes.router,
    view_link_routes.router,
    element_routes.router,
    webhook_routes.router,
    draft_routes.router,
    queue_routes.router,
    routes.about_router,
    page_router,
)
"""All routers, in the order in which addresses are matched."""
LOG: Final = logging.getLogger("planner.service")
"""Log of the service."""
API_DESCRIPTION: Final = """\
Plans the motion of two industrial robots that share one job. Upload problems as files and
download proven programs. Every refusal is a problem document (RFC 9457) with `issues`, each with a `code`
and the `field`."""
"""Description of the API in the OpenAPI document."""


def create_app(service: Service) -> FastAPI:
    """Create the application. The service starts and stops with it.

    Args:
        service: Service that answers the requests.
    """

    @contextlib.asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        del app
        service.start()
        event_task = asyncio.create_task(service.hub.run())
        try:
            yield
        finally:
            event_task.cancel()
            await asyncio.to_thread(service.close)

    app = FastAPI(
        title="Tandem",
        version=__version__,
        description=API_DESCRIPTION,
        lifespan=lifespan,
        docs_url=None,
        redoc_url=None,
    )
    app.state.service = service
    for router in ROUTERS:
        app.include_router(router)
    app.add_exception_handler(RefusedError, _refused_error)
    app.add_exception_handler(RequestValidationError, _validation_error)
    app.add_exception_handler(HTTPException, _http_error)
    app.add_exception_handler(ClientDisconnect, _client_disconnected)
    for kind in (SQLAlchemyError, OSError):
        app.add_exception_handler(kind, _store_error)
    app.add_exception_handler(Exception, _internal_error)
    options = service.options
    host_names = None if options.tokens_required else LOOPBACK | {options.host}
    app.add_middleware(HeadMiddleware)
    app.add_middleware(
        RequestGuard, upload_mb=service.limits.upload_mb, open_hosts=host_names, closed=service.closed_refusal
    )
    all_routes = [*app.routes, *(route for router in ROUTERS for route in router.routes)]
    paths = [getattr(route, "path", "") for route in all_routes]
    app.add_middleware(metrics.MetricsMiddleware, routes=paths)
    app.add_middleware(logs.RequestLogMiddleware)
    if options.tokens_required:  # without tokens, forwarded requests are refused
        app.add_middleware(ProxyHeadersMiddleware, trusted_hosts=list(options.trusted_proxies))
    app.openapi = lambda: _openapi(app)  # type: ignore[method-assign]
    return app


def _openapi(app: FastAPI) -> dict[str, Any]:
    """Return the OpenAPI document, with the schemas of problem files among its components."""
    if app.openapi_schema is None:
        # Imported here, because it loads all processes.
        from planner.service.catalogue import OPENAPI_REFERENCE, problem_schema

        document = get_openapi(
            title=app.title, version=app.version, description=app.description, routes=app.routes
        )
        document["components"]["schemas"] |= problem_schema(OPENAPI_REFERENCE)[1]
        for name in ("HTTPValidationError", "ValidationError"):  # no answer uses them
            document["components"]["schemas"].pop(name, None)
        refusal = {PROBLEM_JSON: {"schema": {"$ref": "#/components/schemas/Refusal"}}}
        refusal_texts = [str(entry["description"]) for entry in REFUSALS.values()]
        for path_item in document["paths"].values():
            for operation in path_item.values():
                description = operation["responses"].get("422", {}).get("description")
                # FastAPI adds its own 422 to every route with parameters.
                if description != REFUSALS[422]["description"]:
                    operation["responses"].pop("422", None)
                for status, answer in operation["responses"].items():
                    # refusals are problem documents, whatever the type of a successful answer
                    if (status[0] == "4" and status != "416") or answer["description"] in refusal_texts:
                        answer["content"] = refusal
        app.openapi_schema = document
    return app.openapi_schema


async def _refused_error(request: Request, error: Exception) -> JSONResponse:
    del request
    if not isinstance(error, RefusedError):
        raise error
    return JSONResponse(error.body, error.status, headers=error.headers, media_type=PROBLEM_JSON)


async def _validation_error(request: Request, error: Exception) -> JSONResponse:
    """Answer 422 with one issue for each request parameter that FastAPI rejected."""
    if not isinstance(error, RequestValidationError):
        raise error
    issues = []
    for error_entry in error.errors():
        field = ".".join(str(part) for part in error_entry["loc"][1:]) or "body"
        got = "" if error_entry["type"] == "missing" else f", got {str(error_entry.get('input'))[:80]!r}"
        message = f"{field}: {error_entry['msg']}{got}. Correct the value."
        issues.append(Issue("service.request", message, field=field))
    return await _refused_error(request, RefusedError(422, issues))


async def _http_error(request: Request, error: Exception) -> JSONResponse:
    """Answer an error of the framework, such as 404 or 405, as a problem document."""
    if not isinstance(error, HTTPException):
        raise error
    headers = dict(error.headers or {})
    if error.status_code == 405:
        headers["Allow"] = allowed_methods(
            [route for router in ROUTERS for route in router.routes], request.scope
        )
    advice = f" (allowed {headers['Allow']})" if "Allow" in headers else ""
    message = f"{request.method} {request.url.path[:200]}: {error.detail}{advice}. See /openapi.json."
    code = "service.not_found" if error.status_code in (404, 405) else "service.request"
    return await _refused_error(request, RefusedError(error.status_code, Issue(code, message), headers))


async def _client_disconnected(request: Request, error: Exception) -> JSONResponse:
    """Handle a client that has disconnected.

    Nobody receives the answer, and the service is not at fault.
    """
    del error
    return await _refused_error(request, connection_closed())


async def _store_error(request: Request, error: Exception) -> JSONResponse:
    """Answer an error of the database or the disk: with its refusal if there is one, else with 500."""
    refused = refusal_of_error(error)
    if refused is None:
        return await _internal_error(request, error)
    LOG.warning(
        "%s %s: %s", request.method, request.url.path, type(error).__name__, extra=_request_fields(request)
    )
    return await _refused_error(request, refused)


async def _internal_error(request: Request, error: Exception) -> JSONResponse:
    request_fields = _request_fields(request)
    LOG.error("%s %s failed", request.method, request.url.path, exc_info=error, extra=request_fields)
    issue = Issue("internal.error", "the service failed. Its log contains the details. Report this error.")
    # This answer bypasses the middleware that adds the header.
    headers = {logs.HEADER: request_fields["request"]} if request_fields["request"] else {}
    return await _refused_error(request, RefusedError(500, issue, headers))


def _request_fields(request: Request) -> dict[str, Any]:
    """Return the extra fields of a log record: request id, method and path."""
    request_id = getattr(request.state, "request_id", None)
    return {"request": request_id, "method": request.method, "path": request.url.path}


STREAM_SHUTDOWN_S: Final = 3
"""Time [s] that open event streams have to end when the service stops."""


def serve(
    options: Options, certificate: Path | None = None, key: Path | None = None, log: logs.Kind = "text"
) -> None:
    """Serve until SIGTERM or Ctrl-C, then return.

    Args:
        options: Options of the service.
        certificate: TLS certificate (PEM), or None for plain HTTP.
        key: Private key of the certificate (PEM).
        log: Format of the log.

    Raises:
        TandemError: The service cannot start.
    """
    if (certificate is None) != (key is None):
        raise issue_error("service.start", "TLS needs both --certificate and --key", field="certificate")
    if certificate is not None and key is not None:
        try:
            ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(certificate, key)
        except (OSError, ssl.SSLError) as error:
            message = f"certificate {certificate} with key {key}: cannot be used ({error}). Give PEM files."
            raise issue_error("service.start", message, field="certificate") from error
    # Each connection needs a file descriptor, so the soft limit is raised to the hard limit.
    _, max_files = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (max_files, max_files))
    service = Service(options, worker_pool_factory(options))
    config = uvicorn.Config(
        create_app(service),
        host=options.host,
        port=options.port,
        http=HeaderTimeoutProtocol,
        log_level="info",
        access_log=log == "text",  # the JSON log has its own line for each request
        server_header=False,
        proxy_headers=False,
        timeout_keep_alive=30,
        timeout_graceful_shutdown=STREAM_SHUTDOWN_S,
        limit_concurrency=None,
        backlog=4096,
        h11_max_incomplete_event_size=64 * 1024,
        ssl_certfile=certificate,
        ssl_keyfile=key,
    )
    logging.getLogger("uvicorn.access").addFilter(strip_query)
    if log == "json":
        logs.write_json(options.data)
    # After shutdown Uvicorn raises the signal again that ended it. SIGTERM is a normal end, so it is ignored.
    signal.signal(signal.SIGTERM, lambda number, frame: None)
    _Server(config, service).run()


def strip_query(record: logging.LogRecord) -> bool:
    """Remove query strings from the address in an access log record.

    Without this, every reader of the log could open the files of signed links.

    Args:
        record: Record to change.

    Returns:
        True, so that the record is logged.
    """
    if isinstance(record.args, tuple):
        record.args = tuple(value.split("?")[0] if isinstance(value, str) else value for value in record.args)
    return True


class _Server(uvicorn.Server):
    """Server that ends event streams and the reading of uploads as soon as it is asked to stop.

    Otherwise the shutdown would wait for them.
    """

    def __init__(self, config: uvicorn.Config, service: Service) -> None:
        super().__init__(config)
        self._service = service

    async def shutdown(self, sockets: list[object] | None = None) -> None:  # type: ignore[override]
        self._service.hub.close()
        self._service.stop_reading()
        await super().shutdown(sockets)  # type: ignore[arg-type]


def worker_pool_factory(options: Options) -> Callable[[], WorkerPool]:
    """Return a factory of the workers that plan jobs: processes on this machine, or a cluster.

    Args:
        options: Options of the service.

    Raises:
        TandemError: The cluster cannot be used.
    """
    memory_mb, count = options.limits.job_memory_mb, options.workers
    if options.cluster is None:
        return lambda: BatchWorkers(count, memory_mb=memory_mb)
    address = options.cluster
    # The first pool is created here, so that errors are reported before the service starts.
    first_pool = [ClusterPlanners(address, count, memory_mb)]
    return lambda: first_pool.pop() if first_pool else ClusterPlanners(address, count, memory_mb)
