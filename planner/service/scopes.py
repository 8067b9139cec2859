"""What a token with a scope may ask: the addresses that are named here, and no other.

A scope is narrower than the role that it has. A new address is closed to tokens with a scope until somebody
names it; what an address shows to whom stands with the address.
"""

from collections.abc import Mapping
from typing import Final

from planner.issues import Issue
from planner.service.models import LONGEST_TAG, TokenRole, TokenScope

ROLE_OF: Final[Mapping[TokenScope, TokenRole]] = {"submit": "plan", "released": "view"}
"""The role that a token of each scope has."""
_ALL: Final = frozenset({"GET /v1/session", "POST /v1/session"})
_READ: Final = frozenset(
    {
        "GET /v1/jobs",
        "GET /v1/jobs/{job}",
        "GET /v1/jobs/{job}/files",
        "GET /v1/jobs/{job}/files/{name:path}",
        "GET /v1/jobs/{job}/programs.zip",
        "GET /v1/jobs/{job}/releases",
    }
)
_SEND: Final = frozenset(
    {
        "POST /v1/jobs",
        "POST /v1/check",
        "GET /v1/jobs/{job}/events",
        "GET /v1/jobs/{job}/estimate",
        "GET /v1/storage",
        "GET /v1/processes",
        "GET /v1/processes/{name}/schema",
        "GET /v1/schema",
        "GET /v1/catalogue/{kind}",
        "GET /v1/issues",
    }
)
OPEN_TO: Final[Mapping[TokenScope, frozenset[str]]] = {
    "submit": _ALL | _READ | _SEND,
    "released": _ALL | _READ,
}
"""Method and address of what a token of each scope may ask."""


def scope_fault(role: TokenRole, team: str | None, scope: TokenScope | None, tag: str | None) -> Issue | None:
    """What of a new token does not go with its scope."""
    if scope is not None and role != ROLE_OF[scope]:
        what = f"role: got {role}, a token with the scope {scope} has the role {ROLE_OF[scope]}; leave it out"
        return Issue("service.token", what, field="role")
    if scope == "released" and team is None:
        what = "team: is missing, and without one the scope released sees nothing; give the team"
        return Issue("service.token", f"{what} whose released programs it reads", field="team")
    if tag is not None and scope != "released":
        what = "tag: goes with the scope released alone, which then has jobs with this tag; leave it out"
        return Issue("service.token", f"{what}, or give --scope released", field="tag")
    if tag is not None and not 1 <= len(tag) <= LONGEST_TAG:
        what = f"tag: got {len(tag)} characters, tags of jobs have 1 to {LONGEST_TAG}; give one of theirs"
        return Issue("service.token", what, field="tag")
    return None


def is_open(scope: TokenScope, method: str, path: str) -> bool:
    """Whether a token of that scope may send ``method`` to the address of a route, as the route names it;
    HEAD where it may GET."""
    return f"{'GET' if method == 'HEAD' else method} {path}" in OPEN_TO[scope]
