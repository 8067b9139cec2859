"""Shared fixtures of the forming tests."""

from __future__ import annotations

import pytest

from planner.processes.forming.plan.springback import forecast


@pytest.fixture(autouse=True)
def _no_forecast(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Skip the springback forecast of each plan. It takes a second, and only its own tests need it."""
    if "springback" not in request.path.parts:
        monkeypatch.setattr(forecast, "estimate_springback", lambda *_: None)
