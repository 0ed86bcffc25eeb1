"""Constraints: what motions reach, beside brackets in symbols; laws written as text beside those
that are built in.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from kempe import constraints
from kempe.budget import Budget
from kempe.description.mechanism import Mechanism
from kempe_bench.bench import Bench
from kempe_bench.timing import Case, Grid, measure

TRAILERS = {3: 10.0, 5: 100.0}
"""Cars by their trailers, and the milliseconds that their classification may take."""
SYMBOLS = (0, 1, 2)
"""Cars whose brackets are formed in symbols."""
CLOSURES = 100_000
ANGLE = 0.3
"""Angle of each hitch: a configuration without a trailer across the one before."""


def train(trailers: int) -> Any:
    """A car that turns on the spot with trailers, each hitched on the axle before it."""
    m = Mechanism("train", dim=2)
    last = m.body("car")
    m.planar("car", m.ground, last)
    m.no_sideslip("axle", last)
    for i in range(trailers):
        body = m.body(f"trailer {i}")
        m.revolute(f"hitch {i}", last, body, at=(-1.0 if i else 0.0, 0.0))
        m.frame(f"axle {i}", body, at=(-1.0, 0.0))
        m.no_sideslip(f"wheels {i}", f"axle {i}")
        last = body
    return m.build()


def classify(bench: Bench) -> Grid:
    """Which dimensions motions reach: brackets by series of the rows, and in symbols."""
    table = Grid("Cars with trailers: growth vector", "ms")
    timed = []
    for n in sorted({*SYMBOLS, *TRAILERS}):
        s = train(n)
        q = s.q({f"hitch {i}": ANGLE for i in range(n)})
        timed.append(Case("Kempe", f"{n} trailers", "s.classify(q)", {"s": s, "q": q}))
    growths = {case.call: case.names["s"].classify(case.names["q"]).growth for case in timed}
    for n in SYMBOLS if _sympy() else ():
        if growths[f"{n} trailers"] == _symbols(n):
            timed.append(Case("SymPy", f"{n} trailers", "f(n)", {"f": _symbols, "n": n}))
    table.rows += measure(timed, 1e3)
    for n, bound in TRAILERS.items():
        row = next(r for r in table.rows if r.call == f"{n} trailers")
        table.at_most(f"{n} trailers, at most {bound:g} ms", row.best or row.value, bound)
    table.remarks.append(
        "SymPy: brackets of the fields in symbols up to the same length, evaluated at the "
        "configuration; it is listed where both give the same growth vector"
    )
    return table


def _sympy() -> bool:
    from importlib.util import find_spec

    return find_spec("sympy") is not None


def _symbols(n: int) -> tuple[int, ...]:
    """The growth vector by brackets in symbols."""
    import sympy as sp

    x, y, h = sp.symbols("x y h")
    hitches = sp.symbols(f"a:{n}") if n else ()
    q = [x, y, h, *hitches]
    ahead: list[Any] = [sp.cos(h), sp.sin(h), 0]
    turn: list[Any] = [0, 0, 1]
    speed = sp.Integer(1)
    rate_before = sp.Integer(0)
    rate_turn = sp.Integer(1)
    # the axle of a trailer, one metre behind its hitch on the axle before, does not slip
    for a in hitches:
        rate = -speed * sp.sin(a)
        ahead.append(rate - rate_before)
        turn.append(-rate_turn)
        speed = speed * sp.cos(a)
        rate_before = rate
        rate_turn = sp.Integer(0)
    fields = [sp.Matrix(ahead), sp.Matrix(turn)]
    here = {x: 0, y: 0, h: 0, **dict.fromkeys(hitches, ANGLE)}
    level = fields
    all_ = list(fields)
    growth = []
    while not growth or growth[-1] < len(q):
        values = np.array([[float(e) for e in f.subs(here)] for f in all_])
        growth.append(int(np.linalg.matrix_rank(values, tol=1e-9)))
        level = [g.jacobian(q) * f - f.jacobian(q) * g for f in fields for g in level]
        all_ += level
    return tuple(growth)


def laws(bench: Bench) -> Grid:
    """Closing a batch under a law of coordinates: built in, and written as text."""
    table = Grid(f"Laws of coordinates: {CLOSURES:,} closures, one thread", "s")
    rng = np.random.default_rng(1)
    timed = []
    for who, declare in (
        ("built in (rod)", lambda m: m.constrain(constraints.Distance("tip", "pin", 0.9), "law")),
        (
            "text",
            lambda m: m.constrain(constraints.OnSurface("tip", "(x - 1)^2 + y^2 = 0.81"), "law"),
        ),
    ):
        m = Mechanism("two-link", dim=2)
        upper = m.body("upper")
        lower = m.body("lower")
        m.revolute("A", m.ground, upper)
        m.revolute("B", upper, lower, at=(0.6, 0.0))
        m.frame("tip", lower, at=(0.5, 0.0))
        m.frame("pin", m.ground, at=(1.0, 0.0))
        declare(m)
        s = m.build()
        known = {"A": rng.uniform(-0.5, 0.5, CLOSURES)}
        one = Budget(threads=1)
        timed.append(
            Case(
                "Kempe",
                who,
                "s.assemble(known, budget=budget)",
                {"s": s, "known": known, "budget": one},
            )
        )
    table.rows += measure(timed, 1.0)
    built_in, text = (row.value for row in table.rows)
    table.at_most("text beside built in, at most 3 times", text / built_in, 3.0)
    return table
