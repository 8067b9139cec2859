"""Logging in by an OpenID Connect provider: people use the accounts that they have.

The code flow with PKCE (OpenID Connect Core 1.0, section 3.1; RFC 7636), by Authlib. An account of the
provider becomes a token of the store that no secret opens: jobs, roles, scopes, teams and the audit log are
as of any other. They and its name are those that the provider tells at each log-in. In another team it is
another token: what it did stays with the team that it was in.
"""

import base64
import contextlib
import dataclasses
import hashlib
import hmac
import json
import math
import re
import secrets
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final
from urllib.parse import parse_qs, urlsplit

import httpx
from authlib.common.errors import AuthlibBaseError
from authlib.integrations.httpx_client import OAuth2Client
from joserfc import jwt
from joserfc.errors import ExpiredTokenError, InvalidKeyIdError, InvalidTokenError, JoseError
from joserfc.jwk import KeySet

from planner.issues import Issue, TandemError, refusal
from planner.service.models import TOKEN_ROLES, Database, TokenRole, TokenScope
from planner.service.scopes import ROLE_OF, scope_fault
from planner.service.security import TOKEN_NAME, Auth, RefusedError, Who, in_clear, shared_secret

ALGORITHMS: Final = ("RS256", "PS256", "ES256")
"""How ID tokens may be signed: with keys of the provider alone."""
ASKED_S: Final = 600.0
"""Time [s] in which somebody logs in at the provider."""
SESSION_S: Final = 12 * 3600.0
"""Time [s] after which it is asked again who somebody is."""
KNOWN_S: Final = 3600.0
"""So long [s] what the provider tells of itself is believed."""
ANSWER_S: Final = 15.0
"""Time [s] in which the provider has to answer."""
FAILED_S: Final = 10.0
"""So long [s] a provider that did not answer is not asked again."""
AT_ONCE: Final = 3
"""Log-ins that ask the provider at once: one that hangs takes no more of the service's threads."""
LEEWAY_S: Final = 60
"""What clocks of provider and service may differ by [s]."""
LONGEST_TOKEN: Final = 120_000
"""Characters of an ID token at most."""
ANY: Final = "*"
"""Stands for every account of the provider that has none of the other values."""
TIMES: Final = ("iat", "nbf", "exp")
"""Claims that are times."""
NAMES: Final = ("email", "preferred_username", "sub")
"""Claims by which an account may be called, the first one that is there; of addresses those that the provider
has verified: others may be anybody's."""


@dataclasses.dataclass(frozen=True)
class Grant:
    """What an account may: its ``role``, or less by a ``scope`` and its ``tag``, in its ``team``; ``own``:
    that is the team of this grant alone, and not that of all accounts."""

    role: TokenRole
    team: str | None = None
    scope: TokenScope | None = None
    tag: str | None = None
    own: bool = False


MOST_FIRST: Final = ("release", "plan", "submit", "view", "released")
"""Roles and scopes, the one that may most first."""


@dataclasses.dataclass(frozen=True)
class Oidc:
    """How people log in. ``issuer``: the provider's address; ``client`` and its ``secret``, as registered
    there. Whose ``claim`` has one of the values of ``grants``, else :data:`ANY`, may that, of several the one
    that may most, of equal ones the first; others are refused."""

    issuer: str
    client: str
    secret: str
    grants: Sequence[tuple[str, Grant]]
    claim: str = "groups"
    scope: str = "openid profile email"


def read(
    issuer: str,
    client: str | None,
    secret: Path | None,
    roles: Sequence[str],
    claim: str,
    team: str | None,
    scope: str,
) -> Oidc:
    """As the command line has it: ``roles`` as ``VALUE=ROLE``, the ``secret`` in a file. Raises
    ``TandemError``."""
    if in_clear(urlsplit(issuer)):
        raise _wrong("oidc-issuer", f"got {issuer[:80]!r}; give the provider's address, https://...")
    if not client or secret is None:
        raise _wrong("oidc-client", "a provider asks who asks; give --oidc-client and --oidc-secret")
    try:
        word = secret.read_text().strip()
    except (OSError, UnicodeDecodeError) as error:
        raise _wrong(
            "oidc-secret", f"{secret} cannot be read ({error}); give a file with the secret"
        ) from error
    if team is not None and not TOKEN_NAME.fullmatch(team):
        raise _wrong("oidc-team", f"got {team[:80]!r}; use letters, digits and _ . @ -, at most 64")
    found = [_grant(one, team) for one in roles]
    if not found:
        raise _wrong(
            "oidc-role", f"nobody could do anything; give --oidc-role VALUE=ROLE, {ANY}=view for all"
        )
    return Oidc(issuer, client, word, tuple(found), claim, scope)


_GRANT: Final = re.compile(r"(?P<value>.+)=(?P<may>[a-z]+)(@(?P<team>[^:]*))?(:(?P<tag>.*))?", re.DOTALL)
"""``VALUE=ROLE@TEAM``, or ``VALUE=SCOPE@TEAM:TAG``."""


def _grant(text: str, team: str | None) -> tuple[str, Grant]:
    """A value of the claim and what it may, in the ``team`` of all accounts unless it says another. Raises
    ``TandemError``."""
    found = _GRANT.fullmatch(text)
    if found is None or found["may"] not in MOST_FIRST:
        what = f"got {text[:80]!r}; give VALUE=ROLE, or VALUE=ROLE@TEAM, where ROLE is one of "
        raise _wrong("oidc-role", f"{what}{', '.join(TOKEN_ROLES)}, or a scope, {' or '.join(ROLE_OF)}")
    own, may, tag = found["team"], found["may"], found["tag"]
    if own is not None and not TOKEN_NAME.fullmatch(own):
        what = f"got {text[:80]!r}, whose team is {own[:64]!r}; use letters, digits and _ . @ -, at most 64"
        raise _wrong("oidc-role", what)
    scope: TokenScope | None = "submit" if may == "submit" else "released" if may == "released" else None
    role = ROLE_OF[scope] if scope else next(one for one in TOKEN_ROLES if one == may)
    given = Grant(role, team if own is None else own, scope, tag, own is not None)
    if fault := scope_fault(role, given.team, scope, tag):
        raise _wrong("oidc-role", f"got {text[:80]!r}; {fault.message}")
    return found["value"], given


def _wrong(field: str, what: str) -> TandemError:
    return refusal("service.start", f"--{field}: {what}", field=field)


@dataclasses.dataclass(frozen=True)
class Asked:
    """What a browser brings back from the provider: that it is the one that went, where it was to go."""

    state: str
    nonce: str
    verifier: str
    next: str
    until: float


class LogIn:
    """Logs people in by one provider. Threads may share it."""

    def __init__(self, database: Database, auth: Auth, oidc: Oidc) -> None:
        self.oidc = oidc
        self._auth = auth
        self._secret = bytes.fromhex(shared_secret(database, "oidc"))
        self._lock = threading.Lock()
        self._room = threading.BoundedSemaphore(AT_ONCE)
        self._about: tuple[float, dict[str, Any], KeySet] | None = None
        self._asked_at = -math.inf
        self._failed_until = -math.inf

    def begin(self, redirect: str, after: str) -> tuple[str, str]:
        """Where the browser goes, and the cookie that it has to bring back to ``redirect``; ``after`` is a
        path of this service. Raises :class:`RefusedError`: 502, or 503 while many log in."""
        with self._one():
            about, _ = self._provider()
        state, nonce, verifier = (secrets.token_urlsafe(32) for _ in range(3))
        asked = Asked(state, nonce, verifier, inside(after), time.time() + ASKED_S)
        with self._client(redirect) as client:
            address, _ = client.create_authorization_url(
                about["authorization_endpoint"], state=state, nonce=nonce, code_verifier=verifier
            )
        return str(address), self._sealed(asked)

    def end(self, address: str, redirect: str, cookie: str | None) -> tuple[Who, str]:
        """Who came back to the ``address``, and where to. Raises :class:`RefusedError`: 403 for who may not,
        502 where the provider does not answer as it should."""
        asked = self._opened(cookie)
        given = {name: values[-1] for name, values in parse_qs(urlsplit(address).query).items()}
        if not hmac.compare_digest(given.get("state", "").encode(), asked.state.encode()):
            raise refused("it was not begun in this browser; begin at the log-in page")
        if "error" in given or "code" not in given:
            raise refused(f"the provider said no ({given.get('error', 'no code')[:60]}); log in again")
        with self._one():
            about, keys = self._provider()
            try:
                with self._client(redirect) as client:
                    tokens = client.fetch_token(
                        about["token_endpoint"], code=given["code"], code_verifier=asked.verifier
                    )
            except AuthlibBaseError as error:
                raise refused(f"the provider said no ({str(error.error)[:60]}); log in again") from error
            except (httpx.HTTPError, ValueError) as error:
                raise _away(error) from error
            token = str(tokens.get("id_token", ""))
            try:
                claims = self._claims(token, about, keys, asked.nonce)
            except InvalidKeyIdError:  # it may have changed its keys
                claims = self._claims(token, *self._provider(anew=True), asked.nonce)
        known = self._accounts(f"{about['issuer']} {claims['sub']}")
        try:
            grant = self.grant(claims)
        except RefusedError:
            self._auth.close_accounts(list(known.values()))
            raise
        who = self._auth.account(
            known[grant.team if grant.own else None],
            called(claims),
            grant.role,
            grant.team,
            grant.scope,
            grant.tag,
            list(known.values()),
        )
        return dataclasses.replace(who, expires=time.time() + SESSION_S), asked.next

    def _accounts(self, account: str) -> dict[str | None, str]:
        """The keys of an account in each team that a grant says, and in that of all, None."""
        teams = {grant.team for _, grant in self.oidc.grants if grant.own}
        return {None: account, **{team: f"{account} team {team}" for team in sorted(filter(None, teams))}}

    @contextlib.contextmanager
    def _one(self) -> Iterator[None]:
        """Of the few who ask the provider at once; raises :class:`RefusedError`, 503, where it is full."""
        if not self._room.acquire(blocking=False):
            issue = Issue("service.log_in", "log-in: many log in just now; try again in a moment")
            raise RefusedError(503, issue, {"Retry-After": "5"})
        try:
            yield
        finally:
            self._room.release()

    def grant(self, claims: Mapping[str, Any]) -> Grant:
        """What claims give, of several grants the one that may most; an address counts if the provider has
        verified it. Raises :class:`RefusedError`, 403."""
        trusted = self.oidc.claim != "email" or claims.get("email_verified") is True
        given = claims.get(self.oidc.claim) if trusted else None
        listed = [given] if isinstance(given, str) else given if isinstance(given, list) else []
        values = set(map(str, listed))
        found = [grant for value, grant in self.oidc.grants if value != ANY and value in values]
        found = found or [grant for value, grant in self.oidc.grants if value == ANY]
        if not found:
            what = f"the account {called(claims)} has no role here; ask who runs the service"
            raise RefusedError(403, Issue("service.role", what, field=self.oidc.claim))
        return min(found, key=lambda grant: MOST_FIRST.index(grant.scope or grant.role))

    def _claims(self, token: str, about: Mapping[str, Any], keys: KeySet, nonce: str) -> dict[str, Any]:
        """Those of an ID token that the provider has signed for this log-in (Core 1.0, section 3.1.3.7).
        Raises :class:`RefusedError`, 403, and ``InvalidKeyIdError`` for a key that is not known."""
        if len(token) > LONGEST_TOKEN:
            what = f"the provider's ID token has {len(token):,} characters, allowed are {LONGEST_TOKEN:,}; "
            what += f"most of it what {self.oidc.claim!r} lists; let the provider send for this service "
            raise refused(f"{what}those groups alone that have a role here, by a filter of that claim")
        try:
            found = dict(jwt.decode(token, keys, algorithms=list(ALGORITHMS)).claims)
            jwt.JWTClaimsRegistry(
                leeway=LEEWAY_S,
                iss={"essential": True, "value": about["issuer"]},
                aud={"essential": True, "value": self.oidc.client},
                sub={"essential": True},
                exp={"essential": True},
                iat={"essential": True},
                nonce={"essential": True, "value": nonce},
            ).validate(found)
        except InvalidKeyIdError:
            raise
        except (ExpiredTokenError, InvalidTokenError) as error:  # by a clock that is wrong, as a rule
            stamps = ", ".join(f"{name} {found[name]!s:.40}" for name in TIMES if name in found)
            what = f"the provider's ID token is not of now ({stamps} s since 1970; this machine's clock says "
            raise refused(f"{what}{time.time():.0f}): set both clocks, and log in again") from error
        except (JoseError, ValueError, TypeError, KeyError) as error:
            raise refused(
                f"the provider's ID token is not good ({type(error).__name__}); log in again"
            ) from error
        if not str(found["sub"]).isprintable():
            raise refused("the provider's ID token names an account by what is no text; ask who runs it")
        if isinstance(found["aud"], list) and len(found["aud"]) > 1 and found.get("azp") != self.oidc.client:
            raise refused("the provider's ID token is for another service; log in again")
        return found

    def _provider(self, anew: bool = False) -> tuple[dict[str, Any], KeySet]:
        """What the provider tells of itself, and its keys (OpenID Connect Discovery 1.0); ``anew``: not what
        is known, unless it was asked a moment ago."""
        with self._lock:
            now = time.monotonic()
            old = anew and now - self._asked_at > FAILED_S
            if self._about is not None and self._about[0] > now and not old:
                return self._about[1:]
            if now < self._failed_until:
                raise _away(TimeoutError())
            self._asked_at = now
            try:
                with httpx.Client(timeout=ANSWER_S) as client:
                    issuer = self.oidc.issuer.rstrip("/")
                    answer = client.get(f"{issuer}/.well-known/openid-configuration")
                    about = answer.raise_for_status().json()
                    if about["issuer"].rstrip("/") != issuer:
                        raise ValueError("it calls itself otherwise")
                    for name in ("authorization_endpoint", "token_endpoint", "jwks_uri"):
                        _checked(about[name])
                    keys = KeySet.import_key_set(client.get(about["jwks_uri"]).raise_for_status().json())
            except (httpx.HTTPError, JoseError, ValueError, KeyError, TypeError, AttributeError) as error:
                self._failed_until = time.monotonic() + FAILED_S
                raise _away(error) from error
            self._about = (time.monotonic() + KNOWN_S, about, keys)
            return about, keys

    def _client(self, redirect: str) -> OAuth2Client:
        return OAuth2Client(
            self.oidc.client,
            self.oidc.secret,
            scope=self.oidc.scope,
            redirect_uri=redirect,
            code_challenge_method="S256",
            timeout=ANSWER_S,
        )

    def _sealed(self, asked: Asked) -> str:
        body = base64.urlsafe_b64encode(json.dumps(dataclasses.asdict(asked)).encode()).decode()
        return f"{body}.{self._seal(body)}"

    def _seal(self, body: str) -> str:
        return hmac.new(self._secret, f"tandem log-in {body}".encode(), hashlib.sha256).hexdigest()

    def _opened(self, cookie: str | None) -> Asked:
        body, _, seal = (cookie or "").partition(".")
        if not hmac.compare_digest(seal.encode(), self._seal(body).encode()):
            raise refused("it was not begun in this browser; begin at the log-in page")
        asked = Asked(**json.loads(base64.urlsafe_b64decode(body)))
        if asked.until < time.time():
            raise refused(f"it took more than {ASKED_S / 60.0:g} minutes; log in again")
        return asked


def inside(path: str) -> str:
    """The path, if it leads to a page of this service, else the first page."""
    return path if re.match(r"/(?![/\\])[\x21-\x7e]*$", path) else "/"


def called(claims: Mapping[str, Any]) -> str:
    """What an account is called."""
    known = {name: _plain(claims[name]) for name in NAMES if claims.get(name)}
    if claims.get("email_verified") is not True:
        known.pop("email", None)
    if "@" in known.get("preferred_username", ""):  # an address that nobody has verified
        known.pop("preferred_username")
    return next(iter(known.values()))


def _plain(name: Any) -> str:
    """A name that a message can hold: no halves of letters, and none that turn the text behind them."""
    return "".join(letter if letter.isprintable() else "?" for letter in str(name)[:200])


def refused(why: str) -> RefusedError:
    """403."""
    return RefusedError(403, Issue("service.log_in", f"log-in: {why}"))


def _checked(address: str) -> None:
    """Raises ``ValueError`` for what is told in clear over a network."""
    if in_clear(urlsplit(address)):
        raise ValueError("it gives an address without TLS")


def _away(error: Exception) -> RefusedError:
    what = f"log-in: the provider does not answer as it should ({type(error).__name__}); try it later"
    return RefusedError(502, Issue("service.log_in", what))
