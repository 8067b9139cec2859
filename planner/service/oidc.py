"""Log-in through an OpenID Connect provider.

The authorization code flow with PKCE (OpenID Connect Core 1.0, section 3.1; RFC 7636), with Authlib. An
account of the provider becomes a token of the store that no secret opens. Jobs, roles, scopes, teams and
the audit log work as for any other token. Role, scope, team and name are taken from the provider at each
log-in. In another team the account is another token, so that what it did stays with the earlier team.
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

from planner.issues import Issue, TandemError, issue_error
from planner.service.models import TOKEN_ROLES, Database, TokenRole, TokenScope
from planner.service.scopes import ROLE_OF, scope_issue
from planner.service.security import (
    TOKEN_NAME,
    Auth,
    Principal,
    RefusedError,
    TokenPermissions,
    is_unencrypted,
    shared_secret,
)

ALGORITHMS: Final = ("RS256", "PS256", "ES256")
"""Signature algorithms of ID tokens: only those with keys of the provider."""
MAX_LOG_IN_S: Final = 600.0
"""Maximum time [s] of a log-in at the provider."""
SESSION_S: Final = 12 * 3600.0
"""Time [s] after which a person must log in again."""
METADATA_CACHE_S: Final = 3600.0
"""Time [s] for which the metadata of the provider are cached."""
PROVIDER_TIMEOUT_S: Final = 15.0
"""Maximum time [s] of an answer of the provider."""
RETRY_AFTER_FAILURE_S: Final = 10.0
"""Time [s] for which a provider that did not answer is not asked again."""
MAX_CONCURRENT_LOG_INS: Final = 3
"""Maximum number of log-ins that query the provider at once.

A provider that hangs takes no more of the service's threads.
"""
CLOCK_LEEWAY_S: Final = 60
"""Maximum difference [s] between the clocks of provider and service."""
MAX_ID_TOKEN_LENGTH: Final = 120_000
"""Maximum number of characters of an ID token."""
ANY_ACCOUNT: Final = "*"
"""Claim value that stands for every account of the provider that has none of the other values."""
TIME_CLAIMS: Final = ("iat", "nbf", "exp")
"""Claims that are times."""
NAME_CLAIMS: Final = ("email", "preferred_username", "sub")
"""Claims that may name an account, in order of preference.

Email addresses count only if the provider has verified them, because others may belong to anybody.
"""


@dataclasses.dataclass(frozen=True)
class Grant:
    """What an account may do.

    Attributes:
        role: Role.
        team: Team.
        scope: Scope that narrows the role.
        tag: Tag that narrows the scope.
        has_own_team: The team is that of this grant, not the team of all accounts.
    """

    role: TokenRole
    team: str | None = None
    scope: TokenScope | None = None
    tag: str | None = None
    has_own_team: bool = False


PERMISSION_ORDER: Final = ("release", "plan", "submit", "view", "released")
"""Roles and scopes, from most to least permissive."""


@dataclasses.dataclass(frozen=True)
class OidcSettings:
    """Settings of the log-in through a provider.

    An account whose claim has one of the values of ``grants`` gets that grant, else that of
    :data:`ANY_ACCOUNT`. Of several grants the most permissive applies, and of equal ones the first. Other
    accounts are refused.

    Attributes:
        issuer: Address of the provider.
        client: Client id that is registered there.
        secret: Client secret.
        grants: Values of the claim, and their grants.
        claim: Name of the claim of the ID token that decides, such as the groups of an account.
        scope: Requested OpenID scopes.
    """

    issuer: str
    client: str
    secret: str
    grants: Sequence[tuple[str, Grant]]
    claim: str = "groups"
    scope: str = "openid profile email"


@dataclasses.dataclass(frozen=True)
class GrantOptions:
    """Command-line options about what accounts may do.

    Attributes:
        roles: Grants as ``VALUE=ROLE``.
        claim: Name of the claim.
        team: Team of all accounts, or None.
    """

    roles: Sequence[str]
    claim: str
    team: str | None


def read_settings(
    issuer: str, client: str | None, secret: Path | None, grant_options: GrantOptions, scope: str
) -> OidcSettings:
    """Read the settings from command-line options.

    Args:
        issuer: Address of the provider.
        client: Client id.
        secret: File with the client secret.
        grant_options: What accounts may do.
        scope: Requested OpenID scopes.

    Raises:
        TandemError: An option is missing or invalid.
    """
    if is_unencrypted(urlsplit(issuer)):
        raise _option_error("oidc-issuer", f"invalid address (got {issuer[:80]!r}). Give https://...")
    if not client or secret is None:
        raise _option_error("oidc-client", "is missing. Give --oidc-client and --oidc-secret.")
    try:
        secret_text = secret.read_text().strip()
    except (OSError, UnicodeDecodeError) as error:
        raise _option_error(
            "oidc-secret", f"{secret} cannot be read ({error}). Give a file with the client secret."
        ) from error
    team = grant_options.team
    if team is not None and not TOKEN_NAME.fullmatch(team):
        raise _option_error(
            "oidc-team", f"invalid name (got {team[:80]!r}, allowed 64 letters, digits and _ . @ -)"
        )
    grants = [_parse_grant(role, team) for role in grant_options.roles]
    if not grants:
        raise _option_error(
            "oidc-role", f"is missing. Give --oidc-role VALUE=ROLE, or {ANY_ACCOUNT}=view for all accounts."
        )
    return OidcSettings(issuer, client, secret_text, tuple(grants), grant_options.claim, scope)


_GRANT_PATTERN: Final = re.compile(
    r"(?P<value>.+)=(?P<may>[a-z]+)(@(?P<team>[^:]*))?(:(?P<tag>.*))?", re.DOTALL
)
"""``VALUE=ROLE@TEAM``, or ``VALUE=SCOPE@TEAM:TAG``."""


def _parse_grant(text: str, team: str | None) -> tuple[str, Grant]:
    """Parse an option ``--oidc-role``.

    Args:
        text: ``VALUE=ROLE@TEAM`` or ``VALUE=SCOPE@TEAM:TAG``.
        team: Team of all accounts, which applies if the text names none.

    Returns:
        Value of the claim, and its grant.

    Raises:
        TandemError: The text is invalid.
    """
    match = _GRANT_PATTERN.fullmatch(text)
    if match is None or match["may"] not in PERMISSION_ORDER:
        problem = f"invalid (got {text[:80]!r}, allowed VALUE=ROLE or VALUE=ROLE@TEAM). ROLE is one of "
        raise _option_error(
            "oidc-role", f"{problem}{', '.join(TOKEN_ROLES)}, or a scope, {' or '.join(ROLE_OF)}."
        )
    own_team, permission, tag = match["team"], match["may"], match["tag"]
    if own_team is not None and not TOKEN_NAME.fullmatch(own_team):
        problem = (
            f"invalid team {own_team[:64]!r} (got {text[:80]!r}, allowed 64 letters, digits and _ . @ -)"
        )
        raise _option_error("oidc-role", problem)
    scope: TokenScope | None = (
        "submit" if permission == "submit" else "released" if permission == "released" else None
    )
    role = (
        ROLE_OF[scope]
        if scope
        else next(token_role for token_role in TOKEN_ROLES if token_role == permission)
    )
    grant = Grant(role, team if own_team is None else own_team, scope, tag, own_team is not None)
    if issue := scope_issue(role, grant.team, scope, tag):
        raise _option_error("oidc-role", f"invalid (got {text[:80]!r}): {issue.message}")
    return match["value"], grant


def _option_error(field: str, problem: str) -> TandemError:
    return issue_error("service.start", f"--{field}: {problem}", field=field)


@dataclasses.dataclass(frozen=True)
class LogInState:
    """State of a log-in, which the browser keeps in a cookie while it is at the provider.

    Attributes:
        state: Random value against forged requests.
        nonce: Random value that the ID token must contain.
        verifier: PKCE verifier.
        next: Path of the page to show after log-in.
        until: Time limit of the log-in [s since 1970].
    """

    state: str
    nonce: str
    verifier: str
    next: str
    until: float


class LogIn:
    """Log-in through one provider. Threads may share it."""

    def __init__(self, database: Database, auth: Auth, oidc: OidcSettings) -> None:
        self.oidc = oidc
        self._auth = auth
        self._secret = bytes.fromhex(shared_secret(database, "oidc"))
        self._lock = threading.Lock()
        self._query_slots = threading.BoundedSemaphore(MAX_CONCURRENT_LOG_INS)
        self._metadata: tuple[float, dict[str, Any], KeySet] | None = None
        self._asked_at = -math.inf
        self._failed_until = -math.inf

    def start(self, redirect: str, next_path: str) -> tuple[str, str]:
        """Start a log-in.

        Args:
            redirect: Address to which the browser returns.
            next_path: Path of this service to show after log-in.

        Returns:
            Address of the provider, and the cookie that the browser must bring back.

        Raises:
            RefusedError: 502, or 503 while many people log in.
        """
        with self._query_slot():
            metadata, _ = self._provider_metadata()
        state, nonce, verifier = (secrets.token_urlsafe(32) for _ in range(3))
        log_in_state = LogInState(state, nonce, verifier, local_path(next_path), time.time() + MAX_LOG_IN_S)
        with self._client(redirect) as client:
            address, _ = client.create_authorization_url(
                metadata["authorization_endpoint"], state=state, nonce=nonce, code_verifier=verifier
            )
        return str(address), self._encode_state(log_in_state)

    def finish(self, address: str, redirect: str, cookie: str | None) -> tuple[Principal, str]:
        """Finish a log-in.

        Args:
            address: Address at which the browser returned, with its query.
            redirect: Address to which the browser was to return.
            cookie: Cookie of :meth:`start`.

        Returns:
            Authenticated principal, and the path of the page to show.

        Raises:
            RefusedError: 403 for accounts without a role, 502 if the provider does not answer correctly.
        """
        log_in_state = self._decode_state(cookie)
        parameters = {name: values[-1] for name, values in parse_qs(urlsplit(address).query).items()}
        if not hmac.compare_digest(parameters.get("state", "").encode(), log_in_state.state.encode()):
            raise log_in_refusal("was not started in this browser. Start at the log-in page.")
        if "error" in parameters or "code" not in parameters:
            raise log_in_refusal(
                f"the provider refused it ({parameters.get('error', 'no code')[:60]}). Log in again."
            )
        with self._query_slot():
            metadata, keys = self._provider_metadata()
            try:
                with self._client(redirect) as client:
                    tokens = client.fetch_token(
                        metadata["token_endpoint"],
                        code=parameters["code"],
                        code_verifier=log_in_state.verifier,
                    )
            except AuthlibBaseError as error:
                raise log_in_refusal(
                    f"the provider refused it ({str(error.error)[:60]}). Log in again."
                ) from error
            except (httpx.HTTPError, ValueError) as error:
                raise _provider_unavailable(error) from error
            token = str(tokens.get("id_token", ""))
            try:
                claims = self._claims(token, metadata, keys, log_in_state.nonce)
            except InvalidKeyIdError:  # the provider may have changed its keys
                claims = self._claims(token, *self._provider_metadata(refresh=True), log_in_state.nonce)
        account_keys = self._account_keys(f"{metadata['issuer']} {claims['sub']}")
        try:
            grant = self.grant(claims)
        except RefusedError:
            self._auth.close_accounts(list(account_keys.values()))
            raise
        principal = self._auth.update_account(
            account_keys[grant.team if grant.has_own_team else None],
            display_name(claims),
            TokenPermissions(grant.role, grant.team, grant.scope, grant.tag),
            list(account_keys.values()),
        )
        return dataclasses.replace(principal, expires=time.time() + SESSION_S), log_in_state.next

    def _account_keys(self, account: str) -> dict[str | None, str]:
        """Return the names under which the store keeps an account: one for each team.

        Args:
            account: Issuer and subject of the ID token.

        Returns:
            Names by the own team of a grant. None is the key for grants without an own team.
        """
        teams = {grant.team for _, grant in self.oidc.grants if grant.has_own_team}
        return {None: account, **{team: f"{account} team {team}" for team in sorted(filter(None, teams))}}

    @contextlib.contextmanager
    def _query_slot(self) -> Iterator[None]:
        """Reserve one of the few concurrent queries of the provider.

        Raises:
            RefusedError: 503, none is free.
        """
        if not self._query_slots.acquire(blocking=False):
            issue = Issue("service.log_in", "log-in: too many log-ins at once. Try again in a moment.")
            raise RefusedError(503, issue, {"Retry-After": "5"})
        try:
            yield
        finally:
            self._query_slots.release()

    def grant(self, claims: Mapping[str, Any]) -> Grant:
        """Return the most permissive grant for some claims.

        An email address counts only if the provider has verified it.

        Args:
            claims: Claims of the ID token.

        Raises:
            RefusedError: 403, no grant applies.
        """
        trusted = self.oidc.claim != "email" or claims.get("email_verified") is True
        claim = claims.get(self.oidc.claim) if trusted else None
        claim_values = [claim] if isinstance(claim, str) else claim if isinstance(claim, list) else []
        values = set(map(str, claim_values))
        matching = [grant for value, grant in self.oidc.grants if value != ANY_ACCOUNT and value in values]
        matching = matching or [grant for value, grant in self.oidc.grants if value == ANY_ACCOUNT]
        if not matching:
            message = f"account {display_name(claims)}: has no role on this service. Ask its operator."
            raise RefusedError(403, Issue("service.role", message, field=self.oidc.claim))
        return min(matching, key=lambda grant: PERMISSION_ORDER.index(grant.scope or grant.role))

    def _claims(self, token: str, metadata: Mapping[str, Any], keys: KeySet, nonce: str) -> dict[str, Any]:
        """Return the claims of an ID token signed for this log-in (Core 1.0, section 3.1.3.7).

        Raises:
            RefusedError: 403, the token is invalid.
            InvalidKeyIdError: The key of the signature is unknown.
        """
        if len(token) > MAX_ID_TOKEN_LENGTH:
            message = f"the provider's ID token is too long (got {len(token):,} characters, allowed "
            message += (
                f"{MAX_ID_TOKEN_LENGTH:,}). Most of it is the claim {self.oidc.claim!r}. Filter this claim "
                "at "
            )
            raise log_in_refusal(
                f"{message}the provider, so that it lists only groups that have a role here."
            )
        try:
            claims = dict(jwt.decode(token, keys, algorithms=list(ALGORITHMS)).claims)
            jwt.JWTClaimsRegistry(
                leeway=CLOCK_LEEWAY_S,
                iss={"essential": True, "value": metadata["issuer"]},
                aud={"essential": True, "value": self.oidc.client},
                sub={"essential": True},
                exp={"essential": True},
                iat={"essential": True},
                nonce={"essential": True, "value": nonce},
            ).validate(claims)
        except InvalidKeyIdError:
            raise
        except (ExpiredTokenError, InvalidTokenError) as error:  # usually a wrong clock
            stamps = ", ".join(f"{name} {claims[name]!s:.40}" for name in TIME_CLAIMS if name in claims)
            message = (
                f"the provider's ID token is not valid now ({stamps} s since 1970, clock of this machine "
            )
            raise log_in_refusal(f"{message}{time.time():.0f}). Set both clocks and log in again.") from error
        except (JoseError, ValueError, TypeError, KeyError) as error:
            raise log_in_refusal(
                f"the provider's ID token is invalid ({type(error).__name__}). Log in again."
            ) from error
        if not str(claims["sub"]).isprintable():
            raise log_in_refusal("the provider's ID token has an unprintable account name. Ask the provider.")
        if (
            isinstance(claims["aud"], list)
            and len(claims["aud"]) > 1
            and claims.get("azp") != self.oidc.client
        ):
            raise log_in_refusal("the provider's ID token is for another service. Log in again.")
        return claims

    def _provider_metadata(self, refresh: bool = False) -> tuple[dict[str, Any], KeySet]:
        """Return metadata and keys of the provider (OpenID Connect Discovery 1.0), cached unless ``refresh``.

        Metadata that were queried less than `RETRY_AFTER_FAILURE_S` ago are not refreshed.

        Raises:
            RefusedError: 502, the provider does not answer correctly, or failed a moment ago.
        """
        with self._lock:
            now = time.monotonic()
            must_refresh = refresh and now - self._asked_at > RETRY_AFTER_FAILURE_S
            if self._metadata is not None and self._metadata[0] > now and not must_refresh:
                return self._metadata[1:]
            if now < self._failed_until:
                raise _provider_unavailable(TimeoutError())
            self._asked_at = now
            try:
                with httpx.Client(timeout=PROVIDER_TIMEOUT_S) as client:
                    issuer = self.oidc.issuer.rstrip("/")
                    answer = client.get(f"{issuer}/.well-known/openid-configuration")
                    metadata = answer.raise_for_status().json()
                    if metadata["issuer"].rstrip("/") != issuer:
                        raise ValueError("the issuer in the metadata differs from its address")
                    for name in ("authorization_endpoint", "token_endpoint", "jwks_uri"):
                        _check_encrypted(metadata[name])
                    keys = KeySet.import_key_set(client.get(metadata["jwks_uri"]).raise_for_status().json())
            except (httpx.HTTPError, JoseError, ValueError, KeyError, TypeError, AttributeError) as error:
                self._failed_until = time.monotonic() + RETRY_AFTER_FAILURE_S
                raise _provider_unavailable(error) from error
            self._metadata = (time.monotonic() + METADATA_CACHE_S, metadata, keys)
            return metadata, keys

    def _client(self, redirect: str) -> OAuth2Client:
        """Return a client for one log-in, which returns to the address ``redirect``."""
        return OAuth2Client(
            self.oidc.client,
            self.oidc.secret,
            scope=self.oidc.scope,
            redirect_uri=redirect,
            code_challenge_method="S256",
            timeout=PROVIDER_TIMEOUT_S,
        )

    def _encode_state(self, log_in_state: LogInState) -> str:
        """Return the content of the cookie: the state in base64, a dot, and its signature."""
        body = base64.urlsafe_b64encode(json.dumps(dataclasses.asdict(log_in_state)).encode()).decode()
        return f"{body}.{self._signature(body)}"

    def _signature(self, body: str) -> str:
        return hmac.new(self._secret, f"tandem log-in {body}".encode(), hashlib.sha256).hexdigest()

    def _decode_state(self, cookie: str | None) -> LogInState:
        """Verify and decode the cookie of a log-in."""
        body, _, signature = (cookie or "").partition(".")
        if not hmac.compare_digest(signature.encode(), self._signature(body).encode()):
            raise log_in_refusal("was not started in this browser. Start at the log-in page.")
        log_in_state = LogInState(**json.loads(base64.urlsafe_b64decode(body)))
        if log_in_state.until < time.time():
            raise log_in_refusal(f"took more than {MAX_LOG_IN_S / 60.0:g} minutes. Log in again.")
        return log_in_state


def local_path(path: str) -> str:
    """Return a path if it leads to a page of this service, else the path of the start page."""
    return path if re.match(r"/(?![/\\])[\x21-\x7e]*$", path) else "/"


def display_name(claims: Mapping[str, Any]) -> str:
    """Return the display name of an account: the first of `NAME_CLAIMS` that is present and trusted.

    Args:
        claims: Claims of the ID token, with a non-empty ``sub``.
    """
    names = {name: _printable(claims[name]) for name in NAME_CLAIMS if claims.get(name)}
    if claims.get("email_verified") is not True:
        names.pop("email", None)
    if "@" in names.get("preferred_username", ""):  # an unverified email address
        names.pop("preferred_username")
    return next(iter(names.values()))


def _printable(name: Any) -> str:
    """Replace unprintable characters and bidirectional controls of a name by question marks."""
    return "".join(letter if letter.isprintable() else "?" for letter in str(name)[:200])


def log_in_refusal(why: str) -> RefusedError:
    """Return the refusal of a log-in: 403."""
    return RefusedError(403, Issue("service.log_in", f"log-in: {why}"))


def _check_encrypted(address: str) -> None:
    """Check that an address uses TLS or is on this machine.

    Raises:
        ValueError: Plain HTTP over a network.
    """
    if is_unencrypted(urlsplit(address)):
        raise ValueError("the metadata contain an address without TLS")


def _provider_unavailable(error: Exception) -> RefusedError:
    message = f"log-in: the provider does not answer correctly ({type(error).__name__}). Try again later."
    return RefusedError(502, Issue("service.log_in", message))
