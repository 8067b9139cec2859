"""How often one token may ask, and one address show tokens that are none: a token bucket each.

A bucket holds what may be asked at once and fills again with time (RFC 2697 has the like of it for
packets). Counts are of this process: two hosts let through twice as much.
"""

import math
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from typing import Final

from planner.service.security import too_many

BURST_S: Final = 10.0
"""What may come at once is what may come in so long [s]."""
FAILURES_PER_S: Final = 1.0
"""Requests with a wrong token that one address may send on average [1/s]."""
MOST_KEPT: Final = 10_000
"""Buckets that are known; those that were asked of longest ago go first, and are full again."""


class Rates:
    """Buckets by key, each for ``per_s`` requests [1/s]; None lets all through. Threads may share it."""

    def __init__(self, per_s: float | None, now: Callable[[], float] = time.monotonic) -> None:
        self._per_s, self._now = per_s, now
        self._lock = threading.Lock()
        self._known: OrderedDict[str, tuple[float, float]] = OrderedDict()  # what is in it, and when it was

    def take(self, key: str, what: str) -> None:
        """Take a request out of a bucket. Raises :class:`RefusedError`, 429, where it is empty; ``what``
        begins the message."""
        if self._per_s is None:
            return
        most = max(1.0, self._per_s * BURST_S)
        with self._lock:
            now = self._now()
            held, since = self._known.pop(key, (most, now))
            held = min(most, held + (now - since) * self._per_s)
            empty = held < 1.0
            self._known[key] = (held if empty else held - 1.0, now)
            while len(self._known) > MOST_KEPT:
                self._known.popitem(last=False)
        if empty:
            wait = math.ceil((1.0 - held) / self._per_s)
            told = f"{what} more than {self._per_s:g} requests a second, or {most:g} at once; "
            raise too_many(f"{told}ask again in {wait} s", wait, self._per_s, "1/s")
