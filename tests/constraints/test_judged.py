"""Every kind as the judge measures it from poses, against the rows of the kernels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from kinds_battery import EXAMPLES, TASKS_ONLY, two_bodies

from kempe import System, tasks
from kempe.constraints.base import list_position_rows
from kempe.equations import closure_rows
from kempe.equations.judge import judge_configurations
from kempe.equations.one_sided import pack_one_sided_rows

HELD = [n for n in EXAMPLES if n not in TASKS_ONLY]


def apart(system: System, q: np.ndarray) -> np.ndarray:
    """How far (..., n, 2) each constraint is missed by the kernels: the norms of its rows in
    metres, and of others.
    """
    packed = closure_rows.pack_full_loops(system, False)
    values = closure_rows.compute_residual(system, q)
    names = [n for n, _ in packed.names]
    metres = np.array([u == "m" for u in packed.units])
    out = []
    for name in judge_configurations(system, q).names:
        own = np.array([n == name for n in names])
        out.append([np.linalg.norm(values[..., own & unit], axis=-1) for unit in (metres, ~metres)])
    return np.moveaxis(np.array(out), 1, -1)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("name", HELD)
def test_each_kind(name, dim, hunt):
    """Where the kernels close it, it holds; elsewhere the miss is that of the kernels' rows, or
    zero with them.
    """
    m = two_bodies(dim)
    rng = hunt.rng()
    m.constrain(made := EXAMPLES[name](dim), "it")
    system = m.build()
    rows = [r for r in made.list_rows(dim) if not r.velocity]
    equal = list_position_rows(made, dim)
    q = np.stack([system.random(rng) for _ in range(hunt.cases(20))])
    there = judge_configurations(system, q)
    closed = system.assemble(start=q)
    assert (
        closed.success.all()
        and closed.judged.holds.all()
        and there.names == (("it",) if rows else ())
    )
    if rows and len(equal) == len(rows):
        rows_ = apart(system, q)
        # the kernels' rows are the chord between directions
        if made.kind in (
            "pointing",
            "look_at",
        ):
            rows_[..., 1] = 2.0 * np.arcsin(np.minimum(rows_[..., 1] / 2.0, 1.0))
        np.testing.assert_allclose(there.errors, rows_, atol=1e-7)
        assert not there.holds.any()
    if rows and not equal:
        beyond = pack_one_sided_rows(system).compute_excess(q, declared=True)
        np.testing.assert_allclose(
            np.linalg.norm(there.errors[0], axis=-1), np.linalg.norm(beyond, axis=-1), atol=1e-9
        )
        assert there.holds.tolist() == (beyond == 0.0).all(axis=-1).tolist() and there.holds.any()


@pytest.mark.parametrize(
    "name", [n for n in HELD if not any(r.velocity for r in EXAMPLES[n](3).list_rows(3))]
)
def test_tasks_and_declared_are_judged_alike(name, hunt):
    m = two_bodies(3)
    rng = hunt.rng()
    m.constrain(made := EXAMPLES[name](3), "it")
    system = m.build()
    q = np.stack([system.random(rng) for _ in range(20)])
    np.testing.assert_allclose(
        judge_configurations(system, q).errors[0].T, tasks.miss(system, made, q), atol=1e-9
    )


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize(
    "name", [n for n in EXAMPLES if not any(r.velocity for r in EXAMPLES[n](3).list_rows(3))]
)
def test_answers_of_ik_are_judged(name, dim):
    """What is required is judged at poses that are multiplied out; another configuration is no
    answer.
    """
    system = two_bodies(dim).build()
    made = EXAMPLES[name](dim)
    answer = system.ik(made.demand(weight=None), start=system.random(3))
    assert answer.success and answer.judged and answer.judged.names == (made.label,)
    np.testing.assert_allclose(
        answer.judged.errors[0], tasks.miss(system, made, answer.q), atol=1e-12
    )
    elsewhere = replace(answer, q=answer.q + np.linspace(0.7, 1.9, system.nq))
    one_sided = name in ("half_space", "contact", "in_box", "inequality")
    assert one_sided or (not elsewhere.judged and "success is contradicted" in elsewhere.verdict)
