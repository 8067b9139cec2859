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

from planner.issues import refusal

if TYPE_CHECKING:
    from planner.service.models import Database
    from planner.service.oidc import Oidc

DATA_FOLDER: Final = Path("tandem-data")
"""Where the service keeps its data, unless told otherwise."""
INSTALL: Final = "pip install 'tandem-planner[service]'"
"""What installs the extra that the service needs."""
out: Final = Console()


@dataclasses.dataclass(frozen=True)
class Serve:
    """Serve Tandem over HTTP, with a page for browsers: jobs, files, progress."""

    host: str = "127.0.0.1"
    """address to listen at; anything but loopback needs tokens"""
    port: int = 8000
    """port to listen at"""
    data: Path = DATA_FOLDER
    """folder for files and, without --database, the database"""
    workers: int = 1
    """processes that plan, one job each at a time"""
    cluster: str | None = None
    """plan on a Dask cluster: tcp://HOST:PORT of its scheduler, or local"""
    database: str | None = None
    """postgresql://USER:PASSWORD@HOST/NAME for several hosts; else a file in the data folder"""
    require_token: bool = False
    """ask for tokens on loopback too, as behind a proxy"""
    trusted_proxy: tuple[str, ...] = ("127.0.0.1", "::1")
    """addresses of proxies whose X-Forwarded-Proto and X-Forwarded-For are believed"""
    oidc_issuer: str | None = None
    """let people log in by this OpenID Connect provider (extra oidc), https://..."""
    oidc_client: str | None = None
    """what this service is called there"""
    oidc_secret: Path | None = None
    """file with its secret there"""
    oidc_role: tuple[str, ...] = ()
    """VALUE=ROLE: whose claim has the value may view, plan or release, or by a scope submit or released;
    *=view for all accounts; =ROLE@TEAM in that team, =released@TEAM:TAG jobs with that tag"""
    oidc_claim: str = "groups"
    """the claim that is meant"""
    oidc_team: str | None = None
    """team of accounts whose role says none, whose jobs they all see; else each sees its own alone"""
    oidc_scope: str = "openid profile email"
    """scopes that are asked for"""
    webhook_host: tuple[str, ...] = ()
    """HOST or HOST:PORT whose addresses users may have told of jobs that end; none: no address is told"""
    certificate: Path | None = None
    """certificate for TLS, PEM"""
    key: Path | None = None
    """its key, PEM"""
    upload_mb: float = 200.0
    """largest upload"""
    mesh_mb: float = 50.0
    """largest mesh in it"""
    mesh_facets: int = 1_000_000
    """most facets of a mesh; it may have three times as many vertices"""
    open_jobs: int = 100
    """jobs of one token that may wait or run"""
    kept_jobs: int = 5000
    """jobs of one token that are kept"""
    requests_per_s: float = 50.0
    """requests of one token on average, a second; ten seconds' worth may come at once"""
    readings: int = 100
    """uploads of one token that may be read or wait to be read"""
    token_disk_mb: float = 20_000.0
    """room for the files of one token"""
    disk_mb: float | None = None
    """room for all files; else what the disk has"""
    job_timeout_s: float = 3600.0
    """most time of planning, a job"""
    job_memory_mb: float = 4096.0
    """most memory of planning, a job"""
    keep_days: float | None = None
    """delete finished jobs after so many days"""
    audit_days: float | None = 1095.0
    """forget who did what after so many days; None for never"""
    log: Literal["text", "json"] = "text"
    """how the log is written: for people, or as lines of JSON on standard output"""
    lease_s: float = 30.0
    """on a shared database: jobs of a host that has been silent for so long are planned by others"""


@dataclasses.dataclass(frozen=True, kw_only=True)
class _Store:
    """The store of a service that a command works on."""

    data: Path = DATA_FOLDER
    """data folder of the service"""
    database: str | None = None
    """database of the service, if it is not in the data folder"""


@dataclasses.dataclass(frozen=True)
class Add(_Store):
    """Make a token and print it, this once."""

    name: tyro.conf.Positional[str]
    """whose it is"""
    role: Literal["view", "plan", "release"] | None = None
    """what it may do: look, also make and change jobs, also release programs; unless stated plan"""
    scope: Literal["submit", "released"] | None = None
    """for a script: send jobs and read those that it sent; for a screen at the cell: read what is released"""
    tag: str | None = None
    """the scope released has the jobs with this tag alone, such as the cell's name"""
    team: str | None = None
    """tokens of one team see one another's jobs; without a team a token sees its own alone"""
    expires: str | None = None
    """how long it is good for: 12h, 90d or 4w; unless stated until it is revoked"""


@dataclasses.dataclass(frozen=True)
class List(_Store):
    """List the tokens, without their secrets."""


@dataclasses.dataclass(frozen=True)
class Revoke(_Store):
    """End a token at once; its jobs stay."""

    name: tyro.conf.Positional[str]
    """whose it is"""


@dataclasses.dataclass(frozen=True)
class Drafts(_Store):
    """List what a token keeps as drafts, cells, tools and templates, or pass that on, or delete it: of who
    left, and of a token that was revoked."""

    name: tyro.conf.Positional[str]
    """whose they are"""
    to: str | None = None
    """name of the token that gets all of them"""
    delete: bool = False
    """delete all of them"""


@dataclasses.dataclass(frozen=True)
class Audit(_Store):
    """List who submitted, cancelled, deleted, released, withdrew, downloaded programs and made links, the
    newest first."""

    job: str | None = None
    """of this job alone, by its id"""
    act: tuple[str, ...] = ()
    """these acts alone: submitted, cancelled, retried, deleted, released, withdrew, downloaded, linked,
    unlinked, passed"""
    most: int = 100
    """so many entries"""
    json: bool = False
    """as a JSON object a line, with all that is known"""


@dataclasses.dataclass(frozen=True)
class BackUp(_Store):
    """Back the service's store up into a new folder: database and files as they are at one moment. The
    service may run meanwhile."""

    folder: tyro.conf.Positional[Path]
    """the new folder"""


@dataclasses.dataclass(frozen=True)
class Restore:
    """Restore a backup into a new data folder; nothing is overwritten."""

    folder: tyro.conf.Positional[Path]
    """what `tandem backup` made"""
    data: Path = DATA_FOLDER
    """data folder to be, of a service that does not run"""
    database: str | None = None
    """empty database to be filled, if it is not to lie in the data folder"""


Token = tyro.conf.OmitSubcommandPrefixes[
    Annotated[Add, tyro.conf.subcommand("add")]
    | Annotated[List, tyro.conf.subcommand("list")]
    | Annotated[Revoke, tyro.conf.subcommand("revoke")]
    | Annotated[Drafts, tyro.conf.subcommand("drafts")]
]


def serve(asked: Serve) -> None:
    """Serve until told to stop; raises ``TandemError`` where it cannot start."""
    with _installed():
        from planner.service import app as server
        from planner.service.security import Limits
        from planner.service.service import Options

    limits = Limits(
        upload_mb=asked.upload_mb,
        mesh_mb=asked.mesh_mb,
        mesh_facets=asked.mesh_facets,
        open_jobs=asked.open_jobs,
        kept_jobs=asked.kept_jobs,
        readings=asked.readings,
        requests_per_s=asked.requests_per_s,
        token_disk_mb=asked.token_disk_mb,
        disk_mb=asked.disk_mb,
        job_s=asked.job_timeout_s,
        job_memory_mb=asked.job_memory_mb,
        keep_days=asked.keep_days,
        audit_days=asked.audit_days,
    )
    more = {"workers": asked.workers, "lease_s": asked.lease_s}
    for name, value in (dataclasses.asdict(limits) | more).items():
        if value is not None and not value > 0:
            raise refusal("service.start", f"{name}: got {value:g}, give more than 0", field=name)
    server.serve(
        Options(
            data=asked.data,
            host=asked.host,
            port=asked.port,
            database=asked.database,
            workers=asked.workers,
            cluster=asked.cluster,
            require_token=asked.require_token,
            trusted_proxies=asked.trusted_proxy,
            webhook_hosts=asked.webhook_host,
            lease_s=asked.lease_s,
            oidc=None if asked.oidc_issuer is None else _oidc(asked, asked.oidc_issuer),
            limits=limits,
        ),
        asked.certificate,
        asked.key,
        asked.log,
    )


def _oidc(asked: Serve, issuer: str) -> Oidc:
    try:
        from planner.service import oidc
    except ImportError as error:
        hint = "install it: pip install 'tandem-planner[service,oidc]'"
        what = f"logging in by a provider needs {error.name or error}, which is not installed"
        raise refusal("service.install", what, hint=hint) from error
    given = (asked.oidc_client, asked.oidc_secret, asked.oidc_role, asked.oidc_claim, asked.oidc_team)
    return oidc.read(issuer, *given, asked.oidc_scope)


def token(asked: Add | List | Revoke | Drafts) -> None:
    """Make, list or end tokens; raises ``TandemError``."""
    database = _opened(asked, make=not isinstance(asked, Drafts))
    from planner.service.security import Auth, lasts

    auth = Auth(database)
    if isinstance(asked, Add):
        lasts_s = None if asked.expires is None else lasts(asked.expires)
        made = auth.make(asked.name, asked.role, asked.team, lasts_s, asked.scope, asked.tag)
        sys.stdout.write(f"{made}\n")
    elif isinstance(asked, Revoke):
        auth.revoke(asked.name)
        out.print(f"{asked.name}: revoked", highlight=False)
    elif isinstance(asked, Drafts):
        _drafts(asked, database)
    else:
        table = Table("name", "role", "scope", "team", "made", "ends", "revoked")
        for known in auth.list():
            times = (_moment(one) for one in (known.created, known.expires, known.revoked))
            scope = " ".join(filter(None, (known.scope, known.tag)))
            table.add_row(known.name, known.role, scope, known.team or "", *times)
        out.print(table)


def _drafts(asked: Drafts, database: Database) -> None:
    from planner.service.drafts import Drafts as Kept
    from planner.service.models import moment, utc
    from planner.service.security import Limits

    kept = Kept(database, Limits())
    if asked.delete and asked.to is not None:
        raise refusal("service.token", "to: it is either --to or --delete; leave one out", field="to")
    if asked.delete or asked.to is not None:
        count = kept.pass_on(asked.name, asked.to)
        done = "deleted" if asked.to is None else f"passed to {asked.to}"
        _tell(f"{asked.name}: {count} drafts, cells, tools and templates {done}")
    else:
        for row in kept.of_token(asked.name):
            _tell(f"{row['id']}  {moment(utc(row['changed']))}  {row['kind']}  {row['title']}")


def audit(asked: Audit) -> None:
    """List what was done in a store; raises ``TandemError``."""
    with _installed():
        from planner.service import audit as log
        from planner.service.models import moment
    found = log.everything(_opened(asked), asked.job, asked.act, max(asked.most, 1))
    for one in found:
        if asked.json:
            sys.stdout.write(f"{one.model_dump_json(exclude_none=True)}\n")
        else:
            told = [one.about.get(key) for key in ("name", "file", "link", "release", "reason", "note")]
            said = ", ".join(" ".join(str(text).split()) for text in told if text)
            at = moment(one.at)
            _tell(f"{at}  {one.by}{f' ({one.team})' if one.team else ''}  {one.act}  {one.job}  {said}")


def back_up(asked: BackUp) -> None:
    """Make a backup; raises ``TandemError``."""
    with _installed():
        from planner.service import backup
    made = backup.back_up(asked.data, asked.database, asked.folder)
    _tell(f"{asked.folder}: a backup of {made.jobs} jobs, {made.files} files, {made.size / 1e6:,.1f} MB")


def restore(asked: Restore) -> None:
    """Restore a backup; raises ``TandemError``."""
    with _installed():
        from planner.service import backup
    made = backup.restore(asked.folder, asked.data, asked.database)
    _tell(f"{asked.data}: restored {made.jobs} jobs, {made.files} files, {made.size / 1e6:,.1f} MB")
    from planner.service.security import Auth

    database = _opened(_Store(data=asked.data, database=asked.database))
    alive = [one.name for one in Auth(database).list() if one.revoked is None]
    database.close()
    if alive:
        what = f"tokens and accounts are in force as they were then: {', '.join(alive)}, with their links; "
        _tell(f"{what}revoke again what was revoked since: tandem token revoke NAME")


def _tell(what: str) -> None:
    out.print(what, highlight=False, markup=False, soft_wrap=True)


@contextlib.contextmanager
def _installed() -> Iterator[None]:
    """Imports for the service; raises ``TandemError``, which says what to install."""
    try:
        yield
    except ImportError as error:
        what = f"the service needs {error.name or error}"
        raise refusal("service.install", what, hint=INSTALL) from error


def _opened(asked: _Store, make: bool = False) -> Database:
    """The store that a command works on, made where there is none and that is asked for."""
    with _installed():
        from planner.service.models import Database, default_url
    if asked.database is None and make:
        try:
            asked.data.mkdir(parents=True, exist_ok=True, mode=0o700)
        except OSError as error:
            message = f"data folder {asked.data}: cannot be written ({error.strerror}); give another one"
            raise refusal("service.start", message, field="data") from error
    elif asked.database is None and not (asked.data / "tandem.db").is_file():
        what = f"data folder {asked.data}: there is no store in it; give --data as the service has it"
        raise refusal("service.start", what, field="data")
    return Database(asked.database or default_url(asked.data))


def _moment(seconds: float | None) -> str:
    if seconds is None:
        return ""
    return dt.datetime.fromtimestamp(seconds, dt.UTC).strftime("%Y-%m-%d %H:%M UTC")
