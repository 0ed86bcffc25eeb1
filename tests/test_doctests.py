"""The examples in docstrings say what comes out."""

from __future__ import annotations

import doctest
import importlib
import pkgutil
import re
from importlib.util import find_spec

import pytest

import kempe

PLAIN = re.compile(r"kempe\.kernels\.(compiled|declare|digest|\w*layout)")
"""Modules of kernels that need no compiler."""
MODULES = sorted(
    m.name
    for m in pkgutil.walk_packages(kempe.__path__, "kempe.")
    if find_spec("numba") or PLAIN.fullmatch(m.name) or not m.name.startswith("kempe.kernels.")
)


@pytest.mark.parametrize("name", MODULES)
def test_examples(name):
    result = doctest.testmod(importlib.import_module(name), optionflags=doctest.ELLIPSIS)
    assert result.failed == 0


def test_there_are_examples():
    finder = doctest.DocTestFinder()
    found = [t for name in MODULES for t in finder.find(importlib.import_module(name)) if t.examples]
    assert len(found) >= 2
