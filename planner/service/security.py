"""Who asks, what one user may ask, and what stands before every request.

Of a token only the hash is kept; browsers that showed one get a cookie, and a link to one file may be
signed for a time. A token has a role, perhaps a team whose jobs it sees, perhaps a scope that is narrower,
and perhaps an end. Before every
request stand the size of its body, where it comes from, and what browsers may do with the answer. The
service says no by an HTTP status and issues that say why.
"""

import dataclasses
import hashlib
import hmac
import json
import math
import re
import secrets
import time
from collections.abc import Callable, Mapping, MutableMapping, Sequence
from http import HTTPStatus
from typing import Any, Final
from urllib.parse import SplitResult, urlsplit

import anyio
from sqlalchemy import ColumnElement, RowMapping, and_, delete, func, insert, or_, select, update
from sqlalchemy.exc import IntegrityError
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from planner.issues import Issue, TandemError, refusal
from planner.runtime.version import __version__
from planner.service.models import SECRETS, SESSIONS, TOKEN_ROLES, TOKENS, Database, TokenRole, TokenScope
from planner.service.scopes import ROLE_OF, is_open, scope_fault


@dataclasses.dataclass(frozen=True)
class Limits:
    """``upload_mb`` of one request, ``mesh_mb`` and ``mesh_facets`` of one mesh (50 MB of STL are a million
    facets; three times as many vertices may be), ``files`` of one upload; ``open_jobs`` that wait or run
    and ``kept_jobs`` in all, of one token; ``token_disk_mb`` of a token's files and ``disk_mb`` of all files,
    each content once, None for what the disk has; ``readings`` of uploads that wait or are under way, of one
    token; ``job_s`` and ``job_memory_mb`` of one job's planning,
    ``check_s`` and ``check_memory_mb`` of reading or checking a problem; ``streams`` of events at once, of
    one token, and ``requests_per_s`` of it, None for any; ``keep_days`` until a finished job is deleted,
    ``audit_days`` until an entry of the audit log is, None for never.
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
    requests_per_s: float | None = 50.0
    drafts: int = 500
    keep_days: float | None = None
    audit_days: float | None = 1095.0


PROBLEM_JSON: Final = "application/problem+json"
"""Content type of a refusal (RFC 9457)."""


class RefusedError(Exception):
    """A request that is refused; ``issues`` carry code and field. Where several things were sent, ``of`` has
    the number of one, from 0, for each issue."""

    def __init__(
        self,
        status: int,
        issues: Issue | Sequence[Issue],
        headers: Mapping[str, str] | None = None,
        of: Sequence[int] = (),
    ) -> None:
        self.status = status
        self.of = tuple(of)
        self.issues = (issues,) if isinstance(issues, Issue) else tuple(issues)
        self.headers = dict(headers or {})
        super().__init__("; ".join(issue.message for issue in self.issues))

    @property
    def body(self) -> dict[str, Any]:
        """The answer as a problem document (RFC 9457), with the issues besides."""
        known = {one.value: one.phrase for one in HTTPStatus}
        return {
            "type": "about:blank",
            "title": known.get(self.status, "Refused"),
            "status": self.status,
            "detail": str(self),
            "issues": [issue_json(issue) for issue in self.issues],
            **({"of": list(self.of)} if self.of else {}),
        }


def issue_json(issue: Issue) -> dict[str, Any]:
    """The issue as JSON has it: numbers that are not finite are left out."""
    data = issue.to_dict()
    return {k: v for k, v in data.items() if not isinstance(v, float) or math.isfinite(v)}


def unknown_job(job: str) -> RefusedError:
    """404."""
    return RefusedError(404, Issue("service.unknown_job", f"job {job[:40]!r}: there is none; list the jobs"))


def too_many(what: str, again_s: int, limit: float | None = None, unit: str | None = None) -> RefusedError:
    """429, for who may ask again in ``again_s`` [s]."""
    issue = Issue("service.too_many", what, limit=limit, unit=unit)
    return RefusedError(429, issue, {"Retry-After": str(again_s)})


def too_large(what: str, limit_mb: float, field: str | None = None) -> RefusedError:
    """413."""
    message = f"{what} is larger than the {limit_mb:g} MB that this service takes; send less, or fewer facets"
    return RefusedError(413, Issue("service.too_large", message, field=field, limit=limit_mb, unit="MB"))


LOCAL: Final = "local"
"""The owner of jobs that came without a token, over loopback."""
SESSION_S: Final = 30 * 86400.0
"""Time [s] after which a session of a browser ends."""
TOKENS_PER_QUERY: Final = 500
"""Tokens that one query of the database asks for."""
_TOKEN: Final = re.compile(r"tandem_([0-9a-f]{16})_[A-Za-z0-9_-]{43}")
"""A token: the identifier that the database knows, and the secret."""
TOKEN_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.@-]{0,63}")
"""A name that a token, or a team, may have."""
_LASTS: Final = re.compile(r"([1-9][0-9]{0,3})([hdw])")
"""How long a token is good for."""
_UNITS_S: Final = {"h": 3600.0, "d": 86400.0, "w": 604800.0}
"""Seconds of an hour, a day, a week."""


@dataclasses.dataclass(frozen=True)
class TokenInfo:
    """A token without its secret; times are seconds since 1970."""

    name: str
    created: float
    revoked: float | None
    role: TokenRole
    team: str | None
    expires: float | None
    scope: TokenScope | None
    tag: str | None


@dataclasses.dataclass(frozen=True)
class Who:
    """Who asks: the identifier of a ``token``, which owns what is made with it, its name, what it may do,
    its team, its end [s since 1970], and its scope, of jobs with a ``tag`` alone where it has one."""

    token: str
    name: str
    role: TokenRole
    team: str | None = None
    expires: float | None = None
    scope: TokenScope | None = None
    tag: str | None = None

    def ask(self, method: str, path: str) -> None:
        """Raises :class:`RefusedError`, 403, beyond the token's scope; ``path`` as a route names it."""
        if self.scope is not None and not is_open(self.scope, method, path):
            what = f"this is beyond the scope {self.scope} of the token {self.name}"
            way = "ask who runs the service for a token without a scope: tandem token add NAME"
            raise RefusedError(403, Issue("service.role", what, field="Authorization", hint=way))

    def need(self, role: TokenRole) -> None:
        """Raises :class:`RefusedError`, 403, where the token's role does not include ``role``."""
        if TOKEN_ROLES.index(self.role) < TOKEN_ROLES.index(role):
            what = f"this needs a token with the role {role}, the token {self.name} has the role {self.role}"
            way = f"ask who runs the service for one: tandem token add NAME --role {role}"
            raise RefusedError(403, Issue("service.role", what, field="Authorization", hint=way))


ANYBODY: Final = Who(LOCAL, LOCAL, "release")
"""Who asks where no tokens are asked for."""


def lasts(text: str) -> float:
    """How long a token is good for [s], said as ``12h``, ``90d`` or ``4w``. Raises ``TandemError``."""
    found = _LASTS.fullmatch(text)
    if found is None:
        what = f"expires: got {text[:40]!r}; give a whole number up to 9999 with h, d or w, such as 90d"
        raise refusal("service.token", what, field="expires")
    return float(found[1]) * _UNITS_S[found[2]]


class Auth:
    """The tokens and sessions of one database."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def make(
        self,
        name: str,
        role: TokenRole | None = None,
        team: str | None = None,
        lasts_s: float | None = None,
        scope: TokenScope | None = None,
        tag: str | None = None,
    ) -> str:
        """A new token, which is told this once, good for ``lasts_s`` from now on. What is not said is the
        role plan, or that of the scope. Raises ``TandemError`` for a name that is taken or odd, and a scope
        that does not go with the rest."""
        role = role or (ROLE_OF[scope] if scope else "plan")
        if fault := scope_fault(role, team, scope, tag):
            raise TandemError(fault)
        for one, field in ((name, "name"), (team, "team")):
            if one is not None and not TOKEN_NAME.fullmatch(one):
                raise TandemError(_bad_name(one, "use letters, digits and _ . @ -, at most 64", field))
        number = secrets.token_hex(8)
        token = f"tandem_{number}_{secrets.token_urlsafe(32)}"
        now = self._database.clock()
        row: dict[str, Any] = {"id": number, "name": name, "hash": _hash(token), "role": role, "team": team}
        row |= {"created": now, "expires": None if lasts_s is None else now + lasts_s}
        row |= {"scope": scope, "tag": tag}
        try:
            with self._database.write() as db:
                db.execute(insert(TOKENS).values(row))
        except IntegrityError as error:
            raise TandemError(_bad_name(name, "there is a token of that name; choose another")) from error
        return token

    def account(
        self,
        key: str,
        name: str,
        role: TokenRole,
        team: str | None,
        scope: TokenScope | None = None,
        tag: str | None = None,
        every: Sequence[str] = (),
    ) -> Who:
        """The account ``key`` of a provider, as a token that no secret opens; another one that is called so
        already has the ``name`` for itself. ``every``: the keys of the same account in all teams, whose
        sessions end but those of this one. Raises :class:`RefusedError`, 403, where one was revoked."""
        number, same = _account(key), {_account(one) for one in (key, *every)}
        plain = re.sub(r"[^A-Za-z0-9_.@-]", "_", name).lstrip("_.@-")[:64] or number
        with self._database.write() as db:
            self._database.one_at_a_time(db, "accounts")
            rows = db.execute(select(TOKENS).where(TOKENS.c.id.in_(same))).mappings().all()
            for row in rows:
                if row["revoked"] is not None:
                    raise RefusedError(403, Issue("service.log_in", f"the account {row['name']} was revoked"))
            taken = select(TOKENS.c.id).where(TOKENS.c.name == plain, TOKENS.c.id != number)
            if db.execute(taken).first() is not None:
                plain = f"{plain[:55]}-{number[:8]}"
            known = {"name": plain, "role": role, "team": team, "scope": scope, "tag": tag}
            if number not in {row["id"] for row in rows}:
                made = {"id": number, "hash": f"account {number}", "created": self._database.clock()}
                db.execute(insert(TOKENS).values(made | known))
            else:
                db.execute(update(TOKENS).where(TOKENS.c.id == number).values(known))
            if others := same - {number}:
                db.execute(delete(SESSIONS).where(SESSIONS.c.token.in_(others)))
        return Who(number, plain, role, team, scope=scope, tag=tag)

    def close_accounts(self, keys: Sequence[str]) -> None:
        """End the sessions of accounts of a provider."""
        with self._database.write() as db:
            db.execute(delete(SESSIONS).where(SESSIONS.c.token.in_([_account(key) for key in keys])))

    def list(self) -> tuple[TokenInfo, ...]:
        """All tokens, the oldest first."""
        with self._database.read() as db:
            rows = db.execute(select(TOKENS).order_by(TOKENS.c.created)).mappings()
            fields = [field.name for field in dataclasses.fields(TokenInfo)]
            return tuple(TokenInfo(**{name: row[name] for name in fields}) for row in rows)

    def revoke(self, name: str) -> None:
        """End a token and its sessions at once; its jobs stay. Raises ``TandemError`` where there is none."""
        with self._database.write() as db:
            number = db.execute(select(TOKENS.c.id).where(TOKENS.c.name == name)).scalar()
            if number is None:
                raise TandemError(_bad_name(name, "there is no token of that name; list them"))
            db.execute(update(TOKENS).where(TOKENS.c.id == number).values(revoked=time.time()))
            db.execute(delete(SESSIONS).where(SESSIONS.c.token == number))

    def any(self) -> bool:
        """Whether a token is in force."""
        with self._database.read() as db:
            alive = select(func.count()).select_from(TOKENS).where(self._good())
            return bool(db.execute(alive).scalar_one())

    def who(self, token: str) -> Who:
        """Whose token it is; raises :class:`RefusedError`, 401."""
        found = _TOKEN.fullmatch(token)
        row = None
        if found:
            query = select(TOKENS, self._good().label("good")).where(TOKENS.c.id == found[1])
            with self._database.read() as db:
                row = db.execute(query).mappings().first()
        kept = "" if row is None else row["hash"]
        if not hmac.compare_digest(kept, _hash(token)) or row is None or row["revoked"] is not None:
            raise unauthorised("the token is unknown or was revoked; ask for a new one")
        if not row["good"]:
            raise unauthorised("the token has come to its end; ask for a new one")
        return _who(row)

    def in_force(self, owner: str) -> bool:
        """Whether the owner's token is known, was not revoked, and has not come to its end."""
        query = select(TOKENS.c.id).where(TOKENS.c.id == owner, self._good())
        with self._database.read() as db:
            return db.execute(query).first() is not None

    def teams(self, tokens: Sequence[str]) -> dict[str, str | None]:
        """Those of the tokens that are in force, with their teams."""
        found: dict[str, str | None] = {}
        with self._database.read() as db:
            for start in range(0, len(tokens), TOKENS_PER_QUERY):
                some = TOKENS.c.id.in_(tokens[start : start + TOKENS_PER_QUERY])
                rows = db.execute(select(TOKENS.c.id, TOKENS.c.team).where(some, self._good()))
                found |= dict(row.tuple() for row in rows)
        return found

    def owners(self, who: Who) -> Sequence[str]:
        """Tokens whose jobs ``who`` sees: its own, and those of its team, also such as are over. One that
        only sends sees its own alone."""
        return [who.token] if who.scope == "submit" else [who.token, *self.mates(who.token)]

    def sees(self, who: Who, owner: str | None) -> bool:
        """Whether ``who`` sees jobs of that owner."""
        return owner is not None and owner in self.owners(who)

    def mates(self, owner: str) -> Sequence[str]:
        """The other tokens of the team of a token; none where it has no team."""
        team = select(TOKENS.c.team).where(TOKENS.c.id == owner).scalar_subquery()
        query = select(TOKENS.c.id).where(TOKENS.c.team == team, TOKENS.c.id != owner)
        if owner == LOCAL:
            return []
        with self._database.read() as db:
            return db.execute(query).scalars().all()

    def open_session(self, who: Who) -> tuple[str, float]:
        """A cookie for a browser whose user showed a token, and for how long [s] it is good: a session ends
        with its token."""
        cookie, now = secrets.token_urlsafe(32), time.time()
        good_s = min(SESSION_S, SESSION_S if who.expires is None else max(who.expires - now, 0.0))
        row = {"hash": _hash(cookie), "token": who.token, "expires": now + good_s}
        with self._database.write() as db:
            db.execute(insert(SESSIONS).values(row))
        return cookie, good_s

    def session(self, cookie: str) -> Who:
        """Whose cookie it is; raises :class:`RefusedError`, 401."""
        query = (
            select(TOKENS, SESSIONS.c.expires.label("over"))
            .join(SESSIONS, TOKENS.c.id == SESSIONS.c.token)
            .where(SESSIONS.c.hash == _hash(cookie), self._good())
        )
        with self._database.read() as db:
            row = db.execute(query).mappings().first()
        if row is None or row["over"] < time.time():
            raise unauthorised("the session is over; show the token again")
        return _who(row)

    def close_session(self, cookie: str) -> None:
        """End a session."""
        with self._database.write() as db:
            db.execute(delete(SESSIONS).where(SESSIONS.c.hash == _hash(cookie)))

    def _good(self) -> ColumnElement[bool]:
        """Of a token that may be used now, by the clock that all hosts share."""
        lasting = or_(TOKENS.c.expires.is_(None), TOKENS.c.expires > self._database.clock())
        return and_(TOKENS.c.revoked.is_(None), lasting)


def _who(row: RowMapping) -> Who:
    return Who(*(row[name] for name in ("id", "name", "role", "team", "expires", "scope", "tag")))


def shared_secret(database: Database, name: str) -> str:
    """The secret of that name, 256 random bits in hex, made by the host that asks first."""
    query = select(SECRETS.c.value).where(SECRETS.c.name == name)
    with database.write() as db:
        database.one_at_a_time(db, f"secret {name}")
        known = db.execute(query).scalar()
        if known is None:
            known = secrets.token_hex(32)
            db.execute(insert(SECRETS).values(name=name, value=known))
        return str(known)


def unauthorised(why: str) -> RefusedError:
    """401."""
    return RefusedError(
        401, Issue("service.token", why, field="Authorization"), {"WWW-Authenticate": "Bearer"}
    )


def _account(key: str) -> str:
    """The identifier of the token that an account of a provider is."""
    return hashlib.sha256(key.encode()).hexdigest()[:16]


def _hash(secret: str) -> str:
    """SHA-256 is enough for a secret of 256 random bits: there is nothing to guess."""
    return hashlib.sha256(secret.encode("utf-8", "surrogatepass")).hexdigest()


def _bad_name(name: str, what: str, field: str = "name") -> Issue:
    kind = "team" if field == "team" else "token"
    return Issue("service.token", f"{kind} {name[:80]!r}: {what}", field=field)


SAFE_METHODS: Final = frozenset({"GET", "HEAD", "OPTIONS"})
"""HTTP methods that change nothing, which other sites may send."""
LOOPBACK: Final = frozenset({"localhost", "127.0.0.1", "::1"})
"""Hosts that are this machine."""
FORWARDING_HEADERS: Final = ("forwarded", "x-forwarded-for", "x-forwarded-host", "x-real-ip")
"""Headers that only a proxy adds."""
MB: Final = 1_000_000
"""Bytes of a megabyte."""
HEADERS: Final = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "SAMEORIGIN",
    "Referrer-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Tandem-Version": __version__,
}
"""Headers of every answer: nothing is guessed, framed or told to other sites; a page that was left open sees
by the version that the service was updated."""


PROBES: Final = frozenset({"/v1/health", "/v1/ready"})
"""Addresses that tell how the process does."""
HTTPS_ALONE: Final = "max-age=31536000"
"""What browsers that came by TLS are told (RFC 6797): for a year they come by it alone."""


DRAIN_S: Final = 20.0
"""Time [s] for which the rest of a request that was refused is read."""


IDLE_S: Final = 60.0
"""Time [s] in which something of a request's body has to come."""
LEAST_BYTES_S: Final = 1000.0
"""A body that comes in slower [bytes/s], `IDLE_S` beside, is given up."""


class _Body:
    """A request's body as it is received. One that comes by the byte is given up as if its client had gone:
    it would keep its connection for ever.

    A connection that is closed on a client that still sends is reset, and the client never sees why it was
    refused. So the answer goes out first, and the rest is read and dropped (RFC 9112, section 9.6)."""

    def __init__(self, receive: Receive) -> None:
        self._receive = receive
        self._got, self._since = 0, math.inf
        self.ended = False

    async def __call__(self) -> Message:
        if self.ended:  # what comes is that the client goes
            return await self._receive()
        now = time.monotonic()
        self._since = min(self._since, now)
        rest_s = self._since + IDLE_S + self._got / LEAST_BYTES_S - now
        message: Message = {"type": "http.disconnect"}
        with anyio.move_on_after(min(max(rest_s, 0.0), IDLE_S)):
            message = await self._receive()
        self.ended = not message.get("more_body", False)
        self._got += len(message.get("body", b""))
        return message

    async def drain(self) -> None:
        """Read on until the client has sent all, or went away, or it takes too long."""
        with anyio.move_on_after(DRAIN_S):
            while not self.ended:
                await self()


class Guard:
    """Wraps the application. ``open_hosts``: the names by which an instance without tokens may be addressed;
    None where tokens are required. ``closed`` gives the refusal of all but `PROBES`, while there is one."""

    def __init__(
        self,
        app: ASGIApp,
        upload_mb: float,
        open_hosts: frozenset[str] | None,
        closed: Callable[[], RefusedError | None] = lambda: None,
    ) -> None:
        self._app, self._limit_mb, self._open_hosts, self._closed = app, upload_mb, open_hosts, closed

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        body = _Body(receive)
        refused = False

        async def hardened(message: Message) -> None:
            nonlocal refused
            if message["type"] == "http.response.start":
                refused = message["status"] >= 400
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
                if scope["scheme"] == "https":
                    headers.setdefault("Strict-Transport-Security", HTTPS_ALONE)
            elif refused and not message.get("more_body") and not body.ended:
                await send({**message, "more_body": True})
                await body.drain()
                message = {"type": "http.response.body", "body": b""}
            await send(message)

        try:
            headers = Headers(scope=scope)
            self._check_origin(scope, headers)
            if scope["path"] not in PROBES and (refusal := self._closed()) is not None:
                raise refusal
            await self._app(scope, self._counted(headers, body), hardened)
        except RefusedError as error:
            await _answer(error, hardened)

    def _check_origin(self, scope: Scope, headers: Headers) -> None:
        host = headers.get("host", "")
        if self._open_hosts is not None:
            if _host_name(host) not in self._open_hosts:
                raise _foreign(f"the host is {host[:80]!r}; without tokens only this machine may ask")
            if any(name in headers for name in FORWARDING_HEADERS):
                raise _foreign("a proxy passed this on; start the service with --require-token behind one")
        if scope["method"] not in SAFE_METHODS:
            origin = headers.get("origin")
            if headers.get("sec-fetch-site", "same-origin") not in ("same-origin", "none") or (
                origin is not None and not _is_own(origin, host, scope["scheme"])
            ):
                raise _foreign("another site sent this request through a browser; use the service's own page")

    def _counted(self, headers: Headers, receive: Receive) -> Receive:
        """The body, refused when it is longer than may be: at once if it says so, else as soon as it is."""
        allowed = int(self._limit_mb * MB)
        said = headers.get("content-length", "0")
        if said.isdecimal() and int(said[:20]) > allowed:
            raise too_large("the upload", self._limit_mb)
        got = 0

        async def counted() -> MutableMapping[str, Any]:
            nonlocal got
            message = await receive()
            got += len(message.get("body", b""))
            if got > allowed:
                raise too_large("the upload", self._limit_mb)
            return message

        return counted


def in_clear(parts: SplitResult) -> bool:
    """Whether an address is one without TLS, but of this machine."""
    return parts.scheme != "https" and not (parts.scheme == "http" and parts.hostname in LOOPBACK)


def _is_own(origin: str, host: str, scheme: str) -> bool:
    """Whether a page of this service sends: one that came in clear is none of a service that is asked by TLS,
    for anybody between may have made it. A proxy may have taken TLS away."""
    try:
        parts = urlsplit(origin)
    except ValueError:
        return False
    return parts.netloc.lower() == host.lower() and (parts.scheme, scheme) != ("http", "https")


def _host_name(host: str) -> str:
    """The host without its port."""
    if host.startswith("["):
        return host[1:].split("]")[0].lower()
    return host.rsplit(":", 1)[0].lower() if host.count(":") == 1 else host.lower()


def _foreign(why: str) -> RefusedError:
    return RefusedError(403, Issue("service.foreign", why))


async def _answer(refused: RefusedError, send: Send) -> None:
    """Send a refusal that no handler of the application saw."""
    body = json.dumps(refused.body).encode()
    headers = [(b"content-type", PROBLEM_JSON.encode()), (b"content-length", str(len(body)).encode())]
    headers += [(name.lower().encode(), value.encode()) for name, value in refused.headers.items()]
    headers.append((b"connection", b"close"))
    await send({"type": "http.response.start", "status": refused.status, "headers": headers})
    await send({"type": "http.response.body", "body": body})
