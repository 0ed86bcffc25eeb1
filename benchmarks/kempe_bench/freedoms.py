"""Degrees of freedom against the peers: who is right, and how long the answer takes."""

from __future__ import annotations

import numpy as np

from kempe.errors import UnsupportedError
from kempe_bench.bench import Bench
from kempe_bench.loop_peers import Exudyn
from kempe_bench.loop_solvers import Mujoco
from kempe_bench.loop_trees import Tree
from kempe_bench.timing import Case, Grid, Row, measure

TRUTH = {
    "four_bar": 1,
    "slider_crank": 1,
    "double_parallelogram": 1,
    "bennett": 1,
    "sarrus": 1,
    "bricard_trihedral": 1,
    "goldberg_5r": 1,
    "stewart": 6,
    "peaucellier": 1,
    "jansen": 1,
    "three_rrr": 3,
    "delta_ss": 9,
    "delta_uu": 3,
    "shaky_3r": 0,
    "parallelogram": 1,
    "pendulum_dead_centre": 1,
    "wunderlich": 2,
}
"""Published local degrees of freedom: the dimension of the set of closed configurations through the
posture."""
POSTURES = {"parallelogram": "flat"}
"""Postures other than 'closed'."""
LARGE = ("delta_uu", "delta_ss")
"""Mechanisms of 15 joints, on which times are judged."""
TIMED = ("four_bar", "bennett", *LARGE, "wunderlich")
RANK = 1e-9
"""Singular values below this part of the largest count as zero, in the rank by hand."""
TRUE = "Kempe, dof"
FIRST_ORDER = "Kempe, rank_dof"
EXUDYN = "Exudyn"
HAND = "MuJoCo, rank by hand"
PUBLISHED = "published"


def dof(bench: Bench) -> Grid:
    """Degrees of freedom, with regular, overconstrained, shaky and bifurcating mechanisms."""
    import kempe
    from kempe.mobility.mobility import mobility

    table = Grid("Degrees of freedom: who is right", "freedoms")
    for name, truth in TRUTH.items():
        system = kempe.load(name)
        q = system.q(POSTURES.get(name, "closed"))
        report = mobility(system, q)
        answers = {PUBLISHED: truth, TRUE: report.dof, FIRST_ORDER: report.rank_dof}
        if "exudyn" in bench.versions:
            answers[EXUDYN] = Exudyn(Tree(system), q).freedoms()
        if "mujoco" in bench.versions:
            answers[HAND] = _rank_by_hand(Tree(system), q)
        table.rows += [Row(who, name, float(n)) for who, n in answers.items() if n is not None]
    n = len(TRUTH)
    for who in dict.fromkeys(row.library for row in table.rows):
        right = [
            row for row in table.rows if row.library == who and row.value == TRUTH.get(row.call)
        ]
        table.rows.append(Row(who, f"right, of {n}", float(len(right))))
    table.at_least(f"dof as published, of {n}", table.value(TRUE, "right"), n)
    table.remarks += [
        "dof is the dimension of the set of closed configurations through the posture; at "
        "wunderlich's flat pose branches of dimensions 1 and 2 meet, at the parallelogram's two of "
        "dimension 1",
        "Exudyn counts by the rank of its constraint Jacobian; MuJoCo does not count: rank of its "
        "Jacobian, by hand; a dash: a cut universal joint, which has no equality constraint there",
        "Pinocchio, Drake and pylinkage have no count of their own",
    ]
    return table


def _rank_by_hand(tree: Tree, q: np.ndarray) -> int | None:
    try:
        peer = Mujoco(tree)
    except UnsupportedError:
        return None
    _, J = peer.equations(peer.ready(q[None])[0])
    values = np.linalg.svd(J, compute_uv=False)
    return peer.nv - int(np.sum(values > RANK * values.max()))


def mobility(bench: Bench) -> Grid:
    """Time of the report on the degrees of freedom."""
    import kempe
    from kempe.mobility import mobility as module

    table = Grid("Report on the degrees of freedom: time, by joints", "ms")
    for name in TIMED:
        system = kempe.load(name)
        q = system.q(POSTURES.get(name, "closed"))
        line = f"{name}, {len(system.structure.joints)}"
        names = {"mobility": module.mobility, "system": system, "q": q}
        timed = [
            Case("Kempe, rank and redundancy", line, "mobility(system, q, local=False)", names),
            Case("Kempe, all", line, "mobility(system, q)", names),
        ]
        if "exudyn" in bench.versions:
            timed.append(
                Case("Exudyn", line, "count()", {"count": Exudyn(Tree(system), q).freedoms})
            )
        table.rows += measure(timed, 1e3)
    for library, bound in (("Kempe, rank and redundancy", 5), ("Kempe, all", 100)):
        worst = max(
            row.best or row.value for row in table.rows if row.library == library and _judged(row)
        )
        table.at_most(f"{library[7:]}, 15 joints, at most {bound} ms", worst, bound)
    table.remarks.append(
        "all: with the local dimension by Taylor coefficients and by sampling where the rank does "
        "not prove it; Exudyn: number of freedoms and of redundant equations only"
    )
    return table


def _judged(row: Row) -> bool:
    return row.call.split(",")[0] in LARGE
