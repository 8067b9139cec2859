"""Who asks: tokens, of which only the hash is kept, and the cookies of browsers that showed one."""

from __future__ import annotations

import dataclasses
import hashlib
import hmac
import re
import secrets
import time
from typing import Final

from sqlalchemy import delete, func, insert, select, update
from sqlalchemy.exc import IntegrityError

from planner.issues import Issue, TandemError
from planner.service.database import Database
from planner.service.refusals import RefusedError
from planner.service.tables import SESSIONS, TOKENS

LOCAL: Final = "local"
"""The owner of jobs that came without a token, over loopback."""
SESSION_S: Final = 30 * 86400.0
_TOKEN: Final = re.compile(r"tandem_([0-9a-f]{16})_[A-Za-z0-9_-]{43}")
_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.@-]{0,63}")


@dataclasses.dataclass(frozen=True)
class TokenInfo:
    """A token without its secret; times are seconds since 1970."""

    name: str
    created: float
    revoked: float | None


class Auth:
    """The tokens and sessions of one database."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def make(self, name: str) -> str:
        """A new token, which is told this once. Raises ``TandemError`` for a name that is taken or odd."""
        if not _NAME.fullmatch(name):
            raise TandemError(_bad_name(name, "use letters, digits and _ . @ -, at most 64"))
        number = secrets.token_hex(8)
        token = f"tandem_{number}_{secrets.token_urlsafe(32)}"
        row = {"id": number, "name": name, "hash": _hash(token), "created": time.time()}
        try:
            with self._database.write() as db:
                db.execute(insert(TOKENS).values(row))
        except IntegrityError as error:
            raise TandemError(_bad_name(name, "there is a token of that name; choose another")) from error
        return token

    def list(self) -> tuple[TokenInfo, ...]:
        """All tokens, the oldest first."""
        with self._database.read() as db:
            rows = db.execute(select(TOKENS).order_by(TOKENS.c.created)).mappings()
            return tuple(TokenInfo(row["name"], row["created"], row["revoked"]) for row in rows)

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
            alive = select(func.count()).select_from(TOKENS).where(TOKENS.c.revoked.is_(None))
            return bool(db.execute(alive).scalar_one())

    def owner(self, token: str) -> str:
        """Whose token it is; raises :class:`RefusedError`, 401."""
        found = _TOKEN.fullmatch(token)
        kept, revoked = "", None
        if found:
            with self._database.read() as db:
                row = db.execute(select(TOKENS).where(TOKENS.c.id == found[1])).mappings().first()
            if row is not None:
                kept, revoked = row["hash"], row["revoked"]
        if not hmac.compare_digest(kept, _hash(token)) or found is None or revoked is not None:
            raise unauthorised("the token is unknown or was revoked; ask for a new one")
        return found[1]

    def open_session(self, owner: str) -> str:
        """A cookie for a browser whose user showed the owner's token."""
        cookie = secrets.token_urlsafe(32)
        row = {"hash": _hash(cookie), "token": owner, "expires": time.time() + SESSION_S}
        with self._database.write() as db:
            db.execute(insert(SESSIONS).values(row))
        return cookie

    def session(self, cookie: str) -> str:
        """Whose cookie it is; raises :class:`RefusedError`, 401."""
        query = (
            select(SESSIONS)
            .join(TOKENS, TOKENS.c.id == SESSIONS.c.token)
            .where(SESSIONS.c.hash == _hash(cookie), TOKENS.c.revoked.is_(None))
        )
        with self._database.read() as db:
            row = db.execute(query).mappings().first()
        if row is None or row["expires"] < time.time():
            raise unauthorised("the session is over; show the token again")
        return str(row["token"])

    def close_session(self, cookie: str) -> None:
        """End a session."""
        with self._database.write() as db:
            db.execute(delete(SESSIONS).where(SESSIONS.c.hash == _hash(cookie)))


def unauthorised(why: str) -> RefusedError:
    """401."""
    return RefusedError(
        401, Issue("service.token", why, field="Authorization"), {"WWW-Authenticate": "Bearer"}
    )


def _hash(secret: str) -> str:
    """SHA-256 is enough for a secret of 256 random bits: there is nothing to guess."""
    return hashlib.sha256(secret.encode("utf-8", "surrogatepass")).hexdigest()


def _bad_name(name: str, what: str) -> Issue:
    return Issue("service.token", f"token {name[:80]!r}: {what}", field="name")
