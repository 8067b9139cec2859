"""Addresses that a token with a scope may use.

A scope is narrower than the role of the token. A new address is closed to such tokens until it is listed
here. What an address returns to whom is decided at the address.
"""

from collections.abc import Mapping
from typing import Final

from planner.issues import Issue
from planner.service.models import MAX_TAG_LENGTH, TokenRole, TokenScope

ROLE_OF: Final[Mapping[TokenScope, TokenRole]] = {"submit": "plan", "released": "view"}
"""Role of tokens with each scope."""
_ALL_SCOPES: Final = frozenset({"GET /v1/session", "POST /v1/session"})
_READ_ADDRESSES: Final = frozenset(
    {
        "GET /v1/jobs",
        "GET /v1/jobs/{job}",
        "GET /v1/jobs/{job}/files",
        "GET /v1/jobs/{job}/files/{name:path}",
        "GET /v1/jobs/{job}/programs.zip",
        "GET /v1/jobs/{job}/releases",
    }
)
_SUBMIT_ADDRESSES: Final = frozenset(
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
PERMITTED_ADDRESSES: Final[Mapping[TokenScope, frozenset[str]]] = {
    "submit": _ALL_SCOPES | _READ_ADDRESSES | _SUBMIT_ADDRESSES,
    "released": _ALL_SCOPES | _READ_ADDRESSES,
}
"""Methods and addresses that each scope permits."""


def scope_issue(role: TokenRole, team: str | None, scope: TokenScope | None, tag: str | None) -> Issue | None:
    """Return what is inconsistent in a new token with a scope, or None.

    Args:
        role: Role.
        team: Team.
        scope: Scope, or None.
        tag: Tag of the scope, or None.
    """
    if scope is not None and role != ROLE_OF[scope]:
        problem = f"role: does not fit scope {scope} (got {role}, allowed {ROLE_OF[scope]}). Leave it out."
        return Issue("service.token", problem, field="role")
    if scope == "released" and team is None:
        problem = "team: is missing, and the scope released sees nothing without one. Give the team"
        return Issue("service.token", f"{problem} whose released programs the token reads.", field="team")
    if tag is not None and scope != "released":
        problem = "tag: requires the scope released, which it limits to jobs with this tag. Leave it out"
        return Issue("service.token", f"{problem}, or give --scope released.", field="tag")
    if tag is not None and not 1 <= len(tag) <= MAX_TAG_LENGTH:
        problem = (
            f"tag: wrong length (got {len(tag)} characters, allowed 1 to {MAX_TAG_LENGTH}). Shorten the tag."
        )
        return Issue("service.token", problem, field="tag")
    return None


def is_permitted(scope: TokenScope, method: str, path: str) -> bool:
    """Report whether a scope permits a request. HEAD is permitted where GET is.

    Args:
        scope: Scope.
        method: HTTP method.
        path: Address as the route states it.
    """
    return f"{'GET' if method == 'HEAD' else method} {path}" in PERMITTED_ADDRESSES[scope]
