"""Authentication, limits, and the checks before every request.

Only the hash of a token is stored. Browsers that sent a token get a cookie. A token has a role, and may
have a team whose jobs it sees, a narrower scope, and an expiry time. Before every request the service
checks the size of its body and its origin, and sets headers that restrict what browsers do with the answer.
Refusals are an HTTP status with issues that give the reason.
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

from planner.issues import Issue, TandemError, issue_error
from planner.runtime.version import __version__
from planner.service.models import SECRETS, SESSIONS, TOKEN_ROLES, TOKENS, Database, TokenRole, TokenScope
from planner.service.scopes import ROLE_OF, is_permitted, scope_issue


@dataclasses.dataclass(frozen=True)
class ServiceLimits:
    """Upper limits of the service. None means no limit, unless stated otherwise.

    Attributes:
        upload_mb: Size of one request [MB].
        mesh_mb: Size of one mesh file [MB]. 50 MB of STL are a million facets.
        mesh_facets: Facets of one mesh. Three times as many vertices are allowed.
        files: Files of one upload.
        open_jobs: Queued and running jobs of one token.
        kept_jobs: All jobs of one token.
        token_disk_mb: Size of a token's files [MB]; equal content counts once.
        disk_mb: Size of all files [MB]; equal content counts once. None: what the disk holds.
        readings: Queued and running readings of uploads of one token.
        job_s: Planning time of one job [s].
        job_memory_mb: Planning memory of one job [MB].
        check_s: Time for reading or checking a problem [s].
        check_memory_mb: Memory for reading or checking a problem [MB].
        streams: Concurrent event streams of one token.
        requests_per_s: Request rate of one token [1/s].
        drafts: Drafts, cells, tools and templates of one token.
        keep_days: Days until an ended job is deleted. None: never.
        audit_days: Days until an audit entry is deleted. None: never.
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
    """A refused request.

    Args:
        status: HTTP status.
        issues: Issues with code and field.
        headers: Headers of the answer.
        of: For each issue, the index of the problem that it concerns, if several were sent.
    """

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
        """The answer as a problem document (RFC 9457) with issues."""
        phrases = {http_status.value: http_status.phrase for http_status in HTTPStatus}
        return {
            "type": "about:blank",
            "title": phrases.get(self.status, "Refused"),
            "status": self.status,
            "detail": str(self),
            "issues": [issue_json(issue) for issue in self.issues],
            **({"of": list(self.of)} if self.of else {}),
        }


def issue_json(issue: Issue) -> dict[str, Any]:
    """Convert an issue to JSON. Numbers that are not finite are omitted."""
    data = issue.to_dict()
    return {
        name: value for name, value in data.items() if not isinstance(value, float) or math.isfinite(value)
    }


def unknown_job(job: str) -> RefusedError:
    """Return the refusal for an unknown job: 404."""
    return RefusedError(404, Issue("service.unknown_job", f"job {job[:40]!r}: not found. List the jobs."))


def too_many(what: str, again_s: int, limit: float | None = None, unit: str | None = None) -> RefusedError:
    """Return a refusal that may be retried: 429.

    Args:
        what: Message.
        again_s: Time [s] to wait.
        limit: Exceeded limit.
        unit: Unit of the limit.
    """
    issue = Issue("service.too_many", what, limit=limit, unit=unit)
    return RefusedError(429, issue, {"Retry-After": str(again_s)})


def too_large(what: str, limit_mb: float, field: str | None = None) -> RefusedError:
    """Return the refusal of too much data: 413.

    Args:
        what: Subject of the message.
        limit_mb: Limit [MB].
        field: Field of the request.
    """
    message = f"{what} is too large (allowed {limit_mb:g} MB). Send less data, or meshes with fewer facets."
    return RefusedError(413, Issue("service.too_large", message, field=field, limit=limit_mb, unit="MB"))


LOCAL: Final = "local"
"""Owner of jobs that were submitted without a token, over loopback."""
SESSION_S: Final = 30 * 86400.0
"""Maximum duration [s] of a browser session."""
TOKENS_PER_QUERY: Final = 500
"""Maximum number of tokens in one database query."""
_TOKEN: Final = re.compile(r"tandem_([0-9a-f]{16})_[A-Za-z0-9_-]{43}")
"""A token: the identifier in the database, and the secret."""
TOKEN_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.@-]{0,63}")
"""Name of a token or a team."""
_LIFETIME: Final = re.compile(r"([1-9][0-9]{0,3})([hdw])")
"""Lifetime of a token."""
_UNITS_S: Final = {"h": 3600.0, "d": 86400.0, "w": 604800.0}
"""Duration [s] of the units of a lifetime: hour, day and week."""


@dataclasses.dataclass(frozen=True)
class TokenInfo:
    """A token without its secret. Times are in seconds since 1970."""

    name: str
    created: float
    revoked: float | None
    role: TokenRole
    team: str | None
    expires: float | None
    scope: TokenScope | None
    tag: str | None


@dataclasses.dataclass(frozen=True)
class TokenPermissions:
    """What a token may do.

    Attributes:
        role: Role.
        team: Team, or None.
        scope: Scope, or None.
        tag: Tag of the jobs in the scope, or None.
    """

    role: TokenRole
    team: str | None = None
    scope: TokenScope | None = None
    tag: str | None = None


@dataclasses.dataclass(frozen=True)
class Principal:
    """Authenticated caller.

    Attributes:
        token: Identifier of the token, which owns what is created with it.
        name: Name.
        role: Role.
        team: Team, or None.
        expires: Expiry time [s since 1970], or None.
        scope: Scope, or None.
        tag: Tag of the jobs in the scope, or None.
    """

    token: str
    name: str
    role: TokenRole
    team: str | None = None
    expires: float | None = None
    scope: TokenScope | None = None
    tag: str | None = None

    def check_scope(self, method: str, path: str) -> None:
        """Check that the scope of the token permits a request.

        Args:
            method: HTTP method.
            path: Address as the route states it.

        Raises:
            RefusedError: 403.
        """
        if self.scope is not None and not is_permitted(self.scope, method, path):
            message = f"token {self.name}: its scope {self.scope} does not permit this request"
            remedy = "Ask the operator of the service for a token without a scope: tandem token add NAME."
            raise RefusedError(403, Issue("service.role", message, field="Authorization", hint=remedy))

    def check_role(self, role: TokenRole) -> None:
        """Check that the role of the token includes another role.

        Args:
            role: Required role.

        Raises:
            RefusedError: 403.
        """
        if TOKEN_ROLES.index(self.role) < TOKEN_ROLES.index(role):
            message = f"token {self.name}: role not sufficient (got {self.role}, required {role})"
            remedy = f"Ask the operator of the service for a token: tandem token add NAME --role {role}."
            raise RefusedError(403, Issue("service.role", message, field="Authorization", hint=remedy))


LOCAL_PRINCIPAL: Final = Principal(LOCAL, LOCAL, "release")
"""Caller when no tokens are required."""


def parse_lifetime(text: str) -> float:
    """Parse the lifetime of a token [s].

    Args:
        text: Lifetime, such as ``12h``, ``90d`` or ``4w``.

    Raises:
        TandemError: The text is invalid.
    """
    match = _LIFETIME.fullmatch(text)
    if match is None:
        message = f"expires: invalid (got {text[:40]!r}, allowed 1 to 9999 with h, d or w, such as 90d)"
        raise issue_error("service.token", message, field="expires")
    return float(match[1]) * _UNITS_S[match[2]]


class Auth:
    """The tokens and sessions of one database."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def create_token(
        self,
        name: str,
        role: TokenRole | None = None,
        team: str | None = None,
        lifetime_s: float | None = None,
        scope: TokenScope | None = None,
        tag: str | None = None,
    ) -> str:
        """Create a token. Its text is returned only once.

        Args:
            name: Name of the token.
            role: Role. By default plan, or the role of the scope.
            team: Team, or None.
            lifetime_s: Lifetime [s], or None for ever.
            scope: Scope, or None.
            tag: Tag of the scope, or None.

        Raises:
            TandemError: The name is taken or invalid, or the scope does not fit the rest.
        """
        role = role or (ROLE_OF[scope] if scope else "plan")
        if issue := scope_issue(role, team, scope, tag):
            raise TandemError(issue)
        for value, field in ((name, "name"), (team, "team")):
            if value is not None and not TOKEN_NAME.fullmatch(value):
                raise TandemError(_bad_name(value, "allowed are 64 letters, digits and _ . @ -", field))
        token_id = secrets.token_hex(8)
        token = f"tandem_{token_id}_{secrets.token_urlsafe(32)}"
        now = self._database.clock()
        row: dict[str, Any] = {"id": token_id, "name": name, "hash": _hash(token), "role": role, "team": team}
        row |= {"created": now, "expires": None if lifetime_s is None else now + lifetime_s}
        row |= {"scope": scope, "tag": tag}
        try:
            with self._database.write() as db:
                db.execute(insert(TOKENS).values(row))
        except IntegrityError as error:
            raise TandemError(_bad_name(name, "already exists. Choose another name.")) from error
        return token

    def update_account(
        self, key: str, name: str, permissions: TokenPermissions, all_keys: Sequence[str] = ()
    ) -> Principal:
        """Create or update the token of a provider's account. No secret opens it.

        If another token has the name, the account gets the name with a suffix.

        Args:
            key: Key of the account.
            name: Name of the account.
            permissions: What the account may do.
            all_keys: Keys of the same account in all teams. Sessions of the other keys end.

        Raises:
            RefusedError: 403, the token of one of the keys was revoked.
        """
        token_id = _account_id(key)
        account_ids = {_account_id(account_key) for account_key in (key, *all_keys)}
        unique_name = re.sub(r"[^A-Za-z0-9_.@-]", "_", name).lstrip("_.@-")[:64] or token_id
        with self._database.write() as db:
            self._database.lock(db, "accounts")
            rows = db.execute(select(TOKENS).where(TOKENS.c.id.in_(account_ids))).mappings().all()
            for row in rows:
                if row["revoked"] is not None:
                    raise RefusedError(403, Issue("service.log_in", f"account {row['name']}: was revoked"))
            taken = select(TOKENS.c.id).where(TOKENS.c.name == unique_name, TOKENS.c.id != token_id)
            if db.execute(taken).first() is not None:
                unique_name = f"{unique_name[:55]}-{token_id[:8]}"
            values = {
                "name": unique_name,
                "role": permissions.role,
                "team": permissions.team,
                "scope": permissions.scope,
                "tag": permissions.tag,
            }
            if token_id not in {row["id"] for row in rows}:
                new_values = {
                    "id": token_id,
                    "hash": f"account {token_id}",
                    "created": self._database.clock(),
                }
                db.execute(insert(TOKENS).values(new_values | values))
            else:
                db.execute(update(TOKENS).where(TOKENS.c.id == token_id).values(values))
            if others := account_ids - {token_id}:
                db.execute(delete(SESSIONS).where(SESSIONS.c.token.in_(others)))
        return Principal(
            token_id,
            unique_name,
            permissions.role,
            permissions.team,
            scope=permissions.scope,
            tag=permissions.tag,
        )

    def close_accounts(self, keys: Sequence[str]) -> None:
        """End the sessions of some accounts of a provider."""
        with self._database.write() as db:
            db.execute(delete(SESSIONS).where(SESSIONS.c.token.in_([_account_id(key) for key in keys])))

    def list(self) -> tuple[TokenInfo, ...]:
        """Return all tokens, oldest first."""
        with self._database.read() as db:
            rows = db.execute(select(TOKENS).order_by(TOKENS.c.created)).mappings()
            fields = [field.name for field in dataclasses.fields(TokenInfo)]
            return tuple(TokenInfo(**{name: row[name] for name in fields}) for row in rows)

    def revoke(self, name: str) -> None:
        """Revoke a token and end its sessions at once. Its jobs remain.

        Args:
            name: Name of the token.

        Raises:
            TandemError: No such token.
        """
        with self._database.write() as db:
            token_id = db.execute(select(TOKENS.c.id).where(TOKENS.c.name == name)).scalar()
            if token_id is None:
                raise TandemError(_bad_name(name, "not found. List the tokens."))
            db.execute(update(TOKENS).where(TOKENS.c.id == token_id).values(revoked=time.time()))
            db.execute(delete(SESSIONS).where(SESSIONS.c.token == token_id))

    def has_valid_token(self) -> bool:
        """Report whether any token is valid."""
        with self._database.read() as db:
            query = select(func.count()).select_from(TOKENS).where(self._is_valid_filter())
            return bool(db.execute(query).scalar_one())

    def authenticate_token(self, token: str) -> Principal:
        """Authenticate a token.

        Args:
            token: Text of the token.

        Raises:
            RefusedError: 401.
        """
        match = _TOKEN.fullmatch(token)
        row = None
        if match:
            query = select(TOKENS, self._is_valid_filter().label("good")).where(TOKENS.c.id == match[1])
            with self._database.read() as db:
                row = db.execute(query).mappings().first()
        stored_hash = "" if row is None else row["hash"]
        if not hmac.compare_digest(stored_hash, _hash(token)) or row is None or row["revoked"] is not None:
            raise unauthorised("the token is unknown or revoked. Ask for a new one.")
        if not row["good"]:
            raise unauthorised("the token has expired. Ask for a new one.")
        return _principal_of_row(row)

    def is_valid(self, owner: str) -> bool:
        """Report whether a token exists, is not revoked and has not expired."""
        query = select(TOKENS.c.id).where(TOKENS.c.id == owner, self._is_valid_filter())
        with self._database.read() as db:
            return db.execute(query).first() is not None

    def teams(self, tokens: Sequence[str]) -> dict[str, str | None]:
        """Return the team of each token that is valid. Invalid tokens are missing."""
        teams: dict[str, str | None] = {}
        with self._database.read() as db:
            for start in range(0, len(tokens), TOKENS_PER_QUERY):
                batch = TOKENS.c.id.in_(tokens[start : start + TOKENS_PER_QUERY])
                rows = db.execute(select(TOKENS.c.id, TOKENS.c.team).where(batch, self._is_valid_filter()))
                teams |= dict(row.tuple() for row in rows)
        return teams

    def owners(self, principal: Principal) -> Sequence[str]:
        """Return the tokens whose jobs a caller sees.

        These are its own, and those of its team, including expired and revoked ones. A token with the scope
        submit sees its own jobs only.
        """
        return (
            [principal.token]
            if principal.scope == "submit"
            else [principal.token, *self.team_tokens(principal.token)]
        )

    def sees(self, principal: Principal, owner: str | None) -> bool:
        """Report whether a caller sees the jobs of an owner."""
        return owner is not None and owner in self.owners(principal)

    def team_tokens(self, owner: str) -> Sequence[str]:
        """Return the other tokens of a token's team. Empty if it has no team."""
        team = select(TOKENS.c.team).where(TOKENS.c.id == owner).scalar_subquery()
        query = select(TOKENS.c.id).where(TOKENS.c.team == team, TOKENS.c.id != owner)
        if owner == LOCAL:
            return []
        with self._database.read() as db:
            return db.execute(query).scalars().all()

    def open_session(self, principal: Principal) -> tuple[str, float]:
        """Create a session of a browser. A session ends with its token at the latest.

        Args:
            principal: Authenticated caller.

        Returns:
            Cookie, and its lifetime [s].
        """
        cookie, now = secrets.token_urlsafe(32), time.time()
        lifetime_s = min(
            SESSION_S, SESSION_S if principal.expires is None else max(principal.expires - now, 0.0)
        )
        row = {"hash": _hash(cookie), "token": principal.token, "expires": now + lifetime_s}
        with self._database.write() as db:
            db.execute(insert(SESSIONS).values(row))
        return cookie, lifetime_s

    def authenticate_session(self, cookie: str) -> Principal:
        """Authenticate a session cookie.

        Args:
            cookie: Value of the cookie.

        Raises:
            RefusedError: 401.
        """
        query = (
            select(TOKENS, SESSIONS.c.expires.label("over"))
            .join(SESSIONS, TOKENS.c.id == SESSIONS.c.token)
            .where(SESSIONS.c.hash == _hash(cookie), self._is_valid_filter())
        )
        with self._database.read() as db:
            row = db.execute(query).mappings().first()
        if row is None or row["over"] < time.time():
            raise unauthorised("the session has expired. Log in again.")
        return _principal_of_row(row)

    def close_session(self, cookie: str) -> None:
        """End a session."""
        with self._database.write() as db:
            db.execute(delete(SESSIONS).where(SESSIONS.c.hash == _hash(cookie)))

    def _is_valid_filter(self) -> ColumnElement[bool]:
        """Return the condition for tokens that are valid now, by the clock that all hosts share."""
        not_expired = or_(TOKENS.c.expires.is_(None), TOKENS.c.expires > self._database.clock())
        return and_(TOKENS.c.revoked.is_(None), not_expired)


def _principal_of_row(row: RowMapping) -> Principal:
    return Principal(*(row[name] for name in ("id", "name", "role", "team", "expires", "scope", "tag")))


def shared_secret(database: Database, name: str) -> str:
    """Return a named secret of 256 random bits in hex. The first host that needs it creates it.

    Args:
        database: Database that the hosts share.
        name: Name of the secret.
    """
    query = select(SECRETS.c.value).where(SECRETS.c.name == name)
    with database.write() as db:
        database.lock(db, f"secret {name}")
        secret = db.execute(query).scalar()
        if secret is None:
            secret = secrets.token_hex(32)
            db.execute(insert(SECRETS).values(name=name, value=secret))
        return str(secret)


def unauthorised(why: str) -> RefusedError:
    """Return the refusal of a missing or invalid token: 401."""
    return RefusedError(
        401, Issue("service.token", why, field="Authorization"), {"WWW-Authenticate": "Bearer"}
    )


def _account_id(key: str) -> str:
    """Return the identifier of the token of a provider's account."""
    return hashlib.sha256(key.encode()).hexdigest()[:16]


def _hash(secret: str) -> str:
    """Return the SHA-256 of a secret.

    Stretching is not needed for 256 random bits, which cannot be guessed.
    """
    return hashlib.sha256(secret.encode("utf-8", "surrogatepass")).hexdigest()


def _bad_name(name: str, problem: str, field: str = "name") -> Issue:
    kind = "team" if field == "team" else "token"
    return Issue("service.token", f"{kind} {name[:80]!r}: {problem}", field=field)


SAFE_METHODS: Final = frozenset({"GET", "HEAD", "OPTIONS"})
"""HTTP methods that change nothing. Other sites may send them."""
LOOPBACK: Final = frozenset({"localhost", "127.0.0.1", "::1"})
"""Host names of this machine."""
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
"""Headers of every answer.

They forbid content sniffing, framing and referrers to other sites. An open page notices by the version that
the service was updated.
"""


PROBES: Final = frozenset({"/v1/health", "/v1/ready"})
"""Addresses that report the state of the process."""
STRICT_TRANSPORT_SECURITY: Final = "max-age=31536000"
"""Strict-Transport-Security header for clients that use TLS (RFC 6797): HTTPS only for a year."""


MAX_DRAIN_S: Final = 20.0
"""Maximum time [s] for reading the rest of a refused request."""


BODY_IDLE_S: Final = 60.0
"""Maximum time [s] without any data of a request body."""
MIN_BODY_RATE_BYTES_S: Final = 1000.0
"""Minimum average rate [bytes/s] of a request body, after `BODY_IDLE_S`."""


class _RequestBody:
    """Body of a request as it is received.

    A body that arrives too slowly is treated as a disconnected client, because it would occupy its connection
    for ever.

    Closing a connection while the client still sends resets it, and the client never sees the refusal.
    Therefore the answer is sent first, and the rest of the body is read and dropped (RFC 9112, section
    9.6).
    """

    def __init__(self, receive: Receive) -> None:
        self._receive = receive
        self._received_bytes, self._started_at = 0, math.inf
        self.ended = False

    async def __call__(self) -> Message:
        """Receive the next part of the body, or a disconnection if the client sends too slowly."""
        if self.ended:  # the next message is the disconnection
            return await self._receive()
        now = time.monotonic()
        self._started_at = min(self._started_at, now)
        # The client has BODY_IDLE_S from its first byte on, and more time for every byte that arrived.
        max_wait_s = self._started_at + BODY_IDLE_S + self._received_bytes / MIN_BODY_RATE_BYTES_S - now
        message: Message = {"type": "http.disconnect"}
        with anyio.move_on_after(min(max(max_wait_s, 0.0), BODY_IDLE_S)):
            message = await self._receive()
        self.ended = not message.get("more_body", False)
        self._received_bytes += len(message.get("body", b""))
        return message

    async def drain(self) -> None:
        """Read the rest of the body, until the client has sent all, disconnects, or takes too long."""
        with anyio.move_on_after(MAX_DRAIN_S):
            while not self.ended:
                await self()


class RequestGuard:
    """ASGI middleware that checks size and origin of requests and sets security headers.

    Args:
        app: Application.
        upload_mb: Maximum size of a request body [MB].
        open_hosts: Host names of an instance without tokens, or None if tokens are required.
        closed: Function that returns the refusal of everything except `PROBES`, or None.
    """

    def __init__(
        self,
        app: ASGIApp,
        upload_mb: float,
        open_hosts: frozenset[str] | None,
        closed: Callable[[], RefusedError | None] = lambda: None,
    ) -> None:
        self._app, self._limit_mb, self._open_hosts, self._closed = app, upload_mb, open_hosts, closed

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on and add security headers to its answer, or refuse the request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        body = _RequestBody(receive)
        refused = False

        async def send_with_headers(message: Message) -> None:
            nonlocal refused
            if message["type"] == "http.response.start":
                refused = message["status"] >= 400
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
                if scope["scheme"] == "https":
                    headers.setdefault("Strict-Transport-Security", STRICT_TRANSPORT_SECURITY)
            elif refused and not message.get("more_body") and not body.ended:
                # The connection stays open until the client has sent its body, so that it sees the refusal.
                await send({**message, "more_body": True})
                await body.drain()
                message = {"type": "http.response.body", "body": b""}
            await send(message)

        try:
            headers = Headers(scope=scope)
            self._check_origin(scope, headers)
            if scope["path"] not in PROBES and (refusal := self._closed()) is not None:
                raise refusal
            await self._app(scope, self._limit_body(headers, body), send_with_headers)
        except RefusedError as error:
            await _send_refusal(error, send_with_headers)

    def _check_origin(self, scope: Scope, headers: Headers) -> None:
        """Refuse requests that other sites send, and without tokens also those of other machines."""
        host = headers.get("host", "")
        if self._open_hosts is not None:
            if _host_name(host) not in self._open_hosts:
                raise _foreign_request(
                    f"host: only this machine is allowed without tokens (got {host[:80]!r})"
                )
            if any(name in headers for name in FORWARDING_HEADERS):
                raise _foreign_request(
                    "a proxy forwarded this request. Behind a proxy, start with --require-token."
                )
        if scope["method"] not in SAFE_METHODS:
            origin = headers.get("origin")
            if headers.get("sec-fetch-site", "same-origin") not in ("same-origin", "none") or (
                origin is not None and not _is_same_origin(origin, host, scope["scheme"])
            ):
                raise _foreign_request(
                    "another site sent this request through a browser. Use the service's pages."
                )

    def _limit_body(self, headers: Headers, receive: Receive) -> Receive:
        """Return a function that receives the body and refuses it as soon as it is too large.

        The returned function raises the same error if more bytes arrive than are allowed.

        Raises:
            RefusedError: 413, the declared length is too large.
        """
        allowed = int(self._limit_mb * MB)
        declared_length = headers.get("content-length", "0")
        # 20 digits suffice: int() refuses numbers of thousands of digits, which a client may send
        if declared_length.isdecimal() and int(declared_length[:20]) > allowed:
            raise too_large("the upload", self._limit_mb)
        received = 0

        async def receive_limited() -> MutableMapping[str, Any]:
            nonlocal received
            message = await receive()
            received += len(message.get("body", b""))
            if received > allowed:
                raise too_large("the upload", self._limit_mb)
            return message

        return receive_limited


def is_unencrypted(parts: SplitResult) -> bool:
    """Report whether an address sends data unencrypted over a network: not HTTPS, and not this machine."""
    return parts.scheme != "https" and not (parts.scheme == "http" and parts.hostname in LOOPBACK)


def _is_same_origin(origin: str, host: str, scheme: str) -> bool:
    """Report whether a page of this service sent the request.

    A service that uses TLS does not trust a page that was loaded without TLS, because anybody in between may
    have changed it. The opposite is allowed, because a proxy may have removed TLS.
    """
    try:
        parts = urlsplit(origin)
    except ValueError:
        return False
    return parts.netloc.lower() == host.lower() and (parts.scheme, scheme) != ("http", "https")


def _host_name(host: str) -> str:
    """Return the host name without its port."""
    if host.startswith("["):
        return host[1:].split("]")[0].lower()
    return host.rsplit(":", 1)[0].lower() if host.count(":") == 1 else host.lower()


def _foreign_request(why: str) -> RefusedError:
    return RefusedError(403, Issue("service.foreign", why))


async def _send_refusal(refused: RefusedError, send: Send) -> None:
    """Send a refusal that no handler of the application has seen."""
    body = json.dumps(refused.body).encode()
    headers = [(b"content-type", PROBLEM_JSON.encode()), (b"content-length", str(len(body)).encode())]
    headers += [(name.lower().encode(), value.encode()) for name, value in refused.headers.items()]
    headers.append((b"connection", b"close"))
    await send({"type": "http.response.start", "status": refused.status, "headers": headers})
    await send({"type": "http.response.body", "body": body})
