"""Mutations change one thing each, leave texts alone, and are found again by their number."""

import ast

import pytest
from mutation import instrumented, mutated, sites

SOURCE = '''
"""Add 1 and 2."""
from __future__ import annotations

SIZE: int = 3

def size(x, least=0, unread=5, *, other=7):
    """The size of 1 thing."""
    assert x >= 0, "negative"
    if x < least:
        raise ValueError(f"{x} is less than {least + 1}")
    out = x + 1 if x and least else -x
    return min(out, SIZE, key=abs)

def pairs(a):
    return [*zip(a, a, strict=True)] or zeros((0, a))

def sentence(x) -> str:
    return f"{x + 1} things"
'''
EXPECTED = [
    ("3", "4"),
    ("0", "1"),
    ("x < least", "x >= least"),
    ("raise ValueError(f'{x} is less than {least + 1}')", "pass"),
    ("x + 1", "x - 1"),
    ("1", "2"),
    ("x and least", "x or least"),
    ("x and least", "not (x and least)"),
    ("-x", "x"),
    ("return min(out, SIZE, key=abs)", "return None"),
    ("min(out, SIZE, key=abs)", "max(out, SIZE, key=abs)"),
    ("min(out, SIZE, key=abs)", "min(out, SIZE)"),
    ("0", "1"),
    ("return [*zip(a, a, strict=True)] or zeros((0, a))", "return None"),
    ("[*zip(a, a, strict=True)] or zeros((0, a))", "[*zip(a, a, strict=True)] and zeros((0, a))"),
]


def test_each_change_once_and_no_texts():
    found = [(s.before, s.after) for s in sites(SOURCE)]
    assert sorted(found) == sorted(EXPECTED)


@pytest.mark.parametrize("site", sites(SOURCE), ids=lambda s: s.after)
def test_a_mutant_is_the_source_with_one_change(site):
    text = ast.unparse(ast.parse(SOURCE))
    tree = mutated(SOURCE, site.number)
    found = ast.unparse(tree)
    assert found != text and site.after in found
    changed = [(a, b) for a, b in zip(text.splitlines(), found.splitlines(), strict=True) if a != b]
    assert len(changed) == 1
    compile(tree, "mutant", "exec")


def test_segments_are_what_a_call_reaches(monkeypatch):
    import sys
    import types

    hits = set()
    module = types.ModuleType("kempe._hits")
    module.hit = hits.add
    monkeypatch.setitem(sys.modules, "kempe._hits", module)
    names = {}
    exec(compile(instrumented(SOURCE, "m.py"), "m", "exec"), names)
    assert names["__doc__"] == "Add 1 and 2." and names["size"].__doc__ == "The size of 1 thing."
    assert names["size"](5) == 3 and hits == {"m.py:size:0", "m.py:size:2"}
    with pytest.raises(ValueError):
        names["size"](1, 2)
    assert hits == {"m.py:size:0", "m.py:size:1", "m.py:size:2"}
    assert {s.segment for s in sites(SOURCE) if s.after == "pass"} == {"size:1"}
