"""Arms that several files of tests use."""

from __future__ import annotations

import pytest

import kempe
from kempe import System


@pytest.fixture(scope="session")
def panda() -> System:
    return kempe.load("panda")


@pytest.fixture(scope="session")
def six(panda) -> System:
    """Six joints, no redundancy."""
    return panda.mechanism.lock({"panda_joint3": 0.4}).build()
