"""A browser for the tests of pages."""

from __future__ import annotations

import pytest
from chromium import CHROMIUM, SOFTWARE

PATIENCE = 300_000
"""Milliseconds after which a page hangs; the usual half minute may pass on a busy machine."""


@pytest.fixture(scope="module")
def browser():
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if CHROMIUM is None:
        pytest.skip("Chromium is not installed")
    with playwright.sync_playwright() as p:
        one = p.chromium.launch(executable_path=CHROMIUM, args=SOFTWARE)
        new_page = one.new_page

        def patient(**how):
            tab = new_page(**how)
            tab.set_default_timeout(PATIENCE)
            return tab

        one.new_page = patient
        yield one
        one.close()
