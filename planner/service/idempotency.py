"""Idempotency keys: a request that is sent again returns the jobs that the first one created.

A client may send a request again because the answer was lost. If it sends the header ``Idempotency-Key``,
the service creates the jobs only once.

A key belongs to the owner that sent it. The store keeps it with a hash of the request content as it was
parsed, because the boundary of a multipart form differs each time. Rows are written in the transaction that
creates the jobs, so that both exist or neither. A key is deleted with the last of its jobs, or by age.

The header is an Internet-Draft of the IETF, draft-ietf-httpapi-idempotency-key-header. Its value is used as
it is, quoted or not.
"""

import dataclasses
import hashlib
import json
import re
from collections.abc import Sequence
from typing import Any, Final

from sqlalchemy import Connection, delete, insert, select

from planner.issues import Issue
from planner.service.models import CANCELLED, JOBS, KEYS, Database
from planner.service.security import RefusedError

HEADER: Final = "Idempotency-Key"
"""Name of the header."""
MAX_KEY_LENGTH: Final = 255
"""Maximum number of characters of a key."""
MIN_KEY_AGE_S: Final = 86400.0
"""Minimum time [s] for which a key is kept if its jobs are."""
_KEY: Final = re.compile(rf"[\x21-\x7e]{{1,{MAX_KEY_LENGTH}}}")
"""A key: printable ASCII without spaces."""


@dataclasses.dataclass(frozen=True)
class IdempotencyKey:
    """Idempotency key of a request.

    Attributes:
        owner: Token that sent it.
        key: SHA-256 of the header's value.
        content: SHA-256 of the request content.
    """

    owner: str
    key: str
    content: str


def checked_header(keys: Sequence[str]) -> str | None:
    """Return the key of a request, or None if the header is missing.

    Args:
        keys: Values of all headers ``Idempotency-Key``.

    Raises:
        RefusedError: 422, there are several keys, or the key is invalid.
    """
    if not keys:
        return None
    if len(keys) > 1 or not _KEY.fullmatch(keys[0]):
        got = f"{len(keys)} keys" if len(keys) > 1 else f"{keys[0][:40]!r} of {len(keys[0])} characters"
        message = (
            f"invalid (got {got}, allowed one key of 1 to {MAX_KEY_LENGTH} printable ASCII characters "
            "without spaces). Send a UUID, for example."
        )
        raise RefusedError(422, Issue("service.idempotency", f"{HEADER}: {message}", field=HEADER))
    return keys[0]


def hashed_key(owner: str, key: str | None, route: str, *parts: Any) -> IdempotencyKey | None:
    """Combine a key with the content of its request. Returns None without a key.

    Args:
        owner: Token.
        key: Value of the header, or None.
        route: Route of the request.
        parts: All other plain data that the answer depends on.
    """
    if key is None:
        return None
    content = json.dumps([route, *parts], sort_keys=True)
    return IdempotencyKey(owner, _sha(key), _sha(content))


def earlier_jobs(db: Connection, key: IdempotencyKey) -> list[str]:
    """Return the jobs that an earlier request with the key created, in its order, without deleted ones.

    Args:
        db: Database connection.
        key: Idempotency key.

    Raises:
        RefusedError: 422, the key was sent with another content.
    """
    query = (
        select(KEYS.c.job, KEYS.c.content)
        .join_from(KEYS, JOBS, KEYS.c.job == JOBS.c.id)
        .where(KEYS.c.owner == key.owner, KEYS.c.hash == key.key, JOBS.c.cancel <= CANCELLED)
        .order_by(KEYS.c.number)
    )
    rows = db.execute(query).all()
    if any(row.content != key.content for row in rows):
        message = "was already used for another request. Repeat that request unchanged, or send another key."
        raise RefusedError(422, Issue("service.idempotency", f"{HEADER}: {message}", field=HEADER))
    return [row.job for row in rows]


def record_jobs(database: Database, db: Connection, key: IdempotencyKey, jobs: Sequence[str]) -> None:
    """Record the jobs that a request created. They replace those of an expired or deleted earlier request.

    Args:
        database: Database.
        db: Open write transaction.
        key: Idempotency key.
        jobs: Ids of the jobs, in the order of the answer.
    """
    db.execute(delete(KEYS).where(KEYS.c.owner == key.owner, KEYS.c.hash == key.key))
    for number, job in enumerate(jobs):
        row = {"owner": key.owner, "hash": key.key, "number": number, "job": job}
        db.execute(insert(KEYS).values(**row, content=key.content, created=database.clock()))


def delete_old_keys(database: Database, db: Connection) -> None:
    """Delete keys that are older than `MIN_KEY_AGE_S`.

    Args:
        database: Database.
        db: Open write transaction.
    """
    db.execute(delete(KEYS).where(KEYS.c.created < database.clock() - MIN_KEY_AGE_S))


def _sha(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
