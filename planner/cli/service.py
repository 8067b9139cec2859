"""``tandem serve``, ``tandem token``, ``tandem backup`` and ``tandem restore``."""

from __future__ import annotations

import contextlib
import dataclasses
import datetime as dt
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal

import tyro
from rich.console import Console
from rich.table import Table

from planner.issues import issue_error

if TYPE_CHECKING:
    from planner.service.models import Database
    from planner.service.oidc import OidcSettings

DATA_FOLDER: Final = Path("tandem-data")
"""Default data folder of the service."""
INSTALL: Final = "pip install 'tandem-planner[service]'"
"""Command that installs the extra for the service."""
out: Final = Console()


@dataclasses.dataclass(frozen=True)
class Serve:
    """Serve Tandem over HTTP, with a page for browsers: jobs, files, progress."""

    host: str = "127.0.0.1"
    """address to listen on; anything except loopback needs tokens"""
    port: int = 8000
    """port to listen on"""
    data: Path = DATA_FOLDER
    """folder for files and, without --database, the database"""
    workers: int = 1
    """planning processes, one job each at a time"""
    cluster: str | None = None
    """plan on a Dask cluster: tcp://HOST:PORT of its scheduler, or local"""
    database: str | None = None
    """postgresql://USER:PASSWORD@HOST/NAME for several hosts; else a file in the data folder"""
    require_token: bool = False
    """require tokens on loopback too, for example behind a proxy"""
    trusted_proxy: tuple[str, ...] = ("127.0.0.1", "::1")
    """addresses of proxies whose X-Forwarded-Proto and X-Forwarded-For are trusted"""
    oidc_issuer: str | None = None
    """let people log in with this OpenID Connect provider (extra oidc), https://..."""
    oidc_client: str | None = None
    """client id of this service at the provider"""
    oidc_secret: Path | None = None
    """file with its client secret"""
    oidc_role: tuple[str, ...] = ()
    """VALUE=ROLE: accounts whose claim has the value may view, plan or release, or have the scope submit or
    released; *=view for all accounts; =ROLE@TEAM in that team, =released@TEAM:TAG jobs with that tag
    """
    oidc_claim: str = "groups"
    """the claim that is compared"""
    oidc_team: str | None = None
    """team of accounts whose role states none; they see all of its jobs; without it each sees only its own"""
    oidc_scope: str = "openid profile email"
    """requested scopes"""
    webhook_host: tuple[str, ...] = ()
    """HOST or HOST:PORT to which users may send webhooks about finished jobs; none: no webhooks"""
    certificate: Path | None = None
    """certificate for TLS, PEM"""
    key: Path | None = None
    """its key, PEM"""
    upload_mb: float = 200.0
    """maximum size of an upload"""
    mesh_mb: float = 50.0
    """maximum size of a mesh in it"""
    mesh_facets: int = 1_000_000
    """maximum number of facets of a mesh; it may have three times as many vertices"""
    open_jobs: int = 100
    """maximum number of waiting or running jobs of one token"""
    kept_jobs: int = 5000
    """maximum number of stored jobs of one token"""
    requests_per_s: float = 50.0
    """mean rate of requests of one token per second; a burst of ten seconds' worth is allowed"""
    readings: int = 100
    """maximum number of uploads of one token that are being read or wait to be read"""
    token_disk_mb: float = 20_000.0
    """disk space for the files of one token"""
    disk_mb: float | None = None
    """disk space for all files; else what the disk has"""
    job_timeout_s: float = 3600.0
    """time limit for planning a job"""
    job_memory_mb: float = 4096.0
    """memory limit for planning a job"""
    keep_days: float | None = None
    """delete finished jobs after this many days"""
    audit_days: float | None = 1095.0
    """delete audit entries after this many days; None for never"""
    log: Literal["text", "json"] = "text"
    """format of the log: text, or JSON lines on standard output"""
    lease_s: float = 30.0
    """on a shared database: after this time without a sign of life, other hosts take over the jobs of a
    host
    """


@dataclasses.dataclass(frozen=True, kw_only=True)
class _Store:
    """Store of the service that a command works on."""

    data: Path = DATA_FOLDER
    """data folder of the service"""
    database: str | None = None
    """database of the service, if it is not in the data folder"""


@dataclasses.dataclass(frozen=True)
class AddToken(_Store):
    """Create a token and print it, only this once."""

    name: tyro.conf.Positional[str]
    """owner of the token"""
    role: Literal["view", "plan", "release"] | None = None
    """what it may do: view; plan, also create and change jobs; release, also release programs; default
    plan
    """
    scope: Literal["submit", "released"] | None = None
    """submit, for a script: send jobs and read its own; released, for a screen at the cell: read what is
    released
    """
    tag: str | None = None
    """restrict the scope released to jobs with this tag, such as the cell's name"""
    team: str | None = None
    """tokens of one team see each other's jobs; without a team a token sees only its own"""
    expires: str | None = None
    """lifetime: 12h, 90d or 4w; default: until it is revoked"""


@dataclasses.dataclass(frozen=True)
class List(_Store):
    """List the tokens, without their secrets."""


@dataclasses.dataclass(frozen=True)
class Revoke(_Store):
    """Revoke a token immediately; its jobs are kept."""

    name: tyro.conf.Positional[str]
    """owner of the token"""


@dataclasses.dataclass(frozen=True)
class Drafts(_Store):
    """List the drafts, cells, tools and templates of a token, pass them on, or delete them.

    This also works for tokens of people who left, and for revoked tokens.
    """

    name: tyro.conf.Positional[str]
    """owner of the drafts"""
    to: str | None = None
    """name of the token that receives all of them"""
    delete: bool = False
    """delete all of them"""


@dataclasses.dataclass(frozen=True)
class Audit(_Store):
    """List the actions of users, newest first.

    These are who submitted, cancelled, deleted, released, withdrew, downloaded programs and created links.
    """

    job: str | None = None
    """only of this job, by its id"""
    act: tuple[str, ...] = ()
    """only these acts: submitted, cancelled, retried, deleted, released, withdrew, downloaded, linked,
    unlinked, passed
    """
    most: int = 100
    """maximum number of entries"""
    json: bool = False
    """one JSON object per line, with all details"""


@dataclasses.dataclass(frozen=True)
class BackUp(_Store):
    """Back up the store of a service into a new folder: a consistent snapshot of database and files.

    The service may keep running.
    """

    folder: tyro.conf.Positional[Path]
    """the new folder"""


@dataclasses.dataclass(frozen=True)
class Restore:
    """Restore a backup into a new data folder; nothing is overwritten."""

    folder: tyro.conf.Positional[Path]
    """a backup made by `tandem backup`"""
    data: Path = DATA_FOLDER
    """new data folder, of a service that is not running"""
    database: str | None = None
    """empty database to fill, if it is not to be in the data folder"""


Token = tyro.conf.OmitSubcommandPrefixes[
    Annotated[AddToken, tyro.conf.subcommand("add")]
    | Annotated[List, tyro.conf.subcommand("list")]
    | Annotated[Revoke, tyro.conf.subcommand("revoke")]
    | Annotated[Drafts, tyro.conf.subcommand("drafts")]
]


def serve(request: Serve) -> None:
    """Serve until stopped.

    Raises:
        TandemError: The service cannot start.
    """
    with _require_installed():
        from planner.service import app as server
        from planner.service.security import ServiceLimits
        from planner.service.service import Options

    limits = ServiceLimits(
        upload_mb=request.upload_mb,
        mesh_mb=request.mesh_mb,
        mesh_facets=request.mesh_facets,
        open_jobs=request.open_jobs,
        kept_jobs=request.kept_jobs,
        readings=request.readings,
        requests_per_s=request.requests_per_s,
        token_disk_mb=request.token_disk_mb,
        disk_mb=request.disk_mb,
        job_s=request.job_timeout_s,
        job_memory_mb=request.job_memory_mb,
        keep_days=request.keep_days,
        audit_days=request.audit_days,
    )
    other_limits = {"workers": request.workers, "lease_s": request.lease_s}
    for name, value in (dataclasses.asdict(limits) | other_limits).items():
        if value is not None and not value > 0:
            raise issue_error("service.start", f"{name}: must be above 0, got {value:g}", field=name)
    server.serve(
        Options(
            data=request.data,
            host=request.host,
            port=request.port,
            database=request.database,
            workers=request.workers,
            cluster=request.cluster,
            require_token=request.require_token,
            trusted_proxies=request.trusted_proxy,
            webhook_hosts=request.webhook_host,
            lease_s=request.lease_s,
            oidc=None if request.oidc_issuer is None else _oidc(request, request.oidc_issuer),
            limits=limits,
        ),
        request.certificate,
        request.key,
        request.log,
    )


def _oidc(request: Serve, issuer: str) -> OidcSettings:
    """Return the settings of the log-in through the provider at the address ``issuer``."""
    try:
        from planner.service import oidc
    except ImportError as error:
        hint = "install it: pip install 'tandem-planner[service,oidc]'"
        message = f"login with a provider needs {error.name or error}, which is not installed"
        raise issue_error("service.install", message, hint=hint) from error
    grant_options = oidc.GrantOptions(request.oidc_role, request.oidc_claim, request.oidc_team)
    return oidc.read_settings(
        issuer, request.oidc_client, request.oidc_secret, grant_options, request.oidc_scope
    )


def token(request: AddToken | List | Revoke | Drafts) -> None:
    """Create, list or revoke tokens, or handle drafts.

    Raises:
        TandemError: The store or the token is not usable.
    """
    database = _open_store(request, create=not isinstance(request, Drafts))
    from planner.service.security import Auth, parse_lifetime

    auth = Auth(database)
    if isinstance(request, AddToken):
        lifetime_s = None if request.expires is None else parse_lifetime(request.expires)
        secret = auth.create_token(
            request.name, request.role, request.team, lifetime_s, request.scope, request.tag
        )
        sys.stdout.write(f"{secret}\n")
    elif isinstance(request, Revoke):
        auth.revoke(request.name)
        out.print(f"{request.name}: revoked", highlight=False)
    elif isinstance(request, Drafts):
        _drafts(request, database)
    else:
        table = Table("name", "role", "scope", "team", "made", "ends", "revoked")
        for stored in auth.list():
            times = (_format_time(moment) for moment in (stored.created, stored.expires, stored.revoked))
            scope = " ".join(filter(None, (stored.scope, stored.tag)))
            table.add_row(stored.name, stored.role, scope, stored.team or "", *times)
        out.print(table)


def _drafts(request: Drafts, database: Database) -> None:
    """List the drafts of a token, pass them to another token, or delete them."""
    from planner.service.drafts import DraftStore
    from planner.service.models import format_time, utc
    from planner.service.security import ServiceLimits

    draft_store = DraftStore(database, ServiceLimits())
    if request.delete and request.to is not None:
        raise issue_error("service.token", "to: --to and --delete exclude each other; omit one", field="to")
    if request.delete or request.to is not None:
        count = draft_store.transfer(request.name, request.to)
        outcome = "deleted" if request.to is None else f"passed to {request.to}"
        _print_line(f"{request.name}: {count} drafts, cells, tools and templates {outcome}")
    else:
        for row in draft_store.of_token(request.name):
            _print_line(f"{row['id']}  {format_time(utc(row['changed']))}  {row['kind']}  {row['title']}")


def audit(request: Audit) -> None:
    """List the audit entries of a store.

    Raises:
        TandemError: The store cannot be opened.
    """
    with _require_installed():
        from planner.service import audit as audit_log
        from planner.service.models import format_time
    entries = audit_log.all_entries(_open_store(request), request.job, request.act, max(request.most, 1))
    for entry in entries:
        if request.json:
            sys.stdout.write(f"{entry.model_dump_json(exclude_none=True)}\n")
        else:
            details = [entry.about.get(key) for key in ("name", "file", "link", "release", "reason", "note")]
            detail_text = ", ".join(" ".join(str(text).split()) for text in details if text)
            time_text = format_time(entry.at)
            _print_line(
                f"{time_text}  {entry.by}{f' ({entry.team})' if entry.team else ''}  {entry.act}  "
                f"{entry.job}  {detail_text}"
            )


def back_up(request: BackUp) -> None:
    """Create a backup.

    Raises:
        TandemError: The backup cannot be written.
    """
    with _require_installed():
        from planner.service import backup
    backup_summary = backup.back_up(request.data, request.database, request.folder)
    _print_line(
        f"{request.folder}: a backup of {backup_summary.jobs} jobs, {backup_summary.files} files, "
        f"{backup_summary.size / 1e6:,.1f} MB"
    )


def restore(request: Restore) -> None:
    """Restore a backup.

    Raises:
        TandemError: The backup cannot be restored.
    """
    with _require_installed():
        from planner.service import backup
    restored = backup.restore(request.folder, request.data, request.database)
    _print_line(
        f"{request.data}: restored {restored.jobs} jobs, {restored.files} files, {restored.size / 1e6:,.1f} "
        "MB"
    )
    from planner.service.security import Auth

    database = _open_store(_Store(data=request.data, database=request.database))
    valid_names = [stored.name for stored in Auth(database).list() if stored.revoked is None]
    database.close()
    if valid_names:
        message = (
            f"tokens and accounts are valid as at the backup: {', '.join(valid_names)}, with their links; "
        )
        _print_line(f"{message}revoke again those that were revoked since: tandem token revoke NAME")


def _print_line(line: str) -> None:
    out.print(line, highlight=False, markup=False, soft_wrap=True)


@contextlib.contextmanager
def _require_installed() -> Iterator[None]:
    """Convert errors of the imports of the service to an issue with the command that installs it.

    Raises:
        TandemError: ``service.install``.
    """
    try:
        yield
    except ImportError as error:
        message = f"the service needs {error.name or error}"
        raise issue_error("service.install", message, hint=INSTALL) from error


def _open_store(request: _Store, create: bool = False) -> Database:
    """Open the store that a command works on. ``create`` creates it if there is none.

    Raises:
        TandemError: The store does not exist or cannot be opened, or the service is not installed.
    """
    with _require_installed():
        from planner.service.models import Database, default_url
    if request.database is None and create:
        try:
            request.data.mkdir(parents=True, exist_ok=True, mode=0o700)
        except OSError as error:
            message = f"data folder {request.data}: cannot be written ({error.strerror}); choose another one"
            raise issue_error("service.start", message, field="data") from error
    elif request.database is None and not (request.data / "tandem.db").is_file():
        text = f"data folder {request.data}: contains no store; state the same --data as the service"
        raise issue_error("service.start", text, field="data")
    return Database(request.database or default_url(request.data))


def _format_time(seconds: float | None) -> str:
    """Format a time [s since 1970] to the minute; empty for None."""
    if seconds is None:
        return ""
    return dt.datetime.fromtimestamp(seconds, dt.UTC).strftime("%Y-%m-%d %H:%M UTC")
