"""Rate limits of a token, and how the service answers a flood of wrong tokens."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from planner.service.models import Database, default_url
from planner.service.rate_limits import MAX_BUCKETS, RateLimiter
from planner.service.security import Auth, RefusedError, ServiceLimits
from tests.service.support import InProcess, issue_codes


class Clock:
    """A clock that moves only when a test sets it."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


def is_allowed(rates: RateLimiter, key: str) -> bool:
    try:
        rates.take(key, "it sends")
    except RefusedError:
        return False
    return True


def test_ten_seconds_worth_may_come_at_once_and_then_as_much_as_the_rate() -> None:
    clock = Clock()
    rates = RateLimiter(2.0, clock)
    assert [is_allowed(rates, "a") for _ in range(21)] == [True] * 20 + [False]
    assert is_allowed(rates, "b")  # another one has a bucket of its own
    clock.now = 0.5
    assert [is_allowed(rates, "a") for _ in range(2)] == [True, False]
    clock.now = 1000.0  # it is never fuller than full
    assert [is_allowed(rates, "a") for _ in range(21)] == [True] * 20 + [False]


def test_over_any_time_no_more_come_through_than_the_rate_and_one_bucket() -> None:
    clock = Clock()
    rates = RateLimiter(5.0, clock)
    count = 0
    for step in range(100_000):
        clock.now = step * 1e-3
        count += is_allowed(rates, "a")
    assert 5.0 * 100.0 <= count <= 5.0 * 100.0 + 50.0


def test_a_refusal_says_how_many_and_when() -> None:
    rates = RateLimiter(0.1, Clock())
    rates.take("a", "this token sends")
    with pytest.raises(RefusedError) as error:
        rates.take("a", "this token sends")
    assert (error.value.status, error.value.headers) == (429, {"Retry-After": "10"})
    (issue,) = error.value.issues
    assert issue.code == "service.too_many"
    assert (
        issue.message == "this token sends more than 0.1 requests per second or 1 at once. Try again in 10 s."
    )


def test_no_rate_lets_all_through() -> None:
    assert all(is_allowed(RateLimiter(None), "a") for _ in range(1000))


def test_a_flood_of_keys_takes_no_more_memory() -> None:
    rates = RateLimiter(1.0, Clock())
    for number in range(2 * MAX_BUCKETS):
        rates.take(f"{number}", "it sends")
    assert len(rates._buckets) == MAX_BUCKETS


@pytest.fixture
def running_service(tmp_path: Path) -> Iterator[tuple[InProcess, str]]:
    data = tmp_path / "data"
    data.mkdir()
    token = Auth(Database(default_url(data))).create_token("ann")
    limits = ServiceLimits(requests_per_s=0.5)
    with InProcess(data, limits, examiners=1, require_token=True) as made:
        yield made, token


def test_a_token_that_asks_too_often_is_told(running_service: tuple[InProcess, str]) -> None:
    made, token = running_service
    ann = {"Authorization": f"Bearer {token}"}
    seen = [made.http.get("/v1/storage", headers=ann) for _ in range(8)]
    statuses = [answer.status_code for answer in seen]
    assert statuses[:5] == [200] * 5
    assert 429 in statuses[5:]
    assert issue_codes(next(item for item in seen if item.status_code == 429)) == [("service.too_many", None)]
    assert made.http.get("/v1/health").status_code == 200  # who watches the service is not counted


def test_wrong_tokens_are_counted_by_address_and_a_good_one_is_let_in(
    running_service: tuple[InProcess, str],
) -> None:
    made, token = running_service
    wrong = {"Authorization": f"Bearer {token[:-1]}{'b' if token[-1] == 'a' else 'a'}"}
    statuses = [made.http.get("/v1/storage", headers=wrong).status_code for _ in range(14)]
    assert statuses[:10] == [401] * 10
    assert statuses[-1] == 429
    assert made.http.get("/v1/storage", headers={"Authorization": f"Bearer {token}"}).status_code == 200
