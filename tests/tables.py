"""Tables that a program may add rows to: they are as before after a `with` block."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from kempe.constraints import KINDS
from kempe.description.formats import FORMATS
from kempe.joints import TYPES
from kempe.solvers import TABLE


@contextmanager
def restored() -> Iterator[None]:
    """Whatever is added to the tables of joints, constraints, formats, solvers and symbols goes
    again.
    """
    drawing = sys.modules.get("kempe.views.drawing.symbols")
    tables: list[dict] = [TYPES, KINDS, FORMATS, *([drawing.SYMBOLS] if drawing else [])]
    before = [dict(table) for table in tables]
    modules = [
        m
        for name, m in list(sys.modules.items())
        if name.startswith("kempe.") and "SOLVERS" in vars(m)
    ]
    rows = [m.SOLVERS for m in modules]
    assert {id(r) for r in TABLE.values()} <= {id(r) for r in rows}
    try:
        yield
    finally:
        for table, kept in zip(tables, before, strict=True):
            table.clear()
            table.update(kept)
        for module, kept in zip(modules, rows, strict=True):
            module.SOLVERS = kept
