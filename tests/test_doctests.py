"""The examples in docstrings say what comes out."""

from __future__ import annotations

import doctest
import importlib
import pkgutil

import pytest

import kempe

MODULES = sorted(m.name for m in pkgutil.walk_packages(kempe.__path__, "kempe."))


@pytest.mark.parametrize("name", MODULES)
def test_examples(name):
    result = doctest.testmod(importlib.import_module(name), optionflags=doctest.ELLIPSIS)
    assert result.failed == 0


def test_there_are_examples():
    finder = doctest.DocTestFinder()
    found = [t for name in MODULES for t in finder.find(importlib.import_module(name)) if t.examples]
    assert len(found) >= 2
