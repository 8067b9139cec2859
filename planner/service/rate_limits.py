"""Rate limits per API token, and per client address for failed authentication: token buckets.

A bucket holds the requests that may come at once, and is refilled over time (similar to RFC 2697 for
packets). Counts are kept in this process, so that two hosts together allow twice as much.
"""

import math
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from typing import Final

from planner.service.security import too_many

BURST_S: Final = 10.0
"""Size of a bucket, as the time [s] in which it is refilled."""
FAILURES_PER_S: Final = 1.0
"""Average rate [1/s] of requests with a wrong token that one address may send."""
MAX_BUCKETS: Final = 10_000
"""Maximum number of buckets. The least recently used are removed and start full again."""


class RateLimiter:
    """Token buckets by key. Threads may share it.

    Args:
        per_s: Rate [1/s] of each bucket, or None for no limit.
        now: Clock [s].
    """

    def __init__(self, per_s: float | None, now: Callable[[], float] = time.monotonic) -> None:
        self._per_s, self._now = per_s, now
        self._lock = threading.Lock()
        self._buckets: OrderedDict[str, tuple[float, float]] = OrderedDict()  # level and time

    def take(self, key: str, subject: str) -> None:
        """Take a request out of a bucket.

        Args:
            key: Key of the bucket.
            subject: Subject of the message.

        Raises:
            RefusedError: 429, the bucket is empty.
        """
        if self._per_s is None:
            return
        capacity = max(1.0, self._per_s * BURST_S)
        with self._lock:
            now = self._now()
            level, updated_at = self._buckets.pop(key, (capacity, now))
            level = min(capacity, level + (now - updated_at) * self._per_s)
            empty = level < 1.0
            self._buckets[key] = (level if empty else level - 1.0, now)
            while len(self._buckets) > MAX_BUCKETS:
                self._buckets.popitem(last=False)
        if empty:
            wait = math.ceil((1.0 - level) / self._per_s)
            message = f"{subject} more than {self._per_s:g} requests per second or {capacity:g} at once. "
            raise too_many(f"{message}Try again in {wait} s.", wait, self._per_s, "1/s")
