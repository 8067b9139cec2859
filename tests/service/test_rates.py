"""How often a token may ask, and what a flood of wrong tokens meets."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from planner.service.models import Database, default_url
from planner.service.rates import MOST_KEPT, Rates
from planner.service.security import Auth, Limits, RefusedError
from tests.service.support import InProcess, codes


class Clock:
    """Stands until it is told to go."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


def allowed(rates: Rates, key: str) -> bool:
    try:
        rates.take(key, "it sends")
    except RefusedError:
        return False
    return True


def test_ten_seconds_worth_may_come_at_once_and_then_as_much_as_the_rate() -> None:
    clock = Clock()
    rates = Rates(2.0, clock)
    assert [allowed(rates, "a") for _ in range(21)] == [True] * 20 + [False]
    assert allowed(rates, "b")  # another one has a bucket of its own
    clock.now = 0.5
    assert [allowed(rates, "a") for _ in range(2)] == [True, False]
    clock.now = 1000.0  # it is never fuller than full
    assert [allowed(rates, "a") for _ in range(21)] == [True] * 20 + [False]


def test_over_any_time_no_more_come_through_than_the_rate_and_one_bucket() -> None:
    clock = Clock()
    rates = Rates(5.0, clock)
    count = 0
    for step in range(100_000):
        clock.now = step * 1e-3
        count += allowed(rates, "a")
    assert 5.0 * 100.0 <= count <= 5.0 * 100.0 + 50.0


def test_a_refusal_says_how_many_and_when() -> None:
    rates = Rates(0.1, Clock())
    rates.take("a", "this token sends")
    with pytest.raises(RefusedError) as error:
        rates.take("a", "this token sends")
    assert (error.value.status, error.value.headers) == (429, {"Retry-After": "10"})
    (issue,) = error.value.issues
    assert issue.code == "service.too_many"
    assert (
        issue.message == "this token sends more than 0.1 requests a second, or 1 at once; ask again in 10 s"
    )


def test_no_rate_lets_all_through() -> None:
    assert all(allowed(Rates(None), "a") for _ in range(1000))


def test_a_flood_of_keys_takes_no_more_memory() -> None:
    rates = Rates(1.0, Clock())
    for number in range(2 * MOST_KEPT):
        rates.take(f"{number}", "it sends")
    assert len(rates._known) == MOST_KEPT


@pytest.fixture
def here(tmp_path: Path) -> Iterator[tuple[InProcess, str]]:
    data = tmp_path / "data"
    data.mkdir()
    token = Auth(Database(default_url(data))).make("ann")
    limits = Limits(requests_per_s=0.5)
    with InProcess(data, limits, examiners=1, require_token=True) as made:
        yield made, token


def test_a_token_that_asks_too_often_is_told(here: tuple[InProcess, str]) -> None:
    made, token = here
    ann = {"Authorization": f"Bearer {token}"}
    seen = [made.http.get("/v1/storage", headers=ann) for _ in range(8)]
    statuses = [answer.status_code for answer in seen]
    assert statuses[:5] == [200] * 5
    assert 429 in statuses[5:]
    assert codes(next(one for one in seen if one.status_code == 429)) == [("service.too_many", None)]
    assert made.http.get("/v1/health").status_code == 200  # who watches the service is not counted


def test_wrong_tokens_are_counted_by_address_and_a_good_one_is_let_in(here: tuple[InProcess, str]) -> None:
    made, token = here
    wrong = {"Authorization": f"Bearer {token[:-1]}{'b' if token[-1] == 'a' else 'a'}"}
    statuses = [made.http.get("/v1/storage", headers=wrong).status_code for _ in range(14)]
    assert statuses[:10] == [401] * 10
    assert statuses[-1] == 429
    assert made.http.get("/v1/storage", headers={"Authorization": f"Bearer {token}"}).status_code == 200
