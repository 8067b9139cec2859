"""Feed and length of a job as the proof measures them, against a moved and sliding arc in closed form."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from planner.issues import TandemError
from planner.processes.hotwire.proof.rules.wire import _speed_bounds, feed_speed
from planner.proof.prove import Prover
from planner.proof.replay import playback
from tests.proof import small_job

RADIUS = 0.3
TIMES = np.array([0.0, 0.5, 1.0])


def seen(slide: float, forward: float) -> np.ndarray:
    """Speeds for an arc in the xz plane that slides along itself by ``slide`` and moves along y, per station
    [m].
    """
    angle = np.linspace(-0.5, 0.5, 201)[None] + slide / RADIUS * np.arange(3)[:, None]
    y = forward * np.arange(3)[:, None] + 0 * angle
    points = np.stack([RADIUS * np.sin(angle), y, RADIUS * np.cos(angle)], axis=-1)
    wire: Any = SimpleNamespace(
        points=points, inside=np.ones(points.shape[:2], dtype=bool), sample=np.arange(3), labels=None
    )
    context: Any = SimpleNamespace(motion=SimpleNamespace(time=TIMES))
    return feed_speed(context, wire)


@pytest.mark.parametrize("count", [0, 1])
def test_a_wire_without_a_way_between_stations_has_no_other_driven_feed(count: int) -> None:
    """As of programs whose synchronised block has no move."""
    nothing: Any = SimpleNamespace()
    speed = np.full(count, np.nan)
    for bound in _speed_bounds(nothing, nothing, speed):
        np.testing.assert_array_equal(bound, speed)


@pytest.mark.parametrize("slide", [0.0, 1e-3, 5e-3])
def test_sliding_along_itself_is_no_feed(slide: float) -> None:
    speed = seen(slide, 4e-3)
    assert np.isnan(speed[0])
    np.testing.assert_allclose(speed[1:], 8e-3, rtol=2e-3)


def test_a_wire_that_only_slides_does_not_cut() -> None:
    assert seen(5e-3, 0.0)[1:].max() < 5e-5


def test_programs_longer_than_what_is_replayed_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(playback, "MAX_MOTION_TIME_S", 1.0)
    prover = Prover(small_job.problem(), small_job.claims())
    with pytest.raises(TandemError) as caught:
        prover.prove(small_job.programs(12))
    (issue,) = caught.value.issues
    assert issue.code == "verify.duration"
    assert issue.value is not None
    assert issue.value > 1.0 / 3600.0
