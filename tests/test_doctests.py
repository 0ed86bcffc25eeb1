"""The examples in docstrings say what comes out."""

from __future__ import annotations

import doctest
import importlib
from pathlib import Path

import pytest

import kempe

ROOT = Path(kempe.__file__).parents[1]
MODULES = [
    path.relative_to(ROOT).with_suffix("").as_posix().replace("/", ".").removesuffix(".__init__")
    for path in sorted(ROOT.glob("kempe/**/*.py"))
    if ">>> " in path.read_text(encoding="utf-8")
]
"""Modules with examples: others, and the compiler that kernels need, are not imported here."""


@pytest.mark.parametrize("name", MODULES)
def test_examples(name):
    result = doctest.testmod(importlib.import_module(name), optionflags=doctest.ELLIPSIS)
    assert result.attempted and not result.failed


def test_there_are_examples():
    assert len(MODULES) >= 2
