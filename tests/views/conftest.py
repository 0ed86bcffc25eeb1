"""A browser for the tests of pages."""

from __future__ import annotations

import pytest
from chromium import CHROMIUM, SOFTWARE


@pytest.fixture(scope="module")
def browser():
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if CHROMIUM is None:
        pytest.skip("Chromium is not installed")
    with playwright.sync_playwright() as p:
        one = p.chromium.launch(executable_path=CHROMIUM, args=SOFTWARE)
        yield one
        one.close()
