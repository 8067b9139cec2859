"""The application and its server: API and page, refusals, the life of the service, options and log.

The files of the page are in ``service/page/``. They carry no data of users: their scripts ask the
API for it, as the user. Of a bundled problem, as a starting point, the page has what it is, its
data with the cell inside, and its files.
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

from planner.batch.cluster import Cluster
from planner.batch.workers import Workers
from planner.issues import Issue, has_errors, refusal
from planner.report import view3d
from planner.runtime.version import __version__
from planner.service import (
    bundled,
    draft_routes,
    element_routes,
    finding_routes,
    logs,
    look_routes,
    metrics,
    queue_routes,
    release_routes,
    routes,
    webhook_routes,
)
from planner.service.answers import Heads, Hurried, allowed
from planner.service.models import Act
from planner.service.routes import REFUSALS, Caller, Here
from planner.service.runner import Team
from planner.service.security import LOOPBACK, PROBLEM_JSON, Guard, RefusedError, issue_json
from planner.service.service import Options, Service
from planner.service.storage import store_refusal, take_upload
from planner.service.upload_processes import connection_closed

page_router: Final = APIRouter(include_in_schema=False)
PAGE_FOLDER: Final = Path(__file__).resolve().parent / "page"
"""The folder of the page."""
STATIC: Final = PAGE_FOLDER / "static"
"""The folder of the files that are sent as they are."""
POLICY: Final = "; ".join(
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
"""Nothing but this site's own files; no inline script or style, and no text becomes markup."""
TYPES: Final = {
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".mjs": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
    ".txt": "text/plain; charset=utf-8",
}
"""Content types of these files."""
TEMPLATES: Final = Environment(
    loader=FileSystemLoader(PAGE_FOLDER / "templates"),
    autoescape=select_autoescape(default=True, default_for_string=True),
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
"""Templates of the pages; all that is put in them is escaped."""
TEMPLATES.globals["ACTS"] = get_args(Act)
LOG_IN_COOKIE: Final = "tandem_log_in"
"""Name of the cookie of a browser that is at the provider."""
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
def home(here: Here) -> HTMLResponse:
    """The history of jobs."""
    return _page("jobs", "Jobs", here)


@page_router.get("/ui/jobs/{job}")
def job(job: str, here: Here) -> HTMLResponse:
    """One job; the script finds out whether there is one of that id."""
    return _page("job", "Job", here, job=job)


@page_router.get("/ui/look/{job}/{look}")
def look(
    request: Request, job: str, look: str, here: Here, signature: Annotated[str, Query(max_length=200)] = ""
) -> HTMLResponse:
    """One job, for who has a link to look; 404 in a sentence for one that does not hold."""
    try:
        routes.looked_at(request, job, look, signature, here)
        answer = _page("look", "Job", here, job=job, look=look, signature=signature)
    except RefusedError as refused:
        answer = _page("look", "No such link", here, status=refused.status, fault=str(refused))
        answer.headers.update(refused.headers)
    answer.headers.update(look_routes.PRIVATE)
    return answer


@page_router.get("/ui/elements/{element}")
def element(element: str, here: Here) -> HTMLResponse:
    """One building element, as of a job."""
    return _page("element", "Element", here, element=element)


@page_router.get("/ui/static/{name:path}")
def static(name: str) -> Response:
    """Styles and scripts of this version."""
    path = next(
        (folder / name for folder in (STATIC, view3d.FOLDER) if (folder / name).is_file()), STATIC / name
    )
    kind = TYPES.get(path.suffix)
    if kind is None or ".." in name or not path.is_file():
        raise _unknown(f"/ui/static/{name}")
    return FileResponse(path, media_type=kind, headers={"Cache-Control": "no-cache"})


@page_router.get("/ui/examples")
def examples(_: Caller) -> dict[str, Any]:
    """Bundled problems."""
    return bundled.problems()


@page_router.get("/ui/example-elements")
def example_elements(_: Caller) -> dict[str, Any]:
    """Bundled building elements."""
    return bundled.elements()


@page_router.get("/ui/example")
def one(_: Caller, name: Annotated[str, Query(max_length=200)]) -> dict[str, Any]:
    """A bundled problem as data."""
    return bundled.problem(name)


@page_router.get("/ui/example/file")
def example_file(
    _: Caller, name: Annotated[str, Query(max_length=200)], file: Annotated[str, Query(max_length=200)]
) -> FileResponse:
    """A file of a bundled problem."""
    return FileResponse(bundled.file(name, file), media_type="application/octet-stream")


@page_router.post("/ui/preview")
async def preview(request: Request, owner: Caller, here: Here) -> JSONResponse:
    """What is known of an upload without planning it, with the shapes that the page draws; 422 as for a
    job."""
    upload = await take_upload(request, here.storage, owner, here.limits)
    read = await here.in_turn(
        request, owner, lambda reading: here.examine(upload, draw=True, reading=reading)
    )
    return JSONResponse(
        {
            "ok": not has_errors(read.issues),
            "name": read.name,
            "digest": read.digest,
            "processes": list(read.processes),
            "summary": dict(read.summary),
            "issues": [issue_json(issue) for issue in read.issues],
            "shapes": list(read.shapes),
        }
    )


@page_router.get("/ui/oidc/login")
def log_in(request: Request, here: Here, after: Annotated[str, Query(max_length=500)] = "/") -> Response:
    """To the provider, by which people log in."""
    if here.log_in is None:
        raise _unknown("/ui/oidc/login")
    try:
        routes.count_unknown(request, here, "logs in")
        address, cookie = here.log_in.begin(_back(request), after)
    except RefusedError as refused:
        return _not_logged_in(here, refused)
    answer = RedirectResponse(address, 303, {"Cache-Control": "no-store"})
    answer.set_cookie(
        LOG_IN_COOKIE,
        cookie,
        max_age=600,
        path="/ui/oidc",
        secure=request.url.scheme == "https",
        httponly=True,
        samesite="lax",  # the provider's page leads back
    )
    return answer


@page_router.get("/ui/oidc/callback")
def logged_in(request: Request, here: Here) -> Response:
    """Back from the provider."""
    if here.log_in is None:
        raise _unknown("/ui/oidc/callback")
    answer: Response
    try:
        routes.count_unknown(request, here, "logs in")
        who, after = here.log_in.end(str(request.url), _back(request), request.cookies.get(LOG_IN_COOKIE))
    except RefusedError as refused:
        answer = _not_logged_in(here, refused)
    else:
        answer = RedirectResponse(after, 303, {"Cache-Control": "no-store"})
        routes.remember(request, answer, here, who)
    answer.delete_cookie(LOG_IN_COOKIE, path="/ui/oidc")
    return answer


def _not_logged_in(here: Service, refused: RefusedError) -> Response:
    answer = _page("login", PAGES["login"], here, status=refused.status, fault=str(refused))
    answer.headers.update(refused.headers)
    return answer


def _back(request: Request) -> str:
    """Where the provider sends browsers: the address under which the browser knows the service."""
    return str(request.url_for("logged_in"))


@page_router.get("/ui/{name}")
def page(name: str, here: Here) -> HTMLResponse:
    """The other pages."""
    if name not in PAGES:
        raise _unknown(f"/ui/{name}")
    return _page(name, PAGES[name], here)


def _page(name: str, title: str, here: Any, status: int = 200, fault: str = "", **more: str) -> HTMLResponse:
    text = TEMPLATES.get_template(f"{name}.html").render(
        title=title,
        page=name,
        version=__version__,
        tokens=here.options.tokens_required,
        accounts=here.log_in is not None,
        fault=fault,
        **more,
    )
    headers = {"Content-Security-Policy": POLICY, "Cache-Control": "no-store"}
    return HTMLResponse(text, status, headers)


def _unknown(path: str) -> RefusedError:
    return RefusedError(404, Issue("service.not_found", f"{path[:200]}: there is no such page; begin at /"))


ROUTERS: Final = (
    routes.job_router,
    finding_routes.router,
    release_routes.router,
    look_routes.router,
    element_routes.router,
    webhook_routes.router,
    draft_routes.router,
    queue_routes.router,
    routes.about_router,
    page_router,
)
"""All addresses."""
LOG: Final = logging.getLogger("planner.service")
"""Log of the service."""
ABOUT: Final = """Plans the motion of two industrial robots that share one job. Problems go in as files,
programs come out if they are proven. Every refusal is a problem document (RFC 9457) with `issues`, each with
a `code` and the `field`."""
"""What the description of the interface begins with."""


def create_app(service: Service) -> FastAPI:
    """The application over a service, which starts and ends with it."""

    @contextlib.asynccontextmanager
    async def life(app: FastAPI) -> AsyncIterator[None]:
        del app
        service.start()
        news = asyncio.create_task(service.hub.run())
        try:
            yield
        finally:
            news.cancel()
            await asyncio.to_thread(service.close)

    app = FastAPI(
        title="Tandem", version=__version__, description=ABOUT, lifespan=life, docs_url=None, redoc_url=None
    )
    app.state.service = service
    for router in ROUTERS:
        app.include_router(router)
    app.add_exception_handler(RefusedError, _refused)
    app.add_exception_handler(RequestValidationError, _invalid)
    app.add_exception_handler(HTTPException, _http)
    app.add_exception_handler(ClientDisconnect, _gone)
    for kind in (SQLAlchemyError, OSError):
        app.add_exception_handler(kind, _store)
    app.add_exception_handler(Exception, _failed)
    options = service.options
    names = None if options.tokens_required else LOOPBACK | {options.host}
    app.add_middleware(Heads)
    app.add_middleware(Guard, upload_mb=service.limits.upload_mb, open_hosts=names, closed=service.closed)
    every = [*app.routes, *(route for router in ROUTERS for route in router.routes)]
    paths = [getattr(route, "path", "") for route in every]
    app.add_middleware(metrics.Measured, routes=paths)
    app.add_middleware(logs.Logged)
    if options.tokens_required:  # without tokens, what a proxy passes on is refused
        app.add_middleware(ProxyHeadersMiddleware, trusted_hosts=list(options.trusted_proxies))
    app.openapi = lambda: _openapi(app)  # type: ignore[method-assign]
    return app


def _openapi(app: FastAPI) -> dict[str, Any]:
    """OpenAPI with the schemas of problem files among its components."""
    if app.openapi_schema is None:
        from planner.service.catalogue import (
            IN_OPENAPI,
            problem_schema,  # loads all processes
        )

        made = get_openapi(
            title=app.title, version=app.version, description=app.description, routes=app.routes
        )
        made["components"]["schemas"] |= problem_schema(IN_OPENAPI)[1]
        for name in ("HTTPValidationError", "ValidationError"):  # no answer has them
            made["components"]["schemas"].pop(name, None)
        refusal = {PROBLEM_JSON: {"schema": {"$ref": "#/components/schemas/Refusal"}}}
        general = [str(one["description"]) for one in REFUSALS.values()]
        for path in made["paths"].values():
            for method in path.values():
                said = method["responses"].get("422", {}).get("description")
                if said != REFUSALS[422]["description"]:  # the framework lists it for all that has parameters
                    method["responses"].pop("422", None)
                for status, answer in method["responses"].items():
                    # a problem document, whatever a good answer is
                    if (status[0] == "4" and status != "416") or answer["description"] in general:
                        answer["content"] = refusal
        app.openapi_schema = made
    return app.openapi_schema


async def _refused(request: Request, error: Exception) -> JSONResponse:
    del request
    if not isinstance(error, RefusedError):
        raise error
    return JSONResponse(error.body, error.status, headers=error.headers, media_type=PROBLEM_JSON)


async def _invalid(request: Request, error: Exception) -> JSONResponse:
    if not isinstance(error, RequestValidationError):
        raise error
    issues = []
    for fault in error.errors():
        field = ".".join(str(step) for step in fault["loc"][1:]) or "body"
        got = "" if fault["type"] == "missing" else f", got {str(fault.get('input'))[:80]!r}"
        what = f"{field}: {fault['msg']}{got}; correct it"
        issues.append(Issue("service.request", what, field=field))
    return await _refused(request, RefusedError(422, issues))


async def _http(request: Request, error: Exception) -> JSONResponse:
    if not isinstance(error, HTTPException):
        raise error
    headers = dict(error.headers or {})
    if error.status_code == 405:
        headers["Allow"] = allowed([route for router in ROUTERS for route in router.routes], request.scope)
    way = f"; use {headers['Allow']}" if "Allow" in headers else ""
    what = f"{request.method} {request.url.path[:200]}: {error.detail}{way}; see /openapi.json"
    code = "service.not_found" if error.status_code in (404, 405) else "service.request"
    return await _refused(request, RefusedError(error.status_code, Issue(code, what), headers))


async def _gone(request: Request, error: Exception) -> JSONResponse:
    """Nobody hears it, and nothing is wrong with the service."""
    del error
    return await _refused(request, connection_closed())


async def _store(request: Request, error: Exception) -> JSONResponse:
    refused = store_refusal(error)
    if refused is None:
        return await _failed(request, error)
    LOG.warning(
        "%s %s: %s", request.method, request.url.path, type(error).__name__, extra=_of_request(request)
    )
    return await _refused(request, refused)


async def _failed(request: Request, error: Exception) -> JSONResponse:
    known = _of_request(request)
    LOG.error("%s %s failed", request.method, request.url.path, exc_info=error, extra=known)
    issue = Issue("internal.error", "the service itself failed, and has written down how; report this")
    headers = {logs.HEADER: known["request"]} if known["request"] else {}  # this answer passes by the others
    return await _refused(request, RefusedError(500, issue, headers))


def _of_request(request: Request) -> dict[str, Any]:
    known = getattr(request.state, "request_id", None)
    return {"request": known, "method": request.method, "path": request.url.path}


STREAMS_END_S: Final = 3
"""Streams that are open get so long to end when the service stops."""


def serve(
    options: Options, certificate: Path | None = None, key: Path | None = None, log: logs.Kind = "text"
) -> None:
    """Serve until told to stop: after SIGTERM it returns. Raises ``TandemError`` where it cannot start."""
    if (certificate is None) != (key is None):
        raise refusal("service.start", "TLS needs --certificate and --key, give both", field="certificate")
    if certificate is not None and key is not None:
        try:
            ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(certificate, key)
        except (OSError, ssl.SSLError) as error:
            message = f"certificate {certificate} with key {key}: cannot be used ({error}); give PEM files"
            raise refusal("service.start", message, field="certificate") from error
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))  # a connection is a file
    service = Service(options, make_team(options))
    config = uvicorn.Config(
        create_app(service),
        host=options.host,
        port=options.port,
        http=Hurried,
        log_level="info",
        access_log=log == "text",  # lines of JSON are about requests anyway
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
    logging.getLogger("uvicorn.access").addFilter(without_query)
    if log == "json":
        logs.write_json(options.data)
    # Uvicorn raises the signal that ended it again when all is stopped; to be asked to end is no failure, so
    # nothing more is to be done then
    signal.signal(signal.SIGTERM, lambda number, frame: None)
    _Server(config, service).run()


def without_query(record: logging.LogRecord) -> bool:
    """Take what follows a ? out of the address that a record of a request tells: a link's signature opens a
    file for whoever reads the log."""
    if isinstance(record.args, tuple):
        record.args = tuple(one.split("?")[0] if isinstance(one, str) else one for one in record.args)
    return True


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
