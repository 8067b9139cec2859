"""Random tests: the same inputs in every run, and no time limit on one of them, as machines stall."""

from __future__ import annotations

from hypothesis import settings

settings.register_profile("fixed", derandomize=True, deadline=None)
settings.load_profile("fixed")
