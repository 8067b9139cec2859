"""Requests that are sent again, for instance because an answer was lost on its way: who sends the header
``Idempotency-Key`` with a request that makes jobs gets the jobs that the first such request made.

A key belongs to the owner that sent it. With it the store keeps a hash of what was asked, made of the parts
as they were read: the boundary of a form is another one each time. Rows are written in the transaction that
makes the jobs, so that there are both or neither. A key goes with the last of its jobs, or by age.

The header is an Internet-Draft of the IETF, draft-ietf-httpapi-idempotency-key-header; its value is taken as
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
LONGEST: Final = 255
"""Characters that a key may have."""
KEPT_S: Final = 86400.0
"""Time [s] for which a key is kept at least, if its jobs are."""
_KEY: Final = re.compile(rf"[\x21-\x7e]{{1,{LONGEST}}}")
"""A key: printable ASCII without spaces."""


@dataclasses.dataclass(frozen=True)
class Once:
    """A request of ``owner`` that is to be done once: SHA-256 of its key, and of its content."""

    owner: str
    key: str
    content: str


def checked(keys: Sequence[str]) -> str | None:
    """The key of a request by its headers of that name; None where there is none. Raises
    :class:`RefusedError`, 422."""
    if not keys:
        return None
    if len(keys) > 1 or not _KEY.fullmatch(keys[0]):
        got = f"{len(keys)} keys" if len(keys) > 1 else f"{keys[0][:40]!r} of {len(keys[0])} characters"
        what = f"got {got}; send one of 1 to {LONGEST} printable ASCII characters without spaces, a UUID say"
        raise RefusedError(422, Issue("service.idempotency", f"{HEADER}: {what}", field=HEADER))
    return keys[0]


def once(owner: str, key: str | None, route: str, *parts: Any) -> Once | None:
    """What is to be done once: ``route`` and ``parts`` (plain data) are all that the answer depends on. None
    without a key."""
    if key is None:
        return None
    content = json.dumps([route, *parts], sort_keys=True)
    return Once(owner, _sha(key), _sha(content))


def made(db: Connection, asked: Once) -> list[str]:
    """The jobs that the first such request made, in its order, without those that were deleted since; empty
    where there are none. Raises :class:`RefusedError`, 422, where the key came with another content."""
    query = (
        select(KEYS.c.job, KEYS.c.content)
        .join_from(KEYS, JOBS, KEYS.c.job == JOBS.c.id)
        .where(KEYS.c.owner == asked.owner, KEYS.c.hash == asked.key, JOBS.c.cancel <= CANCELLED)
        .order_by(KEYS.c.number)
    )
    rows = db.execute(query).all()
    if any(row.content != asked.content for row in rows):
        what = "this key was sent with another request before; send that one again as it was, or another key"
        raise RefusedError(422, Issue("service.idempotency", f"{HEADER}: {what}", field=HEADER))
    return [row.job for row in rows]


def keep(database: Database, db: Connection, asked: Once, jobs: Sequence[str]) -> None:
    """Write down which jobs a request made."""
    db.execute(delete(KEYS).where(KEYS.c.owner == asked.owner, KEYS.c.hash == asked.key))
    for number, job in enumerate(jobs):
        row = {"owner": asked.owner, "hash": asked.key, "number": number, "job": job}
        db.execute(insert(KEYS).values(**row, content=asked.content, created=database.clock()))


def forget(database: Database, db: Connection) -> None:
    """Remove keys that are old enough."""
    db.execute(delete(KEYS).where(KEYS.c.created < database.clock() - KEPT_S))


def _sha(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
