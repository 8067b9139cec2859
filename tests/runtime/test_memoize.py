"""A memoized value equals the recomputed one, whichever argument changes."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner.issues import Severity
from planner.runtime.memoize import digest, memoized, use_cache
from planner.service.file_cache import FileCache


@dataclasses.dataclass(frozen=True)
class First:
    value: Any


@dataclasses.dataclass(frozen=True)
class Second:
    value: Any


ALL = [
    *(
        0,
        0.0,
        -0.0,
        False,
        None,
        "",
        "0",
        1,
        True,
        1.0,
        np.float32(1.0),
        float("nan"),
        float("inf"),
        "\ud800",
    ),
    *((), (0,), (0, 0), ((0,), 0), (0, (0,)), ("ab", "c"), ("a", "bc"), {}, {"a": 1}, {"a": "1"}),
    *(First(1), Second(1), First("1"), Severity.ERROR, Severity.NOTE),
    *(np.zeros(2), np.zeros(2, np.float32), np.zeros(2, np.int64), np.zeros((2, 1)), np.zeros((1, 2))),
    *(np.array([0.0, -0.0]), np.array([0.0, 5e-324])),
]


def test_no_two_values_have_one_digest() -> None:
    assert len({digest(item) for item in ALL}) == len(ALL)
    assert digest(1, (2,)) != digest((1, 2)) != digest(1, 2)
    turned = np.arange(6.0).reshape(2, 3).T
    assert digest(turned) == digest(np.ascontiguousarray(turned)) != digest(turned.T)


@pytest.mark.parametrize("value", [object(), Path("x"), {1, 2}, np.array([None]), lambda: 0])
def test_what_has_no_digest_is_refused(value: object) -> None:
    with pytest.raises(TypeError, match="got a"):
        digest(value)


def test_a_value_is_worked_out_once_and_nobody_can_write_into_it(tmp_path: Path) -> None:
    calls = []

    @memoized
    def double(values: np.ndarray[Any, Any], by: float = 2.0) -> np.ndarray[Any, Any]:
        calls.append(by)
        if by == 0.0:
            raise ValueError("nothing")
        return by * values

    double(np.ones(3)), double(np.ones(3))
    assert len(calls) == 2  # nobody keeps
    with use_cache(FileCache(tmp_path / "kept")):
        double(np.ones(3))[:] = 7.0
        assert double(np.ones(3)).tolist() == [2.0, 2.0, 2.0]
        assert len(calls) == 3
        assert double(np.ones(3), 3.0).tolist() == [3.0, 3.0, 3.0]
        assert double(np.array([1.0, 1.0, np.nextafter(1.0, 2.0)]))[2] > 2.0
        for _ in range(2):
            with pytest.raises(ValueError, match="nothing"):
                double(np.ones(3), 0.0)
        assert len(calls) == 7
        for path in (tmp_path / "kept").iterdir():  # cut off, as by a full disk of another time
            path.write_bytes(path.read_bytes()[:-3])
        assert double(np.ones(3)).tolist() == [2.0, 2.0, 2.0]
    double(np.ones(3))
    assert len(calls) == 9


def test_files_that_are_kept_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("planner.service.file_cache.MAX_CACHE_BYTES", 100_000)
    kept = FileCache(tmp_path)
    for number in range(20):
        kept.put(f"k{number}", np.full(1000, float(number)))
        assert sum(path.stat().st_size for path in tmp_path.iterdir()) <= 100_000
    kept.put("large", np.zeros(100_000))
    assert kept.get("large") is None and kept.get("k0") is None
    assert kept.get("k19")[0] == 19.0
