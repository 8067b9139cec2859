"""Webhooks: addresses that are told when a job has ended.

What is to be told is written in the transaction that ends the job, so a crash loses none of it, and is sent
by any host until it is answered by 2xx: an address may be told the same thing twice, by the same
``webhook-id``. Form, headers and signature are those of Standard Webhooks 1.0 (standardwebhooks.com). An
address is one of a host that the operator has named; redirections are not followed.
"""

import base64
import contextlib
import dataclasses
import datetime as dt
import hashlib
import hmac
import http.client
import json
import logging
import re
import secrets
import socket
import ssl
import threading
import time
from collections.abc import Callable, Collection
from typing import Any, Final
from urllib.parse import SplitResult, urlsplit

from sqlalchemy import ColumnElement, Connection, RowMapping, and_, delete, func, insert, or_, select, update
from sqlalchemy.exc import SQLAlchemyError

from planner.issues import Issue
from planner.service.models import DELIVERIES, JOBS, TOKENS, WEBHOOKS, Database
from planner.service.security import LOCAL, RefusedError, in_clear, too_many

LOG: Final = logging.getLogger("planner.service")
"""Log of the service."""
SECRET_PREFIX: Final = "whsec_"
"""What a secret of Standard Webhooks begins with; base64 follows."""
SECRET_BYTES: Final = 32
"""Length of a secret; Standard Webhooks asks for 24 to 64."""
AGAIN_S: Final = (5.0, 300.0, 1800.0, 7200.0, 18000.0, 36000.0, 50400.0, 72000.0)
"""Waiting times [s] behind each attempt that failed, as Standard Webhooks proposes them: 52 hours in all."""
LATEST_S: Final = 1.1 * AGAIN_S[-1]
"""Nothing is due later than in so long [s]."""
ANSWER_S: Final = 15.0
"""Time [s] in which an address has to answer."""
HELD_S: Final = 90.0
"""Another host sends what a host has held for so long [s] without telling how it went."""
LOOK_S: Final = 1.0
"""What is due is looked for so often [s]."""
AT_ONCE: Final = 4
"""Addresses that are told at once, one of each owner at most: one that is slow keeps no other owner
waiting."""
FORGOTTEN_S: Final = 3 * 86400.0
"""What is due for so long [s] is told no more."""
MOST: Final = 10
"""Webhooks of one owner."""
USUAL_PORTS: Final = {"https": 443, "http": 80}
"""Ports of addresses that name none."""
NUMBER: Final = re.compile(r"[0-9a-f]{32}")
"""A webhook's identifier."""
LONGEST_URL: Final = 500
"""Characters of an address at most."""
GONE: Final = 410
"""The answer of an address that is not to be told anything any more."""


@dataclasses.dataclass(frozen=True)
class Due:
    """Something to be told: ``id`` is told too, ``body`` is sent as it stands; ``attempt`` counts from 1."""

    id: str
    webhook: str
    owner: str
    url: str
    secret: str
    body: str
    attempt: int


def checked(url: str, hosts: Collection[str]) -> SplitResult:
    """An address that may be told. ``hosts``: those that the operator has named, in lower case, each by
    itself for the usual port, or as ``HOST:PORT`` for another one.

    Raises :class:`RefusedError`, 422.
    """
    try:
        parts = urlsplit(url)
        host, port = (parts.hostname or "").lower(), parts.port
    except ValueError:
        raise refused(f"{url[:80]!r} is no address; give https://HOST/PATH") from None
    if not hosts:
        raise refused("this service tells no addresses; ask its operator for --webhook-host")
    if len(url) > LONGEST_URL or not url.isascii() or not url.isprintable() or " " in url:
        raise refused(f"its url may have {LONGEST_URL} characters at most, printable ASCII without spaces")
    if in_clear(parts):
        raise refused(f"{parts.scheme or 'no scheme'} is not taken; give https://HOST/PATH")
    if parts.username is not None or parts.password is not None or parts.fragment:
        raise refused("its url has a user, a password or a fragment; leave them out: requests are signed")
    there = host if port in (None, USUAL_PORTS[parts.scheme]) else f"{host}:{port}"
    if there not in hosts:
        allowed = ", ".join(sorted(hosts))
        raise refused(f"host {there[:80]!r} is none that this service tells; allowed: {allowed}")
    return parts


def refused(why: str, status: int = 422) -> RefusedError:
    """422, or another status."""
    return RefusedError(status, Issue("service.webhook", f"webhook: {why}", field="url"))


def record_end(db: Connection, job: str, state: str) -> None:
    """In the transaction that ends a job: its owner's webhooks are to be told."""
    query = select(JOBS.c.owner, JOBS.c.name, JOBS.c.digest).where(JOBS.c.id == job)
    row = db.execute(query).mappings().one()
    asked = select(WEBHOOKS.c.id).where(WEBHOOKS.c.owner == row["owner"], WEBHOOKS.c.off.is_(None))
    data = {"id": job, "name": row["name"], "digest": row["digest"], "state": state}
    for webhook in db.execute(asked).scalars().all():
        _put(db, webhook, "job.ended", data)


def _put(db: Connection, webhook: str, kind: str, data: dict[str, Any]) -> None:
    now = time.time()
    stamp = dt.datetime.fromtimestamp(now, dt.UTC).isoformat().replace("+00:00", "Z")
    body = json.dumps({"type": kind, "timestamp": stamp, "data": data})
    row = {"id": f"msg_{secrets.token_hex(16)}", "webhook": webhook, "body": body, "due": now, "attempts": 0}
    db.execute(insert(DELIVERIES).values(row))


def _is_due(now: ColumnElement[float]) -> ColumnElement[bool]:
    """What is due later than anything may be was put in by a clock that has been set back since."""
    return or_(DELIVERIES.c.due <= now, DELIVERIES.c.due > now + LATEST_S)


def forget(database: Database, db: Connection) -> None:
    """Drop what nobody has sent for long: no host of this store tells addresses, or the token was revoked."""
    db.execute(delete(DELIVERIES).where(DELIVERIES.c.due < database.clock() - FORGOTTEN_S))


def signature(secret: str, number: str, seconds: int, body: str) -> str:
    """The header ``webhook-signature``: HMAC-SHA256 over identifier, time and body, as of Standard Webhooks
    1.0."""
    key = base64.b64decode(secret.removeprefix(SECRET_PREFIX))
    signed = hmac.new(key, f"{number}.{seconds}.{body}".encode(), hashlib.sha256).digest()
    return f"v1,{base64.b64encode(signed).decode()}"


class Webhooks:
    """The webhooks of one database; ``hosts`` may be told."""

    def __init__(self, database: Database, hosts: Collection[str]) -> None:
        self._database = database
        self.hosts = frozenset(host.lower() for host in hosts)

    def add(self, owner: str, url: str) -> RowMapping:
        """A new webhook with its secret, which is told this once. Raises :class:`RefusedError`, 422 or
        429."""
        checked(url, self.hosts)
        number = secrets.token_hex(16)
        secret = SECRET_PREFIX + base64.b64encode(secrets.token_bytes(SECRET_BYTES)).decode()
        row = {"id": number, "owner": owner, "url": url, "secret": secret, "created": time.time()}
        with self._database.write() as db:
            self._database.one_at_a_time(db, f"webhooks {owner}")
            mine = select(func.count()).select_from(WEBHOOKS).where(WEBHOOKS.c.owner == owner)
            if db.execute(mine).scalar_one() >= MOST:
                what = f"there are {MOST} webhooks of this token, as many as may be; delete one"
                raise too_many(what, 60, MOST)
            db.execute(insert(WEBHOOKS).values(row))
            return db.execute(select(WEBHOOKS).where(WEBHOOKS.c.id == number)).mappings().one()

    def list(self, owner: str) -> list[RowMapping]:
        """The owner's webhooks, the oldest first, each with how many things are ``waiting``."""
        left = select(func.count()).where(DELIVERIES.c.webhook == WEBHOOKS.c.id)
        waiting = left.scalar_subquery().label("waiting")
        query = select(WEBHOOKS, waiting).where(WEBHOOKS.c.owner == owner).order_by(WEBHOOKS.c.created)
        with self._database.read() as db:
            return list(db.execute(query).mappings())

    def remove(self, owner: str, number: str) -> None:
        """Delete a webhook, with what it was still to be told. Raises :class:`RefusedError`, 404."""
        with self._database.write() as db:
            self._own(db, owner, number)
            db.execute(delete(DELIVERIES).where(DELIVERIES.c.webhook == number))
            db.execute(delete(WEBHOOKS).where(WEBHOOKS.c.id == number))

    def ping(self, owner: str, number: str) -> None:
        """Let a webhook be told that it is one; it is on again. Raises :class:`RefusedError`, 404."""
        with self._database.write() as db:
            self._own(db, owner, number)
            db.execute(update(WEBHOOKS).where(WEBHOOKS.c.id == number).values(off=None))
            _put(db, number, "ping", {})

    def _own(self, db: Connection, owner: str, number: str) -> None:
        if not NUMBER.fullmatch(number):
            raise refused(f"{number[:40]!r}: there is none; list them", 404)
        own = select(WEBHOOKS.c.id).where(WEBHOOKS.c.id == number, WEBHOOKS.c.owner == owner)
        if db.execute(own).first() is None:
            raise refused(f"{number[:40]!r}: there is none; list them", 404)

    def claim(self, busy: Collection[str]) -> Due | None:
        """The next thing that is due of an owner who is not ``busy``, held by this host for a while."""
        now = self._database.clock()
        lasting = or_(TOKENS.c.expires.is_(None), TOKENS.c.expires > now)
        in_force = select(TOKENS.c.id).where(TOKENS.c.revoked.is_(None), lasting)
        query = (
            select(DELIVERIES, WEBHOOKS.c.owner, WEBHOOKS.c.url, WEBHOOKS.c.secret)
            .join(WEBHOOKS, WEBHOOKS.c.id == DELIVERIES.c.webhook)
            .where(
                and_(
                    _is_due(now),
                    WEBHOOKS.c.off.is_(None),
                    WEBHOOKS.c.owner.not_in(busy),
                    or_(WEBHOOKS.c.owner == LOCAL, WEBHOOKS.c.owner.in_(in_force)),
                )
            )
            .order_by(DELIVERIES.c.due, DELIVERIES.c.id)
            .limit(1)
            .with_for_update(of=DELIVERIES, skip_locked=True)
        )
        with self._database.read() as db:  # most looks find nothing, and readers keep no writer waiting
            if db.execute(select(DELIVERIES.c.id).where(_is_due(now)).limit(1)).first() is None:
                return None
        with self._database.write() as db:
            row = db.execute(query).mappings().first()
            if row is None:
                return None
            attempt = row["attempts"] + 1
            held = {"due": now + HELD_S, "attempts": attempt}
            db.execute(update(DELIVERIES).where(DELIVERIES.c.id == row["id"]).values(held))
        told = (row["id"], row["webhook"], row["owner"], row["url"], row["secret"], row["body"])
        return Due(*told, attempt)

    def sent(self, due: Due, status: int | None, why: str) -> None:
        """How an attempt went: the ``status`` that was answered, or None and ``why`` there was none."""
        good = status is not None and 200 <= status < 300
        last = good or due.attempt > len(AGAIN_S)
        told = {"told": time.time(), "outcome": f"{status}" if status is not None else why[:200]}
        if status == GONE:
            told["off"] = told["told"]
        with self._database.write() as db:
            db.execute(update(WEBHOOKS).where(WEBHOOKS.c.id == due.webhook).values(told))
            own = and_(DELIVERIES.c.id == due.id, DELIVERIES.c.attempts == due.attempt)
            if last or status == GONE:
                db.execute(delete(DELIVERIES).where(own))
            else:
                later = self._database.clock() + AGAIN_S[due.attempt - 1]
                db.execute(update(DELIVERIES).where(own).values(due=later))


def post(due: Due, hosts: Collection[str]) -> tuple[int | None, str]:
    """Send it once: the status that was answered, or None and why there was none."""
    try:
        parts = checked(due.url, hosts)
        seconds = int(time.time())
        headers = {
            "Content-Type": "application/json",
            "User-Agent": "tandem",
            "webhook-id": due.id,
            "webhook-timestamp": str(seconds),
            "webhook-signature": signature(due.secret, due.id, seconds, due.body),
        }
        until = time.monotonic() + ANSWER_S
        link = http.client.HTTPConnection(parts.netloc, timeout=ANSWER_S)
        link.sock = _reached(parts, until)
        over = threading.Event()
        # a socket's own limit is one for each piece
        ending = threading.Timer(max(until - time.monotonic(), 0.0), _cut, (link, over))
        ending.daemon = True
        ending.start()
        try:
            if isinstance(link.sock, ssl.SSLSocket):
                link.sock.do_handshake()
            way = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
            link.request("POST", way, due.body.encode(), headers)
            status = link.getresponse().status
            if over.is_set():  # a head that was cut off reads as one that ended
                raise TimeoutError
            return status, ""
        finally:
            ending.cancel()
            link.close()
    except RefusedError as no_longer:
        return None, str(no_longer)
    except (OSError, ValueError, http.client.HTTPException) as error:
        LOG.info("webhook %s: no answer: %s", due.webhook, type(error).__name__)
        return None, "no answer"


def _reached(parts: SplitResult, until: float) -> socket.socket:
    """A connection to an address, by the first of its host's that answers before ``until`` [s] by the
    monotonic clock; with TLS, whose handshake is still to be made, where it asks for that. Raises
    ``OSError``."""
    host, port = parts.hostname or "", parts.port or USUAL_PORTS[parts.scheme]
    last: OSError = TimeoutError("no address answered in time")
    for family, kind, proto, _, address in socket.getaddrinfo(host, port, type=socket.SOCK_STREAM):
        if (left := until - time.monotonic()) <= 0.0:
            break
        link = socket.socket(family, kind, proto)
        try:
            link.settimeout(left)
            link.connect(address)
        except OSError as error:
            link.close()
            last = error
            continue
        if parts.scheme != "https":
            return link
        context = ssl.create_default_context()
        return context.wrap_socket(link, server_hostname=host, do_handshake_on_connect=False)
    raise last


def _cut(link: http.client.HTTPConnection, over: threading.Event) -> None:
    over.set()
    with contextlib.suppress(OSError):
        if link.sock is not None:
            link.sock.shutdown(socket.SHUT_RDWR)


Post = Callable[[Due, Collection[str]], tuple[int | None, str]]
"""What sends: the status, or None and why there was none."""


class Sender(threading.Thread):
    """Sends what is due, on each host."""

    def __init__(self, webhooks: Webhooks, send: Post = post) -> None:
        super().__init__(name="tandem-webhooks", daemon=True)
        self._webhooks, self._send = webhooks, send
        self._ending = threading.Event()
        self._lock = threading.Lock()
        self._busy: set[str] = set()

    def stop(self) -> None:
        """Send nothing more; what is under way is sent again if it is not answered."""
        self._ending.set()
        if self.is_alive():
            self.join(LOOK_S + 5.0)

    def run(self) -> None:
        """Until :meth:`stop`."""
        if not self._webhooks.hosts:
            return
        while not self._ending.wait(LOOK_S):
            try:
                while not self._ending.is_set() and len(self._busy) < AT_ONCE:
                    with self._lock:
                        busy = frozenset(self._busy)
                    due = self._webhooks.claim(busy)
                    if due is None:
                        break
                    with self._lock:
                        self._busy.add(due.owner)
                    threading.Thread(target=self._tell, args=(due,), daemon=True).start()
            except SQLAlchemyError:
                LOG.exception("webhooks wait for the database")

    def _tell(self, due: Due) -> None:
        try:
            status, why = self._send(due, self._webhooks.hosts)
            self._webhooks.sent(due, status, why)
            LOG.info("webhook %s: %s", due.webhook, status if status is not None else why)
        except SQLAlchemyError:
            LOG.exception("webhook %s is told again", due.webhook)
        finally:
            with self._lock:
                self._busy.discard(due.owner)
