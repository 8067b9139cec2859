"""Webhooks: notifications when a job has ended.

A notification is written in the transaction that ends the job, so that a crash loses none. Any host sends
it until the address answers 2xx. An address may therefore receive the same notification twice, with the
same ``webhook-id``. Form, headers and signature are those of Standard Webhooks 1.0 (standardwebhooks.com).
The operator must have allowed the host of the address. Redirects are not followed.
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

from planner.issue_codes import format_message
from planner.issues import Issue
from planner.service.models import DELIVERIES, JOBS, TOKENS, WEBHOOKS, Database
from planner.service.security import LOCAL, RefusedError, is_unencrypted, too_many

LOG: Final = logging.getLogger("planner.service")
"""Log of the service."""
SECRET_PREFIX: Final = "whsec_"
"""Prefix of a secret of Standard Webhooks. Base64 follows."""
SECRET_BYTES: Final = 32
"""Length [bytes] of a secret. Standard Webhooks requires 24 to 64."""
RETRY_WAITS_S: Final = (5.0, 300.0, 1800.0, 7200.0, 18000.0, 36000.0, 50400.0, 72000.0)
"""Waiting times [s] after failed attempts, as Standard Webhooks proposes: 52 hours in total."""
MAX_DUE_S: Final = 1.1 * RETRY_WAITS_S[-1]
"""Maximum time [s] until a notification is due.

A later one was written by a clock that has been set back.
"""
ANSWER_TIMEOUT_S: Final = 15.0
"""Maximum time [s] of an answer."""
CLAIM_S: Final = 90.0
"""Time [s] for which a host holds a notification. Then another host may send it."""
POLL_S: Final = 1.0
"""Interval [s] of queries for due notifications."""
MAX_CONCURRENT: Final = 4
"""Maximum number of concurrent notifications.

Each owner has at most one, so that a slow address delays no other owner.
"""
MAX_PENDING_AGE_S: Final = 3 * 86400.0
"""Time [s] after which an unsent notification is dropped."""
MAX_WEBHOOKS: Final = 10
"""Maximum number of webhooks of one owner."""
DEFAULT_PORTS: Final = {"https": 443, "http": 80}
"""Default ports."""
WEBHOOK_ID: Final = re.compile(r"[0-9a-f]{32}")
"""Pattern of webhook ids."""
MAX_URL_LENGTH: Final = 500
"""Maximum number of characters of an address."""
GONE_STATUS: Final = 410
"""HTTP status with which an address refuses all further notifications."""


@dataclasses.dataclass(frozen=True)
class DueNotification:
    """A due notification.

    Attributes:
        id: Id of the notification, which is sent too.
        webhook: Id of the webhook.
        owner: Token.
        url: Address.
        secret: Secret of the webhook.
        body: Body, sent unchanged.
        attempt: Number of the attempt, from 1.
    """

    id: str
    webhook: str
    owner: str
    url: str
    secret: str
    body: str
    attempt: int


def check_url(url: str, hosts: Collection[str]) -> SplitResult:
    """Check an address, and return its parts.

    Args:
        url: Address.
        hosts: Allowed hosts in lower case: ``HOST`` for the default port, ``HOST:PORT`` for another one.

    Raises:
        RefusedError: 422.
    """
    try:
        parts = urlsplit(url)
        host, port = (parts.hostname or "").lower(), parts.port
    except ValueError:
        raise webhook_refusal(f"invalid url (got {url[:80]!r}). Give https://HOST/PATH.") from None
    if not hosts:
        raise webhook_refusal("this service allows no hosts. Ask its operator for --webhook-host.")
    if len(url) > MAX_URL_LENGTH or not url.isascii() or not url.isprintable() or " " in url:
        raise webhook_refusal(
            f"invalid url (allowed {MAX_URL_LENGTH} printable ASCII characters without spaces)"
        )
    if is_unencrypted(parts):
        raise webhook_refusal(
            f"unsupported scheme (got {parts.scheme or 'no scheme'}). Give https://HOST/PATH."
        )
    if parts.username is not None or parts.password is not None or parts.fragment:
        raise webhook_refusal(
            "its url has a user, password or fragment. Leave them out, requests are signed."
        )
    host_and_port = host if port in (None, DEFAULT_PORTS[parts.scheme]) else f"{host}:{port}"
    if host_and_port not in hosts:
        allowed_hosts = ", ".join(sorted(hosts))
        raise webhook_refusal(f"host is not allowed (got {host_and_port[:80]!r}, allowed {allowed_hosts})")
    return parts


def webhook_refusal(why: str, status: int = 422) -> RefusedError:
    """Return a refusal with a field ``url``.

    Args:
        why: Message.
        status: HTTP status.
    """
    message = format_message("service.webhook", reason=why)
    return RefusedError(status, Issue("service.webhook", message, field="url"))


def record_end(db: Connection, job: str, state: str) -> None:
    """Record that all enabled webhooks of a job's owner are to be notified of its end.

    This happens in the transaction that ends the job.

    Args:
        db: Open write transaction.
        job: Id of the job.
        state: Final state.
    """
    query = select(JOBS.c.owner, JOBS.c.name, JOBS.c.digest).where(JOBS.c.id == job)
    row = db.execute(query).mappings().one()
    webhook_query = select(WEBHOOKS.c.id).where(WEBHOOKS.c.owner == row["owner"], WEBHOOKS.c.off.is_(None))
    data = {"id": job, "name": row["name"], "digest": row["digest"], "state": state}
    for webhook in db.execute(webhook_query).scalars().all():
        _add_delivery(db, webhook, "job.ended", data)


def _add_delivery(db: Connection, webhook: str, kind: str, data: dict[str, Any]) -> None:
    """Record a notification of a webhook that is due now. ``kind`` is the type of Standard Webhooks."""
    now = time.time()
    timestamp = dt.datetime.fromtimestamp(now, dt.UTC).isoformat().replace("+00:00", "Z")
    body = json.dumps({"type": kind, "timestamp": timestamp, "data": data})
    row = {"id": f"msg_{secrets.token_hex(16)}", "webhook": webhook, "body": body, "due": now, "attempts": 0}
    db.execute(insert(DELIVERIES).values(row))


def _is_due(now: ColumnElement[float]) -> ColumnElement[bool]:
    """Return the condition for due notifications.

    A notification that is due later than is possible was written by a clock that has been set back since.
    """
    return or_(DELIVERIES.c.due <= now, DELIVERIES.c.due > now + MAX_DUE_S)


def drop_old_deliveries(database: Database, db: Connection) -> None:
    """Drop notifications that have been due for longer than `MAX_PENDING_AGE_S`.

    They remain unsent if no host of this store sends webhooks, or if the token was revoked.

    Args:
        database: Database.
        db: Open write transaction.
    """
    db.execute(delete(DELIVERIES).where(DELIVERIES.c.due < database.clock() - MAX_PENDING_AGE_S))


def signature(secret: str, delivery_id: str, seconds: int, body: str) -> str:
    """Return the header ``webhook-signature``: HMAC-SHA256 over id, time and body (Standard Webhooks 1.0).

    Args:
        secret: Secret of the webhook.
        delivery_id: Id of the notification.
        seconds: Time [s since 1970].
        body: Body.
    """
    key = base64.b64decode(secret.removeprefix(SECRET_PREFIX))
    digest = hmac.new(key, f"{delivery_id}.{seconds}.{body}".encode(), hashlib.sha256).digest()
    return f"v1,{base64.b64encode(digest).decode()}"


class Webhooks:
    """The webhooks of one database.

    Args:
        database: Database.
        hosts: Hosts that may be notified.
    """

    def __init__(self, database: Database, hosts: Collection[str]) -> None:
        self._database = database
        self.hosts = frozenset(host.lower() for host in hosts)

    def add(self, owner: str, url: str) -> RowMapping:
        """Create a webhook. Its secret is returned only once.

        Args:
            owner: Token.
            url: Address.

        Raises:
            RefusedError: 422 or 429.
        """
        check_url(url, self.hosts)
        webhook_id = secrets.token_hex(16)
        secret = SECRET_PREFIX + base64.b64encode(secrets.token_bytes(SECRET_BYTES)).decode()
        row = {"id": webhook_id, "owner": owner, "url": url, "secret": secret, "created": time.time()}
        with self._database.write() as db:
            self._database.lock(db, f"webhooks {owner}")
            count_query = select(func.count()).select_from(WEBHOOKS).where(WEBHOOKS.c.owner == owner)
            if db.execute(count_query).scalar_one() >= MAX_WEBHOOKS:
                message = f"too many webhooks of this token (allowed {MAX_WEBHOOKS}). Delete one."
                raise too_many(message, 60, MAX_WEBHOOKS)
            db.execute(insert(WEBHOOKS).values(row))
            return db.execute(select(WEBHOOKS).where(WEBHOOKS.c.id == webhook_id)).mappings().one()

    def list(self, owner: str) -> list[RowMapping]:
        """Return the webhooks of an owner, oldest first.

        ``waiting`` is the number of pending notifications.
        """
        delivery_count = select(func.count()).where(DELIVERIES.c.webhook == WEBHOOKS.c.id)
        waiting = delivery_count.scalar_subquery().label("waiting")
        query = select(WEBHOOKS, waiting).where(WEBHOOKS.c.owner == owner).order_by(WEBHOOKS.c.created)
        with self._database.read() as db:
            return list(db.execute(query).mappings())

    def remove(self, owner: str, number: str) -> None:
        """Delete a webhook and its pending notifications.

        Args:
            owner: Token.
            number: Id of the webhook.

        Raises:
            RefusedError: 404.
        """
        with self._database.write() as db:
            self._check_owner(db, owner, number)
            db.execute(delete(DELIVERIES).where(DELIVERIES.c.webhook == number))
            db.execute(delete(WEBHOOKS).where(WEBHOOKS.c.id == number))

    def ping(self, owner: str, number: str) -> None:
        """Send a test notification, and enable the webhook again.

        Args:
            owner: Token.
            number: Id of the webhook.

        Raises:
            RefusedError: 404.
        """
        with self._database.write() as db:
            self._check_owner(db, owner, number)
            db.execute(update(WEBHOOKS).where(WEBHOOKS.c.id == number).values(off=None))
            _add_delivery(db, number, "ping", {})

    def _check_owner(self, db: Connection, owner: str, number: str) -> None:
        """Check that a webhook exists and belongs to an owner."""
        if not WEBHOOK_ID.fullmatch(number):
            raise webhook_refusal(f"{number[:40]!r} not found. List the webhooks.", 404)
        query = select(WEBHOOKS.c.id).where(WEBHOOKS.c.id == number, WEBHOOKS.c.owner == owner)
        if db.execute(query).first() is None:
            raise webhook_refusal(f"{number[:40]!r} not found. List the webhooks.", 404)

    def claim(self, busy: Collection[str]) -> DueNotification | None:
        """Claim the next due notification for this host.

        Args:
            busy: Owners to skip, because they are being notified.
        """
        now = self._database.clock()
        not_expired = or_(TOKENS.c.expires.is_(None), TOKENS.c.expires > now)
        valid_tokens = select(TOKENS.c.id).where(TOKENS.c.revoked.is_(None), not_expired)
        query = (
            select(DELIVERIES, WEBHOOKS.c.owner, WEBHOOKS.c.url, WEBHOOKS.c.secret)
            .join(WEBHOOKS, WEBHOOKS.c.id == DELIVERIES.c.webhook)
            .where(
                and_(
                    _is_due(now),
                    WEBHOOKS.c.off.is_(None),
                    WEBHOOKS.c.owner.not_in(busy),
                    or_(WEBHOOKS.c.owner == LOCAL, WEBHOOKS.c.owner.in_(valid_tokens)),
                )
            )
            .order_by(DELIVERIES.c.due, DELIVERIES.c.id)
            .limit(1)
            .with_for_update(of=DELIVERIES, skip_locked=True)
        )
        with self._database.read() as db:  # usually nothing is due, and readers do not block writers
            if db.execute(select(DELIVERIES.c.id).where(_is_due(now)).limit(1)).first() is None:
                return None
        with self._database.write() as db:
            row = db.execute(query).mappings().first()
            if row is None:
                return None
            attempt = row["attempts"] + 1
            claim_values = {"due": now + CLAIM_S, "attempts": attempt}
            db.execute(update(DELIVERIES).where(DELIVERIES.c.id == row["id"]).values(claim_values))
        values = (row["id"], row["webhook"], row["owner"], row["url"], row["secret"], row["body"])
        return DueNotification(*values, attempt)

    def record_attempt(self, due: DueNotification, status: int | None, why: str) -> None:
        """Record the result of an attempt, and when the next one is due.

        A notification that was delivered, has failed too often, or is refused for good is deleted.

        Args:
            due: Notification.
            status: HTTP status, or None without an answer.
            why: Why there was no answer.
        """
        succeeded = status is not None and 200 <= status < 300
        is_last = succeeded or due.attempt > len(RETRY_WAITS_S)
        values = {"told": time.time(), "outcome": f"{status}" if status is not None else why[:200]}
        if status == GONE_STATUS:
            values["off"] = values["told"]
        with self._database.write() as db:
            db.execute(update(WEBHOOKS).where(WEBHOOKS.c.id == due.webhook).values(values))
            delivery_filter = and_(DELIVERIES.c.id == due.id, DELIVERIES.c.attempts == due.attempt)
            if is_last or status == GONE_STATUS:
                db.execute(delete(DELIVERIES).where(delivery_filter))
            else:
                next_due = self._database.clock() + RETRY_WAITS_S[due.attempt - 1]
                db.execute(update(DELIVERIES).where(delivery_filter).values(due=next_due))


def send_notification(due: DueNotification, hosts: Collection[str]) -> tuple[int | None, str]:
    """Send a notification once.

    Args:
        due: Notification.
        hosts: Allowed hosts.

    Returns:
        HTTP status, or None and the reason why there was no answer.
    """
    try:
        parts = check_url(due.url, hosts)
        seconds = int(time.time())
        headers = {
            "Content-Type": "application/json",
            "User-Agent": "tandem",
            "webhook-id": due.id,
            "webhook-timestamp": str(seconds),
            "webhook-signature": signature(due.secret, due.id, seconds, due.body),
        }
        deadline = time.monotonic() + ANSWER_TIMEOUT_S
        connection = http.client.HTTPConnection(parts.netloc, timeout=ANSWER_TIMEOUT_S)
        connection.sock = _connect(parts, deadline)
        timed_out = threading.Event()
        # a socket timeout applies to each read, so a timer limits the whole exchange
        timer = threading.Timer(
            max(deadline - time.monotonic(), 0.0), _close_connection, (connection, timed_out)
        )
        timer.daemon = True
        timer.start()
        try:
            if isinstance(connection.sock, ssl.SSLSocket):
                connection.sock.do_handshake()
            target = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
            connection.request("POST", target, due.body.encode(), headers)
            status = connection.getresponse().status
            if timed_out.is_set():  # a truncated head looks like a complete one
                raise TimeoutError
            return status, ""
        finally:
            timer.cancel()
            connection.close()
    except RefusedError as refusal:
        return None, str(refusal)
    except (OSError, ValueError, http.client.HTTPException) as error:
        LOG.info("webhook %s: no answer: %s", due.webhook, type(error).__name__)
        return None, "no answer"


def _connect(parts: SplitResult, deadline: float) -> socket.socket:
    """Connect to the first address of a host that answers before ``deadline`` [s, monotonic clock].

    With TLS, the caller has to perform the handshake.

    Raises:
        OSError: No address could be connected in time.
    """
    host, port = parts.hostname or "", parts.port or DEFAULT_PORTS[parts.scheme]
    last_error: OSError = TimeoutError("no address answered in time")
    for family, kind, proto, _, address in socket.getaddrinfo(host, port, type=socket.SOCK_STREAM):
        if (remaining := deadline - time.monotonic()) <= 0.0:
            break
        connection = socket.socket(family, kind, proto)
        try:
            connection.settimeout(remaining)
            connection.connect(address)
        except OSError as error:
            connection.close()
            last_error = error
            continue
        if parts.scheme != "https":
            return connection
        context = ssl.create_default_context()
        return context.wrap_socket(connection, server_hostname=host, do_handshake_on_connect=False)
    raise last_error


def _close_connection(connection: http.client.HTTPConnection, timed_out: threading.Event) -> None:
    """Interrupt an exchange that takes too long. Runs in the thread of a timer."""
    timed_out.set()
    with contextlib.suppress(OSError):
        if connection.sock is not None:
            connection.sock.shutdown(socket.SHUT_RDWR)


Deliver = Callable[[DueNotification, Collection[str]], tuple[int | None, str]]
"""Function that sends a notification, see :func:`send_notification`."""


class WebhookSender(threading.Thread):
    """Thread that sends due notifications, on each host."""

    def __init__(self, webhooks: Webhooks, send: Deliver = send_notification) -> None:
        super().__init__(name="tandem-webhooks", daemon=True)
        self._webhooks, self._send = webhooks, send
        self._ending = threading.Event()
        self._lock = threading.Lock()
        self._busy: set[str] = set()

    def stop(self) -> None:
        """Stop sending. Notifications in progress are sent again if they are not answered."""
        self._ending.set()
        if self.is_alive():
            self.join(POLL_S + 5.0)

    def run(self) -> None:
        """Send due notifications until :meth:`stop`."""
        if not self._webhooks.hosts:
            return
        while not self._ending.wait(POLL_S):
            try:
                while not self._ending.is_set() and len(self._busy) < MAX_CONCURRENT:
                    with self._lock:
                        busy = frozenset(self._busy)
                    due = self._webhooks.claim(busy)
                    if due is None:
                        break
                    with self._lock:
                        self._busy.add(due.owner)
                    threading.Thread(target=self._notify, args=(due,), daemon=True).start()
            except SQLAlchemyError:
                LOG.exception("webhooks: the database is unavailable")

    def _notify(self, due: DueNotification) -> None:
        """Send a notification and record the result, in a thread of its own."""
        try:
            status, why = self._send(due, self._webhooks.hosts)
            self._webhooks.record_attempt(due, status, why)
            LOG.info("webhook %s: %s", due.webhook, status if status is not None else why)
        except SQLAlchemyError:
            LOG.exception("webhook %s is notified again", due.webhook)
        finally:
            with self._lock:
                self._busy.discard(due.owner)
