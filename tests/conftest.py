"""Settings of all tests: deterministic property tests without deadlines."""

from __future__ import annotations

import os

from hypothesis import HealthCheck, settings

os.environ.setdefault("KEMPE_QUIET", "1")

settings.register_profile(
    "kempe",
    derandomize=True,
    deadline=None,
    max_examples=40,
    database=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)
settings.load_profile("kempe")
