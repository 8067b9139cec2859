"""What the tests of forming share."""

from __future__ import annotations

import pytest

from planner.processes.forming.plan.springback import forecast


@pytest.fixture(autouse=True)
def _no_forecast(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each plan foretells springback at two places, a second of work which what else is looked at of a plan
    does not hang on: only the forecast's own tests wait for it."""
    if "springback" not in request.path.parts:
        monkeypatch.setattr(forecast, "estimate", lambda *_: None)
