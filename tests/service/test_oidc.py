"""Login through an OpenID Connect provider.

Tested against a real provider (npm's oidc-provider, if it is installed), and against a provider that forges
whatever it can.
"""

from __future__ import annotations

import base64
import hashlib
import hmac
import json
import os
import re
import shutil
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import httpx
import pytest

pytest.importorskip("authlib")

from joserfc import jws
from joserfc.jwk import ECKey, KeySet, RSAKey

from planner.issues import TandemError
from planner.service import oidc
from planner.service.models import Database, default_url
from planner.service.oidc import (
    MAX_LOG_IN_S,
    Grant,
    GrantOptions,
    LogIn,
    OidcSettings,
    display_name,
    local_path,
    read_settings,
)
from planner.service.rate_limits import RateLimiter
from planner.service.security import Auth, RefusedError
from tests.service.support import InProcess, free_port

SECRET = "s3cret-s3cret-s3cret"
GRANTS = (("release", Grant("release", "shop")), ("shop", Grant("plan", "shop")))
REDIRECT = "http://127.0.0.1:9/ui/oidc/callback"
KEY = RSAKey.generate_key(2048, {"kid": "one"})
OTHER = RSAKey.generate_key(2048, {"kid": "one"})


class FakeProvider:
    """A fake provider that answers a code with any requested ID token."""

    def __init__(self) -> None:
        self.token: Callable[[dict[str, Any]], str] = lambda claims: sign_token(claims)
        self.claims: dict[str, Any] = {}
        self.about: dict[str, Any] = {}
        self.token_request: dict[str, list[str]] = {}
        self.nonce = ""
        forger = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                known = {"/jwks": KeySet([KEY]).as_dict(private=False)}
                known["/.well-known/openid-configuration"] = {
                    "issuer": forger.issuer,
                    "authorization_endpoint": f"{forger.issuer}/auth",
                    "token_endpoint": f"{forger.issuer}/token",
                    "jwks_uri": f"{forger.issuer}/jwks",
                    **forger.about,
                }
                self._send(known[self.path])

            def do_POST(self) -> None:
                forger.token_request = parse_qs(self.rfile.read(int(self.headers["Content-Length"])).decode())
                if forger.token_request["code"] == ["spent"]:
                    self._send({"error": "invalid_grant"}, 400)
                else:
                    self._send(
                        {"access_token": "x", "token_type": "Bearer", "id_token": forger.token(forger.claims)}
                    )

            def _send(self, what: Any, status: int = 200) -> None:
                body = json.dumps(what).encode()
                self.send_response(status)
                self.send_header("Content-Type", "application/json")
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *args: Any) -> None:
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.issuer = f"http://127.0.0.1:{self._server.server_port}"
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()


def sign_token(claims: dict[str, Any], key: Any = KEY, alg: str = "RS256", kid: str = "one") -> str:
    text = json.dumps(claims)  # with halves of letters, which jwt.encode does not take
    return jws.serialize_compact({"alg": alg, "kid": kid}, text, key, algorithms=[alg])


@pytest.fixture
def forger() -> Iterator[FakeProvider]:
    made = FakeProvider()
    yield made
    made.close()


@pytest.fixture
def log_in(forger: FakeProvider, tmp_path: Path) -> Iterator[LogIn]:
    database = Database(default_url(tmp_path))
    yield LogIn(database, Auth(database), OidcSettings(forger.issuer, "tandem", SECRET, GRANTS))
    database.close()


def visit_provider(log_in: LogIn, forger: FakeProvider, after: str = "/") -> tuple[str, str]:
    """(the address to which the browser comes back, its cookie); the provider knows somebody of the shop."""
    address, cookie = log_in.start(REDIRECT, after)
    query = parse_qs(urlsplit(address).query)
    now = int(time.time())
    forger.claims = {
        "iss": forger.issuer,
        "aud": "tandem",
        "sub": "7",
        "iat": now,
        "exp": now + 60,
        "nonce": query["nonce"][0],
        "email": "ann@shop.example",
        "email_verified": True,
        "groups": ["shop"],
    }
    return f"{REDIRECT}?code=good&state={query['state'][0]}", cookie


def test_what_is_asked_is_the_code_flow_with_a_challenge(log_in: LogIn, forger: FakeProvider) -> None:
    address, cookie = log_in.start(REDIRECT, "/ui/new")
    query = {name: values[0] for name, values in parse_qs(urlsplit(address).query).items()}
    assert address.startswith(f"{forger.issuer}/auth?")
    assert (query["response_type"], query["client_id"], query["redirect_uri"]) == ("code", "tandem", REDIRECT)
    assert query["code_challenge_method"] == "S256" and "openid" in query["scope"].split()
    others = parse_qs(urlsplit(log_in.start(REDIRECT, "/")[0]).query)
    for name in ("state", "nonce", "code_challenge"):
        assert others[name] != [query[name]] and len(query[name]) >= 43
    assert SECRET not in address and SECRET not in cookie


def test_who_comes_back_is_an_account_with_the_role_that_was_told(
    log_in: LogIn, forger: FakeProvider
) -> None:
    address, cookie = visit_provider(log_in, forger, "/ui/new?from=x")
    who, after = log_in.finish(address, REDIRECT, cookie)
    assert (who.name, who.role, who.team, after) == ("ann@shop.example", "plan", "shop", "/ui/new?from=x")
    assert who.expires is not None and 11 * 3600 < who.expires - time.time() < 13 * 3600
    assert forger.token_request["code_verifier"][0]
    address, cookie = visit_provider(log_in, forger)
    forger.claims |= {"groups": ["shop", "release"], "email": "ann.b@shop.example"}  # promoted, and married
    again, _ = log_in.finish(address, REDIRECT, cookie)
    assert (again.token, again.role, again.name) == (who.token, "release", "ann.b@shop.example")
    address, cookie = visit_provider(log_in, forger)
    forger.claims |= {"sub": "8", "email": "ann.b@shop.example"}  # another account that is called so
    third, _ = log_in.finish(address, REDIRECT, cookie)
    assert third.token != who.token and third.name == f"ann.b@shop.example-{third.token[:8]}"


WRONG: dict[str, dict[str, Any]] = {
    "another issuer": {"iss": "https://evil.example"},
    "another service": {"aud": "other"},
    "another service beside": {"aud": ["tandem", "other"], "azp": "other"},
    "no audience": {"aud": None},
    "over": {"exp": 1_000_000_000},
    "without an end": {"exp": None},
    "of another log-in": {"nonce": "x" * 43},
    "without a nonce": {"nonce": None},
    "of nobody": {"sub": None},
}


@pytest.mark.parametrize("name", WRONG)
def test_an_id_token_that_is_not_for_this_is_refused(log_in: LogIn, forger: FakeProvider, name: str) -> None:
    address, cookie = visit_provider(log_in, forger)
    forger.claims |= WRONG[name]
    forger.claims = {key: value for key, value in forger.claims.items() if value is not None}
    with pytest.raises(RefusedError) as error:
        log_in.finish(address, REDIRECT, cookie)
    assert (error.value.status, error.value.issues[0].code) == (403, "service.log_in")


@pytest.mark.parametrize("jump", [7200.0, -7200.0])
def test_a_clock_that_is_wrong_is_told_as_that(
    log_in: LogIn, forger: FakeProvider, monkeypatch: pytest.MonkeyPatch, jump: float
) -> None:
    address, cookie = visit_provider(log_in, forger)
    now = time.time
    monkeypatch.setattr(oidc, "MAX_LOG_IN_S", 1e9)
    address, cookie = visit_provider(log_in, forger)
    monkeypatch.setattr(time, "time", lambda: now() + jump)
    with pytest.raises(RefusedError, match=r"is not valid now \(iat \d+.*Set both clocks") as error:
        log_in.finish(address, REDIRECT, cookie)
    assert error.value.status == 403


def forge_token(claims: dict[str, Any], alg: str, secret: bytes = b"") -> str:
    """Forge a token by hand, which libraries refuse to do: unsigned, or signed with a guessable secret."""

    def part(what: bytes) -> str:
        return base64.urlsafe_b64encode(what).decode().rstrip("=")

    body = ".".join(part(json.dumps(item).encode()) for item in ({"alg": alg, "kid": "one"}, claims))
    seal = hmac.new(secret, body.encode(), hashlib.sha256).digest() if secret else b""
    return f"{body}.{part(seal)}"


FORGED: dict[str, Callable[[dict[str, Any]], str]] = {
    "by another key": lambda claims: sign_token(claims, OTHER),
    "by nobody": lambda claims: forge_token(claims, "none"),
    "by the public key as a word": lambda claims: forge_token(claims, "HS256", KEY.as_pem(private=False)),
    "by the secret": lambda claims: forge_token(claims, "HS256", SECRET.encode()),
    "by a key of another kind": lambda claims: sign_token(claims, ECKey.generate_key("P-256"), "ES256"),
    "with its last letter lost": lambda claims: sign_token(claims)[:-1],
    "as anything": lambda claims: "a.b.c",
    "not at all": lambda claims: "",
}


@pytest.mark.parametrize("name", FORGED)
def test_an_id_token_that_is_not_the_providers_is_refused(
    log_in: LogIn, forger: FakeProvider, name: str
) -> None:
    address, cookie = visit_provider(log_in, forger)
    forger.token = FORGED[name]
    with pytest.raises(RefusedError) as error:
        log_in.finish(address, REDIRECT, cookie)
    assert (error.value.status, error.value.issues[0].code) == (403, "service.log_in")


def test_only_the_browser_that_went_comes_back(
    log_in: LogIn, forger: FakeProvider, monkeypatch: pytest.MonkeyPatch
) -> None:
    address, cookie = visit_provider(log_in, forger)
    other, others_cookie = visit_provider(log_in, forger)
    body, _, seal = cookie.partition(".")
    for given in (
        None,
        "",
        "x",
        others_cookie,
        f"{body}.{seal[:-1]}0",
        f"{others_cookie.partition('.')[0]}.{seal}",
    ):
        with pytest.raises(RefusedError) as error:
            log_in.finish(address, REDIRECT, given)
        assert error.value.status == 403
    for wrong in (
        address.replace("code=good", "code=spent"),
        f"{REDIRECT}?error=access_denied",
        REDIRECT,
        other,
    ):
        with pytest.raises(RefusedError) as error:
            log_in.finish(wrong, REDIRECT, cookie)
        assert error.value.status == 403, wrong
    now = time.time()
    monkeypatch.setattr(oidc.time, "time", lambda: now + MAX_LOG_IN_S + 1.0)
    with pytest.raises(RefusedError, match="more than 10 minutes"):
        log_in.finish(address, REDIRECT, cookie)


def test_who_has_no_role_or_was_revoked_is_told_so(log_in: LogIn, forger: FakeProvider) -> None:
    for groups in ([], None, "else", ["shopping"], {"shop": 1}, 7):
        address, cookie = visit_provider(log_in, forger)
        forger.claims["groups"] = groups
        with pytest.raises(RefusedError, match=r"ann@shop\.example: has no role on this service"):
            log_in.finish(address, REDIRECT, cookie)
    address, cookie = visit_provider(log_in, forger)
    who, _ = log_in.finish(address, REDIRECT, cookie)
    log_in._auth.revoke(who.name)
    address, cookie = visit_provider(log_in, forger)
    with pytest.raises(RefusedError, match="was revoked"):
        log_in.finish(address, REDIRECT, cookie)


def test_an_account_is_called_by_what_its_provider_vouches_for() -> None:
    claims = {"sub": "7", "email": "boss@shop.example", "preferred_username": "eve"}
    assert display_name(claims) == "eve"
    assert display_name(claims | {"email_verified": True}) == "boss@shop.example"
    assert display_name({"sub": "7"}) == "7"


@pytest.mark.parametrize(
    "about",
    [{"issuer": "https://evil.example"}, {"token_endpoint": "http://evil.example/token"}, {"jwks_uri": None}],
)
def test_a_provider_that_is_another_one_is_not_asked(
    log_in: LogIn, forger: FakeProvider, about: dict[str, Any]
) -> None:
    forger.about = about
    with pytest.raises(RefusedError) as error:
        log_in.start(REDIRECT, "/")
    assert error.value.status == 502


@pytest.mark.parametrize(
    "path",
    ["https://evil.example", "//evil.example", "/\\evil.example", "", "x", "/a\nb", "/a b", "javascript:x"],
)
def test_the_way_back_stays_inside(path: str) -> None:
    assert local_path(path) == "/"
    assert local_path("/ui/jobs/1?x=%2F#y") == "/ui/jobs/1?x=%2F#y"


def settings_of(roles: Sequence[str], claim: str, team: str | None, **given: Any) -> OidcSettings:
    return read_settings(grant_options=GrantOptions(roles, claim, team), **given)


def test_options_that_cannot_be_are_told(tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.write_text(f"{SECRET}\n")
    good = {
        "issuer": "https://id.example/",
        "client": "tandem",
        "secret": secret,
        "roles": ("*=view", "a=b=plan"),
    }
    more = {"claim": "groups", "team": None, "scope": "openid"}
    made = settings_of(**good, **more)  # type: ignore[arg-type]
    assert (made.issuer, made.secret) == ("https://id.example/", SECRET)
    assert made.grants == (("*", Grant("view")), ("a=b", Grant("plan")))
    for wrong, field in (
        ({"issuer": "http://id.example"}, "oidc-issuer"),
        ({"client": None}, "oidc-client"),
        ({"secret": None}, "oidc-client"),
        ({"secret": tmp_path / "none"}, "oidc-secret"),
        ({"roles": ()}, "oidc-role"),
        ({"roles": ("shop=boss",)}, "oidc-role"),
        ({"roles": ("plan",)}, "oidc-role"),
        ({"roles": ("a=plan@",)}, "oidc-role"),
        ({"roles": ("a=plan@two teams",)}, "oidc-role"),
        ({"roles": ("a=released",)}, "oidc-role"),
        ({"roles": ("a=submit:tag",)}, "oidc-role"),
        ({"roles": ("a=view@shop:tag",)}, "oidc-role"),
        ({"roles": ("a=released@shop:",)}, "oidc-role"),
        ({"team": "two teams"}, "oidc-team"),
    ):
        with pytest.raises(TandemError) as error:
            settings_of(**{**good, **more, **wrong})  # type: ignore[arg-type]
        assert (error.value.issues[0].code, error.value.issues[0].field) == ("service.start", field)


TEAMS = (
    "cutters=plan@cutters",
    "foremen=release@cutters",
    "night=submit@cutters",
    "screens=released@cutters:cell 3",
    "formers=plan@formers",
    "*=view",
)


def teams(log_in: LogIn, tmp_path: Path) -> LogIn:
    """The same service whose provider's groups are teams."""
    (tmp_path / "secret").write_text(SECRET)
    given = ("tandem", tmp_path / "secret", GrantOptions(TEAMS, "groups", "all"), "openid")
    return LogIn(log_in._auth._database, log_in._auth, read_settings(log_in.oidc.issuer, *given))


@pytest.mark.parametrize(
    ("groups", "expected_access"),
    [
        (["cutters"], ("plan", "cutters", None, None)),
        (["night"], ("plan", "cutters", "submit", None)),
        (["screens"], ("view", "cutters", "released", "cell 3")),
        ([], ("view", "all", None, None)),
        (["night", "foremen", "formers"], ("release", "cutters", None, None)),
        (["screens", "night"], ("plan", "cutters", "submit", None)),
        (["formers", "cutters"], ("plan", "cutters", None, None)),
        (["cutters=plan@formers", "foremen "], ("view", "all", None, None)),
    ],
)
def test_groups_of_the_provider_give_role_team_and_scope(
    log_in: LogIn, forger: FakeProvider, tmp_path: Path, groups: list[str], expected_access: tuple[Any, ...]
) -> None:
    made = teams(log_in, tmp_path)
    address, cookie = visit_provider(made, forger)
    forger.claims["groups"] = groups
    who, _ = made.finish(address, REDIRECT, cookie)
    assert (who.role, who.team, who.scope, who.tag) == expected_access
    (row,) = log_in._auth.list()
    assert (row.role, row.team, row.scope, row.tag) == expected_access
    session = log_in._auth.authenticate_session(log_in._auth.open_session(who)[0])
    assert (session.role, session.team, session.scope, session.tag) == expected_access


ODD: dict[str, Any] = {
    "all, by its sign": ["*"],
    "a word that holds one": "xshopx",
    "a mapping": {"shop": True, "release": True},
    "lists in lists": [["shop"], [["release"]]],
    "numbers and nothing": [None, 7, 1e400, True],
    "very many": [f"group {number}" for number in range(500)],
    "with marks that turn": ["\u202eshop", "shop\u200b", " shop", "SHOP"],
    "a rule of the command line": ["shop=release", "release@shop"],
}


@pytest.mark.parametrize("name", ODD)
def test_odd_groups_give_nothing(log_in: LogIn, forger: FakeProvider, name: str) -> None:
    address, cookie = visit_provider(log_in, forger)
    forger.claims["groups"] = ODD[name]
    with pytest.raises(RefusedError, match="has no role on this service") as error:
        log_in.finish(address, REDIRECT, cookie)
    assert error.value.status == 403
    assert log_in._auth.list() == ()


@pytest.mark.parametrize("count", [20_000, 200_000])
def test_too_many_groups_are_told_with_what_to_do(log_in: LogIn, forger: FakeProvider, count: int) -> None:
    """The whole list of a directory: the library that reads tokens refuses such a long token."""
    address, cookie = visit_provider(log_in, forger)
    forger.claims["groups"] = [f"group {number:05}" for number in range(count)]
    with pytest.raises(RefusedError, match=r"got [\d,]+ characters, allowed 120,000.*Filter") as error:
        log_in.finish(address, REDIRECT, cookie)
    assert (error.value.status, error.value.issues[0].code) == (403, "service.log_in")


def test_some_thousand_groups_are_read(log_in: LogIn, forger: FakeProvider) -> None:
    address, cookie = visit_provider(log_in, forger)
    forger.claims["groups"] = [*(f"group {number:05}" for number in range(4000)), "release"]
    assert log_in.finish(address, REDIRECT, cookie)[0].role == "release"


@pytest.mark.parametrize("sub", ["\ud800", "a\0b", "\u202e7", "7\u2028"])
def test_an_account_that_is_no_text_is_refused(log_in: LogIn, forger: FakeProvider, sub: str) -> None:
    """Half a letter, as JSON may have it, was an internal error."""
    address, cookie = visit_provider(log_in, forger)
    forger.claims["sub"] = sub
    with pytest.raises(RefusedError, match="unprintable account name") as error:
        log_in.finish(address, REDIRECT, cookie)
    assert error.value.status == 403


@pytest.mark.parametrize("name", ["\ud800@shop.example", "\u202enna", "a\nb", "<b>" + "x" * 10_000])
def test_a_name_without_a_role_is_told_as_text(log_in: LogIn, forger: FakeProvider, name: str) -> None:
    address, cookie = visit_provider(log_in, forger)
    forger.claims |= {"email": name, "groups": []}
    with pytest.raises(RefusedError, match="has no role on this service") as error:
        log_in.finish(address, REDIRECT, cookie)
    (issue,) = error.value.issues
    assert issue.message.isprintable() and len(issue.message.encode()) < 1000


def test_names_of_accounts_are_plain_whatever_the_provider_tells(log_in: LogIn, forger: FakeProvider) -> None:
    address, cookie = visit_provider(log_in, forger)
    forger.claims |= {"email": "<script>alert(1)</script>\u202eann" + "x" * 10_000}
    who, _ = log_in.finish(address, REDIRECT, cookie)
    assert re.fullmatch(r"[A-Za-z0-9_.@-]{1,64}", who.name)


def test_in_another_team_an_account_begins_anew(log_in: LogIn, forger: FakeProvider, tmp_path: Path) -> None:
    """Its jobs stay with the previous team; a revocation in one team holds in all."""
    made, auth = teams(log_in, tmp_path), log_in._auth

    def comes(groups: list[str]) -> Any:
        address, cookie = visit_provider(made, forger)
        forger.claims["groups"] = groups
        return made.finish(address, REDIRECT, cookie)[0]

    first = comes(["cutters"])
    cookie, _ = auth.open_session(first)
    other = comes(["formers"])
    assert other.token != first.token
    assert not auth.sees(other, first.token) and not auth.sees(first, other.token)
    with pytest.raises(RefusedError, match="session has expired"):
        auth.authenticate_session(cookie)
    again = comes(["foremen"])
    assert (again.token, again.role) == (first.token, "release")
    cookie, _ = auth.open_session(again)
    comes(["night"])
    assert (
        auth.authenticate_session(cookie).scope == "submit"
    )  # at once, in the browsers where it is logged in
    auth.revoke(other.name)
    for groups in (["cutters"], ["formers"], []):
        with pytest.raises(RefusedError, match="was revoked"):
            comes(groups)


@pytest.fixture
def real(tmp_path: Path) -> Iterator[InProcess]:
    """A service whose people log in by npm's oidc-provider."""
    folder = os.environ.get("TANDEM_OIDC_PROVIDER", "")
    if not folder or shutil.which("node") is None:
        pytest.skip("TANDEM_OIDC_PROVIDER names no folder of npm's oidc-provider, or there is no node")
    port = free_port()
    script = str(Path(__file__).with_name("oidc_provider.mjs"))
    node = subprocess.Popen(
        ["node", script, str(port), f"{BASE_URL}/ui/oidc/callback", folder], stdout=subprocess.PIPE
    )
    assert node.stdout is not None
    assert node.stdout.readline() == b"ready\n"
    account = OidcSettings(f"http://127.0.0.1:{port}", "tandem", SECRET, REAL)
    try:
        with InProcess(tmp_path / "data", examiners=1, oidc=account) as running_service:
            yield running_service
    finally:
        node.kill()
        node.wait()


BASE_URL = "http://127.0.0.1"
REAL = (
    ("shop", Grant("plan", "shop")),
    ("night", Grant("plan", "shop", "submit")),
    ("screens", Grant("view", "shop", "released", "cell 3")),
)


def logged_in(real: InProcess, account: str) -> httpx.Response:
    """Return the session answer after a login at the provider's own pages."""
    page = real.http.get("/ui/oidc/login?after=/ui/new", follow_redirects=False)
    assert page.status_code == 303
    assert (
        "httponly" in page.headers["set-cookie"].lower()
        and "samesite=lax" in page.headers["set-cookie"].lower()
    )
    address = page.headers["location"]
    with httpx.Client() as browser:
        answer = browser.get(address, follow_redirects=True)
        for form in ({"prompt": "login", "login": account, "password": "x"}, {"prompt": "consent"}):
            action = re.search(r'action="([^"]+)"', answer.text)
            assert action is not None, answer.text[:500]
            answer = browser.post(action[1], data=form, follow_redirects=False)
            while answer.is_redirect and not answer.headers["location"].startswith(f"{BASE_URL}/ui"):
                answer = browser.get(answer.url.join(answer.headers["location"]), follow_redirects=False)
    back = urlsplit(answer.headers["location"])
    return real.http.get(f"{back.path}?{back.query}", follow_redirects=False)


def test_people_log_in_by_a_real_provider(real: InProcess) -> None:
    assert real.http.get("/v1/jobs").status_code == 401
    assert "Log in with your account" in real.http.get("/ui/login").text
    answer = logged_in(real, "ann+shop")
    assert (answer.status_code, answer.headers["location"]) == (303, "/ui/new")
    cookie = answer.headers["set-cookie"].lower()
    assert "tandem_session=" in cookie and "httponly" in cookie and "samesite=strict" in cookie
    assert real.http.get("/v1/jobs").status_code == 200
    (account,) = real.service.auth.list()
    assert (account.name, account.role) == ("ann@shop.example", "plan")
    real.http.cookies.clear()
    refused = logged_in(real, "eve+nobody")
    assert refused.status_code == 403
    assert "eve@shop.example: has no role on this service" in refused.text
    assert real.http.get("/v1/jobs").status_code == 401


@pytest.mark.parametrize(
    ("group", "role", "scope", "tag"),
    [("night", "plan", "submit", None), ("screens", "view", "released", "cell 3")],
)
def test_groups_of_a_real_provider_give_a_scope(
    real: InProcess, group: str, role: str, scope: str, tag: str | None
) -> None:
    assert logged_in(real, f"ann+{group}").status_code == 303
    body = real.http.get("/v1/session").json()
    assert (body["role"], body["team"], body["scope"], body.get("tag")) == (role, "shop", scope, tag)
    assert real.http.get("/v1/jobs").status_code == 200
    for path in ("/v1/elements", "/v1/drafts", "/v1/audit", "/v1/webhooks", "/metrics"):
        assert real.http.get(path).status_code == 403, path
    sent = real.http.post("/v1/jobs", content=b"x", headers={"Content-Type": "application/yaml"})
    assert sent.status_code == (422 if scope == "submit" else 403)


def test_who_comes_without_having_gone_is_told_on_the_log_in_page(real: InProcess) -> None:
    answer = real.http.get("/ui/oidc/callback?code=x&state=<script>alert(1)</script>")
    assert answer.status_code == 403
    assert "started in this browser" in answer.text and "<script>alert" not in answer.text


def test_a_service_without_a_provider_has_no_such_pages(tmp_path: Path) -> None:
    with InProcess(tmp_path / "data", examiners=1) as running_service:
        assert running_service.http.get("/ui/oidc/login").status_code == 404
        assert running_service.http.get("/ui/oidc/callback").status_code == 404
        assert "your account" not in running_service.http.get("/ui/login").text


def test_an_issuer_may_end_with_a_slash(forger: FakeProvider, tmp_path: Path) -> None:
    """Those of Authentik and Auth0 do; it is compared with the provider's (Core 1.0, section 3.1.3.7)."""
    forger.about = {"issuer": f"{forger.issuer}/"}
    database = Database(default_url(tmp_path))
    for given in (forger.issuer, f"{forger.issuer}/"):
        log_in = LogIn(database, Auth(database), OidcSettings(given, "tandem", SECRET, GRANTS))
        address, cookie = visit_provider(log_in, forger)
        forger.claims["iss"] = f"{forger.issuer}/"
        assert log_in.finish(address, REDIRECT, cookie)[0].role == "plan"
        address, cookie = visit_provider(log_in, forger)  # without the slash it is another one
        with pytest.raises(RefusedError):
            log_in.finish(address, REDIRECT, cookie)
    database.close()


def test_an_address_that_nobody_verified_gives_no_role_and_no_name(
    forger: FakeProvider, tmp_path: Path
) -> None:
    database = Database(default_url(tmp_path))
    grants = (("boss@shop.example", Grant("release")), ("*", Grant("view")))
    told = OidcSettings(forger.issuer, "tandem", SECRET, grants, claim="email")
    log_in = LogIn(database, Auth(database), told)
    for verified, role, name in ((False, "view", "7"), (True, "release", "boss@shop.example")):
        address, cookie = visit_provider(log_in, forger)
        borrowed = {"email": "boss@shop.example", "preferred_username": "boss@shop.example"}
        forger.claims |= {**borrowed, "email_verified": verified}
        who, _ = log_in.finish(address, REDIRECT, cookie)
        assert (who.role, who.name) == (role, name)
    database.close()


def test_who_has_lost_his_role_has_no_session_left(log_in: LogIn, forger: FakeProvider) -> None:
    address, cookie = visit_provider(log_in, forger)
    who, _ = log_in.finish(address, REDIRECT, cookie)
    session, _ = log_in._auth.open_session(who)
    assert log_in._auth.authenticate_session(session).token == who.token
    address, cookie = visit_provider(log_in, forger)
    forger.claims["groups"] = []
    with pytest.raises(RefusedError):
        log_in.finish(address, REDIRECT, cookie)
    with pytest.raises(RefusedError):
        log_in._auth.authenticate_session(session)


def test_keys_that_were_changed_are_asked_for(
    log_in: LogIn, forger: FakeProvider, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(oidc, "RETRY_AFTER_FAILURE_S", 0.0)
    address, cookie = visit_provider(log_in, forger)
    log_in.finish(address, REDIRECT, cookie)
    new = RSAKey.generate_key(2048, {"kid": "two"})
    address, cookie = visit_provider(log_in, forger)
    monkeypatch.setattr(f"{__name__}.KEY", new)
    forger.token = lambda claims: sign_token(claims, new, kid="two")
    assert log_in.finish(address, REDIRECT, cookie)[0].role == "plan"


def test_a_provider_that_hangs_costs_log_ins_alone(tmp_path: Path) -> None:
    """Only a few requests to it run at once, with pauses; the service answers others meanwhile."""
    silent = socket.socket()
    silent.bind((BASE_URL.removeprefix("http://"), 0))
    silent.listen(64)
    account = OidcSettings(f"{BASE_URL}:{silent.getsockname()[1]}", "tandem", SECRET, GRANTS)
    with InProcess(tmp_path / "data", examiners=1, oidc=account) as running_service:
        running_service.service.failures = RateLimiter(None)
        before = oidc.PROVIDER_TIMEOUT_S
        oidc.PROVIDER_TIMEOUT_S = 2.0  # type: ignore[misc]
        try:
            with ThreadPoolExecutor(30) as pool:
                futures = [
                    pool.submit(running_service.http.get, "/ui/oidc/login", follow_redirects=False)
                    for _ in range(30)
                ]
                begun = time.monotonic()
                assert running_service.http.get("/v1/jobs").status_code == 401
                assert time.monotonic() - begun < 2.0
                statuses = {item.result().status_code for item in futures}
            assert statuses == {502, 503}
            begun = time.monotonic()
            assert running_service.http.get("/ui/oidc/login").status_code == 502
            assert time.monotonic() - begun < 1.0
        finally:
            oidc.PROVIDER_TIMEOUT_S = before  # type: ignore[misc]
            silent.close()


def test_log_ins_of_one_address_come_at_a_limited_rate(tmp_path: Path) -> None:
    account = OidcSettings(f"{BASE_URL}:9", "tandem", SECRET, GRANTS)
    with InProcess(tmp_path / "data", examiners=1, oidc=account) as running_service:
        assert {running_service.http.get("/ui/oidc/login").status_code for _ in range(14)} == {502, 429}
