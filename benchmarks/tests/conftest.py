"""Settings of the tests of the benchmarks."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from kempe_bench import numeric_worker


@pytest.fixture(scope="session", autouse=True)
def a_busy_machine_ends_no_library() -> Iterator[None]:
    """Only a process that hangs is ended: how fast it is decides nothing in the tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(numeric_worker, "PATIENCE", 1200.0)
        yield
